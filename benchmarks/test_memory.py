"""Peak memory and time of `testrange simulate` and `testrange evaluate` for a flight and for one ten times as long.

The long flight has strips ten times as long over the same range, with ten times as many pictures and packets (every waveform is
stored); its scene is the same. Each command is a process of its own, whose greatest resident memory the system tells. Times are
of the CPU, start-up included.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from campaign.load import load_config
from simulator.flight.plan import design_lines
from simulator.world import prepare_range

TINY = Path(__file__).parents[1] / "tests" / "data" / "tiny.toml"
PROGRAM = Path(sys.executable).with_name("testrange")
TIMES = 10
PICTURES = 2  # of a short strip
COMMON = (  # a short strip has more chunks of pulses than are in memory at one time
    'campaign.parts=["camera", "lidar"]',
    "flight.heights_m=[26.0]",
    "site.extent_m=800.0",
    'recording.waveforms="all"',
    "lidar.prr_hz=400000.0",
)
GB = 1024 / 1e9 if sys.platform != "darwin" else 1e-9  # getrusage counts bytes there, KiB on Linux


# A process begins with the memory of the one that starts it, until it loads its own program: a small one starts the command.
STARTER = """
import os, subprocess, sys
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, used = os.wait4(process.pid, 0)
print(os.waitstatus_to_exitcode(status), used.ru_maxrss, used.ru_utime + used.ru_stime)
"""


def measured(*command: str | Path) -> tuple[float, float]:
    """Greatest resident memory [GB] and CPU time [s] of a command; the figures of its children are in them."""
    told = subprocess.run(
        [sys.executable, "-S", "-c", STARTER, PROGRAM, *command, "--quiet"], capture_output=True, text=True, check=True
    )
    code, memory, cpu_s = told.stdout.split()
    assert code == "0", told.stderr
    return float(memory) * GB, float(cpu_s)


def flight(times: int) -> list[str]:
    """Settings of a flight whose strips are as many times as long as the range's own."""
    config = load_config(TINY, [*COMMON, f"flight.images_per_strip={PICTURES * times}"])
    world = prepare_range(config)
    (line, *_) = design_lines(config, world.scene.layout, config.flight.heights_m[0])
    length = float(((line.end_m - line.start_m) ** 2).sum() ** 0.5)
    run_in = config.flight.run_in_m + 0.5 * (times - 1) * length
    spacing = length / PICTURES
    settings = (
        *COMMON,
        f"flight.images_per_strip={PICTURES * times}",
        f"flight.run_in_m={run_in}",
        f"flight.image_spacing_m={spacing}",
    )
    return [word for one in settings for word in ("--set", one)]


@pytest.mark.skipif(not hasattr(os, "wait4"), reason="this system does not tell a process's memory")
@pytest.mark.benchmark(group="memory")
def test_ten_times_the_flight(benchmark: BenchmarkFixture, record: Callable[..., None], tmp_path: Path) -> None:
    simulated, evaluated = {}, {}

    def fly_and_evaluate() -> None:
        for times in (1, TIMES):
            out = tmp_path / f"{times}"
            simulated[times] = measured("simulate", TINY, "--out", out / "campaign", *flight(times))
            evaluated[times] = measured(
                "evaluate", out / "campaign", "--out", out / "results", "--keep-going", "--no-documents"
            )

    benchmark.pedantic(fly_and_evaluate, rounds=1)
    record(
        memory_ratio_10x=max(run[TIMES][0] / run[1][0] for run in (simulated, evaluated)),
        memory_simulate_ratio_10x=simulated[TIMES][0] / simulated[1][0],
        memory_evaluate_ratio_10x=evaluated[TIMES][0] / evaluated[1][0],
        memory_simulate_gb=simulated[TIMES][0],
        memory_evaluate_gb=evaluated[TIMES][0],
        time_simulate_ratio_10x=simulated[TIMES][1] / simulated[1][1],
        time_evaluate_ratio_10x=evaluated[TIMES][1] / evaluated[1][1],
    )
