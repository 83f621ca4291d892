"""The evaluator's own picks as observations_camera.csv and observations_lidar.csv, one pair a sortie (8.3.2 c, 9.3.2 c, A.1, A.2).

The files are those that a campaign may bring from a person (docs/campaign_folder.md): put into sorties/NN they give the same
indicators again, and any line of them can be looked up in the images and strips. The handbooks print from the same lists.
"""

from pathlib import Path

import numpy as np

from campaign.flight.records import (
    CameraObservation,
    LidarObservation,
    write_camera_observations,
    write_lidar_observations,
)
from evaluator.observe.picks import PointNumbers
from evaluator.results import Evaluation

CAMERA, LIDAR = "observations_camera.csv", "observations_lidar.csv"


def rejected_marks(evaluation: Evaluation) -> set[tuple[int, str, str]]:
    """(sortie, image, target) of marks that the adjustment left out as blunders."""
    lines = set(evaluation.mounting.rejected) if evaluation.mounting else set()
    return {
        (m.sortie, m.image, m.target)
        for m in evaluation.marks
        if any(line.startswith(f"mark of {m.target} in {m.image} (sortie {m.sortie})") for line in lines)
    }


def rejected_vertices(evaluation: Evaluation) -> set[tuple[int, int, str]]:
    """(sortie, strip, target) of vertices that the adjustment left out as blunders."""
    lines = set(evaluation.mounting.rejected) if evaluation.mounting else set()
    return {
        (v.sortie, v.strip, v.target)
        for v in evaluation.vertices
        if any(line.startswith(f"vertex of {v.target} in strip {v.strip} (sortie {v.sortie})") for line in lines)
    }


def target_pixels(evaluation: Evaluation, kind: str) -> dict[tuple[int, str, str], np.ndarray]:
    """(sortie, target, image) -> (n, 2) pixels behind the figures: the corners of the region that was read of a panel, the
    centre of a frustum target's mark. Marks that the adjustment left out are not in it."""
    ids = {t.id for t in evaluation.data.targets if t.kind == kind} if evaluation.data else set()
    out: dict[tuple[int, str, str], np.ndarray] = {}
    if kind == "panel":
        for r in evaluation.regions:
            if r.target in ids:
                out[r.sortie, r.target, r.image] = np.asarray(r.corners_px, dtype=np.float64)
    elif kind == "frustum":
        rejected = rejected_marks(evaluation)
        for m in evaluation.marks:
            if m.target in ids and (m.sortie, m.image, m.target) not in rejected:
                out[m.sortie, m.target, m.image] = np.asarray(m.uv_px, dtype=np.float64)[None]
    return dict(sorted(out.items()))


def target_point_numbers(evaluation: Evaluation, kind: str) -> PointNumbers:
    """(sortie, strip, target) -> record numbers in the strip's LAS file behind the figures; empty where none were kept."""
    found = evaluation.companions.get("target_points")
    ids = {t.id for t in evaluation.data.targets if t.kind == kind} if evaluation.data else set()
    if not isinstance(found, dict):
        return {}
    rejected = rejected_vertices(evaluation)
    return {key: value for key, value in sorted(found.items()) if key[2] in ids and key not in rejected}


def write_observations(folder: Path, evaluation: Evaluation) -> list[Path]:
    """Writes NN/observations_camera.csv and NN/observations_lidar.csv below `folder`, for every sortie with picks.

    Parameters
    ----------
    folder : Path
        results/observations, say; made where it is absent.
    evaluation : Evaluation

    Returns
    -------
    list of Path
        The files, sorted.
    """
    camera: dict[int, list[CameraObservation]] = {}
    lidar: dict[int, list[LidarObservation]] = {}
    for kind in ("frustum", "panel"):
        for (sortie, target, image), pixels in target_pixels(evaluation, kind).items():
            camera.setdefault(sortie, []).extend(
                CameraObservation(target=target, image=image, u_px=float(u), v_px=float(v)) for u, v in pixels
            )
        for (sortie, strip, target), numbers in target_point_numbers(evaluation, kind).items():
            lidar.setdefault(sortie, []).extend(
                LidarObservation(target=target, strip=strip, point=int(n)) for n in numbers
            )
    written = []
    for number in sorted(camera.keys() | lidar.keys()):
        place = folder / f"{number:02d}"
        place.mkdir(parents=True, exist_ok=True)
        if number in camera:
            write_camera_observations(place / CAMERA, camera[number])
            written.append(place / CAMERA)
        if number in lidar:
            write_lidar_observations(place / LIDAR, sorted(lidar[number], key=lambda o: (o.target, o.strip, o.point)))
            written.append(place / LIDAR)
    return written
