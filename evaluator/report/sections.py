"""What stands in the page's tables: indicators, data, mounting by each way, closure, clocks. Strings and numbers, no markup."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from evaluator.c10_1_grading import GROUPS, INDICATORS, Indicator, group_grades
from evaluator.camera_model import LENS_NAMES, lens_vector
from evaluator.documents.handbooks_common import blunder
from evaluator.documents.model import printed_unit
from evaluator.documents.phrases import translated
from evaluator.report.terms import method, parameter, strip
from evaluator.report.texts import Texts
from evaluator.report.words import HOW
from evaluator.results import Evaluation, plain, shown_decimals
from evaluator.scores.score import decimals

_BANDS = {"red", "green", "blue", "grey"}
_LONG = 8  # a longer list is counted, not printed
_CORRELATED = 0.95
_MATRICES = {"covariance", "correlation"}  # drawn as pictures
_ROUNDING = 1e-10  # in any unit of ours: sums over values of the order of 100 leave 1e-14, no instrument resolves this


def number(value: object, t: Texts) -> str:
    """A figure or a short text as it stands in a cell."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return t("yes") if value else t("no")
    if isinstance(value, float):
        return f"{value:.5g}" if abs(value) >= _ROUNDING else "0"
    text = str(value)
    return parameter(text, t.language) if text in _BANDS else blunder(text, t.language)


def companions(value: Any, t: Texts, prefix: str = "") -> list[tuple[str, str]]:
    """Nested companions as lines of name and value; long lists become their length."""
    if isinstance(value, Mapping):
        return [
            pair
            for k, v in value.items()
            if not (k in _MATRICES and isinstance(v, list))
            for pair in companions(
                v, t, f"{prefix} › {parameter(str(k), t.language)}" if prefix else parameter(str(k), t.language)
            )
        ]
    if isinstance(value, list):
        if len(value) > _LONG or any(isinstance(v, list | dict) for v in value):
            return [(prefix, t("entries", n=len(value)))]
        return [(prefix, t("comma").join(number(v, t) for v in value) or "–")]
    return [(prefix, number(value, t))]


def _digits(value: float | None, row: Indicator) -> int:
    """Decimals of the card; a correlation near 100 % gets as many as tell it from 100."""
    usual = shown_decimals(value, row.unit)
    if value is None or not row.higher_is_better:
        return usual
    return max(usual, shown_decimals(100.0 - value, row.unit))


def indicator_cards(evaluation: Evaluation, results: Mapping[str, Any], t: Texts) -> list[dict[str, Any]]:
    """Everything about each indicator, in the order of table 3."""
    cards = []
    for i, row in INDICATORS.items():
        block, how = results["indicators"][i], HOW[i]
        value = evaluation.indicator(i).value
        cards.append(
            {
                "id": i,
                "row": row,
                "name": t.pick(row.name_zh, row.name_en),
                "unit": printed_unit(row.unit),
                "value": value,
                "digits": _digits(value, row),
                "grade": evaluation.grade(i),
                "grade_text": t(f"level_{evaluation.grade(i)}"),
                "block": block,
                "reason": translated(block["reason"] or "", t.language),
                "method": method(block["uncertainty"]["method"] or "", t.language),
                "companions": companions(block["companions"], t),
                "formula": how.formula,
                "words": t.pick(*how.words),
                "data": t.pick(*how.data),
                "better": "≥" if row.higher_is_better else "≤",
            }
        )
    return cards


def group_rows(evaluation: Evaluation, t: Texts) -> list[dict[str, Any]]:
    """Table 3's groups with their grades."""
    grades = group_grades(evaluation.grades())
    return [
        {
            "name": t.pick(g.name_zh, g.name_en) + ("*" if g.starred else ""),
            "indicators": ", ".join(INDICATORS[i].symbol for i in g.indicators),
            "grade": grades[g.id],
            "grade_text": t(f"level_{grades[g.id]}"),
        }
        for g in GROUPS
    ]


def data_rows(evaluation: Evaluation, t: Texts) -> list[tuple[str, str, bool]]:
    """What the folder holds: part, in words, whether there is any of it."""
    data = evaluation.data
    if data is None:
        return []
    kinds = {k: sum(target.kind == k for target in data.targets) for k in ("frustum", "panel", "board")}
    images = sum(len(s.exposures) for s in data.sorties)
    strips = sum(len(s.strips) for s in data.sorties)
    bench, ranging = data.bench, data.ranging
    instruments = [sheet.name for sheet in (data.camera, data.lidar) if sheet is not None]
    instruments += [data.rig.platform] if data.rig is not None else []
    rows = [
        ("d_instruments", ", ".join(instruments), bool(instruments)),
        ("d_plan", t("d_plan_v", n=len(data.plan.strips)) if data.plan else "", data.plan is not None),
        ("d_sorties", t("d_sorties_v", sorties=len(data.sorties), strips=strips), bool(data.sorties)),
        ("d_images", t("d_images_v", n=images), images > 0),
        ("d_targets", t("d_targets_v", **kinds), bool(data.targets)),
        (
            "d_sphere",
            t("d_sphere_v", a=len(bench.stability), b=len(bench.repeatability)),
            bool(bench.stability or bench.repeatability),
        ),
        ("d_board", t("d_images_v", n=len(bench.board_log)), bool(bench.board_log)),
        (
            "d_ranging",
            t("d_ranging_v", scans=len(ranging.scans), readings=len(ranging.readings)),
            bool(ranging.scans or ranging.readings),
        ),
    ]
    return [(t(key), text if there else t("absent"), there) for key, text, there in rows]


@dataclass(frozen=True, kw_only=True)
class ParameterTable:
    """Estimated parameters with their standard deviations: name, unit, estimate, std (None where unknown)."""

    section: str
    title: str
    note: str
    rows: tuple[tuple[str, str, float, float | None], ...]


def _deviations(covariance: np.ndarray | None, n: int) -> list[float | None]:
    return [None] * n if covariance is None else [float(v) for v in np.sqrt(np.diag(covariance))]


def parameter_tables(evaluation: Evaluation, t: Texts) -> list[ParameterTable]:
    """The camera's nine parameters by 9.2, K2 and R2 by 9.1."""
    out = []
    board, line = evaluation.chessboard, evaluation.ranging
    if board is not None and board.lens is not None:
        values = lens_vector(board.lens).tolist()
        rows = tuple(
            (n.removesuffix("_px"), "px" if n.endswith("_px") else "1", value, std)
            for n, value, std in zip(LENS_NAMES, values, _deviations(board.covariance, 9), strict=True)
        )
        setting = [] if board.focus_distance_m is None else [f"{board.focus_distance_m:g} m"]
        setting += [] if board.f_number is None else [f"f/{board.f_number:g}"]
        note = t(
            "lens_note",
            n=len(board.images),
            out=len(board.not_used),
            setting=t("lens_setting", text=", ".join(setting)) if setting else "",
        )
        out.append(ParameterTable(section="camera_reprojection_error", title=t("lens_title"), note=note, rows=rows))
    if line is not None and line.additive_constant_m is not None and line.multiplication_constant is not None:
        k_std, r_std = _deviations(line.covariance, 2)
        rows = (
            ("K₂", "m", line.additive_constant_m, k_std),
            ("R₂", "1", line.multiplication_constant, r_std),
        )
        out.append(
            ParameterTable(
                section="lidar_ranging_rmse_relative", title=t("ranging_title"), note=t("ranging_note"), rows=rows
            )
        )
    return out


def left_out(evaluation: Evaluation) -> list[str]:
    """Images and panels of benches and line that could not serve, with the reason."""
    out: list[str] = []
    if evaluation.sphere is not None:
        for series in (evaluation.sphere.stability_series, evaluation.sphere.repeatability_series):
            out += series.left_out if series is not None else ()
    for result in (evaluation.chessboard, evaluation.ranging):
        out += [f"{name}: {why}" for name, why in result.not_used.items()] if result is not None else []
    return [str(line) for line in plain(out, evaluation.root)]


def _weak_text(entry: Mapping[str, Any], t: Texts) -> str:
    causes = [t(f"weak_{c}") for c in entry.get("causes", ()) if c != "correlation"]
    if causes:
        return t("comma").join(causes)
    other = parameter(str(entry["partner"]), t.language)
    return t("correlated_with", other=other, rho=f"{entry['correlation']:.2f}")


def _help_text(entry: Mapping[str, Any] | None, key: str, t: Texts) -> str:
    if not entry or not entry.get(key):
        return ""
    value = entry.get("std_with_it")
    std = "–" if value is None else f"{value:.{decimals(value)}f}"
    return t("helping_strip", strip=strip(str(entry[key]), t.language), std=std)


def mounting_rows(results: Mapping[str, Any], t: Texts) -> list[dict[str, Any]]:
    """The joint adjustment's parameters, clocks among them, then camera_from_lidar."""
    block = results["mounting"]
    if block.get("status") != "measured":
        return []
    weak = {w["name"]: w for w in block["not_determined"]}
    helps = {h["name"]: h for h in block["companions"].get("strip_that_would_help", [])}
    prior = block["prior_std"] or [None] * len(block["names"])
    rows = []
    for n, u, e, s, p in zip(block["names"], block["units"], block["estimates"], block["std"], prior):
        entry = weak.get(n)
        rows.append(
            {
                "name": parameter(n, t.language),
                "unit": u,
                "estimate": e,
                "std": s,
                "prior": p,
                "weak": _weak_text(entry, t) if entry else "",
                "help": _help_text(helps.get(n), "strip_that_would_help", t) if entry else "",
            }
        )
    relative = block["camera_from_lidar"]
    return rows + [
        {
            "name": parameter(n, t.language),
            "unit": u,
            "estimate": e,
            "std": s,
            "prior": None,
            "weak": "",
            "help": "",
        }
        for n, u, e, s in zip(relative["names"], relative["units"], relative["estimates"], relative["std"])
    ]


def three_ways(results: Mapping[str, Any], t: Texts) -> list[dict[str, Any]]:
    """Each body-sensor parameter by the joint adjustment, by its sensor alone and by the boards: (estimate, std) or None."""
    block = results["mounting"]
    closure, boards = block.get("closure") or {}, block.get("boards") or {}

    def values(of: Mapping[str, Any] | None) -> dict[str, tuple[Any, Any]]:
        return dict(zip(of["names"], zip(of["estimates"], of["std"]))) if of and "estimates" in of else {}

    joint = values(block)
    alone = values(closure.get("camera_alone")) | values(closure.get("lidar_alone"))
    by_boards = values(boards)
    if not (alone or (by_boards and joint)):
        return []
    units = dict(zip(block.get("names", []), block.get("units", [])))
    return [
        {
            "name": parameter(n, t.language),
            "unit": units.get(n, ""),
            "ways": [joint.get(n), alone.get(n), by_boards.get(n)],
        }
        for n in units
    ]


def inseparable(results: Mapping[str, Any], t: Texts) -> list[dict[str, Any]]:
    """Pairs of parameters of the joint adjustment whose |correlation| is above 0.95, strongest first."""
    block = results["mounting"]
    if block.get("status") != "measured":
        return []
    names, matrix = block["names"], np.array(block["correlation"], dtype=np.float64)
    rows = [
        {
            "first": parameter(names[j], t.language),
            "second": parameter(names[i], t.language),
            "correlation": float(matrix[i, j]),
            "where": t("inside_sensor" if names[i].split("_")[0] == names[j].split("_")[0] else "between_sensors"),
        }
        for i, j in zip(*np.nonzero(np.abs(np.tril(matrix, -1)) > _CORRELATED))
    ]
    return sorted(rows, key=lambda r: -abs(r["correlation"]))


def stated_rows(results: Mapping[str, Any], t: Texts) -> list[dict[str, Any]]:
    """What the adjustment took as stated, as its observations see it."""
    block = results["mounting"]
    doubted = {str(line).split(":")[0] for line in block.get("companions", {}).get("stated_in_doubt", [])}
    return [
        {
            **row,
            "name": parameter(row["quantity"], t.language),
            "moves": parameter(row["moves"], t.language),
            "doubted": row["quantity"] in doubted,
        }
        for row in block.get("companions", {}).get("stated", [])
    ]


def closure_rows(results: Mapping[str, Any], t: Texts) -> list[dict[str, Any]]:
    """The closure's six components."""
    block = results["mounting"].get("closure") or {}
    if block.get("chi_square") is None:
        return []
    keys = ("composed", "joint", "difference", "std", "z", "half_width_95")
    return [
        {"name": parameter(n, t.language), "unit": u, **dict(zip(keys, row))}
        for n, u, *row in zip(block["names"], block["units"], *(block[k] for k in keys))
    ]


def board_rows(results: Mapping[str, Any], t: Texts) -> list[dict[str, Any]]:
    """The boards' six parameters by sub-pixel centres and by the half-window count."""
    block = results["mounting"].get("boards") or {}
    if block.get("status") != "measured":
        return []
    count = block.get("half_window_count") or {}
    weak = {w["parameter"]: w for w in block["not_determined"]}
    rows = []
    for k, n in enumerate(block["names"]):
        entry = weak.get(n)
        rows.append(
            {
                "name": parameter(n, t.language),
                "unit": block["units"][k],
                "estimate": block["estimates"][k],
                "std": block["std"][k],
                "prior": block["prior_std"][k],
                "count": (count["estimates"][k], count["std"][k])
                if count.get("estimates") and count["estimates"][k] is not None
                else None,
                "weak": _weak_text(entry, t) if entry else "",
                "help": _help_text(entry, "helping_strip", t),
            }
        )
    return rows


def clock_rows(results: Mapping[str, Any], t: Texts) -> list[dict[str, Any]]:
    """Both sensors' clocks in milliseconds, where the flight estimates them."""
    block = results["mounting"]
    if block.get("status") != "measured":
        return []
    return [
        {"name": parameter(n, t.language), "estimate": 1000.0 * e, "std": 1000.0 * s}
        for n, u, e, s in zip(block["names"], block["units"], block["estimates"], block["std"])
        if u == "s"
    ]
