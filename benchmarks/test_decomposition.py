"""Decomposition of packets with two echoes each, against SciPy's `curve_fit` packet by packet and against the least error.

Separations, amplitudes and noise: `tests/evaluator/two_echoes.py`. A batch is what one strip of a fast scanner sends to it.
"""

import runpy
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.optimize import curve_fit

from evaluator.observe.waveforms import decompose

TWO = runpy.run_path(str(Path(__file__).parents[1] / "tests" / "evaluator" / "two_echoes.py"))
PACKETS = 50_000
ONE_BY_ONE = 300


def two_gaussians(
    t: np.ndarray, a: float, centre: float, sigma: float, a2: float, centre2: float, sigma2: float, level: float
) -> np.ndarray:
    first = a * np.exp(-0.5 * ((t - centre) / sigma) ** 2)
    return np.asarray(level + first + a2 * np.exp(-0.5 * ((t - centre2) / sigma2) ** 2))


@pytest.mark.benchmark(group="decomposition")
def test_decomposition(benchmark: BenchmarkFixture, record: Callable[..., None]) -> None:
    """`curve_fit` gets what it needs to be quick: the number of echoes, their places to half a sample, heights and widths to a
    tenth. Ours finds the echoes itself and learns the noise. Errors: root mean square over the packets of error over
    Cramer-Rao bound, the greatest of the six parameters."""
    made = TWO["pairs"](PACKETS, np.random.default_rng(np.random.SeedSequence([7, 4])))
    packets = made.packets.astype(float)
    options = {"echo_fwhm_ns": TWO["ECHO_FWHM_NS"], "saturation_dn": TWO["SATURATION_DN"]}
    found = benchmark.pedantic(lambda: decompose(packets, 1.0, **options), rounds=5, warmup_rounds=1)
    ours = benchmark.stats.stats.median / PACKETS

    t = np.arange(packets.shape[1], dtype=float)
    scale = np.array([1.1, 1.0, 0.9 / TWO["FWHM_PER_SIGMA"]])
    starts = made.truth * scale + np.array([0.0, 0.5, 0.0])
    chosen = range(0, PACKETS, PACKETS // ONE_BY_ONE)
    start = time.perf_counter()
    for i in chosen:
        curve_fit(two_gaussians, t, packets[i], p0=(*starts[i].ravel(), packets[i].min()), maxfev=5000)
    single = (time.perf_counter() - start) / len(chosen)

    count = np.bincount(found.packet, minlength=PACKETS)
    right = count == 2
    assert right.mean() > 0.999
    fitted = np.stack([found.amplitude_dn, found.centre_ns, found.fwhm_ns], axis=1)[right[found.packet]].reshape(
        -1, 2, 3
    )
    sample = slice(0, 5000)
    bound = TWO["cramer_rao"](made.truth[right][sample])
    ratio = np.sqrt(np.mean(((fitted - made.truth[right])[sample] / bound) ** 2, axis=0))
    record(
        decompositions_per_s=1.0 / ours,
        decomposition_speed_over_curve_fit=single / ours,
        decomposition_rms_over_crb=float(ratio.max()),
    )
