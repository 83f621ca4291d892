"""The post-processed trajectory: SBET (.out), smrmsg.out and trajectory.csv. Time is adjusted standard GPS time in memory."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """Body frame (FRD, origin at the navigation centre) against the Earth, n epochs in increasing time.

    Attitude is against the local north-east-down frame *at the platform's own position*:
    ned_from_body = Rz(heading) Ry(pitch) Rx(roll).
    """

    gps_time_s: np.ndarray  # (n,) adjusted standard GPS time: GPS seconds - 1e9 [s]
    latitude_rad: np.ndarray  # (n,) geodetic, CGCS2000 [rad]
    longitude_rad: np.ndarray  # (n,) [rad]
    ellipsoid_height_m: np.ndarray  # (n,) [m]
    roll_rad: np.ndarray  # (n,) [rad]
    pitch_rad: np.ndarray  # (n,) [rad]
    heading_rad: np.ndarray  # (n,) clockwise from true north, 0..2 pi [rad]
    velocity_ned_m_s: np.ndarray  # (n, 3) [m/s]
    acceleration_body_m_s2: np.ndarray  # (n, 3) [m/s2]
    angular_rate_body_rad_s: np.ndarray  # (n, 3) [rad/s]
    position_std_m: np.ndarray  # (n, 3) north east down; from smrmsg [m]
    attitude_std_rad: np.ndarray  # (n, 3) roll pitch heading; from smrmsg [rad]


def write_sbet(path: Path, trajectory: Trajectory, gps_week: int) -> None:
    """17 little-endian doubles an epoch; time as seconds of `gps_week` (may pass 604800 at a week's end)."""
    raise NotImplementedError


def write_smrmsg(path: Path, trajectory: Trajectory, gps_week: int) -> None:
    """10 doubles an epoch: time, position RMS n e d [m], velocity RMS [m/s], roll pitch heading RMS [arcmin]."""
    raise NotImplementedError


def write_csv(path: Path, trajectory: Trajectory) -> None:
    """The same for people: degrees, Beijing time beside GPS time."""
    raise NotImplementedError


def read_trajectory(sbet: Path, smrmsg: Path | None, gps_week: int) -> Trajectory:
    """Raises CampaignError: empty, truncated, not finite, time not increasing."""
    raise NotImplementedError
