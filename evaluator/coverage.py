"""Which images and strips can hold which surveyed targets; those that none can: a wrong survey or a missed target.

Only where things lie, by the nominal mounting; whether a mark or a plane is then found in there is for `observe`.
"""

from collections.abc import Mapping

import numpy as np
from scipy.spatial import cKDTree

from campaign.errors import TestrangeError
from campaign.flight.las import StripReader
from campaign.survey import SurveyedTarget
from evaluator.camera_model import camera_points, ideal_px, project_exposure
from evaluator.frames import WorldFrame
from evaluator.georeference import TargetReturns, nominal_mountings
from evaluator.model import CampaignData, EvaluationError, Mounting
from evaluator.mounting.geometry import certified_lens, search_radius_px
from evaluator.observe.panel_images import panel_region_px

_REMEDY = "check its coordinates, or take it out of survey/targets.csv"


def targets_outside_images(data: CampaignData) -> list[str]:
    """Targets whose centre lies outside every image, one line each, with the nearest image and how far it is.

    A target within the mounting's prior of an image's edge counts as inside. Without images, the camera's sheet or the rig's
    sheet nothing can be said: an empty list.
    """
    if data.camera is None or data.rig is None or not data.targets:
        return []
    camera, nominal = data.camera, nominal_mountings(data.rig)[0]
    lens, frame = certified_lens(camera)[0], WorldFrame(data.manifest)
    world = _world(data.targets, frame)
    size = np.array([camera.width_px, camera.height_px], dtype=np.float64)
    nearest = np.full(len(world), np.inf)
    name = [""] * len(world)
    looked = False
    for sortie in data.sorties:
        for exposure in sortie.exposures:
            if sortie.trajectory is None or not (sortie.folder.images / exposure.image).is_file():
                continue
            try:
                uv, time = project_exposure(camera, lens, nominal, sortie.trajectory, exposure.gps_time_s, world, frame)
                seen = camera_points(nominal, sortie.trajectory, time, world, frame)
            except EvaluationError:
                continue  # the exposure lies outside the trajectory: named where the image is used
            looked = True
            margin = search_radius_px(data, float(np.median(np.abs(seen[:, 2]))))
            with np.errstate(invalid="ignore"):
                inside = np.all((uv >= -margin) & (uv <= size + margin), axis=1)
                ideal = ideal_px(lens, seen)
                beyond = (
                    np.linalg.norm(np.maximum(np.maximum(-ideal, ideal - size), 0.0), axis=1) * seen[:, 2] / lens.fx_px
                )
            beyond = np.where(np.isfinite(beyond), beyond, np.linalg.norm(seen, axis=1))
            beyond = np.where(inside, 0.0, np.maximum(beyond, 1e-3))
            for i in np.flatnonzero(beyond < nearest):
                nearest[i], name[i] = beyond[i], exposure.image
    if not looked:
        return []
    return [
        f"survey/targets.csv: target {target.id} lies outside every image; the nearest is {image}, "
        f"{_metres(distance)} m beyond its edge; {_REMEDY}"
        for target, image, distance in zip(data.targets, name, nearest)
        if distance > 0.0
    ]


def targets_outside_strips(
    data: CampaignData, returns: Mapping[tuple[int, int, str], TargetReturns], radius_m: float
) -> list[str]:
    """Targets without one return near them in any strip, one line each, with the nearest strip and how far it is.

    Parameters
    ----------
    data : CampaignData
    returns : mapping
        (sortie, strip, target) -> returns, from `georeference.collect_target_returns`: of every strip that could be read.
    radius_m : float
        Within which returns were collected. [m]
    """
    reached = {target for _, _, target in returns}
    missed = [t for t in data.targets if t.id not in reached]
    strips = [(s, strip) for s in data.sorties for strip in s.strips]
    if not missed or not strips:
        return []
    place = np.array([[t.easting_m, t.northing_m] for t in missed])
    nearest, name = np.full(len(missed), np.inf), [""] * len(missed)
    for sortie, strip in strips:
        try:
            for _, chunk in StripReader(sortie.folder.strip_las(strip)).chunks():
                distance = np.atleast_1d(cKDTree(chunk.xyz_m[:, :2]).query(place)[0])
                for i in np.flatnonzero(distance < nearest):
                    nearest[i], name[i] = distance[i], f"sortie {sortie.folder.number} strip {strip}"
        except TestrangeError:
            continue  # named where the strip is used
    return [
        f"survey/targets.csv: target {t.id} lies outside every strip; the nearest is {strip}, "
        f"{_metres(distance)} m away; {_REMEDY}"
        for t, strip, distance in zip(missed, name, nearest)
        if strip and distance > radius_m
    ]


def targets_in_images(data: CampaignData, camera: Mounting | None) -> dict[tuple[int, str], int]:
    """How many targets lie wholly inside each image (6.2.3 b): their squares as seen through the mounting at hand."""
    if data.camera is None or camera is None:
        return {}
    frame = WorldFrame(data.manifest)
    limit = np.array([data.camera.width_px, data.camera.height_px], dtype=np.float64)
    counts: dict[tuple[int, str], int] = {}
    exposures = [(s, e) for s in data.sorties if s.trajectory is not None for e in s.exposures]
    for sortie, exposure in exposures:
        inside = 0
        assert sortie.trajectory is not None
        for target in data.targets:
            try:
                corners = panel_region_px(target, data.camera, camera, sortie.trajectory, exposure, frame)
            except EvaluationError:
                break  # the exposure lies outside the trajectory: named with the marks
            inside += bool(np.isfinite(corners).all() and (corners >= 0.0).all() and (corners <= limit).all())
        counts[sortie.folder.number, exposure.image] = inside
    return counts


def _metres(distance: float) -> str:
    return f"{distance:.1f}" if distance < 10.0 else f"{distance:.0f}"


def _world(targets: tuple[SurveyedTarget, ...], frame: WorldFrame) -> np.ndarray:
    return frame.world_from_map(np.array([[t.easting_m, t.northing_m, t.height_m] for t in targets]))
