"""Compiled kernels of the waveform decomposition: a sum of Gaussians fitted to one packet after the other.

One packet never sees another, so any split over threads gives the same bytes. Positions and widths are in samples here, and
a width is the standard deviation sigma; `waveforms.py` converts, and holds the statistics that join packets.
"""

import math

import numpy as np
from numba import njit

MAX_ECHOES = 8
_MAX_PARAMETERS = 3 * MAX_ECHOES + 1
_MAX_ITERATIONS = 60


@njit(cache=True, nogil=True, error_model="numpy")
def _copy(source: np.ndarray, count: int, target: np.ndarray) -> None:
    """Plain loops compile several times faster than slices."""
    for i in range(count):
        target[i] = source[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _cholesky_inverse(matrix: np.ndarray, n: int) -> bool:
    """Replaces the leading n x n of a symmetric positive definite matrix by its inverse. False: not positive definite."""
    for j in range(n):
        for i in range(j, n):
            s = matrix[i, j]
            for k in range(j):
                s -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not s > 0.0:
                    return False
                matrix[j, j] = math.sqrt(s)
            else:
                matrix[i, j] = s / matrix[j, j]
    for j in range(n):  # inverse of the lower triangle, in place
        matrix[j, j] = 1.0 / matrix[j, j]
        for i in range(j + 1, n):
            s = 0.0
            for k in range(j, i):
                s -= matrix[i, k] * matrix[k, j]
            matrix[i, j] = s / matrix[i, i]
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(i, n):
                s += matrix[k, i] * matrix[k, j]
            matrix[j, i] = s
    for i in range(n):
        for j in range(i):
            matrix[i, j] = matrix[j, i]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _residuals(
    y: np.ndarray, iv: np.ndarray, theta: np.ndarray, k: int, jacobian: np.ndarray, r: np.ndarray, derive: bool
) -> float:
    """Residuals (and derivatives of the model) at theta = (A, centre, sigma) per echo, then the baseline. Returns chi^2."""
    n = y.size
    base = theta[3 * k]
    for i in range(n):
        r[i] = y[i] - base
    if derive:
        for i in range(n):
            for a in range(3 * k):
                jacobian[i, a] = 0.0
            jacobian[i, 3 * k] = 1.0
    for c in range(k):
        a, mu, s = theta[3 * c], theta[3 * c + 1], theta[3 * c + 2]
        lo = max(0, math.floor(mu - 6.0 * s))
        hi = min(n, math.ceil(mu + 6.0 * s) + 1)
        for i in range(lo, hi):
            z = (i - mu) / s
            e = math.exp(-0.5 * z * z)
            r[i] -= a * e
            if derive:
                jacobian[i, 3 * c] = e
                jacobian[i, 3 * c + 1] = a * e * z / s
                jacobian[i, 3 * c + 2] = a * e * z * z / s
    chi2 = 0.0
    for i in range(n):
        chi2 += r[i] * r[i] * iv[i]
    return chi2


@njit(cache=True, nogil=True, error_model="numpy")
def _normal(iv: np.ndarray, jacobian: np.ndarray, r: np.ndarray, p: int, normal: np.ndarray, grad: np.ndarray) -> None:
    for a in range(p):
        grad[a] = 0.0
        for b in range(p):
            normal[a, b] = 0.0
    for i in range(iv.size):
        w = iv[i]
        if w == 0.0:
            continue
        for a in range(p):
            ja = jacobian[i, a] * w
            if ja == 0.0:
                continue
            grad[a] += ja * r[i]
            for b in range(a + 1):
                normal[a, b] += ja * jacobian[i, b]
    for a in range(p):
        for b in range(a):
            normal[b, a] = normal[a, b]


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(
    y: np.ndarray,
    iv: np.ndarray,
    theta: np.ndarray,
    k: int,
    free: int,
    s0: float,
    width: np.ndarray,
    jacobian: np.ndarray,
) -> float:
    """Levenberg-Marquardt from `theta`, in place; width = (least, greatest) sigma over s0. Returns chi^2 (inf: failed)."""
    n, p = y.size, 3 * k + free
    r, trial = np.empty(n), np.empty(3 * k + 1)
    normal, damped = np.empty((p, p)), np.empty((p, p))
    grad = np.empty(p)
    chi2 = _residuals(y, iv, theta, k, jacobian, r, True)
    _normal(iv, jacobian, r, p, normal, grad)
    lam = 1e-3
    for _ in range(_MAX_ITERATIONS):
        for a in range(p):
            for b in range(p):
                damped[a, b] = normal[a, b]
            damped[a, a] *= 1.0 + lam
            if damped[a, a] <= 0.0:
                return math.inf
        accepted = False
        if _cholesky_inverse(damped, p):
            trial[3 * k] = theta[3 * k]
            for a in range(p):
                step = 0.0
                for b in range(p):
                    step += damped[a, b] * grad[b]
                if a < 3 * k and a % 3 == 1:
                    step = min(max(step, -s0), s0)
                trial[a] = theta[a] + step
            for c in range(k):
                old = theta[3 * c + 2]
                s = min(max(trial[3 * c + 2], 0.6 * old), 1.6 * old)
                trial[3 * c + 2] = min(max(s, width[0] * s0), width[1] * s0)
                trial[3 * c] = max(trial[3 * c], 0.2 * theta[3 * c])
                trial[3 * c + 1] = min(max(trial[3 * c + 1], -2.0 * s0), n - 1 + 2.0 * s0)
            new = _residuals(y, iv, trial, k, jacobian, r, False)
            accepted = new <= chi2
        if accepted:
            gain = chi2 - new
            _copy(trial, 3 * k + 1, theta)
            chi2 = _residuals(y, iv, theta, k, jacobian, r, True)
            if gain < 1e-6 + 1e-9 * chi2:
                break
            _normal(iv, jacobian, r, p, normal, grad)
            lam = max(lam * 0.1, 1e-9)
        else:
            lam *= 8.0
            if lam > 1e9:
                break
    return chi2


@njit(cache=True, nogil=True, error_model="numpy")
def _candidates(y: np.ndarray, iv: np.ndarray, base: float, s0: float, sigmas: float, theta: np.ndarray) -> int:
    """Blind peaks: local maxima of the negative second derivative of the smoothed packet, which also shows shoulders."""
    n = y.size
    half = math.ceil(4.0 * s0)
    kernel = np.empty(2 * half + 1)
    for i in range(2 * half + 1):
        z = (i - half) / s0
        kernel[i] = (1.0 - z * z) * math.exp(-0.5 * z * z)
    mean = 0.0
    for i in range(kernel.size):
        mean += kernel[i] / kernel.size
    response, noise = np.zeros(n), np.ones(n)
    for i in range(n):
        total, variance = 0.0, 0.0
        for j in range(2 * half + 1):
            k = min(max(i + j - half, 0), n - 1)
            total += (kernel[j] - mean) * (y[k] - base)
            variance += (kernel[j] - mean) ** 2 / iv[k] if iv[k] > 0.0 else 0.0
        response[i] = total
        noise[i] = math.sqrt(variance) + 1e-9
    count = 0
    strength = np.empty(MAX_ECHOES)
    for i in range(n):
        left = response[i - 1] if i > 0 else -math.inf
        right = response[i + 1] if i < n - 1 else -math.inf
        if not (response[i] > left and response[i] >= right and response[i] > sigmas * noise[i]):
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
        theta[3 * slot] = max(y[i] - base, 3.0 * noise[i] / half)
        theta[3 * slot + 1] = float(i)
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
    jacobian: np.ndarray,
) -> float:
    """Tries one echo more: at the greatest residual, or by splitting the echo that fits worst. Returns the new chi^2 and
    changes theta where chi^2 falls by at least `least_gain`; else returns `chi2`."""
    n = y.size
    r = np.empty(n)
    _residuals(y, iv, theta, k, jacobian, r, False)
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
    best_response, at, amplitude = 0.0, -1, 0.0
    half = math.ceil(3.0 * s0)
    for i in range(n):
        top, bottom = 0.0, 0.0
        for j in range(max(0, i - half), min(n, i + half + 1)):
            z = (j - i) / s0
            g = math.exp(-0.5 * z * z)
            top += r[j] * g * iv[j]
            bottom += g * g * iv[j]
        if bottom > 0.0 and top / math.sqrt(bottom) > best_response:
            best_response, at, amplitude = top / math.sqrt(bottom), i, top / bottom
    # An echo cannot take away more chi^2 than stands where it would lie.
    if max(reachable, best_response * best_response) < least_gain:
        return chi2
    best_chi2 = chi2 - least_gain
    best = np.empty(3 * k + 4)
    found = False
    trial = np.empty(3 * k + 4)
    for start in range(4):
        _copy(theta, 3 * k, trial)
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
        new = _fit(y, iv, trial, k + 1, free, s0, width, jacobian)
        if not new < best_chi2:
            continue
        apart = True
        for c in range(k + 1):
            apart = apart and -s0 < trial[3 * c + 1] < n - 1 + s0
            for d in range(c):
                apart = apart and abs(trial[3 * c + 1] - trial[3 * d + 1]) >= separation * s0
        if apart:
            best_chi2, found = new, True
            _copy(trial, 3 * k + 4, best)
    if not found:
        return chi2
    _copy(best, 3 * k + 4, theta)
    return best_chi2


@njit(cache=True, nogil=True, error_model="numpy")
def _weights(signal: np.ndarray, iv: np.ndarray, noise_dn: float, shot: float, shape: float, half: int) -> None:
    """Inverse variance of the samples that have a weight already; the shape's error follows the greatest signal nearby."""
    n = signal.size
    for i in range(n):
        if iv[i] > 0.0:
            peak = 0.0
            for j in range(max(0, i - half), min(n, i + half + 1)):
                peak = max(peak, signal[j])
            iv[i] = 1.0 / (noise_dn * noise_dn + shot * signal[i] + (shape * peak) ** 2)


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
    summary (p, 4): baseline, chi^2, degrees of freedom, RMS residual. moments (p, 6), or no rows at all: of packets with one
    echo, the sums that the noise model is estimated from. Under the echo: signal, squared residual over (1 - leverage),
    samples; away from it: squared residual, samples; and the amplitude.
    """
    n = packets.shape[1]
    half = max(1, math.ceil(2.0 * s0))
    taps = np.empty(2 * half + 1)
    for i in range(2 * half + 1):
        taps[i] = math.exp(-0.5 * ((i - half) / (0.6 * s0)) ** 2)
    total = 0.0
    for i in range(taps.size):
        total += taps[i]
    theta, reduced = np.empty(_MAX_PARAMETERS), np.empty(_MAX_PARAMETERS)
    backup = np.empty(_MAX_PARAMETERS)
    jacobian = np.ones((n, _MAX_PARAMETERS))
    covariance = np.empty((_MAX_PARAMETERS, _MAX_PARAMETERS))
    grad = np.empty(_MAX_PARAMETERS)
    gains = np.empty(MAX_ECHOES)
    y, iv, r = np.empty(n), np.empty(n), np.empty(n)
    for p in range(packets.shape[0]):
        counts[p] = 0
        base = baseline[p]
        for a in range(4):
            summary[p, a] = math.nan
        if math.isnan(base):
            continue
        valid = 0
        for i in range(n):
            v = packets[p, i]
            y[i] = base if math.isnan(v) else v
        for i in range(n):
            v = packets[p, i]
            if math.isnan(v) or v >= saturation_dn:
                iv[i] = 0.0
                r[i] = 0.0
                continue
            # The variance follows the smoothed signal, not the sample itself: else low samples get the weight.
            signal = 0.0
            for j in range(2 * half + 1):
                signal += taps[j] / total * (y[min(max(i + j - half, 0), n - 1)] - base)
            r[i] = max(signal, 0.0)
            iv[i] = 1.0
            valid += 1
        _weights(r, iv, noise_dn, shot_dn2_per_dn, shape_error, half)
        k = min(_candidates(y, iv, base, s0, 4.5, theta), max_echoes) if valid >= 8 else 0
        chi2 = math.inf
        if k > 0:
            chi2 = _fit(y, iv, theta, k, free, s0, width, jacobian)
        grown = False
        while k > 0:
            # Take out what is not significant.
            if k == 1:
                level, weight = 0.0, 0.0
                for i in range(n):
                    level += (y[i] - base) * iv[i]
                    weight += iv[i]
                shift = level / weight if free else 0.0
                none = 0.0
                for i in range(n):
                    none += (y[i] - base - shift) ** 2 * iv[i]
                gains[0] = none - chi2
            else:
                for c in range(k):
                    _without(theta, k, c, reduced)
                    gains[c] = _fit(y, iv, reduced, k - 1, free, s0, width, jacobian) - chi2
            weakest = k - 1
            for c in range(k):
                weakest = c if gains[c] < gains[weakest] else weakest
            if gains[weakest] < least_gain:
                _without(theta, k, weakest, reduced)
                _copy(reduced, 3 * k - 2, theta)
                k -= 1
                if k > 0:
                    chi2 = _fit(y, iv, theta, k, free, s0, width, jacobian)
                continue
            if k >= max_echoes or grown or not may_grow:
                break
            while k < max_echoes and valid >= 3 * (k + 1) + free + 2:
                _copy(theta, 3 * k + 1, backup)
                new = _grow(y, iv, theta, k, chi2, free, s0, width, least_gain, separation, jacobian)
                if new == chi2:
                    _copy(backup, 3 * k + 1, theta)
                    break
                chi2 = new
                k += 1
                grown = True
            if not grown:
                break
        if k > 0 and (shot_dn2_per_dn > 0.0 or shape_error > 0.0):
            _residuals(y, iv, theta, k, jacobian, r, False)
            for i in range(n):  # weights once more, now from the fitted signal
                r[i] = max(y[i] - r[i] - theta[3 * k], 0.0)
            _weights(r, iv, noise_dn, shot_dn2_per_dn, shape_error, half)
            _fit(y, iv, theta, k, free, s0, width, jacobian)
        if k == 0:
            theta[0] = base
        chi2 = _residuals(y, iv, theta, k, jacobian, r, True)
        parameters = 3 * k + free
        _normal(iv, jacobian, r, parameters, covariance, grad)
        solved = _cholesky_inverse(covariance, parameters)
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
        if k == 1 and solved and p < moments.shape[0]:
            mu, s = theta[1], theta[2]
            for a in range(6):
                moments[p, a] = 0.0
            for i in range(n):
                if iv[i] == 0.0:
                    continue
                z = abs(i - mu) / s
                h = 0.0
                for a in range(parameters):
                    for b in range(parameters):
                        h += jacobian[i, a] * covariance[a, b] * jacobian[i, b]
                h *= iv[i]
                if z < 2.5 and h < 0.8:
                    moments[p, 0] += theta[0] * math.exp(-0.5 * z * z)
                    moments[p, 1] += r[i] * r[i] / (1.0 - h)
                    moments[p, 2] += 1.0
                elif z > 6.0 and r[i] * r[i] < 16.0 * noise_dn * noise_dn:
                    moments[p, 3] += r[i] * r[i] / (1.0 - h)
                    moments[p, 4] += 1.0
            moments[p, 5] = theta[0]
