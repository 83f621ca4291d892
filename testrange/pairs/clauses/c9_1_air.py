"""9.1.2 e, formula (12): correction of a total station's distance for the air, and the group index that it needs."""

from collections.abc import Sequence
from typing import Any

from mpmath import exp, mpf

from testrange.pairs.build import Formula, Values, given, pair
from testrange.pairs.model import Pair

_IUGG = "IUGG 1999 check value 286.338 (here with the WMO's saturation vapour pressure, which moves it by 0.001)"


_TWELVE: dict[str, Formula] = {
    "sign reversed: n_g - n_0": lambda v: -_twelve(v),
    "indices in percent: n_0 - n_g taken a hundredth": lambda v: _twelve(v) / 100,
    "refractivity N in place of the index n = 1 + N 1e-6": lambda v: (
        _twelve(v) * v["group_index"] / (v["group_index"] - 1)
    ),
    "divided by n_0": lambda v: _twelve(v) * v["group_index"] / v["reference_index"],
    "in millimetres": lambda v: 1000 * _twelve(v),
}


def _twelve(v: Values) -> Any:
    return v["distance"] * (v["reference_index"] - v["group_index"]) / v["group_index"]


def _f12(name: str, s: float, n0: float, ng: float, without: Sequence[str] = (), **more: Any) -> Pair:
    return pair(
        f"f12_{name}",
        "(12)",
        "9.1.2 e",
        "Delta D = S (n_0 - n_g) / n_g; both indices are dimensionless, near 1.0003 (the text's 'in percent' cannot be meant).",
        [
            given("distance", "m", "slope distance S as read", s),
            given("reference_index", "1", "n_0 of the instrument's design", n0),
            given("group_index", "1", "group index n_g of the air at work", ng),
        ],
        [("delta_d", "m")],
        _twelve,
        {k: f for k, f in _TWELVE.items() if k not in without},
        tolerance_why="n_0 - n_g of doubles this close is exact, so 1e-9 is kept although the condition number is large",
        **more,
    )


def _group(v: Values, **change: Any) -> Any:
    """Group refractivity N of IUGG 1999; `change` makes the known mistakes."""
    w = v["wavelength"] * change.get("wavelength", 1)
    kelvin = v["temperature"] + change.get("zero", mpf("273.15"))
    a, b = change.get("dispersion", (mpf("4.88660"), mpf("0.06800")))
    standard = mpf("287.6155") + a / w**2 + b / w**4
    dry = mpf("273.15") / mpf("1013.25") * standard * v["pressure"] * change.get("pressure", 1) / kelvin
    return dry + change.get("wet", -1) * mpf("11.27") * _vapour(v) / kelvin


def _vapour(v: Values) -> Any:
    if "vapour" in v:
        return v["vapour"]
    t = v["temperature"]
    return mpf("6.112") * exp(mpf("17.62") * t / (mpf("243.12") + t)) * v["humidity"] / 100


def _air(
    name: str,
    wavelength: float,
    t: float,
    p: float,
    *,
    vapour: float | None = None,
    humidity: float | None = None,
    **more: Any,
) -> Pair:
    wet = (
        given("vapour", "hPa", "partial pressure e of water vapour", vapour)
        if humidity is None
        else given(
            "humidity", "%", "relative humidity; e = 6.112 exp(17.62 t / (243.12 + t)) hPa times it (WMO)", humidity
        )
    )
    return pair(
        f"f12_air_{name}",
        "(12)",
        "9.1.2 e",
        """Group refractivity N = (n_g - 1) 1e6 of air by the IUGG resolution of 1999: N = (273.15 / 1013.25) N_gr p / T - 11.27 e
            / T with N_gr = 287.6155 + 4.88660 / w^2 + 0.06800 / w^4, w in um, T = t + 273.15 K.""",
        [
            given("wavelength", "um", "carrier wavelength w", wavelength),
            given("temperature", "deg C", "temperature t", t),
            given("pressure", "hPa", "pressure p", p),
            wet,
        ],
        [("N", "1e-6")],
        _group,
        {
            "phase index in place of the group index": lambda v: _group(v, dispersion=(mpf("1.62887"), mpf("0.01360"))),
            "degrees Celsius shifted by 273 K": lambda v: _group(v, zero=mpf(273)),
            "wet term added": lambda v: _group(v, wet=1),
            "wet term left out": lambda v: _group(v, wet=0),
            "pressure in mmHg": lambda v: _group(v, pressure=mpf("0.750061683")),
        },
        tolerance_why="of n_g - 1; n_g itself in double precision leaves 4e-13 of it",
        **more,
    )


def pairs() -> list[Pair]:
    return [
        _f12("line", 201.764, 1.000286, 1.000279),
        _f12("one_ppb", 1000.0, 1.000286001, 1.000286, ("divided by n_0",), kind="ill_conditioned"),
        _air("iugg_1999", 0.658, 12.0, 1013.25, humidity=60.0, kind="published", published=_IUGG),
        _air("summer", 0.85, 31.5, 998.5, vapour=24.25),
        _air("mountain", 1.55, -8.25, 612.75, vapour=1.5),
    ]
