"""The standard's own reading of (21)-(24): one rigid camera_from_lidar, as if a target were seen by both sensors in one instant.

A companion figure. In flight the two sensors see a target seconds apart and an error of the LiDAR's own mounting does not
cancel, which the joint solution (`adjustment`) takes into account.
"""

import numpy as np

from campaign.config import Lens
from evaluator.camera_model import ideal_px, project_with_jacobian, undistorted_px
from evaluator.frames import body_pose, euler_rates, euler_rotation, skew
from evaluator.georeference import nominal_mountings
from evaluator.model import EvaluationError
from evaluator.mounting.adjustment import camera_from_lidar
from evaluator.mounting.mounting_model import Problem


def rigid_by_pixels(
    lens: Lens, p_lidar_m: np.ndarray, uv_px: np.ndarray, nominal: np.ndarray, translation_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The rigid camera_from_lidar whose pixels come nearest to the observed ones, by Gauss-Newton.

    Parameters
    ----------
    lens : Lens
        Its distortion is part of the projection.
    p_lidar_m : (n, 3) np.ndarray
        Vertices in the LiDAR's frame. [m]
    uv_px : (n, 2) np.ndarray
        Marks as observed; every pixel has the same weight. [px]
    nominal : (3, 3) np.ndarray
        Rotation of camera_from_lidar as drawn, where the angles are zero.
    translation_m : (3,) np.ndarray
        To begin with. [m]

    Returns
    -------
    roll_pitch_yaw_rad, translation_m : (3,) np.ndarray
        camera_from_lidar is p = nominal R(roll, pitch, yaw) p_lidar + translation. [rad], [m]

    Raises
    ------
    EvaluationError
        A mark leaves the camera's field, or 30 iterations do not reach 1e-10 rad and 1e-8 m, after which one more follows.

    References
    ----------
    GB/T 41450-2022, 9.3.2 f-i, formulas (21)-(24).
    """
    x = np.concatenate([np.zeros(3), translation_m])
    close = False
    for _ in range(30):
        turned = p_lidar_m @ euler_rotation(*x[:3]).T
        uv, by_point, _ = project_with_jacobian(lens, turned @ nominal.T + x[3:])
        if not np.all(np.isfinite(uv)):
            raise EvaluationError("a mark left the camera's field")
        design = np.zeros((len(uv_px), 2, 6))
        design[:, :, :3] = by_point @ (nominal @ -skew(turned) @ euler_rates(x[:3]))
        design[:, :, 3:] = by_point
        step, *_ = np.linalg.lstsq(design.reshape(-1, 6), (uv_px - uv).ravel(), rcond=None)
        x = x + step
        if close:
            return x[:3], x[3:]
        close = bool(np.abs(step[:3]).max() < 1e-10 and np.abs(step[3:]).max() < 1e-8)  # then one step more
    raise EvaluationError("no convergence")


def solve_single_instant(problem: Problem, places_world_m: dict[tuple[int, int, str], np.ndarray]) -> dict[str, object]:
    """Six parameters of (21)-(23) by Gauss-Newton on the pixel residuals.

    Parameters
    ----------
    problem : Problem
    places_world_m : dict
        (sortie, strip, target) -> mark by the LiDAR in that strip, through the *nominal* mounting. An image is paired with
        the scan of its own strip, the nearest in time. [m]

    Returns
    -------
    dict
        `p_m_px`, `roll_pitch_yaw_deg` of nominal^-1 * estimated, `translation_m`; or `reason`.

    References
    ----------
    GB/T 41450-2022, 9.3.2 f-i, formulas (21)-(24).
    """
    camera, lidar = nominal_mountings(problem.rig)
    marks = [m for m in problem.marks if (m.sortie, m.strip, m.target) in places_world_m]
    if len(marks) < 4:
        return {"reason": f"{len(marks)} marks with a vertex, 4 are needed"}
    points = np.zeros((len(marks), 3))  # in the LiDAR frame at the image's instant
    for i, m in enumerate(marks):
        position, world_from_body = body_pose(
            problem.trajectories[m.sortie], np.array([m.gps_time_s]), problem.world_frame
        )
        in_body = world_from_body[0].T @ (places_world_m[m.sortie, m.strip, m.target] - position[0])
        points[i] = lidar.rotation.T @ (in_body - lidar.lever_arm_m)
    reference, translation = camera_from_lidar(camera, lidar)
    observed = np.array([m.uv_px for m in marks])
    try:
        rpy, translation = rigid_by_pixels(problem.lens, points, observed, reference, translation)
    except EvaluationError as error:
        return {"reason": str(error)}
    p = points @ euler_rotation(*rpy).T @ reference.T + translation
    norms = np.linalg.norm(ideal_px(problem.lens, p) - undistorted_px(problem.lens, observed), axis=1)
    names = np.array([m.target for m in marks])
    return {
        "p_m_px": float(np.mean([norms[names == t].mean() for t in np.unique(names)])),
        "roll_pitch_yaw_deg": [float(a) for a in np.degrees(rpy)],
        "translation_m": [float(a) for a in translation],
    }
