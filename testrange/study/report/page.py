"""study.html: one file that opens offline. What was varied, what came of it, with which uncertainty, and what failed."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2

import evaluator.report
from campaign.writing.atomic import complete_file
from evaluator.c10_1_grading import GRADE_ZH, INDICATORS
from evaluator.report.style import font_uri, style
from testrange.study.effects import Effects
from testrange.study.model import RUN_TIME, SAMPLED, Factor, Study
from testrange.study.plan import Plan
from testrange.study.report import figures
from testrange.study.report.says import sentences

MAX_TABLE_ROWS = 500
_FONT_PLACE = "/*font*/"
_CHINESE = "U+2E80-9FFF,U+F900-FAFF,U+FF00-FFEF"
Rows = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True)
class Picture:
    """One figure of the page."""

    name: str  # of its files
    title: str
    caption: str
    uri: str


def write_page(out: Path, plan: Plan, rows: Rows, effects: Sequence[Effects]) -> Path:
    """Writes figures/*.png, figures/*.svg and study.html."""
    study = plan.study
    with style():
        sections = [(e, sentences(study, e, rows), _pictures(out / "figures", study, rows, e)) for e in effects]
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([Path(__file__).parent, Path(evaluator.report.__file__).parent]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    done = [row for row in rows if row["status"] == "done"]
    page = environment.get_template("page.html.j2").render(
        font_place=_FONT_PLACE,
        study=study,
        factors=[(factor, _told(factor)) for factor in study.factor],
        sections=sections,
        rows=rows[:MAX_TABLE_ROWS],
        hidden=max(len(rows) - MAX_TABLE_ROWS, 0),
        count=len(rows),
        done=len(done),
        failed=[row for row in rows if row["status"] == "failed"],
        missing=sum(row["status"] == "missing" for row in rows),
        labels={point.id: point.labels for point in plan.points},
        geometries=len(plan.groups),
        seconds=sum(row[RUN_TIME] or 0.0 for row in done),
        responses=[e.response for e in effects if e.response != RUN_TIME],
        indicators=INDICATORS,
        grade_zh=GRADE_ZH,
        title_of=_title,
        number=number,
    )
    face = f"@font-face{{font-family:'Report SC';src:url({font_uri(page)}) format('woff');unicode-range:{_CHINESE}}}"
    target = out / "study.html"
    with complete_file(target) as work:
        work.write_bytes(page.replace(_FONT_PLACE, face, 1).encode())
    return target


def _title(effects: Effects, indicators: Mapping[str, Any]) -> str:
    """Name of a response for headings."""
    row = indicators.get(effects.response)
    return effects.response if row is None else f"{row.name_en} {row.symbol} {row.name_zh}"


def number(value: object) -> str:
    """Four digits."""
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _told(factor: Factor) -> str:
    """What a factor takes, for people."""
    if factor.range is not None:
        return f"{factor.range[0]:g} to {factor.range[1]:g}{', even by ratio' if factor.log else ''}"
    levels = [level.name for level in factor.level] or [
        f"{v:g}" if isinstance(v, float) else str(v) for v in factor.values or ()
    ]
    return ", ".join(levels)


def _pictures(folder: Path, study: Study, rows: Rows, effects: Effects) -> list[Picture]:
    """All figures of one response."""
    if effects.points < 2:
        return []
    stem = "".join(c if c.isalnum() else "_" for c in effects.response)
    out: list[Picture] = []

    def add(name: str, title: str, caption: str, drawn: Any) -> None:
        file = folder / f"{stem}-{name}"
        svg = figures.write_figure(file, drawn)
        heavy = len(svg) > 300_000  # thousands of dots: the picture of them is smaller
        kind, content = ("png", file.with_suffix(".png").read_bytes()) if heavy else ("svg+xml", svg)
        uri = f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
        out.append(Picture(name=file.name, title=title, caption=caption, uri=uri))

    if study.design in SAMPLED:
        if effects.indices:
            sobol = effects.indices[0].total is not None
            add(
                "indices",
                "Sobol indices" if sobol else "Elementary effects (Morris)",
                _INDICES[sobol],
                figures.indices(study, effects),
            )
        if effects.main:
            add(
                "effects",
                "Main effects",
                f"Straight line through all points; intervals at 95 % from {effects.interval_from}.",
                figures.main_effects(study, effects),
            )
        for factor in study.factor:
            add(
                f"over-{factor.name}",
                f"Over {factor.label or factor.name}",
                "Every point; line: mean of equally filled bins, band: its 95 % interval.",
                figures.scatter(rows, effects, factor),
            )
        return out
    return out + _of_levels(study, rows, effects, add)


_INDICES = {
    True: "Share of the response's variance: by the factor alone (first order), and with all its interactions (total). "
    "Intervals at 95 % by bootstrap.",
    False: "Mean size of the response's change when one factor moves (mu*), and how much that change depends on where "
    "(sigma). Intervals at 95 % by bootstrap.",
}


def _of_levels(study: Study, rows: Rows, effects: Effects, add: Any) -> list[Picture]:
    """Figures of a grid or a list."""
    many = [f for f in study.factor if len(figures.levels_of(rows, f)) > 1] or list(study.factor[:1])
    first, second = many[0], many[1] if len(many) > 1 and study.design == "grid" else None
    band = (
        f"Band: 95 % interval of the mean, noise from {effects.noise_freedom} degrees of freedom of replicates."
        if (effects.noise_std is not None)
        else "No band: there are no replicates."
    )
    if effects.response in INDICATORS:
        add(
            "grades",
            "Grade map",
            "Each cell is divided by the share of its points.",
            figures.grade_map(study, rows, effects.response, first, second),
        )
    if second is not None:
        add(
            "heat",
            "Mean over two factors",
            "Mean of all points of a cell.",
            figures.heat_map(rows, effects, first, second),
        )
        add(
            f"over-{first.name}",
            f"Over {first.label or first.name}",
            band,
            figures.curves(study, rows, effects, first, second),
        )
        add(
            f"over-{second.name}",
            f"Over {second.label or second.name}",
            band,
            figures.curves(study, rows, effects, second, first),
        )
    for factor in many[2:] if second is not None else many:
        add(
            f"over-{factor.name}",
            f"Over {factor.label or factor.name}",
            band,
            figures.curves(study, rows, effects, factor, None),
        )
    if effects.main and len(many) > 1 and study.design == "grid":
        add(
            "effects",
            "Main effects",
            f"Mean over all other factors; intervals at 95 % from {effects.interval_from}.",
            figures.main_effects(study, effects),
        )
    return []
