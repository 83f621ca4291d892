"""What a beam's footprint sees of one smooth surface, or of two that meet in an edge: closed forms.

A cone inside one triangle, with nothing before it, sees a Gaussian beam on a tilted plane. A cone on two triangles that share an
edge sees a Gaussian beam that a line cuts in two. Every other cone is left to `cone`.
"""

import math

import numba
import numpy as np

CURVED = 0.02  # reach times tangent of incidence from which the closed forms' next terms would show
LONG = 0.8  # part of the pulse's length over which a crease may spread
MERGE = 0.06  # echoes closer than this part of the pulse's length are one
OUTSIDE, WHOLE, BROKEN = 3, 4, 5  # how a triangle stands to a cone, beside the numbers of its edges


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def over(plane: np.ndarray, t: int, beam: np.ndarray) -> float:
    """Height of a triangle's plane over the beam's origin, along its normal. `beam`: origin, then direction. [m]"""
    height: float = plane[t, 3] - plane[t, 0] * beam[0] - plane[t, 1] * beam[1] - plane[t, 2] * beam[2]
    return height


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _hidden(corner: np.ndarray, plane: np.ndarray, t: int, cover: int, beam: np.ndarray) -> bool:
    """Whether triangle t lies behind the plane of another that covers the cone."""
    nx, ny, nz, height = plane[cover, 0], plane[cover, 1], plane[cover, 2], over(plane, cover, beam)
    sign = math.copysign(1.0, height)
    for k in range(0, 9, 3):
        x, y, z = corner[t, k] - beam[0], corner[t, k + 1] - beam[1], corner[t, k + 2] - beam[2]
        if sign * (nx * x + ny * y + nz * z) < abs(height) - 1e-5:
            return False
    return True


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _passes(
    px: float,
    py: float,
    pz: float,
    qx: float,
    qy: float,
    qz: float,
    mx: float,
    my: float,
    mz: float,
    dx: float,
    dy: float,
    dz: float,
    reach: float,
) -> bool:
    """Whether an edge from p to q, the plane of which cuts the cone about d, cuts it itself. m: p x q."""
    ax, ay, az = py * dz - pz * dy, pz * dx - px * dz, px * dy - py * dx
    bx, by, bz = dy * qz - dz * qy, dz * qx - dx * qz, dx * qy - dy * qx
    if ax * mx + ay * my + az * mz > 0.0 and bx * mx + by * my + bz * mz > 0.0:
        return True
    limit = reach * reach
    if px * dx + py * dy + pz * dz > 0.0 and ax * ax + ay * ay + az * az < limit * (px * px + py * py + pz * pz):
        return True
    return qx * dx + qy * dy + qz * dz > 0.0 and bx * bx + by * by + bz * bz < limit * (qx * qx + qy * qy + qz * qz)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _stands(corner: np.ndarray, t: int, beam: np.ndarray, reach: float) -> int:
    """How a triangle stands to the cone: OUTSIDE, WHOLE, BROKEN, or the number of the only edge that runs through the cone.

    `fan.touch` decides the same in single precision, from another origin, with slack to both sides.
    """
    dx, dy, dz = beam[3], beam[4], beam[5]
    px, py, pz = corner[t, 0] - beam[0], corner[t, 1] - beam[1], corner[t, 2] - beam[2]
    qx, qy, qz = corner[t, 3] - beam[0], corner[t, 4] - beam[1], corner[t, 5] - beam[2]
    wx, wy, wz = corner[t, 6] - beam[0], corner[t, 7] - beam[1], corner[t, 8] - beam[2]
    turn, edge, within = 0.0, WHOLE, True
    for k in range(3):
        x, y, z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
        if k == 0:
            turn = math.copysign(1.0, x * wx + y * wy + z * wz)
        inside = turn * (dx * x + dy * y + dz * z)
        near = inside * inside < reach * reach * (x * x + y * y + z * z)
        if inside < 0.0:
            if not near:
                return OUTSIDE
            within = False
        if near and _passes(px, py, pz, qx, qy, qz, x, y, z, dx, dy, dz, reach):
            edge = k if edge == WHOLE else BROKEN
        px, py, pz, qx, qy, qz, wx, wy, wz = qx, qy, qz, wx, wy, wz, px, py, pz
    return edge if within or edge != WHOLE else OUTSIDE


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _shared(corner: np.ndarray, a: int, edge_a: int, b: int, edge_b: int) -> bool:
    """Whether an edge of one triangle is one of another's, their vertices in any order."""
    p, q = 3 * edge_a, 3 * ((edge_a + 1) % 3)
    for turned in range(2):
        r, s = 3 * ((edge_b + turned) % 3), 3 * ((edge_b + 1 - turned) % 3)
        same = True
        for k in range(3):
            same &= (corner[a, p + k] == corner[b, r + k]) & (corner[a, q + k] == corner[b, s + k])
        if same:
            return True
    return False


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _crease(
    corner: np.ndarray,
    plane: np.ndarray,
    a: int,
    b: int,
    edge: int,
    beam: np.ndarray,
    spread: float,
    side: np.ndarray,
) -> int:
    """What a cone sees of two triangles where nothing of their borders but `edge` of `a`, which they share, runs through it.

    `side` (2, 5): the power over that of rho = 1 at 1 m, mean range, its variance, range along the axis, tangent of incidence.
    The edge cuts the Gaussian footprint at z standard deviations from the axis; what lies beyond has the moments of a truncated
    normal distribution, and along the edge nothing is cut. To second order in the footprint's angles. Returns which of the two
    the axis hits; -1 where they are folded onto each other.
    """
    dx, dy, dz = beam[3], beam[4], beam[5]
    ox, oy, oz = beam[0], beam[1], beam[2]
    # ---- the plane through the edge and the beam's origin; its normal points to a's side ----
    p, q = 3 * edge, 3 * ((edge + 1) % 3)
    px, py, pz = corner[a, p] - ox, corner[a, p + 1] - oy, corner[a, p + 2] - oz
    qx, qy, qz = corner[a, q] - ox, corner[a, q + 1] - oy, corner[a, q + 2] - oz
    mx, my, mz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    of_a = of_b = 0.0  # a vertex on the edge gives rounding alone
    for k in range(0, 9, 3):
        here = (corner[a, k] - ox) * mx + (corner[a, k + 1] - oy) * my + (corner[a, k + 2] - oz) * mz
        of_a = here if abs(here) > abs(of_a) else of_a
        here = (corner[b, k] - ox) * mx + (corner[b, k + 1] - oy) * my + (corner[b, k + 2] - oz) * mz
        of_b = here if abs(here) > abs(of_b) else of_b
    if not of_a * of_b < 0.0:
        return -1
    scale = math.copysign(1.0 / math.sqrt(mx * mx + my * my + mz * mz), of_a)
    mx, my, mz = mx * scale, my * scale, mz * scale
    # ---- the shares of a Gaussian on both sides of a line, and their moments ----
    sine = dx * mx + dy * my + dz * mz
    z = sine / spread
    density = math.exp(-0.5 * z * z) * 0.3989422804014327
    less = max(0.5 * math.erfc(abs(z) * 0.7071067811865476), 1e-300)
    for k in range(2):
        t, way = (a, 1.0) if k == 0 else (b, -1.0)
        share = less if way * z < 0.0 else 1.0 - less
        mean = way * density / share
        variance = max(1.0 - z * mean - mean * mean, 0.0) * spread * spread
        mean *= spread
        square = variance + mean * mean
        nx, ny, nz = plane[t, 0], plane[t, 1], plane[t, 2]
        cosine = nx * dx + ny * dy + nz * dz
        range_m = over(plane, t, beam) / cosine
        across = (nx * mx + ny * my + nz * mz) / cosine - sine
        tangent = max(1.0 - cosine * cosine, 0.0) / (cosine * cosine)
        along = max(tangent - across * across, 0.0) * spread * spread
        tilt, wide = across * across * square + along, square + spread * spread
        power = 1.0 + 3.0 * across * mean + 3.0 * tilt - 1.5 * wide
        side[k, 0] = share * power * abs(cosine) / (range_m * range_m)
        side[k, 1] = range_m * (1.0 + 2.0 * across * mean + tilt - wide) / power
        side[k, 2] = (across * across * variance + along) * range_m * range_m
        side[k, 3] = range_m
        side[k, 4] = math.sqrt(tangent)
        if not range_m > 0.0:
            return -1
    return 0 if z >= 0.0 else 1


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _joined(echo: np.ndarray, row: int, join_m: float) -> int:
    """Two echoes from `row` on as one where their ranges are nearly the same; how many they are now."""
    step = echo[row + 1, 1] - echo[row, 1]
    total = echo[row, 0] + echo[row + 1, 0]
    if abs(step) >= join_m or total == 0.0:
        return 2
    part = echo[row + 1, 0] / total
    echo[row, 2] += part * (echo[row + 1, 2] - echo[row, 2]) + part * (1.0 - part) * step * step
    echo[row, 1] += part * step
    echo[row, 0] = total
    return 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def see_surfaces(
    origin: np.ndarray,
    direction: np.ndarray,
    touch_first: np.ndarray,
    touch_count: np.ndarray,
    touch_row: np.ndarray,
    touch_whole: np.ndarray,
    corner: np.ndarray,
    plane: np.ndarray,
    rho: np.ndarray,
    reach: float,
    spread: float,
    scale: float,
    extinction: float,
    pulse_m: float,
) -> tuple[np.ndarray, int, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Echoes of those of n beams that see one surface or one crease, before noise, and the others' numbers.

    Parameters
    ----------
    origin, direction : (n, 3) ndarray
        World frame; unit directions. [m]
    touch_first, touch_count, touch_row, touch_whole : ndarray
        See `fan.touch`. Changed: what does not reach into a cone, in double precision, is taken out.
    corner, plane : (t, 9) float32, (t, 4) float64
        Triangles, see `tree.Tree`. [m]
    rho : (t,) ndarray
        pi times the BRDF towards the source, in the tree's order.
    reach, spread : float
        Half angle of the cone; standard deviation of the beam about one axis, a quarter of its divergence. [rad]
    scale, extinction : float
        Peak of an echo of rho cos = 1 at 1 m [DN m2]; one way [1/m].
    pulse_m : float
        Standard deviation of the echo of a flat target, as range. [m]

    Returns
    -------
    echo, echoes : (e, 3) float64, int
        Peak if the echo had not been broadened [DN], range [m], variance that is added to the pulse's [m2]; how many rows.
    first, count : (n,) int64, int32
        Rows of `echo` of each pulse.
    extent_m : (n, 3) float64
        Range along the axis, nearest, farthest; NaN where nothing is seen. [m]
    axis_row : (n,) int64
        Triangle that the axis hits, in the tree's order; -1 none.
    left : (k,) int64
        Beams that see something else.
    """
    n = len(origin)
    first, count = np.zeros(n, np.int64), np.zeros(n, np.int32)
    echo, echoes = np.empty((2 * n + 64, 3)), 0
    extent_m, axis_row = np.full((n, 3), np.nan), np.full(n, -1, np.int64)
    left, others = np.empty(n, np.int64), 0
    stands, side, beam = np.empty(64, np.int64), np.empty((2, 5)), np.empty(6)
    for i in range(n):
        begin, touched = touch_first[i], 0
        for k in range(3):
            beam[k], beam[3 + k] = origin[i, k], direction[i, k]
        if touch_count[i] > len(stands):
            stands = np.empty(2 * touch_count[i], np.int64)
        for j in range(begin, begin + touch_count[i]):
            t = touch_row[j]
            how = WHOLE
            if touch_count[i] > 1 or not touch_whole[j]:
                how = _stands(corner, t, beam, reach)
            if how != OUTSIDE:
                touch_row[begin + touched], stands[touched] = t, how
                touched += 1
        touch_count[i] = touched
        touching = touch_row[begin : begin + touched]
        if touched == 0:
            continue
        dx, dy, dz = beam[3], beam[4], beam[5]
        first[i] = echoes
        # ---- smooth: a Gaussian beam on a tilted plane ----
        cover, range_m, cosine = -1, np.inf, 1.0
        for j in range(touched):
            if stands[j] == WHOLE:
                t = touching[j]
                along = plane[t, 0] * dx + plane[t, 1] * dy + plane[t, 2] * dz
                here_m = over(plane, t, beam) / along
                if here_m < range_m:
                    cover, range_m, cosine = t, here_m, abs(along)
        tangent = math.sqrt(max(1.0 - cosine * cosine, 0.0)) / max(cosine, 1e-9)
        smooth = cover >= 0 and reach * tangent < CURVED
        for j in range(touched):
            if smooth and touching[j] != cover:
                smooth = _hidden(corner, plane, touching[j], cover, beam)
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
        # ---- creased: a Gaussian beam that an edge cuts in two ----
        on = -1
        if touched == 2 and max(stands[0], stands[1]) < OUTSIDE:
            a, b = touching[0], touching[1]
            if _shared(corner, a, stands[0], b, stands[1]):
                on = _crease(corner, plane, a, b, stands[0], beam, spread, side)
        if on >= 0:
            near_m = min(side[0, 3] * (1.0 - reach * side[0, 4]), side[1, 3] * (1.0 - reach * side[1, 4]))
            far_m = max(side[0, 3] * (1.0 + reach * side[0, 4]), side[1, 3] * (1.0 + reach * side[1, 4]))
            if reach * max(side[0, 4], side[1, 4]) > CURVED or far_m - near_m > LONG * pulse_m:
                on = -1
        if on < 0:
            left[others] = i
            others += 1
            continue
        for k in range(2):
            echo[echoes + k, 0] = scale * rho[touching[k]] * side[k, 0] * math.exp(-2.0 * extinction * side[k, 1])
            echo[echoes + k, 1], echo[echoes + k, 2] = side[k, 1], side[k, 2]
        count[i] = _joined(echo, echoes, MERGE * pulse_m)
        echoes += count[i]
        axis_row[i], extent_m[i, 0], extent_m[i, 1], extent_m[i, 2] = touching[on], side[on, 3], near_m, far_m
    return echo, echoes, first, count, extent_m, axis_row, left[:others]
