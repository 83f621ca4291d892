"""2x2 boards (the patent's S1): a levelled slab on a low stand, its top cut into four squares, black and white by turns.

Target frame: origin at the centre of the top face, x right, y along the board's azimuth, z up. White where x and y have the
same sign, like the mark of a frustum target. Where a board stands is `layout`'s subject.
"""

import numpy as np

from campaign.config import Boards
from scenes.shapes import Body, body, box, joined, quads_to_triangles

PART_TOP, PART_STAND, PART_SIDE = 13, 10, -1
STAND_SHARE = 0.4  # edge of the stand's column over the board's
OVERLAP_M = 0.001  # the column reaches this far into the slab


def board_body(boards: Boards, white: int, black: int, metal: int, stand_m: float) -> Body:
    """One board; the stand's column reaches `stand_m` below the top face.

    Parameters
    ----------
    boards : Boards
    white, black, metal : int
        Indices into the scene's materials: two squares each, sides and stand.
    stand_m : float
        From the top face down. [m]
    """
    half, t = 0.5 * boards.size_m, boards.thickness_m
    axis = np.array([-half, 0.0, half])
    grid = np.array([[x, y, 0.0] for y in axis for x in axis])  # 3 i + j: row i along y, column j along x
    low = np.array([[x, y, -t] for x, y in ((-half, -half), (half, -half), (half, half), (-half, half))])
    vertices = np.concatenate([grid, low])
    first = np.array([0, 1, 3, 4])  # lower left corners of the squares: - -, + -, - +, + +
    top = quads_to_triangles(np.stack([first, first + 1, first + 4, first + 3], axis=1))
    # a side: two corners below, the same above and the middle between them, which the squares' border meets
    sides = [(9, 10, 2, 1, 0), (10, 11, 8, 5, 2), (11, 12, 6, 7, 8), (12, 9, 0, 3, 6)]
    around = [tri for a, b, c, m, d in sides for tri in ((a, b, m), (b, c, m), (m, d, a))]
    bottom = [(9, 12, 11), (9, 11, 10)]
    colour = np.repeat([white, black, black, white], 2)
    slab = body(
        vertices,
        np.concatenate([top, around, bottom]),
        np.concatenate([colour, np.full(len(around) + 2, metal)]),
        np.concatenate([np.full(8, PART_TOP), np.full(len(around) + 2, PART_SIDE)]),
    )
    if stand_m <= t:
        return slab
    column = STAND_SHARE * half
    return joined([slab, box((-column, -column, -stand_m), (column, column, OVERLAP_M - t), metal, PART_STAND)])


def half_diagonal_m(boards: Boards) -> float:
    """Radius of the circle around a board. [m]"""
    return float(boards.size_m / np.sqrt(2.0))
