"""Every call of an algorithm that is not ours: timed, checked, and stopped at a limit; a failure is told and counted.

A failure never becomes the evaluator's own result: what the algorithm did not give is missing. Stopping at the limit is by
SIGALRM, which a function that waits in compiled code does not see; then `apart` ends the whole process.
"""

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from evaluator.algorithms.check import CHECKS, MAY_DECLINE, Wrong
from evaluator.algorithms.load import told
from evaluator.algorithms.record import OWN_TOOLS, SLOTS, Algorithms, Tools
from evaluator.algorithms.slots import AlgorithmFailure

CALL_LIMIT_S = 60.0
_LONGEST_REASON = 200
_MOST_REASONS = 4  # of one slot that are told


class _TimeUp(BaseException):
    """Past every `except Exception` of the algorithm's."""


@dataclass(kw_only=True)
class Calls:
    """What became of the calls of one slot."""

    name: str | None = None  # None: our own
    count: int = 0
    seconds: float = 0.0
    failures: dict[str, int] = field(default_factory=dict)  # what -> how often
    dead: str | None = None  # why it is not called any more

    @property
    def failed(self) -> int:
        return sum(self.failures.values())


@dataclass(frozen=True, kw_only=True)
class Log:
    """Calls by slot."""

    calls: Mapping[str, Calls]

    def problems(self) -> list[str]:
        """ "<slot> <name>: what", each once, with how many calls it met; the first of many."""
        lines = []
        for slot, c in self.calls.items():
            told_of = list(c.failures.items())[:_MOST_REASONS]
            lines += [f"{slot} {c.name}: {what} ({times} of {c.count} calls)" for what, times in told_of]
            rest = c.failed - sum(times for _, times in told_of)
            lines += [f"{slot} {c.name}: failed otherwise ({rest} of {c.count} calls)"] if rest else []
        return lines


@contextlib.contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Raises _TimeUp in the block after `seconds`, where this thread gets signals."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    def stop(number: int, frame: object) -> None:
        raise _TimeUp

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _silent(slot: str | None) -> None:
    """Nobody watches."""


def _wrapped(
    slot: str, function: Callable[[Any], Any], calls: Calls, limit_s: float, watch: Callable[[str | None], None]
) -> Callable[[Any], Any]:
    """`function` under guard; of our own only the time is taken."""
    check = CHECKS[slot]

    def own(task: Any) -> Any:
        start = time.perf_counter()
        try:
            return function(task)
        finally:
            calls.count += 1
            calls.seconds += time.perf_counter() - start

    def guarded_call(task: Any) -> Any:
        calls.count += 1
        if calls.dead is not None:
            calls.failures[calls.dead] = calls.failures.get(calls.dead, 0) + 1
            raise AlgorithmFailure(calls.dead, where=f"{slot} {calls.name}")
        start = time.perf_counter()
        watch(slot)
        try:
            with _limited(limit_s):
                answer = function(task)
            if isinstance(answer, str) and slot in MAY_DECLINE:
                return " ".join(answer.split())[:_LONGEST_REASON] or "no reason given"
            return check(answer, task)
        except KeyboardInterrupt:
            raise
        except _TimeUp:
            what = calls.dead = took_too_long(limit_s)
        except Wrong as error:
            what = str(error)
        except BaseException as error:
            what = f"raised {told(error)}"
        finally:
            watch(None)
            calls.seconds += time.perf_counter() - start
        calls.failures[what] = calls.failures.get(what, 0) + 1
        raise AlgorithmFailure(what, where=f"{slot} {calls.name}")

    return own if calls.name is None else guarded_call


def took_too_long(limit_s: float) -> str:
    """The reason of an algorithm that was stopped."""
    return f"a call took longer than {limit_s:g} s and was stopped"


def guarded(
    algorithms: Algorithms,
    *,
    limit_s: float = CALL_LIMIT_S,
    dead: Mapping[str, str] | None = None,
    watch: Callable[[str | None], None] = _silent,
    timed: tuple[str, ...] = (),
) -> tuple[Tools, Log]:
    """The record as the evaluator's rooms call it.

    Parameters
    ----------
    algorithms : Algorithms
    limit_s : float
        Longest call. After one that is longer the slot is not called again. [s]
    dead : mapping, optional
        slot -> why its algorithm is not called at all.
    watch : callable
        Told the slot when a call begins, and None when it ends.
    timed : tuple of str
        Slots whose calls are counted though they hold our own.
    """
    tools: dict[str, Any] = {}
    calls: dict[str, Calls] = {}
    own = Algorithms()
    for slot in SLOTS:
        function, name = getattr(algorithms, slot), algorithms.names.get(slot)
        if function is not getattr(own, slot) and name is None:
            name = (
                f"{getattr(function, '__module__', '?')}:{getattr(function, '__qualname__', type(function).__name__)}"
            )
        if name is None and (slot not in timed or getattr(OWN_TOOLS, slot) is None):
            tools[slot] = getattr(OWN_TOOLS, slot)
            continue
        calls[slot] = Calls(name=name, dead=(dead or {}).get(slot))
        tools[slot] = _wrapped(slot, function, calls[slot], limit_s, watch)
    replaced = {slot: c.name for slot, c in calls.items() if c.name is not None}
    return Tools(**tools, replaced=replaced), Log(calls=calls)
