"""Gauss-Newton on the boards' centres (S7), and blunders among them: boards at a wrong place, swapped names, single centres.

A first solution by the most consistent three boards, then tests of every board as a whole and of every observation under full
correlation, until nothing contradicts the rest. What comes of the solution is `mounting_by_boards`'s subject.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy.linalg
import scipy.stats

from evaluator.boards.board_model import (
    BoardProblem,
    Views,
    carried_px,
    corrected,
    navigation_errors,
    observation_covariance,
    remap,
)
from evaluator.model import EvaluationError

LEAST_BOARDS = 3
_BLUNDER = 1e-5  # tail probability below which an observation or a board contradicts the others
_FITS = 1e-4  # above which a board fits at another one's place
_MOST_REJECTED = 0.5  # of all observations
_GROSS_PX, _GROSS_SIGMAS = 15.0, 8.0  # of a board's median residual against the most consistent boards
_MOST_SUBSETS = 60
_LEAST_SHIFT_PX = 0.05  # less, in a single centre, is no blunder however sharp the centre is stated


@dataclass(frozen=True, kw_only=True)
class BoardFitted:
    xi: np.ndarray
    covariance: np.ndarray  # (6, 6)
    inverse_covariance: np.ndarray  # (2 n, 2 n) of the observations
    design: np.ndarray  # (2 n, 6)
    by_place: np.ndarray  # (2 n, 3)
    residual: np.ndarray  # (2 n,) against the poses of navigation, linear about `views`
    iterations: int
    views: Views  # the poses as corrected


def gauss_newton(problem: BoardProblem, views: Views, uv: np.ndarray, start: np.ndarray) -> BoardFitted:
    """S7: until no parameter moves by more than 1e-7 of its standard deviation.

    Rows are whitened by the Cholesky factor of their covariance and solved by an orthogonal decomposition: navigation makes
    neighbours so alike (condition 5e7 for an APX-15) that the normal equations' rounding would move the parameters for ever.
    Each step is linear about the poses as the pixels correct them, not as navigation has them: half a metre and half a degree
    of it bend pixels by tenths, which sharp centres would take for blunders.
    """
    xi = start.copy()
    prior = np.diag(1.0 / problem.prior_std)
    n = len(uv)
    moved, errors = views, np.zeros((n, 6))
    for iteration in range(1, 31):
        at = remap(problem, moved, xi)
        residual = (uv - at.uv_px).ravel() + carried_px(moved, at, errors)
        if not np.all(np.isfinite(residual)):
            raise EvaluationError(
                "a board's predicted pixel left the camera's field", remedy="check rig.json's nominal mounting"
            )
        design = at.by_xi.reshape(2 * n, 6)
        half = np.linalg.cholesky(observation_covariance(problem, moved, at))
        white = scipy.linalg.solve_triangular(half, np.column_stack([design, residual]), lower=True)
        q, r = np.linalg.qr(np.concatenate([white[:, :6], prior]))
        step = scipy.linalg.solve_triangular(r, q.T @ np.concatenate([white[:, 6], -prior @ xi]))
        back = scipy.linalg.solve_triangular(r, np.eye(6))
        covariance = back @ back.T
        xi = xi + step
        if np.all(np.abs(step) < 1e-7 * np.sqrt(np.diag(covariance))):
            at = remap(problem, moved, xi)
            return BoardFitted(
                xi=xi,
                covariance=covariance,
                inverse_covariance=scipy.linalg.cho_solve((half, True), np.eye(2 * n)),
                design=design,
                by_place=at.by_place.reshape(2 * n, 3),
                residual=(uv - at.uv_px).ravel() + carried_px(moved, at, errors),
                iterations=iteration,
                views=moved,
            )
        weighted = scipy.linalg.solve_triangular(half.T, white[:, 6] - white[:, :6] @ step)
        errors = navigation_errors(problem, moved, at, weighted)
        moved = corrected(views, errors)
    raise EvaluationError("the adjustment of the boards does not converge", got="30 iterations")


def _most_consistent(problem: BoardProblem, views: Views, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Robust first values: the three boards whose mounting leaves the least median residual over all boards.

    Returns
    -------
    xi : (6,) np.ndarray
    gross : (b,) bool np.ndarray
        Boards far off under that mounting.
    wild : (n,) bool np.ndarray
        Observations far off under it.
    """
    count = len(problem.boards)
    triples = list(combinations(range(count), 3))
    rng = np.random.default_rng(1)
    if len(triples) > _MOST_SUBSETS:
        triples = [triples[i] for i in rng.choice(len(triples), _MOST_SUBSETS, replace=False)]
    weight = np.diag(problem.prior_std**-2.0)
    best, best_score, best_norms, each = np.zeros(6), np.inf, np.zeros(count), np.zeros(len(uv))
    for triple in triples:
        rows = np.flatnonzero(np.isin(views.board, triple))
        part = views.rows(rows)
        xi = np.zeros(6)
        for _ in range(4):
            at = remap(problem, part, xi)
            a, r = at.by_xi.reshape(-1, 6), (uv[rows] - at.uv_px).ravel()
            if not np.all(np.isfinite(r)):
                break
            xi = xi + np.linalg.solve(a.T @ a + weight, a.T @ r - weight @ xi)
        norm = np.linalg.norm(uv - remap(problem, views, xi).uv_px, axis=1)
        norms = np.array([np.median(np.nan_to_num(norm[views.board == b], nan=1e9)) for b in range(count)])
        score = float(np.median(norms))
        if score < best_score:
            best, best_score, best_norms, each = xi, score, norms, np.nan_to_num(norm, nan=1e9)
    limit = _GROSS_PX + _GROSS_SIGMAS * best_score
    return best, best_norms > limit, each > limit


def _tests(fit: BoardFitted, views: Views) -> list[tuple[float, bool, np.ndarray]]:
    """-log of the tail probability of every board as a whole (its place shifted) and of every observation.

    With W = V^-1 - V^-1 A N^-1 A' V^-1 and the rows B of a group, s = B' V^-1 r gives s' (B' W B)^-1 s, chi-square distributed.
    Directions that the others hardly control (redundancy below 1 %) are left out, and so are shifts of a single centre that no
    stated deviation would call a blunder: real pictures err by hundredths of a pixel in ways that residuals do not show.

    Returns
    -------
    list of (tail, whether a whole board, rows of the observations)
    """
    inverse, projected = fit.inverse_covariance, fit.inverse_covariance @ fit.design
    w = inverse - projected @ fit.covariance @ projected.T
    wy = inverse @ fit.residual
    whole_boards = [np.flatnonzero(views.board == b) for b in np.unique(views.board)]
    groups = [(rows, True) for rows in whole_boards if len(rows) > 1]
    groups += [(np.array([i]), False) for i in range(len(views.board))]
    out = []
    for rows, whole in groups:
        each = (2 * rows[:, None] + np.arange(2)).ravel()
        b = fit.by_place[each] if whole else np.eye(2)
        score = b.T @ wy[each]
        own = b.T @ inverse[np.ix_(each, each)] @ b
        values, axes = np.linalg.eigh(own)
        seen = values > 1e-8 * values[-1]  # images from one place do not see a shift along their ray
        scale = (axes[:, seen] / np.sqrt(values[seen])).T
        redundancy, vectors = np.linalg.eigh(scale @ (b.T @ w[np.ix_(each, each)] @ b) @ scale.T)
        along = vectors.T @ (scale @ score)
        testable = redundancy > 0.01
        shift = scale.T @ (vectors[:, testable] @ (along[testable] / redundancy[testable]))
        freedom = int(testable.sum()) if whole or np.linalg.norm(shift) >= _LEAST_SHIFT_PX else 0
        statistic = float(np.sum(along[testable] ** 2 / redundancy[testable]))
        tail = -float(scipy.stats.chi2.logsf(statistic, freedom)) if freedom else 0.0
        out.append((tail, whole, rows))
    return out


def place_shift(
    problem: BoardProblem, views: Views, uv: np.ndarray, fit: BoardFitted, rows: np.ndarray, board: int
) -> tuple[np.ndarray, float]:
    """(shift of a board's place that its observations ask for, east north up [m]; tail probability that there is none)."""
    part = replace(views.rows(rows), board=np.full(len(rows), board))
    at = remap(problem, part, fit.xi)
    residual = (uv[rows] - at.uv_px).ravel()
    if not np.all(np.isfinite(residual)):
        return np.full(3, np.nan), 0.0
    design = at.by_xi.reshape(-1, 6)
    place = at.by_place.reshape(-1, 3)
    inverse = np.linalg.inv(observation_covariance(problem, part, at) + design @ fit.covariance @ design.T)
    normal = place.T @ inverse @ place
    shift = np.linalg.lstsq(normal, place.T @ inverse @ residual, rcond=1e-9)[0]
    return shift, float(scipy.stats.chi2.sf(residual @ inverse @ residual, len(residual)))


def swapped_pairs(
    problem: BoardProblem, views: Views, uv: np.ndarray, fit: BoardFitted, out: dict[int, np.ndarray]
) -> list[tuple[int, int]]:
    """Pairs among the boards left out that both fit when their names are exchanged."""
    pairs = []
    for a, b in combinations(sorted(out), 2):
        fits = [place_shift(problem, views, uv, fit, out[i], j)[1] for i, j in ((a, b), (b, a))]
        if min(fits) > _FITS:
            pairs.append((a, b))
    return pairs


def without_blunders(
    problem: BoardProblem, views: Views, uv: np.ndarray
) -> tuple[BoardFitted, np.ndarray, dict[int, np.ndarray], list[int]]:
    """The fit without what contradicts it.

    Returns
    -------
    fit : BoardFitted
    use : (n,) bool np.ndarray
    boards : dict
        Board left out -> its observations.
    single : list of int
        Observations left out one by one.
    """
    use = np.ones(len(uv), dtype=bool)
    boards: dict[int, np.ndarray] = {}
    single: list[int] = []
    start = np.zeros(6)
    if len(problem.boards) > LEAST_BOARDS:
        start, gross, wild = _most_consistent(problem, views, uv)
        for b in np.flatnonzero(gross):
            boards[int(b)] = np.flatnonzero(views.board == b)
            use[boards[int(b)]] = False
        single = [int(i) for i in np.flatnonzero(use & wild)]
        use[single] = False
    while True:
        kept = np.flatnonzero(use)
        if len(np.unique(views.board[kept])) < LEAST_BOARDS or len(kept) < _MOST_REJECTED * len(uv):
            raise EvaluationError(
                "the boards contradict each other",
                got=f"{len(uv) - len(kept)} of {len(uv)} observations do not fit",
                remedy="check time stamps, nominal mounting and survey coordinates",
            )
        fit = gauss_newton(problem, views.rows(kept), uv[kept], start)
        worst = max(_tests(fit, views.rows(kept)), key=lambda test: test[0])
        if worst[0] < -np.log(_BLUNDER):
            return fit, use, boards, single
        rows = kept[worst[2]]
        if worst[1]:
            boards[int(views.board[rows[0]])] = np.flatnonzero(views.board == views.board[rows[0]])
            use[views.board == views.board[rows[0]]] = False
        else:
            single.append(int(rows[0]))
            use[rows[0]] = False
        start = fit.xi
