"""A `Document` as PDF, by typst with the packaged Chinese fonts. The pages' form is document.typ; what they say is not known here.

All text is handed over as data, so none of it can be taken for markup. The same document gives the same bytes.
"""

import datetime
import json
from functools import cache
from pathlib import Path
from typing import Any

import pylopdf_fonts_zh_cn
import typst

from campaign.writing.atomic import complete_file
from evaluator.documents.cells import (
    TITLE_LENGTH,
    alignment,
    breakable,
    clean,
    columns,
    kept_together,
    one_line,
    placed,
    shares,
)
from evaluator.documents.model import (
    Block,
    Document,
    Formula,
    Heading,
    PageBreak,
    Paragraph,
    Picture,
    Signatures,
    Table,
    say,
)
from evaluator.model import EvaluationError

_TEMPLATE = Path(__file__).with_name("document.typ")
_TEXT_WIDTH_MM = {False: 166.0, True: 253.0}  # of A4 upright and on its side, less the margins
_EM_MM = {False: 3.35, True: 2.65}  # size of a table's letters, usual and small
_WHOLE_LINES = 20  # a row of fewer, of the widest letters, is kept on one page
_LETTER_EM = 0.56  # mean width of a Latin letter


@cache
def _fonts() -> typst.Fonts:
    """The packaged fonts and those inside typst; none of this machine's."""
    folders = {str(Path(p).parent) for p in (pylopdf_fonts_zh_cn.sans_path(), pylopdf_fonts_zh_cn.serif_path())}
    return typst.Fonts(include_system_fonts=False, include_embedded_fonts=True, font_paths=sorted(folders))


def document_day(document: Document) -> datetime.date:
    """The campaign's day, for the file's properties; the first day of GPS time where it states none that can be read."""
    try:
        return datetime.date.fromisoformat(document.date[:10])
    except ValueError:
        return datetime.date(1980, 1, 6)


def synthetic_notice(document: Document) -> str:
    """What stands on every page of a simulated campaign; empty for a flown one."""
    return (
        say(document.language, "虚拟检测场仿真数据", "synthetic data of a virtual range") if document.synthetic else ""
    )


def write_pdf(path: Path, document: Document) -> None:
    """Writes the file complete or not at all.

    Raises
    ------
    EvaluationError
        The document cannot be set; the reason is typst's.
    CampaignError
        The file cannot be written.
    """
    content = pdf_bytes(document)
    with complete_file(path) as work:
        work.write_bytes(content)


def pdf_bytes(document: Document) -> bytes:
    """The PDF itself."""
    day = document_day(document)
    noon = datetime.datetime.combine(day, datetime.time(12), tzinfo=datetime.UTC)
    try:
        compiler = typst.Compiler(
            _TEMPLATE.read_bytes(), font_paths=_fonts(), sys_inputs={"document": json.dumps(_content(document, day))}
        )
        made = compiler.compile(format="pdf", timestamp=noon)
    except typst.TypstError as error:
        raise EvaluationError(f"cannot be set: {error.message}", where=document.name) from None
    if not isinstance(made, bytes):
        raise EvaluationError("typst gave no PDF", where=document.name)
    return made


def _content(document: Document, day: datetime.date) -> dict[str, Any]:
    room_mm = _TEXT_WIDTH_MM[document.landscape]
    return {
        "language": document.language,
        "title": breakable(one_line(document.title, TITLE_LENGTH), 28),
        "subtitle": breakable(one_line(document.subtitle, TITLE_LENGTH), 60),
        "landscape": document.landscape,
        "date": [day.year, day.month, day.day],
        "head": {
            "title": breakable(one_line(document.title), 20),
            "campaign": one_line(document.campaign_id, 28),
            "notice": synthetic_notice(document),
        },
        "words": {
            "colon": say(document.language, "：", ":"),
            "date": say(document.language, "日期", "Date"),
        },
        "cover": [
            [breakable(one_line(label), 14), breakable(clean(value, TITLE_LENGTH), 36).replace("\n", " ")]
            for label, value in document.cover
        ],
        "blocks": [_block(b, room_mm) for b in document.blocks],
    }


def _block(block: Block, room_mm: float) -> dict[str, Any]:
    """One block as JSON."""
    match block:
        case Heading():
            return {"kind": "heading", "text": breakable(one_line(block.text, TITLE_LENGTH), 40), "level": block.level}
        case Paragraph():
            return {"kind": "paragraph", "text": breakable(clean(block.text), 60), "note": block.note}
        case Formula():
            return {"kind": "formula", "text": clean(block.text), "number": one_line(block.number)}
        case Table():
            return _table(block, room_mm)
        case Picture():
            return {
                "kind": "picture",
                "svg": block.svg.decode(),
                "caption": clean(block.caption),
                "width": block.width_mm,
                "room": room_mm,
            }
        case Signatures():
            return {"kind": "signatures", "roles": [one_line(r) for r in block.roles]}
        case PageBreak():
            return {"kind": "page"}


def _lines(text: str, room: int) -> float:
    """How many lines a cell has at most."""
    return 1.8 * len(text) / max(room, 1) + text.count("\n")


def _table(table: Table, room_mm: float) -> dict[str, Any]:
    widths = shares(table)
    letter_mm = _EM_MM[table.small] * _LETTER_EM
    rooms = [int((w * room_mm - 3.5) / letter_mm) for w in widths]  # letters that a column holds
    cells = list(placed(table))
    long = {c.row for c in cells if _lines(c.text, sum(rooms[c.column : c.column + c.across])) > _WHOLE_LINES}
    head = [breakable(clean(h), rooms[j]) for j, h in enumerate(table.head)]
    return {
        "kind": "table",
        "caption": clean(table.caption),
        "head": head + [""] * (columns(table) - len(head)) if head else [],
        "head-rows": 1 if head else 0,
        "widths": widths,
        "align": alignment(table),
        "fields": table.fields,
        "small": table.small,
        "keep": [{"y": first, "rows": number} for first, number in kept_together(table)],
        "cells": [
            {
                "x": c.column,
                "y": c.row,
                "down": c.down,
                "across": c.across,
                "text": breakable(c.text, sum(rooms[c.column : c.column + c.across])),
                "long": c.row in long,
            }
            for c in cells
        ],
    }
