"""The order of a run: simulate, evaluate, score, report; and what one needs to know of it afterwards.

Formulas and files live in the rooms that this calls. Output folders appear complete or not at all.
"""

import dataclasses
import json
import os
import resource
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.config import Config, Part
from campaign.errors import CampaignError, TestrangeError
from campaign.writing.atomic import complete_folder
from campaign.writing.resume import resumable_folder
from evaluator.documents.model import Language
from evaluator.model import EvaluationError
from evaluator.results import Evaluation, write_results
from evaluator.scores.score import Score, score_campaign, write_score
from testrange.progress import ProgressCallback
from testrange.refusals import refuse_at_once
from testrange.workers import simulate_units

if TYPE_CHECKING:
    from testrange.export import Format
    from testrange.faults.matrix import FaultMatrix
    from testrange.faults.study import FaultStudy

KEEP_GOING = "testrange evaluate --keep-going"


@dataclass(frozen=True, kw_only=True)
class Run:
    """What a run left behind."""

    evaluation: Evaluation
    score: Score | None
    out: Path
    seconds: float
    peak_memory_mb: float


def peak_memory_mb() -> float:
    """Greatest resident memory of this process, plus that of its greatest child. [MB of 1e6 bytes]"""
    unit = 1.0 if sys.platform == "darwin" else 1024.0  # getrusage counts bytes there, KiB on Linux
    own, child = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return (own + child) * unit / 1e6


def _write_results(
    folder: Path,
    campaign: Path,
    evaluation: Evaluation,
    languages: Sequence[Language],
    progress: ProgressCallback,
    *,
    score: bool,
    documents: bool,
) -> Score | None:
    """results.json, score.json and report.html into `folder`; with `documents` view.html, observations/ and documents/ too.

    Pages in a second language have it in their name: report_en.html.
    """
    from evaluator.report import write_report

    folder.mkdir(parents=True, exist_ok=True)
    write_results(folder / "results.json", evaluation)
    scored = score_campaign(campaign, folder / "results.json") if score else None
    if scored is not None:
        write_score(folder / "score.json", scored)
    for k, language in enumerate(languages):
        progress("report", k, len(languages))
        write_report(folder / f"report{f'_{language}' if k else ''}.html", evaluation, scored, language)
    progress("report", len(languages), len(languages))
    if documents:
        _write_documents(folder, campaign, evaluation, languages, progress, truth=score)
    return scored


def _write_documents(
    folder: Path,
    campaign: Path,
    evaluation: Evaluation,
    languages: Sequence[Language],
    progress: ProgressCallback,
    *,
    truth: bool,
) -> None:
    from evaluator.documents import write_documents
    from evaluator.documents.observations import write_observations
    from evaluator.scores.score_points import point_errors
    from evaluator.view import write_view

    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    write_observations(folder / "observations", evaluation)
    write_documents(folder / "documents", evaluation, results, languages, progress)
    errors = point_errors(campaign) if truth else None
    for k, language in enumerate(languages):
        progress("3D page", k, len(languages))
        write_view(folder / f"view{f'_{language}' if k else ''}.html", evaluation, results, errors, language)
    progress("3D page", len(languages), len(languages))


def _merged(known: Sequence[str], met: Sequence[str]) -> tuple[str, ...]:
    """The folder's errors, then what the evaluation met in files that the errors do not name."""
    files = {line.split(": ", 1)[0] for line in known}
    return (*known, *(line for line in met if line not in known and not any(name in line for name in files)))


def simulate(
    config: Config,
    out: Path,
    progress: ProgressCallback,
    *,
    replace: bool = False,
    only: Part | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
) -> None:
    """Writes the campaign folder `out`; `only` simulates one part of it. What an interrupted call had made is not made again."""
    refuse_at_once(config, out, replace=replace, workers=workers, scheduler=scheduler)
    with resumable_folder(out, _task(config, "simulate", only), replace) as work:
        simulate_units(
            config,
            work.folder,
            work.journal,
            progress,
            None if only is None else frozenset({only}),
            workers or 1,
            scheduler,
        )


def _task(config: Config, *more: object) -> str:
    """All that decides what a simulation writes."""
    from simulator.release import release

    body = config.model_dump_json(exclude={"render": {"cache", "cache_limit_gb"}})
    return json.dumps([release(), body, *more], default=str)


def _refuse_unsound(campaign: Path, keep_going: bool) -> list[str]:
    """The errors of a folder, one line each; without `keep_going` the first of them ends the evaluation."""
    from campaign.checks.folder import check_campaign

    lines = [f"{p.where}: {p.message}" for p in check_campaign(campaign, truth=False) if p.severity == "error"]
    if lines and not keep_going:
        more = f"and {len(lines) - 1} more: testrange check {campaign} lists them; " if len(lines) > 1 else ""
        raise CampaignError(
            lines[0], where=str(campaign), remedy=f"{more}{KEEP_GOING} evaluates what is left", problems=lines
        )
    return lines


def refuse_same_place(campaign: Path, out: Path) -> None:
    """Results inside the campaign would change it; in the campaign's place, or around it, --replace would delete it."""
    source, target = Path(os.path.realpath(campaign)), Path(os.path.realpath(out))  # `resolve` fails at a loop of links
    if target.is_relative_to(source) or source.is_relative_to(target):
        where = "lies inside" if target.is_relative_to(source) else "holds"
        raise CampaignError(f"{where} the campaign that is evaluated", where=str(out), remedy="choose another place")


def evaluate(
    campaign: Path,
    out: Path,
    progress: ProgressCallback,
    *,
    replace: bool = False,
    keep_going: bool = False,
    languages: Sequence[Language] = ("zh",),
    documents: bool = True,
    algorithms: Mapping[str, str] | None = None,
) -> Run:
    """Evaluates any campaign folder, flown or simulated, into `out`: results.json, report.html, view.html, observations and
    documents. Truth is not looked at.

    A folder with an error, or a target that no image or strip holds, is refused; with `keep_going` what is damaged is left
    out and named in the results. `algorithms` (slot -> package.module:function) run in a process of their own.
    """
    from evaluator.evaluate import evaluate_campaign

    start = time.monotonic()
    if not campaign.is_dir():
        raise CampaignError("no such folder", where=str(campaign), expected="a campaign folder with manifest.json")
    refuse_same_place(campaign, out)
    progress("check", 0, 1)
    known = _refuse_unsound(campaign, keep_going)
    progress("check", 1, 1)
    with complete_folder(out, replace) as work:
        try:
            if algorithms:
                evaluation = _with_algorithms(campaign, algorithms, progress, strict=not keep_going)
            else:
                evaluation = evaluate_campaign(campaign, progress, strict=not keep_going)
        except EvaluationError as error:
            raise CampaignError(
                str(error), where=str(campaign), remedy=f"{KEEP_GOING} evaluates all the same"
            ) from None
        evaluation = dataclasses.replace(evaluation, problems=_merged(known, evaluation.problems))
        _write_results(work, campaign, evaluation, languages, progress, score=False, documents=documents)
    return Run(
        evaluation=evaluation,
        score=None,
        out=out,
        seconds=time.monotonic() - start,
        peak_memory_mb=peak_memory_mb(),
    )


def _with_algorithms(
    campaign: Path, algorithms: Mapping[str, str], progress: ProgressCallback, *, strict: bool
) -> Evaluation:
    from evaluator.algorithms.apart import Job, evaluate_apart

    done = evaluate_apart(Job(names=algorithms, campaign=campaign, strict=strict), progress)
    assert done.evaluation is not None
    return done.evaluation


def run(
    config: Config,
    out: Path,
    progress: ProgressCallback,
    *,
    replace: bool = False,
    languages: Sequence[Language] = ("zh",),
    documents: bool = True,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Run:
    """Simulates, evaluates, scores and reports into `out`/campaign and `out`/results. What an interrupted call had simulated is
    not simulated again."""
    from evaluator.evaluate import evaluate_campaign

    start = time.monotonic()
    refuse_at_once(config, out, replace=replace, workers=workers, scheduler=scheduler)
    with resumable_folder(out, _task(config, "run"), replace) as work:
        campaign, results = work.folder / "campaign", work.folder / "results"
        campaign.mkdir(exist_ok=True)
        shutil.rmtree(results, ignore_errors=True)
        simulate_units(config, campaign, work.journal, progress, None, workers or 1, scheduler)
        evaluation = evaluate_campaign(campaign, progress)
        score = _write_results(results, campaign, evaluation, languages, progress, score=True, documents=documents)
    return Run(
        evaluation=evaluation,
        score=score,
        out=out,
        seconds=time.monotonic() - start,
        peak_memory_mb=peak_memory_mb(),
    )


def score(campaign: Path, results: Path) -> tuple[Score, Path]:
    """Scores results.json (or the folder that holds it) against the campaign's truth; score.json is written beside it."""
    from campaign.writing.atomic import complete_file

    file = results / "results.json" if results.is_dir() else results
    scored = score_campaign(campaign, file)
    target = file.with_name("score.json")
    with complete_file(target) as work:
        write_score(work, scored)
    return scored, target


def inside_run(place: Path) -> Path:
    """campaign/ where `place` is what `run` wrote, else the path itself."""
    return place / "campaign" if (place / "campaign").is_dir() else place


def _campaign_of(place: Path) -> Path:
    """The campaign folder that a path means: itself, or campaign/ in what `run` wrote."""
    campaign = inside_run(place)
    if not (campaign / "manifest.json").is_file():
        raise CampaignError(
            "no campaign in it", where=str(place), expected="a campaign folder, or what testrange run wrote"
        )
    return campaign


def _results_of(place: Path, campaign: Path) -> Path | None:
    """results/ beside the campaign of a run."""
    beside = place / "results"
    return beside if campaign != place and beside.is_dir() else None


def _require_kind(out: Path, *suffixes: str) -> None:
    """A file to write is of its kind, so that no other is replaced by it."""
    if out.suffix.lower() not in suffixes or out.is_dir():
        raise CampaignError(
            "is no name for it", where=str(out), expected=f"a file that ends in {' or '.join(suffixes)}"
        )


def picture(run_folder: Path, out: Path, progress: ProgressCallback) -> None:
    """One composite picture of a run: image with overlays, waveforms, grades."""
    from campaign.writing.atomic import complete_file
    from evaluator.evaluate import evaluate_campaign
    from evaluator.report import hero_picture

    _require_kind(out, ".png", ".jpg")
    evaluation = evaluate_campaign(_campaign_of(run_folder), progress)
    with complete_file(out) as work:
        hero_picture(work, evaluation)


def archive(place: Path, results: Path | None, out: Path, progress: ProgressCallback) -> Path:
    """One verifiable package (10.3) of a campaign and its results; a run's folder has both."""
    from campaign.archive.pack import write_archive

    campaign = _campaign_of(place)
    write_archive(campaign, results or _results_of(place, campaign), out, progress)
    return out


def export(place: Path, out: Path, to: "Format", results: Path | None, progress: ProgressCallback) -> list[Path]:
    """A campaign in the formats of other tools; of a run's folder with its results."""
    from testrange.export import export_campaign

    campaign = _campaign_of(place)
    return export_campaign(campaign, out, to, progress, results=results or _results_of(place, campaign))


def view(place: Path, out: Path | None, progress: ProgressCallback, language: Language) -> Path:
    """The 3D page of a run, of results or of a campaign: the one there is, or a new one of a campaign that is evaluated for it
    and written to `out` (view.html beside the campaign)."""
    from evaluator.evaluate import evaluate_campaign
    from evaluator.results import build_results
    from evaluator.scores.score_points import point_errors
    from evaluator.view import write_view
    from testrange.viewing import find_page

    if out is not None:
        _require_kind(out, ".html", ".htm")
    else:
        try:
            return find_page(place)
        except TestrangeError:
            if not (place / "manifest.json").is_file() and not (place / "campaign" / "manifest.json").is_file():
                raise
    campaign = _campaign_of(place)
    evaluation = evaluate_campaign(campaign, progress)
    target = out or campaign.resolve().parent / "view.html"
    write_view(target, evaluation, build_results(evaluation), point_errors(campaign), language)
    return target


def record(place: Path, out: Path, progress: ProgressCallback) -> list[str]:
    """A recording with a time line for the viewer of the extra `rerun`; returns what could not be shown."""
    from campaign.writing.atomic import complete_file
    from evaluator.evaluate import evaluate_campaign
    from evaluator.scores.score_points import point_errors
    from testrange.rerun_log import write_rrd

    _require_kind(out, ".rrd")
    campaign = _campaign_of(place)
    evaluation = evaluate_campaign(campaign, progress)
    with complete_file(out) as work:
        return write_rrd(work, evaluation, point_errors(campaign))


def faults(
    study: "FaultStudy",
    out: Path,
    progress: ProgressCallback,
    settings: Sequence[str] = (),
    *,
    replace: bool = False,
    workers: int | None = None,
) -> "FaultMatrix":
    """Runs a fault matrix into `out`: matrix.json, its drawing, and NN/results.json of every case. What an interrupted call had
    evaluated is not evaluated again."""
    from evaluator.results import write_json
    from testrange.faults.matrix import configurations, matrix_block, run_matrix
    from testrange.faults.picture import draw_matrix
    from testrange.study.report.figures import write_figure

    base, configs = configurations(study, settings)
    refuse_at_once(base, out, replace=replace, workers=workers)
    task = json.dumps([_task(base, "faults"), [_task(config) for config in configs]])
    with resumable_folder(out, task, replace) as work:
        matrix = run_matrix(study, base, configs, work.folder, work.journal.with_name("work"), progress, workers)
        write_json(work.folder / "matrix.json", matrix_block(matrix))
        write_figure(work.folder / "matrix", draw_matrix(matrix))
    return matrix
