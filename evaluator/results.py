"""What an evaluation is, and results.json: built, written, read. No formula and no truth in here.

results.json holds no path and no time of day, and the same evaluation gives the same bytes.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from evaluator.benches.bench_model import ChessboardResult, RangingResult, SphereResult
from evaluator.c10_1_grading import GRADE_ZH, GROUPS, INDICATORS, Grade, grade, group_grades
from evaluator.conformity.model import Row
from evaluator.model import (
    CampaignData,
    EvaluationError,
    MarkObservation,
    Mounting,
    MountingSolution,
    VertexObservation,
)
from evaluator.mounting.diagnosis import Deviation, diagnosis_block
from evaluator.results_model import IndicatorValue, not_measured

SCHEMA = 1
_DIGITS = 12  # significant, of every number but an indicator's value, which is written as it was graded
_CORRELATED = 0.95
CAMERA_FROM_LIDAR = tuple(f"camera_from_lidar_{n}" for n in ("roll", "pitch", "yaw", "x", "y", "z"))
_BENCH = {
    "camera_stability": "no bench/sphere_stability in this campaign",
    "camera_repeatability": "no bench/sphere_repeatability in this campaign",
    "lidar_ranging_rmse_relative": "no ranging/ in this campaign",
    "camera_reprojection_error": "no bench/chessboard in this campaign",
}


@dataclass(frozen=True, kw_only=True)
class Residual:
    """Formula (24) for one target in one image: the mark as observed, the vertex as projected; both distorted pixels."""

    target: str
    sortie: int
    image: str
    observed_px: np.ndarray  # (2,)
    projected_px: np.ndarray  # (2,)
    error_px: float  # norm that enters P_i, after distortion is removed


@dataclass(frozen=True, kw_only=True)
class PanelValue:
    """One reference panel: reflectance by LiDAR R1 and by camera R2, beside what the spectrometer says. [%]"""

    id: str
    nominal_percent: float
    lidar_percent: float | None
    camera_percent: float | None
    laser_reference_percent: float | None = None
    band_reference_percent: float | None = None


@dataclass(frozen=True, kw_only=True)
class Region:
    """The part of one image that was read for one target: corners of a polygon, distorted pixels."""

    target: str
    sortie: int
    image: str
    corners_px: np.ndarray  # (k, 2)


@dataclass(frozen=True, kw_only=True)
class WaveformExample:
    """One received waveform with its decomposition, baseline included. [DN]"""

    label: str  # "P07, 40 %"
    nominal_percent: float | None
    time_ns: np.ndarray  # (n,) of the samples
    samples_dn: np.ndarray  # (n,)
    fit_time_ns: np.ndarray  # (m,)
    fit_dn: np.ndarray  # (m,)


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Everything that the report and results.json are made of."""

    campaign: str
    synthetic: bool
    indicators: Mapping[str, IndicatorValue]
    conformity: tuple[Row, ...] = ()
    mounting: MountingSolution | None = None
    mounting_reason: str | None = None  # why there is none
    mounting_prior_std: np.ndarray | None = None  # rad, m and s, in the solution's order
    problems: tuple[str, ...] = ()  # parts of the folder that could not be read
    data: CampaignData | None = None  # the campaign as read: for the report, and to take its path out of every text
    # for figures
    marks: tuple[MarkObservation, ...] = ()
    vertices: tuple[VertexObservation, ...] = ()
    residuals: tuple[Residual, ...] = ()
    panels: tuple[PanelValue, ...] = ()
    regions: tuple[Region, ...] = ()
    waveforms: tuple[WaveformExample, ...] = ()
    strip_window_s: Mapping[tuple[int, int], tuple[float, float]] = field(
        default_factory=dict
    )  # as in ConformityInputs
    companions: Mapping[str, object] = field(default_factory=dict)
    sphere: SphereResult | None = None
    chessboard: ChessboardResult | None = None
    ranging: RangingResult | None = None
    boards: Mapping[str, object] = field(
        default_factory=dict
    )  # the camera's mounting by 2x2 boards, or why there is none
    closure: Mapping[str, object] = field(default_factory=dict)  # camera-body and LiDAR-body against camera-LiDAR
    deviations: tuple[Deviation, ...] = ()  # what was stated against what was found
    survey_doubts: tuple[str, ...] = ()  # targets whose surveyed place the observations contradict
    algorithms: Mapping[str, str] = field(default_factory=dict)  # slot -> name of what is not the evaluator's own

    @property
    def root(self) -> Path | None:
        """The campaign's folder, where known."""
        return None if self.data is None else self.data.folder.root

    @property
    def stated_doubts(self) -> tuple[str, ...]:
        """What the mountings' adjustment took as stated although its observations contradict it, one line each."""
        found = self.mounting.companions.get("stated_in_doubt") if self.mounting is not None else None
        return tuple(str(line) for line in found) if isinstance(found, list | tuple) else ()

    def indicator(self, indicator_id: str) -> IndicatorValue:
        """The indicator, or "not measured" with the reason where nobody computed it."""
        found = self.indicators.get(indicator_id)
        row = INDICATORS[indicator_id]
        if found is None:
            reason = _BENCH.get(indicator_id, "the evaluation stopped before it")
            return not_measured(row.unit, row.formula, row.clause, reason)
        if found.value is not None and not math.isfinite(found.value):
            return not_measured(row.unit, row.formula, row.clause, f"the value is not finite: {found.value}")
        return found

    def grade(self, indicator_id: str) -> Grade:
        """Grade of the unrounded value; `not_measured` without one."""
        value = self.indicator(indicator_id).value
        return "not_measured" if value is None else grade(indicator_id, value)

    def grades(self) -> dict[str, Grade]:
        """Of all eight indicators, in the order of table 3."""
        return {i: self.grade(i) for i in INDICATORS}


def _without_path(text: str, root: Path) -> str:
    """Text whose paths are relative to the campaign folder."""
    for folder in (root.resolve(), root):
        if folder != Path():
            text = text.replace(f"{folder}/", "")
        if folder.is_absolute():
            text = text.replace(str(folder), ".")
    return text


def plain(value: object, root: Path | None = None) -> Any:
    """JSON's own types: arrays become lists, a number that is not finite null, -0.0 zero, the campaign's path disappears."""
    if isinstance(value, str):
        return value if root is None else _without_path(value, root)
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, np.generic | np.ndarray):
        return plain(value.tolist(), root)
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}") + 0.0 if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): plain(v, root) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v, root) for v in value]
    if isinstance(value, set | frozenset):
        return [plain(v, root) for v in sorted(value)]
    raise EvaluationError(f"{type(value).__name__} cannot be written to results.json", got=value)


def shown_decimals(value: float | None, unit: str) -> int:
    """Decimals with which an indicator is shown to people: 3 for pixels, 2 for the others, more where that left one digit."""
    usual = 3 if unit == "pixel" else 2
    if value is None or not math.isfinite(value) or value == 0.0:
        return usual
    return min(max(usual, 1 - math.floor(math.log10(abs(value)))), 6)


def correlation_matrix(covariance: np.ndarray) -> np.ndarray:
    """Correlations of a covariance matrix (n, n); a parameter without variance has correlation 0 with all others."""
    std = np.sqrt(np.diag(covariance))
    scale = np.where(std > 0.0, std, np.inf)
    out = covariance / np.outer(scale, scale)
    np.fill_diagonal(out, 1.0)
    return np.asarray(out)


def _units(names: Sequence[str]) -> list[str]:
    """deg, m or s of each mounting parameter."""
    return ["s" if "clock" in n else "m" if "lever_arm" in n else "deg" for n in names]


def _scale(names: Sequence[str]) -> np.ndarray:
    """Radians to degrees; metres and seconds stay."""
    return np.array([np.degrees(1.0) if unit == "deg" else 1.0 for unit in _units(names)])


def not_determined(solution: MountingSolution, prior_std: np.ndarray | None) -> list[dict[str, object]]:
    """Parameters whose standard deviation is above half its prior, or that correlate with another of the same sensor's
    beyond 0.95. (The two sensors' own angles correlate through the navigation they share, and are determined all the same.)

    Returns
    -------
    list of dict
        name, std and prior_std (deg, m or s), partner and correlation: the figures behind the judgement.
    """
    scale = _scale(solution.names)
    std = np.sqrt(np.diag(solution.covariance))
    sensor = np.array([name.split("_")[0] for name in solution.names])
    others = np.where(sensor[:, None] == sensor, np.abs(correlation_matrix(solution.covariance)), 0.0)
    others -= 2.0 * np.eye(len(std))
    out: list[dict[str, object]] = []
    for k, name in enumerate(solution.names):
        partner = int(others[k].argmax())
        weak = prior_std is not None and std[k] > 0.5 * prior_std[k]
        if weak or others[k, partner] > _CORRELATED:
            out.append(
                {
                    "name": name,
                    "std": std[k] * scale[k],
                    "prior_std": None if prior_std is None else prior_std[k] * scale[k],
                    "partner": solution.names[partner],
                    "correlation": correlation_matrix(solution.covariance)[k, partner],
                }
            )
    return out


def _mounting_pose(mounting: Mounting) -> dict[str, object]:
    return {"rotation": mounting.rotation, "lever_arm_m": mounting.lever_arm_m}


def mounting_block(evaluation: Evaluation) -> dict[str, object]:
    """The joint adjustment in degrees and metres: estimates against nominal, covariance, correlation, camera_from_lidar."""
    solution = evaluation.mounting
    boards = {"boards": evaluation.boards} if evaluation.boards else {}
    if solution is None:
        reason = evaluation.mounting_reason or "no adjustment was made"
        return {"status": "not_measured", "reason": reason, **boards}
    scale, six = _scale(solution.names), np.repeat([np.degrees(1.0), 1.0], 3)
    covariance = solution.covariance * np.outer(scale, scale)
    relative = solution.camera_from_lidar_covariance * np.outer(six, six)
    prior = evaluation.mounting_prior_std
    return {
        "status": "measured",
        "names": solution.names,
        "units": _units(solution.names),
        "estimates": solution.parameters * scale,
        "std": np.sqrt(np.diag(covariance)),
        "prior_std": None if prior is None else prior * scale,
        "not_determined": not_determined(solution, prior),
        "covariance": covariance,
        "correlation": correlation_matrix(covariance),
        "body_from_camera": _mounting_pose(solution.body_from_camera),
        "body_from_lidar": _mounting_pose(solution.body_from_lidar),
        "camera_from_lidar": {
            "names": CAMERA_FROM_LIDAR,
            "units": ["deg"] * 3 + ["m"] * 3,
            "estimates": solution.camera_from_lidar * six,
            "std": np.sqrt(np.diag(relative)),
            "covariance": relative,
            "correlation": correlation_matrix(relative),
            "rotation": solution.camera_from_lidar_rotation,
            "translation_m": solution.camera_from_lidar_translation_m,
        },
        "sigma0": solution.sigma0,
        "redundancy": solution.redundancy,
        "iterations": solution.iterations,
        "rejected": solution.rejected,
        "companions": solution.companions,
        **({"closure": evaluation.closure} if evaluation.closure else {}),
        **boards,
    }


def _indicator_block(evaluation: Evaluation, indicator_id: str) -> dict[str, object]:
    row, found, mark = INDICATORS[indicator_id], evaluation.indicator(indicator_id), evaluation.grade(indicator_id)
    return {
        "name": row.name_en,
        "name_zh": row.name_zh,
        "symbol": row.symbol,
        "value": found.value,
        "unit": found.unit,
        "grade": mark,
        "grade_zh": GRADE_ZH[mark],
        "clause": found.clause,
        "formula": found.formula,
        "sample_size": found.sample_size,
        "uncertainty": {
            "std": found.std,
            "low_95": found.low_95,
            "high_95": found.high_95,
            "method": found.method,
        },
        "companions": found.companions,
        "reason": found.reason,
    }


def build_results(evaluation: Evaluation) -> dict[str, Any]:
    """The contents of results.json, schema 1, in JSON's own types."""
    grades = evaluation.grades()
    groups = group_grades(grades)
    out: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "standard": "GB/T 41450-2022",
            "campaign": evaluation.campaign,
            "synthetic": evaluation.synthetic,
            "indicators": {i: _indicator_block(evaluation, i) for i in INDICATORS},
            "groups": {
                g.id: {
                    "name": g.name_en,
                    "name_zh": g.name_zh,
                    "grade": groups[g.id],
                    "grade_zh": GRADE_ZH[groups[g.id]],
                    "indicators": g.indicators,
                    "lower_of_its_indicators": g.starred,
                }
                for g in GROUPS
            },
            "conformity": [
                {
                    "clause": r.clause,
                    "requirement": r.requirement,
                    "measured": r.measured,
                    "limit": r.limit,
                    "status": r.status,
                }
                for r in evaluation.conformity
            ],
            "mounting": mounting_block(evaluation),
            "diagnosis": diagnosis_block(evaluation.deviations, evaluation.survey_doubts, evaluation.stated_doubts),
            "problems": evaluation.problems,
            **({"algorithms": evaluation.algorithms} if evaluation.algorithms else {}),
        },
        evaluation.root,
    )
    for i in INDICATORS:  # as graded, not rounded
        value = evaluation.indicator(i).value
        out["indicators"][i]["value"] = None if value is None else float(value)
    return out


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """UTF-8, one space of indent, a line's end at the end; refuses what is not finite."""
    text = json.dumps(content, ensure_ascii=False, indent=1, allow_nan=False)
    path.write_bytes(text.encode() + b"\n")


def write_results(path: Path, evaluation: Evaluation) -> None:
    """Writes results.json."""
    write_json(path, build_results(evaluation))


def read_results(path: Path) -> dict[str, Any]:
    """results.json as a dict.

    Raises
    ------
    EvaluationError
        No such file, not JSON, another schema, or blocks that are not there.
    """
    if path.exists() and not path.is_file():  # a pipe would be waited for
        raise EvaluationError("is no plain file", where=str(path), expected="results.json of testrange evaluate")
    try:
        content = json.loads(path.read_bytes())
    except RecursionError:
        raise EvaluationError("cannot be read as JSON: nested too deep", where=str(path)) from None
    except FileNotFoundError:
        raise EvaluationError("no such file", where=str(path), remedy="run testrange evaluate first") from None
    except (OSError, ValueError) as error:
        raise EvaluationError(f"cannot be read as JSON: {error}", where=str(path)) from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        got = content.get("schema") if isinstance(content, dict) else type(content).__name__
        raise EvaluationError(
            "not a results.json that this version reads", where=str(path), got=got, expected=f"schema {SCHEMA}"
        )
    for key, kind in (("campaign", str), ("indicators", dict), ("conformity", list), ("mounting", dict)):
        if not isinstance(content.get(key), kind):
            raise EvaluationError(f"{key!r} is missing or of another type", where=str(path), expected=kind.__name__)
    return content
