"""8.2 optical radiometric performance: stability RSD, formulas (3)-(5), and repeatability s(x), formula (6).

Holds the formulas, the two indicators and what stands beside them. How the central pixels get out of an image:
`observe/sphere_images.py`. The trend of a series: `series_trend.py`. Whether a series was taken as 8.2.2 says:
`conformity/`. Grades: 10.1's module.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from campaign.benches.bench import SphereExposure
from campaign.progress import Report, silent
from evaluator.benches.bench_model import SphereResult, SphereSeries
from evaluator.benches.series_trend import first_third, trend
from evaluator.load import in_folder
from evaluator.model import CampaignData, EvaluationError
from evaluator.observe.sphere_images import CentralPixels, central_pixels, copied, unlit
from evaluator.results_model import IndicatorValue, not_measured

MIN_IMAGES = 3
WARM_UP_S = 1200.0  # 8.2.2.1 c and 8.2.2.2 c
SIGNIFICANT = 0.05  # two-sided probability below which a trend is called one
UNSETTLED = 0.01  # the same for the first third of a series
_METHOD = (
    "chi-square with n - 1 degrees of freedom for the worst channel, taking the images' deviations as independent and normal; "
    "std = value / sqrt(2 (n - 1))"
)


def mean_dn(dn: object) -> float:
    r"""Arithmetic mean of the digital numbers, formula (4).

    .. math:: \overline{DN} = \frac{1}{n} \sum_{i=1}^{n} DN_i

    Parameters
    ----------
    dn : (n,) array_like
        DN_i, the mean of the nine central pixels of image i, black level subtracted. [DN]

    Returns
    -------
    float
        [DN]

    Raises
    ------
    EvaluationError
        Fewer than two values, not one list, or a value that is not finite.

    References
    ----------
    GB/T 41450-2022, 8.2.1 b, formula (4).
    """
    return float(np.mean(_list("formula (4)", dn)))


def standard_deviation_dn(dn: object) -> float:
    r"""Standard deviation of n measurements, formula (5); formula (6) has the same form.

    .. math:: SD = \sqrt{\frac{1}{n-1} \sum_{i=1}^{n} (DN_i - \overline{DN})^2}

    Parameters
    ----------
    dn : (n,) array_like
        DN_i, as in `mean_dn`. [DN]

    Returns
    -------
    float
        [DN]

    Raises
    ------
    EvaluationError
        As `mean_dn`.

    References
    ----------
    GB/T 41450-2022, 8.2.1 c, formula (5).
    """
    return float(np.std(_list("formula (5)", dn), ddof=1))


def stability_rsd(dn: object) -> float:
    r"""Stability RSD: standard deviation relative to the mean, formula (3).

    .. math:: RSD = 100\,\% \cdot SD / \overline{DN}

    Parameters
    ----------
    dn : (n,) array_like
        DN_i of the images of one hour, black level subtracted. [DN]

    Returns
    -------
    float
        [%]

    Raises
    ------
    EvaluationError
        As `mean_dn`; or the mean is not above zero.

    References
    ----------
    GB/T 41450-2022, 8.2.1 a-c, formulas (3)-(5).
    """
    return _relative("formula (3)", dn)


def repeatability(dn: object) -> float:
    r"""Repeatability s(x): standard deviation in percent of the mean, formula (6).

    .. math:: s(x) = 100\,\% \cdot \frac{1}{\bar x} \sqrt{\frac{1}{n-1} \sum_{i=1}^{n} (x_i - \bar x)^2}

    The standard prints (6) without the division, which is a number in DN (`standard_deviation_dn`), and states s(x) and its
    limits in percent: it is taken relative to the mean.

    Parameters
    ----------
    dn : (n,) array_like
        x_i of the images of five minutes, black level subtracted. [DN]

    Returns
    -------
    float
        [%]

    Raises
    ------
    EvaluationError
        As `stability_rsd`.

    References
    ----------
    GB/T 41450-2022, 8.2.1 d, formula (6).
    """
    return _relative("formula (6)", dn)


def _list(name: str, dn: object) -> np.ndarray:
    try:
        values = np.asarray(dn, dtype=np.float64)
    except (TypeError, ValueError):
        raise EvaluationError(f"{name}: the measurements are not numbers") from None
    if values.ndim != 1 or values.size < 2:
        raise EvaluationError(f"{name}: not a series", got=f"shape {values.shape}", expected="two or more numbers")
    if not np.isfinite(values).all():
        index = int(np.flatnonzero(~np.isfinite(values))[0])
        raise EvaluationError(f"{name}: a value is not finite", got=f"{values[index]} at index {index}")
    return values


def _relative(name: str, dn: object) -> float:
    values = _list(name, dn)
    mean = float(np.mean(values))
    if mean <= 0.0:
        raise EvaluationError(f"{name}: the mean is not above the black level", got=f"{mean:g} DN")
    return 100.0 * float(np.std(values, ddof=1)) / mean


@dataclass(frozen=True, kw_only=True)
class _Method:
    """One of the two methods of 8.2.2."""

    name: str
    formula: str
    place: str
    value: Callable[[object], float]


_STABILITY = _Method(name="sphere_stability", formula="(3)-(5)", place="bench/sphere_stability", value=stability_rsd)
_REPEATABILITY = _Method(
    name="sphere_repeatability", formula="(6)", place="bench/sphere_repeatability", value=repeatability
)


def evaluate_sphere(data: CampaignData, progress: Report = silent) -> SphereResult:
    """Both indicators of 8.2 from the campaign's series at the integrating sphere.

    An indicator is the figure of its worst colour channel; every channel's stands in the companions. Nothing that a folder
    may hold raises: what cannot be measured comes back with its reason.

    Parameters
    ----------
    data : CampaignData
    progress : callable
        Called with "sphere", images read, images in all.
    """
    logs = (data.bench.stability, data.bench.repeatability)
    total, done = sum(map(len, logs)), 0

    def step() -> None:
        nonlocal done
        done += 1
        progress("sphere", done, total)

    progress("sphere", 0, total)
    stability = _series(data, _STABILITY, data.folder.sphere_stability, logs[0], step)
    repeated = _series(data, _REPEATABILITY, data.folder.sphere_repeatability, logs[1], step)
    return SphereResult(
        stability=stability[0],
        stability_series=stability[1],
        repeatability=repeated[0],
        repeatability_series=repeated[1],
    )


def _series(
    data: CampaignData, method: _Method, folder: Path, log: Sequence[SphereExposure], step: Callable[[], None]
) -> tuple[IndicatorValue, SphereSeries | None]:
    def refused(reason: str, **companions: object) -> IndicatorValue:
        return not_measured("%", method.formula, "8.2", reason, **companions)

    if not folder.is_dir():
        return refused(f"no {method.place} in this campaign"), None
    if not log:
        broken = [line for line in data.problems if line.startswith(f"{method.place}/log.csv")]
        return refused(broken[0] if broken else f"no images listed: no {method.place}/log.csv, or an empty one"), None
    read: list[tuple[SphereExposure, CentralPixels]] = []
    left_out: list[str] = []
    for exposure in log:
        try:
            path = data.folder.held(folder / exposure.image)
            read.append((exposure, central_pixels(path, data.camera)))
        except Exception as error:  # whatever a decoder makes of a hostile file
            left_out.append(f"{exposure.image}: {_why(error, data.folder.root)}")
        step()
    sizes = Counter(str(pixels.size) for _, pixels in read)
    if len(sizes) > 1:
        usual = sizes.most_common(1)[0][0]
        odd, got = next((e.image, str(p.size)) for e, p in read if str(p.size) != usual)
        reason = (
            f"{method.place}: images of mixed size; got {got} in {odd}, expected {usual} as in {sizes[usual]} images"
        )
        return refused(reason, left_out=left_out), None
    saturated = [(e, p) for e, p in read if p.saturated_share > 0.0]
    worst = max((p.saturated_share for _, p in read), default=0.0)
    if saturated and 2 * len(saturated) > len(read):
        count = f"{len(saturated)} of {len(read)} images"
        reason = (
            f"{method.place}: the centre is saturated in {count} (at full scale, or nine equal pixels far up the scale); "
            "shorten the exposure (8.2.2 d)"
        )
        spoiled = _gathered(data, read, left_out, worst)
        visible = spoiled.dn.mean(axis=0).min() > 0.0
        return refused(reason, left_out=left_out, saturated_share=worst), spoiled if visible else None
    left_out += [f"{e.image}: {p.saturated_share:.0%} of its central pixels are saturated" for e, p in saturated]
    used = [(e, p) for e, p in read if p.saturated_share == 0.0]
    if len(used) < MIN_IMAGES:
        reason = f"{method.place}: too few usable images; got {len(used)} of {len(log)}, expected at least {MIN_IMAGES}"
        if left_out:
            reason += f"; first left out: {left_out[0]}"
        return refused(reason, left_out=left_out), None
    series = _gathered(data, used, left_out, worst)
    no_series = unlit(series.bands, [p for _, p in used]) or copied([p for _, p in used])
    if no_series:
        return refused(f"{method.place}: {no_series}", left_out=left_out), None
    return _indicator(method, series, [e for e, _ in used], [p for _, p in used]), series


def _gathered(
    data: CampaignData, read: list[tuple[SphereExposure, CentralPixels]], left_out: list[str], saturated_share: float
) -> SphereSeries:
    first = read[0][0]
    return SphereSeries(
        images=tuple(e.image for e, _ in read),
        time_s=np.array([e.gps_time_s - first.gps_time_s for e, _ in read]),
        dn=np.array([p.dn for _, p in read]),
        bands=_bands(data, len(read[0][1].dn)),
        since_lamp_on_s=first.since_lamp_on_s,
        left_out=tuple(left_out),
        saturated_share=saturated_share,
    )


def _why(error: Exception, root: Path) -> str:
    lines = str(error).splitlines()
    return in_folder(lines[0] if lines else type(error).__name__, root)


def _bands(data: CampaignData, count: int) -> tuple[str, ...]:
    if data.camera is not None and len(data.camera.bands) == count:
        return tuple(band.name for band in data.camera.bands)
    return {1: ("grey",), 3: ("red", "green", "blue")}.get(count) or tuple(f"band_{k + 1}" for k in range(count))


def _indicator(
    method: _Method, series: SphereSeries, log: list[SphereExposure], pixels: list[CentralPixels]
) -> IndicatorValue:
    n = len(series.images)
    values = [method.value(column) for column in series.dn.T]
    worst = int(np.argmax(values))
    low, high = values[worst] * np.sqrt((n - 1) / stats.chi2.ppf([0.975, 0.025], n - 1))
    return IndicatorValue(
        value=values[worst],
        unit="%",
        formula=method.formula,
        clause="8.2",
        sample_size=n,
        std=values[worst] / float(np.sqrt(2.0 * (n - 1))),
        low_95=float(low),
        high_95=float(high),
        method=_METHOD,
        companions={
            "worst_channel": series.bands[worst],
            "sd_dn": standard_deviation_dn(series.dn[:, worst]),
            "mean_dn": mean_dn(series.dn[:, worst]),
            "channels": _channels(method, series, log if all(p.linear for p in pixels) else []),
            **_trend_companions(series),
            **_lamp_companions(series, log),
            "images_used": n,
            "linear_pixels": all(p.linear for p in pixels),
            "left_out": list(series.left_out),
            "duration_s": float(series.time_s[-1]),
            "saturated_share": series.saturated_share,
            "black_level_dn": list(pixels[0].black_dn),
            "black_level_source": "; ".join(sorted({p.black_source for p in pixels})),
        },
    )


def _channels(method: _Method, series: SphereSeries, log: list[SphereExposure]) -> dict[str, dict[str, float | None]]:
    """Every channel's figures; the part of photon noise in them where one gain is recorded for all rows of the log (none where
    the pixels are not linear: no gain is theirs)."""
    gains = {e.gain_e_per_dn for e in log}
    gain = gains.pop() if len(gains) == 1 else None
    out: dict[str, dict[str, float | None]] = {}
    for name, dn in zip(series.bands, series.dn.T, strict=True):
        value, mean = method.value(dn), mean_dn(dn)
        line = trend(series.time_s, dn)
        photon = None if gain is None else 100.0 / float(np.sqrt(9.0 * gain * mean))
        out[name] = {
            "value": value,
            "sd_dn": standard_deviation_dn(dn),
            "mean_dn": mean,
            "trend_percent_per_h": None if line is None else line.percent_per_h,
            "photon_noise_percent": photon,
            "photon_noise_share": None if photon is None or value == 0.0 else (photon / value) ** 2,
        }
    return out


def _trend_companions(series: SphereSeries) -> dict[str, object]:
    """Trend of the channels together: a lamp's drift is common, and their sum weights them as photon noise asks for."""
    common = series.dn.sum(axis=1)
    line = trend(series.time_s, common)
    out: dict[str, object] = {
        "trend_percent_per_h": None if line is None else line.percent_per_h,
        "trend_std_percent_per_h": None if line is None else line.std_percent_per_h,
        "trend_p_value": None if line is None else line.p_value,
        "trend_significant": None if line is None else line.p_value < SIGNIFICANT,
    }
    settled = first_third(series.time_s, common)
    out["first_third_percent"] = None if settled is None else settled[0]
    out["first_third_std_percent"] = None if settled is None else settled[1]
    out["settled"] = None if settled is None else settled[2] >= UNSETTLED
    return out


def _lamp_companions(series: SphereSeries, log: list[SphereExposure]) -> dict[str, object]:
    since = series.since_lamp_on_s
    temperatures = [e.camera_temperature_c for e in log if e.camera_temperature_c is not None]
    settings = [{getattr(e, key) for e in log} for key in ("exposure_time_s", "gain_e_per_dn", "f_number")]
    return {
        "since_lamp_on_s": since,
        "warm_up_complete": None if since is None else since >= WARM_UP_S,
        "camera_temperature_c": [min(temperatures), max(temperatures)] if temperatures else None,
        "one_setting": all(len(values) == 1 for values in settings),
    }
