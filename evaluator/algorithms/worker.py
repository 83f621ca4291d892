"""The child of `apart`: imports the functions, evaluates, sends what came of it. Started by `python -m` with a pipe's number."""

import os
import sys
import time
import traceback
import warnings
from multiprocessing.connection import Connection

from campaign.errors import ConfigError, TestrangeError
from evaluator.algorithms.apart import Done, Job
from evaluator.algorithms.guard import guarded
from evaluator.algorithms.load import load_algorithms, put_current_folder_on_path, told


def work(job: Job, pipe: Connection) -> Done:
    """One job."""

    def watch(slot: str | None) -> None:
        pipe.send(("call", slot))

    watch("import")
    put_current_folder_on_path(job.campaign)
    algorithms = load_algorithms(job.names)
    watch(None)
    tools, log = guarded(algorithms, limit_s=job.call_limit_s, dead=job.dead, watch=watch, timed=job.timed)
    if job.campaign is None:
        return Done(evaluation=None, calls=log.calls)
    from evaluator.evaluate import evaluate_with
    from evaluator.scores.score_echoes import echo_errors

    start = time.perf_counter()
    evaluation = evaluate_with(
        job.campaign, lambda *stage: pipe.send(("progress", stage)), tools, log, strict=job.strict
    )
    seconds = time.perf_counter() - start
    echoes = echo_errors(job.campaign, tools.echo_decomposition) if job.echoes else None
    return Done(evaluation=evaluation, calls=log.calls, echoes=echoes, seconds=seconds)


def main() -> None:
    warnings.simplefilter("ignore")
    pipe = Connection(int(sys.argv[1]))
    try:
        _answer(pipe)
    except (BrokenPipeError, ConnectionResetError, EOFError):  # nobody listens any more
        os._exit(1)


def _answer(pipe: Connection) -> None:
    """The result, or in one line why there is none."""
    job = pipe.recv()
    try:
        pipe.send(("done", work(job, pipe)))
    except (BrokenPipeError, ConnectionResetError):
        raise
    except ConfigError as error:
        pipe.send(("config", str(error)))
    except TestrangeError as error:
        pipe.send(("error", str(error)))
    except BaseException as error:
        if os.environ.get("TESTRANGE_TRACEBACK"):
            traceback.print_exc()
        pipe.send(("error", f"internal error: {told(error)}"))


if __name__ == "__main__":
    main()
