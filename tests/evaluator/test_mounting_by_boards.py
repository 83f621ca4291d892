"""The patent's method on flights of plain numbers: no rendering; errors drawn from the stated model by a projection of its own."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from campaign.config import Lens
from campaign.sensors import MountingSheet, NavigationSheet, Rig
from evaluator.boards.board_blunders import gauss_newton
from evaluator.boards.board_model import BoardProblem, Views, observation_covariance, remap
from evaluator.boards.board_observations import MOST_OBSERVATIONS, BoardObservation, thinned
from evaluator.boards.board_strips import predicted_std, rank_and_condition
from evaluator.boards.mounting_by_boards import NAMES, BoardMounting, solve_board_problem
from evaluator.model import EvaluationError

TRUE = np.concatenate([np.radians([0.8, -0.5, 1.2]), [0.03, -0.02, 0.05]])
ARM = np.array([0.10, 0.03, 0.08])
BODY_FROM_NADIR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
LENS = np.array([3000.0, 3000.0, 1536.0, 1024.0, -0.05, 0.02, 0.0, 1e-4, -5e-5])
LENS_STD = np.array([0.15, 0.15, 0.15, 0.15, 4e-5, 1.5e-4, 2e-4, 6e-6, 6e-6])
SURVEY_STD = np.array([0.003, 0.003, 0.004])
PIXEL_STD, CLOCK_STD = 0.02, 0.001
NAVIGATION = {
    "apogee": ((0.01, 0.01, 0.015), (0.005, 0.005, 0.01)),
    "apx15": ((0.02, 0.02, 0.03), (0.025, 0.025, 0.08)),
    "no base": ((0.5, 0.5, 1.0), (0.025, 0.025, 0.08)),
}
HEADINGS = (0.0, 180.0, 90.0, 270.0)


def euler(rpy: np.ndarray) -> np.ndarray:
    """Rz(yaw) Ry(pitch) Rx(roll), (n, 3) -> (n, 3, 3)."""
    return Rotation.from_euler("ZYX", np.asarray(rpy)[..., ::-1]).as_matrix()


@dataclass(frozen=True, kw_only=True)
class Flight:
    """True places and poses; one row of `epoch` for each image, one of `seen` for each board in an image."""

    places: np.ndarray  # (b, 3)
    time: np.ndarray  # (e,)
    sortie: np.ndarray
    strip: np.ndarray
    position: np.ndarray  # (e, 3) ENU
    rpy: np.ndarray  # (e, 3)
    velocity: np.ndarray  # (e, 3) ENU
    epoch: np.ndarray  # (n,) of each observation
    board: np.ndarray  # (n,)

    def pixels(self, xi, lens, places, d_ned, d_rpy, clock) -> np.ndarray:
        """(n, 2): formula (11) written out, with errors of every kind as arguments."""
        position = self.position + d_ned @ ENU_FROM_NED.T - clock * self.velocity
        world_from_body = ENU_FROM_NED @ euler(self.rpy + d_rpy)
        body_from_camera = euler(xi[None, :3])[0] @ BODY_FROM_NADIR
        body = np.einsum("nji,nj->ni", world_from_body[self.epoch], places[self.board] - position[self.epoch])
        x, y, z = ((body - ARM - xi[3:]) @ body_from_camera).T
        x, y = x / z, y / z
        fx, fy, cx, cy, k1, k2, k3, p1, p2 = lens
        r2 = x * x + y * y
        radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.stack([fx * xd + cx, fy * yd + cy], axis=1)


def flight(headings=HEADINGS, heights=(45.0, 65.0), speeds=(5.0, 8.0), boards=8) -> Flight:
    """Eight boards within 12 m of the centre, one image a strip that shows them all."""
    rng = np.random.default_rng(77)
    ring = 2.0 * np.pi * (np.arange(boards) + 0.3) / boards
    radius = np.where(np.arange(boards) % 2, 6.0, 11.0)
    places = np.stack([radius * np.sin(ring), radius * np.cos(ring), rng.uniform(0.0, 0.3, boards)], axis=1)
    rows = []
    for sortie, (height, speed) in enumerate(zip(heights, speeds, strict=True), start=1):
        for strip, heading in enumerate(headings, start=1):
            a = np.radians(heading)
            along = np.array([np.sin(a), np.cos(a), 0.0])
            lead = height * np.tan(np.radians(0.3 * speed))
            position = lead * along + rng.normal(0.0, 0.1, 3) + np.array([0.0, 0.0, height])
            rpy = np.radians(np.array([0.0, -0.3 * speed, heading]) + rng.normal(0.0, 0.5, 3))
            rows.append((1000.0 * sortie + 20.0 * strip, sortie, strip, position, rpy, speed * along))
    time, sortie, strip, position, rpy, velocity = (np.array(c) for c in zip(*rows, strict=True))
    epoch, board = (a.ravel() for a in np.meshgrid(np.arange(len(rows)), np.arange(boards), indexing="ij"))
    return Flight(
        places=places,
        time=time,
        sortie=sortie,
        strip=strip,
        position=position,
        rpy=rpy,
        velocity=velocity,
        epoch=epoch,
        board=board,
    )


def rig(grade: str, clock_std: float = CLOCK_STD) -> Rig:
    prior = {"boresight_std_deg": 1.0, "lever_arm_std_m": 0.1, "boresight_deg": (0.0, 0.0, 0.0)}
    position, attitude = NAVIGATION[grade]
    return Rig(
        platform="m",
        kind="multirotor",
        camera=MountingSheet(lever_arm_m=tuple(ARM), axes="rdf_nadir", clock_std_s=clock_std, **prior),
        lidar=MountingSheet(lever_arm_m=(-0.05, -0.02, 0.12), axes="frd", **prior),
        navigation=NavigationSheet(
            grade="custom",
            position_std_m=position,
            attitude_std_deg=attitude,
            position_correlation_s=60.0,
            attitude_correlation_s=120.0,
        ),
    )


def lens_of(v: np.ndarray) -> Lens:
    return Lens(fx_px=v[0], fy_px=v[1], cx_px=v[2], cy_px=v[3], k1=v[4], k2=v[5], k3=v[6], p1=v[7], p2=v[8])


def correlation(f: Flight, seconds: float) -> np.ndarray:
    """(e, e) of a Gauss-Markov process; sorties are independent."""
    apart = np.abs(f.time[:, None] - f.time[None])
    return np.where(f.sortie[:, None] == f.sortie[None], np.exp(-apart / seconds), 0.0)


def draw(f: Flight, seed: int, grade: str = "apogee") -> tuple[BoardProblem, Views, list[BoardObservation]]:
    """What a campaign would deliver: the truth with one draw of every error."""
    rng = np.random.default_rng(seed)
    n, e = len(f.epoch), len(f.time)
    position_std, attitude_std = NAVIGATION[grade]
    roots = [np.linalg.cholesky(correlation(f, s) + 1e-12 * np.eye(e)) for s in (60.0, 120.0)]
    d_ned = roots[0] @ rng.standard_normal((e, 3)) * position_std
    d_rpy = roots[1] @ rng.standard_normal((e, 3)) * np.radians(attitude_std)
    clock = CLOCK_STD * rng.standard_normal()
    uv = f.pixels(TRUE, LENS, f.places, np.zeros((e, 3)), np.zeros((e, 3)), clock)
    uv = uv + PIXEL_STD * rng.standard_normal((n, 2))
    names = tuple(f"B{k + 1:02d}" for k in range(len(f.places)))
    problem = BoardProblem(
        rig=rig(grade),
        lens=lens_of(LENS + LENS_STD * rng.standard_normal(9)),
        lens_covariance=np.diag(LENS_STD**2),
        image_size_px=(3072, 2048),
        boards=names,
        places_m=f.places + SURVEY_STD * rng.standard_normal(f.places.shape),
        place_covariance_m2=np.tile(np.diag(SURVEY_STD**2), (len(names), 1, 1)),
        prior_std=np.array([np.radians(1.0)] * 3 + [0.1] * 3),
    )
    views = Views(
        board=f.board,
        sortie=f.sortie[f.epoch],
        strip=f.strip[f.epoch],
        time_s=f.time[f.epoch],
        body_m=(f.position + d_ned @ ENU_FROM_NED.T)[f.epoch],
        world_from_body=(ENU_FROM_NED @ euler(f.rpy + d_rpy))[f.epoch],
        velocity_m_s=f.velocity[f.epoch],
        turn_rate_rad_s=np.zeros((n, 3)),
        covariance_px2=np.tile(PIXEL_STD**2 * np.eye(2), (n, 1, 1)),
    )
    observations = [
        BoardObservation(
            target=names[b],
            sortie=int(f.sortie[i]),
            strip=int(f.strip[i]),
            image=f"s{f.sortie[i]:02d}_l{f.strip[i]:02d}.tif",
            gps_time_s=float(f.time[i]),
            uv_px=uv[k],
            covariance_px2=PIXEL_STD**2 * np.eye(2),
            count_px=np.round(uv[k]),
        )
        for k, (i, b) in enumerate(zip(f.epoch, f.board, strict=True))
    ]
    return problem, views, observations


def solved(f: Flight, seed: int, grade: str = "apogee") -> BoardMounting:
    return solve_board_problem(*draw(f, seed, grade))


def cramer_rao(f: Flight, grade: str) -> np.ndarray:
    """(6, 6) bound: every derivative by central differences of this file's own projection."""
    e, b = len(f.time), len(f.places)

    def pixels(v: np.ndarray) -> np.ndarray:
        xi, lens, places, ned, rpy = np.split(v, np.cumsum([6, 9, 3 * b, 3 * e]))[:5]
        return f.pixels(xi, lens, places.reshape(b, 3), ned.reshape(e, 3), rpy[: 3 * e].reshape(e, 3), v[-1]).ravel()

    v0 = np.concatenate([TRUE, LENS, f.places.ravel(), np.zeros(6 * e), [0.0]])
    jacobian = np.empty((2 * len(f.epoch), len(v0)))
    for k in range(len(v0)):
        step = np.zeros(len(v0))
        step[k] = 1e-6
        jacobian[:, k] = (pixels(v0 + step) - pixels(v0 - step)) / 2e-6
    position_std, attitude_std = NAVIGATION[grade]
    source = np.zeros((len(v0), len(v0)))
    source[6:15, 6:15] = np.diag(LENS_STD**2)
    places = slice(15, 15 + 3 * b)
    source[places, places] = np.diag(np.tile(SURVEY_STD**2, b))
    first = 15 + 3 * b
    for std, seconds in ((np.array(position_std), 60.0), (np.radians(attitude_std), 120.0)):
        block = slice(first, first + 3 * e)
        source[block, block] = np.kron(correlation(f, seconds), np.diag(std**2))
        first += 3 * e
    source[-1, -1] = CLOCK_STD**2
    v = jacobian @ source @ jacobian.T + PIXEL_STD**2 * np.eye(len(jacobian))
    a = jacobian[:, :6]
    prior = np.diag(np.array([np.radians(1.0)] * 3 + [0.1] * 3) ** -2.0)
    return np.linalg.inv(a.T @ np.linalg.solve(v, a) + prior)


FULL = flight()


def test_remapping_and_its_derivatives():
    """Rationale: (11) and the analytic Jacobian of S7 carry everything. Expected: pixels of this file's own projection; every
    derivative by central differences. Tolerance: 1e-8 px; 1e-6 of the greatest derivative (the differences' own error).
    """
    problem, views, _ = draw(FULL, 3)
    problem = replace(problem, lens=lens_of(LENS), places_m=FULL.places)
    exact = replace(
        views, body_m=FULL.position[FULL.epoch], world_from_body=(ENU_FROM_NED @ euler(FULL.rpy))[FULL.epoch]
    )
    at = remap(problem, exact, TRUE)
    zero = np.zeros((len(FULL.time), 3))
    assert at.uv_px == pytest.approx(FULL.pixels(TRUE, LENS, FULL.places, zero, zero, 0.0), abs=1e-8)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-6
        numeric = (remap(problem, exact, TRUE + step).uv_px - remap(problem, exact, TRUE - step).uv_px) / 2e-6
        assert at.by_xi[:, :, k] == pytest.approx(numeric, abs=1e-6 * np.abs(numeric).max())
    for k in range(3):
        step = 1e-5 * np.eye(3)[k]
        places = problem.places_m[exact.board]
        numeric = (
            remap(problem, exact, TRUE, places + step).uv_px - remap(problem, exact, TRUE, places - step).uv_px
        ) / 2e-5
        assert at.by_place[:, :, k] == pytest.approx(numeric, abs=1e-6 * np.abs(numeric).max())


def test_injected_mounting_is_recovered_for_twenty_flights():
    """Rationale: acceptance 1: what is stated must be what is got, with every error of the model drawn at once.

    Expected: |z| <= 3 on all but one value in thirty, z spread near 1, angles to 0.02 degrees, RMSE within 1.3 of the
    Cramer-Rao bound that this file takes from finite differences; the stated covariance is that bound.
    The mean residual as S6 has it is navigation's: 1 cm is 0.67 px an axis at 45 m and 0.46 px at 65 m, a part of which the
    mounting takes; with each image's pose adjusted it is survey and noise alone.
    Tolerance: spread 0.8 to 1.2 (120 values: 0.07), stated variances 2 % (the certificate's and the survey's draws move them).
    """
    bound = cramer_rao(FULL, "apogee")
    found = [solved(FULL, seed) for seed in range(20)]
    error = np.array([m.parameters - TRUE for m in found])
    z = error / np.array([np.sqrt(np.diag(m.covariance)) for m in found])
    rmse = np.sqrt(np.mean(error**2, axis=0))
    print("z spread", z.std(axis=0).round(2), "RMSE over bound", (rmse / np.sqrt(np.diag(bound))).round(2))
    assert np.sum(np.abs(z) > 3.0) <= z.size / 30
    assert 0.8 < z.std() < 1.2
    assert np.all(rmse <= 1.3 * np.sqrt(np.diag(bound)))
    assert np.degrees(np.abs(error[:, :3])).max() <= 0.05
    assert np.degrees(rmse[:3]).max() <= 0.02
    assert np.mean([np.diag(m.covariance) for m in found], axis=0) == pytest.approx(np.diag(bound), rel=0.02)
    assert np.mean([m.mean_adjusted_px for m in found]) <= 0.5
    assert 0.4 < np.mean([m.mean_residual_px for m in found]) < 1.0
    assert (
        max(np.linalg.norm(m.mean_vector_px) for m in found) <= 0.5
    )  # correlated navigation: not zero, as weights differ
    assert np.mean([m.sigma0 for m in found]) == pytest.approx(1.0, abs=0.1)
    assert not any(m.rejected for m in found)
    assert not any(m.not_determined for m in found)


def test_a_coarser_navigation_says_so():
    """Rationale: acceptance 1, APX-15 (0.025/0.08 degrees, correlated over the flight). Expected: larger stated deviations,
    errors within three of them, and the Cramer-Rao bound met. Tolerance: z spread 0.6 to 1.5 over 60 values.
    """
    found = [solved(FULL, seed, "apx15") for seed in range(100, 110)]
    fine = np.sqrt(np.diag(cramer_rao(FULL, "apogee")))
    coarse = np.sqrt(np.diag(cramer_rao(FULL, "apx15")))
    z = np.array([(m.parameters - TRUE) / np.sqrt(np.diag(m.covariance)) for m in found])
    assert np.all(coarse[:3] > 2.0 * fine[:3])
    assert np.sqrt(np.diag(found[0].covariance)) == pytest.approx(coarse, rel=0.05)
    assert np.abs(z).max() <= 3.5 and np.sum(np.abs(z) > 3.0) <= 1
    assert 0.6 < z.std() < 1.5
    assert np.mean([m.mean_adjusted_px for m in found]) <= 0.5


def test_sharp_centres_under_a_coarse_navigation_converge():
    """Rationale: centres stated to 0.002 px under pixels of common navigation error make rows nearly alike; the normal equations'
    rounding then moves the parameters by more than the limit in every iteration, for ever.
    """
    for seed in range(3):
        problem, views, observations = draw(flight(), seed, "apx15")
        sharp = replace(views, covariance_px2=np.tile(0.002**2 * np.eye(2), (len(observations), 1, 1)))
        uv = np.array([o.uv_px for o in observations])
        assert gauss_newton(problem, sharp, uv, np.zeros(6)).iterations <= 8


def test_every_cause_is_in_the_covariance():
    """Rationale: a cause that is left out makes stated deviations too small. Expected: the observations' covariance equals the
    one from finite differences of this file's own projection. Tolerance: 1e-5 of the greatest element.
    """
    problem, views, _ = draw(FULL, 5)
    problem = replace(problem, lens=lens_of(LENS), places_m=FULL.places)
    exact = replace(
        views, body_m=FULL.position[FULL.epoch], world_from_body=(ENU_FROM_NED @ euler(FULL.rpy))[FULL.epoch]
    )
    at = remap(problem, exact, TRUE)
    a = at.by_xi.reshape(-1, 6)
    v = observation_covariance(problem, exact, at)
    mine = np.linalg.inv(a.T @ np.linalg.solve(v, a) + np.diag(problem.prior_std**-2.0))
    bound = cramer_rao(FULL, "apogee")
    scale = np.sqrt(np.outer(np.diag(bound), np.diag(bound)))
    assert mine / scale == pytest.approx(bound / scale, abs=1e-4)


def test_single_heading_names_what_it_cannot_determine():
    """Rationale: acceptance 1. One strip at one height ties pitch to dx and roll to dy; a rank check never sees it.

    Expected: the four are named with their partners, have no value, and the strip that helps most is the opposite heading;
    flown in earnest, it leaves the deviation that was promised. Tolerance: 10 % (the strip's own sway and wind differ).
    """
    f = flight(headings=(0.0,), heights=(45.0,), speeds=(5.0,))
    found = solved(f, 1)
    block = found.results_block()
    weak = {str(n["parameter"]): n for n in found.not_determined}
    assert set(weak) == {
        "camera_boresight_roll",
        "camera_boresight_pitch",
        "camera_lever_arm_x",
        "camera_lever_arm_y",
    }
    assert weak["camera_boresight_pitch"]["partner"] == "camera_lever_arm_x"
    assert weak["camera_lever_arm_y"]["partner"] == "camera_boresight_roll"
    assert all(abs(float(n["correlation"])) > 0.95 for n in weak.values())
    estimates = dict(zip(block["names"], block["estimates"], strict=True))
    assert {n for n, v in estimates.items() if v is None} == set(weak)
    assert estimates["camera_boresight_yaw"] == pytest.approx(1.2, abs=0.05)
    assert "opposite heading (180" in str(weak["camera_lever_arm_x"]["helping_strip"])
    both = flight(headings=(0.0, 180.0), heights=(45.0,), speeds=(5.0,))
    problem, views, _ = draw(both, 1)
    flown = dict(zip(NAMES, predicted_std(problem, views, TRUE), strict=True))
    for name in ("camera_lever_arm_x", "camera_lever_arm_y"):
        assert weak[name]["std_with_it"] == pytest.approx(flown[name], rel=0.10)
    assert not solved(both, 1).not_determined
    json.dumps(block, allow_nan=False)
    count = dict(zip(block["names"], block["half_window_count"]["estimates"], strict=True))
    assert {n for n, v in count.items() if v is None} == set(weak)  # nor does the count give it a number


def test_no_strip_is_said_to_help_that_does_not():
    """Rationale: the height of the navigation is the boards' height whatever is flown. With 1 m of it lever arm z (prior 0.1 m)
    is not determined, and one more strip would leave 0.097 of 0.098 m.

    Expected: z is named, its deviation above half its prior is the cause, no strip is recommended and the reason says so; what
    each strip would leave is there. Tolerance: 5 % of the deviation.
    """
    entry = next(e for e in solved(FULL, 3, "no base").not_determined if e["parameter"] == "camera_lever_arm_z")
    assert entry["causes"] == ["prior"]
    assert entry["helping_strip"] is None and entry["std_with_it"] is None
    assert "none of the strips" in str(entry["reason"])
    assert min(entry["std_with_each"].values()) == pytest.approx(entry["std"], rel=0.05)


def test_more_observations_than_memory_holds():
    """Rationale: the adjustment's matrices have twice the observations squared: 100 boards in 60 images would ask for gigabytes.
    Expected: whole images stay, evenly, at most the limit, and the number of those left out is told; few are untouched."""
    _, _, observations = draw(FULL, 1)
    assert thinned(observations) == (observations, 0)
    many = [replace(o, image=f"{k:03d}_{o.image}") for k in range(120) for o in observations]
    kept, left_out = thinned(many)
    images = {(o.sortie, o.image) for o in kept}
    assert len(kept) <= MOST_OBSERVATIONS and len(kept) == 8 * len(images)
    assert left_out == 960 - len(images) and {o.sortie for o in kept} == {1, 2}


def test_rank_and_condition():
    """Rationale: the full rank of one strip hides what the condition shows. Expected: rank 6 for both flights, a condition on
    one strip at one height many times that of four headings at two heights; two equal columns lose a rank. Tolerance: 1e-9 of
    the closed form: columns at an angle whose cosine is c have the condition sqrt((1 + c) / (1 - c)).
    """
    full, one = solved(FULL, 1), solved(flight(headings=(0.0,), heights=(45.0,), speeds=(5.0,)), 1)
    print(full.condition, one.condition)
    assert full.rank == one.rank == 6
    assert full.condition is not None and one.condition is not None
    assert one.condition > 5.0 * full.condition
    c = 0.6
    columns = np.array([[1.0, c], [0.0, np.sqrt(1.0 - c * c)]]) * np.array([3.0, 1e-3])
    assert rank_and_condition(columns, np.eye(2)) == (2, pytest.approx(np.sqrt((1 + c) / (1 - c)), rel=1e-9))
    assert rank_and_condition(columns[:, [0, 0]], np.eye(2)) == (1, None)


def test_a_wild_count_is_named_and_left_out():
    """Rationale: a shadow's edge or a leaf moves the half-window count by a third of the board, 17 px of 50, where the fit is
    right to hundredths. Expected: that count is named and does not move the count's mounting; each board's both centres stand
    in the results; the spread holds the wild one too. Tolerance: the estimates without that observation, 1e-9.
    """
    problem, views, observations = draw(FULL, 7)
    wild = replace(observations[5], count_px=observations[5].count_px + np.array([17.0, 0.0]))
    none = replace(observations[5], count_px=None)
    found = solve_board_problem(problem, views, [*observations[:5], wild, *observations[6:]]).results_block()
    without = solve_board_problem(problem, views, [*observations[:5], none, *observations[6:]]).results_block()
    count = found["half_window_count"]
    assert len(count["left_out"]) == 1 and f"{wild.target} in {wild.image}: 1" in count["left_out"][0]
    assert count["observations"] == 63
    assert count["estimates"] == pytest.approx(without["half_window_count"]["estimates"], abs=1e-9)
    assert count["spread_against_fit_px"] > 1.0
    row = found["residuals"][5]
    assert [row["u_px"], row["v_px"]] == pytest.approx(wild.uv_px)
    assert [row["count_u_px"], row["count_v_px"]] == wild.count_px.tolist()
    assert without["residuals"][5]["count_u_px"] is None


def test_a_survey_blunder_is_named_and_left_out():
    """Rationale: acceptance 5: 10 cm at one board. Expected: that board named with the shift, nothing else left out, and the
    mounting as good as without it. Tolerance: the shift within 3 cm (navigation), |z| <= 3.5.
    """
    for board, error in ((2, [0.1, 0.0, 0.0]), (5, [0.06, -0.08, 0.0])):
        problem, views, observations = draw(FULL, 20 + board)
        places = problem.places_m.copy()
        places[board] += error
        found = solve_board_problem(replace(problem, places_m=places), views, observations)
        assert len(found.rejected) == 1
        line = found.rejected[0]
        assert f"surveyed place of B{board + 1:02d}" in line
        east = float(line.split("east ")[1].split(",")[0])
        assert east == pytest.approx(-error[0], abs=0.03)
        assert f"B{board + 1:02d}" not in found.boards and len(found.boards) == 7
        assert np.abs((found.parameters - TRUE) / np.sqrt(np.diag(found.covariance))).max() < 3.5


def test_swapped_boards_are_named():
    """Rationale: acceptance 5: the survey has two boards' names exchanged (here by 15 m; pixels carry the names that a person
    wrote). Expected: both left out and named as a pair; the rest as good as without. Tolerance: |z| <= 3.5.
    """
    for seed, (a, b) in enumerate(((0, 1), (2, 6), (3, 4)), start=40):
        problem, views, observations = draw(FULL, seed)
        places = problem.places_m.copy()
        places[[a, b]] = places[[b, a]]
        found = solve_board_problem(replace(problem, places_m=places), views, observations)
        assert found.swapped == ((f"B{a + 1:02d}", f"B{b + 1:02d}"),)
        assert len(found.rejected) == 1 and "swapped" in found.rejected[0]
        assert len(found.boards) == 6
        assert np.abs((found.parameters - TRUE) / np.sqrt(np.diag(found.covariance))).max() < 3.5


def test_one_wrong_pixel_costs_one_observation():
    """Rationale: a blunder in one image must not cost a board. Expected: that observation alone is named. Tolerance: none."""
    problem, views, observations = draw(FULL, 60)
    bad = replace(observations[21], uv_px=observations[21].uv_px + np.array([1.5, -1.0]))
    found = solve_board_problem(problem, views, [*observations[:21], bad, *observations[22:]])
    assert found.rejected == (f"board {bad.target} in {bad.image}",)
    assert sum(not r.used for r in found.residuals) == 1
    assert len(found.boards) == 8


def test_a_wild_pixel_or_place_costs_no_other_board():
    """Rationale: a person's pixel may be a slip of the keyboard, a surveyed height one of the pen: 1e5 px, a board above the
    aircraft. Expected: that observation, that board alone is named, no figure that is none. Tolerance: none."""
    problem, views, observations = draw(FULL, 60)
    for far in (300.0, 3000.0, 1e5):
        slip = replace(observations[21], uv_px=observations[21].uv_px + far)
        found = solve_board_problem(problem, views, [*observations[:21], slip, *observations[22:]])
        assert found.rejected == (f"board {slip.target} in {slip.image}",)
        assert np.abs((found.parameters - TRUE) / np.sqrt(np.diag(found.covariance))).max() < 3.5
    high = problem.places_m.copy()
    high[2, 2] += 200.0
    found = solve_board_problem(replace(problem, places_m=high), views, observations)
    assert found.rejected == ("surveyed place of B03: no camera that saw it could see it there",)


def test_results_block_is_complete():
    """Rationale: the report and score read this block. Expected: degrees and metres, a correlation with ones, the count's
    companion with the spread of rounding (0.29 px). Tolerance: 1e-9; 0.03 px.
    """
    found = solved(FULL, 7)
    block = found.results_block()
    json.dumps(block, allow_nan=False)
    assert block["names"] == list(NAMES)
    assert block["estimates"][:3] == pytest.approx(np.degrees(found.parameters[:3]), abs=1e-9)
    assert block["std"][3:] == pytest.approx(np.sqrt(np.diag(found.covariance))[3:], abs=1e-9)
    assert np.diag(block["covariance"]) == pytest.approx(np.square(block["std"]), rel=1e-9)
    assert np.diag(block["correlation"]) == pytest.approx(1.0, abs=1e-9)
    assert block["observations"] == 64 and block["images"] == 8
    assert block["half_window_count"]["spread_against_fit_px"] == pytest.approx(0.29, abs=0.03)
    assert block["half_window_count"]["estimates"][:3] == pytest.approx(np.degrees(TRUE[:3]), abs=0.1)


def test_too_little_is_a_reason():
    """Expected: two boards, or boards that contradict each other, end in one line that says so."""
    f = flight(boards=8)
    problem, views, observations = draw(f, 9)
    two = np.flatnonzero(views.board < 2)
    with pytest.raises(EvaluationError, match="too few 2x2 boards"):
        solve_board_problem(
            replace(
                problem,
                boards=problem.boards[:2],
                places_m=problem.places_m[:2],
                place_covariance_m2=problem.place_covariance_m2[:2],
            ),
            views.rows(two),
            [observations[i] for i in two],
        )
    rng = np.random.default_rng(0)
    wild = problem.places_m + rng.uniform(-3.0, 3.0, problem.places_m.shape) * np.array([1.0, 1.0, 0.0])
    with pytest.raises(EvaluationError, match="contradict"):
        solve_board_problem(replace(problem, places_m=wild), views, observations)
