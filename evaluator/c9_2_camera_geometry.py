"""Clause 9.2: mean reprojection error M_z of the camera, formulas (16)-(19), and what stands beside it.

Corners come from `observe.chessboard`, lens and poses from `camera_calibration`; what is said about the figures beside M_z
(coverage, correlations, held-out images) lives in `c9_2_companions`, grades in `c10_1_grading`.
"""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from campaign.benches.bench import BoardExposure, BoardSheet
from campaign.benches.pictures import PictureSize, picture_size, read_picture
from campaign.config import Lens
from campaign.errors import TestrangeError
from campaign.progress import Report
from evaluator.benches.bench_model import BoardImage, ChessboardResult
from evaluator.benches.board_adjustment import Observations, board_points
from evaluator.benches.c9_2_companions import (
    CELLS,
    companions_of,
    coverage_of,
    positions_of,
    setup_notes,
    uncertainty_of,
)
from evaluator.benches.camera_calibration import Calibration, calibrate
from evaluator.camera_model import ideal_px, undistorted_px
from evaluator.load import in_folder
from evaluator.model import CampaignData, EvaluationError
from evaluator.observe.chessboard import (
    BoardCorners,
    NoBoard,
    find_corners,
    goes_on,
    grey_picture,
    is_symmetric,
    oriented,
    seen_size,
)
from evaluator.observe.sphere_images import check_depth
from evaluator.results_model import IndicatorValue, not_measured

LEAST_IMAGES = 4  # below, nothing is computed; 9.2.2 asks for 20
STANDARD_IMAGES = 20
_THREADS = 2
_HINT_PICTURES = 3
_FOCAL_SHARE = 0.01  # a standard deviation beyond this share of the focal length: not determined
_FLAT_DEG = 3.0


def mean_reprojection_error(projected_px: np.ndarray, observed_px: np.ndarray) -> float:
    """Mean reprojection error M_z.

    Parameters
    ----------
    projected_px : (n, 2) array_like
        Corners projected by (16). [px]
    observed_px : (n, 2) array_like
        Corners as observed, distortion removed. [px]

    Returns
    -------
    float
        M_z, the mean of the residuals' norms. [px]

    Raises
    ------
    EvaluationError
        No corner, unequal lengths, or a value that is not finite.

    References
    ----------
    GB/T 41450-2022, 9.2.1 and 9.2.2 g, formula (19).
    """
    projected, observed = np.asarray(projected_px, dtype=np.float64), np.asarray(observed_px, dtype=np.float64)
    if projected.ndim != 2 or projected.shape != observed.shape or projected.shape[1] != 2 or not len(projected):
        raise EvaluationError(
            "formula (19) needs as many projected as observed corners",
            got=f"{projected.shape} and {observed.shape}",
            expected="(n, 2) each, n >= 1",
        )
    if not (np.all(np.isfinite(projected)) and np.all(np.isfinite(observed))):
        raise EvaluationError("formula (19): a coordinate is not finite")
    return float(np.mean(np.linalg.norm(projected - observed, axis=1)))


def project_16(lens: Lens, rotation: np.ndarray, translation_m: np.ndarray, p_board_m: np.ndarray) -> np.ndarray:
    """Corners of the board to ideal pixels: s [u v 1] = K (R X + t).

    Parameters
    ----------
    lens : Lens
        fx, fy, cx, cy are used; distortion is removed from the observations instead.
    rotation, translation_m : (3, 3), (3,) np.ndarray
        camera_from_board.
    p_board_m : (n, 3) np.ndarray
        [m]

    Returns
    -------
    (n, 2) np.ndarray
        NaN behind the camera. [px]

    References
    ----------
    GB/T 41450-2022, 9.2.2 e, formula (16), in image axes.
    """
    return ideal_px(lens, np.asarray(p_board_m, dtype=np.float64) @ np.asarray(rotation).T + translation_m)


@dataclass(kw_only=True)
class _Seen:
    """What the pictures gave, in the order of log.csv."""

    rows: list[BoardExposure] = field(default_factory=list)
    boards: list[BoardCorners] = field(default_factory=list)
    not_used: dict[str, str] = field(default_factory=dict)
    size: PictureSize | None = None


def evaluate_chessboard(data: CampaignData, progress: Report) -> ChessboardResult:
    """M_z and the camera's calibration from bench/chessboard; never raises for what the folder holds.

    Parameters
    ----------
    data : CampaignData
    progress : callable
        Called with ("chessboard", pictures done, pictures).

    Returns
    -------
    ChessboardResult
        Without a value the indicator carries the reason; pictures that could not serve are in `not_used`.

    References
    ----------
    GB/T 41450-2022, 9.2.2.
    """
    board = data.bench.board
    if board is None or not data.bench.board_log:
        missing = "/board.json" if board is None else "/log.csv with a row for each image"
        missing = missing if data.folder.chessboard.is_dir() else ""
        broken = next((p for p in data.problems if "bench/chessboard" in p), None)
        return ChessboardResult(indicator=_no_value(broken or f"no bench/chessboard{missing} in this campaign"))
    try:
        seen = _observe(data, board, progress)
    except TestrangeError as error:
        return ChessboardResult(indicator=_no_value(in_folder(error, data.folder.root)))
    size = (seen.size.width_px, seen.size.height_px) if seen.size else None
    try:
        if len(seen.boards) < LEAST_IMAGES:
            raise EvaluationError(*_too_few(data, board, seen))
        return _evaluate(data, board, seen)
    except (TestrangeError, np.linalg.LinAlgError, cv2.error) as error:
        reason = in_folder(error, data.folder.root) if isinstance(error, TestrangeError) else f"no calibration: {error}"
        reason += _larger_board(data, board, seen)
        found = [row.image for row in seen.rows]
        indicator = _no_value(reason, boards_found=found, not_used=dict(seen.not_used))
        return ChessboardResult(indicator=indicator, image_size_px=size, not_used=seen.not_used)


def _no_value(reason: str, **companions: object) -> IndicatorValue:
    return not_measured("pixel", "(19)", "9.2", reason, **companions)


def _observe(data: CampaignData, board: BoardSheet, progress: Report) -> _Seen:
    """Corners of every picture; two threads, results in the order of log.csv."""
    folder, root = data.folder.chessboard, data.folder.root
    seen = _Seen()
    sizes: dict[str, PictureSize] = {}
    for row in data.bench.board_log:
        try:
            sizes[row.image] = picture_size(data.folder.held(folder / row.image))
        except TestrangeError as error:
            seen.not_used[row.image] = in_folder(error, root)
    count = Counter((s.width_px, s.height_px) for s in sizes.values())
    if not count:
        return seen
    common = count.most_common(1)[0][0]  # of equals the first that log.csv names
    seen.size = next(s for s in sizes.values() if (s.width_px, s.height_px) == common)
    for name, size in sizes.items():
        if (size.width_px, size.height_px) != common:
            seen.not_used[name] = f"another size: {size}, where most are {common[0]} x {common[1]} px"
    todo = [row for row in data.bench.board_log if row.image in sizes and row.image not in seen.not_used]
    camera = data.camera if data.camera and (data.camera.width_px, data.camera.height_px) == common else None

    def look(row: BoardExposure, thorough: bool) -> BoardCorners | TestrangeError:
        try:
            picture = read_picture(folder / row.image)
            if camera and picture.dtype == np.uint16:
                check_depth(folder / row.image, picture, camera)
            return find_corners(
                picture,
                board.inner_columns,
                board.inner_rows,
                black_level=camera.black_level_dn if camera and picture.dtype == np.uint16 else 0.0,
                full_scale=2**camera.bit_depth - 1 if camera and picture.dtype == np.uint16 else None,
                thorough=thorough,
            )
        except TestrangeError as error:
            return error
        except (cv2.error, np.linalg.LinAlgError) as error:
            return NoBoard("no chessboard found", got=error)

    progress("chessboard", 0, len(todo))
    results: list[BoardCorners | TestrangeError] = []
    with ThreadPoolExecutor(_THREADS) as pool:
        for found in pool.map(lambda row: look(row, False), todo):
            results.append(found)
            progress("chessboard", len(results), len(todo))
        # Where the quick search finds no board at all, the slow one must find one in three pictures to go on.
        again = [i for i, found in enumerate(results) if isinstance(found, NoBoard)]
        first = again[:_HINT_PICTURES] if len(again) == len(todo) else again
        for part in (first, again[len(first) :]):
            if part is first or any(not isinstance(results[i], NoBoard) for i in first):
                for i, found in zip(part, pool.map(lambda i: look(todo[i], True), part)):
                    results[i] = found
    boards: list[BoardCorners] = []
    for row, found in zip(todo, results, strict=True):
        if isinstance(found, BoardCorners):
            seen.rows.append(row)
            boards.append(found)
        else:
            seen.not_used[row.image] = in_folder(found, root)
    seen.boards = oriented(boards)
    return seen


def _too_few(data: CampaignData, board: BoardSheet, seen: _Seen) -> tuple[str]:
    """The reason, with the size of the board that the pictures seem to show where none was found."""
    of = len(data.bench.board_log)
    stated = f"{board.inner_columns} x {board.inner_rows} inner corners"
    if seen.boards:
        first = next(iter(seen.not_used.items()), None)
        more = f"; for example {first[0]}: {first[1]}" if first else ""
        return (
            f"too few images with the whole board ({stated}); got {len(seen.boards)} of {of}; expected at least {LEAST_IMAGES}"
            f" (9.2.2: {STANDARD_IMAGES}){more}",
        )
    looked = [name for name, why in seen.not_used.items() if "no chessboard found" in why]
    for name in looked[:_HINT_PICTURES]:
        hint = _hint(data.folder.chessboard / name, board)
        if hint:
            return (
                f"no board of {stated} in any of {of} images; {name} seems to show {hint[0]} x {hint[1]}; correct board.json",
            )
    first = next(iter(seen.not_used.items()), None)
    if first and not looked:
        return (f"none of {of} images can be used; for example {first[0]}: {first[1]}",)
    return (f"no board of {stated} in any of {of} images" + (f"; for example {first[0]}: {first[1]}" if first else ""),)


def _larger_board(data: CampaignData, board: BoardSheet, seen: _Seen) -> str:
    """What to add where a calibration failed because only a part of a larger board was looked for."""
    if len(seen.boards) < LEAST_IMAGES:
        return ""
    stated = f"{board.inner_columns} x {board.inner_rows} inner corners"
    for row in seen.rows[:_HINT_PICTURES]:
        try:
            grey = grey_picture(read_picture(data.folder.chessboard / row.image))
        except TestrangeError:
            continue
        if goes_on(grey, board.inner_columns, board.inner_rows):
            return f"; the pattern in {row.image} goes on beyond the {stated} that board.json states"
    return ""


def _hint(path: Path, board: BoardSheet) -> tuple[int, int] | None:
    try:
        return seen_size(grey_picture(read_picture(path)), board.inner_columns, board.inner_rows)
    except (TestrangeError, cv2.error):
        return None


def _evaluate(data: CampaignData, board: BoardSheet, seen: _Seen) -> ChessboardResult:
    assert seen.size is not None
    size = (seen.size.width_px, seen.size.height_px)
    obs = Observations(
        board_m=board_points(board.inner_columns, board.inner_rows, board.square_m),
        uv_px=np.stack([b.uv_px for b in seen.boards]),
        covariance_px2=np.stack([b.covariance_px2 for b in seen.boards]),
        size_px=size,
    )
    camera = data.camera
    same = camera is not None and (camera.width_px, camera.height_px) == size
    focal = camera.nominal_focal_length_mm / camera.pixel_size_um * 1e3 if camera is not None and same else None
    calibration = calibrate(obs, focal_px=focal)
    used = np.flatnonzero(calibration.image_use)
    rows = [seen.rows[i] for i in used]
    not_used = dict(seen.not_used) | {
        seen.rows[i].image: f"rejected: {why}" for i, why in sorted(calibration.rejected.items())
    }
    centre = obs.board_m.mean(axis=0)
    from_camera = calibration.poses.rotation[used] @ centre + calibration.poses.translation_m[used]
    distance = np.linalg.norm(from_camera, axis=1)
    position, rule = positions_of(distance, [row.distance_m for row in rows])
    _check_determined(calibration, used, int(position.max()) + 1)
    images = tuple(
        _board_image(calibration, obs, board, int(i), row.image, int(p)) for i, row, p in zip(used, rows, position)
    )
    errors = [image.error_px for image in images]
    value = float(np.concatenate(errors).mean())
    std, low, high = uncertainty_of(errors)
    focus, f_number = _common([r.focus_distance_m for r in rows]), _common([r.f_number for r in rows])
    settings = tuple(sorted({r.focus_distance_m for r in rows if r.focus_distance_m is not None}))
    companions = companions_of(
        calibration, obs, images, [seen.boards[i] for i in used], distance, rule, board, not_used, focus, f_number
    )
    notes = _notes(len(images), int(position.max()) + 1, board, data, same)
    notes += setup_notes(board, distance, [row.distance_m for row in rows], settings)
    wild = [
        f"corner {c % board.inner_columns}, {c // board.inner_columns} of {seen.rows[i].image}"
        for i, c in calibration.wild
    ]
    if wild:
        companions["with_rejected_corners_px"] = _with_wild(calibration, obs, used)
    return ChessboardResult(
        indicator=IndicatorValue(
            value=value,
            unit="pixel",
            formula="(19)",
            clause="9.2",
            sample_size=len(images),
            std=std,
            low_95=low,
            high_95=high,
            method="bootstrap over images, 2000 fixed draws; the calibration itself held",
            companions=companions
            | {"rejected_corners": wild, "notes": notes, "boards_found": [row.image for row in seen.rows]},
        ),
        lens=calibration.lens,
        covariance=calibration.covariance,
        image_size_px=size,
        focus_distance_m=focus,
        focus_settings_m=settings,
        f_number=f_number,
        images=images,
        not_used=not_used,
        distances_m=tuple(float(distance[position == p].mean()) for p in range(int(position.max()) + 1)),
        coverage=coverage_of(images, size, CELLS),
    )


def _board_image(c: Calibration, obs: Observations, board: BoardSheet, i: int, name: str, position: int) -> BoardImage:
    on = c.use[i]
    observed = obs.uv_px[i][on]
    ideal = project_16(c.lens, c.poses.rotation[i], c.poses.translation_m[i], obs.board_m[on])
    index = np.flatnonzero(on)
    return BoardImage(
        image=name,
        corner=np.stack([index % board.inner_columns, index // board.inner_columns], axis=1),
        observed_px=observed,
        projected_px=observed - c.residual_px[i][on],
        error_px=np.linalg.norm(undistorted_px(c.lens, observed) - ideal, axis=1),
        camera_from_board_rotation=c.poses.rotation[i],
        camera_from_board_translation_m=c.poses.translation_m[i],
        position=position,
    )


def _with_wild(c: Calibration, obs: Observations, used: np.ndarray) -> float:
    """M_z over every fitted corner of the accepted images, wild ones too. [px]"""
    projected, observed = [], []
    for i in used:
        seen = np.isfinite(obs.uv_px[i, :, 0])
        observed.append(undistorted_px(c.lens, obs.uv_px[i][seen]))
        projected.append(project_16(c.lens, c.poses.rotation[i], c.poses.translation_m[i], obs.board_m[seen]))
    return mean_reprojection_error(np.concatenate(projected), np.concatenate(observed))


def _check_determined(c: Calibration, used: np.ndarray, positions: int) -> None:
    tilt = np.degrees(np.arccos(np.clip(np.abs(c.poses.rotation[used, 2, 2]), 0.0, 1.0)))
    std = np.sqrt(np.diag(c.covariance))[:2] / np.array([c.lens.fx_px, c.lens.fy_px])
    if std.max() > _FOCAL_SHARE or (positions == 1 and tilt.max() < _FLAT_DEG):
        raise EvaluationError(
            "the images do not determine the focal length",
            got=f"{positions} distance{'s' if positions > 1 else ''}, tilts up to {tilt.max():.1f} deg, "
            f"standard deviation {100.0 * std.max():.2g} % of it",
            expected=f"at most {100.0 * _FOCAL_SHARE:g} %",
            remedy="tilt the board, and take it at four distances (9.2.2 d)",
        )


def _common(values: list[float | None]) -> float | None:
    return values[0] if values and all(v == values[0] for v in values) else None


def _notes(images: int, positions: int, board: BoardSheet, data: CampaignData, same: bool) -> list[str]:
    notes = []
    if images < STANDARD_IMAGES:
        notes.append(f"{images} images, where 9.2.2 asks for {STANDARD_IMAGES}")
    if positions < 4:
        notes.append(f"{positions} distance{'s' if positions > 1 else ''}, where 9.2.2 d asks for 4")
    if is_symmetric(board.inner_columns, board.inner_rows):
        notes.append(
            "the board looks the same turned by 180 degrees: corner (0, 0) is the end nearer the image's top left corner"
        )
    if data.camera is not None and not same:
        notes.append("the images are not of the size in sensors/camera.json: its sheet was not used")
    return notes
