"""Which triangles a beam's narrow cone touches: all of them, however small, and which of them hold the whole cone.

Consecutive pulses form a fan; the blocks of triangles that it may touch are found once (`tree`), and each pulse compares its cone
with their edges. An edge is compared by the plane through it and the beam's origin: of a unit direction d and the normal m of
that plane, d.m is the sine of the angle between beam and edge. For a beam that starts beside the fan's origin, at delta, the
same is d.m - (d x delta).e, with e the edge; m and e are both divided by the length of m.

Loops over a block run on views from zero: where an index might be negative to the compiler, nothing becomes a vector instruction.
"""

import math

import numba
import numpy as np

from simulator.pulses.tree import WIDE

GROUP = 32  # pulses of a fan, at most
FAN_COS = math.cos(0.12)  # how far a fan opens from its first pulse
LANES = 18  # numbers of a triangle: three edges, each m and e
TINY = np.float32(1e-30)
SLACK = 1e-6  # what single precision may lose of an angle [rad]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fan(
    origin: np.ndarray,
    direction: np.ndarray,
    first: int,
    count: int,
    stride: int,
    reach: float,
    out: np.ndarray,
    way: np.ndarray,
    slope: np.ndarray,
) -> float:
    """Four outward planes and what lies behind a fan: five times (normal, margin) in `out`; its axes in `way`.

    `slope`: where each pulse points along the fan. Returns how far to both sides its cone reaches.
    """
    last = first + (count - 1) * stride
    cx = direction[first, 0] + direction[last, 0]
    cy = direction[first, 1] + direction[last, 1]
    cz = direction[first, 2] + direction[last, 2]
    scale = 1.0 / math.sqrt(cx * cx + cy * cy + cz * cz)
    cx, cy, cz = cx * scale, cy * scale, cz * scale
    px = direction[last, 0] - direction[first, 0]
    py = direction[last, 1] - direction[first, 1]
    pz = direction[last, 2] - direction[first, 2]
    along = px * cx + py * cy + pz * cz
    px, py, pz = px - along * cx, py - along * cy, pz - along * cz
    if px * px + py * py + pz * pz < 1e-18:
        if abs(cx) < 0.6:
            px, py, pz = 1.0 - cx * cx, -cx * cy, -cx * cz
        else:
            px, py, pz = -cx * cy, 1.0 - cy * cy, -cy * cz
    scale = 1.0 / math.sqrt(px * px + py * py + pz * pz)
    px, py, pz = px * scale, py * scale, pz * scale
    qx, qy, qz = cy * pz - cz * py, cz * px - cx * pz, cx * py - cy * px
    a0 = b0 = np.inf
    a1 = b1 = -np.inf
    apart = 0.0
    for k in range(count):
        i = first + k * stride
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        forward = 1.0 / (dx * cx + dy * cy + dz * cz)
        a = (dx * px + dy * py + dz * pz) * forward
        b = (dx * qx + dy * qy + dz * qz) * forward
        slope[k] = a
        a0, a1, b0, b1 = min(a0, a), max(a1, a), min(b0, b), max(b1, b)
        for m in range(3):
            apart = max(apart, abs(origin[i, m] - origin[first, m]))
    most = max(max(abs(a0), abs(a1)), max(abs(b0), abs(b1)))
    pad = (reach + 2.0 * SLACK) * (1.0 + 2.0 * most * most) * 1.02
    a0, a1, b0, b1 = a0 - pad, a1 + pad, b0 - pad, b1 + pad
    margin = 2.0 * apart + 1e-3
    for k in range(5):
        out[4 * k + 3] = margin
    out[0], out[1], out[2] = px - a1 * cx, py - a1 * cy, pz - a1 * cz
    out[4], out[5], out[6] = a0 * cx - px, a0 * cy - py, a0 * cz - pz
    out[8], out[9], out[10] = qx - b1 * cx, qy - b1 * cy, qz - b1 * cz
    out[12], out[13], out[14] = b0 * cx - qx, b0 * cy - qy, b0 * cz - qz
    out[16], out[17], out[18] = -cx, -cy, -cz
    way[0], way[1], way[2], way[3], way[4], way[5] = cx, cy, cz, px, py, pz
    way[6] = 2.0 * apart * (1.0 + most)
    return pad


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _meets(plane: np.ndarray, box: np.ndarray, ox: np.float32, oy: np.float32, oz: np.float32, hit: np.ndarray) -> None:
    """Which of the boxes the fan may touch. `plane`, `box` flat, single precision."""
    for k in range(WIDE):
        x, y, z = box[k] - ox, box[k + WIDE] - oy, box[k + 2 * WIDE] - oz
        hx, hy, hz = box[k + 3 * WIDE], box[k + 4 * WIDE], box[k + 5 * WIDE]
        worst = np.float32(-1e38)
        for p in range(0, 20, 4):
            nx, ny, nz = plane[p], plane[p + 1], plane[p + 2]
            over = x * nx + y * ny + z * nz - plane[p + 3] - (hx * abs(nx) + hy * abs(ny) + hz * abs(nz))
            worst = over if over > worst else worst
        hit[k] = 1 if worst <= np.float32(0.0) else 0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _edges(
    block: np.ndarray, ox: float, oy: float, oz: float, way: np.ndarray, lanes: np.ndarray
) -> tuple[float, float]:
    """Triangles of a block to the normals of their edges' planes and the edges, both over the normal's length, in `lanes`.

    Returns where they begin and end along the fan, as slopes. `way` (7,): the fan's axis, its direction across that, and how
    far apart the pulses' origins lie. [m]
    """
    low, high = np.empty(WIDE, np.float32), np.empty(WIDE, np.float32)
    cx, cy, cz, px, py, pz, apart = way[0], way[1], way[2], way[3], way[4], way[5], way[6]
    for k in range(WIDE):
        ux, uy, uz = np.float32(block[k] - ox), np.float32(block[k + WIDE] - oy), np.float32(block[k + 2 * WIDE] - oz)
        ex, ey, ez = (
            block[k + 3 * WIDE] - block[k],
            block[k + 4 * WIDE] - block[k + WIDE],
            block[k + 5 * WIDE] - block[k + 2 * WIDE],
        )
        fx, fy, fz = (
            block[k + 6 * WIDE] - block[k + 3 * WIDE],
            block[k + 7 * WIDE] - block[k + 4 * WIDE],
            block[k + 8 * WIDE] - block[k + 5 * WIDE],
        )
        gx, gy, gz = (
            block[k] - block[k + 6 * WIDE],
            block[k + WIDE] - block[k + 7 * WIDE],
            block[k + 2 * WIDE] - block[k + 8 * WIDE],
        )
        turn = ux * (ey * fz - ez * fy) + uy * (ez * fx - ex * fz) + uz * (ex * fy - ey * fx)
        one = np.float32(1.0) if turn > np.float32(0.0) else np.float32(-1.0)
        ahead = ux * cx + uy * cy + uz * cz
        slope = (ux * px + uy * py + uz * pz) / ahead
        least, most, behind = slope, slope, ahead
        x, y, z = uy * ez - uz * ey, uz * ex - ux * ez, ux * ey - uy * ex
        scale = one / np.sqrt(x * x + y * y + z * z + TINY)
        lanes[k], lanes[k + WIDE], lanes[k + 2 * WIDE] = x * scale, y * scale, z * scale
        lanes[k + 3 * WIDE], lanes[k + 4 * WIDE], lanes[k + 5 * WIDE] = ex * scale, ey * scale, ez * scale
        ux, uy, uz = ux + ex, uy + ey, uz + ez
        ahead = ux * cx + uy * cy + uz * cz
        slope = (ux * px + uy * py + uz * pz) / ahead
        least, most = slope if slope < least else least, slope if slope > most else most
        behind = ahead if ahead < behind else behind
        x, y, z = uy * fz - uz * fy, uz * fx - ux * fz, ux * fy - uy * fx
        scale = one / np.sqrt(x * x + y * y + z * z + TINY)
        lanes[k + 6 * WIDE], lanes[k + 7 * WIDE], lanes[k + 8 * WIDE] = x * scale, y * scale, z * scale
        lanes[k + 9 * WIDE], lanes[k + 10 * WIDE], lanes[k + 11 * WIDE] = fx * scale, fy * scale, fz * scale
        ux, uy, uz = ux + fx, uy + fy, uz + fz
        ahead = ux * cx + uy * cy + uz * cz
        slope = (ux * px + uy * py + uz * pz) / ahead
        least, most = slope if slope < least else least, slope if slope > most else most
        behind = ahead if ahead < behind else behind
        x, y, z = uy * gz - uz * gy, uz * gx - ux * gz, ux * gy - uy * gx
        scale = one / np.sqrt(x * x + y * y + z * z + TINY)
        lanes[k + 12 * WIDE], lanes[k + 13 * WIDE], lanes[k + 14 * WIDE] = x * scale, y * scale, z * scale
        lanes[k + 15 * WIDE], lanes[k + 16 * WIDE], lanes[k + 17 * WIDE] = gx * scale, gy * scale, gz * scale
        good = behind > np.float32(0.01)
        aside = apart / behind
        low[k] = least - aside if good else np.float32(-1e30)
        high[k] = most + aside if good else np.float32(1e30)
    first, last = low[0], high[0]
    for j in range(1, WIDE):
        first, last = min(first, low[j]), max(last, high[j])
    return first, last


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _blocks(
    plane: np.ndarray,
    ox: np.float32,
    oy: np.float32,
    oz: np.float32,
    box: np.ndarray,
    level: np.ndarray,
    stack: np.ndarray,
    number: np.ndarray,
) -> tuple[np.ndarray, int]:
    """Blocks of triangles that the fan may touch, and how many."""
    found = 0
    depth = 1
    stack[0], stack[1] = len(level) - 1, 0
    hit = np.empty(WIDE, np.int32)
    while depth > 0:
        depth -= 1
        height, row = stack[2 * depth], stack[2 * depth + 1]
        at = (level[height] + row) * (6 * WIDE)
        _meets(plane, box[at : at + 6 * WIDE], ox, oy, oz, hit)
        for j in range(WIDE):
            if hit[j] == 0:
                continue
            if height > 0:
                stack[2 * depth], stack[2 * depth + 1] = height - 1, row * WIDE + j
                depth += 1
                continue
            if found == len(number):
                longer = np.empty(2 * found, np.int64)
                longer[:found] = number
                number = longer
            number[found] = row * WIDE + j
            found += 1
    return number, found


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _compare(
    lanes: np.ndarray,
    dx: np.float32,
    dy: np.float32,
    dz: np.float32,
    gx: np.float32,
    gy: np.float32,
    gz: np.float32,
    limit: np.float32,
    least: np.ndarray,
    near: np.ndarray,
) -> None:
    """Of a block's triangles the smallest angle from an edge to the beam, positive inside, and whether that is in the cone."""
    for k in range(WIDE):
        a = lanes[k] * dx + lanes[k + WIDE] * dy + lanes[k + 2 * WIDE] * dz
        a -= lanes[k + 3 * WIDE] * gx + lanes[k + 4 * WIDE] * gy + lanes[k + 5 * WIDE] * gz
        b = lanes[k + 6 * WIDE] * dx + lanes[k + 7 * WIDE] * dy + lanes[k + 8 * WIDE] * dz
        b -= lanes[k + 9 * WIDE] * gx + lanes[k + 10 * WIDE] * gy + lanes[k + 11 * WIDE] * gz
        c = lanes[k + 12 * WIDE] * dx + lanes[k + 13 * WIDE] * dy + lanes[k + 14 * WIDE] * dz
        c -= lanes[k + 15 * WIDE] * gx + lanes[k + 16 * WIDE] * gy + lanes[k + 17 * WIDE] * gz
        a = a if a < b else b
        a = a if a < c else c
        least[k] = a
        near[k] = 1 if a > -limit else 0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def touch(
    origin: np.ndarray,
    direction: np.ndarray,
    stride: int,
    reach: float,
    box: np.ndarray,
    level: np.ndarray,
    block: np.ndarray,
    triangles: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Triangles that each of n cones touches.

    Parameters
    ----------
    origin, direction : (n, 3) ndarray
        World frame; unit directions. [m]
    stride : int
        Pulses i and i + stride are neighbours: the number of channels fired in turn.
    reach : float
        Half angle of the cone. [rad]
    box, level, block : ndarray
        See `tree.Tree`; `box` and `block` flat.
    triangles : int
        In the tree.

    Returns
    -------
    first, count : (n,) int64, int32
        Rows of the next two arrays of each pulse.
    row : (k,) int64
        Triangle, in the tree's order. Some may lie just outside the cone; none inside it is missing.
    whole : (k,) bool
        Whether the whole cone goes through it.
    """
    n = len(origin)
    limit = np.float32(reach + SLACK)
    first, count = np.zeros(n, np.int64), np.zeros(n, np.int32)
    row, whole = np.empty(4 * n + 64, np.int64), np.empty(4 * n + 64, np.bool_)
    rows = 0
    plane, way, slope = np.empty(20, np.float32), np.empty(7, np.float32), np.empty(GROUP)
    stack, number = np.empty(2 * WIDE * (len(level) + 1), np.int64), np.empty(8, np.int64)
    lanes, span = np.empty(WIDE * LANES * len(number), np.float32), np.empty((len(number), 2))
    least, near = np.empty(WIDE, np.float32), np.empty(WIDE, np.uint8)
    words = near.view(np.uint64)  # eight bytes of 0 and 1 at a glance
    for begin in range(min(stride, n)):
        start = begin
        while start < n:
            # ---- a fan of neighbours, and the triangles that it may touch ----
            members = 1
            while members < GROUP and start + members * stride < n:
                i = start + members * stride
                if (
                    direction[i, 0] * direction[start, 0]
                    + direction[i, 1] * direction[start, 1]
                    + direction[i, 2] * direction[start, 2]
                ) < FAN_COS:
                    break
                members += 1
            ox, oy, oz = origin[start, 0], origin[start, 1], origin[start, 2]
            pad = _fan(origin, direction, start, members, stride, reach, plane, way, slope)
            number, tiles = _blocks(plane, np.float32(ox), np.float32(oy), np.float32(oz), box, level, stack, number)
            if len(span) < tiles:
                lanes, span = np.empty(WIDE * LANES * len(number), np.float32), np.empty((len(number), 2))
            for tile in range(tiles):
                span[tile, 0], span[tile, 1] = _edges(
                    block[number[tile] * (9 * WIDE) : (number[tile] + 1) * (9 * WIDE)],
                    ox,
                    oy,
                    oz,
                    way,
                    lanes[tile * (LANES * WIDE) : (tile + 1) * (LANES * WIDE)],
                )
            # ---- each cone against their edges ----
            for member in range(members):
                i = start + member * stride
                left, right = slope[member] - pad, slope[member] + pad
                dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
                sx, sy, sz = origin[i, 0] - ox, origin[i, 1] - oy, origin[i, 2] - oz
                fx, fy, fz = np.float32(dx), np.float32(dy), np.float32(dz)
                gx, gy, gz = np.float32(dy * sz - dz * sy), np.float32(dz * sx - dx * sz), np.float32(dx * sy - dy * sx)
                first[i] = rows
                for tile in range(tiles):
                    if span[tile, 0] > right or span[tile, 1] < left:
                        continue
                    mine = lanes[tile * (LANES * WIDE) : (tile + 1) * (LANES * WIDE)]
                    _compare(mine, fx, fy, fz, gx, gy, gz, limit, least, near)
                    if rows + WIDE > len(row):
                        more, more_whole = np.empty(2 * len(row), np.int64), np.empty(2 * len(row), np.bool_)
                        more[:rows], more_whole[:rows] = row[:rows], whole[:rows]
                        row, whole = more, more_whole
                    for eight in range(WIDE // 8):
                        word = words[eight]
                        while word != 0:
                            low = word & (~word + np.uint64(1))
                            j = 8 * eight + int((low * np.uint64(0x0001020304050607)) >> np.uint64(56))
                            word ^= low
                            if number[tile] * WIDE + j < triangles:
                                row[rows] = number[tile] * WIDE + j
                                whole[rows] = least[j] >= limit
                                rows += 1
                count[i] = rows - first[i]
            start += members * stride
    return first, count, row, whole
