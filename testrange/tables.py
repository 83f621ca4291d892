"""What the command line prints: the table of indicators, what does not conform, the score. At most 100 columns."""

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Literal, TextIO

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from evaluator.c10_1_grading import GRADE_ZH, GROUPS, INDICATORS, Grade, group_grades
from evaluator.documents.model import Language, say
from evaluator.documents.phrases import STATUS, translated
from evaluator.report.terms import parameter
from evaluator.results import Evaluation, shown_decimals
from evaluator.scores.score import Score, decimals

if TYPE_CHECKING:
    from testrange.faults.matrix import FaultMatrix

WIDTH = 100
_COLOUR: dict[Grade, str] = {
    "excellent": "green",
    "good": "cyan",
    "fair": "yellow",
    "ungraded": "red",
    "not_measured": "dim",
}


_SHORT = {  # where the full name is wider than its column
    "reflectance_rmse_relative": "LiDAR/camera reflectance RMSE",
    "camera_reprojection_error": "Camera reprojection error",
}


def console(stream: TextIO | None = None) -> Console:
    """Stdout as wide as the terminal, 100 columns at most, also in a file."""
    out = Console(file=stream or sys.stdout, highlight=False, soft_wrap=False)
    out.width = min(out.width, WIDTH) if out.is_terminal else WIDTH
    return out


def _figure(value: float, unit: str) -> str:
    return f"{value:.{shown_decimals(value, unit)}f} {'px' if unit == 'pixel' else '%'}"


def _table(title: str, columns: Iterable[tuple[str, Literal["left", "right"]]]) -> Table:
    table = Table(title=Text(title), title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name, justify in columns:
        table.add_column(name, justify=justify, no_wrap=True)
    return table


def _grade_word(grade: Grade, language: Language) -> str:
    return say(language, GRADE_ZH[grade], grade.replace("_", " "))


def print_indicators(evaluation: Evaluation, out: Console, language: Language = "zh") -> None:
    """The eight indicators, why some were not measured, and the grades of their groups."""
    table = _table(
        f"GB/T 41450-2022 · {evaluation.campaign}",
        (
            (say(language, "检测项目", "indicator"), "left"),
            ("", "left"),
            (say(language, "检测结果", "value"), "right"),
            (say(language, "95 % 区间", "95 %"), "right"),
            (say(language, "样本数", "n"), "right"),
            (say(language, "一致性程度", "grade"), "left"),
        ),
    )
    for i, row in INDICATORS.items():
        found, mark = evaluation.indicator(i), evaluation.grade(i)
        grade = Text(_grade_word(mark, language), style=_COLOUR[mark])
        name = say(language, row.name_zh, _SHORT.get(i, row.name_en))
        if found.value is None:
            table.add_row(name, row.symbol, "–", "", "", grade)
            continue
        bounds = [f"{v:.{shown_decimals(v, row.unit)}f}" for v in (found.low_95, found.high_95) if v is not None]
        interval = " – ".join(bounds) if len(bounds) == 2 else ""
        table.add_row(name, row.symbol, _figure(found.value, row.unit), interval, str(found.sample_size), grade)
    out.print(table)
    reasons: dict[str, list[str]] = {}
    for i in INDICATORS:
        reason = evaluation.indicator(i).reason
        if reason:
            reasons.setdefault(reason, []).append(INDICATORS[i].symbol)
    for reason, symbols in reasons.items():
        words = say(language, f"未测：{'、'.join(symbols)}：", f"not measured: {', '.join(symbols)}: ")
        out.print(Text(words + translated(reason, language), style="dim"))
    groups = group_grades(evaluation.grades())
    graded = [
        say(language, f"{g.name_zh}：{GRADE_ZH[groups[g.id]]}", f"{g.name_en}: {_grade_word(groups[g.id], language)}")
        for g in GROUPS
        if groups[g.id] != "not_measured"
    ]
    if graded:
        out.print(say(language, "；", "; ").join(graded))


def print_doubts(evaluation: Evaluation, out: Console, language: Language = "zh") -> None:
    """What the observations contradict: surveyed places, what was stated of lens, ranges, clocks and navigation, the closure."""
    lines = [
        say(language, f"靶标 {target} 的控制测量位置存疑", f"surveyed place of {target} is in doubt")
        for target in evaluation.survey_doubts
    ]
    lines += [
        say(
            language,
            f"给定值与观测值矛盾：{parameter(line.split(':')[0], language)}，见报告",
            f"stated, but contradicted: {line}",
        )
        for line in evaluation.stated_doubts
    ]
    if evaluation.closure.get("closes") is False:
        chi, limit = (f"{evaluation.closure[name]:.1f}" for name in ("chi_square", "limit_95"))
        lines.append(
            say(
                language,
                f"相机、机体、激光雷达闭合差超出 95 % 限值：χ² {chi} > {limit}",
                f"camera, body and LiDAR close beyond their 95 %: chi-square {chi} > {limit}; by chance once in twenty",
            )
        )
    for line in lines:
        out.print(Text(line, style="yellow"))


def print_conformity(evaluation: Evaluation, out: Console, language: Language = "zh") -> None:
    """Counts, and every row that fails or warns."""
    counts: dict[str, int] = {}
    for row in evaluation.conformity:
        counts[row.status] = counts.get(row.status, 0) + 1
    if not counts:
        return
    told = [f"{n} {say(language, *STATUS[status])}" for status, n in sorted(counts.items())]
    out.print(say(language, "符合性：", "conformity: ") + say(language, "，", ", ").join(told))
    for row in evaluation.conformity:
        if row.status in ("fail", "warning"):
            requirement, measured, limit = (translated(t, language) for t in (row.requirement, row.measured, row.limit))
            found = say(language, f"：{measured}；限值 {limit}", f": {measured}; limit {limit}")
            text = f"  {say(language, *STATUS[row.status])} {row.clause} {requirement}{found}"
            out.print(Text(text, style="red" if row.status == "fail" else "yellow"))


def print_score(score: Score, out: Console, language: Language = "zh") -> None:
    """Truth against estimate of the quantities that matter most, and the greatest |z|."""
    if not score.items:
        out.print(say(language, "评分：没有已知真值的估计量", "score: nothing was estimated whose truth is known"))
        return
    heads = say(language, "参数,真值,估计值,误差,标准差,z", "quantity,truth,estimate,error,std,z").split(",")
    table = _table(
        say(language, "与真值（truth/）比较", "score against truth/"),
        [(name, "right" if k else "left") for k, name in enumerate(heads)],
    )
    for item in score.items:
        z = "–" if item.z is None else f"{item.z:+.2f}"
        digits = decimals(item.std)
        table.add_row(
            f"{item.quantity} [{item.unit}]".replace("[", r"\["),
            f"{item.truth:.{digits}f}",
            f"{item.estimate:.{digits}f}",
            f"{item.error:+.{digits}f}",
            f"{item.std:.{digits}f}" if item.std > 0.0 else "–",
            z,
        )
    out.print(table)
    if score.max_abs_z is not None:
        n, z = len(score.items), f"{score.max_abs_z:.2f}"
        out.print(say(language, f"{n} 个参数中最大 |z|：{z}", f"greatest |z| of {n} quantities: {z}"))


def summary(evaluation: Evaluation, score: Score | None, **more: Any) -> dict[str, Any]:
    """What --json prints: values and grades, what does not conform, the score's greatest |z|."""
    grades = evaluation.grades()
    return {
        "campaign": evaluation.campaign,
        "indicators": {
            i: {
                "value": evaluation.indicator(i).value,
                "unit": evaluation.indicator(i).unit,
                "grade": grades[i],
                "reason": evaluation.indicator(i).reason,
            }
            for i in INDICATORS
        },
        "groups": group_grades(grades),
        "not_conforming": [
            {"clause": r.clause, "requirement": r.requirement, "status": r.status}
            for r in evaluation.conformity
            if r.status in ("fail", "warning")
        ],
        "max_abs_z": None if score is None else score.max_abs_z,
        **more,
    }


def print_faults(matrix: "FaultMatrix", out: Console) -> None:
    """One row a fault: where it shows, its z there, and the verdict; then the pairs that this flight cannot tell apart."""
    table = _table(
        f"fault matrix, |z| > {matrix.limit:.2f} is a deviation",
        (("fault", "left"), ("shows at", "left"), ("verdict", "left")),
    )
    for column in table.columns:
        column.no_wrap = False
    for r in matrix.results:
        z = {row["quantity"]: row["z"] for row in r.rows}
        shown = [f"{q} {z[q]:+.1f}" for q in r.beyond(matrix.limit)] + [f"survey of {t}" for t in r.doubts]
        verdict = r.verdict(matrix.limit)
        table.add_row(
            r.case.name, ", ".join(shown) or "–", Text(verdict, "green" if verdict == "as injected" else "red")
        )
    out.print(table)
    for first, second, rho in matrix.results[0].pairs:
        out.print(f"  not separable by this flight: {first}, {second} (correlation {rho:+.3f})")
    out.print(f"{matrix.right} of {len(matrix.results)} as injected")
