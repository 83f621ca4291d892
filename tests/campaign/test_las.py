"""LAS strips: bit-exact round trips, other people's readers and files, hostile files."""

import dataclasses
import errno
import io
import itertools
import resource
import struct
from pathlib import Path
from types import ModuleType

import laspy
import numpy as np
import pyproj
import pytest

from campaign.errors import CampaignError
from campaign.las import Returns, StripReader, StripWriter, first_packet_byte

REAL = Path(__file__).resolve().parents[2].parent / "shared" / "real" / "waveform_leica" / "fwf_plain.las"
WEEK_START = 2400 * 604_800 - 1e9


def read_all(path: Path, size: int = 1_000_000, **options: object) -> Returns:
    parts = [r for _, r in StripReader(path, **options).chunks(size)]  # type: ignore[arg-type]
    return Returns(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(Returns)})


def strip(tmp_path: Path) -> tuple[Path, Path]:
    return tmp_path / "strip_01.las", tmp_path / "strip_01_points.laz"


# ---------------------------------------------------------------- our own files


@pytest.mark.parametrize("samples", [16, 64, 100])
def test_round_trip(tmp_path: Path, samples: int, hand: ModuleType) -> None:
    """Rationale: what the simulator writes is what the evaluator sees.

    Expected: every field equal in value and type, packets included, for packets below and above 60 bytes. Tolerance: XYZ 1e-9 m,
    since steps of 0.1 mm are multiplied back; scan angle half a unit in the last place of float32.
    """
    las, points = strip(tmp_path)
    returns, waves = hand.write_strip(las, points, samples=samples)
    again = read_all(las, 77)
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
    las, points = strip(tmp_path / "one")
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
    las, points = strip(tmp_path)
    returns, waves = hand.write_strip(*strip(tmp_path / "alone"))
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
    las, points = strip(tmp_path)
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
    las, points = strip(tmp_path)
    with StripWriter(las, points, hand.make_spec()):
        pass
    reader = StripReader(las)
    assert (reader.point_count, reader.time_range(), list(reader.chunks())) == (0, None, [])
    assert StripReader(points).point_count == 0
    assert len(laspy.read(las).points) == 0


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_nothing_is_left_after_a_failure(tmp_path: Path, error: type[BaseException], hand: ModuleType) -> None:
    las, points = strip(tmp_path)
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
    las, points = strip(tmp_path)
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
    las, points = strip(tmp_path)
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


# ---------------------------------------------------------------- other instruments' files


def foreign(
    path: Path, point_format: int, count: int = 50, *, version: str | None = None, compress: bool = False
) -> laspy.LasData:
    """A plain file as laspy writes it: week seconds, no WKT, no extra bytes."""
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = [0.001] * 3, [1000.0, 2000.0, 0.0]
    data = laspy.LasData(header)
    rng = np.random.default_rng(point_format)
    data.x, data.y, data.z = 1000.0 + rng.random(count), 2000.0 + rng.random(count), rng.random(count)
    data.intensity = rng.integers(1, 5000, count)
    data.return_number = rng.integers(1, 3, count)
    data.number_of_returns = np.full(count, 2)
    data.point_source_id = np.full(count, 7)
    if point_format not in (0, 2):
        data.gps_time = 300_000.0 + np.arange(count)
    if point_format >= 6:
        data.scan_angle = rng.integers(-3000, 3000, count)
    else:
        data.scan_angle_rank = rng.integers(-30, 30, count)
    data.write(path, do_compress=compress)
    return data


@pytest.mark.parametrize(
    ("point_format", "version"), [(f, None) for f in range(11)] + [(0, "1.2"), (3, "1.2"), (1, "1.4")]
)
@pytest.mark.parametrize("compress", [False, True])
def test_every_point_format(tmp_path: Path, point_format: int, version: str | None, compress: bool) -> None:
    """Expected: the fields that a format has, equal to what laspy was given; the others NaN, 0 or -1."""
    if compress and point_format in (4, 5, 9, 10):
        pytest.skip("LASzip has no waveform formats in this backend")
    path = tmp_path / ("f.laz" if compress else "f.las")
    data = foreign(path, point_format, version=version, compress=compress)
    got = read_all(path, 20, gps_week=2400)
    np.testing.assert_allclose(got.xyz_m, data.xyz, atol=1e-9)
    assert np.array_equal(got.return_number, np.asarray(data.return_number))
    assert np.array_equal(got.number_of_returns, np.asarray(data.number_of_returns))
    assert np.array_equal(got.amplitude, np.asarray(data.intensity, np.float32))
    assert np.all(got.strip == 7)
    assert np.all(got.packet == -1)
    assert np.isnan(got.pulse_width_ns).all()
    assert np.isnan(got.encoder_angle_deg).all()
    if point_format in (0, 2):
        assert np.isnan(got.gps_time_s).all()
    else:
        np.testing.assert_allclose(got.gps_time_s, WEEK_START + 300_000.0 + np.arange(50), rtol=0.0, atol=1e-6)
    angle = np.asarray(data.scan_angle) * 0.006 if point_format >= 6 else np.asarray(data.scan_angle_rank)
    np.testing.assert_allclose(got.scan_angle_deg, angle, atol=1e-5)


def test_standard_time_with_the_wrong_bit_is_kept(tmp_path: Path) -> None:
    """Rationale: some files hold adjusted standard time and leave the bit unset; seconds of a week never pass 604 800."""
    data = foreign(tmp_path / "f.las", 6)
    data.gps_time = 4.65e8 + np.arange(50)
    data.write(tmp_path / "f.las")
    assert not StripReader(tmp_path / "f.las").week_seconds
    assert read_all(tmp_path / "f.las", gps_week=2400).gps_time_s[0] == 4.65e8


def test_amplitude_in_db_beside_a_zero_intensity(tmp_path: Path) -> None:
    """RIEGL style: intensity 0, "Amplitude" int16 in 0.01 dB, "Pulse width" uint16 in 0.1 ns. Expected: 10^(dB/10), and ns."""
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams("Amplitude", "i2", scales=np.array([0.01]), offsets=np.array([0.0])),
            laspy.ExtraBytesParams("Pulse width", "u2", scales=np.array([0.1]), offsets=np.array([0.0])),
            laspy.ExtraBytesParams("three", "3f4"),
            laspy.ExtraBytesParams("Reflectance", "f4"),
        ]
    )
    data = laspy.LasData(header)
    data.x = data.y = data.z = np.zeros(3)
    data["Amplitude"] = [10.0, 20.0, 30.0]
    data["Pulse width"] = [4.0, 4.1, 9.9]
    data["Reflectance"] = [-3.0, -2.0, -1.0]
    data.write(tmp_path / "r.las")
    got = read_all(tmp_path / "r.las", amplitude_unit="db")
    np.testing.assert_allclose(got.amplitude, [10.0, 100.0, 1000.0], rtol=1e-6)
    np.testing.assert_allclose(got.pulse_width_ns, [4.0, 4.1, 9.9], rtol=1e-6)
    assert np.array_equal(got.reflectance_db, np.float32([-3.0, -2.0, -1.0]))
    assert not got.intensity.any()


def wave_file(
    path: Path,
    packets: list[tuple[int, bytes]],
    descriptors: dict[int, tuple[int, int, int]],
    *,
    internal: bool,
    start: int = 60,
) -> list[int]:
    """PDRF 4 with the given (descriptor, bytes) packets from byte `start`; an empty descriptor 2 unless given. Gives offsets."""
    header = laspy.LasHeader(version="1.4", point_format=4)
    for number, (bits, samples, spacing) in ({2: (0, 0, 0)} | descriptors).items():
        header.vlrs.append(
            laspy.VLR("LASF_Spec", 99 + number, "", struct.pack("<BBIIdd", bits, 0, samples, spacing, 1.0, 0.0))
        )
    data = laspy.LasData(header)
    data.x = data.y = data.z = np.zeros(len(packets))
    data["wavepacket_index"] = [d for d, _ in packets]
    offsets, at = [], start
    for _, raw in packets:
        offsets.append(at)
        at += len(raw)
    data["wavepacket_offset"] = [o if d else 0 for o, (d, _) in zip(offsets, packets)]
    data["wavepacket_size"] = [len(raw) for _, raw in packets]
    data.write(path)
    block = (
        struct.pack("<H16sHQ32s", 0, b"LASF_Spec", 65535, at - 60, b"")
        + bytes(start - 60)
        + b"".join(r for _, r in packets)
    )
    raw = bytearray(path.read_bytes())
    if internal:
        struct.pack_into("<H", raw, 6, 2)
        struct.pack_into("<Q", raw, 227, len(raw))
        struct.pack_into("<QI", raw, 235, len(raw), 1)
        path.write_bytes(bytes(raw) + block)
    else:
        struct.pack_into("<H", raw, 6, 4)
        path.write_bytes(raw)
        path.with_suffix(".WDP").write_bytes(block)
    return offsets


@pytest.mark.parametrize("internal", [False, True])
def test_packets_of_unequal_length(tmp_path: Path, internal: bool) -> None:
    """Two descriptors (8 bit x 10, 16 bit x 6), a packet cut short, a row without one, an empty descriptor.

    Expected: groups hold the very samples; `waveforms` continues the shorter ones with their last sample.
    """
    eight, sixteen = bytes(range(10)), struct.pack("<6H", *range(1000, 1006))
    packets = [(1, eight), (3, sixteen), (0, b""), (1, eight[:4]), (3, sixteen)]
    wave_file(tmp_path / "w.las", packets, {1: (8, 10, 1000), 3: (16, 6, 1000)}, internal=internal)
    reader = StripReader(tmp_path / "w.las")
    got = read_all(tmp_path / "w.las")
    named = got.packet[[0, 1, 3, 4]]
    assert got.packet[2] == -1
    assert np.all(np.diff(named) > 0)  # in the order of the file
    waves = reader.waveforms(got.packet[[4, 3, 0]])
    assert waves.tolist() == [
        [1000, 1001, 1002, 1003, 1004, 1005, 1005, 1005, 1005, 1005],
        [0, 1, 2, 3, 3, 3, 3, 3, 3, 3],
        list(range(10)),
    ]
    groups = {(d.index, d.samples): (where.tolist(), s.tolist()) for d, where, s in reader.waveform_groups(named)}
    assert groups[(3, 6)] == ([1, 3], [list(range(1000, 1006))] * 2)
    assert groups[(1, 4)] == ([2], [[0, 1, 2, 3]])


def test_offsets_of_internal_packets_count_from_their_record(tmp_path: Path) -> None:
    """A record that names a byte past the file's end, though inside it when counted from the file's beginning."""
    path = tmp_path / "w.las"
    wave_file(path, [(1, bytes(16))] * 3, {1: (8, 16, 1000)}, internal=True)
    StripReader(path).check_packets()
    patched(path, struct.unpack_from("<I", path.read_bytes(), 96)[0] + 29, "<Q", 60 + 16 * 4)
    with pytest.raises(CampaignError, match="is shorter than its packets say"):
        StripReader(path).check_packets()


def test_packets_that_start_at_60_and_different_sampling(tmp_path: Path) -> None:
    raw = [bytes([i] * 16) for i in range(5)]
    wave_file(tmp_path / "w.las", [(1, r) for r in raw], {1: (8, 16, 2000)}, internal=False)
    reader = StripReader(tmp_path / "w.las")
    packet = read_all(tmp_path / "w.las").packet
    assert (packet.tolist(), reader.sampling_ps) == ([0, 1, 2, 3, 4], 2000.0)
    assert reader.waveforms(packet[::-1])[:, 0].tolist() == [4, 3, 2, 1, 0]
    wave_file(
        tmp_path / "v.las", [(1, bytes(16)), (3, bytes(16))], {1: (8, 16, 2000), 3: (8, 16, 1000)}, internal=False
    )
    with pytest.raises(CampaignError, match="packets have different sampling"):
        StripReader(tmp_path / "v.las").waveforms(read_all(tmp_path / "v.las").packet)


def test_real_leica_file() -> None:
    """LAS 1.3, PDRF 4, 256 x 8 bit at 2 ns. Expected: |d| = c/2 (1.499e-4 m/ps, the file rounds to 5 digits), and the greatest
    sample of the first return within one sample of its return location (a median: later returns are smaller)."""
    if not REAL.exists():
        pytest.skip("the real Leica file is not beside the project")
    reader = StripReader(REAL, gps_week=1700)
    got = read_all(REAL, 1000, gps_week=1700)
    assert (reader.point_count, reader.sampling_ps, reader.week_seconds) == (2250, 2000.0, True)
    assert 383_661.0 < got.gps_time_s[0] - (1700 * 604_800 - 1e9) < 383_663.0
    np.testing.assert_allclose(np.linalg.norm(got.wave_direction_m_ps, axis=1), 1.4986e-4, rtol=2e-4)
    single = got.number_of_returns == 1
    waves = reader.waveforms(got.packet[single])
    assert waves.shape == (single.sum(), 256)
    lag = waves.argmax(axis=1) - got.return_location_ps[single] / 2000.0
    assert abs(float(np.median(lag))) < 1.0
    reader.check_packets()


# ---------------------------------------------------------------- hostile files


def patched(path: Path, at: int, form: str, *values: float) -> None:
    raw = bytearray(path.read_bytes())
    struct.pack_into(form, raw, at, *values)
    path.write_bytes(raw)


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
    las, points = strip(tmp_path)
    hand.write_strip(las, points)
    patched(las, at, form, value)
    with pytest.raises(CampaignError, match=message) as caught:
        StripReader(las)
    assert "\n" not in str(caught.value)


def test_truncated_anywhere(tmp_path: Path, hand: ModuleType) -> None:
    """Expected: a LAS and a LAZ file cut at any place make one line, in the constructor or while reading; never a crash."""
    las, points = strip(tmp_path)
    hand.write_strip(las, points)
    for path in (las, points):
        whole = path.read_bytes()
        for size in [0, 3, 100, 226, 300, 400, 700, 1500, 2500, len(whole) // 2, len(whole) - 1]:
            path.write_bytes(whole[: min(size, len(whole) - 1)])
            with pytest.raises(CampaignError):
                read_all(path)


def test_damaged_laz_makes_one_line_or_other_values(tmp_path: Path, hand: ModuleType) -> None:
    """Rationale: bytes of compressed points can be anything. Expected: no crash, and no memory for lengths that the file
    cannot hold: under 200 MB more than before, where an unchecked layer length of 4 GB takes 2.6 GB."""
    las, points = strip(tmp_path)
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
            read_all(points)
        except CampaignError as error:
            failures += 1
            assert "\n" not in str(error)
    assert failures >= 10
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000


def test_hostile_laz_counts(tmp_path: Path, hand: ModuleType) -> None:
    las, points = strip(tmp_path)
    hand.write_strip(las, points)
    whole = points.read_bytes()
    patched(points, 247, "<Q", 2**40)
    with pytest.raises(CampaignError, match="is truncated or damaged"):
        StripReader(points)
    points.write_bytes(whole)
    table = struct.unpack_from("<q", whole, struct.unpack_from("<I", whole, 96)[0])[0]
    patched(points, table + 4, "<I", 2**32 - 1)
    with pytest.raises(CampaignError, match="is truncated or damaged"):
        StripReader(points)


def test_missing_and_short_packets(tmp_path: Path, hand: ModuleType) -> None:
    las, points = strip(tmp_path)
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
    assert len(read_all(las).xyz_m) == 200
    with pytest.raises(CampaignError, match="no such waveform packet"):
        StripReader(las).waveforms(np.array([-1]))
    with pytest.raises(CampaignError, match="has no waveform packets"):
        StripReader(points).waveforms(np.array([0]))


def test_hostile_packet_fields(tmp_path: Path, hand: ModuleType) -> None:
    """An offset of 2^63 and a packet of 4 GB: neither memory nor a wrong sample."""
    las, points = strip(tmp_path)
    hand.write_strip(las, points)
    first = struct.unpack_from("<I", las.read_bytes(), 96)[0]
    patched(las, first + 31, "<Q", 2**63)
    with pytest.raises(CampaignError, match="offset is not plausible"):
        read_all(las)
    patched(las, first + 31, "<QI", 2**40, 2**32 - 1)
    reader = StripReader(las)
    packet = next(iter(reader.chunks()))[1].packet[:1]
    with pytest.raises(CampaignError, match="is shorter than its packets say"):
        reader.waveforms(packet)


def test_packets_that_overlap_take_no_more_than_their_limit(tmp_path: Path) -> None:
    """Rationale: packets of 131 KB that begin a byte apart fill 400 MB from a file of 140 KB. Expected: one line that says how
    many samples, for groups and for rows padded to one length; the file's own packets one at a time are read."""
    packets = [(1, bytes(2 * 65_536)), *[(1, b"")] * 3000]
    wave_file(tmp_path / "w.las", packets, {1: (16, 65_536, 1000)}, internal=False)
    first, length = (
        struct.unpack_from(k, (tmp_path / "w.las").read_bytes(), at)[0] for k, at in (("<I", 96), ("<H", 105))
    )
    raw = bytearray((tmp_path / "w.las").read_bytes())
    named = struct.unpack_from("<BQI", raw, first + length - 29)
    for i in range(3001):
        struct.pack_into("<BQI", raw, first + i * length + length - 29, 1, named[1] + i, named[2] - 6000)
    (tmp_path / "w.las").write_bytes(bytes(raw))
    reader = StripReader(tmp_path / "w.las")
    packet = read_all(tmp_path / "w.las").packet
    assert len(np.unique(packet)) == 3001
    with pytest.raises(CampaignError, match="too many waveform samples"):
        reader.waveforms(packet)
    assert reader.waveforms(packet[-1:]).shape == (1, 65_536 - 3000)


def test_unsupported_descriptor_and_no_file(tmp_path: Path) -> None:
    wave_file(tmp_path / "w.las", [(1, bytes(12))], {1: (12, 8, 1000)}, internal=False)
    with pytest.raises(CampaignError, match="waveform descriptor is not supported"):
        StripReader(tmp_path / "w.las")
    with pytest.raises(CampaignError, match="no such file"):
        StripReader(tmp_path / "x.las")
    (tmp_path / "d.las").mkdir()
    with pytest.raises(CampaignError, match="cannot be read"):
        StripReader(tmp_path / "d.las")
