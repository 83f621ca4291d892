"""Frustum targets (6.2.2 c-g, figure 2): sheet-metal funnel, base plate with its four-sector mark, supports, stand.

Target frame: origin at the mark's centre M on the plate's top face, x right, y along the target's azimuth, z up.
The standard's trapezoids (60 and 120 degrees, short edge = b/2) fix everything but b: legs b/2, faces tilted by
54.74 degrees, and four face planes that meet 0.7071 b from the large rim. The inverted funnel holds that vertex at M;
the upright one stands on the plate and has it 0.7071 b above M. Where a target stands is not decided here.
"""

from dataclasses import dataclass

import numpy as np

from campaign.config import Frustums
from campaign.errors import ConfigError
from scenes.shapes import Body, body, box, joined, quads_to_triangles, rim_quads, side_quads, square_ring

PART_INNER, PART_OUTER, PART_PLATE, PART_MARK, PART_SUPPORT, PART_RIM = 0, 4, 8, 9, 10, 11

VERTEX_PER_EDGE = float(np.sqrt(0.5))  # distance of the common vertex from the large rim, over b
PLATE_THICKNESS_M = 0.008
PLATE_BORDER_M = 0.02  # outside the funnel's corners (inverted: outside its supports)
SUPPORT_WIDTH_M = 0.012
STAND_SHARE = 0.4  # edge of the stand's column over the plate's
LEAST_SHEET_M = 5e-5  # a sheet of no thickness would leave it to chance which of its two faces a ray meets
MARK_SEGMENTS = 64  # a multiple of 8; the polygon is 0.06 % smaller in radius than the circle, on the mean
OVERLAP_M = 0.001  # parts that are joined reach this far into each other, so that no gap and no shared face is left


@dataclass(frozen=True, kw_only=True)
class FrustumMaterials:
    """Indices into the scene's materials."""

    face: int
    plate: int
    white: int
    black: int
    metal: int


def vertex_offset_m(frustums: Frustums) -> float:
    """Height of the common vertex of the stated faces above the mark's centre. [m]"""
    return 0.0 if frustums.style == "inverted" else frustums.long_edge_m * VERTEX_PER_EDGE


def vertex_faces(frustums: Frustums) -> str:
    """Which faces meet in the stated vertex: those that a sensor above sees."""
    return "inner" if frustums.style == "inverted" else "outer"


def _sheet_shift_m(frustums: Frustums) -> float:
    """How far a sheet's second face lies beside the first, measured horizontally: t / sin(54.74 degrees). [m]"""
    return max(frustums.thickness_m, LEAST_SHEET_M) * float(np.sqrt(1.5))


def plate_edge_m(frustums: Frustums) -> float:
    """Edge of the square base plate: the large rim, its supports and a border. [m]"""
    edge = frustums.long_edge_m + 2.0 * PLATE_BORDER_M
    if frustums.style == "inverted":
        edge += 2.0 * (_sheet_shift_m(frustums) + SUPPORT_WIDTH_M)
    return edge


def top_m(frustums: Frustums) -> float:
    """Height of the target's highest point above its mark. [m]"""
    share = 1.0 if frustums.style == "inverted" else 0.5
    return frustums.long_edge_m * VERTEX_PER_EDGE * share


def _funnel(frustums: Frustums, materials: FrustumMaterials) -> Body:
    """The sheet: inner and outer faces a thickness apart, both rims closed by horizontal strips."""
    b, shift = frustums.long_edge_m, _sheet_shift_m(frustums)
    half_small, half_large = 0.25 * b, 0.5 * b
    if frustums.style == "inverted":  # small rim below; the inner faces are the stated ones
        halves = {"inner": (half_small, half_large), "outer": (half_small + shift, half_large + shift)}
        z_low, z_high = 0.5 * b * VERTEX_PER_EDGE, b * VERTEX_PER_EDGE
    else:  # large rim on the plate; the outer faces are the stated ones
        halves = {"inner": (half_large - shift, half_small - shift), "outer": (half_large, half_small)}
        z_low, z_high = 0.0, 0.5 * b * VERTEX_PER_EDGE
    rings = [square_ring(half, z) for key in ("inner", "outer") for half, z in zip(halves[key], (z_low, z_high))]
    inner_low, inner_high, outer_low, outer_high = 0, 4, 8, 12
    quads = np.concatenate(
        [
            side_quads(inner_low, inner_high)[:, ::-1],
            side_quads(outer_low, outer_high),
            rim_quads(inner_high, outer_high),
            rim_quads(inner_low, outer_low)[:, ::-1],
        ]
    )
    sides = np.arange(4)
    part = np.concatenate([PART_INNER + sides, PART_OUTER + sides, np.full(8, PART_RIM)])
    return body(np.concatenate(rings), quads_to_triangles(quads), materials.face, np.repeat(part, 2))


def _plate(frustums: Frustums, materials: FrustumMaterials) -> Body:
    """The base plate; its top face is the disc of the mark and, around it and sharing its border, the rest of the plate.

    Sectors: white where x and y have the same sign, black in the other two.
    """
    n = MARK_SEGMENTS
    angle = 2.0 * np.pi * np.arange(n) / n
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    direction[np.abs(direction) < 1e-12] = 0.0
    disc = frustums.mark_radius_m * direction
    edge = 0.5 * plate_edge_m(frustums) * direction / np.max(np.abs(direction), axis=1, keepdims=True)
    vertices = np.zeros((2 + 3 * n, 3))
    vertices[1 : n + 1, :2] = disc
    vertices[n + 1 : 2 * n + 1, :2] = edge
    vertices[2 * n + 1 : 3 * n + 1, :2] = edge
    vertices[2 * n + 1 :, 2] = -PLATE_THICKNESS_M
    i, j = np.arange(n), (np.arange(n) + 1) % n
    top, rim, low, below = 1, n + 1, 2 * n + 1, 3 * n + 1
    sectors = np.stack([np.zeros(n, dtype=int), top + i, top + j], axis=1)
    around = quads_to_triangles(np.stack([top + i, rim + i, rim + j, top + j], axis=1))
    sides = quads_to_triangles(np.stack([rim + i, low + i, low + j, rim + j], axis=1))
    bottom = np.stack([np.full(n, below), low + j, low + i], axis=1)
    colour = np.where((4 * i // n) % 2 == 0, materials.white, materials.black)
    return body(
        vertices,
        np.concatenate([sectors, around, sides, bottom]),
        np.concatenate([colour, np.full(5 * n, materials.plate)]),
        np.concatenate([np.full(n, PART_MARK), np.full(5 * n, PART_PLATE)]),
    )


def _supports(frustums: Frustums, materials: FrustumMaterials) -> list[Body]:
    """Four posts under the large rim's corners: seen from M they begin 45 degrees off the zenith, so they never hide it."""
    start = 0.5 * frustums.long_edge_m + _sheet_shift_m(frustums)
    end = start + SUPPORT_WIDTH_M
    top = frustums.long_edge_m * VERTEX_PER_EDGE
    posts = []
    for sx, sy in ((-1, 1), (1, 1), (1, -1), (-1, -1)):
        x, y = sorted((sx * start, sx * end)), sorted((sy * start, sy * end))
        posts.append(box((x[0], y[0], -OVERLAP_M), (x[1], y[1], top), materials.metal, PART_SUPPORT))
    return posts


def frustum_body(frustums: Frustums, materials: FrustumMaterials, stand_m: float) -> Body:
    """The whole target in its own frame; the stand's column reaches `stand_m` below the mark.

    Raises
    ------
    ConfigError
        The mark is wider than the small rim, or the sheet is so thick that it closes the funnel.
    """
    opening = 0.25 * frustums.long_edge_m
    if frustums.style == "upright":
        opening -= _sheet_shift_m(frustums)
    if frustums.mark_radius_m > opening:
        raise ConfigError(
            "the mark does not fit in the small rim, which would cover it even from straight above",
            where="targets.frustums.mark_radius_m",
            got=frustums.mark_radius_m,
            expected=f"at most {opening:.4g} m with long_edge_m = {frustums.long_edge_m:.4g}",
        )
    parts = [_funnel(frustums, materials), _plate(frustums, materials)]
    if frustums.style == "inverted":
        parts += _supports(frustums, materials)
    half = 0.5 * STAND_SHARE * plate_edge_m(frustums)
    if stand_m > PLATE_THICKNESS_M:
        below = (-half, -half, -stand_m)
        parts.append(box(below, (half, half, OVERLAP_M - PLATE_THICKNESS_M), materials.metal, PART_SUPPORT))
    return joined(parts)
