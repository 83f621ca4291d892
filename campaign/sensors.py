"""sensors/camera.json, lidar.json, rig.json: what makers and the calibration laboratory state. Never the truth."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from campaign.config import Band, Lens, Model, NonNegative, Positive, Vector3
from campaign.errors import CampaignError
from campaign.formats.text import read_model, write_model


class Calibration(Model):
    """Certificate of the interior orientation. Parameter order everywhere: fx fy cx cy k1 k2 k3 p1 p2."""

    certificate: str
    date: str
    lens: Lens
    covariance: tuple[tuple[float, ...], ...] = Field(description="9 x 9, in the order above, squared units")


class CameraSheet(Model):
    name: str
    manufacturer: str = ""
    width_px: Annotated[int, Field(gt=0, le=20000)]
    height_px: Annotated[int, Field(gt=0, le=20000)]
    pixel_size_um: Positive
    nominal_focal_length_mm: Positive
    f_number: Positive
    bit_depth: Annotated[int, Field(ge=8, le=16)]
    black_level_dn: NonNegative
    bands: tuple[Band, ...]
    shutter: Literal["global", "rolling"] = "global"
    readout_time_s: NonNegative = 0.0
    calibration: Calibration | None = None


class LidarSheet(Model):
    name: str
    manufacturer: str = ""
    wavelength_nm: Positive
    prr_hz: Positive
    scanner: Literal["line", "channels"]
    scan_rate_hz: Positive
    sector_deg: tuple[float, float]
    divergence_rad: Positive
    divergence_definition: Literal["1/e2", "fwhm"] = "1/e2"
    pulse_fwhm_ns: Positive
    echo_fwhm_ns: Positive = Field(description="of the received pulse from a flat target (pulse and receiver)")
    sampling_ns: Positive
    bit_depth: Annotated[int, Field(ge=8, le=16)]
    baseline_dn: NonNegative
    precision_m: Positive
    accuracy_m: Positive
    encoder_std_deg: NonNegative = 0.001
    min_range_m: NonNegative
    max_returns: Annotated[int, Field(ge=1, le=15)]
    amplitude_unit: Literal["linear", "db"] = "linear"


class MountingSheet(Model):
    """Nominal mounting and how far the true one may be off (one standard deviation, an axis)."""

    lever_arm_m: Vector3
    boresight_deg: Vector3
    axes: Literal["frd", "rdf_nadir"] = Field(
        description="frd: zero boresight is the identity; rdf_nadir: x right = body y, y down = body -x, z forward = body z"
    )
    boresight_std_deg: Positive
    lever_arm_std_m: Positive


class NavigationSheet(Model):
    """Stochastic model of the post-processed trajectory's errors: first-order Gauss-Markov, exp(-|dt|/T)."""

    grade: str
    position_std_m: Vector3
    attitude_std_deg: Vector3
    position_correlation_s: Positive
    attitude_correlation_s: Positive


class Rig(Model):
    platform: str
    kind: Literal["multirotor", "fixed_wing"]
    camera: MountingSheet
    lidar: MountingSheet
    navigation: NavigationSheet


def write_sheet(path: Path, sheet: Model) -> None:
    """Any of the three sheets as JSON."""
    write_model(path, sheet)


def read_camera(path: Path) -> CameraSheet:
    """Raises CampaignError naming the key; a certificate's covariance must be 9 x 9, symmetric, without negative variances."""
    sheet = read_model(path, CameraSheet)
    if not 1 <= len(sheet.bands) <= 3:
        raise CampaignError("number of bands", where=f"{path} bands", got=len(sheet.bands), expected="1 to 3")
    if sheet.calibration is not None:
        covariance = sheet.calibration.covariance
        square = len(covariance) == 9 and all(len(row) == 9 for row in covariance)
        if not square or any(abs(covariance[i][j] - covariance[j][i]) > 1e-9 for i in range(9) for j in range(i)):
            raise CampaignError("not a covariance", where=f"{path} calibration.covariance", expected="9 x 9, symmetric")
        if any(covariance[i][i] < 0.0 for i in range(9)):
            raise CampaignError("a variance is negative", where=f"{path} calibration.covariance", expected="0 or above")
    return sheet


def read_lidar(path: Path) -> LidarSheet:
    """Raises CampaignError naming the key."""
    sheet = read_model(path, LidarSheet)
    if sheet.sector_deg[0] >= sheet.sector_deg[1]:
        raise CampaignError(
            "wrong order", where=f"{path} sector_deg", got=list(sheet.sector_deg), expected="least first"
        )
    return sheet


def read_rig(path: Path) -> Rig:
    """Raises CampaignError naming the key."""
    rig = read_model(path, Rig)
    if min(rig.navigation.position_std_m + rig.navigation.attitude_std_deg) < 0.0:
        raise CampaignError("a standard deviation is negative", where=f"{path} navigation", expected="0 or above")
    return rig
