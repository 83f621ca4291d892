"""A campaign that a Dask cluster shares has the bytes of one process's; what goes wrong with the cluster costs nothing."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from campaign.config import Config
from campaign.writing.resume import resumable_folder
from simulator.journal import Journal, finished_units
from simulator.release import release
from testrange import cluster as on_cluster
from testrange.cluster import ClusterError, make_share
from testrange.pipeline import simulate
from testrange.progress import no_progress
from testrange.study.execution import cluster as connection
from testrange.workers import simulate_units

distributed = pytest.importorskip("distributed")
RELEASE = release()


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.fixture
def cluster() -> Iterator[Any]:
    """A scheduler with two workers of one thread, each its own process, on loopback."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as started:
        yield started


def begin(folder: Path) -> tuple[Path, Path]:
    (folder / "work").mkdir(parents=True)
    return folder / "work", folder / "journal"


@pytest.mark.slow
@pytest.mark.parametrize("kill", [False, True])
def test_a_cluster_writes_the_same_campaign(
    micro_campaign: Path, micro: Callable[..., Config], tmp_path: Path, cluster: Any, kill: bool
) -> None:
    """Rationale: a laboratory's machines share a disk; who made which picture must not show, and nodes are lost.

    Expected: every file as one process writes it, also where both workers are killed by kill -9 after the tenth unit; the parent
    finds at least that many units finished; nothing but folder and journal is left. Tolerance: none, bytes.
    """
    folder, journal = begin(tmp_path)
    made: list[int] = []
    killed = threading.Event()

    def watch(stage: str, done: int, total: int) -> None:
        if "cluster" in stage:
            made.append(done)
            if kill and done >= 10 and not killed.is_set():
                killed.set()
                for worker in cluster.workers.values():
                    os.kill(worker.pid, signal.SIGKILL)

    simulate_units(micro(), folder, journal, watch, scheduler=cluster.scheduler_address)
    assert killed.is_set() is kill
    assert max(made[:-1]) >= 10
    assert digests(folder) == digests(micro_campaign)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["journal", "work"]


KILLED = """
import pathlib, sys
from campaign.config import Config
from testrange.pipeline import simulate
config = Config.model_validate_json(pathlib.Path(sys.argv[1]).read_bytes())
simulate(config, pathlib.Path(sys.argv[2]), lambda *_: None, scheduler=sys.argv[3])
"""


@pytest.mark.slow
def test_a_killed_command_leaves_its_shares_at_work(
    micro_campaign: Path, micro: Callable[..., Config], tmp_path: Path, cluster: Any
) -> None:
    """Rationale: Dask's workers outlive the command that is killed, and write the files that the next one writes without them.

    Expected: the command that goes on while they are at work counts what they noted, and ends with the bytes of an undisturbed
    one; when the workers have nothing to do any more nothing but the campaign is there. Tolerance: none, bytes.
    """
    out, body = tmp_path / "campaign", tmp_path / "micro.json"
    body.write_text(micro().model_dump_json())
    place = tmp_path / ".campaign.part"
    command = subprocess.Popen([sys.executable, "-c", KILLED, str(body), str(out), cluster.scheduler_address])
    try:
        while command.poll() is None and sum(finished_units(*j) for j in noted(place)) < 20:
            time.sleep(0.05)
    finally:
        command.kill()
        assert command.wait() == -signal.SIGKILL
    assert (place / on_cluster.TOKEN).is_file()
    simulate(micro(), out, no_progress)
    assert digests(out) == digests(micro_campaign)
    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        while any(client.processing().values()):
            time.sleep(0.05)
    assert digests(out) == digests(micro_campaign)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["campaign", "micro.json"]


def noted(place: Path) -> list[tuple[Path, Path]]:
    """The folder in the making with each journal of a share."""
    return [(folder, own) for folder in place.glob("folder-*") for own in place.glob("journal-*")]


def test_a_scheduler_that_does_not_answer_costs_nothing(
    micro: Callable[..., Config], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: the command that goes on after an interrupt may meet a cluster that is down. Expected: one line, and what was made
    before is still there."""
    monkeypatch.setattr(connection, "CONNECT_S", 0.5)
    with pytest.raises(KeyboardInterrupt), resumable_folder(tmp_path / "out", "task") as work:
        made = work.folder / "made"
        made.write_text("hours")
        raise KeyboardInterrupt
    with (
        pytest.raises(ClusterError, match="no Dask scheduler answers") as told,
        resumable_folder(tmp_path / "out", "task") as work,
    ):
        simulate_units(micro(), work.folder, work.journal, no_progress, scheduler="tcp://127.0.0.1:9")
    assert "\n" not in str(told.value)
    assert made.read_text() == "hours"


def test_without_the_extra(micro: Callable[..., Config], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Expected: the error names what to install."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    folder, journal = begin(tmp_path)
    with pytest.raises(ClusterError, match=r"testrange\[cluster\]"):
        simulate_units(micro(), folder, journal, no_progress, scheduler="tcp://127.0.0.1:9")


def test_a_worker_that_cannot(micro: Callable[..., Config], tmp_path: Path) -> None:
    """Rationale: without a shared file system every share would be made somewhere else and lost, and another release writes other
    bytes. Expected: both are told in words, and nothing is written."""
    body, place = micro().model_dump_json(), (str(tmp_path / "work"), str(tmp_path / "journal-0"), "token")
    assert "does not see" in str(make_share(body, place, None, (0, 2), RELEASE))
    (tmp_path / on_cluster.TOKEN).write_text("another run's")
    assert "does not see" in str(make_share(body, place, None, (0, 2), RELEASE))
    assert "0.0.1 here" in str(make_share(body, place, None, (0, 2), "0.0.1"))
    assert [p.name for p in tmp_path.iterdir()] == [on_cluster.TOKEN]


def test_a_share_stops_when_its_run_has_ended(
    micro: Callable[..., Config], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: Dask cannot end a task that runs, and another command may be at work on the folder by then. Expected: the share
    ends at the next step after its run's token is gone, and does not fail."""
    steps = []

    def simulate(config: Config, folder: Path, progress: Callable[..., None], only: object, journal: Journal) -> None:
        assert journal.shares
        for k in range(5):
            steps.append(k)
            if k == 2:
                (tmp_path / on_cluster.TOKEN).unlink()
            progress("camera", k, 5)

    monkeypatch.setattr("simulator.simulate.simulate_campaign", simulate)
    monkeypatch.setattr(on_cluster, "_threads", lambda: 1)
    monkeypatch.setenv("TESTRANGE_THREADS", "1")
    (tmp_path / on_cluster.TOKEN).write_text("token")
    place = (str(tmp_path), str(tmp_path / "journal-0"), "token")
    assert make_share(micro().model_dump_json(), place, None, (0, 2), RELEASE) is None
    assert steps == [0, 1, 2]


def test_journals_of_shares_are_put_together(tmp_path: Path) -> None:
    """Rationale: a run that was killed leaves its shares' journals, one of them cut. Expected: every whole line counts once,
    the share begins with what is known, and nothing is left beside the journal."""
    root, journal = begin(tmp_path)
    for name in ("a", "b", "c"):
        (root / name).write_text("x")
    Journal(root, journal).finish("a", [root / "a"])
    left = tmp_path / "journal-7"
    left.write_bytes(journal.read_bytes())
    Journal(root, left).finish("b", [root / "b"])
    left.write_bytes(left.read_bytes() + b'{"unit": "c", "fi')
    on_cluster.end_runs(journal)
    own = tmp_path / "journal-0"
    with on_cluster._run_of(journal, [own]) as token:
        assert token == (tmp_path / on_cluster.TOKEN).read_text()
        assert finished_units(root, own) == 2
        share = Journal(root, own)
        assert [share.wants(name) for name in "abc"] == [False, False, True]
        share.finish("c", [root / "c"])
    assert finished_units(root, journal) == 3
    lines = [line for line in journal.read_bytes().splitlines() if line.endswith(b"}}")]
    assert sorted(json.loads(line)["unit"] for line in lines) == ["a", "b", "c"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["journal", "work"]


@pytest.mark.parametrize("scheduler", [None, "tcp://127.0.0.1:9"])
def test_going_on_ends_the_run_of_a_killed_command(
    micro: Callable[..., Config], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scheduler: str | None
) -> None:
    """Rationale: a command that is killed cannot take its token away, and its shares go on; the command that goes on may do so
    without a cluster. Expected: before it makes anything the shares' token is gone, what they noted counts and what they, or a
    lost worker, had half written is removed; a unit that a share ends after that is not noted."""
    root, journal = begin(tmp_path)
    for name in ("a", "b", ".c.part-7-0a.tif"):
        (root / name).write_text("x")
    (tmp_path / on_cluster.TOKEN).write_text("token")
    own = tmp_path / "journal-0123abcd-3"

    def still_wanted() -> None:
        if not on_cluster._is_wanted(own, "token"):
            raise on_cluster._StoppedError

    share = Journal(root, own, share=(3, 4), check=still_wanted)
    share.finish("a", [root / "a"])
    seen = []

    def simulate(config: Config, folder: Path, progress: object, only: object, known: Journal) -> None:
        seen.append(sorted(p.name for p in folder.iterdir()))
        assert [known.wants(name) for name in "ab"] == [False, True]
        with pytest.raises(on_cluster._StoppedError):
            share.finish("b", [root / "b"])

    monkeypatch.setattr("simulator.simulate.simulate_campaign", simulate)
    monkeypatch.setattr("testrange.workers.share_on_cluster", lambda *_: None)
    simulate_units(micro(), root, journal, no_progress, scheduler=scheduler)
    assert seen == [["a", "b"]]
    assert finished_units(root, journal) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["journal", "work"]


def test_a_share_notes_nothing_that_nobody_asks_for(
    micro: Callable[..., Config], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: a strip takes minutes, and the run may have ended meanwhile. Expected: the share looks for its token once more
    before it notes the strip, and ends."""
    root, _ = begin(tmp_path)
    (root / "strip").write_text("x")
    steps = []

    def simulate(config: Config, folder: Path, progress: Callable[..., None], only: object, journal: Journal) -> None:
        progress("lidar", 0, 2)
        journal.finish("first", [folder / "strip"])
        (tmp_path / on_cluster.TOKEN).write_text("another run's")
        steps.append("written")
        journal.finish("second", [folder / "strip"])
        steps.append("noted")

    monkeypatch.setattr("simulator.simulate.simulate_campaign", simulate)
    monkeypatch.setattr(on_cluster, "_threads", lambda: 1)
    monkeypatch.setenv("TESTRANGE_THREADS", "1")
    (tmp_path / on_cluster.TOKEN).write_text("token")
    own = tmp_path / "journal-0"
    assert make_share(micro().model_dump_json(), (str(root), str(own), "token"), None, (0, 2), RELEASE) is None
    assert steps == ["written"]
    assert finished_units(root, own) == 1
