"""One configuration in, one `Plan` out: the flight on paper, the evaluator's own conformity rows on it, physics. No file is kept.

What the observations will tell is predicted (points, brightness, targets in images) and handed to the evaluator's rows in the
place of measurements; what cannot be predicted stays "after the flight".
"""

import re
import tempfile
from collections import Counter
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from campaign.config import Config
from campaign.errors import ConfigError, TestrangeError
from campaign.threads import one_blas_thread
from evaluator.conformity import ConformityInputs, Row, conformity_rows
from evaluator.conformity.flight import flight_times, sun_elevation
from evaluator.coverage import targets_in_images
from evaluator.georeference import nominal_mountings
from evaluator.model import CampaignData, MarkObservation, VertexObservation
from evaluator.mounting.geometry import build_problem, observe_vertices
from evaluator.mounting.helping_strip import predicted_covariance, weak_parameters
from evaluator.mounting.mounting_model import System
from evaluator.mounting.panel_planes import observe_planes
from evaluator.observe.panels import LidarPanelObservation, lidar_panel_observations
from simulator.flight.plan import design_lines, speeds_m_s
from simulator.lidar.radar_equation import unambiguous_range_m
from simulator.lidar.scanner import scanner_from
from simulator.times import BEIJING, gps_time_from_iso
from testrange.plan import light as camera_side
from testrange.plan.beams import Passes, cast_passes
from testrange.plan.benches import set_up_rows
from testrange.plan.model import (
    CONFIGURATION,
    Accuracy,
    Exposure,
    PanelLight,
    Plan,
    PlanRow,
    PlanStatus,
    SortieFigures,
    TargetPoints,
)
from testrange.plan.physics import ground_slant_m, physics_rows
from testrange.plan.rehearsal import Rehearsal, flies, paper_without_flight, rehearse
from testrange.plan.remedies import remedy
from testrange.plan.volume import expected_volume

COLLECT_MARGIN_M = 1.4  # as in evaluator.evaluate: round a target's own radius
LEAST_SUN_DEG, MOST_CHANGE_DEG = 35.0, 20.0  # 7.2 c
# Rows that only the campaign's own records and pictures can fill.
_AFTER = ("5.2", "5.5", "6.3.2 f", "8.2.2", "8.3.2 c", "9.1.2", "9.2.2", "9.3.2 c")
_CLAUSE = re.compile(r"\((\d+\.\d+(?:\.\d+)*(?: [a-z])?)\)")


@one_blas_thread()
def plan_campaign(config: Config) -> Plan:
    """Everything that can be said of a campaign before it is flown or rendered; takes seconds and keeps no file.

    Parameters
    ----------
    config : Config

    Returns
    -------
    Plan
        `refusal` is not None where a row fails. A configuration that cannot be built is a failing row of its own.
    """
    with tempfile.TemporaryDirectory(prefix="testrange-plan-") as folder:
        try:
            return _planned(rehearse(config, Path(folder)))
        except ConfigError as error:
            return _unbuilt(config, error)


def _unbuilt(config: Config, error: ConfigError) -> Plan:
    """A plan of what is known although the configuration cannot be built: the sun, ranges, and why."""
    named = _CLAUSE.search(str(error))
    start_s = gps_time_from_iso(config.campaign.start_time)
    rows: list[PlanRow] = []
    window: tuple[tuple[str, str], ...] = ()
    elevation: tuple[float, float] | None = None
    if flies(config):
        data = paper_without_flight(config)
        window = _sun_window(config, data, start_s, start_s)
        at_start = float(sun_elevation(data, np.array([start_s]))[0])
        elevation = (at_start, at_start)
        rows.append(
            _plan_row(
                config,
                Row(
                    clause="7.2 c",
                    requirement="elevation of the sun",
                    measured=f"{at_start:.1f}° as the first strip begins",
                    limit="> 35°",
                    status="pass" if at_start > LEAST_SUN_DEG else "fail",
                ),
                window,
            )
        )
    rows += physics_rows(config, None, None, ())
    rows.append(
        PlanRow(
            clause=named.group(1) if named else CONFIGURATION,
            requirement="the campaign can be built as configured",
            planned=str(error),
            limit="",
            status="fail",
        )
    )
    return Plan(
        campaign=config.campaign.id,
        title=config.campaign.title,
        start_time=config.campaign.start_time,
        date=_start(config).date().isoformat(),
        duration_s=None,
        sun_window=window,
        sun_elevation_deg=elevation,
        rows=tuple(rows),
        longest_range_m=ground_slant_m(config),
        unambiguous_range_m=_unambiguous_m(config),
    )


def _start(config: Config) -> datetime:
    return datetime.fromisoformat(config.campaign.start_time).astimezone(BEIJING)


def _unambiguous_m(config: Config) -> float | None:
    try:
        return unambiguous_range_m(scanner_from(config.lidar).pulse_interval_s)
    except ConfigError:
        return None


def _planned(rehearsal: Rehearsal) -> Plan:
    config, data = rehearsal.config, rehearsal.data
    passes: Passes | None = None
    panels: list[LidarPanelObservation] = []
    vertices: list[VertexObservation] = []
    reasons: dict[str, str] = {}
    if rehearsal.sorties and "lidar" in config.campaign.parts:
        radius = max((t.size_m for t in data.targets), default=0.0) / float(np.sqrt(2.0)) + COLLECT_MARGIN_M
        passes = cast_passes(rehearsal, radius)
        assert data.rig is not None
        lidar = nominal_mountings(data.rig)[1]
        panels = lidar_panel_observations(data, passes.returns, lidar)
        vertices, reasons = observe_vertices(data, passes.returns, lidar, located=True)
    marks = camera_side.expected_marks(data) if rehearsal.exposing is not None else []
    light = camera_side.panel_lights(rehearsal, passes.amplitude_dn if passes else {})
    measured = _predicted(rehearsal, passes, panels, vertices, marks, light)
    times = flight_times(data, measured)
    window = _sun_window(config, data, float(times[0]), float(times[-1])) if times.size else ()
    elevation = sun_elevation(data, times) if times.size else times
    set_up = set_up_rows(config, data, measured, rehearsal.line)
    found = [set_up.get((row.clause, row.requirement), row) for row in conformity_rows(data, measured)]
    rows = [_plan_row(config, row, window) for row in found]
    if passes is not None and any(t.kind == "frustum" for t in data.targets):
        first = next(k for k, row in enumerate(rows) if row.clause.startswith("9.3.2"))
        rows.insert(first, _faces_row(rehearsal, passes, vertices, reasons))
    accuracy, accuracy_reason = _accuracy(rehearsal, passes, marks, vertices)
    return Plan(
        campaign=config.campaign.id,
        title=config.campaign.title,
        start_time=config.campaign.start_time,
        date=_start(config).date().isoformat(),
        duration_s=data.plan.duration_s if data.plan else None,
        sun_window=window,
        sun_elevation_deg=(float(elevation.min()), float(elevation.max())) if elevation.size else None,
        rows=(*rows, *physics_rows(config, rehearsal, passes, light)),
        sorties=_sortie_figures(rehearsal),
        points=_target_points(rehearsal, passes, panels, vertices),
        light=light,
        exposure=_exposure(rehearsal),
        longest_range_m=passes.longest_range_m if passes else None,
        unambiguous_range_m=_unambiguous_m(config) if passes else None,
        volume=expected_volume(rehearsal, passes),
        accuracy=accuracy,
        accuracy_reason=accuracy_reason,
    )


# ------------------------------------------------------------------------------------------------------------- conformity


def _predicted(
    rehearsal: Rehearsal,
    passes: Passes | None,
    panels: list[LidarPanelObservation],
    vertices: list[VertexObservation],
    marks: list[MarkObservation],
    light: tuple[PanelLight, ...],
) -> ConformityInputs:
    """What the observations are expected to tell."""
    data, config = rehearsal.data, rehearsal.config
    if not rehearsal.sorties or data.rig is None:
        return ConformityInputs(indicators_measured=_indicators(config))
    points: dict[str, int] = {}
    by_sortie: dict[int, dict[str, int]] = {}
    for o in panels:
        points[o.panel] = points.get(o.panel, 0) + o.points
        mine = by_sortie.setdefault(o.sortie, {})
        mine[o.panel] = mine.get(o.panel, 0) + o.points
    with_vertex, with_mark = {v.target for v in vertices}, {m.target for m in marks}
    camera = rehearsal.exposing is not None
    return ConformityInputs(
        panel_points=points,
        panel_points_by_sortie=by_sortie,
        panel_brightness={p.panel: p.brightness for p in light},
        panel_brightness_linear={p.panel: max(p.dn) / p.full_scale_dn for p in light},
        panel_clipped_share={p.panel: float(max(p.dn) >= p.full_scale_dn) for p in light},
        targets_in_image=targets_in_images(data, nominal_mountings(data.rig)[0]) if camera else {},
        scan_interval_s=passes.scan_interval_s if passes else {},
        strip_window_s=passes.strip_window_s if passes else {},
        frustum_vertices=len(with_vertex) if passes else None,
        frustum_marks=len(with_mark) if camera else None,
        frustums_used=len(with_vertex & with_mark) if passes and camera else None,
        indicators_measured=_indicators(config),
    )


def _indicators(config: Config) -> int:
    """How many of the eight a campaign of these parts can measure."""
    parts = set(config.campaign.parts)
    return 3 * ("bench" in parts) + ("ranging" in parts) + ("lidar" in parts) + 3 * ({"camera", "lidar"} <= parts)


def _plan_row(config: Config, row: Row, window: tuple[tuple[str, str], ...]) -> PlanRow:
    after = row.status == "not_recorded" and row.clause.startswith(_AFTER)
    return PlanRow(
        clause=row.clause,
        requirement=row.requirement,
        planned="" if after else row.measured,
        limit=row.limit,
        status="after" if after else row.status,
        remedy=remedy(config, row.clause, row.requirement, window) if row.status == "fail" else "",
    )


def _faces_row(
    rehearsal: Rehearsal, passes: Passes, vertices: list[VertexObservation], reasons: dict[str, str]
) -> PlanRow:
    """Whether the faces of the frustums get enough points for planes (6.2.2 c-d, 9.3.2 d)."""
    frustums = [t.id for t in rehearsal.data.targets if t.kind == "frustum"]
    strips = len(passes.pulses)
    found = {v.target for v in vertices}
    text = f"{len(found)} of {len(frustums)} targets, {len(vertices)} of {len(frustums) * strips} passes give a vertex"
    if passes.faces:
        least = min(passes.faces, key=lambda key: int(passes.faces[key].min()))
        mean = float(np.mean([c.mean() for c in passes.faces.values()]))
        text += f"; {mean:.0f} points on a face on average, {passes.faces[least].min()} at least"
        text += f" ({least[2]}, sortie {least[0]} strip {least[1]})"
    if reasons:
        kind, number = Counter(map(_kind, reasons.values())).most_common(1)[0]
        example = next(line for line in reasons.values() if _kind(line) == kind)
        text += f"; {number} passes: {example}"
    needed = min(len(frustums), 20)
    status: PlanStatus = "fail" if len(found) < needed else "warning" if len(found) < len(frustums) else "pass"
    return PlanRow(
        clause="9.3.2 d",
        requirement="faces of the frustums (6.2.2 c, d) measured as planes that meet in a vertex",
        planned=text,
        limit=f"three faces with 6 clean points or more, of {needed} targets or more",
        status=status,
        remedy=remedy(rehearsal.config, "9.3.2 d", "", ()) if status == "fail" else "",
    )


def _kind(reason: str) -> str:
    """A reason without its figures."""
    return re.sub(r"[\d.]+", "#", reason)


def _sun_window(config: Config, data: CampaignData, first_s: float, last_s: float) -> tuple[tuple[str, str], ...]:
    """Beijing times at which the first strip may begin so that the whole flight keeps 7.2 c on the planned date."""
    start_s = gps_time_from_iso(config.campaign.start_time)
    midnight = _start(config).replace(hour=0, minute=0, second=0, microsecond=0)
    minutes = np.arange(24 * 60)
    begin = gps_time_from_iso(midnight.isoformat()) + 60.0 * minutes
    span = np.linspace(first_s - start_s, last_s - start_s, 2 + int((last_s - first_s) // 600.0))
    elevation = sun_elevation(data, (begin[:, None] + span).ravel()).reshape(len(begin), len(span))
    legal = (elevation.min(axis=1) > LEAST_SUN_DEG) & (np.ptp(elevation, axis=1) <= MOST_CHANGE_DEG)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], legal, [False]]).astype(int)))
    return tuple(
        (_clock(midnight, int(minutes[a])), _clock(midnight, int(minutes[b - 1]))) for a, b in edges.reshape(-1, 2)
    )


def _clock(midnight: datetime, minutes: int) -> str:
    return (midnight + timedelta(minutes=minutes)).strftime("%H:%M")


# ------------------------------------------------------------------------------------------------------------- figures


def _sortie_figures(rehearsal: Rehearsal) -> tuple[SortieFigures, ...]:
    config = rehearsal.config
    flight, scanner = config.flight, config.lidar.scanner
    has_lidar = "lidar" in config.campaign.parts
    if not rehearsal.sorties:  # benches or a ranging line alone: the configured heights are not flown
        return ()
    found = []
    for sortie, height, speed in zip(rehearsal.sorties, flight.heights_m, speeds_m_s(config), strict=True):
        gsd = footprint = blur = turning = forward = side = None
        lines = design_lines(config, rehearsal.scene.layout, height)
        if rehearsal.exposing is not None:
            gsd, footprint = camera_side.ground_resolution_m(config, height)
            blur = camera_side.blur_px(config, height, speed, rehearsal.exposing.exposure_time_s)
            turning = camera_side.attitude_blur_px(config, sortie, rehearsal.exposing.exposure_time_s)
            if flight.images_per_strip > 1:
                forward = camera_side.overlap(flight.image_spacing_m, footprint[1])
        swath = density = None
        line_spacing = pulse_spacing = spot = None
        if has_lidar:
            low, high = (np.radians(np.clip(v, -80.0, 80.0)) for v in scanner.sector_deg)
            swath = float(height * (np.tan(high) - np.tan(low)))
            step = 2.0 * np.pi * scanner.turn_share * scanner.scan_rate_hz / config.lidar.prr_hz
            line_spacing, pulse_spacing = speed / scanner.scan_rate_hz, float(height * step)
            density = 1.0 / (line_spacing * pulse_spacing)
            spot = config.lidar.divergence_rad * height
        extent = footprint[0] if footprint else swath
        if flight.strips_per_heading > 1 and extent:
            apart = float(np.linalg.norm(lines[1].start_m - lines[0].start_m))
            side = camera_side.overlap(apart, extent)
        found.append(
            SortieFigures(
                sortie=sortie.number,
                height_m=height,
                speed_m_s=speed,
                duration_s=float(np.ptp(sortie.motion.gps_time_s)),
                strips=len(sortie.strips),
                images=sum(len(s.exposure_s) for s in sortie.strips) if rehearsal.exposing is not None else 0,
                gsd_m=gsd,
                footprint_m=footprint,
                blur_px=blur,
                blur_attitude_px=turning,
                forward_overlap=forward,
                side_overlap=side,
                swath_m=swath,
                points_per_m2=density,
                line_spacing_m=line_spacing,
                pulse_spacing_m=pulse_spacing,
                beam_footprint_m=spot,
            )
        )
    return tuple(found)


def _target_points(
    rehearsal: Rehearsal,
    passes: Passes | None,
    panels: list[LidarPanelObservation],
    vertices: list[VertexObservation],
) -> tuple[TargetPoints, ...]:
    if passes is None:
        return ()
    found = []
    for sortie in rehearsal.sorties:
        for target in rehearsal.data.targets:
            if target.kind == "panel":
                mine = [o.points for o in panels if (o.panel, o.sortie) == (target.id, sortie.number)]
                found.append(
                    TargetPoints(
                        target=target.id, kind="panel", sortie=sortie.number, points=sum(mine), strips=len(mine)
                    )
                )
            elif target.kind == "frustum":
                used = [v.points for v in vertices if (v.target, v.sortie) == (target.id, sortie.number)]
                on = [n for key, n in passes.faces.items() if (key[0], key[2]) == (sortie.number, target.id)]
                found.append(
                    TargetPoints(
                        target=target.id,
                        kind="frustum",
                        sortie=sortie.number,
                        points=sum(used),
                        faces=tuple(int(n) for n in np.min(on, axis=0)) if on else (0, 0, 0, 0),
                        strips=len(used),
                    )
                )
    return tuple(found)


def _exposure(rehearsal: Rehearsal) -> Exposure | None:
    if rehearsal.exposing is None:
        return None
    return Exposure(
        exposure_time_s=rehearsal.exposing.exposure_time_s,
        gain_e_per_dn=rehearsal.exposing.e_per_dn,
        configured_exposure_time_s=rehearsal.config.camera.exposure_time_s,
    )


def _accuracy(
    rehearsal: Rehearsal, passes: Passes | None, marks: list[MarkObservation], vertices: list[VertexObservation]
) -> tuple[Accuracy | None, str | None]:
    """What the adjustment of 9.3 can reach with these observations: its covariance at the drawing's mountings."""
    if not marks or not vertices or passes is None or rehearsal.data.rig is None:
        return None, "no marks in images" if vertices else "no vertex of a frustum"
    try:
        planes = observe_planes(rehearsal.data, passes.returns, nominal_mountings(rehearsal.data.rig)[1]).planes
        problem = build_problem(rehearsal.data, marks, vertices, planes)
        system = System(problem)
        covariance = predicted_covariance(problem, np.zeros(system.count))
    except TestrangeError as error:
        return None, str(error)
    std = np.sqrt(np.diag(covariance))
    scaled = {
        name: float(np.degrees(s) if "boresight" in name else s) for name, s in zip(system.names, std, strict=True)
    }
    weak = weak_parameters(system.names, covariance, system.prior_std)
    lines = tuple(f"{name}: correlation {rho:+.2f} with {partner}" for name, (_, partner, rho) in weak.items())
    return Accuracy(std=scaled, weak=lines), None
