"""What `testrange study` prints when it has ended."""

from typing import Any

from testrange.study.run import Done
from testrange.tables import console

SHOWN_FAILURES = 5


def summary(done: Done) -> dict[str, Any]:
    """For --json."""
    return {
        "study": done.study.title,
        "folder": str(done.out),
        "page": None if done.page is None else str(done.page),
        "points": {status: done.count(status) for status in ("done", "failed", "missing")},
        "ran": done.ran,
        "geometries": len(done.plan.groups),
        "cache_mb": round(done.cache_mb, 1),
        "failed": [{"id": r["id"], "reason": r["reason"]} for r in done.rows if r["status"] == "failed"],
        "effects": [effects.block() for effects in done.effects],
    }


def print_done(done: Done) -> None:
    """Counts, failures and the strongest factor of each response."""
    out = console()
    counts = ", ".join(f"{done.count(s)} {s}" for s in ("done", "failed", "missing") if done.count(s))
    out.print(f"{done.study.title}: {counts} of {len(done.rows)} points; {done.ran} run now", markup=False)
    failed = [row for row in done.rows if row["status"] == "failed"]
    for row in failed[:SHOWN_FAILURES]:
        where = ", ".join(f"{f.name} {row[f.name]}" for f in done.study.factor)
        out.print(f"  failed: {where}: {row['reason']}", markup=False)
    if len(failed) > SHOWN_FAILURES:
        out.print(f"  and {len(failed) - SHOWN_FAILURES} more, in the table")
    for effects in done.effects:
        for line in _strongest(effects):
            out.print(f"  {line}", markup=False)
    if done.page is None:
        out.print("one shard: the same command without --shard makes table and page when all are done", markup=False)
    else:
        out.print(f"page: {done.page}\ntable: {done.out / 'table.parquet'}", markup=False, soft_wrap=True)
    if done.cache_mb > 0.0:
        out.print(
            f"renders kept: {done.cache_mb:,.0f} MB in {done.out / 'cache'}; --drop-cache removes them", soft_wrap=True
        )


def _strongest(effects: Any) -> list[str]:
    """One line for each factor of a response."""
    if effects.note and not (effects.main or effects.indices):
        return [f"{effects.response}: {effects.note}"]
    lines = [
        f"{effects.response}: {m.factor} {m.effect:+.4g} [{m.low_95:+.4g}, {m.high_95:+.4g}] {effects.unit}"
        for m in effects.main
    ]
    for i in effects.indices:
        if i.total is not None:
            lines.append(
                f"{effects.response}: {i.factor} first {i.first:.3f} ± {i.first_95:.3f}, "
                f"total {i.total:.3f} ± {i.total_95:.3f}"
            )
        else:
            lines.append(
                f"{effects.response}: {i.factor} mu* {i.mu_star:.4g} ± {i.mu_star_95:.4g}, sigma {i.sigma:.4g}"
            )
    return lines
