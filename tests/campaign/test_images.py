"""Images: exact pixels through three readers, EXIF, GPS and XMP through independent ones, hostile files."""

import dataclasses
import struct
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType

import cv2
import exifread
import numpy as np
import pytest
import tifffile
from exifread.utils import get_gps_coords

from campaign.errors import CampaignError
from campaign.flight.images import check_image, read_image, read_preview, read_tags, write_image, write_preview

SIZE = {"width_px": 96, "height_px": 64, "bands": 3}


def pixels(bands: int = 3, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 65_536, (64, 96, bands)).astype(np.uint16)


@pytest.mark.parametrize("bands", [1, 2, 3])
def test_pixels_survive_in_every_reader(tmp_path: Path, bands: int, hand: ModuleType) -> None:
    """Expected: the same numbers from our reader, tifffile and OpenCV (which takes one or three bands, in the order BGR)."""
    dn, path = pixels(bands), tmp_path / "a.tif"
    tags = dataclasses.replace(hand.make_tags(), bands=("red", "green", "blue")[:bands])
    write_image(path, dn, tags)
    assert np.array_equal(read_image(path, **(SIZE | {"bands": bands})), dn)
    assert np.array_equal(tifffile.imread(path), dn if bands > 1 else dn[:, :, 0])
    if bands != 2:
        seen = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(seen[:, :, ::-1] if bands == 3 else seen[:, :, None], dn)
    first = path.read_bytes()
    write_image(path, dn, tags)
    assert path.read_bytes() == first
    assert [p.name for p in tmp_path.iterdir()] == ["a.tif"]


def test_exif_and_gps_through_an_independent_reader(tmp_path: Path, hand: ModuleType) -> None:
    """Rationale: photogrammetry reads scale, time and place from these. Expected: exifread's values, TIFF and JPEG alike.

    Tolerance: arc seconds are written to 1e-5, and half of that is 1.4e-9 degrees.
    """
    tags = hand.make_tags()
    write_image(tmp_path / "a.tif", pixels(), tags)
    write_preview(tmp_path / "a.jpg", np.zeros((64, 96, 3), np.uint8), tags)
    for name in ("a.tif", "a.jpg"):
        with (tmp_path / name).open("rb") as file:
            seen = exifread.process_file(file)
        assert str(seen["Image Make"]) == "Maker"
        assert str(seen["Image Model"]) == "Hand 6"
        assert float(seen["EXIF ExposureTime"].values[0]) == 1 / 2000
        assert float(seen["EXIF FNumber"].values[0]) == 5.6
        assert float(seen["EXIF FocalLength"].values[0]) == 13.5
        assert str(seen["EXIF DateTimeOriginal"]) == "2026:06:09 08:26:23"
        assert str(seen["EXIF OffsetTimeOriginal"]) == "+08:00"
        assert str(seen["EXIF SubSecTimeOriginal"]) == "250000"
        # pixels a centimetre: 1 cm / 4.5 micrometres
        assert float(seen["EXIF FocalPlaneXResolution"].values[0]) == pytest.approx(10_000 / 4.5, rel=1e-12)
        assert seen["EXIF FocalPlaneResolutionUnit"].values == [3]
        assert (seen["EXIF ExifImageWidth"].values, seen["EXIF ExifImageLength"].values) == ([96], [64])
        latitude, longitude = get_gps_coords(seen)
        assert latitude == pytest.approx(31.283012345, abs=1.5e-9)
        assert longitude == pytest.approx(121.213098765, abs=1.5e-9)
        assert float(seen["GPS GPSAltitude"].values[0]) == pytest.approx(63.1234, abs=1e-9)
        assert [float(v) for v in seen["GPS GPSTimeStamp"].values] == [0.0, 26.0, 23.25]
        assert "EXIF FocalLengthIn35mmFilm" not in seen
    with (tmp_path / "a.tif").open("rb") as file:
        black = exifread.process_file(file)["Image BlackLevel"].values
    assert [float(v) for v in black] == [256.0] * 3


def test_xmp_is_attributes_that_an_xml_parser_reads(tmp_path: Path, hand: ModuleType) -> None:
    """Expected: tag 700 parses as XML; DJI's gimbal pitch is -90 looking down, Pix4D's 0; heading 271.25 is yaw -88.75."""
    write_image(tmp_path / "a.tif", pixels(), hand.make_tags())
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        packet = tiff.pages[0].tags[700].value
    description = next(e for e in ET.fromstring(packet).iter() if e.tag.endswith("Description"))
    dji, pix4d = "{http://www.dji.com/drone-dji/1.0/}", "{http://pix4d.com/camera/1.0/}"
    assert float(description.attrib[f"{dji}GimbalYawDegree"]) == -88.75
    assert float(description.attrib[f"{dji}GimbalPitchDegree"]) == -91.5
    assert float(description.attrib[f"{pix4d}Yaw"]) == -88.75
    assert float(description.attrib[f"{pix4d}Pitch"]) == -1.5
    assert float(description.attrib[f"{pix4d}Roll"]) == 0.5


def test_our_tag_reader_and_others_files(tmp_path: Path, hand: ModuleType) -> None:
    write_image(tmp_path / "a.tif", pixels(), hand.make_tags())
    write_preview(tmp_path / "a.jpg", np.zeros((64, 96, 3), np.uint8), hand.make_tags())
    ours, jpeg = read_tags(tmp_path / "a.tif"), read_tags(tmp_path / "a.jpg")
    assert ours["ExposureTime"] == 1 / 2000
    assert ours["BlackLevel"] == (256.0,) * 3
    assert ours["WhiteLevel"] == (16383.0,) * 3
    assert ours["drone-dji:GimbalYawDegree"] == -88.75
    assert ours["GPSLatitude"] == pytest.approx(31.283012345, abs=1.5e-9)
    assert {k: v for k, v in ours.items() if not k.endswith("Level")} == jpeg
    tifffile.imwrite(tmp_path / "plain.tif", pixels(), photometric="rgb")
    assert "ExposureTime" not in read_tags(tmp_path / "plain.tif")
    cv2.imwrite(str(tmp_path / "plain.jpg"), np.zeros((8, 8, 3), np.uint8))
    assert read_tags(tmp_path / "plain.jpg") == {}
    south = dataclasses.replace(hand.make_tags(), latitude_deg=-33.5, longitude_deg=-70.25, ellipsoid_height_m=-12.5)
    write_image(tmp_path / "s.tif", pixels(), south)
    seen = read_tags(tmp_path / "s.tif")
    assert (seen["GPSLatitude"], seen["GPSLongitude"], seen["GPSAltitude"]) == (-33.5, -70.25, -12.5)


@pytest.mark.parametrize(
    "options",
    [
        {"photometric": "rgb", "compression": "zlib"},
        {"photometric": "rgb", "compression": "lzw", "predictor": True},
        {"photometric": "rgb", "tile": (32, 32)},
        {"photometric": "rgb", "byteorder": ">"},
        {"photometric": "rgb", "bigtiff": True},
    ],
)
def test_other_layouts_of_16_bit_tiff_are_read(tmp_path: Path, options: dict) -> None:
    tifffile.imwrite(tmp_path / "b.tif", pixels(), **options)
    assert np.array_equal(read_image(tmp_path / "b.tif", **SIZE), pixels())


def test_separate_planes_are_read(tmp_path: Path) -> None:
    planes = np.ascontiguousarray(np.moveaxis(pixels(), -1, 0))
    tifffile.imwrite(tmp_path / "p.tif", planes, photometric="rgb", planarconfig="separate")
    assert np.array_equal(read_image(tmp_path / "p.tif", **SIZE), pixels())


def test_preview_round_trip_and_order_of_colours(tmp_path: Path, hand: ModuleType) -> None:
    """A red picture stays red. Tolerance: 3 levels, JPEG at quality 90 on a flat picture."""
    red = np.zeros((64, 96, 3), np.uint8)
    red[:, :, 0] = 200
    write_preview(tmp_path / "a.jpg", red, hand.make_tags())
    assert np.abs(read_preview(tmp_path / "a.jpg", width_px=96, height_px=64).astype(int) - red).max() <= 3
    with pytest.raises(CampaignError, match="preview of another size; got 96 x 64 px; expected 90 x 64 px"):
        read_preview(tmp_path / "a.jpg", width_px=90, height_px=64)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"width_px": 90},
            "image of another size than the camera's sheet states; got 96 x 64 px, 3 bands; expected 90 x 64",
        ),
        ({"bands": 1}, "image of another size"),
        ({"width_px": 20_000, "height_px": 20_000, "bands": 4}, "too large an image"),
    ],
)
def test_an_image_of_another_size(tmp_path: Path, change: dict, message: str, hand: ModuleType) -> None:
    write_image(tmp_path / "a.tif", pixels(), hand.make_tags())
    with pytest.raises(CampaignError, match=message):
        read_image(tmp_path / "a.tif", **(SIZE | change))


def test_eight_bits_are_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", pixels().astype(np.uint8), photometric="rgb")
    with pytest.raises(CampaignError, match="image of another depth; got uint8; expected uint16"):
        read_image(tmp_path / "a.tif", **SIZE)


def test_truncated_and_damaged_images(tmp_path: Path, hand: ModuleType) -> None:
    """Expected: a file cut at any place, and any of 300 damaged heads, gives one line or the picture's size; never a crash, and
    never zeros in the place of pixels that are not there."""
    path = tmp_path / "a.tif"
    write_image(path, pixels(), hand.make_tags())
    whole = path.read_bytes()
    for size in (0, 1, 8, 60, 300, 1000, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        for read in (read_image, check_image):
            with pytest.raises(CampaignError) as caught:
                read(path, **SIZE)
            assert "\n" not in str(caught.value)
    head = len(whole) - pixels().nbytes
    rng = np.random.default_rng(0)
    for _ in range(300):
        raw = bytearray(whole)
        for at in rng.integers(0, head, 3):
            raw[at] = rng.integers(0, 256)
        path.write_bytes(raw)
        for read_any in (lambda: read_image(path, **SIZE), lambda: read_tags(path)):
            try:
                read_any()
            except CampaignError as error:
                assert len(str(error).splitlines()) == 1


def test_a_declared_size_of_gigabytes_is_refused_unread(tmp_path: Path, hand: ModuleType) -> None:
    """Width and height of 2^31 in the tags, and a JPEG frame of 65 535 x 65 535: refused by the sheet's size before decoding."""
    write_image(tmp_path / "a.tif", pixels(), hand.make_tags())
    raw = bytearray((tmp_path / "a.tif").read_bytes())
    for i in range(struct.unpack_from("<H", raw, 8)[0]):
        if struct.unpack_from("<H", raw, 10 + 12 * i)[0] in (256, 257):
            struct.pack_into("<I", raw, 10 + 12 * i + 8, 2**31 - 1)
    (tmp_path / "a.tif").write_bytes(raw)
    with pytest.raises(CampaignError, match="image of another size"):
        read_image(tmp_path / "a.tif", **SIZE)
    write_preview(tmp_path / "a.jpg", np.zeros((64, 96, 3), np.uint8), hand.make_tags())
    jpeg = bytearray((tmp_path / "a.jpg").read_bytes())
    at = jpeg.index(b"\xff\xc0")
    struct.pack_into(">HH", jpeg, at + 5, 65_535, 65_535)
    (tmp_path / "a.jpg").write_bytes(jpeg)
    with pytest.raises(CampaignError, match="preview of another size; got 65535 x 65535 px"):
        read_preview(tmp_path / "a.jpg", width_px=96, height_px=64)


def test_no_image_at_all(tmp_path: Path) -> None:
    (tmp_path / "t.tif").write_text("no image")
    for path, message in ((tmp_path / "t.tif", "is no readable TIFF"), (tmp_path / "none.tif", "no such file")):
        with pytest.raises(CampaignError, match=message):
            read_image(path, **SIZE)
        with pytest.raises(CampaignError, match=message):
            read_tags(path)
    with pytest.raises(CampaignError, match="preview of another size; got no JPEG"):
        read_preview(tmp_path / "t.tif", width_px=96, height_px=64)
