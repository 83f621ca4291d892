"""The fault matrix as a drawing: a row for each fault, a column for each quantity, how far each stands off what was stated."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from evaluator.report.style import INK, figure
from testrange.faults.matrix import FaultMatrix

_FULL = 40.0  # |z| of the darkest colour


def draw_matrix(matrix: FaultMatrix) -> Figure:
    """|z| by colour, the figure where it passes the limit; a frame where the injected fault must show."""
    names = [*matrix.quantities, *dict.fromkeys(t for r in matrix.results for t in (*r.case.doubts, *r.doubts))]
    values = np.full((len(matrix.results), len(names)), np.nan)
    drawn = figure(4.2 + 0.36 * len(names), 2.2 + 0.28 * len(matrix.results))
    axes = drawn.add_subplot()
    for i, result in enumerate(matrix.results):
        for row in result.rows:
            values[i, names.index(row["quantity"])] = row["z"]
    shade = np.log1p(np.abs(values)) / np.log1p(_FULL)
    axes.imshow(np.clip(shade, 0.0, 1.0), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for i, result in enumerate(matrix.results):
        for j, name in enumerate(names):
            z = values[i, j]
            doubted = name in result.doubts
            if doubted or abs(z) > matrix.limit:
                text = "×" if doubted else f"{z:.0f}"
                axes.text(j, i, text, ha="center", va="center", fontsize=7.0, color="w" if shade[i, j] > 0.6 else INK)
            if name in (*result.case.shows, *result.case.doubts):
                axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1.0, 1.0, fill=False, edgecolor="#1a7f4b", linewidth=1.6))
            elif doubted or abs(z) > matrix.limit:
                axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1.0, 1.0, fill=False, edgecolor="#b3261e", linewidth=1.6))
    axes.set_xticks(range(len(names)), [n.replace("_", " ") for n in names], rotation=60.0, ha="right")
    axes.set_yticks(range(len(matrix.results)), [r.case.name for r in matrix.results])
    axes.tick_params(length=0.0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    right = f"{matrix.right} of {len(matrix.results)} as injected"
    axes.set_title(
        f"Injected fault against what deviates: z where |z| > {matrix.limit:.2f}, × a surveyed place that is doubted; {right}\n"
        "Green: must show. Red: shows besides.",
        loc="left",
    )
    return drawn
