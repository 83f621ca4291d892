"""What a document is made of, before it becomes PDF or DOCX: plain blocks of finished text in one language.

Builders (one module a document) turn a campaign and its results into a `Document`; writers (`pdf`, `docx`) know nothing of
either. A figure that stands in results.json carries the place where it stands, so that a reader of the finished file can check it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

Language = Literal["zh", "en"]
LANGUAGES: tuple[Language, ...] = ("zh", "en")


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One number as it is printed.

    `source` is its path in results.json ("indicators.calibration_error.value"), empty for what comes from the campaign folder.
    """

    value: float | int | None
    decimals: int = 3
    unit: str = ""
    source: str = ""

    @property
    def text(self) -> str:
        """The number with its unit; an en dash where there is none."""
        if self.value is None:
            return "–"
        number = f"{self.value:z.{self.decimals}f}".replace("-", "−")  # minus sign, none before a zero
        return f"{number} {self.unit}".rstrip()


Cell = str | Figure


@dataclass(frozen=True, kw_only=True)
class Heading:
    """A numbered or plain heading; 1 is the greatest."""

    text: str
    level: int = 1


@dataclass(frozen=True, kw_only=True)
class Paragraph:
    """Running text; `note` is set smaller."""

    text: str
    note: bool = False


@dataclass(frozen=True, kw_only=True)
class Formula:
    """One formula in plain symbols on a line of its own, with the standard's number of it."""

    text: str
    number: str = ""


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table with repeated head row. `fields`: a form without head, labels in the even columns (appendix A)."""

    rows: Sequence[Sequence[Cell]]
    head: Sequence[str] = ()
    caption: str = ""
    widths: Sequence[float] = ()  # shares of the text width; equal where empty
    align: str = ""  # one of l, c, r for each column; left where empty
    fields: bool = False
    small: bool = False  # long lists: pixel coordinates, point numbers
    merge: bool = False  # equal neighbours in the first columns become one cell (table C.3)
    merge_like: Mapping[int, int] = field(default_factory=dict)  # with merge: column -> the column whose joins it takes


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A drawing: SVG for PDF, PNG for DOCX; both of the same figure."""

    svg: bytes
    png: bytes
    caption: str
    width_mm: float = 160.0


@dataclass(frozen=True, kw_only=True)
class Signatures:
    """Lines left open for a hand: role and date."""

    roles: Sequence[str]


@dataclass(frozen=True, kw_only=True)
class PageBreak:
    """The rest begins on a new page."""


Block = Heading | Paragraph | Formula | Table | Picture | Signatures | PageBreak


@dataclass(frozen=True, kw_only=True)
class Document:
    """One document in one language."""

    name: str  # of the file, without suffix: test_report_zh
    title: str
    language: Language
    campaign_id: str
    date: str  # ISO, of the campaign; never of today
    synthetic: bool  # stands on every page
    blocks: Sequence[Block]
    subtitle: str = ""
    landscape: bool = False
    cover: Sequence[tuple[str, str]] = field(default=())  # label, value on a title page of its own


def printed_unit(unit: str) -> str:
    """A unit of results.json as it stands beside a figure."""
    return {"% reflectance": "%", "pixel": "px"}.get(unit, unit)


def say(language: Language, zh: str, en: str) -> str:
    """The one of the two texts."""
    return zh if language == "zh" else en


def figure(results: Mapping[str, Any], source: str, decimals: int = 3, unit: str = "", scale: float = 1.0) -> Figure:
    """A number of results.json by its path; keys and list positions are parted by dots. Absent: a dash.

    Raises
    ------
    TypeError
        What stands there is no number.
    """
    at: Any = results
    for key in source.split("."):
        if isinstance(at, Mapping):
            at = at.get(key)
        elif isinstance(at, list) and key.isdigit() and int(key) < len(at):
            at = at[int(key)]
        else:
            at = None
    if at is not None and (isinstance(at, bool) or not isinstance(at, int | float)):
        raise TypeError(f"{source} holds {type(at).__name__}, a number was expected")
    return Figure(value=None if at is None else at * scale, decimals=decimals, unit=unit, source=source)
