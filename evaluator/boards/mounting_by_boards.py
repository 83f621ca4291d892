"""The camera's mounting by the patent's method: S5 to S7 on the boards' centres, with blunders named and weak parameters refused.

Gauss-Newton on xi = [alpha beta gamma dx dy dz] under the full covariance of `board_model`; the drawing's mounting with its
prior is a weighted observation. A board that contradicts all others, in place or by name, is left out by `board_blunders` and
named here. What this flight cannot determine has no value; the strip that would help is found in `board_strips`. Finding
boards in images: `board_observations`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from evaluator.algorithms.record import OWN_TOOLS, Tools
from evaluator.algorithms.solvers import board_task, board_xi
from evaluator.boards.board_blunders import (
    LEAST_BOARDS,
    place_shift,
    swapped_pairs,
    without_blunders,
)
from evaluator.boards.board_count import LEAST_OBSERVATIONS, by_count
from evaluator.boards.board_determined import NAMES, TO_UNITS, UNITS, not_determined
from evaluator.boards.board_model import BoardProblem, Views, navigation_part, remap, views_of
from evaluator.boards.board_observations import (
    BoardObservation,
    boards,
    boards_not_found,
    observe_boards,
    surveyed_boards,
    swapped_by_azimuth,
    thinned,
)
from evaluator.boards.board_strips import rank_and_condition
from evaluator.frames import WorldFrame
from evaluator.model import CampaignData, EvaluationError
from evaluator.mounting.geometry import certified_lens

__all__ = ["NAMES", "BoardMounting", "observe_boards", "solve_by_boards"]


@dataclass(frozen=True, kw_only=True)
class BoardResidual:
    """Residual of one observation after the adjustment: observed minus (11)."""

    target: str
    sortie: int
    image: str
    residual_px: np.ndarray  # (2,)
    adjusted_px: np.ndarray  # (2,) without what navigation and clock most probably did to it; NaN: not used
    used: bool
    uv_px: np.ndarray  # (2,) the sub-pixel centre
    count_px: np.ndarray | None = None  # (2,) whole numbers: S4 as written


@dataclass(frozen=True, kw_only=True)
class BoardMounting:
    """xi with its covariance, and what it rests on. Angles in rad and lengths in m here; degrees in `results_block`."""

    names: tuple[str, ...]
    parameters: np.ndarray  # (6,)
    covariance: np.ndarray  # (6, 6)
    prior_std: np.ndarray  # (6,)
    not_determined: tuple[dict[str, object], ...]
    rejected: tuple[str, ...]  # one line each
    swapped: tuple[tuple[str, str], ...]
    residuals: tuple[BoardResidual, ...]
    sigma0: float
    redundancy: int
    iterations: int
    boards: tuple[str, ...]  # used
    count: dict[str, object] = field(default_factory=dict)  # the same from the half-window count
    rank: int | None = (
        None  # of the images' own normal equations, without priors: 6 when the images hold every parameter
    )
    condition: float | None = None
    images_not_used: int = 0  # beyond what the adjustment can hold
    not_found: dict[str, str] = field(default_factory=dict)  # boards that no image shows well, and why

    @property
    def mean_residual_px(self) -> float:
        """Mean norm of the residuals of (11), S6. [px]"""
        return float(np.mean([np.linalg.norm(r.residual_px) for r in self.residuals if r.used]))

    @property
    def mean_vector_px(self) -> np.ndarray:
        """(2,) mean of the residuals themselves: what no mounting took up in common. [px]"""
        return np.asarray(np.mean([r.residual_px for r in self.residuals if r.used], axis=0))

    @property
    def mean_adjusted_px(self) -> float:
        """The same with each image's pose adjusted: 1 cm and 0.005 degrees of navigation alone move a board by 0.7 px at 45 m
        (f = 3000 px), which no mounting can take away. [px]"""
        return float(np.mean([np.linalg.norm(r.adjusted_px) for r in self.residuals if r.used]))

    def results_block(self) -> dict[str, object]:
        """For results.json; degrees and metres. A parameter that is not determined has no estimate."""
        weak = {str(entry["parameter"]) for entry in self.not_determined}
        std = np.sqrt(np.diag(self.covariance))
        scaled = self.covariance * np.outer(TO_UNITS, TO_UNITS)
        values = self.parameters * TO_UNITS
        count = dict(self.count)
        if "estimates" in count:  # what the flight cannot determine has no value by the count either
            pairs = zip(self.names, cast("list[float]", count["estimates"]), strict=True)
            count["estimates"] = [None if n in weak else v for n, v in pairs]
        return {
            "method": "2x2 boards, steps S3 to S7 of the patent",
            "names": list(self.names),
            "units": list(UNITS),
            "estimates": [None if n in weak else float(v) for n, v in zip(self.names, values, strict=True)],
            "std": [float(v) for v in std * TO_UNITS],
            "prior_std": [float(v) for v in self.prior_std * TO_UNITS],
            "covariance": scaled.tolist(),
            "correlation": (self.covariance / np.outer(std, std)).tolist(),
            "rank": self.rank,
            "condition": self.condition,
            "not_determined": [dict(entry) for entry in self.not_determined],
            "boards": list(self.boards),
            "images": len({(r.sortie, r.image) for r in self.residuals if r.used}),
            "images_not_used": self.images_not_used,
            "observations": sum(r.used for r in self.residuals),
            "mean_residual_px": self.mean_residual_px,
            "mean_residual_vector_px": self.mean_vector_px.tolist(),
            "mean_residual_without_navigation_px": self.mean_adjusted_px,
            "sigma0": self.sigma0,
            "redundancy": self.redundancy,
            "iterations": self.iterations,
            "rejected": list(self.rejected),
            "swapped": [list(pair) for pair in self.swapped],
            "not_found": dict(self.not_found),
            "half_window_count": count,
            "residuals": [
                {
                    "target": r.target,
                    "sortie": r.sortie,
                    "image": r.image,
                    "du_px": float(r.residual_px[0]),
                    "dv_px": float(r.residual_px[1]),
                    "used": r.used,
                    "u_px": float(r.uv_px[0]),
                    "v_px": float(r.uv_px[1]),
                    "count_u_px": None if r.count_px is None else int(r.count_px[0]),
                    "count_v_px": None if r.count_px is None else int(r.count_px[1]),
                }
                for r in self.residuals
            ],
        }


def build_board_problem(data: CampaignData, observations: list[BoardObservation]) -> tuple[BoardProblem, Views]:
    """The adjustment's input from a campaign.

    Raises
    ------
    EvaluationError
        A sheet is missing, a board is not in the survey, or a flight has no trajectory.
    """
    if data.rig is None or data.camera is None:
        raise EvaluationError("no sensors/rig.json or sensors/camera.json")
    surveyed = surveyed_boards(data)
    names = tuple(sorted({o.target for o in observations}))
    missing = [n for n in names if n not in surveyed]
    if missing:
        raise EvaluationError("a board was observed that the survey does not hold", got=missing[0])
    trajectories = {s.folder.number: s.trajectory for s in data.sorties if s.trajectory is not None}
    lost = sorted({o.sortie for o in observations} - trajectories.keys())
    if lost:
        raise EvaluationError("a sortie with boards has no trajectory", got=f"sortie {lost[0]}")
    lens, lens_covariance = certified_lens(data.camera)
    sheet = data.rig.camera
    problem = BoardProblem(
        rig=data.rig,
        lens=lens,
        lens_covariance=lens_covariance,
        image_size_px=(data.camera.width_px, data.camera.height_px),
        boards=names,
        places_m=np.array([surveyed[n][0] for n in names]).reshape(-1, 3),
        place_covariance_m2=np.array([surveyed[n][1] for n in names]).reshape(-1, 3, 3),
        prior_std=np.concatenate([np.full(3, np.radians(sheet.boresight_std_deg)), np.full(3, sheet.lever_arm_std_m)]),
    )
    return problem, views_of(observations, names, trajectories, WorldFrame(data.manifest))


def solve_board_problem(problem: BoardProblem, views: Views, observations: list[BoardObservation]) -> BoardMounting:
    """S5 to S7 on numbers alone; see `solve_by_boards`."""
    uv = np.array([o.uv_px for o in observations], dtype=np.float64).reshape(-1, 2)
    if len(problem.boards) < LEAST_BOARDS or len(uv) < LEAST_OBSERVATIONS:
        raise EvaluationError(
            "too few 2x2 boards in the images",
            got=f"{len(problem.boards)} boards, {len(uv)} observations",
            expected=f"at least {LEAST_BOARDS} boards and {LEAST_OBSERVATIONS} observations",
        )
    fit, use, boards_out, single = without_blunders(problem, views, uv)
    kept = np.flatnonzero(use)
    used = views.rows(kept)
    pairs = swapped_pairs(problem, views, uv, fit, boards_out)
    in_pair = {b for pair in pairs for b in pair}
    rejected = [
        f"{problem.boards[a]} and {problem.boards[b]} are swapped: each fits at the other's place" for a, b in pairs
    ]
    for b, rows in sorted(boards_out.items()):
        if b in in_pair:
            continue
        shift, _ = place_shift(problem, views, uv, fit, rows, b)
        if not np.all(np.isfinite(shift)):
            rejected.append(f"surveyed place of {problem.boards[b]}: no camera that saw it could see it there")
            continue
        rejected.append(
            f"surveyed place of {problem.boards[b]}: {np.linalg.norm(shift):.3f} m off "
            f"(images minus survey: east {shift[0]:+.3f}, north {shift[1]:+.3f}, up {shift[2]:+.3f} m) in {len(rows)} images"
        )
    rejected += [f"board {observations[i].target} in {observations[i].image}" for i in single]
    at = remap(problem, views, fit.xi)
    moved = navigation_part(problem, fit.views, remap(problem, fit.views, fit.xi)) @ (
        fit.inverse_covariance @ fit.residual
    )
    adjusted = np.full_like(uv, np.nan)
    adjusted[kept] = (fit.residual - moved).reshape(-1, 2)
    rank, condition = rank_and_condition(fit.design, fit.inverse_covariance)
    redundancy = 2 * len(kept)  # six parameters, six weighted observations of them
    chi2 = fit.residual @ fit.inverse_covariance @ fit.residual + np.sum((fit.xi / problem.prior_std) ** 2)
    return BoardMounting(
        names=NAMES,
        parameters=fit.xi,
        covariance=fit.covariance,
        prior_std=problem.prior_std,
        not_determined=not_determined(problem, used, fit, fit.covariance),
        rejected=tuple(rejected),
        swapped=tuple((problem.boards[a], problem.boards[b]) for a, b in pairs),
        residuals=tuple(
            BoardResidual(
                target=o.target,
                sortie=o.sortie,
                image=o.image,
                residual_px=uv[i] - at.uv_px[i],
                adjusted_px=adjusted[i],
                used=bool(use[i]),
                uv_px=o.uv_px,
                count_px=o.count_px,
            )
            for i, o in enumerate(observations)
        ),
        sigma0=float(np.sqrt(chi2 / redundancy)),
        redundancy=redundancy,
        iterations=fit.iterations,
        boards=tuple(problem.boards[b] for b in np.unique(used.board)),
        count=by_count(problem, used, [observations[i] for i in kept], fit, TO_UNITS),
        rank=rank,
        condition=condition,
    )


def _as_answered(
    problem: BoardProblem, views: Views, observations: list[BoardObservation], xi: np.ndarray, covariance: np.ndarray
) -> BoardMounting:
    """xi and its covariance by a solver that is not ours, with the residuals of (11) that they leave."""
    residual = np.array([o.uv_px for o in observations], dtype=np.float64) - remap(problem, views, xi).uv_px
    if not np.isfinite(residual).all():
        raise EvaluationError("the mounting that was found puts a board outside the camera's field")
    return BoardMounting(
        names=NAMES,
        parameters=xi,
        covariance=covariance,
        prior_std=problem.prior_std,
        not_determined=(),
        rejected=(),
        swapped=(),
        residuals=tuple(
            BoardResidual(
                target=o.target,
                sortie=o.sortie,
                image=o.image,
                residual_px=r,
                adjusted_px=r,
                used=True,
                uv_px=o.uv_px,
                count_px=o.count_px,
            )
            for o, r in zip(observations, residual, strict=True)
        ),
        sigma0=float("nan"),
        redundancy=2 * len(observations) - 6,
        iterations=0,
        boards=problem.boards,
    )


def solve_by_boards(
    data: CampaignData,
    observations: list[BoardObservation],
    reasons: Mapping[str, str] | None = None,
    tools: Tools = OWN_TOOLS,
) -> BoardMounting:
    """The camera's mounting from the boards' centres in all images.

    Parameters
    ----------
    data : CampaignData
    observations : list of BoardObservation
        Of all images, from `observe_boards`.
    reasons : mapping, optional
        "target, image" -> why there is no centre, of all images, from `observe_boards`: boards that were never found are then
        named in the result, swapped ones as such.
    tools : Tools
        `mounting_solver` is used.

    Returns
    -------
    BoardMounting

    Raises
    ------
    EvaluationError
        Fewer than three boards or four observations, boards that contradict each other, or a missing sheet.

    References
    ----------
    The patent's steps S3 to S7; W. Baarda, A testing procedure for use in geodetic networks, 1968.
    """
    not_found = boards_not_found((t.id for t in boards(data)), reasons or {}, observations)
    observations, left_out = thinned(observations)
    problem, views = build_board_problem(data, observations)
    if len(problem.boards) < LEAST_BOARDS and not_found:
        why = list(not_found.values())
        raise EvaluationError(
            "too few 2x2 boards in the images",
            got=f"{len(problem.boards)} of {len(boards(data))} boards; of the others most: {max(why, key=why.count)}",
            expected=f"at least {LEAST_BOARDS} boards",
            remedy="check nominal mounting and its deviations in rig.json, time stamps, and the survey's sizes and azimuths",
        )
    if tools.mounting_solver is None:
        found = solve_board_problem(problem, views, observations)
    else:
        answer = tools.mounting_solver(board_task(problem, views, observations))
        found = _as_answered(problem, views, observations, *board_xi(problem, answer))
    pairs = swapped_by_azimuth(not_found)
    lines = [f"{a} and {b} are swapped: each stands at the other's azimuth" for a, b in pairs]
    return replace(
        found,
        rejected=(*found.rejected, *lines),
        swapped=(*found.swapped, *pairs),
        not_found=not_found,
        images_not_used=left_out,
    )
