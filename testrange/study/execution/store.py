"""points/ID.json: one small file for each finished point, done or failed, written complete or not at all."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from campaign.atomic import complete_file

MAX_BYTES = 1_000_000
_KEYS = {"id": str, "status": str, "values": dict, "run_time_s": float, "versions": dict}


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
    texts = all(isinstance(value.get(key), str | None) for key in ("grade", "unit", "reason"))
    return texts and _number(value.get("value")) and _number(value.get("std"))


def _number(value: object) -> bool:
    """A finite one, or none."""
    if isinstance(value, bool) or not isinstance(value, int | float | None):
        return False
    return value is None or abs(value) < 1e300
