"""Facts that only the observations tell, gathered for the rows: points and brightness of panels, spans of strips, who picked."""

from collections.abc import Mapping, Sequence

import numpy as np

from evaluator.conformity.model import ConformityInputs
from evaluator.coverage import targets_in_images
from evaluator.georeference import TargetReturns
from evaluator.model import CampaignData, MarkObservation, Mounting
from evaluator.mounting.geometry import GeometryResult
from evaluator.observe.panels import ImagePanelObservation, LidarPanelObservation


def observed_inputs(
    data: CampaignData,
    *,
    marks: Sequence[MarkObservation],
    panels: Sequence[ImagePanelObservation],
    brightness: Mapping[str, Sequence[float]],
    geometry: GeometryResult | None,
    lidar_panels: Sequence[LidarPanelObservation],
    returns: Mapping[tuple[int, int, str], TargetReturns],
    camera: Mounting | None,
    indicators_measured: int,
) -> ConformityInputs:
    """All of them; `brightness`: HSV V of each panel, an image each."""
    points: dict[str, int] = {}
    by_sortie: dict[int, dict[str, int]] = {}
    for o in lidar_panels:
        points[o.panel] = points.get(o.panel, 0) + o.points
        mine = by_sortie.setdefault(o.sortie, {})
        mine[o.panel] = mine.get(o.panel, 0) + o.points
    linear: dict[str, list[float]] = {}
    clipped: dict[str, list[float]] = {}
    if data.camera is not None:
        full = 2.0**data.camera.bit_depth - 1.0 - data.camera.black_level_dn
        for v in panels:
            linear.setdefault(v.panel, []).append(max(v.mean_dn) / full)
            clipped.setdefault(v.panel, []).append(max(v.clipped_share))
    used = {m.target for m in marks} & {v.target for v in (geometry.vertices if geometry else ())}
    return ConformityInputs(
        panel_points=points,
        panel_points_by_sortie=by_sortie,
        panel_brightness={k: float(np.mean(v)) for k, v in brightness.items()},
        panel_brightness_linear={k: float(np.mean(v)) for k, v in linear.items()},
        panel_clipped_share={k: float(np.max(v)) for k, v in clipped.items()},
        targets_in_image=targets_in_images(data, camera),
        scan_interval_s=_scan_intervals(returns),
        strip_window_s=_strip_windows(returns),
        frustum_vertices=len({v.target for v in geometry.vertices}) if geometry else None,
        frustum_marks=len({m.target for m in marks}) if data.camera is not None else None,
        frustums_used=len(used) if geometry else None,
        panels_picked_by=_picked_by(panels),
        frustums_picked_by=_picked_by(marks),
        indicators_measured=indicators_measured,
    )


def _picked_by(found: Sequence[MarkObservation | ImagePanelObservation]) -> str | None:
    if not found:
        return None
    return "person" if any(o.picked_by == "person" for o in found) else "evaluator"


def _scan_intervals(returns: Mapping[tuple[int, int, str], TargetReturns]) -> dict[tuple[int, int], float]:
    """Seconds from the first to the last target scanned, by each target's mean time, for strips that saw two or more."""
    times: dict[tuple[int, int], list[float]] = {}
    for (sortie, strip, _), rows in returns.items():
        times.setdefault((sortie, strip), []).append(float(rows.returns.gps_time_s.mean()))
    return {key: max(t) - min(t) for key, t in sorted(times.items()) if len(t) > 1}


def _strip_windows(returns: Mapping[tuple[int, int, str], TargetReturns]) -> dict[tuple[int, int], tuple[float, float]]:
    """From the first to the last return near any target: the part of the strip over the range."""
    windows: dict[tuple[int, int], tuple[float, float]] = {}
    for (sortie, strip, _), rows in returns.items():
        low, high = windows.get((sortie, strip), (np.inf, -np.inf))
        time = rows.returns.gps_time_s
        windows[sortie, strip] = (min(low, float(time.min())), max(high, float(time.max())))
    return dict(sorted(windows.items()))
