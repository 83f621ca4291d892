"""Light inside the integrating sphere: radiance of the wall at given places, by path tracing without a depth limit.

Two steps. `_trace_sources` starts a path at each of many points spread over wall and baffle and follows it, sampling the lamp
at every vertex, until it leaves through the port, meets the lamp's black face, or loses at Russian roulette: an unbiased
sample of what leaves the point. `_gather` then adds to every place asked for what comes straight from the lamp and from all
those points, each seen or hidden by a ray. The places share their paths, so their common noise is scale, not pattern.

Every lane writes its own sum once and lanes are added in NumPy in a fixed order: the same bytes for any number of threads.
Diffuse surfaces of one reflectance; no air.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from scenes.sphere import SphereScene
from simulator.render import start
from simulator.render.sampling import PixelSampler, frame_words
from simulator.render.upload import uploaded

start()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

SPHERE_STREAM = 14
PATHS = 1 << 17
LAMP_POINTS = 1 << 12
BLOCKS = 64  # partial sums of one place
ROULETTE = 0.2  # a path that weighs less survives with the probability weight / ROULETTE
LIFT = 5e-5  # start and end of a ray above its surface, in radii of the sphere; single precision leaves 1e-7


@dataclass(frozen=True, kw_only=True)
class _Inside:
    """The sphere as the kernels see it; lengths in radii of the sphere. Numbers are opaque: one kernel for every sphere."""

    mi_scene: Any
    baffle: Any  # ShapePtr, or None
    facing: Any  # Vector3f, the baffle's normal
    lamp: Any  # Vector3f, unit
    lamp_cos: Any
    port_cos: Any
    lamp_radiance: Any  # of unit flux, times the area of the lamp's cap
    reflectance: Any
    key: tuple[Any, Any]


def wall_points(scene: SphereScene, direction: np.ndarray) -> np.ndarray:
    """Where rays from the camera's pupil through the port meet the wall.

    Parameters
    ----------
    direction : (n, 3) ndarray
        In the sphere's axes (the camera's), any length.

    Returns
    -------
    (n, 3) ndarray
        NaN where the ray misses the port, or meets lamp or baffle. [m]
    """
    inside = _inside(scene, 0)
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    # From the plane of the port on: outside it there is nothing but the sphere's back.
    plane = -scene.radius_m * np.cos(scene.port_half_angle_rad)
    with np.errstate(divide="ignore", invalid="ignore"):
        start_m = scene.camera_m + ((plane - scene.camera_m[2]) / unit[:, 2])[:, None] * unit
    through = (unit[:, 2] > 0) & (
        np.hypot(start_m[:, 0], start_m[:, 1]) < scene.radius_m * np.sin(scene.port_half_angle_rad)
    )
    origin = np.where(through[:, None], start_m / scene.radius_m, 0.0)
    ray = mi.Ray3f(_point(origin), mi.Vector3f(*(mi.Float(c) for c in unit.T.astype(np.float32))))
    found = inside.mi_scene.ray_intersect_preliminary(ray, coherent=False)
    point = ray.o + ray.d * dr.select(found.is_valid(), found.t, 0)
    good = found.is_valid() & ~_is_baffle(inside, found) & (dr.dot(dr.normalize(point), inside.lamp) < inside.lamp_cos)
    dr.eval(point, good)
    places = np.array(point).T * scene.radius_m
    places[~(np.array(good) & through)] = np.nan
    return places


def radiance_per_watt(scene: SphereScene, point_m: np.ndarray, seed: int, paths: int = PATHS) -> np.ndarray:
    """Radiance of the wall, of the same height in all directions, for one watt of the lamp.

    Parameters
    ----------
    point_m : (n, 3) ndarray
        Places on the wall. [m]
    seed : int
        Of the samples.
    paths : int
        A power of two.

    Returns
    -------
    (n,) float64 ndarray
        [sr-1 m-2]
    """
    inside = _inside(scene, seed)
    sources = _trace_sources(inside, scene, paths)
    place = point_m / np.linalg.norm(point_m, axis=1, keepdims=True)
    irradiance = _gather(inside, sources, place)
    return np.asarray(irradiance * scene.wall_reflectance / np.pi / scene.radius_m**2)


# ---------------------------------------------------------------------------------------------------------------- set-up


def _inside(scene: SphereScene, seed: int) -> _Inside:
    shapes: dict[str, Any] = {"type": "scene", "wall": {"type": "sphere", "radius": 1.0, "flip_normals": True}}
    if scene.baffle is not None:
        centre, normal = scene.baffle.centre_m / scene.radius_m, scene.baffle.normal
        side = np.cross(normal, [1.0, 0.0, 0.0])
        to_world = mi.ScalarTransform4f().look_at(origin=list(centre), target=list(centre + normal), up=list(side))
        to_world = to_world @ mi.ScalarTransform4f().scale(scene.baffle.radius_m / scene.radius_m)
        shapes["baffle"] = {"type": "disk", "to_world": to_world}
    mi_scene = mi.load_dict(shapes)
    baffle = next((mi.ShapePtr(s) for s in mi_scene.shapes() if s.id() == "baffle"), None)
    cap = 4 * np.pi * scene.lamp_share
    words = frame_words(seed, SPHERE_STREAM, (0,))
    inside = _Inside(
        mi_scene=mi_scene,
        baffle=baffle,
        facing=mi.Vector3f(*map(float, scene.baffle.normal if scene.baffle is not None else (0, 0, 1))),
        lamp=mi.Vector3f(*map(float, scene.lamp_direction)),
        lamp_cos=mi.Float(float(np.cos(scene.lamp_half_angle_rad))),
        port_cos=mi.Float(float(np.cos(scene.port_half_angle_rad))),
        lamp_radiance=mi.Float(float(cap / (np.pi * scene.lamp_area_m2 / scene.radius_m**2))),
        reflectance=mi.Float(scene.wall_reflectance),
        key=(mi.UInt32(words[0]), mi.UInt32(words[1])),
    )
    dr.make_opaque(inside.facing, inside.lamp, inside.lamp_cos, inside.port_cos)
    dr.make_opaque(inside.lamp_radiance, inside.reflectance, inside.key)
    return inside


def _point(xyz: np.ndarray) -> Any:
    return mi.Point3f(*(uploaded(mi.Float, c) for c in xyz.T.astype(np.float32)))


def _is_baffle(inside: _Inside, found: Any) -> Any:
    return mi.Bool(False) if inside.baffle is None else found.shape == inside.baffle


# --------------------------------------------------------------------------------------------------------------- kernels


@dataclass(frozen=True, kw_only=True)
class _Sources:
    """Points that send light, as arrays: place, normal, radiance times the area that the point stands for."""

    point: np.ndarray  # (s, 3)
    normal: np.ndarray  # (s, 3)
    weight: np.ndarray  # (s,)


def _lamp_point(inside: _Inside, u: Any, v: Any) -> Any:
    """Uniform on the lamp's cap."""
    height = 1 - u * (1 - inside.lamp_cos)
    sine, cosine = dr.sincos(2 * dr.pi * v)
    radius = dr.safe_sqrt(1 - height * height)
    return mi.Point3f(mi.Frame3f(inside.lamp).to_world(mi.Vector3f(radius * cosine, radius * sine, height)))


def _exchange(inside: _Inside, p: Any, n_p: Any, q: Any, n_q: Any, active: Any) -> Any:
    """cos cos / distance^2 between two points, 0 where they do not see each other."""
    across = q - p
    cosines = dr.maximum(dr.dot(n_p, across), 0) * dr.maximum(-dr.dot(n_q, across), 0)
    factor = cosines / dr.square(dr.maximum(dr.squared_norm(across), 1e-12))
    begin, end = p + n_p * LIFT, q + n_q * LIFT
    way = end - begin
    ray = mi.Ray3f(begin, way)
    ray.maxt = mi.Float(1 - 1e-4)
    asked = active & (factor > 0)
    hidden = inside.mi_scene.ray_test(ray, coherent=False, active=asked)
    return dr.select(asked & ~hidden, factor, 0)


def _from_lamp(inside: _Inside, p: Any, n_p: Any, u: Any, v: Any, active: Any) -> Any:
    """One sample of the irradiance that comes straight from the lamp."""
    z = _lamp_point(inside, u, v)
    return inside.lamp_radiance * _exchange(inside, p, n_p, z, -mi.Vector3f(z), active)


def _trace_sources(inside: _Inside, scene: SphereScene, paths: int) -> _Sources:
    """Points on wall and baffle with what leaves them, and points on the lamp."""
    lane = dr.arange(mi.UInt32, paths)
    # -- where: uniform over the sphere and both sides of the baffle
    u, v = PixelSampler(mi.UInt32(0xFFFFFFFF), inside.key, pairs=1).pair(lane, 0)
    wall_area, side_area = 4 * np.pi, 0.0
    if scene.baffle is not None:
        side_area = np.pi * (scene.baffle.radius_m / scene.radius_m) ** 2
    area = wall_area + 2 * side_area
    wall_share, side_share = mi.Float(wall_area / area), mi.Float(max(side_area / area, 1e-9))
    dr.make_opaque(wall_share, side_share)
    point = mi.Point3f(mi.warp.square_to_uniform_sphere(mi.Point2f(dr.minimum(u / wall_share, 1), v)))
    normal = -mi.Vector3f(point)
    alive = (-point.z < inside.port_cos) & (dr.dot(point, inside.lamp) < inside.lamp_cos)
    if scene.baffle is not None:
        beyond = (u - wall_share) / side_share
        front = beyond < 1
        disc = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(dr.clip(beyond - dr.select(front, 0, 1), 0, 1), v))
        centre = mi.Point3f(*map(float, scene.baffle.centre_m / scene.radius_m))
        radius = mi.Float(scene.baffle.radius_m / scene.radius_m)
        dr.make_opaque(centre, radius)
        place = centre + radius * mi.Frame3f(inside.facing).to_world(mi.Vector3f(disc.x, disc.y, 0))
        on_baffle = beyond >= 0
        point = dr.select(on_baffle, place, point)
        normal = dr.select(on_baffle, dr.select(front, inside.facing, -inside.facing), normal)
        alive |= on_baffle
    dr.eval(point, normal, alive)
    # -- what leaves
    leaving = _follow(inside, lane, point, normal, alive)
    # -- the lamp itself
    lamp_lane = dr.arange(mi.UInt32, LAMP_POINTS)
    lamp = _lamp_point(inside, *PixelSampler(mi.UInt32(0xFFFFFFFE), inside.key, pairs=1).pair(lamp_lane, 0))
    dr.eval(leaving, lamp)
    sends = np.array(leaving) > 0
    on_lamp = np.array(lamp).T
    per_lamp_point = np.full(LAMP_POINTS, np.array(inside.lamp_radiance)[0] / LAMP_POINTS)
    return _Sources(
        point=np.concatenate([np.array(point).T[sends], on_lamp]),
        normal=np.concatenate([np.array(normal).T[sends], -on_lamp]),
        weight=np.concatenate([np.array(leaving)[sends] * (area / paths), per_lamp_point]),
    )


def _follow(inside: _Inside, lane: Any, point: Any, normal: Any, alive: Any) -> Any:
    """One sample of the radiance that leaves each point."""

    def body(bounce: Any, alive: Any, point: Any, normal: Any, weight: Any, total: Any) -> tuple[Any, ...]:
        sampler = PixelSampler(bounce, inside.key, pairs=3)
        # -- light of the lamp, and reflection
        weight = weight * inside.reflectance
        total = total + weight * _from_lamp(inside, point, normal, *sampler.pair(lane, 0), alive) * (1 / dr.pi)
        # -- roulette
        chance = dr.minimum(weight * (1 / ROULETTE), 1)
        alive = alive & (sampler.pair(lane, 2)[0] < chance)
        weight = dr.select(chance < 1, ROULETTE, weight)
        # -- onward
        local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(*sampler.pair(lane, 1)))
        ray = mi.Ray3f(point + normal * LIFT, mi.Frame3f(normal).to_world(local))
        found = inside.mi_scene.ray_intersect_preliminary(ray, coherent=False, active=alive)
        alive &= found.is_valid()
        met = ray.o + ray.d * dr.select(alive, found.t, 0)
        outward = dr.normalize(mi.Vector3f(met))
        point, normal = mi.Point3f(outward), -outward
        open_wall = (-outward.z < inside.port_cos) & (dr.dot(outward, inside.lamp) < inside.lamp_cos)
        if inside.baffle is not None:
            on_baffle = _is_baffle(inside, found)
            towards = dr.select(dr.dot(inside.facing, ray.d) < 0, inside.facing, -inside.facing)
            point = dr.select(on_baffle, met, point)
            normal = dr.select(on_baffle, towards, normal)
            open_wall |= on_baffle
        return bounce + 1, alive & open_wall, point, normal, weight, total

    lanes = dr.width(lane)
    state = (dr.zeros(mi.UInt32, lanes), alive, point, normal, dr.full(mi.Float, 1, lanes), dr.zeros(mi.Float, lanes))
    return dr.while_loop(state, lambda bounce, alive, *rest: alive, body, label="bounces")[-1]


def _gather(inside: _Inside, sources: _Sources, place: np.ndarray) -> np.ndarray:
    """Irradiance at places of the wall (n, 3) from all sources."""
    count = len(sources.weight)
    block = mi.UInt32(-(-count // BLOCKS))
    last = mi.UInt32(count)
    from_point, from_normal = (uploaded(mi.Float, a.astype(np.float32)) for a in (sources.point, sources.normal))
    from_weight = mi.Float(sources.weight.astype(np.float32))
    dr.make_opaque(block, last)
    lane = dr.arange(mi.UInt32, len(place) * BLOCKS)
    here = dr.gather(mi.Point3f, uploaded(mi.Float, place.astype(np.float32)), lane // BLOCKS)
    facing = -mi.Vector3f(here)
    first = (lane % BLOCKS) * block
    stop = dr.minimum(first + block, last)

    def body(source: Any, total: Any) -> tuple[Any, Any]:
        q = dr.gather(mi.Point3f, from_point, source)
        n_q = dr.gather(mi.Vector3f, from_normal, source)
        seen = _exchange(inside, here, facing, q, n_q, mi.Bool(True))
        return source + 1, total + seen * dr.gather(mi.Float, from_weight, source)

    state = dr.while_loop((first, dr.zeros(mi.Float, dr.width(lane))), lambda s, t: s < stop, body, label="sources")
    return np.array(state[1], np.float64).reshape(len(place), BLOCKS).sum(axis=1)
