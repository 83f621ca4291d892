"""Pictures of any size and of any maker for the benches: TIFF, PNG, JPEG, 8 or 16 bit, 1 to 3 bands. Reading only.

Images of a flight, whose size the camera's sheet fixes, are `campaign.flight.images`'.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tifffile

from campaign.errors import CampaignError
from campaign.flight.images import MAX_IMAGE_BYTES, check_strips, first_page, open_tiff
from campaign.formats.exif import jpeg_frame

MAX_FILE_BYTES = 1_300_000_000
MAX_SIDE_PX = 65_000
_PNG = b"\x89PNG\r\n\x1a\n"
_YCBCR = 6
_COLOURS = (1, 2, _YCBCR)  # TIFF 6.0 photometric interpretation: grey with black zero, YCbCr, RGB
_COLOUR_NAMES = {
    0: "grey with white zero",
    3: "a palette",
    _YCBCR: "YCbCr pixels",
    32803: "a mosaic (CFA)",
    34892: "LinearRaw",
}
_JPEG = (6, 7)  # TIFF compression
_PNG_BANDS = {0: 1, 2: 3, 3: 3, 4: 1, 6: 3}  # colour type -> bands without alpha; a palette becomes RGB


@dataclass(frozen=True, kw_only=True)
class PictureSize:
    """What the header says."""

    width_px: int
    height_px: int
    bands: int
    bits: int  # 8 or 16

    def __str__(self) -> str:
        return f"{self.width_px} x {self.height_px} px, {self.bands} bands of {self.bits} bit"


def picture_size(path: Path) -> PictureSize:
    """Size of a picture without decoding it.

    Raises
    ------
    CampaignError
        No file, neither TIFF nor PNG nor JPEG, a size or depth that is not read here, truncated TIFF.
    """
    head = _head(path)
    if head[:8] == _PNG:
        if len(head) < 26 or head[12:16] != b"IHDR" or head[25] not in _PNG_BANDS:
            raise CampaignError("is no readable PNG", where=str(path))
        width, height = struct.unpack(">II", head[16:24])
        return _bounded(path, width, height, _PNG_BANDS[head[25]], 16 if head[24] == 16 else 8)
    if head[:2] == b"\xff\xd8":
        frame = jpeg_frame(_whole(path))
        if frame is None:
            raise CampaignError("is no readable JPEG", where=str(path))
        return _bounded(path, *frame, 8)
    if head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        with open_tiff(path) as tiff:
            return _tiff_size(path, first_page(path, tiff))
    raise CampaignError("is no picture that is read here", where=str(path), expected="TIFF, PNG or JPEG")


def read_picture(path: Path) -> np.ndarray:
    """(height, width, bands) uint8 or uint16, bands in the file's order (RGB); an alpha band is dropped.

    The size is checked before pixels are decoded. Grey JPEGs have one band.
    """
    size = picture_size(path)
    shape = (size.height_px, size.width_px)
    if _head(path)[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        with open_tiff(path) as tiff:
            page = first_page(path, tiff)
            found = np.asarray(page.asarray())
            if size.bands > 1 and page.planarconfig == 2:
                found = np.moveaxis(found, 0, -1)
        return np.ascontiguousarray(found.reshape(*shape, size.bands))
    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        decoded = cv2.imdecode(np.frombuffer(_whole(path), np.uint8), flags)
    except cv2.error:
        decoded = None
    if decoded is None or decoded.shape[:2] != shape or decoded.dtype not in (np.uint8, np.uint16):
        raise CampaignError("cannot be decoded", where=str(path))
    found = np.asarray(decoded).reshape(*shape, -1)
    if size.bands == 1:
        found = found[..., :1]  # grey with alpha
    return np.ascontiguousarray(found[..., 2::-1] if found.shape[2] >= 3 else found)


def _tiff_size(path: Path, page: tifffile.TiffPage) -> PictureSize:
    """Refuses what tifffile would give as numbers that are no linear DN of whole pixels: previews, mosaics, palettes."""
    colour = int(page.photometric)
    coded = colour == _YCBCR and int(page.compression) not in _JPEG  # tifffile makes RGB of JPEG's alone
    if page.subfiletype & 1 or colour not in _COLOURS or coded:
        what = (
            "a preview" if page.subfiletype & 1 else _COLOUR_NAMES.get(colour, f"photometric interpretation {colour}")
        )
        raise CampaignError(
            "the first picture in the file cannot be measured",
            where=str(path),
            got=what,
            expected="grey (black is zero) or RGB",
            remedy="export linear TIFF",
        )
    if page.dtype not in (np.uint8, np.uint16):
        raise CampaignError("picture of another depth", where=str(path), got=page.dtype, expected="uint8 or uint16")
    check_strips(path, page)
    return _bounded(path, page.imagewidth, page.imagelength, page.samplesperpixel, 8 if page.dtype == np.uint8 else 16)


def _bounded(path: Path, width: int, height: int, bands: int, bits: int) -> PictureSize:
    size = PictureSize(width_px=width, height_px=height, bands=bands, bits=bits)
    small = 0 < width <= MAX_SIDE_PX and 0 < height <= MAX_SIDE_PX
    if not small or width * height * bands * (bits // 8) > MAX_IMAGE_BYTES or not 1 <= bands <= 3:
        expected = f"1 to 3 bands, at most {MAX_SIDE_PX} px a side and {MAX_IMAGE_BYTES} bytes of pixels"
        raise CampaignError("size of a picture", where=str(path), got=size, expected=expected)
    return size


def _head(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise CampaignError("no such file", where=str(path))
        with path.open("rb") as file:
            return file.read(64)
    except OSError as error:
        raise CampaignError("cannot be read", where=str(path), got=error.strerror) from None


def _whole(path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise CampaignError("too large", where=str(path), expected=f"at most {MAX_FILE_BYTES} bytes")
        return path.read_bytes()
    except OSError as error:
        raise CampaignError("cannot be read", where=str(path), got=error.strerror) from None
