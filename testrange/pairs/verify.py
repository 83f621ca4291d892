"""The judge: anyone's answers to reference pairs, right, wrong or missing, and which known mistake a wrong one shows.

Arithmetic is decimal with 60 digits, so that answers in more than double precision are judged as they stand. Reading and bounding
of an answers file lives here too; the command is `testrange.commands.pairs`.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal, InvalidOperation
from pathlib import Path
from typing import Literal

from testrange.pairs.model import Pair, PairsError, read_bounded

MAX_ANSWERS_BYTES = 8_000_000
MAX_ANSWERS = 10_000
MAX_VALUES = 1_000  # of one answer
_MAX_DIGITS = 120  # of one number's text
_MAX_EXPONENT = 400
_CONTEXT = Context(prec=60)
_FARTHEST = 1e300  # tolerances; JSON has no infinity

# What answers to no formula in particular, but happens with all of them; tried after the pair's own mistakes.
_COMMON: tuple[tuple[str, Decimal], ...] = (
    ("sign reversed", Decimal(-1)),
    *((f"{10**k} times too large: a unit, or percent", Decimal(10) ** k) for k in (1, 2, 3, 6)),
    *((f"{10**k} times too small: a unit, or percent", Decimal(10) ** -k) for k in (1, 2, 3, 6)),
    ("twice as large", Decimal(2)),
    ("half as large", Decimal("0.5")),
    ("degrees where radians are asked for", Decimal("57.29577951308232087679815481410517")),
    ("radians where degrees are asked for", Decimal("0.01745329251994329576923690768488613")),
)

Answer = float | int | str | Decimal | Sequence["Answer"] | None
Status = Literal["right", "wrong", "missing"]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What one answer is worth."""

    pair: str
    formula: str
    kind: str
    status: Status
    error_in_tolerances: float | None  # greatest of its results'; None: missing, or not comparable
    mistake: str | None  # the known mistake whose value the answer has
    remark: str | None  # why it cannot be compared


@dataclass(frozen=True, kw_only=True)
class Report:
    """All verdicts, in the order of the pairs."""

    verdicts: tuple[Verdict, ...]
    unknown: tuple[str, ...]  # answers whose id is no pair's

    def of(self, status: Status) -> tuple[Verdict, ...]:
        return tuple(v for v in self.verdicts if v.status == status)

    @property
    def mistakes(self) -> dict[str, tuple[str, ...]]:
        """Name of each mistake that was met -> ids of the pairs that show it."""
        found: dict[str, list[str]] = {}
        for v in self.verdicts:
            if v.mistake is not None:
                found.setdefault(v.mistake, []).append(v.pair)
        return {name: tuple(ids) for name, ids in found.items()}

    def block(self) -> dict[str, object]:
        """For JSON."""
        return {
            "right": len(self.of("right")),
            "wrong": len(self.of("wrong")),
            "missing": len(self.of("missing")),
            "mistakes": {name: list(ids) for name, ids in self.mistakes.items()},
            "unknown": list(self.unknown),
            "pairs": [vars(v) for v in self.verdicts],
        }


def verify(pairs: Iterable[Pair], answers: Mapping[str, Answer]) -> Report:
    """Judge answers to reference pairs.

    Parameters
    ----------
    pairs : iterable of Pair
    answers : mapping
        Pair id -> its value; a list in the order of the pair's results where it has several (nested lists are read row by row).
        Numbers, or decimal strings of them. None, or no entry: missing.

    Returns
    -------
    Report

    Raises
    ------
    PairsError
        More answers, or more values in one, than any set of pairs has. An answer that is no number is a wrong answer.
    """
    pairs = tuple(pairs)
    if len(answers) > MAX_ANSWERS:
        raise PairsError("too many answers", got=len(answers), expected=f"at most {MAX_ANSWERS}")
    known = {pair.id for pair in pairs}
    return Report(
        verdicts=tuple(_judge(pair, answers.get(pair.id)) for pair in pairs),
        unknown=tuple(sorted(_printable(str(name)[:80]) for name in answers if name not in known)),
    )


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)


def _judge(pair: Pair, answer: Answer) -> Verdict:
    def verdict(
        status: Status, error: float | None = None, mistake: str | None = None, remark: str | None = None
    ) -> Verdict:
        return Verdict(
            pair=pair.id,
            formula=pair.formula,
            kind=pair.kind,
            status=status,
            error_in_tolerances=error,
            mistake=mistake,
            remark=remark,
        )

    if answer is None:
        return verdict("missing")
    try:
        values = [_decimal(v) for v in _flat(answer, pair.id)]
    except (InvalidOperation, ValueError, TypeError):
        return verdict("wrong", remark="not a number")
    if len(values) != len(pair.results):
        return verdict("wrong", remark=f"{len(values)} values, {len(pair.results)} are asked for")
    if not all(v.is_finite() for v in values):
        return verdict("wrong", remark="not a finite number")
    tolerance = [Decimal(r.tolerance) for r in pair.results]
    truth = [Decimal(r.value) for r in pair.results]
    error = _distance(values, truth, tolerance)
    if error <= 1.0:
        return verdict("right", error)
    return verdict("wrong", error, named(pair, values))


def named(pair: Pair, values: Sequence[Decimal]) -> str | None:
    """The mistake whose values these are, None where they are no known one's."""
    truth = [Decimal(r.value) for r in pair.results]
    share = Decimal(pair.tolerance_relative)

    def is_at(wrong: Sequence[Decimal]) -> bool:
        # a mistake is met as closely as the result would have to be, each value by its own size
        around = [
            max(Decimal(r.tolerance), _CONTEXT.multiply(abs(w), share))
            for r, w in zip(pair.results, wrong, strict=True)
        ]
        return _distance(values, wrong, around) <= 1.0

    for name, texts in pair.mistakes.items():
        if is_at([Decimal(t) for t in texts]):
            return name
    for name, factor in _COMMON:
        if is_at([_CONTEXT.multiply(t, factor) for t in truth]):
            return name
    return None


def _distance(values: Sequence[Decimal], truth: Sequence[Decimal], tolerance: Sequence[Decimal]) -> float:
    """Greatest difference in units of its tolerance."""
    far = (
        _CONTEXT.divide(abs(_CONTEXT.subtract(v, t)), tol) for v, t, tol in zip(values, truth, tolerance, strict=True)
    )
    return max(min(float(d), _FARTHEST) for d in far)


def _flat(answer: Answer, pair: str, depth: int = 0) -> list[float | int | str | Decimal]:
    if isinstance(answer, (str, Decimal)) or not isinstance(answer, Sequence):
        if answer is None or isinstance(answer, (bool, Mapping)):
            raise ValueError
        return [answer]
    if depth >= 3:
        raise ValueError
    out: list[float | int | str | Decimal] = []
    for part in answer:
        out += _flat(part, pair, depth + 1)
        if len(out) > MAX_VALUES:
            raise PairsError("too many values in one answer", where=pair, expected=f"at most {MAX_VALUES}")
    return out


def _decimal(value: float | int | str | Decimal) -> Decimal:
    """Exactly the number that is meant; raises ValueError where its text is none, or of no use."""
    if isinstance(value, str):
        if len(value) > _MAX_DIGITS:
            raise ValueError
        value = value.strip()
        if "_" in value:
            raise ValueError
    elif isinstance(value, int) and value.bit_length() > 400:
        raise ValueError
    number = Decimal(value)
    if number.is_finite() and number != 0 and abs(number.adjusted()) > _MAX_EXPONENT:
        raise ValueError
    return number


def read_answers(path: Path) -> dict[str, Answer]:
    """Answers from a JSON file: one object, pair id -> number, decimal string or list of them.

    Raises
    ------
    PairsError
        No such file, too large, no JSON, not one object, or an id twice.
    """
    text = read_bounded(path, MAX_ANSWERS_BYTES)
    try:
        content = json.loads(
            text, object_pairs_hook=_once, parse_float=str, parse_int=str, parse_constant=lambda name: math.nan
        )
    except PairsError as error:
        raise PairsError(error.what, where=str(path)) from None
    except (ValueError, RecursionError) as error:
        raise PairsError("is not valid JSON", where=str(path), got=str(error)[:100] or "too deep") from None
    if not isinstance(content, dict):
        raise PairsError(
            "is no answers file",
            where=str(path),
            expected='one object: {"f08_b1": 1.239, "f16_one_point": [320.1, 245.9], ...}',
        )
    return content


def _once(items: list[tuple[str, object]]) -> dict[str, object]:
    found: dict[str, object] = {}
    for name, value in items:
        if name in found:
            raise PairsError(f"{name[:80]} is answered twice")
        found[name] = value
    return found
