"""bench/: the indoor records of 8.2.2 and 9.2.2. room.json, and for each series a folder of images with a log.csv.

bench/room.json                 Room
bench/sphere_stability/         log.csv (SphereExposure), images
bench/sphere_repeatability/     the same
bench/chessboard/               board.json (BoardSheet), log.csv (BoardExposure), images
"""

from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from campaign.config import Model
from campaign.errors import CampaignError
from campaign.formats.text import (
    Parse,
    file_name,
    optional,
    read_model,
    read_rows,
    within,
    write_model,
    write_rows,
)


class RoomSheet(Model):
    """6.3.1, 6.3.2: the benches' room and instruments. None: not recorded."""

    dust_free: bool | None = None
    single_light_source: bool | None = None
    temperature_c: Annotated[float, Field(ge=-60.0, le=80.0)] | None = None
    relative_humidity_percent: Annotated[float, Field(ge=0.0, le=100.0)] | None = None
    pressure_hpa: Annotated[float, Field(ge=400.0, le=1200.0)] | None = None
    sphere_traceability: str | None = Field(None, description="class and certificate of the integrating sphere")


class BoardSheet(Model):
    """One chessboard. Inner corners are numbered row by row; (0, 0) is the board's frame, x along a row, y down, z away."""

    inner_columns: Annotated[int, Field(ge=3, le=200)]
    inner_rows: Annotated[int, Field(ge=3, le=200)]
    square_m: Annotated[float, Field(gt=1e-4, le=10.0)]
    width_m: Annotated[float, Field(gt=0.0, le=100.0)] | None = Field(None, description="of the whole board")
    height_m: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    flatness_m: Annotated[float, Field(ge=0.0, le=0.1)] | None = Field(None, description="as certified")
    material: str = ""


@dataclass(frozen=True, kw_only=True)
class SphereExposure:
    """One row of a sphere series' log.csv, in the order of time. None: not recorded."""

    image: str  # file name beside log.csv
    gps_time_s: float  # adjusted standard GPS time
    since_lamp_on_s: float | None = None
    exposure_time_s: float | None = None
    gain_e_per_dn: float | None = None
    f_number: float | None = None
    camera_temperature_c: float | None = None


@dataclass(frozen=True, kw_only=True)
class BoardExposure:
    """One row of the chessboard's log.csv. None: not recorded."""

    image: str
    gps_time_s: float | None = None
    distance_m: float | None = None  # camera to board, as set up: names the position of 9.2.2 d
    focus_distance_m: float | None = None  # setting of the lens
    f_number: float | None = None
    exposure_time_s: float | None = None
    gain_e_per_dn: float | None = None


_TIME = within(-1e9, 1e10, "s of adjusted GPS time")
SPHERE_COLUMNS: dict[str, Parse] = {
    "image": file_name,
    "gps_time_s": _TIME,
    "since_lamp_on_s": optional(within(0.0, 1e6, "s")),
    "exposure_time_s": optional(within(1e-7, 100.0, "s")),
    "gain_e_per_dn": optional(within(1e-6, 1e6, "e/DN")),
    "f_number": optional(within(0.1, 1000.0, "")),
    "camera_temperature_c": optional(within(-100.0, 150.0, "degrees Celsius")),
}
BOARD_COLUMNS: dict[str, Parse] = {
    "image": file_name,
    "gps_time_s": optional(_TIME),
    "distance_m": optional(within(0.01, 1e4, "m")),
    "focus_distance_m": optional(within(0.01, 1e6, "m")),
    "f_number": optional(within(0.1, 1000.0, "")),
    "exposure_time_s": optional(within(1e-7, 100.0, "s")),
    "gain_e_per_dn": optional(within(1e-6, 1e6, "e/DN")),
}
MAX_IMAGES = 2000  # of one series


def write_room(path: Path, room: RoomSheet) -> None:
    """room.json."""
    write_model(path, room)


def read_room(path: Path) -> RoomSheet:
    """Raises CampaignError naming the key."""
    return read_model(path, RoomSheet)


def write_board(path: Path, board: BoardSheet) -> None:
    """board.json."""
    write_model(path, board)


def read_board(path: Path) -> BoardSheet:
    """Raises CampaignError naming the key."""
    return read_model(path, BoardSheet)


def write_sphere_log(path: Path, rows: list[SphereExposure]) -> None:
    """log.csv of one sphere series."""
    write_rows(path, list(SPHERE_COLUMNS), ([getattr(r, c) for c in SPHERE_COLUMNS] for r in rows))


def read_sphere_log(path: Path) -> list[SphereExposure]:
    """Raises CampaignError naming row and column; times must rise. Columns that were not recorded may be absent."""
    rows = [SphereExposure(**row) for row in _rows(path, SPHERE_COLUMNS, SphereExposure, ["image", "gps_time_s"])]
    for i, (before, after) in enumerate(pairwise(rows), 3):
        if after.gps_time_s <= before.gps_time_s:
            raise CampaignError("time does not rise", where=f"{path} row {i} column gps_time_s", got=after.gps_time_s)
    return rows


def write_board_log(path: Path, rows: list[BoardExposure]) -> None:
    """log.csv of the chessboard."""
    write_rows(path, list(BOARD_COLUMNS), ([getattr(r, c) for c in BOARD_COLUMNS] for r in rows))


def read_board_log(path: Path) -> list[BoardExposure]:
    """Raises CampaignError naming row and column. Columns that were not recorded may be absent."""
    return [BoardExposure(**row) for row in _rows(path, BOARD_COLUMNS, BoardExposure, ["image"])]


def _rows(path: Path, columns: dict[str, Parse], row_type: type, required: list[str]) -> list[dict[str, Any]]:
    known = {f.name for f in fields(row_type)}
    assert known == set(columns)
    empty: dict[str, Any] = dict.fromkeys(columns)
    rows = [empty | row for row in read_rows(path, columns, required)]
    if len(rows) > MAX_IMAGES:
        raise CampaignError("too many images", where=str(path), got=len(rows), expected=f"at most {MAX_IMAGES}")
    seen: set[str] = set()
    for i, row in enumerate(rows, 2):
        if row["image"] in seen:
            raise CampaignError("the image is named twice", where=f"{path} row {i}", got=row["image"])
        seen.add(row["image"])
    return rows
