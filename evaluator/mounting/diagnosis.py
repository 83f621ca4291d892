"""What deviates from what was stated: one row for each parameter that the campaign determines, with its z.

Stated are the drawing's mountings and synchronisation (rig.json), the lens certificate, a range without error, the logged gain,
the LiDAR's response constant.
A deviation is told when |z| passes the limit for the whole table, Phi^-1(1 - 0.005/m) for m rows. Which target the survey
puts wrong is told by the adjustment's rejected observations; they stand beside.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from campaign.sensors import Calibration
from evaluator.benches.bench_model import ChessboardResult, RangingResult
from evaluator.benches.photon_transfer import PhotonTransfer
from evaluator.camera_model import LENS_NAMES, lens_vector
from evaluator.lidar_response import LidarResponse
from evaluator.model import MountingSolution

_FAMILY = 0.005


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """One parameter against what was stated of it."""

    quantity: str
    unit: str
    stated: float
    estimate: float
    std: float  # of the difference
    z: float


def family_limit(count: int) -> float:
    """|z| that the greatest of `count` normal values passes in one case of a hundred.

    Parameters
    ----------
    count : int
        Values looked at together.

    Returns
    -------
    float
        Phi^-1(1 - 0.005 / count).
    """
    return float(norm.ppf(1.0 - _FAMILY / max(count, 1)))


def deviations(
    mounting: MountingSolution | None,
    chessboard: ChessboardResult | None,
    certificate: Calibration | None,
    ranging: RangingResult | None,
    transfer: PhotonTransfer | None,
    response: LidarResponse | None = None,
) -> tuple[Deviation, ...]:
    """Every parameter that the campaign determines; parts that are absent give no row."""
    rows: list[Deviation] = []
    if mounting is not None:
        std = np.sqrt(np.diag(mounting.covariance))
        for name, value, s in zip(mounting.names, mounting.parameters, std, strict=True):
            unit, scale = ("deg", np.degrees(1.0)) if "boresight" in name else ("s" if "clock" in name else "m", 1.0)
            rows.append(_row(name, unit, 0.0, float(value) * scale, float(s) * scale))
    if chessboard is not None and chessboard.lens is not None and chessboard.covariance is not None and certificate:
        variance = np.diag(np.array(certificate.covariance)) + np.diag(chessboard.covariance)
        stated, found = lens_vector(certificate.lens), lens_vector(chessboard.lens)
        for k, name in enumerate(LENS_NAMES):
            unit = "px" if name.endswith("_px") else ""
            rows.append(_row(f"camera_{name}", unit, float(stated[k]), float(found[k]), float(np.sqrt(variance[k]))))
    if ranging is not None and ranging.covariance is not None:
        for name, unit, value, variance_ in (
            ("ranging_additive_constant", "m", ranging.additive_constant_m, ranging.covariance[0, 0]),
            ("ranging_multiplication_constant", "", ranging.multiplication_constant, ranging.covariance[1, 1]),
        ):
            if value is not None:
                rows.append(_row(name, unit, 0.0, value, float(np.sqrt(variance_))))
    if transfer is not None and transfer.stated_e_per_dn:
        ratio = transfer.stated_e_per_dn / transfer.gain_e_per_dn
        rows.append(_row("camera_gain", "", 1.0, ratio, ratio * transfer.std_e_per_dn / transfer.gain_e_per_dn))
    if response is not None:
        rows.append(_row("lidar_gain", "", 1.0, response.gain, response.gain_std))
    return tuple(rows)


def _row(quantity: str, unit: str, stated: float, estimate: float, std: float) -> Deviation:
    return Deviation(
        quantity=quantity,
        unit=unit,
        stated=stated,
        estimate=estimate,
        std=std,
        z=(estimate - stated) / std if std > 0.0 else 0.0,
    )


def suspects(rejected: Sequence[str], targets: Sequence[str], swapped: Sequence[Sequence[str]] = ()) -> tuple[str, ...]:
    """Targets whose surveyed place or height an adjustment left out, and those found at each other's place."""
    named = {line.split(":")[0] for line in rejected} | {t for pair in swapped for t in pair}
    return tuple(t for t in targets if named & {t, f"surveyed place of {t}", f"surveyed height of {t}"})


def diagnosis_block(rows: Sequence[Deviation], survey: Sequence[str], stated: Sequence[str] = ()) -> dict[str, object]:
    """For results.json: the rows, the limit, what passes it, the targets whose surveyed place is doubted, and what the mountings'
    adjustment took as stated although its observations contradict it."""
    limit = family_limit(len(rows))
    return {
        "limit": limit,
        "rows": [vars(r) for r in rows],
        "deviating": [r.quantity for r in rows if abs(r.z) > limit],
        "surveyed_places_in_doubt": list(survey),
        "stated_in_doubt": list(stated),
    }
