"""The page: one HTML text in one language. Its contents come from `sections`, `pictures`, `overlays`; its form: template.html.j2.

No request leaves the page and nothing in it runs: there is no script, and a content security policy says so. It does not depend
on the time or the place of its making.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import jinja2

from evaluator.documents.cells import clean
from evaluator.documents.handbooks_common import blunder
from evaluator.documents.model import Language
from evaluator.documents.phrases import time_in_words, translated
from evaluator.report import sections
from evaluator.report.overlays import shots
from evaluator.report.pictures import pictures
from evaluator.report.style import GRADE_COLOURS, font_uri, style
from evaluator.report.terms import parameter
from evaluator.report.texts import Texts
from evaluator.results import Evaluation, build_results, plain
from evaluator.scores.score import Score, decimals

_FONT_PLACE = "/*font*/"
_CHINESE = "U+2E80-9FFF,U+F900-FAFF,U+FF00-FFEF"


_LONGEST = 2_000  # characters of one text of a campaign; ours have some hundreds


def _shown(value: object) -> object:
    """What stands in the page for a value: texts without control and direction characters, cut where they have no end."""
    if not isinstance(value, str) or hasattr(value, "__html__") or value.startswith("data:"):
        return value
    return clean(value, _LONGEST)


def _parts(evaluation: Evaluation, score: Score | None, language: Language) -> Iterator[str]:
    """The page piece by piece: with its pictures it has megabytes, and twice as many in memory where a text is Chinese."""
    t = Texts(language)
    results = build_results(evaluation)
    counts: dict[str, int] = {}
    for row in evaluation.conformity:
        counts[row.status] = counts.get(row.status, 0) + 1
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        finalize=_shown,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    with style():
        album = {
            section: [replace(p, reason=plain(p.reason, evaluation.root)) for p in page]
            for section, page in pictures(evaluation, results, score, t).items()
        }
    images = [replace(s, reason=plain(s.reason, evaluation.root)) for s in shots(evaluation)]
    content = {
        "t": t,
        "font_place": _FONT_PLACE,
        "evaluation": evaluation,
        "begun": time_in_words(evaluation.data.manifest.start_time, language) if evaluation.data else "",
        "manifest": evaluation.data.manifest if evaluation.data else None,
        "foreign": sorted(results.get("algorithms", {}).items()),
        "cards": sections.indicator_cards(evaluation, results, t),
        "groups": sections.group_rows(evaluation, t),
        "data": sections.data_rows(evaluation, t),
        "conformity": [
            {**r, **{key: translated(str(r[key]), language) for key in ("requirement", "measured", "limit")}}
            for r in results["conformity"]
        ],
        "counts": counts,
        "problems": results["problems"],
        "mounting": results["mounting"],
        "mounting_reason": translated(str(results["mounting"].get("reason") or ""), language),
        "mounting_rows": sections.mounting_rows(results, t),
        "three_ways": sections.three_ways(results, t),
        "inseparable": sections.inseparable(results, t),
        "stated_rows": sections.stated_rows(results, t),
        "closure_rows": sections.closure_rows(results, t),
        "clock_rows": sections.clock_rows(results, t),
        "board_rows": sections.board_rows(results, t),
        "diagnosis": results["diagnosis"],
        "parameters": sections.parameter_tables(evaluation, t),
        "left_out": sections.left_out(evaluation),
        "decimals": decimals,
        "name": lambda text: parameter(text, language),
        "words": lambda text: blunder(str(text or ""), language),
        "number": lambda value: sections.number(value, t),
        "score": score,
        "album": album,
        "images": images,
        "colours": GRADE_COLOURS,
    }
    template = environment.get_template("template.html.j2")
    characters = frozenset().union(*map(frozenset, template.generate(content)))
    face = (
        f"@font-face{{font-family:'Report SC';src:url({font_uri(characters)}) format('woff');unicode-range:{_CHINESE}}}"
    )
    for part in template.generate(content):
        yield str.replace(part, _FONT_PLACE, face, 1)  # a piece's own `replace` would escape it


def write_report(path: Path, evaluation: Evaluation, score: Score | None = None, language: Language = "zh") -> None:
    """Writes report.html.

    Parameters
    ----------
    path : Path
        File to write.
    evaluation : Evaluation
        With `data`, the campaign as read; without it the pictures that need the campaign are left out.
    score : Score, optional
        Only for a simulated campaign that was scored.
    language : "zh" | "en"
        Of headings, words and captions; numbers are the same. What the evaluator says in records and reasons is English.
    """
    with path.open("wb") as file:
        for part in _parts(evaluation, score, language):
            file.write(part.encode())
