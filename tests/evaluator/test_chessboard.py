"""Chessboard corners from pixels, on boards drawn here from their own closed form (pattern, lens, blur, light, noise)."""

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from evaluator.model import EvaluationError
from evaluator.observe.chessboard import BoardCorners, find_corners, goes_on, oriented, turned
from evaluator.observe.saddle_fit import fit_saddles

COLUMNS, ROWS = 9, 6
SIZE = (560, 400)
FOCAL_PX = 600.0
CENTRE = np.array([280.7, 199.1])
FINE = 4  # samples a pixel and axis


@dataclass(frozen=True, kw_only=True)
class View:
    """A board before a camera of 600 px focal length. Lengths in squares."""

    rotation: np.ndarray
    translation: np.ndarray
    bend: float = 0.0  # ideal = observed radius * (1 + bend r^2), r in focal lengths
    blur_px: float = 1.0
    slope: float = 0.0  # light at the right edge over the left edge, minus one
    black: float = 3000.0
    white: float = 45000.0


def corners_true(view: View) -> np.ndarray:
    x, y = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
    p = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) @ view.rotation.T + view.translation
    ideal = p[:, :2] / p[:, 2:]
    goal = np.hypot(*ideal.T)
    r = goal.copy()
    for _ in range(50):
        r -= (r + view.bend * r**3 - goal) / (1.0 + 3.0 * view.bend * r**2)
    return np.asarray(ideal / (1.0 + view.bend * r**2)[:, None] * FOCAL_PX + CENTRE)


def draw(view: View) -> np.ndarray:
    """(rows, columns) expected DN: the pattern by signed distance to its edges, finely sampled; blur; the pixel's square."""
    fine = np.stack(
        np.meshgrid((np.arange(SIZE[0] * FINE) + 0.5) / FINE, (np.arange(SIZE[1] * FINE) + 0.5) / FINE), axis=-1
    )
    ray = (fine.reshape(-1, 2) - CENTRE) / FOCAL_PX
    ray = ray * (1.0 + view.bend * np.sum(ray**2, axis=1, keepdims=True))
    ray = np.concatenate([ray, np.ones((len(ray), 1))], axis=1)
    inverse = np.linalg.inv(np.column_stack([view.rotation[:, 0], view.rotation[:, 1], view.translation]))
    board = ray @ inverse.T
    place = (board[:, :2] / board[:, 2:]).reshape(*fine.shape)
    signs = []
    for axis in range(2):
        p = place[..., axis]
        step = np.hypot(np.gradient(p, axis=0), np.gradient(p, axis=1))
        to_edge = p - np.round(p)
        odd = np.where(np.round(p).astype(int) % 2 == 0, 1.0, -1.0)
        signs.append(odd * np.clip(2.0 * to_edge / step, -1.0, 1.0))
    light = 1.0 + view.slope * (fine[..., 0] / SIZE[0] - 0.5)
    pattern = view.black + (view.white - view.black) * 0.5 * (1.0 + signs[0] * signs[1])
    inside = (np.abs(place - np.array([COLUMNS - 1, ROWS - 1]) / 2.0) <= np.array([COLUMNS + 1, ROWS + 1]) / 2.0).all(
        -1
    )
    image = np.where(inside, pattern, view.white) * light
    sigma = view.blur_px * FINE
    if sigma > 0.0:
        image = cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return image.reshape(SIZE[1], FINE, SIZE[0], FINE).mean(axis=(1, 3))


def rotation(x_deg: float, y_deg: float, z_deg: float) -> np.ndarray:
    return cv2.Rodrigues(np.radians([x_deg, 0.0, 0.0]))[0] @ (
        cv2.Rodrigues(np.radians([0.0, y_deg, 0.0]))[0] @ cv2.Rodrigues(np.radians([0.0, 0.0, z_deg]))[0]
    )


def view(
    square_px: float = 48.0,
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0),
    at: tuple[float, float] = (0.0, 0.0),
    **more: float,
) -> View:
    r = rotation(*tilt)
    distance = FOCAL_PX / square_px
    centre = np.array([at[0] * distance, at[1] * distance, distance])
    shift = r @ np.array([(COLUMNS - 1) / 2.0, (ROWS - 1) / 2.0, 0.0])
    return View(rotation=r, translation=centre - shift, **more)


def noisy(image: np.ndarray, rng: np.random.Generator, std_dn: float = 150.0, bits: int = 16) -> np.ndarray:
    step = 2 ** (16 - bits)
    dn = np.clip(np.round((image + rng.normal(0.0, std_dn, image.shape)) / step), 0, 2**bits - 1)
    return dn.astype(np.uint16)[..., None]


def matched(found: BoardCorners, true: np.ndarray) -> tuple[BoardCorners, np.ndarray]:
    """The numbering that fits the truth, and the errors."""
    both = [(b, b.uv_px - true) for b in (found, turned(found))]
    return min(both, key=lambda pair: float(np.nanmax(np.abs(pair[1]))))


CASES = {
    "square on": view(),
    "perspective": view(44.0, (25.0, -30.0, 12.0)),
    "distortion": view(46.0, (5.0, 8.0, -3.0), bend=0.3),
    "slope of the light": view(46.0, (4.0, 6.0, 2.0), slope=0.8),
    "sharp": view(46.0, (3.0, -5.0, 7.0), blur_px=0.35),
    "blurred": view(46.0, (10.0, 12.0, 3.0), blur_px=4.0),
}


@pytest.mark.parametrize("case", CASES)
def test_corners_are_where_they_were_drawn(case: str) -> None:
    """Rationale: perspective, lens, light and blur must not move corners; a bias common to all would go straight into the lens.
    Expected: without noise every corner within a few thousandths of a pixel, no mean over the board. Tolerance: 0.003 px RMS an
    axis and 0.0005 px mean (the drawing itself samples edges in quarters of a pixel); the sharp edge is beyond what a
    Gaussian model of the pixel resolves, and stays within 0.003 px all the same."""
    v = CASES[case]
    picture = np.round(draw(v)).astype(np.uint16)[..., None]
    _, error = matched(find_corners(picture, COLUMNS, ROWS), corners_true(v))
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.003
    assert np.abs(error.mean(axis=0)).max() < 0.0005


def test_a_straight_edge_model_would_miss_bent_edges() -> None:
    """Rationale: the curvature that the second pass hands to the fit must be needed, or it is not tested. Expected: the same
    corners fitted with straight edges are off by some c w^2 / 6, ten times more than with the bend. Tolerance: a factor of 3."""
    v = view(46.0, (5.0, 8.0, -3.0), bend=0.3)
    picture = draw(v).astype(np.float32)
    true = corners_true(v)
    found, error = matched(find_corners(np.round(draw(v)).astype(np.uint16)[..., None], COLUMNS, ROWS), true)
    grid = true.reshape(ROWS, COLUMNS, 2)
    along, down = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
    angle1 = np.arctan2(-down[..., 0], down[..., 1])
    angle2 = np.arctan2(along[..., 0], -along[..., 1])
    start = np.stack(
        [true[:, 0], true[:, 1], angle1.ravel(), angle2.ravel(), np.ones(len(true)), np.ones(len(true))], 1
    )
    theta, _, _, done = fit_saddles(picture, start, np.zeros((len(true), 2)), np.full(len(true), 20.0))
    straight = theta[:, :2] - true
    assert done.all()
    assert np.sqrt(np.mean(straight**2)) > 3.0 * np.sqrt(np.mean(error**2))
    assert found.square_px == pytest.approx(46.0, rel=0.1)


@pytest.mark.parametrize("bits", [12, 16])
def test_spread_and_covariance(bits: int) -> None:
    """Rationale: the covariance weighs the calibration. Expected: errors over noise draws have the spread that the fit states
    (z near 1), no mean, and lie near the Cramer-Rao bound of an edge: along each of the 2w pixels of an edge the variance is
    noise^2 2 sqrt(pi) s / contrast^2. Tolerance: 15 % for the spread of 8 x 54 x 2 values plus the sandwich's own
    scatter; 25 % over the bound, because the corner's crossing tells nothing about either edge."""
    v = view(46.0, (6.0, 9.0, 4.0), bend=0.05)
    image, true = draw(v), corners_true(v)
    rng = np.random.default_rng(9)
    z, errors = [], []
    for _ in range(8):
        found, error = matched(find_corners(noisy(image, rng, 900.0, bits), COLUMNS, ROWS), true)
        z.append(error / np.sqrt(np.diagonal(found.covariance_px2, axis1=1, axis2=2)))
        errors.append(error)
    assert np.std(z) == pytest.approx(1.0, abs=0.15)
    assert abs(np.mean(z)) < 4.0 / np.sqrt(np.size(z))
    sigma = np.sqrt(1.0 + 1.0 / 12.0)
    bound = 900.0 * np.sqrt(2.0 * np.sqrt(np.pi) * sigma / 40.0) / 42000.0
    assert np.std(errors) < 1.25 * bound
    assert np.std(errors) > 0.9 * bound


def test_small_squares() -> None:
    """Rationale: a far board has squares of ten pixels. Expected: all corners, within a few hundredths. Tolerance: 0.02 px RMS
    at a noise of 1 % of full scale (the bound for windows of 6 px is 0.01 px)."""
    v = view(10.0, (5.0, 5.0, 3.0), blur_px=0.7)
    found, error = matched(
        find_corners(noisy(draw(v), np.random.default_rng(3), 600.0), COLUMNS, ROWS), corners_true(v)
    )
    assert np.isfinite(found.uv_px).all()
    assert np.sqrt(np.mean(error**2)) < 0.02


def test_eight_bit_and_bands_give_the_same_corners() -> None:
    """Rationale: PNG and JPEG come with 8 bits and three bands. Expected: the same corners as from 16 bits. Tolerance: 0.01 px, the
    rounding of 8 bits."""
    v = view(46.0, (6.0, 9.0, 4.0))
    image = draw(v)
    grey = find_corners(np.round(image).astype(np.uint16)[..., None], COLUMNS, ROWS)
    bands = np.stack([image * s for s in (1.0, 0.8, 0.6)], axis=-1)
    colour = find_corners(np.round(bands / 257.0).astype(np.uint8), COLUMNS, ROWS)
    assert np.abs(grey.uv_px - colour.uv_px).max() < 0.01


@pytest.mark.parametrize(
    ("columns", "rows", "more"), [(COLUMNS, ROWS, False), (ROWS, COLUMNS, False), (6, 4, True), (12, 9, False)]
)
def test_a_part_of_a_larger_board_is_noticed(columns: int, rows: int, more: bool) -> None:
    """Rationale: a board.json that states too small a board finds some part of it in every picture, another one each time.
    Expected: the drawn board of 9 x 6 corners goes on beyond 6 x 4, not beyond its own size, whichever side is named first."""
    assert goes_on(draw(view(46.0, (6.0, 9.0, 4.0))), columns, rows) == more


def test_the_colours_tell_the_end() -> None:
    """Rationale: turned by 180 degrees a board of 9 x 6 corners (10 x 7 squares) shows other colours, so corner (0, 0) is the
    same physical one in every image. Expected: in images turned by 0, 90, 180 and 270 degrees all boards get the truth's
    numbering, or all the opposite one. Tolerance: exact."""
    views = [view(42.0, (8.0, -6.0, turn)) for turn in (3.0, 93.0, 183.0, 273.0)]
    boards = oriented([find_corners(np.round(draw(v)).astype(np.uint16)[..., None], COLUMNS, ROWS) for v in views])
    ends = [np.abs(b.uv_px - corners_true(v)).max() < 0.1 for b, v in zip(boards, views, strict=True)]
    assert all(ends) or not any(ends)
    assert len({b.light_first_square for b in boards}) == 1
    again = oriented([turned(boards[0]), *boards[1:]])
    assert np.array_equal(again[0].uv_px, boards[0].uv_px)


def test_a_turned_board_keeps_its_colour_only_if_symmetric() -> None:
    """Rationale: with both numbers of squares even or both odd the pattern is its own image; numbering then follows the picture.
    Expected: `turned` keeps the colour flag, and `oriented` puts (0, 0) nearest the top left. Tolerance: exact."""
    x, y = np.meshgrid(np.arange(5.0), np.arange(3.0))
    uv = np.stack([x.ravel(), y.ravel()], axis=1) * 50.0 + 100.0
    board = BoardCorners(
        columns=5,
        rows=3,
        uv_px=uv[::-1].copy(),
        covariance_px2=np.tile(np.eye(2), (15, 1, 1)),
        light_first_square=True,
        square_px=50.0,
        blur_px=1.0,
        noise_dn=1.0,
        contrast_dn=100.0,
    )
    assert turned(board).light_first_square
    assert np.array_equal(oriented([board])[0].uv_px, uv)


def test_saturated_board_is_refused() -> None:
    """Rationale: clipped white moves nothing by symmetry but tells of a wrong exposure, and 6.3 wants a usable picture.
    Expected: a reason with the share. Tolerance: exact."""
    image = np.clip(draw(view(46.0)) * 2.0, 0.0, 65535.0)
    with pytest.raises(EvaluationError, match=r"saturated.*% of its pixels at full scale \(65535 DN\)"):
        find_corners(np.round(image).astype(np.uint16)[..., None], COLUMNS, ROWS)


@pytest.mark.parametrize("level", [0, 1000])
def test_no_board(level: int) -> None:
    """Rationale: an empty picture is a reason, never a traceback. Expected: EvaluationError. Tolerance: exact."""
    rng = np.random.default_rng(1)
    picture = (level + (rng.integers(0, 50, (120, 160, 1)) if level else 0 * np.ones((120, 160, 1)))).astype(np.uint16)
    with pytest.raises(EvaluationError, match=r"no chessboard found|one grey level"):
        find_corners(picture, COLUMNS, ROWS)
