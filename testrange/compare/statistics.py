"""Paired differences of two contenders, with confidence intervals. Numbers only; what they are of: `run`.

The pair is one thing (a vertex, a mark, a parameter of one campaign) as both contenders estimated it, so that what is hard for
both drops out. Campaigns are the independent units: navigation and survey errors are shared within one.
"""

import itertools
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from testrange.compare.model import Outcome

_LEVEL = 0.95
_DRAWS = 4000
_LEAST_ITEMS = 5  # of one campaign, for an interval within it
T = "Student's t over campaigns"
BOOTSTRAP = "paired bootstrap over the items of one campaign"
NONE = "no interval: one campaign, and too few items in it"


@dataclass(frozen=True, kw_only=True)
class Interval:
    """Mean of the differences, first minus second, and its 95 % interval."""

    mean: float
    low: float | None
    high: float | None

    @property
    def verdict(self) -> int:
        """-1: the first is better, 1: the second, 0: not told apart."""
        if self.low is None or self.high is None:
            return 0
        return -1 if self.high < 0.0 else 1 if self.low > 0.0 else 0


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One quantity, one pair of contenders, over what both estimated."""

    quantity: str
    unit: str
    first: str
    second: str
    campaigns: int
    items: int
    rms: tuple[float, float]
    absolute: Interval  # of |error|
    squared: Interval  # of the squared error
    method: str


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Errors of one contender in one quantity, all campaigns together."""

    contender: str
    quantity: str
    unit: str
    campaigns: int
    items: int
    mean: float
    rms: float
    median_absolute: float


def summaries(outcomes: Iterable[Outcome], contenders: Sequence[str]) -> list[Summary]:
    """By quantity, then by contender."""
    grouped: dict[tuple[str, str], list[np.ndarray]] = {}
    units: dict[str, str] = {}
    for o in outcomes:
        units |= o.units
        for quantity, items in o.errors.items():
            grouped.setdefault((quantity, o.contender), []).append(np.array(list(items.values())))
    out = []
    for quantity in dict.fromkeys(q for q, _ in grouped):
        for name in contenders:
            parts = grouped.get((quantity, name))
            if parts is None:
                continue
            error = np.concatenate(parts)
            out.append(
                Summary(
                    contender=name,
                    quantity=quantity,
                    unit=units[quantity],
                    campaigns=len(parts),
                    items=error.size,
                    mean=float(error.mean()),
                    rms=float(np.sqrt(np.mean(error**2))),
                    median_absolute=float(np.median(np.abs(error))),
                )
            )
    return out


def same_for_all(outcomes: Iterable[Outcome]) -> set[str]:
    """Quantities in which all contenders that have results made the same errors: none of them touches these."""
    found: dict[tuple[str, str], list[Mapping[str, float]]] = {}
    differ: set[str] = set()
    done = [o for o in outcomes if o.reason is None]
    for o in done:
        for quantity in {q for other in done if other.campaign == o.campaign for q in other.errors}:
            first = found.setdefault((o.campaign, quantity), [o.errors.get(quantity, {})])[0]
            if o.errors.get(quantity, {}) != first:
                differ.add(quantity)
    return {q for _, q in found} - differ


def differences(outcomes: Sequence[Outcome], contenders: Sequence[str]) -> list[Difference]:
    """Of every quantity and every pair of contenders that both estimated it in a campaign."""
    found: dict[str, dict[str, Mapping[str, Mapping[str, float]]]] = {}
    units: dict[str, str] = {}
    for o in outcomes:
        units |= o.units
        found.setdefault(o.campaign, {})[o.contender] = o.errors
    quantities = list(dict.fromkeys(q for o in outcomes for q in o.errors))
    out = []
    for quantity, (first, second) in itertools.product(quantities, itertools.combinations(contenders, 2)):
        pairs = []
        for by_name in found.values():
            a, b = (by_name.get(name, {}).get(quantity, {}) for name in (first, second))
            common = [item for item in a if item in b]
            if common:
                pairs.append(np.array([[a[item], b[item]] for item in common]))
        if pairs:
            out.append(_difference(quantity, units[quantity], first, second, pairs))
    return out


def _difference(quantity: str, unit: str, first: str, second: str, pairs: list[np.ndarray]) -> Difference:
    """pairs: (items, 2) errors of each campaign."""
    both = np.concatenate(pairs)
    seed = zlib.crc32(f"{quantity} {first} {second}".encode())
    results = [
        paired_interval([c[:, 0] - c[:, 1] for c in map(measure, pairs)], seed) for measure in (np.abs, np.square)
    ]
    rms = np.sqrt(np.mean(both**2, axis=0))
    return Difference(
        quantity=quantity,
        unit=unit,
        first=first,
        second=second,
        campaigns=len(pairs),
        items=len(both),
        rms=(float(rms[0]), float(rms[1])),
        absolute=results[0][0],
        squared=results[1][0],
        method=results[0][1],
    )


def paired_interval(parts: Sequence[np.ndarray], seed: int = 0) -> tuple[Interval, str]:
    r"""95 % interval of the mean of paired differences.

    .. math:: \bar d \pm t_{0.975,\,n-1} \, s_d / \sqrt{n}

    over the campaigns' means d; of one campaign alone the percentile interval of a bootstrap over its items, which leaves out
    what those have in common.

    Parameters
    ----------
    parts : sequence of (items,) np.ndarray
        Differences, one array a campaign.
    seed : int
        Of the bootstrap's draws.

    Returns
    -------
    Interval
    str
        The method.

    References
    ----------
    Student (1908), The probable error of a mean, Biometrika 6(1), 1-25, doi:10.1093/biomet/6.1.1; Efron, Tibshirani (1993), An
    Introduction to the Bootstrap, chapter 13.
    """
    means = np.array([float(p.mean()) for p in parts])
    if means.size > 1:
        half = float(stats.t.ppf(0.5 + 0.5 * _LEVEL, means.size - 1) * means.std(ddof=1) / np.sqrt(means.size))
        middle = float(means.mean())
        return Interval(mean=middle, low=middle - half, high=middle + half), T
    items = parts[0]
    if items.size < _LEAST_ITEMS:
        return Interval(mean=float(means[0]), low=None, high=None), NONE
    rng = np.random.default_rng(np.random.SeedSequence([41450, seed]))
    drawn = np.array([items[rng.integers(0, items.size, items.size)].mean() for _ in range(_DRAWS)])
    low, high = np.quantile(drawn, [0.5 - 0.5 * _LEVEL, 0.5 + 0.5 * _LEVEL])
    return Interval(mean=float(means[0]), low=float(low), high=float(high)), BOOTSTRAP
