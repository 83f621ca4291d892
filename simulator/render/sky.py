"""The sky as a table for the camera's kernel: cells of equal irradiance, so that a level surface samples it without noise.

The hemisphere is laid out in s = sin^2(zenith angle) and azimuth, where a cell's area is its share of the cosine-weighted
hemisphere. Rows, and cells within a row, are cut so that every cell sends the same irradiance onto a level surface; within a
cell the radiance is constant. The distribution itself is `scenes.sunsky.sky_radiance_relative`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from simulator.render import start
from simulator.render.upload import uploaded

start()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

ROWS = 32
COLUMNS = 64
_FINE = (256, 512)  # quadrature grid in s and azimuth that the cells are cut from


@dataclass(frozen=True, kw_only=True)
class SkyTable:
    """Borders of the cells and their radiance relative to a uniform sky of the same irradiance."""

    row: Any  # mi.Float (ROWS + 1,) s
    column: Any  # mi.Float (ROWS * (COLUMNS + 1),) azimuth / 2 pi, from +x towards +y
    relative: Any  # mi.Float (ROWS * COLUMNS,)


def cells(radiance: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut the sky into cells of equal irradiance.

    Parameters
    ----------
    radiance : callable
        World directions (n, 3), unit, upper hemisphere -> radiance (n,), any scale.

    Returns
    -------
    row : (ROWS + 1,) ndarray
        Borders in s = sin^2 of the zenith angle. [1]
    column : (ROWS, COLUMNS + 1) ndarray
        Borders in azimuth / 2 pi, counter-clockwise from +x. [1]
    relative : (ROWS, COLUMNS) ndarray
        Radiance over the cosine-weighted mean radiance of the sky. [1]
    """
    s = (np.arange(_FINE[0]) + 0.5) / _FINE[0]
    turn = (np.arange(_FINE[1]) + 0.5) / _FINE[1]
    horizontal = np.sqrt(s)[:, None]
    direction = np.stack(
        np.broadcast_arrays(
            horizontal * np.cos(2 * np.pi * turn), horizontal * np.sin(2 * np.pi * turn), np.sqrt(1 - s)[:, None]
        ),
        axis=-1,
    )
    value = np.asarray(radiance(direction.reshape(-1, 3)), float).reshape(_FINE)
    edges_s, edges_turn = np.linspace(0, 1, _FINE[0] + 1), np.linspace(0, 1, _FINE[1] + 1)

    def cut(share: np.ndarray, edges: np.ndarray, count: int) -> np.ndarray:
        cumulative = np.concatenate([[0.0], np.cumsum(share)])
        return np.asarray(np.interp(np.linspace(0, 1, count + 1), cumulative / cumulative[-1], edges))

    row = cut(value.sum(axis=1), edges_s, ROWS)
    cumulative = np.concatenate([np.zeros((1, _FINE[1])), np.cumsum(value, axis=0)])
    at_border = np.stack([np.interp(row, edges_s, column) for column in cumulative.T], axis=1)
    share = np.diff(at_border, axis=0)  # (ROWS, fine azimuth)
    column = np.stack([cut(each, edges_turn, COLUMNS) for each in share])
    column[:, 0], column[:, -1] = 0.0, 1.0
    row[0], row[-1] = 0.0, 1.0
    relative = 1 / (ROWS * COLUMNS * np.diff(row)[:, None] * np.diff(column, axis=1))
    return row, column, relative


def upload(radiance: Callable[[np.ndarray], np.ndarray]) -> SkyTable:
    """`cells` on the renderer's device."""
    row, column, relative = cells(radiance)
    tables = SkyTable(
        row=uploaded(mi.Float, row.astype(np.float32)),
        column=uploaded(mi.Float, column.astype(np.float32)),
        relative=uploaded(mi.Float, relative.astype(np.float32)),
    )
    dr.eval(tables.row, tables.column, tables.relative)
    return tables


def sample(sky: SkyTable, u: Any, v: Any) -> tuple[Any, Any]:
    """Direction with density relative * cos(zenith angle) / pi, and that relative radiance."""
    x, y = u * ROWS, v * COLUMNS
    r, c = dr.minimum(mi.UInt32(x), ROWS - 1), dr.minimum(mi.UInt32(y), COLUMNS - 1)
    low = dr.gather(mi.Float, sky.row, r)
    s = dr.lerp(low, dr.gather(mi.Float, sky.row, r + 1), x - mi.Float(r))
    left = dr.gather(mi.Float, sky.column, r * (COLUMNS + 1) + c)
    turn = dr.lerp(left, dr.gather(mi.Float, sky.column, r * (COLUMNS + 1) + c + 1), y - mi.Float(c))
    sine, cosine = dr.sincos(2 * dr.pi * turn)
    horizontal = dr.sqrt(s)
    direction = mi.Vector3f(horizontal * cosine, horizontal * sine, dr.safe_sqrt(1 - s))
    return direction, dr.gather(mi.Float, sky.relative, r * COLUMNS + c)


def relative_radiance(sky: SkyTable, direction: Any) -> Any:
    """Radiance of the upper hemisphere relative to a uniform sky of the same irradiance; lanes below the horizon: rubbish."""
    s = dr.clip(direction.x * direction.x + direction.y * direction.y, 0, 1)
    turn = dr.atan2(direction.y, direction.x) * (0.5 / dr.pi)
    turn = dr.select(turn < 0, turn + 1, turn)
    r = _last_not_above(sky.row, mi.UInt32(0), ROWS, s)
    first = r * (COLUMNS + 1)
    c = _last_not_above(sky.column, first, COLUMNS, turn) - first
    return dr.gather(mi.Float, sky.relative, r * COLUMNS + c)


def _last_not_above(table: Any, first: Any, count: int, value: Any) -> Any:
    """Index of the cell in `count` (a power of two) ascending borders from `first` that holds the value."""
    index = first
    step = count // 2
    while step:
        index = dr.select(dr.gather(mi.Float, table, index + step) <= value, index + step, index)
        step //= 2
    return index
