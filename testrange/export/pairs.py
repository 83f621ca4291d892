"""Image and the points of the seconds around it, in the LiDAR's axes at that instant, with camera and first guess.

The folder is what direct_visual_lidar_calibration reads after its own preprocessing: NAME.png, NAME.ply, calib.json.
"""

import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from campaign.formats.text import write_rows, write_text
from campaign.progress import Report
from evaluator.camera_model import project
from evaluator.frames import body_pose
from evaluator.model import Mounting, SortieData
from testrange.export.pictures import eight_bit, png, read_shot, tone_curve, write_bytes
from testrange.export.source import Shot, Source

SECONDS = 5.0  # before and after the exposure
MARGIN = 0.05  # of the image's size, beyond its edge
MAX_POINTS = 4_000_000  # of a pair; more are thinned evenly


def write_pairs(source: Source, out: Path, progress: Report) -> int:
    """Writes a pair for every image whose strip saw the same ground; returns how many. Needs a rig, a camera and images."""
    camera, lidar = source.body_from_camera, source.body_from_lidar
    if camera is None or lidar is None or source.data.camera is None:
        return 0
    if not any(s.exposures and s.trajectory is not None for s in source.data.sorties):
        return 0
    shots = source.shots()
    curve = tone_curve(source, shots)
    rows: list[tuple[object, ...]] = []
    done = 0
    progress("pairs", 0, len(shots))
    for sortie, strip in source.strips():
        own = [s for s in shots if s.sortie is sortie and s.exposure.strip == strip]
        for shot, (points, strength) in zip(own, _points_around(source, sortie, strip, own, lidar)):
            done += 1
            if len(points):
                write_bytes(out / f"{shot.name}.png", png(eight_bit(read_shot(source, shot), curve)))
                _write_ply(out / f"{shot.name}.ply", points, strength)
                rows.append((shot.name, sortie.folder.number, strip, shot.gps_time_s, SECONDS, len(points)))
            progress("pairs", done, len(shots))
    if rows:
        header = ["image", "sortie", "strip", "gps_time_s", "seconds", "points"]
        write_rows(out / "pairs.csv", header, rows)
        write_text(out / "calib.json", calibration(source, camera, lidar, [str(r[0]) for r in rows]))
    progress("pairs", len(shots), len(shots))
    return len(rows)


def calibration(source: Source, camera: Mounting, lidar: Mounting, names: list[str]) -> str:
    """calib.json: camera, names of the pairs, first guess of the LiDAR-camera transform."""
    lens = source.lens_or_nominal
    rotation = lidar.rotation.T @ camera.rotation
    translation = lidar.rotation.T @ (camera.lever_arm_m - lidar.lever_arm_m)
    guess = [*translation.tolist(), *Rotation.from_matrix(rotation).as_quat(canonical=True).tolist()]
    content = {
        "camera": {
            "camera_model": "plumb_bob",
            "distortion_coeffs": [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3],
            "intrinsics": [lens.fx_px, lens.fy_px, lens.cx_px - 0.5, lens.cy_px - 0.5],
        },
        "meta": {
            "bag_names": names,
            "camera_info_topic": "/camera/camera_info",
            "data_path": source.data.manifest.campaign,
            "image_topic": "/camera/image/compressed",
            "intensity_channel": "intensity",
            "points_topic": "/lidar/points",
        },
        "results": {"init_T_lidar_camera": guess},
    }
    return json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n"


def _points_around(
    source: Source, sortie: SortieData, strip: int, shots: list[Shot], lidar: Mounting
) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each image: (n, 3) points in the LiDAR's axes at its instant, and their strength for ranking. The strip is read once."""
    parts: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in shots]
    if shots:
        for rows, world in source.points(sortie, strip):
            strength = np.where(np.isfinite(rows.reflectance_db), rows.reflectance_db, rows.amplitude)
            for shot, found in zip(shots, parts):
                near = np.abs(rows.gps_time_s - source.lidar_clock_s - shot.gps_time_s) <= SECONDS
                if near.any():
                    here = world[near]
                    kept = _in_picture(source, shot, here)
                    found.append((_in_lidar(source, shot, here[kept], lidar), strength[near][kept]))
    return [_joined(found) for found in parts]


def _joined(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    if not parts:
        return np.zeros((0, 3)), np.zeros(0)
    points, strength = np.concatenate([p for p, _ in parts]), np.concatenate([s for _, s in parts])
    step = -(-len(points) // MAX_POINTS)
    return points[::step], strength[::step]


def _in_picture(source: Source, shot: Shot, world_m: np.ndarray) -> np.ndarray:
    """(n,) whether a point falls into the image or its margin."""
    uv = project(source.lens_or_nominal, (world_m - shot.centre_world_m) @ shot.world_from_camera)
    size = np.array([source.camera.width_px, source.camera.height_px], dtype=np.float64)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.all((uv > -MARGIN * size) & (uv < (1.0 + MARGIN) * size), axis=1))


def _in_lidar(source: Source, shot: Shot, world_m: np.ndarray, lidar: Mounting) -> np.ndarray:
    """World points (n, 3) in the LiDAR's axes at the exposure. [m]"""
    trajectory = shot.sortie.trajectory
    assert trajectory is not None  # a shot has a pose
    position, world_from_body = (a[0] for a in body_pose(trajectory, np.array([shot.gps_time_s]), source.frame))
    return np.asarray(((world_m - position) @ world_from_body - lidar.lever_arm_m) @ lidar.rotation)


def _write_ply(path: Path, points_m: np.ndarray, strength: np.ndarray) -> None:
    """x y z intensity in single precision; intensity is the rank of the strength, 0 to 1, as that tool's preprocessing gives."""
    rank = np.empty(len(strength), np.float32)
    rank[np.argsort(strength, kind="stable")] = (np.arange(len(strength)) + 0.5) / len(strength)
    table = np.column_stack([points_m, rank]).astype("<f4")
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "intensity"))
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(table)}\n{names}end_header\n"
    write_bytes(path, header.encode() + table.tobytes())
