"""Which of the six parameters a flight leaves open, for what cause, and the strip that would help.

The strips themselves are flown in thought by `board_strips`.
"""

import numpy as np

from evaluator.boards.board_blunders import BoardFitted
from evaluator.boards.board_model import BoardProblem, Views
from evaluator.boards.board_strips import FREE_DATUM_M, helping_strips, predicted_std
from evaluator.mounting.mounting_model import PARAMETER_NAMES

NAMES = PARAMETER_NAMES[:6]
UNITS = ("deg", "deg", "deg", "m", "m", "m")
TO_UNITS = np.array([np.degrees(1.0)] * 3 + [1.0] * 3)
_PRIOR_SHARE, _CORRELATION = 0.5, 0.95  # beyond either a parameter is not determined
_DATUM_SHARE = (
    2.0  # growth of a deviation beyond which it rests on there being no shift of the boards against navigation
)
_HELPS = 0.8  # of the deviation a strip must leave, or less, to be called one that helps


def not_determined(
    problem: BoardProblem, views: Views, fit: BoardFitted, covariance: np.ndarray
) -> tuple[dict[str, object], ...]:
    """What this flight leaves open, and the strip that would help.

    Sigma above half its prior, or a correlation beyond 0.95; and sigma above half its prior, or twice what is stated, once all
    boards may be shifted against the navigation: on one heading a lever arm and such a shift are the same, and a sigma that
    rests on there being none is no determination, however many images or heights that heading has.
    """
    std = np.sqrt(np.diag(covariance))
    free = predicted_std(problem, views, fit.xi, FREE_DATUM_M)
    correlation = covariance / np.outer(std, std)
    off = np.abs(correlation - np.eye(6))
    most = _PRIOR_SHARE * problem.prior_std
    by_datum = (free > most) | (free > _DATUM_SHARE * std)
    weak = [i for i in range(6) if std[i] > most[i] or by_datum[i] or off[i].max() > _CORRELATION]
    if not weak:
        return ()
    strips = helping_strips(problem, views, fit.xi)
    entries: list[dict[str, object]] = []
    for i in weak:
        partner = int(np.argmax(off[i]))
        name, with_it = min(strips, key=lambda s: s[1][i])
        helps = bool(with_it[i] <= _HELPS * free[i])
        causes = {
            "prior": std[i] > most[i],
            "datum": by_datum[i] and std[i] <= most[i],
            "correlation": off[i, partner] > _CORRELATION,
        }
        words = {
            "prior": "its standard deviation is above half its prior",
            "datum": "the headings flown do not part it from a shift of all boards against the navigation",
            "correlation": f"it is tied to {NAMES[partner]}",
        }
        entries.append(
            {
                "parameter": NAMES[i],
                "unit": UNITS[i],
                "reason": " and ".join(words[c] for c, holds in causes.items() if holds)
                + ("" if helps else "; none of the strips that were tried would lessen it by a fifth"),
                "causes": [c for c, holds in causes.items() if holds],
                "std": float(std[i] * TO_UNITS[i]),
                "std_with_free_datum": float(free[i] * TO_UNITS[i]),
                "prior_std": float(problem.prior_std[i] * TO_UNITS[i]),
                "partner": NAMES[partner],
                "correlation": float(correlation[i, partner]),
                "helping_strip": name if helps else None,
                "std_with_it": float(with_it[i] * TO_UNITS[i]) if helps else None,
                "std_with_each": {each: float(s[i] * TO_UNITS[i]) for each, s in strips},
            }
        )
    return tuple(entries)
