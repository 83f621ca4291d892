"""A .zip as a bag of files, for `archive_check`: its directory is bounded and compared with the file before anything is read."""

import stat
import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, cast

from campaign.archive.pack import BAGIT, unsafe
from campaign.errors import CampaignError

MAX_DIRECTORY_BYTES = 500_000_000
MAX_ENTRIES = 1_000_000
MAX_RATIO = 100  # of all contents to the file; pictures, point clouds and tables stay far below
_END, _END64, _LOCATOR64 = b"PK\5\6", b"PK\6\6", b"PK\6\7"


@dataclass(frozen=True, kw_only=True)
class ZipBag:
    """The files of one bag inside a .zip."""

    pack: zipfile.ZipFile  # open
    top: str  # folder of the bag inside the zip, with its /, or empty
    sizes: dict[str, int]  # path inside the bag -> bytes, as the directory states
    infos: dict[str, zipfile.ZipInfo]
    problems: tuple[tuple[str, str], ...]  # (entry, what is wrong)

    @classmethod
    def read(cls, path: Path) -> "ZipBag":
        """The directory of a .zip; raises CampaignError where it is none or cannot be a sound one."""
        _check_end(path)
        try:
            pack = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError, EOFError, struct.error) as error:
            raise CampaignError(f"is no readable zip: {' '.join(str(error).split())[:100]}") from None
        entries = pack.infolist()
        problems = [*_wrong_entries(entries), *_overlaps(entries, pack.start_dir)]
        total, size = sum(e.file_size for e in entries), path.stat().st_size
        if total > MAX_RATIO * size:
            problems.append((path.name, f"unpacks to {total} bytes from {size}; expected at most {MAX_RATIO} times"))
        files = {e.filename: e for e in entries if not e.is_dir()}
        tops = sorted(
            {n.removesuffix(BAGIT) for n in files if n == BAGIT or (n.endswith(f"/{BAGIT}") and n.count("/") == 1)}
        )
        if len(tops) != 1:
            pack.close()
            raise CampaignError(f"holds no {BAGIT}" if not tops else f"holds {len(tops)} bags; expected one")
        top = tops[0]
        problems += [(n, f"stands outside the bag's folder {top}") for n in files if not n.startswith(top)]
        inner = {n.removeprefix(top): e for n, e in files.items() if n.startswith(top)}
        sizes = {n: e.file_size for n, e in sorted(inner.items())}
        return cls(pack=pack, top=top, sizes=sizes, infos=inner, problems=tuple(problems))

    @contextmanager
    def open(self, name: str) -> Iterator[BinaryIO]:
        """One file; zipfile gives no more than the stated bytes and compares their CRC."""
        with self.pack.open(self.infos[name]) as file:
            yield cast(BinaryIO, file)

    def close(self) -> None:
        """Lets go of the file."""
        self.pack.close()


def _check_end(path: Path) -> None:
    """The end record: how long the directory is, before zipfile takes it into memory."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(0, size - 65_557))
        tail = file.read()
        at = tail.rfind(_END)
        if at < 0 or at + 22 > len(tail):
            raise CampaignError("is no zip, or is truncated")
        count, directory = struct.unpack_from("<HI", tail, at + 10)
        locator = size - len(tail) + at - 20
        if (count == 0xFFFF or directory == 0xFFFFFFFF) and locator >= 0:
            file.seek(locator)
            mark, _, where, _ = struct.unpack("<4sIQI", file.read(20))
            if mark == _LOCATOR64 and where + 56 <= size:
                file.seek(where)
                record = file.read(56)
                if record[:4] == _END64:
                    count, directory = struct.unpack_from("<QQ", record, 32)
    if directory > min(size, MAX_DIRECTORY_BYTES) or count > MAX_ENTRIES:
        raise CampaignError(f"its directory is too large: {count} entries, {directory} bytes")


def _wrong_entries(entries: list[zipfile.ZipInfo]) -> Iterator[tuple[str, str]]:
    seen: set[str] = set()
    for e in entries:
        name = e.filename
        if name in seen:
            yield name, "stands twice in the zip"
        seen.add(name)
        wrong = unsafe(name.removesuffix("/")) or ("holds a character after a NUL" if e.orig_filename != name else None)
        if wrong:
            yield name, f"its name {wrong}"
        if e.flag_bits & 0x1 or e.flag_bits & 0x40:
            yield name, "is encrypted"
        if e.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            yield name, f"is packed by method {e.compress_type}; expected stored or deflated"
        mode = e.external_attr >> 16
        if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
            yield name, "is a link or a device; expected a plain file"
        if e.is_dir() and e.file_size:
            yield name, "is a folder with contents of its own"
        if e.compress_type == zipfile.ZIP_STORED and e.compress_size != e.file_size:
            yield name, f"states {e.file_size} bytes, and {e.compress_size} in the zip"


def _overlaps(entries: list[zipfile.ZipInfo], directory_at: int) -> Iterator[tuple[str, str]]:
    """Entries that share bytes of the file, the way zip bombs do, or reach into the directory."""
    placed = sorted(entries, key=lambda e: e.header_offset)
    for e, after in zip(placed, [*(p.header_offset for p in placed[1:]), directory_at], strict=True):
        if e.header_offset + 30 + e.compress_size > after:
            yield e.filename, "shares bytes with another entry"
