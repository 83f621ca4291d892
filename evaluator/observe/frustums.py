"""The common vertex of a frustum target's faces from one strip's returns (9.3.2 d), residuals along the ray.

All work is done in the target's frame (origin: stated place of the vertex, x right, y along the target's azimuth, z up),
through the trajectory and an approximate mounting; the result goes back to the LiDAR frame at the moment the beam
passed the vertex, where the approximate mounting cancels. Marks in images live in `marks`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from campaign.flight.trajectory import Trajectory
from campaign.sensors import LidarSheet
from campaign.survey import SurveyedTarget
from evaluator.algorithms.slots import FoundVertex, VertexTask
from evaluator.frames import WorldFrame, body_pose, euler_rotation
from evaluator.model import Mounting, VertexObservation

SLOPE = np.sqrt(2.0)  # rise over run of every face, by the standard's 60 and 120 degrees
_AZIMUTHS = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]])  # of faces 0-3 in target x, y
_LEAST_POINTS = 6  # on a face, for its plane to count
_LEAST_FACES = 3
_TURN_STD = np.radians(1.5)  # of the whole body: levelling, and the mounting's error not yet known
_REDUNDANCY_OF_SHEET = 20.0  # weight of the sheet's precision against the residuals' own, in degrees of freedom


@dataclass(frozen=True, kw_only=True)
class FrustumModel:
    """What the survey states about one target's body."""

    target: str
    vertex_world_m: np.ndarray  # (3,) surveyed mark plus the stated offset
    world_from_target: np.ndarray  # (3, 3)
    long_edge_m: float
    inverted: bool
    thickness_m: float
    face_angle_std_rad: float = np.radians(0.1)  # how well the sheets keep the standard's angles

    @property
    def sign(self) -> float:
        """Faces lie above (+1) or below (-1) the vertex."""
        return 1.0 if self.inverted else -1.0

    @property
    def normals(self) -> np.ndarray:
        """(4, 3) of the stated faces, towards the side from which a sensor above sees them."""
        up = np.ones((4, 1))
        return np.asarray(np.concatenate([-self.sign * SLOPE * _AZIMUTHS, up], axis=1) / np.sqrt(3.0))


def frustum_model(target: SurveyedTarget, world_frame: WorldFrame) -> FrustumModel:
    """From the survey's row: place of the stated vertex and axes of the target in the world."""
    place = np.array([target.easting_m, target.northing_m, target.height_m])
    a = np.radians(target.azimuth_deg)
    grid_from_target = np.array([[np.cos(a), np.sin(a), 0.0], [-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    world_from_target = world_frame.world_from_grid(place) @ grid_from_target
    inverted = target.style != "upright"
    offset = target.vertex_offset_m
    if offset is None:
        offset = 0.0 if inverted else target.size_m * np.sqrt(0.5)
    return FrustumModel(
        target=target.id,
        vertex_world_m=world_frame.world_from_map(place) + offset * world_from_target[:, 2],
        world_from_target=world_from_target,
        long_edge_m=target.size_m,
        inverted=inverted,
        thickness_m=target.thickness_m or 0.0,
    )


@dataclass(frozen=True, kw_only=True)
class _Rays:
    """Beams in the target's frame."""

    origin_m: np.ndarray  # (n, 3)
    direction: np.ndarray  # (n, 3) unit
    range_m: np.ndarray  # (n,)

    @property
    def points(self) -> np.ndarray:
        return np.asarray(self.origin_m + self.range_m[:, None] * self.direction)


def _coarse(points: np.ndarray, model: FrustumModel) -> tuple[np.ndarray, int]:
    """Vertex to a few centimetres: highest returns, middle of their extent, then the shift that puts most returns on faces."""
    b, sign = model.long_edge_m, model.sign
    if len(points) < _LEAST_FACES * _LEAST_POINTS:
        return np.zeros(3), 0
    top = np.sort(points[:, 2])[-3]
    z_vertex = top - (b / np.sqrt(2.0) if model.inverted else -b / np.sqrt(8.0))
    body = points[points[:, 2] > top - b * 0.38]
    middle = 0.5 * (np.quantile(body[:, :2], 0.02, axis=0) + np.quantile(body[:, :2], 0.98, axis=0))
    best, most = np.zeros(3), -1
    for step, half, half_z in ((0.05 * b, 4, 2), (0.015 * b, 3, 3)):
        centre = np.array([*middle, z_vertex]) if most < 0 else best
        xy = step * np.arange(-half, half + 1)
        z = step * np.arange(-half_z, half_z + 1)
        shifts = centre + np.stack(np.meshgrid(xy, xy, z, indexing="ij"), axis=-1).reshape(-1, 3)
        near = body[np.all(np.abs(body[:, :2] - centre[:2]) < 0.5 * b + half * step, axis=1)]
        run = np.maximum(np.abs(near[:, 0] - shifts[:, :1]), np.abs(near[:, 1] - shifts[:, 1:2]))
        miss = np.abs(near[:, 2] - shifts[:, 2:] - sign * SLOPE * run)
        on = (run > 0.25 * b) & (run < 0.5 * b)
        score = np.sum(np.where(on, np.clip(1.0 - (miss / (1.5 * step)) ** 2, 0.0, None), 0.0), axis=1)
        k = int(np.argmax(score))
        best, most = shifts[k], int(np.sum(on[k] & (miss[k] < 2.5 * step)))
    return best, most


def _assign(rays: _Rays, vertex: np.ndarray, turn: np.ndarray, model: FrustumModel, margin_m: float) -> np.ndarray:
    """Face of each beam, -1 where it lies within `margin_m` of an edge, or passes that close to the large rim."""
    b = model.long_edge_m
    body_from_target = euler_rotation(*turn).T
    relative = (rays.points - vertex) @ body_from_target.T
    along = relative[:, :2] @ _AZIMUTHS.T
    face = np.argmax(along, axis=1)
    run = along[np.arange(len(face)), face]
    lateral = np.abs(along[np.arange(len(face)), (face + 1) % 4])
    ok = (run > 0.25 * b + margin_m) & (run < 0.5 * b - margin_m) & (lateral < run - np.sqrt(2.0) * margin_m)
    if model.inverted:
        # where the beam passed the level of the large rim: a beam to an inner face must come through its opening
        direction = rays.direction @ body_from_target.T
        back = (b / np.sqrt(2.0) - relative[:, 2]) / np.where(np.abs(direction[:, 2]) > 1e-9, direction[:, 2], 1e-9)
        entry = np.max(np.abs(relative[:, :2] + back[:, None] * direction[:, :2]), axis=1)
        ok &= np.abs(entry - 0.5 * b) > margin_m
    return np.asarray(np.where(ok, face, -1))


@dataclass(frozen=True, kw_only=True)
class _Planes:
    """State of the fit: vertex, turn of the whole body, small turns of each face about the two axes in it."""

    vertex: np.ndarray  # (3,)
    turn: np.ndarray  # (3,)
    tilt: np.ndarray  # (4, 2)


def _tangents(model: FrustumModel) -> np.ndarray:
    """(4, 2, 3): level line and line of fall of each face."""
    normals = model.normals
    level = np.concatenate([_AZIMUTHS[:, ::-1] * [1.0, -1.0], np.zeros((4, 1))], axis=1)
    return np.stack([level, np.cross(normals, level)], axis=1)


def _face_normals(model: FrustumModel, planes: _Planes) -> np.ndarray:
    """(4, 3) of the stated faces as fitted."""
    turned = model.normals + np.cross(np.einsum("ki,kij->kj", planes.tilt, _tangents(model)), model.normals)
    turned = turned @ euler_rotation(*planes.turn).T
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def _residuals(
    rays: _Rays, face: np.ndarray, planes: _Planes, model: FrustumModel
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measured minus predicted range, design (n, 3 + 3 + 8), tangent of the incidence angle."""
    n = _face_normals(model, planes)[face]
    cosine = np.sum(n * rays.direction, axis=1)
    cosine = np.where(np.abs(cosine) < 0.02, np.where(cosine < 0, -0.02, 0.02), cosine)
    behind = np.where(cosine > 0.0, -model.thickness_m, 0.0)  # the sheet's other side
    predicted = (n @ planes.vertex - np.sum(n * rays.origin_m, axis=1) + behind) / cosine
    hit = rays.origin_m + predicted[:, None] * rays.direction
    by_turn = np.cross(n, planes.vertex + behind[:, None] * n - hit) / cosine[:, None]
    design = np.zeros((len(face), 14))
    design[:, :3] = n / cosine[:, None]
    design[:, 3:6] = by_turn
    axes = _tangents(model)[face] @ euler_rotation(*planes.turn).T
    columns = 6 + 2 * face[:, None] + np.arange(2)
    design[np.arange(len(face))[:, None], columns] = np.einsum("nkj,nj->nk", axes, by_turn)
    return rays.range_m - predicted, design, np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) / np.abs(cosine)


def _weighted_step(
    residual: np.ndarray, design: np.ndarray, std: np.ndarray, planes: _Planes, model: FrustumModel, rotate: bool
) -> tuple[np.ndarray, np.ndarray]:
    """One Gauss-Newton step under the priors of the turns: (step (14,), covariance (14, 14))."""
    prior_std = np.concatenate([np.full(3, _TURN_STD), np.full(8, model.face_angle_std_rad)])
    if not rotate:
        prior_std = np.full(11, 1e-6)
    state = np.concatenate([planes.turn, planes.tilt.ravel()])
    weight = 1.0 / std**2
    normal = design.T @ (design * weight[:, None])
    right = design.T @ (residual * weight)
    normal[3:, 3:] += np.diag(1.0 / prior_std**2)
    right[3:] -= state / prior_std**2
    covariance = np.linalg.inv(normal)
    return covariance @ right, covariance


def fit_vertex(task: VertexTask) -> FoundVertex | str:
    """Vertex of the stated faces, all planes through one point, residuals along the ray.

    Every face plane is fitted with its residuals along the ray, since the noise of a range lies along its beam (orthogonal
    residuals bring the vertex 7 mm too low at 10 mm of noise); all planes pass one point by construction. The faces' angles
    are observations of 0.1 degrees about the standard's, the whole body is free to turn.

    Returns
    -------
    FoundVertex, or a line that says why there is none.

    References
    ----------
    GB/T 41450-2022, 9.3.2 d.
    """
    model = FrustumModel(
        target="",
        vertex_world_m=np.zeros(3),
        world_from_target=np.eye(3),
        long_edge_m=task.long_edge_m,
        inverted=task.inverted,
        thickness_m=task.thickness_m,
        face_angle_std_rad=task.face_angle_std_rad,
    )
    rays = _Rays(origin_m=task.origin_m, direction=task.direction, range_m=task.range_m)
    footprint, single_return = task.footprint_m, task.single_return
    if 1.2 * footprint >= 0.25 * model.long_edge_m:
        return f"footprint of {footprint:.3f} m on faces {0.25 * model.long_edge_m:.3f} m wide"
    vertex, count = (np.zeros(3), len(rays.range_m)) if task.located else _coarse(rays.points, model)
    if count < _LEAST_FACES * _LEAST_POINTS:
        return f"no funnel found: {max(count, 0)} returns on its faces"

    planes = _Planes(vertex=vertex, turn=np.zeros(3), tilt=np.zeros((4, 2)))
    encoder = task.encoder_std_rad * rays.range_m
    covariance = np.zeros((14, 14))
    gate = 0.10 * model.long_edge_m
    for iteration in range(14):
        rotate = iteration >= 3
        face = _assign(rays, planes.vertex, planes.turn, model, 0.6 * footprint + (0.004 if rotate else 0.0))
        use = np.flatnonzero((face >= 0) & single_return)
        if use.size < _LEAST_FACES * _LEAST_POINTS:
            return f"{use.size} clean returns on the faces"
        part = _Rays(origin_m=rays.origin_m[use], direction=rays.direction[use], range_m=rays.range_m[use])
        residual, design, tangent = _residuals(part, face[use], planes, model)
        std = np.hypot(task.range_std_m, encoder[use] * tangent)
        keep = np.abs(residual) < np.maximum(gate, 4.0 * std)
        if keep.sum() < _LEAST_FACES * _LEAST_POINTS:
            return f"{int(keep.sum())} returns fit the faces"
        if np.unique(face[use][keep]).size < _LEAST_FACES:  # fewer planes have no point in common
            return f"returns on {np.unique(face[use][keep]).size} faces only"
        used_std = std[keep]
        # Huber weights: a return off its plane still pulls, but no harder than one at two standard deviations
        size = np.abs(residual[keep]) / used_std
        spread = max(float(np.median(size)) / 0.6745, 0.3)
        robust = used_std * np.sqrt(np.maximum(size / (2.5 * spread), 1.0))
        step, covariance = _weighted_step(residual[keep], design[keep], robust, planes, model, rotate)
        planes = _Planes(
            vertex=planes.vertex + step[:3], turn=planes.turn + step[3:6], tilt=planes.tilt + step[6:].reshape(4, 2)
        )
        gate = max(0.5 * gate, 4.5 * spread * float(np.median(used_std)))
        if rotate and iteration > 6 and np.abs(step[:3]).max() < 1e-6:
            break
    faces_used = face[use][keep]
    counts = np.bincount(faces_used, minlength=4)
    seen = int(np.sum(counts >= _LEAST_POINTS))
    if seen < _LEAST_FACES:
        return f"{seen} faces with at least {_LEAST_POINTS} returns ({counts.tolist()})"
    after = residual[keep] - design[keep] @ step
    rms = float(np.sqrt(np.mean(after**2)))
    redundancy = max(after.size - 3.0 - 2.0 * seen, 1.0)
    factor = (_REDUNDANCY_OF_SHEET + float(np.sum((after / used_std) ** 2))) / (_REDUNDANCY_OF_SHEET + redundancy)
    if factor > 36.0:
        return f"residuals of {rms:.3f} m against a precision of {task.range_std_m:.3f} m"
    turn_deg = float(np.degrees(np.linalg.norm(planes.turn)))
    if turn_deg > 6.0:
        return f"the faces stand {turn_deg:.1f} degrees off the stated ones"
    return FoundVertex(
        vertex_m=planes.vertex,
        covariance_m2=covariance[:3, :3],
        used=use[keep],
        faces=seen,
        rms_m=rms,
        variance_factor=factor,
    )


def find_vertex(
    p_lidar_m: np.ndarray,
    gps_time_s: np.ndarray,
    single_return: np.ndarray,
    *,
    model: FrustumModel,
    trajectory: Trajectory,
    mounting: Mounting,
    world_frame: WorldFrame,
    lidar: LidarSheet,
    sortie: int,
    strip: int,
    located: bool = False,
    estimate: Callable[[VertexTask], FoundVertex | str] = fit_vertex,
) -> VertexObservation | str:
    """Vertex of the stated faces from one strip: into the target's frame, the estimate, back to the LiDAR's.

    Parameters
    ----------
    p_lidar_m : (n, 3) np.ndarray
        Returns near the target, each in the LiDAR frame at its own time. [m]
    gps_time_s : (n,) np.ndarray
    single_return : (n,) np.ndarray of bool
        The pulse's only return; others may be mixed with an edge and are left out.
    model : FrustumModel
    trajectory, mounting, world_frame
        Approximate georeferencing; the mounting may be off by 2 degrees.
    lidar : LidarSheet
        Precision, encoder noise and divergence.
    sortie, strip : int
    located : bool
        The mounting is known to a few hundredths of a degree already: begin at the surveyed place, without a search.
    estimate : callable
        What finds the vertex among the returns: the algorithm of the slot `vertex_estimation`.

    Returns
    -------
    VertexObservation, or a line that says why there is none.

    References
    ----------
    GB/T 41450-2022, 9.3.2 d.
    """
    if len(p_lidar_m) < _LEAST_FACES * _LEAST_POINTS:
        return f"{len(p_lidar_m)} returns near the target"
    to_target = model.world_from_target
    position, world_from_body = body_pose(trajectory, gps_time_s, world_frame)
    origin = position + world_from_body @ mounting.lever_arm_m - model.vertex_world_m
    arm = np.einsum("nij,nj->ni", world_from_body @ mounting.rotation, p_lidar_m)
    distance = np.linalg.norm(arm, axis=1)
    scale = 2.0 if lidar.divergence_definition == "1/e2" else 2.0 / 0.5887  # two standard widths, 1/e2 full angle
    task = VertexTask(
        origin_m=origin @ to_target,
        direction=(arm / distance[:, None]) @ to_target,
        range_m=distance,
        single_return=single_return,
        long_edge_m=model.long_edge_m,
        inverted=model.inverted,
        thickness_m=model.thickness_m,
        normals=model.normals,
        face_angle_std_rad=model.face_angle_std_rad,
        range_std_m=lidar.precision_m,
        encoder_std_rad=float(np.radians(lidar.encoder_std_deg)),
        footprint_m=0.5 * scale * lidar.divergence_rad * float(np.median(distance)),
        located=located,
    )
    found = estimate(task)
    if isinstance(found, str):
        return found

    # the instant at which the beam passed the vertex: there the approximate mounting drops out to first order
    at = task.points_m[found.used] - found.vertex_m
    times = gps_time_s[found.used]
    start = float(times.mean())
    line, *_ = np.linalg.lstsq(np.column_stack([np.ones(len(at)), at[:, :2]]), times - start, rcond=None)
    when = float(np.clip(start + line[0], times.min(), times.max()))
    there, turned = body_pose(trajectory, np.array([when]), world_frame)
    in_world = model.vertex_world_m + to_target @ found.vertex_m
    in_lidar = mounting.rotation.T @ (turned[0].T @ (in_world - there[0]) - mounting.lever_arm_m)
    lidar_from_target = mounting.rotation.T @ turned[0].T @ to_target
    return VertexObservation(
        target=model.target,
        sortie=sortie,
        strip=strip,
        gps_time_s=when,
        time_spread_s=float(times.max() - times.min()),
        point_lidar_m=in_lidar,
        covariance_m2=lidar_from_target @ found.covariance_m2 @ lidar_from_target.T * found.variance_factor,
        faces=found.faces if found.faces is not None else _faces_of(at),
        points=len(found.used),
        rms_m=found.rms_m if found.rms_m is not None else float("nan"),
        index=found.used,
    )


def _faces_of(relative_m: np.ndarray) -> int:
    """On how many faces at least `_LEAST_POINTS` of these returns (n, 3) lie, relative to the vertex."""
    face = np.argmax(relative_m[:, :2] @ _AZIMUTHS.T, axis=1)
    return int(np.sum(np.bincount(face, minlength=4) >= _LEAST_POINTS))
