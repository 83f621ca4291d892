"""The post-processed trajectory: SBET (.out), smrmsg.out and trajectory.csv. Time is adjusted standard GPS time in memory."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from campaign.errors import CampaignError
from campaign.formats.text import write_rows
from campaign.writing.atomic import complete_file

WEEK_S = 604_800
ADJUSTED_OFFSET_S = 1_000_000_000
GPS_MINUS_UTC_S = 18
MAX_AWAY_DEG = 0.5  # of a record from the site's origin, north; three times that east
MAX_HOLE_S = 2.0  # over which a position may be interpolated
_ARCMIN = np.pi / 180.0 / 60.0


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


def week_start_s(gps_week: int) -> float:
    """Adjusted standard GPS time at which a GPS week begins. A whole number, so that time of week converts without rounding."""
    return float(gps_week * WEEK_S - ADJUSTED_OFFSET_S)


def write_sbet(path: Path, trajectory: Trajectory, gps_week: int) -> None:
    """17 little-endian doubles an epoch; time as seconds of `gps_week` (may pass 604800 at a week's end). Wander angle 0."""
    t = trajectory
    zero = np.zeros(len(t.gps_time_s))
    columns = [t.gps_time_s - week_start_s(gps_week), t.latitude_rad, t.longitude_rad, t.ellipsoid_height_m]
    columns += [*t.velocity_ned_m_s.T, t.roll_rad, t.pitch_rad, t.heading_rad, zero]
    columns += [*t.acceleration_body_m_s2.T, *t.angular_rate_body_rad_s.T]
    _write_doubles(path, columns)


def write_smrmsg(path: Path, trajectory: Trajectory, gps_week: int) -> None:
    """10 doubles an epoch: time, position RMS n e d [m], velocity RMS [m/s] (0: not stated), roll pitch heading RMS [arcmin]."""
    t = trajectory
    zero = np.zeros(len(t.gps_time_s))
    time = t.gps_time_s - week_start_s(gps_week)
    _write_doubles(path, [time, *t.position_std_m.T, zero, zero, zero, *(t.attitude_std_rad / _ARCMIN).T])


def beijing_time(gps_time_s: np.ndarray) -> np.ndarray:
    """(n,) adjusted standard GPS time -> (n,) datetime64[us] of Beijing (UTC + 8 h), GPS - UTC = 18 s."""
    seconds = np.floor(gps_time_s)
    micros = np.round((gps_time_s - seconds) * 1e6)
    shift = ADJUSTED_OFFSET_S - GPS_MINUS_UTC_S + 8 * 3600
    return np.asarray(
        np.datetime64("1980-01-06T00:00:00", "us")
        + ((seconds + shift).astype(np.int64) * 1_000_000 + micros.astype(np.int64)).astype("timedelta64[us]")
    )


def write_csv(path: Path, trajectory: Trajectory) -> None:
    """The same for people: degrees, Beijing time beside GPS time."""
    t = trajectory
    values = {
        "latitude_deg": (np.degrees(t.latitude_rad), ".10f"),
        "longitude_deg": (np.degrees(t.longitude_rad), ".10f"),
        "ellipsoid_height_m": (t.ellipsoid_height_m, ".4f"),
        "roll_deg": (np.degrees(t.roll_rad), ".5f"),
        "pitch_deg": (np.degrees(t.pitch_rad), ".5f"),
        "heading_deg": (np.degrees(t.heading_rad), ".5f"),
        "velocity_north_m_s": (t.velocity_ned_m_s[:, 0], ".4f"),
        "velocity_east_m_s": (t.velocity_ned_m_s[:, 1], ".4f"),
        "velocity_down_m_s": (t.velocity_ned_m_s[:, 2], ".4f"),
    }
    times = np.datetime_as_string(beijing_time(t.gps_time_s), unit="ms").tolist()
    columns = [[f"{v:.6f}" for v in t.gps_time_s.tolist()], [f"{text}+08:00" for text in times]]
    columns += [[f"{v:{form}}" for v in array.tolist()] for array, form in values.values()]
    write_rows(path, ["gps_time_s", "beijing_time", *values], zip(*columns))


def read_trajectory(sbet: Path, smrmsg: Path | None, gps_week: int) -> Trajectory:
    """Raises CampaignError: empty, truncated, not finite, time not increasing.

    A file whose time of week starts again at 0 is carried on. Without smrmsg the standard deviations are NaN; one of
    another rate is interpolated. A wander angle w is taken out: heading = platform heading - w.
    """
    table = _read_doubles(sbet, 17)
    time = _time(sbet, table[:, 0], gps_week)
    if np.any(np.abs(table[:, 1]) > np.pi / 2.0) or np.any(np.abs(table[:, 2]) > 2.0 * np.pi):
        raise CampaignError("a latitude or longitude is out of range", where=str(sbet), expected="radians")
    if np.any(np.abs(table[:, 7:9]) > np.pi + 1e-6) or np.any(np.abs(table[:, 9:11]) > 2.0 * np.pi + 1e-6):
        raise CampaignError("a roll, pitch or heading is out of range", where=str(sbet), expected="radians")
    if np.any(np.abs(table[:, 3]) > 100_000.0):
        raise CampaignError("a height is out of range", where=str(sbet), expected="metres above the ellipsoid")
    wander = table[:, 10]
    velocity = table[:, 4:7].copy()
    heading = table[:, 9]
    if np.any(wander != 0.0):
        heading = np.mod(heading - wander, 2.0 * np.pi)
        c, s = np.cos(wander), np.sin(wander)
        velocity[:, 0], velocity[:, 1] = c * table[:, 4] + s * table[:, 5], c * table[:, 5] - s * table[:, 4]
    position_std = attitude_std = np.full((len(time), 3), np.nan)
    if smrmsg is not None:
        rms = _read_doubles(smrmsg, 10)
        at = _time(smrmsg, rms[:, 0], gps_week)
        columns = [np.interp(time, at, rms[:, i]) for i in (1, 2, 3, 7, 8, 9)]
        position_std, attitude_std = np.stack(columns[:3], axis=1), np.stack(columns[3:], axis=1) * _ARCMIN
    return Trajectory(
        gps_time_s=time,
        latitude_rad=table[:, 1].copy(),
        longitude_rad=table[:, 2].copy(),
        ellipsoid_height_m=table[:, 3].copy(),
        roll_rad=table[:, 7].copy(),
        pitch_rad=table[:, 8].copy(),
        heading_rad=heading.copy(),
        velocity_ned_m_s=velocity,
        acceleration_body_m_s2=table[:, 11:14].copy(),
        angular_rate_body_rad_s=table[:, 14:17].copy(),
        position_std_m=position_std,
        attitude_std_rad=attitude_std,
    )


def misplaced(trajectory: Trajectory, latitude_deg: float, longitude_deg: float) -> str | None:
    """Why a trajectory cannot be the site's: it is elsewhere on the Earth, or has a hole."""
    north = np.abs(np.degrees(trajectory.latitude_rad) - latitude_deg)
    east = np.abs((np.degrees(trajectory.longitude_rad) - longitude_deg + 180.0) % 360.0 - 180.0)
    if float(north.max()) > MAX_AWAY_DEG or float(east.max()) > MAX_AWAY_DEG * 3.0:
        at = f"{np.degrees(trajectory.latitude_rad[0]):.4f}, {np.degrees(trajectory.longitude_rad[0]):.4f}"
        return f"begins far from the site; got {at} degrees; expected near {latitude_deg:.4f}, {longitude_deg:.4f}"
    steps = np.diff(trajectory.gps_time_s)
    if steps.size and float(steps.max()) > max(MAX_HOLE_S, 3.0 * float(np.median(steps))):
        hole = int(np.argmax(steps))
        return f"has a hole of {steps[hole]:.1f} s after record {hole}; expected records without a gap"
    return None


def _write_doubles(path: Path, columns: list[np.ndarray]) -> None:
    with complete_file(path) as work:
        work.write_bytes(np.column_stack(columns).astype("<f8").tobytes())


def _read_doubles(path: Path, columns: int) -> np.ndarray:
    try:
        size = path.stat().st_size
        if size == 0:
            raise CampaignError("is empty", where=str(path), expected=f"records of {8 * columns} bytes")
        if size % (8 * columns):
            raise CampaignError(
                "is truncated", where=str(path), got=f"{size} bytes", expected=f"a multiple of {8 * columns} bytes"
            )
        table = np.fromfile(path, dtype="<f8").reshape(-1, columns).astype(float)
    except FileNotFoundError:
        raise CampaignError("no such file", where=str(path)) from None
    except OSError as error:
        raise CampaignError("cannot be read", where=str(path), got=error.strerror) from None
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if len(bad):
        raise CampaignError("a value is not finite", where=f"{path} record {bad[0]}", expected="numbers")
    return table


def _time(path: Path, seconds: np.ndarray, gps_week: int) -> np.ndarray:
    """Seconds of the week -> adjusted standard GPS time; a step back of a week is a new week."""
    steps = np.diff(seconds)
    seconds = seconds + WEEK_S * np.concatenate([[0], np.cumsum(steps < -WEEK_S / 2)])
    back = np.flatnonzero(np.diff(seconds) <= 0.0)
    if len(back):
        raise CampaignError(
            "time does not increase", where=f"{path} record {back[0] + 1}", got=f"{seconds[back[0] + 1]:.6f}"
        )
    if seconds[0] < 0.0 or seconds[-1] > 2 * WEEK_S:
        raise CampaignError(
            "time is no GPS seconds of the week", where=str(path), got=f"{seconds[0]:.3f}", expected="0 to 604800"
        )
    return np.asarray(seconds + week_start_s(gps_week))
