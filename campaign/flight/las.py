"""LAS 1.4: PDRF 9 with external waveform packets (.wdp), PDRF 6 as LAZ. Conventions: docs/conventions.md.

One packet length a file; the first packet stands at byte S (the packet's size, at least 60). Sample k of a packet lies at
anchor - k dt d with anchor = P + L d, d pointing towards the sensor, |d| = c/2 in m/ps.
"""

import contextlib
import datetime
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

import laspy  # type: ignore[import-untyped]
import lazrs  # type: ignore[import-untyped]
import numpy as np

from campaign.errors import CampaignError
from campaign.flight.trajectory import week_start_s
from campaign.formats.las_layout import LasHeader, WaveDescriptor, read_header
from campaign.formats.las_packets import PacketTable, packet_table, records
from campaign.survey import crs_wkt
from campaign.writing.atomic import part_of, readable_os_errors


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
    reflectance_db: (
        np.ndarray
    )  # (n,) float32, extra byte "Reflectance": range-corrected, 0 dB: 100 % by the device's own scale
    strip: np.ndarray  # (n,) uint16, point source id
    packet: np.ndarray  # (n,) int64: number of the packet in the .wdp file, -1 none
    return_location_ps: np.ndarray  # (n,) float32: L
    wave_direction_m_ps: np.ndarray  # (n, 3) float32: d


GENERATING_SOFTWARE = "testrange"
SCALE_M = 0.0001
SCAN_ANGLE_STEP_DEG = 0.006
TWIN_POINTS = (
    400_000  # compressed at once: eight of LAZ's own chunks, so that every core has some (lazrs lets nobody else run)
)
MAX_CHUNK_BYTES = 256_000_000
SCAN_BYTES = 8_000_000  # of records at once where few columns are looked at
# Extra bytes in the order of the record: name, type, unit and meaning (32 characters), field of Returns. RIEGL's names first.
EXTRA_BYTES = (
    ("Amplitude", "f4", "DN above baseline, linear", "amplitude"),
    ("Pulse width", "f4", "ns, FWHM", "pulse_width_ns"),
    ("Reflectance", "f4", "dB", "reflectance_db"),
    ("Encoder angle", "f4", "deg, 0 nadir, right positive", "encoder_angle_deg"),
    ("Scanner channel", "u1", "0-255", "channel"),
)


class StripWriter:
    """Streams one strip to `strip.las` + `strip.wdp` + `strip_points.laz`. A context manager; on an exception nothing is left.

    `write(returns, packets)`: `returns.packet` counts from 0 within this call (index into `packets`, uint16 (p, samples)),
    the writer adds the packets written before. Memory does not grow with the strip.
    """

    def __init__(self, las: Path, points: Path, spec: LasSpec) -> None:
        self._spec = spec
        self._targets = (las, las.with_suffix(".wdp"), points)
        self._work = tuple(part_of(target) for target in self._targets)
        self._packet_bytes = 2 * spec.sample_count
        self._first_byte = first_packet_byte(self._packet_bytes)
        self._packets = 0
        self._files: list[BinaryIO] = []
        with self._cleaning():
            las.parent.mkdir(parents=True, exist_ok=True)
            points.parent.mkdir(parents=True, exist_ok=True)
            self._files = [work.open("w+b") for work in self._work]
            self._files[1].write(bytes(self._first_byte))
            self._las = laspy.LasWriter(self._files[0], _header(spec, 9), closefd=False)
            self._laz = laspy.LasWriter(
                self._files[2],
                _header(spec, 6),
                do_compress=True,
                laz_backend=laspy.LazBackend.LazrsParallel,
                closefd=False,
            )
            self._twin = np.empty(TWIN_POINTS, self._laz.header.point_format.dtype())
            self._waiting = 0

    def write(self, returns: Returns, packets: np.ndarray) -> None:
        """Append returns and the packets that they refer to."""
        count, used = len(returns.gps_time_s), returns.packet
        if packets.dtype != np.uint16 or packets.ndim != 2 or packets.shape[1] != self._spec.sample_count:
            raise ValueError(f"packets must be uint16 (p, {self._spec.sample_count})")
        if count and (int(used.max()) >= len(packets) or int(used.min()) < -1):
            raise ValueError("a return names a packet that is not given")
        with self._cleaning():
            self._files[1].write(np.ascontiguousarray(packets, "<u2").data)
            if count:
                record = self._las_record(returns)
                self._las.write_points(laspy.PackedPointRecord(record, self._las.header.point_format))
                self._write_twin(record)
            self._packets += len(packets)

    def _write_twin(self, record: np.ndarray) -> None:
        """Put points into the compressed twin's batch, and compress it when it is full."""
        done = 0
        while done < len(record):
            part = record[done : done + TWIN_POINTS - self._waiting]
            batch = self._twin[self._waiting : self._waiting + len(part)]
            for name in self._twin.dtype.names or ():
                batch[name] = part[name]
            done, self._waiting = done + len(part), self._waiting + len(part)
            if self._waiting == TWIN_POINTS:
                self._compress()

    def _compress(self) -> None:
        points, self._waiting = self._twin[: self._waiting], 0
        if len(points):
            self._laz.write_points(laspy.PackedPointRecord(points, self._laz.header.point_format))

    def _las_record(self, returns: Returns) -> np.ndarray:
        spec = self._spec
        record = np.zeros(len(returns.gps_time_s), self._las.header.point_format.dtype())
        steps = np.rint((returns.xyz_m - np.asarray(spec.offset_m)) / SCALE_M)
        if not np.isfinite(steps).all() or np.abs(steps).max() >= 2**31:
            raise CampaignError(
                "a point lies too far from the offset", where=str(self._targets[0]), expected="within 214 km"
            )
        record["X"], record["Y"], record["Z"] = steps.T
        record["intensity"] = returns.intensity
        record["bit_fields"] = (returns.return_number & 15) | (returns.number_of_returns & 15) << 4
        record["classification_flags"] = (returns.channel & 3) << 4
        record["scan_angle"] = np.clip(np.rint(returns.scan_angle_deg / SCAN_ANGLE_STEP_DEG), -30_000, 30_000)
        record["point_source_id"] = returns.strip
        record["gps_time"] = returns.gps_time_s
        has = returns.packet >= 0
        first = self._first_byte + self._packets * self._packet_bytes
        record["wavepacket_index"] = has
        record["wavepacket_offset"] = np.where(has, first + returns.packet * self._packet_bytes, 0)
        record["wavepacket_size"] = np.where(has, self._packet_bytes, 0)
        record["return_point_wave_location"] = returns.return_location_ps
        record["x_t"], record["y_t"], record["z_t"] = returns.wave_direction_m_ps.T
        for name, _, _, field in EXTRA_BYTES:
            record[name] = getattr(returns, field)
        return record

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._remove()
            return
        with self._cleaning():
            self._las.close()
            self._compress()
            self._laz.close()
            length = self._first_byte - 60 + self._packets * self._packet_bytes
            self._files[1].seek(0)
            self._files[1].write(struct.pack("<H16sHQ32s", 0, b"LASF_Spec", 65535, length, b"waveform data packets"))
            for file in self._files:
                file.close()
            for work, target in zip(self._work, self._targets):
                work.replace(target)

    @contextlib.contextmanager
    def _cleaning(self) -> Iterator[None]:
        """Whatever goes wrong inside: nothing is left behind, and a full disk is one line."""
        try:
            with readable_os_errors(self._targets[0]):
                yield
        except lazrs.LazrsError as error:  # hides the system's own error
            self._remove()
            remedy = "is there space left on the disk?"
            raise CampaignError("cannot be written", where=str(self._targets[2]), got=error, remedy=remedy) from None
        except BaseException:
            self._remove()
            raise

    def _remove(self) -> None:
        for file in self._files:
            with contextlib.suppress(OSError):
                file.close()
        for work in self._work:
            work.unlink(missing_ok=True)


def first_packet_byte(packet_bytes: int) -> int:
    """Where the first packet stands: the packet's size, or its first multiple that leaves the 60 bytes of the header free."""
    return packet_bytes * max(1, -(-60 // packet_bytes))


def _header(spec: LasSpec, point_format: int) -> laspy.LasHeader:
    header = laspy.LasHeader(version="1.4", point_format=point_format)
    header.scales = np.full(3, SCALE_M)
    header.offsets = np.asarray(spec.offset_m, float)
    header.creation_date = datetime.date.fromisoformat(spec.creation_date)
    header.system_identifier = spec.system_identifier[:32]
    header.generating_software = GENERATING_SOFTWARE
    header.file_source_id = spec.file_source_id
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.global_encoding.wkt = True
    wkt = crs_wkt(spec.projection_epsg, spec.height_epsg, "WKT1_GDAL")
    header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "OGC WKT", wkt.encode() + b"\0"))
    header.add_extra_dims([laspy.ExtraBytesParams(name, kind, unit) for name, kind, unit, _ in EXTRA_BYTES])
    for struct_ in header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs:
        struct_.options &= ~(struct_.MIN_BIT_MASK | struct_.MAX_BIT_MASK)  # laspy's ranges depend on the chunks written
    if point_format == 9:
        header.global_encoding.waveform_data_packets_external = True
        descriptor = struct.pack("<BBIIdd", 16, 0, spec.sample_count, spec.sampling_ps, 1.0, 0.0)
        header.vlrs.append(laspy.VLR("LASF_Spec", 100, "waveform descriptor", descriptor))
    return header


class StripReader:
    """Reads what any instrument wrote, in chunks; sizes are bounded by the file before memory is taken.

    Takes LAS 1.0-1.4, PDRF 0-10, plain or LAZ, with or without packets (external .wdp or internal). Absent fields: amplitude
    falls back on intensity (an "Amplitude" extra byte in dB, `amplitude_unit="db"`, becomes linear power 10^(dB/10)), widths,
    reflectance and encoder angle become NaN, packet -1.

    Times in seconds of the week become adjusted standard GPS time by `gps_week`; without it they stay as they are and
    `week_seconds` is True. PDRF 0 and 2 have no time: NaN.
    """

    def __init__(self, las: Path, *, gps_week: int | None = None, amplitude_unit: str = "linear") -> None:
        self._header = read_header(las)
        self._gps_week = gps_week
        self._amplitude_unit = amplitude_unit

    @property
    def path(self) -> Path:
        return self._header.path

    @property
    def header(self) -> LasHeader:
        """As checked against the file's size."""
        return self._header

    @property
    def point_count(self) -> int:
        return self._header.point_count

    @property
    def sampling_ps(self) -> float:
        """Of the packets (0 when there are none); the first descriptor's that a record names."""
        packets = self._packets
        return packets.descriptors[0].sampling_ps if packets and packets.descriptors else 0.0

    @cached_property
    def week_seconds(self) -> bool:
        """Whether the file's own times count from the start of a GPS week.

        The header's bit decides, unless the first time is greater than two weeks, which only standard time can be.
        """
        if self._header.adjusted_time or "gps_time" not in (self._header.record.names or ()):
            return False
        return all(
            abs(float(block["gps_time"][0])) < 1_209_600.0 for _, block in records(self._header, 1, only_first=True)
        )

    @cached_property
    def _packets(self) -> PacketTable | None:
        return packet_table(self._header) if self._header.has_waveforms else None

    def time_range(self) -> tuple[float, float] | None:
        """Least and greatest time of the records; None without points or times."""
        if self.point_count == 0 or "gps_time" not in (self._header.record.names or ()):
            return None
        ends = [
            (float(block["gps_time"].min()), float(block["gps_time"].max()))
            for _, block in records(self._header, max(1, SCAN_BYTES // self._header.record.itemsize))
        ]
        start = week_start_s(self._gps_week) if self._gps_week is not None and self.week_seconds else 0.0
        return min(e[0] for e in ends) + start, max(e[1] for e in ends) + start

    def check_packets(self) -> None:
        """Raises CampaignError when the .wdp is missing or shorter than the packets say."""
        if self._packets is not None:
            self._packets.check()

    def chunks(self, points_per_chunk: int = 1_000_000) -> Iterator[tuple[int, Returns]]:
        """Yields (number of the first record, returns)."""
        size = max(1, min(points_per_chunk, MAX_CHUNK_BYTES // self._header.record.itemsize))
        for first, block in records(self._header, size):
            yield first, self._returns(block)

    def chosen(
        self, choose: Callable[[int, np.ndarray], np.ndarray], points_per_chunk: int | None = None
    ) -> Iterator[tuple[np.ndarray, Returns]]:
        """Yields (numbers (m,) int64 of records, returns) of the rows that `choose` takes; of others only the place is looked at.

        Parameters
        ----------
        choose : callable
            (number of the first record, (n, 2) easting and northing [m]) -> (m,) places among these n rows.
        """
        scale, offset = self._header.scale, self._header.offset
        size = max(1, min(points_per_chunk or MAX_CHUNK_BYTES, SCAN_BYTES // self._header.record.itemsize))
        for first, block in records(self._header, size):
            xy = np.stack([block[n] * s + o for n, s, o in zip("XY", scale, offset)], axis=1)
            rows = choose(first, xy)
            if len(rows):
                yield first + rows, self._returns(block[rows])

    def _returns(self, block: np.ndarray) -> Returns:
        header, names = self._header, block.dtype.names or ()
        count = len(block)
        modern = header.point_format >= 6
        nan = np.full(count, np.nan, np.float32)
        time = block["gps_time"].astype(float) if "gps_time" in names else np.full(count, np.nan)
        if self._gps_week is not None and self.week_seconds:
            time = time + week_start_s(self._gps_week)
        angle = block["scan_angle"].astype(np.float32)
        channel = self._extra(block, "scanner channel")
        if channel is None:
            channel = (block["flags"] >> 4) & 3 if modern else np.zeros(count, np.uint8)
        amplitude = self._extra(block, "amplitude")
        if amplitude is None:
            amplitude = block["intensity"].astype(np.float32)
        elif self._amplitude_unit == "db":
            amplitude = np.power(10.0, amplitude / 10.0)
        widths, reflectance, encoder = (self._extra(block, n) for n in ("pulse width", "reflectance", "encoder angle"))
        packets = self._packets
        return Returns(
            xyz_m=np.stack([block[n] * s + o for n, s, o in zip("XYZ", header.scale, header.offset)], axis=1),
            gps_time_s=time,
            intensity=block["intensity"].astype(np.uint16),
            return_number=block["returns"] & 15 if modern else block["flags"] & 7,
            number_of_returns=block["returns"] >> 4 if modern else (block["flags"] >> 3) & 7,
            scan_angle_deg=angle * np.float32(SCAN_ANGLE_STEP_DEG) if modern else angle,
            encoder_angle_deg=nan if encoder is None else encoder.astype(np.float32),
            channel=channel.astype(np.uint8),
            amplitude=amplitude.astype(np.float32),
            pulse_width_ns=nan if widths is None else widths.astype(np.float32),
            reflectance_db=nan if reflectance is None else reflectance.astype(np.float32),
            strip=block["source"].astype(np.uint16),
            packet=np.full(count, -1, np.int64) if packets is None else packets.numbers(block),
            return_location_ps=block["location"].copy() if header.has_waveforms else nan,
            wave_direction_m_ps=block["direction"].copy() if header.has_waveforms else np.stack([nan] * 3, axis=1),
        )

    def _extra(self, block: np.ndarray, name: str) -> np.ndarray | None:
        field = self._header.extra.get(name)
        if field is None:
            return None
        raw = block[field.field]
        return raw.copy() if field.scale == 1.0 and field.offset == 0.0 else raw * field.scale + field.offset

    def waveforms(self, packet: np.ndarray) -> np.ndarray:
        """(p,) packet numbers -> (p, samples) uint16; a packet number is a row's own `packet`. Raises CampaignError when the
        .wdp is shorter than the packets say.

        Where packets differ in length, the shorter ones are continued with their last sample; packets of different sampling
        are refused (use `waveform_groups`).
        """
        packet = np.asarray(packet, np.int64)
        out: np.ndarray | None = None
        spacings = set()
        for descriptor, where, samples in self.waveform_groups(packet):
            spacings.add(descriptor.sampling_ps)
            if out is None and len(where) == len(packet):
                return samples
            if out is None or out.shape[1] < samples.shape[1]:
                if self._packets is not None:
                    self._packets.bounded(len(packet) * samples.shape[1])
                grown = np.zeros((len(packet), samples.shape[1]), np.uint16)
                if out is not None:
                    grown[:, : out.shape[1]] = out
                    grown[:, out.shape[1] :] = out[:, -1:]
                out = grown
            out[where, : samples.shape[1]] = samples
            out[where, samples.shape[1] :] = samples[:, -1:]
        if len(spacings) > 1:
            raise CampaignError(
                "packets have different sampling", where=str(self.path), got=sorted(spacings), expected="one"
            )
        return np.zeros((0, 0), np.uint16) if out is None else out

    def waveform_groups(self, packet: np.ndarray) -> Iterator[tuple[WaveDescriptor, np.ndarray, np.ndarray]]:
        """For each length and descriptor among the packets: (descriptor, places in `packet`, samples (q, s) uint16)."""
        packet = np.asarray(packet, np.int64)
        packets = self._packets
        if packets is None or not packets.descriptors:
            if len(packet):
                raise CampaignError("has no waveform packets", where=str(self.path))
            return
        yield from packets.read(packet)
