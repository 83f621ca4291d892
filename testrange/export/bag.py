"""One .mcap of a campaign with ROS 2 messages, which `ros2 bag`, Foxglove and rerun open. Needs the extra `mcap`.

Topics: /tf (world, body), /tf_static (mountings), /pose, /camera/image/compressed, /camera/camera_info, /lidar/points (one
cloud a second, world frame). Times are UTC (Unix). Streamed: memory does not grow with the flight.
"""

import heapq
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from campaign.errors import CampaignError
from campaign.formats.text import write_text
from campaign.progress import Report
from campaign.writing.atomic import readable_os_errors
from evaluator.frames import body_pose
from evaluator.model import Mounting, SortieData
from testrange.export import cdr
from testrange.export.pictures import eight_bit, jpeg, read_shot, tone_curve
from testrange.export.readme import page, world_frame
from testrange.export.source import Shot, Source

try:
    from mcap.writer import CompressionType, Writer
except ImportError:
    raise CampaignError(
        "the package mcap is not installed",
        where="export --to mcap",
        remedy=".venv/bin/python -m pip install mcap, or pip of whatever environment runs testrange",
    ) from None

POSE_RATE_HZ = 50.0
_UNIX_OF_GPS_EPOCH_S = 315_964_800
_CLOUD = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("reflectance", "<f4"), ("gps_time", "<f8")]
)
_TOPICS = {
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/pose": "geometry_msgs/msg/PoseStamped",
    "/camera/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/camera/camera_info": "sensor_msgs/msg/CameraInfo",
    "/lidar/points": "sensor_msgs/msg/PointCloud2",
}
_LATCHED = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n  deadline:\n    sec: 9223372036\n    nsec: 854775807\n"
    "  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  liveliness: 1\n  liveliness_lease_duration:\n"
    "    sec: 9223372036\n    nsec: 854775807\n  avoid_ros_namespace_conventions: false"
)
Message = tuple[int, int, str, bytes]  # time [ns], place among equals, topic, content


def export(source: Source, out: Path, progress: Report) -> None:
    """Writes CAMPAIGN.mcap and README.md into `out`."""
    name = f"{source.data.manifest.campaign}.mcap"
    write_bag(source, out / name, progress)
    files = [
        (name, "ROS 2 消息 (CDR):/tf、/pose、影像、每秒点云", "ROS 2 messages (CDR): " + " ".join(_TOPICS)),
    ]
    notes = f"""{world_frame(source)}

Times are UTC (Unix); `gps_time` of points is adjusted standard GPS time [s]. Frames: `world`, `body` (x
forward, y right, z down), `camera` (x right, y down, z forward), `lidar`. Points are in `world`, in single
precision, moved there along the trajectory. CameraInfo follows OpenCV: the first pixel's centre is (0, 0)."""
    write_text(out / "README.md", page(source, "mcap", "One file", files, notes, f"ros2 bag play {name}"))


def write_bag(source: Source, path: Path, progress: Report) -> None:
    """One .mcap file."""
    shots = source.shots() if source.data.camera is not None and _has_images(source) else []
    curve = tone_curve(source, shots) if shots else np.zeros(65_536, np.uint8)
    steps = len(shots) + sum(len(s.strips) for s in source.data.sorties)
    progress("mcap", 0, steps)
    with readable_os_errors(path), path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="testrange")
        schemas = {
            kind: writer.register_schema(kind, "ros2msg", cdr.DEFINITIONS[kind].encode()) for kind in set_order(_TOPICS)
        }
        channels = {
            topic: writer.register_channel(
                topic,
                "cdr",
                schemas[kind],
                {"offered_qos_profiles": _LATCHED if topic == "/tf_static" else ""},
            )
            for topic, kind in _TOPICS.items()
        }
        counts = dict.fromkeys(_TOPICS, 0)
        done = 0
        for sortie in source.data.sorties:
            own = [s for s in shots if s.sortie is sortie]
            streams = [_poses(source, sortie), _images(source, own, curve), _clouds(source, sortie)]
            for time_ns, _, topic, content in heapq.merge(*streams, key=lambda m: m[:2]):
                writer.add_message(channels[topic], time_ns, content, time_ns, counts[topic])
                counts[topic] += 1
                if topic == "/camera/camera_info":
                    done += 1
                    progress("mcap", done, steps)
        writer.finish()  # type: ignore[no-untyped-call]
    progress("mcap", steps, steps)


def set_order(topics: dict[str, str]) -> list[str]:
    """Each type once, in order of first use."""
    return list(dict.fromkeys(topics.values()))


def unix_ns(source: Source, gps_time_s: float) -> int:
    """Adjusted standard GPS time -> Unix time. [ns]"""
    whole = int(np.floor(gps_time_s))
    shift = 1_000_000_000 + _UNIX_OF_GPS_EPOCH_S - source.data.manifest.gps_minus_utc_s
    return (whole + shift) * 1_000_000_000 + round((gps_time_s - whole) * 1e9)


def _has_images(source: Source) -> bool:
    return source.data.rig is not None and any(s.exposures and s.trajectory is not None for s in source.data.sorties)


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    return np.asarray(Rotation.from_matrix(rotation).as_quat(canonical=True))


def _poses(source: Source, sortie: SortieData) -> Iterator[Message]:
    """Mountings first, then the body at POSE_RATE_HZ."""
    trajectory = sortie.trajectory
    if trajectory is None:
        return
    times = trajectory.gps_time_s
    start = unix_ns(source, float(times[0]))
    mountings: tuple[tuple[str, Mounting | None], ...] = (
        ("camera", source.body_from_camera),
        ("lidar", source.body_from_lidar),
    )
    for child, mounting in mountings:
        if mounting is not None:
            content = cdr.transform(start, "body", child, mounting.lever_arm_m, _quaternion(mounting.rotation))
            yield start, 0, "/tf_static", content
    step = max(1, round(1.0 / POSE_RATE_HZ / max(float(np.median(np.diff(times))), 1e-6))) if len(times) > 1 else 1
    for first in range(0, len(times), 10_000 * step):
        chosen = times[first : first + 10_000 * step : step]
        for time, place, rotation in zip(chosen, *body_pose(trajectory, chosen, source.frame)):
            ns, turn = unix_ns(source, float(time)), _quaternion(rotation)
            yield ns, 1, "/tf", cdr.transform(ns, "world", "body", place, turn)
            yield ns, 2, "/pose", cdr.pose(ns, "world", place, turn)


def _images(source: Source, shots: list[Shot], curve: np.ndarray) -> Iterator[Message]:
    lens = source.lens_or_nominal if shots else None
    for shot in sorted(shots, key=lambda s: s.gps_time_s):
        assert lens is not None
        ns = unix_ns(source, shot.gps_time_s)
        picture = jpeg(eight_bit(read_shot(source, shot), curve))
        yield ns, 3, "/camera/image/compressed", cdr.compressed_image(ns, "camera", picture)
        k = np.array([[lens.fx_px, 0.0, lens.cx_px - 0.5], [0.0, lens.fy_px, lens.cy_px - 0.5], [0.0, 0.0, 1.0]])
        size = (source.camera.width_px, source.camera.height_px)
        distortion = [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]
        yield ns, 4, "/camera/camera_info", cdr.camera_info(ns, "camera", size, k, distortion)


def _clouds(source: Source, sortie: SortieData) -> Iterator[Message]:
    """One cloud a whole second of each strip; a second that two pieces of a file share becomes one."""
    for strip in sortie.strips:
        held: list[np.ndarray] = []
        second = 0
        for rows, world in source.points(sortie, strip):
            time = rows.gps_time_s - source.lidar_clock_s
            table = np.empty(len(time), _CLOUD)
            table["x"], table["y"], table["z"] = world.T
            table["intensity"], table["reflectance"], table["gps_time"] = rows.intensity, rows.reflectance_db, time
            table = table[np.isfinite(time)]
            table = table[np.argsort(table["gps_time"], kind="stable")]
            whole = np.floor(table["gps_time"]).astype(np.int64)
            for part in np.split(table, np.flatnonzero(np.diff(whole)) + 1):
                if not len(part):
                    continue
                now = int(np.floor(part["gps_time"][0]))
                if held and now != second:
                    yield _cloud(source, held)
                    held = []
                second = now
                held.append(part)
        if held:
            yield _cloud(source, held)


def _cloud(source: Source, parts: list[np.ndarray]) -> Message:
    table = np.concatenate(parts)
    ns = unix_ns(source, float(table["gps_time"][0]))
    return ns, 5, "/lidar/points", cdr.point_cloud(ns, "world", table)
