"""A fault study's file: which faults, and where each must show."""

from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from campaign.config import Model
from campaign.errors import ConfigError
from campaign.load import read_toml, resolve_study


class FaultCase(Model):
    """One fault and where it must show."""

    name: str = Field(pattern=r"^[^\n]{1,60}$")
    set: tuple[str, ...] = Field((), description="settings below faults., as key=value")
    shows: tuple[str, ...] = Field((), description="quantities of the diagnosis that must deviate, all others must not")
    doubts: tuple[str, ...] = Field((), description="targets whose surveyed place must be doubted, no other")


class FaultStudy(Model):
    """configs/studies/*.toml of a fault matrix."""

    base: str = Field(description="a configuration, by name or path")
    set: tuple[str, ...] = Field((), description="settings common to all cases")
    fault: Annotated[tuple[FaultCase, ...], Field(min_length=1, max_length=200)]


def load_study(path: Path | str) -> FaultStudy:
    """A study by path or by its name in configs/studies.

    Raises
    ------
    ConfigError
        No such file, not TOML, an unknown key, two faults of one name, or a setting that is no fault.
    """
    file = resolve_study(path)
    try:
        study = FaultStudy.model_validate(read_toml(file))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = f"{file} {'.'.join(map(str, first['loc']))}"
        raise ConfigError(first["msg"], where=where, got=repr(first["input"])[:60]) from None
    names: set[str] = set()
    for case in study.fault:
        if case.name in names:
            raise ConfigError("two faults of one name", where=f"{file} fault.name", got=case.name)
        names.add(case.name)
        for setting in case.set:
            if not setting.startswith("faults."):
                raise ConfigError("is no fault", where=f"{file} {case.name}", got=setting, expected="faults.…=value")
    return study
