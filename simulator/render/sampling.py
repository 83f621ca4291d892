"""Random numbers of the camera's kernel: a function of (seed, frame, pixel, sample, dimension) alone, and the pixel's filter.

Mitsuba's samplers and `dr.rng` depend on the size of the wavefront, so the same picture in other tiles would be another
picture. Each pair of dimensions is a two-dimensional Sobol sequence, Owen-scrambled and shuffled by hashes: any power of two
of samples is stratified in every pair, whatever the pixel.
"""

from typing import Any

import numpy as np
from scipy.special import ndtr

from simulator.render import start

start()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

FILTER_KNOTS = 2048


def mix(x: Any) -> Any:
    """A 32-bit integer hash (the finaliser of MurmurHash3: every input bit changes half of the output bits)."""
    x = mi.UInt32(x)
    x = (x ^ (x >> 16)) * 0x85EBCA6B
    x = (x ^ (x >> 13)) * 0xC2B2AE35
    return x ^ (x >> 16)


def _scramble_reversed(x: Any, seed: Any) -> Any:
    """Owen scrambling of a number whose bits stand in reverse order: each bit is flipped by a hash of the bits below it.

    References
    ----------
    Laine, S. and Karras, T. (2011), Stratified sampling for stochastic transparency, CGF 30(4).
    Burley, B. (2020), Practical hash-based Owen scrambling, JCGT 10(4); constants by N. Vegdahl.
    """
    x = x ^ (x * 0x3D20ADEA)
    x = x + seed
    x = x * ((seed >> 16) | 1)
    x = x ^ (x * 0x05526C56)
    return x ^ (x * 0x53A22864)


def _pascal(x: Any) -> Any:
    """The second Sobol dimension's generator matrix (Pascal's triangle modulo 2) on an index, bits in reverse order."""
    x = x ^ ((x & 0xAAAAAAAA) >> 1)
    x = x ^ ((x & 0xCCCCCCCC) >> 2)
    x = x ^ ((x & 0xF0F0F0F0) >> 4)
    x = x ^ ((x & 0xFF00FF00) >> 8)
    return x ^ ((x & 0xFFFF0000) >> 16)


def _unit(bits: Any) -> Any:
    """32 random bits -> float in [0, 1)."""
    return mi.Float(bits >> 8) * 2.0**-24


class PixelSampler:
    """The sample sequence of one pixel for each lane."""

    def __init__(self, pixel: Any, key: tuple[Any, Any], pairs: int) -> None:
        own = mix(mi.UInt32(pixel) + key[0]) ^ key[1]
        self._seeds = []
        for pair in range(pairs):
            seed = mix(own + ((pair * 0x9E3779B9) & 0xFFFFFFFF))
            self._seeds.append((seed, mix(seed + 0x68E31DA4), mix(seed + 0xB5297A4D)))

    def pair(self, sample: Any, pair: int) -> tuple[Any, Any]:
        """Two numbers in [0, 1) of a sample (UInt32); `pair` numbers the dimensions."""
        seed, seed_x, seed_y = self._seeds[pair]
        index = dr.brev(_scramble_reversed(dr.brev(sample), seed))
        x = dr.brev(_scramble_reversed(index, seed_x))
        y = dr.brev(_scramble_reversed(_pascal(index), seed_y))
        return _unit(x), _unit(y)


def frame_words(seed: int, stream: int, frame_key: tuple[int, ...]) -> tuple[int, int]:
    """Two 32-bit words for one frame."""
    words = np.random.SeedSequence([seed, stream, *frame_key]).generate_state(2)
    return int(words[0]), int(words[1])


def filter_quantiles(sigma_px: float) -> np.ndarray:
    """Quantile function of the pixel's response along one axis: its box convolved with a Gaussian point spread.

    Parameters
    ----------
    sigma_px : float
        Of the point spread. [px]

    Returns
    -------
    (FILTER_KNOTS + 1,) ndarray
        Offset from the pixel's centre at the probabilities 0, 1/FILTER_KNOTS, ... 1; symmetric. [px]
    """
    probability = np.linspace(0.0, 1.0, FILTER_KNOTS + 1)
    if sigma_px <= 0:
        return probability - 0.5

    def integral(z: np.ndarray) -> np.ndarray:  # of the normal distribution function
        return np.asarray(z * ndtr(z) + np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi))

    x = np.linspace(-0.5 - 6 * sigma_px, 0.0, 20001)
    cumulative = sigma_px * (integral((x + 0.5) / sigma_px) - integral((x - 0.5) / sigma_px))
    half = FILTER_KNOTS // 2
    # The outermost knots: the mean of the tail beyond the next one, so that linear interpolation keeps the spread.
    wanted = probability[: half + 1].copy()
    wanted[0] = 0.25 / FILTER_KNOTS
    lower = np.interp(wanted, cumulative, x)
    lower[half] = 0.0
    return np.concatenate([lower, -lower[-2::-1]])


def filter_offset(table: Any, u: Any) -> Any:
    """Offset from the pixel's centre for a number in [0, 1). [px]"""
    position = u * FILTER_KNOTS
    knot = mi.UInt32(position)
    left = dr.gather(mi.Float, table, knot)
    return left + (position - mi.Float(knot)) * (dr.gather(mi.Float, table, knot + 1) - left)
