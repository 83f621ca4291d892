"""score.json: truth of a hand-made mounting against estimates, with the evaluator's own frames."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from campaign.config import Lens
from campaign.errors import TestrangeError
from campaign.manifest import write_manifest
from campaign.sensors import write_sheet
from campaign.truth import TrueMounting, Truth, write_truth
from evaluator.model import CampaignData, MountingSolution
from evaluator.results import Evaluation, write_results
from evaluator.scores.score import score_campaign, true_values, write_score

# 90-degree turns and round figures, so that every product is done by hand.
CAMERA_ROTATION = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))  # the nominal nadir camera
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def truth_of(camera: TrueMounting, lidar: TrueMounting) -> Truth:
    """Truth with nothing but mountings."""
    return Truth(
        seed=1,
        camera=camera,
        lidar=lidar,
        lens=Lens(fx_px=3000.0, fy_px=3000.0, cx_px=1536.0, cy_px=1024.0),
        camera_clock_s=0.0,
        lidar_clock_s=0.0,
        range_offset_m=0.0,
        range_scale=0.0,
        lidar_gain=1.0,
        camera_gain=1.0,
        targets=(),
    )


def faultless() -> tuple[TrueMounting, TrueMounting]:
    """Camera at (0.1, 0.03, 0.08), LiDAR at (-0.05, -0.02, 0.12) in the body frame, both as drawn."""
    none = {"boresight_deg": (0.0, 0.0, 0.0), "lever_arm_error_m": (0.0, 0.0, 0.0)}
    return (
        TrueMounting(rotation=CAMERA_ROTATION, lever_arm_m=(0.1, 0.03, 0.08), **none),
        TrueMounting(rotation=IDENTITY, lever_arm_m=(-0.05, -0.02, 0.12), **none),
    )


def test_camera_from_lidar_by_hand(campaign_data: CampaignData) -> None:
    """Rationale: with both mountings as drawn the angles are zero; the LiDAR lies at (-0.15, -0.05, 0.04) from the camera in
    body axes, and camera x is body y, camera y is minus body x, camera z is body z.
    Expected: (-0.05, 0.15, 0.04). Tolerance: rounding."""
    assert campaign_data.rig is not None
    found = true_values(truth_of(*faultless()), campaign_data.rig)
    assert [found[f"camera_from_lidar_{a}"] for a in ("roll", "pitch", "yaw")] == pytest.approx([0.0] * 3, abs=1e-12)
    assert [found[f"camera_from_lidar_{a}"] for a in "xyz"] == pytest.approx([-0.05, 0.15, 0.04], abs=1e-12)


def test_boresight_about_one_axis(campaign_data: CampaignData) -> None:
    """Rationale: a camera turned by +1 degree of yaw against a LiDAR as drawn: camera_from_lidar = (Rz N)^-1 L, so
    nominal^-1 camera_from_lidar = N N^-1 Rz^-1 = Rz(-1 degree), whatever N is.
    Expected: yaw -1, others 0. A LiDAR turned alone gives its own sign: roll +0.5. Tolerance: rounding."""
    assert campaign_data.rig is not None
    camera, lidar = faultless()
    a = np.radians(1.0)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    turned = camera.model_copy(
        update={"rotation": tuple(map(tuple, turn @ np.array(CAMERA_ROTATION))), "boresight_deg": (0.0, 0.0, 1.0)}
    )
    found = true_values(truth_of(turned, lidar), campaign_data.rig)
    angles = [found[f"camera_from_lidar_{n}"] for n in ("roll", "pitch", "yaw")]
    assert angles == pytest.approx([0.0, 0.0, -1.0], abs=1e-12)
    assert found["camera_boresight_yaw"] == 1.0
    b = np.radians(0.5)
    turn = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    found = true_values(
        truth_of(camera, lidar.model_copy(update={"rotation": tuple(map(tuple, turn))})), campaign_data.rig
    )
    angles = [found[f"camera_from_lidar_{n}"] for n in ("roll", "pitch", "yaw")]
    assert angles == pytest.approx([0.5, 0.0, 0.0], abs=1e-12)


@pytest.fixture
def scored_folder(campaign_data: CampaignData, evaluation: Evaluation, mounting_solution: MountingSolution) -> Path:
    """A folder on disk whose truth is the hand-made mounting, and results.json beside it whose camera roll is 0.006 deg off."""
    root = campaign_data.folder.root
    root.mkdir(parents=True)
    assert campaign_data.rig is not None
    campaign_data.folder.rig.parent.mkdir()
    write_sheet(campaign_data.folder.rig, campaign_data.rig)
    write_manifest(root, campaign_data.manifest)

    def true(sensor: int) -> TrueMounting:
        mounting = (mounting_solution.body_from_camera, mounting_solution.body_from_lidar)[sensor]
        six = mounting_solution.parameters[6 * sensor : 6 * sensor + 6]
        return TrueMounting(
            rotation=tuple(map(tuple, mounting.rotation.tolist())),
            lever_arm_m=tuple(mounting.lever_arm_m.tolist()),
            boresight_deg=tuple(np.degrees(six[:3]).tolist()),
            lever_arm_error_m=tuple(six[3:].tolist()),
        )

    campaign_data.folder.truth.mkdir()
    write_truth(root, truth_of(true(0), true(1)))
    off = mounting_solution.parameters.copy()
    off[0] += np.radians(0.006)
    write_results(
        root.parent / "results.json", replace(evaluation, mounting=replace(mounting_solution, parameters=off))
    )
    return root


def test_score_of_a_known_error(scored_folder: Path) -> None:
    """Rationale: the camera's roll is estimated 0.006 degrees too high with a stated 0.003; nothing else is off but the made-up
    angles of camera_from_lidar. Expected: error 0.006, z = 2, the other eleven parameters |z| < 1e-6, x y z of
    camera_from_lidar exact; 18 items. Tolerance: 1e-9 deg, twelve digits in results.json."""
    score = score_campaign(scored_folder, scored_folder.parent / "results.json")
    items = {i.quantity: i for i in score.items}
    assert len(items) == 18
    roll = items["camera_boresight_roll"]
    assert (roll.unit, roll.truth) == ("deg", pytest.approx(0.25))
    assert roll.error == pytest.approx(0.006, abs=1e-9)
    assert roll.z == pytest.approx(2.0, abs=1e-6)
    others = [i.z for n, i in items.items() if not n.startswith("camera_from_lidar") and n != "camera_boresight_roll"]
    assert np.abs(np.array(others, dtype=float)).max() < 1e-6
    assert [items[f"camera_from_lidar_{a}"].error for a in "xyz"] == pytest.approx([0.0] * 3, abs=1e-9)
    write_score(scored_folder.parent / "score.json", score)
    written = json.loads((scored_folder.parent / "score.json").read_text())
    assert set(written["items"][0]) == {"quantity", "unit", "truth", "estimate", "error", "std", "z"}
    assert written["max_abs_z"] == pytest.approx(score.max_abs_z)


def test_no_mounting_no_items(scored_folder: Path, evaluation: Evaluation) -> None:
    """Rationale: results without an adjustment can still be scored. Expected: no item, no greatest z."""
    write_results(scored_folder.parent / "results.json", replace(evaluation, mounting=None))
    score = score_campaign(scored_folder, scored_folder.parent / "results.json")
    assert (score.items, score.max_abs_z) == ((), None)


def test_wrong_partner(scored_folder: Path, evaluation: Evaluation) -> None:
    """Rationale: results of another campaign would give plausible nonsense. Expected: one line that names both ids."""
    write_results(scored_folder.parent / "results.json", replace(evaluation, campaign="other"))
    with pytest.raises(TestrangeError, match=re.escape("got other; expected hand-made")):
        score_campaign(scored_folder, scored_folder.parent / "results.json")


def test_torn_mounting_block(scored_folder: Path) -> None:
    """Rationale: somebody else's results.json may be short. Expected: one line, no traceback."""
    path = scored_folder.parent / "results.json"
    content = json.loads(path.read_text())
    content["mounting"]["std"] = content["mounting"]["std"][:3]
    path.write_text(json.dumps(content))
    with pytest.raises(TestrangeError, match="lists of the same length"):
        score_campaign(scored_folder, path)


def test_field_campaign_has_no_score(scored_folder: Path) -> None:
    """Rationale: truth/ exists only in simulated campaigns. Expected: one line that says so."""
    (scored_folder / "truth").rename(scored_folder / "no-truth")
    with pytest.raises(TestrangeError, match="has no truth/"):
        score_campaign(scored_folder, scored_folder.parent / "results.json")
