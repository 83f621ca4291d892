"""What tests of the boards' mounting share: the simulator's own projection, the bound that follows, dry flights.

Read with runpy by the tests that use it. The bound (Cramer-Rao) comes from finite differences of the simulator's true camera on
its true path, so that no formula of the evaluator is in it. A dry flight has the simulator's own draws of navigation, survey
and certificate, and its true pixels with noise in the place of pictures.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from campaign.config import Config
from campaign.load import load_config
from evaluator.boards.board_observations import BoardObservation
from evaluator.boards.mounting_by_boards import BoardMounting
from evaluator.load import load_campaign
from evaluator.model import CampaignData
from simulator import paperwork
from simulator.camera.view import frame_pose, project
from simulator.flight import rig
from simulator.flight.frames import ENU_FROM_NED
from simulator.flight.motion import Strip
from simulator.flight.navigation import estimate_motion, navigation_std, trajectory_of
from simulator.simulate import prepare_range, simulate_campaign
from simulator.world import Range

CAMPAIGN = "mounting_boards"
CAMERA_ONLY = 'campaign.parts=["camera"]'
APX15 = 'navigation.grade="apx15"'
ONE_STRIP = (
    "flight.headings_deg=[0.0]",
    "flight.heights_m=[45.0]",
    "flight.speeds_m_s=[5.0]",
    "flight.images_per_strip=3",
)
TRUE = np.array([0.8, -0.5, 1.2, 0.03, -0.02, 0.05])
UNIT = np.array([np.degrees(1.0)] * 3 + [1.0] * 3)  # rad and m to degrees and m
SHORT = ("roll", "pitch", "yaw", "x", "y", "z")
PIXEL_STD_PX = 0.004  # of a synthetic centre, and stated


def frames_of(world: Range) -> list[tuple[int, Strip, str, float]]:
    """(sortie, strip, picture's name, true time) of every exposure, in the order of the campaign's exposures.csv."""
    return [
        (sortie.number, strip, f"s{sortie.number:02d}_l{strip.number:02d}_{k + 1:03d}.tif", at)
        for sortie in world.sorties
        for strip in sortie.strips
        for k, at in enumerate(strip.exposure_s)
    ]


def boards_of(world: Range) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and true centres (b, 3) of the boards. [m]"""
    found = [t for t in world.scene.targets if t.kind == "board"]
    return tuple(t.id for t in found), np.stack([t.mark_m for t in found])


def pixels(
    world: Range,
    config: Config,
    *,
    shift_m: np.ndarray | None = None,
    ned_m: Sequence[float] = (0.0, 0.0, 0.0),
    rpy_rad: Sequence[float] = (0.0, 0.0, 0.0),
    later_s: float = 0.0,
) -> np.ndarray:
    """(images, boards, 2) true pixels of the boards' centres by `config`'s camera and mounting. [px]

    `shift_m` moves every board, `ned_m` and `rpy_rad` the body, `later_s` the instant.
    """
    centres = boards_of(world)[1] + (0.0 if shift_m is None else shift_m)
    motions = {
        s.number: replace(
            s.motion,
            position_world_m=s.motion.position_world_m + ENU_FROM_NED @ np.asarray(ned_m),
            rpy_rad=s.motion.rpy_rad + np.asarray(rpy_rad),
        )
        for s in world.sorties
    }
    mounting = rig.true_camera(config)
    return np.array(
        [
            project(config.camera, frame_pose(motions[number], mounting, at + later_s), centres)[0]
            for number, _, _, at in frames_of(world)
        ]
    )


def with_mounting(config: Config, xi_deg_m: np.ndarray) -> Config:
    faults = config.faults.model_copy(
        update={"camera_boresight_deg": tuple(xi_deg_m[:3]), "camera_lever_arm_m": tuple(xi_deg_m[3:])}
    )
    return config.model_copy(update={"faults": faults})


def with_lens(config: Config, name: str, step: float) -> Config:
    lens = config.camera.lens.model_copy(update={name: getattr(config.camera.lens, name) + step})
    return config.model_copy(update={"camera": config.camera.model_copy(update={"lens": lens})})


def bound(world: Range, config: Config, seen: np.ndarray, pixel_std_px: float) -> np.ndarray:
    """(6, 6) Cramer-Rao bound of the mounting in degrees and metres, for Gaussian errors of known covariance.

    Observations are the pixels of the boards `seen` (images, boards). Their covariance holds pixel noise, survey (one place for
    each board), the lens's certificate, the camera's clock, and the trajectory's Gauss-Markov errors, independent between
    sorties; each enters through central differences of `pixels`. The drawing's mounting is prior information.
    """

    def difference(step: float, **unit: np.ndarray | float) -> np.ndarray:
        plus, minus = (pixels(world, config, **{k: s * step * v for k, v in unit.items()}) for s in (1.0, -1.0))  # type: ignore[arg-type]
        return np.asarray((plus - minus)[seen].ravel() / (2.0 * step))

    columns = []
    for k in range(6):
        step = np.eye(6)[k] * (1e-3 if k < 3 else 1e-4)
        plus, minus = (pixels(world, with_mounting(config, TRUE + s * step)) for s in (1.0, -1.0))
        columns.append((plus - minus)[seen].ravel() / (2.0 * step[k]))
    design = np.stack(columns, axis=1)

    board = np.repeat(np.nonzero(seen)[1], 2)
    frames = frames_of(world)
    sortie, at = (
        np.repeat(np.array(c)[np.nonzero(seen)[0]], 2) for c in zip(*((f[0], f[3]) for f in frames), strict=True)
    )
    covariance = pixel_std_px**2 * np.eye(len(board))
    survey = config.targets.survey
    for axis, std in enumerate((survey.horizontal_std_m, survey.horizontal_std_m, survey.height_std_m)):
        by_place = std * difference(1e-4, shift_m=np.eye(3)[axis])
        covariance += np.where(board[:, None] == board, np.outer(by_place, by_place), 0.0)
    for name, std in zip(rig.LENS_PARAMETERS, config.camera.calibration_std, strict=True):
        plus, minus = (pixels(world, with_lens(config, name, s * std)) for s in (1.0, -1.0))
        by_lens = (plus - minus)[seen].ravel() / 2.0
        covariance += np.outer(by_lens, by_lens)
    by_clock = config.platform.mounting_clock_std_s * difference(1e-4, later_s=1.0)
    covariance += np.outer(by_clock, by_clock)
    position_std, attitude_std = navigation_std(config)
    apart = np.where(sortie[:, None] == sortie, np.abs(at[:, None] - at), np.inf)
    for axis in np.eye(3):
        by_position = float(axis @ position_std) * difference(1e-4, ned_m=axis)
        by_attitude = float(np.radians(axis @ attitude_std)) * difference(1e-5, rpy_rad=axis)
        navigation = config.navigation
        covariance += np.outer(by_position, by_position) * np.exp(-apart / navigation.position_correlation_s)
        covariance += np.outer(by_attitude, by_attitude) * np.exp(-apart / navigation.attitude_correlation_s)
    platform = config.platform
    prior = np.array([platform.mounting_boresight_std_deg] * 3 + [platform.mounting_lever_arm_std_m] * 3)
    return np.linalg.inv(design.T @ np.linalg.solve(covariance, design) + np.diag(prior**-2.0))


def error_of(found: BoardMounting) -> np.ndarray:
    return np.asarray(found.parameters * UNIT - TRUE)


def std_of(found: BoardMounting) -> np.ndarray:
    return np.asarray(np.sqrt(np.diag(found.covariance)) * UNIT)


def pooled_ratio(errors: np.ndarray, bounds: np.ndarray) -> tuple[float, float]:
    """Root mean square of error over bound, all runs and parameters pooled; and its sampling deviation when the bound is met.

    Runs are independent, the six of a run are not: the mean of n k squares of correlated standard normals has the variance
    2 sum(rho^2) / (n k^2).
    """
    std = np.sqrt(np.diagonal(bounds, axis1=1, axis2=2))
    rho = np.mean(bounds / (std[:, :, None] * std[:, None, :]), axis=0)
    ratio = float(np.sqrt(np.mean((errors / std) ** 2)))
    return ratio, float(0.5 * np.sqrt(2.0 * np.sum(rho**2) / (len(errors) * 36.0)))


def check_single_strip(found: BoardMounting) -> None:
    """Lever arm x and y have no value, and the strip that helps is another heading, with what it would leave."""
    block = found.results_block()
    weak = {str(e["parameter"]): e for e in found.not_determined}
    estimates = dict(zip(found.names, block["estimates"], strict=True))  # type: ignore[call-overload]
    assert {"camera_lever_arm_x", "camera_lever_arm_y"} <= weak.keys()
    assert {n for n, value in estimates.items() if value is None} == weak.keys()
    for name, entry in weak.items():
        assert "heading" in str(entry["helping_strip"]), name
        assert entry["std_with_it"] < entry["std"]
    assert abs(estimates["camera_boresight_yaw"] - TRUE[2]) < 0.1


@dataclass(frozen=True, kw_only=True)
class Dry:
    """A flight without pictures: scene and path of one seed, and its folder as read back."""

    world: Range
    overrides: tuple[str, ...]
    data: CampaignData
    true_px: np.ndarray  # (images, boards, 2)
    seen: np.ndarray  # (images, boards) wholly inside the picture

    def draw(self, seed: int) -> tuple[CampaignData, list[BoardObservation]]:
        """One draw of navigation, survey and certificate by the simulator, of clock and pixel noise here."""
        config = load_config(CAMPAIGN, [*self.overrides, f"seed={seed}"])
        world = self.world
        rng = np.random.default_rng([seed, 4])
        clock_s = config.platform.mounting_clock_std_s * rng.standard_normal()
        sorties = tuple(
            replace(s, trajectory=trajectory_of(estimate_motion(config, f.motion, f.number), world.frame, config))
            for s, f in zip(self.data.sorties, world.sorties, strict=True)
        )
        data = replace(
            self.data,
            sorties=sorties,
            targets=tuple(paperwork.surveyed_targets(config, world.scene, world.frame)),
            camera=rig.camera_sheet(config),
            rig=rig.rig_sheet(config),
        )
        names = boards_of(world)[0]
        observations = [
            BoardObservation(
                target=name,
                sortie=number,
                strip=strip.number,
                image=image,
                gps_time_s=at + clock_s,
                uv_px=self.true_px[i, j] + PIXEL_STD_PX * rng.standard_normal(2),
                covariance_px2=PIXEL_STD_PX**2 * np.eye(2),
            )
            for i, (number, strip, image, at) in enumerate(frames_of(world))
            for j, name in enumerate(names)
            if self.seen[i, j]
        ]
        return data, observations

    def bound(self) -> np.ndarray:
        config = load_config(CAMPAIGN, [*self.overrides])
        return bound(self.world, config, self.seen, PIXEL_STD_PX)


def dry(place: Path, *overrides: str) -> Dry:
    """Fly seed 4 once without pictures."""
    all_overrides = (CAMERA_ONLY, "scene_seed=4", *overrides)
    config = load_config(CAMPAIGN, list(all_overrides))
    folder = place / "dry"
    folder.mkdir()
    simulate_campaign(config, folder, only=frozenset())
    world = prepare_range(config)
    true_px = pixels(world, config)
    margin = 50.0  # half a board's diagonal at 45 m
    size = np.array([config.camera.width_px, config.camera.height_px])
    seen = np.all((true_px > margin) & (true_px < size - margin), axis=2)
    return Dry(world=world, overrides=all_overrides, data=load_campaign(folder), true_px=true_px, seen=seen)
