"""The DOCX writer: what Word finds in it, the same bytes twice, and text that cannot break the XML."""

import io
import time
import zipfile
from dataclasses import replace

import docx
import pytest
from docx.oxml.ns import qn

from evaluator.documents.docx import docx_bytes
from evaluator.documents.model import Document, Figure, Heading, Language, Paragraph, Signatures, Table, say

HOSTILE = "</w:t><w:br/> &amp; ]]> <!-- \x00\x07\x1b\ud800 {{x}} #import"


def document(language: Language = "zh", **changes: object) -> Document:
    """Heading, text, a merged table with a head, a form."""
    made = Document(
        name="made",
        title=say(language, "检测报告", "Test report"),
        language=language,
        campaign_id="hand-made",
        date="2026-06-12",
        synthetic=True,
        cover=[("编号", "R-1")],
        blocks=[
            Heading(text="1　目的"),
            Paragraph(text="对系统进行检测。"),
            Table(
                caption="表 C.3",
                head=("内容", "项目", "结果"),
                rows=[("辐射", "a", Figure(value=-1.25, decimals=2, unit="%")), ("辐射", "b", Figure(value=None))],
                merge=True,
            ),
            Table(rows=[("温度", "20 ℃", "风速", "4 m/s"), ("附注", "long\nlines")], fields=True),
            Signatures(roles=["记录员"]),
        ],
    )
    return replace(made, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("language", ["zh", "en"])
def test_what_word_finds(language: Language) -> None:
    """Rationale: the laboratory edits this file. Expected: a real heading, a head row that Word repeats, joined cells, a running
    head with notice, page and page count as fields, Chinese faces on every run of text. Tolerance: none."""
    word = docx.Document(io.BytesIO(docx_bytes(document(language))))
    assert [p.text for p in word.paragraphs if p.style.name == "Heading 1"] == ["1　目的"]
    table = word.tables[1]  # the first is the cover's
    assert table.rows[0]._tr.trPr.find(qn("w:tblHeader")) is not None
    assert [c.text for c in table.rows[1].cells] == ["辐射", "a", "−1.25 %"]
    assert table.cell(1, 0)._tc is table.cell(2, 0)._tc  # joined
    assert table.cell(2, 2).text == "–"
    assert word.tables[2].cell(1, 1)._tc is word.tables[2].cell(1, 3)._tc
    assert word.tables[2].cell(1, 1).text == "long\nlines"
    head = word.sections[0].header.paragraphs[0].text
    assert "hand-made" in head
    assert say(language, "虚拟检测场仿真数据", "synthetic data of a virtual range") in head
    fields = {f.get(qn("w:instr")) for f in word.sections[0].footer._element.iter(qn("w:fldSimple"))}
    assert fields == {"PAGE", "NUMPAGES"}
    faces = {r.get(qn("w:eastAsia")) for r in word.element.body.iter(qn("w:rFonts"))}
    assert faces == {"宋体", "黑体"}
    assert abs(word.sections[0].page_width.mm - 210) < 0.1


def test_same_document_same_bytes() -> None:
    """Rationale: as for the PDF. Expected: identical bytes; no part carries the time of writing."""
    content = docx_bytes(document())
    time.sleep(0.01)
    assert content == docx_bytes(document())
    with zipfile.ZipFile(io.BytesIO(content)) as package:
        assert {i.date_time for i in package.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert b"2026-06-12T12:00:00Z" in package.read("docProps/core.xml")


def test_hostile_text() -> None:
    """Rationale: names come from a campaign folder that anybody wrote; control characters are not allowed in XML. Expected: the
    package opens, the text stands in it as text, without what XML cannot hold."""
    made = document(
        title=HOSTILE,
        campaign_id=HOSTILE,
        subtitle="x" * 10_000,
        cover=[(HOSTILE, HOSTILE)],
        blocks=[
            Heading(text=HOSTILE),
            Paragraph(text=HOSTILE),
            Table(head=(HOSTILE,), rows=[(HOSTILE,)], caption=HOSTILE),
        ],
    )
    word = docx.Document(io.BytesIO(docx_bytes(made)))
    text = "</w:t><w:br/> &amp; ]]> <!--  {{x}} #import"
    assert word.tables[1].cell(1, 0).text == text
    assert text in [p.text for p in word.paragraphs]


def test_long_tables_are_quick() -> None:
    """Rationale: python-docx's cells walk their table, which takes minutes for a list of points. Expected: 3000 rows of 6 cells in
    the file. Tolerance: 10 s of processor time, ten times what it takes."""
    rows = [tuple(f"{k}.{j}" for j in range(6)) for k in range(3000)]
    start = time.process_time()
    content = docx_bytes(document(blocks=[Table(head=tuple("abcdef"), rows=rows, small=True)]))
    assert time.process_time() - start < 10.0
    with zipfile.ZipFile(io.BytesIO(content)) as package:
        xml = package.read("word/document.xml").decode()
    assert xml.count("<w:tr>") + xml.count("<w:tr ") == 3001 + 1  # head row, and the cover's
    assert ">2999.5<" in xml


@pytest.mark.parametrize("landscape", [False, True])
def test_within_the_page_and_in_the_schema_s_order(landscape: bool) -> None:
    """Rationale: Word repairs or refuses a paragraph whose properties stand in another order than ECMA-376 part 1, 17.3.1.26 and
    17.3.2.28, and prints past the edge without a word. Expected: that order everywhere, each table as wide as the text at most,
    rows of a short table kept with the next but the last. Tolerance: a twentieth of a point a column."""
    word = docx.Document(io.BytesIO(docx_bytes(document(landscape=landscape))))
    section = word.sections[0]
    room = (section.page_width - section.left_margin - section.right_margin) / 635  # EMU in a twentieth of a point
    for table in word.tables:
        columns = [int(c.get(qn("w:w"))) for c in table._tbl.tblGrid]
        assert sum(columns) <= room + len(columns)
    orders = {
        "w:pPr": ["pStyle", "keepNext", "keepLines", "pBdr", "shd", "tabs", "spacing", "ind", "jc", "rPr"],
        "w:rPr": ["rStyle", "rFonts", "b", "i", "color", "w", "sz", "szCs", "u", "shd", "vertAlign", "lang"],
    }
    for root in (word.element.body, section.header._element, section.footer._element):
        for tag, order in orders.items():
            for form in root.iter(qn(tag)):
                at = [order.index(child.tag.rpartition("}")[2]) for child in form]
                assert at == sorted(at)
    rows = word.tables[1]._tbl.tr_lst[1:]  # below the head
    kept = [len(row.findall(f".//{qn('w:keepNext')}")) for row in rows]
    assert kept == [3, 0]
