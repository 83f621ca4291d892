"""Reference pairs: write them, answer them with this evaluator, judge anyone's answers."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from testrange.commands.options import Json, Quiet, Replace, print_json

if TYPE_CHECKING:
    from testrange.pairs.model import Pair

pairs = App(name="pairs", help="Reference pairs: inputs and 30-digit results of every formula, to test any evaluator.")

PairsFolder = Annotated[
    Path | None,
    Parameter(name="--pairs", show_default=False, help="Folder of an earlier `testrange pairs`; else computed anew."),
]

Clauses = Annotated[
    tuple[str, ...],
    Parameter(
        negative="", show_default=False, help="Only these clauses' formulas, such as 8.3 or patent; may be repeated."
    ),
]


@pairs.default
def write(
    *,
    out: Path = Path("out/pairs"),
    clause: Clauses = (),
    replace: Replace = False,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Write the reference pairs: pairs.json, one table a formula for spreadsheets, a card with licence and checksums.

    `testrange pairs verify ANSWERS.json` judges anyone's answers to them, `testrange pairs answer` gives this evaluator's.

    Parameters
    ----------
    out
        Output folder.
    """
    from testrange.pairs.write import compute_pairs, write_pairs
    from testrange.progress import display

    with display(quiet=quiet) as progress:
        found = compute_pairs(progress, clause)
    write_pairs(found, out, replace=replace)
    formulas = list(dict.fromkeys(pair.formula for pair in found))
    if json:
        print_json({"folder": str(out), "pairs": len(found), "formulas": formulas})
    else:
        print(f"{len(found)} pairs for {len(formulas)} formulas and steps: {out / 'pairs.json'}")
        print(
            f"your results go into a copy of {out / 'answers_template.json'}; then: testrange pairs verify ANSWERS.json"
        )
    return 0


@pairs.command
def answer(out: Path, /, *, pairs: PairsFolder = None, quiet: Quiet = False) -> int:
    """Answer the pairs with this project's own evaluator, as an example of an answers file.

    Parameters
    ----------
    out
        The JSON file to write.
    """
    from json import dumps

    from campaign.writing.atomic import complete_file
    from testrange.pairs.ours import ours

    answers = ours(_pairs(pairs, quiet))
    with complete_file(out) as work:
        work.write_text(dumps(answers, indent=1) + "\n", encoding="utf-8")
    print(f"{len(answers)} answers: {out}")
    return 0


@pairs.command
def verify(answers: Path, /, *, pairs: PairsFolder = None, json: Json = False, quiet: Quiet = False) -> int:
    """Judge an answers file: right, wrong or missing, the error in units of tolerance, and the known mistake a wrong one shows.

    Exit code 0 when every answer given is right, 1 otherwise; what is missing does not count.

    Parameters
    ----------
    answers
        JSON: pair id -> number, or list of numbers in the order of the pair's results.
    """
    from testrange.pairs.show import print_report
    from testrange.pairs.verify import read_answers
    from testrange.pairs.verify import verify as judge

    given = read_answers(answers)
    report = judge(_pairs(pairs, quiet), given)
    if json:
        print_json(report.block())
    else:
        print_report(report)
    return 0 if report.of("right") and not report.of("wrong") else 1


def _pairs(folder: Path | None, quiet: bool) -> "tuple[Pair, ...]":
    from testrange.pairs.model import read_pairs
    from testrange.pairs.write import compute_pairs
    from testrange.progress import display

    if folder is not None:
        return read_pairs(folder)
    with display(quiet=quiet) as progress:
        return compute_pairs(progress)
