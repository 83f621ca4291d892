"""Pictures of the chessboard: rays from the pixel through the lens's aperture to the board, lit by one lamp in a dark room.

Mitsuba traces the rays; what a ray finds on the board is looked up in the pattern's own geometry. One lane is one pixel.
Optics are a thin lens: a ray starts on the aperture's disc and passes the point of the plane of focus on the chief ray of
its (distorted) pixel, so that a point out of focus becomes a uniform disc about its chief ray. Light is a small Lambertian
sphere: irradiance I cos(theta)/d^2 in closed form, no sampling, no second bounce.

A first pass takes one chief ray for each pixel and marks those whose blur, point spread and box reach an edge. Only these are
sampled: box and aperture by rays; the Gaussian point spread is integrated in closed form where the pattern is looked up
(axis by axis of the board; what the axes share is sampled), because sampled edges would be noisier than the sensor. The first
number of a sample moves along the normal of the nearest line of the pattern, over the aperture and over the pixel alike.

Not here: exposure, noise, files (simulator.bench.chessboard). Limits: the board's pose is at rest; the wall's light is not
blurred by defocus but at the board's outline; the edge of the board's shadow on the wall is the share of the lamp's disc that
each edge of the board leaves free, multiplied where two edges meet.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from campaign.config import Camera
from scenes.chessboard import BLACK, LAMP_CAMERA_M, LAMP_RADIUS_M, WALL, WHITE, Board
from simulator.render import start
from simulator.render.radiance import TILE, undistort_steps, undistorted
from simulator.render.sampling import PixelSampler, filter_offset, filter_quantiles
from simulator.render.scene import RenderScene
from simulator.render.upload import uploaded

start()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

KNOTS = 2048  # of the tables of quantiles, as simulator.render.sampling
PLAIN, EDGE, CORNER, OUTLINE = 0, 1, 2, 3  # what a pixel's blur reaches
REACH_SIGMA = 4.5  # of the point spread
CORNER_FACTOR = 8  # pixels whose blur reaches lines of both directions get this many times the samples of an edge


@dataclass(frozen=True, kw_only=True)
class BoardView:
    """One picture of the board: the camera with the lens as focused, and where the board stands."""

    camera: Camera  # its lens at this focus setting
    focus_distance_m: float  # of the plane of focus, from the entrance pupil
    aperture_m: float  # diameter of the entrance pupil
    wall_distance_m: float  # along the optical axis
    rotation: np.ndarray  # (3, 3) camera_from_board
    translation_m: np.ndarray  # (3,)


@dataclass(frozen=True, kw_only=True)
class _Job:
    render_scene: RenderScene
    board: Board
    view: BoardView
    steps: int
    centre: Any  # Point3f, entrance pupil in the board's frame [m]
    axes: list[Any]  # camera axes in the board's frame
    lamp: Any  # Point3f, board's frame [m]
    reflectance: list[float]
    key: tuple[Any, Any]
    filter: Any  # quantiles of box and point spread, for the board's outline
    chord: Any  # quantiles of a uniform disc's projection onto a diameter, -1 .. 1
    normal: Any  # quantiles of the standard normal distribution


def render_board(
    render_scene: RenderScene,
    board: Board,
    view: BoardView,
    samples: int,
    words: tuple[int, int],
    tile: int = TILE,
) -> np.ndarray:
    """Radiance of one picture for a lamp of unit radiant intensity, the same in every band.

    Parameters
    ----------
    render_scene : RenderScene
        Of `scenes.chessboard.board_scene`.
    samples : int
        Of a pixel at an edge, a power of two; the others take one.
    words : (int, int)
        Random, of this picture.
    tile : int
        Lanes at a time, a multiple of 64; memory, not the picture, depends on it.

    Returns
    -------
    (height, width) float32 ndarray
        Times the lamp's radiant intensity: radiance. [m-2]
    """
    job = _job(render_scene, board, view, words)
    size = view.camera.width_px * view.camera.height_px
    picture = np.empty(size, np.float32)
    reach = np.empty(size, np.uint8)
    for first in range(0, size, tile):
        lanes = np.s_[first : min(first + tile, size)]
        start_of_tile = mi.UInt32(first)
        dr.make_opaque(start_of_tile)
        pixel = dr.arange(mi.UInt32, lanes.stop - first) + start_of_tile
        value, kind = _once(job, pixel)
        dr.eval(value, kind)
        picture[lanes], reach[lanes] = np.asarray(value), np.asarray(kind)
    for kind, factor in ((EDGE, 1), (CORNER, CORNER_FACTOR), (OUTLINE, 1)):
        pixels = np.flatnonzero(reach == kind).astype(np.uint32)
        # Numbers that the kernel must not know: it is compiled once.
        count, kind_of_all = mi.UInt32(factor * samples), mi.UInt32(kind)
        dr.make_opaque(count, kind_of_all)
        for first in range(0, len(pixels), tile):
            part = pixels[first : first + tile]
            picture[part] = np.asarray(_sampled(job, uploaded(mi.UInt32, part), kind_of_all, count))
    return picture.reshape(view.camera.height_px, view.camera.width_px)


# ---------------------------------------------------------------------------------------------------------------- set-up


def _job(render_scene: RenderScene, board: Board, view: BoardView, words: tuple[int, int]) -> _Job:
    board_from_camera = view.rotation.T
    centre = -board_from_camera @ view.translation_m
    lamp = board_from_camera @ LAMP_CAMERA_M + centre
    share = np.linspace(0.0, 1.0, KNOTS + 1)
    tail = share.copy()
    tail[0], tail[-1] = 0.25 / KNOTS, 1 - 0.25 / KNOTS
    job = _Job(
        render_scene=render_scene,
        board=board,
        view=view,
        steps=undistort_steps(view.camera),
        centre=mi.Point3f(*map(float, centre)),
        axes=[mi.Vector3f(*map(float, column)) for column in board_from_camera.T],
        lamp=mi.Point3f(*map(float, lamp)),
        reflectance=[float(m.reflectance[0]) for m in render_scene.scene.materials],
        key=(mi.UInt32(words[0]), mi.UInt32(words[1])),
        filter=uploaded(mi.Float, filter_quantiles(view.camera.psf_sigma_px).astype(np.float32)),
        chord=uploaded(mi.Float, chord_quantiles(share).astype(np.float32)),
        normal=uploaded(mi.Float, ndtri(tail).astype(np.float32)),
    )
    dr.make_opaque(job.centre, job.axes, job.lamp, job.key, job.filter, job.chord, job.normal)
    return job


def chord_quantiles(share: np.ndarray) -> np.ndarray:
    """Quantile function of x for points spread evenly over the unit disc: F(x) = 1/2 + (x sqrt(1 - x^2) + asin x)/pi."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 200_001)
    return np.interp(share, 0.5 + (0.5 * np.sin(2 * angle) + angle) / np.pi, np.sin(angle))


@dataclass(frozen=True, kw_only=True)
class _Footprint:
    """A pixel on the board's plane, to first order; without the aperture."""

    x: Any  # of the pixel's centre, undistorted normalised
    y: Any
    turn: list[Any]  # undistorted normalised per pixel: xu xv yu yv
    direction: Any  # of the chief ray, board's frame, one unit of depth long
    depth: Any  # along the optical axis [m]; negative: the plane lies behind the camera
    point: tuple[Any, Any]  # board's frame [m]
    per_xy: list[Any]  # metres on the board per normalised coordinate: Xx Xy Yx Yy
    per_px: list[Any]  # metres on the board per pixel: Xu Xv Yu Yv


def _footprint(job: _Job, pixel: Any) -> _Footprint:
    camera, lens = job.view.camera, job.view.camera.lens
    column, row = mi.Int32(pixel % camera.width_px), mi.Int32(pixel // camera.width_px)
    x, y = undistorted(camera, job.steps, column, row, (mi.Float(0), mi.Float(0)))
    r2 = x * x + y * y
    radial = 1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    slope = 2 * (lens.k1 + r2 * (2 * lens.k2 + 3 * lens.k3 * r2))
    xx = radial + x * x * slope + 2 * lens.p1 * y + 6 * lens.p2 * x
    xy = x * y * slope + 2 * lens.p1 * x + 2 * lens.p2 * y
    yy = radial + y * y * slope + 6 * lens.p1 * y + 2 * lens.p2 * x
    scale = dr.rcp(xx * yy - xy * xy)
    turn = [yy * scale / lens.fx_px, -xy * scale / lens.fy_px, -xy * scale / lens.fx_px, xx * scale / lens.fy_px]
    direction = job.axes[0] * x + job.axes[1] * y + job.axes[2]
    depth = -job.centre.z / direction.z
    on_board = job.centre + direction * depth
    across, down = ((axis - direction * (axis.z / direction.z)) * depth for axis in (job.axes[0], job.axes[1]))
    per_xy = [across.x, down.x, across.y, down.y]
    per_px = [
        per_xy[0] * turn[0] + per_xy[1] * turn[2],
        per_xy[0] * turn[1] + per_xy[1] * turn[3],
        per_xy[2] * turn[0] + per_xy[3] * turn[2],
        per_xy[2] * turn[1] + per_xy[3] * turn[3],
    ]
    return _Footprint(
        x=x,
        y=y,
        turn=turn,
        direction=direction,
        depth=depth,
        point=(on_board.x, on_board.y),
        per_xy=per_xy,
        per_px=per_px,
    )


# ------------------------------------------------------------------------------------------------------------------ light


def _lit(reflectance: Any, lamp: Any, point: Any, towards: Any) -> Any:
    """Radiance of a Lambertian surface for unit intensity: rho/pi cos/d^2; `towards` is its normal."""
    to_lamp = lamp - point
    square = dr.dot(to_lamp, to_lamp)
    return reflectance * (1 / np.pi) * dr.maximum(dr.dot(to_lamp, towards), 0) * dr.rcp(square) * dr.rsqrt(square)


def _beside(job: _Job, x: Any, y: Any) -> Any:
    """Radiance of the wall behind the board for the chief ray (x, y): camera axes, shadow of the board included."""
    wall = job.view.wall_distance_m
    point = mi.Point3f(x * wall, y * wall, wall)
    light = mi.Point3f(*map(float, LAMP_CAMERA_M))
    whole = _lit(job.reflectance[WALL], light, point, mi.Vector3f(0, 0, -1))
    # Where the line from the wall to the lamp passes the board's plane, and how large the lamp's disc is there.
    here = job.centre + job.axes[0] * point.x + job.axes[1] * point.y + job.axes[2] * point.z
    part = here.z / (here.z - job.lamp.z)
    passes = here + (job.lamp - here) * part
    radius = LAMP_RADIUS_M * part
    covered = mi.Float(1)
    for place, low, high in zip((passes.x, passes.y), job.board.low_m, job.board.high_m, strict=True):
        covered *= _disc_share((place - float(low)) / radius) - _disc_share((place - float(high)) / radius)
    between = (part > 0) & (part < 1)
    return whole * (1 - dr.select(between, covered, 0))


def _disc_share(h: Any) -> Any:
    """Share of a unit disc on the positive side of a line that lies `h` on its negative side."""
    h = dr.clip(h, -1, 1)
    return 0.5 + (h * dr.safe_sqrt(1 - h * h) + dr.safe_asin(h)) * (1 / np.pi)


# ---------------------------------------------------------------------------------------------------------------- pattern


def _reflectance(job: _Job, x: Any, y: Any, std_x: Any, std_y: Any) -> Any:
    """Reflectance of the board about a point, averaged with a Gaussian along each axis, narrow against a square."""
    board = job.board
    window_x, sign_x = _wave(x / board.square_m, std_x / board.square_m, board.columns)
    window_y, sign_y = _wave(y / board.square_m, std_y / board.square_m, board.rows)
    black = 0.5 * (window_x * window_y + sign_x * sign_y)
    white = job.reflectance[WHITE]
    return white + (job.reflectance[BLACK] - white) * black


def _wave(at: Any, std: Any, squares: int) -> tuple[Any, Any]:
    """Along one axis in squares: 1 within the pattern, and +1, -1, +1 ... square by square; both averaged."""
    line = dr.clip(dr.round(at), -1, squares - 1)
    after = 0.5 + 0.5 * dr.erf((at - line) * (0.5**0.5 * dr.rcp(std)))
    number = mi.Int32(line) + 1  # of the square after the line
    sign = dr.select(number % 2 == 0, mi.Float(1), mi.Float(-1))
    right = dr.select(number < squares, after, 0)
    left = dr.select(number > 0, 1 - after, 0)
    return right + left, sign * (right - left)


def _line_distance_px(board: Board, foot: _Footprint) -> tuple[Any, Any]:
    """From a pixel's centre to the nearest line of the pattern across its x axis, and its y axis. [px]"""
    found = []
    for k, squares in enumerate((board.columns, board.rows)):
        at = foot.point[k] / board.square_m
        line = dr.clip(dr.round(at), -1, squares - 1)
        found.append(dr.abs(at - line) * (board.square_m * dr.rsqrt(_square(foot.per_px, k))))
    return found[0], found[1]


def _rim_distance_px(board: Board, foot: _Footprint) -> tuple[Any, Any]:
    """From a pixel's centre to the nearest edge of the whole board across its x axis, and its y axis. [px]"""
    found = []
    for k in range(2):
        at = foot.point[k]
        rim = dr.minimum(dr.abs(at - float(board.low_m[k])), dr.abs(at - float(board.high_m[k])))
        found.append(rim * dr.rsqrt(_square(foot.per_px, k)))
    return found[0], found[1]


def _square(per_px: list[Any], axis: int) -> Any:
    return dr.square(per_px[2 * axis]) + dr.square(per_px[2 * axis + 1])


# ---------------------------------------------------------------------------------------------------------------- kernels


def _once(job: _Job, pixel: Any) -> tuple[Any, Any]:
    """Radiance on the chief ray of each pixel, and what the pixel's blur reaches."""
    board, camera, view = job.board, job.view.camera, job.view
    foot = _footprint(job, pixel)
    found = job.render_scene.mi_scene.ray_intersect_preliminary(mi.Ray3f(job.centre, foot.direction), coherent=True)
    hit = found.is_valid()
    point = job.centre + foot.direction * dr.select(hit, found.t, 1)
    narrow = mi.Float(1e-4 * board.square_m)
    shade = _lit(_reflectance(job, point.x, point.y, narrow, narrow), job.lamp, point, mi.Vector3f(0, 0, -1))
    value = dr.select(hit, shade, _beside(job, foot.x, foot.y))
    # Blur in pixels; 1.15: lenses stretch it towards the corners.
    blur = 0.5 * view.aperture_m * max(camera.lens.fx_px, camera.lens.fy_px) * 1.15
    reach = blur * dr.abs(dr.rcp(foot.depth) - 1 / view.focus_distance_m) + 0.75 + REACH_SIGMA * camera.psf_sigma_px
    near_x, near_y = _line_distance_px(board, foot)
    pad = [reach * dr.sqrt(_square(foot.per_px, k)) for k in range(2)]
    inside = [
        (foot.point[k] > -board.square_m - pad[k]) & (foot.point[k] < board.square_m * (squares - 1) + pad[k])
        for k, squares in enumerate((board.columns, board.rows))
    ]
    in_pattern = inside[0] & inside[1] & (foot.depth > 0)
    edge = in_pattern & ((near_x < reach) | (near_y < reach))
    corner = in_pattern & (near_x < reach) & (near_y < reach)
    near, within = mi.Bool(False), mi.Bool(True)
    for k in range(2):
        low, high = foot.point[k] - float(board.low_m[k]), float(board.high_m[k]) - foot.point[k]
        within &= (low > -pad[k]) & (high > -pad[k])
        near |= (low < pad[k]) | (high < pad[k])
    outline = near & within & (foot.depth > 0) & ~edge
    kind = dr.select(outline, mi.UInt32(OUTLINE), dr.select(corner, CORNER, dr.select(edge, EDGE, PLAIN)))
    return value, kind


def _sampled(job: _Job, pixel: Any, kind: Any, count: Any) -> Any:
    """Mean radiance over the pixel's box, the point spread and the aperture."""
    sampler = PixelSampler(pixel, job.key, pairs=3)
    foot = _footprint(job, pixel)
    pattern, corner = kind != OUTLINE, kind == CORNER
    lines, rims = _line_distance_px(job.board, foot), _rim_distance_px(job.board, foot)
    by_x = dr.select(pattern, lines[0] < lines[1], rims[0] < rims[1])
    # Unit vector across the nearest line, in the aperture's plane; the image axis that crosses it more steeply.
    across_x, across_y = (dr.select(by_x, foot.per_xy[k], foot.per_xy[2 + k]) for k in range(2))
    unit = dr.rsqrt(across_x * across_x + across_y * across_y)
    across_x, across_y = across_x * unit, across_y * unit
    by_u = dr.select(
        by_x,
        dr.abs(foot.per_px[0]) > dr.abs(foot.per_px[1]),
        dr.abs(foot.per_px[2]) > dr.abs(foot.per_px[3]),
    )
    # The point spread on the board: what the axes share is sampled, the rest is integrated.
    variance = max(job.view.camera.psf_sigma_px, 1e-3) ** 2
    xx, yy = variance * _square(foot.per_px, 0), variance * _square(foot.per_px, 1)
    xy = variance * (foot.per_px[0] * foot.per_px[2] + foot.per_px[1] * foot.per_px[3])
    shared = dr.abs(xy)
    shared_x = dr.select(pattern, dr.sqrt(shared * dr.sqrt(xx / yy)), 0)
    shared_y = dr.select(pattern, dr.sign(xy) * dr.sqrt(shared * dr.sqrt(yy / xx)), 0)
    least = 1e-4 * job.board.square_m
    std_x = dr.select(pattern, dr.sqrt(dr.maximum(xx - shared_x * shared_x, least**2)), least)
    std_y = dr.select(pattern, dr.sqrt(dr.maximum(yy - shared_y * shared_y, least**2)), least)

    def body(sample: Any, total: Any) -> tuple[Any, Any]:
        chord, first = sampler.pair(sample, 0)
        rest, second = sampler.pair(sample, 1)
        # At a corner the aperture's two numbers belong together, along an edge what moves across it.
        first, rest = dr.select(corner, rest, first), dr.select(corner, first, rest)
        # Place in the pixel, in undistorted coordinates.
        first, second = (
            dr.select(pattern, number - 0.5, filter_offset(job.filter, number)) for number in (first, second)
        )
        u, v = dr.select(by_u, first, second), dr.select(by_u, second, first)
        x = foot.x + foot.turn[0] * u + foot.turn[1] * v
        y = foot.y + foot.turn[2] * u + foot.turn[3] * v
        # Place on the aperture.
        p = filter_offset(job.chord, chord)
        q = (2 * rest - 1) * dr.safe_sqrt(1 - p * p)
        radius = 0.5 * job.view.aperture_m
        ax, ay = radius * (across_x * p - across_y * q), radius * (across_y * p + across_x * q)
        origin = job.centre + job.axes[0] * ax + job.axes[1] * ay
        inverse = 1 / job.view.focus_distance_m
        direction = job.axes[0] * (x - ax * inverse) + job.axes[1] * (y - ay * inverse) + job.axes[2]
        found = job.render_scene.mi_scene.ray_intersect_preliminary(mi.Ray3f(origin, direction), coherent=True)
        hit = found.is_valid()
        point = origin + direction * dr.select(hit, found.t, 1)
        spread = filter_offset(job.normal, sampler.pair(sample, 2)[0])
        seen = _reflectance(job, point.x + shared_x * spread, point.y + shared_y * spread, std_x, std_y)
        shade = _lit(seen, job.lamp, point, mi.Vector3f(0, 0, -1))
        return sample + 1, total + dr.select(hit, shade, _beside(job, x, y))

    lanes = dr.width(pixel)
    state = dr.while_loop(
        (dr.zeros(mi.UInt32, lanes), dr.zeros(mi.Float, lanes)),
        lambda sample, total: sample < count,
        body,
        label="board",
    )
    mean = state[1] / mi.Float(count)
    dr.eval(mean)
    return mean
