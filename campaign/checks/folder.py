"""Every problem of a campaign folder, or of a configuration, at once. Formats and cross references; no indicator is computed.

bench/ and ranging/ are `check_bench`'s.
"""

import contextlib
import datetime
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from campaign.checks.bench import check_bench, check_ranging
from campaign.checks.collector import Collector, Problem
from campaign.errors import ConfigError
from campaign.flight.images import check_image
from campaign.flight.las import StripReader
from campaign.flight.records import (
    Exposure,
    FlightPlan,
    read_camera_observations,
    read_environment,
    read_exposures,
    read_lidar_observations,
    read_plan,
)
from campaign.flight.trajectory import Trajectory, beijing_time, misplaced, read_trajectory
from campaign.folder import CampaignFolder, SortieFolder
from campaign.load import load_config
from campaign.manifest import Manifest, read_manifest, special_files, verify_files
from campaign.sensors import CameraSheet, LidarSheet, read_camera, read_lidar, read_rig
from campaign.survey import crs_wkt, far_targets, read_spectra, read_targets
from campaign.truth import read_truth, verify_truth

_STRIP = re.compile(r"strip_(\d{1,4})\.(las|laz)")


def check_campaign(root: Path, *, checksums: bool = True, truth: bool = True) -> list[Problem]:
    """Validates layout, every file's format and cross references (images named in exposures exist and have the sheet's size,
    packets lie inside .wdp, spectra cover the panels ...). An empty list: sound.

    Without `checksums` the files' sizes are compared with the manifest, not their contents. Without `truth` nothing under
    truth/ is opened, so that an evaluation does not depend on it.
    """
    check = _Check(CampaignFolder(Path(root)))
    manifest = check.read(check.folder.manifest, lambda _: read_manifest(check.folder.root))
    if manifest is None and not check.folder.root.is_dir():
        return check.problems
    if manifest is not None:
        check.manifest(manifest, checksums)
    check.plain_files()
    sorties = check.folder.sorties()
    outdoor = _outdoor(check.folder)
    check.survey(manifest, expected=outdoor)
    plan = check.read_part(check.folder.plan, read_plan, expected=outdoor)
    camera = check.read_part(check.folder.camera, read_camera, expected=outdoor)
    lidar = check.read_part(check.folder.lidar, read_lidar, expected=outdoor)
    check.read_part(check.folder.rig, read_rig, expected=outdoor)
    check_bench(check)
    check_ranging(check, None if manifest is None else manifest.gps_week)
    if not sorties and outdoor:
        check.add("warning", check.folder.root / "sorties", "no sortie; nothing was flown")
    for sortie in sorties:
        _check_sortie(check, sortie, manifest, plan, camera, lidar)
    if truth and check.folder.truth.exists():
        true = check.read(check.folder.truth / "truth.json", lambda _: read_truth(check.folder.root))
        if true is not None and checksums:
            for line in verify_truth(check.folder.root, true):
                check.file_line(line)
    return check.problems


def _outdoor(folder: CampaignFolder) -> bool:
    """Whether the campaign is one of a flight, as far as it goes: not one of benches or a ranging line alone."""
    alone = (folder.root / "bench").is_dir() or folder.ranging.is_dir()
    return not alone or bool(folder.sorties()) or folder.targets.parent.exists()


def check_config(path: Path | str, overrides: Sequence[str] = ()) -> list[Problem]:
    """Every problem of a configuration; an empty list: it loads."""
    try:
        load_config(path, overrides)
    except ConfigError as error:
        return [Problem(severity="error", where=str(path), message=line) for line in error.problems]
    return []


@dataclass(kw_only=False)
class _Check(Collector):
    """What more than one part of the check needs."""

    target_ids: set[str] = field(default_factory=set)

    def file_line(self, line: str) -> None:
        """One line of the manifest's comparison."""
        where, _, message = line.partition(": ")
        severity = "warning" if message == "not in the manifest" else "error"
        self.problems.append(Problem(severity=severity, where=where, message=message))

    def plain_files(self) -> None:
        """Whatever is neither a plain file nor a folder: a link may lead out, a pipe would never end."""
        for path in special_files(self.folder.root):
            self.add(
                "error", path, "is no plain file; expected a campaign folder that holds its files itself; copy it in"
            )
        bench = self.folder.root / "bench"
        places = (bench, self.folder.sphere_stability, self.folder.sphere_repeatability, self.folder.chessboard)
        for path in (*places, self.folder.ranging, self.folder.ranging / "scans"):
            if path.is_file() and not path.is_symlink():
                self.add("error", path, "is a file; expected a folder")

    def manifest(self, manifest: Manifest, checksums: bool) -> None:
        for line in verify_files(self.folder.root, manifest, checksums=checksums):
            self.file_line(line)
        with self.catching(self.folder.manifest):
            crs_wkt(manifest.projection_epsg, manifest.height_epsg, "WKT2_2019")
        try:
            if datetime.datetime.fromisoformat(manifest.start_time).tzinfo is None:
                raise ValueError
        except ValueError:
            self.add(
                "error", self.folder.manifest, f"start_time: got {manifest.start_time!r}; expected ISO 8601 with offset"
            )

    def survey(self, manifest: Manifest | None, *, expected: bool) -> None:
        targets = self.read_part(self.folder.targets, read_targets, expected=expected) or []
        if manifest is not None:
            with self.catching(self.folder.targets):
                for line in far_targets(
                    targets, manifest.latitude_deg, manifest.longitude_deg, manifest.projection_epsg
                ):
                    self.add("error", self.folder.targets, line)
        spectra = self.read_part(self.folder.spectra, read_spectra, expected=expected)
        self.target_ids = {t.id for t in targets}
        panels = [t.id for t in targets if t.kind == "panel"]
        if spectra is None:
            return
        for panel in panels:
            if panel not in spectra.panel_ids:
                self.add("error", self.folder.spectra, f"no spectrum of panel {panel}")
        for name in spectra.panel_ids:
            if targets and name not in panels:
                self.add("warning", self.folder.spectra, f"spectrum of {name}, which is no panel of the survey")


def _check_sortie(
    check: _Check,
    sortie: SortieFolder,
    manifest: Manifest | None,
    plan: FlightPlan | None,
    camera: CameraSheet | None,
    lidar: LidarSheet | None,
) -> None:
    week = None if manifest is None else manifest.gps_week
    trajectory = None
    if not sortie.trajectory_sbet.is_file():
        check.add("warning", sortie.trajectory_sbet, "missing; nothing of this sortie can be placed")
    elif week is not None:
        rms = sortie.trajectory_rms if sortie.trajectory_rms.is_file() else None
        if rms is None:
            check.add(
                "warning", sortie.trajectory_rms, "missing; the trajectory's accuracy is taken from the rig sheet"
            )
        trajectory = check.read(sortie.trajectory_sbet, lambda path: read_trajectory(path, rms, week))
    if trajectory is not None and manifest is not None:
        wrong = misplaced(trajectory, manifest.latitude_deg, manifest.longitude_deg)
        if wrong:
            check.add("error", sortie.trajectory_sbet, wrong)
        _check_date(check, sortie, trajectory, manifest)
    check.read_part(sortie.environment, read_environment)
    exposures = check.read_part(sortie.exposures, read_exposures) or []
    planned = None if plan is None else {s.strip for s in plan.strips if s.sortie == sortie.number}
    _check_images(check, sortie, exposures, trajectory, camera, planned)
    _check_strips(check, sortie, trajectory, lidar, planned, week)
    _check_observations(check, sortie, {e.image for e in exposures})


def _check_date(check: _Check, sortie: SortieFolder, trajectory: Trajectory, manifest: Manifest) -> None:
    with contextlib.suppress(ValueError):
        start = datetime.datetime.fromisoformat(manifest.start_time)
        if start.tzinfo is not None:
            local = start.astimezone(datetime.timezone(datetime.timedelta(hours=8))).replace(tzinfo=None)
            flown = beijing_time(trajectory.gps_time_s[:1])[0]
            if abs(flown - np.datetime64(local)) > np.timedelta64(2, "D"):
                check.add(
                    "warning",
                    sortie.trajectory_sbet,
                    f"begins at {flown}, more than two days from the manifest's start",
                )


def _outside(trajectory: Trajectory | None, first_s: float, last_s: float) -> str | None:
    if trajectory is None:
        return None
    start, end = float(trajectory.gps_time_s[0]), float(trajectory.gps_time_s[-1])
    if start <= first_s and last_s <= end:
        return None
    return f"time outside the trajectory; got {first_s:.3f} to {last_s:.3f}; expected within {start:.3f} to {end:.3f}"


def _check_images(
    check: _Check,
    sortie: SortieFolder,
    exposures: list[Exposure],
    trajectory: Trajectory | None,
    camera: CameraSheet | None,
    planned: set[int] | None,
) -> None:
    for exposure in exposures:
        path = sortie.images / exposure.image
        if not path.is_file():
            check.add("error", path, "named in exposures.csv, but missing")
        elif camera is not None:
            size = {"width_px": camera.width_px, "height_px": camera.height_px, "bands": len(camera.bands)}
            with check.catching(path):
                check_image(path, **size)
        problem = _outside(trajectory, exposure.gps_time_s, exposure.gps_time_s)
        if problem:
            check.add("error", sortie.exposures, f"{exposure.image}: {problem}")
        if planned is not None and exposure.strip not in planned:
            check.add("warning", sortie.exposures, f"{exposure.image}: strip {exposure.strip} is not in the plan")
    if sortie.images.is_dir():
        named = {e.image for e in exposures}
        for path in sorted(sortie.images.glob("*.tif")):
            if path.name not in named:
                check.add("warning", path, "not named in exposures.csv; it is not used")


def _check_strips(
    check: _Check,
    sortie: SortieFolder,
    trajectory: Trajectory | None,
    lidar: LidarSheet | None,
    planned: set[int] | None,
    week: int | None,
) -> None:
    files = sorted(sortie.lidar.iterdir()) if sortie.lidar.is_dir() else []
    strips = [(int(m.group(1)), path) for path in files if (m := _STRIP.fullmatch(path.name))]
    if not strips:
        check.add("warning", sortie.lidar, "no strip; what needs the LiDAR is reported as not measured")
    seen: dict[int, str] = {}
    for number, path in strips:
        if number in seen:
            check.add("error", path, f"the same strip as {seen[number]}; expected one file for each strip")
        seen.setdefault(number, path.name)
        if path.name != sortie.strip_las(number).name:
            expected = f"expected {sortie.strip_las(number).name}"
            check.add("error", path, f"the name of the strip's file is not read; {expected}; rename it")
        if not path.is_file():
            continue
        if planned is not None and number not in planned:
            check.add("warning", path, "a strip that is not in the plan")
        with check.catching(path):
            reader = StripReader(path, gps_week=week)
            if reader.point_count == 0:
                check.add("warning", path, "holds no point")
                continue
            if not reader.header.wkt:
                check.add("warning", path, "states no coordinate system; the manifest's is taken")
            times = reader.time_range()
            problem = _outside(trajectory, *times) if times else "records no time"
            if problem:
                check.add("error", path, problem)
            reader.check_packets()
            if lidar is not None and reader.sampling_ps and abs(reader.sampling_ps / 1000.0 - lidar.sampling_ns) > 1e-6:
                got = f"got {reader.sampling_ps / 1000.0:g} ns; expected {lidar.sampling_ns:g} by sensors/lidar.json"
                check.add("error", path, f"another sampling interval; {got}")
            twin = sortie.strip_points(number)
            if twin.exists() and StripReader(twin).point_count != reader.point_count:
                check.add("warning", twin, f"holds another number of points than {path.name}")


def _check_observations(check: _Check, sortie: SortieFolder, images: set[str]) -> None:
    if sortie.observations_camera.is_file():
        for seen in check.read(sortie.observations_camera, read_camera_observations) or []:
            if seen.target not in check.target_ids:
                check.add("error", sortie.observations_camera, f"target {seen.target} is not in the survey")
            if seen.image not in images:
                check.add("error", sortie.observations_camera, f"image {seen.image} is not in exposures.csv")
    if sortie.observations_lidar.is_file():
        for hit in check.read(sortie.observations_lidar, read_lidar_observations) or []:
            if hit.target not in check.target_ids:
                check.add("error", sortie.observations_lidar, f"target {hit.target} is not in the survey")
