"""The instrument behind the optics: digitiser, and its own online echo detection.

This is the simulated device's code, deliberately simple and quick as firmware is. The evaluator decomposes packets with its own.
How echoes become samples is `simulator.pulses.sampling`, how samples become echoes `simulator.pulses.detection`.
"""

from dataclasses import dataclass

import numpy as np

from campaign.config import Lidar
from simulator.lidar.footprint import Optics
from simulator.lidar.radar_equation import FWHM_PER_SIGMA, SPEED_OF_LIGHT_M_S, echo_fwhm_ns
from simulator.normals import normal_stream
from simulator.pulses.caster import Seen
from simulator.pulses.detection import detect, tables
from simulator.pulses.sampling import PULSE_DEVIATES, digitise, pulse_deviates, sample


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


def pulse_normals(key: np.uint64, first: int, count: int, samples: int) -> np.ndarray:
    """(3, count) standard normal float32 of pulses first, first + 1, ... beside their `samples` samples' own."""
    out = np.empty((PULSE_DEVIATES, count), np.float32)
    pulse_deviates(key, first, samples, out)
    return out


def normals(key: np.uint64, count: int) -> np.ndarray:
    """(count,) standard normal float32: the first of the stream `key`."""
    out, words = np.empty(count, np.float32), np.empty((count + 1) // 2, np.uint64)
    normal_stream(key, np.uint64(0), words, words.view(np.int32), out)
    return out


class Device:
    """Digitise and detect blocks of waveforms; each waveform's result depends on itself and its number alone."""

    def __init__(self, lidar: Lidar) -> None:
        d, t = digitiser_from(lidar), detector_from(lidar)
        self._samples = lidar.samples
        self._levels = np.array(
            [d.baseline_dn, d.noise_dn**2, d.shot_noise_dn**2, d.background_dn, d.full_scale_dn], np.float32
        )
        setting = np.array([t.baseline_dn, t.noise_dn, t.threshold_sigma * t.noise_dn, t.echo_sigma])
        table = tables(t.baseline_dn, t.noise_dn, t.shot_noise_dn, t.threshold_sigma, t.full_scale_dn)
        self._detection = (setting, table, t.full_scale_dn, t.half_window)
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
        found = self._found(waves)
        for values in (found.position, found.amplitude_dn, found.sigma):
            values[np.arange(self._most) >= found.count[:, None]] = np.nan
        return found

    def _found(self, waves: np.ndarray) -> DetectedEchoes:
        """Echoes; what is past the count is anything."""
        shape = (len(waves), self._most)
        found = DetectedEchoes(
            count=np.empty(len(waves), np.uint8),
            position=np.empty(shape),
            amplitude_dn=np.empty(shape, np.float32),
            sigma=np.empty(shape, np.float32),
        )
        detect(waves, *self._detection, found.count, found.position, found.amplitude_dn, found.sigma)
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
        """Packets of n pulses, the number of each one's first sample on the clock that the emitted pulse starts, and echoes;
        what their rows hold past the count is anything.

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
        return waves, start, self._found(waves)
