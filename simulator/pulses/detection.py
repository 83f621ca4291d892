"""Samples to echoes, as the device's own firmware does it: maxima above the noise, each fitted by a Gaussian. One waveform after
the other; deliberately simple and quick. The evaluator decomposes packets with its own.
"""

import math

import numba
import numpy as np


def tables(
    baseline: float, noise: float, shot_noise: float, threshold_sigma: float, full_scale: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What `detect` asks for every step of the digitiser, so that it takes no root and no logarithm.

    Parameters
    ----------
    baseline, noise, shot_noise : float
        Level without light, standard deviation there, and what light adds: this squared times its steps to the variance. [DN]
    threshold_sigma : float
        How many standard deviations of the noise make a signal.
    full_scale : int
        Last step.

    Returns
    -------
    rise, fall : (full_scale + 1,) ndarray, int32
        Steps by which the signal must have risen from a valley to here, or fall from a maximum here, to count. [DN]
    log : (full_scale + 1,) ndarray, float32
        Natural logarithm of the height above the baseline.
    """
    above = np.arange(full_scale + 1) - baseline
    rise = threshold_sigma * np.sqrt(noise**2 + shot_noise**2 * np.maximum(above, 0.0))
    fall = np.minimum(rise, 0.5 * above)
    log = np.log(np.maximum(above, 1e-9))
    return np.ceil(rise).astype(np.int32), np.ceil(fall).astype(np.int32), log.astype(np.float32)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _fit_peak(
    wave: np.ndarray, first: int, last: int, baseline: float, log: np.ndarray, full_scale: int, floor: float
) -> tuple[float, float, float]:
    """Gaussian through samples first..last: a parabola fitted to their logarithms, weighted by the square of the signal.

    Clipped samples and those at the noise floor are left out. Returns position, amplitude, sigma; sigma 0 when the samples
    do not bend downwards or are fewer than three.
    """
    middle = 0.5 * (first + last)
    s0 = s1 = s2 = s3 = s4 = t0 = t1 = t2 = 0.0
    used = 0
    for k in range(first, last + 1):
        step = wave[k]
        y = step - baseline
        if step >= full_scale or y <= floor:
            continue
        used += 1
        x = k - middle
        w = y * y
        wx = w * x
        wxx = wx * x
        z = float(log[step])
        s0 += w
        s1 += wx
        s2 += wxx
        s3 += wxx * x
        s4 += wxx * x * x
        t0 += w * z
        t1 += wx * z
        t2 += wxx * z
    if used < 3:
        return middle, 0.0, 0.0
    c00 = s2 * s4 - s3 * s3
    c01 = s2 * s3 - s1 * s4
    c02 = s1 * s3 - s2 * s2
    c11 = s0 * s4 - s2 * s2
    c12 = s1 * s2 - s0 * s3
    c22 = s0 * s2 - s1 * s1
    determinant = s0 * c00 + s1 * c01 + s2 * c02
    if determinant <= 0.0:
        return middle, 0.0, 0.0
    scale = 1.0 / determinant
    a = (c00 * t0 + c01 * t1 + c02 * t2) * scale
    b = (c01 * t0 + c11 * t1 + c12 * t2) * scale
    c = (c02 * t0 + c12 * t1 + c22 * t2) * scale
    if c >= 0.0:
        return middle, 0.0, 0.0
    half = -0.5 / c
    x = half * b
    return middle + x, math.exp(a + 0.5 * b * x), math.sqrt(half)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _ends(wave: np.ndarray, high: int, above: np.ndarray, words: np.ndarray) -> tuple[int, int]:
    """First and last sample of at least `high`; (0, -1): none. `above`: work space, zero past the samples, which `words` shows by
    eights."""
    limit = np.uint16(high)
    for k in range(len(wave)):
        above[k] = np.uint8(wave[k] >= limit)
    first, last = 0, len(words) - 1
    while first <= last and words[first] == 0:
        first += 1
    if first > last:
        return 0, -1
    while words[last] == 0:
        last -= 1
    low, top = (
        words[first],
        words[last],
    )  # bytes of 0 and 1: which is the lowest that is set, how many up to the highest
    low &= ~low + np.uint64(1)
    top |= top >> np.uint64(8)
    top |= top >> np.uint64(16)
    top |= top >> np.uint64(32)
    start = 8 * first + int((low * np.uint64(0x0001020304050607)) >> np.uint64(56))
    return start, 8 * last + int((top * np.uint64(0x0101010101010101)) >> np.uint64(56)) - 1


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _maxima(
    wave: np.ndarray,
    start: int,
    stop: int,
    high: int,
    rise: np.ndarray,
    fall: np.ndarray,
    full_scale: int,
    most: int,
    top: np.ndarray,
) -> int:
    """Maxima of at least `high`, kept apart only where the valley between them is deeper than the noise allows.

    `top` (3, most + 1): each maximum, the last sample of its plateau, the lowest sample before it. Returns how many, of which
    the last may be one more than `most`.
    """
    found = 0
    rising = True
    best = end = low = start
    peak = valley = np.int32(wave[start])
    for k in range(start + 1, len(wave)):
        here = np.int32(wave[k])
        if rising:
            if here > peak:
                best = end = k
                peak = here
            elif here == peak:
                if here >= full_scale or end == k - 1:
                    end = k
            elif peak < high:
                if k > stop:
                    break
                if here < valley:
                    low = best = end = k
                    peak = valley = here
            elif peak - here >= fall[peak]:
                if best > 0:
                    top[0, found], top[1, found], top[2, found] = best, end, low
                    found += 1
                if found > most or k >= stop:
                    break
                rising = False
                low, valley = k, here
        elif here <= valley:
            low, valley = k, here
        elif k > stop:
            break
        elif here - valley >= rise[here]:
            rising = True
            best = end = k
            peak = here
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def detect(
    waves: np.ndarray,
    setting: np.ndarray,
    table: tuple[np.ndarray, np.ndarray, np.ndarray],
    full_scale: int,
    half_window: int,
    count: np.ndarray,
    position: np.ndarray,
    amplitude: np.ndarray,
    sigma: np.ndarray,
) -> None:
    """Echoes of n waveforms (n, samples) uint16 into (n, r) arrays, `count` (n,) of them; what is past it stays as it was.

    `setting`: baseline, standard deviation of the noise there, threshold above the baseline [DN], sigma of a flat target's echo
    [samples]. `table`: see `tables`. `half_window`: samples beside a maximum that the fit takes.
    """
    baseline, floor, threshold, echo_sigma = setting
    rise, fall, log = table
    high, (samples, most) = math.ceil(baseline + threshold), (waves.shape[1], position.shape[1])
    top = np.empty((3, most + 1), np.int64)
    above = np.zeros((samples + 7) // 8 * 8, np.uint8)
    words = above.view(np.uint64)
    for i in range(len(waves)):
        wave = waves[i]
        start, stop = _ends(wave, high, above, words) if high <= full_scale else (0, -1)
        if stop < 0:
            count[i] = 0
            continue
        found = _maxima(wave, start, stop, high, rise, fall, full_scale, most, top)
        kept = min(found, most)
        for j in range(kept):
            best, end = top[0, j], top[1, j]
            # a neighbour pulls the fit towards itself: stay within half the way to the valley between them
            reach = half_window + (2 if wave[best] >= full_scale else 0)
            if j > 0:
                reach = min(reach, max(1, (best - top[2, j]) // 2))
            if j + 1 < found:
                reach = min(reach, max(1, (top[2, j + 1] - end) // 2))
            first, last = max(best - reach, 0), min(end + reach, samples - 1)
            mean, height, width = _fit_peak(wave, first, last, baseline, log, full_scale, floor)
            middle = 0.5 * (best + end)
            if width == 0.0 or abs(mean - middle) > 1.5 + 0.5 * (end - best):
                mean, height, width = middle, wave[best] - baseline, echo_sigma
            position[i, j] = mean
            amplitude[i, j] = height
            sigma[i, j] = width
        count[i] = kept
