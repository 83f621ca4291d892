"""Diagrams of 8.1 and 8.3: waveforms, the surface f(A, L), LiDAR against camera reflectance. Words come from `texts`."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from evaluator.c8_1_lidar_reflectance import ReflectanceSurface
from evaluator.report.style import figure
from evaluator.report.texts import Texts
from evaluator.results import Evaluation, WaveformExample

_GREY = "#6b7280"
_STEPS = 60  # of a surface, each way
_LEVELS = (5, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100)


def draw_waveform(axes: Axes, example: WaveformExample) -> None:
    """Samples as dots, the decomposition as a line."""
    axes.plot(example.fit_time_ns, example.fit_dn, color="#d1603d", lw=1.4)
    axes.plot(example.time_ns, example.samples_dn, ".", color="#1b6ca8", ms=4)
    axes.set_title(example.label, fontsize=9)


def waveforms(examples: tuple[WaveformExample, ...], t: Texts) -> Figure:
    """Received waveforms and their fits, one panel of each reflectance."""
    shown = examples[:6]
    rows = (len(shown) + 1) // 2
    drawn = figure(5.3, 1.5 * rows + 0.4)
    for k, example in enumerate(shown):
        axes = drawn.add_subplot(rows, 2, k + 1)
        draw_waveform(axes, example)
        if k % 2 == 0:
            axes.set_ylabel("DN")
        if k >= len(shown) - 2:
            axes.set_xlabel(t("time_ns"))
    return drawn


def draw_reflectance(axes: Axes, evaluation: Evaluation, t: Texts) -> None:
    """R1 against R2 of every panel, with the line of equality."""
    both = [p for p in evaluation.panels if p.lidar_percent is not None and p.camera_percent is not None]
    x, y = np.array([[p.camera_percent, p.lidar_percent] for p in both], dtype=float).reshape(-1, 2).T
    top = max(105.0, *x, *y) if both else 105.0
    axes.plot([0, top], [0, top], color=_GREY, lw=1, ls="--")
    axes.plot(x, y, "o", color="#1b6ca8", ms=5, mec="white", mew=0.6)
    axes.set(xlabel=t("camera_r2"), ylabel=t("lidar_r1"), aspect="equal", xlim=(0, top), ylim=(0, top))


def reflectance(evaluation: Evaluation, t: Texts) -> Figure:
    """LiDAR against camera, and both minus the spectrometer."""
    drawn = figure(5.3, 6.0)
    upper, lower = drawn.subplots(2, 1, height_ratios=(3, 2))
    draw_reflectance(upper, evaluation, t)
    upper.set_title(t("lidar_camera"))
    laser = [(p.lidar_percent, p.laser_reference_percent) for p in evaluation.panels]
    band = [(p.camera_percent, p.band_reference_percent) for p in evaluation.panels]
    for colour, name, pairs in (("#7b4ea3", "lidar_minus", laser), ("#b97d00", "camera_minus", band)):
        known = np.array([(r, v - r) for v, r in pairs if v is not None and r is not None]).reshape(-1, 2)
        lower.plot(*known.T, "o", ms=4, color=colour, alpha=0.8, label=t(name))
    lower.axhline(0.0, color=_GREY, lw=1)
    lower.set(xlabel=t("spectrometer"), ylabel=t("difference_percent"))
    lower.legend(loc="upper center", bbox_to_anchor=(0.5, -0.3))
    return drawn


def _surface(table: dict[str, Any]) -> ReflectanceSurface:
    return ReflectanceSurface(
        coefficients=np.array(table["coefficients"], dtype=np.float64),
        amplitude_centre=float(table["amplitude_centre"]),
        amplitude_scale=float(table["amplitude_scale"]),
        range_centre_m=float(table["range_centre_m"]),
        range_scale_m=float(table["range_scale_m"]),
    )


def surfaces(evaluation: Evaluation, t: Texts) -> Figure | None:
    """The fitted f(A, L) of every design height with the panels, and what is left at the panels."""
    tables = evaluation.indicator("lidar_reflectance_rmse").companions.get("surfaces")
    if not isinstance(tables, list) or not tables:
        return None
    columns = min(2, len(tables))
    rows = -(-len(tables) // columns)
    drawn = figure(5.3, 2.7 * rows + 2.2)
    upper, lower = drawn.subfigures(2, 1, height_ratios=(2.7 * rows, 2.0), squeeze=False)[:, 0]
    grid = np.atleast_1d(upper.subplots(rows, columns, squeeze=False)).ravel()
    below = lower.subplots()
    picture = None
    for k, (axes, table) in enumerate(zip(grid, tables)):
        a, l = np.array(table["amplitude_dn"], dtype=float), np.array(table["range_m"], dtype=float)
        reference = np.array(table["reference_percent"], dtype=float)
        surface = _surface(table)
        edges = [np.linspace(v.min() - 0.05 * np.ptp(v), v.max() + 0.05 * np.ptp(v), _STEPS) for v in (a, l)]
        mesh = np.meshgrid(*edges)
        value = surface(*mesh)
        picture = axes.pcolormesh(*mesh, value, vmin=0, vmax=105, cmap="viridis", shading="nearest", rasterized=True)
        if np.ptp(value) > 0.0:
            lines = axes.contour(*mesh, value, levels=_LEVELS, colors="white", linewidths=0.6, alpha=0.8)
            axes.clabel(lines, fontsize=6, fmt="%g")
        axes.scatter(a, l, c=reference, vmin=0, vmax=105, cmap="viridis", s=16, ec="white", lw=0.7, zorder=3)
        axes.set_title(t("surface_at", h=float(table["design_height_m"])), fontsize=9)
        axes.grid(False)
        if k % columns == 0:
            axes.set_ylabel(t("range"))
        if k >= len(tables) - columns:
            axes.set_xlabel(t("amplitude"))
        label = t("surface_at", h=float(table["design_height_m"]))
        below.plot(reference, surface(a, l) - reference, ".", ms=5, alpha=0.6, label=label)
    for axes in grid[len(tables) :]:
        axes.set_axis_off()
    if picture is not None:
        upper.colorbar(picture, ax=list(grid), shrink=0.8, label=t("reflectance_percent"))
    below.axhline(0.0, color=_GREY, lw=0.8)
    below.set(xlabel=t("spectrometer"), ylabel=t("surface_minus"))
    below.legend(loc="upper center", bbox_to_anchor=(0.5, -0.3), ncols=2)
    return drawn
