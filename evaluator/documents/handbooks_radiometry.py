"""Calculation handbook B.1, first part: the way from observations to m_f (8.1), RSD and s(x) (8.2).

Every table is printed with enough digits to repeat the sums below it. Nothing is measured here: figures come from results.json,
the series at the integrating sphere from the evaluation.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from evaluator.benches.bench_model import SphereSeries
from evaluator.documents.handbooks_common import companions, cut, figure, missing, side_by_side, value_figure
from evaluator.documents.model import Block, Cell, Figure, Formula, Heading, Language, Paragraph, Table, say
from evaluator.results import Evaluation

_LIDAR = "indicators.lidar_reflectance_rmse.companions"


# --- 8.1 -----------------------------------------------------------------------------------------------------------------------


def lidar_reflectance_blocks(results: Mapping[str, Any], language: Language) -> list[Block]:
    found = companions(results, "lidar_reflectance_rmse")
    blocks: list[Block] = [
        Heading(text=say(language, "1　激光雷达辐射性能（8.1）", "1  Radiometric performance of the LiDAR (8.1)")),
        *missing(results, "lidar_reflectance_rmse", language),
    ]
    if not found.get("panels"):
        return blocks
    return [*blocks, *_surfaces(results, found, language), *_panel_residuals(results, found, language)]


def _surfaces(results: Mapping[str, Any], found: Mapping[str, Any], language: Language) -> list[Block]:
    """8.1.2 e-g: the coefficients of each design height, then A, L and f(A, L) of every panel in every strip."""
    tables = found.get("surfaces") or []
    if not tables:
        return []
    at = f"{_LIDAR}.surfaces"
    coefficients: list[list[Cell]] = []
    values: list[list[Cell]] = []
    for k, t in enumerate(tables):
        names = [f"coefficients.{c}" for c in range(6)]
        scaling = ("amplitude_centre", "amplitude_scale", "range_centre_m", "range_scale_m")
        coefficients.append(
            [
                figure(results, f"{at}.{k}.design_height_m", 1),
                *(figure(results, f"{at}.{k}.{name}", 6) for name in names),
                *(figure(results, f"{at}.{k}.{name}", 4) for name in scaling),
            ]
        )
        a = (np.array(t["amplitude_dn"]) - t["amplitude_centre"]) / t["amplitude_scale"]
        l = (np.array(t["range_m"]) - t["range_centre_m"]) / t["range_scale_m"]
        surface = np.stack([a**0, a, l, a * a, a * l, l * l], axis=1) @ np.array(t["coefficients"])
        values += [
            [
                f"{t['sortie'][i]}-{t['strip'][i]}",
                t["panel"][i],
                figure(results, f"{at}.{k}.amplitude_dn.{i}", 2),
                figure(results, f"{at}.{k}.range_m.{i}", 3),
                Figure(value=float(surface[i]), decimals=3),
            ]
            for i in range(len(a))
        ]
    shown, more = cut(values, language, "results.json")
    head = say(language, "架次-航线|靶标|A|L m|f %", "Sortie-strip|Panel|A|L m|f %").split("|")
    return [
        Paragraph(
            text=say(
                language,
                "由波形分解得到每个靶标在每条航线上的振幅 A（线性，DN）和距离 L，取靶标上全部有效回波的平均值。"
                "每个设计航高用二次多项式曲面拟合 A、L 与实际反射率的关系（8.1.2 f），"
                f"实际反射率取波长 {found.get('wavelength_nm', 0):g} nm 处：",
                "Decomposing the waveforms gives amplitude A (linear, DN) and range L of every panel in every strip, as means over "
                "the panel's usable returns. For each design height a polynomial surface of second degree is fitted to A, L and "
                f"the actual reflectance at {found.get('wavelength_nm', 0):g} nm (8.1.2 f):",
            )
        ),
        Formula(text="f(A, L) = c₀ + c₁a + c₂l + c₃a² + c₄al + c₅l²,   a = (A − A₀)/A₁,   l = (L − L₀)/L₁"),
        Table(
            caption=say(
                language, "表 1　经验辐射校正模型的系数（f 以 % 计）", "Table 1  Coefficients of the model (f in %)"
            ),
            head=["H m", "c₀", "c₁", "c₂", "c₃", "c₄", "c₅", "A₀", "A₁", "L₀ m", "L₁ m"],
            rows=coefficients,
            widths=(0.65, 1.15, 1.1, 1.05, 1.05, 1.05, 1.05, 1.2, 1.2, 1.0, 0.9),
            align="r" * 11,
            small=True,
        ),
        Table(
            caption=say(language, "表 2　振幅、距离与模型值", "Table 2  Amplitudes, ranges and the model's values"),
            head=head * 2,
            rows=side_by_side(shown),
            widths=(1.0, 0.8, 1.1, 1.0, 1.0) * 2,
            align="clrrr" * 2,
            small=True,
        ),
        *more,
    ]


def _panel_residuals(results: Mapping[str, Any], found: Mapping[str, Any], language: Language) -> list[Block]:
    """(2): R_i, the actual reflectance, residual and square of every panel, their sum, m_f."""
    panels = found["panels"]
    at = f"{_LIDAR}.panels"
    rows: list[list[Cell]] = []
    total = 0.0
    for i, p in enumerate(panels):
        difference = p["measured_percent"] - p["reference_percent"]
        total += difference**2
        rows.append(
            [
                p["panel"],
                figure(results, f"{at}.{i}.observations", 0),
                figure(results, f"{at}.{i}.reference_percent", 4),
                figure(results, f"{at}.{i}.measured_percent", 4),
                Figure(value=difference, decimals=4),
                Figure(value=difference**2, decimals=6),
            ]
        )
    n = len(panels)
    rows.append(["Σ", "–", "–", "–", "–", Figure(value=total, decimals=6)])
    value = results["indicators"]["lidar_reflectance_rmse"]["value"]
    shown = (
        value_figure(results, "lidar_reflectance_rmse")
        if value is not None
        else Figure(value=(total / n) ** 0.5, unit="%")
    )
    head = say(
        language,
        "靶标|航线数|实际反射率 R̂ᵢ %|激光雷达 Rᵢ %|Rᵢ − R̂ᵢ %|(Rᵢ − R̂ᵢ)²",
        "Panel|Strips|Actual R̂ᵢ %|LiDAR Rᵢ %|Rᵢ − R̂ᵢ %|(Rᵢ − R̂ᵢ)²",
    ).split("|")
    return [
        Table(
            caption=say(
                language,
                "表 3　标准反射靶标的反射率与残差（Rᵢ 为各航线 f 的平均值）",
                "Table 3  Reflectance of the panels and residuals (Rᵢ: mean of f over the strips)",
            ),
            head=head,
            rows=rows,
            align="lrrrrr",
            small=True,
        ),
        Formula(text=f"m_f = √( Σ(Rᵢ − R̂ᵢ)² / n ) = √( {total:.6f} / {n} ) = {shown.text}", number="(2)"),
        Table(
            rows=[
                (say(language, "反射率中误差 m_f", "m_f"), shown),
                (
                    say(language, "逐一剔除靶标后的 m_f（不参与评价）", "m_f leaving each panel out (not graded)"),
                    figure(results, f"{_LIDAR}.leave_one_panel_out", 4, "%"),
                ),
                (
                    say(
                        language,
                        "以 A/cos(入射角) 代替 A 时的 m_f（不参与评价）",
                        "m_f with A/cos(incidence) (not graded)",
                    ),
                    figure(results, f"{_LIDAR}.with_cos_incidence", 4, "%"),
                ),
            ],
            fields=True,
            widths=(3.0, 2.0),
        ),
    ]


# --- 8.2 -----------------------------------------------------------------------------------------------------------------------


def sphere_blocks(evaluation: Evaluation, results: Mapping[str, Any], language: Language) -> list[Block]:
    series = (
        evaluation.sphere.stability_series if evaluation.sphere else None,
        evaluation.sphere.repeatability_series if evaluation.sphere else None,
    )
    return [
        Heading(
            text=say(language, "2　光学遥感传感器辐射性能（8.2）", "2  Radiometric performance of the camera (8.2)")
        ),
        *_series(results, "camera_stability", series[0], "2.1", 4, language),
        *_series(results, "camera_repeatability", series[1], "2.2", 5, language),
    ]


def _series(
    results: Mapping[str, Any], indicator: str, series: SphereSeries | None, number: str, table: int, language: Language
) -> list[Block]:
    """Readings of one series, its mean, standard deviation and relative standard deviation for each band."""
    block = results["indicators"][indicator]
    title = say(language, block["name_zh"], block["name"])
    blocks: list[Block] = [
        Heading(
            text=f"{number}　{title} {block['symbol']}" if language == "zh" else f"{number}  {title} {block['symbol']}",
            level=2,
        ),
        *missing(results, indicator, language),
    ]
    channels = companions(results, indicator).get("channels")
    if series is None or not isinstance(channels, Mapping):
        return blocks
    rows: list[list[Cell]] = [
        [image, Figure(value=float(t), decimals=1), *(Figure(value=float(v), decimals=3) for v in dn)]
        for image, t, dn in zip(series.images, series.time_s, series.dn, strict=True)
    ]
    at = f"indicators.{indicator}.companions.channels"
    known = [b for b in series.bands if b in channels]
    symbol = block["symbol"]
    for label, key, decimals in (
        (say(language, "平均值", "mean"), "mean_dn", 4),
        (say(language, "标准差 SD", "SD"), "sd_dn", 4),
        (f"{symbol} %", "value", 4),
    ):
        rows.append([label, "–", *(figure(results, f"{at}.{b}.{key}", decimals) for b in known)])
    worst = str(companions(results, indicator).get("worst_channel"))
    n = len(series.images)
    mean, sd = (figure(results, f"{at}.{worst}.{key}", 4) for key in ("mean_dn", "sd_dn"))
    value = value_figure(results, indicator)
    stable = indicator == "camera_stability"
    formulas: list[Block] = (
        [
            Formula(text=f"DN̄ = Σ DNᵢ / n = {mean.text}   (n = {n}, {worst})", number="(4)"),
            Formula(text=f"SD = √( Σ(DNᵢ − DN̄)² / (n − 1) ) = {sd.text}", number="(5)"),
            Formula(text=f"RSD = SD / DN̄ = {sd.text} / {mean.text} = {value.text}", number="(3)"),
        ]
        if stable
        else [
            Formula(text=f"√( Σ(xᵢ − x̄)² / (n − 1) ) = {sd.text} DN   (n = {n}, {worst})", number="(6)"),
            Formula(text=f"s(x) = {sd.text} / {mean.text} = {value.text}"),
        ]
    )
    note = say(
        language,
        "DNᵢ 为影像中央九个像素的平均值，已减去黑电平。取各波段中最大者。",
        "DNᵢ: mean of the image's nine central pixels, black level subtracted. The greatest band's figure counts.",
    )
    if not stable:
        note += say(
            language,
            "公式（6）的结果以 DN 计，而限值以百分数计，故除以平均值；DN 值一并列出。",
            " Formula (6) gives DN and its limits are in percent: the figure is taken relative to the mean, the one in DN stands "
            "beside it.",
        )
    if series.left_out:
        listed = "; ".join(series.left_out[:5])
        note += say(
            language,
            f"未采用的影像 {len(series.left_out)} 张：{listed}。",
            f" Left out ({len(series.left_out)}): {listed}.",
        )
    head = [say(language, "影像", "Image"), "t s", *(f"DN {b}" for b in series.bands)]
    caption = say(language, f"表 {table}　{title}的测量值", f"Table {table}  Readings: {title}")
    shown, more = cut(rows, language, "bench/")
    return [
        *blocks,
        Table(caption=caption, head=head, rows=shown, align="lr" + "r" * len(series.bands), small=True),
        *more,
        *formulas,
        Paragraph(text=note, note=True),
    ]
