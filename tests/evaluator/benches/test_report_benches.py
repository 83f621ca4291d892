"""The report of benches and ranging line: pictures show what they say, half a bench has a report too, text is escaped."""

import html
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from evaluator.benches.bench_model import ChessboardResult, RangingResult, SphereResult
from evaluator.conformity import ConformityInputs, conformity_rows
from evaluator.model import CampaignData
from evaluator.report import bench_plots, write_report
from evaluator.report import pictures as page_pictures
from evaluator.report.style import style
from evaluator.results import Evaluation, build_results, shown_decimals
from evaluator.results_model import IndicatorValue, not_measured
from evaluator.scores.score import Score, ScoreItem


@pytest.fixture
def bench_evaluation(
    evaluation: Evaluation,
    bench_data: CampaignData,
    bench_inputs: ConformityInputs,
    sphere_result: SphereResult,
    chessboard_result: ChessboardResult,
    ranging_result: RangingResult,
) -> Evaluation:
    """All eight indicators; no flight pictures, they are another test's."""
    indicators = {
        **evaluation.indicators,
        "camera_stability": sphere_result.stability,
        "camera_repeatability": sphere_result.repeatability,
        "camera_reprojection_error": chessboard_result.indicator,
        "lidar_ranging_rmse_relative": ranging_result.indicator,
    }
    return replace(
        evaluation,
        indicators=indicators,
        conformity=tuple(conformity_rows(bench_data, bench_inputs)),
        data=replace(bench_data, sorties=()),
        sphere=sphere_result,
        chessboard=chessboard_result,
        ranging=ranging_result,
        marks=(),
        vertices=(),
        residuals=(),
        regions=(),
        panels=(),
        waveforms=(),
        mounting=None,
    )


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, but not written as SVG: seconds for tests that look at the words."""
    monkeypatch.setattr(page_pictures, "svg_uri", lambda figure: "data:image/svg+xml;base64,")


def drawn(draw: Callable[[], Figure | None]) -> Figure:
    with style():
        found = draw()
        assert found is not None
        found.draw_without_rendering()
    return found


def texts(figure: Figure) -> str:
    """Every text of a figure, subfigures and legends too."""
    from matplotlib.text import Text

    return "\n".join(t.get_text() for t in figure.findobj(Text))  # type: ignore[attr-defined]


def test_all_eight_in_one_report(bench_evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: issue 3 wants all eight indicators in the report, with Table 3's grades and C.3's groups. Expected: no indicator
    without a value, six graded groups, the optical one by the lower of its two; the seven pictures of benches and line; fx and K2
    with standard deviations; the image and the panel that were not used, with the reason; the same bytes twice."""
    path = tmp_path / "r.html"
    write_report(path, bench_evaluation, None, "en")
    text = path.read_text()
    plain = html.unescape(text)
    assert 'class="grade not_measured"' not in plain
    assert plain.count("value, unrounded") == 8
    for title in (
        "Integrating sphere",
        "Chessboard residuals",
        "Coverage",
        "Distortion",
        "Camera correlations",
        "Images of the chessboard",
        "Ranging line",
    ):
        assert f"<b>{title}</b>" in plain
    for cell in ("<td>fx</td>", "3000.240", "0.040", "-0.046870", "0.000060", "0.05020", "0.00080", "0.0002010"):
        assert cell in plain
    assert "board_024.tif: no board of 17 x 12 inner corners found" in plain
    assert "L07: no point of it in 3 of 5 scans" in plain
    assert 'class="value">0.037 <small>%' in plain  # RSD: two digits, not 0.04
    assert 'class="value">0.00048 <small>%' in plain
    write_report(path, bench_evaluation, None, "en")
    assert path.read_text() == text


def test_groups_by_the_lower_indicator(bench_evaluation: Evaluation) -> None:
    """Rationale: C.3 grades a group marked * by the lower of its indicators. Expected: RSD 0.037 (excellent) and s(x) 0.7 (good)
    make good; 6 % of either makes none of the three grades."""
    worse = dict(bench_evaluation.indicators)
    for value, expected in ((0.7, "good"), (6.0, "ungraded")):
        worse["camera_repeatability"] = IndicatorValue(value=value, unit="%", formula="(6)", clause="8.2")
        groups = build_results(replace(bench_evaluation, indicators=worse))["groups"]
        assert groups["camera_radiometry"]["grade"] == expected
        assert groups["lidar_geometry"]["grade"] == "excellent"


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("missing", ["sphere", "chessboard", "ranging"])
def test_half_a_bench(bench_evaluation: Evaluation, tmp_path: Path, missing: str) -> None:
    """Rationale: any subset is reported. Expected: the pictures of the other parts and none of the missing."""
    names = {"sphere": "Integrating sphere", "chessboard": "Coverage", "ranging": "Ranging line"}
    write_report(tmp_path / "r.html", replace(bench_evaluation, **{missing: None}), None, "en")
    text = (tmp_path / "r.html").read_text()
    for part, name in names.items():
        assert (f"{name}</b>" in text) == (part != missing)


@pytest.mark.usefixtures("quick")
def test_nothing_could_be_measured(bench_evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: results without images, series and panels are what a spoiled bench leaves. Expected: a report with the reasons and
    no picture of a bench, no table of parameters."""
    none = not_measured("%", "(6)", "8.2", "all images saturated")
    pixel = not_measured("pixel", "(16)-(19)", "9.2", "only 7 images")
    spoiled = replace(
        bench_evaluation,
        indicators={"camera_stability": none, "camera_reprojection_error": pixel},
        sphere=SphereResult(stability=none, repeatability=none),
        chessboard=ChessboardResult(indicator=pixel),
        ranging=RangingResult(indicator=none),
    )
    write_report(tmp_path / "r.html", spoiled, None, "en")
    text = (tmp_path / "r.html").read_text()
    assert "all images saturated" in text
    assert "only 7 images" in text
    assert "Integrating sphere</b>" not in text
    assert "LiDAR ranging constants" not in text


@pytest.mark.usefixtures("quick")
def test_names_are_escaped(bench_evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: names of images and panels are somebody else's text, and figures are SVG. Expected: no script element, in the
    page nor in its drawings (texts are outlines there)."""
    evil = "<script>alert(1)</script>"
    assert bench_evaluation.chessboard is not None and bench_evaluation.ranging is not None
    spoiled = replace(
        bench_evaluation,
        chessboard=replace(bench_evaluation.chessboard, not_used={evil: evil}),
        ranging=replace(bench_evaluation.ranging, not_used={"L09": evil}),
    )
    write_report(tmp_path / "r.html", spoiled, None, "en")
    text = (tmp_path / "r.html").read_text()
    assert "<script" not in text
    assert html.escape(evil) in text


def test_sphere_figure(sphere_result: SphereResult) -> None:
    """Rationale: the figure's numbers are computed again, from the series. Expected: a row for each band, a column for each
    series, the standard deviation of the band relative to its mean (n - 1), the slope of a straight line through 0.1 % an hour of
    drift with 0.02 % of noise. Tolerance: the noise's standard error of a slope, 0.02 / (1 h sqrt(21/12)) = 0.015 %/h, times 4."""
    figure = drawn(lambda: bench_plots.sphere_series(sphere_result))
    axes = [a for sub in figure.subfigs for a in sub.axes]
    assert len(axes) == 6
    assert sphere_result.stability_series is not None
    dn = sphere_result.stability_series.dn[:, 0]
    assert f"red: {dn.mean():.1f} DN, SD {100 * dn.std(ddof=1) / dn.mean():.3f} %" in axes[0].get_title("left")
    trends = [float(a.get_title("left").split("trend ")[1].split(" ")[0]) for a in axes[:3]]
    assert np.abs(np.array(trends) - 0.1).max() < 0.06
    assert "trend" not in "".join(a.get_title("left") for a in axes[3:])


def test_one_series_of_one_band(sphere_result: SphereResult) -> None:
    """Rationale: a grey camera, or one series only, of three images. Expected: one panel; no series: no figure."""
    assert sphere_result.stability_series is not None
    short = replace(
        sphere_result.stability_series,
        dn=sphere_result.stability_series.dn[:3, :1],
        time_s=sphere_result.stability_series.time_s[:3],
        bands=("pan",),
    )
    one = replace(sphere_result, stability_series=short, repeatability_series=None)
    assert len(drawn(lambda: bench_plots.sphere_series(one)).subfigs[0].axes) == 1  # type: ignore[attr-defined]
    none = replace(sphere_result, stability_series=None, repeatability_series=None)
    assert bench_plots.sphere_series(none) is None


def test_residual_figure_shows_what_is_left(chessboard_result: ChessboardResult) -> None:
    """Rationale: the black arrows must show a systematic rest that noise hides. Expected: with a shift of (0.3, -0.2) px added to
    every projection the mean arrow is that shift, magnified as the title says; arrows point down the image for positive v.
    Tolerance: 0.05 px of noise over the cells' corners: 0.01 px."""
    shift = np.array([0.3, -0.2])
    moved = tuple(replace(i, projected_px=i.projected_px + shift) for i in chessboard_result.images)
    figure = drawn(lambda: bench_plots.board_residuals(replace(chessboard_result, images=moved)))
    upper = figure.axes[0]
    arrows = [q for q in upper.findobj(Quiver) if isinstance(q, Quiver)]
    magnify = float(upper.get_title("left").split("× ")[1].split(";")[0])
    mean = np.array([np.mean(arrows[1].U), np.mean(arrows[1].V)]) / magnify
    assert mean == pytest.approx(shift, abs=0.02)
    low, high = upper.get_ylim()
    assert low > high  # v grows downwards, as in the image


def test_coverage_figure(chessboard_result: ChessboardResult) -> None:
    """Rationale: 9.2.2 d asks for each distance by itself. Expected: four maps, each with its count and distance."""
    assert chessboard_result.coverage is not None
    found = texts(drawn(lambda: bench_plots.coverage(chessboard_result)))
    for counts, distance in zip(chessboard_result.coverage, chessboard_result.distances_m):
        assert f"{distance:.2f} m: {(counts > 0).sum()} of 48 cells" in found


def test_distortion_figure(chessboard_result: ChessboardResult) -> None:
    """Rationale: the map is distorted minus ideal. Expected: with k1 = -0.05 alone a point seen at radius r has the ideal radius x
    of r = x - 0.05 x^3, so the map's greatest value, in the corner, is 0.05 x^3 f. Tolerance: rounding."""
    assert chessboard_result.lens is not None
    lens = chessboard_result.lens.model_copy(update={"k1": -0.05, "k2": 0.0, "k3": 0.0, "p1": 0.0, "p2": 0.0})
    lens = lens.model_copy(update={"fx_px": 3000.0, "fy_px": 3000.0, "cx_px": 1536.0, "cy_px": 1024.0})
    figure = drawn(lambda: bench_plots.distortion_map(replace(chessboard_result, lens=lens)))
    amount = np.asarray(figure.axes[0].collections[0].get_array())  # type: ignore[attr-defined]
    step = 3072 / 60
    r = np.hypot(1536.0 - step / 2, 1024.0 - step / 2) / 3000.0
    ideal = min(x.real for x in np.roots([-0.05, 0.0, 1.0, -r]) if abs(x.imag) < 1e-9 and x.real > 0.0)
    assert float(amount.max()) == pytest.approx(0.05 * ideal**3 * 3000.0, rel=1e-6)


def test_distortion_that_folds_back(chessboard_result: ChessboardResult) -> None:
    """Rationale: a bad calibration has a polynomial that no ray reaches in the corners. Expected: a figure or a reason, no
    traceback and no warning."""
    assert chessboard_result.lens is not None
    for change in ({"k1": -3.0}, {"k1": 1e9}, {"k1": 0.0, "k3": -500.0}, {"k1": -1e30}):
        lens = chessboard_result.lens.model_copy(update={"k2": 0.0, "k3": 0.0} | change)
        with style():
            found = bench_plots.distortion_map(replace(chessboard_result, lens=lens))
            if found is not None:
                found.draw_without_rendering()


def test_black_series(sphere_result: SphereResult) -> None:
    """Rationale: a lens cap leaves DN at or below the black level, and no percentage. Expected: the band's panel says so."""
    assert sphere_result.stability_series is not None
    black = replace(sphere_result.stability_series, dn=sphere_result.stability_series.dn * [1.0, 0.0, -1.0])
    found = texts(drawn(lambda: bench_plots.sphere_series(replace(sphere_result, stability_series=black))))
    assert found.count("not above the black level") == 2


def test_correlation_figure(chessboard_result: ChessboardResult) -> None:
    """Rationale: standard deviations alone hide that k1, k2 and k3 trade off. Expected: the built-in correlations as figures."""
    found = texts(drawn(lambda: bench_plots.lens_correlations(chessboard_result)))
    for figure in ("0.97", "-0.93", "-0.98", "0.86"):
        assert figure in found
    assert bench_plots.lens_correlations(replace(chessboard_result, covariance=None)) is None


def test_bars_are_root_mean_squares(chessboard_result: ChessboardResult) -> None:
    """Rationale: M_z is the mean of norms, the bars are RMS. Expected: bar heights are sqrt(mean(e^2)) of each image."""
    figure = drawn(lambda: bench_plots.image_errors(chessboard_result))
    heights = [p.get_height() for p in figure.axes[0].patches]  # type: ignore[attr-defined]
    expected = [np.sqrt(np.mean(i.error_px**2)) for i in chessboard_result.images]
    assert heights == pytest.approx(expected)


def test_ranging_figure(ranging_result: RangingResult) -> None:
    """Rationale: before the correction the LiDAR reads 50 mm and 0.2 per mille short, after it what noise leaves. Expected: points
    at minus 53 to minus 98 mm on the line -K2 - R2 L, then within 2 mm of zero. Tolerance: noise of 0.9 mm at most, and the
    hand-made constants are off by 0.2 mm and 1e-6 * 240 m."""
    figure = drawn(lambda: bench_plots.ranging_errors(ranging_result))
    upper, lower = figure.axes
    before, after = (np.asarray(a.containers[0].lines[0].get_ydata(), dtype=float) for a in (upper, lower))
    expected = -50.0 - 0.2 * np.array([15.0, 60.0, 105.0, 150.0, 195.0, 240.0])
    assert np.abs(before - expected).max() < 1.2
    (line,) = [one for one in upper.lines if one.get_label() == "−K₂ − R₂ L"]
    x, y = (np.asarray(v, dtype=float) for v in line.get_data())
    assert np.abs(np.interp([15.0, 240.0], x, y) - expected[[0, -1]]).max() < 1.0
    assert np.abs(after).max() < 2.0


def test_ranging_figure_takes_each_station_where_it_belongs(ranging_result: RangingResult) -> None:
    """Rationale: K2 and R2 come from one station, m_z from the other, which may read 5 mm more; a line through the differences to
    the wrong one misses its own points. Expected: above the differences to the first, below to the second, both named; bars of
    LiDAR (1.5 mm of 5 scans) and station (2 and 1 mm of 5 readings) together: sqrt(1.5^2 + 2^2) / sqrt(5) = 1.118 mm and 0.806 mm.
    Tolerance: drawing."""
    panels = tuple(replace(p, reference_m=(p.reference_m or 0.0) + 0.005) for p in ranging_result.panels)
    more = {
        "stations": {"correction": "T1", "reference": "T2"},
        "reading_std_m": {"correction": 0.002, "reference": 0.001},
    }
    value = replace(ranging_result.indicator, companions={**ranging_result.indicator.companions, **more})
    figure = drawn(lambda: bench_plots.ranging_errors(replace(ranging_result, panels=panels, indicator=value)))
    upper, lower = figure.axes
    before, after = (np.asarray(a.containers[0].lines[0].get_ydata(), dtype=float) for a in (upper, lower))
    assert before == pytest.approx([1000.0 * (p.lidar_m - (p.correction_m or 0.0)) for p in panels], abs=1e-6)
    assert after == pytest.approx(
        [1000.0 * ((p.corrected_m or 0.0) - (p.reference_m or 0.0)) for p in panels], abs=1e-6
    )
    assert upper.get_title(loc="left").endswith("LiDAR − T1") and lower.get_title(loc="left").endswith("LiDAR − T2")
    for axes, half in ((upper, 1.118), (lower, 0.806)):
        segments = axes.containers[0].lines[2][0].get_segments()
        assert [0.5 * np.ptp(s[:, 1]) for s in segments] == pytest.approx([half] * 6, abs=1e-3)


def test_ranging_without_reference_or_constants(ranging_result: RangingResult) -> None:
    """Rationale: fewer than five panels give distances but no K2, R2; one panel may have no true value. Expected: a figure with the
    panels that have one; none at all: no figure."""
    panels = tuple(replace(p, corrected_m=None, reference_m=None) for p in ranging_result.panels)
    bare = replace(ranging_result, panels=panels, additive_constant_m=None, multiplication_constant=None)
    figure = drawn(lambda: bench_plots.ranging_errors(bare))
    assert len(figure.axes[0].containers[0].lines[0].get_ydata()) == 6  # type: ignore[attr-defined, arg-type]
    nothing = tuple(replace(p, correction_m=None) for p in panels)
    assert bench_plots.ranging_errors(replace(bare, panels=nothing)) is None


def test_decimals_of_a_small_value() -> None:
    """Rationale: 0.00048 % shown as 0.00 % says nothing. Expected: two digits at least; 99.83 and 1.23 as ever; 3 for pixels."""
    cases = (
        (0.00048, "%", 5),
        (0.0371, "%", 3),
        (0.37, "%", 2),
        (99.83, "%", 2),
        (0.0627, "pixel", 3),
        (0.004, "pixel", 4),
    )
    assert [shown_decimals(value, unit) for value, unit, _ in cases] == [d for *_, d in cases]
    assert shown_decimals(None, "%") == shown_decimals(0.0, "%") == 2
    assert shown_decimals(1e-12, "%") == 6


@pytest.mark.usefixtures("quick")
def test_missing_picture_names_no_folder(evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: a report travels; where the campaign lay is nobody's business. Expected: the path inside the campaign only."""
    write_report(
        tmp_path / "r.html", replace(evaluation, residuals=(), waveforms=(), panels=(), mounting=None), None, "en"
    )
    text = (tmp_path / "r.html").read_text()
    assert "No picture: sorties/01/images/s01_000.jpg" in text
    assert str(evaluation.root) not in text


@pytest.mark.usefixtures("quick")
def test_score_table_of_small_constants(bench_evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: R2 = 0.0002 with four decimals is one digit. Expected: two digits of the standard deviation; a figure without one
    has none."""
    item = ScoreItem(
        quantity="ranging_multiplication_constant",
        unit="1",
        truth=2e-4,
        estimate=2.012e-4,
        error=1.2e-6,
        std=5e-6,
        z=0.24,
    )
    rms = replace(item, quantity="distortion_map_rms_px", truth=0.0, estimate=0.031, error=0.031, std=0.0, z=None)
    write_report(tmp_path / "r.html", bench_evaluation, Score(campaign="hand-made", items=(item, rms)), "en")
    text = (tmp_path / "r.html").read_text()
    for cell in ("0.0002012", "+0.0000012", "0.0000050", "+0.24", "+0.0310"):
        assert f'<td class="n">{cell}</td>' in text
