"""Where the chessboard stands in each picture: the lens at the bench's focus, and a plan that covers the field (9.2.2 d).

At every distance the board walks over a grid of places until its inner corners have been in every cell of the field, tilted
about its axes in turn; tilted and turned views near the middle follow. No picture is made here.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from campaign.config import Config, Lens
from campaign.errors import ConfigError
from scenes.chessboard import Board, board_of
from simulator.camera.view import distort, pixel_from_distorted
from simulator.randomness import Stream, generator, scene_seed

CELLS = (8, 6)  # of the field, across and down: each holds a corner at every distance
CLEAR_PX = 3.0  # a corner nearer to a cell's border may be found on its other side
BORDER = 0.01  # of the field, kept free of the board
MIN_IMAGES = 20  # 9.2.2
TURNED_IMAGES = 6  # beside the walk over the field
MIN_SQUARE_PX = 12.0
TILT_STEPS = (1.0, 0.75, 0.5, 0.25, 0.0)
WALK_TILTS = (1.0, 0.85, 0.7, 0.5)  # of the greatest tilt; less would show little of the perspective
JITTER_SHIFT = 0.01  # of the free travel
JITTER_ROLL_DEG = 1.5
_PLAN = 0  # key of the stream


@dataclass(frozen=True, kw_only=True)
class Placement:
    """One picture: camera_from_board, and the distance that the plan asked for."""

    distance_m: float  # along the optical axis to the board's centre
    rotation: np.ndarray  # (3, 3)
    translation_m: np.ndarray  # (3,) of inner corner (0, 0)


# ------------------------------------------------------------------------------------------------------------------ lens


def breathing(focal_length_m: float, focus_distance_m: float, reference_m: float) -> float:
    r"""Principal distance at one focus setting over that at another, thin lens.

    .. math:: \frac{c(s)}{c(s_0)} = \frac{1 + f/(s - f)}{1 + f/(s_0 - f)}

    Parameters
    ----------
    focus_distance_m, reference_m : float
        From the entrance pupil to the plane of focus, s and s_0. [m]
    """

    def image_distance(s: float) -> float:
        return 1 + focal_length_m / (s - focal_length_m)

    return image_distance(focus_distance_m) / image_distance(reference_m)


def bench_focus_m(config: Config) -> float:
    """Focus setting of the lens at the chessboard; as in flight where none is given. [m]"""
    own = config.bench.chessboard.focus_distance_m
    focus = config.camera.focus_distance_m if own is None else own
    nearest = 2 * config.camera.nominal_focal_length_mm / 1000
    if min(focus, config.camera.focus_distance_m) <= nearest:
        where = "camera.focus_distance_m" if own is None or own > nearest else "bench.chessboard.focus_distance_m"
        raise ConfigError(
            "the lens cannot be focused so near",
            where=where,
            got=f"{min(focus, config.camera.focus_distance_m)} m",
            expected=f"more than {nearest:g} m, twice the focal length",
        )
    return focus


def bench_f_number(config: Config) -> float:
    own = config.bench.chessboard.f_number
    return config.camera.f_number if own is None else own


def bench_lens(config: Config) -> Lens:
    """Interior orientation at the bench's focus: fx and fy breathe, principal point and (normalised) distortion stay."""
    camera = config.camera
    factor = breathing(camera.nominal_focal_length_mm / 1000, bench_focus_m(config), camera.focus_distance_m)
    return camera.lens.model_copy(update={"fx_px": camera.lens.fx_px * factor, "fy_px": camera.lens.fy_px * factor})


def project_board(lens: Lens, placement: Placement, point_m: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) of points (n, 2) of the board's plane, board frame; the image's top left corner is (0, 0). [px]"""
    in_camera = point_m @ placement.rotation[:, :2].T + placement.translation_m
    return pixel_from_distorted(lens, distort(lens, in_camera[:, :2] / in_camera[:, 2:]))


# ------------------------------------------------------------------------------------------------------------------ plan


def plan_placements(config: Config) -> tuple[Placement, ...]:
    """Every picture of the bench, distance by distance, then the turned ones.

    Raises
    ------
    ConfigError
        The board is too large for the field at a distance, or its squares are too small in the picture.
    """
    board, lens = board_of(config.bench.chessboard), bench_lens(config)
    size, seed = np.array([config.camera.width_px, config.camera.height_px], float), scene_seed(config)
    tilt = config.bench.chessboard.tilt_deg
    distances = sorted(set(config.bench.chessboard.distances_m))
    plan: list[Placement] = []
    for index, distance in enumerate(distances):
        pixels = board.square_m * lens.fx_px / distance
        if pixels < MIN_SQUARE_PX:
            raise ConfigError(
                "the chessboard's squares are too small in the picture",
                where="bench.chessboard.square_m",
                got=f"{pixels:.1f} px at {distance} m",
                expected=f"at least {MIN_SQUARE_PX:g} px",
                remedy="use larger squares or a shorter distance in distances_m",
            )
        plan += _walk(board, lens, size, distance, tilt, index, seed)
    turned = max(TURNED_IMAGES, MIN_IMAGES - len(plan))
    rng = generator(seed, Stream.CHESSBOARD, _PLAN, len(distances))
    for k in range(turned):
        roll = (90.0, -90.0, 90.0, 180.0)[k % 4] + rng.uniform(-10, 10)
        share = 0.5 + 0.25 * rng.uniform(-1, 1, 2)
        tilts = tilt * np.array([(0.75, 0.65), (-0.75, 0.65), (-0.7, -0.7), (0.7, -0.7)])[k % 4] * rng.uniform(0.9, 1)
        distance = distances[-1 - k % len(distances)]
        placement = _fitting(board, lens, size, distance, tilts, (roll, roll - 90.0, 0.0), share)
        if placement is None:
            raise _too_large(board, distance)
        plan.append(placement)
    return tuple(plan)


def coverage(lens: Lens, size_px: np.ndarray, board: Board, placements: list[Placement]) -> np.ndarray:
    """Inner corners clear of the borders of each cell of the field, (rows, columns), over all placements."""
    pixel = np.concatenate([project_board(lens, p, board.corners_m()) for p in placements])
    place = pixel / size_px * CELLS
    cell = np.floor(place).astype(int)
    clear = np.abs(place - np.round(place)) * size_px / CELLS > CLEAR_PX
    inside = ((cell >= 0) & (cell < CELLS) & clear).all(axis=1)
    count = np.zeros(CELLS[::-1], int)
    np.add.at(count, (cell[inside, 1], cell[inside, 0]), 1)
    return count


def _walk(
    board: Board, lens: Lens, size: np.ndarray, distance: float, tilt: float, index: int, seed: int
) -> list[Placement]:
    """The smallest grid of places whose corners cover the field at one distance, with as much tilt as covers it."""
    fallback: list[Placement] | None = None
    for across, down in sorted(product(range(1, CELLS[0] + 1), range(1, CELLS[1] + 1)), key=lambda n: n[0] * n[1]):
        flat = _grid(board, lens, size, distance, 0.0, (across, down), 0, seed)
        if not coverage(lens, size, board, flat).all():
            continue
        fallback = fallback or flat
        for part, phase in product(WALK_TILTS, range(4)):
            walk = _grid(board, lens, size, distance, part * tilt, (across, down), index + phase, seed)
            if coverage(lens, size, board, walk).all():
                return walk
    if fallback is not None:
        return fallback
    raise ConfigError(
        "the chessboard's corners cannot reach every part of the field",
        where=f"bench.chessboard.distances_m {distance}",
        got=f"squares of {board.square_m} m and a margin of {board.margin_m} m",
        expected=f"an inner corner in each of {CELLS[0]} x {CELLS[1]} cells of the field",
        remedy="lower bench.chessboard.margin_m and square_m, or raise that distance",
    )


def _grid(
    board: Board,
    lens: Lens,
    size: np.ndarray,
    distance: float,
    tilt: float,
    grid: tuple[int, int],
    phase: int,
    seed: int,
) -> list[Placement]:
    """Places from border to border, the board turned about x, y, and the other way, in turn."""
    rng = generator(seed, Stream.CHESSBOARD, _PLAN, phase, *grid)
    last = np.array(grid) - 1
    placements = []
    for k, (row, column) in enumerate(product(range(grid[1]), range(grid[0]))):
        middle = np.where(last > 0, [column, row] / np.maximum(last, 1), 0.5)
        share = np.clip(middle + JITTER_SHIFT * rng.uniform(-1, 1, 2), 0, 1)
        turn = np.pi / 2 * (k + phase)
        tilts = tilt * rng.uniform(0.9, 1) * np.round([np.cos(turn), np.sin(turn)])
        placement = _fitting(board, lens, size, distance, tilts, (JITTER_ROLL_DEG * rng.uniform(-1, 1), 0.0), share)
        if placement is None:
            raise _too_large(board, distance)
        placements.append(placement)
    return placements


def _too_large(board: Board, distance: float) -> ConfigError:
    return ConfigError(
        "the chessboard with its margin does not fit into the field",
        where=f"bench.chessboard.distances_m {distance}",
        got=f"{board.width_m:.2f} x {board.height_m:.2f} m",
        expected="a board smaller than the field at every distance",
        remedy="lower bench.chessboard.square_m or squares, or raise that distance",
    )


def _fitting(
    board: Board,
    lens: Lens,
    size: np.ndarray,
    distance: float,
    tilts_deg: np.ndarray,
    rolls_deg: tuple[float, ...],
    share: np.ndarray,
) -> Placement | None:
    """The placement with as much of the tilt, and the first of the rolls, that leaves the whole board inside the picture."""
    for roll, part in product(rolls_deg, TILT_STEPS):
        rotation = Rotation.from_euler("ZXY", [roll, *(part * tilts_deg)], degrees=True).as_matrix()
        placement = _settled(board, lens, size, distance, rotation, share)
        if placement is not None:
            return placement
    return None


def _settled(
    board: Board, lens: Lens, size: np.ndarray, distance: float, rotation: np.ndarray, share: np.ndarray
) -> Placement | None:
    """Shift the board until the box round its picture stands at `share` (0 .. 1) of its free travel; None: no travel."""
    free_low, free_high = BORDER * size, (1 - BORDER) * size
    centre = np.array([0.0, 0.0, distance])
    outline = board.outline_m()
    for _ in range(25):
        translation = centre - rotation[:, :2] @ board.centre_m
        placement = Placement(distance_m=distance, rotation=rotation, translation_m=translation)
        pixel = project_board(lens, placement, outline)
        low, high = pixel.min(axis=0), pixel.max(axis=0)
        travel = free_high - free_low - (high - low)
        if (travel < 0).any():
            return None
        move = free_low + share * travel - low
        if np.abs(move).max() < 0.01:
            return placement
        centre[:2] += move * distance / [lens.fx_px, lens.fy_px]
    return None
