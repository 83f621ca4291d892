"""bench/ and ranging/: what is written is read again, and hostile files are one line."""

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from campaign.benches.bench import (
    MAX_IMAGES,
    BoardExposure,
    BoardSheet,
    RoomSheet,
    SphereExposure,
    read_board,
    read_board_log,
    read_room,
    read_sphere_log,
    write_board,
    write_board_log,
    write_room,
    write_sphere_log,
)
from campaign.benches.pictures import MAX_SIDE_PX, picture_size, read_picture
from campaign.benches.ranging import (
    RangingLine,
    RangingPanel,
    StationReading,
    TotalStation,
    read_line,
    read_readings,
    scan_paths,
    write_line,
    write_readings,
)
from campaign.errors import CampaignError
from campaign.folder import CampaignFolder

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


def one_line(error: pytest.ExceptionInfo[CampaignError], name: str) -> str:
    """The error's text, which names its file and fits on a line."""
    text = str(error.value)
    assert name in text
    assert len(text.splitlines()) == 1
    assert len(text) < 600
    return text


def test_round_trips(tmp_path: Path) -> None:
    """Rationale: a file read and written again is the same to the byte. Expected: equal objects, None as an empty cell, 1/3 and
    0.1 + 0.2 to the last bit; the second writing gives the same bytes. Tolerance: none."""
    room = RoomSheet(dust_free=True, temperature_c=0.1 + 0.2, sphere_traceability="三级")
    board = BoardSheet(inner_columns=17, inner_rows=12, square_m=0.06, material="<b>")
    cases = (
        (write_room, read_room, room),
        (write_board, read_board, board),
        (write_sphere_log, read_sphere_log, list(SPHERE)),
        (write_board_log, read_board_log, list(BOARD)),
        (write_line, read_line, LINE),
        (write_readings, read_readings, READINGS),
    )
    for write, read, value in cases:
        first, second = tmp_path / "first", tmp_path / "second"
        write(first, value)  # type: ignore[operator]
        found = read(first)  # type: ignore[operator]
        assert found == value
        write(second, found)  # type: ignore[operator]
        assert first.read_bytes() == second.read_bytes()


def test_columns_that_were_not_recorded(tmp_path: Path) -> None:
    """Rationale: a laboratory writes what it has. Expected: image and time suffice for the sphere, the image for the board; without
    air a station's reading stands; the rest is None."""
    path = tmp_path / "log.csv"
    path.write_text("gps_time_s,image\n1.5,a.png\n")
    assert read_sphere_log(path) == [SphereExposure(image="a.png", gps_time_s=1.5)]
    path.write_text("image\na.png\n")
    assert read_board_log(path) == [BoardExposure(image="a.png")]
    path.write_text("station,panel,observation,slope_distance_m,horizontal_angle_deg,zenith_angle_deg\nA,L01,1,,1,2\n")
    assert read_readings(path)[0].slope_distance_m is None
    assert read_readings(path)[0].pressure_hpa is None


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (read_sphere_log, "image,gps_time_s\n../a.tif,1\n", "a file name without a folder"),
        (read_sphere_log, "image,gps_time_s\n/etc/passwd,1\n", "a file name without a folder"),
        (read_board_log, "image\na/b.tif\n", "a file name without a folder"),
        (read_board_log, "image\n.hidden\n", "a file name without a folder"),
        (read_board_log, 'image\n"a\nb.tif"\n', "a file name without a folder"),
        (read_sphere_log, "image,gps_time_s\na.tif,nan\n", "row 2 column gps_time_s"),
        (read_sphere_log, "image,gps_time_s,exposure_time_s\na.tif,1,inf\n", "column exposure_time_s"),
        (read_sphere_log, "image,gps_time_s,gain_e_per_dn\na.tif,1,0\n", "column gain_e_per_dn"),
        (read_sphere_log, "image\na.tif\n", "column 'gps_time_s' is missing"),
        (read_sphere_log, "image,gps_time_s,iso\na.tif,1,100\n", "unknown column 'iso'"),
        (read_sphere_log, "image,gps_time_s\na.tif,2\nb.tif,2\n", "time does not rise"),
        (read_sphere_log, "image,gps_time_s\na.tif,2\na.tif,3\n", "named twice"),
        (read_board_log, "image,distance_m\na.tif,1600000\n", "column distance_m"),
        (read_board_log, "image\n" + "".join(f"i{k}\n" for k in range(MAX_IMAGES + 1)), "too many images"),
        (read_board_log, "", "is empty"),
        (read_board_log, "image\n\0\n", "is not a CSV"),
        (read_readings, "station,panel\nA,L01\n", "is missing"),
        (
            read_readings,
            "station,panel,observation,slope_distance_m,horizontal_angle_deg,zenith_angle_deg\nA,L01,1,15000000,1,2\n",
            "column slope_distance_m: wrong value; got '15000000'",
        ),
        (
            read_readings,
            "station,panel,observation,slope_distance_m,horizontal_angle_deg,zenith_angle_deg\nA,L 1,-1,NaN,1,2\n",
            "and 2 more problems",
        ),
    ],
)
def test_bad_tables(tmp_path: Path, read: Callable[[Path], object], text: str, message: str) -> None:
    """Rationale: tables are typed by people. Expected: one line with file, row, column and what would be right."""
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(CampaignError) as caught:
        read(path)
    assert message in one_line(caught, "table.csv")


@pytest.mark.parametrize(
    ("read", "change", "message"),
    [
        (read_board, {"inner_columns": 2}, "inner_columns"),
        (read_board, {"inner_columns": 10**6}, "inner_columns"),
        (read_board, {"square_m": 60.0}, "square_m"),
        (read_board, {"squares": 3}, "squares"),
        (read_board, {"square_m": "0.06"}, "square_m"),
        (read_line, {"panels": []}, "panels"),
        (read_line, {"panels": [{"id": "L01", "size_m": 1.0}] * 2}, "a name stands twice"),
        (read_line, {"eccentricity_m": [1.0, 2.0]}, "eccentricity_m"),
        (read_line, {"eccentricity_std_m": -1.0}, "eccentricity_std_m"),
    ],
)
def test_bad_sheets(tmp_path: Path, read: Callable[[Path], object], change: dict, message: str) -> None:
    """Rationale: millimetres for metres, a key too many, a string for a number. Expected: one line that names the key."""
    sheet = (
        BoardSheet(inner_columns=17, inner_rows=12, square_m=0.06).model_dump(mode="json")
        if read is read_board
        else LINE.model_dump(mode="json")
    )
    path = tmp_path / "sheet.json"
    write_json(path, sheet | change)
    with pytest.raises(CampaignError) as caught:
        read(path)
    assert message in one_line(caught, "sheet.json")


@pytest.mark.parametrize("serves", [["truth"], []])
def test_station_without_a_use(tmp_path: Path, serves: list[str]) -> None:
    """Rationale: a station serves the correction, the reference, or both. Expected: anything else is refused, by its name."""
    sheet = LINE.model_dump(mode="json")
    sheet["stations"][1]["serves"] = serves
    write_json(tmp_path / "line.json", sheet)
    with pytest.raises(CampaignError, match=r"stations B serves"):
        read_line(tmp_path / "line.json")


def test_hostile_json(tmp_path: Path) -> None:
    """Rationale: NaN is not JSON, and a deep nest is an attack. Expected: one line each."""
    path = tmp_path / "room.json"
    for text in ('{"temperature_c": NaN}', "[" * 100_000, '{"temperature_c": 1e999}', "{", "\xff"):
        path.write_bytes(text.encode("latin-1"))
        with pytest.raises(CampaignError) as caught:
            read_room(path)
        one_line(caught, "room.json")


def test_scans_by_number(tmp_path: Path) -> None:
    """Rationale: scans are ordered by their number, not by their names. Expected: 2, 5 (in capitals, as
    Windows programs write it), 10, 100; other names are no scans."""
    folder = CampaignFolder(tmp_path)
    assert scan_paths(folder) == {}
    for name in ("scan_10.laz", "scan_02.las", "scan_100.laz", "scan_3.laz", "scan_04.txt", "SCAN_05.LAZ"):
        path = folder.ranging / "scans" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    assert [(n, p.name) for n, p in scan_paths(folder).items()] == [
        (2, "scan_02.las"),
        (5, "SCAN_05.LAZ"),
        (10, "scan_10.laz"),
        (100, "scan_100.laz"),
    ]


def write_json(path: Path, content: object) -> None:
    path.write_text(json.dumps(content))


def png(width: int, height: int, bits: int = 8, colour: int = 2, data: bytes = b"") -> bytes:
    """A PNG whose header states any size."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")


def jpeg_header(width: int, height: int) -> bytes:
    """A JPEG of a frame header and nothing else."""
    return b"\xff\xd8\xff\xc0" + struct.pack(">HBHHB", 11, 8, height, width, 1) + b"\x01\x11\x00\xff\xd9"


@pytest.mark.parametrize("bands", [1, 3])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_pictures_come_back(tmp_path: Path, suffix: str, dtype: type, bands: int) -> None:
    """Rationale: lossless pictures of any maker. Expected: each pixel as written, bands in the file's order (RGB); the header says
    the same size. Tolerance: none."""
    rng = np.random.default_rng(1)
    picture = rng.integers(0, np.iinfo(dtype).max, (21, 33, bands)).astype(dtype)
    path = tmp_path / f"p{suffix}"
    if suffix == ".tif":
        tifffile.imwrite(path, picture if bands == 3 else picture[..., 0], photometric="rgb" if bands == 3 else None)
    else:
        cv2.imwrite(str(path), picture[..., ::-1] if bands == 3 else picture)
    found, size = read_picture(path), picture_size(path)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, picture)
    assert (size.width_px, size.height_px, size.bands, size.bits) == (33, 21, bands, 8 * np.dtype(dtype).itemsize)


def test_alpha_and_jpeg(tmp_path: Path) -> None:
    """Rationale: an alpha band is no measurement; JPEG has grey and colour. Expected: RGBA gives RGB as written; a uniform grey
    JPEG comes back within 1 DN in one band, a red one in three with red first. Tolerance: JPEG's rounding."""
    rgba = np.zeros((8, 9, 4), np.uint8)
    rgba[..., 0], rgba[..., 3] = 200, 7
    cv2.imwrite(str(tmp_path / "a.png"), cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA))
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png"), rgba[..., :3])
    cv2.imwrite(str(tmp_path / "g.jpg"), np.full((16, 16), 90, np.uint8))
    assert np.abs(read_picture(tmp_path / "g.jpg").astype(int) - 90).max() <= 1
    cv2.imwrite(str(tmp_path / "r.jpg"), np.full((16, 16, 3), (10, 20, 220), np.uint8))
    found = read_picture(tmp_path / "r.jpg")
    assert found.shape == (16, 16, 3)
    assert np.abs(found.astype(int) - (220, 20, 10)).max() <= 4


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("million.png", png(10**6, 10**6)),
        ("side.png", png(MAX_SIDE_PX + 1, 1)),
        ("area.png", png(60_000, 60_000, bits=16)),
        ("zero.png", png(0, 10)),
        ("huge.jpg", jpeg_header(65_535, 65_535)),
        ("zero.jpg", jpeg_header(0, 10)),
        ("cut.png", png(10, 10)[:20]),
        ("colour.png", png(10, 10, colour=5)),
        ("cut.jpg", b"\xff\xd8\xff\xc0\x00"),
        ("endless.jpg", b"\xff\xd8" + b"\xff\xe1\x00\x02" * 1000),
        ("cut.tif", b"II*\0\x08\0"),
        ("loop.tif", b"II*\0" + struct.pack("<I", 4) + b"\0" * 20),
        ("big.tif", b"II+\0"),
        ("text.tif", b"hello, this is no picture at all, whatever the name says"),
        ("empty.png", b""),
    ],
)
def test_hostile_pictures(tmp_path: Path, name: str, content: bytes) -> None:
    """Rationale: a header may state 10^6 x 10^6 px, or end in its middle. Expected: one line from the header alone, before memory
    is taken (a picture of 10^12 px would need terabytes), both from the size and from reading."""
    path = tmp_path / name
    path.write_bytes(content)
    for read in (picture_size, read_picture):
        with pytest.raises(CampaignError) as caught:
            read(path)  # type: ignore[operator]
        one_line(caught, name)


@pytest.mark.parametrize(
    ("options", "got"),
    [
        ({"photometric": "rgb", "subfiletype": 1}, "a preview"),
        ({"photometric": 32803}, "a mosaic (CFA)"),
        ({"photometric": "palette", "colormap": np.zeros((3, 256), np.uint16)}, "a palette"),
        ({"photometric": "miniswhite"}, "grey with white zero"),
        ({"photometric": 34892}, "LinearRaw"),
        ({"photometric": 8}, "photometric interpretation 8"),
    ],
)
def test_tiffs_that_are_no_linear_picture(tmp_path: Path, options: dict, got: str) -> None:
    """Rationale: a DNG's first page is its preview; mosaics, palettes and inverted grey come out of tifffile as plain numbers, and
    8.2 would be measured on them. Expected: one line with what it is and the remedy, from the size and from reading."""
    path = tmp_path / "p.tif"
    colour = options["photometric"] in ("rgb", 8, 34892)
    tifffile.imwrite(path, np.full((8, 9, 3) if colour else (8, 9), 7, np.uint8), **options)
    for read in (picture_size, read_picture):
        with pytest.raises(CampaignError) as caught:
            read(path)  # type: ignore[operator]
        assert f"got {got};" in one_line(caught, "p.tif") and "export linear TIFF" in str(caught.value)


def test_bands_of_a_jpeg(tmp_path: Path) -> None:
    """Rationale: three bands in the header of a grey JPEG gave three equal channels. Expected: one band; header and pixels
    have the same number of bands agree for grey, colour, and grey PNG with alpha."""
    cv2.imwrite(str(tmp_path / "grey.jpg"), np.full((16, 24), 90, np.uint8))
    cv2.imwrite(str(tmp_path / "colour.jpg"), np.full((16, 24, 3), 90, np.uint8))
    (tmp_path / "alpha.png").write_bytes(png(24, 16, colour=4, data=(b"\0" + b"\x5a\xff" * 24) * 16))
    for name, bands in (("grey.jpg", 1), ("colour.jpg", 3), ("alpha.png", 1)):
        assert picture_size(tmp_path / name).bands == bands
        assert read_picture(tmp_path / name).shape == (16, 24, bands)
        assert np.abs(read_picture(tmp_path / name).astype(int) - 90).max() <= 1


def test_every_wrong_key_of_a_sheet(tmp_path: Path) -> None:
    """Rationale: whoever corrects a file wants all its faults in one run. Expected: a line with its key for each of four faults;
    the text names the first and counts the others."""
    write_json(tmp_path / "board.json", {"inner_columns": 2, "inner_rows": "7", "squares_m": 0.03})
    with pytest.raises(CampaignError) as caught:
        read_board(tmp_path / "board.json")
    keys = [line.partition("board.json ")[2].partition(":")[0] for line in caught.value.problems]
    assert sorted(keys) == ["inner_columns", "inner_rows", "square_m", "squares_m"]
    assert "and 3 more problems in this file" in one_line(caught, "board.json inner_columns")


@pytest.mark.parametrize("name", ["IMG 1.tif", "\u56fe.tif", "a/b.tif", "..", ".a.tif", "a..tif"])
def test_which_file_names_are_legal(tmp_path: Path, name: str) -> None:
    """Rationale: "wrong value" for "IMG 1.tif" does not tell what is wrong. Expected: the line states the legal characters."""
    (tmp_path / "log.csv").write_text(f"image\n{name}\n", encoding="utf-8")
    with pytest.raises(CampaignError) as caught:
        read_board_log(tmp_path / "log.csv")
    assert "letters A-Z a-z, digits, _ - and . only" in one_line(caught, "log.csv row 2 column image")


def test_million_by_million_tiff(tmp_path: Path) -> None:
    """Rationale: the same for a TIFF whose tags lie. Expected: one line; nothing is allocated."""
    path = tmp_path / "million.tif"
    tifffile.imwrite(path, np.zeros((8, 8), np.uint16))
    raw = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as tiff:
        tags = tiff.pages[0].tags  # type: ignore[union-attr]
        for code in (256, 257):
            tag = tags[code]
            form = "<I" if tag.dtype == 4 else "<H"
            struct.pack_into(form, raw, tag.valueoffset, 10**6 if form == "<I" else 65_535)
    path.write_bytes(raw)
    for read in (picture_size, read_picture):
        with pytest.raises(CampaignError) as caught:
            read(path)  # type: ignore[operator]
        one_line(caught, "million.tif")


def test_pixels_that_are_cut_off(tmp_path: Path) -> None:
    """Rationale: a card that was pulled too early leaves a sound header. Expected: PNG and TIFF are refused; no traceback, no
    zeros in the place of pixels."""
    rng = np.random.default_rng(2)
    picture = rng.integers(0, 65_535, (64, 64, 3)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "p.png"), picture)
    tifffile.imwrite(tmp_path / "p.tif", picture, photometric="rgb")
    for name in ("p.png", "p.tif"):
        path = tmp_path / name
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        with pytest.raises(CampaignError) as caught:
            read_picture(path)
        one_line(caught, name)
