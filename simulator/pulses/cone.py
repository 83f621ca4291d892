"""What a beam's footprint sees where closed forms end (`surface`): a few echoes of known range, power and spread.

The cone is filled with sub-rays, few where the triangles are one bent surface of one material, the full pattern where they are
not; the sub-rays on one triangle become one echo, which has the sum of their powers and the mean and variance of their ranges.
"""

import math

import numba
import numpy as np

from simulator.pulses.surface import over

MERGE = 0.06  # echoes closer than this part of the pulse's length are one
SLICE = 0.8  # a surface's echo is cut where it spreads over more than this part of the pulse's length
BENT = 0.1  # largest difference of cosines across a crease that few sub-rays resolve
APART_M = 0.05  # hits are kept one by one where a footprint's surfaces lie further apart than this


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _cover(
    u: np.ndarray, v: np.ndarray, edge: np.ndarray, q: np.ndarray, mine: int, nearest: np.ndarray, who: np.ndarray
) -> None:
    """Sub-rays inside one triangle, where it is the nearest yet. `edge` (9,): three edges; `q` (3,): 1 / range."""
    a0, a1, a2 = edge[0], edge[1], edge[2]
    b0, b1, b2 = edge[3], edge[4], edge[5]
    c0, c1, c2 = edge[6], edge[7], edge[8]
    q0, q1, q2 = q[0], q[1], q[2]
    for s in range(len(u)):
        x, y = u[s], v[s]
        a = a0 + a1 * x + a2 * y
        b = b0 + b1 * x + b2 * y
        c = c0 + c1 * x + c2 * y
        a = a if a < b else b
        a = a if a < c else c
        z = q0 + q1 * x + q2 * y
        old = nearest[s]
        here = (a >= np.float32(0.0)) & (z > old)
        nearest[s] = z if here else old
        who[s] = mine if here else who[s]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _ranges(nearest: np.ndarray, length: np.ndarray, share: np.ndarray, range_m: np.ndarray, power: np.ndarray) -> None:
    """Range of every sub-ray, and its power but for the surface's constant: share / range^3, `share` times length^3."""
    for s in range(len(nearest)):
        z = nearest[s]
        range_m[s] = length[s] / z
        power[s] = share[s] * z * z * z


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _extent(range_m: np.ndarray, who: np.ndarray, mine: int) -> tuple[float, float]:
    """Nearest and farthest range of one triangle's sub-rays; of all that hit for -1."""
    low, high = np.inf, -np.inf
    for s in range(len(who)):
        if who[s] >= 0 and (mine < 0 or who[s] == mine):
            low, high = min(low, range_m[s]), max(high, range_m[s])
    return low, high


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _share(
    range_m: np.ndarray,
    power: np.ndarray,
    who: np.ndarray,
    mine: int,
    about: np.float32,
    low: np.float32,
    high: np.float32,
    s: int,
) -> tuple[np.float32, np.float32, np.float32]:
    """What sub-ray s adds to `_moments`."""
    r = range_m[s]
    inside = (who[s] == mine) & (r >= low) & (r < high)
    p = power[s] if inside else np.float32(0.0)
    x = r - about if inside else np.float32(0.0)
    return p, p * x, p * x * x


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _moments(
    range_m: np.ndarray,
    power: np.ndarray,
    who: np.ndarray,
    mine: int,
    about: np.float32,
    low: np.float32,
    high: np.float32,
) -> tuple[np.float32, np.float32, np.float32]:
    """Sums of power, power x and power x^2 over one triangle's sub-rays with ranges in [low, high); x: range from `about`.

    Two sums side by side, in an order that is written down: where the compiler chooses it, a kernel just compiled and the same one
    out of the cache give other bytes.
    """
    a0 = b0 = c0 = a1 = b1 = c1 = np.float32(0.0)
    pairs = len(who) // 2 * 2
    for s in range(0, pairs, 2):
        p, px, pxx = _share(range_m, power, who, mine, about, low, high, s)
        a0, b0, c0 = a0 + p, b0 + px, c0 + pxx
        p, px, pxx = _share(range_m, power, who, mine, about, low, high, s + 1)
        a1, b1, c1 = a1 + p, b1 + px, c1 + pxx
    if pairs < len(who):
        p, px, pxx = _share(range_m, power, who, mine, about, low, high, pairs)
        a0, b0, c0 = a0 + p, b0 + px, c0 + pxx
    return a0 + a1, b0 + b1, c0 + c1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fill(
    corner: np.ndarray,
    plane: np.ndarray,
    touching: np.ndarray,
    origin: np.ndarray,
    axis: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    kappa: np.ndarray,
    nearest: np.ndarray,
    who: np.ndarray,
) -> None:
    """Of every sub-ray the place in `touching` of the triangle it hits, -1 none, and 1 / range along axis + u across + v along.

    The pattern's axes are those of the ray tracer in simulator.render, so that both can be compared sub-ray by sub-ray.
    """
    dx, dy, dz = axis[0], axis[1], axis[2]
    sign = math.copysign(1.0, dz)
    a = -1.0 / (sign + dz)
    b = dx * dy * a
    sx, sy, sz = 1.0 + sign * dx * dx * a, sign * b, -sign * dx
    tx, ty, tz = b, sign + dy * dy * a, -dy
    edge, q = np.empty(9, np.float32), np.empty(3, np.float32)
    nearest[:] = np.float32(0.0)
    who[:] = -1
    for j in range(len(touching)):
        t = touching[j]
        nx, ny, nz, height = plane[t, 0], plane[t, 1], plane[t, 2], over(plane, t, origin)
        kappa[j] = abs(height)
        if height == 0.0:
            continue
        q[0] = (nx * dx + ny * dy + nz * dz) / height
        q[1] = (nx * sx + ny * sy + nz * sz) / height
        q[2] = (nx * tx + ny * ty + nz * tz) / height
        for k in range(3):
            f, g = 3 * k, 3 * ((k + 1) % 3)
            ax, ay, az = corner[t, f] - origin[0], corner[t, f + 1] - origin[1], corner[t, f + 2] - origin[2]
            bx, by, bz = corner[t, g] - origin[0], corner[t, g + 1] - origin[1], corner[t, g + 2] - origin[2]
            mx, my, mz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            size = math.sqrt(mx * mx + my * my + mz * mz)
            scale = 0.0 if size == 0.0 else math.copysign(1.0 / size, height)
            edge[f] = (mx * dx + my * dy + mz * dz) * scale
            edge[f + 1] = (mx * sx + my * sy + mz * sz) * scale
            edge[f + 2] = (mx * tx + my * ty + mz * tz) * scale
        _cover(u, v, edge, q, j, nearest, who)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add(echo: np.ndarray, begin: int, count: int, peak: float, range_m: float, variance: float, join_m: float) -> int:
    """One more echo of a pulse, or part of one at nearly the same range; the new count."""
    for k in range(begin, begin + count):
        step = range_m - echo[k, 1]
        if abs(step) < join_m:
            total = peak + echo[k, 0]
            part = peak / total
            echo[k, 2] = part * variance + (1.0 - part) * (echo[k, 2] + part * step * step)
            echo[k, 1] += part * step
            echo[k, 0] = total
            return count
    echo[begin + count, 0], echo[begin + count, 1], echo[begin + count, 2] = peak, range_m, variance
    return count + 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _bent(plane: np.ndarray, rho: np.ndarray, touching: np.ndarray, origin: np.ndarray, axis: np.ndarray) -> bool:
    """Whether all triangles that the cone touches are one surface of one material, creased but not broken.

    Then what the few sub-rays do not resolve changes the amplitude by their share of the energy times the cosines' difference.
    """
    low_m, high_m, low, high = np.inf, -np.inf, np.inf, -np.inf
    for j in range(len(touching)):
        t = touching[j]
        cosine = plane[t, 0] * axis[0] + plane[t, 1] * axis[1] + plane[t, 2] * axis[2]
        range_m = over(plane, t, origin) / cosine
        low_m, high_m = min(low_m, range_m), max(high_m, range_m)
        low, high = min(low, abs(cosine)), max(high, abs(cosine))
        if not range_m > 0.0 or rho[touching[j]] != rho[touching[0]]:
            return False
    return high_m - low_m < APART_M and low > 0.2 and high - low < BENT


@numba.njit(cache=True, nogil=True)
def _longer(echo: np.ndarray, used: int) -> np.ndarray:
    out = np.empty((2 * len(echo), 3))
    out[:used] = echo[:used]
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def see_mixed(
    origin: np.ndarray,
    direction: np.ndarray,
    left: np.ndarray,
    touch_first: np.ndarray,
    touch_count: np.ndarray,
    touch_row: np.ndarray,
    echo: np.ndarray,
    echoes: int,
    first: np.ndarray,
    count: np.ndarray,
    extent_m: np.ndarray,
    axis_row: np.ndarray,
    corner: np.ndarray,
    plane: np.ndarray,
    rho: np.ndarray,
    few: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    full: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    scale: float,
    extinction: float,
    pulse_m: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Echoes of the beams `left` over by `surface.see_surfaces`, before noise; its results are completed.

    Parameters
    ----------
    few, full : (s,) ndarrays, float32
        Two patterns of sub-rays: slopes u and v across the beam, the axis first; length of the sub-ray's direction; share of the
        energy over its cube.

    The others: see `surface.see_surfaces`. Where the axis hits nothing, the innermost sub-ray that hits stands for it.

    Returns
    -------
    echo : (e, 3) float64
        With the rows of these beams.
    slot : (n,) int32
        Row in the next two arrays of a footprint whose surfaces lie apart, else -1.
    hit_m, hit_row : (k, s) float32, int32
        Range and triangle of each of its sub-rays; -1 where nothing is hit.
    """
    most, slots = len(full[0]), 0
    slot = np.full(len(origin), -1, np.int32)
    hit_m, hit_row = np.empty((16, most), np.float32), np.empty((16, most), np.int32)
    kappa, work, place = np.empty(64), np.empty((3, most), np.float32), np.empty(most, np.int32)
    for i in left:
        touched = touch_count[i]
        touching = touch_row[touch_first[i] : touch_first[i] + touched]
        if touched > len(kappa):
            kappa = np.empty(2 * touched)
        first[i] = echoes
        u, v, length, share = full
        if _bent(plane, rho, touching, origin[i], direction[i]):
            u, v, length, share = few
        subrays = len(u)
        nearest, sub_m, power, who = work[0, :subrays], work[1, :subrays], work[2, :subrays], place[:subrays]
        _fill(corner, plane, touching, origin[i], direction[i], u, v, kappa, nearest, who)
        _ranges(nearest, length, share, sub_m, power)
        for s in range(subrays):
            if who[s] >= 0:
                axis_row[i] = touching[who[s]]
                extent_m[i, 0] = sub_m[s]
                break
        if axis_row[i] < 0:
            continue
        near_m, far_m = _extent(sub_m, who, -1)
        extent_m[i, 1], extent_m[i, 2] = near_m, far_m
        rows = 0
        for j in range(touched):
            low, parts, step = float(near_m), 1, 0.0
            if far_m - near_m > SLICE * pulse_m:
                low, high = _extent(sub_m, who, j)
                if low > high:
                    continue
                parts = max(1, math.ceil((high - low) / (SLICE * pulse_m)))
                step = (high - low) / parts
            for part in range(parts):
                about = np.float32(low + (part + 0.5) * step)
                bottom = np.float32(0.0 if part == 0 else low + part * step)
                top = np.float32(3e38 if part == parts - 1 else low + (part + 1) * step)
                p0, p1, p2 = _moments(sub_m, power, who, j, about, bottom, top)
                if p0 > 0.0:
                    mean = p1 / float(p0)
                    peak = scale * rho[touching[j]] * kappa[j] * p0 * math.exp(-2.0 * extinction * (about + mean))
                    variance = max(float(p2 / float(p0) - mean * mean), 0.0)
                    if echoes + rows + 2 > len(echo):
                        echo = _longer(echo, echoes + rows)
                    rows = _add(echo, echoes, rows, peak, float(about + mean), variance, MERGE * pulse_m)
        count[i] = rows
        echoes += rows
        if far_m - near_m > APART_M:
            if slots == len(hit_m):
                more_m, more_row = np.empty((2 * slots, most), np.float32), np.empty((2 * slots, most), np.int32)
                more_m[:slots], more_row[:slots] = hit_m, hit_row
                hit_m, hit_row = more_m, more_row
            hit_row[slots, subrays:] = -1
            for s in range(subrays):
                hit_row[slots, s] = touching[who[s]] if who[s] >= 0 else -1
                hit_m[slots, s] = sub_m[s]
            slot[i] = slots
            slots += 1
    return echo, slot, hit_m[:slots], hit_row[:slots]
