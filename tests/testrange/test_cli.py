"""The command line: exit codes, one line for each mistake, --help in time, atomic output. Simulation and evaluation are stubs."""

import errno
import json
import subprocess
import sys
import time
import types
from dataclasses import replace
from pathlib import Path

import pytest

from campaign.config import Config
from campaign.errors import CampaignError
from evaluator.conformity import Row
from evaluator.results import Evaluation
from evaluator.results_model import IndicatorValue
from evaluator.scores.score import Score, ScoreItem
from testrange import cli, pipeline

EVALUATION = Evaluation(
    campaign="quickstart",
    synthetic=True,
    indicators={
        "calibration_error": IndicatorValue(
            value=0.4321, unit="pixel", formula="(20)-(24)", clause="9.3", sample_size=24, low_95=0.35, high_95=0.51
        )
    },
    conformity=(
        Row(clause="7.2 c", requirement="elevation of the sun", measured="20.0°", limit="> 35°", status="fail"),
        Row(clause="7.2 d", requirement="wind", measured="3.0 m/s", limit="≤ force 5", status="pass"),
    ),
)
SCORE = Score(
    campaign="quickstart",
    items=(
        ScoreItem(
            quantity="camera_boresight_roll", unit="deg", truth=0.25, estimate=0.2531, error=0.0031, std=0.003, z=1.0333
        ),
    ),
)


@pytest.fixture
def stubs(monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """Simulator and evaluator that only write one file each; what they were given is kept."""
    seen: dict[str, object] = {}

    def simulate_campaign(config: Config, out: Path, progress, *_: object) -> None:  # type: ignore[no-untyped-def]
        assert list(out.iterdir()) == []
        seen["config"] = config
        for k in range(3):
            progress("render", k, 3)
        (out / "manifest.json").write_text("{}")

    def evaluate_campaign(root: Path, progress, **options: bool) -> Evaluation:  # type: ignore[no-untyped-def]
        if not (root / "manifest.json").is_file():
            raise CampaignError("no such file", where=str(root / "manifest.json"))
        progress("marks", 1, 1)
        return EVALUATION

    simulate, evaluate = types.ModuleType("simulate"), types.ModuleType("evaluate")
    simulate.simulate_campaign = simulate_campaign  # type: ignore[attr-defined]
    evaluate.evaluate_campaign = evaluate_campaign  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "simulator.simulate", simulate)
    monkeypatch.setitem(sys.modules, "evaluator.evaluate", evaluate)

    def score_campaign(root: Path, results: Path) -> Score:
        if not root.is_dir():
            raise CampaignError("no such folder", where=str(root))
        return SCORE

    monkeypatch.setattr(pipeline, "score_campaign", score_campaign)
    return seen


WORDS = {
    "en": ("Mean calibration error", "0.432 px", "not measured", "excellent", "fail 7.2 c", "1 fail, 1 pass", "+1.03"),
    "zh": ("平均标定误差", "0.432 px", "未测：RSD", " 优 ", "不符合 7.2 c", "1 不符合，1 符合", "+1.03"),
}


@pytest.mark.parametrize("language", ["en", "zh"])
def test_run(language: str, stubs: dict[str, object], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: the main command end to end around stubs. Expected: campaign/ and results/ with all files, settings arrive, the
    table in the language within 100 columns, the failed clause, the score, run time and memory, progress on stderr only."""
    out = tmp_path / "demo"
    settings = ["--set", "seed=7", "--set", "flight.heights_m=[30.0, 40.0]"]
    code = cli.call(["run", "quickstart", "--out", str(out), "--language", language, *settings])
    printed = capsys.readouterr()
    assert code == 0
    config = stubs["config"]
    assert isinstance(config, Config)
    assert (config.seed, config.flight.heights_m) == (7, (30.0, 40.0))
    expected = ["documents", "report.html", "results.json", "score.json", "view.html"]
    assert sorted(p.name for p in (out / "results").iterdir()) == expected
    reports = sorted(p.name for p in (out / "results" / "documents").iterdir() if p.name.startswith("test_report"))
    assert reports == [f"test_report_{language}.docx", f"test_report_{language}.pdf"]
    assert (out / "campaign" / "manifest.json").is_file()
    for word in (*WORDS[language], "run time", "peak resident"):
        assert word in printed.out
    if language == "en":
        assert "not measured: RSD: no bench/sphere_stability in this campaign" in printed.out
    wide = {"─", "│"}
    assert max(sum(2 if ord(c) > 0x2E80 and c not in wide else 1 for c in line) for line in printed.out.splitlines()
               if str(tmp_path) not in line) <= 100  # fmt: skip
    assert "render" in printed.err
    assert "render" not in printed.out


def test_run_json(stubs: dict[str, object], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: scripts take --json. Expected: stdout is one JSON document with values and grades."""
    assert cli.call(["run", "quickstart", "--out", str(tmp_path / "a"), "--json", "--quiet"]) == 0
    printed = capsys.readouterr()
    content = json.loads(printed.out)
    assert content["indicators"]["calibration_error"] == {
        "value": 0.4321,
        "unit": "pixel",
        "grade": "excellent",
        "reason": None,
    }
    assert content["not_conforming"] == [{"clause": "7.2 c", "requirement": "elevation of the sun", "status": "fail"}]
    assert content["max_abs_z"] == 1.0333
    assert content["peak_memory_mb"] > 10
    assert printed.err == ""


def test_occupied_folder(stubs: dict[str, object], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: nobody's results may be lost by a second run. Expected: exit 1 without --replace, the old folder untouched; with
    it the new one; a folder that is not ours is never deleted."""
    out = tmp_path / "demo"
    assert cli.call(["run", "quickstart", "--out", str(out), "--quiet"]) == 0
    (out / "note.txt").write_text("mine")
    assert cli.call(["run", "quickstart", "--out", str(out), "--quiet"]) == 1
    assert (out / "note.txt").is_file()
    assert cli.call(["run", "quickstart", "--out", str(out), "--quiet", "--replace"]) == 0
    assert not (out / "note.txt").exists()
    other = tmp_path / "thesis"
    other.mkdir()
    (other / "thesis.tex").write_text("mine")
    assert cli.call(["run", "quickstart", "--out", str(other), "--quiet", "--replace"]) == 1
    assert (other / "thesis.tex").is_file()
    capsys.readouterr()


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (CampaignError("broken", where="a.las"), 1, "testrange: a.las: broken\n"),
        (OSError(errno.ENOSPC, "No space left on device", "/x/a.wdp"), 1, "no space left"),
        (PermissionError(errno.EACCES, "Permission denied", "/x/a.wdp"), 1, "cannot be written"),
        (MemoryError(), 1, "testrange: not enough memory"),
        (KeyboardInterrupt(), 130, "testrange: interrupted\n"),
    ],
)
def test_failure_leaves_nothing(
    stubs: dict[str, object],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    text: str,
) -> None:
    """Rationale: an interrupted run must not look like a finished one. Expected: one line on stderr, its exit code, no folder;
    what was simulated waits beside, unless the input is at fault."""

    def fails(root: Path, progress) -> Evaluation:  # type: ignore[no-untyped-def]
        raise error

    monkeypatch.setattr(sys.modules["evaluator.evaluate"], "evaluate_campaign", fails)
    assert cli.call(["run", "quickstart", "--out", str(tmp_path / "demo"), "--quiet"]) == code
    printed = capsys.readouterr()
    assert text in printed.err
    assert printed.err.startswith("testrange: ")
    assert printed.err.count("\n") == 1
    kept = not isinstance(error, CampaignError)  # no fault of the input: the same command goes on from there
    assert [p.name for p in tmp_path.iterdir()] == ([".demo.part"] if kept else [])


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (["run"], 2),
        (["fly"], 2),
        (["run", "quickstart", "--colour"], 2),
        (["score", "a"], 2),
        (["run", "nothere.toml"], 1),
        (["run", "quickstart", "--set", "seed"], 1),
        (["run", "quickstart", "--set", "camera.pixel_size_mm=1.0"], 1),
        (["run", "quickstart", "--set", "flight.heights_m=[-5.0]"], 1),
        (["evaluate", "nothere"], 1),
        (["score", "nothere", "results.json"], 1),
        (["check", "nothere.toml"], 1),
        (["picture", "nothere", "--out", "a.png"], 1),
    ],
)
def test_mistakes(
    stubs: dict[str, object],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    line: list[str],
    code: int,
) -> None:
    """Rationale: 2 is wrong usage, 1 is wrong input. Expected: that code, one short message, nothing written."""
    monkeypatch.chdir(tmp_path)
    assert cli.call(line) == code
    printed = capsys.readouterr()
    said = (printed.err or printed.out).strip()
    assert said
    assert "Traceback" not in said
    if line[0] != "check":
        assert said.startswith("testrange: ")
        assert len(said.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_check_prints_every_problem(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: nobody wants to mend a file one message at a time. Expected: both wrong keys on lines of their own, exit 1; a
    sound configuration exits 0; --json gives a list."""
    bad = tmp_path / "bad.toml"
    bad.write_text('seed = "x"\nsped = 3\n[campaign]\nid = "bad"\n[camera]\nuse = "quickstart_6mp"\n')
    assert cli.call(["check", str(bad)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert any("sped" in line for line in lines)
    assert lines[-1].endswith("2 errors, 0 warnings")
    assert cli.call(["check", str(bad), "--json"]) == 1
    assert [p["severity"] for p in json.loads(capsys.readouterr().out)] == ["error", "error"]
    assert cli.call(["check", "quickstart"]) == 0


def test_schema(capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: editors complete from it. Expected: JSON Schema that knows a setting of the design's list."""
    assert cli.call(["schema"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert "camera_boresight_deg" in content["$defs"]["Faults"]["properties"]


def test_evaluate_default_place(stubs: dict[str, object], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: results belong beside the campaign, not in it. Expected: results/ beside it, without score.json."""
    campaign = tmp_path / "campaign"
    campaign.mkdir()
    (campaign / "manifest.json").write_text("{}")
    assert cli.call(["evaluate", str(campaign), "--quiet", "--keep-going", "--no-documents", "--language", "both"]) == 0
    written = sorted(p.name for p in (tmp_path / "results").iterdir())
    assert written == ["report.html", "report_en.html", "results.json"]
    assert "greatest |z|" not in capsys.readouterr().out


def test_evaluate_leaves_the_campaign_alone(
    stubs: dict[str, object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rationale: results in the campaign's place, or around it, would delete it with --replace; inside it they change it.
    Expected: one line, exit code 1, every file still there, for each of these places and by way of a link."""
    campaign = tmp_path / "run" / "campaign"
    campaign.mkdir(parents=True)
    (campaign / "manifest.json").write_text("{}")
    (tmp_path / "link").symlink_to(campaign)
    for out in (campaign, campaign / "results", campaign.parent, tmp_path / "link" / "results"):
        call = ["evaluate", str(campaign), "--out", str(out), "--quiet", "--keep-going", "--no-documents", "--replace"]
        assert cli.call(call) == 1
        said = capsys.readouterr()
        assert "the campaign that is evaluated" in said.out + said.err
        assert [p.name for p in campaign.iterdir()] == ["manifest.json"]


def test_score_prints_large_z(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rationale: the largest |z| is what a person looks for. Expected: it is printed with its sign in the table, and score.json is
    written beside results.json."""
    item = SCORE.items[0]
    monkeypatch.setattr(
        pipeline, "score_campaign", lambda root, results: replace(SCORE, items=(item, replace(item, z=-4.5)))
    )
    (tmp_path / "results.json").write_text("{}")
    assert cli.call(["score", str(tmp_path), str(tmp_path), "--language", "en"]) == 0
    printed = capsys.readouterr().out
    assert "-4.50" in printed
    assert "greatest |z| of 2 quantities: 4.50" in printed
    assert json.loads((tmp_path / "score.json").read_text())["max_abs_z"] == 4.5


def test_help_is_quick() -> None:
    """Rationale: DESIGN 6 asks for 0.3 s; heavy libraries must wait for the command that uses them. Expected: none of them is
    imported, and the best of three runs lasts at most 0.3 s of processor time. Tolerance: processor time, since a busy machine
    stretches the clock."""
    program = (
        "import sys, time; sys.argv = ['testrange', '--help']\n"
        "from testrange.cli import call\n"
        "code = call(['--help'])\n"
        "heavy = {'numpy', 'scipy', 'mitsuba', 'matplotlib', 'cv2', 'pydantic', 'pandas'} & set(sys.modules)\n"
        "print(code, sorted(heavy), time.process_time(), file=sys.stderr)"
    )
    spent = []
    for _ in range(3):
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        code, rest = done.stderr.split(" ", 1)
        heavy, seconds = rest.rsplit(" ", 1)
        assert (code, heavy) == ("0", "[]")
        assert "simulate" in done.stdout
        spent.append(float(seconds))
        time.sleep(0.05)
    assert min(spent) <= 0.3


def test_a_run_leaves_everything(tiny_run: Path) -> None:
    """Rationale: what a user gets from one command. Expected: pages, the six documents twice, the evaluator's own picks of every
    sortie; no file of another language."""
    results = tiny_run / "results"
    names = {str(p.relative_to(results)) for p in results.rglob("*") if p.is_file()}
    assert {"results.json", "score.json", "report.html", "view.html"} < names
    kinds = ("test_report", "flight_plan", "observation_radiometric", "observation_geometric")
    kinds += ("calculation_radiometric", "calculation_geometric")
    made = {n for n in names if n.startswith("documents/")}
    assert made == {f"documents/{kind}_zh.{suffix}" for kind in kinds for suffix in ("pdf", "docx")}
    sorties = {p.name for p in (tiny_run / "campaign" / "sorties").iterdir()}
    picks = {n for n in names if n.startswith("observations/")}
    assert picks == {f"observations/{s}/observations_{sensor}.csv" for s in sorties for sensor in ("camera", "lidar")}
