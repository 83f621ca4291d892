"""A plan on the terminal (at most 100 columns, Chinese or English) and as JSON."""

from collections.abc import Callable, Iterable
from dataclasses import asdict
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from evaluator.documents.cells import TITLE_LENGTH, one_line
from evaluator.documents.model import Language
from testrange.plan.model import Plan, PlanRow, SortieFigures, TargetPoints
from testrange.plan.words import STATUS, own, say

_STYLE = {"fail": "red", "warning": "yellow", "after": "dim", "not_recorded": "dim", "not_applicable": "dim"}

_WIDTHS: dict[Language, tuple[int, int]] = {"en": (9, 13), "zh": (6, 9)}  # of status and clause


def plan_block(plan: Plan) -> dict[str, Any]:
    """What --json prints: every figure of the plan, its rows, and the refusal (null where nothing fails)."""
    block = asdict(plan)
    if plan.volume is not None:
        block["volume"]["total"] = plan.volume.total
    block["failing"] = [row.clause for row in plan.failing]
    block["refusal"] = plan.refusal
    return block


def print_plan(plan: Plan, console: Console, language: Language) -> None:
    """Figures first, then every row that a plan can answer, then what only the campaign can tell."""
    head = f"{say(language, '飞行前检核', 'plan')} · GB/T 41450-2022 · {plan.campaign} · {plan.title}"
    console.print(Text(one_line(head, TITLE_LENGTH), "bold"))
    if plan.sorties:
        console.print(_sortie_table(plan.sorties, language))
    if plan.points:
        console.print(_point_table(plan.points, language))
    for name, text in _lines(plan, language):
        console.print(Text.assemble((f"{name}{_colon(language)}", "bold"), text))
    _print_rows([row for row in plan.rows if row.status != "after"], console, language)
    after = [row for row in plan.rows if row.status == "after"]
    if after:
        told = say(language, "；", "; ").join(f"{row.clause} {own(row.requirement, language)}" for row in after)
        console.print(Text(f"{say(language, '检测后方可判定', 'after the campaign')}{_colon(language)}{told}", "dim"))
    counts: dict[str, int] = {}
    for row in plan.rows:
        counts[row.status] = counts.get(row.status, 0) + 1
    console.print(
        say(language, "合计：", "rows: ")
        + say(language, "，", ", ").join(f"{n} {_status(s, language)}" for s, n in counts.items())
    )


def _colon(language: Language) -> str:
    return say(language, "：", ": ")


def _status(status: str, language: Language) -> str:
    return say(language, *STATUS[status])


def _table(title: str, columns: Iterable[tuple[str, str]]) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name, justify in columns:
        table.add_column(Text(name), justify="right" if justify == "right" else "left")
    return table


def _sortie_table(sorties: tuple[SortieFigures, ...], language: Language) -> Table:
    """One column a sortie: the figures have names, and twelve heights are the most."""
    title = say(language, "各架次", "sorties")
    table = _table(title, [(say(language, "架次", "sortie"), "left"), *((str(s.sortie), "right") for s in sorties)])
    lines: list[tuple[tuple[str, str], Callable[[SortieFigures], str | None]]] = [
        (("航高 [m]", "height [m]"), lambda s: f"{s.height_m:g}"),
        (("地速 [m/s]", "ground speed [m/s]"), lambda s: f"{s.speed_m_s:g}"),
        (("飞行时间 [s]", "duration [s]"), lambda s: f"{s.duration_s:.0f}"),
        (("航线 / 影像", "strips / images"), lambda s: f"{s.strips} / {s.images}"),
        (("地面分辨率 GSD [cm]", "GSD [cm]"), lambda s: _maybe(s.gsd_m, 100.0, 2)),
        (
            ("像幅地面尺寸 [m]", "image footprint [m]"),
            lambda s: f"{s.footprint_m[0]:.1f} × {s.footprint_m[1]:.1f}" if s.footprint_m else None,
        ),
        (
            ("像移：航速 / 姿态 [px]", "motion blur: speed / attitude [px]"),
            lambda s: (
                f"{s.blur_px:.2f} / {s.blur_attitude_px:.2f}"
                if s.blur_px is not None and s.blur_attitude_px is not None
                else None
            ),
        ),
        (("航向重叠 [%]", "forward overlap [%]"), lambda s: _maybe(s.forward_overlap, 100.0, 0)),
        (("旁向重叠 [%]", "side overlap [%]"), lambda s: _maybe(s.side_overlap, 100.0, 0)),
        (("激光扫描带宽 [m]", "LiDAR swath [m]"), lambda s: _maybe(s.swath_m, 1.0, 1)),
        (("激光点密度 [1/m²]", "LiDAR points [1/m²]"), lambda s: _maybe(s.points_per_m2, 1.0, 0)),
        (
            ("扫描线距 / 点距 [cm]", "line / point spacing [cm]"),
            lambda s: (
                f"{100 * s.line_spacing_m:.1f} / {100 * s.pulse_spacing_m:.1f}"
                if s.line_spacing_m is not None and s.pulse_spacing_m is not None
                else None
            ),
        ),
        (("激光光斑 [cm]", "beam footprint [cm]"), lambda s: _maybe(s.beam_footprint_m, 100.0, 1)),
    ]
    for name, figure in lines:
        cells = [figure(s) for s in sorties]
        if any(cell is not None for cell in cells):
            table.add_row(Text(say(language, *name)), *(Text(cell or "–") for cell in cells))
    return table


def _maybe(value: float | None, scale: float, digits: int) -> str | None:
    return None if value is None else f"{value * scale:.{digits}f}"


def _point_table(points: tuple[TargetPoints, ...], language: Language) -> Table:
    table = _table(
        say(language, "每个靶标的激光点数（各架次全部航线）", "LiDAR points on a target, all strips of a sortie"),
        [
            (say(language, "架次", "sortie"), "right"),
            (say(language, "靶标", "targets"), "left"),
            (say(language, "最少", "least"), "right"),
            (say(language, "平均", "mean"), "right"),
            (say(language, "最多", "most"), "right"),
            (say(language, "每航线每棱面最少", "a face and strip, least"), "right"),
        ],
    )
    kinds = {"panel": ("标准反射靶标", "panels"), "frustum": ("梯形棱台靶标（棱面上）", "frustums, on their faces")}
    for sortie in sorted({p.sortie for p in points}):
        for kind, name in kinds.items():
            mine = [p for p in points if (p.sortie, p.kind) == (sortie, kind)]
            if not mine:
                continue
            least = min(mine, key=lambda p: p.points)
            table.add_row(
                str(sortie),
                f"{say(language, *name)}{_colon(language)}{len(mine)}",
                f"{least.points} ({least.target})",
                f"{sum(p.points for p in mine) / len(mine):.0f}",
                str(max(p.points for p in mine)),
                str(min(min(p.faces) for p in mine)) if kind == "frustum" else "",
            )
    return table


def _lines(plan: Plan, language: Language) -> list[tuple[str, str]]:
    """Name and text of the figures that stand alone."""
    found: list[tuple[str, str]] = []
    if plan.duration_s is not None:
        found.append(
            (
                say(language, "时间", "time"),
                say(
                    language,
                    f"{plan.start_time} 起，历时 {plan.duration_s / 60.0:.0f} 分钟（含架次间隔）",
                    f"from {plan.start_time}, {plan.duration_s / 60.0:.0f} min with the pauses between sorties",
                ),
            )
        )
    if plan.sun_elevation_deg is not None:
        spans = say(language, "、", ", ").join(f"{a}–{b}" for a, b in plan.sun_window)
        low, high = plan.sun_elevation_deg
        found.append(
            (
                say(language, "太阳", "sun"),
                say(
                    language,
                    f"高度角 {low:.1f}° 至 {high:.1f}°；{plan.date} 首条航线可开始的北京时间（7.2 c）：{spans or '无'}",
                    f"elevation {low:.1f}° to {high:.1f}°; on {plan.date} the first strip may begin {spans or 'never'} "
                    "Beijing time (7.2 c)",
                ),
            )
        )
    found += _light_lines(plan, language)
    if plan.longest_range_m is not None and plan.unambiguous_range_m is not None:
        found.append(
            (
                say(language, "测程", "range"),
                say(
                    language,
                    f"最长斜距 {plan.longest_range_m:.1f} m，不模糊距离 {plan.unambiguous_range_m:.1f} m",
                    f"longest slant {plan.longest_range_m:.1f} m, unambiguous to {plan.unambiguous_range_m:.1f} m",
                ),
            )
        )
    if plan.volume is not None:
        v = plan.volume
        found.append(
            (
                say(language, "数据量", "data"),
                say(
                    language,
                    f"{v.image_count} 张影像 {_mb(v.images)}，{v.return_count:,} 个激光点 {_mb(v.points)}，"
                    f"{v.waveform_count:,} 条波形 {_mb(v.waveforms)}；仿真共占磁盘约 {_mb(v.total)}",
                    f"{v.image_count} images {_mb(v.images)}, {v.return_count:,} points {_mb(v.points)}, "
                    f"{v.waveform_count:,} waveforms {_mb(v.waveforms)}; a simulation takes about {_mb(v.total)} of disk",
                ),
            )
        )
    return found + _accuracy_lines(plan, language)


def _mb(count: int) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


def _light_lines(plan: Plan, language: Language) -> list[tuple[str, str]]:
    if plan.exposure is None or not plan.light:
        return []
    dark, bright = (pick(plan.light, key=lambda p: max(p.dn)) for pick in (min, max))
    e = plan.exposure
    panels = say(language, " 至 ", " to ").join(
        f"{max(p.dn):.0f} DN ({p.panel}, {p.nominal_percent:g} %)" for p in (dark, bright)
    )
    text = say(
        language,
        f"曝光 1/{1.0 / e.exposure_time_s:.0f} s，增益 {e.gain_e_per_dn:.3g} e/DN；标准反射靶标 {panels}，"
        f"满量程 {bright.full_scale_dn:.0f} DN",
        f"exposure 1/{1.0 / e.exposure_time_s:.0f} s, gain {e.gain_e_per_dn:.3g} e/DN; panels {panels}, full scale "
        f"{bright.full_scale_dn:.0f} DN",
    )
    return [(say(language, "影像", "images"), text)]


def _accuracy_lines(plan: Plan, language: Language) -> list[tuple[str, str]]:
    name = say(language, "安置参数预期精度", "mounting, expected std")
    if plan.accuracy is None:
        return [(name, plan.accuracy_reason)] if plan.accuracy_reason else []
    parts = []
    for sensor, words in (("camera", ("相机", "camera")), ("lidar", ("激光雷达", "LiDAR"))):
        angles = "/".join(f"{plan.accuracy.std[f'{sensor}_boresight_{a}']:.4f}" for a in ("roll", "pitch", "yaw"))
        arms = "/".join(f"{1000 * plan.accuracy.std[f'{sensor}_lever_arm_{a}']:.1f}" for a in "xyz")
        parts.append(f"{say(language, *words)} {angles}°, {arms} mm")
    weak = plan.accuracy.weak
    if weak:
        parts.append(
            say(language, "本飞行不能确定：", "not determined by this flight: ") + say(language, "；", "; ").join(weak)
        )
    return [(name, say(language, "；", "; ").join(parts))]


def _print_rows(rows: list[PlanRow], console: Console, language: Language) -> None:
    """One paragraph a row: what it says, its limit in brackets, the way out below."""
    console.print(Text(say(language, "条款检核", "clauses"), "italic"))
    for row in rows:
        style = _STYLE.get(row.status, "")
        limit = own(row.limit, language)
        text = f"{own(row.requirement, language)}{_colon(language)}{own(row.planned, language)}" + (
            f" [{limit}]" if limit else ""
        )
        if row.remedy:
            text += f"\n→ {own(row.remedy, language)}"
        grid = Table.grid(padding=(0, 1, 0, 0))
        for width in _WIDTHS[language]:
            grid.add_column(width=width, no_wrap=True)
        grid.add_column(overflow="fold")
        grid.add_row(Text(_status(row.status, language)), Text(own(row.clause, language)), Text(text), style=style)
        console.print(grid)
