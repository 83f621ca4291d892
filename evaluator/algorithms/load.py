"""Functions by name: "package.module:function" for a slot, from the command line or from the user's own TOML file.

What is asked for is checked without importing anything (`parse_assignments`, `read_algorithms_file`); importing runs the
user's code and so happens where the evaluation happens (`load_algorithms`). No name is ever read from a campaign folder.
"""

import difflib
import importlib
import os
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from campaign.config import Model
from campaign.errors import ConfigError
from campaign.load import read_toml
from evaluator.algorithms.record import SLOTS, Algorithms

_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(\.[^\W\d]\w*)*")
_EXPECTED = "package.module:function"


def _checked(slot: str, name: str) -> None:
    """A slot that exists and a name that can be one."""
    if slot not in SLOTS:
        near = difflib.get_close_matches(slot, SLOTS, n=1, cutoff=0.4)
        remedy = f"did you mean {near[0]}?" if near else None
        raise ConfigError("is no algorithm's slot", where=slot, expected=f"one of {', '.join(SLOTS)}", remedy=remedy)
    if len(name) > 300 or not _NAME.fullmatch(name):
        raise ConfigError("is no function's name", where=slot, got=repr(name)[:80], expected=_EXPECTED)


def parse_assignments(items: Sequence[str]) -> dict[str, str]:
    """`slot=package.module:function` texts as slot -> name.

    Raises
    ------
    ConfigError
        No such slot (the nearest is named), one given twice, or a name that can be none.
    """
    names: dict[str, str] = {}
    for item in items:
        slot, equals, name = (part.strip() for part in item.partition("="))
        if not equals:
            raise ConfigError("is no choice of an algorithm", got=item[:80], expected=f"slot={_EXPECTED}")
        _checked(slot, name)
        if slot in names:
            raise ConfigError("is given twice", where=slot, got=f"{names[slot]} and {name}")
        names[slot] = name
    return names


class _File(Model):
    algorithms: dict[str, Any] = Field(description="slot -> package.module:function")


def read_algorithms_file(path: Path, campaign: Path | None = None) -> dict[str, str]:
    """The table `[algorithms]` of a TOML file of the user's own, as slot -> name.

    Parameters
    ----------
    path : Path
    campaign : Path, optional
        The campaign folder to be evaluated: a file inside it came with it, and is refused.

    Raises
    ------
    ConfigError
        Not readable, another table or key, or a name that can be none.
    """
    if campaign is not None and path.resolve().is_relative_to(campaign.resolve()):
        raise ConfigError(
            "lies in the campaign folder: what somebody sent does not say what is run here",
            where=str(path),
            remedy="copy it elsewhere after reading it",
        )
    try:
        table = _File.model_validate(read_toml(path)).algorithms
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(map(str, first["loc"]))
        raise ConfigError(first["msg"], where=f"{path} {key}", expected="one table, [algorithms]") from None
    for slot, name in table.items():
        if not isinstance(name, str):
            raise ConfigError("is no text", where=f"{path} algorithms.{slot}", got=name, expected=_EXPECTED)
        _checked(slot, name)
    return dict(table)


def choose(items: Sequence[str], file: Path | None, campaign: Path | None = None) -> dict[str, str]:
    """What the command line says, on top of what the user's own file says; slot -> name."""
    named = read_algorithms_file(file, campaign) if file is not None else {}
    return named | parse_assignments(items)


def put_current_folder_on_path(campaign: Path | None = None) -> None:
    """As `python -m` does, so that a function in a file beside the user is found; not where the campaign itself is current."""
    here = Path.cwd()
    if campaign is not None and here.resolve().is_relative_to(campaign.resolve()):
        return
    if str(here) not in sys.path:
        sys.path.insert(0, str(here))


def load_algorithms(names: Mapping[str, str]) -> Algorithms:
    """Imports the functions.

    Parameters
    ----------
    names : mapping
        slot -> package.module:function.

    Returns
    -------
    Algorithms
        The evaluator's own in the slots that `names` leaves out.

    Raises
    ------
    ConfigError
        One line: no such slot, no such module, no such function, not callable, or what the import raised.
    """
    found: dict[str, Any] = {}
    for slot, name in names.items():
        _checked(slot, name)
        found[slot] = _imported(slot, name)
    return Algorithms(**found, names=dict(names))


def _imported(slot: str, name: str) -> Any:
    module_name, _, attribute = name.partition(":")
    where = f"{slot} {name}"
    try:
        module: Any = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is not None and (module_name == error.name or module_name.startswith(f"{error.name}.")):
            looked = (
                f"searched from {os.path.basename(os.getcwd()) or 'the current folder'}/ and the installed packages"
            )
            raise ConfigError(f"no module {error.name}", where=where, remedy=looked) from None
        raise ConfigError(f"its module needs {error.name}, which is not installed", where=where) from None
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise ConfigError(f"its module cannot be imported: {told(error)}", where=where) from None
    target = module
    for part in attribute.split("."):
        if not hasattr(target, part):
            public = [n for n in dir(target) if callable(getattr(target, n, None)) and not n.startswith("_")]
            near = difflib.get_close_matches(part, public, n=1, cutoff=0.4)
            remedy = f"did you mean {near[0]}?" if near else None
            raise ConfigError(f"no function {part} in {module_name}", where=where, remedy=remedy)
        target = getattr(target, part)
    if not callable(target):
        raise ConfigError("is not callable", where=where, got=type(target).__name__, expected="a function")
    return target


def told(error: BaseException) -> str:
    """An exception in one line, at most 200 characters."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}"[:200] if text else type(error).__name__
