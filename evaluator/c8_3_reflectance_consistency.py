"""8.3 Radiometric consistency of LiDAR and camera: correlation r_f, formula (7), and relative error M_f, formula (8).

Holds the formulas, the empirical line of 8.3.2 g and both indicators. The LiDAR's reflectance comes from 8.1's module, the
panels' image values from `observe/panels.py`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from campaign.config import Band
from campaign.sensors import CameraSheet
from campaign.survey import Spectra, SurveyedTarget
from evaluator.c8_1_lidar_reflectance import (
    PanelReflectances,
    bootstrap_panels,
    held_out_rmse,
    interval,
    lidar_reflectance_rmse,
    paired,
    panel_means,
    panel_shortfall,
    panel_table,
)
from evaluator.model import EvaluationError
from evaluator.observe.panels import ImagePanelObservation
from evaluator.results_model import IndicatorValue, not_measured

_MIN_PANELS_IN_IMAGE = 3
_MAX_CLIPPED_SHARE = 0.001


def reflectance_correlation(lidar: object, camera: object) -> float:
    r"""Correlation r_f of the reflectances measured by LiDAR and camera, formula (7).

    .. math:: r_f = \frac{\sum (R_{1,i} - \bar R_1)(R_{2,i} - \bar R_2)}
              {\sqrt{\sum (R_{1,i} - \bar R_1)^2 \sum (R_{2,i} - \bar R_2)^2}}

    Parameters
    ----------
    lidar, camera : (n,) array_like
        Reflectance of each panel, R_1 and R_2; any one unit, the ratio has none.

    Returns
    -------
    float
        r_f between -1 and 1; times 100 it is the indicator in percent.

    Raises
    ------
    EvaluationError
        Fewer than two panels, unequal lengths, a value that is not finite, or one list that does not vary.

    References
    ----------
    GB/T 41450-2022, 8.3.1, formula (7).
    """
    r1, r2 = paired("formula (7)", lidar, camera, 2)
    d1, d2 = r1 - r1.mean(), r2 - r2.mean()
    squares = float(np.sqrt(np.sum(d1 * d1) * np.sum(d2 * d2)))
    if squares <= 1e-15 * max(float(np.abs(r1).max() * np.abs(r2).max()), 1e-300):
        raise EvaluationError("formula (7): all reflectances of one sensor are equal", expected="panels that differ")
    return float(np.clip(np.sum(d1 * d2) / squares, -1.0, 1.0))


def reflectance_rmse_relative(lidar: object, camera: object) -> float:
    r"""Relative root mean square error M_f of the reflectances of LiDAR and camera, formula (8).

    .. math:: M_f = \sqrt{\frac{\sum (R_{1,i} - R_{2,i})^2}{2 (n - 1)}}

    Parameters
    ----------
    lidar, camera : (n,) array_like
        Reflectance of each panel, R_1 and R_2. [% or 1, both alike]

    Returns
    -------
    float
        M_f in the unit given, the positive root.

    Raises
    ------
    EvaluationError
        Fewer than two panels, unequal lengths, or a value that is not finite.

    References
    ----------
    GB/T 41450-2022, 8.3.1, formula (8).
    """
    r1, r2 = paired("formula (8)", lidar, camera, 2)
    return float(np.sqrt(np.sum((r1 - r2) ** 2) / (2.0 * (r1.size - 1))))


@dataclass(frozen=True, kw_only=True)
class EmpiricalLine:
    """R = gain_j * DN + offset: a gain for each image, one offset."""

    gain: np.ndarray  # (images,) [% per DN]
    offset_percent: float


def empirical_line(dn: object, reflectance_percent: object, image: object = None) -> EmpiricalLine:
    """Relative radiometric correction by the empirical line: DN above the black level -> reflectance, least squares.

    Light changes from image to image, path radiance hardly does over one range: so each image has a gain of its own and all
    share the offset. With one image this is the common straight line.

    Parameters
    ----------
    dn : (n,) array_like
        Mean of a panel in an image, black level subtracted. [DN]
    reflectance_percent : (n,) array_like
        Its actual reflectance over the band. [%]
    image : (n,) array_like of int, optional
        Which image (0, 1, ...) each value is from; one image when absent.

    Raises
    ------
    EvaluationError
        Fewer values than unknowns, unequal lengths, a value that is not finite, or an image without signal.

    References
    ----------
    GB/T 41450-2022, 8.3.2 g. Smith and Milton (1999), Int. J. Remote Sens. 20(13), doi:10.1080/014311699211994.
    """
    values, reflectance = paired("empirical line", dn, reflectance_percent, 2)
    index = np.zeros(values.size, dtype=np.int64) if image is None else np.asarray(image, dtype=np.int64)
    if index.shape != values.shape or index.min() < 0:
        raise EvaluationError(
            "empirical line: image numbers do not match the values", got=index.shape, expected=values.shape
        )
    images = int(index.max()) + 1
    if values.size < images + 1:
        raise EvaluationError("empirical line: too few panels", got=values.size, expected=f"at least {images + 1}")
    scale = float(np.abs(values).max()) or 1.0
    design = np.zeros((values.size, images + 1))
    design[np.arange(values.size), index] = values / scale
    design[:, images] = 1.0
    solution, _, rank, _ = np.linalg.lstsq(design, reflectance, rcond=1e-10)
    if rank < images + 1:
        raise EvaluationError("empirical line: the panels' DN do not vary", expected="panels of different reflectance")
    return EmpiricalLine(gain=solution[:images] / scale, offset_percent=float(solution[images]))


def band_reflectance(spectra: Spectra, panel: str, band: Band) -> float:
    """Spectrometer reflectance of one panel over a band with Gaussian response (3.17), cut at 3 FWHM. [%]"""
    if panel not in spectra.panel_ids:
        raise EvaluationError("panel has no spectrum", where=panel, remedy="add its column to survey/spectra.csv")
    w = spectra.wavelength_nm
    if not w[0] <= band.centre_nm <= w[-1]:
        raise EvaluationError(
            f"spectra do not reach band {band.name}", got=f"{band.centre_nm} nm", expected=f"{w[0]} to {w[-1]} nm"
        )
    half = 3.0 * band.fwhm_nm
    grid = np.linspace(max(w[0], band.centre_nm - half), min(w[-1], band.centre_nm + half), 601)
    response = np.exp(-4.0 * np.log(2.0) * ((grid - band.centre_nm) / band.fwhm_nm) ** 2)
    values = np.interp(grid, w, spectra.reflectance[:, spectra.panel_ids.index(panel)])
    return float(100.0 * np.sum(values * response) / np.sum(response))


def choose_band(bands: Sequence[Band], name: str | None = None) -> int:
    """The camera band of the indicator: the named one, else `red`, else the first."""
    names = [b.name for b in bands]
    if name is not None and name not in names:
        raise EvaluationError("camera has no such band", got=name, expected=", ".join(names))
    return names.index(name or ("red" if "red" in names else names[0]))


def usable_images(observations: Sequence[ImagePanelObservation], band: int) -> list[ImagePanelObservation]:
    """Drops clipped values, unevenly lit panels (where the same panel has an even one) and images with under three panels."""
    clear = [o for o in observations if o.clipped_share[band] <= _MAX_CLIPPED_SHARE]
    even = {o.panel for o in clear if not o.uneven}
    clear = [o for o in clear if not o.uneven or o.panel not in even]
    count: dict[tuple[int, str], int] = {}
    for o in clear:
        count[o.sortie, o.image] = count.get((o.sortie, o.image), 0) + 1
    return [o for o in clear if count[o.sortie, o.image] >= _MIN_PANELS_IN_IMAGE]


def camera_reflectances(
    observations: Sequence[ImagePanelObservation], reference_percent: dict[str, float], band: int
) -> PanelReflectances:
    """R_2 of every panel in one band: empirical line over all images, values averaged over images."""
    used = usable_images(observations, band)
    if not used:
        raise EvaluationError("no panel has a usable value in the images", expected="unclipped panels, three an image")
    keys = sorted({(o.sortie, o.image) for o in used})
    image = np.array([keys.index((o.sortie, o.image)) for o in used])
    panel = np.array([o.panel for o in used])
    dn = np.array([o.mean_dn[band] for o in used])
    reference = np.array([reference_percent[p] for p in panel])
    line = empirical_line(dn, reference, image)
    outside = np.full(panel.size, np.nan)
    for p in np.unique(panel):
        own = panel == p
        kept = np.unique(image[~own])
        if (~own).sum() < kept.size + 1 or not np.isin(image[own], kept).all():
            continue
        other = empirical_line(dn[~own], reference[~own], np.searchsorted(kept, image[~own]))
        outside[own] = other.gain[np.searchsorted(kept, image[own])] * dn[own] + other.offset_percent
    return panel_means(panel, line.gain[image] * dn + line.offset_percent, outside, reference_percent)


def line_table(
    observations: Sequence[ImagePanelObservation], reference_percent: dict[str, float], band: int
) -> dict[str, object]:
    """The empirical line as `camera_reflectances` fits it: gain of each image, the offset, DN and R of every panel in every
    image."""
    used = usable_images(observations, band)
    keys = sorted({(o.sortie, o.image) for o in used})
    image = np.array([keys.index((o.sortie, o.image)) for o in used])
    dn = np.array([o.mean_dn[band] for o in used])
    line = empirical_line(dn, np.array([reference_percent[o.panel] for o in used]), image)
    values: list[dict[str, object]] = [
        {
            "panel": o.panel,
            "sortie": o.sortie,
            "image": o.image,
            "pixels": o.pixels,
            "dn": float(d),
            "reflectance_percent": float(line.gain[i] * d + line.offset_percent),
        }
        for o, i, d in zip(used, image, dn, strict=True)
    ]
    gains = [
        {"sortie": sortie, "image": name, "gain_percent_per_dn": float(g)}
        for (sortie, name), g in zip(keys, line.gain, strict=True)
    ]
    return {"offset_percent": line.offset_percent, "gains": gains, "values": values}


def evaluate_reflectance_consistency(
    lidar: PanelReflectances | None,
    observations: Sequence[ImagePanelObservation],
    targets: Sequence[SurveyedTarget],
    spectra: Spectra | None,
    camera: CameraSheet | None,
    *,
    band: str | None = None,
    lidar_reason: str = "the LiDAR's reflectance is not measured",
) -> tuple[IndicatorValue, IndicatorValue, PanelReflectances | None]:
    """Indicators `reflectance_correlation` and `reflectance_rmse_relative`, and the camera's panel values.

    The indicator is of one band (`choose_band`); every band's figures stand among the companions, with the camera's and the
    LiDAR's own leave-one-panel-out errors.
    """

    def both(reason: str) -> tuple[IndicatorValue, IndicatorValue, None]:
        return (
            not_measured("%", "(7)", "8.3", reason),
            not_measured("% reflectance", "(8)", "8.3", reason),
            None,
        )

    if camera is None or spectra is None:
        return both(f"{'sensors/camera.json' if camera is None else 'survey/spectra.csv'} is missing")
    if lidar is None:
        return both(lidar_reason)
    per_band: dict[str, dict[str, object]] = {}
    values: dict[int, PanelReflectances] = {}
    try:
        chosen = choose_band(camera.bands, band)
        for b, sheet in enumerate(camera.bands):
            reference = {p: band_reflectance(spectra, p, sheet) for p in {o.panel for o in observations}}
            values[b] = camera_reflectances(observations, reference, b)
            r1, r2, _ = common_panels(lidar, values[b])
            per_band[sheet.name] = {
                "reflectance_correlation": 100.0 * reflectance_correlation(r1, r2),
                "reflectance_rmse_relative": reflectance_rmse_relative(r1, r2),
                "camera_rmse": lidar_reflectance_rmse(values[b].measured_percent, values[b].reference_percent),
                "camera_leave_one_panel_out": held_out_rmse(values[b]),
            }
    except EvaluationError as error:
        return both(str(error))
    camera_values = values[chosen]
    r1, r2, panels = common_panels(lidar, camera_values)
    h1, h2, _ = common_panels(lidar, camera_values, held_out=True)
    companions: dict[str, object] = {
        "band": camera.bands[chosen].name,
        "bands": per_band,
        "lidar_leave_one_panel_out": held_out_rmse(lidar),
        "camera_leave_one_panel_out": held_out_rmse(camera_values),
        "images": len({(o.sortie, o.image) for o in usable_images(observations, chosen)}),
        "uneven_panels": sorted({o.panel for o in observations if o.uneven}),
        "panels": panel_table(camera_values),
    }
    reference = {p: band_reflectance(spectra, p, camera.bands[chosen]) for p in {o.panel for o in observations}}
    line = line_table(observations, reference, chosen)
    held_out_complete = bool(np.isfinite(h1).all() and np.isfinite(h2).all())
    reason = panel_shortfall(panels, targets)
    draws = bootstrap_panels(len(panels))
    d1, d2 = r1[draws], r2[draws]
    c1, c2 = d1 - d1.mean(axis=1, keepdims=True), d2 - d2.mean(axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        r_draws = 100.0 * (c1 * c2).sum(axis=1) / np.sqrt((c1**2).sum(axis=1) * (c2**2).sum(axis=1))
    m_draws = np.sqrt(((d1 - d2) ** 2).sum(axis=1) / (2.0 * (len(panels) - 1)))
    results = []
    for unit, formula, value, resampled, held in (
        (
            "%",
            "(7)",
            100.0 * reflectance_correlation(r1, r2),
            r_draws,
            100.0 * reflectance_correlation(h1, h2) if held_out_complete else None,
        ),
        (
            "% reflectance",
            "(8)",
            reflectance_rmse_relative(r1, r2),
            m_draws,
            reflectance_rmse_relative(h1, h2) if held_out_complete else None,
        ),
    ):
        own = {**companions, "leave_one_panel_out": held}
        if formula == "(7)":  # once for both
            own["empirical_line"] = line
        if reason is not None:
            results.append(not_measured(unit, formula, "8.3", reason, value_on_what_is_there=value, **own))
            continue
        std, low, high = interval(resampled)
        results.append(
            IndicatorValue(
                value=value,
                unit=unit,
                formula=formula,
                clause="8.3",
                sample_size=len(panels),
                std=std,
                low_95=low,
                high_95=high,
                method=f"bootstrap over {len(panels)} panels, {draws.shape[0]} resamples",
                companions=own,
            )
        )
    return results[0], results[1], camera_values


def common_panels(
    lidar: PanelReflectances, camera: PanelReflectances, *, held_out: bool = False
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """R_1 and R_2 of the panels that both sensors measured."""
    panels = tuple(sorted(set(lidar.panels) & set(camera.panels)))
    if len(panels) < 2:
        raise EvaluationError("LiDAR and camera have no two panels in common", got=len(panels))
    chosen = [
        (v.held_out_percent if held_out else v.measured_percent)[[v.panels.index(p) for p in panels]]
        for v in (lidar, camera)
    ]
    return chosen[0], chosen[1], panels
