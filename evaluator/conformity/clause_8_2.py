"""8.2.2: how the two series at the integrating sphere were taken. 6.3.1's room stands in clause_6_3."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from campaign.benches.bench import SphereExposure
from evaluator.benches.bench_model import SphereSeries
from evaluator.conformity.clause_6_3 import has_sphere
from evaluator.conformity.model import ConformityInputs, Row, missing, passed, percent, row
from evaluator.model import CampaignData
from evaluator.results_model import IndicatorValue

_WARM_UP_S = 1200.0
_TOLERANCE = 0.10  # of an interval: a person or an intervalometer triggers; the text states none
_IMAGES = 21  # both ends of the period included


@dataclass(frozen=True, kw_only=True)
class _Protocol:
    """One of the two methods."""

    clause: str
    name: str
    place: str
    interval_s: float
    wording: str


_STABILITY = _Protocol(
    clause="8.2.2.1",
    name="stability",
    place="bench/sphere_stability",
    interval_s=180.0,
    wording="3 min apart, over 1 h",
)
_REPEATABILITY = _Protocol(
    clause="8.2.2.2",
    name="repeatability",
    place="bench/sphere_repeatability",
    interval_s=15.0,
    wording="15 s apart, over 5 min",
)


def _warm_up(protocol: _Protocol, log: Sequence[SphereExposure]) -> Row:
    clause, requirement, limit = f"{protocol.clause} c", f"warm-up before the {protocol.name} series", "≥ 20 min"
    since = log[0].since_lamp_on_s
    if since is None:
        return missing(clause, requirement, limit, f"since_lamp_on_s in {protocol.place}/log.csv")
    return row(
        clause,
        requirement,
        f"{since / 60.0:.1f} min from switch-on to the first image",
        limit,
        passed(since >= _WARM_UP_S),
    )


def _exposed(
    protocol: _Protocol, log: Sequence[SphereExposure], series: SphereSeries | None, value: IndicatorValue | None
) -> list[Row]:
    clause = f"{protocol.clause} d"
    requirement, limit = f"{protocol.name} images not over-exposed", "no saturated pixel in the central region"
    share = series.saturated_share if series else value.companions.get("saturated_share") if value else None
    if not isinstance(share, int | float):
        clipped = missing(clause, requirement, limit, "image that could be read")
    else:
        text = f"{percent(share, 1)} of the central region saturated, at worst" if share > 0.0 else "none"
        clipped = row(clause, requirement, text, limit, passed(share == 0.0))
    requirement, limit = f"{protocol.name} images of one setting", "the same exposure time and gain"
    settings = {
        name: sorted({getattr(e, key) for e in log if getattr(e, key) is not None})
        for name, key in (("exposure", "exposure_time_s"), ("gain", "gain_e_per_dn"), ("f-number", "f_number"))
    }
    if not settings["exposure"] or not settings["gain"]:
        return [clipped, missing(clause, requirement, limit, f"exposure time and gain in {protocol.place}/log.csv")]
    units = {"exposure": " s", "gain": " e/DN", "f-number": ""}
    parts = [
        f"{name} {values[0]:.5g}{units[name]}"
        if len(values) == 1
        else f"{name} from {values[0]:.5g} to {values[-1]:.5g}{units[name]}"
        for name, values in settings.items()
        if values
    ]
    same = all(len(values) <= 1 for values in settings.values())
    return [clipped, row(clause, requirement, ", ".join(parts), limit, passed(same))]


def _intervals(protocol: _Protocol, log: Sequence[SphereExposure], series: SphereSeries | None) -> Row:
    clause, requirement = f"{protocol.clause} f", f"images of the {protocol.name} series"
    limit = f"{_IMAGES} images {protocol.wording}, each interval within {percent(_TOLERANCE, 0)}"
    used = log
    if series is not None:
        used = [e for e in log if e.image in set(series.images)] or log
    steps = np.diff([e.gps_time_s for e in used])
    text = f"{len(used)} images"
    if series is not None and series.left_out:
        text += f", {len(series.left_out)} left out"
    if steps.size == 0:
        return row(clause, requirement, text, limit, "fail")
    text += f", {steps.min():.1f} s to {steps.max():.1f} s apart, over {steps.sum() / 60.0:.1f} min"
    even = bool(np.all(np.abs(steps / protocol.interval_s - 1.0) <= _TOLERANCE + 1e-9))
    return row(clause, requirement, text, limit, passed(len(used) >= _IMAGES and even))


def _series(
    protocol: _Protocol, log: Sequence[SphereExposure], series: SphereSeries | None, value: IndicatorValue | None
) -> list[Row]:
    if not log:
        limit = f"{protocol.clause} a to h"
        return [missing(protocol.clause, f"{protocol.name} series", limit, f"readable {protocol.place}/log.csv")]
    return [_warm_up(protocol, log), *_exposed(protocol, log, series, value), _intervals(protocol, log, series)]


def clause_8_2(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    """Rows of 8.2.2; one row where the campaign has no sphere."""
    if not has_sphere(data):
        requirement, limit = "images of an integrating sphere", "8.2.2.1 and 8.2.2.2"
        return [row("8.2.2", requirement, "no integrating sphere in this campaign", limit, "not_applicable")]
    result, bench = measured.sphere, data.bench
    if result is None:
        return [
            *_series(_STABILITY, bench.stability, None, None),
            *_series(_REPEATABILITY, bench.repeatability, None, None),
        ]
    return [
        *_series(_STABILITY, bench.stability, result.stability_series, result.stability),
        *_series(_REPEATABILITY, bench.repeatability, result.repeatability_series, result.repeatability),
    ]
