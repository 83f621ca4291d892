"""Clause 9.3: mean calibration error P_m, formulas (20) and (24), and what stands beside it.

Finding targets and solving (21)-(23) live in `observe`, `geometry` and `adjustment`; grades in `c10_1_grading`.
"""

from dataclasses import dataclass, replace

import numpy as np

from campaign.config import Lens
from evaluator.algorithms.solvers import Solve
from evaluator.camera_model import camera_points, ideal_px, project, undistorted_px
from evaluator.georeference import mounting_from_sheet, world_points
from evaluator.model import EvaluationError, Mounting, MountingSolution
from evaluator.mounting.adjustment import on_true_time, solve_mountings
from evaluator.mounting.blunders import without
from evaluator.mounting.mounting_model import Problem
from evaluator.mounting.single_instant import solve_single_instant
from evaluator.results import Residual
from evaluator.results_model import IndicatorValue

_FOLDS = 5
_DRAWS = 2000


def calibration_error(residual_norms_px: np.ndarray) -> float:
    """Mean calibration error P_m.

    Parameters
    ----------
    residual_norms_px : (n,) array_like
        Calibration error P_i of each target. [px]

    Returns
    -------
    float
        P_m. [px]

    Raises
    ------
    EvaluationError
        No target, or a value that is negative or not finite.

    References
    ----------
    GB/T 41450-2022, 9.3.1, formula (20).
    """
    p = np.asarray(residual_norms_px, dtype=np.float64).ravel()
    if p.size == 0:
        raise EvaluationError("the calibration error needs at least one target", got=0)
    if not np.all(np.isfinite(p)) or np.any(p < 0.0):
        raise EvaluationError("a calibration error is negative or not finite", where="formula (20)")
    return float(p.mean())


def residual_norms(projected_px: np.ndarray, observed_px: np.ndarray) -> np.ndarray:
    """Distance between projected and observed pixel of each target, P_i: (n, 2), (n, 2) -> (n,). [px]

    References
    ----------
    GB/T 41450-2022, 9.3.2 j and B.2.
    """
    difference = np.asarray(projected_px, dtype=np.float64) - np.asarray(observed_px, dtype=np.float64)
    if difference.ndim != 2 or difference.shape[1] != 2:
        raise EvaluationError("pixel coordinates must be pairs", got=f"shape {difference.shape}", expected="(n, 2)")
    return np.asarray(np.linalg.norm(difference, axis=1))


def project_24(lens: Lens, rotation: np.ndarray, translation_m: np.ndarray, p_lidar_m: np.ndarray) -> np.ndarray:
    """LiDAR points to ideal pixels by one rigid camera_from_lidar: s [u v 1] = K (R X + t).

    Parameters
    ----------
    lens : Lens
        fx, fy, cx, cy are used; distortion is removed from the observations instead.
    rotation, translation_m : (3, 3), (3,) np.ndarray
        camera_from_lidar.
    p_lidar_m : (n, 3) np.ndarray
        [m]

    Returns
    -------
    (n, 2) np.ndarray
        NaN behind the camera. [px]

    References
    ----------
    GB/T 41450-2022, 9.3.2 i, formula (24), in image axes.
    """
    return ideal_px(lens, np.asarray(p_lidar_m, dtype=np.float64) @ np.asarray(rotation).T + translation_m)


@dataclass(frozen=True, kw_only=True)
class CalibrationResult:
    """The indicator, and the residual of every target in every image."""

    indicator: IndicatorValue
    residuals: tuple[Residual, ...]


def lidar_marks(
    problem: Problem, body_from_lidar: Mounting, *, by_strip: bool = False
) -> dict[tuple[int, int, str], np.ndarray]:
    """Place of each mark by the LiDAR alone, world frame (3,): (sortie, 0, target) -> weighted mean over the sortie's strips,
    or (sortie, strip, target) -> each strip's own.

    Each vertex goes through the mounting and the trajectory at its own time; the weight is the inverse of its variance and
    of the navigation's. The stated offset from mark to vertex is taken off.
    """
    navigation = float(np.mean(np.square(problem.rig.navigation.position_std_m)))
    sums: dict[tuple[int, int, str], np.ndarray] = {}
    for v in problem.vertices:
        point = world_points(
            v.point_lidar_m[None],
            np.array([v.gps_time_s]),
            problem.trajectories[v.sortie],
            body_from_lidar,
            problem.world_frame,
        )[0]
        weight = 1.0 / (float(np.trace(v.covariance_m2)) / 3.0 + navigation + 1e-10)
        offset = problem.surveyed[v.target].vertex_from_mark_m
        key = (v.sortie, v.strip if by_strip else 0, v.target)
        sums[key] = sums.get(key, np.zeros(4)) + weight * np.array([*(point - offset), 1.0])
    return {key: s[:3] / s[3] for key, s in sums.items()}


def residual_table(
    problem: Problem, body_from_camera: Mounting, body_from_lidar: Mounting, *, whole_sortie: bool = False
) -> list[Residual]:
    """Formula (24) in flight for every mark whose target the LiDAR saw in the same sortie: p_C = camera_from_body
    body_from_world(t_e) world_from_body(t_s) body_from_lidar p_L.

    Both sensors are compared on data taken together (9.3.2 c): the vertex is the one of the image's own strip, or where that
    strip has none, the mean over the sortie's strips. `whole_sortie` takes that mean always, and so lets the navigation's
    drift from strip to strip into the figure.
    """
    places = lidar_marks(problem, body_from_lidar)
    if not whole_sortie:
        places |= lidar_marks(problem, body_from_lidar, by_strip=True)
    table = []
    for m in problem.marks:
        place = places.get((m.sortie, m.strip, m.target), places.get((m.sortie, 0, m.target)))
        if place is None:
            continue
        p = camera_points(
            body_from_camera,
            problem.trajectories[m.sortie],
            np.array([m.gps_time_s]),
            place[None],
            problem.world_frame,
        )
        error = residual_norms(ideal_px(problem.lens, p), undistorted_px(problem.lens, m.uv_px[None]))
        table.append(
            Residual(
                target=m.target,
                sortie=m.sortie,
                image=m.image,
                observed_px=m.uv_px,
                projected_px=project(problem.lens, p)[0],
                error_px=float(error[0]),
            )
        )
    return table


def target_errors(table: list[Residual]) -> dict[str, float]:
    """P_i of each target: the mean over its images of the residual's norm. [px]"""
    grouped: dict[str, list[float]] = {}
    for r in table:
        grouped.setdefault(r.target, []).append(r.error_px)
    return {t: float(np.mean(v)) for t, v in sorted(grouped.items())}


def held_out_errors(
    problem: Problem, solution: MountingSolution, folds: int = _FOLDS, solve: Solve = solve_mountings
) -> dict[str, float]:
    """P_i of each target by mountings that were estimated without it (k-fold over targets, fixed draw). [px]"""
    targets = sorted({o.target for o in problem.marks} & {o.target for o in problem.vertices})
    order = np.random.default_rng(20220).permutation(len(targets))
    out: dict[str, float] = {}
    for fold in range(min(folds, len(targets))):
        held = {targets[i] for i in order[fold::folds]}
        rest = replace(
            problem,
            marks=tuple(o for o in problem.marks if o.target not in held),
            vertices=tuple(o for o in problem.vertices if o.target not in held),
        )
        try:
            other = solve(rest, snoop=False, start=solution.parameters)
        except EvaluationError:
            continue
        tested = replace(
            problem,
            marks=tuple(o for o in problem.marks if o.target in held),
            vertices=tuple(o for o in problem.vertices if o.target in held),
        )
        tested = on_true_time(tested, other)
        out |= target_errors(residual_table(tested, other.body_from_camera, other.body_from_lidar))
    return dict(sorted(out.items()))


def bootstrap_mean(table: list[Residual], strips: list[int], draws: int = _DRAWS) -> tuple[float, float, float]:
    """(standard deviation, 2.5 %, 97.5 %) of P_m by drawing targets and, independently, strips anew; the draws are fixed.

    Navigation errors are common to all targets of a strip, so drawing targets alone would leave most of the spread out.

    Parameters
    ----------
    table : list of Residual
    strips : list of int
        Strip of each row.
    """
    targets = sorted({r.target for r in table})
    groups = sorted({(r.sortie, s) for r, s in zip(table, strips, strict=True)})
    total, count = np.zeros((2, len(targets), len(groups)))
    for r, s in zip(table, strips, strict=True):
        at = targets.index(r.target), groups.index((r.sortie, s))
        total[at] += r.error_px
        count[at] += 1.0
    rng = np.random.default_rng(41450)
    by_target = rng.multinomial(len(targets), np.full(len(targets), 1.0 / len(targets)), size=draws)
    by_group = rng.multinomial(len(groups), np.full(len(groups), 1.0 / len(groups)), size=draws)
    seen = by_group @ count.T
    weight = by_target * (seen > 0)
    means = np.sum(weight * (by_group @ total.T) / np.maximum(seen, 1.0), axis=1) / np.maximum(weight.sum(axis=1), 1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(means.std(ddof=1)), float(low), float(high)


def evaluate_calibration(
    problem: Problem, solution: MountingSolution, solve: Solve = solve_mountings
) -> CalibrationResult:
    """P_m (20) of a campaign, with uncertainty and companions.

    Parameters
    ----------
    problem : Problem
        As given to `solve_mountings`.
    solution : MountingSolution
    solve : callable
        What gave it, for the figure on held-out targets.

    Returns
    -------
    CalibrationResult
        Companions: `per_sortie_px`, `all_strips_px` (vertex averaged over the sortie's strips), `held_out_px` (k-fold),
        `single_instant` (one rigid transform, 9.3.2 f-i as written),
        `per_target_px`, `rejected`.

    Raises
    ------
    EvaluationError
        No target was seen by both sensors in one sortie.

    References
    ----------
    GB/T 41450-2022, 9.3, formulas (20)-(24).
    """
    kept = without(problem, solution.rejected)
    timed = on_true_time(kept, solution)
    table = residual_table(timed, solution.body_from_camera, solution.body_from_lidar)
    per_target = target_errors(table)
    if not per_target:
        raise EvaluationError("no target was seen by both sensors in one sortie")
    values = np.array(list(per_target.values()))
    strip_of = {(m.sortie, m.image): m.strip for m in kept.marks}
    std, low, high = bootstrap_mean(table, [strip_of[r.sortie, r.image] for r in table])
    per_sortie = {
        str(s): calibration_error(np.array(list(target_errors([r for r in table if r.sortie == s]).values())))
        for s in sorted({r.sortie for r in table})
    }
    held = held_out_errors(kept, solution, solve=solve)
    drifting = residual_table(timed, solution.body_from_camera, solution.body_from_lidar, whole_sortie=True)
    single = solve_single_instant(kept, lidar_marks(kept, mounting_from_sheet(kept.rig.lidar), by_strip=True))
    indicator = IndicatorValue(
        value=calibration_error(values),
        unit="pixel",
        formula="(20)",
        clause="9.3",
        sample_size=len(per_target),
        std=std,
        low_95=low,
        high_95=high,
        method=f"bootstrap over targets and strips, {_DRAWS} draws",
        companions={
            "per_sortie_px": per_sortie,
            "all_strips_px": calibration_error(np.array(list(target_errors(drifting).values()))),
            "held_out_px": calibration_error(np.array(list(held.values()))) if held else None,
            "held_out_folds": _FOLDS,
            "held_out_per_target_px": held,
            "per_target_px": per_target,
            "marks": len(kept.marks),
            "vertices": len(kept.vertices),
            "images": len({(m.sortie, m.image) for m in kept.marks}),
            "rms_u_px": float(np.sqrt(np.mean([(r.projected_px[0] - r.observed_px[0]) ** 2 for r in table]))),
            "rms_v_px": float(np.sqrt(np.mean([(r.projected_px[1] - r.observed_px[1]) ** 2 for r in table]))),
            "rejected": list(solution.rejected),
            "single_instant": single,
        },
    )
    return CalibrationResult(indicator=indicator, residuals=tuple(table))
