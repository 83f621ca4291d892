"""Clocks in the joint adjustment: recovered where two speeds tell them from lever arms, named where nothing does."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluator.body_rates import body_rates
from evaluator.c9_3_calibration import evaluate_calibration, residual_table, target_errors
from evaluator.frames import body_pose
from evaluator.model import EvaluationError
from evaluator.mounting.adjustment import on_true_time, solve_mountings
from evaluator.mounting.helping_strip import (
    candidate_strips,
    flown_strips,
    helping_strips,
    predicted_covariance,
    weak_parameters,
    with_strip,
)
from evaluator.mounting.mounting_model import PARAMETER_NAMES, System
from evaluator.mounting.single_sensor import solve_camera, solve_lidar

FLIGHTS = runpy.run_path(str(Path(__file__).with_name("flights.py")))
flight, TRUE, FRAME = FLIGHTS["flight"], FLIGHTS["TRUE"], FLIGHTS["FRAME"]
CLOCKS = (5e-4, -3e-4)
PRIOR_S = 1e-3


def test_clock_columns_against_differences() -> None:
    """Rationale: the derivative by the clock comes from the body's velocity and angular rate. Expected: central differences of
    the residual over 2 ms, in a flight without noise that sways by 0.6 degrees (2 m/s at the targets).
    Tolerance: 2 % of the greatest value of a column: the trajectory is linear between samples 20 ms apart, its rate changes by
    (2 pi / 2.6 s) 20 ms = 5 % of the sway's from one to the next, and both differences average over a part of that."""
    system = System(flight(1, clocks=CLOCKS, clock_std_s=PRIOR_S, noise=0.0))
    assert system.names == (*PARAMETER_NAMES, "camera_clock", "lidar_clock")
    x = np.concatenate([TRUE, CLOCKS, system.places.ravel()])
    design = system.linearise(x, with_covariance=False).design
    for column in (12, 13):
        d = np.zeros(x.size)
        d[column] = 1e-3
        ahead = system.linearise(x + d, with_covariance=False).residual
        behind = system.linearise(x - d, with_covariance=False).residual
        numeric = -(ahead - behind) / 2e-3
        assert np.abs(numeric - design[:, column]).max() < 0.02 * np.abs(design[:, column]).max()
        other = system.rows_vertices if column == 12 else 0
        assert not design[other : other + 3, column].any()  # a clock is one sensor's
    assert np.abs(design[: system.rows_vertices, 12]).max() > 100.0  # 3 m/s at 3000 px and 45 m: 200 px/s


def test_all_other_columns_stand_with_clocks_among_them() -> None:
    """Rationale: two parameters more move the places' columns. Expected: differences of the residual, every kind of column.
    Tolerance: as without clocks, 1e-5 of the column."""
    system = System(flight(1, clocks=CLOCKS, clock_std_s=PRIOR_S))
    x = np.concatenate([TRUE, CLOCKS, system.places.ravel()])
    design = system.linearise(x).design
    for j in (0, 4, 8, 11, 14, 14 + 3 * 7 + 2):
        d = np.zeros(x.size)
        d[j] = 1e-6
        numeric = -(system.linearise(x + d).residual - system.linearise(x - d).residual) / 2e-6
        assert np.abs(numeric - design[:, j]).max() < 1e-5 * max(1.0, np.abs(design[:, j]).max())


def test_rates_of_a_trajectory() -> None:
    """Rationale: velocity and turn from poses. Expected: along the course at the flown speed, and the turn between two poses
    4 ms apart. Tolerance: 1e-3 m/s (the Earth's curvature over a strip); 2 % of the turn."""
    problem = flight(2, noise=0.0)
    trajectory = problem.trajectories[2]
    t = np.array([trajectory.gps_time_s[200] + 0.0101])
    velocity, turn = body_rates(trajectory, t, FRAME)
    assert velocity[0] == pytest.approx([0.0, 9.0, 0.0], abs=1e-3)
    (_, a), (_, b) = (body_pose(trajectory, t + d, FRAME) for d in (-0.002, 0.002))
    w = (b[0] @ a[0].T - np.eye(3)) / 0.004
    expected = np.array([w[2, 1], w[0, 2], w[1, 0]])
    assert turn[0] == pytest.approx(expected, abs=0.02 * np.abs(expected).max())


def test_both_clocks_are_recovered_from_two_speeds() -> None:
    """Rationale: closed loop on the stated model, 20 flights at 3 and 9 m/s with clocks of 0.5 and -0.3 ms.
    Expected: |z| <= 3 for both clocks in each, their spread near 1, the mountings' as well, std below half the prior.
    Tolerance: 0.6-1.5 over 20 draws (one sigma of the spread 0.16: 0.6 is 2.5 sigma off)."""
    truth = np.concatenate([TRUE, CLOCKS])
    z = []
    for seed in range(20):
        solution = solve_mountings(flight(seed, clocks=CLOCKS, clock_std_s=PRIOR_S), snoop=False)
        std = np.sqrt(np.diag(solution.covariance))
        assert std[12:].max() < 0.5 * PRIOR_S
        assert (solution.camera_clock_s, solution.lidar_clock_s) == tuple(solution.parameters[12:])
        z.append((solution.parameters - truth) / std)
    values = np.array(z)
    assert np.abs(values[:, 12:]).max() <= 3.0
    assert np.abs(values).max() < 4.4
    for spread in (values[:, 12].std(), values[:, 13].std(), values[:, :12].std()):
        assert 0.6 < spread < 1.5


def test_a_clock_without_a_prior_is_no_parameter() -> None:
    """Rationale: a rig that states synchronisation is believed, and its flights give what they gave before. Expected: twelve
    names; the error then shows as a lever arm along the flight, 9 m/s x 0.5 ms, past what two speeds can hide in it."""
    solution = solve_mountings(flight(3), snoop=False)
    assert solution.names == PARAMETER_NAMES
    assert solution.camera_clock_s == 0.0
    assert on_true_time(flight(3), solution).marks[0].gps_time_s == flight(3).marks[0].gps_time_s
    believed = solve_mountings(flight(3, clocks=(5e-3, 0.0)), snoop=False)
    known = solve_mountings(flight(3, clocks=(5e-3, 0.0), clock_std_s=5e-3), snoop=False)
    assert believed.sigma0 > 1.1 * known.sigma0


def test_one_clock_alone() -> None:
    """Rationale: a triggered camera may be synchronised while the LiDAR is not. Expected: one name more, recovered."""
    problem = flight(4, clocks=(0.0, CLOCKS[1]), clock_std_s=PRIOR_S)
    rig = problem.rig.model_copy(update={"camera": problem.rig.camera.model_copy(update={"clock_std_s": 0.0})})
    solution = solve_mountings(replace(problem, rig=rig), snoop=False)
    assert solution.names == (*PARAMETER_NAMES, "lidar_clock")
    assert abs(solution.lidar_clock_s - CLOCKS[1]) < 3.0 * np.sqrt(solution.covariance[12, 12])


def test_at_one_speed_the_clock_is_not_determined_and_another_speed_would_help() -> None:
    """Rationale: at one speed v, however many headings, a clock c is a lever arm of -v c along the body. What sways tells a
    little; a flight that hardly sways (0.05 degrees) tells nothing. Expected: both clocks named, with the strip of another
    speed and a predicted std well below what the flight gave. A flight at 3 and 9 m/s does better than at 5 m/s, though
    without sway the lever arm's own 3 mm over 6 m/s still leave 0.6 ms."""
    problem = flight(5, speeds=(5.0, 5.0), clocks=CLOCKS, clock_std_s=PRIOR_S, sway_deg=0.05)
    solution = solve_mountings(problem)
    strips = {str(w["name"]): w for w in solution.companions["strip_that_would_help"]}
    assert {"camera_clock", "lidar_clock"} <= set(strips)
    for name in ("camera_clock", "lidar_clock"):
        found = strips[name]
        assert str(found["strip_that_would_help"]).startswith("another speed")
        assert found["partner"] == name.replace("clock", "lever_arm_x")
        assert float(found["std"]) > 0.5 * PRIOR_S
        assert float(found["std_with_it"]) < 0.75 * float(found["std"])
    both = solve_mountings(flight(5, clocks=CLOCKS, clock_std_s=PRIOR_S, sway_deg=0.05), snoop=False)
    assert both.covariance[12, 12] < 0.7 * solution.covariance[12, 12]


def test_clock_and_lever_arm_are_one_at_one_speed() -> None:
    """Rationale: the rule behind the test above, in numbers. Expected: without sway the clock's column is -v times the lever
    arm's for every observation, whatever the heading; at two speeds with two factors. Tolerance: 2 % (a body pitched by
    1.5 degrees moves along the ground, not along its own x; the residual sway is none)."""
    for speeds in ((5.0, 5.0), (3.0, 9.0)):
        system = System(flight(6, speeds=speeds, clock_std_s=PRIOR_S, sway_deg=0.0, noise=0.0))
        design = system.linearise(np.concatenate([TRUE, [0.0, 0.0], system.places.ravel()])).design
        for column, clock, stack, first, k in ((3, 12, system.camera, 0, 2), (9, 13, system.lidar, None, 3)):
            first = system.rows_vertices if first is None else first
            rows = slice(first, first + k * len(stack.time_s))
            speed = np.repeat(np.array(speeds)[stack.sortie - 1], k)
            scale = np.abs(speed * design[rows, column]).max()
            assert np.abs(design[rows, clock] + speed * design[rows, column]).max() < 0.03 * scale


def test_prediction_holds_for_a_strip_that_is_flown() -> None:
    """Rationale: what is promised must come. Expected: the predicted covariance of a flight is that of its solution (no values
    enter), and no strip more raises any standard deviation."""
    problem = flight(7, speeds=(5.0, 5.0), headings=(0.0, 90.0), clock_std_s=PRIOR_S)
    solution = solve_mountings(problem, snoop=False)
    before = predicted_covariance(problem, solution.parameters)
    assert np.sqrt(np.diag(before)) == pytest.approx(np.sqrt(np.diag(solution.covariance)), rel=1e-2)
    strips = flown_strips(problem)
    assert [round(np.degrees(s.heading_rad)) % 360 for s in strips] == [0, 90, 0, 90]
    assert [s.speed_m_s for s in strips] == pytest.approx([5.0] * 4, abs=0.15)
    assert strips[0].shots_m == pytest.approx((-3.0, 3.0), abs=0.11)
    for candidate in candidate_strips(strips):
        more = with_strip(problem, candidate, solution.body_from_camera, solution.body_from_lidar)
        assert len(more.vertices) == len(problem.vertices) + 16
        system = System(more)
        linear = system.linearise(np.concatenate([solution.parameters, system.places.ravel()]))
        new = slice(system.rows_vertices + 3 * len(problem.vertices), system.rows_places)
        assert np.abs(linear.residual[new]).max() < 1e-2  # its values belong to its place: the clock's 5 mm and no more
        after = predicted_covariance(more, solution.parameters)
        assert np.all(np.diag(after) < np.diag(before) * (1.0 + 1e-6))


def test_a_single_strip_names_pitch_and_lever_arm() -> None:
    """Rationale: one heading at one height leaves pitch and the lever arm along it tied: another height parts them.
    Expected: both named for the LiDAR with each other as partner, and the strip that helps is another height."""
    problem = flight(8, speeds=(5.0,), heights=(45.0,), headings=(0.0,))
    solution = solve_mountings(problem, snoop=False)
    weak = {w.name: w for w in helping_strips(problem, solution.parameters, solution.covariance)}
    pitch = weak["lidar_boresight_pitch"]
    assert pitch.partner == "lidar_lever_arm_x"
    assert abs(pitch.correlation) > 0.95
    assert pitch.strip.startswith("another height")
    assert pitch.strip_determines
    assert helping_strips(flight(8), *_solved(flight(8))) == []


def test_a_flight_that_only_hovered_is_told_what_to_fly() -> None:
    """Rationale: without a course there was no candidate, and pitch and lever arm x stood as not determined without a way out.
    Expected: another height, half as high again as the 45 m, determines both."""
    problem = flight(4, heights=(45.0,), speeds=(0.08,), headings=(0.0,))
    weak = {w.name: w for w in helping_strips(problem, *_solved(problem))}
    for name in ("lidar_boresight_pitch", "lidar_lever_arm_x"):
        assert weak[name].strip == "another height (66 m)"
        assert weak[name].strip_determines


def _solved(problem) -> tuple[np.ndarray, np.ndarray]:
    solution = solve_mountings(problem, snoop=False)
    return solution.parameters, solution.covariance


def test_the_rule_of_not_determined() -> None:
    """Rationale: above half the prior, or a correlation inside one sensor beyond 0.95; between sensors it does not count."""
    covariance = np.eye(4)
    covariance[0, 1] = covariance[1, 0] = 0.96
    covariance[2, 3] = covariance[3, 2] = 0.10
    names = ("camera_a", "camera_b", "camera_c", "lidar_a")
    wide = np.full(4, 10.0)
    assert set(weak_parameters(names, covariance, wide)) == {"camera_a", "camera_b"}
    across = np.eye(4)
    across[0, 3] = across[3, 0] = 0.99
    assert weak_parameters(names, across, wide) == {}
    assert set(weak_parameters(names, across, np.array([10.0, 10.0, 1.9, 10.0]))) == {"camera_c"}


def test_the_indicator_uses_the_estimated_times() -> None:
    """Rationale: a clock that is known must not count in P_m. Expected: with clocks of 5 ms (45 mm at 9 m/s, 2 px at 65 m)
    estimated, P_m is that of the same flight without; believed synchronous it is far above."""
    late = (5e-3, -5e-3)
    clean, wrong = flight(9, clock_std_s=5e-3), flight(9, clocks=late, clock_std_s=5e-3)
    solution = solve_mountings(wrong, snoop=False)
    true = solve_mountings(clean, snoop=False)

    def p_m(problem, of) -> float:
        errors = target_errors(residual_table(problem, of.body_from_camera, of.body_from_lidar))
        return float(np.mean(list(errors.values())))

    value = evaluate_calibration(wrong, solution).indicator.value
    assert value == pytest.approx(p_m(on_true_time(clean, true), true), rel=0.05)
    assert p_m(wrong, solution) > 2.0 * value


def test_each_sensor_alone_recovers_its_mounting_and_clock() -> None:
    """Rationale: LiDAR-body without any image, camera-body without any point. Expected: within 4.4 sigma of the truth, and never
    better determined than with both (the joint solution holds all of it)."""
    problem = flight(10, clocks=CLOCKS, clock_std_s=PRIOR_S)
    joint = solve_mountings(problem, snoop=False)
    std = np.sqrt(np.diag(joint.covariance))
    for solve, sensor, own in ((solve_camera, "camera", [*range(6), 12]), (solve_lidar, "lidar", [*range(6, 12), 13])):
        alone = solve(problem)
        assert alone.names == tuple(joint.names[k] for k in own)
        assert alone.sensor == sensor
        truth = np.concatenate([TRUE, CLOCKS])[own]
        spread = np.sqrt(np.diag(alone.covariance))
        assert np.abs((alone.parameters - truth) / spread).max() < 4.4
        assert np.all(spread > std[own] * 0.99)
        assert 0.8 < alone.sigma0 < 1.2


def test_a_sensor_that_saw_nothing_says_so() -> None:
    problem = flight(11)
    with pytest.raises(EvaluationError, match="no vertex in any strip: its mounting cannot be solved"):
        solve_lidar(replace(problem, vertices=()))
    with pytest.raises(EvaluationError, match="no mark in any image"):
        solve_camera(replace(problem, marks=()))
    few = tuple(m for m in problem.marks if m.target in ("F00", "F01", "F02"))
    with pytest.raises(EvaluationError, match="too few targets seen by the camera; got 3"):
        solve_camera(replace(problem, marks=few))
