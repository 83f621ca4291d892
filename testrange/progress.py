"""Progress on stderr: a bar with remaining time on a terminal, plain lines elsewhere, nothing when asked so.

What simulator and evaluator take is a plain callable, `progress(stage, done, total)`; every display here is one.
"""

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self, TextIO

from campaign.progress import Report

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

ProgressCallback = Report

_LINE_EVERY_S = 10.0  # plain lines of one stage


def no_progress(stage: str, done: int, total: int) -> None:
    """Shows nothing."""


class Progress(Protocol):
    """A display of stages. Also callable as `progress(stage, done, total)`."""

    def stage(self, name: str, total: int) -> None:
        """Begins a stage of `total` steps; the one before has ended."""

    def advance(self, n: int = 1) -> None:
        """`n` more steps of the current stage are done."""

    def __call__(self, stage: str, done: int, total: int) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class _Display:
    """Keeps count; what is shown is left to `_begin`, `_update` and `_end`."""

    def __init__(self) -> None:
        self._name: str | None = None
        self._done = 0
        self._total = 0

    def stage(self, name: str, total: int) -> None:
        self._finish()
        self._name, self._done, self._total = name, 0, total
        self._begin(name, total)

    def advance(self, n: int = 1) -> None:
        self._done += n
        self._update(self._done, self._total)

    def __call__(self, stage: str, done: int, total: int) -> None:
        if stage != self._name:
            self.stage(stage, total)
        self._done, self._total = done, total
        self._update(done, total)

    def _finish(self) -> None:
        if self._name is not None:
            self._end(self._name)
        self._name = None

    def _begin(self, name: str, total: int) -> None: ...

    def _update(self, done: int, total: int) -> None: ...

    def _end(self, name: str) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._finish()


class LineProgress(_Display):
    """A line when a stage begins, one every ten seconds while it lasts, one with its duration when it ends."""

    def __init__(self, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._stream = stream or sys.stderr
        self._clock = clock
        self._start = self._shown = 0.0

    def _line(self, text: str) -> None:
        print(text, file=self._stream, flush=True)

    def _begin(self, name: str, total: int) -> None:
        self._start = self._shown = self._clock()
        self._line(f"{name} …")

    def _update(self, done: int, total: int) -> None:
        now = self._clock()
        if now - self._shown >= _LINE_EVERY_S and 0 < done < total:
            self._shown = now
            left = (now - self._start) / done * (total - done)
            self._line(f"{self._name}: {done} of {total}, about {left:.0f} s left")

    def _end(self, name: str) -> None:
        self._line(f"{name}: {self._clock() - self._start:.1f} s")


class BarProgress(_Display):
    """One bar a stage, with the elapsed and the remaining time."""

    def __init__(self) -> None:
        super().__init__()
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
        from rich.progress import TimeRemainingColumn as Remaining

        self._bars: RichProgress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            Remaining(),
            console=Console(stderr=True),
        )
        self._task: TaskID | None = None

    def _begin(self, name: str, total: int) -> None:
        self._task = self._bars.add_task(name, total=total or None)

    def _update(self, done: int, total: int) -> None:
        if self._task is not None:
            self._bars.update(self._task, completed=done, total=total or None)

    def _end(self, name: str) -> None:
        if self._task is not None:
            task = self._bars.tasks[self._bars.task_ids.index(self._task)]
            total = task.total or 1
            self._bars.update(self._task, completed=total, total=total)

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        super().__exit__(kind, error, trace)
        self._bars.stop()


class NullProgress(_Display):
    """Shows nothing."""


def display(*, quiet: bool = False) -> Progress:
    """The display that suits stderr."""
    if quiet:
        return NullProgress()
    return BarProgress() if sys.stderr.isatty() else LineProgress()
