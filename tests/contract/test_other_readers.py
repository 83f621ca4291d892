"""Other people's readers take the folder: laspy, tifffile, OpenCV, exifread, an XML parser, pyproj, csv; NumPy for the rest.

Nothing of campaign/, simulator/ or evaluator/ reads here: packets are found by LAS's own fields, positions go through PROJ.
"""

import csv
import datetime
import itertools
import json
import struct
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import exifread
import laspy
import numpy as np
import pyproj
import pytest
import tifffile
from exifread.utils import get_gps_coords
from scipy.spatial.transform import Rotation

GPS_EPOCH = datetime.datetime(1980, 1, 6, tzinfo=datetime.UTC)
LEAP_S, ADJUSTED_S, WEEK_S = 18, 1_000_000_000, 604_800
SBET = ("time", "lat", "lon", "height", "vx", "vy", "vz", "roll", "pitch", "heading", "wander")


@pytest.fixture(scope="module")
def campaign(tiny_run: Path) -> Path:
    return tiny_run / "campaign"


@pytest.fixture(scope="module")
def manifest(campaign: Path) -> dict[str, Any]:
    return dict(json.loads((campaign / "manifest.json").read_text("utf-8")))


def strips(campaign: Path) -> list[Path]:
    return sorted(campaign.glob("sorties/*/lidar/strip_??.las"))


def packets(las: Path, rows: np.ndarray) -> tuple[np.ndarray, float]:
    """Samples (n, samples) and their spacing [ps] of records, by the fields of LAS 1.4 and struct alone."""
    with laspy.open(las) as reader:
        vlrs = {v.record_id: v for v in reader.header.vlrs if v.user_id == "LASF_Spec"}
    assert (rows["wavepacket_index"] == 1).all()
    # record id 99 + index; bits, compression, samples, spacing, gain, offset
    bits, compression, samples, spacing_ps, gain, offset = struct.unpack("<BBIIdd", vlrs[100].record_data_bytes())
    assert (bits, compression, gain, offset) == (16, 0, 1.0, 0.0)
    raw = las.with_suffix(".wdp").read_bytes()
    _, user, record_id, length = struct.unpack_from("<H16sHQ", raw)
    assert (user.rstrip(b"\0"), record_id, length) == (b"LASF_Spec", 65535, len(raw) - 60)
    assert (rows["wavepacket_size"] == 2 * samples).all()
    at = rows["wavepacket_offset"].astype(np.int64)
    assert at.min() >= 60 and at.max() + 2 * samples <= len(raw)
    content = np.frombuffer(raw, np.uint8)
    return content[at[:, None] + np.arange(2 * samples)].view("<u2").astype(float), float(spacing_ps)


def xyz(las: laspy.LasData, rows: np.ndarray) -> np.ndarray:
    """(n, 3) of records, out of the scaled integers."""
    return np.stack([rows[n] for n in "XYZ"], axis=1) * las.header.scales + las.header.offsets


def sbet(path: Path) -> dict[str, np.ndarray]:
    """Columns of an SBET file."""
    table = np.fromfile(path, "<f8").reshape(-1, 17)
    return dict(zip(SBET, table.T))


def epochs(table: dict[str, np.ndarray], gps_time_s: np.ndarray, week: int) -> dict[str, np.ndarray]:
    """SBET columns at adjusted standard GPS times."""
    seconds = gps_time_s + ADJUSTED_S - week * WEEK_S
    assert table["time"][0] <= seconds.min() and seconds.max() <= table["time"][-1]
    return {
        name: np.interp(seconds, table["time"], np.unwrap(column) if name == "heading" else column)
        for name, column in table.items()
    }


def scanner_map(at: dict[str, np.ndarray], lever_arm_m: np.ndarray, manifest: dict[str, Any]) -> np.ndarray:
    """(n, 3) easting, northing, normal height of a point of the body."""
    to_ecef = pyproj.Transformer.from_crs(
        "EPSG:4479", "EPSG:4480", always_xy=True
    )  # CGCS2000 geocentric, geographic 3D
    lat, lon = at["lat"], at["lon"]
    centre = to_ecef.transform(np.degrees(lon), np.degrees(lat), at["height"], direction="INVERSE")
    ned_from_body = Rotation.from_euler("ZYX", np.stack([at["heading"], at["pitch"], at["roll"]], axis=1))
    north, east, down = ned_from_body.apply(lever_arm_m).T
    zero = np.zeros_like(lat)
    axes = (
        (north, (-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat))),
        (east, (-np.sin(lon), np.cos(lon), zero)),
        (down, (-np.cos(lat) * np.cos(lon), -np.cos(lat) * np.sin(lon), -np.sin(lat))),
    )
    ecef = np.stack(centre, axis=1) + sum(v[:, None] * np.stack(axis, axis=1) for v, axis in axes)
    lon2, lat2, height = to_ecef.transform(*ecef.T)
    to_map = pyproj.Transformer.from_crs("EPSG:4490", f"EPSG:{manifest['projection_epsg']}", always_xy=True)
    easting, northing = to_map.transform(lon2, lat2)
    return np.stack([easting, northing, height - manifest["height_anomaly_m"]], axis=1)


def test_headers_say_what_the_files_hold(campaign: Path, manifest: dict[str, Any]) -> None:
    """Rationale: tools decide by these fields. Expected: LAS 1.4, WKT bit, external packets, standard time, the campaign's day,
    bounds of the points, and a coordinate system that PROJ takes for EPSG:4549+5737: the same plane to 1e-6 m.
    """
    assert len(strips(campaign)) == 4
    for las in strips(campaign):
        for path, point_format in ((las, 9), (las.with_name(f"{las.stem}_points.laz"), 6)):
            data = laspy.read(path)
            header = data.header
            assert (str(header.version), header.point_format.id) == ("1.4", point_format)
            encoding = header.global_encoding
            assert encoding.wkt and encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
            assert encoding.waveform_data_packets_external == (point_format == 9)
            assert not encoding.waveform_data_packets_internal
            assert header.creation_date is not None and header.creation_date.isoformat() == manifest["date"]
            assert header.point_count == len(data.points) > 50_000
            assert header.mins == pytest.approx(data.xyz.min(axis=0), abs=1e-9)
            assert header.maxs == pytest.approx(data.xyz.max(axis=0), abs=1e-9)
            crs = header.parse_crs()
            assert crs is not None and crs.is_compound
            horizontal, vertical = crs.sub_crs_list
            assert (horizontal.to_epsg(min_confidence=20), vertical.to_epsg()) == (4549, 5737)
            place = manifest["longitude_deg"], manifest["latitude_deg"]
            ours, theirs = (
                pyproj.Transformer.from_crs(to.geodetic_crs, to, always_xy=True).transform(*place)
                for to in (horizontal, pyproj.CRS("EPSG:4549"))
            )
            assert ours == pytest.approx(theirs, abs=1e-6)
            assert np.hypot(*(data.xyz[:, :2].mean(axis=0) - theirs)) < 30.0


def test_points_without_waveforms_are_the_same_points(campaign: Path) -> None:
    """Rationale: tools that refuse PDRF 9 take the LAZ twin. Expected: its integers and attributes are equal, row by row."""
    for las in strips(campaign):
        full, twin = laspy.read(las), laspy.read(las.with_name(f"{las.stem}_points.laz"))
        assert np.array_equal(full.header.scales, twin.header.scales)
        assert np.array_equal(full.header.offsets, twin.header.offsets)
        for name in twin.points.array.dtype.names:
            assert np.array_equal(full.points.array[name], twin.points.array[name]), name


def test_peaks_lie_at_the_return_location(campaign: Path) -> None:
    """Rationale: a waveform tool finds an echo by the record's L; a shift of a sample is 15 cm.

    Expected: parabola fitted to the logarithm of the seven samples about the highest one peaks at L / spacing, for every
    single return whose echo is as wide as a pulse to 1.5 %, four standard deviations of a width (two surfaces that flow into one
    echo have no peak of their own), and that did not clip.
    Tolerance: 0.1 sample, the acceptance's. The parabola itself scatters by 1.4 n/A of a sample (n/A: noise over amplitude), 0.022
    at 300 DN.
    """
    sheet = json.loads((campaign / "sensors" / "lidar.json").read_text("utf-8"))
    errors = []
    for las in strips(campaign):
        data = laspy.read(las)
        rows = data.points.array
        single = (rows["bit_fields"] >> 4 == 1) & (rows["wavepacket_index"] > 0) & (rows["Amplitude"] > 300.0)
        single &= np.abs(rows["Pulse width"] / sheet["echo_fwhm_ns"] - 1.0) < 0.015
        rows = rows[single]
        samples, spacing_ps = packets(las, rows)
        assert samples.max() < 2 ** sheet["bit_depth"]
        unclipped = samples.max(axis=1) < 2 ** sheet["bit_depth"] - 1
        rows, samples = rows[unclipped], samples[unclipped]
        top = samples.argmax(axis=1)
        assert ((top > 3) & (top < samples.shape[1] - 4)).all()
        step = np.arange(-3, 4)
        signal = np.maximum(samples[np.arange(len(top))[:, None], top[:, None] + step] - sheet["baseline_dn"], 1.0)
        powers = np.stack([step**0, step, step**2], axis=1)
        normal = np.einsum("nk,ki,kj->nij", signal**2, powers, powers)
        right = np.einsum("nk,ki->ni", signal**2 * np.log(signal), powers)
        _, slope, bend = np.linalg.solve(normal, right[..., None])[..., 0].T
        peak = top - 0.5 * slope / bend
        error = peak - rows["return_point_wave_location"] / spacing_ps
        errors.append(error)
    error = np.concatenate(errors)
    print(f"{len(error)} single returns: mean {error.mean():.1e}, greatest {np.abs(error).max():.4f} samples from L")
    assert len(error) > 50_000
    assert abs(error.mean()) < 0.005
    assert np.abs(error).max() < 0.1


def returns_with_packets(campaign: Path) -> Iterator[tuple[Path, np.ndarray, np.ndarray, np.ndarray]]:
    """Strip, its records that have a packet, their points and directions d."""
    for las in strips(campaign):
        data = laspy.read(las)
        rows = data.points.array[data.points.array["wavepacket_index"] > 0]
        yield las, rows, xyz(data, rows), np.stack([rows[n] for n in ("x_t", "y_t", "z_t")], axis=1).astype(float)


def test_directions_point_at_the_scanner(campaign: Path, manifest: dict[str, Any]) -> None:
    """Rationale: XYZ and d together give the beam; georeferencing used the estimated trajectory and the drawing's mounting (the
    faults are for the evaluator to find), so that is the scanner d must point at: from SBET and rig.json, through PROJ.

    Expected: |d| is half the speed of light; angle between d and scanner - P.
    Tolerance: 0.01 degrees; XYZ's step of 0.1 mm is 0.0003 degrees at 20 m.
    """
    lever = np.array(json.loads((campaign / "sensors" / "rig.json").read_text("utf-8"))["lidar"]["lever_arm_m"])
    for las, rows, points, d in returns_with_packets(campaign):
        assert np.linalg.norm(d, axis=1) == pytest.approx(0.5 * 299_792_458.0 * 1e-12, rel=1e-6)
        track = sbet(las.parents[1] / "trajectory.out")
        at = epochs(track, rows["gps_time"], manifest["gps_week"])
        towards = scanner_map(at, lever, manifest) - points
        angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(towards, d), axis=1), np.einsum("ij,ij->i", towards, d)))
        print(f"{las.parts[-3]}/{las.name}: {len(rows)} directions, greatest angle {angle.max():.5f} deg")
        assert angle.max() < 0.01


def test_anchors_of_one_pulse_agree(campaign: Path) -> None:
    """Rationale: all returns of a pulse share one packet, whose place in the world is the anchor P + L d.

    Expected: returns with the same time and packet have one anchor; sample k lies at anchor - k dt d, so the return itself is
    at L. Tolerance: 2 mm; XYZ's step leaves 0.1 mm, L in single precision 0.02 mm.
    """
    pairs, worst = 0, 0.0
    for _, rows, points, d in returns_with_packets(campaign):
        anchor = points + rows["return_point_wave_location"][:, None].astype(float) * d
        assert (np.diff(rows["gps_time"]) >= 0.0).all()
        same = np.diff(rows["gps_time"]) == 0.0
        assert np.array_equal(same, np.diff(rows["wavepacket_offset"].astype(np.int64)) == 0)
        pairs += np.count_nonzero(same)
        worst = max(worst, float(np.linalg.norm(np.diff(anchor, axis=0)[same], axis=1).max(initial=0.0)))
    print(f"{pairs} pairs of returns, anchors within {1e3 * worst:.3f} mm")
    assert pairs > 20
    assert worst < 0.002


def exposures(campaign: Path) -> Iterator[tuple[Path, dict[str, str]]]:
    for table in sorted(campaign.glob("sorties/*/images/exposures.csv")):
        with table.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                yield table.with_name(row["image"]), row


def test_images_in_two_readers(campaign: Path) -> None:
    """Expected: tifffile and OpenCV (which orders BGR) see the same 16-bit pixels, of the sheet's size; the preview opens too."""
    sheet = json.loads((campaign / "sensors" / "camera.json").read_text("utf-8"))
    size = sheet["height_px"], sheet["width_px"], len(sheet["bands"])
    for path, _ in exposures(campaign):
        pixels = tifffile.imread(path)
        seen = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert seen is not None and pixels.dtype == seen.dtype == np.uint16 and pixels.shape == size
        assert np.array_equal(pixels, seen[:, :, ::-1])
        assert pixels.max() < 2 ** sheet["bit_depth"] and pixels.min() > 0.5 * sheet["black_level_dn"]
        preview = cv2.imread(str(path.with_suffix(".jpg")))
        assert preview is not None and preview.shape[:2] == size[:2]
        grey = preview.astype(float).mean(axis=2).ravel()[::97], pixels.astype(float).mean(axis=2).ravel()[::97]
        assert np.corrcoef(*grey)[0, 1] > 0.9


def test_exif_in_an_independent_reader(campaign: Path, manifest: dict[str, Any]) -> None:
    """Expected: exposure, aperture and focal length as the sheet and exposures.csv state; time of exposure in Beijing time; the
    place that the SBET gives for that time. Tolerance: 1e-6 s, 2e-9 degrees (arc seconds are written to 1e-5), 1e-4 m.
    """
    sheet = json.loads((campaign / "sensors" / "camera.json").read_text("utf-8"))
    assert len(list(exposures(campaign))) == 4
    for path, row in exposures(campaign):
        track = sbet(path.parents[1] / "trajectory.out")
        at = epochs(track, np.array([float(row["gps_time_s"])]), manifest["gps_week"])
        for name in (path, path.with_suffix(".jpg")):
            with name.open("rb") as file:
                seen = exifread.process_file(file)
            assert str(seen["Image Model"]) == sheet["name"]
            assert float(seen["EXIF ExposureTime"].values[0]) == pytest.approx(float(row["exposure_time_s"]), rel=1e-4)
            assert float(seen["EXIF FNumber"].values[0]) == sheet["f_number"]
            assert float(seen["EXIF FocalLength"].values[0]) == sheet["nominal_focal_length_mm"]
            stamped = (
                f"{seen['EXIF DateTimeOriginal']}.{seen['EXIF SubSecTimeOriginal']} {seen['EXIF OffsetTimeOriginal']}"
            )
            taken = datetime.datetime.strptime(stamped, "%Y:%m:%d %H:%M:%S.%f %z") - GPS_EPOCH
            assert taken.total_seconds() + LEAP_S - ADJUSTED_S == pytest.approx(float(row["gps_time_s"]), abs=1e-6)
            latitude, longitude = get_gps_coords(seen)
            assert latitude == pytest.approx(float(np.degrees(at["lat"][0])), abs=2e-9)
            assert longitude == pytest.approx(float(np.degrees(at["lon"][0])), abs=2e-9)
            assert float(seen["GPS GPSAltitude"].values[0]) == pytest.approx(float(at["height"][0]), abs=1e-4)


def test_xmp_in_an_xml_parser(campaign: Path, manifest: dict[str, Any]) -> None:
    """Expected: attitude as attributes, in the two dialects that photogrammetry reads, equal to the SBET's.

    Tolerance: 1e-4 degrees, as many digits as are written, and half of that by interpolation.
    """
    dji, pix4d = "{http://www.dji.com/drone-dji/1.0/}", "{http://pix4d.com/camera/1.0/}"
    for path, row in exposures(campaign):
        track = sbet(path.parents[1] / "trajectory.out")
        at = epochs(track, np.array([float(row["gps_time_s"])]), manifest["gps_week"])
        heading, pitch, roll = (float(np.degrees(at[n][0])) for n in ("heading", "pitch", "roll"))
        with tifffile.TiffFile(path) as tiff:
            packet = tiff.pages[0].tags[700].value
        attributes = next(e for e in ET.fromstring(packet).iter() if e.tag.endswith("Description")).attrib
        for yaw in (f"{dji}GimbalYawDegree", f"{dji}FlightYawDegree", f"{pix4d}Yaw"):
            assert (float(attributes[yaw]) - heading + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1.5e-4), yaw
        assert float(attributes[f"{dji}GimbalPitchDegree"]) == pytest.approx(pitch - 90.0, abs=1.5e-4)
        assert float(attributes[f"{pix4d}Pitch"]) == pytest.approx(pitch, abs=1.5e-4)
        assert float(attributes[f"{pix4d}Roll"]) == pytest.approx(roll, abs=1.5e-4)


def test_sbet_is_a_flight(campaign: Path, manifest: dict[str, Any]) -> None:
    """Expected: time in seconds of the manifest's week at the stated rate, radians over the site, wander angle 0, velocities
    that are the positions' slopes. Tolerance: 0.05 m/s: 1-2 cm of navigation error change by less in the second that is averaged.
    """
    start = datetime.datetime.fromisoformat(manifest["start_time"]) - GPS_EPOCH
    metres = 6_371_000.0
    for path in sorted(campaign.glob("sorties/*/trajectory.out")):
        table = sbet(path)
        first = table["time"][0] + manifest["gps_week"] * WEEK_S
        assert 0.0 <= first - (start.total_seconds() + LEAP_S) < 3600.0
        assert np.diff(table["time"]) == pytest.approx(0.005, abs=1e-6)
        assert not table["wander"].any()
        assert np.degrees(table["lat"]) == pytest.approx(manifest["latitude_deg"], abs=0.001)
        assert np.degrees(table["lon"]) == pytest.approx(manifest["longitude_deg"], abs=0.001)
        step = slice(None, None, 200)
        north = np.diff(table["lat"][step]) * metres
        mean = [table["vx"][i : i + 200].mean() for i in range(0, 200 * len(north), 200)]
        assert north == pytest.approx(np.array(mean), abs=0.05, rel=0.01)


def test_survey_in_csv_and_pyproj(campaign: Path, manifest: dict[str, Any]) -> None:
    """Expected: csv reads every target once, 20 panels and 9 frustums; targets.prj is the plane and height of the campaign;
    the targets lie on the range, apart from one another, and points were measured on every one of them.
    """
    with (campaign / "survey" / "targets.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [sum(r["kind"] == kind for r in rows) for kind in ("panel", "frustum")] == [20, 9]
    assert len({r["id"] for r in rows}) == 29
    crs = pyproj.CRS.from_wkt((campaign / "survey" / "targets.prj").read_text("utf-8"))
    assert [c.to_epsg(min_confidence=20) for c in crs.sub_crs_list] == [4549, 5737]
    places = np.array([[float(r[c]) for c in ("easting_m", "northing_m", "height_m")] for r in rows])
    to_map = pyproj.Transformer.from_crs("EPSG:4490", "EPSG:4549", always_xy=True)
    origin = to_map.transform(manifest["longitude_deg"], manifest["latitude_deg"])
    assert np.hypot(*(places[:, :2] - origin).T).max() < 25.0
    assert min(np.hypot(*(a - b)) for a, b in itertools.combinations(places[:, :2], 2)) > 0.7
    with (campaign / "survey" / "spectra.csv").open(newline="", encoding="utf-8") as file:
        header = next(csv.reader(file))
    assert header == ["wavelength_nm", *(r["id"] for r in rows if r["kind"] == "panel")]
    cloud = np.concatenate([laspy.read(path).xyz for path in strips(campaign)])
    for place in places:
        near = np.hypot(*(cloud[:, :2] - place[:2]).T) < 0.5
        assert near.sum() > 100
        assert abs(np.median(cloud[near, 2]) - place[2]) < 1.0
