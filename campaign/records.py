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
    non_negative,
    number,
    optional,
    positive,
    read_model,
    read_rows,
    whole,
    write_model,
    write_rows,
)


class PlannedStrip(Model):
    sortie: int
    strip: int
    heading_deg: float
    height_m: float = Field(description="above the site's origin, design height")
    speed_m_s: float
    start_en_m: tuple[float, float] = Field(description="map easting, northing where the strip begins")
    end_en_m: tuple[float, float]
    images: int


class FlightPlan(Model):
    """7.1 a-g."""

    aircraft: str
    aircraft_kind: Literal["multirotor", "fixed_wing"]
    takeoff_lat_lon_deg: tuple[float, float]
    area_lat_lon_deg: tuple[tuple[float, float], ...] = Field(description="corners of the flight area")
    area_m2: float
    map_sheet: str = Field(description="1:10 000 sheet number after GB/T 13989, where the site lies")
    season: str
    start_time: str = Field(description="ISO 8601, Beijing time")
    duration_s: float
    deadline: str
    requirements: str = ""
    gsd_m: float = Field(description="of the lowest height, formula (1)")
    site_height_m: float = Field(description="normal height of the site's origin")
    ground_slope_deg: float = Field(description="from the reconnaissance survey, 6.2.1 b")
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


EXPOSURE_COLUMNS: dict[str, Parse] = {
    "image": file_name,
    "gps_time_s": number,
    "strip": whole,
    "exposure_time_s": positive,
    "gain_e_per_dn": positive,
    "focus_distance_m": positive,
}
ENVIRONMENT_COLUMNS: dict[str, Parse] = {
    "gps_time_s": number,
    "illuminance_lx": optional(non_negative),
    "wind_speed_m_s": optional(non_negative),
    "wind_from_deg": optional(number),
    "temperature_c": optional(number),
    "pressure_hpa": optional(positive),
    "relative_humidity_percent": optional(non_negative),
    "satellites": optional(whole),
}
CAMERA_OBSERVATION_COLUMNS: dict[str, Parse] = {
    "target": identifier,
    "image": file_name,
    "u_px": number,
    "v_px": number,
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
