"""Panels of the ranging line in a scan: found by their distances, tied to the total station by a rotation, ranged by a plane.

The scan's axes are the instrument's own: nothing but the total station's distances, the panels' sizes and the angles between
them is known. Distances are from the LiDAR's centre, the origin of both sides.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from campaign.benches.scans import ScanPoints, read_scan
from evaluator.model import EvaluationError

GATE_M = 0.6  # measured minus true range, at most
GATE_SCALE = 2e-3
CELLS = 4  # of the search, along a panel's edge
FILLED = 9  # cells of CELLS x CELLS that must hold a point
CANDIDATES = 6  # of each panel
ENOUGH_POINTS = 2000  # for the middle of a candidate
MAX_TRIES = 500  # pairs of candidates that are followed up
PLACE_GATE = 0.35  # of the panel's size: candidate against the place that the rotation gives
MIN_POINTS = 6  # of one panel in one scan
DEFAULT_DIVERGENCE_RAD = 0.0005
LEAST_STD_M = 2e-5  # of a range: coordinates are written to 0.1 mm
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
    order = np.sort(distance)
    extent = [np.inf, 0.0, 0]

    def near(xyz_m: np.ndarray) -> np.ndarray:
        found = np.linalg.norm(xyz_m, axis=1)
        if len(found):
            extent[:] = [min(extent[0], float(found.min())), max(extent[1], float(found.max())), extent[2] + len(found)]
        place = np.searchsorted(order, found)
        next_to = order[np.clip([place - 1, place], 0, len(order) - 1)]
        return np.asarray((np.abs(found - next_to) <= _gate_m(next_to)).any(axis=0))

    shells = _shells(read_scan(path, near, amplitude_unit=amplitude_unit), distance)
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


def _gate_m(distance_m: np.ndarray) -> np.ndarray:
    """How far a measured range may lie from the true one. [m]"""
    return GATE_M + GATE_SCALE * distance_m


def _shells(points: ScanPoints, distance_m: np.ndarray) -> list[_Shell]:
    """Points near each distance."""
    range_m = np.linalg.norm(points.xyz_m, axis=1)
    order = np.argsort(range_m, kind="stable")
    ordered = range_m[order]
    first = np.searchsorted(ordered, np.maximum(distance_m - _gate_m(distance_m), 1e-3))
    last = np.searchsorted(ordered, distance_m + _gate_m(distance_m), side="right")
    out = []
    for begin, end in zip(first, last, strict=True):
        rows = order[begin:end]
        out.append(
            _Shell(
                direction=points.xyz_m[rows] / range_m[rows, None],
                range_m=range_m[rows],
                amplitude=points.amplitude[rows].astype(float),
                alone=points.number_of_returns[rows] <= 1,
                time_s=points.gps_time_s[rows],
            )
        )
    return out


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
    x, y, z = np.floor(place / cell_m).astype(np.int64).T + (1 << 20)  # 2 million cells an axis
    owner = np.unique((x << 42) | (y << 21) | z, return_inverse=True)[1].ravel()
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
        out.append(_centred(shell, centre / np.linalg.norm(centre), distance_m, size_m))
    return out


def _centred(shell: _Shell, direction: np.ndarray, distance_m: float, size_m: float) -> np.ndarray:
    """The direction again (3,), from points on the panel's own plane: without the post behind it and the ground below."""
    for _ in range(3):
        near = np.flatnonzero(np.linalg.norm(shell.direction - direction, axis=1) * distance_m <= 0.75 * size_m)
        near = near[:: 1 + len(near) // ENOUGH_POINTS]
        try:
            _, residual, scale = _plane(shell.direction[near], shell.range_m[near], direction, rounds=4)
        except EvaluationError:
            return direction
        middle = shell.direction[near[np.abs(residual) <= max(4.0 * scale, 0.01)]].mean(axis=0)
        direction = middle / np.linalg.norm(middle)
    return direction


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
    ranks = CANDIDATES if len(wanted) <= 30 else 2
    pool = [(rank, i, c) for i, found in enumerate(candidates) for rank, c in enumerate(found[:ranks])]
    pairs = [(p, q) for n, p in enumerate(pool) for q in pool[n + 1 :] if p[1] != q[1]]
    pairs.sort(key=lambda pair: pair[0][0] + pair[1][0])  # the best of each panel first
    most, least_miss, best = 2, np.inf, None
    tries = 0
    for (_, i, first), (_, j, second) in pairs:
        angle = np.arccos(np.clip(first @ second, -1, 1)) - np.arccos(np.clip(towards[i] @ towards[j], -1, 1))
        if abs(angle) > gate[i] / distance[i] + gate[j] / distance[j]:
            continue
        start = _rotation(np.stack([first, second]), towards[[i, j]], (distance / size)[[i, j]])
        rotation, chosen = _refined(start, towards, candidates, distance, gate, size)
        miss = [
            float(np.linalg.norm(c - rotation @ towards[k]) * distance[k] / size[k])
            for k, c in enumerate(chosen)
            if c is not None
        ]
        if len(miss) > most or (len(miss) == most and best is not None and sum(miss) < least_miss):
            most, least_miss, best = len(miss), sum(miss), (rotation, chosen)
        tries += 1
        if most == sum(1 for c in candidates if c) or tries >= MAX_TRIES:
            break
    return best if best is not None else (None, [None] * len(wanted))


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
    across_m = np.linalg.norm(shell.direction - predicted, axis=1) * distance_m
    radius_m = max(0.5 * panel.size_m - 0.5 * beam_rad * distance_m, 0.2 * panel.size_m)
    inside = across_m <= radius_m
    if inside.sum() < MIN_POINTS:
        raise EvaluationError("too few points", got=int(inside.sum()), expected=f"at least {MIN_POINTS}")
    middle = _mode(shell.range_m[inside])
    usual = np.median(shell.amplitude[inside & (np.abs(shell.range_m - middle) < 0.1)])
    inside &= shell.alone & ~(shell.amplitude < DARK_SHARE * usual)
    direction, range_m = shell.direction[inside], shell.range_m[inside]
    polar, residual, scale = _plane(direction, range_m, predicted)
    weight = _tukey(residual, scale)
    used = weight > 0
    variance = float(np.sum(weight * residual**2) / np.sum(weight)) * used.sum() / max(used.sum() - 3, 1)
    design = _design(direction, predicted)
    normal = np.linalg.pinv((design * (range_m**4 * weight)[:, None]).T @ design, hermitian=True)
    return RangedPanel(
        range_m=1.0 / float(polar[0]),
        variance_m2=max(float(variance * normal[0, 0] / polar[0] ** 4), LEAST_STD_M**2),
        points=int(used.sum()),
        rms_m=float(np.sqrt(np.mean(residual[used] ** 2))),
        miss_m=float(np.linalg.norm(candidate - predicted)) * distance_m,
        time_s=(float(shell.time_s[inside].min()), float(shell.time_s[inside].max())),
    )


def _design(direction: np.ndarray, about: np.ndarray) -> np.ndarray:
    """(n, 3) rows of 1/r = a . row: along `about`, and two axes across. a[0] is one over the plane's range along `about`."""
    axes = np.linalg.svd(about[None])[2]
    axes[0] = about
    return np.einsum("ij,nj->ni", axes, direction)


def _tukey(residual: np.ndarray, scale: float) -> np.ndarray:
    """Weights, 0 from six scales on."""
    return np.asarray(np.clip(1.0 - (residual / (6.0 * scale)) ** 2, 0.0, None) ** 2)


def _plane(
    direction: np.ndarray, range_m: np.ndarray, about: np.ndarray, rounds: int = 12
) -> tuple[np.ndarray, np.ndarray, float]:
    """(3,) polar form about a direction, (n,) residuals along the ray, and their robust scale.

    It starts from the greatest group of points within 0.1 m of one another and spreads along their plane.
    """
    if len(range_m) < MIN_POINTS:
        raise EvaluationError("too few full echoes", got=len(range_m), expected=f"at least {MIN_POINTS}")
    middle = _mode(range_m)
    design = _design(direction, about)
    weight = (np.abs(range_m - middle) < 0.1).astype(float)
    for _ in range(rounds):
        if np.count_nonzero(weight) < MIN_POINTS:
            raise EvaluationError("too few points on a plane", got=int(np.count_nonzero(weight)))
        # residual along the ray: dr = -r^2 d(1/r)
        rows = design * (weight * range_m**4)[:, None]
        polar = np.linalg.pinv(rows.T @ design, hermitian=True) @ (rows.T @ (1.0 / range_m))
        inverse = design @ polar
        if not (inverse > 0).all():
            raise EvaluationError("its points lie on no plane")
        residual = range_m - 1.0 / inverse
        scale = max(1.4826 * float(np.median(np.abs(residual[weight > 0]))), 2e-4)
        weight = _tukey(residual, scale)
    if not abs(1.0 / polar[0] - middle) < 0.3:
        raise EvaluationError("its points lie on no plane")
    return polar, residual, scale


def _mode(range_m: np.ndarray) -> float:
    """Middle of the 0.1 m in which most ranges lie. [m]"""
    ordered = np.sort(range_m)
    inside = np.searchsorted(ordered, ordered + 0.1, side="right") - np.arange(len(ordered))
    first = int(np.argmax(inside))
    return float(np.median(ordered[first : first + inside[first]]))
