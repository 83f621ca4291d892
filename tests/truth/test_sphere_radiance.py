"""The integrating sphere against sphere theory, and against photons followed one by one in NumPy."""

import numpy as np
import pytest

from campaign.config import Band, Camera, Lens, Sphere
from scenes.sphere import SphereScene, build_sphere
from simulator.render import sphere as render
from simulator.render.sphere import radiance_per_watt

CAMERA = Camera(
    width_px=64,
    height_px=64,
    pixel_size_um=4.5,
    nominal_focal_length_mm=13.5,
    lens=Lens(fx_px=100.0, fy_px=100.0, cx_px=32.0, cy_px=32.0),
    bands=(Band(name="green", centre_nm=540.0, fwhm_nm=75.0),),
)
BACK = np.array([0.0, 0.0, 0.4])  # opposite the port


def built(**changes: object) -> SphereScene:
    return build_sphere(Sphere(**({"baffle": False} | changes)), CAMERA)


def sphere_theory(diameter_m: float, port_m: float, lamp_m: float, rho: float) -> float:
    """Radiance for one watt, L = Phi / (pi A) rho / (1 - rho (1 - f)); port and lamp return nothing: f counts both.

    A is the sphere without the lamp's cap: a flat lamp closes it and lights all the rest (0.06 % for 4 cm in 80 cm).
    """
    cap_port, cap_lamp = (0.5 * (1 - np.sqrt(1 - (d / diameter_m) ** 2)) for d in (port_m, lamp_m))
    area = np.pi * diameter_m**2 * (1 - cap_lamp)
    return float(rho / (np.pi * area) / (1 - rho * (1 - cap_port - cap_lamp)))


@pytest.mark.parametrize(
    ("rho", "port_m", "lamp_m"),
    [(0.3, 0.2, 0.04), (0.8, 0.1, 0.1), (0.9, 0.3, 0.04)]
    + [(0.97, 0.1, 0.04), (0.97, 0.2, 0.04), (0.97, 0.3, 0.02), (0.99, 0.2, 0.04)],
)  # fmt: skip
def test_sphere_theory(rho: float, port_m: float, lamp_m: float) -> None:
    """Rationale: at rho = 0.97 some hundred bounces matter; a limit on depth or a biased roulette leaves light out.

    Expected: the closed form; a sphere without a baffle is solved by one number, and all its wall has that radiance.
    Tolerance: 0.3 %, where the issue asks for 0.5 %: three standard errors of 2^19 paths at rho = 0.97 (one path's relative
    standard deviation is 45 %; at 0.99 it is 60 %).
    """
    scene = built(wall_reflectance=rho, port_diameter_m=port_m, lamp_diameter_m=lamp_m)
    places = np.array([BACK, [0.24, 0.0, 0.32], [-0.24, 0.192, 0.256], [0.32, 0.0, -0.24]])
    found = radiance_per_watt(scene, places, seed=5, paths=1 << 19)
    assert found == pytest.approx(sphere_theory(0.8, port_m, lamp_m, rho), rel=0.003)
    assert found == pytest.approx(found[0], rel=2e-4)  # single precision, and which lamp points a place sees


def test_black_wall() -> None:
    """Expected: a wall that reflects nothing has no radiance; doubling the sphere's size quarters it."""
    assert (radiance_per_watt(built(wall_reflectance=0.0), BACK[None], 1, 1 << 10) == 0).all()
    twice = {"diameter_m": 1.6, "port_diameter_m": 0.4, "lamp_diameter_m": 0.08}
    small, large = (radiance_per_watt(s, n * BACK[None], 1, 1 << 12) for s, n in ((built(), 1), (built(**twice), 2)))
    assert large[0] == pytest.approx(small[0] / 4, rel=1e-4)


def test_roulette_is_unbiased(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: roulette may change the noise, never the mean.

    Expected: with roulette from the first bounce on (a path then lives with probability rho) and with hardly any (weights
    down to 0.1 % of the first), the closed form.
    Tolerance: five standard errors: 2^18 paths of 100 % and of 45 %.
    """
    expected = sphere_theory(0.8, 0.2, 0.04, 0.97)
    for threshold, spread in ((1.0, 1.0), (0.001, 0.45)):
        monkeypatch.setattr(render, "ROULETTE", threshold)
        found = radiance_per_watt(built(), BACK[None], 3, 1 << 18)[0]
        assert found == pytest.approx(expected, rel=5 * spread / 512)


def test_baffle_against_photons_one_by_one() -> None:
    """Rationale: no closed form knows the baffle; a second solution without Mitsuba, in double precision, that follows
    photons from the lamp the other way round.

    Expected: mean radiance of the wall within 30 degrees of the point opposite the port; the baffle keeps the lamp's direct
    light from there and takes some 4 % of the light.
    Tolerance: four standard errors of both (the photons' from ten batches, the render's 0.15 %).
    """
    scene = build_sphere(Sphere(), CAMERA)
    assert scene.baffle is not None
    batches = np.array([_photons(scene, 20_000, seed, np.radians(30.0)) for seed in range(10)])
    photons, error = batches.mean(), batches.std(ddof=1) / np.sqrt(10)
    polar, turn = np.meshgrid(np.arccos(np.linspace(1, np.cos(np.radians(30.0)), 9)), np.arange(8) * np.pi / 4 + 0.3)
    places = 0.4 * np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], -1)
    per_ring = radiance_per_watt(scene, places.reshape(-1, 3), 11, 1 << 18).reshape(polar.shape).mean(axis=0)
    rendered = np.trapezoid(per_ring) / 8  # rings are evenly spaced in the cosine: equal areas
    assert error / photons < 0.004
    assert abs(rendered - photons) < 4 * np.hypot(error, 0.0015 * rendered)
    direct = sphere_theory(0.8, 0.2, 0.04, 0.97)
    assert rendered < direct * 0.98


def _photons(scene: SphereScene, count: int, seed: int, polar_rad: float) -> float:
    """Radiance for one watt of the cap about +z, from the photons that it reflects."""
    assert scene.baffle is not None
    rng = np.random.default_rng(seed)
    radius, baffle = scene.radius_m, scene.baffle
    # -- leave the flat lamp, inwards
    towards = -scene.lamp_direction
    across, side = np.array([1.0, 0.0, 0.0]), np.cross(towards, [1.0, 0.0, 0.0])
    r = radius * np.sin(scene.lamp_half_angle_rad) * np.sqrt(rng.random(count))
    a = 2 * np.pi * rng.random(count)
    place = radius * np.cos(scene.lamp_half_angle_rad) * scene.lamp_direction
    place = place + (r * np.cos(a))[:, None] * across + (r * np.sin(a))[:, None] * side
    normal = np.broadcast_to(towards, (count, 3))
    reflected = 0
    while len(place):
        direction = rng.standard_normal((len(place), 3))
        direction = normal + direction / np.linalg.norm(direction, axis=1, keepdims=True)  # Lambert's cosine
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        begin = place + 1e-9 * normal
        b = np.einsum("ij,ij->i", begin, direction)
        to_wall = -b + np.sqrt(b**2 - np.einsum("ij,ij->i", begin, begin) + radius**2)
        facing = direction @ baffle.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            to_baffle = ((baffle.centre_m - begin) @ baffle.normal) / facing
            crossing = begin + to_baffle[:, None] * direction - baffle.centre_m
            hidden = (to_baffle > 0) & (to_baffle < to_wall) & (np.linalg.norm(crossing, axis=1) < baffle.radius_m)
        place = begin + np.where(hidden, to_baffle, to_wall)[:, None] * direction
        unit = place / np.linalg.norm(place, axis=1, keepdims=True)
        normal = np.where(hidden[:, None], -np.sign(facing)[:, None] * baffle.normal, -unit)
        lost = ~hidden & (
            (-unit[:, 2] > np.cos(scene.port_half_angle_rad))
            | (unit @ scene.lamp_direction > np.cos(scene.lamp_half_angle_rad))
        )
        alive = ~lost & (rng.random(len(place)) < scene.wall_reflectance)
        reflected += int(np.count_nonzero(alive & ~hidden & (unit[:, 2] > np.cos(polar_rad))))
        place, normal = place[alive], normal[alive]
    cap_m2 = 2 * np.pi * radius**2 * (1 - np.cos(polar_rad))
    return reflected / count / cap_m2 / np.pi


def test_same_bytes_for_any_number_of_threads() -> None:
    """Expected: one lane, one sum: the same radiances to the last bit with one thread and with two."""
    scene = build_sphere(Sphere(), CAMERA)
    before = render.dr.thread_count()
    try:
        found = []
        for threads in (1, 2, 3):
            render.dr.set_thread_count(threads)
            found.append(radiance_per_watt(scene, np.stack([BACK, [0.24, 0.0, 0.32]]), 1, 1 << 14).tobytes())
    finally:
        render.dr.set_thread_count(before)
    assert found[0] == found[1] == found[2]
