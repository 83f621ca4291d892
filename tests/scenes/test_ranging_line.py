"""The ranging line as it stands: distances, what hides what, what the faces are made of."""

from collections.abc import Callable

import numpy as np
import pytest

from campaign.config import Config
from campaign.errors import ConfigError
from scenes.ranging_line import FACING_DEG, HEIGHT_SPREAD_M, PART_FACE, RangingScene, build_line, turned
from scenes.spectra import reflectance_at


@pytest.fixture
def line(make_config: Callable[..., Config]) -> RangingScene:
    return build_line(make_config(), np.random.default_rng(5))


def first_hits(line: RangingScene, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Range (n,), infinite without a hit, and face (n,) of rays (n, 3) from the LiDAR's centre: every ray with every triangle."""
    a, b, c = np.moveaxis(line.scene.mesh.vertices_m[line.scene.mesh.faces], 1, 0)
    # Solve t ray = a + u (b - a) + v (c - a) by determinants.
    e, f = b - a, c - a
    h = np.cross(ray[:, None], f[None])
    determinant = np.einsum("nkj,kj->nk", h, e)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("nkj,kj->nk", h, -a) / determinant
        q = np.cross(-a, e)
        v = np.einsum("nj,kj->nk", ray, q) / determinant
        t = np.einsum("kj,kj->k", f, q) / determinant
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    t = np.where(inside, t, np.inf)
    return t.min(axis=1), t.argmin(axis=1)


def test_panels_stand_where_the_configuration_says(line: RangingScene, make_config: Callable[..., Config]) -> None:
    """Centres lie at `distances_m` from the LiDAR, nearest first, near its height; normals point to it within a degree.

    Tolerance: rounding.
    """
    centre = np.stack([p.centre_m for p in line.panels])
    assert np.linalg.norm(centre, axis=1) == pytest.approx(sorted(make_config().ranging.distances_m), abs=1e-9)
    assert np.abs(centre[:, 2]).max() <= HEIGHT_SPREAD_M
    towards = -centre / np.linalg.norm(centre, axis=1)[:, None]
    off = np.degrees(np.arccos(np.clip([t @ p.normal for t, p in zip(towards, line.panels)], -1, 1)))
    assert off.max() <= FACING_DEG + 1e-6 and off.max() > 0.1
    assert [p.id for p in line.panels] == ["R01", "R02", "R03", "R04", "R05", "R06"]


def test_faces_are_squares_of_the_panels_material(line: RangingScene) -> None:
    """The face's corners span size x size about the centre, in its plane; its two triangles carry part 12 and the panel's own
    material, seen from outside towards the LiDAR. Tolerance: rounding at 240 m.
    """
    mesh = line.scene.mesh
    for index, panel in enumerate(line.panels):
        face = np.flatnonzero((mesh.target == index) & (mesh.part == PART_FACE))
        assert len(face) == 2
        corner = mesh.vertices_m[np.unique(mesh.faces[face])]
        assert corner.mean(axis=0) == pytest.approx(panel.centre_m, abs=1e-9)
        assert (corner - panel.centre_m) @ panel.normal == pytest.approx(np.zeros(4), abs=1e-9)
        a, b, c = np.moveaxis(mesh.vertices_m[mesh.faces[face]], 1, 0)
        normal = np.cross(b - a, c - a)
        assert np.linalg.norm(normal, axis=1).sum() / 2 == pytest.approx(panel.size_m**2, rel=1e-9)
        assert (normal @ panel.normal > 0).all()
        assert sorted(map(tuple, corner.round(6))) == sorted(map(tuple, line.corners_m[index].round(6)))
        material = line.scene.materials[int(mesh.material[face[0]])]
        assert material.name == f"panel_{panel.id}"
        assert reflectance_at(material, 1550.0) == pytest.approx(0.6, abs=0.05)


def test_no_panel_hides_another(line: RangingScene) -> None:
    """Rays from the LiDAR's centre to a grid over every face meet that face first, at its own distance.

    Tolerance: 1 mm of range, far below anything else that could be hit.
    """
    mesh = line.scene.mesh
    for index, corner in enumerate(line.corners_m):
        u, v = np.meshgrid(np.linspace(0.01, 0.99, 8), np.linspace(0.013, 0.987, 7))  # none on a diagonal
        goal = corner[0] + u.reshape(-1, 1) * (corner[1] - corner[0]) + v.reshape(-1, 1) * (corner[3] - corner[0])
        far = np.linalg.norm(goal, axis=1)
        range_m, face = first_hits(line, goal / far[:, None])
        assert (mesh.target[face] == index).all() and (mesh.part[face] == PART_FACE).all()
        assert range_m == pytest.approx(far, abs=1e-3)


def test_every_level_beam_is_stopped(line: RangingScene) -> None:
    """Nothing lies beyond `farthest_m`, and a level beam between the panels ends at the wall: no ambiguous echo."""
    mesh = line.scene.mesh
    assert np.linalg.norm(mesh.vertices_m, axis=1).max() <= line.farthest_m + 1e-6
    azimuth = np.arctan2(line.corners_m[..., 0], line.corners_m[..., 1])
    a = np.linspace(azimuth.min() - 0.03, azimuth.max() + 0.03, 100)
    beam = np.stack([np.sin(a), np.cos(a), np.zeros_like(a)], axis=-1)
    range_m, _ = first_hits(line, beam)
    assert range_m.max() <= line.farthest_m
    assert (mesh.target[first_hits(line, beam)[1]] == -1).any()  # some pass between the panels


def test_other_axes_are_a_rotation(line: RangingScene) -> None:
    """A quarter turn about the vertical takes (x, y) to (-y, x). Tolerance: rounding."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    before, after = line.scene.mesh.vertices_m, turned(line.scene, quarter).mesh.vertices_m
    assert after == pytest.approx(np.stack([-before[:, 1], before[:, 0], before[:, 2]], axis=-1), abs=1e-12)


@pytest.mark.parametrize(
    ("distances", "said"),
    [
        ((15.0, 60.0, 60.2, 100.0), "same distance"),
        ((0.9, 60.0), "side by side"),
        ((1.3, 2.0, 2.7, 3.4, 4.1, 4.8), "fit"),
    ],
)
def test_a_line_that_cannot_stand_is_refused(
    make_config: Callable[..., Config], distances: tuple[float, ...], said: str
) -> None:
    """One line that names the setting."""
    config = make_config()
    crowded = config.model_copy(update={"ranging": config.ranging.model_copy(update={"distances_m": distances})})
    with pytest.raises(ConfigError, match=f"ranging.distances_m: .*{said}"):
        build_line(crowded, np.random.default_rng(1))
