"""Algorithms against each other on campaigns whose truth is known: `compare_campaigns`, `write_comparison`, `print_comparison`.

What an algorithm is, and how it is run without harm to the rest: `evaluator.algorithms`. Errors against truth: `evaluator.scores`.
"""

from testrange.compare.model import Contender, parse_contenders
from testrange.compare.run import Comparison, compare_campaigns

__all__ = ["Comparison", "Contender", "compare_campaigns", "parse_contenders"]
