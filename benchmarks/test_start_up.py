"""`testrange --help` against a Python that does nothing: heavy libraries belong in the command that uses them."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture


@pytest.mark.benchmark(group="start-up")
def test_help(benchmark: BenchmarkFixture, record: Callable[..., None]) -> None:
    program = Path(sys.executable).with_name("testrange")
    benchmark.pedantic(
        lambda: subprocess.run([program, "--help"], check=True, stdout=subprocess.DEVNULL), rounds=7, warmup_rounds=2
    )
    best = benchmark.stats.stats.min
    nothing = []
    for _ in range(7):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", "pass"], check=True)
        nothing.append(time.perf_counter() - start)
    record(help_s=best, help_over_bare_python=best / min(nothing))
