"""The test report after appendix C: purpose, basis, items (C.1), instruments (C.2), results (C.3), conformity, attachments.

Every figure is one of results.json. What the laboratory alone knows (number, client, names) is left open for a hand.
"""

from collections.abc import Mapping
from typing import Any

from evaluator.c10_1_grading import GRADE_ZH, GROUPS, INDICATORS, Group, group_grades
from evaluator.documents.instruments import instrument_table, system_table
from evaluator.documents.model import (
    Block,
    Cell,
    Document,
    Figure,
    Heading,
    Language,
    Paragraph,
    Signatures,
    Table,
    figure,
    say,
)
from evaluator.documents.phrases import STATUS, day_in_words, translated
from evaluator.results import Evaluation, shown_decimals

_GRADE_EN = {
    "excellent": "excellent",
    "good": "good",
    "fair": "fair",
    "ungraded": "beyond table 3",
    "not_measured": "not measured",
}
_METHODS = {  # first words of an uncertainty's method -> Chinese
    "bootstrap over targets": "对靶标和航线重抽样（bootstrap）",
    "bootstrap over images": "对影像重抽样（bootstrap），标定参数不变",
    "bootstrap": "对参考板重抽样（bootstrap）",
    "chi-square": "χ² 分布，自由度 n − 1，取最差波段",
    "propagation": "改正距离与相对真值的协方差传播",
}
# What stands beside an indicator: path below its companions, Chinese, English, unit.
_BESIDE: dict[str, tuple[tuple[str, str, str, str], ...]] = {
    "lidar_reflectance_rmse": (
        ("leave_one_panel_out", "逐板留出", "leave one panel out", "%"),
        ("with_cos_incidence", "振幅除以入射角余弦", "amplitude over cosine of incidence", "%"),
    ),
    "camera_stability": (("trend_percent_per_h", "序列趋势（每小时）", "trend of the series, an hour", "%/h"),),
    "camera_repeatability": (("sd_dn", "标准差", "standard deviation", "DN"),),
    "reflectance_correlation": (("leave_one_panel_out", "逐板留出", "leave one panel out", "%"),),
    "reflectance_rmse_relative": (("leave_one_panel_out", "逐板留出", "leave one panel out", "%"),),
    "lidar_ranging_rmse_relative": (
        ("rmse_m", "测距中误差 m_j", "ranging RMSE m_j", "m"),
        ("leave_one_panel_out_percent", "逐板留出", "leave one panel out", "%"),
    ),
    "camera_reprojection_error": (("held_out_px", "留出影像", "held-out images", "pixel"),),
    "calibration_error": (
        ("held_out_px", "留出靶标", "held-out targets", "pixel"),
        ("single_instant.p_m_px", "单一瞬时刚体变换", "one rigid transform for one instant", "pixel"),
    ),
}


def build_test_report(evaluation: Evaluation, results: Mapping[str, Any], language: Language) -> Document:
    """The document of one evaluation.

    Parameters
    ----------
    evaluation : Evaluation
        For what the campaign states of its instruments.
    results : mapping
        results.json; every figure is taken from it.
    language : "zh" | "en"
    """
    data = evaluation.data
    date = data.manifest.date if data else ""
    return Document(
        name=f"test_report_{language}",
        title=say(language, "检测报告", "Test report"),
        subtitle=say(
            language,
            "无人机低空遥感监测的多传感器一致性检测",
            "Multi-sensor consistency test for UAV-borne low-altitude remote sensing",
        ),
        language=language,
        campaign_id=evaluation.campaign,
        date=date,
        synthetic=bool(results["synthetic"]),
        cover=(
            (say(language, "报告编号", "Report number"), evaluation.campaign),
            (say(language, "产品名称", "Product"), _product(evaluation, language)),
            (say(language, "委托单位", "Client"), ""),
            (say(language, "检测日期", "Date of test"), day_in_words(date, language)),
            (say(language, "检测者", "Tested by"), ""),
        ),
        blocks=[
            *_purpose(evaluation, language),
            *_items(results, language),
            *_instruments(evaluation, language),
            *_results(results, language),
            *_conformity(results, language),
            *_attachments(results, language),
        ],
    )


def _product(evaluation: Evaluation, language: Language) -> str:
    """What is tested: camera, LiDAR and platform as their sheets name them."""
    data = evaluation.data
    if data is None:
        return ""
    parts = [sheet.name for sheet in (data.lidar, data.camera) if sheet is not None]
    text = " + ".join(parts)
    if data.rig is not None and data.rig.platform:
        text += say(language, f"（{data.rig.platform}）", f" ({data.rig.platform})") if text else data.rig.platform
    return text


def _purpose(evaluation: Evaluation, language: Language) -> list[Block]:
    maker = ""
    if evaluation.data is not None:
        sheets = (evaluation.data.lidar, evaluation.data.camera)
        names = dict.fromkeys(s.manufacturer for s in sheets if s is not None and s.manufacturer)
        maker = say(language, "、", ", ").join(names)
    of = say(language, f"对 {maker} 生产的" if maker else "对", f" made by {maker}" if maker else "")
    blocks: list[Block] = [
        Heading(text=say(language, "1　检测目的", "1  Purpose")),
        Paragraph(
            text=say(
                language,
                f"{of}低空多传感器集成系统的辐射和几何一致性进行检测，为该集成系统开展低空遥感监测作业提供指标依据。",
                f"To test the radiometric and geometric consistency of the low-altitude multi-sensor system{of}, and so to give "
                "the figures by which it can be employed in low-altitude remote sensing.",
            )
        ),
    ]
    if evaluation.synthetic:
        blocks.append(
            Paragraph(
                text=say(
                    language,
                    "本报告的检测数据由虚拟检测场仿真得到，不是实际飞行的记录；数据格式、处理方法和评价方法与实际检测相同。",
                    "The data of this report were simulated on a virtual range; nothing was flown. Their form, their processing "
                    "and their grading are those of a field test.",
                )
            )
        )
    blocks += [
        Heading(text=say(language, "2　检测依据", "2  Basis")),
        Paragraph(
            text=say(
                language,
                "GB/T 41450—2022《无人机低空遥感监测的多传感器一致性检测技术规范》。",
                "GB/T 41450-2022, Technical specification of multi-sensor consistency testing for unmanned aerial vehicle (UAV) "
                "borne low altitude remote sensing monitoring.",
            )
        ),
    ]
    return blocks


def _group_name(group: Group, language: Language) -> str:
    """In Chinese on two lines, as table C.3 prints it."""
    zh = group.name_zh
    for kind in ("辐射一致性", "几何一致性"):
        zh = zh.replace(kind, f"\n{kind}")
    return say(language, zh, group.name_en) + ("*" if group.starred else "")


def _indicator_name(indicator_id: str, language: Language) -> str:
    row = INDICATORS[indicator_id]
    return say(language, row.name_zh, row.name_en)


def _items(results: Mapping[str, Any], language: Language) -> list[Block]:
    measured, absent = say(language, "已测", "measured"), say(language, "未测", "not measured")
    rows = [
        (
            say(language, g.name_zh, g.name_en),
            _indicator_name(i, language),
            INDICATORS[i].clause,
            absent if results["indicators"][i]["value"] is None else measured,
        )
        for g in GROUPS
        for i in g.indicators
    ]
    return [
        Heading(text=say(language, "3　检测项目", "3  Items")),
        Paragraph(
            text=say(
                language,
                "多传感器一致性检测主要项目如表 C.1 所示。",
                "Table C.1 lists the items of the consistency test.",
            )
        ),
        Table(
            caption=say(language, "表 C.1　主要检测项目", "Table C.1  Items of the test"),
            head=say(language, "一致性类型|检测项目|条款|本次检测", "Consistency|Item|Clause|In this test").split("|"),
            rows=rows,
            widths=(3.2, 3.2, 0.9, 1.4),
            align="llcc",
            merge=True,
        ),
    ]


def _instruments(evaluation: Evaluation, language: Language) -> list[Block]:
    return [
        Heading(text=say(language, "4　检测仪器", "4  Instruments")),
        Paragraph(
            text=say(
                language,
                "多传感器一致性检测过程中相关检测仪器性能参数如表 C.2 所示，被检系统如附表 1 所示。",
                "Table C.2 gives the instruments of the test with their performance, table 1 the system under test.",
            )
        ),
        instrument_table(evaluation, language),
        system_table(evaluation, language),
    ]


def _unit(unit: str) -> str:
    return {"% reflectance": "%"}.get(unit, unit)


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
    return figure(results, path, _decimals(block), _unit(block["unit"]))


def _spread(results: Mapping[str, Any], indicator_id: str, key: str) -> Figure:
    """std with two digits, low_95 and high_95 with the decimals of the indicator itself."""
    block = results["indicators"][indicator_id]
    path = f"indicators.{indicator_id}.uncertainty.{key}"
    decimals = _decimals(block)
    if key == "std":
        decimals = max(decimals, shown_decimals(figure(results, path).value, block["unit"]))
    return figure(results, path, decimals, _unit(block["unit"]))


def _results(results: Mapping[str, Any], language: Language) -> list[Block]:
    grades = {i: results["indicators"][i]["grade"] for i in INDICATORS}
    groups = group_grades(grades)
    sort = {True: say(language, "辐射一致性", "Radiometric"), False: say(language, "几何一致性", "Geometric")}
    rows: list[tuple[Cell, ...]] = [
        (
            sort["radiometry" in g.id],
            _group_name(g, language),
            _indicator_name(i, language),
            _value(results, i, language),
            _spread(results, i, "std"),
            _grade(grades[i], language),
            _grade(groups[g.id], language),
        )
        for g in GROUPS
        for i in g.indicators
    ]
    blocks: list[Block] = [
        Heading(text=say(language, "5　检测结果", "5  Results")),
        Heading(text=say(language, "5.1　一致性程度", "5.1  Degrees of consistency"), level=2),
        Paragraph(text=say(language, "多传感器一致性检测结果如表 C.3 所示。", "Table C.3 gives the results.")),
        Table(
            caption=say(language, "表 C.3　检测结果表", "Table C.3  Results"),
            head=say(
                language,
                "内容|一致性类型|检测项目|检测结果|标准差|单项程度|一致性程度",
                "Content|Consistency|Item|Result|Std. dev.|Of the item|Degree",
            ).split("|"),
            rows=rows,
            widths=say_widths(language, (0.9, 1.75, 1.95, 1.6, 1.6, 1.05, 1.3), (1.3, 1.8, 1.7, 1.6, 1.6, 1.15, 1.15)),
            align="cclrrcc",
            merge=True,
            merge_like={6: 1},
        ),
        Paragraph(
            text=say(
                language,
                "注：* 为较低单指标一致性程度所评估的一致性检测结果。程度按未取舍的数值评定，界限值属较高一级；组内有指标未测时，"
                "该组不评定。",
                "Note: * the degree is the lower one of the group's indicators. The unrounded value is graded; a value on a bound "
                "takes the better degree; a group with an indicator that was not measured has none.",
            ),
            note=True,
        ),
    ]
    return [*blocks, *_not_measured(results, language), *_how_sure(results, language)]


def say_widths(language: Language, zh: tuple[float, ...], en: tuple[float, ...]) -> tuple[float, ...]:
    """The widths that suit the words of a language."""
    return zh if language == "zh" else en


def _not_measured(results: Mapping[str, Any], language: Language) -> list[Block]:
    rows = [
        (
            _indicator_name(i, language),
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
            caption=say(language, "附表 2　未测项目及原因", "Table 2  Items not measured, and why"),
            head=say(language, "检测项目|条款|原因", "Item|Clause|Reason").split("|"),
            rows=rows,
            widths=(2.2, 0.7, 5.0),
            align="lcl",
        )
    ]


def _method(text: str | None, language: Language) -> str:
    if not text or language == "en":
        return text or ""
    return next((zh for start, zh in _METHODS.items() if text.startswith(start)), text)


def _how_sure(results: Mapping[str, Any], language: Language) -> list[Block]:
    """95 % intervals, sample sizes, and the figures that stand beside the standard's own."""
    measured = [i for i in INDICATORS if results["indicators"][i]["value"] is not None]
    if not measured:
        return []
    sure: list[tuple[Cell, ...]] = [
        (
            _indicator_name(i, language),
            f"{INDICATORS[i].symbol}  {results['indicators'][i]['formula']}",
            figure(results, f"indicators.{i}.sample_size", 0),
            _spread(results, i, "low_95"),
            _spread(results, i, "high_95"),
            _method(results["indicators"][i]["uncertainty"]["method"], language),
        )
        for i in measured
    ]
    beside: list[tuple[Cell, ...]] = []
    for i in measured:
        for key, zh, en, unit in _BESIDE[i]:
            found = figure(results, f"indicators.{i}.companions.{key}", 3, unit)
            if found.value is not None:
                decimals = (
                    _decimals(results["indicators"][i]) if unit in ("%", "pixel") else shown_decimals(found.value, unit)
                )
                beside.append(
                    (
                        _indicator_name(i, language),
                        _value(results, i, language),
                        say(language, zh, en),
                        figure(results, found.source, decimals, unit),
                    )
                )
    return [
        Heading(text=say(language, "5.2　不确定度", "5.2  Uncertainty"), level=2),
        Table(
            caption=say(language, "附表 3　样本数与 95 % 区间", "Table 3  Sample sizes and 95 % intervals"),
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
            caption=say(language, "附表 4　对照数值", "Table 4  Figures beside the standard's own"),
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
                "注：留出数值不参与评定，用以说明在同一批参考板、影像或靶标上拟合并检验对结果的影响。",
                "Note: held-out figures are not graded. They show what it does to a result that it is fitted and checked on the "
                "same panels, images or targets.",
            ),
            note=True,
        ),
    ]


def _conformity(results: Mapping[str, Any], language: Language) -> list[Block]:
    """Counts by clause, and every row that fails or warns."""
    rows = results["conformity"]
    statuses = ("pass", "warning", "fail", "not_recorded", "not_applicable")
    counted: dict[str, dict[str, int]] = {}
    for r in rows:
        chapter = str(r["clause"]).split(" ")[0].split(".")[0]
        of = counted.setdefault(chapter, dict.fromkeys(statuses, 0))
        of[r["status"]] = of.get(r["status"], 0) + 1
    chapters = {
        "5": say(language, "5　基本要求", "5  Basic requirements"),
        "6": say(language, "6　检测条件", "6  Conditions of the test"),
        "7": say(language, "7　检测飞行", "7  Flight"),
        "8": say(language, "8　辐射一致性检测", "8  Radiometric consistency"),
        "9": say(language, "9　几何一致性检测", "9  Geometric consistency"),
    }
    table = [(chapters.get(c, c), *(str(n[s]) for s in statuses)) for c, n in counted.items()]
    blocks: list[Block] = [
        Heading(text=say(language, "5.3　检测条件的符合性", "5.3  Conformity of the test's conditions"), level=2),
        Table(
            caption=say(language, "附表 5　各章要求的符合情况（条数）", "Table 5  Requirements by chapter, counted"),
            head=[say(language, "章", "Chapter"), *(STATUS[s][0 if language == "zh" else 1] for s in statuses)],
            rows=table,
            widths=(3.0, 1, 1, 1, 1, 1.2),
            align="lccccc",
        ),
    ]
    amiss = [r for r in rows if r["status"] in ("fail", "warning")]
    if not amiss:
        text = say(language, "没有不符合或需注意的条款。", "No requirement fails or needs attention.")
        return [*blocks, Paragraph(text=text)]
    return [
        *blocks,
        Table(
            caption=say(language, "附表 6　不符合或需注意的条款", "Table 6  Requirements that fail or need attention"),
            head=say(language, "条款|要求|实测|界限|结论", "Clause|Requirement|Measured|Limit|Status").split("|"),
            rows=[
                (
                    r["clause"],
                    translated(r["requirement"], language),
                    translated(r["measured"], language),
                    translated(r["limit"], language),
                    STATUS[r["status"]][0 if language == "zh" else 1],
                )
                for r in amiss
            ],
            widths=(0.9, 2.2, 3.2, 2.0, 0.9),
            align="clllc",
        ),
    ]


def _attachments(results: Mapping[str, Any], language: Language) -> list[Block]:
    rows = say(
        language,
        "辐射一致性检测观测手簿（A.1）|observation_radiometric_zh\n几何一致性检测观测手簿（A.2）|observation_geometric_zh\n"
        "辐射一致性检测计算手簿（B.1）|calculation_radiometric_zh\n几何一致性检测计算手簿（B.2）|calculation_geometric_zh\n"
        "飞行计划书（7.1）|flight_plan_zh\n全部数值|results.json",
        "Observation handbook, radiometry (A.1)|observation_radiometric_en\nObservation handbook, geometry (A.2)|"
        "observation_geometric_en\nCalculation handbook, radiometry (B.1)|calculation_radiometric_en\n"
        "Calculation handbook, geometry (B.2)|calculation_geometric_en\nFlight plan (7.1)|flight_plan_en\nAll figures|results.json",
    )
    problems = [translated(str(p), language) for p in results.get("problems", [])][:100]
    amiss: list[Block] = [Paragraph(text=p) for p in problems]
    if amiss:
        amiss.insert(0, Heading(text=say(language, "资料中的问题", "Problems in the records"), level=2))
    return [
        Heading(text=say(language, "6　附件", "6  Attachments")),
        Table(
            head=say(language, "名称|文件", "Name|File").split("|"),
            rows=[line.split("|") for line in rows.split("\n")],
            widths=(3, 2),
        ),
        *amiss,
        Signatures(roles=say(language, "检测|审核|批准", "Tested by|Checked by|Approved by").split("|")),
    ]
