"""Parts of the strip simulation: fast map coordinates, fast rotations, the kept-packet mask, imports."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from campaign.config import Site
from campaign.errors import ConfigError
from simulator.flight.frames import SiteFrame
from simulator.flight.georeference import MapPatch, Track, beams_world
from simulator.flight.motion import Motion, SensorMounting
from simulator.lidar.footprint import gaussian_footprint
from simulator.lidar.radar_equation import extinction_per_km, unambiguous_range_m


@pytest.mark.parametrize("latitude", [-35.0, 0.0, 31.3, 60.0])
def test_map_patch_equals_the_exact_projection(latitude: float) -> None:
    """Rationale: LAS rows go through a cubic that stands for pyproj. Expected: the same map coordinates anywhere within 2 km
    and 1200 m of height. Tolerance: 1 µm; terms left out are of order (2 km)^4 / R^3 = 6e-8 m."""
    frame = SiteFrame(Site(latitude_deg=latitude))
    patch = MapPatch(frame)
    world = np.random.default_rng(0).uniform([-2000, -2000, -200], [2000, 2000, 1200], (2000, 3))
    assert np.abs(patch.relative(world) + patch.origin_m - frame.map_from_world(world)).max() < 1e-6


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1.2, 1.2), min_size=6, max_size=6), st.lists(st.floats(-5, 5), min_size=6, max_size=6))
def test_beams_equal_the_matrices_of_the_frames(angles: list[float], numbers: list[float]) -> None:
    """Rationale: rotations are arranged for speed here. Expected: what Motion.world_from_body's matrices give.
    Tolerance: rounding, 1e-12."""
    motion = Motion(
        gps_time_s=np.array([0.0, 1.0]),
        position_world_m=np.array([numbers[:3], numbers[3:]]),
        velocity_world_m_s=np.zeros((2, 3)),
        rpy_rad=np.array([angles[:3], angles[3:]]),
    )
    mounting = SensorMounting(
        rotation=np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0], lever_arm_m=np.array(numbers[1:4])
    )
    time = np.linspace(0.0, 1.0, 7)
    beam = np.random.default_rng(2).normal(size=(7, 3))
    origin, direction, _ = beams_world(motion, time, mounting, beam)
    world_from_body = motion.world_from_body(time)
    assert np.allclose(direction, np.einsum("nij,jk,nk->ni", world_from_body, mounting.rotation, beam), atol=1e-12)
    assert np.allclose(origin, motion.position(time) + world_from_body @ mounting.lever_arm_m, atol=1e-12)


def test_beams_do_not_depend_on_their_company() -> None:
    """Rationale: pulses between two samples of the motion are worked on together, and a strip takes only its part of the motion.
    Expected: the bytes of every pulse alone and in any order, with the whole motion or a part; before the first sample its pose,
    after the last one the last. Tolerance: none; against the matrices rounding, 1e-12."""
    rng = np.random.default_rng(3)
    sample_s = np.sort(rng.uniform(0.0, 10.0, 50))
    motion = Motion(
        gps_time_s=sample_s,
        position_world_m=rng.normal(size=(50, 3)),
        velocity_world_m_s=np.zeros((50, 3)),
        rpy_rad=np.cumsum(rng.normal(scale=0.02, size=(50, 3)), axis=0),
    )
    mounting = SensorMounting(rotation=np.eye(3), lever_arm_m=np.array([0.1, -0.2, 0.3]))
    time = np.concatenate([rng.uniform(2.0, 3.0, 700), sample_s[(sample_s > 2.0) & (sample_s < 3.0)], [2.0, 3.0]])
    beam = rng.normal(size=(len(time), 3))
    whole = Track(motion).beams(time, mounting, beam)
    part = Track(motion, 2.0, 3.0).beams(time, mounting, beam)
    order = np.argsort(time)
    sorted_by_time = Track(motion).beams(time[order], mounting, beam[order])
    alone = Track(motion).beams(time[:1], mounting, beam[:1])
    for k in range(2):
        assert np.array_equal(whole[k], part[k])
        assert np.array_equal(whole[k][order], sorted_by_time[k])
        assert np.array_equal(whole[k][:1], alone[k])
    assert np.allclose(whole[1], np.einsum("nij,nj->ni", motion.world_from_body(time), beam), atol=1e-12)
    assert np.allclose(
        whole[0], motion.position(time) + motion.world_from_body(time) @ mounting.lever_arm_m, atol=1e-12
    )
    ends = Track(motion).beams(np.array([-1.0, sample_s[0], sample_s[-1], 11.0]), mounting, beam[:1].repeat(4, axis=0))
    assert np.allclose(ends[1][0], ends[1][1], atol=1e-14)
    assert np.allclose(ends[1][2], ends[1][3], atol=1e-14)


def test_extinction_has_kim_s_values() -> None:
    """Rationale: wavelength in µm, result in 1/km; units mixed up give transmissions of 0. Expected: by definition 3.912 / V at
    0.55 µm; at 0.5 km fog no dependence on wavelength; 10 log10(e) 3.912 / 23 (1.55 / 0.55)^-1.3 = 0.19 dB/km at 23 km, the
    figure of Kim's table for 1550 nm in clear air (0.2 dB/km). Tolerance: its last digit."""
    assert extinction_per_km(0.55, 23.0) == pytest.approx(3.912 / 23.0)
    assert extinction_per_km(1.55, 0.5) == pytest.approx(extinction_per_km(0.785, 0.5))
    assert 10.0 * np.log10(np.e) * extinction_per_km(1.55, 23.0) == pytest.approx(0.2, abs=0.01)


def test_unambiguous_range_of_550_khz() -> None:
    """Rationale: the VUX-1UAV's figure. Expected: 272 m. Tolerance: its last digit."""
    assert unambiguous_range_m(1.0 / 550_000.0) == pytest.approx(272.5, abs=0.1)


@pytest.mark.parametrize("subrays", [2, 3])
def test_patterns_that_cannot_be_round_are_refused(subrays: int) -> None:
    """Rationale: two or three points have a direction. Expected: ConfigError naming the setting."""
    with pytest.raises(ConfigError, match=r"lidar\.subrays"):
        gaussian_footprint(subrays, 0.001)


def test_import_compiles_and_renders_nothing() -> None:
    """Rationale: start-up time. Expected: importing the module loads neither Mitsuba nor a compiled specialisation."""
    code = (
        "import sys, simulator.lidar.strip, simulator.lidar.device, simulator.flight.georeference as g\n"
        "from simulator.pulses import cone, detection, fan, sampling, surface\n"
        "assert 'mitsuba' not in sys.modules and 'drjit' not in sys.modules\n"
        "compiled = detection.detect, g._cubic, g._beams, cone.see_mixed, surface.see_surfaces, fan.touch, sampling.sample\n"
        "assert not any(f.signatures for f in compiled)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
