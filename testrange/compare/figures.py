"""Drawings of a comparison: each contender's errors by quantity, and where two of them differ."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from evaluator.report.style import INK, SORTIE_COLOURS, figure
from testrange.compare.model import Outcome
from testrange.compare.statistics import Difference

_MOST_POINTS = 400  # of one contender and quantity that are drawn
_GREY = "#6b7280"


def error_figure(quantity: str, unit: str, outcomes: Sequence[Outcome], contenders: Sequence[str]) -> Figure:
    """One row a contender: every error as a dot, the middle half as a box, the mean as a line."""
    drawn = figure(5.3, 0.9 + 0.5 * len(contenders))
    axes = drawn.subplots()
    rng = np.random.default_rng(41450)  # of the dots' heights
    for row, name in enumerate(contenders):
        error = np.array([v for o in outcomes if o.contender == name for v in o.errors.get(quantity, {}).values()])
        if not error.size:
            axes.text(
                0.02, row, "no result", transform=axes.get_yaxis_transform(), va="center", color=_GREY, fontsize=8
            )
            continue
        shown = error[np.unique(np.linspace(0, error.size - 1, min(error.size, _MOST_POINTS)).astype(int))]
        height = row + (rng.uniform(-0.22, 0.22, shown.size) if shown.size > 1 else np.zeros(1))
        colour = SORTIE_COLOURS[row % len(SORTIE_COLOURS)]
        axes.plot(shown, height, ".", markersize=4.0, color=colour, alpha=0.55 if shown.size > 20 else 1.0)
        if error.size > 4:
            low, high = np.quantile(error, [0.25, 0.75])
            axes.fill_betweenx([row - 0.3, row + 0.3], low, high, color=colour, alpha=0.18, linewidth=0)
            axes.plot([error.mean()] * 2, [row - 0.36, row + 0.36], color=INK, linewidth=1.4)
    axes.axvline(0.0, color=_GREY, linewidth=0.8)
    axes.set_yticks(range(len(contenders)), contenders)
    axes.set_ylim(len(contenders) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(f"estimate minus truth [{unit}]")
    return drawn


def difference_figure(found: Sequence[Difference], first: str, second: str) -> Figure:
    """Relative differences of the mean |error| of one pair, with their intervals."""
    shown = [d for d in found if d.absolute.low is not None and max(d.rms) > 0.0]
    drawn = figure(5.3, 1.0 + 0.24 * len(shown))
    axes = drawn.subplots()
    for row, d in enumerate(shown):
        scale = 100.0 / max(d.rms)
        low, high = (scale * v for v in (d.absolute.low or 0.0, d.absolute.high or 0.0))
        colour = (_GREY, "#b3261e", "#1a7f4b")[d.absolute.verdict]
        axes.plot([low, high], [row, row], color=colour, linewidth=2.0, solid_capstyle="butt")
        axes.plot([scale * d.absolute.mean], [row], "o", color=colour, markersize=4.0)
    axes.axvline(0.0, color=_GREY, linewidth=0.8)
    axes.set_yticks(range(len(shown)), [d.quantity for d in shown])
    axes.set_ylim(max(len(shown), 1) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(f"|error| of {first} minus {second}, % of the larger RMS")
    axes.set_title(f"← {first} better · {second} better →", fontsize=8, loc="center")
    return drawn


def time_figure(outcomes: Sequence[Outcome], contenders: Sequence[str]) -> Figure:
    """Seconds of each contender, one dot a campaign: the whole evaluation, and in the slots that are compared."""
    drawn = figure(5.3, 0.9 + 0.4 * len(contenders))
    axes = drawn.subplots()
    for row, name in enumerate(contenders):
        mine = [o for o in outcomes if o.contender == name and o.seconds is not None]
        whole = [o.seconds for o in mine if o.seconds is not None]
        part = [sum(o.slot_seconds.values()) for o in mine if o.slot_seconds]
        axes.plot(
            whole, [row] * len(whole), "o", color=SORTIE_COLOURS[0], label="whole evaluation" if not row else None
        )
        axes.plot(part, [row] * len(part), "D", color=SORTIE_COLOURS[1], label="compared slots" if not row else None)
    axes.set_yticks(range(len(contenders)), contenders)
    axes.set_ylim(len(contenders) - 0.5, -0.5)
    if any(o.seconds for o in outcomes):  # where all have failed there is nothing to scale
        axes.set_xscale("log")
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("seconds")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return drawn
