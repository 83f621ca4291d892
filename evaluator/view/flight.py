"""Trajectories and camera poses in map coordinates. No drawing."""

from dataclasses import dataclass

import numpy as np

from campaign.errors import TestrangeError
from evaluator.camera_model import undistort
from evaluator.frames import WorldFrame, body_pose
from evaluator.georeference import nominal_mountings
from evaluator.load import in_folder
from evaluator.model import CampaignData, Mounting, SortieData
from evaluator.results import Evaluation

MOST_EPOCHS = 3000  # of a sortie
STEP_S = 0.1
MOST_CAMERAS = 3000
FRUSTUM_SHARE = 0.1  # of the height above the targets: how far a camera's frustum is drawn
OUTLINE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@dataclass(frozen=True, kw_only=True)
class Path3d:
    """One sortie's trajectory, thinned in time."""

    sortie: int
    map_m: np.ndarray  # (n, 3)
    strip: np.ndarray  # (n,) number of the strip flown at each epoch, -1 in a turn


@dataclass(frozen=True, kw_only=True)
class CameraPose:
    """One exposure."""

    sortie: int
    strip: int
    image: str
    gps_time_s: float
    centre_m: np.ndarray  # (3,) map
    corners_m: np.ndarray | None  # (4, 3) map offsets of the image's corners from the centre, a frustum's length away
    map_from_camera: np.ndarray | None  # (3, 3) the camera's axes, x right, y down the image, z forward, as columns
    adjusted: bool  # by the adjusted mounting, else as drawn


def strip_windows(evaluation: Evaluation) -> dict[tuple[int, int], tuple[float, float]]:
    """From when to when each strip lasted: by its points near targets, else by its exposures. [adjusted GPS s]"""
    windows: dict[tuple[int, int], tuple[float, float]] = {}
    for sortie in evaluation.data.sorties if evaluation.data else ():
        for e in sortie.exposures:
            key = (sortie.folder.number, e.strip)
            low, high = windows.get(key, (e.gps_time_s, e.gps_time_s))
            windows[key] = (min(low, e.gps_time_s), max(high, e.gps_time_s))
    return windows | dict(evaluation.strip_window_s)


def paths(evaluation: Evaluation) -> list[Path3d]:
    """Every sortie's trajectory with its strips marked."""
    data = evaluation.data
    if data is None:
        return []
    frame, windows, out = WorldFrame(data.manifest), strip_windows(evaluation), []
    for sortie in data.sorties:
        t = sortie.trajectory
        if t is None or len(t.gps_time_s) < 2:
            continue
        span = float(t.gps_time_s[-1] - t.gps_time_s[0])
        wanted = np.linspace(t.gps_time_s[0], t.gps_time_s[-1], int(np.clip(span / STEP_S, 2, MOST_EPOCHS)))
        rows = np.unique(np.searchsorted(t.gps_time_s, wanted).clip(0, len(t.gps_time_s) - 1))
        world = frame.world_from_geodetic(t.latitude_rad[rows], t.longitude_rad[rows], t.ellipsoid_height_m[rows])
        strip = np.full(len(rows), -1)
        for (number, name), (start, end) in windows.items():
            if number == sortie.folder.number:
                strip[(t.gps_time_s[rows] >= start) & (t.gps_time_s[rows] <= end)] = name
        out.append(Path3d(sortie=sortie.folder.number, map_m=frame.map_from_world(world), strip=strip))
    return out


def cameras(evaluation: Evaluation) -> tuple[list[CameraPose], list[str]]:
    """Every exposure that a trajectory covers, and what could not be placed, one line each."""
    data = evaluation.data
    poses: list[CameraPose] = []
    problems: list[str] = []
    for sortie in data.sorties if data else ():
        if data is None or sortie.trajectory is None or not sortie.exposures:
            continue
        try:
            poses += _sortie_cameras(evaluation, data, sortie)
        except TestrangeError as error:
            problems.append(in_folder(error, data.folder.root))
    if len(poses) > MOST_CAMERAS:
        problems.append(f"{len(poses) - MOST_CAMERAS} images are not shown; the page holds {MOST_CAMERAS}")
    return poses[:MOST_CAMERAS], problems


def _mounting(evaluation: Evaluation, data: CampaignData) -> Mounting | None:
    if evaluation.mounting is not None:
        return evaluation.mounting.body_from_camera
    return nominal_mountings(data.rig)[0] if data.rig is not None else None


def _sortie_cameras(evaluation: Evaluation, data: CampaignData, sortie: SortieData) -> list[CameraPose]:
    frame, trajectory, mounting = WorldFrame(data.manifest), sortie.trajectory, _mounting(evaluation, data)
    if trajectory is None:
        return []
    clock = evaluation.mounting.camera_clock_s if evaluation.mounting is not None else 0.0
    first, last = trajectory.gps_time_s[0], trajectory.gps_time_s[-1]
    exposures = [e for e in sortie.exposures if first <= e.gps_time_s - clock <= last]
    time = np.array([e.gps_time_s - clock for e in exposures])
    position, world_from_body = body_pose(trajectory, time, frame)
    rays = _corner_rays(data)
    corners: np.ndarray | None = None
    turned: np.ndarray | None = None
    if mounting is not None:
        position = position + world_from_body @ mounting.lever_arm_m
        if rays is not None:
            corners = np.einsum("nij,kj->nki", world_from_body @ mounting.rotation, rays)
        grid = frame.world_from_grid(frame.map_from_world(position))
        turned = np.swapaxes(grid, 1, 2) @ world_from_body @ mounting.rotation
    centres = frame.map_from_world(position)
    ground = (
        float(np.mean([t.height_m for t in data.targets])) if data.targets else frame.map_from_world(np.zeros(3))[2]
    )
    out = []
    for k, e in enumerate(exposures):
        ends = None
        if corners is not None:
            length = float(np.clip(FRUSTUM_SHARE * (centres[k, 2] - ground), 1.0, 60.0))
            ends = frame.map_from_world(position[k] + length * corners[k]) - centres[k]
        out.append(
            CameraPose(
                sortie=sortie.folder.number,
                strip=e.strip,
                image=e.image,
                gps_time_s=e.gps_time_s,
                centre_m=centres[k],
                corners_m=ends,
                map_from_camera=None if turned is None else turned[k],
                adjusted=evaluation.mounting is not None,
            )
        )
    return out


def _corner_rays(data: CampaignData) -> np.ndarray | None:
    """Directions of the image's four corners in the camera's frame, z = 1: (4, 3). None without a calibration."""
    camera = data.camera
    if camera is None or camera.calibration is None:
        return None
    try:
        xy = undistort(camera.calibration.lens, OUTLINE * (camera.width_px, camera.height_px))
    except np.linalg.LinAlgError:  # a lens that folds the image over
        return None
    rays = np.concatenate([xy, np.ones((4, 1))], axis=1)
    return rays if np.isfinite(rays).all() else None
