"""A family's file, its members, and what is expected of an evaluator. No formula, no file of a campaign."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from campaign.config import Model
from campaign.errors import CampaignError, ConfigError
from campaign.load import configs_folder, read_toml

Indicator = Literal[
    "lidar_reflectance_rmse",
    "camera_stability",
    "camera_repeatability",
    "reflectance_correlation",
    "reflectance_rmse_relative",
    "lidar_ranging_rmse_relative",
    "camera_reprojection_error",
    "calibration_error",
]
Grade = Literal["excellent", "good", "fair", "ungraded"]
GRADES: tuple[Grade, ...] = ("excellent", "good", "fair", "ungraded")
Group = Literal["sphere", "ranging", "chessboard", "radiometry", "geometry", "records"]
# Table 3: bounds of 优, 良, 一般, and the unit; written here again, so that a slip in the evaluator's table shows.
BOUNDS: dict[Indicator, tuple[float, float, float]] = {
    "lidar_reflectance_rmse": (3.0, 5.0, 10.0),
    "camera_stability": (1.0, 3.0, 5.0),
    "camera_repeatability": (0.5, 1.0, 3.0),
    "reflectance_correlation": (99.0, 95.0, 90.0),
    "reflectance_rmse_relative": (3.0, 5.0, 10.0),
    "lidar_ranging_rmse_relative": (1.0, 3.0, 5.0),
    "camera_reprojection_error": (0.3, 0.5, 1.0),
    "calibration_error": (0.5, 1.0, 2.0),
}
UNITS: dict[Indicator, str] = dict.fromkeys(BOUNDS, "%") | {
    "camera_reprojection_error": "pixel",
    "calibration_error": "pixel",
    "lidar_reflectance_rmse": "% reflectance",
    "reflectance_rmse_relative": "% reflectance",
}
GREATER_IS_BETTER: frozenset[Indicator] = frozenset({"reflectance_correlation"})
ACCEPTED = 3.0  # tolerances: how far a result may lie from the true value
SCHEMA = 1
INDEX = "family.json"


class Settings(Model):
    """Of one kind of member, on top of the family's."""

    set: tuple[str, ...] = ()


class Family(Model):
    """configs/families/*.toml."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,40}$")
    title: str
    base: str = Field(description="a configuration: a name in configs/campaigns, or a path beside this file")
    set: tuple[str, ...] = ()
    sphere: Settings = Settings()
    ranging: Settings = Settings()
    chessboard: Settings = Settings()
    radiometry: Settings = Settings()
    geometry: Settings = Settings()
    records: Settings = Settings()
    indicators: tuple[Indicator, ...] = Field(tuple(BOUNDS), description="which are varied")
    grades: tuple[Grade, ...] = Field(GRADES, description="of each indicator, one member in the middle")
    boundaries: bool = Field(True, description="members three tolerances to both sides of each boundary")
    violations: tuple[str, ...] | None = Field(None, description="names of violated clauses; all when absent")
    controls: bool = Field(True, description="one member of each kind with nothing wrong")
    pairs: bool = Field(True, description="the reference pairs of every formula, beside the members")
    replicates: Annotated[int, Field(ge=20, le=5000)] = Field(
        200, description="draws of noise from which a tolerance is estimated"
    )


@dataclass(frozen=True, kw_only=True)
class Value:
    """What is true, and the standard uncertainty of one measurement of it."""

    value: float
    tolerance: float
    unit: str
    grades: tuple[Grade, ...] = ()
    # what a known mistake would give in its place: name -> value
    mistakes: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Expected:
    """What an evaluator has to find in one member."""

    member: str
    indicators: dict[str, Value] = field(default_factory=dict)
    constants: dict[str, Value] = field(default_factory=dict)  # of ranging: companions of m_z
    mounting: dict[str, Value] = field(default_factory=dict)  # names of results.json's mounting
    clauses: dict[str, tuple[str, ...]] = field(default_factory=dict)  # clause -> statuses one of which a row must have
    may_fail: tuple[str, ...] = ()  # clauses that say the same again, or that only some evaluators test

    def block(self) -> dict[str, Any]:
        """For expected/MEMBER.json."""
        return {"schema": SCHEMA, **asdict(self)}


@dataclass(frozen=True, kw_only=True)
class Member:
    """One campaign folder of a family, before it is made."""

    name: str
    group: Group
    parts: tuple[str, ...]  # what is simulated: sphere, chessboard, ranging, camera, lidar
    purpose: str
    settings: tuple[str, ...] = ()  # on top of its kind's
    edit: str | None = None  # name of the change of records after the simulation
    expected: Expected


def grade_of(indicator: Indicator, value: float) -> Grade:
    """Table 3; the value on a boundary has the better grade."""
    sign = -1.0 if indicator in GREATER_IS_BETTER else 1.0
    for grade, bound in zip(GRADES, BOUNDS[indicator], strict=False):
        if sign * value <= sign * bound:
            return grade
    return "ungraded"


def accepted_grades(indicator: Indicator, value: float, tolerance: float) -> tuple[Grade, ...]:
    """Grades that a result within the accepted distance of the true value may have."""
    reach = ACCEPTED * tolerance * (1.0 - 1e-6)
    found = {grade_of(indicator, v) for v in (value - reach, value, value + reach)}
    return tuple(g for g in GRADES if g in found)


def load_family(path: Path | str) -> Family:
    """A family by path or by its name in configs/families.

    Raises
    ------
    ConfigError
        No such file, not TOML, or an unknown key.
    """
    file = Path(path)
    if not file.is_file():
        named = configs_folder() / "families" / f"{path}.toml"
        if not named.is_file() or named.parent.resolve() not in named.resolve().parents:
            ready = ", ".join(sorted(p.stem for p in (configs_folder() / "families").glob("*.toml")))
            raise ConfigError("no such file", where=str(path), expected=f"a TOML file, or one of {ready}")
        file = named
    try:
        family = Family.model_validate(read_toml(file))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = f"{file} {'.'.join(map(str, first['loc']))}"
        raise ConfigError(first["msg"], where=where, got=repr(first["input"])[:60]) from None
    beside = file.parent / family.base  # as in a study's file
    return family.model_copy(update={"base": str(beside)}) if beside.suffix == ".toml" else family


class _ValueModel(Model):
    value: float
    tolerance: Annotated[float, Field(gt=0.0)]
    unit: str
    grades: tuple[Grade, ...] = ()
    mistakes: dict[str, float] = Field(default_factory=dict)


class _ExpectedModel(Model):
    schema_: Literal[1] = Field(alias="schema")
    member: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,80}$")
    indicators: dict[str, _ValueModel] = Field(default_factory=dict)
    constants: dict[str, _ValueModel] = Field(default_factory=dict)
    mounting: dict[str, _ValueModel] = Field(default_factory=dict)
    clauses: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    made_of: str = ""
    may_fail: tuple[str, ...] = ()


def read_expected(path: Path) -> Expected:
    """One expected file.

    Raises
    ------
    CampaignError
        Not such a file.
    """
    try:
        if path.stat().st_size > 5_000_000:
            raise CampaignError("is too large", where=str(path))
        model = _ExpectedModel.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise CampaignError("cannot be read", where=str(path), got=error.strerror) from None
    except (ValueError, RecursionError) as error:
        raise CampaignError("is no expected file of a family", where=str(path), got=str(error)[:100]) from None
    block = model.model_dump()

    def values(key: str) -> dict[str, Value]:
        return {name: Value(**value) for name, value in block[key].items()}

    return Expected(
        member=model.member,
        indicators=values("indicators"),
        constants=values("constants"),
        mounting=values("mounting"),
        clauses=model.clauses,
        may_fail=model.may_fail,
    )
