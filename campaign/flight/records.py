"""plan.json, exposures.csv, environment.csv and the optional observations_*.csv."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from campaign.config import Model
from campaign.errors import CampaignError
from campaign.formats.text import (
    Parse,
    file_name,
    identifier,
    optional,
    read_model,
    read_rows,
    whole,
    within,
    write_model,
    write_rows,
)

# Beyond these a value can only be in a wrong unit.
Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Metres = Annotated[float, Field(ge=-1e8, le=1e8)]


class PlannedStrip(Model):
    sortie: Annotated[int, Field(ge=0, le=9999)]
    strip: Annotated[int, Field(ge=0, le=9999)]
    heading_deg: Annotated[float, Field(ge=-360.0, le=720.0)]
    height_m: Annotated[float, Field(gt=0.0, le=20_000.0)] = Field(description="above the site's origin, design height")
    speed_m_s: Annotated[float, Field(gt=0.0, le=200.0)]
    start_en_m: tuple[Metres, Metres] = Field(description="map easting, northing where the strip begins")
    end_en_m: tuple[Metres, Metres]
    images: int


class FlightPlan(Model):
    """7.1 a-g."""

    aircraft: str
    aircraft_kind: Literal["multirotor", "fixed_wing"]
    takeoff_lat_lon_deg: tuple[Degrees, Degrees]
    area_lat_lon_deg: tuple[tuple[Degrees, Degrees], ...] = Field(description="corners of the flight area")
    area_m2: Annotated[float, Field(ge=0.0, le=1e10)]
    map_sheet: str = Field(description="1:10 000 sheet number after GB/T 13989, where the site lies")
    season: str
    start_time: str = Field(description="ISO 8601, Beijing time")
    duration_s: Annotated[float, Field(ge=0.0, le=1e6)]
    deadline: str
    requirements: str = ""
    gsd_m: Annotated[float, Field(gt=0.0, le=100.0)] = Field(description="of the lowest height, formula (1)")
    site_height_m: Annotated[float, Field(ge=-1000.0, le=10_000.0)] = Field(
        description="normal height of the site's origin"
    )
    ground_slope_deg: Annotated[float, Field(ge=0.0, le=90.0)] = Field(
        description="from the reconnaissance survey, 6.2.1 b"
    )
    obstacle_angle_deg: float = Field(description="greatest, seen from the take-off point, 7.2 a")
    static_check_s: float = Field(description="static position check before take-off, 7.2 b")
    static_check_std_m: float
    lock_lost: bool = Field(description="GNSS lock lost during the flight, 7.2 a")
    instruments: dict[str, str] = Field(description="table 2: instrument -> performance, e.g. integrating_sphere")
    strips: tuple[PlannedStrip, ...]


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """One row of exposures.csv."""

    image: str  # file name inside images/, no folder
    gps_time_s: float  # stamped mid-exposure, adjusted standard GPS time
    strip: int
    exposure_time_s: float
    gain_e_per_dn: float
    focus_distance_m: float


@dataclass(frozen=True, kw_only=True)
class EnvironmentRow:
    """One row of environment.csv, about once in 10 s. None: not recorded."""

    gps_time_s: Annotated[float, "adjusted standard GPS time"]
    illuminance_lx: float | None
    wind_speed_m_s: float | None
    wind_from_deg: float | None
    temperature_c: float | None
    pressure_hpa: float | None
    relative_humidity_percent: float | None
    satellites: int | None


@dataclass(frozen=True, kw_only=True)
class CameraObservation:
    """A person's pick of a target in an image (A.1, A.2). Pixel: image's top left corner is (0, 0)."""

    target: str
    image: str
    u_px: float
    v_px: float


@dataclass(frozen=True, kw_only=True)
class LidarObservation:
    """A point that a person gave to a target: index of the record in the strip's LAS file, from 0."""

    target: str
    strip: int
    point: int


def strip_number(text: str) -> int:
    """A strip's number: 0 to 9999, as its file is named."""
    value = whole(text)
    if value > 9999:
        raise ValueError("0 to 9999")
    return value


EXPOSURE_COLUMNS: dict[str, Parse] = {
    "image": file_name,
    "gps_time_s": within(-1e9, 1e10, "s of adjusted GPS time"),
    "strip": strip_number,
    "exposure_time_s": within(1e-7, 100.0, "s"),
    "gain_e_per_dn": within(1e-6, 1e6, "e/DN"),
    "focus_distance_m": within(0.01, 1e6, "m"),
}
ENVIRONMENT_COLUMNS: dict[str, Parse] = {
    "gps_time_s": within(-1e9, 1e10, "s of adjusted GPS time"),
    "illuminance_lx": optional(within(0.0, 1e6, "lx")),
    "wind_speed_m_s": optional(within(0.0, 100.0, "m/s")),
    "wind_from_deg": optional(within(-360.0, 360.0, "degrees")),
    "temperature_c": optional(within(-90.0, 70.0, "degrees Celsius")),
    "pressure_hpa": optional(within(200.0, 1200.0, "hPa")),
    "relative_humidity_percent": optional(within(0.0, 110.0, "%")),
    "satellites": optional(whole),
}
CAMERA_OBSERVATION_COLUMNS: dict[str, Parse] = {
    "target": identifier,
    "image": file_name,
    "u_px": within(-1e5, 1e5, "px"),
    "v_px": within(-1e5, 1e5, "px"),
}
LIDAR_OBSERVATION_COLUMNS: dict[str, Parse] = {"target": identifier, "strip": whole, "point": whole}


def write_plan(path: Path, plan: FlightPlan) -> None:
    """plan.json."""
    write_model(path, plan)


def read_plan(path: Path) -> FlightPlan:
    """Raises CampaignError naming the key."""
    return read_model(path, FlightPlan)


def write_exposures(path: Path, exposures: list[Exposure]) -> None:
    """exposures.csv, one row an image."""
    write_rows(path, list(EXPOSURE_COLUMNS), ([getattr(e, c) for c in EXPOSURE_COLUMNS] for e in exposures))


def read_exposures(path: Path) -> list[Exposure]:
    """Raises CampaignError naming row and column. File names that leave the images folder are refused, and images named twice."""
    rows = read_rows(path, EXPOSURE_COLUMNS)
    seen: set[str] = set()
    for i, row in enumerate(rows, 2):
        if row["image"] in seen:
            raise CampaignError("the image is named twice", where=f"{path} row {i}", got=row["image"])
        seen.add(row["image"])
    return [Exposure(**row) for row in rows]


def write_environment(path: Path, rows: list[EnvironmentRow]) -> None:
    """environment.csv; what was not recorded is an empty cell."""
    write_rows(path, list(ENVIRONMENT_COLUMNS), ([getattr(r, c) for c in ENVIRONMENT_COLUMNS] for r in rows))


def read_environment(path: Path) -> list[EnvironmentRow]:
    """Raises CampaignError naming row and column. A column that was not recorded may be absent."""
    empty: dict[str, Any] = dict.fromkeys(ENVIRONMENT_COLUMNS)
    return [EnvironmentRow(**(empty | row)) for row in read_rows(path, ENVIRONMENT_COLUMNS, ["gps_time_s"])]


def write_camera_observations(path: Path, rows: list[CameraObservation]) -> None:
    """observations_camera.csv."""
    columns = list(CAMERA_OBSERVATION_COLUMNS)
    write_rows(path, columns, ([getattr(r, c) for c in columns] for r in rows))


def read_camera_observations(path: Path) -> list[CameraObservation]:
    """Raises CampaignError naming row and column."""
    return [CameraObservation(**row) for row in read_rows(path, CAMERA_OBSERVATION_COLUMNS)]


def write_lidar_observations(path: Path, rows: list[LidarObservation]) -> None:
    """observations_lidar.csv."""
    columns = list(LIDAR_OBSERVATION_COLUMNS)
    write_rows(path, columns, ([getattr(r, c) for c in columns] for r in rows))


def read_lidar_observations(path: Path) -> list[LidarObservation]:
    """Raises CampaignError naming row and column."""
    return [LidarObservation(**row) for row in read_rows(path, LIDAR_OBSERVATION_COLUMNS)]
