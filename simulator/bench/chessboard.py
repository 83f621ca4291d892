"""The geometric bench (9.2.2): pictures of one chessboard at four distances or more, with the camera of the flight.

Writes bench/chessboard/board.json, log.csv, b_001.tif ... (full frames, 16 bit, all bands; a JPEG preview of each) and
truth/board_corners.npz, whose arrays are (n images, m inner corners, no pickle):

    image           (n,) text, path inside the campaign folder
    distance_m      (n,) along the optical axis to the board's centre
    corner          (m, 2) int64, column and row of each inner corner, row by row
    corner_px       (n, m, 2) float64, true pixel of every inner corner, distorted; the image's top left corner is (0, 0)
    rotation        (n, 3, 3) camera_from_board; the board's frame is BoardSheet's
    translation_m   (n, 3) of inner corner (0, 0) in the camera frame

The camera is that of the flight: lens (breathing with the focus setting), point spread, fixed pattern, noise. Exposure is set
at each distance, as a person would, so that the brightest white of its pictures reaches `exposure_share` of full scale.
"""

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path

import numpy as np

from campaign.benches.bench import BoardExposure, BoardSheet, write_board, write_board_log
from campaign.config import Camera, Config, Faults, Lens
from campaign.flight import images
from campaign.folder import CampaignFolder
from campaign.progress import Report
from campaign.writing.atomic import complete_file
from scenes.chessboard import LAMP_CAMERA_M, Board, board_of, board_scene, lamp_intensity
from simulator.bench.placements import (
    Placement,
    bench_f_number,
    bench_focus_m,
    bench_lens,
    plan_placements,
    project_board,
)
from simulator.camera import sensor
from simulator.camera.ripple import ripple_px, rippled
from simulator.journal import Journal
from simulator.kept import kept_array
from simulator.randomness import Stream, generator, scene_seed
from simulator.release import release
from simulator.render.board import BoardView, render_board
from simulator.render.sampling import frame_words
from simulator.render.scene import load_scene

INTERVAL_S = 20.0  # between pictures
WALL_BEHIND_M = 1.5  # the wall stands this far behind the farthest position
FLATNESS_M = 0.0  # the simulated board is a plane
WAITING_FRAMES = 1  # pictures whose noise and file are made while the next is rendered: bounds the memory
_NOISE, _SAMPLES = 1, 2  # keys of the stream, after the plan's


def simulate_chessboard(
    config: Config, place: CampaignFolder, start_gps_s: float, progress: Report, journal: Journal | None = None
) -> tuple[Lens, float]:
    """Write the bench's folder and its truth.

    Parameters
    ----------
    start_gps_s : float
        Adjusted standard GPS time of the first picture. [s]

    Returns
    -------
    lens : Lens
        True interior orientation at the bench's focus.
    focus_distance_m : float
        Setting of the lens. [m]
    """
    settings, journal = config.bench.chessboard, journal or Journal()
    board, plan, lens = board_of(settings), plan_placements(config), bench_lens(config)
    camera = config.camera.model_copy(update={"lens": lens, "f_number": bench_f_number(config)})
    exposing = {p.distance_m: _exposing(config, camera, board, plan, p.distance_m) for p in plan}
    place.chessboard.mkdir(parents=True, exist_ok=True)
    place.truth.mkdir(exist_ok=True)
    write_board(
        place.chessboard / "board.json",
        BoardSheet(
            inner_columns=board.columns - 1,
            inner_rows=board.rows - 1,
            square_m=board.square_m,
            width_m=board.width_m,
            height_m=board.height_m,
            flatness_m=FLATNESS_M,
            material="printed, matt, on a plane plate",
        ),
    )
    pattern = sensor.fixed_pattern(generator(config.seed, Stream.CAMERA_FIXED_PATTERN))
    scene = load_scene(board_scene(board, settings))
    rows = []
    waiting: deque[Future[None]] = deque()
    progress("chessboard", 0, len(plan))
    with ThreadPoolExecutor(1) as writer:
        for k, placement in enumerate(plan):
            name, time = f"b_{k + 1:03d}.tif", start_gps_s + INTERVAL_S * k
            used = exposing[placement.distance_m]
            rows.append(
                BoardExposure(
                    image=name,
                    gps_time_s=time,
                    distance_m=placement.distance_m,
                    focus_distance_m=bench_focus_m(config),
                    f_number=camera.f_number,
                    exposure_time_s=used.exposure_time_s,
                    gain_e_per_dn=used.e_per_dn,
                )
            )
            if not journal.wants(name):
                progress("chessboard", k + 1, len(plan))
                continue
            view = board_view(config, camera, placement)
            words = frame_words(scene_seed(config), int(Stream.CHESSBOARD), (_SAMPLES, k))
            grey = kept_array(
                config.render.cache,
                (
                    release(),
                    "chessboard",
                    *_seen(view),
                    board,
                    scene.scene.materials,
                    settings.samples,
                    words,
                ),
                lambda: render_board(scene, board, view, settings.samples, words),  # noqa: B023 - called at once
                config.render.cache_limit_gb,
            )
            noise = generator(config.seed, Stream.CHESSBOARD, _NOISE, k)
            while len(waiting) >= WAITING_FRAMES:
                waiting.popleft().result()
            tags = _tags(config, camera, time, used.exposure_time_s)
            path = place.chessboard / name
            waiting.append(writer.submit(_develop, config, camera, used, pattern, grey, noise, path, tags, journal))
            progress("chessboard", k + 1, len(plan))
        for future in waiting:
            future.result()
    if journal.shares:
        return lens, bench_focus_m(config)
    write_board_log(place.chessboard / "log.csv", rows)
    _write_corners(place, config.faults, lens, board, plan, [row.image for row in rows])
    return lens, bench_focus_m(config)


def board_view(config: Config, camera: Camera, placement: Placement) -> BoardView:
    """What the renderer needs of one picture; `camera` carries the bench's lens and f-number."""
    return BoardView(
        camera=camera,
        focus_distance_m=bench_focus_m(config),
        aperture_m=config.camera.nominal_focal_length_mm / 1000 / camera.f_number,
        wall_distance_m=max(config.bench.chessboard.distances_m) + WALL_BEHIND_M,
        rotation=placement.rotation,
        translation_m=placement.translation_m,
    )


def _seen(view: BoardView) -> tuple[object, ...]:
    """All of a view that the renderer reads: noise, gain and black level of the camera are not."""
    camera = view.camera
    optics = (camera.width_px, camera.height_px, camera.lens, camera.psf_sigma_px)
    return (*optics, *(getattr(view, field.name) for field in fields(view) if field.name != "camera"))


def board_irradiance(placement: Placement, point_m: np.ndarray) -> np.ndarray:
    """Irradiance of points (n, 2) of the board by a lamp of unit radiant intensity: cos(theta)/d^2. (n,) [m-2]"""
    point = point_m @ placement.rotation[:, :2].T + placement.translation_m
    to_lamp = LAMP_CAMERA_M - point
    distance = np.linalg.norm(to_lamp, axis=1)
    return np.maximum(to_lamp @ -placement.rotation[:, 2], 0) / distance**3


def _exposing(
    config: Config, camera: Camera, board: Board, plan: tuple[Placement, ...], distance_m: float
) -> sensor.Exposing:
    """Exposure and gain of one position: its brightest white at `exposure_share` of full scale, under one unit of shade."""
    settings = config.bench.chessboard
    x, y = np.linspace(board.low_m, board.high_m, 15).T
    points = np.stack([c.ravel() for c in np.meshgrid(x, y)], axis=-1)
    brightest = max(board_irradiance(p, points).max() for p in plan if p.distance_m == distance_m)
    focal_m, focus_m = camera.nominal_focal_length_mm / 1000, bench_focus_m(config)
    # The sensor stands farther behind the lens than for infinity.
    lamp = ((focus_m - focal_m) / focus_m) ** 2 * np.array([lamp_intensity(band) for band in camera.bands])
    share = settings.exposure_share / max(1.0, config.faults.camera_gain)  # a person sets what the camera shows
    set_to = sensor.exposure_for(camera, settings.white_reflectance / np.pi * brightest * lamp, share)
    return sensor.under_light(set_to, lamp)


def _develop(
    config: Config,
    camera: Camera,
    exposing: sensor.Exposing,
    pattern: sensor.FixedPattern,
    grey: np.ndarray,
    noise: np.random.Generator,
    path: Path,
    tags: images.ImageTags,
    journal: Journal,
) -> None:
    grey = rippled(grey, config.faults, path.stem)
    light = np.broadcast_to(grey[:, :, None], (*grey.shape, len(camera.bands)))
    dn = sensor.expose(light, camera, exposing, config.faults.camera_gain, noise, pattern)
    images.write_image(path, dn, tags)
    images.write_preview(path.with_suffix(".jpg"), sensor.preview(dn, camera), tags)
    journal.finish(path.name, [path, path.with_suffix(".jpg")])


def _tags(config: Config, camera: Camera, gps_time_s: float, exposure_time_s: float) -> images.ImageTags:
    site = config.site
    return images.ImageTags(
        camera_name=camera.name,
        manufacturer=camera.manufacturer,
        gps_time_s=gps_time_s,
        exposure_time_s=exposure_time_s,
        f_number=camera.f_number,
        focal_length_mm=camera.nominal_focal_length_mm,
        pixel_size_um=camera.pixel_size_um,
        black_level_dn=camera.black_level_dn,
        bit_depth=camera.bit_depth,
        latitude_deg=site.latitude_deg,
        longitude_deg=site.longitude_deg,
        ellipsoid_height_m=site.ellipsoid_height_m,
        roll_deg=0.0,
        pitch_deg=0.0,
        heading_deg=0.0,
        bands=tuple(band.name for band in camera.bands),
    )


def _write_corners(
    place: CampaignFolder, faults: Faults, lens: Lens, board: Board, plan: tuple[Placement, ...], names: list[str]
) -> None:
    pixel = [project_board(lens, p, board.corners_m()) for p in plan]
    arrays = {
        "image": np.array([f"bench/chessboard/{name}" for name in names]),
        "distance_m": np.array([p.distance_m for p in plan]),
        "corner": board.corner_index(),
        "corner_px": np.stack([uv + ripple_px(faults, uv, Path(n).stem) for uv, n in zip(pixel, names, strict=True)]),
        "rotation": np.stack([p.rotation for p in plan]),
        "translation_m": np.stack([p.translation_m for p in plan]),
    }
    with complete_file(place.truth / "board_corners.npz") as work:
        np.savez(work, allow_pickle=False, **arrays)
