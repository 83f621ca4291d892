"""A Dask cluster as the place of execution: the same task, the same files. Needs the extra `cluster`.

Point results come back to the study, which writes them: workers need no common disk. Where they have one, under the same path,
they share renders; elsewhere each machine renders for itself.
"""

import re
from collections.abc import Callable
from typing import Any

from campaign.errors import ConfigError
from testrange.study.execution.point import run_point
from testrange.study.execution.schedule import Outcome, Task, not_run
from testrange.study.model import StudyError

CONNECT_S = 20.0
_HOST = re.compile(r"[^\s/@?#]+")
_AHEAD = 2  # tasks at the scheduler for each thread of the cluster: a worker need not wait for the next


class Cluster:
    """A scheduler that somebody started. Implements `schedule.Places`."""

    def __init__(self, address: str, run: Callable[[Task], Outcome] = run_point) -> None:
        self._client, self._wait = connect(address)
        self._address = address
        self._given = 0
        self._run = run
        self._futures: dict[str, Any] = {}

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *_: object) -> None:
        for future in self._futures.values():
            future.cancel()
        self._client.close()

    def room(self) -> bool:
        workers: dict[str, Any] = self._client.scheduler_info(n_workers=-1)["workers"]
        threads = sum(int(w["nthreads"]) for w in workers.values())
        return len(self._futures) < max(_AHEAD * threads, 1)

    def give(self, task: Task) -> None:
        self._given += 1
        self._futures[task["id"]] = self._client.submit(
            self._run, dict(task), key=f"{task['id']}-{id(self)}-{self._given}", pure=False
        )

    def next(self) -> list[tuple[str, Outcome | None]]:
        try:
            self._wait(list(self._futures.values()), return_when="FIRST_COMPLETED")
        except Exception as error:  # its own errors, or those of the connection
            if self._client.status != "running":
                raise StudyError(
                    "the scheduler is gone", where=self._address, got=error, remedy="run the study again: it resumes"
                ) from None
        ended = [(point_id, future) for point_id, future in self._futures.items() if future.done()]
        for point_id, _ in ended:
            del self._futures[point_id]
        return [(point_id, self._outcome(point_id, future)) for point_id, future in ended]

    def _outcome(self, point_id: str, future: Any) -> Outcome | None:
        """None where the scheduler's memory of the task, or of its result, was lost. Dask itself tries a lost worker's task again
        (`distributed.scheduler.allowed-failures`)."""
        if future.status == "error":
            error = future.exception()
            if type(error).__name__ == "KilledWorker":
                return not_run(point_id, "the workers that ran it were lost, as often as the scheduler allows")
            raise StudyError(
                "a worker of the cluster cannot run testrange",
                where=self._address,
                got=f"{type(error).__name__}: {error}"[:200],
                remedy="install the same version there",
            )
        try:
            return future.result() if future.status == "finished" else None
        except Exception:  # the worker that held the result left before it was fetched
            return None


def check_address(address: str) -> None:
    """Nothing is asked of the network. A client that meets such an address itself waits long, and fails twice.

    Raises
    ------
    ConfigError
        Not HOST:PORT, by tcp or tls; no certificate for tls.
    StudyError
        Dask is not installed.
    """
    try:
        import distributed
        from distributed.comm.addressing import parse_address, parse_host_port
    except ImportError:
        raise StudyError(
            "--scheduler needs Dask, which is not installed", remedy="pip install 'testrange[cluster]'"
        ) from None
    try:
        scheme, place = parse_address(address)
        host, port = parse_host_port(place)
    except ValueError:
        scheme = host = ""
        port = 0
    if scheme not in ("tcp", "tls") or not _HOST.fullmatch(host) or not 0 < port < 65536:
        raise ConfigError(
            "is no address of a Dask scheduler",
            where="--scheduler",
            got=repr(address[:200]),
            expected="tcp://HOST:PORT, tls://HOST:PORT or HOST:PORT, for example tcp://192.0.2.7:8786",
        )
    try:
        read: Any = distributed.Security  # without types
        security = read()
        context = security.get_connection_args("client")["ssl_context"]
    except (OSError, TypeError, ValueError) as error:
        raise ConfigError(
            "Dask's own settings for TLS are wrong",
            where="distributed.comm.tls",
            got=f"{type(error).__name__}: {error}"[:200],
        ) from None
    if scheme == "tls" and context is None:
        raise ConfigError(
            "TLS needs certificates",
            where="--scheduler",
            got=repr(address),
            expected="ca-file and client.cert in Dask's settings, distributed.comm.tls",
        )
    if scheme == "tcp" and security.require_encryption:
        raise ConfigError(
            "Dask's settings ask for encryption",
            where="--scheduler",
            got=repr(address),
            expected="tls://HOST:PORT, or another distributed.comm.require-encryption",
        )


def connect(address: str) -> tuple[Any, Any]:
    """The client, and the function that waits for its futures."""
    check_address(address)
    import distributed

    try:
        client: Any = distributed.Client
        return client(address, timeout=CONNECT_S, set_as_default=False), distributed.wait
    except (OSError, RuntimeError, TimeoutError, TypeError, ValueError) as error:
        raise StudyError(
            "no Dask scheduler answers",
            where=address,
            got=f"{type(error).__name__}: {error}"[:200],
            expected="for example tcp://192.0.2.7:8786",
        ) from None
