"""Images: 16-bit TIFF (linear DN, black level included) with EXIF and XMP, and a JPEG preview (8-bit sRGB)."""

import contextlib
import io
import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile

from campaign.errors import CampaignError
from campaign.flight.trajectory import beijing_time
from campaign.formats.exif import (
    ASCII,
    BYTE,
    DATE_TIME,
    EXIF_IFD,
    GPS_IFD,
    LONG,
    MAKE,
    MODEL,
    ORIENTATION,
    RATIONAL,
    SHORT,
    STRIP_OFFSETS,
    UNDEFINED,
    XMP,
    Tag,
    jpeg_exif,
    jpeg_segment,
    jpeg_size,
    tiff_structure,
    xmp_packet,
)
from campaign.formats.exif import SOFTWARE as SOFTWARE_TAG
from campaign.writing.atomic import complete_file

BLACK_LEVEL, WHITE_LEVEL = 50714, 50717


@dataclass(frozen=True, kw_only=True)
class ImageTags:
    """What a camera writes into EXIF and XMP."""

    camera_name: str
    manufacturer: str
    gps_time_s: float  # adjusted standard GPS time; DateTimeOriginal is written in Beijing time with +08:00
    exposure_time_s: float
    f_number: float
    focal_length_mm: float
    pixel_size_um: float
    black_level_dn: float
    bit_depth: int
    latitude_deg: float
    longitude_deg: float
    ellipsoid_height_m: float
    roll_deg: float
    pitch_deg: float
    heading_deg: float
    bands: tuple[str, ...]


MAX_IMAGE_BYTES = 1_200_000_000  # of pixels: 200 megapixels in three bands
MAX_PREVIEW_BYTES = 500_000_000
MAX_XMP_BYTES = 1_000_000
PREVIEW_QUALITY = 90
SOFTWARE = "testrange"
logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # what it would print about a bad file is in our error's line
_XMP_ITEM = re.compile(
    r"""(?:<|\s)((?:drone-dji|Camera):\w{1,64})\s*(?:=\s*["']([^"'<>]{0,200})["']|>([^<>]{0,200})<)"""
)


def write_image(path: Path, dn: np.ndarray, tags: ImageTags) -> None:
    """`dn` (height, width, bands) uint16 -> TIFF without compression, one strip. Same input, same bytes."""
    if dn.dtype != np.uint16 or dn.ndim != 3 or dn.shape[2] != len(tags.bands):
        raise ValueError(f"expected (height, width, {len(tags.bands)}) uint16")
    height, width, bands = dn.shape
    rgb = bands == 3
    structure = [
        Tag(254, LONG, 0),
        Tag(256, LONG, width),
        Tag(257, LONG, height),
        Tag(258, SHORT, (16,) * bands),
        Tag(259, SHORT, 1),  # no compression
        Tag(262, SHORT, 2 if rgb else 1),  # RGB, or black is zero
        Tag(277, SHORT, bands),
        Tag(278, LONG, height),
        Tag(279, LONG, dn.nbytes),
        Tag(284, SHORT, 1),  # bands interleaved
        Tag(339, SHORT, (1,) * bands),
        Tag(BLACK_LEVEL, RATIONAL, (tags.black_level_dn,) * bands),
        Tag(WHITE_LEVEL, LONG, (2**tags.bit_depth - 1,) * bands),
        Tag(XMP, BYTE, xmp_packet(_xmp(tags))),
        *([] if rgb or bands == 1 else [Tag(338, SHORT, (0,) * (bands - 1))]),
        *_common(tags),
    ]
    head = tiff_structure(structure, _exif(tags, width, height), _gps(tags), data_tag=STRIP_OFFSETS)
    with complete_file(path) as work, work.open("wb") as file:
        file.write(head)
        file.write(np.ascontiguousarray(dn, "<u2").data)


def write_preview(path: Path, srgb: np.ndarray, tags: ImageTags) -> None:
    """`srgb` (height, width, 3) uint8 -> JPEG with the same EXIF."""
    if srgb.dtype != np.uint8 or srgb.ndim != 3 or srgb.shape[2] != 3:
        raise ValueError("expected (height, width, 3) uint8")
    done, coded = cv2.imencode(".jpg", srgb[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, PREVIEW_QUALITY])
    if not done:
        raise CampaignError("the preview could not be coded", where=str(path))
    data = coded.tobytes()
    exif = tiff_structure(_common(tags), _exif(tags, srgb.shape[1], srgb.shape[0]), _gps(tags))
    segments = jpeg_segment(0xE1, b"Exif\0\0" + exif)
    segments += jpeg_segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + xmp_packet(_xmp(tags)))
    with complete_file(path) as work:
        work.write_bytes(data[:2] + segments + data[2:])


def read_image(path: Path, *, width_px: int, height_px: int, bands: int) -> np.ndarray:
    """(height, width, bands) uint16. The size in the file is checked against the sheet before pixels are decoded."""
    expected = f"{width_px} x {height_px} px, {bands} bands of uint16"
    _check_bytes(path, width_px * height_px * bands * 2)
    with open_tiff(path) as tiff:
        page = first_page(path, tiff)
        separate = bands > 1 and page.planarconfig == 2
        shape = (height_px, width_px) if bands == 1 else (height_px, width_px, bands)
        shape = (bands, height_px, width_px) if separate else shape
        if tuple(page.shape) != shape and not (bands == 1 and tuple(page.shape) == (height_px, width_px, 1)):
            got = f"{page.imagewidth} x {page.imagelength} px, {page.samplesperpixel} bands"
            raise CampaignError(
                "image of another size than the camera's sheet states", where=str(path), got=got, expected=expected
            )
        if page.dtype != np.uint16:
            raise CampaignError("image of another depth", where=str(path), got=page.dtype, expected="uint16")
        check_strips(path, page)
        dn = page.asarray()
    if separate:
        dn = np.moveaxis(dn, 0, -1)
    return np.ascontiguousarray(dn.reshape(height_px, width_px, bands))


def check_image(path: Path, *, width_px: int, height_px: int, bands: int) -> None:
    """What `read_image` checks, without decoding."""
    _check_bytes(path, width_px * height_px * bands * 2)
    with open_tiff(path) as tiff:
        page = first_page(path, tiff)
        if (page.imagewidth, page.imagelength, page.samplesperpixel) != (width_px, height_px, bands):
            raise CampaignError(
                "image of another size than the camera's sheet states",
                where=str(path),
                got=f"{page.imagewidth} x {page.imagelength} px, {page.samplesperpixel} bands",
                expected=f"{width_px} x {height_px} px, {bands} bands",
            )
        if page.dtype != np.uint16:
            raise CampaignError("image of another depth", where=str(path), got=page.dtype, expected="uint16")
        check_strips(path, page)


def _check_bytes(path: Path, size: int) -> None:
    if size > MAX_IMAGE_BYTES:
        raise CampaignError(
            "too large an image", where=str(path), got=f"{size} bytes of pixels", expected=f"at most {MAX_IMAGE_BYTES}"
        )


def read_preview(path: Path, *, width_px: int, height_px: int) -> np.ndarray:
    """(height, width, 3) uint8."""
    data = _bytes(path)
    size = jpeg_size(data) if data[:2] == b"\xff\xd8" else None
    if size != (width_px, height_px):
        got = "no JPEG" if size is None else f"{size[0]} x {size[1]} px"
        raise CampaignError(
            "preview of another size", where=str(path), got=got, expected=f"{width_px} x {height_px} px"
        )
    try:
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        bgr = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        bgr = None
    if bgr is None or bgr.shape != (height_px, width_px, 3):
        raise CampaignError("preview cannot be decoded", where=str(path))
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB, dst=bgr))  # in place: of 45 megapixels a copy takes 134 MB


def read_tags(path: Path) -> dict[str, object]:
    """EXIF and XMP of a TIFF or JPEG written here or by others; missing tags are absent from the dict.

    Keys are EXIF's own names (Make, Model, DateTimeOriginal, OffsetTimeOriginal, ExposureTime [s], FNumber, FocalLength [mm],
    FocalPlaneXResolution ...), BlackLevel and WhiteLevel (tuples), GPSLatitude and GPSLongitude (signed degrees), GPSAltitude
    [m], and XMP attributes with their prefix (`drone-dji:GimbalYawDegree`, `Camera:Yaw`), as numbers where they are numbers.
    """
    xmp: bytes | None
    with path.open("rb") if path.exists() else contextlib.nullcontext() as file:
        jpeg = file is not None and file.read(2) == b"\xff\xd8"
    if jpeg:
        exif, xmp = jpeg_exif(_bytes(path))
        if exif is None:
            return _xmp_values(xmp)
        source: Path | io.BytesIO = io.BytesIO(exif)
    else:
        source, xmp = path, None
    out: dict[str, object] = {}
    with open_tiff(path, source) as tiff:
        tags = first_page(path, tiff).tags
        sub = {code: tags[code].value for code in (EXIF_IFD, GPS_IFD) if code in tags}
        for name, code in (("Make", MAKE), ("Model", MODEL), ("BlackLevel", BLACK_LEVEL), ("WhiteLevel", WHITE_LEVEL)):
            if code in tags:
                value = tags[code].value
                out[name] = value if isinstance(value, str) else _levels(code, value)
        raw = tags[XMP].value if XMP in tags else b""
        xmp = xmp or (raw if isinstance(raw, bytes) else str(raw).encode())
    exif_values = sub.get(EXIF_IFD)
    if isinstance(exif_values, dict):
        out.update({k: _number(v) for k, v in exif_values.items() if isinstance(v, int | float | str | tuple)})
    gps = sub.get(GPS_IFD)
    if isinstance(gps, dict):
        out.update(_gps_values(gps))
    return out | _xmp_values(xmp)


def _common(tags: ImageTags) -> list[Tag]:
    return [
        Tag(MAKE, ASCII, tags.manufacturer),
        Tag(MODEL, ASCII, tags.camera_name),
        Tag(ORIENTATION, SHORT, 1),
        Tag(SOFTWARE_TAG, ASCII, SOFTWARE),
        Tag(DATE_TIME, ASCII, _beijing(tags)[0]),
    ]


def _beijing(tags: ImageTags) -> tuple[str, str]:
    """Date and time as EXIF writes it, and the digits of its microseconds."""
    date, _, fraction = np.datetime_as_string(beijing_time(np.array([tags.gps_time_s]))[0], unit="us").partition(".")
    return date.replace("-", ":").replace("T", " "), fraction


def _exif(tags: ImageTags, width: int, height: int) -> list[Tag]:
    date, fraction = _beijing(tags)
    per_cm = 10_000.0 / tags.pixel_size_um
    return [
        Tag(33434, RATIONAL, tags.exposure_time_s),
        Tag(33437, RATIONAL, tags.f_number),
        Tag(36864, UNDEFINED, b"0232"),
        Tag(36867, ASCII, date),
        Tag(36881, ASCII, "+08:00"),
        Tag(37386, RATIONAL, tags.focal_length_mm),
        Tag(37521, ASCII, fraction),
        Tag(40962, LONG, width),
        Tag(40963, LONG, height),
        Tag(41486, RATIONAL, per_cm),
        Tag(41487, RATIONAL, per_cm),
        Tag(41488, SHORT, 3),  # resolutions count for a centimetre
    ]


def _gps(tags: ImageTags) -> list[Tag]:
    utc = str((beijing_time(np.array([tags.gps_time_s])) - np.timedelta64(8, "h"))[0])
    hour, minute, second = utc[11:].split(":")
    return [
        Tag(0, BYTE, bytes((2, 3, 0, 0))),
        Tag(1, ASCII, "N" if tags.latitude_deg >= 0.0 else "S"),
        Tag(2, RATIONAL, _sexagesimal(tags.latitude_deg)),
        Tag(3, ASCII, "E" if tags.longitude_deg >= 0.0 else "W"),
        Tag(4, RATIONAL, _sexagesimal(tags.longitude_deg)),
        Tag(5, BYTE, bytes((int(tags.ellipsoid_height_m < 0.0),))),
        Tag(6, RATIONAL, abs(tags.ellipsoid_height_m)),
        Tag(7, RATIONAL, (int(hour), int(minute), float(second))),
        Tag(16, ASCII, "T"),
        Tag(17, RATIONAL, tags.heading_deg % 360.0),
        Tag(18, ASCII, "CGCS2000"),
        Tag(29, ASCII, utc[:10].replace("-", ":")),
    ]


def _sexagesimal(degrees: float) -> tuple[float, float, float]:
    """Degrees, minutes, seconds; seconds to 0.00001 (0.3 mm)."""
    hundred_thousandths = round(abs(degrees) * 3600.0 * 1e5)
    minutes, rest = divmod(hundred_thousandths, 6_000_000)
    return minutes // 60, minutes % 60, rest / 1e5


def _xmp(tags: ImageTags) -> dict[str, str]:
    """Attitude in the two dialects that photogrammetry reads: DJI's gimbal (pitch -90 looks down), Pix4D's camera (0 does)."""
    yaw, pitch, roll = (tags.heading_deg + 180.0) % 360.0 - 180.0, tags.pitch_deg, tags.roll_deg
    return {
        "drone-dji:AbsoluteAltitude": f"{tags.ellipsoid_height_m:+.4f}",
        "drone-dji:GimbalYawDegree": f"{yaw:+.4f}",
        "drone-dji:GimbalPitchDegree": f"{pitch - 90.0:+.4f}",
        "drone-dji:GimbalRollDegree": f"{roll:+.4f}",
        "drone-dji:FlightYawDegree": f"{yaw:+.4f}",
        "drone-dji:FlightPitchDegree": f"{pitch:+.4f}",
        "drone-dji:FlightRollDegree": f"{roll:+.4f}",
        "Camera:Yaw": f"{yaw:.4f}",
        "Camera:Pitch": f"{pitch:.4f}",
        "Camera:Roll": f"{roll:.4f}",
    }


def _bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_PREVIEW_BYTES:
            raise CampaignError("too large", where=str(path), expected=f"at most {MAX_PREVIEW_BYTES} bytes")
        return path.read_bytes()
    except FileNotFoundError:
        raise CampaignError("no such file", where=str(path)) from None
    except OSError as error:
        raise CampaignError("cannot be read", where=str(path), got=error.strerror) from None


@contextlib.contextmanager
def open_tiff(path: Path, source: Path | io.BytesIO | None = None) -> Iterator[tifffile.TiffFile]:
    """tifffile, whose many kinds of error become one line."""
    try:
        with tifffile.TiffFile(path if source is None else source) as tiff:
            yield tiff
    except CampaignError:
        raise
    except FileNotFoundError:
        raise CampaignError("no such file", where=str(path)) from None
    except Exception as error:
        lines = str(error).splitlines() or [type(error).__name__]
        raise CampaignError("is no readable TIFF", where=str(path), got=lines[0][:100]) from None


def first_page(path: Path, tiff: tifffile.TiffFile) -> tifffile.TiffPage:
    page = tiff.pages[0]
    if not isinstance(page, tifffile.TiffPage):
        raise CampaignError("is no readable TIFF", where=str(path), got="no first page")
    return page


def check_strips(path: Path, page: tifffile.TiffPage) -> None:
    """Every strip lies in the file; tifffile itself would fill a missing one with zeros."""
    size = path.stat().st_size
    ends = [o + c for o, c in zip(page.dataoffsets, page.databytecounts, strict=False)]
    if not ends or min(page.databytecounts) <= 0 or min(page.dataoffsets) <= 0 or max(ends) > size:
        raise CampaignError(
            "is truncated", where=str(path), got=f"{size} bytes", expected=f"{max(ends, default=0)} bytes"
        )
    if page.compression == 1 and sum(page.databytecounts) < page.nbytes:
        raise CampaignError("is truncated", where=str(path), got=f"{sum(page.databytecounts)} bytes of pixels")


def _levels(code: int, value: Any) -> tuple[float, ...]:
    numbers = [float(v) for v in (value if isinstance(value, tuple) else (value,))]
    if code == BLACK_LEVEL and len(numbers) > 1 and len(numbers) % 2 == 0 and isinstance(value, tuple):
        numbers = [a / b if b else a for a, b in zip(numbers[::2], numbers[1::2])]
    return tuple(numbers)


def _number(value: Any) -> object:
    """A rational as a number; text and whole numbers as they are."""
    if isinstance(value, tuple) and len(value) == 2 and all(isinstance(v, int) for v in value):
        return value[0] / value[1] if value[1] else float("nan")
    return value


def _gps_values(gps: dict[str, Any]) -> dict[str, object]:
    out: dict[str, object] = {}
    for name, negative in (("Latitude", "S"), ("Longitude", "W")):
        parts = gps.get(f"GPS{name}")
        if isinstance(parts, tuple) and len(parts) == 6 and all(parts[1::2]):
            degrees = sum(n / d / 60.0**i for i, (n, d) in enumerate(zip(parts[::2], parts[1::2])))
            out[f"GPS{name}"] = -degrees if gps.get(f"GPS{name}Ref") == negative else degrees
    height = gps.get("GPSAltitude")
    if height is not None:
        value = _number(height)
        if isinstance(value, int | float):
            out["GPSAltitude"] = -value if gps.get("GPSAltitudeRef") in (1, b"\x01") else value
    return out


def _xmp_values(xmp: bytes | None) -> dict[str, object]:
    """Attributes, or elements with text, of the two dialects; a regular expression because XML from outside can be a bomb."""
    out: dict[str, object] = {}
    for name, attribute, text in _XMP_ITEM.findall((xmp or b"")[:MAX_XMP_BYTES].decode("utf-8", "replace")):
        value = attribute or text
        try:
            out[name] = float(value)
        except ValueError:
            out[name] = value
    return out
