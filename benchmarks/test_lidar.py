"""LiDAR pulses a second, with noise, digitising and detection, and how near the echoes are to brute force.

Three grounds of 320 000 triangles under an instrument of 1.8 million pulses a second and 0.5 mrad: with the quickstart's
targets, flat, and with leaves. Every packet is kept. Brute force traces every sub-ray (256 by default) of every
pulse with another ray caster.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from campaign.config import Config
from campaign.flight import las
from campaign.truth import TrueReturnsWriter
from scenes.model import Mesh, Scene
from simulator.flight import rig
from simulator.flight.georeference import Track
from simulator.lidar.device import Device, normals
from simulator.lidar.fly_lidar import write_strip
from simulator.lidar.footprint import Optics
from simulator.lidar.radar_equation import SPEED_OF_LIGHT_M_S
from simulator.lidar.scanner import scanner_from
from simulator.lidar.strip import StripChunk, backscatter, optics_from, simulate_strip
from simulator.pulses.caster import Caster, Seen
from simulator.render.scene import load_scene
from simulator.render.waveforms import Beams, Tracer
from simulator.simulate import Range

Record = Callable[..., None]
CELLS = 400  # of 0.3 m
ROUNDS = 5
HALF_C_M_NS = 0.5e-9 * SPEED_OF_LIGHT_M_S


def fast(config: Config) -> Config:
    """The quickstart's scanner at the pulse rate of the fastest UAV instruments."""
    scanner = config.lidar.scanner.model_copy(update={"scan_rate_hz": 400.0})
    lidar = config.lidar.model_copy(update={"prr_hz": 1_800_000.0, "scanner": scanner})
    recording = config.recording.model_copy(update={"waveforms": "all"})
    return config.model_copy(update={"lidar": lidar, "recording": recording})


def grid(height: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Mesh:
    line = np.linspace(-60.0, 60.0, CELLS + 1)
    x, y = np.meshgrid(line, line)
    i = np.arange((CELLS + 1) * CELLS).reshape(CELLS, CELLS + 1)[:, :-1].ravel()
    n = CELLS + 1
    faces = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)]).astype(np.int32)
    vertices = np.stack([x, y, height(x, y)], -1).reshape(-1, 3)
    return Mesh(
        vertices_m=vertices,
        faces=faces,
        material=np.zeros(len(faces), np.int32),
        target=np.full(len(faces), -1, np.int32),
        part=np.full(len(faces), -1, np.int8),
    )


def joined(a: Mesh, b: Mesh) -> Mesh:
    return Mesh(
        vertices_m=np.concatenate([a.vertices_m, b.vertices_m]),
        faces=np.concatenate([a.faces, b.faces + len(a.vertices_m)]).astype(np.int32),
        material=np.concatenate([a.material, b.material]),
        target=np.concatenate([a.target, b.target]),
        part=np.concatenate([a.part, b.part]),
    )


def ground(scene: Scene, kind: str) -> Scene:
    """The scene on another ground: "flat", "slope" or "relief" alone, "targets" with its targets, "leaves" with leaves."""
    rng = np.random.default_rng(0)
    if kind in ("flat", "slope"):
        return replace(scene, mesh=grid(lambda x, y: (0.5 if kind == "slope" else 0.0) * x + 0.0 * y), targets=())
    relief = grid(lambda x, y: 0.3 * np.sin(0.7 * x) * np.cos(0.5 * y) - 0.5 + 0.02 * rng.random(x.shape))
    if kind == "targets":
        mine = scene.mesh.target >= 0
        mesh = scene.mesh
        only = replace(
            mesh, faces=mesh.faces[mine], material=mesh.material[mine], target=mesh.target[mine], part=mesh.part[mine]
        )
        return replace(scene, mesh=joined(relief, only))
    centre = rng.uniform([-40, -40, 0.5], [40, 40, 6], (60_000, 1, 3))
    leaf = centre + rng.normal(scale=0.04, size=(60_000, 3, 3))
    ones = np.ones(60_000, np.int32)
    leaves = replace(
        relief,
        vertices_m=leaf.reshape(-1, 3),
        faces=np.arange(180_000, dtype=np.int32).reshape(-1, 3),
        material=0 * ones,
        target=-ones,
        part=(-ones).astype(np.int8),
    )
    return replace(scene, mesh=joined(relief, leaves), targets=())


@pytest.fixture(scope="module")
def flown(quickstart: Range) -> Callable[[str], tuple[Callable[[], Iterator[StripChunk]], int]]:
    """Of a kind of ground: its strip's chunks, made anew by every call, and how many pulses are fired."""

    def of(kind: str) -> tuple[Callable[[], Iterator[StripChunk]], int]:
        config, sortie = fast(quickstart.config), quickstart.sorties[0]
        first = sortie.strips[0]
        strip = replace(first, end_s=first.start_s + 6.0)
        scene = replace(load_scene(ground(quickstart.scene, kind)))
        count = scanner_from(config.lidar).pulse_count(strip.end_s - strip.start_s)
        mountings = (rig.true_lidar(config), rig.nominal_lidar(config))
        return (
            lambda: simulate_strip(
                scene, config, strip, sortie.motion, quickstart.estimated[0], *mountings, quickstart.frame
            ),
            count,
        )

    return of


def rate(benchmark: BenchmarkFixture, run: Callable[[], object], count: int) -> float:
    """Pulses a second, median."""
    benchmark.pedantic(run, rounds=ROUNDS, warmup_rounds=1)
    return count / float(benchmark.stats.stats.median)


@pytest.mark.benchmark(group="lidar")
@pytest.mark.parametrize("kind", ["targets", "flat", "leaves"])
def test_strip_in_memory(
    benchmark: BenchmarkFixture,
    flown: Callable[[str], tuple[Callable[[], Iterator[StripChunk]], int]],
    record: Record,
    kind: str,
) -> None:
    strip, count = flown(kind)
    found = rate(benchmark, lambda: sum(len(c.returns.gps_time_s) for c in strip()), count)
    name = "lidar_pulses_per_s_unwritten" + ("" if kind == "targets" else f"_{kind}")
    record(**{name: found})


@pytest.mark.benchmark(group="lidar")
def test_strip_written(
    benchmark: BenchmarkFixture,
    quickstart: Range,
    flown: Callable[[str], tuple[Callable[[], Iterator[StripChunk]], int]],
    record: Record,
    tmp_path: Path,
) -> None:
    """What a campaign writes of a strip, as it writes it: LAS, .wdp with every packet, compressed twin, truth."""
    config = fast(quickstart.config)
    spec = las.LasSpec(
        projection_epsg=config.site.projection_epsg,
        height_epsg=config.site.height_epsg,
        creation_date="2026-09-25",
        system_identifier="bench",
        offset_m=(615_500.0, 3_463_000.0, 0.0),
        sample_count=config.lidar.samples,
        sampling_ps=1000,
        bit_depth=16,
        file_source_id=1,
    )
    strip, count = flown("targets")

    def write() -> None:
        with (
            las.StripWriter(tmp_path / "strip_01.las", tmp_path / "strip_01_points.laz", spec) as writer,
            TrueReturnsWriter(tmp_path / "returns_01_01.npz") as truth,
        ):
            write_strip(strip(), writer, truth)

    record(lidar_pulses_per_s=rate(benchmark, write, count))


def waveform(seen: Seen, start_sample: np.ndarray, optics: Optics) -> np.ndarray:
    """(n, samples) of the echoes in double precision, on brute force's clock."""
    k = np.arange(optics.samples)
    out = np.zeros((len(seen.count), optics.samples))
    for j in range(int(seen.count.max())):
        row = np.flatnonzero(seen.count > j)
        peak, range_m, variance = seen.echo[seen.first[row] + j].T
        sigma = np.hypot(optics.echo_sigma_ns, np.sqrt(variance) / HALF_C_M_NS)
        x = range_m / HALF_C_M_NS - start_sample[row]
        out[row] += (peak * optics.echo_sigma_ns / sigma)[:, None] * np.exp(
            -0.5 * ((k - x[:, None]) / sigma[:, None]) ** 2
        )
    return out


@pytest.mark.benchmark(group="lidar")
@pytest.mark.parametrize("kind", ["flat", "slope", "targets"])
def test_equals_brute_force(benchmark: BenchmarkFixture, quickstart: Range, record: Record, kind: str) -> None:
    """Noise-free waveforms of 65 536 pulses, and the echoes that the device finds in both with the same noise."""
    config, sortie = fast(quickstart.config), quickstart.sorties[0]
    scene, optics, n = ground(quickstart.scene, kind), optics_from(config.lidar, 23.0), 65_536
    rho = backscatter(scene, config.lidar.wavelength_nm)
    strip, scanner = sortie.strips[0], scanner_from(config.lidar)
    middle = scanner.pulse_count(strip.end_s - strip.start_s) // 2
    pulses = scanner.pulses(np.arange(middle, middle + n))
    origin, direction, _ = Track(sortie.motion).beams(
        strip.start_s + pulses.time_s, rig.true_lidar(config), pulses.direction_lidar
    )
    caster, tracer = Caster(scene.mesh, rho, optics), Tracer(load_scene(scene), rho, optics)
    brute = tracer.launch(Beams(origin_m=origin, direction=direction, shift_m=np.zeros(n)))()
    seen = benchmark.pedantic(lambda: caster.see(origin, direction), rounds=1, warmup_rounds=1)
    wave, known = waveform(seen, brute.start_sample, optics), brute.waveform_dn.astype(float)
    ratio = wave.sum(axis=1) / known.sum(axis=1) - 1.0
    k = np.arange(optics.samples)
    late_m = ((wave * k).sum(axis=1) / wave.sum(axis=1) - (known * k).sum(axis=1) / known.sum(axis=1)) * HALF_C_M_NS
    end = "" if kind == "flat" else f"_{kind}"
    record(
        **{
            f"lidar_amplitude_rms_ratio{end}": np.sqrt(np.mean(ratio**2)),
            f"lidar_range_bias_m{end}": abs(late_m.mean()),
        }
    )
    if kind == "targets":
        device = Device(config.lidar)
        noise = normals(np.uint64(1), n * optics.samples).reshape(n, -1)
        counts = [device.detect(device.digitise(w.astype(np.float32), noise, np.ones(n))).count for w in (wave, known)]
        rim = seen.slot >= 0
        record(
            lidar_echo_count_equal=np.mean(counts[0] == counts[1]),
            lidar_rim_amplitude_bias=abs(ratio[rim].mean()),
            lidar_rim_share=rim.mean(),
        )
