"""Observation equations and stochastic model of the joint adjustment of both mountings, (21)-(23) in flight.

One observation equation serves the camera and the LiDAR alike, p_sensor = sensor_from_body (body_from_world(t) (x - body)
- lever arm): the camera observes its pixel, the LiDAR the point itself, and of a point on a panel's plane the part along the
normal. Unknown are both mountings, every mark's place and every panel's height; the surveyed places and heights and the
drawing's mountings enter as weighted observations (the priors of rig.json, weak). Navigation
errors, which act on everything seen at nearby times of one sortie alike, and the lens certificate's errors are part of the
observations' covariance, so that stated variances hold. A sensor whose rig sheet gives its clock a prior has its clock among
the unknowns: what is stamped t was seen at t - clock. Reading of (21)-(24): one rigid transform does not hold in flight.
The solver lives in `adjustment`; finding marks, vertices and planes, and the indicator (20), elsewhere.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from campaign.config import Lens
from campaign.flight.trajectory import Trajectory
from campaign.sensors import NavigationSheet, Rig
from evaluator.body_rates import body_rates
from evaluator.camera_model import project_with_jacobian
from evaluator.frames import WorldFrame, body_pose, euler_angles, euler_rates, euler_rotation, skew
from evaluator.georeference import nominal_mountings
from evaluator.model import EvaluationError, MarkObservation, Mounting, PlaneObservation, VertexObservation

PARAMETER_NAMES = tuple(
    f"{sensor}_{part}"
    for sensor in ("camera", "lidar")
    for part in (
        "boresight_roll",
        "boresight_pitch",
        "boresight_yaw",
        "lever_arm_x",
        "lever_arm_y",
        "lever_arm_z",
    )
)
CLOCK_NAMES = (
    "camera_clock",
    "lidar_clock",
)  # stamped minus true time [s], after the twelve, where the rig has a prior
KINDS = {"mark": "marks", "vertex": "vertices", "plane": "planes"}  # of observation, each with a variance factor
_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, kw_only=True)
class SurveyedMark:
    """A frustum target as the surveyors give it, in the world frame."""

    mark_world_m: np.ndarray  # (3,)
    covariance_m2: np.ndarray  # (3, 3)
    vertex_from_mark_m: np.ndarray  # (3,) the stated vertex minus the mark's centre


@dataclass(frozen=True, kw_only=True)
class SurveyedPanel:
    """A reflectance panel's upper face as the surveyors give it: level, its height stated."""

    centre_world_m: np.ndarray  # (3,)
    normal_world: np.ndarray  # (3,) unit, up
    height_std_m: float


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Everything the adjustment uses."""

    rig: Rig
    lens: Lens
    lens_covariance: np.ndarray  # (9, 9)
    range_covariance: np.ndarray | None = None  # (2, 2) of K2 [m] and R2 where the ranges were corrected by (15)
    marks: tuple[MarkObservation, ...]
    vertices: tuple[VertexObservation, ...]
    surveyed: dict[str, SurveyedMark]
    trajectories: dict[int, Trajectory]  # by sortie
    world_frame: WorldFrame
    planes: tuple[PlaneObservation, ...] = ()
    panels: dict[str, SurveyedPanel] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class _Stack:
    """Observations of one kind as arrays; the poses are those at `time_s` less the clock."""

    target: np.ndarray  # (n,) index of the target, or of the panel
    sortie: np.ndarray  # (n,)
    time_s: np.ndarray  # (n,)
    body_m: np.ndarray  # (n, 3)
    world_from_body: np.ndarray  # (n, 3, 3)
    velocity_m_s: np.ndarray  # (n, 3) world axes; zero where the clock is not estimated
    turn_rad_s: np.ndarray  # (n, 3) angular rate about world axes; the same
    attitude_axes: np.ndarray  # (n, 3, 3) world axes of the errors of roll, pitch, heading
    offset_m: np.ndarray  # (n, 3) observed point minus mark
    values: np.ndarray  # (n, 2) pixels or (n, 3) LiDAR coordinates
    covariance: np.ndarray  # (n, k, k): k = 2 of marks, 3 of vertices, 1 of planes


def mounting_of(nominal: Mounting, parameters: np.ndarray) -> Mounting:
    """body_from_sensor = dR(roll, pitch, yaw) * nominal, lever arm = nominal + d; parameters (6,) [rad, m]."""
    return Mounting(
        rotation=euler_rotation(*parameters[:3]) @ nominal.rotation, lever_arm_m=nominal.lever_arm_m + parameters[3:]
    )


def observe_points(
    mounting: Mounting, delta_rpy: np.ndarray, body_m: np.ndarray, world_from_body: np.ndarray, world_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points in a sensor's frame with all derivatives.

    Parameters
    ----------
    mounting : Mounting
        body_from_sensor.
    delta_rpy : (3,) np.ndarray
        The angles of dR in it, for the derivative. [rad]
    body_m : (n, 3) np.ndarray
        Body origin in the world. [m]
    world_from_body : (n, 3, 3) np.ndarray
    world_m : (n, 3) np.ndarray
        Points. [m]

    Returns
    -------
    p_sensor : (n, 3) [m]
    d_mounting : (n, 3, 6) by roll, pitch, yaw [m/rad] and lever arm.
    d_point : (n, 3, 3) by the world point; by the body's position it is the negative.
    d_attitude : (n, 3, 3) by a small turn of the body about world axes. [m/rad]
    """
    difference = world_m - body_m
    arm = np.einsum("nji,nj->ni", world_from_body, difference) - mounting.lever_arm_m
    sensor_from_body = mounting.rotation.T
    d_point = sensor_from_body @ np.swapaxes(world_from_body, -1, -2)
    d_mounting = np.empty((len(world_m), 3, 6))
    d_mounting[:, :, :3] = sensor_from_body @ skew(arm) @ euler_rates(delta_rpy)
    d_mounting[:, :, 3:] = -sensor_from_body
    return arm @ mounting.rotation, d_mounting, d_point, d_point @ skew(difference)


def _stack(problem: Problem, index: dict[str, int], kind: str) -> _Stack:
    marks, vertices, planes = problem.marks, problem.vertices, problem.planes
    observations: tuple[MarkObservation | VertexObservation | PlaneObservation, ...]
    if kind == "mark":
        observations, of = marks, [o.target for o in marks]
        values, covariance = [o.uv_px for o in marks], [o.covariance_px2 for o in marks]
    elif kind == "vertex":
        observations, of = vertices, [o.target for o in vertices]
        values = [o.point_lidar_m for o in vertices]
        covariance = [o.covariance_m2 + scan_drift_m2(o, problem.rig.navigation) * np.eye(3) for o in vertices]
    else:
        observations, of = planes, [o.panel for o in planes]
        values, covariance = [o.point_lidar_m for o in planes], [np.array([[o.std_m**2]]) for o in planes]
    n, size, k = len(observations), 2 if kind == "mark" else 3, {"mark": 2, "vertex": 3, "plane": 1}[kind]
    sortie = np.array([o.sortie for o in observations], dtype=np.int64)
    time = np.array([o.gps_time_s for o in observations], dtype=np.float64)
    sheet = problem.rig.camera if kind == "mark" else problem.rig.lidar
    offset = [problem.surveyed[t].vertex_from_mark_m if kind == "vertex" else np.zeros(3) for t in of]
    return _Stack(
        target=np.array([index[t] for t in of], dtype=np.int64),
        sortie=sortie,
        time_s=time,
        offset_m=np.array(offset).reshape(n, 3),
        values=np.array(values).reshape(n, size),
        covariance=np.array(covariance).reshape(n, k, k),
        **_poses(problem, time, sortie, rates=sheet.clock_std_s > 0.0),
    )


def scan_drift_m2(vertex: VertexObservation, sheet: NavigationSheet) -> float:
    """Variance of a vertex because the navigation's errors change while its faces are scanned, one after the other. [m2]

    Two opposite faces, each seen in one half of the scan of D seconds, put the vertex half the difference of the halves' mean
    errors off, along the beam as well. For errors of random walk that change by 2 s^2 t / T in t seconds this half has the variance
    s^2 D / (6 T); it never exceeds s^2.
    """
    tilt = np.radians(np.asarray(sheet.attitude_std_deg[:2]))
    of_tilt, of_place = (
        -np.expm1(-vertex.time_spread_s / (6.0 * t))
        for t in (sheet.attitude_correlation_s, sheet.position_correlation_s)
    )
    turned = float(np.mean(tilt**2)) * float(vertex.point_lidar_m @ vertex.point_lidar_m)
    return float(turned * of_tilt + np.mean(np.square(sheet.position_std_m)) * of_place)


def _poses(problem: Problem, time_s: np.ndarray, sortie: np.ndarray, *, rates: bool) -> dict[str, np.ndarray]:
    """Pose of the body, axes of its attitude's errors and, with `rates`, its motion at the given times."""
    n = len(time_s)
    body, rotation, axes = np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, 3))
    velocity, turn = np.zeros((n, 3)), np.zeros((n, 3))
    for number in np.unique(sortie):
        rows = np.flatnonzero(sortie == number)
        trajectory = problem.trajectories[int(number)]
        body[rows], rotation[rows] = body_pose(trajectory, time_s[rows], problem.world_frame)
        axes[rows] = _ENU_FROM_NED @ euler_rates(euler_angles(_ENU_FROM_NED.T @ rotation[rows]))
        if rates:
            velocity[rows], turn[rows] = body_rates(trajectory, time_s[rows], problem.world_frame)
    return {
        "body_m": body,
        "world_from_body": rotation,
        "attitude_axes": axes,
        "velocity_m_s": velocity,
        "turn_rad_s": turn,
    }


def _gauss_markov(time_s: np.ndarray, sortie: np.ndarray, correlation_s: float) -> np.ndarray:
    """Correlation exp(-|dt|/T) inside a sortie, none between sorties: (n, n)."""
    same = sortie[:, None] == sortie[None, :]
    return np.asarray(np.where(same, np.exp(-np.abs(time_s[:, None] - time_s[None, :]) / correlation_s), 0.0))


def navigation_covariance(
    d_position: np.ndarray,
    d_attitude: np.ndarray,
    time_s: np.ndarray,
    sortie: np.ndarray,
    sheet: NavigationSheet,
) -> np.ndarray:
    """Covariance of observations from first-order Gauss-Markov errors of the trajectory.

    Parameters
    ----------
    d_position, d_attitude : (m, 3) np.ndarray
        Derivative of observation row m by north, east, down [per m] and by roll, pitch, heading [per rad] at its own epoch.
    time_s, sortie : (m,) np.ndarray
        Epoch and flight of each row; flights are independent.
    sheet : NavigationSheet

    Returns
    -------
    (m, m) np.ndarray
    """
    total = np.zeros((len(time_s), len(time_s)))
    for rows, std, correlation in (
        (d_position, np.asarray(sheet.position_std_m), sheet.position_correlation_s),
        (d_attitude, np.radians(np.asarray(sheet.attitude_std_deg)), sheet.attitude_correlation_s),
    ):
        scaled = rows * std
        total += (scaled @ scaled.T) * _gauss_markov(time_s, sortie, correlation)
    return total


@dataclass(frozen=True, kw_only=True)
class Linear:
    """The linearised system: residuals y - f, design, covariance, and the observations' derivatives by what is stated."""

    residual: np.ndarray
    design: np.ndarray
    covariance: np.ndarray
    by_lens: np.ndarray  # (2 marks, 9)
    by_range: np.ndarray  # (rows before the places, 2) of measured by additive [m] and proportional errors of ranges


class System:
    """Observations in fixed order: marks (2 rows), vertices (3), planes (1), surveyed places (3), surveyed heights (1), priors of
    the mounting (12 rows) and of the clocks (0 to 2). Unknowns: the mountings (12), the clocks that have a prior, every mark's
    place (3 each), every panel's height above the surveyed one (1 each)."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        seen = {o.target for o in problem.marks} | {o.target for o in problem.vertices}
        self.targets = tuple(sorted(seen))
        self.panels = tuple(sorted({o.panel for o in problem.planes}))
        missing = [t for t in self.targets if t not in problem.surveyed]
        missing += [p for p in self.panels if p not in problem.panels]
        if missing:
            raise EvaluationError("a target was observed that the survey does not hold", got=missing[0])
        index = {t: i for i, t in enumerate(self.targets)}
        self.camera = _stack(problem, index, "mark")
        self.lidar = _stack(problem, index, "vertex")
        self.plane = _stack(problem, {p: i for i, p in enumerate(self.panels)}, "plane")
        self.nominal = nominal_mountings(problem.rig)
        self.places = np.array([problem.surveyed[t].mark_world_m for t in self.targets]).reshape(-1, 3)
        of = [problem.panels[o.panel] for o in problem.planes]
        self._centres = np.array([p.centre_world_m for p in of]).reshape(-1, 3)
        self._normals = np.array([p.normal_world for p in of]).reshape(-1, 3)
        sizes = (2 * len(problem.marks), 3 * len(problem.vertices), len(of), 3 * len(self.targets), len(self.panels))
        first = [int(v) for v in np.concatenate([[0], np.cumsum(sizes)])]
        self.rows_marks, self.rows_vertices, self.rows_planes, self.rows_places, self.rows_heights = first[:5]
        self.rows_prior = first[5]
        sheets = (problem.rig.camera, problem.rig.lidar)
        clocks = [(name, s.clock_std_s) for name, s in zip(CLOCK_NAMES, sheets, strict=True) if s.clock_std_s > 0.0]
        self.names = PARAMETER_NAMES + tuple(name for name, _ in clocks)
        self.count = len(self.names)  # of the parameters before the places
        self.size = self.rows_prior + self.count
        self.kinds: list[str] = []
        self.groups: list[tuple[int, int]] = []  # first row, rows
        for kind, start, total, each in zip((*KINDS, "survey", "height"), first, sizes, (2, 3, 1, 3, 1), strict=False):
            self.kinds += [kind] * (total // each)
            self.groups += [(start + k, each) for k in range(0, total, each)]
        priors = [
            np.concatenate([np.full(3, np.radians(s.boresight_std_deg)), np.full(3, s.lever_arm_std_m)]) for s in sheets
        ]
        self.prior_std = np.concatenate([*priors, [std for _, std in clocks]])

    def start(self, parameters: np.ndarray) -> np.ndarray:
        """First values of all unknowns: the survey's beside the given mounting parameters and clocks."""
        return np.concatenate([parameters, self.places.ravel(), np.zeros(len(self.panels))])

    def mountings(self, x: np.ndarray) -> tuple[Mounting, Mounting]:
        return mounting_of(self.nominal[0], x[0:6]), mounting_of(self.nominal[1], x[6:12])

    def _clock_column(self, sensor: int) -> int | None:
        return self.names.index(CLOCK_NAMES[sensor]) if CLOCK_NAMES[sensor] in self.names else None

    def _shifted(self, stack: _Stack, clock_s: float) -> _Stack:
        """The body where it was when the observations were made."""
        if clock_s == 0.0:
            return stack
        return replace(stack, **_poses(self.problem, stack.time_s - clock_s, stack.sortie, rates=True))

    def _feet(self, stack: _Stack, mounting: Mounting, heights_m: np.ndarray) -> np.ndarray:
        """Where the planes' normals through the observed points meet the planes, world (n, 3): the places that the points have on
        their planes, of which nothing but the height is known."""
        in_body = stack.values @ mounting.rotation.T + mounting.lever_arm_m
        world = stack.body_m + np.einsum("nij,nj->ni", stack.world_from_body, in_body)
        above = np.sum((world - self._centres) * self._normals, axis=1) - heights_m[stack.target]
        return np.asarray(world - above[:, None] * self._normals)

    def linearise(self, x: np.ndarray, *, with_covariance: bool = True) -> Linear:
        """x: mounting parameters and clocks, 3 of every mark, 1 of every panel. `with_covariance` False leaves it out."""
        of_heights = self.count + 3 * len(self.targets)  # their first column
        marks_world, heights = x[self.count : of_heights].reshape(-1, 3), x[of_heights:]
        camera, lidar = self.mountings(x)
        design = np.zeros((self.size, x.size))
        residual = np.zeros(self.size)
        covariance = np.zeros((self.size, self.size) if with_covariance else (0, 0))
        d_position, d_attitude = np.zeros((self.rows_places, 3)), np.zeros((self.rows_places, 3))
        d_lens, d_range = np.zeros((self.rows_vertices, 9)), np.zeros((self.rows_places, 2))
        for kind, stack, mounting, first, sensor in (
            ("mark", self.camera, camera, self.rows_marks, 0),
            ("vertex", self.lidar, lidar, self.rows_vertices, 1),
            ("plane", self.plane, lidar, self.rows_planes, 1),
        ):
            n, k = stack.covariance.shape[:2]
            if n == 0:
                continue
            column = 6 * sensor
            clock = self._clock_column(sensor)
            if clock is not None:
                stack = self._shifted(stack, float(x[clock]))
            points = (
                self._feet(stack, mounting, heights) if kind == "plane" else marks_world[stack.target] + stack.offset_m
            )
            p, by_mounting, by_point, by_attitude = observe_points(
                mounting, x[column : column + 3], stack.body_m, stack.world_from_body, points
            )
            if kind == "mark":
                predicted, d_uv, by_lens = project_with_jacobian(self.problem.lens, p)
                by_mounting, by_point, by_attitude = d_uv @ by_mounting, d_uv @ by_point, d_uv @ by_attitude
                d_lens[:] = by_lens.reshape(-1, 9)
                difference = stack.values - predicted
            else:
                difference = stack.values - p
                towards = stack.values / np.linalg.norm(stack.values, axis=1, keepdims=True)
                by_range = np.stack([towards, stack.values], axis=-1)  # d p / d(K2, R2), along the ray
            unknown = by_point
            if kind == "plane":  # of the point only the part along the normal, as the sensor sees it
                part = np.swapaxes(by_point @ self._normals[:, :, None], -1, -2)
                difference, by_range, by_mounting = (
                    (part @ difference[:, :, None])[..., 0],
                    part @ by_range,
                    part @ by_mounting,
                )
                by_point, by_attitude = part @ by_point, part @ by_attitude
                unknown = np.ones((n, 1, 1))  # by the plane's height
            rows = slice(first, first + k * n)
            if clock is not None:  # at t - clock the body was behind: its position by -velocity, its attitude by -turn
                by_clock = by_point @ stack.velocity_m_s[:, :, None] - by_attitude @ stack.turn_rad_s[:, :, None]
                design[rows, clock] = by_clock.ravel()
            residual[rows] = difference.ravel()
            design[rows, column : column + 6] = by_mounting.reshape(-1, 6)
            each = first + np.arange(k * n).reshape(n, k)
            at = (
                of_heights + stack.target[:, None]
                if kind == "plane"
                else self.count + 3 * stack.target[:, None] + np.arange(3)
            )
            design[each[:, :, None], at[:, None, :]] = unknown
            if with_covariance:
                covariance[each[:, :, None], each[:, None, :]] = stack.covariance
            if kind != "mark":
                d_range[rows] = by_range.reshape(-1, 2)
            d_position[rows] = (by_point @ _ENU_FROM_NED).reshape(-1, 3)
            d_attitude[rows] = (by_attitude @ stack.attitude_axes).reshape(-1, 3)
        surveyed = slice(self.rows_places, self.rows_prior)
        residual[surveyed] = np.concatenate([(self.places - marks_world).ravel(), -heights])
        design[surveyed, self.count :] = np.eye(x.size - self.count)
        prior = slice(self.rows_prior, self.size)
        residual[prior] = -x[: self.count]
        design[prior, : self.count] = np.eye(self.count)
        if with_covariance:
            self._covariance(covariance, d_position, d_attitude, d_lens, d_range)
        return Linear(residual=residual, design=design, covariance=covariance, by_lens=d_lens, by_range=d_range)

    def _covariance(
        self,
        covariance: np.ndarray,
        d_position: np.ndarray,
        d_attitude: np.ndarray,
        d_lens: np.ndarray,
        d_range: np.ndarray,
    ) -> None:
        """Adds navigation, lens, ranges, survey and priors to the observations' own variances."""
        stacks = (self.camera, self.lidar, self.plane)
        time = np.concatenate([np.repeat(s.time_s, s.covariance.shape[1]) for s in stacks])
        sortie = np.concatenate([np.repeat(s.sortie, s.covariance.shape[1]) for s in stacks])
        seen = slice(0, self.rows_places)
        covariance[seen, seen] += navigation_covariance(
            d_position, d_attitude, time, sortie, self.problem.rig.navigation
        )
        pixels = slice(0, self.rows_vertices)
        covariance[pixels, pixels] += d_lens @ self.problem.lens_covariance @ d_lens.T
        if self.problem.range_covariance is not None:
            covariance[seen, seen] += d_range @ self.problem.range_covariance @ d_range.T
        for i, t in enumerate(self.targets):
            block = slice(self.rows_places + 3 * i, self.rows_places + 3 * i + 3)
            covariance[block, block] = self.problem.surveyed[t].covariance_m2
        heights = np.arange(self.rows_heights, self.rows_prior)
        covariance[heights, heights] = [self.problem.panels[p].height_std_m ** 2 for p in self.panels]
        prior = np.arange(self.rows_prior, self.size)
        covariance[prior, prior] = self.prior_std**2
