"""pycolmap, given the exported images and nothing else, finds cameras and focal length again. Slow: some minutes.

Images that look straight down on flat ground leave focal length against flying height free, and images that all lean to one
side the principal point (docs/exports.md has the figures). This aircraft sways by five degrees in roll and four in pitch; the
field that stays in view is small, so that few targets stand in it.
"""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from campaign.config import Config
from campaign.load import load_config
from campaign.truth import read_truth
from evaluator.frames import WorldFrame, body_pose
from evaluator.load import load_campaign
from testrange.export import export_campaign

SWAYING = (
    "flight.heights_m=[45.0]",
    "flight.headings_deg=[0.0, 180.0, 90.0, 270.0]",
    "flight.images_per_strip=3",
    "flight.image_spacing_m=6.0",
    "flight.run_in_m=12.0",
    "platform.roll_std_deg=5.0",
    "platform.pitch_std_deg=4.0",
    "targets.frustums.count=4",
    "targets.panels.count_of_each=1",
    "render.target_samples=16",
)


def true_centres(campaign: Path) -> dict[str, np.ndarray]:
    """Image's stem -> projection centre, world frame, from truth/. [m]"""
    from campaign.flight.trajectory import Trajectory

    data, truth = load_campaign(campaign), read_truth(campaign)
    arm = np.array(truth.camera.lever_arm_m)
    found = {}
    with np.load(campaign / "truth" / "trajectory.npz") as true:
        for sortie in data.sorties:
            prefix = f"s{sortie.folder.number:02d}_"
            flown = Trajectory(**{k.removeprefix(prefix): true[k] for k in true.files if k.startswith(prefix)})
            for exposure in sortie.exposures:
                time = np.array([exposure.gps_time_s - truth.camera_clock_s])
                position, turn = body_pose(flown, time, WorldFrame(data.manifest))
                found[Path(exposure.image).stem] = position[0] + turn[0] @ arm
    return found


def reconstruct(images: Path, work: Path) -> list[pycolmap.Reconstruction]:
    """SIFT, exhaustive matching, incremental mapping, then one adjustment with the principal point free; one OPENCV camera."""
    database = work / "database.db"
    pycolmap.set_random_seed(0)
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "OPENCV"
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.sift.max_num_features = 3000
    pycolmap.extract_features(
        database, images, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader, extraction_options=extraction
    )
    pycolmap.match_exhaustive(database)
    (work / "sparse").mkdir()
    found = list(pycolmap.incremental_mapping(database, images, work / "sparse").values())
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = True
    for model in found:
        pycolmap.bundle_adjustment(model, options)
    return found


def similarity_residuals(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Target minus source after the best scale, rotation and shift: (n, 3), (n, 3) -> (n, 3). Umeyama 1991."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, d, vt = np.linalg.svd(b.T @ a)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = np.trace(np.diag(d) @ flip) / (a**2).sum()
    return b - scale * a @ (u @ flip @ vt).T


def config() -> Config:
    """The flight that structure from motion needs."""
    return load_config("quickstart", SWAYING)


@pytest.mark.slow
def test_images_alone_give_cameras_and_focal_length(tmp_path: Path) -> None:
    """Rationale: the rendered images are good enough for photogrammetry: texture, optics, noise and geometry belong together.
    Expected: one model with every image; camera centres within 3 GSD of the truth after a similarity fit; focal length within
    0.5 %. Tolerance: what the export promises. Figures of other flights: docs/exports.md.
    """
    from simulator.simulate import simulate_campaign

    campaign = tmp_path / "campaign"
    campaign.mkdir()
    simulate_campaign(config(), campaign, only=frozenset({"camera"}))
    export_campaign(campaign, tmp_path / "export", "colmap")
    (model,) = reconstruct(tmp_path / "export" / "images", tmp_path)
    true = true_centres(campaign)
    centres = {Path(i.name).stem: i.projection_center() for i in model.images.values() if i.has_pose}
    assert sorted(centres) == sorted(true)
    names = sorted(true)
    off = similarity_residuals(np.array([centres[n] for n in names]), np.array([true[n] for n in names]))
    lens = read_truth(campaign).lens
    gsd_m = 45.0 / lens.fx_px
    (camera,) = model.cameras.values()
    share = camera.mean_focal_length() / (0.5 * (lens.fx_px + lens.fy_px)) - 1.0
    worst = np.linalg.norm(off, axis=1).max() / gsd_m
    print(f"{len(centres)} images, worst centre {worst:.2f} GSD, focal length {100 * share:+.3f} %")
    assert worst < 3.0
    assert abs(share) < 0.005
