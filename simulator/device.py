"""The instrument behind the optics: digitiser, and its own online echo detection. Compiled on first use, one waveform a loop turn.

This is the simulated device's code, deliberately simple and quick as firmware is. The evaluator decomposes packets with its own.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numba
import numpy as np
from scipy.special import ndtri

from campaign.config import Lidar
from simulator.radar_equation import FWHM_PER_SIGMA, echo_fwhm_ns


@dataclass(frozen=True, kw_only=True)
class Digitiser:
    """From optical power to whole steps."""

    baseline_dn: float  # zero light, with the mean of the solar background
    noise_dn: float  # standard deviation of detector and amplifier
    shot_noise_dn: float  # added variance: this squared times the light in steps, background included
    background_dn: float
    full_scale_dn: int  # last step


@dataclass(frozen=True, kw_only=True)
class Detector:
    """Settings of the echo detection, all in digitiser steps and samples."""

    baseline_dn: float
    noise_dn: float
    shot_noise_dn: float
    full_scale_dn: int
    threshold_sigma: float
    half_window: int  # samples on each side of a maximum that the fit takes
    echo_sigma: float  # standard deviation of a flat target's echo [samples]
    max_returns: int


@dataclass(frozen=True, kw_only=True)
class DetectedEchoes:
    """n waveforms, up to r echoes each in order of time; rows past `count` hold NaN."""

    count: np.ndarray  # (n,) uint8
    position: np.ndarray  # (n, r) float64: peak, in samples from the packet's first
    amplitude_dn: np.ndarray  # (n, r) float32: peak above the baseline
    sigma: np.ndarray  # (n, r) float32: standard deviation in time [samples]


def digitiser_from(lidar: Lidar) -> Digitiser:
    return Digitiser(
        baseline_dn=lidar.baseline_dn + lidar.solar_background_dn,
        noise_dn=lidar.noise_dn,
        shot_noise_dn=lidar.shot_noise_dn,
        background_dn=lidar.solar_background_dn,
        full_scale_dn=(1 << lidar.bit_depth) - 1,
    )


def detector_from(lidar: Lidar) -> Detector:
    """The device knows its own baseline (it samples before each shot) and noise; a quantised step adds its 1/sqrt(12)."""
    digitiser = digitiser_from(lidar)
    echo_samples = echo_fwhm_ns(lidar.pulse_fwhm_ns, lidar.receiver_fwhm_ns) / lidar.sampling_ns
    variance = digitiser.noise_dn**2 + digitiser.shot_noise_dn**2 * digitiser.background_dn + 1.0 / 12.0
    return Detector(
        baseline_dn=digitiser.baseline_dn,
        noise_dn=float(np.sqrt(variance)),
        shot_noise_dn=digitiser.shot_noise_dn,
        full_scale_dn=digitiser.full_scale_dn,
        threshold_sigma=lidar.threshold_sigma,
        half_window=max(1, round(0.7 * echo_samples)),
        echo_sigma=echo_samples / FWHM_PER_SIGMA,
        max_returns=lidar.max_returns,
    )


def dn_per_w(lidar: Lidar) -> float:
    """Steps per watt of optical power: full-scale power reaches the last step from the baseline. [DN/W]"""
    return ((1 << lidar.bit_depth) - 1 - lidar.baseline_dn) / (lidar.full_scale_power_nw * 1e-9)


@lru_cache(maxsize=1)
def normal_quantiles() -> np.ndarray:
    """(65536,) float32: equally likely values whose pairwise sum is standard normal to 6 standard deviations.

    Noise costs as much as ray casting when every sample draws from the usual generator; two 16-bit numbers and this table are
    five times cheaper, and exact in mean and variance.
    """
    value = ndtri((np.arange(65536) + 0.5) / 65536)
    value *= np.sqrt(0.5 / np.mean(value**2))
    return np.asarray(value, np.float32)


def draw_chance(rng: np.random.Generator, pulses: int, samples: int) -> np.ndarray:
    """(pulses, 2 samples) uniform uint16 for `Device.digitise`."""
    words = rng.bit_generator.random_raw((pulses * samples + 1) // 2)
    return np.asarray(words).astype("<u8", copy=False).view("<u2")[: 2 * pulses * samples].reshape(pulses, 2 * samples)


@numba.njit(cache=True, nogil=True)
def _digitise(
    signal: np.ndarray,
    chance: np.ndarray,
    quantile: np.ndarray,
    gain: np.ndarray,
    levels: np.ndarray,
    out: np.ndarray,
) -> None:
    """`levels`, in single precision: baseline, noise variance, shot noise variance per step, background, full scale."""
    baseline, noise_variance, shot_variance, background, full_scale = levels
    for i in range(signal.shape[0]):
        for k in range(signal.shape[1]):
            light = signal[i, k] * gain[i]
            spread = np.sqrt(noise_variance + shot_variance * (light + background))
            normal = quantile[chance[i, 2 * k]] + quantile[chance[i, 2 * k + 1]]
            value = np.floor(baseline + light + spread * normal + np.float32(0.5))
            out[i, k] = np.uint16(min(max(value, np.float32(0.0)), full_scale))


@numba.njit(cache=True, nogil=True)
def _fit_peak(
    wave: np.ndarray, first: int, last: int, baseline: float, full_scale: int, floor: float
) -> tuple[float, float, float]:
    """Gaussian through samples first..last: a parabola fitted to their logarithms, weighted by the square of the signal.

    Clipped samples and those at the noise floor are left out. Returns position, amplitude, sigma; sigma 0 when the samples
    do not bend downwards or are fewer than three.
    """
    middle = 0.5 * (first + last)
    s0 = s1 = s2 = s3 = s4 = t0 = t1 = t2 = 0.0
    used = 0
    for k in range(first, last + 1):
        y = wave[k] - baseline
        if wave[k] >= full_scale or y <= floor:
            continue
        used += 1
        x = k - middle
        w = y * y
        z = np.log(y)
        wx = w * x
        wxx = wx * x
        s0 += w
        s1 += wx
        s2 += wxx
        s3 += wxx * x
        s4 += wxx * x * x
        t0 += w * z
        t1 += wx * z
        t2 += wxx * z
    if used < 3:
        return middle, 0.0, 0.0
    c00 = s2 * s4 - s3 * s3
    c01 = s2 * s3 - s1 * s4
    c02 = s1 * s3 - s2 * s2
    c11 = s0 * s4 - s2 * s2
    c12 = s1 * s2 - s0 * s3
    c22 = s0 * s2 - s1 * s1
    determinant = s0 * c00 + s1 * c01 + s2 * c02
    if determinant <= 0.0:
        return middle, 0.0, 0.0
    a = (c00 * t0 + c01 * t1 + c02 * t2) / determinant
    b = (c01 * t0 + c11 * t1 + c12 * t2) / determinant
    c = (c02 * t0 + c12 * t1 + c22 * t2) / determinant
    if c >= 0.0:
        return middle, 0.0, 0.0
    x = -0.5 * b / c
    return middle + x, np.exp(a + 0.5 * b * x), np.sqrt(-0.5 / c)


@numba.njit(cache=True, nogil=True)
def _detect(
    waves: np.ndarray,
    baseline: float,
    noise_variance: float,
    shot_variance: float,
    full_scale: int,
    threshold_sigma: float,
    half_window: int,
    echo_sigma: float,
    count: np.ndarray,
    position: np.ndarray,
    amplitude: np.ndarray,
    sigma: np.ndarray,
) -> None:
    """Maxima above the threshold, kept apart only where the valley between them is deeper than the noise allows."""
    samples = waves.shape[1]
    most = position.shape[1]
    floor = np.sqrt(noise_variance)
    threshold = threshold_sigma * floor
    top_at = np.empty(most + 1, np.int64)  # of each maximum
    top_end = np.empty(most + 1, np.int64)  # last sample of its plateau
    left = np.empty(most + 1, np.int64)  # lowest sample before it
    for i in range(waves.shape[0]):
        wave = waves[i]
        # ---- maxima: the signal must fall, and rise again, by threshold_sigma of its own noise ----
        found = 0
        rising = True
        best = end = low = 0
        for k in range(1, samples):
            if rising:
                if wave[k] > wave[best]:
                    best = end = k
                elif wave[k] == wave[best]:
                    if wave[k] >= full_scale or end == k - 1:
                        end = k
                else:
                    y = wave[best] - baseline
                    step = threshold_sigma * np.sqrt(noise_variance + shot_variance * max(y, 0.0))
                    if y < threshold:
                        if wave[k] < wave[low]:
                            low = k
                            best = end = k
                    elif wave[best] - wave[k] >= min(step, 0.5 * y):
                        if found <= most and best > 0:
                            top_at[found], top_end[found], left[found] = best, end, low
                            found += 1
                        if found > most:
                            break
                        rising = False
                        low = k
            elif wave[k] <= wave[low]:
                low = k
            else:
                y = wave[k] - baseline
                step = threshold_sigma * np.sqrt(noise_variance + shot_variance * max(y, 0.0))
                if wave[k] - wave[low] >= step:
                    rising = True
                    best = end = k
        # ---- position, amplitude and width of each ----
        kept = 0
        for j in range(min(found, most)):
            saturated = wave[top_at[j]] >= full_scale
            # a neighbour pulls the fit towards itself: stay within half the way to the valley between them
            reach = half_window + (2 if saturated else 0)
            if j > 0:
                reach = min(reach, max(1, (top_at[j] - left[j]) // 2))
            if j + 1 < found:
                reach = min(reach, max(1, (left[j + 1] - top_end[j]) // 2))
            first = max(top_at[j] - reach, 0)
            last = min(top_end[j] + reach, samples - 1)
            mean, height, width = _fit_peak(wave, first, last, baseline, full_scale, floor)
            if width == 0.0 or abs(mean - 0.5 * (top_at[j] + top_end[j])) > 1.5 + 0.5 * (top_end[j] - top_at[j]):
                mean = 0.5 * (top_at[j] + top_end[j])
                height = wave[top_at[j]] - baseline
                width = echo_sigma
            position[i, kept] = mean
            amplitude[i, kept] = height
            sigma[i, kept] = width
            kept += 1
        count[i] = kept


class Device:
    """Digitise and detect blocks of waveforms on a few threads; each waveform's result depends on itself alone."""

    def __init__(self, lidar: Lidar, threads: int = 2) -> None:
        self._digitiser = digitiser_from(lidar)
        self._detector = detector_from(lidar)
        self._pool = ThreadPoolExecutor(max_workers=threads)
        self._threads = threads

    def _parts(self, n: int) -> list[slice]:
        edges = np.linspace(0, n, self._threads + 1).astype(int)
        return [slice(a, b) for a, b in pairwise(edges) if b > a]

    def digitise(self, signal_dn: np.ndarray, chance: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """Light to steps: shot and amplifier noise, baseline, rounding, saturation.

        Parameters
        ----------
        signal_dn : (n, samples) ndarray, float32
            Light without noise, as steps above the baseline. [DN]
        chance : (n, 2 samples) ndarray, uint16
            Uniform; a sample's normal deviate is the sum of two quantiles, see `normal_quantiles`.
        gain : (n,) ndarray
            Factor on the light of each pulse.

        Returns
        -------
        (n, samples) ndarray, uint16
            [DN]
        """
        d = self._digitiser
        out = np.empty(signal_dn.shape, np.uint16)
        gain = gain.astype(np.float32)
        quantile = normal_quantiles()
        levels = np.array(
            [d.baseline_dn, d.noise_dn**2, d.shot_noise_dn**2, d.background_dn, d.full_scale_dn], np.float32
        )

        def run(part: slice) -> None:
            _digitise(
                signal_dn[part],
                chance[part],
                quantile,
                gain[part],
                levels,
                out[part],
            )

        list(self._pool.map(run, self._parts(len(out))))
        return out

    def detect(self, waves: np.ndarray) -> DetectedEchoes:
        """(n, samples) uint16 packets to echoes.

        Saturated samples are left out of the fit, which then rests on the flanks.
        """
        d, n = self._detector, len(waves)
        count = np.zeros(n, np.uint8)
        position = np.full((n, d.max_returns), np.nan)
        amplitude, sigma = (np.full((n, d.max_returns), np.nan, np.float32) for _ in range(2))

        def run(part: slice) -> None:
            _detect(
                waves[part],
                d.baseline_dn,
                d.noise_dn**2,
                d.shot_noise_dn**2,
                d.full_scale_dn,
                d.threshold_sigma,
                d.half_window,
                d.echo_sigma,
                count[part],
                position[part],
                amplitude[part],
                sigma[part],
            )

        list(self._pool.map(run, self._parts(n)))
        return DetectedEchoes(count=count, position=position, amplitude_dn=amplitude, sigma=sigma)

    def close(self) -> None:
        """Ends the threads."""
        self._pool.shutdown()
