"""Acceptance of the patent's method on configs/campaigns/mounting_boards.toml: ten seeds, rendered, found in the pictures, solved.

Each is held against the bound of `boards_bound`; flights without pictures are `test_boards_bound`'s.
"""

import runpy
import shutil
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from campaign.flight.images import read_image
from campaign.load import load_config
from campaign.truth import read_marks
from evaluator.boards.board_observations import BoardObservation, observe_boards
from evaluator.boards.mounting_by_boards import BoardMounting, solve_by_boards
from evaluator.georeference import nominal_mountings
from evaluator.load import load_campaign
from evaluator.model import CampaignData
from simulator.simulate import prepare_range, simulate_campaign

SHARED = runpy.run_path(str(Path(__file__).parent / "boards_bound.py"))
APX15, CAMERA_ONLY, CAMPAIGN, ONE_STRIP, SHORT = (
    SHARED[name] for name in ("APX15", "CAMERA_ONLY", "CAMPAIGN", "ONE_STRIP", "SHORT")
)
boards_of, bound, check_single_strip, error_of, frames_of, pooled_ratio, std_of = (
    SHARED[name]
    for name in ("boards_of", "bound", "check_single_strip", "error_of", "frames_of", "pooled_ratio", "std_of")
)
SEEDS = tuple(range(1, 11))
APX15_SEEDS = (1, 2)  # whose pictures are also solved with a redrawn, coarser navigation


@dataclass(frozen=True, kw_only=True)
class Run:
    """What is left of one rendered campaign when its pictures are deleted."""

    seed: int
    data: CampaignData
    observations: list[BoardObservation]
    found: BoardMounting
    with_apx15: BoardMounting | None
    pixel_error_px: np.ndarray  # (n, 2) of the centres, against truth/marks.csv
    seconds: float  # to render, find and solve, without the second navigation

    @property
    def z(self) -> np.ndarray:
        return error_of(self.found) / std_of(self.found)


def observed(data: CampaignData) -> tuple[list[BoardObservation], dict[str, str]]:
    """All boards in all pictures of a campaign, from the drawing's mounting."""
    assert data.rig is not None and data.camera is not None
    nominal = nominal_mountings(data.rig)[0]
    size = {"width_px": data.camera.width_px, "height_px": data.camera.height_px, "bands": len(data.camera.bands)}
    found: list[BoardObservation] = []
    reasons: dict[str, str] = {}
    for sortie in data.sorties:
        for exposure in sortie.exposures:
            image = read_image(sortie.folder.images / exposure.image, **size)
            more, why = observe_boards(data, sortie, exposure, image, nominal)
            found += more
            reasons |= why
    return found, reasons


def with_other_navigation(data: CampaignData, place: Path, *overrides: str) -> CampaignData:
    """The same pictures with the trajectories, and the sheet, of another navigation: the simulator's, without rendering."""
    place.mkdir()
    simulate_campaign(load_config(CAMPAIGN, [CAMERA_ONLY, *overrides]), place, only=frozenset())
    other = load_campaign(place)
    sorties = tuple(replace(a, trajectory=b.trajectory) for a, b in zip(data.sorties, other.sorties, strict=True))
    return replace(data, rig=other.rig, sorties=sorties)


def fly(seed: int, place: Path) -> Run:
    started = time.monotonic()
    place.mkdir()
    simulate_campaign(load_config(CAMPAIGN, [CAMERA_ONLY, f"seed={seed}"]), place)
    data = load_campaign(place)
    observations, reasons = observed(data)
    found = solve_by_boards(data, observations, reasons)
    seconds = time.monotonic() - started
    marks = {(m.target, Path(m.image).name): (m.u_px, m.v_px) for m in read_marks(place / "truth" / "marks.csv")}
    coarse = None
    if seed in APX15_SEEDS:
        other = with_other_navigation(data, place.with_name(f"{place.name}_apx15"), f"seed={seed}", APX15)
        coarse = solve_by_boards(other, *observed(other))
    shutil.rmtree(place)
    run = Run(
        seed=seed,
        data=data,
        observations=observations,
        found=found,
        with_apx15=coarse,
        pixel_error_px=np.array([o.uv_px - marks[o.target, o.image] for o in observations]),
        seconds=seconds,
    )
    print(
        f"seed {seed}: {seconds:.0f} s, {len(observations)} centres, z {run.z.round(2)}, "
        f"residual {found.mean_residual_px:.3f} px, without navigation {found.mean_adjusted_px:.3f} px"
    )
    return run


@pytest.fixture(scope="module")
def ten(tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    place = tmp_path_factory.mktemp("ten")
    return [fly(seed, place / f"seed{seed}") for seed in SEEDS]


def bound_of(run: Run) -> np.ndarray:
    """(6, 6) for one rendered seed: the boards seen, and the centres' own scatter about truth/marks.csv as pixel noise."""
    config = load_config(CAMPAIGN, [CAMERA_ONLY, f"seed={run.seed}"])
    world = prepare_range(config)
    used = {(o.image, o.target) for o in run.observations}
    names = boards_of(world)[0]
    seen = np.array([[(image, name) in used for name in names] for _, _, image, _ in frames_of(world)])
    return np.asarray(bound(world, config, seen, float(np.std(run.pixel_error_px))))


@pytest.mark.slow
def test_ten_rendered_seeds(ten: list[Run]) -> None:
    """Rationale: acceptance 1, the method from pictures to mounting, all errors drawn anew in each seed.

    Expected: (0.8, -0.5, 1.2 deg; 3, -2, 5 cm) with |z| <= 3 on at least 58 of 60, angles within 0.02 degrees, nothing
    rejected, everything determined, and every board found in every picture within 0.02 px of its true place.
    The residual as S6 has it is navigation's: 1 cm is 0.67 px an axis at 45 m and 0.46 px at 65 m, and its height and heading
    differ from picture to picture; no mounting takes that away, and its mean is about 0.7 px. What remains when each
    picture's pose takes its most probable navigation error is at most 0.5 px (survey and noise).
    Tolerance: as the acceptance states; z: a normal value passes 3 once in 370, so 0.16 of 60 are expected.
    """
    z = np.array([run.z for run in ten])
    errors = np.array([error_of(run.found) for run in ten])
    raw = np.array([run.found.mean_residual_px for run in ten])
    adjusted = np.array([run.found.mean_adjusted_px for run in ten])
    print("z, a row for each seed:\n", z.round(2))
    print("angles' greatest error", np.abs(errors[:, :3]).max(axis=0).round(4), "deg")
    print("mean residual", raw.round(2), "px; without navigation", adjusted.round(2), "px")
    vector = np.array([np.linalg.norm(run.found.mean_vector_px) for run in ten])
    print("mean of the residuals' vectors, its length", vector.round(2), "px")
    print("seconds a seed", [round(run.seconds) for run in ten])
    assert np.sum(np.abs(z) <= 3.0) >= 58
    assert np.abs(errors[:, :3]).max() <= 0.02
    assert adjusted.max() <= 0.5 and vector.max() <= 0.5
    assert raw.mean() < 1.0
    for run in ten:
        assert not run.found.rejected and not run.found.not_determined
        assert len(run.observations) == 96
        assert np.abs(run.pixel_error_px).max() < 0.02


@pytest.mark.slow
def test_ten_rendered_seeds_meet_the_bound(ten: list[Run]) -> None:
    """Rationale: acceptance 1: no unbiased estimate from these observations can be better than the Cramer-Rao bound, and the
    method must come near it; a stated deviation that differs from the bound states another flight.

    The pixel noise of the bound is the centres' own scatter about truth/marks.csv.

    Expected: RMSE over ten seeds and six parameters at most 1.3 times the bound (its sampling deviation is printed: about
    0.1), each seed's stated deviation from 3 % below to 10 % above its bound.
    Tolerance: each centre's stated deviation comes from its own residuals and is up to a third too large, which makes lever arm
    x and y some per cent too wide; 3 % below for the linearisation at an estimate.
    """
    errors, bounds, stated = [], [], []
    for run in ten:
        bounds.append(bound_of(run))
        errors.append(error_of(run.found))
        stated.append(std_of(run.found) / np.sqrt(np.diag(bounds[-1])))
    ratio, sampling = pooled_ratio(np.array(errors), np.array(bounds))
    each = np.sqrt(np.mean(np.array(errors) ** 2, axis=0) / np.mean(np.diagonal(bounds, axis1=1, axis2=2), axis=0))
    print(
        f"RMSE over bound, pooled {ratio:.2f} (1 +- {sampling:.2f}); each",
        dict(zip(SHORT, each.round(2).tolist(), strict=True)),
    )
    print("bound", np.sqrt(np.mean(np.diagonal(bounds, axis1=1, axis2=2), axis=0)).round(5), "deg, m")
    print("stated over bound, least and greatest", np.min(stated, axis=0).round(3), np.max(stated, axis=0).round(3))
    assert ratio <= 1.3
    assert np.min(stated) > 0.97 and np.max(stated) < 1.10


@pytest.mark.slow
def test_the_same_pictures_with_an_apx15(ten: list[Run]) -> None:
    """Rationale: acceptance 1: pictures do not depend on the navigation's estimate, so the same ones are solved with one of
    0.025/0.08 degrees. Expected: every error within 3 stated deviations, and these several times wider: at least three
    times for the angles, and wider for the lever arm. Tolerance: 12 values, one beyond 3 has a chance of 3 %.
    """
    runs = [run for run in ten if run.with_apx15 is not None]
    assert [run.seed for run in runs] == list(APX15_SEEDS)
    for run in runs:
        assert run.with_apx15 is not None
        wider = std_of(run.with_apx15) / std_of(run.found)
        z = error_of(run.with_apx15) / std_of(run.with_apx15)
        print(
            f"seed {run.seed}: z {z.round(2)}, stated {std_of(run.with_apx15).round(4)}, times wider {wider.round(1)}"
        )
        assert np.abs(z).max() <= 3.0
        assert wider[:3].min() > 3.0 and wider[3:].min() > 1.2
        assert not run.with_apx15.rejected
        assert run.with_apx15.mean_adjusted_px <= 0.5


@pytest.mark.slow
def test_one_rendered_strip_says_what_it_cannot_determine(tmp_path: Path) -> None:
    """Rationale and expectation as above, from pictures."""
    place = tmp_path / "campaign"
    place.mkdir()
    simulate_campaign(load_config(CAMPAIGN, [CAMERA_ONLY, *ONE_STRIP]), place)
    data = load_campaign(place)
    check_single_strip(solve_by_boards(data, *observed(data)))
