"""Points as few bytes: 16-bit places inside tiles of the ground, 8-bit attributes; base64 for the page.

A tile's points stand in an order without pattern, so that any part from the front is an even choice: the page may draw fewer.
"""

import base64
import itertools
from dataclasses import dataclass

import numpy as np

from evaluator.view.model import Cloud
from evaluator.view.points import row_hash

TILE_M = 64.0  # 1 mm steps
MOST_TILES = 400
REFLECTANCE_STEP = 0.005  # codes 1..254 for 0 to 126 %, 0: none
ERROR_DECADES = 3.0  # codes 1..255 for 1 mm to 1 m, equal steps of the logarithm; 0: none
LEAST_ERROR_M = 1e-3


@dataclass(frozen=True, kw_only=True)
class PackedCloud:
    """What the page decodes. Arrays are in one order, tile after tile."""

    tiles: tuple[tuple[tuple[float, ...], tuple[float, ...], int], ...]  # low corner from the origin, step [m]; points
    place: np.ndarray  # (n, 3) uint16
    shift: np.ndarray  # (n, 3) int8: adjusted minus delivered, in `shift_step_m`
    shift_step_m: float  # 0: there is no adjusted version
    strip: np.ndarray  # (n,) uint8 index into the cloud's strips
    reflectance: np.ndarray  # (n,) uint8
    error: np.ndarray  # (2, n) uint8 as delivered, adjusted


def base64_text(array: np.ndarray) -> str:
    """Little-endian bytes in base64."""
    return base64.b64encode(np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<")).tobytes()).decode()


def error_code(error_m: np.ndarray) -> np.ndarray:
    """[m] -> uint8; NaN is 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        code = 1.0 + 254.0 / ERROR_DECADES * np.log10(np.asarray(error_m) / LEAST_ERROR_M)
    return np.where(np.isfinite(error_m), np.clip(np.nan_to_num(code, neginf=1.0), 1, 255).round(), 0).astype(np.uint8)


def reflectance_code(reflectance: np.ndarray) -> np.ndarray:
    """0..1 -> uint8; NaN is 0."""
    code = np.clip(1.0 + np.nan_to_num(reflectance) / REFLECTANCE_STEP, 1, 254).round()
    return np.where(np.isfinite(reflectance), code, 0).astype(np.uint8)


def pack(cloud: Cloud, origin_m: np.ndarray) -> PackedCloud | None:
    """The cloud in bytes; None without points. `origin_m`: map coordinates (3,) that the page counts from."""
    if not cloud.strips or cloud.shown == 0:
        return None
    xyz = cloud.joined("map_m") - origin_m
    shift = cloud.joined("adjusted_map_m") - origin_m - xyz
    known = np.isfinite(shift).all(axis=1)
    step = float(np.abs(shift[known]).max()) / 127.0 if known.any() else 0.0
    edge = TILE_M
    cell = np.floor(xyz[:, :2] / edge).astype(np.int64)
    while len(np.unique(cell, axis=0)) > MOST_TILES:
        edge *= 2.0
        cell = np.floor(xyz[:, :2] / edge).astype(np.int64)
    _, tile = np.unique(cell, axis=0, return_inverse=True)
    strip = np.repeat(np.arange(len(cloud.strips)), [len(s.record) for s in cloud.strips]).astype(np.uint8)
    chance = np.concatenate([row_hash(s.record, 31 + k) for k, s in enumerate(cloud.strips)])
    order = np.lexsort((chance, tile.ravel()))
    ends = np.searchsorted(tile.ravel()[order], np.arange(int(tile.max()) + 2))
    place = np.zeros((len(xyz), 3), np.uint16)
    tiles = []
    for low, high in itertools.pairwise(ends.tolist()):
        part = xyz[order[low:high]]
        corner = np.floor(part.min(axis=0) * 1000.0) / 1000.0
        steps = np.maximum((part.max(axis=0) - corner) / 65535.0, 0.0005)
        place[low:high] = np.round((part - corner) / steps).clip(0, 65535).astype(np.uint16)
        tiles.append((tuple(corner.tolist()), tuple(steps.tolist()), int(high - low)))
    small = np.nan_to_num(shift / step).round().clip(-127, 127) if step > 0.0 else np.zeros(shift.shape)
    return PackedCloud(
        tiles=tuple(tiles),
        place=place,
        shift=small[order].astype(np.int8),
        shift_step_m=step,
        strip=strip[order],
        reflectance=reflectance_code(cloud.joined("reflectance"))[order],
        error=error_code(cloud.joined("error_m"))[:, order],
    )
