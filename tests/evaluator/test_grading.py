"""Table 3: every boundary of every indicator, both directions, and the groups marked *."""

import math

import pytest

from evaluator.c10_1_grading import GRADE_ZH, GROUPS, INDICATORS, grade, group_grades
from evaluator.model import EvaluationError

# Table 3 as printed: id -> bounds of 优, 良, 一般.
TABLE_3 = {
    "lidar_reflectance_rmse": (3.0, 5.0, 10.0),
    "camera_stability": (1.0, 3.0, 5.0),
    "camera_repeatability": (0.5, 1.0, 3.0),
    "reflectance_correlation": (99.0, 95.0, 90.0),
    "reflectance_rmse_relative": (3.0, 5.0, 10.0),
    "lidar_ranging_rmse_relative": (1.0, 3.0, 5.0),
    "camera_reprojection_error": (0.3, 0.5, 1.0),
    "calibration_error": (0.5, 1.0, 2.0),
}


@pytest.mark.parametrize("indicator", TABLE_3)
def test_boundaries_belong_to_the_better_grade(indicator: str) -> None:
    """Rationale: the table prints ≤ (and ≥ for r_f): the bound itself has the better grade, the next number does not.
    Expected: excellent, good, fair at the bounds; one step worse just past each; ungraded past the last.
    Tolerance: none, one unit in the last place."""
    worse = -math.inf if indicator == "reflectance_correlation" else math.inf
    at = [grade(indicator, b) for b in TABLE_3[indicator]]
    past = [grade(indicator, math.nextafter(b, worse)) for b in TABLE_3[indicator]]
    assert at == ["excellent", "good", "fair"]
    assert past == ["good", "fair", "ungraded"]


def test_a_value_is_graded_unrounded() -> None:
    """Rationale: 3.004 % prints as 3.00 % but is past the bound. Expected: good, not excellent."""
    assert grade("lidar_reflectance_rmse", 3.004) == "good"
    assert grade("reflectance_correlation", 98.996) == "good"


def test_correlation_runs_the_other_way() -> None:
    """Rationale: r_f is the one indicator where more is better. Expected: 100 % excellent, 0 ungraded; the reverse for m_f."""
    assert (grade("reflectance_correlation", 100.0), grade("reflectance_correlation", 0.0)) == ("excellent", "ungraded")
    assert (grade("lidar_reflectance_rmse", 100.0), grade("lidar_reflectance_rmse", 0.0)) == ("ungraded", "excellent")


@pytest.mark.parametrize(
    ("pair", "expected"), [((99.9, 4.0), "good"), ((94.0, 1.0), "fair"), ((80.0, 1.0), "ungraded")]
)
def test_starred_group_takes_the_lower(pair: tuple[float, float], expected: str) -> None:
    """Rationale: note * of table 3. Expected: the worse of r_f and M_f; ungraded is worse than fair."""
    grades = {
        "reflectance_correlation": grade("reflectance_correlation", pair[0]),
        "reflectance_rmse_relative": grade("reflectance_rmse_relative", pair[1]),
    }
    assert group_grades(grades)["multisensor_radiometry"] == expected


def test_half_measured_group_has_no_grade() -> None:
    """Rationale: the missing indicator might be the lower. Expected: not_measured although the other is excellent."""
    assert group_grades({"camera_stability": "excellent"})["camera_radiometry"] == "not_measured"


def test_groups_hold_every_indicator_once() -> None:
    """Rationale: the six rows of table 3 divide the eight indicators. Expected: each in one group, two groups starred."""
    members = [i for g in GROUPS for i in g.indicators]
    assert sorted(members) == sorted(INDICATORS) == sorted(TABLE_3)
    assert [g.id for g in GROUPS if g.starred] == ["camera_radiometry", "multisensor_radiometry"]
    assert [GRADE_ZH[g] for g in ("excellent", "good", "fair", "ungraded", "not_measured")] == [
        "优",
        "良",
        "一般",
        "超出评价范围",
        "未测",
    ]


@pytest.mark.parametrize(("indicator", "value"), [("m_f", 1.0), ("calibration_error", math.nan)])
def test_nonsense_is_refused(indicator: str, value: float) -> None:
    """Rationale: a NaN compares false with everything and would fall through to `ungraded`. Expected: an error."""
    with pytest.raises(EvaluationError):
        grade(indicator, value)
