"""IUGG 1999: group refractive index for electronic distance measurement."""

import pytest

from evaluator.c9_1_lidar_ranging import group_refractive_index, meteorological_correction, saturation_pressure_hpa
from evaluator.model import EvaluationError


def test_check_value() -> None:
    """Rationale: a published worked value for a total station's carrier: 0.658 um, 12 degrees, 1013.25 hPa, 60 %.

    Expected: refractivity 286.338. Tolerance: 0.002, for the vapour pressure formula (0.3 % of 8.4 hPa moves it by 0.001)
    and the last printed digit (0.0005), twice.
    """
    assert (group_refractive_index(0.658, 12.0, 1013.25, 60.0) - 1.0) * 1e6 == pytest.approx(286.338, abs=0.002)


def test_standard_air_is_the_dispersion_alone() -> None:
    """Dry air at 0 degrees and 1013.25 hPa: 287.6155 + 4.8866 + 0.068 at 1 um. Tolerance: rounding of 1 + N 1e-6."""
    assert (group_refractive_index(1.0, 0.0, 1013.25, 0.0) - 1.0) * 1e6 == pytest.approx(292.5701, abs=1e-8)


def test_saturation_pressure_at_20_degrees() -> None:
    """Published (WMO): 23.37 hPa by Goff and Gratch. Tolerance: 0.3 %, what Magnus is good for."""
    assert saturation_pressure_hpa(20.0) == pytest.approx(23.37, rel=3e-3)


def test_a_millionth_of_index_is_a_millimetre_a_kilometre() -> None:
    """Formula (12) by hand: S = 1000 m, n_0 - n_g = 1e-6: 1e-3 m / n_g. Tolerance: rounding at 1e3 m."""
    assert meteorological_correction(1000.0, 1.000287, 1.000286) == pytest.approx(1e-3 / 1.000286, abs=1e-9)


@pytest.mark.parametrize(
    ("s", "n0", "ng"), [(float("nan"), 1.0003, 1.0003), (10.0, 286.3, 1.0003), (10.0, 1.0003, 0.0)]
)
def test_no_index_of_air_is_refused(s: float, n0: float, ng: float) -> None:
    with pytest.raises(EvaluationError, match="formula"):
        meteorological_correction(s, n0, ng)
