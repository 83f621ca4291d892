"""The instrument behind the optics: digitiser, and its own online echo detection. Compiled on first use, one waveform a loop turn.

This is the simulated device's code, deliberately simple and quick as firmware is. The evaluator decomposes packets with its own.
How echoes become samples is `simulator.pulses.sampling`.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np

from campaign.config import Lidar
from simulator.footprint import Optics
from simulator.pulses.caster import Seen
from simulator.pulses.sampling import PULSE_DEVIATES, digitise, normal_stream, pulse_deviates, sample
from simulator.radar_equation import FWHM_PER_SIGMA, SPEED_OF_LIGHT_M_S, echo_fwhm_ns


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


def pulse_normals(key: np.uint64, first: int, count: int, samples: int) -> np.ndarray:
    """(3, count) standard normal float32 of pulses first, first + 1, ... beside their `samples` samples' own."""
    out = np.empty((PULSE_DEVIATES, count), np.float32)
    pulse_deviates(key, first, samples, out)
    return out


def normals(key: np.uint64, count: int) -> np.ndarray:
    """(count,) standard normal float32: the first of the stream `key`."""
    out = np.empty(count, np.float32)
    normal_stream(key, np.uint64(0), out)
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fit_peak(
    wave: np.ndarray, first: int, last: int, baseline: float, logs: np.ndarray, full_scale: int, floor: float
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
        z = logs[wave[k]]
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _find(
    waves: np.ndarray,
    row: int,
    setting: np.ndarray,
    logs: np.ndarray,
    full_scale: int,
    half_window: int,
    top: np.ndarray,
    position: np.ndarray,
    amplitude: np.ndarray,
    sigma: np.ndarray,
) -> int:
    """Maxima above the threshold, kept apart only where the valley between them is deeper than the noise allows.

    `setting`: baseline, noise variance, shot variance a step, threshold in sigma, sigma of a flat target's echo. `top` is work
    space (3, r + 1): each maximum, the last sample of its plateau, the lowest sample before it. Returns how many echoes.
    """
    baseline, noise_variance, shot_variance, threshold_sigma, echo_sigma = setting
    wave = waves[row]
    samples, most = len(wave), position.shape[1]
    floor = math.sqrt(noise_variance)
    threshold = threshold_sigma * floor
    high = math.ceil(baseline + threshold)
    start, stop = 0, samples - 1
    while start < samples and wave[start] < high:
        start += 1
    if start == samples:
        return 0
    while wave[stop] < high:
        stop -= 1
    # ---- maxima: the signal must fall, and rise again, by threshold_sigma of its own noise ----
    found = 0
    rising = True
    best = end = low = start
    for k in range(start + 1, samples):
        here = np.int64(wave[k])
        peak = np.int64(wave[best])
        if rising:
            if here > peak:
                best = end = k
            elif here == peak:
                if here >= full_scale or end == k - 1:
                    end = k
            else:
                y = peak - baseline
                if y < threshold:
                    if k > stop:
                        break
                    if here < wave[low]:
                        low = best = end = k
                elif peak - here >= min(threshold_sigma * math.sqrt(noise_variance + shot_variance * y), 0.5 * y):
                    if found <= most and best > 0:
                        top[0, found], top[1, found], top[2, found] = best, end, low
                        found += 1
                    if found > most or k >= stop:
                        break
                    rising = False
                    low = k
        elif here <= wave[low]:
            low = k
        elif k > stop:
            break
        elif here - np.int64(wave[low]) >= threshold:
            y = max(here - baseline, 0.0)
            if here - np.int64(wave[low]) >= threshold_sigma * math.sqrt(noise_variance + shot_variance * y):
                rising = True
                best = end = k
    # ---- position, amplitude and width of each ----
    kept = min(found, most)
    for j in range(kept):
        saturated = wave[top[0, j]] >= full_scale
        # a neighbour pulls the fit towards itself: stay within half the way to the valley between them
        reach = half_window + (2 if saturated else 0)
        if j > 0:
            reach = min(reach, max(1, (top[0, j] - top[2, j]) // 2))
        if j + 1 < found:
            reach = min(reach, max(1, (top[2, j + 1] - top[1, j]) // 2))
        first = max(top[0, j] - reach, 0)
        last = min(top[1, j] + reach, samples - 1)
        mean, height, width = _fit_peak(wave, first, last, baseline, logs, full_scale, floor)
        middle = 0.5 * (top[0, j] + top[1, j])
        if width == 0.0 or abs(mean - middle) > 1.5 + 0.5 * (top[1, j] - top[0, j]):
            mean, height, width = middle, wave[top[0, j]] - baseline, echo_sigma
        position[row, j] = mean
        amplitude[row, j] = height
        sigma[row, j] = width
    return kept


@numba.njit(cache=True, nogil=True)
def _detect(
    waves: np.ndarray,
    setting: np.ndarray,
    logs: np.ndarray,
    full_scale: int,
    half_window: int,
    count: np.ndarray,
    position: np.ndarray,
    amplitude: np.ndarray,
    sigma: np.ndarray,
) -> None:
    top = np.empty((3, position.shape[1] + 1), np.int64)
    for i in range(len(waves)):
        count[i] = _find(waves, i, setting, logs, full_scale, half_window, top, position, amplitude, sigma)
        for k in range(count[i], position.shape[1]):
            position[i, k] = amplitude[i, k] = sigma[i, k] = np.nan


class Device:
    """Digitise and detect blocks of waveforms; each waveform's result depends on itself and its number alone."""

    def __init__(self, lidar: Lidar) -> None:
        d, t = digitiser_from(lidar), detector_from(lidar)
        self._samples = lidar.samples
        self._levels = np.array(
            [d.baseline_dn, d.noise_dn**2, d.shot_noise_dn**2, d.background_dn, d.full_scale_dn], np.float32
        )
        self._setting = np.array(
            [t.baseline_dn, t.noise_dn**2, t.shot_noise_dn**2, t.threshold_sigma, t.echo_sigma], np.float64
        )
        above = np.maximum(np.arange(d.full_scale_dn + 1) - t.baseline_dn, 1e-9)
        self._fit = (np.log(above), d.full_scale_dn, t.half_window)
        self._most = t.max_returns

    def digitise(self, signal_dn: np.ndarray, normal: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """Light to steps: shot and amplifier noise, baseline, rounding, saturation.

        Parameters
        ----------
        signal_dn : (n, samples) ndarray, float32
            Light without noise, as steps above the baseline. [DN]
        normal : (n, samples) ndarray, float32
            Standard normal deviates.
        gain : (n,) ndarray
            Factor on the light of each pulse.

        Returns
        -------
        (n, samples) ndarray, uint16
            [DN]
        """
        out = np.empty(signal_dn.shape, np.uint16)
        light = np.empty(signal_dn.shape[1], np.float32)
        digitise(signal_dn, normal, gain.astype(np.float32), self._levels, light, out)
        return out

    def detect(self, waves: np.ndarray) -> DetectedEchoes:
        """(n, samples) uint16 packets to echoes.

        Saturated samples are left out of the fit, which then rests on the flanks.
        """
        shape = (len(waves), self._most)
        found = DetectedEchoes(
            count=np.zeros(len(waves), np.uint8),
            position=np.empty(shape),
            amplitude_dn=np.empty(shape, np.float32),
            sigma=np.empty(shape, np.float32),
        )
        _detect(waves, self._setting, *self._fit, found.count, found.position, found.amplitude_dn, found.sigma)
        return found

    def receive(
        self,
        seen: Seen,
        optics: Optics,
        shift_m: np.ndarray,
        gain: np.ndarray,
        key: np.uint64,
        number: int,
    ) -> tuple[np.ndarray, np.ndarray, DetectedEchoes]:
        """Packets of n pulses, the number of each one's first sample on the clock that the emitted pulse starts, and echoes.

        Parameters
        ----------
        seen : Seen
            Echoes of the n pulses before noise.
        optics : Optics
        shift_m : (n,) ndarray
            Apparent lengthening of the range: the device's timing jitter. [m]
        gain : (n,) ndarray
            Factor on the light of each pulse.
        key : uint64
            Of the stream of noise.
        number : int
            Of the first pulse in that stream.
        """
        n, step_m = len(gain), 0.5e-9 * SPEED_OF_LIGHT_M_S * optics.sampling_ns
        waves, start = np.empty((n, self._samples), np.uint16), np.empty(n, np.int32)
        sample(
            seen.echo,
            seen.first,
            seen.count,
            np.ascontiguousarray(seen.extent_m[:, 1]),
            shift_m,
            gain,
            np.array([1.0 / step_m, step_m * optics.echo_sigma_ns / optics.sampling_ns]),
            optics.pre_samples,
            key,
            number,
            self._levels,
            waves,
            start,
        )
        return waves, start, self.detect(waves)
