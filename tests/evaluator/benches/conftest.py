"""The benches and the ranging line written by hand: results, records and facts of good ones, beside the flight's fixtures."""

from dataclasses import replace

import numpy as np
import pytest

from campaign.benches.bench import BoardExposure, BoardSheet, RoomSheet, SphereExposure
from campaign.benches.ranging import RangingLine, RangingPanel, StationReading, TotalStation
from campaign.config import Lens
from evaluator.benches.bench_model import (
    BoardImage,
    ChessboardResult,
    PanelRange,
    RangingResult,
    SphereResult,
    SphereSeries,
)
from evaluator.camera_model import LENS_NAMES, lens_from_vector, lens_vector
from evaluator.conformity import ConformityInputs
from evaluator.frames import euler_rotation
from evaluator.model import (
    BenchData,
    CampaignData,
    RangingData,
)
from evaluator.results_model import IndicatorValue

# 2026-06-12 10:30 in Beijing, the flight of the fixtures beside; adjusted standard GPS time.
START_S = 1465266600 + 18 - 1_000_000_000
WIDTH, HEIGHT = 3072, 2048
BENCH_S = START_S - 86_400.0  # the benches stand the day before the flight
TRUE_LENS = Lens(fx_px=3000.2, fy_px=2999.9, cx_px=1540.1, cy_px=1020.4, k1=-0.0469, k2=0.0236, p1=2e-4, p2=-1e-4)


def sphere_series(interval_s: float, drift_percent_per_h: float) -> SphereSeries:
    """21 images of three bands; white noise of 0.02 % and a linear drift."""
    time = interval_s * np.arange(21)
    noise = np.random.default_rng(3).normal(0.0, 2e-4, (21, 3))
    level = np.array([7900.0, 9800.0, 6100.0])
    return SphereSeries(
        images=tuple(f"sphere_{k:03d}.tif" for k in range(21)),
        time_s=time,
        dn=level * (1.0 + drift_percent_per_h / 100.0 * time[:, None] / 3600.0 + noise),
        bands=("red", "green", "blue"),
        since_lamp_on_s=1500.0,
    )


def sphere_log(start_s: float, interval_s: float, since_s: float) -> tuple[SphereExposure, ...]:
    return tuple(
        SphereExposure(
            image=f"sphere_{k:03d}.tif",
            gps_time_s=start_s + interval_s * k,
            since_lamp_on_s=since_s + interval_s * k,
            exposure_time_s=0.01,
            gain_e_per_dn=3.0,
            f_number=5.6,
        )
        for k in range(21)
    )


@pytest.fixture
def sphere_result() -> SphereResult:
    """Both indicators of 8.2 with a lamp that gains 0.1 % an hour."""
    stability = IndicatorValue(
        value=0.0371,
        unit="%",
        formula="(3)-(5)",
        clause="8.2",
        sample_size=21,
        std=0.006,
        companions={"trend_percent_per_h": 0.104, "trend_std_percent_per_h": 0.008, "worst_band": "blue"},
    )
    repeatability = replace(stability, value=0.0199, formula="(6)", companions={"sd_dn": 1.6})
    return SphereResult(
        stability=stability,
        repeatability=repeatability,
        stability_series=sphere_series(180.0, 0.1),
        repeatability_series=sphere_series(15.0, 0.1),
    )


@pytest.fixture
def chessboard_result() -> ChessboardResult:
    """24 images of a board of 17 x 12 inner corners at four distances, 0.05 px of noise an axis; the true lens, a little off."""
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(np.arange(17), np.arange(12)), axis=-1).reshape(-1, 2)
    distances = (1.6, 2.0, 2.5, 3.0)
    images, cells = [], np.zeros((4, 6, 8), int)
    for k in range(24):
        position, turn = divmod(k, 6)
        rotation = euler_rotation(*np.radians([20.0 * (turn % 3 - 1), 18.0 * (turn // 3 - 0.5) * 2.0, 5.0 * turn]))
        size = 3000.0 * 0.06 / distances[position]
        centre = np.array([WIDTH, HEIGHT]) * (0.32 + 0.18 * (turn % 3), 0.42 + 0.16 * (turn // 3))
        observed = centre + (grid - (8.0, 5.5)) * size * (0.95, 0.94)
        shift = rng.normal(0.0, 0.05, observed.shape)
        images.append(
            BoardImage(
                image=f"board_{k:03d}.tif",
                corner=grid,
                observed_px=observed,
                projected_px=observed + shift,
                error_px=np.hypot(*shift.T),
                camera_from_board_rotation=rotation,
                camera_from_board_translation_m=np.array([0.0, 0.0, distances[position]]),
                position=position,
            )
        )
        u, v = np.clip((observed / (WIDTH, HEIGHT) * (8, 6)).astype(int), 0, (7, 5)).T
        np.add.at(cells[position], (v, u), 1)
    std = np.array([0.04, 0.04, 0.05, 0.05, 6e-5, 4e-4, 8e-4, 4e-6, 4e-6])
    correlation = np.eye(9)
    correlation[0, 1] = correlation[1, 0] = 0.97
    correlation[4, 5] = correlation[5, 4] = -0.93
    correlation[5, 6] = correlation[6, 5] = -0.98
    correlation[4, 6] = correlation[6, 4] = 0.86
    off = np.array([1.0, 1.0, -0.5, 0.3, 0.5, -0.4, 0.3, 0.2, -0.2]) * std
    estimates = lens_vector(TRUE_LENS) + off
    indicator = IndicatorValue(
        value=0.0627,
        unit="pixel",
        formula="(16)-(19)",
        clause="9.2",
        sample_size=24,
        std=0.0005,
        companions={
            "parameters": list(LENS_NAMES),
            "estimates": estimates.tolist(),
            "std": std.tolist(),
            "image_size_px": [WIDTH, HEIGHT],
            "coverage": 1.0,
            "coverage_counts": cells.tolist(),
        },
    )
    return ChessboardResult(
        indicator=indicator,
        lens=lens_from_vector(estimates),
        covariance=correlation * np.outer(std, std),
        image_size_px=(WIDTH, HEIGHT),
        focus_distance_m=2.0,
        f_number=5.6,
        images=tuple(images),
        not_used={"board_024.tif": "no board of 17 x 12 inner corners found"},
        distances_m=distances,
        coverage=cells,
    )


@pytest.fixture
def ranging_result() -> RangingResult:
    """Six panels; the LiDAR reads 50 mm and 0.2 per mille short."""
    true = np.array([15.0, 60.0, 105.0, 150.0, 195.0, 240.0])
    noise = np.array([0.4, -0.6, 0.9, -0.3, 0.2, -0.5]) * 1e-3
    measured = (true - 0.05) / (1.0 + 2e-4) + noise
    panels = tuple(
        PanelRange(
            panel=f"L{k + 1:02d}",
            lidar_m=float(m),
            lidar_std_m=0.0015,
            scans=5,
            correction_m=float(t),
            reference_m=float(t),
            corrected_m=float(m + 0.0502 + 2.01e-4 * m),
            correction_readings=5,
            reference_readings=5,
            points=400,
        )
        for k, (t, m) in enumerate(zip(true, measured))
    )
    indicator = IndicatorValue(
        value=0.00048,
        unit="%",
        formula="(9)-(15)",
        clause="9.1",
        sample_size=6,
        companions={
            "additive_constant_m": 0.0502,
            "additive_constant_std_m": 0.0008,
            "multiplication_constant": 2.01e-4,
            "multiplication_constant_std": 5e-6,
            "scan_duration_s": 12.0,
            "chi_square": 3.1,
            "chi_square_freedom": 4,
            "chi_square_p": 0.54,
            "beside": {"panel": "L04", "share": 0.04},
        },
    )
    return RangingResult(
        indicator=indicator,
        panels=panels,
        additive_constant_m=0.0502,
        multiplication_constant=2.01e-4,
        covariance=np.array([[6.4e-7, -3e-9], [-3e-9, 2.5e-11]]),
        not_used={"L07": "no point of it in 3 of 5 scans"},
    )


@pytest.fixture
def bench_data(campaign_data: CampaignData) -> CampaignData:
    """The same flight with both benches and the ranging line, the day before; nothing of them violates the standard."""
    panels = tuple(RangingPanel(id=f"L{k + 1:02d}", size_m=1.2) for k in range(6))
    common = {"scale": 1e-6, "reference_index": 1.000286, "wavelength_um": 0.658}
    stations = (
        TotalStation(name="A", class_mm=10.0, additive_constant_m=-0.0014, serves=("correction",), **common),
        TotalStation(name="B", class_mm=5.0, additive_constant_m=0.0006, serves=("reference",), **common),
    )
    readings = tuple(
        StationReading(
            station=station.name,
            panel=panel.id,
            observation=k,
            slope_distance_m=15.0 + 45.0 * i,
            horizontal_angle_deg=12.0,
            zenith_angle_deg=90.2,
            temperature_c=27.0,
            pressure_hpa=1008.0,
            relative_humidity_percent=65.0,
        )
        for station in stations
        for i, panel in enumerate(panels)
        for k in range(1, 6)
    )
    bench = BenchData(
        room=RoomSheet(
            dust_free=True,
            single_light_source=True,
            temperature_c=20.0,
            relative_humidity_percent=60.0,
            pressure_hpa=1010.0,
            sphere_traceability="second class standard, certificate 7",
        ),
        stability=sphere_log(BENCH_S, 180.0, 1500.0),
        repeatability=sphere_log(BENCH_S + 4000.0, 15.0, 5500.0),
        board=BoardSheet(
            inner_columns=17, inner_rows=12, square_m=0.06, width_m=1.2, height_m=0.9, material="printed aluminium"
        ),
        board_log=tuple(
            BoardExposure(image=f"board_{k:03d}.tif", gps_time_s=BENCH_S + 8000.0 + 20.0 * k) for k in range(25)
        ),
    )
    line = RangingLine(stations=stations, panels=panels, eccentricity_m=(0.35, -0.22, 0.10), eccentricity_std_m=0.0005)
    return replace(campaign_data, bench=bench, ranging=RangingData(line=line, readings=readings))


@pytest.fixture
def bench_inputs(
    conformity_inputs: ConformityInputs,
    sphere_result: SphereResult,
    chessboard_result: ChessboardResult,
    ranging_result: RangingResult,
) -> ConformityInputs:
    """Facts of a good flight and of good benches."""
    whole = replace(chessboard_result, coverage=np.full((4, 6, 8), 9))
    return replace(
        conformity_inputs, sphere=sphere_result, chessboard=whole, ranging=ranging_result, indicators_measured=8
    )
