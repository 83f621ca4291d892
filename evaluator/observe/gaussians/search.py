"""Which echoes a packet holds: blind peaks, echoes taken out and added by chi-square; compiled. The fit: `fit`."""

import math

import numpy as np
from numba import njit

from evaluator.observe.gaussians.fit import (
    LOOSE,
    MAX_ECHOES,
    MAX_PARAMETERS,
    TIGHT,
    Work,
    cholesky_inverse,
    copy,
    fit,
    normal_equations,
    residuals,
    work_space,
)
from evaluator.observe.gaussians.noise import noise_moments, weights


@njit(cache=True, nogil=True, error_model="numpy")
def _spread(values: np.ndarray, taps: np.ndarray, padded: np.ndarray, out: np.ndarray) -> None:
    """Correlation with `taps`, an odd number; beyond the ends stand the first and the last value. `padded` is work space."""
    n, half = values.size, taps.size // 2
    for i in range(half):
        padded[i] = values[0]
        padded[half + n + i] = values[n - 1]
    for i in range(n):
        padded[half + i] = values[i]
        out[i] = 0.0
    for j in range(taps.size):
        tap = taps[j]
        for i in range(n):
            out[i] += tap * padded[i + j]


@njit(cache=True, nogil=True, error_model="numpy")
def _candidates(
    y: np.ndarray, response: np.ndarray, variance: np.ndarray, base: float, s0: float, sigmas: float, theta: np.ndarray
) -> int:
    """Blind peaks: local maxima of the negative second derivative of the smoothed packet, which also shows shoulders."""
    n = y.size
    half = math.ceil(4.0 * s0)
    count = 0
    strength = np.empty(MAX_ECHOES)
    for i in range(n):
        left = response[i - 1] if i > 0 else -math.inf
        right = response[i + 1] if i < n - 1 else -math.inf
        noise = math.sqrt(variance[i]) + 1e-9
        if not (response[i] > left and response[i] >= right and response[i] > sigmas * noise):
            continue
        slot = count
        if count == MAX_ECHOES:
            slot = 0
            for j in range(MAX_ECHOES):
                slot = j if strength[j] < strength[slot] else slot
            if response[i] <= strength[slot]:
                continue
        else:
            count += 1
        strength[slot] = response[i]
        # between samples the response is a parabola
        shift = 0.0
        if 0 < i < n - 1 and left + right < 2.0 * response[i]:
            shift = 0.5 * (right - left) / (2.0 * response[i] - left - right)
        theta[3 * slot] = max(y[i] - base, 3.0 * noise / half)
        theta[3 * slot + 1] = i + shift
        theta[3 * slot + 2] = s0
    theta[3 * count] = base
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _without(theta: np.ndarray, k: int, c: int, out: np.ndarray) -> None:
    """`theta` without echo c."""
    j = 0
    for a in range(3 * k + 1):
        if a // 3 == c and a < 3 * k:
            continue
        out[j] = theta[a]
        j += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _grow(
    y: np.ndarray,
    iv: np.ndarray,
    theta: np.ndarray,
    k: int,
    chi2: float,
    free: int,
    s0: float,
    width: np.ndarray,
    least_gain: float,
    separation: float,
    match: np.ndarray,
    filtered: np.ndarray,
    work: Work,
) -> float:
    """Tries one echo more: at the greatest residual, or by splitting the echo that fits worst. Returns the new chi^2 and
    changes theta where chi^2 falls by at least `least_gain`; else returns `chi2`.

    match: (2, taps) an echo's shape about its centre, and the square of it; filtered (3, n + taps) is work space.
    """
    n = y.size
    residuals(y, iv, theta, k, work)
    r = work[2]
    worst, worst_excess, reachable = -1, -math.inf, 0.0
    for c in range(k):
        mu, s = theta[3 * c + 1], theta[3 * c + 2]
        local, samples = 0.0, 0
        for i in range(max(0, int(mu - 3.0 * s)), min(n, int(mu + 3.0 * s) + 2)):
            local += r[i] * r[i] * iv[i]
            samples += iv[i] > 0.0
        reachable = max(reachable, local)
        if local - samples > worst_excess:
            worst_excess, worst = local - samples, c
    half = match.shape[1] // 2
    top, bottom, padded = filtered[0], filtered[1], filtered[2]
    for i in range(n + 2 * half):
        padded[i] = 0.0
    for i in range(n):
        padded[half + i] = r[i] * iv[i]
        top[i], bottom[i] = 0.0, 0.0
    for j in range(2 * half + 1):
        for i in range(n):
            top[i] += match[0, j] * padded[i + j]
    for i in range(n):
        padded[half + i] = iv[i]
    for j in range(2 * half + 1):
        for i in range(n):
            bottom[i] += match[1, j] * padded[i + j]
    best_response, at, amplitude = 0.0, -1, 0.0
    for i in range(n):
        # the response, top over the root of bottom, is compared by its square: a root for the few that are greater
        if bottom[i] > 0.0 and top[i] > 0.0 and top[i] * top[i] > best_response * best_response * bottom[i]:
            best_response, at, amplitude = top[i] / math.sqrt(bottom[i]), i, top[i] / bottom[i]
    # An echo cannot take away more chi^2 than stands where it would lie.
    if max(reachable, best_response * best_response) < least_gain:
        return chi2
    best_chi2 = chi2 - least_gain
    best = np.empty(3 * k + 4)
    found = False
    trial = np.empty(3 * k + 4)
    for start in range(4):
        copy(theta, 3 * k, trial)
        trial[3 * k + 3] = theta[3 * k]
        if start == 0:
            if at < 0:
                continue
            trial[3 * k], trial[3 * k + 1], trial[3 * k + 2] = amplitude, at, s0
        else:
            if worst < 0:
                continue
            a, mu, s = theta[3 * worst], theta[3 * worst + 1], theta[3 * worst + 2]
            narrow = min(s, s0)
            share = 0.5 if start == 1 else (0.75 if start == 2 else 0.25)
            trial[3 * worst], trial[3 * worst + 1] = 1.1 * share * a, mu - (1.0 - share) * 1.2 * s
            trial[3 * k], trial[3 * k + 1] = 1.1 * (1.0 - share) * a, mu + share * 1.2 * s
            trial[3 * worst + 2] = narrow
            trial[3 * k + 2] = narrow
        new = fit(y, iv, trial, k + 1, free, s0, width, TIGHT, work)
        if not new < best_chi2:
            continue
        apart = True
        for c in range(k + 1):
            apart = apart and -s0 < trial[3 * c + 1] < n - 1 + s0
            for d in range(c):
                apart = apart and abs(trial[3 * c + 1] - trial[3 * d + 1]) >= separation * s0
        if apart:
            best_chi2, found = new, True
            copy(trial, 3 * k + 4, best)
    if not found:
        return chi2
    copy(best, 3 * k + 4, theta)
    return best_chi2


@njit(cache=True, nogil=True, error_model="numpy")
def _significance(
    y: np.ndarray,
    iv: np.ndarray,
    theta: np.ndarray,
    k: int,
    chi2: float,
    base: float,
    free: int,
    s0: float,
    width: np.ndarray,
    reduced: np.ndarray,
    gains: np.ndarray,
    work: Work,
) -> int:
    """chi^2 lost without each echo, the others fitted again, into `gains`. Returns the echo that is missed least."""
    if k == 1:
        level, weight, none = 0.0, 0.0, 0.0
        for i in range(y.size):
            level += (y[i] - base) * iv[i]
            weight += iv[i]
        shift = level / weight if free else 0.0
        for i in range(y.size):
            none += (y[i] - base - shift) ** 2 * iv[i]
        gains[0] = none - chi2
        return 0
    weakest = k - 1
    for c in range(k):
        _without(theta, k, c, reduced)
        gains[c] = fit(y, iv, reduced, k - 1, free, s0, width, LOOSE, work) - chi2
    for c in range(k):
        weakest = c if gains[c] < gains[weakest] else weakest
    return weakest


@njit(cache=True, nogil=True, error_model="numpy")
def decompose_packets(
    packets: np.ndarray,
    baseline: np.ndarray,
    free: int,
    noise_dn: float,
    shot_dn2_per_dn: float,
    shape_error: float,
    saturation_dn: float,
    s0: float,
    width: np.ndarray,
    least_gain: float,
    may_grow: bool,
    separation: float,
    max_echoes: int,
    echoes: np.ndarray,
    counts: np.ndarray,
    summary: np.ndarray,
    moments: np.ndarray,
) -> None:
    """Fits every packet.

    echoes (p, MAX_ECHOES, 7): A, centre, sigma, their standard deviations, chi^2 lost without the echo; counts (p,);
    summary (p, 4): baseline, chi^2, degrees of freedom, RMS residual; moments (p, 8), or no rows at all: `noise_moments`.
    """
    n = packets.shape[1]
    # ---- filters ----
    half = max(1, math.ceil(2.0 * s0))
    smooth = np.empty(2 * half + 1)
    for i in range(2 * half + 1):
        smooth[i] = math.exp(-0.5 * ((i - half) / (0.6 * s0)) ** 2)
    smooth /= smooth.sum()
    far = math.ceil(4.0 * s0)
    bent = np.empty(2 * far + 1)  # negative second derivative of a Gaussian, mean zero
    for i in range(2 * far + 1):
        z = (i - far) / s0
        bent[i] = (1.0 - z * z) * math.exp(-0.5 * z * z)
    bent -= bent.sum() / bent.size
    bent_square = bent * bent
    near = math.ceil(3.0 * s0)
    match = np.empty((2, 2 * near + 1))
    for i in range(2 * near + 1):
        match[0, i] = math.exp(-0.5 * ((i - near) / s0) ** 2)
        match[1, i] = match[0, i] ** 2
    # ---- work space ----
    theta, reduced, backup = np.zeros(MAX_PARAMETERS), np.zeros(MAX_PARAMETERS), np.zeros(MAX_PARAMETERS)
    covariance, grad = np.zeros((MAX_PARAMETERS, MAX_PARAMETERS)), np.zeros(MAX_PARAMETERS)
    gains = np.zeros(MAX_ECHOES)
    y, iv, signal, variance, peak, response = np.zeros((6, n))
    filtered = np.zeros((3, n + 2 * far + 1))
    work = work_space(n)
    r = work[2]
    for p in range(packets.shape[0]):
        counts[p] = 0
        base = baseline[p]
        for a in range(4):
            summary[p, a] = math.nan
        if math.isnan(base):
            continue
        # ---- samples and their weights: the variance follows the smoothed signal, else low samples get the weight ----
        valid = 0
        for i in range(n):
            v = packets[p, i]
            y[i] = (base if math.isnan(v) else v) - base
            used = not math.isnan(v) and v < saturation_dn
            iv[i] = 1.0 if used else 0.0
            valid += used
        _spread(y, smooth, filtered[0], signal)
        for i in range(n):
            signal[i] = max(signal[i], 0.0) if iv[i] > 0.0 else 0.0
        weights(signal, iv, noise_dn, shot_dn2_per_dn, shape_error, half, peak, variance)
        # ---- blind peaks ----
        _spread(y, bent, filtered[0], response)
        _spread(variance, bent_square, filtered[0], signal)
        for i in range(n):
            y[i] += base
        k = min(_candidates(y, response, signal, base, s0, 4.5, theta), max_echoes) if valid >= 8 else 0
        chi2 = fit(y, iv, theta, k, free, s0, width, LOOSE, work) if k > 0 else math.inf
        # ---- echoes out and in ----
        grown = False
        while k > 0:
            weakest = _significance(y, iv, theta, k, chi2, base, free, s0, width, reduced, gains, work)
            if gains[weakest] < least_gain:
                _without(theta, k, weakest, reduced)
                copy(reduced, 3 * k - 2, theta)
                k -= 1
                if k > 0:
                    chi2 = fit(y, iv, theta, k, free, s0, width, LOOSE, work)
                continue
            if k >= max_echoes or grown or not may_grow:
                break
            while k < max_echoes and valid >= 3 * (k + 1) + free + 2:
                copy(theta, 3 * k + 1, backup)
                new = _grow(y, iv, theta, k, chi2, free, s0, width, least_gain, separation, match, filtered, work)
                if new == chi2:
                    copy(backup, 3 * k + 1, theta)
                    break
                chi2 = new
                k += 1
                grown = True
            if not grown:
                break
        # ---- once more, with weights from the fitted signal ----
        if k > 0:
            if shot_dn2_per_dn > 0.0 or shape_error > 0.0:
                residuals(y, iv, theta, k, work)
                for i in range(n):
                    signal[i] = max(y[i] - r[i] - theta[3 * k], 0.0)
                weights(signal, iv, noise_dn, shot_dn2_per_dn, shape_error, half, peak, variance)
            fit(y, iv, theta, k, free, s0, width, TIGHT, work)
        else:
            theta[0] = base
        chi2 = residuals(y, iv, theta, k, work)
        parameters = 3 * k + free
        normal_equations(iv, theta, k, work, covariance, grad)
        solved = cholesky_inverse(covariance, parameters)
        square = 0.0
        for i in range(n):
            if iv[i] > 0.0:
                square += r[i] * r[i]
        summary[p, 0] = theta[3 * k]
        summary[p, 1] = chi2
        summary[p, 2] = valid - parameters
        summary[p, 3] = math.sqrt(square / valid) if valid > 0 else np.nan
        counts[p] = k
        for c in range(k):
            for a in range(3):
                echoes[p, c, a] = theta[3 * c + a]
                echoes[p, c, 3 + a] = math.sqrt(covariance[3 * c + a, 3 * c + a]) if solved else np.nan
            echoes[p, c, 6] = gains[c]
        if k > 0 and solved and p < moments.shape[0]:
            noise_moments(iv, theta, k, parameters, noise_dn, covariance, work, moments[p])
