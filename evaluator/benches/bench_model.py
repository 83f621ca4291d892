"""What the benches' modules (8.2, 9.1, 9.2) hand to conformity, report and results. Plain data, no formula."""

from dataclasses import dataclass, field

import numpy as np

from campaign.config import Lens
from evaluator.results_model import IndicatorValue


@dataclass(frozen=True, kw_only=True)
class SphereSeries:
    """One series at the integrating sphere, in the order of time."""

    images: tuple[str, ...]  # used
    time_s: np.ndarray  # (n,) since the first image
    dn: np.ndarray  # (n, bands) mean of the 9 central pixels, black level subtracted
    bands: tuple[str, ...]
    since_lamp_on_s: float | None  # of the first image
    left_out: tuple[str, ...] = ()  # images that could not serve, one line each with the reason
    saturated_share: float = 0.0  # greatest share of saturated pixels in an image's central region


@dataclass(frozen=True, kw_only=True)
class SphereResult:
    """Both indicators of 8.2; a series is None where the campaign has none that can be read."""

    stability: IndicatorValue
    repeatability: IndicatorValue
    stability_series: SphereSeries | None = None
    repeatability_series: SphereSeries | None = None


@dataclass(frozen=True, kw_only=True)
class BoardImage:
    """One accepted image of the chessboard after the adjustment."""

    image: str
    corner: np.ndarray  # (n, 2) int: column, row of each inner corner
    observed_px: np.ndarray  # (n, 2) as detected (distorted), image axes of 3.13
    projected_px: np.ndarray  # (n, 2) by (16) with distortion: comparable to observed_px
    error_px: np.ndarray  # (n,) norm of (19), on undistorted observations
    camera_from_board_rotation: np.ndarray  # (3, 3)
    camera_from_board_translation_m: np.ndarray  # (3,)
    position: int  # which of the distances of 9.2.2 d, from 0 (nearest)


@dataclass(frozen=True, kw_only=True)
class ChessboardResult:
    """M_z and the calibration behind it. `lens` is None where there is none."""

    indicator: IndicatorValue
    lens: Lens | None = None
    covariance: np.ndarray | None = None  # (9, 9) fx fy cx cy k1 k2 k3 p1 p2
    image_size_px: tuple[int, int] | None = None  # width, height
    focus_distance_m: float | None = None  # setting of the lens, where every image states the same one
    focus_settings_m: tuple[float, ...] = ()  # every setting that an accepted image states, nearest first
    f_number: float | None = None
    images: tuple[BoardImage, ...] = ()
    not_used: dict[str, str] = field(default_factory=dict)  # image -> why
    distances_m: tuple[float, ...] = ()  # mean distance of each position, nearest first
    coverage: np.ndarray | None = None  # (positions, rows, columns) corners in each cell of the field


@dataclass(frozen=True, kw_only=True)
class PanelRange:
    """One panel of the ranging line."""

    panel: str
    lidar_m: float  # mean of the scans, uncorrected
    lidar_std_m: float  # of one scan
    scans: int
    correction_m: float | None  # total station's distance from the LiDAR's centre for K2 and R2 (9.1.2 c-e)
    reference_m: float | None  # relative true value (9.1.2 k)
    corrected_m: float | None = None  # by (15)
    correction_readings: int = 0
    reference_readings: int = 0
    points: int = 0  # LiDAR returns behind lidar_m


@dataclass(frozen=True, kw_only=True)
class RangingResult:
    """m_z and the constants of (13)."""

    indicator: IndicatorValue
    panels: tuple[PanelRange, ...] = ()
    additive_constant_m: float | None = None  # K2
    multiplication_constant: float | None = None  # R2
    covariance: np.ndarray | None = None  # (2, 2) of K2 [m] and R2
    not_used: dict[str, str] = field(default_factory=dict)  # panel -> why
