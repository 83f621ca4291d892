"""Estimates against the truth of a simulated campaign: score.json. The only module of the evaluator that opens truth/."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from campaign.folder import CampaignFolder
from campaign.manifest import read_manifest
from campaign.sensors import Rig, read_rig
from campaign.truth import TrueMounting, Truth, read_truth
from evaluator.frames import euler_angles
from evaluator.georeference import nominal_mountings
from evaluator.model import EvaluationError
from evaluator.results import CAMERA_FROM_LIDAR, plain, read_results, write_json

_AXES = ("roll", "pitch", "yaw"), ("x", "y", "z")


@dataclass(frozen=True, kw_only=True)
class ScoreItem:
    """One quantity: error = estimate - truth, z = error / std (None without a standard deviation)."""

    quantity: str
    unit: str
    truth: float
    estimate: float
    error: float
    std: float
    z: float | None


@dataclass(frozen=True, kw_only=True)
class Score:
    """All quantities of one campaign."""

    campaign: str
    items: tuple[ScoreItem, ...]

    @property
    def max_abs_z(self) -> float | None:
        """Greatest |z|, None when no item has one."""
        found = [abs(i.z) for i in self.items if i.z is not None]
        return max(found) if found else None


def true_values(truth: Truth, rig: Rig) -> dict[str, float]:
    """Truth of every quantity of score.json, computed with the evaluator's own frames.

    Parameters
    ----------
    truth : Truth
        body_from_camera and body_from_lidar as simulated.
    rig : Rig
        Nominal mountings: camera_from_lidar's angles are those of nominal^-1 * true.

    Returns
    -------
    dict
        Quantity -> value in degrees or metres.
    """
    values: dict[str, float] = {}
    for sensor, mounting in (("camera", truth.camera), ("lidar", truth.lidar)):
        for axis, angle in zip(_AXES[0], mounting.boresight_deg):
            values[f"{sensor}_boresight_{axis}"] = float(angle)
        for axis, error in zip(_AXES[1], mounting.lever_arm_error_m):
            values[f"{sensor}_lever_arm_{axis}"] = float(error)
    rotation, translation = camera_from_lidar(truth.camera, truth.lidar)
    nominal_camera, nominal_lidar = nominal_mountings(rig)
    nominal = nominal_camera.rotation.T @ nominal_lidar.rotation
    angles = np.degrees(euler_angles(nominal.T @ rotation))
    return values | dict(zip(CAMERA_FROM_LIDAR, map(float, [*angles, *translation])))


def camera_from_lidar(camera: TrueMounting, lidar: TrueMounting) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) [m] of camera_from_lidar = body_from_camera^-1 * body_from_lidar."""
    inverse = np.array(camera.rotation).T
    lever = np.array(lidar.lever_arm_m) - np.array(camera.lever_arm_m)
    return inverse @ np.array(lidar.rotation), inverse @ lever


def _estimates(block: dict[str, Any], where: str) -> dict[str, tuple[str, float, float]]:
    """Quantity -> unit, estimate, standard deviation from one block of results.json."""
    try:
        found = {
            str(name): (str(unit), float(value), float(std))
            for name, unit, value, std in zip(
                block["names"], block["units"], block["estimates"], block["std"], strict=True
            )
        }
        if not all(math.isfinite(value) and math.isfinite(std) and std >= 0.0 for _, value, std in found.values()):
            raise ValueError
        return found
    except (KeyError, TypeError, ValueError, OverflowError):
        raise EvaluationError(
            "names, units, estimates and std do not go together",
            where=where,
            expected="lists of the same length, of finite numbers, std not below 0",
        ) from None


def score_items(results: dict[str, Any], truth: dict[str, float], where: str) -> tuple[ScoreItem, ...]:
    """Every estimated quantity whose truth is known."""
    mounting = results["mounting"]
    if mounting.get("status") != "measured":
        return ()
    relative = mounting.get("camera_from_lidar")
    found = _estimates(mounting, f"{where}: mounting")
    if isinstance(relative, dict):
        found |= _estimates(relative, f"{where}: mounting.camera_from_lidar")
    items = []
    for name, (unit, estimate, std) in found.items():
        if name in truth:
            error = estimate - truth[name]
            items.append(
                ScoreItem(
                    quantity=name,
                    unit=unit,
                    truth=truth[name],
                    estimate=estimate,
                    error=error,
                    std=std,
                    z=error / std if std > 0.0 else None,
                )
            )
    return tuple(items)


def score_campaign(root: Path, results_path: Path) -> Score:
    """Scores one results.json against truth/ of the campaign it came from.

    Raises
    ------
    EvaluationError
        The campaign has no truth/, or the results are another campaign's.
    """
    folder = CampaignFolder(root)
    manifest = read_manifest(root)
    if not folder.truth.is_dir():
        raise EvaluationError(
            "the campaign has no truth/", where=str(root), remedy="only a simulated campaign can be scored"
        )
    results = read_results(results_path)
    if results["campaign"] != manifest.campaign:
        raise EvaluationError(
            "results of another campaign", where=str(results_path), got=results["campaign"], expected=manifest.campaign
        )
    truth = true_values(read_truth(root), read_rig(folder.rig))
    return Score(campaign=manifest.campaign, items=score_items(results, truth, str(results_path)))


def build_score(score: Score) -> dict[str, Any]:
    """The contents of score.json."""
    out: dict[str, Any] = plain(
        {
            "schema": 1,
            "campaign": score.campaign,
            "max_abs_z": score.max_abs_z,
            "items": [
                {
                    "quantity": i.quantity,
                    "unit": i.unit,
                    "truth": i.truth,
                    "estimate": i.estimate,
                    "error": i.error,
                    "std": i.std,
                    "z": i.z,
                }
                for i in score.items
            ],
        }
    )
    return out


def write_score(path: Path, score: Score) -> None:
    """Writes score.json."""
    write_json(path, build_score(score))
