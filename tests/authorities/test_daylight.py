"""Daylight against published figures."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pvlib
import pytest

from campaign.config import Environment, Site
from campaign.errors import ConfigError
from scenes.sunsky import V_LAMBDA, V_LAMBDA_NM, sun_sky


def test_integral_of_the_photopic_function():
    """Rationale: a typing error in the table of V would shift every illuminance.
    Expected: the sum of CIE 1924 V at 10 nm is 10.6857, its integral 106.857 nm (Wyszecki and Stiles, Color Science,
    table I(4.3.2): chromaticity sums of y-bar at 10 nm); peak at 555-560 nm.
    Tolerance: 1e-3, the table's last digits.
    """
    assert np.trapezoid(V_LAMBDA, V_LAMBDA_NM) == pytest.approx(106.857, abs=1e-2)
    assert V_LAMBDA_NM[np.argmax(V_LAMBDA)] == 560.0
    assert len(V_LAMBDA) == 41


def test_shanghai_june_noon():
    """Rationale: FACTS: SPECTRL2 times V at a Shanghai June noon is 118.8 klx.
    Expected: 118.8 klx. Tolerance: 2 %: the aerosol and water of that figure are not stated.
    """
    s = sun_sky(Site(), Environment(), datetime(2026, 6, 21, 4, 0, tzinfo=UTC))
    assert s.illuminance_lx == pytest.approx(118_800.0, rel=0.02)


@pytest.mark.parametrize(("elevation", "klx"), [(35.0, 63.0), (45.0, 81.0), (60.0, 102.0)])
def test_ies_clear_sky(elevation, klx):
    """Rationale: illuminance must follow the sun's height as a clear sky does (IES tables: 63, 81, 102 klx).
    Expected: those. Tolerance: 8 %: the tables are of a mean clear atmosphere, ours has its own haze and water.
    """
    start = datetime(2026, 6, 21, 22, 0, tzinfo=UTC)
    for minutes in range(0, 360, 2):
        s = None
        try:
            s = sun_sky(Site(), Environment(), start + timedelta(minutes=minutes))
        except ConfigError:
            continue
        if s.elevation_deg >= elevation:
            break
    assert s is not None
    assert s.elevation_deg == pytest.approx(elevation, abs=0.6)
    assert s.illuminance_lx == pytest.approx(1e3 * klx, rel=0.08)


def test_broadband_clear_sky_times_luminous_efficacy():
    """Rationale: an independent clear-sky model (Ineichen and Perez 2002, as in pvlib) bounds the spectrum's sum.
    Expected: illuminance over Ineichen's global irradiance is the efficacy of clear daylight, 95-125 lm/W
    (Littlefair, Lighting Res. Technol. 17, 162 (1985)), for sun heights from 35 to 80 degrees.
    Tolerance: the stated bounds.
    """
    for hour in (0.5, 1.5, 2.5, 4.0):
        s = sun_sky(Site(), Environment(), datetime(2026, 6, 12, tzinfo=UTC) + timedelta(hours=hour))
        zenith = 90.0 - s.elevation_deg
        airmass = pvlib.atmosphere.get_absolute_airmass(pvlib.atmosphere.get_relative_airmass(zenith), 101_000.0)
        sky = pvlib.clearsky.ineichen(zenith, airmass, 3.0, altitude=7.0, dni_extra=1325.0)
        assert 95.0 < s.illuminance_lx / float(sky["ghi"]) < 125.0
