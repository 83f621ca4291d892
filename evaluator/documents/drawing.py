"""A matplotlib figure as a document's picture: SVG for the PDF, PNG for the DOCX, without a date in either."""

import io

from matplotlib.figure import Figure as Drawn

from evaluator.documents.model import Picture

_DPI = 200.0


def picture(drawn: Drawn, caption: str, width_mm: float = 160.0) -> Picture:
    """Both forms of one figure. To be called inside `evaluator.report.style.style()`, which has the Chinese font."""
    svg, png = io.BytesIO(), io.BytesIO()
    drawn.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    drawn.set_layout_engine("none")  # keeps the places that the layout found: it is most of the work
    drawn.savefig(png, format="png", dpi=_DPI, metadata={"Software": None})
    return Picture(svg=svg.getvalue(), png=png.getvalue(), caption=caption, width_mm=width_mm)
