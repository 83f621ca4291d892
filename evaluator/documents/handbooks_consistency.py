"""Calculation handbook B.1, second part: r_f and M_f (8.3): the empirical line of the images, the table of B.1, (7) and (8).

Figures come from results.json; `table_b1` takes any two lists, the standard's own example too.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evaluator.documents.handbooks_common import companions, cut, figure, missing, side_by_side, value_figure
from evaluator.documents.model import Block, Cell, Figure, Formula, Heading, Language, Paragraph, Table, say

_LIDAR = "indicators.lidar_reflectance_rmse.companions"
_CAMERA = "indicators.reflectance_correlation.companions"
_DECIMALS = 5  # of a reflectance as a fraction; squares have twice as many


def consistency_blocks(results: Mapping[str, Any], language: Language) -> list[Block]:
    blocks: list[Block] = [
        Heading(text=say(language, "3　多传感器辐射一致性（8.3）", "3  Radiometric consistency of both sensors (8.3)")),
        *missing(results, "reflectance_correlation", language),
        *missing(results, "reflectance_rmse_relative", language),
    ]
    lidar = companions(results, "lidar_reflectance_rmse").get("panels") or []
    camera = companions(results, "reflectance_correlation").get("panels") or []
    place = {p["panel"]: i for i, p in enumerate(camera)}
    pairs = [(i, place[p["panel"]], p["panel"]) for i, p in enumerate(lidar) if p["panel"] in place]
    if len(pairs) < 2:
        return blocks
    r1 = [figure(results, f"{_LIDAR}.panels.{i}.measured_percent", _DECIMALS, scale=0.01) for i, _, _ in pairs]
    r2 = [figure(results, f"{_CAMERA}.panels.{j}.measured_percent", _DECIMALS, scale=0.01) for _, j, _ in pairs]
    measured = results["indicators"]["reflectance_correlation"]["value"] is not None
    return [
        *blocks,
        *_empirical_line(results, language),
        *table_b1(
            [name for _, _, name in pairs],
            r1,
            r2,
            language,
            r_f=value_figure(results, "reflectance_correlation") if measured else None,
            m_f=value_figure(results, "reflectance_rmse_relative") if measured else None,
        ),
    ]


def _empirical_line(results: Mapping[str, Any], language: Language) -> list[Block]:
    """8.3.2 g: gain of every image, the offset, and DN and reflectance of every panel in every image."""
    found = companions(results, "reflectance_correlation")
    line = found.get("empirical_line")
    if not isinstance(line, Mapping):
        return []
    at = f"{_CAMERA}.empirical_line"
    gains: list[list[Cell]] = [
        [str(g["sortie"]), g["image"], figure(results, f"{at}.gains.{k}.gain_percent_per_dn", 9)]
        for k, g in enumerate(line["gains"])
    ]
    order = sorted(range(len(line["values"])), key=lambda k: (line["values"][k]["image"], line["values"][k]["panel"]))
    values: list[list[Cell]] = [
        [
            line["values"][k]["image"],
            line["values"][k]["panel"],
            figure(results, f"{at}.values.{k}.dn", 2),
            figure(results, f"{at}.values.{k}.reflectance_percent", 3),
        ]
        for k in order
    ]
    shown, more = cut(values, language, "results.json")
    head = say(language, "影像|靶标|DN|R₂ %", "Image|Panel|DN|R₂ %").split("|")
    offset = figure(results, f"{at}.offset_percent", 6, "%")
    return [
        Paragraph(
            text=say(
                language,
                f"影像的相对辐射校正采用经验线性法（8.3.2 g），波段 {found.get('band')}：每张影像一个增益 g，"
                "全部影像共用一个偏置 b，由靶标的 DN（减去黑电平）与波段反射率按最小二乘求得；每个靶标的 R₂ 为各影像的平均值。",
                f"The images are corrected by the empirical line (8.3.2 g), band {found.get('band')}: a gain g for each image "
                "and one offset b, by least squares from the panels' DN (black level subtracted) and their reflectance over the "
                "band. R₂ of a panel is the mean over its images.",
            )
        ),
        Formula(text=f"R₂ = g · DN + b,   b = {offset.text}"),
        Table(
            caption=say(language, "表 6　经验线性法的增益", "Table 6  Gains of the empirical line"),
            head=say(language, "架次|影像|增益 g %/DN", "Sortie|Image|Gain g %/DN").split("|"),
            rows=gains,
            widths=(0.8, 2.0, 1.6),
            align="clr",
            small=True,
        ),
        Table(
            caption=say(
                language, "表 7　各影像中靶标的 DN 与反射率", "Table 7  DN and reflectance of the panels in every image"
            ),
            head=head * 2,
            rows=side_by_side(shown),
            widths=(1.6, 0.8, 1.0, 0.9) * 2,
            align="llrr" * 2,
            small=True,
        ),
        *more,
    ]


def table_b1(
    panels: Sequence[str],
    lidar: Sequence[Figure],
    camera: Sequence[Figure],
    language: Language,
    *,
    r_f: Figure | None = None,
    m_f: Figure | None = None,
) -> list[Block]:
    """The table of B.1 with its sum, and (7) and (8) worked out below it.

    Parameters
    ----------
    panels : sequence of str
    lidar, camera : sequence of Figure
        R_1 and R_2 as fractions; squares are printed with twice their decimals.
    language : "zh" | "en"
    r_f, m_f : Figure, optional
        The graded figures. [%] Without them those of the table are printed.

    References
    ----------
    GB/T 41450-2022, 8.3.1, formulas (7) and (8), figure B.1.
    """
    r1, r2 = (np.array([v.value for v in side], dtype=np.float64) for side in (lidar, camera))
    decimals = 2 * lidar[0].decimals
    squares = (r1 - r2) ** 2
    d1, d2 = r1 - r1.mean(), r2 - r2.mean()
    products, first, second = float(np.sum(d1 * d2)), float(np.sum(d1**2)), float(np.sum(d2**2))
    n, total = len(panels), float(squares.sum())
    if r_f is None:
        r_f = Figure(value=100.0 * products / (first * second) ** 0.5, decimals=2, unit="%")
    if m_f is None:
        m_f = Figure(value=100.0 * (total / (2.0 * (n - 1))) ** 0.5, decimals=2, unit="%")
    rows: list[list[Cell]] = [
        [name, a, b, Figure(value=float(s), decimals=decimals)]
        for name, a, b, s in zip(panels, lidar, camera, squares, strict=True)
    ]
    rows.append(["Σ", "–", "–", Figure(value=total, decimals=decimals)])
    return [
        Table(
            caption=say(language, "表 B.1　多传感器辐射一致性计算", "Table B.1  Radiometric consistency"),
            head=say(
                language,
                "靶标点号|激光雷达测量反射率值|光学遥感传感器测量反射率值|反射率差值平方",
                "Panel|Reflectance by LiDAR|Reflectance by camera|Square of the difference",
            ).split("|"),
            rows=rows,
            align="crrr",
            small=True,
        ),
        Formula(
            text=f"R̄₁ = {r1.mean():.6f},   R̄₂ = {r2.mean():.6f},   Σ(R₁ᵢ − R̄₁)(R₂ᵢ − R̄₂) = {products:.8f}".replace(
                "-", "−"
            )
        ),
        Formula(text=f"Σ(R₁ᵢ − R̄₁)² = {first:.8f},   Σ(R₂ᵢ − R̄₂)² = {second:.8f}"),
        Formula(
            text=f"r_f = Σ(R₁ᵢ − R̄₁)(R₂ᵢ − R̄₂) / √( Σ(R₁ᵢ − R̄₁)² · Σ(R₂ᵢ − R̄₂)² ) = {r_f.text}",
            number="(7)",
        ),
        Formula(
            text=f"M_f = √( Σ(R₁ᵢ − R₂ᵢ)² / (2(n − 1)) ) = √( {total:.{decimals}f} / (2 × {n - 1}) ) = {m_f.text}",
            number="(8)",
        ),
        Table(
            rows=[
                (say(language, "反射率相关性 r_f", "Correlation r_f"), r_f),
                (say(language, "反射率相对中误差 M_f", "Relative RMSE M_f"), m_f),
            ],
            fields=True,
            widths=(3.0, 2.0),
        ),
        Paragraph(
            text=say(
                language, "多传感器辐射一致性按照表 3 进行评价。", "The radiometric consistency is graded by table 3."
            ),
            note=True,
        ),
    ]
