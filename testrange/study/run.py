"""A study from its file to its page: plan, run what is not finished, table, analysis, figures."""

import contextlib
import json
import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from campaign.errors import ConfigError
from campaign.load import dump_toml, load_config
from campaign.progress import Report, silent
from campaign.threads import thread_count
from campaign.writing.atomic import complete_file
from evaluator.results import plain
from simulator.kept import kept_bytes
from testrange.refusals import refuse_workers
from testrange.study.effects import Effects, analyse
from testrange.study.execution import store
from testrange.study.execution.callables import resolve
from testrange.study.execution.responses import check_name, column
from testrange.study.execution.schedule import LOST, Outcome, Places, not_run, run_all
from testrange.study.model import RUN_TIME, Study, load_study
from testrange.study.plan import Plan, Point, base_of, make_plan, task
from testrange.study.table import point_rows, write_table


@dataclass(frozen=True, kw_only=True)
class Done:
    """What a study left behind."""

    study: Study
    plan: Plan
    out: Path
    rows: tuple[dict[str, Any], ...]
    effects: tuple[Effects, ...]
    ran: int  # points that this call ran
    cache_mb: float
    page: Path | None  # None for one shard

    def count(self, status: str) -> int:
        return sum(row["status"] == status for row in self.rows)


def parse_shard(text: str) -> tuple[int, int]:
    """ "2/8" as (2, 8).

    Raises
    ------
    ConfigError
        Not i/N with 1 <= i <= N.
    """
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    number, of = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= number <= of:
        raise ConfigError("is no shard", where=f"--shard {text}", expected="i/N with i from 1 to N, for example 1/8")
    return number, of


def run_study(
    source: Path | str,
    out: Path | None = None,
    progress: Report = silent,
    *,
    settings: Sequence[str] = (),
    workers: int | None = None,
    scheduler: str | None = None,
    shard: str | None = None,
    retry_failed: bool = False,
    drop_cache: bool = False,
) -> Done:
    """Run every point of a study that is not finished, then write its table, figures and page.

    Parameters
    ----------
    source : Path or str
        The study file, or its name in configs/studies.
    out : Path, optional
        The study's folder, out/studies/NAME by default. What is finished there stays.
    workers : int, optional
        Processes on this machine; every core that may be used by default.
    scheduler : str, optional
        Address of a Dask scheduler, in the place of processes.
    shard : str, optional
        "i/N": only this part, and no table; a call without it collects.
    retry_failed : bool
        Run failed points again.
    drop_cache : bool
        Remove the shared renders at the end.

    Raises
    ------
    ConfigError
        The study, its base or a response is wrong. Nothing has been run then.
    StudyError
        `out` holds something else, or another call is at work in it.
    """
    part = None if shard is None else parse_shard(shard)
    refuse_workers(workers)
    study, file = load_study(source, tuple(settings))
    if study.callable is None:
        for name in study.responses:
            check_name(name)
    else:
        resolve(study.callable, str(file.resolve().parent))
    plan = make_plan(study, file)
    target = out or Path("out") / "studies" / file.stem
    mine = plan.points if part is None else plan.shard(*part)
    effects: tuple[Effects, ...] = ()
    page = None
    cache = target / "cache"
    with store.claimed(target, part):
        ran = _run(plan, mine, file, target, progress, _places(workers, scheduler), retry_failed)
        outcomes = store.read_points(target, (p.id for p in plan.points))
        rows = tuple(point_rows(plan, outcomes))
        if part is None:
            effects, page = _write(plan, file, target, rows, _units(study, outcomes.values()), progress)
        if drop_cache:
            shutil.rmtree(cache, ignore_errors=True)
    size = kept_bytes(cache) / 1e6 if cache.is_dir() else 0.0
    return Done(study=study, plan=plan, out=target, rows=rows, effects=effects, ran=ran, cache_mb=size, page=page)


def _places(workers: int | None, scheduler: str | None) -> Callable[[], AbstractContextManager[Places]]:
    if scheduler is not None:
        from testrange.study.execution.cluster import Cluster

        return lambda: Cluster(scheduler)
    from testrange.study.execution.workers import Pool

    return lambda: Pool(workers or thread_count())


def _run(
    plan: Plan,
    points: Sequence[Point],
    file: Path,
    out: Path,
    progress: Report,
    places: Callable[[], AbstractContextManager[Places]],
    retry_failed: bool,
) -> int:
    """Runs what is not finished; the number of points that were run."""
    known = store.read_points(out, (p.id for p in points))
    unlike = {p.id: p for p in points}.values()  # rounded samples may meet the same point twice
    todo = [
        p for p in unlike if p.id not in known or (retry_failed and known[p.id]["status"] == "failed" and not p.reason)
    ]
    for point in todo:
        if point.reason is not None:
            store.write_point(out, not_run(point.id, point.reason))
    todo = [p for p in todo if p.reason is None]
    if not todo:
        return 0
    members = Counter(p.group for p in plan.points)
    tasks = [
        (p.group, task(plan, p, out=out, file=file, cache=members[p.group] > 1 and p.config is not None)) for p in todo
    ]
    done = len(points) - len(todo)
    progress("points", done, len(points))

    def finished(outcome: Outcome) -> None:
        nonlocal done
        store.write_point(out, outcome)
        done += 1
        progress("points", done, len(points))

    try:
        with places() as opened:
            run_all(tasks, opened, finished, lambda point_id: not_run(point_id, LOST))
    finally:  # what a killed worker left behind, in this call or in one before
        for point in todo:
            shutil.rmtree(out / "work" / point.id, ignore_errors=True)
        with contextlib.suppress(OSError):
            (out / "work").rmdir()
    return len(todo)


def _write(
    plan: Plan, file: Path, out: Path, rows: Sequence[dict[str, Any]], units: Mapping[str, str], progress: Report
) -> tuple[tuple[Effects, ...], Path]:
    """table.parquet, analysis.json, study.toml, figures and page."""
    from testrange.study.report.page import write_page

    study = plan.study
    text = file.read_text(encoding="utf-8")
    base = "" if study.base is None else dump_toml(load_config(base_of(study.base, file), study.set))
    progress("table and page", 0, 2)
    with complete_file(out / "study.toml") as work:
        work.write_text(text, encoding="utf-8")
    write_table(out / "table.parquet", plan, rows, {"study": text, "base": base, "set": json.dumps(study.set)})
    effects = analyse(plan, rows, units)
    with complete_file(out / "analysis.json") as work:
        body = json.dumps(plain([e.block() for e in effects]), ensure_ascii=False, indent=1)
        work.write_text(body + "\n", encoding="utf-8")
    progress("table and page", 1, 2)
    page = write_page(out, plan, rows, effects)
    progress("table and page", 2, 2)
    return effects, page


def _units(study: Study, outcomes: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """Unit of every response, by its column, from the first point that has one."""
    units: dict[str, str] = {RUN_TIME: "s"}
    for found in outcomes:
        for name, value in found["values"].items():
            if isinstance(value.get("unit"), str):
                units.setdefault(column(name), value["unit"])
    return {name: units[name] for name in map(column, study.responses) if name in units}
