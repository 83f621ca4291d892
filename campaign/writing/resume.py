"""Folders that take long to make: written beside the target, kept when the work is interrupted, renamed when it is done.

`complete_folder` of `atomic` forgets what an interrupted command had made; here it waits for the same command to go on.
"""

import contextlib
import hashlib
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from campaign.errors import CampaignError, WriteError
from campaign.writing.atomic import check_target, put_in_place, readable_os_errors, settle_replaced

try:
    import fcntl
except ImportError:  # not on every system; there two commands on one target are the user's affair
    fcntl = None  # type: ignore[assignment]

_KEY, _LOCK, _JOURNAL, _FOLDER = "key", "lock", "journal", "folder"


@dataclass(frozen=True, kw_only=True)
class Work:
    """A folder in the making."""

    folder: Path  # becomes the target
    journal: Path  # beside it: what is finished
    resumed: bool  # an earlier command of the same kind had begun


@contextlib.contextmanager
def resumable_folder(target: Path, task: str, replace: bool = False) -> Iterator[Work]:
    """Give a folder beside `target` (`.NAME.part/`); rename it when the block ends.

    An interrupt, a killed process, a full disk and too little memory leave it there, and the next call with the same `task` finds
    what was made; any other failure removes it, and so does a call with another task.

    Parameters
    ----------
    task : str
        All that decides what the folder will hold.
    replace : bool
        As in `complete_folder`.

    Raises
    ------
    CampaignError
        The target is occupied, or another process is at work on it.
    WriteError
        The disk is full or not writable.
    """
    target = Path(os.path.abspath(target))
    check_target(target, replace)
    place = target.with_name(f".{target.name}.part")
    with readable_os_errors(target), _locked(place, target):
        _settle(place, target, replace)
        resumed = _belongs(place, task)
        work = Work(folder=place / _folder_of(task), journal=place / _JOURNAL, resumed=resumed)
        if resumed:
            sweep(work.folder)
        else:
            _clear(place)
            work.folder.mkdir()
            (place / _KEY).write_text(_digest(task), encoding="ascii")
        try:
            yield work
        except (KeyboardInterrupt, MemoryError, OSError, WriteError):
            raise
        except BaseException:
            shutil.rmtree(place, ignore_errors=True)
            raise
        put_in_place(work.folder, target, replace)  # where the target was occupied meanwhile, the work waits
        shutil.rmtree(place, ignore_errors=True)


def _digest(task: str) -> str:
    return hashlib.sha256(task.encode()).hexdigest()


def _folder_of(task: str) -> str:
    """Another one for each task: who still writes for an earlier command with another configuration does not write here."""
    return f"{_FOLDER}-{_digest(task)[:12]}"


def _settle(place: Path, target: Path, replace: bool) -> None:
    """A command that was killed while it replaced the target may have left it beside its place."""
    settle_replaced(target)
    try:
        check_target(target, replace)  # it may be back
    except CampaignError:
        if not (place / _KEY).exists():
            shutil.rmtree(place, ignore_errors=True)
        raise


def _belongs(place: Path, task: str) -> bool:
    key, folder = place / _KEY, place / _folder_of(task)
    if any(p.is_symlink() for p in (key, folder, place / _JOURNAL)):  # nothing that we made
        return False
    return key.is_file() and folder.is_dir() and key.read_bytes()[:64] == _digest(task).encode()


def _clear(place: Path) -> None:
    """Everything but the lock, which is held."""
    for path in place.iterdir():
        if path.name == _LOCK:
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def sweep(folder: Path) -> None:
    """Remove files that were being written when their writer stopped (see `part_of`). One that still writes fails at its end."""
    for path in folder.rglob(".*.part*"):
        if path.is_file() and not path.is_symlink():
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def _locked(place: Path, target: Path) -> Iterator[None]:
    if place.is_symlink() or (place.exists() and not place.is_dir()):
        raise CampaignError("is in the way", where=str(place), remedy="remove it, or choose another place")
    place.mkdir(parents=True, exist_ok=True)
    if (place / _LOCK).is_symlink():
        raise CampaignError("is in the way", where=str(place / _LOCK), remedy="remove it, or choose another place")
    with (place / _LOCK).open("ab") as lock:
        if fcntl is not None:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                gone = not os.path.samestat(os.fstat(lock.fileno()), os.stat(place / _LOCK))
            except (
                BlockingIOError,
                FileNotFoundError,
            ):  # held; or its owner ended and removed it between our two steps
                gone = True
            if gone:
                raise CampaignError(
                    "another testrange is at work on it",
                    where=str(target),
                    remedy="wait for it, or choose another place",
                )
        yield
