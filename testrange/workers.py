"""Several processes, or a cluster, simulate one campaign: each takes every n-th picture, strip or scan; the parent fills gaps and
does the rest."""

import contextlib
import multiprocessing
import os
import threading
import time
from collections.abc import Sequence
from multiprocessing.process import BaseProcess
from pathlib import Path

from campaign.config import Config
from campaign.progress import Report, silent
from campaign.threads import THREADS_VARIABLE, thread_count
from campaign.writing.resume import sweep
from simulator.journal import Journal, finished_units
from testrange.cluster import end_runs, share_on_cluster

POLL_S = 0.5


def simulate_units(
    config: Config,
    folder: Path,
    journal: Path,
    progress: Report,
    only: frozenset[str] | None = None,
    workers: int = 1,
    scheduler: str | None = None,
) -> None:
    """Complete the campaign `folder`, of which `journal` knows what is finished. The bytes do not depend on who makes it.

    A worker that dies leaves its units to the parent, which makes what is missing and writes everything else.

    Parameters
    ----------
    scheduler : str, optional
        Address of a Dask scheduler, whose workers take the place of processes here; all must see `folder` under this path.

    Raises
    ------
    ClusterError
        See `testrange.cluster`.
    """
    from simulator.simulate import simulate_campaign

    end_runs(journal)
    if scheduler is not None:
        share_on_cluster(config, folder, journal, progress, only, scheduler, _unit_count(config, only))
    elif workers > 1:
        _share(config, folder, journal, progress, only, workers)
    sweep(folder)  # of workers that were lost, now or when an earlier command was killed
    simulate_campaign(config, folder, progress, only, Journal(folder, journal))


def _share(
    config: Config, folder: Path, journal: Path, progress: Report, only: frozenset[str] | None, workers: int
) -> None:
    threads = max(1, thread_count() // workers)
    context = multiprocessing.get_context("spawn")
    crew = [
        context.Process(target=_work, args=(config.model_dump_json(), folder, journal, only, (k, workers), threads))
        for k in range(workers)
    ]
    stage = f"{workers} workers"
    total = _unit_count(config, only)
    progress(stage, 0, total)
    try:
        for process in crew:
            process.start()
        while any(process.is_alive() for process in crew):
            time.sleep(POLL_S)
            progress(stage, min(finished_units(folder, journal), total), total)
    finally:
        _stop(crew)
    progress(stage, total, total)


def _stop(crew: Sequence[BaseProcess]) -> None:
    for process in crew:
        if process.pid is not None:
            process.terminate()
    for process in crew:
        if process.pid is not None:
            process.join()


def _unit_count(config: Config, only: frozenset[str] | None) -> int:
    parts = frozenset(config.campaign.parts) if only is None else only
    flight, bench = config.flight, config.bench
    strips = len(flight.heights_m) * len(flight.headings_deg) * flight.strips_per_heading
    count = strips * flight.images_per_strip if "camera" in parts else 0
    count += strips if "lidar" in parts else 0
    count += config.ranging.scans if "ranging" in parts else 0
    if "bench" in parts:
        from simulator.bench.placements import plan_placements

        count += 2 * bench.sphere.images + len(plan_placements(config))
    return max(count, 1)


def _work(
    config: str, folder: Path, journal: Path, only: frozenset[str] | None, share: tuple[int, int], threads: int
) -> None:
    """In a process of its own. What goes wrong here goes wrong in the parent too, which then says so."""
    os.environ[THREADS_VARIABLE] = str(threads)
    threading.Thread(target=_leave_with, args=(os.getppid(),), daemon=True).start()
    with contextlib.suppress(BaseException):
        from simulator.simulate import simulate_campaign

        simulate_campaign(
            Config.model_validate_json(config), folder, silent, only, Journal(folder, journal, share=share)
        )
    os._exit(0)  # the parent judges by the journal


def _leave_with(parent: int) -> None:
    """A worker whose parent was killed stops: another command may be at work on the folder."""
    while os.getppid() == parent:
        time.sleep(POLL_S)
    os._exit(1)
