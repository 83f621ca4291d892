"""What a plan is: figures before the flight, and the rows of the conformity table that can be answered then. Plain data."""

from dataclasses import dataclass
from typing import Literal

PlanStatus = Literal["pass", "fail", "warning", "not_applicable", "not_recorded", "after"]
PHYSICS = "physics"  # the clause of a row that no clause asks for
AMBIGUITY = "longest slant range to the ground unambiguous"  # a requirement
CONFIGURATION = "configuration"  # of what cannot be built and names no clause


MOST_NAMED = 2  # failing rows that a refusal quotes; of the others the clause


@dataclass(frozen=True, kw_only=True)
class PlanRow:
    """One requirement against the plan."""

    clause: str  # "7.2 c", or "physics"
    requirement: str
    planned: str
    limit: str
    status: PlanStatus  # "after": only the campaign itself can tell
    remedy: str = ""  # of a row that fails


@dataclass(frozen=True, kw_only=True)
class SortieFigures:
    """One sortie: one height."""

    sortie: int
    height_m: float  # above the site's origin
    speed_m_s: float
    duration_s: float
    strips: int
    images: int
    gsd_m: float | None  # by the principal distance of the lens; None without a camera
    footprint_m: tuple[float, float] | None  # of an image on level ground, across and along the track
    blur_px: float | None  # by the flight's speed during the exposure
    blur_attitude_px: float | None  # greatest, by the body's turning, at the exposures
    forward_overlap: float | None  # of neighbouring images of a strip; None with one image a strip
    side_overlap: float | None  # of neighbouring parallel strips; None with one strip a heading
    swath_m: float | None  # of the LiDAR on level ground
    points_per_m2: float | None  # of one strip, below the aircraft
    line_spacing_m: float | None
    pulse_spacing_m: float | None  # across the track, below the aircraft
    beam_footprint_m: float | None  # 1/e2, below the aircraft


@dataclass(frozen=True, kw_only=True)
class TargetPoints:
    """LiDAR returns on one target over all strips of one sortie, as the evaluator counts them."""

    target: str
    kind: Literal["panel", "frustum"]
    sortie: int
    points: int  # on the panel; or clean ones on the frustum's faces
    faces: tuple[int, ...] = ()  # frustum: least number on each face over the strips, edges included
    strips: int = 0  # that see the panel, or give a vertex


@dataclass(frozen=True, kw_only=True)
class PanelLight:
    """What one panel is expected to show."""

    panel: str
    nominal_percent: float
    dn: tuple[float, ...]  # a band, above the black level, mean over the exposures
    full_scale_dn: float
    brightness: float  # HSV V of the preview, 0..1
    echo_dn: tuple[float, float] | None  # LiDAR amplitude, least and greatest mean over strips


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """The camera's setting, made at the first strip."""

    exposure_time_s: float
    gain_e_per_dn: float
    configured_exposure_time_s: float


@dataclass(frozen=True, kw_only=True)
class Volume:
    """What the campaign fills a disk with. [bytes]"""

    images: int
    previews: int
    points: int
    waveforms: int
    trajectory: int
    bench: int
    truth: int
    image_count: int
    return_count: int
    waveform_count: int

    @property
    def total(self) -> int:
        """On the disk of a simulation, truth included."""
        return self.images + self.previews + self.points + self.waveforms + self.trajectory + self.bench + self.truth


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Standard deviations of the mountings that the flight's geometry allows."""

    std: dict[str, float]  # parameter -> degrees, m or s
    weak: tuple[str, ...]  # not determined by this flight, one line each


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Everything that can be said before the campaign."""

    campaign: str
    title: str
    start_time: str  # of the first strip, ISO 8601 as configured
    date: str  # Beijing
    duration_s: float | None  # first take-off to last landing, pauses included
    sun_window: tuple[tuple[str, str], ...]  # Beijing times between which the first strip may begin, by 7.2 c
    sun_elevation_deg: tuple[float, float] | None
    rows: tuple[PlanRow, ...]
    sorties: tuple[SortieFigures, ...] = ()
    points: tuple[TargetPoints, ...] = ()
    light: tuple[PanelLight, ...] = ()
    exposure: Exposure | None = None
    longest_range_m: float | None = None
    unambiguous_range_m: float | None = None
    volume: Volume | None = None
    accuracy: Accuracy | None = None
    accuracy_reason: str | None = None

    @property
    def failing(self) -> tuple[PlanRow, ...]:
        """Rows for which the plan is refused."""
        return tuple(row for row in self.rows if row.status == "fail")

    @property
    def refusal(self) -> str | None:
        """One sentence with clauses, what is planned, what is asked for and the way out; None where nothing fails."""
        if not self.failing:
            return None
        failing = sorted(
            self.failing, key=lambda row: row.requirement != AMBIGUITY
        )  # nothing else helps where that fails
        parts, remedies = [], []
        for row in failing[:MOST_NAMED]:
            limit = f", expected {row.limit}" if row.limit else ""
            parts.append(f"{row.clause}, {row.requirement}: got {row.planned}{limit}")
            if row.remedy and row.remedy not in remedies:
                remedies.append(row.remedy)
        if len(failing) > MOST_NAMED:
            parts.append("and " + ", ".join(dict.fromkeys(row.clause for row in failing[MOST_NAMED:])))
        return "; ".join(["the plan fails " + "; ".join(parts), *remedies])
