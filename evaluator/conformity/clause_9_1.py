"""9.1.2: how the ranging line was laid out and observed, and 5.3's classes of its total stations."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from campaign.benches.ranging import TotalStation
from evaluator.benches.ranging_fit import LEAST_P
from evaluator.benches.ranging_observations import BESIDE_SHARE
from evaluator.benches.total_station import air_notes, stations_of
from evaluator.conformity.model import ConformityInputs, Row, missing, passed, percent, row
from evaluator.model import CampaignData

_PANELS = 5
_OBSERVATIONS = 5
_CORRECTION_MM, _REFERENCE_MM = 10.0, 5.0
_EVEN = 2.0  # greatest gap between neighbouring panels over the mean gap
_SHORT_S = 60.0  # a pass over all panels; the text states no figure


def has_ranging(data: CampaignData) -> bool:
    """Whether the campaign holds a ranging line, readable or not."""
    return bool(data.ranging.line or data.ranging.readings or data.folder.ranging.is_dir())


def _used(data: CampaignData, use: str) -> TotalStation | None:
    """The station that the evaluation takes for a use."""
    return stations_of(data.ranging.line, data.ranging.readings).get(use) if data.ranging.line else None


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
        used = _used(data, use)
        if used is None:
            rows.append(missing(clause, name, limit, f"station that serves {use} in ranging/line.json"))
            continue
        rows.append(row(clause, name, f"{used.name}: {used.class_mm:g} mm class", limit, passed(used.class_mm <= most)))
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
    used = _used(data, use)
    seen: dict[str, set[tuple[str, int]]] = {}
    for r in data.ranging.readings:
        if used is not None and r.station == used.name and r.slope_distance_m is not None:
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
    with_air = [r for r in readings if r.temperature_c is not None and r.pressure_hpa is not None]
    if not with_air:
        return missing("9.1.2 e", requirement, limit, "air in ranging/total_station.csv")
    text = f"{len(with_air)} of {len(readings)} readings"
    for key, unit in keys:
        values = [value for r in with_air if (value := getattr(r, key)) is not None]
        text += f"; {min(values):.1f} to {max(values):.1f} {unit}" if values else "; no humidity"
    if len(with_air) < len(readings):
        return row("9.1.2 e", requirement, text, limit, "fail")
    site = data.manifest
    notes = (
        air_notes(data.ranging.line, data.ranging.readings, site.ellipsoid_height_m - site.height_anomaly_m)
        if data.ranging.line
        else []
    )
    return row("9.1.2 e", requirement, "; ".join([text, *notes]), limit, "warning" if notes else "pass")


def _angles(measured: ConformityInputs) -> list[Row]:
    """Panels against the places that the total station's angles give them; no row before the scans are searched."""
    requirement = "panels stand where distances and angles put them"
    limit = f"within {percent(BESIDE_SHARE, 0)} of a panel's size"
    companions = measured.ranging.indicator.companions if measured.ranging else {}
    beside, misread = companions.get("beside"), companions.get("misread")
    if misread is not None:
        return [row("9.1.2 c", requirement, str(misread), limit, "fail")]
    if not isinstance(beside, dict):
        return []
    share = float(beside["share"])
    text = f"{percent(share, 0)} beside at most ({beside['panel']})"
    if share > BESIDE_SHARE:
        text += ": mirrored angles, gon, or the eccentricity's sign or axes?"
    return [row("9.1.2 c", requirement, text, limit, passed(share <= BESIDE_SHARE))]


def _residuals(measured: ConformityInputs) -> Row:
    requirement, limit = "residuals of (14) agree with their stated accuracy", f"p ≥ {LEAST_P:g}"
    companions = measured.ranging.indicator.companions if measured.ranging else {}
    p = companions.get("chi_square_p")
    if not isinstance(p, int | float):
        return missing("9.1.2 h", requirement, limit, "adjustment of (14)")
    text = (
        f"p {p:.2g}, chi-square {companions['chi_square']:.1f}, {companions['chi_square_freedom']} degrees of freedom"
    )
    text = str(companions.get("residuals", text))
    return row("9.1.2 h", requirement, text, limit, passed(p >= LEAST_P))


def _scans(measured: ConformityInputs) -> Row:
    panels = measured.ranging.panels if measured.ranging else ()
    counts = {p.panel: p.scans for p in panels}
    found = _fewest("9.1.2 f", "observations by the LiDAR", counts, "panel found in the scans")
    same = measured.ranging.indicator.companions.get("same_scans") if measured.ranging else None
    if not isinstance(same, list) or not same:
        return found
    return replace(found, measured=f"{found.measured}; {len(same)} files repeat another's points", status="fail")


def clause_9_1(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    """Rows of 9.1.2; one row where the campaign has no ranging line."""
    if not has_ranging(data):
        requirement, limit = "line of reference panels with a total station", "9.1.2 a to k"
        return [row("9.1.2", requirement, "no ranging/ in this campaign", limit, "not_applicable")]
    correction, reference = station_rows(("9.1.2 c", "9.1.2 k"), data)
    what = "reading of such a station"
    return [
        _layout(data, measured),
        _interval(measured),
        correction,
        _fewest("9.1.2 c", "readings of slope distances", _station_counts(data, measured, "correction"), what),
        *_angles(measured),
        _constants(data),
        _air(data),
        _scans(measured),
        _residuals(measured),
        reference,
        _fewest("9.1.2 k", "readings of relative true values", _station_counts(data, measured, "reference"), what),
    ]
