"""The flight: strips on several headings through the range's centre, joined by turns within the platform's acceleration.

Every design height is one sortie, take-off apart. Along a strip the autopilot holds line, height and speed up to `track_std_m`;
the body leans into wind and acceleration and sways with a period of some seconds. Wind is a mean. The path here is the truth.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from campaign.config import Config
from campaign.errors import ConfigError
from scenes.model import Layout
from simulator.flight.motion import Motion, Strip
from simulator.randomness import Stream, generator
from simulator.times import gps_time_from_iso

GRAVITY_M_S2 = 9.80665
BETWEEN_SORTIES_S = 600.0  # landing, battery, take-off
SETTLE_S = 4.0  # straight flight before the first and after the last strip
STABLE_ACCELERATION_SHARE = 0.8  # of the platform's limit, used in turns


@dataclass(frozen=True, kw_only=True)
class Sortie:
    number: int
    motion: Motion
    strips: tuple[Strip, ...]


@dataclass(frozen=True, kw_only=True)
class Line:
    """One strip as designed, world frame."""

    heading_deg: float
    height_m: float
    start_m: np.ndarray  # (3,)
    end_m: np.ndarray  # (3,)

    @property
    def direction(self) -> np.ndarray:
        d = self.end_m - self.start_m
        return np.asarray(d / np.linalg.norm(d))


def design_lines(config: Config, layout: Layout, height_m: float) -> list[Line]:
    """Strips of one height: for each heading, `strips_per_heading` parallel lines about the centre."""
    flight = config.flight
    across_half = height_m * np.tan(np.radians(max(map(abs, config.lidar.scanner.sector_deg))))
    if config.lidar.scanner.sector_deg[1] - config.lidar.scanner.sector_deg[0] >= 180.0:
        across_half = height_m  # +-45 degrees of a full circle
    spacing = 2.0 * across_half * (1.0 - flight.side_overlap)
    lines = []
    for heading in flight.headings_deg:
        a = np.radians(heading)
        along = np.array([np.sin(a), np.cos(a), 0.0])
        right = np.array([np.cos(a), -np.sin(a), 0.0])
        half = abs(along[0]) * layout.field_half_m[0] + abs(along[1]) * layout.field_half_m[1] + flight.run_in_m
        for k in range(flight.strips_per_heading):
            centre = right * spacing * (k - (flight.strips_per_heading - 1) / 2.0) + np.array([0.0, 0.0, height_m])
            lines.append(
                Line(
                    heading_deg=heading % 360.0,
                    height_m=height_m,
                    start_m=centre - along * half,
                    end_m=centre + along * half,
                )
            )
    return lines


def exposure_offsets_m(count: int, spacing_m: float) -> list[float]:
    """Along-track aims of a strip's exposures from its middle: 0, +s, -s, +2s ... so that one always looks at the centre."""
    return sorted(spacing_m * ((k + 1) // 2) * (1 if k % 2 else -1) for k in range(count))


def _quintic(p0: np.ndarray, v0: np.ndarray, p1: np.ndarray, v1: np.ndarray, duration: float) -> np.ndarray:
    """Coefficients (6, 3) of the polynomial in t that joins two states with no acceleration at either end."""
    t = duration
    c3 = (20 * (p1 - p0) - (8 * v1 + 12 * v0) * t) / (2 * t**3)
    c4 = (30 * (p0 - p1) + (14 * v1 + 16 * v0) * t) / (2 * t**4)
    c5 = (12 * (p1 - p0) - 6 * (v1 + v0) * t) / (2 * t**5)
    return np.stack([p0, v0, np.zeros(3), c3, c4, c5])


def _turn(p0: np.ndarray, v0: np.ndarray, p1: np.ndarray, v1: np.ndarray, limit: float) -> tuple[np.ndarray, float]:
    """The quickest such polynomial whose acceleration stays under `limit`. [m/s2]"""
    duration = 2.0
    while True:
        c = _quintic(p0, v0, p1, v1, duration)
        t = np.linspace(0.0, duration, 200)[:, None]
        acceleration = 6 * c[3] * t + 12 * c[4] * t**2 + 20 * c[5] * t**3
        if np.linalg.norm(acceleration, axis=1).max() <= limit:
            return c, duration
        duration *= 1.1


def _sway(rng: np.random.Generator, t: np.ndarray, std: float, period_s: float, parts: int = 5) -> np.ndarray:
    """A smooth zero-mean process: `parts` sines with periods of 0.6 to 2.5 times `period_s`, standard deviation `std`."""
    periods = period_s * np.exp(rng.uniform(np.log(0.6), np.log(2.5), parts))
    phases = rng.uniform(0.0, 2.0 * np.pi, parts)
    return std * np.sqrt(2.0 / parts) * np.sin(2.0 * np.pi * t[:, None] / periods + phases).sum(axis=1)


def _wind_world(config: Config) -> np.ndarray:
    a = np.radians(config.environment.wind_from_deg)
    return -config.environment.wind_speed_m_s * np.array([np.sin(a), np.cos(a), 0.0])


def speeds_m_s(config: Config) -> tuple[float, ...]:
    """Ground speed of each sortie, in the order of `flight.heights_m`. [m/s]

    Raises
    ------
    ConfigError
        `flight.speeds_m_s` has another length than `flight.heights_m`.
    """
    flight = config.flight
    if flight.speeds_m_s is None:
        return (flight.speed_m_s,) * len(flight.heights_m)
    if len(flight.speeds_m_s) != len(flight.heights_m):
        raise ConfigError(
            "one speed for each height",
            where="flight.speeds_m_s",
            got=f"{len(flight.speeds_m_s)} speeds",
            expected=f"{len(flight.heights_m)}, as many as flight.heights_m",
        )
    return flight.speeds_m_s


def trigger_lead_m(config: Config, line: Line, speed_m_s: float) -> float:
    """How far past the middle of a strip the body is when its camera, leaning by the mean pitch, looks at that middle. [m]"""
    air_speed = speed_m_s - float(_wind_world(config) @ line.direction)
    return -line.height_m * float(np.tan(np.radians(config.platform.pitch_per_speed_deg_s_m * air_speed)))


def _fly_sortie(config: Config, lines: list[Line], speed: float, number: int, start_s: float) -> Sortie:
    flight, platform = config.flight, config.platform
    rng = generator(config.seed, Stream.FLIGHT, number)
    limit = STABLE_ACCELERATION_SHARE * platform.max_acceleration_m_s2
    # Pieces of the design path: (polynomial, duration, heading at start, heading at end)
    pieces: list[tuple[np.ndarray, float, float, float]] = []
    starts: list[float] = []
    clock = 0.0

    def straight(p0: np.ndarray, v: np.ndarray, duration: float, heading: float) -> None:
        nonlocal clock
        c = np.zeros((6, 3))
        c[0], c[1] = p0, v
        pieces.append((c, duration, heading, heading))
        clock += duration

    for k, line in enumerate(lines):
        v = line.direction * speed
        if k == 0:
            straight(line.start_m - v * SETTLE_S, v, SETTLE_S, line.heading_deg)
        starts.append(clock)
        straight(line.start_m, v, float(np.linalg.norm(line.end_m - line.start_m)) / speed, line.heading_deg)
        if k + 1 < len(lines):
            after = lines[k + 1]
            # a second of straight flight before the next strip, so that its edge is flown at rest of attitude
            lead = after.direction * speed
            c, duration = _turn(line.end_m, v, after.start_m - lead, lead, limit)
            change = (after.heading_deg - line.heading_deg + 180.0) % 360.0 - 180.0
            pieces.append((c, duration, line.heading_deg, line.heading_deg + change))
            clock += duration
            straight(after.start_m - lead, lead, 1.0, after.heading_deg)
        else:
            straight(line.end_m, v, SETTLE_S, line.heading_deg)

    rate = config.navigation.rate_hz
    t = np.arange(int(np.floor(clock * rate)) + 1) / rate
    edges = np.concatenate([[0.0], np.cumsum([p[1] for p in pieces])])
    which = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(pieces) - 1)
    coefficients = np.stack([p[0] for p in pieces])[which]
    local = (t - edges[which])[:, None]
    position = sum(coefficients[:, k] * local**k for k in range(6))
    velocity = sum(k * coefficients[:, k] * local ** (k - 1) for k in range(1, 6))
    acceleration = sum(k * (k - 1) * coefficients[:, k] * local ** (k - 2) for k in range(2, 6))
    share = local[:, 0] / np.array([p[1] for p in pieces])[which]
    smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    h0, h1 = np.array([p[2] for p in pieces])[which], np.array([p[3] for p in pieces])[which]
    heading = np.unwrap(np.radians(h0 + (h1 - h0) * smooth))

    # what the autopilot does not hold
    for axis in range(3):
        wander = _sway(rng, t, platform.track_std_m, 12.0)
        position[:, axis] += wander
        velocity[:, axis] += np.gradient(wander, t)

    forward = np.stack([np.sin(heading), np.cos(heading), np.zeros_like(heading)], axis=1)
    right = np.stack([np.cos(heading), -np.sin(heading), np.zeros_like(heading)], axis=1)
    air = velocity - _wind_world(config)
    lean = -platform.pitch_per_speed_deg_s_m
    pitch = -np.radians(lean) * (air * forward).sum(1) - np.arctan2((acceleration * forward).sum(1), GRAVITY_M_S2)
    roll = np.radians(lean) * (air * right).sum(1) + np.arctan2((acceleration * right).sum(1), GRAVITY_M_S2)
    period = platform.attitude_period_s
    roll = roll + _sway(rng, t, np.radians(platform.roll_std_deg), period)
    pitch = pitch + _sway(rng, t, np.radians(platform.pitch_std_deg), period)
    heading = heading + _sway(rng, t, np.radians(platform.heading_std_deg), period)

    strips = tuple(
        Strip(
            sortie=number,
            number=k + 1,
            heading_deg=line.heading_deg,
            height_m=line.height_m,
            start_s=start_s + begin,
            end_s=start_s + begin + float(np.linalg.norm(line.end_m - line.start_m)) / speed,
            exposure_s=tuple(
                start_s + begin + (float(np.linalg.norm(line.end_m - line.start_m)) / 2.0 + lead + offset) / speed
                for offset in exposure_offsets_m(flight.images_per_strip, flight.image_spacing_m)
            ),
        )
        for k, (line, begin) in enumerate(zip(lines, starts, strict=True))
        for lead in (trigger_lead_m(config, line, speed),)
    )
    motion = Motion(
        gps_time_s=start_s + t,
        position_world_m=position,
        velocity_world_m_s=velocity,
        rpy_rad=np.stack([roll, pitch, heading], axis=1),
    )
    return Sortie(number=number, motion=motion, strips=strips)


def fly(config: Config, layout: Layout) -> tuple[Sortie, ...]:
    """Fly every height, one sortie each; the first strip of the first sortie begins at campaign.start_time."""
    sorties: list[Sortie] = []
    start = gps_time_from_iso(config.campaign.start_time) - SETTLE_S
    speeds = speeds_m_s(config)
    for number, (height, speed) in enumerate(zip(config.flight.heights_m, speeds, strict=True), start=1):
        sortie = _fly_sortie(config, design_lines(config, layout, height), speed, number, start)
        sorties.append(sortie)
        start = float(np.ceil(sortie.motion.gps_time_s[-1])) + BETWEEN_SORTIES_S
    for before, after in pairwise(sorties):
        assert before.motion.gps_time_s[-1] < after.motion.gps_time_s[0]
    return tuple(sorties)
