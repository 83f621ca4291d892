"""results.json: schema 1, stable bytes, no path, finite numbers, unrounded grades."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from campaign.errors import TestrangeError
from evaluator.model import MountingSolution
from evaluator.results import (
    Evaluation,
    build_results,
    correlation_matrix,
    not_determined,
    plain,
    read_results,
    write_results,
)
from evaluator.results_model import IndicatorValue

OUTDOOR = {"lidar_reflectance_rmse", "reflectance_correlation", "reflectance_rmse_relative", "calibration_error"}


def test_round_trip(evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: scripts read this file. Expected: what was written is read again, eight indicators, four of
    them not measured with a reason, the value as graded (not rounded), the group marked * at its lower grade."""
    path = tmp_path / "results.json"
    write_results(path, evaluation)
    found = read_results(path)
    assert found == build_results(evaluation)
    assert found["schema"] == 1
    assert len(found["indicators"]) == 8
    measured = {i for i, block in found["indicators"].items() if block["value"] is not None}
    assert measured == OUTDOOR
    for i, block in found["indicators"].items():
        if i not in OUTDOOR:
            assert (block["grade"], block["grade_zh"]) == ("not_measured", "未测")
            assert re.fullmatch(r"no (bench/\w+|ranging/) in this campaign", block["reason"])
    first = found["indicators"]["lidar_reflectance_rmse"]
    assert first["value"] == 1.234567890123
    assert first["uncertainty"] == {"std": 0.2, "low_95": 0.9, "high_95": 1.7, "method": "chi-square of 20 panels"}
    assert first["companions"]["with_incidence"]["r_f"] == 99.1
    assert found["indicators"]["calibration_error"]["grade"] == "excellent"  # 0.5 is the bound itself
    assert found["groups"]["multisensor_radiometry"]["grade"] == "good"
    assert found["groups"]["camera_radiometry"]["grade"] == "not_measured"
    assert len(found["conformity"]) == len(evaluation.conformity)


def test_same_bytes_and_no_path(evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: the evaluator is blind to where a campaign lies and when it runs. Expected: the same bytes twice, the campaign's
    path nowhere, no NaN, no time of day but the campaign's own start."""
    a, b = tmp_path / "a.json", tmp_path / "b.json"
    write_results(a, evaluation)
    write_results(b, evaluation)
    assert a.read_bytes() == b.read_bytes()
    text = a.read_text()
    assert str(evaluation.root) not in text
    assert str(tmp_path) not in text
    assert "bench: not there" in text
    assert not re.search(r"\b(NaN|Infinity)\b", text)
    assert json.loads(text)["indicators"]["reflectance_rmse_relative"]["companions"]["nan"] is None
    assert set(re.findall(r"\d\d:\d\d:\d\d", text)) == {"10:30:00"}


def test_grade_of_the_unrounded_value(evaluation: Evaluation) -> None:
    """Rationale: 3 + 1e-13 is past 3. Expected: good, and the value in the file grades the same when somebody checks it."""
    value = IndicatorValue(value=3.0 + 1e-13, unit="% reflectance", formula="(2)", clause="8.1")
    block = build_results(replace(evaluation, indicators={"lidar_reflectance_rmse": value}))["indicators"]
    assert block["lidar_reflectance_rmse"]["grade"] == "good"
    assert block["lidar_reflectance_rmse"]["value"] > 3.0


def test_value_that_is_not_finite(evaluation: Evaluation) -> None:
    """Rationale: NaN is no measurement. Expected: not measured, with the reason."""
    value = IndicatorValue(value=float("nan"), unit="pixel", formula="(20)-(24)", clause="9.3")
    block = build_results(replace(evaluation, indicators={"calibration_error": value}))["indicators"][
        "calibration_error"
    ]
    assert (block["value"], block["grade"]) == (None, "not_measured")
    assert "not finite" in block["reason"]


def test_mounting_in_degrees_and_metres(evaluation: Evaluation, mounting_solution: MountingSolution) -> None:
    """Rationale: estimates are kept in radians inside and given in degrees. Expected: the injected 0.25 degrees, its standard
    deviation of 0.003 degrees, covariance to match, correlations as built. Tolerance: 1e-9, twelve digits in the file."""
    block = build_results(evaluation)["mounting"]
    k = block["names"].index("camera_boresight_roll")
    assert block["units"][k] == "deg"
    assert block["estimates"][k] == pytest.approx(0.25, abs=1e-9)
    assert block["std"][k] == pytest.approx(0.003, abs=1e-9)
    assert block["covariance"][k][k] == pytest.approx(9e-6, rel=1e-9)
    j = block["names"].index("camera_lever_arm_y")
    assert block["covariance"][k][j] == pytest.approx(0.5 * 0.003 * 0.006, rel=1e-9)
    assert block["correlation"][5][11] == pytest.approx(0.97)
    assert block["camera_from_lidar"]["names"][3] == "camera_from_lidar_x"
    assert block["camera_from_lidar"]["std"] == pytest.approx([0.004, 0.004, 0.005, 0.008, 0.008, 0.012])
    rotation = np.array(block["camera_from_lidar"]["rotation"])
    assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-9


def test_not_determined(mounting_solution: MountingSolution) -> None:
    """Rationale: "not determined" is a standard deviation above half its prior, or a correlation beyond 0.95 with another
    parameter of the same sensor. Expected: the two heights, whose 0.97 is between the sensors, are determined; the same 0.97
    between the camera's x and pitch is not; with a prior of 5 mm on x neither is x by its 6 mm."""
    wide = np.tile(np.r_[np.radians([1.0, 1.0, 1.0]), 0.1, 0.1, 0.1], 2)
    assert not_determined(mounting_solution, wide) == []
    inside = mounting_solution.covariance.copy()
    inside[1, 3] = inside[3, 1] = 0.97 * np.sqrt(inside[1, 1] * inside[3, 3])
    tied = replace(mounting_solution, covariance=inside)
    assert [w["name"] for w in not_determined(tied, wide)] == ["camera_boresight_pitch", "camera_lever_arm_x"]
    narrow = wide.copy()
    narrow[3] = 0.005
    assert [w["name"] for w in not_determined(mounting_solution, narrow)] == ["camera_lever_arm_x"]


def test_no_mounting(evaluation: Evaluation) -> None:
    """Rationale: a campaign without targets has no adjustment. Expected: the reason stands in the block."""
    block = build_results(replace(evaluation, mounting=None, mounting_reason="3 targets seen"))["mounting"]
    assert block == {"status": "not_measured", "reason": "3 targets seen"}


def test_correlation_without_variance() -> None:
    """Rationale: a fixed parameter has no correlation; 0/0 must not become NaN. Expected: zeros and a diagonal of ones."""
    found = correlation_matrix(np.array([[4.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 1.0]]))
    np.testing.assert_allclose(found, [[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.5, 0.0, 1.0]], atol=1e-15)


def test_plain_values() -> None:
    """Rationale: companions hold what numpy makes. Expected: JSON's own types; a type that JSON lacks is refused."""
    found = plain({"a": np.float64(0.1 + 0.2), "b": np.arange(3), "c": (True, None), "d": -0.0, "e": float("inf")})
    assert json.dumps(found) == '{"a": 0.3, "b": [0, 1, 2], "c": [true, null], "d": 0.0, "e": null}'
    assert plain("/data/x/lidar/a.las: bad", Path("/data/x")) == "lidar/a.las: bad"
    assert plain("1.5 in . at ./a", Path(".")) == "1.5 in . at ./a"
    with pytest.raises(TestrangeError, match="cannot be written"):
        plain({"a": object()})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file"),
        ("{", "cannot be read as JSON"),
        ("[" * 200_000 + "]" * 200_000, "nested too deep"),
        ("[]", "expected schema 1"),
        ('{"schema": 2}', "got 2; expected schema 1"),
        ('{"schema": 1, "campaign": 7}', "'campaign' is missing"),
        ('{"schema": 1, "campaign": "a", "indicators": {}, "conformity": []}', "'mounting' is missing"),
    ],
)
def test_bad_results_file(tmp_path: Path, content: str | None, message: str) -> None:
    """Rationale: a wrong file is the user's everyday mistake. Expected: one line that names the file and what is wrong."""
    path = tmp_path / "results.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(TestrangeError, match=re.escape(message)) as caught:
        read_results(path)
    assert "results.json" in str(caught.value)
    assert "\n" not in str(caught.value)
