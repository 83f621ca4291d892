"""The fault matrix: one fault at a time is injected, the campaign is simulated and evaluated, and what deviates is compared.

Parts of a campaign that a fault cannot reach have the same bytes as without it, so they are simulated once and linked.
"""

import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from campaign.config import PARTS, Config, Model, Part
from campaign.errors import ConfigError
from campaign.load import load_config, read_toml, resolve_study
from campaign.manifest import read_manifest, write_manifest
from campaign.progress import Report
from evaluator.mounting.diagnosis import family_limit

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


class FaultCase(Model):
    """One fault and where it must show."""

    name: str = Field(pattern=r"^[^\n]{1,60}$")
    set: tuple[str, ...] = Field((), description="settings below faults., as key=value")
    shows: tuple[str, ...] = Field((), description="quantities of the diagnosis that must deviate, all others must not")
    doubts: tuple[str, ...] = Field((), description="targets whose surveyed place must be doubted, no other")


class FaultStudy(Model):
    """configs/studies/*.toml of a fault matrix."""

    base: str = Field(description="a configuration, by name or path")
    set: tuple[str, ...] = Field((), description="settings common to all cases")
    fault: Annotated[tuple[FaultCase, ...], Field(min_length=1, max_length=200)]


@dataclass(frozen=True, kw_only=True)
class CaseResult:
    """One row of the matrix."""

    case: FaultCase
    rows: tuple[dict[str, Any], ...]  # of the diagnosis
    doubts: tuple[str, ...]
    pairs: tuple[tuple[str, str, float], ...]  # parameters that correlate beyond 0.95
    problems: tuple[str, ...]

    def beyond(self, limit: float) -> tuple[str, ...]:
        """Quantities that deviate."""
        return tuple(r["quantity"] for r in self.rows if abs(r["z"]) > limit)

    def verdict(self, limit: float) -> str:
        """ "as injected", or what is missed and what shows besides."""
        found, wanted = set(self.beyond(limit)), set(self.case.shows)
        missed = sorted(wanted - found) + sorted(set(self.case.doubts) - set(self.doubts))
        besides = sorted(found - wanted) + sorted(set(self.doubts) - set(self.case.doubts))
        told = [f"missed: {', '.join(missed)}"] if missed else []
        told += [f"besides: {', '.join(besides)}"] if besides else []
        return "; ".join(told) or "as injected"


@dataclass(frozen=True, kw_only=True)
class FaultMatrix:
    """All cases; the limit is for all values together."""

    results: tuple[CaseResult, ...]
    limit: float

    @property
    def right(self) -> int:
        """Cases in which exactly the injected fault shows."""
        return sum(r.verdict(self.limit) == "as injected" for r in self.results)


def load_study(path: Path | str) -> FaultStudy:
    """A study by path or by its name in configs/studies.

    Raises
    ------
    ConfigError
        No such file, not TOML, an unknown key, or a setting that is no fault.
    """
    file = resolve_study(path)
    try:
        study = FaultStudy.model_validate(read_toml(file))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = f"{file} {'.'.join(map(str, first['loc']))}"
        raise ConfigError(first["msg"], where=where, got=repr(first["input"])[:60]) from None
    for case in study.fault:
        for setting in case.set:
            if not setting.startswith("faults."):
                raise ConfigError("is no fault", where=f"{file} {case.name}", got=setting, expected="faults.…=value")
    return study


def run_matrix(study: FaultStudy, out: Path, progress: Report, settings: Sequence[str] = ()) -> FaultMatrix:
    """Simulate and evaluate every case into `out`/NN (results.json each).

    Parameters
    ----------
    settings : sequence of str
        On top of the study's own.

    Raises
    ------
    ConfigError
        A configuration of a case is wrong; nothing has been simulated then.
    """
    cases = [(case, load_config(study.base, (*study.set, *settings, *case.set))) for case in study.fault]
    results = []
    with tempfile.TemporaryDirectory(dir=out, prefix=".work") as work:
        known: dict[tuple[Part, str], Path] = {}
        for number, (case, config) in enumerate(cases):
            progress(f"{number + 1} of {len(cases)}: {case.name}", 0, 1)
            campaign = _assemble(config, Path(work), number, known)
            results.append(_evaluated(case, campaign, out / f"{number:02d}"))
            shutil.rmtree(campaign)
            progress(f"{number + 1} of {len(cases)}: {case.name}", 1, 1)
    return FaultMatrix(results=tuple(results), limit=family_limit(sum(len(r.rows) for r in results)))


def _assemble(config: Config, work: Path, number: int, known: dict[tuple[Part, str], Path]) -> Path:
    """The campaign folder of one case: its own paperwork, and each part simulated for it or linked from an earlier case."""
    from simulator.simulate import simulate_campaign

    campaign = work / f"case_{number:02d}"
    campaign.mkdir()
    simulate_campaign(config, campaign, only=frozenset())
    for part in PARTS:
        if part not in config.campaign.parts:
            continue
        key = (part, repr([getattr(config.faults, name) for name in REACHES[part]]))
        if key not in known:
            place = work / f"{part}_{number:02d}"
            place.mkdir()
            simulate_campaign(config, place, only=frozenset({part}))
            shutil.rmtree(place / "truth", ignore_errors=True)
            known[key] = place
        _link(known[key], campaign, part)
    write_manifest(campaign, read_manifest(campaign))
    return campaign


def _link(source: Path, campaign: Path, part: Part) -> None:
    """Hard links of one part's files."""
    names = {"camera": "sorties/*/images", "lidar": "sorties/*/lidar", "bench": "bench", "ranging": "ranging"}
    for folder in sorted(source.glob(names[part])):
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            target = campaign / path.relative_to(source)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.link(path, target)


def _evaluated(case: FaultCase, campaign: Path, out: Path) -> CaseResult:
    from evaluator.evaluate import evaluate_campaign
    from evaluator.results import build_results, write_json

    results = build_results(evaluate_campaign(campaign))
    out.mkdir(parents=True)
    write_json(out / "results.json", results)
    block = results["diagnosis"]
    return CaseResult(
        case=case,
        rows=tuple(block["rows"]),
        doubts=tuple(block["surveyed_places_in_doubt"]),
        pairs=_pairs(results["mounting"]),
        problems=tuple(results["problems"]),
    )


def _pairs(mounting: dict[str, Any]) -> tuple[tuple[str, str, float], ...]:
    names, matrix = mounting.get("names", []), mounting.get("correlation", [])
    return tuple(
        (names[i], names[j], matrix[i][j]) for i in range(len(names)) for j in range(i) if abs(matrix[i][j]) > 0.95
    )


def matrix_block(matrix: FaultMatrix) -> dict[str, Any]:
    """For matrix.json."""
    return {
        "limit": matrix.limit,
        "cases": [
            {
                "fault": r.case.name,
                "set": r.case.set,
                "shows": r.case.shows,
                "doubts": r.case.doubts,
                "z": {row["quantity"]: row["z"] for row in r.rows},
                "deviating": r.beyond(matrix.limit),
                "surveyed_places_in_doubt": r.doubts,
                "verdict": r.verdict(matrix.limit),
                "problems": r.problems,
            }
            for r in matrix.results
        ],
        "inseparable": [list(p) for p in matrix.results[0].pairs],
    }
