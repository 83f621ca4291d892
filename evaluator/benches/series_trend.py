"""What a series of measurements does over time: its straight line, and whether its beginning belongs to it. Used by 8.2."""

from dataclasses import dataclass

import numpy as np
from scipy import stats


@dataclass(frozen=True, kw_only=True)
class Trend:
    """Straight line through a series, relative to its mean."""

    percent_per_h: float
    std_percent_per_h: float
    p_value: float  # two-sided, of no trend


def trend(time_s: np.ndarray, dn: np.ndarray) -> Trend | None:
    """Slope of a series by least squares, with Student's t for its significance.

    Parameters
    ----------
    time_s : (n,) ndarray
        [s]
    dn : (n,) ndarray
        [DN]

    Returns
    -------
    Trend or None
        None for fewer than three images or a mean that is not positive.
    """
    n, mean = len(dn), float(np.mean(dn))
    if n < 3 or mean <= 0.0:
        return None
    hours = np.asarray(time_s, float) / 3600.0
    t = hours - hours.mean()
    relative = 100.0 * (np.asarray(dn, float) - mean) / mean
    slope = float(t @ relative) / float(t @ t)
    rest = relative - slope * t
    std = float(np.sqrt(rest @ rest / (n - 2) / (t @ t)))
    return Trend(percent_per_h=slope, std_percent_per_h=std, p_value=_by_chance(slope, std, n - 2))


def _by_chance(value: float, std: float, freedom: int) -> float:
    """Two-sided probability, by Student's t, of a value at least so far from zero."""
    if std == 0.0:
        return 1.0 if value == 0.0 else 0.0
    return float(2.0 * stats.t.sf(abs(value) / std, freedom))


def first_third(time_s: np.ndarray, dn: np.ndarray) -> tuple[float, float, float] | None:
    """What the first third of a series has above the straight line through the rest: a lamp or a camera that had not settled.

    Parameters
    ----------
    time_s : (n,) ndarray
        [s]
    dn : (n,) ndarray
        [DN]

    Returns
    -------
    tuple of float, or None
        Mean difference and its standard deviation by the scatter of the rest [%], and the probability of at least that by
        chance; None for fewer than nine images or a mean that is not positive.
    """
    first = len(dn) // 3
    mean = float(np.mean(dn[first:])) if first >= 3 else 0.0
    if mean <= 0.0:
        return None
    hours, relative = np.asarray(time_s, float) / 3600.0, 100.0 * (np.asarray(dn, float) / mean - 1.0)
    t = hours[first:] - hours[first:].mean()
    slope = float(t @ relative[first:]) / float(t @ t)
    rest = relative[first:] - slope * t - relative[first:].mean()
    freedom = len(t) - 2
    ahead = float(hours[:first].mean() - hours[first:].mean())
    value = float(relative[:first].mean() - relative[first:].mean() - slope * ahead)
    variance = float(rest @ rest) / freedom * (1.0 / first + 1.0 / len(t) + ahead**2 / float(t @ t))
    std = float(np.sqrt(variance))
    return value, std, _by_chance(value, std, freedom)
