"""The form of a reference pair, and reading a set of them from pairs.json. Computing pairs: `clauses`; writing: `write`."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from campaign.config import Model
from campaign.errors import TestrangeError

SCHEMA = 1
PAIRS_FILE = "pairs.json"
DIGITS = 30
MAX_PAIRS_BYTES = 16_000_000
KINDS = ("ordinary", "boundary", "ill_conditioned", "published")

# At most 400 characters and an exponent of three digits: 30-digit results, and doubles written out in full.
NumberText = Annotated[str, Field(max_length=400, pattern=r"^-?[0-9]+(\.[0-9]+)?(e[+-]?[0-9]{1,3})?$")]
Numbers = NumberText | tuple[NumberText, ...] | tuple[tuple[NumberText, ...], ...]
Text = Annotated[str, Field(min_length=1, max_length=2000)]


class PairsError(TestrangeError):
    """A file of pairs or of answers is not what it says."""


class Input(Model):
    """One given quantity; every number is exactly a double, so that both sides start from the same."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
    unit: Annotated[str, Field(max_length=32)]
    meaning: Text
    value: Numbers


class Result(Model):
    """One number that is asked for."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$")]
    unit: Annotated[str, Field(max_length=32)]
    value: NumberText
    tolerance: NumberText = Field(description="an answer farther off than this is wrong; in the result's unit")


class Pair(Model):
    """Inputs and results of one formula, with what a well-known mistake would give instead."""

    id: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_.-]{0,63}$")]
    formula: Annotated[str, Field(max_length=64)]
    clause: Annotated[str, Field(max_length=32)]
    kind: Literal["ordinary", "boundary", "ill_conditioned", "published"]
    statement: Text
    inputs: Annotated[tuple[Input, ...], Field(min_length=1, max_length=32)]
    results: Annotated[tuple[Result, ...], Field(min_length=1, max_length=1000)]
    condition: NumberText = Field(description="relative change of the worst result per relative change of the inputs")
    condition_note: Text
    tolerance_relative: NumberText
    tolerance_why: Text
    mistakes: dict[Annotated[str, Field(min_length=1, max_length=200)], tuple[NumberText, ...]]
    published: str | None = Field(None, max_length=1000, description="what was printed, and where")


class PairFile(Model):
    """pairs.json."""

    schema_: Literal[1] = Field(alias="schema")
    name: Text
    digits: Annotated[int, Field(ge=15, le=100)]
    licence: Text
    pairs: Annotated[tuple[Pair, ...], Field(min_length=1, max_length=5000)]


def read_pairs(folder: Path) -> tuple[Pair, ...]:
    """Pairs of a folder that `testrange pairs` wrote, or of a pairs.json itself.

    Raises
    ------
    PairsError
        No such file, too large, or not of this form.
    """
    path = folder / PAIRS_FILE if folder.is_dir() else folder
    text = read_bounded(path, MAX_PAIRS_BYTES)
    try:
        pairs = PairFile.model_validate_json(text).pairs
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise PairsError("is no file of reference pairs", where=str(path), got=f"{place}: {first['msg']}") from None
    refuse_twice(pairs, path)
    for pair in pairs:
        if any(len(values) != len(pair.results) for values in pair.mistakes.values()):
            raise PairsError("a mistake has not as many values as the pair has results", where=f"{path}: {pair.id}")
        if any(float(r.tolerance) <= 0.0 for r in pair.results):
            raise PairsError("a tolerance is not above zero", where=f"{path}: {pair.id}")
    return pairs


def refuse_twice(pairs: Iterable[Pair], path: Path) -> None:
    seen: set[str] = set()
    for pair in pairs:
        if pair.id in seen:
            raise PairsError("two pairs have one id", where=str(path), got=pair.id)
        seen.add(pair.id)


def read_bounded(path: Path, most: int) -> str:
    """Text of a file of at most `most` bytes."""
    try:
        with path.open("rb") as file:
            raw = file.read(most + 1)
    except FileNotFoundError:
        raise PairsError("no such file", where=str(path)) from None
    except (OSError, ValueError) as error:
        raise PairsError("cannot be read", where=str(path), got=getattr(error, "strerror", None) or error) from None
    if len(raw) > most:
        raise PairsError("is too large", where=str(path), expected=f"at most {most} bytes")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise PairsError("is not UTF-8 text", where=str(path), expected="JSON") from None


def plain(pair: Pair) -> dict[str, object]:
    """A pair as JSON has it."""
    content: dict[str, object] = json.loads(pair.model_dump_json())
    return content
