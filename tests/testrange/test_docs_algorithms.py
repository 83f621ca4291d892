"""docs/your_own_algorithm.md does what it says: its files are written, its commands are run, its tables are the code's own."""

import ast
import json
import re
import shlex
import shutil
from pathlib import Path

import pytest

import evaluator.algorithms.slots as slots
from evaluator.algorithms.record import SLOTS
from evaluator.other_methods import BUILT_IN
from testrange.cli import call

PAGE = Path(__file__).resolve().parents[2] / "docs" / "your_own_algorithm.md"
TEXT = PAGE.read_text(encoding="utf-8")


def test_the_tutorial_runs(tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: a newcomer copies the blocks. Expected: in an empty folder, with a small campaign in the demo's place,
    every file is written as shown and every command ends with 0; the tutorial's vertex is worse in height than ours, as the
    text says, in all strips together; results.json names the function; the program's answer shown is accepted."""
    demo = tmp_path / "out" / "demo" / "campaign"
    shutil.copytree(tiny_run / "campaign", demo, ignore=shutil.ignore_patterns("bench", "ranging", "02"))
    monkeypatch.chdir(tmp_path)
    for name, content in re.findall(r"```(?:python|toml)\n# file: (\S+)\n(.*?)```", TEXT, flags=re.DOTALL):
        Path(name).write_text(content)
    (answer,) = re.findall(r"```json\n(.*?)```", TEXT, flags=re.DOTALL)
    Path("answer.json").write_text(answer)
    Path("their_evaluator").write_text(f"#!/bin/sh\ncp '{tmp_path}/answer.json' \"$2\"\n")
    Path("their_evaluator").chmod(0o755)
    commands = [shlex.split(line) for line in re.findall(r"^testrange (\w.*)$", TEXT, flags=re.MULTILINE)]
    assert [c[0] for c in commands] == ["compare", "evaluate", "compare"]
    for command in commands:
        if (
            command[0] == "evaluate"
        ):  # what the folder lacks is no error of the page; the table of names stands for the option
            command = [*command, "--keep-going", "--no-documents"]
            command[command.index("--algorithm") : command.index("--algorithm") + 2] = [
                "--algorithms",
                "my_algorithms.toml",
            ]
        assert call([*command, "--quiet"]) == 0
    told = json.loads(Path("out/compare/comparison.json").read_text())
    assert all(not r["failures"] and r["status"] == "done" for r in told["runs"])
    up = {r["contender"]: r for r in told["errors"] if r["quantity"] == "vertex_up"}
    assert up["mine"]["items"] > 0.7 * up["default"]["items"] > 9
    assert up["mine"]["rms"] > 1.5 * up["default"]["rms"]
    results = json.loads(Path("out/mine/results.json").read_text())
    assert results["algorithms"] == {"vertex_estimation": "vertex:four_planes"}
    runs = json.loads(Path("out/compare_program/comparison.json").read_text())["runs"]
    assert [r["status"] for r in runs] == ["done", "done"]
    assert runs[1]["indicators"] == {"calibration_error": 0.31, "lidar_reflectance_rmse": 1.2}


def test_the_tables_are_the_records_own() -> None:
    """Rationale: people write against the page. Expected: every slot and ready-made name on it; every name of every record
    with the very comment of the code, which has shape and unit; no word left to fill in."""
    source = Path(slots.__file__).read_text(encoding="utf-8")
    lines = source.splitlines()
    rows = 0
    for node in ast.parse(source).body:
        if not (isinstance(node, ast.ClassDef) and re.search(r"Task$|^Found", node.name)):
            continue
        part = TEXT.split(f"### {node.name}\n", 1)[1].split("\n### ")[0]
        for entry in node.body:
            if isinstance(entry, ast.AnnAssign) and isinstance(entry.target, ast.Name):
                comment = lines[(entry.end_lineno or entry.lineno) - 1].partition("  # ")[2]
                if entry.target.id in ("problem", "views", "observations"):
                    continue
                assert comment and f"| `{entry.target.id}` | {comment} |" in part, f"{node.name}.{entry.target.id}"
                rows += 1
    assert rows > 70
    assert all(f"`{name}`" in TEXT for name in (*SLOTS, *BUILT_IN))
    assert "FIGURES" not in TEXT and "SLOTS" not in TEXT
