"""What passes between the rooms of the 3D page, and what it asks of a truth. Plain data, no formula."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class TruthErrors(Protocol):
    """Tells how far shown points lie from where their pulses truly met a surface. Only a simulated campaign has one."""

    def __call__(
        self,
        sortie: int,
        strip: int,
        record: np.ndarray,
        p_lidar_m: np.ndarray,
        gps_time_s: np.ndarray,
        world_m: np.ndarray,
    ) -> np.ndarray:
        """Distances of several versions of n points from the truth, (k, n), NaN where there is none. [m]

        Parameters
        ----------
        sortie, strip : int
        record : (n,) int64 np.ndarray
            Rows of the strip's LAS file.
        p_lidar_m : (n, 3) np.ndarray
            What the LiDAR measured, in its own frame. [m]
        gps_time_s : (n,) np.ndarray
            As stamped. [s]
        world_m : (k, n, 3) np.ndarray
            The same points by k ways of computing them. [m]
        """


@dataclass(frozen=True, kw_only=True)
class StripPoints:
    """Those returns of one strip that the page shows. Map coordinates: easting, northing, normal height."""

    sortie: int
    strip: int
    record: np.ndarray  # (n,) int64 rows of the strip's LAS file
    map_m: np.ndarray  # (n, 3) as delivered: nominal mounting
    adjusted_map_m: np.ndarray  # (n, 3) by the adjusted mounting; NaN where there is none
    gps_time_s: np.ndarray  # (n,)
    reflectance: np.ndarray  # (n,) 0..1, NaN where not recorded
    last: np.ndarray  # (n,) bool: the pulse's last return
    target: np.ndarray  # (n,) int32 index of the surveyed target near which it lies, -1 none
    error_m: np.ndarray  # (2, n) distance from the truth as delivered and adjusted; NaN where unknown


@dataclass(frozen=True, kw_only=True)
class Cloud:
    """All points that are shown, and what is to be said about them."""

    strips: tuple[StripPoints, ...]
    total: int  # returns in the files
    reflectance_by: str  # "device" | "panels" | "none": who scaled it
    problems: tuple[str, ...] = ()  # strips that could not be read, one line each

    @property
    def shown(self) -> int:
        """Points on the page."""
        return sum(len(s.record) for s in self.strips)

    def joined(self, field: str) -> np.ndarray:
        """One field of all strips, in their order; (2, n) for error_m."""
        parts = [np.asarray(getattr(s, field)) for s in self.strips]
        return np.concatenate(parts, axis=1 if field == "error_m" else 0)
