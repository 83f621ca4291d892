"""LiDAR points between map, world and sensor frame, nominal mountings, and the returns near each target.

LAS coordinates are georeferenced with the nominal mounting and the estimated trajectory; undoing that gives back what the
sensor itself measured, whatever the mounting's error.
"""

from dataclasses import dataclass, fields

import numpy as np

from campaign.flight.las import Returns, StripReader
from campaign.flight.trajectory import Trajectory
from campaign.sensors import MountingSheet, Rig
from evaluator.frames import WorldFrame, body_pose, euler_rotation
from evaluator.model import CampaignData, Mounting, RangeCorrection

# A camera that looks down with its image's top ahead: x right = body y, y down the image = body -x, z forward = body z.
_BODY_FROM_NADIR_CAMERA = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, kw_only=True)
class TargetReturns:
    """Returns of one strip within a horizontal radius of one target's surveyed place (nominal mounting)."""

    target: str
    sortie: int
    strip: int
    record: np.ndarray  # (n,) int64 number of the row in the strip's LAS file
    returns: Returns
    picked_by: str = "evaluator"  # "person": exactly the records that the campaign's observations_lidar.csv names
    reader: StripReader | None = (
        None  # that read them and knows their packets; None: none, or open the strip's file again
    )


def mounting_from_sheet(sheet: MountingSheet) -> Mounting:
    """The nominal body_from_sensor that the rig's drawing states."""
    rotation = euler_rotation(*np.radians(np.asarray(sheet.boresight_deg, dtype=np.float64)))
    if sheet.axes == "rdf_nadir":
        rotation = rotation @ _BODY_FROM_NADIR_CAMERA
    return Mounting(rotation=rotation, lever_arm_m=np.asarray(sheet.lever_arm_m, dtype=np.float64))


def nominal_mountings(rig: Rig) -> tuple[Mounting, Mounting]:
    """(body_from_camera, body_from_lidar) as drawn."""
    return mounting_from_sheet(rig.camera), mounting_from_sheet(rig.lidar)


def lidar_points(
    map_xyz_m: np.ndarray, gps_time_s: np.ndarray, trajectory: Trajectory, rig: Rig, world_frame: WorldFrame
) -> np.ndarray:
    """What the LiDAR measured, (n, 3) in its own frame, from georeferenced map points (n, 3) and their stamped times. [m]"""
    nominal = mounting_from_sheet(rig.lidar)
    position, world_from_body = body_pose(trajectory, gps_time_s, world_frame)
    in_body = np.einsum("nji,nj->ni", world_from_body, world_frame.world_from_map(map_xyz_m) - position)
    return np.asarray((in_body - nominal.lever_arm_m) @ nominal.rotation)


def corrected_points(p_lidar_m: np.ndarray, correction: RangeCorrection | None) -> np.ndarray:
    """Points (n, 3) in the LiDAR's frame with their ranges corrected, L_Q = L + K2 + R2 L, formula (15). [m]"""
    if correction is None:
        return p_lidar_m
    measured = np.linalg.norm(p_lidar_m, axis=1, keepdims=True)
    longer = correction.additive_constant_m / np.maximum(measured, 1e-6) + correction.multiplication_constant
    return np.asarray(p_lidar_m * (1.0 + longer))


def world_points(
    p_lidar_m: np.ndarray, gps_time_s: np.ndarray, trajectory: Trajectory, mounting: Mounting, world_frame: WorldFrame
) -> np.ndarray:
    """World points (n, 3) of points in a sensor's frame through a mounting and the trajectory. [m]"""
    position, world_from_body = body_pose(trajectory, gps_time_s, world_frame)
    in_body = np.asarray(p_lidar_m) @ mounting.rotation.T + mounting.lever_arm_m
    return np.asarray(position + np.einsum("nij,nj->ni", world_from_body, in_body))


def select_returns(returns: Returns, index: np.ndarray) -> Returns:
    """The rows `index` (integers or mask) of every column."""
    return Returns(**{f.name: getattr(returns, f.name)[index] for f in fields(Returns)})


def concatenate_returns(parts: list[Returns]) -> Returns:
    """Rows of all parts, in order."""
    return Returns(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Returns)})


def _near_any(xy_m: np.ndarray, centres_xy_m: np.ndarray, radius_m: float) -> np.ndarray:
    """Rows of (n, 2) that lie in a grid cell touched by any centre's square: a cheap superset of the circles."""
    low = centres_xy_m.min(axis=0) - 2.0 * radius_m
    size = np.ceil((centres_xy_m.max(axis=0) - low) / radius_m).astype(np.int64) + 4
    if int(size[0]) * int(size[1]) > 20_000_000:  # targets very far apart: leave the grid out
        return np.arange(len(xy_m))
    occupied = np.zeros(tuple(size), dtype=bool)
    cell = np.floor((centres_xy_m - low) / radius_m).astype(np.int64)
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            occupied[cell[:, 0] + dx, cell[:, 1] + dy] = True
    inside = np.flatnonzero(np.all((xy_m >= low) & (xy_m < low + radius_m * size), axis=1))
    at = np.floor((xy_m[inside] - low) / radius_m).astype(np.int64)
    return np.asarray(inside[occupied[at[:, 0], at[:, 1]]])


class _Near:
    """Which rows of a block are each target's: within the radius, or those that a person picked."""

    def __init__(self, centres_xy_m: np.ndarray, radius_m: float, picked: list[np.ndarray | None]) -> None:
        self._centres = centres_xy_m
        self._radius_m = radius_m
        self._picked = picked
        self.of_target: dict[int, np.ndarray] = {}  # of the last block: target -> places among the rows chosen

    def rows(self, first: int, xy_m: np.ndarray) -> np.ndarray:
        """Rows of the block that begins with record `first`, (n, 2) its coordinates, that are any target's."""
        near = _near_any(xy_m, self._centres, self._radius_m)
        x, y = xy_m[near].T.copy()
        found: dict[int, np.ndarray] = {}
        for i, (centre, picked) in enumerate(zip(self._centres, self._picked, strict=True)):
            if picked is None:
                rows = near[(x - centre[0]) ** 2 + (y - centre[1]) ** 2 <= self._radius_m**2]
            else:
                rows = picked[(picked >= first) & (picked < first + len(xy_m))] - first
            if rows.size:
                found[i] = rows
        self.of_target = {}
        if not found:
            return np.empty(0, np.int64)
        chosen = np.unique(np.concatenate(list(found.values())))
        self.of_target = {i: np.searchsorted(chosen, rows) for i, rows in found.items()}
        return chosen


def collect_target_returns(
    data: CampaignData, centres_map_m: dict[str, np.ndarray], radius_m: float, *, points_per_chunk: int = 1_000_000
) -> dict[tuple[int, int, str], TargetReturns]:
    """Reads every strip once and keeps the returns near targets; of a target whose points a person picked in a strip, those.

    Parameters
    ----------
    data : CampaignData
    centres_map_m : dict of str to (3,) np.ndarray
        Easting, northing, normal height of each target. [m]
    radius_m : float
        Horizontal radius about the surveyed place; must hold the target plus the mounting's error on the ground. [m]

    Returns
    -------
    dict
        (sortie, strip, target id) -> returns, only where there are any.
    """
    if not centres_map_m:
        return {}
    ids = list(centres_map_m)
    centres = np.array([np.asarray(centres_map_m[i], dtype=np.float64)[:2] for i in ids])
    unit = data.lidar.amplitude_unit if data.lidar is not None else "linear"
    found: dict[tuple[int, int, str], list[tuple[np.ndarray, Returns]]] = {}
    readers: dict[tuple[int, int], StripReader] = {}
    for sortie in data.sorties:
        for strip in sortie.strips:
            reader = StripReader(sortie.folder.strip_las(strip), gps_week=data.manifest.gps_week, amplitude_unit=unit)
            readers[sortie.folder.number, strip] = reader
            picked = [sortie.picked_points.get((strip, target)) for target in ids]
            near = _Near(centres, radius_m, picked)
            for record, chunk in reader.chosen(near.rows, points_per_chunk):
                for i, rows in near.of_target.items():
                    key = (sortie.folder.number, strip, ids[i])
                    found.setdefault(key, []).append((record[rows], select_returns(chunk, rows)))
    by_hand = {(s.folder.number, *key) for s in data.sorties for key in s.picked_points}
    return {
        key: TargetReturns(
            sortie=key[0],
            strip=key[1],
            target=key[2],
            record=np.concatenate([r for r, _ in parts]).astype(np.int64),
            returns=concatenate_returns([r for _, r in parts]),
            picked_by="person" if key in by_hand else "evaluator",
            reader=readers[key[:2]],
        )
        for key, parts in found.items()
    }
