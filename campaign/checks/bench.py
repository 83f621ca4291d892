"""bench/ and ranging/ of a campaign folder: formats and cross references. No series is judged here."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path

from campaign.benches.bench import BoardExposure, SphereExposure, read_board, read_board_log, read_room, read_sphere_log
from campaign.benches.pictures import PictureSize, picture_size
from campaign.benches.ranging import (
    RangingLine,
    StationReading,
    line_path,
    read_line,
    read_readings,
    readings_path,
    scan_paths,
)
from campaign.checks.collector import Collector
from campaign.flight.las import StripReader

_PICTURES = {".tif", ".tiff", ".png", ".jpg", ".jpeg"}
_SCAN_LIKE = re.compile(r".*\.(las|laz)", re.IGNORECASE)
_NEEDED = ("slope_distance_m", "horizontal_angle_deg", "zenith_angle_deg", "temperature_c", "pressure_hpa")
_NAMED = 3  # rows or files that a line names before it counts the rest


def check_bench(check: Collector) -> None:
    """room.json, the two sphere series, the chessboard; nothing where there is no bench/."""
    folder = check.folder
    if not (folder.root / "bench").is_dir():
        return
    if not folder.room.exists():
        check.add("warning", folder.room, "missing; the room (6.3) is reported as not recorded")
    check.read_part(folder.room, read_room, expected=False)
    for place in (folder.sphere_stability, folder.sphere_repeatability):
        if place.is_dir():
            _series(check, place, read_sphere_log)
            if not folder.camera.exists():
                check.add(
                    "warning", place, "no sensors/camera.json: the black level is each image's own tag, else zero"
                )
    if folder.chessboard.is_dir():
        check.read_part(folder.chessboard / "board.json", read_board)
        _series(check, folder.chessboard, read_board_log)


def _series(
    check: Collector, place: Path, read: Callable[[Path], list[SphereExposure]] | Callable[[Path], list[BoardExposure]]
) -> None:
    """One folder of images with its log."""
    log = place / "log.csv"
    rows: Sequence[SphereExposure | BoardExposure] = check.read_part(log, read) or []
    sizes: dict[PictureSize, list[str]] = {}
    for row in rows:
        path = place / row.image
        if not check.folder.holds(path):
            continue  # named by `plain_files`
        if not path.is_file():
            check.add("error", path, "named in log.csv, but missing")
            continue
        with check.catching(path):
            sizes.setdefault(picture_size(path), []).append(row.image)
    if len(sizes) > 1:
        usual = max(sizes, key=lambda size: len(sizes[size]))
        for size, names in sizes.items():
            if size != usual:
                message = f"images of another size than most: {_some(names)}; got {size}; expected {usual}"
                check.add("warning", log, message)
    _missing_cells(check, log, rows)
    named = {row.image for row in rows}
    stems = {Path(name).stem for name in named}
    for path in sorted(place.iterdir()):
        preview = path.suffix.lower() in (".jpg", ".jpeg") and path.stem in stems
        if path.suffix.lower() in _PICTURES and path.name not in named and not preview and rows:
            check.add("warning", path, "not named in log.csv; it is not used")


def _some(names: Sequence[object]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(str(n) for n in names[:_NAMED]) + more


def _missing_cells(
    check: Collector,
    path: Path,
    rows: Sequence[SphereExposure | BoardExposure | StationReading],
    always: Sequence[str] = (),
) -> None:
    """Columns that were recorded in some rows only; those of `always` also where no row has them."""
    for name in (f.name for f in fields(rows[0])) if rows else ():
        empty = [i for i, row in enumerate(rows, 2) if getattr(row, name) is None]
        if empty and (len(empty) < len(rows) or name in always):
            check.add("warning", path, f"column {name}: no value in row {_some(empty)}")


def check_ranging(check: Collector, gps_week: int | None) -> None:
    """line.json, total_station.csv and the scans; nothing where there is no ranging/."""
    folder = check.folder
    if not folder.ranging.is_dir():
        return
    line = check.read_part(line_path(folder), read_line)
    readings = check.read_part(readings_path(folder), read_readings) or []
    _missing_cells(check, readings_path(folder), readings, _NEEDED)
    if line is not None:
        _names(check, line, readings)
    _scans(check, gps_week)


def _names(check: Collector, line: RangingLine, readings: Sequence[StationReading]) -> None:
    path = readings_path(check.folder)
    known = {"station": {s.name for s in line.stations}, "panel": {p.id for p in line.panels}}
    for column, names in known.items():
        used = Counter(getattr(r, column) for r in readings)
        for name in sorted(used.keys() - names):
            check.add("error", path, f"{column} {name} is not in line.json; {used[name]} rows name it")
        if readings:
            for name in sorted(names - used.keys()):
                check.add("warning", path, f"no reading of {column} {name}, which line.json names")
    times = Counter((r.station, r.panel, r.observation) for r in readings)
    for station, panel, observation in sorted(key for key, n in times.items() if n > 1):
        check.add("warning", path, f"observation {observation} of panel {panel} by {station} stands twice")


def _scans(check: Collector, gps_week: int | None) -> None:
    place = check.folder.ranging / "scans"
    files = sorted(p for p in place.iterdir() if _SCAN_LIKE.fullmatch(p.name)) if place.is_dir() else []
    used = scan_paths(check.folder)
    if not used:
        check.add("warning", place, "no scan_NN.laz; what needs the LiDAR's observations is reported as not measured")
    numbers = {path: number for number, path in used.items()}
    for path in files:
        if not check.folder.holds(path):
            continue  # named by `plain_files`
        if path not in numbers:
            check.add("error", path, "is not read; expected scan_NN.las or scan_NN.laz, one file for each number")
            continue
        with check.catching(path):
            if StripReader(path, gps_week=gps_week).point_count == 0:
                check.add("warning", path, "holds no point")
