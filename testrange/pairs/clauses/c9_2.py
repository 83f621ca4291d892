"""9.2.1, formulas (16)-(19): projection, pose by least reprojection error, mean reprojection error; and the lens of 9.2.2 e-g."""

from collections.abc import Sequence
from typing import Any

import mpmath
from mpmath import fsum, mpf, sqrt

from testrange.pairs.build import Formula, Values, given, pair, quantised
from testrange.pairs.maths import (
    ROTATION_TEXT,
    PixelFit,
    applied,
    distorted,
    dot,
    mean_norm,
    minus,
    norm,
    plus,
    radians,
    rotation,
    seen,
    wrong_rotations,
)
from testrange.pairs.model import Pair

IMAGE_AXES = (
    "image axes: u to the right, v down, origin at the image's top left corner, the first pixel's centre at (0.5, 0.5)"
)
K_INPUT = ("intrinsics", "px", "fx, fy, cx, cy of K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
CORNER = "pixel centre at (0, 0): half a pixel too little"


def pixels(uv: Sequence[Sequence[Any]], shift: Any = 0) -> list[Any]:
    return [x + shift for point in uv for x in point]


def names(n: int) -> list[tuple[str, str]]:
    return [(f"{axis}_{i + 1}", "px") for i in range(n) for axis in "uv"]


def projection_mistakes(k: str, angles: str, translation: str, points: str) -> dict[str, Formula]:
    """Known mistakes of s [u v 1]^T = K (R X + t) from angles in degrees."""

    def all_seen(
        v: Values, r: Any, *, intrinsics: Any = None, t: Any = None, sign: tuple[int, int] = (1, 1)
    ) -> list[Any]:
        matrix = v[k] if intrinsics is None else intrinsics
        out = []
        for x in v[points]:
            u, w = seen(matrix, r, v[translation] if t is None else t, x)
            out += [matrix[2] + sign[0] * (u - matrix[2]), matrix[3] + sign[1] * (w - matrix[3])]
        return out

    def turned(name: str) -> Formula:
        return lambda v: all_seen(v, wrong_rotations(v[angles])[name])

    def right(v: Values) -> Any:
        return rotation(radians(v[angles]))

    return {
        **{
            name: turned(name)
            for name in (
                "sign of roll reversed",
                "sign of pitch reversed",
                "sign of yaw reversed",
                "transpose of the rotation",
                "order of the turns reversed: Rx Ry Rz",
            )
        },
        "degrees taken as radians": turned("degrees taken as radians"),
        CORNER: lambda v: [x - mpf("0.5") for x in all_seen(v, right(v))],
        "half a pixel too much": lambda v: [x + mpf("0.5") for x in all_seen(v, right(v))],
        "principal point left out": lambda v: all_seen(v, right(v), intrinsics=[*v[k][:2], mpf(0), mpf(0)]),
        "-f: image turned by half a turn": lambda v: all_seen(v, right(v), sign=(-1, -1)),
        "v upwards": lambda v: all_seen(v, right(v), sign=(1, -1)),
        "fx and fy exchanged": lambda v: all_seen(v, right(v), intrinsics=[v[k][1], v[k][0], *v[k][2:]]),
        "t taken as the camera's place: R (X - t)": lambda v: all_seen(
            v, right(v), t=[-x for x in applied(right(v), v[translation])]
        ),
        "not divided by the depth": lambda v: [
            value for x in v[points] for value in _undivided(v[k], right(v), v[translation], x)
        ],
    }


def _undivided(k: Any, r: Any, t: Any, x: Any) -> list[Any]:
    p = plus(applied(r, x), t)
    return [k[0] * p[0] + k[2] * p[2], k[1] * p[1] + k[3] * p[2]]


def _board(columns: int, rows: int, square: float) -> list[list[float]]:
    return [[square * i, square * j, 0.0] for j in range(rows) for i in range(columns)]


def _project(
    id: str,
    formula: str,
    k: list[float],
    angles: list[float],
    t: list[float],
    points: list[list[float]],
    without: Sequence[str] = (),
    **more: Any,
) -> Pair:
    mistakes = projection_mistakes("intrinsics", "angles", "translation", "points")
    return pair(
        id,
        formula,
        "9.2.1 a" if formula == "(16)" else "9.2.1 b",
        f"""World points to pixels: s [u v 1]^T = K (R X + t); {IMAGE_AXES}; camera axes x right, y down, z forward;
            {ROTATION_TEXT}. Results are u and v of each point in order; no distortion.""",
        [
            given(*K_INPUT, k),
            given("angles", "deg", "roll, pitch, yaw of R", angles),
            given("translation", "m", "t", t),
            given("points", "m", "X, Y, Z of each point in the world", points),
        ],
        names(len(points)),
        lambda v: [
            x for p in v["points"] for x in seen(v["intrinsics"], rotation(radians(v["angles"])), v["translation"], p)
        ],
        {name: f for name, f in mistakes.items() if name not in without},
        derived_tolerance=True,
        **more,
    )


def _fit(v: Values) -> PixelFit:
    """(18) as a function of roll, pitch, yaw [rad] and t."""
    return PixelFit(
        intrinsics=v["intrinsics"], points=v["points"], pixels=v["pixels"], matrices=lambda x: (rotation(x[:3]), x[3:])
    )


def _start(v: Values) -> list[Any]:
    return [*radians(v["start_angles"]), *v["start_translation"]]


_POSES: dict[int, list[Any]] = {}


def _pose(v: Values) -> list[Any]:
    """xi of (18), computed once for each set of inputs."""
    key = hash((mpmath.mp.prec, str(v)))
    if key not in _POSES:
        _POSES[key] = _fit(v).solved(_start(v))
    return _POSES[key]


OBSERVATIONS = (
    "of the parameters against the observed pixels, through the design's pseudo-inverse: sum of |dx/dw w| / |x|"
)


def _pose_pairs(
    name: str, k: list[float], angles: list[float], t: list[float], points: list[list[float]], seed: int, **more: Any
) -> list[Pair]:
    observed = _observed(k, angles, t, points, seed)
    inputs = [
        given(*K_INPUT, k),
        given("points", "m", "X, Y, Z of each point", points),
        given("pixels", "px", "observed u, v of each point, without distortion", observed),
        given("start_angles", "deg", "roll, pitch, yaw to begin with", [float(round(a)) for a in angles]),
        given("start_translation", "m", "t to begin with", [quantised(x, 4) for x in t]),
    ]

    def first(v: Values, r: Any) -> list[Any]:
        x = _pose(v)
        return [*_angles_of(r(x)), *x[3:]]

    pose = pair(
        f"f18_{name}",
        "(18)",
        "9.2.1 c",
        f"""Pose of the camera that minimises half the sum of squared reprojection errors, every point with the same weight: roll,
            pitch, yaw [rad] of R and t of s [u v 1]^T = K (R X + t); {IMAGE_AXES}; {ROTATION_TEXT}.""",
        inputs,
        [("roll", "rad"), ("pitch", "rad"), ("yaw", "rad"), ("t_x", "m"), ("t_y", "m"), ("t_z", "m")],
        _pose,
        {
            "angles in degrees": lambda v: [*(x * 180 / mpmath.pi for x in _pose(v)[:3]), *_pose(v)[3:]],
            CORNER: lambda v: _pose({**v, "pixels": [[a + mpf("0.5") for a in w] for w in v["pixels"]]}),
            "world from camera in place of camera from world": lambda v: [
                *_angles_of(_transpose(rotation(_pose(v)[:3]))),
                *[-x for x in applied(_transpose(rotation(_pose(v)[:3])), _pose(v)[3:])],
            ],
            "transpose of the rotation": lambda v: first(v, lambda x: _transpose(rotation(x[:3]))),
            "start values, not adjusted": _start,
        },
        condition=lambda v: _fit(v).condition(_pose(v)),
        condition_note=OBSERVATIONS,
        derived_tolerance=True,
        **more,
    )
    error = pair(
        f"f19_{name}",
        "(16)-(19)",
        "9.2.1 d",
        """M_z, the mean of the norms of the reprojection errors at the pose that minimises (18), as in the pair f18 of that
            name.""",
        inputs,
        [("M_z", "px")],
        lambda v: mean_norm(_fit(v).residuals(_pose(v))),
        {
            "root mean square in place of the mean of norms": lambda v: _rms(_fit(v).residuals(_pose(v))),
            "at the start values, not minimised": lambda v: mean_norm(_fit(v).residuals(_start(v))),
            "half a pixel between observed and projected": lambda v: mean_norm(
                [r + mpf("0.5") for r in _fit(v).residuals(_pose(v))]
            ),
            "per coordinate, not per point": lambda v: mean_norm(_fit(v).residuals(_pose(v))) / 2,
        },
        condition=lambda v: max(abs(x) for w in v["pixels"] for x in w) / mean_norm(_fit(v).residuals(_pose(v))),
        condition_note="greatest pixel coordinate over M_z: what a rounding of a coordinate is to the residuals",
        derived_tolerance=True,
        **more,
    )
    return [pose, error]


def _transpose(m: Any) -> Any:
    return [list(c) for c in zip(*m, strict=True)]


def _angles_of(m: Any) -> list[Any]:
    return [
        mpmath.atan2(m[2][1], m[2][2]),
        mpmath.atan2(-m[2][0], sqrt(m[2][1] ** 2 + m[2][2] ** 2)),
        mpmath.atan2(m[1][0], m[0][0]),
    ]


def _rms(residuals: Sequence[Any]) -> Any:
    return sqrt(dot(residuals, residuals) / (len(residuals) // 2))


_DIGITS = "31415926535897932384626433832795028841971693993751058209749445923078164062862089986280348253421170679"


def noise(i: int, size: float) -> float:
    """The digits of pi as noise between -size and size."""
    return size * (int(_DIGITS[i % len(_DIGITS)]) - 4.5) / 4.5


def _observed(
    k: list[float],
    angles: list[float],
    t: list[float],
    points: list[list[float]],
    seed: int,
    d: Sequence[float] = (0, 0, 0, 0, 0),
    size: float = 0.25,
) -> list[list[float]]:
    """Pixels with noise, to 2^-10 px."""
    r = rotation(radians([mpf(a) for a in angles]))
    out = []
    for i, p in enumerate(points):
        q = plus(applied(r, [mpf(x) for x in p]), t)
        x, y = distorted([mpf(c) for c in d], q[0] / q[2], q[1] / q[2])
        u, w = k[0] * x + k[2], k[1] * y + k[3]
        out.append([quantised(u + noise(seed + 2 * i, size), 10), quantised(w + noise(seed + 2 * i + 1, size), 10)])
    return out


def _nineteen(
    name: str, projected: list[list[float]], observed: list[list[float]], without: Sequence[str] = (), **more: Any
) -> Pair:
    def off(v: Values) -> list[Any]:
        return [d for a, b in zip(v["observed"], v["projected"], strict=True) for d in minus(a, b)]

    mistakes: dict[str, Formula] = {
        "root mean square in place of the mean of norms": lambda v: _rms(off(v)),
        "mean of |du| + |dv|": lambda v: fsum([abs(x) for x in off(v)]) / len(v["observed"]),
        "mean of squares": lambda v: dot(off(v), off(v)) / len(v["observed"]),
        "per coordinate, not per point": lambda v: mean_norm(off(v)) / 2,
        "sum, not divided by n": lambda v: mean_norm(off(v)) * len(v["observed"]),
        "norm of the mean residual": lambda v: norm(
            [fsum(off(v)[0::2]) / len(v["observed"]), fsum(off(v)[1::2]) / len(v["observed"])]
        ),
    }
    return pair(
        f"f19_norms_{name}",
        "(19)",
        "9.2.1 d",
        "M_z: mean over all points of the norm of observed minus projected pixel.",
        [
            given("observed", "px", "observed u, v, distortion removed", observed),
            given("projected", "px", "projected u, v", projected),
        ],
        [("M_z", "px")],
        lambda v: mean_norm(off(v)),
        {key: f for key, f in mistakes.items() if key not in without},
        derived_tolerance=True,
        **more,
    )


def pairs() -> list[Pair]:
    k = [3000.0, 3002.5, 2001.25, 1498.75]
    tele = [16000.0, 16000.0, 2000.0, 1500.0]
    angles, t = [12.5, -7.25, 31.75], [-0.25, 0.125, 2.75]
    cloud = [[0.5, -0.25, 0.75], [-0.625, 0.375, -0.5], [0.875, 0.5, 1.25], [-0.125, -0.75, 0.25]]
    board = _board(5, 4, 0.0625)
    far = [[x, y, 0.0] for x, y, _ in _board(4, 3, 0.03125)]
    # a thousandth of a metre before the lens: the depth is a small difference of turned coordinates
    depth = applied(rotation(radians([mpf(a) for a in angles])), [mpf(x) for x in cloud[0]])[2]
    close = [0.125, -0.0625, round(float(mpf("0.001") - depth), 7)]
    observed = _observed(k, angles, t, cloud, 7)
    projected = _observed(k, angles, t, cloud, 0, size=0.0)
    return [
        _project("f16_one_point", "(16)", k, angles, t, cloud[:1]),
        _project("f17_points", "(17)", k, angles, t, cloud),
        _project(
            "f16_no_turn", "(16)", k, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [[1.5, -2.25, 8.0]], _UPRIGHT, kind="boundary"
        ),
        _project("f16_near_the_lens", "(16)", k, angles, close, cloud[:1], kind="ill_conditioned"),
        *_pose_pairs("board", k, [20.0, -15.0, 5.0], [-0.125, -0.0625, 0.875], board, 3),
        *_pose_pairs("cloud", k, angles, t, [*cloud, [0.25, 0.625, -0.375], [-0.5, -0.5, 1.0]], 11),
        *_pose_pairs("far_small_board", tele, [2.0, -3.0, 4.0], [0.125, -0.0625, 12.0], far, 5, kind="ill_conditioned"),
        _nineteen("four", projected, observed),
        _nineteen("one_point", [[3.0, 4.0]], [[6.0, 8.0]], _OF_ONE, kind="boundary"),
    ]


_UPRIGHT = (  # where nothing turns and nothing moves these change nothing
    "sign of roll reversed",
    "sign of pitch reversed",
    "sign of yaw reversed",
    "transpose of the rotation",
    "order of the turns reversed: Rx Ry Rz",
    "degrees taken as radians",
    "t taken as the camera's place: R (X - t)",
)
_OF_ONE = ("root mean square in place of the mean of norms", "sum, not divided by n", "norm of the mean residual")
