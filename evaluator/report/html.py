"""The page: what stands in it. Its form is template.html.j2; drawings come from `plots` and `photos`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
from matplotlib.figure import Figure

from campaign.errors import TestrangeError
from evaluator.c10_1_grading import GRADE_ZH, GROUPS, INDICATORS, group_grades
from evaluator.report import photos, plots
from evaluator.report.style import GRADE_COLOURS, font_uri, jpeg_uri, style, svg_uri
from evaluator.report.words import HOW
from evaluator.results import Evaluation, build_results
from evaluator.score import Score

_FONT_PLACE = "/*font*/"


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A drawing as a data URI, or the reason why there is none."""

    title: str
    caption: str
    uri: str | None
    wide: bool = False
    reason: str = ""


def _number(value: object) -> str:
    """A figure or a short text as it stands in a cell."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.5g}"
    return str(value)


def _companions(value: Any, prefix: str = "") -> list[tuple[str, str]]:
    """Nested companions as lines of name and value; lists longer than 8 become their length."""
    if isinstance(value, Mapping):
        return [pair for k, v in value.items() for pair in _companions(v, f"{prefix} › {k}" if prefix else str(k))]
    name = prefix.replace("_", " ")
    if isinstance(value, list):
        if len(value) > 8 or any(isinstance(v, list | dict) for v in value):
            return [(name, f"{len(value)} entries, in results.json")]
        return [(name, ", ".join(_number(v) for v in value))]
    return [(name, _number(value))]


def _picture(
    title: str, caption: str, draw: Callable[[], Figure | None], *, dpi: float = 0.0, wide: bool = False
) -> Picture:
    """Draws; an error that is the input's fault becomes the picture's reason."""
    try:
        drawn = draw()
        if drawn is None:
            return Picture(title=title, caption=caption, uri=None, reason="nothing was observed for it")
        uri = jpeg_uri(drawn, dpi) if dpi else svg_uri(drawn)
    except TestrangeError as error:
        return Picture(title=title, caption=caption, uri=None, reason=str(error))
    return Picture(title=title, caption=caption, uri=uri, wide=wide)


def _photographs(evaluation: Evaluation) -> list[Picture]:
    """One annotated image a sortie, and zooms."""
    data = evaluation.data
    out: list[Picture] = []
    loaded: list[photos.Photo] = []
    if data is None:
        return out
    for sortie, image in photos.choose_images(evaluation):
        title = f"Sortie {sortie}, {image}"
        try:
            photo = photos.load_photo(data, sortie, image)
        except TestrangeError as error:
            out.append(Picture(title=title, caption="", uri=None, reason=str(error)))
            continue
        loaded.append(photo)
        caption = (
            "Yellow: regions and centres of marks as found. Red crosses: vertices of the LiDAR's face planes, projected with the "
            "adjusted mounting. Blue: regions of the reference panels."
        )
        out.append(_picture(title, caption, lambda p=photo: photos.annotated(p, evaluation), dpi=192, wide=True))  # type: ignore[misc]
    if loaded:
        caption = "Ordinary residuals first, then the greatest. Circle: mark as found; cross: LiDAR vertex projected."
        out.append(_picture("Zooms", caption, lambda: photos.zooms(loaded, evaluation), dpi=200))
    return out


def _pictures(evaluation: Evaluation, score: Score | None) -> list[Picture]:
    data = evaluation.data
    out = []
    if data is not None:
        out.append(
            _picture("Layout 布设", "Fields of view are drawn at the lowest design height.", lambda: plots.layout(data))
        )
        out.append(_picture("Flight profile 航高与航速", "Strips are shaded.", lambda: plots.profile(evaluation, data)))
    out += _photographs(evaluation)
    if evaluation.waveforms:
        caption = "Dots: samples of the digitiser. Line: Gaussian decomposition."
        out.append(_picture("Waveforms 波形", caption, lambda: plots.waveforms(evaluation.waveforms)))
    if evaluation.panels:
        out.append(_picture("Reflectance 反射率", "One point a panel.", lambda: plots.reflectance(evaluation)))
    if evaluation.residuals:
        caption = "Mark as found to LiDAR vertex as projected, formula (24)."
        out.append(_picture("Residuals 标定误差", caption, lambda: plots.residual_vectors(evaluation)))
    if evaluation.mounting is not None:
        caption = (
            "Figures where |ρ| > 0.3. Beyond 0.95 inside one sensor: the flight does not tell the two apart; "
            "between the sensors: the navigation they share."
        )
        out.append(_picture("Correlations 相关系数", caption, lambda: plots.correlations(evaluation)))
    if score is not None and score.items:
        caption = "Only a simulated campaign knows the truth."
        out.append(_picture("Score", caption, lambda: plots.truth_errors(score)))
    return out


def _indicator_cards(evaluation: Evaluation, results: Mapping[str, Any]) -> list[dict[str, Any]]:
    cards = []
    for i, row in INDICATORS.items():
        block = results["indicators"][i]
        cards.append(
            {
                "id": i,
                "row": row,
                "value": evaluation.indicator(i).value,
                "digits": 3 if row.unit == "pixel" else 2,
                "grade": evaluation.grade(i),
                "grade_zh": block["grade_zh"],
                "block": block,
                "companions": _companions(block["companions"]),
                "how": HOW[i],
                "better": "≥" if row.higher_is_better else "≤",
            }
        )
    return cards


def _mounting_rows(results: Mapping[str, Any]) -> list[dict[str, Any]]:
    block = results["mounting"]
    if block.get("status") != "measured":
        return []
    weak = {w["name"]: w for w in block["not_determined"]}
    prior = block["prior_std"] or [None] * len(block["names"])
    rows = [
        {"name": n, "unit": u, "estimate": e, "std": s, "prior": p, "weak": weak.get(n)}
        for n, u, e, s, p in zip(block["names"], block["units"], block["estimates"], block["std"], prior)
    ]
    relative = block["camera_from_lidar"]
    return rows + [
        {"name": n, "unit": u, "estimate": e, "std": s, "prior": None, "weak": None}
        for n, u, e, s in zip(relative["names"], relative["units"], relative["estimates"], relative["std"])
    ]


def render_report(evaluation: Evaluation, score: Score | None) -> str:
    """The report as one HTML text: no request leaves it, no date of its making stands in it."""
    results = build_results(evaluation)
    grades = evaluation.grades()
    groups = group_grades(grades)
    counts: dict[str, int] = {}
    for row in evaluation.conformity:
        counts[row.status] = counts.get(row.status, 0) + 1
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=jinja2.StrictUndefined
    )
    with style():
        pictures = _pictures(evaluation, score)
    page = environment.get_template("template.html.j2").render(
        font_place=_FONT_PLACE,
        evaluation=evaluation,
        manifest=evaluation.data.manifest if evaluation.data else None,
        cards=_indicator_cards(evaluation, results),
        groups=[(g, groups[g.id], GRADE_ZH[groups[g.id]]) for g in GROUPS],
        conformity=results["conformity"],
        amiss=[r for r in results["conformity"] if r["status"] in ("fail", "warning")],
        counts=counts,
        problems=results["problems"],
        mounting=results["mounting"],
        mounting_rows=_mounting_rows(results),
        score=score,
        pictures=pictures,
        colours=GRADE_COLOURS,
        number=_number,
    )
    chinese = "U+2E80-9FFF,U+F900-FAFF,U+FF00-FFEF"
    face = f"@font-face{{font-family:'Report SC';src:url({font_uri(page)}) format('woff');unicode-range:{chinese}}}"
    return page.replace(_FONT_PLACE, face, 1)


def write_report(path: Path, evaluation: Evaluation, score: Score | None = None) -> None:
    """Writes report.html.

    Parameters
    ----------
    path : Path
        File to write.
    evaluation : Evaluation
        With `data`, the campaign as read; without it the pictures that need the campaign are left out.
    score : Score, optional
        Only for a simulated campaign that was scored.
    """
    path.write_bytes(render_report(evaluation, score).encode())
