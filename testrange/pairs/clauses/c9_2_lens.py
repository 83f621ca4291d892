"""9.2.2 e-g: the lens. Removal of the distortion; and focal lengths, principal point, distortion and poses by least squares."""

from typing import Any

from testrange.pairs.build import Values, given, pair
from testrange.pairs.clauses.c9_2 import K_INPUT, names, pixels
from testrange.pairs.maths import distorted, undistorted
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


def pairs() -> list[Pair]:
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
