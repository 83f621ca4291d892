"""The quickstart simulated twice with its renders kept, the second time with another seed of noise: a part of the first time.

CPU time of the whole of `simulate`: scene, benches, ranging line, camera, LiDAR, manifest. The renderer is loaded and the kernels
are compiled before, so that the second run does not gain what every second run in one process gains.
"""

import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from campaign.load import load_config
from simulator.simulate import simulate_campaign

TINY = Path(__file__).parents[1] / "tests" / "data" / "tiny.toml"


@pytest.mark.benchmark(group="rerun")
def test_another_noise(benchmark: BenchmarkFixture, record: Callable[..., None], tmp_path: Path) -> None:
    def run(seed: int) -> float:
        kept = f'render.cache="{tmp_path / "cache"}"'
        out = tmp_path / f"{seed}"
        out.mkdir()
        start = time.process_time()
        simulate_campaign(load_config("quickstart", [f"seed={seed}", "scene_seed=1", kept]), out)
        return time.process_time() - start

    (tmp_path / "warm").mkdir()
    simulate_campaign(load_config(TINY), tmp_path / "warm")
    first = run(1)
    again = benchmark.pedantic(lambda: run(2), rounds=1)
    record(rerun_time_ratio=again / first, rerun_first_cpu_s=first)
