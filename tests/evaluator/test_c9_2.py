"""Clause 9.2: formulas (16) and (19), what stands beside M_z, and every folder that gives no figure but a reason."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from campaign.benches.bench import BoardExposure, BoardSheet
from campaign.config import Band, Lens
from campaign.folder import CampaignFolder
from campaign.manifest import Manifest
from campaign.sensors import CameraSheet
from evaluator.benches.bench_model import BoardImage, ChessboardResult
from evaluator.benches.c9_2_companions import coverage_of, positions_of, radial_at_corner_px, uncertainty_of
from evaluator.c9_2_camera_geometry import evaluate_chessboard, mean_reprojection_error, project_16
from evaluator.camera_model import lens_vector
from evaluator.model import BenchData, CampaignData, EvaluationError
from evaluator.observe.chessboard import NoBoard

COLUMNS, ROWS, SQUARE_M = 8, 5, 0.04
SIZE = (400, 300)
FOCAL_PX = 420.0
DISTANCES_M = (0.55, 0.7, 0.9, 1.15)
CELL = 24  # pixels a square of the flat pattern
FINE = 3


def test_formula_19_by_hand() -> None:
    """Rationale: (19) is a mean of norms, not a root of a mean of squares. Expected: norms 5, 0 and 13 give 6 (their RMS is 8.04).
    Tolerance: rounding."""
    observed = np.array([[0.0, 0.0], [7.0, 7.0], [1.0, 2.0]])
    assert mean_reprojection_error(observed + [[3.0, 4.0], [0.0, 0.0], [5.0, -12.0]], observed) == pytest.approx(6.0)


@pytest.mark.parametrize(
    "projected", [np.zeros((0, 2)), np.zeros((2, 2)), np.zeros((3, 3)), np.array([[0.0, np.nan]] * 3)]
)
def test_formula_19_refuses(projected: np.ndarray) -> None:
    """Rationale: no figure from nothing. Expected: EvaluationError. Tolerance: exact."""
    with pytest.raises(EvaluationError, match=r"\(19\)"):
        mean_reprojection_error(projected, np.zeros((3, 2)))


def test_formula_16_by_hand() -> None:
    """Rationale: image axes, principal point, and no distortion in (16). Expected: a board turned by 90 degrees about the optical
    axis (x to y) at 2 m, f = 1000 and 1100: the corner (0.2, 0.1) lies at (-0.1, 0.2, 2) + (0.3, 0, 0), so u = 300 + 100,
    v = 200 + 110. Behind the camera: NaN. Tolerance: rounding."""
    lens = Lens(fx_px=1000.0, fy_px=1100.0, cx_px=300.0, cy_px=200.0, k1=-0.3, p1=0.01)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    uv = project_16(lens, turn, np.array([0.3, 0.0, 2.0]), np.array([[0.2, 0.1, 0.0]]))
    assert np.allclose(uv, [[400.0, 310.0]], atol=1e-12)
    assert np.isnan(project_16(lens, turn, np.array([0.3, 0.0, -2.0]), np.array([[0.2, 0.1, 0.0]]))).all()


def test_positions() -> None:
    """Rationale: 9.2.2 d counts distances; tilts spread the estimated ones by some percent. Expected: stated distances win; without
    them a gap beyond 8 % opens a new position; order follows the distance. Tolerance: exact."""
    estimated = np.array([2.02, 1.0, 1.05, 2.0, 3.1, 1.02])
    position, rule = positions_of(estimated, [None] * 6)
    assert position.tolist() == [1, 0, 0, 1, 2, 0]
    assert "8 %" in rule
    position, rule = positions_of(estimated, [2.0, 1.0, 1.05, 2.0, 3.0, 1.0])
    assert position.tolist() == [2, 0, 1, 2, 3, 0]
    assert "log.csv" in rule


def test_coverage_counts_corners_in_cells() -> None:
    """Rationale: 9.2.2 d wants the whole field at each distance. Expected: three corners fall into three named cells of 4 x 2, at
    their image's position; a corner on the far border belongs to the last cell. Tolerance: exact."""

    def image(position: int, *uv: tuple[float, float]) -> BoardImage:
        return BoardImage(
            image="a.png",
            corner=np.zeros((len(uv), 2), int),
            observed_px=np.array(uv),
            projected_px=np.array(uv),
            error_px=np.zeros(len(uv)),
            camera_from_board_rotation=np.eye(3),
            camera_from_board_translation_m=np.zeros(3),
            position=position,
        )

    count = coverage_of([image(1, (10.0, 10.0), (399.9, 200.0)), image(0, (400.0, 99.0))], (400, 200), (4, 2))
    assert count.shape == (2, 2, 4)
    assert count[1].tolist() == [[1, 0, 0, 0], [0, 0, 0, 1]]
    assert count[0].tolist() == [[0, 0, 0, 1], [0, 0, 0, 0]]


def test_uncertainty_follows_the_scatter_between_images() -> None:
    """Rationale: corners of one image share its errors; images are what may be drawn again. Expected: for 40 images of 50 equal
    errors, the standard deviation of the images' means over sqrt(40). Tolerance: 5 %, 2000 draws."""
    means = np.random.default_rng(4).uniform(0.1, 0.3, 40)
    std, low, high = uncertainty_of([np.full(50, m) for m in means])
    assert std == pytest.approx(means.std() / np.sqrt(40), rel=0.05)
    assert high - low == pytest.approx(3.92 * std, rel=0.1)


def test_radial_distortion_at_the_corner() -> None:
    """Rationale: the figure that a lens sheet states. Expected: f k1 r^3 for a small k1: 1000 * -0.01 * (0.5)^3 = -1.25 px at
    the far corner of 800 x 600. Tolerance: 2 %, the next order."""
    lens = Lens(fx_px=1000.0, fy_px=1000.0, cx_px=400.0, cy_px=300.0, k1=-0.01, p1=0.001)
    assert radial_at_corner_px(lens, (800, 600)) == pytest.approx(-1.25, rel=0.02)


# ---- a folder of small pictures, drawn by a homography of one flat pattern ---------------------------------------------


def rotation(x_deg: float, y_deg: float, z_deg: float) -> np.ndarray:
    turns = [cv2.Rodrigues(np.radians(v))[0] for v in ([x_deg, 0.0, 0.0], [0.0, y_deg, 0.0], [0.0, 0.0, z_deg])]
    return np.asarray(turns[0] @ turns[1] @ turns[2])


def draw(r: np.ndarray, centre_m: np.ndarray, focal_px: float = FOCAL_PX) -> np.ndarray:
    """8-bit picture of the board; every pixel is the mean of FINE x FINE samples."""
    squares = np.add.outer(np.arange(ROWS + 1), np.arange(COLUMNS + 1)) % 2
    flat = np.full(((ROWS + 3) * CELL, (COLUMNS + 3) * CELL), 220.0, np.float32)
    flat[CELL:-CELL, CELL:-CELL] = np.kron(np.where(squares == 0, 30.0, 220.0), np.ones((CELL, CELL)))
    # pattern's sample (i, j), centre of the first at (0, 0) -> board metres; corner (0, 0) is the second square's end
    metres = SQUARE_M / CELL
    board_from_flat = np.array(
        [[metres, 0.0, (0.5 - 2 * CELL) * metres], [0.0, metres, (0.5 - 2 * CELL) * metres], [0, 0, 1]]
    )
    middle = np.array([(COLUMNS - 1) / 2.0, (ROWS - 1) / 2.0, 0.0]) * SQUARE_M
    k = np.array([[focal_px, 0.0, SIZE[0] / 2.0 + 3.0], [0.0, focal_px, SIZE[1] / 2.0 - 2.0], [0.0, 0.0, 1.0]])
    fine_from_px = np.array([[FINE, 0.0, -0.5], [0.0, FINE, -0.5], [0.0, 0.0, 1.0]])
    h = fine_from_px @ k @ np.column_stack([r[:, 0], r[:, 1], centre_m - r @ middle]) @ board_from_flat
    size = (SIZE[0] * FINE, SIZE[1] * FINE)
    fine = cv2.warpPerspective(flat, h, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=90.0)
    fine = cv2.GaussianBlur(fine, (0, 0), 0.7 * FINE)
    return np.round(fine.reshape(SIZE[1], FINE, SIZE[0], FINE).mean(axis=(1, 3))).astype(np.uint8)


def plan(index: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Rotation, centre [m] and distance of image `index` of 20: five at each of four distances."""
    distance = DISTANCES_M[index // 5]
    tilts = [(0, 0, 2), (24, 4, 6), (-24, -3, -5), (3, 25, 8), (-4, -25, -7)]
    at = [(0.0, 0.0), (0.1, 0.06), (-0.1, 0.06), (0.1, -0.06), (-0.1, -0.06)][index % 5]
    return rotation(*tilts[index % 5]), np.array([at[0] * distance, at[1] * distance, distance]), distance


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> CampaignData:
    """Nothing but the chessboard."""
    root = tmp_path_factory.mktemp("board")
    folder = CampaignFolder(root)
    folder.chessboard.mkdir(parents=True)
    log = []
    for i in range(20):
        r, centre, distance = plan(i)
        name = f"b_{i:02d}.png"
        cv2.imwrite(str(folder.chessboard / name), draw(r, centre))
        log.append(BoardExposure(image=name, distance_m=distance, focus_distance_m=2.0, f_number=4.0))
    for name, picture in {
        "empty.png": np.full((SIZE[1], SIZE[0]), 90, np.uint8),
        "small.png": np.full((50, 60), 90, np.uint8),
        "bright.png": np.where(draw(*plan(0)[:2]) > 100, 255, 60).astype(np.uint8),
        "zoomed.png": draw(*plan(6)[:2], focal_px=1.08 * FOCAL_PX),
    }.items():
        cv2.imwrite(str(folder.chessboard / name), picture)
    for i, d in enumerate((0.7, 0.7, 0.7, 0.7, 0.7)):
        at = np.array([0.02 * i - 0.04, 0.01 * i, d])
        cv2.imwrite(str(folder.chessboard / f"flat_{i}.png"), draw(rotation(0, 0, 3.0 * i), at))
    (folder.chessboard / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\nnothing")
    manifest = Manifest(
        campaign="board",
        synthetic=False,
        date="2026-06-12",
        start_time="2026-06-12T10:30:00+08:00",
        gps_week=2422,
        latitude_deg=31.283,
        longitude_deg=121.213,
        ellipsoid_height_m=18.0,
        height_anomaly_m=11.2,
        projection_epsg=4549,
        height_epsg=5737,
        software={},
        files=(),
    )
    board = BoardSheet(inner_columns=COLUMNS, inner_rows=ROWS, square_m=SQUARE_M)
    return CampaignData(
        folder=folder,
        manifest=manifest,
        plan=None,
        targets=(),
        spectra=None,
        camera=None,
        lidar=None,
        rig=None,
        sorties=(),
        bench=BenchData(board=board, board_log=tuple(log)),
    )


def evaluate(data: CampaignData, log: list[BoardExposure], **board: int) -> ChessboardResult:
    assert data.bench.board is not None
    sheet = data.bench.board.model_copy(update=board)
    result = evaluate_chessboard(
        replace(data, bench=BenchData(board=sheet, board_log=tuple(log))), lambda stage, done, total: None
    )
    text = f"{result.indicator.reason} {result.not_used} {result.indicator.companions}"
    assert str(data.folder.root) not in text
    return result


def named(*names: str) -> list[BoardExposure]:
    return [BoardExposure(image=name) for name in names]


def test_a_folder_of_pictures_alone(campaign: CampaignData) -> None:
    """Rationale: neither camera.json nor a flight is needed. Expected: 20 images at 4 positions, the drawn lens within its stated
    uncertainty, M_z at the drawing's own noise (8 bits, bilinear pattern), settings as all rows state them. Tolerance: 4 standard
    deviations by image for f and c; M_z below 0.05 px; the held-out figure above the fitted one by less than a half."""
    calls: list[tuple[str, int, int]] = []
    result = evaluate_chessboard(campaign, lambda *a: calls.append(a))
    value = result.indicator
    assert value.value is not None and value.value < 0.05
    assert value.sample_size == 20
    assert result.lens is not None and result.covariance is not None
    std = np.maximum(np.sqrt(np.diag(result.covariance)), value.companions["std_by_image"])[:4]  # type: ignore[call-overload]
    true = np.array([FOCAL_PX, FOCAL_PX, SIZE[0] / 2.0 + 3.0, SIZE[1] / 2.0 - 2.0])
    assert np.all(np.abs(lens_vector(result.lens)[:4] - true) < 4.0 * std)
    assert std[0] < 1.0
    assert [len(result.distances_m), result.focus_distance_m, result.f_number] == [4, 2.0, 4.0]
    assert result.distances_m == pytest.approx(DISTANCES_M, rel=0.03)
    assert result.coverage is not None
    assert result.coverage.sum() == sum(len(i.error_px) for i in result.images)
    assert value.companions["notes"] == []
    held_out = value.companions["held_out_px"]
    assert isinstance(held_out, float) and value.value < held_out * 1.02 and held_out < 1.5 * value.value
    errors = np.concatenate([i.error_px for i in result.images])
    assert value.value == errors.mean()
    assert value.low_95 is not None and value.high_95 is not None and value.low_95 < value.value < value.high_95
    assert calls[0] == ("chessboard", 0, 20) and calls[-1] == ("chessboard", 20, 20)
    image = result.images[7]
    assert np.all(np.linalg.norm(image.observed_px - image.projected_px, axis=1) < 0.3)


def test_bad_pictures_are_listed_not_fatal(campaign: CampaignData) -> None:
    """Rationale: one bad picture must not cost the campaign. Expected: each is named with its reason, the rest is used. Tolerance:
    exact; the zoomed picture is drawn with 8 % more focal length, which no pose can hide."""
    bad = named("empty.png", "small.png", "bright.png", "broken.png", "gone.png", "zoomed.png")
    result = evaluate(campaign, [*campaign.bench.board_log, *bad])
    assert result.indicator.value is not None and result.indicator.sample_size == 20
    reasons = {
        "empty.png": "one grey level",
        "small.png": "another size: 60 x 50 px",
        "bright.png": "saturated",
        "broken.png": "bench/chessboard/broken.png",
        "gone.png": "no such file",
        "zoomed.png": "rejected: ",
    }
    assert set(result.not_used) == set(reasons)
    for name, text in reasons.items():
        assert text in result.not_used[name], result.not_used[name]
    assert list(result.indicator.companions["rejected"]) == ["zoomed.png"]  # type: ignore[call-overload]


def test_fewer_than_twenty_is_a_figure_with_a_note(campaign: CampaignData) -> None:
    """Rationale: 9.2.2 asks for 20; a laboratory with 10 still learns its M_z, and conformity says no. Expected: a value and the
    note; position by the estimated distance where log.csv has none. Tolerance: exact."""
    result = evaluate(campaign, named(*(row.image for row in campaign.bench.board_log[::2])))
    assert result.indicator.value is not None and result.indicator.sample_size == 10
    assert "10 images, where 9.2.2 asks for 20" in result.indicator.companions["notes"]  # type: ignore[operator]
    assert len(result.distances_m) == 4
    assert result.focus_distance_m is None


def test_pixels_beyond_the_sheets_depth(campaign: CampaignData) -> None:
    """Rationale: pictures scaled from 12 to 16 bit on export are not over-exposed. Expected: the reason names the sheet's depth and
    asks for scaling."""
    names = [f"deep_{i}.png" for i in range(4)]
    for name in names:
        dn = draw(*plan(0)[:2]).astype(np.uint16) * 257
        cv2.imwrite(str(campaign.folder.chessboard / name), dn)
    sheet = CameraSheet(
        name="hand camera",
        width_px=SIZE[0],
        height_px=SIZE[1],
        pixel_size_um=4.5,
        nominal_focal_length_mm=1.89,
        f_number=4.0,
        bit_depth=12,
        black_level_dn=64.0,
        bands=(Band(name="grey", centre_nm=550.0, fwhm_nm=300.0),),
        calibration=None,
    )
    result = evaluate(replace(campaign, camera=sheet), named(*names))
    reason = str(result.indicator.reason)
    assert reason.startswith("none of 4 images can be used; for example deep_0.png: ")
    assert "the pixels go beyond sensors/camera.json's 12 bit: scaled on export?" in reason


def test_a_link_out_of_the_folder(campaign: CampaignData, tmp_path: Path) -> None:
    """Rationale: the folder may be hostile. Expected: a picture behind a link that leads out is not read, though it is sound."""
    cv2.imwrite(str(tmp_path / "x.png"), draw(*plan(0)[:2]))
    (campaign.folder.chessboard / "link.png").symlink_to(tmp_path / "x.png")
    result = evaluate(campaign, [*campaign.bench.board_log[:3], *named("link.png")])
    assert "a link leads out of the campaign folder" in result.not_used["link.png"]


def test_three_images_are_a_reason(campaign: CampaignData) -> None:
    """Rationale: too few images. Expected: not measured, with count, need and an example. Tolerance: exact."""
    log = [*campaign.bench.board_log[:3], *named("empty.png")]
    result = evaluate(campaign, log)
    assert result.indicator.value is None and result.lens is None
    assert "got 3 of 4; expected at least 4 (9.2.2: 20)" in str(result.indicator.reason)
    assert "empty.png" in result.not_used


def test_one_distance(campaign: CampaignData) -> None:
    """Rationale: square on at one distance, focal length and distance are one number; tilts part them. Expected: a reason without
    tilts, a value with a note with them. Tolerance: exact."""
    flat = evaluate(campaign, named(*(f"flat_{i}.png" for i in range(5))))
    assert flat.indicator.value is None
    assert "focal length" in str(flat.indicator.reason) or "converge" in str(flat.indicator.reason)
    tilted = evaluate(campaign, list(campaign.bench.board_log[5:10]))
    assert tilted.indicator.value is not None
    assert "1 distance, where 9.2.2 d asks for 4" in tilted.indicator.companions["notes"]  # type: ignore[operator]


def test_the_slow_search_is_only_for_boards_that_exist(campaign: CampaignData, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: the slow search takes seconds for each large picture: a wrong board.json must not cost minutes, one hard picture
    must not be given up. Expected: no board anywhere: three pictures are searched slowly; one board found quickly: every other one
    is; a board that only the slow search finds opens it for all. Tolerance: exact."""
    slow: list[int] = []

    def find(rule: Callable[[int, bool], bool]) -> Callable[..., object]:
        def stub(picture: np.ndarray, columns: int, rows: int, *, thorough: bool, **_: object) -> object:
            which = int(picture[0, 0, 0])
            if thorough:
                slow.append(which)
            if rule(which, thorough):
                raise EvaluationError("found")  # stands for any picture in which a board is
            raise NoBoard("no chessboard found")

        return stub

    for i in range(6):
        cv2.imwrite(str(campaign.folder.chessboard / f"stub_{i}.png"), np.full((SIZE[1], SIZE[0]), i, np.uint8))
    log = named(*(f"stub_{i}.png" for i in range(6)))
    for rule, expected in (
        (lambda which, thorough: False, [0, 1, 2]),
        (lambda which, thorough: which == 4, [0, 1, 2, 3, 5]),
        (lambda which, thorough: thorough, [0, 1, 2, 3, 4, 5]),
    ):
        slow.clear()
        monkeypatch.setattr("evaluator.c9_2_camera_geometry.find_corners", find(rule))
        evaluate(campaign, log)
        assert sorted(slow) == expected


def test_wrong_board_size(campaign: CampaignData) -> None:
    """Rationale: squares counted in the place of corners is the common mistake. Expected: not measured; the reason states what was
    looked for and what the pictures show (either way round). Tolerance: exact."""
    result = evaluate(campaign, list(campaign.bench.board_log[:6]), inner_columns=COLUMNS + 1, inner_rows=ROWS + 1)
    assert result.indicator.value is None
    assert f"no board of {COLUMNS + 1} x {ROWS + 1} inner corners in any of 6 images" in str(result.indicator.reason)
    assert f"seems to show {COLUMNS} x {ROWS}" in str(result.indicator.reason)


@pytest.mark.parametrize(
    "bench", [BenchData(), BenchData(board=BoardSheet(inner_columns=8, inner_rows=5, square_m=0.04))]
)
def test_nothing_there(campaign: CampaignData, bench: BenchData) -> None:
    """Rationale: a folder without this bench. Expected: the reason names the missing file. Tolerance: exact."""
    result = evaluate_chessboard(replace(campaign, bench=bench), lambda *a: None)
    assert result.indicator.value is None
    assert str(result.indicator.reason).startswith("no bench/chessboard/")


def test_same_figures_again(campaign: CampaignData) -> None:
    """Rationale: two threads and fixed draws: the same folder gives the same bytes. Expected: identical. Tolerance: exact."""
    log = list(campaign.bench.board_log[3:13])
    first, second = evaluate(campaign, log), evaluate(campaign, log)
    assert repr(first.indicator) == repr(second.indicator)
    assert first.covariance is not None and second.covariance is not None
    assert first.covariance.tobytes() == second.covariance.tobytes()
