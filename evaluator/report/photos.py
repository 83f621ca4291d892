"""The composite picture of a run, for a README: an image with its targets, zooms, waveforms, reflectances and grades.

The page's own images are made in `overlays`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from campaign.errors import TestrangeError
from campaign.flight.images import read_preview
from evaluator.c10_1_grading import GRADE_ZH, INDICATORS
from evaluator.documents.model import printed_unit
from evaluator.model import CampaignData
from evaluator.report.radiometry_plots import draw_reflectance, draw_waveform
from evaluator.report.style import GRADE_COLOURS, INK, figure, style
from evaluator.report.texts import Texts
from evaluator.results import Evaluation, Residual, shown_decimals

_REGION = "#ffd54a"
_PANEL = "#5ad1ff"
_PROJECTED = "#ff4d4d"


@dataclass(frozen=True, kw_only=True)
class Photo:
    """One image of the campaign as its 8-bit preview."""

    sortie: int
    image: str
    pixels: np.ndarray  # (height, width, 3) uint8


def choose_images(evaluation: Evaluation) -> list[tuple[int, str]]:
    """For each sortie the image in which most targets were observed."""
    seen: dict[tuple[int, str], set[str]] = {}
    observed = [(r.sortie, r.image, r.target) for r in evaluation.regions]
    observed += [(r.sortie, r.image, r.target) for r in evaluation.residuals]
    observed += [(m.sortie, m.image, m.target) for m in evaluation.marks]
    for sortie, image, target in observed:
        seen.setdefault((sortie, image), set()).add(target)
    best: dict[int, tuple[int, str]] = {}
    for (sortie, image), targets in sorted(seen.items()):
        if len(targets) > best.get(sortie, (0, ""))[0]:
            best[sortie] = (len(targets), image)
    return [(sortie, image) for sortie, (_, image) in sorted(best.items())]


def load_photo(data: CampaignData, sortie: int, image: str) -> Photo:
    """The preview beside an image.

    Raises
    ------
    TestrangeError
        No camera sheet, no such sortie, or a preview that is missing or of another size.
    """
    folder = next((s.folder for s in data.sorties if s.folder.number == sortie), None)
    if data.camera is None or folder is None:
        raise TestrangeError("its camera sheet or sortie is not in the campaign", where=image)
    path = (folder.images / image).with_suffix(".jpg")
    pixels = read_preview(path, width_px=data.camera.width_px, height_px=data.camera.height_px)
    return Photo(sortie=sortie, image=image, pixels=pixels)


def _reduced(pixels: np.ndarray, width: int) -> np.ndarray:
    """The image at `width` columns by area means; never enlarged."""
    if pixels.shape[1] <= width:
        return pixels
    size = (width, max(1, round(pixels.shape[0] * width / pixels.shape[1])))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))


def draw_photo(axes: Axes, photo: Photo, evaluation: Evaluation, width: int, labels: bool = True) -> None:
    """The image in its own pixel coordinates (top left corner (0, 0)) with regions, marks and reprojections."""
    height_px, width_px = photo.pixels.shape[:2]
    axes.imshow(_reduced(photo.pixels, width), extent=(0, width_px, height_px, 0), interpolation="nearest")
    key = (photo.sortie, photo.image)
    kinds = {t.id: t.kind for t in evaluation.data.targets} if evaluation.data else {}
    for region in evaluation.regions:
        if (region.sortie, region.image) == key:
            colour = _PANEL if kinds.get(region.target) == "panel" else _REGION
            axes.add_patch(Polygon(region.corners_px, closed=True, fill=False, ec=colour, lw=0.9))
            if labels:
                u, v = region.corners_px[:, 0].max(), region.corners_px[:, 1].min()
                axes.text(u, v, region.target, color=colour, fontsize=6, va="bottom")
    marks = np.array([m.uv_px for m in evaluation.marks if (m.sortie, m.image) == key]).reshape(-1, 2)
    axes.plot(*marks.T, "o", mfc="none", mec=_REGION, ms=6, mew=0.9)
    projected = np.array([r.projected_px for r in evaluation.residuals if (r.sortie, r.image) == key]).reshape(-1, 2)
    axes.plot(*projected.T, "+", color=_PROJECTED, ms=6, mew=0.9)
    axes.set(xlim=(0, width_px), ylim=(height_px, 0))
    axes.set_axis_off()


def draw_zoom(axes: Axes, photo: Photo, residual: Residual, half_px: int) -> None:
    """The surroundings of one mark at full resolution: mark as observed (circle), vertex as projected (cross)."""
    height, width = photo.pixels.shape[:2]
    u, v = residual.observed_px
    left, top = (
        int(np.clip(round(float(c)) - half_px, 0, max(n - 2 * half_px, 0))) for c, n in ((u, width), (v, height))
    )
    part = photo.pixels[top : top + 2 * half_px, left : left + 2 * half_px]
    axes.imshow(part, extent=(left, left + part.shape[1], top + part.shape[0], top), interpolation="nearest")
    axes.plot(u, v, "o", mfc="none", mec=_REGION, ms=9, mew=1.3)
    axes.plot(*residual.projected_px, "+", color=_PROJECTED, ms=11, mew=1.3)
    axes.set(xlim=(left, left + part.shape[1]), ylim=(top + part.shape[0], top))
    axes.set_axis_off()
    axes.set_title(f"{residual.target}  {residual.error_px:.2f} px", fontsize=8)


def _half_window(evaluation: Evaluation, residuals: Sequence[Residual]) -> int:
    """About three times the radius of the marks, 16 px at least."""
    names = {r.target for r in residuals}
    radii = [m.radius_px for m in evaluation.marks if m.target in names]
    return int(max(16.0, 3.0 * float(np.median(radii)))) if radii else 30


def _grades(axes: Axes, evaluation: Evaluation) -> None:
    """The measured indicators as a short table."""
    axes.set_axis_off()
    axes.set(xlim=(0, 1), ylim=(0, 1))
    measured = [i for i in INDICATORS if evaluation.indicator(i).value is not None]
    for k, i in enumerate(measured):
        row, found, mark = INDICATORS[i], evaluation.indicator(i), evaluation.grade(i)
        y = 1.0 - (k + 0.6) / max(len(measured), 1)
        unit = printed_unit(row.unit)
        value = f"{found.value:.{shown_decimals(found.value, row.unit)}f} {unit}"
        axes.text(0.0, y, f"{row.name_zh} {row.symbol}", fontsize=9, va="center", color=INK)
        axes.text(0.86, y, value, fontsize=9, va="center", ha="right", color=INK)
        axes.text(
            0.91,
            y,
            GRADE_ZH[mark],
            fontsize=9,
            va="center",
            color="white",
            bbox={"boxstyle": "round,pad=0.25", "fc": GRADE_COLOURS[mark], "ec": "none"},
        )


def hero_picture(path: Path, evaluation: Evaluation) -> None:
    """One picture of a run: an image with its targets, zooms, waveforms, reflectances and grades. PNG or JPEG by the suffix.

    Raises
    ------
    TestrangeError
        No image of the campaign can be shown.
    """
    data = evaluation.data
    chosen = choose_images(evaluation)
    if data is None or not chosen:
        raise TestrangeError("no image with observed targets to show", where=evaluation.campaign)
    photo = load_photo(data, *chosen[0])
    with style():
        drawn = figure(12.0, 8.2)
        grid = drawn.add_gridspec(3, 4, height_ratios=(2.15, 2.15, 2.1))
        main = drawn.add_subplot(grid[:2, :3])
        draw_photo(main, photo, evaluation, 1000, labels=False)
        main.set_title(
            f"{evaluation.campaign}: {photo.image}, sortie {photo.sortie}; yellow: marks found, red: LiDAR vertices "
            f"projected, blue: panels",
            fontsize=9,
        )
        known = sorted((r for r in evaluation.residuals if (r.sortie, r.image) == chosen[0]), key=lambda r: r.error_px)
        grades = drawn.add_subplot(grid[0, 3])
        _grades(grades, evaluation)
        grades.set_title("simulated campaign" if evaluation.synthetic else "")
        reflectance = drawn.add_subplot(grid[1, 3])
        draw_reflectance(reflectance, evaluation, Texts("en"))
        row = grid[2, :].subgridspec(1, 5)
        places = [drawn.add_subplot(row[0, k]) for k in range(5)]
        near = [known[len(known) // 2], known[-1]] if known else []
        for axes, residual in zip(places, near):
            draw_zoom(axes, photo, residual, _half_window(evaluation, near))
        examples = evaluation.waveforms
        spread = [examples[int(i)] for i in np.unique(np.linspace(0, len(examples) - 1, 3).round())] if examples else []
        for axes, example in zip(places[len(near) :], spread):
            draw_waveform(axes, example)
            axes.set_xlabel("time [ns]")
        for axes in places[len(near) + len(spread) :]:
            axes.set_axis_off()
        kind = path.suffix.lower().lstrip(".")
        options: dict[str, Any] = (
            {"pil_kwargs": {"quality": 88}} if kind in ("jpg", "jpeg") else {"metadata": {"Software": None}}
        )
        drawn.savefig(path, dpi=120, **options)
