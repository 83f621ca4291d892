"""From the true value that a member shall have to the faults that give it: root finding on the reference functions.

A `Knob` maps a strength to settings and to everything that is then true. No rendering happens here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from scipy.optimize import brentq

from campaign.config import Config
from campaign.errors import ConfigError
from campaign.load import load_config
from testrange.family.model import UNITS, Family, Group, Indicator, Value, accepted_grades

GROUP: dict[Indicator, Group] = {
    "lidar_reflectance_rmse": "radiometry",
    "camera_stability": "sphere",
    "camera_repeatability": "sphere",
    "reflectance_correlation": "radiometry",
    "reflectance_rmse_relative": "radiometry",
    "lidar_ranging_rmse_relative": "ranging",
    "camera_reprojection_error": "chessboard",
    "calibration_error": "geometry",
}
_CALM_PERCENT = 0.2  # of the series at the sphere that is not varied
_VERTEX_STD_M, _MARK_STD_PX = 0.001, 0.02  # of one frustum vertex in one strip, an axis; of a mark in one image


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What is true at one strength, of every indicator and constant that the member holds."""

    settings: tuple[str, ...]
    indicators: dict[str, Value]
    constants: dict[str, Value] = field(default_factory=dict)
    mounting: dict[str, Value] = field(default_factory=dict)


def value_of(indicator: Indicator, value: float, tolerance: float, mistakes: dict[str, float] | None = None) -> Value:
    """With unit and accepted grades."""
    return Value(
        value=value,
        tolerance=tolerance,
        unit=UNITS[indicator],
        grades=accepted_grades(indicator, value, tolerance),
        mistakes=mistakes or {},
    )


def group_config(family: Family, group: Group, settings: Sequence[str] = ()) -> Config:
    """The configuration of a kind of members."""
    return load_config(family.base, (*family.set, *getattr(family, group).set, *settings))


def _list(values: Sequence[float]) -> str:
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"


@dataclass(frozen=True, kw_only=True)
class Knob:
    """Of one indicator: from a strength between 0 and `most` to its true value, and to everything that is then true."""

    indicator: Indicator
    most: float
    value: Callable[[float], float]  # quick
    truth: Callable[[float], Truth]  # with tolerances


def knob(family: Family, indicator: Indicator) -> Knob:
    """The fault that moves an indicator."""
    group = GROUP[indicator]
    if group == "sphere":
        return _sphere(family, indicator)
    if group == "ranging":
        return _ranging(family, indicator)
    if group == "chessboard":
        return _chessboard(family, indicator)
    if group == "radiometry":
        return _radiometry(family, indicator)
    return _geometry(family, indicator)


def _sphere(family: Family, indicator: Indicator) -> Knob:
    from testrange.family.truth.sphere import gains, true_value

    plain = group_config(family, "sphere")

    def truth(strength: float) -> Truth:
        varied, calm = gains(plain, strength), gains(plain, _CALM_PERCENT)
        first, second = (varied, calm) if indicator == "camera_stability" else (calm, varied)
        faults = plain.faults.model_copy(update={"stability_gains": first, "repeatability_gains": second})
        config = plain.model_copy(update={"faults": faults})
        return Truth(
            settings=(f"faults.stability_gains={_list(first)}", f"faults.repeatability_gains={_list(second)}"),
            indicators={
                "camera_stability": value_of("camera_stability", *true_value(config, "stability")),
                "camera_repeatability": value_of("camera_repeatability", *true_value(config, "repeatability")),
            },
        )

    return Knob(indicator=indicator, most=20.0, value=lambda s: truth(s).indicators[indicator].value, truth=truth)


def _ranging(family: Family, indicator: Indicator) -> Knob:
    from testrange.family.truth.ranging import Ranging, table

    plain = group_config(family, "ranging")
    line, distances = Ranging(plain), plain.ranging.distances_m

    def truth(strength: float) -> Truth:
        rows = table(distances, strength)
        true = line.truth(rows, family.replicates)
        k2, r2 = true.additive_constant_m, true.multiplication_constant
        return Truth(
            settings=(f"faults.range_table=[{', '.join(_list(r) for r in rows)}]",) if rows else (),
            indicators={indicator: value_of(indicator, true.m_z_percent, true.m_z_std_percent, true.mistakes)},
            constants={
                "additive_constant_m": Value(value=k2, tolerance=true.additive_constant_std_m, unit="m"),
                "multiplication_constant": Value(value=r2, tolerance=true.multiplication_constant_std, unit="1"),
            },
        )

    # 0.58 m: an evaluator that looks for a panel within 0.6 m of its distance finds it
    return Knob(indicator=indicator, most=0.58, value=lambda s: line.m_z_percent(table(distances, s)), truth=truth)


def _chessboard(family: Family, indicator: Indicator) -> Knob:
    from testrange.family.truth.geometry import Chessboard

    board = Chessboard(group_config(family, "chessboard"))
    solved = lru_cache(maxsize=None)(board.value)

    def truth(strength: float) -> Truth:
        true = solved(strength)
        return Truth(
            settings=(f"faults.image_ripple_px={strength!r}",),
            indicators={indicator: value_of(indicator, true.value_px, true.std_px, true.mistakes)},
        )

    return Knob(indicator=indicator, most=2.2, value=lambda s: solved(s).value_px, truth=truth)


def _radiometry(family: Family, indicator: Indicator) -> Knob:
    from testrange.family.truth.reflectance import Radiometry

    panels = Radiometry(group_config(family, "radiometry"))
    name = {"lidar_reflectance_rmse": "m_f", "reflectance_correlation": "r_f", "reflectance_rmse_relative": "relative"}

    def truth(strength: float) -> Truth:
        gains = panels.gains(strength)
        true, spread = panels.values(gains), panels.spread(gains, family.replicates)
        n = true.panels
        values = {"lidar_reflectance_rmse": value_of("lidar_reflectance_rmse", true.m_f, spread.m_f)}
        if indicator != "lidar_reflectance_rmse":
            values["reflectance_correlation"] = value_of(
                "reflectance_correlation", true.r_f, spread.r_f, {"squared": true.r_f**2 / 100.0}
            )
            values["reflectance_rmse_relative"] = value_of(
                "reflectance_rmse_relative",
                true.relative,
                spread.relative,
                {
                    "2n in the place of 2(n - 1)": true.relative * ((n - 1) / n) ** 0.5,
                    "n - 1 in the place of 2(n - 1)": true.relative * 2.0**0.5,
                    "n in the place of 2(n - 1)": true.relative * (2.0 * (n - 1) / n) ** 0.5,
                },
            )
        pairs = ", ".join(f'["{panel}", {gain!r}]' for panel, gain in gains.items())
        return Truth(
            settings=(f"faults.panel_laser_gain=[{pairs}]",) if gains else (),
            indicators={key: value for key, value in values.items() if key in name},
        )

    def value(strength: float) -> float:
        return float(getattr(panels.values(panels.gains(strength)), name[indicator]))

    return Knob(indicator=indicator, most=1.0, value=value, truth=truth)


def _geometry(family: Family, indicator: Indicator) -> Knob:
    from testrange.family.truth.geometry import Calibration

    config = group_config(family, "geometry")
    marks = Calibration(config, _VERTEX_STD_M, _MARK_STD_PX)
    solved = lru_cache(maxsize=None)(lambda strength: marks.value(strength, family.replicates))
    faults = config.faults

    def truth(strength: float) -> Truth:
        true = solved(strength)
        mounting = {}
        for kind, axes, unit, stated, lidar, moved, std in (
            ("boresight", ("roll", "pitch", "yaw"), "deg", faults.camera_boresight_deg, faults.lidar_boresight_deg,
             true.boresight_deg, true.boresight_std_deg),
            ("lever_arm", ("x", "y", "z"), "m", faults.camera_lever_arm_m, faults.lidar_lever_arm_m,
             true.lever_arm_m, true.lever_arm_std_m),
        ):  # fmt: skip
            for k, axis in enumerate(axes):
                turned = float(moved[k])
                mounting[f"camera_{kind}_{axis}"] = Value(
                    value=stated[k] + turned, tolerance=0.002 + 2.0 * float(std[k]) + abs(turned), unit=unit
                )
                mounting[f"lidar_{kind}_{axis}"] = Value(value=lidar[k], tolerance=0.004 + abs(turned), unit=unit)
        error = true.error
        return Truth(
            settings=(f"faults.image_ripple_px={strength!r}",) if strength else (),
            indicators={indicator: value_of(indicator, error.value_px, error.std_px, error.mistakes)},
            mounting=mounting,
        )

    return Knob(indicator=indicator, most=4.0, value=lambda s: solved(s).error.value_px, truth=truth)


def solve(knob: Knob, wanted: float) -> Truth:
    """What is true at the strength that gives the wanted value.

    Raises
    ------
    ConfigError
        No strength gives it.
    """

    def off(strength: float) -> float:
        return knob.value(strength) - wanted

    low, high = off(0.0), off(knob.most)
    if low * high > 0.0:
        reach = sorted(v + wanted for v in (low, high))
        raise ConfigError(
            "cannot be set in this family",
            where=knob.indicator,
            got=f"{wanted:g} {UNITS[knob.indicator]}",
            expected=f"{reach[0]:.3g} to {reach[1]:.3g}",
            remedy="change the settings of its kind of members",
        )
    strength = brentq(off, 0.0, knob.most, xtol=1e-6 * knob.most, rtol=1e-6, maxiter=60)
    return knob.truth(float(f"{strength:.7g}"))
