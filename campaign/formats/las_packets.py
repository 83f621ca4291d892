"""Blocks of raw LAS records, and waveform packets: which packet a record means, and its samples.

A packet's number is its place in the file: in files with one packet length and no gaps (ours) it counts them, in others it is the
packet's byte with its kind (descriptor and length). Nothing is kept for each packet, whatever the file's length.
"""

import contextlib
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import lazrs  # type: ignore[import-untyped]
import numpy as np

from campaign.errors import CampaignError
from campaign.formats.las_layout import EVLR_HEADER_BYTES, LasHeader, WaveDescriptor

_SCAN_BYTES = 8_000_000  # of records at once
_KINDS = 16  # bits of a packet's number that say its kind, below those of its byte
_GAP_BYTES = 32_768  # packets that stand nearer together are read as one piece
_PIECE_BYTES = 4_000_000
MAX_READ_BYTES = 256_000_000  # of samples, by one call
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
    """Packets of one file: their kinds, and how they are numbered."""

    las: Path
    source: Path
    base: int  # byte of `source` from which offsets count
    descriptors: tuple[WaveDescriptor, ...]  # one for each kind, with the packets' own length
    stated: dict[int, WaveDescriptor]  # by index, as the header has them
    kinds: np.ndarray  # (kinds,) int64: index << 32 | bytes, of each of `descriptors`
    first: int  # byte, counted from `base`, of packet 0 where packets are counted; else -1
    end: int  # the byte, counted from `base`, behind the last packet that a record names

    def numbers(self, block: np.ndarray) -> np.ndarray:
        """(n,) raw records -> (n,) packet numbers, -1 for none."""
        has = _named(self.stated)[block["descriptor"]]
        if not self.descriptors:
            return np.full(len(block), -1, np.int64)
        offset = block["wave_offset"].astype(np.int64)
        if self.first >= 0:
            return np.where(has, (offset - self.first) // self.descriptors[0].packet_bytes, -1)
        order = np.argsort(self.kinds)
        place = np.searchsorted(self.kinds, _kind(block, self.stated), sorter=order).clip(max=len(order) - 1)
        return np.where(has, offset << _KINDS | order[place], -1)

    def read(self, packet: np.ndarray) -> Iterator[tuple[WaveDescriptor, np.ndarray, np.ndarray]]:
        """(descriptor, places in `packet`, samples) for each kind among the packets."""
        if len(packet) == 0:
            return
        if int(packet.min()) < 0:
            raise self._unknown(packet)
        counted = self.first >= 0
        kind = np.zeros(len(packet), np.int64) if counted else packet & ((1 << _KINDS) - 1)
        if not self.descriptors or int(kind.max()) >= len(self.descriptors):
            raise self._unknown(packet)
        self.bounded(int(np.array([d.samples for d in self.descriptors])[kind].sum()))
        with self._open() as file:
            size = file.seek(0, os.SEEK_END)
            for place, descriptor in enumerate(self.descriptors):
                where = np.flatnonzero(kind == place)
                if len(where) == 0:
                    continue
                length = descriptor.packet_bytes
                if counted and int(packet.max()) > size // length:
                    raise self._short(size, self.base + self.first + (int(packet.max()) + 1) * length)
                start = self.base + (self.first + packet * length if counted else packet[where] >> _KINDS)
                if int(start.max()) + length > size:
                    raise self._short(size, int(start.max()) + length)
                yield descriptor, where, self._gather(file, start, descriptor)

    def bounded(self, samples: int) -> None:
        """Raises CampaignError where so many samples are more than one call may take memory for."""
        if 2 * samples > MAX_READ_BYTES:
            most = MAX_READ_BYTES // 2
            raise CampaignError(
                "too many waveform samples", where=str(self.las), got=samples, expected=f"at most {most}"
            )

    def check(self) -> None:
        """Raises CampaignError when the packets that records name do not lie in the file."""
        if self.end > 0:
            with self._open() as file:
                size = file.seek(0, os.SEEK_END)
            if size < self.base + self.end:
                raise self._short(size, self.base + self.end)

    def _gather(self, file: BinaryIO, start: np.ndarray, descriptor: WaveDescriptor) -> np.ndarray:
        """(q, samples) uint16 of packets at bytes `start`: in the order of the file, neighbours as one piece."""
        length = descriptor.packet_bytes
        order = np.argsort(start, kind="stable")
        at = start[order]
        raw = np.empty((len(at), length), np.uint8)
        breaks = np.flatnonzero(np.diff(at) > length + _GAP_BYTES) + 1
        for low, high in zip([0, *breaks.tolist()], [*breaks.tolist(), len(at)]):
            while low < high:
                stop = max(low + 1, int(np.searchsorted(at[low:high], at[low] + _PIECE_BYTES)) + low)
                file.seek(int(at[low]))
                piece = file.read(int(at[stop - 1] - at[low]) + length)
                if len(piece) < int(at[stop - 1] - at[low]) + length:
                    raise self._short(int(at[low]) + len(piece), int(at[stop - 1]) + length)
                rows = np.lib.stride_tricks.sliding_window_view(np.frombuffer(piece, np.uint8), length)
                raw[order[low:stop]] = rows[at[low:stop] - at[low]]
                low = stop
        if descriptor.bits_per_sample == 8:
            return raw.astype(np.uint16)
        return np.asarray(raw.view("<u2"), np.uint16)

    def _unknown(self, packet: np.ndarray) -> CampaignError:
        return CampaignError("no such waveform packet", where=str(self.las), got=f"{packet.min()} to {packet.max()}")

    def _short(self, size: int, expected: int) -> CampaignError:
        return CampaignError(
            "is shorter than its packets say",
            where=str(self.source),
            got=f"{size} bytes",
            expected=f"at least {expected}",
        )

    @contextlib.contextmanager
    def _open(self) -> Iterator[BinaryIO]:
        try:
            with self.source.open("rb") as file:
                yield file
        except FileNotFoundError:
            raise CampaignError(
                "no such file", where=str(self.source), expected=f"the packets of {self.las.name}"
            ) from None
        except OSError as error:
            raise CampaignError("cannot be read", where=str(self.source), got=error.strerror) from None


def packet_table(header: LasHeader) -> PacketTable:
    """Read every record once and see how its packets are numbered; what is kept does not grow with the file."""
    groups: dict[int, WaveDescriptor] = {}
    phases: set[int] = set()
    named = _named(header.descriptors)
    lowest, end = 2**62, 0
    for _, block in records(header, max(1, _SCAN_BYTES // header.record.itemsize)):
        block = block[named[block["descriptor"]]]
        if len(block) == 0:
            continue
        kind = _kind(block, header.descriptors)
        at, size = block["wave_offset"].astype(np.int64), kind & 0xFFFFFFFF
        if int(at.min()) < 0 or int(at.max()) >= 2**46:
            raise CampaignError("a packet's offset is not plausible", where=str(header.path), got=int(at.max()))
        for value in _distinct(kind):
            groups.setdefault(value, _shortened(header.descriptors[value >> 32], value & 0xFFFFFFFF))
        if len(groups) > 1 << _KINDS:
            raise CampaignError(
                "packets of too many lengths", where=str(header.path), expected=f"at most {1 << _KINDS}"
            )
        if len(phases) < 2:
            phases.update(_distinct(at % size)[:2])
        lowest, end = min(lowest, int(at.min())), max(end, int((at + size).max()))
    source, base = _source(header)
    table = PacketTable(
        las=header.path,
        source=source,
        base=base,
        descriptors=tuple(groups.values()),
        stated=header.descriptors,
        kinds=np.array(list(groups), np.int64),
        first=-1,
        end=end,
    )
    if len(groups) == 1 and len(phases) == 1:
        size_one, rest = table.descriptors[0].packet_bytes, phases.pop()
        first = rest + size_one * -(-(EVLR_HEADER_BYTES - rest) // size_one)  # the first such byte past the header's 60
        if lowest >= first and int(table.kinds[0]) & 0xFFFFFFFF == size_one:  # no odd length of 16-bit samples
            return replace(table, first=first)
    return table


def _named(stated: dict[int, WaveDescriptor]) -> np.ndarray:
    """(256,) bool: a record's descriptor index is one of these."""
    known = np.zeros(256, bool)
    known[list(stated)] = True
    return known


def _distinct(values: np.ndarray) -> list[int]:
    """Sorted; most often there is one."""
    return [int(values[0])] if (values == values[0]).all() else np.unique(values).tolist()


def _kind(block: np.ndarray, stated: dict[int, WaveDescriptor]) -> np.ndarray:
    """(n,) int64 index << 32 | bytes: a record that states no length, or a longer one, has a packet of the descriptor's."""
    described = np.ones(256, np.int64)
    for d in stated.values():
        described[d.index] = d.packet_bytes
    index, size = block["descriptor"].astype(np.int64), block["wave_size"].astype(np.int64)
    size = np.where((size == 0) | (size > described[index]), described[index], size)
    return np.asarray(index << 32 | size)


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
