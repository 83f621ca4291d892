"""Clauses 5 to 9: a good flight passes, each fault turns its own row, a missing record is never an error."""

from dataclasses import fields, replace

import numpy as np
import pytest

from campaign.flight.trajectory import Trajectory
from evaluator.conformity import ConformityInputs, Row, conformity_rows, flight_height
from evaluator.conformity.clause_6 import band_flatness, common_field_half_m
from evaluator.conformity.flight import acceleration, sun_elevation, wind_two_minute_mean
from evaluator.model import BenchData, CampaignData, EvaluationError, RangingData

NO_BENCH = ("6.3.1", "6.3.2", "8.2.2", "9.1.2", "9.2.2")  # one row each where there is no bench and no ranging line


def statuses(rows: list[Row], clause: str, word: str = "") -> list[str]:
    """Of every row of one clause whose requirement holds a word."""
    return [r.status for r in rows if r.clause == clause and word in r.requirement]


def test_good_flight(campaign_data: CampaignData, conformity_inputs: ConformityInputs) -> None:
    """Rationale: the hand-made flight keeps to every clause. Expected: no fail; warnings only where the campaign has no bench
    (5.2) and where no person picked targets (8.3.2 c, 9.3.2 c)."""
    rows = conformity_rows(campaign_data, conformity_inputs)
    assert [r for r in rows if r.status == "fail"] == []
    assert [r.clause for r in rows if r.status == "warning"] == ["5.2", "8.3.2 c", "9.3.2 c"]
    assert [r.clause for r in rows if r.status == "not_recorded"] == ["5.1"]
    clauses = {r.clause for r in rows}
    expected = (
        "5.1 5.2 5.3 5.4_a 5.4_b 5.5_a 5.5_b 6.2.1_a 6.2.1_b 6.2.1_c 6.2.2_a 6.2.2_b 6.2.2_c 6.2.2_d 6.2.2_e 6.2.2_f "
    )
    expected += (
        "6.2.2_g 6.2.3_a 6.2.3_b 7.1_a 7.1_b 7.1_c 7.1_d 7.1_e 7.1_f 7.1_g 7.2_a 7.2_b 7.2_c 7.2_d 7.3_a 7.3_b 7.3_c "
    )
    expected += "7.4_a 7.4_b 7.4_c 8.1.2_a 8.3.2_a 8.3.2_c 9.3.2_a 9.3.2_b 9.3.2_c "
    expected += " ".join(NO_BENCH)
    assert clauses == {c.replace("_", " ") for c in expected.split()}


def test_nothing_recorded(bare_data: CampaignData) -> None:
    """Rationale: an early field campaign has nothing but a manifest. Expected: every row not recorded, except the datum that the
    manifest itself states, and benches and instruments that nobody used."""
    rows = conformity_rows(bare_data, ConformityInputs())
    assert {r.status for r in rows if r.clause not in ("5.3", "5.4 a", "5.4 b", *NO_BENCH)} == {"not_recorded"}
    assert [r.status for r in rows if r.clause in NO_BENCH] == ["not_applicable"] * 5
    assert statuses(rows, "5.3") == ["not_applicable", "not_recorded", "not_recorded", "not_applicable"]
    assert statuses(rows, "5.4 a") + statuses(rows, "5.4 b") == ["pass"] * 3


@pytest.mark.parametrize(
    "part", [f.name for f in fields(CampaignData) if f.name not in ("folder", "manifest", "problems")]
)
def test_each_part_may_be_missing(campaign_data: CampaignData, conformity_inputs: ConformityInputs, part: str) -> None:
    """Rationale: one unreadable file must not take the table with it. Expected: as many rows as ever, and none fails."""
    empty = {"targets": (), "sorties": (), "bench": BenchData(), "ranging": RangingData()}.get(part)
    rows = conformity_rows(replace(campaign_data, **{part: empty}), conformity_inputs)
    assert len(rows) == len(conformity_rows(campaign_data, conformity_inputs))
    assert "not_recorded" in {r.status for r in rows}
    assert [r for r in rows if r.status == "fail"] == []


@pytest.mark.parametrize(
    ("change", "clause", "word", "status"),
    [
        ({"projection_epsg": 32651}, "5.4 a", "plane", "warning"),
        ({"height_epsg": 5773}, "5.4 a", "heights", "warning"),
        ({"start_time": "2026-06-12T02:30:00+00:00"}, "5.4 b", "", "fail"),
    ],
)
def test_manifest_faults(
    campaign_data: CampaignData, conformity_inputs: ConformityInputs, change: dict, clause: str, word: str, status: str
) -> None:
    """Rationale and expected: each datum or time system other than the clause's turns its own row."""
    if "projection_epsg" in change:
        campaign_data = replace(campaign_data, targets=())
    data = replace(campaign_data, manifest=campaign_data.manifest.model_copy(update=change))
    assert statuses(conformity_rows(data, conformity_inputs), clause, word) == [status]


@pytest.mark.parametrize(
    ("change", "clause", "word"),
    [
        ({"ground_slope_deg": 10.0}, "6.2.1 b", ""),  # "less than 10"
        ({"obstacle_angle_deg": 20.1}, "7.2 a", "obstacles"),
        ({"lock_lost": True}, "7.2 a", "lock"),
        ({"static_check_s": 0.0}, "7.2 b", "rest"),
        ({"gsd_m": 0.02}, "7.4 a", "resolution"),  # H = 60 m, planned 45 m
    ],
)
def test_plan_faults(
    campaign_data: CampaignData, conformity_inputs: ConformityInputs, change: dict, clause: str, word: str
) -> None:
    """Rationale and expected: each stated value past its limit fails in its own row."""
    assert campaign_data.plan is not None
    data = replace(campaign_data, plan=campaign_data.plan.model_copy(update=change))
    assert statuses(conformity_rows(data, conformity_inputs), clause, word) == ["fail"]


@pytest.mark.parametrize(
    ("change", "clause", "status"),
    [
        ({"illuminance_lx": 100_001.0}, "6.2.1 c", "fail"),
        ({"illuminance_lx": 9_999.0}, "6.2.1 c", "fail"),
        ({"illuminance_lx": 100_000.0}, "6.2.1 c", "pass"),
        ({"illuminance_lx": None}, "6.2.1 c", "not_recorded"),
        ({"wind_speed_m_s": 10.7}, "7.2 d", "pass"),
        ({"wind_speed_m_s": 10.8}, "7.2 d", "fail"),
        ({"wind_speed_m_s": None}, "7.2 d", "not_recorded"),
        ({"satellites": 9}, "7.2 b", "fail"),
        ({"satellites": None}, "7.2 b", "not_recorded"),
    ],
)
def test_environment_faults(
    campaign_data: CampaignData, conformity_inputs: ConformityInputs, change: dict, clause: str, status: str
) -> None:
    """Rationale and expected: limits of light, wind and satellites as printed, and None is a missing record, not a zero."""
    sorties = tuple(
        replace(s, environment=tuple(replace(r, **change) for r in s.environment)) for s in campaign_data.sorties
    )
    rows = conformity_rows(replace(campaign_data, sorties=sorties), conformity_inputs)
    assert statuses(rows, clause)[0] == status


@pytest.mark.parametrize(
    ("change", "clause", "status"),
    [
        ({"material": "plywood"}, "6.2.2 a", "fail"),
        ({"material": "plywood"}, "6.2.2 e", "fail"),
        ({"material": ""}, "6.2.2 g", "not_recorded"),
        ({"horizontal": 0.0101}, "6.2.2 f", "fail"),
        ({"height_std_m": 0.02}, "6.2.2 f", "fail"),
        ({"size_m": 0.49}, "6.2.2 c", "fail"),
        ({"size_m": 0.5}, "6.2.2 c", "pass"),  # 50 x 50 x 35.4 cm inverted
        ({"size_m": 0.8, "style": "upright", "vertex_offset_m": 0.8 / np.sqrt(2)}, "6.2.2 c", "fail"),  # 28.3 cm high
        ({"size_m": 0.85, "style": "upright", "vertex_offset_m": 0.85 / np.sqrt(2)}, "6.2.2 c", "pass"),  # 30.05 cm
        ({"vertex_offset_m": 0.02}, "6.2.2 d", "fail"),
        ({"vertex_offset_m": 0.0026}, "6.2.2 d", "pass"),  # the outer faces of 1.5 mm sheet meet 2.6 mm away
        ({"nominal_reflectance_percent": 20.0}, "8.1.2 a", "fail"),
    ],
)
def test_target_faults(
    campaign_data: CampaignData, conformity_inputs: ConformityInputs, change: dict, clause: str, status: str
) -> None:
    """Rationale and expected: materials, sizes, angles and survey accuracy of clause 6.2.2; figures beside the cases."""
    if "horizontal" in change:
        change = {
            "easting_std_m": change["horizontal"] / np.sqrt(2),
            "northing_std_m": change["horizontal"] / np.sqrt(2),
        }
    data = replace(campaign_data, targets=tuple(replace(t, **change) for t in campaign_data.targets))
    assert statuses(conformity_rows(data, conformity_inputs), clause) == [status]


def test_layout_without_a_corner(campaign_data: CampaignData, conformity_inputs: ConformityInputs) -> None:
    """Rationale: 6.2.3 a wants the four corners. Expected: without the frustum in the south-west the row fails and names it."""
    data = replace(campaign_data, targets=tuple(t for t in campaign_data.targets if t.id != "F01"))
    row = next(
        r for r in conformity_rows(data, conformity_inputs) if r.clause == "6.2.3 a" and "corners" in r.requirement
    )
    assert (row.status, "none at SW" in row.measured) == ("fail", True)


def test_common_field(campaign_data: CampaignData) -> None:
    """Rationale: the field that both sensors see at 45 m, by hand. Camera 3072 x 2048 px, f 3000 px: 23.04 m across, 15.36 m
    along; LiDAR ±35 degrees: 31.51 m across. Expected: flown north-south and east-west the smaller one limits both axes: 15.36 m.
    Tolerance: rounding."""
    field = common_field_half_m(campaign_data)
    assert field == pytest.approx((15.36, 15.36), abs=1e-9)
    assert campaign_data.plan is not None
    north = tuple(s for s in campaign_data.plan.strips if s.heading_deg in (0.0, 180.0))
    data = replace(campaign_data, plan=campaign_data.plan.model_copy(update={"strips": north}))
    assert common_field_half_m(data) == pytest.approx((23.04, 15.36), abs=1e-9)


@pytest.mark.parametrize(
    ("change", "clause", "word", "status"),
    [
        ({"panel_points": {"P01": 100}}, "5.5 b", "", "fail"),
        ({"panel_brightness": {"P01": 0.29}}, "5.5 a", "", "fail"),
        ({"panel_brightness": {"P01": 0.05, "P02": 0.99}}, "5.5 a", "", "pass"),  # the mean of all panels counts: 52 %
        ({"targets_in_image": {(1, "a.tif"): 44, (2, "b.tif"): 43}}, "6.2.3 b", "image", "warning"),
        ({"targets_in_image": {(1, "a.tif"): 43}}, "6.2.3 b", "image", "fail"),
        ({"scan_interval_s": {(1, 1): 61.0}}, "6.2.3 b", "interval", "warning"),
        ({"frustums_used": 19}, "9.3.2 a", "", "fail"),
        ({"panels_picked_by": "person"}, "8.3.2 c", "", "pass"),
        ({"indicators_measured": 8}, "5.2", "", "pass"),
    ],
)
def test_observed_faults(
    campaign_data: CampaignData, conformity_inputs: ConformityInputs, change: dict, clause: str, word: str, status: str
) -> None:
    """Rationale and expected: what only images and point clouds tell turns its own row."""
    assert statuses(conformity_rows(campaign_data, replace(conformity_inputs, **change)), clause, word) == [status]


def _with_trajectory(data: CampaignData, change: dict) -> CampaignData:
    return replace(
        data,
        sorties=tuple(
            replace(s, trajectory=None if s.trajectory is None else replace(s.trajectory, **change(s.trajectory)))
            for s in data.sorties
        ),
    )


@pytest.mark.parametrize(
    ("change", "clause", "word", "expected"),
    [
        (lambda t: {"velocity_ned_m_s": t.velocity_ned_m_s * 3.3}, "7.3 a", "", "fail"),  # 16.5 m/s
        (lambda t: {"velocity_ned_m_s": t.velocity_ned_m_s * 3.19}, "7.3 a", "", "pass"),  # 15.95 m/s
        (lambda t: {"ellipsoid_height_m": t.ellipsoid_height_m + 2.4}, "7.4 b", "design", "fail"),  # 2.4 of 45 m: 5.3 %
        (lambda t: {"ellipsoid_height_m": t.ellipsoid_height_m + 2.4}, "7.4 c", "design", "pass"),
        (lambda t: {"ellipsoid_height_m": t.ellipsoid_height_m + 5.1}, "7.4 c", "design", "fail"),
        (lambda t: {"ellipsoid_height_m": t.ellipsoid_height_m + 980.0}, "7.4 a", "ceiling", "fail"),
        # a saw tooth of 10 s: 0.3 m/s up gives 2.7 m within the 9 s of a strip: 6 % of 45 m; 0.6 m/s gives 12 %
        (
            lambda t: {"ellipsoid_height_m": t.ellipsoid_height_m + 0.3 * (t.gps_time_s % 10.0)},
            "7.4 b",
            "within",
            "warning",
        ),
        (
            lambda t: {"ellipsoid_height_m": t.ellipsoid_height_m + 0.6 * (t.gps_time_s % 10.0)},
            "7.4 b",
            "within",
            "fail",
        ),
        (
            lambda t: {"ellipsoid_height_m": t.ellipsoid_height_m + 5.1 * (t.gps_time_s % 10.0 - 5)},
            "7.4 c",
            "neighbour",
            "fail",
        ),
    ],
)
def test_flight_faults(
    campaign_data: CampaignData, conformity_inputs: ConformityInputs, change, clause: str, word: str, expected: str
) -> None:
    """Rationale and expected: speeds and heights past the limits of 7.3 and 7.4, figures beside the cases."""
    rows = conformity_rows(_with_trajectory(campaign_data, change), conformity_inputs)
    assert statuses(rows, clause, word) == [expected]


def test_turns_do_not_count(campaign_data: CampaignData, conformity_inputs: ConformityInputs) -> None:
    """Rationale: 7.3 c speaks of strips; the hand-made trajectory turns on the spot between them, 10 m/s in one epoch.
    Expected: pass along strips; a window over the turn fails with (5 - -5) / 0.5 = 20 m/s². Tolerance: rounding of the text."""
    rows = conformity_rows(campaign_data, conformity_inputs)
    assert statuses(rows, "7.3 c") == ["pass"]
    start = conformity_inputs.strip_window_s[1, 1][0]
    over_turn = replace(conformity_inputs, strip_window_s={(1, 1): (start, start + 12.0)})
    found = next(r for r in conformity_rows(campaign_data, over_turn) if r.clause == "7.3 c")
    assert (found.status, found.measured) == ("fail", "20.00 m/s² (sortie 1 strip 1)")


def test_constant_acceleration(campaign_data: CampaignData) -> None:
    """Rationale: differences over half a second of a velocity that grows by 2 m/s² give 2 m/s² exactly.
    Expected: 2.0 everywhere. Tolerance: 1e-9, rounding."""
    base = campaign_data.sorties[0].trajectory
    assert isinstance(base, Trajectory)
    speed = 2.0 * (base.gps_time_s - base.gps_time_s[0])
    moving = replace(base, velocity_ned_m_s=np.stack([0.6 * speed, 0.8 * speed, 0.0 * speed], axis=1))
    found = acceleration(moving, slice(0, 400))
    assert found.size > 300
    np.testing.assert_allclose(found, 2.0, atol=1e-9)


def test_low_sun(campaign_data: CampaignData, conformity_inputs: ConformityInputs) -> None:
    """Rationale: 7.2 c. Two strips eight hours apart at 31° N: at 18:30 in Beijing the sun is near the horizon.
    Expected: both rows fail."""
    start = conformity_inputs.strip_window_s[1, 1]
    late = replace(
        conformity_inputs, strip_window_s={(1, 1): start, (2, 1): (start[0] + 28_800.0, start[1] + 28_800.0)}
    )
    assert statuses(conformity_rows(campaign_data, late), "7.2 c") == ["fail", "fail"]


def test_sun_at_a_solstice_noon(campaign_data: CampaignData) -> None:
    """Rationale: at the June solstice the sun culminates at 90° - latitude + 23.436°.
    Expected: 82.153° at 31.283° N at its highest on 2026-06-21. Tolerance: 0.02°: refraction at that height is 0.002°, the
    declination changes by 0.001° within half a day, and the sun moves 0.01° in half a minute of sampling."""
    noon = 1466042400 + 18 - 1_000_000_000  # 02:00 UTC on that day
    elevation = sun_elevation(campaign_data, noon + np.arange(0.0, 7200.0, 30.0))
    assert elevation.max() == pytest.approx(90.0 - 31.283 + 23.436, abs=0.02)


def test_two_minute_wind() -> None:
    """Rationale: a gust of 12 m/s for 20 s among 5 m/s is not force 6. Expected: (10 · 5 + 2 · 12 + 5) / 13 for windows of 13
    records. Tolerance: rounding."""
    time = np.arange(0.0, 600.0, 10.0)
    speed = np.where((time >= 300.0) & (time < 320.0), 12.0, 5.0)
    assert wind_two_minute_mean(time, speed) == pytest.approx((11 * 5.0 + 2 * 12.0) / 13)
    assert wind_two_minute_mean(time[:3], np.array([1.0, 2.0, 6.0])) == 3.0


def test_flatness_of_a_ramp() -> None:
    """Rationale: (max - min) / mean of a straight line. Expected: 0.4 to 0.6 over 500-600 nm: 0.2 / 0.5 = 0.4, also when the
    band's edges fall between samples. Tolerance: rounding."""
    wavelength = np.arange(400.0, 1701.0, 30.0)
    assert band_flatness(wavelength, 0.4 + 0.002 * (wavelength - 500.0), 500.0, 600.0) == pytest.approx(0.4)
    assert band_flatness(wavelength, np.full(wavelength.size, 0.3), 545.0, 555.0) == 0.0


def test_flight_height() -> None:
    """Rationale: formula (1) by hand: 35 mm, 1 cm, 4.4 µm. Expected: 79.545 m (the P1's data sheet says 80 m for 1 cm).
    Tolerance: rounding."""
    assert flight_height(35.0, 0.01, 0.0044) == pytest.approx(79.5454545)


@pytest.mark.parametrize("bad", [(0.0, 0.01, 0.0044), (35.0, -0.01, 0.0044), (35.0, 0.01, float("nan"))])
def test_flight_height_refuses(bad: tuple[float, float, float]) -> None:
    """Rationale: a zero pixel or a negative resolution is a wrong entry. Expected: an error, not infinity."""
    with pytest.raises(EvaluationError):
        flight_height(*bad)
