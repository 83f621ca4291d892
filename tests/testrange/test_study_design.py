"""Study files, designs, and points: what is varied, which points share renders, what each id and seed depend on."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from campaign.errors import ConfigError
from testrange.study.design import design_rows
from testrange.study.execution.responses import check_name
from testrange.study.model import Study, load_study, parse_study
from testrange.study.plan import make_plan

READY = ("height_speed", "sun", "navigation", "targets", "divergence_prr", "layout", "ishigami")


def study(**given: object) -> Study:
    return parse_study({"title": "t", "callable": "m:f", "responses": ["y"], **given}, "study.toml")


def on_range(*factors: dict[str, object], **given: object) -> Study:
    return parse_study({"title": "t", "base": "study_range", "factor": list(factors), **given}, "study.toml")


def factor(name: str, low: float, high: float, **more: object) -> dict[str, object]:
    return {"name": name, "range": [low, high], **more}


def test_grid_and_list() -> None:
    """Expected: every combination, the last factor fastest; a list goes through all factors in step."""
    two = [{"name": "a", "values": [1, 2]}, {"name": "b", "values": ["x", "y", "z"]}]
    assert design_rows(study(factor=two)) == list(itertools.product([1, 2], ["x", "y", "z"]))
    two[1]["values"] = ["x", "y"]
    assert design_rows(study(factor=two, design="list")) == [(1, "x"), (2, "y")]
    two[1]["values"] = ["x"]
    with pytest.raises(ConfigError, match="same number of values"):
        design_rows(study(factor=two, design="list"))


def test_latin_hypercube_has_one_point_in_every_stratum() -> None:
    """Expected: of n points exactly one in each n-th of each range, by ratio where `log` says so (McKay et al. 1979)."""
    rows = design_rows(
        study(design="lhs", samples=16, factor=[factor("a", 2.0, 4.0), factor("b", 1e-3, 1e1, log=True)])
    )
    a, b = (np.array(c, dtype=float) for c in zip(*rows))
    assert sorted(np.floor((a - 2.0) / 2.0 * 16).astype(int)) == list(range(16))
    assert sorted(np.floor((np.log10(b) + 3.0) / 4.0 * 16).astype(int)) == list(range(16))


def test_whole_numbers_and_the_same_sample_each_time() -> None:
    given = study(design="sobol", samples=8, factor=[factor("n", 5, 30, whole=True), factor("x", 0.0, 1.0)])
    rows = design_rows(given)
    assert len(rows) == 8 * (2 + 2) and all(isinstance(n, int) and 5 <= n <= 30 for n, _ in rows)
    assert rows == design_rows(given)


def test_replicates_share_scene_and_geometry_but_not_noise() -> None:
    """Rationale: replicates must cost no render. Expected: two seeds, one scene_seed, one group; the same seeds when a level is
    added, so that finished points stay finished."""
    height = {
        "name": "h",
        "values": [27.0, 35.0],
        "moves": {"flight.heights_m": [0.9, 1.1], "camera.focus_distance_m": 1.0},
    }
    plan = make_plan(on_range(height, replicates=2), Path("study.toml"))
    first, second, other, _ = plan.points
    assert first.config is not None and second.config is not None and other.config is not None
    assert first.config.flight.heights_m == (24.3, 29.7) and first.config.camera.focus_distance_m == 27.0
    assert first.seed != second.seed and first.config.scene_seed == second.config.scene_seed == 7
    assert first.group == second.group != other.group
    height["values"] = [27.0, 30.0, 35.0]
    grown = make_plan(on_range(height, replicates=2), Path("study.toml"))
    assert {p.id for p in plan.points} < {p.id for p in grown.points}


@pytest.mark.parametrize(
    ("setting", "value", "shared"),
    [
        ("navigation.grade", "apx15", True),
        ("lidar.prr_hz", 150000.0, True),
        ("lidar.divergence_rad", 0.001, True),
        ("faults.lidar_boresight_deg", [0.1, 0.0, 0.0], True),
        ("faults.range_offset_m", 0.02, True),
        ("targets.survey.height_std_m", 0.02, True),
        ("faults.camera_boresight_deg", [0.1, 0.0, 0.0], False),
        ("faults.k1", 0.01, False),
        ("flight.speed_m_s", 6.0, False),
        ("campaign.start_time", "2026-09-25T12:30:00+08:00", False),
        ("targets.frustums.count", 12, False),
        ("camera.f_number", 8.0, False),
    ],
)
def test_what_shares_renders(setting: str, value: object, shared: bool) -> None:
    """Rationale: a frame depends on scene, light, the camera and its true pose, and on nothing else. Expected: the base and the
    changed configuration are of one group exactly where no frame can differ."""
    plan = make_plan(
        on_range(
            {"name": "x", "level": [{"name": "as is"}, {"name": "changed", "set": [f"{setting}={_toml(value)}"]}]}
        ),
        Path("study.toml"),
    )
    as_is, changed = plan.points
    assert (as_is.group == changed.group) is shared
    assert as_is.id != changed.id


def _toml(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value)


def test_shards_are_a_partition_that_splits_no_group() -> None:
    plan = make_plan(
        study(factor=[{"name": "a", "values": list(range(7))}], replicates=3, responses=["y"]), Path("study.toml")
    )
    parts = [plan.shard(i, 3) for i in (1, 2, 3)]
    assert sorted(p.id for part in parts for p in part) == sorted(p.id for p in plan.points)
    groups = [{p.group for p in part} for part in parts]
    assert not any(a & b for a, b in itertools.combinations(groups, 2))
    assert [len(g) for g in groups] == [3, 2, 2]


def test_a_level_that_cannot_be_is_a_failed_point_and_not_the_end() -> None:
    plan = make_plan(on_range({"name": "v", "key": "flight.speed_m_s", "values": [4.0, 400.0]}), Path("study.toml"))
    good, bad = plan.points
    assert good.reason is None and bad.reason is not None and "flight.speed_m_s" in bad.reason
    with pytest.raises(ConfigError, match="no point has a configuration"):
        make_plan(on_range({"name": "v", "key": "flight.speed_m_s", "values": [400.0]}), Path("study.toml"))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"design": "random"}, "design"),
        ({"replicate": 2}, "replicate is not a setting"),
        ({"replicates": 0}, "replicates"),
        ({"factor": []}, "factor"),
        ({"factor": [{"name": "a"}]}, "values, range"),
        ({"factor": [{"name": "a b", "values": [1]}]}, "name"),
        ({"factor": [{"name": "seed", "values": [1]}]}, "column"),
        ({"factor": [factor("a", 2.0, 1.0)]}, "least before greatest"),
        ({"factor": [factor("a", 0.0, 1.0, log=True)]}, "above 0"),
        ({"factor": [factor("a", 0.0, 1.0)]}, "not a range"),
        ({"factor": [{"name": "a", "values": [1]}] * 2}, "same name"),
        ({"design": "lhs", "factor": [factor("a", 0.0, 1.0)]}, "samples"),
        ({"design": "sobol", "samples": 12, "factor": [factor("a", 0.0, 1.0)]}, "power of two"),
        ({"callable": "os.system('x')"}, "callable"),
        ({"base": "quickstart"}, "base, or callable"),
        ({"responses": ["y", "y"]}, "twice"),
        ({"responses": ["a"]}, "as a factor"),
        ({"responses": ["status"]}, "another column"),
        ({"fault": []}, "fault"),
    ],
)
def test_a_wrong_study_is_one_line(change: dict[str, object], word: str) -> None:
    data = {"title": "t", "callable": "m:f", "responses": ["y"], "factor": [{"name": "a", "values": [1]}], **change}
    with pytest.raises(ConfigError) as told:
        parse_study(data, "study.toml")
    assert word in str(told.value) and "\n" not in str(told.value)


def test_responses_are_checked_before_anything_is_flown() -> None:
    for name in (
        "indicators.calibration_error",
        "score.camera_from_lidar_pitch.z",
        "panel_points.least",
        "results.a.b",
    ):
        check_name(name)
    for name in ("indicators.speed", "score.pitch", "panel_points", "results", "calibration_error", "__class__"):
        with pytest.raises(ConfigError, match="is no response"):
            check_name(name)


@pytest.mark.parametrize("name", READY)
def test_every_ready_study_has_configurations(name: str) -> None:
    """Expected: no point whose configuration is refused, and responses that exist; whether it can be flown, a run tells."""
    found, file = load_study(name)
    plan = make_plan(found, file)
    assert not [p.reason for p in plan.points if p.reason]
    for response in found.responses if found.base else ():
        check_name(response)
    assert len({p.id for p in plan.points}) == len(plan.points)
