"""The chessboard of the geometric bench (9.2.2) and the one lamp of its dark room (6.3.2 b). Plain data, no rendering.

Board frame (campaign.benches.bench.BoardSheet): origin at inner corner (0, 0), x along a row, y down, z away from the camera; the
board is a plane rectangle in z = 0. The square in the upper left corner of the pattern is black. Surfaces are grey and
Lambertian, so that a picture in one band is a picture in any other, scaled by the lamp's spectrum.
"""

from dataclasses import dataclass

import numpy as np

from campaign.config import Band, Chessboard
from campaign.errors import ConfigError
from scenes.model import Layout, Material, Mesh, Scene
from scenes.sunsky import illuminance_lx

WHITE, BLACK, WALL = 0, 1, 2  # Scene.materials
MAX_BOARD_M = 1.5  # a board that can be made flat and carried
PART_BOARD = 12

LAMP_CAMERA_M = np.array([0.0, -0.4, 0.0])  # beside the camera, above it; camera axes
LAMP_RADIUS_M = 0.03  # an opal globe: small, spherical, Lambertian
LAMP_TEMPERATURE_K = 4000.0
LAMP_FLUX_LM = 20_000.0  # a studio lamp
_NM = np.arange(380.0, 1101.0, 2.0)


@dataclass(frozen=True, kw_only=True)
class Board:
    """Geometry of a board."""

    columns: int  # of squares
    rows: int
    square_m: float
    margin_m: float

    @property
    def width_m(self) -> float:
        return self.columns * self.square_m + 2 * self.margin_m

    @property
    def height_m(self) -> float:
        return self.rows * self.square_m + 2 * self.margin_m

    @property
    def centre_m(self) -> np.ndarray:
        """(2,) of the whole board, board frame."""
        return 0.5 * self.square_m * np.array([self.columns - 2, self.rows - 2])

    @property
    def low_m(self) -> np.ndarray:
        """(2,) upper left corner of the whole board, board frame."""
        return np.full(2, -self.square_m - self.margin_m)

    @property
    def high_m(self) -> np.ndarray:
        """(2,) lower right corner of the whole board, board frame."""
        return self.low_m + [self.width_m, self.height_m]

    def corner_index(self) -> np.ndarray:
        """(n, 2) column and row of every inner corner, row by row."""
        column, row = np.meshgrid(np.arange(self.columns - 1), np.arange(self.rows - 1))
        return np.stack([column.ravel(), row.ravel()], axis=-1)

    def corners_m(self) -> np.ndarray:
        """(n, 2) inner corners, board frame. [m]"""
        return self.corner_index() * self.square_m

    def outline_m(self, points: int = 25) -> np.ndarray:
        """(4 points, 2) along the edges of the whole board, margin included. [m]"""
        share = np.linspace(0.0, 1.0, points, endpoint=False)[:, None]
        (x0, y0), (x1, y1) = self.low_m, self.high_m
        corner = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        return np.concatenate([a + share * (b - a) for a, b in zip(corner, np.roll(corner, -1, axis=0))])


def board_of(settings: Chessboard) -> Board:
    """The configured board.

    Raises
    ------
    ConfigError
        Larger than a board that can be carried.
    """
    columns, rows = settings.squares
    board = Board(columns=columns, rows=rows, square_m=settings.square_m, margin_m=settings.margin_m)
    if max(board.width_m, board.height_m) > MAX_BOARD_M:
        raise ConfigError(
            "the chessboard is too large to be made and carried",
            where="bench.chessboard",
            got=f"{board.width_m:.2f} x {board.height_m:.2f} m with its margin",
            expected=f"at most {MAX_BOARD_M} m",
            remedy="lower square_m, squares or margin_m",
        )
    return board


def is_black(board: Board, point_m: np.ndarray) -> np.ndarray:
    """Whether points (..., 2) of the board's plane lie on a black square. (...) bool"""
    cell = np.floor(point_m / board.square_m).astype(int) + 1
    inside = (cell >= 0).all(axis=-1) & (cell < [board.columns, board.rows]).all(axis=-1)
    return np.asarray(inside & (cell.sum(axis=-1) % 2 == 0))


def board_scene(board: Board, settings: Chessboard) -> Scene:
    """The board as a rectangle that faces -z, in its own frame, with the bench's three materials; the wall is no mesh."""
    (x0, y0), (x1, y1) = board.low_m, board.high_m
    mesh = Mesh(
        vertices_m=np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]]),
        faces=np.array([[0, 2, 1], [0, 3, 2]], np.int32),
        material=np.full(2, WHITE, np.int32),
        target=np.zeros(2, np.int32),
        part=np.full(2, PART_BOARD, np.int8),
    )
    greys = (settings.white_reflectance, settings.black_reflectance, settings.wall_reflectance)
    materials = tuple(
        Material(name=name, wavelength_nm=np.array([400.0, 1700.0]), reflectance=np.full(2, grey))
        for name, grey in zip(("board_white", "board_black", "wall"), greys, strict=True)
    )
    layout = Layout(camera_half_m=(0.0, 0.0), lidar_half_m=0.0, cone_half_m=0.0, field_half_m=(0.0, 0.0))
    return Scene(mesh=mesh, materials=materials, targets=(), layout=layout)


def lamp_intensity(band: Band) -> float:
    """Radiant intensity of the lamp, averaged over a band's Gaussian response: a grey body of LAMP_TEMPERATURE_K whose
    luminous flux is LAMP_FLUX_LM. [W sr-1 nm-1]

    A Lambertian sphere that lies wholly above a surface irradiates it like a point of this intensity: E = I cos(theta)/d^2.
    """
    metre = _NM * 1e-9
    shape = metre**-5 / np.expm1(0.014387769 / (metre * LAMP_TEMPERATURE_K))
    candela = LAMP_FLUX_LM / (4 * np.pi)
    shape *= candela / illuminance_lx(_NM, shape)
    sigma = band.fwhm_nm / np.sqrt(8.0 * np.log(2.0))
    response = np.exp(-0.5 * ((_NM - band.centre_nm) / sigma) ** 2)
    return float(np.sum(response * shape) / np.sum(response))
