"""How LAS records lie in a file: record tables of PDRF 0-10, and a header whose every count is checked against the file's size.

Nothing is trusted: lengths and offsets are compared with the size of the file before memory is taken for them. Reading and
writing of returns stands in `campaign.flight.las`.
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from campaign.errors import CampaignError

_XYZ_INTENSITY = [("X", "<i4"), ("Y", "<i4"), ("Z", "<i4"), ("intensity", "<u2")]
_LEGACY = [
    *_XYZ_INTENSITY,
    ("flags", "u1"),
    ("classification", "u1"),
    ("scan_angle", "i1"),
    ("user", "u1"),
    ("source", "<u2"),
]
_MODERN = [
    *_XYZ_INTENSITY,
    *[
        ("returns", "u1"),
        ("flags", "u1"),
        ("classification", "u1"),
        ("user", "u1"),
        ("scan_angle", "<i2"),
        ("source", "<u2"),
    ],
    ("gps_time", "<f8"),
]
_TIME = [("gps_time", "<f8")]
_RGB = [("rgb", "<u2", (3,))]
_NIR = [("nir", "<u2")]
_WAVE = [
    ("descriptor", "u1"),
    ("wave_offset", "<u8"),
    ("wave_size", "<u4"),
    ("location", "<f4"),
    ("direction", "<f4", (3,)),
]

# PDRF -> fields of one record (LAS 1.4 R15, tables 7-17).
RECORDS: dict[int, list] = {
    0: _LEGACY,
    1: _LEGACY + _TIME,
    2: _LEGACY + _RGB,
    3: _LEGACY + _TIME + _RGB,
    4: _LEGACY + _TIME + _WAVE,
    5: _LEGACY + _TIME + _RGB + _WAVE,
    6: _MODERN,
    7: _MODERN + _RGB,
    8: _MODERN + _RGB + _NIR,
    9: _MODERN + _WAVE,
    10: _MODERN + _RGB + _NIR + _WAVE,
}
# Extra bytes: data type -> NumPy type (LAS 1.4 R15, table 25); 0 is undocumented bytes, 11-30 are the old 2- and 3-vectors.
EXTRA_TYPES = {1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f4", 10: "<f8"}
EVLR_HEADER_BYTES = 60


@dataclass(frozen=True, kw_only=True)
class ExtraField:
    """One extra byte attribute: value = raw * scale + offset."""

    name: str
    field: str  # its name in `LasHeader.record`
    dtype: np.dtype
    at: int  # byte within the record
    scale: float
    offset: float


@dataclass(frozen=True, kw_only=True)
class WaveDescriptor:
    """A waveform packet descriptor: how samples of a packet lie."""

    index: int  # 1-255, as the records name it
    bits_per_sample: int
    samples: int
    sampling_ps: float
    gain: float  # volts a step
    offset: float  # volts

    @property
    def packet_bytes(self) -> int:
        return self.samples * self.bits_per_sample // 8


@dataclass(frozen=True, kw_only=True)
class LasHeader:
    """What a reader needs of a LAS or LAZ file; checked against its size."""

    path: Path
    version_minor: int
    point_format: int
    compressed: bool
    point_count: int
    point_offset: int
    record: np.dtype  # of one whole record, fields at their byte offsets
    scale: tuple[float, float, float]
    offset: tuple[float, float, float]
    adjusted_time: bool
    extra: dict[str, ExtraField]  # by lower-case name
    descriptors: dict[int, WaveDescriptor]
    laszip: bytes | None
    internal_waveforms_at: int  # byte of the waveform EVLR's header; 0: external
    wkt: bool

    @property
    def has_waveforms(self) -> bool:
        return self.point_format in (4, 5, 9, 10)


def _bad(path: Path, what: str, got: object = None, expected: object = None) -> CampaignError:
    return CampaignError(what, where=str(path), got=got, expected=expected)


def read_header(path: Path) -> LasHeader:
    """Parse and check the header, the VLRs and the EVLRs.

    Raises
    ------
    CampaignError
        Not a LAS file, truncated, or a count that the file cannot hold.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(375)
            if len(head) < 227 or head[:4] != b"LASF":
                raise _bad(path, "is no LAS file", "no LASF signature" if len(head) >= 4 else f"{size} bytes")
            return _parse(path, size, head, file)
    except FileNotFoundError:
        raise _bad(path, "no such file") from None
    except OSError as error:
        raise _bad(path, "cannot be read", error.strerror) from None
    except struct.error:
        raise _bad(path, "is truncated", f"{size} bytes") from None


def _parse(path: Path, size: int, head: bytes, file: BinaryIO) -> LasHeader:
    encoding = struct.unpack_from("<H", head, 6)[0]
    major, minor = head[24], head[25]
    if major != 1 or minor > 4:
        raise _bad(path, "LAS version is not supported", f"{major}.{minor}", "1.0 to 1.4")
    header_size, point_offset, vlr_count, format_byte, length = struct.unpack_from("<HIIBH", head, 94)
    if (
        header_size < (375 if minor >= 4 else 235 if minor == 3 else 227)
        or header_size > point_offset
        or point_offset > size
    ):
        raise _bad(path, "is truncated or damaged", f"points begin at byte {point_offset} of {size}")
    compressed, point_format = format_byte >= 64, format_byte & 0x3F
    if point_format not in RECORDS:
        raise _bad(path, "point format is not supported", point_format, "0 to 10")
    count = struct.unpack_from("<I", head, 107)[0]
    if minor >= 4:
        count = struct.unpack_from("<Q", head, 247)[0] or count
    floats = struct.unpack_from("<6d", head, 131)
    if not np.isfinite(floats).all() or min(floats[:3]) <= 0.0:
        raise _bad(path, "scale or offset is no number", list(floats))
    start_of_waves, evlr_at, evlr_count = 0, 0, 0
    if minor >= 3:
        start_of_waves = struct.unpack_from("<Q", head, 227)[0]
    if minor >= 4:
        evlr_at, evlr_count = struct.unpack_from("<QI", head, 235)

    vlrs = _vlrs(path, file, header_size, point_offset, vlr_count)
    vlrs += _evlrs(path, file, size, evlr_at, evlr_count)
    base = np.dtype(RECORDS[point_format])
    if length < base.itemsize:
        raise _bad(
            path, "record length is too small", length, f"at least {base.itemsize} for point format {point_format}"
        )
    laszip = next((data for user, record, data in vlrs if user == "laszip encoded" and record == 22204), None)
    if compressed:
        _check_laszip(path, file, size, point_offset, count, length, laszip)
    elif point_offset + count * length > size:
        holds = (size - point_offset) // length
        raise _bad(path, "is truncated", f"{holds} whole records", f"{count} by its header")
    internal = encoding & 2 and not encoding & 4 and start_of_waves
    if internal and start_of_waves + EVLR_HEADER_BYTES > size:
        raise _bad(path, "is truncated", f"{size} bytes", f"waveforms from byte {start_of_waves}")
    extra = _extra_fields(path, vlrs, base.itemsize, length)
    return LasHeader(
        path=path,
        version_minor=minor,
        point_format=point_format,
        compressed=compressed,
        point_count=count,
        point_offset=point_offset,
        record=_record(point_format, length, extra),
        scale=floats[:3],
        offset=floats[3:],
        adjusted_time=bool(encoding & 1),
        extra={e.name.lower(): e for e in extra if e.dtype.kind != "V" and e.dtype.shape == ()},
        descriptors=_descriptors(path, vlrs),
        laszip=laszip,
        internal_waveforms_at=start_of_waves if internal else 0,
        wkt=any(user == "LASF_Projection" and record == 2112 for user, record, _ in vlrs),
    )


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("latin-1").strip()


def _vlrs(path: Path, file: BinaryIO, at: int, end: int, count: int) -> list[tuple[str, int, bytes]]:
    out = []
    for _ in range(count):
        if at + 54 > end:
            raise _bad(path, "is damaged: its variable length records run into the points", count)
        file.seek(at)
        _, user, record, length, _ = struct.unpack("<H16sHH32s", file.read(54))
        if at + 54 + length > end:
            raise _bad(path, "is damaged: a variable length record runs into the points", record)
        out.append((_text(user), record, file.read(length)))
        at += 54 + length
    return out


def _evlrs(path: Path, file: BinaryIO, size: int, at: int, count: int) -> list[tuple[str, int, bytes]]:
    """Of the extended records only small ones are loaded; waveforms (record 65535) stay where they are."""
    out: list[tuple[str, int, bytes]] = []
    for _ in range(count):
        if at + EVLR_HEADER_BYTES > size:
            raise _bad(path, "is truncated", f"{size} bytes", f"{count} extended records")
        file.seek(at)
        _, user, record, length, _ = struct.unpack("<H16sHQ32s", file.read(EVLR_HEADER_BYTES))
        if at + EVLR_HEADER_BYTES + length > size:
            raise _bad(path, "is truncated: an extended record passes its end", f"{size} bytes")
        if record != 65535 and length <= 1_000_000 and len(out) < 1000:
            out.append((_text(user), record, file.read(length)))
        at += EVLR_HEADER_BYTES + length
    return out


def _check_laszip(
    path: Path, file: BinaryIO, size: int, points_at: int, count: int, length: int, laszip: bytes | None
) -> None:
    """The chunk table must lie in the file, and its chunks must be able to hold the points."""
    if laszip is None or len(laszip) < 34:
        raise _bad(path, "is compressed without a LASzip record")
    chunk_size = struct.unpack_from("<I", laszip, 12)[0]
    items = struct.unpack_from("<H", laszip, 32)[0]
    if (
        len(laszip) < 34 + 6 * items
        or sum(struct.unpack_from("<H", laszip, 36 + 6 * i)[0] for i in range(items)) != length
    ):
        raise _bad(path, "LASzip record does not fit the record length", length)
    if count == 0:
        return
    file.seek(points_at)
    table_at = struct.unpack("<q", file.read(8))[0]
    if table_at == -1 and size >= points_at + 16:
        file.seek(size - 8)
        table_at = struct.unpack("<q", file.read(8))[0]
    if not points_at + 8 <= table_at <= size - 8:
        raise _bad(path, "is truncated", f"{size} bytes", f"a chunk table at byte {table_at}")
    file.seek(table_at)
    chunks = struct.unpack("<II", file.read(8))[1]
    if chunks * length > size or (chunk_size != 0xFFFFFFFF and count > chunks * chunk_size):
        raise _bad(path, "is truncated or damaged", f"{chunks} chunks", f"{count} points by its header")


def _extra_fields(path: Path, vlrs: list[tuple[str, int, bytes]], at: int, end: int) -> list[ExtraField]:
    data = next((d for user, record, d in vlrs if user == "LASF_Spec" and record == 4), b"")
    out: list[ExtraField] = []
    for start in range(0, len(data) - 191, 192):
        kind, options = data[start + 2], data[start + 3]
        name = _text(data[start + 4 : start + 36])
        if kind > 30:
            raise _bad(path, f"extra byte {name!r} has an unknown type", kind)
        if kind == 0:
            dtype = np.dtype(f"V{options}")
        else:
            scalar, count = EXTRA_TYPES[(kind - 1) % 10 + 1], (kind - 1) // 10 + 1
            dtype = np.dtype(scalar) if count == 1 else np.dtype((scalar, (count,)))
        if at + dtype.itemsize > end:
            raise _bad(path, f"extra byte {name!r} lies outside the record", f"{end} bytes a record")
        scale = struct.unpack_from("<d", data, start + 112)[0] if kind and options & 8 else 1.0
        offset = struct.unpack_from("<d", data, start + 136)[0] if kind and options & 16 else 0.0
        out.append(ExtraField(name=name, field=f"extra{len(out)}", dtype=dtype, at=at, scale=scale, offset=offset))
        at += dtype.itemsize
    return out


def _record(point_format: int, length: int, extra: list[ExtraField]) -> np.dtype:
    base = np.dtype(RECORDS[point_format])
    names: list[str] = list(base.names or ())
    fields = [(n, base.fields[n][0], base.fields[n][1]) for n in names] if base.fields else []
    fields += [(e.field, e.dtype, e.at) for e in extra]
    return np.dtype(
        {
            "names": [f[0] for f in fields],
            "formats": [f[1] for f in fields],
            "offsets": [f[2] for f in fields],
            "itemsize": length,
        }
    )


def _descriptors(path: Path, vlrs: list[tuple[str, int, bytes]]) -> dict[int, WaveDescriptor]:
    """Descriptors that are filled in; an empty one (no samples) only matters when a record names it."""
    out = {}
    for user, record, data in vlrs:
        if user == "LASF_Spec" and 100 <= record <= 354 and len(data) >= 26:
            bits, compression, samples, spacing, gain, offset = struct.unpack_from("<BBIIdd", data)
            if samples == 0 or bits == 0:
                continue
            if compression != 0 or bits not in (8, 16):
                raise _bad(
                    path, "waveform descriptor is not supported", f"{bits} bit, compression {compression}", "8 or 16, 0"
                )
            if samples > 65536:
                raise _bad(path, "waveform descriptor is not plausible", f"{samples} samples", "at most 65536")
            index = record - 99
            out[index] = WaveDescriptor(
                index=index, bits_per_sample=bits, samples=samples, sampling_ps=float(spacing), gain=gain, offset=offset
            )
    return out
