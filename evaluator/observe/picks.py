"""Who saw what: the LiDAR points that a person gave to targets, and the record numbers behind the evaluator's own observations.

Only numbers of records; coordinates stay in the strips' files. Pixels that a person gave are used where images are read.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from campaign.errors import CampaignError, TestrangeError
from campaign.flight.las import StripReader
from campaign.flight.records import read_lidar_observations
from campaign.folder import SortieFolder
from evaluator.georeference import TargetReturns
from evaluator.model import CampaignData, VertexObservation
from evaluator.observe.panels import LidarPanelObservation

PointNumbers = dict[tuple[int, int, str], np.ndarray]  # (sortie, strip, target) -> (n,) int64, rising


def read_picked_points(
    place: SortieFolder, strips: Sequence[int], targets: Sequence[str]
) -> tuple[dict[tuple[int, str], np.ndarray], list[CampaignError]]:
    """observations_lidar.csv of one sortie: (strip, target) -> record numbers, and what of it cannot be used.

    The picks of a target in a strip are taken together or not at all: a number beyond the file's end means that the list
    belongs to another file.

    Parameters
    ----------
    place : SortieFolder
    strips : sequence of int
        Numbers of the strips on disk.
    targets : sequence of str
        Ids of the survey.

    Raises
    ------
    CampaignError
        The file cannot be read as a table of this kind.

    References
    ----------
    GB/T 41450-2022, 8.3.2 c, 9.3.2 c.
    """
    path = place.observations_lidar
    gathered: dict[tuple[int, str], list[int]] = {}
    for row in read_lidar_observations(path):
        gathered.setdefault((row.strip, row.target), []).append(row.point)
    known, on_disk = set(targets), set(strips)
    counts: dict[int, int | None] = {}
    found: dict[tuple[int, str], np.ndarray] = {}
    problems: list[CampaignError] = []
    remedy = "the evaluator's own finding takes the place of these picks"
    for (strip, target), numbers in sorted(gathered.items()):
        where = f"{path} target {target} strip {strip}"
        points = np.unique(np.array(numbers, dtype=np.int64))
        if target not in known:
            problems.append(CampaignError("the target is not in the survey", where=where, remedy="correct its name"))
            continue
        if strip not in on_disk:
            problems.append(
                CampaignError("the strip has no LAS file", where=where, expected=place.strip_las(strip).name)
            )
            continue
        if strip not in counts:
            counts[strip] = _point_count(place, strip)
        count = counts[strip]
        if count is None:  # the file is named as unreadable where it is used
            continue
        if points[-1] >= count:
            expected = f"0 to {count - 1}, the records of {place.strip_las(strip).name}"
            problems.append(
                CampaignError(
                    "a point's number is out of range",
                    where=where,
                    got=int(points[-1]),
                    expected=expected,
                    remedy=remedy,
                )
            )
            continue
        found[strip, target] = points
    return found, problems


def _point_count(place: SortieFolder, strip: int) -> int | None:
    try:
        return StripReader(place.strip_las(strip)).point_count
    except TestrangeError:
        return None


def target_points(
    data: CampaignData,
    returns: Mapping[tuple[int, int, str], TargetReturns],
    panels: Sequence[LidarPanelObservation],
    vertices: Sequence[VertexObservation],
) -> PointNumbers:
    """Record numbers of the returns behind every panel's means and every frustum target's vertex.

    Parameters
    ----------
    data : CampaignData
    returns : mapping
        As given to the observers: `VertexObservation.index` counts its rows within the trajectory's time.
    panels, vertices
        What the observers made of them.

    References
    ----------
    GB/T 41450-2022, appendix A.
    """
    found: PointNumbers = {(o.sortie, o.strip, o.panel): np.sort(o.record) for o in panels if o.record.size}
    times = {s.folder.number: s.trajectory.gps_time_s[[0, -1]] for s in data.sorties if s.trajectory is not None}
    for v in vertices:
        rows = returns.get((v.sortie, v.strip, v.target))
        if rows is None or v.index.size == 0 or v.sortie not in times:
            continue
        first, last = times[v.sortie]
        time = rows.returns.gps_time_s
        found[v.sortie, v.strip, v.target] = np.sort(rows.record[(time >= first) & (time <= last)][v.index])
    return dict(sorted(found.items()))


def points_by_person(data: CampaignData, kind: str) -> bool:
    """Whether the campaign brings LiDAR points of a person for any target of one kind."""
    ids = {t.id for t in data.targets if t.kind == kind}
    return any(target in ids for sortie in data.sorties for _, target in sortie.picked_points)
