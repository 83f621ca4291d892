"""Echoes to samples: Gaussians added up, noise, whole steps. Noise is a pure function of a key and of a sample's place."""

import math

import numba
import numpy as np

from simulator.normals import normal_stream

REACH = 6.0  # an echo is cut at this many standard deviations: 1.5e-8 of its peak
PULSE_DEVIATES = 3  # normal numbers that a pulse takes beside its samples'


@numba.njit(cache=True, nogil=True)
def words_of(samples: int) -> int:
    """Words of the stream that a pulse takes: its samples' and its own deviates', each from a new word on."""
    return (samples + 1) // 2 + (PULSE_DEVIATES + 1) // 2


@numba.njit(cache=True, nogil=True)
def pulse_deviates(key: np.uint64, first: int, samples: int, out: np.ndarray) -> None:
    """(3, n): a pulse's own deviates follow its samples' in the stream."""
    few, words = np.empty(PULSE_DEVIATES, np.float32), np.empty(PULSE_DEVIATES, np.uint64)
    sums = words.view(np.int32)
    for i in range(out.shape[1]):
        normal_stream(key, np.uint64((first + i) * words_of(samples) + (samples + 1) // 2), words, sums, few)
        for k in range(PULSE_DEVIATES):
            out[k, i] = few[k]


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def steps(light: np.ndarray, normal: np.ndarray, levels: np.ndarray, out: np.ndarray) -> None:
    """One waveform's light to whole steps. `levels`: baseline, noise variance, shot variance a step, background, full scale."""
    baseline, noise_variance, shot_variance, background, full_scale = levels
    half, dark = baseline + np.float32(0.5), noise_variance + shot_variance * background
    for k in range(len(out)):
        value = half + light[k] + np.sqrt(dark + shot_variance * light[k]) * normal[k]
        value = value if value > np.float32(0.0) else np.float32(0.0)
        value = value if value < full_scale else full_scale
        out[k] = np.uint16(np.int32(value))


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _add_echo(
    light: np.ndarray, x: float, peak: float, sigma: float, power: np.ndarray, bits: np.ndarray, rest: np.ndarray
) -> None:
    """A Gaussian echo at sample x. `power` shows the memory of `bits` (samples,) as float32; `rest` (samples,) is work space."""
    first = max(0, math.floor(x - REACH * sigma))
    part = light[first : max(first, min(len(light), math.ceil(x + REACH * sigma) + 1))]
    height, scale = np.float32(peak), np.float32(math.sqrt(0.5 / math.log(2.0)) / sigma)
    offset = np.float32(first - x)
    for j in range(len(part)):
        t = (offset + np.float32(j)) * scale
        t = t * t
        t = t if t < np.float32(57.0) else np.float32(57.0)
        whole = np.int32(t)
        f = np.float32(whole) - t
        bits[j] = (np.int32(127) - whole) << np.int32(23)
        g = np.float32(1.3333558e-3) + f * np.float32(1.5403530e-4)
        g = np.float32(5.5504109e-2) + f * (np.float32(9.6181291e-3) + f * g)
        rest[j] = np.float32(1.0) + f * (np.float32(0.69314718) + f * (np.float32(0.24022651) + f * g))
    for j in range(len(part)):
        part[j] += height * (power[j] * rest[j])


@numba.njit(cache=True, nogil=True)
def digitise(
    signal: np.ndarray, normal: np.ndarray, gain: np.ndarray, levels: np.ndarray, light: np.ndarray, out: np.ndarray
) -> None:
    for i in range(len(out)):
        for k in range(signal.shape[1]):
            light[k] = signal[i, k] * gain[i]
        steps(light, normal[i], levels, out[i])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sample(
    echo: np.ndarray,
    echo_first: np.ndarray,
    echo_count: np.ndarray,
    near_m: np.ndarray,
    shift_m: np.ndarray,
    gain: np.ndarray,
    clock: np.ndarray,
    pre_samples: int,
    key: np.uint64,
    number: int,
    levels: np.ndarray,
    waves: np.ndarray,
    start: np.ndarray,
) -> None:
    """Packets of n pulses from their echoes; zeros where there is none, for nothing is recorded.

    `levels`: see `steps`. `clock`: samples a metre of range, and the echo's standard deviation as range. `number`: of the first
    pulse in the stream `key`.
    """
    samples = waves.shape[1]
    per_m, pulse_m = clock
    light = np.empty(samples, np.float32)
    normal, words = np.empty(samples, np.float32), np.empty(words_of(samples), np.uint64)
    bits, rest = np.empty(samples, np.int32), np.empty(samples, np.float32)
    power, sums = bits.view(np.float32), words.view(np.int32)
    for i in range(len(waves)):
        if echo_count[i] == 0:
            start[i] = 0
            waves[i, :] = 0
            continue
        # ---- the packet begins a whole number of samples before the nearest echo ----
        begin = max(math.floor((near_m[i] + shift_m[i]) * per_m) - pre_samples, 0.0)
        light[:] = np.float32(0.0)
        for k in range(echo_first[i], echo_first[i] + echo_count[i]):
            long_m = math.sqrt(pulse_m * pulse_m + echo[k, 2])
            x = (echo[k, 1] + shift_m[i]) * per_m - begin
            _add_echo(light, x, gain[i] * echo[k, 0] * pulse_m / long_m, long_m * per_m, power, bits, rest)
        normal_stream(key, np.uint64((number + i) * words_of(samples)), words, sums, normal)
        steps(light, normal, levels, waves[i])
        start[i] = np.int32(begin)
