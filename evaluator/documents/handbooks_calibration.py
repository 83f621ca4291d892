"""Calculation handbook B.2, third part: P_m (9.3): vertices, marks, error of every target, the transform from LiDAR to camera.

Pixels are printed with distortion removed, as they enter (24): the distance of the two printed points is the printed error.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from evaluator.camera_model import undistorted_px
from evaluator.documents.handbooks_common import blunder, companions, cut, figure, missing, value_figure
from evaluator.documents.model import Block, Cell, Figure, Formula, Heading, Language, Paragraph, Table, say
from evaluator.frames import WorldFrame
from evaluator.georeference import world_points
from evaluator.model import CampaignData, MountingSolution
from evaluator.mounting.geometry import certified_lens, surveyed_marks
from evaluator.results import Evaluation, Residual

_ID = "calibration_error"
_AT = f"indicators.{_ID}.companions"
_WORDS = {
    "camera_boresight": ("相机安置角", "camera boresight"),
    "lidar_boresight": ("激光雷达安置角", "LiDAR boresight"),
    "camera_lever_arm": ("相机偏心分量", "camera lever arm"),
    "lidar_lever_arm": ("激光雷达偏心分量", "LiDAR lever arm"),
    "camera_clock": ("相机时钟偏差", "camera clock"),
    "lidar_clock": ("激光雷达时钟偏差", "LiDAR clock"),
}


@dataclass(frozen=True, kw_only=True)
class TargetRow:
    """One row of table B.2."""

    target: str
    image: str
    world_m: Sequence[float] | None
    lidar_px: Sequence[float]
    camera_px: Sequence[float]
    error_px: float


def calibration_blocks(evaluation: Evaluation, results: Mapping[str, Any], language: Language) -> list[Block]:
    """Section 3 of B.2.

    References
    ----------
    GB/T 41450-2022, 9.3.
    """
    blocks: list[Block] = [
        Heading(text=say(language, "3　多传感器几何一致性（9.3）", "3  Geometric consistency of both sensors (9.3)")),
        *missing(results, _ID, language),
    ]
    if evaluation.mounting is None or evaluation.data is None or not evaluation.residuals:
        return blocks
    rows = target_rows(evaluation, evaluation.data, evaluation.mounting)
    per_target = companions(results, _ID).get("per_target_px") or {}
    errors = [(t, figure(results, f"{_AT}.per_target_px.{t}", 4)) for t in sorted(per_target)]
    return [
        *blocks,
        Paragraph(
            text=say(
                language,
                "激光雷达点为梯形棱台各侧面的公共顶点（9.3.2 d），经航迹与平差后的安置参数换算到世界坐标系（站心东、北、天）；"
                "像素坐标以影像左上角为原点，已改正畸变。",
                "The LiDAR's point is the common vertex of a target's faces (9.3.2 d), taken to the world frame (east, north, up) "
                "through trajectory and adjusted mounting. Pixels count from the image's top left corner, distortion removed.",
            )
        ),
        *table_b2(rows, language),
        *per_target_table(errors, language, p_m=value_figure(results, _ID) if errors else None, images=_images(rows)),
        *_transform(results, evaluation.mounting, language),
        *_mounting(results, evaluation.mounting, language),
        *_beside(results, language),
    ]


def target_rows(evaluation: Evaluation, data: CampaignData, solution: MountingSolution) -> list[TargetRow]:
    """Vertex in the world, its pixel and the mark's, for every residual of (24)."""
    if data.camera is None:
        return []
    lens = certified_lens(data.camera)[0]
    places = _vertices_world(evaluation, data, solution)
    strips = {(m.sortie, m.image): m.strip for m in evaluation.marks}

    def row(r: Residual) -> TargetRow:
        strip = strips.get((r.sortie, r.image), 0)
        place = places.get((r.sortie, strip, r.target), places.get((r.sortie, 0, r.target)))
        lidar, camera = undistorted_px(lens, np.stack([r.projected_px, r.observed_px]))
        return TargetRow(
            target=r.target,
            image=r.image,
            world_m=None if place is None else [float(v) for v in place],
            lidar_px=[float(v) for v in lidar],
            camera_px=[float(v) for v in camera],
            error_px=r.error_px,
        )

    return [row(r) for r in sorted(evaluation.residuals, key=lambda r: (r.target, r.sortie, r.image))]


def _vertices_world(
    evaluation: Evaluation, data: CampaignData, solution: MountingSolution
) -> dict[tuple[int, int, str], np.ndarray]:
    """(sortie, strip, target) -> the mark's place by the LiDAR alone; strip 0: plain mean over the sortie's strips."""
    frame = WorldFrame(data.manifest)
    trajectories = {s.folder.number: s.trajectory for s in data.sorties}
    marks = surveyed_marks(data)
    found: dict[tuple[int, int, str], np.ndarray] = {}
    grouped: dict[tuple[int, str], list[np.ndarray]] = {}
    for v in evaluation.vertices:
        trajectory = trajectories.get(v.sortie)
        if trajectory is None or v.target not in marks:
            continue
        time = np.array([v.gps_time_s - solution.lidar_clock_s])
        if not trajectory.gps_time_s[0] <= time[0] <= trajectory.gps_time_s[-1]:
            continue
        point = world_points(v.point_lidar_m[None], time, trajectory, solution.body_from_lidar, frame)[0]
        point = point - marks[v.target].vertex_from_mark_m
        found[v.sortie, v.strip, v.target] = point
        grouped.setdefault((v.sortie, v.target), []).append(point)
    return found | {(sortie, 0, target): np.mean(p, axis=0) for (sortie, target), p in grouped.items()}


def _images(rows: Sequence[TargetRow]) -> dict[str, int]:
    return {t: sum(r.target == t for r in rows) for t in {r.target for r in rows}}


def table_b2(rows: Sequence[TargetRow], language: Language) -> list[Block]:
    """The table of B.2: one row a target and image.

    References
    ----------
    GB/T 41450-2022, figure B.2.
    """
    several = len({r.target for r in rows}) < len(rows)

    def pair(values: Sequence[float], decimals: int) -> str:
        return "(" + ", ".join(f"{v:.{decimals}f}" for v in values).replace("-", "−") + ")"

    cells: list[list[Cell]] = [
        [
            r.target,
            *([r.image] if several else []),
            "–" if r.world_m is None else pair(r.world_m, 3),
            pair(r.lidar_px, 3),
            pair(r.camera_px, 3),
            Figure(value=r.error_px, decimals=3),
        ]
        for r in rows
    ]
    shown, more = cut(cells, language, "results.json")
    head = say(
        language,
        "靶标点号|影像|激光雷达点世界坐标 m|激光雷达点像素坐标|光学遥感传感器同名点像素坐标|标定误差 px",
        "Target|Image|LiDAR's point, world m|LiDAR's point, px|Camera's point, px|Error px",
    ).split("|")
    if not several:
        head.pop(1)
    return [
        Table(
            caption=say(language, "表 B.2　多传感器几何一致性计算", "Table B.2  Geometric consistency"),
            head=head,
            rows=shown,
            widths=(0.8, 1.5, 2.1, 1.8, 1.9, 1.0) if several else (0.8, 2.2, 1.9, 2.0, 1.0),
            align="clccr"[: 1 + several] + "cccr" if several else "ccccr",
            small=True,
            merge=several,
        ),
        *more,
    ]


def per_target_table(
    errors: Sequence[tuple[str, Figure]], language: Language, *, p_m: Figure | None, images: Mapping[str, int]
) -> list[Block]:
    """P_i of every target with their sum, and (20) worked out below.

    Parameters
    ----------
    errors : sequence of (target, Figure)
    language : "zh" | "en"
    p_m : Figure, optional
        The graded figure; without it the mean of the table's.
    images : mapping
        Target -> images behind its P_i.

    References
    ----------
    GB/T 41450-2022, 9.3.1, formula (20).
    """
    if not errors:
        return []
    total = float(sum(e.value or 0.0 for _, e in errors))
    n = len(errors)
    if p_m is None:
        p_m = Figure(value=total / n, decimals=3, unit="px")
    rows: list[list[Cell]] = [[t, Figure(value=images.get(t, 0), decimals=0), e] for t, e in errors]
    rows.append(
        ["Σ", Figure(value=sum(images.get(t, 0) for t, _ in errors), decimals=0), Figure(value=total, decimals=4)]
    )
    head = say(language, "靶标|影像数|Pᵢ px", "Target|Images|Pᵢ px").split("|")
    third = -(-len(rows) // 3)
    blank: list[Cell] = [""] * 3
    cells = [
        [c for k in range(3) for c in (rows[k * third + i] if k * third + i < len(rows) else blank)]
        for i in range(third)
    ]
    return [
        Table(
            caption=say(
                language,
                "表 8　各靶标的标定误差（各影像的平均值）",
                "Table 8  Error of every target (mean over its images)",
            ),
            head=head * 3,
            rows=cells,
            align="lrr" * 3,
            small=True,
        ),
        Formula(text=f"P_m = ΣPᵢ / n = {total:.4f} / {n} = {p_m.text}", number="(20)"),
    ]


def _matrix(rotation: np.ndarray) -> list[str]:
    """Rows of a rotation matrix as printed in (21)."""
    return ["[ " + "  ".join(f"{v:+.8f}" for v in row).replace("-", "−") + " ]" for row in rotation]


def _transform(results: Mapping[str, Any], solution: MountingSolution, language: Language) -> list[Block]:
    """(21)-(24): rotation and translation from LiDAR to camera."""
    at = "mounting.camera_from_lidar"
    names = ("roll", "pitch", "yaw", "X", "Y", "Z")
    units = ["°"] * 3 + ["m"] * 3
    rows: list[list[Cell]] = [
        [name, figure(results, f"{at}.estimates.{k}", 5), figure(results, f"{at}.std.{k}", 5), unit]
        for k, (name, unit) in enumerate(zip(names, units, strict=True))
    ]
    return [
        Heading(text=say(language, "3.1　激光雷达到光学遥感传感器的转换关系", "3.1  From LiDAR to camera"), level=2),
        *(
            Formula(text=("R_LC = " if k == 1 else "　　　") + line, number="(21)" if k == 1 else "")
            for k, line in enumerate(_matrix(solution.camera_from_lidar_rotation))
        ),
        Formula(text="x = f X/Z,   y = f Y/Z,   [X Y Z]ᵀ = R_LC [X_L Y_L Z_L]ᵀ + t", number="(22)"),
        Formula(text="V = C₁ΔdX + C₂ΔdY + C₃ΔdZ + C₄Δα + C₅Δβ + C₆Δγ + L", number="(23)"),
        Formula(text="s [u v 1]ᵀ = K (R_LC [X Y Z]ᵀ + t)", number="(24)"),
        Table(
            caption=say(
                language,
                "表 9　转换参数（角：相对名义安置；平移 t 在相机坐标系中）",
                "Table 9  Parameters of the transform (angles against nominal; translation t in camera axes)",
            ),
            head=say(language, "参数|估计值|标准差|单位", "Parameter|Estimate|Std. dev.|Unit").split("|"),
            rows=rows,
            align="lrrc",
            small=True,
        ),
        Paragraph(
            text=say(
                language,
                "飞行中扫描仪与相机在不同时刻观测同一靶标，故以 p_C = R_CB R_BW(t_e) R_WB(t_s) R_BL p_L 表示（22），"
                "两个传感器的安置参数联合平差，控制测量的靶标位置作为带权观测值；上表为两者的乘积。像平面坐标采用影像轴，不用 −f。",
                "In flight scanner and camera see a target at different times: (22) is taken as p_C = R_CB R_BW(t_e) R_WB(t_s) "
                "R_BL p_L. Both mountings are adjusted together with the surveyed places as weighted observations; the table holds "
                "their product. Image axes are used, without −f.",
            ),
            note=True,
        ),
    ]


def _name(name: str, language: Language) -> str:
    stem, _, last = name.rpartition("_")
    if name in _WORDS:
        return say(language, *_WORDS[name])
    return f"{say(language, *_WORDS.get(stem, (stem, stem)))} {last}"


def _mounting(results: Mapping[str, Any], solution: MountingSolution, language: Language) -> list[Block]:
    decimals = {"deg": 5, "m": 5, "s": 7}
    units = results["mounting"]["units"]
    rows: list[list[Cell]] = [
        [
            _name(name, language),
            figure(results, f"mounting.estimates.{k}", decimals[units[k]]),
            figure(results, f"mounting.std.{k}", decimals[units[k]]),
            figure(results, f"mounting.prior_std.{k}", decimals[units[k]])
            if results["mounting"]["prior_std"] is not None
            else "–",
            {"deg": "°"}.get(units[k], units[k]),
        ]
        for k, name in enumerate(solution.names)
    ]
    blocks: list[Block] = [
        Table(
            caption=say(language, "表 10　安置参数（相对名义值）", "Table 10  Mounting parameters against nominal"),
            head=say(language, "参数|估计值|标准差|先验标准差|单位", "Parameter|Estimate|Std. dev.|Prior|Unit").split(
                "|"
            ),
            rows=rows,
            widths=(2.2, 1.2, 1.2, 1.2, 0.7),
            align="lrrrc",
            small=True,
        ),
        Table(
            rows=[
                (
                    "σ₀",
                    figure(results, "mounting.sigma0", 4),
                    say(language, "多余观测", "Redundancy"),
                    figure(results, "mounting.redundancy", 0),
                    say(language, "迭代次数", "Iterations"),
                    figure(results, "mounting.iterations", 0),
                )
            ],
            fields=True,
        ),
    ]
    weak = results["mounting"].get("not_determined") or []
    if weak:
        listed = say(language, "、", ", ").join(_name(str(w["name"]), language) for w in weak)
        text = say(language, f"未能确定的参数：{listed}。", f"Not determined: {listed}.")
        blocks.append(Paragraph(text=text, note=True))
    if solution.rejected:
        listed = say(language, "；", "; ").join(blunder(line, language) for line in solution.rejected)
        text = say(language, f"作为粗差剔除的观测值：{listed}。", f"Left out as blunders: {listed}.")
        blocks.append(Paragraph(text=text, note=True))
    return blocks


def _beside(results: Mapping[str, Any], language: Language) -> list[Block]:
    found = companions(results, _ID)
    rows: list[tuple[Cell, ...]] = [(say(language, "平均标定误差 P_m", "P_m"), value_figure(results, _ID))]
    for sortie in sorted(found.get("per_sortie_px") or {}, key=int):
        label = say(language, f"第 {sortie} 架次的 P_m", f"P_m of sortie {sortie}")
        rows.append((label, figure(results, f"{_AT}.per_sortie_px.{sortie}", 4, "px")))
    rows += [
        (
            say(language, "未参与求解的靶标的 P_m（交叉验证，不参与评价）", "P_m of held-out targets (not graded)"),
            figure(results, f"{_AT}.held_out_px", 4, "px"),
        ),
        (
            say(
                language, "单一刚体变换的 P_m（9.3.2 f～i 原文，不参与评价）", "P_m of one rigid transform (not graded)"
            ),
            figure(results, f"{_AT}.single_instant.p_m_px", 4, "px"),
        ),
    ]
    if results["indicators"][_ID]["value"] is None:
        rows = rows[1:]
    return [Table(rows=rows, fields=True, widths=(3.4, 1.6))]
