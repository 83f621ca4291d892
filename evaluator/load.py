"""Read a campaign folder, part by part. A part that is missing or broken never stops the rest: it is named in `problems`."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from campaign.benches.bench import read_board, read_board_log, read_room, read_sphere_log
from campaign.benches.ranging import line_path, read_line, read_readings, readings_path, scan_paths
from campaign.errors import CampaignError, TestrangeError
from campaign.flight.records import read_environment, read_exposures, read_plan
from campaign.flight.trajectory import Trajectory, misplaced, read_trajectory
from campaign.folder import CampaignFolder, SortieFolder
from campaign.manifest import read_manifest
from campaign.sensors import read_camera, read_lidar, read_rig
from campaign.survey import far_targets, read_spectra, read_targets
from evaluator.model import BenchData, CampaignData, RangingData, SortieData
from evaluator.observe.picks import read_picked_points

T = TypeVar("T")
U = TypeVar("U")


def load_campaign(root: Path) -> CampaignData:
    """Everything but images and returns, which are streamed later.

    Raises
    ------
    CampaignError
        `root` is no campaign folder: no readable manifest.json.
    """
    folder = CampaignFolder(root)
    if not root.is_dir():
        raise CampaignError("no such folder", where=str(root), expected="a campaign folder with manifest.json")
    manifest = read_manifest(root)
    problems: list[str] = []

    def part(path: Path, read: Callable[[], T]) -> T | None:
        if not path.exists():
            return None
        try:
            if not folder.held(path).is_file():
                raise CampaignError("is no file", where=str(path))
            return read()
        except TestrangeError as error:
            problems.append(in_folder(error, root))
            return None

    def log(place: Path, read: Callable[[Path], list[U]]) -> tuple[U, ...]:
        path = place / "log.csv"
        return tuple(part(path, lambda: read(path)) or ())

    def trajectory(place: SortieFolder) -> Trajectory:
        rms = place.trajectory_rms if place.trajectory_rms.is_file() else None
        found = read_trajectory(place.trajectory_sbet, rms, manifest.gps_week)
        wrong = misplaced(found, manifest.latitude_deg, manifest.longitude_deg)
        if wrong:
            raise CampaignError(wrong, where=str(place.trajectory_sbet))
        return found

    def picked_points(place: SortieFolder, strips: tuple[int, ...]) -> dict[tuple[int, str], np.ndarray]:
        ids = [t.id for t in targets if t.id not in beyond]
        found, wrong = part(place.observations_lidar, lambda: read_picked_points(place, strips, ids)) or ({}, [])
        problems.extend(in_folder(error, root) for error in wrong)
        return found

    def sortie(place: SortieFolder) -> SortieData:
        strips = _strips(place)
        return SortieData(
            folder=place,
            trajectory=part(place.trajectory_sbet, lambda: trajectory(place)),
            exposures=tuple(part(place.exposures, lambda: read_exposures(place.exposures)) or ()),
            environment=tuple(part(place.environment, lambda: read_environment(place.environment)) or ()),
            strips=strips,
            picked_points=picked_points(place, strips),
        )

    targets = part(folder.targets, lambda: read_targets(folder.targets)) or []
    far = far_targets(targets, manifest.latitude_deg, manifest.longitude_deg, manifest.projection_epsg)
    problems += [f"survey/targets.csv: {line}" for line in far]
    beyond = {line.split(":", 1)[0] for line in far}
    return CampaignData(
        folder=folder,
        manifest=manifest,
        plan=part(folder.plan, lambda: read_plan(folder.plan)),
        targets=tuple(t for t in targets if t.id not in beyond),
        spectra=part(folder.spectra, lambda: read_spectra(folder.spectra)),
        camera=part(folder.camera, lambda: read_camera(folder.camera)),
        lidar=part(folder.lidar, lambda: read_lidar(folder.lidar)),
        rig=part(folder.rig, lambda: read_rig(folder.rig)),
        sorties=tuple(sortie(place) for place in folder.sorties()),
        bench=BenchData(
            room=part(folder.room, lambda: read_room(folder.room)),
            stability=log(folder.sphere_stability, read_sphere_log),
            repeatability=log(folder.sphere_repeatability, read_sphere_log),
            board=part(folder.chessboard / "board.json", lambda: read_board(folder.chessboard / "board.json")),
            board_log=log(folder.chessboard, read_board_log),
        ),
        ranging=RangingData(
            line=part(line_path(folder), lambda: read_line(line_path(folder))),
            readings=tuple(part(readings_path(folder), lambda: read_readings(readings_path(folder))) or ()),
            scans=tuple(scan_paths(folder).items()),
        ),
        problems=tuple(problems),
    )


def in_folder(error: TestrangeError | str, root: Path) -> str:
    """An error's line with paths relative to the campaign: results are the same wherever the folder stands."""
    return str(error).replace(f"{root}/", "").replace(str(root), root.name)


def _strips(place: SortieFolder) -> tuple[int, ...]:
    """Numbers of the waveform files strip_NN.las, in order."""
    if not place.lidar.is_dir():
        return ()
    names = {path.name for path in place.lidar.glob("strip_*.las") if path.is_file()}
    stems = (name.removeprefix("strip_").removesuffix(".las") for name in names)
    numbers = {int(stem) for stem in stems if stem.isascii() and stem.isdigit() and len(stem) <= 4}
    return tuple(sorted(n for n in numbers if place.strip_las(n).name in names))
