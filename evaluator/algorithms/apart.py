"""An evaluation in a process of its own, which is ended when an algorithm in it never returns or takes the process down.

The child (`worker`) tells this side through a pipe when a call begins and ends. A call that its own alarm did not end is ended
here with the whole process, and the evaluation begins again without that algorithm, so that all else is evaluated. The child
runs functions that the user named; the pipe carries pickles between the two halves of one program, of one user.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.errors import ConfigError
from campaign.progress import Report, silent
from evaluator.algorithms.guard import CALL_LIMIT_S, Calls, took_too_long
from evaluator.model import EvaluationError

if TYPE_CHECKING:  # the child that only imports a function shall not wait for what evaluates
    from evaluator.results import Evaluation
    from evaluator.scores.score_echoes import EchoErrors

RUN_LIMIT_S = 4.0 * 3600.0
_GRACE_S = 2.0  # after which a call that its alarm should have ended is ended with its process
_START_S = 180.0  # for the interpreter and our own imports, on a busy machine


@dataclass(frozen=True, kw_only=True)
class Job:
    """What the child does."""

    names: Mapping[str, str]  # slot -> package.module:function
    campaign: Path | None  # None: import the functions, and no more
    strict: bool = False
    call_limit_s: float = CALL_LIMIT_S
    dead: Mapping[str, str] = field(default_factory=dict)  # slot -> why it is not called
    echoes: bool = False  # compare echoes with truth/ too
    timed: tuple[str, ...] = ()  # slots whose calls are counted though they hold our own


@dataclass(frozen=True, kw_only=True)
class Done:
    """What the child gave."""

    evaluation: "Evaluation | None"
    calls: Mapping[str, Calls]
    echoes: "EchoErrors | None" = None
    seconds: float = 0.0  # of the evaluation, without the start of the process


class _Ended(Exception):
    """The child ended during a call, or was ended."""

    def __init__(self, slot: str | None, how: str) -> None:
        super().__init__(how)
        self.slot, self.how = slot, how


def evaluate_apart(
    job: Job, progress: Report = silent, *, start_limit_s: float = _START_S, run_limit_s: float = RUN_LIMIT_S
) -> Done:
    """Runs a job; again without the algorithm that hung or ended the process, as often as there are slots.

    Parameters
    ----------
    job : Job
    progress : callable
    start_limit_s, run_limit_s : float
        For the start of the child, and for the whole. [s]

    Raises
    ------
    ConfigError
        A function cannot be imported.
    EvaluationError
        The evaluation itself cannot be done; or the child ended outside any algorithm, or took longer than `run_limit_s`.
    """
    dead = dict(job.dead)
    until = time.monotonic() + run_limit_s
    while True:
        now = Job(**{**vars(job), "dead": dead})
        try:
            return _run(now, progress, start_limit_s, until, run_limit_s)
        except _Ended as end:
            if end.slot is None or end.slot in dead:
                where = str(job.campaign) if job.campaign is not None else None
                raise EvaluationError(f"the evaluation's process {end.how}", where=where) from None
            dead[end.slot] = end.how


def _run(job: Job, progress: Report, start_limit_s: float, until: float, run_limit_s: float) -> Done:
    ours, theirs = Pipe()
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "evaluator.algorithms.worker", str(theirs.fileno())],
        pass_fds=(theirs.fileno(),),
        stdin=subprocess.DEVNULL,
        stdout=2,  # what a function prints is for people; stdout may be JSON
        start_new_session=True,
    )
    theirs.close()
    try:
        ours.send(job)
        return _listen(ours, process, job, progress, start_limit_s, until, run_limit_s)
    except (EOFError, OSError):
        process.wait(_GRACE_S * 5)
        raise _Ended(None, _how(process)) from None
    finally:
        end_group(process)
        ours.close()


def _listen(
    pipe: Connection,
    process: "subprocess.Popen[bytes]",
    job: Job,
    progress: Report,
    start_limit_s: float,
    until: float,
    run_limit_s: float,
) -> Done:
    """Until the result is there; knows at every moment which slot is being called, and since when."""
    slot: str | None = None
    limit, begun = time.monotonic() + start_limit_s, False
    while True:
        try:
            heard = pipe.poll(max(min(limit, until) - time.monotonic(), 0.0))
        except (EOFError, OSError):
            heard = True
        if not heard:
            if time.monotonic() >= until:
                raise EvaluationError(f"the evaluation took longer than {run_limit_s:g} s and was stopped")
            if slot == "import":
                raise ConfigError(
                    f"importing the algorithms took longer than {job.call_limit_s:g} s and was stopped",
                    where=", ".join(job.names.values()),
                )
            raise _Ended(slot, took_too_long(job.call_limit_s) if begun else "did not start")
        try:
            kind, what = pipe.recv()
        except (EOFError, OSError):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_GRACE_S * 5)
            raise _Ended(None if slot == "import" else slot, _how(process)) from None
        if kind == "progress":
            progress(*what)
        elif kind == "call":
            begun, slot = True, what
            limit = until if what is None else time.monotonic() + job.call_limit_s + _GRACE_S
        elif kind == "done":
            return what
        elif kind == "config":
            raise ConfigError(what)
        else:
            raise EvaluationError(what)


def _how(process: "subprocess.Popen[bytes]") -> str:
    """How a process ended, in words."""
    code = process.poll()
    if code is None:
        return "closed its pipe"
    if code < 0:
        try:
            return f"ended the process by {signal.Signals(-code).name}"
        except ValueError:
            return f"ended the process by signal {-code}"
    return f"ended the process with code {code}"


def end_group(process: "subprocess.Popen[bytes]") -> None:
    """Ends a process that leads a session of its own, with all that it started."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_GRACE_S * 5)
