"""The Ishigami function: a cheap response whose Sobol indices are known, for trying a study in seconds."""

import math
from collections.abc import Mapping

A, B = 7.0, 0.1


def ishigami(factors: Mapping[str, float], seed: int) -> float:
    r""":math:`\sin x_1 + a \sin^2 x_2 + b x_3^4 \sin x_1` with a = 7, b = 0.1; `seed` is not used: it has no noise.

    References
    ----------
    Ishigami and Homma, Proc. ISUMA '90, 398-403. Indices on [-pi, pi]: S1 = (0.3139, 0.4424, 0), ST = (0.5576, 0.4424, 0.2437).
    """
    x1, x2, x3 = factors["x1"], factors["x2"], factors["x3"]
    return math.sin(x1) + A * math.sin(x2) ** 2 + B * x3**4 * math.sin(x1)
