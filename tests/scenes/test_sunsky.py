"""Sun and sky: normalisation, pattern, position, and refusal of the night."""

from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.integrate import dblquad

from campaign.config import Band, Environment, Site
from campaign.errors import ConfigError
from scenes.sunsky import band_irradiance, illuminance_lx, sky_normalisation, sky_radiance_relative, sun_sky


def direction(elevation_deg, azimuth_deg):
    e, a = np.radians([elevation_deg, azimuth_deg])
    return np.array([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)])


@pytest.mark.parametrize("elevation", [35.0, 60.0, 88.0])
def test_sky_normalisation_integrates_to_the_diffuse_irradiance(elevation):
    """Rationale: the sky's pattern is scaled to the diffuse irradiance, so its integral must be that.
    Expected: an adaptive quadrature of L cos(Z) over the hemisphere equals sky_normalisation.
    Tolerance: 1e-3; the two schemes share nothing but L.
    """
    to_sun = direction(elevation, 117.0)

    def integrand(phi, cos_zenith):
        s = np.sqrt(1.0 - cos_zenith**2)
        ray = np.array([s * np.sin(phi), s * np.cos(phi), cos_zenith])
        return float(sky_radiance_relative(ray, to_sun)) * cos_zenith

    # splitting at the sun's azimuth and height keeps its cusp on borders
    phi = np.radians(117.0)
    z = to_sun[2]
    total = sum(
        dblquad(integrand, low, high, phi + k * np.pi, phi + (k + 1) * np.pi, epsabs=1e-4, epsrel=1e-4)[0]
        for low, high in ((0.0, z), (z, 1.0))
        for k in (-1, 0)
    )
    assert sky_normalisation(to_sun) == pytest.approx(total, rel=1e-3)


def test_sky_pattern_against_the_formula_by_hand():
    """Rationale: a wrong coefficient would still integrate to one.
    Expected: sun and view at the zenith: (1 - e^-0.32)(1 + 10(1 - e^(-3 pi/2)) + 0.45); view 90 degrees from a sun on
    the horizon, at the zenith: (1 - e^-0.32) * 1; dark below the horizon; symmetric about the sun's vertical plane.
    Tolerance: 1e-12.
    """
    up = np.array([0.0, 0.0, 1.0])
    phi0 = 1.0 - np.exp(-0.32)
    by_hand = phi0 * (1.0 + 10.0 * (1.0 - np.exp(-1.5 * np.pi)) + 0.45)
    assert float(sky_radiance_relative(up, up)) == pytest.approx(by_hand, rel=1e-12)
    assert float(sky_radiance_relative(up, np.array([1.0, 0.0, 0.0]))) == pytest.approx(phi0, rel=1e-12)
    assert float(sky_radiance_relative(np.array([0.6, 0.0, -0.8]), up)) == 0.0
    sun = direction(50.0, 0.0)
    left, right = direction(30.0, -40.0), direction(30.0, 40.0)
    both = sky_radiance_relative(np.stack([left, right]), sun)
    assert both[0] == pytest.approx(both[1], rel=1e-12)
    assert float(sky_radiance_relative(direction(50.0, 5.0), sun)) > 5 * float(
        sky_radiance_relative(direction(50.0, 150.0), sun)
    )


def test_sun_stands_where_the_almanac_says():
    """Rationale: azimuth and elevation conventions. Expected: at the site's solar noon of the June solstice the
    elevation is 90 - latitude + 23.44 degrees, the azimuth 180; to_sun points south and up.
    Tolerance: 0.1 degree (refraction, equation of time to a minute).
    """
    site = Site()
    # solar noon = 12:00 UTC - longitude * 4 min + 1.8 min (equation of time on 21 June)
    minutes = 12 * 60 - site.longitude_deg * 4.0 + 1.8
    utc = datetime(2026, 6, 21, int(minutes // 60), int(minutes % 60), int(minutes * 60 % 60), tzinfo=UTC)
    s = sun_sky(site, Environment(), utc)
    assert s.elevation_deg == pytest.approx(90.0 - site.latitude_deg + 23.44, abs=0.1)
    assert s.azimuth_deg == pytest.approx(180.0, abs=1.0)
    np.testing.assert_allclose(s.to_sun, direction(s.elevation_deg, s.azimuth_deg), atol=1e-12)
    assert np.linalg.norm(s.to_sun) == pytest.approx(1.0, abs=1e-12)


def test_time_zone_is_honoured():
    """Rationale: Beijing time in documents, UTC inside. Expected: 10:30+08:00 is 02:30 UTC. Tolerance: exact."""
    a = sun_sky(Site(), Environment(), datetime.fromisoformat("2026-06-12T10:30:00+08:00"))
    b = sun_sky(Site(), Environment(), datetime(2026, 6, 12, 2, 30))
    assert a.elevation_deg == b.elevation_deg
    assert a.illuminance_lx == b.illuminance_lx
    assert 65.0 < a.elevation_deg < 73.0


def test_band_irradiance_is_the_spectrum_where_it_is_smooth():
    """Rationale: a band's average feeds the renderer. Expected: a narrow band gives the spectrum's own value; a wide
    one lies between its extremes there; haze moves light from the sun to the sky.
    Tolerance: 1 % for a 5 nm band on samples of 5-10 nm.
    """
    utc = datetime(2026, 6, 12, 2, 30, tzinfo=UTC)
    s = sun_sky(Site(), Environment(), utc)
    direct, diffuse = band_irradiance(s, Band(name="g", centre_nm=550.0, fwhm_nm=5.0))
    assert direct == pytest.approx(np.interp(550.0, s.wavelength_nm, s.direct_normal), rel=0.01)
    assert diffuse == pytest.approx(np.interp(550.0, s.wavelength_nm, s.diffuse_horizontal), rel=0.01)
    hazy = sun_sky(Site(), Environment(aerosol_optical_depth_500nm=0.4), utc)
    direct_haze, diffuse_haze = band_irradiance(hazy, Band(name="g", centre_nm=550.0, fwhm_nm=75.0))
    assert direct_haze < 0.9 * direct
    assert diffuse_haze > 1.3 * diffuse
    assert np.all(np.isfinite(s.direct_normal))
    assert np.all(np.isfinite(s.diffuse_horizontal))
    assert s.wavelength_nm[0] <= 350.0
    assert s.wavelength_nm[-1] >= 1700.0


def test_illuminance_of_a_monochromatic_line():
    """Rationale: 683 lm/W at 555 nm defines the lumen. Expected: 1 W/m2 within 550-560 nm gives 683 lx.
    Tolerance: 0.8 %: V of the 10 nm table is 0.995 on both sides of its peak.
    """
    nm, line = np.array([300.0, 550.0, 555.0, 560.0, 800.0]), np.array([0.0, 0.0, 0.2, 0.0, 0.0])
    assert illuminance_lx(nm, line) == pytest.approx(683.0, rel=0.008)


def test_night_is_refused():
    """Rationale: no light, no picture. Expected: ConfigError that names start_time. Tolerance: none."""
    with pytest.raises(ConfigError, match=r"start_time.*sun elevation -"):
        sun_sky(Site(), Environment(), datetime(2026, 6, 12, 16, 0, tzinfo=UTC))
