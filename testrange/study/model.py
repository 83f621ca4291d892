"""The study file: what is varied, how, and what is looked at. Values and settings are checked when points are made."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, field_validator, model_validator

from campaign.config import Model
from campaign.errors import ConfigError, TestrangeError
from campaign.load import read_toml, resolve_study

Design = Literal["grid", "list", "lhs", "sobol", "morris"]
Scalar = bool | int | float | str
Value = Scalar | list[Any]
SAMPLED: tuple[Design, ...] = ("lhs", "sobol", "morris")
MAX_POINTS = 200_000
RUN_TIME = "run_time_s"  # always a column; may be a response
_NAME = r"^[A-Za-z][A-Za-z0-9_]{0,39}$"
_KEY = r"^[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)*$"
_CALLABLE = r"^[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*$"
RESERVED = frozenset(
    {"id", "row", "replicate", "seed", "status", "reason", RUN_TIME, "settings", "versions", "geometry"}
)


class StudyError(TestrangeError):
    """A study cannot go on: its folder, its cluster, its workers."""


class Level(Model):
    """One level of a factor that is no single value: several settings under one name."""

    name: str = Field(min_length=1, max_length=60)
    value: float | None = Field(None, description="where the level stands on an axis; absent: the levels are names")
    set: tuple[str, ...] = Field((), description="settings, as after --set")


class Factor(Model):
    """One thing that is varied: a key, several keys that move together, or named levels."""

    name: Annotated[str, Field(pattern=_NAME)]
    label: str = Field("", max_length=80, description="for axes; the name when absent")
    unit: str = Field("", max_length=20)
    key: Annotated[str, Field(pattern=_KEY)] | None = Field(None, description="the setting that takes the value")
    moves: dict[Annotated[str, Field(pattern=_KEY)], float | tuple[float, ...]] = Field(
        default={}, description="settings that move together: the value times this number, or times each of these"
    )
    values: tuple[Value, ...] | None = Field(None, min_length=1, max_length=1000, description="grid and list")
    range: tuple[float, float] | None = Field(None, description="lhs, sobol, morris: least and greatest value")
    log: bool = Field(False, description="spread evenly by ratio")
    whole: bool = Field(False, description="round to whole numbers")
    level: tuple[Level, ...] = Field((), max_length=200, description="in the place of values")

    @field_validator("moves", mode="before")
    @classmethod
    def _dotted(cls, value: Any) -> Any:
        """flight.heights_m without quotation marks is a table in a table in TOML."""
        return dict(_flat(value, ())) if isinstance(value, dict) else value

    @property
    def title(self) -> str:
        """For axes and tables: label and unit."""
        return f"{self.label or self.name} [{self.unit}]" if self.unit else self.label or self.name

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        given = [self.values is not None, self.range is not None, bool(self.level)]
        if sum(given) != 1:
            raise ValueError("expected one of values, range or [[factor.level]]")
        if self.level and (self.key or self.moves):
            raise ValueError("named levels have settings of their own: leave out key and moves")
        if self.key and self.moves:
            raise ValueError('expected key or moves, not both; key = "a.b" is moves = {"a.b" = 1.0}')
        if self.moves and any(isinstance(v, bool | str | list) for v in self.values or ()):
            raise ValueError("moves multiplies the value: expected numbers")
        if self.range is not None and not self.range[0] < self.range[1]:
            raise ValueError("range: expected least before greatest")
        if len({level.name for level in self.level}) < len(self.level):
            raise ValueError("two levels have the same name")
        places = [level.value for level in self.level if level.value is not None]
        if len(set(places)) < len(places):
            raise ValueError("two levels have the same value: the table could not tell them apart")
        if self.log and self.range is not None and self.range[0] <= 0.0:
            raise ValueError("log needs a range above 0")
        if self.name in RESERVED:
            raise ValueError(f"{self.name} is a column of the table; choose another name")
        return self


def _flat(table: Mapping[str, Any], above: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, (*above, key))
        else:
            yield ".".join((*above, key)), value


class Study(Model):
    """configs/studies/*.toml of a study."""

    title: str = Field(min_length=1, max_length=120)
    about: str = Field("", max_length=4000, description="what is asked; printed on the page")
    base: str | None = Field(None, description="a configuration, by name or path; absent with callable")
    callable: Annotated[str, Field(pattern=_CALLABLE)] | None = Field(
        None, description='in the place of a campaign: "package.module:function" of the factors and a seed'
    )
    set: tuple[str, ...] = Field((), max_length=200, description="settings common to all points")
    design: Design = "grid"
    samples: Annotated[int, Field(ge=1, le=MAX_POINTS)] | None = Field(
        None, description="lhs: points; sobol: base samples, a power of two; morris: trajectories"
    )
    second_order: bool = Field(False, description="sobol: pairs of factors too, for twice the points")
    grid_levels: Annotated[int, Field(ge=4, le=64, multiple_of=2)] = Field(4, description="morris: levels of a factor")
    design_seed: Annotated[int, Field(ge=0, lt=2**32)] = 1
    replicates: Annotated[int, Field(ge=1, le=1000)] = Field(1, description="points of each row, noise redrawn")
    responses: Annotated[tuple[str, ...], Field(min_length=1, max_length=60)] = ("indicators.calibration_error",)
    keep: bool = Field(False, description="keep each point's campaign folder and results under runs/")
    factor: Annotated[tuple[Factor, ...], Field(min_length=1, max_length=20)]

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if (self.base is None) == (self.callable is None):
            raise ValueError("expected base, or callable in its place")
        if self.callable and self.set:
            raise ValueError("set belongs to a base configuration; a callable takes the factors alone")
        names = [f.name for f in self.factor]
        if len(set(names)) < len(names):
            raise ValueError("two factors have the same name")
        columns = [r.removeprefix("indicators.") for r in self.responses if r != RUN_TIME]
        taken = [*columns, *names, *RESERVED]
        if len(set(taken)) < len(taken) or self.responses.count(RUN_TIME) > 1:
            raise ValueError("a response is named twice, or as a factor or another column of the table")
        if self.design in SAMPLED:
            for factor in self.factor:
                if factor.range is None:
                    raise ValueError(f"factor {factor.name}: design = {self.design} needs range = [least, greatest]")
            if self.samples is None:
                raise ValueError(f"samples is missing; design = {self.design} needs it")
            if self.design == "sobol" and self.samples & (self.samples - 1):
                raise ValueError("samples: expected a power of two with design = sobol")
        else:
            for factor in self.factor:
                if factor.range is not None:
                    raise ValueError(
                        f"factor {factor.name}: design = {self.design} needs values or levels, not a range"
                    )
        if self.base is not None:
            for factor in self.factor:
                if not (factor.key or factor.moves or factor.level):
                    raise ValueError(f"factor {factor.name}: expected key, moves or [[factor.level]]")
        return self


def load_study(path: Path | str, overrides: tuple[str, ...] = ()) -> tuple[Study, Path]:
    """A study by path, or by its name in configs/studies, and its file.

    Parameters
    ----------
    overrides : tuple of str
        Common settings on top of the study's own, "key=value".

    Raises
    ------
    ConfigError
        No such file, not TOML, an unknown key, a fault matrix, or parts that do not go together.
    """
    file = resolve_study(path)
    data = read_toml(file)
    if "fault" in data:
        raise ConfigError("is a fault matrix", where=str(file), remedy=f"testrange faults {path}")
    return parse_study(data, str(file), overrides), file


def parse_study(data: Mapping[str, Any], where: str, overrides: tuple[str, ...] = ()) -> Study:
    """The model of a study file's contents."""
    try:
        study = Study.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        if first["type"] == "extra_forbidden":
            raise ConfigError(f"{place} is not a setting of a study", where=where) from None
        what = first["msg"].removeprefix("Value error, ").replace("valid tuple", "valid list")
        got = None if first["type"] == "value_error" else repr(first["input"])[:60]
        raise ConfigError(f"{place}: {what}" if place else what, where=where, got=got) from None
    except RecursionError:
        raise ConfigError("the values are nested too deeply", where=where) from None
    if overrides and study.base is None:
        raise ConfigError("a study of a callable has no settings", where=f"--set {overrides[0]}")
    return study.model_copy(update={"set": (*study.set, *overrides)})
