"""Clauses 5 to 9 as a table of conformity: what the standard asks, what the campaign's records say, pass or fail.

Modules
-------
model       a row of the table, the optional facts that the orchestrator adds
clause_5    5.1-5.5: content, instruments, datum and time, brightness and points on the panels
clause_6    6.2: range, targets, layout
clause_6_3  6.3: the room of the benches, sphere and chessboard
clause_7    7.1-7.4: plan, environment, speed, height; formula (1)
clause_8_9  8.1.2, 8.3.2, 9.3.2: how many targets; the order of clauses 8 and 9
clause_8_2  8.2.2: the two series at the integrating sphere
clause_9_1  9.1.2: the ranging line and its total stations
clause_9_2  9.2.2: how the chessboard was photographed
flight      strips of the trajectory, sun position: what clauses 6 and 7 look up

A record that is missing gives a row "not_recorded" and never an error; a bench or a ranging line that the campaign does not have
at all is one row "not_applicable" for each of its clauses.
"""

from collections.abc import Callable

from evaluator.conformity.clause_5 import clause_5
from evaluator.conformity.clause_6 import clause_6
from evaluator.conformity.clause_6_3 import clause_6_3
from evaluator.conformity.clause_7 import clause_7, flight_height
from evaluator.conformity.clause_8_9 import clause_8_9
from evaluator.conformity.model import ConformityInputs, Row, Status
from evaluator.model import CampaignData

__all__ = ["ConformityInputs", "Row", "Status", "conformity_rows", "flight_height"]

_FAMILIES: tuple[Callable[[CampaignData, ConformityInputs], list[Row]], ...] = (
    clause_5,
    clause_6,
    clause_6_3,
    clause_7,
    clause_8_9,
)


def conformity_rows(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    """Every row, in the order of the clauses."""
    return [row for family in _FAMILIES for row in family(data, measured)]
