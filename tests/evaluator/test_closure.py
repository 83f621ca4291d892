"""Closure of camera-body, LiDAR-body and camera-LiDAR: within its stated region for clean data, outside for a changed rig."""

import json
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluator.model import EvaluationError
from evaluator.mounting.adjustment import solve_mountings
from evaluator.mounting.blunders import kept_problem
from evaluator.mounting.closure import NAMES, alone_estimator, closure, joint_estimator
from evaluator.mounting.mounting_model import System
from evaluator.mounting.single_sensor import solve_camera

FLIGHTS = runpy.run_path(str(Path(__file__).with_name("flights.py")))
flight, TRUE = FLIGHTS["flight"], FLIGHTS["TRUE"]


def test_clean_flights_close_in_about_95_of_100() -> None:
    """Rationale: the covariance of the difference must hold navigation, survey and lens once, not twice and not never.
    Expected: chi-square with six degrees of freedom over 20 flights: 19 inside, mean 6.
    Tolerance: at least 17 inside (fewer: 0.3 % at p = 0.95), mean 6 +- 2.4 (three sigma of a mean of 20, sqrt(12/20) = 0.77;
    a covariance twice or half as large would give 3 or 12)."""
    found = []
    for seed in range(20):
        problem = flight(200 + seed)
        found.append(closure(problem, solve_mountings(problem, snoop=False)))
    assert all(c.freedom == 6 for c in found)
    assert sum(c.closes for c in found) >= 17
    assert abs(np.mean([c.chi_square for c in found]) - 6.0) < 2.4
    z = np.array([c.difference / np.sqrt(np.diag(c.covariance)) for c in found])
    assert 0.7 < z.std() < 1.3
    assert np.abs(z).max() < 4.4


@pytest.mark.parametrize("turn", [(0.05, 0.0, 0.0), (0.1, 0.1, 0.1)])
def test_a_boresight_that_changed_between_sorties_does_not_close(turn: tuple[float, float, float]) -> None:
    """Rationale: one mounting no longer holds for both sorties, and the two ways weigh the sorties differently.
    Expected: a turn of 0.05 degrees, ten times the navigation's noise, lies far outside."""
    problem = flight(5, lidar_turn_deg=turn)
    found = closure(problem, solve_mountings(problem, snoop=False))
    assert not found.closes
    assert found.chi_square > 5.0 * found.limit_95


def test_with_clocks_it_closes_too() -> None:
    """Rationale: clocks are unknowns of both ways. Expected: a well-timed model closes with 14 parameters as with 12."""
    closes = []
    for seed in range(5):
        problem = flight(300 + seed, clocks=(5e-4, -3e-4), clock_std_s=1e-3)
        closes.append(closure(problem, solve_mountings(problem, snoop=False)).closes)
    assert sum(closes) >= 4


def test_the_covariance_is_that_of_the_least_squares() -> None:
    """Rationale: an efficient estimator differs from any other made of the same data by the difference of the two
    covariances (Hausman, Econometrica 46, 1978). Expected: camera alone against the joint camera, both stated on their own, leave
    what the closure's own route (estimators times observations' covariance) gives. Tolerance: 2 % of the joint variance, for the
    linearisation at another point."""
    problem = flight(6)
    solution = solve_mountings(problem, snoop=False)
    system = System(problem)
    marks = np.array([solution.vertices_world_m[t] for t in system.targets])
    linear = system.linearise(np.concatenate([solution.parameters, marks.ravel()]))
    change = alone_estimator(system, linear.design, linear.covariance, "camera")
    change = change - joint_estimator(linear.design, linear.covariance)[:6]
    expected = solve_camera(problem, snoop=False).covariance - solution.covariance[:6, :6]
    std = np.sqrt(np.diag(solution.covariance)[:6])
    difference = (change @ linear.covariance @ change.T - expected) / np.outer(std, std)
    assert np.abs(difference).max() < 0.02


def test_without_noise_both_ways_give_the_same() -> None:
    """Expected: nothing but the priors' pull, a tenth of what noise would do."""
    quiet = flight(6, noise=0.0)
    found = closure(quiet, solve_mountings(quiet, snoop=False))
    assert np.abs(found.difference / np.sqrt(np.diag(found.covariance))).max() < 0.1
    assert np.linalg.eigvalsh(found.covariance).min() > 0.0


def test_rejected_observations_stay_out() -> None:
    """Rationale: what the joint adjustment threw out must not come back through a sensor alone. Expected: a blunder of 60 px
    named, left out of `kept_problem`, and the triangle closes."""
    problem = flight(7)
    marks = list(problem.marks)
    marks[10] = replace(marks[10], uv_px=marks[10].uv_px + np.array([60.0, -40.0]))
    surveyed = dict(problem.surveyed)
    surveyed["F05"] = replace(surveyed["F05"], mark_world_m=surveyed["F05"].mark_world_m + np.array([0.1, 0.0, 0.0]))
    wrong = replace(problem, marks=tuple(marks), surveyed=surveyed)
    solution = solve_mountings(wrong)
    kept = kept_problem(wrong, solution)
    assert len(kept.marks) == len(marks) - 1
    assert kept.surveyed["F05"].covariance_m2[0, 0] > 1e5
    assert closure(wrong, solution).closes


def test_block_is_json_in_degrees_and_metres() -> None:
    """Expected: numbers of the data class times 180/pi for angles; JSON's own types throughout."""
    problem = flight(8)
    found = closure(problem, solve_mountings(problem, snoop=False))
    block = json.loads(json.dumps(found.block()))
    assert block["names"] == list(NAMES)
    assert block["units"] == ["deg", "deg", "deg", "m", "m", "m"]
    assert block["difference"][0] == pytest.approx(np.degrees(found.difference[0]))
    assert block["difference"][4] == pytest.approx(found.difference[4])
    assert block["covariance"][0][4] == pytest.approx(np.degrees(found.covariance[0, 4]))
    assert block["z"][2] == pytest.approx(found.difference[2] / np.sqrt(found.covariance[2, 2]))
    assert block["closes"] is (found.chi_square <= 12.591587)
    side = block["lidar_alone"]
    assert side["units"] == ["deg", "deg", "deg", "m", "m", "m"]
    assert side["estimates"][1] == pytest.approx(np.degrees(found.lidar.parameters[1]))
    assert side["estimates"][4] == pytest.approx(found.lidar.parameters[4])
    # alone, with the navigation between its strips, the LiDAR has only the two heights to part these
    assert side["not_determined"] == ["lidar_boresight_pitch", "lidar_lever_arm_x"]
    assert block["camera_alone"]["names"][0] == "camera_boresight_roll"


def test_one_sensor_alone_cannot_close() -> None:
    problem = flight(9)
    solution = solve_mountings(problem, snoop=False)
    with pytest.raises(EvaluationError, match="no vertex in any strip"):
        closure(replace(problem, vertices=()), solution)
