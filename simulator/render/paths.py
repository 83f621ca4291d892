"""Light on its way: what a surface of the range sends back along a ray, one sample at a time, in Dr.Jit.

Sun and sky are sampled apart. The ray that samples the sky is also the path's continuation, so a vertex costs two rays.
Which rays and how many samples is `simulator.render.radiance`'s affair; the irradiance that targets pass among their own
faces may come out of a table (`simulator.render.ambient`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from campaign.config import Camera
from scenes.model import SunSky
from scenes.spectra import band_reflectance
from scenes.sunsky import band_irradiance, sky_radiance_relative
from simulator.render import sky as sky_table
from simulator.render import start
from simulator.render.sampling import PixelSampler
from simulator.render.scene import RenderScene
from simulator.render.texture import texture_factor
from simulator.render.upload import uploaded

start()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

SUN_RADIUS_RAD = 0.00465
LIFT_M = 2e-4  # start of a secondary ray above its surface; single precision leaves 5e-6 m at 80 m
PAIRS = 4  # of random numbers a vertex takes, from the sequence's pair 2 on
SKY_SHARE = 0.98  # of the samples of a level surface; the rest guards tilted ones against the horizon


@dataclass(frozen=True, kw_only=True)
class Light:
    """Sun and sky at one instant: opaque to the compiler, so that a kernel serves every instant."""

    to_sun: Any  # Vector3f
    sun_x: Any  # two unit vectors across the sun's direction
    sun_y: Any
    direct: list[Any]  # for each band [W m-2 nm-1]
    diffuse: list[Any]
    horizontal: list[Any]  # irradiance of a level surface
    sky: sky_table.SkyTable


@dataclass(frozen=True, kw_only=True)
class Surfaces:
    """Materials in the camera's bands."""

    bands: int
    material: Any  # Float, rows of: reflectance in each band, opposition gain, 1/width, contrast, 1/scale
    row: int
    ground: int  # the material that fills the world beyond the terrain
    opposition: bool
    textured: bool


@dataclass(frozen=True, kw_only=True)
class AmbientTable:
    """Light from everything but the sun's own disc on flat parts of targets, at the nodes of a grid over each part."""

    facet: Any  # Int32 (faces,) -1: not in the table
    frame: Any  # Float (facets * 9,): origin, and two vectors across the grid with length 1 / its extent
    value: Any  # Float (facets * nodes * nodes * bands,): irradiance / pi
    nodes: int


def surfaces(render_scene: RenderScene, camera: Camera, repeat: int = 1) -> Surfaces:
    """Tables of the scene's materials; `repeat` lists every band so many times."""
    materials = render_scene.scene.materials
    rows = [
        [float(band_reflectance(m, band.centre_nm, band.fwhm_nm)) for band in camera.bands] * repeat
        + [m.opposition_gain, 1 / m.opposition_width_rad, m.texture_contrast, 1 / m.texture_scale_m]
        for m in materials
    ]
    mesh = render_scene.scene.mesh
    ground = mesh.material[mesh.target < 0]
    table = uploaded(mi.Float, np.asarray(rows, np.float32))
    dr.eval(table)
    return Surfaces(
        bands=len(camera.bands) * repeat,
        material=table,
        row=len(rows[0]),
        ground=int(ground[0]) if len(ground) else int(mesh.material[0]),
        opposition=any(m.opposition_gain > 0 for m in materials),
        textured=any(m.texture_contrast > 0 for m in materials),
    )


def light_of(camera: Camera, sun_sky: SunSky) -> Light:
    """A SunSky in the camera's bands."""
    irradiance = [band_irradiance(sun_sky, band) for band in camera.bands]
    return light_from(sun_sky.to_sun, [direct for direct, _ in irradiance], [diffuse for _, diffuse in irradiance])


def light_from(to_sun: np.ndarray, direct: list[float], diffuse: list[float]) -> Light:
    """Sun in a direction with direct normal and diffuse irradiance for each band. [W m-2 nm-1]"""
    towards = to_sun / np.linalg.norm(to_sun)
    across = np.cross(towards, [0.0, 0.0, 1.0] if abs(towards[2]) < 0.9 else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    up = max(float(towards[2]), 0.0)
    light = Light(
        to_sun=mi.Vector3f(*map(float, towards)),
        sun_x=mi.Vector3f(*map(float, across)),
        sun_y=mi.Vector3f(*map(float, np.cross(towards, across))),
        direct=[mi.Float(float(value)) for value in direct],
        diffuse=[mi.Float(float(value)) for value in diffuse],
        horizontal=[mi.Float(float(a) * up + float(b)) for a, b in zip(direct, diffuse, strict=True)],
        sky=sky_table.upload(lambda direction: sky_radiance_relative(direction, towards)),
    )
    dr.make_opaque(light.to_sun, light.sun_x, light.sun_y, light.direct, light.diffuse, light.horizontal)
    return light


# ----------------------------------------------------------------------------------------------------------- surfaces


@dataclass
class Hit:
    """A point of a surface; reflectances with the texture in them."""

    prim: Any
    point: Any  # Point3f [m]
    normal: Any  # unit, towards where the ray came from
    outside: Any  # the ray came from the side that the face's normal points to
    reflectance: list[Any]
    gain: Any  # opposition
    inverse_width: Any


def surface(render_scene: RenderScene, materials: Surfaces, ray: Any, found: Any, active: Any) -> Hit:
    """Where a ray met the range, and what is there."""
    prim = dr.select(active, found.prim_index, 0)
    point = ray.o + ray.d * dr.select(active, found.t, 0)
    normal = dr.gather(mi.Vector3f, render_scene.normal, prim)
    outside = dr.dot(normal, ray.d) <= 0
    normal = dr.select(outside, normal, -normal)
    base = dr.gather(mi.UInt32, render_scene.material, prim) * materials.row
    b = materials.bands

    def entry(k: int) -> Any:
        return dr.gather(mi.Float, materials.material, base + k)

    reflectance = [entry(k) for k in range(b)]
    if materials.textured:
        contrast = entry(b + 2)
        factor = rarely(
            active & (contrast > 0), lambda: texture_factor(point.x, point.y, contrast, entry(b + 3)), mi.Float(1)
        )
        reflectance = [dr.minimum(r * factor, 1) for r in reflectance]
    return Hit(prim, point, normal, outside, reflectance, entry(b), entry(b + 1))


# -------------------------------------------------------------------------------------------------------------- light


def rarely(condition: Any, value: Callable[[], Any], otherwise: Any) -> Any:
    """`value()` where the condition holds; a group of lanes in which it holds nowhere jumps over it."""
    return dr.if_stmt((), condition, value, lambda: otherwise)


def sun_light(
    render_scene: RenderScene, materials: Surfaces, light: Light, hit: Hit, incoming: Any, active: Any, u: Any, v: Any
) -> Any:
    """Direct sun from a point of its disc: what each band's reflectance / pi * direct irradiance is multiplied with."""
    radius, turn = SUN_RADIUS_RAD * dr.sqrt(u), 2 * dr.pi * v
    sine, cosine = dr.sincos(turn)
    to_sun = dr.normalize(light.to_sun + light.sun_x * (radius * cosine) + light.sun_y * (radius * sine))
    cos_sun = dr.dot(hit.normal, to_sun)
    lit = active & (cos_sun > 0)
    lit &= ~render_scene.mi_scene.ray_test(mi.Ray3f(hit.point + hit.normal * LIFT_M, to_sun), coherent=True, active=lit)
    weight = dr.select(lit, cos_sun, 0)
    if materials.opposition:
        phase = dr.safe_acos(-dr.dot(incoming, to_sun))
        weight *= 1 + hit.gain * dr.exp(-dr.minimum(phase * hit.inverse_width, 40))
    return weight


def sample_hemisphere(
    sky: sky_table.SkyTable, normal: Any, of_normal: tuple[Any, Any], of_sky: tuple[Any, Any], choice: Any
) -> tuple[Any, Any, Any]:
    """Direction above a surface, cosine / (pi * density) of it, and the sky's relative radiance from there (-1: ground).

    A cosine-weighted direction about the normal is kept where it points below the horizon (it sees the ground). Above it, it
    is exchanged for one of the sky's with a probability that is nearly one on level surfaces. The fraction of the
    cosine-weighted hemisphere below the horizon is (1 - n_z) / 2, so the density of the mixture is known. The two directions
    need numbers of their own: the first one's decide whether the second is asked.
    """
    local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(*of_normal))
    about_normal = mi.Frame3f(normal).to_world(local)
    share = SKY_SHARE * dr.square(dr.maximum(normal.z, 0))
    above = about_normal.z > 0
    exchanged = above & (choice < share)
    direction, relative = sky_table.sample(sky, *of_sky)
    direction = dr.select(exchanged, direction, about_normal)
    relative = rarely(above & ~exchanged, lambda: sky_table.relative_radiance(sky, direction), relative)
    cosine = dr.dot(normal, direction)
    density = dr.select(
        above,
        0.5 * (1 + normal.z) * share * relative * direction.z + (1 - share) * dr.maximum(cosine, 0),
        dr.maximum(cosine, 1e-6),
    )
    return direction, dr.select((cosine > 0) & (density > 0), cosine / density, 0), dr.select(above, relative, -1)


def relative_or_ground(sky: sky_table.SkyTable, direction: Any) -> Any:
    """The sky's relative radiance, -1 below the horizon."""
    return dr.select(direction.z > 0, sky_table.relative_radiance(sky, direction), -1)


def escaped(materials: Surfaces, light: Light, relative: Any) -> list[Any]:
    """Radiance of a ray that meets nothing: the sky, or (`relative` < 0) level ground of the terrain's material beyond it."""
    values = []
    for b in range(materials.bands):
        ground = dr.gather(mi.Float, materials.material, mi.UInt32(materials.ground * materials.row + b))
        values.append(dr.select(relative >= 0, relative * light.diffuse[b], ground * light.horizontal[b]) * (1 / dr.pi))
    return values


def gathered(
    render_scene: RenderScene,
    materials: Surfaces,
    light: Light,
    bounces: int,
    vertex: int,
    sampler: PixelSampler,
    sample: Any,
    point: Any,
    normal: Any,
    active: Any,
    choice: Any = None,
) -> list[Any]:
    """One sample of the irradiance / pi that the sky and other surfaces send to a point, in every band; no direct sun."""
    of_normal, of_sky = (sampler.pair(sample, k + PAIRS * vertex) for k in (3, 4))
    if choice is None:
        choice = sampler.pair(sample, 5 + PAIRS * vertex)[0]
    direction, weight, relative = sample_hemisphere(light.sky, normal, of_normal, of_sky, choice)
    following = mi.Ray3f(point + normal * LIFT_M, direction)
    going = active & (weight > 0)
    ambient = escaped(materials, light, relative)
    if vertex < bounces:
        further = render_scene.mi_scene.ray_intersect_preliminary(following, coherent=False, active=going)
        met = going & further.is_valid()

        def next_surface() -> tuple[Any, ...]:
            inner = mi.Bool(True)
            return tuple(
                outgoing(
                    render_scene, materials, light, bounces, vertex + 1, sampler, sample, following, further, inner
                )
            )

        reflected = rarely(met, next_surface, tuple(mi.Float(0) for _ in ambient))
        ambient = [dr.select(met, r, a) for r, a in zip(reflected, ambient, strict=True)]
    else:
        going &= ~render_scene.mi_scene.ray_test(following, coherent=False, active=going)
    weight = dr.select(going, weight, 0)
    return [weight * a for a in ambient]


def outgoing(
    render_scene: RenderScene,
    materials: Surfaces,
    light: Light,
    bounces: int,
    vertex: int,
    sampler: PixelSampler,
    sample: Any,
    ray: Any,
    found: Any,
    active: Any,
    choice: Any = None,
    table: AmbientTable | None = None,
) -> list[Any]:
    """One sample of the radiance that a surface sends back along a ray that met it, in every band."""
    here = surface(render_scene, materials, ray, found, active)
    # -- sun
    sun = sun_light(render_scene, materials, light, here, ray.d, active, *sampler.pair(sample, 2 + PAIRS * vertex))
    # -- sky and other surfaces, out of the table where it has the place
    cached = mi.Bool(False)
    if table is not None:
        facet = dr.gather(mi.Int32, table.facet, here.prim)
        cached = active & here.outside & (facet >= 0)
    searching = active & ~cached

    def search() -> tuple[Any, ...]:
        at = here.point, here.normal, searching, choice
        return tuple(gathered(render_scene, materials, light, bounces, vertex, sampler, sample, *at))

    if table is None:
        ambient = search()
    else:
        zero = tuple(mi.Float(0) for _ in range(materials.bands))
        ambient = rarely(searching, search, zero)
        stored = rarely(cached, lambda: looked_up(table, materials.bands, facet, here.point), zero)
        ambient = tuple(dr.select(cached, s, a) for s, a in zip(stored, ambient, strict=True))
    return [
        rho * (sun * direct * (1 / dr.pi) + a)
        for rho, direct, a in zip(here.reflectance, light.direct, ambient, strict=True)
    ]


def looked_up(table: AmbientTable, bands: int, facet: Any, point: Any) -> tuple[Any, ...]:
    """Irradiance / pi between the nodes of a facet's grid, bilinear, in every band."""
    base = mi.UInt32(dr.maximum(facet, 0)) * 3
    across = point - dr.gather(mi.Point3f, table.frame, base)
    last = table.nodes - 1
    x = dr.clip(dr.dot(across, dr.gather(mi.Vector3f, table.frame, base + 1)), 0, 1) * last
    y = dr.clip(dr.dot(across, dr.gather(mi.Vector3f, table.frame, base + 2)), 0, 1) * last
    i, j = dr.minimum(mi.UInt32(x), last - 1), dr.minimum(mi.UInt32(y), last - 1)
    fx, fy = x - mi.Float(i), y - mi.Float(j)
    first = mi.UInt32(dr.maximum(facet, 0)) * (table.nodes * table.nodes) + j * table.nodes + i

    def node(step: int, band: int) -> Any:
        return dr.gather(mi.Float, table.value, (first + step) * bands + band)

    return tuple(
        dr.lerp(dr.lerp(node(0, b), node(1, b), fx), dr.lerp(node(table.nodes, b), node(table.nodes + 1, b), fx), fy)
        for b in range(bands)
    )
