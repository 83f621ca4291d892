"""One strip of the LiDAR, from true motion to LAS rows: beams, waveforms, the device's echoes, and their georeferencing.

Streams in chunks of fixed size, several at once, each on a thread of its own. Two motions meet here: the true one steers the
beams, the estimated one at the stamped time with the nominal mounting places the returns, as post-processing does on real data.
Formulas of the received power are in `simulator.lidar.radar_equation`, what a beam sees in `simulator.pulses`, echo detection in
`simulator.lidar.device`.
"""

import itertools
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from campaign.config import Config, Faults, Lidar
from campaign.errors import ConfigError
from campaign.flight.las import Returns
from campaign.threads import thread_count
from campaign.truth import TrueReturns
from scenes.model import Scene
from scenes.spectra import reflectance_at
from simulator.flight.frames import SiteFrame
from simulator.flight.georeference import MapPatch, Track
from simulator.flight.motion import Motion, SensorMounting, Strip
from simulator.lidar.device import Device, pulse_normals
from simulator.lidar.footprint import Optics, gaussian_footprint
from simulator.lidar.radar_equation import (
    FWHM_PER_SIGMA,
    SPEED_OF_LIGHT_M_S,
    echo_fwhm_ns,
    extinction_per_km,
    unambiguous_range_m,
)
from simulator.lidar.response import response_constant_dn_m2
from simulator.lidar.scanner import scanner_from
from simulator.pulses.caster import Caster
from simulator.pulses.rows import attributes, finish, inside, place, select
from simulator.randomness import Stream, key

if TYPE_CHECKING:
    from simulator.render.scene import RenderScene

BLOCK = 16_384  # pulses that are worked on at once; a chunk is whole blocks
HALF_C_M_PS = 0.5 * SPEED_OF_LIGHT_M_S * 1e-12  # length of the packets' direction vector


@dataclass(frozen=True, kw_only=True)
class StripChunk:
    """Rows of one chunk; `returns.packet` counts from 0 within `packets`."""

    returns: Returns
    packets: np.ndarray  # (p, samples) uint16
    truth: TrueReturns


class Chart(Protocol):
    """From the axes that beams are traced in to the coordinates that are written."""

    origin_m: np.ndarray  # (3,)

    def relative(self, world_m: np.ndarray) -> np.ndarray:
        """(n, 3) -> (n, 3) minus `origin_m`. [m]"""
        ...


def optics_from(lidar: Lidar, visibility_km: float) -> Optics:
    """What the ray tracer needs to know of device and air."""
    sigma_ns = echo_fwhm_ns(lidar.pulse_fwhm_ns, lidar.receiver_fwhm_ns) / FWHM_PER_SIGMA
    return Optics(
        footprint=gaussian_footprint(lidar.subrays, lidar.divergence_rad),
        echo_sigma_ns=sigma_ns,
        sampling_ns=lidar.sampling_ns,
        samples=lidar.samples,
        pre_samples=min(int(np.ceil(6.0 * sigma_ns / lidar.sampling_ns)), lidar.samples // 4),
        scale_dn_m2=response_constant_dn_m2(lidar),
        extinction_per_m=extinction_per_km(lidar.wavelength_nm * 1e-3, visibility_km) * 1e-3,
    )


def backscatter(scene: Scene, wavelength_nm: float) -> np.ndarray:
    """(materials,) pi times each BRDF towards the source, where a LiDAR always looks: rho (1 + opposition gain)."""
    return np.array([float(reflectance_at(m, wavelength_nm)) * (1.0 + m.opposition_gain) for m in scene.materials])


def measured_range_m(range_m: np.ndarray, faults: Faults) -> np.ndarray:
    """What a LiDAR with the faults of range shows for ranges (n,): offset, scale and table add up. [m]"""
    out = range_m * (1.0 + faults.range_scale) + faults.range_offset_m
    if faults.range_table:
        out += np.interp(range_m, *np.array(sorted(faults.range_table)).T)
    return out


def simulate_strip(
    render_scene: "RenderScene",
    config: Config,
    strip: Strip,
    true_motion: Motion,
    estimated_motion: Motion,
    true_mounting: SensorMounting,
    nominal_mounting: SensorMounting,
    site_frame: SiteFrame,
) -> Iterator[StripChunk]:
    """Fire every pulse of one strip inside the scanner's sector; coordinates are the map's. See `observe`."""
    chart = MapPatch(site_frame)
    return observe(
        render_scene, config, strip, true_motion, estimated_motion, true_mounting, nominal_mounting, chart, Stream.LIDAR
    )


def observe(
    render_scene: "RenderScene",
    config: Config,
    strip: Strip,
    true_motion: Motion,
    estimated_motion: Motion,
    true_mounting: SensorMounting,
    nominal_mounting: SensorMounting,
    chart: Chart,
    stream: Stream,
) -> Iterator[StripChunk]:
    """Beams, waveforms, echoes and rows of one strip, or of one scan of the ranging line.

    Parameters
    ----------
    chart : Chart
        What places a return: the site's map, or the instrument's own axes.
    stream : Stream
        Of the noise, with the strip's sortie and number.

    Yields
    ------
    StripChunk
        In order of time; chunks without any return are left out. Memory does not grow with the strip.

    Raises
    ------
    ConfigError
        A surface beyond the unambiguous range, a trajectory that does not cover the strip, or a scanner that cannot be.
    """
    clock_s = config.faults.lidar_clock_s
    _require_cover(true_motion, strip, 0.0)
    _require_cover(estimated_motion, strip, clock_s)
    work = _Strip(
        render_scene.scene,
        config,
        strip,
        Track(true_motion, strip.start_s, strip.end_s),
        Track(estimated_motion, strip.start_s + clock_s, strip.end_s + clock_s),
        true_mounting,
        nominal_mounting,
        chart,
        stream,
    )
    threads = thread_count()
    starts = iter(range(0, work.count, config.recording.pulses_per_chunk))
    waiting: deque[Future[tuple[StripChunk | None, float]]] = deque()
    pool = ThreadPoolExecutor(threads)
    try:
        while True:
            for start in itertools.islice(starts, threads + 1 - len(waiting)):
                waiting.append(pool.submit(work.chunk, start))
            if not waiting:
                return
            chunk, farthest_m = waiting.popleft().result()
            _require_unambiguous(farthest_m, unambiguous_range_m(work.scanner.pulse_interval_s))
            if chunk is not None:
                yield chunk
    finally:
        pool.shutdown(cancel_futures=True)


def _require_cover(motion: Motion, strip: Strip, clock_s: float) -> None:
    first, last = float(motion.gps_time_s[0]), float(motion.gps_time_s[-1])
    if strip.start_s + min(clock_s, 0.0) < first or strip.end_s + max(clock_s, 0.0) > last:
        raise ConfigError(
            "the trajectory does not cover the strip",
            where=f"sortie {strip.sortie} strip {strip.number}",
            got=f"{first:.3f} to {last:.3f} s",
            expected=f"{strip.start_s:.3f} to {strip.end_s:.3f} s and faults.lidar_clock_s ({clock_s:g} s) around it",
        )


def _require_unambiguous(farthest: float, limit_m: float) -> None:
    if farthest > limit_m:
        raise ConfigError(
            "a surface lies beyond the range at which echoes of two pulses cannot be told apart",
            where="lidar.prr_hz",
            got=f"{farthest:.1f} m",
            expected=f"at most {limit_m:.1f} m, half the way of light between two pulses",
            remedy="lower lidar.prr_hz or flight.heights_m, or narrow lidar.scanner.sector_deg",
        )


@dataclass(frozen=True, kw_only=True)
class _Part:
    """Rows of one block. Fields as in `Returns` and `TrueReturns`."""

    returns: dict[str, np.ndarray]
    truth: dict[str, np.ndarray]


class _Strip:
    """Everything that does not change from pulse to pulse. `chunk` may be called from several threads, in any order."""

    def __init__(
        self,
        scene: Scene,
        config: Config,
        strip: Strip,
        true_track: Track,
        estimated_track: Track,
        true_mounting: SensorMounting,
        nominal_mounting: SensorMounting,
        chart: Chart,
        stream: Stream,
    ) -> None:
        lidar = config.lidar
        self.scanner = scanner_from(lidar)
        self.count = self.scanner.pulse_count(strip.end_s - strip.start_s)
        self._config, self._strip, self._chart = config, strip, chart
        self._true, self._estimated = (true_track, true_mounting), (estimated_track, nominal_mounting)
        self._optics = optics_from(lidar, config.environment.visibility_km)
        self._caster = Caster(scene.mesh, backscatter(scene, lidar.wavelength_nm), self._optics)
        self._device = Device(lidar)
        self._key = np.uint64(key(config.seed, stream, strip.sortie, strip.number))
        self._near_target = None if config.recording.waveforms == "all" else _NearTargets(config, scene)
        self._step_m = 0.5e-9 * SPEED_OF_LIGHT_M_S * lidar.sampling_ns
        self._setting = np.array([self._step_m, lidar.min_range_m, FWHM_PER_SIGMA * lidar.sampling_ns])

    def chunk(self, start: int) -> tuple[StripChunk | None, float]:
        """Rows of the chunk that begins with pulse `start`, None where no pulse gave an echo; the farthest surface hit [m]."""
        end = min(start + self._config.recording.pulses_per_chunk, self.count)
        packets = np.empty((end - start, self._config.lidar.samples), np.uint16)
        parts, farthest, stored = [], 0.0, 0
        for first in range(start, end, BLOCK):
            part, far_m, stored = self._block(first, min(BLOCK, end - first), packets, stored)
            farthest = max(farthest, far_m)
            parts.append(part)
        if not sum(len(p.returns["packet"]) for p in parts):
            return None, farthest
        joined = {name: np.concatenate([p.returns[name] for p in parts]) for name in parts[0].returns}
        known = {name: np.concatenate([p.truth[name] for p in parts]) for name in parts[0].truth}
        return (
            StripChunk(
                returns=Returns(**joined),
                packets=packets[:stored],
                truth=TrueReturns(**known),
            ),
            farthest,
        )

    def _block(self, first: int, n: int, packets: np.ndarray, stored: int) -> tuple[_Part, float, int]:
        """Rows of n pulses, the farthest surface, and how many of the chunk's `packets` are full: `stored` were before."""
        lidar, faults, scanner = self._config.lidar, self._config.faults, self.scanner
        # ---- fire: the true motion steers the beams ----
        pulses = scanner.pulses(np.arange(first, first + n))
        time_s = self._strip.start_s + pulses.time_s
        encoder_error, gain_error, timing_error = pulse_normals(self._key, first, n, lidar.samples)
        encoder_rad = pulses.encoder_angle_rad + np.radians(lidar.encoder_std_deg) * encoder_error
        shift_m = lidar.range_noise_m * timing_error.astype(np.float64)
        gain = np.maximum(faults.lidar_gain * (1.0 + lidar.gain_jitter * gain_error.astype(np.float64)), 0.0)
        origin, direction, _ = self._true[0].beams(time_s, self._true[1], pulses.direction_lidar)
        seen = self._caster.see(origin, direction, scanner.stride)
        waves, start, found = self._device.receive(seen, self._optics, shift_m, gain, self._key, first)
        # ---- post-processing: the estimated motion at the stamped time places the returns ----
        stamped = time_s + faults.lidar_clock_s
        beam = scanner.direction(encoder_rad, pulses.channel)
        origin, direction, level = self._estimated[0].beams(stamped, self._estimated[1], beam)
        rows = int(found.count.sum())
        kinds = (np.int64, np.uint8, np.uint8, np.float64, np.float64, np.float32, np.float32)
        out: list[np.ndarray] = [np.empty(rows, kind) for kind in kinds]
        device = (start, found.count, found.position, found.amplitude_dn, found.sigma)
        rows = select(seen.count, *device, self._setting, *out)
        pulse, number, siblings, seen_m, at, amplitude, width_ns = (a[:rows] for a in out)
        measured_m, world = measured_range_m(seen_m, faults), np.empty((rows, 3))
        place(pulse, measured_m, origin, direction, world)
        xyz, packet, location = np.empty((rows, 3)), np.empty(rows, np.int64), np.empty(rows, np.float32)
        towards = np.empty((rows, 3), np.float32)
        stored = finish(
            pulse,
            np.ones(rows, np.bool_) if self._near_target is None else self._near_target(world),
            at,
            self._chart.relative(world),
            self._chart.relative(origin),
            self._chart.origin_m,
            waves,
            stored,
            1e3 * lidar.sampling_ns,
            HALF_C_M_PS,
            xyz,
            packet,
            location,
            towards,
            packets,
        )
        own = (np.float64, np.uint16, np.float32, np.float32, np.uint8)
        row_time_s, intensity, scan_angle_deg, encoder_deg, channel = of = [np.empty(rows, kind) for kind in own]
        attributes(pulse, amplitude, stamped, level, encoder_rad, pulses.channel, *of)
        power = (amplitude * measured_m**2 / self._optics.scale_dn_m2).astype(np.float32)
        returns = {
            "xyz_m": xyz,
            "gps_time_s": row_time_s,
            "intensity": intensity,
            "return_number": number,
            "number_of_returns": siblings,
            "scan_angle_deg": scan_angle_deg,
            "encoder_angle_deg": encoder_deg,
            "channel": channel,
            "amplitude": amplitude,
            "pulse_width_ns": width_ns,
            "reflectance_db": np.float32(10.0) * np.log10(power),
            "strip": np.full(rows, self._strip.number, np.uint16),
            "packet": packet,
            "return_location_ps": location,
            "wave_direction_m_ps": towards,
        }
        truth = self._caster.truth(seen, pulse, siblings, seen_m, shift_m)
        far_m = float(np.fmax.reduce(seen.extent_m[:, 2], initial=0.0))
        return _Part(returns=returns, truth=truth), far_m, stored


class _NearTargets:
    """Whether a point lies within a target's size and margin, horizontally; by a raster whose cells err on the wide side."""

    CELL_M = 0.1

    def __init__(self, config: Config, scene: Scene) -> None:
        centre = np.array([t.mark_m[:2] for t in scene.targets]).reshape(-1, 2)
        radius = np.array([t.size_m for t in scene.targets]) + config.recording.target_margin_m + self.CELL_M
        self._low = (centre - radius[:, None]).min(axis=0) if len(centre) else np.zeros(2)
        high = (centre + radius[:, None]).max(axis=0) if len(centre) else np.zeros(2)
        shape = np.ceil((high - self._low) / self.CELL_M).astype(int) + 2
        self._inside = np.zeros(shape, bool)
        for middle, reach in zip(centre, radius, strict=True):
            first = np.floor((middle - reach - self._low) / self.CELL_M).astype(int).clip(0)
            last = np.ceil((middle + reach - self._low) / self.CELL_M).astype(int) + 1
            x, y = (self._low[k] + (np.arange(first[k], last[k]) + 0.5) * self.CELL_M - middle[k] for k in range(2))
            part = self._inside[first[0] : last[0], first[1] : last[1]]
            part |= x[: part.shape[0], None] ** 2 + y[None, : part.shape[1]] ** 2 <= reach**2

    def __call__(self, world_m: np.ndarray) -> np.ndarray:
        """(n, 3) -> (n,) bool."""
        keep = np.empty(len(world_m), np.bool_)
        inside(world_m, self._low, self.CELL_M, self._inside, keep)
        return keep
