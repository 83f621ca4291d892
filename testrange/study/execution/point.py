"""One point: simulated, evaluated, scored, reduced to its responses. Runs in a worker, which may be on another machine."""

import contextlib
import os
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from campaign.errors import TestrangeError
from campaign.threads import THREADS_VARIABLE
from testrange.study.execution.callables import from_callable, resolve
from testrange.study.execution.versions import versions

if TYPE_CHECKING:
    from evaluator.results import Evaluation

_ONE_AT_A_TIME = threading.Lock()  # the renderer is one for a process


def run_point(task: Mapping[str, Any]) -> dict[str, Any]:
    """Result of one task of `plan.task`: status "done" or "failed", values, run time, versions. Never raises.

    Threads: one each of Dr.Jit, Numba and BLAS, whatever starts it.
    """
    start = time.monotonic()
    outcome: dict[str, Any]
    with _ONE_AT_A_TIME:
        try:
            values = _called(task) if task["callable"] else _simulated(task)
            outcome = {"status": "done", "reason": None, "values": values}
        except TestrangeError as error:
            outcome = _failed(str(error))
        except MemoryError:
            outcome = _failed("not enough memory")
        except (Exception, SystemExit) as error:
            outcome = _failed(f"{type(error).__name__}: {error}{_where(error)}")
    return {"id": task["id"], **outcome, "run_time_s": round(time.monotonic() - start, 3), "versions": dict(versions())}


def _failed(reason: str) -> dict[str, Any]:
    return {"status": "failed", "reason": " ".join(reason.split())[:500], "values": {}}


def _where(error: BaseException) -> str:
    """The innermost file and line, without the machine's folders."""
    trace, place = error.__traceback__, ""
    while trace is not None:
        place = f" ({Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno})"
        trace = trace.tb_next
    return place


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    before = os.environ.get(THREADS_VARIABLE)
    os.environ[THREADS_VARIABLE] = "1"  # the renderer takes its threads when it is loaded, which is inside
    try:
        with threadpool_limits(limits=1):
            yield
    finally:
        if before is None:
            del os.environ[THREADS_VARIABLE]
        else:
            os.environ[THREADS_VARIABLE] = before


def _called(task: Mapping[str, Any]) -> dict[str, Any]:
    """A callable named in the study file, found beside it or installed: `function(factors, seed)`."""
    return from_callable(
        resolve(task["callable"], task["folder"])(task["factors"], task["seed"]), tuple(task["responses"])
    )


def _simulated(task: Mapping[str, Any]) -> dict[str, Any]:
    """A campaign flown, evaluated and scored in a temporary folder."""
    from campaign.config import Config
    from evaluator.evaluate import evaluate_campaign
    from evaluator.results import build_results, write_results
    from evaluator.scores.score import score_campaign
    from simulator.simulate import simulate_campaign
    from testrange.study.execution import responses

    config = Config.model_validate(task["config"])
    rendered = config.model_copy(update={"render": config.render.model_copy(update={"cache": task["cache"]})})
    with _one_thread(), _workplace(Path(task["work"]), task["keep"]) as place:
        campaign = place / "campaign"
        campaign.mkdir()
        simulate_campaign(rendered, campaign)
        evaluation = evaluate_campaign(campaign)
        write_results(place / "results.json", evaluation)
        score = score_campaign(campaign, place / "results.json")
        results = build_results(evaluation)
        items: dict[str, dict[str, Any]] = {
            i.quantity: {"error": i.error, "estimate": i.estimate, "std": i.std, "z": i.z, "unit": i.unit}
            for i in score.items
        }
        items["max_abs_z"] = {"z": score.max_abs_z, "unit": ""}
        counts = _panel_counts(evaluation)
        return {name: responses.take(name, results, items, counts, config) for name in task["responses"]}


@contextlib.contextmanager
def _workplace(work: Path, keep: str | None) -> Iterator[Path]:
    """A temporary folder below `work`, which the study removes where a worker could not; with `keep` one that stays, complete or
    not at all."""
    if keep is not None:
        from campaign.writing.atomic import complete_folder

        with complete_folder(Path(keep), replace=True) as place:
            yield place
        return
    work.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryDirectory(dir=work) as name:
            yield Path(name)
    finally:
        with contextlib.suppress(OSError):  # another attempt's folder is in it, or the other points'
            work.rmdir()
            work.parent.rmdir()


def _panel_counts(evaluation: "Evaluation") -> dict[str, Any]:
    """LiDAR returns by panel, and how many panels were met on how many strips."""
    found = cast("tuple[tuple[str, int, int, int], ...]", evaluation.companions.get("panel_returns", ()))
    panels: dict[str, int] = {}
    for panel, _, _, points in found:
        panels[panel] = panels.get(panel, 0) + points
    return {"panels": panels, "observations": len(found)}
