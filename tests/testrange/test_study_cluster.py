"""A study on a Dask cluster (extra `cluster`): the same table as by processes, also when a worker is lost."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from campaign.errors import TestrangeError
from testrange.study.execution import cluster as execution
from testrange.study.run import Done, run_study

distributed = pytest.importorskip("distributed")
CALLABLES = Path(__file__).with_name("study_callables.py")


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """A scheduler with two workers of one thread, each its own process; the address."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as started:
        yield started.scheduler_address


@pytest.fixture(autouse=True)
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes longer than these studies."""
    monkeypatch.setattr("testrange.study.report.page._pictures", lambda *_: [])


def study(folder: Path, function: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / CALLABLES.name).write_bytes(CALLABLES.read_bytes())
    (folder / "s.toml").write_text(
        f'title = "t"\ncallable = "study_callables:{function}"\nresponses = ["y"]\nreplicates = 2\n'
        '[[factor]]\nname = "a"\nvalues = [1.0, 2.0, 3.0]\n[[factor]]\nname = "b"\nvalues = [0.0, 1.0]\n'
    )
    return folder / "s.toml"


def rows(done: Done) -> dict[str, list[object]]:
    """All columns but the run time."""
    return {k: v for k, v in pq.read_table(done.out / "table.parquet").to_pydict().items() if k != "run_time_s"}


def test_the_same_table_although_a_worker_is_lost(cluster: str, tmp_path: Path) -> None:
    """Rationale: nodes are drained and run out of memory. Expected: two workers die by kill -9 in the middle of a point, the points
    are run again, and the table is that of one process on this machine which runs after them (their marks remain)."""
    file = study(tmp_path, "kills_its_worker_once")
    done = run_study(file, tmp_path / "cluster", scheduler=cluster)
    assert len(list(tmp_path.glob("killed-*"))) == 2
    assert (done.ran, done.count("done")) == (12, 12)
    assert rows(done) == rows(run_study(file, tmp_path / "processes", workers=1))
    assert run_study(file, tmp_path / "cluster", scheduler=cluster).ran == 0


def test_a_scheduler_that_does_not_answer_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "CONNECT_S", 0.5)
    with pytest.raises(TestrangeError, match="no Dask scheduler answers") as told:
        run_study(study(tmp_path, "additive"), tmp_path / "out", scheduler="tcp://127.0.0.1:9")
    assert "\n" not in str(told.value)


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Expected: the error names what to install."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(TestrangeError, match=r"testrange\[cluster\]"):
        run_study(study(tmp_path, "additive"), tmp_path / "out", scheduler="tcp://127.0.0.1:9")
