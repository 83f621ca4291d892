"""Points of a study: configuration, identity, geometry group, shard. Nothing is simulated here.

A point's id is a hash of everything that its result depends on, so that a finished point is found again whatever else the
study file says, and a changed one is not. Noise: replicate r of a row has a seed of its own; scene, flight and render samples
keep the base's, so that replicates share their renders.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from campaign.config import Config
from campaign.errors import ConfigError
from campaign.load import load_config
from testrange.study.design import Row, design_rows
from testrange.study.execution.callables import module_file
from testrange.study.execution.versions import versions
from testrange.study.model import RUN_TIME, Factor, Level, Study, Value

# What no rendered frame depends on. Anything else that differs is another geometry: at worst a frame is rendered twice.
_NOT_SEEN = ("seed", "navigation", "bench", "ranging", "recording", "schema_version")
_NOT_SEEN_LIDAR = frozenset({"scanner"})  # the scanner's sector bounds the field in which targets stand
_SEEN_FAULTS = ("camera_boresight_deg", "camera_lever_arm_m", "principal_distance_px", "principal_point_px", "k1")


@dataclass(frozen=True, kw_only=True)
class Point:
    """One task: what varies, and what is to be simulated; `reason` where the configuration is wrong."""

    id: str
    row: int  # of the design, from 0
    factors: Mapping[str, Value]  # for the table: a level's value, or its name
    labels: Mapping[str, str]  # for people
    replicate: int
    seed: int
    settings: tuple[str, ...]
    group: str  # points of one group share their renders
    config: Config | None = None  # absent for a callable, and where it is wrong
    reason: str | None = None


@dataclass(frozen=True, kw_only=True)
class Plan:
    """All points of a study, in the order of its table."""

    study: Study
    rows: tuple[Row, ...]
    points: tuple[Point, ...]

    @property
    def groups(self) -> tuple[str, ...]:
        """Geometry groups in the order of their first points."""
        return tuple(dict.fromkeys(p.group for p in self.points))

    def shard(self, number: int, of: int) -> tuple[Point, ...]:
        """Points of every `of`-th group, beginning with the `number`-th: one job of an array. A group is never split."""
        mine = set(self.groups[number - 1 :: of])
        return tuple(p for p in self.points if p.group in mine)


def make_plan(study: Study, file: Path) -> Plan:
    """Rows, replicates and configurations of a study.

    Raises
    ------
    ConfigError
        The base, or a setting of every point, is wrong. A configuration that only some levels make impossible is a failed
        point, and its reason is in the table.
    """
    rows = tuple(design_rows(study))
    base = None if study.base is None else load_config(base_of(study.base, file), study.set)
    code = None if study.callable is None else _code(study.callable, file)
    points = [
        _point(study, file, base, code, number, row, replicate)
        for number, row in enumerate(rows)
        for replicate in range(study.replicates)
    ]
    if base is not None and all(p.reason for p in points):
        raise ConfigError(
            f"no point has a configuration that can be simulated; the first: {points[0].reason}", where=str(file)
        )
    return Plan(study=study, rows=rows, points=tuple(points))


def settings_of(study: Study, row: Row) -> tuple[str, ...]:
    """What a row sets, as after --set."""
    out: list[str] = []
    for factor, value in zip(study.factor, row):
        if isinstance(value, Level):
            out += value.set
        elif factor.key is not None:
            out.append(f"{factor.key}={_toml(value)}")
        else:
            for key, times in factor.moves.items():
                out.append(f"{key}={_toml(_moved(float(value), times))}")  # type: ignore[arg-type]
    return tuple(out)


def task(plan: Plan, point: Point, *, out: Path, file: Path, cache: bool) -> dict[str, Any]:
    """What a worker is given: plain values, whatever machine it runs on."""
    return {
        "id": point.id,
        "factors": dict(point.factors),
        "seed": point.seed,
        "responses": [name for name in plan.study.responses if name != RUN_TIME],
        "callable": plan.study.callable,
        "folder": str(file.resolve().parent),
        "config": None if point.config is None else point.config.model_dump(mode="json", exclude_none=True),
        "cache": str((out / "cache").resolve()) if cache else None,
        "work": str((out / "work" / point.id).resolve()),
        "keep": str((out / "runs" / point.id).resolve()) if plan.study.keep else None,
    }


def value_and_label(factor: Factor, value: Value | Level) -> tuple[Value, str]:
    """What stands in the table, and what is shown."""
    if isinstance(value, Level):
        return (value.name if value.value is None else value.value), value.name
    if isinstance(value, list):
        text = json.dumps(value, ensure_ascii=False)
        return text, text
    return value, f"{value:g}" if isinstance(value, float) else str(value)


def base_of(base: str, file: Path) -> Path | str:
    """A path is relative to the study file; a bare name is one of configs/campaigns."""
    beside = file.parent / base
    return beside if Path(base).suffix == ".toml" and not Path(base).is_absolute() else base


def _point(
    study: Study, file: Path, base: Config | None, code: list[str] | None, number: int, row: Row, replicate: int
) -> Point:
    shown = [value_and_label(factor, value) for factor, value in zip(study.factor, row)]
    factors = {factor.name: value for factor, (value, _) in zip(study.factor, shown)}
    settings = settings_of(study, row) if base is not None else ()
    seed = 0 if base is None else base.seed
    seed = _seed(seed, [settings, factors], replicate)
    config, reason = None, None
    if base is not None and study.base is not None:
        fixed = {s.partition("=")[0].strip() for s in settings}
        if base.scene_seed is None and "scene_seed" not in fixed:
            settings = (f"scene_seed={base.seed}", *settings)
        if "seed" not in fixed:
            settings = (f"seed={seed}", *settings)
        try:
            config = load_config(base_of(study.base, file), (*study.set, *settings))
            seed = config.seed
        except ConfigError as error:
            reason = str(error)
    body = None if config is None else _without_cache(config)
    return Point(
        id=_hash(
            body,
            settings if body is None else None,
            code if body is None else [code, versions()["code"]],
            factors if body is None else None,
            seed,
            study.responses,
        )[:20],
        row=number,
        factors=factors,
        labels={factor.name: label for factor, (_, label) in zip(study.factor, shown)},
        replicate=replicate,
        seed=seed,
        settings=settings,
        group=_group(body, factors),
        config=config,
        reason=reason,
    )


def _code(callable_name: str, file: Path) -> list[str]:
    """Name of a callable, and what its module says where it stands beside the study: another text is another response."""
    module = module_file(callable_name, str(file.resolve().parent))
    return [callable_name, "" if module is None else hashlib.sha256(module.read_bytes()).hexdigest()]


def _without_cache(config: Config) -> dict[str, Any]:
    body: dict[str, Any] = config.model_dump(mode="json", exclude_none=True)
    for place in ("cache", "cache_limit_gb"):
        body["render"].pop(place, None)
    return body


def _group(body: dict[str, Any] | None, factors: Mapping[str, Value]) -> str:
    """Hash of all that a frame depends on; of the factors where nothing is rendered."""
    if body is None:
        return _hash(factors)[:12]
    seen = {key: value for key, value in body.items() if key not in _NOT_SEEN}
    seen["campaign"] = [body["campaign"]["start_time"], "camera" in body["campaign"]["parts"]]
    seen["lidar"] = {key: value for key, value in body["lidar"].items() if key in _NOT_SEEN_LIDAR}
    seen["faults"] = {key: body["faults"][key] for key in _SEEN_FAULTS}
    seen["targets"] = {key: value for key, value in body["targets"].items() if key != "survey"}
    seen["rate"] = body["navigation"]["rate_hz"]
    return _hash(seen)[:12]


def _hash(*parts: object) -> str:
    text = json.dumps([versions()["testrange"], *parts], sort_keys=True, ensure_ascii=False, default=list)
    return hashlib.sha256(text.encode()).hexdigest()


def _seed(base: int, what: Sequence[object], replicate: int) -> int:
    """Noise of one point: another for every row and replicate, the same when the study grows."""
    return int(_hash(base, what, replicate)[:7], 16)


def _moved(value: float, times: float | tuple[float, ...]) -> Value:
    if isinstance(times, tuple):
        return [float(f"{value * t:.12g}") for t in times]
    return float(f"{value * times:.12g}")


def _toml(value: Value) -> str:
    """A TOML value on one line; JSON's form of numbers, texts and lists is TOML's."""
    return json.dumps(value, ensure_ascii=False)
