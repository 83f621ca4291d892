"""Progress: plain lines with the time that is left, no line when quiet, a bar that ends full."""

import io

import pytest

from testrange.progress import BarProgress, LineProgress, NullProgress, display, no_progress


def test_lines_say_what_is_left() -> None:
    """Rationale: a log wants few lines. Expected: begin, after 12 s of 3 steps out of 12 "about 36 s left" (4 s a step, 9 steps),
    none 8 s later, end with the duration when the next stage begins."""
    now = [0.0]
    stream = io.StringIO()
    with LineProgress(stream, clock=lambda: now[0]) as progress:
        progress("render", 0, 12)
        now[0] = 12.0
        progress("render", 3, 12)
        now[0] = 20.0
        progress("render", 5, 12)
        now[0] = 50.0
        progress("render", 12, 12)
        progress("lidar", 0, 0)
        now[0] = 51.5
    assert stream.getvalue().splitlines() == [
        "render …",
        "render: 3 of 12, about 36 s left",
        "render: 50.0 s",
        "lidar …",
        "lidar: 1.5 s",
    ]


def test_stage_and_advance() -> None:
    """Rationale: the same display serves both ways of counting. Expected: the same lines as by calling."""
    now = [0.0]
    stream = io.StringIO()
    with LineProgress(stream, clock=lambda: now[0]) as progress:
        progress.stage("render", 4)
        now[0] = 10.0
        progress.advance()
    assert stream.getvalue().splitlines() == ["render …", "render: 1 of 4, about 30 s left", "render: 10.0 s"]


def test_a_failed_stage_has_no_end() -> None:
    """Rationale: "render: 3.0 s" after an error would claim that it was done. Expected: no such line."""
    stream = io.StringIO()
    with pytest.raises(ValueError, match="bad"), LineProgress(stream) as progress:
        progress("render", 0, 2)
        raise ValueError("bad")
    assert stream.getvalue() == "render …\n"


def test_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: --quiet, and callers that want no display. Expected: not a character."""
    with display(quiet=True) as progress:
        progress("render", 1, 2)
    no_progress("render", 1, 2)
    assert isinstance(progress, NullProgress)
    printed = capsys.readouterr()
    assert (printed.out, printed.err) == ("", "")


def test_bar_ends_full(capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: a stage may end before its last report. Expected: the bar stands at 4/4 on stderr, nothing on stdout."""
    with BarProgress() as progress:
        progress("render", 1, 4)
        progress("lidar", 2, 2)
    printed = capsys.readouterr()
    assert "4/4" in printed.err
    assert "2/2" in printed.err
    assert printed.out == ""
