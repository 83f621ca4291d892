"""Other people's readers take the exports: pycolmap, exifread, Pillow, OpenCV, trimesh, Open3D, laspy, PROJ, mcap.

Expected places come from SBET, LAS and the sheets through PROJ and SciPy, pixels from truth/; nothing of evaluator/ but one pose.
"""

import csv
import datetime
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import exifread
import laspy
import numpy as np
import pycolmap
import pyproj
import pytest
import trimesh
from exifread.utils import get_gps_coords
from PIL import Image
from scipy.spatial.transform import Rotation

from evaluator.frames import WorldFrame, body_pose
from evaluator.load import load_campaign
from testrange.export import Format, export_campaign

WEEK_S, ADJUSTED_S, LEAP_S = 604_800, 1_000_000_000, 18


@pytest.fixture(scope="module")
def campaign(tiny_run: Path) -> Path:
    return tiny_run / "campaign"


@pytest.fixture(scope="module")
def results(tiny_run: Path) -> dict[str, Any]:
    return dict(json.loads((tiny_run / "results" / "results.json").read_bytes()))


@pytest.fixture(scope="module")
def exported(tiny_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Exports once for each format, with and without results."""
    root, done = tmp_path_factory.mktemp("export"), set()

    def export(to: Format, *, adjusted: bool = False) -> Path:
        out = root / f"{to}_{adjusted}"
        if out not in done:
            export_campaign(tiny_run / "campaign", out, to, results=tiny_run / "results" if adjusted else None)
            done.add(out)
        return out

    return export


def manifest(campaign: Path) -> dict[str, Any]:
    return dict(json.loads((campaign / "manifest.json").read_bytes()))


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def exposures(campaign: Path) -> dict[str, tuple[str, dict[str, str]]]:
    """Image's stem -> (sortie, row of exposures.csv)."""
    found = {}
    for path in sorted(campaign.glob("sorties/*/images/exposures.csv")):
        found |= {Path(r["image"]).stem: (path.parts[-3], r) for r in table(path)}
    return found


def true_marks(campaign: Path) -> dict[tuple[str, str], np.ndarray]:
    """(target, image's stem) -> true pixel of what is visible."""
    rows = table(campaign / "truth" / "marks.csv")
    return {
        (r["target"], Path(r["image"]).stem): np.array([float(r["u_px"]), float(r["v_px"])])
        for r in rows
        if r["visible"] == "1"
    }


def camera_places(campaign: Path) -> dict[str, tuple[float, float, float, float]]:
    """Stem -> latitude, longitude [deg], ellipsoidal height [m] of the projection centre by SBET and drawing, heading [deg]."""
    week = manifest(campaign)["gps_week"]
    arm = json.loads((campaign / "sensors" / "rig.json").read_bytes())["camera"]["lever_arm_m"]
    to_ecef = pyproj.Transformer.from_crs("EPSG:4480", "EPSG:4479", always_xy=True)
    found = {}
    for stem, (sortie, row) in exposures(campaign).items():
        sbet = np.fromfile(campaign / "sorties" / sortie / "trajectory.out", "<f8").reshape(-1, 17)
        at = float(row["gps_time_s"]) + ADJUSTED_S - week * WEEK_S
        lat, lon, height, roll, pitch = (np.interp(at, sbet[:, 0], sbet[:, k]) for k in (1, 2, 3, 7, 8))
        heading = np.interp(at, sbet[:, 0], np.unwrap(sbet[:, 9]))
        north, east, down = Rotation.from_euler("ZYX", [heading, pitch, roll]).apply(arm)
        sp, cp, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
        axes = np.array([[-sp * cl, -sp * sl, cp], [-sl, cl, 0.0], [-cp * cl, -cp * sl, -sp]])
        ecef = (
            np.array(to_ecef.transform(np.degrees(lon), np.degrees(lat), height)) + np.array([north, east, down]) @ axes
        )
        lon2, lat2, height2 = to_ecef.transform(*ecef, direction="INVERSE")
        found[stem] = (lat2, lon2, height2, float(np.degrees(heading)) % 360.0)
    return found


def enu(campaign: Path, map_m: np.ndarray) -> np.ndarray:
    """Easting, northing, normal height (n, 3) -> east, north, up at the site's origin, by PROJ alone. [m]"""
    m = manifest(campaign)
    to_geographic = pyproj.Transformer.from_crs(f"EPSG:{m['projection_epsg']}", "EPSG:4490", always_xy=True)
    lon, lat = to_geographic.transform(map_m[:, 0], map_m[:, 1])
    to_topocentric = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=GRS80 +step "
        f"+proj=topocentric +ellps=GRS80 +lat_0={m['latitude_deg']!r} +lon_0={m['longitude_deg']!r} "
        f"+h_0={m['ellipsoid_height_m']!r}"
    )
    return np.stack(to_topocentric.transform(lon, lat, map_m[:, 2] + m["height_anomaly_m"]), axis=1)


# ------------------------------------------------------------------------------------------------ COLMAP


def reprojections_px(folder: Path) -> np.ndarray:
    """Distance of every point of the model from its observation, by COLMAP's own camera."""
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    errors = []
    for image in model.images.values():
        camera = model.cameras[image.camera_id]
        for point in image.points2D:
            in_camera = image.cam_from_world() * model.points3D[point.point3D_id].xyz
            errors.append(np.linalg.norm(camera.img_from_cam(in_camera) - point.xy))
    return np.array(errors)


def test_pycolmap_reads_the_model_and_meets_the_observations(
    exported: Callable[..., Path], campaign: Path, results: dict[str, Any]
) -> None:
    """Rationale: poses, lens, axes and pixels are COLMAP's own then; a half pixel or a sign would show at once.
    Expected: with the adjusted mounting all marks within the navigation's noise: at 22 and 30 m with a pixel of 6 mm/m, 1 cm
    and 0.005 degrees are 0.8 px; with the nominal one (0.3 degrees, some cm) more than 5 px.
    Tolerance: median 1 px, every one 3 px.
    """
    folder = exported("colmap", adjusted=True)
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    assert len(model.images) == len(exposures(campaign)) and len(model.points3D) >= 8
    (camera,) = model.cameras.values()
    assert camera.model_name == "FULL_OPENCV" and (camera.width, camera.height) == (1536, 1024)
    errors = reprojections_px(folder)
    assert len(errors) > 20
    assert np.median(errors) < 1.0 and errors.max() < 3.0, errors
    assert np.median(reprojections_px(exported("colmap"))) > 5.0
    true = true_marks(campaign)
    targets = [r["id"] for r in table(campaign / "survey" / "targets.csv")]
    off = [
        np.linalg.norm(p.xy - true[targets[p.point3D_id - 1], Path(image.name).stem])
        for image in model.images.values()
        for p in image.points2D
    ]
    assert np.median(off) < 0.1, "observations are the evaluator's, in COLMAP's pixels"


def test_colmaps_places_are_the_models(exported: Callable[..., Path], campaign: Path) -> None:
    """Rationale: model_aligner takes these files. Expected: projection centres of the model, and the same places through PROJ.
    Tolerance: digits written, 0.02 mm.
    """
    folder = exported("colmap")
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    by_name = {image.name: image.projection_center() for image in model.images.values()}

    def places(name: str) -> dict[str, np.ndarray]:
        lines = (line.split() for line in (folder / name).read_text().splitlines())
        return {words[0]: np.array(words[1:], float) for words in lines}

    flat, round_, geographic = (places(f"places_{n}.txt") for n in ("enu", "ecef", "wgs84"))
    assert set(flat) == set(round_) == set(geographic) == set(by_name)
    to_ecef = pyproj.Transformer.from_crs("EPSG:4480", "EPSG:4479", always_xy=True)
    expected = camera_places(campaign)
    for name, centre in by_name.items():
        np.testing.assert_allclose(flat[name], centre, atol=2e-5)
        lat, lon, height = geographic[name]
        np.testing.assert_allclose(round_[name], to_ecef.transform(lon, lat, height), atol=2e-5)
        # between samples of 5 ms both sides interpolate, each in its own coordinates
        np.testing.assert_allclose([lat, lon], expected[Path(name).stem][:2], atol=1e-9, rtol=0.0)
        assert abs(height - expected[Path(name).stem][2]) < 1e-3


def test_colmap_finds_the_focal_length_in_exif_and_nothing_else(exported: Callable[..., Path]) -> None:
    """Expected: COLMAP's own EXIF reader gives the nominal 13.5 mm / 9 um = 1500 px; no place, no date."""
    path = sorted((exported("colmap") / "images").iterdir())[0]
    camera = pycolmap.infer_camera_from_image(path)
    assert camera.has_prior_focal_length and abs(camera.mean_focal_length() - 1500.0) < 1e-3
    with path.open("rb") as file:
        names = {n for n in exifread.process_file(file) if n.startswith(("EXIF", "GPS", "Image"))}
    assert not {n for n in names if "GPS" in n or "Date" in n or "Make" in n}
    assert {"EXIF FocalLength", "EXIF FocalPlaneXResolution"} <= names


# --------------------------------------------------------------------------------------------------- ODM


def test_exif_holds_place_time_and_attitude(exported: Callable[..., Path], campaign: Path) -> None:
    """Rationale: ODM starts from EXIF. Expected: the projection centre within 1e-7 degrees, normal height within 2 mm, Beijing
    time of the exposure with +08:00, GPS time 8 hours less, heading of the image; Pillow opens it at the sheet's size.
    """
    m, places = manifest(campaign), camera_places(campaign)
    shots = exposures(campaign)
    paths = sorted((exported("odm") / "images").iterdir())
    assert [p.stem for p in paths] == sorted(shots)
    for path in paths:
        with path.open("rb") as file:
            tags = exifread.process_file(file)
        lat, lon, height, heading = places[path.stem]
        found = get_gps_coords(tags)
        assert abs(found[0] - lat) < 1e-7 and abs(found[1] - lon) < 1e-7
        altitude = tags["GPS GPSAltitude"].values[0]
        assert abs(float(altitude) - (height - m["height_anomaly_m"])) < 2e-3
        gps_s = float(shots[path.stem][1]["gps_time_s"]) + ADJUSTED_S
        utc = datetime.datetime(1980, 1, 6) + datetime.timedelta(seconds=gps_s - LEAP_S)
        local = utc + datetime.timedelta(hours=8)
        written = f"{tags['EXIF DateTimeOriginal']}.{tags['EXIF SubSecTimeOriginal']}"
        assert abs(datetime.datetime.strptime(written, "%Y:%m:%d %H:%M:%S.%f") - local) < datetime.timedelta(
            microseconds=2
        )
        assert str(tags["EXIF OffsetTimeOriginal"]) == "+08:00"
        hour, minute, second = (float(v) for v in tags["GPS GPSTimeStamp"].values)
        midnight = utc.replace(hour=0, minute=0, second=0, microsecond=0)
        assert abs(hour * 3600 + minute * 60 + second - (utc - midnight).total_seconds()) < 1e-4
        # heading of the image's top edge and of the body differ by the turn that roll and pitch of a degree make: far below 0.1
        assert abs((float(tags["GPS GPSImgDirection"].values[0]) - heading + 180.0) % 360.0 - 180.0) < 0.1
        with Image.open(path) as picture:
            assert picture.size == (1536, 1024) and picture.mode == "RGB"


def test_gcp_list_and_geo_agree_with_survey_and_truth(exported: Callable[..., Path], campaign: Path) -> None:
    """Rationale: ODM reads columns by place. Expected: coordinates of targets.csv, pixels of truth half a pixel less (OpenSfM's
    pixel), places of EXIF, accuracies of smrmsg. Tolerance: median of pixels 0.1 px, every one 1 px.
    """
    folder = exported("odm")
    header, *lines = (folder / "gcp_list.txt").read_text().splitlines()
    assert header == f"EPSG:{manifest(campaign)['projection_epsg']}" and len(lines) > 20
    survey = {r["id"]: r for r in table(campaign / "survey" / "targets.csv")}
    true, off = true_marks(campaign), []
    for line in lines:
        east, north, height, u, v, image, target = line.split()
        row = survey[target]
        stated = [float(row[c]) for c in ("easting_m", "northing_m", "height_m")]
        np.testing.assert_allclose([float(east), float(north), float(height)], stated, atol=6e-5, rtol=0.0)
        off.append(np.array([float(u), float(v)]) + 0.5 - true[target, Path(image).stem])
    errors = np.linalg.norm(off, axis=1)
    assert np.median(errors) < 0.1 and errors.max() < 1.0
    assert np.abs(np.median(off, axis=0)).max() < 0.1, "half a pixel would show"
    header, *lines = (folder / "geo.txt").read_text().splitlines()
    assert header == "EPSG:4326"
    for line in lines:
        image, lon, lat, height, yaw, pitch, roll, horizontal, vertical = line.split()
        with (folder / "images" / image).open("rb") as file:
            place = get_gps_coords(exifread.process_file(file))
        np.testing.assert_allclose([float(lat), float(lon)], place, atol=1e-8, rtol=0.0)
        assert max(abs(float(pitch)), abs(float(roll))) < 6.0 and 0.0 <= float(yaw) < 360.0
        assert 0.001 <= float(horizontal) < 0.1 and 0.001 <= float(vertical) < 0.1
        assert 10.0 < float(height) < 60.0


def test_one_gain_for_all_images(exported: Callable[..., Path], campaign: Path) -> None:
    """Rationale: matching needs detail, radiometry one scale. Expected: mean of linearised blocks proportional to DN above black,
    the same factor in every image. Tolerance: 8 bits and JPEG, 2 %.
    """
    sheet = json.loads((campaign / "sensors" / "camera.json").read_bytes())
    factors = []
    for path in sorted((exported("odm") / "images").iterdir()):
        (tif,) = campaign.glob(f"sorties/*/images/{path.stem}.tif")
        dn = cv2.imread(str(tif), cv2.IMREAD_UNCHANGED).astype(float) - sheet["black_level_dn"]
        coded = cv2.imread(str(path)).astype(float) / 255.0
        linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
        usable = coded.max(axis=2) < 0.9
        factors.append(linear[usable].mean() / dn[usable].mean())
        assert (coded.max(axis=2) >= 254.5 / 255.0).mean() < 0.01, "hardly anything is clipped"
        assert 0.2 < coded.mean() < 0.8
    assert np.ptp(factors) / np.mean(factors) < 0.02


# ------------------------------------------------------------------------------------------------ clouds


def ply(path: Path) -> np.ndarray:
    """Binary PLY by its header, (n,) structured."""
    raw = path.read_bytes()
    end = raw.index(b"end_header\n") + len(b"end_header\n")
    kinds = {"double": "<f8", "float": "<f4"}
    lines = raw[:end].decode().splitlines()
    fields = [(w[2], kinds[w[1]]) for w in map(str.split, lines) if w[0] == "property"]
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    return np.frombuffer(raw, np.dtype(fields), count, end)


def test_clouds_are_the_las_files(exported: Callable[..., Path], campaign: Path) -> None:
    """Rationale: no point may be lost or moved. Expected: every return of every strip, coordinates through PROJ alone.
    Tolerance: 1e-6 m in PLY (double), 5e-6 m in PCD (single precision within 100 m).
    """
    import open3d

    folder = exported("clouds") / "clouds"
    strips = sorted(campaign.glob("sorties/*/lidar/strip_??.las"))
    assert len(strips) == len(list(folder.glob("*.ply"))) == 4
    for path in strips:
        name = f"s{path.parts[-3]}_l{path.stem[-2:]}"
        las = laspy.read(path)
        expected = enu(campaign, np.stack([las.x, las.y, las.z], axis=1))
        points = ply(folder / f"{name}.ply")
        np.testing.assert_allclose(np.stack([points[c] for c in "xyz"], axis=1), expected, atol=1e-6, rtol=0.0)
        np.testing.assert_array_equal(points["gps_time"], las.gps_time)
        np.testing.assert_array_equal(points["intensity"], las.intensity)
        np.testing.assert_array_equal(points["reflectance"], las["Reflectance"])
        other = np.asarray(open3d.io.read_point_cloud(str(folder / f"{name}.pcd")).points)
        np.testing.assert_allclose(other, expected, atol=5e-6, rtol=0.0)
    cloud = trimesh.load(folder / "s01_l01.ply")
    first = laspy.read(strips[0])
    np.testing.assert_allclose(np.asarray(cloud.vertices)[0], enu(campaign, first.xyz[:1])[0], atol=1e-5)


def test_pairs_hold_together(exported: Callable[..., Path], campaign: Path, results: dict[str, Any]) -> None:
    """Rationale: a calibration starts from this camera, this guess and these points. Expected: surveyed marks, taken into the
    LiDAR's axes by the adjusted mounting, then through calib.json and OpenCV, lie on the true pixels (1 px of navigation noise);
    the cloud has returns beside each mark; intensities are ranks. Control: the nominal export's guess is off by several px.
    """
    data = load_campaign(campaign)
    frame, true = WorldFrame(data.manifest), true_marks(campaign)
    shots = exposures(campaign)
    block = results["mounting"]["body_from_lidar"]
    rotation, arm = np.array(block["rotation"]), np.array(block["lever_arm_m"])

    def off_px(folder: Path) -> np.ndarray:
        calib = json.loads((folder / "calib.json").read_bytes())
        x, y, z, *quaternion = calib["results"]["init_T_lidar_camera"]
        turn = Rotation.from_quat(quaternion)
        fx, fy, cx, cy = calib["camera"]["intrinsics"]
        k = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        errors = []
        assert sorted(calib["meta"]["bag_names"]) == sorted(shots)
        for name in calib["meta"]["bag_names"]:
            sortie, row = shots[name]
            trajectory = next(s.trajectory for s in data.sorties if s.folder.number == int(sortie))
            assert trajectory is not None
            position, turns = body_pose(trajectory, np.array([float(row["gps_time_s"])]), frame)
            for t in data.targets:
                if (t.id, name) not in true:
                    continue
                world = enu(campaign, np.array([[t.easting_m, t.northing_m, t.height_m]]))[0]
                in_lidar = (turns[0].T @ (world - position[0]) - arm) @ rotation
                in_camera = turn.inv().apply(in_lidar - [x, y, z])
                uv, _ = cv2.projectPoints(
                    in_camera[None], np.zeros(3), np.zeros(3), k, np.array(calib["camera"]["distortion_coeffs"])
                )
                errors.append(uv.ravel() + 0.5 - true[t.id, name])
        return np.array(errors)

    adjusted = exported("clouds", adjusted=True) / "pairs"
    errors = np.linalg.norm(off_px(adjusted), axis=1)
    assert len(errors) > 20 and np.median(errors) < 1.0 and errors.max() < 3.0
    assert np.median(np.linalg.norm(off_px(exported("clouds") / "pairs"), axis=1)) > 3.0
    for name, (sortie, row) in shots.items():
        points = ply(adjusted / f"{name}.ply")
        assert points.dtype.names == ("x", "y", "z", "intensity")
        assert abs(float(points["intensity"].mean()) - 0.5) < 1e-3 and points["intensity"].max() < 1.0
        with Image.open(adjusted / f"{name}.png") as picture:
            assert picture.size == (1536, 1024)
        trajectory = next(s.trajectory for s in data.sorties if s.folder.number == int(sortie))
        assert trajectory is not None
        position, turns = body_pose(trajectory, np.array([float(row["gps_time_s"])]), frame)
        xyz = np.stack([points[c] for c in "xyz"], axis=1).astype(float)
        world = position[0] + (xyz @ rotation.T + arm) @ turns[0].T
        marks = [t for t in data.targets if (t.id, name) in true]
        for t in marks:
            centre = enu(campaign, np.array([[t.easting_m, t.northing_m, t.height_m]]))[0]
            assert np.linalg.norm(world - centre, axis=1).min() < 0.15, f"{t.id} in {name}"


# -------------------------------------------------------------------------------------------------- mcap


class Cdr:
    """The few CDR types that these messages need, read by hand."""

    def __init__(self, raw: bytes) -> None:
        assert raw[:4] == b"\0\1\0\0"
        self.raw, self.at = raw[4:], 0

    def get(self, form: str) -> Any:
        size = struct.calcsize(f"<{form}")
        self.at += -self.at % size
        (value,) = struct.unpack_from(f"<{form}", self.raw, self.at)
        self.at += size
        return value

    def text(self) -> str:
        size = self.get("I")
        self.at += size
        return self.raw[self.at - size : self.at - 1].decode()

    def blob(self) -> bytes:
        size = self.get("I")
        self.at += size
        return self.raw[self.at - size : self.at]

    def header(self) -> tuple[int, str]:
        return self.get("i") * 10**9 + self.get("I"), self.text()


def test_mcap_holds_images_clouds_and_poses(exported: Callable[..., Path], campaign: Path) -> None:
    """Expected: one image and one CameraInfo an exposure at its UTC time, clouds of whole seconds with every return, poses;
    messages in the order of time. Positions of PROJ within 0.05 mm (single precision).
    """
    from mcap.reader import make_reader

    (path,) = exported("mcap").glob("*.mcap")
    seen: dict[str, list[tuple[int, bytes]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        for schema, channel, message in reader.iter_messages():
            assert schema is not None and schema.encoding == "ros2msg" and channel.message_encoding == "cdr"
            seen.setdefault(channel.topic, []).append((message.log_time, message.data))
    shots = exposures(campaign)
    unix = {stem: float(r["gps_time_s"]) + ADJUSTED_S + 315_964_800 - LEAP_S for stem, (_, r) in shots.items()}
    images = seen["/camera/image/compressed"]
    assert len(images) == len(seen["/camera/camera_info"]) == len(shots)
    np.testing.assert_allclose([t / 1e9 for t, _ in images], sorted(unix.values()), atol=2e-6, rtol=0.0)
    message = Cdr(images[0][1])
    assert message.header() == (images[0][0], "camera") and message.text() == "jpeg"
    assert cv2.imdecode(np.frombuffer(message.blob(), np.uint8), cv2.IMREAD_COLOR).shape == (1024, 1536, 3)
    total, first = 0, None
    for time, raw in seen["/lidar/points"]:
        message = Cdr(raw)
        assert message.header() == (time, "world") and message.get("I") == 1
        width = message.get("I")
        names = []
        for _ in range(message.get("I")):
            names.append((message.text(), message.get("I"), message.get("B"), message.get("I")))
        assert [n[0] for n in names] == ["x", "y", "z", "intensity", "reflectance", "gps_time"]
        assert not message.get("?") and message.get("I") == 28 and message.get("I") == 28 * width
        rows = np.frombuffer(message.blob(), [(n, "<f8" if kind == 8 else "<f4") for n, _, kind, _ in names])
        assert len(rows) == width and np.ptp(np.floor(rows["gps_time"])) == 0.0
        first = rows if first is None else first
        total += width
    strips = [laspy.read(p) for p in sorted(campaign.glob("sorties/*/lidar/strip_??.las"))]
    assert total == sum(len(las) for las in strips)
    assert first is not None
    expected = enu(campaign, strips[0].xyz[: len(first)])
    np.testing.assert_allclose(np.stack([first[c] for c in "xyz"], axis=1), expected, atol=5e-5, rtol=0.0)
    assert len(seen["/pose"]) == len(seen["/tf"]) > 1000 and len(seen["/tf_static"]) >= 2
    message = Cdr(seen["/pose"][0][1])
    assert message.header()[1] == "world"
    place = np.array([message.get("d") for _ in range(3)])
    sbet = np.fromfile(campaign / "sorties" / "01" / "trajectory.out", "<f8").reshape(-1, 17)
    m = manifest(campaign)
    to_map = pyproj.Transformer.from_crs("EPSG:4490", f"EPSG:{m['projection_epsg']}", always_xy=True)
    east, north = to_map.transform(np.degrees(sbet[0, 2]), np.degrees(sbet[0, 1]))
    np.testing.assert_allclose(
        place, enu(campaign, np.array([[east, north, sbet[0, 3] - m["height_anomaly_m"]]]))[0], atol=1e-5
    )
