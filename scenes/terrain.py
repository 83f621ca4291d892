"""The ground: an inclined plane with smooth relief, triangulated finely where targets stand. Its texture is the material's."""

from dataclasses import dataclass

import numpy as np

from campaign.config import Site
from scenes.shapes import quads_to_triangles

WAVES = 8
WAVELENGTHS_M = (10.0, 40.0)  # shortest and longest of the relief
FINE_STEP_M = 0.5
GROWTH = 1.15  # of the grid's step, from row to row outside the fine part
COARSEST_STEP_M = 4.0


@dataclass(frozen=True, kw_only=True)
class Terrain:
    """Ground height as a closed form: plane through the world's origin plus a sum of sines."""

    gradient: np.ndarray  # (2,) dz/dx, dz/dy of the plane
    wave_rad_m: np.ndarray  # (k, 2) wave vectors
    amplitude_m: np.ndarray  # (k,)
    phase_rad: np.ndarray  # (k,)

    def height(self, x_m: np.ndarray | float, y_m: np.ndarray | float) -> np.ndarray:
        """Height above the world's origin at any points. [m]"""
        x, y = np.broadcast_arrays(np.asarray(x_m, dtype=float), np.asarray(y_m, dtype=float))
        phase = x[..., None] * self.wave_rad_m[:, 0] + y[..., None] * self.wave_rad_m[:, 1] + self.phase_rad
        return np.asarray(x * self.gradient[0] + y * self.gradient[1] + np.sin(phase) @ self.amplitude_m)


def make_terrain(site: Site, rng: np.random.Generator) -> Terrain:
    """Plane that falls by `slope_deg` towards `slope_azimuth_deg`; relief with the standard deviation `relief_m`."""
    fall = np.radians(site.slope_azimuth_deg)
    log_length = rng.uniform(np.log(WAVELENGTHS_M[0]), np.log(WAVELENGTHS_M[1]), WAVES)
    direction = rng.uniform(0.0, 2.0 * np.pi, WAVES)
    weight = rng.uniform(0.5, 1.0, WAVES)
    return Terrain(
        gradient=-np.tan(np.radians(site.slope_deg)) * np.array([np.sin(fall), np.cos(fall)]),
        wave_rad_m=2.0 * np.pi / np.exp(log_length)[:, None] * np.stack([np.cos(direction), np.sin(direction)], axis=1),
        amplitude_m=site.relief_m * weight * np.sqrt(2.0 / np.sum(weight**2)),
        phase_rad=rng.uniform(0.0, 2.0 * np.pi, WAVES),
    )


def _grid_lines(half_m: float, fine_half_m: float) -> np.ndarray:
    """Symmetric grid lines: equal steps within +-fine_half_m, growing steps out to +-half_m exactly."""
    fine_half = min(fine_half_m, half_m)
    lines = list(np.linspace(0.0, fine_half, int(np.ceil(fine_half / FINE_STEP_M)) + 1))
    step = FINE_STEP_M
    while lines[-1] < half_m:
        step = min(step * GROWTH, COARSEST_STEP_M)
        lines.append(lines[-1] + step)
    if len(lines) > 2 and half_m - lines[-2] < 0.5 * step:  # no sliver at the border
        lines.pop(-2)
    lines[-1] = half_m
    positive = np.array(lines)
    return np.concatenate([-positive[:0:-1], positive])


def terrain_mesh(terrain: Terrain, extent_m: float, fine_half_m: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) and faces (f, 3) of the square of `extent_m`, facing up.

    Steps are 0.5 m where targets stand (|x|, |y| <= fine_half_m) and grow to 4 m outside. Vertices lie on the closed
    form; between them a triangle departs by at most step^2/8 of its curvature, about 1 mm where targets stand.
    """
    x, y = (_grid_lines(0.5 * extent_m, half) for half in fine_half_m)
    xx, yy = np.meshgrid(x, y)
    vertices = np.stack([xx, yy, terrain.height(xx, yy)], axis=-1).reshape(-1, 3)
    index = np.arange(xx.size, dtype=np.int32).reshape(xx.shape)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1).reshape(-1, 4)
    return vertices, quads_to_triangles(quads)
