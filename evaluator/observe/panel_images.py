"""Reflectance panels in images: their outline in pixels, and the mean DN inside it for each band.

One image at a time, so that memory does not grow with the campaign. Panels in the cloud: `panels.py`.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from scipy.ndimage import uniform_filter

from campaign.config import Lens
from campaign.flight.records import CameraObservation, Exposure
from campaign.flight.trajectory import Trajectory
from campaign.sensors import CameraSheet
from campaign.survey import SurveyedTarget
from evaluator.camera_model import camera_points, project_exposure
from evaluator.frames import WorldFrame
from evaluator.model import EvaluationError, Mounting
from evaluator.observe.panels import ImagePanelObservation, panel_axes_world

_MIN_PIXELS = 16
_UNEVEN = 0.1
_SEARCH_PX = 96


def camera_lens(camera: CameraSheet) -> Lens:
    """The certificate's lens; without one the nominal focal length and the image's middle."""
    if camera.calibration is not None:
        return camera.calibration.lens
    f = camera.nominal_focal_length_mm * 1000.0 / camera.pixel_size_um
    return Lens(fx_px=f, fy_px=f, cx_px=0.5 * camera.width_px, cy_px=0.5 * camera.height_px)


def focal_length_mm(camera: CameraSheet) -> float:
    """f of formula (1): the certificate's principal distance; without one the nominal focal length. [mm]"""
    return camera_lens(camera).fx_px * camera.pixel_size_um / 1000.0


def panel_region_px(
    panel: SurveyedTarget,
    camera: CameraSheet,
    body_from_camera: Mounting,
    trajectory: Trajectory,
    exposure: Exposure,
    world_frame: WorldFrame,
    *,
    shrink: float = 0.0,
) -> np.ndarray:
    """Outline of a panel's top face in one image, or of the part that is left after a border is taken off.

    Parameters
    ----------
    shrink : float
        Width of the border over the panel's edge length, 0 to 0.5.

    Returns
    -------
    (4, 2) np.ndarray
        Corners in order; NaN where a corner is behind the camera. May lie outside the image. [px]
    """
    centre, axes = panel_axes_world(panel, world_frame)
    half = (0.5 - shrink) * panel.size_m
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corners = centre + half * signs @ axes[:2]
    lens = camera_lens(camera)
    return project_exposure(camera, lens, body_from_camera, trajectory, exposure.gps_time_s, corners, world_frame)[0]


def inside_image(region_px: np.ndarray, camera: CameraSheet, margin_px: float = 0.0) -> bool:
    """Whether all corners lie in the image, at least `margin_px` from its border."""
    limit = np.array([camera.width_px, camera.height_px]) - margin_px
    return bool(np.isfinite(region_px).all() and (region_px >= margin_px).all() and (region_px <= limit).all())


def region_pixels(region_px: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels whose centre lies in a convex polygon: rows (n,), columns (n,), place in it from 0 to 1 (n, 2).

    The place is along two sides of a quadrilateral, within the upright box of any other polygon.
    """
    low = np.floor(region_px.min(axis=0)).astype(np.int64)
    high = np.ceil(region_px.max(axis=0)).astype(np.int64)
    grid = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    columns, rows = grid[0].ravel(), grid[1].ravel()
    centre = np.stack([columns + 0.5, rows + 0.5], axis=-1)
    side = np.roll(region_px, -1, axis=0) - region_px
    to_pixel = centre[:, None, :] - region_px[None, :, :]
    cross = side[None, :, 0] * to_pixel[..., 1] - side[None, :, 1] * to_pixel[..., 0]
    keep = np.all(cross >= 0.0, axis=1) | np.all(cross <= 0.0, axis=1)
    corner, basis = region_px.min(axis=0), np.diag(np.ptp(region_px, axis=0))
    if len(region_px) == 4:
        corner = region_px[0]
        basis = np.stack([region_px[1] - corner, region_px[3] - corner], axis=-1)
    if abs(np.linalg.det(basis)) < 1e-9:
        keep[:] = False
        return rows[keep], columns[keep], np.empty((0, 2))
    place = np.linalg.solve(basis, (centre[keep] - corner).T).T
    return rows[keep], columns[keep], place


def panel_image_values(
    dn: np.ndarray,
    exposure: Exposure,
    sortie: int,
    panels: Sequence[SurveyedTarget],
    camera: CameraSheet,
    body_from_camera: Mounting,
    trajectory: Trajectory,
    world_frame: WorldFrame,
    *,
    search: bool = False,
    picked: Sequence[CameraObservation] = (),
) -> list[ImagePanelObservation]:
    """Mean DN above the black level of every panel that lies wholly in one image.

    Parameters
    ----------
    dn : (height, width, bands) np.ndarray
        Linear image as read. [DN]
    panels : sequence of SurveyedTarget
        Other kinds are passed over.
    body_from_camera : Mounting
        The solved mounting, or the nominal one together with `search`.
    search : bool
        Move the outlines by contrast first: one shift common to all panels, then a little for each.
    picked : sequence of CameraObservation
        Pixels that a person gave, for the panels they name: of three or more the convex hull is read as it is, one or two
        say where the panel's centre is.

    Raises
    ------
    EvaluationError
        The image's size or bands are not the sheet's.
    """
    expected = (camera.height_px, camera.width_px, len(camera.bands))
    if dn.shape != expected:
        raise EvaluationError("image is not the camera's", where=exposure.image, got=dn.shape, expected=expected)
    outlines: dict[str, np.ndarray] = {}
    shrinks: dict[str, float] = {}
    focal = camera_lens(camera).fx_px
    for panel in panels:
        if panel.kind != "panel":
            continue
        centre, _ = panel_axes_world(panel, world_frame)
        time = np.array([exposure.gps_time_s])
        depth = float(camera_points(body_from_camera, trajectory, time, centre[None, :], world_frame)[0, 2])
        if depth <= 0.0:
            continue
        # Off the rim by a tenth, and by three pixels for the blur and what is left of the mounting's error.
        pixels = panel.size_m * focal / depth
        shrinks[panel.id] = min(max(0.1, 3.0 / pixels), 0.4)
        outlines[panel.id] = panel_region_px(panel, camera, body_from_camera, trajectory, exposure, world_frame)
    if search:
        outlines = shift_by_contrast(dn, outlines, camera)
    full_scale = float(2**camera.bit_depth - 1)
    by_hand = _picked_pixels(picked, exposure, [p.id for p in panels if p.kind == "panel"])
    found = []
    for name in sorted(outlines.keys() | by_hand.keys()):
        pixels_of_person = by_hand.get(name)
        if pixels_of_person is not None and len(pixels_of_person) >= 3:
            region = pixels_of_person[cv2.convexHull(pixels_of_person.astype(np.float32), returnPoints=False).ravel()]
            if not inside_image(region, camera):
                continue
        elif name in outlines:
            outline = outlines[name]
            middle = outline.mean(axis=0)
            if pixels_of_person is not None:
                outline = outline + (pixels_of_person.mean(axis=0) - middle)
                middle = outline.mean(axis=0)
            if not inside_image(outline, camera):
                continue
            region = middle + (1.0 - 2.0 * shrinks[name]) * (outline - middle)
        else:
            continue
        rows, columns, place = region_pixels(region)
        if rows.size < _MIN_PIXELS:
            continue
        values = dn[rows, columns].astype(np.float64)
        mean, std = values.mean(axis=0), values.std(axis=0)
        found.append(
            ImagePanelObservation(
                panel=name,
                sortie=sortie,
                strip=exposure.strip,
                image=exposure.image,
                mean_dn=tuple(float(v) for v in mean - camera.black_level_dn),
                std_dn=tuple(float(v) for v in std),
                clipped_share=tuple(float(v) for v in (values >= full_scale).mean(axis=0)),
                pixels=int(rows.size),
                uneven=_uneven(values - camera.black_level_dn, place),
                region_px=region,
                picked_by="evaluator" if pixels_of_person is None else "person",
            )
        )
    return found


def _picked_pixels(
    picked: Sequence[CameraObservation], exposure: Exposure, panels: Sequence[str]
) -> dict[str, np.ndarray]:
    """Panel -> (n, 2) pixels that a person gave in one image."""
    gathered: dict[str, list[tuple[float, float]]] = {}
    for o in picked:
        if o.image == exposure.image and o.target in panels:
            gathered.setdefault(o.target, []).append((o.u_px, o.v_px))
    return {name: np.array(pixels, dtype=np.float64) for name, pixels in gathered.items()}


def _uneven(values: np.ndarray, place: np.ndarray) -> bool:
    """Whether the nine parts of a panel differ by over a tenth of its mean, and by more than their noise."""
    grey = values.mean(axis=1)
    cell = np.clip((place * 3.0).astype(np.int64), 0, 2)
    part = cell[:, 0] * 3 + cell[:, 1]
    count = np.bincount(part, minlength=9)
    if (count < 3).any():
        return False
    means = np.bincount(part, weights=grey, minlength=9) / count
    inner = np.sqrt(np.maximum(np.bincount(part, weights=grey**2, minlength=9) / count - means**2, 0.0) / count)
    difference = float(means.max() - means.min())
    return difference > _UNEVEN * abs(float(grey.mean())) and difference > 6.0 * float(np.median(inner))


def shift_by_contrast(dn: np.ndarray, outlines: Mapping[str, np.ndarray], camera: CameraSheet) -> dict[str, np.ndarray]:
    """Moves outlines onto the panels of one image where only the nominal mounting is known.

    A panel is uniform inside and has edges about it: log variance of a larger box minus that of a box inside it. The sum over
    all panels gives the shift that a wrong boresight causes; each panel then moves by at most 16 pixels more. Panels too near
    to the image's border stay out.
    """
    reach = _SEARCH_PX
    scores: dict[str, np.ndarray] = {}
    for name, outline in outlines.items():
        if not np.isfinite(outline).all():
            continue
        edge = float(np.sqrt(abs(np.linalg.det(np.stack([outline[1] - outline[0], outline[3] - outline[0]])))))
        side = outline[1] - outline[0]
        turn = (abs(side[0]) + abs(side[1])) / max(float(np.hypot(*side)), 1e-9)  # 1 upright .. 1.41 on its corner
        inner, outer = max(3, int(0.85 * edge / turn)), max(7, int(1.3 * edge * turn))
        pad = reach + outer // 2 + 2
        column, row = np.floor(outline.mean(axis=0)).astype(np.int64)
        if not (pad <= row < camera.height_px - pad and pad <= column < camera.width_px - pad):
            continue
        window = dn[row - pad : row + pad + 1, column - pad : column + pad + 1].astype(np.float64).mean(axis=2)
        window -= window.mean()
        spread = [
            np.maximum(uniform_filter(window**2, size) - uniform_filter(window, size) ** 2, 0.0)
            for size in (inner, outer)
        ]
        floor = 1e-4 * float(window.var()) + 1.0
        score = np.log(spread[1] + floor) - np.log(spread[0] + floor)
        middle = slice(pad - reach, pad + reach + 1)
        scores[name] = score[middle, middle]
    if not scores:
        return {}
    common = np.unravel_index(int(np.argmax(np.sum(list(scores.values()), axis=0))), next(iter(scores.values())).shape)
    moved = {}
    for name, score in scores.items():
        low = [max(0, int(c) - 16) for c in common]
        part = score[low[0] : int(common[0]) + 17, low[1] : int(common[1]) + 17]
        best = np.unravel_index(int(np.argmax(part)), part.shape)
        shift = np.array([low[1] + int(best[1]) - reach, low[0] + int(best[0]) - reach], dtype=np.float64)
        moved[name] = outlines[name] + shift
    return moved
