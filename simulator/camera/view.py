"""The simulator's camera maths in NumPy: the pose of a frame, the lens, projection into a picture, boxes round the targets.

The evaluator has a camera of its own; a contract test compares the two. The renderer's inverse of the lens runs in its kernel
(simulator/render/radiance.py) and follows `undistort`. Pixel (0, 0) is the image's top left corner.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from campaign.config import Camera, Lens
from scenes.model import Scene
from simulator.flight.motion import Motion, SensorMounting

SUPPORT = 10  # scenes.model.Mesh.part of supports and stands: they need no samples of a target's quality
TARGET_MARGIN_PX = 6.0  # round a target's box: point spread, motion blur, and the ground that edges are fitted against
NEAR_M = 0.01  # nothing nearer to the projection centre has a pixel


@dataclass(frozen=True, kw_only=True)
class FramePose:
    """The camera in the world during one exposure: constant velocity and constant rate about the middle of it."""

    position_world_m: np.ndarray  # (3,) projection centre
    world_from_camera: np.ndarray  # (3, 3) at mid-exposure (rolling shutter: of the middle row)
    velocity_world_m_s: np.ndarray  # (3,)
    angular_rate_camera_rad_s: np.ndarray  # (3,) of the camera against the world, in camera axes
    gps_time_s: float  # true time of mid-exposure


def frame_pose(motion: Motion, mounting: SensorMounting, gps_time_s: float, half_span_s: float = 1e-3) -> FramePose:
    """Pose and its rates at one instant, the rates by central differences over `half_span_s` to both sides.

    Parameters
    ----------
    motion : Motion
        Of the body.
    mounting : SensorMounting
        body_from_camera, the true one.
    gps_time_s : float
        Mid-exposure. [s]
    half_span_s : float
        Give half the read-out time for a rolling shutter. [s]
    """
    times = gps_time_s + np.array([-half_span_s, 0.0, half_span_s])
    world_from_body = motion.world_from_body(times)
    position = motion.position(times) + world_from_body @ mounting.lever_arm_m
    world_from_camera = world_from_body @ mounting.rotation
    turn = Rotation.from_matrix(world_from_camera[0].T @ world_from_camera[2]).as_rotvec()
    return FramePose(
        position_world_m=position[1],
        world_from_camera=world_from_camera[1],
        velocity_world_m_s=(position[2] - position[0]) / (2 * half_span_s),
        angular_rate_camera_rad_s=turn / (2 * half_span_s),
        gps_time_s=float(gps_time_s),
    )


def distort(lens: Lens, xy: np.ndarray) -> np.ndarray:
    """Brown-Conrady distortion of normalised image coordinates x = X/Z, y = Y/Z.

    Parameters
    ----------
    xy : (..., 2) ndarray
        Undistorted. [1]

    Returns
    -------
    (..., 2) ndarray
        Distorted. [1]

    References
    ----------
    Brown, D. C. (1966), Decentering distortion of lenses, Photogrammetric Engineering 32(3). p1 and p2 in OpenCV's order.
    """
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    return np.stack(
        [
            x * radial + 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x * x),
            y * radial + lens.p1 * (r2 + 2 * y * y) + 2 * lens.p2 * x * y,
        ],
        axis=-1,
    )


def undistort_step(lens: Lens, xy_distorted: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """One step of the fixed point x = (x_d - tangential(x)) / radial(x), (..., 2) each."""
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    tangential = np.stack(
        [
            2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x * x),
            lens.p1 * (r2 + 2 * y * y) + 2 * lens.p2 * x * y,
        ],
        axis=-1,
    )
    return np.asarray((xy_distorted - tangential) / radial[..., None])


def undistort(lens: Lens, xy_distorted: np.ndarray, tolerance: float = 1e-12, iterations: int = 100) -> np.ndarray:
    """Inverse of `distort` to `tolerance`, (..., 2) -> (..., 2).

    Points that the lens model cannot reach (beyond the radius where it folds back) come back as NaN.
    """
    target = np.asarray(xy_distorted, float)
    xy = target.copy()
    with np.errstate(all="ignore"):
        for _ in range(iterations):
            previous, xy = xy, undistort_step(lens, target, xy)
            if not (np.abs(xy - previous) > tolerance).any():
                break
        failed = ~(np.abs(distort(lens, xy) - target).max(axis=-1) < 10 * tolerance)
    xy[failed] = np.nan
    return xy


def pixel_from_distorted(lens: Lens, xy_distorted: np.ndarray) -> np.ndarray:
    """Distorted normalised coordinates (..., 2) -> pixel (..., 2). [px]"""
    return xy_distorted * [lens.fx_px, lens.fy_px] + [lens.cx_px, lens.cy_px]


def distorted_from_pixel(lens: Lens, pixel: np.ndarray) -> np.ndarray:
    """Pixel (..., 2) -> distorted normalised coordinates (..., 2). [1]"""
    return (pixel - [lens.cx_px, lens.cy_px]) / [lens.fx_px, lens.fy_px]


def row_time_s(camera: Camera, v_px: np.ndarray) -> np.ndarray:
    """Time of a row's mid-exposure against the frame's mid-exposure, from the (observed) row coordinate. [s]"""
    if camera.shutter == "global":
        return np.zeros_like(v_px)
    return (v_px / camera.height_px - 0.5) * camera.readout_time_s


def camera_points(pose: FramePose, world_m: np.ndarray, offset_s: np.ndarray) -> np.ndarray:
    """World points (n, 3) in camera axes (n, 3) at `offset_s` (n,) after mid-exposure. [m]"""
    centre = pose.position_world_m + offset_s[:, None] * pose.velocity_world_m_s
    at_middle = (world_m - centre) @ pose.world_from_camera
    return Rotation.from_rotvec(-offset_s[:, None] * pose.angular_rate_camera_rad_s).apply(at_middle)


def project(camera: Camera, pose: FramePose, world_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where world points appear in the picture.

    Parameters
    ----------
    camera : Camera
        Lens, and shutter: with a rolling one the time of the point's own row is found by iteration.
    pose : FramePose
        Of the frame.
    world_m : (n, 3) ndarray
        World frame. [m]

    Returns
    -------
    pixel : (n, 2) ndarray
        From the image's top left corner; NaN behind the camera. May lie outside the image. [px]
    depth : (n,) ndarray
        Along the optical axis. [m]
    """
    world = np.atleast_2d(np.asarray(world_m, float))
    offset = np.zeros(len(world))
    rolling = camera.shutter == "rolling" and camera.readout_time_s > 0
    for _ in range(12 if rolling else 1):
        point = camera_points(pose, world, offset)
        depth = point[:, 2]
        xy = np.full((len(world), 2), np.nan)
        front = depth > NEAR_M
        xy[front] = point[front, :2] / depth[front, None]
        pixel = pixel_from_distorted(camera.lens, distort(camera.lens, xy))
        if rolling:
            v = np.clip(np.nan_to_num(pixel[:, 1]), -camera.height_px, 2 * camera.height_px)
            previous, offset = offset, row_time_s(camera, v)
            if np.abs(offset - previous).max(initial=0.0) < 1e-12:
                break
    return pixel, depth


def target_regions(camera: Camera, pose: FramePose, scene: Scene) -> list[tuple[int, int, int, int, int]]:
    """Boxes round the targets that a frame shows: (target index, u0, v0, u1, v1), u1 and v1 exclusive. [px]

    From the corners of the targets' true geometry without their stands; clipped to the image.
    """
    mesh = scene.mesh
    faces = np.flatnonzero((mesh.target >= 0) & (mesh.part != SUPPORT))
    corner = mesh.faces[faces].ravel()
    owner = np.repeat(mesh.target[faces], 3)
    pixel, depth = project(camera, pose, mesh.vertices_m[corner])
    # A point far outside the field may fold back into the image through the lens polynomial: ask the pinhole first.
    pinhole = camera_points(pose, mesh.vertices_m[corner], np.zeros(len(corner)))
    lens = camera.lens
    reach = 1.5 * np.array([camera.width_px / lens.fx_px, camera.height_px / lens.fy_px])
    with np.errstate(invalid="ignore", divide="ignore"):
        usable = (depth > NEAR_M) & (np.abs(pinhole[:, :2] / pinhole[:, 2:3]) < reach).all(axis=1)
    regions = []
    size = np.array([camera.width_px, camera.height_px])
    for index in np.unique(owner):
        own = (owner == index) & usable
        if not own.any():
            continue
        low = np.clip(np.floor(pixel[own].min(axis=0) - TARGET_MARGIN_PX), 0, size).astype(int)
        high = np.clip(np.ceil(pixel[own].max(axis=0) + TARGET_MARGIN_PX), 0, size).astype(int)
        if (high > low).all():
            regions.append((int(index), int(low[0]), int(low[1]), int(high[0]), int(high[1])))
    return regions
