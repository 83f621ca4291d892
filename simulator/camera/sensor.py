"""From radiance to digital numbers after EMVA 1288: photons, electrons, noise, gain, black level, bits; and the preview.

One gain serves all bands, as on a camera with one analogue chain; it is set at the first strip and then left alone. Optics
before the sensor (lens, point spread, motion) are the renderer's, vignetting is here.

References
----------
EMVA Standard 1288, release 4.0 Linear: the linear camera model.
"""

from dataclasses import dataclass, replace

import numpy as np

from campaign.config import Band, Camera
from scenes.model import SunSky
from scenes.sunsky import band_irradiance

PLANCK_J_S = 6.62607015e-34
LIGHT_M_S = 299792458.0
GAUSSIAN_AREA = np.sqrt(np.pi / (4 * np.log(2)))  # of a Gaussian response over its full width at half maximum
POISSON_BELOW_E = 50.0  # fewer electrons than this are drawn from a Poisson distribution
ROWS_AT_ONCE = 16  # blocks of fixed size: the noise of a frame is one sequence
DARK_CURRENT_C = 20.0  # sensor temperature for which a camera's dark current is stated
LONGEST_EXPOSURE_S = 1.0  # on a bench; a fainter light is met with gain
DAYLIGHT_K = 5800.0  # black body for the preview's fixed white balance


@dataclass(frozen=True, kw_only=True)
class Exposing:
    """Exposure as set at the first strip."""

    e_per_radiance: np.ndarray  # (bands,) electrons for 1 W m-2 sr-1 nm-1 on the axis
    e_per_dn: float  # one analogue gain for all bands
    exposure_time_s: float  # as configured, or shorter where a white panel would pass the target part of the full well
    white_dn: np.ndarray  # (bands,) expected DN above black of a level 100 % reflector


@dataclass(frozen=True, kw_only=True)
class FixedPattern:
    """What differs from pixel to pixel and stays: keys of normal numbers that belong to a pixel's place, so that no map of the
    sensor is kept."""

    prnu: np.uint64  # relative gain error, in standard deviations
    dsnu: np.uint64  # offset, the same


@dataclass(frozen=True, kw_only=True)
class Window:
    """The part of the sensor that is read out."""

    column: int  # the first one
    row: int
    width_px: int
    height_px: int

    @property
    def cut(self) -> tuple[slice, slice]:
        """Rows and columns of the window in an array of the whole sensor."""
        return slice(self.row, self.row + self.height_px), slice(self.column, self.column + self.width_px)


def middle_window(camera: Camera, size_px: tuple[int, int] | None) -> Window:
    """A window of (width, height) about the sensor's middle, at most the sensor; None: the whole sensor."""
    width, height = (camera.width_px, camera.height_px) if size_px is None else size_px
    width, height = min(max(width, 1), camera.width_px), min(max(height, 1), camera.height_px)
    return Window(
        column=(camera.width_px - width) // 2, row=(camera.height_px - height) // 2, width_px=width, height_px=height
    )


def dark_current_e_s(camera: Camera, temperature_c: float, doubling_k: float) -> float:
    r"""Dark current of the sensor at another temperature than the one it is stated for.

    .. math:: I(T) = I(20\,^{\circ}\mathrm{C}) \cdot 2^{(T - 20\,^{\circ}\mathrm{C}) / \Delta T}

    Parameters
    ----------
    temperature_c : float
        Of the sensor. [degrees Celsius]
    doubling_k : float
        Rise of temperature that doubles the dark current. [K]

    Returns
    -------
    float
        [e/s]

    References
    ----------
    EMVA Standard 1288, release 4.0 Linear, 7 (dark current and its dependence on temperature).
    """
    return float(camera.dark_current_e_s * 2.0 ** ((temperature_c - DARK_CURRENT_C) / doubling_k))


def full_scale_dn(camera: Camera) -> float:
    """DN between the black level and the last step."""
    return 2.0**camera.bit_depth - 1.0 - camera.black_level_dn


def electrons_per_radiance(camera: Camera, band: Band, exposure_time_s: float) -> float:
    r"""Electrons in a pixel on the axis for unit spectral radiance, the lens focused at infinity.

    .. math:: \mu_e = \frac{\pi}{4 N^2}\, A\, t\, \eta\, \Delta\lambda\, \frac{\lambda}{h c}\, L_\lambda

    Parameters
    ----------
    band : Band
        Gaussian response of unit peak; the radiance is its average over the band, photons are counted at its centre.
    exposure_time_s : float
        [s]

    Returns
    -------
    float
        [e / (W m-2 sr-1 nm-1)]

    References
    ----------
    EMVA Standard 1288, release 4.0 Linear, 2.1 (photons from irradiance).
    """
    area_m2 = (camera.pixel_size_um * 1e-6) ** 2
    photon_j = PLANCK_J_S * LIGHT_M_S / (band.centre_nm * 1e-9)
    width_nm = GAUSSIAN_AREA * band.fwhm_nm
    irradiance = np.pi / (4 * camera.f_number**2)
    return float(irradiance * area_m2 * exposure_time_s * camera.quantum_efficiency * width_nm / photon_j)


def exposure_gain(camera: Camera, light: SunSky) -> Exposing:
    """Set exposure and gain so that a level 100 % reflector reaches `exposure_target` of full scale in its brightest band.

    Where it would pass that part of the full well, the exposure is shortened and the gain is the full well's; else the
    exposure stays and the gain is raised.
    """
    up = max(float(light.to_sun[2]), 0.0)
    white = np.array([(direct * up + diffuse) / np.pi for direct, diffuse in _irradiances(camera, light)])
    per_radiance = np.array([electrons_per_radiance(camera, band, camera.exposure_time_s) for band in camera.bands])
    brightest = float(np.max(white * per_radiance))
    target = camera.exposure_target * camera.full_well_e
    shorter = min(1.0, target / brightest) if brightest > 0 else 1.0
    electrons = white * per_radiance * shorter
    wanted_dn = camera.exposure_target * full_scale_dn(camera)
    e_per_dn = float(np.max(electrons)) / wanted_dn if brightest > 0 else camera.full_well_e / full_scale_dn(camera)
    return Exposing(
        e_per_radiance=per_radiance * shorter,
        e_per_dn=e_per_dn,
        exposure_time_s=camera.exposure_time_s * shorter,
        white_dn=electrons / e_per_dn,
    )


def exposure_for(camera: Camera, radiance: np.ndarray, share: float) -> Exposing:
    """Set exposure and gain on a bench so that a steady light reaches a part of full scale in its brightest band.

    The gain is the base gain, at which full well and full scale meet, and the exposure is set to suit, up to
    LONGEST_EXPOSURE_S; beyond that the gain is raised.

    Parameters
    ----------
    radiance : (bands,) ndarray
        Where it is brightest. [W m-2 sr-1 nm-1]
    share : float
        Part of full scale above the black level.

    Returns
    -------
    Exposing
        Its `white_dn` is the expected DN of this light.
    """
    per_second = np.array([electrons_per_radiance(camera, band, 1.0) for band in camera.bands])
    brightest = float(np.max(radiance * per_second))
    base_gain = camera.full_well_e / full_scale_dn(camera)
    wanted_s = share * camera.full_well_e / brightest if brightest > 0 else LONGEST_EXPOSURE_S
    exposure_time_s = min(wanted_s, LONGEST_EXPOSURE_S)
    electrons = radiance * per_second * exposure_time_s
    e_per_dn = base_gain * exposure_time_s / wanted_s if brightest > 0 else base_gain
    return Exposing(
        e_per_radiance=per_second * exposure_time_s,
        e_per_dn=e_per_dn,
        exposure_time_s=exposure_time_s,
        white_dn=electrons / e_per_dn,
    )


def under_light(exposing: Exposing, radiance: np.ndarray) -> Exposing:
    """The same setting with every band's response taken times its radiance, for light of one shape in all bands.

    `expose` then takes that shape, (h, w, 1) broadcast to all bands, in the place of a radiance.
    """
    return replace(exposing, e_per_radiance=exposing.e_per_radiance * radiance)


def _irradiances(camera: Camera, light: SunSky) -> list[tuple[float, float]]:
    return [band_irradiance(light, band) for band in camera.bands]


def fixed_pattern(rng: np.random.Generator) -> FixedPattern:
    """Draw the photo-response and dark-signal non-uniformity of one camera."""
    prnu, dsnu = rng.integers(1 << 64, size=2, dtype=np.uint64)
    return FixedPattern(prnu=prnu, dsnu=dsnu)


def deviates(key: np.uint64, camera: Camera, window: Window) -> np.ndarray:
    """Standard normal numbers (h, w, bands) of a pattern's pixels in a window."""
    from simulator.camera.pixels import pattern

    out = np.empty((window.height_px, window.width_px, len(camera.bands)), np.float32)
    pattern(key, window.row, window.column, camera.width_px, out)
    return out


def vignetting(camera: Camera, window: Window | None = None) -> np.ndarray:
    """Relative illumination (h, w), of a window where there is one: 1 on the axis, 1 - `vignetting` at the sensor's
    farthest corner, quadratic in the radius.
    """
    part = middle_window(camera, None) if window is None else window
    x = (np.arange(part.column, part.column + part.width_px) + 0.5 - camera.lens.cx_px) ** 2
    y = (np.arange(part.row, part.row + part.height_px) + 0.5 - camera.lens.cy_px) ** 2
    corner = max(camera.lens.cx_px, camera.width_px - camera.lens.cx_px) ** 2
    corner += max(camera.lens.cy_px, camera.height_px - camera.lens.cy_px) ** 2
    return np.asarray(1 - camera.vignetting * (y[:, None] + x) / corner, np.float32)


def expose(
    radiance: np.ndarray,
    camera: Camera,
    exposing: Exposing,
    camera_gain_fault: float,
    rng_frame: np.random.Generator,
    pattern: FixedPattern,
    window: Window | None = None,
    dark_e_s: float | None = None,
) -> np.ndarray:
    """One picture of the sensor, or of a window of it.

    Parameters
    ----------
    radiance : (h, w, bands) ndarray
        [W m-2 sr-1 nm-1]
    camera_gain_fault : float
        Factor on the DN above black; 1 is no fault.
    rng_frame : numpy.random.Generator
        Of this frame's temporal noise.
    pattern : FixedPattern
        Of the camera.
    window : Window, optional
        What `radiance` shows of the sensor; absent: all of it. Windows of ROWS_AT_ONCE rows, or a multiple,
        one below the other and with one generator, give the bytes of the whole.
    dark_e_s : float, optional
        Dark current at the sensor's temperature; absent: as the camera's data state it. [e/s]

    Returns
    -------
    (h, w, bands) uint16 ndarray
        DN, black level included.
    """
    from simulator.camera.pixels import expected, steps
    from simulator.normals import normal_stream

    part = middle_window(camera, None) if window is None else window
    dn = np.empty(radiance.shape, np.uint16)
    per_radiance = exposing.e_per_radiance.astype(np.float32)
    dark = np.float32((camera.dark_current_e_s if dark_e_s is None else dark_e_s) * exposing.exposure_time_s)
    below, prnu, dsnu_e = np.float32(POISSON_BELOW_E), np.float32(camera.prnu), np.float32(camera.dsnu_e)
    levels = (
        np.float32(camera.read_noise_e**2),
        np.float32(camera.full_well_e),
        np.float32(camera_gain_fault / exposing.e_per_dn),
        np.float32(camera.black_level_dn + 0.5),  # the conversion to integers truncates
        np.float32(2**camera.bit_depth - 1),
    )
    means, normals = np.empty((2, ROWS_AT_ONCE, *dn.shape[1:]), np.float32)
    words = np.empty((normals.size + 1) // 2, np.uint64)
    seen = np.broadcast_to(np.asarray(radiance, np.float32), dn.shape)
    for first in range(0, len(dn), ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        mean, noise = means[: len(dn[rows])], normals[: len(dn[rows])]
        block = replace(part, row=part.row + first, height_px=len(mean))
        light, of_gain = vignetting(camera, block), deviates(pattern.prnu, camera, block)
        few = expected(seen[rows], light, per_radiance, prnu, of_gain, dark, below, mean)
        key = rng_frame.integers(1 << 64, dtype=np.uint64)
        normal_stream(key, np.uint64(0), words, words.view(np.int32), noise.reshape(-1))
        if few:
            where = mean < below
            low = mean[where]
            drawn = rng_frame.poisson(low) + camera.read_noise_e * rng_frame.standard_normal(len(low))
            mean[where], noise[where] = drawn.astype(np.float32), 0
        steps(mean, noise, dsnu_e, deviates(pattern.dsnu, camera, block), levels, dn[rows])
    return dn


def sensor_noise_std_dn(signal_dn: np.ndarray, camera: Camera, exposing: Exposing) -> np.ndarray:
    r"""Standard deviation of single pixels about their mean signal, fixed pattern included, in closed form.

    .. math:: \sigma^2 = \frac{\mu}{K} + \frac{\mu_d + \sigma_r^2 + \sigma_{DSNU}^2}{K^2} + (s\,\mu)^2 + \frac{1}{12}

    with K the electrons for one DN and s the PRNU.

    Parameters
    ----------
    signal_dn : array_like
        Above the black level. [DN]

    References
    ----------
    EMVA Standard 1288, release 4.0 Linear, 2.3 (noise model), 2.4 (non-uniformity).
    """
    signal = np.asarray(signal_dn, float)
    k = exposing.e_per_dn
    dark = camera.dark_current_e_s * exposing.exposure_time_s
    electrons = dark + camera.read_noise_e**2 + camera.dsnu_e**2
    return np.asarray(np.sqrt(np.maximum(signal, 0) / k + electrons / k**2 + (camera.prnu * signal) ** 2 + 1 / 12))


def white_balance(camera: Camera) -> np.ndarray:
    """Relative signal (bands,) of a white surface by daylight, the greatest 1: the preview's fixed balance.

    A black body at DAYLIGHT_K stands for daylight; photons are counted, weighted by the bands' widths.
    """
    metre = np.array([band.centre_nm for band in camera.bands]) * 1e-9
    power = metre**-5 / np.expm1(PLANCK_J_S * LIGHT_M_S / (metre * 1.380649e-23 * DAYLIGHT_K))
    signal = power * metre * np.array([band.fwhm_nm for band in camera.bands])
    return np.asarray(signal / signal.max())


def preview(dn: np.ndarray, camera: Camera) -> np.ndarray:
    """8-bit sRGB picture (h, w, 3): black taken off, fixed white balance, scaled to full scale, sRGB transfer curve.

    Bands by falling wavelength go to red, green, blue; one band is grey, of two the shorter is shown as green and blue.
    """
    order = np.argsort([-band.centre_nm for band in camera.bands], kind="stable")
    balance = white_balance(camera)
    steps = np.arange(2**camera.bit_depth)
    picture = np.empty((*dn.shape[:2], 3), np.uint8)
    for channel in range(3):
        band = order[min(channel, len(order) - 1)]
        linear = np.clip((steps - camera.black_level_dn) / (full_scale_dn(camera) * balance[band]), 0, 1)
        curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        value = np.round(255 * curve).astype(np.uint8)
        for first in range(0, len(dn), ROWS_AT_ONCE):
            rows = slice(first, first + ROWS_AT_ONCE)
            picture[rows, :, channel] = value[np.minimum(dn[rows, :, band], len(steps) - 1)]
    return picture
