"""What the commands share: their common options, and how a run is told of."""

import json
import sys
from typing import Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from campaign.errors import ConfigError

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
Workers = Annotated[
    int | None,
    Parameter(
        validator=Number(gte=1, lte=256),
        show_default=False,
        help="Processes that share pictures and strips, and the cores, 1 by default; the same files for any number.",
    ),
]
Scheduler = Annotated[
    str | None,
    Parameter(
        show_default=False,
        help="Address of a Dask scheduler (tcp://HOST:8786) whose workers share pictures and strips instead (extra "
        "`cluster`); all must see the output folder under the same path.",
    ),
]
Cache = Annotated[
    str | None,  # a path would make "." of an empty text
    Parameter(
        show_default=False,
        help="Folder that keeps renders between runs: with scene_seed fixed, another seed or navigation error renders nothing "
        "again. Up to render.cache_limit_gb (50) are kept; the campaign is the same with it and without.",
    ),
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


def with_cache(settings: tuple[str, ...], cache: str | None) -> tuple[str, ...]:
    """The settings, and where renders are kept."""
    if cache is not None and any("\ud800" <= c <= "\udfff" for c in cache):
        raise ConfigError("is not UTF-8", where="--cache", got=ascii(cache), remedy="choose another name")
    if cache == "":
        raise ConfigError("is empty", where="--cache", expected="a folder", remedy="leave it out to keep no renders")
    return settings if cache is None else (*settings, f"render.cache={json.dumps(cache, ensure_ascii=False)}")


def print_json(content: Any) -> None:
    print(json.dumps(content, ensure_ascii=False, indent=1))


def languages(language: Literal["zh", "en", "both"]) -> tuple[Literal["zh", "en"], ...]:
    return ("zh", "en") if language == "both" else (language,)


def report(done: Any, as_json: bool, language: Literal["zh", "en", "both"]) -> None:
    """Prints what a run or an evaluation found."""
    from testrange import tables

    results = done.out / "results" if (done.out / "results").is_dir() else done.out
    if as_json:
        print_json(
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
    console, words = tables.console(), languages(language)[0]
    tables.print_indicators(done.evaluation, console, words)
    tables.print_doubts(done.evaluation, console, words)
    tables.print_conformity(done.evaluation, console, words)
    if done.score is not None:
        tables.print_score(done.score, console, words)
    print(f"report: {results / 'report.html'}")
    if (results / "documents").is_dir():
        print(f"3D page: {results / 'view.html'}, documents: {results / 'documents'}")
    print(f"run time: {done.seconds:.1f} s, peak resident memory: {done.peak_memory_mb:,.0f} MB")


def counted(number: int, thing: str) -> str:
    """ "1 file", "2 files"."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def fail(text: str, code: int) -> int:
    """One line on stderr; returns the exit code."""
    print(f"testrange: {text}", file=sys.stderr)
    return code
