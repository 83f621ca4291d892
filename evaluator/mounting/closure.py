"""Closure of the triangle camera-body, LiDAR-body, camera-LiDAR: three ways to the same transform, compared with all they share.

Camera-body from the camera's observations alone and LiDAR-body from the LiDAR's alone (vertices, panels' planes) give a
camera_from_lidar; the joint adjustment of 9.3 gives another. Both are linear functions of the same observations, so their
difference is one too, and its covariance follows from the observations' whole covariance: what they share (navigation,
survey, lens) is counted once.
The solutions live in `adjustment` and `single_sensor`. What a closure cannot show is a fault that both ways take up alike, e.g. a
boresight's change that one lever arm explains as well.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.stats

from evaluator.model import MountingSolution, SensorSolution
from evaluator.mounting.adjustment import camera_from_lidar_vector
from evaluator.mounting.blunders import kept_problem
from evaluator.mounting.helping_strip import weak_parameters
from evaluator.mounting.mounting_model import Problem, System
from evaluator.mounting.single_sensor import solve_camera, solve_lidar

NAMES = tuple(f"camera_from_lidar_{part}" for part in ("roll", "pitch", "yaw", "x", "y", "z"))
_RANK = 1e-8  # of the largest eigenvalue, after scaling to unit variances: below it a direction is the same either way


@dataclass(frozen=True, kw_only=True)
class Closure:
    """Composed minus joint camera_from_lidar: three angles [rad], three lengths [m]."""

    composed: np.ndarray  # (6,) of camera-body and LiDAR-body
    joint: np.ndarray  # (6,) of the joint adjustment
    difference: np.ndarray  # (6,)
    covariance: np.ndarray  # (6, 6) of the difference
    chi_square: float
    freedom: int
    limit_95: float  # of chi_square
    camera: SensorSolution  # each sensor alone
    lidar: SensorSolution

    @property
    def closes(self) -> bool:
        """Whether zero lies in the 95 % region of the difference."""
        return self.chi_square <= self.limit_95

    def block(self) -> dict[str, object]:
        """For results.json: degrees and metres."""
        scale = np.repeat([np.degrees(1.0), 1.0], 3)
        std = np.sqrt(np.diag(self.covariance))
        known = np.where(std > 0.0, std, np.inf)
        return {
            "names": list(NAMES),
            "units": ["deg"] * 3 + ["m"] * 3,
            "composed": [float(v) for v in self.composed * scale],
            "joint": [float(v) for v in self.joint * scale],
            "difference": [float(v) for v in self.difference * scale],
            "std": [float(v) for v in std * scale],
            "z": [float(v) for v in self.difference / known],
            "covariance": (self.covariance * np.outer(scale, scale)).tolist(),
            "half_width_95": [float(v) for v in np.sqrt(self.limit_95) * std * scale],
            "chi_square": self.chi_square,
            "freedom": self.freedom,
            "limit_95": self.limit_95,
            "closes": self.closes,
            "camera_alone": _side(self.camera),
            "lidar_alone": _side(self.lidar),
        }


def _side(solution: SensorSolution) -> dict[str, object]:
    """One sensor against the body, in degrees, metres and seconds."""
    units = ["s" if "clock" in n else "m" if "lever_arm" in n else "deg" for n in solution.names]
    scale = np.array([np.degrees(1.0) if unit == "deg" else 1.0 for unit in units])
    return {
        "names": list(solution.names),
        "units": units,
        "estimates": [float(v) for v in solution.parameters * scale],
        "std": [float(v) for v in np.sqrt(np.diag(solution.covariance)) * scale],
        "sigma0": solution.sigma0,
        "redundancy": solution.redundancy,
        "not_determined": sorted(weak_parameters(solution.names, solution.covariance, solution.prior_std)),
    }


def joint_estimator(design: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """N^-1 A' V^-1: what takes observations to unknowns, (unknowns, rows)."""
    factor = np.linalg.cholesky(covariance)
    white = scipy.linalg.solve_triangular(factor, design, lower=True, check_finite=False)
    gain = np.linalg.solve(white.T @ white, white.T)
    return np.asarray(scipy.linalg.solve_triangular(factor, gain.T, lower=True, trans="T", check_finite=False).T)


def alone_estimator(system: System, design: np.ndarray, covariance: np.ndarray, sensor: str) -> np.ndarray:
    """Estimator of one sensor's parameters from its own rows, the surveyed places and its priors: (6 + clock, all rows)."""
    own = np.array([k for k, name in enumerate(system.names) if name.startswith(sensor)])
    seen = (
        np.arange(system.rows_marks, system.rows_vertices)
        if sensor == "camera"
        else np.arange(system.rows_vertices, system.rows_places)
    )
    rows = np.concatenate([seen, np.arange(system.rows_places, system.rows_prior), system.rows_prior + own])
    columns = np.concatenate([own, np.arange(system.count, design.shape[1])])
    out = np.zeros((len(own), len(design)))
    out[:, rows] = joint_estimator(design[np.ix_(rows, columns)], covariance[np.ix_(rows, rows)])[: len(own)]
    return out


def closure(problem: Problem, solution: MountingSolution) -> Closure:
    """Composed against joint camera_from_lidar.

    Parameters
    ----------
    problem : Problem
        As given to `solve_mountings`; what that left out is left out here.
    solution : MountingSolution

    Returns
    -------
    Closure
        `covariance` is J (G_alone - G_joint) V (G_alone - G_joint)' J': G the estimators, V the covariance of all observations
        with surveyed places and priors among them, J the derivative of camera_from_lidar by both mountings.

    Raises
    ------
    EvaluationError
        A sensor alone saw too few targets.
    """
    kept = kept_problem(problem, solution)
    camera = solve_camera(kept, snoop=False, start=solution.parameters)
    lidar = solve_lidar(kept, snoop=False, start=solution.parameters)
    system = System(kept)
    marks = np.array([solution.vertices_world_m[t] - problem.surveyed[t].vertex_from_mark_m for t in system.targets])
    linear = system.linearise(np.concatenate([solution.parameters, marks.ravel(), np.zeros(len(system.panels))]))
    alone = np.zeros((12, system.size))
    for first, sensor in ((0, "camera"), (6, "lidar")):
        alone[first : first + 6] = alone_estimator(system, linear.design, linear.covariance, sensor)[:6]
    change = alone - joint_estimator(linear.design, linear.covariance)[:12]
    apart = np.concatenate([camera.parameters[:6], lidar.parameters[:6]])
    jacobian = np.zeros((6, 12))
    for j in range(12):
        d = np.zeros(12)
        d[j] = 1e-6
        jacobian[:, j] = (
            camera_from_lidar_vector(system.nominal, apart + d) - camera_from_lidar_vector(system.nominal, apart - d)
        ) / 2e-6
    gain = jacobian @ change
    covariance = gain @ linear.covariance @ gain.T
    composed = camera_from_lidar_vector(system.nominal, apart)
    difference = composed - solution.camera_from_lidar
    difference[:3] = (difference[:3] + np.pi) % (2.0 * np.pi) - np.pi
    chi_square, freedom = _chi_square(difference, covariance)
    return Closure(
        composed=composed,
        joint=solution.camera_from_lidar,
        difference=difference,
        covariance=covariance,
        chi_square=chi_square,
        freedom=freedom,
        limit_95=float(scipy.stats.chi2.ppf(0.95, freedom)),
        camera=camera,
        lidar=lidar,
    )


def _chi_square(difference: np.ndarray, covariance: np.ndarray) -> tuple[float, int]:
    """d' C^-1 d over the directions in which C is not zero, and their number."""
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
    values, vectors = np.linalg.eigh(covariance / np.outer(std, std))
    use = values > _RANK * values.max()
    along = vectors.T @ (difference / std)
    return float(np.sum(along[use] ** 2 / values[use])), int(use.sum())
