"""The flown motion keeps the limits of 7.3 and 7.4 and passes where it was planned."""

from dataclasses import replace

import numpy as np
import pytest

from campaign.config import Config
from campaign.errors import ConfigError
from campaign.load import load_config
from scenes.model import Layout
from simulator.flight.motion import Motion
from simulator.flight.plan import exposure_offsets_m, fly, speeds_m_s

LAYOUT = Layout(camera_half_m=(23.0, 15.4), lidar_half_m=31.0, cone_half_m=45.0, field_half_m=(13.0, 12.0))


@pytest.fixture(scope="module")
def config() -> Config:
    return load_config("quickstart")


def _during(motion: Motion, start: float, end: float) -> np.ndarray:
    return (motion.gps_time_s >= start) & (motion.gps_time_s <= end)


def test_limits_of_7_3_and_7_4_hold_on_every_strip(config: Config) -> None:
    """Rationale: 7.3 (16 m/s, 2.5 m/s2 along strips) and 7.4 (5 m, 5 % of height) bind the simulated pilot too.

    Expected: speed within 10 % of the plan's, acceleration under 2.5 m/s2 everywhere, height within 5 %.
    Tolerance: 10 % of speed is five times the wander's own rate (0.1 m with periods above 7 s: 0.09 m/s of 5 m/s).
    """
    for sortie, height in zip(fly(config, LAYOUT), config.flight.heights_m, strict=True):
        motion = sortie.motion
        acceleration = np.gradient(motion.velocity_world_m_s, motion.gps_time_s, axis=0)
        assert np.linalg.norm(acceleration, axis=1).max() <= config.platform.max_acceleration_m_s2
        for strip in sortie.strips:
            on = _during(motion, strip.start_s, strip.end_s)
            speed = np.linalg.norm(motion.velocity_world_m_s[on, :2], axis=1)
            assert np.abs(speed / config.flight.speed_m_s - 1.0).max() < 0.10
            assert np.abs(motion.position_world_m[on, 2] / height - 1.0).max() < 0.05


def test_one_exposure_of_each_strip_looks_at_the_centre(config: Config) -> None:
    """Rationale: 6.2.3 b wants every target in one image, so each strip has one exposure whose nadir ray, at the body's mean
    lean, falls on the range's centre.

    Tolerance: on the ground, four standard deviations of attitude (0.6 degrees on two axes) and track.
    """
    platform = config.platform
    for sortie, height in zip(fly(config, LAYOUT), config.flight.heights_m, strict=True):
        sigma = np.hypot(height * np.radians(platform.pitch_std_deg), platform.track_std_m)
        for strip in sortie.strips:
            times = np.array(strip.exposure_s)
            down = sortie.motion.world_from_body(times)[:, :, 2]
            place = sortie.motion.position(times)
            ground = place[:, :2] - down[:, :2] * (place[:, 2:] / down[:, 2:])
            along = np.array([np.sin(np.radians(strip.heading_deg)), np.cos(np.radians(strip.heading_deg))])
            assert np.abs(ground @ along).min() < 4.0 * sigma


def test_velocity_is_the_derivative_of_position(config: Config) -> None:
    """Tolerance: central differences at 200 Hz of accelerations that change within 1 m/s3: 1e-4 m/s; ten times that."""
    motion = fly(config, LAYOUT)[0].motion
    numeric = np.gradient(motion.position_world_m, motion.gps_time_s, axis=0)
    assert np.abs(numeric - motion.velocity_world_m_s)[2:-2].max() < 1e-3


def test_headings_are_flown_as_planned(config: Config) -> None:
    """Tolerance: four standard deviations of the heading's sway."""
    for sortie in fly(config, LAYOUT):
        for strip in sortie.strips:
            on = _during(sortie.motion, strip.start_s, strip.end_s)
            off = np.degrees(sortie.motion.rpy_rad[on, 2]) - strip.heading_deg
            assert np.abs((off + 180.0) % 360.0 - 180.0).max() < 4.0 * config.platform.heading_std_deg


def test_same_seed_same_flight_and_another_seed_another(config: Config) -> None:
    first, again = fly(config, LAYOUT), fly(config, LAYOUT)
    other = fly(config.model_copy(update={"seed": 2}), LAYOUT)
    assert np.array_equal(first[0].motion.rpy_rad, again[0].motion.rpy_rad)
    assert not np.array_equal(first[0].motion.rpy_rad, other[0].motion.rpy_rad)


def test_exposures_alternate_about_the_centre() -> None:
    assert exposure_offsets_m(1, 5.0) == [0.0]
    assert exposure_offsets_m(2, 5.0) == [0.0, 5.0]
    assert exposure_offsets_m(5, 2.0) == [-4.0, -2.0, 0.0, 2.0, 4.0]


def test_a_larger_field_gives_longer_strips(config: Config) -> None:
    """Strip length = field along the heading plus the run-in at both ends, at the planned speed."""
    wide = replace(LAYOUT, field_half_m=(20.0, 12.0))
    strip = fly(config, wide)[0].strips[2]
    assert strip.heading_deg == 90.0
    assert (strip.end_s - strip.start_s) * config.flight.speed_m_s == pytest.approx(2 * (20.0 + 4.0), rel=1e-6)


def test_each_height_has_its_own_speed(config: Config) -> None:
    """Rationale: two speeds tell a clock from a lever arm. Expected: each sortie at its speed, its exposures where the one
    speed has them (the same place to the lean's difference), and the plan's rows say so.

    Tolerance: 10 % of speed as above; the centre exposure within four standard deviations of attitude and track.
    """
    two = config.model_copy(
        update={"flight": config.flight.model_copy(update={"speeds_m_s": (3.0, 9.0), "heights_m": (45.0, 65.0)})}
    )
    assert speeds_m_s(two) == (3.0, 9.0)
    assert speeds_m_s(config) == (config.flight.speed_m_s,) * 2
    for sortie, speed, height in zip(fly(two, LAYOUT), (3.0, 9.0), (45.0, 65.0), strict=True):
        motion = sortie.motion
        acceleration = np.gradient(motion.velocity_world_m_s, motion.gps_time_s, axis=0)
        assert np.linalg.norm(acceleration, axis=1).max() <= config.platform.max_acceleration_m_s2
        sigma = np.hypot(height * np.radians(config.platform.pitch_std_deg), config.platform.track_std_m)
        for strip in sortie.strips:
            on = _during(motion, strip.start_s, strip.end_s)
            assert np.abs(np.linalg.norm(motion.velocity_world_m_s[on, :2], axis=1) / speed - 1.0).max() < 0.10
            assert (strip.end_s - strip.start_s) * speed == pytest.approx(
                2 * (LAYOUT.field_half_m[0 if strip.heading_deg in (90.0, 270.0) else 1] + two.flight.run_in_m)
            )
            times = np.array(strip.exposure_s)
            assert np.diff(times) * speed == pytest.approx(two.flight.image_spacing_m, abs=1e-6)
            down = motion.world_from_body(times)[:, :, 2]
            place = motion.position(times)
            ground = place[:, :2] - down[:, :2] * (place[:, 2:] / down[:, 2:])
            along = np.array([np.sin(np.radians(strip.heading_deg)), np.cos(np.radians(strip.heading_deg))])
            assert np.abs(ground @ along).min() < 4.0 * sigma


def test_speeds_and_heights_go_together(config: Config) -> None:
    """Expected: one line that says how many."""
    flight = config.flight.model_copy(update={"speeds_m_s": (3.0, 5.0, 7.0)})
    with pytest.raises(ConfigError, match=r"flight\.speeds_m_s: one speed for each height; got 3 speeds; expected 2"):
        fly(config.model_copy(update={"flight": flight}), LAYOUT)


def test_the_same_speed_twice_is_the_one_speed(config: Config) -> None:
    """Rationale: stating speeds one by one must not change the draws. Expected: bit for bit the same motion."""
    flight = config.flight.model_copy(update={"speeds_m_s": (config.flight.speed_m_s,) * 2})
    a, b = fly(config, LAYOUT), fly(config.model_copy(update={"flight": flight}), LAYOUT)
    for one, other in zip(a, b, strict=True):
        assert np.array_equal(one.motion.position_world_m, other.motion.position_world_m)
        assert one.strips == other.strips
