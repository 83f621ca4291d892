"""Whether the ranging line was recorded otherwise than the folder says: angles mirrored or in gon, eccentricity reversed.

Tried only where the records do not fit the scans: each arrangement is laid on one scan, and one that fits where the recorded one
does not is named. Nothing is repaired here: the record is the laboratory's.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from campaign.benches.ranging import RangingLine, StationReading
from evaluator.benches.bench_model import PanelRange
from evaluator.benches.ranging_fit import MIN_PANELS, adjusted_constants
from evaluator.benches.ranging_observations import (
    BESIDE_SHARE,
    Found,
    lidar_covariance_m2,
    observe_scans,
    panel_ranges,
    station_of,
)
from evaluator.benches.total_station import StationResult, covariance_m2, eccentricity_covariance_m2
from evaluator.model import CampaignData, EvaluationError

BETTER = 0.25  # the other arrangement's misfit, of the recorded one's
DEGREES_OF_GON = 0.9


@dataclass(frozen=True, kw_only=True)
class _Laid:
    """How an arrangement fits one scan."""

    panels: int
    share: float  # greatest distance of a panel from where the angles put it, over its size
    per_freedom: float  # chi-square of (14) over its degrees of freedom; infinite below five panels

    def fits_instead_of(self, recorded: "_Laid") -> bool:
        if self.panels < max(recorded.panels, MIN_PANELS) or self.share > BESIDE_SHARE:
            return False
        nearer = self.share < BETTER**0.5 * recorded.share and recorded.share > BESIDE_SHARE
        closer = self.per_freedom < BETTER * recorded.per_freedom
        worse = self.per_freedom > max(recorded.per_freedom, 10.0) or self.share > max(recorded.share, BESIDE_SHARE)
        return (nearer or closer or recorded.panels < MIN_PANELS) and not worse


def differences_m2(
    line: RangingLine, correction: StationResult, reference: StationResult, names: list[str], found: Found
) -> np.ndarray:
    """(n, n) of the total station's distances minus the LiDAR's: what enters (14)."""
    own = lidar_covariance_m2(names, found)[0] + covariance_m2(correction, names)
    return np.asarray(own + eccentricity_covariance_m2(line, reference, names))


def in_doubt(
    line: RangingLine, correction: StationResult, reference: StationResult, usable: list[PanelRange], found: Found
) -> bool:
    """Whether panels stand beside their places, or the residuals of (14) fail for no single panel's sake."""
    if len(usable) < MIN_PANELS or found.beside[0] > BESIDE_SHARE:
        return True
    names = [p.panel for p in usable]
    measured, first = np.array([[p.lidar_m, p.correction_m] for p in usable], float).T
    try:
        fit = adjusted_constants(names, measured, first, differences_m2(line, correction, reference, names, found))
    except EvaluationError:
        return False
    return fit.factor > 1.0


def misread(data: CampaignData, line: RangingLine) -> str | None:
    """The reason to refuse the line: the arrangement that fits a scan where the recorded one does not."""
    for scan in data.ranging.scans[:2]:
        recorded = _laid(data, line, data.ranging.readings, scan) or _Laid(panels=0, share=np.inf, per_freedom=np.inf)
        for what, other_line, readings in _others(line, data.ranging.readings):
            laid = _laid(data, other_line, readings, scan)
            if laid is not None and laid.fits_instead_of(recorded):
                return f"{what}: so the panels fit {scan[1].name}, as recorded they do not"
    return None


def _others(
    line: RangingLine, readings: tuple[StationReading, ...]
) -> list[tuple[str, RangingLine, tuple[StationReading, ...]]]:
    def turned(horizontal: float, zenith: float) -> tuple[StationReading, ...]:
        return tuple(
            replace(
                r,
                horizontal_angle_deg=None if r.horizontal_angle_deg is None else horizontal * r.horizontal_angle_deg,
                zenith_angle_deg=None if r.zenith_angle_deg is None else zenith * r.zenith_angle_deg,
            )
            for r in readings
        )

    x, y, z = line.eccentricity_m
    return [
        ("the horizontal angles run counter-clockwise (mirrored)", line, turned(-1.0, 1.0)),
        ("the angles are in gon, not in degrees", line, turned(DEGREES_OF_GON, DEGREES_OF_GON)),
        ("the eccentricity has the wrong sign", line.model_copy(update={"eccentricity_m": (-x, -y, -z)}), readings),
    ]


def _laid(
    data: CampaignData,
    line: RangingLine,
    readings: tuple[StationReading, ...],
    scan: tuple[int, Path],
) -> _Laid | None:
    found = Found()
    part = replace(data, ranging=replace(data.ranging, line=line, readings=readings, scans=(scan,)))
    try:
        correction, reference = (station_of(part, line, use, found) for use in ("correction", "reference"))
        observe_scans(part, line, correction, reference, found, lambda *_: None)
        panels, _ = panel_ranges(line, correction, reference, found)
        usable = [p for p in panels if p.correction_m is not None and p.reference_m is not None]
        names = [p.panel for p in usable]
        per_freedom = np.inf
        if len(usable) >= MIN_PANELS:
            measured, first = np.array([[p.lidar_m, p.correction_m] for p in usable], float).T
            fit = adjusted_constants(names, measured, first, differences_m2(line, correction, reference, names, found))
            per_freedom = fit.chi_square / fit.freedom
    except EvaluationError:
        return None
    return _Laid(panels=len(usable), share=found.beside[0], per_freedom=per_freedom)
