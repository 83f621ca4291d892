"""A Dask cluster simulates one campaign (extra `cluster`): it gets the same shares of pictures, strips and scans as processes do.

Every worker writes its units into the campaign's folder itself, so all must see that folder under one path, as they do on a
shared file system. Each share notes what it finished in a journal of its own: appending to one file from several machines is not
safe everywhere. The study's points are another thing (`testrange.study.execution.cluster`): their results are small and travel.
"""

import contextlib
import os
import platform
import secrets
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from campaign.config import Config
from campaign.errors import TestrangeError, WriteError
from campaign.progress import Report
from campaign.threads import THREADS_VARIABLE
from simulator.journal import Journal, finished_units
from simulator.release import release

POLL_S = 2.0
SHARES = 2  # for each worker: a slow machine leaves some of its part to the others
TOKEN = "cluster"  # beside the journal: whose run this is
_ONE_AT_A_TIME = threading.Lock()  # the renderer is one for a process

Place = tuple[str, str, str]  # folder, the share's journal, token


class ClusterError(WriteError):
    """The cluster cannot do its part: nothing is wrong with the input, and the same command may succeed later."""


class _StoppedError(Exception):
    """The run that asked for this share has ended."""


def share_on_cluster(
    config: Config, folder: Path, journal: Path, progress: Report, only: frozenset[str] | None, address: str, total: int
) -> None:
    """Have the workers of the scheduler at `address` make the units of a campaign; `total` of them, for the display.

    A unit whose worker is lost, and that Dask gives to no other, is left to the caller.

    Raises
    ------
    ClusterError
        No Dask, no scheduler, no worker; a worker that does not see the folder, has another version, or cannot run.
    """
    with _client(address) as client:
        workers = len(client.scheduler_info(n_workers=-1)["workers"])
        if not workers:
            raise ClusterError("the scheduler has no workers", where=address, remedy="start some: dask worker ADDRESS")
        count = SHARES * workers
        stage = f"{workers} cluster workers"
        progress(stage, 0, total)
        cache = config.render.cache
        shared = config.render.model_copy(update={"cache": None if cache is None else os.path.abspath(cache)})
        body = config.model_copy(update={"render": shared}).model_dump_json()
        run = secrets.token_hex(4)  # who still writes for an earlier one does not write into these
        journals = [journal.with_name(f"{journal.name}-{run}-{k}") for k in range(count)]
        with _run_of(journal, journals) as token:
            before = finished_units(folder, journal)
            futures = [
                client.submit(
                    make_share,
                    body,
                    (str(folder), str(own), token),
                    only,
                    (k, count),
                    release(),
                    key=f"testrange-{token}-{k}",
                    pure=False,
                )
                for k, own in enumerate(journals)
            ]
            try:
                while not all(future.done() for future in futures):
                    if client.status != "running":
                        raise ClusterError(
                            "the scheduler is gone", where=address, remedy="the same command goes on where it stopped"
                        )
                    time.sleep(POLL_S)
                    done = before + sum(finished_units(folder, own) - before for own in journals)
                    progress(stage, min(max(done, 0), total), total)
                _refuse_unable(futures, address)
            finally:
                for future in futures:
                    future.cancel()
        progress(stage, total, total)


def _refuse_unable(futures: list[Any], address: str) -> None:
    """What a worker says of itself. A lost worker is no reason to stop: the caller makes what is missing."""
    for future in futures:
        if future.status == "finished":
            told = future.result()
        elif future.status == "error" and type(future.exception()).__name__ != "KilledWorker":
            error = future.exception()
            told = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        else:
            continue
        if told is not None:
            raise ClusterError(
                "a worker cannot do its part",
                where=address,
                got=told,
                expected="the same testrange everywhere, and the output folder on a file system that all workers share",
            )


@contextlib.contextmanager
def _client(address: str) -> Iterator[Any]:
    from testrange.study.execution import cluster

    try:
        client, _ = cluster.connect(address)
    except TestrangeError as error:  # a campaign that was begun must outlive a scheduler that does not answer
        raise ClusterError(str(error)) from None
    try:
        yield client
    finally:
        client.close()


@contextlib.contextmanager
def _run_of(journal: Path, journals: list[Path]) -> Iterator[str]:
    """A token that workers look for, and the shares' journals: begun with what is finished, put together in the end."""
    place, token = journal.with_name(TOKEN), secrets.token_hex(8)
    for own in journals:
        own.write_bytes(journal.read_bytes() if journal.is_file() else b"")
    place.write_text(token, encoding="ascii")
    try:
        yield token
    finally:
        end_runs(journal)


def end_runs(journal: Path) -> None:
    """Nobody's shares are wanted any more; what they finished counts. Before a command goes on this ends the run of one that was
    killed, whose shares may still be at work."""
    journal.with_name(TOKEN).unlink(missing_ok=True)
    _gather(journal)


def _gather(journal: Path) -> None:
    """Lines of the shares' journals that the campaign's own does not have yet, into it."""
    known = set(journal.read_bytes().splitlines()) if journal.is_file() else set()
    for own in sorted(journal.parent.glob(f"{journal.name}-*")):
        if not own.is_file() or own.is_symlink():
            continue
        new = [line for line in own.read_bytes().splitlines() if line not in known]
        with journal.open("ab") as file:
            file.write(b"".join(b"\n" + line for line in new) + b"\n")  # the last line may have been cut
            file.flush()
            os.fsync(file.fileno())
        known.update(new)
        own.unlink()


# ---------------------------------------------------------------------------------------------------------- on a worker


def make_share(
    config: str, place: Place, only: frozenset[str] | None, share: tuple[int, int], asked: str
) -> str | None:
    """One share of a campaign's units, on a worker. What it cannot do at all, in words; a unit that fails, fails in the caller too,
    which then says so."""
    folder, journal, token = Path(place[0]), Path(place[1]), place[2]
    if release() != asked:
        return f"testrange {release()} on {platform.node()}, {asked} here"
    if not _is_wanted(journal, token):
        return f"{platform.node()} does not see {folder}"

    def still_wanted(*_: object) -> None:
        if not _is_wanted(journal, token):
            raise _StoppedError

    with _ONE_AT_A_TIME:
        os.environ[THREADS_VARIABLE] = str(
            _threads()
        )  # the renderer takes its threads when it is loaded, which is inside
        with contextlib.suppress(TestrangeError, OSError, MemoryError, _StoppedError):
            from simulator.simulate import simulate_campaign

            own = Journal(folder, journal, share=share, check=still_wanted)
            simulate_campaign(Config.model_validate_json(config), folder, still_wanted, only, own)
    return None


def _is_wanted(journal: Path, token: str) -> bool:
    try:
        return journal.with_name(TOKEN).read_text(encoding="ascii") == token
    except (OSError, ValueError):
        return False


def _threads() -> int:
    """What this worker was given; one where nobody is a worker."""
    from distributed import get_worker

    try:
        return max(1, int(get_worker().state.nthreads))
    except ValueError:
        return 1
