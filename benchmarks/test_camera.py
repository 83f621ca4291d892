"""The camera: a frame against a bare `mi.render` of the same triangles, its noise against the sensor's, and its seconds.

Time: as many paths of the same depth in three channels on both sides, none of them in targets' boxes. A path is a camera ray, at
each of two surfaces one ray towards the lights, and the ray between them. Ours: distortion, point spread and motion during the
exposure, materials with texture and opposition peak, the sun's disc and a CIE sky sampled apart (the continuation is the sky's
sample too). The bare one: a pinhole that stands still, one grey material, Mitsuba's path tracer with one bounce, a directional
sun and the same sky as an environment map. CPU seconds of the whole process, alternately, medians.

Noise: the same frame from two seeds. Half the squared difference is the render's variance; the sensor's is its own in closed form
at the same signal. Ratios are of root mean squares over all pixels and bands. The frames of the P1 take minutes: `-k p1`.
"""

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from campaign.config import Camera
from campaign.folder import CampaignFolder
from campaign.load import load_config
from campaign.progress import silent
from scenes.frustums import PART_MARK
from scenes.model import Scene
from scenes.panels import PART_TOP
from scenes.sunsky import sky_radiance_relative
from simulator.camera import sensor
from simulator.camera.fly_camera import fly_camera
from simulator.camera.view import FramePose, frame_pose, project, target_regions
from simulator.flight import rig
from simulator.journal import Journal
from simulator.render.radiance import render_bands, render_frame
from simulator.world import Range, light_at, prepare_range

SAMPLES = 4
ROUNDS = 5
SKY_PX = (64, 128)
PARTS = {"panels": PART_TOP, "marks": PART_MARK}
P1 = ("flight.heights_m=[60.0]", "flight.headings_deg=[0.0]", "flight.images_per_strip=1")


def bare_scene(world: Range, eye: np.ndarray, camera: Camera, to_sun: np.ndarray) -> object:
    """The range's triangles for `mi.render`, seen from above."""
    import mitsuba as mi

    mesh = world.scene.mesh
    triangles = mi.Mesh("bare", len(mesh.vertices_m), len(mesh.faces))
    params = mi.traverse(triangles)
    params["vertex_positions"] = mesh.vertices_m.astype(np.float32).ravel()
    params["faces"] = mesh.faces.astype(np.uint32).ravel()
    params.update()
    polar, azimuth = ((np.arange(n) + 0.5) / n * turn for n, turn in zip(SKY_PX, (np.pi, 2 * np.pi), strict=True))
    level = np.sin(polar)[:, None]
    direction = np.broadcast_arrays(level * np.cos(azimuth), level * np.sin(azimuth), np.cos(polar)[:, None])
    radiance = sky_radiance_relative(np.stack(direction, axis=-1).reshape(-1, 3), to_sun).reshape(SKY_PX)
    radiance[SKY_PX[0] // 2 :] = 0.05
    field = np.degrees(2 * np.arctan(0.5 * camera.width_px / camera.lens.fx_px))
    return mi.load_dict(
        {
            "type": "scene",
            "mesh": triangles,
            "sky": {
                "type": "envmap",
                "bitmap": mi.Bitmap(np.repeat(radiance[..., None], 3, axis=-1).astype(np.float32)),
                "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90),
            },
            "sun": {"type": "directional", "direction": (-to_sun).tolist()},
            "integrator": {"type": "path", "max_depth": 3},
            "sensor": {
                "type": "perspective",
                "fov": float(field),
                "to_world": mi.ScalarTransform4f().look_at(
                    origin=eye.tolist(), target=[float(eye[0]), float(eye[1]), 0.0], up=[0.0, 1.0, 0.0]
                ),
                "film": {
                    "type": "hdrfilm",
                    "width": camera.width_px,
                    "height": camera.height_px,
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": "independent"},
            },
        }
    )


def cpu_seconds(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


@pytest.mark.benchmark(group="camera")
def test_time_against_bare_render(benchmark: BenchmarkFixture, quickstart: Range, record: Callable[..., None]) -> None:
    import drjit as dr
    import mitsuba as mi

    config = quickstart.config
    half = {"width_px": config.camera.width_px // 2, "height_px": config.camera.height_px // 2}
    lens = config.camera.lens
    halved = {name: 0.5 * getattr(lens, name) for name in ("fx_px", "fy_px", "cx_px", "cy_px")}
    camera = config.camera.model_copy(update={**half, "lens": lens.model_copy(update=halved)})
    sortie = quickstart.sorties[0]
    at = sortie.strips[0].exposure_s[0]
    pose, light = frame_pose(sortie.motion, rig.true_camera(config), at), light_at(quickstart, at)
    settings = config.render.model_copy(update={"samples": SAMPLES})
    scene = bare_scene(quickstart, pose.position_world_m, camera, light.to_sun)

    def bare() -> None:
        dr.eval(mi.render(scene, spp=SAMPLES, seed=1))
        dr.sync_thread()

    def ours() -> None:
        render_frame(quickstart.render_scene, camera, pose, light, settings, 1, (1, 1, 0), [])

    bare()  # compiles
    pairs: list[tuple[float, float]] = []
    benchmark.pedantic(lambda: pairs.append((cpu_seconds(ours), cpu_seconds(bare))), rounds=ROUNDS, warmup_rounds=1)
    both = np.array(pairs[1:])
    paths = camera.width_px * camera.height_px * SAMPLES
    record(
        camera_time_ratio=float(np.median(both[:, 0] / both[:, 1])),
        camera_paths_per_cpu_s=float(paths / np.median(both[:, 0])),
        camera_bare_paths_per_cpu_s=float(paths / np.median(both[:, 1])),
    )


def targets_seen(scene: Scene, camera: Camera, pose: FramePose, parts: tuple[int, ...]) -> np.ndarray:
    """(h, w) int16, index of the target of whose `parts` a pixel is, else -1: triangles drawn from far to near."""
    seen = np.full((camera.height_px, camera.width_px), -1, np.int16)
    mesh = scene.mesh
    own = np.flatnonzero(mesh.target >= 0)
    pixel, depth = project(camera, pose, mesh.vertices_m[mesh.faces[own].ravel()])
    pixel, depth = pixel.reshape(-1, 3, 2), depth.reshape(-1, 3).mean(axis=1)
    for k in np.argsort(-depth):
        if np.abs(pixel[k]).max() < 2**15:  # else far outside
            index = int(mesh.target[own[k]]) if mesh.part[own[k]] in parts else -1
            cv2.fillConvexPoly(seen, np.round((pixel[k] - 0.5) * 16).astype(np.int32), index, shift=4)
    return seen


def noise_ratios(world: Range, camera: Camera | None = None) -> dict[str, float]:
    """RMS of the render's noise over RMS of the sensor's, for the first frame of a configuration.

    In the targets' boxes, elsewhere, and for panels' tops and marks one by one, of which the 95th percentile is told.
    """
    config = world.config
    camera = config.camera if camera is None else camera
    sortie = world.sorties[0]
    at = sortie.strips[0].exposure_s[0]
    pose, light = frame_pose(sortie.motion, rig.true_camera(config), at), light_at(world, at)
    regions = target_regions(camera, pose, world.scene)
    exposing = sensor.exposure_gain(camera, light)
    factor = (exposing.e_per_radiance / exposing.e_per_dn).astype(np.float32)
    inside = np.zeros((camera.height_px, camera.width_px), bool)
    for _, u0, v0, u1, v1 in regions:
        inside[v0:v1, u0:u1] = True
    count = len(world.scene.targets)
    masks = {name: targets_seen(world.scene, camera, pose, (part,)) for name, part in PARTS.items()}
    single = {name: np.zeros((2, count)) for name in masks}
    sums = np.zeros((2, 2))  # render's and sensor's; in the boxes and elsewhere
    frames = (
        render_bands(world.render_scene, camera, pose, light, config.render, seed, (1, 1, 0), regions)
        for seed in (1, 2)
    )
    first = 0
    for one, two in zip(*frames, strict=True):
        rows = slice(first, first + len(one))
        first = rows.stop
        window = sensor.Window(column=0, row=rows.start, width_px=camera.width_px, height_px=len(one))
        dn = factor * sensor.vignetting(camera, window)[..., None]
        render = 0.5 * (((one - two) * dn) ** 2).sum(axis=-1)
        own = (sensor.sensor_noise_std_dn(0.5 * (one + two) * dn, camera, exposing) ** 2).sum(axis=-1)
        for k, variance in enumerate((render, own)):
            sums[k] += variance[inside[rows]].sum(), variance[~inside[rows]].sum()
            for name, mask in masks.items():
                where = mask[rows] >= 0
                single[name][k] += np.bincount(mask[rows][where], variance[where], count)
    ratio = np.sqrt(sums[0] / sums[1])
    found = {"targets": float(ratio[0]), "elsewhere": float(ratio[1])}
    for name, (render, own) in single.items():
        if (own > 0).any():
            found[f"{name}_p95"] = float(np.percentile(np.sqrt(render[own > 0] / own[own > 0]), 95))
    return found


@pytest.mark.benchmark(group="camera")
def test_noise(benchmark: BenchmarkFixture, quickstart: Range, record: Callable[..., None]) -> None:
    found = benchmark.pedantic(lambda: noise_ratios(quickstart), rounds=1)
    record(**{f"camera_noise_ratio_{name}_quickstart": value for name, value in found.items()})


@pytest.fixture(scope="module")
def p1() -> Range:
    """One frame of 45 megapixels."""
    return prepare_range(load_config("multirotor_vux1_p1", list(P1)))


@pytest.mark.benchmark(group="camera")
def test_p1_noise(benchmark: BenchmarkFixture, p1: Range, record: Callable[..., None]) -> None:
    found = benchmark.pedantic(lambda: noise_ratios(p1), rounds=1)
    record(**{f"camera_noise_ratio_{name}": value for name, value in found.items()})


@pytest.mark.benchmark(group="camera")
def test_p1_frame(benchmark: BenchmarkFixture, p1: Range, record: Callable[..., None], tmp_path: Path) -> None:
    """Rendered, developed and written; what a first frame has to compile and to draw included."""
    cpu = time.process_time()
    benchmark.pedantic(lambda: fly_camera(p1, CampaignFolder(tmp_path), silent, Journal()), rounds=1)
    record(camera_frame_s=benchmark.stats.stats.min, camera_frame_cpu_s=time.process_time() - cpu)
