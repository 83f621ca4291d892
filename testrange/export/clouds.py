"""Point clouds as PLY and PCD, one of each a strip; and image-cloud pairs for LiDAR-camera calibration (`pairs`).

Coordinates are of the world frame (east, north, up at the site's origin), so that no tool loses digits in single precision.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from campaign.flight.las import Returns
from campaign.formats.text import write_text
from campaign.progress import Report
from campaign.writing.atomic import complete_file
from evaluator.model import SortieData
from testrange.export.pairs import SECONDS, write_pairs
from testrange.export.readme import page, world_frame
from testrange.export.source import Source

# name -> type in PLY, NumPy type; PCD holds x y z in single precision, as PCL's points do.
PLY_FIELDS = (
    ("x", "<f8"),
    ("y", "<f8"),
    ("z", "<f8"),
    ("intensity", "<f4"),
    ("reflectance", "<f4"),
    ("gps_time", "<f8"),
)
PCD_FIELDS = tuple((name, "<f4" if name in "xyz" else kind) for name, kind in PLY_FIELDS)
_PLY_TYPES = {"<f4": "float", "<f8": "double"}


def export(source: Source, out: Path, progress: Report) -> None:
    """Writes clouds/sNN_lNN.{ply,pcd}, pairs/ where there are images, and README.md into `out`."""
    strips = source.strips()
    counts = {}
    for done, (sortie, strip) in enumerate(strips):
        progress("point cloud", done, len(strips))
        name = f"s{sortie.folder.number:02d}_l{strip:02d}"
        counts[name] = write_strip(source, sortie, strip, out / "clouds" / name)
    progress("point cloud", len(strips), len(strips))
    pairs = write_pairs(source, out / "pairs", progress)
    write_text(out / "README.md", _readme(source, counts, pairs))


def write_strip(source: Source, sortie: SortieData, strip: int, stem: Path) -> int:
    """One strip as PLY and PCD; returns the number of points. Memory does not grow with the strip."""
    bodies = [stem.with_suffix(f".{kind}.body") for kind in ("ply", "pcd")]
    stem.parent.mkdir(parents=True, exist_ok=True)
    count = 0
    with bodies[0].open("wb") as ply, bodies[1].open("wb") as pcd:
        for rows, world in source.points(sortie, strip):
            for file, fields in ((ply, PLY_FIELDS), (pcd, PCD_FIELDS)):
                file.write(_table(rows, world, fields).tobytes())
            count += len(rows.gps_time_s)
    comment = f"{source.data.manifest.campaign} sortie {sortie.folder.number} strip {strip}"
    headers: tuple[Callable[[int, str], bytes], ...] = (ply_header, pcd_header)
    for body, header in zip(bodies, headers):
        with complete_file(body.with_suffix("")) as work, work.open("wb") as whole, body.open("rb") as part:
            whole.write(header(count, comment))
            shutil.copyfileobj(part, whole, 1 << 20)
        body.unlink()
    return count


def _table(rows: Returns, world_m: np.ndarray, fields: tuple[tuple[str, str], ...]) -> np.ndarray:
    table = np.empty(len(world_m), dtype=list(fields))
    table["x"], table["y"], table["z"] = world_m.T
    table["intensity"], table["reflectance"] = rows.intensity, rows.reflectance_db
    table["gps_time"] = rows.gps_time_s
    return table


def ply_header(count: int, comment: str, fields: tuple[tuple[str, str], ...] = PLY_FIELDS) -> bytes:
    """PLY 1.0, binary, little endian."""
    lines = ["ply", "format binary_little_endian 1.0", f"comment {comment}"]
    lines += ["comment x y z in metres, world frame; reflectance in dB; gps_time adjusted standard GPS time [s]"]
    lines += [
        f"element vertex {count}",
        *(f"property {_PLY_TYPES[kind]} {name}" for name, kind in fields),
        "end_header",
    ]
    return "\n".join(lines).encode() + b"\n"


def pcd_header(count: int, comment: str) -> bytes:
    """PCD 0.7, binary."""
    lines = [
        f"# {comment}; x y z in metres, world frame; reflectance in dB; gps_time adjusted standard GPS time [s]",
        "VERSION 0.7",
        "FIELDS " + " ".join(name for name, _ in PCD_FIELDS),
        "SIZE " + " ".join(kind[-1] for _, kind in PCD_FIELDS),
        "TYPE " + " ".join("F" for _ in PCD_FIELDS),
        "COUNT " + " ".join("1" for _ in PCD_FIELDS),
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA binary",
    ]
    return "\n".join(lines).encode() + b"\n"


def _readme(source: Source, counts: dict[str, int], pairs: int) -> str:
    files = [(f"clouds/{name}.ply, .pcd", f"{count} 点", f"{count} points") for name, count in counts.items()]
    if pairs:
        files.append(("pairs/", f"{pairs} 组影像与点云", f"{pairs} pairs of an image and points"))
    notes = f"""{world_frame(source)}

Fields: `x y z` (double in PLY, float in PCD), `intensity` as in the LAS file, `reflectance` [dB], 0 dB is
100 % by the device's own scale (NaN: not recorded), `gps_time` adjusted standard GPS time [s].

`pairs/` is what direct_visual_lidar_calibration reads after its own preprocessing: `NAME.png`; `NAME.ply`
with x y z intensity (float) in the LiDAR's axes at the instant of the exposure, points of {SECONDS:g} s
before and after moved there along the trajectory, intensity the rank from 0 to 1; `calib.json` with the
camera (plumb_bob: fx fy cx cy, k1 k2 p1 p2 k3; here the first pixel's centre is (0, 0)) and the first guess
`init_T_lidar_camera`, x y z qx qy qz qw with p_lidar = T p_camera. `pairs.csv` lists times and numbers of
points."""
    return page(source, "PLY, PCD, PNG", f"{len(counts)} strips", files, notes)
