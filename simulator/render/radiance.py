"""The camera's light: radiance of one frame by path tracing, W m-2 sr-1 nm-1, with point spread and motion, without the sensor.

Mitsuba traces the rays; the paths are ours. One lane is one pixel, its samples run in a loop inside the kernel and their sum
is written once, so the picture is the same to the byte for any number of threads and any size of tile. Sun and sky are
sampled apart; the ray that samples the sky is also the path's continuation, so a vertex costs two rays. Vignetting, noise and
DN are `simulator.camera.sensor`'s.

Limits: diffuse surfaces (with an opposition peak in the sun's direct light); no air between ground and camera; the sky is a
CIE clear sky in `sky.ROWS` x `sky.COLUMNS` cells; the sun is a uniform disc; pose rates are constant during an exposure.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from campaign.config import Camera, Render
from campaign.errors import ConfigError
from scenes.model import SunSky
from simulator.camera.view import FramePose, undistort, undistort_step
from simulator.render import start
from simulator.render.ambient import ambient_table
from simulator.render.paths import (
    LIFT_M,
    PAIRS,
    AmbientTable,
    Light,
    Surfaces,
    escaped,
    light_of,
    outgoing,
    rarely,
    relative_or_ground,
    surface,
    surfaces,
)
from simulator.render.sampling import PixelSampler, filter_offset, filter_quantiles, frame_words
from simulator.render.scene import RenderScene
from simulator.render.spread import fold, halo_px
from simulator.render.upload import uploaded

start()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

RENDER_STREAM = 9
EDGE_FACTOR = 4  # pixels at an edge inside a target's box get this many times its samples
MAX_SAMPLES = 4096
TILE = 1 << 20  # lanes in flight
BAND_PIXELS = 1 << 20  # of a band of rows
ROW_STEP = 16  # bands are whole blocks of the sensor's noise (simulator.camera.sensor.ROWS_AT_ONCE)
BOX_PIXELS = 1 << 17  # of boxes that are rendered together
Region = tuple[int, int, int, int, int]


@dataclass(frozen=True, kw_only=True)
class _View:
    """The camera during one exposure; numbers that change from frame to frame are opaque, so a kernel is compiled once."""

    camera: Camera
    steps: int  # of the lens's inversion
    position: Any  # Point3f [m]
    velocity: Any  # Vector3f [m/s]
    axes: list[Any]  # columns of world_from_camera at mid-exposure
    rate: Any  # Vector3f, camera axes [rad/s]
    filter: Any  # Float, quantiles of the pixel's response
    halo: int  # pixels round the image that are numbered too


@dataclass(frozen=True, kw_only=True)
class _Job:
    """All that the kernels of one frame read."""

    render_scene: RenderScene
    view: _View
    materials: Surfaces
    light: Light
    ambient: AmbientTable | None
    bounces: int
    key: tuple[Any, Any]  # random words


def band_rows(camera: Camera) -> int:
    """Rows that `render_bands` gives at a time: about BAND_PIXELS pixels, a multiple of ROW_STEP."""
    return max(ROW_STEP, BAND_PIXELS // camera.width_px // ROW_STEP * ROW_STEP)


def render_frame(
    render_scene: RenderScene,
    camera: Camera,
    pose: FramePose,
    light: SunSky,
    settings: Render,
    seed: int,
    frame_key: tuple[int, ...],
    regions: list[Region],
    tile: int = TILE,
) -> np.ndarray:
    """Radiance of a whole frame (height, width, bands): what `render_bands` gives, in one piece. [W m-2 sr-1 nm-1]"""
    bands = render_bands(render_scene, camera, pose, light, settings, seed, frame_key, regions, tile)
    return np.concatenate(list(bands))


def render_bands(
    render_scene: RenderScene,
    camera: Camera,
    pose: FramePose,
    light: SunSky,
    settings: Render,
    seed: int,
    frame_key: tuple[int, ...],
    regions: list[Region],
    tile: int = TILE,
) -> Iterator[np.ndarray]:
    """Radiance of a frame from its first row to its last, point spread and motion blur included.

    Memory does not grow with the frame but by the boxes' pixels: nobody needs all of it at once.

    Parameters
    ----------
    settings : Render
        `samples` for every pixel, `target_samples` inside the regions (shared out over sub-pixels), EDGE_FACTOR times as many
        at edges inside them.
    seed, frame_key : int, tuple of int
        Of the samples; the same words give the same bytes.
    regions : list of (target index, u0, v0, u1, v1)
        From `simulator.camera.view.target_regions`. [px]
    tile : int
        Lanes at a time, a power of two of at least 1024; memory, not the picture, depends on it.

    Yields
    ------
    (rows, width, bands) float32 ndarray
        `band_rows` rows, the last time what is left. [W m-2 sr-1 nm-1]
    """
    words = frame_words(seed, RENDER_STREAM, frame_key)
    job = _Job(
        render_scene=render_scene,
        view=_view(camera, pose),
        materials=surfaces(render_scene, camera),
        light=light_of(camera, light),
        ambient=ambient_table(render_scene, camera, light, settings.bounces, seed) if regions else None,
        bounces=settings.bounces,
        key=(mi.UInt32(words[0]), mi.UInt32(words[1])),
    )
    dr.make_opaque(job.key)
    boxes = _boxes(job, regions, max(settings.samples, settings.target_samples), tile)
    step = band_rows(camera)
    for first in range(0, camera.height_px, step):
        last = min(first + step, camera.height_px)
        inside = np.zeros((last - first, camera.width_px), bool)
        band = np.empty((*inside.shape, len(camera.bands)), np.float32)
        for (_, u0, v0, u1, v1), box in zip(regions, boxes, strict=True):
            low, high = max(v0, first), min(v1, last)
            if low < high:
                inside[low - first : high - first, u0:u1] = True
                band[low - first : high - first, u0:u1] = box[low - v0 : high - v0]
        pixels = _numbers(job.view, 0, first, camera.width_px, last)[~inside]
        band[~inside] = _trace(job, pixels, settings.samples, 1, tile)
        yield band


def _numbers(view: _View, u0: int, v0: int, u1: int, v1: int) -> np.ndarray:
    """Numbers (v1 - v0, u1 - u0) uint32 of the pixels of a box, which may reach into the image's halo.

    Light from beyond the image's border comes from a place like any other, so the halo is numbered too.
    """
    column = np.arange(u0, u1, dtype=np.int64) + view.halo
    row = np.arange(v0, v1, dtype=np.int64) + view.halo
    return (row[:, None] * (view.camera.width_px + 2 * view.halo) + column).astype(np.uint32)


def _boxes(job: _Job, regions: list[Region], samples: int, tile: int) -> list[np.ndarray]:
    """The targets' boxes (v1 - v0, u1 - u0, bands), rendered by sub-pixels; some boxes together, for one wavefront."""
    split = max(k for k in (1, 2, 4) if k * k <= samples)
    halo, sigma = job.view.halo, job.view.camera.psf_sigma_px
    boxes: list[np.ndarray] = []
    together: list[np.ndarray] = []
    for k, (_, u0, v0, u1, v1) in enumerate(regions, start=1):
        together.append(_numbers(job.view, u0 - halo, v0 - halo, u1 + halo, v1 + halo))
        if k < len(regions) and sum(number.size for number in together) < BOX_PIXELS:
            continue
        pixels = np.concatenate([number.ravel() for number in together])
        seen = np.concatenate([_identity(job, pixels[k : k + tile]) for k in range(0, len(pixels), tile)])
        ends = np.cumsum([number.size for number in together])
        each = [part.reshape(number.shape) for part, number in zip(np.split(seen, ends[:-1]), together, strict=True)]
        edges = np.concatenate([_edges(part).ravel() for part in each])
        sub = np.empty((len(pixels), split, split, job.materials.bands), np.float32)
        for mask, count in ((~edges, samples), (edges, min(MAX_SAMPLES, EDGE_FACTOR * samples))):
            sub[mask] = _trace(job, pixels[mask], count // split**2, split, tile).reshape(-1, *sub.shape[1:])
        for part, number in zip(np.split(sub, ends[:-1]), together, strict=True):
            height, width = number.shape
            fine = part.reshape(height, width, *sub.shape[1:]).swapaxes(1, 2).reshape(height * split, width * split, -1)
            boxes.append(fold(fine, sigma, split))
        together = []
    return boxes


# ---------------------------------------------------------------------------------------------------------------- set-up


def _view(camera: Camera, pose: FramePose) -> _View:
    view = _View(
        camera=camera,
        steps=undistort_steps(camera),
        position=mi.Point3f(*map(float, pose.position_world_m)),
        velocity=mi.Vector3f(*map(float, pose.velocity_world_m_s)),
        axes=[mi.Vector3f(*map(float, column)) for column in pose.world_from_camera.T],
        rate=mi.Vector3f(*map(float, pose.angular_rate_camera_rad_s)),
        filter=uploaded(mi.Float, filter_quantiles(camera.psf_sigma_px).astype(np.float32)),
        halo=halo_px(camera.psf_sigma_px),
    )
    dr.make_opaque(view.position, view.velocity, view.axes, view.rate, view.filter)
    return view


def _edges(seen: np.ndarray) -> np.ndarray:
    """Pixels (h, w) at an edge of what is seen or of a shadow: one of the eight neighbours sees something else.

    Told by one ray through each pixel's centre, the same for any seed: choosing by the samples themselves would bias them.
    """
    edges = np.zeros(seen.shape, bool)
    for low, high in (
        (np.s_[:-1], np.s_[1:]),
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:-1, :-1], np.s_[1:, 1:]),
        (np.s_[:-1, 1:], np.s_[1:, :-1]),
    ):
        differs = seen[low] != seen[high]
        edges[low] |= differs
        edges[high] |= differs
    return edges


# --------------------------------------------------------------------------------------------------------- camera ray


def undistort_steps(camera: Camera) -> int:
    """Steps of the fixed point that bring the image's corners within 1e-5 px."""
    lens = camera.lens
    u, v = np.meshgrid([0.0, 0.5 * camera.width_px, camera.width_px], [0.0, 0.5 * camera.height_px, camera.height_px])
    border = (np.stack([u.ravel(), v.ravel()], axis=-1) - [lens.cx_px, lens.cy_px]) / [lens.fx_px, lens.fy_px]
    exact = undistort(lens, border)
    if not np.isfinite(exact).all():
        raise ConfigError("the lens model folds back inside the image", where="camera.lens", remedy="check k1 k2 k3")
    found = border
    steps = 0
    while np.abs(found - exact).max() * lens.fx_px > 1e-5:
        found = undistort_step(lens, border, found)
        steps += 1
    return steps


def undistorted(camera: Camera, steps: int, column: Any, row: Any, offset: tuple[Any, Any]) -> tuple[Any, Any]:
    """Normalised coordinates x = X/Z, y = Y/Z of a place `offset` from a pixel's centre, the lens's distortion taken off."""
    lens = camera.lens
    # Whole pixels and fractions apart: the difference to the principal point keeps its digits.
    whole_x, whole_y = int(np.floor(lens.cx_px)), int(np.floor(lens.cy_px))
    xd = (mi.Float(column - whole_x) + (0.5 - (lens.cx_px - whole_x) + offset[0])) / lens.fx_px
    yd = (mi.Float(row - whole_y) + (0.5 - (lens.cy_px - whole_y) + offset[1])) / lens.fy_px
    x, y = xd, yd
    for _ in range(steps):
        r2 = x * x + y * y
        radial = dr.rcp(1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3)))
        tx = 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x * x)
        ty = lens.p1 * (r2 + 2 * y * y) + 2 * lens.p2 * x * y
        x, y = (xd - tx) * radial, (yd - ty) * radial
    return x, y


def _camera_ray(view: _View, pixel: Any, offset: tuple[Any, Any], share: Any) -> Any:
    """Ray through a place of the image; `share` in [0, 1) is the part of the exposure that has passed."""
    camera = view.camera
    across = camera.width_px + 2 * view.halo
    column, row = mi.Int32(pixel % across) - view.halo, mi.Int32(pixel // across) - view.halo
    x, y = undistorted(camera, view.steps, column, row, offset)
    t = (share - 0.5) * camera.exposure_time_s
    if camera.shutter == "rolling":
        t += ((mi.Float(row) + 0.5) / camera.height_px - 0.5) * camera.readout_time_s
    # Rotation by rate * t to third order: 1e-9 rad for 1 rad/s over 15 ms.
    w, d = view.rate * t, mi.Vector3f(x, y, 1)
    once = dr.cross(w, d)
    twice = dr.cross(w, once)
    d = d + once + 0.5 * twice + (1 / 6) * dr.cross(w, twice)
    world = view.axes[0] * d.x + view.axes[1] * d.y + view.axes[2] * d.z
    return mi.Ray3f(view.position + view.velocity * t, dr.normalize(world))


# ------------------------------------------------------------------------------------------------------------ kernels


def _trace(job: _Job, pixels: np.ndarray, samples: int, split: int, tile: int) -> np.ndarray:
    """Mean radiance of pixels, point spread included, (n, bands); of their sub-pixels, without it, (n * split^2, bands)."""
    lanes = len(pixels) * split**2
    mean = np.empty((lanes, job.materials.bands), np.float32)
    count = mi.UInt32(samples)
    dr.make_opaque(count)
    # Whole pixels, and a multiple of 64 of them: the rays of a packet are the same ones in any tile.
    step = max(64, tile // split**2)
    for first in range(0, len(pixels), step):
        part = pixels[first : first + step]
        lane = dr.arange(mi.UInt32, len(part) * split**2)
        pixel = dr.gather(mi.UInt32, uploaded(mi.UInt32, part), lane // split**2)
        found = _mean(job, pixel, lane % split**2, split, count)
        mean[first * split**2 : (first + len(part)) * split**2] = np.stack([np.asarray(m) for m in found], axis=-1)
    return mean


def _mean(job: _Job, pixel: Any, sub: Any, split: int, count: Any) -> list[Any]:
    sampler = PixelSampler(pixel * split**2 + sub, job.key, pairs=2 + PAIRS * (job.bounces + 1))
    corner = mi.Float(sub % split) / split - 0.5, mi.Float(sub // split) / split - 0.5

    def body(sample: Any, *total: Any) -> tuple[Any, ...]:
        u, v = sampler.pair(sample, 0)
        if split == 1:
            offset = filter_offset(job.view.filter, u), filter_offset(job.view.filter, v)
        else:
            offset = corner[0] + u / split, corner[1] + v / split
        value = _sample(job, pixel, offset, sampler, sample)
        return (sample + 1, *(t + v for t, v in zip(total, value, strict=True)))

    lanes = dr.width(pixel)
    state = dr.while_loop(
        (dr.zeros(mi.UInt32, lanes), *(dr.zeros(mi.Float, lanes) for _ in range(job.materials.bands))),
        lambda sample, *total: sample < count,
        body,
        label="samples",
    )
    mean = [total / mi.Float(count) for total in state[1:]]
    dr.eval(mean)
    return mean


def _sample(job: _Job, pixel: Any, offset: tuple[Any, Any], sampler: PixelSampler, sample: Any) -> list[Any]:
    """Radiance of one sample, `offset` from its pixel's centre, in every band."""
    share, choice = sampler.pair(sample, 1)
    ray = _camera_ray(job.view, pixel, offset, share)
    found = job.render_scene.mi_scene.ray_intersect_preliminary(ray, coherent=True)
    hit = found.is_valid()
    beside = rarely(~hit, lambda: relative_or_ground(job.light.sky, ray.d), mi.Float(0))
    reached = outgoing(
        job.render_scene,
        job.materials,
        job.light,
        job.bounces,
        0,
        sampler,
        sample,
        ray,
        found,
        hit,
        choice,
        job.ambient,
    )
    return [dr.select(hit, r, e) for r, e in zip(reached, escaped(job.materials, job.light, beside), strict=True)]


def _identity(job: _Job, pixels: np.ndarray) -> np.ndarray:
    """A number for what each pixel's centre sees: owner, part, material, lit or not."""
    ray = _camera_ray(job.view, uploaded(mi.UInt32, pixels), (mi.Float(0), mi.Float(0)), mi.Float(0.5))
    scene = job.render_scene
    found = scene.mi_scene.ray_intersect_preliminary(ray, coherent=True)
    active = found.is_valid()
    hit = surface(scene, job.materials, ray, found, active)
    lit = active & (dr.dot(hit.normal, job.light.to_sun) > 0)
    shadow = mi.Ray3f(hit.point + hit.normal * LIFT_M, job.light.to_sun)
    lit &= ~scene.mi_scene.ray_test(shadow, coherent=True, active=lit)
    owner, part = (dr.gather(mi.Int32, column, hit.prim) + 1 for column in (scene.target, scene.part))
    material = mi.Int32(dr.gather(mi.UInt32, scene.material, hit.prim) % 256)
    number = (owner * 32 + part) * 256 + material
    return np.asarray(dr.select(active, number * 2 + dr.select(lit, 1, 0), 0))
