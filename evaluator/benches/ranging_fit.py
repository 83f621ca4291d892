"""Least squares of (14) and the test of its residuals: one panel that does not fit is found, or the covariance is scaled.

Formulas (9)-(15) as the standard states them are in `evaluator.c9_1_lidar_ranging`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from evaluator.model import EvaluationError

MIN_PANELS = 5  # 9.1.2 a
LEAST_P = 1e-3  # of the chi-square test of the residuals of (14)
APART = 10.83  # chi-square by which one panel's exclusion must fit better than any other's: p = 0.001 at one degree of freedom


@dataclass(frozen=True, kw_only=True)
class RangingFit:
    """K_2 and R_2 with what their residuals say of the data."""

    constants: np.ndarray  # (2,) K_2 [m], R_2
    covariance: np.ndarray  # (2, 2), multiplied by `factor`
    gain: np.ndarray  # (2, n): differences to constants; 0 at the panel left out
    used: np.ndarray  # (n,) bool
    chi_square: float  # of all panels
    freedom: int
    p: float
    factor: float  # 1, or chi-square over its freedom where no single panel explains it
    without: tuple[str, float, int] | None  # panel left out, chi-square of the rest, its freedom
    remark: str | None  # what was found and done, where the test fails


def range_residuals(
    measured_m: ArrayLike, reference_m: ArrayLike, additive_constant_m: float, multiplication_constant: float
) -> np.ndarray:
    """Residuals v = -K_2 - R_2 L + (L_true - L) of the error equations.

    Parameters
    ----------
    measured_m, reference_m : (n,) array_like
        Ranges by the LiDAR, L, and by the total station. [m]
    additive_constant_m : float
        K_2. [m]
    multiplication_constant : float
        R_2, dimensionless.

    Returns
    -------
    (n,) ndarray
        [m]

    References
    ----------
    GB/T 41450-2022, 9.1.2 h, formula (14).
    """
    measured, reference = (np.asarray(x, np.float64) for x in (measured_m, reference_m))
    return reference - measured - additive_constant_m - multiplication_constant * measured


def constants(
    measured: np.ndarray, reference: np.ndarray, covariance_m2: ArrayLike | None
) -> tuple[float, float, np.ndarray]:
    """K_2, R_2 and their covariance; without `covariance_m2` from the residuals."""
    gain = gain_of(measured, covariance_m2)
    k2, r2 = gain @ (reference - measured)
    if covariance_m2 is not None:
        return float(k2), float(r2), gain @ np.asarray(covariance_m2) @ gain.T
    residual = range_residuals(measured, reference, float(k2), float(r2))
    return float(k2), float(r2), gain @ gain.T * float(residual @ residual) / (len(measured) - 2)


def gain_of(measured: np.ndarray, covariance_m2: ArrayLike | None) -> np.ndarray:
    """(2, n) that takes differences to K_2, R_2."""
    count, middle = len(measured), float(np.mean(measured))
    if np.ptp(measured) < 1.0:
        raise EvaluationError(
            "formula (13): the panels stand at one distance", got=f"{np.ptp(measured):.2f} m", expected="1 m and more"
        )
    design = np.column_stack([np.ones(count), measured - middle])  # about the middle: well conditioned
    covariance = np.eye(count) if covariance_m2 is None else np.asarray(covariance_m2, np.float64)
    try:
        if covariance.shape != (count, count) or not np.isfinite(covariance).all():
            raise np.linalg.LinAlgError
        lower = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        raise EvaluationError("formula (13): no covariance matrix of the differences", got=covariance.shape) from None
    gain = np.linalg.pinv(np.linalg.solve(lower, design)) @ np.linalg.inv(lower)
    gain[0] -= gain[1] * middle
    return np.asarray(gain)


def adjusted_constants(
    names: list[str], measured: np.ndarray, reference: np.ndarray, covariance_m2: np.ndarray
) -> RangingFit:
    """Constants by (14) with the test of their residuals.

    Where the test fails (p < 0.001), each panel in turn is left out. If the rest then passes, by far better than without any
    other panel, and five remain, that panel does not count for K_2 and R_2. Else the covariance is multiplied by chi-square
    over its degrees of freedom.

    Parameters
    ----------
    measured, reference : (n,) ndarray
        Ranges by the LiDAR and by the total station. [m]
    covariance_m2 : (n, n) ndarray
        Of the differences. [m2]

    References
    ----------
    GB/T 41450-2022, 9.1.2 h, formula (14); the test is not in the standard.
    """
    every = np.ones(len(names), bool)
    statistic = _chi_square(measured, reference, covariance_m2, every)
    freedom = len(names) - 2
    p = float(chi2.sf(statistic, freedom))
    used, factor, without, remark = every, 1.0, None, None
    if p < LEAST_P:
        told = f"the residuals of (14) exceed what is stated: chi-square {statistic:.0f}, {freedom} degrees of freedom"
        worst, rest = _one_panel(measured, reference, covariance_m2)
        if worst is not None and len(names) > MIN_PANELS:
            used = np.arange(len(names)) != worst
            without = names[worst], rest, freedom - 1
            remark = f"{told}; {names[worst]} is left out of K2 and R2: without it {rest:.1f}, {freedom - 1}"
        else:
            factor = statistic / freedom
            named = (
                f"without {names[worst]} they agree ({rest:.1f}, {freedom - 1}), but fewer than {MIN_PANELS} panels were left"
                if worst is not None
                else "no single panel explains it"
            )
            remark = f"{told}; {named}: the covariance is multiplied by {factor:.1f}"
    gain = np.zeros((2, len(names)))
    gain[:, used] = gain_of(measured[used], covariance_m2[np.ix_(used, used)])
    return RangingFit(
        constants=gain @ (reference - measured),
        covariance=factor * gain @ covariance_m2 @ gain.T,
        gain=gain,
        used=used,
        chi_square=statistic,
        freedom=freedom,
        p=p,
        factor=factor,
        without=without,
        remark=remark,
    )


def _one_panel(measured: np.ndarray, reference: np.ndarray, covariance: np.ndarray) -> tuple[int | None, float]:
    """The only panel without which the residuals pass, and the chi-square of the rest; None where no panel stands out."""
    count = len(measured)
    if count < 5:  # three that remain have one degree of freedom
        return None, np.inf
    rests = np.full(count, np.inf)
    for k in range(count):
        try:
            rests[k] = _chi_square(measured, reference, covariance, np.arange(count) != k)
        except EvaluationError:  # the others stand at one distance
            continue
    order = np.argsort(rests)
    best = int(order[0])
    alone = rests[order[1]] - rests[best] > APART
    return (best if alone and chi2.sf(rests[best], count - 3) >= LEAST_P else None), float(rests[best])


def _chi_square(measured: np.ndarray, reference: np.ndarray, covariance: np.ndarray, used: np.ndarray) -> float:
    part = covariance[np.ix_(used, used)]
    k2, r2, _ = constants(measured[used], reference[used], part)
    residual = range_residuals(measured, reference, k2, r2)[used]
    return float(residual @ np.linalg.solve(part, residual))
