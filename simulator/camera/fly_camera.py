"""The camera in flight: every exposure rendered, developed and written. Light and paths are the renderer's, noise the sensor's.

A frame goes by in bands of rows: rendering keeps both cores busy, noise and files of the bands before are made meanwhile on a
second thread, and no more of a frame is in memory than its numbers.
"""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from campaign import truth as truth_files
from campaign.config import Config
from campaign.flight import images, records
from campaign.folder import CampaignFolder
from campaign.progress import Report
from simulator import record_truth
from simulator.camera import sensor
from simulator.camera import view as camera_maths
from simulator.camera.ripple import rippled_rows
from simulator.flight import rig
from simulator.flight.frames import rpy_from_rotation
from simulator.flight.motion import Motion, Strip
from simulator.journal import Journal
from simulator.kept import kept_blocks
from simulator.randomness import Stream, generator, scene_seed
from simulator.release import release
from simulator.render.radiance import band_rows, render_bands
from simulator.world import Range, light_at

WAITING_BANDS = 8  # rendered bands that may wait for noise and file: bounds the memory


@dataclass(frozen=True, kw_only=True)
class _Frame:
    """A picture that is being developed."""

    config: Config
    exposing: sensor.Exposing
    fixed_pattern: sensor.FixedPattern
    noise: np.random.Generator
    dn: np.ndarray  # (h, w, bands) uint16, filled from its first row on
    path: Path  # without ending
    tags: images.ImageTags


def fly_camera(world: Range, place: CampaignFolder, progress: Report, journal: Journal) -> None:
    """Images, previews and exposures.csv of every sortie, and truth/marks.csv."""
    config = world.config
    exposing = sensor.exposure_gain(config.camera, light_at(world, world.sorties[0].strips[0].start_s))
    fixed_pattern = sensor.fixed_pattern(generator(config.seed, Stream.CAMERA_FIXED_PATTERN))
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
            camera = config.camera
            frame = _Frame(
                config=config,
                exposing=exposing,
                fixed_pattern=fixed_pattern,
                noise=generator(config.seed, Stream.CAMERA_NOISE, sortie.number, strip.number, index),
                dn=np.empty((camera.height_px, camera.width_px, len(camera.bands)), np.uint16),
                path=folder.images / name,
                tags=_tags(world, estimated, time + config.faults.camera_clock_s, exposing.exposure_time_s),
            )
            first = 0
            for radiance in _rippled(_radiance(world, pose, strip, index, time), config, name):
                while len(waiting) >= WAITING_BANDS:
                    waiting.popleft().result()
                waiting.append(writer.submit(_develop, frame, first, radiance))
                first += len(radiance)
            waiting.append(writer.submit(_write, frame, image, journal))
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


def _radiance(
    world: Range, pose: camera_maths.FramePose, strip: Strip, index: int, time: float
) -> Iterator[np.ndarray]:
    """Radiance of one frame in bands of rows, rendered or out of the cache, whose key is all that the renderer reads."""
    config, scene = world.config, world.scene
    camera, settings = config.camera, config.render
    seed = scene_seed(config)
    light = light_at(world, time)
    key = (strip.sortie, strip.number, index)
    optics = (camera.width_px, camera.height_px, camera.lens, camera.bands, camera.psf_sigma_px)
    shutter = (camera.exposure_time_s, camera.shutter, camera.readout_time_s)
    samples = (settings.samples, settings.target_samples, settings.bounces)

    def render() -> Iterator[np.ndarray]:
        regions = camera_maths.target_regions(camera, pose, scene)
        return render_bands(world.render_scene, camera, pose, light, settings, seed, key, regions)

    made_of: tuple[object, ...] = (release(), "frame", seed, key, optics, shutter, samples, pose, light)
    made_of = (*made_of, scene.mesh, scene.materials, scene.targets)
    return kept_blocks(settings.cache, made_of, render, settings.cache_limit_gb)


def _rippled(bands: Iterator[np.ndarray], config: Config, name: str) -> Iterator[np.ndarray]:
    """The bands as they are; where a fault displaces the picture, in bands of the whole of it."""
    if config.faults.image_ripple_px == 0.0:
        yield from bands
        return
    camera = config.camera
    picture = np.empty((camera.height_px, camera.width_px, len(camera.bands)), np.float32)
    first = 0
    for band in bands:
        picture[first : first + len(band)] = band
        first += len(band)
    step = band_rows(camera)
    for first in range(0, camera.height_px, step):
        yield rippled_rows(picture, config.faults, name, slice(first, min(first + step, camera.height_px)))


def _develop(frame: _Frame, first: int, radiance: np.ndarray) -> None:
    """A band of rows, from row `first` on; the frame's noise is one sequence, so bands come in order."""
    camera = frame.config.camera
    window = sensor.Window(column=0, row=first, width_px=camera.width_px, height_px=len(radiance))
    gain = frame.config.faults.camera_gain
    frame.dn[window.cut] = sensor.expose(
        radiance, camera, frame.exposing, gain, frame.noise, frame.fixed_pattern, window
    )


def _write(frame: _Frame, unit: str, journal: Journal) -> None:
    files = [frame.path.with_suffix(".tif"), frame.path.with_suffix(".jpg")]
    images.write_image(files[0], frame.dn, frame.tags)
    images.write_preview(files[1], sensor.preview(frame.dn, frame.config.camera), frame.tags)
    journal.finish(unit, files)


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
