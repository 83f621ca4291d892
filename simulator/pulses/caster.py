"""A scene and a LiDAR, ready to be asked what beams see of it. The kernels are `fan`, `surface` and `cone`."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from scenes.model import Mesh
from simulator.lidar.footprint import Footprint, Optics, gaussian_footprint
from simulator.lidar.radar_equation import SPEED_OF_LIGHT_M_S
from simulator.pulses.cone import see_mixed
from simulator.pulses.fan import touch
from simulator.pulses.rows import true_surfaces
from simulator.pulses.surface import see_surfaces
from simulator.pulses.tree import tree_of

FEW = 61  # sub-rays where a footprint's triangles are one creased surface


@dataclass(frozen=True, kw_only=True)
class Seen:
    """Echoes of n beams before noise. Rows are triangles in the order of the tree: `Caster.face` has their numbers."""

    echo: np.ndarray  # (e, 3) float64: peak [DN], range [m], added variance [m2]
    first: np.ndarray  # (n,) int64: of each pulse's rows in `echo`
    count: np.ndarray  # (n,) int32: of its rows; 0: nothing is hit
    extent_m: np.ndarray  # (n, 3) float64: innermost, nearest and farthest sub-ray that hits; NaN: none
    axis_row: np.ndarray  # (n,) int64 triangle that the innermost hits, -1
    slot: np.ndarray  # (n,) int32: row in the next two where surfaces of one footprint lie apart, else -1
    hit_m: np.ndarray  # (k, s) float32: range of each sub-ray
    hit_row: np.ndarray  # (k, s) int32: its triangle, -1 where nothing is hit


def _rays(pattern: Footprint) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """u, v, length of the sub-ray's direction, and share of the energy over its cube; single precision."""
    u, v = np.ascontiguousarray(pattern.offset.T, np.float32)
    length = np.sqrt(1.0 + u.astype(np.float64) ** 2 + v.astype(np.float64) ** 2)
    return u, v, length.astype(np.float32), (pattern.weight / length**3).astype(np.float32)


class Caster:
    """Tables are made once; `see` may be called from several threads."""

    def __init__(self, mesh: Mesh, backscatter: np.ndarray, optics: Optics) -> None:
        """`backscatter`: (materials,) pi times the BRDF towards the source at the laser line."""
        tree = tree_of(mesh.vertices_m, mesh.faces)
        pattern = optics.footprint
        offset = pattern.offset.astype(np.float32)
        self.face = tree.face  # number in the mesh of each row of the tree
        self._about = (
            tree.normal,
            mesh.target.astype(np.int32),
            np.where(mesh.part <= 9, mesh.part, -1).astype(np.int8),
        )
        self._touch = (tree.box.ravel(), tree.level, tree.block.ravel(), len(tree.corner))
        self._reach = float(np.hypot(offset[:, 0], offset[:, 1]).max())
        rho = np.ascontiguousarray(backscatter[mesh.material[tree.face]], np.float64)
        power = (optics.scale_dn_m2, optics.extinction_per_m, 0.5e-9 * SPEED_OF_LIGHT_M_S * optics.echo_sigma_ns)
        few = gaussian_footprint(FEW, 4.0 * pattern.spread_rad) if len(pattern.weight) > FEW else pattern
        self._surfaces: tuple[Any, ...] = (tree.corner, tree.plane, rho, self._reach, pattern.spread_rad, *power)
        self._mixed: tuple[Any, ...] = (tree.corner, tree.plane, rho, _rays(few), _rays(pattern), *power)

    def see(self, origin_m: np.ndarray, direction: np.ndarray, stride: int = 1) -> Seen:
        """(n, 3) and (n, 3) float64; pulses i and i + stride are neighbours."""
        touch_first, touch_count, touch_row, whole = touch(origin_m, direction, stride, self._reach, *self._touch)
        touched = (touch_first, touch_count, touch_row)
        echo, echoes, first, count, extent_m, axis_row, left = see_surfaces(
            origin_m, direction, *touched, whole, *self._surfaces
        )
        echo, slot, hit_m, hit_row = see_mixed(
            origin_m, direction, left, *touched, echo, echoes, first, count, extent_m, axis_row, *self._mixed
        )
        return Seen(
            echo=echo,
            first=first,
            count=count,
            extent_m=extent_m,
            axis_row=axis_row,
            slot=slot,
            hit_m=hit_m,
            hit_row=hit_row,
        )

    def truth(
        self, seen: Seen, pulse: np.ndarray, siblings: np.ndarray, range_m: np.ndarray, shift_m: np.ndarray
    ) -> dict[str, np.ndarray]:
        """`TrueReturns` of r returns: of the surface at the beam's axis, or where surfaces lie apart of the sub-ray nearest in
        range; a single return close to the axis' surface is that surface's.

        Parameters
        ----------
        seen : Seen
        pulse, siblings : (r,) ndarray
            Of each return; how many returns its pulse has.
        range_m : (r,) ndarray
            Where the device saw it. [m]
        shift_m : (n,) ndarray
            How much too far away, of each pulse. [m]
        """
        rows = len(pulse)
        out = (np.empty(rows), np.empty((rows, 3), np.float32), np.empty(rows, np.int32), np.empty(rows, np.int8))
        which = (pulse, siblings, range_m, shift_m, seen.extent_m, seen.axis_row, seen.slot, seen.hit_m, seen.hit_row)
        true_surfaces(*which, self.face, *self._about, *out)
        return dict(zip(("range_m", "normal_world", "target", "face"), out, strict=True))
