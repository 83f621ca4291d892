"""The strip that would determine what a flight did not: predicted by adding it, without values, to the adjustment.

A hypothetical strip passes over the middle of the surveyed targets, level and straight, 60 s after the last observation of the
sortie whose strip it copies (so it shares that sortie's navigation errors as a real one would). Both sensors observe it as they
observed the others: with the median variance of their marks, vertices and planes, marks only where the image holds them. Nothing is
solved; only the covariance of a flight with it is formed. The rule of "not determined" is stated here too.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
import scipy.linalg

from campaign.config import Lens
from campaign.flight.trajectory import Trajectory
from evaluator.body_rates import body_rates
from evaluator.camera_model import project
from evaluator.frames import WorldFrame, body_pose, euler_angles, euler_rotation
from evaluator.model import EvaluationError, MarkObservation, Mounting, PlaneObservation, VertexObservation
from evaluator.mounting.mounting_model import Problem, System

PRIOR_SHARE, CORRELATED = 0.5, 0.95  # not determined: sigma above this share of its prior, or a correlation beyond this
_AFTER_S = 60.0
_FASTEST_M_S = {"multirotor": 16.0, "fixed_wing": 30.0}  # 7.3
_HOVERING_M_S, _USUAL_M_S = 0.1, 5.0  # below it there is no course; what a candidate flies where nothing flew
_STEP_S = 0.01
_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, kw_only=True)
class Strip:
    """A strip as flown or as it might be."""

    name: str
    sortie: int
    heading_rad: float  # of its course, clockwise from north
    height_m: float  # above the targets
    speed_m_s: float
    shots_m: tuple[float, ...]  # where along it the camera exposes, from the middle of the targets


@dataclass(frozen=True, kw_only=True)
class Weak:
    """One parameter that the flight does not determine, and what would help."""

    name: str
    std: float  # rad, m or s
    prior_std: float
    partner: str  # the other parameter of the same sensor that it correlates with most
    correlation: float
    strip: str  # the best of the candidates
    strip_std: float  # with it
    strip_correlation: float  # largest of the same sensor, with it
    strip_determines: bool

    def block(self) -> dict[str, object]:
        """For results.json; in degrees, metres or seconds."""
        scale = np.degrees(1.0) if "boresight" in self.name else 1.0
        return {
            "name": self.name,
            "std": float(self.std * scale),
            "prior_std": float(self.prior_std * scale),
            "partner": self.partner,
            "correlation": self.correlation,
            "strip_that_would_help": self.strip,
            "std_with_it": float(self.strip_std * scale),
            "correlation_with_it": self.strip_correlation,
            "determined_with_it": self.strip_determines,
        }


def weak_parameters(
    names: tuple[str, ...], covariance: np.ndarray, prior_std: np.ndarray
) -> dict[str, tuple[float, str, float]]:
    """Parameters whose standard deviation is above half its prior or that correlate with another of the same sensor's beyond 0.95.

    Returns
    -------
    dict
        name -> (standard deviation, partner, correlation with it).
    """
    std = np.sqrt(np.diag(covariance))
    partner, strongest = _partners(names, covariance)
    weak = (std > PRIOR_SHARE * prior_std) | (np.abs(strongest) > CORRELATED)
    return {names[k]: (float(std[k]), names[partner[k]], float(strongest[k])) for k in np.flatnonzero(weak)}


def _partners(names: tuple[str, ...], covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(index of the most correlated parameter of the same sensor, that correlation) for each parameter."""
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(std, std)
    sensor = np.array([name.split("_")[0] for name in names])
    own = np.where(sensor[:, None] == sensor, correlation, 0.0)
    partner = (np.abs(own) - 2.0 * np.eye(len(names))).argmax(axis=1)
    return partner, own[np.arange(len(names)), partner]


def flown_strips(problem: Problem) -> list[Strip]:
    """Course, height and speed of every strip with observations, from the trajectory at their middle. Of one that hovered
    nothing but the height; it counts, to the north at a usual speed, where no other flew."""
    centre = np.mean([s.mark_world_m for s in problem.surveyed.values()], axis=0)
    times: dict[tuple[int, int], list[float]] = {}
    images: dict[tuple[int, int], set[float]] = {}
    seen: list[MarkObservation | VertexObservation] = [*problem.marks, *problem.vertices]
    for o in seen:
        times.setdefault((o.sortie, o.strip), []).append(o.gps_time_s)
    for m in problem.marks:
        images.setdefault((m.sortie, m.strip), set()).add(round(m.gps_time_s, 2))
    out: list[Strip] = []
    hovered: list[Strip] = []
    for (sortie, number), at in sorted(times.items()):
        trajectory = problem.trajectories[sortie]
        middle = np.array([0.5 * (min(at) + max(at))])
        position, _ = body_pose(trajectory, middle, problem.world_frame)
        velocity = body_rates(trajectory, middle, problem.world_frame)[0][0]
        speed = float(np.hypot(*velocity[:2]))
        still = speed < _HOVERING_M_S
        along = np.array([0.0, 1.0, 0.0]) if still else np.array([*velocity[:2] / speed, 0.0])
        shots = np.array(sorted(images.get((sortie, number), set())))
        places = body_pose(trajectory, shots, problem.world_frame)[0] - centre
        (hovered if still else out).append(
            Strip(
                name=f"strip {number} of sortie {sortie}",
                sortie=sortie,
                heading_rad=float(np.arctan2(along[0], along[1])),
                height_m=float(position[0, 2] - centre[2]),
                speed_m_s=_USUAL_M_S if still else speed,
                shots_m=tuple(float(v) for v in np.unique(np.round(places @ along, 1))),
            )
        )
    return out or hovered


def candidate_strips(flown: list[Strip], kind: str = "multirotor") -> list[Strip]:
    """What a pilot could fly besides: back along the first strip, across it, half as high again as the highest, at three times
    the greatest speed as far as 7.3 allows it (16 m/s, fixed wing 30 m/s), else at a third of the least."""
    first = flown[0]
    height = 1.5 * max(s.height_m for s in flown)
    fastest = max(s.speed_m_s for s in flown)
    speed = min(3.0 * fastest, _FASTEST_M_S[kind])
    if speed < 1.5 * fastest:
        speed = min(s.speed_m_s for s in flown) / 3.0
    return [
        replace(first, name="opposite heading", heading_rad=first.heading_rad + np.pi),
        replace(first, name="perpendicular heading", heading_rad=first.heading_rad + np.pi / 2.0),
        replace(first, name=f"another height ({height:.0f} m)", height_m=height),
        replace(first, name=f"another speed ({speed:.1f} m/s)", speed_m_s=speed),
    ]


def _extended(trajectory: Trajectory, more: Trajectory) -> Trajectory:
    return Trajectory(
        **{f.name: np.concatenate([getattr(trajectory, f.name), getattr(more, f.name)]) for f in fields(Trajectory)}
    )


def _level_flight(world_frame: WorldFrame, strip: Strip, centre_m: np.ndarray, time_s: np.ndarray) -> Trajectory:
    """A straight level strip; the middle of `time_s` is over the centre."""
    along = np.array([np.sin(strip.heading_rad), np.cos(strip.heading_rad), 0.0])
    local = time_s - 0.5 * (time_s[0] + time_s[-1])
    position = centre_m + np.array([0.0, 0.0, strip.height_m]) + strip.speed_m_s * local[:, None] * along
    lat, lon, height = world_frame.geodetic_from_world(position)
    level = _ENU_FROM_NED @ euler_rotation(*np.array([0.0, 0.0, strip.heading_rad]))
    rpy = euler_angles(np.swapaxes(world_frame.world_from_local_ned(lat, lon), -1, -2) @ level)
    zero = np.zeros((len(time_s), 3))
    return Trajectory(
        gps_time_s=time_s,
        latitude_rad=lat,
        longitude_rad=lon,
        ellipsoid_height_m=height,
        roll_rad=rpy[:, 0],
        pitch_rad=rpy[:, 1],
        heading_rad=rpy[:, 2] % (2.0 * np.pi),
        velocity_ned_m_s=zero,
        acceleration_body_m_s2=zero,
        angular_rate_body_rad_s=zero,
        position_std_m=zero,
        attitude_std_rad=zero,
    )


def _in_image(lens: Lens, uv_px: np.ndarray) -> np.ndarray:
    """The image's size is not part of the problem: twice the principal point is near enough."""
    return np.asarray(np.all((uv_px > 0.0) & (uv_px < [2.0 * lens.cx_px, 2.0 * lens.cy_px]), axis=1))


def with_strip(problem: Problem, strip: Strip, camera: Mounting, lidar: Mounting) -> Problem:
    """The problem with one strip more: observations with variances, at the values that the surveyed places give them."""
    centre = np.mean([s.mark_world_m for s in problem.surveyed.values()], axis=0)
    old = problem.trajectories[strip.sortie]
    seen = sorted({o.target for o in problem.marks} | {o.target for o in problem.vertices})
    places = np.array([problem.surveyed[t].mark_world_m for t in seen])
    along = np.array([np.sin(strip.heading_rad), np.cos(strip.heading_rad), 0.0])
    reach = np.abs((places - centre) @ along).max() + max(map(abs, strip.shots_m), default=0.0)
    half_s = reach / strip.speed_m_s + 1.0
    start = float(old.gps_time_s[-1]) + _AFTER_S
    time = start + np.arange(int(2.0 * half_s / _STEP_S) + 2) * _STEP_S
    middle = 0.5 * (time[0] + time[-1])
    flight = _level_flight(problem.world_frame, strip, centre, time)
    number = 1 + max([o.strip for o in problem.marks] + [o.strip for o in problem.vertices])
    marks: list[MarkObservation] = []
    vertices: list[VertexObservation] = []
    planes: list[PlaneObservation] = []

    def scanned(at_m: np.ndarray, offset_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """When the LiDAR passes these places, and what it measures."""
        times = middle + (at_m - centre) @ along / strip.speed_m_s
        body, rotation = body_pose(flight, times, problem.world_frame)
        in_body = np.einsum("nji,nj->ni", rotation, at_m + offset_m - body)
        return times, (in_body - lidar.lever_arm_m) @ lidar.rotation

    if problem.marks:
        variance = np.median([m.covariance_px2 for m in problem.marks], axis=0)
        for k, shot in enumerate(middle + np.array(strip.shots_m or (0.0,)) / strip.speed_m_s):
            body, rotation = body_pose(flight, np.array([shot]), problem.world_frame)
            p = ((places - body[0]) @ rotation[0] - camera.lever_arm_m) @ camera.rotation
            uv = project(problem.lens, p)
            marks += [
                MarkObservation(
                    target=seen[i],
                    sortie=strip.sortie,
                    strip=number,
                    image=f"{strip.name} {k}",
                    gps_time_s=float(shot),
                    uv_px=uv[i],
                    covariance_px2=variance,
                    radius_px=1.0,
                )
                for i in np.flatnonzero((p[:, 2] > 0.0) & _in_image(problem.lens, uv))
            ]
    if problem.vertices:
        variance = np.median([v.covariance_m2 for v in problem.vertices], axis=0)
        offset = np.array([problem.surveyed[t].vertex_from_mark_m for t in seen])
        scans, points = scanned(places, offset)
        vertices = [
            VertexObservation(
                target=target,
                sortie=strip.sortie,
                strip=number,
                gps_time_s=float(scan),
                time_spread_s=0.0,
                point_lidar_m=point,
                covariance_m2=variance,
                faces=4,
                points=1,
                rms_m=0.0,
            )
            for target, scan, point in zip(seen, scans, points, strict=True)
        ]
    if problem.planes:
        over = sorted({o.panel for o in problem.planes})
        std = float(np.median([o.std_m for o in problem.planes]))
        scans, points = scanned(np.array([problem.panels[p].centre_world_m for p in over]), np.zeros(3))
        planes = [
            PlaneObservation(
                panel=panel,
                sortie=strip.sortie,
                strip=number,
                gps_time_s=float(scan),
                point_lidar_m=point,
                std_m=std,
                points=1,
                rms_m=0.0,
            )
            for panel, scan, point in zip(over, scans, points, strict=True)
        ]
    return replace(
        problem,
        marks=problem.marks + tuple(marks),
        vertices=problem.vertices + tuple(vertices),
        planes=problem.planes + tuple(planes),
        trajectories={**problem.trajectories, strip.sortie: _extended(old, flight)},
    )


def predicted_covariance(problem: Problem, parameters: np.ndarray) -> np.ndarray:
    """Covariance of mounting parameters and clocks that the problem's geometry allows, at given parameters."""
    system = System(problem)
    linear = system.linearise(system.start(parameters))
    try:
        factor = np.linalg.cholesky(linear.covariance)
    except np.linalg.LinAlgError:
        raise EvaluationError("the covariance of the observations is not positive definite") from None
    white = scipy.linalg.solve_triangular(factor, linear.design, lower=True, check_finite=False)
    covariance = np.linalg.inv(white.T @ white)
    return np.asarray(covariance[: system.count, : system.count])


def helping_strips(problem: Problem, parameters: np.ndarray, covariance: np.ndarray) -> list[Weak]:
    """For each parameter that is not determined the candidate strip that leaves it best determined.

    Parameters
    ----------
    problem : Problem
        The observations that the adjustment kept; those of one sensor alone will do.
    parameters : (12 + clocks,) np.ndarray
        Where the prediction is made.
    covariance : (12 + clocks, 12 + clocks) np.ndarray
        What the flight gave.

    Returns
    -------
    list of Weak
        With the figures of the candidate that leaves the least standard deviation; empty where everything is determined.
        Only parameters of sensors that observed something are judged.
    """
    system = System(problem)
    sensors = (["camera"] if problem.marks else []) + (["lidar"] if problem.vertices else [])
    own = np.array([k for k, name in enumerate(system.names) if name.split("_")[0] in sensors])
    names = tuple(system.names[k] for k in own)
    prior = system.prior_std[own]
    weak = weak_parameters(names, covariance[np.ix_(own, own)], prior)
    flown = flown_strips(problem) if weak else []
    if not flown:
        return []
    camera, lidar = system.mountings(parameters)
    tried = []
    for strip in candidate_strips(flown, problem.rig.kind):
        wider = predicted_covariance(with_strip(problem, strip, camera, lidar), parameters)[np.ix_(own, own)]
        tried.append((strip.name, np.sqrt(np.diag(wider)), np.abs(_partners(names, wider)[1])))
    out = []
    for name, (std, partner, correlation) in weak.items():
        k = names.index(name)
        best = int(np.argmin([s[k] for _, s, _ in tried]))
        what, s, r = tried[best]
        out.append(
            Weak(
                name=name,
                std=float(std),
                prior_std=float(prior[k]),
                partner=partner,
                correlation=float(correlation),
                strip=what,
                strip_std=float(s[k]),
                strip_correlation=float(r[k]),
                strip_determines=bool(s[k] <= PRIOR_SHARE * prior[k] and r[k] <= CORRELATED),
            )
        )
    return out
