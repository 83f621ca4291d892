"""A simulation that was stopped ends with the same bytes; so does one that several processes share."""

import hashlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from campaign.config import Config
from campaign.errors import CampaignError, ConfigError, WriteError
from campaign.writing.resume import resumable_folder
from simulator.journal import Journal, finished_units
from testrange.pipeline import simulate
from testrange.progress import no_progress

CONFTEST = Path(__file__).with_name("conftest.py")
SIMULATE = """
import importlib.util, pathlib, sys
spec = importlib.util.spec_from_file_location("micro", sys.argv[1])
micro = importlib.util.module_from_spec(spec)
spec.loader.exec_module(micro)
from testrange.pipeline import simulate
simulate(micro.micro_config(), pathlib.Path(sys.argv[2]), lambda *_: None, workers=int(sys.argv[3]))
"""


def different(a: Path, b: Path) -> set[str]:
    """Paths that only one folder has, or whose bytes differ."""
    left, right = (
        {p.relative_to(f).as_posix(): hashlib.sha256(p.read_bytes()).digest() for p in f.rglob("*") if p.is_file()}
        for f in (a, b)
    )
    return {name for name in left.keys() | right.keys() if left.get(name) != right.get(name)}


def begin(out: Path, workers: int = 1, told: int | None = None) -> "subprocess.Popen[bytes]":
    return subprocess.Popen([sys.executable, "-c", SIMULATE, str(CONFTEST), str(out), str(workers)], stdout=told)


def journal_of(out: Path) -> Path:
    return out.with_name(f".{out.name}.part") / "journal"


def lines(journal: Path) -> int:
    return journal.read_bytes().count(b"\n") if journal.is_file() else 0


def kill_at(out: Path, units: int, delay_s: float) -> bool:
    """Simulates until that many units are finished, waits, and kills. False: it had ended before, or its folder was complete."""
    process, journal = begin(out), journal_of(out)
    try:
        while process.poll() is None and lines(journal) < units:
            time.sleep(0.01)
        time.sleep(delay_s)
    finally:
        process.kill()
        ended = process.wait()
    return ended == -signal.SIGKILL and not out.is_dir()


def killed_and_resumed(out: Path, moments: list[tuple[int, float]]) -> int:
    """Kills at those moments, then lets it end; how often it was killed at work."""
    killed = sum(kill_at(out, *moment) for moment in moments)
    if not out.is_dir():
        assert begin(out).wait(timeout=300) == 0
    return killed


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system kills otherwise")
def test_five_kills(micro_campaign: Path, tmp_path: Path) -> None:
    """Rationale: a full-size campaign takes half an hour; a power cut must not cost it, nor leave a file that only looks whole.

    Expected: killed with SIGKILL in its sphere, chessboard, ranging line, picture and strip, the folder ends as an undisturbed
    one and nothing is left beside it. Tolerance: none, bytes.
    """
    chance = random.Random(20260925)
    moments = [(units, chance.uniform(0.0, 0.3)) for units in (2, 44, 58, 68, 71)]
    out = tmp_path / "campaign"
    assert killed_and_resumed(out, moments) >= 3  # the last ones may find it finished
    assert different(micro_campaign, out) == set()
    assert [p.name for p in tmp_path.iterdir()] == ["campaign"]


@pytest.mark.slow
def test_fifty_kills(micro_campaign: Path, tmp_path: Path) -> None:
    """Rationale and expectation as above, at random moments, up to five for each simulation, until fifty found it at work; one that
    comes after the end does not count. Every simulation must be interrupted at least twice."""
    killed = attempt = 0
    while killed < 50:
        chance = random.Random(attempt)
        moments = sorted((chance.randrange(0, 72), chance.uniform(0.0, 0.5)) for _ in range(5))
        out = tmp_path / f"{attempt}"
        interrupted = killed_and_resumed(out, moments)
        assert interrupted >= 2, attempt
        assert different(micro_campaign, out) == set(), attempt
        killed, attempt = killed + interrupted, attempt + 1
    assert sum(1 for _ in tmp_path.iterdir()) == attempt


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system kills otherwise")
def test_a_killed_command_with_two_workers(micro_campaign: Path, tmp_path: Path) -> None:
    """Rationale: kill -9, or a lack of memory, ends the command and not its workers, which are still writing when it goes on.

    Expected: the workers end by themselves (nobody holds the command's output any more); the next command, which is begun while
    they are there, ends with the bytes of an undisturbed one and leaves nothing beside it. Tolerance: none, bytes.
    """
    out = tmp_path / "campaign"
    process, journal = begin(out, workers=2, told=subprocess.PIPE), journal_of(out)
    try:
        while process.poll() is None and lines(journal) < 20:
            time.sleep(0.01)
    finally:
        process.kill()
        assert process.wait() == -signal.SIGKILL
    assert lines(journal) >= 20 and not out.exists()
    resumed = begin(out, workers=2)
    process.communicate(timeout=60)  # until the last orphan's end
    assert resumed.wait(timeout=300) == 0
    assert different(micro_campaign, out) == set()
    assert [p.name for p in tmp_path.iterdir()] == ["campaign"]


def test_two_workers_write_the_same_campaign(
    micro_campaign: Path, micro: Callable[..., Config], tmp_path: Path
) -> None:
    """Rationale: on a machine with many cores several processes share pictures and strips; who made which must not show.

    Expected: every file as one process writes it. Tolerance: none, bytes.
    """
    out = tmp_path / "campaign"
    simulate(micro(), out, no_progress, workers=2)
    assert different(micro_campaign, out) == set()


def test_only_what_is_complete_counts(tmp_path: Path) -> None:
    """Rationale: after a power cut the journal may end in half a line, and a file may be shorter than it was said to be.

    Expected: of four units one counts: its line is whole and its file has its size.
    """
    root, file = tmp_path / "folder", tmp_path / "journal"
    root.mkdir()
    for name in ("whole", "short", "gone", "torn"):
        (root / name).write_bytes(b"12345678")
        Journal(root, file).finish(name, [root / name])
    (root / "short").write_bytes(b"1234")
    (root / "gone").unlink()
    file.write_bytes(file.read_bytes()[:-10])
    journal = Journal(root, file)
    assert [name for name in ("whole", "short", "gone", "torn", "new") if not journal.wants(name)] == ["whole"]
    assert finished_units(root, file) == 1


def test_shares_cover_every_unit_once() -> None:
    """Rationale: a unit that two workers take is made twice, one that none takes is left to the parent alone."""
    units = [f"unit {k}" for k in range(17)]
    taken = [[u for u in units if journal.wants(u)] for journal in (Journal(share=(k, 3)) for k in range(3))]
    assert sorted(u for share in taken for u in share) == sorted(units)
    assert max(map(len, taken)) - min(map(len, taken)) == 1


@pytest.mark.parametrize(
    ("error", "kept"),
    [
        (KeyboardInterrupt(), True),
        (WriteError("no space left"), True),
        (MemoryError(), True),
        (ConfigError("no"), False),
    ],
)
def test_what_survives_a_failure(tmp_path: Path, error: BaseException, kept: bool) -> None:
    """Rationale: an interrupt, a full disk and too little memory are no fault of the input, and the same command may go on; a wrong
    configuration must leave nothing. Expected: kept or gone, and the next call of another task begins afresh."""
    target = tmp_path / "out"
    with pytest.raises(type(error)), resumable_folder(target, "task") as work:
        (work.folder / "made").write_text("1")
        (work.folder / ".made.part.tif").write_text("half")
        raise error
    assert not target.exists()
    assert (tmp_path / ".out.part").exists() is kept
    with resumable_folder(target, "task") as work:
        assert work.resumed is kept
        assert [p.name for p in work.folder.iterdir()] == (["made"] if kept else [])
        (work.folder / "more").write_text("2")
    assert sorted(p.name for p in target.iterdir()) == (["made", "more"] if kept else ["more"])


def test_another_task_begins_afresh(tmp_path: Path) -> None:
    """Rationale: what another configuration had made must not get into this campaign."""
    with pytest.raises(KeyboardInterrupt), resumable_folder(tmp_path / "out", "one") as work:
        (work.folder / "made").write_text("1")
        raise KeyboardInterrupt
    with resumable_folder(tmp_path / "out", "two") as work:
        assert not work.resumed
        assert list(work.folder.iterdir()) == []
        (work.folder / "mine").write_text("2")
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["mine"]


@pytest.mark.skipif(os.name != "posix", reason="locks are POSIX")
def test_two_commands_on_one_target(tmp_path: Path) -> None:
    """Rationale: two simulations that write into one folder would mix. Expected: the second says so in one line."""
    with resumable_folder(tmp_path / "out", "task") as work:
        (work.folder / "a").write_text("1")
        with (
            pytest.raises(CampaignError, match="another testrange is at work on it"),
            resumable_folder(tmp_path / "out", "task"),
        ):
            pass
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_target_that_was_occupied_meanwhile(tmp_path: Path) -> None:
    """Rationale: the hours of a simulation must not be lost because somebody made a folder of that name. Expected: refused in one
    line, what was made stays, and the same command ends it once the place is free.
    """
    target = tmp_path / "out"
    with (
        pytest.raises(CampaignError, match="already exists and is not empty"),
        resumable_folder(target, "task") as work,
    ):
        (work.folder / "made").write_text("1")
        target.mkdir()
        (target / "theirs").write_text("x")
    assert [p.name for p in target.iterdir()] == ["theirs"]
    (target / "theirs").unlink()
    with resumable_folder(target, "task") as work:
        assert work.resumed
    assert [p.name for p in target.iterdir()] == ["made"]


def test_links_in_a_part_folder_are_not_followed(tmp_path: Path) -> None:
    """Rationale: who may write beside the target could have our files swept and written elsewhere. Expected: a linked folder
    with the right key counts as nobody's work; what it points to stays as it is. A linked lock is refused.
    """
    elsewhere, place = tmp_path / "elsewhere", tmp_path / ".out.part"
    elsewhere.mkdir()
    (elsewhere / ".a.part.tif").write_text("precious")
    with pytest.raises(KeyboardInterrupt), resumable_folder(tmp_path / "out", "task") as work:
        raise KeyboardInterrupt
    work.folder.rmdir()
    work.folder.symlink_to(elsewhere)
    with resumable_folder(tmp_path / "out", "task") as work:
        assert not work.resumed
        (work.folder / "mine").write_text("1")
    assert [p.name for p in elsewhere.iterdir()] == [".a.part.tif"]
    assert not (tmp_path / "out").is_symlink()
    (tmp_path / "out" / "mine").unlink()
    place.mkdir()
    (place / "lock").symlink_to(elsewhere / "lock")
    with pytest.raises(CampaignError, match="is in the way"), resumable_folder(tmp_path / "out", "task"):
        pass
    assert not (elsewhere / "lock").exists()
