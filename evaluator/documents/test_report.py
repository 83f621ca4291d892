"""The test report after appendix C: purpose, basis, items (C.1), instruments (C.2), results (C.3), conformity, attachments.

Every figure is one of results.json. What the laboratory alone knows (number, client, names) is left open for a hand.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from evaluator.c10_1_grading import GROUPS, INDICATORS
from evaluator.documents.instruments import instrument_table, system_table
from evaluator.documents.model import (
    Block,
    Document,
    Heading,
    Language,
    Paragraph,
    Signatures,
    Table,
    say,
)
from evaluator.documents.phrases import STATUS, day_in_words, translated
from evaluator.documents.test_report_results import indicator_name, result_blocks
from evaluator.results import Evaluation

_OWN_TABLE = re.compile(r"(附表|Table) #")


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
        blocks=_numbered(
            [
                *_purpose(evaluation, language),
                *_items(results, language),
                *_instruments(evaluation, language),
                *result_blocks(results, language),
                *_conformity(results, language),
                *_attachments(results, language),
            ]
        ),
    )


def _numbered(blocks: list[Block]) -> list[Block]:
    """Tables of our own numbered as they come: some stand only where there is something to say."""
    count = 0
    out: list[Block] = []
    for block in blocks:
        found = _OWN_TABLE.match(block.caption) if isinstance(block, Table) else None
        if isinstance(block, Table) and found:
            count += 1
            block = replace(block, caption=f"{found.group(1)} {count}{block.caption[found.end() :]}")
        out.append(block)
    return out


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


def _items(results: Mapping[str, Any], language: Language) -> list[Block]:
    measured, absent = say(language, "已测", "measured"), say(language, "未测", "not measured")
    rows = [
        (
            say(language, g.name_zh, g.name_en),
            indicator_name(i, language),
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
            caption=say(language, "附表 #　各章要求的符合情况（条数）", "Table #  Requirements by chapter, counted"),
            head=[
                say(language, "章", "Chapter"),
                *(STATUS[s][0 if language == "zh" else 1].capitalize() for s in statuses),
            ],
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
            caption=say(language, "附表 #　不符合或需注意的条款", "Table #  Requirements that fail or need attention"),
            head=say(language, "条款|要求|实测|限值|结论", "Clause|Requirement|Measured|Limit|Status").split("|"),
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
