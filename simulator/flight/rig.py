"""The rig: nominal and true mounting of both sensors, and the sheets that their makers and the calibration laboratory state."""

import numpy as np

from campaign.config import Camera, Config, Faults, Lens, Lidar, Mounting, Vector3
from campaign.sensors import Calibration, CameraSheet, LidarSheet, MountingSheet, NavigationSheet, Rig
from campaign.truth import TrueMounting
from scenes.spectra import material
from simulator.flight.frames import FRD_FROM_RDF_NADIR, rotation_from_rpy
from simulator.flight.motion import SensorMounting
from simulator.flight.navigation import navigation_std
from simulator.lidar.response import response_constant_dn_m2
from simulator.randomness import Stream, generator

LENS_PARAMETERS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "k3", "p1", "p2")


def _rotation_deg(rpy_deg: Vector3) -> np.ndarray:
    return rotation_from_rpy(*np.radians(np.asarray(rpy_deg, float)))


def nominal_camera(config: Config) -> SensorMounting:
    """body_from_camera as drawn: looking down, top of the image ahead, turned by the nominal boresight."""
    mounting = config.platform.camera
    return SensorMounting(
        rotation=_rotation_deg(mounting.boresight_deg) @ FRD_FROM_RDF_NADIR, lever_arm_m=np.array(mounting.lever_arm_m)
    )


def nominal_lidar(config: Config) -> SensorMounting:
    """body_from_lidar as drawn: zero boresight is the identity."""
    mounting = config.platform.lidar
    return SensorMounting(rotation=_rotation_deg(mounting.boresight_deg), lever_arm_m=np.array(mounting.lever_arm_m))


def _faulty(nominal: SensorMounting, boresight_deg: Vector3, lever_arm_m: Vector3) -> SensorMounting:
    return SensorMounting(
        rotation=_rotation_deg(boresight_deg) @ nominal.rotation,
        lever_arm_m=nominal.lever_arm_m + np.array(lever_arm_m),
    )


def true_camera(config: Config) -> SensorMounting:
    return _faulty(nominal_camera(config), config.faults.camera_boresight_deg, config.faults.camera_lever_arm_m)


def true_lidar(config: Config) -> SensorMounting:
    return _faulty(nominal_lidar(config), config.faults.lidar_boresight_deg, config.faults.lidar_lever_arm_m)


def true_mountings(config: Config) -> tuple[TrueMounting, TrueMounting]:
    """Camera and LiDAR, in the form that truth/ keeps."""

    def record(mounting: SensorMounting, boresight: Vector3, lever: Vector3) -> TrueMounting:
        return TrueMounting(
            rotation=tuple(tuple(float(x) for x in row) for row in mounting.rotation),
            lever_arm_m=tuple(float(x) for x in mounting.lever_arm_m),
            boresight_deg=boresight,
            lever_arm_error_m=lever,
        )

    faults: Faults = config.faults
    return (
        record(true_camera(config), faults.camera_boresight_deg, faults.camera_lever_arm_m),
        record(true_lidar(config), faults.lidar_boresight_deg, faults.lidar_lever_arm_m),
    )


def certificate(config: Config) -> Calibration:
    """The laboratory's certificate: truth plus a draw from the covariance that it states."""
    camera = config.camera
    std = np.asarray(camera.calibration_std)
    true = np.array([getattr(camera.lens, name) for name in LENS_PARAMETERS])
    drawn = true + std * generator(config.seed, Stream.CALIBRATION).standard_normal(len(std))
    return Calibration(
        certificate=f"CAL-{config.campaign.id}",
        date=config.campaign.start_time[:10],
        lens=Lens(**dict(zip(LENS_PARAMETERS, map(float, drawn), strict=True))),
        covariance=tuple(tuple(float(v) for v in row) for row in np.diag(std**2)),
    )


def camera_sheet(config: Config) -> CameraSheet:
    c: Camera = config.camera
    return CameraSheet(
        name=c.name,
        manufacturer=c.manufacturer,
        width_px=c.width_px,
        height_px=c.height_px,
        pixel_size_um=c.pixel_size_um,
        nominal_focal_length_mm=c.nominal_focal_length_mm,
        f_number=c.f_number,
        bit_depth=c.bit_depth,
        black_level_dn=c.black_level_dn,
        bands=c.bands,
        shutter=c.shutter,
        readout_time_s=c.readout_time_s,
        calibration=certificate(config),
    )


def stated_response(config: Config) -> float:
    """Of the laboratory's sheet: the device without its faults on a PTFE standard, with the laboratory's error. [DN m2]"""
    lidar = config.lidar
    standard = 1.0 + material("ptfe").opposition_gain
    draw = generator(config.seed, Stream.RESPONSE).standard_normal()
    error = float(np.exp(lidar.response_constant_std * draw))
    return float(f"{response_constant_dn_m2(lidar) * standard * error:.6g}")


def lidar_sheet(config: Config) -> LidarSheet:
    c: Lidar = config.lidar
    return LidarSheet(
        name=c.name,
        manufacturer=c.manufacturer,
        wavelength_nm=c.wavelength_nm,
        prr_hz=c.prr_hz,
        scanner=c.scanner.type,
        scan_rate_hz=c.scanner.scan_rate_hz,
        sector_deg=c.scanner.sector_deg,
        divergence_rad=c.divergence_rad,
        pulse_fwhm_ns=c.pulse_fwhm_ns,
        echo_fwhm_ns=float(np.hypot(c.pulse_fwhm_ns, c.receiver_fwhm_ns)),
        sampling_ns=c.sampling_ns,
        bit_depth=c.bit_depth,
        baseline_dn=c.baseline_dn,
        precision_m=c.stated_precision_m,
        accuracy_m=c.stated_accuracy_m,
        encoder_std_deg=c.encoder_std_deg,
        min_range_m=c.min_range_m,
        max_returns=c.max_returns,
        response_constant_dn_m2=stated_response(config),
        response_constant_std=c.response_constant_std,
    )


def rig_sheet(config: Config) -> Rig:
    platform = config.platform
    position_std, attitude_std = navigation_std(config)

    def sheet(mounting: Mounting, axes: str) -> MountingSheet:
        return MountingSheet(
            lever_arm_m=mounting.lever_arm_m,
            boresight_deg=mounting.boresight_deg,
            axes=axes,
            boresight_std_deg=platform.mounting_boresight_std_deg,
            lever_arm_std_m=platform.mounting_lever_arm_std_m,
            clock_std_s=platform.mounting_clock_std_s,
        )

    return Rig(
        platform=platform.name,
        kind=platform.kind,
        camera=sheet(platform.camera, "rdf_nadir"),
        lidar=sheet(platform.lidar, "frd"),
        navigation=NavigationSheet(
            grade=config.navigation.grade,
            position_std_m=position_std,
            attitude_std_deg=attitude_std,
            position_correlation_s=config.navigation.position_correlation_s,
            attitude_correlation_s=config.navigation.attitude_correlation_s,
        ),
    )
