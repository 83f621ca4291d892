"""What the joint adjustment takes as stated and does not estimate, put to the test of the observations: lens certificate, constants
of the ranges, clocks without a prior; and how large an error of a surveyed place must be to be found.

Baarda's reliability: each such quantity as one unknown more, its least error that is found nineteen times in twenty, and what one
that just escapes does to the mountings. Nothing is corrected here. A lens that changed since its certificate can hide in a lever
arm, of the other sensor too, with a unit weight of 1 and a triangle that closes; its own trace over the field does not hide.
The adjustment is `adjustment`'s, the test of single observations `blunders`'.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.stats

from evaluator.mounting.blunders import BLUNDER, LOOSE_STD_M
from evaluator.mounting.diagnosis import family_limit
from evaluator.mounting.mounting_model import CLOCK_NAMES, System

POWER = 0.95  # probability with which an error of the stated size is found
_UNIT_WEIGHT = 1e-3  # tail probability of the residuals as a whole
_UNKNOWN = 1e-9  # information (per unit squared) below which the observations say nothing of a quantity


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """The adjustment's last step; L is the Cholesky factor of the observations' covariance."""

    factor: np.ndarray  # (n, n) L
    design: np.ndarray  # (n, u) L^-1 A
    covariance: np.ndarray  # (u, u)
    residual: np.ndarray  # (n,) L^-1 r


@dataclass(frozen=True, kw_only=True)
class Doubt:
    """One stated quantity as the observations see it."""

    quantity: str
    unit: str
    shift: float  # true minus stated that they ask for, everything else as stated
    std: float  # of it, what is stated about its accuracy within
    z: float
    detectable: float  # least shift that is found with POWER
    moves: str  # parameter that a shift displaces most, in its own standard deviations
    by: float  # how far `detectable` displaces it; rad, m or s
    by_sigma: float

    def block(self) -> dict[str, object]:
        """For results.json; `by` in degrees, metres or seconds."""
        return {**vars(self), "by": self.by * (float(np.degrees(1.0)) if "boresight" in self.moves else 1.0)}


def stated_columns(system: System, x: np.ndarray) -> dict[str, tuple[str, np.ndarray]]:
    """By how much every observation would be greater for one unit more of each quantity.

    Parameters
    ----------
    system : System
    x : (u,) np.ndarray
        All unknowns.

    Returns
    -------
    dict
        Quantity -> unit, (rows,) np.ndarray. K2 and R2 count as in (15): true = measured + K2 + R2 measured.
    """
    sheets = {"camera": system.problem.rig.camera, "lidar": system.problem.rig.lidar}
    timed = {name: s.model_copy(update={"clock_std_s": s.clock_std_s or 1.0}) for name, s in sheets.items()}
    wider = System(replace(system.problem, rig=system.problem.rig.model_copy(update=timed)))
    first = dict(zip(system.names, x, strict=False))
    start = [first.get(name, 0.0) for name in wider.names]
    linear = wider.linearise(np.concatenate([start, x[system.count :]]), with_covariance=False)
    lens, ranges = linear.by_lens, linear.by_range
    found = {
        "camera_principal_distance_px": ("px", lens[:, 0] + lens[:, 1]),
        "camera_cx_px": ("px", lens[:, 2]),
        "camera_cy_px": ("px", lens[:, 3]),
        "camera_k1": ("", lens[:, 4]),
        "ranging_additive_constant": ("m", -ranges[:, 0]),
        "ranging_multiplication_constant": ("", -ranges[:, 1]),
    }
    found |= {
        name: ("s", linear.design[: system.rows_prior, wider.names.index(name)])
        for name in CLOCK_NAMES
        if name not in system.names
    }
    return {name: (unit, _whole(column, system.size)) for name, (unit, column) in found.items()}


def _whole(column: np.ndarray, size: int) -> np.ndarray:
    out = np.zeros(size)
    out[: len(column)] = column
    return out


def examine(system: System, x: np.ndarray, fit: Fitted) -> tuple[list[Doubt], list[str]]:
    """Every stated quantity alone, and those that the observations contradict, strongest first.

    After the strongest is granted as an unknown the others are tested again, so that what only resembles it is not named too. The
    lines hold the shifts of all that are granted together, and the unit weight is judged with them granted.

    Returns
    -------
    doubts : list of Doubt
    lines : list of str
        One for the unit weight where it is beyond chance, one for each contradicted quantity.
    """
    columns = stated_columns(system, x)
    white = {
        name: scipy.linalg.solve_triangular(fit.factor, column, lower=True, check_finite=False)
        for name, (_, column) in columns.items()
    }
    limit = family_limit(len(columns))
    found = [_doubt(system, name, columns[name][0], white[name], fit, limit) for name in columns]
    doubts = [d for d in found if d is not None]
    named: list[Doubt] = []
    left, now = {d.quantity: d for d in doubts}, fit
    while left:
        worst = max(left.values(), key=lambda d: abs(d.z))
        if abs(worst.z) <= limit:
            break
        named.append(worst)
        now = _granted(now, white[worst.quantity])
        again = (_doubt(system, n, d.unit, white[n], now, limit) for n, d in left.items() if n != worst.quantity)
        left = {d.quantity: d for d in again if d is not None}
    shifts = (now.covariance @ (now.design.T @ fit.residual))[fit.design.shape[1] :]
    stds = np.sqrt(np.diag(now.covariance)[fit.design.shape[1] :])
    alone = {d.quantity: d for d in doubts}
    lines = [_line(alone[d.quantity], float(v), float(s)) for d, v, s in zip(named, shifts, stds, strict=True)]
    redundancy = len(now.residual) - now.design.shape[1]
    whole = unit_weight_line(float(np.sqrt(now.residual @ now.residual / max(redundancy, 1))), redundancy)
    return doubts, lines if whole is None else [whole, *lines]


def _doubt(system: System, name: str, unit: str, white: np.ndarray, fit: Fitted, limit: float) -> Doubt | None:
    """None where no observation says anything of the quantity."""
    into = fit.covariance @ (fit.design.T @ white)
    free = white - fit.design @ into
    information = float(free @ free)
    if information <= _UNKNOWN * float(white @ white):
        return None
    std = 1.0 / float(np.sqrt(information))
    detectable = (limit + float(scipy.stats.norm.ppf(POWER))) * std
    sigma = np.sqrt(np.diag(fit.covariance)[: system.count])
    most = int(np.argmax(np.abs(into[: system.count]) / sigma))
    shift = float(free @ fit.residual) / information
    return Doubt(
        quantity=name,
        unit=unit,
        shift=shift,
        std=std,
        z=shift / std,
        detectable=detectable,
        moves=system.names[most],
        by=float(into[most]) * detectable,
        by_sigma=float(into[most] / sigma[most]) * detectable,
    )


def _granted(fit: Fitted, white: np.ndarray) -> Fitted:
    """The fit with one unknown more, whose column is `white`."""
    into = fit.covariance @ (fit.design.T @ white)
    free = white - fit.design @ into
    information = float(free @ free)
    value = float(free @ fit.residual) / information
    extended = np.append(into, -1.0)
    covariance = np.outer(extended, extended) / information
    covariance[:-1, :-1] += fit.covariance
    return Fitted(
        factor=fit.factor,
        design=np.column_stack([fit.design, white]),
        covariance=covariance,
        residual=fit.residual - free * value,
    )


def _line(doubt: Doubt, shift: float, std: float) -> str:
    moved = shift * doubt.by_sigma / doubt.detectable
    unit = f" {doubt.unit}" if doubt.unit else ""
    return (
        f"{doubt.quantity}: off by {shift:+.2g}{unit} (standard deviation {std:.1g}), "
        f"which moves {doubt.moves} by {moved:+.1f} of its standard deviations"
    )


def unit_weight_line(sigma0: float, redundancy: int) -> str | None:
    """A line where the residuals as a whole are greater than all that is stated allows, after the observers' own variances were
    estimated: what is left is what many observations share, the navigation before all. None where chance may be the reason.

    The test is the global one: redundancy times sigma0 squared is chi-square.
    """
    if redundancy <= 0:
        return None
    limit = float(np.sqrt(scipy.stats.chi2.isf(_UNIT_WEIGHT, redundancy) / redundancy))
    if sigma0 <= limit:
        return None
    return (
        f"unit_weight: {sigma0:.2f} where chance allows {limit:.2f}; what many observations share is worse than stated, "
        "the navigation before all, and the standard deviations are too small"
    )


def detectable_survey(system: System, fit: Fitted) -> dict[str, object]:
    """Least error of one target's surveyed place, and of one panel's height, that the test of blunders finds with POWER.

    Returns
    -------
    dict
        `probability`; `horizontal`, `vertical` and, with panels, `panel_height`: target, error_m of the target where it is
        greatest; horizontal along its worst direction.
    """
    out: dict[str, object] = {"probability": POWER}
    of: dict[str, list[tuple[float, str]]] = {"horizontal": [], "vertical": [], "panel_height": []}
    for first, names, size in (
        (system.rows_places, system.targets, 3),
        (system.rows_heights, system.panels, 1),
    ):
        lost = np.sqrt(_noncentrality(size))
        for k, name in enumerate(names):
            if _is_free(system, name, size):
                continue
            rows = np.zeros((system.size, size))
            rows[first + size * k + np.arange(size), np.arange(size)] = 1.0
            white = scipy.linalg.solve_triangular(fit.factor, rows, lower=True, check_finite=False)
            free = white - fit.design @ (fit.covariance @ (fit.design.T @ white))
            w = free.T @ free
            if size == 1:
                of["panel_height"].append((lost / float(np.sqrt(max(w[0, 0], 1e-12))), name))
                continue
            least = float(np.linalg.eigvalsh(w[:2, :2])[0])
            of["horizontal"].append((lost / float(np.sqrt(max(least, 1e-12))), name))
            of["vertical"].append((lost / float(np.sqrt(max(w[2, 2], 1e-12))), name))
    return out | {kind: _greatest(values) for kind, values in of.items() if values}


def _is_free(system: System, name: str, size: int) -> bool:
    """Whether a surveyed place, or a height, was rejected: nothing is believed of it any more."""
    surveyed, panels = system.problem.surveyed, system.problem.panels
    std = panels[name].height_std_m if size == 1 else float(np.sqrt(np.max(np.diag(surveyed[name].covariance_m2))))
    return std >= LOOSE_STD_M


def _greatest(values: Sequence[tuple[float, str]]) -> Mapping[str, object]:
    error, name = max(values)
    return {"target": name, "error_m": float(error)}


def _noncentrality(freedom: int) -> float:
    """Of the chi-square that passes the threshold of blunders with POWER."""
    threshold = float(scipy.stats.chi2.isf(BLUNDER, freedom))

    def missing(noncentrality: float) -> float:
        return float(scipy.stats.ncx2.sf(threshold, freedom, noncentrality)) - POWER

    return float(scipy.optimize.brentq(missing, 1e-3, 10.0 * threshold + 100.0))
