"""Materials of the range and their spectra from 400 to 1700 nm, and the averages that a sensor's band takes of them.

Spectra are smooth curves through a few anchor values that reproduce the published *shape* of each material; they are
no measurement of one sample. Sources of the levels and features:

* PTFE: 0.99 and flat from 400 to 1700 nm, a faint dip near 1390 nm. V. R. Weidner and J. J. Hsia, J. Opt. Soc. Am. 71, 856
  (1981); Labsphere, A Guide to Reflectance Coatings and Materials.
* Barium sulfate paint: luminous reflectance 0.992 fresh, 0.97-0.98 as a field coating, falling beyond 1000 nm, with
  water's overtone at 1450 nm. F. Grum and G. W. Luckey, Appl. Opt. 7, 2289 (1968); the same guide.
* Water-based paint: a barium sulfate pigment in a water-borne binder (no TiO2, whose edge at 400-420 nm would spoil
  the flatness), 0.95, with C-H and O-H overtones near 1200, 1440 and 1690 nm.
* Dry grass, soil, asphalt, concrete: typical curves of the ECOSTRESS spectral library, S. K. Meerdink et al.,
  Remote Sens. Environ. 230, 111196 (2019).

Opposition: a ray back to its source meets no shadow, so every diffuse surface is brighter there, grounds more than coatings.
"""

from dataclasses import replace
from difflib import get_close_matches

import numpy as np
from scipy.interpolate import PchipInterpolator

from campaign.config import Site
from campaign.errors import ConfigError
from scenes.model import Material

WAVELENGTH_NM = np.arange(400.0, 1701.0, 5.0)
_FWHM_PER_SIGMA = np.sqrt(8.0 * np.log(2.0))
_EFFECTIVE_HALF = np.sqrt(np.log(10.0) / np.log(2.0)) / 2.0  # half width at a tenth of the peak, over the FWHM

# name -> (wavelengths [nm], reflectance, (centre [nm], sigma [nm], relative depth) of dips, opposition gain, width [rad])
_Dips = tuple[tuple[float, float, float], ...]
_TABLE: dict[str, tuple[tuple[float, ...], tuple[float, ...], _Dips, float, float]] = {
    "ptfe": (
        (400, 600, 1000, 1300, 1500, 1700),
        (0.988, 0.991, 0.992, 0.991, 0.989, 0.986),
        ((1390, 18, 0.003), (1450, 30, 0.002)),
        0.03,
        0.05,
    ),
    "barium_sulfate": (
        (400, 450, 600, 900, 1200, 1350, 1550, 1700),
        (0.968, 0.975, 0.979, 0.977, 0.969, 0.962, 0.953, 0.948),
        ((1450, 35, 0.010),),
        0.04,
        0.05,
    ),
    "water_based_paint": (
        (400, 430, 500, 700, 1000, 1300, 1550, 1700),
        (0.942, 0.950, 0.954, 0.955, 0.952, 0.946, 0.937, 0.930),
        ((1200, 20, 0.003), (1440, 35, 0.010), (1690, 25, 0.006)),
        0.04,
        0.05,
    ),
    "dry_grass": (
        (400, 500, 600, 680, 750, 900, 1100, 1300, 1550, 1700),
        (0.075, 0.115, 0.165, 0.195, 0.255, 0.320, 0.370, 0.390, 0.370, 0.345),
        ((1200, 35, 0.03), (1455, 55, 0.16)),
        0.20,
        0.10,
    ),
    "bare_soil": (
        (400, 500, 600, 700, 900, 1100, 1300, 1550, 1700),
        (0.070, 0.110, 0.170, 0.210, 0.265, 0.310, 0.340, 0.370, 0.380),
        ((1415, 25, 0.05), (1460, 50, 0.04)),
        0.20,
        0.10,
    ),
    "asphalt": (
        (400, 600, 900, 1300, 1700),
        (0.080, 0.105, 0.125, 0.145, 0.160),
        (),
        0.12,
        0.08,
    ),
    "concrete": (
        (400, 500, 700, 1000, 1300, 1700),
        (0.200, 0.260, 0.315, 0.345, 0.365, 0.370),
        ((1415, 25, 0.02), (1460, 50, 0.03)),
        0.12,
        0.08,
    ),
    "black_paint": ((400, 700, 1100, 1700), (0.040, 0.041, 0.043, 0.047), (), 0.05, 0.05),
    "grey_paint": ((400, 700, 1100, 1700), (0.300, 0.302, 0.300, 0.294), ((1450, 40, 0.006),), 0.05, 0.05),
    "metal_stand": ((400, 700, 850, 1000, 1700), (0.300, 0.320, 0.310, 0.330, 0.360), (), 0.03, 0.05),
}

WHITE_STANDARDS = ("barium_sulfate", "ptfe", "water_based_paint")
WHITEST = 0.995  # no panel reflects more, whatever its draw


def material_names() -> tuple[str, ...]:
    """Names that `material` knows."""
    return tuple(_TABLE)


def material(name: str) -> Material:
    """A material of the range by name.

    Raises
    ------
    ConfigError
        Unknown name; the nearest known one is named.
    """
    if name not in _TABLE:
        near = get_close_matches(name, _TABLE, n=1)
        raise ConfigError(
            "unknown material",
            got=repr(name),
            expected="one of " + ", ".join(_TABLE),
            remedy=f"did you mean {near[0]}?" if near else None,
        )
    anchor_nm, anchor, dips, gain, width = _TABLE[name]
    reflectance = PchipInterpolator(anchor_nm, anchor)(WAVELENGTH_NM)
    for centre, sigma, depth in dips:
        reflectance = reflectance * (1.0 - depth * np.exp(-0.5 * ((WAVELENGTH_NM - centre) / sigma) ** 2))
    return Material(
        name=name,
        wavelength_nm=WAVELENGTH_NM.copy(),
        reflectance=reflectance,
        opposition_gain=gain,
        opposition_width_rad=width,
    )


def ground_material(site: Site) -> Material:
    """The site's ground, without texture.

    Raises
    ------
    ConfigError
        Unknown name.
    """
    try:
        return material(site.ground_material)
    except ConfigError as error:
        raise ConfigError(error.what, where="site.ground_material", got=repr(site.ground_material)) from error


def panel_material(level_percent: float, base_material: str, rng: np.random.Generator, spread: float) -> Material:
    """One grey or white panel: the white standard darkened with carbon black, with the scatter of manufacture.

    Parameters
    ----------
    level_percent : float
        Nominal level. 100 stands for the undarkened standard, which reflects a few percent less. [%]
    base_material : str
        One of WHITE_STANDARDS.
    rng : numpy.random.Generator
        Draws two numbers whatever the level, so that one panel's draw does not shift another's.
    spread : float
        Relative standard deviation of the level from panel to panel.

    Returns
    -------
    Material
        Darker panels keep less of the standard's own features (carbon black has none) and tilt more: up to 4 % over
        the 1300 nm at 5 %. In any band of 150 nm or less that is far below the 5 % of 6.2.2 b.

    Raises
    ------
    ConfigError
        A level that is not above 0 and at most 100.
    """
    if not 0.0 < level_percent <= 100.0:
        raise ConfigError(
            "no such reflectance level",
            where="targets.panels.nominal_reflectance_percent",
            got=f"{level_percent:g}",
            expected="above 0 and at most 100 %",
        )
    white = material(base_material)
    level = level_percent / 100.0
    offset, tilt = rng.standard_normal(), rng.uniform(-1.0, 1.0)
    shape = (white.reflectance / np.mean(white.reflectance)) ** np.sqrt(level)
    slope = 1.0 + 0.02 * (1.0 - level) * tilt * (WAVELENGTH_NM - 1050.0) / 650.0
    if level >= 1.0:
        mean = np.mean(white.reflectance) * (1.0 - 0.25 * spread * abs(offset))
    else:
        mean = level * (1.0 + spread * offset)
    return replace(
        white,
        name=f"{base_material}_{level_percent:g}",
        reflectance=np.clip(mean * shape * slope, 0.0, WHITEST),
    )


def reflectance_at(material: Material, nm: float) -> float:
    """Reflectance at one wavelength (a laser line), linear between samples."""
    return float(np.interp(nm, material.wavelength_nm, material.reflectance))


def band_reflectance(material: Material, centre_nm: float, fwhm_nm: float) -> float:
    """Average over a Gaussian response, cut at +-3 sigma and at the spectrum's ends.

    Parameters
    ----------
    centre_nm, fwhm_nm : float
        Of the response. [nm]

    Returns
    -------
    float
        sum(R S) / sum(S), illumination taken as constant over the band.
    """
    sigma = fwhm_nm / _FWHM_PER_SIGMA
    nm = np.linspace(centre_nm - 3.0 * sigma, centre_nm + 3.0 * sigma, 601)
    nm = nm[(nm >= material.wavelength_nm[0]) & (nm <= material.wavelength_nm[-1])]
    response = np.exp(-0.5 * ((nm - centre_nm) / sigma) ** 2)
    return float(np.sum(np.interp(nm, material.wavelength_nm, material.reflectance) * response) / np.sum(response))


def spectral_flatness(material: Material, centre_nm: float, fwhm_nm: float) -> float:
    """Flatness (3.17) over a band's effective range: (max - min) / mean where the response is at least a tenth of its peak.

    Parameters
    ----------
    centre_nm, fwhm_nm : float
        Of a Gaussian response; for a laser the line and its receiver's filter. [nm]

    Returns
    -------
    float
        Relative, 0 = flat. 6.2.2 b asks for better than 0.05.
    """
    half = _EFFECTIVE_HALF * fwhm_nm
    nm = np.linspace(centre_nm - half, centre_nm + half, 301)
    nm = nm[(nm >= material.wavelength_nm[0]) & (nm <= material.wavelength_nm[-1])]
    value = np.interp(nm, material.wavelength_nm, material.reflectance)
    return float((np.max(value) - np.min(value)) / np.mean(value))
