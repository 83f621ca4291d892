"""Triangulated bodies and how they are joined: boxes, sheet-metal rings, placement. No target and no material is named here."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Body:
    """Triangles with a material and a part for each face. Faces are counter-clockwise seen from outside."""

    vertices_m: np.ndarray  # (v, 3) float64
    faces: np.ndarray  # (f, 3) int32
    material: np.ndarray  # (f,) int32
    part: np.ndarray  # (f,) int8


def quads_to_triangles(quads: np.ndarray) -> np.ndarray:
    """(q, 4) corner indices in order -> (2 q, 3) triangles, the two of a quad next to each other."""
    quads = np.asarray(quads, dtype=np.int32)
    return np.stack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], axis=1).reshape(-1, 3)


def body(vertices_m: np.ndarray, faces: np.ndarray, material: int | np.ndarray, part: int | np.ndarray) -> Body:
    """One body; a material or part that is one number serves every face."""
    n = len(faces)
    return Body(
        vertices_m=np.asarray(vertices_m, dtype=np.float64),
        faces=np.asarray(faces, dtype=np.int32),
        material=np.broadcast_to(np.asarray(material, dtype=np.int32), (n,)).copy(),
        part=np.broadcast_to(np.asarray(part, dtype=np.int8), (n,)).copy(),
    )


def square_ring(half_m: float, z_m: float) -> np.ndarray:
    """Four corners (4, 3) of a horizontal square, clockwise from above, beginning at (-x, +y).

    Side k runs from corner k to corner k + 1: side 0 faces +y, 1 faces +x, 2 faces -y, 3 faces -x.
    """
    return np.array([[-half_m, half_m, z_m], [half_m, half_m, z_m], [half_m, -half_m, z_m], [-half_m, -half_m, z_m]])


def _next(k: np.ndarray) -> np.ndarray:
    return (k + 1) % 4


def side_quads(low: int, high: int) -> np.ndarray:
    """Four side faces between two square rings whose first corners have the indices `low` and `high`, facing outward."""
    k = np.arange(4)
    return np.stack([low + k, high + k, high + _next(k), low + _next(k)], axis=1)


def rim_quads(inner: int, outer: int) -> np.ndarray:
    """The horizontal strip between two square rings of one height, facing up."""
    k = np.arange(4)
    return np.stack([inner + k, inner + _next(k), outer + _next(k), outer + k], axis=1)


def box(low_m: Sequence[float], high_m: Sequence[float], material: int, part: int) -> Body:
    """Axis-parallel box. Its faces 0 and 1 are the top."""
    (x0, y0, z0), (x1, y1, z1) = low_m, high_m
    vertices = np.array([[x, y, z] for z in (z0, z1) for x, y in ((x0, y1), (x1, y1), (x1, y0), (x0, y0))])
    quads = np.concatenate([[[7, 6, 5, 4]], [[0, 1, 2, 3]], side_quads(0, 4)])
    return body(vertices, quads_to_triangles(quads), material, part)


def joined(bodies: Sequence[Body]) -> Body:
    """All bodies as one; they stay separate shells."""
    offsets = np.cumsum([0, *(len(b.vertices_m) for b in bodies[:-1])])
    return Body(
        vertices_m=np.concatenate([b.vertices_m for b in bodies]),
        faces=np.concatenate([b.faces + np.int32(o) for b, o in zip(bodies, offsets, strict=True)]),
        material=np.concatenate([b.material for b in bodies]),
        part=np.concatenate([b.part for b in bodies]),
    )


def placed(piece: Body, origin_m: np.ndarray, azimuth_deg: float) -> Body:
    """The body turned so that its +y axis points to `azimuth_deg` (clockwise from the world's +y), then moved."""
    a = np.radians(azimuth_deg)
    world_from_target = np.array([[np.cos(a), np.sin(a), 0.0], [-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    return Body(
        vertices_m=piece.vertices_m @ world_from_target.T + origin_m,
        faces=piece.faces,
        material=piece.material,
        part=piece.part,
    )
