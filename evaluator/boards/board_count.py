"""The adjustment once more on the whole pixels of S4's half-window count, for comparison with the sub-pixel centres."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from evaluator.boards.board_blunders import LEAST_BOARDS, BoardFitted, gauss_newton
from evaluator.boards.board_model import BoardProblem, Views
from evaluator.boards.board_observations import BoardObservation
from evaluator.model import EvaluationError

LEAST_OBSERVATIONS = 4
_COUNT_STD_PX = 0.35  # of the half-window count: rounding to whole pixels, and its noise
_MOST_AWAY_PX = 5.0 * _COUNT_STD_PX  # from the fit; a shadow or a leaf moves the count by a third of the board


def by_count(
    problem: BoardProblem, views: Views, observations: Sequence[BoardObservation], fit: BoardFitted, units: np.ndarray
) -> dict[str, object]:
    """What the count alone would give, in `units` per rad and m; counts far from their centre are left out and named.

    The spread and the mean distance are those of all counts.
    """
    rows = np.array([i for i, o in enumerate(observations) if o.count_px is not None], dtype=np.int64)
    if not len(rows):
        return {}
    apart = np.array([observations[i].count_px - observations[i].uv_px for i in rows], dtype=np.float64)
    away = np.linalg.norm(apart, axis=1)
    wild = away > _MOST_AWAY_PX
    out: dict[str, object] = {
        "observations": int(np.sum(~wild)),
        "spread_against_fit_px": float(np.std(apart)),
        "mean_distance_to_fit_px": float(np.mean(away)),
        "left_out": [
            f"{observations[i].target} in {observations[i].image}: {d:.1f} px from its centre"
            for i, d in zip(rows[wild], away[wild], strict=True)
        ],
    }
    rows = rows[~wild]
    if len(rows) < LEAST_OBSERVATIONS or len(np.unique(views.board[rows])) < LEAST_BOARDS:
        return out
    counts = np.array([observations[i].count_px for i in rows], dtype=np.float64)
    part = replace(views.rows(rows), covariance_px2=np.tile(_COUNT_STD_PX**2 * np.eye(2), (len(rows), 1, 1)))
    try:
        own = gauss_newton(problem, part, counts, fit.xi)
    except EvaluationError:
        return out
    return out | {
        "estimates": [float(v) for v in own.xi * units],
        "std": [float(v) for v in np.sqrt(np.diag(own.covariance)) * units],
        "mean_residual_px": float(np.mean(np.linalg.norm(own.residual.reshape(-1, 2), axis=1))),
    }
