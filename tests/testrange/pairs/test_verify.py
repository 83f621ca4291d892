"""The judge of answers and the files about it: units of tolerance, hostile answers, what is missing, the same bytes each time."""

import hashlib
import json
from decimal import Decimal
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testrange.cli import call
from testrange.pairs.model import Input, Pair, PairsError, Result, read_pairs
from testrange.pairs.show import print_report
from testrange.pairs.verify import read_answers, verify
from testrange.pairs.write import compute_pairs, write_pairs


def pair(id: str, *values: str, tolerance: str = "1e-9", mistakes: dict[str, tuple[str, ...]] | None = None) -> Pair:
    return Pair(
        id=id,
        formula="(0)",
        clause="0",
        kind="ordinary",
        statement="none",
        inputs=(Input(name="x", unit="1", meaning="none", value="1"),),
        results=tuple(Result(name=f"y{i}", unit="1", value=v, tolerance=tolerance) for i, v in enumerate(values)),
        condition="1.0",
        condition_note="none",
        tolerance_relative="1.0e-9",
        tolerance_why="none",
        mistakes=mistakes or {},
    )


def test_error_in_units_of_tolerance() -> None:
    """By hand: 2.0000000005 against 2 +- 1e-9 is half a tolerance off and right, 2.000000003 three and wrong. Tolerance: 1e-6,
    what a double leaves of such a difference."""
    a = pair("a", "2")
    right, wrong = (verify([a], {"a": v}).verdicts[0] for v in (2.0000000005, 2.000000003))
    assert (right.status, wrong.status) == ("right", "wrong")
    assert right.error_in_tolerances == pytest.approx(0.5, rel=1e-6)
    assert wrong.error_in_tolerances == pytest.approx(3.0, rel=1e-6)


def test_more_than_double_precision_is_judged_as_it_stands() -> None:
    """An answer of 30 digits as text: one unit of the 30th digit off, at a tolerance of two of them."""
    a = pair("a", "1.00000000000000000000000000003", tolerance="2e-29")
    assert verify([a], {"a": "1.00000000000000000000000000002"}).verdicts[0].error_in_tolerances == pytest.approx(0.5)
    assert verify([a], {"a": Decimal(1)}).verdicts[0].status == "wrong"


def test_mistakes_of_the_pair_then_common_ones() -> None:
    """The pair's own name comes before a common one of the same value; all values must be the mistake's."""
    a = pair("a", "2", "3", mistakes={"turned": ("3", "2"), "reversed as known": ("-2", "-3")})
    told = {
        (3.0, 2.0): "turned",
        (-2.0, -3.0): "reversed as known",
        (2000.0, 3000.0): "1000 times too large: a unit, or percent",
        (4.0, 6.0): "twice as large",
        (2.0, 4.0): None,
    }
    for values, name in told.items():
        assert verify([a], {"a": list(values)}).verdicts[0].mistake == name


def test_lists_may_be_nested_and_a_single_number_may_stand_in_one() -> None:
    a, b = pair("a", "1", "2", "3", "4"), pair("b", "5")
    assert not verify([a, b], {"a": [[1, 2], [3, 4]], "b": [5]}).of("wrong")


def test_missing_and_unknown() -> None:
    report = verify([pair("a", "1"), pair("b", "1"), pair("c", "1")], {"a": 1, "b": None, "z": 1})
    assert [v.status for v in report.verdicts] == ["right", "missing", "missing"]
    assert report.unknown == ("z",)


@pytest.mark.parametrize(
    ("answer", "remark"),
    [
        ("nan", "not a finite number"),
        (float("inf"), "not a finite number"),
        ("-Infinity", "not a finite number"),
        ("sNaN", "not a finite number"),
        ("one", "not a number"),
        ("", "not a number"),
        ("1_000", "not a number"),
        ("1" * 500, "not a number"),
        ("1e999999999", "not a number"),
        ("1e-999999999999999999999", "not a number"),
        (10**500, "not a number"),
        (True, "not a number"),
        ({"y0": 1}, "not a number"),
        ([], "0 values, 1 are asked for"),
        ([1, 1], "2 values, 1 are asked for"),
        ([[[[1]]]], "not a number"),
        ([None], "not a number"),
    ],
)
def test_what_is_no_answer_is_a_wrong_one(answer: object, remark: str) -> None:
    """Rationale: answers come from anywhere. Expected: wrong, with the reason, and no error."""
    (verdict,) = verify([pair("a", "1")], {"a": answer}).verdicts  # type: ignore[dict-item]
    assert (verdict.status, verdict.remark) == ("wrong", remark)
    json.dumps(vars(verdict), allow_nan=False)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=150, deadline=None)
@given(JSON)
def test_any_json_gets_a_verdict(answer: object) -> None:
    """A law for all inputs: a verdict that JSON can hold, right only within the tolerance, never an error."""
    (verdict,) = verify([pair("a", "1", mistakes={"m": ("2",)})], {"a": answer}).verdicts  # type: ignore[dict-item]
    json.dumps(vars(verdict), allow_nan=False)
    if verdict.status == "right":
        assert verdict.error_in_tolerances is not None and verdict.error_in_tolerances <= 1.0


def test_a_far_answer_has_a_finite_error() -> None:
    """JSON has no infinity: 1e400 at a tolerance of 1e-9 overflows a double."""
    (verdict,) = verify([pair("a", "1")], {"a": "1e400"}).verdicts
    assert verdict.error_in_tolerances == 1e300


def test_too_many_answers_or_values_are_refused() -> None:
    with pytest.raises(PairsError, match="too many answers"):
        verify([pair("a", "1")], dict.fromkeys(map(str, range(10_001)), 1))
    with pytest.raises(PairsError, match="too many values"):
        verify([pair("a", "1")], {"a": [1] * 1001})


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (b"[1, 2]", "is no answers file"),
        (b'{"a": 1, "a": 2}', "answered twice"),
        (b"{", "is not valid JSON"),
        (b"\xff\xfe{}", "is not UTF-8 text"),
        (b'{"a": ' + b"[" * 100_000 + b"]" * 100_000 + b"}", "is not valid JSON"),
        (b'{"a": "' + b"x" * 8_000_000 + b'"}', "is too large"),
    ],
)
def test_hostile_answers_files(tmp_path: Path, text: bytes, what: str) -> None:
    """Expected: one line that names the file."""
    path = tmp_path / "answers.json"
    path.write_bytes(text)
    with pytest.raises(PairsError, match=what) as caught:
        read_answers(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_numbers_of_a_file_keep_all_their_digits(tmp_path: Path) -> None:
    path = tmp_path / "answers.json"
    path.write_text('{"a": 1.00000000000000000000000000003, "b": NaN, "c": 7}')
    found = read_answers(path)
    assert (
        verify([pair("a", "1.00000000000000000000000000003", tolerance="1e-40")], found).verdicts[0].status == "right"
    )
    assert verify([pair("b", "1")], found).verdicts[0].remark == "not a finite number"
    assert verify([pair("c", "7")], found).verdicts[0].status == "right"


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda p: p["results"][0].update(value="1e9999"), "results"),
        (lambda p: p["results"][0].update(tolerance="0"), "tolerance is not above zero"),
        (lambda p: p["mistakes"].update(other=["1", "2"]), "as many values"),
        (lambda p: p.update(id="../up"), "id"),
        (lambda p: p.update(surplus=1), "surplus"),
    ],
)
def test_hostile_pairs(tmp_path: Path, change: object, what: str) -> None:
    write_pairs([pair("a", "1", mistakes={"m": ("2",)})], tmp_path / "pairs")
    path = tmp_path / "pairs" / "pairs.json"
    content = json.loads(path.read_text())
    change(content["pairs"][0])  # type: ignore[operator]
    path.write_text(json.dumps(content))
    with pytest.raises(PairsError, match=what):
        read_pairs(tmp_path / "pairs")


def test_texts_of_a_file_are_printed_as_they_stand(capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: pairs and answers come from anywhere. Expected: no markup is read in a formula's name, no escape is printed."""
    odd = pair("a", "1").model_copy(update={"formula": "[/red] (8)"})
    print_report(verify([odd], {"a": 2.0, "\x1b[2J\r": 1.0}))
    told = capsys.readouterr().out
    assert "[/red] (8)" in told and "answers to no pair: 1:" in told
    assert not {"\x1b", "\r"} & set(told)


def test_files_are_the_same_each_time_and_read_back(tmp_path: Path) -> None:
    """Expected: equal bytes of two runs, sums that check, pairs that read back as they were, tables with every number."""
    pairs = compute_pairs(clauses=("8.3",))
    for name in ("one", "two"):
        write_pairs(compute_pairs(clauses=("8.3",)), tmp_path / name)
    files = sorted(p.relative_to(tmp_path / "one") for p in (tmp_path / "one").rglob("*") if p.is_file())
    assert [(tmp_path / "one" / f).read_bytes() for f in files] == [(tmp_path / "two" / f).read_bytes() for f in files]
    for line in (tmp_path / "one" / "SHA256SUMS").read_text().splitlines():
        total, name = line.split("  ")
        assert hashlib.sha256((tmp_path / "one" / name).read_bytes()).hexdigest() == total
    assert len(files) == 1 + len((tmp_path / "one" / "SHA256SUMS").read_text().splitlines())
    assert read_pairs(tmp_path / "one") == pairs
    eight = (tmp_path / "one" / "tables" / "formula_8.csv").read_text()
    for p in pairs:
        if p.formula == "(8)":
            assert p.results[0].value in eight and all(v in eight for values in p.mistakes.values() for v in values)


def test_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Expected: write, answer, verify: 0 and all right; one answer broken: 1, named; nothing answered: 1; no such clause: 1."""
    folder, answers = tmp_path / "pairs", tmp_path / "answers.json"
    assert call(["pairs", "--clause", "8.3", "--out", str(folder), "--quiet"]) == 0
    assert call(["pairs", "answer", str(answers), "--pairs", str(folder)]) == 0
    capsys.readouterr()
    assert call(["pairs", "verify", str(answers), "--pairs", str(folder)]) == 0
    assert "0 wrong, 0 missing" in capsys.readouterr().out
    content = json.loads(answers.read_text())
    wrong = next(p for p in read_pairs(folder) if p.id == "f08_b1").mistakes["2n in place of 2(n-1)"]
    answers.write_text(json.dumps({**content, "f08_b1": float(wrong[0]), "f07_b1": None, "more": 1}))
    assert call(["pairs", "verify", str(answers), "--pairs", str(folder)]) == 1
    told = capsys.readouterr().out
    assert (
        "mistake: 2n in place of 2(n-1) (1 pair)" in told
        and "1 wrong, 1 missing" in told
        and "answers to no pair: 1" in told
    )
    assert call(["pairs", "verify", str(answers), "--pairs", str(folder), "--json"]) == 1
    block = json.loads(capsys.readouterr().out)
    assert block["mistakes"] == {"2n in place of 2(n-1)": ["f08_b1"]} and block["missing"] == 1
    assert call(["pairs", "verify", str(folder / "answers_template.json"), "--pairs", str(folder)]) == 1
    assert call(["pairs", "--clause", "8.9", "--out", str(tmp_path / "none")]) == 1
    assert call(["pairs", "--out", str(folder), "--clause", "7.4", "--quiet"]) == 1  # not empty, no --replace
    assert call(["pairs", "--out", str(folder), "--clause", "7.4", "--quiet", "--replace"]) == 0
