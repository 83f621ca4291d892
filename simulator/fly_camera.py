"""The camera in flight: every exposure rendered, developed and written. Light and paths are the renderer's, noise the sensor's.

Rendering keeps both cores busy; noise and files of the frame before are made meanwhile on a second thread.
"""

import hashlib
import os
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import numpy as np

from campaign import images, records
from campaign import truth as truth_files
from campaign.config import Config
from campaign.folder import CampaignFolder
from campaign.progress import Report
from simulator import camera as camera_maths
from simulator import record_truth, rig, sensor
from simulator.frames import rpy_from_rotation
from simulator.journal import Journal
from simulator.motion import Motion, Strip
from simulator.randomness import Stream, generator
from simulator.render.radiance import render_frame
from simulator.ripple import rippled
from simulator.world import Range, light_at

WAITING_FRAMES = 2  # rendered frames that may wait for noise and file: bounds the memory


def fly_camera(world: Range, place: CampaignFolder, progress: Report, journal: Journal) -> None:
    """Images, previews and exposures.csv of every sortie, and truth/marks.csv."""
    config = world.config
    exposing = sensor.exposure_gain(config.camera, light_at(world, world.sorties[0].strips[0].start_s))
    fixed_pattern = sensor.fixed_pattern(config.camera, generator(config.seed, Stream.CAMERA_FIXED_PATTERN))
    frames = [
        (sortie, estimated, strip, index, time)
        for sortie, estimated in zip(world.sorties, world.estimated, strict=True)
        for strip in sortie.strips
        for index, time in enumerate(strip.exposure_s)
    ]
    for sortie in world.sorties:
        place.sortie(sortie.number).images.mkdir(parents=True, exist_ok=True)
    progress("camera", 0, len(frames))
    marks: list[truth_files.TrueMark] = []
    waiting: deque[Future[None]] = deque()
    with ThreadPoolExecutor(1) as writer:
        for done, (sortie, estimated, strip, index, time) in enumerate(frames, start=1):
            folder = place.sortie(sortie.number)
            name = f"s{sortie.number:02d}_l{strip.number:02d}_{index + 1:03d}"
            half_span = max(1e-3, 0.5 * config.camera.readout_time_s)
            pose = camera_maths.frame_pose(sortie.motion, rig.true_camera(config), time, half_span)
            image = f"sorties/{sortie.number:02d}/images/{name}.tif"
            marks += record_truth.marks_in(config.camera, world.scene, pose, image, config.faults)
            if not journal.wants(image):
                progress("camera", done, len(frames))
                continue
            radiance = _radiance(world, pose, strip, index, time)
            tags = _tags(world, estimated, time + config.faults.camera_clock_s, exposing.exposure_time_s)
            noise = generator(config.seed, Stream.CAMERA_NOISE, sortie.number, strip.number, index)
            while len(waiting) >= WAITING_FRAMES:
                waiting.popleft().result()
            waiting.append(
                writer.submit(
                    _develop,
                    config,
                    exposing,
                    fixed_pattern,
                    radiance,
                    noise,
                    folder.images / name,
                    tags,
                    image,
                    journal,
                )
            )
            progress("camera", done, len(frames))
        for future in waiting:
            future.result()
    if journal.shares:
        return
    for sortie in world.sorties:
        records.write_exposures(
            place.sortie(sortie.number).exposures,
            [
                records.Exposure(
                    image=f"s{sortie.number:02d}_l{strip.number:02d}_{index + 1:03d}.tif",
                    gps_time_s=time + config.faults.camera_clock_s,
                    strip=strip.number,
                    exposure_time_s=exposing.exposure_time_s,
                    gain_e_per_dn=exposing.e_per_dn,
                    focus_distance_m=config.camera.focus_distance_m,
                )
                for strip in sortie.strips
                for index, time in enumerate(strip.exposure_s)
            ],
        )
    place.truth.mkdir(exist_ok=True)
    truth_files.write_marks(place.truth / "marks.csv", marks)


def _radiance(world: Range, pose: camera_maths.FramePose, strip: Strip, index: int, time: float) -> np.ndarray:
    """Radiance of one frame, rendered or out of the cache."""
    config = world.config
    seed = config.seed if config.scene_seed is None else config.scene_seed
    light = light_at(world, time)
    key = (strip.sortie, strip.number, index)
    cached = None
    if config.render.cache is not None:
        digest = hashlib.sha256(repr((version("testrange"), seed, key, config.render.samples)).encode())
        digest.update(repr((config.render.target_samples, config.render.bounces, config.site)).encode())
        digest.update(config.camera.model_dump_json().encode())
        mesh = world.scene.mesh
        for array in (mesh.vertices_m, mesh.faces, mesh.material, *asdict(pose).values(), *asdict(light).values()):
            digest.update(np.ascontiguousarray(array).tobytes())
        for material in world.scene.materials:
            digest.update(np.ascontiguousarray(material.reflectance).tobytes())
        cached = Path(config.render.cache) / f"{digest.hexdigest()[:40]}.npy"
        if cached.is_file():
            return np.asarray(np.load(cached, allow_pickle=False))
    regions = camera_maths.target_regions(config.camera, pose, world.scene)
    radiance = render_frame(world.render_scene, config.camera, pose, light, config.render, seed, key, regions)
    if cached is not None:
        cached.parent.mkdir(parents=True, exist_ok=True)
        part = cached.with_suffix(f".{os.getpid()}.part")
        with part.open("wb") as file:
            np.save(file, radiance)
        part.replace(cached)
    return radiance


def _develop(
    config: Config,
    exposing: sensor.Exposing,
    fixed_pattern: sensor.FixedPattern,
    radiance: np.ndarray,
    noise: np.random.Generator,
    path: Path,
    tags: images.ImageTags,
    unit: str,
    journal: Journal,
) -> None:
    radiance = rippled(radiance, config.faults, path.stem)
    dn = sensor.expose(radiance, config.camera, exposing, config.faults.camera_gain, noise, fixed_pattern)
    images.write_image(path.with_suffix(".tif"), dn, tags)
    images.write_preview(path.with_suffix(".jpg"), sensor.preview(dn, config.camera), tags)
    journal.finish(unit, [path.with_suffix(".tif"), path.with_suffix(".jpg")])


def _tags(world: Range, estimated: Motion, stamped_s: float, exposure_time_s: float) -> images.ImageTags:
    camera = world.config.camera
    at = np.array([stamped_s])
    latitude, longitude, height = world.frame.geodetic_from_world(estimated.position(at))
    ned_from_world = world.frame.local_ned_from_world(latitude, longitude)
    roll, pitch, heading = rpy_from_rotation(ned_from_world @ estimated.world_from_body(at))
    return images.ImageTags(
        camera_name=camera.name,
        manufacturer=camera.manufacturer,
        gps_time_s=stamped_s,
        exposure_time_s=exposure_time_s,
        f_number=camera.f_number,
        focal_length_mm=camera.nominal_focal_length_mm,
        pixel_size_um=camera.pixel_size_um,
        black_level_dn=camera.black_level_dn,
        bit_depth=camera.bit_depth,
        latitude_deg=float(np.degrees(latitude[0])),
        longitude_deg=float(np.degrees(longitude[0])),
        ellipsoid_height_m=float(height[0]),
        roll_deg=float(np.degrees(roll[0])),
        pitch_deg=float(np.degrees(pitch[0])),
        heading_deg=float(np.degrees(heading[0]) % 360.0),
        bands=tuple(band.name for band in camera.bands),
    )
