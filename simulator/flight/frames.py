"""The simulator's frames: rotations, world (ENU at the site's origin), geodetic and map coordinates.

The evaluator has frames of its own (evaluator/frames.py); a contract test compares the two. Conventions: docs/conventions.md.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyproj

from campaign.config import Site

# CGCS2000's ellipsoid; GRS80's flattening differs by 1.6e-11, a tenth of a millimetre nowhere on the Earth.
SEMI_MAJOR_M = 6378137.0
INVERSE_FLATTENING = 298.257222101

ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# Columns: camera x (right) = body y, camera y (down) = body -x, camera z (forward) = body z: a nadir camera, top of image ahead.
FRD_FROM_RDF_NADIR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def rotation_from_rpy(roll_rad: np.ndarray, pitch_rad: np.ndarray, yaw_rad: np.ndarray) -> np.ndarray:
    """Rz(yaw) Ry(pitch) Rx(roll), angles (...) -> rotations (..., 3, 3)."""
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    cp, sp = np.cos(pitch_rad), np.sin(pitch_rad)
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=-2)


def rpy_from_rotation(rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inverse of `rotation_from_rpy` for |pitch| < 90 degrees. [rad]"""
    return (
        np.arctan2(rotation[..., 2, 1], rotation[..., 2, 2]),
        -np.arcsin(np.clip(rotation[..., 2, 0], -1.0, 1.0)),
        np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]),
    )


def _enu_axes(latitude_rad: np.ndarray, longitude_rad: np.ndarray) -> np.ndarray:
    """ecef_from_enu (..., 3, 3): columns east, north, up."""
    sl, cl = np.sin(longitude_rad), np.cos(longitude_rad)
    sp, cp = np.sin(latitude_rad), np.cos(latitude_rad)
    zero = np.zeros_like(sl)
    rows = [[-sl, -sp * cl, cp * cl], [cl, -sp * sl, cp * sl], [zero, cp, sp]]
    return np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=-2)


@dataclass(frozen=True)
class SiteFrame:
    """World (ENU at the origin) against geodetic and projected coordinates of one site. Exact: no small-area formula."""

    site: Site

    @cached_property
    def _topocentric(self) -> str:
        s = self.site
        return (
            f"+proj=topocentric +a={SEMI_MAJOR_M} +rf={INVERSE_FLATTENING} "
            f"+lat_0={s.latitude_deg!r} +lon_0={s.longitude_deg!r} +h_0={s.ellipsoid_height_m!r}"
        )

    @cached_property
    def _geodetic_from_world(self) -> pyproj.Transformer:
        ellipsoid = f"+a={SEMI_MAJOR_M} +rf={INVERSE_FLATTENING}"
        return pyproj.Transformer.from_pipeline(
            f"+proj=pipeline +step +inv {self._topocentric} +step +inv +proj=cart {ellipsoid} "
            "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
        )

    @cached_property
    def _map_from_geodetic(self) -> pyproj.Transformer:
        crs = pyproj.CRS.from_epsg(self.site.projection_epsg)
        return pyproj.Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True)

    def geodetic_from_world(self, world_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(n, 3) -> latitude [rad], longitude [rad], ellipsoidal height [m]."""
        lon, lat, height = self._geodetic_from_world.transform(world_m[..., 0], world_m[..., 1], world_m[..., 2])
        return np.radians(lat), np.radians(lon), np.asarray(height)

    def map_from_world(self, world_m: np.ndarray) -> np.ndarray:
        """(n, 3) -> (n, 3) easting, northing, normal height. [m]"""
        lon, lat, height = self._geodetic_from_world.transform(world_m[..., 0], world_m[..., 1], world_m[..., 2])
        east, north = self._map_from_geodetic.transform(lon, lat)
        return np.stack([east, north, np.asarray(height) - self.site.height_anomaly_m], axis=-1)

    def local_ned_from_world(self, latitude_rad: np.ndarray, longitude_rad: np.ndarray) -> np.ndarray:
        """Rotation from world axes to north-east-down at another place, (..., 3, 3)."""
        origin = _enu_axes(np.radians(self.site.latitude_deg), np.radians(self.site.longitude_deg))
        local = _enu_axes(np.asarray(latitude_rad), np.asarray(longitude_rad))
        return ENU_FROM_NED.T @ np.swapaxes(local, -1, -2) @ origin

    def grid_azimuth_deg(self, azimuth_deg: float, world_m: np.ndarray) -> float:
        """Azimuth against the map's grid north of a horizontal direction given against world north, at one point."""
        a = np.radians(azimuth_deg)
        ends = self.map_from_world(np.stack([world_m, world_m + np.array([np.sin(a), np.cos(a), 0.0])]))
        d = ends[1] - ends[0]
        return float(np.degrees(np.arctan2(d[0], d[1])) % 360.0)
