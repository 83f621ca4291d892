"""Received waveforms with their decomposition, one for each reflectance class: pictures for the report, no measurement."""

from collections.abc import Mapping

import numpy as np

from campaign.flight.las import StripReader
from evaluator.algorithms.record import OWN_TOOLS, Tools
from evaluator.algorithms.slots import AlgorithmFailure, EchoTask
from evaluator.georeference import TargetReturns
from evaluator.model import CampaignData
from evaluator.observe.panels import LidarPanelObservation
from evaluator.observe.waveforms import FWHM_PER_SIGMA
from evaluator.results import WaveformExample

_FINE = 8  # points of the drawn fit a sample


def waveform_examples(
    data: CampaignData,
    returns: Mapping[tuple[int, int, str], TargetReturns],
    observations: list[LidarPanelObservation],
    tools: Tools = OWN_TOOLS,
) -> list[WaveformExample]:
    """The packet nearest to the panel's mean amplitude, of the first panel of each nominal class that has waveforms."""
    nominal = {t.id: t.nominal_reflectance_percent for t in data.targets if t.kind == "panel"}
    folders = {s.folder.number: s.folder for s in data.sorties}
    found: dict[float, WaveformExample] = {}
    for o in observations:
        level = nominal.get(o.panel)
        if level is None or level in found or not o.from_waveform or data.lidar is None:
            continue
        near = returns[o.sortie, o.strip, o.panel]
        rows = near.returns
        with_packet = np.flatnonzero((rows.packet >= 0) & (rows.number_of_returns == 1))
        if with_packet.size == 0:
            continue
        row = with_packet[np.argmin(np.abs(rows.amplitude[with_packet] - o.amplitude_dn))]
        reader = near.reader or StripReader(folders[o.sortie].strip_las(o.strip))
        sampling_ns = reader.sampling_ps / 1000.0
        samples = reader.waveforms(rows.packet[row : row + 1])[0].astype(np.float64)
        width = data.lidar.echo_fwhm_ns
        task = EchoTask(
            samples_dn=samples[None], sampling_ns=sampling_ns, echo_fwhm_ns=width, saturation_dn=float("inf")
        )
        try:
            echoes = tools.echo_decomposition(task)
        except AlgorithmFailure:
            continue
        base = np.median(samples) if echoes.baseline_dn is None else echoes.baseline_dn[0]
        widths = np.full(echoes.centre_ns.size, np.nan) if echoes.fwhm_ns is None else echoes.fwhm_ns
        time = np.arange(samples.size) * sampling_ns
        fine = np.arange(samples.size * _FINE) * (sampling_ns / _FINE)
        fit = np.full(fine.size, base)
        for amplitude, centre, fwhm in zip(echoes.amplitude_dn, echoes.centre_ns, widths, strict=True):
            fwhm = fwhm if np.isfinite(fwhm) else width
            fit += amplitude * np.exp(-0.5 * ((fine - centre) * FWHM_PER_SIGMA / fwhm) ** 2)
        found[level] = WaveformExample(
            label=f"{o.panel}, {level:g} %",
            nominal_percent=level,
            time_ns=time,
            samples_dn=samples,
            fit_time_ns=fine,
            fit_dn=fit,
        )
    return [found[level] for level in sorted(found)]
