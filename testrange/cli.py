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
        done = pipeline.run(loaded, target, progress, replace=replace)
    _report(done, json)


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
    replace: Replace = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Evaluate any campaign folder, flown or simulated: results.json and report.html.

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

    target = out or campaign.resolve().parent / "results"
    with display(quiet=quiet) as progress:
        done = pipeline.evaluate(campaign, target, progress, replace=replace, keep_going=keep_going)
    _report(done, json)


@app.command
def score(campaign: Path, results: Path, /, *, json: Json = False) -> None:
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
        tables.print_score(scored, tables.console())
        print(f"score: {target}")


@app.command
def check(path: str, /, *, set_: Settings = (), json: Json = False) -> int:
    """Validate a campaign folder or a configuration: every problem at once.

    Parameters
    ----------
    path
        A campaign folder, a TOML file, or the name of one in configs/campaigns.
    """
    if Path(path).is_dir():
        from campaign.check import check_campaign

        found = [(p.severity, p.where, p.message) for p in check_campaign(Path(path))]
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


def _report(done: Any, as_json: bool) -> None:
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
    console = tables.console()
    tables.print_indicators(done.evaluation, console)
    tables.print_conformity(done.evaluation, console)
    if done.score is not None:
        tables.print_score(done.score, console)
    print(f"report: {results / 'report.html'}")
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
