"""The evaluator's own frames: rotations, world (ENU at the site's origin), geodetic and map coordinates, body poses.

Nothing here is shared with the simulator, which has a module of its own; a contract test compares the two. Conventions:
docs/conventions.md. Sensors and their mountings live in `georeference` and `camera_model`.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyproj

from campaign.flight.trajectory import Trajectory
from campaign.manifest import Manifest
from evaluator.model import EvaluationError

# GRS80, which CGCS2000's ellipsoid equals to 0.1 mm.
_A_M = 6378137.0
_F = 1.0 / 298.257222101
_E2 = _F * (2.0 - _F)


def skew(vector: np.ndarray) -> np.ndarray:
    """Cross product matrices: (..., 3) -> (..., 3, 3) with skew(a) @ b = a x b."""
    x, y, z = np.moveaxis(np.asarray(vector, dtype=np.float64), -1, 0)
    out = np.zeros((*x.shape, 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -z, y, -x
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = z, -y, x
    return out


def euler_rotation(roll_rad: np.ndarray, pitch_rad: np.ndarray, yaw_rad: np.ndarray) -> np.ndarray:
    """Turns about x (roll), then y (pitch), then z (yaw) of fixed axes: angles (...) -> (..., 3, 3)."""
    roll, pitch, yaw = np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (roll_rad, pitch_rad, yaw_rad)))
    out = np.empty((*roll.shape, 3, 3))
    sr, cr, sp, cp, sy, cy = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch), np.sin(yaw), np.cos(yaw)
    out[..., 0, 0], out[..., 1, 0], out[..., 2, 0] = cp * cy, cp * sy, -sp
    out[..., 0, 1] = sr * sp * cy - cr * sy
    out[..., 1, 1] = sr * sp * sy + cr * cy
    out[..., 2, 1] = sr * cp
    out[..., 0, 2] = cr * sp * cy + sr * sy
    out[..., 1, 2] = cr * sp * sy - sr * cy
    out[..., 2, 2] = cr * cp
    return out


def euler_angles(rotation: np.ndarray) -> np.ndarray:
    """Inverse of `euler_rotation` for |pitch| < 90 degrees: (..., 3, 3) -> (..., 3) roll pitch yaw. [rad]"""
    return np.stack(
        [
            np.arctan2(rotation[..., 2, 1], rotation[..., 2, 2]),
            np.arctan2(-rotation[..., 2, 0], np.hypot(rotation[..., 2, 1], rotation[..., 2, 2])),
            np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]),
        ],
        axis=-1,
    )


def euler_rates(rpy_rad: np.ndarray) -> np.ndarray:
    """Matrix E(rpy) with d(rotation) = skew(E d(rpy)) rotation, angles (..., 3) -> (..., 3, 3).

    Its columns are the axes of the three turns in the fixed frame: yaw about z, pitch about y turned by yaw, roll about x
    turned by pitch and yaw.
    """
    rpy = np.asarray(rpy_rad, dtype=np.float64)
    pitch, yaw = rpy[..., 1], rpy[..., 2]
    out = np.zeros((*pitch.shape, 3, 3))
    out[..., 0, 0], out[..., 1, 0], out[..., 2, 0] = (
        np.cos(pitch) * np.cos(yaw),
        np.cos(pitch) * np.sin(yaw),
        -np.sin(pitch),
    )
    out[..., 0, 1], out[..., 1, 1] = -np.sin(yaw), np.cos(yaw)
    out[..., 2, 2] = 1.0
    return out


def _ecef(latitude_rad: np.ndarray, longitude_rad: np.ndarray, height_m: np.ndarray) -> np.ndarray:
    """Geodetic (...) -> Earth-centred (..., 3). [m]"""
    sin_lat, cos_lat = np.sin(latitude_rad), np.cos(latitude_rad)
    normal = _A_M / np.sqrt(1.0 - _E2 * sin_lat**2)
    return np.stack(
        [
            (normal + height_m) * cos_lat * np.cos(longitude_rad),
            (normal + height_m) * cos_lat * np.sin(longitude_rad),
            (normal * (1.0 - _E2) + height_m) * sin_lat,
        ],
        axis=-1,
    )


def _geodetic(ecef_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Earth-centred (..., 3) -> latitude, longitude [rad], height [m]; 1e-9 m within 10 km of the ellipsoid."""
    x, y, z = np.moveaxis(ecef_m, -1, 0)
    distance = np.hypot(x, y)
    latitude = np.arctan2(z, distance * (1.0 - _E2))
    height = np.zeros_like(latitude)
    for _ in range(6):  # contraction by about e2 * h / a a step
        sin_lat = np.sin(latitude)
        normal = _A_M / np.sqrt(1.0 - _E2 * sin_lat**2)
        height = distance * np.cos(latitude) + z * sin_lat - _A_M**2 / normal
        latitude = np.arctan2(z, distance * (1.0 - _E2 * normal / (normal + height)))
    return latitude, np.arctan2(y, x), height


def _ecef_from_ned(latitude_rad: np.ndarray, longitude_rad: np.ndarray) -> np.ndarray:
    """Axes north, east, down as columns in the Earth-centred frame: (...) -> (..., 3, 3)."""
    latitude, longitude = np.broadcast_arrays(np.asarray(latitude_rad), np.asarray(longitude_rad))
    sp, cp, sl, cl = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    north = np.stack([-sp * cl, -sp * sl, cp], axis=-1)
    east = np.stack([-sl, cl, np.zeros_like(sl)], axis=-1)
    down = np.stack([-cp * cl, -cp * sl, -sp], axis=-1)
    return np.stack([north, east, down], axis=-1)


# World axes (east, north, up) of a vector given along north, east, down.
_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class WorldFrame:
    """World: east, north, up at the origin that the manifest states. Exact against geodetic and projected coordinates."""

    manifest: Manifest

    @cached_property
    def _origin(self) -> tuple[np.ndarray, np.ndarray]:
        m = self.manifest
        latitude, longitude = np.radians(m.latitude_deg), np.radians(m.longitude_deg)
        return _ecef(latitude, longitude, np.array(m.ellipsoid_height_m)), _ecef_from_ned(
            latitude, longitude
        ) @ _ENU_FROM_NED.T

    @cached_property
    def _projection(self) -> pyproj.Transformer:
        crs = pyproj.CRS.from_epsg(self.manifest.projection_epsg)
        return pyproj.Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True)

    def world_from_geodetic(
        self, latitude_rad: np.ndarray, longitude_rad: np.ndarray, height_m: np.ndarray
    ) -> np.ndarray:
        """Latitude, longitude [rad] and ellipsoidal height [m], each (...) -> (..., 3). [m]"""
        origin, axes = self._origin
        return np.asarray((_ecef(latitude_rad, longitude_rad, height_m) - origin) @ axes)

    def geodetic_from_world(self, world_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(..., 3) -> latitude, longitude [rad], ellipsoidal height [m], each (...)."""
        origin, axes = self._origin
        return _geodetic(origin + np.asarray(world_m, dtype=np.float64) @ axes.T)

    def world_from_map(self, map_m: np.ndarray) -> np.ndarray:
        """Easting, northing, normal height (..., 3) -> world (..., 3). [m]"""
        m = np.asarray(map_m, dtype=np.float64)
        lon, lat = self._projection.transform(m[..., 0], m[..., 1], direction="INVERSE")
        return self.world_from_geodetic(np.radians(lat), np.radians(lon), m[..., 2] + self.manifest.height_anomaly_m)

    def map_from_world(self, world_m: np.ndarray) -> np.ndarray:
        """World (..., 3) -> easting, northing, normal height (..., 3). [m]"""
        lat, lon, height = self.geodetic_from_world(world_m)
        east, north = self._projection.transform(np.degrees(lon), np.degrees(lat))
        return np.stack([np.asarray(east), np.asarray(north), height - self.manifest.height_anomaly_m], axis=-1)

    def world_from_local_ned(self, latitude_rad: np.ndarray, longitude_rad: np.ndarray) -> np.ndarray:
        """Rotation from the north-east-down axes at a place (...) to world axes, (..., 3, 3)."""
        return np.asarray(self._origin[1].T @ _ecef_from_ned(latitude_rad, longitude_rad))

    def world_from_grid(self, map_m: np.ndarray) -> np.ndarray:
        """Rotation from easting, northing, up at map points (..., 3) to world axes (..., 3, 3): grid convergence and the
        plumb line's turn over the site; the projection's scale is left out."""
        m = np.asarray(map_m, dtype=np.float64)
        here = self.world_from_map(m)
        ahead = self.world_from_map(m + np.array([0.0, 10.0, 0.0])) - here
        above = self.world_from_map(m + np.array([0.0, 0.0, 10.0])) - here
        up = above / np.linalg.norm(above, axis=-1, keepdims=True)
        east = np.cross(ahead, up)
        east /= np.linalg.norm(east, axis=-1, keepdims=True)
        return np.stack([east, np.cross(up, east), up], axis=-1)


def body_pose(trajectory: Trajectory, gps_time_s: np.ndarray, world_frame: WorldFrame) -> tuple[np.ndarray, np.ndarray]:
    """Pose of the body at any times inside the trajectory.

    Parameters
    ----------
    trajectory : Trajectory
        Samples; between them the position and the angles against the origin's axes are taken as linear.
    gps_time_s : (n,) np.ndarray
        Adjusted standard GPS time. [s]
    world_frame : WorldFrame

    Returns
    -------
    position_m : (n, 3) np.ndarray
        Body origin in the world frame. [m]
    world_from_body : (n, 3, 3) np.ndarray

    Raises
    ------
    EvaluationError
        A time lies outside the trajectory.
    """
    time = np.atleast_1d(np.asarray(gps_time_s, dtype=np.float64))
    samples = trajectory.gps_time_s
    if time.size == 0:
        return np.zeros((0, 3)), np.zeros((0, 3, 3))
    first, last = float(time.min()), float(time.max())
    if samples.size == 0 or not (samples[0] <= first and last <= samples[-1]):
        span = "no epochs" if samples.size == 0 else f"{samples[0]:.3f} to {samples[-1]:.3f} s"
        raise EvaluationError(
            "an observation's time lies outside the trajectory", got=f"{first:.3f} to {last:.3f} s", expected=span
        )
    low = max(int(np.searchsorted(samples, first, side="right")) - 1, 0)
    high = min(int(np.searchsorted(samples, last, side="left")) + 1, samples.size)
    part = slice(low, high)
    t = samples[part]
    lat, lon = trajectory.latitude_rad[part], trajectory.longitude_rad[part]
    position = world_frame.world_from_geodetic(lat, lon, trajectory.ellipsoid_height_m[part])
    local = euler_rotation(trajectory.roll_rad[part], trajectory.pitch_rad[part], trajectory.heading_rad[part])
    rpy = euler_angles(_ENU_FROM_NED.T @ world_frame.world_from_local_ned(lat, lon) @ local)
    rpy = np.unwrap(rpy, axis=0)
    at = np.stack([np.interp(time, t, c) for c in position.T], axis=-1)
    angles = [np.interp(time, t, c) for c in rpy.T]
    return at, _ENU_FROM_NED @ euler_rotation(*angles)
