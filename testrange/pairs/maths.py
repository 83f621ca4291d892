"""Matrices, rotations, cameras and least squares in mpmath, written for the reference pairs alone.

Rotations are products of the three elementary turns, so that a reader can follow them; nothing here is fast.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
from mpmath import cos, mpf, pi, sin

Vector = list[Any]
Matrix = list[list[Any]]

ROTATION_TEXT = (
    "R(roll, pitch, yaw) = Rz(yaw) Ry(pitch) Rx(roll) with Rx(a) = [[1,0,0],[0,cos a,-sin a],[0,sin a,cos a]], "
    "Ry(a) = [[cos a,0,sin a],[0,1,0],[-sin a,0,cos a]], Rz(a) = [[cos a,-sin a,0],[sin a,cos a,0],[0,0,1]]"
)


def dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """Sum of products; for a few terms five times as fast as mpmath's own, which rounds only once."""
    return sum((x * y for x, y in zip(a, b, strict=True)), mpf(0))


def product(a: Matrix, b: Matrix) -> Matrix:
    return [[dot(row, column) for column in zip(*b, strict=True)] for row in a]


def transposed(a: Matrix) -> Matrix:
    return [list(column) for column in zip(*a, strict=True)]


def applied(a: Matrix, x: Sequence[Any]) -> Vector:
    return [dot(row, x) for row in a]


def plus(a: Sequence[Any], b: Sequence[Any]) -> Vector:
    return [x + y for x, y in zip(a, b, strict=True)]


def minus(a: Sequence[Any], b: Sequence[Any]) -> Vector:
    return [x - y for x, y in zip(a, b, strict=True)]


def norm(x: Sequence[Any]) -> Any:
    return mpmath.sqrt(dot(x, x))


def rx(a: Any) -> Matrix:
    return [[mpf(1), mpf(0), mpf(0)], [mpf(0), cos(a), -sin(a)], [mpf(0), sin(a), cos(a)]]


def ry(a: Any) -> Matrix:
    return [[cos(a), mpf(0), sin(a)], [mpf(0), mpf(1), mpf(0)], [-sin(a), mpf(0), cos(a)]]


def rz(a: Any) -> Matrix:
    return [[cos(a), -sin(a), mpf(0)], [sin(a), cos(a), mpf(0)], [mpf(0), mpf(0), mpf(1)]]


def radians(degrees: Sequence[Any]) -> Vector:
    return [d * pi / 180 for d in degrees]


def rotation(angles_rad: Sequence[Any]) -> Matrix:
    """R = Rz(yaw) Ry(pitch) Rx(roll) of (roll, pitch, yaw)."""
    roll, pitch, yaw = angles_rad
    return product(rz(yaw), product(ry(pitch), rx(roll)))


def wrong_rotations(angles_deg: Sequence[Any]) -> dict[str, Matrix]:
    """The rotation of three angles [deg] with one known mistake each."""
    a, b, c = radians(angles_deg)
    return {
        "sign of roll reversed": rotation([-a, b, c]),
        "sign of pitch reversed": rotation([a, -b, c]),
        "sign of yaw reversed": rotation([a, b, -c]),
        "all angles reversed": rotation([-a, -b, -c]),
        "transpose of the rotation": transposed(rotation([a, b, c])),
        "order of the turns reversed: Rx Ry Rz": product(rx(a), product(ry(b), rz(c))),
        "degrees taken as radians": rotation(list(angles_deg)),
        "roll and pitch exchanged": rotation([b, a, c]),
    }


def seen(k: Sequence[Any], r: Matrix, t: Sequence[Any], x: Sequence[Any]) -> Vector:
    """(u, v) of s [u v 1]^T = K (R X + t), K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] given as (fx, fy, cx, cy)."""
    p = plus(applied(r, x), t)
    return [k[0] * p[0] / p[2] + k[2], k[1] * p[1] / p[2] + k[3]]


def distorted(d: Sequence[Any], x: Any, y: Any) -> Vector:
    """Brown-Conrady of normalised coordinates; d = (k1, k2, k3, p1, p2)."""
    k1, k2, k3, p1, p2 = d
    r2 = x * x + y * y
    g = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return [x * g + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * g + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y]


def undistorted(d: Sequence[Any], x: Any, y: Any) -> Vector:
    """The normalised coordinates that `distorted` takes to (x, y), by Newton's method with differences."""
    found = [x, y]
    for _ in range(60):
        slope = jacobian(lambda p: distorted(d, p[0], p[1]), found)
        step = least_squares(slope, minus([x, y], distorted(d, found[0], found[1])))
        found = plus(found, step)
        if max(abs(s) for s in step) < mpf(10) ** -50:
            return found
    raise ArithmeticError("the distortion cannot be removed")


def least_squares(a: Matrix, b: Sequence[Any]) -> Vector:
    """The x that minimises |a x - b|, by the normal equations: at 60 digits and more their squared condition does no harm."""
    at = transposed(a)
    n = mpmath.matrix([[dot(p, q) for q in at] for p in at])
    return list(mpmath.lu_solve(n, mpmath.matrix([dot(p, b) for p in at])))


def pseudo_inverse(a: Matrix) -> Matrix:
    """(A^T A)^-1 A^T: how a least-squares solution answers to its observations."""
    at = transposed(a)
    inverse = mpmath.inverse(mpmath.matrix([[dot(p, q) for q in at] for p in at]))
    return [[dot(list(inverse[i, :]), column) for column in a] for i in range(len(at))]


def condition_of(a: Matrix, *, scaled: bool = True) -> Any:
    """Ratio of the greatest to the least singular value; `scaled`: with columns brought to equal length."""
    lengths = [norm(column) if scaled else mpf(1) for column in transposed(a)]
    equal = [[x / s for x, s in zip(row, lengths, strict=True)] for row in a]
    at = transposed(equal)
    values = mpmath.eigsy(mpmath.matrix([[dot(p, q) for q in at] for p in at]), eigvals_only=True)
    return mpmath.sqrt(max(values) / min(values))


def jacobian(f: Callable[[Vector], Vector], x: Sequence[Any]) -> Matrix:
    """d f / d x by central differences, (rows of f, len(x)); 25 digits and more at 60."""
    step = mpf(10) ** -(mpmath.mp.dps // 3)
    columns = []
    for i in range(len(x)):
        above, below = list(x), list(x)
        above[i], below[i] = x[i] + step, x[i] - step
        columns.append([(p - q) / (2 * step) for p, q in zip(f(above), f(below), strict=True)])
    return transposed(columns)


@dataclass(frozen=True, kw_only=True)
class PixelFit:
    """Points seen by one camera whose R and t in s [u v 1]^T = K (R X + t) depend on unknown parameters."""

    intrinsics: Sequence[Any]
    points: Sequence[Sequence[Any]]
    pixels: Sequence[Sequence[Any]]
    matrices: Callable[[Vector], tuple[Matrix, Vector]]

    def residuals(self, x: Vector) -> Vector:
        """Observed minus projected, u and v of each point."""
        r, t = self.matrices(x)
        return [
            d for w, p in zip(self.pixels, self.points, strict=True) for d in minus(w, seen(self.intrinsics, r, t, p))
        ]

    def design(self, x: Vector) -> Matrix:
        """Derivatives of the pixels: of R and t by central differences (1e-40 at 60 digits), and on by the chain rule."""
        step = mpf(10) ** -(mpmath.mp.dps // 3)
        turned = []
        for i in range(len(x)):
            (r1, t1), (r0, t0) = (self.matrices([v + s * (i == j) for j, v in enumerate(x)]) for s in (step, -step))
            change = [
                [(p - q) / (2 * step) for p, q in zip(a, b, strict=True)]
                for a, b in zip([*r1, t1], [*r0, t0], strict=True)
            ]
            turned.append((change[:3], change[3]))
        r, t = self.matrices(x)
        fx, fy = self.intrinsics[:2]
        rows = []
        for point in self.points:
            p = plus(applied(r, point), t)
            moves = [plus(applied(dr, point), dt) for dr, dt in turned]
            rows += [[fx * (m[0] - p[0] / p[2] * m[2]) / p[2] for m in moves]]
            rows += [[fy * (m[1] - p[1] / p[2] * m[2]) / p[2] for m in moves]]
        return rows

    def solved(self, start: Sequence[Any]) -> Vector:
        """The parameters that minimise the sum of squared residuals, to 1e-38: Gauss-Newton until nothing moves."""
        x = list(start)
        for _ in range(200):
            step = least_squares(self.design(x), self.residuals(x))
            x = plus(x, step)
            if max(abs(s) for s in step) < mpf(10) ** -38:
                return x
        raise ArithmeticError("Gauss-Newton does not converge")

    def condition(self, x: Vector) -> Any:
        """Of the parameters against the observed pixels: greatest over them of sum |dx/dw w| / |x|."""
        observed = [abs(v) for w in self.pixels for v in w]
        gain = pseudo_inverse(self.design(x))
        return max(dot([abs(g) for g in row], observed) / abs(p) for row, p in zip(gain, x, strict=True))


def mean_norm(residuals: Sequence[Any]) -> Any:
    """Mean over points of the norms of (du, dv)."""
    return sum((norm(residuals[i : i + 2]) for i in range(0, len(residuals), 2)), mpf(0)) / (len(residuals) // 2)
