"""How far the ranges of a decomposition's echoes lie from the truth of a simulated campaign: flat panels, single returns.

Opens truth/ as `score` does. The measured range of a return is moved by what its echo's centre differs from the return's place
in the packet; the truth is the geometric range with the range errors that were injected.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from campaign.flight.las import Returns, StripReader
from campaign.folder import CampaignFolder
from campaign.truth import read_true_returns, read_truth
from evaluator.algorithms.slots import AlgorithmFailure, EchoTask, FoundEchoes
from evaluator.frames import WorldFrame
from evaluator.georeference import concatenate_returns, lidar_points, select_returns
from evaluator.load import load_campaign
from evaluator.observe.panels import nearest_echo

_MOST_PACKETS = 2000  # of a strip, evenly spread over those that qualify
_METRES_PER_NS = 0.149896229  # light there and back


@dataclass(frozen=True, kw_only=True)
class EchoErrors:
    """One row a packet."""

    strip: np.ndarray  # (n, 2) int64 sortie, strip
    record: np.ndarray  # (n,) int64 row of the strip's LAS file
    error_m: np.ndarray  # (n,) range minus truth; NaN: no echo near the return's place, or none at all
    echoes: np.ndarray  # (n,) int64 echoes found in the packet, of which one is right
    decomposed: np.ndarray  # (n,) bool: the algorithm gave an answer for this strip


def echo_errors(root: Path, decompose: Callable[[EchoTask], FoundEchoes]) -> EchoErrors | None:
    """Range errors on the panels of every strip; None where the campaign has no truth/, no waveforms or no panel in a strip.

    Parameters
    ----------
    root : Path
    decompose : callable
        The algorithm of the slot `echo_decomposition`, as `guard` gives it.
    """
    folder = CampaignFolder(root)
    if not folder.truth.is_dir():
        return None
    data, truth = load_campaign(root), read_truth(root)
    if data.rig is None or data.lidar is None:
        return None
    frame = WorldFrame(data.manifest)
    panels = np.array([t.kind == "panel" for t in truth.targets] + [False])  # the last: -1, the ground
    parts: list[EchoErrors] = []
    for sortie in data.sorties:
        for strip in sortie.strips:
            path = folder.truth / f"returns_{sortie.folder.number:02d}_{strip:02d}.npz"
            if sortie.trajectory is None or not path.is_file():
                continue
            true = read_true_returns(folder.held(path))
            on_panel = panels[np.clip(true.target, -1, len(truth.targets) - 1)] & np.isfinite(true.range_m)
            reader = StripReader(sortie.folder.strip_las(strip), gps_week=data.manifest.gps_week)
            record, rows = _chosen(reader, on_panel)
            if rows is None:
                continue
            points = lidar_points(rows.xyz_m, rows.gps_time_s, sortie.trajectory, data.rig, frame)
            expected = true.range_m[record] * (1.0 + truth.range_scale) + truth.range_offset_m
            numbers, row = np.unique(rows.packet, return_inverse=True)
            task = EchoTask(
                samples_dn=np.asarray(reader.waveforms(numbers), dtype=np.float64),
                sampling_ns=reader.sampling_ps / 1000.0,
                echo_fwhm_ns=data.lidar.echo_fwhm_ns,
                saturation_dn=2.0**data.lidar.bit_depth - 1.0,
            )
            error, count, answered = np.full(record.size, np.nan), np.zeros(record.size, np.int64), True
            try:
                found = decompose(task)
            except AlgorithmFailure:
                answered = False
            else:
                location = rows.return_location_ps / 1000.0
                near = nearest_echo(found, row, location, data.lidar.echo_fwhm_ns)
                hit = near >= 0
                moved = (found.centre_ns[near[hit]] - location[hit]) * _METRES_PER_NS
                error[hit] = np.linalg.norm(points[hit], axis=1) + moved - expected[hit]
                count = np.bincount(found.packet, minlength=numbers.size)[row]
            key = np.tile([sortie.folder.number, strip], (record.size, 1)).astype(np.int64)
            parts.append(
                EchoErrors(
                    strip=key, record=record, error_m=error, echoes=count, decomposed=np.full(record.size, answered)
                )
            )
    if not parts:
        return None
    return EchoErrors(
        **{
            name: np.concatenate([getattr(p, name) for p in parts])
            for name in ("strip", "record", "error_m", "echoes", "decomposed")
        }
    )


def _chosen(reader: StripReader, on_panel: np.ndarray) -> tuple[np.ndarray, Returns | None]:
    """Records (n,) and rows of single returns on panels that have a packet, at most `_MOST_PACKETS`, evenly spread."""
    records, parts = [], []
    for first, chunk in reader.chunks():
        last = first + len(chunk.xyz_m)
        if last > len(on_panel):  # not this strip's table
            break
        index = np.flatnonzero(on_panel[first:last] & (chunk.packet >= 0) & (chunk.number_of_returns <= 1))
        records.append(first + index)
        parts.append(select_returns(chunk, index))
    count = sum(r.size for r in records)
    if count == 0:
        return np.empty(0, np.int64), None
    keep = np.unique(np.linspace(0, count - 1, min(count, _MOST_PACKETS)).astype(np.int64))
    return np.concatenate(records)[keep].astype(np.int64), select_returns(concatenate_returns(parts), keep)
