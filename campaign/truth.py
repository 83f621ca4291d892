"""truth/: what only a simulated campaign knows. Written by the simulator; in the evaluator only `score` opens it.

truth/truth.json      Truth below, and truth/'s own files with SHA-256
truth/campaign.toml   the configuration as run
truth/trajectory.npz  no pickle: the true Trajectory fields of every sortie, prefixed sNN_
truth/marks.csv       target, image, u_px, v_px, visible: true pixel of every mark's centre in every image
truth/returns_SS_LL.npz   per return of sortie SS strip LL: range_m, normal, target index, face
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import Field

from campaign.config import Lens, Model, Vector3
from campaign.manifest import ManifestFile


class TrueMounting(Model):
    """body_from_sensor: rotation (row major, 3 x 3) and lever arm."""

    rotation: tuple[Vector3, Vector3, Vector3]
    lever_arm_m: Vector3
    boresight_deg: Vector3 = Field(description="roll pitch yaw of dR in: body_from_sensor = dR * nominal rotation")
    lever_arm_error_m: Vector3 = Field(description="true minus nominal lever arm, body axes")


class TrueTarget(Model):
    id: str
    kind: str
    mark_world_m: Vector3 = Field(description="panel: centre of the top face; frustum: centre of the mark")
    vertex_world_m: Vector3 | None = None
    band_reflectance: tuple[float, ...] | None = Field(None, description="panels: over each camera band")
    laser_reflectance: float | None = None


class Truth(Model):
    seed: int
    camera: TrueMounting
    lidar: TrueMounting
    lens: Lens
    camera_clock_s: float
    lidar_clock_s: float
    range_offset_m: float
    range_scale: float
    lidar_gain: float
    camera_gain: float
    targets: tuple[TrueTarget, ...]
    files: tuple[ManifestFile, ...] = ()


@dataclass(frozen=True, kw_only=True)
class TrueReturns:
    """Per return of one strip, in the order of its LAS rows."""

    range_m: np.ndarray  # (n,) float64 geometric range to the first surface of the beam's axis
    normal_world: np.ndarray  # (n, 3) float32
    target: np.ndarray  # (n,) int32 index into Truth.targets, -1 ground
    face: np.ndarray  # (n,) int8: frustum face 0-3 inner, 4-7 outer, 8 plate, 9 mark, -1 other


def write_truth(root: Path, truth: Truth) -> None:
    """Writes truth.json last, with the checksums of everything else under truth/."""
    raise NotImplementedError


def read_truth(root: Path) -> Truth:
    raise NotImplementedError


def write_true_returns(path: Path, returns: TrueReturns) -> None:
    raise NotImplementedError


def read_true_returns(path: Path) -> TrueReturns:
    raise NotImplementedError
