"""Clauses 5 to 9 as a table of conformity: what the standard asks, what the campaign's records say, pass or fail.

Modules
-------
model       a row of the table, the optional facts that the orchestrator adds
clause_5    5.1-5.5: content, instruments, datum and time, brightness and points on the panels
clause_6    6.2: range, targets, layout
clause_7    7.1-7.4: plan, environment, speed, height; formula (1)
clause_8_9  8.1.2, 8.3.2, 9.3.2: how many targets
flight      strips of the trajectory, sun position: what clauses 6 and 7 look up

A record that is missing gives a row "not_recorded" and never an error.
"""

from collections.abc import Callable

from evaluator.conformity.clause_5 import clause_5
from evaluator.conformity.clause_6 import clause_6
from evaluator.conformity.clause_7 import clause_7, flight_height
from evaluator.conformity.clause_8_9 import clause_8_9
from evaluator.conformity.model import ConformityInputs, Row, Status
from evaluator.model import CampaignData

__all__ = ["ConformityInputs", "Row", "Status", "conformity_rows", "flight_height"]

_FAMILIES: tuple[Callable[[CampaignData, ConformityInputs], list[Row]], ...] = (
    clause_5,
    clause_6,
    clause_7,
    clause_8_9,
)


def conformity_rows(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    """Every row, in the order of the clauses."""
    return [row for family in _FAMILIES for row in family(data, measured)]
