"""5.1-5.5: what is tested and in which order, instruments, datum and time, how well the panels were observed."""

import numpy as np

from evaluator.conformity.clause_6 import survey_accuracy, worst_flatness
from evaluator.conformity.clause_6_3 import has_chessboard, has_sphere, sphere_row
from evaluator.conformity.clause_9_1 import has_ranging, station_rows
from evaluator.conformity.model import ConformityInputs, Row, missing, passed, percent, row
from evaluator.model import CampaignData

_INDICATORS = 8  # table 1
_CGCS2000_ZONES = range(4513, 4555)  # 4513-4533 with zone numbers, 4534-4554 by central meridian
_HEIGHT_1985 = 5737
_BRIGHTNESS = (0.30, 0.80)
_POINTS = 100


def _first_flight_s(data: CampaignData) -> float | None:
    """When the first image was taken in flight, or the first trajectory begins. [adjusted GPS s]"""
    times = [e.gps_time_s for s in data.sorties for e in s.exposures]
    times += [float(s.trajectory.gps_time_s[0]) for s in data.sorties if s.trajectory is not None]
    return min(times, default=None)


def _sensors_first(data: CampaignData) -> Row:
    requirement = "each sensor's own radiometric and geometric performance tested before the multi-sensor test"
    present = {
        "camera radiometry (8.2)": has_sphere(data),
        "camera geometry (9.2)": has_chessboard(data),
        "LiDAR geometry (9.1)": has_ranging(data),
    }
    absent = [name for name, here in present.items() if not here]
    if absent:
        calibration = data.camera.calibration if data.camera else None
        note = f"; camera certificate {calibration.certificate} of {calibration.date}" if calibration else ""
        return row("5.1", requirement, f"no {', '.join(absent)} in this campaign{note}", "required", "not_recorded")
    flown = _first_flight_s(data)
    bench = data.bench
    tested = [e.gps_time_s for e in (*bench.stability, *bench.repeatability)]
    tested += [e.gps_time_s for e in bench.board_log if e.gps_time_s is not None]
    text = f"{', '.join(present)} are part of the campaign"
    if flown is None or not tested:
        return row("5.1", requirement, text, "required", "pass")
    hours = (flown - max(tested)) / 3600.0
    text += f"; benches ended {abs(hours):.1f} h {'before' if hours > 0 else 'after'} the flight began"
    return row("5.1", requirement, text, "required", passed(hours > 0.0))


def _content(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    first = _sensors_first(data)
    requirement = "all indicators of table 1 measured"
    if measured.indicators_measured is None:
        return [first, missing("5.2", requirement, "8 of 8", "count of measured indicators")]
    n = measured.indicators_measured
    return [
        first,
        row("5.2", requirement, f"{n} of {_INDICATORS}", "8 of 8", "pass" if n == _INDICATORS else "warning"),
    ]


def _instruments(data: CampaignData) -> list[Row]:
    def unused(name: str, limit: str) -> Row:
        return row("5.3", name, "not used in this campaign", limit, "not_applicable")

    sphere = has_sphere(data)
    rows = [sphere_row("5.3", data) if sphere else unused("integrating sphere", "traceable, third class or better")]
    flatness = worst_flatness(data)
    name, limit = "reference panels", "flatness better than 5 %; BaSO4, PTFE or water-based paint"
    if flatness is None:
        rows.append(missing("5.3", name, limit, "spectra of the panels"))
    else:
        rows.append(
            row(
                "5.3",
                name,
                f"flatness {percent(flatness[1], 1)} at worst ({flatness[0]})",
                limit,
                passed(flatness[1] < 0.05),
            )
        )
    accuracy = survey_accuracy(data)
    name, limit = "survey of the geometric targets", "better than 1 cm horizontally, 2 cm in height"
    if accuracy is None:
        rows.append(missing("5.3", name, limit, "surveyed frustum target"))
    else:
        horizontal, height = accuracy
        text = f"{horizontal * 1000:.1f} mm horizontally, {height * 1000:.1f} mm in height, at worst"
        rows.append(row("5.3", name, text, limit, passed(horizontal < 0.01 and height < 0.02)))
    if has_ranging(data):
        return rows + station_rows(("5.3", "5.3"), data)
    return [*rows, unused("total station", "10 mm class, 5 mm class for relative true values")]


def _datum(data: CampaignData) -> list[Row]:
    m = data.manifest
    plane = m.projection_epsg in _CGCS2000_ZONES
    height = m.height_epsg == _HEIGHT_1985
    # The clause asks for the region's own datum and prefers CGCS2000 and 1985: another one is not a failure by itself.
    beijing = m.start_time.endswith("+08:00")
    return [
        row(
            "5.4 a",
            "plane coordinates in the region's system, tied to CGCS2000 where possible",
            f"EPSG:{m.projection_epsg}",
            "CGCS2000 3-degree zone (EPSG:4513-4554)",
            "pass" if plane else "warning",
        ),
        row(
            "5.4 a",
            "heights in the region's system, tied to the 1985 datum where possible",
            f"EPSG:{m.height_epsg}",
            "1985 national height datum (EPSG:5737)",
            "pass" if height else "warning",
        ),
        row("5.4 b", "dates of the Common Era, Beijing time", m.start_time, "UTC+08:00", passed(beijing)),
    ]


def _brightness(measured: ConformityInputs) -> Row:
    requirement, limit = "mean image brightness (HSV V) of the reference panels", "30 % to 80 %"
    values = measured.panel_brightness
    if not values:
        return missing("5.5 a", requirement, limit, "brightness of the panels")
    mean = float(np.mean(list(values.values())))
    low, high = min(values, key=values.__getitem__), max(values, key=values.__getitem__)
    text = f"{percent(mean, 1)} over {len(values)} panels"
    text += f", from {percent(values[low], 0)} ({low}) to {percent(values[high], 0)} ({high})"
    if measured.panel_brightness_linear:
        text += f"; linear {percent(float(np.mean(list(measured.panel_brightness_linear.values()))), 1)}"
    if measured.panel_clipped_share:
        clipped = {k: v for k, v in measured.panel_clipped_share.items() if v > 0.0}
        text += f"; clipped pixels on {len(clipped)} panels" if clipped else "; no clipped pixel"
        if clipped:
            worst = max(clipped, key=clipped.__getitem__)
            text += f" (up to {percent(clipped[worst], 1)}, {worst})"
    return row("5.5 a", requirement, text, limit, passed(_BRIGHTNESS[0] <= mean <= _BRIGHTNESS[1]))


def _points(data: CampaignData, measured: ConformityInputs) -> Row:
    requirement, limit = "LiDAR points on each reference panel", "more than 100"
    panels = [t.id for t in data.targets if t.kind == "panel"]
    if not measured.panel_points or not panels:
        return missing("5.5 b", requirement, limit, "LiDAR points on panels")
    counts = {p: measured.panel_points.get(p, 0) for p in panels}
    least = min(counts, key=counts.__getitem__)
    few = sum(c <= _POINTS for c in counts.values())
    text = f"least {counts[least]} ({least}), all sorties; {few} of {len(counts)} panels at or below 100"
    for sortie, by_panel in sorted(measured.panel_points_by_sortie.items()):
        text += f"; sortie {sortie}: least {min(by_panel.get(p, 0) for p in panels)}"
    return row("5.5 b", requirement, text, limit, passed(few == 0))


def clause_5(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    """Rows of clause 5."""
    return [
        *_content(data, measured),
        *_instruments(data),
        *_datum(data),
        _brightness(measured),
        _points(data, measured),
    ]
