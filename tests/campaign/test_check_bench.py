"""What `check` says of bench/ and ranging/: a sound folder has no line, each fault has one."""

import shutil
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest
import tifffile

from campaign.benches.bench import (
    BoardExposure,
    BoardSheet,
    RoomSheet,
    SphereExposure,
    write_board,
    write_board_log,
    write_room,
    write_sphere_log,
)
from campaign.benches.ranging import (
    RangingLine,
    RangingPanel,
    StationReading,
    TotalStation,
    line_path,
    readings_path,
    scan_path,
    scan_paths,
    write_line,
    write_readings,
)
from campaign.checks.folder import check_campaign
from campaign.folder import CampaignFolder
from campaign.manifest import read_manifest, write_manifest

SPHERE = tuple(
    SphereExposure(
        image=f"S_{k:03d}.tif",
        gps_time_s=465_000_000.125 + 15.0 * k,
        since_lamp_on_s=1500.0 + 15.0 * k,
        exposure_time_s=1 / 3,
        gain_e_per_dn=3.051,
        f_number=5.6,
        camera_temperature_c=None if k == 1 else -3.25,
    )
    for k in range(3)
)
BOARD = (BoardExposure(image="B_1.png"), BoardExposure(image="B_2.png", gps_time_s=4.5e8, distance_m=0.1 + 0.2))
STATION = {"class_mm": 5.0, "additive_constant_m": -0.0014, "scale": 3e-6, "reference_index": 1.000286338}
LINE = RangingLine(
    stations=(
        TotalStation(name="A", wavelength_um=0.658, serves=("correction",), **STATION),
        TotalStation(name="B", wavelength_um=0.85, **STATION),
    ),
    panels=(RangingPanel(id="L01", size_m=1.2), RangingPanel(id="L02", size_m=1.2, nominal_reflectance_percent=60.0)),
    eccentricity_m=(0.35, -0.22, 0.1),
    eccentricity_std_m=0.0005,
)
READINGS = [
    StationReading(
        station=station,
        panel=panel,
        observation=k,
        slope_distance_m=15.0 + 0.1 * k,
        horizontal_angle_deg=359.99999,
        zenith_angle_deg=90.1,
        temperature_c=27.0,
        pressure_hpa=1008.0,
        relative_humidity_percent=65.0,
    )
    for station in ("A", "B")
    for panel in ("L01", "L02")
    for k in (1, 2)
]


def png(width: int, height: int, bits: int = 8, colour: int = 2, data: bytes = b"") -> bytes:
    """A PNG whose header states any size."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")


def jpeg_header(width: int, height: int) -> bytes:
    """A JPEG of a frame header and nothing else."""
    return b"\xff\xd8\xff\xc0" + struct.pack(">HBHHB", 11, 8, height, width, 1) + b"\x01\x11\x00\xff\xd9"


@pytest.fixture
def bench_campaign(tmp_path: Path, hand: ModuleType) -> CampaignFolder:
    """A folder of benches and a line alone, with no flight: written by hand."""
    folder = CampaignFolder(tmp_path / "indoors")
    rng = np.random.default_rng(1)
    write_room(folder.room, RoomSheet(dust_free=True))
    for place in (folder.sphere_stability, folder.sphere_repeatability):
        write_sphere_log(place / "log.csv", list(SPHERE)[:1] + list(SPHERE)[2:])
        for name in ("S_000.tif", "S_002.tif"):
            tifffile.imwrite(place / name, rng.integers(0, 999, (32, 48, 3)).astype(np.uint16), photometric="rgb")
    write_board(folder.chessboard / "board.json", BoardSheet(inner_columns=5, inner_rows=4, square_m=0.06))
    write_board_log(folder.chessboard / "log.csv", [BoardExposure(image=f"B_{k}.png") for k in range(3)])
    for k in range(3):
        cv2.imwrite(str(folder.chessboard / f"B_{k}.png"), rng.integers(0, 255, (30, 40, 3)).astype(np.uint8))
    write_line(line_path(folder), LINE)
    write_readings(readings_path(folder), READINGS)
    for number in (1, 2):
        hand.write_strip(tmp_path / "strip.las", scan_path(folder, number), n=20)
    (folder.root / "sensors").mkdir()
    hand.write_sheet(folder.camera, hand.make_camera())
    write_manifest(folder.root, hand.make_manifest())
    return folder


def lines(folder: CampaignFolder) -> list[str]:
    return [str(p) for p in check_campaign(folder.root, checksums=False)]


def test_a_sound_bench_has_no_problem(bench_campaign: CampaignFolder) -> None:
    """Rationale: a campaign of benches alone is a normal one. Expected: no error, no warning of plan, survey or flight."""
    assert lines(bench_campaign) == []


def test_a_flight_beside_the_bench_is_still_asked_for(bench_campaign: CampaignFolder) -> None:
    """Rationale: with a survey the campaign is one of a flight. Expected: the warnings of what the flight lacks."""
    (bench_campaign.root / "survey").mkdir()
    found = lines(bench_campaign)
    assert len(found) == 6  # plan, targets, spectra, lidar, rig, sorties
    assert all(line.startswith("warning: ") for line in found)


def spoil_log(place: str, old: str, new: str) -> Callable[[Path], object]:
    def spoil(root: Path) -> None:
        path = root / place
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return spoil


@pytest.mark.parametrize(
    ("spoil", "severity", "message"),
    [
        (lambda r: (r / "bench/room.json").write_text("{"), "error", "room.json: is not valid JSON"),
        (lambda r: (r / "bench/room.json").unlink(), "warning", "room.json: missing; the room (6.3)"),
        (lambda r: (r / "bench/chessboard/board.json").unlink(), "warning", "board.json: missing"),
        (lambda r: (r / "bench/chessboard/log.csv").unlink(), "warning", "chessboard/log.csv: missing"),
        (lambda r: (r / "bench/chessboard/B_1.png").unlink(), "error", "B_1.png: named in log.csv, but missing"),
        (
            lambda r: (r / "bench/chessboard/B_1.png").write_bytes(png(10**6, 10**6)),
            "error",
            "B_1.png: size of a picture; got 1000000 x 1000000 px",
        ),
        (
            lambda r: (r / "bench/chessboard/B_1.png").write_bytes(png(10, 10, data=b"\0" * 310)),
            "warning",
            "log.csv: images of another size than most: B_1.png; got 10 x 10 px, 3 bands of 8 bit; expected 40 x 30 px",
        ),
        (
            lambda r: (r / "bench/chessboard/B_9.jpg").write_bytes(jpeg_header(4, 4)),
            "warning",
            "B_9.jpg: not named in log.csv",
        ),
        (
            lambda r: (r / "bench/sphere_stability/S_000.tif").write_bytes(b"II*\0"),
            "error",
            "sphere_stability/S_000.tif: is no readable TIFF",
        ),
        (
            spoil_log("bench/sphere_stability/log.csv", ",1500.0,", ",,"),
            "warning",
            "sphere_stability/log.csv: column since_lamp_on_s: no value in row 2",
        ),
        (lambda r: (r / "sensors/camera.json").unlink(), "warning", "bench/sphere_stability: no sensors/camera.json"),
        (lambda r: (r / "ranging/line.json").unlink(), "warning", "line.json: missing"),
        (lambda r: (r / "ranging/total_station.csv").unlink(), "warning", "total_station.csv: missing"),
        (spoil_log("ranging/total_station.csv", "A,L01,", "C,L01,"), "error", "station C is not in line.json; 1 rows"),
        (spoil_log("ranging/total_station.csv", "A,L01,", "A,L03,"), "error", "panel L03 is not in line.json"),
        (spoil_log("ranging/total_station.csv", "A,L01,2,", "A,L01,1,"), "warning", "observation 1 of panel L01 by A"),
        (
            spoil_log("ranging/total_station.csv", "A,L01,2,15.2,", "A,L01,2,,"),
            "warning",
            "total_station.csv: column slope_distance_m: no value in row 3",
        ),
        (
            spoil_log("ranging/line.json", '"id": "L02"', '"id": "L04"'),
            "warning",
            "no reading of panel L04, which line.json names",
        ),
        (lambda r: (r / "ranging/scans/scan_01.laz").write_bytes(b"LASF"), "error", "scan_01.laz: "),
        (
            lambda r: (r / "ranging/scans/scan_01.laz").rename(r / "ranging/scans/scan_1.laz"),
            "error",
            "scan_1.laz: is not read; expected scan_NN.las",
        ),
    ],
)
def test_each_fault_is_a_line(
    bench_campaign: CampaignFolder, spoil: Callable[[Path], object], severity: str, message: str
) -> None:
    """Expected: a line that names the file and the fault, no absolute path, no line break, and of the right severity."""
    spoil(bench_campaign.root)
    write_manifest(bench_campaign.root, read_manifest(bench_campaign.root))
    found = lines(bench_campaign)
    hits = [line for line in found if message in line]
    assert hits, found
    assert all(line.startswith(severity) for line in hits)
    assert all(len(line.splitlines()) == 1 and str(bench_campaign.root) not in line for line in found)


@pytest.mark.parametrize(
    "name",
    [
        "ranging/line.json",
        "ranging/total_station.csv",
        "bench/room.json",
        "bench/chessboard/board.json",
        "bench/sphere_stability/log.csv",
        "sensors/camera.json",
    ],
)
def test_a_folder_in_the_place_of_a_file(bench_campaign: CampaignFolder, name: str) -> None:
    """Expected: one error of the folder, as of any unreadable file."""
    (bench_campaign.root / name).unlink()
    (bench_campaign.root / name).mkdir()
    write_manifest(bench_campaign.root, read_manifest(bench_campaign.root))
    assert lines(bench_campaign).count(f"error: {name}: is a folder; expected a file") == 1


@pytest.mark.parametrize("name", ["bench", "bench/chessboard", "ranging", "ranging/scans"])
def test_a_file_in_the_place_of_a_folder(bench_campaign: CampaignFolder, name: str) -> None:
    """Expected: one error; without it the part would silently be absent."""
    shutil.rmtree(bench_campaign.root / name)
    (bench_campaign.root / name).write_text("hello")
    write_manifest(bench_campaign.root, read_manifest(bench_campaign.root))
    assert f"error: {name}: is a file; expected a folder" in lines(bench_campaign)


def test_links_that_lead_out_are_named_and_not_opened(bench_campaign: CampaignFolder, tmp_path: Path) -> None:
    """Rationale: a hostile campaign may link to any file of the machine. Expected: a line for each link, that it is no plain file;
    nothing of what it leads to (broken JSON, no picture, no LAS) is told; a scan behind a link is none."""
    secret = tmp_path / "secret"
    secret.write_text("{ secret")
    names = ["bench/room.json", "bench/sphere_stability/S_000.tif", "ranging/line.json", "ranging/scans/scan_01.laz"]
    for name in names:
        (bench_campaign.root / name).unlink()
        (bench_campaign.root / name).symlink_to(secret)
    found = lines(bench_campaign)
    for name in names:
        plain = [line for line in found if f": {name}: " in line]
        assert [line.partition(": ")[2].partition(": ")[2].partition(";")[0] for line in plain] == [
            "leaves the campaign folder",
            "is no plain file",
        ]
    assert list(scan_paths(bench_campaign)) == [2]


def test_missing_air_is_named(bench_campaign: CampaignFolder) -> None:
    """Rationale: (12) needs temperature and pressure, and without them no reading serves, also where the columns are absent.
    Expected: a warning each; humidity is worth under 1 ppm: none where nobody recorded it."""
    bare = [replace(r, temperature_c=None, pressure_hpa=None, relative_humidity_percent=None) for r in READINGS]
    write_readings(readings_path(bench_campaign), bare)
    write_manifest(bench_campaign.root, read_manifest(bench_campaign.root))
    columns = [line.split("column ")[1].split(":")[0] for line in lines(bench_campaign) if "column" in line]
    assert columns == ["temperature_c", "pressure_hpa"]


def test_no_scan_and_previews(bench_campaign: CampaignFolder) -> None:
    """Rationale: a line without its scans is a subset like any other; a JPEG beside its TIFF is a preview. Expected: one warning of
    the scans, none of the preview."""
    for path in (bench_campaign.ranging / "scans").iterdir():
        path.unlink()
    (bench_campaign.sphere_stability / "S_000.jpg").write_bytes(jpeg_header(4, 4))
    write_manifest(bench_campaign.root, read_manifest(bench_campaign.root))
    assert [line.split(": ")[:2] for line in lines(bench_campaign)] == [["warning", "ranging/scans"]]
