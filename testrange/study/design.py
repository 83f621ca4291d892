"""Factors to rows: which value every factor has in every row of a design. SALib draws the samples; the order is the table's."""

import itertools
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from campaign.errors import ConfigError
from testrange.study.model import MAX_POINTS, SAMPLED, Factor, Level, Study, Value

Row = tuple[Value | Level, ...]  # one entry for each factor of the study, in its order


def design_rows(study: Study) -> list[Row]:
    """All rows of the design, without replicates.

    grid    every combination, the last factor fastest
    list    the first values of all factors, then the second ...
    lhs, sobol, morris   SALib's samples in SALib's order, so that its analyses can be applied to the table
    """
    if study.design in SAMPLED:
        return _sampled(study)
    levels = [_levels(factor) for factor in study.factor]
    names = [[_key(level) for level in found] for found in levels]
    if study.design == "list":
        if len({len(found) for found in levels}) > 1:
            told = ", ".join(f"{f.name} {len(found)}" for f, found in zip(study.factor, levels))
            raise ConfigError("design = list takes the same number of values of each factor", got=told)
        _refuse_many(len(levels[0]) * study.replicates)
        _refuse_twice(list(zip(*names)), "rows")
        return list(zip(*levels))
    for factor, given in zip(study.factor, names):
        _refuse_twice(given, f"values of factor {factor.name}")
    _refuse_many(math.prod(len(found) for found in levels) * study.replicates)
    return list(itertools.product(*levels))


def problem(study: Study) -> dict[str, Any]:
    """SALib's description of the factors, on the axes that are sampled (the logarithm of a `log` factor)."""
    return {
        "num_vars": len(study.factor),
        "names": [factor.name for factor in study.factor],
        "bounds": [_bounds(factor) for factor in study.factor],
    }


def on_axis(factor: Factor, value: float) -> float:
    """Where a value stands on the axis that is sampled."""
    return math.log10(value) if factor.log else value


def _levels(factor: Factor) -> tuple[Value | Level, ...]:
    return factor.level or factor.values or ()


def _bounds(factor: Factor) -> list[float]:
    assert factor.range is not None  # the study's own check
    return [on_axis(factor, bound) for bound in factor.range]


def _sampled(study: Study) -> list[Row]:
    from SALib.sample import latin, morris, sobol  # type: ignore[import-untyped]

    count, k, seed = study.samples or 1, len(study.factor), study.design_seed
    per_sample = {"lhs": 1, "sobol": 2 * k + 2 if study.second_order else k + 2, "morris": k + 1}[study.design]
    _refuse_many(count * per_sample * study.replicates)
    described = problem(study)
    if study.design == "lhs":
        drawn = latin.sample(described, count, seed=seed)
    elif study.design == "sobol":
        drawn = sobol.sample(described, count, calc_second_order=study.second_order, seed=seed)
    else:
        for factor in study.factor:
            _refuse_rounding(factor, study.grid_levels)
        drawn = morris.sample(described, count, num_levels=study.grid_levels, seed=seed)
    return [tuple(_value(f, float(x)) for f, x in zip(study.factor, row)) for row in np.asarray(drawn)]


def _refuse_rounding(factor: Factor, levels: int) -> None:
    """An elementary effect is divided by the step between levels, which rounding must not change."""
    if not factor.whole:
        return
    low, high = _bounds(factor)
    places = np.linspace(low, high, levels)
    rounded = np.rint(10.0**places) if factor.log else np.rint(places)
    met = np.log10(np.maximum(rounded, 1e-9)) if factor.log else rounded
    if np.abs(met - places).max() > 0.02 * (high - low):
        raise ConfigError(
            f"the {levels} levels of a Morris design are no whole numbers here",
            where=f"factor {factor.name}",
            got=f"range {factor.range}",
            remedy=f"take a range that {levels - 1} divides, another grid_levels, or leave out whole",
        )


def _value(factor: Factor, drawn: float) -> Value:
    value = 10.0**drawn if factor.log else drawn
    return round(value) if factor.whole else float(f"{value:.12g}")


def _key(level: Value | Level) -> Value:
    """What tells a level from others in the table."""
    if isinstance(level, Level):
        return level.name
    return json.dumps(level) if isinstance(level, list) else level


def _refuse_twice(found: Sequence[object], what: str) -> None:
    if len(set(found)) < len(found):
        raise ConfigError(f"two {what} are the same", remedy="replicates = 2 repeats a point with other noise")


def _refuse_many(points: int) -> None:
    if points > MAX_POINTS:
        raise ConfigError("too many points", got=points, expected=f"at most {MAX_POINTS}", remedy="take fewer samples")
