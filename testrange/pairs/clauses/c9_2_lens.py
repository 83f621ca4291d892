"""9.2.2 e-g: the lens. Removal of the distortion; and focal lengths, principal point, distortion and poses by least squares."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
from mpmath import mpf

from testrange.pairs.build import Values, given, pair, quantised
from testrange.pairs.clauses.c9_2 import CORNER, IMAGE_AXES, K_INPUT, names, noise, pixels
from testrange.pairs.maths import (
    ROTATION_TEXT,
    Matrix,
    Vector,
    applied,
    distorted,
    dot,
    jacobian,
    mean_norm,
    minus,
    plus,
    pseudo_inverse,
    radians,
    rotation,
    transposed,
    undistorted,
)
from testrange.pairs.model import Pair


def _undistort(v: Values) -> list[Any]:
    fx, fy, cx, cy = v["intrinsics"]
    out = []
    for u, w in v["pixels"]:
        x, y = undistorted(v["distortion"], (u - cx) / fx, (w - cy) / fy)
        out += [fx * x + cx, fy * y + cy]
    return out


def _redistort(v: Values, d: Any) -> list[Any]:
    fx, fy, cx, cy = v["intrinsics"]
    out = []
    for u, w in v["pixels"]:
        x, y = distorted(d, (u - cx) / fx, (w - cy) / fy)
        out += [fx * x + cx, fy * y + cy]
    return out


@dataclass(frozen=True)
class _Calibration:
    """One lens, k images of a plane board, as a function of fx fy cx cy k1 k2 k3 p1 p2 and of each image's six."""

    board: Matrix
    images: Sequence[Matrix]

    def of_image(self, i: int, lens: Vector, pose: Vector) -> Vector:
        """Pixels of one image, u and v of each corner."""
        r, t = rotation(pose[:3]), pose[3:]
        out = []
        for corner in self.board:
            p = plus(applied(r, corner), t)
            x, y = distorted(lens[4:], p[0] / p[2], p[1] / p[2])
            out += [lens[0] * x + lens[2], lens[1] * y + lens[3]]
        return out

    def residuals(self, i: int, x: Vector) -> Vector:
        observed = [c for w in self.images[i] for c in w]
        return minus(observed, self.of_image(i, x[:9], x[9 + 6 * i : 15 + 6 * i]))

    def solved(self, start: Vector) -> Vector:
        """Gauss-Newton until nothing moves by more than 1e-36 of its size; an image's pose concerns that image alone."""
        x, size = list(start), len(start)
        for _ in range(200):
            normal, right = mpmath.zeros(size), mpmath.zeros(size, 1)
            for i in range(len(self.images)):
                at = [*range(9), *range(9 + 6 * i, 15 + 6 * i)]
                design = transposed(jacobian(lambda p, i=i: self.of_image(i, p[:9], p[9:]), [x[j] for j in at]))  # type: ignore[misc]
                off = self.residuals(i, x)
                for a, row in zip(at, design, strict=True):
                    right[a] += dot(row, off)
                    for b, other in zip(at, design, strict=True):
                        if b <= a:
                            normal[a, b] += dot(row, other)
            for a in range(size):
                for b in range(a):
                    normal[b, a] = normal[a, b]
            step = list(mpmath.lu_solve(normal, right))
            x = plus(x, step)
            if max(abs(s / v) for s, v in zip(step, x, strict=True)) < mpf(10) ** -36:
                return x
        raise ArithmeticError("the calibration does not converge")

    def gain(self, x: Vector) -> Matrix:
        """How the nine of the lens answer to the pixels: rows of the pseudo-inverse."""
        rows = []
        for i in range(len(self.images)):
            at = [*range(9), *range(9 + 6 * i, 15 + 6 * i)]
            for row in jacobian(lambda p, i=i: self.of_image(i, p[:9], p[9:]), [x[j] for j in at]):  # type: ignore[misc]
                full = [mpf(0)] * len(x)
                for j, value in zip(at, row, strict=True):
                    full[j] = value
                rows.append(full)
        return pseudo_inverse(rows)[:9]


_CALIBRATED: dict[int, Vector] = {}


def _calibration(v: Values) -> _Calibration:
    n = len(v["board"])
    return _Calibration(v["board"], [v["pixels"][i : i + n] for i in range(0, len(v["pixels"]), n)])


def _calibrated(v: Values) -> Vector:
    """The solution, and M_z as its last."""
    key = hash((mpmath.mp.prec, str(v)))
    if key not in _CALIBRATED:
        start = [*v["start_lens"]]
        for pose in v["start_poses"]:
            start += [*radians(pose[:3]), *pose[3:]]
        x = _calibration(v).solved(start)
        _CALIBRATED[key] = [*x, _m_z(v, x)]
    return _CALIBRATED[key]


def _m_z(v: Values, x: Vector) -> Any:
    """Mean over all corners of undistorted observation minus ideal projection."""
    calibration, lens = _calibration(v), x[:9]
    ideal = [*lens[:4], *[mpf(0)] * 5]
    off = []
    for i, image in enumerate(calibration.images):
        observed = _undistort({"intrinsics": lens[:4], "distortion": lens[4:], "pixels": image})
        off += minus(observed, calibration.of_image(i, ideal, x[9 + 6 * i : 15 + 6 * i]))
    return mean_norm(off)


def _lens_condition(v: Values) -> Any:
    x = _calibrated(v)[:-1]
    observed = [abs(c) for w in v["pixels"] for c in w]
    return max(
        dot([abs(g) for g in row], observed) / abs(value)
        for row, value in zip(_calibration(v).gain(x), x[:9], strict=True)
    )


def _calibration_pair() -> Pair:
    lens = [1200.0, 1202.5, 801.25, 598.75, -0.125, 0.09375, -0.03125, 0.001953125, -0.0009765625]
    board = [[0.0625 * i, 0.0625 * j, 0.0] for j in range(3) for i in range(4)]
    poses = [
        [25.0, 10.0, 2.0, -0.125, -0.09375, 0.3125],
        [-20.0, 15.0, -3.0, -0.1875, -0.0625, 0.34375],
        [10.0, -25.0, 88.0, 0.09375, -0.125, 0.375],
        [-15.0, -20.0, 178.0, 0.125, 0.125, 0.28125],
    ]
    calibration = _Calibration([[mpf(c) for c in p] for p in board], [[]] * len(poses))
    pixels = []
    for i, pose in enumerate(poses):
        exact = calibration.of_image(i, [mpf(c) for c in lens], [*radians([mpf(a) for a in pose[:3]]), *pose[3:]])
        noisy = [quantised(c + noise(23 * i + j, 0.015625), 10) for j, c in enumerate(exact)]
        pixels += [noisy[j : j + 2] for j in range(0, len(noisy), 2)]
    return pair(
        "c9_2_2_f_calibration",
        "9.2.2 e-g",
        "9.2.2 e-h",
        f"""Camera from four images of a plane board: fx, fy, cx, cy, k1, k2, k3, p1, p2 that, with a pose for each image,
            minimise the sum of squared differences of observed and projected, distorted pixels, every corner with the same weight;
            then M_z of (19): the mean norm of undistorted observation minus projection without distortion. Lens as in the pair of
            9.2.2 g; {IMAGE_AXES}; {ROTATION_TEXT}.""",
        [
            given("board", "m", "X, Y, Z of each corner, the same in every image", board),
            given("pixels", "px", "observed u, v: all corners of image 1, then of image 2, ...", pixels),
            given("start_lens", "px, 1", "lens to begin with, in the order of the results", lens),
            given(
                "start_poses",
                "deg, m",
                "roll, pitch, yaw and t of each image to begin with: s [u v 1]^T = K (R X + t)",
                poses,
            ),
        ],
        [
            *((n, "px") for n in ("fx", "fy", "cx", "cy")),
            *((n, "1") for n in ("k1", "k2", "k3", "p1", "p2")),
            ("M_z", "px"),
        ],
        lambda v: [*_calibrated(v)[:9], _calibrated(v)[-1]],
        {
            CORNER: lambda v: [
                *_calibrated(v)[:2],
                *(c - mpf("0.5") for c in _calibrated(v)[2:4]),
                *_calibrated(v)[4:9],
                _calibrated(v)[-1],
            ],
            "p1 and p2 exchanged": lambda v: [
                *_calibrated(v)[:7],
                _calibrated(v)[8],
                _calibrated(v)[7],
                _calibrated(v)[-1],
            ],
            "coefficients in the order k1 k2 p1 p2 k3": lambda v: [
                *_calibrated(v)[:6],
                *_calibrated(v)[7:9],
                _calibrated(v)[6],
                _calibrated(v)[-1],
            ],
        },
        condition=_lens_condition,
        condition_note="of the lens against the observed pixels, through the design's pseudo-inverse: sum of |dx/dw w| / |x|",
        derived_tolerance=True,
    )


def pairs() -> list[Pair]:
    return [*_undistorted_pairs(), _calibration_pair()]


def _undistorted_pairs() -> list[Pair]:
    k = [3000.0, 3002.5, 2001.25, 1498.75]
    d = [-0.0625, 0.03125, -0.0078125, 0.0009765625, -0.00048828125]
    uv = [[3800.5, 2750.25], [120.75, 95.5], [2400.0, 300.125]]
    return [
        pair(
            "c9_2_2_g_undistorted",
            "9.2.2 g",
            "9.2.2 g",
            """Distortion removed: pixels of the ideal camera with the same K. x_d = x (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p1 x y
                + p2 (r2 + 2 x^2), y_d = y (...) + p1 (r2 + 2 y^2) + 2 p2 x y, u = fx x_d + cx,
                v = fy y_d + cy; solved for x, y.""",
            [
                given(*K_INPUT, k),
                given("distortion", "1", "k1, k2, k3, p1, p2", d),
                given("pixels", "px", "observed u, v", uv),
            ],
            names(len(uv)),
            _undistort,
            {
                "distorted once more": lambda v: _redistort(v, v["distortion"]),
                "distorted with the signs reversed": lambda v: _redistort(v, [-x for x in v["distortion"]]),
                "coefficients in the order k1 k2 p1 p2 k3": lambda v: _undistort(
                    {**v, "distortion": [*v["distortion"][:2], *v["distortion"][3:], v["distortion"][2]]}
                ),
                "p1 and p2 exchanged": lambda v: _undistort(
                    {**v, "distortion": [*v["distortion"][:3], v["distortion"][4], v["distortion"][3]]}
                ),
                "left as it is": lambda v: pixels(v["pixels"]),
            },
        )
    ]
