"""The LiDAR's brute-force reference: every sub-ray of every pulse traced by Mitsuba's ray caster and added up. No campaign is made
with it; tests and benchmarks compare `simulator.pulses`, which makes them, with this independent kernel.

One lane a pulse, every output slot written once: the same bytes on any threads.

In: beams (origin, axis, timing shift). Out: noise-free waveforms in digitiser steps above the baseline, where each packet
starts, and what the beam's axis hit. Noise, quantising and detection belong to the device (simulator.lidar.device).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from simulator.lidar.footprint import Optics
from simulator.lidar.radar_equation import SPEED_OF_LIGHT_M_S
from simulator.render.scene import RenderScene
from simulator.render.upload import uploaded

import drjit as dr  # isort: skip  (simulator.render.scene has chosen the variant)
import mitsuba as mi  # isort: skip

NO_HIT = np.uint32(0xFFFFFFFF)


@dataclass(frozen=True, kw_only=True)
class Beams:
    """n pulses in the world frame."""

    origin_m: np.ndarray  # (n, 3)
    direction: np.ndarray  # (n, 3) unit
    shift_m: np.ndarray  # (n,) apparent lengthening of the range: the device's timing jitter


@dataclass(frozen=True, kw_only=True)
class Echoes:
    """n pulses, before noise."""

    waveform_dn: np.ndarray  # (n, samples) float32 above the baseline, not clipped
    start_sample: np.ndarray  # (n,) int32: the first sample's number on the clock that the emitted pulse starts
    axis_range_m: np.ndarray  # (n,) float32 along the beam's axis, or the innermost sub-ray that hits; NaN: nothing hit
    axis_face: np.ndarray  # (n,) uint32 face hit there, NO_HIT
    hits: np.ndarray  # (n,) uint32 sub-rays that hit something
    last_range_m: np.ndarray  # (n,) float32 farthest sub-ray's; its echo may lie beyond the packet's end


def _packed(beams: Beams) -> np.ndarray:
    """(7 n,) float32: origin, axis and shift of each pulse in turn."""
    table = np.empty((len(beams.shift_m), 7), np.float32)
    table[:, :3], table[:, 3:6], table[:, 6] = beams.origin_m, beams.direction, beams.shift_m
    return table.ravel()


class Tracer:
    """A scene and a device, ready to be asked for chunks of pulses. Tables are uploaded once."""

    def __init__(self, scene: RenderScene, backscatter: np.ndarray, optics: Optics) -> None:
        """`backscatter`: (materials,) pi times the BRDF towards the source at the laser line."""
        self._scene = scene
        self._optics = optics
        self._rho = uploaded(mi.Float, backscatter.astype(np.float32))
        self._u = uploaded(mi.Float, optics.footprint.offset[:, 0].astype(np.float32))
        self._v = uploaded(mi.Float, optics.footprint.offset[:, 1].astype(np.float32))
        self._w = uploaded(mi.Float, optics.footprint.weight.astype(np.float32))
        dr.eval(self._rho, self._u, self._v, self._w)

    def _beam(self, beams: Beams) -> tuple[Any, Callable[[Any], Any], Any]:
        """Origin, direction of sub-ray number s, and the timing shift.

        The seven numbers of a pulse are gathered from one array: Dr.Jit maps NumPy memory as it stands and bakes each
        array's alignment, which is chance, into the kernel, so separate arrays would compile anew for most chunks.
        """
        table = uploaded(mi.Float, _packed(beams))
        lane = dr.arange(mi.UInt32, len(beams.shift_m))
        column = [dr.gather(mi.Float, table, lane * 7 + k) for k in range(7)]
        origin, axis = mi.Point3f(*column[:3]), mi.Vector3f(*column[3:6])
        across, along = mi.coordinate_system(axis)

        def direction(s: Any) -> Any:
            return dr.normalize(
                axis + dr.gather(mi.Float, self._u, s) * across + dr.gather(mi.Float, self._v, s) * along
            )

        return origin, direction, column[6]

    def launch(self, beams: Beams) -> Callable[[], Echoes]:
        """Start a chunk on Dr.Jit's workers and return at once; the function that comes back waits for it.

        Every sub-ray adds P = scale * w * rho * cos(alpha) * exp(-2 alpha R) / R^2 at two-way time 2 R / c.
        """
        o = self._optics
        n, subrays, samples = len(beams.shift_m), len(o.footprint.weight), o.samples
        samples_per_m = 2e9 / (SPEED_OF_LIGHT_M_S * o.sampling_ns)
        sigma = o.echo_sigma_ns / o.sampling_ns  # in samples
        reach = int(np.ceil(6.0 * sigma))
        lane = dr.arange(mi.UInt32, n)
        origin, direction, shift = self._beam(beams)

        # ---- trace: range and peak of every sub-ray, kept in the lane's own memory -------------------------------------
        ranges = dr.alloc_local(mi.Float, subrays, value=mi.Float(0))
        peaks = dr.alloc_local(mi.Float, subrays, value=mi.Float(0))

        def trace(
            s: Any, ranges: Any, peaks: Any, near: Any, far: Any, axis: Any, face: Any, hits: Any
        ) -> tuple[Any, ...]:
            d = direction(s)
            hit = self._scene.mi_scene.ray_intersect_preliminary(mi.Ray3f(origin, d), coherent=False)
            ok = hit.is_valid()
            t = dr.select(ok, hit.t, 1.0)
            normal = [dr.gather(mi.Float, self._scene.normal, 3 * hit.prim_index + k, ok) for k in range(3)]
            cosine = dr.abs(normal[0] * d.x + normal[1] * d.y + normal[2] * d.z)
            rho = dr.gather(mi.Float, self._rho, dr.gather(mi.UInt32, self._scene.material, hit.prim_index, ok), ok)
            air = dr.exp(-dr.minimum(2.0 * o.extinction_per_m * t, 40.0))
            peak = o.scale_dn_m2 * dr.gather(mi.Float, self._w, s) * rho * cosine * air / (t * t)
            ranges.write(t, s)
            peaks.write(dr.select(ok, peak, 0.0), s)
            first = ok & (hits == 0)
            axis = dr.select(first, t, axis)
            face = dr.select(first, hit.prim_index, face)
            near = dr.select(ok, dr.minimum(near, t), near)
            far = dr.select(ok, dr.maximum(far, t), far)
            return s + 1, ranges, peaks, near, far, axis, face, hits + dr.select(ok, mi.UInt32(1), mi.UInt32(0))

        _, ranges, peaks, near, far, axis, face, hits = dr.while_loop(
            (
                mi.UInt32(0),
                ranges,
                peaks,
                mi.Float(dr.inf),
                mi.Float(-dr.inf),
                mi.Float(dr.nan),
                mi.UInt32(int(NO_HIT)),
                mi.UInt32(0),
            ),
            lambda s, *_: s < subrays,
            trace,
            max_iterations=subrays,
        )

        # ---- digitiser: the packet begins a whole number of samples before the nearest echo ----------------------------
        start = dr.select(hits > 0, dr.floor((near + shift) * samples_per_m) - o.pre_samples, 0.0)
        start = dr.maximum(start, 0.0)

        # ---- waveform: each echo is a Gaussian, cut at six standard deviations (1.5e-8 of its peak) --------------------
        wave = dr.alloc_local(mi.Float, samples, value=mi.Float(0))

        def add(s: Any, wave: Any) -> tuple[Any, ...]:
            x = (ranges.read(s) + shift) * samples_per_m - start
            peak = peaks.read(s)
            b0 = dr.floor(x) - reach + 1
            for j in range(2 * reach):
                b = b0 + j
                active = (b >= 0) & (b < samples) & (peak > 0)
                k = mi.UInt32(dr.clip(b, 0, samples - 1))
                value = peak * dr.exp(-dr.minimum(0.5 * dr.square((b - x) / sigma), 40.0))
                wave.write(wave.read(k, active) + value, k, active)
            return s + 1, wave

        _, wave = dr.while_loop((mi.UInt32(0), wave), lambda s, wave: s < subrays, add, max_iterations=subrays)

        out = dr.empty(mi.Float, n * samples)

        def store(k: Any, wave: Any) -> tuple[Any, ...]:
            dr.scatter(out, wave.read(k), lane * samples + k)
            return k + 1, wave

        dr.while_loop((mi.UInt32(0), wave), lambda k, wave: k < samples, store)
        start_sample = mi.Int32(start)
        dr.eval(out, start_sample, axis, face, hits, far)

        def wait() -> Echoes:
            return Echoes(
                waveform_dn=np.asarray(out).reshape(n, samples),
                start_sample=np.asarray(start_sample),
                axis_range_m=np.asarray(axis),
                axis_face=np.asarray(face),
                hits=np.asarray(hits),
                last_range_m=np.asarray(far),
            )

        return wait
