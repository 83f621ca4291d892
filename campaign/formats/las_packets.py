"""Blocks of raw LAS records, and waveform packets: which packet a record means, and its samples.

A packet's number is its place in the file. Files with one packet length and no gaps (ours) are counted; others get a table of
every packet that a record names, in the order of its byte.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import lazrs  # type: ignore[import-untyped]
import numpy as np

from campaign.errors import CampaignError
from campaign.formats.las_layout import EVLR_HEADER_BYTES, LasHeader, WaveDescriptor

_SCAN_POINTS = 1_000_000
# LASzip items of the layered compressor: type -> layers; one of extra bytes (14) has a layer for each byte.
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_BYTE14 = 14


def records(header: LasHeader, points: int, *, only_first: bool = False) -> Iterator[tuple[int, np.ndarray]]:
    """(number of the first record, raw records) in blocks of at most `points`."""
    end = min(1, header.point_count) if only_first else header.point_count
    try:
        with header.path.open("rb") as file:
            unzip = _decompressor(header, file) if header.compressed and end else None
            if unzip is None:
                file.seek(header.point_offset)
            for first in range(0, end, points):
                count = min(points, end - first)
                if unzip is None:
                    block = np.fromfile(file, header.record, count)
                    if len(block) < count:
                        raise CampaignError("is truncated", where=str(header.path), got=f"{first + len(block)} records")
                else:
                    raw = np.zeros(count * header.record.itemsize, np.uint8)
                    unzip.decompress_many(raw)
                    block = raw.view(header.record)
                yield first, block
    except OSError as error:
        raise CampaignError("cannot be read", where=str(header.path), got=error.strerror or error) from None
    except CampaignError:
        raise
    except BaseException as error:
        # lazrs raises its own LazrsError, and a panic of the Rust library is no Exception
        if type(error).__module__.startswith(("lazrs", "pyo3")) or type(error).__name__ == "PanicException":
            raise CampaignError("compressed points cannot be read", where=str(header.path), got=error) from None
        raise


def _decompressor(header: LasHeader, file: BinaryIO) -> Any:
    """lazrs at the first point, once every chunk is known to lie in the file.

    A chunk of the layered formats (PDRF 6-10) states the lengths of its layers, and lazrs takes memory for them unseen.
    """
    laszip, length = header.laszip or b"", header.record.itemsize
    size = header.path.stat().st_size
    layers = 0
    for i in range(struct.unpack_from("<H", laszip, 32)[0]):
        kind, item_bytes = struct.unpack_from("<HH", laszip, 34 + 6 * i)
        layers += item_bytes if kind == _BYTE14 else _LAYERS.get(kind, 0)
    file.seek(header.point_offset)
    at = header.point_offset + 8
    for _, chunk_bytes in lazrs.read_chunk_table(file, lazrs.LazVlr(laszip)):
        needed = length
        if layers and at + length + 4 + 4 * layers <= size:
            file.seek(at + length)
            needed += 4 + 4 * layers + sum(struct.unpack(f"<I{layers}I", file.read(4 + 4 * layers))[1:])
        if needed > chunk_bytes or at + chunk_bytes > size:
            raise CampaignError(
                "compressed points cannot be read", where=str(header.path), got=f"a damaged chunk at byte {at}"
            )
        at += chunk_bytes
    file.seek(header.point_offset)
    return lazrs.LasZipDecompressor(file, laszip)


@dataclass(frozen=True, kw_only=True)
class PacketTable:
    """Packets of one file. `offset` None: packet k stands at `first + k * size` of the one descriptor."""

    las: Path
    source: Path
    base: int  # byte of `source` from which offsets count
    descriptors: tuple[WaveDescriptor, ...]
    first: int
    end: int  # the byte, counted from `base`, behind the last packet that a record names
    offset: np.ndarray | None  # (p,) increasing
    index: np.ndarray | None  # (p,) place in `descriptors` of each

    def numbers(self, block: np.ndarray) -> np.ndarray:
        """(n,) raw records -> (n,) packet numbers, -1 for none."""
        known = np.zeros(256, bool)
        known[[d.index for d in self.descriptors]] = True
        has = known[block["descriptor"]]
        offset = block["wave_offset"].astype(np.int64)
        if self.offset is None:
            size = self.descriptors[0].packet_bytes if self.descriptors else 1
            number = (offset - self.first) // size
        else:
            number = np.searchsorted(self.offset, offset)
        return np.where(has, number, -1)

    def read(self, packet: np.ndarray) -> Iterator[tuple[WaveDescriptor, np.ndarray, np.ndarray]]:
        """(descriptor, places in `packet`, samples) for each descriptor among the packets."""
        if len(packet) == 0:
            return
        known = None if self.offset is None else len(self.offset)
        if packet.min() < 0 or (known is not None and packet.max() >= known):
            raise CampaignError("no such waveform packet", where=str(self.las), got=f"{packet.min()} to {packet.max()}")
        data = self._data()
        for place, descriptor in enumerate(self.descriptors):
            size = descriptor.packet_bytes
            if self.offset is None or self.index is None:
                where, start = np.arange(len(packet)), self.base + self.first + packet * size
            else:
                where = np.flatnonzero(self.index[packet] == place)
                start = self.base + self.offset[packet[where]]
            if len(where) == 0:
                continue
            if int(start.max()) + size > len(data):
                raise self._short(int(start.max()) + size)
            yield descriptor, where, _gather(data, start, descriptor)

    def check(self) -> None:
        """Raises CampaignError when the packets that records name do not lie in the file."""
        if self.end > 0 and len(self._data()) < self.base + self.end:
            raise self._short(self.base + self.end)

    def _short(self, expected: int) -> CampaignError:
        return CampaignError(
            "is shorter than its packets say",
            where=str(self.source),
            got=f"{len(self._data())} bytes",
            expected=f"at least {expected}",
        )

    def _data(self) -> np.ndarray:
        try:
            if self.source.stat().st_size == 0:
                return np.zeros(0, np.uint8)
            return np.memmap(self.source, np.uint8, "r")
        except FileNotFoundError:
            raise CampaignError(
                "no such file", where=str(self.source), expected=f"the packets of {self.las.name}"
            ) from None
        except OSError as error:
            raise CampaignError("cannot be read", where=str(self.source), got=error.strerror) from None


def _gather(data: np.ndarray, start: np.ndarray, descriptor: WaveDescriptor) -> np.ndarray:
    size = descriptor.packet_bytes
    first = int(start.min())
    if not np.any((start - first) % size):  # whole packets apart: rows of one array
        rows = (len(data) - first) // size
        raw = data[first : first + rows * size].reshape(rows, size)[(start - first) // size]
    else:
        raw = data[start[:, None] + np.arange(size)]
    if descriptor.bits_per_sample == 8:
        return np.asarray(raw, np.uint16)
    return np.asarray(np.ascontiguousarray(raw).view("<u2"), np.uint16)


def packet_table(header: LasHeader) -> PacketTable:
    """Read every record once and see how its packets are numbered."""
    known = np.zeros(256, bool)
    known[list(header.descriptors)] = True
    described = np.ones(256, np.int64)
    for d in header.descriptors.values():
        described[d.index] = d.packet_bytes
    groups: dict[int, WaveDescriptor] = {}  # (descriptor << 32 | bytes) -> the descriptor with the packets' own length
    phases: set[int] = set()
    found: list[np.ndarray] = []
    end = 0
    step = max(1, min(_SCAN_POINTS, 128_000_000 // header.record.itemsize))
    for _, block in records(header, step):
        block = block[known[block["descriptor"]]]
        if len(block) == 0:
            continue
        index, at, size = (block[n].astype(np.int64) for n in ("descriptor", "wave_offset", "wave_size"))
        if int(at.min()) < 0 or int(at.max()) >= 2**46:
            raise CampaignError("a packet's offset is not plausible", where=str(header.path), got=int(at.max()))
        # a record that states no length, or a longer one, has a packet of the descriptor's
        size = np.where((size == 0) | (size > described[index]), described[index], size)
        kind = index << 32 | size
        for value in np.unique(kind).tolist():
            groups.setdefault(value, _shortened(header.descriptors[value >> 32], value & 0xFFFFFFFF))
        if len(groups) > 65_536:
            raise CampaignError("packets of too many lengths", where=str(header.path), expected="at most 65536")
        order = np.array(list(groups), np.int64)
        by_value = np.argsort(order)
        group = by_value[np.searchsorted(order, kind, sorter=by_value)]
        phases.update(np.unique(at % size).tolist()[:2])
        end = max(end, int((at + size).max()))
        found.append(np.unique(at << 16 | group))
    source, base = _source(header)
    descriptors = tuple(groups.values())
    table = PacketTable(
        las=header.path, source=source, base=base, descriptors=descriptors, first=0, end=end, offset=None, index=None
    )
    if len(descriptors) == 0:
        return table
    if len(descriptors) == 1 and len(phases) == 1:
        size_one, rest = descriptors[0].packet_bytes, phases.pop()
        first = rest + size_one * -(-(EVLR_HEADER_BYTES - rest) // size_one)  # the first such byte past the header's 60
        if all(int(f[0] >> 16) >= first for f in found):
            return replace(table, first=first)
    pairs = np.unique(np.concatenate(found))
    offset, group = pairs >> 16, (pairs & 65_535).astype(np.uint16)
    if np.any(np.diff(offset) == 0):
        raise CampaignError("one packet has two lengths", where=str(header.path))
    return replace(table, offset=offset, index=group)


def _shortened(descriptor: WaveDescriptor, size: int) -> WaveDescriptor:
    return replace(descriptor, samples=max(1, size * 8 // descriptor.bits_per_sample))


def _source(header: LasHeader) -> tuple[Path, int]:
    """The file that holds the packets: inside the LAS file, or beside it with the suffix .wdp in any case."""
    if header.internal_waveforms_at:
        return header.path, header.internal_waveforms_at
    beside = header.path.with_suffix(".wdp")
    if not beside.exists() and header.path.with_suffix(".WDP").exists():
        beside = header.path.with_suffix(".WDP")
    return beside, 0
