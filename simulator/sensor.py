"""From radiance to digital numbers after EMVA 1288: photons, electrons, noise, gain, black level, bits; and the preview.

One gain serves all bands, as on a camera with one analogue chain; it is set at the first strip and then left alone. Optics
before the sensor (lens, point spread, motion) are the renderer's, vignetting is here.

References
----------
EMVA Standard 1288, release 4.0 Linear: the linear camera model.
"""

from dataclasses import dataclass

import numpy as np

from campaign.config import Band, Camera
from scenes.model import SunSky
from scenes.sunsky import band_irradiance

PLANCK_J_S = 6.62607015e-34
LIGHT_M_S = 299792458.0
GAUSSIAN_AREA = np.sqrt(np.pi / (4 * np.log(2)))  # of a Gaussian response over its full width at half maximum
POISSON_BELOW_E = 50.0  # fewer electrons than this are drawn from a Poisson distribution
ROWS_AT_ONCE = 16  # blocks of fixed size: the noise of a frame is one sequence
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
    """What differs from pixel to pixel and stays, drawn once for a camera."""

    prnu: np.ndarray  # (h, w, bands) float32, relative gain error
    dsnu_e: np.ndarray  # (h, w, bands) float32 [e]


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


def _irradiances(camera: Camera, light: SunSky) -> list[tuple[float, float]]:
    return [band_irradiance(light, band) for band in camera.bands]


def fixed_pattern(camera: Camera, rng: np.random.Generator) -> FixedPattern:
    """Draw the photo-response and dark-signal non-uniformity of one camera."""
    shape = (camera.height_px, camera.width_px, len(camera.bands))
    return FixedPattern(
        prnu=rng.standard_normal(shape, dtype=np.float32) * np.float32(camera.prnu),
        dsnu_e=rng.standard_normal(shape, dtype=np.float32) * np.float32(camera.dsnu_e),
    )


def vignetting(camera: Camera) -> np.ndarray:
    """Relative illumination (h, w): 1 on the axis, 1 - `vignetting` at the farthest corner, quadratic in the radius."""
    x = (np.arange(camera.width_px) + 0.5 - camera.lens.cx_px) ** 2
    y = (np.arange(camera.height_px) + 0.5 - camera.lens.cy_px) ** 2
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
) -> np.ndarray:
    """One picture of the sensor.

    Parameters
    ----------
    radiance : (h, w, bands) ndarray
        [W m-2 sr-1 nm-1]
    camera_gain_fault : float
        Factor on the DN above black; 1 is no fault.
    rng_frame : numpy.random.Generator
        Of this frame's temporal noise.

    Returns
    -------
    (h, w, bands) uint16 ndarray
        DN, black level included.
    """
    dn = np.empty(radiance.shape, np.uint16)
    light = vignetting(camera)
    per_radiance = exposing.e_per_radiance.astype(np.float32)
    dark = np.float32(camera.dark_current_e_s * exposing.exposure_time_s)
    read_variance = np.float32(camera.read_noise_e**2)
    full_well = np.float32(camera.full_well_e)
    dn_per_e = np.float32(camera_gain_fault / exposing.e_per_dn)
    # + 0.5: the conversion to integers truncates.
    black = np.float32(camera.black_level_dn + 0.5)
    last = np.float32(2**camera.bit_depth - 1)
    for first in range(0, len(radiance), ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        mean = radiance[rows] * (light[rows, :, None] * per_radiance)
        mean *= 1 + pattern.prnu[rows]
        mean += dark
        np.maximum(mean, 0, out=mean)
        noise = rng_frame.standard_normal(mean.shape, dtype=np.float32)
        few = mean < POISSON_BELOW_E
        noise *= np.sqrt(mean + read_variance)
        electrons = mean + noise
        if few.any():
            low = mean[few]
            drawn = rng_frame.poisson(low) + camera.read_noise_e * rng_frame.standard_normal(len(low))
            electrons[few] = drawn.astype(np.float32)
        electrons += pattern.dsnu_e[rows]
        np.minimum(electrons, full_well, out=electrons)
        electrons *= dn_per_e
        electrons += black
        np.clip(electrons, 0, last, out=electrons)
        dn[rows] = electrons
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
    channels = []
    for band in order:
        linear = np.clip((steps - camera.black_level_dn) / (full_scale_dn(camera) * balance[band]), 0, 1)
        curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        channels.append(np.round(255 * curve).astype(np.uint8)[np.minimum(dn[..., band], len(steps) - 1)])
    while len(channels) < 3:
        channels.append(channels[-1])
    return np.stack(channels, axis=-1)
