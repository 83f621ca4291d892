"""The fault matrix: every case simulated and evaluated, what deviates in each, and whether that is what was injected."""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from campaign.config import Config
from campaign.errors import CampaignError
from campaign.load import load_config
from campaign.progress import Report
from campaign.threads import thread_count
from evaluator.mounting.diagnosis import family_limit
from testrange.faults.study import FaultCase, FaultStudy
from testrange.study.execution.schedule import LOST, Outcome, not_run, run_all
from testrange.study.execution.workers import Pool

RUN = "testrange.faults.cases:run_task"


@dataclass(frozen=True, kw_only=True)
class CaseResult:
    """One row of the matrix."""

    case: FaultCase
    rows: tuple[dict[str, Any], ...] = ()  # of the diagnosis
    doubts: tuple[str, ...] = ()  # targets
    stated: tuple[str, ...] = ()  # what the adjustment took as stated and doubts
    pairs: tuple[tuple[str, str, float], ...] = ()  # parameters that correlate beyond 0.95
    problems: tuple[str, ...] = ()
    failed: str | None = None  # why there are no results

    def beyond(self, limit: float) -> tuple[str, ...]:
        """Quantities that deviate."""
        return tuple(r["quantity"] for r in self.rows if abs(r["z"]) > limit)

    def verdict(self, limit: float) -> str:
        """ "as injected", or what is missed and what shows besides."""
        if self.failed is not None:
            return f"failed: {self.failed}"
        found, wanted = set(self.beyond(limit)), set(self.case.shows)
        missed = sorted(wanted - found) + sorted(set(self.case.doubts) - set(self.doubts))
        besides = sorted(found - wanted) + sorted(set(self.doubts) - set(self.case.doubts))
        besides += [f"{name} as stated" for name in sorted(set(self.stated) - wanted)]
        told = [f"missed: {', '.join(missed)}"] if missed else []
        told += [f"besides: {', '.join(besides)}"] if besides else []
        return "; ".join(told) or "as injected"


@dataclass(frozen=True, kw_only=True)
class FaultMatrix:
    """All cases; the limit is for all values together."""

    results: tuple[CaseResult, ...]
    limit: float

    @property
    def right(self) -> int:
        """Cases in which exactly the injected fault shows."""
        return sum(r.verdict(self.limit) == "as injected" for r in self.results)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Of all cases, in the order in which the diagnosis has them."""
        return tuple(dict.fromkeys(row["quantity"] for r in self.results for row in r.rows))


def configurations(study: FaultStudy, settings: Sequence[str] = ()) -> tuple[Config, tuple[Config, ...]]:
    """The configuration without any case's fault, and one for each case.

    Raises
    ------
    ConfigError
        One of them is wrong.
    """
    common = (*study.set, *settings)
    return load_config(study.base, common), tuple(load_config(study.base, (*common, *c.set)) for c in study.fault)


def run_matrix(
    study: FaultStudy,
    base: Config,
    configs: Sequence[Config],
    out: Path,
    work: Path,
    progress: Report,
    workers: int | None = None,
) -> FaultMatrix:
    """Simulate and evaluate every case into `out`/NN (results.json each); those that are there already are not run again.

    Parameters
    ----------
    base, configs
        Of `configurations`.
    work : Path
        For what goes again when all is done: the base's parts, a campaign for each worker.
    workers : int, optional
        Processes of one thread each; every core that may be used by default.

    Raises
    ------
    CampaignError
        A part of the campaign that all cases share cannot be made.
    """
    shutil.rmtree(work / "cases", ignore_errors=True)  # of workers that were killed
    for folder in ("cases", "parts"):
        (work / folder).mkdir(parents=True, exist_ok=True)
    common: dict[str, Any] = {
        "base": base.model_dump(mode="json"),
        "parts": str(work / "parts"),
        "work": str(work / "cases"),
    }
    shared = [common | {"id": f"base-{p}", "config": common["base"], "part": p} for p in base.campaign.parts]
    cases = [
        common | {"id": f"{k:02d}", "config": c.model_dump(mode="json"), "out": str(out / f"{k:02d}")}
        for k, c in enumerate(configs)
    ]
    todo = [task for task in cases if not (Path(task["out"]) / "results.json").is_file()]
    failed: dict[str, str] = {}
    with Pool(workers or thread_count(), RUN) as pool:
        _run("what all cases share", shared, len(shared), pool, failed, progress)
        for name, reason in failed.items():
            raise CampaignError(reason, where=name)
        _run("faults", todo, len(cases), pool, failed, progress)
    results = tuple(
        _result(case, Path(task["out"]) / "results.json", failed.get(task["id"]))
        for case, task in zip(study.fault, cases, strict=True)
    )
    return FaultMatrix(results=results, limit=family_limit(sum(len(r.rows) for r in results)))


def _run(
    stage: str,
    tasks: Sequence[Mapping[str, Any]],
    of: int,
    pool: Pool,
    failed: dict[str, str],
    progress: Report,
) -> None:
    done = of - len(tasks)
    progress(stage, done, of)

    def finished(outcome: Outcome) -> None:
        nonlocal done
        done += 1
        if outcome["status"] != "done":
            failed[outcome["id"]] = outcome["reason"]
        progress(stage, done, of)

    run_all([(task["id"], task) for task in tasks], pool, finished, lambda task_id: not_run(task_id, LOST))


def _result(case: FaultCase, file: Path, failed: str | None) -> CaseResult:
    if failed is not None:
        return CaseResult(case=case, failed=failed)
    results = json.loads(file.read_text(encoding="utf-8"))
    block = results["diagnosis"]
    return CaseResult(
        case=case,
        rows=tuple(block["rows"]),
        doubts=tuple(block["surveyed_places_in_doubt"]),
        stated=tuple(line.split(":")[0] for line in block["stated_in_doubt"]),
        pairs=_pairs(results["mounting"]),
        problems=tuple(results["problems"]),
    )


def _pairs(mounting: dict[str, Any]) -> tuple[tuple[str, str, float], ...]:
    names, matrix = mounting.get("names", []), mounting.get("correlation", [])
    return tuple(
        (names[i], names[j], matrix[i][j]) for i in range(len(names)) for j in range(i) if abs(matrix[i][j]) > 0.95
    )


def matrix_block(matrix: FaultMatrix) -> dict[str, Any]:
    """For matrix.json."""
    return {
        "limit": matrix.limit,
        "values": sum(len(r.rows) for r in matrix.results),
        "as_injected": matrix.right,
        "cases": [
            {
                "fault": r.case.name,
                "set": r.case.set,
                "shows": r.case.shows,
                "doubts": r.case.doubts,
                "z": {row["quantity"]: row["z"] for row in r.rows},
                "deviating": r.beyond(matrix.limit),
                "surveyed_places_in_doubt": r.doubts,
                "stated_in_doubt": r.stated,
                "verdict": r.verdict(matrix.limit),
                "problems": r.problems,
            }
            for r in matrix.results
        ],
        "inseparable": [list(p) for p in matrix.results[0].pairs],
    }
