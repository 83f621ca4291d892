"""Chessboard corners from the pixels of one picture (9.2.2 c): where the board is, each inner corner to sub-pixel, its covariance.

A board is found on a reduced picture (OpenCV); every corner is then fitted to the full-resolution pixels (`saddle_fit`), twice: the
first pass tells how the lens bends the board's lines and how much is blurred, the second fits with that. Calibration lives in
`camera_calibration`.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from evaluator.model import EvaluationError
from evaluator.observe.saddle_fit import fit_saddles

# Longer side of the reduced picture and OpenCV's flags, tried in this order. Equalising the histogram finds boards before a bright
# sky and loses boards in a dark room.
_ATTEMPTS = (
    (1000, 0),
    (1000, cv2.CALIB_CB_NORMALIZE_IMAGE),
    (1600, cv2.CALIB_CB_EXHAUSTIVE),
    (3200, cv2.CALIB_CB_EXHAUSTIVE),
)
_NEAR = ((-1, -1), (1, 1), (-1, 0), (0, -1), (1, 0), (0, 1), (-1, 1), (1, -1))
_QUICK = 2  # of them take a tenth of a second; the others seconds, where there is no board
_MOST_RADIUS_PX = 20.0  # of a corner's window: beyond it corners hardly gain
_LEAST_RADIUS_PX = 3.2
_SATURATED = 0.05  # share of the board's pixels at full scale
_FULL_SCALES = (255, 1023, 4095, 16383, 65535)


class NoBoard(EvaluationError):
    """A picture in which no board of the stated size was found."""


@dataclass(frozen=True, kw_only=True)
class BoardCorners:
    """One board as observed. Corner (column, row) stands at index row * columns + column."""

    columns: int
    rows: int
    uv_px: np.ndarray  # (rows * columns, 2) first pixel's centre (0.5, 0.5); NaN: not fitted
    covariance_px2: np.ndarray  # (rows * columns, 2, 2)
    light_first_square: bool  # of the square right and below of corner (0, 0), inside the board
    square_px: float  # median side of a square
    blur_px: float  # median standard deviation of an edge
    noise_dn: float  # median RMS of the fits' residuals
    contrast_dn: float  # median difference of white and black


def grey_picture(picture: np.ndarray, black_level: float = 0.0) -> np.ndarray:
    """(rows, columns, bands) DN -> (rows, columns) float32, bands averaged, black level off. [DN]"""
    if picture.ndim == 2 or picture.shape[2] == 1:
        grey = picture.reshape(picture.shape[:2]).astype(np.float32)
    else:
        grey = np.zeros(picture.shape[:2], np.float32)
        for band in range(picture.shape[2]):
            grey += picture[..., band]
        grey /= np.float32(picture.shape[2])
    grey -= np.float32(black_level)
    return grey


def _eight_bit(grey: np.ndarray) -> np.ndarray:
    """Spread between the 1st and 99th percentile, for finding only."""
    low, high = np.percentile(grey[::4, ::4], (1.0, 99.0))
    if not high > low:
        raise EvaluationError("the picture holds one grey level", got=f"{low:g} DN")
    return np.asarray(np.clip((grey - low) * (255.0 / (high - low)), 0.0, 255.0)).astype(np.uint8)


def _reduced(grey: np.ndarray, side: int) -> np.ndarray:
    scale = side / max(grey.shape)
    if scale >= 1.0:
        return grey
    size = (max(round(grey.shape[1] * scale), 1), max(round(grey.shape[0] * scale), 1))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA))


def _find(grey: np.ndarray, columns: int, rows: int, thorough: bool) -> tuple[np.ndarray, float] | None:
    """(rows, columns, 2) corners to about a pixel of the reduced picture, image axes at full resolution, and that pixel's size."""
    tried: set[tuple[int, int]] = set()
    for side, flags in _ATTEMPTS if thorough else _ATTEMPTS[:_QUICK]:
        attempt = (min(side, max(grey.shape)), flags)
        if attempt in tried:
            continue
        tried.add(attempt)
        small = _reduced(grey, side)
        found, corners = cv2.findChessboardCornersSB(_eight_bit(small), (columns, rows), flags=flags)
        if found:
            step = np.array([grey.shape[1] / small.shape[1], grey.shape[0] / small.shape[0]])
            # OpenCV's first pixel has its centre at (0, 0)
            uv = (np.asarray(corners, dtype=np.float64).reshape(rows, columns, 2) + 0.5) * step
            return uv, float(step.max())
    return None


def seen_size(grey: np.ndarray, columns: int, rows: int) -> tuple[int, int] | None:
    """Inner corners (columns, rows) of the board that a picture seems to hold, when the stated one is not found: to tell the user.

    One row or column more or fewer is tried first (squares counted in the place of corners), then whatever board OpenCV can grow
    from half the size; only a size that is then found exactly is told.
    """
    small = _eight_bit(_reduced(grey, _ATTEMPTS[0][0]))
    near = [(columns + i, rows + j) for i, j in _NEAR if columns + i >= 3 and rows + j >= 3]
    for flags in (0, cv2.CALIB_CB_NORMALIZE_IMAGE):
        least = (max(columns // 2, 3), max(rows // 2, 3))
        found, _, meta = cv2.findChessboardCornersSBWithMeta(small, least, flags | cv2.CALIB_CB_LARGER)
        grown = [(int(meta.shape[1]), int(meta.shape[0]))] if found and np.ndim(meta) == 2 else []
        for size in [*near, *grown]:
            if min(size) >= 3 and size != (columns, rows) and cv2.findChessboardCornersSB(small, size, flags=flags)[0]:
                return size
    return None


def goes_on(grey: np.ndarray, columns: int, rows: int) -> bool:
    """Whether a picture's board has more inner corners than stated, on its longer or its shorter side."""
    small = _eight_bit(_reduced(grey, _ATTEMPTS[0][0]))
    found, _, meta = cv2.findChessboardCornersSBWithMeta(small, (4, 3), cv2.CALIB_CB_LARGER)
    if not found or np.ndim(meta) != 2:
        return False
    return any(grown > stated for grown, stated in zip(sorted(meta.shape), sorted((columns, rows)), strict=True))


def _neighbour_steps(uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps to the next corner along the columns' and the rows' index, (rows, columns, 2) each."""
    return np.gradient(uv, axis=1), np.gradient(uv, axis=0)


def _half_widths(along: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Distance from each corner to the next parallel edges, the smaller one. [px]"""
    area = np.abs(along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0])
    return np.asarray(area / np.maximum(np.linalg.norm(along, axis=-1), np.linalg.norm(down, axis=-1)))


def _terms(x: np.ndarray, y: np.ndarray, degree: int) -> np.ndarray:
    return np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)


def _smooth_map(uv: np.ndarray, good: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the whole board says about each corner: place (rows, columns, 2), steps along and down, and both lines' curvatures.

    A homography and a polynomial for what the lens adds, by least squares. Board coordinates are in squares.

    Returns
    -------
    place : (rows, columns, 2) np.ndarray
        [px]
    steps : (2, rows, columns, 2) np.ndarray
        Change of place by one square along a row, along a column. [px]
    bend : (rows, columns, 2) np.ndarray
        Curvature of the line between columns (its normal points along the row), and of the line between rows. [1/px]
    """
    rows, columns = good.shape
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(np.float64)
    centre = np.array([columns - 1, rows - 1]) / 2.0
    half = max(columns, rows) / 2.0
    board = (grid - centre) / half
    h, _ = cv2.findHomography(board[good], uv[good], 0)
    count = int(good.sum())
    degree = next((d for d in (5, 4, 3) if 5 * (d + 1) * (d + 2) <= 4 * count), 2)  # 2.5 corners a coefficient

    def homography(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        p = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.asarray(h).T
        return np.asarray(p[..., :2] / p[..., 2:])

    x, y = board[..., 0], board[..., 1]
    rest = uv - homography(x, y)
    use = good.copy()
    for _ in range(3):
        coefficients = np.linalg.lstsq(_terms(x[use], y[use], degree), rest[use], rcond=None)[0]
        off = np.linalg.norm(rest - _terms(x, y, degree) @ coefficients, axis=-1)
        use = good & (off <= max(6.0 * float(np.median(off[good])), 0.02))

    def place(dx: float, dy: float) -> np.ndarray:
        a, b = x + dx / half, y + dy / half
        return homography(a, b) + _terms(a, b, degree) @ coefficients

    middle, step = place(0.0, 0.0), 0.25
    steps, bends = [], []
    for dx, dy in ((step, 0.0), (0.0, step)):
        ahead, behind = place(dx, dy), place(-dx, -dy)
        steps.append((ahead - behind) / (2.0 * step))
        bends.append((ahead + behind - 2.0 * middle) / step**2)
    along, down = steps
    bend = np.stack([_across(along, down, bends[1]), _across(down, along, bends[0])], axis=-1)
    return middle, np.stack(steps), bend


def _across(towards: np.ndarray, tangent: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Curvature of a line with that tangent and second derivative, counted along its normal on the side of `towards`."""
    normal = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
    normal *= np.sign(np.sum(normal * towards, axis=-1, keepdims=True))
    normal /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    return np.asarray(np.sum(second * normal, axis=-1) / np.sum(tangent**2, axis=-1))


def _normal_angles(along: np.ndarray, down: np.ndarray) -> np.ndarray:
    """(..., 2) angles of the normals of the line between columns (towards +column) and between rows (towards +row)."""
    angles = []
    for towards, tangent in ((along, down), (down, along)):
        normal = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
        normal = normal * np.sign(np.sum(normal * towards, axis=-1, keepdims=True))
        angles.append(np.arctan2(normal[..., 1], normal[..., 0]))
    return np.stack(angles, axis=-1)


def _check_saturation(picture: np.ndarray, uv: np.ndarray, full_scale: int | None) -> None:
    hull = np.round(uv[[0, 0, -1, -1], [0, -1, -1, 0]]).astype(int)
    low = np.maximum(hull.min(axis=0), 0)
    high = np.minimum(hull.max(axis=0) + 1, picture.shape[1::-1])
    part = picture[low[1] : high[1], low[0] : high[0]]
    inside = np.zeros(part.shape[:2], np.uint8)
    cv2.fillConvexPoly(inside, (hull - low).astype(np.int32), 1)
    bands = part.reshape(*part.shape[:2], -1)
    brightest = bands[..., 0]
    for band in range(1, bands.shape[2]):
        brightest = np.maximum(brightest, bands[..., band])
    pixels = brightest[inside.astype(bool)]
    if not pixels.size:
        return
    top = int(pixels.max())
    if top < full_scale if full_scale else top not in _FULL_SCALES:
        return
    share = float(np.mean(pixels >= top))
    if share > _SATURATED:
        raise EvaluationError(
            "the board is saturated",
            got=f"{100.0 * share:.0f} % of its pixels at full scale ({top} DN)",
            expected=f"at most {100.0 * _SATURATED:g} %",
            remedy="expose less",
        )


def find_corners(
    picture: np.ndarray,
    columns: int,
    rows: int,
    *,
    black_level: float = 0.0,
    full_scale: int | None = None,
    thorough: bool = True,
) -> BoardCorners:
    """The inner corners of one board.

    Parameters
    ----------
    picture : (height, width, bands) uint8 or uint16 np.ndarray
        As `campaign.benches.pictures.read_picture` gives it. [DN]
    columns, rows : int
        Inner corners.
    black_level : float
        [DN]
    full_scale : int, optional
        Greatest DN of the sensor; without it 255, 1023, 4095, 16383 and 65535 are taken for one where they are the picture's
        greatest.
    thorough : bool
        Search also in larger pictures, which takes seconds where there is no board.

    Returns
    -------
    BoardCorners
        Right-handed (x along a row, y down, z away from the camera). Which of the two ends is corner (0, 0) is OpenCV's choice:
        `oriented` settles it.

    Raises
    ------
    NoBoard
        No board of this size.
    EvaluationError
        Saturated, or more than one corner in fifty cannot be fitted.
    """
    grey = grey_picture(picture, black_level)
    found = _find(grey, columns, rows, thorough)
    if found is None:
        raise NoBoard("no chessboard found", expected=f"{columns} x {rows} inner corners, all of them visible")
    uv, coarse = found
    _check_saturation(picture, uv, full_scale)
    along, down = _neighbour_steps(uv)
    if np.median(along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0]) < 0.0:
        uv = uv[:, ::-1]
        along, down = _neighbour_steps(uv)
    # first pass: straight edges, a window well inside the squares
    reach = _half_widths(along, down)
    theta, _, good = _fit(
        grey,
        uv,
        along,
        down,
        np.zeros((rows, columns, 2)),
        np.minimum(0.45 * reach, 10.0),
        max(1.0, 0.5 * coarse),
        reach,
    )
    if good.mean() < 0.8:
        raise EvaluationError(
            "corners cannot be fitted", got=f"{int((~good).sum())} of {good.size}", remedy="blurred or hidden squares"
        )
    place, (along, down), bend = _smooth_map(theta[..., :2], good)
    off = np.linalg.norm(theta[..., :2] - place, axis=-1)
    limit = max(8.0 * float(np.median(off[good])), 0.5)
    start = np.where((good & (off < limit))[..., None], theta[..., :2], place)
    # second pass: edges as bent as the lens bends them, the window as wide as the neighbours and the blur let it be
    blur = float(np.median(theta[good][:, 4:6]))
    reach = _half_widths(along, down)
    theta, covariance, good = _fit(grey, start, along, down, bend, reach - 3.0 * blur - 0.7, blur, reach)
    if good.mean() < 0.98:
        raise EvaluationError(
            "corners cannot be fitted", got=f"{int((~good).sum())} of {good.size}", remedy="blurred or hidden squares"
        )
    # Light that falls off across the board is blurred with the pattern, which moves every edge by s^2 d(ln contrast)/dx.
    uv = theta[..., :2] + np.mean(theta[..., 4:6] ** 2, axis=-1, keepdims=True) * theta[..., 10:12] / theta[..., 9:10]
    parity = 1 - 2 * (np.add.outer(np.arange(rows), np.arange(columns)) % 2)
    level = np.median((theta[..., 9] * parity)[good])
    residual = theta[..., 12][good]
    return BoardCorners(
        columns=columns,
        rows=rows,
        uv_px=np.where(good[..., None], uv, np.nan).reshape(-1, 2),
        covariance_px2=covariance.reshape(-1, 2, 2),
        light_first_square=bool(level > 0.0),
        square_px=float(np.median(np.concatenate([np.linalg.norm(along, axis=-1), np.linalg.norm(down, axis=-1)]))),
        blur_px=float(np.median(theta[good][:, 4:6])),
        noise_dn=float(np.median(residual)),
        contrast_dn=float(2.0 * abs(level)),
    )


def _fit(
    grey: np.ndarray,
    uv: np.ndarray,
    along: np.ndarray,
    down: np.ndarray,
    bend: np.ndarray,
    radius: np.ndarray,
    blur: float,
    reach: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """theta (rows, columns, 13: `fit_saddles`' and the residuals' RMS), covariance (rows, columns, 2, 2), good (rows, columns)."""
    rows, columns = uv.shape[:2]
    start = np.concatenate([uv, _normal_angles(along, down), np.full((rows, columns, 2), blur)], axis=-1)
    border = np.minimum(uv, np.array(grey.shape[::-1]) - uv).min(axis=-1) - 1.0  # the window stays inside the picture
    radius = np.minimum(np.clip(radius, _LEAST_RADIUS_PX, _MOST_RADIUS_PX), border)
    theta, covariance, noise, converged = fit_saddles(
        grey,
        np.ascontiguousarray(start.reshape(-1, 6)),
        np.ascontiguousarray(bend.reshape(-1, 2)),
        np.where(radius >= _LEAST_RADIUS_PX, radius, 0.0).ravel(),
    )
    moved = np.linalg.norm(theta[:, :2] - start.reshape(-1, 6)[:, :2], axis=1)
    parity = (1 - 2 * (np.add.outer(np.arange(rows), np.arange(columns)) % 2)).ravel()
    with np.errstate(invalid="ignore"):
        contrast = theta[:, 9] * parity
        contrast = contrast * np.sign(np.nanmedian(contrast))
        good = converged & (moved < 0.4 * reach.ravel()) & (contrast > 0.2 * np.nanmedian(contrast))
        good &= np.sqrt(np.trace(covariance, axis1=1, axis2=2)) < 1.0
    return (
        np.concatenate([theta, noise[:, None]], axis=1).reshape(rows, columns, -1),
        covariance.reshape(rows, columns, 2, 2),
        good.reshape(rows, columns),
    )


def turned(board: BoardCorners) -> BoardCorners:
    """The same observation numbered from the opposite corner (180 degrees)."""
    colour = board.light_first_square == ((board.columns + board.rows) % 2 == 0)
    return replace(board, uv_px=board.uv_px[::-1], covariance_px2=board.covariance_px2[::-1], light_first_square=colour)


def is_symmetric(columns: int, rows: int) -> bool:
    """Whether the pattern looks the same turned by 180 degrees: both numbers of squares even, or both odd."""
    return (columns + rows) % 2 == 0


def oriented(boards: Iterable[BoardCorners]) -> list[BoardCorners]:
    """All boards numbered from the same physical corner, where the colours tell which it is.

    One even and one odd number of squares: the square at corner (0, 0) has the colour that most boards gave it as found (white on a
    draw). Otherwise the pattern is symmetric and (0, 0) is the end that lies nearer the image's top left corner (smaller u + v).
    """
    boards = list(boards)
    if not boards:
        return []
    if not is_symmetric(boards[0].columns, boards[0].rows):
        light = 2 * sum(b.light_first_square for b in boards) >= len(boards)
        return [b if b.light_first_square == light else turned(b) for b in boards]
    return [b if _near_top_left(b) else turned(b) for b in boards]


def _near_top_left(board: BoardCorners) -> bool:
    half = board.uv_px.shape[0] // 2
    return bool(np.nanmean(board.uv_px[:half].sum(axis=1)) <= np.nanmean(board.uv_px[-half:].sum(axis=1)))
