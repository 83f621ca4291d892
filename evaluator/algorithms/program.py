"""A whole evaluator of somebody else's: a program that is given a campaign folder and the name of a results file to write.

It is called as `PROGRAM CAMPAIGN OUTPUT`, without a shell, in an empty folder, under a time limit. What it writes has the form
of results.json or of a part of it (`indicators`, `mounting`) and counts as hostile until it went through `read_output`.
"""

import json
import math
import os
import stat
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from campaign.errors import ConfigError
from evaluator.algorithms.apart import end_group
from evaluator.c10_1_grading import INDICATORS
from evaluator.model import EvaluationError
from evaluator.results import SCHEMA, read_results, write_json

PROGRAM_LIMIT_S = 3600.0
MAX_BYTES = 20_000_000
_MOST_NAMES = 100
_TAIL = 2000  # bytes of stderr that are kept


def check_program(path: Path) -> Path:
    """The program's absolute path.

    Raises
    ------
    ConfigError
        No such file, or not one that can be run.
    """
    if not path.is_file():
        raise ConfigError("no such program", where=str(path))
    if not os.access(path, os.X_OK):
        raise ConfigError("cannot be run", where=str(path), remedy=f"chmod +x {path.name}")
    return path.resolve()


def run_program(program: Path, campaign: Path, campaign_id: str, limit_s: float = PROGRAM_LIMIT_S) -> dict[str, Any]:
    """Runs the program and reads what it wrote.

    Parameters
    ----------
    program, campaign : Path
    campaign_id : str
        What results of this campaign must call it.
    limit_s : float
        After which the program is ended with all that it started. [s]

    Returns
    -------
    dict
        As `evaluator.results.read_results` gives it.

    Raises
    ------
    EvaluationError
        It cannot be started, fails, takes too long, or writes what is not accepted; the text says which.
    """
    program = check_program(program)
    with tempfile.TemporaryDirectory(prefix="testrange-") as folder:
        out = Path(folder) / "results.json"
        try:
            process = subprocess.Popen(
                [str(program), str(campaign.resolve()), str(out)],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        except OSError as error:
            raise EvaluationError(f"cannot be started: {error.strerror}", where=program.name) from None
        tail = bytearray()
        reader = threading.Thread(target=_keep_tail, args=(process, tail), daemon=True)
        reader.start()
        try:
            code = _wait(process, out, limit_s, program.name)
        finally:
            end_group(process)
            reader.join(1.0)
        if code != 0:
            lines = bytes(tail).decode(errors="replace").split("\n")
            last = next((line.strip() for line in reversed(lines) if line.strip()), "")
            how = f"ended with code {code}" if code > 0 else f"was ended by signal {-code}"
            raise EvaluationError(how, where=program.name, got=_printable(last)[:200] or None)
        return read_output(out, campaign_id, program.name)


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)


def _keep_tail(process: "subprocess.Popen[bytes]", tail: bytearray) -> None:
    assert process.stderr is not None
    with process.stderr as stream:
        while chunk := os.read(stream.fileno(), 65536):
            tail += chunk
            del tail[:-_TAIL]


def _wait(process: "subprocess.Popen[bytes]", out: Path, limit_s: float, name: str) -> int:
    """Its exit code. Raises where it takes too long or writes too much."""
    until = time.monotonic() + limit_s
    pause = 0.01
    while True:
        try:
            return process.wait(min(pause, max(until - time.monotonic(), 0.0)))
        except subprocess.TimeoutExpired:
            pause = min(2.0 * pause, 0.5)
        if time.monotonic() >= until:
            raise EvaluationError(f"took longer than {limit_s:g} s and was stopped", where=name)
        if out.is_file() and out.stat().st_size > MAX_BYTES:
            raise EvaluationError(f"wrote more than {MAX_BYTES} bytes and was stopped", where=name)


def read_output(path: Path, campaign_id: str, name: str) -> dict[str, Any]:
    """A program's results file, checked; parts that may be left out are there afterwards.

    Raises
    ------
    EvaluationError
        Missing, no regular file, too large, not JSON, of another campaign, or a number that is none.
    """
    try:
        status = path.lstat()
    except OSError:
        raise EvaluationError("wrote no results file", where=name) from None
    if not stat.S_ISREG(status.st_mode):
        raise EvaluationError("its results file is no file", where=name)
    if status.st_size > MAX_BYTES:
        raise EvaluationError("its results file is too large", where=name, expected=f"at most {MAX_BYTES} bytes")
    try:
        content = json.loads(path.read_bytes(), parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise EvaluationError(f"its results file is no JSON: {str(error)[:100]}", where=name) from None
    if not isinstance(content, dict):
        raise EvaluationError("its results are no object", where=name, got=type(content).__name__)
    if content.get("schema", SCHEMA) != SCHEMA:
        raise EvaluationError("its results have another schema", where=name, got=_short(content["schema"]))
    if content.get("campaign", campaign_id) != campaign_id:
        got = _short(content["campaign"])
        raise EvaluationError("its results are another campaign's", where=name, got=got, expected=campaign_id)
    clean = {
        "schema": SCHEMA,
        "campaign": campaign_id,
        "indicators": _indicators(content.get("indicators", {}), name),
        "conformity": [],
        "mounting": _mounting(content.get("mounting", {}), name),
    }
    if not clean["indicators"] and not clean["mounting"]:
        raise EvaluationError("its results hold neither indicators nor a mounting", where=name)
    with tempfile.TemporaryDirectory(prefix="testrange-") as folder:
        write_json(Path(folder) / "results.json", clean)
        return read_results(Path(folder) / "results.json")


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is no number of JSON")


def _short(value: object) -> str:
    return _printable(repr(value))[:60]


def _finite(value: object, what: str, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise EvaluationError(f"{what} is no number", where=name, got=_short(value))
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise EvaluationError(f"{what} is not finite", where=name)
    return number


def _indicators(block: object, name: str) -> dict[str, Any]:
    """Indicator -> value and what `score` reads of its companions."""
    if not isinstance(block, Mapping):
        raise EvaluationError("indicators is no object", where=name, got=_short(block))
    out: dict[str, Any] = {}
    for key, found in block.items():
        if key not in INDICATORS:
            raise EvaluationError("is no indicator", where=name, got=_short(key), expected=", ".join(INDICATORS))
        if not isinstance(found, Mapping):
            raise EvaluationError(f"indicators.{key} is no object", where=name, got=_short(found))
        value = found.get("value")
        companions = found.get("companions", {})
        out[key] = {
            "value": None if value is None else _finite(value, f"indicators.{key}.value", name),
            "unit": INDICATORS[key].unit,
            "companions": companions if isinstance(companions, Mapping) else {},
        }
    return out


def _columns(block: Mapping[str, Any], where: str, name: str) -> dict[str, Any]:
    """names, units, estimates, std of one length."""
    lists = {}
    for key in ("names", "units", "estimates", "std"):
        column = block.get(key)
        if not isinstance(column, list) or not 0 < len(column) <= _MOST_NAMES:
            raise EvaluationError(f"{where}.{key} is no list", where=name, expected=f"1 to {_MOST_NAMES} entries")
        lists[key] = column
    if len({len(column) for column in lists.values()}) != 1:
        raise EvaluationError(f"{where}: names, units, estimates and std differ in length", where=name)
    for key in ("names", "units"):
        if not all(isinstance(text, str) and len(text) <= 80 for text in lists[key]):
            raise EvaluationError(f"{where}.{key} holds what is no text", where=name)
    for key in ("estimates", "std"):
        lists[key] = [_finite(v, f"{where}.{key}", name) for v in lists[key]]
    if min(lists["std"]) < 0.0:
        raise EvaluationError(f"{where}.std is below zero", where=name)
    return lists


def _mounting(block: object, name: str) -> dict[str, Any]:
    if not isinstance(block, Mapping):
        raise EvaluationError("mounting is no object", where=name, got=_short(block))
    if not block or block.get("status", "measured") != "measured":
        return {}
    out: dict[str, Any] = {"status": "measured", **_columns(block, "mounting", name)}
    relative = block.get("camera_from_lidar")
    if isinstance(relative, Mapping):
        out["camera_from_lidar"] = _columns(relative, "mounting.camera_from_lidar", name)
    return out
