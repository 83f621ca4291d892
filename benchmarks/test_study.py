"""A study with one worker against the same study with two: both with one thread each, both from nothing."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from testrange.study.run import Done, run_study

# Four geometries of about the same cost, none shared: what is measured is the pool, not the cache.
STUDY = """
title = "Two workers"
base = "study_range"
responses = ["indicators.calibration_error", "run_time_s"]

[[factor]]
name = "speed"
key = "flight.speed_m_s"
values = [4.0, 4.2, 4.4, 4.6]
"""


@pytest.mark.benchmark(group="study")
def test_two_workers(benchmark: BenchmarkFixture, record: Callable[..., None], tmp_path: Path) -> None:
    """The aim is a ratio of 1.7 or more on two cores that nobody else uses."""
    (tmp_path / "study.toml").write_text(STUDY)

    def run(workers: int) -> Done:
        done = run_study(tmp_path / "study.toml", tmp_path / f"out{workers}", workers=workers)
        assert done.count("done") == 4
        return done

    start = time.perf_counter()
    run(1)
    alone = time.perf_counter() - start
    benchmark.pedantic(lambda: run(2), rounds=1)
    together = benchmark.stats.stats.min
    record(study_one_worker_s=alone, study_two_workers_s=together, study_two_workers_ratio=alone / together)
