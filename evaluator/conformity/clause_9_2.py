"""9.2.2: how the chessboard was photographed. Its size and the room stand in clause_6_3."""

import numpy as np

from evaluator.benches.bench_model import ChessboardResult
from evaluator.conformity.clause_6_3 import board_images, has_chessboard
from evaluator.conformity.model import ConformityInputs, Row, missing, passed, row
from evaluator.model import CampaignData

_POSITIONS = 4
_ANGLE_DEG = 10.0  # between two boards of one position; the text asks for different angles and states none


def board_angles_deg(result: ChessboardResult) -> dict[int, float]:
    """For each position the greatest angle between the normals of two of its boards. [deg]"""
    normals: dict[int, list[np.ndarray]] = {}
    for image in result.images:
        normals.setdefault(image.position, []).append(image.camera_from_board_rotation[:, 2])
    out = {}
    for position, found in sorted(normals.items()):
        n = np.array(found)
        out[position] = float(np.degrees(np.arccos(np.clip((n @ n.T).min(), -1.0, 1.0))))
    return out


def _angles(result: ChessboardResult | None) -> Row:
    requirement, limit = "board or camera turned to different angles", f"not quantified; > {_ANGLE_DEG:g}° here"
    if result is None or not result.images:
        return missing("9.2.2 c", requirement, limit, "image with the board in it")
    angles = board_angles_deg(result)
    worst = min(angles, key=angles.__getitem__)
    text = f"normals differ by up to {angles[worst]:.0f}° at the position where they differ least"
    text += f", by {max(angles.values()):.0f}° at most" if len(angles) > 1 else ""
    return row("9.2.2 c", requirement, text, limit, passed(angles[worst] > _ANGLE_DEG))


def _focus(data: CampaignData, result: ChessboardResult | None) -> Row:
    """One calibration is of one lens: whoever refocuses between images photographs the board with several."""
    requirement, limit = "settings of the lens kept", "one focus setting in all images"
    stated = {e.focus_distance_m for e in data.bench.board_log if e.focus_distance_m is not None}
    if result is not None:
        one = () if result.focus_distance_m is None else (result.focus_distance_m,)
        stated |= {*result.focus_settings_m, *one}
    settings = sorted(stated)
    if not settings:
        return missing("9.2.2 b", requirement, limit, "focus_distance_m in bench/chessboard/log.csv")
    text = f"{settings[0]:g} m" if len(settings) == 1 else f"{len(settings)}: {settings[0]:g} m to {settings[-1]:g} m"
    return row("9.2.2 b", requirement, text, limit, passed(len(settings) == 1))


def _distances(result: ChessboardResult | None) -> Row:
    requirement, limit = "distances between board and camera", f"≥ {_POSITIONS}"
    if result is None or not result.distances_m:
        return missing("9.2.2 d", requirement, limit, "image with the board in it")
    text = f"{len(result.distances_m)}: {', '.join(f'{d:.2f}' for d in result.distances_m)} m"
    return row("9.2.2 d", requirement, text, limit, passed(len(result.distances_m) >= _POSITIONS))


def _covered(result: ChessboardResult | None) -> Row:
    requirement, limit = "whole field of view covered at each distance", "a corner in every cell of the field"
    if result is None or result.coverage is None or not result.coverage.size:
        return missing("9.2.2 d", requirement, limit, "image with the board in it")
    seen = (result.coverage > 0).sum(axis=(1, 2))
    cells = int(np.prod(result.coverage.shape[1:]))
    worst = int(seen.argmin())
    at = f" at {result.distances_m[worst]:.2f} m" if worst < len(result.distances_m) else ""
    text = f"{seen[worst]} of {cells} cells{at}, where it is least"
    return row("9.2.2 d", requirement, text, limit, passed(bool((seen == cells).all())))


def clause_9_2(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    """Rows of 9.2.2; one row where the campaign has no chessboard."""
    if not has_chessboard(data):
        requirement, limit = "images of a chessboard", "9.2.2 a to h"
        return [row("9.2.2", requirement, "no chessboard in this campaign", limit, "not_applicable")]
    result = measured.chessboard
    return [
        _focus(data, result),
        _angles(result),
        _covered(result),
        _distances(result),
        board_images("9.2.2", data, measured),
    ]
