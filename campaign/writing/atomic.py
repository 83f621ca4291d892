"""Files and folders that appear complete or not at all: written beside the target, renamed at the end, removed on any failure.

A folder is on the disk before it gets its name. Two processes may write the same file: each has a temporary one of its own.
"""

import contextlib
import errno
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from campaign.errors import CampaignError, WriteError

# What marks a folder as one that this project wrote, and that `replace` may therefore delete.
_OWN_MARKS = (
    "manifest.json",
    "results.json",
    "score.json",
    "matrix.json",
    "comparison.json",
    "pairs.json",
    "campaign/manifest.json",
    "results/results.json",
)


@contextlib.contextmanager
def complete_folder(target: Path, replace: bool = False) -> Iterator[Path]:
    """Give a temporary folder beside `target`; rename it to `target` when the block ends, remove it when the block fails.

    Parameters
    ----------
    target : Path
        May be absent or an empty folder; a folder with contents is refused unless `replace`.
    replace : bool
        Put the new folder in the place of the old one, which is deleted only if it is recognisably a campaign or results
        folder. The old one stays until the new one is complete.

    Raises
    ------
    CampaignError
        The target is occupied, or the disk is full or not writable.
    """
    target = Path(os.path.abspath(target))
    check_target(target, replace)
    with readable_os_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent))
        work.chmod(0o777 & ~_umask())
        try:
            yield work
            put_in_place(work, target, replace)
        except BaseException:
            shutil.rmtree(work, ignore_errors=True)
            raise


@contextlib.contextmanager
def complete_file(target: Path) -> Iterator[Path]:
    """Give a temporary name beside `target` (same suffix); rename it when the block ends, remove it when the block fails."""
    if target.name in ("", "..") or target.is_dir():
        raise CampaignError("is a folder", where=str(target), expected="the name of a file to write")
    work = part_of(target)
    with readable_os_errors(target):
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            yield work
            work.replace(target)
        except BaseException:
            work.unlink(missing_ok=True)
            raise


def part_of(target: Path) -> Path:
    """A name beside `target`, with its suffix, that no other writer has: what is renamed is one writer's whole file."""
    return target.with_name(f".{target.stem}.part-{os.getpid()}-{secrets.token_hex(4)}{target.suffix}")


@contextlib.contextmanager
def readable_os_errors(target: Path) -> Iterator[None]:
    """A full disk or a missing permission as one line."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise WriteError(
                "no space left on the disk while writing",
                where=str(target),
                remedy="free some space or choose another place",
            ) from None
        if error.errno in (
            errno.EACCES,
            errno.EPERM,
            errno.EEXIST,
            errno.EROFS,
            errno.ENOTDIR,
            errno.ENAMETOOLONG,
            errno.EISDIR,
        ):
            raise WriteError("cannot be written", where=str(target), got=error.strerror) from None
        raise


def check_target(target: Path, replace: bool) -> None:
    """Refuse a target that is occupied, or that `replace` must not delete."""
    if not target.exists() and not target.is_symlink():
        return
    if target.is_symlink() or not target.is_dir():
        raise CampaignError("exists and is not a folder", where=str(target), remedy="choose another place")
    if not any(target.iterdir()):
        return
    if not replace:
        raise CampaignError(
            "already exists and is not empty",
            where=str(target),
            remedy="choose another place, delete it, or add --replace",
        )
    if not any((target / mark).is_file() for mark in _OWN_MARKS):
        raise CampaignError(
            "will not be replaced: it does not look like a campaign or results folder",
            where=str(target),
            expected=f"one of {', '.join(_OWN_MARKS)} inside",
        )


def put_in_place(work: Path, target: Path, replace: bool) -> None:
    """Rename `work` to `target` when it is on the disk; what stood there is deleted after."""
    check_target(target, replace)
    _sync_tree(work)
    if not target.exists():
        work.rename(target)
        _sync_folder(target.parent)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".old", dir=target.parent))
    target.rename(old / "old")
    try:
        work.rename(target)
        _sync_folder(target.parent)
    except BaseException:
        (old / "old").rename(target)
        raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


def settle_replaced(target: Path) -> None:
    """What a kill within `put_in_place` left of a replaced folder: put back where nothing stands in its place, else deleted.

    For who holds the target's lock.
    """
    made = re.compile(rf"\.{re.escape(target.name)}\.[a-z0-9_]{{8}}\.old")  # as mkdtemp makes them
    left = [p for p in target.parent.iterdir() if made.fullmatch(p.name) and p.is_dir() and not p.is_symlink()]
    for place in sorted(left, key=lambda p: (-p.stat().st_mtime_ns, p.name)):
        old = place / "old"
        if any(p != old or p.is_symlink() or not p.is_dir() for p in place.iterdir()):  # not as we leave it
            continue
        free = not target.exists() and not target.is_symlink()
        if free and any((old / mark).is_file() for mark in _OWN_MARKS):
            old.rename(target)
            _sync_folder(target.parent)
        shutil.rmtree(place, ignore_errors=True)


def sync_file(path: Path) -> None:
    """Have a file's bytes on the disk."""
    with path.open("rb" if os.name == "posix" else "r+b") as file:  # elsewhere only who may write may do so
        os.fsync(file.fileno())


def _sync_tree(folder: Path) -> None:
    """Every file below `folder`, and the names in its folders. What is on the disk already costs nothing."""
    for place, _, names in os.walk(folder, topdown=False):
        for path in (Path(place, name) for name in names):
            if stat.S_ISREG(path.lstat().st_mode):
                sync_file(path)
        _sync_folder(Path(place))


def _sync_folder(folder: Path) -> None:
    """The names in a folder, where the system can do that."""
    with contextlib.suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask
