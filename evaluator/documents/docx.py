"""A `Document` as DOCX that a laboratory can edit: real headings, tables with repeated head rows, page number fields.

Tables are built as XML: a cell object of python-docx walks its whole table. The same document gives the same bytes.
"""

import datetime
import io
import zipfile
from pathlib import Path
from typing import Any

import docx
from docx.document import Document as WordDocument
from docx.enum.section import WD_ORIENT
from docx.enum.text import WD_ALIGN_PARAGRAPH, WD_BREAK, WD_TAB_ALIGNMENT
from docx.oxml import OxmlElement
from docx.oxml.ns import qn
from docx.shared import Mm, Pt, RGBColor
from docx.text.paragraph import Paragraph as WordParagraph

from campaign.writing.atomic import complete_file
from evaluator.documents.cells import TITLE_LENGTH, Placed, alignment, clean, kept_together, one_line, placed, shares
from evaluator.documents.docx_table import BODY, HEAD, RULE, cell_xml, row_xml, table_element
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
from evaluator.documents.pdf import document_day, synthetic_notice

_MARGIN_MM = 22.0
_RED = RGBColor(0xA8, 0x23, 0x1B)
_FAINT = RGBColor(0x5B, 0x64, 0x72)
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)


def write_docx(path: Path, document: Document) -> None:
    """Writes the file complete or not at all.

    Raises
    ------
    CampaignError
        The file cannot be written.
    """
    content = docx_bytes(document)
    with complete_file(path) as work:
        work.write_bytes(content)


def docx_bytes(document: Document) -> bytes:
    """The DOCX itself."""
    word = docx.Document()
    _properties(word, document)
    _styles(word, document)
    _page(word, document)
    _cover(word, document)
    for block in document.blocks:
        _block(word, document, block)
    buffer = io.BytesIO()
    word.save(buffer)
    return _same_dates(buffer.getvalue())


def _same_dates(content: bytes) -> bytes:
    """The package with one date for all its parts and without the template's thumbnail picture."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        for item in old.infolist():
            entry = zipfile.ZipInfo(item.filename, _ZIP_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            new.writestr(entry, old.read(item.filename))
    return out.getvalue()


def _properties(word: WordDocument, document: Document) -> None:
    at = datetime.datetime.combine(document_day(document), datetime.time(12))
    core = word.core_properties
    core.title, core.author, core.last_modified_by = one_line(document.title, TITLE_LENGTH), "testrange", "testrange"
    core.subject, core.comments, core.keywords = one_line(document.campaign_id), "", synthetic_notice(document)
    core.language = "zh-CN" if document.language == "zh" else "en-GB"
    core.created = core.modified = core.last_printed = at
    core.revision = 1


def _faces(element: Any, faces: tuple[str, str]) -> None:
    """Latin and Chinese face of a run or a style."""
    properties = element.get_or_add_rPr()
    fonts = properties.get_or_add_rFonts()
    for key in list(fonts.attrib):
        del fonts.attrib[key]
    for key in ("w:ascii", "w:hAnsi", "w:cs"):
        fonts.set(qn(key), faces[0])
    fonts.set(qn("w:eastAsia"), faces[1])


def _styles(word: WordDocument, document: Document) -> None:
    normal = word.styles["Normal"]
    _faces(normal.element, BODY)
    normal.font.size = Pt(10.5)
    normal.paragraph_format.space_after = Pt(4)
    normal.paragraph_format.line_spacing = 1.25 if document.language == "zh" else 1.1
    for level, size in ((1, 15), (2, 12.5), (3, 11)):
        style = word.styles[f"Heading {level}"]
        _faces(style.element, HEAD)
        style.font.size, style.font.bold, style.font.color.rgb = Pt(size), document.language == "en", RGBColor(0, 0, 0)
        style.paragraph_format.space_before, style.paragraph_format.space_after = Pt(14), Pt(6)
    language = OxmlElement("w:lang")
    language.set(qn("w:val"), "en-GB")
    language.set(qn("w:eastAsia"), "zh-CN")
    normal.element.get_or_add_rPr().append(language)


def _page(word: WordDocument, document: Document) -> None:
    """A4, running head with the notice, page number and count as fields."""
    section = word.sections[0]
    wide, high = (297.0, 210.0) if document.landscape else (210.0, 297.0)
    section.orientation = WD_ORIENT.LANDSCAPE if document.landscape else WD_ORIENT.PORTRAIT
    section.page_width, section.page_height = Mm(wide), Mm(high)
    section.left_margin = section.right_margin = Mm(_MARGIN_MM)
    section.top_margin, section.bottom_margin = Mm(26), Mm(22)
    head = section.header.paragraphs[0]
    head.paragraph_format.tab_stops.clear_all()
    head.paragraph_format.tab_stops.add_tab_stop(Mm(wide - 2 * _MARGIN_MM), WD_TAB_ALIGNMENT.RIGHT)
    _run(head, f"{one_line(document.title)}\t{one_line(document.campaign_id)}", 8.5, HEAD, _FAINT)
    if document.synthetic:
        _run(head, f"　{synthetic_notice(document)}", 8.5, HEAD, _RED)
    _bottom_rule(head)
    foot = section.footer.paragraphs[0]
    foot.alignment = WD_ALIGN_PARAGRAPH.CENTER
    before, between, after = say(document.language, "第 |页　共 |页", "Page | of |").split("|")
    _run(foot, before, 8.5, HEAD, _FAINT)
    _field(foot, "PAGE")
    _run(foot, (" " if document.language == "zh" else "") + between, 8.5, HEAD, _FAINT)
    _field(foot, "NUMPAGES")
    _run(foot, (" " if document.language == "zh" else "") + after, 8.5, HEAD, _FAINT)


def _run(
    paragraph: WordParagraph,
    text: str,
    size: float,
    faces: tuple[str, str] = BODY,
    colour: RGBColor | None = None,
    bold: bool = False,
) -> None:
    run = paragraph.add_run(text)
    run.font.size, run.font.bold = Pt(size), bold or None
    _faces(run._element, faces)
    if colour is not None:
        run.font.color.rgb = colour


def _field(paragraph: WordParagraph, instruction: str) -> None:
    """PAGE or NUMPAGES, which Word works out itself."""
    field = OxmlElement("w:fldSimple")
    field.set(qn("w:instr"), instruction)
    run = OxmlElement("w:r")
    properties = OxmlElement("w:rPr")
    size = OxmlElement("w:sz")
    size.set(qn("w:val"), "17")
    properties.append(size)
    run.append(properties)
    run.append(_text("1"))
    field.append(run)
    paragraph._element.append(field)


def _bottom_rule(paragraph: WordParagraph) -> None:
    borders = OxmlElement("w:pBdr")
    line = OxmlElement("w:bottom")
    for key, value in (("val", "single"), ("sz", "4"), ("space", "3"), ("color", RULE)):
        line.set(qn(f"w:{key}"), value)
    borders.append(line)
    paragraph._element.get_or_add_pPr().insert_element_before(
        borders, "w:shd", "w:tabs", "w:spacing", "w:ind", "w:jc", "w:rPr"
    )


def _text(text: str) -> Any:
    element = OxmlElement("w:t")
    element.text = text
    element.set("{http://www.w3.org/XML/1998/namespace}space", "preserve")
    return element


def _cover(word: WordDocument, document: Document) -> None:
    """A title page of its own where the document has one, else the title above the text."""
    alone = bool(document.cover)
    title = word.add_paragraph()
    title.alignment = WD_ALIGN_PARAGRAPH.CENTER
    title.paragraph_format.space_before = Pt((40 if document.landscape else 130) if alone else 0)
    bold = document.language == "en"
    _run(title, one_line(document.title, TITLE_LENGTH), 26 if alone else 18, HEAD, bold=bold)
    if document.subtitle:
        below = word.add_paragraph()
        below.alignment = WD_ALIGN_PARAGRAPH.CENTER
        _run(below, one_line(document.subtitle, TITLE_LENGTH), 13 if alone else 10.5, HEAD, _FAINT)
    if not alone:
        return
    word.add_paragraph().paragraph_format.space_after = Pt(30 if document.landscape else 110)
    colon = say(document.language, "：", ":")
    rows = [
        row_xml(
            [
                cell_xml(one_line(label) + colon, 45.0, size=12, faces=HEAD, align="right"),
                cell_xml(one_line(value, TITLE_LENGTH), 85.0, size=12, rule_below=True),
            ]
        )
        for label, value in document.cover
    ]
    word.element.body.insert(len(word.element.body) - 1, table_element([45.0, 85.0], rows, centred=True))
    _new_page(word)


def _block(word: WordDocument, document: Document, block: Block) -> None:
    match block:
        case Heading():
            word.add_heading(one_line(block.text, TITLE_LENGTH), min(max(block.level, 1), 3))
        case Paragraph():
            paragraph = word.add_paragraph()
            if not block.note and document.language == "zh":
                _indent_two(paragraph)
            colour = _FAINT if block.note else None
            _run(paragraph, clean(block.text), 9 if block.note else 10.5, BODY, colour)
        case Formula():
            paragraph = word.add_paragraph()
            width = Mm((297.0 if document.landscape else 210.0) - 2 * _MARGIN_MM)
            stops = paragraph.paragraph_format.tab_stops
            stops.add_tab_stop(width // 2, WD_TAB_ALIGNMENT.CENTER)
            stops.add_tab_stop(width, WD_TAB_ALIGNMENT.RIGHT)
            _run(paragraph, f"\t{clean(block.text)}\t{one_line(block.number)}", 10.5, ("Cambria Math", "宋体"))
        case Table():
            _table(word, document, block)
        case Picture():
            paragraph = word.add_paragraph()
            paragraph.alignment = WD_ALIGN_PARAGRAPH.CENTER
            room = (297.0 if document.landscape else 210.0) - 2 * _MARGIN_MM
            paragraph.add_run().add_picture(io.BytesIO(block.png), width=Mm(min(block.width_mm, room)))
            if block.caption:
                paragraph.paragraph_format.keep_with_next = True
                _caption(word, block.caption, above=False)
        case Signatures():
            _signatures(word, document, block)
        case PageBreak():
            _new_page(word)


def _new_page(word: WordDocument) -> None:
    word.add_paragraph().add_run().add_break(WD_BREAK.PAGE)


def _indent_two(paragraph: WordParagraph) -> None:
    """First line in by two Chinese characters."""
    indent = OxmlElement("w:ind")
    indent.set(qn("w:firstLineChars"), "200")
    indent.set(qn("w:firstLine"), "420")
    paragraph._element.get_or_add_pPr().append(indent)


def _caption(word: WordDocument, text: str, above: bool = True) -> None:
    paragraph = word.add_paragraph()
    paragraph.alignment = WD_ALIGN_PARAGRAPH.CENTER
    paragraph.paragraph_format.keep_with_next = above
    paragraph.paragraph_format.space_before = Pt(8 if above else 2)
    _run(paragraph, clean(text), 9.5, HEAD)


def _signatures(word: WordDocument, document: Document, block: Signatures) -> None:
    colon, date = say(document.language, "：", ":"), say(document.language, "日期", "Date")
    line = say(document.language, "＿＿＿＿年＿＿月＿＿日", "________________")
    for role in block.roles:
        paragraph = word.add_paragraph()
        paragraph.paragraph_format.space_before = Pt(14)
        paragraph.paragraph_format.tab_stops.add_tab_stop(Mm(85))
        _run(paragraph, f"{one_line(role)}{colon}____________________\t{date}{colon}{line}", 10.5)


def _table(word: WordDocument, document: Document, block: Table) -> None:
    """Rows as XML; a merged cell starts with `restart` and continues below."""
    room = (297.0 if document.landscape else 210.0) - 2 * _MARGIN_MM
    widths = [share * room for share in shares(block)]
    aligned = alignment(block)
    size = 7.5 if block.small else 9.5
    count = len(widths)
    if block.caption:
        _caption(word, block.caption)
    lines: list[str] = []
    if block.head:
        bold = document.language == "en"
        head = [*block.head, *[""] * (count - len(block.head))]
        cells = [
            cell_xml(clean(text), widths[j], size=size, faces=HEAD, align="center", shade=True, bold=bold)
            for j, text in enumerate(head)
        ]
        lines.append(row_xml(cells, head_row=True))
    starts: dict[tuple[int, int], Placed] = {(c.row, c.column): c for c in placed(block)}
    covered: dict[int, tuple[int, int]] = {}  # column -> rows still joined, columns across
    kept = {i for first, number in kept_together(block) for i in range(first, first + number - 1)}
    for i in range(len(block.rows)):
        cells = []
        j = 0
        while j < count:
            cell = starts.get((i, j))
            left, across = covered.get(j, (0, 1))
            if cell is None:
                across = across if left else 1
                join = "continue" if left else ""
                cells.append(
                    cell_xml("", sum(widths[j : j + across]), size=size, across=across, join=join, keep=i in kept)
                )
                covered[j] = (max(left - 1, 0), across)
                j += across
                continue
            label = block.fields and j % 2 == 0
            cells.append(
                cell_xml(
                    cell.text,
                    sum(widths[j : j + cell.across]),
                    size=size,
                    faces=HEAD if label else BODY,
                    align="center" if label else "left" if cell.across > 1 else aligned[j],
                    shade=label,
                    across=cell.across,
                    join="restart" if cell.down > 1 else "",
                    top=block.small and not label,
                    keep=i in kept,
                )
            )
            covered[j] = (cell.down - 1, cell.across)
            j += cell.across
        lines.append(row_xml(cells))
    word.element.body.insert(len(word.element.body) - 1, table_element(widths, lines))
    gap = word.add_paragraph()
    gap.paragraph_format.space_after = Pt(2)
    gap.paragraph_format.line_spacing = Pt(8)
