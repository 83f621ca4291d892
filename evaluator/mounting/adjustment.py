"""Solver of the joint adjustment (23): Gauss-Newton under full covariance, rounds of data snooping, the solution's frame.

The observation equations and their covariance live in `mounting_model`, the test for blunders in `blunders`; the indicator (20) in
`c9_3_calibration`.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from evaluator.frames import euler_angles
from evaluator.model import EvaluationError, Mounting, MountingSolution
from evaluator.mounting.blunders import (
    common_shift,
    describe_group,
    rescaled,
    snooping,
    variance_factor,
    without,
    worst_groups,
)
from evaluator.mounting.helping_strip import helping_strips
from evaluator.mounting.mounting_model import KINDS, Problem, System, mounting_of
from evaluator.mounting.stated import Fitted, detectable_survey, examine

_MOST_REJECTED = 0.25  # of all observations; more is no longer a matter of single blunders


@dataclass(frozen=True, kw_only=True)
class _Fit:
    x: np.ndarray
    covariance: np.ndarray
    factor: np.ndarray  # Cholesky factor L of the observations' covariance
    design: np.ndarray  # L^-1 A
    residual: np.ndarray  # L^-1 r after the last step
    iterations: int


def _factorised(covariance: np.ndarray) -> np.ndarray:
    """Lower Cholesky factor; the argument is overwritten."""
    try:
        return np.asarray(scipy.linalg.cholesky(covariance, lower=True, overwrite_a=True, check_finite=False))
    except np.linalg.LinAlgError:
        raise EvaluationError(
            "the covariance of the observations is not positive definite",
            remedy="check the standard deviations in survey/targets.csv, rig.json and the lens certificate",
        ) from None


def _gauss_newton(system: System, x: np.ndarray, most_iterations: int = 30) -> _Fit:
    """Iterates until no parameter moves by more than 1e-3 of its standard deviation.

    The covariance, through which navigation errors pass with the geometry, is formed anew only while a step turns a mounting
    by more than 1 mrad or moves one by more than a centimetre (a clock's steps move the poses by less): below that it changes by
    less than a thousandth.
    """
    factor: np.ndarray | None = None
    for iteration in range(1, most_iterations + 1):
        linear = system.linearise(x, with_covariance=factor is None)
        if not np.all(np.isfinite(linear.residual)):
            raise EvaluationError(
                "a mark's predicted pixel left the camera's field", remedy="check rig.json's nominal mounting"
            )
        if factor is None:
            factor = _factorised(linear.covariance)
        both = scipy.linalg.solve_triangular(
            factor, np.column_stack([linear.design, linear.residual]), lower=True, check_finite=False
        )
        design, residual = both[:, :-1], both[:, -1]
        covariance = np.linalg.inv(design.T @ design)
        step = covariance @ (design.T @ residual)
        x = x + step
        if np.max(np.abs(step) / np.sqrt(np.diag(covariance))) < 1e-3:
            return _Fit(
                x=x,
                covariance=covariance,
                factor=factor,
                design=design,
                residual=residual - design @ step,
                iterations=iteration,
            )
        turns, arms = step[[0, 1, 2, 6, 7, 8]], step[[3, 4, 5, 9, 10, 11]]
        if np.abs(turns).max() > 1e-3 or np.abs(arms).max() > 1e-2:
            factor = None
    raise EvaluationError("the adjustment of the mounting does not converge", got=f"{most_iterations} iterations")


def camera_from_lidar(camera: Mounting, lidar: Mounting) -> tuple[np.ndarray, np.ndarray]:
    """(rotation (3, 3), translation (3,) [m]) of camera_from_lidar from body_from_camera and body_from_lidar."""
    rotation = camera.rotation.T @ lidar.rotation
    return rotation, camera.rotation.T @ (lidar.lever_arm_m - camera.lever_arm_m)


def camera_from_lidar_vector(nominal: tuple[Mounting, Mounting], parameters: np.ndarray) -> np.ndarray:
    """(6,): roll, pitch, yaw [rad] of nominal^-1 * estimated rotation, x, y, z [m] of the estimated translation."""
    reference, _ = camera_from_lidar(*nominal)
    rotation, translation = camera_from_lidar(
        mounting_of(nominal[0], parameters[0:6]), mounting_of(nominal[1], parameters[6:12])
    )
    return np.concatenate([euler_angles(reference.T @ rotation), translation])


def product_covariance(nominal: tuple[Mounting, Mounting], x: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    jacobian = np.zeros((6, 12))
    for j in range(12):  # central differences: the map is smooth and a step of 1e-6 leaves 1e-10
        d = np.zeros(12)
        d[j] = 1e-6
        jacobian[:, j] = (camera_from_lidar_vector(nominal, x + d) - camera_from_lidar_vector(nominal, x - d)) / 2e-6
    return np.asarray(jacobian @ covariance @ jacobian.T)


def _check(problem: Problem, sensors: tuple[str, ...]) -> None:
    """Enough was seen by every one of `sensors`."""
    sets = []
    for sensor, observations, what in (
        ("camera", problem.marks, "mark in any image"),
        ("lidar", problem.vertices, "vertex in any strip"),
    ):
        if sensor not in sensors:
            continue
        if not observations:
            of = "the mountings cannot be solved together" if len(sensors) == 2 else "its mounting cannot be solved"
            raise EvaluationError(f"no {what}: {of}")
        sets.append({o.target for o in observations})
    common = set.intersection(*sets)
    if len(common) < 4:
        raise EvaluationError(
            "too few targets seen by both sensors"
            if len(sensors) == 2
            else f"too few targets seen by the {sensors[0]}",
            got=len(common),
            expected=f"at least 4 for the {'twelve' if len(sensors) == 2 else 'six'} parameters",
        )


@dataclass(frozen=True, kw_only=True)
class Solved:
    """The last fit, with what is left of the observations."""

    system: System
    fit: _Fit
    rejected: list[str]
    factors: np.ndarray  # (3,) variance factors of marks, vertices and planes

    @property
    def redundancy(self) -> int:
        return len(self.fit.residual) - len(self.fit.x)

    @property
    def sigma0(self) -> float:
        freedom = self.redundancy
        return float(np.sqrt(self.fit.residual @ self.fit.residual / freedom)) if freedom > 0 else 1.0


def fit_problem(problem: Problem, *, snoop: bool, start: np.ndarray | None, sensors: tuple[str, ...]) -> Solved:
    """Fits, rejects and rescales until nothing changes."""
    _check(problem, sensors)
    total = len(problem.marks) + len(problem.vertices) + len(problem.planes)
    rejected: list[str] = []
    factors = np.ones(len(KINDS))
    first = None if start is None else np.asarray(start, dtype=np.float64)
    scaled = problem
    for _round in range(40):
        system = System(scaled)
        if first is None:
            first = np.zeros(system.count)
        fit = _gauss_newton(system, system.start(first))
        if not snoop:
            break
        statistic, freedom = snooping(system.groups, fit.factor, fit.design, fit.covariance, fit.residual)
        kinds = np.array(system.kinds)
        ratio = np.array([variance_factor(statistic[kinds == k], freedom[kinds == k]) for k in KINDS])
        ratio[2] = max(
            ratio[2], 1.0
        )  # a plane's variance is its own points'; next to navigation's a lower one does not show
        robust = statistic.copy()
        for value, kind in zip(ratio, KINDS, strict=True):
            robust[kinds == kind] /= max(value, 1.0)
        worst = worst_groups(robust, freedom)
        changed = np.abs(np.log(ratio)) > 0.1
        if not worst and (not changed.any() or _round > 8):
            break
        step = np.where(changed, np.clip(ratio, 0.1, 10.0), 1.0)
        factors = factors * step
        first = fit.x[: system.count]
        names = [describe_group(system, g) for g in worst]
        rejected += names
        if len(rejected) > _MOST_REJECTED * total:
            raise EvaluationError(
                "more than a quarter of the observations contradict the rest",
                got=f"{len(rejected)} of {total}",
                remedy="check time stamps, nominal mounting and survey coordinates",
            )
        scaled = rescaled(without(scaled, names), step)
        _check(scaled, sensors)
    else:
        raise EvaluationError("data snooping does not come to an end", got=f"{len(rejected)} observations rejected")
    return Solved(system=system, fit=fit, rejected=rejected, factors=factors)


def strong_pairs(names: tuple[str, ...], covariance: np.ndarray) -> list[dict[str, object]]:
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(std, std)
    return [
        {"parameters": [names[i], names[j]], "correlation": float(correlation[i, j])}
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) > 0.95
    ]


def _plane_companions(solved: Solved) -> dict[str, object]:
    """How many planes were used, and how the panels' surveyed heights stand against the frustums'; nothing without planes."""
    system, fit = solved.system, solved.fit
    if not system.problem.planes:
        return {}
    rows = np.arange(system.rows_heights, system.rows_prior)
    shift, std = common_shift(rows, fit.factor, fit.design, fit.covariance, fit.residual)
    return {
        "variance_factor_planes": float(solved.factors[2]),
        "planes": len(system.problem.planes),
        "panel_heights_shift_m": shift,
        "panel_heights_shift_std_m": std,
    }


def _stated_companions(solved: Solved) -> dict[str, object]:
    """What is stated and not estimated, as the observations see it, and which errors of the survey would be found."""
    fit = solved.fit
    fitted = Fitted(factor=fit.factor, design=fit.design, covariance=fit.covariance, residual=fit.residual)
    doubts, lines = examine(solved.system, fit.x, fitted)
    return {
        "stated": [d.block() for d in doubts],
        "stated_in_doubt": lines,
        "detectable_survey_error": detectable_survey(solved.system, fitted),
    }


def solve_mountings(problem: Problem, *, snoop: bool = True, start: np.ndarray | None = None) -> MountingSolution:
    """Both mountings from all marks, vertices and panels' planes.

    Parameters
    ----------
    problem : Problem
    snoop : bool
        Reject blunders and estimate the variance factors of marks, vertices and planes; False takes everything as it is.
    start : (12 + clocks,) np.ndarray, optional
        First values of the parameters; the drawing's mountings and no clock error when absent.

    Returns
    -------
    MountingSolution
        `companions` hold the variance factors, correlations beyond 0.95, what is not determined, with `snoop` the strip that
        would determine it, what of the stated the observations contradict (`stated`) and which error of the survey they would
        find, and where there are planes their number and how all their surveyed heights stand off together.

    Raises
    ------
    EvaluationError
        Too few observations, no convergence, or more than a quarter of the observations rejected.

    References
    ----------
    GB/T 41450-2022, 9.3.2 h-i, formula (23), for two mountings and with surveyed places as weighted observations; Baarda, A
    testing procedure for use in geodetic networks, 1968.
    """
    solved = fit_problem(problem, snoop=snoop, start=start, sensors=("camera", "lidar"))
    system, fit = solved.system, solved.fit
    names, n = system.names, system.count
    x = fit.x[:n]
    covariance = fit.covariance[:n, :n]
    camera, lidar = system.mountings(x)
    rotation, translation = camera_from_lidar(camera, lidar)
    std = np.sqrt(np.diag(covariance))
    helping = helping_strips(system.problem, x, covariance) if snoop else []
    clocks = dict(zip(names[12:], x[12:], strict=True))
    return MountingSolution(
        names=names,
        parameters=x,
        covariance=covariance,
        body_from_camera=camera,
        body_from_lidar=lidar,
        camera_from_lidar_rotation=rotation,
        camera_from_lidar_translation_m=translation,
        camera_from_lidar=camera_from_lidar_vector(system.nominal, x[:12]),
        camera_from_lidar_covariance=product_covariance(system.nominal, x[:12], covariance[:12, :12]),
        vertices_world_m={
            t: fit.x[n + 3 * i : n + 3 * i + 3] + problem.surveyed[t].vertex_from_mark_m
            for i, t in enumerate(system.targets)
        },
        iterations=fit.iterations,
        sigma0=solved.sigma0,
        redundancy=solved.redundancy,
        rejected=tuple(solved.rejected),
        companions={
            "variance_factor_marks": float(solved.factors[0]),
            "variance_factor_vertices": float(solved.factors[1]),
            **_plane_companions(solved),
            "strong_correlations": strong_pairs(names, covariance),
            "not_determined": [
                name for name, s, prior in zip(names, std, system.prior_std, strict=True) if s > 0.5 * prior
            ],
            "prior_std": [float(s) for s in system.prior_std],
            **(_stated_companions(solved) if snoop else {}),
            **({"strip_that_would_help": [w.block() for w in helping]} if helping else {}),
        },
        prior_std=system.prior_std,
        camera_clock_s=float(clocks.get("camera_clock", 0.0)),
        lidar_clock_s=float(clocks.get("lidar_clock", 0.0)),
    )


def on_true_time(problem: Problem, solution: MountingSolution) -> Problem:
    """The observations at the times when they were made by the estimated clocks; itself where none was estimated."""
    camera, lidar = solution.camera_clock_s, solution.lidar_clock_s
    if camera == 0.0 and lidar == 0.0:
        return problem
    return replace(
        problem,
        marks=tuple(replace(o, gps_time_s=o.gps_time_s - camera) for o in problem.marks),
        vertices=tuple(replace(o, gps_time_s=o.gps_time_s - lidar) for o in problem.vertices),
        planes=tuple(replace(o, gps_time_s=o.gps_time_s - lidar) for o in problem.planes),
    )
