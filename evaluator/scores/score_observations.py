"""Single observations of an evaluation against the truth of a simulated campaign: vertices, marks, panels' reflectance.

Opens truth/ as `score` does. A vertex is put into the world by the true mounting and the true trajectory at the true time, so
that only the estimate's own error is left, with the range noise and the range errors that were injected.
"""

from pathlib import Path

import numpy as np

from campaign.folder import CampaignFolder
from campaign.manifest import read_manifest
from campaign.truth import read_marks, read_true_trajectories, read_truth
from evaluator.frames import WorldFrame
from evaluator.georeference import world_points
from evaluator.model import Mounting
from evaluator.results import Evaluation

Errors = dict[str, dict[str, float]]  # quantity -> item -> error


def observation_errors(root: Path, evaluation: Evaluation) -> Errors:
    """Errors of every vertex, mark and panel whose truth is known.

    Returns
    -------
    dict
        Quantity -> what -> estimate minus truth: `vertex_east`, `vertex_north`, `vertex_up` [m], `mark_u`, `mark_v` [px],
        `panel_reflectance` [%].

    Raises
    ------
    CampaignError
        truth/ cannot be read.
    """
    folder = CampaignFolder(root)
    if not folder.truth.is_dir():
        return {}
    truth = read_truth(root)
    out: Errors = {}
    if evaluation.vertices:
        frame = WorldFrame(read_manifest(root))
        paths = read_true_trajectories(folder.held(folder.truth / "trajectory.npz"))
        mounting = Mounting(rotation=np.array(truth.lidar.rotation), lever_arm_m=np.array(truth.lidar.lever_arm_m))
        places = {t.id: np.array(t.vertex_world_m) for t in truth.targets if t.vertex_world_m is not None}
        for v in evaluation.vertices:
            time = v.gps_time_s - truth.lidar_clock_s
            path = paths.get(v.sortie)
            if path is None or v.target not in places or not path.gps_time_s[0] <= time <= path.gps_time_s[-1]:
                continue
            world = world_points(v.point_lidar_m[None], np.array([time]), path, mounting, frame)[0]
            for axis, error in zip(("east", "north", "up"), world - places[v.target], strict=True):
                out.setdefault(f"vertex_{axis}", {})[f"{v.target}, sortie {v.sortie}, strip {v.strip}"] = float(error)
    if evaluation.marks and (folder.truth / "marks.csv").is_file():
        true = {(m.target, m.image): (m.u_px, m.v_px) for m in read_marks(folder.held(folder.truth / "marks.csv"))}
        for o in evaluation.marks:
            known = true.get((o.target, f"sorties/{o.sortie:02d}/images/{o.image}"))
            if known is not None:
                for axis, k in (("u", 0), ("v", 1)):
                    out.setdefault(f"mark_{axis}", {})[f"{o.target}, {o.image}"] = float(o.uv_px[k] - known[k])
    laser = {t.id: 100.0 * t.laser_reflectance for t in truth.targets if t.laser_reflectance is not None}
    for panel in evaluation.panels:
        if panel.lidar_percent is not None and panel.id in laser:
            out.setdefault("panel_reflectance", {})[panel.id] = panel.lidar_percent - laser[panel.id]
    return out
