"""Calculation handbook B.2, first part: m_z of the LiDAR (9.1), from the total station's readings to (9)-(15)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from campaign.benches.ranging import RangingLine, StationReading, TotalStation
from evaluator.benches.total_station import (
    HUMIDITY_PERCENT,
    corrected_slope_distance,
    group_refractive_index,
    meteorological_correction,
)
from evaluator.documents.handbooks_common import companions, cut, figure, missing, value_figure
from evaluator.documents.model import Block, Cell, Figure, Formula, Heading, Language, Paragraph, Table, say
from evaluator.model import EvaluationError
from evaluator.results import Evaluation

_ID = "lidar_ranging_rmse_relative"
_AT = f"indicators.{_ID}.companions"


def ranging_blocks(evaluation: Evaluation, results: Mapping[str, Any], language: Language) -> list[Block]:
    """Section 1 of B.2.

    References
    ----------
    GB/T 41450-2022, 9.1.
    """
    ranging = evaluation.data.ranging if evaluation.data else None
    blocks: list[Block] = [
        Heading(text=say(language, "1　激光雷达几何性能（9.1）", "1  Geometric performance of the LiDAR (9.1)")),
        *missing(results, _ID, language),
    ]
    if ranging is not None and ranging.line is not None:
        blocks += _stations(ranging.line, language)
        blocks += _readings(ranging.line, ranging.readings, language)
    found = companions(results, _ID)
    panels = found.get("panels") or []
    if panels:
        blocks += _panels(results, panels, language)
    if results["indicators"][_ID]["value"] is not None:
        blocks += _constants(results, panels, language)
    return blocks


def _stations(line: RangingLine, language: Language) -> list[Block]:
    uses = {
        "correction": say(language, "求 K₂、R₂", "K₂, R₂"),
        "reference": say(language, "相对真值", "relative true values"),
    }
    rows: list[list[Cell]] = [
        [
            f"{s.name} {s.model}".strip(),
            Figure(value=s.class_mm, decimals=1),
            Figure(value=1e3 * s.additive_constant_m, decimals=2),
            Figure(value=1e6 * s.scale, decimals=2),
            Figure(value=s.reference_index, decimals=8),
            Figure(value=s.wavelength_um, decimals=3),
            say(language, "、", ", ").join(uses.get(u, u) for u in s.serves),
        ]
        for s in line.stations
    ]
    e = ", ".join(f"{v:.4f}" for v in line.eccentricity_m).replace("-", "−")
    return [
        Table(
            caption=say(
                language, "表 1　全站仪及其检定参数（9.1.2 c、d、k）", "Table 1  Total stations and their certificates"
            ),
            head=say(
                language,
                "全站仪|等级 mm|K₁ mm|R₁ ppm|n₀|λ µm|用途",
                "Station|Class mm|K₁ mm|R₁ ppm|n₀|λ µm|Serves",
            ).split("|"),
            rows=rows,
            widths=(1.6, 0.8, 0.8, 0.8, 1.2, 0.8, 1.8),
            align="lrrrrrl",
            small=True,
        ),
        Paragraph(
            text=say(
                language,
                f"归心元素（激光雷达中心减全站仪中心）：({e}) m，每轴标准差 {line.eccentricity_std_m:g} m。",
                f"Eccentricity (centre of the LiDAR minus that of the stations): ({e}) m, {line.eccentricity_std_m:g} m an axis.",
            ),
            note=True,
        ),
    ]


def _readings(line: RangingLine, readings: Sequence[StationReading], language: Language) -> list[Block]:
    """(12) for every reading; a reading that lacks a value has dashes from there on."""
    stations = {s.name: s for s in line.stations}
    rows: list[list[Cell]] = []
    for r in sorted(readings, key=lambda r: (r.station, r.panel, r.observation)):
        index, correction, distance = _corrected(stations.get(r.station), r)
        rows.append(
            [
                r.station,
                r.panel,
                str(r.observation),
                Figure(value=r.slope_distance_m, decimals=4),
                Figure(value=r.temperature_c, decimals=1),
                Figure(value=r.pressure_hpa, decimals=1),
                Figure(value=r.relative_humidity_percent, decimals=0),
                Figure(value=index, decimals=8),
                Figure(value=None if correction is None else 1e3 * correction, decimals=3),
                Figure(value=distance, decimals=5),
            ]
        )
    if not rows:
        return []
    shown, more = cut(rows, language, "ranging/total_station.csv")
    return [
        Table(
            caption=say(
                language, "表 2　全站仪观测值及其改正", "Table 2  Readings of the total stations and their corrections"
            ),
            head=say(
                language,
                "全站仪|靶标|次|S m|t ℃|p hPa|RH %|n_g|ΔD mm|D m",
                "Station|Panel|No.|S m|t ℃|p hPa|RH %|n_g|ΔD mm|D m",
            ).split("|"),
            rows=shown,
            widths=(1.1, 0.7, 0.4, 1.1, 0.6, 0.8, 0.6, 1.2, 0.8, 1.2),
            align="llcrrrrrrr",
            small=True,
        ),
        *more,
        Formula(text="ΔD = S (n₀ − n_g) / n_g,   D = S + K₁ + R₁S + ΔD", number="(12)"),
        Paragraph(
            text=say(
                language,
                "n_g 按 IUGG 1999 群折射率公式计算，无量纲。D 再由观测角和归心元素化算到激光雷达中心，取各次的平均值。",
                "n_g by the IUGG 1999 group index, dimensionless. D is then reduced to the LiDAR's centre by the angles and the "
                "eccentricity, and averaged over the observations.",
            ),
            note=True,
        ),
    ]


def _corrected(
    station: TotalStation | None, reading: StationReading
) -> tuple[float | None, float | None, float | None]:
    """(n_g, ΔD, D) of one reading; None where something is missing or out of range."""
    s, t, p = reading.slope_distance_m, reading.temperature_c, reading.pressure_hpa
    if station is None or s is None or t is None or p is None:
        return None, None, None
    humidity = HUMIDITY_PERCENT if reading.relative_humidity_percent is None else reading.relative_humidity_percent
    try:
        index = group_refractive_index(station.wavelength_um, t, p, min(humidity, 100.0))
        correction = meteorological_correction(s, station.reference_index, index)
    except EvaluationError:
        return None, None, None
    return index, correction, corrected_slope_distance(s, station.additive_constant_m, station.scale, correction)


def _panels(results: Mapping[str, Any], panels: Sequence[Mapping[str, Any]], language: Language) -> list[Block]:
    at = f"{_AT}.panels"
    rows: list[list[Cell]] = [
        [
            str(p["panel"]),
            figure(results, f"{at}.{i}.scans", 0),
            figure(results, f"{at}.{i}.points", 0),
            figure(results, f"{at}.{i}.lidar_m", 5),
            figure(results, f"{at}.{i}.lidar_std_m", 2, scale=1e3),
            figure(results, f"{at}.{i}.correction_m", 5),
            figure(results, f"{at}.{i}.correction_readings", 0),
            figure(results, f"{at}.{i}.reference_m", 5),
            figure(results, f"{at}.{i}.reference_readings", 0),
        ]
        for i, p in enumerate(panels)
    ]
    return [
        Table(
            caption=say(
                language,
                "表 3　激光雷达与全站仪所测距离的平均值（自激光雷达中心起）",
                "Table 3  Mean ranges by LiDAR and total stations (from the LiDAR's centre)",
            ),
            head=say(
                language,
                "靶标|扫描|点数|激光雷达 L m|单次 σ mm|全站仪 L̃ m|次|相对真值 L̂ m|次",
                "Panel|Scans|Points|LiDAR L m|σ of one mm|Station L̃ m|n|True value L̂ m|n",
            ).split("|"),
            rows=rows,
            widths=(0.7, 0.6, 0.9, 1.4, 0.9, 1.4, 0.4, 1.4, 0.4),
            align="lrrrrrrrr",
            small=True,
        )
    ]


def _constants(results: Mapping[str, Any], panels: Sequence[Mapping[str, Any]], language: Language) -> list[Block]:
    """(13)-(15), then (9)-(11)."""
    k2, r2 = (companions(results, _ID)[n] for n in ("additive_constant_m", "multiplication_constant"))
    residuals: list[list[Cell]] = []
    errors: list[list[Cell]] = []
    squares, truths = 0.0, []
    for i, p in enumerate(panels):
        measured, first, truth, corrected = (p[n] for n in ("lidar_m", "correction_m", "reference_m", "corrected_m"))
        if first is not None:
            v = 1e3 * (-k2 - r2 * measured + (first - measured))
            residuals.append(
                [
                    str(p["panel"]),
                    figure(results, f"{_AT}.panels.{i}.correction_m", 5),
                    figure(results, f"{_AT}.panels.{i}.lidar_m", 5),
                    Figure(value=1e3 * (first - measured), decimals=3),
                    Figure(value=v, decimals=3),
                ]
            )
        if first is None or truth is None or corrected is None:
            continue
        error = 1e3 * (corrected - truth)
        squares += error**2
        truths.append(truth)
        errors.append(
            [
                str(p["panel"]),
                figure(results, f"{_AT}.panels.{i}.lidar_m", 5),
                figure(results, f"{_AT}.panels.{i}.corrected_m", 5),
                figure(results, f"{_AT}.panels.{i}.reference_m", 5),
                Figure(value=error, decimals=4),
                Figure(value=error**2, decimals=6),
            ]
        )
    n = len(truths)
    mean = Figure(value=float(np.mean(truths)), decimals=5) if truths else Figure(value=None)
    errors.append(
        ["Σ", "–", "–", Figure(value=float(np.sum(truths)), decimals=5), "–", Figure(value=squares, decimals=6)]
    )
    rmse = figure(results, f"{_AT}.rmse_m", 6, "m")
    average = figure(results, f"{_AT}.mean_range_m", 4, "m")
    value = value_figure(results, _ID)
    plus = figure(results, f"{_AT}.multiplication_constant", 4, "ppm", scale=1e6)
    return [
        Formula(text="L̃ᵢ = (Lᵢ + vᵢ) + K₂ + R₂Lᵢ", number="(13)"),
        Formula(text="vᵢ = −K₂ − R₂Lᵢ + (L̃ᵢ − Lᵢ)", number="(14)"),
        Table(
            rows=[
                (
                    say(language, "加常数 K₂", "Additive constant K₂"),
                    figure(results, f"{_AT}.additive_constant_m", 4, "mm", scale=1e3),
                    "σ",
                    figure(results, f"{_AT}.additive_constant_std_m", 4, "mm", scale=1e3),
                ),
                (
                    say(language, "乘常数 R₂", "Multiplication constant R₂"),
                    plus,
                    "σ",
                    figure(results, f"{_AT}.multiplication_constant_std", 4, "ppm", scale=1e6),
                ),
                (
                    say(language, "等权解 K₂（比较）", "K₂ with equal weights"),
                    figure(results, f"{_AT}.unweighted_constants.0", 4, "mm", scale=1e3),
                    say(language, "等权解 R₂", "R₂ with equal weights"),
                    figure(results, f"{_AT}.unweighted_constants.1", 4, "ppm", scale=1e6),
                ),
            ],
            fields=True,
            widths=(2.0, 1.6, 1.6, 1.6),
        ),
        Table(
            caption=say(language, "表 4　测距误差方程的残差", "Table 4  Residuals of the observation equations"),
            head=say(language, "靶标|L̃ m|L m|L̃ − L mm|v mm", "Panel|L̃ m|L m|L̃ − L mm|v mm").split("|"),
            rows=residuals,
            align="lrrrr",
            small=True,
        ),
        Formula(text="L_Q = L + K₂ + R₂L", number="(15)"),
        Table(
            caption=say(language, "表 5　改正后的距离与相对真值", "Table 5  Corrected ranges and relative true values"),
            head=say(
                language,
                "靶标|L m|L_Q m|L̂ m|L_Q − L̂ mm|(L_Q − L̂)² mm²",
                "Panel|L m|L_Q m|L̂ m|L_Q − L̂ mm|(L_Q − L̂)² mm²",
            ).split("|"),
            rows=errors,
            align="lrrrrr",
            small=True,
        ),
        Formula(text=f"m_j = √( Σ(L_Q − L̂)² / n ) = √( {squares:.6f} / {n} ) mm = {rmse.text}", number="(9)"),
        Formula(text=f"L̄ = ΣL̂ / n = {mean.text} m", number="(10)"),
        Formula(text=f"m_z = m_j / L̄ = {rmse.text} / {average.text} = {value.text}", number="(11)"),
        Table(
            rows=[
                (say(language, "测距相对中误差 m_z", "m_z"), value),
                (
                    say(language, "改正前的 m_z（不参与评价）", "m_z before the correction (not graded)"),
                    figure(results, f"{_AT}.relative_rmse_before_percent", 6, "%"),
                ),
                (
                    say(language, "逐一剔除靶标后的 m_z（不参与评价）", "m_z leaving each panel out (not graded)"),
                    figure(results, f"{_AT}.leave_one_panel_out_percent", 6, "%"),
                ),
            ],
            fields=True,
            widths=(3.0, 2.0),
        ),
        Paragraph(
            text=say(
                language,
                "K₂、R₂ 按全部观测量的协方差加权求得。K₂ 以米计，R₂ 无量纲（标准文本记为百分数）。",
                "K₂ and R₂ are weighted by the covariance of all that enters. K₂ is in metres and R₂ dimensionless (the text has "
                "percent).",
            ),
            note=True,
        ),
    ]
