"""A response of the user's own: "package.module:function" of a study file, found beside it or installed. Light: a worker that runs
nothing else starts in a moment."""

import importlib
import importlib.util
import math
import sys
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from campaign.errors import ConfigError, TestrangeError


def resolve(name: str, folder: str) -> Callable[..., Any]:
    """The function that "package.module:function" means; a module beside the study file comes before an installed one.

    Raises
    ------
    TestrangeError
        No such module or function, or the module fails when it is read.
    """
    module, _, attribute = name.partition(":")
    file = module_file(name, folder)
    if folder not in sys.path:
        sys.path.append(folder)  # what the module imports may stand there too
    try:
        loaded = importlib.import_module(module) if file is None else _from_file(file, file.stat().st_mtime_ns)
    except (Exception, SystemExit) as error:
        remedy = "put the module beside the study file" if isinstance(error, ModuleNotFoundError) else None
        got = f"{type(error).__name__}: {error}"
        raise TestrangeError("cannot be imported", where=name, got=got, remedy=remedy) from None
    found: object = getattr(loaded, attribute, None)
    if not callable(found):
        raise TestrangeError(f"{module} has no function {attribute}", where=name)
    return found


def module_file(name: str, folder: str) -> Path | None:
    """The module's file where it stands beside the study file."""
    file = Path(folder, *name.partition(":")[0].split(".")).with_suffix(".py")
    return file if file.is_file() else None


@cache
def _from_file(file: Path, changed_ns: int) -> ModuleType:
    """A module by its file: a worker of a cluster may have met another of the same name."""
    spec = importlib.util.spec_from_file_location(f"_study_{file.stem}_{changed_ns}", file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file.name} is no module")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def from_callable(found: object, names: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """What a callable gave: one number for the only response, or a mapping of responses to numbers.

    Raises
    ------
    ConfigError
        Something else, or a response is missing.
    """
    given: Mapping[str, Any] = found if isinstance(found, Mapping) else {names[0]: found} if len(names) == 1 else {}
    missing = [name for name in names if name not in given]
    if missing:
        raise ConfigError(
            "the callable gave no value of it", where=missing[0], expected="a mapping of responses to numbers"
        )
    out = {}
    for name in names:
        try:
            out[name] = finite({"value": float(given[name])})
        except (TypeError, ValueError, OverflowError):
            raise ConfigError("the callable gave no number", where=name, got=repr(given[name])[:60]) from None
    return out


def finite(found: dict[str, Any]) -> dict[str, Any]:
    """NaN and infinity are no values."""
    value = found["value"]
    if value is None or math.isfinite(value):
        return found
    return found | {"value": None, "reason": f"the value is not finite: {value}"}
