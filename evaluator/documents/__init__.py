"""10.2, 10.3, appendices A-C: what the laboratory files, as PDF and DOCX, Chinese or English."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from campaign.progress import Report, silent
from evaluator.documents.model import Document, Language

if TYPE_CHECKING:
    from evaluator.results import Evaluation

__all__ = ["build_documents", "write_documents"]


def build_documents(evaluation: "Evaluation", results: Mapping[str, Any], language: Language) -> list[Document]:
    """Test report, flight plan and the four handbooks in one language."""
    from evaluator.documents.flight_plan import build_flight_plan
    from evaluator.documents.handbooks_calculation import build_geometric_calculation, build_radiometric_calculation
    from evaluator.documents.handbooks_observation import build_geometric_observation, build_radiometric_observation
    from evaluator.documents.test_report import build_test_report

    made = [build_test_report(evaluation, results, language)]
    if evaluation.data is not None:
        made.append(build_flight_plan(evaluation.data, results, language))
    for build in (
        build_radiometric_observation,
        build_geometric_observation,
        build_radiometric_calculation,
        build_geometric_calculation,
    ):
        made.append(build(evaluation, results, language))
    return made


def write_documents(
    folder: Path,
    evaluation: "Evaluation",
    results: Mapping[str, Any],
    languages: Sequence[Language] = ("zh",),
    progress: Report = silent,
) -> list[Path]:
    """Writes every document as PDF and DOCX.

    Parameters
    ----------
    folder : Path
        Is made where it does not exist; files of the same names are replaced, others left alone.
    evaluation : Evaluation
        With `data`, the campaign as read.
    results : mapping
        results.json, from which every figure is taken.
    languages : sequence of "zh" | "en"
    progress : callable

    Returns
    -------
    list of Path
        The files, in the order of writing: test_report_zh.pdf, test_report_zh.docx, flight_plan_zh.pdf, …, then
        observation_ and calculation_radiometric and _geometric.

    Raises
    ------
    CampaignError
        A file cannot be written.
    """
    from evaluator.documents.docx import write_docx
    from evaluator.documents.pdf import write_pdf

    documents = [d for language in languages for d in build_documents(evaluation, results, language)]
    written: list[Path] = []
    for k, document in enumerate(documents):
        progress("documents", k, len(documents))
        for suffix, write in ((".pdf", write_pdf), (".docx", write_docx)):
            path = folder / f"{document.name}{suffix}"
            write(path, document)
            written.append(path)
    progress("documents", len(documents), len(documents))
    return written
