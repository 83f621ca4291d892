"""What a finished table says: main effects, Sobol and Morris indices, curves with bands, grades. Numbers only; figures elsewhere.

Points that failed, or that have no value of a response, are left out of it and counted. Intervals are at 95 %.

References
----------
Sobol indices: Saltelli et al., Comput. Phys. Commun. 181 (2010) 259-270; intervals by bootstrap (SALib).
Morris: Technometrics 33 (1991) 161-174, mu* after Campolongo et al., Environ. Model. Softw. 22 (2007) 1509-1518 (SALib).
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import stats

from testrange.study.design import on_axis, problem
from testrange.study.execution.responses import column
from testrange.study.model import SAMPLED, Study, Value
from testrange.study.plan import Plan

RESAMPLES = 1000
_SEED = 20220415  # of the bootstrap: the same table gives the same intervals
GRADES = ("excellent", "good", "fair", "ungraded", "not_measured", "failed")


@dataclass(frozen=True, kw_only=True)
class LevelMean:
    """Mean of a response over all points with one level of a factor."""

    level: Value
    label: str
    mean: float
    low_95: float
    high_95: float
    points: int


@dataclass(frozen=True, kw_only=True)
class MainEffect:
    """What one factor does, averaged over all others."""

    factor: str
    effect: (
        float  # grid, list: greatest minus least level mean; samples: change over the factor's range by a straight line
    )
    low_95: float
    high_95: float
    p_value: float  # that the factor does nothing: F test of the additive model
    levels: tuple[LevelMean, ...]  # empty for samples


@dataclass(frozen=True, kw_only=True)
class Index:
    """Sobol or Morris indices of one factor, with half widths of their 95 % intervals."""

    factor: str
    first: float | None = None
    first_95: float | None = None
    total: float | None = None
    total_95: float | None = None
    mu: float | None = None
    mu_star: float | None = None
    mu_star_95: float | None = None
    sigma: float | None = None


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Second-order Sobol index of two factors."""

    first_factor: str
    second_factor: str
    index: float
    index_95: float


@dataclass(frozen=True, kw_only=True)
class Effects:
    """Everything about one response."""

    response: str  # column of the table
    unit: str
    points: int  # with a value
    left_out: int
    mean: float | None
    noise_std: float | None  # of one point, from replicates
    noise_freedom: int
    interval_from: str  # what the intervals of level means rest on
    main: tuple[MainEffect, ...]
    indices: tuple[Index, ...]
    pairs: tuple[Pair, ...]
    note: str

    def block(self) -> dict[str, Any]:
        """For analysis.json."""
        out: dict[str, Any] = asdict(self)
        return out


def analyse(plan: Plan, rows: Sequence[Mapping[str, Any]], units: Mapping[str, str]) -> tuple[Effects, ...]:
    """Effects of every response of the study."""
    return tuple(_effects(plan, rows, column(name), units.get(column(name), "")) for name in plan.study.responses)


def grade_shares(
    rows: Sequence[Mapping[str, Any]], indicator: str, factors: Sequence[str]
) -> dict[tuple[Value, ...], dict[str, float]]:
    """Share of each grade among all points of a cell: levels of `factors` -> grade -> share. A failed point is `failed`."""
    cells: dict[tuple[Value, ...], list[str]] = {}
    for row in rows:
        if row["status"] == "missing":
            continue
        grade = row[f"{indicator}.grade"] if row["status"] == "done" else "failed"
        cells.setdefault(tuple(row[f] for f in factors), []).append(grade or "not_measured")
    return {cell: {g: found.count(g) / len(found) for g in GRADES if g in found} for cell, found in cells.items()}


def cell_means(
    rows: Sequence[Mapping[str, Any]], response: str, factors: Sequence[str]
) -> dict[tuple[Value, ...], tuple[float, float, int]]:
    """Mean, standard deviation (NaN for one point) and number of points of every cell."""
    cells: dict[tuple[Value, ...], list[float]] = {}
    for row in rows:
        if row[response] is not None and math.isfinite(row[response]):
            cells.setdefault(tuple(row[f] for f in factors), []).append(row[response])
    return {
        c: (float(np.mean(v)), float(np.std(v, ddof=1)) if len(v) > 1 else math.nan, len(v)) for c, v in cells.items()
    }


def _effects(plan: Plan, rows: Sequence[Mapping[str, Any]], response: str, unit: str) -> Effects:
    study = plan.study
    have = [row for row in rows if row[response] is not None and math.isfinite(row[response])]
    values = np.array([row[response] for row in have], dtype=float)
    noise, freedom = _noise(have, response)
    main: tuple[MainEffect, ...] = ()
    indices: tuple[Index, ...] = ()
    pairs: tuple[Pair, ...] = ()
    source, note = "", ""
    if len(values) < 2 or not np.ptp(values) > 0.0:
        note = "no value" if not len(values) else "the same value in every point: nothing to tell apart"
    elif study.design in ("sobol", "morris"):
        by_row = _row_means(rows, response, len(plan.rows))
        if study.design == "sobol":
            indices, pairs, note = _sobol(study, by_row)
        else:
            indices, note = _morris(plan, by_row)
    else:
        fitted = _additive(study, have, values, noise, freedom)
        if fitted is None:
            note = "too few points for main effects"
        else:
            main, source = fitted
    return Effects(
        response=response,
        unit=unit,
        points=len(values),
        left_out=len(rows) - len(have),
        mean=float(values.mean()) if len(values) else None,
        noise_std=noise,
        noise_freedom=freedom,
        interval_from=source,
        main=main,
        indices=indices,
        pairs=pairs,
        note=note,
    )


def _noise(have: Sequence[Mapping[str, Any]], response: str) -> tuple[float | None, int]:
    """Standard deviation of one point from the replicates of all rows, pooled, and its degrees of freedom."""
    by_row: dict[int, list[float]] = {}
    for row in have:
        by_row.setdefault(row["row"], []).append(row[response])
    freedom = sum(len(v) - 1 for v in by_row.values())
    if freedom == 0:
        return None, 0
    return math.sqrt(sum(float(np.sum((np.array(v) - np.mean(v)) ** 2)) for v in by_row.values()) / freedom), freedom


def _design_matrix(
    study: Study, have: Sequence[Mapping[str, Any]]
) -> tuple[np.ndarray, list[slice], list[list[Value]]]:
    """Constant, then for each factor one column a level after the first (grid, list), or its place in its range (samples)."""
    columns, places = [np.ones(len(have))], []
    levels: list[list[Value]] = []
    for factor in study.factor:
        given = [row[factor.name] for row in have]
        start = len(columns)
        if study.design in SAMPLED:
            low, high = (on_axis(factor, bound) for bound in factor.range or (0.0, 1.0))
            columns.append(np.array([(on_axis(factor, float(v)) - low) / (high - low) for v in given]))
            levels.append([])
        else:
            found = list(dict.fromkeys(given))
            columns += [np.array([v == level for v in given], dtype=float) for level in found[1:]]
            levels.append(found)
        places.append(slice(start, len(columns)))
    return np.stack(columns, axis=1), places, levels


def _additive(
    study: Study, have: Sequence[Mapping[str, Any]], values: np.ndarray, noise: float | None, freedom: int
) -> tuple[tuple[MainEffect, ...], str] | None:
    """Main effects by least squares of an additive model, so that missing points do no harm.

    The variance is that of replicates where there are some, else that of what the additive model leaves (interactions and
    noise together).
    """
    matrix, places, levels = _design_matrix(study, have)
    rank = int(np.linalg.matrix_rank(matrix))
    solution, *_ = np.linalg.lstsq(matrix, values, rcond=None)
    left = values - matrix @ solution
    if noise is not None and freedom >= 2:
        variance, source = noise**2, f"replicates ({freedom} degrees of freedom)"
    elif len(values) > rank:
        freedom = len(values) - rank
        variance, source = float(left @ left) / freedom, f"what an additive model leaves ({freedom} degrees of freedom)"
    else:
        return None
    inverse = np.linalg.pinv(matrix.T @ matrix)
    t = float(stats.t.ppf(0.975, freedom))
    rounding = len(values) * (1e-12 * float(np.abs(values).max())) ** 2  # sum of squares that is none
    out = []
    for factor, place, found in zip(study.factor, places, levels):
        others = np.delete(matrix, place, axis=1)
        more = float(np.sum((values - others @ np.linalg.lstsq(others, values, rcond=None)[0]) ** 2) - left @ left)
        count = rank - int(np.linalg.matrix_rank(others))
        if count == 0 or more <= rounding:
            p = 1.0
        else:
            p = float(stats.f.sf(more / count / variance, count, freedom)) if variance > 0.0 else 0.0
        points = Counter(row[factor.name] for row in have)
        contrasts = _contrasts(matrix, place, len(found))
        means = contrasts @ solution
        half = t * np.sqrt(np.maximum(variance * np.sum((contrasts @ inverse) * contrasts, axis=1), 0.0))
        if found:
            most, least = int(np.argmax(means)), int(np.argmin(means))
            sign = 1.0 if most > least else -1.0  # rising or falling in the order of the levels
            difference = sign * (contrasts[most] - contrasts[least])
        else:
            difference = np.zeros(matrix.shape[1])
            difference[place] = 1.0
        effect = float(difference @ solution)
        width = t * math.sqrt(max(variance * float(difference @ inverse @ difference), 0.0))
        out.append(
            MainEffect(
                factor=factor.name,
                effect=effect,
                low_95=effect - width,
                high_95=effect + width,
                p_value=p,
                levels=tuple(
                    LevelMean(
                        level=level,
                        label=f"{level:g}" if isinstance(level, float) else str(level),
                        mean=float(means[k]),
                        low_95=float(means[k] - half[k]),
                        high_95=float(means[k] + half[k]),
                        points=points[level],
                    )
                    for k, level in enumerate(found)
                ),
            )
        )
    return tuple(out), source


def _contrasts(matrix: np.ndarray, place: slice, levels: int) -> np.ndarray:
    """(levels, parameters): mean response at each level of one factor, all other columns at their means."""
    out = np.repeat(matrix.mean(axis=0)[None], levels, axis=0)
    out[:, place] = np.eye(levels)[:, 1:] if levels else 0.0
    return out


def _row_means(rows: Sequence[Mapping[str, Any]], response: str, count: int) -> np.ndarray:
    """(count,) mean over the replicates of each row, NaN where one has no value."""
    out: list[list[float]] = [[] for _ in range(count)]
    for row in rows:
        out[row["row"]].append(math.nan if row[response] is None else row[response])
    return np.array([float(np.mean(v)) for v in out])


def _blocks(values: np.ndarray, size: int) -> tuple[np.ndarray, str]:
    """Which blocks of `size` rows are complete, and what to say of the others."""
    complete = np.isfinite(values.reshape(-1, size)).all(axis=1)
    lost = int((~complete).sum())
    note = f"{lost} of {len(complete)} sample blocks left out: a point of each has no value" if lost else ""
    return complete, note


def _sobol(study: Study, values: np.ndarray) -> tuple[tuple[Index, ...], tuple[Pair, ...], str]:
    from SALib.analyze import sobol  # type: ignore[import-untyped]

    k = len(study.factor)
    size = 2 * k + 2 if study.second_order else k + 2
    complete, note = _blocks(values, size)
    if complete.sum() < 4:
        return (), (), f"too few complete sample blocks. {note}"
    used = values.reshape(-1, size)[complete].ravel()
    found = sobol.analyze(
        problem(study), used, calc_second_order=study.second_order, num_resamples=RESAMPLES, seed=_SEED
    )
    indices = tuple(
        Index(
            factor=factor.name,
            first=float(found["S1"][i]),
            first_95=float(found["S1_conf"][i]),
            total=float(found["ST"][i]),
            total_95=float(found["ST_conf"][i]),
        )
        for i, factor in enumerate(study.factor)
    )
    pairs = tuple(
        Pair(
            first_factor=study.factor[i].name,
            second_factor=study.factor[j].name,
            index=float(found["S2"][i, j]),
            index_95=float(found["S2_conf"][i, j]),
        )
        for i in range(k)
        for j in range(i + 1, k)
        if study.second_order
    )
    return indices, pairs, note


def _morris(plan: Plan, values: np.ndarray) -> tuple[tuple[Index, ...], str]:
    from SALib.analyze import morris

    study = plan.study
    size = len(study.factor) + 1
    complete, note = _blocks(values, size)
    if complete.sum() < 2:
        return (), f"too few complete trajectories. {note}"
    drawn = np.array(
        [[on_axis(f, float(v)) for f, v in zip(study.factor, row)] for row in plan.rows]  # type: ignore[arg-type]
    )
    keep = np.repeat(complete, size)
    found = morris.analyze(
        problem(study),
        drawn[keep],
        values[keep],
        num_levels=study.grid_levels,
        num_resamples=RESAMPLES,
        seed=_SEED,
    )
    indices = tuple(
        Index(
            factor=factor.name,
            mu=float(found["mu"][i]),
            mu_star=float(found["mu_star"][i]),
            mu_star_95=float(found["mu_star_conf"][i]),
            sigma=float(found["sigma"][i]),
        )
        for i, factor in enumerate(study.factor)
    )
    return indices, note
