"""Diagrams of the benches and the ranging line: sphere series, chessboard residuals, coverage, distortion, ranging errors."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from evaluator.benches.bench_model import BoardImage, ChessboardResult, RangingResult, SphereResult, SphereSeries
from evaluator.camera_model import LENS_NAMES, undistort
from evaluator.report.style import INK, SORTIE_COLOURS, arrow_limits, figure
from evaluator.report.texts import Texts
from evaluator.results import correlation_matrix

_GREY = "#6b7280"
_BAND_COLOURS = {"red": "#c0392b", "green": "#2e8b57", "blue": "#1b6ca8"}
_VECTORS = 900  # drawn at most; all are in the means and in the scatter
_LONGEST_ARROW = 0.25  # of the image's width
_MAP_STEPS = 60
_CORNERS_OF_A_MEAN = 5  # fewer are noise, not a mean
_ENGLISH = Texts("en")


def _colour(index: int) -> str:
    return SORTIE_COLOURS[index % len(SORTIE_COLOURS)]


def _band_colour(name: str, index: int) -> str:
    return _BAND_COLOURS.get(name.lower(), _colour(index))


def _draw_series(axes: Axes, series: SphereSeries, band: int, trend: bool, t: Texts) -> None:
    """One band relative to its mean, with one standard deviation either way. [%]"""
    minutes = np.asarray(series.time_s) / 60.0
    values = np.asarray(series.dn)[:, band]
    mean = float(values.mean())
    if not mean > 0.0:
        axes.set_title(t("band_black", band=series.bands[band], dn=mean), fontsize=8)
        return
    relative = 100.0 * (values / mean - 1.0)
    spread = float(relative.std(ddof=1)) if relative.size > 1 else 0.0
    colour = _band_colour(series.bands[band], band)
    axes.axhspan(-spread, spread, color=colour, alpha=0.12, lw=0)
    axes.axhline(0.0, color=_GREY, lw=0.8)
    axes.plot(minutes, relative, "o-", color=colour, ms=2.5, lw=0.7)
    title = f"{series.bands[band]}: {mean:.1f} DN, SD {spread:.3f} %"
    if trend and minutes.size > 2:
        slope, offset = np.polyfit(minutes, relative, 1)
        axes.plot(minutes, slope * minutes + offset, "--", color=INK, lw=1.0)
        title += "\n" + t("trend", slope=60.0 * slope)
    axes.set_title(title, fontsize=8)
    axes.tick_params(labelsize=7)


def sphere_series(result: SphereResult, t: Texts = _ENGLISH) -> Figure | None:
    """Both series at the integrating sphere over time, a row for each band, and the lamp's trend in the longer one."""
    shown = [
        (series, title, trend)
        for series, title, trend in (
            (result.stability_series, t("stability"), True),
            (result.repeatability_series, t("repeatability"), False),
        )
        if series is not None and np.size(series.dn)
    ]
    if not shown:
        return None
    rows = max(len(series.bands) for series, _, _ in shown)
    drawn = figure(5.3, 0.5 + 1.7 * rows)
    columns = drawn.subfigures(1, len(shown), squeeze=False)[0]
    for column, (series, title, trend) in zip(columns, shown):
        column.suptitle(title, fontsize=10)
        grid = column.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        for band, axes in enumerate(grid):
            if band < len(series.bands):
                _draw_series(axes, series, band, trend, t)
            else:
                axes.set_axis_off()
        grid[len(series.bands) - 1].set_xlabel(t("time_min"), fontsize=8)
        grid[len(series.bands) // 2].set_ylabel(t("dn_minus_mean"), fontsize=8)
    return drawn


def _distance(result: ChessboardResult, position: int, t: Texts) -> str:
    """A position of the board by its distance, else by its number."""
    known = position < len(result.distances_m)
    return f"{result.distances_m[position]:.2f} m" if known else t("position", n=position + 1)


def _residuals(images: tuple[BoardImage, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of all corners: where they are seen (n, 2), projected minus observed (n, 2) [px], position (n,)."""
    observed = np.concatenate([np.asarray(i.observed_px).reshape(-1, 2) for i in images])
    projected = np.concatenate([np.asarray(i.projected_px).reshape(-1, 2) for i in images])
    position = np.concatenate([np.full(len(np.asarray(i.observed_px)), i.position) for i in images])
    return observed, projected - observed, position


def _frame(axes: Axes, size_px: tuple[float, float]) -> None:
    """The image's border and axes, v down."""
    width, height = size_px
    axes.add_patch(Rectangle((0, 0), width, height, fill=False, ec=_GREY))
    pad = 0.02 * max(width, height)
    axes.set(xlim=(-pad, width + pad), ylim=(height + pad, -pad), aspect="equal", xlabel="u [px]", ylabel="v [px]")


def _size(result: ChessboardResult) -> tuple[float, float]:
    if result.image_size_px is not None:
        return float(result.image_size_px[0]), float(result.image_size_px[1])
    width, height = np.max([np.asarray(i.observed_px).max(axis=0) for i in result.images], axis=0)
    return float(width), float(height)


def _cell_means(observed: np.ndarray, shift: np.ndarray, size: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Mean residual of each cell of the field, (m, 2), at the cell's middle: what is left that noise does not explain."""
    shape = np.array([16, max(1, round(16 * size[1] / size[0]))])
    cell = np.clip((observed / size * shape).astype(int), 0, shape - 1)
    index = cell[:, 1] * shape[0] + cell[:, 0]
    count = np.bincount(index, minlength=int(shape.prod()))
    total = np.stack([np.bincount(index, s, minlength=int(shape.prod())) for s in shift.T], axis=1)
    seen = count >= _CORNERS_OF_A_MEAN
    centre = np.stack([np.arange(count.size) % shape[0], np.arange(count.size) // shape[0]], axis=1) + 0.5
    return (centre / shape * size)[seen], total[seen] / count[seen, None]


def board_residuals(result: ChessboardResult, t: Texts = _ENGLISH) -> Figure | None:
    """Residual vectors of the corners over the field, and their scatter about zero; one colour a distance."""
    if not result.images:
        return None
    observed, shift, position = _residuals(result.images)
    size = _size(result)
    keep = np.linspace(0, len(observed) - 1, min(len(observed), _VECTORS)).astype(int)
    length = np.hypot(*shift.T)
    most = min(0.02 / max(float(np.median(length)), 1e-9), _LONGEST_ARROW / max(float(length[keep].max()), 1e-9))
    magnify = float(f"{most * size[0]:.2g}")
    drawn = figure(5.3, 6.6)
    upper, lower = drawn.subplots(2, 1, height_ratios=(1, 1))
    _frame(upper, size)
    colours = np.array([_colour(p) for p in range(int(position.max()) + 1)])[position]
    arrows = {"angles": "xy", "scale_units": "xy", "scale": 1}
    upper.quiver(*observed[keep].T, *(shift[keep] * magnify).T, color=colours[keep], alpha=0.6, width=0.002, **arrows)
    centre, mean = _cell_means(observed, shift, size)
    upper.quiver(*centre.T, *(mean * magnify).T, color=INK, width=0.004, **arrows)
    low, high = arrow_limits(size, (observed + shift * magnify)[keep], centre + mean * magnify)
    upper.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
    upper.set_title(t("cell_vectors", m=magnify), fontsize=9)
    reach = 1.1 * max(float(np.quantile(length, 0.999)), 1e-9)
    lower.axhline(0.0, color=_GREY, lw=0.8)
    lower.axvline(0.0, color=_GREY, lw=0.8)
    for p in np.unique(position):
        of = position == p
        at = _distance(result, int(p), t)
        lower.plot(*shift[of].T, ".", ms=2, color=_colour(int(p)), alpha=0.5, label=at, rasterized=True)
    lower.set(xlim=(-reach, reach), ylim=(reach, -reach), aspect="equal", xlabel="Δu [px]", ylabel="Δv [px]")
    lower.set_title(t("projected_distance"))
    lower.xaxis.set_major_locator(MaxNLocator(5))
    lower.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), markerscale=4)
    return drawn


def coverage(result: ChessboardResult, t: Texts = _ENGLISH) -> Figure | None:
    """Corners in each cell of the field, one map a distance (9.2.2 d); a cell without any is marked."""
    if result.coverage is None or not np.size(result.coverage):
        return None
    counts = np.asarray(result.coverage)
    size = _size(result) if result.images or result.image_size_px else (float(counts.shape[2]), float(counts.shape[1]))
    columns = 2 if len(counts) > 1 else 1
    rows = -(-len(counts) // columns)
    drawn = figure(5.3, 0.5 + rows * (0.35 + 4.1 / columns * size[1] / size[0]))
    top = max(float(counts.max()), 1.0)
    grid = np.atleast_1d(drawn.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)).ravel()
    for k, axes in enumerate(grid):
        if k >= len(counts):
            axes.set_axis_off()
            continue
        picture = axes.imshow(
            counts[k], vmin=0, vmax=top, cmap="Blues", extent=(0, size[0], size[1], 0), aspect="equal"
        )
        cell = np.array(size) / counts.shape[2:0:-1]
        for i, j in zip(*np.nonzero(counts[k] == 0)):
            axes.add_patch(Rectangle((j * cell[0], i * cell[1]), *cell, fill=False, hatch="///", ec="#b3261e", lw=0))
        axes.grid(False)
        seen = int((counts[k] > 0).sum())
        axes.set_title(t("cells", at=_distance(result, k, t), seen=seen, all=counts[k].size), fontsize=9)
        axes.tick_params(labelsize=7)
    drawn.colorbar(picture, ax=list(grid), shrink=0.7, label=t("corners_in_cell"))
    drawn.suptitle(t("hatched"), fontsize=10, x=0.02, ha="left")
    return drawn


def distortion_map(result: ChessboardResult, t: Texts = _ENGLISH) -> Figure | None:
    """How far the estimated lens moves an image point from where a distortion-free one puts it. [px]"""
    if result.lens is None or (result.image_size_px is None and not result.images):
        return None
    width, height = _size(result)
    step = max(width, height) / _MAP_STEPS
    u, v = np.meshgrid(np.arange(step / 2, width, step), np.arange(step / 2, height, step))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    lens = result.lens
    try:
        with np.errstate(all="ignore"):
            ideal = undistort(lens, uv) * (lens.fx_px, lens.fy_px) + (lens.cx_px, lens.cy_px)
    except np.linalg.LinAlgError:  # the polynomial folds back exactly on a point of the grid
        return None
    shift = (uv - ideal).reshape(*u.shape, 2)
    amount = np.hypot(shift[..., 0], shift[..., 1])
    reached = amount < max(width, height)  # beyond it the polynomial has folded back and no ray belongs to the point
    if not reached.any():
        return None
    amount[~reached], shift[~reached] = np.nan, np.nan
    drawn = figure(5.3, 0.8 + 3.7 * height / width)
    axes = drawn.add_subplot()
    picture = axes.pcolormesh(u, v, amount, shading="nearest", cmap="viridis", rasterized=True)
    if np.isfinite(amount).all() and np.ptp(amount) > 0.0:
        lines = axes.contour(u, v, amount, levels=6, colors="white", linewidths=0.6)
        axes.clabel(lines, fontsize=7, fmt="%.3g")
    axes.plot(lens.cx_px, lens.cy_px, "+", color="white", ms=9, mew=1.4)
    some = (slice(2, None, 6), slice(2, None, 6))
    axes.quiver(u[some], v[some], shift[some][..., 0], shift[some][..., 1], color="white", angles="xy", width=0.003)
    _frame(axes, (width, height))
    axes.grid(False)
    axes.set_title(t("distortion_title"))
    drawn.colorbar(picture, ax=axes, shrink=0.8, label=t("distorted_ideal"))
    return drawn


def lens_correlations(result: ChessboardResult, t: Texts = _ENGLISH) -> Figure | None:
    """Correlation matrix of the nine parameters of the camera."""
    if result.covariance is None:
        return None
    matrix = correlation_matrix(np.asarray(result.covariance))
    drawn = figure(5.3, 4.6)
    axes = drawn.add_subplot()
    picture = axes.imshow(matrix, vmin=-1, vmax=1, cmap="RdBu_r")
    names = [n.removesuffix("_px") for n in LENS_NAMES]
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.grid(False)
    for i, j in zip(*np.nonzero(np.abs(np.tril(matrix, -1)) > 0.1)):
        colour = "white" if abs(matrix[i, j]) > 0.6 else INK
        axes.text(j, i, f"{matrix[i, j]:.2f}", ha="center", va="center", fontsize=7, color=colour)
    axes.set_title(t("p_lens_correlations"))
    drawn.colorbar(picture, ax=axes, shrink=0.8)
    return drawn


def image_errors(result: ChessboardResult, t: Texts = _ENGLISH) -> Figure | None:
    """Root mean square of the reprojection error of every accepted image, in the order of the log."""
    if not result.images:
        return None
    values = np.array([np.sqrt(np.mean(np.square(i.error_px))) for i in result.images])
    colours = [_colour(i.position) for i in result.images]
    drawn = figure(5.3, 3.2)
    axes = drawn.add_subplot()
    axes.bar(np.arange(len(values)) + 1, values, color=colours, width=0.8)
    if result.indicator.value is not None:
        axes.axhline(result.indicator.value, color=INK, ls="--", lw=1.0)
        axes.plot([], [], "--", color=INK, lw=1.0, label=t("mean_of_norms", m=result.indicator.value))
    for p in sorted({i.position for i in result.images}):
        at = _distance(result, p, t)
        axes.plot([], [], "s", color=_colour(p), label=at)
    axes.grid(False, axis="x")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel=t("accepted_image"), ylabel="RMS [px]", xlim=(0.3, len(values) + 0.7), ylim=(0, None))
    axes.set_title(t("image_errors"))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3)
    return drawn


def ranging_errors(result: RangingResult, t: Texts = _ENGLISH) -> Figure | None:
    """LiDAR minus total station over the distance, bars of one standard deviation of both.

    Above what the LiDAR reads minus the station that K2 and R2 come from, with their line; a panel that they leave out is hollow.
    Below the corrected ranges minus the relative true values.
    """
    if not any(p.correction_m is not None or p.reference_m is not None for p in result.panels):
        return None
    names, noise = (result.indicator.companions.get(k) for k in ("stations", "reading_std_m"))
    drawn = figure(5.3, 5.4)
    upper, lower = drawn.subplots(2, 1, sharex=True)
    for axes, use, value, colour, title in (
        (upper, "correction", "lidar_m", "#d1603d", t("before")),
        (lower, "reference", "corrected_m", "#1b6ca8", t("after")),
    ):
        known = [p for p in result.panels if getattr(p, f"{use}_m") is not None and getattr(p, value) is not None]
        station = names.get(use, "total station") if isinstance(names, dict) else t("total_station")
        reading = float(noise.get(use, 0.0)) if isinstance(noise, dict) else 0.0
        axes.set_title(f"{title}: {t('lidar')} − {station}")
        axes.set_ylabel(t("difference_mm"))
        if not known:
            continue
        truth = np.array([getattr(p, f"{use}_m") for p in known], dtype=float)
        difference = 1000.0 * (np.array([getattr(p, value) for p in known], dtype=float) - truth)
        lidar = np.array([p.lidar_std_m / np.sqrt(max(p.scans, 1)) for p in known])
        by_station = reading / np.sqrt([max(getattr(p, f"{use}_readings"), 1) for p in known])
        error = 1000.0 * np.hypot(lidar, by_station)
        axes.errorbar(truth, difference, yerr=error, fmt="o", color=colour, ms=4, capsize=3, lw=1.0)
        out = np.array([p.panel in result.not_used for p in known])
        axes.plot(truth[out], difference[out], "o", color=colour, mfc="white", ms=4, zorder=3)
        for p, x, y in zip(known, truth, difference):
            if axes is lower or p.panel in result.not_used:
                axes.annotate(p.panel, (x, y), xytext=(5, 4), textcoords="offset points", fontsize=7, color=_GREY)
    lower.axhline(0.0, color=_GREY, lw=0.8)
    if result.additive_constant_m is not None and result.multiplication_constant is not None:
        span = np.array([0.0, 1.05 * max(p.lidar_m for p in result.panels)])
        line = -1000.0 * (result.additive_constant_m + result.multiplication_constant * span)
        upper.plot(span, line, "--", color=_GREY, lw=1.0, label="−K₂ − R₂ L")
        upper.legend(loc="best")
    lower.set_xlabel(t("distance"))
    return drawn
