"""What a response's name means: which number of an evaluated campaign stands in the table. Only simulated campaigns come here.

indicators.ID              one of the eight indicators: value, standard deviation, grade
score.QUANTITY.error       a quantity of score.json against truth; also .estimate, .std, .z, and score.max_abs_z
panel_points.least         LiDAR returns on a panel, all strips together; also .mean, and .per_strip: the mean of panel and strip
calibration_error_ground_m P_m of each sortie times its ground sampling distance, mean over sorties [m]
run_time_s                 of the point, on whatever ran it [s]
results.A.B.C              any number in results.json, by its path
"""

from collections.abc import Callable, Mapping
from typing import Any

from campaign.config import Config
from campaign.errors import ConfigError
from evaluator.c10_1_grading import INDICATORS
from testrange.study.execution.callables import finite
from testrange.study.model import RUN_TIME

PANEL_POINTS = ("least", "mean", "per_strip")
SCORED = ("error", "estimate", "std", "z")
GROUND = "calibration_error_ground_m"


def check_name(name: str) -> None:
    """Refuse a response that no campaign can have.

    Raises
    ------
    ConfigError
        With the forms that exist.
    """
    head, _, tail = name.partition(".")
    known = (
        (head == "indicators" and tail in INDICATORS)
        or name == "score.max_abs_z"
        or (head == "score" and tail.count(".") == 1 and tail.rpartition(".")[2] in SCORED)
        or (head == "panel_points" and tail in PANEL_POINTS)
        or name in (GROUND, RUN_TIME)
        or (head == "results" and bool(tail))
    )
    if not known:
        expected = (
            "indicators.ID, score.QUANTITY.error|estimate|std|z, score.max_abs_z, panel_points.least|mean|per_strip, "
        )
        raise ConfigError(
            "is no response",
            where=name,
            expected=f"{expected}{GROUND}, {RUN_TIME} or results.PATH; ID: {', '.join(INDICATORS)}",
        )


def column(name: str) -> str:
    """Name in the table: an indicator's id, else the response as written."""
    return name.removeprefix("indicators.")


def take(
    name: str,
    results: Mapping[str, Any],
    score: Mapping[str, Mapping[str, float | None]],
    panel_points: Mapping[str, Any],
    config: Config,
) -> dict[str, Any]:
    """value, and std, grade, unit and reason where there are any."""
    head, _, tail = name.partition(".")
    if head == "indicators":
        block = results["indicators"][tail]
        found = {"value": block["value"], "std": block["uncertainty"]["std"], "grade": block["grade"]}
        return found | {"unit": block["unit"], "reason": block["reason"]}
    if head == "score":
        quantity, _, what = tail.rpartition(".")
        item = score.get(quantity or tail)
        if item is None:
            return {"value": None, "reason": f"{quantity or tail} was not estimated, or its truth is not known"}
        std = item["std"] if what in ("error", "estimate") else None
        return {"value": item[what if quantity else "z"], "std": std, "unit": item.get("unit")}
    if head == "panel_points":
        return _panel_points(tail, panel_points)
    if name == GROUND:
        return _ground(results, config)
    return _path(tail, results)


def _panel_points(what: str, counts: Mapping[str, Any]) -> dict[str, Any]:
    """Returns of panels by panel and by (panel, strip)."""
    panels: Mapping[str, int] = counts["panels"]
    if not panels:
        return {"value": None, "reason": "no LiDAR points on panels"}
    totals: dict[str, Callable[[], float]] = {
        "least": lambda: float(min(panels.values())),
        "mean": lambda: sum(panels.values()) / len(panels),
        "per_strip": lambda: sum(panels.values()) / max(counts["observations"], 1),
    }
    return {"value": totals[what](), "unit": "points"}


def _ground(results: Mapping[str, Any], config: Config) -> dict[str, Any]:
    """P_m on the ground: pixels of each sortie times H / f. [m]"""
    block = results["indicators"]["calibration_error"]
    per_sortie = block["companions"].get("per_sortie_px") or {}
    heights = config.flight.heights_m
    found = [
        float(px) * heights[int(s) - 1] / config.camera.lens.fx_px for s, px in per_sortie.items() if px is not None
    ]
    if not found or block["value"] is None:
        return {"value": None, "unit": "m", "reason": block["reason"] or "no sortie has a figure of its own"}
    std = block["uncertainty"]["std"]
    value = sum(found) / len(found)
    return {"value": value, "unit": "m", "std": None if std is None else value * std / block["value"]}


def _path(path: str, results: Mapping[str, Any]) -> dict[str, Any]:
    place: Any = results
    for part in path.split("."):
        if isinstance(place, Mapping) and part in place:
            place = place[part]
        elif isinstance(place, list) and part.isdecimal() and int(part) < len(place):
            place = place[int(part)]
        else:
            return {"value": None, "reason": f"results.json has no {path}"}
    if isinstance(place, bool) or not isinstance(place, int | float):
        return {"value": None, "reason": f"{path} of results.json is no number"}
    return finite({"value": float(place)})
