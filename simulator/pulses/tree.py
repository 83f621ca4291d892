"""Boxes over the triangles of a scene: a wide tree in plain arrays, for whoever asks what a narrow fan may touch.

Triangles are put in an order in which 32 in a row are neighbours; 32 blocks share a box of the next level, and so on, so the
tree has no pointers, and a test of 32 boxes or triangles is a handful of vector instructions.
"""

import math
import weakref
from dataclasses import dataclass

import numba
import numpy as np

WIDE = 32


@dataclass(frozen=True, kw_only=True)
class Tree:
    """t triangles; vertices as single precision holds them, as every ray tracer does."""

    corner: np.ndarray  # (t, 9) float32: three vertices, in the tree's order [m]
    plane: np.ndarray  # (t, 4) float64: unit normal, and its product with a point of the plane [m]
    face: np.ndarray  # (t,) int64: number in the mesh
    block: np.ndarray  # (b, 9, 32) float32: the same vertices by blocks; past the last triangle, the first one again
    box: np.ndarray  # (m, 6, 32) float32: centre and half size of 32 nodes; a missing node's half size is negative [m]
    normal: np.ndarray  # (t, 3) float32: unit normals, in the mesh's order, of its own vertices
    level: np.ndarray  # (l,) int64: where each level begins in `box`, the leaves' own first; the last level is one row


_last: list[tuple["weakref.ref[np.ndarray]", "weakref.ref[np.ndarray]", Tree]] = []  # one scene serves every strip


def tree_of(vertices_m: np.ndarray, faces: np.ndarray) -> Tree:
    """`build_tree`, kept for as long as the same two arrays are asked for again."""
    for known_vertices, known_faces, tree in _last:
        if known_vertices() is vertices_m and known_faces() is faces:
            return tree
    tree = build_tree(vertices_m, faces)
    _last[:] = [(weakref.ref(vertices_m), weakref.ref(faces), tree)]
    return tree


def build_tree(vertices_m: np.ndarray, faces: np.ndarray) -> Tree:
    """(v, 3) and (t, 3), at least one triangle; the same mesh gives the same tree."""
    corner = np.asarray(vertices_m, np.float32)[faces].reshape(-1, 9)
    order = _order(corner.reshape(-1, 3, 3).mean(axis=1, dtype=np.float64))
    corner = np.ascontiguousarray(corner[order])
    count = len(corner)
    filled = np.concatenate([corner, np.repeat(corner[:1], -count % WIDE, axis=0)])
    filled[count:] = corner[-1:]  # for the boxes; a query goes by the count
    vertex = filled.reshape(-1, 3 * WIDE, 3).astype(np.float64)
    low, high = vertex.min(axis=1), vertex.max(axis=1)
    boxes, level = [], [0]
    while True:
        centre, half = 0.5 * (low + high), 0.5 * (high - low)
        node = np.concatenate([centre, half], axis=1).astype(np.float32)
        node[:, 3:] += 4e-7 * (np.abs(node[:, :3]) + node[:, 3:])  # what rounding of both may lose
        missing = np.tile(np.array([0, 0, 0, -1e30, -1e30, -1e30], np.float32), (-len(node) % WIDE, 1))
        boxes.append(np.concatenate([node, missing]).reshape(-1, WIDE, 6).transpose(0, 2, 1))
        if len(low) <= WIDE:
            break
        level.append(level[-1] + len(boxes[-1]))
        start = np.arange(0, len(low), WIDE)
        low, high = np.minimum.reduceat(low, start), np.maximum.reduceat(high, start)
    return Tree(
        corner=corner,
        plane=_planes(corner),
        normal=_planes(vertices_m[faces].reshape(-1, 9))[:, :3].astype(np.float32),
        face=order,
        block=np.ascontiguousarray(filled.reshape(-1, WIDE, 9).transpose(0, 2, 1)),
        box=np.ascontiguousarray(np.concatenate(boxes)),
        level=np.array(level, np.int64),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _planes(corner: np.ndarray) -> np.ndarray:
    """(t, 9) -> (t, 4); zeros for a triangle without an area."""
    out = np.empty((len(corner), 4))
    for t in range(len(corner)):
        ax, ay, az = float(corner[t, 0]), float(corner[t, 1]), float(corner[t, 2])
        ex, ey, ez = corner[t, 3] - ax, corner[t, 4] - ay, corner[t, 5] - az
        fx, fy, fz = corner[t, 6] - ax, corner[t, 7] - ay, corner[t, 8] - az
        nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
        size = math.sqrt(nx * nx + ny * ny + nz * nz)
        scale = 0.0 if size == 0.0 else 1.0 / size
        out[t, 0], out[t, 1], out[t, 2] = nx * scale, ny * scale, nz * scale
        out[t, 3] = out[t, 0] * ax + out[t, 1] * ay + out[t, 2] * az
    return out


@numba.njit(cache=True, nogil=True)
def _order(point: np.ndarray) -> np.ndarray:
    """(t, 3) -> an order in which every 32, and every 32 times 32, are neighbours.

    The points are halved across their longest extent, at a multiple of the width, again and again.
    """
    count = len(point)
    order = np.arange(count)
    stack = [(0, count)]
    while len(stack) > 0:
        begin, end = stack.pop()
        if end - begin <= WIDE:
            continue
        axis, longest = 0, -1.0
        for k in range(3):
            low, high = np.inf, -np.inf
            for j in range(begin, end):
                low, high = min(low, point[order[j], k]), max(high, point[order[j], k])
            if high - low > longest:
                axis, longest = k, high - low
        unit = WIDE
        while unit * WIDE < end - begin:
            unit *= WIDE
        pieces = (end - begin + unit - 1) // unit
        middle = begin + (pieces // 2) * unit
        left, right = begin, end - 1
        while left < right:  # quickselect: what belongs before `middle` goes there
            pivot = point[order[(left + right) // 2], axis]
            a, b = left, right
            while a <= b:
                while point[order[a], axis] < pivot:
                    a += 1
                while point[order[b], axis] > pivot:
                    b -= 1
                if a <= b:
                    order[a], order[b] = order[b], order[a]
                    a, b = a + 1, b - 1
            if middle <= b:
                right = b
            elif middle >= a:
                left = a
            else:
                break
        stack.append((begin, middle))
        stack.append((middle, end))
    return order
