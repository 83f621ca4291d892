"""comparison.json, run_times.json and comparison.html. All but the run times and the page that shows them is the same for the
same campaigns and algorithms."""

from pathlib import Path
from typing import Any

import jinja2

import evaluator.report
from campaign.writing.atomic import complete_file
from evaluator.c10_1_grading import INDICATORS
from evaluator.report.style import font_uri, style, svg_uri
from evaluator.results import plain, write_json
from testrange.compare import figures
from testrange.compare.run import Comparison
from testrange.compare.statistics import BOOTSTRAP, NONE, Difference, Interval, T, same_for_all, summaries

_FONT_PLACE = "/*font*/"
_CHINESE = "U+2E80-9FFF,U+F900-FAFF,U+FF00-FFEF"


def comparison_block(comparison: Comparison) -> dict[str, Any]:
    """The contents of comparison.json, schema 1."""
    names = [c.name for c in comparison.contenders]
    block: dict[str, Any] = plain(
        {
            "schema": 1,
            "algorithms": [{"name": c.name, "is": c.told} for c in comparison.contenders],
            "campaigns": comparison.campaigns,
            "without_truth": comparison.without_truth,
            "runs": [
                {
                    "campaign": o.campaign,
                    "algorithm": o.contender,
                    "status": "failed" if o.reason else "done",
                    "reason": o.reason,
                    "failures": o.failures,
                    "calls": {slot: {"all": n, "failed": failed} for slot, (n, failed) in o.calls.items()},
                    "indicators": o.indicators,
                }
                for o in comparison.outcomes
            ],
            "errors": [vars(s) for s in summaries(comparison.outcomes, names)],
            "differences": [
                {
                    "quantity": d.quantity,
                    "unit": d.unit,
                    "first": d.first,
                    "second": d.second,
                    "campaigns": d.campaigns,
                    "items": d.items,
                    "rms": d.rms,
                    "absolute_error": _interval(d.absolute),
                    "squared_error": _interval(d.squared),
                    "method": d.method,
                }
                for d in comparison.differences
            ],
        }
    )
    return block


def _interval(found: Interval) -> dict[str, float | None]:
    return {"mean": found.mean, "low_95": found.low, "high_95": found.high}


def run_times_block(comparison: Comparison) -> dict[str, Any]:
    """Seconds of every run: they differ from one comparison to the next and so stand apart."""
    block: dict[str, Any] = plain(
        {
            "schema": 1,
            "runs": [
                {
                    "campaign": o.campaign,
                    "algorithm": o.contender,
                    "seconds": o.seconds,
                    "seconds_in_slots": o.slot_seconds,
                }
                for o in comparison.outcomes
            ],
        }
    )
    return block


def write_comparison(folder: Path, comparison: Comparison) -> None:
    """The three files."""
    write_json(folder / "comparison.json", comparison_block(comparison))
    write_json(folder / "run_times.json", run_times_block(comparison))
    with complete_file(folder / "comparison.html") as work:
        work.write_bytes(render_page(comparison).encode())


def render_page(comparison: Comparison) -> str:
    """One HTML text that opens offline: failures, errors, differences, run times."""
    names = [c.name for c in comparison.contenders]
    alike = same_for_all(comparison.outcomes)
    rows = [r for r in summaries(comparison.outcomes, names) if r.quantity not in alike]
    units = {r.quantity: r.unit for r in rows}
    pairs: dict[tuple[str, str], list[Difference]] = {}
    for d in comparison.differences:
        if d.quantity not in alike:
            pairs.setdefault((d.first, d.second), []).append(d)
    with style():
        errors = [
            (q, svg_uri(figures.error_figure(q, unit, comparison.outcomes, names)))
            for q, unit in units.items()
            if any(r.quantity == q and r.items > 1 for r in rows)
        ]
        told = [
            (first, second, found, svg_uri(figures.difference_figure(found, first, second)))
            for (first, second), found in pairs.items()
        ]
        times = svg_uri(figures.time_figure(comparison.outcomes, names))
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([Path(__file__).parent, Path(evaluator.report.__file__).parent]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("page.html.j2").render(
        font_place=_FONT_PLACE,
        comparison=comparison,
        names=names,
        rows=rows,
        alike=sorted(alike),
        errors=errors,
        pairs=told,
        times=times,
        failed=[o for o in comparison.outcomes if o.reason or o.failures],
        indicators=INDICATORS,
        number=number,
        letters={T: "t", BOOTSTRAP: "b", NONE: ""},
    )
    face = f"@font-face{{font-family:'Report SC';src:url({font_uri(page)}) format('woff');unicode-range:{_CHINESE}}}"
    return page.replace(_FONT_PLACE, face, 1)


def number(value: float | None) -> str:
    """Three significant digits, without exponent where that is short."""
    if value is None:
        return "–"
    if value == 0.0:
        return "0"
    size = abs(value)
    return f"{value:.3g}" if not 1e-4 <= size < 1e5 else f"{value:#.3g}".rstrip(".")
