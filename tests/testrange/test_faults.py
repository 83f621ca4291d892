"""The fault matrix' own logic: what a study says, which parts are simulated anew, what a verdict is."""

import json
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import pytest
from matplotlib.colors import to_rgb

from campaign.config import PARTS, Config
from campaign.errors import CampaignError, ConfigError
from campaign.load import load_config
from evaluator.mounting.diagnosis import family_limit
from testrange import pipeline
from testrange.faults import cases
from testrange.faults.matrix import CaseResult, FaultMatrix, matrix_block
from testrange.faults.picture import draw_matrix
from testrange.faults.study import FaultCase, FaultStudy, load_study

TINY = Path(__file__).parents[1] / "data" / "tiny.toml"
NOTHING = [f"faults.{s}_{k}=[0.0, 0.0, 0.0]" for s in ("camera", "lidar") for k in ("boresight_deg", "lever_arm_m")]


def case(shows: tuple[str, ...] = (), doubts: tuple[str, ...] = ()) -> FaultCase:
    return FaultCase(name="a fault", shows=shows, doubts=doubts)


def result(of: FaultCase, z: dict[str, float], doubts: tuple[str, ...] = ()) -> CaseResult:
    rows = tuple({"quantity": q, "z": v} for q, v in z.items())
    return CaseResult(case=of, rows=rows, doubts=doubts, pairs=(), problems=())


def test_verdict() -> None:
    """Expected: only the injected quantity, on either side of zero, and only the doubted target, is "as injected"; what is missed
    and what shows besides is named."""
    assert result(case(("a",)), {"a": -9.0, "b": 3.9}).verdict(4.0) == "as injected"
    assert result(case(), {"a": 3.9, "b": -3.9}).verdict(4.0) == "as injected"
    assert result(case(("a",)), {"a": 3.9, "b": 5.0}).verdict(4.0) == "missed: a; besides: b"
    assert result(case((), ("F07",)), {"a": 0.0}, ("F07",)).verdict(4.0) == "as injected"
    assert result(case((), ("F07",)), {"a": 0.0}, ("F08",)).verdict(4.0) == "missed: F07; besides: F08"
    assert replace(result(case(), {"a": 0.0}), stated=("k1",)).verdict(4.0) == "besides: k1 as stated"


def test_limit_is_for_the_family() -> None:
    """Expected: Phi^-1(1 - 0.005/m): 2.576 for one value, 3.891 for a hundred (tables of the normal distribution)."""
    assert family_limit(1) == pytest.approx(2.5758, abs=1e-4)
    assert family_limit(100) == pytest.approx(3.8906, abs=1e-4)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ('base = "quickstart"\n[[fault]]\nname = "x"\nset = ["seed=2"]\n', "seed=2"),
        ('base = "quickstart"\n[[fault]]\nname = "x"\nshow = []\n', "show"),
        ('base = "quickstart"\n', "fault"),
        ("base = 3\n", "base"),
        ('base = "quickstart"\n[[fault]]\nname = "x"\n[[fault]]\nname = "x"\n', "one name"),
    ],
)
def test_a_wrong_study_is_one_line(tmp_path: Path, text: str, word: str) -> None:
    path = tmp_path / "study.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as told:
        load_study(path)
    assert word in str(told.value) and "\n" not in str(told.value)


def test_the_ready_made_study_loads_and_every_case_has_a_configuration() -> None:
    study = load_study("faults")
    assert study.fault[0].name == "none"
    assert len({c.name for c in study.fault}) == len(study.fault)
    for each in study.fault:
        assert load_config(study.base, (*study.set, *each.set)).faults != (
            load_config(study.base, study.set).faults if each.set else None
        )


def test_only_what_a_fault_reaches_is_simulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: two dozen campaigns would take hours; equal faults of a part give equal bytes.

    Expected: a boresight of the camera simulates its images alone, a range error the LiDAR and the ranging line, a survey error
    nothing but the paperwork; every assembled folder holds all four parts, those that the fault cannot reach from the base.
    """
    asked: list[frozenset[str]] = []
    files = {
        "camera": "sorties/01/images/a.tif",
        "lidar": "sorties/01/lidar/a.las",
        "bench": "bench/chessboard/a.tif",
        "ranging": "ranging/line.json",
    }

    def simulate(config: Config, place: Path, only: frozenset[str]) -> None:
        asked.append(only)
        for part in only:
            path = place / files[part]
            path.parent.mkdir(parents=True)
            path.write_text(repr(config.faults))
        if not only:
            (place / "manifest.json").write_text("{}")
            (place / "truth").mkdir()

    monkeypatch.setattr("simulator.simulate.simulate_campaign", simulate)
    monkeypatch.setattr(cases, "read_manifest", lambda root: root)
    monkeypatch.setattr(cases, "write_manifest", lambda root, manifest: None)
    base = load_config(TINY, NOTHING)
    parts = tmp_path / "parts"
    parts.mkdir()
    for part in PARTS:
        cases.make_part(base, part, parts, tmp_path / "work")
        cases.make_part(base, part, parts, tmp_path / "work")  # it is there: nothing happens
    assert asked == [frozenset({part}) for part in PARTS]
    for k, (settings, reached) in enumerate(
        [
            ((), set()),
            (("faults.camera_boresight_deg=[0.1, 0.0, 0.0]",), {"camera"}),
            (("faults.range_scale=1e-4",), {"lidar", "ranging"}),
            (("faults.lidar_gain=0.75",), {"lidar", "ranging"}),
            (("faults.k1=0.001",), {"camera", "bench"}),
            (('faults.survey_target="F01"', "faults.survey_error_m=[0.1, 0.0, 0.0]"), set()),
        ]
    ):
        asked.clear()
        config = load_config(TINY, [*NOTHING, *settings])
        campaign = cases.assemble(config, base, parts, tmp_path / f"case{k}")
        assert set().union(*asked) == reached
        assert not (campaign / "truth").exists()
        for part in PARTS:
            assert (campaign / files[part]).read_text() == repr((config if part in reached else base).faults)


def results_of(z: dict[str, float], doubts: tuple[str, ...] = ()) -> dict[str, object]:
    return {
        "diagnosis": {
            "rows": [{"quantity": q, "z": v} for q, v in z.items()],
            "surveyed_places_in_doubt": list(doubts),
            "stated_in_doubt": [],
        },
        "mounting": {"names": ["a", "b"], "correlation": [[1.0, 0.97], [0.97, 1.0]]},
        "problems": [],
    }


class Here:
    """Runs tasks in this process, in the place of worker processes: a part is a folder, a case's results are made up."""

    ran: ClassVar[list[str]] = []
    stop_after: ClassVar[int | None] = None
    broken: ClassVar[str | None] = None

    def __init__(self, count: int, run: str) -> None:
        self.ended: list[tuple[str, dict | None]] = []

    def __enter__(self) -> "Here":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def room(self) -> bool:
        return not self.ended

    def give(self, task: dict) -> None:
        if len(Here.ran) == Here.stop_after:
            raise KeyboardInterrupt
        Here.ran.append(task["id"])
        outcome = {"id": task["id"], "status": "done", "reason": None}
        if task["id"] == Here.broken:
            outcome |= {"status": "failed", "reason": "no such light"}
        elif task.get("part"):
            (Path(task["parts"]) / task["part"]).mkdir(exist_ok=True)
        else:
            Path(task["out"]).mkdir(parents=True)
            z = {"a": 9.0 if task["id"] == "01" else 1.0, "b": -0.5}
            (Path(task["out"]) / "results.json").write_text(json.dumps(results_of(z)))
        self.ended.append((task["id"], outcome))

    def next(self) -> list[tuple[str, dict | None]]:
        ended, self.ended = self.ended, []
        return ended


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FaultStudy:
    Here.ran, Here.stop_after, Here.broken = [], None, None
    monkeypatch.setattr("testrange.faults.matrix.Pool", Here)
    file = tmp_path / "study.toml"
    nothing = json.dumps(NOTHING)
    file.write_text(
        f'base = "{TINY}"\nset = {nothing}\n[[fault]]\nname = "none"\n'
        '[[fault]]\nname = "roll"\nset = ["faults.camera_boresight_deg=[0.1, 0.0, 0.0]"]\nshows = ["a"]\n'
        '[[fault]]\nname = "clock"\nset = ["faults.camera_clock_s=0.005"]\nshows = ["b"]\n'
    )
    return load_study(file)


def test_matrix_from_study_to_files(study: FaultStudy, tmp_path: Path) -> None:
    """Expected: the base's parts first, then every case; six values share the limit 3.14; the control and the roll are right, the
    clock is missed; matrix.json says so, the drawing is there, nothing is left beside the folder."""
    out = tmp_path / "out"
    matrix = pipeline.faults(study, out, lambda *_: None)
    assert Here.ran == [*(f"base-{p}" for p in PARTS), "00", "01", "02"]
    assert matrix.limit == pytest.approx(family_limit(6))
    assert [r.verdict(matrix.limit) for r in matrix.results] == ["as injected", "as injected", "missed: b"]
    block = json.loads((out / "matrix.json").read_text())
    assert block["as_injected"] == 2 and block["values"] == 6
    assert block["inseparable"] == [["b", "a", 0.97]]
    assert {p.name for p in out.iterdir()} == {"00", "01", "02", "matrix.json", "matrix.png", "matrix.svg"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "study.toml"]


def test_a_stopped_matrix_goes_on(study: FaultStudy, tmp_path: Path) -> None:
    """Expected: after an interrupt in the third case the first two are not run again; with another setting all are."""
    out = tmp_path / "out"
    Here.stop_after = 6
    with pytest.raises(KeyboardInterrupt):
        pipeline.faults(study, out, lambda *_: None)
    assert not out.exists() and Here.ran[-1] == "01"
    Here.stop_after = None
    Here.ran.clear()
    pipeline.faults(study, out, lambda *_: None)
    assert Here.ran == [*(f"base-{p}" for p in PARTS), "02"]  # a part that is there takes no time
    Here.ran.clear()
    pipeline.faults(study, out, lambda *_: None, ["seed=5"], replace=True)
    assert Here.ran[-3:] == ["00", "01", "02"]


def test_a_case_that_fails_is_named(study: FaultStudy, tmp_path: Path) -> None:
    """Expected: its row says why and is not "as injected", the others stand; what all cases share must not fail."""
    Here.broken = "01"
    matrix = pipeline.faults(study, tmp_path / "out", lambda *_: None)
    assert matrix.results[1].verdict(matrix.limit) == "failed: no such light"
    assert matrix.right == 1 and matrix_block(matrix)["cases"][1]["z"] == {}
    Here.broken = "base-lidar"
    with pytest.raises(CampaignError, match="no such light"):
        pipeline.faults(study, tmp_path / "other", lambda *_: None)
    assert not (tmp_path / "other").exists()


def test_a_task_that_cannot_run_is_one_line(tmp_path: Path) -> None:
    """Expected: an outcome with a reason, never an exception: the worker goes on."""
    task = {"id": "00", "config": {"seed": "x"}, "base": {}, "parts": "", "work": str(tmp_path), "out": str(tmp_path)}
    outcome = cases.run_task(task)
    assert outcome["status"] == "failed" and "\n" not in outcome["reason"]


def test_drawing_frames_what_must_show_and_what_shows_besides() -> None:
    """Expected: a green frame at the injected quantity and target, a red one at what deviates besides, its z as a number."""
    limit = family_limit(4)
    rows = (
        result(case(("a",)), {"a": 9.0, "b": 6.0}),
        result(case((), ("F07",)), {"a": 0.1, "b": 0.2}, ("F07",)),
    )
    axes = draw_matrix(FaultMatrix(results=rows, limit=limit)).axes[0]
    frames = [(p.get_x() + 0.5, p.get_y() + 0.5, p.get_edgecolor()[:3]) for p in axes.patches]
    green, red = to_rgb("#1a7f4b"), to_rgb("#b3261e")
    assert frames == [(0.0, 0.0, green), (1.0, 0.0, red), (2.0, 1.0, green)]
    assert [t.get_text() for t in axes.texts] == ["9", "6", "×"]
