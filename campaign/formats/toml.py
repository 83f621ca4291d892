"""A small TOML writer for configurations: tables, arrays, inline tables inside arrays. Reading is tomllib's."""

from collections.abc import Iterator
from typing import Any


def toml_text(data: dict[str, Any]) -> str:
    """A nested dict as TOML text; plain values stand before the tables of each level."""
    return "\n".join(_table(data, "")).strip() + "\n"


def _table(data: dict[str, Any], prefix: str) -> Iterator[str]:
    for key, value in data.items():
        if not isinstance(value, dict):
            yield f"{key} = {_value(value)}"
    for key, value in data.items():
        if isinstance(value, dict):
            yield f"\n[{prefix}{key}]"
            yield from _table(value, f"{prefix}{key}.")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return '"' + "".join(_escaped(c) for c in value) + '"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {_value(v)}" for k, v in value.items()) + " }"
    raise TypeError(f"{type(value).__name__} has no TOML form here")


def _escaped(character: str) -> str:
    if character in '"\\':
        return "\\" + character
    code = ord(character)
    return character if code >= 0x20 and code != 0x7F else f"\\u{code:04x}"
