"""What a beam sees, against brute force: every sub-ray traced by another ray caster (Embree, in simulator.render.waveforms)."""

import numpy as np
import pytest

from scenes.model import Layout, Material, Mesh, Scene
from simulator.lidar.footprint import Optics, gaussian_footprint
from simulator.lidar.radar_equation import SPEED_OF_LIGHT_M_S
from simulator.pulses.caster import Caster, Seen
from simulator.render.scene import load_scene
from simulator.render.waveforms import Beams, Echoes, Tracer

HALF_C_M_NS = 0.5e-9 * SPEED_OF_LIGHT_M_S
LAYOUT = Layout(camera_half_m=(1.0, 1.0), lidar_half_m=1.0, cone_half_m=1.0, field_half_m=(1.0, 1.0))
RHO = np.array([0.5, 0.1])
DIVERGENCE = 0.0005


def optics(subrays: int = 256, samples: int = 96, divergence_rad: float = DIVERGENCE) -> Optics:
    return Optics(
        footprint=gaussian_footprint(subrays, divergence_rad),
        echo_sigma_ns=1.8142,
        sampling_ns=1.0,
        samples=samples,
        pre_samples=12,
        scale_dn_m2=1e6,
        extinction_per_m=1e-4,
    )


def scene_of(vertices: np.ndarray, faces: np.ndarray, material: np.ndarray) -> Scene:
    grey = [Material(name=f"{r}", wavelength_nm=np.array([400.0, 1700.0]), reflectance=np.full(2, r)) for r in RHO]
    mesh = Mesh(
        vertices_m=vertices,
        faces=faces.astype(np.int32),
        material=material.astype(np.int32),
        target=np.full(len(faces), -1, np.int32),
        part=np.full(len(faces), -1, np.int8),
    )
    return Scene(mesh=mesh, materials=tuple(grey), targets=(), layout=LAYOUT)


def ground(slope: float = 0.0, rough_m: float = 0.0, cells: int = 200, half_m: float = 30.0) -> tuple[np.ndarray, ...]:
    """Vertices, faces and materials of a grid of 0.3 m."""
    g = np.linspace(-half_m, half_m, cells + 1)
    x, y = np.meshgrid(g, g)
    z = slope * x + rough_m * np.random.default_rng(0).random(x.shape)
    i = np.arange((cells + 1) * cells).reshape(cells, cells + 1)[:, :-1].ravel()
    n = cells + 1
    faces = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])
    return np.stack([x, y, z], -1).reshape(-1, 3), faces, np.zeros(len(faces))


def with_plates(count: int, size_m: float) -> Scene:
    """Rough ground with small dark plates of any attitude above it."""
    rng = np.random.default_rng(1)
    vertices, faces, _ = ground(rough_m=0.3)
    first, square = len(vertices), np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    turns = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    centre = rng.uniform([-25, -1, 1], [25, 4, 4], (count, 3))
    plates = rng.uniform(0.3, 1.0, (count, 1, 1)) * size_m * square @ turns + centre[:, None]
    more = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(count)[:, None, None] + first
    return scene_of(
        np.concatenate([vertices, plates.reshape(-1, 3)]),
        np.concatenate([faces, more.reshape(-1, 3)]),
        np.concatenate([np.zeros(len(faces)), np.ones(2 * count)]),
    )


def scan(count: int, height_m: float = 50.0) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions of lines across the flight, 0.1 m from pulse to pulse."""
    i = np.arange(count)
    angle = np.radians(-28.0) + (i % 470) * 0.00209
    line = i // 470
    origin = np.stack([0.0 * angle, 0.05 * line + 1e-5 * (i % 470), 0.0 * angle + height_m], -1)
    direction = np.stack([np.sin(angle), 0.0 * angle + 0.01, -np.cos(angle)], -1)
    return origin, direction / np.linalg.norm(direction, axis=1, keepdims=True)


def both(scene: Scene, beams: tuple[np.ndarray, np.ndarray], how: Optics) -> tuple[Seen, Echoes]:
    origin, direction = beams
    seen = Caster(scene.mesh, RHO, how).see(origin, direction)
    tracer = Tracer(load_scene(scene), RHO, how)
    return seen, tracer.launch(Beams(origin_m=origin, direction=direction, shift_m=np.zeros(len(origin))))()


def waveform(seen: Seen, start_sample: np.ndarray, how: Optics) -> np.ndarray:
    """(n, samples) of the echoes, in double precision."""
    k = np.arange(how.samples)
    out = np.zeros((len(seen.count), how.samples))
    for j in range(int(seen.count.max())):
        row = np.flatnonzero(seen.count > j)
        peak, range_m, variance = seen.echo[seen.first[row] + j].T
        sigma = np.hypot(how.echo_sigma_ns, np.sqrt(variance) / HALF_C_M_NS)
        x = range_m / HALF_C_M_NS - start_sample[row]
        out[row] += (peak * how.echo_sigma_ns / sigma)[:, None] * np.exp(
            -0.5 * ((k - x[:, None]) / sigma[:, None]) ** 2
        )
    return out


def arrival_m(wave: np.ndarray, start_sample: np.ndarray) -> np.ndarray:
    return (wave * np.arange(wave.shape[1])).sum(axis=1) / wave.sum(axis=1) * HALF_C_M_NS + start_sample * HALF_C_M_NS


@pytest.mark.parametrize("slope", [0.0, 0.6])
def test_smooth_ground_equals_brute_force(slope: float) -> None:
    """Rationale: on one surface the echo is a closed form; brute force has 256 sub-rays.
    Expected: amplitude RMS <= 0.5 % and range bias <= 0.5 mm are the issue's. Tolerance: 2e-4 and 0.02 mm; the closed form
    neglects (reach tan)^3 < 1e-8, the pattern's ring at 1.6 half divergences ends where 0.6 % of the Gaussian lies beyond.
    """
    how = optics()
    seen, brute = both(scene_of(*ground(slope, cells=300, half_m=45.0)), scan(20_000), how)
    wave, known = waveform(seen, brute.start_sample, how), brute.waveform_dn.astype(float)
    ratio = wave.max(axis=1) / known.max(axis=1) - 1.0
    assert np.sqrt(np.mean(ratio**2)) < 2e-4
    assert abs(np.mean(arrival_m(wave, brute.start_sample) - arrival_m(known, brute.start_sample))) < 2e-5


def test_rims_and_rough_ground_equal_brute_force() -> None:
    """Rationale: rims, creases, small plates and shadows are what a shortcut gets wrong.
    Expected: the same sub-rays hit the same faces; amplitudes at mixed footprints are unbiased, waveforms alike.
    Tolerance: bias 1e-4 (the issue's is 1 %), RMS 0.5 %; a sub-ray within 1e-6 rad of an edge may fall on the other side.
    """
    how = optics()
    scene, beams = with_plates(400, 0.3), scan(30_000)
    seen, brute = both(scene, beams, how)
    assert np.array_equal(seen.count > 0, brute.hits > 0)
    face = Caster(scene.mesh, RHO, how).face[seen.axis_row]
    assert np.mean(face != brute.axis_face) < 2e-4
    wave, known = waveform(seen, brute.start_sample, how), brute.waveform_dn.astype(float)
    rim = seen.slot >= 0
    assert 500 < rim.sum() < 0.5 * len(rim)
    ratio = wave.sum(axis=1) / known.sum(axis=1) - 1.0
    assert abs(ratio[rim].mean()) < 2e-4
    assert np.sqrt(np.mean(ratio**2)) < 5e-3
    worst = np.abs(wave - known).max(axis=1) / known.max(axis=1)
    assert np.quantile(worst, 0.999) < 0.01


@pytest.mark.parametrize("size_m", [0.004, 0.001])
def test_a_small_object_is_never_overlooked(size_m: float) -> None:
    """Rationale: the issue asks for a bound on what is missed. A cone finds every triangle that it touches, so an object is
    seen as soon as one of the pattern's sub-rays falls on it, however small it is against the footprint (25 mm here), and only
    the pattern's own spacing bounds what its size does to the amplitude.
    Expected: the same footprints are mixed as brute force finds. Tolerance: none but sub-rays on an edge (2e-4 of pulses).
    """
    how = optics()
    seen, brute = both(with_plates(4000, size_m), scan(30_000), how)
    nearest_m = (brute.start_sample + how.pre_samples) * HALF_C_M_NS  # to a sample, 0.15 m
    known = brute.last_range_m - nearest_m > 0.5  # a plate's height above the ground is more
    found = seen.extent_m[:, 2] - seen.extent_m[:, 1] > 0.5
    assert known.sum() > 30
    assert not np.any(found & (seen.slot < 0))
    assert np.mean(known & ~found) < 2e-4


def test_channels_and_order_do_not_show() -> None:
    """Rationale: pulses are grouped into fans, which only saves work. Expected: any order, stride or single pulse gives the same
    echoes. Tolerance: bits."""
    how = optics(61)
    scene, (origin, direction) = with_plates(200, 0.3), scan(6_000)
    caster = Caster(scene.mesh, RHO, how)
    whole, order = caster.see(origin, direction), np.random.default_rng(2).permutation(6_000)
    mixed, strided = caster.see(origin[order], direction[order]), caster.see(origin, direction, stride=7)
    for k in range(0, 6_000, 11):
        known = whole.echo[whole.first[k] : whole.first[k] + whole.count[k]]
        at = int(np.flatnonzero(order == k)[0])
        for other, i in ((mixed, at), (strided, k)):
            got = other.echo[other.first[i] : other.first[i] + other.count[i]]
            assert np.allclose(got, known, rtol=1e-9, atol=1e-9)


def test_big_triangles_and_beams_into_the_sky() -> None:
    """Rationale: vertices behind the scanner, one triangle alone, nothing hit. Expected: a range of 50 m below, nothing above.
    Tolerance: rounding."""
    vertices = np.array([[-1e3, -1e3, 0.0], [1e3, -1e3, 0.0], [0.0, 2e3, 0.0]])
    caster = Caster(scene_of(vertices, np.array([[0, 1, 2]]), np.zeros(1)).mesh, RHO, optics())
    down = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8]])
    seen = caster.see(np.tile([0.0, 0.0, 50.0], (3, 1)), down)
    assert list(seen.count) == [1, 0, 1]
    assert seen.extent_m[0, 0] == pytest.approx(50.0, abs=1e-9)
    assert seen.extent_m[2, 0] == pytest.approx(62.5, abs=1e-9)
    assert np.isnan(seen.extent_m[1]).all()
