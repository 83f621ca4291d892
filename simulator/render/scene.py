"""A scene as Mitsuba sees it: one merged mesh, and tables that give each face its material, owner and part."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from scenes.model import Scene
from simulator.render import start
from simulator.render.upload import uploaded

start()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402


@dataclass(frozen=True, kw_only=True)
class RenderScene:
    """Mitsuba's scene and per-face tables on its device. `si.prim_index` of a hit is the index into every table."""

    mi_scene: Any
    material: Any  # mi.UInt32 (f,)
    target: Any  # mi.Int32 (f,)
    part: Any  # mi.Int32 (f,)
    normal: Any  # mi.Float (3 f,) unit normals, x y z interleaved
    scene: Scene


def load_scene(scene: Scene) -> RenderScene:
    """Build Mitsuba's acceleration structure and upload the tables.

    Vertices are rounded to single precision here: keep the world within +-2 km of the site's origin.
    """
    mesh = scene.mesh
    vertices = mesh.vertices_m.astype(np.float32)
    mi_mesh = mi.Mesh("range", len(vertices), len(mesh.faces))
    params = mi.traverse(mi_mesh)
    params["vertex_positions"] = uploaded(mi.Float, vertices)
    params["faces"] = uploaded(mi.UInt32, mesh.faces.astype(np.uint32))
    params.update()
    corner = mesh.vertices_m[mesh.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tables = RenderScene(
        mi_scene=mi.load_dict({"type": "scene", "range": mi_mesh}),
        material=uploaded(mi.UInt32, mesh.material.astype(np.uint32)),
        target=uploaded(mi.Int32, mesh.target.astype(np.int32)),
        part=uploaded(mi.Int32, mesh.part.astype(np.int32)),
        normal=uploaded(mi.Float, normal.astype(np.float32)),
        scene=scene,
    )
    dr.eval(tables.material, tables.target, tables.part, tables.normal)
    return tables
