"""The report: self-contained, escaped, small, the same bytes twice, and complete."""

import html
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from campaign.errors import TestrangeError
from evaluator.conformity import Row
from evaluator.model import CampaignData
from evaluator.report import hero_picture, write_report
from evaluator.report.photos import choose_images
from evaluator.results import Evaluation
from evaluator.score import Score, ScoreItem

NO_FIGURES = {"waveforms": (), "panels": (), "residuals": (), "mounting": None}


def made_up_score() -> Score:
    """Two quantities, one without a standard deviation."""
    item = ScoreItem(
        quantity="camera_boresight_roll", unit="deg", truth=0.25, estimate=0.2531, error=0.0031, std=0.003, z=1.0333
    )
    return Score(
        campaign="hand-made", items=(item, replace(item, quantity="lidar_lever_arm_z", unit="m", std=0.0, z=None))
    )


def test_complete_report(previews: CampaignData, evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: a person reads the test in this one file, offline. Expected: every indicator in both languages with its grade,
    every conformity row, both photographs, the score; no address outside the file; under 10 MB; the same bytes
    twice. Tolerance: none."""
    path = tmp_path / "report.html"
    tight = np.full(12, 1e-4)  # priors that no flight beats: every parameter is "not determined"
    evaluation = replace(evaluation, mounting_prior_std=tight)
    write_report(path, evaluation, made_up_score())
    text = path.read_text()
    plain = html.unescape(text)
    for word in (
        "反射率中误差",
        "LiDAR reflectance RMSE",
        "优 · excellent",
        "未测",
        "1.23",
        "0.500",
        "Simulated campaign",
    ):
        assert word in plain
    for row in evaluation.conformity:
        assert row.requirement in plain
        assert row.measured in plain
    assert text.count("data:image/jpeg") == 3  # two annotated images and the zooms
    assert text.count("data:image/svg+xml") == 7
    assert "camera boresight roll" in text
    assert "+1.03" in text
    assert plain.count("not determined: ρ = ") == 12
    assert re.findall(r"(?:src|href|url)\s*[=(]\s*[\"']?(?!data:)[^\s\"')]+", text) == []
    assert "<script" not in text
    assert str(evaluation.root) not in text
    assert len(text) < 10e6
    write_report(path, evaluation, made_up_score())
    assert path.read_text() == text


def test_markup_is_escaped(evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: a campaign folder is somebody else's text. Expected: a script in a record arrives as characters."""
    evil = "<script>alert(1)</script>"
    row = Row(clause="7.1 a", requirement="aircraft", measured=evil, limit="<b>", status="pass")
    write_report(
        tmp_path / "r.html", replace(evaluation, conformity=(row,), problems=(evil,), data=None, **NO_FIGURES), None
    )
    text = (tmp_path / "r.html").read_text()
    assert "<script" not in text
    assert text.count(html.escape(evil)) == 2


def test_bare_report(evaluation: Evaluation, bare_data: CampaignData, tmp_path: Path) -> None:
    """Rationale: a campaign of which nothing could be measured has a report too. Expected: eight times 未测 and no picture,
    no heading without one; a field campaign is not called simulated."""
    nothing = Evaluation(campaign="empty", synthetic=False, indicators={}, data=bare_data, mounting_reason="no targets")
    write_report(tmp_path / "r.html", nothing, None)
    text = (tmp_path / "r.html").read_text()
    assert text.count("未测 · not measured</span>\n") == 8
    assert "Simulated campaign" not in text
    assert "Not measured: no targets" in text
    assert "data:image/" not in text
    assert "<h2>Pictures</h2>" not in text


def test_missing_preview_is_said(evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: previews are optional. Expected: the report says which one is missing and draws the rest."""
    write_report(tmp_path / "r.html", replace(evaluation, **NO_FIGURES), None)
    text = (tmp_path / "r.html").read_text()
    assert text.count("No picture:") == 2
    assert "data:image/svg+xml" in text


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
