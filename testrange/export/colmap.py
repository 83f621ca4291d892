"""COLMAP: images/, sparse/0/ as text, and the images' places for its model_aligner.

COLMAP's pixels follow our corner convention (its documentation: the first pixel's centre is (0.5, 0.5)), its camera axes are ours,
and its FULL_OPENCV with k4 = k5 = k6 = 0 is our lens, so nothing is converted but the order of parameters.
"""

from pathlib import Path

import numpy as np
import pyproj
from scipy.spatial.transform import Rotation

from campaign.formats.text import write_text
from campaign.progress import Report
from evaluator.camera_model import project
from evaluator.frames import WorldFrame
from testrange.export.observations import Sighting, find_sightings
from testrange.export.pictures import eight_bit, jpeg, lens_exif, read_shot, tone_curve, write_bytes
from testrange.export.readme import page, world_frame
from testrange.export.source import Shot, Source


def export(source: Source, out: Path, progress: Report) -> None:
    """Writes images/, sparse/0/{cameras,images,points3D}.txt, places_*.txt and README.md into `out`."""
    shots = source.shots()
    progress("tone", 0, 1)
    curve = tone_curve(source, shots)
    progress("tone", 1, 1)
    exif = lens_exif(source.camera)
    for done, shot in enumerate(shots):
        progress("images", done, len(shots))
        write_bytes(out / "images" / f"{shot.name}.jpg", jpeg(eight_bit(read_shot(source, shot), curve), exif))
    progress("images", len(shots), len(shots))
    sightings = find_sightings(source, shots, progress)
    write_model(source, shots, sightings, out / "sparse" / "0")
    write_places(source, shots, out)
    write_text(out / "README.md", _readme(source, shots, sightings))


def camera_line(source: Source) -> str:
    """CAMERA_ID MODEL WIDTH HEIGHT fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"""
    lens = source.lens_or_nominal
    values = (
        lens.fx_px,
        lens.fy_px,
        lens.cx_px,
        lens.cy_px,
        lens.k1,
        lens.k2,
        lens.p1,
        lens.p2,
        lens.k3,
        0.0,
        0.0,
        0.0,
    )
    camera = source.camera
    return f"1 FULL_OPENCV {camera.width_px} {camera.height_px} " + " ".join(repr(float(v)) for v in values)


def write_model(source: Source, shots: list[Shot], sightings: list[Sighting], folder: Path) -> None:
    """The sparse model; its points are the surveyed targets, its tracks the sightings."""
    write_text(folder / "cameras.txt", f"# CAMERA_ID MODEL WIDTH HEIGHT PARAMS\n{camera_line(source)}\n")
    ids = {t.id: number for number, t in enumerate(source.data.targets, start=1)}
    lines = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", "# POINTS2D[] as X Y POINT3D_ID"]
    tracks: dict[str, list[tuple[int, int, float]]] = {}
    places = {t.id: source.surveyed_world(t) for t in source.data.targets}
    for number, shot in enumerate(shots, start=1):
        camera_from_world = shot.world_from_camera.T
        x, y, z, w = Rotation.from_matrix(camera_from_world).as_quat(canonical=True)
        translation = -camera_from_world @ shot.centre_world_m
        pose = " ".join(f"{v:.17g}" for v in (w, x, y, z, *translation))
        lines.append(f"{number} {pose} 1 {shot.name}.jpg")
        own = [s for s in sightings if s.shot is shot]
        for index, s in enumerate(own):
            in_camera = camera_from_world @ (places[s.target] - shot.centre_world_m)
            error = float(np.linalg.norm(project(source.lens_or_nominal, in_camera[None])[0] - s.uv_px))
            tracks.setdefault(s.target, []).append((number, index, error))
        lines.append(" ".join(f"{s.uv_px[0]:.4f} {s.uv_px[1]:.4f} {ids[s.target]}" for s in own))
    write_text(folder / "images.txt", "\n".join(lines) + "\n")
    points = ["# POINT3D_ID X Y Z R G B ERROR TRACK[] as IMAGE_ID POINT2D_IDX"]
    for target, track in sorted(tracks.items(), key=lambda item: ids[item[0]]):
        errors = [e for _, _, e in track if np.isfinite(e)]
        mean = float(np.mean(errors)) if errors else -1.0
        place = " ".join(f"{v:.6f}" for v in places[target])
        hits = " ".join(f"{image} {index}" for image, index, _ in track)
        points.append(f"{ids[target]} {place} 255 255 255 {mean:.4f} {hits}")
    write_text(folder / "points3D.txt", "\n".join(points) + "\n")


def write_places(source: Source, shots: list[Shot], out: Path) -> None:
    """Name and projection centre of every image: world (ENU), Earth-centred, and latitude, longitude, height."""
    centres = np.array([s.centre_world_m for s in shots])
    lat, lon, height = source.frame.geodetic_from_world(centres)
    tables = {
        "places_enu.txt": [" ".join(f"{v:.5f}" for v in c) for c in centres],
        "places_ecef.txt": [" ".join(f"{v:.5f}" for v in c) for c in earth_centred(source.frame, centres)],
        "places_wgs84.txt": [
            f"{a:.11f} {b:.11f} {c:.5f}" for a, b, c in zip(np.degrees(lat), np.degrees(lon), height, strict=True)
        ],
    }
    for name, rows in tables.items():
        write_text(out / name, "".join(f"{s.name}.jpg {row}\n" for s, row in zip(shots, rows, strict=True)))


def earth_centred(frame: WorldFrame, world_m: np.ndarray) -> np.ndarray:
    """World (n, 3) -> Earth-centred (n, 3), CGCS2000. [m]"""
    lat, lon, height = frame.geodetic_from_world(world_m)
    to_ecef = pyproj.Transformer.from_crs("EPSG:4480", "EPSG:4479", always_xy=True)
    return np.stack(to_ecef.transform(np.degrees(lon), np.degrees(lat), height), axis=1)


def _readme(source: Source, shots: list[Shot], sightings: list[Sighting]) -> str:
    files = (
        (
            "images/",
            "8 位 JPEG，同一增益；EXIF 仅含焦距与像元尺寸",
            "8-bit JPEG, one gain; EXIF holds focal length, pixel size",
        ),
        (
            "sparse/0/",
            "文本模型:解算航迹与安置给出位姿,点为靶标测量坐标",
            "text model: poses by trajectory and mounting, surveyed points",
        ),
        ("places_enu.txt", "影像投影中心,世界坐标系", "projection centres, world frame"),
        ("places_ecef.txt", "同上,地心地固坐标", "the same, Earth-centred"),
        ("places_wgs84.txt", "同上,纬度、经度、大地高", "the same: latitude, longitude, ellipsoidal height"),
    )
    notes = f"""{world_frame(source)}

像素:影像左上角为 (0, 0),首像素中心为 (0.5, 0.5),与 COLMAP 相同。
Pixels: the image's top left corner is (0, 0), the first pixel's centre (0.5, 0.5), as in COLMAP itself. Camera: FULL_OPENCV,
fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 with k4 = k5 = k6 = 0. Poses of a rolling shutter hold at the middle row."""
    commands = """colmap model_aligner --input_path MODEL --output_path OUT --ref_images_path places_enu.txt \\
    --ref_is_gps 0 --alignment_type custom --alignment_max_error 0.2
colmap model_aligner --input_path MODEL --output_path OUT --ref_images_path places_wgs84.txt \\
    --ref_is_gps 1 --alignment_type enu --alignment_max_error 0.2"""
    summary = (
        f"{len(shots)} images, {len({s.target for s in sightings})} surveyed targets, {len(sightings)} observations"
    )
    return page(source, "COLMAP", summary, files, notes, commands)
