"""A row of the conformity table, and the facts that only the observations can tell."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from evaluator.benches.bench_model import ChessboardResult, RangingResult, SphereResult

Status = Literal["pass", "fail", "warning", "not_applicable", "not_recorded"]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One requirement of clauses 5 to 9 against what the campaign's records say."""

    clause: str  # "7.2 c"
    requirement: str
    measured: str
    limit: str
    status: Status


@dataclass(frozen=True, kw_only=True)
class ConformityInputs:
    """What the orchestrator learned from images, point clouds and adjustment. Everything is optional: an empty mapping or
    None is reported as "not recorded".

    Keys: panels and frustums by target id, strips by (sortie, strip), images by (sortie, image file name).
    """

    panel_points: Mapping[str, int] = field(default_factory=dict)  # LiDAR returns on the panel, whole campaign
    panel_points_by_sortie: Mapping[int, Mapping[str, int]] = field(default_factory=dict)
    panel_brightness: Mapping[str, float] = field(default_factory=dict)  # mean HSV V of the 8-bit sRGB preview, 0..1
    panel_brightness_linear: Mapping[str, float] = field(default_factory=dict)  # the same of the linear image, 0..1
    panel_clipped_share: Mapping[str, float] = field(default_factory=dict)  # pixels at full scale in the region, 0..1
    targets_in_image: Mapping[tuple[int, str], int] = field(default_factory=dict)  # targets wholly inside each image
    scan_interval_s: Mapping[tuple[int, int], float] = field(default_factory=dict)  # first to last target scanned [s]
    strip_window_s: Mapping[tuple[int, int], tuple[float, float]] = field(
        default_factory=dict
    )  # LiDAR on .. off [GPS s]
    frustum_vertices: int | None = None  # frustum targets with at least one vertex
    frustum_marks: int | None = None  # with at least one mark in an image
    frustums_used: int | None = None  # in the adjustment, after blunders were left out
    panels_picked_by: str | None = None  # "evaluator" or "person"
    frustums_picked_by: str | None = None
    indicators_measured: int | None = None  # of the eight of table 1
    sphere: SphereResult | None = None
    chessboard: ChessboardResult | None = None
    ranging: RangingResult | None = None


def row(clause: str, requirement: str, measured: str, limit: str, status: Status) -> Row:
    """A `Row` by position: the tables of the clauses read better so."""
    return Row(clause=clause, requirement=requirement, measured=measured, limit=limit, status=status)


def passed(condition: bool) -> Status:
    """The status of a plain yes or no."""
    return "pass" if condition else "fail"


def missing(clause: str, requirement: str, limit: str, what: str) -> Row:
    """A requirement whose record the campaign does not hold."""
    return row(clause, requirement, f"no {what}", limit, "not_recorded")


def percent(value: float, digits: int) -> str:
    """0.1234 as "12.3 %"."""
    return f"{100.0 * value:.{digits}f} %"
