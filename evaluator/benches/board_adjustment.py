"""One Gauss-Newton problem of clause 9.2: images of a plane board, normal equations with the poses eliminated, damped steps.

All images go in as stacked arrays (k images, n corners of the board); a missing corner is NaN. The poses are eliminated (Schur
complement), so the solved system is 9 x 9. Start values, weights and blunders live in `camera_calibration`.
"""

from dataclasses import dataclass

import numpy as np
from pydantic import ValidationError

from campaign.config import Lens
from evaluator.camera_model import lens_from_vector, lens_vector, project_with_jacobian
from evaluator.model import EvaluationError

_MOST_ITERATIONS = 100


@dataclass(frozen=True, kw_only=True)
class Observations:
    """Corners of k images of one board with n inner corners."""

    board_m: np.ndarray  # (n, 3) in the board's frame, z = 0
    uv_px: np.ndarray  # (k, n, 2) image axes; NaN: not observed
    covariance_px2: np.ndarray  # (k, n, 2, 2)
    size_px: tuple[int, int]  # width, height


@dataclass(frozen=True, kw_only=True)
class Poses:
    """camera_from_board of each image."""

    rotation: np.ndarray  # (k, 3, 3)
    translation_m: np.ndarray  # (k, 3)


def board_points(columns: int, rows: int, square_m: float) -> np.ndarray:
    """(rows * columns, 3) inner corners in the board's frame, row by row; x along a row, y down, z away. [m]"""
    x, y = np.meshgrid(np.arange(columns) * square_m, np.arange(rows) * square_m)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


def skew(v: np.ndarray) -> np.ndarray:
    """(..., 3) -> (..., 3, 3), skew(a) b = a x b."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)


def rotation_exp(w: np.ndarray) -> np.ndarray:
    """Rodrigues: rotation vectors (..., 3) [rad] -> matrices (..., 3, 3)."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    k = skew(w)
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + a * k + b * (k @ k))


def moved(poses: Poses, step: np.ndarray) -> Poses:
    """Poses after an increment (k, 6): rotation vector [rad] about the board's origin, then translation [m]."""
    return Poses(rotation=rotation_exp(step[:, :3]) @ poses.rotation, translation_m=poses.translation_m + step[:, 3:])


def residuals_and_jacobian(
    lens: Lens, poses: Poses, board_m: np.ndarray, uv_px: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Observed minus projected, and how the projection moves.

    Parameters
    ----------
    lens : Lens
    poses : Poses
        k images.
    board_m : (n, 3) np.ndarray
        [m]
    uv_px : (k, n, 2) np.ndarray
        NaN: not observed. [px]

    Returns
    -------
    residual_px : (k, n, 2) np.ndarray
        NaN where not observed or not projectable. [px]
    d_lens : (k, n, 2, 9) np.ndarray
        d uv / d (fx fy cx cy k1 k2 k3 p1 p2).
    d_pose : (k, n, 2, 6) np.ndarray
        d uv / d (rotation vector, translation): the increment turns the board's points about the board's origin.

    References
    ----------
    GB/T 41450-2022, 9.2.2 e, formulas (16)-(18).
    """
    turned = np.einsum("kij,nj->kni", poses.rotation, board_m)
    uv, d_point, d_lens = project_with_jacobian(lens, turned + poses.translation_m[:, None])
    d_pose = np.concatenate([-d_point @ skew(turned), d_point], axis=-1)
    return uv_px - uv, d_lens, d_pose


@dataclass(frozen=True, kw_only=True)
class System:
    """Normal equations with the poses apart."""

    cost: float
    lens: np.ndarray  # (9, 9)
    cross: np.ndarray  # (k, 9, 6)
    pose: np.ndarray  # (k, 6, 6)
    lens_by_image: np.ndarray  # (k, 9) gradients
    pose_right: np.ndarray  # (k, 6)


def normal_system(lens: Lens, poses: Poses, obs: Observations, weight: np.ndarray) -> System:
    """`weight` (k, n, 2, 2) is zero for corners that take no part."""
    residual, d_lens, d_pose = residuals_and_jacobian(lens, poses, obs.board_m, obs.uv_px)
    off = ~np.any(weight != 0.0, axis=(-1, -2))
    if not np.all(np.isfinite(residual[~off])):
        return System(
            cost=np.inf, **dict.fromkeys(("lens", "cross", "pose", "lens_by_image", "pose_right"), np.empty(0))
        )
    residual = np.where(off[..., None], 0.0, residual)
    d_lens[off], d_pose[off] = 0.0, 0.0
    k = len(residual)
    weighted = (weight @ residual[..., None])[..., 0]
    b = d_lens.reshape(k, -1, 9)
    p = d_pose.reshape(k, -1, 6)
    wb, wp = (weight @ d_lens).reshape(k, -1, 9), (weight @ d_pose).reshape(k, -1, 6)
    flat = weighted.reshape(k, -1)
    return System(
        cost=float(np.sum(weighted * residual)),
        lens=(np.swapaxes(b, 1, 2) @ wb).sum(axis=0),
        cross=np.swapaxes(b, 1, 2) @ wp,
        pose=np.swapaxes(p, 1, 2) @ wp,
        lens_by_image=np.einsum("kmi,km->ki", b, flat),
        pose_right=np.einsum("kmi,km->ki", p, flat),
    )


def _damped(matrix: np.ndarray, damping: float) -> np.ndarray:
    out = matrix.copy()
    i = np.arange(matrix.shape[-1])
    out[..., i, i] += damping * matrix[..., i, i] + 1e-30
    return out


def reduced(s: System, damping: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Schur complement (9, 9), its right side by image (k, 9), and pose^-1 cross' (k, 6, 9)."""
    inverse_cross = np.linalg.solve(_damped(s.pose, damping), np.swapaxes(s.cross, 1, 2))
    matrix = _damped(s.lens, damping) - np.einsum("kij,kjl->il", s.cross, inverse_cross)
    right = s.lens_by_image - np.einsum("kji,kj->ki", inverse_cross, s.pose_right)
    return matrix, right, inverse_cross


def adjust(
    lens: Lens, poses: Poses, obs: Observations, weight: np.ndarray, free: np.ndarray, most: int = _MOST_ITERATIONS
) -> tuple[Lens, Poses, System, int]:
    """Levenberg-Marquardt on the free lens parameters (9,) bool and all poses; no free one: poses alone.

    Raises
    ------
    EvaluationError
        No convergence, or a point that the start values cannot project.
    """
    s = normal_system(lens, poses, obs, weight)
    if not np.isfinite(s.cost):
        raise EvaluationError("the start values of the calibration do not project the board")
    damping = 1e-4
    for iteration in range(1, most + 1):
        try:
            step_lens = np.zeros(9)
            if free.any():
                matrix, right, inverse_cross = reduced(s, damping)
                step_lens[free] = np.linalg.solve(matrix[np.ix_(free, free)], right.sum(axis=0)[free])
            step_pose = np.linalg.solve(_damped(s.pose, damping), s.pose_right[..., None])[..., 0]
            if free.any():
                step_pose = step_pose - inverse_cross @ step_lens
            new_lens = lens_from_vector(lens_vector(lens) + step_lens)
        except (np.linalg.LinAlgError, ValidationError):
            damping *= 10.0
            if damping > 1e12:
                break
            continue
        foreseen = float(s.lens_by_image.sum(axis=0) @ step_lens + np.sum(s.pose_right * step_pose))
        new_poses = moved(poses, step_pose)
        trial = normal_system(new_lens, new_poses, obs, weight)
        if foreseen <= 1e-12 * s.cost + 1e-20 and damping <= 1e-3:
            # A full step gains nothing: here rounding decides which way the cost goes. Parameters may still be 1e-6 of their
            # standard deviation off; the step makes that good.
            return (new_lens, new_poses, trial, iteration) if np.isfinite(trial.cost) else (lens, poses, s, iteration)
        if trial.cost <= s.cost * (1.0 + 1e-12):
            lens, poses, s = new_lens, new_poses, trial
            damping = max(damping * 0.1, 1e-10)
        else:
            damping *= 10.0
            if damping > 1e12:
                break
    raise EvaluationError(
        "the calibration does not converge", got=f"{most} iterations", remedy="more tilts and distances of the board"
    )


def poses_only(lens: Lens, poses: Poses, obs: Observations, weight: np.ndarray) -> Poses:
    """Best poses for a lens that is held fixed."""
    return adjust(lens, poses, obs, weight, np.zeros(9, bool))[1]
