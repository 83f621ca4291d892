"""Reflectance panels as planes: from each panel and strip one observation of the LiDAR's mounting, the mean distance of the
panel's points from its surveyed upper face.

A panel is level and its height is surveyed, so that its points know where the beam is along the vertical whatever their place on
the panel. Which returns lie on a panel is found as for 8.1 (`observe.panels`), well inside its border. Unlike a vertex a plane
needs no shape to be fitted: roll shows as a tilt across the swath, the lever arm's z as a height. The equation and
its covariance are `mounting_model`'s, the test against all other observations `blunders`'.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from campaign.survey import SurveyedTarget
from evaluator.frames import WorldFrame, body_pose
from evaluator.georeference import TargetReturns, corrected_points, lidar_points, world_points
from evaluator.model import CampaignData, EvaluationError, Mounting, MountingSolution, PlaneObservation, SortieData
from evaluator.mounting.mounting_model import SurveyedPanel
from evaluator.observe.panels import panel_axes_world, returns_on_panel

_LEAST_POINTS = 20
_COMMON_STD_M = (
    0.001  # of a panel's mean beyond its points' scatter: the echoes' phase in the sampling, the encoder's steps
)
_OUTLIER = 5.0  # robust standard deviations from the plane
_MOST_OUTLIERS = 0.05
_NOT_PLANE_M = 0.005  # a ninth of the panel lies this far off its plane, and five standard deviations
_CONTRADICTION = 4.4  # standard deviations of a common shift: two-sided 1e-5, as for single blunders
_MOST_TILT_DEG = 1.0  # 5 cm off the centre a tilt of one degree is a height of 0.9 mm
_LONGEST_S = 5.0  # of scanning one panel in one strip


@dataclass(frozen=True, kw_only=True)
class PlanesFound:
    """Observations, and why the others are none."""

    planes: tuple[PlaneObservation, ...]
    missing: dict[str, str]  # "panel, sortie n, strip n" -> why: not enough was seen of it
    rejected: tuple[str, ...]  # what contradicts itself, named as the adjustment names its blunders, with the reason


def surveyed_panels(data: CampaignData) -> dict[str, SurveyedPanel]:
    """Upper faces of the panels in the world frame."""
    frame = WorldFrame(data.manifest)
    out = {}
    for t in data.targets:
        if t.kind == "panel":
            centre, axes = panel_axes_world(t, frame)
            out[t.id] = SurveyedPanel(
                centre_world_m=centre, normal_world=axes[2], height_std_m=max(t.height_std_m, 1e-5)
            )
    return out


def observe_planes(
    data: CampaignData, returns: Mapping[tuple[int, int, str], TargetReturns], body_from_lidar: Mounting
) -> PlanesFound:
    """One plane from every panel and strip.

    Parameters
    ----------
    data : CampaignData
    returns : mapping
        (sortie, strip, target) -> returns about the target, from `georeference.collect_target_returns`.
    body_from_lidar : Mounting
        From an adjustment: it says which returns lie on a panel, and turns the sensor's motion while it scans one. What it is
        wrong by cancels in the observations themselves.
    """
    if data.rig is None or data.lidar is None:
        raise EvaluationError("sensors/rig.json and sensors/lidar.json are needed to find panels in the cloud")
    panels = {t.id: t for t in data.targets if t.kind == "panel"}
    sorties = {s.folder.number: s for s in data.sorties}
    planes: list[PlaneObservation] = []
    missing: dict[str, str] = {}
    rejected: list[str] = []
    for sortie, strip, name in sorted(returns):
        if name not in panels or sortie not in sorties:
            continue
        found = observe_plane(data, sorties[sortie], panels[name], returns[sortie, strip, name], body_from_lidar)
        if isinstance(found, PlaneObservation):
            planes.append(found)
        elif found.startswith("not "):
            rejected.append(f"plane of {name} in strip {strip} (sortie {sortie}): {found}")
        else:
            missing[f"{name}, sortie {sortie}, strip {strip}"] = found
    return PlanesFound(planes=tuple(planes), missing=missing, rejected=tuple(rejected))


def observe_plane(
    data: CampaignData, sortie: SortieData, panel: SurveyedTarget, part: TargetReturns, body_from_lidar: Mounting
) -> PlaneObservation | str:
    """The plane of one panel in one strip, or why there is none: "not ..." where its points are no level plane."""
    assert data.rig is not None and data.lidar is not None
    trajectory, frame = sortie.trajectory, WorldFrame(data.manifest)
    if trajectory is None:
        return "no trajectory"
    rows = part.returns
    time = rows.gps_time_s
    if not (trajectory.gps_time_s[0] <= time.min() and time.max() <= trajectory.gps_time_s[-1]):
        return "scanned outside the trajectory"
    measured = corrected_points(lidar_points(rows.xyz_m, time, trajectory, data.rig, frame), data.range_correction)
    world = world_points(measured, time, trajectory, body_from_lidar, frame)
    origin = world_points(np.zeros_like(measured), time, trajectory, body_from_lidar, frame)
    key = (part.sortie, part.strip, part.target)
    on = returns_on_panel(key, panel, part, world, origin, data.lidar, frame, searched=False)
    if on is None or on.index.size < _LEAST_POINTS:
        return f"fewer than {_LEAST_POINTS} returns wholly on it"
    centre, axes = panel_axes_world(panel, frame)
    time, world = time[on.index], world[on.index]
    if np.ptp(time) > _LONGEST_S:
        return f"scanned over {np.ptp(time):.0f} s"
    local = (world - centre) @ axes.T
    use, residual, tilt_deg = plane_residuals(local)
    reason = not_plane(local[use], residual[use], panel.size_m, 1.0 - float(use.mean()))
    if reason is not None:
        return reason
    if tilt_deg > _MOST_TILT_DEG:
        return f"not level: tilted by {tilt_deg:.1f} degrees"
    n = int(use.sum())
    scatter = float(np.sqrt(np.sum(residual[use] ** 2) / (n - 3)))
    middle = np.array([time[use].mean()])
    body, rotation = body_pose(trajectory, middle, frame)
    in_body = (world[use].mean(axis=0) - body[0]) @ rotation[0] - body_from_lidar.lever_arm_m
    return PlaneObservation(
        panel=panel.id,
        sortie=part.sortie,
        strip=part.strip,
        gps_time_s=float(middle[0]),
        point_lidar_m=in_body @ body_from_lidar.rotation,
        std_m=float(np.hypot(scatter / np.sqrt(n), _COMMON_STD_M)),
        points=n,
        rms_m=scatter,
    )


def plane_residuals(local_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Which points lie on the plane through them, each one's height above it, and its tilt.

    Parameters
    ----------
    local_m : (n, 3) np.ndarray
        In the panel's axes. [m]

    Returns
    -------
    use : (n,) np.ndarray of bool
        Within five robust standard deviations.
    residual : (n,) np.ndarray
        Along the normal of the panel. [m]
    tilt : float
        [deg]
    """
    design = np.column_stack([np.ones(len(local_m)), local_m[:, :2]])
    use = np.ones(len(local_m), dtype=bool)
    plane = np.zeros(3)
    residual = local_m[:, 2] - np.median(local_m[:, 2])
    for _ in range(3):
        spread = 1.4826 * float(np.median(np.abs(residual[use])))
        use = np.abs(residual) <= max(_OUTLIER * spread, 1e-4)
        plane, *_ = np.linalg.lstsq(design[use], local_m[use, 2], rcond=None)
        residual = local_m[:, 2] - design @ plane
    return use, residual, float(np.degrees(np.arctan(np.hypot(*plane[1:]))))


def not_plane(local_m: np.ndarray, residual_m: np.ndarray, size_m: float, outliers: float) -> str | None:
    """Why these points are no plane: too many outliers, or the mean of a ninth of the panel lies off by more than 5 mm and five
    of its standard deviations (something on the panel, a sag, a step); None where they are one."""
    if outliers > _MOST_OUTLIERS:
        return f"not plane: {100.0 * outliers:.0f} % of its points lie off it"
    cell = np.clip(np.floor(3.0 * (local_m[:, :2] / size_m + 0.5)), 0, 2).astype(np.int64)
    ninth = 3 * cell[:, 0] + cell[:, 1]
    count = np.bincount(ninth, minlength=9)
    mean = np.bincount(ninth, weights=residual_m, minlength=9) / np.maximum(count, 1)
    limit = np.maximum(_NOT_PLANE_M, 5.0 * float(np.std(residual_m)) / np.sqrt(np.maximum(count, 1)))
    excess = np.where(count > 0, np.abs(mean) / limit, 0.0)
    worst = int(np.argmax(excess))
    if excess[worst] > 1.0:
        return f"not plane: a ninth of it lies {1e3 * mean[worst]:+.0f} mm off"
    return None


def contradiction(solution: MountingSolution) -> str | None:
    """Why the planes contradict vertices and marks as a whole: all surveyed heights of panels stand off by the same (another face,
    another datum) by more than chance allows. None where they agree, and where there are no planes."""
    shift, std = (solution.companions.get(f"panel_heights_{of}") for of in ("shift_m", "shift_std_m"))
    if not isinstance(shift, float) or not isinstance(std, float) or abs(shift) <= _CONTRADICTION * std:
        return None
    return f"their surveyed heights contradict the frustums' by {1e3 * shift:+.0f} mm ({1e3 * std:.1f} mm)"
