"""The chessboard bench: its plan, its lens, and the files that it writes. The pictures' truth is tests/truth's."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from campaign.benches.bench import read_board, read_board_log
from campaign.benches.pictures import read_picture
from campaign.config import Config, Lens
from campaign.errors import ConfigError
from campaign.folder import CampaignFolder
from campaign.load import load_config
from scenes.chessboard import board_of, is_black
from simulator.bench.chessboard import simulate_chessboard
from simulator.bench.placements import Placement, bench_lens, plan_placements, project_board
from simulator.camera.sensor import full_scale_dn

TINY = Path(__file__).parents[1] / "data" / "tiny.toml"
P1 = (
    "bench.chessboard.focus_distance_m=3.0",
    "bench.chessboard.f_number=11.0",
    "bench.chessboard.square_m=0.075",
    "bench.chessboard.margin_m=0.05",
    "bench.chessboard.distances_m=[2.2, 2.6, 3.0, 3.6]",
)
# 0.4 megapixels, otherwise the quickstart's camera at a quarter of its resolution
SMALL = (
    "camera.width_px=768",
    "camera.height_px=512",
    "camera.pixel_size_um=18.0",
    "camera.lens.fx_px=751.0",
    "camera.lens.fy_px=750.8",
    "camera.lens.cx_px=385.2",
    "camera.lens.cy_px=254.8",
    "bench.chessboard.samples=16",
)


def by_opencv(lens: Lens, placement: Placement, point_m: np.ndarray) -> np.ndarray:
    """Pixels of the board's points by OpenCV, whose first pixel has its centre at (0, 0)."""
    matrix = np.array([[lens.fx_px, 0, lens.cx_px - 0.5], [0, lens.fy_px, lens.cy_px - 0.5], [0, 0, 1]])
    distortion = np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3])
    turn = cv2.Rodrigues(placement.rotation)[0]
    points = np.column_stack([point_m, np.zeros(len(point_m))])
    return cv2.projectPoints(points, turn, placement.translation_m, matrix, distortion)[0].reshape(-1, 2) + 0.5


@pytest.mark.parametrize(
    ("name", "overrides"),
    [("quickstart", ()), ("multirotor_vux1_p1", P1), (str(TINY), ()), ("quickstart", ("seed=5",))],
)
def test_plan_covers_the_field_at_each_distance(name: str, overrides: tuple[str, ...]) -> None:
    """Rationale: 9.2.2 d asks for the whole field at each of four distances, c for tilts, 6.3.2 for 20 pictures; OpenCV
    needs the board's whole margin inside the picture.
    Expected: projected by OpenCV, every cell of 8 x 6 holds an inner corner at every distance; outlines stay inside.
    Tolerance: none; a plan of more than 28 pictures would cost the demo its time.
    """
    config = load_config(name, overrides)
    plan, board, lens = plan_placements(config), board_of(config.bench.chessboard), bench_lens(config)
    size = np.array([config.camera.width_px, config.camera.height_px])
    assert 20 <= len(plan) <= 28
    distances = {p.distance_m for p in plan}
    assert distances == set(config.bench.chessboard.distances_m)
    for distance in distances:
        own = [p for p in plan if p.distance_m == distance]
        pixel = np.concatenate([by_opencv(lens, p, board.corners_m()) for p in own])
        column, row = np.floor(pixel / size * [8, 6]).astype(int).T
        assert len(set(zip(column.tolist(), row.tolist(), strict=True))) == 48, distance
    for placement in plan:
        outline = by_opencv(lens, placement, board.outline_m(100))
        assert (outline > 0.0095 * size).all() and (outline < 0.9905 * size).all()
        # the middle of the board stands at the distance that the log states
        middle = placement.rotation[:, :2] @ board.centre_m + placement.translation_m
        assert middle[2] == pytest.approx(placement.distance_m, abs=1e-9)


def test_plan_tilts_and_turns() -> None:
    """Rationale: without tilt the principal distance cannot be told from the board's distance, without turns the principal
    point from the tangential distortion.
    Expected: at every distance normals lean to all four sides; some boards stand upright; no normal leans more than asked.
    Tolerance: two tilts of 22 degrees' shares add up to 22.5 degrees at most.
    """
    config = load_config("quickstart")
    plan = plan_placements(config)
    normal = np.array([p.rotation[:, 2] for p in plan])
    lean = np.degrees(np.arccos(normal[:, 2]))
    assert lean.max() < 22.5
    assert np.median(lean) > 10.0
    for distance in config.bench.chessboard.distances_m:
        own = normal[[p.distance_m == distance for p in plan]]
        for axis in (0, 1):
            assert own[:, axis].min() < -0.1 and own[:, axis].max() > 0.1, distance
    roll = np.degrees([np.arctan2(p.rotation[1, 0], p.rotation[0, 0]) for p in plan])
    assert (np.abs(np.abs(roll) - 90) < 20).sum() >= 3


def test_plan_is_the_seeds() -> None:
    """Rationale: a campaign is its configuration, and what is rendered must not be rendered again for another noise. Expected: the
    same poses for the same seed, others for another, and the same where `scene_seed` holds them. Tolerance: exact.
    """
    first, again, other, held = (
        plan_placements(load_config("quickstart", [f"seed={s}", *more]))
        for s, *more in ((3,), (3,), (4,), (4, "scene_seed=3"))
    )
    for same in (again, held):
        assert all((a.rotation == b.rotation).all() for a, b in zip(first, same, strict=True))
    assert any((a.rotation != b.rotation).any() for a, b in zip(first, other))


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("bench.chessboard.square_m=0.09", ("too large", "1.74", "at most 1.5 m")),
        ("bench.chessboard.distances_m=[1.0, 2.0]", ("does not fit", "distances_m 1.0", "raise that distance")),
        ("bench.chessboard.distances_m=[2.0, 20.0]", ("too small", "9.0 px at 20.0 m", "larger squares")),
        ("bench.chessboard.margin_m=0.2 bench.chessboard.distances_m=[2.2,2.8]", ("cannot reach", "margin_m")),
        ("bench.chessboard.focus_distance_m=0.02", ("focused so near", "0.027 m")),
    ],
)
def test_impossible_benches_are_one_line(override: str, words: tuple[str, ...]) -> None:
    """Rationale: the user reads what to change. Expected: ConfigError with place, figures and remedy. Tolerance: none."""
    with pytest.raises(ConfigError) as error:
        plan_placements(load_config("quickstart", override.replace(", ", ",").split()))
    assert all(word in str(error.value) for word in words), str(error.value)


def test_breathing_is_the_thin_lens() -> None:
    """Rationale: refocusing moves the lens: image distance v = f s/(s - f).
    Expected: a P1's 35 mm set to 2 m instead of infinity: 35 * 2000/(2000 - 35) mm = 35.623 mm, 1.78 % more; the principal
    point and the normalised distortion stay; locked as in flight nothing changes.
    Tolerance: 1e-9, double precision.
    """
    config = load_config(
        "multirotor_vux1_p1", [*P1[1:], "bench.chessboard.focus_distance_m=2.0", "camera.focus_distance_m=1e6"]
    )
    lens, flight = bench_lens(config), config.camera.lens
    expected = (35 * 2000 / (2000 - 35)) / (35 * 1e9 / (1e9 - 35))
    assert lens.fx_px / flight.fx_px == pytest.approx(expected, abs=1e-9)
    assert lens.fy_px / flight.fy_px == pytest.approx(expected, abs=1e-9)
    assert expected == pytest.approx(1.018, abs=5e-4)
    assert lens.model_copy(update={"fx_px": flight.fx_px, "fy_px": flight.fy_px}) == flight
    locked = load_config("quickstart")
    assert bench_lens(locked) == locked.camera.lens


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[Config, CampaignFolder, Lens, float]:
    config = load_config("quickstart", SMALL)
    place = CampaignFolder(tmp_path_factory.mktemp("bench"))
    said: list[tuple[str, int, int]] = []
    lens, focus = simulate_chessboard(config, place, 1.4e9, lambda *what: said.append(what))
    count = len(plan_placements(config))
    assert said == [("chessboard", k, count) for k in range(count + 1)]
    return config, place, lens, focus


def test_files_of_the_bench(small: tuple[Config, CampaignFolder, Lens, float]) -> None:
    """Rationale: the evaluator reads nothing but the folder.
    Expected: board.json, one log row a picture with rising times, pictures of the camera's size and bands with previews;
    true corners as OpenCV projects them through the returned lens.
    Tolerance: 1e-8 px, double precision on both sides.
    """
    config, place, lens, focus = small
    board, sheet = board_of(config.bench.chessboard), read_board(place.chessboard / "board.json")
    assert (sheet.inner_columns, sheet.inner_rows, sheet.square_m) == (17, 12, 0.06)
    assert (sheet.width_m, sheet.height_m) == (pytest.approx(1.2), pytest.approx(0.9))
    rows = read_board_log(place.chessboard / "log.csv")
    plan = plan_placements(config)
    assert [row.distance_m for row in rows] == [p.distance_m for p in plan]
    assert [row.gps_time_s for row in rows] == [1.4e9 + 20.0 * k for k in range(len(plan))]
    assert {(row.focus_distance_m, row.f_number) for row in rows} == {(50.0, 8.0)}
    assert focus == 50.0
    with np.load(place.truth / "board_corners.npz", allow_pickle=False) as truth:
        assert list(truth["image"]) == [f"bench/chessboard/{row.image}" for row in rows]
        assert (truth["corner"][:19] == [[k % 17, k // 17] for k in range(19)]).all()
        for k, placement in enumerate(plan):
            expected = by_opencv(lens, placement, board.corners_m())
            np.testing.assert_allclose(truth["corner_px"][k], expected, rtol=0, atol=1e-8)
            np.testing.assert_array_equal(truth["rotation"][k], placement.rotation)
    for row in rows:
        assert read_picture(place.chessboard / row.image).shape == (512, 768, 3)
        assert (place.chessboard / row.image).with_suffix(".jpg").stat().st_size > 10_000
    json.loads((place.chessboard / "board.json").read_text())


def test_exposure_and_pattern(small: tuple[Config, CampaignFolder, Lens, float]) -> None:
    """Rationale: white squares shall use the range without clipping, at each distance; black and white must lie where the
    board says.
    Expected: the brightest whites of a distance at exposure_share of full scale; black over white = 0.04/0.85 (no stray
    light) in the middle of every square.
    Tolerance: 3 % of full scale for the brightest (the board's rim is brighter than its squares; noise 0.5 % a pixel), 0.02 for
    the ratio (3 sigma of 25 pixels' noise at the darkest squares is 0.008, and a square away the lamp's light differs by 5 %).
    """
    config, place, lens, _ = small
    board, camera = board_of(config.bench.chessboard), config.camera
    middles = np.array([[c - 0.5, r - 0.5] for r in range(board.rows) for c in range(board.columns)]) * board.square_m
    black = is_black(board, middles)
    assert black[0] and not black[1]
    brightest: dict[float, list[float]] = {}
    for k, (row, placement) in enumerate(
        zip(read_board_log(place.chessboard / "log.csv"), plan_placements(config), strict=True)
    ):
        dn = read_picture(place.chessboard / row.image).astype(float) - camera.black_level_dn
        level = cv2.blur(dn, (5, 5)).max(axis=2)
        assert row.distance_m is not None
        brightest.setdefault(row.distance_m, []).append(level.max() / full_scale_dn(camera))
        u, v = np.floor(project_board(lens, placement, middles)).astype(int).T
        found = level[v, u].reshape(board.rows, board.columns)
        isblack = black.reshape(found.shape)
        beside = np.where(isblack[:, :-1], found[:, :-1] / found[:, 1:], found[:, 1:] / found[:, :-1])
        np.testing.assert_allclose(beside, 0.04 / 0.85, rtol=0, atol=0.02, err_msg=f"picture {k}")
    for distance, levels in brightest.items():
        assert max(levels) == pytest.approx(0.7, abs=0.03), distance


def test_one_band_and_a_gain_fault(tmp_path: Path) -> None:
    """Rationale: any camera of one to three bands; a person sets the exposure by what the camera shows, its fault included.
    Expected: one-band pictures whose brightest whites reach exposure_share although the gain is 1.4 times what it should be.
    Tolerance: 3 % of full scale, as above.
    """
    config = load_config("quickstart", [*SMALL, "bench.chessboard.distances_m=[1.6]", "faults.camera_gain=1.4"])
    camera = config.camera.model_copy(update={"bands": config.camera.bands[1:2]})
    place = CampaignFolder(tmp_path)
    simulate_chessboard(config.model_copy(update={"camera": camera}), place, 1.4e9, lambda *what: None)
    rows = read_board_log(place.chessboard / "log.csv")
    assert len(rows) >= 20
    pictures = [read_picture(place.chessboard / row.image) for row in rows]
    assert {p.shape for p in pictures} == {(512, 768, 1)}
    brightest = max(cv2.blur(p[..., 0].astype(float) - camera.black_level_dn, (5, 5)).max() for p in pictures)
    assert brightest / full_scale_dn(camera) == pytest.approx(0.7, abs=0.03)
