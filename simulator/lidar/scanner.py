"""How the beam moves: which pulses are fired inside the sector, when, at which encoder angle, and where they point.

A scanner enumerates only the pulses whose encoder angle lies in the configured sector; the map from a pulse's number to its
time is in closed form, so any chunk of a strip can be produced alone. Beams are in the lidar frame: (0, sin, cos) of the
encoder angle, positive to the right, tilted along x by a channel's elevation. Poses and encoder noise are applied elsewhere.
"""

from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np

from campaign.config import Lidar
from campaign.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class PulseAngles:
    """n pulses."""

    time_s: np.ndarray  # (n,) float64 since the strip's start
    encoder_angle_rad: np.ndarray  # (n,) float64, 0 = nadir, positive to the right
    channel: np.ndarray  # (n,) uint8
    direction_lidar: np.ndarray  # (n, 3) float64 unit vectors


class Scanner(Protocol):
    """What the simulation of a strip asks of a scanner. A Risley pair or an oscillating mirror fits the same five."""

    @property
    def pulse_interval_s(self) -> float:
        """Between two pulses that the same receiver waits for: bounds the unambiguous range."""
        ...

    @property
    def stride(self) -> int:
        """Pulses i and i + stride point to nearly the same place: the number of channels fired in turn."""
        ...

    def pulse_count(self, duration_s: float) -> int:
        """Pulses fired inside the sector before `duration_s`."""
        ...

    def pulses(self, index: np.ndarray) -> PulseAngles:
        """(n,) int64 numbers, from 0, among the pulses inside the sector."""
        ...

    def direction(self, encoder_angle_rad: np.ndarray, channel: np.ndarray) -> np.ndarray:
        """(n, 3) unit vectors in the lidar frame for encoder readings, which may carry noise."""
        ...


@dataclass(frozen=True, kw_only=True)
class TurningScanner:
    """A beam, or a fan of channels fired in turn, turned about the flight axis at constant speed.

    In every scan line the encoder runs once from `start_rad` over `sweep_rad`; one full turn, or one facet of a polygon. The
    first pulse kept in a line is the first one fired at or after the sector's left edge; every line keeps the same number.
    """

    prr_hz: float
    scan_rate_hz: float
    start_rad: float
    sweep_rad: float
    sector_rad: tuple[float, float]
    elevation_rad: tuple[float, ...]  # of each channel; one zero for a line scanner

    @property
    def pulse_interval_s(self) -> float:
        return len(self.elevation_rad) / self.prr_hz

    @property
    def stride(self) -> int:
        return len(self.elevation_rad)

    @property
    def pulses_per_line(self) -> int:
        """Kept in each line."""
        share = (self.sector_rad[1] - self.sector_rad[0]) / self.sweep_rad
        return int(np.floor(share * self.prr_hz / self.scan_rate_hz + 1e-6))

    def _first_pulse(self, line: np.ndarray) -> np.ndarray:
        """Number, among all pulses fired since the start, of the first one inside the sector of each line."""
        edge = (self.sector_rad[0] - self.start_rad) / self.sweep_rad
        return np.ceil((line + edge) * (self.prr_hz / self.scan_rate_hz) - 1e-6).astype(np.int64)

    def pulse_count(self, duration_s: float) -> int:
        fired = int(np.ceil(duration_s * self.prr_hz - 1e-6))
        lines = np.arange(max(0, int(duration_s * self.scan_rate_hz) - 2), int(duration_s * self.scan_rate_hz) + 2)
        kept = np.clip(fired - self._first_pulse(lines), 0, self.pulses_per_line)
        return int(lines[0] * self.pulses_per_line + kept.sum())

    def pulses(self, index: np.ndarray) -> PulseAngles:
        n = len(index)
        time, angle, channel = np.empty(n), np.empty(n), np.empty(n, np.uint8)
        setting = (self.prr_hz, self.scan_rate_hz, self.start_rad, self.sweep_rad, self.sector_rad[0])
        _turning(
            np.asarray(index, np.int64), self.pulses_per_line, setting, len(self.elevation_rad), time, angle, channel
        )
        return PulseAngles(
            time_s=time,
            encoder_angle_rad=angle,
            channel=channel,
            direction_lidar=self.direction(angle, channel),
        )

    def direction(self, encoder_angle_rad: np.ndarray, channel: np.ndarray) -> np.ndarray:
        out = np.empty((len(encoder_angle_rad), 3))
        elevation = np.asarray(self.elevation_rad)
        _fan(np.sin(encoder_angle_rad), np.cos(encoder_angle_rad), channel, np.sin(elevation), np.cos(elevation), out)
        return out


@numba.njit(cache=True, nogil=True)
def _turning(
    index: np.ndarray,
    per_line: int,
    setting: tuple[float, float, float, float, float],
    channels: int,
    time: np.ndarray,
    angle: np.ndarray,
    channel: np.ndarray,
) -> None:
    """Pulse rate, scan rate, start, sweep and left edge of the sector, in `setting`; see `TurningScanner._first_pulse`."""
    prr, rate, start, sweep, left = setting
    edge = (left - start) / sweep
    for i in range(len(index)):
        line = index[i] // per_line
        fired = int(np.ceil((line + edge) * (prr / rate) - 1e-6)) + index[i] - line * per_line
        time[i] = fired / prr
        angle[i] = start + sweep * (time[i] * rate - line)
        channel[i] = fired % channels


@numba.njit(cache=True, nogil=True)
def _fan(
    across: np.ndarray, down: np.ndarray, channel: np.ndarray, sine: np.ndarray, cosine: np.ndarray, out: np.ndarray
) -> None:
    """`sine`, `cosine`: of each channel's elevation."""
    for i in range(len(across)):
        out[i, 0] = sine[channel[i]]
        out[i, 1] = cosine[channel[i]] * across[i]
        out[i, 2] = cosine[channel[i]] * down[i]


def scanner_from(lidar: Lidar) -> Scanner:
    """The scanner that a configuration describes.

    Raises
    ------
    ConfigError
        A sector outside the beam's sweep or without a pulse; channels missing, or given to a line scanner; a sensor whose
        pulse rate is below its scan rate.
    """
    s = lidar.scanner
    half = 180.0 * s.turn_share
    left, right = s.sector_deg
    if not -half <= left < right <= half:
        raise ConfigError(
            "the sector is not inside the beam's sweep",
            where="lidar.scanner.sector_deg",
            got=[left, right],
            expected=f"{-half:g} <= left < right <= {half:g} (lidar.scanner.turn_share = {s.turn_share:g})",
        )
    if s.type == "channels" and not 1 <= len(s.channel_elevations_deg) <= 256:
        raise ConfigError(
            "a scanner of type channels needs the tilt of each beam",
            where="lidar.scanner.channel_elevations_deg",
            got=f"{len(s.channel_elevations_deg)} values",
            expected="1 to 256 values",
        )
    if s.type == "line" and s.channel_elevations_deg:
        raise ConfigError(
            "a line scanner has one beam",
            where="lidar.scanner.channel_elevations_deg",
            got=f"{len(s.channel_elevations_deg)} values",
            expected="none",
            remedy='set lidar.scanner.type = "channels", or remove the list',
        )
    scanner = TurningScanner(
        prr_hz=lidar.prr_hz,
        scan_rate_hz=s.scan_rate_hz,
        start_rad=float(np.radians(-half)),
        sweep_rad=float(np.radians(2.0 * half)),
        sector_rad=(float(np.radians(left)), float(np.radians(right))),
        elevation_rad=tuple(float(v) for v in np.radians(s.channel_elevations_deg)) or (0.0,),
    )
    if scanner.pulses_per_line < 1:
        raise ConfigError(
            "no pulse falls into the sector",
            where="lidar.prr_hz",
            got=f"{lidar.prr_hz:g} Hz at {s.scan_rate_hz:g} lines a second",
            expected="at least one pulse per line and sector",
            remedy="raise lidar.prr_hz, lower lidar.scanner.scan_rate_hz or widen the sector",
        )
    return scanner
