"""Rows of the benches and the ranging line: good ones pass, each fault turns its own row, half a bench is never an error."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from campaign.benches.bench import RoomSheet
from evaluator.benches.bench_model import ChessboardResult
from evaluator.conformity import ConformityInputs, Row, conformity_rows
from evaluator.conformity.clause_6_3 import traceability_class
from evaluator.conformity.clause_9_2 import board_angles_deg
from evaluator.frames import euler_rotation
from evaluator.model import BenchData, CampaignData, RangingData

Change = Callable[[CampaignData, ConformityInputs], tuple[CampaignData, ConformityInputs]]


def statuses(rows: list[Row], clause: str, word: str = "") -> list[str]:
    """Of every row of one clause whose requirement holds a word."""
    return [r.status for r in rows if r.clause == clause and word in r.requirement]


def test_good_benches(bench_data: CampaignData, bench_inputs: ConformityInputs) -> None:
    """Rationale: benches and line of the conftest keep to every clause. Expected: nothing fails and nothing is unrecorded; the two
    warnings are those of targets that no person picked; each letter of the clauses has its row, in the standard's order."""
    rows = conformity_rows(bench_data, bench_inputs)
    assert [r for r in rows if r.status in ("fail", "not_recorded", "not_applicable")] == []
    assert [r.clause for r in rows if r.status == "warning"] == ["8.3.2 c", "9.3.2 c"]
    found = [r.clause for r in rows]
    letters = [f"6.3.1 {c}" for c in "abcdef"] + [f"6.3.2 {c}" for c in "abcdefgh"]
    letters += [f"8.2.2.{k} {c}" for k in (1, 2) for c in "cddf"] + [f"9.1.2 {c}" for c in "abcccdefhkk"]
    letters += ["9.2.2 b", "9.2.2 c", "9.2.2 d", "9.2.2 d", "9.2.2"]
    assert [c for c in found if c.startswith(("6.3", "8.2", "9.1", "9.2"))] == letters
    assert [c.split(" ")[0] for c in found] == sorted((c.split(" ")[0] for c in found), key=order_of(found))


def order_of(found: list[str]) -> Callable[[str], tuple[int, ...]]:
    """Clause numbers as numbers: 8.2.2.1 stands after 8.1.2 and before 8.3.2."""
    return lambda clause: tuple(int(n) for n in clause.split("."))


def room(**change: object) -> Change:
    def changed(data: CampaignData, inputs: ConformityInputs) -> tuple[CampaignData, ConformityInputs]:
        assert data.bench.room is not None
        return replace(
            data, bench=replace(data.bench, room=RoomSheet(**(data.bench.room.model_dump() | change)))
        ), inputs

    return changed


def board(**change: object) -> Change:
    def changed(data: CampaignData, inputs: ConformityInputs) -> tuple[CampaignData, ConformityInputs]:
        assert data.bench.board is not None
        return replace(data, bench=replace(data.bench, board=data.bench.board.model_copy(update=change))), inputs

    return changed


def exposures(series: str, row: int, **change: object) -> Change:
    """One row of a sphere log changed."""

    def changed(data: CampaignData, inputs: ConformityInputs) -> tuple[CampaignData, ConformityInputs]:
        log = list(getattr(data.bench, series))
        log[row] = replace(log[row], **change)
        return replace(data, bench=replace(data.bench, **{series: tuple(log)})), inputs

    return changed


def station(index: int, **change: object) -> Change:
    def changed(data: CampaignData, inputs: ConformityInputs) -> tuple[CampaignData, ConformityInputs]:
        line = data.ranging.line
        assert line is not None
        stations = list(line.stations)
        stations[index] = stations[index].model_copy(update=change)
        line = line.model_copy(update={"stations": tuple(stations)})
        return replace(data, ranging=replace(data.ranging, line=line)), inputs

    return changed


def reading(row: int, **change: object) -> Change:
    def changed(data: CampaignData, inputs: ConformityInputs) -> tuple[CampaignData, ConformityInputs]:
        rows = list(data.ranging.readings)
        rows[row] = replace(rows[row], **change)
        return replace(data, ranging=replace(data.ranging, readings=tuple(rows))), inputs

    return changed


def panels(change: Callable[[tuple], tuple]) -> Change:
    def changed(data: CampaignData, inputs: ConformityInputs) -> tuple[CampaignData, ConformityInputs]:
        assert inputs.ranging is not None
        return data, replace(inputs, ranging=replace(inputs.ranging, panels=change(inputs.ranging.panels)))

    return changed


def ranging(**change: object) -> Change:
    """Companions of the ranging indicator changed."""

    def changed(data: CampaignData, inputs: ConformityInputs) -> tuple[CampaignData, ConformityInputs]:
        assert inputs.ranging is not None
        value = inputs.ranging.indicator
        value = replace(value, companions={**value.companions, **change})
        return data, replace(inputs, ranging=replace(inputs.ranging, indicator=value))

    return changed


def chessboard(**change: object) -> Change:
    def changed(data: CampaignData, inputs: ConformityInputs) -> tuple[CampaignData, ConformityInputs]:
        assert inputs.chessboard is not None
        return data, replace(inputs, chessboard=replace(inputs.chessboard, **change))

    return changed


def saturated(share: float) -> Change:
    def changed(data: CampaignData, inputs: ConformityInputs) -> tuple[CampaignData, ConformityInputs]:
        assert inputs.sphere is not None and inputs.sphere.stability_series is not None
        series = replace(inputs.sphere.stability_series, saturated_share=share)
        return data, replace(inputs, sphere=replace(inputs.sphere, stability_series=series))

    return changed


def all_saturated(data: CampaignData, inputs: ConformityInputs) -> tuple[CampaignData, ConformityInputs]:
    """The module of 8.2 refuses the series and says by how much in the indicator's companions."""
    assert inputs.sphere is not None
    refused = replace(inputs.sphere.stability, value=None, reason="saturated", companions={"saturated_share": 1.0})
    return data, replace(inputs, sphere=replace(inputs.sphere, stability=refused, stability_series=None))


ONE_EMPTY_CELL = np.full((4, 6, 8), 3)
ONE_EMPTY_CELL[2, 0, 7] = 0


@pytest.mark.parametrize(
    ("change", "clause", "word", "status"),
    [
        (room(dust_free=False), "6.3.1 a", "", "fail"),
        (room(dust_free=None), "6.3.2 a", "", "not_recorded"),
        (room(single_light_source=False), "6.3.2 b", "", "fail"),
        (room(temperature_c=25.0), "6.3.1 c", "", "pass"),  # 20 +- 5: the bound itself
        (room(temperature_c=25.1), "6.3.1 c", "", "fail"),
        (room(temperature_c=14.9), "6.3.2 c", "", "fail"),
        (room(relative_humidity_percent=49.9), "6.3.1 d", "", "fail"),
        (room(relative_humidity_percent=70.0), "6.3.2 d", "", "pass"),
        (room(relative_humidity_percent=70.1), "6.3.2 d", "", "fail"),
        (room(pressure_hpa=860.0), "6.3.1 e", "", "pass"),  # 86 kPa
        (room(pressure_hpa=859.0), "6.3.1 e", "", "fail"),
        (room(pressure_hpa=1061.0), "6.3.2 e", "", "fail"),
        (room(sphere_traceability="fourth class standard"), "6.3.1 f", "", "fail"),
        (room(sphere_traceability="fourth class standard"), "5.3", "sphere", "fail"),
        (room(sphere_traceability="certificate 7"), "5.3", "sphere", "warning"),
        (room(sphere_traceability=None), "5.3", "sphere", "not_recorded"),
        (board(width_m=0.25, height_m=0.20), "6.3.2 g", "", "pass"),
        (board(width_m=0.25, height_m=0.19), "6.3.2 g", "", "fail"),
        (board(width_m=0.24, height_m=0.24), "6.3.2 g", "", "fail"),
        (board(width_m=None, square_m=0.01), "6.3.2 g", "", "fail"),  # 18 cm of squares
        (exposures("stability", 0, since_lamp_on_s=1199.0), "8.2.2.1 c", "", "fail"),
        (exposures("stability", 0, since_lamp_on_s=1200.0), "8.2.2.1 c", "", "pass"),
        (exposures("repeatability", 0, since_lamp_on_s=None), "8.2.2.2 c", "", "not_recorded"),
        (saturated(1e-6), "8.2.2.1 d", "over-exposed", "fail"),
        (all_saturated, "8.2.2.1 d", "over-exposed", "fail"),
        (exposures("stability", 7, exposure_time_s=0.02), "8.2.2.1 d", "setting", "fail"),
        (exposures("repeatability", 7, gain_e_per_dn=2.9), "8.2.2.2 d", "setting", "fail"),
        (exposures("stability", 20, gps_time_s=1465266618 - 1e9 - 86400 + 3617.0), "8.2.2.1 f", "", "pass"),  # 197 s
        (exposures("stability", 20, gps_time_s=1465266618 - 1e9 - 86400 + 3619.0), "8.2.2.1 f", "", "fail"),  # 199 s
        (panels(lambda p: p[:4]), "9.1.2 a", "", "fail"),
        (panels(lambda p: (*p[:5], replace(p[5], lidar_m=900.0))), "9.1.2 a", "", "warning"),
        (station(0, class_mm=10.1), "9.1.2 c", "total station", "fail"),
        (station(0, class_mm=10.1), "5.3", "slope", "fail"),
        (station(1, class_mm=5.1), "9.1.2 k", "total station", "fail"),
        (station(1, class_mm=5.1), "5.3", "true values", "fail"),
        (panels(lambda p: (replace(p[0], correction_readings=4), *p[1:])), "9.1.2 c", "readings", "fail"),
        (panels(lambda p: (replace(p[0], reference_readings=4), *p[1:])), "9.1.2 k", "readings", "fail"),
        (panels(lambda p: (*p[:5], replace(p[5], scans=4))), "9.1.2 f", "", "fail"),
        (ranging(same_scans=["scan_02.laz holds the same points as scan_01.laz"]), "9.1.2 f", "", "fail"),
        (ranging(chi_square_p=0.00101), "9.1.2 h", "", "pass"),
        (ranging(chi_square_p=0.00099), "9.1.2 h", "", "fail"),
        (ranging(chi_square_p=None), "9.1.2 h", "", "not_recorded"),
        (ranging(beside={"panel": "L02", "share": 0.13}), "9.1.2 c", "panels stand", "fail"),
        (ranging(misread="the angles are in gon"), "9.1.2 c", "panels stand", "fail"),
        (reading(3, pressure_hpa=None), "9.1.2 e", "", "fail"),
        (reading(3, temperature_c=None), "9.1.2 e", "", "fail"),
        (reading(3, relative_humidity_percent=None), "9.1.2 e", "", "warning"),  # 50 % is taken
        (reading(3, pressure_hpa=756.0), "9.1.2 e", "", "warning"),  # 1008 hPa in mmHg
        (station(0, serves=("correction", "reference")), "9.1.2 k", "total station", "pass"),  # B is taken for it
        (
            reading(3, slope_distance_m=None, pressure_hpa=None),
            "9.1.2 e",
            "",
            "pass",
        ),  # that reading is not used at all
        (chessboard(coverage=ONE_EMPTY_CELL), "9.2.2 d", "covered", "fail"),
        (chessboard(distances_m=(1.6, 2.0, 2.5)), "9.2.2 d", "distances", "fail"),
        (chessboard(images=()), "6.3.2 f", "", "fail"),
        (chessboard(images=()), "9.2.2", "", "fail"),
        (chessboard(images=()), "9.2.2 c", "", "not_recorded"),
    ],
)
def test_bench_faults(
    bench_data: CampaignData, bench_inputs: ConformityInputs, change: Change, clause: str, word: str, status: str
) -> None:
    """Rationale and expected: limits as printed, the value on a limit passes, a missing record is no failure; no other clause than
    those that state the same fact turns."""
    data, inputs = change(bench_data, bench_inputs)
    rows = conformity_rows(data, inputs)
    assert statuses(rows, clause, word) == [status]


def test_19_images_are_too_few(bench_data: CampaignData, bench_inputs: ConformityInputs) -> None:
    """Rationale: 25 were taken, but only images in which the board was found serve. Expected: 19 fail, 20 pass, and before
    any image is searched the log's number counts."""
    board = bench_inputs.chessboard
    assert board is not None
    for n, status in ((19, "fail"), (20, "pass")):
        inputs = replace(bench_inputs, chessboard=replace(board, images=board.images[:n]))
        rows = conformity_rows(bench_data, inputs)
        assert statuses(rows, "6.3.2 h") == statuses(rows, "9.2.2") == [status]
    rows = conformity_rows(bench_data, replace(bench_inputs, chessboard=None))
    assert statuses(rows, "6.3.2 h") == ["pass"]


@pytest.mark.parametrize("absent", ["sphere", "chessboard", "ranging"])
def test_one_part_only_missing(bench_data: CampaignData, bench_inputs: ConformityInputs, absent: str) -> None:
    """Rationale: a campaign may hold any subset. Expected: one "not applicable" row for each clause of the absent part, nothing
    else fails, and 5.1 is not recorded since one sensor was not tested alone."""
    empty = {
        "sphere": ({"stability": (), "repeatability": ()}, ["6.3.1", "8.2.2"]),
        "chessboard": ({"board": None, "board_log": ()}, ["6.3.2", "9.2.2"]),
        "ranging": ({}, ["9.1.2"]),
    }
    change, clauses = empty[absent]
    data = replace(bench_data, bench=replace(bench_data.bench, **change))
    if absent == "ranging":
        data = replace(data, ranging=RangingData())
    rows = conformity_rows(data, replace(bench_inputs, **{absent: None}))
    assert [r.clause for r in rows if r.status == "not_applicable" and r.clause != "5.3"] == clauses
    assert statuses(rows, "5.1") == ["not_recorded"]
    assert [r for r in rows if r.status == "fail"] == []


def test_unreadable_parts(bench_data: CampaignData, bench_inputs: ConformityInputs) -> None:
    """Rationale: log, board sheet and line may be torn while the folders are there. Expected: rows not recorded, none fails,
    no error."""
    for place in (bench_data.folder.sphere_stability, bench_data.folder.chessboard, bench_data.folder.ranging):
        place.mkdir(parents=True)
    data = replace(bench_data, bench=BenchData(), ranging=RangingData(), plan=None)
    rows = conformity_rows(data, ConformityInputs())
    inside = [r for r in rows if r.clause.startswith(("6.3", "8.2", "9.1", "9.2"))]
    assert {r.status for r in inside} == {"not_recorded"}
    assert len(inside) == 6 + 8 + 2 + 10 + 5


def test_bench_after_the_flight(bench_data: CampaignData, bench_inputs: ConformityInputs) -> None:
    """Rationale: 5.1 wants single sensors tested first. Expected: benches of the day before pass; the same a week later fail."""
    assert statuses(conformity_rows(bench_data, bench_inputs), "5.1") == ["pass"]
    log = tuple(replace(e, gps_time_s=(e.gps_time_s or 0.0) + 7 * 86400.0) for e in bench_data.bench.board_log)
    late = replace(bench_data, bench=replace(bench_data.bench, board_log=log))
    assert statuses(conformity_rows(late, bench_inputs), "5.1") == ["fail"]


def test_ranging_rows_without_evaluation(bench_data: CampaignData, bench_inputs: ConformityInputs) -> None:
    """Rationale: when no scan can be read, what the surveyors did can still be judged. Expected: layout and readings of the station
    from the raw readings (distances 15 to 240 m, five each), the LiDAR's part not recorded; a reading twice under one number counts
    once."""
    inputs = replace(bench_inputs, ranging=None)
    rows = conformity_rows(bench_data, inputs)
    assert statuses(rows, "9.1.2 a") == ["pass"]
    assert statuses(rows, "9.1.2 c") == ["pass", "pass"]
    assert statuses(rows, "9.1.2 f") == statuses(rows, "9.1.2 b") == ["not_recorded"]
    readings = list(bench_data.ranging.readings)
    readings[1] = replace(readings[1], observation=1)
    doubled = replace(bench_data, ranging=replace(bench_data.ranging, readings=tuple(readings)))
    assert statuses(conformity_rows(doubled, inputs), "9.1.2 c", "readings") == ["fail"]


def test_instruments_by_the_plan(bench_data: CampaignData, bench_inputs: ConformityInputs) -> None:
    """Rationale: 5.3 may be stated in the flight plan only. Expected: the sphere's class is read from its words; a total station
    of the plan is named, but its class is nobody's certificate: a warning, twice for its two uses."""
    assert bench_data.plan is not None
    words = {"integrating_sphere": "third class", "total_station": "1 second"}
    data = replace(
        bench_data,
        plan=bench_data.plan.model_copy(update={"instruments": words}),
        bench=replace(bench_data.bench, room=None),
        ranging=replace(bench_data.ranging, line=None),
    )
    rows = conformity_rows(data, bench_inputs)
    assert statuses(rows, "5.3", "sphere") == statuses(rows, "6.3.1 f") == ["pass"]
    assert statuses(rows, "5.3", "total station") == ["warning", "warning"]
    assert statuses(rows, "6.3.1 a") == ["not_recorded"]


def test_angle_between_boards(chessboard_result: ChessboardResult) -> None:
    """Rationale: boards turned by +15 and -25 degrees about their x axis have normals 40 degrees apart; a turn in the board's own
    plane changes no normal. Expected: 40 and 0. Tolerance: 1e-6 degrees, arccos near 1 loses half the digits."""
    turned = [euler_rotation(np.radians(a), 0.0, 0.0) for a in (15.0, -25.0)]
    rolled = [euler_rotation(0.0, 0.0, np.radians(a)) for a in (0.0, 90.0)]
    images = tuple(
        replace(chessboard_result.images[0], camera_from_board_rotation=r, position=p)
        for p, group in enumerate((turned, rolled))
        for r in group
    )
    found = board_angles_deg(replace(chessboard_result, images=images))
    assert found == pytest.approx({0: 40.0, 1: 0.0}, abs=1e-6)


@pytest.mark.parametrize(
    ("statement", "expected"),
    [
        ("second class standard, certificate of the range's own lamp", 2),
        ("Class 3, compared with a first class standard", 3),
        ("三级溯源", 3),
        ("level 4", 4),
        ("2nd grade", 2),
        ("国家基准", 0),
        ("certificate 20231234", None),
        ("", None),
    ],
)
def test_class_in_words(statement: str, expected: int | None) -> None:
    """Rationale: the class is a sentence of a certificate. Expected: the lowest class named; a certificate's number is none."""
    assert traceability_class(statement) == expected
