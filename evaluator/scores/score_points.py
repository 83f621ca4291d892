"""How far shown points of the cloud lie from the truth of a simulated campaign. Beside `score` the only room that opens truth/.

A pulse's true point is the true range along the beam that the LiDAR stated, through the true mounting and the true trajectory
at the true time. The noise of the encoder, about 1 mm at 60 m, stays in the stated beam and so does not count as error.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from campaign.errors import CampaignError
from campaign.flight.trajectory import Trajectory
from campaign.folder import CampaignFolder
from campaign.manifest import read_manifest
from campaign.truth import Truth, read_true_returns, read_true_trajectories, read_truth
from evaluator.frames import WorldFrame
from evaluator.georeference import world_points
from evaluator.model import Mounting


class PointTruth:
    """Errors of points by truth/; one strip's table in memory at a time. A `TruthErrors` of the 3D page."""

    def __init__(self, folder: CampaignFolder, truth: Truth, trajectories: Mapping[int, Trajectory]) -> None:
        self._folder = folder
        self._frame = WorldFrame(read_manifest(folder.root))
        self._trajectories = trajectories
        self._clock_s = truth.lidar_clock_s
        self._mounting = Mounting(
            rotation=np.array(truth.lidar.rotation), lever_arm_m=np.array(truth.lidar.lever_arm_m)
        )

    def __call__(
        self,
        sortie: int,
        strip: int,
        record: np.ndarray,
        p_lidar_m: np.ndarray,
        gps_time_s: np.ndarray,
        world_m: np.ndarray,
    ) -> np.ndarray:
        """Distance of each version of each point from its true place.

        Parameters
        ----------
        sortie, strip : int
        record : (n,) int64 np.ndarray
            Rows of the strip's LAS file, which are those of its true returns.
        p_lidar_m : (n, 3) np.ndarray
            As measured, in the LiDAR's frame; only the direction is used. [m]
        gps_time_s : (n,) np.ndarray
            As stamped. [s]
        world_m : (k, n, 3) np.ndarray
            Versions of the points. [m]

        Returns
        -------
        (k, n) np.ndarray
            NaN where the version is NaN or the truth says nothing about it. [m]

        Raises
        ------
        CampaignError
            truth/ has no table of this strip, or one that does not belong to it.
        """
        path = self._folder.held(self._folder.truth / f"returns_{sortie:02d}_{strip:02d}.npz")
        true_range = read_true_returns(path).range_m
        trajectory = self._trajectories.get(sortie)
        if trajectory is None:
            raise CampaignError("has no trajectory of this sortie", where=str(self._folder.truth), got=sortie)
        if record.size and int(record.max()) >= len(true_range):
            raise CampaignError(
                "does not have the rows of its strip", where=str(path), got=len(true_range), expected=int(record.max())
            )
        length = np.linalg.norm(p_lidar_m, axis=1)
        time = gps_time_s - self._clock_s
        known = (time >= trajectory.gps_time_s[0]) & (time <= trajectory.gps_time_s[-1]) & (length > 0.0)
        rows = np.flatnonzero(known & np.isfinite(true_range[record]))
        out = np.full(world_m.shape[:2], np.nan)
        if rows.size:
            beam = p_lidar_m[rows] / length[rows, None]
            exact = beam * true_range[record[rows], None]
            true = world_points(exact, time[rows], trajectory, self._mounting, self._frame)
            out[:, rows] = np.linalg.norm(world_m[:, rows] - true, axis=2)
        return out


def point_errors(root: Path) -> PointTruth | None:
    """What tells the errors of a campaign's points; None where the campaign has no truth/ (a flown one).

    Raises
    ------
    CampaignError
        truth/ is there and cannot be read.
    """
    folder = CampaignFolder(root)
    if not folder.truth.is_dir():
        return None
    truth = read_truth(root)
    return PointTruth(folder, truth, read_true_trajectories(folder.held(folder.truth / "trajectory.npz")))
