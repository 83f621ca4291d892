"""Files of a set of reference pairs: pairs.json, one table for each formula, a card. The same bytes each time; no date."""

import csv
import hashlib
import io
import json
from collections.abc import Sequence
from pathlib import Path

from campaign.progress import Report, silent
from campaign.writing.atomic import complete_folder
from testrange.pairs.model import DIGITS, PAIRS_FILE, SCHEMA, Numbers, Pair, PairsError, plain

NAME = "Reference pairs for GB/T 41450-2022 and the patent's method"
LICENCE = (
    "CC0 1.0: numbers of no author; use them for whatever you like (https://creativecommons.org/publicdomain/zero/1.0/)"
)
_KIND_TEXTS = {
    "ordinary": "as a campaign gives them",
    "boundary": "fewest values, grade limits, exact results",
    "ill-conditioned": "where a careless algorithm loses its digits",
    "published": "appendix B of the standard, IUGG 1999",
}


def compute_pairs(progress: Report = silent, clauses: Sequence[str] = ()) -> tuple[Pair, ...]:
    """Every pair, from the formulas: about ten seconds, nearly all of it for the adjustments of 9.2, 9.3 and the patent.

    Parameters
    ----------
    progress : callable
        Called with ("pairs", families done, families).
    clauses : sequence of str
        Beginnings of clauses, "8" or "9.1.2", or "patent"; all when empty.

    Raises
    ------
    PairsError
        A clause that has no formula.
    """
    from testrange.pairs.clauses import FAMILIES

    known = [clause for clause, _ in FAMILIES]
    for wanted in clauses:
        if not any(_within(clause, wanted) for clause in known):
            raise PairsError("has no formula", where=f"clause {wanted}", expected=", ".join(known))
    chosen = [f for clause, f in FAMILIES if not clauses or any(_within(clause, wanted) for wanted in clauses)]
    out: list[Pair] = []
    for i, family in enumerate(chosen):
        progress("pairs", i, len(chosen))
        out += family()
    progress("pairs", len(chosen), len(chosen))
    return tuple(out)


def _within(clause: str, wanted: str) -> bool:
    """Whether "9.1.2" is of "9.1"."""
    return f"{clause}.".startswith(f"{wanted}.")


def write_pairs(pairs: Sequence[Pair], folder: Path, *, replace: bool = False) -> None:
    """pairs.json, tables/*.csv, README.md and SHA256SUMS into a folder that appears complete or not at all."""
    files = {PAIRS_FILE: _json(pairs), "answers_template.json": _template(pairs)}
    for formula in dict.fromkeys(pair.formula for pair in pairs):
        files[f"tables/{_file_name(formula)}.csv"] = _table([p for p in pairs if p.formula == formula])
    files["README.md"] = _card(pairs)
    sums = "".join(f"{hashlib.sha256(text.encode()).hexdigest()}  {name}\n" for name, text in sorted(files.items()))
    with complete_folder(folder, replace=replace) as work:
        for name, text in {**files, "SHA256SUMS": sums}.items():
            (work / name).parent.mkdir(exist_ok=True)
            (work / name).write_bytes(text.encode())


def _json(pairs: Sequence[Pair]) -> str:
    content = {
        "schema": SCHEMA,
        "name": NAME,
        "digits": DIGITS,
        "licence": LICENCE,
        "pairs": [plain(pair) for pair in pairs],
    }
    return json.dumps(content, ensure_ascii=False, indent=1) + "\n"


def _template(pairs: Sequence[Pair]) -> str:
    return json.dumps({pair.id: None for pair in pairs}, indent=1) + "\n"


def _file_name(formula: str) -> str:
    return "formula_" + "".join(
        c if c.isalnum() or c == "-" else "" for c in formula.replace(".", "-").replace(" ", "-")
    )


def _table(pairs: Sequence[Pair]) -> str:
    """One row a number: spreadsheets keep 15 digits, which bring every input back to the same double."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(["pair", "role", "name", "index", "unit", "value", "tolerance", "meaning"])
    for pair in pairs:
        for given in pair.inputs:
            for index, value in _numbered(given.value):
                rows.writerow([pair.id, "input", given.name, index, given.unit, value, "", given.meaning])
        for result in pair.results:
            rows.writerow([pair.id, "result", result.name, "", result.unit, result.value, result.tolerance, ""])
        for name, values in pair.mistakes.items():
            for result, value in zip(pair.results, values, strict=True):
                rows.writerow([pair.id, "mistake", result.name, "", result.unit, value, "", name])
    return out.getvalue()


def _numbered(value: Numbers) -> list[tuple[str, str]]:
    if isinstance(value, str):
        return [("", value)]
    out = []
    for i, part in enumerate(value, start=1):
        if isinstance(part, str):
            out.append((str(i), part))
        else:
            out += [(f"{i} {j}", x) for j, x in enumerate(part, start=1)]
    return out


def _card(pairs: Sequence[Pair]) -> str:
    lines = [
        f"# {NAME}",
        "",
        f"{len(pairs)} pairs of inputs and results, {DIGITS} digits each, for the formulas listed below: of GB/T 41450-2022, and",
        "steps S3 to S7 of the patent on camera mounting errors. An evaluator is tested with them without image or point cloud.",
        "",
        "* How made: the formulas computed with mpmath at 60 digits from the text of the standard; nothing of the evaluator that",
        "  `testrange` also holds took part. Where the text leaves something open, the pair's statement says how it is read.",
        "* Inputs are doubles written out in full: exact when read in double precision, and when a spreadsheet cuts them to 15",
        "  digits they come back to the same doubles.",
        "* Results are rounded once, to 30 digits. Each has its own tolerance in its own unit; `tolerance_why` says where from.",
        f"* Licence: {LICENCE}.",
        "* Checksums: `SHA256SUMS` (check with `sha256sum -c SHA256SUMS`).",
        "",
        "`pairs.json` holds all; `tables/` the same numbers, one table a formula. Put your own results into a copy of",
        "`answers_template.json` (a number, or a list in the order of the pair's `results`; `null` counts as missing) and run",
        "`testrange pairs verify ANSWERS.json --pairs DIR`.",
        "",
        "| formula | pairs | " + " | ".join(_KIND_TEXTS) + " | greatest condition |",
        "|---|---|" + "---|" * (len(_KIND_TEXTS) + 1),
    ]
    for formula in dict.fromkeys(pair.formula for pair in pairs):
        own = [p for p in pairs if p.formula == formula]
        count = [sum(p.kind.replace("_", "-") == kind for p in own) for kind in _KIND_TEXTS]
        worst = max(float(p.condition) for p in own)
        lines.append(f"| {formula} | {len(own)} | " + " | ".join(str(c or "") for c in count) + f" | {worst:.0e} |")
    lines += ["", *(f"* {kind}: {text}" for kind, text in _KIND_TEXTS.items()), ""]
    return "\n".join(lines)
