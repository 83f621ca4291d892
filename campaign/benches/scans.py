"""Scans of the ranging line: points about a LiDAR's own centre, as LAS 1.4 PDRF 6 (LAZ). Written, and read within bounds.

A scan lies in the instrument's own axes, so its CRS is a local one. Flights are in `campaign.flight.las`, which also reads here.
"""

import datetime
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import laspy  # type: ignore[import-untyped]
import lazrs  # type: ignore[import-untyped]
import numpy as np

from campaign.errors import CampaignError
from campaign.flight.las import GENERATING_SOFTWARE, SCALE_M, StripReader
from campaign.writing.atomic import complete_file

MAX_POINTS = 10_000_000  # kept in memory of one scan
LOCAL_WKT = (
    'LOCAL_CS["LiDAR axes",LOCAL_DATUM["LiDAR centre",0],UNIT["metre",1.0],AXIS["x",OTHER],AXIS["y",OTHER],'
    'AXIS["z",OTHER]]'
)
_EXTRA = (
    ("Amplitude", "f4", "DN above baseline, linear"),
    ("Pulse width", "f4", "ns, FWHM"),
    ("Reflectance", "f4", "dB"),
)


@dataclass(frozen=True, kw_only=True)
class ScanPoints:
    """n returns of one scan. The origin is the LiDAR's centre."""

    xyz_m: np.ndarray  # (n, 3) float64
    gps_time_s: np.ndarray  # (n,) adjusted standard GPS time; NaN where the file has none
    intensity: np.ndarray  # (n,) uint16
    amplitude: np.ndarray  # (n,) float32, linear; NaN or the intensity where the file has none
    pulse_width_ns: np.ndarray  # (n,) float32, NaN where the file has none
    reflectance_db: np.ndarray  # (n,) float32, NaN where the file has none
    return_number: np.ndarray  # (n,) uint8, from 1
    number_of_returns: np.ndarray  # (n,) uint8


def joined(parts: list[ScanPoints]) -> ScanPoints:
    """At least one part, in order."""
    return ScanPoints(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(ScanPoints)})


def write_scan(path: Path, points: ScanPoints, *, number: int, creation_date: str, system_identifier: str) -> None:
    """One scan, complete or not at all.

    Parameters
    ----------
    number : int
        Of the scan; file source id and point source id.
    creation_date : str
        ISO date of the campaign, for the header's day and year.
    """
    steps = np.rint(points.xyz_m / SCALE_M)
    if not np.isfinite(steps).all() or (steps.size and np.abs(steps).max() >= 2**31):
        raise CampaignError("a point lies too far from the LiDAR", where=str(path), expected="within 214 km")
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, SCALE_M), np.zeros(3)
    header.creation_date = datetime.date.fromisoformat(creation_date)
    header.system_identifier = system_identifier[:32]
    header.generating_software = GENERATING_SOFTWARE
    header.file_source_id = number
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.global_encoding.wkt = True
    header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "OGC WKT", LOCAL_WKT.encode() + b"\0"))
    header.add_extra_dims([laspy.ExtraBytesParams(name, kind, unit) for name, kind, unit in _EXTRA])
    for struct in header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs:
        struct.options &= ~(struct.MIN_BIT_MASK | struct.MAX_BIT_MASK)
    record = np.zeros(len(steps), header.point_format.dtype())
    record["X"], record["Y"], record["Z"] = steps.T
    record["intensity"] = points.intensity
    record["bit_fields"] = (points.return_number & 15) | (points.number_of_returns & 15) << 4
    record["point_source_id"] = number
    record["gps_time"] = points.gps_time_s
    record["Amplitude"], record["Pulse width"] = points.amplitude, points.pulse_width_ns
    record["Reflectance"] = points.reflectance_db
    try:
        with complete_file(path) as work, work.open("wb") as file:
            las = laspy.LasWriter(
                file, header, do_compress=True, laz_backend=laspy.LazBackend.LazrsParallel, closefd=False
            )
            if len(record):
                las.write_points(laspy.PackedPointRecord(record, header.point_format))
            las.close()
    except lazrs.LazrsError as error:  # hides the system's own error
        remedy = "is there space left on the disk?"
        raise CampaignError("cannot be written", where=str(path), got=error, remedy=remedy) from None


def read_scan(
    path: Path, keep: Callable[[np.ndarray], np.ndarray] | None = None, *, amplitude_unit: str = "linear"
) -> ScanPoints:
    """The points of a scan that `keep` accepts; the rest is never held.

    Parameters
    ----------
    keep : callable, optional
        (n, 3) coordinates -> (n,) bool.
    amplitude_unit : str
        "linear", or "db" as some makers write the extra byte.

    Raises
    ------
    CampaignError
        Not readable, no points, or more than MAX_POINTS kept.
    """
    reader = StripReader(path, amplitude_unit=amplitude_unit)
    parts, total = [], 0
    for _, block in reader.chunks():
        chosen = np.ones(len(block.gps_time_s), bool) if keep is None else keep(block.xyz_m)
        parts.append(ScanPoints(**{f.name: getattr(block, f.name)[chosen] for f in fields(ScanPoints)}))
        total += len(parts[-1].gps_time_s)
        if total > MAX_POINTS:
            raise CampaignError("too many points", where=str(path), got=total, expected=f"at most {MAX_POINTS}")
    if not parts:
        raise CampaignError("holds no point", where=str(path))
    return joined(parts)
