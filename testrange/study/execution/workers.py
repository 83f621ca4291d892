"""Worker processes of this machine, one Dr.Jit, Numba and BLAS thread each. A worker that dies is replaced.

A process of its own for each worker, not a pool of the standard library: there the death of one ends all.
"""

import contextlib
import importlib
import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from multiprocessing.connection import Connection, wait
from typing import Any

from campaign.threads import THREADS_VARIABLE
from testrange.study.execution.schedule import Outcome, Task

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", THREADS_VARIABLE)
RUN_POINT = "testrange.study.execution.point:run_point"
_SPAWN = multiprocessing.get_context("spawn")  # a forked copy of a renderer's threads does not run


class _Worker:
    """A process and what it is doing."""

    def __init__(self, run: str) -> None:
        self.pipe, other = _SPAWN.Pipe()
        with _one_thread_for_children():
            self.process = _SPAWN.Process(target=_work, args=(other, run), daemon=True)
            self.process.start()
        other.close()
        self.task_id: str | None = None

    def give(self, task: Task) -> None:
        self.task_id = task["id"]
        with contextlib.suppress(OSError):  # it died idle: `Pool.next` sees its end
            self.pipe.send(dict(task))

    def outcome(self) -> Outcome | None:
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            return None

    def end(self) -> None:
        self.pipe.close()
        self.process.kill()
        self.process.join()


class Pool:
    """As many workers as asked for, started when there is work for them. Implements `schedule.Places`.

    Parameters
    ----------
    count : int
    run : str
        MODULE:FUNCTION that makes an outcome of a task and never raises.
    """

    def __init__(self, count: int, run: str = RUN_POINT) -> None:
        self._count = count
        self._run = run
        self._workers: list[_Worker] = []

    def __enter__(self) -> "Pool":
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.end()

    def room(self) -> bool:
        return sum(w.task_id is not None for w in self._workers) < self._count

    def give(self, task: Task) -> None:
        idle = next((w for w in self._workers if w.task_id is None), None)
        if idle is None:
            idle = _Worker(self._run)
            self._workers.append(idle)
        idle.give(task)

    def next(self) -> list[tuple[str, Outcome | None]]:
        busy = [w for w in self._workers if w.task_id is not None]
        ready = wait([w.pipe for w in busy])
        ended: list[tuple[str, Outcome | None]] = []
        for worker in busy:
            if worker.pipe in ready and worker.task_id is not None:
                outcome = worker.outcome()
                ended.append((worker.task_id, outcome))
                worker.task_id = None
                if outcome is None:
                    worker.end()
                    self._workers.remove(worker)
        return ended


@contextlib.contextmanager
def _one_thread_for_children() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _work(pipe: Connection, run: str) -> None:
    """A worker's life: tasks in, outcomes out, until the study closes the pipe or ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the study's: it ends its workers
    os.dup2(2, 1)  # what libraries print is no output of the command
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    threading.Thread(target=_end_with_parent, daemon=True).start()
    module, function = run.split(":")
    run_task = getattr(importlib.import_module(module), function)
    while True:
        try:
            task: dict[str, Any] = pipe.recv()
        except (EOFError, OSError):
            return
        pipe.send(run_task(task))


def _end_with_parent() -> None:
    """A study that was killed leaves no worker behind."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
