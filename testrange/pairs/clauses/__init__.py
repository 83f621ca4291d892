"""The formulas in mpmath, from the text of GB/T 41450-2022 and of the patent, one module for each clause family.

Written apart from the evaluator, which none of these modules imports. Each offers `pairs()`.
"""

from collections.abc import Callable

from testrange.pairs.clauses import (
    c7_4,
    c8_1,
    c8_2,
    c8_3,
    c9_1,
    c9_1_air,
    c9_2,
    c9_2_lens,
    c9_3,
    c9_3_adjusted,
    patent,
)
from testrange.pairs.model import Pair

FAMILIES: tuple[tuple[str, Callable[[], list[Pair]]], ...] = (
    ("7.4", c7_4.pairs),
    ("8.1", c8_1.pairs),
    ("8.2", c8_2.pairs),
    ("8.3", c8_3.pairs),
    ("9.1", c9_1.pairs),
    ("9.1.2", c9_1_air.pairs),
    ("9.2", c9_2.pairs),
    ("9.2.2", c9_2_lens.pairs),
    ("9.3", c9_3.pairs),
    ("9.3.2", c9_3_adjusted.pairs),
    ("patent", patent.pairs),
)
