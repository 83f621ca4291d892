"""The patent's steps: S3 projection, S4 half-window count, S5 remapping with the mounting's error, S6 residual, S7 adjustment."""

from typing import Any

import mpmath
from mpmath import fsum, mpf, pi

from testrange.pairs.build import Formula, Values, given, pair, quantised
from testrange.pairs.clauses.c9_2 import CORNER, IMAGE_AXES, K_INPUT, OBSERVATIONS, noise
from testrange.pairs.maths import (
    ROTATION_TEXT,
    PixelFit,
    applied,
    mean_norm,
    minus,
    norm,
    plus,
    product,
    radians,
    rotation,
    seen,
    transposed,
    wrong_rotations,
)
from testrange.pairs.model import Pair

# R_CB takes camera coordinates (x right, y down, z forward) to the pod's (x forward, y right, z down): the camera looks down, its
# image's top ahead.
_R_CB = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
_ZERO = [mpf(0)] * 3


def remapped(k: Any, r_cb: Any, t_cb: Any, r_bw: Any, t_bw: Any, place: Any, dr: Any, dt: Any) -> list[Any]:
    """(11): s [u v 1]^T = K R_CB^-1 dR^-1 (R_BW^-1 (P_W - t_BW) - t_CB - dt)."""
    in_pod = applied(transposed(r_bw), minus(place, t_bw))
    in_camera = applied(transposed(product(dr, r_cb)), minus(minus(in_pod, t_cb), dt))
    return seen(k, [[1, 0, 0], [0, 1, 0], [0, 0, 1]], _ZERO, in_camera)


_IDENTITY = [[mpf(1), mpf(0), mpf(0)], [mpf(0), mpf(1), mpf(0)], [mpf(0), mpf(0), mpf(1)]]


def _s3(v: Values, r_bw: Any = None, **change: Any) -> list[Any]:
    r_bw = rotation(radians(v["attitude"])) if r_bw is None else r_bw
    v = {**v, **change}
    return [
        x
        for place in v["places"]
        for x in remapped(
            v["intrinsics"], v["r_cb"], v["t_cb"], r_bw, v["position"], place, _dr(v), v.get("shift", _ZERO)
        )
    ]


def _dr(v: Values) -> Any:
    return v["dr"] if "dr" in v else rotation(radians(v["mounting"])) if "mounting" in v else _IDENTITY


def _attitude(key: str) -> Formula:
    return lambda v: _s3(v, wrong_rotations(v["attitude"])[key])


def _mounting(key: str) -> Formula:
    return lambda v: _s3(v, dr=wrong_rotations(v["mounting"])[key])


_COMMON_MISTAKES: dict[str, Formula] = {
    "sign of the attitude's roll reversed": _attitude("sign of roll reversed"),
    "sign of the attitude's pitch reversed": _attitude("sign of pitch reversed"),
    "sign of the heading reversed": _attitude("sign of yaw reversed"),
    "attitude transposed": _attitude("transpose of the rotation"),
    "degrees taken as radians": _attitude("degrees taken as radians"),
    "order of the turns reversed: Rx Ry Rz": _attitude("order of the turns reversed: Rx Ry Rz"),
    "R_CB in place of its inverse": lambda v: _s3(v, r_cb=transposed(v["r_cb"])),
    "t_CB added": lambda v: _s3(v, t_cb=[-x for x in v["t_cb"]]),
    CORNER: lambda v: [x - mpf("0.5") for x in _s3(v)],
}
_SHARED_STATEMENT = f"""P_W = R_BW P_B + t_BW with R_BW = Rz(heading) Ry(pitch) Rx(roll); axes of P_W: x north, y east, z down; of
    the pod: x forward, y right, z down; of the camera: x right, y down, z forward; {IMAGE_AXES}; {ROTATION_TEXT}."""


_WITH_ERROR = "P_B = dR R_CB P_C + t_CB + dt, dR = Rz(gamma) Ry(beta) Rx(alpha); s [u v 1]^T = K P_C."


def _inputs(k: Any, attitude: Any, position: Any, t_cb: Any, places: Any) -> list[Any]:
    return [
        given(*K_INPUT, k),
        given("attitude", "deg", "roll, pitch, heading by the IMU", attitude),
        given("position", "m", "t_BW by GNSS", position),
        given("r_cb", "1", "R_CB, row by row", _R_CB),
        given("t_cb", "m", "t_CB", t_cb),
        given("places", "m", "P_W of each board's centre", places),
    ]


def _uv(n: int) -> list[tuple[str, str]]:
    return [(f"{axis}_{i + 1}", "px") for i in range(n) for axis in "uv"]


_K = [3000.0, 3002.5, 2001.25, 1498.75]
_T_CB = [0.125, -0.0625, 0.1875]
_PLACES = [[2.5, -3.25, 0.125], [-4.75, 5.5, -0.25], [6.125, 4.0, 0.0]]
_HERE = [1.25, -0.75, -45.5]
_MOUNTING = ("mounting", "deg", "alpha, beta, gamma of dR = Rz(gamma) Ry(beta) Rx(alpha)")
_SHIFT = ("shift", "m", "dt")


def _s3_pair(name: str, attitude: list[float], position: list[float], **more: Any) -> Pair:
    return pair(
        f"s3_{name}",
        "S3",
        "patent S3",
        f"Boards' centres to pixels: {_SHARED_STATEMENT} P_B = R_CB P_C + t_CB; s [u v 1]^T = K P_C.",
        _inputs(_K, attitude, position, _T_CB, _PLACES),
        _uv(len(_PLACES)),
        _s3,
        _COMMON_MISTAKES,
        derived_tolerance=True,
        **more,
    )


_S5_MISTAKES: dict[str, Formula] = {
    "sign of alpha reversed": _mounting("sign of roll reversed"),
    "sign of beta reversed": _mounting("sign of pitch reversed"),
    "sign of gamma reversed": _mounting("sign of yaw reversed"),
    "dR in place of its inverse": _mounting("transpose of the rotation"),
    "order of dR reversed: Rx Ry Rz": _mounting("order of the turns reversed: Rx Ry Rz"),
    "dR on the camera's side: R_CB dR": lambda v: _s3(v, dr=_IDENTITY, r_cb=product(v["r_cb"], _dr(v))),
    "dt reversed": lambda v: _s3(v, shift=[-x for x in v["shift"]]),
    "dt left out": lambda v: _s3(v, shift=_ZERO),
    "mounting's degrees taken as radians": _mounting("degrees taken as radians"),
}


def _s5_pair(name: str, attitude: list[float], mounting: list[float], shift: list[float]) -> Pair:
    return pair(
        f"s5_{name}",
        "S5",
        "patent S5",
        f"Boards' centres to pixels with the mounting's error: {_SHARED_STATEMENT} {_WITH_ERROR}",
        [*_inputs(_K, attitude, _HERE, _T_CB, _PLACES), given(*_MOUNTING, mounting), given(*_SHIFT, shift)],
        _uv(len(_PLACES)),
        _s3,
        {**_COMMON_MISTAKES, **_S5_MISTAKES},
        derived_tolerance=True,
    )


def _s6(v: Values, sign: int = 1) -> list[Any]:
    return [sign * (m - p) for m, p in zip([x for w in v["pixels"] for x in w], _s3(v), strict=True)]


def _s6_pair(attitude: list[float], mounting: list[float], shift: list[float]) -> Pair:
    observed = [[2013.25, 1382.875], [2716.75, 1069.5], [2011.125, 838.25]]
    return pair(
        "s6_residuals",
        "S6",
        "patent S6",
        f"Residuals, observed minus remapped pixel of each board: {_SHARED_STATEMENT} {_WITH_ERROR}",
        [
            *_inputs(_K, attitude, _HERE, _T_CB, _PLACES),
            given(*_MOUNTING, mounting),
            given(*_SHIFT, shift),
            given("pixels", "px", "observed u, v of each board", observed),
        ],
        [(f"e{axis}_{i + 1}", "px") for i in range(len(observed)) for axis in "uv"],
        _s6,
        {
            "remapped minus observed": lambda v: _s6(v, -1),
            "without the mounting's error": lambda v: _s6({**v, "dr": _IDENTITY, "shift": _ZERO}),
            "sign of alpha reversed": lambda v: _s6(
                {**v, "dr": wrong_rotations(v["mounting"])["sign of roll reversed"]}
            ),
            "sign of beta reversed": lambda v: _s6(
                {**v, "dr": wrong_rotations(v["mounting"])["sign of pitch reversed"]}
            ),
            "sign of gamma reversed": lambda v: _s6(
                {**v, "dr": wrong_rotations(v["mounting"])["sign of yaw reversed"]}
            ),
        },
        derived_tolerance=True,
    )


def _bright(v: Values) -> list[list[int]]:
    return [[1 if value > v["threshold"] else 0 for value in row] for row in v["image"]]


def _windows(v: Values, bright: list[list[int]]) -> list[tuple[int, int, int, int, int]]:
    """(column, row, left - right, upper - lower, bright pixels) of every window inside the image; column and row of its centre."""
    half = int(v["window"]) // 2
    out = []
    for row in range(half, len(bright) - half + 1):
        for column in range(half, len(bright[0]) - half + 1):
            part = [line[column - half : column + half] for line in bright[row - half : row + half]]
            left, right = sum(sum(line[:half]) for line in part), sum(sum(line[half:]) for line in part)
            above, below = sum(map(sum, part[:half])), sum(map(sum, part[half:]))
            out.append((column, row, left - right, above - below, left + right))
    return out


def _s4(v: Values, dark: bool = False) -> list[Any]:
    bright = _bright(v)
    if dark:
        bright = [[1 - b for b in row] for row in bright]
    area = int(v["window"]) ** 2
    equal = [
        (column, row)
        for column, row, across, down, count in _windows(v, bright)
        if across == 0 and down == 0 and 3 * count >= area and 3 * count <= 2 * area
    ]
    if len(equal) != 1:
        raise ArithmeticError(f"{len(equal)} windows with equal halves")
    return [mpf(x) for x in equal[0]]


def _centroid(v: Values) -> list[Any]:
    places = [(c, r) for r, row in enumerate(_bright(v)) for c, b in enumerate(row) if b]
    return [fsum([mpf(p[i]) + mpf("0.5") for p in places]) / len(places) for i in (0, 1)]


def _picture(centre: tuple[int, int], turn: tuple[int, int], size: int = 28, noisy: bool = True) -> list[list[int]]:
    """A 2x2 board of 20 px about `centre`, its sectors' borders along (a, b) and (-b, a), on dark ground; grey levels vary."""
    a, b = turn
    rows = []
    for r in range(size):
        row = []
        for c in range(size):
            x, y = 2 * (c - centre[0]) + 1, 2 * (r - centre[1]) + 1  # twice the distance from the centre, never zero
            along, across = a * x + b * y, a * y - b * x
            inside = max(abs(along), abs(across)) ** 2 <= 400 * (a * a + b * b)
            white = inside and along * across > 0
            level = 190 if white or (c > size - 3 and r < 5) else 40 if inside else 60  # a stone lies in the corner
            row.append(level + (7 * c + 13 * r) % 11 if noisy else level)
        rows.append(row)
    return rows


def _s4_pair(name: str, centre: tuple[int, int], turn: tuple[int, int], window: int, **more: Any) -> Pair:
    return pair(
        f"s4_{name}",
        "S4",
        "patent S4",
        """Centre of a 2x2 board by the half-window count: the one window (square, of the given even side, wholly inside the image,
            a third to two thirds of its pixels bright) whose left and right halves, and whose upper and lower halves, hold equal
            numbers of bright pixels (grey level above the threshold). Column and row of its centre; a whole number is the border
            between two pixels, the image's top left corner is (0, 0).""",
        [
            given("image", "DN", "grey levels, row by row", _picture(centre, turn)),
            given("threshold", "DN", "a pixel above it is bright", 125),
            given("window", "px", "side of the window", window),
        ],
        [("column", "px"), ("row", "px")],
        _s4,
        {
            "column and row exchanged": lambda v: _s4(v)[::-1],
            CORNER: lambda v: [x - mpf("0.5") for x in _s4(v)],
            "pixel right and below of the centre, counted from its middle": lambda v: [x + mpf("0.5") for x in _s4(v)],
            "window's corner in place of its centre": lambda v: [x - int(v["window"]) // 2 for x in _s4(v)],
            "centroid of the bright pixels": _centroid,
        },
        scale=[1.0],
        condition=lambda v: mpf(0),
        condition_note="whole numbers: counting has no rounding",
        tolerance_why="whole numbers",
        **more,
    )


def _fit(v: Values) -> PixelFit:
    """All boards in all photos as a function of xi = alpha, beta, gamma [rad], dx, dy, dz [m]."""
    pod_from_world = [transposed(rotation(radians(a))) for a in v["attitudes"]]
    arms = []  # R_BW^-1 (P_W - t_BW) - t_CB of each observation
    for photo, board in zip(v["photo"], v["board"], strict=True):
        i, j = int(photo) - 1, int(board) - 1
        arms.append(minus(applied(pod_from_world[i], minus(v["places"][j], v["positions"][i])), v["t_cb"]))

    def matrices(x: Any) -> Any:
        camera_from_pod = transposed(product(rotation(x[:3]), v["r_cb"]))
        return camera_from_pod, [-c for c in applied(camera_from_pod, x[3:])]

    return PixelFit(intrinsics=v["intrinsics"], points=arms, pixels=v["pixels"], matrices=matrices)


_XI: dict[int, list[Any]] = {}


def _xi(v: Values) -> list[Any]:
    key = hash((mpmath.mp.prec, str(v)))
    if key not in _XI:
        _XI[key] = _fit(v).solved([mpf(0)] * 6)
    return _XI[key]


def _mean_residual(v: Values) -> Any:
    return mean_norm(_fit(v).residuals(_xi(v)))


def _s7_pair(name: str, attitudes: list[list[float]], positions: list[list[float]], seed: int, **more: Any) -> Pair:
    places = [
        [8.5, -6.25, 0.125],
        [-7.75, 6.5, -0.25],
        [6.125, 7.0, 0.0],
        [-8.25, -6.5, 0.375],
        [0.25, 0.5, -0.125],
        [9.0, 0.75, 0.25],
    ]
    mounting, shift = [0.5, -0.75, 1.25], [0.0625, -0.03125, 0.046875]
    dr = rotation(radians([mpf(a) for a in mounting]))
    rows = [(i, j) for i in range(len(attitudes)) for j in range(len(places))]
    pixels: list[list[float]] = []
    for i, j in rows:
        at = remapped(
            [mpf(x) for x in _K], [[mpf(x) for x in r] for r in _R_CB], [mpf(x) for x in _T_CB],
            rotation(radians([mpf(a) for a in attitudes[i]])), [mpf(x) for x in positions[i]], [mpf(x) for x in places[j]], dr,
            [mpf(x) for x in shift],
        )  # fmt: skip
        at = plus(at, [noise(seed + 2 * len(pixels), 0.25), noise(seed + 2 * len(pixels) + 1, 0.25)])
        pixels.append([quantised(x, 10) for x in at])

    def reverse(i: int) -> Formula:
        return lambda v: [*(-x if j == i else x for j, x in enumerate(_xi(v))), _mean_residual(v)]

    return pair(
        f"s7_{name}",
        "S7",
        "patent S5-S7",
        f"""xi = [alpha beta gamma dx dy dz] that minimises the sum of squared residuals of all boards in all photos, every pixel
            with one weight and nothing known beforehand, iterated to convergence from zero; angles in rad, then the mean norm of
            the residuals. {_SHARED_STATEMENT} {_WITH_ERROR}""",
        [
            given(*K_INPUT, _K),
            given("attitudes", "deg", "roll, pitch, heading of each photo", attitudes),
            given("positions", "m", "t_BW of each photo", positions),
            given("r_cb", "1", "R_CB, row by row", _R_CB),
            given("t_cb", "m", "t_CB", _T_CB),
            given("places", "m", "P_W of each board's centre", places),
            given("photo", "1", "number of the photo of each observation, from 1", [i + 1 for i, _ in rows]),
            given("board", "1", "number of the board of each observation, from 1", [j + 1 for _, j in rows]),
            given("pixels", "px", "observed u, v", pixels),
        ],
        [
            ("alpha", "rad"),
            ("beta", "rad"),
            ("gamma", "rad"),
            ("dx", "m"),
            ("dy", "m"),
            ("dz", "m"),
            ("mean_residual", "px"),
        ],
        lambda v: [*_xi(v), _mean_residual(v)],
        {
            "sign of alpha reversed": reverse(0),
            "sign of beta reversed": reverse(1),
            "sign of gamma reversed": reverse(2),
            "correction in place of the error: all signs reversed": lambda v: [
                *(-x for x in _xi(v)),
                _mean_residual(v),
            ],
            "angles in degrees": lambda v: [*(x * 180 / pi for x in _xi(v)[:3]), *_xi(v)[3:], _mean_residual(v)],
            CORNER: lambda v: (lambda w: [*_xi(w), _mean_residual(w)])(
                {**v, "pixels": [[a + mpf("0.5") for a in p] for p in v["pixels"]]}
            ),
            "root mean square in place of the mean of norms": lambda v: [
                *_xi(v),
                norm(_fit(v).residuals(_xi(v))) / mpmath.sqrt(len(v["pixels"])),
            ],
        },
        condition=lambda v: _fit(v).condition(_xi(v)),
        condition_note=OBSERVATIONS,
        derived_tolerance=True,
        **more,
    )


def pairs() -> list[Pair]:
    attitude = [2.5, -3.75, 62.25]
    mounting, shift = [0.5, -0.75, 1.25], [0.0625, -0.03125, 0.046875]
    crossed = [[1.25, -2.0, 0.5], [-1.5, 1.75, 181.25], [0.75, 2.5, 90.0], [-2.25, -0.5, 269.5]]
    over = [[-1.0, 0.5, -45.0], [1.25, -0.25, -45.5], [0.5, 1.0, -65.25], [-0.75, -1.25, -64.5]]
    straight = [[0.25, -0.5, 45.0], [-0.125, 0.25, 45.25], [0.5, 0.125, 44.75]]
    along = [[-2.0, -2.25, -45.0], [0.0, 0.25, -45.125], [2.25, 2.0, -44.875]]
    return [
        _s3_pair("banked", attitude, _HERE),
        _s3_pair("southward", [-8.5, 4.25, 200.5], [-3.5, 2.25, -61.0]),
        _s4_pair("square_on", (13, 15), (1, 0), 10),
        _s4_pair("turned", (15, 12), (3, 1), 10),
        _s5_pair("banked", attitude, mounting, shift),
        _s5_pair("southward", [-8.5, 4.25, 200.5], [-2.25, 1.5, 3.75], [-0.125, 0.0625, 0.03125]),
        _s6_pair(attitude, mounting, shift),
        _s7_pair("four_headings", crossed, over, 0),
        _s7_pair("one_heading", straight, along, 30, kind="ill_conditioned"),
    ]
