"""Families: what a member promises, what verify says of results that are right, wrong, and wrong in a known way."""

import json
import math
import os
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

from campaign.errors import CampaignError, ConfigError
from campaign.load import configs_folder, load_config
from evaluator.c10_1_grading import grade
from testrange.cli import call
from testrange.family import model
from testrange.family.design import middle
from testrange.family.edits import EDITS
from testrange.family.evaluate import evaluate_members
from testrange.family.knobs import GROUP, group_config, knob, solve
from testrange.family.make import make_family
from testrange.family.model import BOUNDS, Expected, Family, Value, accepted_grades, grade_of, load_family
from testrange.family.truth.ranging import Ranging, table
from testrange.family.truth.sphere import pattern
from testrange.family.verify import summary_lines, verify
from testrange.family.violations import VIOLATIONS

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "families.md"


def quiet(stage: str, done: int, total: int) -> None:
    """No progress."""


@pytest.fixture(scope="module")
def small() -> Family:
    return load_family("small")


# ------------------------------------------------------------------------------------------------------------------- form


def test_the_bounds_are_those_that_the_evaluator_grades_by() -> None:
    """Rationale: table 3 is written twice, so that a slip shows. Expected: the same grade on, below and above each bound."""
    for indicator, bounds in BOUNDS.items():
        for bound in bounds:
            for value in (bound, math.nextafter(bound, -math.inf), math.nextafter(bound, math.inf)):
                assert grade_of(indicator, value) == grade(indicator, value), (indicator, value)


def test_accepted_grades_near_a_boundary_are_two() -> None:
    """Rationale: a measurement may fall to either side. Expected: one grade from three tolerances on, both nearer."""
    assert accepted_grades("camera_stability", 0.96, 0.01) == ("excellent",)
    assert accepted_grades("camera_stability", 0.98, 0.01) == ("excellent", "good")
    assert accepted_grades("reflectance_correlation", 99.02, 0.01) == ("excellent", "good")
    assert accepted_grades("reflectance_correlation", 99.04, 0.01) == ("excellent",)


@pytest.mark.parametrize("name", ["small", "full"])
def test_ready_made_families_load_and_every_member_has_a_configuration(name: str) -> None:
    """Rationale: a slip in a setting would show after an hour of making. Expected: every violation's settings are accepted, and
    its edit exists."""
    family = load_family(name)
    for group in set(GROUP.values()):
        group_config(family, group)
    for violation in VIOLATIONS:
        group_config(family, violation.group, violation.set)
        assert violation.edit is None or violation.edit in EDITS
    assert len({v.name for v in VIOLATIONS}) == len(VIOLATIONS)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ('name = "x"\ntitle = "t"\nbase = "quickstart"\nindicator = []\n', "indicator"),
        ('name = "../x"\ntitle = "t"\nbase = "quickstart"\n', "name"),
        ("name = \n", "x.toml"),
    ],
)
def test_a_wrong_family_is_one_line(tmp_path: Path, text: str, word: str) -> None:
    """Expected: a ConfigError that names the key or the file, in one line."""
    path = tmp_path / "x.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as error:
        load_family(path)
    assert word in str(error.value) and "\n" not in str(error.value)


def test_another_family_in_the_folder_is_refused(tmp_path: Path, small: Family) -> None:
    """Rationale: members of two families in one folder would be scored together. Expected: refused, the other named."""
    (tmp_path / "family.json").write_text('{"family": "other"}')
    with pytest.raises(CampaignError, match="other"):
        make_family(small, tmp_path, quiet)


# -------------------------------------------------------------------------------------------------------------- references


def test_the_sphere_s_pattern_has_the_standard_deviation_of_formula_5() -> None:
    """Closed form: mean 0 and sum of squares n - 1. Tolerance: rounding."""
    wave = pattern(21)
    assert abs(wave.mean()) < 1e-12
    assert float(np.sum(wave**2)) == pytest.approx(20.0, rel=1e-12)


def test_range_errors_of_equal_steps_are_free_of_what_the_constants_absorb(small: Family) -> None:
    """Rationale: signs + - - + of eight panels at equal steps have neither sum nor slope over true ranges; but (13) multiplies the
    measured ones, whose variance is V + e^2, so R2 takes up a little. Expected: m_j = e sqrt(V / (V + e^2)), closed form.
    Tolerance: 1.5e-3: the scale fault of 0.12 % and the noise."""
    config = group_config(small, "ranging")
    line, distances = Ranging(config), np.array(config.ranging.distances_m)
    for error in (0.1, 0.4):
        rmse = error * np.sqrt(distances.var() / (distances.var() + error**2))
        expected = 100.0 * float(rmse / distances.mean())
        assert line.m_z_percent(table(config.ranging.distances_m, error)) == pytest.approx(expected, rel=1.5e-3)


@pytest.mark.parametrize(
    "indicator", ["camera_repeatability", "lidar_ranging_rmse_relative", "reflectance_correlation", "calibration_error"]
)
def test_every_grade_can_be_set(small: Family, indicator: model.Indicator) -> None:
    """Expected: the value wanted, to a tenth of a tolerance, in the middle of each grade, which alone is accepted there."""
    moves = knob(small.model_copy(update={"replicates": 30}), indicator)
    for wanted_grade in model.GRADES:
        wanted = middle(indicator, wanted_grade)
        found = solve(moves, wanted).indicators[indicator]
        assert abs(found.value - wanted) < 0.1 * found.tolerance
        assert found.grades == (wanted_grade,)


def test_reflectances_keep_to_what_can_exist(small: Family) -> None:
    """Rationale: for least squares with an intercept var(R1) = r^2 var(R), so M_f >= sqrt(n (1 - r^2) var / (2 (n - 1))) for
    panels of variance 1100; the brief's figures 3.4 % at 99 % and 7.4 % at 95 %. Tolerance: 3 %, the panels' own spread."""
    moves = knob(small.model_copy(update={"replicates": 30}), "reflectance_correlation")
    for r_f, least in ((99.0, 3.4), (95.0, 7.4), (90.0, 10.4)):
        relative = solve(moves, r_f).indicators["reflectance_rmse_relative"].value
        assert relative == pytest.approx(least, rel=0.03)


def test_a_value_that_cannot_exist_is_one_line(small: Family) -> None:
    """Expected: what can be reached stands in the error."""
    with pytest.raises(ConfigError, match=r"lidar_ranging_rmse_relative: cannot be set.*expected"):
        solve(knob(small.model_copy(update={"replicates": 30}), "lidar_ranging_rmse_relative"), 50.0)


def test_faults_of_families_are_settings(tmp_path: Path) -> None:
    """Rationale: a member's card says how to make it again with --set. Expected: lists of pairs are read as such."""
    config = load_config(
        "quickstart", ['faults.panel_laser_gain=[["P02", 0.05]]', "faults.range_table=[[4.0, 0.1], [5.0, -0.1]]"]
    )
    assert config.faults.panel_laser_gain == (("P02", 0.05),)
    assert config.faults.range_table == ((4.0, 0.1), (5.0, -0.1))


# ------------------------------------------------------------------------------------------------------------------ verify


def expect(folder: Path, expected: Expected) -> None:
    (folder / "expected").mkdir(parents=True, exist_ok=True)
    (folder / "expected" / f"{expected.member}.json").write_text(json.dumps(expected.block()))


def results(folder: Path, member: str, **content: object) -> Path:
    place = folder / member
    place.mkdir(parents=True, exist_ok=True)
    (place / "results.json").write_text(json.dumps({"campaign": member, **content}))
    return folder


def indicator_of(value: float | None, grade_: str, **companions: float) -> dict[str, object]:
    return {"value": value, "grade": grade_, "companions": companions}


RELATIVE = Value(
    value=4.0,
    tolerance=0.05,
    unit="%",
    grades=("good",),
    mistakes={"2n in the place of 2(n - 1)": 4.0 * (19 / 20) ** 0.5},
)


def test_right_results_are_right(tmp_path: Path) -> None:
    """Expected: within three tolerances and with an accepted grade and the clause found, nothing is said."""
    expect(
        tmp_path, Expected(member="a", indicators={"reflectance_rmse_relative": RELATIVE}, clauses={"7.2 c": ("fail",)})
    )
    place = results(
        tmp_path / "r",
        "a",
        indicators={"reflectance_rmse_relative": indicator_of(4.1, "good")},
        conformity=[{"clause": "7.2 c", "status": "pass"}, {"clause": "7.2 c", "status": "fail"}],
    )
    report = verify(tmp_path, [place])
    assert report.right and report.verdicts[0].compared[0].tolerances == pytest.approx(2.0)


def test_wrong_grades_values_and_clauses_are_told(tmp_path: Path) -> None:
    """Expected: each of four faults of a results file by itself: value, grade of a right value, clause missed, clause besides."""
    expect(
        tmp_path, Expected(member="a", indicators={"reflectance_rmse_relative": RELATIVE}, clauses={"7.2 c": ("fail",)})
    )
    place = results(
        tmp_path / "r",
        "a",
        indicators={"reflectance_rmse_relative": indicator_of(4.02, "fair")},
        conformity=[{"clause": "7.2 c", "status": "pass"}, {"clause": "7.2 d", "status": "fail"}],
    )
    verdict = verify(tmp_path, [place]).verdicts[0]
    assert not verdict.right
    assert verdict.clauses_missed == ("7.2 c",) and verdict.clauses_besides == ("7.2 d",)
    assert verdict.compared[0].near and not verdict.compared[0].graded
    results(tmp_path / "r", "a", indicators={"reflectance_rmse_relative": indicator_of(None, "not_measured")})
    assert verify(tmp_path, [place]).verdicts[0].missing


def test_a_slip_below_each_members_tolerance_is_found_over_all(tmp_path: Path) -> None:
    """Rationale: 2n for 2(n - 1) changes M_f by 2.5 %, 2 tolerances at 4 %. Expected: no member is wrong by its value, the slip is
    named all the same; results that scatter by half a tolerance are not accused."""
    rng = np.random.default_rng(1)
    for k, true in enumerate(np.linspace(3.5, 4.5, 12)):
        slip = {"2n in the place of 2(n - 1)": float(true) * (19 / 20) ** 0.5}
        value = Value(value=float(true), tolerance=0.05, unit="%", grades=("good",), mistakes=slip)
        expect(tmp_path, Expected(member=f"m{k}", indicators={"reflectance_rmse_relative": value}))
        for folder, factor in (("slip", (19 / 20) ** 0.5), ("fine", 1.0)):
            got = float(true) * factor + 0.025 * rng.standard_normal()
            results(tmp_path / folder, f"m{k}", indicators={"reflectance_rmse_relative": indicator_of(got, "good")})
    slipped, fine = verify(tmp_path, [tmp_path / "slip"]), verify(tmp_path, [tmp_path / "fine"])
    assert slipped.mistakes == ("reflectance_rmse_relative: 2n in the place of 2(n - 1)",) and not slipped.right
    assert fine.right and not fine.mistakes


def test_a_reversed_sign_and_one_way_time_are_named(tmp_path: Path) -> None:
    """Expected: the angle by name; R2 of -1/2, what twice the true range gives, as a factor of 2."""
    mounting = {
        "camera_boresight_roll": Value(value=0.25, tolerance=0.005, unit="deg"),
        "camera_boresight_pitch": Value(value=-0.3, tolerance=0.005, unit="deg"),
    }
    expect(
        tmp_path,
        Expected(
            member="a",
            mounting=mounting,
            constants={"multiplication_constant": Value(value=0.0, tolerance=1e-4, unit="1")},
        ),
    )
    place = results(
        tmp_path / "r",
        "a",
        indicators={"lidar_ranging_rmse_relative": indicator_of(0.1, "excellent", multiplication_constant=-0.5001)},
        mounting={"names": list(mounting), "estimates": [0.25, 0.3]},
    )
    report = verify(tmp_path, [place])
    assert "camera_boresight_pitch: sign reversed" in report.mistakes
    assert any("one-way time" in m for m in report.mistakes)
    assert not any("roll" in m for m in report.mistakes)


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[1]",
        "[" * 200_000,
        '{"campaign": 3}',
        '{"campaign": "a", "indicators": [1], "conformity": 7}',
        '{"campaign": "a", "mounting": {"names": [["x"], {}], "estimates": [1, 2]}}',
        *(
            f'{{"campaign": "a", "indicators": {{"reflectance_rmse_relative": {{"value": {value}}}}}}}'
            for value in ("NaN", "1e400", "9" * 400, "1e308", "true", "[4.0]")
        ),
    ],
)
def test_hostile_results_are_one_line_or_missing(tmp_path: Path, content: str) -> None:
    """Rationale: results come from anybody. Expected: refused in one line, or judged as without values; no traceback."""
    expect(tmp_path, Expected(member="a", indicators={"reflectance_rmse_relative": RELATIVE}))
    (tmp_path / "r" / "a").mkdir(parents=True)
    (tmp_path / "r" / "a" / "results.json").write_text(content)
    try:
        assert not verify(tmp_path, [tmp_path / "r"]).right
    except CampaignError as error:
        assert "\n" not in str(error)


def test_what_somebody_wrote_moves_no_cursor(tmp_path: Path) -> None:
    """Expected: escapes and line ends of a results file are blanks in what is printed; every number of --json is JSON's."""
    expect(tmp_path, Expected(member="a", indicators={"reflectance_rmse_relative": RELATIVE}))
    place = results(
        tmp_path / "r",
        "a",
        indicators={"reflectance_rmse_relative": indicator_of(1e308, "\x1b[2J\nb: fine")},
        conformity=[{"clause": "7.2\x1b[31m\r\n", "status": "fail"}],
    )
    results(tmp_path / "r", "b", campaign="\x1b]0;title\x07")
    report = verify(tmp_path, [place])
    assert all(line.isprintable() for line in summary_lines(report))
    assert json.loads(json.dumps(report.block(), allow_nan=False))["greatest_error_in_tolerances"] > 1e100


def test_results_of_another_family_are_not_right(tmp_path: Path) -> None:
    """Rationale: with single files only the members that they name are judged. Expected: none at all is no success; a member
    that is expected twice is refused."""
    expect(tmp_path, Expected(member="a", indicators={"reflectance_rmse_relative": RELATIVE}))
    results(tmp_path / "r", "z")
    assert not verify(tmp_path, [tmp_path / "r" / "z" / "results.json"]).right
    shutil.copy(tmp_path / "expected" / "a.json", tmp_path / "expected" / "b.json")
    with pytest.raises(CampaignError, match="twice"):
        verify(tmp_path, [tmp_path / "r"])


def test_a_member_made_again_is_evaluated_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: results of the member as it was would be judged against what is expected now."""
    ran: list[str] = []
    monkeypatch.setattr("testrange.family.evaluate.evaluate_one", lambda campaign, out: ran.append(campaign.name) or [])
    for name in ("a", "b"):
        (tmp_path / "members" / name).mkdir(parents=True)
        (tmp_path / "members" / name / "manifest.json").write_text("{}")
        results(tmp_path / "out", name)
    os.utime(tmp_path / "out" / "b" / "results.json", (1.0, 1.0))
    assert evaluate_members(tmp_path, tmp_path / "out", quiet, workers=1) == []
    assert ran == ["b"]


def test_a_base_stands_beside_its_family(tmp_path: Path) -> None:
    """Expected: a path is meant from the family's file, as in a study; the card names the file, not this machine's folders."""
    (tmp_path / "mine.toml").write_text('name = "m"\ntitle = "m"\nbase = "b.toml"\n')
    shutil.copy(configs_folder() / "campaigns" / "quickstart.toml", tmp_path / "b.toml")
    family = load_family(tmp_path / "mine.toml")
    assert group_config(family, "sphere")
    assert Path(family.base) == tmp_path / "b.toml"


# ---------------------------------------------------------------------------------------------------------------- the page


def test_the_page_s_own_family_is_made_and_right(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: the tutorial is run as printed. Expected: three members, all right; made again, nothing is done; a member with a
    file changed is made anew; no truth in a member; links keep one file's bytes once."""
    page = PAGE.read_text(encoding="utf-8")
    text = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)[0]
    tomllib.loads(text)
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    commands = [
        line.strip() for line in page.splitlines() if line.startswith("    testrange family") and "mine" in line
    ]
    assert len(commands) == 3
    for command in commands:
        words = command.replace("/tmp/", f"{tmp_path}/").replace(" mine.toml", f" {tmp_path}/mine.toml").split()[1:]
        assert call([*words, "--quiet"] if "verify" not in words else words) == 0, command
    assert "3 of 3 members right" in capsys.readouterr().out
    made = make_family(load_family(tmp_path / "mine.toml"), tmp_path / "mine", quiet)
    assert made.made == 0
    members = sorted((tmp_path / "mine" / "members").iterdir())
    assert [m.name for m in members] == [
        "camera_repeatability.fair",
        "camera_repeatability.good",
        "violated.sphere_class",
    ]
    assert not any((m / "truth").exists() for m in members)
    assert "CC BY 4.0" in (tmp_path / "mine" / "cards" / "camera_repeatability.good.md").read_text(encoding="utf-8")
