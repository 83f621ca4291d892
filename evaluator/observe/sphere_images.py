"""The nine central pixels of an image of the integrating sphere (8.2.2 g), above the black level.

Images may be full frames of many megapixels in any format that `campaign.benches.pictures` reads; of an uncompressed TIFF only
three rows are read.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from campaign.benches.pictures import PictureSize, picture_size, read_picture
from campaign.errors import CampaignError
from campaign.flight.images import first_page, open_tiff, read_tags
from campaign.sensors import CameraSheet

SIDE_PX = 3
LEAST_SHARE = 0.01  # of full scale above black: see `unlit`
_LEAST_16_BIT = 1023.0  # [DN] of a camera whose depth is not stated: 10 bit is the least that is stored in 16
_SHEET = "sensors/camera.json"


@dataclass(frozen=True, kw_only=True)
class CentralPixels:
    """The centre of one image."""

    size: PictureSize
    dn: tuple[float, ...]  # (bands,) mean of the nine pixels, black level subtracted
    black_dn: tuple[float, ...]  # (bands,)
    black_source: str
    saturated_share: float  # of the nine pixels in any band
    pixels: bytes  # the nine as they stand in the file
    full_scale_dn: float  # the last step as stated by the sheet or the file, else the least that it can be
    linear: bool  # by the format: 16 bit, or 8 bit of a camera whose sheet has no more; never JPEG


def central_pixels(path: Path, sheet: CameraSheet | None) -> CentralPixels:
    """Read the centre of one image.

    The black level is the sheet's, else the image's own tag, else zero. The sheet does not speak for an 8-bit picture of a
    deeper camera. A pixel is saturated at the last step (the sheet's bit depth, else the WhiteLevel tag, else the file's
    depth), and where all nine are alike in a 16-bit image above half of that: a full well that clips below the last step.

    Raises
    ------
    CampaignError
        No file, no readable picture, one smaller than 3 x 3 pixels, or pixels beyond the sheet's bit depth.
    """
    size = picture_size(path)
    if min(size.width_px, size.height_px) < SIDE_PX:
        raise CampaignError("too small a picture", where=str(path), got=size, expected="at least 3 x 3 px")
    block = _centre(path, size)
    black, white, stated, source = _levels(path, size, sheet)
    if source == _SHEET and sheet is not None:
        check_depth(path, block, sheet)
    full = (block >= white).any(axis=2)
    alike = (block == block[:1, :1]).all(axis=(0, 1)) & (block[0, 0] > 0.5 * white)
    clipped = size.bits == 16 and bool(alike.any())
    return CentralPixels(
        size=size,
        dn=tuple(float(v) for v in block.astype(np.float64).mean(axis=(0, 1)) - black),
        black_dn=tuple(float(v) for v in black),
        black_source=source,
        saturated_share=1.0 if clipped else float(full.mean()),
        pixels=block.tobytes(),
        full_scale_dn=white if stated or size.bits == 8 else _LEAST_16_BIT,
        linear=(size.bits == 16 or source == _SHEET) and path.suffix.lower() not in (".jpg", ".jpeg"),
    )


def check_depth(path: Path, dn: np.ndarray, sheet: CameraSheet) -> None:
    """Raises CampaignError where a DN is beyond what the sheet's bit depth can hold: black level and gain would not fit either."""
    top = int(dn.max())
    if top > 2**sheet.bit_depth - 1:
        raise CampaignError(
            f"the pixels go beyond sensors/camera.json's {sheet.bit_depth} bit: scaled on export?",
            where=str(path),
            got=f"{top} DN",
            expected=f"at most {2**sheet.bit_depth - 1}",
        )


def unlit(bands: Sequence[str], pixels: Sequence[CentralPixels]) -> str | None:
    """Why the light of a series cannot be judged, or None.

    Below 1 % of full scale the lamp is off or the shutter closed: one DN by which a 14-bit camera's black level is wrong changes
    every relative figure by 0.6 % and more, and read noise is of the signal's size. A sphere is exposed to half the scale or so.
    """
    mean = np.array([p.dn for p in pixels]).mean(axis=0)
    worst = int(mean.argmin())
    if mean[worst] <= 0.0:
        return f"channel {bands[worst]} is not above the black level; lengthen the exposure (8.2.2 d)"
    least = LEAST_SHARE * min(p.full_scale_dn for p in pixels)
    if mean[worst] < least:
        return (
            f"channel {bands[worst]} is hardly above the black level: is the lamp on? got {mean[worst]:.3g} DN, "
            f"expected at least {least:.3g} DN (1 % of full scale); lengthen the exposure (8.2.2 d)"
        )
    return None


def copied(pixels: Sequence[CentralPixels]) -> str | None:
    """Why images that are all alike are no series, or None: photons and read-out never repeat nine pixels in every image."""
    if len({p.pixels for p in pixels}) > 1:
        return None
    return (
        f"the nine central pixels are the same in all {len(pixels)} images: one picture copied, or none of the sensor's"
    )


def _centre(path: Path, size: PictureSize) -> np.ndarray:
    """(3, 3, bands); of an even side the pixel after the middle is the block's centre."""
    row, column = size.height_px // 2 - 1, size.width_px // 2 - 1
    with path.open("rb") as file:
        head = file.read(4)
    if head in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        with open_tiff(path) as tiff:
            page = first_page(path, tiff)
            depth = np.dtype(np.uint16 if size.bits == 16 else np.uint8)
            shape = (size.height_px, size.width_px, size.bands)
            if page.is_memmappable and page.planarconfig == 1:
                stored = depth.newbyteorder(tiff.byteorder)
                rows = np.memmap(path, dtype=stored, mode="r", offset=page.dataoffsets[0], shape=shape)
                return np.asarray(rows[row : row + SIDE_PX, column : column + SIDE_PX].astype(depth))
    return read_picture(path)[row : row + SIDE_PX, column : column + SIDE_PX]


def _levels(path: Path, size: PictureSize, sheet: CameraSheet | None) -> tuple[np.ndarray, float, bool, str]:
    """Black level of each band, the last step, whether that is stated, and where the black level comes from."""
    if sheet is not None and sheet.bit_depth <= size.bits:
        return np.full(size.bands, sheet.black_level_dn), 2.0**sheet.bit_depth - 1.0, True, _SHEET
    tags = _tags(path)
    last = 2.0**size.bits - 1.0
    whites = _band_values(tags.get("WhiteLevel"), size.bands)
    stated = whites is not None and 0.0 < float(whites.min()) <= last
    white = float(whites.min()) if whites is not None and stated else last
    blacks = _band_values(tags.get("BlackLevel"), size.bands)
    if blacks is None or blacks.min() < 0.0 or blacks.max() >= white:
        return np.zeros(size.bands), white, stated, "none recorded: 0 taken"
    return blacks, white, stated, "the images' BlackLevel tag"


def _tags(path: Path) -> dict[str, object]:
    try:
        return read_tags(path)
    except CampaignError:  # a picture without EXIF, such as a PNG
        return {}


def _band_values(value: object, bands: int) -> np.ndarray | None:
    """A tag's numbers, one for each band; None where there are none."""
    if not isinstance(value, tuple) or len(value) not in (1, bands):
        return None
    numbers = np.asarray(value, float)
    return np.broadcast_to(numbers, (bands,)).copy() if np.isfinite(numbers).all() else None
