"""Tables, sheets, trajectories, truth: exact round trips, and errors that name row and column."""

import dataclasses
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from campaign.config import Lens
from campaign.errors import CampaignError
from campaign.flight.records import (
    CameraObservation,
    EnvironmentRow,
    Exposure,
    LidarObservation,
    read_camera_observations,
    read_environment,
    read_exposures,
    read_lidar_observations,
    read_plan,
    write_camera_observations,
    write_environment,
    write_exposures,
    write_lidar_observations,
    write_plan,
)
from campaign.flight.trajectory import beijing_time, read_trajectory, write_csv, write_sbet, write_smrmsg
from campaign.sensors import read_camera, read_lidar, read_rig, write_sheet
from campaign.survey import Spectra, read_spectra, read_targets, write_gcp_list, write_spectra, write_targets
from campaign.truth import (
    TrueMark,
    TrueMounting,
    TrueReturns,
    TrueTarget,
    Truth,
    read_marks,
    read_true_returns,
    read_true_trajectories,
    read_truth,
    verify_truth,
    write_marks,
    write_true_returns,
    write_true_trajectories,
    write_truth,
)

NINTH = 1.0 / 9.0  # has no short decimal form


def same(a: object, b: object) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))  # type: ignore[arg-type]


def test_survey_round_trip_is_exact(tmp_path: Path, hand: ModuleType) -> None:
    """Rationale: a millimetre lost in a file is a millimetre of calibration. Expected: equality; tolerance none."""
    targets = [dataclasses.replace(t, easting_m=t.easting_m + NINTH) for t in hand.make_targets()]
    write_targets(tmp_path / "targets.csv", targets, 4549, 5737)
    assert read_targets(tmp_path / "targets.csv") == targets
    assert (tmp_path / "targets.prj").read_text().startswith('PROJCS["CGCS2000_3_Degree_GK_CM_120E"')


def test_gcp_list_names_the_projection_and_every_target(tmp_path: Path, hand: ModuleType) -> None:
    write_gcp_list(tmp_path / "gcp_list.txt", hand.make_targets(), 4549)
    lines = (tmp_path / "gcp_list.txt").read_text().splitlines()
    assert lines[0] == "EPSG:4549"
    assert lines[2:] == ["# 520010.1235 3462020.1000 7.1230 P01", "# 520011.0000 3462021.0000 7.2000 F01"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("520010.12345", "nan", "row 2 column easting_m: wrong value; got 'nan'; expected a finite number"),
        ("520010.12345", "12,5", "the row has another length than the header"),
        ("520010.12345", "east", "row 2 column easting_m: wrong value; got 'east'; expected a number"),
        ("F01", "P01", "row 3 column id: the id occurs twice"),
        ("frustum", "cone", "row 3 column kind: wrong value; got 'cone'; expected panel or frustum"),
        ("easting_m,", "east_m,", "unknown column 'east_m'"),
        (",inverted,", ",,", "row 3 column style: is empty; expected a value for a frustum"),
        (",0.003,", ",-0.003,", "row 2 column easting_std_m: wrong value"),
        ("P01", "../P01", "row 2 column id: wrong value"),
        ("id,", '"id,', "is not valid CSV"),
    ],
)
def test_a_bad_survey_names_row_and_column(tmp_path: Path, old: str, new: str, message: str, hand: ModuleType) -> None:
    path = tmp_path / "targets.csv"
    write_targets(path, hand.make_targets(), 4549, 5737)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(CampaignError) as caught:
        read_targets(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_bad_cell_is_a_problem(tmp_path: Path, hand: ModuleType) -> None:
    path = tmp_path / "targets.csv"
    write_targets(path, hand.make_targets(), 4549, 5737)
    path.write_text(path.read_text().replace("520010.12345", "nan").replace("3462021.0", "inf"))
    with pytest.raises(CampaignError) as caught:
        read_targets(path)
    assert [("row 2 column easting_m" in p, "row 3 column northing_m" in p) for p in caught.value.problems] == [
        (True, False),
        (False, True),
    ]


def test_spectra_round_trip_and_faults(tmp_path: Path) -> None:
    path = tmp_path / "spectra.csv"
    spectra = Spectra(
        wavelength_nm=np.array([400.0, 1000.0 + NINTH, 1700.0]),
        panel_ids=("P01", "P02"),
        reflectance=np.full((3, 2), NINTH),
    )
    write_spectra(path, spectra)
    again = read_spectra(path)
    assert again.panel_ids == spectra.panel_ids
    assert np.array_equal(again.wavelength_nm, spectra.wavelength_nm)
    assert np.array_equal(again.reflectance, spectra.reflectance)
    good = path.read_text()
    for old, new, message in (
        ("1700.0", "900.0", "row 4 column wavelength_nm"),
        ("0.1111111111111111", "nan", "row 2 column P01"),
        ("0.1111111111111111", "11.1", "expected a reflectance from 0 to 1.5"),
        ("P02", "P01", "a panel occurs twice"),
    ):
        path.write_text(good.replace(old, new, 1))
        with pytest.raises(CampaignError, match=message):
            read_spectra(path)


def test_records_round_trip_exactly(tmp_path: Path, hand: ModuleType) -> None:
    plan = hand.make_plan()
    write_plan(tmp_path / "plan.json", plan)
    assert read_plan(tmp_path / "plan.json") == plan
    exposures = [
        Exposure(
            image="a.tif",
            gps_time_s=hand.T0 + NINTH,
            strip=1,
            exposure_time_s=NINTH,
            gain_e_per_dn=3.0,
            focus_distance_m=50.0,
        )
    ]
    write_exposures(tmp_path / "e.csv", exposures)
    assert read_exposures(tmp_path / "e.csv") == exposures
    empty = EnvironmentRow(
        gps_time_s=hand.T0,
        illuminance_lx=None,
        wind_speed_m_s=None,
        wind_from_deg=None,
        temperature_c=None,
        pressure_hpa=None,
        relative_humidity_percent=None,
        satellites=None,
    )
    rows = [empty, dataclasses.replace(empty, illuminance_lx=8e4 + NINTH, satellites=12, temperature_c=-3.5)]
    write_environment(tmp_path / "env.csv", rows)
    assert read_environment(tmp_path / "env.csv") == rows
    camera = [CameraObservation(target="F01", image="a.tif", u_px=10.0 + NINTH, v_px=20.5)]
    write_camera_observations(tmp_path / "c.csv", camera)
    assert read_camera_observations(tmp_path / "c.csv") == camera
    lidar = [LidarObservation(target="F01", strip=1, point=123456)]
    write_lidar_observations(tmp_path / "l.csv", lidar)
    assert read_lidar_observations(tmp_path / "l.csv") == lidar


@pytest.mark.parametrize("name", ["../a.tif", "/etc/passwd", "a/b.tif", "..", "a\\b.tif", ""])
def test_image_names_cannot_leave_the_folder(tmp_path: Path, name: str) -> None:
    path = tmp_path / "e.csv"
    path.write_text(f"image,gps_time_s,strip,exposure_time_s,gain_e_per_dn,focus_distance_m\n{name},1,1,0.1,1,1\n")
    with pytest.raises(CampaignError, match="column image"):
        read_exposures(path)


def test_sheets_round_trip_and_refuse_what_is_no_covariance(tmp_path: Path, hand: ModuleType) -> None:
    for sheet, reader in (
        (hand.make_camera(), read_camera),
        (hand.make_lidar(), read_lidar),
        (hand.make_rig(), read_rig),
    ):
        write_sheet(tmp_path / "s.json", sheet)
        assert reader(tmp_path / "s.json") == sheet
    data = json.loads(hand.make_camera().model_dump_json())
    data["calibration"]["covariance"][0][1] = 0.5
    (tmp_path / "c.json").write_text(json.dumps(data))
    with pytest.raises(CampaignError, match=r"calibration.covariance: not a covariance; expected 9 x 9, symmetric"):
        read_camera(tmp_path / "c.json")
    for text, message in (
        ("{", "is not valid JSON"),
        ('{"name": 3}', "name: Input should be a valid string"),
        ("[" * 99999, "JSON"),
    ):
        (tmp_path / "c.json").write_text(text)
        with pytest.raises(CampaignError, match=message):
            read_camera(tmp_path / "c.json")


def test_trajectory_round_trip(tmp_path: Path, hand: ModuleType) -> None:
    """Expected: bit-exact but for attitude RMS, which smrmsg holds in arc minutes: two roundings, 4e-16 relative."""
    trajectory = hand.make_trajectory()
    write_sbet(tmp_path / "t.out", trajectory, hand.WEEK)
    write_smrmsg(tmp_path / "s.out", trajectory, hand.WEEK)
    again = read_trajectory(tmp_path / "t.out", tmp_path / "s.out", hand.WEEK)
    np.testing.assert_allclose(again.attitude_std_rad, trajectory.attitude_std_rad, rtol=1e-15)
    assert same(dataclasses.replace(again, attitude_std_rad=trajectory.attitude_std_rad), trajectory)
    raw = np.fromfile(tmp_path / "t.out", "<f8").reshape(-1, 17)
    assert raw[0, 0] == hand.T0 + 1e9 - hand.WEEK * 604_800
    assert np.array_equal(raw[:, 9], trajectory.heading_rad)
    assert np.isnan(read_trajectory(tmp_path / "t.out", None, hand.WEEK).position_std_m).all()


def test_trajectory_over_the_end_of_a_week_and_with_a_wander_angle(tmp_path: Path) -> None:
    """A file whose time of week starts again at 0, with x and y axes turned by w = 0.3: heading and velocity come back to north."""
    table = np.zeros((3, 17))
    table[:, 0] = [604_799.5, 0.0, 0.5]
    table[:, 9], table[:, 10] = 0.5, 0.3
    north, east = 3.0, 4.0
    # platform axes: x points to azimuth -w
    table[:, 4], table[:, 5] = north * np.cos(0.3) - east * np.sin(0.3), north * np.sin(0.3) + east * np.cos(0.3)
    table.astype("<f8").tofile(tmp_path / "t.out")
    got = read_trajectory(tmp_path / "t.out", None, 2400)
    assert np.array_equal(np.diff(got.gps_time_s), [0.5, 0.5])
    np.testing.assert_allclose(got.heading_rad, 0.2, atol=1e-15)
    np.testing.assert_allclose(got.velocity_ned_m_s[0, :2], [north, east], atol=1e-14)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda raw: b"", "is empty"),
        (lambda raw: raw[:-1], "is truncated"),
        (lambda raw: raw[:136] + raw[:136], "time does not increase"),
        (lambda raw: raw[:8] + np.array([np.nan]).tobytes() + raw[16:], "record 0: a value is not finite"),
        (lambda raw: np.array([1.4e9]).tobytes() + raw[8:136], "time is no GPS seconds of the week"),
        (lambda raw: raw[:8] + np.array([31.0]).tobytes() + raw[16:], "a latitude or longitude is out of range"),
    ],
)
def test_a_bad_trajectory_is_one_line(tmp_path: Path, change, message: str, hand: ModuleType) -> None:
    path = tmp_path / "t.out"
    write_sbet(path, hand.make_trajectory(20), hand.WEEK)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(CampaignError, match=message):
        read_trajectory(path, None, hand.WEEK)


def test_beijing_time_of_known_instants(tmp_path: Path, hand: ModuleType) -> None:
    """2017-01-01T00:00:00Z, the end of the last leap second, is GPS second 1167264018 (IERS bulletin C 52: GPS - UTC = 18 s)."""
    got = beijing_time(np.array([1_167_264_018.0 - 1e9, 1_167_264_018.25 - 1e9]))
    assert str(got[0]) == "2017-01-01T08:00:00.000000"
    assert str(got[1]) == "2017-01-01T08:00:00.250000"
    trajectory = hand.make_trajectory(2)
    write_csv(tmp_path / "t.csv", trajectory)
    rows = (tmp_path / "t.csv").read_text().splitlines()
    assert rows[1].split(",")[:2] == ["465000000.250000", "2026-06-09T08:26:22.250+08:00"]
    assert rows[1].split(",")[5] == f"{np.degrees(trajectory.roll_rad[0]):.5f}"


def make_truth() -> Truth:
    mounting = TrueMounting(
        rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        lever_arm_m=(0.1, 0.0, NINTH),
        boresight_deg=(0.3, -0.2, 0.25),
        lever_arm_error_m=(0.0, 0.0, 0.01),
    )
    return Truth(
        seed=7,
        camera=mounting,
        lidar=mounting,
        lens=Lens(fx_px=3000.0, fy_px=3000.0, cx_px=1536.0, cy_px=1024.0),
        camera_clock_s=1e-4,
        lidar_clock_s=0.0,
        range_offset_m=0.0,
        range_scale=0.0,
        lidar_gain=1.0,
        camera_gain=1.0,
        targets=(TrueTarget(id="F01", kind="frustum", mark_world_m=(1.0, 2.0, 3.0), vertex_world_m=(1.0, 2.0, 3.0)),),
    )


def test_truth_round_trip_and_its_own_checksums(tmp_path: Path, hand: ModuleType) -> None:
    trajectory = hand.make_trajectory()
    rng = np.random.default_rng(1)
    returns = TrueReturns(
        range_m=rng.random(50),
        normal_world=rng.random((50, 3)).astype(np.float32),
        target=rng.integers(-1, 4, 50).astype(np.int32),
        face=rng.integers(-1, 9, 50).astype(np.int8),
    )
    marks = [TrueMark(target="F01", image="sorties/01/images/a.tif", u_px=NINTH, v_px=2.0, visible=False)]
    folder = tmp_path / "truth"
    write_true_trajectories(folder / "trajectory.npz", {1: trajectory, 2: hand.make_trajectory(seed=3)})
    write_true_returns(folder / "returns_01_01.npz", returns)
    write_marks(folder / "marks.csv", marks)
    write_truth(tmp_path, make_truth())
    assert same(read_true_trajectories(folder / "trajectory.npz")[1], trajectory)
    assert same(read_true_returns(folder / "returns_01_01.npz"), returns)
    assert read_true_returns(folder / "returns_01_01.npz").face.dtype == np.int8
    assert read_marks(folder / "marks.csv") == marks
    truth = read_truth(tmp_path)
    assert truth.model_copy(update={"files": ()}) == make_truth()
    assert [f.path for f in truth.files] == ["truth/marks.csv", "truth/returns_01_01.npz", "truth/trajectory.npz"]
    assert verify_truth(tmp_path, truth) == []
    names = [f.name for f in dataclasses.fields(trajectory) if "_std_" not in f.name]
    np.savez(tmp_path / "plain.npz", **{f"s01_{n}": getattr(trajectory, n) for n in names})
    plain = read_true_trajectories(tmp_path / "plain.npz")[1]
    assert np.isnan(plain.position_std_m).all()
    assert np.array_equal(plain.roll_rad, trajectory.roll_rad)
    first = (folder / "trajectory.npz").read_bytes()
    write_true_trajectories(folder / "trajectory.npz", {1: trajectory, 2: hand.make_trajectory(seed=3)})
    assert (folder / "trajectory.npz").read_bytes() == first
    (folder / "marks.csv").write_text("target,image,u_px,v_px,visible\n")
    assert verify_truth(tmp_path, truth)[0].startswith("truth/marks.csv: size differs")


def test_npz_with_a_pickle_is_refused(tmp_path: Path) -> None:
    """Rationale: a pickle runs code. Expected: one line, nothing executed."""
    path = tmp_path / "r.npz"
    np.savez(path, range_m=np.array([{"a": 1}], dtype=object))
    with pytest.raises(CampaignError, match="cannot be read"):
        read_true_returns(path)
    path.write_bytes(b"PK\x03\x04 no zip")
    with pytest.raises(CampaignError, match="cannot be read"):
        read_true_trajectories(path)


@pytest.mark.parametrize(
    ("row", "column"),
    [
        ("F01,a.tif,1e308,1", "u_px"),
        ("F01,a.tif,1,nan", "v_px"),
        ("F01,a.tif,1,x", "v_px"),
        ("<script>,a.tif,1,1", "target"),
        ("F01,../a.tif,1,1", "image"),
    ],
)
def test_picks_that_nobody_made(tmp_path: Path, row: str, column: str) -> None:
    """Rationale: observations_camera.csv comes from outside, and a square of 1e308 has no value. Expected: refused with row and
    column; a pick just beside the image is read."""
    path = tmp_path / "observations_camera.csv"
    path.write_text(f"target,image,u_px,v_px\nF01,a.tif,-3.5,20.25\n{row}\n")
    with pytest.raises(CampaignError, match=f"row 3 column {column}"):
        read_camera_observations(path)
    path.write_text("target,image,u_px,v_px\nF01,a.tif,-3.5,20.25\n")
    assert read_camera_observations(path)[0].u_px == -3.5
