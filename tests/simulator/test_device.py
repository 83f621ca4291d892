"""Digitiser and the instrument's own echo detection, on synthetic waveforms."""

import numpy as np
import pytest

from campaign.config import Lidar
from simulator.lidar.device import Device, detector_from, normals, pulse_normals
from simulator.lidar.radar_equation import FWHM_PER_SIGMA, echo_fwhm_ns

LIDAR = Lidar()
FWHM = echo_fwhm_ns(LIDAR.pulse_fwhm_ns, LIDAR.receiver_fwhm_ns) / LIDAR.sampling_ns
SIGMA = FWHM / FWHM_PER_SIGMA
TIME = np.arange(LIDAR.samples)
STEP_MM = 149.896  # half the way of light in one sample


@pytest.fixture(scope="module")
def device() -> Device:
    return Device(LIDAR)


def gaussian(centre: np.ndarray, amplitude: np.ndarray | float, sigma: float = SIGMA) -> np.ndarray:
    peak = np.broadcast_to(np.asarray(amplitude, float), centre.shape)[:, None]
    return (peak * np.exp(-0.5 * ((TIME - centre[:, None]) / sigma) ** 2)).astype(np.float32)


def silence(n: int) -> np.ndarray:
    """No noise at all."""
    return np.zeros((n, LIDAR.samples), np.float32)


def drawn(seed: int, n: int) -> np.ndarray:
    return normals(np.uint64(seed), n * LIDAR.samples).reshape(n, LIDAR.samples)


def centres(n: int, seed: int = 0) -> np.ndarray:
    return 14.0 + 3.0 * np.random.default_rng(seed).random(n)


def test_noise_is_standard_normal() -> None:
    """Rationale: noise is a hash of the sample's number, bent into a normal. Expected: mean 0, variance 1, kurtosis 3, the tails
    of the normal beyond 3 and 4, no correlation between neighbours, and a part of a stream equals the stream's part.
    Tolerance: 5 standard errors of 4 million draws, and 1 % and 4 % of the tails that bytes and polynomial leave.
    """
    z = normals(np.uint64(1), 4_000_000).astype(np.float64)
    n = len(z)
    assert abs(z.mean()) < 5 / np.sqrt(n)
    assert abs(z.var() - 1.0) < 5 * np.sqrt(2 / n)
    assert abs(np.mean(z**4) - 3.0) < 5 * np.sqrt(96 / n)
    assert abs(np.mean(z[1:] * z[:-1])) < 5 / np.sqrt(n)
    for limit, tail, own in ((3.0, 0.0026997960632601866, 0.01), (4.0, 6.334248366623996e-05, 0.04)):
        assert abs(np.mean(np.abs(z) > limit) - tail) < 5 * np.sqrt(tail / n) + own * tail
    few, taken = pulse_normals(np.uint64(1), 2, 5, 63), 64 + 4  # numbers of a pulse: whole pairs
    assert np.array_equal(few[:, 1], normals(np.uint64(1), 4 * taken)[3 * taken + 64 :][:3])


def test_digitiser_adds_the_stated_noise(device: Device) -> None:
    """Rationale: EMVA-like model, variance = noise^2 + shot^2 (light + background) + 1/12. Expected: that variance and the mean
    baseline + background + light. Tolerance: 5 standard errors."""
    n, light = 20_000, 900.0
    wave = device.digitise(
        np.full((n, LIDAR.samples), light, np.float32),
        drawn(2, n),
        np.ones(n),
    ).astype(float)
    variance = LIDAR.noise_dn**2 + LIDAR.shot_noise_dn**2 * (light + LIDAR.solar_background_dn) + 1 / 12
    count = wave.size
    assert abs(wave.mean() - (LIDAR.baseline_dn + LIDAR.solar_background_dn + light)) < 5 * np.sqrt(variance / count)
    assert abs(wave.var() - variance) < 5 * variance * np.sqrt(2 / count)


def test_echo_position_is_unbiased_and_not_quantised(device: Device) -> None:
    """Rationale: a known defect elsewhere is that later returns sit on whole bins. Expected: position and amplitude of one
    and of a second, well separated echo without bias, at any phase of the sampling clock.
    Tolerance: 0.5 mm in range for any phase: rounding to steps of 1/1000 and 1/500 of the peaks moves a fit by less than that.
    """
    first = centres(2000)
    second = first + 20.0
    wave = device.digitise(gaussian(first, 1000.0) + gaussian(second, 2000.0), silence(2000), np.ones(2000))
    found = device.detect(wave)
    assert np.all(found.count == 2)
    for k, truth in enumerate((first, second)):
        assert np.abs(found.position[:, k] - truth).max() * STEP_MM < 0.5
        assert np.abs(found.amplitude_dn[:, k] - 1000.0 * (k + 1)).max() < 1.5
        assert np.abs(found.sigma[:, k] / SIGMA - 1.0).max() < 2e-3
    assert np.std(np.modf(found.position[:, 1])[0]) > 0.2  # uniform phases stay uniform


@pytest.mark.parametrize(("separation", "echoes"), [(1.2, 2), (0.5, 1)])
def test_two_surfaces_separate_at_the_width_of_the_echo(device: Device, separation: float, echoes: int) -> None:
    """Rationale: two equal Gaussians have two maxima from 0.85 FWHM on. Expected: surfaces 1.2 c FWHM/2 apart give two echoes,
    0.5 apart one, at any phase. Tolerance: none."""
    first = centres(500)
    wave = device.digitise(
        gaussian(first, 1000.0) + gaussian(first + separation * FWHM, 1000.0), silence(500), np.ones(500)
    )
    found = device.detect(wave)
    assert np.all(found.count == echoes)
    if echoes == 2:  # the other echo's flank moves a maximum by 0.15 samples; nothing else may
        assert np.abs(found.position[:, 1] - found.position[:, 0] - separation * FWHM).max() < 0.4


def test_scatter_of_the_range_follows_the_noise(device: Device) -> None:
    """Rationale: the fit must be near what the noise allows. Expected: unbiased, and scattered by at most 1.5 times the
    Cramer-Rao bound of a sampled Gaussian in white noise of known width, sqrt(2 sigma / sqrt(pi)) * noise / A.
    Tolerance: bias 4 standard errors."""
    n, amplitude = 8000, 300.0
    truth = centres(n)
    found = device.detect(device.digitise(gaussian(truth, amplitude), drawn(3, n), np.ones(n)))
    assert np.all(found.count == 1)
    error = found.position[:, 0] - truth
    noise = np.sqrt(LIDAR.noise_dn**2 + LIDAR.shot_noise_dn**2 * amplitude)
    bound = np.sqrt(2.0 * SIGMA / np.sqrt(np.pi)) * noise / amplitude
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(n)
    assert error.std() < 1.5 * bound


def test_noise_alone_gives_no_echo(device: Device) -> None:
    """Rationale: threshold at 6 sigma. Expected: fewer than one false echo in 1e9 samples, so none in 3 million."""
    dark = np.zeros((50_000, LIDAR.samples), np.float32)
    found = device.detect(device.digitise(dark, drawn(4, 50_000), np.ones(50_000)))
    assert found.count.sum() == 0


@pytest.mark.parametrize("over", [1.2, 5.0, 20.0])
def test_saturated_echo_rests_on_its_flanks(device: Device, over: float) -> None:
    """Rationale: a plateau has no maximum to find. Expected: range within 2 mm and amplitude within 2 % of a flat target's echo
    up to 20 times full scale. Tolerance: steps of 1 DN on flanks of some hundred DN."""
    truth = centres(500)
    full = detector_from(LIDAR).full_scale_dn
    wave = device.digitise(gaussian(truth, over * full), silence(500), np.ones(500))
    assert wave.max() == full
    found = device.detect(wave)
    assert np.all(found.count == 1)
    assert np.abs(found.position[:, 0] - truth).max() * STEP_MM < 2.0
    assert np.abs(found.amplitude_dn[:, 0] / (over * full) - 1.0).max() < 0.02


def test_at_most_max_returns_in_order_of_time() -> None:
    """Rationale: a record has room for so many. Expected: the first `max_returns`, increasing."""
    device = Device(LIDAR.model_copy(update={"max_returns": 2}))
    first = centres(50)
    wave = device.digitise(
        sum(gaussian(first + 12.0 * k, 500.0 + 100.0 * k) for k in range(4)), silence(50), np.ones(50)
    )
    found = device.detect(wave)
    assert np.all(found.count == 2)
    assert np.abs(found.position - np.stack([first, first + 12.0], axis=1)).max() < 0.01


def test_result_does_not_depend_on_neighbours(device: Device) -> None:
    """Rationale: the same bytes for any split of the work. Expected: bit-exact for a lone row."""
    n = 1001
    signal = gaussian(centres(n), np.linspace(5.0, 6000.0, n))
    wave = device.digitise(signal, drawn(5, n), np.ones(n))
    assert np.array_equal(wave[700:701], device.digitise(signal[700:701], drawn(5, n)[700:701], np.ones(1)))
    all_, lone = device.detect(wave), device.detect(wave[700:701])
    assert np.array_equal(all_.position[700:701], lone.position, equal_nan=True)


def test_constant_packets_are_harmless(device: Device) -> None:
    """Rationale: empty, flat and fully clipped packets occur. Expected: no echo from flat ones, none or one from clipped."""
    flat = np.full((3, LIDAR.samples), 61, np.uint16)
    flat[1] = 0
    flat[2] = 4095
    found = device.detect(flat)
    assert found.count[0] == found.count[1] == 0
    assert found.count[2] <= 1
    assert len(device.detect(flat[:0]).count) == 0
