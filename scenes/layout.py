"""Where targets stand (6.2.3): the centre and the four corners of the common field, and an even cover of all of it.

A grid with odd numbers of rows and columns has a node at the centre and at each corner. Frustums take these five, or 2x2
boards where there is no frustum; kinds, reflectance levels and stand heights are then spread so that like stands far from
like. The field itself: `fields`.
"""

from dataclasses import dataclass

import numpy as np

from campaign.config import Config
from campaign.errors import ConfigError
from scenes import boards as board_shape
from scenes.fields import common_field
from scenes.frustums import plate_edge_m
from scenes.model import Layout
from scenes.panels import half_diagonal_m

SEARCH_RADIUS_M = 1.0  # an evaluator's window about a target whose mounting is not yet known
CLEARANCE_M = 0.3  # between the circles about two neighbours
JITTER = 0.15  # of the grid's step, at most
BORDER_M = 5.0  # of ground around the field, at least
CORNERS_AND_CENTRE = 5


@dataclass(frozen=True, kw_only=True)
class Spot:
    """One place for one target."""

    kind: str  # "panel" | "frustum" | "board"
    x_m: float
    y_m: float
    azimuth_deg: float
    stand_height_m: float
    level_percent: float | None = None  # panels


def spread_labels(points_m: np.ndarray, labels: np.ndarray, fixed: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Permute labels over points so that equal ones stand far apart.

    Minimises the sum of 1/d^2 over pairs with equal labels, by the best swap until none helps.

    Parameters
    ----------
    points_m : (n, 2) array
    labels : (n,) int array
        Where `fixed` they stay; the others are shuffled first.
    fixed : (n,) bool array
    rng : numpy.random.Generator

    Returns
    -------
    (n,) int array
    """
    labels = labels.copy()
    labels[~fixed] = rng.permutation(labels[~fixed])
    difference = points_m[:, None] - points_m[None]
    distance2 = np.sum(difference**2, axis=-1)
    np.fill_diagonal(distance2, np.inf)
    weight = 1.0 / distance2
    kinds = int(labels.max(initial=0)) + 1
    movable = ~fixed[:, None] & ~fixed[None]
    for _ in range(20 * len(labels)):
        cost = weight @ np.eye(kinds)[labels]  # (n, kinds): what each point would pay under each label
        own = cost[np.arange(len(labels)), labels]
        gain = cost[:, labels] + cost[:, labels].T - 2.0 * weight - own[:, None] - own[None]
        gain[~movable | (labels[:, None] == labels[None])] = 0.0
        first, second = np.unravel_index(int(np.argmin(gain)), gain.shape)
        if gain[first, second] > -1e-12:
            break
        labels[[first, second]] = labels[[second, first]]
    return labels


def minimum_spacing_m(config: Config) -> float:
    """Least distance between two targets' centres: search windows apart, and the targets themselves clear. [m]"""
    return max(2.0 * SEARCH_RADIUS_M, 2.0 * largest_radius_m(config) + CLEARANCE_M)


def largest_radius_m(config: Config) -> float:
    """Radius of the circle around the widest target. [m]"""
    radii = [half_diagonal_m(config.targets.panels)]
    if config.targets.frustums.count:
        radii.append(plate_edge_m(config.targets.frustums) / np.sqrt(2.0))
    if config.targets.boards.count:
        radii.append(board_shape.half_diagonal_m(config.targets.boards))
    return float(max(radii))


def _best_grid(count: int, half_m: tuple[float, float]) -> tuple[int, int, float]:
    """Odd numbers of columns and rows with at least `count` nodes and the widest step. [-, -, m]"""
    candidates = []
    for columns in range(1 if count < CORNERS_AND_CENTRE else 3, count + 3, 2):
        rows = -(-count // columns)
        rows = max(rows + 1 - rows % 2, 1 if count < CORNERS_AND_CENTRE else 3)
        steps = [2.0 * half / (n - 1) for half, n in zip(half_m, (columns, rows)) if n > 1]
        candidates.append((min(steps, default=np.inf), -columns * rows, columns, rows))
    step, _, columns, rows = max(candidates)
    return columns, rows, float(step)


def _node_half_m(config: Config, layout: Layout) -> tuple[float, float]:
    radius = largest_radius_m(config)
    return max(layout.field_half_m[0] - radius, 0.0), max(layout.field_half_m[1] - radius, 0.0)


def _target_count(config: Config) -> tuple[int, int, int]:
    """Frustums, panels, boards."""
    panels = config.targets.panels
    of_panels = len(panels.nominal_reflectance_percent) * panels.count_of_each
    return config.targets.frustums.count, of_panels, config.targets.boards.count


def _refuse(config: Config, step_m: float, layout: Layout) -> ConfigError:
    height, count = min(config.flight.heights_m), sum(_target_count(config))
    needed = minimum_spacing_m(config)
    fits = None
    for factor in np.arange(1.02, 6.0, 0.02):
        field = common_field(config, height * factor)
        if _best_grid(count, _node_half_m(config, field))[2] >= needed:
            fits = height * factor
            break
    odd = "set an odd flight.strips_per_heading, " if config.flight.strips_per_heading % 2 == 0 else ""
    raise_to = f"fly at {fits:.1f} m or higher, " if fits is not None else ""
    return ConfigError(
        f"{count} targets do not fit in the field that both sensors see on every heading (6.2.3)",
        where="targets",
        got=(
            f"a field of {2 * layout.field_half_m[0]:.1f} x {2 * layout.field_half_m[1]:.1f} m at {height:g} m"
            f" and {step_m:.2f} m from target to target"
        ),
        expected=f"at least {needed:.2f} m",
        remedy=(f"{raise_to}{odd}or place fewer or smaller targets"),
    )


def _drop_surplus(points_m: np.ndarray, keep: np.ndarray, surplus: int, rng: np.random.Generator) -> np.ndarray:
    """Indices of the points that stay; the ones left out stand far from each other and from `keep`.

    They come from the inside, where neighbours close the gap, while at least half of the inside stays.
    """
    left_out: list[int] = []
    nearest = np.min(np.linalg.norm(points_m[:, None] - points_m[keep][None], axis=-1), axis=1)
    nearest = nearest + 1e-6 * rng.random(len(points_m))
    border = np.any(np.abs(points_m) >= np.max(np.abs(points_m), axis=0) - 1e-9, axis=1)
    if surplus <= 0.5 * (np.sum(~border) - 1):
        nearest[border] = 0.0
    for _ in range(surplus):
        chosen = int(np.argmax(nearest))
        left_out.append(chosen)
        nearest = np.minimum(nearest, np.linalg.norm(points_m - points_m[chosen], axis=1))
    return np.setdiff1d(np.arange(len(points_m)), left_out)


def place_targets(config: Config, rng: np.random.Generator) -> tuple[Layout, tuple[Spot, ...]]:
    """Field at the lowest planned height and a place for every target: panels, then frustums, then boards.

    Raises
    ------
    ConfigError
        They do not fit at that height (the message names the height that would do), or the ground ends inside the field.
    """
    if config.targets.frustums.count and not config.targets.frustums.stand_heights_m:
        raise ConfigError(
            "no stand height is given",
            where="targets.frustums.stand_heights_m",
            got="an empty list",
            expected="one or more heights in metres",
        )
    layout = common_field(config, min(config.flight.heights_m))
    frustum_count, panel_count, board_count = _target_count(config)
    count = frustum_count + panel_count + board_count
    half = _node_half_m(config, layout)
    columns, rows, step = _best_grid(count, half)
    spare = step - minimum_spacing_m(config)
    if spare < 0.0:
        raise _refuse(config, step, layout)

    reach = max(layout.field_half_m) + BORDER_M
    if 0.5 * config.site.extent_m < reach:
        raise ConfigError(
            "the ground ends inside the field that targets cover",
            where="site.extent_m",
            got=f"{config.site.extent_m:g} m",
            expected=f"at least {2.0 * reach:.1f} m at a lowest height of {min(config.flight.heights_m):g} m",
        )

    xs = np.linspace(-half[0], half[0], columns) if columns > 1 else np.zeros(1)
    ys = np.linspace(-half[1], half[1], rows) if rows > 1 else np.zeros(1)
    grid = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    last = len(grid) - 1
    special = np.unique([last // 2, 0, columns - 1, last - columns + 1, last])
    special = special[np.argsort(np.linalg.norm(grid[special], axis=1), kind="stable")]  # the centre first
    stay = _drop_surplus(grid, special, len(grid) - count, rng)
    points = grid[stay]
    special = np.searchsorted(stay, special[np.isin(special, stay)])

    jitter = min(JITTER * step, 0.5 * spare) if np.isfinite(step) else 0.0
    moved = points + rng.uniform(-jitter, jitter, points.shape)
    moved[special] = points[special]  # the five that 6.2.3 a names stay exactly there
    points = np.clip(moved, [-half[0], -half[1]], [half[0], half[1]])

    kind = np.zeros(count, dtype=int)  # 1: frustum, 2: board
    fixed = np.zeros(count, dtype=bool)
    first = special[: frustum_count or board_count]
    kind[first], fixed[first] = 1 if frustum_count else 2, True
    others = np.flatnonzero(~fixed)
    frustums_left, boards_left = frustum_count - np.sum(kind == 1), board_count - np.sum(kind == 2)
    kind[others[:frustums_left]] = 1
    kind[others[frustums_left : frustums_left + boards_left]] = 2
    kind = spread_labels(points, kind, fixed, rng)

    is_panel, is_frustum, is_board = (np.flatnonzero(kind == k) for k in range(3))
    panels, frustums = config.targets.panels, config.targets.frustums
    level = np.repeat(np.arange(len(panels.nominal_reflectance_percent)), panels.count_of_each)
    level = spread_labels(points[is_panel], level, np.zeros(panel_count, dtype=bool), rng)
    stand = np.arange(frustum_count) % max(len(frustums.stand_heights_m), 1)
    stand = spread_labels(points[is_frustum], stand, np.zeros(frustum_count, dtype=bool), rng)
    spots = [
        Spot(
            kind="panel",
            x_m=float(points[i, 0]),
            y_m=float(points[i, 1]),
            azimuth_deg=float(rng.uniform(0.0, 90.0)),
            stand_height_m=panels.stand_height_m,
            level_percent=panels.nominal_reflectance_percent[k],
        )
        for i, k in zip(is_panel, level, strict=True)
    ]
    spots += [
        Spot(
            kind="frustum",
            x_m=float(points[i, 0]),
            y_m=float(points[i, 1]),
            azimuth_deg=float(rng.uniform(0.0, 360.0)),
            stand_height_m=frustums.stand_heights_m[k],
        )
        for i, k in zip(is_frustum, stand, strict=True)
    ]
    spots += [
        Spot(
            kind="board",
            x_m=float(points[i, 0]),
            y_m=float(points[i, 1]),
            azimuth_deg=float(rng.uniform(0.0, 360.0)),
            stand_height_m=config.targets.boards.stand_height_m,
        )
        for i in is_board
    ]
    return layout, tuple(spots)
