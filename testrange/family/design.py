"""Which members a family has: each indicator in the middle of every grade and on both sides of every boundary, one clause violated
at a time, and a control of each kind with nothing wrong.
"""

from collections.abc import Sequence

from campaign.progress import Report, silent
from testrange.family.knobs import GROUP, Knob, Truth, knob, solve
from testrange.family.model import (
    ACCEPTED,
    BOUNDS,
    GREATER_IS_BETTER,
    Expected,
    Family,
    Grade,
    Group,
    Indicator,
    Member,
)
from testrange.family.violations import MAY_FAIL, PARTS, violation_members

_BESIDE = ACCEPTED * 1.02  # tolerances from a boundary: a hair farther than what is accepted
_CONTROLS: dict[Group, Indicator] = {
    "sphere": "camera_stability",
    "ranging": "lidar_ranging_rmse_relative",
    "chessboard": "camera_reprojection_error",
    "radiometry": "reflectance_correlation",
    "geometry": "calibration_error",
}


def middle(indicator: Indicator, grade: Grade) -> float:
    """The middle of a grade in table 3; beyond, half a grade's width past the last bound."""
    best = 100.0 if indicator in GREATER_IS_BETTER else 0.0
    first, second, third = BOUNDS[indicator]
    edges = {
        "excellent": (best, first),
        "good": (first, second),
        "fair": (second, third),
        "ungraded": (third, 2.0 * third - second),
    }[grade]
    return 0.5 * (edges[0] + edges[1])


def designed(family: Family, progress: Report = silent, only: Sequence[str] = ()) -> list[Member]:
    """Every member, its faults solved for; `only` those whose name begins with one of these.

    Raises
    ------
    ConfigError
        A setting is wrong, or a value that cannot exist here.
    """
    members: list[Member] = []
    stages = len(family.indicators) + 1
    for done, indicator in enumerate(family.indicators):
        progress("design", done, stages)
        control = f"control.{GROUP[indicator]}"
        if not any(_may_begin(name, only) for name in (f"{indicator}.", control)):
            continue
        moves = knob(family, indicator)
        members += [_in_grade(moves, grade) for grade in family.grades]
        if family.boundaries:
            members += _beside(moves)
        if family.controls and indicator in _CONTROLS.values():
            what = "nothing wrong but what every sensor has"
            members.append(_member(control, indicator, moves.truth(0.0), what))
    progress("design", stages - 1, stages)
    if family.controls:
        members.append(_plain_control())
    members += violation_members(family.violations)
    progress("design", stages, stages)
    return [m for m in members if not only or m.name.startswith(tuple(only))]


def _may_begin(name: str, only: Sequence[str]) -> bool:
    return not only or any(name.startswith(o) or o.startswith(name) for o in only)


def _member(name: str, indicator: Indicator, truth: Truth, purpose: str) -> Member:
    group = GROUP[indicator]
    return Member(
        name=name,
        group=group,
        parts=PARTS[group],
        purpose=purpose,
        settings=truth.settings,
        expected=Expected(
            member=name,
            indicators=truth.indicators,
            constants=truth.constants,
            mounting=truth.mounting,
            may_fail=MAY_FAIL.get(group, ()),
        ),
    )


def _in_grade(moves: Knob, grade: Grade) -> Member:
    indicator = moves.indicator
    wanted = middle(indicator, grade)
    purpose = f"{indicator} in the middle of {grade}: {wanted:g}"
    return _member(f"{indicator}.{grade}", indicator, solve(moves, wanted), purpose)


def _beside(moves: Knob) -> list[Member]:
    """Three tolerances to both sides of each boundary."""
    members, indicator = [], moves.indicator
    for bound in BOUNDS[indicator]:
        tolerance = solve(moves, bound).indicators[indicator].tolerance
        for name, sign in (("below", -1.0), ("above", 1.0)):
            solved = solve(moves, bound + sign * _BESIDE * tolerance)
            purpose = f"{indicator} three tolerances {name} the boundary {bound:g}"
            members.append(_member(f"{indicator}.{name}_{bound:g}", indicator, solved, purpose))
    return members


def _plain_control() -> Member:
    return Member(
        name="control.records",
        group="records",
        parts=PARTS["records"],
        purpose="records of a flight with no clause violated",
        expected=Expected(member="control.records"),
    )
