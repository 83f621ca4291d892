"""8.1, formula (2), and the empirical surface f(A, L, R) of 8.1.2 f-h that gives its reflectances."""

from collections.abc import Sequence
from typing import Any

from mpmath import fdot, fsum, log, mpf, sqrt

from testrange.pairs.build import Formula, Values, given, pair, quantised
from testrange.pairs.maths import condition_of, least_squares
from testrange.pairs.model import Pair
from testrange.pairs.tables import PANELS_LIDAR, PANELS_REFERENCE


def _squares(v: Values) -> Any:
    return fsum([(a - b) ** 2 for a, b in zip(v["measured"], v["reference"], strict=True)])


def _rmse(v: Values) -> Any:
    return sqrt(_squares(v) / len(v["measured"]))


def _differences(v: Values) -> list[Any]:
    return [a - b for a, b in zip(v["measured"], v["reference"], strict=True)]


def _about_mean(v: Values) -> Any:
    d = _differences(v)
    mean = fsum(d) / len(d)
    return sqrt(fsum([(x - mean) ** 2 for x in d]) / len(d))


_MISTAKES: dict[str, Formula] = {
    "n-1 in place of n": lambda v: sqrt(_squares(v) / (len(v["measured"]) - 1)),
    "2(n-1) in place of n, as in (8)": lambda v: sqrt(_squares(v) / (2 * (len(v["measured"]) - 1))),
    "no root": lambda v: _rmse(v) ** 2,
    "mean difference removed": _about_mean,
    "mean absolute difference": lambda v: fsum([abs(d) for d in _differences(v)]) / len(v["measured"]),
    "relative to the reference": lambda v: (
        100
        * sqrt(
            fsum([((a - b) / b) ** 2 for a, b in zip(v["measured"], v["reference"], strict=True)]) / len(v["measured"])
        )
    ),
    "reflectance as a fraction, not percent": lambda v: _rmse(v) / 100,
}


def _plain(
    name: str, measured: Sequence[float], reference: Sequence[float], without: Sequence[str] = (), **more: Any
) -> Pair:
    return pair(
        f"f02_{name}",
        "(2)",
        "8.1.1",
        "m_f = root(sum (R_i - Rhat_i)^2 / n), the positive root of what is printed with both signs.",
        [
            given("measured", "%", "reflectance R_i of each panel by the LiDAR", list(measured)),
            given("reference", "%", "actual reflectance Rhat_i by the spectrometer", list(reference)),
        ],
        [("m_f", "%")],
        _rmse,
        {k: f for k, f in _MISTAKES.items() if k not in without},
        **more,
    )


def _terms(a: Any, l: Any) -> list[Any]:
    return [mpf(1), a, l, a * a, a * l, l * l]


def _design(v: Values, terms: Any = _terms) -> list[list[Any]]:
    """Rows of the surface; variables centred and scaled to -1 ... 1, which leaves the fit as it is."""

    def scaled(x: Sequence[Any]) -> list[Any]:
        low, high = min(x), max(x)
        return [(2 * value - low - high) / (high - low) for value in x]

    return [terms(a, l) for a, l in zip(scaled(v["amplitude"]), scaled(v["range"]), strict=True)]


def _fitted(v: Values, terms: Any = _terms) -> list[Any]:
    design = _design(v, terms)
    coefficients = least_squares(design, v["reflectance"])
    return [fdot(row, coefficients) for row in design]


def _surface(v: Values, terms: Any = _terms) -> list[Any]:
    found = _fitted(v, terms)
    return [*found, sqrt(fsum([(a - b) ** 2 for a, b in zip(found, v["reflectance"], strict=True)]) / len(found))]


def _in_decibel(v: Values) -> list[Any]:
    return _surface({**v, "amplitude": [10 * log(a, 10) for a in v["amplitude"]]})


def _without_range(a: Any, l: Any) -> list[Any]:
    return [mpf(1), a, a * a]


def _fit(name: str, amplitude: list[float], range_m: list[float], reflectance: list[float], **more: Any) -> Pair:
    n = len(amplitude)
    return pair(
        f"f02_surface_{name}",
        "(2)",
        "8.1.2 f-i",
        """Second-order surface R = c0 + c1 A + c2 L + c3 A^2 + c4 A L + c5 L^2 by least squares through the panels' actual
            reflectances; results are its values at the n panels, in the given order, and m_f of (2) with those values.""",
        [
            given("amplitude", "DN", "echo peak A above the baseline, linear", amplitude),
            given("range", "m", "measured range L", range_m),
            given("reflectance", "%", "actual reflectance", reflectance),
        ],
        [*((f"R_{i + 1}", "%") for i in range(n)), ("m_f", "%")],
        _surface,
        {
            "no mixed term A L": lambda v: _surface(v, lambda a, l: [mpf(1), a, l, a * a, l * l]),
            "a plane, no squares": lambda v: _surface(v, lambda a, l: [mpf(1), a, l]),
            "range left out": lambda v: _surface(v, _without_range),
            "amplitude in decibel": _in_decibel,
        },
        condition=lambda v: condition_of(_design(v)),
        condition_note="ratio of the design's singular values, variables scaled to -1 ... 1 and columns to equal length",
        derived_tolerance=True,
        **more,
    )


def _amplitude(reflectance: float, range_m: float, disturbed: int) -> float:
    """An echo that falls with the square of the range, with a saturation; sixteenths of a DN."""
    raw = mpf(reflectance) * (60 / mpf(range_m)) ** 2 * 25
    return quantised(raw - raw**2 / 30000 + mpf(disturbed) / 2, 4)


_DIGITS = (3, 1, 4, 1, 5, 9, 2, 6, 5, 3, 5, 8, 9, 7, 9, 3, 2, 3, 8, 4)


def _panels(spread_m: float) -> tuple[list[float], list[float], list[float]]:
    """20 panels about 60 m away whose ranges differ by `spread_m` at most."""
    reflectance = [float(c) for c in (5, 20, 40, 60, 100) for _ in range(4)]
    order = (7, 2, 13, 18, 5, 0, 16, 11, 9, 14, 3, 19, 1, 8, 17, 6, 12, 4, 15, 10)
    range_m = [round(60 + spread_m * k / 19, 9) for k in order]
    amplitude = [_amplitude(r, l, d - 4) for r, l, d in zip(reflectance, range_m, _DIGITS, strict=True)]
    return amplitude, range_m, reflectance


def _collinear() -> tuple[list[float], list[float], list[float]]:
    """Amplitude that follows the range but for parts of 2^-12 of its spread: A and L say nearly the same."""
    _, range_m, reflectance = _panels(8.0)
    amplitude = [quantised(400 + 100 * mpf(l) + (d - 4.5) / 8, 4) for l, d in zip(range_m, _DIGITS, strict=True)]
    return amplitude, range_m, reflectance


def pairs() -> list[Pair]:
    base = (50.0, 50.0, 50.0, 50.0, 50.0)
    tiny = [round(50 + k * 1e-9, 9) for k in (3, -1, 4, 1, -5)]
    return [
        _plain("panels", PANELS_LIDAR, PANELS_REFERENCE),
        _plain("grade_limit", [8.0, 17.0, 43.0, 57.0, 97.0], [5.0, 20.0, 40.0, 60.0, 100.0], _SAME, kind="boundary"),
        _plain("one_panel", [41.5], [40.0], _OF_ONE, kind="boundary"),
        _plain("tiny_errors", tiny, base, kind="ill_conditioned"),
        _fit("panels", *_panels(12.0)),
        _fit("nearly_one_range", *_panels(3 / 64), kind="ill_conditioned", tolerance_why=_CENTRED),
        _fit("amplitude_follows_range", *_collinear(), kind="ill_conditioned"),
    ]


_SAME = ("mean absolute difference",)  # all differences are 3 %
_OF_ONE = (
    "n-1 in place of n",
    "2(n-1) in place of n, as in (8)",
    "mean difference removed",
    "mean absolute difference",
)
_CENTRED = (
    "with variables centred and scaled the design is well conditioned and 1e-9 is kept; with raw powers of L, which differs by "
    "parts of a thousandth, the condition number is about 1e7 and an evaluator that squares it by normal equations fails"
)
