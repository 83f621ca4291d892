"""Pictures of the chessboard against closed forms: where corners lie, how wide edges are, how bright surfaces are.

Every projection here is OpenCV's, every blur is computed by other means than the renderer's.
"""

import cv2
import numpy as np
import pytest
from scipy.optimize import curve_fit
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from campaign.config import Config
from campaign.load import load_config
from scenes.chessboard import LAMP_CAMERA_M, Board, board_of, board_scene
from simulator.bench.chessboard import board_view
from simulator.bench.placements import Placement, bench_f_number, bench_lens, plan_placements
from simulator.camera.sensor import Exposing, full_scale_dn, sensor_noise_std_dn
from simulator.render import board as renderer
from simulator.render import start
from simulator.render.board import BoardView, render_board
from simulator.render.sampling import frame_words
from simulator.render.scene import RenderScene, load_scene

STREAM = 15
# a window of the quickstart's camera: the same lens and pixels
WINDOW = ("camera.width_px=960", "camera.height_px=640", "camera.lens.cx_px=471.3", "camera.lens.cy_px=325.4")


class Bench:
    """One configuration, ready to render."""

    def __init__(self, *overrides: str, name: str = "quickstart") -> None:
        self.config: Config = load_config(name, list(overrides))
        self.board: Board = board_of(self.config.bench.chessboard)
        self.camera = self.config.camera.model_copy(
            update={"lens": bench_lens(self.config), "f_number": bench_f_number(self.config)}
        )
        self.scene: RenderScene = load_scene(board_scene(self.board, self.config.bench.chessboard))

    def placed(
        self, distance_m: float, tilt_deg: tuple[float, float], roll_deg: float, centre_px: tuple[float, float]
    ) -> Placement:
        """The board's centre at a distance along the axis, near a pixel."""
        lens = self.camera.lens
        rotation = Rotation.from_euler("ZXY", [roll_deg, *tilt_deg], degrees=True).as_matrix()
        ray = np.array([(centre_px[0] - lens.cx_px) / lens.fx_px, (centre_px[1] - lens.cy_px) / lens.fy_px, 1.0])
        translation = distance_m * ray - rotation[:, :2] @ self.board.centre_m
        return Placement(distance_m=distance_m, rotation=rotation, translation_m=translation)

    def view(self, placement: Placement) -> BoardView:
        return board_view(self.config, self.camera, placement)

    def render(self, placement: Placement, samples: int = 64, seed: int = 1, tile: int = 1 << 20) -> np.ndarray:
        return render_board(
            self.scene, self.board, self.view(placement), samples, frame_words(seed, STREAM, (0,)), tile=tile
        )

    def pixels(self, placement: Placement, point_m: np.ndarray) -> np.ndarray:
        """By OpenCV, whose first pixel has its centre at (0, 0)."""
        lens = self.camera.lens
        matrix = np.array([[lens.fx_px, 0, lens.cx_px - 0.5], [0, lens.fy_px, lens.cy_px - 0.5], [0, 0, 1]])
        points = np.column_stack([point_m, np.zeros(len(point_m))])
        turn = cv2.Rodrigues(placement.rotation)[0]
        distortion = np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3])
        return cv2.projectPoints(points, turn, placement.translation_m, matrix, distortion)[0].reshape(-1, 2) + 0.5


def corner_errors(bench: Bench, placement: Placement, picture: np.ndarray) -> np.ndarray:
    """Found minus true (n, 2) of the inner corners that lie in the picture, by OpenCV's refinement from the true place. [px]"""
    true = bench.pixels(placement, bench.board.corners_m())
    size = np.array(picture.shape[::-1])
    true = true[((true > 16) & (true < size - 16)).all(axis=1)]
    smooth = cv2.GaussianBlur(picture / picture.max(), (0, 0), 1.0)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-5)
    start = (true - 0.5).astype(np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(smooth, start.copy(), (9, 9), (-1, -1), stop).reshape(-1, 2) + 0.5 - true


CORNER_CASES = {
    # name: overrides, index into the quickstart's plan
    "near, field corner, tilted": (("bench.chessboard.f_number=8.0",), 0),
    "near, wide open": (("bench.chessboard.f_number=2.8",), 3),
    "far, tilted the other way": (("bench.chessboard.f_number=8.0",), 15),
    "far, upright, both tilts": (("bench.chessboard.f_number=8.0",), 18),
    "focused at 2 m": (("bench.chessboard.f_number=5.6", "bench.chessboard.focus_distance_m=2.0"), 5),
}


@pytest.mark.parametrize("case", CORNER_CASES)
def test_corners_lie_where_the_lens_puts_them(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: calibration takes corners for the centres of what a point becomes; a biased render would bias K.
    Expected: in full frames without noise, under even light (a lamp far away), corners found by OpenCV agree with OpenCV's
    projection through the true lens, in the field's corners as well.
    Tolerance: 0.003 px for the mean, 0.015 px for one axis' scatter: the render's own noise is 0.004-0.01 px, the refinement
    on raw pixels has an error of 0.008 px that depends on where a corner falls in its pixel.
    """
    overrides, index = CORNER_CASES[case]
    monkeypatch.setattr(renderer, "LAMP_CAMERA_M", np.array([0.0, 0.0, -1000.0]))
    bench = Bench(*overrides)
    placement = plan_placements(bench.config)[index]
    error = corner_errors(bench, placement, bench.render(placement))
    assert len(error) == 204
    print(f"\n{case}: mean {error.mean(axis=0).round(4)} px, RMS {np.sqrt((error**2).mean(axis=0)).round(4)} px")
    assert np.abs(error.mean(axis=0)).max() < 0.003
    assert np.sqrt((error**2).mean(axis=0)).max() < 0.015


def test_uneven_light_moves_corners_by_its_gradient() -> None:
    """Rationale: the lamp's light falls off across the board; a blurred edge then moves towards the brighter side, as it
    does before a real board. The renderer must show it, and it must stay small.
    Expected: d ln E/dx times the blur's variance (box, point spread, aperture, and the finder's own smoothing), about 0.003 px.
    Tolerance: the mean below the acceptance's 0.01 px.
    """
    bench = Bench()
    for index in (5, 9):
        placement = plan_placements(bench.config)[index]
        error = corner_errors(bench, placement, bench.render(placement))
        assert np.abs(error.mean(axis=0)).max() < 0.01


def edge_profile(x: np.ndarray, disc_px: float, sigma_px: float) -> np.ndarray:
    """Share of light at `x` px beyond a straight edge: uniform disc, Gaussian, and a pixel's box across the edge."""
    k = np.arange(1, 61) * np.pi / 61
    node, weight = np.cos(k), np.sin(k) ** 2  # Gauss-Chebyshev, second kind: the disc's projection is sqrt(1 - x^2)
    z = (x[:, None] + 0.5 * disc_px * node) / sigma_px

    def ramp(z: np.ndarray) -> np.ndarray:
        return z * norm.cdf(z) + norm.pdf(z)

    half = 0.5 / sigma_px
    return (ramp(z + half) - ramp(z - half)) * sigma_px @ weight / weight.sum()


@pytest.mark.parametrize(
    ("f_number", "focus_m", "distance_m"),
    [(4.0, 50.0, 1.6), (2.8, 50.0, 2.5), (2.0, 1.6, 3.0), (2.0, 3.0, 1.7), (8.0, 2.0, 2.0)],
)
def test_blur_is_the_thin_lens(f_number: float, focus_m: float, distance_m: float) -> None:
    """Rationale: a board at the wrong distance is out of focus by a disc of f^2/(N (s - f)) |s - u|/u.
    Expected: the profile of an edge is the disc's, widened by point spread and box: a fit gives back the disc's diameter, and
    the point spread where the board is in focus.
    Tolerance: 1 % (0.1 % render noise; the camera's calibrated principal distance is 0.14 % longer than its nominal focal
    length; along 36 px of the edge the light differs by 2 %).
    """
    bench = Bench(*WINDOW, f"bench.chessboard.f_number={f_number}", f"bench.chessboard.focus_distance_m={focus_m}")
    placement = bench.placed(distance_m, (0.0, 0.0), 3.0, (480.0, 320.0))
    picture = bench.render(placement)
    # the line between columns 8 and 9, away from lines of the other direction; the roll lets pixels sample it at every phase
    ends = bench.pixels(placement, np.array([[8.0, 5.3], [8.0, 5.7]]) * bench.board.square_m)
    length = np.linalg.norm(ends[1] - ends[0])
    along = (ends[1] - ends[0]) / length
    v, u = np.mgrid[: picture.shape[0], : picture.shape[1]] + 0.5
    offset = np.stack([u, v], axis=-1) - ends[0]
    distance = offset @ [-along[1], along[0]]
    near = (offset @ along > 0) & (offset @ along < length) & (np.abs(distance) < 10)
    focal_m, pixel_m = 0.0135, 4.5e-6
    expected = focal_m**2 / (f_number * (focus_m - focal_m)) * abs(focus_m - distance_m) / distance_m / pixel_m
    sigma = bench.camera.psf_sigma_px

    def model(x: np.ndarray, centre: float, low: float, high: float, slope: float, width: float) -> np.ndarray:
        disc, spread = (width, sigma) if expected > 0 else (0.0, width)
        return (low + (high - low) * edge_profile(x - centre, disc, spread)) * (1 + slope * x)

    value = picture[near] / picture[near].max()
    first, last = value[distance[near] < -8].mean(), value[distance[near] > 8].mean()
    fitted, _ = curve_fit(model, distance[near], value, p0=[0.0, first, last, 0.0, expected or 0.4])
    residual = np.std(value - model(distance[near], *fitted))
    print(
        f"\nD {expected:.3f} px, fitted {fitted[4]:.3f} px, shift {fitted[0]:.4f} px, residual {100 * residual:.2f} %"
    )
    assert fitted[4] == pytest.approx(expected or sigma, rel=0.01)
    assert abs(fitted[0]) < 0.003
    assert residual < 0.006


def test_refocusing_changes_the_scale() -> None:
    """Rationale: 1.8 % from far to 2 m for a P1's 35 mm lens (DESIGN 5): the bench must show it in the picture, not in a file.
    Expected: corners of a board at 2 m, found in two pictures, lie farther from the principal point by
    (2 m)/(2 m - f) at the near setting; far focus is stopped down so that both pictures can be measured.
    Tolerance: 1e-4 of the scale: 0.03 px over the board's 330 px, ten times what single corners leave in the mean.
    """
    common = (
        "camera.width_px=900",
        "camera.height_px=640",
        "camera.lens.cx_px=450.0",
        "camera.lens.cy_px=320.0",
        "camera.focus_distance_m=1e6",
        "bench.chessboard.squares=[8, 5]",
        "bench.chessboard.square_m=0.02",
        "bench.chessboard.margin_m=0.02",
        "bench.chessboard.f_number=32.0",
        "bench.chessboard.wall_reflectance=0.0",
    )
    found: list[np.ndarray] = []
    for focus in ("2.0", "1e6"):
        bench = Bench(*common, f"bench.chessboard.focus_distance_m={focus}", name="multirotor_vux1_p1")
        placement = bench.placed(2.0, (0.0, 0.0), 0.0, (450.0, 320.0))
        picture = bench.render(placement)
        found.append(corner_errors(bench, placement, picture) + bench.pixels(placement, bench.board.corners_m()))
    near, far = (f - f.mean(axis=0) for f in found)
    scale = (near * far).sum() / (far * far).sum()
    print(f"\nscale {scale:.5f}")
    assert scale == pytest.approx(2.0 / (2.0 - 0.035), abs=1e-4)


def test_light_is_one_lamp() -> None:
    """Rationale: 6.3.2 b, one source: irradiance cos/d^2 from a small sphere beside the camera, Lambertian surfaces.
    Expected: in the middle of squares rho/pi cos/d^2, by the pose alone; on the wall the same, 1.5 m behind the farthest
    position; none in the board's shadow.
    Tolerance: 2e-5, single precision.
    """
    bench = Bench()
    placement = plan_placements(bench.config)[15]
    picture = bench.render(placement, samples=16)
    lens, settings = bench.camera.lens, bench.config.bench.chessboard
    for column, row in ((0, 0), (17, 12), (9, 6), (3, 8)):
        pixel = bench.pixels(placement, (np.array([[column, row]]) - 0.5) * bench.board.square_m)[0]
        u, v = np.floor(pixel).astype(int)
        ray = cv2.undistortPoints(
            np.array([[[float(u), float(v)]]]),  # OpenCV's coordinates of the pixel's centre
            np.array([[lens.fx_px, 0, lens.cx_px - 0.5], [0, lens.fy_px, lens.cy_px - 0.5], [0, 0, 1]]),
            np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]),
        ).ravel()
        ray = np.append(ray, 1.0)
        normal = placement.rotation[:, 2]
        point = ray * (normal @ placement.translation_m) / (normal @ ray)
        to_lamp = LAMP_CAMERA_M - point
        cosine = -normal @ to_lamp / np.linalg.norm(to_lamp)
        grey = settings.black_reflectance if (column + row) % 2 == 0 else settings.white_reflectance
        assert picture[v, u] == pytest.approx(grey / np.pi * cosine / (to_lamp @ to_lamp), rel=2e-5)
    wall = (picture[1030, 2900], (2900.5 - lens.cx_px) / lens.fx_px, (1030.5 - lens.cy_px) / lens.fy_px)
    point = np.array([wall[1], wall[2], 1.0]) * (3.0 + 1.5)
    square = float(((LAMP_CAMERA_M - point) ** 2).sum())
    assert wall[0] == pytest.approx(
        settings.wall_reflectance / np.pi * 4.5 / square**1.5, rel=0.02
    )  # distortion left out
    assert (picture == 0).sum() > 10_000


@pytest.mark.parametrize(
    ("overrides", "tilt_deg", "roll_deg"),
    [
        (("bench.chessboard.f_number=2.8",), (14.0, -16.0), 25.0),
        (("camera.psf_sigma_px=2.0", "bench.chessboard.focus_distance_m=1.6"), (50.0, 0.0), 45.0),
        (
            ("camera.psf_sigma_px=0.0", "bench.chessboard.focus_distance_m=1.5", "bench.chessboard.f_number=4"),
            (0.0, 20.0),
            80.0,
        ),
    ],
    ids=["out of focus by 9 px", "steeply tilted, wide point spread", "no point spread"],
)
def test_pixels_against_brute_force(overrides: tuple[str, ...], tilt_deg: tuple[float, float], roll_deg: float) -> None:
    """Rationale: the renderer integrates the point spread in closed form and steers its samples; a plain Monte Carlo in NumPy,
    with another inverse of the lens (OpenCV's) and no closed form at all, must give the same pixels.
    Expected: about one corner towards the field's corner, every pixel agrees.
    Tolerance: 4.5 sigma of the reference's own noise (40 000 samples a pixel) and of the render's (0.3 % of white).
    """
    bench = Bench(*overrides)
    # a window at the upper left corner of the quickstart's field
    lens = bench.camera.lens.model_copy(update={"cx_px": 1480.0, "cy_px": 950.0})
    bench.camera = bench.camera.model_copy(update={"width_px": 384, "height_px": 256, "lens": lens})
    placement = bench.placed(1.6, tilt_deg, roll_deg, (192.0, 128.0))
    picture = bench.render(placement, samples=512)
    corner = bench.pixels(placement, np.array([[8.0, 5.0]]) * bench.board.square_m)[0]
    view, settings = bench.view(placement), bench.config.bench.chessboard
    matrix = np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1]])
    distortion = np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3])
    rng = np.random.default_rng(5)
    draws = 40_000
    worst = 0.0
    for du, dv in ((0, 0), (-4, 1), (3, 3), (1, -6), (-7, -7), (5, 0)):
        u, v = np.floor(corner).astype(int) + [du, dv]
        place = (
            np.array([u, v]) + rng.uniform(0, 1, (draws, 2)) + bench.camera.psf_sigma_px * rng.normal(size=(draws, 2))
        )
        ray = cv2.undistortPoints(place.reshape(-1, 1, 2), matrix, distortion).reshape(-1, 2)
        angle, radius = rng.uniform(0, 2 * np.pi, draws), 0.5 * view.aperture_m * np.sqrt(rng.uniform(0, 1, draws))
        origin = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(draws)])
        through = view.focus_distance_m * np.column_stack([ray, np.ones(draws)]) - origin
        normal = placement.rotation[:, 2]
        reach = ((placement.translation_m - origin) @ normal) / (through @ normal)
        point = origin + reach[:, None] * through
        on_board = (point - placement.translation_m) @ placement.rotation[:, :2] / bench.board.square_m
        cell = np.floor(on_board).astype(int) + 1
        inside = ((cell >= 0) & (cell < [bench.board.columns, bench.board.rows])).all(axis=1)
        grey = np.where(inside & (cell.sum(axis=1) % 2 == 0), settings.black_reflectance, settings.white_reflectance)
        to_lamp = LAMP_CAMERA_M - point
        value = grey / np.pi * (to_lamp @ -normal) / np.linalg.norm(to_lamp, axis=1) ** 3
        spread = np.hypot(value.std() / np.sqrt(draws), 0.003 * picture.max())
        worst = max(worst, abs(picture[v, u] - value.mean()) / spread)
    print(f"\nworst of six pixels: {worst:.2f} sigma")
    assert worst < 4.5


def test_render_is_quieter_than_the_sensor() -> None:
    """Rationale: the render's noise adds to the sensor's; if it were larger, the evaluator would be tested on a camera that
    nobody has.
    Expected: at edges and corners of the pattern, from two seeds, less than the sensor's noise at the same signal, near and far.
    Tolerance: the brief's limit is twice; 0.5 to 0.8 of it was seen, 1 is asserted.
    """
    bench = Bench()
    for index in (0, 15):
        placement = plan_placements(bench.config)[index]
        first, second = (bench.render(placement, seed=seed) for seed in (1, 2))
        varied = first != second
        outline = np.zeros(first.shape, np.uint8)
        cv2.fillPoly(outline, [np.round(bench.pixels(placement, bench.board.outline_m())).astype(np.int32)], 1)
        chosen = varied & (cv2.erode(outline, np.ones((21, 21), np.uint8)) > 0)
        # white at `exposure_share` of the full well, and the gain that puts the full well at full scale
        camera, full = bench.camera, full_scale_dn(bench.camera)
        exposing = Exposing(
            e_per_radiance=np.ones(1), e_per_dn=camera.full_well_e / full, exposure_time_s=0.4, white_dn=np.ones(1)
        )
        scale = bench.config.bench.chessboard.exposure_share * full / float(first.max())
        sensor = sensor_noise_std_dn(first[chosen] * scale, camera, exposing)
        noise = (first[chosen] - second[chosen]) * scale / np.sqrt(2)
        ratio = np.sqrt((noise**2).mean() / (sensor**2).mean())
        print(f"\npicture {index}: {chosen.sum()} px at edges, render over sensor {ratio:.2f}")
        assert ratio < 1.0


def test_any_tile_and_thread_count_gives_the_same_bytes() -> None:
    """Rationale: tiles and threads are the machine's, not physics. Expected: the same bytes for tiles of 4096 and 2^20 lanes
    and for one thread, others for another seed. Tolerance: none.
    """
    bench = Bench(*WINDOW, "bench.chessboard.f_number=4.0")
    placement = bench.placed(2.0, (15.0, -12.0), 70.0, (700.0, 200.0))
    whole, other = (bench.render(placement, samples=16, seed=seed) for seed in (1, 2))
    assert whole.tobytes() != other.tobytes()
    start(threads=1)
    try:
        tiles = bench.render(placement, samples=16, tile=4096)
    finally:
        start()
    assert whole.tobytes() == tiles.tobytes()
