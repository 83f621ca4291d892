"""What only the simulation knows, written under truth/: faults, reflectances, places, marks in images, the true scene."""

from pathlib import Path

import numpy as np

from campaign import truth as files
from campaign.config import Camera, Config, Faults, Vector3
from campaign.load import dump_toml
from scenes.model import Scene, Target
from scenes.spectra import band_reflectance, reflectance_at
from simulator.camera import view as camera_maths
from simulator.camera.ripple import ripple_px
from simulator.faults import true_lens
from simulator.flight import rig
from simulator.flight.frames import SiteFrame
from simulator.flight.motion import Motion
from simulator.flight.navigation import trajectory_of


def marks_in(
    camera: Camera, scene: Scene, pose: camera_maths.FramePose, image: str, faults: Faults | None = None
) -> list[files.TrueMark]:
    """True pixel of every target's mark (panel: centre of its top) in one image; `image` is its path in the folder."""
    targets = scene.targets
    pixel, depth = camera_maths.project(camera, pose, np.stack([target.mark_m for target in targets]))
    if faults is not None and faults.image_ripple_px:
        pixel = pixel + ripple_px(faults, pixel, Path(image).stem)
    inside = (depth > 0) & (pixel >= 0).all(axis=1) & (pixel < [camera.width_px, camera.height_px]).all(axis=1)
    return [
        files.TrueMark(target=t.id, image=image, u_px=float(uv[0]), v_px=float(uv[1]), visible=bool(seen))
        for t, uv, seen in zip(targets, pixel, inside, strict=True)
        if np.isfinite(uv).all()
    ]


def write(
    config: Config,
    scene: Scene | None,
    motions: dict[int, Motion],
    frame: SiteFrame,
    out: Path,
    bench: files.TrueBench | None = None,
    ranging: files.TrueRanging | None = None,
) -> None:
    """Everything else of truth/ in the campaign folder `out`; truth.json with the checksums last. No scene: nothing flew."""
    folder = out / "truth"
    folder.mkdir(exist_ok=True)
    (folder / "campaign.toml").write_text(dump_toml(config), encoding="utf-8")
    if scene is not None:
        paths = {number: trajectory_of(motion, frame, config) for number, motion in motions.items()}
        files.write_true_trajectories(folder / "trajectory.npz", paths)
        _write_scene(scene, folder / "scene.ply")
    camera, lidar = rig.true_mountings(config)
    faults = config.faults
    files.write_truth(
        out,
        files.Truth(
            seed=config.seed,
            camera=camera,
            lidar=lidar,
            lens=true_lens(config),
            camera_clock_s=faults.camera_clock_s,
            lidar_clock_s=faults.lidar_clock_s,
            range_offset_m=faults.range_offset_m,
            range_scale=faults.range_scale,
            lidar_gain=faults.lidar_gain,
            camera_gain=faults.camera_gain,
            targets=tuple(_true_target(target, config) for target in (scene.targets if scene else ())),
            bench=bench,
            ranging=ranging,
        ),
    )


def _true_target(target: Target, config: Config) -> files.TrueTarget:
    panel = target.spectrum if target.kind == "panel" else None
    bands, laser = None, None
    if panel is not None:
        bands = tuple(float(band_reflectance(panel, b.centre_nm, b.fwhm_nm)) for b in config.camera.bands)
        laser = float(reflectance_at(panel, config.lidar.wavelength_nm))
    return files.TrueTarget(
        id=target.id,
        kind=target.kind,
        mark_world_m=_vector(target.mark_m),
        vertex_world_m=None if target.vertex_m is None else _vector(target.vertex_m),
        band_reflectance=bands,
        laser_reflectance=laser,
    )


def _vector(values: np.ndarray) -> Vector3:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _write_scene(scene: Scene, path: Path) -> None:
    """The true surfaces for any mesh viewer: world frame, single precision, each face as grey as its reflectance at 550 nm."""
    import trimesh

    grey = np.array([np.interp(550.0, m.wavelength_nm, m.reflectance) for m in scene.materials])
    level = np.clip(255.0 * grey[scene.mesh.material] ** (1.0 / 2.2), 0.0, 255.0).astype(np.uint8)
    colours = np.column_stack([level, level, level, np.full(level.size, 255, dtype=np.uint8)])
    mesh = trimesh.Trimesh(scene.mesh.vertices_m, scene.mesh.faces, face_colors=colours, process=False)
    mesh.export(path, file_type="ply")
