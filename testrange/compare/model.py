"""What is compared: contenders by their text on the command line, and what one of them did with one campaign."""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from campaign.errors import ConfigError
from evaluator.algorithms.load import parse_assignments
from evaluator.algorithms.program import check_program
from evaluator.other_methods import BUILT_IN

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,39}")
_EXPECTED = "name:slot=package.module:function[,slot=…], name:program:/path, or a ready-made one"
MOST = 12


@dataclass(frozen=True, kw_only=True)
class Contender:
    """One way to evaluate a campaign."""

    name: str
    slots: Mapping[str, str] = field(default_factory=dict)  # slot -> package.module:function; none: the evaluator's own
    program: Path | None = None  # instead: a whole evaluator

    @property
    def told(self) -> str:
        """What it is, without the place of a program on this machine."""
        if self.program is not None:
            return f"program {self.program.name}"
        return ", ".join(f"{slot}={name}" for slot, name in self.slots.items()) or "the evaluator's own"


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What one contender did with one campaign."""

    campaign: str
    contender: str
    reason: str | None = None  # why there are no results at all
    seconds: float | None = None  # of the evaluation, or of the program
    slot_seconds: Mapping[str, float] = field(default_factory=dict)  # in the slots that any contender replaces
    calls: Mapping[str, tuple[int, int]] = field(
        default_factory=dict
    )  # slot -> calls, failed ones; of its own algorithms
    failures: tuple[str, ...] = ()  # of its own algorithms: "<slot> <name>: what (n of m calls)"
    indicators: Mapping[str, float | None] = field(default_factory=dict)
    errors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # quantity -> item -> estimate minus truth
    units: Mapping[str, str] = field(default_factory=dict)  # of the quantities


def parse_contenders(texts: Sequence[str]) -> tuple[Contender, ...]:
    """Contenders of the command line; one alone is compared with "default".

    Raises
    ------
    ConfigError
        A text that is none of the forms, a name twice, an unknown slot or ready-made name (the nearest is told), none at all.
    """
    found = [_contender(text.strip()) for text in texts]
    if len(found) == 1 and found[0].name != "default":
        found.insert(0, Contender(name="default"))
    if not 2 <= len(found) <= MOST:
        raise ConfigError("algorithms to compare", got=len(found), expected=f"2 to {MOST}, each by --algorithm")
    for k, contender in enumerate(found):
        if contender.name in {c.name for c in found[:k]}:
            raise ConfigError(
                "two algorithms have one name", where=contender.name, remedy="give each its own before the colon"
            )
    return tuple(found)


def _contender(text: str) -> Contender:
    name, colon, rest = text.partition(":")
    if not colon:
        if name in BUILT_IN:
            return Contender(name=name, slots=BUILT_IN[name])
        near = difflib.get_close_matches(name, BUILT_IN, n=1, cutoff=0.4)
        remedy = f"did you mean {near[0]}?" if near else f"ready-made: {', '.join(BUILT_IN)}"
        raise ConfigError("is no algorithm", where=text[:80], expected=_EXPECTED, remedy=remedy)
    if not _NAME.fullmatch(name):
        own = f"put a name of your own in front: mine:{text[:60]}" if "=" in name else None
        raise ConfigError("begins with no name", where=text[:80], expected=_EXPECTED, remedy=own)
    if name in BUILT_IN:
        raise ConfigError("is the name of a ready-made algorithm", where=name, remedy="choose another")
    if rest.startswith("program:"):
        return Contender(name=name, program=check_program(Path(rest.removeprefix("program:"))))
    return Contender(name=name, slots=parse_assignments(rest.split(",")))
