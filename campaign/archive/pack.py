"""The archive of 10.3: one BagIt package of a campaign and its results, as a folder or as a .zip. Checked by `archive_check`.

    bagit.txt bag-info.txt manifest-sha256.txt tagmanifest-sha256.txt
    data/item_list.csv item_list.html test_items.csv    a) item list
    data/ro-crate-metadata.json                         RO-Crate 1.1
    data/campaign/...                                   the campaign folder as it is: b), c) and e)
    data/results/...                                    d) report

Everything is copied and hashed in one pass. No date of today: the same campaign gives the same bytes. What the lists say lives in
`archive_lists`.
"""

import datetime
import hashlib
import unicodedata
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from campaign.archive.lists import Item, indicators_csv, item_csv, item_html, results_campaign, ro_crate
from campaign.errors import CampaignError
from campaign.manifest import NAME as MANIFEST_NAME
from campaign.manifest import Manifest, read_manifest, walk
from campaign.progress import Report, silent
from campaign.writing.atomic import complete_file, complete_folder, readable_os_errors

BAGIT = "bagit.txt"
BAG_INFO = "bag-info.txt"
MANIFEST = "manifest-sha256.txt"
TAG_MANIFEST = "tagmanifest-sha256.txt"
DECLARATION = "BagIt-Version: 1.0\nTag-File-Character-Encoding: UTF-8\n"
CAMPAIGN, RESULTS = "data/campaign", "data/results"
CHUNK_BYTES = 1 << 20
_UNWRITTEN = {"Cc", "Cs", "Zl", "Zp"}  # control characters, lone surrogates, separators of lines: they break the lists
_ZIP64_ABOVE = 1_900_000_000  # bytes; the plain form ends at 2^31 - 1


def write_archive(campaign: Path, results: Path | None, out: Path, progress: Report = silent) -> None:
    """Package a campaign folder.

    Parameters
    ----------
    campaign : Path
        The campaign folder; every file goes in, truth/ of a simulated one too.
    results : Path, optional
        The results folder, or results.json in it: reports, handbooks, results.json.
    out : Path
        A name that ends in .zip, or a folder that does not exist or is empty. Appears complete or not at all.
    progress : callable

    Raises
    ------
    CampaignError
        Not a campaign, a file that is missing or was changed after manifest.json was written, a link, results of another
        campaign, or `out` is occupied.

    References
    ----------
    GB/T 41450-2022, 10.3; RFC 8493 (BagIt); RO-Crate 1.1.
    """
    manifest = read_manifest(campaign)
    folder = None if results is None else results.parent if results.is_file() else results
    if folder is not None and not folder.is_dir():
        raise CampaignError("no such folder", where=str(folder), expected="what testrange evaluate wrote")
    owner = results_campaign(folder)
    if owner is not None and owner != manifest.campaign:
        raise CampaignError("results of another campaign", where=str(folder), got=owner, expected=manifest.campaign)
    if unsafe(manifest.campaign) or "/" in manifest.campaign:
        raise CampaignError(
            "names no folder of an archive", where=f"{MANIFEST_NAME} campaign", got=repr(manifest.campaign[:40])
        )
    date = _zip_date(manifest)
    for source in (campaign, *([folder] if folder else [])):
        if out.resolve().is_relative_to(source.resolve()):
            raise CampaignError("lies inside what is archived", where=str(out), remedy="choose another place")
    files = [(f"{CAMPAIGN}/{name}", campaign / name) for name in walk(campaign, campaign)]
    files += [] if folder is None else [(f"{RESULTS}/{name}", folder / name) for name in walk(folder, folder)]
    for name, path in files:
        wrong = unsafe(name)
        if wrong:
            raise CampaignError(f"its name {wrong}", where=repr(str(path)), remedy="rename the file")
    if out.suffix.lower() == ".zip":
        if out.exists():
            raise CampaignError("already exists", where=str(out), remedy="choose another place or delete it")
        with complete_file(out) as work:
            top = manifest.campaign
            with zipfile.ZipFile(work, "w", zipfile.ZIP_STORED) as pack:
                _write(_ZipSink(pack, top, date), manifest, files, folder, progress)
        return
    with complete_folder(out) as work:
        _write(_FolderSink(work), manifest, files, folder, progress)


@dataclass(frozen=True)
class _Written:
    size: int
    sha256: str


class _Sink(Protocol):
    def add(self, name: str, chunks: Iterable[bytes], size: int) -> _Written:
        """One file of `size` bytes; name with /."""


@dataclass(frozen=True)
class _FolderSink:
    root: Path

    def add(self, name: str, chunks: Iterable[bytes], size: int) -> _Written:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            return _copied(chunks, file.write)


@dataclass(frozen=True)
class _ZipSink:
    pack: zipfile.ZipFile
    top: str
    date: tuple[int, int, int, int, int, int]

    def add(self, name: str, chunks: Iterable[bytes], size: int) -> _Written:
        info = zipfile.ZipInfo(f"{self.top}/{name}", self.date)
        info.create_system = 3  # Unix: the mode below counts
        info.external_attr = 0o100644 << 16
        info.compress_type = zipfile.ZIP_STORED
        with self.pack.open(info, "w", force_zip64=size > _ZIP64_ABOVE) as file:
            return _copied(chunks, file.write)


def _copied(chunks: Iterable[bytes], write: "Writer") -> _Written:
    digest, size = hashlib.sha256(), 0
    for chunk in chunks:
        digest.update(chunk)
        write(chunk)
        size += len(chunk)
    return _Written(size, digest.hexdigest())


class Writer(Protocol):
    """What takes bytes."""

    def __call__(self, data: bytes, /) -> int: ...


def _write(
    sink: _Sink, manifest: Manifest, files: list[tuple[str, Path]], results: Path | None, progress: Report
) -> None:
    """Payload, lists, manifests, in this order; what is in manifest.json must be there and be the same."""
    stated = {f"{CAMPAIGN}/{f.path}": f for f in manifest.files}
    missing = sorted(set(stated) - {name for name, _ in files})
    if missing:
        raise _not_as_stated(missing[0].removeprefix(f"{CAMPAIGN}/"), "is missing")
    written: dict[str, _Written] = {}
    for done, (name, path) in enumerate(files):
        progress("archive", done, len(files))
        with _opened(path) as (chunks, size):
            entry = sink.add(name, chunks, size)
        if entry.size != size:
            raise CampaignError("changed while it was read", where=str(path), got=entry.size, expected=f"{size} bytes")
        if name in stated and (entry.size, entry.sha256) != (stated[name].bytes, stated[name].sha256):
            raise _not_as_stated(name.removeprefix(f"{CAMPAIGN}/"), "was changed after manifest.json was written")
        written[name] = entry
    items = [Item(path=n.removeprefix("data/"), size=e.size, sha256=e.sha256) for n, e in written.items()]
    lists = {
        "data/test_items.csv": indicators_csv(manifest, results),
        "data/item_list.csv": item_csv(items),
        "data/item_list.html": item_html(manifest, items, results),
        "data/ro-crate-metadata.json": ro_crate(manifest, items),
    }
    for name, text in lists.items():
        written[name] = _add_text(sink, name, text)
    payload = sum(e.size for e in written.values())
    tags = {
        BAGIT: DECLARATION,
        BAG_INFO: _bag_info(manifest, payload, len(written)),
        MANIFEST: _manifest_text(written),
    }
    hashes = {name: _add_text(sink, name, text) for name, text in tags.items()}
    _add_text(sink, TAG_MANIFEST, _manifest_text(hashes))
    progress("archive", len(files), len(files))


def _add_text(sink: _Sink, name: str, text: str) -> _Written:
    raw = text.encode("utf-8")
    return sink.add(name, [raw], len(raw))


def _not_as_stated(name: str, what: str) -> CampaignError:
    return CampaignError(f"{name} {what}", remedy="testrange check CAMPAIGN lists every difference; restore the file")


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Iterator[bytes], int]]:
    """A plain file in pieces, and its size; a link, pipe or device is refused."""
    if path.is_symlink() or not path.is_file():
        raise CampaignError("is no plain file", where=str(path), remedy="copy what it leads to into the folder")
    with readable_os_errors(path), path.open("rb") as file:
        yield iter(lambda: file.read(CHUNK_BYTES), b""), path.stat().st_size


def _manifest_text(files: dict[str, _Written]) -> str:
    return "".join(f"{entry.sha256}  {encoded(name)}\n" for name, entry in sorted(files.items()))


def unsafe(name: str) -> str | None:
    """Why a path may not stand in an archive; None: it may."""
    parts = name.split("/")
    if not name or "\\" in name or any(unicodedata.category(c) in _UNWRITTEN for c in name):
        return "holds a character that other systems cannot write"
    if name.startswith("/") or ":" in parts[0] or any(part in ("", ".", "..") for part in parts):
        return "leaves the archive"
    return "is too long" if len(name) > 4096 else None


def encoded(name: str) -> str:
    """A path as BagIt writes it: %, line feed and carriage return as percent codes."""
    return name.replace("%", "%25").replace("\n", "%0A").replace("\r", "%0D")


def _bag_info(manifest: Manifest, payload_bytes: int, payload_files: int) -> str:
    values = {
        "Bag-Software-Agent": "testrange",
        "Bagging-Date": manifest.date,
        "External-Description": manifest.title or manifest.campaign,
        "External-Identifier": manifest.campaign,
        "Internal-Sender-Description": "GB/T 41450-2022, 10.3"
        + ("; synthetic data of a virtual range" if manifest.synthetic else ""),
        "Payload-Oxum": f"{payload_bytes}.{payload_files}",
    }
    return "".join(f"{key}: {' '.join(value.split())}\n" for key, value in values.items())


def _zip_date(manifest: Manifest) -> tuple[int, int, int, int, int, int]:
    """The campaign's day; ZIP begins with 1980."""
    try:
        day = datetime.date.fromisoformat(manifest.date[:10])
    except ValueError:
        raise CampaignError(
            "is no date", where=f"{MANIFEST_NAME} date", got=manifest.date[:40], expected="ISO 8601"
        ) from None
    return (max(day.year, 1980), day.month, day.day, 0, 0, 0) if day.year < 2108 else (2107, 12, 31, 0, 0, 0)
