"""Tables of a DOCX as XML text, parsed at once: made cell by cell with python-docx, 3000 rows take 20 s. No document in here."""

from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import escape

from docx.oxml import parse_xml
from docx.oxml.ns import nsdecls

BODY = ("Times New Roman", "宋体")  # Latin and Chinese face
HEAD = ("Arial", "黑体")
RULE = "8A93A0"
_SHADE = "EEF1F5"
_TWIPS_PER_MM = 1440.0 / 25.4


def table_element(widths_mm: Sequence[float], rows: Sequence[str], centred: bool = False) -> Any:
    """A w:tbl of fixed widths; `centred`: without rules, as on the cover."""
    sides = ("top", "left", "bottom", "right", "insideH", "insideV")
    borders = "".join(f'<w:{side} w:val="single" w:sz="4" w:space="0" w:color="{RULE}"/>' for side in sides)
    form = '<w:jc w:val="center"/>' if centred else f"<w:tblBorders>{borders}</w:tblBorders>"
    grid = "".join(f'<w:gridCol w:w="{_twips(width)}"/>' for width in widths_mm)
    return parse_xml(
        f"<w:tbl {nsdecls('w')}><w:tblPr>"
        f'<w:tblW w:w="{_twips(sum(widths_mm))}" w:type="dxa"/>{form}<w:tblLayout w:type="fixed"/>'
        f"</w:tblPr><w:tblGrid>{grid}</w:tblGrid>{''.join(rows)}</w:tbl>"
    )


def _twips(width_mm: float) -> int:
    return round(width_mm * _TWIPS_PER_MM)


def row_xml(cells: Sequence[str], head_row: bool = False) -> str:
    form = "<w:trPr><w:cantSplit/><w:tblHeader/></w:trPr>" if head_row else ""
    return f"<w:tr>{form}{''.join(cells)}</w:tr>"


def cell_xml(
    text: str,
    width_mm: float,
    *,
    size: float,
    faces: tuple[str, str] = BODY,
    align: str = "left",
    shade: bool = False,
    bold: bool = False,
    across: int = 1,
    join: str = "",
    top: bool = False,
    rule_below: bool = False,
    keep: bool = False,
) -> str:
    """One w:tc with one paragraph, as XML; line ends become breaks. `text` is clean and is escaped here.

    `keep`: on one page with the row below.
    """
    form = [f'<w:tcW w:w="{_twips(width_mm)}" w:type="dxa"/>']
    if across > 1:
        form.append(f'<w:gridSpan w:val="{across}"/>')
    if join:
        form.append(f'<w:vMerge w:val="{join}"/>')
    if rule_below:
        rule = f'<w:bottom w:val="single" w:sz="4" w:space="0" w:color="{RULE}"/>'
        form.append(f"<w:tcBorders>{rule}</w:tcBorders>")
    if shade:
        form.append(f'<w:shd w:val="clear" w:color="auto" w:fill="{_SHADE}"/>')
    form.append(f'<w:vAlign w:val="{"top" if top else "center"}"/>')
    placing = (
        "<w:keepNext/>" if keep else ""
    ) + '<w:spacing w:before="20" w:after="20" w:line="240" w:lineRule="auto"/>'
    placing += "" if align == "left" else f'<w:jc w:val="{align}"/>'
    latin, chinese = faces
    look = f'<w:rFonts w:ascii="{latin}" w:hAnsi="{latin}" w:cs="{latin}" w:eastAsia="{chinese}"/>'
    look += ("<w:b/>" if bold else "") + f'<w:sz w:val="{round(2 * size)}"/>'
    words = "<w:br/>".join(f'<w:t xml:space="preserve">{escape(part)}</w:t>' for part in text.split("\n"))
    return (
        f"<w:tc><w:tcPr>{''.join(form)}</w:tcPr><w:p><w:pPr>{placing}</w:pPr>"
        f"<w:r><w:rPr>{look}</w:rPr>{words}</w:r></w:p></w:tc>"
    )
