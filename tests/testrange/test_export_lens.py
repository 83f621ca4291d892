"""A lens of results.json that cannot be the camera's is refused before anything is written."""

import pytest

from campaign.config import Lens
from testrange.export.source import check_lens


def test_a_lens_far_from_the_sheet_is_refused() -> None:
    """Rationale: 1e308 px in results.json went into cameras.txt as it stood. Expected: both principal distances named where they
    differ by more than a factor of two; no word otherwise. Tolerance: a refocused lens moves by some percent."""
    stated = Lens(fx_px=3000.0, fy_px=3000.0, cx_px=1536.0, cy_px=1024.0)
    for fx_px in (1e308, 100.0):
        with pytest.raises(ValueError, match=r"fx_px is .*, the sheet's 3000"):
            check_lens(stated.model_copy(update={"fx_px": fx_px}), stated)
    check_lens(stated.model_copy(update={"fx_px": 3054.0}), stated)
    check_lens(None, stated)
    check_lens(stated, None)
