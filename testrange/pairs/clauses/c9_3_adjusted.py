"""9.3.2 d-k: vertices from the planes of a frustum's faces, and the adjustment of camera_from_lidar by (21)-(24)."""

from collections.abc import Sequence
from typing import Any

import mpmath
from mpmath import fsum, mpf, pi

from testrange.pairs.build import Formula, Values, given, pair, quantised
from testrange.pairs.clauses.c9_2 import CORNER, IMAGE_AXES, K_INPUT, OBSERVATIONS, noise
from testrange.pairs.maths import (
    ROTATION_TEXT,
    Matrix,
    PixelFit,
    Vector,
    applied,
    condition_of,
    dot,
    jacobian,
    least_squares,
    mean_norm,
    minus,
    norm,
    plus,
    product,
    radians,
    rotation,
    seen,
    transposed,
)
from testrange.pairs.model import Pair

_NADIR = [[mpf(0), mpf(1), mpf(0)], [mpf(-1), mpf(0), mpf(0)], [mpf(0), mpf(0), mpf(1)]]


def _boresight(v: Values) -> PixelFit:
    return PixelFit(
        intrinsics=v["intrinsics"],
        points=v["points"],
        pixels=v["pixels"],
        matrices=lambda x: (product(_NADIR, rotation(x[:3])), x[3:]),
    )


_SOLVED: dict[int, list[Any]] = {}


def _solved(v: Values) -> list[Any]:
    key = hash((mpmath.mp.prec, str(v)))
    if key not in _SOLVED:
        _SOLVED[key] = _boresight(v).solved([mpf(0), mpf(0), mpf(0), *v["start_translation"]])
    return _SOLVED[key]


def _p_m(v: Values) -> Any:
    return mean_norm(_boresight(v).residuals(_solved(v)))


def _reverse(i: int) -> Formula:
    return lambda v: [*(-x if j == i else x for j, x in enumerate(_solved(v))), _p_m(v)]


def _adjustment(
    name: str,
    k: list[float],
    boresight: list[float],
    t: list[float],
    points: list[list[float]],
    seed: int,
    size: float = 0.25,
    **more: Any,
) -> Pair:
    r = product(_NADIR, rotation(radians([mpf(a) for a in boresight])))
    observed = []
    for i, p in enumerate(points):
        u, w = seen([mpf(x) for x in k], r, [mpf(x) for x in t], [mpf(x) for x in p])
        observed.append(
            [quantised(u + noise(seed + 2 * i, size), 10), quantised(w + noise(seed + 2 * i + 1, size), 10)]
        )
    return pair(
        f"f24_adjusted_{name}",
        "(20)-(24)",
        "9.3.2 f-k",
        f"""Six parameters of s [u v 1]^T = K (R X + t), R = N R(alpha, beta, gamma) with N = [[0,1,0],[-1,0,0],[0,0,1]] (a LiDAR
            with x forward, y right, z down and a camera that looks down), by least squares of the pixels, all of one weight,
            iterated to convergence from zero angles: alpha, beta, gamma [rad], t [m]; then P_m (20) of the residuals' norms.
            {IMAGE_AXES}; {ROTATION_TEXT}.""",
        [
            given(*K_INPUT, k),
            given("points", "m", "X, Y, Z of each vertex by the LiDAR", points),
            given("pixels", "px", "u, v of each mark, without distortion", observed),
            given("start_translation", "m", "t to begin with", [0.0, 0.0, 0.0]),
        ],
        [("alpha", "rad"), ("beta", "rad"), ("gamma", "rad"), ("t_x", "m"), ("t_y", "m"), ("t_z", "m"), ("P_m", "px")],
        lambda v: [*_solved(v), _p_m(v)],
        {
            "sign of roll reversed": _reverse(0),
            "sign of pitch reversed": _reverse(1),
            "sign of yaw reversed": _reverse(2),
            "all angles reversed": lambda v: [*(-x for x in _solved(v)[:3]), *_solved(v)[3:], _p_m(v)],
            "angles in degrees": lambda v: [*(x * 180 / pi for x in _solved(v)[:3]), *_solved(v)[3:], _p_m(v)],
            CORNER: lambda v: (lambda w: [*_solved(w), _p_m(w)])(
                {**v, "pixels": [[a + mpf("0.5") for a in p] for p in v["pixels"]]}
            ),
            "translation in the LiDAR's frame, reversed: dX, dY, dZ": lambda v: [
                *_solved(v)[:3],
                *[-x for x in applied(transposed(product(_NADIR, rotation(_solved(v)[:3]))), _solved(v)[3:])],
                _p_m(v),
            ],
            "first step only, not iterated": lambda v: _first_step(v),
        },
        condition=lambda v: _boresight(v).condition(_solved(v)),
        condition_note=OBSERVATIONS,
        derived_tolerance=True,
        **more,
    )


def _first_step(v: Values) -> list[Any]:
    start = [mpf(0), mpf(0), mpf(0), *v["start_translation"]]
    fit = _boresight(v)
    x = plus(start, least_squares(fit.design(start), fit.residuals(start)))
    return [*x, mean_norm(fit.residuals(x))]


def _vertex(name: str, planes: list[list[float]], without: Sequence[str] = (), **more: Any) -> Pair:
    def solve(v: Values) -> list[Any]:
        return least_squares([row[:3] for row in v["planes"]], [row[3] for row in v["planes"]])

    mistakes: dict[str, Formula] = {
        "sign of d reversed": lambda v: [-x for x in solve(v)],
        "last plane left out": lambda v: solve({"planes": v["planes"][:-1]}),
        "normals not of unit length taken as such": lambda v: solve(
            {"planes": [[x / norm(r[:3]) for x in r[:3]] + [r[3]] for r in v["planes"]]}
        ),
    }
    return pair(
        f"c9_3_2_d_vertex_{name}",
        "9.3.2 d",
        "9.3.2 d",
        """Common vertex of a frustum's faces from the parameters of their planes a x + b y + c z = d, by least squares of
            a x + b y + c z - d, every plane as it is given.""",
        [given("planes", "m", "a, b, c [1] and d [m] of each face", planes)],
        [("x", "m"), ("y", "m"), ("z", "m")],
        solve,
        {k: f for k, f in mistakes.items() if k not in without},
        condition=lambda v: condition_of([row[:3] for row in v["planes"]], scaled=False),
        condition_note="ratio of the singular values of the normals",
        derived_tolerance=True,
        **more,
    )


def _plane(points: Matrix) -> tuple[Vector, Any]:
    """Unit normal n and distance d of the plane n x = d with the least sum of squared orthogonal distances."""
    centre = [fsum(c) / len(points) for c in transposed(points)]
    off = transposed([minus(p, centre) for p in points])
    _, vectors = mpmath.eigsy(mpmath.matrix([[dot(a, b) for b in off] for a in off]))
    normal = [vectors[i, 0] for i in range(3)]
    return normal, dot(normal, centre)


def _faces(v: Values) -> list[Matrix]:
    count = max(int(f) for f in v["face"])
    return [[p for p, f in zip(v["points"], v["face"], strict=True) if int(f) == k + 1] for k in range(count)]


def _by_points(v: Values) -> Vector:
    planes = [_plane(points) for points in _faces(v)]
    return least_squares([n for n, _ in planes], [d for _, d in planes])


def _vertical(v: Values) -> Vector:
    """Planes z = a x + b y + c with vertical residuals."""
    rows, right = [], []
    for points in _faces(v):
        a, b, c = least_squares([[p[0], p[1], mpf(1)] for p in points], [p[2] for p in points])
        length = mpmath.sqrt(a * a + b * b + 1)
        rows.append([-a / length, -b / length, 1 / length])
        right.append(c / length)
    return least_squares(rows, right)


def _vertex_from_points(name: str, half_width: float, **more: Any) -> Pair:
    """Six points on each inner face of a funnel, rim 0.5 m, in a band of `half_width` along the slope, with 2 mm of noise."""
    points, face = [], []
    at = [mpf("0.0078125"), mpf("-0.005859375"), mpf("0.00390625")]
    for k, (ax, ay) in enumerate(((0, 1), (1, 0), (0, -1), (-1, 0))):
        for i in range(6):
            run = mpf("0.1875") + half_width * (2 * (i % 3) - 2) / 2
            along = mpf("0.03125") * (2 * (i // 3) - 1) + mpf("0.0078125") * (i % 3)
            off = noise(6 * k + i, 0.002)
            x, y = ax * run + ay * along, ay * run - ax * along
            z = mpmath.sqrt(2) * run + off
            points.append([round(float(c), 9) for c in plus([x, y, z], at)])
            face.append(k + 1)
    return pair(
        f"c9_3_2_d_points_{name}",
        "9.3.2 d",
        "9.3.2 d",
        """Common vertex of a frustum's faces from the points on them: for each face the plane with the least sum of squared
            orthogonal distances, then the point with the least sum of squared distances to the four planes.""",
        [
            given("points", "m", "x, y, z of each return, z up", points),
            given("face", "1", "face of each point, from 1", face),
        ],
        [("x", "m"), ("y", "m"), ("z", "m")],
        _by_points,
        {
            "vertical in place of orthogonal residuals": _vertical,
            "z reversed": lambda v: [*_by_points(v)[:2], -_by_points(v)[2]],
            "last face left out": lambda v: _by_points(
                {
                    "points": [p for p, f in zip(v["points"], v["face"], strict=True) if f < 4],
                    "face": [f for f in v["face"] if f < 4],
                }
            ),
        },
        condition=lambda v: _point_condition(v),
        condition_note="of the vertex against the points: sum of |dx/dp p| / |x|",
        derived_tolerance=True,
        **more,
    )


def _point_condition(v: Values) -> Any:
    flat = [c for p in v["points"] for c in p]
    found = _by_points(v)

    def of(x: Vector) -> Vector:
        return _by_points({**v, "points": [x[i : i + 3] for i in range(0, len(x), 3)]})

    return max(
        dot([abs(g) for g in row], [abs(c) for c in flat]) / abs(value)
        for row, value in zip(jacobian(of, flat), found, strict=True)
    )


def pairs() -> list[Pair]:
    k = [3000.0, 3002.5, 2001.25, 1498.75]
    field = [
        [6.5 * x + 0.5 * y, 7.25 * y - 0.25 * x, 40.0 + 3.5 * ((2 * x + 3 * y) % 5)]
        for x in (-2, -1, 0, 1, 2)
        for y in (-1.5, -0.5, 0.5, 1.5)
    ]
    flat = [
        [4.0 * x, 3.0 * y, quantised(55 + noise(7 * x + 3 * y + 20, 0.25), 8)] for x in (-1, 0, 1) for y in (-1, 0, 1)
    ]
    narrow = [
        [x, 0.75 * y, quantised(55 + noise(7 * int(x) + 3 * y + 20, 0.0625), 8)]
        for x in (-1.0, 0.0, 1.0)
        for y in (-1, 0, 1)
    ]
    sheets = [
        [1.0, 0.0, 0.703125, 0.5],
        [-1.0, 0.015625, 0.71875, -0.25],
        [0.0, 1.0, 0.7109375, 0.375],
        [0.0078125, -1.0, 0.6953125, 0.125],
    ]
    tilt = 1e-5
    thin = [
        [0.0, 0.0, 1.0, 2.0],
        [tilt, 0.0, 1.0, round(2.0 + 1.5 * tilt, 9)],
        [0.0, tilt, 1.0, round(2.0 - 0.8125 * tilt, 9)],
        [-tilt, tilt, 1.0, round(2.0 - 2.25 * tilt, 9)],
    ]
    return [
        _adjustment("twenty_targets", k, [0.75, -1.25, 0.5], [0.125, -0.25, 0.0625], field, 0),
        _adjustment("weak_geometry", k, [0.5, -0.75, 1.0], [0.125, -0.25, 0.5], flat, 40, kind="ill_conditioned"),
        _adjustment(
            "narrow_field", k, [0.5, -0.75, 1.0], [0.25, -0.5, 0.5], narrow, 60, 2.0**-7, kind="ill_conditioned"
        ),
        _vertex_from_points("funnel", 0.03125),
        _vertex_from_points("narrow_band", 0.00390625, kind="ill_conditioned"),
        _vertex("four_faces", sheets),
        _vertex("nearly_parallel", thin, ("normals not of unit length taken as such",), kind="ill_conditioned"),
    ]
