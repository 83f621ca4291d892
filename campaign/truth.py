"""truth/: what only a simulated campaign knows. Written by the simulator; in the evaluator only `score` opens it.

truth/truth.json      Truth below, and truth/'s own files with SHA-256
truth/campaign.toml   the configuration as run
truth/trajectory.npz  no pickle: the true Trajectory fields of every sortie, prefixed sNN_
truth/marks.csv       target, image, u_px, v_px, visible: true pixel of every mark's centre in every image
truth/scene.ply         the true surfaces, world frame
truth/returns_SS_LL.npz   per return of sortie SS strip LL: range_m, normal, target index, face
"""

import shutil
import tempfile
import zipfile
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Self

import numpy as np
from pydantic import Field

from campaign.config import Lens, Model, Vector3
from campaign.errors import CampaignError
from campaign.flight.trajectory import Trajectory
from campaign.formats.text import (
    Parse,
    identifier,
    inner_path,
    number,
    one_of,
    read_model,
    read_rows,
    write_model,
    write_rows,
)
from campaign.manifest import TRUTH, ManifestFile, compare_files, sha256, walk
from campaign.writing.atomic import complete_file

MAX_NPZ_BYTES = 4_000_000_000


class TrueMounting(Model):
    """body_from_sensor: rotation (row major, 3 x 3) and lever arm."""

    rotation: tuple[Vector3, Vector3, Vector3]
    lever_arm_m: Vector3
    boresight_deg: Vector3 = Field(description="roll pitch yaw of dR in: body_from_sensor = dR * nominal rotation")
    lever_arm_error_m: Vector3 = Field(description="true minus nominal lever arm, body axes")


class TrueTarget(Model):
    id: str
    kind: str
    mark_world_m: Vector3 = Field(description="panel: centre of the top face; frustum: centre of the mark")
    vertex_world_m: Vector3 | None = None
    band_reflectance: tuple[float, ...] | None = Field(None, description="panels: over each camera band")
    laser_reflectance: float | None = None


class TrueBench(Model):
    """The benches (8.2, 9.2). None: that bench was not simulated."""

    lens: Lens | None = Field(None, description="interior orientation at the chessboard's focus setting")
    focus_distance_m: float | None = None
    drift_percent_per_h: float | None = Field(
        None,
        description="change of the lamp's output over the stability series: slope of the straight line through it, "
        "relative to its mean, without the image-to-image noise",
    )


class TrueRanging(Model):
    """The LiDAR's range errors in the form of (13): true = measured + K2 + R2 measured."""

    additive_constant_m: float
    multiplication_constant: float


class Truth(Model):
    seed: int
    camera: TrueMounting
    lidar: TrueMounting
    lens: Lens
    camera_clock_s: float
    lidar_clock_s: float
    range_offset_m: float
    range_scale: float
    lidar_gain: float
    camera_gain: float
    targets: tuple[TrueTarget, ...]
    bench: TrueBench | None = None
    ranging: TrueRanging | None = None
    files: tuple[ManifestFile, ...] = ()


@dataclass(frozen=True, kw_only=True)
class TrueReturns:
    """Per return of one strip, in the order of its LAS rows."""

    range_m: np.ndarray  # (n,) float64 geometric range to the first surface of the beam's axis
    normal_world: np.ndarray  # (n, 3) float32
    target: np.ndarray  # (n,) int32 index into Truth.targets, -1 ground
    face: np.ndarray  # (n,) int8: frustum face 0-3 inner, 4-7 outer, 8 plate, 9 mark, -1 other


@dataclass(frozen=True, kw_only=True)
class TrueMark:
    """True pixel of one mark's centre in one image; the image's top left corner is (0, 0)."""

    target: str
    image: str  # path inside the campaign folder
    u_px: float
    v_px: float
    visible: bool


MARK_COLUMNS: dict[str, Parse] = {
    "target": identifier,
    "image": inner_path,
    "u_px": number,
    "v_px": number,
    "visible": one_of("0", "1"),
}


def write_truth(root: Path, truth: Truth) -> None:
    """Writes truth.json of the campaign folder `root` last, with the checksums of everything else under truth/."""
    files = tuple(
        ManifestFile(path=name, bytes=(root / name).stat().st_size, sha256=sha256(root / name)) for name in _files(root)
    )
    write_model(root / TRUTH / "truth.json", truth.model_copy(update={"files": files}))


def read_truth(root: Path) -> Truth:
    """truth.json of the campaign folder `root`."""
    if not (root / TRUTH / "truth.json").is_file():
        raise CampaignError("has no truth", where=str(root), remedy="only a simulated campaign can be scored")
    return read_model(root / TRUTH / "truth.json", Truth)


def verify_truth(root: Path, truth: Truth) -> list[str]:
    """Every missing, changed or surplus file under truth/, one line each."""
    return compare_files(root, truth.files, _files(root))


_COLUMNS: dict[str, tuple[str, tuple[int, ...]]] = {
    "range_m": ("<f8", ()),
    "normal_world": ("<f4", (3,)),
    "target": ("<i4", ()),
    "face": ("|i1", ()),
}


class TrueReturnsWriter:
    """Streams one strip's returns into .npz: each column grows in a nameless file, so memory does not grow with the strip.

    A context manager; the file appears when the block ends without an error. `count`: returns written so far.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._columns = {name: tempfile.TemporaryFile(dir=path.parent) for name in _COLUMNS}  # noqa: SIM115
        self.count = 0

    def write(self, returns: TrueReturns) -> None:
        """Append rows."""
        for name, (kind, _) in _COLUMNS.items():
            self._columns[name].write(np.ascontiguousarray(getattr(returns, name), kind).data)
        self.count += len(returns.range_m)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._join()
        finally:
            for column in self._columns.values():
                column.close()

    def _join(self) -> None:
        """The columns as members of one archive; as `numpy.savez`, without any time of day."""
        with complete_file(self._path) as work, zipfile.ZipFile(work, "w", zipfile.ZIP_STORED) as archive:
            for name, (kind, tail) in _COLUMNS.items():
                column = self._columns[name]
                column.seek(0)
                with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                    header = {"descr": kind, "fortran_order": False, "shape": (self.count, *tail)}
                    np.lib.format.write_array_header_1_0(member, header)
                    shutil.copyfileobj(column, member, 1 << 20)


def write_true_returns(path: Path, returns: TrueReturns) -> None:
    """One strip's returns as .npz."""
    with TrueReturnsWriter(path) as writer:
        writer.write(returns)


def read_true_returns(path: Path) -> TrueReturns:
    """Raises CampaignError: not readable, an array missing, unequal lengths."""
    arrays = _read_npz(path)
    missing = [f.name for f in fields(TrueReturns) if f.name not in arrays]
    if missing or len({len(a) for a in arrays.values()}) != 1:
        raise CampaignError("is no table of true returns", where=str(path), got=f"no {missing[0]}" if missing else None)
    return TrueReturns(**{f.name: arrays[f.name] for f in fields(TrueReturns)})


def write_true_trajectories(path: Path, sorties: dict[int, Trajectory]) -> None:
    """trajectory.npz: the fields of every sortie, prefixed sNN_."""
    _write_npz(path, {f"s{n:02d}_{f.name}": getattr(t, f.name) for n, t in sorties.items() for f in fields(Trajectory)})


def read_true_trajectories(path: Path) -> dict[int, Trajectory]:
    """Raises CampaignError: not readable, a field missing. Standard deviations, which the truth has none of, may be absent: NaN."""
    arrays = _read_npz(path)
    sorties: dict[int, dict[str, np.ndarray]] = {}
    for name, array in arrays.items():
        prefix, _, field = name.partition("_")
        if not prefix[1:].isdigit():
            raise CampaignError("an array has no sortie in its name", where=str(path), got=name, expected="sNN_field")
        sorties.setdefault(int(prefix[1:]), {})[field] = array
    try:
        return {number: Trajectory(**(_no_std(columns) | columns)) for number, columns in sorties.items()}
    except TypeError as error:
        raise CampaignError("is no true trajectory", where=str(path), got=error) from None


def _no_std(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return dict.fromkeys(
        ("position_std_m", "attitude_std_rad"), np.full((len(next(iter(columns.values()))), 3), np.nan)
    )


def write_marks(path: Path, marks: list[TrueMark]) -> None:
    """marks.csv."""
    write_rows(path, list(MARK_COLUMNS), ([m.target, m.image, m.u_px, m.v_px, int(m.visible)] for m in marks))


def read_marks(path: Path) -> list[TrueMark]:
    """Raises CampaignError naming row and column."""
    return [TrueMark(**(row | {"visible": row["visible"] == "1"})) for row in read_rows(path, MARK_COLUMNS)]


def _files(root: Path) -> list[str]:
    return sorted(name for name in walk(root, root / TRUTH) if name != f"{TRUTH}/truth.json")


def _write_npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Not compressed: NumPy's zip entries carry no time of day, so the same arrays give the same bytes."""
    with complete_file(path) as work:
        np.savez(work, allow_pickle=False, **arrays)


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    try:
        if path.stat().st_size > MAX_NPZ_BYTES:
            raise CampaignError("too large", where=str(path), expected=f"at most {MAX_NPZ_BYTES} bytes")
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > 2 * path.stat().st_size + 1_000_000:
                raise CampaignError("unpacks to more than it should", where=str(path))
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise CampaignError("no such file", where=str(path)) from None
    except (OSError, ValueError, zipfile.BadZipFile, EOFError, KeyError) as error:
        raise CampaignError(
            "cannot be read", where=str(path), got=str(error).splitlines()[0] if str(error) else None
        ) from None
