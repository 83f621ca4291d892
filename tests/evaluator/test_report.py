"""The report: self-contained, escaped, small, the same bytes twice, complete, and in two languages with the same numbers."""

import base64
import html
import re
import runpy
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.quiver import Quiver

from campaign.errors import TestrangeError
from evaluator.conformity import Row
from evaluator.documents.model import LANGUAGES, Language, Paragraph
from evaluator.documents.test_report import build_test_report
from evaluator.model import CampaignData
from evaluator.report import hero_picture, write_report
from evaluator.report import pictures as page_pictures
from evaluator.report.overlays import shots, spots_by_image
from evaluator.report.photos import choose_images
from evaluator.report.plots import residual_vectors
from evaluator.report.texts import TABLE, Texts
from evaluator.results import Evaluation, build_results
from evaluator.scores.score import Score, ScoreItem

BROWSER = runpy.run_path(str(Path(__file__).with_name("browser.py")))
CHROMIUM = BROWSER["chromium"]()
NO_FIGURES = {"waveforms": (), "panels": (), "residuals": (), "mounting": None}


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, but not written as SVG: seconds for tests that look at the words."""
    monkeypatch.setattr(page_pictures, "svg_uri", lambda figure: "data:image/svg+xml;base64,")


def made_up_score() -> Score:
    """Two quantities, one without a standard deviation."""
    item = ScoreItem(
        quantity="camera_boresight_roll", unit="deg", truth=0.25, estimate=0.2531, error=0.0031, std=0.003, z=1.0333
    )
    return Score(
        campaign="hand-made", items=(item, replace(item, quantity="lidar_lever_arm_z", unit="m", std=0.0, z=None))
    )


def words(path: Path) -> str:
    """The page without its pictures and markup."""
    text = re.sub(r"<style>.*?</style>|data:[^\"')]+", "", path.read_text(), flags=re.S)
    return html.unescape(re.sub(r"<[^>]+>", " ", text))


def test_complete_report(previews: CampaignData, evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: a person reads the test in this one file, offline. Expected: every indicator with its grade, every conformity row,
    both photographs with their enlarged targets, the score; no address outside the file, no script; under 10 MB; the same bytes
    twice. Tolerance: none."""
    path = tmp_path / "report.html"
    tight = np.full(12, 1e-4)  # priors that no flight beats: every parameter is "not determined"
    evaluation = replace(evaluation, mounting_prior_std=tight)
    write_report(path, evaluation, made_up_score(), "en")
    text = path.read_text()
    plain = html.unescape(text)
    for word in (
        "LiDAR reflectance RMSE",
        "excellent",
        "not measured",
        "1.23",
        "0.500",
        "Synthetic data of a virtual range",
    ):
        assert word in plain
    for row in evaluation.conformity:
        assert row.requirement in plain
        assert row.measured in plain
    assert text.count("data:image/jpeg") == 4  # two images, and a sheet of enlarged targets for each
    assert text.count("data:image/svg+xml") == 9
    assert "camera boresight roll" in text
    assert "+1.03" in text
    assert plain.count("not determined: ρ = ") == 12
    assert re.findall(r"(?:src|href|url)\s*[=(]\s*[\"']?(?!data:|#)[^\s\"')]+", text) == []
    assert "<script" not in text
    assert "default-src 'none'" in text
    assert str(evaluation.root) not in text
    assert len(text) < 10e6
    write_report(path, evaluation, made_up_score(), "en")
    assert path.read_text() == text


@pytest.mark.usefixtures("quick")
def test_two_languages_one_set_of_numbers(previews: CampaignData, evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: Chinese is the default; a translation must not change a figure. Expected: Chinese headings and grades, no English
    heading, the same numbers in the same order as the English page once both are stripped of words. Tolerance: none."""
    pages = {}
    for language in ("zh", "en"):
        write_report(tmp_path / "r.html", evaluation, made_up_score(), language)
        pages[language] = words(tmp_path / "r.html")
    assert "检测结果" in pages["zh"] and "安置参数" in pages["zh"] and "相机 安置角误差 横滚" in pages["zh"]
    assert "Indicators and grades" not in pages["zh"] and "检测结果" not in pages["en"]
    figures = {k: re.findall(r"[+-]?\d+\.\d{2,}", page) for k, page in pages.items()}
    assert figures["zh"] == figures["en"]
    assert len(figures["zh"]) > 80
    write_report(tmp_path / "r.html", evaluation, made_up_score())
    assert words(tmp_path / "r.html") == pages["zh"]


def test_every_text_is_there_twice() -> None:
    """Rationale: one table of texts. Expected: each key with Chinese and English (a note may be empty in one), the same fields
    in both, and only keys that the table has are asked for by the template."""
    field = re.compile(r"{(\w+)")
    for key, (zh, en) in TABLE.items():
        assert zh or en, key
        if zh and en:
            assert sorted(field.findall(zh)) == sorted(field.findall(en)), key
    template = Path(page_pictures.__file__).with_name("template.html.j2").read_text()
    asked = set(re.findall(r"\bt\(\"(\w+)\"\s*[,)]", template))
    assert len(asked) > 60
    assert asked <= set(TABLE)
    with pytest.raises(KeyError):
        Texts("zh")("no such key")


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("language", LANGUAGES)
def test_replaced_algorithms_are_named(evaluation: Evaluation, tmp_path: Path, language: Language) -> None:
    """Rationale: figures by somebody else's algorithm must not pass for the evaluator's. Expected: page and test report name each
    slot with its function at the head, markup in it as characters; neither says anything where nothing was replaced."""
    words = Texts(language)("foreign")
    named = {"mark_measurement": "my.marks:find", "vertex_estimation": "<script>alert(1)</script>"}
    for algorithms in (named, {}):
        page = replace(evaluation, algorithms=algorithms, data=None, **NO_FIGURES)  # type: ignore[arg-type]
        write_report(tmp_path / "r.html", page, None, language)
        text = (tmp_path / "r.html").read_text()
        blocks = build_test_report(page, build_results(page), language).blocks
        told = [b.text for b in blocks if isinstance(b, Paragraph) and "my.marks:find" in b.text]
        assert (words in html.unescape(text)) == bool(algorithms)
        assert len(told) == bool(algorithms)
        assert "<script" not in text
        if algorithms:
            head = text[text.index("<header>") : text.index("</header>")]
            assert all(html.escape(part) in head and part in told[0] for pair in named.items() for part in pair)


def test_no_arrow_leaves_its_plot(evaluation: Evaluation) -> None:
    """Rationale: a mark near the image's corner with a residual that points outward was cut. Expected: feet and tips of all
    arrows lie within the axes, for a corner, and for one residual a thousand times the others. Tolerance: none."""
    assert evaluation.data is not None
    assert evaluation.data.camera is not None
    size = evaluation.data.camera.width_px, evaluation.data.camera.height_px
    first = evaluation.residuals[0]
    for far in (2.0, 500.0):
        corner = replace(first, observed_px=(size[0] - 2.0, 1.0), projected_px=(size[0] - 2.0 + far, 1.0 - far))
        drawn = residual_vectors(replace(evaluation, residuals=(*evaluation.residuals, corner)), Texts("en"))
        axes = drawn.axes[0]
        arrows = next(c for c in axes.collections if isinstance(c, Quiver))
        tips = arrows.XY + np.column_stack([arrows.U, arrows.V])
        (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
        for points in (arrows.XY, tips):
            assert left <= points[:, 0].min()
            assert points[:, 0].max() <= right
            assert top <= points[:, 1].min()
            assert points[:, 1].max() <= bottom
        assert right - left < 1.6 * size[0]


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("language", ["zh", "en"])
def test_markup_is_escaped(evaluation: Evaluation, tmp_path: Path, language: str) -> None:
    """Rationale: a campaign folder is somebody else's text. Expected: a script in a record, in the campaign's name and in the
    boards' block arrives as characters; a name that looks like the page's own place marker moves nothing."""
    evil = "<script>alert(1)</script>"
    row = Row(clause="7.1 a", requirement="aircraft", measured=evil, limit="<b>", status="pass")
    boards = {"status": "not_measured", "reason": evil, "not_in_images": {evil: evil}}
    page = replace(
        evaluation,
        campaign=f"{evil}/*font*/",
        conformity=(row,),
        problems=(evil,),
        boards=boards,
        data=None,
        **NO_FIGURES,  # type: ignore[arg-type]
    )
    write_report(tmp_path / "r.html", page, None, language)  # type: ignore[arg-type]
    text = (tmp_path / "r.html").read_text()
    assert "<script" not in text
    assert text.count(html.escape(evil)) >= 5
    assert text.index("@font-face") < text.index("</style>")


@pytest.mark.usefixtures("quick")
def test_text_that_turns_the_reading_direction_or_never_ends(evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: a right-to-left override in a title reads "gnp.exe" backwards, an escape character colours a terminal, a reason
    of a megabyte hides the page. Expected: neither arrives, the letters around them do; a text is cut at some thousand characters.
    Tolerance: none."""
    evil = "a\u202eb\u2066c\x1b[31md\x00e\x9bf"
    page = replace(evaluation, campaign=evil, problems=(evil, "W" * 1_000_000), data=None, **NO_FIGURES)  # type: ignore[arg-type]
    write_report(tmp_path / "r.html", page, None, "zh")
    text = (tmp_path / "r.html").read_text()
    assert not re.search("[\u202a-\u202e\u2066-\u2069\x00-\x08\x0e-\x1f\x7f-\x9f]", text)
    assert "abc[31mdef" in text
    assert "W" * 1_000 in text and "W" * 3_000 not in text


@pytest.mark.usefixtures("quick")
def test_bare_report(evaluation: Evaluation, bare_data: CampaignData, tmp_path: Path) -> None:
    """Rationale: a campaign of which nothing could be measured has a report too, which says so. Expected: each indicator is listed
    as not measured with its reason and what it needs; the parts of the folder are "none"; no picture; a field campaign is not
    called simulated."""
    nothing = Evaluation(campaign="empty", synthetic=False, indicators={}, data=bare_data, mounting_reason="no targets")
    write_report(tmp_path / "r.html", nothing, None)
    text = (tmp_path / "r.html").read_text()
    assert text.count('class="grade not_measured"') == 8 + 6 + 8  # cards, groups, sections
    assert "8 项指标中已测 0 项" in text
    assert text.count("本次检测无：bench/chessboard") == 3  # card, list of what is missing, section
    assert "bench/chessboard 的影像、board.json 与 log.csv" in text
    assert text.count('<td class="s-warning">无</td>') == 8
    assert "仿真" not in words(tmp_path / "r.html")
    assert "未测：no targets" in text
    assert "data:image/" not in text
    assert 'id="flight"' not in text and 'id="images"' not in text


NAMES = tuple(f"camera_{n}" for n in ("boresight_roll", "boresight_pitch", "lever_arm_x"))


@pytest.mark.usefixtures("quick")
def test_what_the_flight_does_not_determine(evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: a flight on one heading gives no number for what it cannot tell; swapped boards, a contradiction between the
    sensors and clocks must meet the eye. Expected: "not determined" with the partner, its correlation and the strip that helps,
    in place of the estimate; the swapped pair; "do not agree"; the half-window count beside the sub-pixel centres."""
    weak = {
        "parameter": "camera_lever_arm_x",
        "unit": "m",
        "reason": "tied",
        "std": 0.06,
        "prior_std": 0.1,
        "partner": "camera_boresight_pitch",
        "correlation": -0.97,
        "helping_strip": "opposite heading",
        "std_with_it": 0.0021,
    }
    boards = {
        "status": "measured",
        "names": NAMES,
        "units": ("deg", "deg", "m"),
        "estimates": (0.8, -0.5, None),
        "std": (0.01, 0.01, 0.06),
        "prior_std": (1.0, 1.0, 0.1),
        "covariance": [[1e-4, 0.0, 0.0], [0.0, 1e-4, -5.8e-4], [0.0, -5.8e-4, 3.6e-3]],
        "not_determined": (weak,),
        "observations": 40,
        "images": 5,
        "mean_residual_px": 0.3,
        "mean_residual_without_navigation_px": 0.2,
        "sigma0": 1.0,
        "redundancy": 80,
        "rejected": ("B01 and B02 are swapped: each fits at the other's place",),
        "swapped": (("B01", "B02"),),
        "half_window_count": {
            "observations": 40,
            "spread_against_fit_px": 0.31,
            "mean_residual_px": 0.5,
            "estimates": (0.79, -0.51, 0.02),
            "std": (0.02, 0.02, 0.07),
        },
    }
    six = [f"camera_from_lidar_{n}" for n in ("roll", "pitch", "yaw", "x", "y", "z")]
    closure = {
        "names": six,
        "units": ["deg"] * 3 + ["m"] * 3,
        **{key: [0.01] * 6 for key in ("composed", "joint", "difference", "std", "half_width_95")},
        "z": [4.4] * 6,
        "chi_square": 30.0,
        "freedom": 6,
        "limit_95": 12.59,
        "closes": False,
    }
    page = replace(evaluation, boards=boards, closure=closure, data=None, waveforms=(), panels=(), residuals=())
    write_report(tmp_path / "r.html", page, None, "en")
    text = words(tmp_path / "r.html")
    assert "not determined : ρ = -0.97 with camera boresight pitch" in re.sub(
        r"\s+:", " :", text.replace("determined:", "determined :")
    )
    assert "a strip that would help: opposite heading, std then 0.0021" in text
    assert "B01 ↔ B02" in text
    assert "do not agree" in text and "+4.40" in text
    assert "+0.790 (0.020)" in text and "spread against the sub-pixel centres 0.31 px" in text
    write_report(tmp_path / "r.html", page, None, "zh")
    text = words(tmp_path / "r.html")
    assert "可加飞：对向航线，标准差将为 0.0021" in text and "不闭合" in text


def test_missing_preview_is_said(evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: images may be missing on disk. Expected: each is named with the reason and the rest is drawn."""
    write_report(tmp_path / "r.html", replace(evaluation, **NO_FIGURES), None, "en")  # type: ignore[arg-type]
    text = (tmp_path / "r.html").read_text()
    assert evaluation.data is not None
    assert text.count("No picture: sorties/") == sum(len(s.exposures) for s in evaluation.data.sorties)
    assert "data:image/svg+xml" in text


def _decoded(uri: str) -> np.ndarray:
    found = cv2.imdecode(np.frombuffer(base64.b64decode(uri.partition(",")[2]), np.uint8), cv2.IMREAD_COLOR)
    assert found is not None
    return found


def test_each_image_with_all_its_targets(previews: CampaignData, evaluation: Evaluation) -> None:
    """Rationale: a person believes a residual who sees the mark. Expected: every exposure once, in order; marks, vertices and
    regions as the evaluation holds them; in the sheet a cell for each target with its dark mark in the middle.
    Tolerance: half a pixel of the original in the cell, the crop is made of whole pixels."""
    found = list(shots(evaluation))
    exposed = [(s.folder.number, e.image) for s in previews.sorties for e in s.exposures]
    assert [(s.sortie, s.image) for s in found] == exposed
    shown = [s for s in found if not s.reason]
    assert [s.image for s in shown] == ["s01_000.tif", "s02_000.tif"]
    for shot in shown:
        mine = {r.target: r for r in evaluation.residuals if r.image == shot.image}
        assert {s.target for s in shot.spots if s.kind == "frustum"} == set(mine)
        assert shot.mean_error_px == pytest.approx(np.mean([r.error_px for r in mine.values()]))
        sheet = _decoded(shot.sheet_uri)
        assert sheet.shape[:2] == (shot.sheet_height, shot.sheet_width)
        for zoom in shot.zooms:
            if zoom.kind != "frustum":
                continue
            assert zoom.observed is not None
            assert np.hypot(zoom.observed[0] - zoom.x - 64, zoom.observed[1] - zoom.y - 64) < 4.0
            assert sheet[int(zoom.observed[1]), int(zoom.observed[0])].max() < 80
        assert _decoded(shot.uri).shape[1] <= shot.width_px


def test_raw_image_in_the_place_of_a_preview(previews: CampaignData, evaluation: Evaluation) -> None:
    """Rationale: a field campaign may hold TIFFs alone. Expected: the image itself, stretched: dark stays dark, bright becomes
    bright, and the page says where it comes from."""
    import tifffile

    assert previews.camera is not None
    sheet = previews.camera
    folder = previews.sorties[0].folder.images
    (folder / "s01_000.jpg").unlink()
    dn = np.full((sheet.height_px, sheet.width_px, len(sheet.bands)), 400, np.uint16)
    dn[: sheet.height_px // 2] = 2000
    tifffile.imwrite(folder / "s01_000.tif", dn, photometric="rgb" if len(sheet.bands) == 3 else "minisblack")
    first = next(iter(shots(evaluation)))
    assert first.raw and not first.reason
    picture = _decoded(first.uri)
    assert picture[5].mean() > 240 and picture[-5].mean() < 160


def test_budget_of_a_full_size_campaign(
    previews: CampaignData, evaluation: Evaluation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: 48 images of 45 megapixels must fit into 30 MB; noise is the worst that JPEG can meet. Expected: with fewer
    exposures and a smaller budget the JPEGs stay within it (base64 adds a third), none is left out."""
    from evaluator.report import overlays

    sortie = previews.sorties[0]
    exposures = tuple(
        replace(sortie.exposures[0], image=f"n{k:02d}.tif", gps_time_s=sortie.exposures[0].gps_time_s + k)
        for k in range(8)
    )
    many = replace(previews, sorties=(replace(sortie, exposures=exposures),))
    rng = np.random.default_rng(5)
    noise = rng.integers(0, 255, (600, 800, 3), dtype=np.uint8)
    sheet = many.camera.model_copy(update={"width_px": 800, "height_px": 600})  # type: ignore[union-attr]
    monkeypatch.setattr(overlays, "_PHOTO_BUDGET", 600_000)
    monkeypatch.setattr(overlays, "_ZOOM_BUDGET", 300_000)
    monkeypatch.setattr(overlays, "_pixels", lambda *_: (noise, False))
    spots = spots_by_image(evaluation)[(1, "s01_000.tif")]
    monkeypatch.setattr(overlays, "spots_by_image", lambda _: {(1, e.image): spots for e in exposures})
    found = list(shots(replace(evaluation, data=replace(many, camera=sheet))))
    assert len(found) == 8
    total = sum(len(s.uri) + len(s.sheet_uri) for s in found)
    assert total < 0.9e6 * 4 / 3 * 1.01
    assert _decoded(found[0].uri).shape[1] >= 300


def test_image_with_most_targets(evaluation: Evaluation) -> None:
    """Rationale: the picture should show as much as possible. Expected: a second image with one target only is not chosen."""
    one = replace(evaluation.residuals[0], image="s01_999.tif")
    assert choose_images(replace(evaluation, residuals=(*evaluation.residuals, one))) == [
        (1, "s01_000.tif"),
        (2, "s02_000.tif"),
    ]


def test_hero_picture(previews: CampaignData, evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: the README opens with it. Expected: 1440 x 984 px, not one colour; an evaluation without
    images is refused with one line. Tolerance: none."""
    path = tmp_path / "hero.png"
    hero_picture(path, evaluation)
    pixels = cv2.imread(str(path))
    assert pixels is not None
    assert pixels.shape == (984, 1440, 3)
    assert np.unique(pixels.reshape(-1, 3), axis=0).shape[0] > 1000
    with pytest.raises(TestrangeError, match="no image with observed targets"):
        hero_picture(path, replace(evaluation, regions=(), residuals=(), marks=()))


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_page_in_a_browser(previews: CampaignData, evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: a page that people open from disk must work there, on a phone too, without a network. Expected: no console error
    (the content security policy reports there), no request but for the file and what it carries, the indicators' table and all
    eight cards, every picture decoded; nothing wider than a phone's 390 px; a click opens a picture large, another closes it.
    Tolerance: none."""
    path = tmp_path / "report.html"
    write_report(path, evaluation, made_up_score())
    with BROWSER["Browser"](CHROMIUM) as page:
        page.size(390, 800)
        page.load(path)
        assert page.script("document.querySelectorAll('table.indicators tbody tr').length") == 6
        assert page.script("document.querySelectorAll('#summary + .grid > .card').length") == 8
        assert page.script("document.documentElement.scrollWidth") <= 390
        decoded = page.script(
            "Promise.all([...document.images].map(async i => { return (i.loading = 'eager', await i.decode(), i.naturalWidth) }))"
        )
        assert len(decoded) == 13 and min(decoded) > 100
        frame = "getComputedStyle(document.querySelector('.shots .frame')).position"
        assert page.script(frame) == "static"
        page.script("document.querySelector('.shots .open').click()")
        assert page.script(frame) == "fixed"
        page.script("document.querySelector('.shots .open').click()")
        assert page.script(frame) == "static"
        page.size(1280, 900)
        page.load(path)
        assert page.script("document.documentElement.scrollWidth") <= 1280
        assert page.script("document.fonts.ready.then(f => [...f].filter(x => x.status == 'loaded').length)") == 1
        assert [url for url in page.requests if not url.startswith(("file:", "data:", "about:"))] == []
        assert page.messages == []
