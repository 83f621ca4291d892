"""Extra `rerun`: a campaign as an .rrd recording with its time line: trajectory, camera with reduced images, points as scanned.

Places are map coordinates minus an origin in whole metres, z up; the time line is UTC. What stands still (ground, targets) has
no time. Which points are shown is decided by evaluator.view, as for view.html. The recording's own row numbers are made of the
time of writing by the SDK: two recordings hold the same data, not the same bytes.
"""

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import matplotlib
import numpy as np

from campaign.errors import TestrangeError
from campaign.flight.images import read_preview
from campaign.flight.trajectory import ADJUSTED_OFFSET_S
from campaign.writing.atomic import complete_file
from evaluator.frames import WorldFrame, body_pose
from evaluator.model import CampaignData
from evaluator.results import Evaluation
from evaluator.view import flight, solids
from evaluator.view.model import Cloud, TruthErrors
from evaluator.view.points import sample_cloud
from evaluator.view.terrain import best_map, grid_terrain

if TYPE_CHECKING:
    from rerun import RecordingStream

TIME_LINE = "utc"
GPS_EPOCH_UNIX_S = 315_964_800.0  # 1980-01-06
SLICE_S = 0.5  # of points that appear together
POSE_STEP_S = 0.1
IMAGE_WIDTH_PX = 960
MOST_IMAGES = 300
EXTRA = "rerun"


def _refuse_without_extra() -> None:
    if importlib.util.find_spec("rerun") is None:
        raise TestrangeError(
            "rerun-sdk is not installed",
            where="--rerun",
            remedy=".venv/bin/python -m pip install rerun-sdk, or pip of whatever environment runs testrange",
        )


def unix_time_s(data: CampaignData, gps_time_s: np.ndarray) -> np.ndarray:
    """Adjusted standard GPS time (n,) -> seconds since 1970 UTC (n,). [s]"""
    return np.asarray(gps_time_s) + ADJUSTED_OFFSET_S + GPS_EPOCH_UNIX_S - data.manifest.gps_minus_utc_s


def write_rrd(path: Path, evaluation: Evaluation, truth_errors: TruthErrors | None = None) -> list[str]:
    """Writes the recording; returns what could not be shown, one line each.

    Parameters
    ----------
    path : Path
        File to write, *.rrd.
    evaluation : Evaluation
        With `data`, the campaign as read.
    truth_errors : TruthErrors, optional
        `evaluator.scores.score_points.point_errors(root)`; errors then stand beside each slice of points.

    Raises
    ------
    TestrangeError
        The extra is not installed, or there is no campaign to show.
    """
    _refuse_without_extra()
    import rerun as rr

    data = evaluation.data
    if data is None:
        raise TestrangeError("the evaluation was made without its campaign", where=str(path))
    cloud = sample_cloud(evaluation, truth_errors)
    poses, problems = flight.cameras(evaluation)
    problems = [*cloud.problems, *problems]
    origin = np.floor(WorldFrame(data.manifest).map_from_world(np.zeros(3)))
    with complete_file(path) as work:
        recording = rr.RecordingStream("testrange", recording_id=evaluation.campaign, send_properties=False)
        for automatic in ("log_time", "log_tick"):
            recording.disable_timeline(automatic)
        recording.save(work)
        try:
            recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            _still(recording, evaluation, data, cloud, origin)
            _moving(recording, evaluation, data, origin)
            problems += _images(recording, data, poses, origin)
            _points(recording, data, cloud, origin)
        finally:
            recording.flush()
            recording.disconnect()
    return problems


def _still(
    recording: "RecordingStream", evaluation: Evaluation, data: CampaignData, cloud: Cloud, origin: np.ndarray
) -> None:
    """Ground, targets, trajectories as lines."""
    import rerun as rr

    terrain = grid_terrain(cloud)
    if terrain is not None:
        rows, columns = terrain.height_m.shape
        y, x = np.mgrid[:rows, :columns]
        place = np.stack(
            [terrain.low_m[0] + x * terrain.cell_m, terrain.low_m[1] + y * terrain.cell_m, terrain.height_m]
        )
        corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
        quads = np.stack([corner, corner + 1, corner + columns + 1, corner + columns], axis=1)
        quads = quads[np.isfinite(terrain.height_m.ravel()[quads]).all(axis=1)]
        at = np.nan_to_num(place.reshape(3, -1).T - origin)
        mesh = rr.Mesh3D(
            vertex_positions=at,
            triangle_indices=np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]),
            albedo_factor=[96, 104, 88],
        )
        recording.log("world/terrain", mesh, static=True)
    for t in data.targets:
        shape = solids.template(*solids.form(t))
        a = np.radians(t.azimuth_deg)
        turn = np.array([[np.cos(a), np.sin(a), 0.0], [-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
        centre = np.array([t.easting_m, t.northing_m, t.height_m]) - origin
        corners = centre + t.size_m * (shape.xyz.astype(float) @ turn.T)
        own = (t.nominal_reflectance_percent or 50.0) / 100.0
        grey = np.rint(255.0 * np.clip(np.where(shape.grey < 0.0, own, shape.grey), 0.02, 1.0) ** 0.55)
        colour = np.repeat(grey.astype(np.uint8), 3)[:, None].repeat(3, axis=1)
        recording.log(f"world/targets/{t.id}", rr.Mesh3D(vertex_positions=corners, vertex_colors=colour), static=True)
        recording.log(f"world/targets/{t.id}/label", rr.Points3D([centre], labels=[t.id], radii=[0.02]), static=True)
    for track in flight.paths(evaluation):
        line = rr.LineStrips3D([track.map_m - origin])
        recording.log(f"world/trajectory/sortie_{track.sortie:02d}", line, static=True)


def _moving(recording: "RecordingStream", evaluation: Evaluation, data: CampaignData, origin: np.ndarray) -> None:
    """The body's pose along each trajectory; its axes are forward, right, down."""
    import rerun as rr

    frame = WorldFrame(data.manifest)
    for sortie in data.sorties:
        if sortie.trajectory is None or len(sortie.trajectory.gps_time_s) < 2:
            continue
        begin, end = (float(t) for t in sortie.trajectory.gps_time_s[[0, -1]])
        time = np.linspace(begin, end, max(2, min(20_000, int((end - begin) / POSE_STEP_S))))
        position, world_from_body = body_pose(sortie.trajectory, time, frame)
        place = frame.map_from_world(position)
        turned = np.swapaxes(frame.world_from_grid(place), 1, 2) @ world_from_body
        entity = f"world/body/sortie_{sortie.folder.number:02d}"
        axes = rr.Arrows3D(vectors=3.0 * np.eye(3), colors=[[230, 80, 60], [60, 180, 90], [70, 120, 230]])
        recording.log(f"{entity}/axes", axes, static=True)
        recording.send_columns(
            entity,
            indexes=[rr.TimeColumn(TIME_LINE, timestamp=unix_time_s(data, time))],
            columns=rr.Transform3D.columns(
                translation=place - origin,
                mat3x3=np.swapaxes(turned, 1, 2).reshape(-1, 9),  # column by column
            ),
        )


def _images(
    recording: "RecordingStream", data: CampaignData, poses: list[flight.CameraPose], origin: np.ndarray
) -> list[str]:
    """The camera at each exposure with its image, reduced; what has no preview shows its frustum alone."""
    import rerun as rr

    problems: list[str] = []
    camera = data.camera
    if camera is None or camera.calibration is None:
        return ["sensors/camera.json: no calibration, so no image is placed"]
    step = max(1, -(-len(poses) // MOST_IMAGES))
    folders = {s.folder.number: s.folder for s in data.sorties}
    for pose in poses[::step]:
        if pose.map_from_camera is None:
            continue
        recording.set_time(TIME_LINE, timestamp=float(unix_time_s(data, np.array(pose.gps_time_s))))
        entity = f"world/camera/sortie_{pose.sortie:02d}"
        recording.log(entity, rr.Transform3D(translation=pose.centre_m - origin, mat3x3=pose.map_from_camera))
        recording.log(f"{entity}/name", rr.TextLog(pose.image))
        scale = min(1.0, IMAGE_WIDTH_PX / camera.width_px)
        size = (round(camera.width_px * scale), round(camera.height_px * scale))
        lens = camera.calibration.lens
        pinhole = rr.Pinhole(
            resolution=size,
            focal_length=(lens.fx_px * scale, lens.fy_px * scale),
            principal_point=(lens.cx_px * scale, lens.cy_px * scale),
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=6.0,
        )
        recording.log(f"{entity}/image", pinhole)
        try:
            preview = data.folder.held((folders[pose.sortie].images / pose.image).with_suffix(".jpg"))
            pixels = read_preview(preview, width_px=camera.width_px, height_px=camera.height_px)
        except TestrangeError as error:
            problems.append(str(error).replace(f"{data.folder.root}/", ""))
            continue
        small = cv2.resize(pixels[:, :, ::-1], size, interpolation=cv2.INTER_AREA)
        done, coded = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])
        if done:
            recording.log(f"{entity}/image", rr.EncodedImage(contents=coded.tobytes(), media_type="image/jpeg"))
    return problems


def _points(recording: "RecordingStream", data: CampaignData, cloud: Cloud, origin: np.ndarray) -> None:
    """Points in slices of time, coloured by reflectance; a slice stays once it has appeared."""
    import rerun as rr

    place = best_map(cloud) - origin if cloud.strips else np.zeros((0, 3))
    bright = np.clip(np.nan_to_num(cloud.joined("reflectance"), nan=0.4), 0.0, 1.0) if cloud.strips else np.zeros(0)
    colour = (255.0 * matplotlib.colormaps["cividis"](bright)[:, :3]).astype(np.uint8)
    first = 0
    for s in cloud.strips:
        rows = np.arange(first, first + len(s.record))
        first += len(s.record)
        known = np.flatnonzero(np.isfinite(s.gps_time_s))
        if not known.size:
            continue
        slices = np.floor((s.gps_time_s[known] - s.gps_time_s[known].min()) / SLICE_S).astype(int)
        error = np.where(np.isfinite(s.error_m[1]), s.error_m[1], s.error_m[0])
        for number in np.unique(slices).tolist():
            part = known[slices == number]
            begin = float(unix_time_s(data, s.gps_time_s[part].min()))
            recording.set_time(TIME_LINE, timestamp=begin)
            entity = f"world/points/sortie_{s.sortie:02d}/strip_{s.strip:02d}/{number:04d}"
            points = rr.Points3D(place[rows[part]], colors=colour[rows[part]], radii=[0.02])
            recording.log(entity, points)
            if np.isfinite(error[part]).any():
                values = rr.AnyValues(error_m=np.nan_to_num(error[part], nan=-1.0).astype(np.float32))
                recording.log(entity, values)
