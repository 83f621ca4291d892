"""The ground: slope, relief and the mesh that stands for its closed form."""

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator

from campaign.config import Site
from scenes.terrain import make_terrain, terrain_mesh


def test_slope_falls_towards_its_azimuth():
    """Rationale: `slope_azimuth_deg` is the direction in which the ground falls. Expected: 100 m towards 135 degrees
    the ground is 100 tan(3 deg) lower, across it level. Tolerance: 1e-9 m.
    """
    terrain = make_terrain(Site(slope_deg=3.0, slope_azimuth_deg=135.0, relief_m=0.0), np.random.default_rng(1))
    d = 100.0 / np.sqrt(2.0)
    assert terrain.height(d, -d) == pytest.approx(-100.0 * np.tan(np.radians(3.0)), abs=1e-9)
    assert terrain.height(d, d) == pytest.approx(0.0, abs=1e-9)


def test_relief_has_its_standard_deviation_and_is_smooth():
    """Rationale: `relief_m` is a standard deviation; targets' stands must not meet bumps.
    Expected: over 4 km by 4 km, 20 seeds: 0.2 m RMS; no feature shorter than 10 m, so the slope stays below
    the sum of amplitudes times 2 pi / 10 m.
    Tolerance: 2 % of the RMS: a few dozen wavelengths are averaged in each seed.
    """
    x, y = np.meshgrid(np.linspace(-2000, 2000, 201), np.linspace(-2000, 2000, 201))
    for seed in range(20):
        terrain = make_terrain(Site(slope_deg=0.0, relief_m=0.2), np.random.default_rng(seed))
        z = terrain.height(x, y)
        assert z.std() == pytest.approx(0.2, rel=0.02)
        step = (terrain.height(x + 0.01, y) - z) / 0.01
        assert np.abs(step).max() <= terrain.amplitude_m.sum() * 2.0 * np.pi / 10.0


def test_mesh_follows_the_closed_form():
    """Rationale: targets are placed by the closed form, rays meet the mesh.
    Expected: vertices on it exactly; between them within step^2 / 8 times the sum of the second derivatives; all
    triangles face up; the square is exactly covered.
    Tolerance: 2 mm in the fine part at 3 cm relief (bound 0.5^2/4 * 0.12 m * (2 pi/10)^2 = 3 mm, worst case).
    """
    site = Site(relief_m=0.03, slope_deg=2.0)
    terrain = make_terrain(site, np.random.default_rng(2))
    vertices, faces = terrain_mesh(terrain, site.extent_m, (12.0, 15.0))
    np.testing.assert_array_equal(vertices[:, 2], terrain.height(vertices[:, 0], vertices[:, 1]))
    triangle = vertices[faces]
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    assert (normal[:, 2] > 0).all()
    assert 0.5 * normal[:, 2].sum() == pytest.approx(site.extent_m**2, rel=1e-12)
    centre = triangle.mean(axis=1)
    error = centre[:, 2] - terrain.height(centre[:, 0], centre[:, 1])
    fine = (np.abs(centre[:, 0]) < 12.0) & (np.abs(centre[:, 1]) < 15.0)
    assert np.abs(error[fine]).max() < 0.002
    size = np.ptp(triangle, axis=1)[:, :2].max(axis=1)
    assert size[fine].max() <= 0.5 + 1e-12
    assert size.max() <= 6.0


def test_mesh_has_no_cracks_between_fine_and_coarse():
    """Rationale: a crack lets a beam fall through. Expected: Euler characteristic 1 of a disc: V - E + F = 1, and a
    linear interpolation on the vertices finds every point inside the square. Tolerance: none.
    """
    terrain = make_terrain(Site(), np.random.default_rng(3))
    vertices, faces = terrain_mesh(terrain, 60.0, (10.0, 8.0))
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    assert len(vertices) - len(edges) + len(faces) == 1
    points = np.random.default_rng(4).uniform(-29.9, 29.9, (500, 2))
    found = LinearNDInterpolator(vertices[:, :2], vertices[:, 2])(points)
    assert np.abs(found - terrain.height(points[:, 0], points[:, 1])).max() < 0.1


def test_fine_part_wider_than_the_ground():
    """Rationale: a low flight over a small square. Expected: the grid ends at the square. Tolerance: exact."""
    vertices, _ = terrain_mesh(make_terrain(Site(), np.random.default_rng(5)), 30.0, (40.0, 40.0))
    assert vertices[:, :2].min() == -15.0
    assert vertices[:, :2].max() == 15.0
