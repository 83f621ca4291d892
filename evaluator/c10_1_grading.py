"""10.1, table 3: from an indicator's value to its grade, and from the indicators of a group to the group's grade.

Nothing is measured here and nothing is rounded: the unrounded value is graded, and a value on a boundary gets the better
grade. A value past the last column has no grade in the table and is `ungraded`, never a fourth grade.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from evaluator.model import EvaluationError

Grade = Literal["excellent", "good", "fair", "ungraded", "not_measured"]

GRADE_ZH: dict[Grade, str] = {
    "excellent": "优",
    "good": "良",
    "fair": "一般",
    "ungraded": "超出评价范围",
    "not_measured": "未测",
}
# From best to worst; what a group marked * takes is the last of these among its indicators.
_ORDER: tuple[Grade, ...] = ("excellent", "good", "fair", "ungraded")


@dataclass(frozen=True, kw_only=True)
class Indicator:
    """One row of table 3: names, unit and the bounds of 优, 良 and 一般."""

    id: str
    symbol: str
    name_en: str
    name_zh: str
    unit: str
    formula: str
    clause: str
    bounds: tuple[float, float, float]
    higher_is_better: bool = False


@dataclass(frozen=True, kw_only=True)
class Group:
    """One row of table 3's second column. `starred`: graded by the lower of its indicators."""

    id: str
    name_en: str
    name_zh: str
    indicators: tuple[str, ...]
    starred: bool


def _row(
    id: str, symbol: str, en: str, zh: str, unit: str, formula: str, clause: str, *bounds: float, up: bool = False
) -> Indicator:
    best, middle, last = bounds
    return Indicator(
        id=id,
        symbol=symbol,
        name_en=en,
        name_zh=zh,
        unit=unit,
        formula=formula,
        clause=clause,
        bounds=(best, middle, last),
        higher_is_better=up,
    )


INDICATORS: dict[str, Indicator] = {
    row.id: row
    for row in (
        _row(
            "lidar_reflectance_rmse",
            "m_f",
            "LiDAR reflectance RMSE",
            "反射率中误差",
            "% reflectance",
            "(2)",
            "8.1",
            3.0,
            5.0,
            10.0,
        ),
        _row("camera_stability", "RSD", "Camera stability", "稳定性", "%", "(3)-(5)", "8.2", 1.0, 3.0, 5.0),
        _row("camera_repeatability", "s(x)", "Camera repeatability", "重复性", "%", "(6)", "8.2", 0.5, 1.0, 3.0),
        _row(
            "reflectance_correlation",
            "r_f",
            "Reflectance correlation",
            "反射率相关性",
            "%",
            "(7)",
            "8.3",
            99.0,
            95.0,
            90.0,
            up=True,
        ),
        _row(
            "reflectance_rmse_relative",
            "M_f",
            "LiDAR against camera reflectance RMSE",
            "反射率相对中误差",
            "% reflectance",
            "(8)",
            "8.3",
            3.0,
            5.0,
            10.0,
        ),
        _row(
            "lidar_ranging_rmse_relative",
            "m_z",
            "LiDAR relative ranging RMSE",
            "测距相对中误差",
            "%",
            "(9)-(15)",
            "9.1",
            1.0,
            3.0,
            5.0,
        ),
        _row(
            "camera_reprojection_error",
            "M_z",
            "Camera mean reprojection error",
            "平均重投影误差",
            "pixel",
            "(16)-(19)",
            "9.2",
            0.3,
            0.5,
            1.0,
        ),
        _row(
            "calibration_error",
            "P_m",
            "Mean calibration error",
            "平均标定误差",
            "pixel",
            "(20)-(24)",
            "9.3",
            0.5,
            1.0,
            2.0,
        ),
    )
}

GROUPS: tuple[Group, ...] = (
    Group(
        id="lidar_radiometry",
        name_en="LiDAR radiometric consistency",
        name_zh="激光雷达辐射一致性",
        indicators=("lidar_reflectance_rmse",),
        starred=False,
    ),
    Group(
        id="camera_radiometry",
        name_en="Optical sensor radiometric consistency",
        name_zh="光学遥感传感器辐射一致性",
        indicators=("camera_stability", "camera_repeatability"),
        starred=True,
    ),
    Group(
        id="multisensor_radiometry",
        name_en="Multi-sensor radiometric consistency",
        name_zh="多传感器辐射一致性",
        indicators=("reflectance_correlation", "reflectance_rmse_relative"),
        starred=True,
    ),
    Group(
        id="lidar_geometry",
        name_en="LiDAR geometric consistency",
        name_zh="激光雷达几何一致性",
        indicators=("lidar_ranging_rmse_relative",),
        starred=False,
    ),
    Group(
        id="camera_geometry",
        name_en="Optical sensor geometric consistency",
        name_zh="光学遥感传感器几何一致性",
        indicators=("camera_reprojection_error",),
        starred=False,
    ),
    Group(
        id="multisensor_geometry",
        name_en="Multi-sensor geometric consistency",
        name_zh="多传感器几何一致性",
        indicators=("calibration_error",),
        starred=False,
    ),
)


def grade(indicator_id: str, value: float) -> Grade:
    """Grade of one indicator by table 3.

    Parameters
    ----------
    indicator_id : str
        One of `INDICATORS`.
    value : float
        Unrounded, in the indicator's unit.

    Returns
    -------
    "excellent" | "good" | "fair" | "ungraded"
        The first column whose bound the value meets; the bound belongs to the better grade. `ungraded` past the last.

    Raises
    ------
    EvaluationError
        Unknown indicator, or a value that is not finite.

    Notes
    -----
    The table prints r_i for the reflectance correlation r_f, whose bounds are lower bounds; all others are upper bounds.

    References
    ----------
    GB/T 41450-2022, 10.1, table 3.
    """
    row = INDICATORS.get(indicator_id)
    if row is None:
        raise EvaluationError(f"{indicator_id!r} is not an indicator of table 3", expected=", ".join(INDICATORS))
    if not math.isfinite(value):
        raise EvaluationError("an indicator that is not finite has no grade", where=indicator_id, got=value)
    for name, bound in zip(_ORDER, row.bounds):
        if value >= bound if row.higher_is_better else value <= bound:
            return name
    return "ungraded"


def group_grade(group: Group, grades: Mapping[str, Grade]) -> Grade:
    """Grade of a group: of its only indicator, or (marked * in table 3) the lower of its indicators'.

    A group of which one indicator was not measured is `not_measured`: the missing one might be the lower.

    References
    ----------
    GB/T 41450-2022, 10.1, table 3 and its note.
    """
    found = [grades.get(i, "not_measured") for i in group.indicators]
    if "not_measured" in found:
        return "not_measured"
    return max(found, key=_ORDER.index)


def group_grades(grades: Mapping[str, Grade]) -> dict[str, Grade]:
    """Grades of all six groups, by the group's id."""
    return {g.id: group_grade(g, grades) for g in GROUPS}
