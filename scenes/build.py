"""Config -> Scene: ground, targets and materials in one mesh. The same seed gives the same scene."""

from dataclasses import replace

import numpy as np

from campaign.config import Config
from scenes.boards import board_body
from scenes.frustums import (
    PLATE_THICKNESS_M,
    FrustumMaterials,
    frustum_body,
    plate_edge_m,
    vertex_faces,
    vertex_offset_m,
)
from scenes.layout import BORDER_M, Spot, place_targets
from scenes.model import Material, Mesh, Scene, Target
from scenes.panels import panel_body
from scenes.shapes import Body, placed
from scenes.spectra import ground_material, material, panel_material
from scenes.streams import LAYOUT, SPECTRA, TERRAIN, stream
from scenes.terrain import Terrain, make_terrain, terrain_mesh

STAND_DEPTH_M = 0.1  # a stand's column reaches this far below the lowest ground under its target


def _ground_under(terrain: Terrain, spot: Spot, radius_m: float) -> tuple[float, float]:
    """Lowest and highest ground within a square about a spot. [m]"""
    offset = np.linspace(-radius_m, radius_m, 9)
    dx, dy = np.meshgrid(offset, offset)
    height = terrain.height(spot.x_m + dx, spot.y_m + dy)
    return float(height.min()), float(height.max())


def _panel(config: Config, spot: Spot, name: str, surface: Material, terrain: Terrain) -> tuple[Target, float]:
    """The target, and how far its stand reaches below its top face."""
    panels = config.targets.panels
    low, high = _ground_under(terrain, spot, panels.size_m / np.sqrt(2.0))
    top = high + spot.stand_height_m + panels.thickness_m
    target = Target(
        id=name,
        kind="panel",
        mark_m=np.array([spot.x_m, spot.y_m, top]),
        azimuth_deg=spot.azimuth_deg,
        size_m=panels.size_m,
        nominal_reflectance_percent=spot.level_percent,
        spectrum=surface,
        material_name=panels.material,
    )
    return target, top - low + STAND_DEPTH_M


def _frustum(config: Config, spot: Spot, name: str, terrain: Terrain) -> tuple[Target, float]:
    """The target, and how far its stand reaches below its mark."""
    frustums = config.targets.frustums
    low, high = _ground_under(terrain, spot, plate_edge_m(frustums) / np.sqrt(2.0))
    mark = np.array([spot.x_m, spot.y_m, high + spot.stand_height_m + PLATE_THICKNESS_M])
    target = Target(
        id=name,
        kind="frustum",
        mark_m=mark,
        azimuth_deg=spot.azimuth_deg,
        size_m=frustums.long_edge_m,
        vertex_m=mark + np.array([0.0, 0.0, vertex_offset_m(frustums)]),
        style=frustums.style,
        thickness_m=frustums.thickness_m,
        vertex_faces=vertex_faces(frustums),
        mark_radius_m=frustums.mark_radius_m,
        material_name=frustums.material,
    )
    return target, float(mark[2]) - low + STAND_DEPTH_M


def _board(config: Config, spot: Spot, name: str, terrain: Terrain) -> tuple[Target, float]:
    """The target, and how far its stand reaches below its top face."""
    boards = config.targets.boards
    low, high = _ground_under(terrain, spot, boards.size_m / np.sqrt(2.0))
    top = high + spot.stand_height_m + boards.thickness_m
    target = Target(
        id=name,
        kind="board",
        mark_m=np.array([spot.x_m, spot.y_m, top]),
        azimuth_deg=spot.azimuth_deg,
        size_m=boards.size_m,
        material_name=config.targets.frustums.material,
    )
    return target, top - low + STAND_DEPTH_M


def _merged(ground: tuple[np.ndarray, np.ndarray], bodies: list[Body]) -> Mesh:
    """Ground first (material 0, no owner), then the targets in order."""
    vertices, faces = [ground[0]], [ground[1]]
    material_index = [np.zeros(len(ground[1]), dtype=np.int32)]
    owner, part = [np.full(len(ground[1]), -1, dtype=np.int32)], [np.full(len(ground[1]), -1, dtype=np.int8)]
    count = len(ground[0])
    for index, piece in enumerate(bodies):
        vertices.append(piece.vertices_m)
        faces.append(piece.faces + np.int32(count))
        material_index.append(piece.material)
        owner.append(np.full(len(piece.faces), index, dtype=np.int32))
        part.append(piece.part)
        count += len(piece.vertices_m)
    return Mesh(
        vertices_m=np.concatenate(vertices),
        faces=np.concatenate(faces).astype(np.int32),
        material=np.concatenate(material_index),
        target=np.concatenate(owner),
        part=np.concatenate(part),
    )


def site_terrain(config: Config) -> Terrain:
    """The ground of a campaign as a closed form."""
    return make_terrain(config.site, stream(config.seed, TERRAIN))


def build_scene(config: Config) -> Scene:
    """Everything that stands on the range.

    Returns
    -------
    Scene
        Targets: panels P01..., then frustums F01..., then boards B01..., each in the order of the layout's grid. Materials:
        ground, metal, plate, coating of the faces, white and black of marks and boards, then one for each panel.

    Raises
    ------
    ConfigError
        Targets do not fit (6.2.3), a size is impossible, or a material is unknown.
    """
    site, frustums = config.site, config.targets.frustums
    ground = replace(
        ground_material(site), texture_contrast=site.texture_contrast, texture_scale_m=site.texture_scale_m
    )
    coating = material(frustums.material)
    materials = [
        ground,
        material("metal_stand"),
        material("grey_paint"),
        coating,
        replace(coating, name="mark_white"),
        replace(material("black_paint"), name="mark_black"),
    ]
    indices = FrustumMaterials(metal=1, plate=2, face=3, white=4, black=5)

    terrain = site_terrain(config)
    layout, spots = place_targets(config, stream(config.seed, LAYOUT))
    rng = stream(config.seed, SPECTRA)
    targets: list[Target] = []
    bodies: list[Body] = []
    numbers = {"panel": 0, "frustum": 0, "board": 0}
    width = max(2, len(str(len(spots))))
    for spot in spots:
        numbers[spot.kind] += 1
        name = f"{spot.kind[0].upper()}{numbers[spot.kind]:0{width}d}"
        if spot.level_percent is not None:
            panels = config.targets.panels
            surface = panel_material(spot.level_percent, panels.material, rng, panels.spectrum_std)
            surface = replace(surface, name=f"panel_{name}")
            target, depth = _panel(config, spot, name, surface, terrain)
            piece = panel_body(panels, len(materials), indices.metal, depth)
            materials.append(surface)
        elif spot.kind == "board":
            target, depth = _board(config, spot, name, terrain)
            piece = board_body(config.targets.boards, indices.white, indices.black, indices.metal, depth)
        else:
            target, depth = _frustum(config, spot, name, terrain)
            piece = frustum_body(frustums, indices, depth)
        targets.append(target)
        bodies.append(placed(piece, target.mark_m, target.azimuth_deg))
    fine = (layout.field_half_m[0] + BORDER_M, layout.field_half_m[1] + BORDER_M)
    return Scene(
        mesh=_merged(terrain_mesh(terrain, site.extent_m, fine), bodies),
        materials=tuple(materials),
        targets=tuple(targets),
        layout=layout,
    )
