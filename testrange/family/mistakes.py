"""Names for mistakes: a value that is wrong, and is what a known slip would give."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from testrange.family.model import ACCEPTED, Value

_CLEARLY = 6.0  # tolerances that must lie between two explanations before one is named
_FARTHEST = 1e150  # tolerances: its square is a number, and JSON has no infinity
_ONE_WAY = 0.01  # of the multiplication constant: how near to -1/2 or 1
_POOLED = 25.0  # chi-square by which a mistake must explain all members together better than none


@dataclass(frozen=True, kw_only=True)
class Compared:
    """One quantity of one member."""

    quantity: str
    unit: str
    true: float
    got: float
    tolerance: float
    grade: str | None = None
    grades: tuple[str, ...] = ()
    mistakes: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, quantity: str, value: Value, got: float, grade: str | None) -> "Compared":
        return cls(
            quantity=quantity,
            unit=value.unit,
            true=value.value,
            got=got,
            tolerance=value.tolerance,
            grade=grade,
            grades=value.grades,
            mistakes=value.mistakes,
        )

    @property
    def tolerances(self) -> float:
        return max(-_FARTHEST, min(_FARTHEST, (self.got - self.true) / self.tolerance))

    @property
    def near(self) -> bool:
        return abs(self.tolerances) <= ACCEPTED

    @property
    def graded(self) -> bool:
        return not self.grades or self.grade in self.grades

    @property
    def right(self) -> bool:
        return self.near and self.graded

    def block(self) -> dict[str, Any]:
        """For verdict.json."""
        out = {
            "quantity": self.quantity,
            "unit": self.unit,
            "true": self.true,
            "got": self.got,
            "tolerance": self.tolerance,
            "error_in_tolerances": self.tolerances,
            "right": self.right,
        }
        return out | ({"grade": self.grade, "accepted": list(self.grades)} if self.grades else {})


def mistakes_of(c: Compared) -> list[str]:
    """What one wrong value looks like; nothing where it is right or looks like nothing known."""
    if c.near:
        return [] if c.graded else [f"{c.quantity}: the value is right and its grade is not table 3's"]
    reach = ACCEPTED * c.tolerance
    found = [
        f"{c.quantity}: {name}"
        for name, value in c.mistakes.items()
        if abs(c.got - value) <= reach and abs(value - c.true) > reach
    ]
    if abs(c.true) > _CLEARLY * c.tolerance and abs(c.got + c.true) <= reach + 0.05 * abs(c.true) and not c.grades:
        found.append(f"{c.quantity}: sign reversed")
    if c.quantity == "multiplication_constant":
        for value, what in ((-0.5, "twice the true ones: one-way time taken for"), (1.0, "half the true ones:")):
            if abs(c.got - value) <= _ONE_WAY:
                found.append(f"ranges are {what} two-way time (factor 2)")
    if c.grades:
        for factor, what in (
            (100.0, "percent in the place of a fraction"),
            (0.01, "a fraction in the place of percent"),
        ):
            if abs(c.got / factor - c.true) <= reach:
                found.append(f"{c.quantity}: {what}")
    return found


def common_mistakes(members: Sequence[Sequence[Compared]]) -> tuple[str, ...]:
    """Mistakes that explain all members' values of a quantity together, although each alone may lie within its tolerance."""
    by_quantity: dict[str, list[Compared]] = {}
    for compared in members:
        for c in compared:
            by_quantity.setdefault(c.quantity, []).append(c)
    named = []
    for quantity, values in sorted(by_quantity.items()):
        plain = sum(c.tolerances**2 for c in values)
        best: tuple[float, str] | None = None
        for name in sorted({m for c in values for m in c.mistakes}):
            with_it = sum(replace(c, true=c.mistakes.get(name, c.true)).tolerances ** 2 for c in values)
            if plain - with_it > _POOLED and with_it < plain / 4.0 and (best is None or with_it < best[0]):
                best = with_it, name
        if best is not None:
            named.append(f"{quantity}: {best[1]}")
        named += _reversed(quantity, values)
    if any("ranges are" in m for compared in members for c in compared for m in mistakes_of(c)):
        named.append("one-way time: ranges wrong by a factor of 2")
    return tuple(dict.fromkeys(named))


def _reversed(quantity: str, values: list[Compared]) -> list[str]:
    clear = [c for c in values if not c.grades and abs(c.true) > _CLEARLY * c.tolerance]
    turned = [c for c in clear if any("sign reversed" in m for m in mistakes_of(c))]
    return [f"{quantity}: sign reversed"] if turned and 2 * len(turned) > len(clear) else []
