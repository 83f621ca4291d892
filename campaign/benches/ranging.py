"""ranging/: the line of panels of 9.1.2. line.json, total_station.csv, and one point cloud for each LiDAR observation.

ranging/line.json               RangingLine
ranging/total_station.csv       StationReading, one row a reading
ranging/scans/scan_01.laz …     points in a Cartesian frame whose origin is the LiDAR's centre; its axes are the instrument's
                                own and need not be level or oriented. One scan is one independent observation of every panel
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from campaign.config import Model, Vector3
from campaign.errors import CampaignError
from campaign.folder import CampaignFolder
from campaign.formats.text import (
    Parse,
    identifier,
    optional,
    read_model,
    read_rows,
    whole,
    within,
    write_model,
    write_rows,
)


class TotalStation(Model):
    """One instrument with its certificate: D = S + K1 + R1 S + dD, dD by formula (12)."""

    name: str = Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")
    model: str = ""
    class_mm: Annotated[float, Field(gt=0.0, le=1000.0)]
    class_ppm: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    additive_constant_m: Annotated[float, Field(ge=-1.0, le=1.0)] = Field(description="K1, added to what it reads")
    scale: Annotated[float, Field(ge=-0.01, le=0.01)] = Field(description="R1, times what it reads, added")
    additive_constant_std_m: Annotated[float, Field(ge=0.0, le=0.1)] = Field(
        0.0, description="of K1, by the certificate"
    )
    scale_std: Annotated[float, Field(ge=0.0, le=0.001)] = Field(0.0, description="of R1, by the certificate")
    reference_index: Annotated[float, Field(ge=1.0, le=1.001)] = Field(description="n0 of its design")
    wavelength_um: Annotated[float, Field(ge=0.3, le=2.0)] = Field(description="of the carrier")
    serves: tuple[str, ...] = Field(
        ("correction", "reference"),
        description="correction: slope distances of 9.1.2 c for K2 and R2; reference: relative true values of 9.1.2 k",
    )


class RangingPanel(Model):
    id: str = Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")
    size_m: Annotated[float, Field(gt=0.0, le=50.0)]
    nominal_reflectance_percent: Annotated[float, Field(ge=0.0, le=120.0)] | None = None


class RangingLine(Model):
    """How the line was set up."""

    stations: Annotated[tuple[TotalStation, ...], Field(min_length=1, max_length=20)]
    panels: Annotated[tuple[RangingPanel, ...], Field(min_length=1, max_length=200)]
    eccentricity_m: Vector3 = Field(
        description="LiDAR's centre minus the stations' common centre, in the total stations' frame: x along horizontal "
        "angle 90 degrees, y along 0 degrees, z up"
    )
    eccentricity_std_m: Annotated[float, Field(ge=0.0, le=1.0)] = Field(description="one axis")


@dataclass(frozen=True, kw_only=True)
class StationReading:
    """One reading of one panel's centre. None: not recorded."""

    station: str  # TotalStation.name
    panel: str
    observation: int  # independent observations of one panel count from 1
    slope_distance_m: float | None
    horizontal_angle_deg: float | None  # clockwise from the frame's y
    zenith_angle_deg: float | None
    temperature_c: float | None = None
    pressure_hpa: float | None = None
    relative_humidity_percent: float | None = None


TEMPERATURE_C = (-40.0, 60.0)  # of the air that (12) is worked out for
PRESSURE_HPA = (500.0, 1100.0)

READING_COLUMNS: dict[str, Parse] = {
    "station": identifier,
    "panel": identifier,
    "observation": whole,
    "slope_distance_m": optional(within(0.05, 20_000.0, "m")),
    "horizontal_angle_deg": optional(within(-360.0, 720.0, "degrees")),
    "zenith_angle_deg": optional(within(0.0, 180.0, "degrees")),
    "temperature_c": optional(within(*TEMPERATURE_C, "degrees Celsius")),
    "pressure_hpa": optional(within(*PRESSURE_HPA, "hPa")),
    "relative_humidity_percent": optional(within(0.0, 110.0, "%")),
}
_REQUIRED = READING_COLUMNS.keys() - {"temperature_c", "pressure_hpa", "relative_humidity_percent"}
_SCAN = re.compile(r"scan_(\d{2,4})\.(las|laz)", re.IGNORECASE)


def line_path(folder: CampaignFolder) -> Path:
    return folder.ranging / "line.json"


def readings_path(folder: CampaignFolder) -> Path:
    return folder.ranging / "total_station.csv"


def scan_path(folder: CampaignFolder, number: int) -> Path:
    return folder.ranging / "scans" / f"scan_{number:02d}.laz"


def scan_paths(folder: CampaignFolder) -> dict[int, Path]:
    """Number -> file of every scan on disk, in order; none that a link takes out of the folder."""
    parent = folder.ranging / "scans"
    if not parent.is_dir():
        return {}
    found = sorted((int(m.group(1)), p) for p in parent.iterdir() if (m := _SCAN.fullmatch(p.name)) and p.is_file())
    found = [(number, path) for number, path in found if folder.holds(path)]
    return dict(found)


def write_line(path: Path, line: RangingLine) -> None:
    """line.json."""
    write_model(path, line)


def read_line(path: Path) -> RangingLine:
    """Raises CampaignError naming the key; names of stations and panels are unique."""
    line = read_model(path, RangingLine)
    for what, names in (("stations", [s.name for s in line.stations]), ("panels", [p.id for p in line.panels])):
        if len(set(names)) != len(names):
            raise CampaignError("a name stands twice", where=f"{path} {what}", got=names)
    for station in line.stations:
        unknown = set(station.serves) - {"correction", "reference"}
        if unknown or not station.serves:
            raise CampaignError(
                "unknown use of a station",
                where=f"{path} stations {station.name} serves",
                got=sorted(unknown),
                expected="correction, reference",
            )
    return line


def write_readings(path: Path, rows: list[StationReading]) -> None:
    """total_station.csv."""
    write_rows(path, list(READING_COLUMNS), ([getattr(r, c) for c in READING_COLUMNS] for r in rows))


def read_readings(path: Path) -> list[StationReading]:
    """Raises CampaignError naming row and column. An empty cell is None: the evaluator leaves such a row out and says so."""
    empty: dict[str, Any] = dict.fromkeys(READING_COLUMNS)
    return [StationReading(**(empty | row)) for row in read_rows(path, READING_COLUMNS, sorted(_REQUIRED))]
