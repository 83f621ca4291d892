"""One point: simulated, evaluated, scored, reduced to its responses. Runs in a worker, which may be on another machine."""

import contextlib
import importlib
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from campaign.errors import TestrangeError
from campaign.threads import THREADS_VARIABLE
from testrange.study.execution import responses
from testrange.study.plan import versions

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
    os.environ[THREADS_VARIABLE] = "1"  # before the renderer is loaded, which takes its threads then
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    with threadpool_limits(limits=1):
        yield


def _called(task: Mapping[str, Any]) -> dict[str, Any]:
    """A callable named in the study file, found beside it or installed: `function(factors, seed)`."""
    return responses.from_callable(
        resolve(task["callable"], task["folder"])(task["factors"], task["seed"]), tuple(task["responses"])
    )


def resolve(name: str, folder: str) -> Callable[..., Any]:
    """The function that "package.module:function" means; modules beside the study file come first.

    Raises
    ------
    TestrangeError
        No such module or function.
    """
    module, _, attribute = name.partition(":")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        found = getattr(importlib.import_module(module), attribute)
    except ImportError as error:
        raise TestrangeError(
            "cannot be imported", where=name, got=error, remedy="put the module beside the study file"
        ) from None
    except AttributeError:
        raise TestrangeError(f"{module} has no {attribute}", where=name) from None
    if not callable(found):
        raise TestrangeError("is no function", where=name)
    return found


def _simulated(task: Mapping[str, Any]) -> dict[str, Any]:
    """A campaign flown, evaluated and scored in a temporary folder."""
    from campaign.config import Config
    from evaluator.evaluate import evaluate_campaign
    from evaluator.results import build_results, write_results
    from evaluator.score import score_campaign
    from simulator.simulate import simulate_campaign

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
        from campaign.atomic import complete_folder

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
