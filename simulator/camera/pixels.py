"""The passes over a sensor's pixels that `simulator.camera.sensor` takes, compiled.

In float32 throughout, one operation after the other, so that the bytes are those of the same lines in NumPy.
"""

import numba
import numpy as np

from simulator.normals import normal_stream


@numba.njit(cache=True, nogil=True)
def pattern(key: np.uint64, row: int, column: int, width_px: int, out: np.ndarray) -> None:
    """Standard normal numbers (rows, w, bands) that belong to the pixels of a window which begins at `row` and `column`."""
    n = out.shape[1] * out.shape[2]
    words, line = np.empty((n + 2) // 2, np.uint64), np.empty(n + 1, np.float32)
    sums = words.view(np.int32)
    for i in range(out.shape[0]):
        first = ((row + i) * width_px + column) * out.shape[2]
        odd = first % 2
        normal_stream(key, np.uint64(first // 2), words, sums, line[: n + odd])
        k = odd
        for j in range(out.shape[1]):
            for b in range(out.shape[2]):
                out[i, j, b] = line[k]
                k += 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def expected(
    radiance: np.ndarray,
    light: np.ndarray,
    per_radiance: np.ndarray,
    prnu: np.float32,
    deviate: np.ndarray,
    dark: np.float32,
    few_below: np.float32,
    mean: np.ndarray,
) -> int:
    """Mean electrons (rows, w, bands) of every pixel, dark current included, into `mean`; how many are below `few_below`.

    light: (rows, w) the lens's fall-off.
    """
    few = 0
    for i in range(mean.shape[0]):
        for j in range(mean.shape[1]):
            for b in range(mean.shape[2]):
                value = radiance[i, j, b] * (light[i, j] * per_radiance[b])
                value *= np.float32(1) + prnu * deviate[i, j, b]
                value += dark
                value = max(value, np.float32(0))
                few += value < few_below
                mean[i, j, b] = value
    return few


@numba.njit(cache=True, nogil=True, error_model="numpy")
def steps(
    mean: np.ndarray,
    noise: np.ndarray,
    dsnu_e: np.float32,
    deviate: np.ndarray,
    levels: tuple[np.float32, np.float32, np.float32, np.float32, np.float32],
    dn: np.ndarray,
) -> None:
    """Whole steps of pixels with `noise` in standard deviations; where it is zero, `mean` has its noise already.

    levels: variance of reading [e2], full well [e], steps an electron, black level and a half, last step.
    """
    read_variance, full_well, dn_per_e, black, last = levels
    for i in range(mean.shape[0]):
        for j in range(mean.shape[1]):
            for b in range(mean.shape[2]):
                spread = np.sqrt(max(mean[i, j, b] + read_variance, np.float32(0)))
                value = mean[i, j, b] + noise[i, j, b] * spread
                value = min(value + dsnu_e * deviate[i, j, b], full_well)
                value = value * dn_per_e + black
                value = min(max(value, np.float32(0)), last)
                dn[i, j, b] = np.uint16(np.int32(value))
