"""What a study says: indices, main effects and grades against closed forms; figures and page."""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from evaluator.report.style import style
from testrange.study.design import design_rows
from testrange.study.effects import analyse, cell_means, grade_shares
from testrange.study.ishigami import A, B, ishigami
from testrange.study.model import Study, parse_study
from testrange.study.plan import Plan, make_plan
from testrange.study.report import figures
from testrange.study.report.page import write_page
from testrange.study.run import run_study
from testrange.study.table import point_rows

HERE = Path("study.toml")


def planned(**given: object) -> Plan:
    data = {"title": "t", "callable": "m:f", "responses": ["y"], **given}
    return make_plan(parse_study(data, "study.toml"), HERE)


def rows_of(plan: Plan, function: Any) -> list[dict[str, Any]]:
    """The table of a study whose callable is `function`, without running workers."""
    outcomes: dict[str, Mapping[str, Any]] = {
        p.id: {
            "status": "done",
            "reason": None,
            "versions": {},
            "run_time_s": 0.0,
            "values": {"y": {"value": function(p)}},
        }
        for p in plan.points
    }
    return point_rows(plan, outcomes)


def ranged(*names: str, low: float = -math.pi, high: float = math.pi) -> list[dict[str, object]]:
    return [{"name": n, "range": [low, high]} for n in names]


def closed_form() -> tuple[list[float], list[float]]:
    """S1 and ST of the Ishigami function (Homma and Saltelli, Reliab. Eng. Syst. Saf. 52 (1996) 1-17)."""
    v1 = 0.5 * (1.0 + B * math.pi**4 / 5.0) ** 2
    v2 = A**2 / 8.0
    v13 = B**2 * math.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    total = v1 + v2 + v13
    return [v1 / total, v2 / total, 0.0], [(v1 + v13) / total, v2 / total, v13 / total]


def test_the_published_indices_of_the_ishigami_function(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: the ready study through workers, table and analysis. Expected: 0.3139, 0.4424, 0 and 0.5576, 0.4424, 0.2437.
    Tolerance: the study's own 95 % intervals, which must be narrower than 0.15 with 256 base samples."""
    monkeypatch.setattr("testrange.study.report.page._pictures", lambda *_: [])
    first, total = closed_form()
    assert first == pytest.approx([0.3139, 0.4424, 0.0], abs=5e-5)
    assert total == pytest.approx([0.5576, 0.4424, 0.2437], abs=5e-5)
    text = (Path(__file__).parents[2] / "configs" / "studies" / "ishigami.toml").read_text()
    (tmp_path / "s.toml").write_text(text.replace("samples = 1024", "samples = 256"))
    done = run_study(tmp_path / "s.toml", tmp_path / "out", workers=2)
    for index, s1, st in zip(done.effects[0].indices, first, total):
        assert (
            index.first is not None
            and index.first_95 is not None
            and index.total is not None
            and index.total_95 is not None
        )
        assert abs(index.first - s1) < index.first_95 < 0.15
        assert abs(index.total - st) < index.total_95 < 0.18


def test_sobol_leaves_whole_blocks_out_and_second_order_finds_the_pair() -> None:
    """Expected: with two points of one block failed the indices stay within their intervals and the note counts the block; x1 with
    x3 is the only pair, 0.2437."""
    plan = planned(design="sobol", samples=512, second_order=True, factor=ranged("x1", "x2", "x3"))
    rows = rows_of(plan, lambda p: ishigami(p.factors, 0))
    rows[3]["y"] = rows[5]["y"] = None
    (found,) = analyse(plan, rows, {})
    assert found.left_out == 2 and "1 of 512 sample blocks left out" in found.note
    pairs = {(p.first_factor, p.second_factor): p for p in found.pairs}
    assert abs(pairs["x1", "x3"].index - 0.2437) < pairs["x1", "x3"].index_95 < 0.2
    assert abs(pairs["x1", "x2"].index) < pairs["x1", "x2"].index_95
    for index, st in zip(found.indices, closed_form()[1]):
        assert index.total is not None and index.total_95 is not None and abs(index.total - st) < index.total_95


def test_morris_of_a_plane() -> None:
    """Expected: for 2 x - 3 z on [0, 4] mu* is slope times range, 8 and 12, mu keeps the sign, sigma is 0: elementary effects of a
    plane are all alike. Tolerance: rounding of the factors to 12 digits."""
    plan = planned(design="morris", samples=6, factor=ranged("x", "z", low=0.0, high=4.0))
    (found,) = analyse(plan, rows_of(plan, lambda p: 2.0 * p.factors["x"] - 3.0 * p.factors["z"]), {})
    assert [i.mu_star for i in found.indices] == pytest.approx([8.0, 12.0], abs=1e-9)
    assert [i.mu for i in found.indices] == pytest.approx([8.0, -12.0], abs=1e-9)
    assert [i.sigma for i in found.indices] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_main_effects_of_a_balanced_grid() -> None:
    """Expected: level means are the plain means of the rows, their interval t s/sqrt(n) with s pooled over the replicates; the
    effect of a goes from its least to its greatest level mean, with t s sqrt(2/n) (two-way analysis of variance)."""
    rng = np.random.default_rng(5)
    noise = {k: float(v) for k, v in enumerate(rng.normal(0.0, 0.1, 24))}
    plan = planned(
        replicates=2, factor=[{"name": "a", "values": [1.0, 2.0, 3.0]}, {"name": "b", "values": ["p", "q", "r", "s"]}]
    )
    order = {p.id: k for k, p in enumerate(plan.points)}
    rows = rows_of(plan, lambda p: 2.0 * p.factors["a"] + noise[order[p.id]])
    (found,) = analyse(plan, rows, {"y": "m"})
    y = np.array([row["y"] for row in rows]).reshape(3, 4, 2)
    s = math.sqrt(float(np.mean((y[..., 0] - y[..., 1]) ** 2)) / 2.0)
    assert found.noise_std == pytest.approx(s, rel=1e-12) and found.noise_freedom == 12
    t = float(stats.t.ppf(0.975, 12))
    a, b = found.main
    assert [level.mean for level in a.levels] == pytest.approx(y.mean(axis=(1, 2)))
    assert a.levels[0].high_95 - a.levels[0].mean == pytest.approx(t * s / math.sqrt(8.0))
    assert a.effect == pytest.approx(y[2].mean() - y[0].mean())
    assert a.high_95 - a.effect == pytest.approx(t * s * math.sqrt(2.0 / 8.0))
    assert a.p_value < 1e-6 < b.p_value
    assert b.low_95 < 0.0 < b.high_95


def test_intervals_hold_the_truth_in_95_of_100_studies() -> None:
    """Rationale: an interval is a promise. Expected: of 400 studies of y = a + noise the interval of the effect, 2, holds it in
    380. Tolerance: 4 standard deviations of that binomial, 17."""
    plan = planned(replicates=2, factor=[{"name": "a", "values": [1.0, 2.0, 3.0]}])
    rng = np.random.default_rng(11)
    held = 0
    for _ in range(400):
        (found,) = analyse(plan, rows_of(plan, lambda p: p.factors["a"] + rng.normal(0.0, 0.1)), {})
        held += found.main[0].low_95 <= 2.0 <= found.main[0].high_95
    assert abs(held - 380) <= 17


def test_latin_hypercube_effects_are_the_slopes_over_the_range() -> None:
    """Expected: of 5 x + 0 z the effects are 10 over [0, 2] and 0, within their intervals.
    Tolerance: three standard deviations for z, which is 1.5 half widths."""
    plan = planned(design="lhs", samples=40, factor=ranged("x", "z", low=0.0, high=2.0))
    rng = np.random.default_rng(3)
    (found,) = analyse(plan, rows_of(plan, lambda p: 5.0 * p.factors["x"] + rng.normal(0.0, 0.2)), {})
    x, z = found.main
    assert x.low_95 < 10.0 < x.high_95 and x.high_95 - x.low_95 < 0.6
    assert abs(z.effect) < 1.5 * (z.high_95 - z.effect) and x.p_value < 1e-9


def test_a_constant_response_and_none_at_all() -> None:
    plan = planned(factor=[{"name": "a", "values": [1, 2]}])
    assert "same value" in analyse(plan, rows_of(plan, lambda p: 4.0), {})[0].note
    assert analyse(plan, rows_of(plan, lambda p: None), {})[0].note == "no value"


def graded() -> tuple[Plan, list[dict[str, Any]]]:
    """A campaign study with made-up values: P_m = height/50 + speed/20, the second replicate a little worse, one point failed."""
    study: Study = parse_study(
        {
            "title": "Height <and> speed",
            "base": "study_range",
            "replicates": 2,
            "responses": ["indicators.calibration_error"],
            "factor": [
                {"name": "h", "label": "height", "unit": "m", "values": [25.0, 50.0], "key": "camera.focus_distance_m"},
                {"name": "v", "label": "speed", "unit": "m/s", "values": [2.0, 6.0, 10.0], "key": "flight.speed_m_s"},
            ],
        },
        "study.toml",
    )
    plan = make_plan(study, HERE)
    outcomes: dict[str, Mapping[str, Any]] = {}
    for p in plan.points:
        value = float(p.factors["h"]) / 50.0 + float(p.factors["v"]) / 20.0 - 0.25 + 0.16 * p.replicate  # type: ignore[arg-type]
        grade = "excellent" if value <= 0.5 else "good" if value <= 1.0 else "fair"
        values = {"indicators.calibration_error": {"value": value, "std": 0.02, "grade": grade, "unit": "pixel"}}
        outcomes[p.id] = {"status": "done", "reason": None, "versions": {}, "run_time_s": 1.0, "values": values}
    outcomes[plan.points[-1].id] = {
        "status": "failed", "reason": "a <script> broke", "versions": {}, "run_time_s": 1.0, "values": {},
    }  # fmt: skip
    return plan, point_rows(plan, outcomes)


def test_grade_shares_count_replicates_and_failures() -> None:
    """Expected: at 25 m and 2 m/s 0.35 and 0.51 px: half excellent, half good; at 50 m and 10 m/s half fair (1.25), half failed;
    cell means are of what has a value."""
    _, rows = graded()
    shares = grade_shares(rows, "calibration_error", ("h", "v"))
    assert shares[25.0, 2.0] == {"excellent": 0.5, "good": 0.5}
    assert shares[50.0, 10.0] == {"fair": 0.5, "failed": 0.5}
    assert cell_means(rows, "calibration_error", ("h", "v"))[25.0, 2.0][0] == pytest.approx(0.43)


def test_the_page_shows_all_and_asks_for_nothing(tmp_path: Path) -> None:
    """Expected: grades in both languages, what failed and why as text and no markup, every figure as PNG and SVG, no address but
    of namespaces and data; the same bytes a second time."""
    plan, rows = graded()
    effects = analyse(plan, rows, {"calibration_error": "pixel"})
    pages = [write_page(tmp_path / name, plan, rows, effects).read_bytes() for name in ("a", "b")]
    assert pages[0] == pages[1]
    page = pages[0].decode()
    assert (
        "优" in page
        and "a &lt;script&gt; broke" in page
        and "<script" not in page
        and "Height &lt;and&gt; speed" in page
    )
    assert effects[0].unit == "pixel" and "flight.speed_m_s" in page and "95 % interval" in page
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    names = {p.name for p in (tmp_path / "a" / "figures").iterdir()}
    for kind in ("grades", "heat", "over-h", "over-v", "effects"):
        assert {f"calibration_error-{kind}.png", f"calibration_error-{kind}.svg"} <= names
    for name in names:
        drawn = (tmp_path / "a" / "figures" / name).read_bytes()
        assert drawn == (tmp_path / "b" / "figures" / name).read_bytes() and b"<dc:date>" not in drawn


def test_the_grade_map_is_drawn_in_the_grades_colours() -> None:
    """Expected: the areas of a cell's rectangles are the shares of its grades."""
    plan, rows = graded()
    with style():
        drawn = figures.grade_map(plan.study, rows, "calibration_error", *plan.study.factor)
    patches = [p for p in drawn.axes[0].patches if abs(p.get_y() + 0.45) < 1e-9 and p.get_x() < 0.5]  # type: ignore[attr-defined]
    assert [round(p.get_width() / 0.94, 6) for p in patches] == [0.5, 0.5]  # type: ignore[attr-defined]
    assert len({p.get_facecolor() for p in patches}) == 2


def test_ishigami_needs_all_of_its_rows() -> None:
    """Expected: Saltelli's sample has N (k + 2) rows."""
    assert len(design_rows(planned(design="sobol", samples=8, factor=ranged("x1", "x2", "x3")).study)) == 8 * 5
