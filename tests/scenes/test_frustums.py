"""The frustum target against the closed forms of 6.2.2 d and 9.3.2 g."""

import numpy as np
import pytest
import trimesh

from campaign.config import Frustums
from campaign.errors import ConfigError
from scenes.frustums import (
    FrustumMaterials,
    frustum_body,
    plate_edge_m,
    top_m,
    vertex_faces,
    vertex_offset_m,
)
from scenes.shapes import Body, placed

MATERIALS = FrustumMaterials(metal=1, plate=2, face=3, white=4, black=5)
STYLES = ["inverted", "upright"]


def plane(piece: Body, part: int) -> tuple[np.ndarray, float]:
    """Unit normal n and offset d of n.x = d through one part's vertices, by the winding of its first triangle."""
    faces = piece.faces[piece.part == part]
    a, b, c = piece.vertices_m[faces[0]]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    points = piece.vertices_m[np.unique(faces)]
    assert np.ptp(points @ normal) < 1e-12  # all four corners lie in it
    return normal, float(points[0] @ normal)


def stated_parts(frustums: Frustums) -> range:
    return range(4) if vertex_faces(frustums) == "inner" else range(4, 8)


def meeting_point(piece: Body, parts: range) -> tuple[np.ndarray, float]:
    """Least squares intersection of four planes and the largest distance of it to any of them."""
    normals, offsets = zip(*(plane(piece, p) for p in parts))
    n, d = np.array(normals), np.array(offsets)
    point = np.linalg.lstsq(n, d, rcond=None)[0]
    return point, float(np.abs(n @ point - d).max())


def corners(piece: Body, part: int) -> np.ndarray:
    """The four corners of a trapezoid, lower edge first, each edge's two ends in turn around the outline."""
    points = piece.vertices_m[np.unique(piece.faces[piece.part == part])]
    low = points[points[:, 2] < points[:, 2].mean()]
    high = points[points[:, 2] > points[:, 2].mean()]
    if np.dot(low[1] - low[0], high[1] - high[0]) > 0:
        high = high[::-1]
    return np.concatenate([low, high])


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("long_edge", [0.5, 0.8, 1.3])
def test_face_planes_meet_in_the_stated_vertex(style, long_edge):
    """Rationale: 9.3.2 g takes the vertex from the planes; survey and truth state where it is.
    Expected: the four stated planes meet at (0, 0, vertex_offset): 0 for inverted, b/sqrt(2) for upright.
    Tolerance: 1e-9 m, rounding of the intersection only.
    """
    frustums = Frustums(style=style, long_edge_m=long_edge, mark_radius_m=0.1)
    piece = frustum_body(frustums, MATERIALS, 0.5)
    point, miss = meeting_point(piece, stated_parts(frustums))
    expected = 0.0 if style == "inverted" else long_edge / np.sqrt(2.0)
    assert vertex_offset_m(frustums) == pytest.approx(expected, abs=1e-15)
    np.testing.assert_allclose(point, [0.0, 0.0, expected], atol=1e-9)
    assert miss < 1e-9


@pytest.mark.parametrize("style", STYLES)
def test_trapezoids_have_the_standards_angles(style):
    """Rationale: 6.2.2 d: isosceles trapezoids of 60 and 120 degrees, short edge half the long one.
    Expected: angles 60, 60, 120, 120; edges b, b/2, b/2, b/2; faces tilted by atan(sqrt 2) = 54.7356 degrees.
    Tolerance: 1e-9, rounding.
    """
    frustums = Frustums(style=style)
    piece = frustum_body(frustums, MATERIALS, 0.5)
    for part in stated_parts(frustums):
        p = corners(piece, part)
        edge = np.roll(p, -1, axis=0) - p
        length = np.linalg.norm(edge, axis=1)
        unit = edge / length[:, None]
        angle = np.degrees(np.arccos(-np.sum(unit * np.roll(unit, 1, axis=0), axis=1)))
        np.testing.assert_allclose(np.sort(angle), [60.0, 60.0, 120.0, 120.0], atol=1e-7)
        np.testing.assert_allclose(np.sort(length), np.array([0.5, 0.5, 0.5, 1.0]) * 0.8, atol=1e-12)
        normal, _ = plane(piece, part)
        assert np.degrees(np.arccos(abs(normal[2]))) == pytest.approx(54.7356103, abs=1e-6)


@pytest.mark.parametrize("style", STYLES)
def test_sheets_are_a_thickness_apart(style):
    """Rationale: inner and outer vertices differ by sqrt(3) thicknesses; truth must not mix them up.
    Expected: inner and outer plane of one side are parallel with opposite normals, `thickness_m` apart, and the
    side's horizontal direction is azimuth + 90 k.
    Tolerance: 1e-12 m; directions 1e-9.
    """
    frustums = Frustums(style=style, thickness_m=0.003)
    piece = placed(frustum_body(frustums, MATERIALS, 0.5), np.zeros(3), 30.0)
    for side in range(4):
        inner, d_inner = plane(piece, side)
        outer, d_outer = plane(piece, side + 4)
        np.testing.assert_allclose(inner, -outer, atol=1e-12)
        assert d_outer + d_inner == pytest.approx(0.003, abs=1e-12)
        azimuth = np.degrees(np.arctan2(outer[0], outer[1])) % 360.0
        assert azimuth == pytest.approx(30.0 + 90.0 * side, abs=1e-9)
        assert (outer[2] < 0.0) == (style == "inverted")


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("thickness", [0.0, 0.0015])
def test_every_shell_is_closed_and_faces_outward(style, thickness):
    """Rationale: a hole or a reversed face would let rays through or turn a normal; normals are geometric.
    Expected: each connected shell watertight with consistent winding and positive volume; the sheet's volume close to
    its mid surface times its thickness.
    Tolerance: 1 % of the sheet's volume: the rims are cut horizontally.
    """
    frustums = Frustums(style=style, thickness_m=thickness)
    piece = frustum_body(frustums, MATERIALS, 0.5)
    mesh = trimesh.Trimesh(piece.vertices_m, piece.faces, process=False)
    shells = mesh.split(only_watertight=False)
    assert len(shells) == (7 if style == "inverted" else 3)  # sheet, plate, stand, and four supports
    for shell in shells:
        assert shell.is_watertight
        assert shell.is_winding_consistent
        assert shell.volume > 0.0
    sheet = np.isin(piece.part, [*range(8), 11])
    volume = trimesh.Trimesh(piece.vertices_m, piece.faces[sheet], process=False).volume
    area = 4 * 0.5 * (0.8 + 0.4) * 0.4 * np.sqrt(0.75)
    assert volume == pytest.approx(area * max(thickness, 5e-5), rel=0.01)


@pytest.mark.parametrize(("style", "edge"), [("inverted", 0.5), ("inverted", 0.8), ("upright", 0.85)])
def test_size_meets_6_2_2_c(style, edge):
    """Rationale: 6.2.2 c: at least 50 x 50 x 30 cm; STANDARD 2 shows which b reach it in each style.
    Expected: the large rim spans b; the highest point is b/sqrt(2) (inverted) or half that (upright) above the plate.
    Tolerance: 1e-12 m on height; the outer rim may exceed b by two sheets.
    """
    frustums = Frustums(style=style, long_edge_m=edge, mark_radius_m=0.1)
    piece = frustum_body(frustums, MATERIALS, 0.5)
    funnel = piece.vertices_m[np.unique(piece.faces[np.isin(piece.part, range(8))])]
    span = np.ptp(funnel, axis=0)
    assert edge <= span[0] <= edge + 2 * 0.0015 * np.sqrt(1.5) + 1e-12
    height = edge / np.sqrt(2.0) * (1.0 if style == "inverted" else 0.5)
    assert funnel[:, 2].max() == pytest.approx(height, abs=1e-12)
    assert top_m(frustums) == pytest.approx(height, abs=1e-12)
    assert span[0] >= 0.5
    assert span[1] >= 0.5
    assert height >= 0.3
    plate = piece.vertices_m[np.unique(piece.faces[piece.part == 8])]
    np.testing.assert_allclose(np.ptp(plate[:, :2], axis=0), plate_edge_m(frustums), atol=1e-12)
    assert plate_edge_m(frustums) >= span[0]


def hits(piece: Body, origin: np.ndarray, direction: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Whether each ray meets any kept triangle beyond 1e-6 m (Moeller and Trumbore, float64, both sides)."""
    a, b, c = np.moveaxis(piece.vertices_m[piece.faces[keep]], 1, 0)
    e1, e2 = b - a, c - a
    p = np.cross(direction[:, None], e2[None])
    det = np.einsum("rti,ti->rt", p, e1)
    det = np.where(np.abs(det) < 1e-15, np.nan, det)
    s = origin - a
    u = np.einsum("rti,ti->rt", p, s) / det
    q = np.cross(s, e1)
    v = direction @ q.T / det
    t = np.sum(e2 * q, axis=1)[None] / det
    with np.errstate(invalid="ignore"):
        return np.any((u > -1e-9) & (v > -1e-9) & (u + v < 1 + 1e-9) & (t > 1e-6), axis=1)


@pytest.mark.parametrize("style", STYLES)
def test_the_marks_centre_is_never_hidden(style):
    """Rationale: the camera measures M, so nothing may stand between M and a sensor within the field of view.
    Expected: every ray from M up to 35 degrees off the zenith leaves the target freely, in all azimuths; along the
    diagonals of the inverted funnel up to 44 degrees, and along its sides from 36 degrees on, below the sheet.
    Tolerance: none; the faces end at 35.26 and 45 degrees.
    """
    frustums = Frustums(style=style)
    piece = frustum_body(frustums, MATERIALS, 0.5)
    azimuth = np.radians(np.arange(0.0, 360.0, 3.0))

    def blocked(zenith_deg: float, where: np.ndarray) -> np.ndarray:
        z = np.radians(zenith_deg)
        rays = np.stack([np.sin(z) * np.sin(where), np.sin(z) * np.cos(where), np.full(len(where), np.cos(z))], axis=1)
        return hits(piece, np.zeros(3), rays, piece.part != 9)

    for zenith in (0.0, 10.0, 20.0, 30.0, 35.0):
        assert not blocked(zenith, azimuth).any()
    if style == "inverted":
        assert not blocked(44.0, np.radians([45.0, 135.0, 225.0, 315.0])).any()
        assert not blocked(36.0, np.radians([0.0, 90.0, 180.0, 270.0])).any()
    else:
        assert blocked(37.0, np.radians([0.0, 90.0])).all()  # the control: here the sheet does hide M


def test_mark_has_four_equal_sectors():
    """Rationale: the evaluator fits the sector borders; white and black must alternate about the target's axes.
    Expected: white where x y > 0, black where x y < 0, each half of the disc, all triangles meeting in M.
    Tolerance: the 64-sided polygon's area is 0.16 % below the circle's.
    """
    piece = frustum_body(Frustums(mark_radius_m=0.16), MATERIALS, 0.5)
    mark = piece.part == 9
    triangles = piece.vertices_m[piece.faces[mark]]
    np.testing.assert_array_equal(triangles[:, 0], 0.0)
    centre = triangles.mean(axis=1)
    white = piece.material[mark] == MATERIALS.white
    np.testing.assert_array_equal(white, centre[:, 0] * centre[:, 1] > 0)
    area = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])[:, 2]
    assert (area > 0).all()
    assert area[white].sum() == pytest.approx(0.5 * np.pi * 0.16**2, rel=2e-3)
    assert area[~white].sum() == pytest.approx(area[white].sum(), rel=1e-12)


def test_mark_and_plate_share_no_ground():
    """Rationale: two surfaces in one place fight for the ray; the plate must begin where the disc ends.
    Expected: the upward faces at z = 0 (disc and plate) add up to the plate's square exactly.
    Tolerance: 1e-12 m2.
    """
    frustums = Frustums()
    piece = frustum_body(frustums, MATERIALS, 0.5)
    triangles = piece.vertices_m[piece.faces[np.isin(piece.part, (8, 9))]]
    top = triangles[np.all(triangles[:, :, 2] == 0.0, axis=1)]
    area = 0.5 * np.cross(top[:, 1] - top[:, 0], top[:, 2] - top[:, 0])[:, 2]
    assert area.sum() == pytest.approx(plate_edge_m(frustums) ** 2, abs=1e-12)


def test_a_mark_wider_than_the_small_rim_is_refused():
    """Rationale: it would be covered from above. Expected: one line that names the setting and the limit. Tolerance: none."""
    with pytest.raises(ConfigError, match=r"mark_radius_m.*got 0\.21.*at most 0\.2 m"):
        frustum_body(Frustums(long_edge_m=0.8, mark_radius_m=0.21), MATERIALS, 0.5)
