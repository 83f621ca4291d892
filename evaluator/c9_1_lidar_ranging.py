"""Clause 9.1: ranging error of the LiDAR, formulas (9)-(15), and the indicator m_z from a campaign's ranging line.

The total station's side with (12) is in `evaluator.benches.total_station` and offered here too, the records are gathered in
`evaluator.benches.ranging_observations`.
"""

import numpy as np
from numpy.typing import ArrayLike

from campaign.benches.ranging import RangingLine
from campaign.progress import Report
from evaluator.benches.bench_model import PanelRange, RangingResult
from evaluator.benches.ranging_arrangement import differences_m2, in_doubt, misread
from evaluator.benches.ranging_fit import MIN_PANELS, adjusted_constants, constants, range_residuals
from evaluator.benches.ranging_observations import (
    Found,
    lidar_covariance_m2,
    observe_scans,
    panel_ranges,
    station_of,
    unread,
)
from evaluator.benches.total_station import (
    StationResult,
    air_notes,
    covariance_m2,
    eccentricity_covariance_m2,
    group_refractive_index,
    meteorological_correction,
    saturation_pressure_hpa,
    unknown_stations,
    unused_stations,
)
from evaluator.model import CampaignData, EvaluationError
from evaluator.results_model import IndicatorValue, not_measured

__all__ = [
    "corrected_range",
    "evaluate_ranging",
    "group_refractive_index",
    "mean_range",
    "meteorological_correction",
    "range_correction_constants",
    "range_residuals",
    "ranging_rmse",
    "relative_rmse",
    "saturation_pressure_hpa",
]

UNIT, FORMULA, CLAUSE = "%", "(11)", "9.1"


def _checked(formula: str, least: int, *values: ArrayLike) -> list[np.ndarray]:
    arrays = [np.atleast_1d(np.asarray(v, np.float64)) for v in values]
    if any(a.ndim != 1 or len(a) != len(arrays[0]) for a in arrays):
        raise EvaluationError(
            f"formula {formula}: values are not of one length", got=[a.shape for a in arrays], expected="(n,)"
        )
    if len(arrays[0]) < least:
        raise EvaluationError(f"formula {formula}: too few panels", got=len(arrays[0]), expected=f"at least {least}")
    if not all(np.isfinite(a).all() for a in arrays):
        raise EvaluationError(f"formula {formula}: a value is not finite")
    return arrays


def ranging_rmse(measured_m: ArrayLike, reference_m: ArrayLike) -> float:
    """Root mean square ranging error m_j over the reference panels.

    Parameters
    ----------
    measured_m : (n,) array_like
        Slant range by the LiDAR, L_i. [m]
    reference_m : (n,) array_like
        Slant range by the total station, taken as relative true value. [m]

    Returns
    -------
    float
        m_j, the positive root of what is printed with both signs. [m]

    Raises
    ------
    EvaluationError
        Fewer than five panels, unequal lengths, or a value that is not finite.

    References
    ----------
    GB/T 41450-2022, 9.1.1, formula (9).
    """
    measured, reference = _checked("(9)", MIN_PANELS, measured_m, reference_m)
    return float(np.sqrt(np.mean((measured - reference) ** 2)))


def mean_range(reference_m: ArrayLike) -> float:
    """Mean range: as printed, the mean of the *true* ranges, although the text calls it the LiDAR's.

    Parameters
    ----------
    reference_m : (n,) array_like
        Slant range by the total station. [m]

    Returns
    -------
    float
        [m]

    Raises
    ------
    EvaluationError
        Fewer than five panels, or a value that is not finite.

    References
    ----------
    GB/T 41450-2022, 9.1.1, formula (10).
    """
    (reference,) = _checked("(10)", MIN_PANELS, reference_m)
    return float(np.mean(reference))


def relative_rmse(rmse_m: float, mean_range_m: float) -> float:
    """Relative ranging error m_z = m_j / mean range.

    Parameters
    ----------
    rmse_m : float
        m_j of (9). [m]
    mean_range_m : float
        Of (10). [m]

    Returns
    -------
    float
        [%]

    Raises
    ------
    EvaluationError
        A mean range that is not positive, or a value that is not finite.

    References
    ----------
    GB/T 41450-2022, 9.1.1, formula (11).
    """
    if not (np.isfinite(rmse_m) and np.isfinite(mean_range_m) and mean_range_m > 0.0):
        raise EvaluationError("formula (11): no positive mean range", got=[rmse_m, mean_range_m])
    return 100.0 * rmse_m / mean_range_m


def range_correction_constants(
    measured_m: ArrayLike, reference_m: ArrayLike, covariance_m2: ArrayLike | None = None
) -> tuple[float, float, np.ndarray]:
    r"""Additive and multiplication constant of the LiDAR, from v = -K_2 - R_2 L + (L_true - L) by least squares.

    Parameters
    ----------
    measured_m : (n,) array_like
        Range by the LiDAR, L_r. [m]
    reference_m : (n,) array_like
        Range by the total station. [m]
    covariance_m2 : (n, n) array_like, optional
        Of the differences reference - measured. Without it every panel weighs the same and the covariance comes from the
        residuals. [m2]

    Returns
    -------
    float, float, (2, 2) ndarray
        K_2 [m], R_2 (dimensionless; the standard's "in percent" cannot be meant for either), their covariance.

    Raises
    ------
    EvaluationError
        Fewer than five panels, unequal lengths, values not finite, panels all at one distance, or no covariance matrix.

    References
    ----------
    GB/T 41450-2022, 9.1.2 g-i, formulas (13) and (14).
    """
    measured, reference = _checked("(13)", MIN_PANELS, measured_m, reference_m)
    return constants(measured, reference, covariance_m2)


def corrected_range(measured_m: ArrayLike, additive_constant_m: float, multiplication_constant: float) -> np.ndarray:
    """Corrected range L_Q = L + K_2 + R_2 L.

    Parameters
    ----------
    measured_m : (n,) array_like
        Range by the LiDAR. [m]
    additive_constant_m : float
        K_2. [m]
    multiplication_constant : float
        R_2, dimensionless.

    Returns
    -------
    (n,) ndarray
        [m]

    References
    ----------
    GB/T 41450-2022, 9.1.2 j, formula (15).
    """
    measured = np.asarray(measured_m, np.float64)
    return measured + additive_constant_m + multiplication_constant * measured


def evaluate_ranging(data: CampaignData, progress: Report) -> RangingResult:
    """K_2, R_2 and m_z after correction from ranging/; whatever is missing becomes the indicator's reason.

    The indicator is 9.1.2 k's: corrected ranges against the station that serves "reference"; K_2 and R_2 come from the one
    that serves "correction".
    """
    found = Found()
    try:
        return _evaluate(data, progress, found)
    except EvaluationError as error:
        return RangingResult(indicator=_without(str(error), found))


def _without(reason: str, found: Found, **companions: object) -> IndicatorValue:
    return not_measured(UNIT, FORMULA, CLAUSE, reason, **_remarks(found), **companions)


def _remarks(found: Found) -> dict[str, object]:
    out: dict[str, object] = {"scans": found.scans}
    if found.duration_s:
        out["scan_duration_s"] = max(found.duration_s)
    if found.left_out:
        out["left_out"] = found.left_out
    if found.notes:
        out["notes"] = found.notes
    if found.same_scans:
        out["same_scans"] = found.same_scans
    if found.beside[1]:
        out["beside"] = {"panel": found.beside[1], "share": found.beside[0]}
    return out


def _evaluate(data: CampaignData, progress: Report, found: Found) -> RangingResult:
    line = data.ranging.line
    if line is None:
        absent = "no ranging/line.json" if data.folder.ranging.is_dir() else "no ranging/"
        raise EvaluationError(unread(data, "ranging/line.json") or f"{absent} in this campaign")
    if not data.ranging.readings:
        raise EvaluationError(unread(data, "ranging/total_station.csv") or "no reading in ranging/total_station.csv")
    found.left_out += unknown_stations(line, data.ranging.readings) + unused_stations(line, data.ranging.readings)
    site = data.manifest
    found.notes += air_notes(line, data.ranging.readings, site.ellipsoid_height_m - site.height_anomaly_m)
    correction, reference = (station_of(data, line, serves, found) for serves in ("correction", "reference"))
    if not data.ranging.scans:
        raise EvaluationError("no scan of the ranging line", expected="ranging/scans/scan_01.laz ...")
    try:
        observe_scans(data, line, correction, reference, found, progress)
    except EvaluationError:
        suspected = misread(data, line)
        if suspected is None:
            raise
        return RangingResult(indicator=_without(suspected, found, misread=suspected))
    panels, not_used = panel_ranges(line, correction, reference, found)
    usable = [p for p in panels if p.correction_m is not None and p.reference_m is not None]
    suspected = misread(data, line) if in_doubt(line, correction, reference, usable, found) else None
    if suspected is not None:
        return RangingResult(
            indicator=_without(suspected, found, misread=suspected, panels=_rows(panels)),
            panels=tuple(panels),
            not_used=not_used,
        )
    if len(usable) < MIN_PANELS:
        missing = "; ".join(f"{name}: {why}" for name, why in not_used.items())
        reason = f"too few panels of the ranging line are measured; got {len(usable)}; expected at least {MIN_PANELS}"
        return RangingResult(
            indicator=_without(f"{reason} ({missing})" if missing else reason, found, panels=_rows(panels)),
            panels=tuple(panels),
            not_used=not_used,
        )
    try:
        return _adjusted(line, correction, reference, panels, usable, not_used, found)
    except EvaluationError as error:
        return RangingResult(
            indicator=_without(str(error), found, panels=_rows(panels)), panels=tuple(panels), not_used=not_used
        )


def _adjusted(
    line: RangingLine,
    correction: StationResult,
    reference: StationResult,
    panels: list[PanelRange],
    usable: list[PanelRange],
    not_used: dict[str, str],
    found: Found,
) -> RangingResult:
    """(13)-(15) and (9)-(11) with the covariance of all that enters."""
    names = [p.panel for p in usable]
    measured = np.array([p.lidar_m for p in usable])
    first, truth = (np.array([getattr(p, k) for p in usable], float) for k in ("correction_m", "reference_m"))
    by_lidar, scale, freedom = lidar_covariance_m2(names, found)
    by_first, by_second = covariance_m2(correction, names), covariance_m2(reference, names)
    common = eccentricity_covariance_m2(line, reference, names)
    differences = differences_m2(line, correction, reference, names, found)
    fit = adjusted_constants(names, measured, first, differences)
    k2, r2 = (float(v) for v in fit.constants)
    if fit.remark is not None:
        found.notes.append(fit.remark)
    if fit.without is not None:
        not_used = {**not_used, fit.without[0]: f"left out of K2 and R2, counts in m_z: {fit.remark}"}
    corrected = corrected_range(measured, k2, r2)
    mean_m = mean_range(truth)
    before_m, after_m = ranging_rmse(measured, truth), ranging_rmse(corrected, truth)
    m_z = relative_rmse(after_m, mean_m)
    # error of the corrected range minus the reference: (I - M) lidar + M first + (M - I) common - second
    design = np.column_stack([np.ones(len(measured)), measured])
    through = design @ fit.gain
    rest = np.eye(len(measured)) - through
    after = rest @ (by_lidar + common) @ rest.T + through @ by_first @ through.T + by_second
    if correction.station.name == reference.station.name:  # the same readings twice
        after -= through @ by_first + by_first @ through.T
    after *= fit.factor
    std = relative_rmse(_rmse_std(corrected - truth, after), mean_m)
    plain = range_correction_constants(measured[fit.used], first[fit.used])
    held_out = _held_out(measured, first, truth, differences, fit.used)
    k2_std, r2_std = np.sqrt(np.diag(fit.covariance))
    rows = {p.panel: float(value) for p, value in zip(usable, corrected, strict=True)}
    panels = [
        PanelRange(**{**vars(p), "corrected_m": rows.get(p.panel, float(corrected_range(p.lidar_m, k2, r2)))})
        for p in panels
    ]
    indicator = IndicatorValue(
        value=m_z,
        unit=UNIT,
        formula=FORMULA,
        clause=CLAUSE,
        sample_size=len(usable),
        std=std,
        low_95=max(0.0, m_z - 1.96 * std),
        high_95=m_z + 1.96 * std,
        method="propagation of the covariance of the corrected ranges and relative true values (scatter of scans and "
        "readings, certificates, eccentricity, K2 and R2) to m_j, normal distribution",
        companions={
            "additive_constant_m": k2,
            "additive_constant_std_m": float(k2_std),
            "multiplication_constant": r2,
            "multiplication_constant_std": float(r2_std),
            "correlation": float(fit.covariance[0, 1] / (k2_std * r2_std)),
            "unweighted_constants": [plain[0], plain[1]],
            "rmse_m": after_m,
            "mean_range_m": mean_m,
            "rmse_before_m": before_m,
            "relative_rmse_before_percent": relative_rmse(before_m, mean_m),
            "expected_rmse_m": float(np.sqrt(np.trace(after) / len(usable))),
            "leave_one_panel_out_rmse_m": held_out,
            "leave_one_panel_out_percent": relative_rmse(held_out, mean_m),
            "chi_square": fit.chi_square,
            "chi_square_freedom": fit.freedom,
            "chi_square_p": fit.p,
            **({"residuals": fit.remark} if fit.remark else {}),
            "lidar_scatter_over_fit": float(np.sqrt(scale)) if freedom >= 4 else None,
            "reading_std_m": {
                use: result.scatter * float(np.mean([p.class_m for p in result.panels]))
                for use, result in (("correction", correction), ("reference", reference))
            },
            "stations": {"correction": correction.station.name, "reference": reference.station.name},
            "panels": _rows(panels),
            **({"not_used": not_used} if not_used else {}),
            **_remarks(found),
        },
    )
    return RangingResult(
        indicator=indicator,
        panels=tuple(panels),
        additive_constant_m=k2,
        multiplication_constant=r2,
        covariance=fit.covariance,
        not_used=not_used,
    )


def _rmse_std(error_m: np.ndarray, covariance: np.ndarray) -> float:
    """Standard deviation of a root mean square of n errors of known covariance, at most the errors' own. [m]"""
    count, square = len(error_m), float(np.mean(error_m**2))
    variance = (4.0 * error_m @ covariance @ error_m + 2.0 * np.trace(covariance @ covariance)) / count**2
    return float(min(np.sqrt(variance) / (2.0 * np.sqrt(max(square, 1e-30))), np.sqrt(np.trace(covariance) / count)))


def _held_out(
    measured: np.ndarray, first: np.ndarray, truth: np.ndarray, covariance: np.ndarray, used: np.ndarray
) -> float:
    """Root mean square of each panel's error after correction by constants from all other panels. [m]"""
    errors = []
    for k in range(len(measured)):
        rest = used & (np.arange(len(measured)) != k)
        k2, r2, _ = constants(measured[rest], first[rest], covariance[np.ix_(rest, rest)])
        errors.append(float(corrected_range(measured[k], k2, r2)) - truth[k])
    return float(np.sqrt(np.mean(np.square(errors))))


def _rows(panels: list[PanelRange]) -> list[dict[str, object]]:
    return [vars(p).copy() for p in panels]
