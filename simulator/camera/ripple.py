"""Heat shimmer: the air over warm ground displaces the picture in waves, in each image otherwise. No lens model holds it.

The picture is rendered with the true lens and then displaced, before the sensor's noise: pictures that differ in it share a
render. Radiance is carried along unchanged; the displacement's own magnification (2 pi amplitude / period) is left out.
"""

import zlib

import numpy as np
from scipy.ndimage import map_coordinates

from campaign.config import Config, Faults
from campaign.errors import ConfigError

_ACROSS_RAD = 1.43  # between the directions of the two waves
_STEEPEST = 0.5  # displacement's greatest slope: beyond, the picture nearly folds
_ITERATIONS = 40
_ROWS = 128  # of a picture at a time
_MARGIN_ROWS = 24


def ripple_px(faults: Faults, uv_px: np.ndarray, image: str) -> np.ndarray:
    r"""Displacement of what the lens would show at a pixel of one image.

    .. math:: \Delta u = a \sin(2\pi\, e_u \cdot x / T + \varphi_u), \quad \Delta v = a \sin(2\pi\, e_v \cdot x / T + \varphi_v)

    Parameters
    ----------
    uv_px : (..., 2) np.ndarray
        By the lens alone. [px]
    image : str
        Name of its file without the ending: each has directions and phases of its own.

    Returns
    -------
    (..., 2) np.ndarray
        Its root mean square length over the picture is a. [px]
    """
    turns = 2.0 * np.pi / faults.image_ripple_period_px
    u, v = uv_px[..., 0], uv_px[..., 1]
    draw = zlib.crc32(image.encode())
    along, *phases = (2.0 * np.pi * ((draw >> shift) & 0x3FF) / 1024.0 for shift in (0, 10, 20))
    waves = [
        np.sin(turns * (np.cos(turn) * u + np.sin(turn) * v) + phase)
        for turn, phase in zip((along, along + _ACROSS_RAD), phases, strict=True)
    ]
    return faults.image_ripple_px * np.stack(waves, axis=-1)


def require_no_fold(config: Config) -> None:
    """The displacement leaves a picture.

    Raises
    ------
    ConfigError
        An amplitude too great for its period.
    """
    faults = config.faults
    slope = 2.0 * np.pi * faults.image_ripple_px / faults.image_ripple_period_px
    if slope > _STEEPEST:
        raise ConfigError(
            "the ripple folds the picture",
            where="faults.image_ripple_px",
            got=f"{faults.image_ripple_px:g} px over {faults.image_ripple_period_px:g} px",
            expected=f"at most {_STEEPEST * faults.image_ripple_period_px / (2.0 * np.pi):.3g} px",
        )


def rippled(picture: np.ndarray, faults: Faults, image: str) -> np.ndarray:
    """A picture (h, w) or (h, w, bands) as displaced; itself where there is no ripple. `image`: see `ripple_px`."""
    if faults.image_ripple_px == 0.0:
        return picture
    blocks = (slice(first, min(first + _ROWS, len(picture))) for first in range(0, len(picture), _ROWS))
    return np.concatenate([rippled_rows(picture, faults, image, rows) for rows in blocks])


def rippled_rows(picture: np.ndarray, faults: Faults, image: str, rows: slice) -> np.ndarray:
    """Some rows of a picture as displaced."""
    height, width = picture.shape[:2]
    seen = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(rows.start, rows.stop) + 0.5), axis=-1)
    source = seen.copy()
    for _ in range(_ITERATIONS):  # source + ripple(source) = seen; the slope is at most a half
        step = seen - ripple_px(faults, source, image) - source
        source += step
        if np.abs(step).max() < 1e-6:
            break
    # The spline of a few rows more is the whole picture's: a row's weight falls by 0.27 from row to row.
    low = max(0, int(source[..., 1].min()) - _MARGIN_ROWS)
    near = picture[low : min(height, int(source[..., 1].max()) + _MARGIN_ROWS)]
    at = np.stack([source[..., 1] - 0.5 - low, source[..., 0] - 0.5])
    planes = near[..., None] if near.ndim == 2 else near
    out = np.stack(
        [map_coordinates(planes[..., b], at, order=3, mode="nearest") for b in range(planes.shape[2])], axis=-1
    ).astype(picture.dtype)
    np.maximum(out, 0.0, out=out)
    return out[..., 0] if picture.ndim == 2 else out
