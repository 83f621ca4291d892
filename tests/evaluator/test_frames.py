"""Frames of the evaluator against pyproj, against closed forms and against themselves."""

import numpy as np
import pyproj
import pytest

from campaign.flight.trajectory import Trajectory
from campaign.manifest import Manifest
from evaluator.frames import WorldFrame, body_pose, euler_angles, euler_rates, euler_rotation, skew
from evaluator.model import EvaluationError

LAT, LON, HEIGHT = 31.283, 121.213, 18.0


def manifest() -> Manifest:
    return Manifest(
        campaign="t",
        synthetic=True,
        date="2026-06-12",
        start_time="2026-06-12T10:30:00+08:00",
        gps_week=2422,
        latitude_deg=LAT,
        longitude_deg=LON,
        ellipsoid_height_m=HEIGHT,
        height_anomaly_m=11.2,
        projection_epsg=4549,
        height_epsg=5737,
        software={},
        files=(),
    )


def trajectory(n: int = 401, rate_hz: float = 200.0, heading_deg: float = 359.5) -> Trajectory:
    """A body that flies north at 5 m/s, 50 m above the origin, rolling and turning slowly past north."""
    t = 464_000_000.0 + np.arange(n) / rate_hz
    s = t - t[0]
    heading = np.radians(heading_deg + 1.0 * s) % (2 * np.pi)
    return Trajectory(
        gps_time_s=t,
        latitude_rad=np.radians(LAT) + 5.0 * s / 6.35e6,
        longitude_rad=np.full(n, np.radians(LON)),
        ellipsoid_height_m=np.full(n, HEIGHT + 50.0),
        roll_rad=np.radians(1.0) * np.sin(s),
        pitch_rad=np.full(n, np.radians(-2.0)),
        heading_rad=heading,
        velocity_ned_m_s=np.zeros((n, 3)),
        acceleration_body_m_s2=np.zeros((n, 3)),
        angular_rate_body_rad_s=np.zeros((n, 3)),
        position_std_m=np.zeros((n, 3)),
        attitude_std_rad=np.zeros((n, 3)),
    )


def test_world_against_proj_topocentric() -> None:
    """Rationale: the own ellipsoid formulas must equal PROJ's topocentric step.
    Expected: the same coordinates. Tolerance: 1e-6 m; GRS80 written twice, double precision."""
    frame = WorldFrame(manifest())
    rng = np.random.default_rng(1)
    world = rng.uniform(-2000.0, 2000.0, (50, 3))
    lat, lon, h = frame.geodetic_from_world(world)
    pipe = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=GRS80 "
        f"+step +proj=topocentric +ellps=GRS80 +lat_0={LAT} +lon_0={LON} +h_0={HEIGHT}"
    )
    expected = np.stack(pipe.transform(np.degrees(lon), np.degrees(lat), h), axis=-1)
    assert np.abs(expected - world).max() < 1e-6


def test_map_round_trip() -> None:
    """Rationale: map and world must invert each other. Expected: identity. Tolerance: 1e-7 m, PROJ's inverse projection."""
    frame = WorldFrame(manifest())
    world = np.random.default_rng(2).uniform(-500.0, 500.0, (40, 3))
    assert np.abs(frame.world_from_map(frame.map_from_world(world)) - world).max() < 1e-7


def test_grid_axes_are_a_rotation_and_follow_the_map() -> None:
    """Rationale: a step along the map's axes must be the same step along the rotated axes.
    Expected: equal but for the projection's scale (m = 1.0006 at 115 km from the meridian). Tolerance: 2e-3 of 1 m."""
    frame = WorldFrame(manifest())
    origin = frame.map_from_world(np.zeros(3))
    axes = frame.world_from_grid(origin)
    assert np.abs(axes @ axes.T - np.eye(3)).max() < 1e-12
    assert np.linalg.det(axes) > 0
    for k in range(3):
        step = frame.world_from_map(origin + np.eye(3)[k]) - frame.world_from_map(origin)
        assert np.abs(step - axes[:, k]).max() < 2e-3


def test_euler_round_trip_and_order() -> None:
    """Rationale: R = Rz Ry Rx, the convention of the trajectory. Expected: product of elementary turns, exact inverse.
    Tolerance: 1e-14, rounding."""
    rpy = np.array([0.3, -0.7, 2.1])
    c, s = np.cos(rpy), np.sin(rpy)
    rx = np.array([[1, 0, 0], [0, c[0], -s[0]], [0, s[0], c[0]]])
    ry = np.array([[c[1], 0, s[1]], [0, 1, 0], [-s[1], 0, c[1]]])
    rz = np.array([[c[2], -s[2], 0], [s[2], c[2], 0], [0, 0, 1]])
    rotation = euler_rotation(*rpy)
    assert np.abs(rotation - rz @ ry @ rx).max() < 1e-14
    assert np.abs(euler_angles(rotation) - rpy).max() < 1e-14


def test_euler_rates_against_differences() -> None:
    """Rationale: the adjustment's derivatives rest on it. Expected: central differences. Tolerance: 1e-9 with step 1e-6."""
    rpy = np.array([0.2, -0.4, 1.1])
    rates = euler_rates(rpy)
    for k in range(3):
        d = np.zeros(3)
        d[k] = 1e-6
        numeric = (euler_rotation(*(rpy + d)) - euler_rotation(*(rpy - d))) / 2e-6
        assert np.abs(numeric - skew(rates[:, k]) @ euler_rotation(*rpy)).max() < 1e-9


def test_body_pose_through_north() -> None:
    """Rationale: heading passes 360 degrees between samples; interpolation must not swing round.
    Expected: heading 359.5 + 1 t degrees and 5 m/s north. Tolerance: 1e-6 degrees plus convergence of the meridians (none
    on the origin's own meridian); 0.02 m for the rounded radius of the Earth over 6 m."""
    frame = WorldFrame(manifest())
    tr = trajectory()
    t = tr.gps_time_s[0] + np.array([0.4974, 0.5012, 1.2345])
    position, rotation = body_pose(tr, t, frame)
    heading = np.degrees(np.arctan2(rotation[:, 0, 0], rotation[:, 1, 0]))  # body x: east, north
    expected = (359.5 + (t - tr.gps_time_s[0]) + 180.0) % 360.0 - 180.0
    assert np.abs(heading - expected).max() < 1e-6
    assert np.abs(position[:, 0]).max() < 1e-9
    assert np.abs(position[:, 1] - 5.0 * (t - tr.gps_time_s[0])).max() < 0.02
    assert np.abs(position[:, 2] - 50.0).max() < 1e-4


def test_body_pose_outside_is_an_error() -> None:
    """Rationale: extrapolating a trajectory would be silently wrong. Expected: EvaluationError naming both spans."""
    tr = trajectory()
    with pytest.raises(EvaluationError, match="outside the trajectory"):
        body_pose(tr, np.array([tr.gps_time_s[-1] + 0.001]), WorldFrame(manifest()))
