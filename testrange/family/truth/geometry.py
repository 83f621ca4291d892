"""True M_z and P_m: noise-free corners and marks with the picture's ripple, and the adjustments of 9.2.2 f and 9.3.2 i written
anew, by least squares with numerical derivatives. Projection is the simulator's.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from campaign.config import Config, Lens
from scenes.build import build_scene
from scenes.chessboard import board_of
from simulator.bench.placements import Placement, bench_lens, plan_placements, project_board
from simulator.camera.ripple import ripple_px
from simulator.camera.view import frame_pose, project, undistort
from simulator.faults import with_true_lens
from simulator.flight import rig
from simulator.flight.plan import fly
from simulator.randomness import scene_seed

_LENS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "k3", "p1", "p2")
_LENS_STEP = np.array([1e-2, 1e-2, 1e-2, 1e-2, 1e-5, 1e-5, 1e-5, 1e-6, 1e-6])
_CORNER_STD_PX = 0.004  # how well a corner is found, one axis
# Of the shimmer: what a finder averages away inside its window, and what an evaluator's weights of images make of it.
_BOARD_SHARE, _MARK_SHARE = 0.012, 0.005
# A picture whose point spread is narrower than a pixel is not carried on exactly by the ripple's cubic interpolation: a sharp edge
# that is displaced by 0.05, 0.15, 0.3, 0.5, 0.75 px moves by 0.947, 0.954, 0.974, 1.000, 1.011 of that (numbers of an edge alone).
_WARP_SHARE, _WARP_PX = 0.045, 0.008


@dataclass(frozen=True, kw_only=True)
class TrueError:
    """A mean error in pixels, the standard uncertainty of one measurement, and what mistakes would give."""

    value_px: float
    std_px: float
    mistakes: dict[str, float] = field(default_factory=dict)


def _ideal(lens: Lens, pixel: np.ndarray) -> np.ndarray:
    """Distortion removed. [px]"""
    xy = undistort(lens, (pixel - [lens.cx_px, lens.cy_px]) / [lens.fx_px, lens.fy_px])
    return np.asarray(xy * [lens.fx_px, lens.fy_px] + [lens.cx_px, lens.cy_px])


def _solved(predict: Callable[[np.ndarray], np.ndarray], observed: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Gauss-Newton with central differences."""
    x = np.zeros(len(steps))
    for _ in range(6):
        base = predict(x)
        design = np.empty((base.size, len(steps)))
        for j, step in enumerate(steps):
            move = np.zeros(len(steps))
            move[j] = step
            design[:, j] = (predict(x + move) - predict(x - move)).ravel() / 2.0
        change = np.linalg.lstsq(design, (observed - base).ravel(), rcond=None)[0]
        x = x + change * steps
        if np.abs(change).max() < 1e-6:
            break
    return x


class Chessboard:
    """Of one configuration; asked many times with other ripples."""

    def __init__(self, config: Config) -> None:
        self._config = with_true_lens(config)
        self._board = board_of(self._config.bench.chessboard).corners_m()
        self._plan: tuple[Placement, ...] = plan_placements(self._config)
        self._lens = bench_lens(self._config)
        self._pixel = np.stack([project_board(self._lens, p, self._board) for p in self._plan])

    def _lens_of(self, x: np.ndarray) -> Lens:
        values = {name: getattr(self._lens, name) + float(v) for name, v in zip(_LENS, x, strict=True)}
        return Lens(**values)

    def _image(self, lens: Lens, k: int, pose: np.ndarray) -> np.ndarray:
        place = self._plan[k]
        moved = Placement(
            distance_m=place.distance_m,
            rotation=Rotation.from_rotvec(pose[:3]).as_matrix() @ place.rotation,
            translation_m=place.translation_m + pose[3:],
        )
        return project_board(lens, moved, self._board)

    def value(self, amplitude_px: float) -> TrueError:
        """Formula (19) after the adjustment of lens and poses."""
        faults = self._config.faults.model_copy(update={"image_ripple_px": amplitude_px})
        observed = np.stack([uv + ripple_px(faults, uv, f"b_{k:03d}") for k, uv in enumerate(self._pixel, start=1)])
        lens, poses = self._adjusted(observed)
        errors, rms = [], []
        for k in range(len(self._plan)):
            ideal = _ideal(lens, self._image(lens, k, poses[k])) - _ideal(lens, observed[k])
            errors.append(np.linalg.norm(ideal, axis=1))
            rms.append(ideal)
        norm = np.concatenate(errors)
        squares = float(np.mean(np.sum(np.concatenate(rms) ** 2, axis=1)))
        # noise of the corners adds to every residual: mean of |r + e| to second order, and its own mean where r is small
        rng = np.random.default_rng(919)
        noisy = np.concatenate(rms) + _CORNER_STD_PX * rng.standard_normal((norm.size, 2))
        mean = float(np.mean(np.linalg.norm(noisy, axis=1)))
        std = np.hypot(_BOARD_SHARE * mean, _CORNER_STD_PX / np.sqrt(norm.size))
        std = np.hypot(std, min(_WARP_SHARE * mean, _WARP_PX))
        std = float(np.hypot(std, mean - float(norm.mean())))
        return TrueError(
            value_px=mean,
            std_px=max(std, 1e-4),
            mistakes={
                "root mean square in the place of the mean": float(np.sqrt(squares + 2.0 * _CORNER_STD_PX**2)),
                "components in the place of norms": float(np.sqrt(squares / 2.0)),
            },
        )

    def _adjusted(self, observed: np.ndarray) -> tuple[Lens, np.ndarray]:
        """Nine of the lens and six of each image, by normal equations with the images eliminated one by one."""
        x = np.zeros(9)
        poses = np.zeros((len(self._plan), 6))
        for _ in range(40):
            lens = self._lens_of(x)
            normal, right = np.zeros((9, 9)), np.zeros(9)
            kept = []
            for k in range(len(self._plan)):
                a, b, r = self._linearised(lens, x, k, poses[k], observed[k])
                inverse = np.linalg.inv(b.T @ b)
                gain = a.T @ b @ inverse
                normal += a.T @ a - gain @ (b.T @ a)
                right += a.T @ r - gain @ (b.T @ r)
                kept.append((inverse, b.T @ a, b.T @ r))
            change = np.linalg.solve(normal, right)
            for k, (inverse, ba, br) in enumerate(kept):
                poses[k] += inverse @ (br - ba @ change) * 1e-4
            x = x + change * _LENS_STEP
            if np.abs(change).max() < 1e-2:  # steps of a hundredth of a pixel or less
                break
        return self._lens_of(x), poses

    def _linearised(
        self, lens: Lens, x: np.ndarray, k: int, pose: np.ndarray, observed: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """By the lens in its steps, by the pose in 1e-4, and what is left."""
        base = self._image(lens, k, pose)
        a = np.empty((base.size, 9))
        for j, step in enumerate(_LENS_STEP):
            move = np.zeros(9)
            move[j] = step
            ahead, behind = (self._image(self._lens_of(x + s * move), k, pose) for s in (1.0, -1.0))
            a[:, j] = (ahead - behind).ravel() / 2.0
        b = np.empty((base.size, 6))
        for j in range(6):
            move = np.zeros(6)
            move[j] = 1e-4
            b[:, j] = (self._image(lens, k, pose + move) - self._image(lens, k, pose - move)).ravel() / 2.0
        return a, b, (observed - base).ravel()


@dataclass(frozen=True, kw_only=True)
class TrueCalibration:
    """P_m, and by how much the ripple turns and moves the camera's mounting, with the spread by noise."""

    error: TrueError
    boresight_deg: np.ndarray  # (3,) roll, pitch, yaw: added to the fault's
    lever_arm_m: np.ndarray  # (3,)
    boresight_std_deg: np.ndarray
    lever_arm_std_m: np.ndarray


class Calibration:
    """Marks of one configuration in all of its images; asked many times with other ripples. Navigation is taken as perfect, and
    the LiDAR's mounting as found: what is left is the picture's own error, and the noise of vertices."""

    def __init__(self, config: Config, vertex_std_m: float, mark_std_px: float) -> None:
        self._config = with_true_lens(config)
        self._noise = vertex_std_m, mark_std_px
        fixed = config.model_copy(update={"seed": scene_seed(config)})
        scene = build_scene(fixed)
        camera = self._config.camera
        frustums = [t for t in scene.targets if t.kind == "frustum"]
        marks = np.stack([t.mark_m for t in frustums])
        mounting = rig.true_camera(config)
        self._views = []
        for sortie in fly(fixed, scene.layout):
            for strip in sortie.strips:
                for number, time in enumerate(strip.exposure_s, start=1):
                    name = f"s{sortie.number:02d}_l{strip.number:02d}_{number:03d}"
                    pose = frame_pose(sortie.motion, mounting, time)
                    pixel, depth = project(camera, pose, marks)
                    edge = 12.0
                    inside = (depth > 0) & (pixel > edge).all(axis=1)
                    inside &= (pixel < [camera.width_px - edge, camera.height_px - edge]).all(axis=1)
                    world_from_body = sortie.motion.world_from_body(np.array([time]))[0]
                    in_body = (marks - sortie.motion.position(np.array([time]))[0]) @ world_from_body
                    self._views.append((in_body[inside], pixel[inside], np.flatnonzero(inside), strip.height_m, name))
        self._rotation, self._lever = mounting.rotation, mounting.lever_arm_m

    def _predict(self, x: np.ndarray) -> np.ndarray:
        """Ideal pixels of all marks with the camera's mounting turned and moved by x, body axes."""
        lens = self._config.camera.lens
        rotation = Rotation.from_rotvec(x[:3]).as_matrix() @ self._rotation
        out = []
        for in_body, *_ in self._views:
            p = (in_body - self._lever - x[3:]) @ rotation
            out.append(p[:, :2] / p[:, 2:] * [lens.fx_px, lens.fy_px] + [lens.cx_px, lens.cy_px])
        return np.concatenate(out)

    def value(self, amplitude_px: float, replicates: int) -> TrueCalibration:
        """Formula (20) after the adjustment of the camera's mounting, the mean over replicates of noise."""
        faults = self._config.faults.model_copy(update={"image_ripple_px": amplitude_px})
        lens = self._config.camera.lens
        seen = np.concatenate([uv + ripple_px(faults, uv, name) for _, uv, _, _, name in self._views])
        observed = _ideal(lens, seen)
        target = np.concatenate([index for _, _, index, _, _ in self._views])
        height = np.concatenate([np.full(len(index), h) for _, _, index, h, _ in self._views])
        steps = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3])
        x = _solved(self._predict, observed, steps)
        left = observed - self._predict(x)
        vertex_std_m, mark_std_px = self._noise
        std_px = np.hypot(mark_std_px, vertex_std_m * lens.fx_px / height)
        rng = np.random.default_rng(np.random.SeedSequence([self._config.seed, 931]))
        drawn = [
            _by_target(np.linalg.norm(left + std_px[:, None] * rng.standard_normal(left.shape), axis=1), target)
            for _ in range(replicates)
        ]
        value = float(np.mean(drawn))
        design = np.stack(
            [(self._predict(x + s) - self._predict(x - s)).ravel() / 2.0 for s in np.diag(steps)], axis=-1
        )
        # An evaluator weights marks as it likes: what the ripple leaves then enters the mounting with other weights.
        weighted = design / np.repeat(np.hypot(std_px, np.sqrt(np.mean(left**2))), 2)[:, None]
        covariance = np.linalg.inv(weighted.T @ weighted)
        std = np.sqrt(np.diag(covariance)) * steps
        # a rotation vector this small is roll, pitch and yaw
        spread = float(np.hypot(np.std(drawn, ddof=1), _MARK_SHARE * value))
        return TrueCalibration(
            error=TrueError(
                value_px=value,
                std_px=spread,
                mistakes={
                    "root mean square in the place of the mean": float(
                        np.sqrt(np.mean(np.sum(left**2, axis=1) + 2.0 * std_px**2))
                    )
                },
            ),
            boresight_deg=np.degrees(x[:3]),
            lever_arm_m=x[3:],
            boresight_std_deg=np.degrees(std[:3]),
            lever_arm_std_m=std[3:],
        )


def _by_target(errors: np.ndarray, target: np.ndarray) -> float:
    """Mean over targets of the mean over a target's images."""
    return float(np.mean([errors[target == t].mean() for t in np.unique(target)]))
