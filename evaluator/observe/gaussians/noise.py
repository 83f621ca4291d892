"""The noise model in one packet: weights of its samples, and what its residuals tell of the noise; compiled."""

import math

import numpy as np
from numba import njit

from evaluator.observe.gaussians.fit import MAX_PARAMETERS, Work

_ALONE = 4.0  # an echo whose nearest neighbour is this many sigma away tells of the noise under it


@njit(cache=True, nogil=True, error_model="numpy")
def weights(
    signal: np.ndarray,
    iv: np.ndarray,
    noise_dn: float,
    shot: float,
    shape: float,
    half: int,
    peak: np.ndarray,
    variance: np.ndarray,
) -> None:
    """Inverse variance of the samples that have a weight already; the shape's error follows the greatest signal nearby.

    peak (n,) is work space; variance (n,) is 0 where a sample has no weight.
    """
    n = signal.size
    for i in range(n):
        peak[i] = max(signal[i], 0.0)
    if shape > 0.0:
        for o in range(1, half + 1):
            for i in range(n - o):
                peak[i] = max(peak[i], signal[i + o])
            for i in range(o, n):
                peak[i] = max(peak[i], signal[i - o])
    for i in range(n):
        square = noise_dn * noise_dn + shot * signal[i] + (shape * peak[i]) ** 2
        here = iv[i] > 0.0
        variance[i] = square if here else 0.0
        iv[i] = 1.0 / square if here else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def noise_moments(
    iv: np.ndarray,
    theta: np.ndarray,
    k: int,
    p: int,
    noise_dn: float,
    covariance: np.ndarray,
    work: Work,
    out: np.ndarray,
) -> None:
    """Of the packet's strongest echo, unless another stands close to it: what the noise model is estimated from.

    out: under the echo the fitted signal, squared residual over (1 - leverage) and samples; away from all echoes squared
    residual and samples; the amplitude; sigma; the number of echoes. All zero where there is none such.
    """
    e, window, r, _, _ = work
    for a in range(out.size):
        out[a] = 0.0
    top = 0
    for c in range(k):
        top = c if theta[3 * c] > theta[3 * top] else top
    mu, s = theta[3 * top + 1], theta[3 * top + 2]
    for c in range(k):
        if c != top and abs(theta[3 * c + 1] - mu) < _ALONE * max(s, theta[3 * c + 2]):
            return
    row = np.empty(MAX_PARAMETERS)
    for i in range(iv.size):
        if iv[i] == 0.0:
            continue
        signal, nearest = 0.0, math.inf
        for a in range(p):
            row[a] = 0.0
        row[3 * k] = 1.0
        for c in range(k):
            z = (i - theta[3 * c + 1]) / theta[3 * c + 2]
            nearest = min(nearest, abs(z))
            if window[c, 0] <= i < window[c, 1]:
                g = e[c, i]
                signal += theta[3 * c] * g
                row[3 * c] = g
                row[3 * c + 1] = theta[3 * c] * g * z / theta[3 * c + 2]
                row[3 * c + 2] = row[3 * c + 1] * z
        h = 0.0
        for a in range(p):
            for b in range(p):
                h += row[a] * covariance[a, b] * row[b]
        h *= iv[i]
        if abs(i - mu) < 2.5 * s and h < 0.8:
            out[0] += signal
            out[1] += r[i] * r[i] / (1.0 - h)
            out[2] += 1.0
        elif nearest > 6.0 and r[i] * r[i] < 16.0 * noise_dn * noise_dn:
            out[3] += r[i] * r[i] / (1.0 - h)
            out[4] += 1.0
    out[5], out[6], out[7] = theta[3 * top], s, k
