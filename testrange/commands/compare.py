"""Algorithms against each other."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from testrange.commands.options import Json, Quiet, Replace, print_json

Contenders = Annotated[
    tuple[str, ...],
    Parameter(
        name="--algorithm",
        negative="",
        show_default=False,
        help="What to compare, once for each: name:slot=package.module:function[,slot=...] for functions of your own, "
        "name:program:/path for a whole evaluator, or a ready-made one: default, vertex-orthogonal, waveform-peak, "
        "waveform-richardson-lucy. One alone is compared with default.",
    ),
]


def compare(
    *campaigns: Path,
    algorithm: Contenders = (),
    out: Path = Path("out/compare"),
    time_limit: Annotated[float | None, Parameter(show_default=False)] = None,
    replace: Replace = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare algorithms on campaigns whose truth is known: errors, run times, failures, paired differences.

    Writes comparison.html, comparison.json and run_times.json. docs/your_own_algorithm.md shows how to write a function for a
    slot. An algorithm that fails is reported, and the rest goes on.

    Parameters
    ----------
    campaigns
        Campaign folders, or what testrange run wrote.
    out
        Output folder.
    time_limit
        Seconds that one call of an algorithm, or one run of a program, may take; 60 and 3600 by default.
    """
    from campaign.errors import ConfigError
    from campaign.writing.atomic import complete_folder
    from testrange import tables
    from testrange.compare import compare_campaigns, parse_contenders
    from testrange.compare.table import print_comparison
    from testrange.compare.write import comparison_block, write_comparison
    from testrange.pipeline import inside_run, refuse_same_place
    from testrange.progress import display

    if not campaigns:
        raise ConfigError("no campaign to compare on", expected="testrange compare CAMPAIGN --algorithm ...")
    if time_limit is not None and not 0.0 < time_limit < 1e6:
        raise ConfigError("is no time limit", where="--time-limit", got=time_limit, expected="seconds above zero")
    contenders = parse_contenders(algorithm)
    for campaign in campaigns:
        refuse_same_place(inside_run(campaign), out)
    with complete_folder(out, replace) as work, display(quiet=quiet) as progress:
        folders = [inside_run(c) for c in campaigns]
        comparison = compare_campaigns(folders, contenders, progress, time_limit_s=time_limit)
        write_comparison(work, comparison)
    if json:
        print_json(comparison_block(comparison))
    else:
        print_comparison(comparison, tables.console())
        print(f"page: {out / 'comparison.html'}")
