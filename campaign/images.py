"""Images: 16-bit TIFF (linear DN, black level included) with EXIF and XMP, and a JPEG preview (8-bit sRGB)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np


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


def write_image(path: Path, dn: np.ndarray, tags: ImageTags) -> None:
    """`dn` (height, width, bands) uint16 -> lossless TIFF. Same input, same bytes."""
    raise NotImplementedError


def write_preview(path: Path, srgb: np.ndarray, tags: ImageTags) -> None:
    """`srgb` (height, width, 3) uint8 -> JPEG with the same EXIF."""
    raise NotImplementedError


def read_image(path: Path, *, width_px: int, height_px: int, bands: int) -> np.ndarray:
    """(height, width, bands) uint16. The size in the file is checked against the sheet before pixels are decoded."""
    raise NotImplementedError


def read_preview(path: Path, *, width_px: int, height_px: int) -> np.ndarray:
    """(height, width, 3) uint8."""
    raise NotImplementedError


def read_tags(path: Path) -> dict[str, object]:
    """EXIF and XMP of a TIFF written here or by others; missing tags are absent from the dict."""
    raise NotImplementedError
