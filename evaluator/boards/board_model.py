"""The patent's camera: remapping function (11) with its derivatives, and what makes its pixels err (S3, S5, S6).

Unknown is xi = [alpha beta gamma dx dy dz]. Everything else that is not known exactly is part of the observations' covariance:
pixels, the survey (one board's place errs alike in all its images), navigation (nearby times of one flight err alike), lens and
clock (all images alike). The solver and its tests live in `mounting_by_boards`.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from campaign.config import Lens
from campaign.flight.trajectory import Trajectory
from campaign.sensors import Rig
from evaluator.boards.board_observations import BoardObservation
from evaluator.camera_model import project_with_jacobian
from evaluator.frames import WorldFrame, body_pose, euler_angles, euler_rates, euler_rotation
from evaluator.georeference import nominal_mountings
from evaluator.mounting.mounting_model import mounting_of, navigation_covariance, observe_points

_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_CLOCK_STEP_S = 0.005  # over which the pixel's change with time is taken, to both sides


@dataclass(frozen=True, kw_only=True)
class Views:
    """From where each observation was made: one row each."""

    board: np.ndarray  # (n,) index into the problem's boards
    sortie: np.ndarray  # (n,)
    strip: np.ndarray  # (n,)
    time_s: np.ndarray  # (n,)
    body_m: np.ndarray  # (n, 3) estimated position t_BW
    world_from_body: np.ndarray  # (n, 3, 3) estimated attitude R_BW
    velocity_m_s: np.ndarray  # (n, 3) world
    turn_rate_rad_s: np.ndarray  # (n, 3) of the body, about world axes
    covariance_px2: np.ndarray  # (n, 2, 2)

    def rows(self, index: np.ndarray) -> "Views":
        """The rows `index` (integers or mask)."""
        return Views(**{f.name: getattr(self, f.name)[index] for f in fields(Views)})

    def with_more(self, other: "Views") -> "Views":
        """Both, one after the other."""
        return Views(**{f.name: np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(Views)})


@dataclass(frozen=True, kw_only=True)
class BoardProblem:
    """Everything that S5 to S7 use, apart from the pixels."""

    rig: Rig
    lens: Lens
    lens_covariance: np.ndarray  # (9, 9)
    image_size_px: tuple[int, int]
    boards: tuple[str, ...]
    places_m: np.ndarray  # (b, 3) surveyed centres in the world
    place_covariance_m2: np.ndarray  # (b, 3, 3)
    prior_std: np.ndarray  # (6,) of xi, rad and m


@dataclass(frozen=True, kw_only=True)
class Remapped:
    """(11) at every observation, with derivatives."""

    uv_px: np.ndarray  # (n, 2)
    by_xi: np.ndarray  # (n, 2, 6)
    by_place: np.ndarray  # (n, 2, 3) by the board's centre in the world
    by_attitude: np.ndarray  # (n, 2, 3) by a small turn of the body about world axes
    by_lens: np.ndarray  # (n, 2, 9)


def views_of(
    observations: list[BoardObservation],
    boards: tuple[str, ...],
    trajectories: dict[int, Trajectory],
    world_frame: WorldFrame,
) -> Views:
    """Position and attitude at each observation's time, by the sorties' trajectories."""
    n = len(observations)
    sortie = np.array([o.sortie for o in observations], dtype=np.int64)
    time = np.array([o.gps_time_s for o in observations], dtype=np.float64)
    body, rotation = np.zeros((n, 3)), np.zeros((n, 3, 3))
    velocity, rate = np.zeros((n, 3)), np.zeros((n, 3))
    for number in np.unique(sortie):
        rows = np.flatnonzero(sortie == number)
        trajectory = trajectories[int(number)]
        body[rows], rotation[rows] = body_pose(trajectory, time[rows], world_frame)
        span = trajectory.gps_time_s[[0, -1]]
        low, high = (np.clip(time[rows] + s, *span) for s in (-_CLOCK_STEP_S, _CLOCK_STEP_S))
        (p0, r0), (p1, r1) = (body_pose(trajectory, t, world_frame) for t in (low, high))
        step = np.maximum(high - low, 1e-9)[:, None]
        velocity[rows] = (p1 - p0) / step
        turn = r1 @ np.swapaxes(r0, -1, -2)
        rate[rows] = 0.5 * np.stack(
            [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
        )
        rate[rows] /= step
    return Views(
        board=np.array([boards.index(o.target) for o in observations], dtype=np.int64),
        sortie=sortie,
        strip=np.array([o.strip for o in observations], dtype=np.int64),
        time_s=time,
        body_m=body,
        world_from_body=rotation,
        velocity_m_s=velocity,
        turn_rate_rad_s=rate,
        covariance_px2=np.array([o.covariance_px2 for o in observations]).reshape(-1, 2, 2),
    )


def remap(problem: BoardProblem, views: Views, xi: np.ndarray, place_m: np.ndarray | None = None) -> Remapped:
    """Remapping function (11): s [u v 1] = K R_CB^-1 dR^-1 (R_BW^-1 (P_W - t_BW) - t_CB - dt), then the lens's distortion.

    Parameters
    ----------
    problem : BoardProblem
    views : Views
        n observations.
    xi : (6,) np.ndarray
        alpha, beta, gamma of dR = Rz(gamma) Ry(beta) Rx(alpha) [rad], dx, dy, dz [m], body axes.
    place_m : (n, 3) np.ndarray, optional
        Board centres; the surveyed ones when absent. [m]

    Returns
    -------
    Remapped

    References
    ----------
    The patent's steps S3 and S5, (1)-(11).
    """
    mounting = mounting_of(nominal_mountings(problem.rig)[0], np.asarray(xi, dtype=np.float64))
    places = problem.places_m[views.board] if place_m is None else place_m
    p, by_xi, by_place, by_attitude = observe_points(mounting, xi[:3], views.body_m, views.world_from_body, places)
    uv, by_point, by_lens = project_with_jacobian(problem.lens, p)
    return Remapped(
        uv_px=uv,
        by_xi=by_point @ by_xi,
        by_place=by_point @ by_place,
        by_attitude=by_point @ by_attitude,
        by_lens=by_lens,
    )


def _by_navigation(views: Views, at: Remapped) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the pixels by the navigation's north, east, down and by its roll, pitch, heading: (n, 2, 3) each."""
    axes = _ENU_FROM_NED @ euler_rates(euler_angles(_ENU_FROM_NED.T @ views.world_from_body))
    return -at.by_place @ _ENU_FROM_NED, at.by_attitude @ axes


def navigation_part(problem: BoardProblem, views: Views, at: Remapped) -> np.ndarray:
    """Covariance of all pixels from what moves whole images: navigation, and the clock against it.

    Returns
    -------
    (2 n, 2 n) np.ndarray, row order u v of each observation.
    """
    by_position, by_attitude = _by_navigation(views, at)
    total = navigation_covariance(
        by_position.reshape(-1, 3),
        by_attitude.reshape(-1, 3),
        np.repeat(views.time_s, 2),
        np.repeat(views.sortie, 2),
        problem.rig.navigation,
    )
    clock = at.by_attitude @ views.turn_rate_rad_s[:, :, None] - at.by_place @ views.velocity_m_s[:, :, None]
    drift = clock.ravel()
    return np.asarray(total + problem.rig.camera.clock_std_s**2 * np.outer(drift, drift))


def navigation_errors(problem: BoardProblem, views: Views, at: Remapped, weighted: np.ndarray) -> np.ndarray:
    """What the navigation must be corrected by, most probably, at every observation: C J' V^-1 (r - A dxi).

    Parameters
    ----------
    weighted : (2 n,) np.ndarray
        V^-1 (r - A dxi).

    Returns
    -------
    (n, 6) np.ndarray
        North, east, down [m], roll, pitch, heading [rad].
    """
    sheet = problem.rig.navigation
    apart = np.where(
        views.sortie[:, None] == views.sortie[None], np.abs(views.time_s[:, None] - views.time_s[None]), np.inf
    )
    out = []
    for by, std, correlation in zip(
        _by_navigation(views, at),
        (np.asarray(sheet.position_std_m), np.radians(np.asarray(sheet.attitude_std_deg))),
        (sheet.position_correlation_s, sheet.attitude_correlation_s),
        strict=True,
    ):
        pull = np.einsum("nka,nk->na", by, weighted.reshape(-1, 2))
        out.append(std**2 * (np.exp(-apart / correlation) @ pull))
    return np.concatenate(out, axis=1)


def corrected(views: Views, errors: np.ndarray) -> Views:
    """Views with position and attitude corrected by `navigation_errors`."""
    rpy = euler_angles(_ENU_FROM_NED.T @ views.world_from_body) + errors[:, 3:]
    return replace(
        views,
        body_m=views.body_m + errors[:, :3] @ _ENU_FROM_NED.T,
        world_from_body=_ENU_FROM_NED @ euler_rotation(*rpy.T),
    )


def carried_px(views: Views, at: Remapped, errors: np.ndarray) -> np.ndarray:
    """(2 n,) pixels by which `errors` move the observations, linear at these views: J e. [px]"""
    by_position, by_attitude = _by_navigation(views, at)
    moved = by_position @ errors[:, :3, None] + by_attitude @ errors[:, 3:, None]
    return np.asarray(moved.ravel())


def observation_covariance(problem: BoardProblem, views: Views, at: Remapped) -> np.ndarray:
    """Covariance of all pixels from everything: pixel, survey, lens, navigation, clock.

    Returns
    -------
    (2 n, 2 n) np.ndarray, row order u v of each observation.
    """
    n = len(views.board)
    total = navigation_part(problem, views, at)
    each = np.arange(2 * n).reshape(n, 2)
    total[each[:, :, None], each[:, None, :]] += views.covariance_px2
    lens = at.by_lens.reshape(2 * n, 9)
    total += lens @ problem.lens_covariance @ lens.T
    place = at.by_place.reshape(2 * n, 3)
    board = np.repeat(views.board, 2)
    spread = (place[:, None, :] @ problem.place_covariance_m2[board])[:, 0]
    return np.asarray(total + np.where(board[:, None] == board[None, :], spread @ place.T, 0.0))
