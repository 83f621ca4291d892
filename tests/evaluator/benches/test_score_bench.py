"""score.json of benches and ranging line: known errors come out, with their z, whatever else the folder holds."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from campaign.config import Lens
from campaign.errors import TestrangeError
from campaign.manifest import write_manifest
from campaign.sensors import write_sheet
from campaign.truth import TrueBench, TrueMounting, TrueRanging, Truth, write_truth
from evaluator.benches.bench_model import ChessboardResult, RangingResult, SphereResult
from evaluator.camera_model import LENS_NAMES, lens_vector, project
from evaluator.frames import euler_rotation
from evaluator.model import CampaignData
from evaluator.results import Evaluation, write_results
from evaluator.scores.score import Score, decimals, distortion_error, score_campaign

TRUE_LENS = Lens(fx_px=3000.2, fy_px=2999.9, cx_px=1540.1, cy_px=1020.4, k1=-0.0469, k2=0.0236, p1=2e-4, p2=-1e-4)
BENCH = TrueBench(lens=TRUE_LENS, focus_distance_m=2.0, drift_percent_per_h=0.1)
RANGING = TrueRanging(additive_constant_m=0.05, multiplication_constant=2e-4)
CAMERA = tuple(f"camera_{name}" for name in LENS_NAMES)
MAP = ("distortion_map_rms_px", "distortion_map_rms_turned_px")
LINE = ("ranging_additive_constant", "ranging_multiplication_constant")
Make = Callable[..., Score]


def truth_of(**parts: object) -> Truth:
    """Truth with mountings that nobody estimates."""
    none = {"boresight_deg": (0.0, 0.0, 0.0), "lever_arm_error_m": (0.0, 0.0, 0.0), "lever_arm_m": (0.0, 0.0, 0.0)}
    mounting = TrueMounting(rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), **none)
    return Truth(
        seed=1,
        camera=mounting,
        lidar=mounting,
        lens=Lens(fx_px=3000.0, fy_px=3000.0, cx_px=1536.0, cy_px=1024.0),  # of the flight's focus: not what is scored
        camera_clock_s=0.0,
        lidar_clock_s=0.0,
        range_offset_m=0.0,
        range_scale=0.0,
        lidar_gain=1.0,
        camera_gain=1.0,
        targets=(),
        **parts,
    )


@pytest.fixture
def scored(
    bare_data: CampaignData,
    sphere_result: SphereResult,
    chessboard_result: ChessboardResult,
    ranging_result: RangingResult,
) -> Make:
    """Writes a campaign of a manifest and truth alone, results.json of benches and line, and scores it."""

    def make(spoil: Callable[[dict[str, Any]], object] = lambda found: None, **parts: object) -> Score:
        root = bare_data.folder.root
        root.mkdir(parents=True)
        write_manifest(root, bare_data.manifest)
        bare_data.folder.truth.mkdir()
        write_truth(root, truth_of(**(parts or {"bench": BENCH, "ranging": RANGING})))
        evaluation = Evaluation(
            campaign="hand-made",
            synthetic=True,
            data=bare_data,
            indicators={
                "camera_stability": sphere_result.stability,
                "camera_repeatability": sphere_result.repeatability,
                "camera_reprojection_error": chessboard_result.indicator,
                "lidar_ranging_rmse_relative": ranging_result.indicator,
            },
        )
        path = root.parent / "results.json"
        write_results(path, evaluation)
        content = json.loads(path.read_text())
        spoil(content["indicators"])
        path.write_text(json.dumps(content))
        return score_campaign(root, path)

    return make


def test_benches_alone_are_scored(scored: Make) -> None:
    """Rationale: no rig, no flight, no mounting. The estimates of the conftest are off by known shares of their standard
    deviations: 1, 1, -0.5, 0.3, 0.5, -0.4, 0.3, 0.2, -0.2 for the lens; K2 0.2 mm of 0.8 mm, R2 1e-6 of 5e-6; the lamp
    0.004 of 0.008 % an hour. Expected: those z, the bench's lens and not the flight's as truth, two figures of the map
    without z. Tolerance: twelve digits in results.json."""
    items = {i.quantity: i for i in scored().items}
    assert set(items) == {*CAMERA, *MAP, *LINE, "lamp_drift"}
    z = [items[name].z for name in CAMERA]
    assert z == pytest.approx([1.0, 1.0, -0.5, 0.3, 0.5, -0.4, 0.3, 0.2, -0.2], abs=1e-6)
    assert [items[name].unit for name in CAMERA] == ["px"] * 4 + ["1"] * 5
    assert [items[name].truth for name in CAMERA] == lens_vector(TRUE_LENS).tolist()
    assert [items[name].z for name in LINE] == pytest.approx([0.25, 0.2], abs=1e-9)
    assert items["lamp_drift"].z == pytest.approx(0.5)
    assert items["lamp_drift"].unit == "%/h"
    assert [items[name].z for name in MAP] == [None, None]
    assert 0.0 < items[MAP[1]].estimate < items[MAP[0]].estimate < 0.1  # a few hundredths of a pixel of focal length


def test_truth_without_a_part(scored: Make) -> None:
    """Rationale: a campaign may have simulated one bench only. Expected: items of that one alone."""
    assert {i.quantity for i in scored(ranging=RANGING).items} == set(LINE)


def test_sphere_alone(scored: Make) -> None:
    """Rationale: the chessboard was not simulated, so the bench has no lens. Expected: the lamp alone."""
    assert {i.quantity for i in scored(bench=TrueBench(drift_percent_per_h=0.1)).items} == {"lamp_drift"}


def test_indicators_without_estimates(scored: Make) -> None:
    """Rationale: an indicator that was not measured has no companions, or null for a trend. Expected: no item, no error."""

    def spoil(indicators: dict[str, Any]) -> None:
        indicators["camera_reprojection_error"]["companions"] = {}
        indicators["camera_stability"]["companions"]["trend_percent_per_h"] = None
        del indicators["lidar_ranging_rmse_relative"]["companions"]

    assert scored(spoil).items == ()


def test_names_and_the_covered_cells(scored: Make) -> None:
    """Rationale: the list of parameters may be called `names`, and counts that are no table cannot bound a map. Expected: the same
    z of the parameters, no map."""

    def spoil(indicators: dict[str, Any]) -> None:
        companions = indicators["camera_reprojection_error"]["companions"]
        companions["names"] = companions.pop("parameters")
        companions["coverage_counts"] = 0.9

    items = {i.quantity: i for i in scored(spoil).items}
    assert items["camera_fx_px"].z == pytest.approx(1.0, abs=1e-6)
    assert not set(MAP) & set(items)


def test_lens_that_folds_back(scored: Make) -> None:
    """Rationale: a spoiled calibration may have k1 = -3 or 1e30. Expected: the parameters are scored; a map where rays
    exist; no warning, no traceback."""

    def spoil(indicators: dict[str, Any]) -> None:
        indicators["camera_reprojection_error"]["companions"]["estimates"][4] = 1e30

    items = {i.quantity: i for i in scored(spoil).items}
    assert items["camera_k1"].estimate == 1e30
    assert items["camera_fx_px"].z == pytest.approx(1.0, abs=1e-6)


def test_no_image_size_no_map(scored: Make) -> None:
    """Rationale: parameters are scored also where no map can be drawn. Expected: nine items of the lens, no map."""

    def spoil(indicators: dict[str, Any]) -> None:
        del indicators["camera_reprojection_error"]["companions"]["image_size_px"]

    found = {i.quantity for i in scored(spoil).items}
    assert found == {*CAMERA, *LINE, "lamp_drift"}


@pytest.mark.parametrize(
    ("indicator", "key", "value"),
    [
        ("camera_reprojection_error", "std", [0.1]),
        ("camera_reprojection_error", "estimates", ["a"] * 9),
        ("camera_reprojection_error", "names", 7),
        ("camera_reprojection_error", "parameters", ["fx_px"]),
        ("camera_reprojection_error", "std", [-1.0] * 9),
        ("lidar_ranging_rmse_relative", "additive_constant_m", "5 cm"),
        ("camera_stability", "trend_std_percent_per_h", -1.0),
    ],
)
def test_torn_companions(scored: Make, indicator: str, key: str, value: object) -> None:
    """Rationale: results.json may come from somebody else's program. Expected: one line that names the indicator."""

    def spoil(indicators: dict[str, Any]) -> None:
        indicators[indicator]["companions"][key] = value

    with pytest.raises(TestrangeError, match=indicator) as caught:
        scored(spoil)
    assert "\n" not in str(caught.value)


def test_mounting_and_benches_together(
    campaign_data: CampaignData,
    evaluation: Evaluation,
    chessboard_result: ChessboardResult,
) -> None:
    """Rationale: a whole campaign has everything. Expected: 18 quantities of the mounting, nine of the lens, the map."""
    root = campaign_data.folder.root
    campaign_data.folder.rig.parent.mkdir(parents=True)
    assert campaign_data.rig is not None
    write_sheet(campaign_data.folder.rig, campaign_data.rig)
    write_manifest(root, campaign_data.manifest)
    campaign_data.folder.truth.mkdir()
    write_truth(root, truth_of(bench=BENCH))
    indicators = {**evaluation.indicators, "camera_reprojection_error": chessboard_result.indicator}
    write_results(root.parent / "results.json", replace(evaluation, indicators=indicators))
    assert len(score_campaign(root, root.parent / "results.json").items) == 18 + 9 + 2


def test_map_of_a_known_lens_error() -> None:
    """Rationale: without distortion an error of the principal point by (3, -4) px moves every point by 5 px, and a rotation takes
    up all of it but what perspective leaves: a turn by a = 5/3000 moves a point at angle t by a (1 + tan2 t), so with tan t up to
    0.61 about 5 * 0.2 px remain. A focal length wrong by f moves a point at radius r by r * df / f: over an image of half sides
    w, h the RMS is df/f * sqrt((w2 + h2) / 3). Expected: those. Tolerance: 5.0 to rounding; the residue
    within a factor of 2; the RMS to 1 %, the grid has 48 cells."""
    true = Lens(fx_px=3000.0, fy_px=3000.0, cx_px=1536.0, cy_px=1024.0)
    moved = true.model_copy(update={"cx_px": 1539.0, "cy_px": 1020.0})
    plain, turned = distortion_error(moved, true, (3072, 2048))
    assert plain == pytest.approx(5.0, abs=1e-9)
    assert 0.1 < turned < 1.0
    longer = true.model_copy(update={"fx_px": 3001.0, "fy_px": 3001.0})
    expected = 1.0 / 3001.0 * np.sqrt((1536.0**2 + 1024.0**2) / 3.0)
    assert distortion_error(longer, true, (3072, 2048))[0] == pytest.approx(expected, rel=0.01)


def test_map_forgives_a_rotation() -> None:
    """Rationale: the true lens seen through a camera that is turned by 0.02 degrees about each axis: the estimate is fitted to
    where the turned camera sees points, by principal point and focal length only. Expected: the rotation that is taken out leaves
    less than a tenth of the plain figure. Checked against the projection of turned rays. Tolerance: the factor."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.15, 0.15, (200, 2)), np.ones(200)])
    turn = euler_rotation(*np.radians([0.02, 0.02, 0.0]))
    shift = (project(TRUE_LENS, points @ turn.T) - project(TRUE_LENS, points)).mean(axis=0)
    moved = TRUE_LENS.model_copy(
        update={"cx_px": TRUE_LENS.cx_px + float(shift[0]), "cy_px": TRUE_LENS.cy_px + float(shift[1])}
    )
    middle = np.zeros((9, 9))
    middle[3:6, 3:6] = 1
    plain, turned = distortion_error(moved, TRUE_LENS, (3072, 2048), middle)
    assert plain == pytest.approx(np.hypot(*shift), rel=0.02)
    assert turned < 0.1 * plain


def test_map_within_the_covered_field() -> None:
    """Rationale: k3 does nothing at the middle and much in the corners. Expected: an error of k3 counts less when only the middle
    ninth was covered than over the whole image, by far more than a factor of ten; no covered cell at all: not a number."""
    wrong = TRUE_LENS.model_copy(update={"k3": 0.05})
    middle = np.zeros((3, 3))
    middle[1, 1] = 7
    size = (3072, 2048)
    assert distortion_error(wrong, TRUE_LENS, size, middle)[0] < 0.05 * distortion_error(wrong, TRUE_LENS, size)[0]
    assert np.isnan(distortion_error(wrong, TRUE_LENS, size, np.zeros((3, 3)))[0])


def test_figures_follow_their_standard_deviation() -> None:
    """Rationale: two digits of the standard deviation are enough, and 0.0002 +- 0.0000 is not. Expected: 5e-6 needs 7 decimals,
    0.003 needs 4, 40 none but two are shown; without one, 4."""
    assert [decimals(s) for s in (5e-6, 0.003, 40.0, 1e-12, 0.0, None, float("nan"))] == [7, 4, 2, 8, 4, 4, 4]
