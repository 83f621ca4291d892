"""manifest.json: what this campaign is, its frames and time systems, and every file with its SHA-256."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from campaign.config import Model


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
    latitude_deg: float = Field(description="origin of the site's topocentric frame")
    longitude_deg: float
    ellipsoid_height_m: float
    height_anomaly_m: float
    projection_epsg: int
    height_epsg: int
    software: dict[str, str]
    files: tuple[ManifestFile, ...]


def write_manifest(root: Path, manifest: Manifest) -> None:
    """Fills `files` from disk (all but manifest.json and truth/, sorted) and writes manifest.json."""
    raise NotImplementedError


def read_manifest(root: Path) -> Manifest:
    raise NotImplementedError


def verify_files(root: Path, manifest: Manifest) -> list[str]:
    """Every missing, changed, surplus or escaping file, one line each; truth/ is left to truth/truth.json."""
    raise NotImplementedError
