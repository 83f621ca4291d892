"""A campaign and an evaluation written by hand: round figures that a reader can check, no file of a simulator involved."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from campaign.config import Band, Lens
from campaign.flight.records import EnvironmentRow, Exposure, FlightPlan, PlannedStrip
from campaign.flight.trajectory import Trajectory
from campaign.folder import CampaignFolder
from campaign.manifest import Manifest
from campaign.sensors import Calibration, CameraSheet, LidarSheet, MountingSheet, NavigationSheet, Rig
from campaign.survey import Spectra, SurveyedTarget
from campaign.threads import one_blas_thread
from evaluator.conformity import ConformityInputs, conformity_rows
from evaluator.frames import WorldFrame, euler_rotation
from evaluator.model import (
    CampaignData,
    MarkObservation,
    Mounting,
    MountingSolution,
    SortieData,
    VertexObservation,
)
from evaluator.results import Evaluation, PanelValue, Region, Residual, WaveformExample
from evaluator.results_model import IndicatorValue

LEVELS = (5.0, 20.0, 40.0, 60.0, 100.0)
WIDTH, HEIGHT, FOCAL_PX = 3072, 2048, 3000.0
# 2026-06-12 10:30 in Beijing = 02:30 UTC; GPS - UTC = 18 s; adjusted standard GPS time = GPS seconds - 1e9.
START_S = 1465266600 + 18 - 1_000_000_000


def _manifest() -> Manifest:
    return Manifest(
        campaign="hand-made",
        title="Written by hand",
        synthetic=True,
        date="2026-06-12",
        start_time="2026-06-12T10:30:00+08:00",
        gps_week=2422,
        latitude_deg=31.283,
        longitude_deg=121.213,
        ellipsoid_height_m=18.0,
        height_anomaly_m=11.2,
        projection_epsg=4549,
        height_epsg=5737,
        software={"testrange": "0.1.0"},
        files=(),
    )


def _targets(frame: WorldFrame) -> tuple[SurveyedTarget, ...]:
    """24 frustums on a 6 x 4 grid of 36 m x 22 m, 20 panels between them."""
    grid = [(x, y) for y in np.linspace(-11, 11, 4) for x in np.linspace(-18, 18, 6)]
    between = [(x, y) for y in np.linspace(-9, 9, 4) for x in np.linspace(-14, 14, 5)]
    places = np.array(
        [(x, y, 0.15 + 0.45 * (k % 3)) for k, (x, y) in enumerate(grid)] + [(x, y, 0.2) for x, y in between]
    )
    e, n, h = frame.map_from_world(places).T
    common = {"easting_std_m": 0.003, "northing_std_m": 0.003, "height_std_m": 0.004, "azimuth_deg": 0.0}
    frustums = tuple(
        SurveyedTarget(
            id=f"F{k + 1:02d}",
            kind="frustum",
            easting_m=e[k],
            northing_m=n[k],
            height_m=h[k],
            size_m=0.8,
            style="inverted",
            thickness_m=0.0015,
            vertex_faces="inner",
            vertex_offset_m=0.0,
            mark_radius_m=0.16,
            material="barium_sulfate",
            **common,
        )
        for k in range(24)
    )
    panels = tuple(
        SurveyedTarget(
            id=f"P{k + 1:02d}",
            kind="panel",
            easting_m=e[24 + k],
            northing_m=n[24 + k],
            height_m=h[24 + k],
            size_m=1.2,
            nominal_reflectance_percent=LEVELS[k % 5],
            material="ptfe",
            **common,
        )
        for k in range(20)
    )
    return frustums + panels


def _spectra() -> Spectra:
    wavelength = np.arange(400.0, 1701.0, 10.0)
    levels = np.array([LEVELS[k % 5] for k in range(20)]) / 100.0
    # 4 % of slope over 1300 nm: 0.2 % over a band of 70 nm
    slope = 1.0 + 0.04 * (wavelength - 1050.0) / 1300.0
    return Spectra(
        wavelength_nm=wavelength,
        panel_ids=tuple(f"P{k + 1:02d}" for k in range(20)),
        reflectance=slope[:, None] * levels[None, :] * 0.98,
    )


def _camera() -> CameraSheet:
    lens = Lens(fx_px=FOCAL_PX, fy_px=FOCAL_PX, cx_px=WIDTH / 2, cy_px=HEIGHT / 2)
    covariance = tuple(tuple(0.0225 if i == j and i < 4 else 0.0 for j in range(9)) for i in range(9))
    return CameraSheet(
        name="hand camera",
        width_px=WIDTH,
        height_px=HEIGHT,
        pixel_size_um=4.5,
        nominal_focal_length_mm=13.5,
        f_number=5.6,
        bit_depth=14,
        black_level_dn=256.0,
        bands=(
            Band(name="blue", centre_nm=470.0, fwhm_nm=70.0),
            Band(name="green", centre_nm=550.0, fwhm_nm=70.0),
            Band(name="red", centre_nm=650.0, fwhm_nm=70.0),
        ),
        calibration=Calibration(certificate="CAL-1", date="2026-06-01", lens=lens, covariance=covariance),
    )


def _lidar() -> LidarSheet:
    return LidarSheet(
        name="hand scanner",
        wavelength_nm=1550.0,
        prr_hz=300_000.0,
        scanner="line",
        scan_rate_hz=100.0,
        sector_deg=(-35.0, 35.0),
        divergence_rad=0.0005,
        pulse_fwhm_ns=4.0,
        echo_fwhm_ns=4.27,
        sampling_ns=1.0,
        bit_depth=12,
        baseline_dn=60.0,
        precision_m=0.005,
        accuracy_m=0.010,
        min_range_m=3.0,
        max_returns=5,
    )


def _rig() -> Rig:
    common = {"boresight_std_deg": 1.0, "lever_arm_std_m": 0.1, "boresight_deg": (0.0, 0.0, 0.0)}
    return Rig(
        platform="hand copter",
        kind="multirotor",
        camera=MountingSheet(lever_arm_m=(0.10, 0.03, 0.08), axes="rdf_nadir", **common),
        lidar=MountingSheet(lever_arm_m=(-0.05, -0.02, 0.12), axes="frd", **common),
        navigation=NavigationSheet(
            grade="apogee",
            position_std_m=(0.01, 0.01, 0.015),
            attitude_std_deg=(0.005, 0.005, 0.01),
            position_correlation_s=60.0,
            attitude_correlation_s=120.0,
        ),
    )


def trajectory_along(frame: WorldFrame, start_s: float, height_m: float, speed_m_s: float = 5.0) -> Trajectory:
    """Four passes of 10 s at constant height and speed, headings 0, 180, 90, 270, back to back, 50 Hz. [adjusted GPS s]"""
    t = np.arange(0.0, 40.0, 0.02)
    leg = np.minimum((t // 10.0).astype(int), 3)
    heading = np.radians(np.array([0.0, 180.0, 90.0, 270.0])[leg])
    along = (t % 10.0 - 5.0) * speed_m_s
    world = np.stack([np.sin(heading) * along, np.cos(heading) * along, np.full_like(t, height_m)], axis=1)
    lat, lon, height = frame.geodetic_from_world(world)
    zero = np.zeros((t.size, 3))
    return Trajectory(
        gps_time_s=start_s + t,
        latitude_rad=lat,
        longitude_rad=lon,
        ellipsoid_height_m=height,
        roll_rad=np.zeros_like(t),
        pitch_rad=np.zeros_like(t),
        heading_rad=heading,
        velocity_ned_m_s=np.stack([np.cos(heading), np.sin(heading), 0 * t], axis=1) * speed_m_s,
        acceleration_body_m_s2=zero,
        angular_rate_body_rad_s=zero,
        position_std_m=zero + 0.01,
        attitude_std_rad=zero + 1e-4,
    )


def _plan() -> FlightPlan:
    strips = tuple(
        PlannedStrip(
            sortie=s,
            strip=k + 1,
            heading_deg=h,
            height_m=height,
            speed_m_s=5.0,
            start_en_m=(0.0, 0.0),
            end_en_m=(1.0, 1.0),
            images=2,
        )
        for s, height in ((1, 45.0), (2, 65.0))
        for k, h in enumerate((0.0, 180.0, 90.0, 270.0))
    )
    return FlightPlan(
        aircraft="hand copter",
        aircraft_kind="multirotor",
        takeoff_lat_lon_deg=(31.283, 121.213),
        area_lat_lon_deg=((31.282, 121.212), (31.284, 121.212), (31.284, 121.214), (31.282, 121.214)),
        area_m2=42_000.0,
        map_sheet="H51G001001",
        season="summer",
        start_time="2026-06-12T10:30:00+08:00",
        duration_s=900.0,
        deadline="2026-06-30",
        requirements="clear sky",
        gsd_m=0.015,
        site_height_m=6.8,
        ground_slope_deg=1.0,
        obstacle_angle_deg=8.0,
        static_check_s=300.0,
        static_check_std_m=0.006,
        lock_lost=False,
        instruments={"reference_panel": "flatness 2 %"},
        strips=strips,
    )


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """As the evaluator runs: many small matrices are slower by many threads."""
    with one_blas_thread():
        yield


@pytest.fixture
def campaign_data(tmp_path: Path) -> CampaignData:
    """Two sorties of four strips at 45 and 65 m over 24 frustums and 20 panels; nothing of it violates the standard."""
    manifest = _manifest()
    frame = WorldFrame(manifest)
    folder = CampaignFolder(tmp_path / "campaign")
    sorties = []
    for number, height in ((1, 45.0), (2, 65.0)):
        start = START_S + 600.0 * (number - 1)
        exposures = tuple(
            Exposure(
                image=f"s{number:02d}_{2 * leg + k:03d}.tif",
                gps_time_s=start + 10.0 * leg + 4.5 + k,
                strip=leg + 1,
                exposure_time_s=0.0005,
                gain_e_per_dn=3.0,
                focus_distance_m=1000.0,
            )
            for leg in range(4)
            for k in range(2)
        )
        environment = tuple(
            EnvironmentRow(
                gps_time_s=start + 10.0 * k,
                illuminance_lx=90_000.0,
                wind_speed_m_s=3.0,
                wind_from_deg=120.0,
                temperature_c=24.0,
                pressure_hpa=1010.0,
                relative_humidity_percent=55.0,
                satellites=22,
            )
            for k in range(5)
        )
        sorties.append(
            SortieData(
                folder=folder.sortie(number),
                trajectory=trajectory_along(frame, start, height),
                exposures=exposures,
                environment=environment,
                strips=(1, 2, 3, 4),
            )
        )
    return CampaignData(
        folder=folder,
        manifest=manifest,
        plan=_plan(),
        targets=_targets(frame),
        spectra=_spectra(),
        camera=_camera(),
        lidar=_lidar(),
        rig=_rig(),
        sorties=tuple(sorties),
    )


@pytest.fixture
def conformity_inputs(campaign_data: CampaignData) -> ConformityInputs:
    """Facts of a good flight."""
    panels = {t.id: 400 + k for k, t in enumerate(t for t in campaign_data.targets if t.kind == "panel")}
    level = {t.id: t.nominal_reflectance_percent or 0.0 for t in campaign_data.targets if t.kind == "panel"}
    windows = {
        (s.folder.number, k + 1): (
            float(s.trajectory.gps_time_s[0]) + 10.0 * k + 0.5,
            float(s.trajectory.gps_time_s[0]) + 10.0 * k + 9.5,
        )
        for s in campaign_data.sorties
        if s.trajectory is not None
        for k in range(4)
    }
    return ConformityInputs(
        panel_points=panels,
        panel_points_by_sortie={
            1: {p: n // 2 for p, n in panels.items()},
            2: {p: n - n // 2 for p, n in panels.items()},
        },
        panel_brightness={p: 0.25 + 0.7 * v / 100.0 for p, v in level.items()},
        panel_brightness_linear={p: 0.8 * v / 100.0 for p, v in level.items()},
        panel_clipped_share=dict.fromkeys(panels, 0.0),
        targets_in_image={(s.folder.number, e.image): 44 for s in campaign_data.sorties for e in s.exposures},
        scan_interval_s=dict.fromkeys(windows, 7.2),
        strip_window_s=windows,
        frustum_vertices=24,
        frustum_marks=24,
        frustums_used=24,
        panels_picked_by="evaluator",
        frustums_picked_by="evaluator",
        indicators_measured=4,
    )


NAMES = tuple(
    f"{sensor}_{kind}"
    for sensor in ("camera", "lidar")
    for kind in ("boresight_roll", "boresight_pitch", "boresight_yaw", "lever_arm_x", "lever_arm_y", "lever_arm_z")
)
CAMERA_DEG, LIDAR_DEG = np.array([0.25, -0.30, 0.40]), np.array([-0.20, 0.35, -0.30])
CAMERA_M, LIDAR_M = np.array([0.03, -0.02, 0.04]), np.array([-0.04, 0.03, 0.02])
FRD_FROM_RDF = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture
def mounting_solution() -> MountingSolution:
    """The true mounting of a hand-made rig, with 0.003 degrees and 6 mm of stated uncertainty."""
    std = np.tile(np.r_[np.radians([0.003, 0.003, 0.004]), 0.006, 0.006, 0.010], 2)
    correlation = np.eye(12)
    correlation[0, 4] = correlation[4, 0] = 0.5
    correlation[5, 11] = correlation[11, 5] = 0.97
    camera = Mounting(
        rotation=euler_rotation(*np.radians(CAMERA_DEG)) @ FRD_FROM_RDF,
        lever_arm_m=np.array([0.10, 0.03, 0.08]) + CAMERA_M,
    )
    lidar = Mounting(
        rotation=euler_rotation(*np.radians(LIDAR_DEG)), lever_arm_m=np.array([-0.05, -0.02, 0.12]) + LIDAR_M
    )
    rotation = camera.rotation.T @ lidar.rotation
    translation = camera.rotation.T @ (lidar.lever_arm_m - camera.lever_arm_m)
    six = np.r_[np.radians([0.004, 0.004, 0.005]), 0.008, 0.008, 0.012]
    return MountingSolution(
        names=NAMES,
        parameters=np.r_[np.radians(CAMERA_DEG), CAMERA_M, np.radians(LIDAR_DEG), LIDAR_M],
        covariance=correlation * np.outer(std, std),
        body_from_camera=camera,
        body_from_lidar=lidar,
        camera_from_lidar_rotation=rotation,
        camera_from_lidar_translation_m=translation,
        camera_from_lidar=np.r_[np.radians([0.1, 0.2, 0.3]), translation],
        camera_from_lidar_covariance=np.diag(six**2),
        vertices_world_m={},
        iterations=5,
        sigma0=1.02,
        redundancy=500,
        rejected=("F03 in s01_001.tif: 5.2 sigma",),
        companions={"single_instant_p_m_px": 1.4},
    )


def _pixel(world_m: np.ndarray, height_m: float) -> np.ndarray:
    """Nadir pinhole heading north over the site's origin."""
    return np.array([WIDTH / 2, HEIGHT / 2]) + FOCAL_PX * np.array([world_m[0], -world_m[1]]) / (height_m - world_m[2])


@pytest.fixture
def evaluation(
    campaign_data: CampaignData, conformity_inputs: ConformityInputs, mounting_solution: MountingSolution
) -> Evaluation:
    """Four outdoor indicators measured; one image a sortie with marks, regions and residuals; a waveform of each level."""
    rng = np.random.default_rng(7)
    frame = WorldFrame(campaign_data.manifest)
    marks, residuals, regions, vertices = [], [], [], []
    for sortie, height in ((1, 45.0), (2, 65.0)):
        image = f"s{sortie:02d}_000.tif"
        for t in campaign_data.targets:
            world = frame.world_from_map(np.array([t.easting_m, t.northing_m, t.height_m]))
            uv = _pixel(world, height)
            half = t.size_m / 2.0 * FOCAL_PX / height
            square = uv + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
            regions.append(Region(target=t.id, sortie=sortie, image=image, corners_px=square))
            if t.kind != "frustum":
                continue
            error = rng.normal(0.0, 0.25, 2)
            residuals.append(
                Residual(
                    target=t.id,
                    sortie=sortie,
                    image=image,
                    observed_px=uv,
                    projected_px=uv + error,
                    error_px=float(np.hypot(*error)),
                )
            )
            marks.append(
                MarkObservation(
                    target=t.id,
                    sortie=sortie,
                    strip=1,
                    image=image,
                    gps_time_s=START_S + 4.5,
                    uv_px=uv,
                    covariance_px2=np.eye(2) * 0.0025,
                    radius_px=9.0,
                )
            )
            vertices.append(
                VertexObservation(
                    target=t.id,
                    sortie=sortie,
                    strip=1,
                    gps_time_s=START_S + 4.0,
                    time_spread_s=0.2,
                    point_lidar_m=np.array([world[1], world[0], height - world[2]]),
                    covariance_m2=np.eye(3) * 9e-6,
                    faces=4,
                    points=180,
                    rms_m=0.004,
                )
            )
    panels = tuple(
        PanelValue(
            id=t.id,
            nominal_percent=t.nominal_reflectance_percent or 0.0,
            lidar_percent=0.98 * (t.nominal_reflectance_percent or 0.0) + rng.normal(0, 0.8),
            camera_percent=0.98 * (t.nominal_reflectance_percent or 0.0) + rng.normal(0, 0.5),
            laser_reference_percent=0.98 * (t.nominal_reflectance_percent or 0.0),
            band_reference_percent=0.98 * (t.nominal_reflectance_percent or 0.0),
        )
        for t in campaign_data.targets
        if t.kind == "panel"
    )
    time, fine = np.arange(64.0), np.linspace(0.0, 63.0, 400)

    def pulse(t: np.ndarray, level: float) -> np.ndarray:
        return 60.0 + 25.0 * level * np.exp(-4.0 * np.log(2.0) * ((t - 25.3) / 4.27) ** 2)

    waveforms = tuple(
        WaveformExample(
            label=f"P{k + 1:02d}, {level:g} %",
            nominal_percent=level,
            time_ns=time,
            samples_dn=np.round(pulse(time, level) + rng.normal(0, 2.0, 64)),
            fit_time_ns=fine,
            fit_dn=pulse(fine, level),
        )
        for k, level in enumerate(LEVELS)
    )
    indicators = {
        "lidar_reflectance_rmse": IndicatorValue(
            value=1.234567890123,
            unit="% reflectance",
            formula="(2)",
            clause="8.1",
            sample_size=20,
            std=0.2,
            low_95=0.9,
            high_95=1.7,
            method="chi-square of 20 panels",
            companions={"leave_one_panel_out": 1.61, "with_incidence": {"in_sample": 1.18, "r_f": np.float64(99.1)}},
        ),
        "reflectance_correlation": IndicatorValue(value=99.83, unit="%", formula="(7)", clause="8.3", sample_size=20),
        "reflectance_rmse_relative": IndicatorValue(
            value=3.2,
            unit="% reflectance",
            formula="(8)",
            clause="8.3",
            sample_size=20,
            companions={"nan": float("nan")},
        ),
        "calibration_error": IndicatorValue(
            value=0.5, unit="pixel", formula="(20)-(24)", clause="9.3", sample_size=24, companions={"held_out_px": 0.52}
        ),
    }
    return Evaluation(
        campaign="hand-made",
        synthetic=True,
        indicators=indicators,
        conformity=tuple(conformity_rows(campaign_data, conformity_inputs)),
        mounting=mounting_solution,
        mounting_prior_std=np.tile(np.r_[np.radians([1.0, 1.0, 1.0]), 0.1, 0.1, 0.015], 2),
        problems=(f"{campaign_data.folder.root}/bench: not there",),
        data=campaign_data,
        marks=tuple(marks),
        vertices=tuple(vertices),
        residuals=tuple(residuals),
        panels=panels,
        regions=tuple(regions),
        waveforms=waveforms,
        strip_window_s=conformity_inputs.strip_window_s,
    )


@pytest.fixture
def previews(campaign_data: CampaignData, evaluation: Evaluation) -> CampaignData:
    """The same campaign with a preview picture on disk for every image that the evaluation names."""
    for sortie in campaign_data.sorties:
        images = sortie.folder.images
        images.mkdir(parents=True)
        picture = np.full((HEIGHT, WIDTH, 3), (70, 110, 90), np.uint8)
        for region in (r for r in evaluation.regions if r.sortie == sortie.folder.number):
            cv2.fillPoly(picture, [np.round(region.corners_px).astype(np.int32)], (200, 200, 200))
        for mark in (m for m in evaluation.marks if m.sortie == sortie.folder.number):
            centre = tuple(int(v) for v in mark.uv_px)
            cv2.circle(picture, centre, 9, (10, 10, 10), -1)
        cv2.imwrite(str(images / f"s{sortie.folder.number:02d}_000.jpg"), picture)
    return campaign_data


@pytest.fixture
def bare_data(campaign_data: CampaignData) -> CampaignData:
    """A folder with nothing but its manifest."""
    return replace(campaign_data, plan=None, targets=(), spectra=None, camera=None, lidar=None, rig=None, sorties=())
