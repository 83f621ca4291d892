"""Fly one configuration and write its campaign folder. The order of a campaign: range, survey, flight, camera, LiDAR, truth.

Rendering and ray casting keep both cores busy; noise and files of the frame before are made meanwhile on a second thread.
"""

import hashlib
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from campaign import images, las, manifest, records, sensors, survey, trajectory
from campaign import truth as truth_files
from campaign.config import Config
from campaign.folder import CampaignFolder, SortieFolder
from campaign.threads import one_blas_thread
from scenes.build import build_scene
from scenes.model import Scene, SunSky
from scenes.sunsky import sun_sky
from simulator import camera as camera_maths
from simulator import paperwork, record_truth, rig, sensor
from simulator.flight import Sortie, fly
from simulator.frames import SiteFrame, rpy_from_rotation
from simulator.lidar import simulate_strip
from simulator.motion import Motion, Strip
from simulator.navigation import estimate_motion, trajectory_of
from simulator.randomness import Stream, generator
from simulator.render.radiance import render_frame
from simulator.render.scene import RenderScene, load_scene
from simulator.times import BEIJING, gps_week, utc_from_gps_time

Report = Callable[[str, int, int], None]
SOFTWARE = ("testrange", "mitsuba", "drjit", "numpy")
WAITING_FRAMES = 2  # rendered frames that may wait for noise and file: bounds the memory


def silent(stage: str, done: int, total: int) -> None:
    """A progress report that says nothing."""


@dataclass(frozen=True, kw_only=True)
class Range:
    """What one simulation works with."""

    config: Config
    frame: SiteFrame
    scene: Scene
    render_scene: RenderScene
    sorties: tuple[Sortie, ...]
    estimated: tuple[Motion, ...]


def prepare_range(config: Config) -> Range:
    """Build the scene, fly it, and draw the navigation's errors. Nothing is rendered or written."""
    fixed = config.model_copy(update={"seed": config.seed if config.scene_seed is None else config.scene_seed})
    scene = build_scene(fixed)
    sorties = fly(fixed, scene.layout)
    return Range(
        config=config,
        frame=SiteFrame(config.site),
        scene=scene,
        render_scene=load_scene(scene),
        sorties=sorties,
        estimated=tuple(estimate_motion(config, sortie.motion, sortie.number) for sortie in sorties),
    )


@one_blas_thread()
def simulate_campaign(
    config: Config, out: Path, progress: Report = silent, only: frozenset[str] = frozenset({"camera", "lidar"})
) -> None:
    """Write a complete campaign folder into the existing, empty folder `out` (the caller makes it appear or not at all).

    Parameters
    ----------
    only : which sensors fly: "camera", "lidar" or both.
    """
    place = CampaignFolder(out)
    progress("scene", 0, 1)
    world = prepare_range(config)
    _write_survey(world, place)
    _write_sensors(world, place)
    records.write_plan(place.plan, paperwork.flight_plan(config, world.scene, world.sorties, world.frame))
    progress("scene", 1, 1)
    for sortie, estimated in zip(world.sorties, world.estimated, strict=True):
        folder = place.sortie(sortie.number)
        folder.root.mkdir(parents=True)
        _write_trajectory(world, folder, estimated, sortie)
        records.write_environment(folder.environment, paperwork.environment_rows(config, sortie))
    if "camera" in only:
        _fly_camera(world, place, progress)
    if "lidar" in only:
        _fly_lidar(world, place, progress)
    motions = {sortie.number: sortie.motion for sortie in world.sorties}
    record_truth.write(config, world.scene, motions, world.frame, out)
    _write_manifest(world, out)


def _write_survey(world: Range, place: CampaignFolder) -> None:
    site = world.config.site
    place.targets.parent.mkdir(parents=True)
    targets = paperwork.surveyed_targets(world.config, world.scene, world.frame)
    survey.write_targets(place.targets, targets, site.projection_epsg, site.height_epsg)
    survey.write_gcp_list(place.gcp_list, targets, site.projection_epsg)
    if any(target.kind == "panel" for target in world.scene.targets):
        survey.write_spectra(place.spectra, paperwork.measured_spectra(world.config, world.scene))


def _write_sensors(world: Range, place: CampaignFolder) -> None:
    place.camera.parent.mkdir(parents=True)
    sensors.write_sheet(place.camera, rig.camera_sheet(world.config))
    sensors.write_sheet(place.lidar, rig.lidar_sheet(world.config))
    sensors.write_sheet(place.rig, rig.rig_sheet(world.config))


def _write_trajectory(world: Range, folder: SortieFolder, estimated: Motion, sortie: Sortie) -> None:
    written = trajectory_of(estimated, world.frame, world.config)
    week = gps_week(float(world.sorties[0].motion.gps_time_s[0]))
    trajectory.write_sbet(folder.trajectory_sbet, written, week)
    trajectory.write_smrmsg(folder.trajectory_rms, written, week)
    trajectory.write_csv(folder.trajectory_csv, written)


def _light_at(world: Range, gps_time_s: float) -> SunSky:
    return sun_sky(world.config.site, world.config.environment, utc_from_gps_time(gps_time_s))


def _fly_camera(world: Range, place: CampaignFolder, progress: Report) -> None:
    config = world.config
    exposing = sensor.exposure_gain(config.camera, _light_at(world, world.sorties[0].strips[0].start_s))
    fixed_pattern = sensor.fixed_pattern(config.camera, generator(config.seed, Stream.CAMERA_FIXED_PATTERN))
    frames = [
        (sortie, estimated, strip, index, time)
        for sortie, estimated in zip(world.sorties, world.estimated, strict=True)
        for strip in sortie.strips
        for index, time in enumerate(strip.exposure_s)
    ]
    for sortie in world.sorties:
        place.sortie(sortie.number).images.mkdir(parents=True)
    progress("camera", 0, len(frames))
    marks: list[truth_files.TrueMark] = []
    waiting: deque[Future[None]] = deque()
    with ThreadPoolExecutor(1) as writer:
        for done, (sortie, estimated, strip, index, time) in enumerate(frames, start=1):
            folder = place.sortie(sortie.number)
            name = f"s{sortie.number:02d}_l{strip.number:02d}_{index + 1:03d}"
            half_span = max(1e-3, 0.5 * config.camera.readout_time_s)
            pose = camera_maths.frame_pose(sortie.motion, rig.true_camera(config), time, half_span)
            radiance = _radiance(world, pose, strip, index, time)
            image = f"sorties/{sortie.number:02d}/images/{name}.tif"
            marks += record_truth.marks_in(config.camera, world.scene, pose, image)
            tags = _tags(world, estimated, time + config.faults.camera_clock_s, exposing.exposure_time_s)
            noise = generator(config.seed, Stream.CAMERA_NOISE, sortie.number, strip.number, index)
            while len(waiting) >= WAITING_FRAMES:
                waiting.popleft().result()
            waiting.append(
                writer.submit(_develop, config, exposing, fixed_pattern, radiance, noise, folder.images / name, tags)
            )
            progress("camera", done, len(frames))
        for future in waiting:
            future.result()
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
                    focus_distance_m=strip.height_m,
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
    light = _light_at(world, time)
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
) -> None:
    dn = sensor.expose(radiance, config.camera, exposing, config.faults.camera_gain, noise, fixed_pattern)
    images.write_image(path.with_suffix(".tif"), dn, tags)
    images.write_preview(path.with_suffix(".jpg"), sensor.preview(dn, config.camera), tags)


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


def _fly_lidar(world: Range, place: CampaignFolder, progress: Report) -> None:
    config = world.config
    site = config.site
    origin = world.frame.map_from_world(np.zeros((1, 3)))[0]
    strips = [
        (sortie, estimated, strip)
        for sortie, estimated in zip(world.sorties, world.estimated, strict=True)
        for strip in sortie.strips
    ]
    place.truth.mkdir(exist_ok=True)
    for sortie in world.sorties:
        place.sortie(sortie.number).lidar.mkdir(parents=True)
    progress("lidar", 0, len(strips))
    for done, (sortie, estimated, strip) in enumerate(strips, start=1):
        folder = place.sortie(sortie.number)
        spec = las.LasSpec(
            projection_epsg=site.projection_epsg,
            height_epsg=site.height_epsg,
            creation_date=config.campaign.start_time[:10],
            system_identifier=config.lidar.name[:32],
            offset_m=(round(float(origin[0]), -2), round(float(origin[1]), -2), 0.0),
            sample_count=config.lidar.samples,
            sampling_ps=round(config.lidar.sampling_ns * 1000.0),
            bit_depth=16,
            file_source_id=strip.number,
        )
        known: list[truth_files.TrueReturns] = []
        chunks = simulate_strip(
            world.render_scene,
            config,
            strip,
            sortie.motion,
            estimated,
            rig.true_lidar(config),
            rig.nominal_lidar(config),
            world.frame,
        )
        waiting: Future[None] | None = None
        with (
            ThreadPoolExecutor(1) as pool,
            las.StripWriter(folder.strip_las(strip.number), folder.strip_points(strip.number), spec) as writer,
        ):
            for chunk in chunks:
                if waiting is not None:
                    waiting.result()
                waiting = pool.submit(writer.write, chunk.returns, chunk.packets)
                known.append(chunk.truth)
            if waiting is not None:
                waiting.result()
        truth_files.write_true_returns(
            place.truth / f"returns_{sortie.number:02d}_{strip.number:02d}.npz", record_truth.joined(known)
        )
        progress("lidar", done, len(strips))


def _write_manifest(world: Range, out: Path) -> None:
    config, site = world.config, world.config.site
    start = utc_from_gps_time(float(world.sorties[0].motion.gps_time_s[0])).astimezone(BEIJING)
    manifest.write_manifest(
        out,
        manifest.Manifest(
            campaign=config.campaign.id,
            title=config.campaign.title,
            synthetic=True,
            date=start.date().isoformat(),
            start_time=start.isoformat(timespec="seconds"),
            gps_week=gps_week(float(world.sorties[0].motion.gps_time_s[0])),
            latitude_deg=site.latitude_deg,
            longitude_deg=site.longitude_deg,
            ellipsoid_height_m=site.ellipsoid_height_m,
            height_anomaly_m=site.height_anomaly_m,
            projection_epsg=site.projection_epsg,
            height_epsg=site.height_epsg,
            software={name: version(name) for name in SOFTWARE},
            files=(),
        ),
    )
