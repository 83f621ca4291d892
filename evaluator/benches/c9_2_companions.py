"""What stands beside M_z (9.2): positions of the board, coverage of the field, correlations, held-out images, uncertainty.

Nothing here changes the lens or the indicator's value.
"""

from collections.abc import Sequence

import numpy as np

from campaign.benches.bench import BoardSheet
from campaign.config import Lens
from evaluator.benches.bench_model import BoardImage
from evaluator.benches.board_adjustment import Observations, Poses, adjust, poses_only
from evaluator.benches.camera_calibration import Calibration, weights
from evaluator.camera_model import LENS_NAMES, ideal_px, lens_vector, undistorted_px
from evaluator.model import EvaluationError
from evaluator.observe.chessboard import BoardCorners

CELLS = (8, 6)  # columns and rows of the field's coverage
_GAP = 0.08  # between the estimated distances of two positions
_STATED_GAP = 0.005  # between stated ones
_DISTANCE_SHARE = 0.2  # between a stated and an estimated distance: a tape to the tripod is better than that
_FOLDS = 5
_DRAWS = 2000
_SEED = 41450
# What a lens of any make would have, one standard deviation: of the focal length and the image's width (shares), k1 k2 k3 p1 p2.
_PRIOR = (0.05, 0.05, 0.05, 0.05, 0.1, 0.2, 0.4, 0.002, 0.002)


def positions_of(distance_m: np.ndarray, stated_m: Sequence[float | None]) -> tuple[np.ndarray, str]:
    """Which of the distances of 9.2.2 d each image belongs to, from 0 (nearest), and the rule that told.

    Stated distances that differ by more than 0.5 % are different positions. Where one is missing, the estimated ones are sorted
    and split wherever the next is more than 8 % farther.
    """
    stated = [d for d in stated_m if d is not None]
    if len(stated) == len(distance_m):
        value, gap, rule = np.asarray(stated, dtype=np.float64), _STATED_GAP, "distance_m of log.csv"
    else:
        value, gap, rule = distance_m, _GAP, "estimated distances, split at gaps beyond 8 %"
    order = np.argsort(value, kind="stable")
    new = np.diff(value[order]) > gap * value[order][:-1]
    position = np.empty(len(value), dtype=np.int64)
    position[order] = np.concatenate([[0], np.cumsum(new)])
    return position, rule


def setup_notes(
    board: BoardSheet, distance_m: np.ndarray, stated_m: Sequence[float | None], focus_m: Sequence[float]
) -> list[str]:
    """What log.csv and board.json state that does not fit the images or itself: units, above all. One line each.

    Parameters
    ----------
    board : BoardSheet
    distance_m : (n,) np.ndarray
        Estimated, camera to the board's centre. [m]
    stated_m : (n,) sequence of float or None
        distance_m of log.csv.
    focus_m : sequence of float
        Every focus setting of the series.
    """
    notes = []
    ratio = np.array([s / d for s, d in zip(stated_m, distance_m, strict=True) if s is not None])
    off = np.abs(ratio - 1.0) > _DISTANCE_SHARE
    if off.any():
        notes.append(
            f"distance_m of log.csv differs from the estimated distance by more than {_DISTANCE_SHARE:.0%} in {off.sum()} of "
            f"{ratio.size} images (it is {np.median(ratio[off]):.3g} times it): check its unit, and square_m of board.json"
        )
    for count, whole, key in (
        (board.inner_columns + 1, board.width_m, "width_m"),
        (board.inner_rows + 1, board.height_m, "height_m"),
    ):
        squares = count * board.square_m
        if whole is not None and (squares > whole * (1.0 + 1e-6) or squares < whole / 3.0):
            notes.append(
                f"{count} squares of square_m are {squares:.3g} m, where {key} of board.json is {whole:.3g} m: check their units"
            )
    if len(focus_m) > 1:
        notes.append(
            f"the focus was changed during the series: {len(focus_m)} settings from {focus_m[0]:g} to {focus_m[-1]:g} m; one lens "
            "was estimated for all"
        )
    return notes


def coverage_of(images: Sequence[BoardImage], size_px: tuple[int, int], cells: tuple[int, int]) -> np.ndarray:
    """(positions, rows, columns) corners in each cell of the field."""
    positions = max(image.position for image in images) + 1
    count = np.zeros((positions, cells[1], cells[0]), dtype=np.int64)
    for image in images:
        cell = np.floor(image.observed_px / np.array(size_px) * np.array(cells)).astype(int)
        cell = np.clip(cell, 0, np.array(cells) - 1)
        np.add.at(count[image.position], (cell[:, 1], cell[:, 0]), 1)
    return count


def uncertainty_of(errors_px: Sequence[np.ndarray]) -> tuple[float, float, float]:
    """(standard deviation, 2.5 %, 97.5 %) of the mean of all norms by drawing images with replacement, fixed draws. [px]"""
    rng = np.random.default_rng(_SEED)
    total = np.array([e.sum() for e in errors_px])
    count = np.array([e.size for e in errors_px])
    draw = rng.integers(0, len(total), size=(_DRAWS, len(total)))
    mean = total[draw].sum(axis=1) / count[draw].sum(axis=1)
    low, high = np.quantile(mean, (0.025, 0.975))
    return float(mean.std(ddof=1)), float(low), float(high)


def held_out_px(c: Calibration, obs: Observations) -> float | None:
    """Mean norm of (19) on images that took no part in the lens (five folds); each gets its own pose. None: too few images. [px]"""
    used = np.flatnonzero(c.image_use)
    if len(used) < 2 * LEAST_TRAINING:
        return None
    fold = np.arange(len(used)) % _FOLDS
    norms = []
    for f in range(_FOLDS):
        train, test = used[fold != f], used[fold == f]
        try:
            lens = _part(c, obs, train, c.lens, fixed=False)[0]
            _, poses = _part(c, obs, test, lens, fixed=True)
        except EvaluationError:
            return None
        for j, i in enumerate(test):
            on = c.use[i]
            ideal = ideal_px(lens, obs.board_m[on] @ poses.rotation[j].T + poses.translation_m[j])
            norms.append(np.linalg.norm(undistorted_px(lens, obs.uv_px[i][on]) - ideal, axis=1))
    return float(np.concatenate(norms).mean())


LEAST_TRAINING = 4


def _part(c: Calibration, obs: Observations, index: np.ndarray, lens: Lens, *, fixed: bool) -> tuple[Lens, Poses]:
    part = Observations(
        board_m=obs.board_m,
        uv_px=obs.uv_px[index],
        covariance_px2=obs.covariance_px2[index],
        size_px=obs.size_px,
    )
    poses = Poses(rotation=c.poses.rotation[index], translation_m=c.poses.translation_m[index])
    weight = weights(part, c.use[index], c.floor_px, c.factor[index])
    if fixed:
        return lens, poses_only(lens, poses, part, weight)
    lens, poses, _, _ = adjust(lens, poses, part, weight, np.ones(9, bool))
    return lens, poses


def radial_at_corner_px(lens: Lens, size_px: tuple[int, int]) -> float | None:
    """Radially symmetric distortion at the image's corner farthest from the principal point: observed minus ideal radius. [px]

    None where the polynomial folds back before it.
    """
    radial = lens.model_copy(update={"p1": 0.0, "p2": 0.0})
    centre = lens_vector(lens)[2:4]
    corners = np.array([(u, v) for u in (0.0, size_px[0]) for v in (0.0, size_px[1])])
    far = corners[[int(np.argmax(np.linalg.norm(corners - centre, axis=1)))]]
    with np.errstate(all="ignore"):
        try:
            ideal = undistorted_px(radial, far)
        except np.linalg.LinAlgError:
            return None
    value = float(np.linalg.norm(far - centre) - np.linalg.norm(ideal - centre))
    return value if np.isfinite(value) else None


def companions_of(
    c: Calibration,
    obs: Observations,
    images: Sequence[BoardImage],
    boards: Sequence[BoardCorners],
    distance_m: np.ndarray,
    rule: str,
    board: BoardSheet,
    not_used: dict[str, str],
    focus_distance_m: float | None,
    f_number: float | None,
) -> dict[str, object]:
    """Plain numbers, strings, lists and dicts for results.json."""
    std = np.sqrt(np.diag(c.covariance))
    correlation = c.covariance / np.outer(std, std)
    values = lens_vector(c.lens)
    prior = np.array(_PRIOR)
    prior[:2] *= values[:2]
    prior[2:4] *= obs.size_px[0]
    positions = max(image.position for image in images) + 1
    coverage = coverage_of(images, obs.size_px, CELLS)
    rotation = np.stack([image.camera_from_board_rotation for image in images])
    tilt = np.degrees(np.arccos(np.clip(np.abs(rotation[:, 2, 2]), 0.0, 1.0)))
    per_image = [
        {
            "image": image.image,
            "corners": len(image.error_px),
            "rms_px": float(np.sqrt(np.mean(image.error_px**2))),
            "mean_px": float(image.error_px.mean()),
            "position": image.position,
            "distance_m": float(d),
            "tilt_deg": float(t),
            "square_px": found.square_px,
            "blur_px": found.blur_px,
        }
        for image, found, d, t in zip(images, boards, distance_m, tilt)
    ]
    errors = np.concatenate([image.error_px for image in images])
    own = np.sqrt(np.trace(obs.covariance_px2, axis1=-2, axis2=-1)[c.use] / 2.0)
    return {
        "parameters": list(LENS_NAMES),
        "parameter_units": ["px"] * 4 + [""] * 5,
        "estimates": [float(v) for v in values],
        "std": [float(s) for s in std],
        "std_by_image": [float(s) for s in np.sqrt(np.diag(c.covariance_by_image))],
        "covariance": c.covariance.tolist(),
        "correlation": correlation.tolist(),
        "strong_correlations": [
            {"parameters": [LENS_NAMES[i], LENS_NAMES[j]], "correlation": float(correlation[i, j])}
            for i in range(9)
            for j in range(i)
            if abs(correlation[i, j]) > 0.95
        ],
        "not_determined": [name for name, s, p in zip(LENS_NAMES, std, prior) if s > 0.5 * p],
        "prior_std": [float(p) for p in prior],
        "sigma0_px": c.sigma0_px,
        "rms_px": float(np.sqrt(np.mean(errors**2))),
        "max_px": float(errors.max()),
        "corner_std_px": float(np.median(own)),
        "unexplained_px": c.floor_px,
        "redundancy": c.redundancy,
        "iterations": c.iterations,
        "held_out_px": held_out_px(c, obs),
        "per_image": per_image,
        "positions_by": rule,
        "distances_m": [float(distance_m[[i.position == p for i in images]].mean()) for p in range(positions)],
        "images_by_position": [sum(i.position == p for i in images) for p in range(positions)],
        "coverage_cells": list(CELLS),
        "coverage_counts": coverage.tolist(),
        "coverage_by_position": [float(np.mean(count > 0)) for count in coverage],
        "coverage": float(np.mean(coverage.sum(axis=0) > 0)),
        "tilt_deg": [float(tilt.min()), float(tilt.max())],
        "board": {
            "inner_columns": board.inner_columns,
            "inner_rows": board.inner_rows,
            "square_m": board.square_m,
        },
        "image_size_px": list(obs.size_px),
        "radial_distortion_at_corner_px": radial_at_corner_px(c.lens, obs.size_px),
        "focus_distance_m": focus_distance_m,
        "f_number": f_number,
        "rejected": {name: why for name, why in not_used.items() if why.startswith("rejected:")},
        "not_used": dict(not_used),
    }
