"""From the ranging line's records to ranges: both total stations, every scan, and what of them cannot serve.

Formulas (9)-(15) and the indicator are in `evaluator.c9_1_lidar_ranging`.
"""

from dataclasses import dataclass, field

import numpy as np

from campaign.benches.ranging import RangingLine
from campaign.errors import TestrangeError
from campaign.progress import Report
from evaluator.benches.bench_model import PanelRange
from evaluator.benches.total_station import CLASS_MM, StationResult, readings_of, stations_of
from evaluator.load import in_folder
from evaluator.model import CampaignData, EvaluationError
from evaluator.observe.ranging_panels import LEAST_STD_M, RangedPanel, WantedPanel, panels_in_scan

MIN_OBSERVATIONS = 5  # 9.1.2 c, f
FULL_OVER_FWHM = 1.699  # of a Gaussian beam: width at 1/e2 over width at half maximum
BESIDE_SHARE = 0.12  # of a panel's size: centres found and predicted agree far better when the angles are right


@dataclass(kw_only=True)
class Found:
    """What the scans and the stations gave."""

    ranged: dict[str, list[RangedPanel]] = field(default_factory=dict)
    misses: dict[str, list[str]] = field(default_factory=dict)  # panel -> one line for each scan without it
    notes: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)  # readings, stations and scans that do not serve
    scans: int = 0  # independent ones
    same_scans: list[str] = field(default_factory=list)  # one line for each that repeats another
    beside: tuple[float, str] = (
        0.0,
        "",
    )  # greatest distance from where the angles put a panel, over its size; the panel
    duration_s: list[float] = field(default_factory=list)


def unread(data: CampaignData, name: str) -> str | None:
    """Why a record could not be read, if it stands in the folder."""
    return next((text for text in data.problems if text.startswith(name)), None)


def station_of(data: CampaignData, line: RangingLine, serves: str, found: Found) -> StationResult:
    step = {"correction": "9.1.2 c", "reference": "9.1.2 k"}[serves]
    station = stations_of(line, data.ranging.readings).get(serves)
    if station is None:
        raise EvaluationError(f"no total station of ranging/line.json serves {serves!r} ({step})")
    result, left_out = readings_of(line, data.ranging.readings, station)
    found.left_out += [text for text in left_out if text not in found.left_out]
    if not result.panels:
        raise EvaluationError(
            f"no usable reading of {result.station.name}, which serves {serves!r} ({step})",
            got=left_out[0] if left_out else "no row",
        )
    if result.station.class_mm > CLASS_MM[serves]:
        found.notes.append(
            f"{result.station.name} is of the {result.station.class_mm:g} mm class, {step} asks for {CLASS_MM[serves]:g} mm"
        )
    return result


def observe_scans(
    data: CampaignData,
    line: RangingLine,
    correction: StationResult,
    reference: StationResult,
    found: Found,
    progress: Report,
) -> None:
    """Every scan; those that cannot serve are named."""
    wanted = []
    for panel in line.panels:
        sighted = reference.of(panel.id) or correction.of(panel.id)
        if sighted is not None:
            wanted.append(WantedPanel(id=panel.id, size_m=panel.size_m, place_m=sighted.place_m))
    if len(wanted) < 3:
        raise EvaluationError("fewer than three panels have a total station's distance", got=len(wanted))
    divergence = None
    if data.lidar is not None:
        wider = FULL_OVER_FWHM if data.lidar.divergence_definition == "fwhm" else 1.0
        divergence = wider * data.lidar.divergence_rad
    unit = data.lidar.amplitude_unit if data.lidar else "linear"
    reasons = []
    seen: dict[tuple[tuple[str, float, int, float], ...], str] = {}
    progress("ranging", 0, len(data.ranging.scans))
    for done, (_, path) in enumerate(data.ranging.scans, start=1):
        try:
            scan = panels_in_scan(path, wanted, divergence, unit)
            content = tuple((name, r.range_m, r.points, r.rms_m) for name, r in sorted(scan.panels.items()))
            if content in seen:
                found.same_scans.append(
                    f"{path.name} holds the same points as {seen[content]}: no independent observation, left out"
                )
                continue
            seen[content] = path.name
            found.scans += 1
            found.duration_s += [scan.duration_s] if scan.duration_s is not None else []
            for name, ranged in scan.panels.items():
                found.ranged.setdefault(name, []).append(ranged)
            for name, why in scan.not_found.items():
                found.misses.setdefault(name, []).append(f"{path.name}: {why}")
        except TestrangeError as error:
            text = in_folder(error, data.folder.root)
            reasons.append(text if path.name in text else f"{path.name}: {text}")
        finally:
            progress("ranging", done, len(data.ranging.scans))
    found.left_out += reasons
    found.notes += found.same_scans
    if not found.scans:
        raise EvaluationError("no scan of the ranging line can be used", got=reasons[0])


def panel_ranges(
    line: RangingLine, correction: StationResult, reference: StationResult, found: Found
) -> tuple[list[PanelRange], dict[str, str]]:
    """Panels seen by the LiDAR, and why the others are not used."""
    panels, not_used = [], {}
    beside: list[tuple[float, str]] = []
    for name, size_m in ((p.id, p.size_m) for p in line.panels):
        by_correction, by_reference, ranged = correction.of(name), reference.of(name), found.ranged.get(name, [])
        counts = {
            f"readings of {correction.station.name}": by_correction.readings if by_correction else 0,
            f"readings of {reference.station.name}": by_reference.readings if by_reference else 0,
            "scans": len(ranged),
        }
        if not ranged:
            not_used[name] = found.misses.get(name, ["no total station's distance to look for it"])[0]
            continue
        absent = [what for what, count in counts.items() if count == 0]
        if absent:
            not_used[name] = f"no {absent[0]}"
        else:
            found.notes += [
                f"{name}: {count} {what}, 9.1.2 asks for {MIN_OBSERVATIONS}"
                for what, count in counts.items()
                if count < MIN_OBSERVATIONS
            ]
        beside.append((float(np.mean([r.miss_m for r in ranged])) / size_m, name))
        ranges = np.array([r.range_m for r in ranged])
        panels.append(
            PanelRange(
                panel=name,
                lidar_m=float(ranges.mean()),
                lidar_std_m=float(ranges.std(ddof=1)) if len(ranges) > 1 else float(np.sqrt(ranged[0].variance_m2)),
                scans=len(ranges),
                correction_m=by_correction.distance_m if by_correction else None,
                reference_m=by_reference.distance_m if by_reference else None,
                correction_readings=by_correction.readings if by_correction else 0,
                reference_readings=by_reference.readings if by_reference else 0,
                points=sum(r.points for r in ranged),
            )
        )
    share, name = found.beside = max(beside, default=(0.0, ""))
    if share > BESIDE_SHARE:
        found.notes.append(
            f"{name} is found {100.0 * share:.0f} % of its size beside where the total station's angles put it: are they "
            "degrees, clockwise from the frame's y, and the eccentricity in the same frame?"
        )
    return panels, not_used


def lidar_covariance_m2(names: list[str], found: Found) -> tuple[np.ndarray, float, int]:
    """(n, n) of the means over the scans; the plane fits' own variance, scaled by the scatter from scan to scan."""
    formal = [np.mean([r.variance_m2 for r in found.ranged[name]]) for name in names]
    squares, freedom = 0.0, 0
    for name, variance in zip(names, formal, strict=True):
        ranges = np.array([r.range_m for r in found.ranged[name]])
        squares += float(np.sum((ranges - ranges.mean()) ** 2)) / float(variance)
        freedom += len(ranges) - 1
    scale = squares / freedom if freedom >= 4 else 1.0
    counts = np.array([len(found.ranged[name]) for name in names])
    return np.diag(np.maximum(scale * np.asarray(formal), LEAST_STD_M**2) / counts), scale, freedom
