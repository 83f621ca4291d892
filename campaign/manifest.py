"""manifest.json: what this campaign is, its frames and time systems, and every file with its SHA-256."""

import hashlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import Field

from campaign.config import Model
from campaign.errors import CampaignError
from campaign.formats.text import read_model, write_model
from campaign.progress import Report, silent
from campaign.threads import thread_count

NAME = "manifest.json"
TRUTH = "truth"


class ManifestFile(Model):
    path: str
    bytes: Annotated[int, Field(ge=0)]
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class Manifest(Model):
    schema_version: Literal[1] = 1
    campaign: str
    title: str = ""
    synthetic: bool
    date: str = Field(description="ISO date, Beijing time")
    start_time: str = Field(description="ISO 8601, Beijing time")
    gps_week: Annotated[int, Field(ge=0, le=10000)]
    gps_minus_utc_s: Annotated[int, Field(ge=0, le=60)] = 18
    latitude_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = Field(
        description="origin of the site's topocentric frame"
    )
    longitude_deg: Annotated[float, Field(ge=-180.0, le=360.0)]
    ellipsoid_height_m: Annotated[float, Field(ge=-1000.0, le=10_000.0)]
    height_anomaly_m: Annotated[float, Field(ge=-150.0, le=150.0)]
    projection_epsg: int
    height_epsg: int
    software: dict[str, str]
    files: tuple[ManifestFile, ...]


def write_manifest(root: Path, manifest: Manifest, progress: Report = silent) -> None:
    """Fills `files` from disk (all but manifest.json and truth/, sorted) and writes manifest.json."""
    write_model(root / NAME, manifest.model_copy(update={"files": list_files(root, progress)}))


def read_manifest(root: Path) -> Manifest:
    """Raises CampaignError: not a campaign folder, not valid, a schema version that is not known."""
    if not root.is_dir():
        raise CampaignError("no such folder", where=str(root))
    if not (root / NAME).is_file():
        raise CampaignError("is no campaign folder", where=str(root), got="no manifest.json", remedy="check the path")
    return read_model(root / NAME, Manifest)


def verify_files(root: Path, manifest: Manifest, *, checksums: bool = True) -> list[str]:
    """Every missing, changed, surplus or escaping file, one line each; truth/ is left to truth/truth.json.

    Without `checksums` a file is compared by its size alone.
    """
    return compare_files(root, manifest.files, _campaign_files(root), checksums=checksums)


def list_files(root: Path, progress: Report = silent) -> tuple[ManifestFile, ...]:
    """Every file of a campaign but manifest.json and truth/, sorted by path."""
    names = _campaign_files(root)
    entries: list[ManifestFile] = []
    with ThreadPoolExecutor(thread_count()) as pool:
        for entry in pool.map(partial(_entry, root), names):
            progress("checksums", len(entries), len(names))
            entries.append(entry)
    progress("checksums", len(names), len(names))
    return tuple(entries)


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file, read in pieces."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def compare_files(
    root: Path, files: tuple[ManifestFile, ...], on_disk: list[str], *, checksums: bool = True
) -> list[str]:
    """Differences between a list of files and a folder, one line each."""
    problems = []
    listed = set()
    for file in files:
        if file.path in listed:
            problems.append(f"{file.path}: listed twice")
        listed.add(file.path)
        if not _inside(root, file.path):
            problems.append(f"{file.path}: leaves the campaign folder")
            continue
        path = root / file.path
        if not path.is_file():
            problems.append(f"{file.path}: missing")
        elif path.stat().st_size != file.bytes:
            problems.append(f"{file.path}: size differs; got {path.stat().st_size} bytes; expected {file.bytes}")
        elif checksums and sha256(path) != file.sha256:
            problems.append(f"{file.path}: checksum differs; the file was changed after the manifest was written")
    problems += [f"{path}: not in the manifest" for path in on_disk if path not in listed]
    return problems


def walk(root: Path, folder: Path) -> Iterator[str]:
    """Relative names of every file below `folder`, sorted; links are not followed."""
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink():
            yield from walk(root, path)
        else:
            yield path.relative_to(root).as_posix()


def special_files(root: Path) -> list[Path]:
    """Links, pipes, devices and sockets anywhere in a campaign but in truth/, sorted."""
    paths = (root / name for name in walk(root, root) if not name.startswith(f"{TRUTH}/"))
    return [path for path in paths if path.is_symlink() or not path.is_file()]


def _campaign_files(root: Path) -> list[str]:
    return sorted(p for p in walk(root, root) if p != NAME and not p.startswith(f"{TRUTH}/"))


def _entry(root: Path, name: str) -> ManifestFile:
    path = root / name
    if path.is_symlink() or not path.is_file():
        raise CampaignError("is no plain file", where=str(path), remedy="a campaign folder holds its files itself")
    return ManifestFile(path=name, bytes=path.stat().st_size, sha256=sha256(path))


def _inside(root: Path, name: str) -> bool:
    """Whether a listed name, links resolved, stays inside the folder."""
    pure = PurePosixPath(name)
    if not name or pure.is_absolute() or ".." in pure.parts or "\\" in name or "\0" in name:
        return False
    try:
        return (root / name).resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError):
        return False
