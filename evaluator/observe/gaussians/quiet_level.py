"""Compiled kernel: baseline and noise of each waveform packet. The fits are in `fit`."""

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def quiet_level(packets: np.ndarray, baseline: np.ndarray, noise: np.ndarray) -> None:
    """Baseline and noise of each packet from its quiet samples; NaN samples do not exist.

    Start: the shortest interval that holds a quarter of the samples (echoes are bright and few, so it sits on the baseline).
    Then samples within 3.5 sigma of the mean are kept until nothing changes.
    """
    values = np.empty(packets.shape[1])
    for p in range(packets.shape[0]):
        n = 0
        roughness = 0.0  # of second differences: what changes from sample to sample, whatever the echoes do
        triples = 0
        for i in range(packets.shape[1]):
            v = packets[p, i]
            if math.isnan(v):
                continue
            if i >= 2:
                second = v - 2.0 * packets[p, i - 1] + packets[p, i - 2]
                if not math.isnan(second):
                    roughness += math.sqrt(abs(second))
                    triples += 1
            j = n  # insertion sort: packets are short
            while j > 0 and values[j - 1] > v:
                values[j] = values[j - 1]
                j -= 1
            values[j] = v
            n += 1
        if n < 8:
            baseline[p] = math.nan
            noise[p] = math.nan
            continue
        m = max(6, n // 4)
        best, start = math.inf, 0
        for i in range(n - m + 1):
            width = values[i + m - 1] - values[i]
            if width < best:
                best, start = width, i
        level = 0.0
        for i in range(start, start + m):
            level += values[i] / m
        # A quarter of a normal distribution lies within +-0.32 sigma; digital steps put a floor under it. A slow tail
        # widens the interval but not the second differences (mean root of a normal deviate's size: 0.822).
        sigma = best / 0.64
        if triples > 0:
            sigma = min(sigma, 3.0 * (roughness / triples / 0.822) ** 2 / math.sqrt(6.0))
        sigma = max(sigma, 0.5)
        most = 2.0 * sigma
        for _ in range(20):
            kept, total, square = 0, 0.0, 0.0
            for i in range(n):
                d = values[i] - level
                if abs(d) <= 3.5 * sigma:
                    kept += 1
                    total += d
                    square += d * d
            if kept < 4:
                break
            shift = total / kept
            new_sigma = max(math.sqrt(max(square / kept - shift * shift, 0.0) * kept / (kept - 1)), 0.289)
            new_sigma = min(new_sigma, most)
            if abs(shift) < 1e-3 and abs(new_sigma - sigma) < 1e-3:
                break
            level += shift
            sigma = new_sigma
        baseline[p] = level
        noise[p] = sigma
