"""Panels as planes in the joint adjustment: honest variances, a surveyed height counted once, blunders named."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from campaign.flight.las import Returns
from campaign.survey import SurveyedTarget
from evaluator.frames import WorldFrame, body_pose
from evaluator.georeference import TargetReturns, nominal_mountings, world_points
from evaluator.model import CampaignData, PlaneObservation
from evaluator.mounting.adjustment import solve_mountings
from evaluator.mounting.blunders import kept_problem
from evaluator.mounting.closure import closure, joint_estimator
from evaluator.mounting.diagnosis import suspects
from evaluator.mounting.helping_strip import candidate_strips, flown_strips, with_strip
from evaluator.mounting.mounting_model import Problem, System, mounting_of
from evaluator.mounting.panel_planes import contradiction, not_plane, observe_planes, plane_residuals
from evaluator.mounting.single_sensor import solve_lidar
from evaluator.observe.panels import panel_axes_world

FLIGHTS = runpy.run_path(str(Path(__file__).with_name("flights.py")))
flight, TRUE = FLIGHTS["flight"], FLIGHTS["TRUE"]
ROLL, ARM_Y, ARM_Z = 6, 10, 11
FAULT = np.array([*np.radians([0.3, -0.25, 0.4]), 0.03, -0.02, 0.02])


def linear_solution(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """(errors, covariance) of the twelve parameters by one step from the truth: the adjustment is linear over its own
    errors."""
    system = System(problem)
    linear = system.linearise(system.start(TRUE))
    rest = linear.residual.copy()
    rest[system.rows_prior :] = 0.0  # a prior drawn at the truth: its pull is not what is tested
    gain = joint_estimator(linear.design, linear.covariance)[:12]
    return gain @ rest, gain @ linear.covariance @ gain.T


def test_columns_against_differences() -> None:
    """Rationale: a plane's row is a vertex's three rows projected on the normal; heights come after the places.
    Expected: central differences of the residual, for mounting, clock and height. Tolerance: 1e-5 of the column as
    for the other observations; the clock 5 %: a plane's is all sway, whose rate changes by 5 % from one sample of the
    trajectory to the next."""
    system = System(flight(1, panels=5, clocks=(0.0, 3e-4), clock_std_s=1e-3, noise=0.0))
    x = system.start(np.concatenate([TRUE, [0.0, 3e-4]]))
    rows = slice(system.rows_planes, system.rows_places)
    design = system.linearise(x, with_covariance=False).design
    assert len(design[rows]) == 5 * 8
    for j in (*range(6, 12), x.size - 3):
        d = np.zeros(x.size)
        d[j] = 1e-5
        ahead, behind = (system.linearise(x + s * d, with_covariance=False).residual[rows] for s in (1.0, -1.0))
        numeric = -(ahead - behind) / 2e-5
        assert np.abs(numeric - design[rows, j]).max() < 1e-5 * max(1.0, np.abs(design[rows, j]).max())
    d = np.zeros(x.size)
    d[13] = 1e-3
    ahead, behind = (system.linearise(x + s * d, with_covariance=False).residual[rows] for s in (1.0, -1.0))
    assert np.abs(-(ahead - behind) / 2e-3 - design[rows, 13]).max() < 0.05 * np.abs(design[rows, 13]).max()
    assert not design[rows, :6].any() and not design[rows, 12].any()  # nothing of the camera's
    assert not design[rows, system.count : x.size - 5].any()  # nor of the marks' places


def test_a_mounting_that_is_off_moves_the_points_as_it_must() -> None:
    """Rationale: the sign of the observation, from geometry alone: a LiDAR that hangs 0.1 m lower than assumed puts
    every panel 0.1 m too high; one that rolls by r (right side down, heading any) puts panels to the right at
    distance y too high by r y. Tolerance: 2 mm: attitudes of a degree turn the vertical by 2 %."""
    problem = flight(2, panels=6, noise=0.0, sway_deg=0.0)
    system = System(problem)
    rows = slice(system.rows_planes, system.rows_places)

    def heights(change: np.ndarray) -> np.ndarray:
        """Of the georeferenced points above the surveyed panels, with a mounting that is wrong by `change`."""
        return np.asarray(system.linearise(system.start(TRUE + change), with_covariance=False).residual[rows])

    change = np.zeros(12)
    change[ARM_Z] = 0.1
    assert heights(change) == pytest.approx(-0.1, abs=2e-3)  # the assumed sensor is lower than the true one
    change = np.zeros(12)
    change[ROLL] = 1e-3
    lidar = mounting_of(nominal_mountings(problem.rig)[1], TRUE[6:])
    right = np.array([(lidar.rotation @ o.point_lidar_m)[1] for o in problem.planes])
    assert np.abs(right).max() > 8.0
    assert heights(change) == pytest.approx(-1e-3 * right, abs=3e-4)


def test_honest_variances_and_what_planes_add() -> None:
    """Rationale: closed loop on the stated model: navigation shared by vertices and planes of one strip, one surveyed
    height for a panel in all its strips. Thirty flights of 20 panels, heights surveyed to 10 mm (so that counting
    them once for each of the eight strips would show). Expected: spread of z near 1 for the LiDAR's roll and lever
    arm y and z; standard deviations below those without planes, roll and y by a tenth at least. Tolerance: 0.75-1.3
    for each over 30 draws (one sigma 0.13), mean below 0.55 (three sigma of a mean of 30); no |z| above 4.4."""
    z, shares = [], []
    for seed in range(30):
        problem = flight(700 + seed, panels=20, panel_height_std=0.01)
        error, covariance = linear_solution(problem)
        z.append(error / np.sqrt(np.diag(covariance)))
        if seed < 3:
            _, alone = linear_solution(replace(problem, planes=()))
            shares.append(np.sqrt(np.diag(covariance) / np.diag(alone)))
    values = np.array(z)
    assert np.abs(values).max() < 4.4
    for k in (ROLL, ARM_Y, ARM_Z):
        assert 0.75 < values[:, k].std() < 1.3, k
        assert abs(values[:, k].mean()) < 0.55, k
    share = np.mean(shares, axis=0)
    assert share[ROLL] < 0.95 and share[ARM_Y] < 0.9 and share[ARM_Z] < 1.0
    assert (share <= 1.0 + 1e-9).all()


def test_whole_adjustment_with_planes() -> None:
    """Rationale: iterated from the drawing, with snooping. Expected: nothing but chance rejections, z below 4.4, the
    number of planes in the companions; a coarse scanner's vertices (20 mm) leave the LiDAR's roll twice as uncertain
    as with planes."""
    problem = flight(41, panels=20, range_std=0.02)
    solution = solve_mountings(problem)
    std = np.sqrt(np.diag(solution.covariance))
    assert (np.abs(solution.parameters - TRUE) / std).max() < 4.4
    assert len(solution.rejected) <= 2
    assert solution.companions["planes"] in (158, 159, 160)
    assert solution.companions["variance_factor_planes"] == 1.0
    alone = solve_mountings(replace(problem, planes=()), snoop=False)
    assert std[ROLL] < 0.5 * np.sqrt(alone.covariance[ROLL, ROLL])
    assert "planes" not in alone.companions and "variance_factor_planes" not in alone.companions
    assert contradiction(solution) is None


def test_a_surveyed_height_counts_once() -> None:
    """Rationale: eight strips over one panel do not average its surveyed height. Expected: the height above the body
    of P panels in S strips, all else known, has the variance sigma_h^2 / P + sigma_n^2 / (P S). Tolerance: 1 %
    (cosines of two degrees; a navigation of a nanometre)."""
    problem = flight(3, panels=6, noise=0.0, sway_deg=0.0, panel_std=0.002, panel_height_std=0.004)
    still = problem.rig.navigation.model_copy(
        update={"position_std_m": (1e-9,) * 3, "attitude_std_deg": (1e-9,) * 3}, deep=True
    )
    system = System(replace(problem, rig=problem.rig.model_copy(update={"navigation": still})))
    linear = system.linearise(system.start(TRUE))
    rows = np.r_[system.rows_planes : system.rows_places, system.rows_heights : system.rows_prior]
    columns = np.r_[ARM_Z, linear.design.shape[1] - 6 : linear.design.shape[1]]
    gain = joint_estimator(linear.design[np.ix_(rows, columns)], linear.covariance[np.ix_(rows, rows)])[0]
    variance = gain @ linear.covariance[np.ix_(rows, rows)] @ gain
    assert variance == pytest.approx(0.004**2 / 6 + 0.002**2 / 48, rel=0.01)


def test_range_constants_act_on_planes_too() -> None:
    """Rationale: ranges corrected by (15) share its errors, on planes and vertices alike. Expected: an error of K2 moves a point
    on a panel by the vertical part of its ray, and two panels by the product of theirs; a vertex shares it.
    Tolerance: 1e-9 of squares of metres, beside 1e-4 of the effect."""
    problem = flight(4, panels=10, noise=0.0)
    uncertain = replace(problem, range_covariance=np.diag([0.01**2, 0.0]))
    systems = [System(p) for p in (problem, uncertain)]
    without, with_ = (s.linearise(s.start(TRUE)).covariance for s in systems)
    system = systems[0]
    rows = slice(system.rows_planes, system.rows_places)
    rays = np.array([o.point_lidar_m / np.linalg.norm(o.point_lidar_m) for o in problem.planes])
    lidar = mounting_of(nominal_mountings(problem.rig)[1], TRUE[6:])
    up = np.einsum("nij,nj->ni", system.plane.world_from_body, rays @ lidar.rotation.T)[:, 2]
    assert (up < -0.9).all()
    assert (with_ - without)[rows, rows] == pytest.approx(0.01**2 * np.outer(up, up), abs=1e-9)
    vertex = problem.vertices[5].point_lidar_m
    third = system.rows_vertices + 3 * 5 + 2
    expected = 0.01**2 * up * vertex[2] / np.linalg.norm(vertex)
    assert (with_ - without)[third, rows] == pytest.approx(expected, abs=1e-9)


def test_blunders_are_named_and_harmless() -> None:
    """Rationale: a strip's points of one panel off by 5 cm, a height mistyped by 10 cm. Expected: both named, the
    height as the survey's, which makes the panel a suspect; the solution stays within 4.4 sigma, and what was left
    out stays out of the closure."""
    problem = flight(42, panels=12)
    planes, panels = list(problem.planes), dict(problem.panels)
    wrong = next(k for k, o in enumerate(planes) if o.panel == "P03" and o.strip == 2)
    planes[wrong] = replace(planes[wrong], point_lidar_m=planes[wrong].point_lidar_m + np.array([0.0, 0.0, 0.05]))
    panels["P07"] = replace(panels["P07"], centre_world_m=panels["P07"].centre_world_m + np.array([0.0, 0.0, 0.1]))
    spoiled = replace(problem, planes=tuple(planes), panels=panels)
    solution = solve_mountings(spoiled)
    assert f"plane of P03 in strip 2 (sortie {planes[wrong].sortie})" in solution.rejected
    assert "surveyed height of P07" in solution.rejected
    assert len(solution.rejected) <= 4
    assert suspects(solution.rejected, ["P03", "P07"]) == ("P07",)
    assert (np.abs(solution.parameters - TRUE) / np.sqrt(np.diag(solution.covariance))).max() < 4.4
    kept = kept_problem(spoiled, solution)
    assert len(kept.planes) == solution.companions["planes"]
    assert kept.panels["P07"].height_std_m > 100.0
    found = closure(spoiled, solution)
    assert found.closes
    assert found.lidar.redundancy > 12 * 8


def test_heights_of_another_face_contradict_the_vertices() -> None:
    """Rationale: panels that were all surveyed at their lower face, 20 mm deep, agree with one another: no single one is a
    blunder, and the lever arm's z (8 mm by the navigation) could take it up. Their heights against the frustums' cannot:
    12 and 16 of 4 mm leave 1.5 mm. Expected: -20 mm within four of its standard deviations, that of 1.5 to 2.5 mm, and a line
    that says so; no line for the panels as they are, z of their shift below 4.4 and its spread near 1 in five flights."""
    z = []
    for seed in range(5):
        right = solve_mountings(flight(430 + seed, panels=12), snoop=False)
        shift, std = (float(str(right.companions[f"panel_heights_{of}"])) for of in ("shift_m", "shift_std_m"))
        z.append(shift / std)
        assert contradiction(right) is None
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.9  # five draws: chi-square of 0.5 to 17
    problem = flight(430, panels=12)
    low = {
        name: replace(p, centre_world_m=p.centre_world_m - np.array([0.0, 0.0, 0.02]))
        for name, p in problem.panels.items()
    }
    wrong = solve_mountings(replace(problem, panels=low))
    shift, std = (float(str(wrong.companions[f"panel_heights_{of}"])) for of in ("shift_m", "shift_std_m"))
    assert 0.0015 < std < 0.0025
    assert shift == pytest.approx(-0.02, abs=4.0 * std)
    line = contradiction(wrong)
    assert line is not None and line.startswith("their surveyed heights contradict the frustums' by -")
    assert contradiction(solve_mountings(replace(problem, planes=()), snoop=False)) is None


def test_closure_holds_planes() -> None:
    """Rationale: the LiDAR alone has its planes, the joint solution too: they are counted once. Expected: the
    triangle closes within its 95 % in at least 3 of 4 flights (fewer: 1.4 %), mean chi-square 6 within three
    sigma of a mean of 4 (5.2). The planes tighten the LiDAR's side."""
    found = []
    for seed in range(4):
        problem = flight(800 + seed, panels=12)
        found.append(closure(problem, solve_mountings(problem, snoop=False)))
    assert sum(c.closes for c in found) >= 3
    assert abs(np.mean([c.chi_square for c in found]) - 6.0) < 5.2
    alone = solve_lidar(replace(problem, planes=()), snoop=False)
    assert found[-1].lidar.covariance[ROLL - 6, ROLL - 6] < 0.9 * alone.covariance[0, 0]


def test_a_helping_strip_passes_over_panels_too() -> None:
    """Expected: one plane more for each panel, at the height that the survey gives it, so that its residual is zero."""
    problem = flight(5, panels=4, noise=0.0)
    camera, lidar = System(problem).mountings(TRUE)
    more = with_strip(problem, candidate_strips(flown_strips(problem))[1], camera, lidar)
    assert len(more.planes) == len(problem.planes) + 4
    system = System(more)
    residual = system.linearise(system.start(TRUE)).residual[system.rows_planes : system.rows_places]
    assert np.abs(residual[-4:]).max() < 1e-6


def _square(rng: np.random.Generator, n: int = 200, noise_m: float = 0.004) -> np.ndarray:
    return np.column_stack([rng.uniform(-0.5, 0.5, (n, 2)), rng.normal(0.0, noise_m, n)])


def test_what_is_no_plane() -> None:
    """Rationale: only a level plane stands for one height. Expected: 200 points of 4 mm are a plane (their ninths
    scatter by 0.85 mm); with a sag of 30 mm, with a box of 60 mm on one ninth, with 15 % of strays they are none."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        good = _square(rng)
        use, residual, tilt = plane_residuals(good)
        assert not_plane(good[use], residual[use], 1.2, 1.0 - use.mean()) is None
        assert tilt < 0.3  # 4 mm over 0.29 m rms and 200 points: 0.06 degrees
    sag = _square(rng)
    sag[:, 2] -= 0.03 * np.cos(np.pi * sag[:, 0]) * np.cos(np.pi * sag[:, 1])
    box = _square(rng)
    on = np.all((box[:, :2] > -0.2) & (box[:, :2] < 0.1), axis=1)
    box[on, 2] += 0.06
    strays = _square(rng)
    strays[:30, 2] += rng.uniform(0.1, 1.0, 30)
    for local in (sag, box, strays):
        use, residual, _ = plane_residuals(local)
        reason = not_plane(local[use], residual[use], 1.2, 1.0 - use.mean())
        assert reason is not None and reason.startswith("not plane: ")
    tilted = _square(rng)
    tilted[:, 2] += np.tan(np.radians(3.0)) * tilted[:, 0]
    assert plane_residuals(tilted)[2] == pytest.approx(3.0, abs=0.3)


def _scanned(data: CampaignData, panel: SurveyedTarget, shape: str, rng: np.random.Generator) -> TargetReturns:
    """Returns of strip 1 on one panel (and the ground about it, 0.17 m lower) by a LiDAR whose mounting is wrong by
    FAULT."""
    assert data.rig is not None
    frame, trajectory = WorldFrame(data.manifest), data.sorties[0].trajectory
    assert trajectory is not None
    nominal = nominal_mountings(data.rig)[1]
    true = mounting_of(nominal, FAULT)
    centre, axes = panel_axes_world(panel, frame)
    n = 1500
    local = np.column_stack([rng.uniform(-1.2, 1.2, (n, 2)), np.zeros(n)])
    on = (np.abs(local[:, :2]) <= 0.5 * panel.size_m).all(axis=1)
    local[~on, 2] = -0.17
    if shape == "high":
        local[on, 2] += 0.02
    elif shape == "tilted":
        local[on, 2] += np.tan(np.radians(2.0)) * local[on, 0]
    elif shape == "box":
        lid = on & np.all((local[:, :2] > 0.0) & (local[:, :2] < 0.32), axis=1)
        local[lid, 2] += 0.05
    world = centre + local @ axes
    time = float(trajectory.gps_time_s[0]) + 5.0 + world[:, 1] / 5.0
    order = np.argsort(time)
    world, time = world[order], time[order]
    position, world_from_body = body_pose(trajectory, time, frame)
    p = (np.einsum("nji,nj->ni", world_from_body, world - position) - true.lever_arm_m) @ true.rotation
    p *= (1.0 + rng.normal(0.0, 0.004, n) / np.linalg.norm(p, axis=1))[:, None]
    one, zero = np.ones(n, np.uint8), np.zeros(n, np.float32)
    returns = Returns(
        xyz_m=frame.map_from_world(world_points(p, time, trajectory, nominal, frame)),
        gps_time_s=time,
        intensity=one.astype(np.uint16),
        return_number=one,
        number_of_returns=one,
        scan_angle_deg=zero,
        encoder_angle_deg=zero,
        channel=0 * one,
        amplitude=zero + 100.0,
        pulse_width_ns=zero + 4.0,
        reflectance_db=zero,
        strip=one.astype(np.uint16),
        packet=np.full(n, -1),
        return_location_ps=zero,
        wave_direction_m_ps=np.zeros((n, 3), np.float32),
    )
    return TargetReturns(sortie=1, strip=1, target=panel.id, record=np.arange(n), returns=returns)


def test_planes_from_points(campaign_data: CampaignData) -> None:
    """Rationale: from returns to residual, through a mounting that is half a degree wrong. Expected: with the true
    mounting the observation stands 0 mm above the surveyed plane, 20 mm where the panel stands that much higher; a
    tilted panel, one with a box on it and one hit by too few beams give none, each with its reason. Points on the
    ground, 17 cm lower, do not count. Tolerance: four of the stated sigma (4 mm over some 250 points and the common
    millimetre)."""
    rng = np.random.default_rng(6)
    data = campaign_data
    assert data.rig is not None
    panels = [t for t in data.targets if t.kind == "panel"]
    shapes = ["plane", "high", "tilted", "box", "few"]
    returns = {(1, 1, t.id): _scanned(data, t, shape, rng) for t, shape in zip(panels, shapes, strict=False)}
    few = returns[1, 1, panels[4].id]
    returns[1, 1, panels[4].id] = replace(few, returns=_every(few.returns, 40))
    true = mounting_of(nominal_mountings(data.rig)[1], FAULT)
    found = observe_planes(data, returns, true)
    assert [o.panel for o in found.planes] == [panels[0].id, panels[1].id]
    frame, trajectory = WorldFrame(data.manifest), data.sorties[0].trajectory
    assert trajectory is not None
    for o, expected in zip(found.planes, (0.0, 0.02), strict=True):
        centre, axes = panel_axes_world(next(t for t in panels if t.id == o.panel), frame)
        world = world_points(o.point_lidar_m[None], np.array([o.gps_time_s]), trajectory, true, frame)[0]
        assert (world - centre) @ axes[2] == pytest.approx(expected, abs=4.0 * o.std_m)
        assert 0.001 <= o.std_m < 0.0015
        assert o.rms_m == pytest.approx(0.004, rel=0.2)
        assert 150 < o.points < 1500 * 0.25
    assert found.rejected[0].startswith(f"plane of {panels[2].id} in strip 1 (sortie 1): not level: tilted by ")
    assert found.rejected[1].startswith(f"plane of {panels[3].id} in strip 1 (sortie 1): not plane: ")
    assert found.missing == {f"{panels[4].id}, sortie 1, strip 1": "fewer than 20 returns wholly on it"}


def test_a_plane_cancels_the_mounting_it_was_found_with(campaign_data: CampaignData) -> None:
    """Rationale: points are averaged at one moment through an approximate mounting. Expected: one that is 0.02
    degrees and 1 cm wrong gives the same observation along the normal, seen through the true one. Tolerance: 0.2 mm
    (another choice of points at the border)."""
    data = campaign_data
    assert data.rig is not None
    panel = next(t for t in data.targets if t.kind == "panel")
    returns = {(1, 1, panel.id): _scanned(data, panel, "plane", np.random.default_rng(7))}
    frame, trajectory = WorldFrame(data.manifest), data.sorties[0].trajectory
    assert trajectory is not None
    nominal = nominal_mountings(data.rig)[1]
    true = mounting_of(nominal, FAULT)
    near = mounting_of(nominal, FAULT + np.array([*np.radians([0.02, -0.02, 0.02]), 0.01, 0.01, -0.01]))

    def height(o: PlaneObservation) -> float:
        world = world_points(o.point_lidar_m[None], np.array([o.gps_time_s]), trajectory, true, frame)[0]
        return float(world[2])

    a, b = (observe_planes(data, returns, m).planes[0] for m in (true, near))
    assert height(a) == pytest.approx(height(b), abs=2e-4)


def _every(returns: Returns, step: int) -> Returns:
    return Returns(**{name: getattr(returns, name)[::step] for name in Returns.__dataclass_fields__})
