"""The ground as a grid of heights, from the LiDAR points that lie away from targets."""

from dataclasses import dataclass

import numpy as np

from evaluator.view.model import Cloud

MOST_CELLS = 40_000
LEAST_CELL_M = 0.4
FILL_STEPS = 12  # a hole under a target is filled from its corners
_LOW = 0.3  # of the heights in a cell: below what grows or stands on it, above the noise's tail


@dataclass(frozen=True, kw_only=True)
class Terrain:
    """Heights at the centres of square cells; NaN where nothing was scanned. Map coordinates."""

    low_m: np.ndarray  # (2,) easting, northing of the first cell's centre
    cell_m: float
    height_m: np.ndarray  # (rows, columns): row along northing
    reflectance: np.ndarray  # (rows, columns) 0..1, NaN

    def below(self, easting_m: float, northing_m: float) -> float | None:
        """Height of the ground at a place, None off the grid."""
        column, row = np.rint((np.array([easting_m, northing_m]) - self.low_m) / self.cell_m).astype(int)
        if not (0 <= row < self.height_m.shape[0] and 0 <= column < self.height_m.shape[1]):
            return None
        height = float(self.height_m[row, column])
        return height if np.isfinite(height) else None


def best_map(cloud: Cloud) -> np.ndarray:
    """Places of all shown points, (n, 3): adjusted where they are, else as delivered. [m]"""
    delivered, adjusted = cloud.joined("map_m"), cloud.joined("adjusted_map_m")
    return np.where(np.isfinite(adjusted), adjusted, delivered)


def grid_terrain(cloud: Cloud) -> Terrain | None:
    """Heights of the ground; None without points away from targets.

    A cell's height is the 30 % quantile of its last returns: what grows on it is above, and a few are not noise alone.
    """
    if not cloud.strips:
        return None
    ground = (cloud.joined("target") < 0) & cloud.joined("last")
    xyz = best_map(cloud)[ground]
    if len(xyz) < 16:
        return None
    reflectance = cloud.joined("reflectance")[ground]
    ends = np.quantile(xyz[:, :2], [0.0005, 0.9995], axis=0)  # a few stray points do not stretch the grid
    span = np.maximum(ends[1] - ends[0], LEAST_CELL_M)
    cell = max(LEAST_CELL_M, float(np.sqrt(span[0] * span[1] / MOST_CELLS)), float(span.max()) / 2000.0)
    columns, rows = (int(v) for v in np.ceil(span / cell).astype(int))
    at = np.floor((xyz[:, :2] - ends[0]) / cell).astype(np.int64)
    inside = np.flatnonzero(np.all((at >= 0) & (at < (columns, rows)), axis=1))
    key = at[inside, 1] * columns + at[inside, 0]
    order = np.lexsort((xyz[inside, 2], key))
    cells, start, count = np.unique(key[order], return_index=True, return_counts=True)
    height = np.full(rows * columns, np.nan)
    height[cells] = xyz[inside[order], 2][start + (_LOW * (count - 1)).astype(int)]
    bright = np.full(rows * columns, np.nan)
    known = np.nan_to_num(reflectance[inside[order]])
    bright[cells] = np.add.reduceat(known, start) / count if len(cells) else bright[cells]
    return Terrain(
        low_m=ends[0] + 0.5 * cell,
        cell_m=cell,
        height_m=filled(height.reshape(rows, columns), FILL_STEPS),
        reflectance=filled(bright.reshape(rows, columns), FILL_STEPS),
    )


def filled(grid: np.ndarray, steps: int) -> np.ndarray:
    """NaN cells with at least four of eight neighbours take their mean, `steps` times; others stay NaN.

    Holes close from their corners; a straight outer border, whose cells outside have three neighbours, does not grow."""
    out = grid.copy()
    for _ in range(steps):
        hole = np.isnan(out)
        if not hole.any():
            break
        padded = np.pad(out, 1, constant_values=np.nan)
        around = np.stack([padded[1 + i : 1 + i + out.shape[0], 1 + j : 1 + j + out.shape[1]] for i, j in _NEIGHBOURS])
        known = np.isfinite(around)
        enough = hole & (known.sum(axis=0) >= 4)
        out[enough] = np.nansum(around[:, enough], axis=0) / known[:, enough].sum(axis=0)
    return out


_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
