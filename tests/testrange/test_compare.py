"""Algorithms compared: statistics in closed form, the command line's texts, one comparison with everything that can fail."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from campaign.errors import ConfigError
from evaluator.other_methods import BUILT_IN
from testrange.cli import call
from testrange.compare import Comparison, Contender, parse_contenders
from testrange.compare.model import Outcome
from testrange.compare.statistics import BOOTSTRAP, NONE, T, differences, paired_interval, same_for_all, summaries
from testrange.compare.table import print_comparison
from testrange.compare.write import comparison_block, number, render_page
from testrange.tables import _table, console


def test_the_t_interval_is_students() -> None:
    """Rationale: a wrong factor would call noise a difference. Expected: Student's own example (1908, hours of sleep gained
    by two drugs, ten patients): mean 1.58 h, 95 % interval 0.70 to 2.46 h, as tables give it. Tolerance: half of the last
    digit."""
    first = np.array([0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0])
    second = np.array([1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4])
    found, method = paired_interval([np.array([d]) for d in second - first])
    assert method == T and found.verdict == 1
    assert (found.mean, found.low, found.high) == pytest.approx((1.58, 0.70, 2.46), abs=0.005)


def test_intervals_hold_what_they_promise() -> None:
    """Rationale: 95 % of such intervals hold the true difference. Expected: of 400 draws of six campaigns 95 %, and of 200
    draws of one campaign with 60 items, by the bootstrap, nearly as many. Tolerance: four binomial standard deviations (4.4
    and 6.2 %); the percentile interval at 60 items is known to fall short by about 1 %."""
    rng = np.random.default_rng(7)
    over = [paired_interval([rng.normal(0.3, 1.0, 1) for _ in range(6)])[0] for _ in range(400)]
    assert abs(np.mean([f.low <= 0.3 <= f.high for f in over]) - 0.95) < 0.044
    within = [paired_interval([rng.exponential(1.0, 60) - 0.7], k) for k in range(200)]
    assert {method for _, method in within} == {BOOTSTRAP}
    assert abs(np.mean([f.low <= 0.3 <= f.high for f, _ in within]) - 0.94) < 0.062


def outcome(campaign: str, contender: str, **errors: dict[str, float]) -> Outcome:
    return Outcome(campaign=campaign, contender=contender, seconds=1.0, errors=errors, units=dict.fromkeys(errors, "m"))


def test_only_what_both_estimated_is_paired() -> None:
    """Rationale: an algorithm that leaves out the hard items must not win by it. Expected: the one common item of each
    campaign counts, differences of |error| and of squares by hand, means over campaigns; summaries count all items."""
    outcomes = [
        outcome("c1", "a", x={"p": 1.0, "q": 100.0}),
        outcome("c1", "b", x={"p": -3.0}),
        outcome("c2", "a", x={"p": -2.0}),
        outcome("c2", "b", x={"p": 3.0, "r": 50.0}),
    ]
    (found,) = differences(outcomes, ["a", "b"])
    assert (found.campaigns, found.items, found.method) == (2, 2, T)
    assert found.absolute.mean == pytest.approx(((1 - 3) + (2 - 3)) / 2)
    assert found.squared.mean == pytest.approx(((1 - 9) + (4 - 9)) / 2)
    half = stats.t.ppf(0.975, 1) * np.std([-2.0, -1.0], ddof=1) / np.sqrt(2.0)
    assert found.absolute.high == pytest.approx(-1.5 + half)
    assert found.rms == pytest.approx((np.sqrt(2.5), 3.0))
    assert [(s.contender, s.items) for s in summaries(outcomes, ["a", "b"])] == [("a", 3), ("b", 3)]


def test_one_campaign_and_one_value_have_no_interval() -> None:
    """Rationale: one pair of numbers says nothing of their spread. Expected: a difference, no bounds, no verdict, and the
    reason."""
    (found,) = differences([outcome("c", "a", x={"": 1.0}), outcome("c", "b", x={"": 2.0})], ["a", "b"])
    assert (found.absolute.low, found.absolute.verdict, found.method) == (None, 0, NONE)


def test_what_no_algorithm_touches_is_left_out() -> None:
    """Rationale: thirty bench figures alike hide the four that differ. Expected: alike in all runs that have results; a run
    without results does not count, a missing quantity does."""
    outcomes = [
        outcome("c", "a", lens={"": 1.0}, vertex={"p": 1.0}, mark={"p": 1.0}),
        outcome("c", "b", lens={"": 1.0}, vertex={"p": 2.0}),
        Outcome(campaign="c", contender="d", reason="failed"),
    ]
    assert same_for_all(outcomes) == {"lens"}


@pytest.mark.parametrize(
    ("texts", "what"),
    [
        (["nonsense"], "is no algorithm.*ready-made: default"),
        (["vertex-ortogonal"], "did you mean vertex-orthogonal"),
        (["default"], "algorithms to compare; got 1; expected 2 to 12"),
        ([], "algorithms to compare; got 0"),
        (["a:vertex_estimation=m:f", "a:vertex_estimation=m:g"], "two algorithms have one name"),
        (["a:vertex=m:f"], "vertex: is no algorithm's slot"),
        (["vertex_estimation=m:f"], "put a name of your own in front: mine:vertex_estimation=m:f"),
        (["default:vertex_estimation=m:f"], "is the name of a ready-made algorithm"),
        (["a:program:/no/such/file"], "no such program"),
    ],
)
def test_texts_of_the_command_line_are_checked(texts: list[str], what: str) -> None:
    """Rationale: an hour later is too late. Expected: one line before anything runs."""
    with pytest.raises(ConfigError, match=what):
        parse_contenders(texts)


def test_texts_of_the_command_line_are_understood() -> None:
    """Rationale: the forms of the help. Expected: one alone meets the default; several slots of one contender; ready-made
    ones."""
    default, mine = parse_contenders(["mine:vertex_estimation=a.b:f,reflectance_model=c:g"])
    assert default == Contender(name="default") and default.told == "the evaluator's own"
    assert mine.slots == {"vertex_estimation": "a.b:f", "reflectance_model": "c:g"}
    assert [c.slots for c in parse_contenders(list(BUILT_IN))] == list(BUILT_IN.values())


def hostile() -> Comparison:
    """A comparison whose every text is an attempt."""
    script = "<script>alert(1)</script>"
    outcomes = (
        outcome(script, "a", vertex_up={f"v{k}": 0.01 * k for k in range(8)}),
        Outcome(campaign=script, contender="b", reason=f"raised {script}", failures=(f"slot {script}",)),
    )
    contenders = (Contender(name="a"), Contender(name="b", slots={"vertex_estimation": script}))
    return Comparison(contenders=contenders, campaigns=(script,), outcomes=outcomes, differences=())


def test_the_page_runs_nothing_and_is_the_same_again() -> None:
    """Rationale: what an algorithm or a campaign says ends in a page. Expected: escaped, no script, no request; the same
    bytes twice, and comparison.json without a run time."""
    page = render_page(hostile())
    assert "<script" not in page and page.count("&lt;script&gt;") >= 5
    assert "http:" not in page.replace("http://www.w3.org", "") and 'src="data:' in page
    assert page == render_page(hostile())
    block = comparison_block(hostile())
    assert "seconds" not in json.dumps(block) and block["runs"][1]["status"] == "failed"


def test_a_comparison_in_which_everything_failed_has_a_page() -> None:
    """Expected: the reasons, and no figure that has nothing to scale; also where one value leaves no interval."""
    failed = tuple(Outcome(campaign="c", contender=name, reason=f"{name} hung") for name in "ab")
    alone = (outcome("c", "a", x={"": 1.0}), outcome("c", "b", x={"": 2.0}))
    for outcomes, word in ((failed, "b hung"), (alone, "told apart")):
        found = Comparison(
            contenders=(Contender(name="a"), Contender(name="b")),
            campaigns=("c",),
            outcomes=outcomes,
            differences=tuple(differences(outcomes, ["a", "b"])),
        )
        assert word in render_page(found)


def test_what_a_campaign_is_called_is_no_markup(capsys: pytest.CaptureFixture[str]) -> None:
    """Expected: a manifest's id with brackets is printed as it stands."""
    odd = Comparison(
        contenders=(Contender(name="a"), Contender(name="b")),
        campaigns=("[/red]",),
        outcomes=(outcome("[/red]", "a", x={"": 1.0}), outcome("[/red]", "b", x={"": 2.0})),
        differences=(),
    )
    print_comparison(odd, console())
    print_with_title("GB/T 41450-2022 · [/red]")
    assert capsys.readouterr().out.count("[/red]") == 2


def print_with_title(title: str) -> None:
    console().print(_table(title, [("a", "left"), ("a column as wide as the title", "left")]))


def test_a_comparison_does_not_replace_its_campaign(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: --replace deletes what looks like a campaign. Expected: refused in one line, the folder as it was."""
    campaign = tmp_path / "run" / "campaign"
    campaign.mkdir(parents=True)
    (campaign / "manifest.json").write_text("{}")
    for out in (tmp_path / "run", campaign, campaign / "compared"):
        words = ["compare", str(tmp_path / "run"), "--algorithm", "vertex-orthogonal", "--out", str(out), "--replace"]
        assert call(words) == 1
        assert "the campaign that is evaluated" in capsys.readouterr().err
    assert [p.name for p in campaign.iterdir()] == ["manifest.json"]


@pytest.mark.parametrize(("value", "text"), [(None, "–"), (0.0, "0"), (0.012345, "0.0123"), (1234567.0, "1.23e+06")])
def test_numbers_are_short(value: float | None, text: str) -> None:
    """Rationale: a table of 17 digits is unreadable. Expected: three significant digits."""
    assert number(value) == text


BAD = """
import os
import numpy as np
from evaluator.algorithms.own import polynomial_surface


def two_percent_more(task):
    return polynomial_surface(task) + 2.0


def raises(task):
    raise ValueError("no idea")


def nan(task):
    return np.full(len(task.at_range_m), np.nan)


def shape(task):
    return np.zeros(3)


def hangs(task):
    while True:
        pass
"""


def test_whatever_one_does_the_rest_goes_on(
    tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rationale: a comparison runs for hours. Expected: of algorithms that raise, return NaN, hang or return the wrong
    shape, and of programs that fail, hang and answer with NaN, each is reported by name with its reason; the default, the
    model that adds two percent, and a program that answers have their errors, exactly two percent apart in every panel's
    mean; exit code 0. Tolerance: 1e-6 % of rounding in results."""
    root = tmp_path / "campaign"
    leave_out = shutil.ignore_patterns("bench", "ranging", "images", "strip_0[2-9].*", "02")
    shutil.copytree(tiny_run / "campaign", root, ignore=leave_out)
    (tmp_path / "models.py").write_text(BAD)
    answers = {
        "answers": """echo '{"mounting": {"names": ["lidar_boresight_yaw"], "units": ["deg"],
                      "estimates": [-0.2], "std": [0.1]}}' > "$2" """,
        "fails": "echo broken >&2; exit 1",
        "sleeps": "sleep 60",
        "nan": 'echo \'{"indicators": {"calibration_error": {"value": NaN}}}\' > "$2"',
    }
    for name, script in answers.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.chdir(tmp_path)
    models = [
        f"m-{name}:reflectance_model=models:{name}" for name in ("two_percent_more", "raises", "nan", "shape", "hangs")
    ]
    programs = [f"p-{name}:program:./{name}" for name in answers]
    asked = [part for text in ("default", *models, *programs) for part in ("--algorithm", text)]
    assert call(["compare", str(root), *asked, "--time-limit", "2", "--out", "out", "--quiet"]) == 0
    told = json.loads((tmp_path / "out" / "comparison.json").read_text())
    runs = {r["algorithm"]: r for r in told["runs"]}
    name = "reflectance_model models:"
    assert runs["m-raises"]["failures"][0].startswith(f"{name}raises: raised ValueError: no idea (")
    assert "values that are not finite" in runs["m-nan"]["failures"][0]
    assert "has the shape (3,), expected" in runs["m-shape"]["failures"][0]
    assert f"{name}hangs: a call took longer than 2 s and was stopped" in runs["m-hangs"]["failures"][0]
    reasons = {n: runs[f"p-{n}"]["reason"] for n in answers}
    assert reasons["answers"] is None and reasons["fails"] == "fails: ended with code 1; got broken"
    assert "took longer than 2 s" in reasons["sleeps"] and "NaN is no number" in reasons["nan"]
    shown = capsys.readouterr().out
    assert "p-sleeps" in shown and "broken" in shown and "comparison.html" in shown

    means = {r["contender"]: r["mean"] for r in told["errors"] if r["quantity"] == "panel_reflectance"}
    assert means.keys() == {"default", "m-two_percent_more"}
    assert means["m-two_percent_more"] - means["default"] == pytest.approx(2.0, abs=1e-6)
    (yaw,) = [r for r in told["errors"] if r["quantity"] == "lidar_boresight_yaw"]
    assert yaw["contender"] == "p-answers" and yaw["mean"] == pytest.approx(0.1, abs=1e-9)  # of -0.30 in tiny.toml
    (pair,) = [
        d for d in told["differences"] if d["second"] == "m-two_percent_more" and d["quantity"] == "panel_reflectance"
    ]
    assert pair["items"] == 20 and pair["absolute_error"]["high_95"] < 0.0
    times = json.loads((tmp_path / "out" / "run_times.json").read_text())["runs"]
    assert times[0]["seconds"] > 0.0 and times[0]["seconds_in_slots"]["reflectance_model"] > 0.0


def test_a_name_that_cannot_be_imported_stops_before_anything_runs(
    tmp_path: Path, tiny_run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rationale: a mistyped module is the commonest mistake. Expected: exit code 1, one line with the contender's name, no
    output."""
    monkeypatch.chdir(tmp_path)
    asked = ["--algorithm", "mine:vertex_estimation=verteks:find", "--out", "out", "--quiet"]
    assert call(["compare", str(tiny_run), *asked]) == 1
    assert "mine: vertex_estimation verteks:find: no module verteks" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
