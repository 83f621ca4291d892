"""What the page says of each target and image when it is chosen: label and text, finished in one language."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from campaign.flight.trajectory import beijing_time
from campaign.survey import SurveyedTarget
from evaluator.results import Evaluation
from evaluator.view.flight import CameraPose

Rows = list[tuple[str, str]]


def _number(value: object, decimals: int) -> str | None:
    """A finite number as text with a true minus sign; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        return None
    return f"{value:.{decimals}f}".replace("-", "−")


def _dig(value: Any, *keys: str) -> Any:
    """A nested value of results.json; None where it is not there."""
    for key in keys:
        if not isinstance(value, Mapping):
            return None
        value = value.get(key)
    return value


def board_residuals(results: Mapping[str, Any]) -> dict[str, tuple[float, int]]:
    """Board -> RMS length of its residuals that were used [px], images."""
    squares: dict[str, list[float]] = {}
    for row in _dig(results, "mounting", "boards", "residuals") or ():
        u, v = _dig(row, "du_px"), _dig(row, "dv_px")
        if isinstance(u, float) and isinstance(v, float) and _dig(row, "used"):
            squares.setdefault(str(row.get("target")), []).append(u * u + v * v)
    return {name: (float(np.sqrt(np.mean(s))), len(s)) for name, s in squares.items()}


def target_rows(
    target: SurveyedTarget, evaluation: Evaluation, results: Mapping[str, Any], words: Mapping[str, str]
) -> tuple[Rows, str]:
    """(label and text of everything known of a target, the short figure for the list)."""
    rows: Rows = [
        (words["easting"], f"{target.easting_m:.4f} m"),
        (words["northing"], f"{target.northing_m:.4f} m"),
        (words["normal_height"], f"{target.height_m:.4f} m".replace("-", "−")),
        (words["azimuth"], f"{target.azimuth_deg % 360.0:.2f}°"),
        (words["edge"], f"{target.size_m:g} m"),
    ]
    short = ""
    if target.kind == "frustum":
        rows.append((words["style"], words.get(target.style or "", target.style or "–")))
        p_i = _number(_dig(results, "indicators", "calibration_error", "companions", "per_target_px", target.id), 3)
        used = sum(r.target == target.id for r in evaluation.residuals)
        rows.append((words["p_i"], f"{p_i} px" if p_i else words["not_found"]))
        if used:
            rows.append((words["images_used"], str(used)))
        short = f"{p_i} px" if p_i else ""
    elif target.kind == "panel":
        short = f"{target.nominal_reflectance_percent:g} %" if target.nominal_reflectance_percent else ""
        rows.append((words["nominal"], short or "–"))
        panel = next((p for p in evaluation.panels if p.id == target.id), None)
        for label, value, reference in (
            ("lidar_reflectance", panel and panel.lidar_percent, panel and panel.laser_reference_percent),
            ("camera_reflectance", panel and panel.camera_percent, panel and panel.band_reference_percent),
        ):
            text, against = _number(value, 2), _number(reference, 2)
            beside = f" ({words['reference']} {against} %)" if against else ""
            rows.append((words[label], f"{text} %{beside}" if text else words["not_found"]))
    else:
        found = board_residuals(results).get(target.id)
        rows.append((words["board_residual"], f"{found[0]:.3f} px" if found else words["not_found"]))
        if found:
            rows.append((words["images_used"], str(found[1])))
            short = f"{found[0]:.2f} px"
    if target.id in evaluation.survey_doubts:
        rows.append((words["doubt"], target.id))
    return rows, short


def image_rows(pose: CameraPose, words: Mapping[str, str]) -> Rows:
    """Label and text of everything known of an image."""
    time = np.datetime_as_string(beijing_time(np.array([pose.gps_time_s])), unit="ms")[0].replace("T", " ")
    return [
        (words["sortie"], str(pose.sortie)),
        (words["strip"], str(pose.strip)),
        (words["time"], str(time)),
        (words["centre_height"], f"{pose.centre_m[2]:.3f} m".replace("-", "−")),
        (words["pose_by"], words["by_adjustment" if pose.adjusted else "by_drawing"]),
    ]
