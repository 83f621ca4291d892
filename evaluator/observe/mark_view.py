"""How a mark should look: finely sampled shares of white and black, sun and shade, as the pixels of one image would see them.

The funnel's slabs are cast on the plate from the sun's disc and from the camera. No pixel is read; the fit is in `marks`.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from evaluator.observe.target_view import on_plate

FINE = 6  # samples a pixel and axis in the maps
_BLUR_PX = 0.5  # standard deviation before the pixel's own box
_BLUR_STEP_PX = 0.3  # the fit's prior of it
_SUN_RADIUS = np.radians(0.2666)
_SUN_POINTS = 6
_TILT_STD = np.radians(0.2)  # of the sun against the sheets: sheet-metal work, level of the plate; 1-2 mm of shadow


@dataclass(frozen=True, kw_only=True)
class MarkView:
    """One mark as one image should show it."""

    predicted_px: np.ndarray  # (2,)
    px_per_m: np.ndarray  # (2, 2) pixel step by target x and y
    radius_m: float
    sheets_m: np.ndarray  # (q, 8, 3) the funnel's slabs, target frame about the mark: `target_view.sheet_corners`
    eye_m: np.ndarray  # (3,) projection centre, target frame about the mark
    to_sun: np.ndarray | None  # (3,) unit, target frame; None: no sun


def mark_radius_px(view: MarkView) -> float:
    """Mean radius of the mark in the image. [px]"""
    return view.radius_m * float(np.sqrt(abs(np.linalg.det(view.px_per_m))))


def _outlines(points_m: np.ndarray, view: MarkView, size: int, half: float) -> list[np.ndarray]:
    """Outlines (k, 2) of slabs (q, 8, 2) on the plate, at fine coordinates, of those that may meet the mark."""
    fine = (points_m @ view.px_per_m.T + half) * FINE - 0.5
    meets = np.all((fine.min(axis=1) < size) & (fine.max(axis=1) > -1.0), axis=-1)
    return [cv2.convexHull(corners.astype(np.float32))[:, 0] for corners in fine[meets]]


def _cover(outlines: list[np.ndarray], size: int) -> np.ndarray:
    """Share of every fine sample's square inside any of the outlines; true to area for slivers thinner than a square."""
    left = np.ones((size, size), np.float32)
    at = np.arange(size, dtype=np.float32)
    for outline in outlines:
        edge = np.roll(outline, -1, axis=0) - outline
        length = np.hypot(edge[:, 0], edge[:, 1])
        normal = np.stack([-edge[:, 1], edge[:, 0]], axis=1)[length > 1e-3] / length[length > 1e-3, None]
        corner = outline[length > 1e-3]
        if np.sum(normal * (outline.mean(axis=0) - corner)) < 0.0:
            normal = -normal
        # distance beyond an edge is linear over the map: its extremes are at the corners
        middle = np.sum(normal * (corner - 0.5 * (size - 1)), axis=1) + 0.5
        reach = 0.5 * (size - 1) * np.abs(normal).sum(axis=1)
        if np.any(middle - reach >= 1.0):
            continue
        outside = np.zeros((size, size), np.float32)
        for k in np.flatnonzero(middle + reach > 0.0):
            (nx, ny), (cx, cy) = normal[k], corner[k]
            beyond = np.add.outer(ny * (cy - at) + np.float32(0.5), nx * (cx - at))
            outside += np.clip(beyond, 0.0, 1.0, out=beyond)
        left *= np.minimum(outside, 1.0, out=outside)
    return 1.0 - left


def centre_hidden(view: MarkView) -> bool:
    """Whether a sheet stands before the centre and half a pixel around it. Inverted funnels never do; upright ones do from
    35.26 degrees off the zenith along a side."""
    outlines = _outlines(on_plate(view.sheets_m, view.eye_m, finite=True), view, 1, 0.5)
    return any(cv2.pointPolygonTest(o, (FINE / 2 - 0.5, FINE / 2 - 0.5), True) > 0.5 * FINE for o in outlines)


def _grown(mask: np.ndarray, by_px: float) -> np.ndarray:
    """Mask grown by a disc."""
    r = max(round(by_px * FINE), 1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * r + 1, 2 * r + 1))
    return np.asarray(cv2.dilate(mask, disc))


@dataclass(frozen=True, kw_only=True)
class Maps:
    """Finely sampled shares of a pixel, blurred: 0-3 lit white, lit black, shaded white, shaded black, 4 not to be used."""

    base: np.ndarray  # (5, s, s)
    by_place: np.ndarray  # (2, 4, s, s) slope by column and row [1/px]
    by_blur: np.ndarray  # (4, s, s) change with the blur's step
    by_shade: np.ndarray  # (0 or 2, 4, s, s) change when the sun moves by _TILT_STD against the target
    half_px: float


def _shade(view: MarkView, size: int, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Share of the sun's disc that the sheets hide (size, size), and its slope (2, size, size) by the sun's place over _TILT_STD.

    A ring of R / sqrt 2 has the disc's second moments. Near the faces' own angle the sheets' shadow is a line thinner than the
    penumbra: with a point for a sun it would be a black line through the centre.
    """
    if view.to_sun is None:
        return np.zeros((size, size), np.float32), np.zeros((2, size, size), np.float32)
    turn = 2.0 * np.pi * (np.arange(_SUN_POINTS) + 0.5) / _SUN_POINTS
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    across = np.linalg.svd(view.to_sun[None])[2][1:]
    radius = _SUN_RADIUS / np.sqrt(2.0)
    hidden = np.stack(
        [
            _cover(_outlines(on_plate(view.sheets_m, sun, finite=False), view, size, half), size)
            for sun in view.to_sun / np.linalg.norm(view.to_sun) + radius * ring @ across
        ]
    )
    slope = np.tensordot(ring.T * (2.0 / _SUN_POINTS * _TILT_STD / radius), hidden, axes=1)
    return hidden.mean(axis=0), np.asarray(slope, dtype=np.float32)


def appearance(view: MarkView) -> Maps:
    reach = view.radius_m * float(np.linalg.norm(view.px_per_m, ord=2))
    half = float(np.ceil(reach + 3.0))
    size = int(2 * half) * FINE
    axis = (np.arange(size) + 0.5) / FINE - half
    u, v = np.meshgrid(axis, axis)
    inverse = np.linalg.inv(view.px_per_m)
    x, y = inverse[0, 0] * u + inverse[0, 1] * v, inverse[1, 0] * u + inverse[1, 1] * v
    scale = float(np.sqrt(abs(np.linalg.det(view.px_per_m))))
    behind = _cover(_outlines(on_plate(view.sheets_m, view.eye_m, finite=True), view, size, half), size)
    hidden = _grown((behind > 0.02).astype(np.uint8), 0.2 + 0.003 * scale).astype(bool)
    out = hidden | (np.hypot(x, y) > view.radius_m)
    white = (x * y > 0.0).astype(np.float32)
    black = 1.0 - white
    shade, slope = _shade(view, size, half)
    raw = np.stack([white * (1.0 - shade), black * (1.0 - shade), white * shade, black * shade, out.astype(np.float32)])
    base = _blurred(raw)
    by_shade = np.zeros((0, 4, size, size), np.float32)
    if np.any(slope[:, ~out]):
        moved = _blurred(np.stack([white * slope[0], black * slope[0], white * slope[1], black * slope[1]]))
        by_shade = np.stack([-moved[0], -moved[1], moved[0], moved[1], -moved[2], -moved[3], moved[2], moved[3]])
        by_shade = by_shade.reshape(2, 4, size, size)
    kernel = np.array([-0.5, 0.0, 0.5], np.float32) * FINE
    one = np.ones(1, np.float32)
    return Maps(
        base=base,
        by_place=np.stack(
            [
                [cv2.sepFilter2D(m, -1, kernel, one) for m in base[:4]],
                [cv2.sepFilter2D(m, -1, one, kernel) for m in base[:4]],
            ]
        ),
        by_blur=np.stack([cv2.Laplacian(m, -1) for m in base[:4]]) * (_BLUR_PX * _BLUR_STEP_PX * FINE**2),
        by_shade=by_shade,
        half_px=half,
    )


def _blurred(maps: np.ndarray) -> np.ndarray:
    """As pixels see them: Gaussian of the optics, then the pixel's square."""
    reach = round(3.5 * _BLUR_PX * FINE)
    gauss = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (_BLUR_PX * FINE)) ** 2)
    box = np.array([0.5, *np.ones(FINE - 1), 0.5])
    kernel = np.convolve(gauss, box)
    kernel /= kernel.sum()
    return np.stack([cv2.sepFilter2D(m, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE) for m in maps])
