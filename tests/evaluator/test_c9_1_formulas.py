"""Formulas (9)-(15) and the total station's corrections by hand: numbers that a reader can check with a pocket calculator."""

import numpy as np
import pytest

from campaign.benches.ranging import (
    RangingLine,
    RangingPanel,
    TotalStation,
)
from evaluator.benches.total_station import (
    StationPanel,
    StationResult,
    corrected_slope_distance,
    covariance_m2,
    eccentricity_covariance_m2,
    group_refractive_index,
    meteorological_correction,
)
from evaluator.c9_1_lidar_ranging import (
    corrected_range,
    mean_range,
    range_correction_constants,
    ranging_rmse,
    relative_rmse,
)
from evaluator.model import EvaluationError
from evaluator.observe.ranging_panels import _rotation

MM = 1e-3


def test_formulas_9_to_11_by_hand() -> None:
    """Errors 3, -4, 0, 0, 0 mm: m_j = sqrt(25 / 5) mm = 2.236068 mm. True ranges 10 ... 50 m: mean 30 m; m_z = 0.00745356 %.

    The mean is that of the true ranges, as (10) prints it: with the measured ones it were 29.9998 m. Tolerance: rounding.
    """
    truth = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    measured = truth + np.array([3.0, -4.0, 0.0, 0.0, 0.0]) * MM
    assert ranging_rmse(measured, truth) == pytest.approx(np.sqrt(5.0) * MM, abs=1e-12)
    assert mean_range(truth) == 30.0
    assert relative_rmse(np.sqrt(5.0) * MM, 30.0) == pytest.approx(100 * np.sqrt(5.0) / 30_000.0, rel=1e-12)


def test_formulas_13_and_14_by_hand() -> None:
    """L = 10 ... 50 m, differences 1, 2, 3, 4, 6 mm.

    Slope: sum of (-20, -10, 0, 10, 20)(-2.2, -1.2, -0.2, 0.8, 2.8) = 120 over 1000: R_2 = 0.12 mm/m; K_2 = 3.2 - 0.12 * 30
    = -0.4 mm. Residuals 0.2, 0, -0.2, -0.4, 0.4 mm: sum of squares 0.4, variance 0.4 / 3; of R_2 that over 1000.
    Tolerance: rounding at 50 m.
    """
    measured = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    k2, r2, covariance = range_correction_constants(measured, measured + np.array([1.0, 2.0, 3.0, 4.0, 6.0]) * MM)
    assert k2 == pytest.approx(-0.4 * MM, abs=1e-12)
    assert r2 == pytest.approx(0.12 * MM, abs=1e-13)
    assert covariance[1, 1] == pytest.approx(0.4 / 3.0 * 1e-6 / 1000.0, rel=1e-6)
    assert covariance[0, 0] == pytest.approx(0.4 / 3.0 * 1e-6 * (1 / 5 + 900.0 / 1000.0), rel=1e-6)


def test_what_all_panels_share_goes_into_the_constant_alone() -> None:
    """Rationale: the eccentricity's error shifts every distance alike; averaging over panels must not shrink it.

    Expected: 2 mm common to all adds 4 mm2 to the variance of K_2, nothing to R_2, and changes neither estimate.
    Tolerance: rounding.
    """
    measured = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    reference = measured + np.array([1.0, 2.0, 3.0, 4.0, 6.0]) * MM
    own = np.eye(5) * MM**2
    alone = range_correction_constants(measured, reference, own)
    both = range_correction_constants(measured, reference, own + 4.0 * MM**2)
    assert both[:2] == pytest.approx(alone[:2], abs=1e-10)
    assert both[2][0, 0] - alone[2][0, 0] == pytest.approx(4.0 * MM**2, rel=1e-6)
    assert both[2][1, 1] == pytest.approx(alone[2][1, 1], rel=1e-6)


def test_a_panel_of_no_weight_does_not_count() -> None:
    """Five panels on the line K_2 = 50 mm, R_2 = 2e-4, a sixth 1 m off but stated to be good to 1 km. Tolerance: 1e-6 m."""
    measured = np.array([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    reference = measured * 1.0002 + 0.05
    reference[5] += 1.0
    k2, r2, _ = range_correction_constants(measured, reference, np.diag([1e-6] * 5 + [1e6]))
    assert k2 == pytest.approx(0.05, abs=1e-6)
    assert r2 == pytest.approx(2e-4, abs=1e-7)


def test_formula_15_by_hand() -> None:
    """100 m + 0.05 m + 2e-4 * 100 m = 100.07 m. Tolerance: rounding."""
    assert corrected_range([100.0], 0.05, 2e-4) == pytest.approx([100.07], abs=1e-12)


def test_total_station_by_hand() -> None:
    """S = 200 m in dry air of 0 degrees and 1013.25 hPa at 1 um: n_g = 1.0002925701 (287.6155 + 4.8866 + 0.0680), n_0 = 1.0003:
    dD = 200 * 7.4299e-6 / n_g = 1.485545 mm; K_1 = -1.4 mm, R_1 = 3e-6: D = 200 - 0.0014 + 0.0006 + 0.001485545 m.

    Tolerance: 1e-9 m, the last digit above.
    """
    correction = meteorological_correction(200.0, 1.0003, group_refractive_index(1.0, 0.0, 1013.25, 0.0))
    assert correction == pytest.approx(1.485545 * MM, abs=1e-9)
    assert corrected_slope_distance(200.0, -1.4 * MM, 3e-6, correction) == pytest.approx(200.000685545, abs=1e-9)


def test_covariance_of_two_distances_by_hand() -> None:
    """Two panels at 100 m (east) and 200 m (north), 5 and 4 readings of 2 mm, certificate 0.2 mm and 0.5 ppm, eccentricity 0.5 mm.

    Expected: 4/5 + 0.04 + 0.05^2 = 0.8425 mm2 and 4/4 + 0.04 + 0.1^2 = 1.05 mm2; common to both 0.04 + 0.05 * 0.1 = 0.045 mm2.
    The eccentricity adds 0.25 mm2 to each, and nothing in common as they stand at right angles. Tolerance: rounding.
    """
    panels = tuple(
        StationPanel(
            panel=name, readings=n, distance_m=d, std_m=None, place_m=d * np.eye(3)[k], sight_m=d, class_m=10 * MM
        )
        for k, (name, n, d) in enumerate((("a", 5, 100.0), ("b", 4, 200.0)))
    )
    station = TotalStation(
        name="A",
        class_mm=10.0,
        additive_constant_m=-1.4 * MM,
        scale=3e-6,
        additive_constant_std_m=0.2 * MM,
        scale_std=0.5e-6,
        reference_index=1.0003,
        wavelength_um=1.0,
        serves=("correction",),
    )
    result = StationResult(station=station, panels=panels, scatter=0.2, freedom=7)
    assert covariance_m2(result, ["a", "b"]) / MM**2 == pytest.approx(np.array([[0.8425, 0.045], [0.045, 1.05]]))
    sheet = RangingLine(
        stations=(station,),
        panels=(RangingPanel(id="a", size_m=1.0),),
        eccentricity_m=(0, 0, 0),
        eccentricity_std_m=0.0005,
    )
    assert eccentricity_covariance_m2(sheet, result, ["a", "b"]) / MM**2 == pytest.approx(0.25 * np.eye(2))


def test_a_flat_fan_of_panels_gives_a_rotation_and_no_mirror() -> None:
    """Rationale: panels at one height lie in one plane with the LiDAR, where a mirror image fits as well as a rotation does.

    Expected: over 20 turns, the turn itself, from two directions and from five. Tolerance: rounding.
    """
    rng = np.random.default_rng(4)
    for count in (2, 5):
        azimuth = np.radians(np.linspace(-8.0, 9.0, count))
        origin = np.stack([np.sin(azimuth), np.cos(azimuth), np.zeros(count)], axis=-1)
        for _ in range(20):
            q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
            turn = q * np.sign(np.linalg.det(q))
            assert _rotation(origin @ turn.T, origin, np.ones(count)) == pytest.approx(turn, abs=1e-7)


@pytest.mark.parametrize("bad", [[1.0, 2.0, 3.0, 4.0], [1.0, 2.0, 3.0, 4.0, np.nan], [[1.0] * 5] * 5])
def test_formulas_refuse_what_they_cannot_average(bad: list) -> None:
    """Four panels, NaN, a matrix: an EvaluationError that names the formula."""
    with pytest.raises(EvaluationError, match=r"formula \(9\)"):
        ranging_rmse(bad, bad)
    with pytest.raises(EvaluationError, match=r"formula \(10\)"):
        mean_range(bad)
    with pytest.raises(EvaluationError, match=r"formula \(13\)"):
        range_correction_constants(bad, bad)


def test_one_distance_gives_no_scale() -> None:
    with pytest.raises(EvaluationError, match="one distance"):
        range_correction_constants([10.0, 10.1, 10.2, 10.0, 10.1], [10.0, 10.1, 10.2, 10.0, 10.1])
    with pytest.raises(EvaluationError, match="covariance"):
        range_correction_constants([10.0, 20.0, 30.0, 40.0, 50.0], [10.0, 20.0, 30.0, 40.0, 50.0], -np.eye(5))
