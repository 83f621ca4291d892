"""Compiled kernel of the chessboard's corners: two crossing blurred edges fitted to the pixels round one corner after another.

One corner never sees another, so any split over threads gives the same bytes. Finding boards, windows and start values are
`chessboard`'s.

Model of a pixel at (x, y) from the corner:

    I = a0 + ax x + ay y + (b0 + bx x + by y) erf(d1 / (s1 sqrt 2)) erf(d2 / (s2 sqrt 2)),
    d_i = n_i . (x, y) - c_i (t_i . (x, y))^2 / 2

with the edges' normals n_i and tangents t_i, blurs s_i, and curvatures c_i that are given (a lens bends the edges; a straight
line fitted to a bent edge misses the corner by c w^2 / 6 for a window of half-width w). Levels and the shape of a symmetric blur
move nothing: the model is even about the corner.
"""

import math

import numpy as np
from numba import njit

PARAMETERS = 12  # u v, angles of both normals, both blurs, a0 ax ay, b0 bx by
_MOST_ITERATIONS = 40
_SIGMA = (0.15, 12.0)  # blur that is believed [px]
_CONVERGED_PX = 3e-4
_BAND_SIGMAS, _BAND_PX = 3.5, 2.5  # half-width of the pixels used along an edge
_ROOT_HALF = 1.0 / math.sqrt(2.0)
_SLOPE = math.sqrt(2.0 / math.pi)


@njit(cache=True, nogil=True, error_model="numpy")
def _cholesky(matrix: np.ndarray, factor: np.ndarray) -> bool:
    """Lower factor of a symmetric matrix whose lower triangle is filled. False: not positive definite."""
    n = matrix.shape[0]
    for j in range(n):
        for i in range(j, n):
            s = matrix[i, j]
            for k in range(j):
                s -= factor[i, k] * factor[j, k]
            if i == j:
                if not s > 0.0:
                    return False
                factor[j, j] = math.sqrt(s)
            else:
                factor[i, j] = s / factor[j, j]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(factor: np.ndarray, right: np.ndarray, x: np.ndarray) -> None:
    n = factor.shape[0]
    for i in range(n):
        s = right[i]
        for k in range(i):
            s -= factor[i, k] * x[k]
        x[i] = s / factor[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= factor[k, i] * x[k]
        x[i] = s / factor[i, i]


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(picture: np.ndarray, start: np.ndarray, radius: float, pixels: np.ndarray) -> int:
    """Fills `pixels` (m, 3) with u, v, DN of the window's pixels that lie near either edge; returns how many. Farther ones say
    nothing about the corner's place."""
    c1, n1 = math.cos(start[2]), math.sin(start[2])
    c2, n2 = math.cos(start[3]), math.sin(start[3])
    band1, band2 = _BAND_SIGMAS * start[4] + _BAND_PX, _BAND_SIGMAS * start[5] + _BAND_PX
    left, top = math.floor(start[0] - radius), math.floor(start[1] - radius)
    right, bottom = math.ceil(start[0] + radius), math.ceil(start[1] + radius)
    if left < 0 or top < 0 or right > picture.shape[1] or bottom > picture.shape[0]:
        return 0
    count = 0
    for row in range(top, bottom):
        y = row + 0.5 - start[1]
        for column in range(left, right):
            x = column + 0.5 - start[0]
            near = abs(c1 * x + n1 * y) <= band1 or abs(c2 * x + n2 * y) <= band2
            if near and x * x + y * y <= radius * radius:
                pixels[count, 0], pixels[count, 1] = column + 0.5, row + 0.5
                pixels[count, 2] = picture[row, column]
                count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _system(
    pixels: np.ndarray,
    theta: np.ndarray,
    bend: np.ndarray,
    normal: np.ndarray,
    gradient: np.ndarray,
    robust: np.ndarray,
    mode: int,
) -> float:
    """Sum of squares. Mode 0: that alone; 1: fills `normal`, `gradient`; 2: also `robust` = sum r^2 J J'."""
    c1, n1 = math.cos(theta[2]), math.sin(theta[2])
    c2, n2 = math.cos(theta[3]), math.sin(theta[3])
    i1, i2 = _ROOT_HALF / theta[4], _ROOT_HALF / theta[5]
    if mode > 0:
        for i in range(PARAMETERS):
            gradient[i] = 0.0
            for j in range(i + 1):
                normal[i, j] = 0.0
                robust[i, j] = 0.0
    j_row = np.empty(PARAMETERS)
    total = 0.0
    for p in range(pixels.shape[0]):
        x, y = pixels[p, 0] - theta[0], pixels[p, 1] - theta[1]
        t1, t2 = c1 * y - n1 * x, c2 * y - n2 * x
        l1, l2 = c1 * x + n1 * y, c2 * x + n2 * y
        z1 = (l1 - 0.5 * bend[0] * t1 * t1) * i1
        z2 = (l2 - 0.5 * bend[1] * t2 * t2) * i2
        e1, e2 = math.erf(z1), math.erf(z2)
        b = theta[9] + theta[10] * x + theta[11] * y
        r = pixels[p, 2] - (theta[6] + theta[7] * x + theta[8] * y + b * e1 * e2)
        total += r * r
        if mode == 0:
            continue
        g1 = b * e2 * _SLOPE / theta[4] * math.exp(-z1 * z1)  # d I / d d1
        g2 = b * e1 * _SLOPE / theta[5] * math.exp(-z2 * z2)
        k1, k2 = bend[0] * t1, bend[1] * t2
        # d d / d x = c + k n, d d / d y = n - k c
        j_row[0] = -(theta[7] + theta[10] * e1 * e2 + g1 * (c1 + k1 * n1) + g2 * (c2 + k2 * n2))
        j_row[1] = -(theta[8] + theta[11] * e1 * e2 + g1 * (n1 - k1 * c1) + g2 * (n2 - k2 * c2))
        j_row[2] = g1 * (t1 + k1 * l1)
        j_row[3] = g2 * (t2 + k2 * l2)
        j_row[4] = -g1 * z1 / (i1 * theta[4])
        j_row[5] = -g2 * z2 / (i2 * theta[5])
        j_row[6], j_row[7], j_row[8] = 1.0, x, y
        j_row[9] = e1 * e2
        j_row[10], j_row[11] = x * e1 * e2, y * e1 * e2
        for i in range(PARAMETERS):
            gradient[i] += j_row[i] * r
            for j in range(i + 1):
                normal[i, j] += j_row[i] * j_row[j]
        if mode == 2:
            for i in range(PARAMETERS):
                for j in range(i + 1):
                    robust[i, j] += r * r * j_row[i] * j_row[j]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _start_levels(pixels: np.ndarray, theta: np.ndarray) -> None:
    """a0 and b0 from the pixels' mean and their product with the pattern."""
    c1, n1 = math.cos(theta[2]), math.sin(theta[2])
    c2, n2 = math.cos(theta[3]), math.sin(theta[3])
    count, total, with_pattern, pattern, squares = pixels.shape[0], 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        x, y, value = pixels[k, 0] - theta[0], pixels[k, 1] - theta[1], pixels[k, 2]
        p = math.erf((c1 * x + n1 * y) * _ROOT_HALF / theta[4]) * math.erf((c2 * x + n2 * y) * _ROOT_HALF / theta[5])
        total += value
        pattern += p
        with_pattern += value * p
        squares += p * p
    determinant = count * squares - pattern * pattern
    theta[6], theta[9] = total / count, 0.0
    if determinant > 0.0:
        theta[9] = (count * with_pattern - total * pattern) / determinant
        theta[6] = (total - theta[9] * pattern) / count


@njit(cache=True, nogil=True, error_model="numpy")
def fit_saddles(
    picture: np.ndarray, start: np.ndarray, bend: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Levenberg-Marquardt for every corner.

    Parameters
    ----------
    picture : (rows, columns) float32 np.ndarray
    start : (n, 6) np.ndarray
        u, v, angles of the normals towards +column and +row [rad], blurs. First pixel's centre (0.5, 0.5). [px]
    bend : (n, 2) np.ndarray
        Curvatures c_i. [1/px]
    radius : (n,) np.ndarray
        Of the round window. [px]

    Returns
    -------
    theta : (n, 12) np.ndarray
        u v, angles, blurs, a0 ax ay, b0 bx by.
    covariance : (n, 2, 2) np.ndarray
        Of u, v, from the residuals, whatever the noise's variance in black and white (sandwich). [px^2]
    noise : (n,) np.ndarray
        Root mean square of the residuals. [DN]
    converged : (n,) bool np.ndarray
    """
    n = start.shape[0]
    theta_out = np.full((n, PARAMETERS), np.nan)
    covariance = np.full((n, 2, 2), np.nan)
    noise = np.full(n, np.nan)
    converged = np.zeros(n, np.bool_)
    normal, robust = np.zeros((PARAMETERS, PARAMETERS)), np.zeros((PARAMETERS, PARAMETERS))
    damped, factor = np.zeros((PARAMETERS, PARAMETERS)), np.zeros((PARAMETERS, PARAMETERS))
    gradient, step, new = np.zeros(PARAMETERS), np.zeros(PARAMETERS), np.zeros(PARAMETERS)
    theta, half, other = np.zeros(PARAMETERS), np.zeros(PARAMETERS), np.zeros(PARAMETERS)
    unit = np.zeros(PARAMETERS)
    side = int(2.0 * radius.max()) + 3 if n > 0 else 1
    window = np.empty((side * side, 3))
    for k in range(n):
        for i in range(PARAMETERS):
            theta[i] = start[k, i] if i < 6 else 0.0
        if not (radius[k] > 0.0 and math.isfinite(theta[0]) and math.isfinite(theta[1])):
            continue
        count = _gather(picture, theta, radius[k], window)
        if count < 2 * PARAMETERS:
            continue
        pixels = window[:count]
        _start_levels(pixels, theta)
        damping = 1e-3
        chi = _system(pixels, theta, bend[k], normal, gradient, robust, 1)
        done = False
        for _ in range(_MOST_ITERATIONS):
            for i in range(PARAMETERS):
                for j in range(i):
                    damped[i, j] = normal[i, j]
                damped[i, i] = normal[i, i] * (1.0 + damping) + 1e-30
            if not _cholesky(damped, factor):
                damping *= 10.0
                if damping > 1e8:
                    break
                continue
            _solve(factor, gradient, step)
            foreseen = 0.0
            for i in range(PARAMETERS):
                new[i] = theta[i] + step[i]
                foreseen += step[i] * (gradient[i] + damping * normal[i, i] * step[i])
            for i in range(4, 6):
                new[i] = min(max(new[i], 0.5 * theta[i], _SIGMA[0]), 2.0 * theta[i], _SIGMA[1])
            trial = _system(pixels, new, bend[k], normal, gradient, robust, 0)
            small = abs(step[0]) < _CONVERGED_PX and abs(step[1]) < _CONVERGED_PX
            if trial <= chi or small:
                for i in range(PARAMETERS):
                    theta[i] = new[i]
                if small:
                    done = True
                    break
                gain = (chi - trial) / max(foreseen, 1e-30)
                if gain < 0.5:  # where the model does not fit (sharpened pictures), full steps swing to and fro
                    damping = max(3.0 * damping, 0.03)
                elif gain > 0.75:
                    damping = max(damping * 0.1, 1e-9)
                chi = _system(pixels, theta, bend[k], normal, gradient, robust, 1)
            else:
                damping *= 10.0
                if damping > 1e8:
                    break
        for i in range(PARAMETERS):
            theta_out[k, i] = theta[i]
        chi = _system(pixels, theta, bend[k], normal, gradient, robust, 2)
        noise[k] = math.sqrt(chi / count)
        if not done or not _cholesky(normal, factor):
            continue
        scale = count / (count - PARAMETERS)
        for a in range(2):
            for i in range(PARAMETERS):
                unit[i] = 1.0 if i == a else 0.0
            _solve(factor, unit, half)
            for b in range(a + 1):
                for i in range(PARAMETERS):
                    unit[i] = 1.0 if i == b else 0.0
                _solve(factor, unit, other)
                s = 0.0
                for i in range(PARAMETERS):
                    for j in range(PARAMETERS):
                        s += half[i] * other[j] * (robust[i, j] if j <= i else robust[j, i])
                covariance[k, a, b] = covariance[k, b, a] = s * scale
        converged[k] = True
    return theta_out, covariance, noise, converged
