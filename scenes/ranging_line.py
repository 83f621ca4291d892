"""The ranging line of 9.1.2: upright panels on posts at stated distances, side by side, ground and a wall behind them.

Axes: east, north, up about the LiDAR's centre. Who measures the line, and in which axes, is the simulator's business.
"""

from dataclasses import dataclass, replace

import numpy as np

from campaign.config import Config
from campaign.errors import ConfigError
from scenes.model import Layout, Mesh, Scene, Target
from scenes.shapes import Body, body, box, joined
from scenes.spectra import ground_material, material, panel_material

PART_FACE, PART_STAND = 12, 10
THICKNESS_M = 0.02
POST_M = 0.08  # edge of the post, behind the slab
GROUND_M = 1.6  # the LiDAR stands at least so high
BEHIND_M = 8.0  # from the farthest panel to the wall
WALL_M = 2.0  # how far the wall rises above the LiDAR
GAP_DEG = 1.0  # between neighbours, seen from the LiDAR
HEIGHT_SPREAD_M = 0.2  # panels' centres lie so far above or below the LiDAR, at most
FACING_DEG = 1.0  # a panel's normal points to the LiDAR so well
FACET_DEG = 2.0  # of wall and ground
WIDEST_DEG = 150.0
_GROUND, _WALL, _METAL = 0, 1, 2  # materials; the panels' follow


@dataclass(frozen=True, kw_only=True)
class LinePanel:
    """One panel as it stands."""

    id: str
    centre_m: np.ndarray  # (3,) of its face
    normal: np.ndarray  # (3,) of its face, towards the LiDAR
    size_m: float


@dataclass(frozen=True, kw_only=True)
class RangingScene:
    """Everything along the line."""

    scene: Scene
    panels: tuple[LinePanel, ...]
    farthest_m: float  # of any surface
    corners_m: np.ndarray  # (panels, 4, 3) of the faces


def build_line(config: Config, rng: np.random.Generator) -> RangingScene:
    """Panels R01... in the order of their distances, shuffled in azimuth about north.

    Raises
    ------
    ConfigError
        Panels that do not fit side by side, or a distance that stands twice.
    """
    ranging = config.ranging
    distance = np.sort(np.asarray(ranging.distances_m, np.float64))
    if np.any(np.diff(distance) < 0.5 * ranging.panel_size_m):
        raise ConfigError(
            "two panels stand at the same distance",
            where="ranging.distances_m",
            got=[float(d) for d in distance],
            expected=f"at least {0.5 * ranging.panel_size_m:g} m from one to the next",
        )
    centre, normal = _places(distance, ranging.panel_size_m, rng)
    ground_m = -max(GROUND_M, 0.5 * ranging.panel_size_m + HEIGHT_SPREAD_M + 0.5)
    materials = [ground_material(config.site), material("concrete"), material("metal_stand")]
    bodies, targets, panels, corners = [], [], [], []
    for k in range(len(distance)):
        name = f"R{k + 1:02d}"
        surface = panel_material(
            ranging.panel_reflectance_percent,
            config.targets.panels.material,
            rng,
            config.targets.panels.spectrum_std,
        )
        surface = replace(surface, name=f"panel_{name}")
        piece, corner = _panel(centre[k], normal[k], ranging.panel_size_m, ground_m, len(materials))
        materials.append(surface)
        bodies.append(piece)
        corners.append(corner)
        panels.append(LinePanel(id=name, centre_m=centre[k], normal=normal[k], size_m=ranging.panel_size_m))
        targets.append(
            Target(
                id=name,
                kind="panel",
                mark_m=centre[k],
                azimuth_deg=float(np.degrees(np.arctan2(normal[k][0], normal[k][1]))),
                size_m=ranging.panel_size_m,
                nominal_reflectance_percent=ranging.panel_reflectance_percent,
                spectrum=surface,
                material_name=config.targets.panels.material,
            )
        )
    azimuth = np.degrees(np.arctan2(centre[:, 0], centre[:, 1]))
    side = np.degrees(ranging.panel_size_m / distance)
    span = (float(np.min(azimuth - side)) - 3.0, float(np.max(azimuth + side)) + 3.0)
    radius = float(distance[-1]) + BEHIND_M
    surroundings = _surroundings(span, radius, ground_m)
    whole = joined([surroundings, *bodies])
    owner = np.repeat(np.arange(-1, len(bodies)), [len(surroundings.faces), *(len(b.faces) for b in bodies)])
    return RangingScene(
        scene=Scene(
            mesh=Mesh(
                vertices_m=whole.vertices_m,
                faces=whole.faces,
                material=whole.material,
                target=owner.astype(np.int32),
                part=whole.part,
            ),
            materials=tuple(materials),
            targets=tuple(targets),
            layout=Layout(camera_half_m=(0.0, 0.0), lidar_half_m=0.0, cone_half_m=0.0, field_half_m=(0.0, 0.0)),
        ),
        panels=tuple(panels),
        farthest_m=float(np.hypot(radius, max(-ground_m, WALL_M))),
        corners_m=np.stack(corners),
    )


def turned(scene: Scene, rotation: np.ndarray) -> Scene:
    """The scene in other axes: (3, 3) applied to every vertex."""
    mesh = scene.mesh
    return replace(scene, mesh=replace(mesh, vertices_m=np.einsum("ij,vj->vi", rotation, mesh.vertices_m)))


def _places(distance: np.ndarray, size_m: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(panels, 3) centres and (panels, 3) normals."""
    count = len(distance)
    order = rng.permutation(count)
    rise = rng.uniform(-HEIGHT_SPREAD_M, HEIGHT_SPREAD_M, count)
    lean = np.radians(rng.uniform(-FACING_DEG, FACING_DEG, (count, 2)) / np.sqrt(2.0))
    half = np.degrees(np.arctan(0.5 * size_m / distance))[order]
    total = float(2.0 * half.sum() + GAP_DEG * (count - 1))
    if total > WIDEST_DEG or distance[0] < size_m:
        raise ConfigError(
            "the panels do not fit side by side",
            where="ranging.distances_m",
            got=f"{total:.0f} degrees, the nearest at {distance[0]:g} m",
            expected=f"at most {WIDEST_DEG:g} degrees, and no panel nearer than its size",
            remedy="take smaller panels or fewer near ones",
        )
    middle = np.cumsum(2.0 * half + GAP_DEG) - half - GAP_DEG - 0.5 * total
    azimuth = np.empty(count)
    azimuth[order] = np.radians(middle)
    elevation = np.arcsin(rise / distance)
    flat = np.cos(elevation)
    centre = distance[:, None] * np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], axis=-1)
    a, e = azimuth + np.pi + lean[:, 0], -elevation + lean[:, 1]
    normal = np.stack([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)], axis=-1)
    return centre, normal


def _panel(
    centre_m: np.ndarray, normal: np.ndarray, size_m: float, ground_m: float, surface: int
) -> tuple[Body, np.ndarray]:
    """A slab whose face has the material `surface`, on a post behind it; and the (4, 3) corners of the face."""
    half = 0.5 * size_m
    slab = box((-half, -THICKNESS_M, -half), (half, 0.0, half), _METAL, -1)
    slab.material[4:6], slab.part[4:6] = surface, PART_FACE  # the side that faces +y
    right = np.cross(normal, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, normal, np.cross(right, normal)], axis=1)
    corner = np.array([[-half, 0, -half], [half, 0, -half], [half, 0, half], [-half, 0, half]]) @ axes.T + centre_m
    back = THICKNESS_M + 0.02
    post = box((-0.5 * POST_M, -back - POST_M, ground_m - centre_m[2]), (0.5 * POST_M, -back, 0.0), _METAL, PART_STAND)
    # the post stands upright: turned about the vertical only
    level = np.array([normal[0], normal[1], 0.0]) / np.hypot(normal[0], normal[1])
    upright = np.stack([right, level, [0.0, 0.0, 1.0]], axis=1)
    pieces = [replace(slab, vertices_m=slab.vertices_m @ axes.T), replace(post, vertices_m=post.vertices_m @ upright.T)]
    whole = joined(pieces)
    return replace(whole, vertices_m=whole.vertices_m + centre_m), corner


def _surroundings(span_deg: tuple[float, float], radius_m: float, ground_m: float) -> Body:
    """A level fan of ground below the LiDAR, and a wall along its far edge that stops every beam."""
    facets = int(np.ceil((span_deg[1] - span_deg[0]) / FACET_DEG))
    azimuth = np.radians(np.linspace(*span_deg, facets + 1))
    edge = radius_m * np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
    low = np.column_stack([edge, np.full(facets + 1, ground_m)])
    high = np.column_stack([edge, np.full(facets + 1, WALL_M)])
    k = np.arange(facets)
    apex, first, top = 0, 1, facets + 2
    fan = np.stack([np.full(facets, apex), first + k + 1, first + k], axis=1)
    wall = np.concatenate(
        [
            np.stack([first + k, first + k + 1, top + k + 1], axis=1),
            np.stack([first + k, top + k + 1, top + k], axis=1),
        ]
    )
    kind = np.repeat([_GROUND, _WALL], [len(fan), len(wall)])
    return body(np.concatenate([[[0.0, 0.0, ground_m]], low, high]), np.concatenate([fan, wall]), kind, -1)
