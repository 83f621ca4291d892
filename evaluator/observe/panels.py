"""Reflectance panels in the cloud: which returns lie on a panel, and their mean amplitude, range and incidence.

A panel is searched where the survey and the mounting put it; without a mounting solution, near there, by its contrast in
height and amplitude against what surrounds it. Panels in images: `panel_images.py`. Reflectance is computed by 8.1 and 8.3.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from campaign.errors import CampaignError
from campaign.flight.las import StripReader
from campaign.sensors import LidarSheet
from campaign.survey import SurveyedTarget
from evaluator.algorithms.record import OWN_TOOLS, Tools
from evaluator.algorithms.slots import AlgorithmFailure, EchoTask, FoundEchoes, FoundPanel, PanelTask
from evaluator.frames import WorldFrame
from evaluator.georeference import TargetReturns, corrected_points, lidar_points, nominal_mountings, world_points
from evaluator.model import CampaignData, EvaluationError, Mounting, SortieData

_MIN_RETURNS = 5
_HEIGHT_WINDOW_M = 0.06  # about the panel's median height; panels stand higher than this above the ground
_AGREE_M = (
    0.5  # panels of one strip are displaced alike: the mounting turns all of them, a heading error the outer ones more
)
_AGREE_LEAST = 5  # panels that a common displacement is taken from
_SEARCH_STEP_M = 0.05


@dataclass(frozen=True, kw_only=True)
class LidarPanelObservation:
    """One panel in one strip: means over the returns whose footprint lies wholly on it."""

    panel: str
    sortie: int
    strip: int
    design_height_m: float  # of the strip (plan); without a plan the mean height above the panels, whole metres
    points: int  # returns on the whole panel (5.5 b)
    used: int  # returns behind the means
    amplitude_dn: float  # linear
    amplitude_std_dn: float  # of the single return
    range_m: float
    cos_incidence: float  # the panel is level
    echo_fwhm_ns: float  # NaN without waveforms
    from_waveform: bool  # else the file's own amplitude
    offset_m: tuple[float, float, float]  # of the returns against the survey: searched shift east, north; height found
    # (used,) numbers in the strip's LAS file of the returns behind the means
    record: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64), repr=False, compare=False)
    picked_by: str = "evaluator"  # or "person": the records are those of the campaign's observations_lidar.csv


@dataclass(frozen=True, kw_only=True)
class ImagePanelObservation:
    """One panel in one image: means over the pixels inside its shrunk outline."""

    panel: str
    sortie: int
    strip: int
    image: str
    mean_dn: tuple[float, ...]  # a band, black level subtracted
    std_dn: tuple[float, ...]
    clipped_share: tuple[float, ...]
    pixels: int
    uneven: bool  # means of its nine parts differ by over a tenth: partly shaded, or not the panel alone
    region_px: np.ndarray  # (k, 2) the outline that was used; k = 4, or what a person's pixels span
    picked_by: str = "evaluator"  # or "person"


def panel_axes_world(target: SurveyedTarget, world_frame: WorldFrame) -> tuple[np.ndarray, np.ndarray]:
    """Centre of the panel's top face and its axes x, y, up as rows, in the world frame: (3,), (3, 3)."""
    a = np.radians(target.azimuth_deg)
    centre = np.array([target.easting_m, target.northing_m, target.height_m])
    steps = np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0]])
    world = world_frame.world_from_map(np.stack([centre, centre + steps[0], centre + steps[1]]))
    x = world[1] - world[0]
    x /= np.linalg.norm(x)
    y = world[2] - world[0]
    y -= x * (x @ y)
    y /= np.linalg.norm(y)
    return world[0], np.stack([x, y, np.cross(x, y)])


def find_panel_shift(
    local_m: np.ndarray, amplitude: np.ndarray, size_m: float, reach_m: float = 1.2
) -> np.ndarray | None:
    """Where a panel lies near its predicted place, by contrast.

    The square that is most uniform in height and amplitude and differs most from the ring about it, on a grid of 5 cm.

    Parameters
    ----------
    local_m : (n, 3) np.ndarray
        Returns in the panel's axes, origin at its predicted centre. [m]
    amplitude : (n,) np.ndarray
        Linear amplitude.
    size_m : float
        Edge of the panel. [m]
    reach_m : float
        Farthest along each axis. [m]

    Returns
    -------
    (2,) np.ndarray or None
        Shift along the panel's x and y, None where nothing stands out. [m]
    """
    step = _SEARCH_STEP_M
    half = max(1, round(0.5 * size_m / step))
    ring = half + max(2, round(0.25 * size_m / step))
    reach = round(reach_m / step)
    edge = ring + reach
    cell = np.floor(local_m[:, :2] / step).astype(np.int64) + edge
    width = 2 * edge
    inside = np.all((cell >= 0) & (cell < width), axis=1)
    if inside.sum() < 4 * _MIN_RETURNS:
        return None
    flat = cell[inside, 0] * width + cell[inside, 1]
    features = [local_m[inside, 2], np.log(np.maximum(amplitude[inside], 1e-3))]
    floors, signs = (0.01, 0.05), (True, False)  # a panel stands above the ground; it may be darker or brighter
    centres = np.arange(-reach, reach + 1) + edge

    def boxes(weights: np.ndarray | None, size: int) -> np.ndarray:
        grid = np.bincount(flat, weights=weights, minlength=width * width).reshape(width, width)
        total = np.zeros((width + 1, width + 1))
        total[1:, 1:] = grid.cumsum(axis=0).cumsum(axis=1)
        low, high = centres - size, centres + size
        return np.asarray(
            total[np.ix_(high, high)] - total[np.ix_(low, high)] - total[np.ix_(high, low)] + total[np.ix_(low, low)]
        )

    count_in, count_all = boxes(None, half), boxes(None, ring)
    count_ring = count_all - count_in
    score = np.zeros_like(count_in)
    with np.errstate(invalid="ignore", divide="ignore"):
        for values, floor, above in zip(features, floors, signs, strict=True):
            values = values - values.mean()
            sum_in = boxes(values, half)
            mean_in = sum_in / count_in
            mean_ring = (boxes(values, ring) - sum_in) / count_ring
            variance = np.maximum(boxes(values**2, half) / count_in - mean_in**2, 0.0)
            difference = mean_in - mean_ring
            score += (np.maximum(difference, 0.0) if above else np.abs(difference)) / np.sqrt(variance + floor**2)
    # A ring that reaches out of the data, or of the strip, compares with half of what surrounds the square.
    whole_ring = 0.6 * count_in * ((ring / half) ** 2 - 1.0)
    score[(count_in < _MIN_RETURNS) | (count_ring < np.maximum(whole_ring, _MIN_RETURNS))] = -np.inf
    score[~np.isfinite(score)] = -np.inf
    best = np.unravel_index(int(np.argmax(score)), score.shape)
    if not score[best] > 3.0:
        return None
    near = score >= 0.97 * score[best]  # a plateau's middle, not its first cell
    rows, columns = np.nonzero(near)
    close = (np.abs(rows - best[0]) <= 3) & (np.abs(columns - best[1]) <= 3)
    return np.array([rows[close].mean() - reach, columns[close].mean() - reach]) * step


@dataclass(frozen=True, kw_only=True)
class OnPanel:
    """Returns of one strip on one panel."""

    key: tuple[int, int, str]
    index: np.ndarray  # into the target's returns: those whose footprint lies on the panel
    points: int
    range_m: np.ndarray
    cos_incidence: np.ndarray
    height_above_m: float
    offset_m: tuple[float, float, float]


def lidar_panel_observations(
    data: CampaignData,
    returns: Mapping[tuple[int, int, str], TargetReturns],
    body_from_lidar: Mounting | None,
    tools: Tools = OWN_TOOLS,
) -> list[LidarPanelObservation]:
    """Every panel in every strip, sorted by sortie, strip and panel.

    Parameters
    ----------
    data : CampaignData
    returns : mapping
        From `georeference.collect_target_returns`, about the panels; other targets are passed over.
    body_from_lidar : Mounting or None
        The solved mounting. None: the nominal one, and each panel is searched by contrast.
    tools : Tools
        `panel_finding` and `echo_decomposition` are used; a panel, or a strip's waveforms, on which one fails is left out.

    Raises
    ------
    EvaluationError
        The campaign has no rig or no LiDAR sheet.
    """
    if data.rig is None or data.lidar is None:
        raise EvaluationError("sensors/rig.json and sensors/lidar.json are needed to find panels in the cloud")
    rig, lidar = data.rig, data.lidar
    panels = {t.id: t for t in data.targets if t.kind == "panel"}
    frame = WorldFrame(data.manifest)
    mounting = body_from_lidar or nominal_mountings(data.rig)[1]
    found: list[LidarPanelObservation] = []
    for sortie in data.sorties:
        if sortie.trajectory is None:
            continue
        for strip in sortie.strips:

            def place(
                name: str, sortie: SortieData = sortie, strip: int = strip, near: np.ndarray | None = None
            ) -> OnPanel | None:
                key = (sortie.folder.number, strip, name)
                if key not in returns or sortie.trajectory is None:
                    return None
                rows = returns[key].returns
                p_lidar = corrected_points(
                    lidar_points(rows.xyz_m, rows.gps_time_s, sortie.trajectory, rig, frame), data.range_correction
                )
                world = world_points(p_lidar, rows.gps_time_s, sortie.trajectory, mounting, frame)
                origin = world_points(np.zeros_like(p_lidar), rows.gps_time_s, sortie.trajectory, mounting, frame)
                try:
                    return returns_on_panel(
                        key,
                        panels[name],
                        returns[key],
                        world,
                        origin,
                        lidar,
                        frame,
                        body_from_lidar is None,
                        tools.panel_finding,
                        near,
                    )
                except AlgorithmFailure:  # counted and named where it failed
                    return None

            chosen = [on for name in sorted(panels) if (on := place(name)) is not None]
            if body_from_lidar is None:
                chosen = _agreeing(chosen, place)
            found += _strip_observations(data, sortie.folder.strip_las(strip), chosen, returns, tools)
    return found


def _agreeing(chosen: list[OnPanel], place: Callable[..., OnPanel | None]) -> list[OnPanel]:
    """Panels of one strip that were searched one by one: another thing that stands out can be taken for a dark panel. One whose
    displacement is not that of the others is looked for again near theirs, and left out where it is not found there."""
    if len(chosen) < _AGREE_LEAST:
        return chosen
    common = np.median([o.offset_m[:2] for o in chosen], axis=0)
    agreed: list[OnPanel] = []
    for on in chosen:
        if np.all(np.abs(np.asarray(on.offset_m[:2]) - common) <= _AGREE_M):
            agreed.append(on)
        elif (again := place(on.key[2], near=common)) is not None:
            agreed.append(again)
    return agreed


def find_on_panel(task: PanelTask) -> FoundPanel | str:
    """The returns on one panel, where it is predicted or, with `searched`, where its contrast puts it near there.

    The beam's footprint (full width at 1/e^2, stretched by incidence) and the residual error of place keep `clear` off the rim.
    """
    local = task.points_m
    shift = np.zeros(2)
    if task.searched:
        result = find_panel_shift(local, task.amplitude_dn, task.size_m, task.reach_m)
        if result is None:
            return "nothing stands out near its predicted place"
        shift = result
    offset = np.abs(local[:, :2] - shift)
    half = 0.5 * task.size_m
    whole = np.all(offset <= half, axis=1)
    core = np.all(offset <= 0.5 * half, axis=1)
    if core.sum() < _MIN_RETURNS:
        return f"{core.sum()} returns on its inner half"
    height = float(np.median(local[core, 2]))
    level = np.abs(local[:, 2] - height) <= _HEIGHT_WINDOW_M
    margin = 0.75 * task.divergence_rad * task.range_m / np.maximum(task.cos_incidence, 0.1) + (
        0.12 if task.searched else 0.05
    )
    clear = np.all(offset <= (half - np.minimum(margin, 0.6 * half))[:, None], axis=1)
    index = np.flatnonzero(clear & level & task.single_return)
    if index.size < _MIN_RETURNS:
        return f"{index.size} returns wholly on it"
    return FoundPanel(inside=np.flatnonzero(whole & level), clear=index, shift_m=shift, height_m=height)


def returns_on_panel(
    key: tuple[int, int, str],
    panel: SurveyedTarget,
    rows: TargetReturns,
    world_m: np.ndarray,
    origin_m: np.ndarray,
    lidar: LidarSheet,
    frame: WorldFrame,
    searched: bool,
    find: Callable[[PanelTask], FoundPanel | str] = find_on_panel,
    near_m: np.ndarray | None = None,
) -> OnPanel | None:
    """One strip's returns on one panel, by a person's pick or by `find`, the algorithm of the slot `panel_finding`.

    `near_m` (2,): displacement east and north that the strip's other panels have, about which this one is searched. [m]
    """
    centre, axes = panel_axes_world(panel, frame)
    displaced = np.zeros(3) if near_m is None else np.array([near_m[0], near_m[1], 0.0])
    centre = centre + displaced
    local = (world_m - centre) @ axes.T
    ray = origin_m - world_m
    range_m = np.linalg.norm(ray, axis=1)
    cosine = (ray @ axes[2]) / np.maximum(range_m, 1e-9)
    if rows.picked_by == "person":  # these points and no others (8.3.2 c)
        return OnPanel(
            key=key,
            index=np.arange(len(world_m)),
            points=len(world_m),
            range_m=range_m,
            cos_incidence=cosine,
            height_above_m=float(np.mean(ray @ axes[2])),
            offset_m=(0.0, 0.0, float(np.median(local[:, 2]))),
        )
    found = find(
        PanelTask(
            points_m=local,
            amplitude_dn=rows.returns.amplitude,
            range_m=range_m,
            cos_incidence=cosine,
            single_return=(rows.returns.return_number == 1) & (rows.returns.number_of_returns <= 1),
            size_m=panel.size_m,
            divergence_rad=lidar.divergence_rad * (1.7 if lidar.divergence_definition == "fwhm" else 1.0),
            searched=searched,
            reach_m=1.2 if near_m is None else _AGREE_M,
        )
    )
    if isinstance(found, str) or len(found.clear) < _MIN_RETURNS:
        return None
    index = found.clear
    along = found.shift_m @ axes[:2] + displaced
    return OnPanel(
        key=key,
        index=index,
        points=len(found.inside),
        range_m=range_m[index],
        cos_incidence=cosine[index],
        height_above_m=float(np.mean(ray[index] @ axes[2])),
        offset_m=(
            float(along[0]),
            float(along[1]),
            float(np.median(local[index, 2])) if found.height_m is None else found.height_m,
        ),
    )


def _strip_observations(
    data: CampaignData,
    las: Path,
    chosen: Sequence[OnPanel],
    returns: Mapping[tuple[int, int, str], TargetReturns],
    tools: Tools,
) -> list[LidarPanelObservation]:
    """Decomposes the packets of one strip's panels together, then averages a panel at a time."""
    if not chosen or data.lidar is None:
        return []
    amplitude = np.concatenate([returns[o.key].returns.amplitude[o.index] for o in chosen]).astype(np.float64)
    packet = np.concatenate([returns[o.key].returns.packet[o.index] for o in chosen])
    location_ns = np.concatenate([returns[o.key].returns.return_location_ps[o.index] for o in chosen]) / 1000.0
    width = np.full(amplitude.size, np.nan)
    measured = np.zeros(amplitude.size, dtype=bool)
    if (packet >= 0).any():
        try:
            reader = returns[chosen[0].key].reader or StripReader(las)
            wave_amplitude, width = _amplitude_of_packets(reader, packet, location_ns, data.lidar, tools)
            measured = np.isfinite(wave_amplitude)
            amplitude = np.where(measured, wave_amplitude, amplitude)
        except (CampaignError, AlgorithmFailure):  # as a broken .wdp: the file's own amplitudes; 8.1 then says so
            measured[:] = False
    heights = {(s.sortie, s.strip): s.height_m for s in data.plan.strips} if data.plan is not None else {}
    flown = float(np.round(np.mean([o.height_above_m for o in chosen])))
    observations, start = [], 0
    for o in chosen:
        part = slice(start, start + o.index.size)
        start += o.index.size
        from_waveform = bool(measured[part].mean() > 0.5)
        use = measured[part] if from_waveform else np.isfinite(amplitude[part])
        if use.sum() < _MIN_RETURNS:
            continue
        values = amplitude[part][use]
        # A few returns that grazed something else must not move the mean.
        middle = np.median(values)
        spread = 1.4826 * np.median(np.abs(values - middle))
        if returns[o.key].picked_by != "person":
            use[use] = np.abs(values - middle) <= max(5.0 * spread, 1e-6 * abs(middle))
        values = amplitude[part][use]
        echo_width = width[part][use]
        observations.append(
            LidarPanelObservation(
                panel=o.key[2],
                sortie=o.key[0],
                strip=o.key[1],
                design_height_m=heights.get((o.key[0], o.key[1]), flown),
                points=o.points,
                used=int(use.sum()),
                amplitude_dn=float(values.mean()),
                amplitude_std_dn=float(values.std(ddof=1)),
                range_m=float(o.range_m[use].mean()),
                cos_incidence=float(o.cos_incidence[use].mean()),
                echo_fwhm_ns=float(np.nanmean(echo_width)) if np.isfinite(echo_width).any() else float("nan"),
                from_waveform=from_waveform,
                offset_m=o.offset_m,
                record=returns[o.key].record[o.index[use]],
                picked_by=returns[o.key].picked_by,
            )
        )
    return observations


def _amplitude_of_packets(
    reader: StripReader, packet: np.ndarray, location_ns: np.ndarray, lidar: LidarSheet, tools: Tools
) -> tuple[np.ndarray, np.ndarray]:
    """Amplitude [DN] and width [ns] of the echo at each return's place in its packet; NaN where there is none."""
    amplitude, width = np.full(packet.size, np.nan), np.full(packet.size, np.nan)
    sampling_ns = reader.sampling_ps / 1000.0
    numbers = np.unique(packet[packet >= 0])
    if sampling_ns <= 0.0 or numbers.size == 0:
        return amplitude, width
    echoes = tools.echo_decomposition(
        EchoTask(
            samples_dn=np.asarray(reader.waveforms(numbers), dtype=np.float64),
            sampling_ns=sampling_ns,
            echo_fwhm_ns=lidar.echo_fwhm_ns,
            saturation_dn=2.0**lidar.bit_depth - 1.0,
        )
    )
    if echoes.packet.size == 0:
        return amplitude, width
    nearest = nearest_echo(echoes, np.searchsorted(numbers, packet), location_ns, lidar.echo_fwhm_ns)
    hit = (packet >= 0) & (nearest >= 0)
    amplitude[hit] = echoes.amplitude_dn[nearest[hit]]
    if echoes.fwhm_ns is not None:
        width[hit] = echoes.fwhm_ns[nearest[hit]]
    return amplitude, width


def nearest_echo(echoes: FoundEchoes, row: np.ndarray, location_ns: np.ndarray, within_ns: float) -> np.ndarray:
    """(n,) index of the echo nearest in time to each place in a packet `row`, -1 where none is within `within_ns`."""
    # Echoes are sorted by packet and time: the nearest in time of the same packet stands left or right of the place.
    span = 1e7
    keys = echoes.packet * span + echoes.centre_ns
    wanted = row * span + location_ns
    right = np.clip(np.searchsorted(keys, wanted), 0, keys.size - 1)
    left = np.clip(right - 1, 0, keys.size - 1)
    nearest = np.where(np.abs(keys[left] - wanted) <= np.abs(keys[right] - wanted), left, right)
    return np.where(np.abs(keys[nearest] - wanted) <= within_ns, nearest, -1)
