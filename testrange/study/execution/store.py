"""points/ID.json: one small file for each finished point, done or failed, written complete or not at all."""

import contextlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from campaign.writing.atomic import complete_file, readable_os_errors
from evaluator.c10_1_grading import GRADE_ZH
from testrange.study.model import StudyError

try:
    import fcntl
except ImportError:  # not on every system; there two studies in one folder are the user's affair
    fcntl = None  # type: ignore[assignment]

MAX_BYTES = 1_000_000
_LOCK = ".lock"
_OURS = frozenset({_LOCK, "cache", "work", "runs", "figures", "study.toml"})  # before the first point is finished
_GRADES = (None, *GRADE_ZH)
_KEYS = {"id": str, "status": str, "values": dict, "run_time_s": float, "versions": dict}


@contextlib.contextmanager
def claimed(out: Path, shard: tuple[int, int] | None) -> Iterator[None]:
    """The folder is made, or is a study's, and nobody else is at work on the same points until the block ends.

    Raises
    ------
    StudyError
        It holds something else, or another study, or the same shard of it, is running in it.
    """
    if out.is_dir() and not (out / "points").is_dir():
        strange = sorted({p.name for p in out.iterdir()} - _OURS)
        if strange:
            raise StudyError("is not empty and no study", where=str(out), got=strange[0], remedy="choose another place")
    with readable_os_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        lock = (out / _LOCK).open("ab")
    with lock:
        if fcntl is not None:
            number, of = shard or (0, 0)  # a shard locks a byte of its own, a whole study all of them
            try:
                fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB, min(of, 1), of * (of - 1) // 2 + number)
            except (BlockingIOError, PermissionError):
                raise StudyError(
                    "another testrange is at work on it", where=str(out), remedy="wait for it, or choose another place"
                ) from None
            except OSError:  # a disk without locks
                pass
        yield


def place_of(out: Path, point_id: str) -> Path:
    return out / "points" / f"{point_id}.json"


def write_point(out: Path, outcome: Mapping[str, Any]) -> None:
    """Writes one finished point."""
    target = place_of(out, outcome["id"])
    with complete_file(target) as work:
        text = json.dumps(outcome, ensure_ascii=False, indent=1, sort_keys=True)
        work.write_text(text + "\n", encoding="utf-8")


def read_point(out: Path, point_id: str) -> dict[str, Any] | None:
    """What is known of a point; None where there is nothing, or a file that nobody wrote in one piece."""
    place = place_of(out, point_id)
    try:
        if place.stat().st_size > MAX_BYTES:
            return None
        found = json.loads(place.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(found, dict) or found.get("id") != point_id or found.get("status") not in ("done", "failed"):
        return None
    if any(not isinstance(found.get(key), kind) for key, kind in _KEYS.items()):
        return None
    if not (math.isfinite(found["run_time_s"]) and found["run_time_s"] >= 0.0):
        return None
    if not all(_sound(v) for v in found["values"].values()) or not isinstance(found.get("reason"), str | None):
        return None
    return found


def read_points(out: Path, ids: Iterable[str]) -> dict[str, dict[str, Any]]:
    """All that are known, by id."""
    found = {point_id: read_point(out, point_id) for point_id in ids}
    return {point_id: point for point_id, point in found.items() if point is not None}


def _sound(value: object) -> bool:
    """One response."""
    if not isinstance(value, dict):
        return False
    texts = all(isinstance(value.get(key), str | None) for key in ("unit", "reason"))
    return texts and value.get("grade") in _GRADES and _number(value.get("value")) and _number(value.get("std"))


def _number(value: object) -> bool:
    """A finite one, or none."""
    if isinstance(value, bool) or not isinstance(value, int | float | None):
        return False
    return value is None or abs(value) < 1e300
