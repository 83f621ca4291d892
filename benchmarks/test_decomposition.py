"""Gaussian decomposition of waveforms against SciPy's `curve_fit`, packet by packet, on the same simulated packets."""

import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.optimize import curve_fit

from evaluator.observe.waveforms import decompose
from simulator.lidar import StripChunk

ONE_BY_ONE = 400


def gaussian(t: np.ndarray, amplitude: float, centre: float, sigma: float, level: float) -> np.ndarray:
    return np.asarray(level + amplitude * np.exp(-0.5 * ((t - centre) / sigma) ** 2))


@pytest.mark.benchmark(group="decomposition")
def test_decomposition(
    benchmark: BenchmarkFixture, strip: Callable[[], Iterator[StripChunk]], record: Callable[..., None]
) -> None:
    """`curve_fit` gets what it needs to be quick: one echo a packet, the peak as start. Ours finds the echoes itself."""
    packets = np.concatenate([chunk.packets for chunk in strip()])[:20_000].astype(float)
    found = benchmark.pedantic(lambda: decompose(packets, 1.0, echo_fwhm_ns=4.27), rounds=3, warmup_rounds=1)
    best = benchmark.stats.stats.min / len(packets)
    t = np.arange(packets.shape[1], dtype=float)
    rows = packets[:: len(packets) // ONE_BY_ONE][:ONE_BY_ONE]
    start = time.perf_counter()
    for row in rows:
        curve_fit(gaussian, t, row, p0=(row.max() - row[-1], float(row.argmax()), 1.8, row[-1]), maxfev=2000)
    single = (time.perf_counter() - start) / len(rows)
    assert len(found.amplitude_dn) >= 0.99 * len(packets)
    record(decompositions_per_s=1 / best, decomposition_speed_over_curve_fit=single / best)
