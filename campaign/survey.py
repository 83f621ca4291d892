"""What the surveyors delivered: survey/targets.csv (+ .prj), gcp_list.txt, spectra.csv."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True, kw_only=True)
class SurveyedTarget:
    """One row of targets.csv. Map coordinates: easting, northing (projected CRS of the manifest), normal height.

    The point is the centre of the top face of a panel, or the centre of the mark of a frustum target.
    """

    id: str  # letters, digits, "_", "-"; unique
    kind: str  # "panel" | "frustum"
    easting_m: float
    northing_m: float
    height_m: float
    easting_std_m: float
    northing_std_m: float
    height_std_m: float
    azimuth_deg: float  # grid direction of the target's own +y edge normal, clockwise from grid north
    size_m: float  # panel: edge of the square; frustum: long edge b of the large rim
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


def write_targets(path: Path, targets: list[SurveyedTarget], projection_epsg: int, height_epsg: int) -> None:
    raise NotImplementedError


def read_targets(path: Path) -> list[SurveyedTarget]:
    """Raises CampaignError naming row and column: NaN, duplicate id, unknown kind, missing or unknown column."""
    raise NotImplementedError


def write_gcp_list(path: Path, targets: list[SurveyedTarget], projection_epsg: int) -> None:
    """ODM's ground control list header with target coordinates, no image rows."""
    raise NotImplementedError


def write_spectra(path: Path, spectra: Spectra) -> None:
    raise NotImplementedError


def read_spectra(path: Path) -> Spectra:
    raise NotImplementedError
