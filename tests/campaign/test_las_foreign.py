"""LAS strips of other instruments: every point format, attributes under other names, packets inside and of unequal length."""

import struct
from pathlib import Path
from types import ModuleType

import laspy
import numpy as np
import pytest

from campaign.errors import CampaignError
from campaign.flight.las import StripReader

REAL = Path(__file__).resolve().parents[2].parent / "shared" / "real" / "waveform_leica" / "fwf_plain.las"
WEEK_START = 2400 * 604_800 - 1e9


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
def test_every_point_format(
    tmp_path: Path, point_format: int, version: str | None, compress: bool, hand: ModuleType
) -> None:
    """Expected: the fields that a format has, equal to what laspy was given; the others NaN, 0 or -1."""
    if compress and point_format in (4, 5, 9, 10):
        pytest.skip("LASzip has no waveform formats in this backend")
    path = tmp_path / ("f.laz" if compress else "f.las")
    data = foreign(path, point_format, version=version, compress=compress)
    got = hand.read_strip(path, 20, gps_week=2400)
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


def test_standard_time_with_the_wrong_bit_is_kept(tmp_path: Path, hand: ModuleType) -> None:
    """Rationale: some files hold adjusted standard time and leave the bit unset; seconds of a week never pass 604 800."""
    data = foreign(tmp_path / "f.las", 6)
    data.gps_time = 4.65e8 + np.arange(50)
    data.write(tmp_path / "f.las")
    assert not StripReader(tmp_path / "f.las").week_seconds
    assert hand.read_strip(tmp_path / "f.las", gps_week=2400).gps_time_s[0] == 4.65e8


def test_amplitude_in_db_beside_a_zero_intensity(tmp_path: Path, hand: ModuleType) -> None:
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
    got = hand.read_strip(tmp_path / "r.las", amplitude_unit="db")
    np.testing.assert_allclose(got.amplitude, [10.0, 100.0, 1000.0], rtol=1e-6)
    np.testing.assert_allclose(got.pulse_width_ns, [4.0, 4.1, 9.9], rtol=1e-6)
    assert np.array_equal(got.reflectance_db, np.float32([-3.0, -2.0, -1.0]))
    assert not got.intensity.any()


@pytest.mark.parametrize("internal", [False, True])
def test_packets_of_unequal_length(tmp_path: Path, internal: bool, hand: ModuleType) -> None:
    """Two descriptors (8 bit x 10, 16 bit x 6), a packet cut short, a row without one, an empty descriptor.

    Expected: groups hold the very samples; `waveforms` continues the shorter ones with their last sample.
    """
    eight, sixteen = bytes(range(10)), struct.pack("<6H", *range(1000, 1006))
    packets = [(1, eight), (3, sixteen), (0, b""), (1, eight[:4]), (3, sixteen)]
    hand.wave_file(tmp_path / "w.las", packets, {1: (8, 10, 1000), 3: (16, 6, 1000)}, internal=internal)
    reader = StripReader(tmp_path / "w.las")
    got = hand.read_strip(tmp_path / "w.las")
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


def test_offsets_of_internal_packets_count_from_their_record(tmp_path: Path, hand: ModuleType) -> None:
    """A record that names a byte past the file's end, though inside it when counted from the file's beginning."""
    path = tmp_path / "w.las"
    hand.wave_file(path, [(1, bytes(16))] * 3, {1: (8, 16, 1000)}, internal=True)
    StripReader(path).check_packets()
    hand.patched(path, struct.unpack_from("<I", path.read_bytes(), 96)[0] + 29, "<Q", 60 + 16 * 4)
    with pytest.raises(CampaignError, match="is shorter than its packets say"):
        StripReader(path).check_packets()


def test_packets_that_start_at_60_and_different_sampling(tmp_path: Path, hand: ModuleType) -> None:
    raw = [bytes([i] * 16) for i in range(5)]
    hand.wave_file(tmp_path / "w.las", [(1, r) for r in raw], {1: (8, 16, 2000)}, internal=False)
    reader = StripReader(tmp_path / "w.las")
    packet = hand.read_strip(tmp_path / "w.las").packet
    assert (packet.tolist(), reader.sampling_ps) == ([0, 1, 2, 3, 4], 2000.0)
    assert reader.waveforms(packet[::-1])[:, 0].tolist() == [4, 3, 2, 1, 0]
    hand.wave_file(
        tmp_path / "v.las", [(1, bytes(16)), (3, bytes(16))], {1: (8, 16, 2000), 3: (8, 16, 1000)}, internal=False
    )
    with pytest.raises(CampaignError, match="packets have different sampling"):
        StripReader(tmp_path / "v.las").waveforms(hand.read_strip(tmp_path / "v.las").packet)


def test_real_leica_file(hand: ModuleType) -> None:
    """LAS 1.3, PDRF 4, 256 x 8 bit at 2 ns. Expected: |d| = c/2 (1.499e-4 m/ps, the file rounds to 5 digits), and the greatest
    sample of the first return within one sample of its return location (a median: later returns are smaller)."""
    if not REAL.exists():
        pytest.skip("the real Leica file is not beside the project")
    reader = StripReader(REAL, gps_week=1700)
    got = hand.read_strip(REAL, 1000, gps_week=1700)
    assert (reader.point_count, reader.sampling_ps, reader.week_seconds) == (2250, 2000.0, True)
    assert 383_661.0 < got.gps_time_s[0] - (1700 * 604_800 - 1e9) < 383_663.0
    np.testing.assert_allclose(np.linalg.norm(got.wave_direction_m_ps, axis=1), 1.4986e-4, rtol=2e-4)
    single = got.number_of_returns == 1
    waves = reader.waveforms(got.packet[single])
    assert waves.shape == (single.sum(), 256)
    lag = waves.argmax(axis=1) - got.return_location_ps[single] / 2000.0
    assert abs(float(np.median(lag))) < 1.0
    reader.check_packets()
