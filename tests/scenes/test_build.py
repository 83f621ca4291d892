"""The whole scene: owners, materials, ground under targets, reproducibility."""

import numpy as np
import pytest

from campaign.config import Frustums, Site, Targets
from scenes.build import build_scene, site_terrain


@pytest.fixture(scope="module")
def site():
    """Steeper and rougher than the default, within 6.2.1's 10 degrees."""
    return Site(slope_deg=6.0, relief_m=0.1)


def test_same_seed_same_scene_other_seed_other_scene(make_config):
    """Rationale: one seed, one range. Expected: bytes equal for equal seeds; targets, ground and spectra all differ for
    another. Tolerance: exact.
    """
    a, b, c = (build_scene(make_config(seed=s)) for s in (5, 5, 6))
    for name in ("vertices_m", "faces", "material", "target", "part"):
        assert getattr(a.mesh, name).tobytes() == getattr(b.mesh, name).tobytes()
    for m, n in zip(a.materials, b.materials, strict=True):
        assert m.reflectance.tobytes() == n.reflectance.tobytes()
    assert not np.array_equal([t.mark_m for t in a.targets], [t.mark_m for t in c.targets])
    assert not np.array_equal(a.materials[-1].reflectance, c.materials[-1].reflectance)
    assert a.mesh.vertices_m[0, 2] != c.mesh.vertices_m[0, 2]


def test_tables_fit_together(make_config):
    """Rationale: renderer and LiDAR look material, owner and part up by face.
    Expected: ground faces: material 0, owner -1; each panel's top (part 12) two faces of its own material at its mark;
    each frustum has all parts 0-11; indices in range.
    Tolerance: 1e-9 m on the panel's top.
    """
    scene = build_scene(make_config())
    mesh = scene.mesh
    ground = mesh.target == -1
    assert (mesh.material[ground] == 0).all()
    assert (mesh.part[ground] == -1).all()
    assert scene.materials[0].texture_contrast == 0.25
    assert mesh.material.max() == len(scene.materials) - 1
    assert mesh.faces.max() == len(mesh.vertices_m) - 1
    for index, target in enumerate(scene.targets):
        own = mesh.target == index
        if target.kind == "panel":
            top = own & (mesh.part == 12)
            assert top.sum() == 2
            (number,) = np.unique(mesh.material[top])
            assert scene.materials[number] is target.spectrum
            corners = mesh.vertices_m[np.unique(mesh.faces[top])]
            np.testing.assert_allclose(corners.mean(axis=0), target.mark_m, atol=1e-9)
            edge = np.linalg.norm(corners - target.mark_m, axis=1)
            np.testing.assert_allclose(edge, target.size_m / np.sqrt(2.0), atol=1e-9)
        else:
            assert set(np.unique(mesh.part[own])) == set(range(12))
    assert all(m.texture_contrast == 0.0 for m in scene.materials[1:])


def test_marks_lie_where_the_mesh_has_them(make_config):
    """Rationale: mark_m and azimuth_deg are the truth that the survey is drawn from.
    Expected: all mark triangles meet in mark_m; the white quadrants lie at azimuth + 45 and + 225 degrees; the vertex is
    the mark (inverted) or 0.7071 b above it (upright).
    Tolerance: 1e-9 m.
    """
    for style in ("inverted", "upright"):
        scene = build_scene(make_config(targets=Targets(frustums=Frustums(style=style))))
        mesh = scene.mesh
        for index, target in enumerate(scene.targets):
            if target.kind != "frustum":
                continue
            mark = (mesh.target == index) & (mesh.part == 9)
            corner = mesh.vertices_m[mesh.faces[mark]]
            np.testing.assert_allclose(corner[:, 0] - target.mark_m, 0.0, atol=1e-9)
            offset = corner.mean(axis=1) - target.mark_m
            azimuth = np.degrees(np.arctan2(offset[:, 0], offset[:, 1])) - target.azimuth_deg
            white = np.array([m.name == "mark_white" for m in scene.materials])[mesh.material[mark]]
            np.testing.assert_array_equal(white, np.sin(2.0 * np.radians(azimuth)) > 0)
            rise = 0.0 if style == "inverted" else 0.8 / np.sqrt(2.0)
            np.testing.assert_allclose(target.vertex_m - target.mark_m, [0.0, 0.0, rise], atol=1e-9)


def test_targets_stand_on_the_ground(make_config, site):
    """Rationale: nothing floats and no plate dips into a slope.
    Expected: every target's lowest vertex is below the ground there, its slab or plate nowhere below ground plus the
    stand's height.
    Tolerance: 5 mm, the mesh of the ground against its closed form at 10 cm relief.
    """
    config = make_config(site=site)
    scene = build_scene(config)
    terrain = site_terrain(config)
    mesh = scene.mesh
    for index in range(len(scene.targets)):
        own = mesh.target == index
        points = mesh.vertices_m[np.unique(mesh.faces[own])]
        column = points[points[:, 2] < points[:, 2].min() + 1e-6]
        assert (column[:, 2] < terrain.height(column[:, 0], column[:, 1])).all()
        slab = mesh.vertices_m[np.unique(mesh.faces[own & np.isin(mesh.part, (-1, 12, 8))])]
        gap = slab[:, 2] - terrain.height(slab[:, 0], slab[:, 1])
        assert gap.min() > 0.15 - 0.005
        assert np.ptp(mesh.vertices_m[np.unique(mesh.faces[own & np.isin(mesh.part, (12, 9))]), 2]) < 1e-12  # levelled
