"""The points that the page shows: all near targets up to a cap, the rest thinned evenly in space. Strips are read in chunks.

The choice hangs on the rows' numbers alone, never on chance: the same campaign gives the same points. Nothing here opens truth/;
errors come from whoever was given as `TruthErrors`.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from campaign.errors import TestrangeError
from campaign.flight.las import Returns, StripReader
from campaign.survey import SurveyedTarget
from evaluator.frames import WorldFrame, body_pose
from evaluator.georeference import corrected_points, nominal_mountings
from evaluator.load import in_folder
from evaluator.model import SortieData
from evaluator.results import Evaluation
from evaluator.view.model import Cloud, StripPoints, TruthErrors

LEAST_POINTS = 380_000  # at about 17 characters a point: 6.6 MB of page
MOST_POINTS = 1_000_000  # 17 MB
SHARE_ON_TARGETS = 0.4  # of the points, at most
MARGIN_M = 0.4  # round a target's circumscribed circle
DELIVERED_MARGIN_M = 0.6  # the same where no mounting could be adjusted
MOST_SHIFT_M = 3.0  # of the points by the adjusted mounting, beyond which they are not searched
WIDE_CAP = 8  # times as many points near a target are looked at as are shown
MAX_STRIPS = 255  # a point names its strip in one byte
MAX_AWAY_M = 20_000.0  # of a point from the site's origin; farther ones are damaged records
MAX_RASTER = 4_000_000  # cells of the raster that finds points near targets


def point_budget(total: int) -> int:
    """How many of `total` returns the page shows."""
    return min(total, max(LEAST_POINTS, min(MOST_POINTS, total // 10)))


def row_hash(record: np.ndarray, salt: int) -> np.ndarray:
    """A number from 0 to 2^64 for each row, without pattern (splitmix64): it orders rows as chance would."""
    with np.errstate(over="ignore"):
        x = record.astype(np.uint64) + np.uint64(salt % 2**32 + 1) * np.uint64(0x9E3779B97F4A7C15)
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return np.asarray(x ^ (x >> np.uint64(31)))


def thin_evenly(xyz_m: np.ndarray, order: np.ndarray, count: int) -> np.ndarray:
    """Indices of about `count` of n points, at most one in each cube of a grid; the first by `order` in each.

    Parameters
    ----------
    xyz_m : (n, 3) np.ndarray
        [m]
    order : (n,) np.ndarray
        The least stands for its cube, and is kept when cubes are too many.
    count : int

    Returns
    -------
    (m,) np.ndarray
        Increasing, m <= count.
    """
    if len(xyz_m) <= count:
        return np.arange(len(xyz_m))
    if count <= 0:
        return np.zeros(0, dtype=np.int64)
    rank = np.argsort(order, kind="stable")
    low = xyz_m.min(axis=0)
    span = np.maximum(xyz_m.max(axis=0) - low, 1e-3)
    edge = max(float(np.sqrt(span[0] * span[1] / count)), float(span.max()) / 2**20)
    kept = rank
    for _ in range(4):
        cell = np.floor((xyz_m[rank] - low) / edge).astype(np.int64)
        _, first = np.unique((cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2], return_index=True)
        kept = rank[np.sort(first)]
        if 1.0 <= len(kept) / count < 1.2:
            break
        edge = max(edge * float(np.clip(np.sqrt(len(kept) / (1.1 * count)), 0.5, 2.0)), float(span.max()) / 2**20)
    return np.sort(kept[:count])


class _Near:
    """Which surveyed target a point lies near: a coarse raster first, then distances."""

    def __init__(self, targets: tuple[SurveyedTarget, ...], margin_m: float) -> None:
        self.xy = np.array([[t.easting_m, t.northing_m] for t in targets]).reshape(-1, 2)
        self.radius = np.array([t.size_m / np.sqrt(2.0) + margin_m for t in targets])
        if not targets:
            return
        self.tree = cKDTree(self.xy)
        reach = float(self.radius.max())
        self.low = self.xy.min(axis=0) - reach
        span = self.xy.max(axis=0) + reach - self.low
        self.cell = max(reach / 2.0, float(np.sqrt(span[0] * span[1] / MAX_RASTER)), float(span.max()) / 1e6)
        shape = np.ceil(span / self.cell).astype(int) + 1
        self.raster = np.zeros(tuple(shape), dtype=bool)
        for (x, y), r in zip(self.xy, self.radius):
            a = np.floor((np.array([x - r, y - r]) - self.low) / self.cell).astype(int)
            b = np.floor((np.array([x + r, y + r]) - self.low) / self.cell).astype(int) + 1
            self.raster[max(a[0], 0) : b[0], max(a[1], 0) : b[1]] = True

    def __call__(self, xy_m: np.ndarray) -> np.ndarray:
        """(n, 2) -> (n,) int32, -1 none."""
        out = np.full(len(xy_m), -1, dtype=np.int32)
        if not len(self.xy) or not len(xy_m):
            return out
        at = np.floor((xy_m - self.low) / self.cell)
        inside = np.flatnonzero(np.all((at >= 0) & (at < self.raster.shape), axis=1))
        cells = at[inside].astype(int)
        rows = inside[self.raster[cells[:, 0], cells[:, 1]]]
        distance, nearest = self.tree.query(xy_m[rows])
        index = np.asarray(nearest)
        close = distance <= self.radius[index]
        out[rows[close]] = index[close]
        return out


def _shift_m(evaluation: Evaluation) -> float:
    """How far the adjusted mounting moves points on the ground, about; 0 without one. [m]"""
    data, solution = evaluation.data, evaluation.mounting
    if data is None or data.rig is None or solution is None:
        return 0.0
    nominal = nominal_mountings(data.rig)[1]
    turn = solution.body_from_lidar.rotation @ nominal.rotation.T
    angle = float(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
    lever = float(np.linalg.norm(solution.body_from_lidar.lever_arm_m - nominal.lever_arm_m))
    ground = float(np.mean([t.height_m for t in data.targets] or [0.0])) + data.manifest.height_anomaly_m
    tops = [float(s.trajectory.ellipsoid_height_m.max()) for s in data.sorties if s.trajectory is not None]
    return float(np.clip(1.3 * angle * (max(tops, default=0.0) - ground) + lever, 0.0, MOST_SHIFT_M))


def _candidates(
    reader: StripReader, salt: int, near: _Near, origin_map_m: np.ndarray, quota: int, cap: int
) -> dict[str, np.ndarray]:
    """Columns of one strip's rows: about `quota` evenly in space (`even` says which), and those near targets as delivered."""
    columns: dict[str, list[np.ndarray]] = {}
    limit = np.uint64(min(1.0, 2.0 * quota / max(reader.point_count, 1)) * (2**64 - 2048))
    for first, chunk in reader.chunks():
        record = first + np.arange(len(chunk.gps_time_s), dtype=np.int64)
        target = near(chunk.xyz_m[:, :2])
        order = row_hash(record, salt)
        sound = np.isfinite(chunk.xyz_m).all(axis=1) & (np.abs(chunk.xyz_m - origin_map_m) < MAX_AWAY_M).all(axis=1)
        even = sound & (order < limit)
        close = np.zeros(len(record), dtype=bool)
        close[_capped(np.where(sound, target, -1), order, WIDE_CAP * cap)] = True
        rows = np.flatnonzero(even | close)
        for name, values in (
            _columns(chunk) | {"record": record, "order": order, "even": even, "close": close}
        ).items():
            columns.setdefault(name, []).append(values[rows])
    table = {name: np.concatenate(parts) for name, parts in columns.items()}
    if table:
        some = np.flatnonzero(table["even"])
        table["even"] = np.zeros(len(table["even"]), dtype=bool)
        table["even"][some[thin_evenly(table["map_m"][some], table["order"][some], quota)]] = True
        wanted = table["even"] | table["close"]
        table = {name: values[wanted] for name, values in table.items()}
    return table


def _capped(group: np.ndarray, order: np.ndarray, cap: int) -> np.ndarray:
    """Indices of the first `cap` rows, by `order`, of every group from 0."""
    rows = np.flatnonzero(group >= 0)
    rows = rows[np.lexsort((order[rows], group[rows]))]
    _, start, counts = np.unique(group[rows], return_index=True, return_counts=True)
    place = np.arange(len(rows)) - np.repeat(start, counts)
    return np.asarray(rows[place < cap])


def _columns(chunk: Returns) -> dict[str, np.ndarray]:
    return {
        "map_m": chunk.xyz_m,
        "gps_time_s": chunk.gps_time_s,
        "reflectance_db": chunk.reflectance_db,
        "amplitude": chunk.amplitude,
        "last": chunk.return_number >= chunk.number_of_returns,
    }


def _adjusted(
    evaluation: Evaluation, frame: WorldFrame, sortie: SortieData, points: StripPoints
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rows that the trajectory covers (m,), what the LiDAR measured there (m, 3), and world places (m, 3) as delivered and by
    the adjusted mounting (NaN without one). [m]"""
    data, trajectory = evaluation.data, sortie.trajectory
    nothing = np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))
    if data is None or data.rig is None or trajectory is None:
        return nothing
    shift = evaluation.mounting.lidar_clock_s if evaluation.mounting is not None else 0.0
    low, high = trajectory.gps_time_s[0] + abs(shift), trajectory.gps_time_s[-1] - abs(shift)
    rows = np.flatnonzero((points.gps_time_s >= low) & (points.gps_time_s <= high))  # NaN: no
    if not rows.size:
        return nothing
    time, nominal = points.gps_time_s[rows], nominal_mountings(data.rig)[1]
    delivered = frame.world_from_map(points.map_m[rows])
    position, turn = body_pose(trajectory, time, frame)  # as georeference's functions do, with one pose for both
    measured = (np.einsum("nji,nj->ni", turn, delivered - position) - nominal.lever_arm_m) @ nominal.rotation
    if evaluation.mounting is None:
        return rows, measured, delivered, np.full(delivered.shape, np.nan)
    mounting = evaluation.mounting.body_from_lidar
    in_body = corrected_points(measured, data.range_correction) @ mounting.rotation.T + mounting.lever_arm_m
    if shift != 0.0:
        position, turn = body_pose(trajectory, time - shift, frame)
    return rows, measured, delivered, position + np.einsum("nij,nj->ni", turn, in_body)


def _strip_points(
    evaluation: Evaluation,
    frame: WorldFrame,
    sortie: SortieData,
    found: StripPoints,
    table: dict[str, np.ndarray],
    cap: int,
    truth_errors: TruthErrors | None,
) -> tuple[StripPoints, np.ndarray, list[str]]:
    """One strip's points as shown, their amplitude times squared range (n,), NaN where unknown, and a problem with truth."""
    targets = evaluation.data.targets if evaluation.data is not None else ()
    n = len(found.record)
    rows, measured, delivered, adjusted = _adjusted(evaluation, frame, sortie, found)
    adjusted_map = np.full((n, 3), np.nan)
    if rows.size:
        turn = frame.world_from_grid(found.map_m[rows].mean(axis=0))  # decimetres: one rotation holds for all
        adjusted_map[rows] = found.map_m[rows] + (adjusted - delivered) @ turn
    known = np.isfinite(adjusted_map).all(axis=1)
    place = np.where(known[:, None], adjusted_map, found.map_m)
    target = _Near(targets, MARGIN_M if known.any() else DELIVERED_MARGIN_M)(place[:, :2])
    found = replace(found, adjusted_map_m=adjusted_map, target=target)
    mask = table["even"] & (target < 0)
    mask[_capped(target, table["order"], cap)] = True
    chosen = np.flatnonzero(mask)
    power = np.full(n, np.nan)
    power[rows] = table["amplitude"][rows].astype(float) * np.sum(measured**2, axis=1)
    error, problems = np.full((2, n), np.nan), []
    part = np.flatnonzero(mask[rows])
    if truth_errors is not None and part.size:
        at, both = rows[part], np.stack([delivered[part], adjusted[part]])
        try:
            error[:, at] = truth_errors(
                found.sortie, found.strip, found.record[at], measured[part], found.gps_time_s[at], both
            )
        except TestrangeError as wrong:
            problems.append(str(wrong))
    return _rows(replace(found, error_m=error), chosen), power[chosen], problems


def sample_cloud(evaluation: Evaluation, truth_errors: TruthErrors | None) -> Cloud:
    """The points of all strips that the page shows.

    A strip that cannot be read, or whose truth does not fit it, is named in `problems`; the others are shown all the same.
    """
    data = evaluation.data
    if data is None:
        return Cloud(strips=(), total=0, reflectance_by="none")
    frame, near = WorldFrame(data.manifest), _Near(data.targets, DELIVERED_MARGIN_M + _shift_m(evaluation))
    origin = frame.map_from_world(np.zeros(3))
    unit = data.lidar.amplitude_unit if data.lidar is not None else "linear"
    problems: list[str] = []
    readers: list[tuple[SortieData, int, StripReader]] = []
    for sortie in data.sorties:
        for strip in sortie.strips:
            try:
                las = data.folder.held(sortie.folder.strip_las(strip))
                readers.append((sortie, strip, StripReader(las, gps_week=data.manifest.gps_week, amplitude_unit=unit)))
            except TestrangeError as error:
                problems.append(in_folder(error, data.folder.root))
    if len(readers) > MAX_STRIPS:
        problems.append(f"{len(readers) - MAX_STRIPS} strips are not shown; the page holds {MAX_STRIPS}")
        readers = readers[:MAX_STRIPS]
    total = sum(reader.point_count for _, _, reader in readers)
    budget = point_budget(total)
    cap = max(20, int(SHARE_ON_TARGETS * budget) // max(1, len(data.targets) * len(readers)))
    strips: list[StripPoints] = []
    power: list[np.ndarray] = []
    by_device = True
    for k, (sortie, strip, reader) in enumerate(readers):
        try:
            quota = int(budget * reader.point_count / max(total, 1))
            table = _candidates(reader, k, near, origin, quota, cap)
            if not table or not len(table["record"]):
                continue
            n = len(table["record"])
            found = StripPoints(
                sortie=sortie.folder.number,
                strip=strip,
                record=table["record"],
                map_m=table["map_m"],
                adjusted_map_m=np.full((n, 3), np.nan),
                gps_time_s=table["gps_time_s"],
                reflectance=np.power(10.0, np.clip(table["reflectance_db"].astype(float), -60.0, 20.0) / 10.0),
                last=table["last"],
                target=np.full(n, -1, np.int32),
                error_m=np.full((2, n), np.nan),
            )
            found, strength, amiss = _strip_points(evaluation, frame, sortie, found, table, cap, truth_errors)
        except TestrangeError as error:
            problems.append(in_folder(error, data.folder.root))
            continue
        problems += [in_folder(line, data.folder.root) for line in amiss]
        by_device &= bool(np.isfinite(found.reflectance).any())
        strips.append(found)
        power.append(strength)
    scaled_by = "device"
    if not (by_device and strips):
        strips, scaled_by = _by_panels(strips, power, data.targets)
    return _fitted(Cloud(strips=tuple(strips), total=total, reflectance_by=scaled_by, problems=tuple(problems)), budget)


def _by_panels(
    strips: list[StripPoints], power: list[np.ndarray], targets: tuple[SurveyedTarget, ...]
) -> tuple[list[StripPoints], str]:
    """Where the device states no reflectance: amplitude times squared range, scaled by the panels' nominal values.

    The surface f(A, L, R) of 8.1.2 holds at the panels' distances alone; this is for colours only.
    """
    nominal = np.array([(t.nominal_reflectance_percent or 0.0) / 100.0 for t in targets] + [0.0])
    level = [nominal[s.target] for s in strips]
    on = [(r > 0.0) & np.isfinite(p) for r, p in zip(level, power)]
    known = np.concatenate([p[k] for p, k in zip(power, on)]) if strips else np.zeros(0)
    if not known.size or not float(known @ known) > 0.0:
        nothing = [replace(s, reflectance=np.full(len(s.record), np.nan)) for s in strips]
        return nothing, "none"
    scale = float(known @ np.concatenate([r[k] for r, k in zip(level, on)])) / float(known @ known)
    return [replace(s, reflectance=scale * p) for s, p in zip(strips, power)], "panels"


def _fitted(cloud: Cloud, budget: int) -> Cloud:
    """At most `budget` points: what is too much goes from those away from targets."""
    too_many = cloud.shown - budget
    if too_many <= 0:
        return cloud
    order = np.concatenate([row_hash(s.record, 977 + k) for k, s in enumerate(cloud.strips)])
    target = cloud.joined("target")
    order[target >= 0] = 0
    limit = np.partition(order, budget - 1)[budget - 1]
    parts, start = [], 0
    for s in cloud.strips:
        rows = np.flatnonzero(order[start : start + len(s.record)] <= limit)
        start += len(s.record)
        parts.append(_rows(s, rows))
    return replace(cloud, strips=tuple(parts))


def _rows(strip: StripPoints, rows: np.ndarray) -> StripPoints:
    one = ("record", "map_m", "adjusted_map_m", "gps_time_s", "reflectance", "last", "target")
    return replace(strip, **{f: getattr(strip, f)[rows] for f in one}, error_m=strip.error_m[:, rows])
