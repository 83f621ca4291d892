"""One sensor's mounting against the body from its own observations alone: the two other sides of the triangle of closure.

The joint adjustment and the solver are `adjustment`'s; whether the three sides close is `closure`'s.
"""

from dataclasses import replace

import numpy as np

from evaluator.model import SensorSolution
from evaluator.mounting.adjustment import fit_problem, strong_pairs
from evaluator.mounting.mounting_model import Problem


def solve_camera(problem: Problem, *, snoop: bool = True, start: np.ndarray | None = None) -> SensorSolution:
    """The camera's mounting (and clock) from its marks alone; see `solve_mountings`. `start` is (12 + clocks,) as there."""
    return _solve_sensor(replace(problem, vertices=(), planes=()), "camera", snoop, start)


def solve_lidar(problem: Problem, *, snoop: bool = True, start: np.ndarray | None = None) -> SensorSolution:
    """The LiDAR's mounting (and clock) from the targets' vertices and the panels' planes alone; see `solve_mountings`."""
    return _solve_sensor(replace(problem, marks=()), "lidar", snoop, start)


def _solve_sensor(problem: Problem, sensor: str, snoop: bool, start: np.ndarray | None) -> SensorSolution:
    """The other sensor's parameters stay at their priors and touch nothing."""
    solved = fit_problem(problem, snoop=snoop, start=start, sensors=(sensor,))
    names = solved.system.names
    own = np.array([k for k, name in enumerate(names) if name.startswith(sensor)])
    x, covariance = solved.fit.x, solved.fit.covariance[np.ix_(own, own)]
    of = tuple(names[k] for k in own)
    return SensorSolution(
        sensor=sensor,
        names=of,
        parameters=x[own],
        covariance=covariance,
        prior_std=solved.system.prior_std[own],
        body_from_sensor=solved.system.mountings(x)[0 if sensor == "camera" else 1],
        sigma0=solved.sigma0,
        redundancy=solved.redundancy,
        rejected=tuple(solved.rejected),
        companions={
            "variance_factor": float(solved.factors[0 if sensor == "camera" else 1]),
            "strong_correlations": strong_pairs(of, covariance),
        },
    )
