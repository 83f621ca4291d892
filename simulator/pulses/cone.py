"""What a beam's footprint sees of the triangles that its cone touches: a few echoes of known range, power and spread.

A cone inside one triangle, with nothing before it, sees a smooth surface: its echo is the closed form of a Gaussian beam on a
tilted plane. Every other cone is filled with sub-rays, few where the triangles are one creased surface of one material, the full
pattern where they are not; the sub-rays on one triangle become one echo, which has the sum of their powers and the mean and
variance of their ranges.
"""

import math

import numba
import numpy as np

CURVED = 0.02  # reach times tangent of incidence from which the closed form's next terms would show
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


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "nsz"})
def _moments(
    range_m: np.ndarray,
    power: np.ndarray,
    who: np.ndarray,
    mine: int,
    about: np.float32,
    low: np.float32,
    high: np.float32,
) -> tuple[np.float32, np.float32, np.float32]:
    """Sums of power, power x and power x^2 over one triangle's sub-rays with ranges in [low, high); x: range from `about`."""
    p0 = p1 = p2 = np.float32(0.0)
    for s in range(len(who)):
        r = range_m[s]
        inside = (who[s] == mine) & (r >= low) & (r < high)
        p = power[s] if inside else np.float32(0.0)
        x = r - about if inside else np.float32(0.0)
        p0 += p
        p1 += p * x
        p2 += p * x * x
    return p0, p1, p2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _plane(corner: np.ndarray, t: int, ox: float, oy: float, oz: float) -> tuple[float, float, float, float]:
    """Unit normal of a triangle, and its plane's height over the beam's origin along it. [m]"""
    ax, ay, az = float(corner[t, 0]), float(corner[t, 1]), float(corner[t, 2])
    ex, ey, ez = corner[t, 3] - ax, corner[t, 4] - ay, corner[t, 5] - az
    fx, fy, fz = corner[t, 6] - ax, corner[t, 7] - ay, corner[t, 8] - az
    nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    size = math.sqrt(nx * nx + ny * ny + nz * nz)
    scale = 0.0 if size == 0.0 else 1.0 / size
    nx, ny, nz = nx * scale, ny * scale, nz * scale
    return nx, ny, nz, nx * (ax - ox) + ny * (ay - oy) + nz * (az - oz)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _hidden(corner: np.ndarray, t: int, cover: int, ox: float, oy: float, oz: float) -> bool:
    """Whether triangle t lies behind the plane of another that covers the cone."""
    nx, ny, nz, height = _plane(corner, cover, ox, oy, oz)
    sign = math.copysign(1.0, height)
    for k in range(0, 9, 3):
        x, y, z = corner[t, k] - ox, corner[t, k + 1] - oy, corner[t, k + 2] - oz
        if sign * (nx * x + ny * y + nz * z) < abs(height) - 1e-5:
            return False
    return True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fill(
    corner: np.ndarray,
    touching: np.ndarray,
    touched: int,
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
    for j in range(touched):
        t = touching[j]
        nx, ny, nz, height = _plane(corner, t, origin[0], origin[1], origin[2])
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
def _bent(corner: np.ndarray, rho: np.ndarray, touching: np.ndarray, origin: np.ndarray, axis: np.ndarray) -> bool:
    """Whether all triangles that the cone touches are one surface of one material, creased but not broken.

    Then what the few sub-rays do not resolve changes the amplitude by their share of the energy times the cosines' difference.
    """
    low_m, high_m, low, high = np.inf, -np.inf, np.inf, -np.inf
    for j in range(len(touching)):
        nx, ny, nz, height = _plane(corner, touching[j], origin[0], origin[1], origin[2])
        cosine = nx * axis[0] + ny * axis[1] + nz * axis[2]
        range_m = height / cosine
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
def see(
    origin: np.ndarray,
    direction: np.ndarray,
    touch_first: np.ndarray,
    touch_count: np.ndarray,
    touch_row: np.ndarray,
    touch_whole: np.ndarray,
    corner: np.ndarray,
    rho: np.ndarray,
    few: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    full: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    reach: float,
    spread: float,
    scale: float,
    extinction: float,
    pulse_m: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Echoes of n beams before noise.

    Parameters
    ----------
    origin, direction : (n, 3) ndarray
        World frame; unit directions. [m]
    touch_first, touch_count, touch_row, touch_whole : ndarray
        See `fan.touch`.
    corner : (t, 9) ndarray, float32
        Vertices in the tree's order. [m]
    rho : (t,) ndarray
        pi times the BRDF towards the source, in the tree's order.
    few, full : (s,) ndarrays, float32
        Two patterns of sub-rays: slopes u and v across the beam, the axis first; length of the sub-ray's direction; share of the
        energy over its cube.
    reach, spread : float
        Of the outermost sub-ray; standard deviation of the beam about one axis, a quarter of its divergence. [rad]
    scale, extinction : float
        Peak of an echo of rho cos = 1 at 1 m [DN m2]; one way [1/m].
    pulse_m : float
        Standard deviation of the echo of a flat target, as range. [m]

    Returns
    -------
    echo : (e, 3) float64
        Peak if the echo had not been broadened [DN], range [m], variance that is added to the pulse's [m2].
    first, count : (n,) int64, int32
        Rows of `echo` of each pulse.
    extent_m : (n, 3) float64
        Innermost sub-ray that hits, nearest, farthest; NaN where nothing is hit. [m]
    axis_row : (n,) int64
        Triangle that the innermost hits, in the tree's order; -1 none.
    slot : (n,) int32
        Row in the next two arrays of a footprint whose surfaces lie apart, else -1.
    hit_m, hit_row : (k, s) float32, int32
        Range and triangle of each of its sub-rays; -1 where nothing is hit.
    """
    n, most = len(origin), len(full[0])
    first, count = np.zeros(n, np.int64), np.zeros(n, np.int32)
    echo = np.empty((2 * n + 64, 3))
    echoes = 0
    extent_m = np.full((n, 3), np.nan)
    axis_row, slot = np.full(n, -1, np.int64), np.full(n, -1, np.int32)
    hit_m, hit_row = np.empty((16, most), np.float32), np.empty((16, most), np.int32)
    slots = 0
    kappa = np.empty(64)
    work = np.empty((3, most), np.float32)
    place = np.empty(most, np.int32)
    for i in range(n):
        touched = touch_count[i]
        if touched == 0:
            continue
        touching = touch_row[touch_first[i] : touch_first[i] + touched]
        whole = touch_whole[touch_first[i] : touch_first[i] + touched]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        ox, oy, oz = origin[i, 0], origin[i, 1], origin[i, 2]
        first[i] = echoes
        # ---- smooth: a Gaussian beam on a tilted plane ----
        cover, range_m, cosine = -1, np.inf, 1.0
        for j in range(touched):
            if whole[j]:
                nx, ny, nz, height = _plane(corner, touching[j], ox, oy, oz)
                along = nx * dx + ny * dy + nz * dz
                if height / along < range_m:
                    cover, range_m, cosine = touching[j], height / along, abs(along)
        tangent = math.sqrt(max(1.0 - cosine * cosine, 0.0)) / max(cosine, 1e-9)
        smooth = cover >= 0 and reach * tangent < CURVED
        for j in range(touched):
            if smooth and touching[j] != cover:
                smooth = _hidden(corner, touching[j], cover, ox, oy, oz)
        if echoes + 8 > len(echo):
            echo = _longer(echo, echoes)
        if smooth:
            tilt = (tangent * spread) ** 2
            peak = scale * rho[cover] * cosine / range_m**2 * (1.0 + 3.0 * tilt - 3.0 * spread**2)
            echo[echoes, 0] = peak * math.exp(-2.0 * extinction * range_m)
            echo[echoes, 1] = range_m * (1.0 - 2.0 * tilt + spread**2)
            echo[echoes, 2] = tilt * range_m**2
            count[i] = 1
            echoes += 1
            extent_m[i, 0] = range_m
            extent_m[i, 1] = range_m * (1.0 - reach * tangent)
            extent_m[i, 2] = range_m * (1.0 + reach * tangent)
            axis_row[i] = cover
            continue
        # ---- mixed: sub-rays, few of them on one bent surface ----
        u, v, length, share = full
        if _bent(corner, rho, touching, origin[i], direction[i]):
            u, v, length, share = few
        subrays = len(u)
        nearest, sub_m, power, who = work[0, :subrays], work[1, :subrays], work[2, :subrays], place[:subrays]
        if touched > len(kappa):
            kappa = np.empty(2 * touched)
        _fill(corner, touching, touched, origin[i], direction[i], u, v, kappa, nearest, who)
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
    return echo, first, count, extent_m, axis_row, slot, hit_m[:slots], hit_row[:slots]


@numba.njit(cache=True, nogil=True)
def nearest_hit(
    wanted_m: np.ndarray, slot: np.ndarray, hit_m: np.ndarray, hit_row: np.ndarray, range_m: np.ndarray, row: np.ndarray
) -> None:
    """Which surface each return came from: of its footprint's sub-rays, the hit nearest in range. Rows without a slot stay."""
    for i in range(len(wanted_m)):
        if slot[i] < 0:
            continue
        best = np.inf
        for s in range(hit_m.shape[1]):
            if hit_row[slot[i], s] >= 0 and abs(hit_m[slot[i], s] - wanted_m[i]) < best:
                best = abs(hit_m[slot[i], s] - wanted_m[i])
                range_m[i], row[i] = hit_m[slot[i], s], hit_row[slot[i], s]
