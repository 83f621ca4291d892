"""The solvers' slots: the adjustment's own problems as tasks of plain arrays, and answers back as solutions.

The adjustments themselves live in `adjustment` and `mounting_by_boards`.
"""

from typing import TYPE_CHECKING, Protocol

import numpy as np

from campaign.sensors import Rig
from evaluator.algorithms.record import Tools
from evaluator.algorithms.slots import ExtrinsicTask, FoundCameraMounting, FoundMountings, MountingTask
from evaluator.camera_model import lens_vector
from evaluator.frames import body_pose, euler_angles
from evaluator.georeference import nominal_mountings
from evaluator.model import MarkObservation, Mounting, MountingSolution, VertexObservation
from evaluator.mounting.adjustment import (
    camera_from_lidar,
    camera_from_lidar_vector,
    product_covariance,
    solve_mountings,
)
from evaluator.mounting.mounting_model import PARAMETER_NAMES, Problem

if TYPE_CHECKING:
    from evaluator.boards.board_model import BoardProblem, Views
    from evaluator.boards.board_observations import BoardObservation


class Solve(Protocol):
    """`adjustment.solve_mountings`, or another solver in its form."""

    def __call__(
        self, problem: Problem, *, snoop: bool = True, start: np.ndarray | None = None
    ) -> MountingSolution: ...


def mountings_solver(tools: Tools) -> Solve:
    """Our own adjustment, or what stands in the slot `extrinsic_solver`."""
    replaced = tools.extrinsic_solver
    if replaced is None:
        return solve_mountings

    def solve(problem: Problem, *, snoop: bool = True, start: np.ndarray | None = None) -> MountingSolution:
        return _solution(problem, replaced(extrinsic_task(problem)))

    return solve


def _poses(
    problem: Problem, observations: tuple[MarkObservation, ...] | tuple[VertexObservation, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Body's origin (n, 3) [m] and world_from_body (n, 3, 3) at each observation's time."""
    body, rotation = np.zeros((len(observations), 3)), np.zeros((len(observations), 3, 3))
    sorties = np.array([o.sortie for o in observations], dtype=np.int64)
    times = np.array([o.gps_time_s for o in observations], dtype=np.float64)
    for number in np.unique(sorties):
        rows = sorties == number
        body[rows], rotation[rows] = body_pose(problem.trajectories[int(number)], times[rows], problem.world_frame)
    return body, rotation


def _integers(values: list[int]) -> np.ndarray:
    return np.array(values, dtype=np.int64)


def _prior(rig: Rig) -> np.ndarray:
    """(12,) standard deviations of the drawing's mountings: three angles [rad], three lengths [m], of camera and LiDAR."""
    return np.concatenate(
        [
            np.concatenate([np.full(3, np.radians(s.boresight_std_deg)), np.full(3, s.lever_arm_std_m)])
            for s in (rig.camera, rig.lidar)
        ]
    )


def extrinsic_task(problem: Problem) -> ExtrinsicTask:
    """The problem as arrays; of the surveyed targets only those that were seen."""
    marks, vertices = problem.marks, problem.vertices
    targets = tuple(sorted({o.target for o in marks} | {o.target for o in vertices}))
    at = {t: i for i, t in enumerate(targets)}
    surveyed = [problem.surveyed[t] for t in targets]
    camera, lidar = nominal_mountings(problem.rig)
    mark_body, mark_rotation = _poses(problem, marks)
    vertex_body, vertex_rotation = _poses(problem, vertices)
    return ExtrinsicTask(
        targets=targets,
        mark_world_m=np.array([s.mark_world_m for s in surveyed]).reshape(-1, 3),
        mark_world_covariance_m2=np.array([s.covariance_m2 for s in surveyed]).reshape(-1, 3, 3),
        vertex_from_mark_m=np.array([s.vertex_from_mark_m for s in surveyed]).reshape(-1, 3),
        mark_target=_integers([at[o.target] for o in marks]),
        mark_sortie=_integers([o.sortie for o in marks]),
        mark_strip=_integers([o.strip for o in marks]),
        mark_time_s=np.array([o.gps_time_s for o in marks]),
        mark_uv_px=np.array([o.uv_px for o in marks]).reshape(-1, 2),
        mark_covariance_px2=np.array([o.covariance_px2 for o in marks]).reshape(-1, 2, 2),
        mark_body_m=mark_body,
        mark_world_from_body=mark_rotation,
        vertex_target=_integers([at[o.target] for o in vertices]),
        vertex_sortie=_integers([o.sortie for o in vertices]),
        vertex_strip=_integers([o.strip for o in vertices]),
        vertex_time_s=np.array([o.gps_time_s for o in vertices]),
        vertex_lidar_m=np.array([o.point_lidar_m for o in vertices]).reshape(-1, 3),
        vertex_covariance_m2=np.array([o.covariance_m2 for o in vertices]).reshape(-1, 3, 3),
        vertex_body_m=vertex_body,
        vertex_world_from_body=vertex_rotation,
        lens=lens_vector(problem.lens),
        lens_covariance=problem.lens_covariance,
        camera_rotation=camera.rotation,
        camera_lever_arm_m=camera.lever_arm_m,
        lidar_rotation=lidar.rotation,
        lidar_lever_arm_m=lidar.lever_arm_m,
        prior_std=_prior(problem.rig),
        position_std_m=np.array(problem.rig.navigation.position_std_m, dtype=np.float64),
        attitude_std_rad=np.radians(np.array(problem.rig.navigation.attitude_std_deg, dtype=np.float64)),
        problem=problem,
    )


def _against(nominal: Mounting, rotation: np.ndarray, lever_arm_m: np.ndarray) -> np.ndarray:
    """(6,) roll pitch yaw [rad] of rotation * nominal^-1, lever arm minus nominal [m]."""
    return np.concatenate([euler_angles(rotation @ nominal.rotation.T), lever_arm_m - nominal.lever_arm_m])


def _solution(problem: Problem, found: FoundMountings) -> MountingSolution:
    """As `solve_mountings` returns it, without what only that knows: adjusted places, rejected observations, sigma0."""
    nominal = nominal_mountings(problem.rig)
    camera = Mounting(rotation=found.camera_rotation, lever_arm_m=found.camera_lever_arm_m)
    lidar = Mounting(rotation=found.lidar_rotation, lever_arm_m=found.lidar_lever_arm_m)
    x = np.concatenate([_against(n, m.rotation, m.lever_arm_m) for n, m in ((nominal[0], camera), (nominal[1], lidar))])
    rotation, translation = camera_from_lidar(camera, lidar)
    return MountingSolution(
        names=PARAMETER_NAMES,
        parameters=x,
        covariance=found.covariance,
        body_from_camera=camera,
        body_from_lidar=lidar,
        camera_from_lidar_rotation=rotation,
        camera_from_lidar_translation_m=translation,
        camera_from_lidar=camera_from_lidar_vector(nominal, x),
        camera_from_lidar_covariance=product_covariance(nominal, x, found.covariance),
        vertices_world_m={t: s.mark_world_m + s.vertex_from_mark_m for t, s in problem.surveyed.items()},
        iterations=0,
        sigma0=float("nan"),
        redundancy=2 * len(problem.marks) + 3 * len(problem.vertices) - 12,
        prior_std=_prior(problem.rig),
    )


def board_task(problem: "BoardProblem", views: "Views", observations: "list[BoardObservation]") -> MountingTask:
    """The boards' problem as arrays."""
    camera = nominal_mountings(problem.rig)[0]
    return MountingTask(
        boards=problem.boards,
        board_world_m=problem.places_m,
        board_covariance_m2=problem.place_covariance_m2,
        board=views.board,
        sortie=views.sortie,
        strip=views.strip,
        time_s=views.time_s,
        uv_px=np.array([o.uv_px for o in observations], dtype=np.float64).reshape(-1, 2),
        covariance_px2=views.covariance_px2,
        body_m=views.body_m,
        world_from_body=views.world_from_body,
        lens=lens_vector(problem.lens),
        lens_covariance=problem.lens_covariance,
        camera_rotation=camera.rotation,
        camera_lever_arm_m=camera.lever_arm_m,
        prior_std=problem.prior_std,
        problem=problem,
        views=views,
        observations=tuple(observations),
    )


def board_xi(problem: "BoardProblem", found: FoundCameraMounting) -> tuple[np.ndarray, np.ndarray]:
    """xi (6,) against the drawing, and its covariance (6, 6)."""
    nominal = nominal_mountings(problem.rig)[0]
    return _against(nominal, found.camera_rotation, found.camera_lever_arm_m), found.covariance
