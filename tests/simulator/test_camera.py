"""Camera maths: lens, projection, rolling shutter, pose of a frame, boxes round targets."""

import numpy as np
import pytest

from campaign.config import Band, Camera, Lens
from scenes.model import Layout, Material, Mesh, Scene, Target
from simulator.camera.view import (
    FramePose,
    distort,
    distorted_from_pixel,
    frame_pose,
    pixel_from_distorted,
    project,
    target_regions,
    undistort,
)
from simulator.flight.frames import FRD_FROM_RDF_NADIR
from simulator.flight.motion import Motion, SensorMounting

BAND = Band(name="green", centre_nm=550.0, fwhm_nm=70.0)
# The calibration of a real full-frame mapping camera (its maker's report).
P1 = Camera(
    width_px=8192,
    height_px=5460,
    pixel_size_um=4.4,
    nominal_focal_length_mm=35.0,
    lens=Lens(
        fx_px=8197.45,
        fy_px=8197.45,
        cx_px=4047.05,
        cy_px=2757.58,
        k1=-0.0469,
        k2=0.0236,
        k3=-0.1049,
        p1=0.00192,
        p2=-0.00166,
    ),
    bands=(BAND,),
)
NADIR = np.diag([1.0, -1.0, -1.0])  # x east, top of the image north


def pose(**changes: object) -> FramePose:
    values: dict = {
        "position_world_m": np.array([0.0, 0.0, 50.0]),
        "world_from_camera": NADIR,
        "velocity_world_m_s": np.zeros(3),
        "angular_rate_camera_rad_s": np.zeros(3),
        "gps_time_s": 0.0,
    }
    return FramePose(**(values | changes))


def plain(**changes: object) -> Camera:
    values: dict = {
        "width_px": 600,
        "height_px": 400,
        "pixel_size_um": 5.0,
        "nominal_focal_length_mm": 5.0,
        "lens": Lens(fx_px=1000.0, fy_px=1000.0, cx_px=300.0, cy_px=200.0),
        "bands": (BAND,),
    }
    return Camera(**(values | changes))


def test_distortion_round_trip_over_the_full_field() -> None:
    """Rationale: rays leave through the inverse lens, truth is projected through the forward one; they must be one lens.

    Expected: pixel -> undistorted -> pixel is the identity, out to the corners of a real lens's calibration.
    Tolerance: 1e-3 px is demanded; the inverse is solved to 1e-12, 1e-8 px after the focal length.
    """
    u, v = np.meshgrid(np.linspace(0, P1.width_px, 61), np.linspace(0, P1.height_px, 41))
    pixel = np.stack([u, v], axis=-1)
    again = pixel_from_distorted(P1.lens, distort(P1.lens, undistort(P1.lens, distorted_from_pixel(P1.lens, pixel))))
    assert np.abs(again - pixel).max() < 1e-6
    assert np.abs(distort(P1.lens, distorted_from_pixel(P1.lens, pixel[0, 0])) * 8197.45).max() > 50  # it does distort


def test_distortion_follows_the_printed_formula() -> None:
    """Rationale: the round trip holds for any function; the coefficients must stand where the convention says.

    Expected: one term at a time at (x, y) = (0.3, -0.2), r2 = 0.13, worked by hand.
    Tolerance: rounding.
    """
    xy = np.array([0.3, -0.2])
    base = {"fx_px": 1.0, "fy_px": 1.0, "cx_px": 1.0, "cy_px": 1.0}
    for name, moved in {
        "k1": xy * 0.13,
        "k2": xy * 0.0169,
        "k3": xy * 0.002197,
        "p1": np.array([2 * 0.3 * -0.2, 0.13 + 2 * 0.04]),
        "p2": np.array([0.13 + 2 * 0.09, 2 * 0.3 * -0.2]),
    }.items():
        assert distort(Lens(**base, **{name: 0.1}), xy) - xy == pytest.approx(0.1 * moved, abs=1e-15)


def test_unreachable_points_are_nan() -> None:
    """Rationale: a strong barrel folds back; a silent wrong inverse would put a ray anywhere.

    Expected: r (1 - 0.5 r^2) never exceeds 0.5443, so x_d = 0.6 has no source and 0.5 has one.
    Tolerance: none needed.
    """
    lens = Lens(fx_px=1.0, fy_px=1.0, cx_px=1.0, cy_px=1.0, k1=-0.5)
    found = undistort(lens, np.array([[0.6, 0.0], [0.5, 0.0]]))
    assert np.isnan(found[0]).all()
    assert distort(lens, found[1]) == pytest.approx([0.5, 0.0], abs=1e-10)


def test_projection_by_hand() -> None:
    """Rationale: axes and signs: x right, y down, top left origin.

    Expected: from 50 m, f = 1000 px, 1 m east is 20 px right of the centre, 1 m north 20 px above it.
    Tolerance: rounding.
    """
    pixel, depth = project(plain(), pose(), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 60.0]]))
    assert pixel[:2] == pytest.approx(np.array([[320.0, 200.0], [300.0, 180.0]]))
    assert depth == pytest.approx([50.0, 50.0, -10.0])
    assert np.isnan(pixel[2]).all()


def test_rolling_shutter_sees_each_row_at_its_own_time() -> None:
    """Rationale: with a rolling shutter a point's row decides when it is seen, and when decides the row.

    Expected: flying north (up in the image) at v, rows read top to bottom: the camera at time t stands at v t, so the row
    solves row = 200 + f/H (v t - y), t = (row/400 - 0.5) T: closed form row = (200 - f/H (y + v T/2)) / (1 - f v T/(400 H)).
    Tolerance: 1e-6 px, the iteration stops at 1e-12 s.
    """
    camera = plain(shutter="rolling", readout_time_s=0.03)
    moving = pose(velocity_world_m_s=np.array([0.0, 15.0, 0.0]))
    y = np.array([-8.0, -1.0, 0.0, 5.0])
    pixel, _ = project(camera, moving, np.stack([0 * y, y, 0 * y], axis=-1))
    expected = (200 - 20 * (y + 15 * 0.03 / 2)) / (1 - 20 * 15 * 0.03 / 400)
    assert pixel[:, 1] == pytest.approx(expected, abs=1e-6)
    still, _ = project(plain(), moving, np.stack([0 * y, y, 0 * y], axis=-1))
    assert still[:, 1] == pytest.approx(200 - 20 * y)


def test_rolling_shutter_turns_with_the_rate() -> None:
    """Rationale: the sign of the angular rate must be that of `frame_pose`.

    Expected: turning about the optical axis by +w (x towards y), a point off the axis moves in the image by -w t.
    Tolerance: 1e-9 px.
    """
    camera = plain(shutter="rolling", readout_time_s=0.03)
    turning = pose(angular_rate_camera_rad_s=np.array([0.0, 0.0, 0.5]))
    pixel, _ = project(camera, turning, np.array([[10.0, 0.0, 0.0]]))
    angle = -0.5 * (pixel[0, 1] / 400 - 0.5) * 0.03
    assert pixel[0] == pytest.approx([300 + 200 * np.cos(angle), 200 + 200 * np.sin(angle)], abs=1e-9)


def test_frame_pose_of_a_turning_body() -> None:
    """Rationale: lever arm, mounting and rates enter truth here and nowhere else.

    Expected: yaw rate w about FRD z gives the nadir camera the rate +w about its z; a lever arm ahead moves sideways.
    Tolerance: the motion interpolates angles linearly; 1e-6 of the rates.
    """
    time = np.linspace(0, 1, 201)
    rate = 0.4
    rpy = np.stack([0.02 + 0 * time, -0.03 + 0 * time, rate * (time - 0.5)], axis=-1)
    motion = Motion(
        gps_time_s=time,
        position_world_m=np.stack([0 * time, 5.0 * time, 40.0 + 0 * time], axis=-1),
        velocity_world_m_s=np.tile([0.0, 5.0, 0.0], (201, 1)),
        rpy_rad=rpy,
    )
    level = Motion(**{**motion.__dict__, "rpy_rad": rpy * [0, 0, 1]})
    mounting = SensorMounting(rotation=FRD_FROM_RDF_NADIR, lever_arm_m=np.array([0.2, 0.0, 0.1]))
    found = frame_pose(level, mounting, 0.5)
    assert found.angular_rate_camera_rad_s == pytest.approx([0, 0, rate], abs=1e-6)
    assert found.position_world_m == pytest.approx([0.0, 2.7, 39.9], abs=1e-9)
    # Heading turns from north to east: a point ahead of the body moves east.
    assert found.velocity_world_m_s == pytest.approx([0.2 * rate, 5.0, 0.0], abs=1e-6)
    tilted = frame_pose(motion, mounting, 0.5)
    later = frame_pose(motion, mounting, 0.51).world_from_camera
    turn = tilted.world_from_camera.T @ later
    small = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    assert tilted.angular_rate_camera_rad_s == pytest.approx(small / 0.01, abs=1e-4)


def test_boxes_hold_their_targets_and_nothing_outside_the_image() -> None:
    """Rationale: samples are spent, and the evaluator's observations lie, inside these boxes.

    Expected: a 2 m square at (2, -1) seen from 50 m spans 40 px about (340, 220), plus the margin; a target out of view and
    a stand (part 10) give no box and no growth.
    Tolerance: whole pixels.
    """
    square = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    vertices = np.concatenate([square + [2.0, -1.0, 0.0], square + [90.0, 0.0, 0.0], 3 * square + [2.0, -1.0, -0.1]])
    faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * k for k in range(3)]).astype(np.int32)
    scene = Scene(
        mesh=Mesh(
            vertices_m=vertices,
            faces=faces,
            material=np.zeros(6, np.int32),
            target=np.array([0, 0, 1, 1, 0, 0], np.int32),
            part=np.array([12, 12, 12, 12, 10, 10], np.int8),
        ),
        materials=(Material(name="grey", wavelength_nm=np.array([400.0, 1700.0]), reflectance=np.array([0.2, 0.2])),),
        targets=tuple(
            Target(id=f"P{k}", kind="panel", mark_m=np.zeros(3), azimuth_deg=0.0, size_m=2.0) for k in range(2)
        ),
        layout=Layout(camera_half_m=(1, 1), lidar_half_m=1, cone_half_m=1, field_half_m=(1, 1)),
    )
    assert target_regions(plain(), pose(), scene) == [(0, 314, 194, 366, 246)]
