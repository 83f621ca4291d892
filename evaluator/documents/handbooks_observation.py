"""Observation handbooks after appendix A: A.1 radiometric, A.2 geometric consistency.

The form of the test's conditions, the sketch of the layout, where every target stands, and for every target in every sortie its
pixel coordinates and LiDAR point numbers. What the campaign does not hold is left as "not recorded".
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from evaluator.documents.handbooks_common import cut, document, has_flight, missing
from evaluator.documents.handbooks_conditions import conditions
from evaluator.documents.handbooks_sketch import layout_sketch
from evaluator.documents.model import Block, Cell, Document, Figure, Heading, Language, Paragraph, Table, say
from evaluator.documents.observations import CAMERA, LIDAR, rejected_marks, target_pixels, target_point_numbers
from evaluator.documents.phrases import translated
from evaluator.model import CampaignData
from evaluator.results import Evaluation

_LISTED = 8  # coordinates or point numbers of one target in one sortie
_FILES = "observations/NN/"


def build_radiometric_observation(evaluation: Evaluation, results: Mapping[str, Any], language: Language) -> Document:
    """A.1: reflectance panels.

    Parameters
    ----------
    evaluation : Evaluation
        Regions, point numbers and the campaign's own records.
    results : mapping
        results.json.
    language : "zh" | "en"

    References
    ----------
    GB/T 41450-2022, 10.2 b, A.1.
    """
    title = ("多传感器辐射一致性检测观测手簿", "Observation handbook A.1, radiometric")
    return _build(evaluation, results, language, "panel", "observation_radiometric", title)


def build_geometric_observation(evaluation: Evaluation, results: Mapping[str, Any], language: Language) -> Document:
    """A.2: targets of geometric consistency.

    Parameters
    ----------
    evaluation : Evaluation
    results : mapping
        results.json.
    language : "zh" | "en"

    References
    ----------
    GB/T 41450-2022, 10.2 d, A.2.
    """
    title = ("多传感器几何一致性检测观测手簿", "Observation handbook A.2, geometric")
    return _build(evaluation, results, language, "frustum", "observation_geometric", title)


def _build(
    evaluation: Evaluation,
    results: Mapping[str, Any],
    language: Language,
    kind: str,
    name: str,
    title: tuple[str, str],
) -> Document:
    data = evaluation.data
    blocks: list[Block] = [
        Heading(text=say(language, "1　基本信息", "1  The test")),
        Table(rows=conditions(data, kind, language), fields=True, widths=(1.3, 2.7, 1.3, 2.7)),
        Heading(text=say(language, "2　靶标布设", "2  Layout of the targets")),
        *_layout(data, kind, language),
        Heading(text=say(language, "3　光学遥感传感器观测值", "3  Observations of the camera")),
        *_camera(evaluation, kind, language),
        Heading(text=say(language, "4　激光雷达观测值", "4  Observations of the LiDAR")),
        *_lidar(evaluation, kind, language),
        *_remarks(evaluation, results, kind, language),
    ]
    return document(evaluation, results, language, name, title, blocks)


# --- layout --------------------------------------------------------------------------------------------------------------------


def _layout(data: CampaignData | None, kind: str, language: Language) -> list[Block]:
    chosen = [t for t in data.targets if t.kind == kind] if data else []
    if data is None or not chosen:
        text = say(language, "控制测量资料中没有此类靶标。", "The survey holds no target of this kind.")
        return [Paragraph(text=text)]
    sketch = layout_sketch(data, kind, language)
    last = say(language, "标称反射率 %", "Nominal reflectance %") if kind == "panel" else say(language, "式样", "Style")
    styles = {"inverted": say(language, "倒置", "inverted"), "upright": say(language, "正置", "upright")}
    rows: list[tuple[Cell, ...]] = [
        (
            t.id,
            Figure(value=t.northing_m, decimals=3),
            Figure(value=t.easting_m, decimals=3),
            Figure(value=t.height_m, decimals=3),
            Figure(value=t.size_m, decimals=3),
            Figure(value=t.nominal_reflectance_percent, decimals=0)
            if kind == "panel"
            else styles.get(t.style or "", "–"),
        )
        for t in sorted(chosen, key=lambda t: t.id)
    ]
    rows_shown, more = cut(rows, language, "survey/targets.csv")
    table = Table(
        caption=say(language, "表 1　靶标布设位置（控制测量）", "Table 1  Surveyed places of the targets"),
        head=[
            say(language, "靶标", "Target"),
            say(language, "北坐标 m", "Northing m"),
            say(language, "东坐标 m", "Easting m"),
            say(language, "正常高 m", "Normal height m"),
            say(language, "边长 m", "Edge m"),
            last,
        ],
        rows=rows_shown,
        widths=(1.0, 1.7, 1.5, 1.3, 1.0, 1.3),
        align="lrrrrr" if kind == "panel" else "lrrrrl",
        small=True,
    )
    return ([sketch] if sketch else []) + [table, *more]


# --- observations --------------------------------------------------------------------------------------------------------------


def _sortie_name(number: int, language: Language) -> str:
    digits = "零一二三四五六七八九十"
    word = digits[number] if number < len(digits) else f" {number} "
    return say(language, f"第{word}架次", f"sortie {number}")


def _grid(evaluation: Evaluation, kind: str) -> list[tuple[int, str]]:
    """Every sortie with every target of the kind, in order: a place without an observation is printed as such."""
    data = evaluation.data
    if data is None:
        return []
    ids = sorted(t.id for t in data.targets if t.kind == kind)
    return [(s.folder.number, i) for s in data.sorties for i in ids]


def _no_observations(evaluation: Evaluation, kind: str, what: tuple[str, str], language: Language) -> list[Block]:
    if not has_flight(evaluation.data):
        text = say(
            language,
            "本次检测没有飞行数据，此项无观测值。",
            "This campaign holds no flight: nothing was observed here.",
        )
    else:
        text = say(language, *what)
    return [Paragraph(text=text)]


def _camera(evaluation: Evaluation, kind: str, language: Language) -> list[Block]:
    pixels = target_pixels(evaluation, kind)
    if not pixels:
        why = ("影像中未得到此类靶标的观测值。", "No target of this kind was observed in an image.")
        return _no_observations(evaluation, kind, why, language)
    rows: list[tuple[Cell, ...]] = []
    for sortie, target in _grid(evaluation, kind):
        mine = {image: uv for (s, t, image), uv in pixels.items() if (s, t) == (sortie, target)}
        count = sum(len(uv) for uv in mine.values())
        rows.append(
            (
                _sortie_name(sortie, language),
                target,
                Figure(value=len(mine), decimals=0),
                Figure(value=count, decimals=0),
                _coordinates(mine, 1 if kind == "panel" else 2, language),
            )
        )
    shown, more = cut(rows, language, _FILES + CAMERA)
    caption = {
        "panel": say(
            language,
            "表 2　辐射靶标在影像中的像素坐标（取值区域的角点）",
            "Table 2  Pixel coordinates of the panels (corners of the region that was read)",
        ),
        "frustum": say(
            language,
            "表 2　几何一致性靶标标识图案中心的像素坐标",
            "Table 2  Pixel coordinates of the marks' centres",
        ),
    }[kind]
    head = say(
        language, "架次|靶标|影像数|坐标数|像素坐标 (u, v)", "Sortie|Target|Images|Pixels|Pixel coordinates (u, v)"
    ).split("|")
    return [
        Table(
            caption=caption,
            head=head,
            rows=shown,
            widths=(0.9, 0.65, 0.65, 0.65, 6.3),
            align="llrrl",
            small=True,
            merge=True,
        ),
        *more,
    ]


def _coordinates(by_image: Mapping[str, np.ndarray], decimals: int, language: Language) -> str:
    """The first eight as the example has them, by image."""
    if not by_image:
        return say(language, "未观测到", "not observed")
    parts, left = [], _LISTED
    for image, uv in sorted(by_image.items()):
        if left <= 0:
            break
        listed = uv[:left]
        left -= len(listed)
        parts.append(f"{image}: " + ";".join(f"({u:.{decimals}f},{v:.{decimals}f})" for u, v in listed))
    text = say(language, "；", "; ").join(parts)
    return text + ("…" if sum(len(uv) for uv in by_image.values()) > _LISTED else "")


def _lidar(evaluation: Evaluation, kind: str, language: Language) -> list[Block]:
    numbers = target_point_numbers(evaluation, kind)
    if not numbers:
        why = ("未保存此类靶标的激光雷达点号。", "No LiDAR point numbers of targets of this kind were kept.")
        return _no_observations(evaluation, kind, why, language)
    rows: list[tuple[Cell, ...]] = []
    for sortie, target in _grid(evaluation, kind):
        mine = {strip: n for (s, strip, t), n in numbers.items() if (s, t) == (sortie, target)}
        count = sum(len(n) for n in mine.values())
        rows.append((_sortie_name(sortie, language), target, Figure(value=count, decimals=0), _points(mine, language)))
    shown, more = cut(rows, language, _FILES + LIDAR)
    caption = {
        "panel": say(language, "表 3　落在辐射靶标上的激光雷达点号", "Table 3  LiDAR points on the panels"),
        "frustum": say(
            language,
            "表 3　落在几何一致性靶标侧面上的激光雷达点号",
            "Table 3  LiDAR points on the faces of the geometric targets",
        ),
    }[kind]
    head = say(language, "架次|靶标|点数|激光雷达点号", "Sortie|Target|Points|LiDAR point numbers").split("|")
    return [
        Table(
            caption=caption, head=head, rows=shown, widths=(0.9, 0.7, 0.7, 6.4), align="llrl", small=True, merge=True
        ),
        *more,
    ]


def _points(by_strip: Mapping[int, np.ndarray], language: Language) -> str:
    """Point numbers as the example has them, the first eight; of every strip the count."""
    if not by_strip:
        return say(language, "未观测到", "not observed")
    parts, left = [], _LISTED
    for strip, numbers in sorted(by_strip.items()):
        listed = numbers[:left]
        left -= len(listed)
        text = say(language, f"航线 {strip}（{len(numbers)} 点）", f"strip {strip} ({len(numbers)} points)")
        if len(listed):
            text += ": " + ",".join(f"P{n}" for n in listed) + (",…" if len(listed) < len(numbers) else "")
        parts.append(text)
    return say(language, "；", "; ").join(parts)


def _remarks(evaluation: Evaluation, results: Mapping[str, Any], kind: str, language: Language) -> list[Block]:
    target = say(
        language,
        {"panel": "辐射靶标", "frustum": "几何一致性靶标"}[kind],
        {"panel": "panel", "frustum": "geometric target"}[kind],
    )
    notes = [
        say(
            language,
            f"注：光学遥感传感器观测值表示{target}在光学遥感影像中的像素坐标（影像左上角为原点，第一个像素的中心为 (0.5, 0.5)）；"
            f"激光雷达观测值表示落在{target}上的激光雷达点号，即该航线 LAS 文件中的记录序号，自 0 起。"
            f"每个靶标至多列出前 {_LISTED} 个，"
            f"全部观测值见 {_FILES}{CAMERA} 和 {_FILES}{LIDAR}（NN 为架次号）。",
            f"Note: observations of the camera are pixel coordinates of the {target} in the image (origin: the image's top left "
            "corner; the first pixel's centre is (0.5, 0.5)). Observations of the LiDAR are numbers of the points on the "
            f"{target}: of the record in the strip's LAS file, from 0. At most the first {_LISTED} of a target are printed; all of "
            f"them stand in {_FILES}{CAMERA} and {_FILES}{LIDAR} (NN: the sortie).",
        )
    ]
    clause = {"panel": "8.3.2 c", "frustum": "9.3.2 c"}[kind]
    found_by = next((r["measured"] for r in results["conformity"] if r["clause"] == clause), None)
    if found_by:
        text = translated(str(found_by), language)
        notes.append(say(language, f"靶标的提取（{clause}）：{text}。", f"Who found the targets ({clause}): {text}."))
    if kind == "frustum":
        rejected = sorted(rejected_marks(evaluation))
        if rejected:
            listed = say(language, "、", ", ").join(f"{t} ({image})" for _, image, t in rejected)
            notes.append(
                say(
                    language,
                    f"平差中作为粗差剔除、未列入表 2 的标识观测值：{listed}。",
                    f"Marks that the adjustment left out as blunders and that table 2 does not hold: {listed}.",
                )
            )
    blocks: list[Block] = [Paragraph(text=text, note=True) for text in notes]
    for indicator in {"panel": ("reflectance_correlation",), "frustum": ("calibration_error",)}[kind]:
        blocks += missing(results, indicator, language)
    return blocks
