"""Calculation handbook B.2, second part: M_z of the camera (9.2): interior orientation, distortion, poses, error of every image."""

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from evaluator.benches.bench_model import ChessboardResult
from evaluator.documents.handbooks_common import companions, cut, figure, missing, value_figure
from evaluator.documents.model import Block, Cell, Figure, Formula, Heading, Language, Paragraph, Table, say
from evaluator.results import Evaluation

_ID = "camera_reprojection_error"
_AT = f"indicators.{_ID}.companions"
_SYMBOLS = {"fx_px": "fx", "fy_px": "fy", "cx_px": "cx", "cy_px": "cy"}


def camera_geometry_blocks(evaluation: Evaluation, results: Mapping[str, Any], language: Language) -> list[Block]:
    """Section 2 of B.2.

    References
    ----------
    GB/T 41450-2022, 9.2.
    """
    blocks: list[Block] = [
        Heading(text=say(language, "2　光学遥感传感器几何性能（9.2）", "2  Geometric performance of the camera (9.2)")),
        *missing(results, _ID, language),
    ]
    found = companions(results, _ID)
    if not found.get("parameters"):
        return blocks
    blocks += [
        Formula(text="sᵢ [uᵢ vᵢ 1]ᵀ = K [R|t] [Xᵢ Yᵢ Zᵢ 1]ᵀ", number="(16)"),
        Formula(text="sᵢ wᵢ = K [R|t] Pᵢ", number="(17)"),
        *_interior(results, language),
    ]
    if found.get("per_image"):
        blocks += _images(evaluation.chessboard, results, language)
    if evaluation.chessboard is not None and evaluation.chessboard.not_used:
        listed = "; ".join(f"{name}: {why}" for name, why in sorted(evaluation.chessboard.not_used.items())[:10])
        text = say(language, f"未采用的影像：{listed}。", f"Images that were not used: {listed}.")
        blocks.append(Paragraph(text=text, note=True))
    return blocks


def _interior(results: Mapping[str, Any], language: Language) -> list[Block]:
    found = companions(results, _ID)
    rows: list[list[Cell]] = []
    for k, name in enumerate(found["parameters"]):
        pixels = str(name).endswith("_px")
        decimals = 4 if pixels else 8
        rows.append(
            [
                _SYMBOLS.get(name, name),
                figure(results, f"{_AT}.estimates.{k}", decimals),
                figure(results, f"{_AT}.std.{k}", decimals if pixels else 9),
                "px" if pixels else "1",
            ]
        )
    return [
        Table(
            caption=say(
                language,
                "表 6　内方位元素与畸变参数（9.2.2 e、f）",
                "Table 6  Interior orientation and distortion (9.2.2 e, f)",
            ),
            head=say(language, "参数|估计值|标准差|单位", "Parameter|Estimate|Std. dev.|Unit").split("|"),
            rows=rows,
            align="lrrc",
            small=True,
        ),
        Paragraph(
            text=say(
                language,
                "像素坐标以影像左上角为原点。畸变：k1、k2、k3 径向，p1、p2 切向；先从观测值中改正畸变，再按（19）计算误差。",
                "Pixels count from the image's top left corner. k1, k2, k3: radial, p1, p2: tangential distortion. It is removed "
                "from the observations before (19).",
            ),
            note=True,
        ),
    ]


def _images(chessboard: ChessboardResult | None, results: Mapping[str, Any], language: Language) -> list[Block]:
    """Every accepted image: pose (18), corners, mean error; the sum over all corners gives (19)."""
    images = companions(results, _ID)["per_image"]
    poses = {i.image: i for i in chessboard.images} if chessboard else {}
    rows: list[list[Cell]] = []
    corners, total = 0, 0.0
    for k, image in enumerate(images):
        corners += image["corners"]
        total += image["corners"] * image["mean_px"]
        pose = poses.get(image["image"])
        vector: list[Cell] = ["–"] * 6
        if pose is not None:
            turn = cv2.Rodrigues(np.asarray(pose.camera_from_board_rotation, dtype=np.float64))[0].ravel()
            vector = [Figure(value=float(v), decimals=5) for v in turn]
            vector += [Figure(value=float(v), decimals=4) for v in pose.camera_from_board_translation_m]
        rows.append(
            [
                image["image"],
                *vector,
                figure(results, f"{_AT}.per_image.{k}.distance_m", 3),
                figure(results, f"{_AT}.per_image.{k}.corners", 0),
                figure(results, f"{_AT}.per_image.{k}.mean_px", 6),
                Figure(value=image["corners"] * image["mean_px"], decimals=5),
            ]
        )
    rows.append(["Σ", *["–"] * 7, Figure(value=corners, decimals=0), "–", Figure(value=total, decimals=5)])
    shown, more = cut(rows, language, "results.json")
    value = value_figure(results, _ID)
    return [
        Formula(text="ξ* = arg min ½ Σ‖ wᵢ − (1/sᵢ) K [R|t] Pᵢ ‖²", number="(18)"),
        Table(
            caption=say(
                language,
                "表 7　各影像的外方位元素与重投影误差（r：旋转矢量 rad；t：m）",
                "Table 7  Exterior orientation and error of each image (r: rotation vector in rad; t in m)",
            ),
            head=say(
                language,
                "影像|rx|ry|rz|tx|ty|tz|距离 m|角点|平均 px|合计 px",
                "Image|rx|ry|rz|tx|ty|tz|Dist. m|n|Mean px|Sum px",
            ).split("|"),
            rows=shown,
            widths=(1.15, 1.0, 1.0, 1.0, 0.95, 0.95, 0.95, 0.85, 0.7, 1.05, 1.05),
            align="l" + "r" * 10,
            small=True,
        ),
        *more,
        Formula(
            text=f"M_z = Σ‖ wᵢ − (1/sᵢ) K [R|t] Pᵢ ‖ / n = {total:.5f} / {corners} = {value.text}",
            number="(19)",
        ),
        Table(
            rows=[
                (say(language, "平均重投影误差 M_z", "M_z"), value),
                (
                    say(language, "交叉验证的 M_z（不参与评价）", "M_z on held-out images (not graded)"),
                    figure(results, f"{_AT}.held_out_px", 6, "px"),
                ),
                (say(language, "均方根", "Root mean square"), figure(results, f"{_AT}.rms_px", 6, "px")),
                (say(language, "最大值", "Greatest"), figure(results, f"{_AT}.max_px", 6, "px")),
            ],
            fields=True,
            widths=(3.0, 2.0),
        ),
    ]
