"""Photon transfer: the camera's noise against its signal, EMVA 1288."""

from datetime import UTC, datetime

import numpy as np
import pytest

from campaign.config import Band, Camera, Environment, Lens, Site
from scenes.sunsky import sun_sky
from simulator.camera.sensor import expose, exposure_gain, fixed_pattern, sensor_noise_std_dn

CAMERA = Camera(
    width_px=256,
    height_px=256,
    pixel_size_um=4.5,
    nominal_focal_length_mm=13.5,
    lens=Lens(fx_px=500.0, fy_px=500.0, cx_px=128.0, cy_px=128.0),
    bands=(Band(name="green", centre_nm=550.0, fwhm_nm=70.0),),
    f_number=4.0,
)
LEVELS_E = np.array([5.0, 30.0, 70.0, 500.0, 3000.0, 12000.0, 24000.0])


@pytest.fixture(scope="module")
def transfer() -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Mean signal, temporal variance, total variance of flat fields at LEVELS_E, and e per DN."""
    light = sun_sky(Site(), Environment(), datetime(2026, 6, 12, 3, 0, tzinfo=UTC))
    exposing = exposure_gain(CAMERA, light)
    pattern = fixed_pattern(np.random.default_rng(7))
    rows = []
    for number, electrons in enumerate(LEVELS_E):
        flat = np.full((256, 256, 1), electrons / exposing.e_per_radiance[0], np.float32)
        a, b = (
            expose(flat, CAMERA, exposing, 1.0, np.random.default_rng([number, k]), pattern).astype(float)
            for k in (1, 2)
        )
        rows.append((0.5 * (a + b).mean() - CAMERA.black_level_dn, 0.5 * (a - b).var(), a.var()))
    signal, temporal, total = np.array(rows).T
    return signal, temporal, total, exposing.e_per_dn


def test_signal_is_linear(transfer: tuple[np.ndarray, np.ndarray, np.ndarray, float]) -> None:
    """Rationale: reflectance is regressed on DN; a bend would be taken for a property of the panels.

    Expected: mean DN = electrons / K at every level, also across the change from Poisson to Gaussian draws.
    Tolerance: 5 standard errors of the mean of 2 x 65 536 pixels, whose PRNU is common to both frames.
    """
    signal, _, total, k = transfer
    dark = CAMERA.dark_current_e_s * CAMERA.exposure_time_s
    error = np.abs(signal - (LEVELS_E + dark) / k)
    assert (error < 5 * np.sqrt(total / 65536)).all(), error / np.sqrt(total / 65536)


def test_temporal_variance_is_shot_noise(transfer: tuple[np.ndarray, np.ndarray, np.ndarray, float]) -> None:
    """Rationale: photon transfer: variance = mu/K + (dark + read)/K^2 + 1/12, so its slope gives K.

    Expected: each level's variance, and a slope of 1/K.
    Tolerance: a variance from 65 536 differences has 0.55 % standard error: 5 of them, and 2 % on the slope.
    """
    signal, temporal, _, k = transfer
    dark = CAMERA.dark_current_e_s * CAMERA.exposure_time_s
    expected = signal / k + (dark * 0 + CAMERA.read_noise_e**2) / k**2 + 1 / 12
    assert temporal == pytest.approx(expected, rel=0.0275)
    assert np.polyfit(signal[3:], temporal[3:], 1)[0] == pytest.approx(1 / k, rel=0.02)


def test_closed_form_holds_for_single_pixels(transfer: tuple[np.ndarray, np.ndarray, np.ndarray, float]) -> None:
    """Rationale: `sensor_noise_std_dn` judges the render's noise; it must be the noise of single pixels.

    Expected: the standard deviation over a flat field, fixed pattern included.
    Tolerance: 1.5 %, five standard errors of a standard deviation from 65 536 pixels.
    """
    signal, _, total, _ = transfer
    light = sun_sky(Site(), Environment(), datetime(2026, 6, 12, 3, 0, tzinfo=UTC))
    closed = sensor_noise_std_dn(signal, CAMERA, exposure_gain(CAMERA, light))
    assert np.sqrt(total) == pytest.approx(closed, rel=0.015)
