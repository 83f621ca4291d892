"""Observations that contradict all others: the test that finds them, their names, and the problem without them.

Data snooping (Baarda) for the joint adjustment of both mountings, and targets that stand at each other's surveyed place, which
give no observation at all. The adjustment that calls it is `adjustment`'s.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import scipy.linalg
import scipy.stats

from campaign.survey import SurveyedTarget
from evaluator.model import MarkObservation, MountingSolution, PlaneObservation, VertexObservation
from evaluator.mounting.mounting_model import KINDS, Problem, System

# An observation is a blunder when its test's tail probability falls below this.
BLUNDER = 1e-5
_MOST_EXCHANGED = 6  # targets that nothing saw; where there are more it is another fault, and pairs would fit by chance
LOOSE_STD_M = 1e3  # stands for what is known of a surveyed place or height that was rejected


def snooping(
    groups: Sequence[tuple[int, int]],
    factor: np.ndarray,
    design: np.ndarray,
    covariance: np.ndarray,
    residual: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Test of each observation group against all others, under full correlation.

    With W = V^-1 - V^-1 A N^-1 A' V^-1 a shift of group g alone gives (V^-1 r)_g' (W_gg)^-1 (V^-1 r)_g, chi-square
    distributed. Directions that the other observations hardly control (redundancy below 1 %) are left out.

    Parameters
    ----------
    groups : sequence of (first row, rows)
    factor : (n, n) np.ndarray
        Cholesky factor L of the observations' covariance V.
    design, residual : (n, u), (n,) np.ndarray
        L^-1 A and L^-1 r.
    covariance : (u, u) np.ndarray
        N^-1.

    Returns
    -------
    statistic, freedom : (groups,) np.ndarray
    """
    inverse = scipy.linalg.solve_triangular(factor, np.eye(len(factor)), lower=True, check_finite=False)
    precision = inverse.T @ inverse
    projected = inverse.T @ design
    w = precision - projected @ covariance @ projected.T
    wy = inverse.T @ residual
    statistic, freedom = np.zeros(len(groups)), np.zeros(len(groups))
    for g, (first, size) in enumerate(groups):
        rows = slice(first, first + size)
        scale = np.linalg.inv(np.linalg.cholesky(precision[rows, rows]))
        redundancy, vectors = np.linalg.eigh(scale @ w[rows, rows] @ scale.T)
        along = vectors.T @ (scale @ wy[rows])
        testable = redundancy > 0.01
        statistic[g] = np.sum(along[testable] ** 2 / redundancy[testable])
        freedom[g] = testable.sum()
    return statistic, freedom


def common_shift(
    rows: np.ndarray, factor: np.ndarray, design: np.ndarray, covariance: np.ndarray, residual: np.ndarray
) -> tuple[float, float]:
    """By how much all observations of `rows` stand off together, as one unknown more would tell, and its standard deviation.

    Parameters
    ----------
    rows : (k,) np.ndarray of int
        Rows of one unit that are shifted alike, e.g. surveyed heights.
    factor, design, covariance, residual
        As for `snooping`.
    """
    together = np.zeros(len(factor))
    together[rows] = 1.0
    white = scipy.linalg.solve_triangular(factor, together, lower=True, check_finite=False)
    free = white - design @ (covariance @ (design.T @ white))
    information = max(float(free @ free), 1e-12)
    return float(free @ residual) / information, 1.0 / float(np.sqrt(information))


def variance_factor(statistic: np.ndarray, freedom: np.ndarray) -> float:
    """Variance factor of one kind of observation: median of the statistics over the median of chi-square, since blunders are
    still in it. A factor below 1 must hold for the tails as well: there the mean counts where it is greater, up to 1, for
    errors that are peaked would else have their variance halved by the many good ones."""
    use = freedom > 0
    if use.sum() < 20:
        return 1.0
    expected = scipy.stats.chi2.ppf(0.5, freedom[use])
    median = float(np.median(statistic[use] / expected))
    mean = float(statistic[use].sum() / freedom[use].sum())
    return median if median >= 1.0 else max(median, min(mean, 1.0))


def worst_groups(statistic: np.ndarray, freedom: np.ndarray) -> list[int]:
    """Groups to reject now: those past the threshold whose test is at least half the greatest one."""
    tail = -scipy.stats.chi2.logsf(statistic, np.maximum(freedom, 1.0))
    tail[freedom == 0] = 0.0
    if tail.size == 0 or tail.max() < -np.log(BLUNDER):
        return []
    return [int(g) for g in np.flatnonzero((tail >= -np.log(BLUNDER)) & (tail >= 0.5 * tail.max()))]


def describe_mark(mark: MarkObservation) -> str:
    """The line that names a mark among the rejected."""
    return f"mark of {mark.target} in {mark.image} (sortie {mark.sortie})"


def describe_vertex(vertex: VertexObservation) -> str:
    """The line that names a vertex among the rejected."""
    return f"vertex of {vertex.target} in strip {vertex.strip} (sortie {vertex.sortie})"


def describe_plane(plane: PlaneObservation) -> str:
    """The line that names a panel's plane among the rejected."""
    return f"plane of {plane.panel} in strip {plane.strip} (sortie {plane.sortie})"


def describe_place(target: str) -> str:
    """The line that names a surveyed place among the rejected."""
    return f"surveyed place of {target}"


def describe_height(panel: str) -> str:
    """The line that names a panel's surveyed height among the rejected."""
    return f"surveyed height of {panel}"


def exchanged(
    unseen: Iterable[SurveyedTarget], seen_as: Callable[[tuple[SurveyedTarget, ...]], set[str]]
) -> list[tuple[str, str]]:
    """Pairs of targets whose surveyed places are exchanged: each is found when the other is looked for at its place.

    A target's azimuth and make stay with its name, so that at an exchanged place neither its faces nor its mark are as stated
    and nothing of it is observed. Where both look alike (faces within 6 degrees, modulo 90) an exchange is none.

    Parameters
    ----------
    unseen : iterable of SurveyedTarget
        Targets passed over but not found by any sensor.
    seen_as : callable
        Targets as they might stand -> ids of those that are found so.
    """
    targets = sorted(unseen, key=lambda t: t.id)
    if len(targets) > _MOST_EXCHANGED:
        return []

    def at_place_of(body: SurveyedTarget, place: SurveyedTarget) -> SurveyedTarget:
        return replace(
            body, id=place.id, easting_m=place.easting_m, northing_m=place.northing_m, height_m=place.height_m
        )

    return [
        (a.id, b.id)
        for a, b in combinations(targets, 2)
        if seen_as((at_place_of(b, a), at_place_of(a, b))) >= {a.id, b.id}
    ]


def describe_exchange(target: str, other: str) -> str:
    """The line that names an exchanged target among the rejected."""
    return f"{describe_place(target)}: exchanged with that of {other}"


def describe_group(system: System, group: int) -> str:
    """The name of one of the system's groups."""
    kind = system.kinds[group]
    index = group - system.kinds.index(kind)
    problem = system.problem
    if kind == "mark":
        return describe_mark(problem.marks[index])
    if kind == "vertex":
        return describe_vertex(problem.vertices[index])
    if kind == "plane":
        return describe_plane(problem.planes[index])
    return describe_place(system.targets[index]) if kind == "survey" else describe_height(system.panels[index])


def without(problem: Problem, rejected: Sequence[str]) -> Problem:
    """The problem without what `rejected` names; a rejected surveyed place or height becomes free."""
    out = set(rejected)
    return replace(
        problem,
        marks=tuple(o for o in problem.marks if describe_mark(o) not in out),
        vertices=tuple(o for o in problem.vertices if describe_vertex(o) not in out),
        planes=tuple(o for o in problem.planes if describe_plane(o) not in out),
        surveyed={
            t: replace(s, covariance_m2=LOOSE_STD_M**2 * np.eye(3)) if describe_place(t) in out else s
            for t, s in problem.surveyed.items()
        },
        panels={
            p: replace(s, height_std_m=LOOSE_STD_M) if describe_height(p) in out else s
            for p, s in problem.panels.items()
        },
    )


def rescaled(problem: Problem, factors: np.ndarray) -> Problem:
    """The problem with the variances of marks, vertices and planes times their `factors` (3,)."""
    marks, vertices, planes = (float(f) for f in factors)
    return replace(
        problem,
        marks=tuple(replace(o, covariance_px2=o.covariance_px2 * marks) for o in problem.marks),
        vertices=tuple(replace(o, covariance_m2=o.covariance_m2 * vertices) for o in problem.vertices),
        planes=tuple(replace(o, std_m=o.std_m * float(np.sqrt(planes))) for o in problem.planes),
    )


def kept_problem(problem: Problem, solution: MountingSolution) -> Problem:
    """The observations that the adjustment kept, with the variances that it ended with and rejected places free."""
    factors = [solution.companions.get(f"variance_factor_{name}", 1.0) for name in KINDS.values()]
    return rescaled(
        without(problem, solution.rejected), np.array([f if isinstance(f, float) else 1.0 for f in factors])
    )
