"""2x2 boards in the scene: their pattern, their place among the other targets, and that a scene without them is untouched."""

import numpy as np
import pytest

from campaign.config import Boards, Frustums, Panels, Targets
from scenes.boards import PART_STAND, PART_TOP, board_body
from scenes.build import build_scene
from scenes.layout import minimum_spacing_m, place_targets
from scenes.streams import LAYOUT, stream


@pytest.fixture
def with_boards(make_config):
    """A configuration with so many boards and, unless told otherwise, the default frustums and panels."""

    def make(count: int, **targets):
        return make_config(targets=Targets(boards=Boards(count=count), **targets))

    return make


def test_white_where_x_and_y_have_the_same_sign():
    """Rationale: evaluator and survey rely on this pattern. Expected: the four squares' colour by the sign of x y, their area
    together the whole top, all facing up. Tolerance: 1e-12 of the area.
    """
    piece = board_body(Boards(size_m=0.9), white=4, black=5, metal=1, stand_m=0.3)
    top = piece.part == PART_TOP
    corner = piece.vertices_m[piece.faces[top]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    centre = corner.mean(axis=1)
    assert np.all(normal[:, 2] > 0.0) and np.all(corner[..., 2] == 0.0)
    assert np.sum(normal[:, 2]) / 2.0 == pytest.approx(0.81, rel=1e-12)
    assert np.array_equal(piece.material[top] == 4, centre[:, 0] * centre[:, 1] > 0.0)
    assert set(piece.material[~top]) == {1} and PART_STAND in piece.part


@pytest.mark.parametrize("stand_m", [0.3, 0.0])
def test_shells_are_closed(stand_m):
    """Rationale: a gap lets a ray through, a wrong turn hides a face. Expected: the signed volume of all triangles is that of
    slab and column, and no edge has one triangle only (the middle of each border belongs to square and side alike).
    Tolerance: 1e-12 m3.
    """
    boards = Boards(size_m=1.0, thickness_m=0.02)
    piece = board_body(boards, 4, 5, 1, stand_m)
    corner = piece.vertices_m[piece.faces]
    volume = np.sum(np.einsum("ni,ni->n", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))) / 6.0
    column = 0.4**2 * (stand_m - 0.02 + 0.001) if stand_m else 0.0
    assert volume == pytest.approx(1.0 * 0.02 + column, abs=1e-12)
    edges = np.concatenate([piece.faces[:, [i, (i + 1) % 3]] for i in range(3)])
    assert {tuple(e) for e in edges} == {tuple(e[::-1]) for e in edges}


def test_boards_stand_among_the_others(with_boards):
    """Rationale: 6.2.3 holds for all targets together. Expected: ids B01 ... B08 after panels and frustums; no two targets
    nearer than the search windows allow; the five places of 6.2.3 a stay with frustums. Tolerance: 1e-9 m.
    """
    config = with_boards(8)
    scene = build_scene(config)
    boards = [t for t in scene.targets if t.kind == "board"]
    assert [t.id for t in boards] == [f"B{k:02d}" for k in range(1, 9)] == [t.id for t in scene.targets[-8:]]
    xy = np.array([t.mark_m[:2] for t in scene.targets])
    distance = np.linalg.norm(xy[:, None] - xy[None], axis=-1) + 1e9 * np.eye(len(xy))
    assert distance.min() >= minimum_spacing_m(config) - 1e-9
    border = np.all(np.abs(xy) >= np.abs(xy).max(axis=0) - 1e-9, axis=1)
    assert border.sum() == 4 and all(scene.targets[k].kind == "frustum" for k in np.flatnonzero(border))
    assert len({round(t.azimuth_deg, 3) for t in boards}) == 8


def test_boards_alone_take_centre_and_corners(with_boards):
    """Rationale: without other targets the patent's six boards must spread over the field: centre and corners first.
    Expected: with one level of one panel, boards at the centre and at all four corners. Tolerance: 1e-9 m.
    """
    config = with_boards(
        6, frustums=Frustums(count=0), panels=Panels(nominal_reflectance_percent=(50.0,), count_of_each=1)
    )
    _, spots = place_targets(config, stream(3, LAYOUT))
    board = np.array([[s.x_m, s.y_m] for s in spots if s.kind == "board"])
    reach = np.abs([[s.x_m, s.y_m] for s in spots]).max(axis=0)
    assert np.sum(np.all(np.abs(np.abs(board) - reach) < 1e-9, axis=1)) == 4
    assert np.linalg.norm(board, axis=1).min() < 1e-9


def test_a_board_faces_the_sky_above_the_ground(with_boards):
    """Rationale: a slab below the terrain would not be seen. Expected: its mark is the centre of its top face, a stand's
    height and a slab's thickness above the highest ground under it; colours follow the azimuth. Tolerance: 1e-9 m.
    """
    config = with_boards(8)
    scene = build_scene(config)
    mesh = scene.mesh
    ground = mesh.vertices_m[np.unique(mesh.faces[mesh.target == -1])]
    for index, target in enumerate(scene.targets):
        if target.kind != "board":
            continue
        top = (mesh.target == index) & (mesh.part == PART_TOP)
        corner = mesh.vertices_m[mesh.faces[top]]
        middle = np.mean([corner.reshape(-1, 3).min(axis=0), corner.reshape(-1, 3).max(axis=0)], axis=0)
        assert middle == pytest.approx(target.mark_m, abs=1e-9)
        a = np.radians(target.azimuth_deg)
        offset = corner.mean(axis=1) - target.mark_m
        along = offset @ [np.sin(a), np.cos(a), 0.0]
        across = offset @ [np.cos(a), -np.sin(a), 0.0]
        names = np.array([m.name for m in scene.materials])[mesh.material[top]]
        assert np.array_equal(names == "mark_white", along * across > 0.0)
        near = np.linalg.norm(ground[:, :2] - target.mark_m[:2], axis=1) < 0.5
        if near.any():
            assert target.mark_m[2] > ground[near, 2].max() + 0.1


def test_no_boards_no_change(make_config, with_boards):
    """Rationale: with boards.count = 0 a campaign of before must stay the same to the byte. Expected: the mesh of a
    configuration that names no boards. Tolerance: exact."""
    a, b = build_scene(make_config(seed=4)), build_scene(make_config(seed=4, targets=Targets(boards=Boards(count=0))))
    assert a.mesh.vertices_m.tobytes() == b.mesh.vertices_m.tobytes()
    assert [t.id for t in a.targets] == [t.id for t in b.targets]
