"""What the surveyors delivered: survey/targets.csv (+ .prj), gcp_list.txt, spectra.csv."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pyproj

from campaign.errors import CampaignError
from campaign.formats.text import (
    Parse,
    identifier,
    number,
    one_of,
    optional,
    raise_problems,
    read_rows,
    read_table,
    within,
    write_rows,
    write_text,
)


@dataclass(frozen=True, kw_only=True)
class SurveyedTarget:
    """One row of targets.csv. Map coordinates: easting, northing (projected CRS of the manifest), normal height.

    The point is the centre of the top face of a panel or of a 2x2 board, or the centre of the mark of a frustum target. A
    board is white where its own x and y (y along the azimuth, x to its right) have the same sign.
    """

    id: str  # letters, digits, "_", "-"; unique
    kind: str  # "panel" | "frustum" | "board"
    easting_m: float
    northing_m: float
    height_m: float
    easting_std_m: float
    northing_std_m: float
    height_std_m: float
    azimuth_deg: float  # grid direction of the target's own +y edge normal, clockwise from grid north
    size_m: float  # panel, board: edge of the square; frustum: long edge b of the large rim
    nominal_reflectance_percent: float | None = None  # panels
    style: str | None = None  # frustums: "inverted" | "upright"
    thickness_m: float | None = None  # frustums: sheet metal
    vertex_faces: str | None = None  # frustums: "inner" | "outer": which faces meet in the stated vertex
    vertex_offset_m: float | None = None  # frustums: height of that vertex above the mark's centre
    mark_radius_m: float | None = None  # frustums
    material: str = ""  # "barium_sulfate" | "ptfe" | "water_based_paint"


@dataclass(frozen=True, kw_only=True)
class Spectra:
    """Spectrometer reflectance of every panel."""

    wavelength_nm: np.ndarray  # (w,) increasing, 400..1700
    panel_ids: tuple[str, ...]
    reflectance: np.ndarray  # (w, panels) 0..1 (a little above 1 is legal)


MAX_TARGETS = 2000  # ten times a large range; more is another table
MAX_SITE_M = 20_000.0  # no range is wider; beyond, the coordinates are in another system
MATERIALS = ("barium_sulfate", "ptfe", "water_based_paint")
TARGET_COLUMNS: dict[str, Parse] = {
    "id": identifier,
    "kind": one_of("panel", "frustum", "board"),
    "easting_m": number,
    "northing_m": number,
    "height_m": number,
    "easting_std_m": within(0.0, 10.0, "m"),
    "northing_std_m": within(0.0, 10.0, "m"),
    "height_std_m": within(0.0, 10.0, "m"),
    "azimuth_deg": within(-360.0, 360.0, "degrees"),
    "size_m": within(0.01, 100.0, "m"),
    "nominal_reflectance_percent": optional(within(0.01, 150.0, "%")),
    "style": optional(one_of("inverted", "upright")),
    "thickness_m": optional(within(0.0, 0.5, "m")),
    "vertex_faces": optional(one_of("inner", "outer")),
    "vertex_offset_m": optional(within(-100.0, 100.0, "m")),
    "mark_radius_m": optional(within(0.001, 50.0, "m")),
    "material": one_of("", *MATERIALS),
}
# What a target of one kind must state beside the columns that all have.
_NEEDED = {
    "panel": ("nominal_reflectance_percent",),
    "board": (),
    "frustum": ("style", "thickness_m", "vertex_faces", "vertex_offset_m", "mark_radius_m"),
}


@cache
def crs_wkt(projection_epsg: int, height_epsg: int | None, version: str) -> str:
    """WKT of the projected, or the compound, coordinate system.

    Raises
    ------
    CampaignError
        The numbers name no projected system with a height system.
    """
    name = f"EPSG:{projection_epsg}" + ("" if height_epsg is None else f"+{height_epsg}")
    try:
        return str(pyproj.CRS.from_user_input(name).to_wkt(version))
    except pyproj.exceptions.CRSError:
        raise CampaignError("is no coordinate system that is known here", where=name, expected="EPSG numbers") from None


def write_targets(path: Path, targets: list[SurveyedTarget], projection_epsg: int, height_epsg: int) -> None:
    """targets.csv, and targets.prj with the compound coordinate system for GIS tools."""
    write_text(path.with_suffix(".prj"), crs_wkt(projection_epsg, height_epsg, "WKT1_ESRI") + "\n")
    write_rows(path, list(TARGET_COLUMNS), ([getattr(t, c) for c in TARGET_COLUMNS] for t in targets))


def read_targets(path: Path) -> list[SurveyedTarget]:
    """Raises CampaignError naming row and column: NaN, duplicate id, unknown kind, missing or unknown column."""
    rows = read_rows(path, TARGET_COLUMNS)
    if len(rows) > MAX_TARGETS:
        raise CampaignError("too many targets", where=str(path), got=len(rows), expected=f"at most {MAX_TARGETS}")
    seen: set[str] = set()
    problems = []
    for i, row in enumerate(rows, 2):
        if row["id"] in seen:
            problems.append(CampaignError("the id occurs twice", where=f"{path} row {i} column id", got=row["id"]))
        seen.add(row["id"])
        for column in _NEEDED[row["kind"]]:
            if row[column] is None:
                where = f"{path} row {i} column {column}"
                problems.append(CampaignError("is empty", where=where, expected=f"a value for a {row['kind']}"))
    raise_problems(problems)
    return [SurveyedTarget(**row) for row in rows]


def far_targets(targets: list[SurveyedTarget], latitude_deg: float, longitude_deg: float, epsg: int) -> list[str]:
    """Targets that cannot belong to the site, one line each: swapped axes, another zone, kilometres, a zone's number in front.

    Raises
    ------
    CampaignError
        The number names no projected coordinate system, or the origin has no place in it.
    """
    try:
        crs = pyproj.CRS.from_epsg(epsg)
        if not crs.is_projected:
            raise CampaignError(
                "is no projected coordinate system", where=f"EPSG:{epsg}", expected="eastings, northings"
            )
        origin = pyproj.Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True).transform(
            longitude_deg, latitude_deg
        )
    except pyproj.exceptions.ProjError:
        raise CampaignError("is no coordinate system that is known here", where=f"EPSG:{epsg}") from None
    if not np.isfinite(origin).all():
        raise CampaignError(
            "the site's origin lies outside the projection",
            where=f"EPSG:{epsg}",
            got=f"{latitude_deg:g}, {longitude_deg:g}",
        )
    lines = []
    for target in targets:
        away = np.hypot(target.easting_m - origin[0], target.northing_m - origin[1])
        if not away <= MAX_SITE_M or not abs(target.height_m) <= MAX_SITE_M:
            lines.append(
                f"{target.id}: lies {away / 1000.0:.0f} km from the site's origin, height {target.height_m:g} m; expected "
                f"eastings and northings near {origin[0]:.0f}, {origin[1]:.0f} by the manifest's EPSG:{epsg}, in metres"
            )
    return lines


def write_gcp_list(path: Path, targets: list[SurveyedTarget], projection_epsg: int) -> None:
    """ODM's ground control list: its header and the targets as comments, to which a person adds image rows.

    An image row is: easting northing height column row image target.
    """
    lines = [f"EPSG:{projection_epsg}", "# easting_m northing_m height_m target"]
    lines += [f"# {t.easting_m:.4f} {t.northing_m:.4f} {t.height_m:.4f} {t.id}" for t in targets]
    write_text(path, "\n".join(lines) + "\n")


def write_spectra(path: Path, spectra: Spectra) -> None:
    """spectra.csv: wavelength_nm and one column for each panel."""
    table = np.column_stack([spectra.wavelength_nm, spectra.reflectance])
    write_rows(path, ["wavelength_nm", *spectra.panel_ids], table.astype(float).tolist())


def read_spectra(path: Path) -> Spectra:
    """Raises CampaignError naming row and column: not finite, wavelengths not increasing, reflectance outside 0 to 1.5."""
    header, rows = read_table(path)
    if header[0] != "wavelength_nm" or len(header) < 2 or len(rows) < 2:
        raise CampaignError(
            "is no table of spectra", where=str(path), expected="wavelength_nm, then a column for each panel"
        )
    if len(set(header)) != len(header):
        raise CampaignError("a panel occurs twice", where=str(path))
    try:
        for name in header[1:]:
            identifier(name)
        table = np.array(rows, dtype=float)
    except ValueError as error:
        raise CampaignError(
            "wrong value", where=str(path), got=error, expected="panel ids, and numbers below them"
        ) from None
    wrong = ~np.isfinite(table)
    wrong[:, 1:] |= (table[:, 1:] < 0.0) | (table[:, 1:] > 1.5)
    wrong[1:, 0] |= np.diff(table[:, 0]) <= 0.0
    if wrong.any():
        row, column = (int(i) for i in np.argwhere(wrong)[0])
        expected = "increasing wavelengths" if column == 0 else "a reflectance from 0 to 1.5"
        raise CampaignError(
            "wrong value",
            where=f"{path} row {row + 2} column {header[column]}",
            got=rows[row][column][:40],
            expected=expected,
        )
    dark = [name for name, column in zip(header[1:], table[:, 1:].T) if not column.any()]
    if dark:
        raise CampaignError(
            "a panel reflects nothing", where=f"{path} column {dark[0]}", expected="0 to 1.5, not all 0"
        )
    return Spectra(
        wavelength_nm=table[:, 0], panel_ids=tuple(header[1:]), reflectance=np.ascontiguousarray(table[:, 1:])
    )
