"""All documents of a campaign together: which files there are, that they can be made again, whatever the campaign holds."""

import io
from pathlib import Path

import docx
import pypdfium2

from evaluator.documents import build_documents, write_documents
from evaluator.documents.docx import docx_bytes
from evaluator.documents.model import Document, Figure, Table
from evaluator.documents.pdf import pdf_bytes
from evaluator.model import CampaignData
from evaluator.results import Evaluation, build_results
from evaluator.results_model import IndicatorValue

NAMES = (
    "test_report",
    "flight_plan",
    "observation_radiometric",
    "observation_geometric",
    "calculation_radiometric",
    "calculation_geometric",
)


def sources(documents: list[Document]) -> set[str]:
    """Every place of results.json that the documents print."""
    tables = [block for document in documents for block in document.blocks if isinstance(block, Table)]
    return {c.source for table in tables for row in table.rows for c in row if isinstance(c, Figure) and c.source}


def test_a_flight(evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: one call leaves what a laboratory files. Expected: six documents as PDF and DOCX, the bytes made in memory;
    each names the campaign; no path of this machine; what stood in the folder stays; both languages print the
    same places of results.json, every measured indicator's value among them. Tolerance: none."""
    results = build_results(evaluation)
    (tmp_path / "notes.txt").write_text("mine")
    stages: list[tuple[int, int]] = []
    written = write_documents(tmp_path, evaluation, results, ("zh",), lambda _, done, of: stages.append((done, of)))
    assert [p.name for p in written] == [f"{n}_zh.{s}" for n in NAMES for s in ("pdf", "docx")]
    assert stages[-1] == (6, 6)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    chinese = build_documents(evaluation, results, "zh")
    made = [content for d in chinese for content in (pdf_bytes(d), docx_bytes(d))]
    for path, content in zip(written, made, strict=True):
        assert path.read_bytes() == content, path.name
        assert str(tmp_path).encode() not in content
        if path.suffix == ".pdf":
            pdf = pypdfium2.PdfDocument(content)
            assert evaluation.campaign in pdf[0].get_textpage().get_text_range()
            pdf.close()
        else:
            assert docx.Document(io.BytesIO(content)).core_properties.subject == evaluation.campaign
    measured = {f"indicators.{i}.value" for i, v in evaluation.indicators.items() if v.value is not None}
    assert measured <= sources(chinese)
    assert sources(chinese) == sources(build_documents(evaluation, results, "en"))


def test_a_chessboard_alone(bare_data: CampaignData) -> None:
    """Rationale: a laboratory may bring one bench and no flight. Expected: all six documents, the one figure, no error."""
    found = IndicatorValue(value=0.25, unit="pixel", formula="(19)", clause="9.2", sample_size=24, std=0.01)
    evaluation = Evaluation(
        campaign="bench", synthetic=False, indicators={"camera_reprojection_error": found}, data=bare_data
    )
    documents = build_documents(evaluation, build_results(evaluation), "zh")
    assert [d.name for d in documents] == [f"{n}_zh" for n in NAMES]
    assert all(len(pdf_bytes(d)) > 1000 for d in documents)
    assert "indicators.camera_reprojection_error.value" in sources(documents)
