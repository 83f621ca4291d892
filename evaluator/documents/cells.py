"""What both writers need before they draw: text without control characters, and which cells of a table become one."""

import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass

from evaluator.documents.model import Cell, Figure, Table

HEAD_LENGTH = 40  # characters of a title or an id that the running head has room for
TITLE_LENGTH = 200
TEXT_LENGTH = 20_000  # of one cell or paragraph; the longest of our own has some hundreds

_LETTERS, _LETTERS_SMALL = 88, 111  # mean Latin letters in a line over the whole width of an upright page
_SHORT_TABLE = 8  # rows
_KEPT_LINES = 24.0  # of the widest letters: less than half a page

_HIDDEN = {"Cc", "Cs", "Cn", "Co"}  # control, lone surrogate, unassigned, private use
# Marks that turn the direction of what follows: a file name could read backwards.
_DIRECTION = frozenset(chr(c) for c in (*range(0x202A, 0x202F), *range(0x2066, 0x206A), 0x200E, 0x200F, 0xFEFF))
_ODD = re.compile(r"[^\n -~\u00a0-\u00ff\u0370-\u03ff\u2010-\u2027\u3000-\u303f\u4e00-\u9fff\uff00-\uffef]")
# What a line may break after although no blank stands there.
_JOINTS = "_-/.,;:=)"


def _kept(found: re.Match[str]) -> str:
    c = found.group()
    if c in "\t\r\v\f\u2028\u2029\x85":
        return " "
    return "" if unicodedata.category(c) in _HIDDEN or c in _DIRECTION else c


def clean(text: str, limit: int = TEXT_LENGTH) -> str:
    """Text that any writer can show: line ends kept, control and direction characters gone, cut to `limit` characters."""
    out = _ODD.sub(_kept, str(text)[: 2 * limit].replace("\r\n", "\n"))
    return out if len(out) <= limit else out[: limit - 1] + "…"


def one_line(text: str, limit: int = HEAD_LENGTH) -> str:
    """The same on one line."""
    return clean(re.sub(r"[ \n]+", " ", clean(text, 4 * limit)).strip(" "), limit)


def _weight(c: str) -> float:
    """Width of a Latin letter over the mean width of letters, rounded up."""
    if c in "MW@%mw—":
        return 1.8
    return 1.35 if c.isupper() or c in "&#<>=+~" else 1.0


def breakable(text: str, room: int) -> str:
    """Text whose words of Latin letters are never wider than `room` mean letters: a zero-width space where they may break.

    Words that fit stay as they are, so a number is found again by its digits.
    """
    room = max(room, 4)

    def part(found: re.Match[str]) -> str:
        word = found.group()
        left = sum(map(_weight, word))
        if left <= room:
            return word
        out, since = [], 0.0
        for c, after in zip(word, [*word[1:], ""], strict=True):
            out.append(c)
            since += _weight(c)
            left -= _weight(c)
            full = since + _weight(after or "i") > room
            if after and (full or (c in _JOINTS and since >= room / 2 and left + since > room)):
                out.append("\u200b")
                since = 0.0
        return "".join(out)

    return re.sub(rf"[!-~\u00a1-\u2e7f]{{{max(2, int(room / 1.8))},}}", part, text)


def shown(cell: Cell) -> str:
    """A cell as text."""
    return cell.text if isinstance(cell, Figure) else clean(cell)


def columns(table: Table) -> int:
    """Number of columns: of the head, else of the longest row."""
    return max((len(table.head), *(len(row) for row in table.rows)), default=1) or 1


@dataclass(frozen=True, kw_only=True)
class Placed:
    """One cell where it stands; it covers `down` rows and `across` columns."""

    row: int
    column: int
    down: int
    across: int
    text: str
    number: bool


def placed(table: Table) -> Iterator[Placed]:
    """Every cell that is drawn, row by row. The last cell of a short row takes the rest of the row.

    With `merge`, a text that equals the one above it joins it where all columns before it do; a column named in `merge_like`
    joins wherever its model does.
    """
    width, rows = columns(table), len(table.rows)
    joined = _joined(table, width) if table.merge else [[False] * width] * rows
    for i, row in enumerate(table.rows):
        for j, cell in enumerate(row[:width]):
            if joined[i][j]:
                continue
            down = 1
            while i + down < rows and joined[i + down][j]:
                down += 1
            across = width - j if j == len(row) - 1 else 1
            yield Placed(row=i, column=j, down=down, across=across, text=shown(cell), number=isinstance(cell, Figure))


def _joined(table: Table, width: int) -> list[list[bool]]:
    """Whether a cell is part of the one above it."""
    out = [[False] * width for _ in table.rows]
    for i in range(1, len(table.rows)):
        above, row = table.rows[i - 1], table.rows[i]
        if len(above) != width or len(row) != width:
            continue
        for j in range(width):
            if isinstance(row[j], Figure) or row[j] != above[j]:
                break
            out[i][j] = True
        for j, model in table.merge_like.items():
            out[i][j] = out[i][model]
    return out


def shares(table: Table) -> list[float]:
    """Widths of the columns; their sum is 1."""
    width = columns(table)
    given = [float(w) for w in table.widths if w > 0.0]
    if len(given) != width:
        given = [1.0] * width
    return [w / sum(given) for w in given]


def alignment(table: Table) -> list[str]:
    """left, center or right for each column."""
    word = {"l": "left", "c": "center", "r": "right"}
    return [word.get(table.align[j : j + 1], "left") for j in range(columns(table))]


def kept_together(table: Table) -> list[tuple[int, int]]:
    """Rows that no page break may part, as (first, number): all of a short table, else the first and the last two.

    So no table begins or ends with one row alone on a page. A row too long to be kept whole is kept with none.
    """
    rows, letters = len(table.rows), _LETTERS_SMALL if table.small else _LETTERS
    lines, widths = [0.0] * rows, shares(table)
    for cell in placed(table):
        room = letters * sum(widths[cell.column : cell.column + cell.across])
        lines[cell.row] = max(lines[cell.row], cell.text.count("\n") + max(1.0, 1.8 * len(cell.text) / room))
    if rows < 2 or sum(lines[-2:]) > _KEPT_LINES:
        return []
    if rows <= _SHORT_TABLE and sum(lines) <= _KEPT_LINES:
        return [(0, rows)]
    return [(0, 2), (rows - 2, 2)] if rows > 3 and sum(lines[:2]) <= _KEPT_LINES else [(rows - 2, 2)]
