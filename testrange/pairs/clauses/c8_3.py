"""8.3.1, formulas (7) and (8): correlation and relative error of the reflectances of LiDAR and camera."""

from collections.abc import Sequence
from typing import Any

from mpmath import fdot, fsum, mpf, sqrt

from testrange.pairs.build import Formula, Values, given, pair
from testrange.pairs.model import Pair
from testrange.pairs.tables import B1_CAMERA, B1_LIDAR, PANELS_CAMERA, PANELS_LIDAR


def _centred(x: Sequence[Any]) -> list[Any]:
    mean = fsum(x) / len(x)
    return [value - mean for value in x]


def _r(v: Values) -> Any:
    a, b = _centred(v["lidar"]), _centred(v["camera"])
    return fdot(a, b) / sqrt(fdot(a, a) * fdot(b, b))


def _squares(v: Values) -> Any:
    return fsum([(a - b) ** 2 for a, b in zip(v["lidar"], v["camera"], strict=True)])


def _m(v: Values) -> Any:
    return sqrt(_squares(v) / (2 * (len(v["lidar"]) - 1)))


def _ranks(x: Sequence[Any]) -> list[Any]:
    return [mpf(sum(other < value for other in x)) + mpf(sum(other == value for other in x) + 1) / 2 for value in x]


_R_MISTAKES: dict[str, Formula] = {
    "covariance over n, variances over n-1": lambda v: _r(v) * (len(v["lidar"]) - 1) / len(v["lidar"]),
    "covariance over n-1, variances over n": lambda v: _r(v) * len(v["lidar"]) / (len(v["lidar"]) - 1),
    "r squared": lambda v: _r(v) ** 2,
    "in percent": lambda v: 100 * _r(v),
    "means not subtracted": lambda v: (
        fdot(v["lidar"], v["camera"]) / sqrt(fdot(v["lidar"], v["lidar"]) * fdot(v["camera"], v["camera"]))
    ),
    "slope of the regression line": lambda v: (
        fdot(_centred(v["lidar"]), _centred(v["camera"])) / fdot(_centred(v["lidar"]), _centred(v["lidar"]))
    ),
    "correlation of ranks": lambda v: _r({"lidar": _ranks(v["lidar"]), "camera": _ranks(v["camera"])}),
}
_M_MISTAKES: dict[str, Formula] = {
    "2n in place of 2(n-1)": lambda v: sqrt(_squares(v) / (2 * len(v["lidar"]))),
    "n-1 in place of 2(n-1)": lambda v: sqrt(_squares(v) / (len(v["lidar"]) - 1)),
    "n in place of 2(n-1), as in (2)": lambda v: sqrt(_squares(v) / len(v["lidar"])),
    "2n-1 in place of 2(n-1)": lambda v: sqrt(_squares(v) / (2 * len(v["lidar"]) - 1)),
    "no root": lambda v: _m(v) ** 2,
    "mean difference removed": lambda v: sqrt(
        fsum([d**2 for d in _centred([a - b for a, b in zip(v["lidar"], v["camera"], strict=True)])])
        / (2 * (len(v["lidar"]) - 1))
    ),
}


def _made(
    formula: str,
    name: str,
    lidar: Sequence[float],
    camera: Sequence[float],
    unit: str,
    without: Sequence[str] = (),
    **more: Any,
) -> Pair:
    seven = formula == "(7)"
    return pair(
        f"{'f07' if seven else 'f08'}_{name}",
        formula,
        "8.3.1 a" if seven else "8.3.1 b",
        """r_f = sum (R1_i - mean R1)(R2_i - mean R2) / root(sum (R1_i - mean R1)^2 sum (R2_i - mean R2)^2), as a number between
            -1 and 1 (times 100 it is the indicator in percent)."""
        if seven
        else "M_f = root(sum (R1_i - R2_i)^2 / (2 (n - 1))), the positive root, in the unit of the reflectances.",
        [
            given("lidar", unit, "reflectance R1_i of each panel by the LiDAR", list(lidar)),
            given("camera", unit, "reflectance R2_i of each panel by the camera", list(camera)),
        ],
        [("r_f", "1")] if seven else [("M_f", unit)],
        _r if seven else _m,
        {k: f for k, f in (_R_MISTAKES if seven else _M_MISTAKES).items() if k not in without},
        **more,
    )


def pairs() -> list[Pair]:
    ranks = "correlation of ranks"
    percent = [100 * v for v in (0.0625, 0.1875, 0.40625, 0.609375, 0.96875)]
    other = [100 * v for v in (0.078125, 0.203125, 0.421875, 0.640625, 0.9453125)]
    # 20 panels of one class: reflectances of 50 %, apart by parts of 2^-13 %
    offsets = (0, 3, 1, 4, 1, 5, 9, 2, 6, 5, 3, 5, 8, 9, 7, 9, 3, 2, 3, 8)
    tight = [50 + k / 2**13 for k in offsets]
    tight_other = [
        50 + (2 * k + e) / 2**13 for k, e in zip(offsets, (1, 0, 2, 1, 0, 2, 1, 1, 0, 2, 0, 1, 2, 0, 1, 1, 2, 0, 0, 1))
    ]
    near_one = [5.0, 20.0, 40.0, 60.0, 100.0]
    nearly = [round(x + d * 1e-6, 6) for x, d in zip(near_one, (1, -2, 3, -1, 1))]
    cancels = (
        "reflectances this close to their mean differ from it exactly, so subtracting the means first keeps 1e-12 although the "
        "condition number is large"
    )
    return [
        _made("(7)", "panels", PANELS_LIDAR, PANELS_CAMERA, "%"),
        _made("(7)", "b1", B1_LIDAR, B1_CAMERA, "1", kind="published", published="appendix B.1: r_f = 99.83 %"),
        _made("(7)", "five_panels", percent, other, "%", (ranks,)),
        _made("(7)", "opposite", percent, other[::-1], "%", ("r squared", ranks), kind="boundary"),
        _made(
            "(7)",
            "near_one",
            near_one,
            nearly,
            "%",
            ("r squared", ranks, "slope of the regression line", "means not subtracted"),
            kind="boundary",
        ),
        _made("(7)", "one_class", tight, tight_other, "%", kind="ill_conditioned", tolerance_why=cancels),
        _made("(8)", "panels", PANELS_LIDAR, PANELS_CAMERA, "%"),
        _made(
            "(8)",
            "b1",
            B1_LIDAR,
            B1_CAMERA,
            "1",
            kind="published",
            published="appendix B.1: M_f = 1.24 % (here as a fraction)",
        ),
        _made("(8)", "five_panels", percent, other, "%"),
        _made(
            "(8)", "two_panels", [20.0, 60.5], [21.25, 58.0], "%", ("n in place of 2(n-1), as in (2)",), kind="boundary"
        ),
        _made("(8)", "identical", percent, percent, "%", tuple(_M_MISTAKES), scale=[1.0], kind="boundary"),
        _made("(8)", "one_class", tight, tight_other, "%", kind="ill_conditioned", tolerance_why=cancels),
    ]
