"""Colour scales of the page: perceptually uniform, and told apart without full colour vision."""

import matplotlib
import numpy as np

# Okabe and Ito's colours, which the colour-blind tell apart; black left out.
GROUPS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#999999")
SCALES = {"reflectance": "cividis", "height": "viridis", "error": "inferno"}
STEPS = 64


def scale(name: str) -> list[str]:
    """Colours of a scale from its low to its high end, as #rrggbb. The darkest tenth is left out: it would not show."""
    low = 0.12 if name == "inferno" else 0.06
    rgb = matplotlib.colormaps[name](np.linspace(low, 1.0, STEPS))[:, :3]
    return ["#" + "".join(f"{round(255 * float(v)):02x}" for v in row) for row in rgb]


def group_colour(place: int) -> str:
    """The colour of the k-th of several groups; the first eight differ."""
    return GROUPS[place % len(GROUPS)]
