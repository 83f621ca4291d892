"""Rigid motion of the body over time: sampled poses, linearly interpolated. True and estimated motion have the same form."""

from dataclasses import dataclass

import numpy as np

from simulator.flight.frames import ENU_FROM_NED, rotation_from_rpy


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Body frame (FRD) in the world frame. Attitude against the north-east-down axes *of the site's origin*.

    Between samples position and angles are linear in time: at 200 Hz that is the truth by definition, and 0.01 mm and
    1e-5 degrees from any smoother curve.
    """

    gps_time_s: np.ndarray  # (n,) adjusted standard GPS time
    position_world_m: np.ndarray  # (n, 3)
    velocity_world_m_s: np.ndarray  # (n, 3)
    rpy_rad: np.ndarray  # (n, 3) roll pitch heading, heading unwrapped

    def position(self, gps_time_s: np.ndarray) -> np.ndarray:
        """(m,) -> (m, 3). [m]"""
        return np.stack([np.interp(gps_time_s, self.gps_time_s, c) for c in self.position_world_m.T], axis=-1)

    def rpy(self, gps_time_s: np.ndarray) -> np.ndarray:
        """(m,) -> (m, 3). [rad]"""
        return np.stack([np.interp(gps_time_s, self.gps_time_s, c) for c in self.rpy_rad.T], axis=-1)

    def world_from_body(self, gps_time_s: np.ndarray) -> np.ndarray:
        """(m,) -> rotations (m, 3, 3)."""
        return ENU_FROM_NED @ rotation_from_rpy(*np.moveaxis(self.rpy(gps_time_s), -1, 0))


@dataclass(frozen=True, kw_only=True)
class SensorMounting:
    """body_from_sensor: rotation (3, 3) and the sensor's origin in the body frame (3,) [m]."""

    rotation: np.ndarray
    lever_arm_m: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Strip:
    """One flight line as flown."""

    sortie: int
    number: int  # from 1 within the sortie
    heading_deg: float
    height_m: float  # design height above the site's origin
    start_s: float  # adjusted standard GPS time: LiDAR on
    end_s: float
    exposure_s: tuple[float, ...]  # true mid-exposure times
