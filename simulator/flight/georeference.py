"""From a sensor's own measurement to map coordinates, for millions of pulses: poses applied to vectors, and a fast exact map.

Frames and rotations are defined in `simulator.flight.frames`; here they are only arranged for speed. No matrix product goes through
BLAS, whose rounding depends on its threads.
"""

import math

import numba
import numpy as np

from simulator.flight.frames import SiteFrame
from simulator.flight.motion import Motion, SensorMounting

_HALF_M = np.array([2000.0, 2000.0, 700.0])  # the world box in which MapPatch holds
_CENTRE_M = np.array([0.0, 0.0, 500.0])


def beams_world(
    motion: Motion, gps_time_s: np.ndarray, mounting: SensorMounting, direction_sensor: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origins and directions of beams in the world frame.

    Parameters
    ----------
    motion : Motion
        True or estimated. Make a `Track` of it when there are many calls.
    gps_time_s : (n,) ndarray
        True time of the pulse for the true motion; the stamped time for the estimated one. [s]
    mounting : SensorMounting
        body_from_sensor.
    direction_sensor : (n, 3) ndarray
        Unit vectors in the sensor's frame.

    Returns
    -------
    (n, 3) ndarray, (n, 3) ndarray, (2, n) ndarray
        Origin [m]; unit direction; its components to the right of the heading, and down.
    """
    return Track(motion).beams(gps_time_s, mounting, direction_sensor)


class Track:
    """A motion with the sines and cosines of its samples' angles, for millions of beams."""

    def __init__(self, motion: Motion) -> None:
        self._time = np.ascontiguousarray(motion.gps_time_s, np.float64)
        pose = np.concatenate([motion.position_world_m, motion.rpy_rad], axis=1)
        self._pose = np.ascontiguousarray(
            np.concatenate([pose, np.cos(motion.rpy_rad), np.sin(motion.rpy_rad)], axis=1)
        )

    def beams(
        self, gps_time_s: np.ndarray, mounting: SensorMounting, direction_sensor: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `beams_world`."""
        n = len(gps_time_s)
        origin, direction, level = np.empty((n, 3)), np.empty((n, 3)), np.empty((2, n))
        arm = np.asarray(mounting.lever_arm_m, np.float64)
        rotation = np.ascontiguousarray(mounting.rotation, np.float64)
        time, beam = np.ascontiguousarray(gps_time_s, np.float64), np.ascontiguousarray(direction_sensor, np.float64)
        _beams(self._time, self._pose, time, rotation, arm, beam, origin, direction, level)
        return origin, direction, level


@numba.njit(cache=True, nogil=True)
def _turned(cosine: float, sine: float, angle: float) -> tuple[float, float]:
    """Cosine and sine of an angle more; a series where that is small, good to 1e-17."""
    if abs(angle) > 0.03:
        c, s = math.cos(angle), math.sin(angle)
    else:
        w = angle * angle
        c = 1.0 - w * (0.5 - w * (1.0 / 24.0 - w * (1.0 / 720.0 - w * (1.0 / 40320.0))))
        s = angle * (1.0 - w * (1.0 / 6.0 - w * (1.0 / 120.0 - w * (1.0 / 5040.0))))
    return cosine * c - sine * s, sine * c + cosine * s


@numba.njit(cache=True, nogil=True)
def _beams(
    sample_time: np.ndarray,
    pose: np.ndarray,
    time: np.ndarray,
    rotation: np.ndarray,
    arm: np.ndarray,
    beam: np.ndarray,
    origin: np.ndarray,
    direction: np.ndarray,
    level: np.ndarray,
) -> None:
    """Body FRD vectors into world ENU axes: Rx(roll), Ry(pitch), Rz(heading) in turn. `pose`: position, angles, cosines, sines."""
    last = len(sample_time) - 2
    vector, out = np.empty((2, 3)), np.empty((2, 3))
    vector[0] = arm
    j = 0
    for i in range(len(time)):
        t = time[i]
        if last < 0:
            part = 0.0
        else:
            if t < sample_time[j] or (j < last and t >= sample_time[min(j + 2, last)]):
                j = min(max(np.searchsorted(sample_time, t, side="right") - 1, 0), last)
            while j < last and t >= sample_time[j + 1]:
                j += 1
            part = min(max((t - sample_time[j]) / (sample_time[j + 1] - sample_time[j]), 0.0), 1.0)
        to = j + 1 if last >= 0 else j
        for k in range(3):
            vector[1, k] = rotation[k, 0] * beam[i, 0] + rotation[k, 1] * beam[i, 1] + rotation[k, 2] * beam[i, 2]
        cr, sr = _turned(pose[j, 6], pose[j, 9], part * (pose[to, 3] - pose[j, 3]))
        cp, sp = _turned(pose[j, 7], pose[j, 10], part * (pose[to, 4] - pose[j, 4]))
        ch, sh = _turned(pose[j, 8], pose[j, 11], part * (pose[to, 5] - pose[j, 5]))
        for k in range(2):
            x, y, z = vector[k, 0], vector[k, 1], vector[k, 2]
            y, z = cr * y - sr * z, sr * y + cr * z
            x, z = cp * x + sp * z, cp * z - sp * x
            out[k, 0], out[k, 1], out[k, 2] = sh * x + ch * y, ch * x - sh * y, -z
            level[0, i], level[1, i] = y, z  # the beam's, which is the last
        for k in range(3):
            origin[i, k] = pose[j, k] + part * (pose[to, k] - pose[j, k]) + out[0, k]
            direction[i, k] = out[1, k]


class MapPatch:
    """World to map coordinates by a cubic that interpolates `SiteFrame.map_from_world`: the same to 1 µm within 2 km, 10 x faster.

    Tensor Chebyshev nodes, four an axis; terms above total degree three are below a micrometre and dropped.
    """

    def __init__(self, frame: SiteFrame) -> None:
        node = np.cos(np.pi * (np.arange(4) + 0.5) / 4)
        t = np.stack([np.ones(4), node, 2 * node**2 - 1, 4 * node**3 - 3 * node])  # (degree, node)
        t = t * np.array([0.25, 0.5, 0.5, 0.5])[:, None]
        grid = np.stack(np.meshgrid(node, node, node, indexing="ij"), axis=-1)
        mapped = frame.map_from_world((grid * _HALF_M + _CENTRE_M).reshape(-1, 3)).reshape(grid.shape)
        self.origin_m = np.asarray(np.round(frame.map_from_world(np.zeros((1, 3)))[0]))
        self._coefficient = np.einsum("ai,bj,ck,ijkm->abcm", t, t, t, mapped - self.origin_m)

    def relative(self, world_m: np.ndarray) -> np.ndarray:
        """(n, 3) world -> (n, 3) easting, northing, normal height minus `origin_m`. [m]"""
        out = np.empty(world_m.shape)
        _cubic(world_m, _CENTRE_M, _HALF_M, self._coefficient, out)
        return out


@numba.njit(cache=True, nogil=True)
def _cubic(world: np.ndarray, centre: np.ndarray, half: np.ndarray, coefficient: np.ndarray, out: np.ndarray) -> None:
    """Sum of coefficient[a, b, c] T_a(x) T_b(y) T_c(z) over a + b + c <= 3; x in the unit cube."""
    flat = np.empty(60)
    k = 0
    for a in range(4):
        for b in range(4 - a):
            for c in range(4 - a - b):
                flat[k], flat[k + 20], flat[k + 40] = coefficient[a, b, c]
                k += 1
    w = np.empty(20)
    for i in range(len(world)):
        x, y, z = (
            (world[i, 0] - centre[0]) / half[0],
            (world[i, 1] - centre[1]) / half[1],
            (world[i, 2] - centre[2]) / half[2],
        )
        x2, y2, z2 = 2 * x * x - 1, 2 * y * y - 1, 2 * z * z - 1
        w[0], w[1], w[2], w[3] = 1.0, z, z2, (2 * z2 - 1) * z
        w[4], w[5], w[6] = y, y * z, y * z2
        w[7], w[8], w[9] = y2, y2 * z, (2 * y2 - 1) * y
        w[10], w[11], w[12] = x, x * z, x * z2
        w[13], w[14], w[15] = x * y, x * y * z, x * y2
        w[16], w[17], w[18], w[19] = x2, x2 * z, x2 * y, (2 * x2 - 1) * x
        e = n = h = 0.0
        for k in range(20):
            e += w[k] * flat[k]
            n += w[k] * flat[k + 20]
            h += w[k] * flat[k + 40]
        out[i, 0], out[i, 1], out[i, 2] = e, n, h
