"""Somebody's results against what is expected: grades, clauses, errors in tolerances, and the mistake's name where it can be told.

Any evaluator is scored that writes results.json in this project's form (schema 1); of it only grades, values, mounting, the
constants of ranging and the conformity table are read.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from campaign.errors import CampaignError
from testrange.family.mistakes import Compared, common_mistakes, mistakes_of
from testrange.family.model import ACCEPTED, Expected, read_expected

_MAX_BYTES = 50_000_000


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One member."""

    member: str
    compared: tuple[Compared, ...] = ()  # values
    missing: tuple[str, ...] = ()  # what the results do not hold
    clauses_missed: tuple[str, ...] = ()
    clauses_besides: tuple[str, ...] = ()
    mistakes: tuple[str, ...] = ()

    @property
    def right(self) -> bool:
        """Everything as expected."""
        return not (self.missing or self.clauses_missed or self.clauses_besides) and all(c.right for c in self.compared)


@dataclass(frozen=True, kw_only=True)
class Report:
    """All members, and mistakes that run through them."""

    verdicts: tuple[Verdict, ...]
    mistakes: tuple[str, ...] = ()
    unknown: tuple[str, ...] = field(default=())  # results of no member

    @property
    def right(self) -> bool:
        return bool(self.verdicts) and not self.mistakes and all(v.right for v in self.verdicts)

    def block(self) -> dict[str, Any]:
        """For verdict.json."""
        values = [c for v in self.verdicts for c in v.compared if c.grades]
        clauses = [v for v in self.verdicts if v.clauses_missed or v.clauses_besides]
        worst = max((abs(c.tolerances) for v in self.verdicts for c in v.compared), default=0.0)
        return {
            "schema": 1,
            "right": self.right,
            "members": len(self.verdicts),
            "members_right": sum(v.right for v in self.verdicts),
            "grades": len(values),
            "grades_right": sum(c.graded for c in values),
            "members_with_clauses_wrong": len(clauses),
            "greatest_error_in_tolerances": worst,
            "mistakes": list(self.mistakes),
            "results_of_no_member": list(self.unknown),
            "verdicts": [
                {
                    "member": v.member,
                    "right": v.right,
                    "values": [c.block() for c in v.compared],
                    "missing": list(v.missing),
                    "clauses_missed": list(v.clauses_missed),
                    "clauses_besides": list(v.clauses_besides),
                    "mistakes": list(v.mistakes),
                }
                for v in self.verdicts
            ],
        }


def verify(family: Path, results: Sequence[Path]) -> Report:
    """Scores results against DIR/expected.

    Parameters
    ----------
    family : Path
        What `make_family` wrote.
    results : sequence of Path
        Folders with MEMBER/results.json, or results.json files, which name their campaign.

    Raises
    ------
    CampaignError
        No expected files, or results that cannot be read.
    """
    files = sorted((family / "expected").glob("*.json")) if (family / "expected").is_dir() else []
    if not files:
        raise CampaignError("holds no expected files", where=str(family), expected="what testrange family make wrote")
    expected: dict[str, Expected] = {}
    for file, read in zip(files, map(read_expected, files), strict=True):
        if read.member in expected:
            raise CampaignError("expects of one member twice", where=str(file), got=read.member)
        expected[read.member] = read
    found = _collected(results)
    chosen = [name for name in expected if name in found] if any(p.is_file() for p in results) else list(expected)
    verdicts = tuple(_judged(expected[name], found.get(name)) for name in chosen)
    return Report(
        verdicts=verdicts,
        mistakes=common_mistakes([v.compared for v in verdicts]),
        unknown=tuple(sorted(set(found) - set(expected))),
    )


def _collected(places: Sequence[Path]) -> dict[str, dict[str, Any]]:
    """Member -> results."""
    found: dict[str, dict[str, Any]] = {}
    for place in places:
        if place.is_dir():
            files = sorted(place.glob("*/results.json")) or sorted(place.glob("results.json"))
            if not files:
                raise CampaignError("holds no results", where=str(place), expected="MEMBER/results.json")
        else:
            files = [place]
        for file in files:
            content = _read(file)
            name = str(content.get("campaign", ""))
            if name in found:
                raise CampaignError("results of one member stand twice", where=str(file), got=name)
            found[name] = content
    return found


def _read(file: Path) -> dict[str, Any]:
    try:
        if file.stat().st_size > _MAX_BYTES:
            raise CampaignError("is too large", where=str(file), expected=f"at most {_MAX_BYTES} bytes")
        content = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise CampaignError("cannot be read", where=str(file), got=error.strerror) from None
    except (ValueError, RecursionError) as error:
        raise CampaignError("is no JSON", where=str(file), got=str(error)[:100]) from None
    if not isinstance(content, dict) or not isinstance(content.get("campaign"), str):
        raise CampaignError("is no results file", where=str(file), expected="an object with campaign and indicators")
    return content


def _dict(of: object, key: str) -> dict[str, Any]:
    value = of.get(key) if isinstance(of, dict) else None
    return value if isinstance(value, dict) else {}


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:  # JSON has no greatest integer
        return None
    return number if math.isfinite(number) else None


def _judged(expected: Expected, results: dict[str, Any] | None) -> Verdict:
    if results is None:
        return Verdict(member=expected.member, missing=("results.json",))
    compared: list[Compared] = []
    missing: list[str] = []
    indicators = _dict(results, "indicators")
    for name, value in expected.indicators.items():
        entry = _dict(indicators, name)
        number = _number(entry.get("value"))
        if number is None:
            missing.append(f"{name}: {str(entry.get('reason') or 'no value')[:160]}")
            continue
        compared.append(Compared.of(name, value, number, str(entry.get("grade", ""))))
    companions = _dict(_dict(indicators, "lidar_ranging_rmse_relative"), "companions")
    mounting = _dict(results, "mounting")
    names, estimates = mounting.get("names"), mounting.get("estimates")
    pairs = zip(names, estimates) if isinstance(names, list) and isinstance(estimates, list) else ()
    solved = {name: estimate for name, estimate in pairs if isinstance(name, str)}
    for values, of in ((expected.constants, companions), (expected.mounting, solved)):
        for name, value in values.items():
            number = _number(of.get(name))
            if number is None:
                missing.append(f"{name}: no value")
            else:
                compared.append(Compared.of(name, value, number, None))
    missed, besides = _clauses(expected, results.get("conformity"))
    return Verdict(
        member=expected.member,
        compared=tuple(compared),
        missing=tuple(missing),
        clauses_missed=missed,
        clauses_besides=besides,
        mistakes=tuple(dict.fromkeys(m for c in compared for m in mistakes_of(c))),
    )


def _clauses(expected: Expected, rows: object) -> tuple[tuple[str, ...], tuple[str, ...]]:
    found = [
        (str(r.get("clause")), str(r.get("status")))
        for r in (rows if isinstance(rows, list) else [])
        if isinstance(r, dict)
    ]
    missed = tuple(
        clause
        for clause, statuses in expected.clauses.items()
        if not any(c == clause and status in statuses for c, status in found)
    )
    known = {*expected.clauses, *expected.may_fail}
    besides = tuple(sorted({c for c, status in found if status == "fail" and c not in known}))
    return missed, besides


def summary_lines(report: Report) -> list[str]:
    """For people: what is wrong, then the counts. What stands in somebody's file moves no cursor."""
    lines = []
    for v in report.verdicts:
        told = [f"missing {m}" for m in v.missing]
        for c in v.compared:
            if not c.right:
                graded = f", graded {c.grade}, expected {' or '.join(c.grades)}" if c.grades and not c.graded else ""
                told.append(
                    f"{c.quantity} {c.got:.5g} {c.unit}, true {c.true:.5g}: {c.tolerances:+.1f} tolerances{graded}"
                )
        told += [f"clause {c} not found" for c in v.clauses_missed]
        told += [f"clause {c} fails besides" for c in v.clauses_besides]
        told += [f"looks like: {m}" for m in v.mistakes]
        lines += [f"{v.member}: {t}" for t in told]
    block = report.block()
    lines += [f"mistake throughout: {m}" for m in report.mistakes]
    lines += [f"no such member: {name}" for name in report.unknown]
    lines.append(
        f"{block['members_right']} of {block['members']} members right; {block['grades_right']} of {block['grades']} grades; "
        f"greatest error {block['greatest_error_in_tolerances']:.2f} tolerances, {ACCEPTED:g} are accepted"
    )
    return ["".join(c if c.isprintable() else " " for c in line) for line in lines]
