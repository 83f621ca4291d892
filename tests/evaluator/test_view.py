"""view.html: what it holds is right, it is one safe file, and a browser draws it without a request."""

import base64
import hashlib
import html
import json
import re
import runpy
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from campaign.flight.las import LasSpec, Returns, StripWriter
from campaign.truth import TrueMounting, TrueReturns, Truth, write_true_returns, write_true_trajectories, write_truth
from evaluator.frames import WorldFrame, body_pose
from evaluator.georeference import nominal_mountings, world_points
from evaluator.model import CampaignData
from evaluator.results import Evaluation, build_results
from evaluator.scores.score_points import point_errors
from evaluator.view import page, points, solids, write_view
from evaluator.view.pack import error_code
from evaluator.view.terrain import filled

N = 3000  # returns of a strip
OFFSET_M = 0.05  # added to every measured range
BROWSER = runpy.run_path(str(Path(__file__).with_name("browser.py")))
CHROMIUM = BROWSER["chromium"]()


def _returns(map_m: np.ndarray, time: np.ndarray, strip: int) -> Returns:
    n, zero = len(time), np.zeros(len(time), np.float32)
    return Returns(
        xyz_m=map_m,
        gps_time_s=time,
        intensity=np.full(n, 1000, np.uint16),
        return_number=np.ones(n, np.uint8),
        number_of_returns=np.ones(n, np.uint8),
        scan_angle_deg=zero,
        encoder_angle_deg=zero,
        channel=np.zeros(n, np.uint8),
        amplitude=zero + 100.0,
        pulse_width_ns=zero + 4.0,
        reflectance_db=zero + np.float32(10.0 * np.log10(0.4)),
        strip=np.full(n, strip, np.uint16),
        packet=np.full(n, -1, np.int64),
        return_location_ps=zero,
        wave_direction_m_ps=np.zeros((n, 3), np.float32),
    )


def _mounting(evaluation: Evaluation) -> TrueMounting:
    assert evaluation.mounting is not None
    m = evaluation.mounting.body_from_lidar
    rotation: Any = tuple(map(tuple, m.rotation.tolist()))
    lever: Any = tuple(m.lever_arm_m.tolist())
    return TrueMounting(
        rotation=rotation, lever_arm_m=lever, boresight_deg=(0.0, 0.0, 0.0), lever_arm_error_m=(0.0, 0.0, 0.0)
    )


@pytest.fixture
def flown(evaluation: Evaluation, campaign_data: CampaignData) -> Evaluation:
    """Eight strips over flat ground, georeferenced by the nominal mounting; the true one is what the adjustment found. Every
    range is 5 cm too long. truth/ says both."""
    assert evaluation.mounting is not None
    assert campaign_data.rig is not None
    frame, rng = WorldFrame(campaign_data.manifest), np.random.default_rng(3)
    true, nominal = evaluation.mounting.body_from_lidar, nominal_mountings(campaign_data.rig)[1]
    root = campaign_data.folder.root
    (root / "truth").mkdir(parents=True)
    for sortie in campaign_data.sorties:
        assert sortie.trajectory is not None
        for strip in sortie.strips:
            time = np.sort(sortie.trajectory.gps_time_s[0] + 10.0 * (strip - 1) + rng.uniform(1.0, 9.0, N))
            position, turn = body_pose(sortie.trajectory, time, frame)
            ground = position + np.c_[rng.uniform(-16.0, 16.0, (N, 2)), -position[:, 2]]
            ground[:, 2] = 0.02 * ground[:, 0]
            p = (np.einsum("nji,nj->ni", turn, ground - position) - true.lever_arm_m) @ true.rotation
            length = np.linalg.norm(p, axis=1)
            measured = p * (1.0 + OFFSET_M / length)[:, None]
            delivered = world_points(measured, time, sortie.trajectory, nominal, frame)
            spec = LasSpec(
                projection_epsg=4549,
                height_epsg=5737,
                creation_date="2026-06-12",
                system_identifier="hand",
                offset_m=tuple(np.floor(frame.map_from_world(np.zeros(3))).tolist()),
                sample_count=32,
                sampling_ps=1000,
                bit_depth=16,
                file_source_id=strip,
            )
            las, laz = sortie.folder.strip_las(strip), sortie.folder.strip_points(strip)
            with StripWriter(las, laz, spec) as writer:
                writer.write(_returns(frame.map_from_world(delivered), time, strip), np.zeros((0, 32), np.uint16))
            write_true_returns(
                root / "truth" / f"returns_{sortie.folder.number:02d}_{strip:02d}.npz",
                TrueReturns(
                    range_m=length,
                    normal_world=np.zeros((N, 3), np.float32),
                    target=np.full(N, -1, np.int32),
                    face=np.full(N, -1, np.int8),
                ),
            )
    trajectories = {s.folder.number: s.trajectory for s in campaign_data.sorties if s.trajectory is not None}
    write_true_trajectories(root / "truth" / "trajectory.npz", trajectories)
    truth = Truth(
        seed=1,
        camera=_mounting(evaluation),
        lidar=_mounting(evaluation),
        lens=campaign_data.camera.calibration.lens,  # type: ignore[union-attr]
        camera_clock_s=0.0,
        lidar_clock_s=0.0,
        range_offset_m=OFFSET_M,
        range_scale=0.0,
        lidar_gain=1.0,
        camera_gain=1.0,
        targets=(),
    )
    (root / "manifest.json").write_text(campaign_data.manifest.model_dump_json())
    write_truth(root, truth)
    return evaluation


def scene_of(path: Path) -> dict[str, Any]:
    """The scene as the page's own program reads it."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', path.read_text(), re.S)
    assert found is not None
    scene: dict[str, Any] = json.loads(found[1])
    return scene


def unpacked(scene: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Places as delivered and adjusted, (n, 3) each, from the page's bytes alone. [m]"""
    cloud = scene["cloud"]
    place = np.frombuffer(base64.b64decode(cloud["place"]), "<u2").reshape(-1, 3).astype(float)
    shift = np.frombuffer(base64.b64decode(cloud["shift"]), np.int8).reshape(-1, 3) * cloud["shift_step"]
    first = 0
    for tile in cloud["tiles"]:
        part = slice(first, first + tile["count"])
        place[part] = place[part] * tile["step"] + tile["low"]
        first += tile["count"]
    assert first == len(place)
    return place + scene["origin"], place + scene["origin"] + shift


def test_points_are_the_files_points(flown: Evaluation, tmp_path: Path) -> None:
    """Rationale: a picture is believed; what it shows must be what was measured. Expected: all 24 000 returns, which are fewer than
    the page holds; each within 1 mm of a row of its LAS file, as delivered, and within 4 mm of the true ground plus the 5 cm that
    its range is too long, adjusted; errors of 5 cm adjusted. Tolerance: steps of the packing, 1 mm and 1/127 of the greatest
    shift (below 0.5 m); an error's code has steps of 2.8 %.
    """
    path = tmp_path / "view.html"
    assert flown.data is not None
    write_view(path, flown, build_results(flown), point_errors(flown.data.folder.root))
    scene = scene_of(path)
    delivered, adjusted = unpacked(scene)
    cloud = points.sample_cloud(flown, None)
    assert len(delivered) == 8 * N == cloud.total == scene["cloud"]["total"]
    known = cloud.joined("map_m")
    assert np.abs(np.sort(known, axis=0) - np.sort(delivered, axis=0)).max() < 1e-3
    frame = WorldFrame(flown.data.manifest)
    world = frame.world_from_map(adjusted)
    height = world[:, 2] - 0.02 * world[:, 0]
    assert height.mean() == pytest.approx(-OFFSET_M, abs=0.004)  # nearly straight down
    assert np.abs(height + OFFSET_M).max() < 0.012
    codes = np.frombuffer(base64.b64decode(scene["cloud"]["error"][1]), np.uint8)
    np.testing.assert_allclose(1e-3 * 10 ** (3.0 * (codes - 1.0) / 254.0), OFFSET_M, rtol=0.03)
    as_delivered = np.frombuffer(base64.b64decode(scene["cloud"]["error"][0]), np.uint8)
    assert (as_delivered > codes).mean() > 0.9  # the mounting's error is greater than the range's
    assert not any("truth" in line for line in scene["notes"])
    bright = np.frombuffer(base64.b64decode(scene["cloud"]["reflectance"]), np.uint8)
    np.testing.assert_allclose((bright - 1.0) * scene["cloud"]["reflectance_step"], 0.4, atol=0.003)


def test_field_campaign_has_no_errors(flown: Evaluation, tmp_path: Path) -> None:
    """Expected: without truth/ `point_errors` is None and the page offers no error; a table of another strip is a note, and the
    other strips keep theirs. Tolerance: none."""
    assert flown.data is not None
    root, path = flown.data.folder.root, tmp_path / "view.html"
    write_true_returns(
        root / "truth" / "returns_01_01.npz",
        TrueReturns(
            range_m=np.ones(3),
            normal_world=np.zeros((3, 3), np.float32),
            target=np.zeros(3, np.int32),
            face=np.zeros(3, np.int8),
        ),
    )
    write_view(path, flown, build_results(flown), point_errors(root))
    scene = scene_of(path)
    assert sum("truth/returns_01_01.npz" in line for line in scene["notes"]) == 1
    codes = np.frombuffer(base64.b64decode(scene["cloud"]["error"][0]), np.uint8)
    strip = np.frombuffer(base64.b64decode(scene["cloud"]["strip"]), np.uint8)
    assert not codes[strip == 0].any()
    assert codes[strip > 0].all()
    shutil.rmtree(root / "truth")
    assert point_errors(root) is None
    write_view(path, flown, build_results(flown), point_errors(root))
    assert scene_of(path)["cloud"]["error"] == [None, None]


def test_one_safe_file(flown: Evaluation, tmp_path: Path) -> None:
    """Rationale: text of a campaign folder is somebody else's. Expected: a title with a script in it arrives as characters; the
    policy names the page's own script and style by their sums and nothing else may run; no address and no path of the
    machine in it; the notice of a synthetic campaign; the same bytes twice; below 8 MB. Tolerance: none."""
    assert flown.data is not None
    evil = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
    turned = "\u202e\u2066\x1b"
    manifest = flown.data.manifest.model_copy(update={"title": evil + turned, "campaign": "a<b>&amp;"})
    exposures = tuple(replace(e, image=f"{e.image}<i>{turned}") for e in flown.data.sorties[0].exposures)
    first = replace(flown.data.sorties[0], exposures=exposures)
    data = replace(flown.data, manifest=manifest, sorties=(first, *flown.data.sorties[1:]))
    bad = replace(flown, data=data, campaign="a<b>&amp;")
    path, again = tmp_path / "view.html", tmp_path / "again.html"
    for out in (path, again):
        write_view(out, bad, build_results(bad))
    text = path.read_text()
    assert path.read_bytes() == again.read_bytes()
    assert len(text) < 8e6
    assert text.count("<script") == 2
    assert "<img" not in text
    assert not re.search("[\u202e\u2066\x1b]|u202e|u001b", text)
    assert html.escape(evil, quote=False) in text
    assert any("<i>" in c["image"] for c in scene_of(path)["cameras"])
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    script = re.search(r"<script>(.*?)</script>", text, re.S)
    style = re.search(r"<style>(.*?)</style>", text, re.S)
    assert policy is not None
    assert script is not None
    assert style is not None
    for kind, block in (("script-src", script[1]), ("style-src", style[1])):
        digest = base64.b64encode(hashlib.sha256(block.encode()).digest()).decode()
        assert f"{kind} 'sha256-{digest}';" in policy[1]
    assert "unsafe" not in policy[1]
    assert "innerHTML" not in script[1]
    assert not re.search(r"https?:", text)
    assert str(data.folder.root) not in text
    assert "虚拟检测场仿真数据" in text
    field = replace(flown, synthetic=False)
    write_view(path, field, build_results(field), language="en")
    assert "Synthetic data" not in re.sub(r'<script type="application.*', "", path.read_text(), flags=re.S)


def test_facts_of_targets(flown: Evaluation, tmp_path: Path) -> None:
    """Expected: every target at its surveyed place, to 0.1 mm, with P_i as results.json states it, panels with both reflectances; a
    folder with nothing but a manifest still gives a page. Tolerance: none but rounding."""
    assert flown.data is not None
    results = build_results(flown)
    results["indicators"]["calibration_error"]["companions"]["per_target_px"] = {"F03": 0.23456}
    path = tmp_path / "view.html"
    write_view(path, flown, results, language="en")
    scene = scene_of(path)
    targets = {t["id"]: t for t in scene["targets"]}
    for t in flown.data.targets:
        at = np.array(targets[t.id]["at"]) + scene["origin"]
        np.testing.assert_allclose(at, [t.easting_m, t.northing_m, t.height_m], atol=1e-5)
        assert targets[t.id]["rows"][0] == ["Easting", f"{t.easting_m:.4f} m"]
    assert ["Calibration error Pᵢ", "0.235 px"] in targets["F03"]["rows"]
    assert ["Calibration error Pᵢ", "Not measured"] in targets["F04"]["rows"]
    panel = next(p for p in flown.panels if p.id == "P05")
    assert any(f"{panel.lidar_percent:.2f} %" in value for _, value in targets["P05"]["rows"])
    nothing = replace(flown.data, plan=None, targets=(), spectra=None, camera=None, lidar=None, rig=None, sorties=())
    write_view(path, replace(flown, data=nothing), results)
    assert scene_of(path)["cloud"] is None


def test_thinning_is_even() -> None:
    """Rationale: two strips overlap; the thinned cloud should not. Expected: of a square whose left half is nine times as dense,
    both halves keep within 25 % the same number, with one point a cube and not more than asked. Tolerance: cubes at the rim."""
    rng = np.random.default_rng(5)
    left, right = (
        rng.uniform(0, 1, (90_000, 3)) * [0.5, 1, 0],
        rng.uniform(0, 1, (10_000, 3)) * [0.5, 1, 0] + [0.5, 0, 0],
    )
    xyz = 100.0 * np.concatenate([left, right])
    kept = points.thin_evenly(xyz, points.row_hash(np.arange(len(xyz)), 1), 4000)
    assert 3200 <= len(kept) <= 4000
    assert (xyz[kept, 0] < 50.0).sum() == pytest.approx(len(kept) / 2, rel=0.25)


def test_solids_follow_the_drawing() -> None:
    """Expected: 6.2.2 c by its own numbers: the four face planes of both frustums meet 0.7071 b from the large rim, inverted at the
    mark, upright above it. Tolerance: float32."""
    for style, vertex in (("inverted", 0.0), ("upright", solids.VERTEX_PER_EDGE)):
        shape = solids.template(f"frustum {style}", 0.1)
        triangles = shape.xyz.reshape(-1, 3, 3).astype(float)
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        sloping = np.abs(np.abs(normal[:, 2]) - np.cos(np.radians(54.7356))) < 1e-3
        assert sloping.sum() == 8
        apart = np.einsum("ij,ij->i", normal[sloping], [0.0, 0.0, vertex] - triangles[sloping, 0])
        np.testing.assert_allclose(apart, 0.0, atol=1e-6)


def test_codes_and_holes() -> None:
    """Expected: 1 mm, 1 m and more, and nothing are codes 1, 255 and 0; a hole under a target closes, what lies outside stays."""
    assert error_code(np.array([1e-5, 1e-3, 1.0, 7.0, np.nan])).tolist() == [1, 1, 255, 255, 0]
    grid = np.full((20, 20), np.nan)
    grid[4:16, 4:16] = 2.0
    grid[8:12, 8:12] = np.nan
    done = filled(grid, 12)
    assert (done[4:16, 4:16] == 2.0).all()
    assert np.isnan(done).sum() == 400 - 144


@pytest.fixture
def browser() -> Iterator[Any]:
    """A headless Chromium without network."""
    if CHROMIUM is None:
        pytest.skip("no Chromium here")
    with BROWSER["Browser"](CHROMIUM) as started:
        yield started


def test_in_a_browser(flown: Evaluation, tmp_path: Path, browser: Any) -> None:
    """Rationale: the page is for people's eyes, offline. Expected, from disk without network: no console message, no request
    but the page and what it carries; the canvas shows hundreds of colours and they change with the colour scale; a click in
    the list moves the camera to that target and shows its place; a click on the canvas there chooses it; on a phone the list
    is a drawer; a browser without WebGL2 says so. Tolerance: none."""
    assert flown.data is not None
    path = tmp_path / "view.html"
    write_view(path, flown, build_results(flown), point_errors(flown.data.folder.root))
    browser.size(1000, 700)
    browser.open(path)
    assert browser.state("state") == "drawn"
    before = browser.picture()[20:680, 350:980]
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 300
    browser.script(
        "const s = document.querySelector('#colour'); s.value = 'error'; s.dispatchEvent(new Event('change'))"
    )
    after = browser.picture()[20:680, 350:980]
    assert (cv2.absdiff(before, after).max(axis=2) > 20).mean() > 0.05
    camera = browser.state("camera")
    browser.script("[...document.querySelectorAll('#list button')].find(b => b.textContent.startsWith('F07')).click()")
    browser.settle()
    target = next(t for t in scene_of(path)["targets"] if t["id"] == "F07")
    assert browser.state("camera") != camera
    np.testing.assert_allclose([float(v) for v in browser.state("camera").split()[:3]], target["at"], atol=2e-3)
    assert browser.script("document.querySelector('#card-rows dd').textContent") == target["rows"][0][1]
    browser.script("document.querySelector('#card-close').click()")
    browser.click(665, 350)
    assert browser.script("document.querySelector('#card-title').textContent").startswith("F07")
    browser.script("const q = document.querySelector('#search'); q.value = 'p1'; q.dispatchEvent(new Event('input'))")
    assert browser.script("document.querySelectorAll('#list li:not([hidden])').length") == 10  # P10 to P19
    browser.size(390, 780)
    browser.settle()
    assert browser.script("document.documentElement.scrollWidth") == 390
    assert browser.script("getComputedStyle(document.querySelector('#inside')).display") == "none"
    browser.script("document.querySelector('#drawer').click()")
    assert browser.script("getComputedStyle(document.querySelector('#inside')).display") == "flex"
    browser.before_each_page(
        "HTMLCanvasElement.prototype.getContext = (f => function (k, ...a) "
        "{ return k === 'webgl2' ? null : f.call(this, k, ...a) })(HTMLCanvasElement.prototype.getContext)"
    )
    browser.open(path)
    assert browser.state("state") == "no-webgl"
    assert "WebGL2" in browser.script("document.querySelector('#notice').textContent")
    assert browser.script("document.querySelector('#notice').hidden") is False
    assert browser.messages == []
    assert {url.split(":", 1)[0] for url in browser.requests} <= {"file", "data"}


def test_scripts_are_complete() -> None:
    """Expected: the page's program is the five files in their order, and none of them ends the script element."""
    for name in page.SCRIPTS:
        assert "</script" not in (page.HERE / name).read_text()
