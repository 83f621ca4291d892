"""sensors/camera.json, lidar.json, rig.json: what makers and the calibration laboratory state. Never the truth."""

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from campaign.config import Band, Lens, Model, NonNegative
from campaign.errors import CampaignError
from campaign.formats.text import read_model, write_model

# Beyond these a value can only be in a wrong unit.
Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Arm = Annotated[float, Field(ge=-100.0, le=100.0)]
Spread = Annotated[float, Field(ge=0.0, le=100.0)]


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
    pixel_size_um: Annotated[float, Field(ge=0.1, le=1000.0)]
    nominal_focal_length_mm: Annotated[float, Field(ge=0.1, le=10_000.0)]
    f_number: Annotated[float, Field(ge=0.1, le=1000.0)]
    bit_depth: Annotated[int, Field(ge=8, le=16)]
    black_level_dn: NonNegative
    bands: tuple[Band, ...]
    shutter: Literal["global", "rolling"] = "global"
    readout_time_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    calibration: Calibration | None = None


class LidarSheet(Model):
    name: str
    manufacturer: str = ""
    wavelength_nm: Annotated[float, Field(ge=200.0, le=20_000.0)]
    prr_hz: Annotated[float, Field(ge=1.0, le=1e9)]
    scanner: Literal["line", "channels"]
    scan_rate_hz: Annotated[float, Field(ge=1e-3, le=1e6)]
    sector_deg: tuple[Degrees, Degrees]
    divergence_rad: Annotated[float, Field(ge=1e-7, le=1.0)]
    divergence_definition: Literal["1/e2", "fwhm"] = "1/e2"
    pulse_fwhm_ns: Annotated[float, Field(ge=0.01, le=1000.0)]
    echo_fwhm_ns: Annotated[float, Field(ge=0.01, le=1000.0)] = Field(
        description="of the received pulse from a flat target (pulse and receiver)"
    )
    sampling_ns: Annotated[float, Field(ge=1e-3, le=1000.0)]
    bit_depth: Annotated[int, Field(ge=8, le=16)]
    baseline_dn: NonNegative
    precision_m: Annotated[float, Field(ge=1e-6, le=10.0)]
    accuracy_m: Annotated[float, Field(ge=1e-6, le=10.0)]
    encoder_std_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.001
    min_range_m: Annotated[float, Field(ge=0.0, le=10_000.0)]
    max_returns: Annotated[int, Field(ge=1, le=15)]
    amplitude_unit: Literal["linear", "db"] = "linear"
    response_constant_dn_m2: Annotated[float, Field(gt=0.0, le=1e18)] | None = Field(
        None,
        description="of the laboratory: waveform's peak above the baseline times range squared over reflectance and cosine of"
        " incidence, on a diffuse white standard; null: not stated",
    )
    response_constant_std: Annotated[float, Field(ge=0.0, le=1.0)] = Field(0.03, description="relative")


class MountingSheet(Model):
    """Nominal mounting and how far the true one may be off (one standard deviation, an axis)."""

    lever_arm_m: tuple[Arm, Arm, Arm]
    boresight_deg: tuple[Degrees, Degrees, Degrees]
    axes: Literal["frd", "rdf_nadir"] = Field(
        description="frd: zero boresight is the identity; rdf_nadir: x right = body y, y down = body -x, z forward = body z"
    )
    boresight_std_deg: Annotated[float, Field(ge=1e-6, le=45.0)]
    lever_arm_std_m: Annotated[float, Field(ge=1e-6, le=10.0)]
    clock_std_s: Annotated[float, Field(ge=0.0, le=10.0)] = Field(
        0.0, description="of the sensor's time stamps against navigation; 0: synchronised, not estimated"
    )


class NavigationSheet(Model):
    """Stochastic model of the post-processed trajectory's errors: first-order Gauss-Markov, exp(-|dt|/T)."""

    grade: str
    position_std_m: tuple[Spread, Spread, Spread]
    attitude_std_deg: tuple[Spread, Spread, Spread]
    position_correlation_s: Annotated[float, Field(ge=1e-3, le=1e7)]
    attitude_correlation_s: Annotated[float, Field(ge=1e-3, le=1e7)]


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
    if sheet.black_level_dn >= 2**sheet.bit_depth - 1:
        raise CampaignError(
            "no signal is left", where=f"{path} black_level_dn", got=sheet.black_level_dn, expected="below 2^bit_depth"
        )
    if sheet.calibration is not None:
        _check_lens(path, sheet, sheet.calibration.lens)
        covariance = sheet.calibration.covariance
        square = len(covariance) == 9 and all(len(row) == 9 for row in covariance)
        if not square or any(abs(covariance[i][j] - covariance[j][i]) > 1e-9 for i in range(9) for j in range(i)):
            raise CampaignError("not a covariance", where=f"{path} calibration.covariance", expected="9 x 9, symmetric")
        if any(covariance[i][i] < 0.0 for i in range(9)):
            raise CampaignError("a variance is negative", where=f"{path} calibration.covariance", expected="0 or above")
        if any(covariance[i][i] > (100.0 if i >= 4 else sheet.width_px**2) for i in range(9)):
            raise CampaignError(
                "a variance is not plausible",
                where=f"{path} calibration.covariance",
                expected="px squared, in the lens' order",
            )
        if any(
            abs(covariance[i][j]) > 1.0001 * math.sqrt(covariance[i][i] * covariance[j][j])
            for i in range(9)
            for j in range(i)
        ):
            raise CampaignError(
                "a correlation exceeds 1", where=f"{path} calibration.covariance", expected="a covariance"
            )
    return sheet


def _check_lens(path: Path, sheet: CameraSheet, lens: Lens) -> None:
    """A lens in other units than pixels and normalised coordinates is refused."""
    stated = sheet.nominal_focal_length_mm * 1000.0 / sheet.pixel_size_um
    where = f"{path} calibration.lens"
    if not (0.5 < lens.fx_px / stated < 2.0 and 0.5 < lens.fy_px / stated < 2.0):
        raise CampaignError(
            "the focal length is not plausible",
            where=where,
            got=f"{lens.fx_px:g}, {lens.fy_px:g} px",
            expected=f"about {stated:.0f} px by focal length and pixel size",
        )
    if not (lens.cx_px < sheet.width_px and lens.cy_px < sheet.height_px):
        raise CampaignError(
            "the principal point lies outside the image", where=where, expected="pixels from its corner"
        )
    if max(abs(k) for k in (lens.k1, lens.k2, lens.k3, lens.p1, lens.p2)) > 10.0:
        raise CampaignError("a distortion is above 10", where=where, expected="on normalised image coordinates")


def read_lidar(path: Path) -> LidarSheet:
    """Raises CampaignError naming the key."""
    sheet = read_model(path, LidarSheet)
    if sheet.baseline_dn >= 2**sheet.bit_depth - 1:
        raise CampaignError(
            "no signal is left", where=f"{path} baseline_dn", got=sheet.baseline_dn, expected="below 2^bit_depth"
        )
    if sheet.sector_deg[0] >= sheet.sector_deg[1]:
        raise CampaignError(
            "wrong order", where=f"{path} sector_deg", got=list(sheet.sector_deg), expected="least first"
        )
    return sheet


def read_rig(path: Path) -> Rig:
    """Raises CampaignError naming the key."""
    return read_model(path, Rig)
