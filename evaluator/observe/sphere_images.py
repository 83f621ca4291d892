"""The nine central pixels of an image of the integrating sphere (8.2.2 g), above the black level.

Images may be full frames of many megapixels in any format that `campaign.pictures` reads; of an uncompressed TIFF only three
rows are read.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from campaign.errors import CampaignError
from campaign.images import first_page, open_tiff, read_tags
from campaign.pictures import PictureSize, picture_size, read_picture
from campaign.sensors import CameraSheet

SIDE_PX = 3


@dataclass(frozen=True, kw_only=True)
class CentralPixels:
    """The centre of one image."""

    size: PictureSize
    dn: tuple[float, ...]  # (bands,) mean of the nine pixels, black level subtracted
    black_dn: tuple[float, ...]  # (bands,)
    black_source: str
    saturated_share: float  # of the nine pixels in any band


def central_pixels(path: Path, sheet: CameraSheet | None) -> CentralPixels:
    """Read the centre of one image.

    The black level is the sheet's, else the image's own tag, else zero. The sheet does not speak for an 8-bit picture of a
    deeper camera. A pixel is saturated at the last step (the sheet's bit depth, else the WhiteLevel tag, else the file's
    depth), and where all nine are alike in a 16-bit image above half of that: a full well that clips below the last step.

    Raises
    ------
    CampaignError
        No file, no readable picture, or one smaller than 3 x 3 pixels.
    """
    size = picture_size(path)
    if min(size.width_px, size.height_px) < SIDE_PX:
        raise CampaignError("too small a picture", where=str(path), got=size, expected="at least 3 x 3 px")
    block = _centre(path, size)
    black, white, source = _levels(path, size, sheet)
    full = (block >= white).any(axis=2)
    alike = (block == block[:1, :1]).all(axis=(0, 1)) & (block[0, 0] > 0.5 * white)
    clipped = size.bits == 16 and bool(alike.any())
    return CentralPixels(
        size=size,
        dn=tuple(float(v) for v in block.astype(np.float64).mean(axis=(0, 1)) - black),
        black_dn=tuple(float(v) for v in black),
        black_source=source,
        saturated_share=1.0 if clipped else float(full.mean()),
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


def _levels(path: Path, size: PictureSize, sheet: CameraSheet | None) -> tuple[np.ndarray, float, str]:
    """Black level of each band, the last step, and where the black level comes from."""
    if sheet is not None and sheet.bit_depth <= size.bits:
        return np.full(size.bands, sheet.black_level_dn), 2.0**sheet.bit_depth - 1.0, "sensors/camera.json"
    tags = _tags(path)
    last = 2.0**size.bits - 1.0
    whites = _band_values(tags.get("WhiteLevel"), size.bands)
    white = last if whites is None or not 0.0 < whites.min() <= last else float(whites.min())
    blacks = _band_values(tags.get("BlackLevel"), size.bands)
    if blacks is None or blacks.min() < 0.0 or blacks.max() >= white:
        return np.zeros(size.bands), white, "none recorded: 0 taken"
    return blacks, white, "the images' BlackLevel tag"


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
