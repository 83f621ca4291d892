"""Ranges of the flight corrected by the ranging line's K2 and R2 (15), and what their uncertainty does to the vertices."""

import dataclasses

import numpy as np
import pytest

from evaluator.benches.bench_model import RangingResult
from evaluator.benches.order import flight_ranges
from evaluator.georeference import corrected_points
from evaluator.model import CampaignData, RangeCorrection
from evaluator.results_model import not_measured

COVARIANCE = np.array([[1e-6, -4e-9], [-4e-9, 2.5e-11]])


def ranging(k2: float, r2: float) -> RangingResult:
    return RangingResult(
        indicator=not_measured("%", "(11)", "9.1", "a test"),
        additive_constant_m=k2,
        multiplication_constant=r2,
        covariance=COVARIANCE,
    )


@pytest.fixture
def bare() -> CampaignData:
    """A campaign without any part: the correction asks for none."""
    missing = {f.name: None for f in dataclasses.fields(CampaignData) if f.default is dataclasses.MISSING}
    return CampaignData(**(missing | {"targets": (), "sorties": ()}))  # type: ignore[arg-type]


def test_points_move_along_their_rays() -> None:
    """Expected: L_Q = L + K2 + R2 L by hand: 50 m with K2 = 0.05 m and R2 = 2e-4 is 50.06 m, the direction unchanged; without a
    correction the very same array. Tolerance: rounding."""
    p = np.array([[0.0, 30.0, 40.0], [0.0, 0.0, 50.0]])
    moved = corrected_points(
        p, RangeCorrection(additive_constant_m=0.05, multiplication_constant=2e-4, covariance=COVARIANCE)
    )
    assert np.linalg.norm(moved, axis=1) == pytest.approx([50.06, 50.06], abs=1e-12)
    assert np.cross(moved, p) == pytest.approx(np.zeros((2, 3)), abs=1e-9)
    assert corrected_points(p, None) is p


def test_only_constants_that_differ_from_zero_correct(bare: CampaignData) -> None:
    """Rationale: a correction that may be zero would only add its noise. Expected: two standard deviations are left alone, fifty
    are not; the correction carries the pair's covariance."""
    assert flight_ranges(bare, ranging(0.002, 0.0)).range_correction is None
    found = flight_ranges(bare, ranging(0.05, 0.0)).range_correction
    assert found is not None
    assert found.additive_constant_m == 0.05
    assert found.covariance is COVARIANCE
    assert flight_ranges(bare, RangingResult(indicator=ranging(0.0, 0.0).indicator)).range_correction is None
