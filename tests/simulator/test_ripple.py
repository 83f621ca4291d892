"""Heat shimmer: a picture displaced in blocks of rows is the picture displaced."""

import numpy as np
import pytest

from campaign.config import Faults
from simulator.camera.ripple import ripple_px, rippled, rippled_rows

FAULTS = Faults(image_ripple_px=2.0, image_ripple_period_px=120.0)


def test_blocks_of_rows_leave_no_seam() -> None:
    """Rationale: a frame of 45 megapixels is displaced in bands; a spline that ends at a band's border would draw a line.

    Expected: the same values whether rows are displaced alone or in blocks of any height.
    Tolerance: 1e-6 of the range, for a search that ends at 1e-6 px and a spline's tail of 0.27^24.
    """
    picture = np.random.default_rng(1).uniform(0, 1, (330, 200, 2)).astype(np.float32)
    whole = rippled(picture, FAULTS, "a")
    for step in (16, 77):
        parts = [
            rippled_rows(picture, FAULTS, "a", slice(first, min(first + step, len(picture))))
            for first in range(0, len(picture), step)
        ]
        assert np.concatenate(parts) == pytest.approx(whole, abs=1e-6)
    assert rippled(picture[..., 0], FAULTS, "a") == pytest.approx(whole[..., 0])


def test_a_dot_moves_by_the_stated_displacement() -> None:
    """Rationale: truth of marks and corners is computed with `ripple_px`; the picture must follow it.

    Expected: the centroid of a round dot at its place plus the displacement there; another image is displaced otherwise.
    Tolerance: 0.02 px: the displacement bends within the dot, by 2 (2 pi / 400)^2 3^2 = 0.005 px.
    """
    faults = Faults(image_ripple_px=2.0, image_ripple_period_px=400.0)
    v, u = np.mgrid[:300, :300] + 0.5
    place = np.array([143.2, 161.7])
    dot = np.exp(-0.5 * ((u - place[0]) ** 2 + (v - place[1]) ** 2) / 3.0**2).astype(np.float32)
    moved = rippled(dot, faults, "a")
    centroid = np.array([(moved * u).sum(), (moved * v).sum()]) / moved.sum()
    assert centroid == pytest.approx(place + ripple_px(faults, place, "a"), abs=0.02)
    assert np.hypot(*(centroid - place - ripple_px(faults, place, "b"))) > 0.1
