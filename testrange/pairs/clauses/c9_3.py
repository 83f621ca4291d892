"""9.3, formulas (20)-(24) one by one: mean calibration error, rotation, collinearity, its linear form, projection.

Their adjustment, and the vertices that it takes: `c9_3_adjusted`.
"""

from collections.abc import Sequence
from typing import Any

from mpmath import fsum, mpf, pi, sqrt

from testrange.pairs.build import Formula, Values, given, pair
from testrange.pairs.clauses.c9_2 import (
    IMAGE_AXES,
    K_INPUT,
    names,
    projection_mistakes,
)
from testrange.pairs.maths import (
    ROTATION_TEXT,
    applied,
    dot,
    jacobian,
    minus,
    norm,
    radians,
    rotation,
    seen,
    transposed,
    wrong_rotations,
)
from testrange.pairs.model import Pair
from testrange.pairs.tables import B2

_ANGLES = ("angles", "deg", "alpha, beta, gamma: roll, pitch, yaw of R_LC")


def _twenty(name: str, errors: Sequence[float], without: Sequence[str] = (), **more: Any) -> Pair:
    def mean(v: Values) -> Any:
        return fsum(v["errors"]) / len(v["errors"])

    mistakes: dict[str, Formula] = {
        "root mean square in place of the mean": lambda v: sqrt(dot(v["errors"], v["errors"]) / len(v["errors"])),
        "n-1 in place of n": lambda v: fsum(v["errors"]) / (len(v["errors"]) - 1),
        "sum, not divided by n": lambda v: fsum(v["errors"]),
        "median": lambda v: (
            (sorted(v["errors"])[(len(v["errors"]) - 1) // 2] + sorted(v["errors"])[len(v["errors"]) // 2]) / 2
        ),
    }
    return pair(
        f"f20_{name}",
        "(20)",
        "9.3.1",
        "P_m: arithmetic mean of the calibration errors P_i of n targets.",
        [given("errors", "px", "P_i of each target", list(errors))],
        [("P_m", "px")],
        mean,
        {k: f for k, f in mistakes.items() if k not in without},
        **more,
    )


def _b2() -> Pair:
    def off(v: Values) -> list[Any]:
        return [norm(minus(a, b)) for a, b in zip(v["projected"], v["observed"], strict=True)]

    return pair(
        "f20_b2_coordinates",
        "(20)",
        "9.3.2 j-k",
        "P_m from coordinates: P_i is the distance of projected and observed pixel of target i, P_m the mean of the P_i.",
        [
            given("projected", "px", "u, v of each target by the LiDAR", [list(r[4:6]) for r in B2]),
            given("observed", "px", "u, v of the same target by the camera", [list(r[6:8]) for r in B2]),
        ],
        [("P_m", "px")],
        lambda v: fsum(off(v)) / len(B2),
        {
            "appendix B.2's printed column P_i, not its coordinates": lambda v: (
                fsum([mpf(repr(r[8])) for r in B2]) / len(B2)
            ),
            "root mean square in place of the mean": lambda v: sqrt(dot(off(v), off(v)) / len(B2)),
            "mean of |du| + |dv|": lambda v: (
                fsum([abs(x) for a, b in zip(v["projected"], v["observed"], strict=True) for x in minus(a, b)])
                / len(B2)
            ),
        },
        kind="published",
        published="appendix B.2 prints 0.349 px; its own coordinates give 1.698 px: rows 10 and 15 are misprints",
    )


def _rotation(name: str, angles: list[float], without: Sequence[str] = (), **more: Any) -> Pair:
    wrong = (
        "sign of roll reversed",
        "sign of pitch reversed",
        "sign of yaw reversed",
        "transpose of the rotation",
        "order of the turns reversed: Rx Ry Rz",
        "degrees taken as radians",
        "roll and pitch exchanged",
    )

    def turned(key: str) -> Formula:
        return lambda v: wrong_rotations(v["angles"])[key]

    return pair(
        f"f21_{name}",
        "(21)",
        "9.3.2 f",
        f"Rotation R_LC(alpha, beta, gamma), row by row: {ROTATION_TEXT}.",
        [given(*_ANGLES, angles)],
        [(f"{row}{column}", "1") for row in "abc" for column in (1, 2, 3)],
        lambda v: rotation(radians(v["angles"])),
        {key: turned(key) for key in wrong if key not in without},
        scale=[1.0],
        tolerance_why="of 1, the length of the matrix's rows",
        **more,
    )


def _photo(f: Any, r: Any, d: Sequence[Any], x: Sequence[Any]) -> list[Any]:
    """(22): with the columns of R_LC, and -f."""
    p = applied(transposed(r), minus(x, d))
    return [-f * p[0] / p[2], -f * p[1] / p[2]]


def _collinear(v: Values, r: Any = None) -> list[Any]:
    r = rotation(radians(v["angles"])) if r is None else r
    return [c for x in v["points"] for c in _photo(v["focal"], r, v["offset"], x)]


def _turned(key: str) -> Formula:
    return lambda v: _collinear(v, wrong_rotations(v["angles"])[key])


_COLLINEAR_INPUTS = (
    ("focal", "px", "principal distance f"),
    _ANGLES,
    ("offset", "m", "dX, dY, dZ: origin of the camera in the LiDAR's frame"),
    ("points", "m", "X_L, Y_L, Z_L of each vertex"),
)


def _twenty_two(
    name: str, focal: float, angles: list[float], offset: list[float], points: list[list[float]], **more: Any
) -> Pair:
    return pair(
        f"f22_{name}",
        "(22)",
        "9.3.2 g",
        f"""Collinearity in photo axes, as printed: x_c = -f (a1 (X_L - dX) + b1 (Y_L - dY) + c1 (Z_L - dZ)) / (a3 (X_L - dX) +
            b3 (Y_L - dY) + c3 (Z_L - dZ)), y_c with a2, b2, c2 above; a, b, c are the rows of R_LC; {ROTATION_TEXT}. Results: x_c
            and y_c of each point in order.""",
        [given(*head, x) for head, x in zip(_COLLINEAR_INPUTS, (focal, angles, offset, points), strict=True)],
        [(f"{axis}_{i + 1}", "px") for i in range(len(points)) for axis in "xy"],
        _collinear,
        {
            "sign of roll reversed": _turned("sign of roll reversed"),
            "sign of pitch reversed": _turned("sign of pitch reversed"),
            "sign of yaw reversed": _turned("sign of yaw reversed"),
            "transpose of the rotation": _turned("transpose of the rotation"),
            "degrees taken as radians": _turned("degrees taken as radians"),
            "+f in place of -f": lambda v: [-x for x in _collinear(v)],
            "y downwards": lambda v: [x * (-1) ** i for i, x in enumerate(_collinear(v))],
            "offset added": lambda v: _collinear({**v, "offset": [-x for x in v["offset"]]}),
            "offset left out": lambda v: _collinear({**v, "offset": [mpf(0)] * 3}),
        },
        derived_tolerance=True,
        **more,
    )


def _linear(v: Values) -> list[Any]:
    """C_1 ... C_6 of x, of y, then L of both."""
    start = [*v["offset"], *radians(v["angles"])]

    def of(x: Sequence[Any]) -> list[Any]:
        return _photo(v["focal"], rotation(x[3:]), x[:3], v["point"])

    rows = jacobian(of, start)
    return [*rows[0], *rows[1], *minus(of(start), v["observed"])]


def _with(v: Values, change: Any) -> list[Any]:
    c = _linear(v)
    return [change(i, x) for i, x in enumerate(c)]


def _twenty_three(
    name: str, focal: float, angles: list[float], offset: list[float], point: list[float], observed: list[float]
) -> Pair:
    return pair(
        f"f23_{name}",
        "(23)",
        "9.3.2 h",
        f"""Error equations of (22) about the given values, V = C_1 ddX + C_2 ddY + C_3 ddZ + C_4 dalpha + C_5 dbeta + C_6 dgamma
            + L: C are the derivatives of x_c and y_c (angles in radians), L is computed minus observed; {ROTATION_TEXT}.""",
        [
            *(given(*head, x) for head, x in zip(_COLLINEAR_INPUTS[:3], (focal, angles, offset), strict=True)),
            given("point", "m", "X_L, Y_L, Z_L of the vertex", point),
            given("observed", "px", "x_c, y_c as observed, photo axes", observed),
        ],
        [
            *((f"C{i}_{axis}", "px/m" if i < 4 else "px/rad") for axis in "xy" for i in range(1, 7)),
            ("L_x", "px"),
            ("L_y", "px"),
        ],
        _linear,
        {
            "L is observed minus computed": lambda v: _with(v, lambda i, x: -x if i >= 12 else x),
            "derivatives by degrees": lambda v: _with(v, lambda i, x: x * pi / 180 if i < 12 and i % 6 >= 3 else x),
            "derivatives by the point, not the offset": lambda v: _with(
                v, lambda i, x: -x if i < 12 and i % 6 < 3 else x
            ),
            "signs of the angles' derivatives reversed": lambda v: _with(
                v, lambda i, x: -x if i < 12 and i % 6 >= 3 else x
            ),
            "sign of pitch reversed": lambda v: _linear(
                {**v, "angles": [v["angles"][0], -v["angles"][1], v["angles"][2]]}
            ),
            "sign of yaw reversed": lambda v: _linear({**v, "angles": [*v["angles"][:2], -v["angles"][2]]}),
        },
    )


def _twenty_four(
    name: str, k: list[float], angles: list[float], t: list[float], points: list[list[float]], **more: Any
) -> Pair:
    return pair(
        f"f24_{name}",
        "(24)",
        "9.3.2 i",
        f"""LiDAR points to pixels: s [u v 1]^T = K R_LC [X Y Z 1]^T with R_LC = [R | t], camera axes x right, y down, z forward;
            {IMAGE_AXES}; {ROTATION_TEXT}. Results: u and v of each point in order.""",
        [
            given(*K_INPUT, k),
            given("angles", "deg", "roll, pitch, yaw of R in R_LC = [R | t]", angles),
            given("translation", "m", "t in R_LC = [R | t]", t),
            given("points", "m", "X, Y, Z of each vertex by the LiDAR", points),
        ],
        names(len(points)),
        lambda v: [
            x for p in v["points"] for x in seen(v["intrinsics"], rotation(radians(v["angles"])), v["translation"], p)
        ],
        projection_mistakes("intrinsics", "angles", "translation", "points"),
        derived_tolerance=True,
        **more,
    )


def pairs() -> list[Pair]:
    k = [3000.0, 3002.5, 2001.25, 1498.75]
    scatter = [[0.5, -0.25, 12.75], [-4.625, 3.375, 15.5], [3.875, 2.5, 18.25], [-2.125, -3.75, 14.25]]
    down = [[x, y, -z] for x, y, z in scatter]
    b2 = [row[8] for row in B2]
    return [
        _twenty(
            "b2_column", b2, kind="published", published="appendix B.2: P_m = 0.349 px from the printed column of P_i"
        ),
        _twenty("two_targets", [0.25, 1.0], ("median", "n-1 in place of n"), kind="boundary"),
        _b2(),
        _rotation("boresight", [0.75, -1.25, 2.5]),
        _rotation("large", [25.5, -40.25, 130.0]),
        _rotation("near_gimbal_lock", [10.0, 89.5, -20.0], kind="boundary"),
        _twenty_two("photo", 3000.0, [2.25, -1.5, 31.75], [0.125, -0.0625, 0.1875], down),
        _twenty_three("photo", 3000.0, [2.25, -1.5, 31.75], [0.125, -0.0625, 0.1875], down[1], [905.5, -475.25]),
        _twenty_two("large_angles", 3652.5, [-12.25, 21.5, 200.75], [-0.375, 0.25, 0.5], down[:2]),
        _twenty_three("large_angles", 3652.5, [-12.25, 21.5, 200.75], [-0.375, 0.25, 0.5], down[3], [-1250.5, 975.25]),
        _twenty_four("four_targets", k, [2.25, -1.5, 31.75], [0.125, -0.0625, 0.1875], scatter),
    ]
