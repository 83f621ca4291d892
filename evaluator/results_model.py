"""What an indicator's module hands to the orchestrator: a value with uncertainty and companions, or the reason for none.

Grades and the writing of results.json do not live here.
"""

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class IndicatorValue:
    """One indicator of Table 3, not yet graded. `value` is None where it was not measured; `reason` then says why."""

    value: float | None  # unrounded; in `unit`
    unit: str  # "%" | "% reflectance" | "pixel"
    formula: str  # of the standard, e.g. "(2)"
    clause: str  # e.g. "8.1"
    sample_size: int = 0  # panels, images or targets behind the value
    std: float | None = None  # standard deviation of `value`
    low_95: float | None = None
    high_95: float | None = None
    method: str | None = None  # how std, low_95 and high_95 were computed
    companions: dict[str, object] = field(default_factory=dict)  # numbers, strings, lists, dicts: goes into JSON
    reason: str | None = None

    def __post_init__(self) -> None:
        if self.value is None and not self.reason:
            raise ValueError("an indicator without a value must say why in `reason`")


def not_measured(unit: str, formula: str, clause: str, reason: str, **companions: object) -> IndicatorValue:
    """An indicator that cannot be computed from this campaign; `companions` keep what was found on the way."""
    return IndicatorValue(
        value=None, unit=unit, formula=formula, clause=clause, reason=reason, companions=dict(companions)
    )
