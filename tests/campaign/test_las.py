"""LAS strips as the range writes them: bit-exact round trips, other people's readers, failures while writing."""

import dataclasses
import errno
import io
import itertools
import struct
from pathlib import Path
from types import ModuleType

import laspy
import numpy as np
import pyproj
import pytest

from campaign.errors import CampaignError
from campaign.flight.las import Returns, StripReader, StripWriter, first_packet_byte


@pytest.mark.parametrize("samples", [16, 64, 100])
def test_round_trip(tmp_path: Path, samples: int, hand: ModuleType) -> None:
    """Rationale: what the simulator writes is what the evaluator sees.

    Expected: every field equal in value and type, packets included, for packets below and above 60 bytes. Tolerance: XYZ 1e-9 m,
    since steps of 0.1 mm are multiplied back; scan angle half a unit in the last place of float32.
    """
    las, points = hand.strip_paths(tmp_path)
    returns, waves = hand.write_strip(las, points, samples=samples)
    again = hand.read_strip(las, 77)
    for field in dataclasses.fields(Returns):
        wrote, read = getattr(returns, field.name), getattr(again, field.name)
        assert read.dtype == wrote.dtype, field.name
        if field.name in ("xyz_m", "scan_angle_deg"):
            np.testing.assert_allclose(read, wrote, rtol=1e-7 if field.name != "xyz_m" else 0.0, atol=1e-9)
        else:
            assert np.array_equal(read, wrote), field.name
    has = again.packet >= 0
    assert np.array_equal(StripReader(las).waveforms(again.packet[has]), waves[returns.packet[has]])
    first = 64 if samples == 16 else 2 * samples
    assert (tmp_path / "strip_01.wdp").read_bytes()[first:] == waves.tobytes()


def test_same_bytes_for_any_chunks_and_days(tmp_path: Path, hand: ModuleType) -> None:
    """Rationale: same seed, same bytes. Expected: one call and three calls give identical files."""
    las, points = hand.strip_paths(tmp_path / "one")
    returns, waves = hand.write_strip(las, points)
    cut = [0, 40, 41, len(waves)]
    with StripWriter(tmp_path / "two" / las.name, tmp_path / "two" / points.name, hand.make_spec()) as writer:
        for low, high in itertools.pairwise(cut):
            here = (returns.packet >= low) & (returns.packet < high) | ((returns.packet < 0) & (high == len(waves)))
            part = Returns(**{f.name: getattr(returns, f.name)[here] for f in dataclasses.fields(Returns)})
            shifted = dataclasses.replace(part, packet=np.where(part.packet >= 0, part.packet - low, -1))
            writer.write(shifted, waves[low:high])
    for name in (las.name, "strip_01.wdp", points.name):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_two_writers_of_one_strip(tmp_path: Path, hand: ModuleType) -> None:
    """Rationale: a worker whose command was killed may still write a strip when the next command does; one must not rename what
    the other has half written. Expected: after either of them the three files are those of one writer alone. Tolerance: none."""
    las, points = hand.strip_paths(tmp_path)
    returns, waves = hand.write_strip(*hand.strip_paths(tmp_path / "alone"))
    alone = {p.name: p.read_bytes() for p in (tmp_path / "alone").iterdir()}

    def there() -> dict[str, bytes]:
        return {p.name: p.read_bytes() for p in tmp_path.iterdir() if p.is_file() and not p.name.startswith(".")}

    with StripWriter(las, points, hand.make_spec()) as orphan:
        orphan.write(returns, waves)
        with StripWriter(las, points, hand.make_spec()) as writer:
            assert there() == {}
            writer.write(returns, waves)
        assert there() == alone
    assert there() == alone
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*alone, "alone"])


def test_laspy_reads_points_packets_and_crs(tmp_path: Path, hand: ModuleType) -> None:
    """Rationale: other people's reader takes the folder. Expected: laspy's values equal ours; packets found by LAS's own fields."""
    las, points = hand.strip_paths(tmp_path)
    returns, waves = hand.write_strip(las, points)
    data = laspy.read(las)
    header = data.header
    assert (str(header.version), header.point_format.id, header.file_source_id) == ("1.4", 9, 1)
    assert header.creation_date.isoformat() == "2026-06-09"
    assert header.global_encoding.wkt
    assert header.global_encoding.waveform_data_packets_external
    assert header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    crs = pyproj.CRS.from_wkt(next(v for v in header.vlrs if v.record_id == 2112).string)
    assert [c.to_epsg(min_confidence=20) for c in crs.sub_crs_list] == [4549, 5737]
    np.testing.assert_allclose(data.xyz, returns.xyz_m, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(header.mins, returns.xyz_m.min(axis=0), rtol=0.0, atol=1e-9)
    for name, expected in (
        ("gps_time", returns.gps_time_s),
        ("Amplitude", returns.amplitude),
        ("Pulse width", returns.pulse_width_ns),
        ("Reflectance", returns.reflectance_db),
        ("Encoder angle", returns.encoder_angle_deg),
        ("Scanner channel", returns.channel),
        ("scanner_channel", returns.channel & 3),
        ("return_number", returns.return_number),
        ("number_of_returns", returns.number_of_returns),
        ("return_point_wave_location", returns.return_location_ps),
        ("z_t", returns.wave_direction_m_ps[:, 2]),
    ):
        assert np.array_equal(np.asarray(data[name]), expected), name
    np.testing.assert_allclose(np.asarray(data["scan_angle"]) * 0.006, returns.scan_angle_deg, atol=1e-5)
    raw = (tmp_path / "strip_01.wdp").read_bytes()
    assert struct.unpack_from("<H16sHQ", raw) == (0, b"LASF_Spec".ljust(16, b"\0"), 65535, len(raw) - 60)
    index, at, size = (np.asarray(data[n]) for n in ("wavepacket_index", "wavepacket_offset", "wavepacket_size"))
    for i in (0, 57, 198):
        assert (index[i], size[i]) == (1, 128)
        assert np.array_equal(np.frombuffer(raw, "<u2", 64, int(at[i])), waves[returns.packet[i]])
    assert (index[-1], at[-1], size[-1]) == (0, 0, 0)
    descriptor = next(v for v in header.vlrs if v.record_id == 100)
    parsed = descriptor.parsed_record
    assert (parsed.bits_per_sample, parsed.number_of_samples, parsed.temporal_sample_spacing) == (16, 64, 1000)
    twin = laspy.read(points)
    assert twin.header.point_format.id == 6
    assert np.array_equal(twin.xyz, data.xyz)
    assert np.array_equal(np.asarray(twin["Amplitude"]), returns.amplitude)


def test_an_empty_strip(tmp_path: Path, hand: ModuleType) -> None:
    las, points = hand.strip_paths(tmp_path)
    with StripWriter(las, points, hand.make_spec()):
        pass
    reader = StripReader(las)
    assert (reader.point_count, reader.time_range(), list(reader.chunks())) == (0, None, [])
    assert StripReader(points).point_count == 0
    assert len(laspy.read(las).points) == 0


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_nothing_is_left_after_a_failure(tmp_path: Path, error: type[BaseException], hand: ModuleType) -> None:
    las, points = hand.strip_paths(tmp_path)
    with pytest.raises(error), StripWriter(las, points, hand.make_spec()) as writer:
        writer.write(hand.make_returns(10, 5), np.zeros((5, 64), np.uint16))
        raise error
    with (
        pytest.raises(CampaignError, match="a point lies too far"),
        StripWriter(las, points, hand.make_spec()) as writer,
    ):
        far = dataclasses.replace(hand.make_returns(10, 5), xyz_m=np.zeros((10, 3)))
        writer.write(far, np.zeros((5, 64), np.uint16))
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_while_streaming(tmp_path: Path, hand: ModuleType) -> None:
    """Rationale: /dev/full answers every flush with ENOSPC. Expected: one line, nothing left."""
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full on this system")
    las, points = hand.strip_paths(tmp_path)
    with pytest.raises(CampaignError, match="no space left"), StripWriter(las, points, hand.make_spec()) as writer:
        writer._files[1].close()
        writer._files[1] = open("/dev/full", "wb")  # noqa: SIM115
        writer.write(hand.make_returns(100, 500), np.zeros((5000, 64), np.uint16))
    assert list(tmp_path.iterdir()) == []


class FullDisk(io.BytesIO):
    """A file on a disk that is full after 20 000 bytes."""

    def write(self, data: object) -> int:
        if self.tell() > 20_000:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)  # type: ignore[arg-type]


def test_a_full_disk_under_the_compressed_points(tmp_path: Path, hand: ModuleType) -> None:
    """Rationale: lazrs turns the system's error into its own. Expected: one line that still asks for space, nothing left."""
    las, points = hand.strip_paths(tmp_path)
    with (
        pytest.raises(CampaignError, match="space left on the disk"),
        StripWriter(las, points, hand.make_spec()) as writer,
    ):
        writer._laz = laspy.LasWriter(
            FullDisk(), writer._laz.header, do_compress=True, laz_backend=laspy.LazBackend.LazrsParallel, closefd=False
        )
        for _ in range(30):
            writer.write(hand.make_returns(5000, 1), np.zeros((1, 64), np.uint16))
    assert list(tmp_path.iterdir()) == []


def test_first_packet_leaves_room_for_the_header() -> None:
    assert [first_packet_byte(s) for s in (32, 59, 60, 128, 256)] == [64, 118, 60, 128, 256]
