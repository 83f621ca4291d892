"""8.2.1, formulas (3)-(6): stability, mean, standard deviation and repeatability of a series of digital numbers."""

import statistics
from collections.abc import Sequence
from typing import Any

from mpmath import fsum, mpf, sqrt

from testrange.pairs.build import Formula, given, pair, quantised
from testrange.pairs.model import Pair

_TWO_PASSES = (
    "numbers this close to a mean differ from it exactly (Sterbenz), and the mean's own rounding enters by its square: two passes "
    "keep (1.1e-16 times the condition number)^2; sum(x^2) - n mean^2 in one pass loses all digits"
)


def _mean(x: Sequence[Any]) -> Any:
    return fsum(x) / len(x)


def _squares(x: Sequence[Any]) -> Any:
    mean = _mean(x)
    return fsum([(value - mean) ** 2 for value in x])


def _sd(x: Sequence[Any]) -> Any:
    return sqrt(_squares(x) / (len(x) - 1))


def _sd_n(x: Sequence[Any]) -> Any:
    return sqrt(_squares(x) / len(x))


def _one_pass(x: Sequence[Any]) -> Any:
    """sum x^2 - n mean^2 in double precision, added up in order: what cancellation leaves."""
    numbers = [float(value) for value in x]
    total = square = 0.0
    for value in numbers:
        total += value
        square += value * value
    return sqrt(mpf(max((square - total * total / len(numbers)) / (len(numbers) - 1), 0.0)))


_ONE_PASS = "one pass, sum(x^2) - n mean^2, in double precision"
_N = "n in place of n-1"
_FRACTION = "a fraction, not percent"
_OF_MEAN = "standard deviation of the mean"
# Of two numbers these are the mean itself, or half their distance, as is what n in place of n-1 gives.
_SAME_OF_TWO = ("median", "middle of the range", "mean absolute deviation", _OF_MEAN)
_FORMULAS: dict[str, tuple[str, str, str, str, Formula, dict[str, Formula]]] = {
    "f03": (
        "(3)",
        "8.2.1 a",
        "RSD",
        "%",
        lambda v: 100 * _sd(v["dn"]) / _mean(v["dn"]),
        {
            _N: lambda v: 100 * _sd_n(v["dn"]) / _mean(v["dn"]),
            _FRACTION: lambda v: _sd(v["dn"]) / _mean(v["dn"]),
            "not divided by the mean": lambda v: _sd(v["dn"]),
            "range over mean": lambda v: 100 * (max(v["dn"]) - min(v["dn"])) / _mean(v["dn"]),
        },
    ),
    "f04": (
        "(4)",
        "8.2.1 b",
        "mean",
        "DN",
        lambda v: _mean(v["dn"]),
        {
            "n-1 in place of n": lambda v: fsum(v["dn"]) / (len(v["dn"]) - 1),
            "median": lambda v: statistics.median(v["dn"]),
            "middle of the range": lambda v: (max(v["dn"]) + min(v["dn"])) / 2,
            "first value left out": lambda v: _mean(v["dn"][1:]),
        },
    ),
    "f05": (
        "(5)",
        "8.2.1 c",
        "SD",
        "DN",
        lambda v: _sd(v["dn"]),
        {
            _N: lambda v: _sd_n(v["dn"]),
            "no root: the variance": lambda v: _squares(v["dn"]) / (len(v["dn"]) - 1),
            "mean absolute deviation": lambda v: _mean([abs(x - _mean(v["dn"])) for x in v["dn"]]),
            _OF_MEAN: lambda v: _sd(v["dn"]) / sqrt(len(v["dn"])),
        },
    ),
    "f06": (
        "(6)",
        "8.2.1 d",
        "s",
        "%",
        lambda v: 100 * _sd(v["dn"]) / _mean(v["dn"]),
        {
            _N: lambda v: 100 * _sd_n(v["dn"]) / _mean(v["dn"]),
            "in DN, as (6) is printed": lambda v: _sd(v["dn"]),
            _FRACTION: lambda v: _sd(v["dn"]) / _mean(v["dn"]),
            _OF_MEAN: lambda v: 100 * _sd(v["dn"]) / _mean(v["dn"]) / sqrt(len(v["dn"])),
        },
    ),
}
_STATEMENTS = {
    "f03": "RSD = 100 SD / mean, in percent, with the standard deviation SD of (5), n - 1 in its denominator, and the mean of (4).",
    "f04": "Arithmetic mean of n digital numbers, (DN_1 + ... + DN_n) / n.",
    "f05": "Standard deviation of n digital numbers: the root of the sum of squares about the mean over n - 1.",
    "f06": """Repeatability s(x). (6) is printed without a division by the mean, which would be a number in DN, but s(x) and its
        limits are in percent: s(x) = 100 SD / mean.""",
}


def _made(
    name: str, dn: Sequence[float], only: Sequence[str] | None = None, *, spread: bool = False, **more: Any
) -> list[Pair]:
    """One pair for each formula on the same series; `spread`: the one-pass mistake shows."""
    out = []
    for key, (formula, clause, result, unit, solve, mistakes) in _FORMULAS.items():
        if only is not None and key not in only:
            continue
        own = dict(mistakes)
        if spread and key != "f04":
            own[_ONE_PASS] = (
                (lambda v: _one_pass(v["dn"]))
                if unit == "DN"
                else (lambda v: 100 * _one_pass(v["dn"]) / _mean(v["dn"]))
            )
        if len(dn) == 2:
            own = {name: f for name, f in own.items() if name not in _SAME_OF_TWO}
        out.append(
            pair(
                f"{key}_{name}",
                formula,
                clause,
                _STATEMENTS[key],
                [given("dn", "DN", "mean of the nine central pixels of each image, black level subtracted", list(dn))],
                [(result, unit)],
                solve,
                own,
                **more,
            )
        )
    return out


def pairs() -> list[Pair]:
    # 21 images, 3 min over 1 h: a drift, and noise by the digits of pi
    hour = [
        quantised(2860 + 0.75 * i + 1.5 * (d - 4.5), 4)
        for i, d in enumerate((3, 1, 4, 1, 5, 9, 2, 6, 5, 3, 5, 8, 9, 7, 9, 3, 2, 3, 8, 4, 6))
    ]
    five = [
        quantised(2871 + 0.375 * (d - 4.5), 4) for d in (2, 7, 1, 8, 2, 8, 1, 8, 2, 8, 4, 5, 9, 0, 4, 5, 2, 3, 5, 3, 6)
    ]
    # NIST StRD NumAcc4's design, a mean of 1e7 and a deviation of 0.1, with sixteenths so that doubles hold it
    far = [1e7 + k / 16 for k in (3, 1, 5, 2, 4, 1, 5, 3, 2, 4, 6)]
    farther = [2.0**36 + k for k in (1, 0, 2, 1, 0, 3, 1)]
    return [
        *_made("hour", hour, ("f03", "f04", "f05")),
        *_made("five_minutes", five, ("f04", "f05", "f06")),
        *_made("two_images", [1024.0, 1031.5], kind="boundary"),
        *_made("far_mean", far, ("f03", "f05", "f06"), spread=True, kind="ill_conditioned", tolerance_why=_TWO_PASSES),
        *_made("farther_mean", farther, ("f03", "f05"), spread=True, kind="ill_conditioned", tolerance_why=_TWO_PASSES),
    ]
