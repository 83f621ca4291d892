"""The patent's step S4 as written: a 2x2 board's centre as the window whose halves hold equal numbers of bright pixels.

Whole pixels, no model. What the mounting rests on is the fit in `boards`; this count is reported beside it.
"""

import numpy as np

# Of feature pixels in a window that may be a board's centre: a half there. About the middle of a white square turned by 45
# degrees it is 0.76, in a window as wide as the square.
_COUNT_SHARE = (1.0 / 3.0, 2.0 / 3.0)


def otsu_threshold(values: np.ndarray) -> float:
    """The level that parts values into two classes with the greatest variance between them; 256 steps of their range.

    References
    ----------
    N. Otsu, A threshold selection method from gray-level histograms, IEEE Trans. SMC 9(1), 1979.
    """
    low, high = float(np.min(values)), float(np.max(values))
    if not high > low:
        return high
    counts, edges = np.histogram(values, bins=256, range=(low, high))
    middle = 0.5 * (edges[:-1] + edges[1:])
    below = np.cumsum(counts)[:-1].astype(np.float64)
    total = float(np.sum(counts))
    sums = np.cumsum(counts * middle)
    with np.errstate(invalid="ignore", divide="ignore"):
        between = (sums[-1] * below / total - sums[:-1]) ** 2 / (below * (total - below))
    between = np.nan_to_num(between)
    best = np.flatnonzero(between >= between.max() * (1.0 - 1e-12))
    return float(edges[1 + int(best[len(best) // 2])])


def half_window_centre(
    grey: np.ndarray, predicted_px: np.ndarray, search_px: float, window_px: int, threshold: float | None = None
) -> np.ndarray | None:
    """S4 as written: the window whose left and right, upper and lower halves hold equal numbers of feature pixels.

    Feature pixels are brighter than `threshold`. About the centre of a board each window inside it is the same after half a
    turn, so the halves are equal there whatever the board's azimuth and slant. With the board turned by theta from 0 to 45
    degrees, t = tan theta, a window of side 2 h that is off by a small (dx, dy) differs left to right by
    2 h ((1 + t) dx - (1 - t) dy) and above to below by 2 h ((1 - t) dx + (1 + t) dy), up to signs (along the windows' edges
    white is gained and lost in these lengths; other angles follow by reflection). The determinant 8 h^2 (1 + t^2) never
    vanishes: near the centre there is no other solution, and a pixel's step changes a count by a side of the window. Farther
    off both differences vanish too: over ground, in one square, and, for windows wider than a square, about the middle of a
    white square. Hence the rule, where the text has none:

    * the window has an even side and lies inside the board; half the board's narrower side is a good one;
    * a third to two thirds of its pixels are feature pixels;
    * the least sum of both differences wins (noise may leave no window with none); of equals the one with a share nearest to a
      half; of those still equal the one nearest to the prediction.

    Parameters
    ----------
    grey : (h, w) np.ndarray
        Image.
    predicted_px : (2,) np.ndarray
        Column, row; the image's top left corner is (0, 0). [px]
    search_px : float
        Centres are tried up to so far from the prediction, in each axis. [px]
    window_px : int
        Side of the window; rounded up to an even number. [px]
    threshold : float, optional
        Otsu's of the pixels that are searched, when absent.

    Returns
    -------
    (2,) np.ndarray of whole numbers, or None when no window qualifies. A whole number is a border between pixels.

    References
    ----------
    The patent's step S4; F. C. Crow, Summed-area tables for texture mapping, SIGGRAPH 1984.
    """
    half = max((int(window_px) + 1) // 2, 1)
    image = np.asarray(grey)
    middle = np.round(np.asarray(predicted_px, dtype=np.float64)).astype(int)
    reach = int(np.ceil(search_px))
    first = np.maximum(middle - reach, half)
    last = np.minimum(middle + reach, np.array([image.shape[1], image.shape[0]]) - half)
    if np.any(last < first):
        return None
    part = image[first[1] - half : last[1] + half, first[0] - half : last[0] + half]
    level = otsu_threshold(part) if threshold is None else threshold
    table = np.zeros((part.shape[0] + 1, part.shape[1] + 1), dtype=np.int64)
    table[1:, 1:] = np.cumsum(np.cumsum(part > level, axis=0, dtype=np.int64), axis=1)
    rows, columns = last[1] - first[1] + 1, last[0] - first[0] + 1

    def corner(down: int, right: int) -> np.ndarray:
        """Table at each window's corner or middle: 0, 1, 2 halves down and to the right."""
        return table[down * half : down * half + rows, right * half : right * half + columns]

    def count(top: int, left: int, bottom: int, right: int) -> np.ndarray:
        return corner(bottom, right) - corner(top, right) - corner(bottom, left) + corner(top, left)

    difference = np.abs(count(0, 0, 2, 1) - count(0, 1, 2, 2)) + np.abs(count(0, 0, 1, 2) - count(1, 0, 2, 2))
    share = count(0, 0, 2, 2) / (4.0 * half * half)
    possible = (share >= _COUNT_SHARE[0]) & (share <= _COUNT_SHARE[1])
    if not possible.any():
        return None
    row, column = np.nonzero(possible & (difference == difference[possible].min()))
    place = np.stack([column, row], axis=1) + first
    order = np.lexsort(
        (np.sum((place - np.asarray(predicted_px)) ** 2, axis=1), np.round(np.abs(share[row, column] - 0.5), 9))
    )
    return np.asarray(place[order[0]], dtype=np.float64)
