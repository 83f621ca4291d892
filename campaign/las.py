"""LAS 1.4: PDRF 9 with external waveform packets (.wdp), PDRF 6 as LAZ. Conventions: docs/conventions.md.

One packet length a file; the first packet stands at byte S (the packet's size, at least 60). Sample k of a packet lies at
anchor - k dt d with anchor = P + L d, d pointing towards the sensor, |d| = c/2 in m/ps.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np


@dataclass(frozen=True, kw_only=True)
class LasSpec:
    """What the header needs to know."""

    projection_epsg: int
    height_epsg: int
    creation_date: str  # ISO date of the campaign, for the header's day and year
    system_identifier: str  # <= 32 ASCII
    offset_m: tuple[float, float, float]  # of the scaled integers: near the site
    sample_count: int  # of every packet
    sampling_ps: int
    bit_depth: int  # 16: samples are stored as uint16
    file_source_id: int  # strip number


@dataclass(frozen=True, kw_only=True)
class Returns:
    """n returns (LAS rows), in the order of the file. Scale of XYZ is 0.1 mm."""

    xyz_m: np.ndarray  # (n, 3) float64: easting, northing, normal height
    gps_time_s: np.ndarray  # (n,) float64 adjusted standard GPS time of the pulse
    intensity: np.ndarray  # (n,) uint16: peak amplitude in DN above the baseline, times 16, clipped
    return_number: np.ndarray  # (n,) uint8, from 1
    number_of_returns: np.ndarray  # (n,) uint8
    scan_angle_deg: np.ndarray  # (n,) float32, from the vertical, positive to the right
    encoder_angle_deg: np.ndarray  # (n,) float32, extra byte
    channel: np.ndarray  # (n,) uint8, scanner channel (LAS scanner channel holds 0-3; the full one is an extra byte)
    amplitude: np.ndarray  # (n,) float32, extra byte "Amplitude": peak above the baseline [DN, linear]
    pulse_width_ns: np.ndarray  # (n,) float32, extra byte "Pulse width": FWHM
    reflectance_db: np.ndarray  # (n,) float32, extra byte "Reflectance": range-corrected, against 100 % at the device's own scale
    strip: np.ndarray  # (n,) uint16, point source id
    packet: np.ndarray  # (n,) int64: number of the packet in the .wdp file, -1 none
    return_location_ps: np.ndarray  # (n,) float32: L
    wave_direction_m_ps: np.ndarray  # (n, 3) float32: d


class StripWriter:
    """Streams one strip to `strip.las` + `strip.wdp` + `strip_points.laz`. A context manager; on an exception nothing is left.

    `write(returns, packets)`: `returns.packet` counts from 0 within this call (index into `packets`, uint16 (p, samples)),
    the writer adds the packets written before.
    """

    def __init__(self, las: Path, points: Path, spec: LasSpec) -> None:
        raise NotImplementedError

    def write(self, returns: Returns, packets: np.ndarray) -> None:
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        raise NotImplementedError


class StripReader:
    """Reads what any instrument wrote, in chunks; sizes are bounded by the file before memory is taken.

    Takes PDRF 0-10, with or without packets. Absent fields: amplitude falls back on intensity (an "Amplitude" extra byte in
    dB is converted by `amplitude_unit`), widths and reflectance become NaN, packet -1.
    """

    def __init__(self, las: Path, *, gps_week: int | None = None, amplitude_unit: str = "linear") -> None:
        raise NotImplementedError

    @property
    def point_count(self) -> int:
        raise NotImplementedError

    @property
    def sampling_ps(self) -> float:
        """Of the packets (0 when there are none)."""
        raise NotImplementedError

    def chunks(self, points_per_chunk: int = 1_000_000) -> Iterator[tuple[int, Returns]]:
        """Yields (number of the first record, returns)."""
        raise NotImplementedError

    def waveforms(self, packet: np.ndarray) -> np.ndarray:
        """(p,) packet numbers -> (p, samples) uint16; a packet number is a row's own `packet`. Raises CampaignError when the
        .wdp is shorter than the packets say."""
        raise NotImplementedError
