"""Materials: levels and flatness of 6.2.2 a-b, and the averages over a band."""

from dataclasses import replace

import numpy as np
import pytest

from campaign.errors import ConfigError
from scenes.spectra import (
    WHITE_STANDARDS,
    band_reflectance,
    material,
    material_names,
    panel_material,
    reflectance_at,
    spectral_flatness,
)

BANDS = [(465.0, 70.0), (540.0, 75.0), (620.0, 70.0), (735.0, 40.0), (850.0, 60.0)]
LASERS = [532.0, 905.0, 1064.0, 1550.0]


@pytest.mark.parametrize("name", material_names())
def test_every_material_covers_the_range(name):
    """Rationale: camera bands and laser lines from 400 to 1700 nm are looked up without extrapolation.
    Expected: increasing wavelengths from 400 to 1700 nm, reflectance inside 0..1. Tolerance: none.
    """
    m = material(name)
    assert m.wavelength_nm[0] == 400.0
    assert m.wavelength_nm[-1] == 1700.0
    assert np.all(np.diff(m.wavelength_nm) > 0)
    assert np.all((m.reflectance > 0.0) & (m.reflectance < 1.0))


@pytest.mark.parametrize("base", WHITE_STANDARDS)
@pytest.mark.parametrize("level", [5.0, 20.0, 40.0, 60.0, 100.0])
def test_panels_are_flat_and_at_their_level(base, level):
    """Rationale: 6.2.2 b asks for flatness better than 5 % in each response band; 8.1.2 for known levels.
    Expected: flatness below 5 % in camera bands and 30 nm about the usual laser lines, for 50 draws; mean level within
    1 % (spread off) of nominal, a 100 % panel between 93 and 99.5 %.
    Tolerance: 5 % is the clause's; at 5 % reflectance the tilt of up to 2 % to either end adds to the 1 %.
    """
    rng = np.random.default_rng(3)
    for _ in range(50):
        m = panel_material(level, base, rng, 0.01)
        for centre, fwhm in [*BANDS, *((line, 30.0) for line in LASERS)]:
            assert spectral_flatness(m, centre, fwhm) < 0.05
        assert m.reflectance.max() <= 0.995
    exact = panel_material(level, base, rng, 0.0)
    mean = np.mean(exact.reflectance)
    if level == 100.0:
        assert 0.93 < mean < 0.995
    else:
        assert mean == pytest.approx(level / 100.0, rel=0.01)


def test_a_100_percent_ptfe_panel_reflects_98_to_99_percent():
    """Rationale: Spectralon-like standards are the default panels. Expected: 0.98-0.995 in every band and at 1550 nm.
    Tolerance: makers' grade of 99 % less handling.
    """
    rng = np.random.default_rng(4)
    for _ in range(20):
        m = panel_material(100.0, "ptfe", rng, 0.01)
        assert all(0.98 < band_reflectance(m, *band) <= 0.995 for band in BANDS)
        assert 0.975 < reflectance_at(m, 1550.0) <= 0.995


def test_level_spread_is_the_stated_one():
    """Rationale: `spectrum_std` is the relative spread from panel to panel.
    Expected: standard deviation 0.02 of 2000 levels. Tolerance: 5 sigma of a standard deviation, 5 * 0.02 / sqrt(4000).
    """
    rng = np.random.default_rng(5)
    level = np.array([np.mean(panel_material(40.0, "ptfe", rng, 0.02).reflectance) / 0.4 for _ in range(2000)])
    assert abs(level.std() - 0.02) < 5 * 0.02 / np.sqrt(4000.0)


def test_band_reflectance_of_a_line_and_of_a_parabola():
    """Rationale: closed forms of a Gaussian average. Expected: a linear spectrum gives its value at the centre, a
    parabola c (x - centre)^2 gives c sigma^2. Tolerance: 1 % of the parabola's, for the cut at 3 sigma (which takes
    2.7 % of the variance off) see the factor; 1e-6 for 5 nm samples of the line.
    """
    base = material("ptfe")
    x = base.wavelength_nm
    line = replace(base, reflectance=0.1 + 2e-4 * (x - 400.0))
    assert band_reflectance(line, 700.0, 80.0) == pytest.approx(0.16, abs=1e-6)
    sigma = 80.0 / 2.3548200
    parabola = replace(base, reflectance=1e-6 * (x - 700.0) ** 2)
    cut = 1.0 - 2.0 * 3.0 * np.exp(-4.5) / np.sqrt(2.0 * np.pi) / 0.9973002  # variance of a normal cut at 3 sigma
    assert band_reflectance(parabola, 700.0, 80.0) == pytest.approx(1e-6 * sigma**2 * cut, rel=0.01)


def test_flatness_of_a_known_slope():
    """Rationale: (3.17) is (max - min)/mean over the band's effective range, where the response is above a tenth.
    Expected: for R = s x that is width / centre with width = FWHM sqrt(ln 10 / ln 2). Tolerance: 1e-6, samples of 5 nm
    are exact on a line.
    """
    base = material("ptfe")
    sloped = replace(base, reflectance=5e-4 * base.wavelength_nm)
    expected = 60.0 * np.sqrt(np.log(10.0) / np.log(2.0)) / 600.0
    assert spectral_flatness(sloped, 600.0, 60.0) == pytest.approx(expected, rel=1e-6)
    assert spectral_flatness(replace(base, reflectance=np.full_like(base.reflectance, 0.3)), 600.0, 60.0) == 0.0
    assert spectral_flatness(material("dry_grass"), 620.0, 70.0) > 0.05  # the control: grass would not pass


def test_barium_sulfate_has_its_water_dip_and_falls_into_the_infrared():
    """Rationale: lasers at 1550 nm meet a darker standard than cameras do.
    Expected: local minimum at 1450 nm, and less at 1550 than at 600 nm by 1 to 5 %. Tolerance: the range of published
    coatings.
    """
    m = material("barium_sulfate")
    assert reflectance_at(m, 1450.0) < min(reflectance_at(m, 1350.0), reflectance_at(m, 1520.0))
    assert 0.01 < 1.0 - reflectance_at(m, 1550.0) / reflectance_at(m, 600.0) < 0.05


def test_bad_names_and_levels_are_one_clear_line():
    """Rationale: both come from a configuration. Expected: ConfigError that names the nearest material; levels outside
    0..100 refused. Tolerance: none.
    """
    with pytest.raises(ConfigError, match="did you mean dry_grass"):
        material("dry_gras")
    for level in (0.0, -5.0, 120.0):
        with pytest.raises(ConfigError, match="nominal_reflectance_percent"):
            panel_material(level, "ptfe", np.random.default_rng(0), 0.01)
