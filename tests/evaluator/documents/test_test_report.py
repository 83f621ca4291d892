"""The test report: every figure is that of results.json, in PDF and DOCX; it is complete whatever a campaign measured."""

import io
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import docx
import pypdfium2
import pytest

from evaluator.c10_1_grading import GRADE_ZH, INDICATORS
from evaluator.documents.docx import docx_bytes
from evaluator.documents.instruments import instrument_table
from evaluator.documents.model import LANGUAGES, Document, Figure, Language, Table, say
from evaluator.documents.pdf import pdf_bytes
from evaluator.documents.phrases import day_in_words, time_in_words, translated
from evaluator.documents.test_report import build_test_report
from evaluator.model import CampaignData
from evaluator.results import Evaluation, build_results
from evaluator.results_model import IndicatorValue


def at(results: Any, source: str) -> Any:
    """What stands at a path of results.json, found without the code under test."""
    for key in source.split("."):
        results = results[int(key)] if isinstance(results, list) else results[key]
    return results


def figures(document: Document) -> Iterator[tuple[Table, int, int, Figure]]:
    """Every figure of the document's tables that names its source."""
    for block in document.blocks:
        if isinstance(block, Table):
            for i, row in enumerate(block.rows):
                for j, cell in enumerate(row):
                    if isinstance(cell, Figure) and cell.source:
                        yield block, i, j, cell


def read_back(text: str) -> float:
    """The number at the beginning of a printed cell."""
    found = re.match(r"[−-]?\d+(\.\d+)?", text)
    assert found, text
    return float(found.group().replace("−", "-"))


def text_of_pdf(document: Document) -> str:
    content = pypdfium2.PdfDocument(pdf_bytes(document))
    text = "".join(page.get_textpage().get_text_range() for page in content)
    content.close()
    return re.sub(r"[\s\u200b\ufffe\x02]", "", text)


def text_of_docx(document: Document) -> str:
    word = docx.Document(io.BytesIO(docx_bytes(document)))
    cells = [c.text for t in word.tables for row in t.rows for c in row.cells]
    return "\n".join([*(p.text for p in word.paragraphs), *cells])


def check_figures(document: Document, results: dict[str, Any]) -> int:
    """Every figure with a source, read back from the DOCX's cell and the PDF's text; how many there were."""
    word = docx.Document(io.BytesIO(docx_bytes(document)))
    tables = iter(word.tables[1 if document.cover else 0 :])
    by_block = {id(b): next(tables) for b in document.blocks if isinstance(b, Table)}
    pdf = text_of_pdf(document)
    rows: dict[int, list[list[str]]] = {}
    count = 0
    for table, i, j, figure in figures(document):
        count += 1
        stands = at(results, figure.source)
        assert figure.value == pytest.approx(stands, rel=1e-12) if stands is not None else figure.value is None
        key = id(table)
        if key not in rows:
            rows[key] = [[c.text for c in row.cells] for row in by_block[key].rows]
        printed = rows[key][i + bool(table.head)][j]
        assert re.sub(r"\s", "", printed) in pdf
        if stands is None:
            assert printed == "–"
            continue
        assert abs(read_back(printed) - stands) <= 0.5000001 * 10.0**-figure.decimals, (figure.source, printed)
    return count


@pytest.mark.parametrize("language", LANGUAGES)
def test_figures_equal_results_json(evaluation: Evaluation, language: Language) -> None:
    """Rationale: what is filed must be what was measured. Expected: each figure with a source, read back from the DOCX's cell, is
    the number at that path of results.json and stands in the PDF's text too; value, standard deviation, both bounds
    and sample size of all measured indicators are among them. Tolerance: half of the last printed digit."""
    results = build_results(evaluation)
    document = build_test_report(evaluation, results, language)
    assert check_figures(document, results) >= 20
    sources = {f.source for _, _, _, f in figures(document)}
    for i, block in results["indicators"].items():
        if block["value"] is not None:
            for key in ("value", "sample_size", "uncertainty.std", "uncertainty.low_95", "uncertainty.high_95"):
                assert f"indicators.{i}.{key}" in sources


def test_a_changed_figure_is_found(evaluation: Evaluation) -> None:
    """Rationale: the check above must be able to fail. Expected: it does when results.json changes afterwards."""
    results = build_results(evaluation)
    document = build_test_report(evaluation, results, "zh")
    results["indicators"]["calibration_error"]["value"] += 0.01
    with pytest.raises(AssertionError):
        check_figures(document, results)


@pytest.mark.parametrize("language", LANGUAGES)
def test_what_was_not_measured_says_why(evaluation: Evaluation, language: Language) -> None:
    """Rationale: a flight alone leaves four indicators open. Expected: table C.3 names all eight, the four as not measured without
    a figure, each with its reason, in the document's language; the group with an unmeasured indicator has no degree."""
    results = build_results(evaluation)
    document = build_test_report(evaluation, results, language)
    table = next(b for b in document.blocks if isinstance(b, Table) and "C.3" in b.caption)
    assert [row[2] for row in table.rows] == [say(language, r.name_zh, r.name_en) for r in INDICATORS.values()]
    for row, i in zip(table.rows, INDICATORS, strict=True):
        absent = results["indicators"][i]["value"] is None
        assert (row[3] == say(language, "未测", "not measured")) is absent
        assert isinstance(row[3], Figure) is not absent
    text = text_of_pdf(document) + text_of_docx(document)
    assert say(language, "本次检测无：bench/chessboard", "no bench/chessboard in this campaign") in text
    starred = [row for row in table.rows if "*" in str(row[1])]
    assert len(starred) == 4
    assert starred[0][6] == say(language, GRADE_ZH["not_measured"], "not measured")
    assert starred[2][6] == say(language, "良", "good")  # the lower of excellent and good


def test_only_a_chessboard(bare_data: CampaignData) -> None:
    """Rationale: a laboratory may bring one bench. Expected: all sections of appendix C, one measured item, seven reasons, and
    "not recorded" where the campaign states no instrument; no figure without a source."""
    found = IndicatorValue(value=0.25, unit="pixel", formula="(19)", clause="9.2", sample_size=24, std=0.01)
    evaluation = Evaluation(
        campaign="bench", synthetic=False, indicators={"camera_reprojection_error": found}, data=bare_data
    )
    results = build_results(evaluation)
    document = build_test_report(evaluation, results, "zh")
    text = text_of_docx(document)
    for heading in ("检测目的", "检测依据", "检测项目", "检测仪器", "检测结果", "附件"):
        assert heading in text
    assert text.count("已测") == 1
    reasons = next(b for b in document.blocks if isinstance(b, Table) and "未测项目" in b.caption)
    assert len(reasons.rows) == 7
    assert all(row[2] for row in reasons.rows)
    instruments = next(b for b in document.blocks if isinstance(b, Table) and "C.2" in b.caption)
    assert {row[2] for row in instruments.rows} >= {"未记录"}
    assert check_figures(document, results) > 4
    assert "仿真" not in text


def test_tables_are_numbered_as_they_come(evaluation: Evaluation) -> None:
    """Rationale: "items not measured" is left out where all are measured. Expected: own tables count 1, 2, 3 without a gap,
    whether it stands (5 or 6 tables) or not (one less), in both languages."""
    everything = {
        i: IndicatorValue(value=0.25, unit=row.unit, formula=row.formula, clause=row.clause, sample_size=20, std=0.01)
        for i, row in INDICATORS.items()
    }
    for case in (evaluation, replace(evaluation, indicators=everything), replace(evaluation, indicators={})):
        for language in LANGUAGES:
            document = build_test_report(case, build_results(case), language)
            captions = [
                b.caption for b in document.blocks if isinstance(b, Table) and not re.search(r"C\.\d", b.caption)
            ]
            numbers = [int(m.group(1)) for c in captions if (m := re.match(r"(?:附表|Table) (\d+)\s", c))]
            assert numbers == list(range(1, len([c for c in captions if c]) + 1))
            assert any("未测项目" in c or "not measured" in c for c in captions) == (case.indicators != everything)
            assert numbers[-1] >= 4


def test_instruments_like_with_like(evaluation: Evaluation) -> None:
    """Rationale: 5.3 asks 1 cm of a point horizontally; two axes of 3 mm are 4.2 mm of a point, and the standard's material has a
    name. Expected: what a simulated campaign states, in both languages, with PTFE, 聚四氟乙烯."""
    assert evaluation.data is not None
    assert evaluation.data.plan is not None
    stated = {
        "reference_panels": "ptfe; flatness better than 5 % by spectrometer",
        "geometric_targets": "control survey 4.2 mm horizontally, 4.0 mm in height (standard deviation of a point)",
    }
    data = replace(evaluation.data, plan=evaluation.data.plan.model_copy(update={"instruments": stated}))
    english, chinese = (instrument_table(replace(evaluation, data=data), language) for language in ("en", "zh"))
    assert english.rows[1][2] == "PTFE; flatness better than 5 % by spectrometer"
    assert english.rows[2][2] == stated["geometric_targets"]
    assert chinese.rows[1][2] == "聚四氟乙烯；光谱仪测定平坦性优于 5 %"
    assert chinese.rows[2][2] == "控制测量点位水平 4.2 mm，高程 4.0 mm（标准差）"


def test_failures_and_warnings_are_listed(evaluation: Evaluation) -> None:
    """Rationale: who reads the report must see what did not conform. Expected: counts by chapter add up to the conformity rows of
    results.json, and each failed or warned row stands in the report with its clause."""
    results = build_results(evaluation)
    results["conformity"][3] = {
        "clause": "7.2 c",
        "requirement": "elevation of the sun",
        "measured": "30.0° to 34.0°",
        "limit": "> 35°",
        "status": "fail",
    }
    document = build_test_report(evaluation, results, "zh")
    counts = next(b for b in document.blocks if isinstance(b, Table) and "条数" in b.caption)
    assert sum(int(str(c)) for row in counts.rows for c in row[1:]) == len(results["conformity"])
    amiss = [r for r in results["conformity"] if r["status"] in ("fail", "warning")]
    table = next(b for b in document.blocks if isinstance(b, Table) and "需注意" in b.caption)
    assert [row[0] for row in table.rows] == [r["clause"] for r in amiss]
    assert ("7.2 c", "太阳高度角", "30.0°～34.0°", "> 35°", "不符合") in table.rows


def test_hostile_campaign(evaluation: Evaluation) -> None:
    """Rationale: names come from a folder that anybody wrote. Expected: markup of typst and of XML in names stands as text."""
    assert evaluation.data is not None and evaluation.data.camera is not None
    hostile = "#panic() </w:t> $x$ *a* \x00\x1b"
    camera = evaluation.data.camera.model_copy(update={"name": hostile, "manufacturer": hostile})
    wrong = replace(evaluation, data=replace(evaluation.data, camera=camera), campaign=hostile)
    document = build_test_report(wrong, build_results(wrong), "zh")
    assert "#panic()</w:t>$x$*a*" in text_of_pdf(document)
    assert "#panic() </w:t> $x$ *a*" in text_of_docx(document)


def test_phrases() -> None:
    """Rationale: conformity rows are written in English; a Chinese report shows them in Chinese. Expected: whole phrases, phrases
    with numbers, parts between semicolons, phrases within phrases; English and unknown text as it was."""
    assert translated("least 5 (R01), 6 panels", "zh") == "最少 5 次（R01），6 个靶标"
    assert translated("no wind in environment.csv", "zh") == "environment.csv 中无风速"
    assert translated("sortie 1: 44 of 44 (a.tif); sortie 2: 43 of 44 (b.tif)", "zh") == (
        "第 1 架次：44/44（a.tif）；第 2 架次：43/44（b.tif）"
    )
    assert translated("something {0} nobody %1 wrote", "zh") == "something {0} nobody %1 wrote"
    assert translated("least 5 (R01), 6 panels", "en") == "least 5 (R01), 6 panels"
    assert day_in_words("2026-06-02", "zh") == "2026年6月2日"
    assert day_in_words("never", "en") == "never"
    assert time_in_words("2026-06-12T02:30:00+00:00", "en") == "12 June 2026, 10:30 Beijing time"


def test_all_conformity_rows_of_a_flight_are_chinese(evaluation: Evaluation) -> None:
    """Rationale: as above. Expected: no requirement of the made-up flight keeps an English word of four letters and more; names of
    systems and files are not words."""
    words = set()
    for row in evaluation.conformity:
        words |= set(re.findall(r"\b[a-z]{4,}\b", translated(row.requirement, "zh")))
    assert words == set()


def test_correlation_is_not_rounded_to_certainty(evaluation: Evaluation) -> None:
    """Rationale: 99.9953 % printed with two decimals reads 100.00 %. Expected: as many decimals as tell it from 100."""
    value = replace(evaluation.indicators["reflectance_correlation"], value=99.99534)
    made = replace(evaluation, indicators={**evaluation.indicators, "reflectance_correlation": value})
    document = build_test_report(made, build_results(made), "zh")
    printed = next(f for *_, f in figures(document) if f.source == "indicators.reflectance_correlation.value")
    assert printed.text == "99.9953 %"
    assert math.isclose(printed.value or 0.0, 99.99534)
