"""What the command line says beside its tables."""

import io
from types import SimpleNamespace
from typing import Any, cast

import pytest

from evaluator.documents.model import Language
from evaluator.results import Evaluation
from testrange import tables


def told(language: Language, **of: Any) -> list[str]:
    """Lines of `print_doubts`."""
    evaluation = SimpleNamespace(**{"survey_doubts": (), "stated_doubts": (), "closure": {}} | of)
    out = io.StringIO()
    console = tables.console(out)
    tables.print_doubts(cast("Evaluation", evaluation), console, language)
    return out.getvalue().splitlines()


def test_nothing_is_said_of_a_sound_campaign() -> None:
    assert told("zh", closure={"closes": True}) == []
    assert told("en") == []


@pytest.mark.parametrize(
    ("language", "words"),
    [
        (
            "en",
            ["surveyed place of F07", "camera_cy_px: off by +3 px", "chi-square 14.2 > 12.6; by chance once in twenty"],
        ),
        (
            "zh",
            ["靶标 F07 的控制测量位置存疑", "给定值与观测值矛盾：相机 cy", "闭合差超出 95 % 限值：χ² 14.2 > 12.6"],
        ),
    ],
)
def test_doubts_are_said_beside_the_grades(language: Language, words: list[str]) -> None:
    """Rationale: grades can be best while a stale certificate moves a mounting by ten of its deviations."""
    lines = told(
        language,
        survey_doubts=("F07",),
        stated_doubts=("camera_cy_px: off by +3 px",),
        closure={"closes": False, "chi_square": 14.23, "limit_95": 12.59},
    )
    assert len(lines) == 3
    for line, word in zip(lines, words, strict=True):
        assert word in line
