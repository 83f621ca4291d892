"""Flights of plain numbers for tests of clocks and closure: smooth motion at given speeds, errors from the stated model.

Read with runpy by the tests that use it; nothing of the simulator is in it.
"""

import numpy as np

from campaign.config import Lens
from campaign.flight.trajectory import Trajectory
from campaign.manifest import Manifest
from campaign.sensors import MountingSheet, NavigationSheet, Rig
from evaluator.camera_model import lens_from_vector, lens_vector, project
from evaluator.frames import WorldFrame, euler_angles, euler_rotation
from evaluator.georeference import nominal_mountings
from evaluator.model import MarkObservation, PlaneObservation, VertexObservation
from evaluator.mounting.mounting_model import Problem, SurveyedMark, SurveyedPanel, mounting_of

FRAME = WorldFrame(
    Manifest(
        campaign="t",
        synthetic=True,
        date="2026-06-12",
        start_time="2026-06-12T10:30:00+08:00",
        gps_week=2422,
        latitude_deg=31.283,
        longitude_deg=121.213,
        ellipsoid_height_m=18.0,
        height_anomaly_m=11.2,
        projection_epsg=4549,
        height_epsg=5737,
        software={},
        files=(),
    )
)
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
LENS = Lens(fx_px=3000.0, fy_px=3000.0, cx_px=1536.0, cy_px=1024.0, k1=-0.05, k2=0.02)
LENS_STD = np.array([0.15, 0.15, 0.15, 0.15, 4e-5, 1.5e-4, 2e-4, 6e-6, 6e-6])
TRUE = np.concatenate(
    [np.radians([0.35, -0.28, 0.42]), [0.03, -0.02, 0.02], np.radians([-0.31, 0.25, -0.4]), [-0.02, 0.03, 0.015]]
)
POSITION_STD, ATTITUDE_STD_DEG = np.array([0.01, 0.01, 0.015]), np.array([0.005, 0.005, 0.01])
STEP_S = 0.02


def rig(clock_std_s: float) -> Rig:
    prior = {
        "boresight_std_deg": 1.0,
        "lever_arm_std_m": 0.1,
        "boresight_deg": (0.0, 0.0, 0.0),
        "clock_std_s": clock_std_s,
    }
    return Rig(
        platform="m",
        kind="multirotor",
        camera=MountingSheet(lever_arm_m=(0.1, 0.03, 0.08), axes="rdf_nadir", **prior),
        lidar=MountingSheet(lever_arm_m=(-0.05, -0.02, 0.12), axes="frd", **prior),
        navigation=NavigationSheet(
            grade="custom",
            position_std_m=tuple(POSITION_STD),
            attitude_std_deg=tuple(ATTITUDE_STD_DEG),
            position_correlation_s=60.0,
            attitude_correlation_s=120.0,
        ),
    )


def _gauss_markov(rng: np.random.Generator, times: np.ndarray, std: np.ndarray, correlation_s: float) -> np.ndarray:
    out = rng.standard_normal((len(times), 3))
    for k, dt in enumerate(np.diff(times), start=1):
        keep = np.exp(-dt / correlation_s)
        out[k] = keep * out[k - 1] + np.sqrt(1.0 - keep**2) * out[k]
    return out * std


def _trajectory(times: np.ndarray, position: np.ndarray, rpy: np.ndarray) -> Trajectory:
    lat, lon, h = FRAME.geodetic_from_world(position)
    local = np.swapaxes(FRAME.world_from_local_ned(lat, lon), -1, -2) @ ENU_FROM_NED @ euler_rotation(*rpy.T)
    angles = euler_angles(local)
    zero = np.zeros((len(times), 3))
    return Trajectory(
        gps_time_s=times,
        latitude_rad=lat,
        longitude_rad=lon,
        ellipsoid_height_m=h,
        roll_rad=angles[:, 0],
        pitch_rad=angles[:, 1],
        heading_rad=angles[:, 2] % (2 * np.pi),
        velocity_ned_m_s=zero,
        acceleration_body_m_s2=zero,
        angular_rate_body_rad_s=zero,
        position_std_m=zero,
        attitude_std_rad=zero,
    )


def flight(
    seed: int,
    speeds=(3.0, 9.0),
    heights=(45.0, 65.0),
    headings=(0.0, 180.0, 90.0, 270.0),
    clocks=(0.0, 0.0),
    clock_std_s=0.0,
    truth=TRUE,
    sway_deg=0.6,
    noise=1.0,
    mark_std=0.06,
    range_std=0.004,
    lidar_turn_deg=(0.0, 0.0, 0.0),
    panels=0,
    panel_std=0.001,
    panel_height_std=0.004,
    grid=(4, 4),
) -> Problem:
    """Targets on a grid, 16 unless told; every height a sortie with one strip a heading, two images and one scan of every
    target each.

    `clocks` are stamped minus true time of camera and LiDAR, `lidar_turn_deg` a change of the LiDAR's boresight before the
    second sortie, `noise` scales every error. `panels` level ones stand between the targets; every strip scans them too.
    """
    rng = np.random.default_rng(seed)
    the_rig = rig(clock_std_s)
    nominal = nominal_mountings(the_rig)
    camera = mounting_of(nominal[0], truth[:6])
    e, n = np.meshgrid(np.linspace(-14, 14, grid[0]), np.linspace(-10, 10, grid[1]))
    places = np.stack([e.ravel(), n.ravel(), rng.choice([0.2, 0.65, 1.15], e.size)], axis=-1)
    survey_std = np.array([0.003, 0.003, 0.004])
    names = [f"F{i:02d}" for i in range(len(places))]
    surveyed = {
        name: SurveyedMark(
            mark_world_m=p + noise * rng.standard_normal(3) * survey_std,
            covariance_m2=np.diag(survey_std**2),
            vertex_from_mark_m=np.zeros(3),
        )
        for name, p in zip(names, places, strict=True)
    }
    certificate = lens_from_vector(lens_vector(LENS) + noise * LENS_STD * rng.standard_normal(9))
    marks, vertices, planes, trajectories = [], [], [], {}
    own = np.random.default_rng([seed, 41450])  # so that panels change nothing else
    centres = np.column_stack(
        [own.uniform(-14, 14, panels), own.uniform(-10, 10, panels), own.uniform(0.1, 0.3, panels)]
    )
    heights_surveyed = centres[:, 2] + noise * panel_height_std * own.standard_normal(panels)
    for sortie, (height, speed) in enumerate(zip(heights, speeds, strict=True), start=1):
        changed = truth[6:].copy()
        if sortie == 2:
            changed[:3] += np.radians(lidar_turn_deg)
        lidar = mounting_of(nominal[1], changed)
        half_s = 17.0 / speed + 1.0
        local = np.arange(-half_s, half_s, STEP_S)
        middles = 464_000_000.0 + 1000.0 * sortie + (2.0 * half_s + 20.0) * np.arange(1, len(headings) + 1)
        times, position, rpy = [], [], []
        for middle, heading in zip(middles, headings, strict=True):
            along = np.array([np.sin(np.radians(heading)), np.cos(np.radians(heading)), 0.0])
            times.append(middle + local)
            position.append(speed * local[:, None] * along + np.array([0.0, 0.0, height]))
            phase = rng.uniform(0.0, 2.0 * np.pi, 6)
            sway = sum(
                np.sin(2.0 * np.pi * local[:, None] / period + phase[k : k + 3]) for k, period in ((0, 2.6), (3, 4.7))
            )
            rpy.append(np.radians(sway_deg * sway + np.array([0.0, -1.5, heading])))
        t, p, a = np.concatenate(times), np.concatenate(position), np.concatenate(rpy)
        d_position = noise * _gauss_markov(rng, t, POSITION_STD, 60.0)
        d_rpy = noise * _gauss_markov(rng, t, np.radians(ATTITUDE_STD_DEG), 120.0)
        trajectories[sortie] = _trajectory(t, p + d_position @ ENU_FROM_NED.T, a + d_rpy)

        def pose(at: np.ndarray, t=t, p=p, a=a) -> tuple[np.ndarray, np.ndarray]:
            angles = [np.interp(at, t, c) for c in a.T]
            return np.stack([np.interp(at, t, c) for c in p.T], -1), ENU_FROM_NED @ euler_rotation(*angles)

        for strip, (middle, heading) in enumerate(zip(middles, headings, strict=True), start=1):
            along = np.array([np.sin(np.radians(heading)), np.cos(np.radians(heading)), 0.0])
            shots = middle + np.array([-3.0, 3.0]) / speed
            for image, (at, rotation) in enumerate(zip(*pose(shots), strict=True)):
                uv = project(LENS, ((places - at) @ rotation - camera.lever_arm_m) @ camera.rotation)
                inside = np.all((uv > 10) & (uv < [3062, 2038]), axis=1)
                uv = uv + noise * rng.normal(0.0, mark_std, uv.shape)
                marks += [
                    MarkObservation(
                        target=names[i],
                        sortie=sortie,
                        strip=strip,
                        image=f"s{sortie}_{strip}_{image}.tif",
                        gps_time_s=float(shots[image] + clocks[0]),
                        uv_px=uv[i],
                        covariance_px2=np.eye(2) * mark_std**2,
                        radius_px=8.0,
                    )
                    for i in np.flatnonzero(inside)
                ]
            scans = middle + places @ along / speed
            at, rotation = pose(scans)
            points = (np.einsum("nji,nj->ni", rotation, places - at) - lidar.lever_arm_m) @ lidar.rotation
            points = points + noise * rng.normal(0.0, range_std, points.shape)
            vertices += [
                VertexObservation(
                    target=names[i],
                    sortie=sortie,
                    strip=strip,
                    gps_time_s=float(scans[i] + clocks[1]),
                    time_spread_s=0.1,
                    point_lidar_m=points[i],
                    covariance_m2=np.eye(3) * range_std**2,
                    faces=4,
                    points=120,
                    rms_m=range_std,
                )
                for i in range(len(names))
            ]
            if panels == 0:
                continue
            scans = middle + centres @ along / speed
            at, rotation = pose(scans)
            on = centres + np.append(own.uniform(-0.05, 0.05, 2), 0.0)  # where on a panel does not matter
            on[:, 2] += noise * panel_std * own.standard_normal(panels)
            points = (np.einsum("nji,nj->ni", rotation, on - at) - lidar.lever_arm_m) @ lidar.rotation
            planes += [
                PlaneObservation(
                    panel=f"P{i:02d}",
                    sortie=sortie,
                    strip=strip,
                    gps_time_s=float(scans[i] + clocks[1]),
                    point_lidar_m=points[i],
                    std_m=panel_std,
                    points=100,
                    rms_m=10.0 * panel_std,
                )
                for i in range(panels)
            ]
    return Problem(
        rig=the_rig,
        lens=certificate,
        lens_covariance=np.diag(LENS_STD**2),
        marks=tuple(marks),
        vertices=tuple(vertices),
        surveyed=surveyed,
        trajectories=trajectories,
        world_frame=FRAME,
        planes=tuple(planes),
        panels={
            f"P{i:02d}": SurveyedPanel(
                centre_world_m=np.array([*centres[i, :2], heights_surveyed[i]]),
                normal_world=np.array([0.0, 0.0, 1.0]),
                height_std_m=panel_height_std,
            )
            for i in range(panels)
        },
    )
