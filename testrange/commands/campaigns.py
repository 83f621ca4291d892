"""A campaign from its configuration to its grades: run, simulate, evaluate, score, plan, check, schema."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from testrange.commands.options import (
    Cache,
    Documents,
    Json,
    Lang,
    OneLanguage,
    Quiet,
    Replace,
    Scheduler,
    Settings,
    Workers,
    counted,
    fail,
    languages,
    print_json,
    report,
    with_cache,
)


def run(
    config: str,
    /,
    *,
    out: Path | None = None,
    set_: Settings = (),
    language: Lang = "zh",
    documents: Documents = True,
    replace: Replace = False,
    json: Json = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    cache: Cache = None,
    quiet: Quiet = False,
) -> None:
    """Simulate, evaluate, score and report. Interrupted, the same command goes on where it stopped.

    Parameters
    ----------
    config
        A TOML file, or the name of one in configs/campaigns.
    out
        Output folder, out/CAMPAIGN by default; it gets campaign/ and results/.
    """
    from campaign.load import load_config
    from testrange import pipeline
    from testrange.progress import display

    loaded = load_config(config, with_cache(set_, cache))
    target = out or Path("out") / loaded.campaign.id
    with display(quiet=quiet) as progress:
        done = pipeline.run(
            loaded,
            target,
            progress,
            replace=replace,
            languages=languages(language),
            documents=documents,
            workers=workers,
            scheduler=scheduler,
        )
    report(done, json, language)


def simulate(
    config: str,
    /,
    *,
    out: Path,
    only: Literal["camera", "lidar", "bench", "ranging"] | None = None,
    set_: Settings = (),
    replace: Replace = False,
    json: Json = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    cache: Cache = None,
    quiet: Quiet = False,
) -> None:
    """Fly and observe the range: write a campaign folder. Interrupted, the same command goes on where it stopped.

    Parameters
    ----------
    config
        A TOML file, or the name of one in configs/campaigns.
    out
        The campaign folder to write.
    only
        One part alone: one sensor's flight, the indoor benches, or the ranging line.
    """
    from campaign.load import load_config
    from testrange import pipeline
    from testrange.progress import display

    loaded = load_config(config, with_cache(set_, cache))
    with display(quiet=quiet) as progress:
        pipeline.simulate(loaded, out, progress, replace=replace, only=only, workers=workers, scheduler=scheduler)
    if json:
        print_json({"campaign": loaded.campaign.id, "folder": str(out)})
    else:
        print(f"campaign folder: {out}")


def evaluate(
    campaign: Path,
    /,
    *,
    out: Path | None = None,
    keep_going: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    algorithm: Annotated[tuple[str, ...], Parameter(negative="", show_default=False)] = (),
    algorithms: Path | None = None,
    language: Lang = "zh",
    documents: Documents = True,
    replace: Replace = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Evaluate any campaign folder, flown or simulated: results.json, report.html, view.html, documents/, observations/.

    Parameters
    ----------
    campaign
        The campaign folder.
    out
        Results folder, results/ beside the campaign by default.
    keep_going
        Evaluate a folder that has errors: what is damaged is left out and named.
    algorithm
        A function of your own in place of one of the evaluator's, as slot=package.module:function; may be repeated.
        docs/your_own_algorithm.md names the slots.
    algorithms
        A TOML file of your own with the same in a table [algorithms].
    """
    from testrange import pipeline
    from testrange.progress import display

    campaign = pipeline.inside_run(campaign)
    target = out or campaign.resolve().parent / "results"
    chosen = {}
    if algorithm or algorithms is not None:
        from evaluator.algorithms.load import choose

        chosen = choose(algorithm, algorithms, campaign)
    with display(quiet=quiet) as progress:
        done = pipeline.evaluate(
            campaign,
            target,
            progress,
            replace=replace,
            keep_going=keep_going,
            languages=languages(language),
            documents=documents,
            algorithms=chosen,
        )
    report(done, json, language)


def score(campaign: Path, results: Path, /, *, language: OneLanguage = "zh", json: Json = False) -> None:
    """Compare results with the truth of a simulated campaign: score.json.

    Parameters
    ----------
    campaign
        The campaign folder, with truth/.
    results
        results.json, or the folder that holds it.
    """
    from evaluator.scores.score import build_score
    from testrange import pipeline, tables

    scored, target = pipeline.score(campaign, results)
    if json:
        print_json(build_score(scored))
    else:
        tables.print_score(scored, tables.console(), language)
        print(f"score: {target}")


def plan(config: str, /, *, language: OneLanguage = "zh", set_: Settings = (), json: Json = False) -> int:
    """What a campaign will be like before anything is flown: conformity, points, light, ranges. 1: it does not conform.

    Parameters
    ----------
    config
        A TOML file, or the name of one in configs/campaigns.
    """
    from campaign.load import load_config
    from testrange import tables
    from testrange.plan import plan_block, plan_campaign, print_plan

    found = plan_campaign(load_config(config, set_))
    if json:
        print_json(plan_block(found))
    else:
        print_plan(found, tables.console(), language)
    return 0 if found.refusal is None else fail(found.refusal, 1)


def check(path: str, /, *, set_: Settings = (), json: Json = False) -> int:
    """Validate a campaign folder, an archive or a configuration: every problem at once.

    Parameters
    ----------
    path
        A campaign folder, an archive, a TOML file, or the name of one in configs/campaigns.
    """
    from campaign.archive.check import check_archive, is_archive

    if is_archive(Path(path)):
        found = [(p.severity, p.where, p.message) for p in check_archive(Path(path))]
    elif Path(path).is_dir():
        from campaign.checks.folder import check_campaign
        from testrange.pipeline import inside_run

        found = [(p.severity, p.where, p.message) for p in check_campaign(inside_run(Path(path)))]
    else:
        from campaign.errors import ConfigError
        from campaign.load import load_config

        try:
            load_config(path, set_)
            found = []
        except ConfigError as error:
            found = [("error", path, line) for line in error.problems]
    errors = sum(severity == "error" for severity, _, _ in found)
    if json:
        print_json([{"severity": s, "where": w, "message": m} for s, w, m in found])
    else:
        for severity, where, message in found:
            print(f"{severity}: {message}" if where in message else f"{severity}: {where}: {message}")
        told = f"{counted(errors, 'error')}, {counted(len(found) - errors, 'warning')}"
        print(f"{path}: {told if found else 'sound'}")
    return 1 if errors else 0


def schema() -> None:
    """Print the JSON Schema of a configuration."""
    from campaign.load import json_schema

    print_json(json_schema())
