"""docs/studies.md: its commands run as they stand, one after the other."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from evaluator.c10_1_grading import INDICATORS
from testrange.study.execution.responses import PANEL_POINTS, SCORED
from testrange.study.model import Factor, Study

PAGE = Path(__file__).parents[2] / "docs" / "studies.md"
_BLOCK = re.compile(r"^```(\w+)(?: ([\w.]+))?\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)


def run_page(folder: Path, slow: bool) -> None:
    """Write the page's files and run its shell blocks; those marked `slow` only when asked for, the others only when not."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for language, mark, text in _BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        if language in ("toml", "py"):
            (folder / mark).write_text(text, encoding="utf-8")
        if language == "sh" and (mark == "slow") is slow:
            done = subprocess.run(
                ["bash", "-euc", text],
                cwd=folder,
                env={**os.environ, "PATH": path},
                capture_output=True,
                text=True,
                check=False,
            )
            assert done.returncode == 0, f"{text}\n{done.stderr}"


def test_the_tutorial_runs(tmp_path: Path) -> None:
    """Expected: every quick command ends with 0; the Ishigami table has 512 (3 + 2) rows, the shards' table is the whole's."""
    run_page(tmp_path, slow=False)
    out = tmp_path / "out"
    assert pq.read_table(out / "ishigami" / "table.parquet").num_rows == 512 * 5
    whole, parts = (pq.read_table(out / name / "table.parquet").drop(["run_time_s"]) for name in ("smear", "parts"))
    assert whole.equals(parts) and whole.num_rows == 30
    speed, height, smear = (whole[name].to_pylist() for name in ("speed", "height", "smear_px"))
    assert smear == pytest.approx([v * 0.75 / h for v, h in zip(speed, height)])


@pytest.mark.slow
def test_the_tutorials_campaigns_run(tmp_path: Path) -> None:
    """Expected: twice the pulses, twice the points; twice the speed, half the points. Tolerance 10 %: points at panels' edges."""
    run_page(tmp_path, slow=True)
    table = pq.read_table(tmp_path / "out" / "points" / "table.parquet").to_pydict()
    found = {(p, v): n for p, v, n in zip(table["prr"], table["speed"], table["panel_points.per_strip"])}
    base = found[50000.0, 4.0]
    assert found[100000.0, 4.0] == pytest.approx(2.0 * base, rel=0.1)
    assert found[50000.0, 8.0] == pytest.approx(0.5 * base, rel=0.1)


def test_every_key_and_response_is_on_the_page() -> None:
    text = PAGE.read_text(encoding="utf-8")
    keys = (set(Study.model_fields) | set(Factor.model_fields)) - {"design_seed", "grid_levels", "factor", "level"}
    assert sorted(key for key in keys if f"`{key}" not in text) == []
    assert all(f".{what}" in text for what in (*PANEL_POINTS, *SCORED)) and len(INDICATORS) == 8
