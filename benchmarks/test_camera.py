"""A camera frame against a bare `mi.render` of the same triangles with as many paths of the same depth.

Ours: three bands, distortion, motion during the exposure, sun and sky sampled apart. The bare one: a pinhole that stands still,
grey surfaces under a uniform sky, Mitsuba's path tracer with one bounce. Target boxes are left out on both sides.
"""

import time
from collections.abc import Callable

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from scenes.sunsky import sun_sky
from simulator import rig
from simulator.camera import frame_pose
from simulator.render.radiance import render_frame
from simulator.simulate import Range
from simulator.times import utc_from_gps_time

SAMPLES = 4


def bare_seconds(world: Range, eye: np.ndarray, width: int, height: int) -> float:
    """The best of three, compiled before."""
    import drjit as dr
    import mitsuba as mi

    mesh = world.scene.mesh
    triangles = mi.Mesh("bare", len(mesh.vertices_m), len(mesh.faces))
    params = mi.traverse(triangles)
    params["vertex_positions"] = mesh.vertices_m.astype(np.float32).ravel()
    params["faces"] = mesh.faces.astype(np.uint32).ravel()
    params.update()
    lens = world.config.camera.lens
    scene = mi.load_dict(
        {
            "type": "scene",
            "mesh": triangles,
            "sky": {"type": "constant"},
            "integrator": {"type": "path", "max_depth": 3},
            "sensor": {
                "type": "perspective",
                "fov": float(np.degrees(2 * np.arctan(0.5 * world.config.camera.width_px / lens.fx_px))),
                "to_world": mi.ScalarTransform4f().look_at(
                    origin=eye.tolist(), target=[float(eye[0]), float(eye[1]), 0.0], up=[0.0, 1.0, 0.0]
                ),
                "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent"},
            },
        }
    )
    best = np.inf
    for seed in range(4):
        start = time.perf_counter()
        dr.eval(mi.render(scene, spp=SAMPLES, seed=seed))
        dr.sync_thread()
        best = min(best, time.perf_counter() - start) if seed else np.inf
    return best


@pytest.mark.benchmark(group="camera")
def test_frame(benchmark: BenchmarkFixture, quickstart: Range, record: Callable[..., None]) -> None:
    config = quickstart.config
    half = {"width_px": config.camera.width_px // 2, "height_px": config.camera.height_px // 2}
    lens = config.camera.lens
    halved = {name: 0.5 * getattr(lens, name) for name in ("fx_px", "fy_px", "cx_px", "cy_px")}
    camera = config.camera.model_copy(update={**half, "lens": lens.model_copy(update=halved)})
    sortie = quickstart.sorties[0]
    at = sortie.strips[0].exposure_s[0]
    pose = frame_pose(sortie.motion, rig.true_camera(config), at)
    settings = config.render.model_copy(update={"samples": SAMPLES})
    light = sun_sky(config.site, config.environment, utc_from_gps_time(at))
    benchmark.pedantic(
        lambda: render_frame(quickstart.render_scene, camera, pose, light, settings, 1, (1, 1, 0), []),
        rounds=3,
        warmup_rounds=1,
    )
    best = benchmark.stats.stats.min
    bare = bare_seconds(quickstart, pose.position_world_m, camera.width_px, camera.height_px)
    paths = camera.width_px * camera.height_px * SAMPLES
    record(
        camera_paths_per_s=paths / best, camera_bare_paths_per_s=paths / bare, camera_time_over_bare_render=best / bare
    )
