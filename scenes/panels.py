"""Reflectance panels (6.2.2 a-b, 8.1.2 a): a levelled slab on a stand. Its spectrum comes from `spectra`."""

import numpy as np

from campaign.config import Panels
from scenes.shapes import Body, box, joined

PART_TOP, PART_STAND, PART_SIDE = 12, 10, -1
STAND_SHARE = 0.4  # edge of the stand's column over the panel's
OVERLAP_M = 0.001  # the column reaches this far into the slab


def panel_body(panels: Panels, surface: int, metal: int, stand_m: float) -> Body:
    """One panel; origin at the centre of its top face, z up. The stand's column reaches `stand_m` below the top face.

    Only the top face carries the panel's own material `surface`; sides and stand are `metal`.
    """
    half, t = 0.5 * panels.size_m, panels.thickness_m
    slab = box((-half, -half, -t), (half, half, 0.0), metal, PART_SIDE)
    slab.material[:2] = surface
    slab.part[:2] = PART_TOP
    if stand_m <= t:
        return slab
    column = STAND_SHARE * half
    return joined([slab, box((-column, -column, -stand_m), (column, column, OVERLAP_M - t), metal, PART_STAND)])


def half_diagonal_m(panels: Panels) -> float:
    """Radius of the circle around a panel. [m]"""
    return float(panels.size_m / np.sqrt(2.0))
