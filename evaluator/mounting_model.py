"""Observation equations and stochastic model of the joint adjustment of both mountings, (21)-(23) in flight.

One observation equation serves the camera and the LiDAR alike, p_sensor = sensor_from_body (body_from_world(t) (x - body)
- lever arm): the camera observes its pixel, the LiDAR the point itself. Unknown are both mountings and every mark's place;
the surveyed places and the drawing's mountings enter as weighted observations (the priors of rig.json, weak). Navigation
errors, which act on everything seen at nearby times of one sortie alike, and the lens certificate's errors are part of the
observations' covariance, so that stated variances hold. A sensor whose rig sheet gives its clock a prior has its clock among
the unknowns: what is stamped t was seen at t - clock. Reading of (21)-(24): one rigid transform does not hold in flight.
The solver lives in `adjustment`; finding marks and vertices, and the indicator (20), elsewhere.
"""

from dataclasses import dataclass, replace

import numpy as np

from campaign.config import Lens
from campaign.sensors import NavigationSheet, Rig
from campaign.trajectory import Trajectory
from evaluator.camera_model import project_with_jacobian
from evaluator.frames import WorldFrame, body_pose, euler_angles, euler_rates, euler_rotation, skew
from evaluator.georeference import nominal_mountings
from evaluator.model import EvaluationError, MarkObservation, Mounting, VertexObservation

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
_RATE_SPAN_S = 0.02  # rates of the body by differences over it: a tenth of a step's noise, far below any sway
_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, kw_only=True)
class SurveyedMark:
    """A frustum target as the surveyors give it, in the world frame."""

    mark_world_m: np.ndarray  # (3,)
    covariance_m2: np.ndarray  # (3, 3)
    vertex_from_mark_m: np.ndarray  # (3,) the stated vertex minus the mark's centre


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


@dataclass(frozen=True, kw_only=True)
class _Stack:
    """Observations of one sensor as arrays; the poses are those at `time_s` less the clock."""

    target: np.ndarray  # (n,) index of the target
    sortie: np.ndarray  # (n,)
    time_s: np.ndarray  # (n,)
    body_m: np.ndarray  # (n, 3)
    world_from_body: np.ndarray  # (n, 3, 3)
    velocity_m_s: np.ndarray  # (n, 3) world axes; zero where the clock is not estimated
    turn_rad_s: np.ndarray  # (n, 3) angular rate about world axes; the same
    attitude_axes: np.ndarray  # (n, 3, 3) world axes of the errors of roll, pitch, heading
    offset_m: np.ndarray  # (n, 3) observed point minus mark
    values: np.ndarray  # (n, k) pixels or LiDAR coordinates
    covariance: np.ndarray  # (n, k, k)


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


def _stack(problem: Problem, index: dict[str, int], which: str) -> _Stack:
    observations: list[MarkObservation | VertexObservation] = [
        *(problem.marks if which == "camera" else problem.vertices)
    ]
    k = 2 if which == "camera" else 3
    n = len(observations)
    sortie = np.array([o.sortie for o in observations], dtype=np.int64)
    time = np.array([o.gps_time_s for o in observations], dtype=np.float64)
    values = np.zeros((n, k))
    covariance = np.zeros((n, k, k))
    offset = np.zeros((n, 3))
    for i, o in enumerate(observations):
        if isinstance(o, MarkObservation):
            values[i], covariance[i] = o.uv_px, o.covariance_px2
        elif isinstance(o, VertexObservation):
            values[i], covariance[i] = o.point_lidar_m, o.covariance_m2
            offset[i] = problem.surveyed[o.target].vertex_from_mark_m
    sheet = problem.rig.camera if which == "camera" else problem.rig.lidar
    return _Stack(
        target=np.array([index[o.target] for o in observations], dtype=np.int64),
        sortie=sortie,
        time_s=time,
        offset_m=offset,
        values=values,
        covariance=covariance,
        **_poses(problem, time, sortie, rates=sheet.clock_std_s > 0.0),
    )


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


def body_rates(
    trajectory: Trajectory, gps_time_s: np.ndarray, world_frame: WorldFrame
) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and angular rate of the body at any times inside the trajectory.

    By differences of its poses over 20 ms: a trajectory's own columns of rates may be absent, and from one record to the next
    a filter's noise would be a hundredth of the speed.

    Returns
    -------
    velocity, turn : (n, 3) np.ndarray
        In world axes. [m/s], [rad/s]
    """
    samples = trajectory.gps_time_s
    before = np.maximum(gps_time_s - 0.5 * _RATE_SPAN_S, samples[0])
    after = np.minimum(gps_time_s + 0.5 * _RATE_SPAN_S, samples[-1])
    span = np.maximum(after - before, 1e-9)[:, None]
    (p0, r0), (p1, r1) = body_pose(trajectory, before, world_frame), body_pose(trajectory, after, world_frame)
    turned = r1 @ np.swapaxes(r0, -1, -2)
    small = 0.5 * np.stack(
        [turned[:, 2, 1] - turned[:, 1, 2], turned[:, 0, 2] - turned[:, 2, 0], turned[:, 1, 0] - turned[:, 0, 1]], -1
    )
    return (p1 - p0) / span, small / span


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
    """The linearised system: residuals y - f, design, covariance."""

    residual: np.ndarray
    design: np.ndarray
    covariance: np.ndarray


class System:
    """Observations in fixed order: marks (2 rows), vertices (3), surveyed places (3), priors of the mounting (12 rows)
    and of the clocks (0 to 2). Unknowns: the mountings (12), the clocks that have a prior, every mark's place (3 each)."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        seen = {o.target for o in problem.marks} | {o.target for o in problem.vertices}
        self.targets = tuple(sorted(seen))
        missing = [t for t in self.targets if t not in problem.surveyed]
        if missing:
            raise EvaluationError("a target was observed that the survey does not hold", got=missing[0])
        index = {t: i for i, t in enumerate(self.targets)}
        self.camera = _stack(problem, index, "camera")
        self.lidar = _stack(problem, index, "lidar")
        self.nominal = nominal_mountings(problem.rig)
        self.places = np.array([problem.surveyed[t].mark_world_m for t in self.targets]).reshape(-1, 3)
        c, v, t = len(problem.marks), len(problem.vertices), len(self.targets)
        self.rows_marks, self.rows_vertices, self.rows_places = 0, 2 * c, 2 * c + 3 * v
        self.rows_prior = self.rows_places + 3 * t
        sheets = (problem.rig.camera, problem.rig.lidar)
        clocks = [(name, s.clock_std_s) for name, s in zip(CLOCK_NAMES, sheets, strict=True) if s.clock_std_s > 0.0]
        self.names = PARAMETER_NAMES + tuple(name for name, _ in clocks)
        self.count = len(self.names)  # of the parameters before the places
        self.size = self.rows_prior + self.count
        self.kinds = ["mark"] * c + ["vertex"] * v + ["survey"] * t
        self.groups = [(2 * i, 2) for i in range(c)]
        self.groups += [(self.rows_vertices + 3 * i, 3) for i in range(v)]
        self.groups += [(self.rows_places + 3 * i, 3) for i in range(t)]
        each = [
            np.concatenate([np.full(3, np.radians(s.boresight_std_deg)), np.full(3, s.lever_arm_std_m)]) for s in sheets
        ]
        self.prior_std = np.concatenate([*each, [std for _, std in clocks]])

    def mountings(self, x: np.ndarray) -> tuple[Mounting, Mounting]:
        return mounting_of(self.nominal[0], x[0:6]), mounting_of(self.nominal[1], x[6:12])

    def _clock_column(self, sensor: int) -> int | None:
        return self.names.index(CLOCK_NAMES[sensor]) if CLOCK_NAMES[sensor] in self.names else None

    def _shifted(self, stack: _Stack, clock_s: float) -> _Stack:
        """The body where it was when the observations were made."""
        if clock_s == 0.0:
            return stack
        return replace(stack, **_poses(self.problem, stack.time_s - clock_s, stack.sortie, rates=True))

    def linearise(self, x: np.ndarray, *, with_covariance: bool = True) -> Linear:
        """x: mounting parameters and clocks, then 3 of every mark. `with_covariance` False leaves it out."""
        marks_world = x[self.count :].reshape(-1, 3)
        camera, lidar = self.mountings(x)
        design = np.zeros((self.size, x.size))
        residual = np.zeros(self.size)
        covariance = np.zeros((self.size, self.size) if with_covariance else (0, 0))
        d_position, d_attitude = np.zeros((self.rows_places, 3)), np.zeros((self.rows_places, 3))
        d_lens = np.zeros((self.rows_vertices, 9))
        for sensor, (stack, mounting, first, column) in enumerate(
            ((self.camera, camera, self.rows_marks, 0), (self.lidar, lidar, self.rows_vertices, 6))
        ):
            n, k = stack.values.shape
            if n == 0:
                continue
            clock = self._clock_column(sensor)
            if clock is not None:
                stack = self._shifted(stack, float(x[clock]))
            p, by_mounting, by_point, by_attitude = observe_points(
                mounting,
                x[column : column + 3],
                stack.body_m,
                stack.world_from_body,
                marks_world[stack.target] + stack.offset_m,
            )
            predicted = p
            if k == 2:
                predicted, d_uv, by_lens = project_with_jacobian(self.problem.lens, p)
                by_mounting, by_point, by_attitude = d_uv @ by_mounting, d_uv @ by_point, d_uv @ by_attitude
                d_lens[:] = by_lens.reshape(-1, 9)
            rows = slice(first, first + k * n)
            if clock is not None:  # at t - clock the body was behind: its position by -velocity, its attitude by -turn
                by_clock = by_point @ stack.velocity_m_s[:, :, None] - by_attitude @ stack.turn_rad_s[:, :, None]
                design[rows, clock] = by_clock.ravel()
            residual[rows] = (stack.values - predicted).ravel()
            design[rows, column : column + 6] = by_mounting.reshape(-1, 6)
            each = first + np.arange(k * n).reshape(n, k)
            columns = self.count + 3 * stack.target[:, None] + np.arange(3)
            design[each[:, :, None], columns[:, None, :]] = by_point
            if with_covariance:
                covariance[each[:, :, None], each[:, None, :]] = stack.covariance
            d_position[rows] = (by_point @ _ENU_FROM_NED).reshape(-1, 3)
            d_attitude[rows] = (by_attitude @ stack.attitude_axes).reshape(-1, 3)
        places = slice(self.rows_places, self.rows_prior)
        residual[places] = (self.places - marks_world).ravel()
        design[places, self.count :] = np.eye(3 * len(self.targets))
        prior = slice(self.rows_prior, self.size)
        residual[prior] = -x[: self.count]
        design[prior, : self.count] = np.eye(self.count)
        if with_covariance:
            self._covariance(covariance, d_position, d_attitude, d_lens)
        return Linear(residual=residual, design=design, covariance=covariance)

    def _covariance(
        self, covariance: np.ndarray, d_position: np.ndarray, d_attitude: np.ndarray, d_lens: np.ndarray
    ) -> None:
        """Adds navigation, lens, survey and priors to the observations' own variances."""
        time = np.concatenate([np.repeat(self.camera.time_s, 2), np.repeat(self.lidar.time_s, 3)])
        sortie = np.concatenate([np.repeat(self.camera.sortie, 2), np.repeat(self.lidar.sortie, 3)])
        seen = slice(0, self.rows_places)
        covariance[seen, seen] += navigation_covariance(
            d_position, d_attitude, time, sortie, self.problem.rig.navigation
        )
        pixels = slice(0, self.rows_vertices)
        covariance[pixels, pixels] += d_lens @ self.problem.lens_covariance @ d_lens.T
        if self.problem.range_covariance is not None:
            points = slice(self.rows_vertices, self.rows_places)
            p = self.lidar.values
            towards = p / np.linalg.norm(p, axis=1, keepdims=True)
            by_constants = np.stack([towards.ravel(), p.ravel()], axis=1)  # d p / d(K2, R2), along the ray
            covariance[points, points] += by_constants @ self.problem.range_covariance @ by_constants.T
        for i, t in enumerate(self.targets):
            block = slice(self.rows_places + 3 * i, self.rows_places + 3 * i + 3)
            covariance[block, block] = self.problem.surveyed[t].covariance_m2
        prior = slice(self.rows_prior, self.size)
        covariance[prior, prior] = np.diag(self.prior_std**2)
