"""The evaluator's camera: Brown-Conrady projection with analytic derivatives, removal of distortion, world to pixel.

Image axes (3.13): origin at the image's top left corner, the first pixel's centre at (0.5, 0.5); camera axes x right, y down,
z forward. Camera calibration from chessboards does not live here.
"""

import numpy as np

from campaign.config import Lens
from campaign.flight.trajectory import Trajectory
from campaign.sensors import CameraSheet
from evaluator.frames import WorldFrame, body_pose
from evaluator.model import Mounting

LENS_NAMES = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "k3", "p1", "p2")


def lens_vector(lens: Lens) -> np.ndarray:
    """(9,) fx fy cx cy k1 k2 k3 p1 p2, the order of every covariance."""
    return np.array([getattr(lens, name) for name in LENS_NAMES], dtype=np.float64)


def lens_from_vector(values: np.ndarray) -> Lens:
    """Inverse of `lens_vector`."""
    return Lens(**{name: float(v) for name, v in zip(LENS_NAMES, values, strict=True)})


def _distort(k: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distorted normalised coordinates, (n,) each; the radial factor and the squared radius come with them."""
    k1, k2, k3, p1, p2 = k
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return xd, yd, radial, r2


def _distort_jacobian(k: np.ndarray, x: np.ndarray, y: np.ndarray, radial: np.ndarray, r2: np.ndarray) -> np.ndarray:
    """d(xd, yd)/d(x, y), (n, 2, 2); symmetric."""
    k1, k2, k3, p1, p2 = k
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))  # d radial = slope (x dx + y dy)
    out = np.empty((*x.shape, 2, 2))
    out[..., 0, 0] = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    out[..., 0, 1] = out[..., 1, 0] = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    out[..., 1, 1] = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return out


def project_with_jacobian(lens: Lens, p_camera_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixel coordinates of camera points and their derivatives.

    Parameters
    ----------
    lens : Lens
    p_camera_m : (n, 3) np.ndarray
        Points, x right, y down, z forward. [m]

    Returns
    -------
    uv_px : (n, 2) np.ndarray
        NaN behind the camera and where the distortion polynomial folds back. [px]
    d_point : (n, 2, 3) np.ndarray
        d uv / d p. [px/m]
    d_lens : (n, 2, 9) np.ndarray
        d uv / d (fx fy cx cy k1 k2 k3 p1 p2).

    References
    ----------
    Brown, Close-range camera calibration, Photogrammetric Engineering 37(8), 1971; GB/T 41450-2022, 9.3.2, formula (22), in
    image axes.
    """
    p = np.asarray(p_camera_m, dtype=np.float64)
    v = lens_vector(lens)
    f, c, k = v[0:2], v[2:4], v[4:]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        inverse = np.where(p[..., 2] > 0.0, 1.0 / p[..., 2], np.nan)
        x, y = p[..., 0] * inverse, p[..., 1] * inverse
        xd, yd, radial, r2 = _distort(k, x, y)
        growth = 1.0 + r2 * (3.0 * k[0] + r2 * (5.0 * k[1] + r2 * 7.0 * k[2]))
        folded = ~(growth > 0.0)
        inner = _distort_jacobian(k, x, y, radial, r2)
        uv = np.stack([f[0] * xd + c[0], f[1] * yd + c[1]], axis=-1)
    uv[folded] = np.nan
    normalised = np.zeros((*x.shape, 2, 3))
    normalised[..., 0, 0] = normalised[..., 1, 1] = inverse
    normalised[..., 0, 2], normalised[..., 1, 2] = -x * inverse, -y * inverse
    d_point = f[:, None] * (inner @ normalised)
    d_lens = np.zeros((*x.shape, 2, 9))
    d_lens[..., 0, 0], d_lens[..., 1, 1] = xd, yd
    d_lens[..., 0, 2] = d_lens[..., 1, 3] = 1.0
    for power in range(3):
        d_lens[..., 0, 4 + power] = f[0] * x * r2 ** (power + 1)
        d_lens[..., 1, 4 + power] = f[1] * y * r2 ** (power + 1)
    d_lens[..., 0, 7], d_lens[..., 1, 7] = f[0] * 2.0 * x * y, f[1] * (r2 + 2.0 * y * y)
    d_lens[..., 0, 8], d_lens[..., 1, 8] = f[0] * (r2 + 2.0 * x * x), f[1] * 2.0 * x * y
    return uv, d_point, d_lens


def project(lens: Lens, p_camera_m: np.ndarray) -> np.ndarray:
    """Camera points (n, 3) [m] -> distorted pixels (n, 2); NaN behind the camera."""
    return project_with_jacobian(lens, p_camera_m)[0]


def undistort(lens: Lens, uv_px: np.ndarray) -> np.ndarray:
    """Distorted pixels (n, 2) -> normalised coordinates x/z, y/z (n, 2), by Newton's method to 1e-12."""
    uv = np.asarray(uv_px, dtype=np.float64)
    v = lens_vector(lens)
    target = (uv - v[2:4]) / v[0:2]
    xy = target.copy()
    for _ in range(30):
        x, y = xy[..., 0], xy[..., 1]
        xd, yd, radial, r2 = _distort(v[4:], x, y)
        step = np.linalg.solve(
            _distort_jacobian(v[4:], x, y, radial, r2), (target - np.stack([xd, yd], axis=-1))[..., None]
        )[..., 0]
        xy = xy + step
        if not np.any(np.abs(step) > 1e-13):
            break
    return xy


def undistorted_px(lens: Lens, uv_px: np.ndarray) -> np.ndarray:
    """Distorted pixels (n, 2) -> pixels of the ideal camera with the same fx, fy, cx, cy. [px]"""
    v = lens_vector(lens)
    return np.asarray(undistort(lens, uv_px) * v[0:2] + v[2:4])


def ideal_px(lens: Lens, p_camera_m: np.ndarray) -> np.ndarray:
    """s [u v 1] = K p, formula (24): camera points (n, 3) -> undistorted pixels (n, 2)."""
    p = np.asarray(p_camera_m, dtype=np.float64)
    v = lens_vector(lens)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(p[..., 2:] > 0.0, p[..., :2] / p[..., 2:], np.nan) * v[0:2] + v[2:4])


def row_time(camera: CameraSheet, exposure_gps_time_s: float, v_px: np.ndarray) -> np.ndarray:
    """Time at which image row v was exposed; the stamp is the middle of the exposure of the middle row. [s]"""
    rows = np.asarray(v_px, dtype=np.float64)
    if camera.shutter == "global" or camera.readout_time_s == 0.0:
        return np.full(rows.shape, exposure_gps_time_s)
    return np.asarray(exposure_gps_time_s + (rows / camera.height_px - 0.5) * camera.readout_time_s)


def camera_points(
    mounting: Mounting,
    trajectory: Trajectory,
    gps_time_s: np.ndarray,
    world_m: np.ndarray,
    world_frame: WorldFrame,
) -> np.ndarray:
    """World points (n, 3) seen at times (n,) -> camera frame (n, 3). [m]"""
    position, world_from_body = body_pose(trajectory, gps_time_s, world_frame)
    in_body = np.einsum("nji,nj->ni", world_from_body, np.asarray(world_m) - position)
    return np.asarray((in_body - mounting.lever_arm_m) @ mounting.rotation)


def project_world(
    lens: Lens,
    mounting: Mounting,
    trajectory: Trajectory,
    gps_time_s: np.ndarray,
    world_m: np.ndarray,
    world_frame: WorldFrame,
) -> np.ndarray:
    """World points (n, 3) [m] seen at times (n,) [s] -> distorted pixels (n, 2); NaN behind the camera."""
    return project(lens, camera_points(mounting, trajectory, gps_time_s, world_m, world_frame))


def project_exposure(
    camera: CameraSheet,
    lens: Lens,
    mounting: Mounting,
    trajectory: Trajectory,
    exposure_gps_time_s: float,
    world_m: np.ndarray,
    world_frame: WorldFrame,
) -> tuple[np.ndarray, np.ndarray]:
    """World points (n, 3) in one image, each at its own row's time: (pixels (n, 2), times (n,))."""
    world = np.atleast_2d(world_m)
    time = np.full(len(world), exposure_gps_time_s)
    uv = project_world(lens, mounting, trajectory, time, world, world_frame)
    if camera.shutter == "rolling" and camera.readout_time_s > 0.0:
        for _ in range(3):
            rows = np.clip(np.where(np.isfinite(uv[:, 1]), uv[:, 1], 0.0), 0.0, camera.height_px)
            time = row_time(camera, exposure_gps_time_s, rows)
            uv = project_world(lens, mounting, trajectory, time, world, world_frame)
    return uv, time
