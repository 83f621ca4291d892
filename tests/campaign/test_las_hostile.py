"""Hostile LAS, LAZ and wdp files: one line, and no more memory than their limits."""

import resource
import struct
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from campaign.errors import CampaignError
from campaign.flight.las import StripReader


@pytest.mark.parametrize(
    ("at", "form", "value", "message"),
    [
        (0, "4s", b"LASX", "is no LAS file"),
        (25, "<B", 9, "LAS version is not supported"),
        (94, "<H", 100, "is truncated or damaged"),
        (96, "<I", 2**31, "is truncated or damaged"),
        (100, "<I", 2**32 - 1, "variable length records run into the points"),
        (104, "<B", 33, "point format is not supported"),
        (105, "<H", 20, "record length is too small"),
        (105, "<H", 59, "lies outside the record"),
        (131, "<d", float("nan"), "scale or offset is no number"),
        (131, "<d", 0.0, "scale or offset is no number"),
        (247, "<Q", 2**60, "is truncated"),
        (243, "<I", 2**32 - 1, "is truncated"),
    ],
)
def test_a_hostile_header_is_one_line(
    tmp_path: Path, at: int, form: str, value: float, message: str, hand: ModuleType
) -> None:
    """Rationale: sizes are believed only when the file can hold them. Expected: CampaignError before memory is taken."""
    las, points = hand.strip_paths(tmp_path)
    hand.write_strip(las, points)
    hand.patched(las, at, form, value)
    with pytest.raises(CampaignError, match=message) as caught:
        StripReader(las)
    assert "\n" not in str(caught.value)


def test_truncated_anywhere(tmp_path: Path, hand: ModuleType) -> None:
    """Expected: a LAS and a LAZ file cut at any place make one line, in the constructor or while reading; never a crash."""
    las, points = hand.strip_paths(tmp_path)
    hand.write_strip(las, points)
    for path in (las, points):
        whole = path.read_bytes()
        for size in [0, 3, 100, 226, 300, 400, 700, 1500, 2500, len(whole) // 2, len(whole) - 1]:
            path.write_bytes(whole[: min(size, len(whole) - 1)])
            with pytest.raises(CampaignError):
                hand.read_strip(path)


def test_damaged_laz_makes_one_line_or_other_values(tmp_path: Path, hand: ModuleType) -> None:
    """Rationale: bytes of compressed points can be anything. Expected: no crash, and no memory for lengths that the file
    cannot hold: under 200 MB more than before, where an unchecked layer length of 4 GB takes 2.6 GB."""
    las, points = hand.strip_paths(tmp_path)
    hand.write_strip(las, points)
    whole = bytearray(points.read_bytes())
    layers_at = struct.unpack_from("<I", whole, 96)[0] + 8 + 47 + 4
    rng = np.random.default_rng(0)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    failures = 0
    for trial in range(40):
        raw = bytearray(whole)
        for at in rng.integers(375, len(raw), 20):
            raw[at] = rng.integers(0, 256)
        if trial % 4 == 0:
            raw = bytearray(whole)
            struct.pack_into("<I", raw, layers_at + 4 * int(rng.integers(0, 26)), 2**32 - 1)
        points.write_bytes(raw)
        try:
            hand.read_strip(points)
        except CampaignError as error:
            failures += 1
            assert "\n" not in str(error)
    assert failures >= 10
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000


def test_hostile_laz_counts(tmp_path: Path, hand: ModuleType) -> None:
    las, points = hand.strip_paths(tmp_path)
    hand.write_strip(las, points)
    whole = points.read_bytes()
    hand.patched(points, 247, "<Q", 2**40)
    with pytest.raises(CampaignError, match="is truncated or damaged"):
        StripReader(points)
    points.write_bytes(whole)
    table = struct.unpack_from("<q", whole, struct.unpack_from("<I", whole, 96)[0])[0]
    hand.patched(points, table + 4, "<I", 2**32 - 1)
    with pytest.raises(CampaignError, match="is truncated or damaged"):
        StripReader(points)


def test_missing_and_short_packets(tmp_path: Path, hand: ModuleType) -> None:
    las, points = hand.strip_paths(tmp_path)
    returns, _ = hand.write_strip(las, points)
    wdp = tmp_path / "strip_01.wdp"
    raw = wdp.read_bytes()
    wdp.write_bytes(raw[:-1])
    reader = StripReader(las)
    message = rf"strip_01\.wdp: is shorter than its packets say; got {len(raw) - 1} bytes; expected at least"
    with pytest.raises(CampaignError, match=message):
        reader.waveforms(np.array([119]))
    assert reader.waveforms(np.array([118])).shape == (1, 64)
    wdp.write_bytes(raw[:2000])
    with pytest.raises(CampaignError, match="is shorter than its packets say"):
        StripReader(las).check_packets()
    wdp.write_bytes(b"")
    with pytest.raises(CampaignError, match="is shorter"):
        StripReader(las).waveforms(returns.packet[:3])
    wdp.unlink()
    with pytest.raises(CampaignError, match="no such file"):
        StripReader(las).waveforms(returns.packet[:3])
    assert len(hand.read_strip(las).xyz_m) == 200
    with pytest.raises(CampaignError, match="no such waveform packet"):
        StripReader(las).waveforms(np.array([-1]))
    with pytest.raises(CampaignError, match="has no waveform packets"):
        StripReader(points).waveforms(np.array([0]))


def test_hostile_packet_fields(tmp_path: Path, hand: ModuleType) -> None:
    """An offset of 2^63 and a packet of 4 GB: neither memory nor a wrong sample."""
    las, points = hand.strip_paths(tmp_path)
    hand.write_strip(las, points)
    first = struct.unpack_from("<I", las.read_bytes(), 96)[0]
    hand.patched(las, first + 31, "<Q", 2**63)
    with pytest.raises(CampaignError, match="offset is not plausible"):
        hand.read_strip(las)
    hand.patched(las, first + 31, "<QI", 2**40, 2**32 - 1)
    reader = StripReader(las)
    packet = next(iter(reader.chunks()))[1].packet[:1]
    with pytest.raises(CampaignError, match="is shorter than its packets say"):
        reader.waveforms(packet)


def test_packets_that_overlap_take_no_more_than_their_limit(tmp_path: Path, hand: ModuleType) -> None:
    """Rationale: packets of 131 KB that begin a byte apart fill 400 MB from a file of 140 KB. Expected: one line that says how
    many samples, for groups and for rows padded to one length; the file's own packets one at a time are read."""
    packets = [(1, bytes(2 * 65_536)), *[(1, b"")] * 3000]
    hand.wave_file(tmp_path / "w.las", packets, {1: (16, 65_536, 1000)}, internal=False)
    first, length = (
        struct.unpack_from(k, (tmp_path / "w.las").read_bytes(), at)[0] for k, at in (("<I", 96), ("<H", 105))
    )
    raw = bytearray((tmp_path / "w.las").read_bytes())
    named = struct.unpack_from("<BQI", raw, first + length - 29)
    for i in range(3001):
        struct.pack_into("<BQI", raw, first + i * length + length - 29, 1, named[1] + i, named[2] - 6000)
    (tmp_path / "w.las").write_bytes(bytes(raw))
    reader = StripReader(tmp_path / "w.las")
    packet = hand.read_strip(tmp_path / "w.las").packet
    assert len(np.unique(packet)) == 3001
    with pytest.raises(CampaignError, match="too many waveform samples"):
        reader.waveforms(packet)
    assert reader.waveforms(packet[-1:]).shape == (1, 65_536 - 3000)


def test_unsupported_descriptor_and_no_file(tmp_path: Path, hand: ModuleType) -> None:
    hand.wave_file(tmp_path / "w.las", [(1, bytes(12))], {1: (12, 8, 1000)}, internal=False)
    with pytest.raises(CampaignError, match="waveform descriptor is not supported"):
        StripReader(tmp_path / "w.las")
    with pytest.raises(CampaignError, match="no such file"):
        StripReader(tmp_path / "x.las")
    (tmp_path / "d.las").mkdir()
    with pytest.raises(CampaignError, match="cannot be read"):
        StripReader(tmp_path / "d.las")
