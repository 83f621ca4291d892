"""Mark centres on rendered pictures: the simulator's target, light and sensor on one side, the evaluator's fit on the other.

Acceptance 9 of the second part: shadow cannot bias a mark. A target's funnel shades and hides up to a third of its mark, and the
sun at 54.7 degrees lies in a face's plane: there the shadow is a line through the centre, thinner than the penumbra.
"""

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from typing import Literal

import numpy as np
import pytest

from campaign.config import Band, Camera, Environment, Frustums, Lens, Render, Site
from evaluator.observe.frustums import FrustumModel
from evaluator.observe.mark_view import MarkView
from evaluator.observe.marks import MarkFit, find_mark
from evaluator.observe.target_view import sheet_corners
from scenes.frustums import FrustumMaterials, frustum_body
from scenes.model import Layout, Mesh, Scene, SunSky, Target
from scenes.shapes import placed
from scenes.spectra import material
from scenes.sunsky import sun_sky
from simulator.camera.sensor import expose, exposure_gain, fixed_pattern
from simulator.camera.view import FramePose, project, target_regions
from simulator.render.radiance import render_frame
from simulator.render.scene import RenderScene, load_scene

FRUSTUMS = Frustums()
FOCAL_PX = 3000.0
CAMERA = Camera(
    width_px=400,
    height_px=400,
    pixel_size_um=4.5,
    nominal_focal_length_mm=13.5,
    bands=(Band(name="green", centre_nm=540.0, fwhm_nm=75.0),),
    lens=Lens(fx_px=FOCAL_PX, fy_px=FOCAL_PX, cx_px=200.0, cy_px=200.0),
)
SPACING_M = 2.2
ROWS = 3
WRONG = np.radians(0.5)  # the prediction's error in direction: an unknown boresight


@dataclass(frozen=True, kw_only=True)
class Photograph:
    """A rendered picture of all targets, and what a surveyor and a navigator would know."""

    grey: np.ndarray
    truth_px: np.ndarray  # (n, 2)
    views: list[MarkView]
    off_zenith_deg: np.ndarray  # (n,) of each target's line of sight


@cache
def range_of_targets() -> tuple[Scene, RenderScene]:
    """Nine targets on a wide ground, each turned by another angle."""
    names = ("dry_grass", "metal_stand", "grey_paint", FRUSTUMS.material, FRUSTUMS.material, "black_paint")
    materials = FrustumMaterials(metal=1, plate=2, face=3, white=4, black=5)
    ground = np.array([[-100.0, -100.0, -0.5], [100.0, -100.0, -0.5], [100.0, 100.0, -0.5], [-100.0, 100.0, -0.5]])
    vertices, faces = [ground], [np.array([[0, 1, 2], [0, 2, 3]])]
    material_of, owner, part = [np.zeros(2)], [np.full(2, -1)], [np.full(2, -1)]
    targets = []
    for k in range(ROWS**2):
        mark = np.array([SPACING_M * (k % ROWS - 1), SPACING_M * (k // ROWS - 1), 0.0])
        azimuth = 40.0 * k % 90.0
        piece = placed(frustum_body(FRUSTUMS, materials, 0.6), mark, azimuth)
        faces.append(piece.faces + sum(map(len, vertices)))
        vertices.append(piece.vertices_m)
        material_of.append(piece.material)
        owner.append(np.full(len(piece.faces), k))
        part.append(piece.part)
        targets.append(Target(id=f"F{k + 1:02d}", kind="frustum", mark_m=mark, azimuth_deg=azimuth, size_m=0.8))
    scene = Scene(
        mesh=Mesh(
            vertices_m=np.concatenate(vertices),
            faces=np.concatenate(faces).astype(np.int32),
            material=np.concatenate(material_of).astype(np.int32),
            target=np.concatenate(owner).astype(np.int32),
            part=np.concatenate(part).astype(np.int8),
        ),
        materials=tuple(material(name) for name in names),
        targets=tuple(targets),
        layout=Layout(camera_half_m=(1, 1), lidar_half_m=1, cone_half_m=1, field_half_m=(1, 1)),
    )
    return scene, load_scene(scene)


@cache
def light(elevation_deg: float, azimuth_deg: float) -> SunSky:
    """A clear June morning's spectra from any direction."""
    morning = sun_sky(Site(), Environment(), datetime(2026, 6, 12, 2, 30, tzinfo=UTC))
    e, a = np.radians(elevation_deg), np.radians(azimuth_deg)
    towards = np.array([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)])
    return replace(morning, to_sun=towards, elevation_deg=elevation_deg, azimuth_deg=azimuth_deg)


def photograph(
    rng: np.random.Generator,
    sun: SunSky,
    view_deg: float,
    view_azimuth_deg: float,
    *,
    height_m: float = 55.0,
    turn_deg: float = 25.0,
    samples: Literal[32, 256] = 32,
) -> Photograph:
    """The camera looks at the middle target from `view_deg` off the zenith."""
    scene, loaded = range_of_targets()
    a, t = np.radians(view_azimuth_deg), np.tan(np.radians(view_deg))
    eye = height_m * np.array([t * np.sin(a), t * np.cos(a), 1.0])
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    forward = -eye / np.linalg.norm(eye)
    forward += np.array([*rng.uniform(-0.5, 0.5, 2), 0.0]) / FOCAL_PX  # the marks' places within a pixel
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [s, c, 0.0])
    right /= np.linalg.norm(right)
    pose = FramePose(
        position_world_m=eye,
        world_from_camera=np.stack([right, np.cross(forward, right), forward], axis=1),
        velocity_world_m_s=np.zeros(3),
        angular_rate_camera_rad_s=np.zeros(3),
        gps_time_s=0.0,
    )
    radiance = render_frame(
        loaded,
        CAMERA,
        pose,
        sun,
        Render(samples=2, target_samples=samples, bounces=1),
        int(rng.integers(1 << 30)),
        (1,),
        target_regions(CAMERA, pose, scene),
    )
    image = expose(radiance, CAMERA, exposure_gain(CAMERA, sun), 1.0, rng, fixed_pattern(rng))
    turned = np.array([[np.cos(WRONG), -np.sin(WRONG)], [np.sin(WRONG), np.cos(WRONG)]])
    marks = np.stack([target.mark_m for target in scene.targets])
    truth, _ = project(CAMERA, pose, marks)
    lines = eye - marks
    views = []
    for target, place, line in zip(scene.targets, truth, lines, strict=True):
        turn = np.radians(target.azimuth_deg)
        axes = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]).T
        steps, _ = project(CAMERA, pose, target.mark_m + 1e-3 * axes[:, :2].T)
        model = FrustumModel(
            target=target.id,
            vertex_world_m=target.mark_m,
            world_from_target=axes,
            long_edge_m=FRUSTUMS.long_edge_m,
            inverted=True,
            thickness_m=FRUSTUMS.thickness_m,
        )
        views.append(
            MarkView(
                predicted_px=place + rng.uniform(-12.0, 12.0, 2),
                px_per_m=turned @ (steps - place).T / 1e-3,
                radius_m=FRUSTUMS.mark_radius_m,
                sheets_m=sheet_corners(model),
                eye_m=axes.T @ line + rng.normal(0.0, 0.05, 3),
                to_sun=axes.T @ sun.to_sun,
            )
        )
    off_zenith = np.degrees(np.arccos(lines[:, 2] / np.linalg.norm(lines, axis=1)))
    return Photograph(grey=image.mean(axis=2), truth_px=truth, views=views, off_zenith_deg=off_zenith)


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Every mark of one picture."""

    error_px: np.ndarray  # (n, 2)
    z: np.ndarray  # (n, 2) errors whitened by the stated covariance
    reasons: list[str]


def measure(picture: Photograph) -> Measured:
    errors, z, reasons = [], [], []
    for truth, view in zip(picture.truth_px, picture.views, strict=True):
        found = find_mark(picture.grey, view, 20.0)
        if not isinstance(found, MarkFit):
            reasons.append(found)
            continue
        errors.append(found.uv_px - truth)
        z.append(np.linalg.solve(np.linalg.cholesky(found.covariance_px2), errors[-1]))
    return Measured(error_px=np.reshape(errors, (-1, 2)), z=np.reshape(z, (-1, 2)), reasons=reasons)


def check(found: Measured, group: tuple[float, ...], least: int, most_z: float = 5.0) -> None:
    """A group is one direction of the sun and one of the view, over nine places in a pixel and nine turns of the target."""
    bias, spread = found.error_px.mean(axis=0), found.error_px.std()
    print(
        f"sun {group[0]:.1f}/{group[1]:.0f} view {group[2]:.0f}/{group[3]:.0f} deg: {len(found.error_px)} marks, "
        f"bias {bias[0]:+.3f} {bias[1]:+.3f}, spread {spread:.3f} px, z {found.z.std():.2f}, at most {np.abs(found.z).max():.1f}"
    )
    assert len(found.error_px) >= least, (group, found.reasons)
    assert np.abs(bias).max() <= 0.05, (group, found.error_px)
    assert spread <= 0.1, (group, found.error_px)
    assert np.abs(found.z).max() <= most_z, (group, found.error_px, found.z)


@pytest.mark.parametrize(
    ("elevation_deg", "sun_azimuth_deg", "view_deg", "view_azimuth_deg", "height_m", "least"),
    [
        (54.0, 10.0, 0.0, 0.0, 65.0, 8),
        (54.7, 130.0, 20.0, 200.0, 55.0, 8),
        (70.0, 300.0, 35.0, 320.0, 45.0, 4),
        (60.0, 200.0, 40.0, 20.0, 45.0, 3),
    ],
)
def test_marks_on_renders(
    elevation_deg: float, sun_azimuth_deg: float, view_deg: float, view_azimuth_deg: float, height_m: float, least: int
) -> None:
    """Rationale: acceptance 9: shadow, funnel, penumbra, light between the faces, blur, noise and the sensor's steps at once,
    made by a renderer that shares nothing with the fit. Some directions of the whole grid, the worst suns among them.

    Expected: no bias; deviations as stated. From 35 degrees off the zenith a face hides the middle of a mark that is seen along
    a side: a reason instead of a centre is right there, so fewer need be found.
    Tolerance: bias 0.05 px (acceptance 9), spread 0.1 px, no error over five stated deviations.
    """
    group = (elevation_deg, sun_azimuth_deg, view_deg, view_azimuth_deg)
    rng = np.random.default_rng(int(10 * sum(group)))
    sun = light(elevation_deg, sun_azimuth_deg)
    check(measure(photograph(rng, sun, view_deg, view_azimuth_deg, height_m=height_m)), group, least)


@pytest.mark.slow
@pytest.mark.parametrize("elevation_deg", [36.0, 45.0, 54.0, 54.7, 60.0, 70.0])
@pytest.mark.parametrize("view_deg", [0.0, 20.0, 35.0, 40.0])
def test_whole_grid_of_suns_and_views(elevation_deg: float, view_deg: float) -> None:
    """Rationale, expected, tolerance: as `test_marks_on_renders`, over four azimuths of sun and view; and the stated
    deviations are honest as a whole: whitened errors spread by 0.6 to 1.5. At 40 degrees a mark keeps so few clear pixels
    that one error in a hundred (0.06 px) passes five stated deviations; 6.5 is the bound there."""
    rng = np.random.default_rng(int(10 * elevation_deg + view_deg))
    z = []
    for k in range(4):
        group = (elevation_deg, 17.0 + 100.0 * k, view_deg, 80.0 + 67.0 * k)
        height = 45.0 if view_deg > 30.0 else 65.0 - 5.0 * (k % 3)  # slant: a mark needs some 35 clear pixels
        picture = photograph(rng, light(*group[:2]), *group[2:], height_m=height)
        found = measure(picture)
        check(found, group, 6 if view_deg < 30.0 else 2, 5.0 if view_deg < 40.0 else 6.5)
        z.append(found.z)
    assert 0.6 < np.std(np.concatenate(z)) < 1.5, z
