"""Diagrams that need no photograph: layout, profile, waveforms, reflectance, residuals, correlations, truth against estimate."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

from evaluator.conformity.flight import strip_windows
from evaluator.conformity.model import ConformityInputs
from evaluator.frames import WorldFrame
from evaluator.model import CampaignData
from evaluator.report.style import INK, figure, sortie_colour
from evaluator.results import Evaluation, WaveformExample, correlation_matrix
from evaluator.score import Score

_STEP_S = 0.25  # between drawn points of a track
_LABELS = ("roll", "pitch", "yaw", "x", "y", "z")


def _oriented(half_x: float, half_y: float, heading_deg: float) -> np.ndarray:
    """Corners (4, 2), east and north, of a rectangle about the origin whose y axis points along a heading."""
    a = np.radians(heading_deg)
    corners = np.array([[-half_x, -half_y], [half_x, -half_y], [half_x, half_y], [-half_x, half_y]])
    return np.asarray(corners @ np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]))


def _fields_of_view(axes: Axes, data: CampaignData) -> None:
    """Camera frame, LiDAR swath and the ±45° cone on the ground, at the lowest design height and its first heading."""
    if data.plan is None or not data.plan.strips:
        return
    low = min(data.plan.strips, key=lambda s: s.height_m)
    height, heading = low.height_m, low.heading_deg
    axes.add_patch(
        Circle((0, 0), height, fill=False, ls=":", lw=1.2, color="#6b7280", label=f"±45° cone at {height:g} m")
    )
    if data.camera is not None:
        scale = data.camera.pixel_size_um / data.camera.nominal_focal_length_mm / 2000.0 * height
        frame = _oriented(data.camera.width_px * scale, data.camera.height_px * scale, heading)
        axes.add_patch(
            Polygon(frame, closed=True, fill=True, fc="#f4b94222", ec="#b97d00", lw=1.4, label="camera, nadir")
        )
    if data.lidar is not None:
        left, right = (height * np.tan(np.radians(np.clip(s, -80.0, 80.0))) for s in data.lidar.sector_deg)
        a = np.radians(heading)
        along = np.array([np.sin(a), np.cos(a)]) * height * 1.3
        across = np.array([np.cos(a), -np.sin(a)])
        for k, edge in enumerate((left, right)):
            ends = np.stack([across * edge - along, across * edge + along])
            axes.plot(*ends.T, color="#7b4ea3", ls="--", lw=1.2, label=None if k else "LiDAR swath")


def layout(data: CampaignData) -> Figure:
    """Plan of the range: targets, fields of view, tracks and exposures."""
    frame = WorldFrame(data.manifest)
    drawn = figure(5.3, 5.6)
    axes = drawn.add_subplot()
    _fields_of_view(axes, data)
    for sortie in data.sorties:
        t = sortie.trajectory
        if t is None or t.gps_time_s.size < 2:
            continue
        number, colour = sortie.folder.number, sortie_colour(sortie.folder.number)
        time = np.arange(t.gps_time_s[0], t.gps_time_s[-1], _STEP_S)
        world = frame.world_from_geodetic(t.latitude_rad, t.longitude_rad, t.ellipsoid_height_m)
        east, north = (np.interp(time, t.gps_time_s, world[:, k]) for k in (0, 1))
        axes.plot(east, north, color=colour, lw=0.9, alpha=0.7, label=f"sortie {number}")
        exposed = np.array([e.gps_time_s for e in sortie.exposures])
        if exposed.size:
            at = [np.interp(exposed, t.gps_time_s, world[:, k]) for k in (0, 1)]
            axes.plot(*at, "o", ms=3, color=colour, mec="white", mew=0.4)
    for kind, marker, label in (("frustum", "s", "frustum target"), ("panel", "D", "reference panel")):
        chosen = [t for t in data.targets if t.kind == kind]
        if not chosen:
            continue
        world = frame.world_from_map(np.array([[t.easting_m, t.northing_m, t.height_m] for t in chosen]))
        if kind == "panel":
            shade = [str(np.clip((t.nominal_reflectance_percent or 0.0) / 100.0, 0, 1)) for t in chosen]
            axes.scatter(world[:, 0], world[:, 1], c=shade, marker=marker, s=22, ec=INK, lw=0.7, label=label, zorder=3)
        else:
            axes.scatter(
                world[:, 0], world[:, 1], c="none", marker=marker, s=34, ec="#b3261e", lw=1.1, label=label, zorder=3
            )
    reach = min((s.height_m for s in data.plan.strips), default=40.0) if data.plan else 40.0
    axes.set(xlim=(-1.15 * reach, 1.15 * reach), ylim=(-1.15 * reach, 1.15 * reach), aspect="equal")
    axes.set(
        xlabel="east of the origin [m]",
        ylabel="north of the origin [m]",
        title="Layout and fields of view 靶标布设略图",
    )
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3)
    return drawn


def profile(evaluation: Evaluation, data: CampaignData) -> Figure:
    """Height above the site's origin and ground speed over time, one column a sortie, strips shaded."""
    flown = [s for s in data.sorties if s.trajectory is not None and s.trajectory.gps_time_s.size > 1]
    drawn = figure(5.3, 3.4)
    if not flown:
        drawn.text(0.5, 0.5, "no trajectory", ha="center")
        return drawn
    grid = drawn.subplots(2, len(flown), sharex="col", sharey="row", squeeze=False)
    windows = strip_windows(data, ConformityInputs(strip_window_s=evaluation.strip_window_s))
    for column, sortie in enumerate(flown):
        t = sortie.trajectory
        assert t is not None
        number = sortie.folder.number
        time = np.arange(t.gps_time_s[0], t.gps_time_s[-1], _STEP_S)
        height = np.interp(time, t.gps_time_s, t.ellipsoid_height_m - data.manifest.ellipsoid_height_m)
        speed = np.interp(time, t.gps_time_s, np.hypot(*t.velocity_ned_m_s[:, :2].T))
        colour = sortie_colour(number)
        for axes, values in zip(grid[:, column], (height, speed)):
            axes.plot(time - time[0], values, color=colour, lw=1.2)
            for (owner, _), (start, end) in windows.items():
                if owner == number:
                    axes.axvspan(start - time[0], max(end, start + 0.5) - time[0], color=colour, alpha=0.12, lw=0)
        grid[0, column].set_title(f"sortie {number}")
        grid[1, column].set_xlabel("time [s]")
    grid[0, 0].set_ylabel("height [m]")
    grid[1, 0].set_ylabel("ground speed [m/s]")
    grid[0, 0].set_ylim(bottom=0)
    grid[1, 0].set_ylim(bottom=0)
    return drawn


def draw_waveform(axes: Axes, example: WaveformExample) -> None:
    """Samples as dots, the decomposition as a line."""
    axes.plot(example.fit_time_ns, example.fit_dn, color="#d1603d", lw=1.4)
    axes.plot(example.time_ns, example.samples_dn, ".", color="#1b6ca8", ms=4)
    axes.set_title(example.label, fontsize=9)


def waveforms(examples: tuple[WaveformExample, ...]) -> Figure:
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
            axes.set_xlabel("time [ns]")
    return drawn


def draw_reflectance(axes: Axes, evaluation: Evaluation) -> None:
    """R1 against R2 of every panel, with the line of equality."""
    both = [p for p in evaluation.panels if p.lidar_percent is not None and p.camera_percent is not None]
    x, y = np.array([[p.camera_percent, p.lidar_percent] for p in both], dtype=float).reshape(-1, 2).T
    top = max(105.0, *x, *y) if both else 105.0
    axes.plot([0, top], [0, top], color="#6b7280", lw=1, ls="--")
    axes.plot(x, y, "o", color="#1b6ca8", ms=5, mec="white", mew=0.6)
    axes.set(xlabel="camera R₂ [%]", ylabel="LiDAR R₁ [%]", aspect="equal", xlim=(0, top), ylim=(0, top))


def reflectance(evaluation: Evaluation) -> Figure:
    """LiDAR against camera, and both minus the spectrometer."""
    drawn = figure(5.3, 6.0)
    upper, lower = drawn.subplots(2, 1, height_ratios=(3, 2))
    draw_reflectance(upper, evaluation)
    upper.set_title("LiDAR against camera 反射率相关性")
    laser = [(p.lidar_percent, p.laser_reference_percent) for p in evaluation.panels]
    band = [(p.camera_percent, p.band_reference_percent) for p in evaluation.panels]
    for colour, name, pairs in (
        ("#7b4ea3", "LiDAR − spectrometer at the laser line", laser),
        ("#b97d00", "camera − spectrometer over the band", band),
    ):
        known = np.array([(r, v - r) for v, r in pairs if v is not None and r is not None]).reshape(-1, 2)
        lower.plot(*known.T, "o", ms=4, color=colour, alpha=0.8, label=name)
    lower.axhline(0.0, color="#6b7280", lw=1)
    lower.set(xlabel="spectrometer [%]", ylabel="difference [%]")
    lower.legend(loc="upper center", bbox_to_anchor=(0.5, -0.3))
    return drawn


def residual_vectors(evaluation: Evaluation) -> Figure:
    """Residuals of formula (24) where they stand in the image, magnified, and their spread about zero."""
    observed = np.array([r.observed_px for r in evaluation.residuals]).reshape(-1, 2)
    shift = np.array([r.projected_px for r in evaluation.residuals]).reshape(-1, 2) - observed
    colours = [sortie_colour(r.sortie) for r in evaluation.residuals]
    drawn = figure(5.3, 6.4)
    upper, lower = drawn.subplots(2, 1, height_ratios=(1, 1))
    camera = evaluation.data.camera if evaluation.data else None
    size = (camera.width_px, camera.height_px) if camera else tuple(observed.max(axis=0))
    length = np.hypot(*shift.T)
    unit = max(float(np.median(length)), 1e-6)
    magnify = 0.05 * size[0] / unit
    upper.add_patch(Rectangle((0, 0), size[0], size[1], fill=False, ec="#6b7280"))
    upper.quiver(*observed.T, *(shift * magnify).T, color=colours, angles="xy", scale_units="xy", scale=1, width=0.003)
    upper.set(xlim=(-60, size[0] + 60), ylim=(size[1] + 60, -60), aspect="equal", xlabel="u [px]", ylabel="v [px]")
    upper.set_title(f"residual vectors × {magnify:.0f}")
    reach = 1.15 * max(float(length.max()), 1e-6)
    lower.axhline(0.0, color="#6b7280", lw=0.8)
    lower.axvline(0.0, color="#6b7280", lw=0.8)
    lower.scatter(*shift.T, c=colours, s=12, alpha=0.7, lw=0)
    lower.set(xlim=(-reach, reach), ylim=(reach, -reach), aspect="equal", xlabel="Δu [px]", ylabel="Δv [px]")
    lower.set_title("projected − observed; colour: sortie")
    return drawn


def correlations(evaluation: Evaluation) -> Figure | None:
    """Correlation matrix of the mounting parameters, and of the clocks where they were estimated."""
    solution = evaluation.mounting
    if solution is None:
        return None
    matrix = correlation_matrix(solution.covariance)
    drawn = figure(5.3, 5.0)
    axes = drawn.add_subplot()
    picture = axes.imshow(matrix, vmin=-1, vmax=1, cmap="RdBu_r")
    names = [f"{s} {n}" for s in ("cam", "lidar") for n in _LABELS]
    names += [n.replace("camera", "cam").replace("_", " ") for n in solution.names[12:]]
    axes.set_xticks(range(len(names)), names, rotation=90)
    axes.set_yticks(range(len(names)), names)
    axes.grid(False)
    for i, j in zip(*np.nonzero(np.abs(np.tril(matrix, -1)) > 0.3)):
        axes.text(
            j,
            i,
            f"{matrix[i, j]:.2f}",
            ha="center",
            va="center",
            fontsize=6,
            color="white" if abs(matrix[i, j]) > 0.6 else INK,
        )
    axes.set_title("Correlation of the mounting parameters")
    drawn.colorbar(picture, ax=axes, shrink=0.7)
    return drawn


def truth_errors(score: Score) -> Figure:
    """Error of each estimate in units of its stated standard deviation."""
    items = [i for i in score.items if i.z is not None]
    drawn = figure(5.3, 0.24 * len(items) + 0.9)
    axes = drawn.add_subplot()
    z = np.array([i.z for i in items], dtype=float)
    place = np.arange(len(items))[::-1]
    axes.axvspan(-2, 2, color="#1a7f4b", alpha=0.12, lw=0)
    axes.axvline(0, color="#6b7280", lw=0.8)
    axes.hlines(place, 0, z, color="#1b6ca8", lw=1.4)
    axes.plot(z, place, "o", color="#1b6ca8", ms=4)
    axes.set_yticks(place, [i.quantity.replace("_", " ") for i in items])
    reach = max(3.0, 1.1 * float(np.abs(z).max())) if len(items) else 3.0
    axes.set(xlim=(-reach, reach), xlabel="z = (estimate − truth) / standard deviation")
    axes.set_title("Truth against estimate; shaded: ±2")
    return drawn
