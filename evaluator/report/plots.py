"""Diagrams of the flight that need no photograph: layout, profile, residuals, correlations, truth and statement against estimate.

Reflectances and waveforms: `radiometry_plots`. Words come from `texts`.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from matplotlib.ticker import LogLocator, NullFormatter

from evaluator.c10_1_grading import INDICATORS
from evaluator.conformity.flight import acceleration, strip_windows
from evaluator.conformity.model import ConformityInputs
from evaluator.frames import WorldFrame
from evaluator.model import CampaignData, SortieData
from evaluator.mounting.diagnosis import Deviation, family_limit
from evaluator.observe.panel_images import camera_lens
from evaluator.report.style import GRADE_COLOURS, INK, arrow_limits, figure, sortie_colour
from evaluator.report.terms import parameter, short
from evaluator.report.texts import Texts
from evaluator.results import Evaluation, correlation_matrix
from evaluator.scores.score import Score

_STEP_S = 0.25  # between drawn points of a track
_GREY, _LIMIT = "#6b7280", "#b3261e"
_MAX_SPEED_M_S = {"multirotor": 16.0, "fixed_wing": 30.0}  # 7.3 a
_MAX_ACCELERATION_M_S2 = 2.5  # 7.3 c
_HEIGHT_SHARE, _HEIGHT_M = 0.05, 5.0  # 7.4 b, c
_LONGEST_ARROW = 0.25  # of the image's width
_LEAST_FIGURE = 0.3  # |correlation| from which it is printed


def _oriented(half_x: float, half_y: float, heading_deg: float) -> np.ndarray:
    """Corners (4, 2), east and north, of a rectangle about the origin whose y axis points along a heading."""
    a = np.radians(heading_deg)
    corners = np.array([[-half_x, -half_y], [half_x, -half_y], [half_x, half_y], [-half_x, half_y]])
    return np.asarray(corners @ np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]))


def _fields_of_view(axes: Axes, data: CampaignData, t: Texts) -> None:
    """Camera frame, LiDAR swath and the ±45° cone on the ground, at the lowest design height and its first heading."""
    if data.plan is None or not data.plan.strips:
        return
    low = min(data.plan.strips, key=lambda s: s.height_m)
    height, heading = low.height_m, low.heading_deg
    axes.add_patch(Circle((0, 0), height, fill=False, ls=":", lw=1.2, color=_GREY, label=t("cone", h=height)))
    if data.camera is not None:
        lens, sheet = camera_lens(data.camera), data.camera
        half = 0.5 * height * sheet.width_px / lens.fx_px, 0.5 * height * sheet.height_px / lens.fy_px
        frame = _oriented(*half, heading)
        axes.add_patch(
            Polygon(frame, closed=True, fill=True, fc="#f4b94222", ec="#b97d00", lw=1.4, label=t("camera_frame"))
        )
    if data.lidar is not None:
        left, right = (height * np.tan(np.radians(np.clip(s, -80.0, 80.0))) for s in data.lidar.sector_deg)
        a = np.radians(heading)
        along = np.array([np.sin(a), np.cos(a)]) * height * 1.3
        across = np.array([np.cos(a), -np.sin(a)])
        for k, edge in enumerate((left, right)):
            ends = np.stack([across * edge - along, across * edge + along])
            axes.plot(*ends.T, color="#7b4ea3", ls="--", lw=1.2, label=None if k else t("swath"))


def layout(data: CampaignData, t: Texts) -> Figure:
    """Plan of the range: targets, fields of view, tracks and exposures."""
    frame = WorldFrame(data.manifest)
    drawn = figure(5.3, 5.6)
    axes = drawn.add_subplot()
    _fields_of_view(axes, data, t)
    for sortie in data.sorties:
        flown = sortie.trajectory
        if flown is None or flown.gps_time_s.size < 2:
            continue
        number, colour = sortie.folder.number, sortie_colour(sortie.folder.number)
        time = np.arange(flown.gps_time_s[0], flown.gps_time_s[-1], _STEP_S)
        world = frame.world_from_geodetic(flown.latitude_rad, flown.longitude_rad, flown.ellipsoid_height_m)
        east, north = (np.interp(time, flown.gps_time_s, world[:, k]) for k in (0, 1))
        axes.plot(east, north, color=colour, lw=0.9, alpha=0.7, label=t("sortie", n=number))
        exposed = np.array([e.gps_time_s for e in sortie.exposures])
        if exposed.size:
            at = [np.interp(exposed, flown.gps_time_s, world[:, k]) for k in (0, 1)]
            axes.plot(*at, "o", ms=3, color=colour, mec="white", mew=0.4)
    for kind, marker, size, edge in (("frustum", "s", 34, _LIMIT), ("panel", "D", 22, INK), ("board", "X", 34, INK)):
        chosen = [target for target in data.targets if target.kind == kind]
        if not chosen:
            continue
        world = frame.world_from_map(np.array([[c.easting_m, c.northing_m, c.height_m] for c in chosen]))
        shade = [{"frustum": "none", "board": "#ffd54a"}.get(kind, "")] * len(chosen)
        if kind == "panel":
            shade = [str(np.clip((c.nominal_reflectance_percent or 0.0) / 100.0, 0, 1)) for c in chosen]
        x, y = world[:, 0], world[:, 1]
        axes.scatter(x, y, c=shade, marker=marker, s=size, ec=edge, lw=0.9, label=t(kind), zorder=3)
    reach = min((s.height_m for s in data.plan.strips), default=40.0) if data.plan else 40.0
    axes.set(xlim=(-1.15 * reach, 1.15 * reach), ylim=(-1.15 * reach, 1.15 * reach), aspect="equal")
    axes.set(xlabel=t("east"), ylabel=t("north"))
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3)
    return drawn


def profile(evaluation: Evaluation, data: CampaignData, sortie: SortieData, t: Texts) -> Figure | None:
    """Height above the site's origin, ground speed and acceleration of one sortie over time, with the limits of 7.3 and 7.4."""
    flown, number = sortie.trajectory, sortie.folder.number
    if flown is None or flown.gps_time_s.size < 2:
        return None
    windows = strip_windows(data, ConformityInputs(strip_window_s=evaluation.strip_window_s))
    mine = {strip: window for (owner, strip), window in windows.items() if owner == number}
    design = {s.strip: s.height_m for s in data.plan.strips if s.sortie == number} if data.plan else {}
    start = float(flown.gps_time_s[0])
    time = np.arange(start, flown.gps_time_s[-1], _STEP_S)
    height = np.interp(time, flown.gps_time_s, flown.ellipsoid_height_m - data.manifest.ellipsoid_height_m)
    speed = np.interp(time, flown.gps_time_s, np.hypot(*flown.velocity_ned_m_s[:, :2].T))
    change = acceleration(flown, slice(None))
    drawn = figure(5.3, 5.0)
    rows = drawn.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
    colour = sortie_colour(number)
    at = np.interp(time, flown.gps_time_s[flown.gps_time_s.size - change.size :], change) if change.size else None
    for axes, values in zip(rows, (height, speed, at)):
        if values is not None:
            axes.plot(time - start, values, color=colour, lw=1.1)
        for low, high in mine.values():
            axes.axvspan(low - start, max(high, low + 0.5) - start, color=colour, alpha=0.12, lw=0)
    _height_limits(rows[0], mine, design, start, t)
    kind = data.plan.aircraft_kind if data.plan else data.rig.kind if data.rig else None
    limits = ((rows[1], _MAX_SPEED_M_S.get(kind or ""), "m/s"), (rows[2], _MAX_ACCELERATION_M_S2, "m/s²"))
    for axes, limit, unit in limits:
        if limit is not None:
            axes.axhline(limit, color=_LIMIT, lw=1.0, ls="--", label=t("limit_is", v=limit, unit=unit))
            axes.legend(loc="upper right", frameon=True, framealpha=0.8, edgecolor="none")
            axes.set_ylim(0.0, 1.35 * max(limit, float(np.max(axes.lines[0].get_ydata()))))
    rows[0].set_ylabel(t("height_m"))
    rows[1].set_ylabel(t("speed"))
    rows[2].set_ylabel(t("acceleration"))
    rows[2].set_xlabel(t("time_s"))
    return drawn


def _height_limits(
    axes: Axes, windows: dict[int, tuple[float, float]], design: dict[int, float], start: float, t: Texts
) -> None:
    """Design height of each strip and how far 7.4 b and c let it go, the nearer of 5 % and 5 m."""
    named = False
    for strip, (low, high) in windows.items():
        wanted = design.get(strip)
        if wanted is None:
            continue
        reach, x = min(_HEIGHT_SHARE * wanted, _HEIGHT_M), np.array([low, max(high, low + 0.5)]) - start
        axes.plot(x, [wanted, wanted], color=INK, lw=0.9)
        for edge in (wanted - reach, wanted + reach):
            axes.plot(x, [edge, edge], color=_LIMIT, lw=1.0, ls="--", label=None if named else t("design_height"))
            named = True
    if named:
        axes.legend(loc="lower right", frameon=True, framealpha=0.8, edgecolor="none")
        wanted_all = [design[s] for s in windows if s in design]
        axes.set_ylim(min(wanted_all) - 9.0, max(wanted_all) + 9.0)


def residual_vectors(evaluation: Evaluation, t: Texts) -> Figure:
    """Residuals of formula (24) where they stand in the image, magnified, and their spread about zero."""
    observed = np.array([r.observed_px for r in evaluation.residuals]).reshape(-1, 2)
    shift = np.array([r.projected_px for r in evaluation.residuals]).reshape(-1, 2) - observed
    colours = [sortie_colour(r.sortie) for r in evaluation.residuals]
    drawn = figure(5.3, 6.4)
    upper, lower = drawn.subplots(2, 1, height_ratios=(1, 1))
    camera = evaluation.data.camera if evaluation.data else None
    size = (camera.width_px, camera.height_px) if camera else tuple(observed.max(axis=0))
    length = np.hypot(*shift.T)
    magnify = size[0] * min(0.05 / max(float(np.median(length)), 1e-6), _LONGEST_ARROW / max(float(length.max()), 1e-6))
    upper.add_patch(Rectangle((0, 0), size[0], size[1], fill=False, ec=_GREY))
    upper.quiver(*observed.T, *(shift * magnify).T, color=colours, angles="xy", scale_units="xy", scale=1, width=0.003)
    low, high = arrow_limits(size, observed + shift * magnify)
    upper.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), aspect="equal", xlabel="u [px]", ylabel="v [px]")
    upper.set_title(t("vectors", m=magnify))
    _scatter_about_zero(lower, shift, colours, np.ones(len(shift), dtype=bool))
    lower.set_title(t("projected_minus"))
    return drawn


def _scatter_about_zero(axes: Axes, shift: np.ndarray, colours: Sequence[str], used: np.ndarray) -> None:
    reach = 1.15 * max(float(np.abs(shift).max(initial=0.0)), 1e-6)
    axes.axhline(0.0, color=_GREY, lw=0.8)
    axes.axvline(0.0, color=_GREY, lw=0.8)
    faces = [c if u else "none" for c, u in zip(colours, used)]
    axes.scatter(shift[:, 0], shift[:, 1], c=faces, ec=list(colours), s=14, alpha=0.7, lw=0.8)
    axes.set(xlim=(-reach, reach), ylim=(reach, -reach), aspect="equal", xlabel="Δu [px]", ylabel="Δv [px]")


def board_residuals(evaluation: Evaluation, t: Texts) -> Figure | None:
    """Residuals of the 2x2 boards' centres about zero."""
    rows = evaluation.boards.get("residuals")
    if not isinstance(rows, list | tuple) or not rows:
        return None
    shift = np.array([[r["du_px"], r["dv_px"]] for r in rows], dtype=np.float64)
    drawn = figure(5.3, 4.6)
    axes = drawn.add_subplot()
    colours = [sortie_colour(r["sortie"]) for r in rows]
    _scatter_about_zero(axes, shift, colours, np.array([bool(r["used"]) for r in rows]))
    for number in sorted({r["sortie"] for r in rows}):
        axes.plot([], [], "o", color=sortie_colour(number), label=t("sortie", n=number))
    drawn.legend(loc="outside lower center", ncols=6)
    axes.set_title(t("observed_minus"))
    return drawn


def target_errors(evaluation: Evaluation, t: Texts) -> Figure | None:
    """P_i of each target as adjusted and held out, against table 3."""
    companions = evaluation.indicator("calibration_error").companions
    adjusted, held = companions.get("per_target_px"), companions.get("held_out_per_target_px")
    if not isinstance(adjusted, dict) or not adjusted:
        return None
    names = sorted(adjusted)
    drawn = figure(5.3, 3.4)
    axes = drawn.add_subplot()
    place = np.arange(len(names))
    axes.bar(place, [adjusted[n] for n in names], color="#1b6ca8", width=0.7, alpha=0.85, label=t("adjusted"))
    if isinstance(held, dict):
        known = [k for k, n in enumerate(names) if held.get(n) is not None]
        axes.plot(known, [held[names[k]] for k in known], "o", mfc="white", mec=INK, ms=4.5, label=t("held_out"))
    top = axes.get_ylim()[1]
    for bound, grade in zip(INDICATORS["calibration_error"].bounds, ("excellent", "good", "fair")):
        if bound < 2.5 * top:
            axes.axhline(bound, color=GRADE_COLOURS[grade], lw=1.0, ls="--")  # type: ignore[index]
    axes.grid(False, axis="x")
    axes.set_xticks(place, names, rotation=90)
    axes.set(ylabel="P_i [px]", xlim=(-0.7, len(names) - 0.3))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.14), ncols=2)
    return drawn


def correlation_figure(
    matrix: np.ndarray, names: Sequence[str], least: float = _LEAST_FIGURE, height_in: float = 5.0
) -> Figure:
    """A correlation matrix with figures where |correlation| is above `least`."""
    drawn = figure(5.3, height_in)
    axes = drawn.add_subplot()
    picture = axes.imshow(matrix, vmin=-1, vmax=1, cmap="RdBu_r")
    axes.set_xticks(range(len(names)), names, rotation=90)
    axes.set_yticks(range(len(names)), names)
    axes.grid(False)
    for i, j in zip(*np.nonzero(np.abs(np.tril(matrix, -1)) > least)):
        colour = "white" if abs(matrix[i, j]) > 0.6 else INK
        text = f"{matrix[i, j]:.2f}".replace("0.", ".", 1)
        axes.text(j, i, text, ha="center", va="center", fontsize=6.5, color=colour)
    drawn.colorbar(picture, ax=axes, shrink=0.7, pad=0.02)
    return drawn


def correlations(evaluation: Evaluation, t: Texts) -> Figure | None:
    """Correlation matrix of the mounting parameters, and of the clocks where they were estimated."""
    solution = evaluation.mounting
    if solution is None:
        return None
    return correlation_figure(correlation_matrix(solution.covariance), [short(n, t.language) for n in solution.names])


def block_correlations(block: object, t: Texts) -> Figure | None:
    """The same of a block of results.json with `names` and `correlation` or `covariance`."""
    if not isinstance(block, dict) or "names" not in block:
        return None
    matrix = block.get("correlation")
    if matrix is None and block.get("covariance") is not None:
        matrix = correlation_matrix(np.array(block["covariance"], dtype=np.float64))
    if matrix is None:
        return None
    return correlation_figure(
        np.array(matrix, dtype=np.float64), [short(n, t.language) for n in block["names"]], 0.1, 4.4
    )


def truth_errors(score: Score, t: Texts) -> Figure | None:
    """Error of each estimate in units of its stated standard deviation."""
    items = [i for i in score.items if i.z is not None]
    if not items:
        return None
    drawn = figure(5.3, 0.24 * len(items) + 0.9)
    axes = drawn.add_subplot()
    z = np.array([i.z for i in items], dtype=float)
    place = np.arange(len(items))[::-1]
    axes.axvspan(-2, 2, color="#1a7f4b", alpha=0.12, lw=0)
    axes.axvline(0, color=_GREY, lw=0.8)
    axes.hlines(place, 0, z, color="#1b6ca8", lw=1.4)
    axes.plot(z, place, "o", color="#1b6ca8", ms=4)
    axes.set_yticks(place, [parameter(i.quantity, t.language) for i in items])
    reach = max(3.0, 1.1 * float(np.abs(z).max()))
    axes.set(xlim=(-reach, reach), ylim=(-0.7, len(items) - 0.3), xlabel=t("z_axis"))
    axes.set_title(t("truth_title"))
    return drawn


def deviation_bars(rows: Sequence[Deviation], t: Texts) -> Figure | None:
    """|z| of every parameter against what was stated of it, and the limit for all together."""
    if not rows:
        return None
    limit = family_limit(len(rows))
    size = np.maximum(np.abs([r.z for r in rows]), 0.05)
    drawn = figure(5.3, 0.24 * len(rows) + 0.8)
    axes = drawn.add_subplot()
    place = np.arange(len(rows))[::-1]
    axes.barh(place, size, left=0.04, color=[_LIMIT if s > limit else "#1b6ca8" for s in size], height=0.62, alpha=0.85)
    axes.axvline(limit, color=INK, ls="--", lw=1.0)
    axes.set_yticks(place, [parameter(r.quantity, t.language) for r in rows])
    axes.set_xscale("log")
    axes.set(xlim=(0.04, 2.0 * max(10.0, float(size.max()))), ylim=(-0.7, len(rows) - 0.3), xlabel=t("abs_z"))
    axes.xaxis.set_major_locator(LogLocator(numticks=8))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(False, axis="y")
    return drawn
