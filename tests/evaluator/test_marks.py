"""Mark centres on pictures made here, beam by beam: the target in three dimensions, sun, sky, blur, pixel and noise.

The picture tests every sub-sample's line of sight and line to the sun against the funnel in space; the evaluator projects the
funnel's outlines on the plate. Nothing is shared but the target's size.
"""

from dataclasses import replace

import numpy as np
import pvlib
import pytest
import scipy.ndimage

from evaluator.observe.frustums import FrustumModel
from evaluator.observe.mark_view import MarkView
from evaluator.observe.marks import MarkFit, find_mark
from evaluator.observe.target_view import sheet_corners, to_sun

B, SHEET, RADIUS = 0.8, 0.0015, 0.16
MODEL = FrustumModel(
    target="F01",
    vertex_world_m=np.zeros(3),
    world_from_target=np.eye(3),
    long_edge_m=B,
    inverted=True,
    thickness_m=SHEET,
)


def blocked(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Whether rays from the plate meet the funnel's sheet."""
    hit = np.zeros(len(origin), dtype=bool)
    for k in range(4):
        axis = np.array([np.sin(k * np.pi / 2), np.cos(k * np.pi / 2)])
        for other in (0.0, SHEET * np.sqrt(1.5)):
            normal = np.array([*axis, -1.0 / np.sqrt(2.0)])
            with np.errstate(divide="ignore", invalid="ignore"):
                t = (other - origin @ normal) / (direction @ normal)
                p = origin + t[:, None] * direction
            run = p[:, :2] @ axis
            across = np.abs(p[:, 0] * axis[1] - p[:, 1] * axis[0])
            z = p[:, 2] / np.sqrt(2.0)
            hit |= (z > 0.25 * B) & (z < 0.5 * B) & (across <= run) & (t > 1e-9)
    return hit


def disc_of(sun: np.ndarray) -> np.ndarray:
    """Directions over the sun's disc, of equal weight: (12, 3). The evaluator has a ring of six."""
    across = np.cross(sun, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    k = np.arange(12)
    r, turn = np.radians(0.2666) * np.sqrt((k + 0.5) / 12), 2.39996 * k
    return np.asarray(sun + (r * np.cos(turn))[:, None] * across + (r * np.sin(turn))[:, None] * np.cross(sun, across))


def picture(
    rng: np.random.Generator,
    view_deg: float,
    view_azimuth_deg: float,
    sun: np.ndarray,
    *,
    height: float = 55.0,
    focal: float = 3000.0,
    turn_deg: float = 25.0,
    noise: float = 0.006,
    blur_px: float = 0.45,
    offset: tuple[float, float] = (20.0, -15.0),
    size: int = 76,
) -> tuple[np.ndarray, np.ndarray, MarkView]:
    """(picture, true centre, prediction). Nadir camera turned by `turn_deg`; the prediction is off by `offset` and 0.5 degrees."""
    fine = 6
    a, t = np.radians(view_azimuth_deg), np.tan(np.radians(view_deg))
    camera = np.array([height * t * np.sin(a), height * t * np.cos(a), height])
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    right, down = np.array([c, -s, 0.0]), np.array([-s, -c, 0.0])  # camera axes in the target's frame, z forward = down
    centre = size / 2.0 + rng.uniform(-0.5, 0.5, 2)

    def pixel(point: np.ndarray) -> np.ndarray:
        d = point - camera
        return focal * np.stack([d @ right, d @ down], axis=-1) / -d[..., 2:]

    base = pixel(np.zeros((1, 3)))[0] - centre  # principal point so that the mark's centre lands on `centre`
    grid = (np.arange(size * fine) + 0.5) / fine
    u, v = np.meshgrid(grid, grid)
    uv = np.stack([u.ravel(), v.ravel()], axis=-1) + base
    plate = camera + height * ((uv[:, :1] / focal) * right + (uv[:, 1:] / focal) * down + [0.0, 0.0, -1.0])
    plate[:, 2] = 0.0
    seen = ~blocked(plate, np.broadcast_to(camera, plate.shape) - plate)
    near = np.max(np.abs(plate[:, :2]), axis=1) < 0.2
    lit = np.ones(len(plate))
    lit[near] = np.mean([~blocked(plate[near], np.broadcast_to(s, (near.sum(), 3))) for s in disc_of(sun)], axis=0)
    x, y = plate[:, 0], plate[:, 1]
    albedo = np.where(x * y > 0, 0.95, 0.05)
    albedo = np.where(np.hypot(x, y) > RADIUS, 0.6, albedo)
    light = 0.75 * lit + 0.25 * (1.0 + 0.8 * x - 0.6 * y)
    value = np.where(seen, albedo * light, 0.55)
    value = np.where(np.max(np.abs(plate[:, :2]), axis=1) > 0.45, 0.15 * light, value)
    value = scipy.ndimage.gaussian_filter(value.reshape(size * fine, -1), blur_px * fine)
    image = value.reshape(size, fine, size, fine).mean(axis=(1, 3))
    image = image + rng.normal(0.0, noise, image.shape) * np.sqrt(0.2 + image)
    wrong = np.radians(0.5)
    steps = (pixel(np.array([[1e-3, 0, 0], [0, 1e-3, 0]])) - pixel(np.zeros((1, 3)))) / 1e-3
    turned = np.array([[np.cos(wrong), -np.sin(wrong)], [np.sin(wrong), np.cos(wrong)]]) @ steps.T
    off = camera + np.array([0.3, -0.3, 0.0])  # pose known to some decimetres only: boresight fault
    view = MarkView(
        predicted_px=centre + np.array(offset),
        px_per_m=turned,
        radius_m=RADIUS,
        sheets_m=sheet_corners(MODEL),
        eye_m=off,
        to_sun=sun,
    )
    return image, centre, view


def sun_at(elevation_deg: float, azimuth_deg: float) -> np.ndarray:
    e, a = np.radians(elevation_deg), np.radians(azimuth_deg)
    return np.array([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)])


@pytest.mark.parametrize("view_deg", [0.0, 15.0, 30.0, 40.0])
def test_centre_is_unbiased_for_all_suns(view_deg: float) -> None:
    """Rationale: shadows and the funnel cover up to a third of the mark; a centroid would move by more than a pixel.
    Expected: mean error zero over sun azimuths. Tolerance: bias 0.05 px on the mean of eight pictures, spread 0.1 px
    (issue: bias <= 0.05 px over sun azimuths and view angles of 0-40 degrees)."""
    rng = np.random.default_rng(int(view_deg))
    errors, z = [], []
    for k in range(8):
        sun = sun_at(48.0 + 3.0 * k, 45.0 * k)
        image, centre, view = picture(rng, view_deg, 37.0 + 61.0 * k, sun, offset=(20.0 - 3 * k, -15.0 + 2 * k))
        found = find_mark(image, view, 30.0)
        assert isinstance(found, MarkFit), (k, found)
        errors.append(found.uv_px - centre)
        z.append(errors[-1] / np.sqrt(np.diag(found.covariance_px2)))
    values = np.array(errors)
    assert np.abs(values.mean(axis=0)).max() < 0.05, values
    assert values.std() < 0.1, values
    assert 0.25 < np.std(z) < 1.4, (
        z
    )  # stated: 1.4 times the fit's own and 0.004 px, for causes that this picture has not


def test_no_mark_is_refused() -> None:
    """Rationale: a panel or bare ground must not be taken for a mark. Expected: refusal with the reason."""
    rng = np.random.default_rng(3)
    image, _, view = picture(rng, 10.0, 0.0, sun_at(60.0, 100.0))
    ground = 0.2 + 0.02 * scipy.ndimage.gaussian_filter(rng.standard_normal(image.shape), 1.0)
    assert isinstance(find_mark(ground, view, 30.0), str)
    ground[30:80, 40:90] = 0.9  # a panel: straight edges and one corner in view of the template
    assert isinstance(find_mark(ground, view, 30.0), str)


def test_mark_at_the_image_border_is_refused() -> None:
    """Rationale: a mark half outside has no centre to fit. Expected: refusal, no index error."""
    image, _, view = picture(np.random.default_rng(4), 10.0, 0.0, sun_at(60.0, 100.0))
    edge = MarkView(**{**vars(view), "predicted_px": np.array([-30.0, 20.0])})
    assert isinstance(find_mark(image[:, 70:], edge, 5.0), str)


def test_hidden_centre_is_refused() -> None:
    """Rationale: an upright funnel is open at the top only; its sheet stands before the centre from 35.26 degrees off the zenith
    along a side (half the small rim over its height, b/4 over 0.3536 b). What is then in view must not become a centre.
    Expected: refusal beyond, none for that reason before; an inverted funnel's centre is seen from everywhere.
    Tolerance: 1.5 degrees, half a pixel of the mark."""
    rng = np.random.default_rng(6)
    for inverted, angle, hidden in (
        (False, 33.7, False),
        (False, 37.5, True),
        (True, 33.7, False),
        (True, 37.5, False),
    ):
        image, _, view = picture(rng, angle, 90.0, sun_at(60.0, 200.0), noise=0.002)
        sheets = sheet_corners(replace(MODEL, inverted=inverted))
        found = find_mark(image, replace(view, sheets_m=sheets), 30.0)
        assert (found == "the funnel hides the centre") == hidden, (inverted, angle, found)


def test_sliver_of_shadow_along_a_sector_edge() -> None:
    """Rationale: the sun in a face's plane (54.7 degrees up, along a side) draws a line of half shade along a sector's edge, a
    third of a pixel wide. Its brightness, left free, once drew centres by 0.8 px.
    Expected: centres as elsewhere. Tolerance: 0.05 px each, five times the noise; five stated deviations."""
    rng = np.random.default_rng(7)
    for k, elevation in enumerate((53.5, 54.3, 54.7, 55.5)):
        image, centre, view = picture(rng, 8.0, 40.0 * k, sun_at(elevation, 90.0 * k + 4.0))
        found = find_mark(image, view, 30.0)
        assert isinstance(found, MarkFit), (elevation, found)
        error = found.uv_px - centre
        assert np.abs(error).max() < 0.05, (elevation, error)
        assert np.abs(error / np.sqrt(np.diag(found.covariance_px2))).max() < 5.0, (elevation, error)


def test_sun_against_pvlib() -> None:
    """Rationale: shadows are predicted from date and site. Expected: NREL's algorithm. Tolerance: 0.02 degrees."""
    for stamp, gps in (("2026-06-12 02:30:00+00:00", 1465266618.0), ("2026-01-05 06:00:00+00:00", 1451628018.0)):
        expected = pvlib.solarposition.get_solarposition(stamp, 31.283, 121.213).iloc[0]
        sun = to_sun(gps - 1e9, 18.0, 31.283, 121.213)
        assert abs(np.degrees(np.arcsin(sun[2])) - expected["elevation"]) < 0.02
        azimuth = np.degrees(np.arctan2(sun[0], sun[1])) % 360.0
        assert abs(azimuth - expected["azimuth"]) < 0.03
