"""Every contender on every campaign, one after the other; whatever one of them does, the rest goes on."""

import itertools
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from campaign.errors import ConfigError, TestrangeError
from campaign.manifest import read_manifest
from campaign.progress import Report, silent
from evaluator.algorithms.apart import Done, Job, evaluate_apart
from evaluator.algorithms.guard import CALL_LIMIT_S
from evaluator.algorithms.program import PROGRAM_LIMIT_S, run_program
from evaluator.algorithms.record import SLOTS
from evaluator.results import build_results, write_json
from evaluator.scores.score import score_campaign
from evaluator.scores.score_echoes import EchoErrors
from evaluator.scores.score_observations import observation_errors
from testrange.compare.model import Contender, Outcome
from testrange.compare.statistics import Difference, differences

_UNITS = {"vertex": "m", "mark": "px", "panel": "%", "echo_range": "m", "echo": "%"}


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Outcomes in the order of campaigns, then of contenders; differences of every pair of contenders."""

    contenders: tuple[Contender, ...]
    campaigns: tuple[str, ...]
    outcomes: tuple[Outcome, ...]
    differences: tuple[Difference, ...]
    without_truth: tuple[str, ...] = ()  # campaigns that have no truth/


def compare_campaigns(
    campaigns: Sequence[Path],
    contenders: Sequence[Contender],
    progress: Report = silent,
    *,
    time_limit_s: float | None = None,
) -> Comparison:
    """Runs the comparison.

    Parameters
    ----------
    campaigns : sequence of Path
        Campaign folders.
    contenders : sequence of Contender
    progress : callable
    time_limit_s : float, optional
        Of one call of an algorithm, and of one run of a program; 60 s and one hour when absent. [s]

    Raises
    ------
    ConfigError
        An algorithm cannot be imported; nothing has been evaluated then.
    CampaignError
        A path is no campaign folder.
    """
    labels = _labels(campaigns)
    call_limit_s = time_limit_s or CALL_LIMIT_S
    for contender in contenders:
        if contender.slots:
            try:
                evaluate_apart(Job(names=contender.slots, campaign=None, call_limit_s=call_limit_s))
            except ConfigError as error:
                raise ConfigError(str(error), where=contender.name) from None
    slots = tuple(s for s in SLOTS if any(s in c.slots for c in contenders))
    outcomes = []
    for number, ((root, label), contender) in enumerate(itertools.product(labels, contenders)):
        stage = f"{number + 1} of {len(labels) * len(contenders)}: {label}, {contender.name}"
        outcomes.append(_outcome(root, label, contender, slots, call_limit_s, time_limit_s, _staged(progress, stage)))
    return Comparison(
        contenders=tuple(contenders),
        campaigns=tuple(label for _, label in labels),
        outcomes=tuple(outcomes),
        differences=tuple(differences(outcomes, [c.name for c in contenders])),
        without_truth=tuple(label for root, label in labels if not (root / "truth").is_dir()),
    )


def _labels(campaigns: Sequence[Path]) -> list[tuple[Path, str]]:
    """Folder and id of each; ids that come twice are numbered."""
    ids = [read_manifest(root).campaign for root in campaigns]
    out = []
    for k, (root, name) in enumerate(zip(campaigns, ids, strict=True)):
        twin = ids[:k].count(name)
        out.append((root, f"{name} ({twin + 1})" if ids.count(name) > 1 else name))
    return out


def _staged(progress: Report, stage: str) -> Report:
    """One stage for a whole evaluation: what of its stages are done."""
    seen: list[str] = []

    def report(inner: str, done: int, total: int) -> None:
        if inner not in seen:
            seen.append(inner)
            progress(stage, min(len(seen), 11), 12)

    progress(stage, 0, 12)
    return report


def _outcome(
    root: Path,
    label: str,
    contender: Contender,
    slots: tuple[str, ...],
    call_limit_s: float,
    time_limit_s: float | None,
    progress: Report,
) -> Outcome:
    try:
        if contender.program is not None:
            start = time.perf_counter()
            campaign_id = read_manifest(root).campaign
            results = run_program(contender.program, root, campaign_id, time_limit_s or PROGRAM_LIMIT_S)
            seconds = time.perf_counter() - start
            errors, units = _scored(root, results)
            return Outcome(
                campaign=label,
                contender=contender.name,
                seconds=seconds,
                indicators=_values(results),
                errors=errors,
                units=units,
            )
        echoes = "echo_decomposition" in slots
        job = Job(names=contender.slots, campaign=root, call_limit_s=call_limit_s, echoes=echoes, timed=slots)
        return _of_evaluation(root, label, contender, evaluate_apart(job, progress))
    except TestrangeError as error:
        return Outcome(campaign=label, contender=contender.name, reason=str(error))


def _of_evaluation(root: Path, label: str, contender: Contender, done: Done) -> Outcome:
    assert done.evaluation is not None
    results = build_results(done.evaluation)
    errors, units = _scored(root, results)
    single = observation_errors(root, done.evaluation) | _echo_items(done.echoes)
    units |= {name: _UNITS[name if name in _UNITS else name.split("_")[0]] for name in single}
    own = {slot: c for slot, c in done.calls.items() if c.name is not None}
    return Outcome(
        campaign=label,
        contender=contender.name,
        seconds=done.seconds,
        slot_seconds={slot: c.seconds for slot, c in done.calls.items()},
        calls={slot: (c.count, c.failed) for slot, c in own.items()},
        failures=tuple(
            f"{slot} {c.name}: {what} ({times} of {c.count} calls)"
            for slot, c in own.items()
            for what, times in c.failures.items()
        ),
        indicators=_values(results),
        errors={**errors, **single},
        units=units,
    )


def _scored(root: Path, results: Mapping[str, Any]) -> tuple[dict[str, dict[str, float]], dict[str, str]]:
    """Errors and units of score.json's quantities; none without truth/."""
    if not (root / "truth").is_dir():
        return {}, {}
    with tempfile.TemporaryDirectory(prefix="testrange-") as folder:
        path = Path(folder) / "results.json"
        write_json(path, results)
        try:
            items = score_campaign(root, path).items
        except TestrangeError as error:
            raise type(error)(str(error).replace(str(path), "its results")) from None
    return {i.quantity: {"": i.error} for i in items}, {i.quantity: i.unit for i in items}


def _values(results: Mapping[str, Any]) -> dict[str, float | None]:
    return {name: block.get("value") for name, block in results["indicators"].items()}


def _echo_items(found: EchoErrors | None) -> dict[str, dict[str, float]]:
    """Range errors by return; the share of packets without an echo near the return, and of those with more than one."""
    if found is None or not found.decomposed.any():
        return {}
    known = np.isfinite(found.error_m)
    items = {
        f"sortie {s}, strip {n}, record {r}": float(e)
        for (s, n), r, e in zip(found.strip[known], found.record[known], found.error_m[known], strict=True)
    }
    mine = found.decomposed
    return {
        "echo_range": items,
        "echo_missed": {"": float(100.0 * np.mean(~known[mine]))},
        "echo_surplus": {"": float(100.0 * np.mean(found.echoes[mine] > 1))},
    }
