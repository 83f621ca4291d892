"""Verifies an archive of 10.3, BagIt folder or .zip, without trusting it: names, sizes, lists, checksums, the campaign in it.

What an archive states is compared before anything long is read. The campaign in a .zip is unpacked to a temporary folder, file by
file and no longer than stated, once names, sizes and kinds of all entries were found sound. Writing lives in `archive`.
"""

import hashlib
import os
import re
import shutil
import stat
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Protocol

from pydantic import ValidationError

from campaign.archive.pack import BAG_INFO, BAGIT, CAMPAIGN, CHUNK_BYTES, MANIFEST, TAG_MANIFEST, unsafe
from campaign.archive.zips import ZipBag
from campaign.checks.collector import Problem
from campaign.checks.folder import check_campaign
from campaign.errors import CampaignError
from campaign.manifest import Manifest
from campaign.progress import Report, silent

MAX_TAG_BYTES = 200_000_000
MAX_ENTRIES = 1_000_000
MAX_LINES = 200  # problems of one kind
FREE_SHARE = 0.9  # of the temporary disk that an unpacked campaign may take
_LINE = re.compile(r"([0-9a-fA-F]{64})[ \t]+\*?(\S.*)")
_OXUM = re.compile(r"(\d{1,18})\.(\d{1,9})")


class Bag(Protocol):
    """A package of files, however it is stored."""

    @property
    def sizes(self) -> dict[str, int]:
        """Path inside the bag -> bytes, as stated."""

    def open(self, name: str) -> AbstractContextManager[BinaryIO]:
        """The content."""

    def close(self) -> None:
        """Lets go of what is open."""


def is_archive(path: Path) -> bool:
    """Whether `path` looks like an archive rather than a campaign: a .zip file, or a folder with bagit.txt."""
    return (path.is_file() and path.suffix.lower() == ".zip") or (path / BAGIT).is_file()


def check_archive(path: Path, progress: Report = silent) -> list[Problem]:
    """Every problem of an archive; an empty list: complete and unchanged.

    Parameters
    ----------
    path : Path
        A .zip file or a folder with bagit.txt.
    progress : callable

    Raises
    ------
    CampaignError
        `path` is neither.

    References
    ----------
    GB/T 41450-2022, 10.3; RFC 8493 (BagIt).
    """
    check = _Check()
    if path.is_dir():
        bag: Bag | None = _folder_bag(path, check)
    elif path.is_file():
        bag = _zip_bag(path, check)
    else:
        raise CampaignError("no such archive", where=str(path), expected="a .zip file or a folder with bagit.txt")
    if bag is None:
        return check.problems
    try:
        _contents(bag, path, check, progress)
    finally:
        bag.close()
    return check.problems


def _contents(bag: Bag, path: Path, check: "_Check", progress: Report) -> None:
    """Lists, then checksums, then the campaign; each only where what comes before it is sound."""
    if check.problems:
        return
    stated = _lists(bag, check)
    if stated is None:
        return
    found = _checksums(bag, stated, check, progress)
    inner = f"{CAMPAIGN}/manifest.json"
    if inner not in bag.sizes:
        check.error(inner, "is missing; the archive holds no campaign")
        return
    _campaign_list(bag, inner, found, check)
    if path.is_dir():
        _campaign(path / CAMPAIGN, check)
    else:
        _packed_campaign(bag, check, progress)


def _campaign(folder: Path, check: "_Check") -> None:
    """The campaign's own formats, as `testrange check` of the folder has them; checksums were compared before."""
    for p in check_campaign(folder, checksums=False):
        message = p.message.replace(f"{folder}/", "").replace(str(folder), CAMPAIGN)
        check.problems.append(Problem(severity=p.severity, where=f"{CAMPAIGN}/{p.where}", message=message))


def _packed_campaign(bag: Bag, check: "_Check", progress: Report) -> None:
    """The same for a .zip: unpacked to a temporary folder, which goes away; a warning where that cannot be done."""
    files = {name: size for name, size in bag.sizes.items() if name.startswith(f"{CAMPAIGN}/")}
    needed = sum(files.values())
    place = Path(tempfile.gettempdir())
    unchecked = "formats of the campaign not checked: {}; unpack the archive and check that folder"
    free = shutil.disk_usage(place).free
    if needed > FREE_SHARE * free:
        check.warning(CAMPAIGN, unchecked.format(f"{needed} bytes to unpack, {free} free for temporary files"))
        return
    with tempfile.TemporaryDirectory(prefix="testrange-check-", dir=place) as work:
        try:
            for done, name in enumerate(files):
                progress("unpacking", done, len(files))
                _unpack(bag, name, Path(work) / name)
            progress("unpacking", len(files), len(files))
        except (OSError, zipfile.BadZipFile, EOFError, ValueError, NotImplementedError) as error:
            why = getattr(error, "strerror", None) or " ".join(str(error).split())[:100]
            check.warning(CAMPAIGN, unchecked.format(f"{_printable(name)}: {why}"))
            return
        _campaign(Path(work) / CAMPAIGN, check)


def _unpack(bag: Bag, name: str, to: Path) -> None:
    """One file, as long as the directory states and no longer."""
    to.parent.mkdir(parents=True, exist_ok=True)
    left = bag.sizes[name]
    with bag.open(name) as file, to.open("xb") as out:
        while left > 0 and (chunk := file.read(min(CHUNK_BYTES, left))):
            out.write(chunk)
            left -= len(chunk)


@dataclass(kw_only=True)
class _Check:
    problems: list[Problem] = field(default_factory=list)
    told: dict[str, int] = field(default_factory=dict)

    def error(self, where: str, message: str, kind: str = "") -> None:
        """One problem; of one kind at most MAX_LINES are listed."""
        if kind:
            self.told[kind] = self.told.get(kind, 0) + 1
            if self.told[kind] > MAX_LINES:
                return
        self.problems.append(Problem(severity="error", where=_printable(where), message=message))

    def warning(self, where: str, message: str) -> None:
        self.problems.append(Problem(severity="warning", where=_printable(where), message=message))


def _printable(name: str) -> str:
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in name[:300])


@dataclass(frozen=True)
class _FolderBag:
    root: Path
    sizes: dict[str, int]

    @contextmanager
    def open(self, name: str) -> Iterator[BinaryIO]:
        flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        with os.fdopen(os.open(self.root / name, flags), "rb") as file:
            yield file

    def close(self) -> None:
        """Nothing is held open."""


def _folder_bag(root: Path, check: _Check) -> _FolderBag | None:
    """Sizes of all plain files; links, pipes and devices are errors and are not followed."""
    sizes: dict[str, int] = {}
    waiting = [root]
    while waiting:
        folder = waiting.pop()
        for entry in sorted(os.scandir(folder), key=lambda e: e.name):
            name = Path(entry.path).relative_to(root).as_posix()
            mode = entry.stat(follow_symlinks=False).st_mode
            if stat.S_ISDIR(mode):
                waiting.append(Path(entry.path))
            elif not stat.S_ISREG(mode):
                check.error(name, "is no plain file; expected an archive that holds its files itself", "special")
            elif wrong := unsafe(name):
                check.error(name, f"its name {wrong}", "name")
            else:
                sizes[name] = entry.stat(follow_symlinks=False).st_size
        if len(sizes) > MAX_ENTRIES:
            check.error(".", f"holds more than {MAX_ENTRIES} files")
            return None
    return _FolderBag(root, dict(sorted(sizes.items())))


def _zip_bag(path: Path, check: _Check) -> ZipBag | None:
    try:
        bag = ZipBag.read(path)
    except CampaignError as error:
        check.error(path.name, error.what)
        return None
    for name, message in bag.problems:
        check.error(name, message, "zip")
    return bag


def _text(bag: Bag, name: str, check: _Check) -> str | None:
    """A tag file; None with a problem where it is missing, too large or not UTF-8."""
    if name not in bag.sizes:
        check.error(name, "is missing")
        return None
    if bag.sizes[name] > MAX_TAG_BYTES:
        check.error(name, f"is too large; got {bag.sizes[name]} bytes; expected at most {MAX_TAG_BYTES}")
        return None
    try:
        with bag.open(name) as file:
            return file.read(MAX_TAG_BYTES + 1).decode("utf-8-sig")
    except UnicodeDecodeError:
        check.error(name, "is not UTF-8 text")
    except (OSError, zipfile.BadZipFile, EOFError, ValueError) as error:
        check.error(name, f"cannot be read: {' '.join(str(error).split())[:100]}")
    return None


def _lists(bag: Bag, check: _Check) -> dict[str, str] | None:
    """Payload as the manifest lists it (path -> SHA-256), after declaration, totals and names were compared."""
    declaration = _text(bag, BAGIT, check)
    if declaration is None:
        return None
    if not re.fullmatch(r"BagIt-Version: (0\.97|1\.0)\r?\nTag-File-Character-Encoding: UTF-8(\r?\n)?", declaration):
        check.error(BAGIT, "is no declaration of BagIt 0.97 or 1.0 in UTF-8")
        return None
    if "fetch.txt" in bag.sizes:
        check.error("fetch.txt", "the archive leaves files to be fetched from elsewhere; expected all files inside")
        return None
    payload = {name: size for name, size in bag.sizes.items() if name.startswith("data/")}
    _oxum(bag, payload, check)
    text = _text(bag, MANIFEST, check)
    if text is None:
        return None
    stated = _parsed(text, MANIFEST, check)
    for name in stated:
        if not name.startswith("data/"):
            check.error(name, f"{MANIFEST} lists a file outside data/", "outside")
        elif name not in payload:
            check.error(name, f"missing; {MANIFEST} lists it", "missing")
    for name in payload:
        if name not in stated:
            check.error(name, f"not in {MANIFEST}", "surplus")
    folded: dict[str, str] = {}
    for name in payload:
        other = folded.setdefault(name.casefold(), name)
        if other != name:
            check.warning(name, f"differs from {other} by the case of letters alone; one is lost on some systems")
    _tags(bag, check)
    return {name: digest for name, digest in stated.items() if name in payload}


def _oxum(bag: Bag, payload: dict[str, int], check: _Check) -> None:
    """Bytes and number of files of the payload against Payload-Oxum."""
    if BAG_INFO not in bag.sizes:
        check.warning(BAG_INFO, "missing; the payload's size is stated nowhere")
        return
    text = _text(bag, BAG_INFO, check) or ""
    values = [line.partition(":")[2].strip() for line in text.splitlines() if line.lower().startswith("payload-oxum:")]
    match = _OXUM.fullmatch(values[0]) if len(values) == 1 else None
    if match is None:
        check.error(BAG_INFO, "states no Payload-Oxum; expected BYTES.FILES once")
        return
    got = (sum(payload.values()), len(payload))
    if got != (int(match[1]), int(match[2])):
        check.error(BAG_INFO, f"the payload has {got[0]} bytes in {got[1]} files; Payload-Oxum states {values[0]}")


def _parsed(text: str, source: str, check: _Check) -> dict[str, str]:
    stated: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        match = _LINE.fullmatch(line.rstrip("\r"))
        if match is None:
            check.error(source, f"line {number} is no checksum and path", "line")
            continue
        name = match[2].replace("%0A", "\n").replace("%0D", "\r").replace("%0a", "\n").replace("%0d", "\r")
        name = name.replace("%25", "%")
        if wrong := unsafe(name):
            check.error(source, f"line {number}: a path {wrong}: {_printable(name)}", "path")
        elif name in stated:
            check.error(source, f"line {number}: listed twice: {name}", "twice")
        else:
            stated[name] = match[1].lower()
    return stated


def _tags(bag: Bag, check: _Check) -> None:
    """Checksums of the tag files."""
    if TAG_MANIFEST not in bag.sizes:
        check.warning(TAG_MANIFEST, "missing; nobody guards the lists themselves")
        return
    text = _text(bag, TAG_MANIFEST, check)
    stated = _parsed(text or "", TAG_MANIFEST, check)
    for name in (BAGIT, BAG_INFO, MANIFEST):
        if name in bag.sizes and name not in stated:
            check.error(name, f"not in {TAG_MANIFEST}")
    for name, digest in stated.items():
        if name not in bag.sizes or name.startswith("data/") or bag.sizes[name] > MAX_TAG_BYTES:
            check.error(name, f"{TAG_MANIFEST} lists it; missing or no tag file", "tag")
        elif _digest(bag, name, check) not in (digest, None):
            check.error(name, "checksum differs; the file was changed", "changed")
    for name in bag.sizes:
        if not name.startswith("data/") and name not in stated and name != TAG_MANIFEST:
            check.warning(name, f"not in {TAG_MANIFEST}")


def _digest(bag: Bag, name: str, check: _Check) -> str | None:
    """SHA-256 of one file, read in pieces; None with a problem where it cannot be read or is longer than stated."""
    digest, size = hashlib.sha256(), 0
    try:
        with bag.open(name) as file:
            while chunk := file.read(CHUNK_BYTES):
                digest.update(chunk)
                size += len(chunk)
                if size > bag.sizes[name]:
                    break
    except (OSError, zipfile.BadZipFile, EOFError, ValueError, NotImplementedError) as error:
        check.error(name, f"cannot be read: {' '.join(str(error).split())[:100]}", "read")
        return None
    if size != bag.sizes[name]:
        check.error(name, f"size differs; got {size} bytes; expected {bag.sizes[name]}", "size")
        return None
    return digest.hexdigest()


def _checksums(bag: Bag, stated: dict[str, str], check: _Check, progress: Report) -> dict[str, str]:
    """SHA-256 of every payload file as found."""
    found: dict[str, str] = {}
    for done, (name, digest) in enumerate(stated.items()):
        progress("checksums", done, len(stated))
        got = _digest(bag, name, check)
        if got is not None:
            found[name] = got
            if got != digest:
                check.error(name, f"checksum differs from {MANIFEST}; the file was changed", "changed")
    progress("checksums", len(stated), len(stated))
    return found


def _campaign_list(bag: Bag, inner: str, found: dict[str, str], check: _Check) -> None:
    """The campaign's own list of files against what was hashed."""
    text = _text(bag, inner, check)
    if text is None:
        return
    try:
        manifest = Manifest.model_validate_json(text, strict=True)
    except (ValidationError, RecursionError):
        check.error(inner, "is no manifest of a campaign")
        return
    for file in manifest.files:
        name = f"{CAMPAIGN}/{file.path}"
        if name not in bag.sizes:
            check.error(name, "missing; the campaign's manifest.json lists it", "campaign missing")
        elif name in found and (bag.sizes[name], found[name]) != (file.bytes, file.sha256):
            check.error(name, "differs from the campaign's manifest.json", "campaign changed")
