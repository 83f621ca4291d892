"""The centre of a 2x2 board in an image, to hundredths of a pixel, with the patent's half-window count beside it.

The fit knows the whole board: two blurred edges that cross in the centre, its outline, the ground on each of its four sides.
The count itself is `half_window`'s. Which board is where, and why one is left out, is `board_observations`'s subject.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy.special

from evaluator.observe.half_window import half_window_centre, otsu_threshold

_LEAST_EDGE_PX = 8.0  # of the board's narrower side
_MOST_EDGE_PX = 160.0  # wider boards are looked at through larger pixels
_LEAST_CORRELATION = 0.6
_LEAST_CONTRAST = 0.35  # of white to black over white
_WORST_FIT = 0.06  # residuals over contrast
_LARGEST_STD_PX = 0.15
_FLOOR_PX = 0.0005  # standard deviation below which no centre is stated
_CORRELATED = 1.3  # factor on the deviation: neighbouring residuals have causes in common
_START_BLUR_PX, _BLUR_PX = 0.6, (0.25, 2.0)  # standard deviation with the pixel's own square in it; what is believed
_START = np.array([0.0] * 6 + [_START_BLUR_PX])  # of `_shares`: as predicted
_SHAPE_STD = np.array([0.02, 0.035, 0.035, 0.02])  # of the predicted shape: 1 degree of mounting at 40 degrees of slant
_MOST_OUTSIDE = 0.2  # share of a pixel outside the board; beyond, it says nothing about the centre
_MOST_WHITE = 3.5  # times saturation, by the edges alone: beyond, centres went wrong by a pixel with 0.0005 px stated
_SATURATED_SHARE = 0.3  # of a search window in which no board was found: more is the reason
_UNEVEN_SIGMAS, _UNEVEN_PULL = 4.0, 1.5  # beyond chance; centre's pull in blurs, for light that is uneven by its whole
_SHADOW_SHARE = 0.6  # white in a shadow has less than this of the light of white in the sun


@dataclass(frozen=True, kw_only=True)
class BoardView:
    """One board as one image should show it."""

    predicted_px: np.ndarray  # (2,) of its centre
    offset_from_board: np.ndarray  # (3, 3) homography: board x, y [m] -> pixel minus `predicted_px`
    size_m: float


@dataclass(frozen=True, kw_only=True)
class BoardFit:
    """Centre of one board, twice."""

    uv_px: np.ndarray  # (2,) by the fit
    covariance_px2: np.ndarray  # (2, 2)
    count_px: np.ndarray | None  # (2,) integers: by the half-window count; None: no window qualifies
    threshold: float  # of the count
    edge_px: float  # mean edge of the board in the image
    blur_px: float
    white: float  # level of the white squares
    contrast: float  # white minus black over white
    rms: float  # residuals over white minus black
    correlation: float  # of the search
    pixels: int


def _shares(view: BoardView, uv: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Shares of white, black and the four sides' ground in pixels.

    Parameters
    ----------
    view : BoardView
    uv : (n, 2) np.ndarray
        Pixels minus the predicted centre. [px]
    p : (7,) np.ndarray
        Centre's offset from the predicted one [px], corrections of the shape xx xy yx yy, blur [px].

    Returns
    -------
    (6, n) np.ndarray
        White, black, beyond +x, -x, +y, -y. A blurred edge is the normal distribution of the distance to it.
    """
    g = np.linalg.inv(view.offset_from_board)
    d = uv - p[:2]
    w = d @ g[2, :2] + g[2, 2]
    q = (d @ g[:2, :2].T + g[:2, 2]) / w[:, None]
    shape = np.array([[1.0 + p[2], p[3]], [p[4], 1.0 + p[5]]])
    slope = (g[None, :2, :2] - q[:, :, None] * g[2, :2]) / w[:, None, None]  # dq/du
    slope = shape @ slope
    q = q @ shape.T
    per_m = 1.0 / np.linalg.norm(slope, axis=2)  # pixels from edge to edge, a metre
    half = 0.5 * view.size_m
    blur = p[6]
    middle, high, low = (scipy.special.ndtr((q + at) * per_m / blur) for at in (0.0, -half, half))
    positive, negative = middle - high, low - middle  # (n, 2) share with 0 < q < half, -half < q < 0
    white = positive[:, 0] * positive[:, 1] + negative[:, 0] * negative[:, 1]
    black = positive[:, 0] * negative[:, 1] + negative[:, 0] * positive[:, 1]
    return np.stack([white, black, high[:, 0], 1.0 - low[:, 0], high[:, 1], 1.0 - low[:, 1]])


def _outline_px(view: BoardView) -> np.ndarray:
    """(4, 2) corners of the board minus its predicted centre. [px]"""
    half = 0.5 * view.size_m
    corner = np.array([[half, half, 1.0], [half, -half, 1.0], [-half, -half, 1.0], [-half, half, 1.0]])
    mapped = corner @ view.offset_from_board.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def sides_px(view: BoardView) -> tuple[float, float]:
    """Narrower width of the board between opposite edges, and mean edge. [px]"""
    c = _outline_px(view)
    edge = np.roll(c, -1, axis=0) - c
    length = np.linalg.norm(edge, axis=1)
    area = 0.5 * abs(float(np.sum(c[:, 0] * np.roll(c[:, 1], -1) - c[:, 1] * np.roll(c[:, 0], -1))))
    return area / float(length.max()), float(np.sqrt(area))


def _search(window: np.ndarray, view: BoardView) -> list[tuple[np.ndarray, float]]:
    """Best places of the predicted pattern in a window: (column, row) of the centre, correlation; best first."""
    reach = np.ceil(np.abs(_outline_px(view)).max(axis=0)).astype(int)
    columns, rows = 2 * reach + 1
    if window.shape[0] < rows or window.shape[1] < columns:
        return []
    u, v = np.meshgrid(np.arange(columns) - reach[0], np.arange(rows) - reach[1])
    at = _shares(view, np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64), _START)
    mask = (at[0] + at[1] > 0.8).reshape(rows, columns).astype(np.float32)
    template = (at[0] - at[1]).reshape(rows, columns).astype(np.float32)
    level = (window - window.mean()) / max(float(window.std()), 1e-9)
    score = cv2.matchTemplate(level.astype(np.float32), template, cv2.TM_CCOEFF_NORMED, mask=mask)
    score = np.where(np.isfinite(score) & (np.abs(score) < 1.001), score, 0.0)
    found: list[tuple[np.ndarray, float]] = []
    row_at, column_at = np.ogrid[: score.shape[0], : score.shape[1]]
    for _ in range(3):
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        best = float(score[row, column])
        if best < max(_LEAST_CORRELATION, 0.85 * found[0][1] if found else 0.0):
            break
        found.append((np.array([column + reach[0] + 0.5, row + reach[1] + 0.5]), best))
        score = np.where(np.hypot(row_at - row, column_at - column) > reach.min(), score, 0.0)
    return found


@dataclass(frozen=True, kw_only=True)
class _State:
    p: np.ndarray  # (7,)
    covariance: np.ndarray  # (2, 2)
    levels: np.ndarray  # white, black, four sides
    rms: float
    pixels: int
    converged: bool


_STEPS = np.array([1e-3, 1e-3, 1e-5, 1e-5, 1e-5, 1e-5, 1e-3])


def _refine(view: BoardView, uv: np.ndarray, value: np.ndarray, start: np.ndarray) -> _State | None:
    """Gauss-Newton on centre, shape and blur; levels and a slope of the light across the board are linear.

    The covariance is that of an M-estimate whose residuals differ in size (Huber's sandwich): pixels on edges, which alone say
    where the centre is, are less certain than those inside the squares, and the mean residual would state half of it.

    References
    ----------
    P. J. Huber, Robust Statistics, 1981, section 7.6.
    """
    p = start.copy()
    _, edge = sides_px(view)
    state: _State | None = None
    use = np.zeros(len(value), dtype=bool)
    weight = np.ones(0)
    scale = 1.0
    for iteration in range(15):
        if iteration < 3:  # afterwards the same pixels, so that the minimum stands still
            shares = _shares(view, uv, p)
            use = shares[0] + shares[1] > 1.0 - _MOST_OUTSIDE
            if use.sum() < 30:
                return None
        at, y = uv[use], value[use]
        base = _shares(view, at, p)
        if iteration < 3 or state is None:
            weight = np.ones(len(y))
        levels = _levels(base, y) if state is None else state.levels
        model = levels @ base
        by_p = np.empty((len(y), 7))
        for k, h in enumerate(_STEPS):
            moved = p.copy()
            moved[k] += h
            by_p[:, k] = (levels @ _shares(view, at, moved) - model) / h
        offset = (at - p[:2]) / edge
        sides = [k for k in range(2, 6) if base[k].sum() > 0.5]
        lit = levels[0] * base[0] + levels[1] * base[1]
        design = np.column_stack([by_p, base[0], base[1], *base[sides], lit * offset[:, 0], lit * offset[:, 1]])
        prior = np.zeros(design.shape[1])
        prior[2:6] = _SHAPE_STD**-2.0
        prior[6] = 0.3**-2.0
        pull = np.zeros(design.shape[1])
        pull[2:6] = -p[2:6]
        pull[6] = _START_BLUR_PX - p[6]
        solution: np.ndarray = np.zeros(len(prior))
        inverse: np.ndarray = np.eye(len(prior))
        residual: np.ndarray = y
        for _robust in range(3):
            normal = design.T @ (design * weight[:, None]) + np.diag(prior * scale**2) * (state is not None)
            normal += 1e-9 * np.diag(np.maximum(np.diag(normal), 1e-12))
            inverse = np.linalg.inv(normal)
            solution = inverse @ (design.T @ (weight * y) + prior * pull * scale**2 * (state is not None))
            residual = y - design @ solution
            scale = max(1.4826 * float(np.median(np.abs(residual))), 1e-9)
            weight = 1.0 / np.maximum(np.abs(residual) / (2.5 * scale), 1.0)
        step = solution[:7].copy()
        if not np.all(np.isfinite(step)):
            return None
        step[:2] = np.clip(step[:2], -1.0, 1.0)
        step[2:6] = np.clip(step[2:6], -0.05, 0.05)
        p = p + step
        p[2:6] = np.clip(p[2:6], -0.15, 0.15)
        p[6] = np.clip(p[6], *_BLUR_PX)
        levels = np.zeros(6)
        levels[[0, 1, *sides]] = solution[7 : 9 + len(sides)]
        freedom = max(float(weight.sum()) - design.shape[1], 1.0)
        variance = float(np.sum(weight * residual**2)) / freedom
        inner = design * (weight == 1.0)[:, None]
        normal = design.T @ inner + np.diag(prior * scale**2)
        inverse = np.linalg.inv(normal + 1e-9 * np.diag(np.maximum(np.diag(normal), 1e-12)))
        pulls = design @ inverse[:, :2] * (weight * residual)[:, None]  # of each pixel on the centre
        done = iteration >= 3 and bool(np.abs(step[:2]).max() < 1e-3)
        state = _State(
            p=p,
            covariance=pulls.T @ pulls * (len(y) / freedom),
            levels=levels,
            rms=float(np.sqrt(variance)),
            pixels=int(use.sum()),
            converged=done,
        )
        if done:
            break
    return state


def _levels(shares: np.ndarray, y: np.ndarray) -> np.ndarray:
    """First levels of white, black and the sides."""
    tie = 1e-3 * np.eye(6)
    out = np.linalg.lstsq(np.concatenate([shares.T, tie]), np.concatenate([y, np.zeros(6)]), rcond=None)[0]
    return np.asarray(out)


def _shadow_across(shares: np.ndarray, value: np.ndarray) -> bool:
    """Whether pixels that should be pure white have two levels."""
    white = value[shares[0] > 0.97]
    if white.size < 8:
        return False
    low, high = np.percentile(white, [10.0, 90.0])
    return bool(low < _SHADOW_SHARE * high)


def _unevenness(white: np.ndarray, residual: np.ndarray) -> float:
    """Standard deviation of the light over the white squares beyond pixel noise: a faint shadow's edge, dirt. 0 where the
    pixels' own noise may be all.

    Parameters
    ----------
    white : (h, w) bool np.ndarray
        Pixels that should be pure white.
    residual : (h, w) np.ndarray
        Value minus the level of white.
    """
    count = cv2.boxFilter(white.astype(np.float64), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(np.where(white, residual, 0.0), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    whole = white & (count > 8.5)
    n = int(whole.sum())
    if n < 2:
        return 0.0
    smooth = total[whole] / 9.0
    noise = float(np.mean((residual[whole] - smooth) ** 2)) * 9.0 / 8.0
    found, by_chance = float(np.mean(smooth**2)), 2.0 * noise / 9.0  # twice: the lens' blur makes neighbours alike
    if found < by_chance * (1.0 + _UNEVEN_SIGMAS * np.sqrt(2.0 * 9.0 / n)):
        return 0.0
    return float(np.sqrt(found - by_chance))


def find_board(
    grey: np.ndarray, view: BoardView, search_px: float, *, clipped_at: float = np.inf, black_level: float = 0.0
) -> BoardFit | str:
    """Centre of one board.

    Parameters
    ----------
    grey : (h, w) np.ndarray
        Whole image, linear in radiance.
    view : BoardView
        Prediction.
    search_px : float
        How far the board may be from its predicted place, in each axis. [px]
    clipped_at : float
        Values from here on are saturated and not used.
    black_level : float
        Value without light; contrast and shadow are judged above it.

    Returns
    -------
    BoardFit, or a line that says why there is none. The first pixel's centre is (0.5, 0.5).

    References
    ----------
    The patent's step S4.
    """
    narrow, edge = sides_px(view)
    if narrow < _LEAST_EDGE_PX:
        return f"board of {narrow:.1f} px, {_LEAST_EDGE_PX:.0f} px are needed"
    if edge > _MOST_EDGE_PX:
        return _coarser(grey, view, search_px, int(np.ceil(edge / _MOST_EDGE_PX)), clipped_at, black_level)
    size = np.array([grey.shape[1], grey.shape[0]])
    reach = int(np.ceil(search_px + np.abs(_outline_px(view)).max() + 3.0))
    middle = np.floor(view.predicted_px).astype(int)
    low, high = np.maximum(middle - reach, 0), np.minimum(middle + reach + 1, size)
    outline = view.predicted_px + _outline_px(view)
    cut = bool(np.any(outline < 0.0) or np.any(outline > size))
    if np.any(high <= low):
        return "outside the image"
    window = np.asarray(grey[low[1] : high[1], low[0] : high[0]], dtype=np.float64) - black_level
    candidates = _search(window, view)
    if not candidates:
        saturated = float(np.mean(window >= clipped_at - black_level))
        if saturated > _SATURATED_SHARE:
            return f"over-exposed: {100.0 * saturated:.0f} % of the search window is saturated"
        if cut:
            return "part of the board lies outside the image"
        near = np.any(outline < search_px) or np.any(outline > size - search_px)
        where = ", or partly outside the image" if near else ""
        return (
            f"no board of this size and azimuth within {search_px:.0f} px: missing, hidden, in shadow or turned{where}"
        )
    fits: list[BoardFit] = []
    reason = ""
    for place, correlation in candidates:
        fit = _fit_at(window, place, correlation, view, clipped_at - black_level)
        if isinstance(fit, str):
            reason = reason or fit
            continue
        moved = fit.uv_px + low
        corners = moved + outline - view.predicted_px
        if np.any(corners < -0.5) or np.any(corners > size + 0.5):
            reason = reason or "part of the board lies outside the image"
            continue
        side = 2 * max(round(0.25 * narrow), 1)
        count = half_window_centre(window, place, 0.5 * narrow, side, fit.threshold)
        fits.append(replace(fit, uv_px=moved, count_px=None if count is None else count + low, edge_px=edge))
    if not fits:
        return reason
    fits.sort(key=lambda f: f.rms)
    if len(fits) > 1 and fits[1].rms < 1.5 * fits[0].rms:
        return "two boards alike within the search window"
    return fits[0]


def _coarser(
    grey: np.ndarray, view: BoardView, search_px: float, factor: int, clipped_at: float, black_level: float
) -> BoardFit | str:
    """The same on means of factor x factor pixels: a wide board needs no more of them, and memory stays bounded."""
    size = np.array([grey.shape[1], grey.shape[0]])
    reach = search_px + np.abs(_outline_px(view)).max() + 5.0 * factor
    low = np.clip(np.floor((view.predicted_px - reach) / factor), 0, None).astype(int) * factor
    high = np.minimum(np.ceil((view.predicted_px + reach) / factor).astype(int), size // factor) * factor
    if np.any(high <= low):
        return "outside the image"
    blocks = grey[low[1] : high[1], low[0] : high[0]]
    blocks = blocks.reshape(len(blocks) // factor, factor, -1, factor)
    mean = blocks.mean(axis=(1, 3), dtype=np.float64)
    mean = np.where(blocks.max(axis=(1, 3)) >= clipped_at, np.maximum(mean, clipped_at), mean)
    shrink = np.diag([1.0 / factor, 1.0 / factor, 1.0])
    coarse = replace(
        view, predicted_px=(view.predicted_px - low) / factor, offset_from_board=shrink @ view.offset_from_board
    )
    fit = find_board(mean, coarse, search_px / factor, clipped_at=clipped_at, black_level=black_level)
    if isinstance(fit, str):
        return fit
    return replace(
        fit,
        uv_px=low + factor * fit.uv_px,
        covariance_px2=factor**2 * fit.covariance_px2,
        count_px=None if fit.count_px is None else low + factor * fit.count_px,
        edge_px=factor * fit.edge_px,
        blur_px=factor * fit.blur_px,
        pixels=factor**2 * fit.pixels,
    )


def _fit_at(
    window: np.ndarray, place: np.ndarray, correlation: float, view: BoardView, clipped_at: float
) -> BoardFit | str:
    """Fit about one place of the window, and the checks that make it a board."""
    reach = np.ceil(np.abs(_outline_px(view)).max(axis=0) + 3.0).astype(int)
    low = np.maximum(np.floor(place).astype(int) - reach, 0)
    high = np.minimum(np.floor(place).astype(int) + reach + 1, [window.shape[1], window.shape[0]])
    v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
    value = window[low[1] : high[1], low[0] : high[0]].ravel()
    uv = np.stack([u.ravel(), v.ravel()], axis=-1) + 0.5 - place
    threshold = otsu_threshold(value)
    good = value < clipped_at
    uv, value = uv[good], value[good]
    state = _refine(view, uv, value, _START)
    shares = _shares(view, uv, _START if state is None else state.p)
    if state is None or not state.converged:
        return "a shadow lies across the board" if _shadow_across(shares, value) else "the fit does not converge"
    white, black = float(state.levels[0]), float(state.levels[1])
    contrast = (white - black) / max(abs(white), 1e-12)
    covariance = _CORRELATED**2 * state.covariance + _FLOOR_PX**2 * np.eye(2)
    std = float(np.sqrt(np.max(np.linalg.eigvalsh(covariance))))
    if _shadow_across(shares, value):
        return "a shadow lies across the board"
    area = (high - low)[::-1]
    pure, residual = np.zeros(area.prod(), bool), np.zeros(area.prod())
    pure[good], residual[good] = shares[0] > 0.97, value - white
    uneven = _unevenness(pure.reshape(area), residual.reshape(area)) / max(abs(white), 1e-12)
    covariance = covariance + (_UNEVEN_PULL * uneven * float(state.p[6])) ** 2 * np.eye(2)
    if white > _MOST_WHITE * clipped_at:
        return f"over-exposed: white would be {white / clipped_at:.0f} times saturation"
    if contrast < _LEAST_CONTRAST:
        return f"contrast of {contrast:.2f} between the squares"
    if state.rms > _WORST_FIT * (white - black):
        return f"the pattern fits badly (residuals {state.rms / (white - black):.2f} of the contrast)"
    if std > _LARGEST_STD_PX:
        return f"centre not determined (standard deviation {std:.2f} px)"
    if np.linalg.norm(state.p[:2]) > 3.0:
        return "the fit left the pattern that was found"
    return BoardFit(
        uv_px=place + state.p[:2],
        covariance_px2=covariance,
        count_px=None,
        threshold=threshold,
        edge_px=0.0,
        blur_px=float(state.p[6]),
        white=white,
        contrast=contrast,
        rms=state.rms / (white - black),
        correlation=correlation,
        pixels=state.pixels,
    )
