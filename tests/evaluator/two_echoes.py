"""Packets of two echoes by the simulator's device, and what they can tell at most: the Cramer-Rao bound.

Read with runpy by the test and by the benchmark of the decomposition; nothing of the evaluator is in it.
"""

from dataclasses import dataclass

import numpy as np

from campaign.load import load_config
from simulator.lidar.device import Device, digitiser_from
from simulator.lidar.strip import optics_from

FWHM_PER_SIGMA = 2.0 * np.sqrt(2.0 * np.log(2.0))
CONFIG = load_config("quickstart")
LIDAR = CONFIG.lidar
OPTICS = optics_from(LIDAR, CONFIG.environment.visibility_km)
ECHO_FWHM_NS = OPTICS.echo_sigma_ns * FWHM_PER_SIGMA
SATURATION_DN = 2.0**LIDAR.bit_depth - 1.0


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """n packets of two echoes each, in order of time."""

    packets: np.ndarray  # (n, samples) uint16 [DN]
    truth: np.ndarray  # (n, 2, 3): amplitude [DN], centre after the first sample [ns], FWHM [ns]


def pairs(count: int, rng: np.random.Generator) -> Pairs:
    """As a canopy's or an edge's two surfaces give them: 2 to 4 FWHM apart (1.3 to 2.6 m), the first 150 to 1500 DN high, the
    second 0.2 to 2 times that, each up to 15 % wider than a flat target's echo; digitised as `simulator.lidar.device` does."""
    fwhm = ECHO_FWHM_NS * rng.uniform(1.0, 1.15, (count, 2))
    first = rng.uniform(12.0, 16.0, count)
    centre = np.stack([first, first + ECHO_FWHM_NS * rng.uniform(2.0, 4.0, count)], axis=1)
    strong = np.exp(rng.uniform(np.log(150.0), np.log(1500.0), count))
    amplitude = np.stack([strong, strong * np.exp(rng.uniform(np.log(0.2), np.log(2.0), count))], axis=1)
    truth = np.stack([amplitude, centre, fwhm], axis=2)
    signal = np.concatenate([_signal(part) for part in np.array_split(truth, -(-count // 5000))])
    normal = rng.standard_normal(signal.shape, np.float32)
    packets = Device(LIDAR).digitise(signal.astype(np.float32), normal, np.ones(count))
    return Pairs(packets=packets, truth=truth)


def _signal(truth: np.ndarray) -> np.ndarray:
    """(n, samples) light above the baseline [DN]."""
    t = np.arange(LIDAR.samples) * LIDAR.sampling_ns
    z = (t - truth[:, :, 1, None]) * FWHM_PER_SIGMA / truth[:, :, 2, None]
    return np.sum(truth[:, :, 0, None] * np.exp(-0.5 * z**2), axis=1)


def cramer_rao(truth: np.ndarray) -> np.ndarray:
    r"""(n, 2, 3) least standard deviation of amplitude, centre and FWHM that an unbiased estimator can have, baseline unknown.

    Samples are normal with mean m and variance v(m) = noise^2 + shot^2 (light + background) + 1/12 (rounding), so that the
    Fisher information is

    .. math:: I = \sum_i \frac{m_i' m_i'^T}{v_i} + \frac{v_i' v_i'^T}{2 v_i^2}

    with the derivatives in closed form (Kay 1993, Fundamentals of Statistical Signal Processing: Estimation Theory, 3.31).
    """
    device = digitiser_from(LIDAR)
    t = np.arange(LIDAR.samples) * LIDAR.sampling_ns
    amplitude, centre, fwhm = (truth[:, :, j, None] for j in range(3))
    offset = t - centre
    shape = np.exp(-4.0 * np.log(2.0) * (offset / fwhm) ** 2)
    by_centre = amplitude * shape * 8.0 * np.log(2.0) * offset / fwhm**2
    by_fwhm = by_centre * offset / fwhm
    slopes = np.stack([shape, by_centre, by_fwhm], axis=2).reshape(len(truth), 6, len(t))
    slopes = np.concatenate([slopes, np.ones((len(truth), 1, len(t)))], axis=1)
    light = np.sum(amplitude * shape, axis=1)
    variance = device.noise_dn**2 + device.shot_noise_dn**2 * (light + device.background_dn) + 1.0 / 12.0
    grows = device.shot_noise_dn**2 * slopes
    grows[:, 6] = 0.0  # the baseline is no light
    information = np.einsum("nat,nbt,nt->nab", slopes, slopes, 1.0 / variance, optimize=True)
    information += 0.5 * np.einsum("nat,nbt,nt->nab", grows, grows, 1.0 / variance**2, optimize=True)
    bound = np.sqrt(np.diagonal(np.linalg.inv(information), axis1=1, axis2=2))
    return np.asarray(bound[:, :6].reshape(-1, 2, 3))
