"""Levenberg-Marquardt for a sum of Gaussians on one packet, with the analytic Jacobian; compiled. Which echoes: `search`.

theta holds amplitude, centre and sigma of each echo, then the baseline.
"""

import math

import numpy as np
from numba import njit

MAX_ECHOES = 8
MAX_PARAMETERS = 3 * MAX_ECHOES + 1
TIGHT = 1e-9  # chi-square may change by this share in the last step of a fit that is reported
LOOSE = 1e-4  # and of one that only serves a decision
_REACH = 6.0  # an echo ends this many sigma from its centre: 1.5e-8 of its peak
_MAX_ITERATIONS = 60
# Shapes (echoes, n), their windows (echoes, 2) int64, residuals (n,), two matrices (2, p, p), three vectors (3, p): taken once a
# call of `search`, because taking memory costs as much as an iteration.
Work = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@njit(cache=True, nogil=True, error_model="numpy")
def work_space(n: int) -> Work:
    """For packets of n samples."""
    return (
        np.zeros((MAX_ECHOES, n)),
        np.zeros((MAX_ECHOES, 2), np.int64),
        np.zeros(n),
        np.zeros((2, MAX_PARAMETERS, MAX_PARAMETERS)),
        np.zeros((3, MAX_PARAMETERS)),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def copy(source: np.ndarray, count: int, target: np.ndarray) -> None:
    """Plain loops compile several times faster than slices."""
    for i in range(count):
        target[i] = source[i]


@njit(cache=True, nogil=True, error_model="numpy")
def shapes(theta: np.ndarray, k: int, e: np.ndarray, window: np.ndarray) -> None:
    """exp(-z^2/2) of each echo, z = (i - centre)/sigma, within its window [window[c, 0], window[c, 1]).

    From sample to sample the ratio of two values changes by the constant factor exp(-1/sigma^2): three exponentials an echo.
    """
    n = e.shape[1]
    for c in range(k):
        mu, s = theta[3 * c + 1], theta[3 * c + 2]
        lo = max(0, math.floor(mu - _REACH * s))
        hi = min(n, math.ceil(mu + _REACH * s) + 1)
        window[c, 0], window[c, 1] = lo, max(lo, hi)
        if hi <= lo:
            continue
        start = min(max(math.floor(mu + 0.5), lo), hi - 1)
        d = 1.0 / s
        z = (start - mu) * d
        peak = math.exp(-0.5 * z * z)
        up = math.exp(-d * (z + 0.5 * d))
        bend = math.exp(-d * d)
        value, ratio = peak, up
        e[c, start] = value
        for i in range(start + 1, hi):
            value *= ratio
            ratio *= bend
            e[c, i] = value
        value, ratio = peak, bend / up
        for i in range(start - 1, lo - 1, -1):
            value *= ratio
            ratio *= bend
            e[c, i] = value


@njit(cache=True, nogil=True, error_model="numpy")
def residuals(y: np.ndarray, iv: np.ndarray, theta: np.ndarray, k: int, work: Work) -> float:
    """Shapes and residuals at theta, into the work space. Returns chi^2."""
    e, window, r, _, _ = work
    shapes(theta, k, e, window)
    n = y.size
    base = theta[3 * k]
    for i in range(n):
        r[i] = y[i] - base
    for c in range(k):
        a = theta[3 * c]
        for i in range(window[c, 0], window[c, 1]):
            r[i] -= a * e[c, i]
    even, odd = 0.0, 0.0  # two sums: one waits while the other is added to
    for i in range(0, n - 1, 2):
        even += r[i] * r[i] * iv[i]
        odd += r[i + 1] * r[i + 1] * iv[i + 1]
    if n % 2 == 1:
        even += r[n - 1] * r[n - 1] * iv[n - 1]
    return even + odd


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(
    iv: np.ndarray, theta: np.ndarray, k: int, work: Work, normal: np.ndarray, grad: np.ndarray
) -> None:
    r"""Lower triangle of J^T W J, and J^T W r, baseline included, at the shapes and residuals in the work space.

    The columns of one echo are :math:`e, (A/\sigma) e z, (A/\sigma) e z^2`, so that its block holds the sums of
    :math:`w e^2 z^m`, m = 0 ... 4, and two echoes share only samples where their windows overlap.
    """
    e, window, r, _, _ = work
    b = 3 * k
    level, right = 0.0, 0.0
    for i in range(iv.size):
        level += iv[i]
        right += iv[i] * r[i]
    normal[b, b], grad[b] = level, right
    for c in range(k):
        j = 3 * c
        mu, d = theta[j + 1], 1.0 / theta[j + 2]
        f = theta[j] * d
        s0 = s1 = s2 = s3 = s4 = 0.0
        t0 = t1 = t2 = 0.0
        g0 = g1 = g2 = 0.0
        for i in range(window[c, 0], window[c, 1]):
            z = (i - mu) * d
            we = iv[i] * e[c, i]
            wez = we * z
            wezz = wez * z
            ez = e[c, i] * z
            ezz = ez * z
            s0 += we * e[c, i]
            s1 += we * ez
            s2 += wez * ez
            s3 += wez * ezz
            s4 += wezz * ezz
            t0 += we
            t1 += wez
            t2 += wezz
            g0 += we * r[i]
            g1 += wez * r[i]
            g2 += wezz * r[i]
        ff = f * f
        normal[j, j] = s0
        normal[j + 1, j], normal[j + 1, j + 1] = f * s1, ff * s2
        normal[j + 2, j], normal[j + 2, j + 1], normal[j + 2, j + 2] = f * s2, ff * s3, ff * s4
        normal[b, j], normal[b, j + 1], normal[b, j + 2] = t0, f * t1, f * t2
        grad[j], grad[j + 1], grad[j + 2] = g0, f * g1, f * g2
        for c2 in range(c):
            j2 = 3 * c2
            mu2, d2 = theta[j2 + 1], 1.0 / theta[j2 + 2]
            f2 = theta[j2] * d2
            c00 = c01 = c02 = c10 = c11 = c12 = c20 = c21 = c22 = 0.0
            for i in range(max(window[c, 0], window[c2, 0]), min(window[c, 1], window[c2, 1])):
                z, z2 = (i - mu) * d, (i - mu2) * d2
                w = iv[i] * e[c, i] * e[c2, i]
                wz = w * z
                wzz = wz * z
                c00 += w
                c10 += wz
                c20 += wzz
                c01 += w * z2
                c11 += wz * z2
                c21 += wzz * z2
                z2 *= z2
                c02 += w * z2
                c12 += wz * z2
                c22 += wzz * z2
            both = f * f2
            normal[j, j2], normal[j, j2 + 1], normal[j, j2 + 2] = c00, f2 * c01, f2 * c02
            normal[j + 1, j2], normal[j + 1, j2 + 1], normal[j + 1, j2 + 2] = f * c10, both * c11, both * c12
            normal[j + 2, j2], normal[j + 2, j2 + 1], normal[j + 2, j2 + 2] = f * c20, both * c21, both * c22


@njit(cache=True, nogil=True, error_model="numpy")
def cholesky_inverse(matrix: np.ndarray, n: int) -> bool:
    """Replaces the leading n x n of a symmetric positive definite matrix, whose lower triangle is given, by its inverse.

    False: not positive definite.
    """
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
def damped_step(normal: np.ndarray, grad: np.ndarray, p: int, lam: float, lower: np.ndarray, step: np.ndarray) -> bool:
    """Solves (N + lam diag N) step = grad by Cholesky; `lower` is work space. False: not positive definite."""
    for j in range(p):
        s = normal[j, j] * (1.0 + lam)
        for k in range(j):
            s -= lower[j, k] * lower[j, k]
        if not s > 0.0:
            return False
        inverse = 1.0 / math.sqrt(s)
        lower[j, j] = inverse  # of the diagonal the reciprocal is kept
        for i in range(j + 1, p):
            t = normal[i, j]
            for k in range(j):
                t -= lower[i, k] * lower[j, k]
            lower[i, j] = t * inverse
    for i in range(p):
        t = grad[i]
        for k in range(i):
            t -= lower[i, k] * step[k]
        step[i] = t * lower[i, i]
    for i in range(p - 1, -1, -1):
        t = step[i]
        for k in range(i + 1, p):
            t -= lower[k, i] * step[k]
        step[i] = t * lower[i, i]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def fit(
    y: np.ndarray,
    iv: np.ndarray,
    theta: np.ndarray,
    k: int,
    free: int,
    s0: float,
    width: np.ndarray,
    change: float,
    work: Work,
) -> float:
    """Levenberg-Marquardt from `theta`, in place; width = (least, greatest) sigma over s0. Returns chi^2 (inf: failed).

    It ends where a step lowers chi^2 by less than the share `change` of it, or by 1000 `change`.
    """
    matrices, vectors = work[3], work[4]
    n, p = y.size, 3 * k + free
    normal, lower = matrices[0], matrices[1]
    grad, step, trial = vectors[0], vectors[1], vectors[2]
    chi2 = residuals(y, iv, theta, k, work)
    normal_equations(iv, theta, k, work, normal, grad)
    lam = 1e-3
    for _ in range(_MAX_ITERATIONS):
        for a in range(p):
            if normal[a, a] <= 0.0:
                return math.inf
        accepted = False
        if damped_step(normal, grad, p, lam, lower, step):
            trial[3 * k] = theta[3 * k]
            for a in range(p):
                move = step[a]
                if a < 3 * k and a % 3 == 1:
                    move = min(max(move, -s0), s0)
                trial[a] = theta[a] + move
            for c in range(k):
                old = theta[3 * c + 2]
                s = min(max(trial[3 * c + 2], 0.6 * old), 1.6 * old)
                trial[3 * c + 2] = min(max(s, width[0] * s0), width[1] * s0)
                trial[3 * c] = max(trial[3 * c], 0.2 * theta[3 * c])
                trial[3 * c + 1] = min(max(trial[3 * c + 1], -2.0 * s0), n - 1 + 2.0 * s0)
            new = residuals(y, iv, trial, k, work)
            accepted = new <= chi2
        if accepted:
            gain = chi2 - new
            copy(trial, 3 * k + 1, theta)
            chi2 = new
            if gain < 1e3 * change + change * chi2:
                break
            normal_equations(iv, theta, k, work, normal, grad)
            lam = max(lam * 0.1, 1e-9)
        else:
            lam *= 8.0
            if lam > 1e9:
                break
    return chi2
