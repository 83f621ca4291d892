"""The comparison on the terminal: failures, errors by algorithm, differences that are told apart. At most 100 columns."""

from rich.console import Console
from rich.text import Text

from testrange.compare.run import Comparison
from testrange.compare.statistics import same_for_all, summaries
from testrange.compare.write import number
from testrange.tables import _table as table

_WIDTH_OF_NAMES = 60  # beyond which columns get letters


def print_comparison(comparison: Comparison, out: Console) -> None:
    names = [c.name for c in comparison.contenders]
    heads = names
    if sum(len(n) + 2 for n in names) > _WIDTH_OF_NAMES:
        heads = [chr(ord("A") + k) for k in range(len(names))]
        for head, name in zip(heads, names, strict=True):
            out.print(Text(f"{head}: {name}"))
    rows = summaries(comparison.outcomes, names)
    alike = same_for_all(comparison.outcomes)
    count = len(comparison.campaigns)
    title = f"RMS error against truth/, {count} campaign{'s' if count > 1 else ''}"
    shown = table(title, [("quantity", "left"), ("n", "right"), *((n, "right") for n in heads)])
    for quantity in dict.fromkeys(r.quantity for r in rows if r.quantity not in alike):
        mine = {r.contender: r for r in rows if r.quantity == quantity}
        first = next(iter(mine.values()))
        cells = [number(mine[n].rms) if n in mine else "–" for n in names]
        shown.add_row(Text(f"{quantity} [{first.unit}]"), str(max(r.items for r in mine.values())), *cells)
    if rows:
        out.print(shown)
        if alike:
            out.print(Text(f"the same for all: {len(alike)} quantities that no algorithm here touches", style="dim"))
    else:
        out.print("no errors: no campaign with truth/, or no results")
    told = [d for d in comparison.differences if d.absolute.verdict]
    if told:
        shown = table(
            "told apart: |error|, first minus second",
            (("quantity", "left"), ("better", "left"), ("than", "left"), ("by", "right"), ("95 %", "right")),
        )
        for d in told:
            better, worse = (d.first, d.second) if d.absolute.verdict < 0 else (d.second, d.first)
            sign = -1.0 if d.absolute.verdict < 0 else 1.0
            bounds = sorted(sign * v for v in (d.absolute.low or 0.0, d.absolute.high or 0.0))
            interval = f"{number(bounds[0])} … {number(bounds[1])}"
            shown.add_row(Text(f"{d.quantity} [{d.unit}]"), better, worse, number(sign * d.absolute.mean), interval)
        out.print(shown)
        for method in dict.fromkeys(d.method for d in told):
            out.print(Text(f"intervals: {method}", style="dim"))
    shown = table("run time [s]", [("campaign", "left"), *((n, "right") for n in heads)])
    for campaign in comparison.campaigns:
        seconds = [o.seconds for o in comparison.outcomes if o.campaign == campaign]
        shown.add_row(Text(campaign), *("–" if s is None else f"{s:.1f}" for s in seconds))
    out.print(shown)
    for o in comparison.outcomes:
        if o.reason:
            out.print(Text(f"failed: {o.contender} on {o.campaign}: {o.reason}", style="red"))
        for line in o.failures:
            out.print(Text(f"{o.contender} on {o.campaign}: {line}", style="yellow"))
