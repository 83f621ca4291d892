"""Echoes in waveform packets: the empirical model waveform decomposition of 8.1.2 e.

A packet is a baseline plus a sum of Gaussians. This module estimates baseline and noise, runs the compiled fits
(`gaussians/`) and returns amplitude, centre and width of every echo with their standard deviations. It does not open
files and does not know panels.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from campaign.threads import thread_count
from evaluator.model import EvaluationError

FWHM_PER_SIGMA = 2.0 * np.sqrt(2.0 * np.log(2.0))
_BLOCK = 512  # packets a task; results do not depend on it
_NOISE_SAMPLE = 4096  # packets from which the noise model is estimated, evenly spread
_ENOUGH_SINGLE = 400  # packets with one echo, of these, that are enough for it


@dataclass(frozen=True, kw_only=True)
class NoiseModel:
    """Variance of a sample that carries the signal s above the baseline, under an echo of amplitude A:
    noise^2 + shot s + (shape A)^2."""

    noise_dn: float  # of a quiet sample [DN]
    shot_dn2_per_dn: float = 0.0  # photon noise: variance per DN of signal [DN]
    shape_error: float = 0.0  # relative departure of the real pulse from a Gaussian


@dataclass(frozen=True, kw_only=True)
class Echoes:
    """m echoes of p packets, in the order of the packets and of time."""

    packet: np.ndarray  # (m,) int64 index into the packets given
    amplitude_dn: np.ndarray  # (m,) peak above the baseline
    centre_ns: np.ndarray  # (m,) after the packet's first sample
    fwhm_ns: np.ndarray  # (m,)
    amplitude_std_dn: np.ndarray  # (m,) from the covariance of the fit
    centre_std_ns: np.ndarray  # (m,)
    fwhm_std_ns: np.ndarray  # (m,)
    chi2: np.ndarray  # (m,) reduced chi-square of the packet's fit
    significance: np.ndarray  # (m,) square root of the chi-square lost without this echo, the others fitted again
    packet_baseline_dn: np.ndarray  # (p,) NaN where a packet has too few samples
    packet_chi2: np.ndarray  # (p,) reduced
    packet_rms_dn: np.ndarray  # (p,) residual of the samples used
    noise: NoiseModel


def decompose(
    packets: np.ndarray,
    sampling_ns: float,
    baseline_dn: float | None = None,
    noise_dn: float | None = None,
    echo_fwhm_ns: float = 4.0,
    *,
    shot_dn2_per_dn: float | None = None,
    shape_error: float | None = None,
    saturation_dn: float | None = None,
    least_chi2: float = 30.0,
    least_separation: float = 0.3,
    width_limits: tuple[float, float] = (0.7, 5.0),
    max_echoes: int = 6,
    threads: int | None = None,
) -> Echoes:
    r"""Decompose waveform packets into Gaussian echoes.

    .. math:: y(t) = b + \sum_j A_j \exp\left(-\frac{(t - \mu_j)^2}{2 \sigma_j^2}\right)

    Blind peaks (second derivative of the smoothed packet, above 4.5 sigma) start a Levenberg-Marquardt fit with the
    analytic Jacobian, weighted by the noise model. An echo stays only where taking it out (and fitting the others again)
    raises chi-square by `least_chi2`; one is added, at the greatest residual or by splitting an echo, by the same rule.

    Parameters
    ----------
    packets : (p, s) array_like
        Samples. NaN: no such sample (packets of unequal length). [DN]
    sampling_ns : float
        Interval of the samples. [ns]
    baseline_dn : float, optional
        Level without signal when it is known exactly; otherwise it is estimated from each packet's quiet samples and
        then is one more unknown of the fit. [DN]
    noise_dn : float, optional
        Standard deviation of a quiet sample; estimated (median over the packets) when absent. [DN]
    echo_fwhm_ns : float
        Width of the echo of a flat target, from the data sheet: start value and scale of the limits. [ns]
    shot_dn2_per_dn, shape_error : float, optional
        Noise that grows with the signal, see `NoiseModel`; estimated when absent, from packets with one echo where there
        are some hundreds, else from the strongest echoes.
    saturation_dn : float, optional
        Samples at or above this are not used. [DN]
    least_chi2 : float
        Chi-square that an echo (three parameters) must explain. 30 is exceeded by noise once in a million places.
    least_separation : float
        Echoes closer than this share of `echo_fwhm_ns` are one echo of another shape, not two surfaces.
    width_limits : (float, float)
        Least and greatest width of an echo over `echo_fwhm_ns`.
    max_echoes : int
        At most this many echoes a packet, 1 to 8.
    threads : int, optional
        Number of threads; the result does not depend on it.

    Returns
    -------
    Echoes

    References
    ----------
    GB/T 41450-2022, 8.1.2 e. Wagner et al. (2006), ISPRS J. 60(2), 100-112, doi:10.1016/j.isprsjprs.2005.12.001.
    """
    from evaluator.observe.gaussians.fit import MAX_ECHOES  # numba loads only where packets are fitted
    from evaluator.observe.gaussians.quiet_level import quiet_level
    from evaluator.observe.gaussians.search import decompose_packets

    data = np.ascontiguousarray(np.asarray(packets, dtype=np.float64))
    if data.ndim != 2:
        raise EvaluationError(
            "waveform packets must be a table", got=f"{data.ndim} dimensions", expected="(packets, samples)"
        )
    for name, value in (("sampling_ns", sampling_ns), ("echo_fwhm_ns", echo_fwhm_ns)):
        if not (np.isfinite(value) and value > 0.0):
            raise EvaluationError(f"{name} is not a positive number", got=value)
    if not 1 <= max_echoes <= MAX_ECHOES:
        raise EvaluationError("max_echoes is out of range", got=max_echoes, expected=f"1 to {MAX_ECHOES}")
    if np.isinf(data).any():
        raise EvaluationError("a waveform sample is infinite", expected="finite samples, NaN for none")
    p = data.shape[0]
    s0 = echo_fwhm_ns / FWHM_PER_SIGMA / sampling_ns
    pool_size = threads or thread_count()

    level, spread = np.full(p, np.nan), np.full(p, np.nan)
    blocks = [slice(i, min(i + _BLOCK, p)) for i in range(0, p, _BLOCK)]
    with ThreadPoolExecutor(max_workers=pool_size) as pool:
        list(pool.map(lambda b: quiet_level(data[b], level[b], spread[b]), blocks))
        if baseline_dn is not None:
            level = np.where(np.isnan(level), np.nan, float(baseline_dn))
        noise_given = noise_dn
        if noise_dn is None:
            noise_dn = float(np.nanmedian(spread)) if np.isfinite(spread).any() else 1.0
        if not (np.isfinite(noise_dn) and noise_dn > 0.0):
            raise EvaluationError("noise_dn is not a positive number", got=noise_dn)

        def fit(
            rows: np.ndarray, start: np.ndarray, noise: NoiseModel, moments: np.ndarray, may_grow: bool
        ) -> tuple[np.ndarray, ...]:
            count = rows.shape[0]
            found = np.full((count, MAX_ECHOES, 7), np.nan)
            counts, summary = np.zeros(count, dtype=np.int64), np.full((count, 4), np.nan)
            width = np.array(width_limits, dtype=np.float64)

            def task(block: slice) -> None:
                decompose_packets(
                    rows[block],
                    start[block],
                    int(baseline_dn is None),
                    noise.noise_dn,
                    noise.shot_dn2_per_dn,
                    noise.shape_error,
                    np.inf if saturation_dn is None else float(saturation_dn),
                    s0,
                    width,
                    float(least_chi2),
                    may_grow,
                    float(least_separation) * FWHM_PER_SIGMA,
                    max_echoes,
                    found[block],
                    counts[block],
                    summary[block],
                    moments[block],
                )

            list(pool.map(task, [slice(i, min(i + _BLOCK, count)) for i in range(0, count, _BLOCK)]))
            return found, counts, summary

        noise = NoiseModel(noise_dn=noise_dn, shot_dn2_per_dn=shot_dn2_per_dn or 0.0, shape_error=shape_error or 0.0)
        if p and (shot_dn2_per_dn is None or shape_error is None or noise_given is None):
            chosen = np.unique(np.linspace(0, p - 1, min(p, _NOISE_SAMPLE)).astype(np.int64))
            sample = np.ascontiguousarray(data[chosen])
            for _ in range(2):  # the second round fits with the weights that the first one found
                moments = np.zeros((chosen.size, 8))
                fit(sample, level[chosen], noise, moments, False)
                noise = _noise_model(_telling(moments, s0), noise.noise_dn, noise_given, shot_dn2_per_dn, shape_error)
        found, counts, summary = fit(data, level, noise, np.empty((0, 8)), True)
    return _collect(found, counts, summary, sampling_ns, noise)


def model_packets(echoes: Echoes, sampling_ns: float, samples: int) -> np.ndarray:
    """The fitted packets, (p, samples) [DN]; NaN where a packet had no baseline."""
    model = np.repeat(echoes.packet_baseline_dn[:, None], samples, axis=1)
    t = np.arange(samples) * sampling_ns
    z = (t[None, :] - echoes.centre_ns[:, None]) / (echoes.fwhm_ns[:, None] / FWHM_PER_SIGMA)
    np.add.at(model, echoes.packet, echoes.amplitude_dn[:, None] * np.exp(-0.5 * z * z))
    return model


def _telling(moments: np.ndarray, s0: float) -> np.ndarray:
    """Rows of packets with one echo; where these are few, also of the strongest echoes among others.

    Only echoes as wide as a flat target's, so that two surfaces in one echo are not taken for noise.
    """
    flat = np.abs(moments[:, 6] / s0 - 1.0) < 0.1
    single = flat & (moments[:, 7] == 1.0)
    return moments[single if single.sum() >= _ENOUGH_SINGLE else flat]


def _noise_model(
    moments: np.ndarray, noise_dn: float, noise_given: float | None, shot: float | None, shape: float | None
) -> NoiseModel:
    """Noise, and how it grows with the signal, from the residuals of echoes that stand alone (`gaussians.noise`, moments).

    Mean squares under the echo are compared over amplitude: photon noise grows with it, the error of the shape with its
    square. Medians over packets of alike amplitude, so that a few packets with a hidden second surface do not count.
    """
    quiet = moments[:, 4].sum()
    if noise_given is None and quiet >= 1000:
        noise_dn = float(np.sqrt(moments[:, 3].sum() / quiet))
    used = (moments[:, 2] >= 4) & (moments[:, 5] > 5.0 * noise_dn)
    if used.sum() < 50 or (shot is not None and shape is not None):
        return NoiseModel(noise_dn=noise_dn, shot_dn2_per_dn=shot or 0.0, shape_error=shape or 0.0)
    order = np.argsort(moments[used, 5], kind="stable")
    signal_of, square_of, amplitude_of, samples_of = (
        moments[used, 0] / moments[used, 2],
        moments[used, 1] / moments[used, 2],
        moments[used, 5],
        moments[used, 2],
    )
    classes = np.array_split(order, min(24, order.size // 25))
    signal = np.array([np.median(signal_of[c]) for c in classes])
    peak = np.array([np.median(amplitude_of[c]) for c in classes])
    freedom = np.array([np.median(samples_of[c]) for c in classes])
    # The median of a mean of m squares lies below its expectation by (1 - 2/(9 m))^3 (Wilson and Hilferty).
    variance = np.array([np.median(square_of[c]) for c in classes]) / (1.0 - 2.0 / (9.0 * freedom)) ** 3
    known = noise_dn**2 + (shot or 0.0) * signal + ((shape or 0.0) * peak) ** 2
    columns = np.stack(([signal] if shot is None else []) + ([peak**2] if shape is None else []), axis=1)
    weight = 1.0 / variance.clip(0.1 * noise_dn**2)
    solution = np.zeros(columns.shape[1])
    for _ in range(4):  # relative weights, found again from the fit: the median of a class is itself noisy
        solution, _ = nnls(columns * weight[:, None], (variance - known) * weight)
        weight = 1.0 / (known + columns @ solution)
    values = iter(solution)
    return NoiseModel(
        noise_dn=noise_dn,
        shot_dn2_per_dn=float(next(values)) if shot is None else shot,
        shape_error=float(np.sqrt(next(values))) if shape is None else shape,
    )


def _collect(
    found: np.ndarray, counts: np.ndarray, summary: np.ndarray, sampling_ns: float, noise: NoiseModel
) -> Echoes:
    """Flat arrays in physical units, sorted by packet and time."""
    packet, slot = np.nonzero(np.arange(found.shape[1])[None, :] < counts[:, None])
    rows = found[packet, slot]
    order = np.lexsort((rows[:, 1], packet))
    packet, rows = packet[order], rows[order]
    with np.errstate(invalid="ignore", divide="ignore"):
        reduced = np.where(summary[:, 2] > 0, summary[:, 1] / summary[:, 2], np.nan)
    return Echoes(
        packet=packet.astype(np.int64),
        amplitude_dn=rows[:, 0],
        centre_ns=rows[:, 1] * sampling_ns,
        fwhm_ns=rows[:, 2] * (FWHM_PER_SIGMA * sampling_ns),
        amplitude_std_dn=rows[:, 3],
        centre_std_ns=rows[:, 4] * sampling_ns,
        fwhm_std_ns=rows[:, 5] * (FWHM_PER_SIGMA * sampling_ns),
        chi2=reduced[packet],
        significance=np.sqrt(np.maximum(rows[:, 6], 0.0)),
        packet_baseline_dn=summary[:, 0],
        packet_chi2=reduced,
        packet_rms_dn=summary[:, 3],
        noise=noise,
    )
