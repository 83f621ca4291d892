"""Echoes in waveforms by peak detection and by deconvolution: two algorithms for the slot `echo_decomposition`.

The evaluator's own, a sum of Gaussians, is `observe.waveforms`.
"""

import numpy as np

from evaluator.algorithms.slots import EchoTask, FoundEchoes

_FWHM_PER_SIGMA = 2.0 * np.sqrt(2.0 * np.log(2.0))
_SIGMAS = 5.0  # of the noise, for a peak to count
_ITERATIONS = 60
_LEAST_SHARE = 0.05  # of the packet's greatest echo


def _levelled(task: EchoTask) -> tuple[np.ndarray, np.ndarray, float]:
    """Packets (p, s) above their baseline, zero where there is no sample; baselines (p,); noise of a sample. [DN]"""
    samples = np.asarray(task.samples_dn, dtype=np.float64)
    known = np.isfinite(samples)
    baseline = np.array([np.median(row[k]) if k.any() else np.nan for row, k in zip(samples, known, strict=True)])
    above = np.where(known, samples - baseline[:, None], 0.0)
    # quiet samples are those below the median; their spread is free of echoes
    below = above[known & (above < 0.0)]
    noise = float(np.sqrt(np.mean(below**2))) if below.size else 1.0
    return above, baseline, max(noise, 1e-9)


def peaks(task: EchoTask, /) -> FoundEchoes:
    """Local maxima above five times the noise, each refined by the parabola through its three samples.

    With the samples y-, y0, y+ about a maximum the parabola's top lies at d = (y- - y+) / (2 (y- - 2 y0 + y+)) samples and
    has the height y0 - (y- - y+) d / 4. For a Gaussian this is biased towards the sample, and lower than its top. Of a clipped
    echo, whose top is flat, the middle is taken.

    References
    ----------
    Wagner, Ullrich, Melzer, Briese, Kraus (2004), From single-pulse to full-waveform airborne laser scanners: potential and
    practical challenges, Int. Archives of Photogrammetry 35(B3), 201-206: maximum as detector.
    """
    above, baseline, noise = _levelled(task)
    left, middle, right = above[:, :-2], above[:, 1:-1], above[:, 2:]
    packet, at = np.nonzero((middle > left) & (middle >= right) & (middle > _SIGMAS * noise))
    at = at + 1
    last = at.copy()  # of the equal samples that begin at the maximum: a clipped echo has a flat top
    for _ in range(above.shape[1]):
        more = (last + 1 < above.shape[1]) & (
            above[packet, np.minimum(last + 1, above.shape[1] - 1)] == above[packet, at]
        )
        if not more.any():
            break
        last += more
    low, top, high = above[packet, at - 1], above[packet, at], above[packet, np.minimum(at + 1, above.shape[1] - 1)]
    curve = low - 2.0 * top + high
    shift = np.where(last > at, 0.5 * (last - at), 0.5 * (low - high) / np.where(curve < 0.0, curve, -1.0))
    return FoundEchoes(
        packet=packet,
        amplitude_dn=np.where(last > at, top, top - 0.25 * (low - high) * shift),
        centre_ns=(at + shift) * task.sampling_ns,
        baseline_dn=baseline,
    )


def richardson_lucy(task: EchoTask, /) -> FoundEchoes:
    r"""Deconvolution by the width of a flat target's echo, then the centre of gravity of every blob that is left.

    .. math:: x_{k+1} = x_k \cdot \left( g^T * \frac{y}{g * x_k} \right)

    with the echo's shape g of sum 1. An echo's amplitude is the blob's sum times the greatest value of g: right where the echo
    has that shape, too high where it is wider.

    References
    ----------
    Richardson (1972), J. Opt. Soc. Am. 62(1), 55-59, doi:10.1364/JOSA.62.000055; Lucy (1974), Astron. J. 79, 745-754,
    doi:10.1086/111605; for waveforms of laser scanners Wu, van Aardt, Asner (2011), IEEE Trans. Geosci. Remote Sens. 49(6),
    2402-2414, doi:10.1109/TGRS.2010.2103080.
    """
    above, baseline, noise = _levelled(task)
    sigma = task.echo_fwhm_ns / _FWHM_PER_SIGMA / task.sampling_ns
    index = np.arange(above.shape[1])
    blur = np.exp(-0.5 * ((index[:, None] - index[None, :]) / sigma) ** 2)  # column j: an echo at sample j
    blur /= np.sqrt(2.0 * np.pi) * sigma
    signal = np.maximum(above, 0.0)
    estimate = np.repeat(signal.mean(axis=1, keepdims=True), signal.shape[1], axis=1)
    for _ in range(_ITERATIONS):
        ratio = signal / np.maximum(estimate @ blur, 1e-3 * noise)  # the blur is symmetric: its own transpose
        estimate = estimate * (ratio @ blur)
    first = np.zeros(estimate.shape, dtype=bool)  # samples at which a blob begins: behind each local minimum
    first[:, 0] = True
    first[:, 1:-1] |= (estimate[:, 1:-1] <= estimate[:, :-2]) & (estimate[:, 1:-1] < estimate[:, 2:])
    blob = np.cumsum(first.ravel()) - 1
    total = np.bincount(blob, weights=estimate.ravel())
    place = np.bincount(blob, weights=(estimate * index).ravel()) / np.maximum(total, 1e-300)
    packet = np.flatnonzero(first) // estimate.shape[1]
    height = total * blur[0, 0]
    keep = height > np.maximum(_SIGMAS * noise, _LEAST_SHARE * above.max(axis=1)[packet])
    return FoundEchoes(
        packet=packet[keep],
        amplitude_dn=height[keep],
        centre_ns=place[keep] * task.sampling_ns,
        baseline_dn=baseline,
    )
