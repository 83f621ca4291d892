"""Studies: flight, sensors, light or errors varied, and what the indicators do."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from testrange.commands.options import Json, Quiet, Settings, print_json


def study(
    source: Annotated[str, Parameter(name="STUDY")],
    /,
    *,
    out: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    shard: str | None = None,
    retry_failed: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    drop_cache: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    set_: Settings = (),
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Vary a campaign and see what the indicators do: table.parquet, figures and study.html. docs/studies.md shows how.

    A study that was stopped goes on where it was: what is finished in its folder is never run again.

    Parameters
    ----------
    source
        A TOML file, or the name of one in configs/studies.
    out
        Folder of the study, out/studies/NAME by default.
    workers
        Processes on this machine, one thread each; by default as many as there are cores.
    scheduler
        Address of a Dask scheduler (tcp://HOST:8786) to run the points there instead (extra `cluster`).
    shard
        i/N: only the i-th of N parts, for array jobs; the same command without it, afterwards, makes table and page.
    retry_failed
        Run points again that failed before.
    drop_cache
        Remove the renders that points share, which are kept for the next call.
    """
    from testrange.progress import display
    from testrange.refusals import refuse_scheduler
    from testrange.study.report.tell import print_done, summary
    from testrange.study.run import run_study

    refuse_scheduler(scheduler, workers)
    with display(quiet=quiet) as progress:
        done = run_study(
            source,
            out,
            progress,
            settings=set_,
            workers=workers,
            scheduler=scheduler,
            shard=shard,
            retry_failed=retry_failed,
            drop_cache=drop_cache,
        )
    if json:
        print_json(summary(done))
    else:
        print_done(done)
    return 0
