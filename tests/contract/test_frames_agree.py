"""Simulator and evaluator have frames of their own; here, and only here, the two are compared."""

import numpy as np
import pytest

from campaign.config import Site
from campaign.load import load_config
from campaign.manifest import Manifest
from evaluator.frames import WorldFrame, body_pose, euler_angles, euler_rotation
from evaluator.georeference import nominal_mountings
from scenes.model import Layout
from simulator.flight import rig
from simulator.flight.frames import SiteFrame, rotation_from_rpy, rpy_from_rotation
from simulator.flight.navigation import trajectory_of
from simulator.flight.plan import fly


def _manifest(site: Site) -> Manifest:
    return Manifest(
        campaign="c",
        synthetic=True,
        date="2026-06-12",
        start_time="2026-06-12T10:30:00+08:00",
        gps_week=2422,
        latitude_deg=site.latitude_deg,
        longitude_deg=site.longitude_deg,
        ellipsoid_height_m=site.ellipsoid_height_m,
        height_anomaly_m=site.height_anomaly_m,
        projection_epsg=site.projection_epsg,
        height_epsg=site.height_epsg,
        software={},
        files=(),
    )


SITE = Site()
LAYOUT = Layout(camera_half_m=(23.0, 15.4), lidar_half_m=31.0, cone_half_m=45.0, field_half_m=(13.0, 12.0))


def test_map_coordinates_agree_both_ways() -> None:
    """Tolerance: 1e-6 m, a hundredth of the LAS step; PROJ's transverse Mercator is good to 1e-9 m here."""
    world = np.random.default_rng(1).uniform(-1500.0, 1500.0, (200, 3))
    simulated = SiteFrame(SITE).map_from_world(world)
    evaluator = WorldFrame(_manifest(SITE))
    assert np.abs(evaluator.map_from_world(world) - simulated).max() < 1e-6
    assert np.abs(evaluator.world_from_map(simulated) - world).max() < 1e-6


def test_rotations_agree() -> None:
    angles = np.random.default_rng(2).uniform(-1.4, 1.4, (3, 500))
    ours = rotation_from_rpy(*angles)
    assert np.abs(ours - euler_rotation(*angles)).max() < 1e-15
    assert np.abs(np.stack(rpy_from_rotation(ours)) - euler_angles(ours).T).max() < 1e-12


def test_body_pose_out_of_the_file_form_is_the_pose_that_was_flown() -> None:
    """Rationale: the simulator writes attitude against north at the platform; the evaluator must undo just that.

    Tolerance: 1e-6 m; 1e-9 rad: both interpolate linearly, on angles that differ by the local meridian's turn (1e-5 rad).
    """
    config = load_config("quickstart")
    motion = fly(config, LAYOUT)[0].motion
    written = trajectory_of(motion, SiteFrame(config.site), config)
    times = np.random.default_rng(3).uniform(motion.gps_time_s[0], motion.gps_time_s[-1], 500)
    position, rotation = body_pose(written, times, WorldFrame(_manifest(config.site)))
    assert np.abs(position - motion.position(times)).max() < 1e-6
    assert np.abs(rotation - motion.world_from_body(times)).max() < 1e-8


def test_nominal_mountings_agree() -> None:
    config = load_config(
        "quickstart",
        ["platform.camera.boresight_deg=[1.0, -2.0, 3.0]", "platform.lidar.boresight_deg=[0.5, 90.0, 1.0]"],
    )
    camera, lidar = nominal_mountings(rig.rig_sheet(config))
    for ours, theirs in ((rig.nominal_camera(config), camera), (rig.nominal_lidar(config), lidar)):
        assert ours.rotation == pytest.approx(theirs.rotation, abs=1e-15)
        assert ours.lever_arm_m == pytest.approx(theirs.lever_arm_m, abs=0)
