"""table.parquet: one row for each point, in the order of the design, whoever ran it and wherever. What it was made from is in the
file's metadata (`study`, `base`). The run time has a column of its own; without it the table depends on nothing but the study.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from campaign.writing.atomic import complete_file
from testrange.study.execution.responses import column
from testrange.study.model import RUN_TIME, Study
from testrange.study.plan import Plan, Point

if TYPE_CHECKING:
    import pyarrow as pa  # type: ignore[import-untyped]

Outcomes = Mapping[str, Mapping[str, Any]]


def point_rows(plan: Plan, outcomes: Outcomes) -> list[dict[str, Any]]:
    """All points as plain rows; a point without an outcome is `missing`."""
    return [_row(plan.study, point, outcomes.get(point.id)) for point in plan.points]


def write_table(path: Path, plan: Plan, rows: Sequence[Mapping[str, Any]], texts: Mapping[str, str]) -> None:
    """Writes the table.

    Parameters
    ----------
    texts : mapping of str to str
        Metadata: the study file, the base configuration.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq  # type: ignore[import-untyped]

    names = list(rows[0])
    factors = {f.name for f in plan.study.factor}
    arrays = [_array([row[name] for row in rows], name, name in factors) for name in names]
    table = pa.table(dict(zip(names, arrays))).replace_schema_metadata(dict(texts))
    with complete_file(path) as work:
        pq.write_table(table, work, compression="zstd")


def _row(study: Study, point: Point, outcome: Mapping[str, Any] | None) -> dict[str, Any]:
    found = outcome or {"status": "missing", "reason": "not run yet", "values": {}, "versions": {}, RUN_TIME: None}
    row: dict[str, Any] = {"id": point.id, "row": point.row, **point.factors}
    row |= {"replicate": point.replicate, "seed": point.seed}
    for name in study.responses:
        if name == RUN_TIME:
            continue
        value = found["values"].get(name, {})
        row[column(name)] = _float(value.get("value"))
        if study.base is not None:
            row[f"{column(name)}.std"] = _float(value.get("std"))
        if name.startswith("indicators."):
            row[f"{column(name)}.grade"] = value.get("grade")
        row[f"{column(name)}.reason"] = value.get("reason")
    row |= {"status": found["status"], "reason": found["reason"], "geometry": point.group}
    row |= {"settings": json.dumps(point.settings, ensure_ascii=False)}
    row |= {"versions": json.dumps(found["versions"], sort_keys=True), RUN_TIME: _float(found[RUN_TIME])}
    return row


def _float(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _array(values: list[Any], name: str, factor: bool) -> "pa.Array":
    """A column of one type: what is not the same type in every row is text; a response is a number also where all are absent."""
    import pyarrow as pa

    kinds = {type(v) for v in values if v is not None}
    if kinds <= {int, float} and float in kinds:
        return pa.array([None if v is None else float(v) for v in values], pa.float64())
    if len(kinds) == 1:
        return pa.array(values)
    if kinds:
        return pa.array([None if v is None else str(v) for v in values], pa.string())
    text = factor or name.endswith((".grade", ".reason")) or name == "reason"
    return pa.array(values, pa.string() if text else pa.float64())
