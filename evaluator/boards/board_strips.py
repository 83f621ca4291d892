"""Which further strip would determine the camera's mounting: predicted from the normal equations, before anybody flies it."""

from dataclasses import replace

import numpy as np

from evaluator.boards.board_model import BoardProblem, Views, observation_covariance, remap
from evaluator.frames import euler_rotation

_OTHER_HEIGHT = 1.4  # times the flown one
_OTHER_SPEED = 1.6
_LATER_S = 30.0  # between the last strip and the one that is thought of
FREE_DATUM_M = 1.0  # of a horizontal shift of all boards against the navigation that nothing is known of


def rank_and_condition(design: np.ndarray, inverse_covariance: np.ndarray) -> tuple[int, float | None]:
    """Rank and condition of the whitened Jacobian of S7, each column scaled to one; priors are not in it.

    Columns that are alike to 1e-6 count as one. A flight may keep full rank and tell two parameters apart by nothing but noise:
    `not_determined` judges by deviations and correlations, these two figures go with it. No condition without full rank.
    """
    normal = design.T @ inverse_covariance @ design
    scale = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(normal / np.outer(scale, scale)), 0.0))
    rank = int(np.sum(values > 1e-6 * values[-1]))
    return rank, float(values[-1] / values[0]) if rank == len(values) else None


def predicted_std(problem: BoardProblem, views: Views, xi: np.ndarray, datum_std_m: float = 0.0) -> np.ndarray:
    """(6,) standard deviations of xi, rad and m, that observations from these views would give.

    With `datum_std_m` all boards may be shifted together, east and north, against the navigation: what only one heading sees
    as a lever arm then has no small deviation any more, whereas opposite or perpendicular headings part the two. [m]
    """
    at = remap(problem, views, xi)
    design = at.by_xi.reshape(-1, 6)
    shifts = datum_std_m * at.by_place.reshape(-1, 3)[:, :2]
    normal = design.T @ np.linalg.solve(observation_covariance(problem, views, at) + shifts @ shifts.T, design)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(normal + np.diag(problem.prior_std**-2.0)))))


def _copied(
    problem: BoardProblem, views: Views, xi: np.ndarray, turn_rad: float, stretch: float, faster: float
) -> Views:
    """A flown strip once more: turned about the vertical through the boards' middle, stretched about it, at another speed."""
    middle = problem.places_m[np.unique(views.board)].mean(axis=0)
    turn = euler_rotation(np.array(0.0), np.array(0.0), np.array(turn_rad))
    copy = replace(
        views,
        body_m=middle + stretch * (views.body_m - middle) @ turn.T,
        world_from_body=turn @ views.world_from_body,
        velocity_m_s=faster * views.velocity_m_s @ turn.T,
        turn_rate_rad_s=views.turn_rate_rad_s @ turn.T,
        time_s=views.time_s + _LATER_S + float(np.ptp(views.time_s)),
    )
    uv = remap(problem, copy, xi).uv_px
    with np.errstate(invalid="ignore"):
        inside = np.all((uv >= 0.0) & (uv <= np.array(problem.image_size_px)), axis=1)
    return copy.rows(inside)


def helping_strips(problem: BoardProblem, views: Views, xi: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Further strips, one at a time, and the standard deviations that each would leave, a datum shift being free.

    The richest strip of each sortie is flown once more with the same boards and as many images: on the opposite heading, on a
    perpendicular one, at 1.4 times its height (a sortie of its own), and, where clocks are not synchronised, at another speed.

    Returns
    -------
    list of (name, (6,) np.ndarray of standard deviations, rad and m)
    """
    sortie = int(np.bincount(views.sortie).argmax())
    own = views.sortie == sortie
    strip = int(np.bincount(views.strip[own]).argmax())
    base = views.rows(own & (views.strip == strip))
    last = float(views.time_s[own].max())
    base_in_time = replace(base, time_s=base.time_s + last - float(base.time_s.max()))
    height = float(np.mean(base.body_m[:, 2] - problem.places_m[base.board, 2]))
    ahead = base.world_from_body[0, :, 0]
    heading = float(np.degrees(np.arctan2(ahead[0], ahead[1])) % 360.0)
    speed = float(np.mean(np.linalg.norm(base.velocity_m_s, axis=1)))
    new = replace(base, sortie=np.full(len(base.sortie), int(views.sortie.max()) + 1))
    options = [
        (f"the opposite heading ({(heading + 180.0) % 360.0:.0f} deg)", base_in_time, np.pi, 1.0, 1.0),
        (f"a perpendicular heading ({(heading + 90.0) % 360.0:.0f} deg)", base_in_time, -0.5 * np.pi, 1.0, 1.0),
        (f"another height ({_OTHER_HEIGHT * height:.0f} m)", new, 0.0, _OTHER_HEIGHT, 1.0),
    ]
    if problem.rig.camera.clock_std_s > 0.0:
        options.append((f"another speed ({_OTHER_SPEED * speed:.1f} m/s)", base_in_time, 0.0, 1.0, _OTHER_SPEED))
    out = []
    for name, copy, turn, stretch, faster in options:
        more = _copied(problem, copy, xi, turn, stretch, faster)
        if len(more.board):
            out.append((name, predicted_std(problem, views.with_more(more), xi, FREE_DATUM_M)))
    return out or [("none of the strips that were tried", predicted_std(problem, views, xi, FREE_DATUM_M))]
