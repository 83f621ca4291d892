"""Panels of the ranging line in a scan: found by their distances, tied to the total station by a rotation, ranged by a plane.

The scan's axes are the instrument's own: nothing but the total station's distances, the panels' sizes and the angles between
them is known. Distances are from the LiDAR's centre, the origin of both sides.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from campaign.scans import ScanPoints, read_scan
from evaluator.model import EvaluationError

GATE_M = 0.6  # measured minus true range, at most
GATE_SCALE = 2e-3
CELLS = 4  # of the search, along a panel's edge
FILLED = 9  # cells of CELLS x CELLS that must hold a point
CANDIDATES = 6  # of each panel
PLACE_GATE = 0.35  # of the panel's size: candidate against the place that the rotation gives
MIN_POINTS = 6  # of one panel in one scan
DEFAULT_DIVERGENCE_RAD = 0.0005
DARK_SHARE = 0.8  # of the panel's usual amplitude: below it part of the footprint lies beside the panel


@dataclass(frozen=True, kw_only=True)
class WantedPanel:
    """What the total station says."""

    id: str
    size_m: float
    place_m: np.ndarray  # (3,) from the LiDAR's centre, the stations' axes


@dataclass(frozen=True, kw_only=True)
class RangedPanel:
    """One panel in one scan."""

    range_m: float  # from the LiDAR's centre to the panel's centre
    variance_m2: float  # by the plane fit
    points: int
    rms_m: float  # residuals along the ray
    miss_m: float  # across: where its points lie against where the rotation puts it
    time_s: tuple[float, float]  # of its first and last point; NaN without times


@dataclass(frozen=True, kw_only=True)
class ScanPanels:
    """One scan."""

    panels: dict[str, RangedPanel]
    not_found: dict[str, str] = field(default_factory=dict)
    rotation: np.ndarray | None = None  # lidar_from_station
    duration_s: float | None = None  # from the first panel's first point to the last one's last


@dataclass(frozen=True, kw_only=True)
class _Shell:
    """Points of a scan near one panel's distance."""

    direction: np.ndarray  # (n, 3)
    range_m: np.ndarray  # (n,)
    amplitude: np.ndarray  # (n,)
    alone: np.ndarray  # (n,) bool: the pulse's only return
    time_s: np.ndarray  # (n,)


def panels_in_scan(
    path: Path, wanted: list[WantedPanel], divergence_rad: float | None, amplitude_unit: str = "linear"
) -> ScanPanels:
    """Find and range every panel of one scan.

    Parameters
    ----------
    wanted : list of WantedPanel
        At least three.
    divergence_rad : float, optional
        Full angle of the beam; half a footprint inside its edge a panel's points are trusted. [rad]

    Raises
    ------
    CampaignError
        The scan cannot be read.
    EvaluationError
        No three panels agree with the total station.
    """
    distance = np.array([np.linalg.norm(p.place_m) for p in wanted])
    gate = GATE_M + GATE_SCALE * distance
    extent = [np.inf, 0.0, 0]

    def near(xyz_m: np.ndarray) -> np.ndarray:
        found = np.linalg.norm(xyz_m, axis=1)
        if len(found):
            extent[:] = [min(extent[0], float(found.min())), max(extent[1], float(found.max())), extent[2] + len(found)]
        place = np.searchsorted(order, found)
        below, above = np.clip(place - 1, 0, len(order) - 1), np.clip(place, 0, len(order) - 1)
        return np.minimum(np.abs(found - order[below]), np.abs(found - order[above])) <= float(gate.max())

    order = np.sort(distance)
    points = read_scan(path, near, amplitude_unit=amplitude_unit)
    shells = [_shell(points, d, g) for d, g in zip(distance, gate, strict=True)]
    candidates = [_candidates(shell, d, p.size_m) for shell, d, p in zip(shells, distance, wanted, strict=True)]
    rotation, chosen = _tie(wanted, candidates)
    if rotation is None:
        raise EvaluationError(
            "no three panels are found where the total station's distances and angles put them",
            got=f"{int(extent[2])} points from {extent[0]:.2f} to {extent[1]:.2f} m"
            + _unit_hint(extent[1], float(distance.max())),
            expected=f"panels at {distance.min():.2f} to {distance.max():.2f} m, in metres about the LiDAR's centre",
        )
    ranged: dict[str, RangedPanel] = {}
    missing: dict[str, str] = {}
    beam = DEFAULT_DIVERGENCE_RAD if divergence_rad is None else divergence_rad
    for panel, shell, d, candidate in zip(wanted, shells, distance, chosen, strict=True):
        if candidate is None:
            missing[panel.id] = "no plane of its size where the other panels and the total station put it"
            continue
        try:
            ranged[panel.id] = _range(shell, rotation @ panel.place_m / d, candidate, panel, d, beam)
        except EvaluationError as error:
            missing[panel.id] = str(error)
    times = np.array([panel.time_s for panel in ranged.values()]).reshape(-1, 2)
    duration = float(times[:, 1].max() - times[:, 0].min()) if len(times) else np.nan
    return ScanPanels(
        panels=ranged, not_found=missing, rotation=rotation, duration_s=duration if np.isfinite(duration) else None
    )


def _unit_hint(largest: float, expected_m: float) -> str:
    """The scan's extent as a guess at its unit."""
    for factor, unit in ((1000.0, "millimetres"), (100.0, "centimetres"), (1 / 0.3048, "feet")):
        if 0.9 < largest / (expected_m * factor) < 1.5:
            return f", which looks like {unit}"
    return ""


def _shell(points: ScanPoints, distance_m: float, gate_m: float) -> _Shell:
    range_m = np.linalg.norm(points.xyz_m, axis=1)
    near = (np.abs(range_m - distance_m) <= gate_m) & (range_m > 0.0)
    return _Shell(
        direction=points.xyz_m[near] / range_m[near, None],
        range_m=range_m[near],
        amplitude=points.amplitude[near].astype(float),
        alone=points.number_of_returns[near] <= 1,
        time_s=points.gps_time_s[near],
    )


def _candidates(shell: _Shell, distance_m: float, size_m: float) -> list[np.ndarray]:
    """Directions (3,) of what fills a square of the panel's size at its distance, and little beside it; best first.

    Each point's neighbours are counted by the cells of a grid that they fill, so that a dense line does not pass for an area:
    ground seen at a grazing angle crosses the shell as a thin arc, a post as a column.
    """
    if len(shell.range_m) < MIN_POINTS:
        return []
    # A cube of cells about the LiDAR: a panel's cells are those that its directions, at its distance, fall into.
    cell_m = size_m / CELLS
    place = shell.direction * distance_m
    key = np.floor(place / cell_m).astype(np.int64)
    owner = np.unique(key, axis=0, return_inverse=True)[1].ravel()
    count = np.bincount(owner)
    middle = np.stack([np.bincount(owner, place[:, k]) for k in range(3)], axis=-1) / count[:, None]
    tree = cKDTree(middle)
    inner = np.asarray(tree.query_ball_point(middle, 0.55 * size_m, return_length=True))
    outer = np.asarray(tree.query_ball_point(middle, 1.2 * size_m, return_length=True))
    score = 2.0 * inner - outer  # full and alone
    out: list[np.ndarray] = []
    for best in np.argsort(-score, kind="stable"):
        if len(out) == CANDIDATES or inner[best] < FILLED:
            break
        if any(np.linalg.norm(middle[best] - c * distance_m) < size_m for c in out):
            continue
        centre = middle[best]
        for _ in range(5):
            near = tree.query_ball_point(centre, 0.75 * size_m)
            centre = middle[near].mean(axis=0)
        out.append(centre / np.linalg.norm(centre))
    return out


def _tie(
    wanted: list[WantedPanel], candidates: list[list[np.ndarray]]
) -> tuple[np.ndarray | None, list[np.ndarray | None]]:
    """lidar_from_station, and the candidate of each panel that agrees with it.

    Two candidates of two panels give a rotation when they stand at the right angle to each other; the one that most
    candidates agree with is refined with all of them. On a line whose panels all stand in one direction the turn about that
    direction stays open, and then matters nowhere.
    """
    distance = np.array([np.linalg.norm(p.place_m) for p in wanted])
    towards = np.stack([p.place_m for p in wanted]) / distance[:, None]
    size = np.array([p.size_m for p in wanted])
    # A candidate's own centre is good to a share of the panel's size.
    gate = PLACE_GATE * size
    pool = [(i, c) for i, found in enumerate(candidates) for c in found]
    best: tuple[int, float, np.ndarray | None] = (2, np.inf, None)
    for a, (i, first) in enumerate(pool):
        for j, second in pool[a + 1 :]:
            if i == j:
                continue
            angle = np.arccos(np.clip(first @ second, -1, 1)) - np.arccos(np.clip(towards[i] @ towards[j], -1, 1))
            if abs(angle) > gate[i] / distance[i] + gate[j] / distance[j]:
                continue
            rotation = _rotation(np.stack([first, second]), towards[[i, j]], 1.0 / (size[[i, j]] / distance[[i, j]]))
            rotation, chosen = _refined(rotation, towards, candidates, distance, gate, size)
            miss = [
                np.linalg.norm(c - rotation @ towards[k]) * distance[k] / size[k]
                for k, c in enumerate(chosen)
                if c is not None
            ]
            if (-len(miss), float(np.sum(miss))) < (-best[0], best[1]):
                best = (len(miss), float(np.sum(miss)), rotation)
    if best[2] is None:
        return None, [None] * len(wanted)
    return _refined(best[2], towards, candidates, distance, gate, size)


def _refined(
    rotation: np.ndarray,
    towards: np.ndarray,
    candidates: list[list[np.ndarray]],
    distance: np.ndarray,
    gate: np.ndarray,
    size: np.ndarray,
) -> tuple[np.ndarray, list[np.ndarray | None]]:
    """The rotation by all candidates that agree with it, three times over; the first time with twice the gate."""
    chosen: list[np.ndarray | None] = []
    for widen in (3.0, 2.0, 1.0):
        chosen = []
        for k, found in enumerate(candidates):
            predicted = rotation @ towards[k]
            miss = [float(np.linalg.norm(c - predicted)) * distance[k] for c in found]
            nearest = int(np.argmin(miss)) if miss else 0
            chosen.append(found[nearest] if miss and miss[nearest] <= widen * gate[k] else None)
        used = [k for k, c in enumerate(chosen) if c is not None]
        if len(used) < 2:
            break
        rotation = _rotation(np.stack([c for c in chosen if c is not None]), towards[used], distance[used] / size[used])
    return rotation, chosen


def _rotation(to: np.ndarray, origin: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(3, 3) that best takes directions (n, 3) `origin` to `to`. A proper rotation also where all lie on one line."""
    u, _, vt = np.linalg.svd(to.T @ (origin * (weight**2)[:, None]))
    sign = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))])
    return np.asarray(u @ sign @ vt)


def _range(
    shell: _Shell, predicted: np.ndarray, candidate: np.ndarray, panel: WantedPanel, distance_m: float, beam_rad: float
) -> RangedPanel:
    """Range along `predicted` to the plane through the panel's points.

    A plane in polar form is linear in 1 / range: 1/r = a . direction. Residuals are taken along the ray; Tukey's weights
    leave out what stands before or behind the panel. Only points within half a footprint of the inscribed circle count, and
    only full, single echoes.
    """
    axes = np.linalg.svd(predicted[None])[2]  # rows: along +-predicted, two across
    along = shell.direction @ predicted
    across = np.einsum("ij,nj->ni", axes[1:], shell.direction) / np.maximum(along, 1e-9)[:, None]
    radius_m = 0.5 * panel.size_m - 0.5 * beam_rad * distance_m
    inside = (along > 0.5) & (np.hypot(*across.T) * distance_m <= max(radius_m, 0.2 * panel.size_m))
    if inside.sum() < MIN_POINTS:
        raise EvaluationError("too few points", got=int(inside.sum()), expected=f"at least {MIN_POINTS}")
    # The panel's own range first: the greatest group of points within the noise of one another.
    middle = _mode(shell.range_m[inside])
    usual = np.median(shell.amplitude[inside & (np.abs(shell.range_m - middle) < 0.1)])
    inside &= shell.alone & ~(shell.amplitude < DARK_SHARE * usual)
    design = np.column_stack([np.ones(len(along)), across])[inside] * along[inside, None]
    range_m = shell.range_m[inside]
    if len(range_m) < MIN_POINTS:
        raise EvaluationError("too few full echoes", got=len(range_m), expected=f"at least {MIN_POINTS}")
    weight = (np.abs(range_m - middle) < 0.1).astype(float)
    a = np.array([1.0 / middle, 0.0, 0.0])
    scale = 0.0
    for _ in range(10):
        if np.count_nonzero(weight) < MIN_POINTS:
            raise EvaluationError("too few points on a plane", got=int(np.count_nonzero(weight)))
        # residual along the ray: dr = -r^2 d(1/r)
        rows = design * (middle**2 * np.sqrt(weight))[:, None]
        a = np.linalg.lstsq(rows, middle**2 * np.sqrt(weight) / range_m, rcond=None)[0]
        residual = range_m - 1.0 / (design @ a)
        scale = max(1.4826 * float(np.median(np.abs(residual[weight > 0]))), 2e-4)
        weight = np.clip(1.0 - (residual / (6.0 * scale)) ** 2, 0.0, None) ** 2
    used = weight > 0
    freedom = max(int(used.sum()) - 3, 1)
    variance = float(np.sum(weight[used] * residual[used] ** 2) / np.sum(weight[used])) * int(used.sum()) / freedom
    normal = np.linalg.inv((design * (middle**4 * weight)[:, None]).T @ design)
    range_centre = 1.0 / float(a[0])
    if not abs(range_centre - middle) < 0.2:
        raise EvaluationError("its points lie on no plane")
    return RangedPanel(
        range_m=range_centre,
        variance_m2=variance * float(normal[0, 0]) * range_centre**4,
        points=int(used.sum()),
        rms_m=float(np.sqrt(np.mean(residual[used] ** 2))),
        miss_m=float(np.linalg.norm(candidate - predicted)) * distance_m,
        time_s=(float(shell.time_s[inside].min()), float(shell.time_s[inside].max())),
    )


def _mode(range_m: np.ndarray) -> float:
    """Middle of the 0.1 m in which most ranges lie. [m]"""
    ordered = np.sort(range_m)
    inside = np.searchsorted(ordered, ordered + 0.1, side="right") - np.arange(len(ordered))
    first = int(np.argmax(inside))
    return float(np.median(ordered[first : first + inside[first]]))
