"""OpenDroneMap: images/ with EXIF, gcp_list.txt, geo.txt.

One vertical system in the whole project: normal height (1985), of ground control, geo.txt and EXIF alike. OpenSfM, which ODM
runs, puts the centre of the first pixel at (0, 0): half a pixel is taken off here.
"""

from pathlib import Path

import numpy as np

from campaign.formats.text import write_text
from campaign.progress import Report
from testrange.export.observations import Sighting, find_sightings
from testrange.export.pictures import eight_bit, flight_exif, jpeg, read_shot, tone_curve, write_bytes
from testrange.export.readme import page
from testrange.export.source import Shot, Source


def export(source: Source, out: Path, progress: Report) -> None:
    """Writes images/, gcp_list.txt, geo.txt and README.md into `out`."""
    shots = source.shots()
    progress("tone", 0, 1)
    curve = tone_curve(source, shots)
    progress("tone", 1, 1)
    lat, lon, height = geographic(source, shots)
    for done, shot in enumerate(shots):
        progress("images", done, len(shots))
        exif = flight_exif(source, shot, float(lat[done]), float(lon[done]), float(height[done]))
        write_bytes(out / "images" / f"{shot.name}.jpg", jpeg(eight_bit(read_shot(source, shot), curve), exif))
    progress("images", len(shots), len(shots))
    sightings = find_sightings(source, shots, progress)
    write_text(out / "gcp_list.txt", gcp_list(source, sightings))
    write_text(out / "geo.txt", geo(source, shots))
    write_text(out / "README.md", _readme(source, shots, sightings))


def geographic(source: Source, shots: list[Shot]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Latitude, longitude [deg] and normal height [m] of the projection centres."""
    lat, lon, height = source.frame.geodetic_from_world(np.array([s.centre_world_m for s in shots]))
    return np.degrees(lat), np.degrees(lon), height - source.data.manifest.height_anomaly_m


def gcp_list(source: Source, sightings: list[Sighting]) -> str:
    """EPSG header, then: easting northing height column row image target."""
    targets = {t.id: t for t in source.data.targets}
    lines = [f"EPSG:{source.data.manifest.projection_epsg}"]
    for s in sorted(sightings, key=lambda s: (s.target, s.shot.name)):
        t = targets[s.target]
        u, v = s.uv_px - 0.5
        lines.append(
            f"{t.easting_m:.4f} {t.northing_m:.4f} {t.height_m:.4f} {u:.3f} {v:.3f} {s.shot.name}.jpg {s.target}"
        )
    return "\n".join(lines) + "\n"


def geo(source: Source, shots: list[Shot]) -> str:
    """EPSG header, then: image longitude latitude height yaw pitch roll horizontal and vertical accuracy."""
    lat, lon, height = geographic(source, shots)
    lines = ["EPSG:4326"]
    for i, shot in enumerate(shots):
        roll, pitch, heading = source.attitude_deg(shot)
        line = f"{shot.name}.jpg {lon[i]:.11f} {lat[i]:.11f} {height[i]:.4f} {heading:.5f} {pitch:.5f} {roll:.5f}"
        std = shot.position_std_m
        if np.isfinite(std).all():
            line += f" {max(float(np.hypot(std[0], std[1])), 1e-3):.4f} {max(float(std[2]), 1e-3):.4f}"
        lines.append(line)
    return "\n".join(lines) + "\n"


def _readme(source: Source, shots: list[Shot], sightings: list[Sighting]) -> str:
    m = source.data.manifest
    files = (
        (
            "images/",
            "8 位 JPEG;EXIF 为北京时间 (+08:00),GPS 时间为 UTC",
            "8-bit JPEG; EXIF in Beijing time, GPS time stamp in UTC",
        ),
        (
            "gcp_list.txt",
            "像控点:东 北 高 列 行 影像 靶标",
            f"EPSG:{m.projection_epsg}: easting northing height column row image target",
        ),
        (
            "geo.txt",
            "影像 经度 纬度 高 航向 俯仰 横滚 精度",
            "image longitude latitude height yaw pitch roll accuracies",
        ),
    )
    notes = f"""高程均为正常高 (1985 国家高程基准):大地高减 {m.height_anomaly_m!r} m。
Heights are normal heights (1985) in all three files: ellipsoidal height minus {m.height_anomaly_m!r} m.
Longitude and latitude are of CGCS2000, written under EPSG:4326 without a change of datum, and of the
camera's projection centre.

Yaw is the heading of the image's top edge from true north, pitch 0 looks down [deg]. Accuracies [m] are one
standard deviation of the navigation, horizontal the root of the sum of north and east squared. Column and
row count from the centre of the first pixel, (0, 0), as OpenSfM does: half a pixel less than in the
campaign folder."""
    commands = """docker run -ti --rm -v "$PWD":/datasets/code opendronemap/odm --project-path /datasets code"""
    summary = f"{len(shots)} images, {len({s.target for s in sightings})} control points, {len(sightings)} observations"
    return page(source, "OpenDroneMap", summary, files, notes, commands)
