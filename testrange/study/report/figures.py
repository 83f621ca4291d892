"""Drawings of a study. Each is a matplotlib figure; `write_figure` makes PNG and SVG of it, the same bytes for the same table."""

import io
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from scipy import stats

from campaign.writing.atomic import complete_file
from evaluator.c10_1_grading import GRADE_ZH, INDICATORS
from evaluator.report.style import GRADE_COLOURS, INK, SORTIE_COLOURS, figure
from testrange.study.effects import GRADES, Effects, cell_means, grade_shares
from testrange.study.model import Factor, Study, Value

Rows = Sequence[Mapping[str, Any]]
PNG_DPI = 160
FAILED_COLOUR = "#ffffff"
GRADE_WORDS = {g: f"{GRADE_ZH[g]} {g.replace('_', ' ')}" for g in GRADE_COLOURS} | {"failed": "simulation failed"}
_SHORT = {
    "excellent": "优",
    "good": "良",
    "fair": "一般",
    "ungraded": "超出",
    "not_measured": "未测",
    "failed": "failed",
}
_MAX_LINES = 6  # curves in one figure
_MAX_CELLS = 30  # levels of one factor that are written out; more are drawn, every k-th is named
_BINS = 24  # of a scatter's mean, at most


def write_figure(place: Path, drawn: Figure) -> bytes:
    """PNG and SVG beside each other; the SVG's bytes."""
    for suffix, options in (
        (".png", {"dpi": PNG_DPI, "metadata": {"Software": None}}),
        (".svg", {"metadata": {"Date": None, "Creator": None}}),
    ):
        buffer = io.BytesIO()
        drawn.savefig(buffer, format=suffix[1:], **options)
        with complete_file(place.with_suffix(suffix)) as work:
            work.write_bytes(buffer.getvalue())
    return place.with_suffix(".svg").read_bytes()


def response_title(effects: Effects) -> str:
    """Name and unit, for axes."""
    name = _plain(effects.response)
    if effects.response in INDICATORS:
        row = INDICATORS[effects.response]
        name = f"{row.name_en} {_symbol(row.symbol)}"
    return f"{name} [{effects.unit}]" if effects.unit else name


def _plain(text: str) -> str:
    """A user's text: $ begins no formula."""
    return text.replace("$", r"\$")


def _symbol(symbol: str) -> str:
    return f"${symbol.replace('_', '_{', 1)}}}$" if "_" in symbol else symbol


def levels_of(rows: Rows, factor: Factor) -> list[Value]:
    """Levels of a factor in the order of the design."""
    return list(dict.fromkeys(row[factor.name] for row in rows))


def is_number(levels: Sequence[Value]) -> bool:
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in levels)


def curves(study: Study, rows: Rows, effects: Effects, factor: Factor, by: Factor | None) -> Figure:
    """Response over one factor: a line for each level of another, or one for all, each with its 95 % band from replicates."""
    drawn = figure(5.6, 3.7)
    axes = drawn.subplots()
    levels = levels_of(rows, factor)
    if is_number(levels):  # whatever their order in the study file, the line runs from left to right
        levels = sorted(levels, key=lambda v: float(v))  # type: ignore[arg-type]
    x = _places(axes, factor, levels)
    groups: list[Value | None] = [None] if by is None else [*levels_of(rows, by)[:_MAX_LINES]]
    names = [factor.name] if by is None else [factor.name, by.name]
    cells = cell_means(rows, effects.response, names)
    for k, group in enumerate(groups):
        colour = SORTIE_COLOURS[k % len(SORTIE_COLOURS)]
        found = [cells.get((level,) if group is None else (level, group)) for level in levels]
        mean = np.array([c[0] if c else math.nan for c in found])
        half = np.array([_half(c, effects) for c in found])
        label = "" if by is None else f"{_plain(by.label or by.name)} {_text(group)} {_plain(by.unit)}".strip()
        axes.fill_between(x, mean - half, mean + half, color=colour, alpha=0.15, linewidth=0)
        axes.plot(x, mean, "o-", color=colour, markersize=4, linewidth=1.4, label=label)
    axes.set_ylabel(response_title(effects))
    _grade_lines(axes, effects)
    if by is not None:
        axes.legend()
    return drawn


def scatter(rows: Rows, effects: Effects, factor: Factor) -> Figure:
    """Response over one sampled factor: every point, and the mean in bins with its 95 % band."""
    drawn = figure(5.6, 3.7)
    axes = drawn.subplots()
    have = [row for row in rows if row[effects.response] is not None]
    x = np.array([float(row[factor.name]) for row in have])
    y = np.array([float(row[effects.response]) for row in have])
    if factor.log:
        axes.set_xscale("log")
    axes.plot(x, y, ".", color="#8a93a0", markersize=3 if len(x) < 500 else 1.5, rasterized=len(x) > 2000)
    place = np.log(x) if factor.log else x
    edges = np.quantile(place, np.linspace(0.0, 1.0, min(_BINS, max(len(x) // 8, 1)) + 1))
    middle, mean, half = [], [], []
    for low, high in itertools.pairwise(edges):
        inside = (place >= low) & (place <= high)
        if inside.sum() >= 3:
            middle.append(float(np.mean(place[inside])))
            mean.append(float(np.mean(y[inside])))
            half.append(
                float(stats.t.ppf(0.975, inside.sum() - 1) * np.std(y[inside], ddof=1) / math.sqrt(inside.sum()))
            )
    at = np.exp(middle) if factor.log else np.array(middle)
    m, h = np.array(mean), np.array(half)
    axes.fill_between(at, m - h, m + h, color=SORTIE_COLOURS[0], alpha=0.25, linewidth=0)
    axes.plot(at, m, "-", color=SORTIE_COLOURS[0], linewidth=1.6)
    axes.set_xlabel(_plain(factor.title))
    axes.set_ylabel(response_title(effects))
    return drawn


def main_effects(study: Study, effects: Effects) -> Figure:
    """Level means of all factors side by side on one scale, with 95 % intervals."""
    count = len(effects.main)
    if not effects.main[0].levels:
        return _bars(
            [m.factor for m in effects.main],
            [[m.effect for m in effects.main]],
            [[(m.high_95 - m.low_95) / 2 for m in effects.main]],
            [""],
            f"change over the range: {response_title(effects)}",
            study,
        )
    drawn = figure(max(2.0 * count + 1.2, 4.2), 3.4)
    panels = np.atleast_1d(drawn.subplots(1, count, sharey=True))
    for axes, effect in zip(panels, effects.main):
        factor = next(f for f in study.factor if f.name == effect.factor)
        x = _places(axes, factor, [level.level for level in effect.levels])
        mean = np.array([level.mean for level in effect.levels])
        ends = np.array([[level.mean - level.low_95, level.high_95 - level.mean] for level in effect.levels]).T
        axes.errorbar(x, mean, yerr=ends, fmt="o-", color=SORTIE_COLOURS[0], markersize=4, linewidth=1.4, capsize=3)
    panels[0].set_ylabel(response_title(effects))
    return drawn


def indices(study: Study, effects: Effects) -> Figure:
    """Sobol: first and total; Morris: mu* and sigma."""
    names = [i.factor for i in effects.indices]
    if effects.indices[0].total is not None:
        series = [[i.first or 0.0 for i in effects.indices], [i.total or 0.0 for i in effects.indices]]
        ends = [[i.first_95 or 0.0 for i in effects.indices], [i.total_95 or 0.0 for i in effects.indices]]
        return _bars(names, series, ends, ["first order", "total"], "share of the variance", study, zero=True)
    series = [[i.mu_star or 0.0 for i in effects.indices], [i.sigma or 0.0 for i in effects.indices]]
    ends = [[i.mu_star_95 or 0.0 for i in effects.indices], [0.0] * len(names)]
    return _bars(
        names,
        series,
        ends,
        ["μ* (strength)", "σ (not linear, or together with others)"],
        response_title(effects),
        study,
    )


def heat_map(rows: Rows, effects: Effects, across: Factor, up: Factor) -> Figure:
    """Mean of a response over two factors, written into the cells."""
    x, y = levels_of(rows, across), levels_of(rows, up)
    cells = cell_means(rows, effects.response, [across.name, up.name])
    field = np.array([[cells[(a, b)][0] if (a, b) in cells else math.nan for a in x] for b in y])
    drawn, axes = _board(x, y, across, up)
    shown = axes.imshow(field, origin="lower", aspect="auto", cmap="viridis")
    low, high = (float(np.nanmin(field)), float(np.nanmax(field))) if np.isfinite(field).any() else (0.0, 1.0)
    for (j, i), value in np.ndenumerate(field if max(field.shape) <= _MAX_CELLS else field[:0]):
        dark = np.isfinite(value) and (value - low) < 0.55 * (high - low)
        text = "–" if not np.isfinite(value) else f"{value:.3g}"
        axes.text(i, j, text, ha="center", va="center", fontsize=8, color="white" if dark else INK)
    drawn.colorbar(shown, ax=axes, label=response_title(effects))
    return drawn


def grade_map(study: Study, rows: Rows, indicator: str, across: Factor, up: Factor | None) -> Figure:
    """Which grade at which level of two factors: each cell is divided by the share of its points that have a grade."""
    x = levels_of(rows, across)
    y: list[Value] = [""] if up is None else levels_of(rows, up)
    names = [across.name] if up is None else [across.name, up.name]
    shares = grade_shares(rows, indicator, names)
    drawn, axes = _board(x, y, across, up)
    for i, a in enumerate(x):
        for j, b in enumerate(y):
            start = i - 0.47
            for grade, share in shares.get((a,) if up is None else (a, b), {}).items():
                _grade_cell(axes, grade, share, start, j, told=max(len(x), len(y)) <= _MAX_CELLS)
                start += 0.94 * share
    axes.set_xlim(-0.5, len(x) - 0.5)
    axes.set_ylim(-0.5, len(y) - 0.5)
    axes.grid(False)
    seen = [g for g in GRADES if any(g in s for s in shares.values())]
    handles = [
        Patch(facecolor=_colour(g), edgecolor="#6b7280", label=GRADE_WORDS[g], hatch="///" if g == "failed" else None)
        for g in seen
    ]
    drawn.legend(handles=handles, loc="outside lower center", ncols=3)
    row = INDICATORS[indicator]
    axes.set_title(f"{row.name_en} {_symbol(row.symbol)}: grade by table 3")
    return drawn


def _grade_cell(axes: Axes, grade: str, share: float, start: float, level: int, told: bool) -> None:
    failed = grade == "failed"
    axes.add_patch(
        Rectangle(
            (start, level - 0.45),
            0.94 * share,
            0.9,
            facecolor=_colour(grade),
            edgecolor="#6b7280" if failed else "white",
            linewidth=0.8,
            hatch="///" if failed else None,
        )
    )
    if share >= 0.2 and told:
        text = _SHORT[grade] if share == 1.0 else f"{_SHORT[grade]}\n{100.0 * share:.0f} %"
        axes.text(
            start + 0.47 * share, level, text, ha="center", va="center", fontsize=8, color=INK if failed else "white"
        )


def _colour(grade: str) -> str:
    found: dict[str, str] = {str(k): v for k, v in GRADE_COLOURS.items()}
    return found.get(grade, FAILED_COLOUR)


def _board(x: Sequence[Value], y: Sequence[Value], across: Factor, up: Factor | None) -> tuple[Figure, Axes]:
    """Axes whose cells are levels."""
    wide, high = (min(len(levels), _MAX_CELLS) for levels in (x, y))
    drawn = figure(max(1.0 * wide + 2.2, 4.4), max(0.62 * high + 1.6, 2.2))
    axes = drawn.subplots()
    axes.set_xticks(*_named(x))
    axes.set_yticks(*_named(y))
    axes.set_xlabel(_plain(across.title))
    axes.set_ylabel("" if up is None else _plain(up.title))
    axes.grid(False)
    return drawn, axes


def _half(cell: tuple[float, float, int] | None, effects: Effects) -> float:
    """Half width of the 95 % interval of a cell's mean, by the noise pooled over all cells where it is known."""
    if cell is None or effects.noise_std is None:
        return math.nan
    return float(stats.t.ppf(0.975, effects.noise_freedom)) * effects.noise_std / math.sqrt(cell[2])


def _places(axes: Axes, factor: Factor, levels: Sequence[Value]) -> np.ndarray:
    """Where levels stand on the x axis: numbers at their value, names side by side."""
    axes.set_xlabel(_plain(factor.title))
    if is_number(levels):
        if factor.log:
            axes.set_xscale("log")
        x = np.array(levels, dtype=float)
        if len(levels) <= 8:
            axes.set_xticks(x, [_text(v) for v in levels])
            axes.set_xticks([], minor=True)
        return x
    axes.set_xticks(*_named(levels), rotation=20 if len(levels) > 4 else 0)
    return np.arange(len(levels), dtype=float)


def _named(levels: Sequence[Value]) -> tuple[range, list[str]]:
    """Places and names of the levels, or of every k-th of many."""
    places = range(0, len(levels), math.ceil(len(levels) / _MAX_CELLS) or 1)
    return places, [_text(levels[k]) for k in places]


def _text(value: Value | None) -> str:
    return f"{value:g}" if isinstance(value, float) else _plain(str(value))


def _grade_lines(axes: Axes, effects: Effects) -> None:
    """Limits of table 3 that lie within the drawing."""
    if effects.response not in INDICATORS:
        return
    row = INDICATORS[effects.response]
    low, high = axes.get_ylim()
    for grade, limit in zip(("excellent", "good", "fair"), row.bounds):
        if low < limit < high:
            axes.axhline(limit, color=_colour(grade), linewidth=1.0, linestyle="--")
            axes.annotate(
                f"{_SHORT[grade]} {limit:g}",
                (1.0, limit),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="bottom",
                fontsize=7.5,
                color=_colour(grade),
            )


def _bars(
    names: Sequence[str],
    series: Sequence[Sequence[float]],
    ends: Sequence[Sequence[float]],
    labels: Sequence[str],
    title: str,
    study: Study,
    zero: bool = False,
) -> Figure:
    """Bars of all factors side by side, with 95 % intervals."""
    drawn = figure(max(1.0 * len(names) + 2.0, 4.4), 3.4)
    axes = drawn.subplots()
    wide = 0.8 / len(series)
    for k, (values, half, label) in enumerate(zip(series, ends, labels)):
        x = np.arange(len(names)) + (k - 0.5 * (len(series) - 1)) * wide
        axes.bar(
            x,
            values,
            0.92 * wide,
            color=SORTIE_COLOURS[k],
            label=label,
            yerr=half if any(half) else None,
            error_kw={"elinewidth": 1.0, "capsize": 3, "ecolor": INK},
        )
    titles = {f.name: f.label or f.name for f in study.factor}
    axes.set_xticks(range(len(names)), [_plain(titles[n]) for n in names], rotation=20 if len(names) > 5 else 0)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set_ylabel(title)
    if zero:
        axes.set_ylim(min(-0.05, axes.get_ylim()[0]), max(1.05, axes.get_ylim()[1]))
    if any(labels):
        axes.legend()
    return drawn
