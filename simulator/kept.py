"""Arrays that are kept in a folder between runs, by what they were made of: renders that several campaigns share.

A file appears whole or not at all, and every block of it has a checksum: what was cut or changed since is made again. The folder
has a bound; where it is met, what was not used for the longest time goes. Nothing here is a reason for a run to fail but a folder
that cannot be made.
"""

import contextlib
import errno
import hashlib
import os
import re
import secrets
import shutil
import struct
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from io import BufferedReader
from pathlib import Path

import numpy as np
from pydantic import BaseModel

from campaign.errors import WriteError

LIMIT_GB = 50.0  # `render.cache_limit_gb` where nobody sets it
SPARE_BYTES = 2e9  # of the disk, which the campaign itself may need
ABANDONED_S = 86_400.0  # a file that nobody finished in this time is nobody's

_MAGIC = b"testrange kept 1"
_HEAD = struct.Struct("<8sI4Q")  # type, number of axes, shape; a last one without type says how many blocks there are
_SUM = struct.Struct("<I")
_AROUND = 256  # bytes of a file beside its numbers, at most
_OURS = re.compile(r"[0-9a-f]{40}\.(kept|[0-9a-f]{8}\.part)")


class _Damaged(Exception):
    """A kept file is not what was written."""


def kept_array(
    folder: str | None, made_of: object, make: Callable[[], np.ndarray], limit_gb: float = LIMIT_GB
) -> np.ndarray:
    """What `make` gives, or what it gave for the same `made_of`; without a folder nothing is kept.

    Parameters
    ----------
    folder : str, optional
        Made where it does not exist (`render.cache`).
    made_of : object
        Everything that the array depends on: numbers, texts, arrays, models and data classes, in tuples.
    limit_gb : float
        Of the folder, of all campaigns together (`render.cache_limit_gb`). [GB of 1e9 bytes]
    """
    array, *_ = kept_blocks(folder, made_of, lambda: iter((make(),)), limit_gb)
    return array


def kept_blocks(
    folder: str | None, made_of: object, make: Callable[[], Iterator[np.ndarray]], limit_gb: float = LIMIT_GB
) -> Iterator[np.ndarray]:
    """As `kept_array`, for what is made block by block and is never in memory as a whole.

    What is left before its last block is not kept. Where a block of a file is damaged, it and those after it are made again.
    """
    if folder is None:
        yield from make()
        return
    digest = hashlib.sha256()
    _add(digest, made_of)
    name = digest.hexdigest()[:40]
    kept = Path(folder) / f"{name}.kept"
    sound = 0
    if kept.is_file():
        try:
            for block in _read(kept, name):
                yield block
                sound += 1
        except (_Damaged, OSError):
            with contextlib.suppress(OSError):
                kept.unlink()
        else:
            with contextlib.suppress(OSError):
                os.utime(kept)  # used now
            return
    make_folder(kept.parent)
    for number, block in enumerate(_keeping(make(), kept, limit_gb * 1e9)):
        if number >= sound:
            yield block


def make_folder(folder: Path, to_write: bool = False) -> None:
    """Make the folder of what is kept; `to_write` also tries whether a file can be made in it. A full disk is no reason to refuse.

    Raises
    ------
    WriteError
        It cannot be made, or not be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if to_write:
            with tempfile.TemporaryFile(dir=folder):
                pass
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT) and folder.is_dir():
            return
        raise WriteError(
            "the folder that keeps renders cannot be written",
            where=str(folder),
            got="no folder" if isinstance(error, FileExistsError) else error.strerror,
            expected="a folder that can be made and written",
            remedy="choose another with --cache or render.cache, or leave it out",
        ) from None


def kept_bytes(folder: Path) -> int:
    """What the files of this kind in a folder hold together."""
    return sum(size for _, size, _ in _files(folder))


# ------------------------------------------------------------------------------------------------------------------ files


def _keeping(blocks: Iterator[np.ndarray], kept: Path, limit: float) -> Iterator[np.ndarray]:
    """The blocks, each written before it is given away; the file takes its name after the last one.

    Where it would not fit, or the disk does not let us write, they go by and nothing is kept.
    """
    part: Path | None = kept.with_name(f"{kept.stem}.{secrets.token_hex(4)}.part")
    count = 0
    try:
        for block in blocks:
            if part is not None and not (
                _room(kept.parent, block.nbytes + _AROUND, limit) and _append(part, kept.stem, block)
            ):
                part.unlink(missing_ok=True)
                part = None
            count += 1
            yield block
        if part is not None and _append(part, kept.stem, count):
            with contextlib.suppress(OSError):
                part.replace(kept)
    finally:
        if part is not None:
            part.unlink(missing_ok=True)


def _append(part: Path, name: str, block: np.ndarray | int) -> bool:
    """One more block, or how many there were. False: the disk is full, or the like."""
    try:
        with part.open("ab") as file:
            if file.tell() == 0:
                file.write(_MAGIC + name.encode())
            if isinstance(block, int):
                file.write(_HEAD.pack(b"", 0, block, 0, 0, 0))
                return True
            head = _HEAD.pack(block.dtype.str.encode(), block.ndim, *block.shape, *[0] * (4 - block.ndim))
            data = np.ascontiguousarray(block).data.cast("B") if block.size else memoryview(b"")
            file.write(head)
            file.write(data)
            file.write(_SUM.pack(zlib.crc32(data, zlib.crc32(head))))
    except OSError:
        return False
    return True


def _read(kept: Path, name: str) -> Iterator[np.ndarray]:
    left = kept.stat().st_size
    with kept.open("rb") as file:
        if file.read(len(_MAGIC) + len(name)) != _MAGIC + name.encode():
            raise _Damaged
        count = 0
        while (block := _block(file, left, count)) is not None:
            yield block
            count += 1


def _block(file: BufferedReader, left: int, count: int) -> np.ndarray | None:
    """The next block; None after the last. No more memory is taken than the file has bytes."""
    head = file.read(_HEAD.size)
    if len(head) != _HEAD.size:
        raise _Damaged
    kind, axes, *shape = _HEAD.unpack(head)
    text = kind.rstrip(b"\0").decode("ascii", errors="replace")
    if text == "":
        if shape[0] != count or file.read(1):
            raise _Damaged
        return None
    if axes > 4 or not re.fullmatch(r"[<|][biuf][1248]", text):
        raise _Damaged
    dtype, size = np.dtype(text), 1
    for n in shape[:axes]:
        size *= n
    if size * dtype.itemsize > left:
        raise _Damaged
    block = np.empty(shape[:axes], dtype)
    data = block.data.cast("B") if block.size else memoryview(bytearray())
    if file.readinto(data) != len(data):
        raise _Damaged
    if file.read(_SUM.size) != _SUM.pack(zlib.crc32(data, zlib.crc32(head))):
        raise _Damaged
    return block


def _room(folder: Path, needed: int, limit: float) -> bool:
    """Whether as many bytes fit, once what was not used for the longest time has gone."""
    try:
        if shutil.disk_usage(folder).free < needed + SPARE_BYTES:
            return False
        files = sorted(_files(folder))
    except OSError:
        return False
    total = sum(size for _, size, _ in files) + needed
    for used_s, size, path in files:
        whole = path.suffix == ".kept"
        if (whole and total > limit) or (not whole and time.time() - used_s > ABANDONED_S):
            with contextlib.suppress(OSError):
                path.unlink()
                total -= size
    return total <= limit


def _files(folder: Path) -> list[tuple[float, int, Path]]:
    """When each was used last, its size, and where it is: files of ours alone, whatever else stands there."""
    found = []
    for entry in os.scandir(folder):
        if _OURS.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
            with contextlib.suppress(FileNotFoundError):  # another process may be at work on the folder
                about = entry.stat(follow_symlinks=False)
                found.append((about.st_mtime, about.st_size, Path(entry.path)))
    return found


# -------------------------------------------------------------------------------------------------------------------- key


def _add(digest: "hashlib._Hash", value: object) -> None:
    if isinstance(value, np.ndarray):
        digest.update(repr((value.dtype.str, value.shape)).encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, BaseModel):
        digest.update(value.model_dump_json().encode())
    elif is_dataclass(value):
        for field in fields(value):
            digest.update(field.name.encode())
            _add(digest, getattr(value, field.name))
    elif isinstance(value, tuple | list):
        digest.update(f"{len(value)}:".encode())
        for each in value:
            _add(digest, each)
    else:
        digest.update(f"{value!r};".encode())
