"""The PDF writer: what it prints, on every page, within the page, the same bytes twice, and no text taken for markup."""

import re
from dataclasses import replace
from pathlib import Path

import pypdfium2
import pypdfium2.raw
import pytest
from fontTools.ttLib import TTFont

from evaluator.documents.cells import breakable, clean, placed
from evaluator.documents.model import (
    Document,
    Figure,
    Formula,
    Heading,
    Language,
    PageBreak,
    Paragraph,
    Signatures,
    Table,
    say,
)
from evaluator.documents.pdf import pdf_bytes, write_pdf

HOSTILE = (
    '#import "/etc/passwd" *bold* _x_ $a$ @ref <label> \\ [#panic()] `raw` #(1+1) // gone /* gone */ '
    "</w:t><w:br/> &amp; ]]> {{x}} %s"
)
CONTROL = "a\x00b\x07c\x1bd\u202ee\ufefff\ud800g\x85h\ufffe"


def pages_text(content: bytes) -> list[str]:
    """Text of each page without blanks and line ends, so that a wrapped line reads as one."""
    out = []
    document = pypdfium2.PdfDocument(content)
    for page in document:
        text = page.get_textpage().get_text_range()
        out.append(re.sub(r"[\s\u200b\ufffe\u00ad\x02]", "", text))
    document.close()
    return out


def outside(content: bytes, margin_pt: float) -> list[str]:
    """Characters whose box leaves the page less the margin."""
    out = []
    document = pypdfium2.PdfDocument(content)
    for number, page in enumerate(document, 1):
        width = page.get_width()
        height = page.get_height()
        text = page.get_textpage()
        for k in range(text.count_chars()):
            left, bottom, right, top = text.get_charbox(k)
            if right - left < 0.01 or not text.get_text_range(k, 1).strip():  # a blank may hang over the end of a line
                continue
            if left < margin_pt - 1.0 or right > width - margin_pt + 1.0 or bottom < 20.0 or top > height - 20.0:
                out.append(f"page {number}: {text.get_text_range(k, 1)!r} at {left:.0f}..{right:.0f}")
    document.close()
    return out


def document(language: Language = "zh", **changes: object) -> Document:
    """A little of everything."""
    made = Document(
        name=f"made_{language}",
        title=say(language, "检测报告", "Test report"),
        language=language,
        campaign_id="hand-made",
        date="2026-06-12",
        synthetic=True,
        blocks=[
            Heading(text=say(language, "1　目的", "1  Purpose")),
            Paragraph(text=say(language, "对系统的一致性进行检测，共20个靶标。", "To test the system; it’s “here”.")),
            Formula(text="m_f = √( Σ (Rᵢ − R̂ᵢ)² / n )", number="(2)"),
            Table(
                head=("a", "b", "c"),
                rows=[("x", "one", Figure(value=-1.25, decimals=2, unit="%")), ("x", "two", Figure(value=None))],
                merge=True,
            ),
            Table(rows=[("温度", "20 ℃", "风速", "4 m/s"), ("附注", "long")], fields=True),
            Signatures(roles=["记录员", "检查员"]),
        ],
    )
    return replace(made, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("language", ["zh", "en"])
def test_every_page_says_what_it_is(language: Language) -> None:
    """Rationale: a page of a filed report may lie alone on a desk. Expected: on each of the pages, cover included, the title, the
    campaign, the synthetic notice, and its own number with the count of pages. Tolerance: none."""
    made = document(language, cover=[("编号", "R-1"), ("委托单位", "")])
    made = replace(made, blocks=[*made.blocks, PageBreak(), *made.blocks, PageBreak(), Paragraph(text="end")])
    pages = pages_text(pdf_bytes(made))
    assert len(pages) == 4
    for number, text in enumerate(pages, 1):
        assert say(language, "检测报告", "Testreport") in text
        assert "hand-made" in text
        assert say(language, "虚拟检测场仿真数据", "syntheticdataofavirtualrange") in text
        assert say(language, f"第{number}页共4页", f"Page{number}of4") in text


def test_a_flown_campaign_has_no_notice() -> None:
    """Rationale: the notice must mean something. Expected: none of its words on any page of a campaign that was flown."""
    assert "仿真" not in "".join(pages_text(pdf_bytes(document(synthetic=False))))


def test_long_lists_repeat_their_head_and_stay_on_the_page() -> None:
    """Rationale: A.1 lists thousands of point numbers. Expected: every number printed once, in order; the head row on every page
    of the table; no character outside the margins. Tolerance: 1 pt, side bearings."""
    numbers = [f"P{k}" for k in range(10_000, 15_000)]
    rows = [(f"F{k:02d}", ", ".join(numbers[500 * k : 500 * k + 500])) for k in range(10)]
    content = pdf_bytes(document(blocks=[Table(head=("靶标", "点号"), rows=rows, widths=(1, 8), small=True)]))
    pages = pages_text(content)
    assert len(pages) > 3
    assert all("靶标点号" in text for text in pages)
    assert re.findall(r"P1\d{4}", "".join(pages)) == numbers
    assert outside(content, 22 / 25.4 * 72) == []


def test_text_is_never_markup() -> None:
    """Rationale: names and purposes come from a campaign folder that anybody wrote. Expected: the text as it is, in the PDF, in
    title, head row, cell, form, caption and paragraph; nothing carried out. Tolerance: none."""
    hostile = Table(head=(HOSTILE, "b"), rows=[(HOSTILE, HOSTILE)], caption=HOSTILE)
    form = Table(rows=[(HOSTILE, HOSTILE)], fields=True)
    made = document(
        title=HOSTILE,
        campaign_id=HOSTILE,
        subtitle=HOSTILE,
        cover=[(HOSTILE, HOSTILE)],
        blocks=[Heading(text=HOSTILE), Paragraph(text=HOSTILE), Paragraph(text=HOSTILE, note=True), hostile, form],
    )
    content = pdf_bytes(made)
    text = "".join(pages_text(content))
    assert text.count(re.sub(r"\s", "", HOSTILE)) >= 6
    assert outside(content, 22 / 25.4 * 72) == []


def test_ten_thousand_letters_and_control_characters() -> None:
    """Rationale: a title of 10 000 characters, a word without a blank and control characters must not break a page or a file.
    Expected: a PDF of few pages, nothing outside the margins, the head row's title cut, hidden characters gone."""
    long = "W" * 10_000
    made = document(
        title=long,
        campaign_id=long,
        cover=[(long, long)],
        blocks=[
            Paragraph(text=CONTROL + "末"),
            Table(head=("a", "b", "c"), rows=[("x", long[:900], "y")], widths=(1, 1, 8)),
        ],
    )
    content = pdf_bytes(made)
    pages = pages_text(content)
    assert len(pages) < 12
    assert outside(content, 22 / 25.4 * 72) == []
    assert "abcdefgh末" in "".join(pages)
    assert clean(CONTROL) == "abcdefg h"


def test_same_document_same_bytes(tmp_path: Path) -> None:
    """Rationale: a filed report can be made again and compared. Expected: identical bytes, and another day gives others."""
    a, b = tmp_path / "a.pdf", tmp_path / "b.pdf"
    write_pdf(a, document())
    write_pdf(b, document())
    assert a.read_bytes() == b.read_bytes()
    assert b"D:20260612" in a.read_bytes()
    write_pdf(b, document(date="not a date"))
    assert b"D:19800106" in b.read_bytes()


def test_no_missing_glyph() -> None:
    """Rationale: a machine without Chinese fonts must show every character. Expected: all that documents print beyond ASCII stands
    in the packaged serif font, but for indices and combining marks, which typst's own fonts hold (looked at)."""
    import pylopdf_fonts_zh_cn

    from evaluator.documents.phrase_table import PHRASES

    sources = sorted(Path(__file__).parents[3].joinpath("evaluator", "documents").glob("*.py"))
    with TTFont(str(pylopdf_fonts_zh_cn.serif_path()), lazy=True) as font:
        known = set(font.getBestCmap())
    text = PHRASES + "".join(p.read_text() for p in sources if not p.name.startswith(("handbooks", "cells")))
    absent = {c for c in text if ord(c) > 127 and ord(c) not in known}
    assert absent <= set("ᵢ̂₀₁₂₃⁻\u200b"), absent


def test_merged_cells_and_short_rows() -> None:
    """Rationale: table C.3 joins its first columns; forms end in a cell that takes the rest of the row. Expected: joined only
    where all columns before are, never two figures; `merge_like` follows its column; a short row's last cell fills it."""
    rows = [("A", "x", Figure(value=1.0), "u"), ("A", "x", Figure(value=1.0), "v"), ("B", "x", "same", "w"), ("only",)]
    made = list(placed(Table(rows=rows, merge=True, merge_like={3: 1})))
    where = {(c.row, c.column): (c.down, c.across) for c in made}
    assert where[0, 0] == (2, 1)
    assert where[0, 1] == (2, 1)
    assert where[0, 2] == (1, 1)
    assert where[1, 2] == (1, 1)
    assert where[0, 3] == (2, 1)
    assert where[2, 1] == (1, 1)
    assert where[3, 0] == (1, 4)
    assert (1, 0) not in where


def test_numbers_are_never_broken_apart() -> None:
    """Rationale: a reader searches a number in the PDF. Expected: what fits its column is left as it is; a longer word is cut after
    at most `room` letters and is the same without the marks. Tolerance: none."""
    assert breakable("0.123456 (500.12, 20.30)", 9) == "0.123456 (500.12, 20.30)"
    cut = breakable("bench/sphere_stability/log.csv", 10)
    assert cut.replace("\u200b", "") == "bench/sphere_stability/log.csv"
    assert max(len(part) for part in cut.split("\u200b")) <= 10


@pytest.mark.parametrize("small", [False, True])
def test_no_row_alone_on_the_next_page(small: bool) -> None:
    """Rationale: a long table's last row alone under a repeated head reads as a table of its own. Expected: whatever the number of
    rows, a page that shows rows shows two or more; a table of eight rows is never parted. Tolerance: none."""
    first = 44 if small else 28
    for count, before in [
        *((n, 1) for n in range(first, first + 16)),
        *((n, b) for n in (2, 8) for b in range(22, 34, 2)),
    ]:
        rows = [(f"row{k:03d}", Figure(value=k)) for k in range(count)]
        table = Table(rows=rows, head=("Name", "Value"), caption="Table 1", small=small)
        document = Document(
            name="t", title="T", language="en", campaign_id="c", date="2026-06-01", synthetic=False,
            blocks=[*(Paragraph(text="words"),) * before, table],
        )  # fmt: skip
        shown = [len(re.findall(r"row\d{3}", page)) for page in pages_text(pdf_bytes(document))]
        assert sum(shown) == count
        assert 1 not in shown
        assert count > 8 or max(shown) == count


def test_subscripts_of_formula_22() -> None:
    """Rationale: X_L is printed with an index, as in the standard. Expected: no underscore is left of any symbol of (22)."""
    document = Document(
        name="t", title="T", language="en", campaign_id="c", date="2026-06-01", synthetic=False,
        blocks=[Formula(text="[X Y Z]ᵀ = R_LC [X_L Y_L Z_L]ᵀ + t", number="(22)"),
                Paragraph(text="p_C = R_CB R_BW(t_e) R_WB(t_s) R_BL p_L")],
    )  # fmt: skip
    text = "".join(pages_text(pdf_bytes(document)))
    assert "_" not in text
    assert "[XLYLZL]" in text
    assert "pC=RCBRBW(te)RWB(ts)RBLpL" in text
