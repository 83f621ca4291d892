"""A campaign with everything, each part by the evaluator's own formulas."""

from dataclasses import replace

import numpy as np
import pytest

from campaign.benches.ranging import RangingLine, RangingPanel, StationReading, TotalStation
from evaluator.benches.bench_model import BoardImage, ChessboardResult, SphereResult, SphereSeries
from evaluator.c8_1_lidar_reflectance import evaluate_lidar_reflectance
from evaluator.c8_2_camera_radiometry import mean_dn, repeatability, stability_rsd, standard_deviation_dn
from evaluator.c8_3_reflectance_consistency import band_reflectance, evaluate_reflectance_consistency
from evaluator.c9_1_lidar_ranging import corrected_range, mean_range, ranging_rmse, relative_rmse
from evaluator.c9_3_calibration import calibration_error, target_errors
from evaluator.frames import euler_rotation
from evaluator.model import CampaignData, RangingData
from evaluator.observe.panels import ImagePanelObservation, LidarPanelObservation
from evaluator.results import Evaluation
from evaluator.results_model import IndicatorValue


def _radiometry(data: CampaignData) -> dict[str, IndicatorValue]:
    """8.1 and 8.3 on observations by hand: radar equation with 1 % of noise, a straight line with 0.5 %."""
    rng = np.random.default_rng(41)
    panels = [t for t in data.targets if t.kind == "panel"]
    lidar = []
    images = []
    assert data.spectra is not None and data.camera is not None
    for sortie, height in ((1, 45.0), (2, 65.0)):
        for k, t in enumerate(panels):
            level, range_m = 0.98 * (t.nominal_reflectance_percent or 0.0), height + 0.05 * k
            lidar.append(
                LidarPanelObservation(
                    panel=t.id,
                    sortie=sortie,
                    strip=1,
                    design_height_m=height,
                    points=300,
                    used=200,
                    amplitude_dn=4e4 * level / range_m**2 * rng.normal(1.0, 0.01),
                    amplitude_std_dn=5.0,
                    range_m=range_m,
                    cos_incidence=0.99,
                    echo_fwhm_ns=4.3,
                    from_waveform=True,
                    offset_m=(0.0, 0.0, 0.0),
                )
            )
            share = [band_reflectance(data.spectra, t.id, b) / 100.0 for b in data.camera.bands]
            images.append(
                ImagePanelObservation(
                    panel=t.id,
                    sortie=sortie,
                    strip=1,
                    image=f"s{sortie:02d}_000.tif",
                    mean_dn=tuple(60.0 + 9000.0 * s * rng.normal(1.0, 0.005) for s in share),
                    std_dn=(20.0,) * 3,
                    clipped_share=(0.0,) * 3,
                    pixels=900,
                    uneven=False,
                    region_px=np.zeros((4, 2)),
                )
            )
    m_f, values = evaluate_lidar_reflectance(lidar, data.targets, data.spectra, data.lidar)
    r_f, m_relative, _ = evaluate_reflectance_consistency(values, images, data.targets, data.spectra, data.camera)
    return {"lidar_reflectance_rmse": m_f, "reflectance_correlation": r_f, "reflectance_rmse_relative": m_relative}


def _sphere() -> SphereResult:
    bands, rng = ("red", "green", "blue"), np.random.default_rng(8)
    out = []
    for interval, value, formula in ((180.0, stability_rsd, "(3)-(5)"), (15.0, repeatability, "(6)")):
        dn = np.array([7900.0, 9800.0, 6100.0]) * (1.0 + rng.normal(0.0, 3e-3, (21, 3)))
        series = SphereSeries(
            images=tuple(f"s_{k:03d}.tif" for k in range(21)),
            time_s=interval * np.arange(21),
            dn=dn,
            bands=bands,
            since_lamp_on_s=1500.0,
        )
        channels = {
            b: {"value": value(c), "sd_dn": standard_deviation_dn(c), "mean_dn": mean_dn(c)}
            for b, c in zip(bands, dn.T, strict=True)
        }
        worst = max(channels, key=lambda b: channels[b]["value"])
        found = IndicatorValue(
            value=channels[worst]["value"],
            unit="%",
            formula=formula,
            clause="8.2",
            sample_size=21,
            companions={"channels": channels, "worst_channel": worst},
        )
        out.append((found, series))
    return SphereResult(
        stability=out[0][0], stability_series=out[0][1], repeatability=out[1][0], repeatability_series=out[1][1]
    )


def _ranging(data: CampaignData) -> tuple[CampaignData, IndicatorValue]:
    panels = tuple(RangingPanel(id=f"L{k + 1:02d}", size_m=1.2) for k in range(6))
    station = TotalStation(
        name="A", class_mm=2.0, additive_constant_m=-0.0014, scale=2e-6, reference_index=1.000286, wavelength_um=0.658
    )
    truth = np.array([15.0, 60.0, 105.0, 150.0, 195.0, 240.0])
    readings = tuple(
        StationReading(
            station="A",
            panel=p.id,
            observation=k,
            slope_distance_m=float(t) + 0.001 * k,
            horizontal_angle_deg=12.0,
            zenith_angle_deg=90.2,
            temperature_c=27.0 + k,
            pressure_hpa=1008.0,
            relative_humidity_percent=None if k == 2 else 65.0,
        )
        for p, t in zip(panels, truth, strict=True)
        for k in range(1, 6)
    )
    measured = truth * (1.0 - 2e-4) - 0.05 + np.array([0.4, -0.6, 0.9, -0.3, 0.2, -0.5]) * 1e-3
    k2, r2 = 0.0502, 2.01e-4
    corrected = corrected_range(measured, k2, r2)
    rmse, mean = ranging_rmse(corrected, truth), mean_range(truth)
    rows = [
        {
            "panel": p.id,
            "lidar_m": float(m),
            "lidar_std_m": 0.0012,
            "scans": 5,
            "correction_m": float(t) + 0.0003,
            "reference_m": float(t),
            "corrected_m": float(c),
            "correction_readings": 5,
            "reference_readings": 5,
            "points": 400,
        }
        for p, m, t, c in zip(panels, measured, truth, corrected, strict=True)
    ]
    indicator = IndicatorValue(
        value=relative_rmse(rmse, mean),
        unit="%",
        formula="(11)",
        clause="9.1",
        sample_size=6,
        companions={
            "additive_constant_m": k2,
            "additive_constant_std_m": 8e-4,
            "multiplication_constant": r2,
            "multiplication_constant_std": 5e-6,
            "unweighted_constants": [k2, r2],
            "rmse_m": rmse,
            "mean_range_m": mean,
            "relative_rmse_before_percent": relative_rmse(ranging_rmse(measured, truth), mean),
            "leave_one_panel_out_percent": 0.0009,
            "panels": rows,
        },
    )
    line = RangingLine(stations=(station,), panels=panels, eccentricity_m=(0.35, -0.22, 0.1), eccentricity_std_m=0.0005)
    return replace(data, ranging=RangingData(line=line, readings=readings)), indicator


def _chessboard() -> ChessboardResult:
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(np.arange(9), np.arange(6)), axis=-1).reshape(-1, 2)
    images = []
    for k in range(20):
        corners = grid[: 54 - k]  # images do not all show every corner
        observed = 300.0 + 40.0 * corners
        shift = rng.normal(0.0, 0.05, observed.shape)
        images.append(
            BoardImage(
                image=f"b_{k:03d}.tif",
                corner=corners,
                observed_px=observed,
                projected_px=observed + shift,
                error_px=np.hypot(*shift.T),
                camera_from_board_rotation=euler_rotation(0.1, 0.2, 0.01 * k),
                camera_from_board_translation_m=np.array([0.1, -0.2, 1.5 + 0.1 * k]),
                position=k % 4,
            )
        )
    per_image = [
        {"image": i.image, "corners": len(i.corner), "mean_px": float(i.error_px.mean()), "distance_m": 1.5}
        for i in images
    ]
    names = ["fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "k3", "p1", "p2"]
    indicator = IndicatorValue(
        value=float(np.concatenate([i.error_px for i in images]).mean()),
        unit="pixel",
        formula="(19)",
        clause="9.2",
        sample_size=20,
        companions={
            "parameters": names,
            "estimates": [3000.1, 2999.8, 1536.0, 1024.0, -0.05, 0.02, -0.005, 3e-4, -2e-4],
            "std": [0.04] * 4 + [6e-6] * 5,
            "per_image": per_image,
            "held_out_px": 0.0635,
            "rms_px": 0.07,
            "max_px": 0.2,
        },
    )
    return ChessboardResult(indicator=indicator, images=tuple(images), not_used={"b_020.tif": "no board found"})


@pytest.fixture
def whole(evaluation: Evaluation) -> Evaluation:
    """All eight indicators with the companions that the evaluator writes."""
    assert evaluation.data is not None
    sphere, board = _sphere(), _chessboard()
    data, m_z = _ranging(evaluation.data)
    per_target = target_errors(list(evaluation.residuals))
    p_m = IndicatorValue(
        value=calibration_error(np.array(list(per_target.values()))),
        unit="pixel",
        formula="(20)",
        clause="9.3",
        sample_size=24,
        companions={
            "per_target_px": per_target,
            "per_sortie_px": {"1": 0.30, "2": 0.31},
            "held_out_px": 0.33,
            "single_instant": {"p_m_px": 1.4},
        },
    )
    indicators = _radiometry(data) | {
        "camera_stability": sphere.stability,
        "camera_repeatability": sphere.repeatability,
        "lidar_ranging_rmse_relative": m_z,
        "camera_reprojection_error": board.indicator,
        "calibration_error": p_m,
    }
    points = {
        (s, strip, t.id): np.arange(100 * s, 100 * s + 40) for s in (1, 2) for strip in (1, 2) for t in data.targets
    }
    return replace(
        evaluation,
        data=data,
        indicators=indicators,
        sphere=sphere,
        chessboard=board,
        companions={"target_points": points},
    )
