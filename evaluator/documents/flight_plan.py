"""The flight plan of 7.1 a to g, from plan.json, survey and sensor sheets; with results also what the flight then showed."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from campaign.flight.records import FlightPlan, PlannedStrip
from evaluator.conformity.clause_7 import flight_height
from evaluator.documents.drawing import picture
from evaluator.documents.flight_sketch import map_points, sketch
from evaluator.documents.map_sheet import degrees_minutes_seconds, sheet_at
from evaluator.documents.model import (
    Block,
    Cell,
    Document,
    Figure,
    Formula,
    Heading,
    Language,
    Paragraph,
    Signatures,
    Table,
    say,
)
from evaluator.documents.phrases import STATUS, not_stated, time_in_words, translated
from evaluator.model import CampaignData
from evaluator.observe.panel_images import camera_lens, focal_length_mm
from evaluator.report.style import style

_KIND = {"multirotor": ("多旋翼", "multirotor"), "fixed_wing": ("固定翼", "fixed wing")}
_SEASON = {"spring": "春季", "summer": "夏季", "autumn": "秋季", "winter": "冬季"}
_MAX_STRIPS = 400  # drawn and listed; a test has tens

# The simulated platform flies level for some seconds into its first strip and out of its last one.
_LEVEL = ("，含航线前后的平飞", ", level flight before and after the strips included")


def build_flight_plan(data: CampaignData, results: Mapping[str, Any] | None, language: Language) -> Document:
    """The document of one campaign, flown or only planned.

    Parameters
    ----------
    data : CampaignData
        Its plan, manifest, survey and sensor sheets.
    results : mapping, optional
        results.json: adds the conformity rows of 6.2.1 and 7.
    language : "zh" | "en"
    """
    plan = data.plan
    blocks: list[Block] = (
        [
            Paragraph(
                text=say(
                    language,
                    "本次检测没有飞行计划（plan.json），飞行计划书各项（7.1 a～g）未记录。",
                    "This campaign holds no flight plan (plan.json): 7.1 a to g are not recorded.",
                )
            )
        ]
        if plan is None
        else [*_summary(data, plan, language), *_area(data, plan, language), *_technical(data, plan, language)]
    )
    return Document(
        name=f"flight_plan_{language}",
        title=say(language, "飞行计划书", "Flight plan"),
        subtitle=say(language, "GB/T 41450—2022，7.1", "GB/T 41450-2022, 7.1"),
        language=language,
        campaign_id=data.manifest.campaign,
        date=data.manifest.date,
        synthetic=data.manifest.synthetic,
        blocks=[
            *blocks,
            *_conformity(results, language),
            Signatures(roles=say(language, "编制|审核|批准", "Prepared by|Checked by|Approved by").split("|")),
        ],
    )


def _place(lat_lon_deg: tuple[float, float], language: Language) -> str:
    latitude, longitude = lat_lon_deg
    north = say(language, "北纬 ", "latitude ")
    east = say(language, "，东经 ", ", longitude ")
    return f"{north}{degrees_minutes_seconds(latitude)}{east}{degrees_minutes_seconds(longitude)}"


def _sheets(plan: FlightPlan, language: Language) -> str:
    """Sheets that hold the area's corners, by their coordinates; a plan that states another one is told so."""
    places = plan.area_lat_lon_deg or (plan.takeoff_lat_lon_deg,)
    found = dict.fromkeys(s.number for p in places if (s := sheet_at(*p)) is not None)
    computed = say(language, "、", ", ").join(found)
    if not found:
        return plan.map_sheet or not_stated(language)
    if plan.map_sheet and plan.map_sheet not in found:
        return say(
            language,
            f"{computed}（由坐标计算；计划写为 {plan.map_sheet}，二者不符）",
            f"{computed} (by the coordinates; the plan states {plan.map_sheet}, which differs)",
        )
    return say(language, f"{computed}（1:10 000，GB/T 13989—2012）", f"{computed} (1:10 000, GB/T 13989-2012)")


def _summary(data: CampaignData, plan: FlightPlan, language: Language) -> list[Block]:
    """a to g as a form."""
    heights = sorted({s.height_m for s in plan.strips})
    season = _SEASON.get(plan.season, plan.season) if language == "zh" else plan.season
    time = time_in_words(plan.start_time, language)
    area = (
        f"{plan.area_m2:.1f} m² = {plan.area_m2 / 1e4:.2f} hm²"
        if language == "zh"
        else (f"{plan.area_m2:.1f} m² = {plan.area_m2 / 1e4:.2f} ha")
    )
    join = say(language, "、", ", ")
    rows = [
        ("a", "飞机型号", "aircraft", f"{plan.aircraft} ({_KIND[plan.aircraft_kind][language == 'en']})"),
        ("b", "起降点", "take-off and landing point", _place(plan.takeoff_lat_lon_deg, language)),
        ("c", "图幅号", "map sheet", _sheets(plan, language)),
        ("d", "飞行区域面积", "flight area", area if plan.area_m2 > 0.0 else not_stated(language)),
        (
            "e",
            "飞行季节和时间",
            "season and time",
            join.join(t for t in (season, time) if t)
            + say(language, f"，历时 {plan.duration_s / 60:.1f} min", f", for {plan.duration_s / 60:.1f} min")
            + (_LEVEL[language == "en"] if data.manifest.synthetic else ""),
        ),
        ("f", "执行期限", "term of the task", plan.deadline or not_stated(language)),
        (
            "g",
            "其他技术要求",
            "other requirements",
            say(language, "；", "; ").join(
                t
                for t in (
                    translated(plan.requirements, language),
                    say(language, "地面分辨率 ", "ground resolution ") + f"{100 * plan.gsd_m:.2f} cm",
                    say(language, "设计航高 ", "design heights ") + ", ".join(f"{h:g}" for h in heights) + " m"
                    if heights
                    else "",
                )
                if t
            ),
        ),
    ]
    return [
        Heading(text=say(language, "1　计划内容", "1  What is planned")),
        Table(
            rows=[(f"{k}) " + say(language, zh, en), text) for k, zh, en, text in rows],
            widths=(1.9, 6.1),
            fields=True,
        ),
        Heading(text=say(language, "2　飞行区域", "2  Flight area")),
    ]


def _area(data: CampaignData, plan: FlightPlan, language: Language) -> list[Block]:
    """c and d: corners with their sheets, and the sketch."""
    points = map_points(data.manifest, plan.area_lat_lon_deg)
    rows: list[tuple[Cell, ...]] = []
    for k, (latitude, longitude) in enumerate(plan.area_lat_lon_deg):
        sheet = sheet_at(latitude, longitude)
        rows.append(
            (
                str(k + 1),
                degrees_minutes_seconds(latitude),
                degrees_minutes_seconds(longitude),
                Figure(value=None if points is None else float(points[k, 1]), decimals=1),
                Figure(value=None if points is None else float(points[k, 0]), decimals=1),
                sheet.number if sheet else "–",
            )
        )
    with style():
        drawn = picture(
            sketch(data, plan, language),
            say(language, "图 1　飞行区域略图", "Figure 1  Sketch of the flight area"),
        )
    return [
        Table(
            caption=say(language, "表 1　飞行区域角点", "Table 1  Corners of the flight area"),
            head=say(
                language,
                "点号|纬度|经度|北坐标 x (m)|东坐标 y (m)|图幅号",
                "Corner|Latitude|Longitude|Northing (m)|Easting (m)|Sheet",
            ).split("|"),
            rows=rows,
            widths=(0.8, 1.7, 1.7, 1.7, 1.7, 1.6),
            align="cccccc",
        ),
        Paragraph(
            text=say(
                language,
                f"注：经纬度为 CGCS2000；平面坐标为 EPSG:{data.manifest.projection_epsg}，北坐标在前。",
                f"Note: latitude and longitude in CGCS2000; plane coordinates in EPSG:{data.manifest.projection_epsg}, "
                "northing first.",
            ),
            note=True,
        ),
        drawn,
    ]


def _length_m(strip: PlannedStrip) -> float:
    return float(np.hypot(*(np.array(strip.end_en_m) - np.array(strip.start_en_m))))


def _technical(data: CampaignData, plan: FlightPlan, language: Language) -> list[Block]:
    """g: strips with heights and speeds, formula (1), footprints and overlap, limits of 7.2 and 7.3."""
    rows: list[tuple[Cell, ...]] = [
        (
            str(s.sortie),
            str(s.strip),
            Figure(value=s.heading_deg, decimals=1),
            Figure(value=s.height_m, decimals=1),
            Figure(value=s.speed_m_s, decimals=1),
            Figure(value=_length_m(s), decimals=1),
            str(s.images),
            _forward_overlap(data, s),
        )
        for s in plan.strips[:_MAX_STRIPS]
    ]
    blocks: list[Block] = [
        Heading(text=say(language, "3　技术要求", "3  Technical requirements")),
        Table(
            caption=say(language, "表 2　航线", "Table 2  Strips"),
            head=say(
                language,
                "架次|航线|航向 (°)|设计航高 (m)|航速 (m/s)|长度 (m)|影像数|航向重叠",
                "Sortie|Strip|Heading (°)|Height (m)|Speed (m/s)|Length (m)|Images|Overlap",
            ).split("|"),
            rows=rows,
            widths=(0.8, 0.8, 1.1, 1.4, 1.2, 1.1, 0.9, 1.1),
            align="cccccccc",
            merge=True,
        ),
    ]
    if data.camera is not None and plan.strips:
        focal, pixel = focal_length_mm(data.camera), data.camera.pixel_size_um / 1000.0
        height = flight_height(focal, plan.gsd_m, pixel)
        blocks += [
            Paragraph(
                text=say(
                    language,
                    "飞行高度由地面分辨率按公式（1）决定，f 取镜头主距：",
                    "Formula (1) gives the height from the ground resolution; f is the lens's principal distance:",
                )
            ),
            Formula(
                text=f"H = f × GSD / a = {focal:.2f} mm × {plan.gsd_m:g} m / {pixel:g} mm = {height:.1f} m",
                number=say(language, "（1）", "(1)"),
            ),
        ]
    return [*blocks, _limits(data, plan, language)]


def _footprint_m(data: CampaignData, height_m: float) -> tuple[float, float] | None:
    """Across and along the track, of a nadir image whose columns run across. [m]"""
    camera = data.camera
    if camera is None:
        return None
    lens = camera_lens(camera)
    return camera.width_px * height_m / lens.fx_px, camera.height_px * height_m / lens.fy_px


def _forward_overlap(data: CampaignData, strip: PlannedStrip) -> Cell:
    """Of neighbouring images evenly spaced from end to end; a dash for a strip of one image."""
    footprint = _footprint_m(data, strip.height_m)
    if footprint is None or strip.images < 2:
        return "–"
    base = _length_m(strip) / (strip.images - 1)
    return Figure(value=100.0 * (1.0 - base / footprint[1]), decimals=0, unit="%")


def _limits(data: CampaignData, plan: FlightPlan, language: Language) -> Table:
    fixed = plan.aircraft_kind == "fixed_wing"
    rows: list[tuple[str, str, str]] = [
        (
            "7.2 a",
            say(language, "起降点障碍物高度角", "Obstacles at the take-off point"),
            f"{plan.obstacle_angle_deg:.0f}°（≤ 20°）",
        ),
        (
            "7.2 b",
            say(language, "卫星数；起飞前静止定位", "Satellites; position at rest before take-off"),
            say(language, f"≥ 10 颗；{plan.static_check_s:.0f} s", f"≥ 10; {plan.static_check_s:.0f} s"),
        ),
        (
            "7.2 c",
            say(language, "太阳高度角", "Elevation of the sun"),
            say(language, "> 35°，飞行期间变化 ≤ 20°", "> 35°, changing by ≤ 20° during the flight"),
        ),
        ("7.2 d", say(language, "风力", "Wind"), say(language, "≤ 5 级（≤ 10.7 m/s）", "≤ force 5 (≤ 10.7 m/s)")),
        (
            "7.3 a",
            say(language, "最大飞行速度", "Greatest ground speed"),
            f"≤ {30 if fixed else 16} m/s（{_KIND[plan.aircraft_kind][language == 'en']}）",
        ),
        ("7.3 c", say(language, "航线中加速度", "Acceleration along strips"), "≤ 2.5 m/s²"),
        ("7.4 a", say(language, "飞行升限", "Ceiling"), "≤ 1000 m"),
        (
            "7.4 b",
            say(language, "航高变化", "Change of height"),
            say(
                language,
                "一条航线内 ≤ 5 %～10 %，与设计航高之差 ≤ 5 %",
                "≤ 5 % to 10 % within a strip, ≤ 5 % against design",
            ),
        ),
        (
            "7.4 c",
            say(language, "相邻航高之差；与设计航高之差", "Height between neighbours; against design"),
            "≤ 5 m",
        ),
        ("6.2.1 b", say(language, "地形坡度", "Slope of the terrain"), f"{plan.ground_slope_deg:.1f}°（< 10°）"),
    ]
    heights = sorted({s.height_m for s in plan.strips})
    for height in heights[:6]:
        footprint = _footprint_m(data, height)
        if footprint is not None:
            rows.append(
                (
                    "7.1 g",
                    say(language, f"影像覆盖，航高 {height:g} m", f"Image on the ground from {height:g} m"),
                    f"{footprint[0]:.1f} m × {footprint[1]:.1f} m",
                )
            )
    if language == "en":
        rows = [(a, b, c.replace("（", " (").replace("）", ")")) for a, b, c in rows]
    return Table(
        caption=say(language, "表 3　飞行要求", "Table 3  Requirements on the flight"),
        head=say(language, "条款|内容|要求", "Clause|Content|Requirement").split("|"),
        rows=rows,
        widths=(0.8, 3.0, 4.0),
        align="cll",
    )


def _conformity(results: Mapping[str, Any] | None, language: Language) -> list[Block]:
    """Rows of 6.2.1 and 7 as the flight then was."""
    if results is None:
        return []
    rows = [
        (
            r["clause"],
            translated(r["requirement"], language),
            translated(r["measured"], language),
            translated(r["limit"], language),
            STATUS[r["status"]][0 if language == "zh" else 1],
        )
        for r in results["conformity"]
        if r["clause"].startswith(("6.2.1", "7.2", "7.3", "7.4"))
    ]
    if not rows:
        return []
    return [
        Heading(text=say(language, "4　执行情况", "4  As it was flown")),
        Table(
            caption=say(language, "表 4　飞行环境、速度和航高的符合情况", "Table 4  Environment, speed and height"),
            head=say(language, "条款|要求|实测|限值|结论", "Clause|Requirement|Measured|Limit|Status").split("|"),
            rows=rows,
            widths=(0.8, 2.4, 3.0, 2.0, 0.9),
            align="clllc",
        ),
    ]
