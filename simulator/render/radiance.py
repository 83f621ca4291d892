"""The camera's light: radiance of one frame by path tracing, W m-2 sr-1 nm-1, with point spread and motion, without the sensor.

Mitsuba traces the rays; the paths are ours. One lane is one pixel, its samples run in a loop inside the kernel and their sum
is written once, so the picture is the same to the byte for any number of threads and any size of tile. Sun and sky are
sampled apart; the ray that samples the sky is also the path's continuation, so a vertex costs two rays. Vignetting, noise and
DN are `simulator.sensor`'s.

Limits: diffuse surfaces (with an opposition peak in the sun's direct light); no air between ground and camera; the sky is a
CIE clear sky in `sky.ROWS` x `sky.COLUMNS` cells; the sun is a uniform disc; pose rates are constant during an exposure.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from campaign.config import Camera, Lens, Render
from campaign.errors import ConfigError
from scenes.model import SunSky
from scenes.spectra import band_reflectance
from scenes.sunsky import band_irradiance, sky_radiance_relative
from simulator.camera import FramePose, undistort, undistort_step
from simulator.render import sky as sky_table
from simulator.render import start
from simulator.render.sampling import PixelSampler, filter_offset, filter_quantiles, frame_words
from simulator.render.scene import RenderScene
from simulator.render.texture import texture_factor

start()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

SUN_RADIUS_RAD = 0.00465
RENDER_STREAM = 9
LIFT_M = 2e-4  # start of a secondary ray above its surface; single precision leaves 5e-6 m at 80 m
EDGE_FACTOR = 8  # pixels at an edge inside a target's box get this many times its samples
EDGE_REACH_PX = 2  # how far from an edge: point spread and motion blur
MAX_SAMPLES = 4096
TILE = 1 << 20  # lanes in flight
SKY_SHARE = 0.98  # of the samples of a level surface; the rest guards tilted ones against the horizon
Region = tuple[int, int, int, int, int]


@dataclass(frozen=True)
class _Frame:
    """What changes from frame to frame: opaque, so that the kernel is compiled once for a camera."""

    position: Any  # Point3f [m]
    velocity: Any  # Vector3f [m/s]
    axes: Any  # three Vector3f: columns of world_from_camera at mid-exposure
    rate: Any  # Vector3f, camera axes [rad/s]
    to_sun: Any  # Vector3f
    sun_x: Any  # two unit vectors across the sun's direction
    sun_y: Any
    direct: list[Any]  # for each band [W m-2 nm-1]
    diffuse: list[Any]
    horizontal: list[Any]  # irradiance of a level surface
    key: tuple[Any, Any]  # random words


@dataclass(frozen=True)
class _Tables:
    """What stays: materials, sky distribution, pixel filter."""

    bands: int
    material: Any  # rows of bands reflectances, gain, 1/width, contrast, 1/scale
    row: int
    ground: int  # the material that fills the world beyond the terrain
    opposition: bool
    textured: bool
    sky: sky_table.SkyTable
    filter: Any


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
    """Radiance of a frame, its point spread and motion blur included.

    Parameters
    ----------
    settings : Render
        `samples` for every pixel, `target_samples` inside the regions, EDGE_FACTOR times as many at edges inside them.
    seed, frame_key : int, tuple of int
        Of the samples; the same words give the same bytes.
    regions : list of (target index, u0, v0, u1, v1)
        From `simulator.camera.target_regions`. [px]
    tile : int
        Lanes at a time, a power of two of at least 1024; memory, not the picture, depends on it.

    Returns
    -------
    (height, width, bands) float32 ndarray
        [W m-2 sr-1 nm-1]
    """
    tables = _tables(render_scene, camera, light)
    frame = _frame(camera, pose, light, frame_words(seed, RENDER_STREAM, frame_key))
    count = camera.width_px * camera.height_px
    picture = np.empty((count, tables.bands), np.float32)
    inside = np.zeros((camera.height_px, camera.width_px), bool)
    for _, u0, v0, u1, v1 in regions:
        inside[v0:v1, u0:u1] = True
    target_samples = max(settings.samples, settings.target_samples)
    edges = _edges(render_scene, camera, tables, frame, inside, tile)
    for mask, samples in (
        (~inside, settings.samples),
        (inside & ~edges, target_samples),
        (edges, min(MAX_SAMPLES, EDGE_FACTOR * target_samples)),
    ):
        pixels = np.flatnonzero(mask).astype(np.uint32)
        for first in range(0, len(pixels), tile):
            part = pixels[first : first + tile]
            picture[part] = _trace(render_scene, camera, tables, frame, settings.bounces, part, samples)
    return picture.reshape(camera.height_px, camera.width_px, tables.bands)


# ---------------------------------------------------------------------------------------------------------------- set-up


def _tables(render_scene: RenderScene, camera: Camera, light: SunSky) -> _Tables:
    materials = render_scene.scene.materials
    rows = [
        [float(band_reflectance(m, band.centre_nm, band.fwhm_nm)) for band in camera.bands]
        + [m.opposition_gain, 1 / m.opposition_width_rad, m.texture_contrast, 1 / m.texture_scale_m]
        for m in materials
    ]
    mesh = render_scene.scene.mesh
    ground = mesh.material[mesh.target < 0]
    table = mi.Float(np.asarray(rows, np.float32).ravel())
    quantiles = mi.Float(filter_quantiles(camera.psf_sigma_px).astype(np.float32))
    dr.eval(table, quantiles)
    return _Tables(
        bands=len(camera.bands),
        material=table,
        row=len(rows[0]),
        ground=int(ground[0]) if len(ground) else int(mesh.material[0]),
        opposition=any(m.opposition_gain > 0 for m in materials),
        textured=any(m.texture_contrast > 0 for m in materials),
        sky=sky_table.upload(lambda direction: sky_radiance_relative(direction, light.to_sun)),
        filter=quantiles,
    )


def _frame(camera: Camera, pose: FramePose, light: SunSky, words: tuple[int, int]) -> _Frame:
    irradiance = [band_irradiance(light, band) for band in camera.bands]
    to_sun = light.to_sun / np.linalg.norm(light.to_sun)
    across = np.cross(to_sun, [0.0, 0.0, 1.0] if abs(to_sun[2]) < 0.9 else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    up = max(float(to_sun[2]), 0.0)
    frame = _Frame(
        position=mi.Point3f(*map(float, pose.position_world_m)),
        velocity=mi.Vector3f(*map(float, pose.velocity_world_m_s)),
        axes=[mi.Vector3f(*map(float, column)) for column in pose.world_from_camera.T],
        rate=mi.Vector3f(*map(float, pose.angular_rate_camera_rad_s)),
        to_sun=mi.Vector3f(*map(float, to_sun)),
        sun_x=mi.Vector3f(*map(float, across)),
        sun_y=mi.Vector3f(*map(float, np.cross(to_sun, across))),
        direct=[mi.Float(float(direct)) for direct, _ in irradiance],
        diffuse=[mi.Float(float(diffuse)) for _, diffuse in irradiance],
        horizontal=[mi.Float(float(direct) * up + float(diffuse)) for direct, diffuse in irradiance],
        key=(mi.UInt32(words[0]), mi.UInt32(words[1])),
    )
    dr.make_opaque(
        frame.position,
        frame.velocity,
        frame.axes,
        frame.rate,
        frame.to_sun,
        frame.sun_x,
        frame.sun_y,
        frame.direct,
        frame.diffuse,
        frame.horizontal,
        frame.key,
    )
    return frame


def _edges(
    render_scene: RenderScene, camera: Camera, tables: _Tables, frame: _Frame, inside: np.ndarray, tile: int
) -> np.ndarray:
    """Pixels inside the boxes near an edge of what is seen or of a shadow, (height, width) bool.

    Found by one ray through each pixel's centre, the same for any seed: choosing by the samples themselves would bias them.
    """
    pixels = np.flatnonzero(inside).astype(np.uint32)
    flat = np.full(inside.size, -1, np.int32)
    for first in range(0, len(pixels), tile):
        part = pixels[first : first + tile]
        flat[part] = _identity(render_scene, camera, tables, frame, part)
    seen = flat.reshape(inside.shape)
    edges = np.zeros(inside.shape, bool)
    for axis in (0, 1):
        a, b = (seen[:-1], seen[1:]) if axis == 0 else (seen[:, :-1], seen[:, 1:])
        differs = (a != b) & (a >= 0) & (b >= 0)
        if axis == 0:
            edges[:-1] |= differs
            edges[1:] |= differs
        else:
            edges[:, :-1] |= differs
            edges[:, 1:] |= differs
    for _ in range(EDGE_REACH_PX - 1):
        grown = edges.copy()
        grown[1:] |= edges[:-1]
        grown[:-1] |= edges[1:]
        grown[:, 1:] |= edges[:, :-1]
        grown[:, :-1] |= edges[:, 1:]
        edges = grown
    return np.asarray(edges & inside)


# --------------------------------------------------------------------------------------------------------- camera ray


def _undistort_steps(camera: Camera) -> int:
    """Steps of the fixed point that bring the image's corners within 1e-5 px."""
    lens: Lens = camera.lens
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


def _camera_ray(camera: Camera, frame: _Frame, steps: int, pixel: Any, offset: tuple[Any, Any], share: Any) -> Any:
    """Ray through a place of the image; `share` in [0, 1) is the part of the exposure that has passed."""
    lens = camera.lens
    column, row = pixel % camera.width_px, pixel // camera.width_px
    # Whole pixels and fractions apart: the difference to the principal point keeps its digits.
    whole_x, whole_y = int(np.floor(lens.cx_px)), int(np.floor(lens.cy_px))
    xd = (mi.Float(mi.Int32(column) - whole_x) + (0.5 - (lens.cx_px - whole_x) + offset[0])) / lens.fx_px
    yd = (mi.Float(mi.Int32(row) - whole_y) + (0.5 - (lens.cy_px - whole_y) + offset[1])) / lens.fy_px
    x, y = xd, yd
    for _ in range(steps):
        r2 = x * x + y * y
        radial = dr.rcp(1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3)))
        tx = 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x * x)
        ty = lens.p1 * (r2 + 2 * y * y) + 2 * lens.p2 * x * y
        x, y = (xd - tx) * radial, (yd - ty) * radial
    t = (share - 0.5) * camera.exposure_time_s
    if camera.shutter == "rolling":
        t += ((mi.Float(row) + 0.5) / camera.height_px - 0.5) * camera.readout_time_s
    # Rotation by rate * t to third order: 1e-9 rad for 1 rad/s over 15 ms.
    w, d = frame.rate * t, mi.Vector3f(x, y, 1)
    once = dr.cross(w, d)
    twice = dr.cross(w, once)
    d = d + once + 0.5 * twice + (1 / 6) * dr.cross(w, twice)
    world = frame.axes[0] * d.x + frame.axes[1] * d.y + frame.axes[2] * d.z
    return mi.Ray3f(frame.position + frame.velocity * t, dr.normalize(world))


# ----------------------------------------------------------------------------------------------------------- surfaces


@dataclass
class _Hit:
    point: Any  # Point3f on the surface [m]
    normal: Any  # unit, towards where the ray came from
    reflectance: list[Any]  # for each band, texture included
    gain: Any  # opposition
    inverse_width: Any


def _surface(render_scene: RenderScene, tables: _Tables, ray: Any, found: Any, hit: Any) -> _Hit:
    prim = dr.select(hit, found.prim_index, 0)
    point = ray.o + ray.d * dr.select(hit, found.t, 0)
    normal = dr.gather(mi.Vector3f, render_scene.normal, prim)
    normal = dr.select(dr.dot(normal, ray.d) > 0, -normal, normal)
    base = dr.gather(mi.UInt32, render_scene.material, prim) * tables.row
    b = tables.bands

    def entry(k: int) -> Any:
        return dr.gather(mi.Float, tables.material, base + k)

    reflectance = [entry(k) for k in range(b)]
    if tables.textured:
        factor = texture_factor(point.x, point.y, entry(b + 2), entry(b + 3))
        reflectance = [dr.minimum(r * factor, 1) for r in reflectance]
    return _Hit(point, normal, reflectance, entry(b), entry(b + 1))


# -------------------------------------------------------------------------------------------------------------- light


def _sun_light(
    render_scene: RenderScene, tables: _Tables, frame: _Frame, hit: _Hit, incoming: Any, active: Any, u: Any, v: Any
) -> Any:
    """Direct sun: what every band's reflectance / pi * direct irradiance is multiplied with."""
    radius, turn = SUN_RADIUS_RAD * dr.sqrt(u), 2 * dr.pi * v
    sine, cosine = dr.sincos(turn)
    to_sun = dr.normalize(frame.to_sun + frame.sun_x * (radius * cosine) + frame.sun_y * (radius * sine))
    cos_sun = dr.dot(hit.normal, to_sun)
    lit = active & (cos_sun > 0)
    lit &= ~render_scene.mi_scene.ray_test(mi.Ray3f(hit.point + hit.normal * LIFT_M, to_sun), coherent=True, active=lit)
    weight = dr.select(lit, cos_sun, 0)
    if tables.opposition:
        phase = dr.safe_acos(-dr.dot(incoming, to_sun))
        weight *= 1 + hit.gain * dr.exp(-dr.minimum(phase * hit.inverse_width, 40))
    return weight


def _sample_hemisphere(tables: _Tables, normal: Any, u: Any, v: Any, choice: Any) -> tuple[Any, Any, Any]:
    """Direction above a surface, cosine / (pi * density) of it, and the sky's relative radiance from there.

    A cosine-weighted direction about the normal is kept where it points below the horizon (it sees the ground). Above it, it
    is exchanged for one of the sky's with a probability that is nearly one on level surfaces. The fraction of the
    cosine-weighted hemisphere below the horizon is (1 - n_z) / 2, so the density of the mixture is known.
    """
    local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(u, v))
    about_normal = mi.Frame3f(normal).to_world(local)
    share = SKY_SHARE * dr.square(dr.maximum(normal.z, 0))
    above = about_normal.z > 0
    of_sky = above & (choice < share)
    direction, relative = sky_table.sample(tables.sky, u, v)
    direction = dr.select(of_sky, direction, about_normal)
    relative = _rarely(above & ~of_sky, lambda: sky_table.relative_radiance(tables.sky, direction), relative)
    cosine = dr.dot(normal, direction)
    density = dr.select(
        above,
        0.5 * (1 + normal.z) * share * relative * direction.z + (1 - share) * dr.maximum(cosine, 0),
        dr.maximum(cosine, 1e-6),
    )
    return direction, dr.select((cosine > 0) & (density > 0), cosine / density, 0), dr.select(above, relative, -1)


def _rarely(condition: Any, value: Callable[[], Any], otherwise: Any) -> Any:
    """`value()` where the condition holds; a group of lanes in which it holds nowhere jumps over it."""
    return dr.if_stmt((), condition, value, lambda: otherwise)


def _escaped(tables: _Tables, frame: _Frame, relative: Any) -> list[Any]:
    """Radiance of a ray that meets nothing: the sky, or (`relative` < 0) level ground of the terrain's material beyond it."""
    values = []
    for b in range(tables.bands):
        ground = dr.gather(mi.Float, tables.material, mi.UInt32(tables.ground * tables.row + b)) * frame.horizontal[b]
        values.append(dr.select(relative >= 0, relative * frame.diffuse[b], ground) * (1 / dr.pi))
    return values


# ------------------------------------------------------------------------------------------------------------ kernels


def _trace(
    render_scene: RenderScene,
    camera: Camera,
    tables: _Tables,
    frame: _Frame,
    bounces: int,
    pixels: np.ndarray,
    samples: int,
) -> np.ndarray:
    """Mean radiance of some pixels, (n, bands)."""
    pixel = mi.UInt32(pixels)
    count = mi.UInt32(samples)
    dr.make_opaque(count)
    sampler = PixelSampler(pixel, frame.key)
    steps = _undistort_steps(camera)

    def body(sample: Any, *total: Any) -> tuple[Any, ...]:
        value = _path(render_scene, camera, tables, frame, bounces, steps, pixel, sampler, sample)
        return (sample + 1, *(t + v for t, v in zip(total, value, strict=True)))

    state = dr.while_loop(
        (dr.zeros(mi.UInt32, len(pixels)), *(dr.zeros(mi.Float, len(pixels)) for _ in range(tables.bands))),
        lambda sample, *total: sample < count,
        body,
        label="samples",
    )
    mean = [total * (1 / samples) for total in state[1:]]
    dr.eval(mean)
    return np.stack([np.asarray(m) for m in mean], axis=-1)


def _path(
    render_scene: RenderScene,
    camera: Camera,
    tables: _Tables,
    frame: _Frame,
    bounces: int,
    steps: int,
    pixel: Any,
    sampler: PixelSampler,
    sample: Any,
) -> list[Any]:
    """Radiance of one sample in every band."""
    u, v = sampler.pair(sample, 0)
    share, choice = sampler.pair(sample, 1)
    offset = filter_offset(tables.filter, u), filter_offset(tables.filter, v)
    ray = _camera_ray(camera, frame, steps, pixel, offset, share)
    found = render_scene.mi_scene.ray_intersect_preliminary(ray, coherent=True)
    hit = found.is_valid()
    beside = _rarely(~hit, lambda: _relative_or_ground(tables, ray.d), mi.Float(0))
    reached = _outgoing(render_scene, tables, frame, bounces, 0, sampler, sample, ray, found, hit, choice)
    return [dr.select(hit, r, e) for r, e in zip(reached, _escaped(tables, frame, beside), strict=True)]


def _relative_or_ground(tables: _Tables, direction: Any) -> Any:
    return dr.select(direction.z > 0, sky_table.relative_radiance(tables.sky, direction), -1)


def _outgoing(
    render_scene: RenderScene,
    tables: _Tables,
    frame: _Frame,
    bounces: int,
    vertex: int,
    sampler: PixelSampler,
    sample: Any,
    ray: Any,
    found: Any,
    active: Any,
    choice: Any = None,
) -> list[Any]:
    """Radiance that a surface sends back along a ray that met it, one sample in every band."""
    scene = render_scene.mi_scene
    here = _surface(render_scene, tables, ray, found, active)
    # -- sun
    sun = _sun_light(render_scene, tables, frame, here, ray.d, active, *sampler.pair(sample, 2 + 3 * vertex))
    # -- sky, or what stands before it
    u, v = sampler.pair(sample, 3 + 3 * vertex)
    if choice is None:
        choice = sampler.pair(sample, 4 + 3 * vertex)[0]
    direction, weight, relative = _sample_hemisphere(tables, here.normal, u, v, choice)
    following = mi.Ray3f(here.point + here.normal * LIFT_M, direction)
    going = active & (weight > 0)
    ambient = _escaped(tables, frame, relative)
    if vertex < bounces:
        further = scene.ray_intersect_preliminary(following, coherent=False, active=going)
        met = going & further.is_valid()

        def next_surface() -> tuple[Any, ...]:
            return tuple(
                _outgoing(
                    render_scene, tables, frame, bounces, vertex + 1, sampler, sample, following, further, mi.Bool(True)
                )
            )

        reflected = _rarely(met, next_surface, tuple(mi.Float(0) for _ in ambient))
        ambient = [dr.select(met, r, a) for r, a in zip(reflected, ambient, strict=True)]
    else:
        going &= ~scene.ray_test(following, coherent=False, active=going)
    weight = dr.select(going, weight, 0)
    return [
        rho * (sun * direct * (1 / dr.pi) + weight * a)
        for rho, direct, a in zip(here.reflectance, frame.direct, ambient, strict=True)
    ]


def _identity(
    render_scene: RenderScene, camera: Camera, tables: _Tables, frame: _Frame, pixels: np.ndarray
) -> np.ndarray:
    """A number for what each pixel's centre sees: owner, part, material, lit or not."""
    pixel = mi.UInt32(pixels)
    centre = mi.Float(0), mi.Float(0)
    ray = _camera_ray(camera, frame, _undistort_steps(camera), pixel, centre, mi.Float(0.5))
    found = render_scene.mi_scene.ray_intersect_preliminary(ray, coherent=True)
    active = found.is_valid()
    prim = dr.select(active, found.prim_index, 0)
    hit = _surface(render_scene, tables, ray, found, active)
    cos_sun = dr.dot(hit.normal, frame.to_sun)
    lit = active & (cos_sun > 0)
    lit &= ~render_scene.mi_scene.ray_test(
        mi.Ray3f(hit.point + hit.normal * LIFT_M, frame.to_sun), coherent=True, active=lit
    )

    def table(column: Any) -> Any:
        return dr.gather(mi.Int32, column, prim) + 1

    material = dr.gather(mi.UInt32, render_scene.material, prim)
    number = (table(render_scene.target) * 32 + table(render_scene.part)) * 256 + mi.Int32(material % 256)
    number = dr.select(active, number * 2 + dr.select(lit, 1, 0), 0)
    return np.asarray(number)
