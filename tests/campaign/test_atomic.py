"""Folders and files appear complete or not at all."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from campaign.errors import CampaignError
from campaign.writing.atomic import complete_file, complete_folder
from campaign.writing.resume import resumable_folder, sweep


def test_a_folder_appears_only_when_complete(tmp_path: Path) -> None:
    target = tmp_path / "sub" / "out"
    with complete_folder(target) as work:
        (work / "a").write_text("1")
        assert not target.exists()
    assert (target / "a").read_text() == "1"
    assert [p.name for p in target.parent.iterdir()] == ["out"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_nothing_is_left_after_a_failure(tmp_path: Path, error: type[BaseException]) -> None:
    with pytest.raises(error), complete_folder(tmp_path / "out") as work:
        (work / "a").write_text("1")
        raise error
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="no space left on the disk"), complete_folder(tmp_path / "out"):
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(CampaignError, match="no space left on the disk"), complete_file(tmp_path / "f.csv") as work:
        work.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_an_occupied_target_is_kept(tmp_path: Path) -> None:
    """Rationale: deleting a user's folder is the worst that a tool can do."""
    target = tmp_path / "out"
    target.mkdir()
    (target / "thesis.tex").write_text("years of work")
    with pytest.raises(CampaignError, match="already exists"), complete_folder(target):
        pass
    with pytest.raises(CampaignError, match="does not look like"), complete_folder(target, replace=True):
        pass
    assert (target / "thesis.tex").read_text() == "years of work"
    (tmp_path / "link").symlink_to(target)
    with pytest.raises(CampaignError, match="is not a folder"), complete_folder(tmp_path / "link", replace=True):
        pass


def test_replace_swaps_our_own_folder_only_when_the_new_one_is_complete(tmp_path: Path) -> None:
    target = tmp_path / "out"
    target.mkdir()
    (target / "manifest.json").write_text("old")
    with pytest.raises(ValueError), complete_folder(target, replace=True) as work:
        (work / "manifest.json").write_text("new")
        raise ValueError
    assert (target / "manifest.json").read_text() == "old"
    with complete_folder(target, replace=True) as work:
        (work / "manifest.json").write_text("new")
    assert (target / "manifest.json").read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_an_unwritable_place_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CampaignError, match="cannot be written"), complete_folder(tmp_path / "file" / "out"):
        pass


@pytest.mark.parametrize("place", ["/", ".", "..", "folder"])
def test_a_file_to_write_has_a_name(tmp_path: Path, place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: `view --out /` ended in an internal error, and a folder of that name was found out only when all was written.
    Expected: one line, before the work."""
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CampaignError, match="is a folder"), complete_file(Path(place)):
        raise AssertionError("the work began")


def test_two_writers_of_one_file(tmp_path: Path) -> None:
    """Rationale: what a killed command left at work on another machine may write a picture at the same time as the command that
    goes on. Expected: the file is never half of one; the names keep the suffix, and a sweep finds them."""
    target = tmp_path / "p.tif"
    with complete_file(target) as orphan:
        orphan.write_text("wh")
        with complete_file(target) as work:
            assert work != orphan and work.suffix == orphan.suffix == ".tif"
            work.write_text("whole")
        assert target.read_text() == "whole"
        orphan.write_text("whole")
    assert [p.name for p in tmp_path.iterdir()] == ["p.tif"]
    with pytest.raises(CampaignError, match="is gone"), complete_file(target) as orphan:
        orphan.write_text("wh")
        sweep(tmp_path)
        assert [p.name for p in tmp_path.iterdir()] == ["p.tif"]
        raise CampaignError("its file is gone", where="p.tif")
    assert target.read_text() == "whole"


@pytest.mark.skipif(os.name != "posix", reason="folders cannot be synced elsewhere")
@pytest.mark.parametrize("replace", [False, True])
def test_a_folder_is_on_the_disk_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, replace: bool
) -> None:
    """Rationale: after a power cut a folder that looks complete must be; the journal syncs units only, not the manifest.

    Expected: every file and folder is synced before the rename, the parent after it; a link's and a pipe's end are left alone.
    """
    target, events = tmp_path / "out", []
    if replace:
        target.mkdir()
        (target / "manifest.json").write_text("old")
    sync, rename = os.fsync, Path.rename

    def synced(number: int) -> None:
        events.append(os.readlink(f"/dev/fd/{number}") if sys.platform == "linux" else os.fstat(number).st_ino)
        sync(number)

    def renamed(old: Path, new: Path) -> Path:
        events.append("renamed" if new == target else "put aside")
        return rename(old, new)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Path, "rename", renamed)
    with complete_folder(target, replace=replace) as work:
        (work / "truth").mkdir()
        (work / "manifest.json").write_text("{}")
        (work / "truth" / "truth.json").write_text("{}")
        (work / "link").symlink_to(tmp_path)
        os.mkfifo(work / "pipe")
        inside = [work / "truth", work / "manifest.json", work / "truth" / "truth.json", work, tmp_path]
        known = [str(p) if sys.platform == "linux" else p.stat().st_ino for p in inside]
    at = events.index("renamed")
    assert set(events[:at]) - {"put aside"} == set(known[:-1])
    assert events[at + 1 :] == known[-1:]


KILLED = """
import os, pathlib, signal, sys
from campaign.writing.atomic import complete_folder
rename, done = pathlib.Path.rename, []
def stops(old, new):
    if done:
        os.kill(os.getpid(), signal.SIGKILL)
    done.append(rename(old, new))
pathlib.Path.rename = stops
with complete_folder(pathlib.Path(sys.argv[1]), replace=True) as work:
    (work / "manifest.json").write_text("new")
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system kills otherwise")
def test_a_kill_between_the_two_renames(tmp_path: Path) -> None:
    """Rationale: there the target has no name, and the replaced campaign lies in a hidden folder that nobody looks into.

    Expected: the next command on the target puts it back, and refuses to go over it unless told to; what is left beside a target
    that stands is deleted. What others named much like it, a link, and a folder with more in it stay.
    """
    target = tmp_path / "out"
    target.mkdir()
    (target / "manifest.json").write_text("old")
    assert subprocess.run([sys.executable, "-c", KILLED, str(target)]).returncode == -signal.SIGKILL
    [kept] = tmp_path.glob(".out.*.old")
    assert not target.exists() and (kept / "old" / "manifest.json").read_text() == "old"
    with pytest.raises(CampaignError, match="already exists"), resumable_folder(target, "task"):
        raise AssertionError("the work began")
    assert (target / "manifest.json").read_text() == "old"
    assert list(tmp_path.glob(".out.*old")) == [] and not (tmp_path / ".out.part").exists()

    precious = tmp_path / "precious" / "old"
    precious.mkdir(parents=True)
    (precious / "manifest.json").write_text("x")
    theirs = [
        tmp_path / name for name in (".out.2024.old", ".out.backups1.old", ".out.x.abcdefgh.old", ".out.abcdefgh.old")
    ]
    for place in theirs[:3]:
        (place / "old").mkdir(parents=True)
        (place / "old" / "manifest.json").write_text("x")
    (theirs[1] / "more").write_text("x")
    theirs[3].symlink_to(precious.parent)
    (kept / "old").mkdir(parents=True)
    (kept / "old" / "half").write_text("x")
    with resumable_folder(target, "task", replace=True) as work:
        assert not kept.exists()
        (work.folder / "manifest.json").write_text("new")
    assert (target / "manifest.json").read_text() == "new"
    assert (precious / "manifest.json").exists() and all((place / "old" / "manifest.json").exists() for place in theirs)
