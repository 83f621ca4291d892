"""Injected faults of the lens and of the survey: what they change, and what they leave alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from campaign.config import Config
from campaign.errors import ConfigError
from campaign.load import load_config
from campaign.truth import read_truth
from scenes.build import build_scene
from scenes.model import Scene
from simulator.bench.placements import bench_lens
from simulator.camera.view import frame_pose, project
from simulator.faults import require_targets, true_lens, with_true_lens
from simulator.flight import rig
from simulator.flight.frames import SiteFrame
from simulator.flight.plan import fly
from simulator.paperwork import surveyed_targets
from simulator.simulate import simulate_campaign

TINY = Path(__file__).parents[1] / "data" / "tiny.toml"
LENS = ("faults.principal_distance_px=2.5", "faults.principal_point_px=[1.5, -0.75]", "faults.k1=0.004")


def config(*overrides: str) -> Config:
    return load_config(TINY, list(overrides))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(config())


def _places(scene: Scene, *overrides: str) -> dict[str, np.ndarray]:
    of = config(*overrides)
    rows = surveyed_targets(of, scene, SiteFrame(of.site))
    return {r.id: np.array([r.easting_m, r.northing_m, r.height_m, r.azimuth_deg]) for r in rows}


def test_the_lens_moves_and_its_certificate_does_not() -> None:
    """Rationale: a fault of the lens is one that the certificate does not know. Expected: fx and fy longer by 2.5 px, the
    principal point moved, k1 greater by 0.004, all else as it was; the sheet to the last digit; applied twice is applied once."""
    before, after = config(), config(*LENS)
    lens, fault = before.camera.lens, true_lens(after)
    assert (fault.fx_px - lens.fx_px, fault.fy_px - lens.fy_px) == pytest.approx((2.5, 2.5), abs=1e-9)
    assert (fault.cx_px - lens.cx_px, fault.cy_px - lens.cy_px) == pytest.approx((1.5, -0.75), abs=1e-9)
    assert fault.k1 - lens.k1 == pytest.approx(0.004, abs=1e-12)
    assert (fault.k2, fault.k3, fault.p1, fault.p2) == (lens.k2, lens.k3, lens.p1, lens.p2)
    assert rig.camera_sheet(after) == rig.camera_sheet(before)
    once = with_true_lens(after)
    assert once.camera.lens == fault
    assert with_true_lens(once) == once
    assert with_true_lens(before) == before


def test_the_bench_sees_the_same_lens() -> None:
    """Rationale: 9.2 is what finds a lens that left its certificate. Expected: the bench's lens carries the whole fault, times
    the factor of the bench's focus, which the fault does not change."""
    before, after = bench_lens(config()), bench_lens(with_true_lens(config(*LENS)))
    breathing = before.fx_px / config().camera.lens.fx_px
    assert after.fx_px - before.fx_px == pytest.approx(2.5 * breathing, abs=1e-9)
    assert after.cx_px - before.cx_px == pytest.approx(1.5, abs=1e-9)


def test_pictures_move_as_the_lens_does(scene: Scene) -> None:
    """Rationale: every picture is made by the true lens. Expected: for a longer principal distance alone, the image of a mark
    moves away from the principal point by 2.5/1502 of its distance; of the moved point alone, by its move."""
    layout = scene.layout
    at = fly(config(), layout)[0]
    pose = frame_pose(at.motion, rig.true_camera(config()), at.strips[0].exposure_s[0], 1e-3)
    marks = np.stack([t.mark_m for t in scene.targets])
    plain = project(config().camera, pose, marks)[0]
    longer = project(with_true_lens(config(LENS[0])).camera, pose, marks)[0]
    moved = project(with_true_lens(config(LENS[1])).camera, pose, marks)[0]
    lens = config().camera.lens
    expected = (plain - [lens.cx_px, lens.cy_px]) * 2.5 / np.array([lens.fx_px, lens.fy_px])
    assert longer - plain == pytest.approx(expected, abs=1e-6)
    assert np.abs(expected).max() > 0.5
    assert moved - plain == pytest.approx(np.tile([1.5, -0.75], (len(marks), 1)), abs=1e-6)


@pytest.mark.parametrize(
    ("override", "name"),
    [
        ("faults.principal_distance_px=-1600.0", "faults.principal_distance_px"),
        ("faults.principal_point_px=[-900.0, 0.0]", "faults.principal_point_px"),
    ],
)
def test_a_fault_that_leaves_no_lens_is_one_line(override: str, name: str) -> None:
    with pytest.raises(ConfigError, match=name) as error:
        true_lens(config(override))
    assert "\n" not in str(error.value)


def test_a_blunder_of_the_survey_moves_one_row(scene: Scene) -> None:
    """Rationale: one wrong row, everything else to the digit as without it. Expected: exactly the error (rows are rounded to
    10 um)."""
    plain = _places(scene)
    target = next(t.id for t in scene.targets if t.kind == "frustum")
    wrong = _places(scene, f'faults.survey_target="{target}"', "faults.survey_error_m=[0.06, -0.08, 0.03]")
    for each, row in plain.items():
        expected = np.array([0.06, -0.08, 0.03, 0.0]) if each == target else np.zeros(4)
        assert wrong[each] - row == pytest.approx(expected, abs=1.1e-5)


def test_swapped_targets_exchange_places(scene: Scene) -> None:
    """Rationale: two points booked under each other's name. Expected: each row holds where the other stands and keeps its own
    azimuth, which comes from the setting out; every other row is untouched."""
    plain = _places(scene)
    a, b = [t.id for t in scene.targets if t.kind == "frustum"][:2]
    swapped = _places(scene, f'faults.swapped_targets=["{a}", "{b}"]')
    assert np.array_equal(swapped[a][:3], plain[b][:3]) and swapped[a][3] == plain[a][3]
    assert np.array_equal(swapped[b][:3], plain[a][:3]) and swapped[b][3] == plain[b][3]
    assert all(np.array_equal(swapped[t], plain[t]) for t in plain if t not in (a, b))


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        (('faults.survey_target="F99"',), "faults.survey_target: not a target of this range; got F99"),
        (('faults.swapped_targets=["F01", "Q1"]',), "faults.swapped_targets: not a target of this range; got Q1"),
        (('faults.swapped_targets=["F01", "F01"]',), "swapped with itself"),
        (("faults.survey_error_m=[0.1, 0.0, 0.0]",), "set faults.survey_target"),
    ],
)
def test_unknown_targets_are_one_line(scene: Scene, overrides: tuple[str, ...], text: str) -> None:
    with pytest.raises(ConfigError) as error:
        require_targets(config(*overrides), tuple(t.id for t in scene.targets))
    assert text in str(error.value)
    assert "\n" not in str(error.value)


def test_no_target_at_all(scene: Scene) -> None:
    with pytest.raises(ConfigError, match="no target stands on this range"):
        require_targets(config('faults.survey_target="F01"'), ())


def test_the_survey_of_an_empty_range_has_no_rows(scene: Scene) -> None:
    """A range with only panels is surveyed like any other."""
    panels = replace(scene, targets=tuple(t for t in scene.targets if t.kind == "panel"))
    assert len(_places(panels)) == 20


def test_a_flight_with_a_lens_fault_is_another_picture_under_the_same_papers(tmp_path: Path) -> None:
    """Rationale: closed loop of the room. Expected: truth/ has the faulty lens and its marks where that lens sees them; sheets,
    plan and survey are those of the flight without the fault, byte for byte; truth/campaign.toml still asks for the fault."""
    small = (
        'campaign.parts=["camera"]',
        "flight.heights_m=[22.0]",
        "flight.headings_deg=[0.0]",
        "camera.width_px=320",
        "camera.height_px=240",
        "camera.pixel_size_um=40.0",
        "camera.lens.fx_px=330.0",
        "camera.lens.fy_px=330.0",
        "camera.lens.cx_px=161.0",
        "camera.lens.cy_px=118.0",
        "render.target_samples=1",
    )
    folders = []
    for name, overrides in (("plain", ()), ("fault", LENS)):
        folder = tmp_path / name
        folder.mkdir()
        simulate_campaign(config(*small, *overrides), folder)
        folders.append(folder)
    plain, fault = folders
    for paper in ("sensors/camera.json", "sensors/rig.json", "survey/targets.csv", "plan.json"):
        assert (plain / paper).read_bytes() == (fault / paper).read_bytes(), paper
    before, after = read_truth(plain), read_truth(fault)
    assert after.lens == true_lens(config(*small, *LENS))
    assert before.lens == config(*small).camera.lens
    assert "principal_distance_px = 2.5" in (fault / "truth" / "campaign.toml").read_text(encoding="utf-8")
    image = next((plain / "sorties" / "01" / "images").glob("*.tif"))
    assert image.read_bytes() != (fault / image.relative_to(plain)).read_bytes()
