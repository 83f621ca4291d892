"""An evaluator of somebody else's: how it is run, and what is accepted of what it writes."""

import json
import time
from pathlib import Path

import pytest

from campaign.errors import ConfigError
from evaluator.algorithms.program import MAX_BYTES, run_program
from evaluator.model import EvaluationError

MOUNTING = {
    "names": ["camera_boresight_roll", "lidar_boresight_roll"],
    "units": ["deg", "deg"],
    "estimates": [0.251, -0.198],
    "std": [0.002, 0.003],
}


def program(folder: Path, script: str) -> Path:
    """A shell script as program; $1 is the campaign, $2 the file to write."""
    path = folder / "theirs"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return path


def answering(folder: Path, answer: object) -> Path:
    text = answer if isinstance(answer, str) else json.dumps(answer)
    (folder / "answer.json").write_text(text)
    return program(folder, f"cp '{folder}/answer.json' \"$2\"")


def test_a_part_of_the_results_is_enough(tmp_path: Path) -> None:
    """Rationale: an outsider writes what he computes. Expected: indicators and mounting come through as written, the rest
    is filled; the program got the campaign's absolute path and ran in another folder; what it printed is nowhere."""
    out = tmp_path / "seen"
    (tmp_path / "answer.json").write_text(
        json.dumps({"indicators": {"calibration_error": {"value": 0.31, "grade": "mine"}}, "mounting": MOUNTING})
    )
    path = program(tmp_path, f"echo noise; pwd > '{out}'; echo \"$1\" >> '{out}'; cp '{tmp_path}/answer.json' \"$2\"")
    found = run_program(path, tmp_path, "demo", 20.0)
    assert found["indicators"]["calibration_error"]["value"] == 0.31
    assert "grade" not in found["indicators"]["calibration_error"]
    assert found["mounting"] == {"status": "measured", **MOUNTING} and found["campaign"] == "demo"
    folder, campaign = out.read_text().splitlines()
    assert campaign == str(tmp_path) and folder != campaign and not Path(folder).exists()


@pytest.mark.parametrize(
    ("answer", "what"),
    [
        ("{", "is no JSON"),
        ("[" * 200_000, "is no JSON"),
        ('{"indicators": {"calibration_error": {"value": NaN}}}', "NaN is no number of JSON"),
        ('{"indicators": {"calibration_error": {"value": 1e999}}}', "is not finite"),
        ({"indicators": {"calibration_error": {"value": "0.3"}}}, "is no number; got '0.3'"),
        ({"indicators": {"calibration_error": {"value": True}}}, "is no number; got True"),
        ({"indicators": {"calibration_err": {"value": 1.0}}}, "is no indicator; got 'calibration_err'"),
        ({"indicators": [1]}, "indicators is no object"),
        ([1], "its results are no object"),
        ({}, "hold neither indicators nor a mounting"),
        ({"schema": 9, "mounting": MOUNTING}, "another schema"),
        ({"campaign": "other", "mounting": MOUNTING}, "another campaign's; got 'other'; expected demo"),
        ({"mounting": MOUNTING | {"std": [0.1]}}, "differ in length"),
        ({"mounting": MOUNTING | {"std": [0.1, -1.0]}}, "std is below zero"),
        ({"mounting": MOUNTING | {"names": [1, 2]}}, "holds what is no text"),
        ({"mounting": MOUNTING | {"names": ["x"] * 101}}, "names is no list"),
        ({"mounting": {k: v for k, v in MOUNTING.items() if k != "units"}}, "units is no list"),
    ],
)
def test_hostile_results_are_refused_in_one_line(tmp_path: Path, answer: object, what: str) -> None:
    """Rationale: what it wrote is from outside. Expected: told what is wrong, no traceback, nothing read before."""
    with pytest.raises(EvaluationError) as told:
        run_program(answering(tmp_path, answer), tmp_path, "demo", 20.0)
    assert what in str(told.value) and "\n" not in str(told.value) and str(tmp_path) not in str(told.value)


@pytest.mark.parametrize(
    ("script", "what"),
    [
        ("echo 'first line' >&2; printf 'no licence\\033[31m\\n' >&2; exit 3", "ended with code 3; got no licence"),
        ("kill -SEGV $$", "was ended by signal 11"),
        ("exit 0", "wrote no results file"),
        ('mkdir "$2"', "its results file is no file"),
        ('ln -s /etc/hostname "$2"', "its results file is no file"),
        ('mkfifo "$2"', "its results file is no file"),
    ],
)
def test_a_program_that_fails_is_told(tmp_path: Path, script: str, what: str) -> None:
    """Rationale: raises, dies, writes nothing or no file. Expected: each told; control characters of its last line do not
    reach the terminal."""
    with pytest.raises(EvaluationError) as told:
        run_program(program(tmp_path, script), tmp_path, "demo", 20.0)
    assert what in str(told.value) and "\x1b" not in str(told.value)


def test_a_program_that_hangs_is_ended_with_all_it_started(tmp_path: Path) -> None:
    """Rationale: a shell that waits for another program. Expected: stopped at the limit; the grandchild, which would write
    a file after three seconds, does not live to do it. Tolerance: the limit of 1 s, 8 s for a busy machine."""
    late = tmp_path / "late"
    start = time.monotonic()
    with pytest.raises(EvaluationError, match=r"theirs: took longer than 1 s and was stopped"):
        run_program(program(tmp_path, f"(sleep 3; touch '{late}') & wait"), tmp_path, "demo", 1.0)
    assert time.monotonic() - start < 9.0
    time.sleep(max(0.0, 3.5 - (time.monotonic() - start)))
    assert not late.exists()


def test_a_program_that_fills_the_disk_is_ended(tmp_path: Path) -> None:
    """Rationale: the limit of time alone lets it write for an hour. Expected: ended soon after it passed the limit of bytes."""
    path = program(tmp_path, 'while :; do head -c 4000000 /dev/zero >> "$2"; done')
    with pytest.raises(EvaluationError, match=rf"wrote more than {MAX_BYTES} bytes and was stopped"):
        run_program(path, tmp_path, "demo", 30.0)


def test_what_cannot_be_run_is_told_before(tmp_path: Path) -> None:
    """Rationale: a path mistyped. Expected: no such program; not executable, with the remedy."""
    with pytest.raises(ConfigError, match="no such program"):
        run_program(tmp_path / "none", tmp_path, "demo")
    (tmp_path / "text").write_text("hello")
    with pytest.raises(ConfigError, match=r"cannot be run; chmod \+x text"):
        run_program(tmp_path / "text", tmp_path, "demo")
    (tmp_path / "text").chmod(0o755)
    with pytest.raises(EvaluationError, match="cannot be started: Exec format error"):
        run_program(tmp_path / "text", tmp_path, "demo")
