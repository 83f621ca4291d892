"""9.1, formulas (9)-(11) and (13)-(15): errors of the LiDAR's ranges, additive and multiplication constant. (12): `c9_1_air`."""

from collections.abc import Sequence
from typing import Any

from mpmath import fsum, mpf, sqrt

from testrange.pairs.build import Formula, Values, given, pair, quantised
from testrange.pairs.maths import least_squares, minus
from testrange.pairs.model import Pair


def _mean(x: Sequence[Any]) -> Any:
    return fsum(x) / len(x)


def _rms(x: Sequence[Any]) -> Any:
    return sqrt(fsum([d * d for d in x]) / len(x))


def _nine(v: Values, factor: int | Any = 1) -> Any:
    return _rms([factor * l - t for l, t in zip(v["measured"], v["reference"], strict=True)])


_NINE: dict[str, Formula] = {
    "one-way time of flight: c t in place of c t / 2": lambda v: _nine(v, 2),
    "range halved twice": lambda v: _nine(v, mpf(1) / 2),
    "n-1 in place of n": lambda v: _nine(v) * sqrt(mpf(len(v["measured"])) / (len(v["measured"]) - 1)),
    "2(n-1) in place of n, as in (8)": lambda v: (
        _nine(v) * sqrt(mpf(len(v["measured"])) / (2 * (len(v["measured"]) - 1)))
    ),
    "mean difference removed": lambda v: _rms([d - _mean(_off(v)) for d in _off(v)]),
    "mean absolute difference": lambda v: _mean([abs(d) for d in _off(v)]),
    "in millimetres": lambda v: 1000 * _nine(v),
    "no root": lambda v: _nine(v) ** 2,
}


def _off(v: Values) -> list[Any]:
    return minus(v["measured"], v["reference"])


_RANGES = (
    ("measured", "m", "range L_i of each panel by the LiDAR"),
    ("reference", "m", "range Lhat_i by the total station"),
)


def _both(measured: Sequence[float], reference: Sequence[float]) -> list[Any]:
    return [given(*head, list(x)) for head, x in zip(_RANGES, (measured, reference), strict=True)]


def _f09(
    name: str, measured: Sequence[float], reference: Sequence[float], without: Sequence[str] = (), **more: Any
) -> Pair:
    return pair(
        f"f09_{name}",
        "(9)",
        "9.1.1 a",
        "m_j = root(sum (L_i - Lhat_i)^2 / n), the positive root of what is printed with both signs.",
        _both(measured, reference),
        [("m_j", "m")],
        _nine,
        {k: f for k, f in _NINE.items() if k not in without},
        **more,
    )


def _f10(name: str, measured: Sequence[float], reference: Sequence[float], **more: Any) -> Pair:
    return pair(
        f"f10_{name}",
        "(10)",
        "9.1.1 b",
        """Mean range. The text calls it the LiDAR's, the formula averages the actual ranges Lhat_i of the total station: as
            printed.""",
        _both(measured, reference),
        [("mean_range", "m")],
        lambda v: _mean(v["reference"]),
        {
            "mean of the LiDAR's ranges": lambda v: _mean(v["measured"]),
            "n-1 in place of n": lambda v: fsum(v["reference"]) / (len(v["reference"]) - 1),
            "sum, not divided by n": lambda v: fsum(v["reference"]),
        },
        **more,
    )


def _f11(name: str, m_j: float, mean: float, **more: Any) -> Pair:
    return pair(
        f"f11_{name}",
        "(11)",
        "9.1.1 c",
        "m_z = 100 m_j / mean range, in percent.",
        [given("m_j", "m", "ranging error of (9)", m_j), given("mean_range", "m", "mean range of (10)", mean)],
        [("m_z", "%")],
        lambda v: 100 * v["m_j"] / v["mean_range"],
        {
            "a fraction, not percent": lambda v: v["m_j"] / v["mean_range"],
            "m_j in millimetres": lambda v: 100000 * v["m_j"] / v["mean_range"],
            "inverted": lambda v: 100 * v["mean_range"] / v["m_j"],
            "in parts per million": lambda v: 1000000 * v["m_j"] / v["mean_range"],
        },
        **more,
    )


def _fourteen(v: Values, k2: Any = None, r2: Any = None) -> list[Any]:
    k2, r2 = v["k2"] if k2 is None else k2, v["r2"] if r2 is None else r2
    return [(t - l) - k2 - r2 * l for l, t in zip(v["measured"], v["reference"], strict=True)]


def _f14(name: str, measured: Sequence[float], reference: Sequence[float], k2: float, r2: float, **more: Any) -> Pair:
    return pair(
        f"f14_{name}",
        "(14)",
        "9.1.2 h",
        "v_r = -K_2 - R_2 L_r + (Ltilde_r - L_r), K_2 in metres and R_2 dimensionless (the text's 'in percent' cannot be meant).",
        [
            *_both(measured, reference),
            given("k2", "m", "additive constant K_2", k2),
            given("r2", "1", "multiplication constant R_2", r2),
        ],
        [(f"v_{i + 1}", "m") for i in range(len(measured))],
        _fourteen,
        {
            "additive constant in percent": lambda v: _fourteen(v, k2=v["k2"] / 100),
            "multiplication constant in percent": lambda v: _fourteen(v, r2=v["r2"] / 100),
            "multiplication constant in parts per million": lambda v: _fourteen(v, r2=v["r2"] / 10**6),
            "signs of the constants reversed": lambda v: _fourteen(v, -v["k2"], -v["r2"]),
            "signs of the residuals reversed": lambda v: [-x for x in _fourteen(v)],
            "constant times the true range": lambda v: [
                (t - l) - v["k2"] - v["r2"] * t for l, t in zip(v["measured"], v["reference"], strict=True)
            ],
        },
        derived_tolerance=True,
        **more,
    )


def _f13(name: str, measured: Sequence[float], v_r: Sequence[float], k2: float, r2: float) -> Pair:
    def true(v: Values, k: Any = 1, r: Any = 1, e: Any = 1) -> list[Any]:
        return [(l + e * x) + k * v["k2"] + r * v["r2"] * l for l, x in zip(v["measured"], v["v"], strict=True)]

    return pair(
        f"f13_{name}",
        "(13)",
        "9.1.2 g",
        "Ltilde_r = (L_r + v_r) + K_2 + R_2 L_r, K_2 in metres and R_2 dimensionless.",
        [
            given("measured", "m", "range L_r by the LiDAR", list(measured)),
            given("v", "m", "residual v_r", list(v_r)),
            given("k2", "m", "additive constant K_2", k2),
            given("r2", "1", "multiplication constant R_2", r2),
        ],
        [(f"L_{i + 1}", "m") for i in range(len(measured))],
        true,
        {
            "additive constant in percent": lambda v: true(v, k=mpf("0.01")),
            "multiplication constant in percent": lambda v: true(v, r=mpf("0.01")),
            "signs of the constants reversed": lambda v: true(v, -1, -1),
            "sign of the residual reversed": lambda v: true(v, e=-1),
            "residual left out": lambda v: true(v, e=0),
        },
    )


def _constants(v: Values) -> list[Any]:
    return least_squares([[mpf(1), l] for l in v["measured"]], minus(v["reference"], v["measured"]))


def _inverse_problem(v: Values) -> list[Any]:
    """Constants that take the true range to the measured one."""
    return least_squares([[mpf(1), t] for t in v["reference"]], minus(v["measured"], v["reference"]))


def _on_true(v: Values) -> list[Any]:
    return least_squares([[mpf(1), t] for t in v["reference"]], minus(v["reference"], v["measured"]))


def _fit(name: str, measured: Sequence[float], reference: Sequence[float], **more: Any) -> Pair:
    return pair(
        f"f14_constants_{name}",
        "(13)-(14)",
        "9.1.2 i",
        """Additive constant K_2 [m] and multiplication constant R_2 [1] of the LiDAR that minimise the sum of v_r^2 of (14), every
            panel with the same weight.""",
        _both(measured, reference),
        [("K_2", "m"), ("R_2", "1")],
        _constants,
        {
            "additive constant in percent": lambda v: [100 * _constants(v)[0], _constants(v)[1]],
            "multiplication constant in percent": lambda v: [_constants(v)[0], 100 * _constants(v)[1]],
            "multiplication constant in parts per million": lambda v: [_constants(v)[0], 10**6 * _constants(v)[1]],
            "signs reversed: measured minus true": lambda v: [-x for x in _constants(v)],
            "LiDAR from total station": _inverse_problem,
            "regression on the total station's ranges": _on_true,
            "no multiplication constant": lambda v: [_mean(minus(v["reference"], v["measured"])), mpf(0)],
        },
        derived_tolerance=True,
        **more,
    )


def _f15(name: str, measured: Sequence[float], k2: float, r2: float, **more: Any) -> Pair:
    def corrected(v: Values, k: Any = 1, r: Any = 1) -> list[Any]:
        return [l + k * v["k2"] + r * v["r2"] * l for l in v["measured"]]

    return pair(
        f"f15_{name}",
        "(15)",
        "9.1.2 j",
        "L_Q = L_L + K_2 + R_2 L_L, K_2 in metres and R_2 dimensionless.",
        [
            given("measured", "m", "range L_L by the LiDAR", list(measured)),
            given("k2", "m", "additive constant K_2", k2),
            given("r2", "1", "multiplication constant R_2", r2),
        ],
        [(f"L_{i + 1}", "m") for i in range(len(measured))],
        corrected,
        {
            "additive constant in percent": lambda v: corrected(v, k=mpf("0.01")),
            "multiplication constant in percent": lambda v: corrected(v, r=mpf("0.01")),
            "multiplication constant in parts per million": lambda v: corrected(v, r=mpf("1e-6")),
            "constants subtracted": lambda v: corrected(v, -1, -1),
            "additive constant left out": lambda v: corrected(v, k=0),
        },
        **more,
    )


def _whole(v: Values) -> Any:
    """9.1.2 k: (15) with the constants of (14), then (9)-(11)."""
    k2, r2 = _constants(v)
    corrected = [l + k2 + r2 * l for l in v["measured"]]
    return 100 * _nine({"measured": corrected, "reference": v["reference"]}) / _mean(v["reference"])


def _chain(name: str, measured: Sequence[float], reference: Sequence[float]) -> Pair:
    return pair(
        f"f11_whole_{name}",
        "(9)-(15)",
        "9.1.2 g-k",
        """m_z in percent after correction: K_2 and R_2 by least squares of (14), corrected ranges by (15), then (9)-(11) against
            the same total station ranges.""",
        _both(measured, reference),
        [("m_z", "%")],
        _whole,
        {
            "not corrected": lambda v: 100 * _nine(v) / _mean(v["reference"]),
            "n-2 in place of n": lambda v: _whole(v) * sqrt(mpf(len(v["measured"])) / (len(v["measured"]) - 2)),
            "n-1 in place of n": lambda v: _whole(v) * sqrt(mpf(len(v["measured"])) / (len(v["measured"]) - 1)),
            "one-way time of flight: c t in place of c t / 2": lambda v: _whole_of(v, 2),
            "mean of the LiDAR's ranges": lambda v: _whole(v) * _mean(v["reference"]) / _mean(v["measured"]),
        },
        tolerance_why="the residuals are a ten-thousandth of the ranges: 1e-16 of a range is 1e-12 of them",
    )


def _whole_of(v: Values, factor: int) -> Any:
    """Uncorrected: constants would take the factor up."""
    return 100 * _nine(v, factor) / _mean(v["reference"])


# A ranging line of seven panels; LiDAR with 12 mm and 150 ppm, millimetres of noise; 2^-12 m.
_TRUE = tuple(quantised(x, 12) for x in (12.137, 31.402, 55.871, 79.265, 104.518, 148.033, 201.764))
_LIDAR = tuple(
    quantised(t - 0.012 - 150e-6 * t + d / 1000, 12) for t, d in zip(_TRUE, (1.5, -2.25, 0.75, 3.0, -1.25, -0.5, 1.75))
)
_NEAR_TRUE = tuple(quantised(1500 + x, 10) for x in (0.0, 0.25, 0.4375, 0.6875, 0.875, 1.125))
_NEAR_LIDAR = tuple(round(t - 0.02 + d * 1e-5, 5) for t, d in zip(_NEAR_TRUE, (13, -21, 8, 34, -5, -27)))


def pairs() -> list[Pair]:
    five = (10.5, 20.25, 40.0, 80.75, 160.5)
    return [
        _f09("line", _LIDAR, _TRUE),
        _f09(
            "one_offset",
            [x + 0.25 for x in five],
            five,
            ("mean difference removed", "mean absolute difference"),
            kind="boundary",
        ),
        _f09(
            "nanometres",
            [round(1000 + k * 1e-10, 10) for k in (3, -1, 4, 1, -5)],
            [1000.0] * 5,
            kind="ill_conditioned",
            tolerance_why=_EXACT,
        ),
        _f10("line", _LIDAR, _TRUE),
        _f10(
            "far",
            [5000 + k for k in (3.0, 1.0, 4.0, 1.0, 5.0)],
            [5000 + k / 4 for k in (2, 7, 1, 8, 2)],
            kind="boundary",
        ),
        _f11("line", 0.0045, 92.5),
        _f11("grade_limit", 1.875, 62.5, kind="boundary"),
        _f13("line", _LIDAR[:5], (0.0015, -0.00225, 0.00075, 0.003, -0.00125), 0.012, 0.00015),
        _f13("both_negative", (25.5, 310.25), (-0.0025, 0.001953125), -0.0375, -0.0003),
        _f14("line", _LIDAR[:5], _TRUE[:5], 0.0117, 0.000152),
        _f14("far", _NEAR_LIDAR, _NEAR_TRUE, 0.0185, 0.0000012),
        _fit("line", _LIDAR, _TRUE),
        _fit("five_panels", _LIDAR[1:6], _TRUE[1:6], kind="boundary"),
        _fit("nearly_one_distance", _NEAR_LIDAR, _NEAR_TRUE, kind="ill_conditioned"),
        _f15("line", _LIDAR[:5], 0.0117, 0.000152),
        _f15("zero_constants", (1.5, 300.25), -0.5, -0.0009765625, kind="boundary"),
        _chain("line", _LIDAR, _TRUE),
    ]


_EXACT = "differences of doubles this close are exact, so 1e-9 is kept although the condition number is large"
