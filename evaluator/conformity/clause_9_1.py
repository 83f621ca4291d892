"""9.1.2: how the ranging line was laid out and observed, and 5.3's classes of its total stations."""

from collections.abc import Mapping

import numpy as np

from campaign.ranging import TotalStation
from evaluator.conformity.model import ConformityInputs, Row, missing, passed, row
from evaluator.model import CampaignData

_PANELS = 5
_OBSERVATIONS = 5
_CORRECTION_MM, _REFERENCE_MM = 10.0, 5.0
_EVEN = 2.0  # greatest gap between neighbouring panels over the mean gap
_SHORT_S = 60.0  # a pass over all panels; the text states no figure


def has_ranging(data: CampaignData) -> bool:
    """Whether the campaign holds a ranging line, readable or not."""
    return bool(data.ranging.line or data.ranging.readings or data.folder.ranging.is_dir())


def _serving(data: CampaignData, use: str) -> list[TotalStation]:
    return [s for s in data.ranging.line.stations if use in s.serves] if data.ranging.line else []


def station_rows(clauses: tuple[str, str], data: CampaignData) -> list[Row]:
    """The classes of both uses of total stations: by ranging/line.json, else by the plan's instruments."""
    names = "total station for slope distances", "total station for relative true values"
    limits = "10 mm class or better", "5 mm class or better"
    if data.ranging.line is None:
        stated = data.plan.instruments.get("total_station") if data.plan else None
        what = "class in ranging/line.json"
        return [
            row(clause, name, f"{stated} (by the plan)", limit, "warning")
            if stated
            else missing(clause, name, limit, what)
            for clause, name, limit in zip(clauses, names, limits)
        ]
    rows = []
    for clause, name, limit, use, most in zip(
        clauses, names, limits, ("correction", "reference"), (_CORRECTION_MM, _REFERENCE_MM)
    ):
        stations = _serving(data, use)
        if not stations:
            rows.append(missing(clause, name, limit, f"station that serves {use} in ranging/line.json"))
            continue
        text = ", ".join(f"{s.name}: {s.class_mm:g} mm class" for s in stations)
        rows.append(row(clause, name, text, limit, passed(all(s.class_mm <= most for s in stations))))
    return rows


def _distances(data: CampaignData, measured: ConformityInputs) -> dict[str, float]:
    """Panel -> distance: as evaluated, else the mean of the total stations' raw readings. [m]"""
    if measured.ranging is not None and measured.ranging.panels:
        return {p.panel: p.lidar_m for p in measured.ranging.panels}
    read: dict[str, list[float]] = {}
    for r in data.ranging.readings:
        if r.slope_distance_m is not None:
            read.setdefault(r.panel, []).append(r.slope_distance_m)
    return {panel: float(np.mean(values)) for panel, values in read.items()}


def _layout(data: CampaignData, measured: ConformityInputs) -> Row:
    requirement, limit = "reference panels spread evenly over the LiDAR's range", "≥ 5"
    found = np.sort(np.array(list(_distances(data, measured).values())))
    if not found.size:
        return missing("9.1.2 a", requirement, limit, "panel with a distance")
    text = f"{found.size} panels from {found[0]:.1f} m to {found[-1]:.1f} m"
    if measured.ranging is not None and measured.ranging.not_used:
        text += f", {len(measured.ranging.not_used)} not used"
    if found.size < _PANELS:
        return row("9.1.2 a", requirement, text, limit, "fail")
    ratio = float(np.diff(found).max() / max(np.diff(found).mean(), 1e-9))
    text += f"; greatest gap {ratio:.1f} times the mean gap"
    return row("9.1.2 a", requirement, text, limit, "pass" if ratio <= _EVEN else "warning")


def _interval(measured: ConformityInputs) -> Row:
    requirement, limit = "all panels scanned within a short interval", f"stated; warning beyond {_SHORT_S:.0f} s a scan"
    seconds = measured.ranging.indicator.companions.get("scan_duration_s") if measured.ranging else None
    if not isinstance(seconds, int | float):
        return missing("9.1.2 b", requirement, limit, "time in the scans' records")
    return row(
        "9.1.2 b",
        requirement,
        f"{seconds:.1f} s a scan at most",
        limit,
        "pass" if seconds <= _SHORT_S else "warning",
    )


def _fewest(clause: str, requirement: str, counts: Mapping[str, int], what: str) -> Row:
    limit = f"≥ {_OBSERVATIONS} of each panel"
    if not counts:
        return missing(clause, requirement, limit, what)
    least = min(counts, key=counts.__getitem__)
    text = f"least {counts[least]} ({least}), {len(counts)} panels"
    return row(clause, requirement, text, limit, passed(counts[least] >= _OBSERVATIONS))


def _station_counts(data: CampaignData, measured: ConformityInputs, use: str) -> dict[str, int]:
    if measured.ranging is not None and measured.ranging.panels:
        by_use = {"correction": "correction_readings", "reference": "reference_readings"}[use]
        return {p.panel: int(getattr(p, by_use)) for p in measured.ranging.panels}
    names = {s.name for s in _serving(data, use)}
    seen: dict[str, set[tuple[str, int]]] = {}
    for r in data.ranging.readings:
        if r.station in names and r.slope_distance_m is not None:
            seen.setdefault(r.panel, set()).add((r.station, r.observation))
    return {panel: len(found) for panel, found in seen.items()}


def _constants(data: CampaignData) -> Row:
    requirement, limit = "constants K₁ and R₁ from the instrument's certificate", "stated"
    if data.ranging.line is None:
        return missing("9.1.2 d", requirement, limit, "ranging/line.json")
    text = "; ".join(
        f"{s.name}: K₁ {s.additive_constant_m * 1000:+.1f} mm, R₁ {s.scale * 1e6:+.1f} ppm"
        for s in data.ranging.line.stations
    )
    return row("9.1.2 d", requirement, text, limit, "pass")


def _air(data: CampaignData) -> Row:
    requirement, limit = "temperature, pressure and humidity for the atmospheric correction (12)", "with every reading"
    readings = [r for r in data.ranging.readings if r.slope_distance_m is not None]
    if not readings:
        return missing("9.1.2 e", requirement, limit, "reading in ranging/total_station.csv")
    keys = ("temperature_c", "°C"), ("pressure_hpa", "hPa"), ("relative_humidity_percent", "%")
    with_air = [r for r in readings if all(getattr(r, key) is not None for key, _ in keys)]
    if not with_air:
        return missing("9.1.2 e", requirement, limit, "air in ranging/total_station.csv")
    text = f"{len(with_air)} of {len(readings)} readings"
    for key, unit in keys:
        values = [getattr(r, key) for r in with_air]
        text += f"; {min(values):.1f} to {max(values):.1f} {unit}"
    return row("9.1.2 e", requirement, text, limit, passed(len(with_air) == len(readings)))


def clause_9_1(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    """Rows of 9.1.2; one row where the campaign has no ranging line."""
    if not has_ranging(data):
        requirement, limit = "line of reference panels with a total station", "9.1.2 a to k"
        return [row("9.1.2", requirement, "no ranging/ in this campaign", limit, "not_applicable")]
    panels = measured.ranging.panels if measured.ranging else ()
    correction, reference = station_rows(("9.1.2 c", "9.1.2 k"), data)
    what = "reading of such a station"
    return [
        _layout(data, measured),
        _interval(measured),
        correction,
        _fewest("9.1.2 c", "readings of slope distances", _station_counts(data, measured, "correction"), what),
        _constants(data),
        _air(data),
        _fewest("9.1.2 f", "observations by the LiDAR", {p.panel: p.scans for p in panels}, "panel found in the scans"),
        reference,
        _fewest("9.1.2 k", "readings of relative true values", _station_counts(data, measured, "reference"), what),
    ]
