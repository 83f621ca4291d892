"""docs/reference_pairs.md: its commands run at small size, its code runs, its example is right, its table of mistakes complete."""

import json
import re
from decimal import Decimal, getcontext
from pathlib import Path

import pytest

from testrange.cli import call
from testrange.pairs.model import Pair, read_pairs

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "reference_pairs.md").read_text(encoding="utf-8")
SMALL = ["--clause", "8.3"]


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    return tmp_path


def test_every_command_and_block_of_code(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: a reader types what stands there. Expected: each command in the page's order, with the code and the answers file
    between them, ends as the page says, and the wrong answer's table is the printed one. Small: clause 8.3 alone."""
    commands = [line.split() for line in re.findall(r"^    (testrange pairs .*)$", PAGE, re.MULTILINE)]
    code = blocks("python")
    assert len(commands) == 5 and len(code) == 2
    assert call([*commands[0][1:], *SMALL, "--quiet"]) == 0
    exec(compile(code[0], "page", "exec"), {})
    assert call(commands[1][1:]) == 0
    assert call(commands[2][1:]) == 0 and call(commands[3][1:]) == 0
    assert "0 wrong, 0 missing" in capsys.readouterr().out
    (folder / "out" / "wrong.json").write_text(blocks("json")[0])
    assert call(commands[4][1:]) == 1
    printed = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    for line in blocks("text")[0].strip().splitlines():
        assert " ".join(line.split()) in printed
    exec(compile(code[1], "page", "exec"), {})


def test_the_example_by_hand(folder: Path) -> None:
    """Expected: the page's table is the pair's input, its arithmetic exact, its root the result. Tolerance: none."""
    assert call(["pairs", "--out", "out/pairs", *SMALL, "--quiet"]) == 0
    pair = next(p for p in read_pairs(Path("out/pairs")) if p.id == "f08_five_panels")
    rows = [
        [Decimal(c) for c in r]
        for r in re.findall(r"^\| ([\d.]+) \| ([\d.]+) \| (-?[\d.]+) \| ([\d.]+) \|$", PAGE, re.MULTILINE)
    ]
    assert [[str(r[i]) for r in rows] for i in (0, 1)] == [list(i.value) for i in pair.inputs]
    assert all(r[2] == r[0] - r[1] and r[3] == r[2] ** 2 for r in rows)
    total = sum(r[3] for r in rows)
    getcontext().prec = 40
    assert f"sum | {total} |" in PAGE and f"= 8: {total / 8}." in PAGE
    assert f"    {pair.results[0].value}\n" in PAGE
    assert abs((total / 8).sqrt() - Decimal(pair.results[0].value)) < Decimal("1e-29")


def test_the_table_of_mistakes_is_complete() -> None:
    """Expected: of every formula each mistake, and none that is no longer there. The families whose adjustments take long are
    covered by their rows' presence alone."""
    from testrange.pairs.clauses import FAMILIES

    table = dict(re.findall(r"^\| (\S[^|]*?) \| ([^|]*) \|$", PAGE.split("## Mistakes")[1], re.MULTILINE))
    found: dict[str, list[str]] = {}
    quick = ("7.4", "8.1", "8.2", "8.3", "9.1", "9.1.2", "9.3")
    pairs: list[Pair] = [p for clause, family in FAMILIES if clause in quick for p in family()]
    for p in pairs:
        found.setdefault(p.formula, []).extend(m for m in p.mistakes if m not in found.get(p.formula, []))
    for formula, names in found.items():
        assert sorted(table[formula].replace("&#124;", "|").split("; ")) == sorted(names), formula
    assert {f"({n})" for n in range(1, 25)} <= set(table) and {"S3", "S4", "S5", "S6", "S7"} <= set(table)
    json.dumps(table)
