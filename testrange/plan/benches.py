"""Rows of the benches that their set-up decides: places of the chessboard, scans of the line. The others wait for pictures."""

from dataclasses import replace

import numpy as np

from campaign.config import Config
from evaluator.benches.bench_model import BoardImage, ChessboardResult
from evaluator.conformity import ConformityInputs, Row
from evaluator.conformity.clause_9_2 import clause_9_2
from evaluator.model import CampaignData
from evaluator.results_model import not_measured
from scenes.chessboard import board_of
from simulator.bench.placements import bench_focus_m, bench_lens, coverage, plan_placements
from simulator.lidar.ranging import Line

LEAST_SCANS, SHORT_S = 5, 60.0  # 9.1.2 f, b


def set_up_rows(
    config: Config, data: CampaignData, measured: ConformityInputs, line: Line | None
) -> dict[tuple[str, str], Row]:
    """Rows by clause and requirement, in the place of those that say that no picture and no scan is there yet."""
    rows: list[Row] = []
    if data.bench.board_log:
        placed = clause_9_2(data, replace(measured, chessboard=_placed(config)))
        rows += [row for row in placed if row.clause in ("9.2.2 c", "9.2.2 d")]
    if line is not None:
        rows += _scans(config, line)
    return {(row.clause, row.requirement): row for row in rows}


def _placed(config: Config) -> ChessboardResult:
    """The chessboard where the plan of the bench puts it, as if every picture had been found."""
    board, lens, plan = board_of(config.bench.chessboard), bench_lens(config), plan_placements(config)
    size = (config.camera.width_px, config.camera.height_px)
    distances = sorted({p.distance_m for p in plan})
    none = np.zeros((0, 2))
    return ChessboardResult(
        indicator=not_measured("pixel", "(16)", "9.2", "planned"),
        image_size_px=size,
        focus_distance_m=bench_focus_m(config),
        images=tuple(
            BoardImage(
                image=f"b_{k + 1:03d}.tif",
                corner=none.astype(int),
                observed_px=none,
                projected_px=none,
                error_px=none[:, 0],
                camera_from_board_rotation=p.rotation,
                camera_from_board_translation_m=p.translation_m,
                position=distances.index(p.distance_m),
            )
            for k, p in enumerate(plan)
        ),
        distances_m=tuple(distances),
        coverage=np.stack(
            [coverage(lens, np.array(size, float), board, [p for p in plan if p.distance_m == d]) for d in distances]
        ),
    )


def _scans(config: Config, line: Line) -> list[Row]:
    corner = line.setting.corners_m.reshape(-1, 3)
    middle = line.setting.corners_m.mean(axis=(0, 1))
    along = np.degrees(np.arctan2(corner[:, 0], corner[:, 1]) - np.arctan2(middle[0], middle[1]))
    along = (along + 180.0) % 360.0 - 180.0
    spread = np.asarray(config.lidar.scanner.channel_elevations_deg or (0.0,))
    seconds = float(np.ptp(along) + np.ptp(spread)) / config.ranging.turn_rate_deg_s
    scans = config.ranging.scans
    return [
        Row(
            clause="9.1.2 b",
            requirement="all panels scanned within a short interval",
            measured=f"{seconds:.1f} s a scan at most",
            limit=f"stated; warning beyond {SHORT_S:.0f} s a scan",
            status="pass" if seconds <= SHORT_S else "warning",
        ),
        Row(
            clause="9.1.2 f",
            requirement="observations by the LiDAR",
            measured=f"{scans} scans of {len(line.setting.panels)} panels",
            limit=f"≥ {LEAST_SCANS} of each panel",
            status="pass" if scans >= LEAST_SCANS else "fail",
        ),
    ]
