"""Estimates against the truth of a simulated campaign: score.json. The only module of the evaluator that opens truth/.

Estimates come from results.json alone. Beside the block `mounting` these companions of the indicators are read:

camera_reprojection_error    `parameters` or `names` (fx_px fy_px cx_px cy_px k1 k2 k3 p1 p2), `estimates`, `std`: three lists of
                             one length; `image_size_px` (width, height) and, where given, `coverage_counts` (corners in each
                             cell: positions, rows, columns) bound the map of the distortion's error
lidar_ranging_rmse_relative  `additive_constant_m`, `additive_constant_std_m`, `multiplication_constant`,
                             `multiplication_constant_std`
camera_stability             `trend_percent_per_h`, `trend_std_percent_per_h`

and of the block `diagnosis` the rows of the gains, which stand nowhere else.

Whatever is absent, in the results or in truth/, has no item.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from campaign.config import Lens
from campaign.folder import CampaignFolder
from campaign.manifest import read_manifest
from campaign.sensors import Rig, read_rig
from campaign.truth import TrueMounting, Truth, read_truth
from evaluator.camera_model import LENS_NAMES, lens_from_vector, lens_vector, project, project_with_jacobian, undistort
from evaluator.frames import euler_angles
from evaluator.georeference import nominal_mountings
from evaluator.model import EvaluationError
from evaluator.results import CAMERA_FROM_LIDAR, plain, read_results, write_json

_AXES = ("roll", "pitch", "yaw"), ("x", "y", "z")
_LENS_QUANTITIES = tuple(f"camera_{name}" for name in LENS_NAMES)
_GAINS = ("camera_gain", "lidar_gain")
_MAP_STEPS = 48  # points of the distortion's map along the image's longer side


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


def decimals(std: float | None) -> int:
    """Decimals with which a figure is shown: two digits of its standard deviation, 2 to 8; 4 where there is none."""
    if std is None or not math.isfinite(std) or std <= 0.0:
        return 4
    return min(max(1 - math.floor(math.log10(std)), 2), 8)


def true_values(truth: Truth, rig: Rig | None) -> dict[str, float]:
    """Truth of every quantity of score.json, computed with the evaluator's own frames.

    Parameters
    ----------
    truth : Truth
        body_from_camera and body_from_lidar as simulated, the benches' lens and lamp, the ranging line's constants.
    rig : Rig or None
        Nominal mountings: camera_from_lidar's angles are those of nominal^-1 * true. Without it no mounting is scored.

    Returns
    -------
    dict
        Quantity -> value in the unit of its estimate.
    """
    values = {"camera_gain": truth.camera_gain, "lidar_gain": truth.lidar_gain}
    if truth.bench is not None and truth.bench.lens is not None:
        values |= dict(zip(_LENS_QUANTITIES, lens_vector(truth.bench.lens).tolist()))
    if truth.bench is not None and truth.bench.drift_percent_per_h is not None:
        values["lamp_drift"] = truth.bench.drift_percent_per_h + 0.0
    if truth.ranging is not None:
        values["ranging_additive_constant"] = truth.ranging.additive_constant_m + 0.0  # no minus zero
        values["ranging_multiplication_constant"] = truth.ranging.multiplication_constant + 0.0
    if rig is None:
        return values
    for sensor, mounting in (("camera", truth.camera), ("lidar", truth.lidar)):
        for axis, angle in zip(_AXES[0], mounting.boresight_deg):
            values[f"{sensor}_boresight_{axis}"] = float(angle)
        for axis, error in zip(_AXES[1], mounting.lever_arm_error_m):
            values[f"{sensor}_lever_arm_{axis}"] = float(error)
    values |= {"camera_clock": truth.camera_clock_s, "lidar_clock": truth.lidar_clock_s}
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


def _companions(results: dict[str, Any], indicator: str) -> dict[str, Any]:
    """Companions of one indicator; empty where results.json holds none."""
    block = results["indicators"].get(indicator)
    found = block.get("companions") if isinstance(block, dict) else None
    return found if isinstance(found, dict) else {}


def _bench_estimates(results: dict[str, Any], where: str) -> dict[str, tuple[str, float, float]]:
    """Quantity -> unit, estimate, standard deviation of benches and ranging line, from the indicators' companions."""
    found: dict[str, tuple[str, float, float]] = {}
    camera = _companions(results, "camera_reprojection_error")
    names = camera.get("names", camera.get("parameters"))
    if names is not None and camera.get("estimates") is not None:
        units = ["px" if str(n).endswith("_px") else "1" for n in names] if isinstance(names, list) else None
        block = camera | {"names": names, "units": units}
        lens = _estimates(block, f"{where}: camera_reprojection_error")
        found |= {f"camera_{name}": lens[name] for name in LENS_NAMES if name in lens}
    single = (
        (
            "lidar_ranging_rmse_relative",
            "ranging_additive_constant",
            "m",
            "additive_constant_m",
            "additive_constant_std_m",
        ),
        (
            "lidar_ranging_rmse_relative",
            "ranging_multiplication_constant",
            "1",
            "multiplication_constant",
            "multiplication_constant_std",
        ),
        ("camera_stability", "lamp_drift", "%/h", "trend_percent_per_h", "trend_std_percent_per_h"),
    )
    for indicator, quantity, unit, estimate, std in single:
        companions = _companions(results, indicator)
        if companions.get(estimate) is not None:
            block = {
                "names": [quantity],
                "units": [unit],
                "estimates": [companions[estimate]],
                "std": [companions.get(std) or 0.0],
            }
            found |= _estimates(block, f"{where}: {indicator}")
    return found


def _gain_estimates(results: dict[str, Any], where: str) -> dict[str, tuple[str, float, float]]:
    """Quantity -> unit, estimate, standard deviation of the gains, over what was stated of them."""
    block = results.get("diagnosis")
    rows = block.get("rows") if isinstance(block, dict) else None
    gains = [r for r in rows if isinstance(r, dict) and r.get("quantity") in _GAINS] if isinstance(rows, list) else []
    columns = {
        "names": [r["quantity"] for r in gains],
        "units": ["1"] * len(gains),
        "estimates": [r.get("estimate") for r in gains],
        "std": [r.get("std") for r in gains],
    }
    return _estimates(columns, f"{where}: diagnosis")


def distortion_error(
    estimated: Lens, true: Lens, size_px: tuple[int, int], coverage: np.ndarray | None = None
) -> tuple[float, float]:
    """How far apart two lenses put the same ray, over the image: root mean square of the distance.

    Each point of a grid over the image becomes a ray by the estimated lens; the true lens says where that ray is seen.

    Parameters
    ----------
    estimated, true : Lens
    size_px : (int, int)
        Width and height of the image. [px]
    coverage : (rows, columns) np.ndarray, optional
        Corners seen in each cell of the image; cells without one are left out. None: the whole image.

    Returns
    -------
    plain_px, turned_px : float
        As the lenses stand, and after the rotation of the estimated rays that makes them agree best: an error that a mounting
        takes up (a principal point's against a boresight's). [px]
    """
    width, height = size_px
    step = max(width, height) / _MAP_STEPS
    columns, rows = max(2, round(width / step)), max(2, round(height / step))
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    share = np.stack([u.ravel(), v.ravel()], axis=1)
    if coverage is not None:
        cell = (share * np.array(coverage.shape)[::-1]).astype(int)
        share = share[coverage[cell[:, 1], cell[:, 0]] > 0]
    uv = share * (width, height)
    rays = np.column_stack([undistort(estimated, uv), np.ones(len(uv))])
    known = np.isfinite(rays).all(axis=1) & np.isfinite(project(true, rays)).all(axis=1)
    uv, rays = uv[known], rays[known]
    if not len(uv):
        return math.nan, math.nan
    plain = _rms(project(true, rays) - uv)
    turned = rays
    for _ in range(5):
        seen, d_point, _lens = project_with_jacobian(true, turned)
        x, y, z = turned.T
        zero = np.zeros_like(x)
        cross = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)  # d (w x p) / d w
        turn = np.linalg.lstsq((d_point @ cross).reshape(-1, 3), (uv - seen).ravel(), rcond=None)[0]
        turned = turned + np.cross(turn, turned)
    return plain, _rms(project(true, turned) - uv)


def _rms(difference_px: np.ndarray) -> float:
    """Root mean square of the norms of (n, 2)."""
    return float(np.sqrt((difference_px**2).sum(axis=1).mean()))


def _map_items(results: dict[str, Any], truth: Truth, where: str) -> list[ScoreItem]:
    """The distortion's error as one figure over the covered field, with and without a common rotation; no z."""
    if truth.bench is None or truth.bench.lens is None:
        return []
    companions = _companions(results, "camera_reprojection_error")
    lens = _bench_estimates(results, where)
    try:
        estimated = lens_from_vector(np.array([lens[name][1] for name in _LENS_QUANTITIES]))
        width, height = (int(n) for n in companions["image_size_px"])
        coverage = companions.get("coverage_counts")
        cells = None if coverage is None else np.array(coverage, dtype=float).sum(axis=0)
        if (
            not 0 < width <= 65_000
            or not 0 < height <= 65_000
            or (cells is not None and (cells.ndim != 2 or not cells.size))
        ):
            return []
    except (KeyError, TypeError, ValueError, OverflowError):
        return []  # results of which no map can be drawn; the parameters are scored all the same
    try:
        with np.errstate(all="ignore"):
            plain, turned = distortion_error(estimated, truth.bench.lens, (width, height), cells)
    except np.linalg.LinAlgError:  # an estimate whose distortion folds back inside the field
        return []
    return [
        ScoreItem(quantity=name, unit="px", truth=0.0, estimate=value, error=value, std=0.0, z=None)
        for name, value in (("distortion_map_rms_px", plain), ("distortion_map_rms_turned_px", turned))
        if math.isfinite(value)
    ]


def _board_estimates(block: Any, where: str) -> dict[str, tuple[str, float, float]]:
    """Quantity -> unit, estimate, standard deviation by 2x2 boards; what the flight does not determine has no estimate."""
    if not isinstance(block, dict) or block.get("status") != "measured":
        return {}
    try:
        rows = zip(block["names"], block["units"], block["estimates"], block["std"], strict=True)
        known = [row for row in rows if row[2] is not None]
    except (KeyError, TypeError, ValueError):
        raise EvaluationError("the block of the boards is torn", where=f"{where}: mounting.boards") from None
    columns = dict(zip(("names", "units", "estimates", "std"), (list(c) for c in zip(*known)))) if known else {}
    return _estimates(columns, f"{where}: mounting.boards") if columns else {}


def score_items(results: dict[str, Any], truth: dict[str, float], where: str) -> tuple[ScoreItem, ...]:
    """Every estimated quantity whose truth is known."""
    mounting = results["mounting"]
    found: dict[str, tuple[str, float, float]] = {}
    if mounting.get("status") == "measured":
        relative = mounting.get("camera_from_lidar")
        found = _estimates(mounting, f"{where}: mounting")
        if isinstance(relative, dict):
            found |= _estimates(relative, f"{where}: mounting.camera_from_lidar")
    by_boards = _board_estimates(mounting.get("boards"), where)
    if not found:  # boards alone: the flight's only word on the camera's mounting
        found |= by_boards
    found |= {f"boards_{name}": value for name, value in by_boards.items()}
    truth = truth | {f"boards_{name}": truth[name] for name in by_boards if name in truth}
    found |= _bench_estimates(results, where) | _gain_estimates(results, where)
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
    truth = read_truth(root)
    rig = read_rig(folder.rig) if folder.rig.exists() else None
    where = str(results_path)
    items = score_items(results, true_values(truth, rig), where)
    return Score(campaign=manifest.campaign, items=(*items, *_map_items(results, truth, where)))


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
