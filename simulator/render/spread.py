"""From sub-pixels to pixels inside the targets' boxes: the pixel's box and the point spread as weighted sums.

A sample drawn through a pixel's own point spread serves that pixel alone. Inside the boxes sub-pixels are sampled instead,
and every pixel takes its weighted share of all of them within reach of its point spread: about four times as many samples
for each pixel, which is what a mark's edges need. Plain sums in a fixed order, no BLAS: the same bytes on any machine.
"""

import numpy as np

REACH_SIGMA = 3.5  # where the point spread is cut


def halo_px(sigma_px: float) -> int:
    """Whole pixels round a box whose light reaches into it."""
    return int(np.ceil(REACH_SIGMA * sigma_px))


def weights(sigma_px: float, split: int) -> np.ndarray:
    """Weights of the sub-pixels for one pixel along one axis, from `halo_px` pixels before it to as many behind it.

    Parameters
    ----------
    sigma_px : float
        Of the Gaussian point spread. [px]
    split : int
        Sub-pixels along a pixel's edge.

    Returns
    -------
    ((2 halo_px + 1) * split,) ndarray
        Symmetric, sum 1. With the sub-pixel's own box the variance is 1/12 + sigma^2, as long as the point spread is wider
        than a sub-pixel; below that there is none.
    """
    halo = halo_px(sigma_px)
    box = np.zeros((2 * halo + 1) * split)
    box[halo * split : (halo + 1) * split] = 1 / split
    # A pixel's box is the sum of its sub-pixels' boxes exactly, so all of the point spread is the weights'.
    at = np.arange(-halo * split, halo * split + 1) / split
    gauss = np.exp(-0.5 * (at / sigma_px) ** 2) if sigma_px * split > 0.3 else (at == 0).astype(float)
    spread = np.convolve(box, gauss / gauss.sum(), mode="full")
    return np.asarray(spread[halo * split : len(spread) - halo * split] / spread.sum())


def fold(sub: np.ndarray, sigma_px: float, split: int) -> np.ndarray:
    """Sub-pixels of a box and its halo -> pixels of the box.

    Parameters
    ----------
    sub : ((h + 2 halo) * split, (w + 2 halo) * split, bands) float32 ndarray
        Means over the sub-pixels.

    Returns
    -------
    (h, w, bands) float32 ndarray
    """
    taps = weights(sigma_px, split).astype(np.float32)
    across = _fold_rows(sub, taps, split)
    return np.ascontiguousarray(_fold_rows(across.swapaxes(0, 1), taps, split).swapaxes(0, 1))


def _fold_rows(sub: np.ndarray, taps: np.ndarray, split: int) -> np.ndarray:
    count = (len(sub) - len(taps)) // split + 1
    total = np.zeros((count, *sub.shape[1:]), np.float32)
    for k, weight in enumerate(taps):
        total += weight * sub[k : k + (count - 1) * split + 1 : split]
    return total
