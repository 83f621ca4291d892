"""The page: what stands in it. Its form is template.html.j2; drawings come from `plots` and `photos`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib.figure import Figure

from campaign.errors import TestrangeError
from evaluator.c10_1_grading import GRADE_ZH, GROUPS, INDICATORS, group_grades
from evaluator.camera_model import LENS_NAMES, lens_vector
from evaluator.report import bench_plots, photos, plots
from evaluator.report.style import GRADE_COLOURS, font_uri, jpeg_uri, style, svg_uri
from evaluator.report.words import HOW
from evaluator.results import Evaluation, build_results, plain, shown_decimals
from evaluator.score import Score, decimals

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
    if data is not None and (data.targets or data.sorties or data.plan is not None):
        out.append(
            _picture("Layout 布设", "Fields of view are drawn at the lowest design height.", lambda: plots.layout(data))
        )
    if data is not None and any(s.trajectory is not None for s in data.sorties):
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
    out += _bench_pictures(evaluation)
    if score is not None and score.items:
        caption = "Only a simulated campaign knows the truth."
        out.append(_picture("Score", caption, lambda: plots.truth_errors(score)))
    return out


def _bench_pictures(evaluation: Evaluation) -> list[Picture]:
    """Those of 8.2, 9.1 and 9.2 that the campaign has."""
    sphere, board, ranging = evaluation.sphere, evaluation.chessboard, evaluation.ranging
    out = []
    if sphere is not None and (sphere.stability_series or sphere.repeatability_series):
        caption = "Mean of the nine central pixels of each image. Shaded: ±1 SD. Dashed: the lamp's trend."
        out.append(_picture("Integrating sphere 积分球", caption, lambda: bench_plots.sphere_series(sphere)))
    if board is not None and (board.images or board.lens is not None):
        caption = "Corner as found to corner as projected, formula (19). A pattern in the means would be distortion left over."
        out.append(_picture("Chessboard residuals 重投影残差", caption, lambda: bench_plots.board_residuals(board)))
        caption = "9.2.2 d asks for the whole field at each distance."
        out.append(_picture("Coverage 视场覆盖", caption, lambda: bench_plots.coverage(board)))
        caption = "Where the lens puts a point against where it would stand without distortion."
        out.append(_picture("Distortion 畸变", caption, lambda: bench_plots.distortion_map(board)))
        caption = "Figures where |ρ| > 0.1. k1, k2 and k3 always correlate: their sum over the field is determined, not each alone."
        out.append(_picture("Camera correlations 内参相关系数", caption, lambda: bench_plots.lens_correlations(board)))
        caption = "Colour: distance of the board."
        out.append(_picture("Images of the chessboard 各影像误差", caption, lambda: bench_plots.image_errors(board)))
    if ranging is not None and ranging.panels:
        caption = (
            "True = measured + K₂ + R₂ · measured, formula (13); LiDAR minus total station, from the LiDAR's centre. "
            "Bars: standard deviation of the means of the scans and of the readings together."
        )
        out.append(_picture("Ranging line 测距误差", caption, lambda: bench_plots.ranging_errors(ranging)))
    return out


@dataclass(frozen=True, kw_only=True)
class ParameterTable:
    """Estimated parameters with their standard deviations: name, unit, estimate, std (None where unknown)."""

    title: str
    note: str
    rows: tuple[tuple[str, str, float, float | None], ...]


def _deviations(covariance: np.ndarray | None, n: int) -> list[float | None]:
    return [None] * n if covariance is None else [float(v) for v in np.sqrt(np.diag(covariance))]


def _parameter_tables(evaluation: Evaluation) -> list[ParameterTable]:
    """The camera's nine parameters by 9.2, K2 and R2 by 9.1."""
    out = []
    board, line = evaluation.chessboard, evaluation.ranging
    if board is not None and board.lens is not None:
        values = lens_vector(board.lens).tolist()
        rows = tuple(
            (n.removesuffix("_px"), "px" if n.endswith("_px") else "1", value, std)
            for n, value, std in zip(LENS_NAMES, values, _deviations(board.covariance, 9), strict=True)
        )
        note = f"{len(board.images)} images"
        note += f", {len(board.not_used)} not used" if board.not_used else ""
        note += "" if board.focus_distance_m is None else f"; lens set to {board.focus_distance_m:g} m"
        note += "" if board.f_number is None else f", f/{board.f_number:g}"
        note += ". The image's top left corner is (0, 0), the centre of its first pixel (0.5, 0.5)."
        out.append(ParameterTable(title="Camera 内方位元素与畸变参数", note=note, rows=rows))
    if line is not None and line.additive_constant_m is not None and line.multiplication_constant is not None:
        k_std, r_std = _deviations(line.covariance, 2)
        rows = (
            ("K₂, additive constant 加常数", "m", line.additive_constant_m, k_std),
            ("R₂, multiplication constant 乘常数", "1", line.multiplication_constant, r_std),
        )
        note = "true = measured + K₂ + R₂ · measured."
        out.append(ParameterTable(title="LiDAR ranging 激光雷达测距常数", note=note, rows=rows))
    return out


def _left_out(evaluation: Evaluation) -> list[str]:
    """Images and panels of benches and line that could not serve, with the reason."""
    out: list[str] = []
    if evaluation.sphere is not None:
        for series in (evaluation.sphere.stability_series, evaluation.sphere.repeatability_series):
            out += series.left_out if series is not None else ()
    for result in (evaluation.chessboard, evaluation.ranging):
        out += [f"{name}: {why}" for name, why in result.not_used.items()] if result is not None else []
    return [str(line) for line in plain(out, evaluation.root)]


def _indicator_cards(evaluation: Evaluation, results: Mapping[str, Any]) -> list[dict[str, Any]]:
    cards = []
    for i, row in INDICATORS.items():
        block = results["indicators"][i]
        cards.append(
            {
                "id": i,
                "row": row,
                "value": evaluation.indicator(i).value,
                "digits": shown_decimals(evaluation.indicator(i).value, row.unit),
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
        pictures = [replace(p, reason=plain(p.reason, evaluation.root)) for p in _pictures(evaluation, score)]
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
        diagnosis=results["diagnosis"],
        mounting_rows=_mounting_rows(results),
        parameters=_parameter_tables(evaluation),
        left_out=_left_out(evaluation),
        decimals=decimals,
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
