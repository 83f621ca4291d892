"""Section 5 of the test report: table C.3 with what surrounds it. Every figure is one of results.json."""

from collections.abc import Mapping
from typing import Any

from evaluator.c10_1_grading import GRADE_ZH, GROUPS, INDICATORS, Group, group_grades
from evaluator.documents.model import (
    Block,
    Cell,
    Figure,
    Heading,
    Language,
    Paragraph,
    Table,
    figure,
    printed_unit,
    say,
)
from evaluator.documents.phrases import translated
from evaluator.report.terms import method
from evaluator.results import shown_decimals

_GRADE_EN = {
    "excellent": "excellent",
    "good": "good",
    "fair": "fair",
    "ungraded": "beyond table 3",
    "not_measured": "not measured",
}
# What stands beside an indicator: path below its companions, Chinese, English, unit.
_BESIDE: dict[str, tuple[tuple[str, str, str, str], ...]] = {
    "lidar_reflectance_rmse": (
        ("leave_one_panel_out", "逐靶标留出", "leave one panel out", "%"),
        ("with_cos_incidence", "振幅除以入射角余弦", "amplitude over cosine of incidence", "%"),
    ),
    "camera_stability": (("trend_percent_per_h", "序列趋势（每小时）", "trend of the series, an hour", "%/h"),),
    "camera_repeatability": (("sd_dn", "标准差", "standard deviation", "DN"),),
    "reflectance_correlation": (("leave_one_panel_out", "逐靶标留出", "leave one panel out", "%"),),
    "reflectance_rmse_relative": (("leave_one_panel_out", "逐靶标留出", "leave one panel out", "%"),),
    "lidar_ranging_rmse_relative": (
        ("rmse_m", "测距中误差 m_j", "ranging RMSE m_j", "m"),
        ("leave_one_panel_out_percent", "逐靶标留出", "leave one panel out", "%"),
    ),
    "camera_reprojection_error": (("held_out_px", "留出影像", "held-out images", "px"),),
    "calibration_error": (
        ("held_out_px", "留出靶标", "held-out targets", "px"),
        ("single_instant.p_m_px", "单一瞬时刚体变换", "one rigid transform for one instant", "px"),
    ),
}


def _group_name(group: Group, language: Language) -> str:
    """In Chinese on two lines, as table C.3 prints it."""
    zh = group.name_zh
    for kind in ("辐射一致性", "几何一致性"):
        zh = zh.replace(kind, f"\n{kind}")
    return say(language, zh, group.name_en) + ("*" if group.starred else "")


def indicator_name(indicator_id: str, language: Language) -> str:
    """An indicator's name in the document's language."""
    row = INDICATORS[indicator_id]
    return say(language, row.name_zh, row.name_en)


def _grade(grade: str, language: Language) -> str:
    return say(language, GRADE_ZH.get(grade, grade), _GRADE_EN.get(grade, grade))  # type: ignore[call-overload]


def _decimals(block: Mapping[str, Any]) -> int:
    """As elsewhere; a correlation by what it lacks to 100 %, or 99.995 would read 100."""
    value = block["value"]
    if value is not None and block["symbol"] == "r_f":
        value = 100.0 - value
    return shown_decimals(value, block["unit"])


def _value(results: Mapping[str, Any], indicator_id: str, language: Language) -> Cell:
    block = results["indicators"][indicator_id]
    if block["value"] is None:
        return say(language, "未测", "not measured")
    path = f"indicators.{indicator_id}.value"
    return figure(results, path, _decimals(block), printed_unit(block["unit"]))


def _spread(results: Mapping[str, Any], indicator_id: str, key: str) -> Figure:
    """std with two digits, low_95 and high_95 with the decimals of the indicator itself."""
    block = results["indicators"][indicator_id]
    path = f"indicators.{indicator_id}.uncertainty.{key}"
    decimals = _decimals(block)
    if key == "std":
        decimals = max(decimals, shown_decimals(figure(results, path).value, block["unit"]))
    return figure(results, path, decimals, printed_unit(block["unit"]))


def result_blocks(results: Mapping[str, Any], language: Language) -> list[Block]:
    """Section 5: table C.3, what was not measured, uncertainties, and the figures beside the standard's own."""
    grades = {i: results["indicators"][i]["grade"] for i in INDICATORS}
    groups = group_grades(grades)
    sort = {True: say(language, "辐射一致性", "Radiometric"), False: say(language, "几何一致性", "Geometric")}
    rows: list[tuple[Cell, ...]] = [
        (
            sort["radiometry" in g.id],
            _group_name(g, language),
            indicator_name(i, language),
            _value(results, i, language),
            _spread(results, i, "std"),
            _grade(grades[i], language),
            _grade(groups[g.id], language),
        )
        for g in GROUPS
        for i in g.indicators
    ]
    replaced = "; ".join(f"{slot} = {function}" for slot, function in sorted(results.get("algorithms", {}).items()))
    told = say(
        language,
        "下列步骤使用了替换算法，不是由本评价程序自己的算法完成的：",
        "Replaced algorithms: these steps were not done by the evaluator's own: ",
    )
    foreign: list[Block] = [Paragraph(text=told + replaced)] if replaced else []
    blocks: list[Block] = [
        Heading(text=say(language, "5　检测结果", "5  Results")),
        Heading(text=say(language, "5.1　一致性程度", "5.1  Degrees of consistency"), level=2),
        Paragraph(text=say(language, "多传感器一致性检测结果如表 C.3 所示。", "Table C.3 gives the results.")),
        *foreign,
        Table(
            caption=say(language, "表 C.3　检测结果表", "Table C.3  Results"),
            head=say(
                language,
                "内容|一致性类型|检测项目|检测结果|标准差|单项程度|一致性程度",
                "Content|Consistency|Item|Result|Std. dev.|Of the item|Degree",
            ).split("|"),
            rows=rows,
            widths=_widths(language, (0.9, 1.75, 1.95, 1.6, 1.6, 1.05, 1.3), (1.3, 1.8, 1.7, 1.6, 1.6, 1.15, 1.15)),
            align="cclrrcc",
            merge=True,
            merge_like={6: 1},
        ),
        Paragraph(
            text=say(
                language,
                "注：* 为较低单指标一致性程度所评估的一致性检测结果。程度按未修约的数值评定，等于限值的属较高一级；"
                "组内有指标未测时，该组不评定。",
                "Note: * the degree is the lower one of the group's indicators. The unrounded value is graded; a value on a bound "
                "takes the better degree; a group with an indicator that was not measured has none.",
            ),
            note=True,
        ),
    ]
    return [*blocks, *_not_measured(results, language), *_how_sure(results, language)]


def _widths(language: Language, zh: tuple[float, ...], en: tuple[float, ...]) -> tuple[float, ...]:
    """The widths that suit the words of a language."""
    return zh if language == "zh" else en


def _not_measured(results: Mapping[str, Any], language: Language) -> list[Block]:
    rows = [
        (
            indicator_name(i, language),
            INDICATORS[i].clause,
            translated(results["indicators"][i]["reason"] or "", language),
        )
        for i in INDICATORS
        if results["indicators"][i]["value"] is None
    ]
    if not rows:
        return []
    return [
        Table(
            caption=say(language, "附表 #　未测项目及原因", "Table #  Items not measured, and why"),
            head=say(language, "检测项目|条款|原因", "Item|Clause|Reason").split("|"),
            rows=rows,
            widths=(2.2, 0.7, 5.0),
            align="lcl",
        )
    ]


def _how_sure(results: Mapping[str, Any], language: Language) -> list[Block]:
    """95 % intervals, sample sizes, and the figures that stand beside the standard's own."""
    measured = [i for i in INDICATORS if results["indicators"][i]["value"] is not None]
    if not measured:
        return []
    sure: list[tuple[Cell, ...]] = [
        (
            indicator_name(i, language),
            f"{INDICATORS[i].symbol}  {results['indicators'][i]['formula']}",
            figure(results, f"indicators.{i}.sample_size", 0),
            _spread(results, i, "low_95"),
            _spread(results, i, "high_95"),
            method(results["indicators"][i]["uncertainty"]["method"] or "", language),
        )
        for i in measured
    ]
    beside: list[tuple[Cell, ...]] = []
    for i in measured:
        for key, zh, en, unit in _BESIDE[i]:
            found = figure(results, f"indicators.{i}.companions.{key}", 3, unit)
            if found.value is not None:
                decimals = (
                    _decimals(results["indicators"][i]) if unit in ("%", "px") else shown_decimals(found.value, unit)
                )
                beside.append(
                    (
                        indicator_name(i, language),
                        _value(results, i, language),
                        say(language, zh, en),
                        figure(results, found.source, decimals, unit),
                    )
                )
    return [
        Heading(text=say(language, "5.2　不确定度", "5.2  Uncertainty"), level=2),
        Table(
            caption=say(language, "附表 #　样本数与 95 % 区间", "Table #  Sample sizes and 95 % intervals"),
            head=say(
                language,
                "检测项目|符号、公式|样本数|95 % 下限|95 % 上限|计算方法",
                "Item|Symbol, formula|n|95 % from|95 % to|Method",
            ).split("|"),
            rows=sure,
            widths=(1.8, 1.5, 0.8, 1.35, 1.35, 3.0),
            align="lccrrl",
        ),
        Table(
            caption=say(language, "附表 #　对照数值", "Table #  Figures beside the standard's own"),
            head=say(language, "检测项目|检测结果|对照|数值", "Item|Result|Beside it|Value").split("|"),
            rows=beside,
            widths=(2.2, 1.5, 3.0, 1.5),
            align="lrlr",
            merge=True,
            merge_like={1: 0},
        ),
        Paragraph(
            text=say(
                language,
                "注：留出数值不参与评定，用以说明在同一批标准反射靶标、影像或靶标上拟合并检验对结果的影响。",
                "Note: held-out figures are not graded. They show what it does to a result that it is fitted and checked on the "
                "same panels, images or targets.",
            ),
            note=True,
        ),
    ]
