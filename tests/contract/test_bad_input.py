"""Bad input through the command line: one line that names the file or the key, exit code 1, nothing half-written.

What the line has to hold is written here by hand for each damage; that it is one line, without a traceback and without an
internal error, is checked for all alike.
"""

import contextlib
import json
import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import tifffile

from campaign.manifest import read_manifest, write_manifest
from testrange import cli

TINY = Path(__file__).parents[1] / "data" / "tiny.toml"
S = "sorties/01"
SMALL = [
    part
    for setting in (
        "flight.heights_m=[22.0]",
        "camera.width_px=640",
        "camera.height_px=480",
        "camera.pixel_size_um=20.0",
        "camera.lens.fx_px=676.0",
        "camera.lens.fy_px=676.0",
        "camera.lens.cx_px=320.0",
        "camera.lens.cy_px=240.0",
        "lidar.prr_hz=100000.0",
        "render.target_samples=1",
    )
    for part in ("--set", setting)
]
IMAGE = f"{S}/images/s01_l01_001.tif"
STRIP = f"{S}/lidar/strip_01.las"


def refused(capsys: pytest.CaptureFixture[str], place: Path, arguments: list[str], *words: str, code: int = 1) -> str:
    """Runs one command that must fail: its line, after everything that holds for all of them was checked."""
    before = sorted(place.iterdir())
    capsys.readouterr()
    assert cli.call(arguments) == code
    printed = capsys.readouterr()
    assert printed.err.startswith("testrange: ")
    assert printed.err.count("\n") == 1
    assert "Traceback" not in printed.err
    assert "internal error" not in printed.err
    assert len(printed.err) < 1200
    for word in words:
        assert word in printed.err
    kept = {
        f".{Path(out).name}.part" for out in [*arguments, ""][1:] if "no space left" in printed.err
    }  # to be resumed
    assert [p for p in sorted(place.iterdir()) if p.name not in kept] == before
    return printed.err


@pytest.fixture(scope="session")
def thin(tiny_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small campaign's first sortie without truth/ and benches: few bytes to copy for each damage."""
    place = tmp_path_factory.mktemp("thin") / "campaign"
    shutil.copytree(
        tiny_run / "campaign", place, ignore=shutil.ignore_patterns("truth", "02", "*_points.laz", "bench", "ranging")
    )
    write_manifest(place, read_manifest(place))
    return place


@pytest.fixture
def folder(thin: Path, tmp_path: Path) -> Path:
    """A copy that a test may damage."""
    return Path(shutil.copytree(thin, tmp_path / "campaign"))


def swap(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def column(path: Path, name: str, value: str, row: int = 1) -> None:
    """One cell of a CSV file."""
    lines = [line.split(",") for line in path.read_text().splitlines()]
    lines[row][lines[0].index(name)] = value
    path.write_text("\n".join(",".join(line) for line in lines) + "\n")


def key(path: Path, name: str, value: object) -> None:
    """One value of a JSON file."""
    content = json.loads(path.read_text())
    place = content
    *parents, last = name.split(".")
    for parent in parents:
        place = place[parent]
    place[last] = value
    path.write_text(json.dumps(content))


def cut(path: Path, share: float) -> None:
    os.truncate(path, int(path.stat().st_size * share))


def patch(path: Path, at: int, raw: bytes) -> None:
    with path.open("r+b") as file:
        file.seek(at)
        file.write(raw)


def sbet(path: Path, col: int, value: float, record: int | slice = slice(None)) -> None:
    table = np.fromfile(path, "<f8").reshape(-1, 17)
    table[record, col] = value
    table.tofile(path)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("lidar.divergence_mrad=0.5", ("lidar.divergence_mrad is not a setting", "did you mean lidar.divergence_rad?")),
        ("flihgt.speed_m_s=5.0", ("flihgt", "is not a setting")),
        ("flight.speed_m_s=-5.0", ("flight.speed_m_s", "got -5.0", "greater than 0")),
        ("flight.heights_m=[-45.0]", ("flight.heights_m", "-45.0", "greater than 0")),
        ("flight.heights_m=[0.045]", ("flight.heights_m", "got 0.045", "in metres; is the unit wrong?")),
        ("flight.heights_m=[45000.0]", ("flight.heights_m", "in metres")),
        ("flight.heights_m=[]", ("flight.heights_m",)),
        ("flight.speed_m_s=nan", ("flight.speed_m_s",)),
        ("flight.speed_m_s=inf", ("flight.speed_m_s",)),
        ('flight.speed_m_s="fast"', ("flight.speed_m_s", '"fast"', "valid number")),
        ("lidar.scanner.sector_deg=[35.0, -35.0]", ("lidar.scanner.sector_deg", "least before greatest")),
        ("lidar.divergence_rad=0.5", ("lidar.divergence_rad", "radians; is the unit wrong?")),
        ("lidar.wavelength_nm=1.55", ("lidar.wavelength_nm", "got 1.55", "400")),
        ("lidar.pulse_fwhm_ns=4e-9", ("lidar.pulse_fwhm_ns", "nanoseconds")),
        ("lidar.prr_hz=0.3", ("lidar.prr_hz", "hertz")),
        ("camera.exposure_time_s=1000.0", ("camera.exposure_time_s", "seconds")),
        ("camera.pixel_size_um=4.5e-6", ("camera.pixel_size_um", "micrometres")),
        ("camera.lens.fx_px=15.0", ("camera.lens.fx_px", "expected about")),
        ("camera.lens.k1=1e6", ("camera.lens", "normalised image coordinates")),
        ("camera.lens.fy_px=1e-300", ("camera.lens.fy_px",)),
        ("faults.camera_clock_s=2.0", ("faults.camera_clock_s", "in seconds")),
        ("faults.range_offset_m=20.0", ("faults.range_offset_m", "in metres")),
        ("faults.camera_boresight_deg=[900.0, 0.0, 0.0]", ("faults.camera_boresight_deg", "degrees")),
        ("faults.camera_lever_arm_m=[30.0, 0.0, 0.0]", ("faults.camera_lever_arm_m", "in metres")),
        ("navigation.position_std_m=[0.01, 0.01, 0.01]", ("navigation.position_std_m", 'grade = "custom"')),
        ("platform.track_std_m=1e300", ("platform.track_std_m", "in metres")),
        ("platform.max_acceleration_m_s2=1e-12", ("platform.max_acceleration_m_s2",)),
        ("site.longitude_deg=-121.2", ("site.longitude_deg", "check the sign")),
        ("site.latitude_deg=3128.3", ("site.latitude_deg",)),
        ("site.projection_epsg=1", ("site.projection_epsg", "EPSG")),
        ("site.ground_material=lawn", ("site.ground_material",)),
        ("campaign.start_time=2026-09-25T10:30:00", ("campaign.start_time", "UTC offset")),
        ('campaign.id="../../escape"', ("campaign.id",)),
        ('camera.use="../../../etc/passwd"', ("ready-made", "passwd")),
        ("targets.frustums.count=-3", ("targets.frustums.count",)),
        ("targets.frustums.thickness_m=1.5", ("targets.frustums.thickness_m", "metres")),
        # so low that no image could hold the targets
        ("flight.heights_m=[5.0]", ("targets", "do not fit in the field that both sensors see", "at 5 m")),
        ("seed", ("--set seed", "key=value")),
        ("seed=7 8", ("seed",)),
        ("seed=[[[[[[1]]]]]]", ("seed",)),
    ],
)
def test_configuration_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, setting: str, words: tuple[str, ...]
) -> None:
    """Rationale: a slip in a unit, a sign or a name costs a person minutes of simulation if it passes. Expected: refused before
    anything is made, by the key's name, with what was expected."""
    refused(
        capsys, tmp_path, ["simulate", str(TINY), "--out", str(tmp_path / "c"), "--quiet", "--set", setting], *words
    )


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"\xff\xfe\x00", "is not UTF-8 text"),
        (b"seed = ", "is not valid TOML"),
        (b"[a" * 2000, "is not valid TOML"),
        (b"a = " + b"[" * 100_000, "c.toml"),
        (b"#" * 1_100_000, "too large"),
        (b"", "campaign is missing"),
    ],
)
def test_configuration_file_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, content: bytes, word: str
) -> None:
    (tmp_path / "c.toml").write_bytes(content)
    refused(capsys, tmp_path, ["run", str(tmp_path / "c.toml"), "--out", str(tmp_path / "c"), "--quiet"], word)


def relist(root: Path) -> None:
    """A manifest that agrees with the damaged files: the damage itself must then be seen."""
    write_manifest(root, read_manifest(root))


DAMAGES: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "missing_las": (lambda r: (r / STRIP).unlink(), (STRIP, "missing")),
    "one_byte": (lambda r: patch(r / f"{S}/lidar/strip_01.wdp", 5000, b"\x55\xaa"), ("strip_01.wdp", "checksum differs")),
    "listed_twice": (
        lambda r: key(r / "manifest.json", "files", json.loads((r / "manifest.json").read_text())["files"] * 2),
        ("listed twice",),
    ),
    "manifest_leaves": (
        lambda r: swap(r / "manifest.json", '"path": "plan.json"', '"path": "../plan.json"'),
        ("../plan.json", "leaves the campaign folder"),
    ),
    "manifest_missing": (lambda r: (r / "manifest.json").unlink(), ("manifest.json",)),
    "manifest_deep": (lambda r: (r / "manifest.json").write_text("[" * 100_000), ("manifest.json",)),
    "manifest_nan": (lambda r: swap(r / "manifest.json", '"latitude_deg": ', '"latitude_deg": NaN, "x": '), ("manifest.json",)),
    "link_out": (
        lambda r: ((r / IMAGE).unlink(), (r / IMAGE).symlink_to("/etc/passwd")),
        ("s01_l01_001.tif", "leaves the campaign folder"),
    ),
    "pipe": (lambda r: os.mkfifo(r / "survey/notes"), ("survey/notes", "is no plain file")),
}  # fmt: skip
RELISTED: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "truncated_las": (lambda r: cut(r / STRIP, 0.5), (STRIP, "is truncated", "whole records; expected")),
    "las_count": (
        lambda r: patch(r / STRIP, 247, struct.pack("<Q", 2**62)),
        (STRIP, "is truncated", "4611686018427387904 by its header"),
    ),
    "las_text": (lambda r: (r / STRIP).write_bytes(b"x" * 500), (STRIP, "is no LAS file")),
    "las_twice": (lambda r: shutil.copy(r / STRIP, r / f"{S}/lidar/strip_1.las"), ("strip_1.las", "strip_01.las")),
    "wdp_short": (
        lambda r: cut(r / f"{S}/lidar/strip_01.wdp", 0.9),
        ("strip_01.wdp", "is shorter than its packets say", "expected at least"),
    ),
    "wdp_missing": (lambda r: (r / f"{S}/lidar/strip_01.wdp").unlink(), ("strip_01.wdp", "expected the packets of")),
    "image_size": (
        lambda r: tifffile.imwrite(r / IMAGE, np.zeros((9, 9, 3), np.uint16), photometric="rgb"),
        (IMAGE, "another size", "got 9 x 9 px", "expected 1536 x 1024 px"),
    ),
    "image_cut": (lambda r: cut(r / IMAGE, 0.5), (IMAGE, "is truncated")),
    "image_missing": (lambda r: (r / IMAGE).unlink(), (IMAGE, "named in exposures.csv, but missing")),
    "image_leaves": (
        lambda r: column(r / f"{S}/images/exposures.csv", "image", "../../../../../etc/passwd"),
        ("exposures.csv", "row 2 column image", "a file name without a folder"),
    ),
    "exposures_twice": (
        lambda r: column(r / f"{S}/images/exposures.csv", "image", "s01_l02_001.tif"),
        ("exposures.csv", "named twice"),
    ),
    "exposures_empty": (lambda r: (r / f"{S}/images/exposures.csv").write_text(""), ("exposures.csv", "is empty")),
    "survey_nan": (
        lambda r: column(r / "survey/targets.csv", "northing_m", "nan"),
        ("survey/targets.csv", "row 2 column northing_m", "a finite number"),
    ),
    "survey_negative_std": (
        lambda r: column(r / "survey/targets.csv", "height_std_m", "-0.004"),
        ("row 2 column height_std_m", "0 to 10 m"),
    ),
    "survey_millimetres": (lambda r: column(r / "survey/targets.csv", "size_m", "700"), ("size_m", "0.01 to 100 m")),
    "survey_twice": (lambda r: column(r / "survey/targets.csv", "id", "P02"), ("survey/targets.csv", "P02")),
    "survey_of_points": (
        lambda r: (r / "survey/targets.csv").write_text(
            "\n".join(
                [
                    *(lines := (r / "survey/targets.csv").read_text().splitlines()),
                    *(f"X{i},{lines[1].split(',', 1)[1]}" for i in range(3000)),
                ]
            )
        ),
        ("survey/targets.csv", "too many targets", "at most 2000"),
    ),
    "spectra_dark": (
        lambda r: (r / "survey/spectra.csv").write_text("wavelength_nm,P01\n400,0\n1700,0\n"),
        ("spectra.csv", "column P01", "reflects nothing"),
    ),
    "image_depth": (
        lambda r: tifffile.imwrite(r / IMAGE, np.zeros((1024, 1536, 3), np.uint8), photometric="rgb"),
        (IMAGE, "another depth", "expected uint16"),
    ),
    "image_huge": (
        lambda r: (
            key(r / "sensors/camera.json", "width_px", 20_000),
            key(r / "sensors/camera.json", "height_px", 20_000),
        ),
        ("too large an image", "expected at most"),
    ),
    "black_level": (
        lambda r: key(r / "sensors/camera.json", "black_level_dn", 1e300),
        ("sensors/camera.json", "black_level_dn", "below 2^bit_depth"),
    ),
    "survey_kilometres": (
        lambda r: column(r / "survey/targets.csv", "northing_m", "3462.9"),
        ("survey/targets.csv", "P01: lies", "km from the site's origin", "in metres"),
    ),
    "survey_utf16": (
        lambda r: (r / "survey/targets.csv").write_bytes((r / "survey/targets.csv").read_text().encode("utf-16")),
        ("survey/targets.csv", "is not UTF-8 text"),
    ),
    "survey_no_id": (lambda r: column(r / "survey/targets.csv", "id", "../x"), ("column id", "letters, digits")),
    "spectra_nan": (lambda r: column(r / "survey/spectra.csv", "P01", "nan"), ("spectra.csv", "column P01")),
    "spectra_percent": (lambda r: column(r / "survey/spectra.csv", "P01", "55.0"), ("a reflectance from 0 to 1.5",)),
    "trajectory_empty": (
        lambda r: (r / f"{S}/trajectory.out").write_bytes(b""),
        (f"{S}/trajectory.out", "is empty", "records of 136 bytes"),
    ),
    "trajectory_cut": (lambda r: cut(r / f"{S}/trajectory.out", 0.49999), ("trajectory.out", "is truncated")),
    "trajectory_short": (
        lambda r: os.truncate(r / f"{S}/trajectory.out", 136 * 500),
        ("time outside the trajectory", "expected within"),
    ),
    "trajectory_nan": (
        lambda r: sbet(r / f"{S}/trajectory.out", 3, np.nan, 50),
        ("trajectory.out", "record 50", "not finite"),
    ),
    "trajectory_degrees": (lambda r: sbet(r / f"{S}/trajectory.out", 1, 31.28), ("trajectory.out", "expected radians")),
    "heading_degrees": (
        lambda r: sbet(r / f"{S}/trajectory.out", 9, 180.0),
        ("trajectory.out", "roll, pitch or heading", "expected radians"),
    ),
    "longitude_sign": (
        lambda r: sbet(r / f"{S}/trajectory.out", 2, -2.1156),
        ("trajectory.out", "begins far from the site", "expected near 31.2"),
    ),
    "trajectory_hole": (
        lambda r: np.delete(np.fromfile(r / f"{S}/trajectory.out").reshape(-1, 17), slice(900, 3000), 0).tofile(
            r / f"{S}/trajectory.out"
        ),
        ("trajectory.out", "has a hole of"),
    ),
    "gps_week": (lambda r: key(r / "manifest.json", "gps_week", 2419), ("time outside the trajectory",)),
    "epsg": (lambda r: key(r / "manifest.json", "projection_epsg", 4326), ("EPSG:4326",)),
    "camera_missing_key": (
        lambda r: swap(r / "sensors/camera.json", '"width_px"', '"width"'),
        ("sensors/camera.json", "width_px"),
    ),
    "camera_metres": (
        lambda r: key(r / "sensors/camera.json", "pixel_size_um", 9e-6),
        ("sensors/camera.json", "pixel_size_um"),
    ),
    "covariance": (
        lambda r: key(r / "sensors/camera.json", "calibration.covariance", [[1.0] * 9] * 8),
        ("sensors/camera.json", "9 x 9"),
    ),
    "bands": (
        lambda r: key(
            r / "sensors/camera.json",
            "bands",
            [{"name": f"b{i}", "centre_nm": 500.0, "fwhm_nm": 9.0} for i in range(1000)],
        ),
        ("sensors/camera.json", "1000", "1 to 3"),
    ),
    "sector": (
        lambda r: key(r / "sensors/lidar.json", "sector_deg", [35.0, -35.0]),
        ("sensors/lidar.json", "sector_deg", "least first"),
    ),
    "sampling": (lambda r: key(r / "sensors/lidar.json", "sampling_ns", 2.0), ("another sampling interval",)),
    "negative_spread": (
        lambda r: key(r / "sensors/rig.json", "navigation.attitude_std_deg", [-0.01, 0.01, 0.01]),
        ("sensors/rig.json", "attitude_std_deg", "greater than or equal to 0"),
    ),
    "lever_arm_millimetres": (
        lambda r: key(r / "sensors/rig.json", "camera.lever_arm_m", [150.0, 30.0, 80.0]),
        ("sensors/rig.json", "lever_arm_m"),
    ),
    "wind_km_h": (lambda r: column(r / f"{S}/environment.csv", "wind_speed_m_s", "300"), ("wind_speed_m_s", "m/s")),
}


@pytest.mark.parametrize("name", [*DAMAGES, *RELISTED])
def test_folder_is_refused(capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path, name: str) -> None:
    """Rationale: an evaluation of a damaged folder would be believed. Expected: refused before it begins; the line names the
    file and the fault, and says how to go on."""
    damage, words = (DAMAGES | RELISTED)[name]
    damage(folder)
    if name in RELISTED:
        relist(folder)
    line = refused(capsys, tmp_path, ["evaluate", str(folder), "--out", str(tmp_path / "results"), "--quiet"], *words)
    assert "--keep-going" in line
    if " more: " in line:
        assert f"testrange check {folder} lists them" in line


def moved(root: Path, metres: float, target: str = "F01") -> None:
    path = root / "survey/targets.csv"
    rows = path.read_text().splitlines()
    row = next(i for i, line in enumerate(rows) if line.startswith(f"{target},"))
    column(path, "easting_m", repr(float(rows[row].split(",")[2]) + metres), row)
    relist(root)


def test_target_outside_every_image(capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path) -> None:
    """Rationale: a wrong survey row must not pass as a mark that was not found. Expected: with images the line names the target,
    the nearest image and the distance: 200 m less what the image covers beyond the target; without images the strip."""
    moved(folder, 200.0)
    out = ["--out", str(tmp_path / "results"), "--quiet"]
    line = refused(capsys, tmp_path, ["evaluate", str(folder), *out], "target F01 lies outside every image", "s01_l0")
    distance = float(line.split("_001.tif, ")[1].split(" m ")[0])
    assert 160.0 < distance < 200.0
    shutil.rmtree(folder / S / "images")
    relist(folder)
    line = refused(
        capsys, tmp_path, ["evaluate", str(folder), *out], "target F01 lies outside every strip", "sortie 1 strip"
    )
    assert "--keep-going" in line


def test_keep_going_names_what_is_left_out(capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path) -> None:
    """Rationale: a field campaign with one broken part is still worth an evaluation. Expected: with a broken camera sheet, a cut
    strip and a target elsewhere the LiDAR's reflectance is measured from the other strip, P_m is not and says why, each fault
    is among the problems without this machine's paths, and truth/ is not missed."""
    moved(folder, 200.0, "F02")
    cut(folder / STRIP, 0.5)
    key(folder / "sensors/camera.json", "f_number", -5.6)
    for name in ("observations_camera.csv", "lidar/strip_07.las"):
        os.mkfifo(folder / S / name)  # nobody writes into it: reading would never end
    assert cli.call(["evaluate", str(folder), "--out", str(tmp_path / "r"), "--quiet", "--keep-going"]) == 0
    assert capsys.readouterr().err == ""
    results = json.loads((tmp_path / "r/results.json").read_text())
    assert str(tmp_path) not in (tmp_path / "r/results.json").read_text()
    assert results["indicators"]["lidar_reflectance_rmse"]["grade"] != "not_measured"
    assert results["indicators"]["calibration_error"]["grade"] == "not_measured"
    assert "camera.json" in results["indicators"]["calibration_error"]["reason"]
    told = "\n".join(results["problems"])
    for word in ("strip_01.las: is truncated", "camera.json: f_number", "target F02 lies outside every strip"):
        assert word in told


@contextlib.contextmanager
def largest_file(size: int) -> Iterator[None]:
    """As on a full disk: no file of this process may grow beyond `size` bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("size", [1_000, 300_000, 1_000_000])
def test_disk_full_while_simulating(capsys: pytest.CaptureFixture[str], tmp_path: Path, size: int) -> None:
    """Expected: whether the survey, the trajectory or an image is the first that does not fit, one line and no folder."""
    command = ["simulate", str(TINY), "--out", str(tmp_path / "c"), "--quiet", *SMALL]
    with largest_file(size):
        refused(capsys, tmp_path, command, "no space left")


@pytest.mark.parametrize("size", [1_500_000, 3_000_000])
def test_disk_full_under_a_strip(capsys: pytest.CaptureFixture[str], tmp_path: Path, size: int) -> None:
    """Expected: the same where LAS, packets and their compressed twin grow together."""
    command = ["simulate", str(TINY), "--out", str(tmp_path / "c"), "--quiet", "--only", "lidar"]
    with largest_file(size):
        refused(capsys, tmp_path, command, "no space left")


@pytest.mark.parametrize(("only", "missing"), [("camera", "lidar"), ("lidar", "images")])
def test_one_sensor_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path, only: str, missing: str) -> None:
    """Rationale: a folder may hold any subset. Expected: it is sound, it is evaluated, and what needs the other sensor is not
    measured with a reason; nothing is named as a problem."""
    campaign = tmp_path / "c"
    assert cli.call(["simulate", str(TINY), "--out", str(campaign), "--quiet", "--only", only, *SMALL]) == 0
    assert not (campaign / S / missing).exists()
    assert cli.call(["evaluate", str(campaign), "--out", str(tmp_path / "r"), "--quiet"]) == 0
    results = json.loads((tmp_path / "r/results.json").read_text())
    assert results["problems"] == []
    indicators = results["indicators"]
    assert indicators["lidar_reflectance_rmse"]["grade"] == "not_measured" or only == "lidar"
    for name in ("reflectance_correlation", "calibration_error"):
        assert indicators[name]["grade"] == "not_measured"
        assert len(indicators[name]["reason"]) > 10
    assert capsys.readouterr().err == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    "setting", ["targets.frustums.count=0", "targets.panels.count_of_each=1", 'lidar.use="velodyne_vlp16"']
)
def test_unusual_ranges(capsys: pytest.CaptureFixture[str], tmp_path: Path, setting: str) -> None:
    """Expected: a range without frustum targets, with one panel a level, or under a spinning scanner is run to its end: every
    indicator has a value or a reason."""
    assert cli.call(["run", str(TINY), "--out", str(tmp_path / "r"), "--quiet", "--set", setting, *SMALL]) == 0
    results = json.loads((tmp_path / "r/results/results.json").read_text())
    assert all(i["value"] is not None or i["reason"] for i in results["indicators"].values())
    assert capsys.readouterr().err == ""


def test_disk_full_while_evaluating(capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path) -> None:
    shutil.rmtree(folder / S / "images")
    shutil.rmtree(folder / S / "lidar")
    relist(folder)
    with largest_file(1_000):
        refused(capsys, tmp_path, ["evaluate", str(folder), "--out", str(tmp_path / "r"), "--quiet"], "no space left")


def test_occupied_output_is_refused_first(capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path) -> None:
    """Expected: refused before minutes of work, and what stands there stays."""
    for command in (["simulate", str(TINY)], ["run", str(TINY)]):
        refused(capsys, tmp_path, [*command, "--out", str(folder), "--quiet"], "already exists and is not empty")
    refused(capsys, tmp_path, ["evaluate", str(folder), "--out", str(folder), "--quiet"], "inside the campaign")
    (tmp_path / "file").write_text("mine")
    for command in (["simulate", str(TINY)], ["evaluate", str(folder)]):
        refused(capsys, tmp_path, [*command, "--out", str(tmp_path / "file"), "--quiet"], "exists and is not a folder")
        refused(capsys, tmp_path, [*command, "--out", str(tmp_path / "file/x"), "--quiet"], "cannot be written")


def test_interrupt_while_simulating(tmp_path: Path) -> None:
    """Rationale: people stop long runs. Expected: SIGINT in the middle of rendering ends the process within seconds with code
    130, one line after the progress, and nothing on the disk but what the same command goes on with."""
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "  # a shell's background job ignores it
        "from testrange.cli import main; sys.argv[0] = 'testrange'; main()"
    )
    command = [sys.executable, "-c", program, "simulate", str(TINY), "--out", str(tmp_path / "c")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("camera"):
                break
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
        assert process.wait(30) == 130
    assert rest.splitlines()[-1] == "testrange: interrupted"
    assert "Traceback" not in rest
    assert [p.name for p in tmp_path.iterdir()] == [".c.part"]


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[]",
        "{" * 100_000,
        '{"schema": 1}',
        '{"schema": 1, "campaign": "tiny", "indicators": {}, "conformity": [], "mounting": []}',
        '{"schema": 1, "campaign": "other", "indicators": {}, "conformity": [], "mounting": {}}',
        *(
            '{"schema": 1, "campaign": "tiny", "indicators": {}, "conformity": [], "mounting": {"status": "measured", '
            f'"names": ["camera_boresight_roll"], "units": ["deg"], "estimates": {estimates}, "std": {std}}}}}'
            for estimates, std in (("[1]", "[]"), ('["x"]', "[1]"), ("[NaN]", "[1]"), ("[1]", "[-1]"), ("7", "[1]"))
        ),
    ],
)
def test_results_by_hand_are_refused_by_score(
    capsys: pytest.CaptureFixture[str], tiny_run: Path, tmp_path: Path, content: str
) -> None:
    """Rationale: other people's programs write results.json too. Expected: refused with the file's name; no score.json."""
    (tmp_path / "results.json").write_text(content)
    refused(capsys, tmp_path, ["score", str(tiny_run / "campaign"), str(tmp_path)], "results.json")
