"""Sun and clear sky at one instant: position, spectra, illuminance, and how radiance is spread over the sky.

Spectra are SPECTRL2's (direct and diffuse); the sky's pattern is that of the CIE standard clear sky, scaled in every
band to the diffuse irradiance. No cloud, no polarisation, no ground but a constant albedo.
"""

from datetime import UTC, datetime

import numpy as np
import pandas as pd
import pvlib  # type: ignore[import-untyped]

from campaign.config import Band, Environment, Site
from campaign.errors import ConfigError
from scenes.model import SunSky

GROUND_ALBEDO = 0.2
LUMINOUS_EFFICACY_LM_W = 683.002  # K_cd, BIPM SI brochure

# CIE 1924 photopic luminosity function V, 380-780 nm in steps of 10 nm (ISO/CIE 23539).
V_LAMBDA_NM = np.arange(380.0, 781.0, 10.0)
# fmt: off
V_LAMBDA = np.array([
    0.000039, 0.00012, 0.000396, 0.00121, 0.0040, 0.0116, 0.023, 0.038, 0.060, 0.09098, 0.13902, 0.20802, 0.323, 0.503,
    0.710, 0.862, 0.954, 0.99495, 0.995, 0.952, 0.870, 0.757, 0.631, 0.503, 0.381, 0.265, 0.175, 0.107, 0.061, 0.032,
    0.017, 0.00821, 0.004102, 0.002091, 0.001047, 0.00052, 0.000249, 0.00012, 0.00006, 0.00003, 0.000015,
])
# fmt: on

# CIE standard general sky, type 12 "CIE standard clear sky, low illuminance turbidity" (ISO 15469:2004, table 1).
SKY_A, SKY_B, SKY_C, SKY_D, SKY_E = -1.0, -0.32, 10.0, -3.0, 0.45


def illuminance_lx(wavelength_nm: np.ndarray, irradiance: np.ndarray) -> float:
    """Illuminance of a spectral irradiance.

    Parameters
    ----------
    wavelength_nm : (w,) array
        Increasing. [nm]
    irradiance : (w,) array
        [W m-2 nm-1]

    Returns
    -------
    float
        683.002 lm/W times the integral of E V over wavelength. [lx]
    """
    nm = np.arange(380.0, 781.0, 1.0)
    value = np.interp(nm, wavelength_nm, irradiance) * np.interp(nm, V_LAMBDA_NM, V_LAMBDA)
    return float(LUMINOUS_EFFICACY_LM_W * np.trapezoid(value, nm))


def sun_sky(site: Site, environment: Environment, utc: datetime) -> SunSky:
    """Sun and sky over a site at one instant.

    Parameters
    ----------
    utc : datetime
        With a time zone (any), or without one and then in UTC.

    Returns
    -------
    SunSky
        SPECTRL2 (R. E. Bird and C. Riordan, SERI/TR-215-2436, 1984) with the environment's pressure, ozone, water
        vapour and aerosol, 350-2000 nm. Sun direction with refraction.

    Raises
    ------
    ConfigError
        The sun is below the horizon, or so low (under 3 degrees) that the model's air mass means nothing.
    """
    instant = utc.replace(tzinfo=UTC) if utc.tzinfo is None else utc.astimezone(UTC)
    pressure_pa = 100.0 * environment.pressure_hpa
    position = pvlib.solarposition.get_solarposition(
        pd.DatetimeIndex([pd.Timestamp(instant)]),
        site.latitude_deg,
        site.longitude_deg,
        altitude=site.ellipsoid_height_m - site.height_anomaly_m,
        pressure=pressure_pa,
        temperature=environment.temperature_c,
    )
    elevation = float(position["apparent_elevation"].iloc[0])
    azimuth = float(position["azimuth"].iloc[0])
    if elevation < 3.0:
        raise ConfigError(
            "the sun is too low to fly a camera",
            where="campaign.start_time",
            got=f"sun elevation {elevation:.1f} deg at {instant.isoformat()}",
            expected="above 35 deg (7.2 c)",
            remedy="choose another time or check the UTC offset",
        )
    zenith = 90.0 - elevation
    spectra = pvlib.spectrum.spectrl2(
        apparent_zenith=zenith,
        aoi=zenith,
        surface_tilt=0.0,
        ground_albedo=GROUND_ALBEDO,
        surface_pressure=pressure_pa,
        relative_airmass=float(pvlib.atmosphere.get_relative_airmass(zenith, model="kasten1966")),
        precipitable_water=environment.precipitable_water_cm,
        ozone=environment.ozone_atm_cm,
        aerosol_turbidity_500nm=environment.aerosol_optical_depth_500nm,
        dayofyear=instant.timetuple().tm_yday,
    )
    wavelength = np.asarray(spectra["wavelength"], dtype=float).ravel()
    direct = np.asarray(spectra["dni"], dtype=float).ravel()
    diffuse = np.asarray(spectra["dhi"], dtype=float).ravel()
    keep = (wavelength >= 350.0) & (wavelength <= 2000.0) & np.isfinite(direct) & np.isfinite(diffuse)
    wavelength, direct, diffuse = wavelength[keep], direct[keep], diffuse[keep]
    el, az = np.radians(elevation), np.radians(azimuth)
    to_sun = np.array([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)])
    return SunSky(
        to_sun=to_sun,
        elevation_deg=elevation,
        azimuth_deg=azimuth,
        wavelength_nm=wavelength,
        direct_normal=direct,
        diffuse_horizontal=diffuse,
        illuminance_lx=illuminance_lx(wavelength, direct * np.sin(el) + diffuse),
    )


def band_irradiance(sunsky: SunSky, band: Band) -> tuple[float, float]:
    """Direct normal and diffuse horizontal irradiance, averaged over a band's Gaussian response. [W m-2 nm-1]"""
    sigma = band.fwhm_nm / np.sqrt(8.0 * np.log(2.0))
    nm = np.linspace(band.centre_nm - 3.0 * sigma, band.centre_nm + 3.0 * sigma, 601)
    response = np.exp(-0.5 * ((nm - band.centre_nm) / sigma) ** 2)
    response /= np.sum(response)
    return (
        float(np.sum(response * np.interp(nm, sunsky.wavelength_nm, sunsky.direct_normal))),
        float(np.sum(response * np.interp(nm, sunsky.wavelength_nm, sunsky.diffuse_horizontal))),
    )


def sky_radiance_relative(direction: np.ndarray, to_sun: np.ndarray) -> np.ndarray:
    r"""Relative radiance of the CIE standard clear sky.

    .. math:: L = \left[1 + a\,e^{b/\cos Z}\right]\left[1 + c\,(e^{d\chi} - e^{d\pi/2}) + e\cos^2\chi\right]

    Z the zenith angle, chi the angle from the sun.

    Parameters
    ----------
    direction : (..., 3) array
        Unit vectors towards the sky.
    to_sun : (3,) array
        Unit vector towards the sun.

    Returns
    -------
    (...) array
        0 at and below the horizon. Its scale is arbitrary: divide by `sky_normalisation`.

    References
    ----------
    ISO 15469:2004 (CIE S 011), type 12; R. Kittler and S. Darula, the standard's a-e.
    """
    direction = np.asarray(direction, dtype=float)
    cos_zenith = direction[..., 2]
    up = cos_zenith > 0.0
    gradation = 1.0 + SKY_A * np.exp(SKY_B / np.where(up, np.maximum(cos_zenith, 1e-3), 1.0))
    cos_chi = np.clip(direction @ np.asarray(to_sun, dtype=float), -1.0, 1.0)
    indicatrix = 1.0 + SKY_C * (np.exp(SKY_D * np.arccos(cos_chi)) - np.exp(SKY_D * np.pi / 2.0)) + SKY_E * cos_chi**2
    return np.where(up, gradation * indicatrix, 0.0)


def sky_normalisation(to_sun: np.ndarray) -> float:
    """Horizontal irradiance of the relative sky: integral of L cos(Z) over the hemisphere, good to 1e-4.

    Radiance of the sky in a band is diffuse_horizontal * sky_radiance_relative / sky_normalisation.
    """
    node, weight = np.polynomial.legendre.leggauss(180)
    cos_zenith, weight = 0.5 * (node + 1.0), 0.5 * weight
    azimuth = 2.0 * np.pi * (np.arange(720) + 0.5) / 720
    sine = np.sqrt(1.0 - cos_zenith**2)[:, None]
    grid = np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), cos_zenith[:, None])
    radiance = sky_radiance_relative(np.stack(grid, axis=-1), to_sun)
    return float(np.sum(weight * cos_zenith * np.sum(radiance, axis=1)) * 2.0 * np.pi / 720)
