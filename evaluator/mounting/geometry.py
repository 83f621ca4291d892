"""From a campaign as read to both mountings: vertices and planes of every strip, marks of every image, the joint adjustment.

The order of 9.3.2 c-i, nothing else: finding and solving live in `observe` and `adjustment`, the indicator in `c9_3_calibration`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from campaign.config import Lens
from campaign.flight.records import CameraObservation, Exposure
from campaign.sensors import CameraSheet
from campaign.survey import SurveyedTarget
from evaluator.algorithms.record import OWN_TOOLS, Tools
from evaluator.algorithms.slots import AlgorithmFailure, MarkTask
from evaluator.algorithms.solvers import Solve, mountings_solver
from evaluator.camera_model import camera_points, project_exposure, project_with_jacobian, row_time
from evaluator.frames import WorldFrame, body_pose
from evaluator.georeference import TargetReturns, corrected_points, lidar_points, nominal_mountings
from evaluator.model import (
    CampaignData,
    EvaluationError,
    MarkObservation,
    Mounting,
    MountingSolution,
    PlaneObservation,
    SortieData,
    VertexObservation,
)
from evaluator.mounting.adjustment import solve_mountings
from evaluator.mounting.blunders import describe_exchange, exchanged
from evaluator.mounting.mounting_model import Problem, SurveyedMark
from evaluator.mounting.panel_planes import PlanesFound, contradiction, observe_planes, surveyed_panels
from evaluator.observe.frustums import FrustumModel, find_vertex, frustum_model
from evaluator.observe.mark_view import MarkView, mark_radius_px
from evaluator.observe.target_view import sheet_corners, to_sun

_HAND_STD_PX = 0.5  # of a pixel that a person picked
_WIDEST_SEARCH_PX = 120.0


def frustums(data: CampaignData) -> tuple[SurveyedTarget, ...]:
    """The frustum targets of the survey."""
    return tuple(t for t in data.targets if t.kind == "frustum")


def search_radius_px(data: CampaignData, height_m: float) -> float:
    """How far a mark may lie from its nominal prediction: one prior standard deviation of the camera's mounting, at most
    0.8 m on the ground, so that a neighbouring target stays outside."""
    if data.rig is None or data.camera is None:
        raise EvaluationError("no sensors/rig.json or sensors/camera.json")
    focal = data.camera.nominal_focal_length_mm * 1000.0 / data.camera.pixel_size_um
    angle = np.radians(data.rig.camera.boresight_std_deg) + data.rig.camera.lever_arm_std_m / max(height_m, 1.0)
    return float(np.clip(focal * min(angle, 0.8 / max(height_m, 1.0)), 15.0, _WIDEST_SEARCH_PX))


def observe_vertices(
    data: CampaignData,
    returns: Mapping[tuple[int, int, str], TargetReturns],
    body_from_lidar: Mounting,
    *,
    located: bool = False,
    tools: Tools = OWN_TOOLS,
) -> tuple[list[VertexObservation], dict[str, str]]:
    """Vertices of every frustum target and strip (9.3.2 d).

    Parameters
    ----------
    data : CampaignData
    returns : mapping
        (sortie, strip, target) -> returns about the target, from `georeference.collect_target_returns`.
    body_from_lidar : Mounting
        Approximate; see `observe.frustums.find_vertex`.
    located : bool
        The mounting comes from an adjustment.
    tools : Tools
        `vertex_estimation` is used.

    Returns
    -------
    vertices : list of VertexObservation
    reasons : dict
        "target, sortie n, strip n" -> why there is no vertex.
    """
    if data.rig is None or data.lidar is None:
        raise EvaluationError(
            "no sensors/rig.json or sensors/lidar.json: the LiDAR's own coordinates cannot be recovered"
        )
    world_frame = WorldFrame(data.manifest)
    models = {t.id: frustum_model(t, world_frame) for t in frustums(data)}
    trajectories = {s.folder.number: s.trajectory for s in data.sorties}
    found: list[VertexObservation] = []
    reasons: dict[str, str] = {}
    for sortie, strip, target in sorted(returns):
        trajectory = trajectories.get(sortie)
        if target not in models or trajectory is None:
            continue
        rows = returns[sortie, strip, target].returns
        inside = (rows.gps_time_s >= trajectory.gps_time_s[0]) & (rows.gps_time_s <= trajectory.gps_time_s[-1])
        time = rows.gps_time_s[inside]
        points = lidar_points(rows.xyz_m[inside], time, trajectory, data.rig, world_frame)
        vertex: VertexObservation | str
        try:
            vertex = find_vertex(
                corrected_points(points, data.range_correction),
                time,
                rows.number_of_returns[inside] <= 1,
                model=models[target],
                trajectory=trajectory,
                mounting=body_from_lidar,
                world_frame=world_frame,
                lidar=data.lidar,
                sortie=sortie,
                strip=strip,
                located=located,
                estimate=tools.vertex_estimation,
            )
        except AlgorithmFailure as error:
            vertex = str(error)
        if isinstance(vertex, VertexObservation):
            found.append(vertex)
        else:
            reasons[f"{target}, sortie {sortie}, strip {strip}"] = vertex
    return found, reasons


def mark_view(
    model: FrustumModel,
    mark_radius_m: float,
    camera: CameraSheet,
    lens: Lens,
    body_from_camera: Mounting,
    sortie: SortieData,
    exposure: Exposure,
    world_frame: WorldFrame,
) -> MarkView | None:
    """How one mark should look in one image; None when it lies outside the image."""
    if sortie.trajectory is None:
        return None
    axes = model.world_from_target
    mark = model.vertex_world_m
    if not model.inverted:
        mark = mark - model.long_edge_m * np.sqrt(0.5) * axes[:, 2]
    uv, time = project_exposure(
        camera, lens, body_from_camera, sortie.trajectory, exposure.gps_time_s, mark, world_frame
    )
    if not np.all(np.isfinite(uv)) or np.any(uv[0] < 0.0) or np.any(uv[0] > [camera.width_px, camera.height_px]):
        return None
    p = camera_points(body_from_camera, sortie.trajectory, time, mark[None], world_frame)
    _, by_point, _ = project_with_jacobian(lens, p)
    position, world_from_body = body_pose(sortie.trajectory, time, world_frame)
    camera_from_target = body_from_camera.rotation.T @ world_from_body[0].T @ axes
    eye = axes.T @ (position[0] + world_from_body[0] @ body_from_camera.lever_arm_m - mark)
    m = world_frame.manifest
    sun = axes.T @ to_sun(exposure.gps_time_s, float(m.gps_minus_utc_s), m.latitude_deg, m.longitude_deg)
    return MarkView(
        predicted_px=uv[0],
        px_per_m=by_point[0] @ camera_from_target[:, :2],
        radius_m=mark_radius_m,
        sheets_m=sheet_corners(model),
        eye_m=eye,
        to_sun=sun if sun[2] > 0.05 else None,
    )


def mean_band(image: np.ndarray) -> np.ndarray:
    """(h, w, bands) -> (h, w), band by band: five times as fast as a mean over the last axis."""
    total = image[..., 0].astype(np.float32)
    for band in range(1, image.shape[2]):
        total += image[..., band]
    total /= image.shape[2]
    return total


def observe_marks(
    data: CampaignData,
    sortie: SortieData,
    exposure: Exposure,
    image: np.ndarray,
    body_from_camera: Mounting,
    search_px: float,
    picked: Sequence[CameraObservation] = (),
    tools: Tools = OWN_TOOLS,
) -> tuple[list[MarkObservation], dict[str, str]]:
    """Marks of every frustum target in one image (9.3.2 e).

    Parameters
    ----------
    data, sortie, exposure
    image : (h, w) or (h, w, bands) np.ndarray
        Linear DN.
    body_from_camera : Mounting
        Approximate.
    search_px : float
        How far a mark may be from its predicted place. [px]
    picked : sequence of CameraObservation
        Pixels that a person gave: taken where the campaign has them, for the targets they name.
    tools : Tools
        `mark_finding` is used.

    Returns
    -------
    marks : list of MarkObservation
    reasons : dict
        "target, image" -> why there is none; targets outside the image are not listed.
    """
    camera = data.camera
    if camera is None:
        raise EvaluationError("no sensors/camera.json")
    lens = certified_lens(camera)[0]
    world_frame = WorldFrame(data.manifest)
    grey = image if image.ndim == 2 else mean_band(image)
    by_hand = {o.target: np.array([o.u_px, o.v_px]) for o in picked if o.image == exposure.image}
    marks: list[MarkObservation] = []
    reasons: dict[str, str] = {}
    for target in frustums(data):
        radius = target.mark_radius_m
        if target.id in by_hand:
            uv, covariance, radius_px = by_hand[target.id], _HAND_STD_PX**2 * np.eye(2), 0.0
        elif radius is None:
            reasons[f"{target.id}, {exposure.image}"] = "the survey states no mark radius"
            continue
        else:
            model = frustum_model(target, world_frame)
            view = mark_view(model, radius, camera, lens, body_from_camera, sortie, exposure, world_frame)
            if view is None:
                continue
            try:
                found = tools.mark_finding(
                    MarkTask(
                        grey=grey,
                        predicted_px=view.predicted_px,
                        search_radius_px=search_px,
                        px_per_m=view.px_per_m,
                        radius_m=view.radius_m,
                        sheets_m=view.sheets_m,
                        eye_m=view.eye_m,
                        to_sun=view.to_sun,
                        clipped_at=0.995 * (2.0**camera.bit_depth - 1.0),
                    )
                )
            except AlgorithmFailure as error:
                found = str(error)
            if isinstance(found, str):
                reasons[f"{target.id}, {exposure.image}"] = found
                continue
            uv, covariance, radius_px = found.uv_px, found.covariance_px2, mark_radius_px(view)
        marks.append(
            MarkObservation(
                target=target.id,
                sortie=sortie.folder.number,
                strip=exposure.strip,
                image=exposure.image,
                gps_time_s=float(row_time(camera, exposure.gps_time_s, uv[1])),
                uv_px=uv,
                covariance_px2=covariance,
                radius_px=radius_px,
                picked_by="person" if target.id in by_hand else "evaluator",
            )
        )
    return marks, reasons


def certified_lens(camera: CameraSheet) -> tuple[Lens, np.ndarray]:
    """(lens, 9 x 9 covariance) of the certificate; without one the nominal lens, loosely known.

    Raises
    ------
    EvaluationError
        The covariance is not a symmetric 9 x 9 matrix.
    """
    if camera.calibration is None:
        f = camera.nominal_focal_length_mm * 1000.0 / camera.pixel_size_um
        lens = Lens(fx_px=f, fy_px=f, cx_px=0.5 * camera.width_px, cy_px=0.5 * camera.height_px)
        # a P1's nominal focal length is 3 % off; distortions of real mapping lenses
        std = np.array([0.03 * f, 0.03 * f, 20.0, 20.0, 0.1, 0.1, 0.1, 2e-3, 2e-3])
        return lens, np.diag(std**2)
    covariance = np.array(camera.calibration.covariance, dtype=np.float64)
    if covariance.shape != (9, 9) or not np.allclose(covariance, covariance.T):
        raise EvaluationError(
            "the certificate's covariance is wrong",
            where="sensors/camera.json",
            got=f"shape {covariance.shape}",
            expected="a symmetric 9 x 9 matrix",
        )
    return camera.calibration.lens, covariance


def surveyed_marks(data: CampaignData) -> dict[str, SurveyedMark]:
    """Frustum targets' marks in the world frame, with the survey's covariance and the stated vertex offset."""
    world_frame = WorldFrame(data.manifest)
    out = {}
    for t in frustums(data):
        model = frustum_model(t, world_frame)
        place = np.array([t.easting_m, t.northing_m, t.height_m])
        mark = world_frame.world_from_map(place)
        axes = world_frame.world_from_grid(place)
        variance = np.array([t.easting_std_m, t.northing_std_m, t.height_std_m]) ** 2
        out[t.id] = SurveyedMark(
            mark_world_m=mark,
            covariance_m2=axes @ np.diag(np.maximum(variance, 1e-10)) @ axes.T,
            vertex_from_mark_m=model.vertex_world_m - mark,
        )
    return out


def build_problem(
    data: CampaignData,
    marks: Sequence[MarkObservation],
    vertices: Sequence[VertexObservation],
    planes: Sequence[PlaneObservation] = (),
) -> Problem:
    """The adjustment's input."""
    if data.rig is None or data.camera is None:
        raise EvaluationError("no sensors/rig.json or sensors/camera.json")
    lens, covariance = certified_lens(data.camera)
    return Problem(
        rig=data.rig,
        lens=lens,
        lens_covariance=covariance,
        range_covariance=data.range_correction.covariance if data.range_correction else None,
        marks=tuple(marks),
        vertices=tuple(vertices),
        surveyed=surveyed_marks(data),
        trajectories={s.folder.number: s.trajectory for s in data.sorties if s.trajectory is not None},
        world_frame=WorldFrame(data.manifest),
        planes=tuple(planes),
        panels=surveyed_panels(data) if planes else {},
    )


@dataclass(frozen=True, kw_only=True)
class GeometryResult:
    """Both mountings and what they rest on."""

    problem: Problem
    solution: MountingSolution
    vertices: tuple[VertexObservation, ...]
    vertex_reasons: dict[str, str]
    planes: tuple[PlaneObservation, ...] = ()  # as observed; empty where they contradict the vertices
    plane_reasons: dict[str, str] = field(default_factory=dict)


def solve_geometry(
    data: CampaignData,
    marks: Sequence[MarkObservation],
    returns: Mapping[tuple[int, int, str], TargetReturns],
    tools: Tools = OWN_TOOLS,
) -> GeometryResult:
    """Both mountings. Vertices are found twice: with the drawing's mounting, then with the first solution's, so that the
    sensor's motion while it scans a target is turned by the right mounting. With that mounting the panels' planes are found; where
    they agree with the vertices they join the adjustment.

    Raises
    ------
    EvaluationError
        Too little was seen; the commonest reason is part of the text.
    """
    if data.rig is None:
        raise EvaluationError("no sensors/rig.json")
    solve = mountings_solver(tools)
    vertices, reasons = observe_vertices(data, returns, nominal_mountings(data.rig)[1], tools=tools)
    if not vertices:
        nothing = "no strip passed over a frustum target"
        if not any(sortie.strips for sortie in data.sorties):
            nothing = "the campaign holds no LiDAR strip"
        what = next(iter(reasons.values()), nothing)
        raise EvaluationError(f"no frustum target has a vertex: {what}")
    first = solve(build_problem(data, marks, vertices))
    vertices, reasons = observe_vertices(data, returns, first.body_from_lidar, located=True, tools=tools)
    problem = build_problem(data, marks, vertices)
    solution = solve(problem, start=first.parameters)
    alone = GeometryResult(problem=problem, solution=solution, vertices=tuple(vertices), vertex_reasons=reasons)
    lines = exchanged_frustums(data, marks, vertices, returns, solution.body_from_lidar)
    if tools.extrinsic_solver is not None:  # it takes marks and vertices; what it did not use is not said to agree
        return _with_rejected(alone, lines)
    planes = observe_planes(data, returns, solution.body_from_lidar)
    return _with_rejected(with_planes(data, alone, planes, solve), lines)


def exchanged_frustums(
    data: CampaignData,
    marks: Sequence[MarkObservation],
    vertices: Sequence[VertexObservation],
    returns: Mapping[tuple[int, int, str], TargetReturns],
    body_from_lidar: Mounting,
) -> list[str]:
    """One line for each frustum that stands at another one's surveyed place."""
    found = {o.target for o in marks} | {o.target for o in vertices}
    passed = {target for _, _, target in returns}
    unseen = [t for t in frustums(data) if t.id in passed - found]

    def seen_as(targets: tuple[SurveyedTarget, ...]) -> set[str]:
        """Found in at least half of the strips that passed."""
        there = {key: returns[key] for key in returns if key[2] in {t.id for t in targets}}
        seen, _ = observe_vertices(replace(data, targets=targets), there, body_from_lidar, located=True)
        strips = {t.id: sum(key[2] == t.id for key in there) for t in targets}
        return {t for t, n in strips.items() if 2 * sum(v.target == t for v in seen) >= n}

    return [describe_exchange(*pair) for a, b in exchanged(unseen, seen_as) for pair in ((a, b), (b, a))]


def with_planes(
    data: CampaignData, alone: GeometryResult, found: PlanesFound, solve: Solve = solve_mountings
) -> GeometryResult:
    """The adjustment with the panels' planes beside what `alone` used; `alone` where there are none, or where they as a whole
    contradict the vertices (heights surveyed to another face, say), which is then named."""
    alone = replace(alone, plane_reasons=found.missing)
    if not found.planes:
        return _with_rejected(alone, found.rejected)
    problem = build_problem(data, alone.problem.marks, alone.problem.vertices, found.planes)
    panels = len({o.panel for o in found.planes})
    try:
        solution = solve(problem, start=alone.solution.parameters)
        doubt = contradiction(solution)
    except EvaluationError as error:
        doubt = str(error)
    if doubt is not None:
        return _with_rejected(alone, (*found.rejected, f"planes of all {panels} panels: {doubt}"))
    together = replace(alone, problem=problem, solution=solution, planes=found.planes)
    return _with_rejected(together, found.rejected)


def _with_rejected(result: GeometryResult, lines: Sequence[str]) -> GeometryResult:
    solution = result.solution
    return replace(result, solution=replace(solution, rejected=(*solution.rejected, *lines)))
