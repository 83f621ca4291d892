"""The judge's report on a terminal: what is wrong, by which mistake; then one row a formula."""

from rich.console import Console
from rich.table import Table
from rich.text import Text

from testrange.pairs.verify import Report, Verdict
from testrange.tables import console

_MOST_ROWS = 60


def print_report(report: Report, to: Console | None = None) -> None:
    """Wrong answers first, then the count by formula."""
    out = to or console()
    wrong = report.of("wrong")
    if wrong:
        table = Table(title=f"wrong: {len(wrong)}", title_justify="left", box=None, padding=(0, 2, 0, 0))
        table.add_column("pair", overflow="fold")
        table.add_column("formula")
        table.add_column("tolerances off", justify="right")
        table.add_column("mistake", overflow="fold")
        for v in wrong[:_MOST_ROWS]:
            table.add_row(v.pair, Text(v.formula), _off(v), Text(v.mistake or v.remark or "none that is known"))
        out.print(table)
        if len(wrong) > _MOST_ROWS:
            out.print(f"and {len(wrong) - _MOST_ROWS} more; --json has them all")
        out.print()
    table = Table(box=None, padding=(0, 2, 0, 0))
    table.add_column("formula")
    for heading in ("right", "wrong", "missing"):
        table.add_column(heading, justify="right")
    table.add_column("greatest error of a right one, tolerances", justify="right")
    for formula in dict.fromkeys(v.formula for v in report.verdicts):
        own = [v for v in report.verdicts if v.formula == formula]
        count = [sum(v.status == s for v in own) for s in ("right", "wrong", "missing")]
        errors = [v.error_in_tolerances for v in own if v.status == "right" and v.error_in_tolerances is not None]
        table.add_row(Text(formula), *(str(c or "") for c in count), f"{max(errors):.1e}" if errors else "")
    out.print(table)
    total = {s: len(report.of(s)) for s in ("right", "wrong", "missing")}
    out.print(f"{total['right']} right, {total['wrong']} wrong, {total['missing']} missing")
    for name, ids in report.mistakes.items():
        out.print(Text(f"mistake: {name} ({len(ids)} pair{'s' if len(ids) > 1 else ''})"))
    if report.unknown:
        shown = ", ".join(report.unknown[:5]) + (" ..." if len(report.unknown) > 5 else "")
        out.print(Text(f"answers to no pair: {len(report.unknown)}: {shown}"))


def _off(v: Verdict) -> str:
    return "" if v.error_in_tolerances is None else f"{v.error_in_tolerances:.3g}"
