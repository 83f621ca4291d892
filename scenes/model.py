"""What a scene is: one merged triangle mesh with a material and an owner for each face, spectra, targets. Plain arrays."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Material:
    """A diffuse surface: spectrum, and the shape of its BRDF about the backscatter (opposition) direction.

    rho(wavelength) is the hemispherical reflectance; the BRDF is rho/pi * (1 + opposition_gain * exp(-phase/opposition_width)),
    phase the angle between the directions to source and receiver. opposition_gain = 0: Lambertian.
    """

    name: str
    wavelength_nm: np.ndarray  # (w,) increasing, covers 400-1700
    reflectance: np.ndarray  # (w,) 0..1
    opposition_gain: float = 0.0
    opposition_width_rad: float = 0.05
    texture_contrast: float = 0.0  # relative standard deviation of a procedural albedo texture; 0 on targets
    texture_scale_m: float = 0.04  # finest wavelength of that texture


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """World frame (ENU, metres). Faces are counter-clockwise seen from outside; normals are geometric."""

    vertices_m: np.ndarray  # (v, 3) float64
    faces: np.ndarray  # (f, 3) int32
    material: np.ndarray  # (f,) int32 index into Scene.materials
    target: np.ndarray  # (f,) int32 index into Scene.targets, -1: ground, stands' owner is the target they carry
    # (f,) int8: frustum face 0-3 inner, 4-7 outer (the side at azimuth + 90 k is k and 4 + k), 8 plate, 9 mark,
    # 10 support or stand, 11 rim; panel top 12; board top 13; -1 else
    part: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Target:
    """A placed target and its true geometry."""

    id: str  # "P01" panels, "F01" frustums, "B01" boards
    kind: str  # "panel" | "frustum" | "board"
    mark_m: np.ndarray  # (3,) world: panel, board: centre of its top face; frustum: centre of the mark
    azimuth_deg: float  # of the target's +y axis, clockwise from the world's +y (true north)
    size_m: float  # edge of a panel or board, or long edge b
    vertex_m: np.ndarray | None = None  # (3,) world: where the stated faces meet
    style: str | None = None
    thickness_m: float | None = None
    vertex_faces: str | None = None  # "inner" | "outer"
    mark_radius_m: float | None = None
    nominal_reflectance_percent: float | None = None
    spectrum: Material | None = None  # panels: its own material (true spectrum)
    material_name: str = ""


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Where the field is that both sensors see, and how targets cover it (6.2.3)."""

    camera_half_m: tuple[float, float]  # half extents of the image on the ground at the lowest height, across x along
    lidar_half_m: float  # half swath at the lowest height
    cone_half_m: float  # H tan 45 deg
    field_half_m: tuple[float, float]  # of the common field that targets cover, world x (east), y (north)


@dataclass(frozen=True, kw_only=True)
class Scene:
    mesh: Mesh
    materials: tuple[Material, ...]
    targets: tuple[Target, ...]
    layout: Layout


@dataclass(frozen=True, kw_only=True)
class SunSky:
    """Light at one instant, world frame.

    Sky radiance follows the CIE clear sky (distribution only), scaled to the diffuse irradiance.
    """

    to_sun: np.ndarray  # (3,) unit vector, world ENU
    elevation_deg: float
    azimuth_deg: float  # clockwise from north
    wavelength_nm: np.ndarray  # (w,)
    direct_normal: np.ndarray  # (w,) [W m-2 nm-1]
    diffuse_horizontal: np.ndarray  # (w,) [W m-2 nm-1]
    illuminance_lx: float  # horizontal, by V(lambda)
