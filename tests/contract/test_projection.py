"""The simulator's camera against the evaluator's: pixels of the same world points, through the campaign folder's formats.

Two implementations that share no code; agreement to rounding means that pose, mounting, lens, shutter and every convention of
the folder (geodetic position, attitude against local north, stamped time, pixel origin) are read as they were written.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tifffile import imread

from campaign.config import Camera, Config
from campaign.flight.trajectory import Trajectory, read_trajectory, write_sbet
from campaign.load import load_config
from campaign.manifest import Manifest
from campaign.truth import read_marks, read_true_trajectories, read_truth
from evaluator.camera_model import project_exposure, undistort
from evaluator.evaluate import read_campaign
from evaluator.frames import WorldFrame
from evaluator.model import Mounting
from evaluator.mounting.geometry import observe_marks
from scenes.model import Layout
from simulator.camera.view import FramePose, frame_pose, project
from simulator.flight import rig
from simulator.flight.frames import SiteFrame
from simulator.flight.motion import Motion
from simulator.flight.navigation import trajectory_of
from simulator.flight.plan import fly
from simulator.times import gps_week

LAYOUT = Layout(camera_half_m=(23.0, 15.4), lidar_half_m=31.0, cone_half_m=45.0, field_half_m=(13.0, 12.0))
FAULTS = (
    "faults.camera_boresight_deg=[0.25, -0.30, 0.40]",
    "faults.camera_lever_arm_m=[0.03, -0.02, 0.04]",
    "platform.camera.boresight_deg=[1.0, -2.0, 3.0]",
)
P1 = (*FAULTS, 'camera={use="dji_p1_35mm"}')
ROLLING = 'camera.shutter="rolling"'


def manifest_of(config: Config, week: int) -> Manifest:
    site = config.site
    return Manifest(
        campaign="c",
        synthetic=True,
        date="2026-09-25",
        start_time=config.campaign.start_time,
        gps_week=week,
        latitude_deg=site.latitude_deg,
        longitude_deg=site.longitude_deg,
        ellipsoid_height_m=site.ellipsoid_height_m,
        height_anomaly_m=site.height_anomaly_m,
        projection_epsg=site.projection_epsg,
        height_epsg=site.height_epsg,
        software={},
        files=(),
    )


def written(motion: Motion, config: Config, week: int, folder: Path) -> Trajectory:
    """A motion as the folder hands it on: SBET, written and read."""
    path = folder / "trajectory.out"
    write_sbet(path, trajectory_of(motion, SiteFrame(config.site), config), week)
    return read_trajectory(path, None, week)


def world_points(camera: Camera, pose: FramePose) -> np.ndarray:
    """Points that fill the image from edge to edge, at many depths: lines of sight of a grid of pixels, followed 20-90 m."""
    u, v = np.meshgrid(np.linspace(1, camera.width_px - 1, 25), np.linspace(1, camera.height_px - 1, 19))
    xy = undistort(camera.lens, np.stack([u.ravel(), v.ravel()], axis=1))
    depth = np.random.default_rng(5).uniform(20.0, 90.0, len(xy))[:, None]
    rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) * depth
    return np.asarray(pose.position_world_m + rays @ pose.world_from_camera.T)


@pytest.mark.parametrize(
    ("overrides", "limit_px"),
    [
        (FAULTS, 1e-5),
        (P1, 1e-5),
        ((*FAULTS, ROLLING, "camera.readout_time_s=0.02"), 0.02),
        ((*P1, ROLLING, "camera.readout_time_s=0.01"), 0.02),
    ],
    ids=["6mp", "p1", "6mp rolling", "p1 rolling"],
)
def test_both_cameras_see_a_point_in_the_same_pixel(
    overrides: tuple[str, ...], limit_px: float, tmp_path: Path
) -> None:
    """Rationale: with one common projection a sign error would cancel, and the range would certify itself.

    Expected: the same pixel over the whole field, at four headings and two heights, with a mounting that is turned on every axis.
    Tolerance: 1e-5 px with a global shutter: the trajectory passes through geodetic coordinates in doubles (1e-9 m) and is
    interpolated on other angles (some 1e-10 rad). 0.02 px, the acceptance's bound, for a rolling one: the
    simulator keeps the rates constant over the read-out, the evaluator interpolates the 200 Hz poses. The sway's angular
    acceleration leaves f a T^2 / 8, which grows with the square of the read-out: 20 ms for the small camera, 10 ms for a P1.
    """
    config = load_config("quickstart", list(overrides))
    camera = config.camera
    sorties = fly(config, LAYOUT)
    week = gps_week(float(sorties[0].motion.gps_time_s[0]))
    frame = WorldFrame(manifest_of(config, week))
    mounting = rig.true_camera(config)
    half_span = 0.5 * camera.readout_time_s if camera.shutter == "rolling" else 1e-3
    worst = []
    for sortie in sorties:
        trajectory = written(sortie.motion, config, week, tmp_path)
        for strip in sortie.strips:
            time = strip.exposure_s[0]
            pose = frame_pose(sortie.motion, mounting, time, half_span_s=half_span)
            points = world_points(camera, pose)
            simulated, depth = project(camera, pose, points)
            evaluated, _ = project_exposure(
                rig.camera_sheet(config),
                camera.lens,
                Mounting(rotation=mounting.rotation, lever_arm_m=mounting.lever_arm_m),
                trajectory,
                time,
                points,
                frame,
            )
            assert (depth > 15.0).all()
            inside = (simulated > 0).all(axis=1) & (simulated < [camera.width_px, camera.height_px]).all(axis=1)
            assert inside.mean() > 0.8
            worst.append(np.abs(simulated - evaluated)[inside].max())
    print(f"{len(worst)} images, greatest difference {max(worst):.2e} px")
    assert len(worst) == 8
    assert max(worst) < limit_px


def test_pixels_from_a_textbook(tmp_path: Path) -> None:
    """Rationale: two cameras that were wrong in the same way would agree.

    Expected: level flight north at 50 m, mounting without error and lever arm, no distortion: a point 5 m ahead and 2 m to the
    right lies f * 5/50 above and f * 2/50 right of the principal point. Heading east: ahead is east. Tolerance: 1e-6 px.
    """
    config = load_config(
        "quickstart",
        ["platform.camera={lever_arm_m=[0.0, 0.0, 0.0]}"]
        + [f"faults.camera_{name}=[0.0, 0.0, 0.0]" for name in ("boresight_deg", "lever_arm_m")]
        + [f"camera.lens.{k}=0.0" for k in ("k1", "k2", "k3", "p1", "p2")],
    )
    lens, n = config.camera.lens, 21
    time = 474_338_620.0 + 0.01 * np.arange(n)
    week = gps_week(float(time[0]))
    expected = [lens.cx_px + lens.fx_px * 2 / 50, lens.cy_px - lens.fy_px * 5 / 50]
    for heading, ahead, right in ((0.0, (0.0, 1.0), (1.0, 0.0)), (math.pi / 2, (1.0, 0.0), (0.0, -1.0))):
        motion = Motion(
            gps_time_s=time,
            position_world_m=np.tile([0.0, 0.0, 50.0], (n, 1)),
            velocity_world_m_s=np.zeros((n, 3)),
            rpy_rad=np.tile([0.0, 0.0, heading], (n, 1)),
        )
        mounting = rig.true_camera(config)
        point = np.array([[*(5 * np.array(ahead) + 2 * np.array(right)), 0.0]])
        simulated, _ = project(config.camera, frame_pose(motion, mounting, time[10]), point)
        evaluated, _ = project_exposure(
            rig.camera_sheet(config),
            lens,
            Mounting(rotation=mounting.rotation, lever_arm_m=mounting.lever_arm_m),
            written(motion, config, week, tmp_path),
            time[10],
            point,
            WorldFrame(manifest_of(config, week)),
        )
        assert simulated[0] == pytest.approx(expected, abs=1e-6)
        assert evaluated[0] == pytest.approx(expected, abs=1e-6)


@pytest.fixture(scope="module")
def known(tiny_run: Path) -> dict[str, Any]:
    """A simulated campaign with its truth put in the evaluator's forms."""
    root = tiny_run / "campaign"
    truth = read_truth(root)
    return {
        "data": read_campaign(root),
        "truth": truth,
        "trajectories": read_true_trajectories(root / "truth" / "trajectory.npz"),
        "mounting": Mounting(rotation=np.array(truth.camera.rotation), lever_arm_m=np.array(truth.camera.lever_arm_m)),
        "marks": {(m.image, m.target): np.array([m.u_px, m.v_px]) for m in read_marks(root / "truth" / "marks.csv")},
    }


def predictions(known: dict[str, Any]) -> dict[tuple[str, str], np.ndarray]:
    """(image, target) -> the evaluator's pixel of the true place, with true mounting, lens, trajectory and time."""
    data, truth = known["data"], known["truth"]
    frame, out = WorldFrame(data.manifest), {}
    for sortie in data.sorties:
        for exposure in sortie.exposures:
            uv, _ = project_exposure(
                data.camera,
                truth.lens,
                known["mounting"],
                known["trajectories"][sortie.folder.number],
                exposure.gps_time_s - truth.camera_clock_s,
                np.array([t.mark_world_m for t in truth.targets]),
                frame,
            )
            image = f"sorties/{sortie.folder.number:02d}/images/{exposure.image}"
            out |= {(image, t.id): pixel for t, pixel in zip(truth.targets, uv, strict=True)}
    return out


def test_true_marks_of_a_campaign_are_where_the_evaluator_puts_them(known: dict[str, Any]) -> None:
    """Expected: truth/marks.csv, which the simulator wrote, is the evaluator's projection of the true world points.

    Tolerance: 1e-4 px: truth and exposures are written with all digits; interpolation of other angles leaves 1e-8 rad.
    """
    predicted = predictions(known)
    difference = [np.abs(predicted[key] - uv).max() for key, uv in known["marks"].items()]
    print(f"{len(difference)} marks, greatest difference {max(difference):.2e} px")
    assert len(difference) > 100
    assert max(difference) < 1e-4


def test_rendered_marks_are_where_the_evaluator_puts_them(known: dict[str, Any]) -> None:
    """Rationale: the chain's last link: rays of the renderer against the evaluator's projection, through pixels. A shift by half
    a pixel between ray and array index, or of the pose within the exposure, shows here and nowhere else.

    Expected: marks that the evaluator finds in the noisy images, against its own projection of the true centres with true
    mounting, lens and trajectory: mean difference zero in u and v.
    Tolerance: 0.02 px, the acceptance's, plus three standard errors of the mean of the marks seen (each is found to 0.01-0.1 px).
    """
    data, mounting = known["data"], known["mounting"]
    predicted, differences, std = predictions(known), [], []
    for sortie in data.sorties:
        for exposure in sortie.exposures:
            image = imread(sortie.folder.images / exposure.image)
            marks, _ = observe_marks(data, sortie, exposure, image, mounting, 15.0)
            for mark in marks:
                key = f"sorties/{sortie.folder.number:02d}/images/{exposure.image}", mark.target
                differences.append(mark.uv_px - predicted[key])
                std.append(np.sqrt(np.diag(mark.covariance_px2)))
    found, weight = np.array(differences), 1.0 / np.square(std)
    mean = (weight * found).sum(axis=0) / weight.sum(axis=0)
    error = 1.0 / np.sqrt(weight.sum(axis=0))
    print(
        f"{len(found)} marks: mean {mean.round(4)} px, its error {error.round(4)} px, spread {found.std(axis=0).round(4)} px"
    )
    assert len(found) >= 24
    assert (3.0 * error < 0.03).all()
    assert (np.abs(mean) < 0.02 + 3.0 * error).all()
    assert (np.abs(found) < 0.5).all()
