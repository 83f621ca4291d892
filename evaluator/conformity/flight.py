"""What clauses 6 and 7 look up: the parts of the trajectory that are strips, and where the sun stood. No row is written here."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
import pandas as pd
import pvlib.solarposition  # type: ignore[import-untyped]

from campaign.flight.trajectory import Trajectory
from evaluator.conformity.model import ConformityInputs
from evaluator.model import CampaignData

_GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
_ACCELERATION_WINDOW_S = (
    0.5  # velocity differences over half a second: navigation noise averages out, manoeuvres do not
)


@dataclass(frozen=True, kw_only=True)
class StripFlight:
    """One strip as flown, n epochs of the trajectory."""

    sortie: int
    strip: int
    gps_time_s: np.ndarray  # (n,) [s]
    height_m: np.ndarray  # (n,) above the site's origin [m]
    ground_speed_m_s: np.ndarray  # (n,) [m/s]
    acceleration_m_s2: np.ndarray  # (m,) magnitude over half a second; empty for a shorter strip [m/s2]
    design_height_m: float | None  # above the site's origin [m]
    exposure_height_m: np.ndarray  # (e,) at the strip's exposures, in order of time [m]

    @property
    def name(self) -> str:
        return f"sortie {self.sortie} strip {self.strip}"


def strip_windows(data: CampaignData, measured: ConformityInputs) -> dict[tuple[int, int], tuple[float, float]]:
    """From when to when each strip lasted: LiDAR on to off where known, else first to last exposure. [adjusted GPS s]"""
    windows: dict[tuple[int, int], tuple[float, float]] = {}
    for sortie in data.sorties:
        for exposure in sortie.exposures:
            key = (sortie.folder.number, exposure.strip)
            low, high = windows.get(key, (exposure.gps_time_s, exposure.gps_time_s))
            windows[key] = (min(low, exposure.gps_time_s), max(high, exposure.gps_time_s))
    windows.update(measured.strip_window_s)
    return dict(sorted(windows.items()))


def acceleration(trajectory: Trajectory, part: slice) -> np.ndarray:
    """Magnitude of the change of velocity over half a second, (m,). [m/s2]"""
    time, velocity = trajectory.gps_time_s[part], trajectory.velocity_ned_m_s[part]
    if time.size < 2 or time[-1] - time[0] < _ACCELERATION_WINDOW_S:
        return np.zeros(0)
    end = time[time >= time[0] + _ACCELERATION_WINDOW_S]
    before = np.stack([np.interp(end - _ACCELERATION_WINDOW_S, time, v) for v in velocity.T], axis=-1)
    change = velocity[time.size - end.size :] - before
    return np.asarray(np.linalg.norm(change, axis=1) / _ACCELERATION_WINDOW_S)


def strip_flights(data: CampaignData, measured: ConformityInputs) -> Iterator[StripFlight]:
    """Every strip that the trajectory covers with at least two epochs."""
    design = {(s.sortie, s.strip): s.height_m for s in data.plan.strips} if data.plan else {}
    windows = strip_windows(data, measured)
    for sortie in data.sorties:
        trajectory = sortie.trajectory
        if trajectory is None:
            continue
        time = trajectory.gps_time_s
        height = trajectory.ellipsoid_height_m - data.manifest.ellipsoid_height_m
        for (number, strip), (start, end) in windows.items():
            if number != sortie.folder.number:
                continue
            part = slice(int(np.searchsorted(time, start)), int(np.searchsorted(time, end, side="right")))
            if part.stop - part.start < 2:
                continue
            exposed = sorted(e.gps_time_s for e in sortie.exposures if e.strip == strip)
            yield StripFlight(
                sortie=number,
                strip=strip,
                gps_time_s=time[part],
                height_m=height[part],
                ground_speed_m_s=np.hypot(trajectory.velocity_ned_m_s[part, 0], trajectory.velocity_ned_m_s[part, 1]),
                acceleration_m_s2=acceleration(trajectory, part),
                design_height_m=design.get((number, strip)),
                exposure_height_m=np.interp(exposed, time, height) if exposed else np.zeros(0),
            )


def flight_times(data: CampaignData, measured: ConformityInputs) -> np.ndarray:
    """Times from the first strip to the last, at most a minute apart; empty when nothing is recorded. [adjusted GPS s]"""
    windows = list(strip_windows(data, measured).values())
    if not windows:
        return np.zeros(0)
    start, end = min(w[0] for w in windows), max(w[1] for w in windows)
    return np.linspace(start, end, 2 + int((end - start) // 60.0))


def sun_elevation(data: CampaignData, gps_time_s: np.ndarray) -> np.ndarray:
    """Elevation of the sun's centre at the site's origin, with refraction, by NREL's algorithm (pvlib). [deg]

    Parameters
    ----------
    data : CampaignData
        For the site's place and GPS - UTC.
    gps_time_s : (n,) np.ndarray
        Adjusted standard GPS time. [s]

    Returns
    -------
    (n,) np.ndarray
        [deg]

    References
    ----------
    I. Reda and A. Andreas, Solar position algorithm for solar radiation applications, Solar Energy 76 (2004), 577-589.
    """
    m = data.manifest
    utc = [_GPS_EPOCH + timedelta(seconds=float(t) + 1e9 - m.gps_minus_utc_s) for t in gps_time_s]
    position = pvlib.solarposition.get_solarposition(
        pd.DatetimeIndex(utc), m.latitude_deg, m.longitude_deg, altitude=m.ellipsoid_height_m
    )
    return np.asarray(position["apparent_elevation"], dtype=np.float64)


def wind_two_minute_mean(gps_time_s: np.ndarray, speed_m_s: np.ndarray) -> float:
    """Greatest mean wind over two minutes; the mean of all when the record is shorter. [m/s]

    Each window ends at a record and holds the records of the 120 s before it (GB/T 28591: two-minute mean).
    """
    order = np.argsort(gps_time_s)
    time, speed = np.asarray(gps_time_s, float)[order], np.asarray(speed_m_s, float)[order]
    total = np.concatenate([[0.0], np.cumsum(speed)])
    first = np.searchsorted(time, time - 120.0)
    full = time >= time[0] + 120.0
    if not full.any():
        return float(speed.mean())
    last = np.arange(1, time.size + 1)
    means = (total[last] - total[first]) / (last - first)
    return float(means[full].max())
