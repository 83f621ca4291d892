"""One case of the fault matrix, from configuration to results.json. Runs in a worker process.

Parts of a campaign that a fault cannot reach have the same bytes as without it, so they are simulated once, for the base, and
linked. A case's own campaign goes when it has been evaluated.
"""

import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from campaign.config import PARTS, Config, Part
from campaign.errors import TestrangeError
from campaign.manifest import read_manifest, write_manifest
from campaign.writing.atomic import complete_file

# Which faults reach which part. What is not named here (survey, trajectory, sheets) is written anew for every case.
_LENS = (
    "principal_distance_px",
    "principal_point_px",
    "k1",
    "camera_gain",
    "image_ripple_px",
    "image_ripple_period_px",
)
REACHES: dict[Part, tuple[str, ...]] = {
    "camera": ("camera_boresight_deg", "camera_lever_arm_m", "camera_clock_s", *_LENS),
    "lidar": (
        "lidar_boresight_deg",
        "lidar_lever_arm_m",
        "lidar_clock_s",
        "range_offset_m",
        "range_scale",
        "range_table",
        "panel_laser_gain",
        "lidar_gain",
    ),
    "bench": (*_LENS, "stability_gains", "repeatability_gains"),
    "ranging": ("range_offset_m", "range_scale", "range_table", "lidar_gain"),
}
_FOLDERS: dict[Part, str] = {
    "camera": "sorties/*/images",
    "lidar": "sorties/*/lidar",
    "bench": "bench",
    "ranging": "ranging",
}


def reached(part: Part, config: Config, base: Config) -> bool:
    """Whether this configuration's faults make other files of `part` than the base's."""
    return any(getattr(config.faults, name) != getattr(base.faults, name) for name in REACHES[part])


def run_task(task: Mapping[str, Any]) -> dict[str, Any]:
    """What a worker does: one part of the base, or one case. Never raises.

    Parameters
    ----------
    task : mapping
        `id`; `config`; `base` (configuration without the fault); `parts` (folder with one of the base's parts each); `work`
        (folder for what goes again); `part` of the base, or `out`, the folder of a case.

    Returns
    -------
    dict
        `id`, `status` ("done" or "failed"), `reason`.
    """
    reason = None
    try:
        config, base = (Config.model_validate(task[name]) for name in ("config", "base"))
        if task.get("part"):
            make_part(base, task["part"], Path(task["parts"]), Path(task["work"]) / task["id"])
        else:
            run_case(config, base, Path(task["parts"]), Path(task["work"]) / task["id"], Path(task["out"]))
    except TestrangeError as error:
        reason = str(error)
    except MemoryError:
        reason = "not enough memory"
    except Exception as error:  # a worker tells, the command goes on with the others
        reason = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
    return {"id": task["id"], "status": "failed" if reason else "done", "reason": reason}


def make_part(config: Config, part: Part, parts: Path, work: Path) -> None:
    """One part of the campaign as `parts`/PART, complete or not at all; one that is there already stays."""
    from simulator.simulate import simulate_campaign

    if (parts / part).is_dir():
        return
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    simulate_campaign(config, work, only=frozenset({part}))
    shutil.rmtree(work / "truth", ignore_errors=True)
    work.rename(parts / part)


def run_case(config: Config, base: Config, parts: Path, work: Path, out: Path) -> None:
    """Assemble the campaign of one case in `work`, evaluate it to `out`/results.json, remove it."""
    from evaluator.evaluate import evaluate_campaign
    from evaluator.results import build_results, write_json

    shutil.rmtree(work, ignore_errors=True)
    try:
        results = build_results(evaluate_campaign(assemble(config, base, parts, work)))
    finally:
        shutil.rmtree(work, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    with complete_file(out / "results.json") as file:
        write_json(file, results)


def assemble(config: Config, base: Config, parts: Path, work: Path) -> Path:
    """The campaign folder of one case below `work`: paperwork, parts that the fault reaches made anew, the base's others linked."""
    from simulator.simulate import simulate_campaign

    campaign, own = work / "campaign", work / "own"
    campaign.mkdir(parents=True)
    own.mkdir()
    simulate_campaign(config, campaign, only=frozenset())
    for part in PARTS:
        if part not in config.campaign.parts:
            continue
        if reached(part, config, base):
            make_part(config, part, own, work / "part")
            _link(own / part, campaign, part)
        else:
            _link(parts / part, campaign, part)
    shutil.rmtree(campaign / "truth", ignore_errors=True)
    write_manifest(campaign, read_manifest(campaign))
    return campaign


def _link(source: Path, campaign: Path, part: Part) -> None:
    """Hard links of one part's files."""
    for folder in sorted(source.glob(_FOLDERS[part])):
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            target = campaign / path.relative_to(source)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.link(path, target)
