"""The sensor: exposure, limits of the scale, black level, vignetting, fixed pattern, preview."""

from datetime import UTC, datetime

import numpy as np
import pytest

from campaign.config import Band, Camera, Environment, Lens, Site
from scenes.model import SunSky
from scenes.sunsky import band_irradiance, sun_sky
from simulator.camera.sensor import (
    ROWS_AT_ONCE,
    FixedPattern,
    Window,
    electrons_per_radiance,
    expose,
    exposure_gain,
    fixed_pattern,
    preview,
    vignetting,
)

BANDS = (
    Band(name="red", centre_nm=620.0, fwhm_nm=70.0),
    Band(name="green", centre_nm=540.0, fwhm_nm=75.0),
    Band(name="blue", centre_nm=465.0, fwhm_nm=70.0),
)


def camera(**changes: object) -> Camera:
    values: dict = {
        "width_px": 64,
        "height_px": 64,
        "pixel_size_um": 4.5,
        "nominal_focal_length_mm": 13.5,
        "lens": Lens(fx_px=100.0, fy_px=100.0, cx_px=32.0, cy_px=32.0),
        "bands": BANDS,
    }
    return Camera(**(values | changes))


def quiet(**changes: object) -> Camera:
    return camera(**({"read_noise_e": 0.0, "dark_current_e_s": 0.0, "prnu": 0.0, "dsnu_e": 0.0} | changes))


@pytest.fixture(scope="module")
def light() -> SunSky:
    return sun_sky(Site(), Environment(), datetime(2026, 6, 12, 3, 0, tzinfo=UTC))


def white_radiance(cam: Camera, light: SunSky) -> np.ndarray:
    up = light.to_sun[2]
    return np.array([(d * up + f) / np.pi for d, f in (band_irradiance(light, b) for b in cam.bands)])


ANY_PATTERN = FixedPattern(prnu=np.uint64(1), dsnu=np.uint64(2))  # its spread is the camera's


def test_electrons_of_a_hand_worked_pixel() -> None:
    """Rationale: absolute photon counts decide the noise.

    Expected: L = 0.1 W m-2 sr-1 nm-1 at f/4 gives E = pi 0.1/64 = 4.9087e-3 W m-2 nm-1; over (4.5 um)^2 and 0.5 ms
    4.9701e-17 J/nm; times 75 x 1.064467 nm = 3.9678e-15 J; one photon at 540 nm 3.67861e-19 J; at 50 % 5393.1 e.
    Tolerance: 2e-4, the figures are rounded.
    """
    assert 0.1 * electrons_per_radiance(camera(f_number=4.0), BANDS[1], 5e-4) == pytest.approx(5393.1, rel=2e-4)


@pytest.mark.parametrize(("f_number", "shortened"), [(5.6, False), (1.4, True)])
def test_white_reaches_the_target_part_of_full_scale(light: SunSky, f_number: float, shortened: bool) -> None:
    """Rationale: the gain is set so; a lens that is too fast must shorten the exposure and not pass the full well.

    Expected: the brightest band of a level white reflector at exposure_target of full scale.
    Tolerance: one DN on the mean of 4096 pixels (shot noise over 64 is 0.3 DN), 0.02 %.
    """
    cam = quiet(f_number=f_number)
    exposing = exposure_gain(cam, light)
    assert (exposing.exposure_time_s < cam.exposure_time_s) is shortened
    scene = np.broadcast_to(white_radiance(cam, light), (64, 64, 3)).astype(np.float32)
    electrons = white_radiance(cam, light) * exposing.e_per_radiance
    assert electrons.max() <= cam.exposure_target * cam.full_well_e * (1 + 1e-9)
    dn = expose(scene, cam, exposing, 1.0, np.random.default_rng(1), ANY_PATTERN)
    mean = dn.mean(axis=(0, 1)) - cam.black_level_dn
    assert mean.max() == pytest.approx(cam.exposure_target * (2**14 - 1 - 256), abs=3.0)
    assert mean == pytest.approx(exposing.white_dn, abs=5.0)


def test_scale_ends_at_full_well_and_last_step(light: SunSky) -> None:
    """Rationale: clipping must be visible as clipping.

    Expected: overexposure stops at the full well or at the last step, whichever comes first; darkness at the black level.
    Tolerance: none; the dark frame's mean within 0.05 DN (read noise 3 e over 12288 values).
    """
    cam = camera(f_number=5.6)
    exposing = exposure_gain(cam, light)
    bright = np.full((64, 64, 3), 100.0, np.float32)
    assert (expose(bright, cam, exposing, 1.0, np.random.default_rng(1), ANY_PATTERN) == 2**14 - 1).all()
    small = cam.model_copy(update={"full_well_e": 2000.0})
    stop = np.floor(2000.0 / exposing.e_per_dn + 256 + 0.5)
    assert (expose(bright, small, exposing, 1.0, np.random.default_rng(1), ANY_PATTERN) == stop).all()
    dark = expose(np.zeros_like(bright), cam, exposing, 1.0, np.random.default_rng(1), ANY_PATTERN)
    assert dark.mean() == pytest.approx(256.0, abs=0.05)
    assert dark.min() < 256  # noise about the black level is kept, not cut off


def test_gain_fault_multiplies_what_is_above_black(light: SunSky) -> None:
    """Rationale: the injected fault is a factor on the signal, not on the black level.

    Expected: means above black in the ratio 0.9.
    Tolerance: shot noise of 12288 values at some 5000 e: 3e-4.
    """
    cam = quiet()
    exposing = exposure_gain(cam, light)
    half = np.broadcast_to(0.5 * white_radiance(cam, light), (64, 64, 3)).astype(np.float32)
    means = [
        expose(half, cam, exposing, gain, np.random.default_rng(1), ANY_PATTERN).mean() - 256 for gain in (1.0, 0.9)
    ]
    assert means[1] / means[0] == pytest.approx(0.9, rel=3e-4)


def test_vignetting_is_one_on_the_axis_and_as_stated_in_the_corner() -> None:
    """Rationale: `vignetting` is the loss at the corner.

    Expected: 1 at the principal point, 1 - 0.3 at the corner, 1 - 0.15 half way up the axis's square (x = w/2, y = 0).
    Tolerance: a pixel's half width, 1 %.
    """
    fall = vignetting(camera(vignetting=0.3))
    assert fall[32, 32] == pytest.approx(1.0, abs=1e-3)
    assert fall[0, 0] == pytest.approx(0.7, abs=0.01)
    assert fall[32, 0] == pytest.approx(0.85, abs=0.01)


def test_fixed_pattern_stays_and_noise_does_not(light: SunSky) -> None:
    """Rationale: PRNU is a map of the camera, shot noise is new in each frame.

    Expected: the mean of two frames' product of deviations is the PRNU's variance: correlation s^2 mu^2.
    Tolerance: 64*64*3 pairs with shot noise 1.5 times the PRNU (1 %): 4 sigma = 12 %.
    """
    cam = quiet(prnu=0.01)
    pattern = fixed_pattern(np.random.default_rng(5))
    exposing = exposure_gain(cam, light)
    half = np.broadcast_to(0.5 * white_radiance(cam, light), (64, 64, 3)).astype(np.float32)
    frames = [expose(half, cam, exposing, 1.0, np.random.default_rng(k), pattern).astype(float) for k in (1, 2)]
    relative = [(f - f.mean((0, 1))) / (f.mean((0, 1)) - 256) for f in frames]
    assert np.mean(relative[0] * relative[1]) == pytest.approx(0.01**2, rel=0.12)


def test_bands_of_rows_are_the_whole_picture(light: SunSky) -> None:
    """Rationale: a frame is developed band by band as it is rendered; its noise, fall-off and fixed pattern must not show where.

    Expected: windows of one, two and one block of rows with one generator give the bytes of the whole, dark pixels (drawn from a
    Poisson distribution) among them. Tolerance: none.
    """
    cam = camera(vignetting=0.3)
    pattern = fixed_pattern(np.random.default_rng(5))
    exposing = exposure_gain(cam, light)
    scene = np.geomspace(1e-4, 1.0, 64)[None, :, None] * white_radiance(cam, light) * np.ones((64, 1, 1))
    radiance = scene.astype(np.float32)
    whole = expose(radiance, cam, exposing, 1.0, np.random.default_rng(1), pattern)
    rng, parts = np.random.default_rng(1), []
    for first, last in ((0, 1), (1, 3), (3, 4)):
        rows = slice(first * ROWS_AT_ONCE, last * ROWS_AT_ONCE)
        window = Window(column=0, row=rows.start, width_px=64, height_px=rows.stop - rows.start)
        parts.append(expose(radiance[rows], cam, exposing, 1.0, rng, pattern, window))
    assert (np.concatenate(parts) == whole).all()


def test_preview_is_srgb_of_the_linear_signal() -> None:
    """Rationale: brightness (5.5 a) is judged on it.

    Expected: black level 0; a band at its white balance x 21.4 % of full scale gives sRGB 50 %: 0.21404 -> 0.5000; neutral.
    Tolerance: one step of 255.
    """
    from simulator.camera.sensor import white_balance

    cam = camera()
    dn = np.full((2, 2, 3), 256, np.uint16)
    dn[1] = np.round(256 + 0.21404 * (2**14 - 1 - 256) * white_balance(cam)).astype(np.uint16)
    picture = preview(dn, cam)
    assert (picture[0] == 0).all()
    assert np.abs(picture[1].astype(int) - 128).max() <= 1
    one = camera(bands=(BANDS[1],))
    grey = preview(dn[..., 1:2], one)
    assert (grey[..., 0] == grey[..., 1]).all() and (grey[..., 1] == grey[..., 2]).all()
    swapped = camera(bands=(BANDS[2], BANDS[0]))  # blue first
    two = preview(np.dstack([np.full((1, 1), 256), np.full((1, 1), 9000)]).astype(np.uint16), swapped)
    assert two[0, 0, 0] > 150 and (two[0, 0, 1:] == 0).all()
