"""This project's evaluator run blind over a family's members: OUT/NAME/results.json."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from campaign.errors import CampaignError, TestrangeError
from campaign.progress import Report


def evaluate_members(
    family: Path, out: Path, progress: Report, workers: int = 2, *, replace: bool = False
) -> list[str]:
    """Evaluates what has no results since it was made; returns what could not be evaluated, one line each.

    Raises
    ------
    CampaignError
        No members.
    """
    folder = family / "members"
    names = sorted(p.name for p in folder.iterdir() if (p / "manifest.json").is_file()) if folder.is_dir() else []
    if not names:
        raise CampaignError("holds no members", where=str(family), expected="what testrange family make wrote")
    todo = [n for n in names if replace or not _newer(out / n / "results.json", folder / n / "manifest.json")]
    problems: list[str] = []
    progress("evaluate", 0, len(todo))
    if workers <= 1:
        for done, name in enumerate(todo, start=1):
            problems += evaluate_one(folder / name, out / name)
            progress("evaluate", done, len(todo))
        return problems
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_one_thread) as pool:
        jobs = [pool.submit(evaluate_one, folder / name, out / name) for name in todo]
        for done, job in enumerate(as_completed(jobs), start=1):
            try:
                problems += job.result()
            except BrokenProcessPool:
                raise CampaignError(
                    "a process of the evaluation was killed, perhaps for want of memory",
                    where=str(family),
                    remedy="the same command goes on; --workers 1 needs less",
                ) from None
            progress("evaluate", done, len(todo))
    return sorted(problems)


def _newer(results: Path, member: Path) -> bool:
    """Whether results are there, and not of a member that was made again since."""
    return results.is_file() and results.stat().st_mtime_ns >= member.stat().st_mtime_ns


def _one_thread() -> None:
    os.environ["NUMBA_NUM_THREADS"] = "1"


def evaluate_one(campaign: Path, out: Path) -> list[str]:
    """results.json of one member; one line where it cannot be evaluated."""
    from evaluator.evaluate import evaluate_campaign
    from evaluator.results import write_results

    try:
        evaluation = evaluate_campaign(campaign)
        out.mkdir(parents=True, exist_ok=True)
        write_results(out / "results.json", evaluation)
    except TestrangeError as error:
        return [f"{campaign.name}: {error}"]
    return []
