"""From a sensor's own measurement to map coordinates, for millions of pulses: poses applied to vectors, and a fast exact map.

Frames and rotations are defined in `simulator.flight.frames`; here they are only arranged for speed. No matrix product goes through
BLAS, whose rounding depends on its threads.
"""

import numba
import numpy as np

from simulator.flight.frames import SiteFrame
from simulator.flight.motion import Motion, SensorMounting

_HALF_M = np.array([2000.0, 2000.0, 700.0])  # the world box in which MapPatch holds
_CENTRE_M = np.array([0.0, 0.0, 500.0])
_SMALL_RAD = 0.03
LANES = 256  # pulses that go through each step together


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
    """A motion, or what of it lies around two times, with the sines and cosines of its angles, for millions of beams."""

    def __init__(self, motion: Motion, from_s: float = -np.inf, to_s: float = np.inf) -> None:
        first = max(int(np.searchsorted(motion.gps_time_s, from_s, side="right")) - 1, 0)
        part_of = slice(first, int(np.searchsorted(motion.gps_time_s, to_s, side="left")) + 1)
        time = motion.gps_time_s[part_of]
        pose = np.concatenate([motion.position_world_m[part_of], motion.rpy_rad[part_of]], axis=1)
        # so many pieces that a series is enough for the angles inside each; the motion stays the same
        pieces = np.maximum(np.ceil(np.abs(np.diff(pose[:, 3:], axis=0)).max(axis=1) / _SMALL_RAD), 1).astype(np.int64)
        begin = np.repeat(np.arange(len(pieces)), pieces)
        part = (np.arange(len(begin)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[begin]
        self._time = np.append(time[begin] + part * np.diff(time)[begin], time[-1])
        pose = np.concatenate([pose[begin] + part[:, None] * np.diff(pose, axis=0)[begin], pose[-1:]])
        self._pose = np.concatenate([pose, np.cos(pose[:, 3:]), np.sin(pose[:, 3:])], axis=1)

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


@numba.njit(cache=True, nogil=True, inline="always")
def _turned(part: np.ndarray, angle: float, cosine: float, sine: float, to: tuple[np.ndarray, np.ndarray]) -> None:
    """Cosines and sines of an angle and parts of a small one more: a series, good to 1e-17."""
    c, s = to
    for k in range(len(part)):
        v = part[k] * angle
        w = v * v
        more_c = 1.0 - w * (0.5 - w * (1.0 / 24.0 - w * (1.0 / 720.0 - w * (1.0 / 40320.0))))
        more_s = v * (1.0 - w * (1.0 / 6.0 - w * (1.0 / 120.0 - w * (1.0 / 5040.0))))
        c[k], s[k] = cosine * more_c - sine * more_s, sine * more_c + cosine * more_s


@numba.njit(cache=True, nogil=True, inline="always")
def _turn(by: tuple[np.ndarray, np.ndarray], a: np.ndarray, b: np.ndarray) -> None:
    """Rotate (a, b) in their plane, from a to b."""
    c, s = by
    for k in range(len(a)):
        a[k], b[k] = c[k] * a[k] - s[k] * b[k], s[k] * a[k] + c[k] * b[k]


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
    """Body FRD vectors into world ENU axes: Rx(roll), Ry(pitch), Rz(heading) in turn. `pose`: position, angles, cosines, sines.

    Pulses between two samples of the motion go through every step together; in short loops, each of which becomes vector
    instructions.
    """
    last = max(len(sample_time) - 2, 0)
    step, work = np.empty(6), np.empty((13, LANES))
    first = 0
    while first < len(time):
        j = min(max(np.searchsorted(sample_time, time[first], side="right") - 1, 0), last)
        low, high = -np.inf if j == 0 else sample_time[j], np.inf if j == last else sample_time[j + 1]
        end = first + 1
        while end < len(time) and end < first + LANES and low <= time[end] < high:
            end += 1
        n, to = end - first, min(j + 1, len(sample_time) - 1)
        part, x, y, z, ax, ay, az = (
            work[0, :n],
            work[1, :n],
            work[2, :n],
            work[3, :n],
            work[4, :n],
            work[5, :n],
            work[6, :n],
        )
        roll, pitch, heading = (work[7, :n], work[8, :n]), (work[9, :n], work[10, :n]), (work[11, :n], work[12, :n])
        begin, length = sample_time[j], sample_time[to] - sample_time[j]
        scale = 1.0 / length if length > 0.0 else 0.0
        for c in range(6):
            step[c] = pose[to, c] - pose[j, c]
        for k in range(n):
            t = (time[first + k] - begin) * scale
            t = t if t > 0.0 else 0.0
            part[k] = t if t < 1.0 else 1.0
        _turned(part, step[3], pose[j, 6], pose[j, 9], roll)
        _turned(part, step[4], pose[j, 7], pose[j, 10], pitch)
        _turned(part, step[5], pose[j, 8], pose[j, 11], heading)
        # ---- the beam ----
        for k in range(n):
            u, v, w = beam[first + k, 0], beam[first + k, 1], beam[first + k, 2]
            x[k] = rotation[0, 0] * u + rotation[0, 1] * v + rotation[0, 2] * w
            y[k] = rotation[1, 0] * u + rotation[1, 1] * v + rotation[1, 2] * w
            z[k] = rotation[2, 0] * u + rotation[2, 1] * v + rotation[2, 2] * w
        _turn(roll, y, z)
        _turn(pitch, z, x)
        for k in range(n):
            level[0, first + k] = y[k]
        for k in range(n):
            level[1, first + k] = z[k]
        _turn(heading, x, y)
        for k in range(n):
            direction[first + k, 0], direction[first + k, 1], direction[first + k, 2] = y[k], x[k], -z[k]
        # ---- where it begins: the lever arm ----
        for k in range(n):
            ax[k], ay[k], az[k] = arm[0], arm[1], arm[2]
        _turn(roll, ay, az)
        _turn(pitch, az, ax)
        _turn(heading, ax, ay)
        for k in range(n):
            origin[first + k, 0] = pose[j, 0] + part[k] * step[0] + ay[k]
            origin[first + k, 1] = pose[j, 1] + part[k] * step[1] + ax[k]
            origin[first + k, 2] = pose[j, 2] + part[k] * step[2] - az[k]
        first = end


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
        chebyshev = np.einsum("ai,bj,ck,ijkm->abcm", t, t, t, mapped - self.origin_m)
        chebyshev[np.indices((4, 4, 4)).sum(axis=0) > 3] = 0.0
        power = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [-1, 0, 2, 0], [0, -3, 0, 4]], float)  # (degree, power of x)
        cubic = np.einsum("abcm,ax,by,cz->mxyz", chebyshev, power, power, power)
        x, y, z = _POWERS.T
        self._coefficient = np.ascontiguousarray(cubic[:, x, y, z])

    def relative(self, world_m: np.ndarray) -> np.ndarray:
        """(n, 3) world -> (n, 3) easting, northing, normal height minus `origin_m`. [m]"""
        out = np.empty(world_m.shape)
        _cubic(world_m, _CENTRE_M, 1.0 / _HALF_M, self._coefficient, out)
        return out


# Powers of x, y, z in the order in which `_polynomial` takes their coefficients.
_POWERS = np.array([(a, b, c) for a in range(4) for b in range(4 - a) for c in range(4 - a - b)])


@numba.njit(cache=True, nogil=True, inline="always")
def _polynomial(f: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray, out: np.ndarray) -> None:
    """Every power of x, y, z up to a total of three, by Horner's scheme in z, then y, then x."""
    f0, f1, f2, f3, f4, f5, f6, f7, f8, f9 = f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8], f[9]
    g0, g1, g2, g3, g4, g5, g6, g7, g8, g9 = f[10], f[11], f[12], f[13], f[14], f[15], f[16], f[17], f[18], f[19]
    for k in range(len(out)):
        a, b, c = x[k], y[k], z[k]
        x0 = f0 + c * (f1 + c * (f2 + c * f3)) + b * (f4 + c * (f5 + c * f6) + b * (f7 + c * f8 + b * f9))
        x1 = g0 + c * (g1 + c * g2) + b * (g3 + c * g4 + b * g5)
        out[k] = x0 + a * (x1 + a * (g6 + c * g7 + b * g8 + a * g9))


@numba.njit(cache=True, nogil=True)
def _cubic(world: np.ndarray, centre: np.ndarray, scale: np.ndarray, coefficient: np.ndarray, out: np.ndarray) -> None:
    """`coefficient` (3, 20) of `_POWERS`; the unit cube is the patch."""
    work = np.empty((4, LANES))
    for first in range(0, len(world), LANES):
        n = min(LANES, len(world) - first)
        for c in range(3):
            middle, factor = centre[c], scale[c]
            for k in range(n):
                work[c, k] = (world[first + k, c] - middle) * factor
        for c in range(3):
            _polynomial(coefficient[c], work[0, :n], work[1, :n], work[2, :n], work[3, :n])
            for k in range(n):
                out[first + k, c] = work[3, k]
