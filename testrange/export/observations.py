"""Where surveyed targets were seen in the images: a person's picks, else the results', else found here."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from campaign.errors import TestrangeError
from campaign.flight.records import CameraObservation, read_camera_observations
from campaign.progress import Report
from evaluator.boards.board_observations import observe_boards
from evaluator.georeference import nominal_mountings
from evaluator.model import SortieData
from evaluator.mounting.geometry import observe_marks, search_radius_px
from testrange.export.pictures import read_shot
from testrange.export.source import Shot, Source

_REJECTED = re.compile(r"(?:mark|centre|board) of (\S+) in (\S+) \(sortie (\d+)\)")


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """One surveyed target in one image; the image's top left corner is (0, 0)."""

    target: str
    shot: Shot
    uv_px: np.ndarray  # (2,) distorted


def find_sightings(source: Source, shots: list[Shot], progress: Report) -> list[Sighting]:
    """Every sighting of a mark (frustum) or board, in order of images and targets, without those that the adjustment rejected."""
    wanted = {t.kind for t in source.data.targets} & {"frustum", "board"}
    if not wanted or source.data.rig is None or source.data.camera is None:
        return []
    left_out = _rejected(source)
    known = {t.id for t in source.data.targets if t.kind in wanted}
    hand: dict[int, list[CameraObservation]] = {}
    written: dict[int, list[CameraObservation] | None] = {}
    found: list[Sighting] = []
    progress("observations", 0, len(shots))
    for done, shot in enumerate(shots, start=1):
        number = shot.sortie.folder.number
        if number not in hand:
            hand[number] = _picked(source, shot.sortie)
            written[number] = _written(source, number)
        seen = _seen(source, shot, hand[number], written[number], wanted)
        height, width = source.camera.height_px, source.camera.width_px
        for target, uv in sorted(seen.items()):
            inside = 0.0 <= uv[0] <= width and 0.0 <= uv[1] <= height
            if target in known and inside and (target, shot.exposure.image, number) not in left_out:
                found.append(Sighting(target=target, shot=shot, uv_px=np.asarray(uv, dtype=np.float64)))
        progress("observations", done, len(shots))
    return found


def _picked(source: Source, sortie: SortieData) -> list[CameraObservation]:
    path = sortie.folder.observations_camera
    return read_camera_observations(source.data.folder.held(path)) if path.is_file() else []


def _written(source: Source, number: int) -> list[CameraObservation] | None:
    """What the evaluation wrote of one sortie; None where it wrote nothing."""
    if source.results_folder is None:
        return None
    path = (
        source.results_folder
        / "observations"
        / f"{number:02d}"
        / source.data.folder.sortie(number).observations_camera.name
    )
    return read_camera_observations(path) if path.is_file() else None


def _seen(
    source: Source,
    shot: Shot,
    picked: list[CameraObservation],
    written: list[CameraObservation] | None,
    wanted: set[str],
) -> dict[str, np.ndarray]:
    """Target -> pixel in one image; a target that cannot be found is left out. Person's picks are in what was written."""
    data, rig = source.data, source.rig
    if written is not None and wanted == {"frustum"}:
        return {o.target: np.array([o.u_px, o.v_px]) for o in written if o.image == shot.exposure.image}
    image = read_shot(source, shot)
    nominal = nominal_mountings(rig)[0]
    heights = {(s.sortie, s.strip): s.height_m for s in data.plan.strips} if data.plan is not None else {}
    height = heights.get((shot.sortie.folder.number, shot.exposure.strip), shot.exposure.focus_distance_m)
    out: dict[str, np.ndarray] = {}
    try:
        if "frustum" in wanted:
            search = search_radius_px(data, height)
            marks, _ = observe_marks(data, shot.sortie, shot.exposure, image, nominal, search, picked)
            out |= {m.target: m.uv_px for m in marks}
        if "board" in wanted:
            boards, _ = observe_boards(data, shot.sortie, shot.exposure, image, nominal, None, picked)
            out |= {b.target: b.uv_px for b in boards}
    except TestrangeError:
        return out | {o.target: np.array([o.u_px, o.v_px]) for o in picked if o.image == shot.exposure.image}
    return out


def _rejected(source: Source) -> set[tuple[str, str, int]]:
    """(target, image, sortie) that the adjustment left out as blunders."""
    block = source.results["mounting"] if source.results is not None else {}
    lines = [str(line) for line in block.get("rejected") or ()]
    return {(m[1], Path(m[2]).name, int(m[3])) for line in lines if (m := _REJECTED.search(line))}
