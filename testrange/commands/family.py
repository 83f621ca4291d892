"""Conformance data sets: make, evaluate, verify."""

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from testrange.commands.options import Json, Quiet, Replace, print_json

family = App(
    name="family",
    help="Data sets with known indicators: make them, run this evaluator over them, score anybody's results.",
    help_format="plaintext",
)


@family.default
@family.command
def make(
    family: str = "small",
    /,
    *,
    out: Path,
    only: Annotated[
        tuple[str, ...], Parameter(negative="", help="Members whose name begins so; may be repeated.")
    ] = (),
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Write the campaign folders of a family, what is expected of an evaluator, and a card of each. Goes on where it stopped.

    Parameters
    ----------
    family
        A TOML file, or the name of one in configs/families.
    out
        Output folder: members/, expected/, cards/.
    """
    from testrange.family.make import make_family
    from testrange.family.model import load_family
    from testrange.progress import display

    loaded = load_family(family)
    with display(quiet=quiet) as progress:
        made = make_family(loaded, out, progress, only)
    if json:
        print_json({"members": list(made.names), "made": made.made, "failed": made.failed})
    else:
        for name, why in made.failed.items():
            print(f"not made: {name}: {why}")
        print(f"{len(made.names) - len(made.failed)} members, {made.made} of them now: {out / 'members'}")
    return 1 if made.failed else 0


@family.command
def evaluate(
    place: Path,
    /,
    *,
    out: Path,
    workers: Annotated[int, Parameter(help="Processes.")] = 2,
    replace: Replace = False,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Run this evaluator blind over the members: OUT/MEMBER/results.json. Goes on where it stopped.

    Parameters
    ----------
    place
        What testrange family make wrote.
    out
        Folder for the results.
    """
    from testrange.family.evaluate import evaluate_members
    from testrange.progress import display

    with display(quiet=quiet) as progress:
        problems = evaluate_members(place, out, progress, workers, replace=replace)
    if json:
        print_json({"results": str(out), "problems": problems})
    else:
        for line in problems:
            print(line)
        print(f"results: {out}")
    return 1 if problems else 0


@family.command
def verify(
    place: Path,
    results: Annotated[tuple[Path, ...], Parameter(negative="")],
    /,
    *,
    json: Json = False,
) -> int:
    """Score an evaluator's results: grades, clauses, errors in tolerances, and what its mistakes look like.

    Parameters
    ----------
    place
        What testrange family make wrote.
    results
        Folders with MEMBER/results.json, or results.json files.
    """
    from testrange.family.verify import summary_lines
    from testrange.family.verify import verify as compare

    report = compare(place, results)
    if json:
        print_json(report.block())
    else:
        for line in summary_lines(report):
            print(line)
    return 0 if report.right else 1
