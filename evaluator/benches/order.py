"""The benches and the ranging line of one campaign, in the order of the clauses, and which lens the flight is evaluated with.

A part that is missing or fails leaves its reason with its indicator and never stops another. Formulas live in c8_2, c9_1, c9_2.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from campaign.progress import Report
from campaign.sensors import Calibration as Certificate
from campaign.sensors import CameraSheet
from evaluator.benches.bench_model import ChessboardResult, RangingResult, SphereResult
from evaluator.benches.photon_transfer import PhotonTransfer, photon_transfer
from evaluator.c8_2_camera_radiometry import evaluate_sphere
from evaluator.c9_1_lidar_ranging import evaluate_ranging
from evaluator.c9_2_camera_geometry import evaluate_chessboard
from evaluator.model import CampaignData, RangeCorrection
from evaluator.results_model import IndicatorValue

_WORST_PX = 1.0  # M_z beyond table 3: no such calibration serves another indicator
_RANGE_SIGNIFICANT = 1e-3  # probability of K2 and R2 by chance, below which the flight's ranges are corrected
_FOCUS_PX = 0.1  # of principal distance: what a focus setting may differ in without being told apart


@dataclass(frozen=True, kw_only=True)
class Benches:
    """Results of 8.2, 9.1 and 9.2."""

    sphere: SphereResult
    chessboard: ChessboardResult
    ranging: RangingResult
    photon_transfer: PhotonTransfer | None

    @property
    def indicators(self) -> dict[str, IndicatorValue]:
        """The four indicators that need no flight."""
        return {
            "camera_stability": self.sphere.stability,
            "camera_repeatability": self.sphere.repeatability,
            "lidar_ranging_rmse_relative": self.ranging.indicator,
            "camera_reprojection_error": self.chessboard.indicator,
        }


def evaluate_benches(data: CampaignData, progress: Report) -> Benches:
    """Every bench of a campaign; what it lacks is "not measured" with the reason."""
    return Benches(
        sphere=evaluate_sphere(data, progress),
        chessboard=evaluate_chessboard(data, progress),
        ranging=evaluate_ranging(data, progress),
        photon_transfer=photon_transfer(data),
    )


def principal_distance_change_px(camera: CameraSheet, from_focus_m: float, to_focus_m: float) -> float:
    r"""How far the principal distance moves between two focus settings of a thin lens, in pixels.

    .. math:: c(s) = f + f^2 / (s - f)

    Parameters
    ----------
    camera : CameraSheet
        Nominal focal length f and pixel size.
    from_focus_m, to_focus_m : float
        Distances s that the lens is set to, from its pupil. [m]

    References
    ----------
    Luhmann et al., Close-Range Photogrammetry and 3D Imaging, 3rd ed., 3.1.3 (thin lens).
    """
    f = camera.nominal_focal_length_mm * 1e-3
    near = min(from_focus_m, to_focus_m)
    if near <= 1.01 * f:
        return float("inf")
    change = f * f * (1.0 / (to_focus_m - f) - 1.0 / (from_focus_m - f))
    return float(change / (camera.pixel_size_um * 1e-6))


def flight_ranges(data: CampaignData, ranging: RangingResult) -> CampaignData:
    """The campaign whose flight's ranges are corrected by (15), where K2 and R2 of 9.1 differ from zero together.

    A pair that may be zero is left out: it would add its own noise to every range.
    """
    if ranging.covariance is None or ranging.additive_constant_m is None or ranging.multiplication_constant is None:
        return data
    found = np.array([ranging.additive_constant_m, ranging.multiplication_constant])
    statistic = float(found @ np.linalg.solve(ranging.covariance, found))
    if chi2.sf(statistic, 2) > _RANGE_SIGNIFICANT:
        return data
    correction = RangeCorrection(
        additive_constant_m=float(found[0]), multiplication_constant=float(found[1]), covariance=ranging.covariance
    )
    return replace(data, range_correction=correction)


def flight_lens(data: CampaignData, chessboard: ChessboardResult) -> tuple[CampaignData, str]:
    """The campaign with the interior orientation that 9.3 uses, and a line that says which and why.

    The calibration of 9.2 serves where the campaign has one of this camera at the flight's focus setting; else the
    certificate in sensors/camera.json stays.
    """
    camera = data.camera
    if camera is None:
        return data, "no sensors/camera.json"
    stated = f"certificate {camera.calibration.certificate}" if camera.calibration else "none"
    if chessboard.lens is None or chessboard.covariance is None:
        return data, f"{stated}; 9.2 gave no calibration"
    why = _unfit(data, camera, chessboard)
    if why and camera.calibration is not None:
        return data, f"{stated}; the calibration of 9.2 does not serve: {why}"
    covariance = _cautious(chessboard)
    own = Certificate(
        certificate="9.2 of this campaign",
        date=data.manifest.date,
        lens=chessboard.lens,
        covariance=tuple(tuple(float(v) for v in row) for row in covariance),
    )
    line = "calibration of 9.2 of this campaign" + (f", for want of a certificate, although {why}" if why else "")
    if chessboard.focus_distance_m is None:
        line += "; its focus setting is not recorded"
    return replace(data, camera=camera.model_copy(update={"calibration": own})), line


def _cautious(chessboard: ChessboardResult) -> np.ndarray:
    """(9, 9) covariance with the larger of two standard deviations for each parameter: corners independent, or images only.

    A board that is not quite plane shifts all corners of an image together; then only images can be taken as independent.
    """
    covariance = np.asarray(chessboard.covariance)
    std = np.sqrt(np.diag(covariance))
    by_image = np.asarray(chessboard.indicator.companions.get("std_by_image", std), dtype=np.float64)
    factor = np.maximum(by_image / std, 1.0)
    widened = covariance * np.outer(factor, factor)
    return np.asarray(0.5 * (widened + widened.T))


def _unfit(data: CampaignData, camera: CameraSheet, chessboard: ChessboardResult) -> str | None:
    """Why the calibration of 9.2 cannot stand for the camera in flight."""
    if chessboard.image_size_px != (camera.width_px, camera.height_px):
        return f"images of {chessboard.image_size_px} px, the camera's have {camera.width_px} x {camera.height_px}"
    if len(chessboard.focus_settings_m) > 1:
        return "the focus was changed during the series"
    value = chessboard.indicator.value
    if value is None or not value <= _WORST_PX:
        return f"M_z is {value} px"
    if chessboard.focus_distance_m is None or chessboard.covariance is None:
        return None
    settings = {e.focus_distance_m for sortie in data.sorties for e in sortie.exposures}
    moved = [abs(principal_distance_change_px(camera, chessboard.focus_distance_m, s)) for s in settings]
    bound = _FOCUS_PX + 3.0 * float(np.sqrt(chessboard.covariance[0, 0]))
    if moved and max(moved) > bound:
        return f"another focus setting moves the principal distance by {max(moved):.2f} px"
    return None
