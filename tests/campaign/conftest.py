"""A campaign folder written by hand: one sortie, one strip, two images. Numbers are arbitrary but consistent."""

import dataclasses
import struct
import sys
from pathlib import Path
from types import ModuleType

import laspy
import numpy as np
import pytest

from campaign.config import Band, Lens
from campaign.flight.images import ImageTags, write_image, write_preview
from campaign.flight.las import LasSpec, Returns, StripReader, StripWriter
from campaign.flight.records import (
    EnvironmentRow,
    Exposure,
    FlightPlan,
    PlannedStrip,
    write_environment,
    write_exposures,
    write_plan,
)
from campaign.flight.trajectory import Trajectory, write_csv, write_sbet, write_smrmsg
from campaign.folder import CampaignFolder
from campaign.manifest import Manifest, write_manifest
from campaign.sensors import Calibration, CameraSheet, LidarSheet, MountingSheet, NavigationSheet, Rig, write_sheet
from campaign.survey import Spectra, SurveyedTarget, write_gcp_list, write_spectra, write_targets

T0 = 465_000_000.25  # adjusted standard GPS time: 2026-06-09 08:26:22.25 Beijing time
WEEK = int((T0 + 1e9) // 604_800)
WIDTH, HEIGHT = 96, 64
LENS = Lens(fx_px=100.0, fy_px=100.0, cx_px=48.0, cy_px=32.0, k1=-0.05)


@pytest.fixture(scope="session")
def hand() -> ModuleType:
    """This module: its functions make the parts of a campaign."""
    return sys.modules[__name__]


def read_strip(path: Path, size: int = 1_000_000, **options: object) -> Returns:
    parts = [r for _, r in StripReader(path, **options).chunks(size)]  # type: ignore[arg-type]
    return Returns(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(Returns)})


def strip_paths(tmp_path: Path) -> tuple[Path, Path]:
    return tmp_path / "strip_01.las", tmp_path / "strip_01_points.laz"


def wave_file(
    path: Path,
    packets: list[tuple[int, bytes]],
    descriptors: dict[int, tuple[int, int, int]],
    *,
    internal: bool,
    start: int = 60,
) -> list[int]:
    """PDRF 4 with the given (descriptor, bytes) packets from byte `start`; an empty descriptor 2 unless given. Gives offsets."""
    header = laspy.LasHeader(version="1.4", point_format=4)
    for number, (bits, samples, spacing) in ({2: (0, 0, 0)} | descriptors).items():
        header.vlrs.append(
            laspy.VLR("LASF_Spec", 99 + number, "", struct.pack("<BBIIdd", bits, 0, samples, spacing, 1.0, 0.0))
        )
    data = laspy.LasData(header)
    data.x = data.y = data.z = np.zeros(len(packets))
    data["wavepacket_index"] = [d for d, _ in packets]
    offsets, at = [], start
    for _, raw in packets:
        offsets.append(at)
        at += len(raw)
    data["wavepacket_offset"] = [o if d else 0 for o, (d, _) in zip(offsets, packets)]
    data["wavepacket_size"] = [len(raw) for _, raw in packets]
    data.write(path)
    block = (
        struct.pack("<H16sHQ32s", 0, b"LASF_Spec", 65535, at - 60, b"")
        + bytes(start - 60)
        + b"".join(r for _, r in packets)
    )
    raw = bytearray(path.read_bytes())
    if internal:
        struct.pack_into("<H", raw, 6, 2)
        struct.pack_into("<Q", raw, 227, len(raw))
        struct.pack_into("<QI", raw, 235, len(raw), 1)
        path.write_bytes(bytes(raw) + block)
    else:
        struct.pack_into("<H", raw, 6, 4)
        path.write_bytes(raw)
        path.with_suffix(".WDP").write_bytes(block)
    return offsets


def patched(path: Path, at: int, form: str, *values: float) -> None:
    raw = bytearray(path.read_bytes())
    struct.pack_into(form, raw, at, *values)
    path.write_bytes(raw)


def make_trajectory(n: int = 400, seed: int = 1) -> Trajectory:
    rng = np.random.default_rng(seed)
    return Trajectory(
        gps_time_s=T0 + np.arange(n) * 0.005,
        latitude_rad=np.radians(31.283) + 1e-7 * rng.standard_normal(n),
        longitude_rad=np.radians(121.213) + 1e-7 * rng.standard_normal(n),
        ellipsoid_height_m=63.0 + rng.standard_normal(n),
        roll_rad=0.01 * rng.standard_normal(n),
        pitch_rad=0.01 * rng.standard_normal(n),
        heading_rad=np.mod(0.1 * rng.standard_normal(n), 2 * np.pi),
        velocity_ned_m_s=rng.standard_normal((n, 3)),
        acceleration_body_m_s2=rng.standard_normal((n, 3)),
        angular_rate_body_rad_s=rng.standard_normal((n, 3)),
        position_std_m=0.01 + 0.001 * rng.random((n, 3)),
        attitude_std_rad=1e-4 + 1e-5 * rng.random((n, 3)),
    )


def make_spec(samples: int = 64) -> LasSpec:
    return LasSpec(
        projection_epsg=4549,
        height_epsg=5737,
        creation_date="2026-06-09",
        system_identifier="hand",
        offset_m=(520_000.0, 3_462_000.0, 0.0),
        sample_count=samples,
        sampling_ps=1000,
        bit_depth=16,
        file_source_id=1,
    )


def make_returns(n: int, packets: int, seed: int = 2, strip: int = 1) -> Returns:
    """Random returns whose coordinates lie on the grid of 0.1 mm; the last one has no packet."""
    rng = np.random.default_rng(seed)
    steps = rng.integers(-1_000_000, 1_000_000, (n, 3))
    packet = np.sort(rng.integers(0, packets, n)).astype(np.int64)
    packet[-1] = -1
    return Returns(
        xyz_m=steps * 0.0001 + np.array([520_000.0, 3_462_000.0, 0.0]),
        gps_time_s=T0 + 0.1 + np.sort(rng.random(n)),
        intensity=rng.integers(0, 65_536, n).astype(np.uint16),
        return_number=rng.integers(1, 6, n).astype(np.uint8),
        number_of_returns=rng.integers(1, 6, n).astype(np.uint8),
        scan_angle_deg=(rng.integers(-7500, 7500, n) * np.float32(0.006)).astype(np.float32),
        encoder_angle_deg=rng.uniform(-45.0, 45.0, n).astype(np.float32),
        channel=rng.integers(0, 32, n).astype(np.uint8),
        amplitude=rng.uniform(0.0, 4000.0, n).astype(np.float32),
        pulse_width_ns=rng.uniform(3.0, 9.0, n).astype(np.float32),
        reflectance_db=rng.uniform(-20.0, 0.0, n).astype(np.float32),
        strip=np.full(n, strip, np.uint16),
        packet=packet,
        return_location_ps=rng.uniform(0.0, 60_000.0, n).astype(np.float32),
        wave_direction_m_ps=(1.499e-4 * rng.standard_normal((n, 3))).astype(np.float32),
    )


def make_targets() -> list[SurveyedTarget]:
    common = {"easting_std_m": 0.003, "northing_std_m": 0.003, "height_std_m": 0.004, "azimuth_deg": 12.5}
    panel = SurveyedTarget(
        id="P01",
        kind="panel",
        easting_m=520_010.12345,
        northing_m=3_462_020.1,
        height_m=7.123,
        size_m=1.2,
        nominal_reflectance_percent=20.0,
        material="ptfe",
        **common,
    )
    frustum = SurveyedTarget(
        id="F01",
        kind="frustum",
        easting_m=520_011.0,
        northing_m=3_462_021.0,
        height_m=7.2,
        size_m=0.8,
        style="inverted",
        thickness_m=0.0015,
        vertex_faces="inner",
        vertex_offset_m=0.0,
        mark_radius_m=0.16,
        material="barium_sulfate",
        **common,
    )
    return [panel, frustum]


def make_tags() -> ImageTags:
    return ImageTags(
        camera_name="Hand 6",
        manufacturer="Maker",
        gps_time_s=T0 + 1.0,
        exposure_time_s=1 / 2000,
        f_number=5.6,
        focal_length_mm=13.5,
        pixel_size_um=4.5,
        black_level_dn=256.0,
        bit_depth=14,
        latitude_deg=31.283012345,
        longitude_deg=121.213098765,
        ellipsoid_height_m=63.1234,
        roll_deg=0.5,
        pitch_deg=-1.5,
        heading_deg=271.25,
        bands=("red", "green", "blue"),
    )


def make_plan() -> FlightPlan:
    strip = PlannedStrip(
        sortie=1,
        strip=1,
        heading_deg=0.0,
        height_m=45.0,
        speed_m_s=5.0,
        start_en_m=(0.0, 0.0),
        end_en_m=(1.0, 9.0),
        images=2,
    )
    return FlightPlan(
        aircraft="A",
        aircraft_kind="multirotor",
        takeoff_lat_lon_deg=(31.283, 121.213),
        area_lat_lon_deg=((31.28, 121.21), (31.29, 121.22)),
        area_m2=1e4,
        map_sheet="H51G001001",
        season="summer",
        start_time="2026-06-09T08:26:22+08:00",
        duration_s=60.0,
        deadline="2026-06-30",
        gsd_m=0.015,
        site_height_m=6.8,
        ground_slope_deg=1.0,
        obstacle_angle_deg=8.0,
        static_check_s=120.0,
        static_check_std_m=0.01,
        lock_lost=False,
        instruments={"total_station": "1 second"},
        strips=(strip,),
    )


def make_camera() -> CameraSheet:
    covariance = tuple(tuple(1e-4 if i == j else 0.0 for j in range(9)) for i in range(9))
    return CameraSheet(
        name="Hand 6",
        width_px=WIDTH,
        height_px=HEIGHT,
        pixel_size_um=4.5,
        nominal_focal_length_mm=0.45,
        f_number=5.6,
        bit_depth=14,
        black_level_dn=256.0,
        bands=tuple(
            Band(name=n, centre_nm=c, fwhm_nm=60.0) for n, c in (("red", 640.0), ("green", 550.0), ("blue", 460.0))
        ),
        calibration=Calibration(certificate="C-1", date="2026-06-01", lens=LENS, covariance=covariance),
    )


def make_lidar() -> LidarSheet:
    return LidarSheet(
        name="L",
        wavelength_nm=1550.0,
        prr_hz=3e5,
        scanner="line",
        scan_rate_hz=100.0,
        sector_deg=(-35.0, 35.0),
        divergence_rad=5e-4,
        pulse_fwhm_ns=4.0,
        echo_fwhm_ns=4.3,
        sampling_ns=1.0,
        bit_depth=12,
        baseline_dn=60.0,
        precision_m=0.005,
        accuracy_m=0.01,
        min_range_m=3.0,
        max_returns=5,
    )


def make_rig() -> Rig:
    mounting = {
        "lever_arm_m": (0.1, 0.0, 0.1),
        "boresight_deg": (0.0, 0.0, 0.0),
        "boresight_std_deg": 1.0,
        "lever_arm_std_m": 0.1,
    }
    return Rig(
        platform="multirotor",
        kind="multirotor",
        camera=MountingSheet(axes="rdf_nadir", **mounting),
        lidar=MountingSheet(axes="frd", **mounting),
        navigation=NavigationSheet(
            grade="apogee",
            position_std_m=(0.01, 0.01, 0.015),
            attitude_std_deg=(0.005, 0.005, 0.01),
            position_correlation_s=60.0,
            attitude_correlation_s=120.0,
        ),
    )


def make_manifest() -> Manifest:
    return Manifest(
        campaign="hand",
        synthetic=False,
        date="2026-06-09",
        start_time="2026-06-09T08:26:22+08:00",
        gps_week=WEEK,
        latitude_deg=31.283,
        longitude_deg=120.213,
        ellipsoid_height_m=18.0,
        height_anomaly_m=11.2,
        projection_epsg=4549,
        height_epsg=5737,
        software={"hand": "1"},
        files=(),
    )


def write_strip(
    las: Path, points: Path, n: int = 200, packets: int = 120, samples: int = 64
) -> tuple[Returns, np.ndarray]:
    returns = make_returns(n, packets)
    waves = np.random.default_rng(3).integers(0, 4096, (packets, samples)).astype(np.uint16)
    with StripWriter(las, points, make_spec(samples)) as writer:
        writer.write(returns, waves)
    return returns, waves


@pytest.fixture
def hand_campaign(tmp_path: Path) -> CampaignFolder:
    folder = CampaignFolder(tmp_path / "hand")
    sortie = folder.sortie(1)
    write_plan(folder.plan, make_plan())
    targets = make_targets()
    write_targets(folder.targets, targets, 4549, 5737)
    write_gcp_list(folder.gcp_list, targets, 4549)
    wavelength = np.arange(400.0, 1701.0, 50.0)
    write_spectra(
        folder.spectra, Spectra(wavelength_nm=wavelength, panel_ids=("P01",), reflectance=np.full((27, 1), 0.2))
    )
    for path, sheet in ((folder.camera, make_camera()), (folder.lidar, make_lidar()), (folder.rig, make_rig())):
        write_sheet(path, sheet)
    trajectory = make_trajectory()
    write_sbet(sortie.trajectory_sbet, trajectory, WEEK)
    write_smrmsg(sortie.trajectory_rms, trajectory, WEEK)
    write_csv(sortie.trajectory_csv, trajectory)
    rng = np.random.default_rng(5)
    exposures = []
    for i in range(2):
        name = f"DSC_{i:04d}"
        write_image(
            sortie.images / f"{name}.tif", rng.integers(256, 16383, (HEIGHT, WIDTH, 3)).astype(np.uint16), make_tags()
        )
        write_preview(
            sortie.images / f"{name}.jpg", rng.integers(0, 255, (HEIGHT, WIDTH, 3)).astype(np.uint8), make_tags()
        )
        exposures.append(
            Exposure(
                image=f"{name}.tif",
                gps_time_s=T0 + 0.5 + i,
                strip=1,
                exposure_time_s=5e-4,
                gain_e_per_dn=3.0,
                focus_distance_m=50.0,
            )
        )
    write_exposures(sortie.exposures, exposures)
    row = EnvironmentRow(
        gps_time_s=T0,
        illuminance_lx=8e4,
        wind_speed_m_s=3.0,
        wind_from_deg=None,
        temperature_c=24.0,
        pressure_hpa=1010.0,
        relative_humidity_percent=55.0,
        satellites=22,
    )
    write_environment(sortie.environment, [row])
    write_strip(sortie.strip_las(1), sortie.strip_points(1))
    write_manifest(folder.root, make_manifest())
    return folder
