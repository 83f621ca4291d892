"""Studies run: resumed, killed, retried, split, on a cluster; always the same table. Responses are cheap callables."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from campaign.errors import ConfigError, TestrangeError
from testrange import cli
from testrange.study.execution.schedule import Outcome, Task, run_all
from testrange.study.run import parse_shard, run_study

CALLABLES = Path(__file__).with_name("study_callables.py")
PROGRAM = Path(sys.executable).with_name("testrange")


@pytest.fixture(autouse=True)
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes longer than these studies."""
    monkeypatch.setattr("testrange.study.report.page._pictures", lambda *_: [])


def write(folder: Path, function: str, **more: str) -> Path:
    """A study of 3 x 2 levels and two replicates."""
    folder.mkdir(exist_ok=True)
    shutil.copy(CALLABLES, folder / CALLABLES.name)
    extra = "\n".join(f"{k} = {v}" for k, v in more.items())
    (folder / "s.toml").write_text(
        f'title = "t"\ncallable = "study_callables:{function}"\nresponses = ["y"]\nreplicates = 2\n{extra}\n'
        '[[factor]]\nname = "a"\nvalues = [1.0, 2.0, 3.0]\n[[factor]]\nname = "b"\nvalues = [0.0, 1.0]\n'
    )
    return folder / "s.toml"


def table(out: Path) -> dict[str, list[Any]]:
    """All columns but the run time."""
    return {k: v for k, v in pq.read_table(out / "table.parquet").to_pydict().items() if k != "run_time_s"}


def ran(folder: Path) -> list[str]:
    """What the callable noted, sorted."""
    return sorted((folder / "ran").read_text().splitlines())


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study run once, without anything in its way."""
    place = tmp_path_factory.mktemp("plain")
    run_study(write(place, "additive"), place / "out", workers=1)
    return place / "out"


def test_table_and_nothing_twice(plain: Path, tmp_path: Path) -> None:
    """Expected: rows in the order of the design with 3 a + b^2 within the noise; two workers give the same table; a second call
    runs nothing and leaves every file but none changed."""
    rows = table(plain)
    assert rows["a"] == [1.0] * 4 + [2.0] * 4 + [3.0] * 4 and rows["replicate"] == [0, 1] * 6
    assert all(abs(y - 3.0 * a - b**2) <= 0.5 for a, b, y in zip(rows["a"], rows["b"], rows["y"]))
    assert len(set(rows["seed"])) == 12 and set(rows["status"]) == {"done"}
    study = write(tmp_path, "additive")
    run_study(study, tmp_path / "out", workers=2)
    assert table(tmp_path / "out") == rows
    before = ran(tmp_path)
    made = {p.name: p.read_bytes() for p in (tmp_path / "out").rglob("*") if p.is_file()}
    again = run_study(study, tmp_path / "out", workers=2)
    assert again.ran == 0 and ran(tmp_path) == before and len(before) == 12
    assert {p.name: p.read_bytes() for p in (tmp_path / "out").rglob("*") if p.is_file()} == made
    assert not [name for name in made if ".part" in name]


def test_metadata_makes_the_study_again(plain: Path) -> None:
    found = pq.read_schema(plain / "table.parquet").metadata
    assert found[b"study"].decode() == (plain.parent / "s.toml").read_text()
    assert json.loads(table(plain)["versions"][0])["testrange"]


def test_a_failed_point_is_listed_and_retried_only_when_asked(tmp_path: Path) -> None:
    """Expected: four of twelve fail with one line that says what, the others are done; a second call runs none of them again;
    with retry_failed they run, and only they."""
    study = write(tmp_path, "fails_at_two")
    done = run_study(study, tmp_path / "out", workers=1)
    failed = [row for row in done.rows if row["status"] == "failed"]
    assert (done.count("done"), done.count("failed")) == (8, 4)
    assert {row["a"] for row in failed} == {2.0}
    assert all("ZeroDivisionError: a is two and that is too much (study_callables.py:" in r["reason"] for r in failed)
    assert "a is two and that is too much" in (tmp_path / "out" / "study.html").read_text()
    (tmp_path / "mended").touch()
    assert run_study(study, tmp_path / "out", workers=1).ran == 0
    mended = run_study(study, tmp_path / "out", workers=1, retry_failed=True)
    assert (mended.ran, mended.count("done")) == (4, 12)


def test_a_killed_worker_is_replaced(tmp_path: Path) -> None:
    """Rationale: kill -9, or the kernel out of memory. Expected: the two points are run once more, and the table is that of a
    quiet run after it (the marks of the first attempts remain)."""
    study = write(tmp_path, "kills_its_worker_once")
    done = run_study(study, tmp_path / "out", workers=2)
    assert len(list(tmp_path.glob("killed-*"))) == 2 and done.count("done") == 12
    assert len(ran(tmp_path)) == 14
    run_study(study, tmp_path / "quiet", workers=1)
    assert table(tmp_path / "out") == table(tmp_path / "quiet")


def test_a_point_that_always_kills_its_worker_is_listed(tmp_path: Path) -> None:
    """Expected: three attempts of each of its two replicates, then failed with the reason; ten others done."""
    done = run_study(write(tmp_path, "kills_its_worker"), tmp_path / "out", workers=2)
    assert (done.count("done"), done.count("failed")) == (10, 2)
    assert len((tmp_path / "deaths").read_text()) == 6
    assert "lost 3 times" in next(r["reason"] for r in done.rows if r["status"] == "failed")


def test_a_killed_study_resumes(tmp_path: Path) -> None:
    """Expected: kill -9 of the study in its middle leaves no worker running; the next call runs what is missing and nothing that
    was written; the table is that of a study that nobody killed."""
    quiet, killed = write(tmp_path / "quiet", "slow"), write(tmp_path / "killed", "slow")
    run_study(quiet, tmp_path / "quiet" / "out", workers=2)
    out = tmp_path / "killed" / "out"
    process = subprocess.Popen([PROGRAM, "study", killed, "--out", out, "--workers", "2", "--quiet"])
    deadline = time.monotonic() + 200.0
    while len(list(out.glob("points/*.json"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    time.sleep(0.6)  # three points' time: a worker left behind would have noted one more
    written, noted = len(list(out.glob("points/*.json"))), len(ran(tmp_path / "killed"))
    assert 3 <= written < 12
    time.sleep(0.5)
    assert len(ran(tmp_path / "killed")) == noted
    done = run_study(killed, out, workers=2)
    assert done.ran == 12 - written
    assert table(out) == table(tmp_path / "quiet" / "out")


def test_shards_then_collect(plain: Path, tmp_path: Path) -> None:
    """Expected: each shard writes its points and no table; the call without one runs nothing and makes the table of a whole run."""
    study, out = write(tmp_path, "additive"), tmp_path / "out"
    ran_by = [run_study(study, out, workers=1, shard=f"{i}/4").ran for i in (1, 2, 3, 4)]
    assert ran_by == [4, 4, 2, 2] and not (out / "table.parquet").exists()
    assert run_study(study, out, workers=1).ran == 0
    assert table(out) == table(plain)


@pytest.mark.parametrize("text", ["0/3", "4/3", "1", "1/0", "a/b", "-1/3", "1/3/5"])
def test_wrong_shards(text: str) -> None:
    with pytest.raises(ConfigError, match="is no shard"):
        parse_shard(text)


def test_what_a_callable_may_not_give(tmp_path: Path) -> None:
    """Expected: no number is a failed point; NaN and infinity are points without a value, whose reason says so."""
    done = run_study(write(tmp_path / "a", "nothing"), tmp_path / "a" / "out", workers=1)
    assert done.count("failed") == 12 and "gave no" in done.rows[0]["reason"]
    done = run_study(write(tmp_path / "b", "not_finite"), tmp_path / "b" / "out", workers=1)
    assert [row["y"] for row in done.rows] == [None] * 8 + [1.0] * 4
    assert done.rows[0]["y.reason"] == "the value is not finite: nan"


def test_a_damaged_point_is_run_again(tmp_path: Path) -> None:
    """Rationale: a folder from elsewhere may hold anything. Expected: what is not a point's file counts as not run."""
    study, out = write(tmp_path, "additive"), tmp_path / "out"
    run_study(study, out, workers=1)
    whole = table(out)
    files = sorted(out.glob("points/*.json"))
    good = [file.read_text() for file in files]
    broken = (
        "",
        "[]",
        '{"id": "x"}',
        "[" * 100_000,
        re.sub(r'"value": [^}]*', '"value": 1e999', good[4]),
        good[5].replace('"done"', "[]"),
    )
    for file, text in zip(files, broken):
        file.write_text(text)
    assert run_study(study, out, workers=1).ran == 6
    assert table(out) == whole


def test_no_such_function_ends_before_anything_runs(tmp_path: Path) -> None:
    with pytest.raises(TestrangeError, match="has no function missing"):
        run_study(write(tmp_path, "missing"), tmp_path / "out", workers=1)
    assert not (tmp_path / "out").exists()


def test_an_edited_function_is_another_response(tmp_path: Path) -> None:
    """Expected: a point is finished for the text of the module that made it; a module that cannot be read is one line."""
    study, out = write(tmp_path, "additive"), tmp_path / "out"
    first = run_study(study, out, workers=1)
    file = tmp_path / CALLABLES.name
    file.write_text(file.read_text().replace("3.0 * factors", "4.0 * factors"))
    second = run_study(study, out, workers=1)
    assert second.ran == 12
    assert [b["y"] - a["y"] for a, b in zip(first.rows, second.rows)] == pytest.approx([a["a"] for a in first.rows])
    file.write_text("1 / 0\n")
    with pytest.raises(TestrangeError, match="cannot be imported; got ZeroDivisionError"):
        run_study(study, out, workers=1)


class Serial:
    """Places of a test: `width` tasks at a time, ended in the order given; keeps what ran beside what."""

    def __init__(self, width: int) -> None:
        self.width, self.running, self.beside = width, list[Task](), list[set[str]]()

    def room(self) -> bool:
        return len(self.running) < self.width

    def give(self, task: Task) -> None:
        self.running.append(task)
        self.beside.append({t["id"] for t in self.running})

    def next(self) -> list[tuple[str, Outcome | None]]:
        task = self.running.pop(0)
        return [(task["id"], {"id": task["id"]})]


def test_the_first_of_a_group_runs_before_the_others() -> None:
    """Rationale: two workers must not render the same frame at one time. Expected: while the first of a geometry runs, no other of
    it does; its others follow at once, before a geometry that has not begun; with one geometry the second place waits."""
    tasks: list[tuple[str, Mapping[str, Any]]] = [(g, {"id": f"{g}{k}"}) for g in "ABC" for k in range(3)]
    places, order = Serial(2), list[str]()
    run_all(tasks, places, lambda outcome: order.append(outcome["id"]), lambda point: {"id": point})
    assert sorted(order) == sorted(t["id"] for _, t in tasks)
    ended: set[str] = set()
    for beside, last in zip(places.beside, [None, *order]):
        ended |= {last} if last else set()
        for group in "ABC":
            mine = {p for p in beside if p[0] == group}
            assert len(mine) < 2 or f"{group}0" not in mine
    assert order.index("A2") < order.index("C0")


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Expected: exit code 0 and the counts as JSON; a fault matrix, a missing file, a wrong number of
    workers are one line, 1."""
    study = write(tmp_path, "additive")
    assert cli.call(["study", str(study), "--out", str(tmp_path / "out"), "--workers", "1", "--json", "--quiet"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["points"] == {"done": 12, "failed": 0, "missing": 0}
    assert told["effects"][0]["main"][0]["factor"] == "a"
    for arguments, word in (
        (["study", "faults"], "testrange faults"),
        (["study", str(tmp_path / "none.toml")], "no such file"),
        (["study", str(study), "--workers", "0"], "workers"),
        (["study", str(study), "--set", "seed=3"], "has no settings"),
        (["study", "no_such_study"], "no ready-made study"),
    ):
        assert cli.call(arguments) == 1
        err = capsys.readouterr().err
        assert word in err and err.count("\n") == 1
