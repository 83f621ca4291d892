"""Images for other tools: 8 bits with one gain for the whole campaign, JPEG with the EXIF that each tool needs, PNG without."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from campaign.errors import CampaignError
from campaign.flight.images import read_image
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
    SOFTWARE,
    UNDEFINED,
    Tag,
    directory,
    jpeg_segment,
    xmp_packet,
)
from campaign.sensors import CameraSheet
from campaign.writing.atomic import complete_file
from testrange.export.source import Shot, Source

JPEG_QUALITY = 95
_BRIGHTEST = 0.9  # of the linear scale, where the brightest thousandth of all pixels comes to lie
_SHARE = 0.999
_MAX_GAIN = 64.0


def read_shot(source: Source, shot: Shot) -> np.ndarray:
    """(height, width, bands) uint16, black level included."""
    camera = source.camera
    path = source.data.folder.held(shot.path)
    if not path.is_file():
        raise CampaignError("no such file", where=str(path))
    return read_image(path, width_px=camera.width_px, height_px=camera.height_px, bands=len(camera.bands))


def tone_curve(source: Source, shots: Sequence[Shot]) -> np.ndarray:
    """DN -> 8 bits for all images of a campaign: black level off, one gain, the transfer curve of sRGB.

    The gain brings the brightest thousandth of all pixels to 0.9 of full scale; it is at least 1, so that nothing that was
    exposed gets darker.

    Returns
    -------
    (65536,) np.ndarray of uint8

    References
    ----------
    IEC 61966-2-1:1999, 5.2.
    """
    counts = np.zeros(65_536, np.int64)
    for shot in shots:
        counts += np.bincount(read_shot(source, shot)[::4, ::4].ravel(), minlength=65_536)
    camera = source.camera
    full = 2.0**camera.bit_depth - 1.0 - camera.black_level_dn
    bright = int(np.searchsorted(np.cumsum(counts), _SHARE * counts.sum()))
    gain = float(np.clip(_BRIGHTEST * full / max(bright - camera.black_level_dn, 1.0), 1.0, _MAX_GAIN))
    linear = np.clip((np.arange(65_536) - camera.black_level_dn) / full * gain, 0.0, 1.0)
    curved = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    return np.asarray(np.rint(255.0 * curved).astype(np.uint8))


def eight_bit(dn: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """(h, w, bands) DN -> (h, w, 3) or (h, w) uint8; of two bands the first."""
    return np.asarray(curve[dn] if dn.shape[2] == 3 else curve[dn[:, :, 0]])


def jpeg(picture: np.ndarray, segments: bytes = b"") -> bytes:
    """A JPEG file with the given segments first. Colour is not subsampled."""
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    options += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    data = _coded(".jpg", picture, options)
    return data[:2] + segments + data[2:]


def png(picture: np.ndarray) -> bytes:
    """A PNG file."""
    return _coded(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 3])


def _coded(suffix: str, picture: np.ndarray, options: list[int]) -> bytes:
    done, coded = cv2.imencode(suffix, picture[:, :, ::-1] if picture.ndim == 3 else picture, options)
    if not done:
        raise CampaignError("an image could not be coded", where=suffix)
    return coded.tobytes()


def write_bytes(path: Path, data: bytes) -> None:
    """A file, complete or not at all."""
    with complete_file(path) as work:
        work.write_bytes(data)


def lens_exif(camera: CameraSheet) -> bytes:
    """EXIF segment with nominal focal length and focal plane resolution, and nothing that tells where or when."""
    return _exif([Tag(ORIENTATION, SHORT, 1)], _lens_tags(camera), [])


def flight_exif(source: Source, shot: Shot, latitude_deg: float, longitude_deg: float, height_m: float) -> bytes:
    """EXIF and XMP segments with camera, Beijing time of the exposure, place (height above sea level) and attitude."""
    camera, exposure = source.camera, shot.exposure
    beijing = np.datetime_as_string(beijing_time(np.array([shot.gps_time_s]))[0], unit="us")
    date, _, fraction = beijing.partition(".")
    date = date.replace("-", ":").replace("T", " ")
    utc = str(beijing_time(np.array([shot.gps_time_s]))[0] - np.timedelta64(8, "h"))
    hour, minute, second = utc[11:].split(":")
    first = [
        Tag(MAKE, ASCII, camera.manufacturer or "unknown"),
        Tag(MODEL, ASCII, camera.name),
        Tag(ORIENTATION, SHORT, 1),
        Tag(SOFTWARE, ASCII, "testrange"),
        Tag(DATE_TIME, ASCII, date),
    ]
    exif = [
        *_lens_tags(camera),
        Tag(33434, RATIONAL, exposure.exposure_time_s),
        Tag(33437, RATIONAL, camera.f_number),
        Tag(36867, ASCII, date),
        Tag(36881, ASCII, "+08:00"),
        Tag(37521, ASCII, fraction),
    ]
    roll, pitch, heading = source.attitude_deg(shot)
    gps = [
        Tag(0, BYTE, bytes((2, 3, 0, 0))),
        Tag(1, ASCII, "N" if latitude_deg >= 0.0 else "S"),
        Tag(2, RATIONAL, _sexagesimal(latitude_deg)),
        Tag(3, ASCII, "E" if longitude_deg >= 0.0 else "W"),
        Tag(4, RATIONAL, _sexagesimal(longitude_deg)),
        Tag(5, BYTE, bytes((int(height_m < 0.0),))),
        Tag(6, RATIONAL, round(abs(height_m), 4)),
        Tag(7, RATIONAL, (int(hour), int(minute), float(second))),
        Tag(16, ASCII, "T"),
        Tag(17, RATIONAL, round(heading, 4)),
        Tag(18, ASCII, "CGCS2000"),
        Tag(29, ASCII, utc[:10].replace("-", ":")),
    ]
    yaw = (heading + 180.0) % 360.0 - 180.0
    xmp = {
        "drone-dji:AbsoluteAltitude": f"{height_m:+.4f}",
        "drone-dji:GimbalYawDegree": f"{yaw:+.4f}",
        "drone-dji:GimbalPitchDegree": f"{pitch - 90.0:+.4f}",
        "drone-dji:GimbalRollDegree": f"{roll:+.4f}",
        "Camera:Yaw": f"{yaw:.4f}",
        "Camera:Pitch": f"{pitch:.4f}",
        "Camera:Roll": f"{roll:.4f}",
    }
    return _exif(first, exif, gps) + jpeg_segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + xmp_packet(xmp))


def _lens_tags(camera: CameraSheet) -> list[Tag]:
    per_cm = 10_000.0 / camera.pixel_size_um
    return [
        Tag(36864, UNDEFINED, b"0232"),
        Tag(37386, RATIONAL, camera.nominal_focal_length_mm),
        Tag(40962, LONG, camera.width_px),
        Tag(40963, LONG, camera.height_px),
        Tag(41486, RATIONAL, per_cm),
        Tag(41487, RATIONAL, per_cm),
        Tag(41488, SHORT, 3),  # resolutions count for a centimetre
    ]


def _exif(first: list[Tag], exif: list[Tag], gps: list[Tag]) -> bytes:
    """APP1 segment of a TIFF structure; without GPS tags there is no GPS directory."""

    def start(exif_at: int, gps_at: int) -> bytes:
        links = [Tag(EXIF_IFD, LONG, exif_at)] + ([Tag(GPS_IFD, LONG, gps_at)] if gps else [])
        return directory(first + links, 8)

    exif_at = 8 + len(start(0, 0))
    gps_at = exif_at + len(directory(exif, exif_at))
    body = start(exif_at, gps_at) + directory(exif, exif_at) + (directory(gps, gps_at) if gps else b"")
    return jpeg_segment(0xE1, b"Exif\0\0II*\0" + (8).to_bytes(4, "little") + body)


def _sexagesimal(degrees: float) -> tuple[float, float, float]:
    """Degrees, minutes, seconds; seconds to 0.00001 (0.3 mm)."""
    hundred_thousandths = round(abs(degrees) * 3600.0 * 1e5)
    minutes, rest = divmod(hundred_thousandths, 6_000_000)
    return minutes // 60, minutes % 60, rest / 1e5
