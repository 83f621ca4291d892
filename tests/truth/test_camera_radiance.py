"""The renderer against closed forms: radiance of panels, an opposition peak, light between two surfaces, places of corners."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from campaign.config import Band, Camera, Environment, Lens, Render, Site
from scenes.model import Layout, Material, Mesh, Scene, SunSky, Target
from scenes.sunsky import band_irradiance, sky_normalisation, sky_radiance_relative, sun_sky
from simulator.camera.view import FramePose, project, target_regions
from simulator.render import ambient, radiance
from simulator.render.scene import RenderScene, load_scene

NADIR = np.diag([1.0, -1.0, -1.0])
SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
TWO = np.array([[0, 1, 2], [0, 2, 3]])
NO_LAYOUT = Layout(camera_half_m=(1, 1), lidar_half_m=1, cone_half_m=1, field_half_m=(1, 1))


def grey(rho: float, **more: float) -> Material:
    return Material(name="grey", wavelength_nm=np.array([400.0, 1700.0]), reflectance=np.array([rho, rho]), **more)


def squares(*pieces: tuple[np.ndarray, int, int], materials: tuple[Material, ...]) -> RenderScene:
    """Quadrilaterals (4 corners, material, target)."""
    count = len(pieces)
    return load_scene(
        Scene(
            mesh=Mesh(
                vertices_m=np.concatenate([corners for corners, _, _ in pieces]),
                faces=np.concatenate([TWO + 4 * k for k in range(count)]).astype(np.int32),
                material=np.repeat([m for _, m, _ in pieces], 2).astype(np.int32),
                target=np.repeat([t for _, _, t in pieces], 2).astype(np.int32),
                part=np.full(2 * count, 12, np.int8),
            ),
            materials=materials,
            targets=(Target(id="P01", kind="panel", mark_m=np.zeros(3), azimuth_deg=0.0, size_m=2.0),),
            layout=NO_LAYOUT,
        )
    )


def camera(**changes: object) -> Camera:
    values: dict = {
        "width_px": 64,
        "height_px": 64,
        "pixel_size_um": 4.5,
        "nominal_focal_length_mm": 13.5,
        "lens": Lens(fx_px=1000.0, fy_px=1000.0, cx_px=32.0, cy_px=32.0),
        "bands": (
            Band(name="green", centre_nm=540.0, fwhm_nm=75.0),
            Band(name="blue", centre_nm=465.0, fwhm_nm=70.0),
        ),
    }
    return Camera(**(values | changes))


def above(height_m: float = 10.0, **changes: object) -> FramePose:
    values: dict = {
        "position_world_m": np.array([0.0, 0.0, height_m]),
        "world_from_camera": NADIR,
        "velocity_world_m_s": np.zeros(3),
        "angular_rate_camera_rad_s": np.zeros(3),
        "gps_time_s": 0.0,
    }
    return FramePose(**(values | changes))


@pytest.fixture(scope="module")
def light() -> SunSky:
    return sun_sky(Site(), Environment(), datetime(2026, 6, 12, 1, 0, tzinfo=UTC))


@pytest.mark.parametrize("bounces", [0, 1])
def test_level_panel_under_sun_and_sky(light: SunSky, bounces: int) -> None:
    """Rationale: the whole radiometric half stands on it.

    Expected: rho/pi (E_direct cos(zenith angle) + E_diffuse) in both bands.
    Tolerance: 0.1 %; the sky's samples leave 0.02 % on the mean of 4096 pixels, single pixels 0.5 %.
    """
    rendered = radiance.render_frame(
        squares((SQUARE, 0, -1), materials=(grey(0.5),)), camera(), above(), light, Render(bounces=bounces), 1, (1,), []
    )
    for band, picture in zip(camera().bands, np.moveaxis(rendered, -1, 0)):
        direct, diffuse = band_irradiance(light, band)
        expected = 0.5 / np.pi * (direct * light.to_sun[2] + diffuse)
        assert picture.mean() == pytest.approx(expected, rel=1e-3)
        assert picture.std() / expected < 5e-3


def test_tilted_panel_under_sun_and_sky(light: SunSky) -> None:
    """Rationale: frustum faces are tilted; a tilted surface weighs the sky differently, and sees the ground.

    Expected: rho/pi (E_direct cos(incidence) + integral of the CIE sky over the panel's hemisphere + (1 - cos tilt)/2 of
    the ground's E). The scene is the panel alone; beyond a scene the kernel puts ground of the first material.
    Tolerance: 0.3 %: the sky in cells of some 5 degrees.
    """
    tilt = np.radians(40.0)
    turn = np.array([[np.cos(tilt), 0, -np.sin(tilt)], [0, 1, 0], [np.sin(tilt), 0, np.cos(tilt)]])
    normal = turn @ [0.0, 0.0, 1.0]
    scene = squares((SQUARE @ turn.T, 0, -1), materials=(grey(0.5),))
    rendered = radiance.render_frame(scene, camera(), above(), light, Render(samples=16), 1, (1,), [])
    z = (np.arange(1000) + 0.5) / 1000
    azimuth = 2 * np.pi * (np.arange(720) + 0.5) / 720
    level = np.sqrt(1 - z**2)[:, None]
    grid = np.stack(np.broadcast_arrays(level * np.cos(azimuth), level * np.sin(azimuth), z[:, None]), axis=-1)
    sky = sky_radiance_relative(grid, light.to_sun) * np.maximum(grid @ normal, 0)
    share = sky.sum() * 2 * np.pi / 720 / 1000 / sky_normalisation(light.to_sun)
    for band, picture in zip(camera().bands, np.moveaxis(rendered, -1, 0)):
        direct, diffuse = band_irradiance(light, band)
        ground = 0.5 * (direct * light.to_sun[2] + diffuse) * (1 - np.cos(tilt)) / 2
        expected = 0.5 / np.pi * (direct * max(light.to_sun @ normal, 0) + diffuse * share + ground)
        assert picture.mean() == pytest.approx(expected, rel=3e-3)


def test_light_from_a_wall(light: SunSky) -> None:
    """Rationale: a bounce that is too strong or too weak tilts the reflectance of everything near a target.

    Expected: a level strip at the foot of a very long, very high white wall, both in an even sky: with the sun along the
    wall neither is lit by it (it is switched off), so with one bounce the strip receives half its sky and half the wall's
    light: E (1/2 + 1/2 rho_w * 1/2) with the wall seeing half a sky, its other half the dark ground (rho 0) -- at a
    uniform sky. The CIE sky is not uniform: the wall's and strip's shares are integrated numerically.
    Tolerance: 1 %: a wall of 200 x 200 m instead of an endless one.
    """
    dark = SunSky(
        to_sun=np.array([0.0, 0.6, 0.8]),
        elevation_deg=53.13,
        azimuth_deg=0.0,
        wavelength_nm=light.wavelength_nm,
        direct_normal=0 * light.direct_normal,
        diffuse_horizontal=light.diffuse_horizontal,
        illuminance_lx=1.0,
    )
    wall = np.array([[1.0, -100.0, -0.01], [1.0, 100.0, -0.01], [1.0, 100.0, 200.0], [1.0, -100.0, 200.0]])
    strip = SQUARE * [0.5, 0.5, 1.0] + [0.5, 0, 0]
    ground = np.array([[-300.0, -300, -0.02], [300, -300, -0.02], [300, 300, -0.02], [-300, 300, -0.02]])
    scene = squares((ground, 2, -1), (strip, 0, 0), (wall, 1, 0), materials=(grey(0.5), grey(0.8), grey(0.0)))
    view = above(1.5, position_world_m=np.array([0.97, 0.0, 1.5]))
    lens = Lens(fx_px=3e4, fy_px=3e4, cx_px=32.0, cy_px=32.0)
    rendered = radiance.render_frame(scene, camera(lens=lens), view, dark, Render(samples=64, bounces=1), 1, (1,), [])
    z = (np.arange(1000) + 0.5) / 1000
    azimuth = 2 * np.pi * (np.arange(720) + 0.5) / 720
    level = np.sqrt(1 - z**2)[:, None]
    grid = np.stack(np.broadcast_arrays(level * np.cos(azimuth), level * np.sin(azimuth), z[:, None]), axis=-1)
    sky = sky_radiance_relative(grid, dark.to_sun) / sky_normalisation(dark.to_sun) * 2 * np.pi / 720 / 1000
    half = (sky * grid[..., 2] * (grid[..., 0] < 0)).sum()
    on_wall = (sky * np.maximum(-grid[..., 0], 0)).sum()
    for band, picture in zip(camera().bands, np.moveaxis(rendered, -1, 0)):
        diffuse = band_irradiance(dark, band)[1]
        expected = 0.5 / np.pi * diffuse * (half + 0.5 * 0.8 * on_wall)
        assert picture.mean() == pytest.approx(expected, rel=0.01)


def test_opposition_peak(light: SunSky) -> None:
    """Rationale: panels leave Lambert most where the LiDAR looks; the camera meets the peak only with the sun behind it.

    Expected: with the camera on the sun's ray direct light is 1 + gain, 0.1 rad off it 1 + gain exp(-0.1/width).
    Tolerance: 0.5 %: the sun's disc of 0.0047 rad and the field's 0.064 rad average the peak; the middle 4 x 4 pixels.
    """
    scene = squares((SQUARE, 0, -1), materials=(grey(0.5, opposition_gain=0.4, opposition_width_rad=0.2),))
    for off in (0.0, 0.1):
        angle = off
        direction = light.to_sun * np.cos(angle)
        across = np.cross(light.to_sun, [0.0, 0.0, 1.0])
        direction = direction + across / np.linalg.norm(across) * np.sin(angle)
        right = np.cross(-direction, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(-direction, right), -direction], axis=1)
        view = above(position_world_m=10 * direction, world_from_camera=axes)
        rendered = radiance.render_frame(scene, camera(), view, light, Render(samples=64), 1, (1,), [])
        direct, diffuse = band_irradiance(light, camera().bands[0])
        # Mean of exp(-phase/width) over the sun's disc, which is 2/3 of its radius from the middle.
        phase = np.hypot(off, 0.0) if off else 2 / 3 * 0.00465 + 0.0009
        expected = 0.5 / np.pi * (direct * light.to_sun[2] * (1 + 0.4 * np.exp(-phase / 0.2)) + diffuse)
        assert rendered[30:34, 30:34, 0].mean() == pytest.approx(expected, rel=5e-3)


def corner_px(picture: np.ndarray) -> np.ndarray:
    """Place of the corner of a white quadrant (x > 0, y > 0, so right and up) on black, from its two edges' places.

    Along every row (column) far from the corner the edge is where the picture's sum from the dark side says: exact for any
    symmetric spread.
    """
    white, black = picture[2:14, -14:-2].mean(), picture[-14:-2, 2:14].mean()
    share = (picture - black) / (white - black)
    _, width = share.shape
    rows, columns = slice(4, 14), slice(width - 14, width - 4)
    u = width - share[rows].sum(axis=1).mean()
    v = share[:, columns].sum(axis=0).mean()
    return np.array([u, v])


@pytest.mark.parametrize("shutter", ["global", "rolling"])
def test_corner_stands_where_the_projection_says(light: SunSky, shutter: str) -> None:
    """Rationale: truth/marks.csv is projected, pictures are rendered; the calibration error compares the two.

    Expected: the corner of a bright square at `project` of it, with a strong lens, off axis, in motion, both shutters.
    Tolerance: 0.02 px; the fit of the corner finds 0.005 px.
    """
    cam = camera(
        width_px=2000,
        height_px=1600,
        lens=Lens(
            fx_px=3000.0, fy_px=2998.0, cx_px=1012.3, cy_px=790.7, k1=-0.05, k2=0.02, k3=-0.1, p1=0.0019, p2=-0.0017
        ),
        shutter=shutter,
        readout_time_s=0.02 if shutter == "rolling" else 0.0,
    )
    big = 30 * SQUARE
    for corner in (np.array([0.9, 0.7]), np.array([9.0, -7.0])):
        at = np.array([corner[0], corner[1], 0.0])
        view = above(
            30.0,
            velocity_world_m_s=np.array([3.0, 5.0, -0.5]),
            angular_rate_camera_rad_s=np.array([0.05, -0.08, 0.1]) if shutter == "rolling" else np.zeros(3),
        )
        pixel = project(cam, view, at[None])[0][0]
        # A square with this corner whose sides follow the image's rows and columns there: the lens turns them.
        step = 1e-3
        jacobian = np.stack(
            [(project(cam, view, at[None] + step * e)[0][0] - pixel) / step for e in np.eye(3)[:2]], axis=1
        )
        sides = np.linalg.inv(jacobian) @ np.diag([1.0, -1.0])
        sides /= np.linalg.norm(sides, axis=0)
        quad = np.zeros((4, 3))
        quad[:, :2] = corner + 0.6 * np.array([0 * sides[:, 0], sides[:, 0], sides.sum(axis=1), sides[:, 1]])
        scene = squares((big - [0, 0, 0.001], 0, -1), (quad, 1, 0), materials=(grey(0.05), grey(0.9)))
        u, v = np.floor(pixel).astype(int)
        box = [(0, u - 22, v - 22, u + 22, v + 22)]
        rendered = radiance.render_frame(
            scene, cam, view, light, Render(samples=1, target_samples=256), 1, (1,), box, tile=1 << 20
        )
        patch = rendered[v - 20 : v + 20, u - 20 : u + 20, 0].astype(float)
        assert corner_px(patch) + [u - 20, v - 20] == pytest.approx(pixel, abs=0.02)


def test_boxes_leave_no_seam(light: SunSky) -> None:
    """Rationale: inside a box the point spread is summed over sub-pixels, outside it is drawn; a picture has one spread.

    Expected: the same picture of a slanting edge, rendered inside and outside a box, and a box that ends at the image's border.
    Tolerance: 128 drawn samples leave 0.010 of white in a pixel at an edge: 5 sigma for the worst pixel, 0.013 for their RMS,
    and 0.05 % for the mean.
    """
    turned = SQUARE @ np.array([[0.9, 0.3, 0], [-0.3, 0.9, 0], [0, 0, 1]]) * 0.25 + [0.2, 0.1, 0.0]
    scene = squares((30 * SQUARE - [0, 0, 0.001], 0, -1), (turned, 1, 0), materials=(grey(0.05), grey(0.9)))
    cam = camera()
    drawn = radiance.render_frame(scene, cam, above(), light, Render(samples=128), 1, (1,), [])
    summed = radiance.render_frame(
        scene, cam, above(), light, Render(samples=1, target_samples=128), 2, (1,), [(0, 0, 0, 64, 64)]
    )
    difference = (summed - drawn) / drawn.max()
    at_edge = (summed > 0.15 * summed.max()) & (summed < 0.85 * summed.max())
    assert at_edge.sum() > 200
    assert np.sqrt(np.mean(difference[at_edge] ** 2)) < 0.013
    assert np.abs(difference).max() < 0.05
    assert abs(difference.mean()) < 5e-4


@pytest.fixture(scope="module")
def frustum_range() -> tuple[RenderScene, Camera, FramePose]:
    """One inverted frustum on its plate, as scenes builds it, 40 m below the camera."""
    from campaign.config import Frustums
    from scenes.frustums import FrustumMaterials, frustum_body

    body = frustum_body(Frustums(), FrustumMaterials(face=1, plate=2, white=1, black=3, metal=2), stand_m=0.3)
    ground = 30 * SQUARE - [0, 0, 0.3]
    faces = np.concatenate([body.faces, TWO + len(body.vertices_m)])
    count = len(body.faces)
    scene = Scene(
        mesh=Mesh(
            vertices_m=np.concatenate([body.vertices_m, ground]),
            faces=faces.astype(np.int32),
            material=np.concatenate([np.broadcast_to(body.material, count), [0, 0]]).astype(np.int32),
            target=np.concatenate([np.zeros(count), [-1, -1]]).astype(np.int32),
            part=np.concatenate([np.broadcast_to(body.part, count), [-1, -1]]).astype(np.int8),
        ),
        materials=(grey(0.15), grey(0.9), grey(0.3), grey(0.05)),
        targets=(Target(id="F01", kind="frustum", mark_m=np.zeros(3), azimuth_deg=0.0, size_m=0.8, style="inverted"),),
        layout=NO_LAYOUT,
    )
    cam = camera(width_px=128, height_px=128, lens=Lens(fx_px=3000.0, fy_px=3000.0, cx_px=64.0, cy_px=64.0))
    return load_scene(scene), cam, above(40.0, position_world_m=np.array([0.2, -0.15, 40.0]))


def test_table_of_inner_light_is_not_biased(
    frustum_range: tuple[RenderScene, Camera, FramePose], light: SunSky, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: the light among a funnel's faces comes from a table; paths without it are the reference.

    Expected: the same mean radiance on the mark, on the plate and on each inner face.
    Tolerance: 0.3 % of a sunlit face: the reference's own noise is 0.15 %, the grid of 7 cm and the sun rounded by 0.6
    degrees do the rest.
    """
    scene, cam, view = frustum_range
    view = above(40.0)
    region = target_regions(cam, view, scene.scene)
    settings = Render(samples=1, target_samples=64)
    with_table = radiance.render_frame(scene, cam, view, light, settings, 1, (1,), region)
    monkeypatch.setattr(radiance, "ambient_table", lambda *_: None)
    without = radiance.render_frame(scene, cam, view, light, settings, 2, (1,), region)
    centre = project(cam, view, np.zeros((1, 3)))[0][0]
    y, x = np.mgrid[:128, :128] + 0.5 - centre[[1, 0], None, None]
    scale = 3000 / 40
    parts = {"mark": np.hypot(x, y) < 0.14 * scale}
    for name, along, beside in (("right", x, y), ("left", -x, y), ("low", y, x), ("high", -y, x)):
        parts[name] = (along > 0.24 * scale) & (along < 0.38 * scale) & (np.abs(beside) < 0.8 * along)
    tolerance = 3e-3 * float(without[parts["left"]].mean())
    for name, part in parts.items():
        assert part.sum() > 100
        assert with_table[part].mean(axis=0) == pytest.approx(without[part].mean(axis=0), abs=tolerance), name


def test_facets_cover_inner_faces_and_plate(frustum_range: tuple[RenderScene, Camera, FramePose]) -> None:
    """Rationale: a facet with nodes off its face would read light from inside a wall.

    Expected: four faces and the plate's top; nodes on their planes; those of the plate at z = 0, of the faces on the planes
    through the mark's centre that rise by 54.74 degrees.
    Tolerance: rounding.
    """
    scene = frustum_range[0].scene
    flat = ambient.facets(scene)
    assert len(flat.origin) == 5
    assert set(np.unique(scene.mesh.part[flat.face >= 0])) == {0, 1, 2, 3, 8, 9}
    for node, normal in zip(flat.node, flat.normal):
        assert node @ normal == pytest.approx(0.0, abs=1e-9)  # all five planes pass through the mark
    assert np.sort(flat.normal[:, 2]) == pytest.approx([1 / np.sqrt(3)] * 4 + [1.0])
    assert flat.node[4, :, 2] == pytest.approx(0.0)


def test_render_noise_against_the_sensor(frustum_range: tuple[RenderScene, Camera, FramePose], light: SunSky) -> None:
    """Rationale: what a campaign's noise is must be the sensor's, not the renderer's.

    Expected: two seeds' difference inside the target's box, over the sensor's noise at the same signal, at most a half
    away from edges and at most one and a half at them.
    Tolerance: the limits themselves.
    """
    from simulator.camera.sensor import exposure_gain, sensor_noise_std_dn

    scene, cam, view = frustum_range
    region = target_regions(cam, view, scene.scene)
    _, u0, v0, u1, v1 = region[0]
    a, b = (
        radiance.render_frame(scene, cam, view, light, Render(), seed, (1,), region)[v0:v1, u0:u1].astype(float)
        for seed in (1, 2)
    )
    exposing = exposure_gain(cam, light)
    factor = exposing.e_per_radiance / exposing.e_per_dn
    noise = np.abs(a - b) / np.sqrt(2) * factor / sensor_noise_std_dn(0.5 * (a + b) * factor, cam, exposing)
    typical = float(np.median(noise) / 0.6745)
    overall = float(np.sqrt(np.mean(noise**2)))
    print(f"render noise over sensor noise in the box: {typical:.2f} typical, {overall:.2f} RMS")
    assert typical < 0.5
    assert overall < 1.5


def test_bands_of_rows_are_the_whole_picture(
    frustum_range: tuple[RenderScene, Camera, FramePose], light: SunSky, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: a large frame comes in bands of rows; a target's box that lies across them must not show where. Expected: eight
    bands of 16 rows make the picture that comes as one. Tolerance: last digits: a band begins a packet of rays of its own."""
    scene, cam, view = frustum_range
    region = target_regions(cam, view, scene.scene)
    frame = (scene, cam, view, light, Render(samples=2, target_samples=4), 1, (1, 1), region)
    whole = radiance.render_frame(*frame)
    monkeypatch.setattr(radiance, "BAND_PIXELS", 16 * cam.width_px)
    bands = list(radiance.render_bands(*frame))
    assert [len(band) for band in bands] == [16] * 8 and region[0][2] < 48 and region[0][4] > 80
    assert np.concatenate(bands) == pytest.approx(whole, rel=1e-5)


def test_same_bytes_for_other_tiles_and_threads(
    frustum_range: tuple[RenderScene, Camera, FramePose], light: SunSky, tmp_path: Path
) -> None:
    """Rationale: the same seed gives the same campaign on any machine of one kind.

    Expected: identical pictures for two sizes of tile and for one and two threads; another seed or frame differs.
    Tolerance: none.
    """
    from simulator.render import start

    scene, cam, view = frustum_range
    region = target_regions(cam, view, scene.scene)
    settings = Render(samples=2, target_samples=4)

    def render(seed: int = 1, key: tuple[int, ...] = (1, 1), tile: int = 1 << 20) -> np.ndarray:
        ambient._kept.clear()
        return radiance.render_frame(scene, cam, view, light, settings, seed, key, region, tile=tile)

    first = render()
    assert (first == render(tile=1024)).all()
    start(threads=1)
    try:
        assert (first == render()).all()
    finally:
        start()
    assert (first == render()).all()
    assert (first != render(seed=2)).mean() > 0.5
    assert (first != render(key=(1, 2))).mean() > 0.5
