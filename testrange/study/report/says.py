"""What a study says, in sentences with their uncertainty; no figure and no page."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from evaluator.c10_1_grading import GRADE_ZH, INDICATORS
from testrange.study.effects import Effects, MainEffect, grade_shares
from testrange.study.model import SAMPLED, Study

_P = 0.05


def sentences(study: Study, effects: Effects, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What was found about one response."""
    out: list[str] = []
    if effects.mean is None:
        return [_why_none(effects, rows)]
    unit = f" {effects.unit}" if effects.unit else ""
    noise = ""
    if effects.noise_std is not None:
        noise = f"; one point scatters by {effects.noise_std:.3g}{unit} (standard deviation of replicates)"
    out.append(f"Mean of {effects.points} points: {effects.mean:.4g}{unit}{noise}.")
    if effects.left_out:
        out.append(f"{effects.left_out} of {len(rows)} points without a value are left out: {_reason(effects, rows)}.")
    if effects.note:
        out.append(f"{effects.note[0].upper()}{effects.note[1:]}.".replace("..", "."))
    titles = {f.name: f.label or f.name for f in study.factor}
    for main in sorted(effects.main, key=lambda m: m.p_value):
        out.append(_main(main, titles[main.factor], unit, study))
    out += _indices(effects, titles)
    if effects.response in INDICATORS:
        out.append(_grades(effects.response, rows))
    return out


def _why_none(effects: Effects, rows: Sequence[Mapping[str, Any]]) -> str:
    return f"No point has a value: {_reason(effects, rows)}."


def _reason(effects: Effects, rows: Sequence[Mapping[str, Any]]) -> str:
    """The most frequent one."""
    found = Counter(
        row.get(f"{effects.response}.reason") or row["reason"] or "no reason was given"
        for row in rows
        if row[effects.response] is None
    )
    ((most, count),) = found.most_common(1)
    return most if len(found) == 1 else f"{most} ({count} of them)"


def _main(main: MainEffect, title: str, unit: str, study: Study) -> str:
    interval = f"[{main.low_95:+.3g}, {main.high_95:+.3g}]"
    if study.design in SAMPLED:
        how = f"over its range the response changes by {main.effect:+.3g}{unit}, 95 % interval {interval}"
    else:
        least = min(main.levels, key=lambda level: level.mean)
        most = max(main.levels, key=lambda level: level.mean)
        how = f"least at {least.label} ({least.mean:.4g}), greatest at {most.label} ({most.mean:.4g}); difference "
        how += f"{abs(main.effect):.3g}{unit}, 95 % interval {interval}"
    p = "p < 0.001" if main.p_value < 0.001 else f"p = {main.p_value:.2g}"
    seen = "" if main.p_value < _P else " Not distinguishable from noise."
    return f"{title}: {how} ({p}).{seen}"


def _indices(effects: Effects, titles: Mapping[str, str]) -> list[str]:
    if not effects.indices:
        return []
    if effects.indices[0].total is not None:
        ordered = sorted(effects.indices, key=lambda i: -(i.total or 0.0))
        told = [
            f"{titles[i.factor]}: {100 * (i.first or 0):.1f} ± {100 * (i.first_95 or 0):.1f} % of the variance alone, "
            f"{100 * (i.total or 0):.1f} ± {100 * (i.total_95 or 0):.1f} % with interactions."
            for i in ordered
        ]
        pairs = [p for p in effects.pairs if abs(p.index) > p.index_95]
        told += [
            f"{titles[p.first_factor]} with {titles[p.second_factor]}: {100 * p.index:.1f} ± {100 * p.index_95:.1f} % together."
            for p in pairs
        ]
        return told
    ordered = sorted(effects.indices, key=lambda i: -(i.mu_star or 0.0))
    return [
        f"{titles[i.factor]}: mean change {i.mu_star:.3g} ± {i.mu_star_95:.2g}, varying by {i.sigma:.3g} with the place."
        for i in ordered
    ]


def _grades(indicator: str, rows: Sequence[Mapping[str, Any]]) -> str:
    shares = grade_shares(rows, indicator, ()).get((), {})
    words: dict[str, str] = {g: f"{zh} ({g.replace('_', ' ')})" for g, zh in GRADE_ZH.items()} | {"failed": "failed"}
    return (
        "Grades: " + ", ".join(f"{words[g]} {100.0 * share:.0f} %" for g, share in shares.items()) + " of the points."
    )
