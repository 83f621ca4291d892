"""8.1.2 a, 8.3.2 a and c, 9.3.2 a to c: how many targets there are, how they spread, and who found them.

The order of clauses 8 and 9 is kept here; benches and ranging line: clause_8_2, clause_9_1, clause_9_2.
"""

import numpy as np

from evaluator.conformity.clause_8_2 import clause_8_2
from evaluator.conformity.clause_9_1 import clause_9_1
from evaluator.conformity.clause_9_2 import clause_9_2
from evaluator.conformity.model import ConformityInputs, Row, missing, passed, percent, row
from evaluator.model import CampaignData
from evaluator.observe.picks import points_by_person

_LEVELS_PERCENT = (5.0, 20.0, 40.0, 60.0, 100.0)
_PANELS_A_LEVEL = 4
_FRUSTUMS = 20
_LEVEL_TOLERANCE_PERCENT = (
    2.5  # a level is what the panel was ordered as; its true reflectance is the spectrometer's matter
)


def _panels(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    requirement = "reference panels of 5, 20, 40, 60 and 100 %"
    limit = "≥ 4 of each"
    panels = [t for t in data.targets if t.kind == "panel"]
    stated = np.array(
        [t.nominal_reflectance_percent for t in panels if t.nominal_reflectance_percent is not None], dtype=float
    )
    counts = {level: int((np.abs(stated - level) <= _LEVEL_TOLERANCE_PERCENT).sum()) for level in _LEVELS_PERCENT}
    seen = [t.id for t in panels if measured.panel_points.get(t.id, 0) > 0]
    rows = []
    for clause in ("8.1.2 a", "8.3.2 a"):
        if not panels:
            rows.append(missing(clause, requirement, limit, "reference panel in survey/targets.csv"))
            continue
        text = ", ".join(f"{n} of {level:g} %" for level, n in counts.items())
        if measured.panel_points:
            text += f"; {len(seen)} of {len(panels)} found in the point clouds"
        enough = all(n >= _PANELS_A_LEVEL for n in counts.values())
        rows.append(row(clause, requirement, text, limit, passed(enough)))
    return rows


def _picked(clause: str, what: str, by: str | None, points_by_person: bool) -> Row:
    """`by`: who found them in the images; the points of the LiDAR are told apart."""
    requirement = f"{what} picked by a person"
    if by is None:
        return missing(clause, requirement, "visual", "statement of who found the targets")
    if by == "person":
        points = "pixels and LiDAR points" if points_by_person else "pixels"
        return row(clause, requirement, f"{points} from the campaign's observation records", "visual", "pass")
    if points_by_person:
        text = f"LiDAR points from the campaign's observation records, pixels found by the {by}"
        return row(clause, requirement, text, "visual", "warning")
    return row(clause, requirement, f"found by the {by}, residuals shown in the report", "visual", "warning")


def _frustums(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    frustums = [t for t in data.targets if t.kind == "frustum"]
    number, limit = "geometric targets in the common field", "≥ 20"
    spread, differ = "their places and depths differ", "not quantified"
    if not frustums:
        what = "frustum target in survey/targets.csv"
        return [missing("9.3.2 a", number, limit, what), missing("9.3.2 b", spread, differ, what)]
    text = f"{len(frustums)} surveyed"
    for name, count in (("with a vertex", measured.frustum_vertices), ("with a mark", measured.frustum_marks)):
        text += "" if count is None else f", {count} {name}"
    used = measured.frustums_used
    text += "" if used is None else f", {used} used"
    counted = used if used is not None else len(frustums)
    rows = [row("9.3.2 a", number, text, limit, passed(counted >= _FRUSTUMS))]
    east, north, height = np.array([[t.easting_m, t.northing_m, t.height_m] for t in frustums]).T
    text = f"{np.ptp(east):.0f} m × {np.ptp(north):.0f} m, target heights within {np.ptp(height):.2f} m"
    if data.plan and data.plan.strips:
        flown = sorted({s.height_m for s in data.plan.strips})
        text += f", flown at {', '.join(f'{h:g}' for h in flown)} m"
        depth = (max(flown) - min(flown) + float(np.ptp(height))) / min(flown)
        rows.append(
            row("9.3.2 b", spread, f"{text}: depth varies by {percent(depth, 0)}", differ, passed(depth > 0.01))
        )
    else:
        rows.append(row("9.3.2 b", spread, text, differ, passed(float(np.ptp(height)) > 0.0)))
    return rows


def clause_8_9(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    """Rows of clauses 8 and 9, in their order."""
    lidar, both = _panels(data, measured)
    return [
        lidar,
        *clause_8_2(data, measured),
        both,
        _picked("8.3.2 c", "reference panels", measured.panels_picked_by, points_by_person(data, "panel")),
        *clause_9_1(data, measured),
        *clause_9_2(data, measured),
        *_frustums(data, measured),
        _picked("9.3.2 c", "geometric targets", measured.frustums_picked_by, points_by_person(data, "frustum")),
    ]
