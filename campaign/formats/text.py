"""CSV and JSON below the campaign's tables and sheets: bounded reading, errors that name file, row and column, complete writing."""

import csv
import io
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from campaign.errors import CampaignError
from campaign.writing.atomic import complete_file

MAX_CSV_BYTES = 30_000_000  # a row takes some twenty times its bytes while it is read
MAX_JSON_BYTES = 50_000_000
MAX_FIELD = 100_000
MAX_PROBLEMS = 100  # of one file; whoever has more has the wrong file
_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
_FILE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,127}")
_FILE_NAME_RULE = "a file name without a folder, of letters A-Z a-z, digits, _ - and . only (no .., no first . or -)"

Parse = Callable[[str], Any]
M = TypeVar("M", bound=BaseModel)


def number(text: str) -> float:
    """A finite decimal number."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError("a finite number")
    return value


def non_negative(text: str) -> float:
    """A finite number that is not negative."""
    value = number(text)
    if value < 0.0:
        raise ValueError("a number not below 0")
    return value


def positive(text: str) -> float:
    """A finite number above zero."""
    value = number(text)
    if value <= 0.0:
        raise ValueError("a number above 0")
    return value


def within(low: float, high: float, unit: str) -> Parse:
    """A number between two limits beyond which it can only be in a wrong unit."""

    def parse(text: str) -> float:
        value = number(text)
        if not low <= value <= high:
            raise ValueError(f"{low:g} to {high:g} {unit}")
        return value

    return parse


def whole(text: str) -> int:
    """A whole number that is not negative."""
    if not text.isascii() or not text.isdigit() or len(text) > 15:
        raise ValueError("a whole number not below 0")
    return int(text)


def identifier(text: str) -> str:
    """Letters, digits, _ and -, at most 64."""
    if not _ID.fullmatch(text):
        raise ValueError("letters, digits, _ and - only")
    return text


def file_name(text: str) -> str:
    """A file name without a folder, of letters, digits, _ - and . only: it cannot leave the folder that it is joined to."""
    if not _FILE_NAME.fullmatch(text) or ".." in text:
        raise ValueError(_FILE_NAME_RULE)
    return text


def inner_path(text: str) -> str:
    """A path inside the campaign folder, with /: plain names only, so it cannot leave it."""
    for part in text.split("/"):
        file_name(part)
    return text


def one_of(*words: str) -> Parse:
    """A word of a closed list."""

    def parse(text: str) -> str:
        if text not in words:
            raise ValueError(" or ".join(words))
        return text

    return parse


def optional(parse: Parse) -> Parse:
    """An empty cell is None."""
    return lambda text: None if text == "" else parse(text)


def read_bounded(path: Path, limit: int) -> str:
    """A UTF-8 text file of at most `limit` bytes."""
    try:
        with path.open("rb") as file:
            raw = file.read(limit + 1)
    except FileNotFoundError:
        raise CampaignError("no such file", where=str(path)) from None
    except OSError as error:
        raise CampaignError("cannot be read", where=str(path), got=error.strerror) from None
    if len(raw) > limit:
        raise CampaignError("too large", where=str(path), expected=f"at most {limit} bytes")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise CampaignError("is not UTF-8 text", where=str(path)) from None


def read_table(path: Path) -> tuple[list[str], list[list[str]]]:
    """Header and rows of a CSV file; every row as long as the header."""
    text = read_bounded(path, MAX_CSV_BYTES)
    if "\0" in text:
        raise CampaignError("is not a CSV text file", where=str(path))
    csv.field_size_limit(MAX_FIELD)
    try:
        lines = [row for row in csv.reader(io.StringIO(text), strict=True) if row and row != [""]]
    except csv.Error as error:
        raise CampaignError("is not valid CSV", where=str(path), got=error) from None
    if not lines:
        raise CampaignError("is empty", where=str(path), expected="a header row")
    header, rows = [cell.strip() for cell in lines[0]], lines[1:]
    for i, row in enumerate(rows, 2):
        if len(row) != len(header):
            raise CampaignError(
                "the row has another length than the header",
                where=f"{path} row {i}",
                got=len(row),
                expected=len(header),
            )
    return header, rows


def read_rows(path: Path, columns: Mapping[str, Parse], required: Iterable[str] | None = None) -> list[dict[str, Any]]:
    """Rows of a CSV file as dicts of parsed cells.

    Columns may stand in any order; an unknown one is refused, a missing one too unless it is left out of `required`.
    """
    header, rows = read_table(path)
    unknown = [c for c in header if c not in columns]
    missing = [c for c in (columns if required is None else required) if c not in header]
    if unknown or missing or len(set(header)) != len(header):
        wrong = f"unknown column {unknown[0]!r}" if unknown else "a column twice" if not missing else ""
        raise CampaignError(
            wrong or f"column {missing[0]!r} is missing", where=str(path), expected="columns " + ", ".join(columns)
        )
    out, problems = [], []
    for i, row in enumerate(rows, 2):
        cells = {}
        for name, text in zip(header, row):
            try:
                cells[name] = columns[name](text.strip())
            except (ValueError, OverflowError) as error:
                expected = "a number" if "could not convert" in str(error) else error
                where = f"{path} row {i} column {name}"
                problems.append(CampaignError("wrong value", where=where, got=repr(text[:40]), expected=expected))
        if len(problems) >= MAX_PROBLEMS:
            break
        out.append(cells)
    raise_problems(problems)
    return out


def raise_problems(problems: Sequence[CampaignError]) -> None:
    """One error whose text is the first problem and the number of others; `problems` holds a line for each."""
    if len(problems) == 1:
        raise problems[0]
    if problems:
        more = f"and {len(problems) - 1} more problems in this file"
        raise CampaignError(str(problems[0]), remedy=more, problems=[str(p) for p in problems])


def write_rows(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """A CSV file; floats in their shortest exact form, None as an empty cell."""
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([_cell(v) for v in row] for row in rows)
    write_text(path, buffer.getvalue())


def write_text(path: Path, text: str) -> None:
    """A UTF-8 file with \\n line ends, complete or not at all."""
    with complete_file(path) as work:
        work.write_bytes(text.encode("utf-8"))


def _cell(value: object) -> object:
    if value is None:
        return ""
    return repr(float(value)) if isinstance(value, float) else value


def read_model(path: Path, model: type[M]) -> M:
    """A JSON file as a validated model; the error holds a line for each wrong key, as that of a table does for each cell."""
    text = read_bounded(path, MAX_JSON_BYTES)
    try:
        return model.model_validate_json(text, strict=True)
    except ValidationError as error:
        wrong = error.errors(include_url=False)
    except RecursionError:
        raise CampaignError("is nested too deeply", where=str(path)) from None
    if wrong[0]["type"] == "json_invalid":
        raise CampaignError("is not valid JSON", where=str(path), got=wrong[0]["msg"].split(": ", 1)[-1])
    problems = []
    for one in wrong[:MAX_PROBLEMS]:
        key = ".".join(str(part) for part in one["loc"])
        got = None if one["type"] == "missing" else json.dumps(one["input"], default=str)[:60]
        problems.append(CampaignError(one["msg"], where=f"{path} {key}".strip(), got=got))
    raise_problems(problems)
    raise AssertionError("pydantic names at least one error")


def write_model(path: Path, model: BaseModel) -> None:
    """A model as JSON that a person can read, keys in the order of the fields."""
    write_text(path, json.dumps(model.model_dump(mode="json"), ensure_ascii=False, indent=2) + "\n")
