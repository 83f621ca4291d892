"""What the four handbooks of appendices A and B share: their frame, values as they are printed, and the grades of 10.1.

The builders live in `handbooks_observation`, `handbooks_radiometry` and `handbooks_geometry`; page layout is the writers' matter.
"""

import datetime
import re
from collections.abc import Mapping, Sequence
from typing import Any

from evaluator.c10_1_grading import GROUPS, INDICATORS, Grade, group_grades
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
    printed_unit,
    say,
)
from evaluator.documents.model import figure as figure
from evaluator.documents.phrases import not_stated, translated
from evaluator.model import CampaignData
from evaluator.results import Evaluation, shown_decimals

MOST_ROWS = 600  # of one table; a longer list ends with where all of it stands
_GPS_EPOCH = datetime.datetime(1980, 1, 6, tzinfo=datetime.UTC)
_BEIJING = datetime.timezone(datetime.timedelta(hours=8))
_BLUNDERS = (
    (re.compile(r"mark of (\S+) in (\S+) \(sortie (\d+)\)"), "第 {2} 架次影像 {1} 中靶标 {0} 的标识"),
    (re.compile(r"vertex of (\S+) in strip (\d+) \(sortie (\d+)\)"), "第 {2} 架次航线 {1} 中靶标 {0} 的公共顶点"),
    (re.compile(r"plane of (\S+) in strip (\d+) \(sortie (\d+)\)"), "第 {2} 架次航线 {1} 中靶标 {0} 的平面"),
    (re.compile(r"surveyed place of (\S+): exchanged with that of (\S+)"), "靶标 {0} 与 {1} 的控制测量位置互换"),
    (re.compile(r"surveyed place of (\S+)"), "靶标 {0} 的控制测量位置"),
    (re.compile(r"surveyed height of (\S+)"), "靶标 {0} 的控制测量高程"),
)
_GRADE_WORDS: dict[str, tuple[str, str]] = {
    "excellent": ("优", "excellent"),
    "good": ("良", "good"),
    "fair": ("一般", "fair"),
    "ungraded": ("超出评价范围", "ungraded"),
    "not_measured": ("未测", "not measured"),
}


def document(
    evaluation: Evaluation,
    results: Mapping[str, Any],
    language: Language,
    name: str,
    title: tuple[str, str],
    blocks: Sequence[Block],
) -> Document:
    """A handbook: its blocks, then the open lines of recorder and inspector."""
    data = evaluation.data
    return Document(
        name=f"{name}_{language}",
        title=say(language, *title),
        language=language,
        campaign_id=evaluation.campaign,
        date=data.manifest.date if data else "",
        synthetic=bool(results["synthetic"]),
        blocks=[*blocks, Signatures(roles=say(language, "记录员|检查员", "Recorded by|Inspected by").split("|"))],
    )


def beijing(gps_time_s: float, gps_minus_utc_s: int) -> datetime.datetime:
    """Beijing time of an adjusted standard GPS time (5.4 b)."""
    utc = _GPS_EPOCH + datetime.timedelta(seconds=gps_time_s + 1e9 - gps_minus_utc_s)
    return utc.astimezone(_BEIJING)


def span(low: float, high: float, decimals: int, unit: str, language: Language) -> str:
    """Two values and their unit, or one where they print alike."""
    first, last = (f"{v:.{decimals}f}".replace("-", "−") for v in (low, high))
    if first == last:
        return f"{first} {unit}".strip()
    return say(language, f"{first} {unit}～{last} {unit}", f"{first} to {last} {unit}").strip()


def companions(results: Mapping[str, Any], indicator_id: str) -> Mapping[str, Any]:
    """What stands beside an indicator's value; empty where nothing does."""
    found = results["indicators"][indicator_id]["companions"]
    return found if isinstance(found, Mapping) else {}


def value_figure(results: Mapping[str, Any], indicator_id: str) -> Figure:
    """An indicator's value with the decimals used everywhere."""
    block = results["indicators"][indicator_id]
    value = block["value"]
    gap = 100.0 - value if value is not None and block["symbol"] == "r_f" else value  # 99.995 must not read 100
    decimals = shown_decimals(gap, block["unit"])
    unit = printed_unit(block["unit"])
    return figure(results, f"indicators.{indicator_id}.value", decimals, unit)


def missing(results: Mapping[str, Any], indicator_id: str, language: Language) -> list[Block]:
    """Says that an indicator was not measured, and why; empty where it was."""
    block = results["indicators"][indicator_id]
    if block["value"] is not None:
        return []
    name = say(language, block["name_zh"], block["name"])
    reason = translated(str(block["reason"] or not_stated(language)), language)
    text = say(
        language,
        f"{name}（{block['symbol']}）未测。原因：{reason}",
        f"{name} ({block['symbol']}) was not measured: {reason}",
    )
    blocks: list[Block] = [Paragraph(text=text)]
    partial = f"indicators.{indicator_id}.companions.value_on_what_is_there"
    there = figure(results, partial, 4, printed_unit(block["unit"]))
    if there.value is not None:
        blocks.append(
            Table(
                rows=[(say(language, "按现有数据计算（不参与评价）", "From what is there (not graded)"), there)],
                fields=True,
            )
        )
    return blocks


def blunder(line: str, language: Language) -> str:
    """An observation that the adjustment left out, in the document's language."""
    if language == "en":
        return line
    for pattern, words in _BLUNDERS:
        found = pattern.match(line)
        if found:
            return words.format(*found.groups()) + line[found.end() :]
    return translated(line, language)


def grade_word(grade: str, language: Language) -> str:
    """A grade of table 3 in the document's language."""
    return say(language, *_GRADE_WORDS.get(grade, (grade, grade)))


def limits(indicator_id: str, language: Language) -> str:
    """Bounds of table 3 for one indicator."""
    row = INDICATORS[indicator_id]
    sign = "≥" if row.higher_is_better else "≤"
    unit = "" if row.unit == "pixel" else " %"
    words = [grade_word(g, language) for g in ("excellent", "good", "fair")]
    return say(language, "；", "; ").join(f"{w} {sign}{b:g}{unit}" for w, b in zip(words, row.bounds, strict=True))


def grading(results: Mapping[str, Any], indicators: Sequence[str], language: Language, number: str) -> list[Block]:
    """10.1 for some of the indicators, and for the groups that they form."""
    grades: dict[str, Grade] = {i: results["indicators"][i]["grade"] for i in INDICATORS}
    of_group = group_grades(grades)
    rows: list[tuple[Cell, ...]] = []
    for group in GROUPS:
        for i in group.indicators:
            if i not in indicators:
                continue
            measured = results["indicators"][i]["value"] is not None
            name = say(language, INDICATORS[i].name_zh, INDICATORS[i].name_en)
            rows.append(
                (
                    say(language, group.name_zh, group.name_en) + ("*" if group.starred else ""),
                    f"{name} {INDICATORS[i].symbol}",
                    value_figure(results, i) if measured else grade_word("not_measured", language),
                    limits(i, language),
                    grade_word(grades[i], language),
                    grade_word(of_group[group.id], language),
                )
            )
    return [
        Heading(text=say(language, f"{number}　结果评价（10.1，表 3）", f"{number}  Grades (10.1, table 3)")),
        Table(
            head=say(
                language,
                "一致性类型|衡量指标|结果|表 3 限值|单项程度|一致性程度",
                "Consistency|Indicator|Result|Limits of table 3|Of the item|Degree",
            ).split("|"),
            rows=rows,
            widths=(1.6, 1.6, 1.2, 2.2, 1.0, 1.1),
            align="llrlcc",
            merge=True,
            merge_like={5: 0},
        ),
        Paragraph(
            text=say(
                language,
                "*：取该类各指标中较低的程度。边界值归入较高程度；按未修约值评价。",
                "*: the lower of the group's indicators. A value on a boundary belongs to the better grade; the unrounded "
                "value is graded.",
            ),
            note=True,
        ),
    ]


def cut(rows: Sequence[Sequence[Cell]], language: Language, where: str) -> tuple[list[Sequence[Cell]], list[Block]]:
    """At most `MOST_ROWS` rows, and a note where the rest stands."""
    if len(rows) <= MOST_ROWS:
        return list(rows), []
    text = say(
        language,
        f"共 {len(rows)} 行，此处列出前 {MOST_ROWS} 行，全部见 {where}。",
        f"{len(rows)} rows; the first {MOST_ROWS} are printed, all of them stand in {where}.",
    )
    return list(rows[:MOST_ROWS]), [Paragraph(text=text, note=True)]


def side_by_side(rows: Sequence[Sequence[Cell]], times: int = 2) -> list[list[Cell]]:
    """Rows of a narrow table set in several columns, to be read down and then right; short ends are filled with blanks."""
    if not rows:
        return []
    height = -(-len(rows) // times)
    blank: list[Cell] = [""] * len(rows[0])
    return [
        [cell for k in range(times) for cell in (rows[k * height + i] if k * height + i < len(rows) else blank)]
        for i in range(height)
    ]


def campaign_form(evaluation: Evaluation, language: Language) -> list[tuple[Cell, ...]]:
    """First rows of a calculation handbook's form: which test, when, with what."""
    data = evaluation.data
    unknown = not_stated(language)
    return [
        (
            say(language, "检测编号", "Test"),
            evaluation.campaign,
            say(language, "检测日期", "Date"),
            data.manifest.date if data else unknown,
        ),
        (
            say(language, "光学遥感传感器型号", "Camera"),
            data.camera.name if data and data.camera else unknown,
            say(language, "激光雷达型号", "LiDAR"),
            data.lidar.name if data and data.lidar else unknown,
        ),
    ]


def has_flight(data: CampaignData | None) -> bool:
    """Whether anything was flown: a sortie with images or strips."""
    return data is not None and any(s.exposures or s.strips for s in data.sorties)
