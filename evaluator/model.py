"""What passes between the rooms of the evaluator: the campaign as read, observations, the mounting solution."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from campaign.benches.bench import BoardExposure, BoardSheet, RoomSheet, SphereExposure
from campaign.benches.ranging import RangingLine, StationReading
from campaign.errors import TestrangeError
from campaign.flight.records import EnvironmentRow, Exposure, FlightPlan
from campaign.flight.trajectory import Trajectory
from campaign.folder import CampaignFolder, SortieFolder
from campaign.manifest import Manifest
from campaign.sensors import CameraSheet, LidarSheet, Rig
from campaign.survey import Spectra, SurveyedTarget


class EvaluationError(TestrangeError):
    """An indicator cannot be computed; the reason is its text."""


@dataclass(frozen=True, kw_only=True)
class SortieData:
    folder: SortieFolder
    trajectory: Trajectory | None
    exposures: tuple[Exposure, ...]
    environment: tuple[EnvironmentRow, ...]
    strips: tuple[int, ...]  # numbers of the LiDAR strips on disk
    # (strip, target) -> record numbers, rising, that a person gave to the target (observations_lidar.csv)
    picked_points: Mapping[tuple[int, str], np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class BenchData:
    """Records of the indoor benches; images are read when they are needed. Absent: None or empty."""

    room: RoomSheet | None = None
    stability: tuple[SphereExposure, ...] = ()
    repeatability: tuple[SphereExposure, ...] = ()
    board: BoardSheet | None = None
    board_log: tuple[BoardExposure, ...] = ()


@dataclass(frozen=True, kw_only=True)
class RangingData:
    """Records of the ranging line; the scans' points are read when they are needed."""

    line: RangingLine | None = None
    readings: tuple[StationReading, ...] = ()
    scans: tuple[tuple[int, Path], ...] = ()  # number, file


@dataclass(frozen=True, kw_only=True)
class RangeCorrection:
    """K2 and R2 of 9.1 where they differ from zero: the flight's ranges are corrected by (15)."""

    additive_constant_m: float
    multiplication_constant: float
    covariance: np.ndarray  # (2, 2)


@dataclass(frozen=True, kw_only=True)
class CampaignData:
    """What a folder holds; a part that is absent is None or empty."""

    folder: CampaignFolder
    manifest: Manifest
    plan: FlightPlan | None
    targets: tuple[SurveyedTarget, ...]
    spectra: Spectra | None
    camera: CameraSheet | None
    lidar: LidarSheet | None
    rig: Rig | None
    sorties: tuple[SortieData, ...]
    bench: BenchData = BenchData()
    ranging: RangingData = RangingData()
    range_correction: RangeCorrection | None = None  # found by the evaluation, not read
    problems: tuple[str, ...] = ()  # parts that could not be read, one line each


@dataclass(frozen=True, kw_only=True)
class Mounting:
    """body_from_sensor: rotation (3, 3), lever arm (3,) [m]."""

    rotation: np.ndarray
    lever_arm_m: np.ndarray


@dataclass(frozen=True, kw_only=True)
class MarkObservation:
    """The centre of one frustum target's mark in one image."""

    target: str
    sortie: int
    strip: int
    image: str
    gps_time_s: float  # of the row of the image in which the mark lies
    uv_px: np.ndarray  # (2,) as observed (distorted); the first pixel's centre is (0.5, 0.5)
    covariance_px2: np.ndarray  # (2, 2)
    radius_px: float  # of the region that was fitted
    picked_by: str = "evaluator"  # or the campaign's observations file


@dataclass(frozen=True, kw_only=True)
class VertexObservation:
    """The common vertex of one frustum target's faces from one strip, in the LiDAR frame at `gps_time_s`."""

    target: str
    sortie: int
    strip: int
    gps_time_s: float  # mean time of the points used
    time_spread_s: float
    point_lidar_m: np.ndarray  # (3,)
    covariance_m2: np.ndarray  # (3, 3)
    faces: int  # planes used
    points: int  # returns used
    rms_m: float  # of the residuals along the ray
    # (points,) which of the rows given to `find_vertex` were used
    index: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64), repr=False, compare=False)


@dataclass(frozen=True, kw_only=True)
class PlaneObservation:
    """The upper face of one reflectance panel from one strip: the mean of its points, of which only the place along the panel's
    normal is used, in the LiDAR frame at `gps_time_s`."""

    panel: str
    sortie: int
    strip: int
    gps_time_s: float  # mean time of the points
    point_lidar_m: np.ndarray  # (3,)
    std_m: float  # of the mean along the normal, without navigation and survey
    points: int
    rms_m: float  # of the points about their own plane


@dataclass(frozen=True, kw_only=True)
class MountingSolution:
    """Result of the joint adjustment (21)-(23). Parameters: camera roll pitch yaw [rad], lever arm x y z [m], LiDAR the same,
    then the clocks [s] that have a prior.

    body_from_sensor = dR(roll, pitch, yaw) * nominal rotation, lever arm = nominal + d. A clock is stamped minus true time.
    """

    names: tuple[str, ...]  # 12: camera_boresight_roll ... lidar_lever_arm_z; then camera_clock, lidar_clock
    parameters: np.ndarray  # (12 + clocks,) rad, m and s, against nominal
    covariance: np.ndarray  # (12 + clocks, 12 + clocks)
    body_from_camera: Mounting
    body_from_lidar: Mounting
    camera_from_lidar_rotation: np.ndarray  # (3, 3)
    camera_from_lidar_translation_m: np.ndarray  # (3,)
    camera_from_lidar: np.ndarray  # (6,) roll pitch yaw [rad] of nominal^-1 * estimated, x y z [m] of the translation
    camera_from_lidar_covariance: np.ndarray  # (6, 6)
    vertices_world_m: dict[str, np.ndarray]  # adjusted
    iterations: int
    sigma0: float  # a posteriori standard deviation of unit weight
    redundancy: int
    rejected: tuple[str, ...] = ()  # observations left out as blunders, one line each
    companions: dict[str, object] = field(default_factory=dict)  # e.g. the single-instant solution
    prior_std: np.ndarray | None = None  # in the order of names; rad, m and s
    camera_clock_s: float = 0.0  # estimated, else 0
    lidar_clock_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class SensorSolution:
    """One sensor's mounting from its own observations alone, against the body: as in MountingSolution."""

    sensor: str  # camera or lidar
    names: tuple[str, ...]  # 6, and the clock where it has a prior
    parameters: np.ndarray  # rad, m and s, against nominal
    covariance: np.ndarray
    prior_std: np.ndarray
    body_from_sensor: Mounting
    sigma0: float
    redundancy: int
    rejected: tuple[str, ...] = ()
    companions: dict[str, object] = field(default_factory=dict)
