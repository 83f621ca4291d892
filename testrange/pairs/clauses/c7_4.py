"""7.4 a, formula (1): flying height from focal length, ground resolution and pixel size."""

from typing import Any

from testrange.pairs.build import Values, given, pair
from testrange.pairs.model import Pair

_STATEMENT = "H = f GSD / a: flying height above the ground, in metres."


def _height(v: Values) -> Any:
    return v["focal_mm"] * v["gsd_m"] / v["pixel_mm"]


_MISTAKES = {
    "millimetres for metres: H in mm": lambda v: _height(v) * 1000,
    "pixel size in um": lambda v: _height(v) / 1000,
    "f and a exchanged": lambda v: v["pixel_mm"] * v["gsd_m"] / v["focal_mm"],
    "GSD in cm": lambda v: _height(v) * 100,
}


def _one(name: str, focal: float, gsd: float, pixel: float, **more: Any) -> Pair:
    return pair(
        f"f01_{name}",
        "(1)",
        "7.4 a",
        _STATEMENT,
        [
            given("focal_mm", "mm", "focal length f", focal),
            given("gsd_m", "m", "ground resolution GSD", gsd),
            given("pixel_mm", "mm", "pixel size a of the sensor", pixel),
        ],
        [("H", "m")],
        _height,
        _MISTAKES,
        **more,
    )


def pairs() -> list[Pair]:
    return [
        _one("p1", 35.0, 0.0125, 0.0044),
        _one("wide", 24.0, 0.01953125, 0.00390625),
        _one("ceiling", 50.0, 0.078125, 0.00390625, kind="boundary"),  # the 1000 m of 7.4 a
    ]
