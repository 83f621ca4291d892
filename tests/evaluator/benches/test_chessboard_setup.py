"""What log.csv and board.json state that the images contradict, and how it reaches conformity and flight."""

from dataclasses import replace

import numpy as np
import pytest

from campaign.benches.bench import BoardExposure, BoardSheet
from campaign.sensors import Calibration
from evaluator.benches.bench_model import ChessboardResult
from evaluator.benches.c9_2_companions import setup_notes
from evaluator.benches.order import flight_lens
from evaluator.c9_2_camera_geometry import _larger_board, _Seen
from evaluator.conformity import conformity_rows
from evaluator.conformity.model import ConformityInputs, Row
from evaluator.model import CampaignData

BOARD = BoardSheet(inner_columns=17, inner_rows=12, square_m=0.03, width_m=0.6, height_m=0.45)
DISTANCE_M = np.array([1.0, 1.5, 2.0, 2.5])


def only(rows: list[Row], clause: str) -> Row:
    (found,) = [r for r in rows if r.clause == clause]
    return found


def test_what_fits_gives_no_note() -> None:
    """Expected: distances within 20 % (a tape to the tripod), a board somewhat wider than its squares, one focus: nothing;
    distances that are not stated neither."""
    assert setup_notes(BOARD, DISTANCE_M, list(1.19 * DISTANCE_M), (2.0,)) == []
    assert setup_notes(BOARD, DISTANCE_M, [None] * 4, ()) == []


def test_units_that_do_not_fit() -> None:
    """Rationale: mm in the place of m turns every distance, and nothing else. Expected: one note with the ratio and the count; by
    hand: 18 squares of 0.034 m are 0.612 m and do not fit on 0.6 m, 18 of 0.011 m (0.198 m) do not fill a third of it."""
    (note,) = setup_notes(BOARD, DISTANCE_M, [1000.0, 1.5, 2000.0, None], ())
    assert "by more than 20% in 2 of 3 images (it is 1e+03 times it)" in note
    (note,) = setup_notes(BOARD.model_copy(update={"square_m": 0.034}), DISTANCE_M, [None] * 4, ())
    assert "18 squares of square_m are 0.612 m, where width_m of board.json is 0.6 m" in note
    found = setup_notes(BOARD.model_copy(update={"square_m": 0.011}), DISTANCE_M, [None] * 4, ())
    assert len(found) == 2 and "13 squares of square_m are 0.143 m, where height_m" in found[1]


def test_a_refocused_series(bench_data: CampaignData, bench_inputs: ConformityInputs) -> None:
    """Rationale: a lens that was refocused between images is several lenses; its calibration must not pass for one. Expected: a
    note, a failed row of 9.2.2 b, and the flight keeps its certificate with the reason; with one setting none of them."""
    (note,) = setup_notes(BOARD, DISTANCE_M, [None] * 4, (1.0, 24.0))
    assert "the focus was changed during the series: 2 settings from 1 to 24 m" in note
    result, camera = bench_inputs.chessboard, bench_data.camera
    assert result is not None and camera is not None and result.lens is not None and result.covariance is not None
    size = (camera.width_px, camera.height_px)
    certificate = Calibration(
        certificate="K 1",
        date="2026-01-01",
        lens=result.lens,
        covariance=tuple(tuple(float(v) for v in r) for r in result.covariance),
    )
    data = replace(bench_data, camera=camera.model_copy(update={"calibration": certificate}))
    refocused = replace(result, image_size_px=size, focus_distance_m=None, focus_settings_m=(1.0, 24.0))
    kept, line = flight_lens(data, refocused)
    assert kept is data and "the focus was changed during the series" in line
    assert "calibration of 9.2 of this campaign" in flight_lens(data, replace(refocused, focus_settings_m=(2.0,)))[1]
    failed = only(conformity_rows(data, replace(bench_inputs, chessboard=refocused)), "9.2.2 b")
    assert (failed.status, failed.measured) == ("fail", "2: 1 m to 24 m")
    assert only(conformity_rows(bench_data, bench_inputs), "9.2.2 b").status == "pass"


def test_boards_found_without_a_calibration(bench_data: CampaignData, bench_inputs: ConformityInputs) -> None:
    """Rationale: "board found in 0 of 25" sends people to the board's paint where the distances were at fault. Expected: the number
    of images in which it was found, and a pass; h still counts the images of the calibration: none."""
    result = bench_inputs.chessboard
    assert result is not None
    names = [row.image for row in bench_data.bench.board_log]
    value = replace(result.indicator, value=None, reason="no calibration", companions={"boards_found": names[:-1]})
    inputs = replace(bench_inputs, chessboard=ChessboardResult(indicator=value))
    rows = conformity_rows(bench_data, inputs)
    assert only(rows, "6.3.2 f").status == "pass"
    assert f"board found in {len(names) - 1} of {len(names)} images" in only(rows, "6.3.2 f").measured
    assert only(rows, "6.3.2 h").status == "fail"


@pytest.mark.parametrize("more", [True, False])
def test_only_a_larger_board_is_told(bench_data: CampaignData, monkeypatch: pytest.MonkeyPatch, more: bool) -> None:
    """Rationale: a part of the stated board is found in every picture of it; telling that sends people to a sound board.json.
    Expected: a hint where the pattern goes on beyond what is stated, and only then."""
    monkeypatch.setattr("evaluator.c9_2_camera_geometry.read_picture", lambda path: np.zeros((8, 8, 1), np.uint8))
    monkeypatch.setattr("evaluator.c9_2_camera_geometry.goes_on", lambda grey, columns, rows: more)
    row = BoardExposure(image="b_1.tif")
    hint = _larger_board(bench_data, BOARD, _Seen(rows=[row] * 4, boards=[None] * 4))  # type: ignore[list-item]
    told = "; the pattern in b_1.tif goes on beyond the 17 x 12 inner corners that board.json states"
    assert hint == (told if more else "")
