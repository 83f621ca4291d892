"""`testrange plan` against the campaign flown by the same configuration, against closed forms, and what it refuses."""

import io
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.cells import cell_len
from rich.console import Console

from campaign.load import load_config
from evaluator.georeference import collect_target_returns
from evaluator.load import load_campaign
from evaluator.model import Mounting
from evaluator.mounting.geometry import observe_vertices
from evaluator.observe.panels import lidar_panel_observations
from simulator.flight import rig
from testrange.plan import Plan, plan_block, plan_campaign, print_plan
from testrange.plan import light as camera_side

TINY = Path(__file__).parents[1] / "data" / "tiny.toml"
SPEED_OF_LIGHT_M_S = 299_792_458.0
# What can be written down before the flight says the same after it.
SAME_BEFORE_AND_AFTER = ("5.1", "5.2", "5.3", "5.4", "6.2", "6.3.1", "7.1", "7.2", "7.3", "7.4", "8.1.2", "8.3.2 a")


@pytest.fixture(scope="module")
def tiny_plan() -> Plan:
    return plan_campaign(load_config(TINY))


@pytest.fixture(scope="module")
def flown_points(tiny_run: Path) -> dict[tuple[str, int], tuple[int, int]]:
    """Returns on every panel and frustum in every sortie of the flown campaign, counted with the true mounting, and the number
    of strips that gave a panel or a vertex."""
    config, data = load_config(TINY), load_campaign(tiny_run / "campaign")
    true = rig.true_lidar(config)
    mounting = Mounting(rotation=true.rotation, lever_arm_m=true.lever_arm_m)
    centres = {t.id: np.array([t.easting_m, t.northing_m, t.height_m]) for t in data.targets}
    returns = collect_target_returns(data, centres, max(t.size_m for t in data.targets) / np.sqrt(2.0) + 1.4)
    panels = [(o.panel, o.sortie, o.points) for o in lidar_panel_observations(data, returns, mounting)]
    vertices, _ = observe_vertices(data, returns, mounting, located=True)
    counts: dict[tuple[str, int], tuple[int, int]] = {}
    for target, sortie, points in [*panels, *((v.target, v.sortie, v.points) for v in vertices)]:
        total, strips = counts.get((target, sortie), (0, 0))
        counts[target, sortie] = total + points, strips + 1
    return counts


def row(plan: Plan, clause: str, words: str) -> str:
    return next(r.planned for r in plan.rows if r.clause == clause and words in r.requirement)


# ------------------------------------------------------------------------------------------------- plan against the flight


def test_rows_say_the_same_after_the_flight(tiny_plan: Plan, tiny_run: Path) -> None:
    """Rationale: sun, heights, speeds, wind, layout and survey are decided before the sensors are switched on.
    Expected: every row of these clauses has the flown campaign's own words and status, 7.2 c and 7.4 among them.
    Tolerance: none, the rows print one to three digits; but for the scans' interval, a mean over drawn pulses: 0.1 s.
    """
    scanned = "the LiDAR scans all targets within a short interval"
    flown = json.loads((tiny_run / "results" / "results.json").read_text())["conformity"]
    after = [
        (r["clause"], r["requirement"], r["measured"], r["status"])
        for r in flown
        if r["clause"].startswith(SAME_BEFORE_AND_AFTER) and r["requirement"] != scanned
    ]
    before = {(r.clause, r.requirement, r.planned, r.status) for r in tiny_plan.rows}
    assert {clause for clause, *_ in after} >= {"7.2 c", "7.4 a", "7.4 b", "7.4 c", "6.2.3 a", "6.2.3 b"}
    assert [found for found in after if found not in before] == []
    flown_s = next(r["measured"] for r in flown if r["requirement"] == scanned)
    both = [
        [float(v) for v in re.findall(r"([\d.]+) s", text)] for text in (row(tiny_plan, "6.2.3 b", scanned), flown_s)
    ]
    assert np.allclose(both[0], both[1], atol=0.11)


def test_points_on_every_target_agree_with_the_flight(
    tiny_plan: Plan, flown_points: dict[tuple[str, int], tuple[int, int]]
) -> None:
    """Rationale: the plan casts the scanner's pulses at the drawing's surfaces; the flight traces footprints with waveforms,
    a mounting that is wrong by some tenths of a degree, and noise.
    Expected: the same number on every panel and on every frustum's faces in every sortie. A frustum of which the evaluator
    found no vertex in one of the passes cannot be compared; of 18 one may be left out.
    Tolerance: 15 % each; 4 % of all panels and of all frustums together, where the places of single scan lines average out.
    """
    planned = {(p.target, p.sortie): (p.points, p.strips) for p in tiny_plan.points}
    assert planned.keys() == flown_points.keys()
    both = [key for key in planned if planned[key][1] == flown_points[key][1]]
    assert len(both) >= len(planned) - 1
    off = {key: planned[key][0] / flown_points[key][0] - 1.0 for key in both}
    assert {key: share for key, share in off.items() if abs(share) > 0.15} == {}
    for kind in "PF":
        total = [sum(c[key][0] for key in both if key[0][0] == kind) for c in (planned, flown_points)]
        assert abs(total[0] / total[1] - 1.0) < 0.04


def test_brightness_and_least_points_agree_with_the_flight(tiny_plan: Plan, tiny_run: Path) -> None:
    """Rationale: 5.5 a and b are predicted from light, exposure and pulses; the flown figures come from pictures and clouds.
    Expected: the mean brightness of the panels, and the fewest points on one.
    Tolerance: 1.5 % of full scale (neighbours throw a little light on a panel; the preview has 256 steps); 10 %.
    """
    flown = json.loads((tiny_run / "results" / "results.json").read_text())["conformity"]
    measured = {r["clause"]: r["measured"] for r in flown if r["clause"].startswith("5.5")}
    mean = [float(text.split(" %")[0]) for text in (row(tiny_plan, "5.5 a", "brightness"), measured["5.5 a"])]
    assert abs(mean[0] - mean[1]) < 1.5
    least = [
        int(re.findall(r"least (\d+)", text)[0]) for text in (row(tiny_plan, "5.5 b", "points"), measured["5.5 b"])
    ]
    assert abs(least[0] / least[1] - 1.0) < 0.10


def test_data_volume_agrees_with_the_disk(tiny_plan: Plan, tiny_run: Path) -> None:
    """Rationale: the counts are exact, compressed formats have an average size.
    Expected: the folder's bytes. Tolerance: 5 % of all; 1 % of the images, which are not compressed.
    """
    files = [path for path in (tiny_run / "campaign").rglob("*") if path.is_file()]
    assert tiny_plan.volume is not None
    assert tiny_plan.volume.total == pytest.approx(sum(p.stat().st_size for p in files), rel=0.05)
    flight = sum(p.stat().st_size for p in files if p.suffix == ".tif" and "sorties" in p.parts)
    assert tiny_plan.volume.images == pytest.approx(flight, rel=0.01)
    packets = sum(p.stat().st_size for p in files if p.suffix == ".wdp")
    assert tiny_plan.volume.waveforms == pytest.approx(packets, rel=0.10)


# ---------------------------------------------------------------------------------------------------------- what it refuses


def test_a_low_sun_is_refused_with_the_hours_that_serve() -> None:
    """Rationale: 7.2 c. At 31.3 degrees north on 25 November the declination is -20.8 degrees, so the sun stands at
    arcsin(sin φ sin δ + cos φ cos δ cos h), and solar noon is at 11:42 Beijing time (121.2 degrees east, equation of time +13 min).
    Expected: 25 degrees at 9:00, refused, with the hours during which it stays above 35 degrees.
    Tolerance: half a degree; five minutes (refraction, equation of time to a minute, steps of a minute).
    """
    plan = plan_campaign(
        load_config(TINY, ['campaign.start_time="2026-11-25T09:00:00+08:00"', 'campaign.parts=["lidar"]'])
    )
    latitude, declination, noon_min = np.radians(31.283), np.radians(-20.8), 11 * 60 + 42

    def elevation(minute: float) -> float:
        hour = np.radians((minute - noon_min) / 4.0)
        return float(
            np.degrees(
                np.arcsin(
                    np.sin(latitude) * np.sin(declination) + np.cos(latitude) * np.cos(declination) * np.cos(hour)
                )
            )
        )

    assert plan.sun_elevation_deg is not None
    assert plan.sun_elevation_deg[0] == pytest.approx(elevation(9 * 60), abs=0.5)
    assert [r.clause for r in plan.failing if r.clause.startswith("7")] == ["7.2 c"]
    assert plan.refusal is not None and "7.2 c" in plan.refusal and "Beijing time" in plan.refusal
    ((first, last),) = plan.sun_window
    minutes = [int(t[:2]) * 60 + int(t[3:]) for t in (first, last)]
    high = [m for m in range(24 * 60) if elevation(m) > 35.0]
    assert plan.duration_s is not None
    assert abs(minutes[0] - high[0]) <= 5
    assert abs(minutes[1] - (high[-1] - plan.duration_s / 60.0)) <= 5


def test_a_wide_beam_on_small_frustums_is_refused() -> None:
    """Rationale: a VLP-16's footprint (3 mrad) at 30 m is 9 cm; on faces 12.5 cm wide no beam lies clear of the edges, and
    its 10 turns a second leave few lines on a target.
    Expected: 9.3.2 d is refused, with the number of points; the finer scanner passes with the same targets.
    """
    small = [
        "targets.frustums.long_edge_m=0.5",
        "targets.frustums.mark_radius_m=0.1",
        'campaign.parts=["camera", "lidar"]',
        "targets.frustums.count=20",
        "flight.heights_m=[40.0, 50.0]",
    ]
    refused = plan_campaign(load_config(TINY, [*small, 'lidar={use="velodyne_vlp16"}']))
    clauses = [r.clause for r in refused.failing]
    assert "9.3.2 d" in clauses and "9.3.2 a" in clauses
    text = row(refused, "9.3.2 d", "faces")
    assert text.startswith("0 of 20 targets") and "points on a face on average" in text
    assert refused.refusal is not None and "long_edge_m" in refused.refusal
    fine = plan_campaign(load_config(TINY, [*small, "lidar.prr_hz=800000.0", "lidar.scanner.scan_rate_hz=160.0"]))
    assert [r.clause for r in fine.failing] == []
    assert row(fine, "9.3.2 d", "faces").startswith("20 of 20 targets")


@pytest.mark.parametrize("height_m", [110.0, 450.0])
def test_a_height_beyond_the_range_ambiguity_is_refused(height_m: float) -> None:
    """Rationale: an echo that comes back after the next pulse has left belongs to neither: R <= c / (2 PRR).
    Expected: refused by physics where the slant range at the sector's edge passes that, whether (110 m) or not (450 m, where
    the ground ends first) the range can be built; the height that would do is named, and one just below passes.
    Tolerance: roll, lever arm and slope lengthen the way by up to 8 %.
    """
    rate = 1_200_000.0
    limit = SPEED_OF_LIGHT_M_S / 2.0 / rate
    lidar_only = ['campaign.parts=["lidar"]', f"lidar.prr_hz={rate}"]
    plan = plan_campaign(load_config(TINY, [*lidar_only, f"flight.heights_m=[{height_m}]"]))
    assert plan.unambiguous_range_m == pytest.approx(limit)
    assert plan.longest_range_m == pytest.approx(height_m / np.cos(np.radians(35.0)), rel=0.08)
    assert "physics" in [r.clause for r in plan.failing]
    assert plan.refusal is not None and f"{limit:.1f} m" in plan.refusal
    allowed = int(re.findall(r"fly at (\d+) m or lower", plan.refusal)[0])
    assert allowed < limit
    if height_m < 200.0:
        below = plan_campaign(load_config(TINY, [*lidar_only, f"flight.heights_m=[{allowed - 1}.0]"]))
        assert "physics" not in [r.clause for r in below.failing]


@pytest.mark.parametrize("parts", ['["bench"]', '["ranging"]'])
def test_benches_or_a_ranging_line_alone_can_be_planned(parts: str) -> None:
    """Rationale: a laboratory plans its indoor tests by themselves; the heights of the configuration are not flown then.
    Expected: a plan without sorties in which nothing fails, in both languages. Tolerance: none."""
    plan = plan_campaign(load_config(TINY, [f"campaign.parts={parts}"]))
    assert plan.sorties == () and plan.refusal is None
    clause = "9.2.2 d" if "bench" in parts else "9.1.2 f"
    assert any(r.clause == clause and r.status == "pass" for r in plan.rows)
    for language in ("zh", "en"):
        console = Console(file=io.StringIO(), width=100)
        print_plan(plan, console, language)


def test_what_cannot_be_built_is_a_row_and_a_refusal() -> None:
    """Rationale: a plan that ends in an error says nothing of what else is wrong. Expected: a failing row with the clause that
    the error names, and the sun of that time beside it."""
    plan = plan_campaign(load_config(TINY, ["flight.heights_m=[8.0]"]))
    assert "6.2.3" in [r.clause for r in plan.failing]
    assert any(r.clause == "7.2 c" and r.status == "pass" for r in plan.rows)
    night = plan_campaign(load_config(TINY, ['campaign.start_time="2026-12-21T05:00:00+08:00"']))
    assert {r.clause for r in night.failing} == {"7.2 c"}
    assert night.sun_window and night.sun_window[0][0] > "09:00"


# ---------------------------------------------------------------------------------------------------------------- figures


def test_resolution_blur_and_overlap_by_hand() -> None:
    """Expected: f = 1502.1 px at 22 m: 14.6 mm a pixel; 4 m/s in 1/2000 s are 2 mm or 0.137 px; images 6 m apart on a
    footprint of 15.0 m have 60 % in common. Tolerance: the digits given."""
    config = load_config(TINY)
    gsd_m, footprint_m = camera_side.ground_resolution_m(config, 22.0)
    assert gsd_m == pytest.approx(0.014646, abs=1e-6)
    assert footprint_m == pytest.approx((22.496, 15.001), abs=1e-3)
    assert camera_side.blur_px(config, 22.0, 4.0, 0.0005) == pytest.approx(0.1365, abs=1e-4)
    assert camera_side.overlap(6.0, 15.0) == pytest.approx(0.6)


def test_a_plan_needs_no_renderer(tmp_path: Path) -> None:
    """Rationale: a plan is asked for many times, on machines that cannot render. Expected: neither mitsuba nor drjit loaded."""
    few = ["flight.heights_m=[22.0]", "flight.headings_deg=[0.0]"]
    script = (
        "import sys\n"
        "from campaign.load import load_config\n"
        "from testrange.plan import plan_campaign\n"
        f"plan_campaign(load_config({str(TINY)!r}, {few!r}))\n"
        "sys.exit(any(name in sys.modules for name in ('mitsuba', 'drjit')))\n"
    )
    assert subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=False).returncode == 0


def test_the_days_of_the_benches_are_the_simulator_s() -> None:
    """Rationale: these constants live in a module that loads the renderer, so the plan has its own. Expected: the same."""
    from simulator import simulate
    from simulator.bench import chessboard
    from testrange.plan import rehearsal

    assert rehearsal.SPHERE_BEFORE_S == simulate.SPHERE_BEFORE_S
    assert rehearsal.CHESSBOARD_BEFORE_S == simulate.CHESSBOARD_BEFORE_S
    assert rehearsal.CHESSBOARD_INTERVAL_S == chessboard.INTERVAL_S


def test_tables_fit_100_columns_and_json_holds_the_plan(tiny_plan: Plan) -> None:
    """Expected: no line wider than 100 cells, nothing cut off, clauses and figures in both languages; JSON that reads back."""
    for language, words in (("en", ("clauses", "LiDAR points")), ("zh", ("条款检核", "激光点数"))):
        stream = io.StringIO()
        print_plan(tiny_plan, Console(file=stream, width=100, highlight=False), language)  # type: ignore[arg-type]
        text = stream.getvalue()
        assert max(cell_len(line) for line in text.splitlines()) <= 100
        assert "…" not in text
        assert all(word in text for word in (*words, "7.2 c", "GSD"))
    block = json.loads(json.dumps(plan_block(tiny_plan)))
    assert block["failing"] == [r.clause for r in tiny_plan.failing]
    assert block["refusal"] == tiny_plan.refusal
    assert block["sorties"][0]["height_m"] == 22.0


def test_the_file_of_the_page_is_a_configuration(tmp_path: Path) -> None:
    """Rationale: docs/your_own_range.md shows a file to begin with. Expected: it loads, with the values that it shows."""
    page = (Path(__file__).parents[2] / "docs" / "your_own_range.md").read_text()
    (tmp_path / "my_range.toml").write_text(page.split("```toml\n")[1].split("```")[0])
    config = load_config(tmp_path / "my_range.toml")
    assert config.platform.camera.lever_arm_m == (0.12, 0.02, 0.09)
    assert config.site.slope_deg == 2.0


def test_the_same_configuration_gives_the_same_plan(tiny_plan: Plan) -> None:
    assert plan_campaign(load_config(TINY)) == tiny_plan
