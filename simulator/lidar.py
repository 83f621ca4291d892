"""One strip of the LiDAR, from true motion to LAS rows: beams, waveforms, the device's echoes, and their georeferencing.

Streams in chunks of fixed size. Two motions meet here: the true one steers the beams, the estimated one at the stamped time
with the nominal mounting places the returns, as post-processing does on real data. Formulas of the received power are in
`simulator.radar_equation`, the ray tracing in `simulator.render.waveforms`, echo detection in `simulator.device`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from campaign.config import Config, Faults, Lidar
from campaign.errors import ConfigError
from campaign.las import Returns
from campaign.threads import thread_count
from campaign.truth import TrueReturns
from scenes.model import Scene
from scenes.spectra import reflectance_at
from simulator.device import DetectedEchoes, Device, dn_per_w, draw_chance
from simulator.footprint import gaussian_footprint
from simulator.frames import SiteFrame
from simulator.georeference import MapPatch, beams_world
from simulator.motion import Motion, SensorMounting, Strip
from simulator.radar_equation import (
    FWHM_PER_SIGMA,
    SPEED_OF_LIGHT_M_S,
    echo_fwhm_ns,
    extinction_per_km,
    peak_power_w,
    unambiguous_range_m,
)
from simulator.randomness import Stream, generator
from simulator.scanner import Scanner, scanner_from

if TYPE_CHECKING:
    from simulator.render.scene import RenderScene
    from simulator.render.waveforms import Beams, Echoes, Optics, Tracer

BLOCK = 65_536  # pulses that share one random generator; a chunk is whole blocks
HALF_C_M_PS = 0.5 * SPEED_OF_LIGHT_M_S * 1e-12  # length of the packets' direction vector
ALONE_M = 0.05  # a single return this close to the beam's axis is the axis' surface


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


@dataclass(frozen=True, kw_only=True)
class _Shots:
    """Pulses of one chunk as fired."""

    time_s: np.ndarray  # (n,) true, adjusted standard GPS time
    encoder_rad: np.ndarray  # (n,) as read, with the encoder's error
    channel: np.ndarray  # (n,)
    beams: "Beams"
    gain: np.ndarray  # (n,)
    chance: np.ndarray  # (n, 2 samples) uint16, for the digitiser


def optics_from(lidar: Lidar, visibility_km: float) -> "Optics":
    """What the ray tracer needs to know of device and air.

    The receiver lowers a pulse's peak and keeps its energy, hence the ratio of the two widths.
    """
    from simulator.render.waveforms import Optics

    echo_ns = echo_fwhm_ns(lidar.pulse_fwhm_ns, lidar.receiver_fwhm_ns)
    peak_w = peak_power_w(lidar.pulse_energy_uj * 1e-6, lidar.pulse_fwhm_ns * 1e-9) * lidar.pulse_fwhm_ns / echo_ns
    sigma_ns = echo_ns / FWHM_PER_SIGMA
    return Optics(
        footprint=gaussian_footprint(lidar.subrays, lidar.divergence_rad),
        echo_sigma_ns=sigma_ns,
        sampling_ns=lidar.sampling_ns,
        samples=lidar.samples,
        pre_samples=min(int(np.ceil(6.0 * sigma_ns / lidar.sampling_ns)), lidar.samples // 4),
        scale_dn_m2=dn_per_w(lidar) * peak_w * lidar.aperture_diameter_m**2 * lidar.system_efficiency / 4.0,
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
    from simulator.render.waveforms import Tracer

    lidar = config.lidar
    scanner = scanner_from(lidar)
    for motion, clock_s in ((true_motion, 0.0), (estimated_motion, config.faults.lidar_clock_s)):
        _require_cover(motion, strip, clock_s)
    optics = optics_from(lidar, config.environment.visibility_km)
    tracer = Tracer(render_scene, backscatter(render_scene.scene, lidar.wavelength_nm), optics)
    post = _PostProcessing(config, strip, estimated_motion, nominal_mounting, chart, render_scene.scene, optics)
    device = Device(lidar, threads=thread_count())
    count = scanner.pulse_count(strip.end_s - strip.start_s)
    limit_m = unambiguous_range_m(scanner.pulse_interval_s)
    starts = range(0, count, config.recording.pulses_per_chunk)
    try:
        ahead = None
        for start in [*starts, None]:
            # While the workers trace one chunk, this thread aims the next one and reads out the one before.
            shots = None
            if start is not None:
                shots = _aim(config, strip, scanner, start, count, true_motion, true_mounting, stream)
            echoes = None if ahead is None else ahead[1]()
            launched = None if shots is None else (shots, tracer.launch(shots.beams))
            if ahead is not None and echoes is not None:
                _require_unambiguous(echoes, limit_m)
                waves = device.digitise(echoes.waveform_dn, ahead[0].chance, ahead[0].gain)
                chunk = post.rows(ahead[0], echoes, device.detect(waves), waves, scanner, tracer)
                if chunk is not None:
                    yield chunk
            ahead = launched
    finally:
        device.close()


def _require_cover(motion: Motion, strip: Strip, clock_s: float) -> None:
    first, last = float(motion.gps_time_s[0]), float(motion.gps_time_s[-1])
    if strip.start_s + min(clock_s, 0.0) < first or strip.end_s + max(clock_s, 0.0) > last:
        raise ConfigError(
            "the trajectory does not cover the strip",
            where=f"sortie {strip.sortie} strip {strip.number}",
            got=f"{first:.3f} to {last:.3f} s",
            expected=f"{strip.start_s:.3f} to {strip.end_s:.3f} s and faults.lidar_clock_s ({clock_s:g} s) around it",
        )


def _require_unambiguous(echoes: "Echoes", limit_m: float) -> None:
    farthest = float(echoes.last_range_m.max())
    if farthest > limit_m:
        raise ConfigError(
            "a surface lies beyond the range at which echoes of two pulses cannot be told apart",
            where="lidar.prr_hz",
            got=f"{farthest:.1f} m",
            expected=f"at most {limit_m:.1f} m, half the way of light between two pulses",
            remedy="lower lidar.prr_hz or flight.heights_m, or narrow lidar.scanner.sector_deg",
        )


def _aim(
    config: Config,
    strip: Strip,
    scanner: Scanner,
    start: int,
    count: int,
    motion: Motion,
    mounting: SensorMounting,
    stream: Stream,
) -> _Shots:
    """True beams of the chunk that begins with pulse `start`, and all its random numbers."""
    from simulator.render.waveforms import Beams

    lidar, faults = config.lidar, config.faults
    index = np.arange(start, min(start + config.recording.pulses_per_chunk, count))
    normals, chances = [], []
    for block in range(start, start + len(index), BLOCK):
        rng = generator(config.seed, stream, strip.sortie, strip.number, block // BLOCK)
        size = min(BLOCK, count - block)
        normals.append(rng.standard_normal((3, size)))
        chances.append(draw_chance(rng, size, lidar.samples))
    encoder_error, gain_error, timing_error = np.concatenate(normals, axis=1)
    pulses = scanner.pulses(index)
    time = strip.start_s + pulses.time_s
    origin, direction, _ = beams_world(motion, time, mounting, pulses.direction_lidar)
    return _Shots(
        time_s=time,
        encoder_rad=pulses.encoder_angle_rad + np.radians(lidar.encoder_std_deg) * encoder_error,
        channel=pulses.channel,
        beams=Beams(origin_m=origin, direction=direction, shift_m=lidar.range_noise_m * timing_error),
        gain=np.maximum(faults.lidar_gain * (1.0 + lidar.gain_jitter * gain_error), 0.0),
        chance=chances[0] if len(chances) == 1 else np.concatenate(chances),
    )


class _PostProcessing:
    """What the operator's software does with a strip: measured range, place on the map, LAS attributes, kept packets."""

    def __init__(
        self,
        config: Config,
        strip: Strip,
        motion: Motion,
        mounting: SensorMounting,
        chart: Chart,
        scene: Scene,
        optics: "Optics",
    ) -> None:
        self._config = config
        self._strip = strip
        self._motion = motion
        self._mounting = mounting
        self._map = chart
        self._scale_dn_m2 = optics.scale_dn_m2
        self._near_target = None if config.recording.waveforms == "all" else _NearTargets(config, scene)
        corner = scene.mesh.vertices_m[scene.mesh.faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        self._normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
        self._mesh = scene.mesh

    def rows(
        self,
        shots: _Shots,
        echoes: "Echoes",
        found: DetectedEchoes,
        waves: np.ndarray,
        scanner: Scanner,
        tracer: "Tracer",
    ) -> StripChunk | None:
        """LAS rows of one chunk, None where no pulse gave an echo."""
        lidar, faults = self._config.lidar, self._config.faults
        step_m = 0.5e-9 * SPEED_OF_LIGHT_M_S * lidar.sampling_ns
        device_range = (echoes.start_sample[:, None] + found.position) * step_m
        valid = device_range >= lidar.min_range_m  # NaN, no echo, is not
        valid &= echoes.hits[:, None] > 0  # a packet is recorded only where light came back
        pulse, echo = np.nonzero(valid)
        if len(pulse) == 0:
            return None
        per_pulse = valid.sum(axis=1)
        position = found.position[pulse, echo]
        measured = measured_range_m(device_range[pulse, echo], faults)
        amplitude = found.amplitude_dn[pulse, echo]

        stamped = shots.time_s + faults.lidar_clock_s
        beam = scanner.direction(shots.encoder_rad, shots.channel)
        origin, direction, rpy = beams_world(self._motion, stamped, self._mounting, beam)
        heading = rpy[:, 2]
        right = direction[:, 0] * np.cos(heading) - direction[:, 1] * np.sin(heading)
        scan_angle = np.degrees(np.arctan2(right, -direction[:, 2]))
        world = origin[pulse] + measured[:, None] * direction[pulse]
        on_map = self._map.relative(world)
        towards = self._map.relative(origin)[pulse] - on_map
        towards *= (HALF_C_M_PS / np.sqrt((towards**2).sum(axis=1)))[:, None]

        keep = np.ones(len(pulse), bool) if self._near_target is None else self._near_target(world)
        stored = np.zeros(len(waves), bool)
        stored[pulse[keep]] = True
        number = np.where(stored, np.cumsum(stored) - 1, -1)
        returns = Returns(
            xyz_m=on_map + self._map.origin_m,
            gps_time_s=stamped[pulse],
            intensity=np.clip(np.round(16.0 * amplitude), 0, 65535).astype(np.uint16),
            return_number=(np.cumsum(valid, axis=1)[pulse, echo]).astype(np.uint8),
            number_of_returns=per_pulse[pulse].astype(np.uint8),
            scan_angle_deg=scan_angle[pulse].astype(np.float32),
            encoder_angle_deg=np.degrees(shots.encoder_rad)[pulse].astype(np.float32),
            channel=shots.channel[pulse],
            amplitude=amplitude,
            pulse_width_ns=(found.sigma[pulse, echo] * (FWHM_PER_SIGMA * lidar.sampling_ns)).astype(np.float32),
            reflectance_db=(10.0 * np.log10(amplitude * measured**2 / self._scale_dn_m2)).astype(np.float32),
            strip=np.full(len(pulse), self._strip.number, np.uint16),
            packet=number[pulse].astype(np.int64),
            return_location_ps=np.where(stored[pulse], position * (1e3 * lidar.sampling_ns), 0.0).astype(np.float32),
            wave_direction_m_ps=towards.astype(np.float32),
        )
        return StripChunk(
            returns=returns,
            packets=waves[stored],
            truth=self._truth(shots, echoes, tracer, pulse, device_range[pulse, echo], per_pulse[pulse]),
        )

    def _truth(
        self,
        shots: _Shots,
        echoes: "Echoes",
        tracer: "Tracer",
        pulse: np.ndarray,
        device_range_m: np.ndarray,
        siblings: np.ndarray,
    ) -> TrueReturns:
        """Surface of each return: the beam axis', or where several surfaces share a footprint the one nearest in range."""
        from simulator.render.waveforms import Beams

        seen = device_range_m - shots.beams.shift_m[pulse]
        range_m, face = echoes.axis_range_m[pulse].astype(np.float64), echoes.axis_face[pulse].copy()
        mixed = np.flatnonzero((siblings > 1) | (np.abs(seen - range_m) > ALONE_M))
        if len(mixed):
            rows = pulse[mixed]
            beams = Beams(
                origin_m=shots.beams.origin_m[rows], direction=shots.beams.direction[rows], shift_m=np.zeros(len(rows))
            )
            range_m[mixed], face[mixed] = tracer.surface_near(beams, seen[mixed])
        return TrueReturns(
            range_m=range_m,
            normal_world=self._normal[face],
            target=self._mesh.target[face].astype(np.int32),
            face=np.where(self._mesh.part[face] <= 9, self._mesh.part[face], -1).astype(np.int8),
        )


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
        for place, reach in zip(centre, radius, strict=True):
            first = np.floor((place - reach - self._low) / self.CELL_M).astype(int).clip(0)
            last = np.ceil((place + reach - self._low) / self.CELL_M).astype(int) + 1
            x, y = (self._low[k] + (np.arange(first[k], last[k]) + 0.5) * self.CELL_M - place[k] for k in range(2))
            part = self._inside[first[0] : last[0], first[1] : last[1]]
            part |= x[: part.shape[0], None] ** 2 + y[None, : part.shape[1]] ** 2 <= reach**2

    def __call__(self, world_m: np.ndarray) -> np.ndarray:
        """(n, 3) -> (n,) bool."""
        cell = np.floor((world_m[:, :2] - self._low) / self.CELL_M)
        legal = ((cell >= 0) & (cell < self._inside.shape)).all(axis=1)
        index = np.where(legal[:, None], cell, 0).astype(np.int64)
        return np.asarray(legal & self._inside[index[:, 0], index[:, 1]])
