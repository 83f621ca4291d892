"""Every image of the campaign, reduced, with what was found and projected in it as vector graphics, and its targets enlarged.

Each image is read once. Pictures are JPEG within a budget for the whole page; regions, marks and reprojections are SVG over
them, in the image's own pixels (top left corner (0, 0)). The page's words stand in `texts`.
"""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import islice

import cv2
import numpy as np

from campaign.errors import TestrangeError
from campaign.flight.images import read_image, read_preview
from campaign.flight.records import Exposure
from campaign.sensors import CameraSheet
from evaluator.camera_model import project_exposure
from evaluator.frames import WorldFrame
from evaluator.georeference import nominal_mountings
from evaluator.model import CampaignData, SortieData
from evaluator.mounting.mounting_model import mounting_of
from evaluator.observe.panel_images import camera_lens
from evaluator.report.style import image_uri
from evaluator.results import Evaluation

_PHOTO_BUDGET = 13_000_000  # bytes of JPEG on the whole page
_ZOOM_BUDGET = 5_000_000
_PHOTO_BYTES = 700_000  # of one picture at most
_ZOOM_BYTES = 160_000
_WIDEST, _NARROWEST = 1600, 480
_QUALITIES = (80, 68, 52, 36)
_CELL, _COLUMNS = 128, 6  # of a sheet of enlarged targets [px]
_MOST_ZOOMS = 60  # in one image


@dataclass(frozen=True, kw_only=True)
class Spot:
    """One target in one image: what was found, what was projected, and the region that was read. Distorted pixels."""

    target: str
    kind: str  # frustum, panel or board
    observed_px: np.ndarray | None = None  # (2,)
    projected_px: np.ndarray | None = None  # (2,)
    error_px: float | None = None
    region_px: np.ndarray | None = None  # (k, 2)
    radius_px: float = 0.0

    @property
    def centre_px(self) -> np.ndarray | None:
        """Where to look."""
        if self.observed_px is not None:
            return self.observed_px
        return self.projected_px if self.region_px is None else self.region_px.mean(axis=0)

    @property
    def reach_px(self) -> float:
        """Half the side of its surroundings."""
        if self.region_px is not None and self.observed_px is None:
            return max(12.0, 0.8 * float(np.ptp(self.region_px, axis=0).max()))
        return max(14.0, 2.0 * self.radius_px)


@dataclass(frozen=True, kw_only=True)
class Zoom:
    """One cell of a sheet: where it stands there, and marks in the sheet's pixels."""

    label: str
    kind: str
    x: int
    y: int
    observed: tuple[float, float] | None
    projected: tuple[float, float] | None
    outline: str


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One image as the page shows it; without a picture the reason."""

    sortie: int
    strip: int
    image: str
    width_px: int
    height_px: int
    uri: str = ""
    raw: bool = False  # from the image itself: there is no preview
    spots: tuple[Spot, ...] = ()
    sheet_uri: str = ""
    sheet_width: int = 0
    sheet_height: int = 0
    zooms: tuple[Zoom, ...] = field(default=())
    reason: str = ""

    def count(self, kind: str) -> int:
        """Targets of one kind in it."""
        return sum(s.kind == kind for s in self.spots)

    @property
    def mean_error_px(self) -> float | None:
        """Mean of the errors of (24) in it; boards apart."""
        found = [s.error_px for s in self.spots if s.error_px is not None and s.kind == "frustum"]
        return float(np.mean(found)) if found else None


def spots_by_image(evaluation: Evaluation) -> dict[tuple[int, str], tuple[Spot, ...]]:
    """What is drawn in each image, by sortie and file name, targets in order."""
    kinds = {t.id: t.kind for t in evaluation.data.targets} if evaluation.data else {}
    marks = {(m.sortie, m.image, m.target): m for m in evaluation.marks}
    residuals = {(r.sortie, r.image, r.target): r for r in evaluation.residuals}
    regions = {(r.sortie, r.image, r.target): r for r in evaluation.regions}
    out: dict[tuple[int, str], list[Spot]] = {}
    for key in sorted({*marks, *residuals, *regions}):
        mark, residual, region = marks.get(key), residuals.get(key), regions.get(key)
        seen = residual.observed_px if residual is not None else mark.uv_px if mark is not None else None
        out.setdefault(key[:2], []).append(
            Spot(
                target=key[2],
                kind=kinds.get(key[2], "panel" if seen is None else "frustum"),
                observed_px=seen,
                projected_px=None if residual is None else residual.projected_px,
                error_px=None if residual is None else residual.error_px,
                region_px=None if region is None else region.corners_px,
                radius_px=mark.radius_px if mark is not None else 9.0 if seen is not None else 0.0,
            )
        )
    for key2, spots in _board_spots(evaluation).items():
        out.setdefault(key2, []).extend(spots)
    return {key2: tuple(spots) for key2, spots in sorted(out.items())}


def _board_spots(evaluation: Evaluation) -> dict[tuple[int, str], list[Spot]]:
    """Boards where the adjustment projects them, plus the residual that results.json states: where they were found."""
    data, residuals = evaluation.data, evaluation.boards.get("residuals")
    estimates = evaluation.boards.get("estimates")
    if data is None or data.rig is None or data.camera is None or data.camera.calibration is None:
        return {}
    if not isinstance(residuals, list | tuple) or not isinstance(estimates, list | tuple):
        return {}
    if any(e is None for e in estimates):
        return {}
    xi = np.array(estimates, dtype=np.float64) * np.repeat([np.radians(1.0), 1.0], 3)
    mounting, lens = mounting_of(nominal_mountings(data.rig)[0], xi), data.camera.calibration.lens
    frame = WorldFrame(data.manifest)
    boards = {t.id: t for t in data.targets}
    exposed = {(s.folder.number, e.image): (s, e) for s in data.sorties for e in s.exposures}
    out: dict[tuple[int, str], list[Spot]] = {}
    for row in residuals:
        key = (row["sortie"], row["image"])
        if key not in exposed or row["target"] not in boards:
            continue
        sortie, exposure = exposed[key]
        if sortie.trajectory is None:
            continue
        t = boards[row["target"]]
        place = frame.world_from_map(np.array([[t.easting_m, t.northing_m, t.height_m]]))
        uv, _ = project_exposure(data.camera, lens, mounting, sortie.trajectory, exposure.gps_time_s, place, frame)
        if not np.isfinite(uv).all():
            continue
        shift = np.array([row["du_px"], row["dv_px"]])
        spot = Spot(
            target=t.id,
            kind="board",
            observed_px=uv[0] + shift,
            projected_px=uv[0],
            error_px=float(np.hypot(*shift)),
            radius_px=0.3 * t.size_m / max(_ground_sample_m(data, sortie, exposure), 1e-6),
        )
        out.setdefault(key, []).append(spot)
    return out


def _ground_sample_m(data: CampaignData, sortie: SortieData, exposure: Exposure) -> float:
    """About one pixel on the ground, from the height above the site's origin."""
    t, sheet = sortie.trajectory, data.camera
    assert t is not None and sheet is not None
    height = (
        float(np.interp(exposure.gps_time_s, t.gps_time_s, t.ellipsoid_height_m)) - data.manifest.ellipsoid_height_m
    )
    return max(height, 1.0) / camera_lens(sheet).fx_px


def _pixels(sheet: CameraSheet, sortie: SortieData, exposure: Exposure) -> tuple[np.ndarray, bool]:
    """(height, width, 3) uint8 of the preview, else of the image itself (True), stretched to its brightest pixels."""
    path = sortie.folder.images / exposure.image
    preview = path.with_suffix(".jpg")
    if preview.is_file() or not path.is_file():
        return read_preview(preview, width_px=sheet.width_px, height_px=sheet.height_px), False
    dn = read_image(path, width_px=sheet.width_px, height_px=sheet.height_px, bands=len(sheet.bands))
    top = float(np.quantile(dn[::16, ::16], 0.998))
    linear = np.clip((np.arange(65536) - sheet.black_level_dn) / max(top - sheet.black_level_dn, 1.0), 0.0, 1.0)
    table = np.round(255.0 * linear ** (1.0 / 2.2)).astype(np.uint8)
    shown = np.empty_like(dn, np.uint8)
    for row in range(0, len(dn), 64):  # NumPy makes indices of 8 bytes of them
        shown[row : row + 64] = table[dn[row : row + 64]]
    return (shown if shown.shape[2] == 3 else np.repeat(shown[:, :, :1], 3, axis=2)), True


def _jpeg(pixels: np.ndarray, most_bytes: int) -> bytes:
    """JPEG of the best quality that fits; where none does, of fewer pixels."""
    bgr = np.ascontiguousarray(pixels[:, :, ::-1])
    while True:
        for quality in _QUALITIES:
            data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
            if len(data) <= most_bytes or max(bgr.shape) < 64:
                return data
        bgr = _resized(bgr, max(1, bgr.shape[1] * 3 // 4), max(1, bgr.shape[0] * 3 // 4))


def _resized(pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    way = cv2.INTER_AREA if width < pixels.shape[1] else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(np.ascontiguousarray(pixels), (width, height), interpolation=way))


_Cell = tuple[int, int, float, int, int]  # left and top in the image, scale, x and y in the sheet


def _in_cell(uv: np.ndarray | None, cell: _Cell) -> tuple[float, float] | None:
    """A pixel of the image in the sheet; None outside its cell."""
    if uv is None:
        return None
    left, top, scale, x, y = cell
    u, v = (float(uv[0]) - left) * scale, (float(uv[1]) - top) * scale
    return (x + u, y + v) if 0.0 <= u <= _CELL and 0.0 <= v <= _CELL else None


def _outline_in_cell(corners: np.ndarray | None, cell: _Cell) -> list[str]:
    """Corners of a region in the sheet, held inside its cell."""
    if corners is None:
        return []
    left, top, scale, x, y = cell
    inside = np.clip((corners - (left, top)) * scale, 0.0, _CELL) + (x, y)
    return [f"{u:.1f},{v:.1f}" for u, v in inside]


def _sheet(pixels: np.ndarray, spots: Sequence[Spot]) -> tuple[np.ndarray | None, tuple[Zoom, ...]]:
    """Surroundings of each target at the image's own resolution, side by side."""
    height, width = pixels.shape[:2]
    shown = [s for s in spots if s.centre_px is not None and np.isfinite(s.centre_px).all()][:_MOST_ZOOMS]
    if not shown:
        return None, ()
    columns = min(_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    sheet = np.full((rows * _CELL, columns * _CELL, 3), 40, np.uint8)
    zooms = []
    for k, spot in enumerate(shown):
        assert spot.centre_px is not None
        half = int(min(spot.reach_px, 0.5 * min(width, height)))
        left, top = (
            int(np.clip(round(float(c)) - half, 0, n - 2 * half)) for c, n in zip(spot.centre_px, (width, height))
        )
        x, y = (k % columns) * _CELL, (k // columns) * _CELL
        sheet[y : y + _CELL, x : x + _CELL] = _resized(
            pixels[top : top + 2 * half, left : left + 2 * half], _CELL, _CELL
        )
        cell = (left, top, _CELL / (2.0 * half), x, y)
        error = "" if spot.error_px is None else f" {spot.error_px:.2f} px"
        zooms.append(
            Zoom(
                label=f"{spot.target}{error}",
                kind=spot.kind,
                x=x,
                y=y,
                observed=_in_cell(spot.observed_px, cell),
                projected=_in_cell(spot.projected_px, cell),
                outline=" ".join(_outline_in_cell(spot.region_px, cell)),
            )
        )
    return sheet, tuple(zooms)


def _shot(
    data: CampaignData, sortie: SortieData, exposure: Exposure, spots: tuple[Spot, ...], budgets: tuple[int, int]
) -> Shot:
    sheet = data.camera
    assert sheet is not None
    bare = Shot(
        sortie=sortie.folder.number,
        strip=exposure.strip,
        image=exposure.image,
        width_px=sheet.width_px,
        height_px=sheet.height_px,
        spots=spots,
    )
    try:
        pixels, raw = _pixels(sheet, sortie, exposure)
    except TestrangeError as error:
        return replace(bare, reason=str(error))
    aspect = sheet.height_px / sheet.width_px
    width = int(np.clip(np.sqrt(budgets[0] / 0.3 / aspect), _NARROWEST, min(_WIDEST, sheet.width_px)))
    small = _resized(pixels, width, max(1, round(width * aspect)))
    cells, zooms = _sheet(pixels, spots)
    return replace(
        bare,
        uri=image_uri(_jpeg(small, budgets[0])),
        raw=raw,
        sheet_uri="" if cells is None else image_uri(_jpeg(cells, budgets[1])),
        sheet_width=0 if cells is None else cells.shape[1],
        sheet_height=0 if cells is None else cells.shape[0],
        zooms=zooms,
    )


def shots(evaluation: Evaluation) -> Iterator[Shot]:
    """Every image of every sortie, in the order of the flight; two are read at a time.

    The page's budget is divided evenly: many images become smaller ones, none is left out.
    """
    data = evaluation.data
    if data is None or data.camera is None:
        return
    found = spots_by_image(evaluation)
    jobs = [(s, e) for s in data.sorties for e in sorted(s.exposures, key=lambda e: (e.gps_time_s, e.image))]
    if not jobs:
        return
    budgets = (min(_PHOTO_BYTES, _PHOTO_BUDGET // len(jobs)), min(_ZOOM_BYTES, _ZOOM_BUDGET // len(jobs)))
    workers = min(2, os.cpu_count() or 1)
    with ThreadPoolExecutor(workers) as pool:
        rest = iter(jobs)

        def start(some: int) -> list[Future[Shot]]:
            return [
                pool.submit(_shot, data, s, e, found.get((s.folder.number, e.image), ()), budgets)
                for s, e in islice(rest, some)
            ]

        running = start(workers)
        while running:
            done = running.pop(0).result()
            running += start(1)
            yield done
