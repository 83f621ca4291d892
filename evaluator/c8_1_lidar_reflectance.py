"""8.1 LiDAR radiometric performance: reflectance from echo amplitude and range, and its root mean square error m_f, formula (2).

Holds the formula, the empirical surface f(A, L, R) of 8.1.2 f-h and the indicator with its companions. How panels are found in
the cloud and echoes in the waveforms: `observe/`. Grades: 10.1's module.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from campaign.sensors import LidarSheet
from campaign.survey import Spectra, SurveyedTarget
from evaluator.algorithms.record import OWN_TOOLS, Tools
from evaluator.algorithms.slots import ReflectanceTask
from evaluator.model import EvaluationError
from evaluator.observe.panels import LidarPanelObservation
from evaluator.results_model import IndicatorValue, not_measured

MIN_PANELS = 20
MIN_PANELS_OF_EACH = 4
NOMINAL_CLASSES_PERCENT = (5.0, 20.0, 40.0, 60.0, 100.0)
_RESAMPLES = 4000
_BOOTSTRAP_SEED = 41450  # fixed: the same campaign gives the same interval
_COEFFICIENTS = 6


def paired(name: str, first: object, second: object, at_least: int) -> tuple[np.ndarray, np.ndarray]:
    """Two arrays of equal length with finite values; raises EvaluationError in one line otherwise."""
    a, b = (np.asarray(v, dtype=np.float64) for v in (first, second))
    if a.ndim != 1 or a.shape != b.shape:
        raise EvaluationError(f"{name}: the two lists differ", got=f"{a.shape} and {b.shape}", expected="equal lengths")
    if a.size < at_least:
        raise EvaluationError(f"{name}: too few panels", got=a.size, expected=f"at least {at_least}")
    for values in (a, b):
        if not np.isfinite(values).all():
            index = int(np.flatnonzero(~np.isfinite(values))[0])
            raise EvaluationError(f"{name}: a value is not finite", got=f"{values[index]} at index {index}")
    return a, b


def lidar_reflectance_rmse(measured_percent: object, reference_percent: object) -> float:
    r"""Root mean square error m_f of the reflectance measured by the LiDAR, formula (2).

    .. math:: m_f = \sqrt{\frac{1}{n} \sum_{i=1}^{n} (R_i - \hat R_i)^2}

    Parameters
    ----------
    measured_percent : (n,) array_like
        Reflectance of each panel by the LiDAR, R_i. [%]
    reference_percent : (n,) array_like
        Actual reflectance of each panel by the spectrometer. [%]

    Returns
    -------
    float
        m_f; the standard prints a sign of either kind, this is the positive root. [% reflectance]

    Raises
    ------
    EvaluationError
        No panel, unequal lengths, or a value that is not finite.

    References
    ----------
    GB/T 41450-2022, 8.1.1, formula (2).
    """
    measured, reference = paired("formula (2)", measured_percent, reference_percent, 1)
    return float(np.sqrt(np.mean((measured - reference) ** 2)))


@dataclass(frozen=True, kw_only=True)
class ReflectanceSurface:
    """f(A, L): second-order polynomial on amplitude and range scaled to about -1..1."""

    coefficients: np.ndarray  # (6,) of 1, a, l, a^2, a l, l^2 [%]
    amplitude_centre: float
    amplitude_scale: float
    range_centre_m: float
    range_scale_m: float

    def __call__(self, amplitude: object, range_m: object) -> np.ndarray:
        """Reflectance at (A, L). [%]"""
        terms = _terms(
            (np.asarray(amplitude, dtype=np.float64) - self.amplitude_centre) / self.amplitude_scale,
            (np.asarray(range_m, dtype=np.float64) - self.range_centre_m) / self.range_scale_m,
        )
        return np.asarray(terms @ self.coefficients)


def _terms(a: np.ndarray, l: np.ndarray) -> np.ndarray:
    return np.stack([np.ones_like(a), a, l, a * a, a * l, l * l], axis=-1)


def fit_reflectance_surface(amplitude: object, range_m: object, reflectance_percent: object) -> ReflectanceSurface:
    """Empirical radiometric model f(A, L, R): second-order polynomial by least squares.

    Variables are centred and scaled by half their spread; where they do not vary enough for all six coefficients (one range
    only) the least-norm solution is taken.

    Parameters
    ----------
    amplitude : (n,) array_like
        Echo peak above the baseline, linear. [DN]
    range_m : (n,) array_like
        Slant range. [m]
    reflectance_percent : (n,) array_like
        Actual reflectance. [%]

    Raises
    ------
    EvaluationError
        Fewer than six values, unequal lengths, or a value that is not finite.

    References
    ----------
    GB/T 41450-2022, 8.1.2 f-g.
    """
    a, reflectance = paired("surface f(A, L, R)", amplitude, reflectance_percent, _COEFFICIENTS)
    l, _ = paired("surface f(A, L, R)", range_m, reflectance_percent, _COEFFICIENTS)
    centres, scales = [], []
    for values in (a, l):
        low, high = float(values.min()), float(values.max())
        centres.append(0.5 * (low + high))
        scales.append(max(0.5 * (high - low), 1e-6 * max(abs(high), 1.0)))
    terms = _terms((a - centres[0]) / scales[0], (l - centres[1]) / scales[1])
    coefficients, *_ = np.linalg.lstsq(terms, reflectance, rcond=1e-8)
    return ReflectanceSurface(
        coefficients=coefficients,
        amplitude_centre=centres[0],
        amplitude_scale=scales[0],
        range_centre_m=centres[1],
        range_scale_m=scales[1],
    )


def reflectance_at(spectra: Spectra, panel: str, wavelength_nm: float) -> float:
    """Spectrometer reflectance of one panel at one wavelength, linear between its samples. [%]"""
    if panel not in spectra.panel_ids:
        raise EvaluationError("panel has no spectrum", where=panel, remedy="add its column to survey/spectra.csv")
    w = spectra.wavelength_nm
    if not w[0] <= wavelength_nm <= w[-1]:
        raise EvaluationError(
            "spectra do not reach the laser's wavelength", got=f"{wavelength_nm} nm", expected=f"{w[0]} to {w[-1]} nm"
        )
    return float(100.0 * np.interp(wavelength_nm, w, spectra.reflectance[:, spectra.panel_ids.index(panel)]))


@dataclass(frozen=True, kw_only=True)
class PanelReflectances:
    """Reflectance of n panels by one sensor; each is the mean over its strips (images) and heights. [%]"""

    panels: tuple[str, ...]  # sorted
    reference_percent: np.ndarray  # (n,) spectrometer
    measured_percent: np.ndarray  # (n,) model fitted on the same panels, as the standard has it
    held_out_percent: np.ndarray  # (n,) model fitted without this panel
    spread_percent: np.ndarray  # (n,) standard deviation of the single values
    observations: np.ndarray  # (n,) how many


def lidar_reflectances(
    observations: Sequence[LidarPanelObservation],
    reference_percent: dict[str, float],
    *,
    incidence: bool = False,
    tools: Tools = OWN_TOOLS,
) -> PanelReflectances:
    """R_i of every panel: one surface f(A, L, R) for each design height, values averaged over strips and heights.

    Parameters
    ----------
    observations : sequence of LidarPanelObservation
        One a panel and strip.
    reference_percent : dict
        Actual reflectance by panel. [%]
    incidence : bool
        The named variant: A / cos(incidence) takes the place of A.
    tools : Tools
        `reflectance_model` is used.
    """
    if not observations:
        raise EvaluationError("no panel was found in the LiDAR's strips")
    panel = np.array([o.panel for o in observations])
    height = np.array([o.design_height_m for o in observations])
    amplitude = np.array([o.amplitude_dn / (o.cos_incidence if incidence else 1.0) for o in observations])
    range_m = np.array([o.range_m for o in observations])
    reference = np.array([reference_percent[p] for p in panel])
    inside, outside = np.full(panel.size, np.nan), np.full(panel.size, np.nan)

    def model(known: np.ndarray, at: np.ndarray) -> np.ndarray:
        return tools.reflectance_model(
            ReflectanceTask(
                amplitude_dn=amplitude[known],
                range_m=range_m[known],
                reflectance_percent=reference[known],
                at_amplitude_dn=amplitude[at],
                at_range_m=range_m[at],
            )
        )

    for h in np.unique(height):
        rows = height == h
        inside[rows] = model(rows, rows)
        for p in np.unique(panel[rows]):
            others, own = rows & (panel != p), rows & (panel == p)
            if others.sum() >= _COEFFICIENTS:
                outside[own] = model(others, own)
    return panel_means(panel, inside, outside, reference_percent)


def panel_means(
    panel: np.ndarray, inside: np.ndarray, outside: np.ndarray, reference_percent: dict[str, float]
) -> PanelReflectances:
    """Single values -> one a panel."""
    names = tuple(sorted(set(panel.tolist())))
    groups = [panel == name for name in names]
    return PanelReflectances(
        panels=names,
        reference_percent=np.array([reference_percent[n] for n in names]),
        measured_percent=np.array([inside[g].mean() for g in groups]),
        held_out_percent=np.array([outside[g].mean() for g in groups]),
        spread_percent=np.array([inside[g].std(ddof=1) if g.sum() > 1 else 0.0 for g in groups]),
        observations=np.array([int(g.sum()) for g in groups]),
    )


def bootstrap_panels(count: int) -> np.ndarray:
    """(resamples, count) indices of panels drawn with replacement; the same for the same count."""
    rng = np.random.default_rng(np.random.SeedSequence([_BOOTSTRAP_SEED, count]))
    return rng.integers(0, count, size=(_RESAMPLES, count))


def interval(values: np.ndarray) -> tuple[float, float, float]:
    """Standard deviation and 95 % interval of bootstrap values."""
    values = values[np.isfinite(values)]
    return float(values.std(ddof=1)), float(np.quantile(values, 0.025)), float(np.quantile(values, 0.975))


def panel_shortfall(panels: Iterable[str], targets: Sequence[SurveyedTarget]) -> str | None:
    """Why these panels are fewer than 8.1.2 a and 8.3.2 a ask for; None when they are enough."""
    found = set(panels)
    nominal = {t.id: t.nominal_reflectance_percent for t in targets if t.kind == "panel"}
    if len(found) < MIN_PANELS:
        missing = sorted(set(nominal) - found)
        tail = f"; not found: {', '.join(missing[:8])}{' ...' if len(missing) > 8 else ''}" if missing else ""
        return f"{len(found)} panels measured, at least {MIN_PANELS} are needed{tail}"
    classes = Counter(nominal.get(p) for p in found)
    for c in NOMINAL_CLASSES_PERCENT:
        if classes.get(c, 0) < MIN_PANELS_OF_EACH:
            return f"{classes.get(c, 0)} panels of {c:g} % measured, at least {MIN_PANELS_OF_EACH} are needed"
    return None


def panel_table(values: PanelReflectances) -> list[dict[str, object]]:
    """Rows for the report."""
    return [
        {
            "panel": name,
            "reference_percent": float(values.reference_percent[i]),
            "measured_percent": float(values.measured_percent[i]),
            "held_out_percent": _number(values.held_out_percent[i]),
            "spread_percent": float(values.spread_percent[i]),
            "observations": int(values.observations[i]),
        }
        for i, name in enumerate(values.panels)
    ]


def surface_table(
    observations: Sequence[LidarPanelObservation], reference_percent: dict[str, float]
) -> list[dict[str, object]]:
    """The surface f(A, L) of each design height as `lidar_reflectances` fits it, with the panels' values that it was fitted to."""
    tables: list[dict[str, object]] = []
    for height in sorted({o.design_height_m for o in observations}):
        mine = [o for o in observations if o.design_height_m == height]
        amplitude, range_m = (
            [float(v) for v in column] for column in zip(*((o.amplitude_dn, o.range_m) for o in mine))
        )
        surface = fit_reflectance_surface(amplitude, range_m, [reference_percent[o.panel] for o in mine])
        tables.append(
            {
                "design_height_m": height,
                "coefficients": [float(v) for v in surface.coefficients],  # of 1, a, l, a^2, a l, l^2
                "amplitude_centre": surface.amplitude_centre,  # a = (A - centre) / scale
                "amplitude_scale": surface.amplitude_scale,
                "range_centre_m": surface.range_centre_m,  # l = (L - centre) / scale
                "range_scale_m": surface.range_scale_m,
                "panel": [o.panel for o in mine],
                "sortie": [o.sortie for o in mine],
                "strip": [o.strip for o in mine],
                "amplitude_dn": amplitude,
                "range_m": range_m,
                "reference_percent": [float(reference_percent[o.panel]) for o in mine],
            }
        )
    return tables


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def held_out_rmse(values: PanelReflectances) -> float | None:
    """Formula (2) on the values of the leave-one-panel-out models; None where one of them could not be computed."""
    if not np.isfinite(values.held_out_percent).all():
        return None
    return lidar_reflectance_rmse(values.held_out_percent, values.reference_percent)


def evaluate_lidar_reflectance(
    observations: Sequence[LidarPanelObservation],
    targets: Sequence[SurveyedTarget],
    spectra: Spectra | None,
    lidar: LidarSheet | None,
    tools: Tools = OWN_TOOLS,
) -> tuple[IndicatorValue, PanelReflectances | None]:
    """Indicator `lidar_reflectance_rmse` with its companions, and the panels' values for 8.3.

    The value is in-sample, as 8.1.2 f-i is written. Beside it: the leave-one-panel-out figure (all strips of a panel left
    out together), and both for the variant with the incidence angle. Its interval is a bootstrap over panels.
    """
    unit, formula, clause = "% reflectance", "(2)", "8.1"
    if lidar is None or spectra is None:
        missing = "sensors/lidar.json" if lidar is None else "survey/spectra.csv"
        return not_measured(unit, formula, clause, f"{missing} is missing"), None
    try:
        reference = {p: reflectance_at(spectra, p, lidar.wavelength_nm) for p in {o.panel for o in observations}}
        plain = lidar_reflectances(observations, reference, tools=tools)
        angle = lidar_reflectances(observations, reference, incidence=True, tools=tools)
    except EvaluationError as error:
        return not_measured(unit, formula, clause, str(error)), None
    value = lidar_reflectance_rmse(plain.measured_percent, plain.reference_percent)
    heights = sorted({o.design_height_m for o in observations})
    companions: dict[str, object] = {
        "leave_one_panel_out": held_out_rmse(plain),
        "with_cos_incidence": lidar_reflectance_rmse(angle.measured_percent, angle.reference_percent),
        "with_cos_incidence_leave_one_panel_out": held_out_rmse(angle),
        "mean_difference": float(np.mean(plain.measured_percent - plain.reference_percent)),
        "wavelength_nm": lidar.wavelength_nm,
        "design_heights_m": heights,
        "observations": len(observations),
        "returns_used": int(sum(o.used for o in observations)),
        "panels": panel_table(plain),
        # the coefficients of our own surface say nothing about another model
        "surfaces": [] if "reflectance_model" in tools.replaced else surface_table(observations, reference),
    }
    reason = panel_shortfall(plain.panels, targets)
    if reason is None and not all(o.from_waveform for o in observations):
        count = sum(not o.from_waveform for o in observations)
        reason = f"no waveforms on {count} of {len(observations)} panel observations (8.1.2 d-e need them)"
    if reason is not None:
        return not_measured(unit, formula, clause, reason, value_on_what_is_there=value, **companions), plain
    squares = (plain.measured_percent - plain.reference_percent) ** 2
    std, low, high = interval(np.sqrt(squares[bootstrap_panels(squares.size)].mean(axis=1)))
    result = IndicatorValue(
        value=value,
        unit=unit,
        formula=formula,
        clause=clause,
        sample_size=len(plain.panels),
        std=std,
        low_95=low,
        high_95=high,
        method=f"bootstrap over {squares.size} panels, {_RESAMPLES} resamples",
        companions=companions,
    )
    return result, plain
