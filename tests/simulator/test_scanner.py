"""Which pulses a turning scanner fires, when, and where they point."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from campaign.config import Lidar, Scanner
from campaign.errors import ConfigError
from simulator.lidar.scanner import scanner_from


def lidar(prr_hz: float = 300_000.0, **scanner: object) -> Lidar:
    return Lidar(prr_hz=prr_hz, scanner=Scanner(**scanner))


def test_line_scanner_keeps_what_brute_force_keeps() -> None:
    """Rationale: pulses in the sector are enumerated in closed form, so chunks can be made alone.
    Expected: the same times and angles as firing every pulse of the turn and keeping those inside the sector, but for the
    one pulse a line that a whole number per line leaves out.
    Tolerance: 1e-12 s and 1e-9 rad, rounding of the line number times the period.
    """
    device = lidar(scan_rate_hz=100.0, sector_deg=(-35.0, 35.0))
    scanner = scanner_from(device)
    fired = np.arange(300_000 // 2)
    time = fired / 300_000.0
    angle = -180.0 + 360.0 * np.modf(time * 100.0)[0]
    inside = (angle >= -35.0 - 1e-7) & (angle < 35.0)
    pulses = scanner.pulses(np.arange(scanner.pulse_count(0.5)))
    expected = time[inside]
    per_line = int(np.floor(70.0 / 360.0 * 3000.0))
    assert scanner.pulse_count(0.5) == 50 * per_line
    kept = np.isin(np.round(expected * 300_000).astype(int), np.round(pulses.time_s * 300_000).astype(int))
    assert kept.mean() > 1.0 - 1.5 / per_line
    assert np.abs(np.degrees(pulses.encoder_angle_rad) - np.interp(pulses.time_s, time, angle)).max() < 1e-6
    assert np.all(np.diff(pulses.time_s) > 0.0)


def test_beams_point_right_of_nadir_for_positive_angles() -> None:
    """Rationale: (0, sin, cos) in FRD, y to the right, z down. Expected: +30 degrees gives y = 1/2. Tolerance: rounding."""
    scanner = scanner_from(lidar())
    direction = scanner.direction(np.radians([30.0, 0.0]), np.zeros(2, np.uint8))
    assert np.allclose(direction, [[0.0, 0.5, np.sqrt(0.75)], [0.0, 0.0, 1.0]], atol=1e-15)


def test_channels_fire_in_turn_and_tilt_along_track() -> None:
    """Rationale: a spinning fan. Expected: channel i mod C of the firing sequence; x = sin(elevation) whatever the azimuth,
    and C times the pulse interval before a channel's next pulse. Tolerance: rounding."""
    tilt = (-15.0, -1.0, 5.0)
    scanner = scanner_from(lidar(type="channels", scan_rate_hz=10.0, channel_elevations_deg=tilt))
    pulses = scanner.pulses(np.arange(3000))
    fired = np.round(pulses.time_s * 300_000).astype(int)
    assert np.array_equal(pulses.channel, fired % 3)
    assert np.allclose(pulses.direction_lidar[:, 0], np.sin(np.radians(np.array(tilt)[pulses.channel])), atol=1e-15)
    assert np.allclose(np.linalg.norm(pulses.direction_lidar, axis=1), 1.0, atol=1e-15)
    assert scanner.pulse_interval_s == pytest.approx(3 / 300_000)


@settings(max_examples=60, deadline=None)
@given(
    prr=st.floats(3e4, 2e6),
    rate=st.floats(5.0, 400.0),
    edges=st.tuples(st.floats(-170.0, -5.0), st.floats(5.0, 170.0)),
    duration=st.floats(0.0, 0.3),
)
def test_count_and_enumeration_agree(prr: float, rate: float, edges: tuple[float, float], duration: float) -> None:
    """Rationale: the strip's loop trusts `pulse_count`. Expected: the last counted pulse lies before the end, the next one does
    not; every angle lies in the sector; time grows by at least one pulse interval. Tolerance: 1e-6 of a pulse interval."""
    scanner = scanner_from(lidar(prr, scan_rate_hz=rate, sector_deg=edges))
    count = scanner.pulse_count(duration)
    pulses = scanner.pulses(np.arange(count + 1))
    slack = 1e-5 / prr
    assert pulses.time_s[count] >= duration - slack
    if count:
        assert pulses.time_s[count - 1] < duration + slack
    assert np.all(np.diff(pulses.time_s) >= 1.0 / prr - slack)
    step = 2.0 * np.pi * rate / prr
    inside = (pulses.encoder_angle_rad >= np.radians(edges[0]) - 1e-5 * step - 1e-9) & (
        pulses.encoder_angle_rad <= np.radians(edges[1]) + 1e-5 * step + 1e-9
    )
    assert inside.all()


def test_a_chunk_alone_equals_its_part_of_the_whole() -> None:
    """Rationale: no state between chunks. Expected: bit-exact."""
    scanner = scanner_from(lidar(123_457.0, scan_rate_hz=77.3))
    whole, part = scanner.pulses(np.arange(5000)), scanner.pulses(np.arange(3000, 4000))
    assert np.array_equal(whole.time_s[3000:4000], part.time_s)
    assert np.array_equal(whole.encoder_angle_rad[3000:4000], part.encoder_angle_rad)


@pytest.mark.parametrize(
    ("scanner", "key"),
    [
        ({"sector_deg": (35.0, -35.0)}, "sector_deg"),
        ({"sector_deg": (-60.0, 60.0), "turn_share": 0.25}, "sector_deg"),
        ({"type": "channels"}, "channel_elevations_deg"),
        ({"type": "line", "channel_elevations_deg": (1.0,)}, "channel_elevations_deg"),
        ({"scan_rate_hz": 4e5, "sector_deg": (-1.0, 1.0)}, "prr_hz"),
    ],
)
def test_impossible_scanners_are_refused_by_name(scanner: dict[str, object], key: str) -> None:
    """Rationale: bad input is one line that names the setting. Expected: ConfigError with the key."""
    with pytest.raises(ConfigError, match=key):
        scanner_from(lidar(**scanner))
