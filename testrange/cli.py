"""The command line. Every command imports its rooms when it runs, so that --help takes no longer than it must.

Exit codes: 0 done; 1 the input or the campaign is at fault, one line on stderr; 2 wrong usage; 130 interrupted.
"""

import errno
import json
import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter

from campaign.errors import TestrangeError

app = App(
    name="testrange",
    help="A virtual test range for UAV LiDAR and cameras after GB/T 41450-2022.",
    version_flags=["--version"],
    help_format="plaintext",  # Markdown help costs 40 ms of imports
    result_action="return_value",
    suppress_keyboard_interrupt=False,  # `call` says it in the same form as every other end
)

Settings = Annotated[
    tuple[str, ...],
    Parameter(
        name="--set",
        negative="",
        show_default=False,
        help="One setting as key=value, a TOML value; may be repeated: --set seed=7",
    ),
]
Replace = Annotated[
    bool, Parameter(negative="", show_default=False, help="Replace an output folder of an earlier run.")
]
Json = Annotated[bool, Parameter(name="--json", negative="", show_default=False, help="Print JSON instead of tables.")]
Lang = Annotated[
    Literal["zh", "en", "both"],
    Parameter(
        name="--language", help="Of reports, documents and tables: Chinese, English, or pages and documents in both."
    ),
]
OneLanguage = Annotated[Literal["zh", "en"], Parameter(name="--language", help="Chinese or English.")]
Documents = Annotated[
    bool,
    Parameter(show_default=False, help="Documents as PDF and DOCX and the 3D page; --no-documents leaves them out."),
]
Quiet = Annotated[bool, Parameter(negative="", show_default=False, help="No progress.")]


def _print_json(content: Any) -> None:
    print(json.dumps(content, ensure_ascii=False, indent=1))


@app.command
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
    quiet: Quiet = False,
) -> None:
    """Simulate, evaluate, score and report.

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

    loaded = load_config(config, set_)
    target = out or Path("out") / loaded.campaign.id
    with display(quiet=quiet) as progress:
        done = pipeline.run(
            loaded, target, progress, replace=replace, languages=_languages(language), documents=documents
        )
    _report(done, json, language)


@app.command
def simulate(
    config: str,
    /,
    *,
    out: Path,
    only: Literal["camera", "lidar", "bench", "ranging"] | None = None,
    set_: Settings = (),
    replace: Replace = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fly and observe the range: write a campaign folder.

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

    loaded = load_config(config, set_)
    with display(quiet=quiet) as progress:
        pipeline.simulate(loaded, out, progress, replace=replace, only=only)
    if json:
        _print_json({"campaign": loaded.campaign.id, "folder": str(out)})
    else:
        print(f"campaign folder: {out}")


@app.command
def evaluate(
    campaign: Path,
    /,
    *,
    out: Path | None = None,
    keep_going: Annotated[bool, Parameter(negative="", show_default=False)] = False,
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
    """
    from testrange import pipeline
    from testrange.progress import display

    campaign = pipeline.inside_run(campaign)
    target = out or campaign.resolve().parent / "results"
    with display(quiet=quiet) as progress:
        done = pipeline.evaluate(
            campaign,
            target,
            progress,
            replace=replace,
            keep_going=keep_going,
            languages=_languages(language),
            documents=documents,
        )
    _report(done, json, language)


@app.command
def score(campaign: Path, results: Path, /, *, language: OneLanguage = "zh", json: Json = False) -> None:
    """Compare results with the truth of a simulated campaign: score.json.

    Parameters
    ----------
    campaign
        The campaign folder, with truth/.
    results
        results.json, or the folder that holds it.
    """
    from evaluator.score import build_score
    from testrange import pipeline, tables

    scored, target = pipeline.score(campaign, results)
    if json:
        _print_json(build_score(scored))
    else:
        tables.print_score(scored, tables.console(), language)
        print(f"score: {target}")


@app.command
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
        _print_json(plan_block(found))
    else:
        print_plan(found, tables.console(), language)
    return 0 if found.refusal is None else _fail(found.refusal, 1)


@app.command
def archive(
    campaign: Path,
    /,
    *,
    out: Path,
    results: Path | None = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Package a campaign and its results for filing (10.3): one BagIt package that `testrange check` verifies.

    Parameters
    ----------
    campaign
        A campaign folder, or what testrange run wrote.
    out
        A name that ends in .zip, or a new folder.
    results
        Its results folder; results/ beside the campaign where testrange run wrote both.
    """
    from testrange import pipeline
    from testrange.progress import display

    with display(quiet=quiet) as progress:
        pipeline.archive(campaign, results, out, progress)
    if json:
        _print_json({"archive": str(out), "bytes": out.stat().st_size if out.is_file() else None})
    else:
        print(f"archive: {out}")


@app.command
def export(
    campaign: Path,
    /,
    *,
    to: Literal["colmap", "odm", "clouds", "mcap"],
    out: Path,
    results: Path | None = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a campaign in the formats of other tools; docs/exports.md describes the files.

    Parameters
    ----------
    campaign
        A campaign folder, or what testrange run wrote.
    to
        colmap: images and model; odm: images with GPS tags and gcp_list.txt; clouds: PLY and PCD with image pairs;
        mcap: a recording (extra `mcap`).
    out
        A new folder; for mcap also a file that ends in .mcap.
    results
        results.json: the adjusted mountings are used instead of the data sheets'; results/ beside the campaign where
        testrange run wrote both.
    """
    from testrange import pipeline
    from testrange.progress import display

    with display(quiet=quiet) as progress:
        files = pipeline.export(campaign, out, to, results, progress)
    if json:
        _print_json({"files": [str(f) for f in files]})
    else:
        print(f"{len(files)} files: {out}")


@app.command
def view(
    place: Path,
    /,
    *,
    port: Annotated[int, Parameter(help="0 takes a free one.")] = 8041,
    rerun: Path | None = None,
    out: Path | None = None,
    language: OneLanguage = "zh",
    quiet: Quiet = False,
) -> None:
    """Show the range in 3D: serves view.html to this machine only, until Ctrl-C.

    Parameters
    ----------
    place
        What testrange run or evaluate wrote, a page, or a campaign folder, which is then evaluated.
    rerun
        Write a recording with a time line to this .rrd file instead (extra `rerun`).
    out
        Write the page to this file and do not serve it.
    """
    from testrange import pipeline
    from testrange.progress import display
    from testrange.viewing import serve

    with display(quiet=quiet) as progress:
        if rerun is not None:
            left_out = pipeline.record(place, rerun, progress)
        else:
            page = pipeline.view(place, out, progress, language)
    if rerun is not None:
        for line in left_out:
            print(f"not shown: {line}")
        print(f"recording: {rerun}")
    elif out is not None:
        print(f"3D page: {page}")
    else:
        serve(page, port)


@app.command
def check(path: str, /, *, set_: Settings = (), json: Json = False) -> int:
    """Validate a campaign folder, an archive or a configuration: every problem at once.

    Parameters
    ----------
    path
        A campaign folder, an archive, a TOML file, or the name of one in configs/campaigns.
    """
    from campaign.archive_check import check_archive, is_archive

    if is_archive(Path(path)):
        found = [(p.severity, p.where, p.message) for p in check_archive(Path(path))]
    elif Path(path).is_dir():
        from campaign.check import check_campaign
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
        _print_json([{"severity": s, "where": w, "message": m} for s, w, m in found])
    else:
        for severity, where, message in found:
            print(f"{severity}: {message}" if where in message else f"{severity}: {where}: {message}")
        print(f"{path}: {errors} errors, {len(found) - errors} warnings" if found else f"{path}: sound")
    return 1 if errors else 0


@app.command
def faults(
    study: str = "faults",
    /,
    *,
    out: Path = Path("out/faults"),
    set_: Settings = (),
    replace: Replace = False,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Inject one fault at a time and print which parameters show it: matrix.json, and results.json of every case.

    Parameters
    ----------
    study
        A TOML file, or the name of one in configs/studies.
    out
        Output folder.
    """
    from testrange import pipeline, tables
    from testrange.faults import load_study, matrix_block
    from testrange.progress import display

    loaded = load_study(study)
    with display(quiet=quiet) as progress:
        matrix = pipeline.faults(loaded, out, progress, set_, replace=replace)
    if json:
        _print_json(matrix_block(matrix))
    else:
        tables.print_faults(matrix, tables.console())
        print(f"matrix: {out / 'matrix.json'}")
    return 0 if matrix.right == len(matrix.results) else 1


@app.command
def schema() -> None:
    """Print the JSON Schema of a configuration."""
    from campaign.load import json_schema

    _print_json(json_schema())


@app.command
def picture(run_folder: Path, /, *, out: Path, quiet: Quiet = False) -> None:
    """One picture of a run: an image with its targets, waveforms and grades. Evaluates the campaign again.

    Parameters
    ----------
    run_folder
        What testrange run wrote, or a campaign folder.
    out
        A .png or .jpg file.
    """
    from testrange import pipeline
    from testrange.progress import display

    with display(quiet=quiet) as progress:
        pipeline.picture(run_folder, out, progress)
    print(f"picture: {out}")


def _languages(language: Literal["zh", "en", "both"]) -> tuple[Literal["zh", "en"], ...]:
    return ("zh", "en") if language == "both" else (language,)


def _report(done: Any, as_json: bool, language: Literal["zh", "en", "both"]) -> None:
    """Prints what a run or an evaluation found."""
    from testrange import tables

    results = done.out / "results" if (done.out / "results").is_dir() else done.out
    if as_json:
        _print_json(
            tables.summary(
                done.evaluation,
                done.score,
                folder=str(done.out),
                report=str(results / "report.html"),
                seconds=round(done.seconds, 1),
                peak_memory_mb=round(done.peak_memory_mb),
            )
        )
        return
    console, words = tables.console(), _languages(language)[0]
    tables.print_indicators(done.evaluation, console, words)
    tables.print_conformity(done.evaluation, console, words)
    if done.score is not None:
        tables.print_score(done.score, console, words)
    print(f"report: {results / 'report.html'}")
    if (results / "documents").is_dir():
        print(f"3D page: {results / 'view.html'}, documents: {results / 'documents'}")
    print(f"run time: {done.seconds:.1f} s, peak resident memory: {done.peak_memory_mb:,.0f} MB")


def _fail(text: str, code: int) -> int:
    print(f"testrange: {text}", file=sys.stderr)
    return code


def _one_line(error: BaseException) -> str:
    told = " ".join(str(error).split())[:200]
    return f"{told}; please report it, with what TESTRANGE_TRACEBACK=1 prints"


def _innermost(error: BaseException) -> str:
    """File and line of our own that was running."""
    here = Path(__file__).resolve().parent.parent
    place, trace = "testrange", error.__traceback__
    while trace is not None:
        file = Path(trace.tb_frame.f_code.co_filename)
        if file.is_relative_to(here) and "site-packages" not in file.relative_to(here).parts:
            place = f"{file.relative_to(here)}:{trace.tb_lineno}"
        trace = trace.tb_next
    return place


def call(arguments: Sequence[str]) -> int:
    """Runs one command line; returns its exit code."""
    try:
        result = app(list(arguments), exit_on_error=False, print_error=False)
    except CycloptsError as error:
        return _fail(f"{' '.join(str(error).split())} See testrange --help.", 2)
    except TestrangeError as error:
        return _fail(str(error), 1)
    except KeyboardInterrupt:
        return _fail("interrupted", 130)
    except MemoryError:
        return _fail("not enough memory; free some, or take smaller images, fewer targets or shorter strips", 1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the reader of stdout left; nothing more to say
        return 0
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            return _fail(
                f"{error.filename or 'output'}: no space left on the disk; free some or choose another place", 1
            )
        return _fail(f"{error.filename or 'file'}: {error.strerror or error}", 1)
    except Exception as error:
        if os.environ.get("TESTRANGE_TRACEBACK"):
            raise
        return _fail(f"{_innermost(error)}: internal error: {type(error).__name__}; {_one_line(error)}", 1)
    return result if isinstance(result, int) else 0


def main() -> None:
    """Entry point of the command `testrange`."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # what a library thinks of a value is no news to the user
    sys.exit(call(sys.argv[1:]))
