"""Studies in the wrong place, with points that nobody measured, twice at a time, or far too large."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from campaign.errors import ConfigError, TestrangeError
from evaluator.report.style import style
from testrange.study.design import design_rows
from testrange.study.effects import analyse
from testrange.study.execution.schedule import run_all
from testrange.study.model import parse_study
from testrange.study.plan import make_plan
from testrange.study.report import figures
from testrange.study.run import run_study
from testrange.study.table import point_rows

CALLABLES = Path(__file__).with_name("study_callables.py")


@pytest.fixture(autouse=True)
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes longer than these studies."""
    monkeypatch.setattr("testrange.study.report.page._pictures", lambda *_: [])


def write(folder: Path, function: str, values: str = "[1.0, 2.0]") -> Path:
    folder.mkdir(exist_ok=True)
    shutil.copy(CALLABLES, folder / CALLABLES.name)
    (folder / "s.toml").write_text(
        f'title = "t"\ncallable = "study_callables:{function}"\nresponses = ["y"]\n'
        f'[[factor]]\nname = "a"\nvalues = {values}\n[[factor]]\nname = "b"\nvalues = [0.0, 1.0]\n'
    )
    return folder / "s.toml"


def planned(**given: object) -> Any:
    return make_plan(parse_study({"title": "t", "callable": "m:f", "responses": ["y"], **given}, "s"), Path("s.toml"))


def rows_of(plan: Any, function: Any, grade: str | None = None) -> list[dict[str, Any]]:
    return point_rows(
        plan,
        {
            p.id: {
                "status": "done",
                "reason": None,
                "versions": {},
                "run_time_s": 0.0,
                "values": {name: {"value": function(p), "grade": grade} for name in plan.study.responses},
            }
            for p in plan.points
        },
    )


@pytest.mark.parametrize("name", ["manifest.json", "results.json", "thesis.docx"])
def test_a_folder_that_is_something_else_is_left_alone(tmp_path: Path, name: str) -> None:
    """Expected: one line; nothing is written. --drop-cache would else delete a `cache/` that is not ours."""
    out = tmp_path / "out"
    (out / "cache").mkdir(parents=True)
    (out / name).write_text("{}")
    with pytest.raises(TestrangeError, match=rf"is not empty and no study; got {name}"):
        run_study(write(tmp_path, "additive"), out, workers=1, drop_cache=True)
    assert sorted(p.name for p in out.iterdir()) == ["cache", name]


@pytest.mark.parametrize("shard", [None, (1, 2)])
def test_two_calls_at_one_time_in_one_folder(tmp_path: Path, shard: tuple[int, int] | None) -> None:
    """Rationale: each removes work folders that the other's points stand in. Expected: while another process holds the folder,
    or a shard of it, the same call and a whole study are refused in one line; another shard goes on beside a shard.
    """
    file, out = write(tmp_path, "additive"), tmp_path / "out"
    hold = (
        "import sys; from pathlib import Path; from testrange.study.execution.store import claimed\n"
        f"with claimed(Path(sys.argv[1]), {shard}): print('held', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", hold, str(out)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None and other.stdout.readline() == "held\n"
        for part in {None, "1/2"}:
            with pytest.raises(TestrangeError, match="another testrange is at work on it"):
                run_study(file, out, workers=1, shard=part)
        if shard:
            assert run_study(file, out, workers=1, shard="2/2").ran == 2
        other.communicate("")
    assert run_study(file, out, workers=1).ran == (2 if shard else 4)


@pytest.mark.parametrize(
    "wrong",
    [
        {"values": {"y": {"value": 1.0, "grade": "<b>best"}}},
        {"values": {"y": {"value": 10**400}}},
        {"run_time_s": float("nan")},
        {"run_time_s": -1.0},
    ],
)
def test_a_point_that_nobody_measured_is_run_again(tmp_path: Path, wrong: dict[str, Any]) -> None:
    """Expected: a finished point with an unknown grade or a time that is none counts as not there; the page is written."""
    file, out = write(tmp_path, "additive"), tmp_path / "out"
    assert run_study(file, out, workers=1).ran == 4
    place = next((out / "points").glob("*.json"))
    place.write_text(json.dumps(json.loads(place.read_text()) | wrong))
    assert run_study(file, out, workers=1).ran == 1


@pytest.mark.parametrize(
    "given",
    [
        {"factor": [{"name": "a", "values": [1, 2, 1.0]}]},
        {
            "design": "list",
            "factor": [{"name": "a", "values": [1, 2, 1]}, {"name": "b", "values": [3, 4, 3]}],
        },
        {"factor": [{"name": "a", "level": [{"name": "x"}, {"name": "x", "set": ["seed=1"]}]}]},
        {"factor": [{"name": "a", "level": [{"name": "x", "value": 1.0}, {"name": "y", "value": 1.0}]}]},
    ],
)
def test_what_the_table_could_not_tell_apart(given: dict[str, Any]) -> None:
    """Rationale: the same point twice counts as two measurements and narrows every interval."""
    with pytest.raises(ConfigError, match="same"):
        design_rows(parse_study({"title": "t", "callable": "m:f", "responses": ["y"], **given}, "s"))


def test_a_list_has_a_limit_too() -> None:
    study = {"title": "t", "callable": "m:f", "responses": ["y"], "design": "list", "replicates": 1000}
    with pytest.raises(ConfigError, match="too many points; got 1000000"):
        design_rows(parse_study({**study, "factor": [{"name": "a", "values": list(range(1000))}]}, "s"))


def test_rounded_samples_that_meet_run_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Expected: 32 rows of two whole levels are two points; each is run once, and every row has its value."""
    given: list[str] = []

    def noted(tasks: Any, *rest: Any) -> None:
        given.extend(t["id"] for _, t in tasks)
        run_all(tasks, *rest)

    monkeypatch.setattr("testrange.study.run.run_all", noted)
    file = write(tmp_path, "additive")
    file.write_text(
        'title = "t"\ncallable = "study_callables:additive"\nresponses = ["y"]\ndesign = "sobol"\nsamples = 8\n'
        '[[factor]]\nname = "a"\nrange = [0.6, 2.4]\nwhole = true\n[[factor]]\nname = "b"\nrange = [0.6, 1.4]\nwhole = true\n'
    )
    done = run_study(file, tmp_path / "out", workers=1)
    assert len(done.rows) == done.count("done") == 32
    assert len(given) == len(set(given)) == 2


def test_a_factor_that_does_nothing_in_a_response_without_noise() -> None:
    """Expected: p = 1 for the factor without effect, also where replicates agree to the last digit; 0 for the other.

    Tolerance: exact; what rounding leaves is below 1e-12 of the values.
    """
    factors = [{"name": "a", "values": [1.0, 2.0, 3.0]}, {"name": "b", "values": [0.1, 0.2]}]
    for replicates in (1, 2):
        plan = planned(factor=factors, replicates=replicates)
        (found,) = analyse(plan, rows_of(plan, lambda p: 1.1 * p.factors["a"]), {})
        a, b = found.main
        assert b.p_value == 1.0
        assert a.p_value < 1e-12


def test_hundreds_of_levels_are_a_figure_of_a_sheet() -> None:
    """Expected: a picture no wider than 33 inches with at most 30 names on an axis, in the place of 202 inches."""
    plan = planned(
        factor=[{"name": "a", "values": list(range(200))}, {"name": "b", "values": ["x", "y"]}],
        responses=["indicators.calibration_error"],
    )
    rows = rows_of(plan, lambda p: float(p.factors["a"]), "good")
    (found,) = analyse(plan, rows, {})
    a, b = plan.study.factor
    with style():
        for drawn in (
            figures.heat_map(rows, found, a, b),
            figures.grade_map(plan.study, rows, "calibration_error", a, b),
        ):
            assert drawn.get_size_inches()[0] <= 33.0
            assert len(drawn.axes[0].get_xticks()) <= 30
            assert not drawn.axes[0].texts


def test_morris_steps_are_not_rounded_away() -> None:
    """Rationale: with levels 1, 1.33, 1.67, 2 rounded, 3 a would be said to change by 4.5 over a range of 1. Expected: refused; on
    levels that are whole, mu* is the change over the range, 9, in closed form; ranges below zero and by ratio are taken.
    """
    design: dict[str, Any] = {"design": "morris", "samples": 8}
    for wrong in ([1.0, 2.0], [1.0, 3.0]):
        with pytest.raises(ConfigError, match="no whole numbers"):
            planned(factor=[{"name": "a", "range": wrong, "whole": True}], **design)
    plan = planned(
        factor=[
            {"name": "a", "range": [-2.0, 1.0], "whole": True},
            {"name": "b", "range": [1.0, 1000.0], "whole": True, "log": True},
        ],
        **design,
    )
    (found,) = analyse(plan, rows_of(plan, lambda p: 3.0 * p.factors["a"]), {})
    assert [i.mu_star for i in found.indices] == pytest.approx([9.0, 0.0], abs=1e-9)


def test_a_curve_runs_from_left_to_right() -> None:
    """Expected: levels written as 30, 10, 20 are drawn as 10, 20, 30, each with its own mean."""
    plan = planned(factor=[{"name": "a", "values": [30, 10, 20]}])
    rows = rows_of(plan, lambda p: 2.0 * p.factors["a"])
    (found,) = analyse(plan, rows, {})
    with style():
        drawn = figures.curves(plan.study, rows, found, plan.study.factor[0], None)
    assert drawn.axes[0].lines[0].get_xydata().tolist() == [[10.0, 20.0], [20.0, 40.0], [30.0, 60.0]]
