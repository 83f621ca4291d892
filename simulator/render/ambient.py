"""Light among the faces of a frustum target, from a table: white sheet metal in the sun lights its own mark.

One reflected ray a sample leaves the inside of a funnel several times noisier than the sensor, and a thousand samples a
pixel would cost more than the rest of the picture. The irradiance that sky and surroundings send to a flat face is smooth,
so it is computed once on a grid over each face and read from there; the direct sun, its shadows and all edges stay exact.
Tables hold for a small range of sun directions (SUN_STEP), direct and diffuse light apart, and serve every frame in it.
Panels and ground are level and open: they need no table and have none.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from campaign.config import Camera
from scenes.model import Scene, SunSky
from scenes.sunsky import band_irradiance
from simulator.render import start
from simulator.render.paths import PAIRS, AmbientTable, Surfaces, gathered, light_from, surfaces
from simulator.render.sampling import PixelSampler
from simulator.render.scene import RenderScene
from simulator.render.upload import uploaded

start()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

NODES = 13  # of the grid over a face, each way: 7 cm on a plate of 0.9 m
SAMPLES = 2048  # a node, a power of two: half of it left faces noisier than the sensor of 50 000 electrons allows
SUN_STEP = 0.02  # of the sun's direction vector: 1.1 degrees at most
AMBIENT_KEY = (9, 0)  # the renderer's stream; frames have a sortie, from 1, in the second place
LIFT_M = 5e-4  # a node above its plane
INWARD = 0.01  # nodes at the border of a face move this share of the way to its centre
KEPT = 4  # tables in memory: sun directions of a flight
INNER_FACES, ALL_FACES, PLATE_AND_MARK = range(4), range(8), (8, 9)


@dataclass(frozen=True)
class _Facets:
    face: np.ndarray  # (f,) facet of each mesh face, -1 none
    origin: np.ndarray  # (k, 3) corner of the grid
    across: np.ndarray  # (k, 2, 3) edges of the grid [m]
    normal: np.ndarray  # (k, 3)
    node: np.ndarray  # (k, NODES * NODES, 3) on the face


def _nearest_inside(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Nearest points of a union of triangles in the plane: (n, 2), (t, 3, 2) -> (n, 2)."""
    start_, edge = triangles, np.roll(triangles, -1, axis=1) - triangles
    to_point = points[:, None, None] - start_  # (n, t, 3, 2)
    side = edge[..., 0] * to_point[..., 1] - edge[..., 1] * to_point[..., 0]
    inside = ((side >= 0).all(axis=2) | (side <= 0).all(axis=2)).any(axis=1)
    length2 = np.maximum((edge**2).sum(axis=-1), 1e-18)
    along = np.clip((to_point * edge).sum(axis=-1) / length2, 0, 1)
    foot = start_ + along[..., None] * edge
    distance = ((points[:, None, None] - foot) ** 2).sum(axis=-1).reshape(len(points), -1)
    nearest = foot.reshape(len(points), -1, 2)[np.arange(len(points)), distance.argmin(axis=1)]
    return np.asarray(np.where(inside[:, None], points, nearest))


def facets(scene: Scene) -> _Facets:
    """Flat parts of frustum targets that a camera above sees: inner faces and plate, of upright ones all faces."""
    mesh = scene.mesh
    face = np.full(len(mesh.faces), -1, np.int32)
    origins: list[np.ndarray] = []
    edges, normals, nodes = [], [], []
    for index, target in enumerate(scene.targets):
        if target.kind != "frustum":
            continue
        # The upright funnel stands on its plate: a grid across the foot of a wall would leak light, so that plate has none.
        inverted = target.style == "inverted"
        groups = [(part,) for part in (INNER_FACES if inverted else ALL_FACES)] + ([PLATE_AND_MARK] if inverted else [])
        for parts in groups:
            member = np.flatnonzero((mesh.target == index) & np.isin(mesh.part, parts))
            if len(member) == 0:
                continue
            corner = mesh.vertices_m[mesh.faces[member]]
            n = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
            area = np.linalg.norm(n, axis=1)
            n /= area[:, None]
            # Of a plate: its top.
            level = (corner * n[:, None]).sum(axis=-1).mean(axis=1)
            chosen = int(np.argmax(area)) if parts != PLATE_AND_MARK else int(np.argmax(n[:, 2] + 1e-3 * level))
            flat = (n @ n[chosen] > 1 - 1e-6) & (np.abs(level - level[chosen]) < 1e-3)
            member, corner, normal = member[flat], corner[flat], n[chosen]
            sides = (np.roll(corner, -1, axis=1) - corner).reshape(-1, 3)
            u = sides[np.argmax(np.linalg.norm(sides, axis=1))]
            u = u / np.linalg.norm(u)
            basis = np.stack([u, np.cross(normal, u)])  # (2, 3)
            base = corner[0, 0]
            plane = (corner - base) @ basis.T
            low, high = plane.min(axis=(0, 1)), plane.max(axis=(0, 1))
            step = np.linspace(0, 1, NODES)
            grid = low + np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2) * (high - low)
            centre = plane.mean(axis=(0, 1))
            inside = _nearest_inside(grid, plane)
            inside += INWARD * (centre - inside)
            face[member] = len(origins)
            origins.append(base + low @ basis)
            edges.append(basis * (high - low)[:, None])
            normals.append(normal)
            nodes.append(base + inside @ basis)
    count = len(origins)
    return _Facets(
        face=face,
        origin=np.array(origins).reshape(count, 3),
        across=np.array(edges).reshape(count, 2, 3),
        normal=np.array(normals).reshape(count, 3),
        node=np.array(nodes).reshape(count, NODES * NODES, 3),
    )


def _coefficients(
    render_scene: RenderScene, camera: Camera, flat: _Facets, to_sun: np.ndarray, bounces: int, seed: int
) -> np.ndarray:
    """(nodes, 2, bands): irradiance / pi for unit direct normal and for unit diffuse horizontal irradiance."""
    bands = len(camera.bands)
    doubled: Surfaces = surfaces(render_scene, camera, repeat=2)
    light = light_from(to_sun, [1.0] * bands + [0.0] * bands, [0.0] * bands + [1.0] * bands)
    words = np.random.SeedSequence([seed, *AMBIENT_KEY, *_rounded(to_sun, offset=1 << 20)]).generate_state(2)
    key = mi.UInt32(int(words[0])), mi.UInt32(int(words[1]))
    count = mi.UInt32(SAMPLES)
    dr.make_opaque(key, count)
    normal = np.repeat(flat.normal, NODES * NODES, axis=0)
    place = flat.node.reshape(-1, 3) + LIFT_M * normal
    point = mi.Point3f(*(uploaded(mi.Float, c.astype(np.float32)) for c in place.T))
    upward = mi.Vector3f(*(uploaded(mi.Float, c.astype(np.float32)) for c in normal.T))
    sampler = PixelSampler(dr.arange(mi.UInt32, len(place)), key, pairs=2 + PAIRS * (bounces + 1))

    def body(sample: Any, *total: Any) -> tuple[Any, ...]:
        value = gathered(render_scene, doubled, light, bounces, 0, sampler, sample, point, upward, mi.Bool(True))
        return (sample + 1, *(t + v for t, v in zip(total, value, strict=True)))

    state = dr.while_loop(
        (dr.zeros(mi.UInt32, len(place)), *(dr.zeros(mi.Float, len(place)) for _ in range(2 * bands))),
        lambda sample, *total: sample < count,
        body,
        label="ambient",
    )
    mean = [total * (1 / SAMPLES) for total in state[1:]]
    dr.eval(mean)
    return np.stack([np.asarray(m) for m in mean], axis=-1).reshape(-1, 2, bands)


def _rounded(to_sun: np.ndarray, offset: int = 0) -> tuple[int, ...]:
    return tuple(int(c) + offset for c in np.rint(np.asarray(to_sun) / SUN_STEP))


_kept: list[tuple[RenderScene, object, _Facets, np.ndarray]] = []


def ambient_table(
    render_scene: RenderScene, camera: Camera, light: SunSky, bounces: int, seed: int
) -> AmbientTable | None:
    """The table for a frame's light; None where the scene has no frustum target.

    The same light gives the same table whatever was rendered before: what is kept from frame to frame saves time only.
    """
    key = (_rounded(light.to_sun), tuple((b.centre_nm, b.fwhm_nm) for b in camera.bands), bounces, seed)
    for entry in _kept:
        if entry[0] is render_scene and entry[1] == key:
            break
    else:
        flat = facets(render_scene.scene)
        towards = np.array(key[0]) * SUN_STEP
        found = (
            _coefficients(render_scene, camera, flat, towards / np.linalg.norm(towards), bounces, seed)
            if len(flat.origin)
            else np.zeros((0, 2, len(camera.bands)))
        )
        entry = (render_scene, key, flat, found)
        _kept.append(entry)
        del _kept[:-KEPT]
    _, _, flat, coefficient = entry
    if len(flat.origin) == 0:
        return None
    irradiance = np.array([band_irradiance(light, band) for band in camera.bands]).T  # (2, bands)
    value = (coefficient * irradiance).sum(axis=1)
    # Vectors with length 1 / extent: their products with a place on the grid run from 0 to 1.
    inverse = flat.across / (flat.across**2).sum(axis=-1, keepdims=True)
    frame = np.concatenate([flat.origin[:, None], inverse], axis=1)
    table = AmbientTable(
        facet=uploaded(mi.Int32, flat.face.astype(np.int32)),
        frame=uploaded(mi.Float, frame.astype(np.float32)),
        value=uploaded(mi.Float, value.astype(np.float32)),
        nodes=NODES,
    )
    dr.eval(table.facet, table.frame, table.value)
    return table
