"""LiDAR pulses a second: one strip of the quickstart with waveforms, kept in memory and written to disk."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from campaign import las
from simulator.lidar import StripChunk
from simulator.scanner import scanner_from
from simulator.simulate import Range

Strip = Callable[[], Iterator[StripChunk]]
Record = Callable[..., None]


def pulses(world: Range) -> tuple[int, float]:
    """(pulses fired inside the sector, seconds that the instrument takes)"""
    strip = world.sorties[0].strips[0]
    seconds = strip.end_s - strip.start_s
    return scanner_from(world.config.lidar).pulse_count(seconds), seconds


@pytest.mark.benchmark(group="lidar")
def test_strip_in_memory(benchmark: BenchmarkFixture, quickstart: Range, strip: Strip, record: Record) -> None:
    benchmark.pedantic(lambda: sum(len(c.returns.gps_time_s) for c in strip()), rounds=3, warmup_rounds=1)
    count, seconds = pulses(quickstart)
    best = benchmark.stats.stats.min
    record(lidar_pulses_per_s=count / best, lidar_speed_over_instrument=seconds / best)


@pytest.mark.benchmark(group="lidar")
def test_strip_written(
    benchmark: BenchmarkFixture, quickstart: Range, strip: Strip, record: Record, tmp_path: Path
) -> None:
    """LAS with packets and the LAZ twin. In a campaign a second thread writes while the next chunk is traced; not here."""
    config = quickstart.config
    spec = las.LasSpec(
        projection_epsg=config.site.projection_epsg,
        height_epsg=config.site.height_epsg,
        creation_date="2026-09-25",
        system_identifier="bench",
        offset_m=(615_500.0, 3_463_000.0, 0.0),
        sample_count=config.lidar.samples,
        sampling_ps=1000,
        bit_depth=16,
        file_source_id=1,
    )

    def write() -> None:
        with las.StripWriter(tmp_path / "strip_01.las", tmp_path / "strip_01_points.laz", spec) as writer:
            for chunk in strip():
                writer.write(chunk.returns, chunk.packets)

    benchmark.pedantic(write, rounds=2, warmup_rounds=1)
    count, seconds = pulses(quickstart)
    best = benchmark.stats.stats.min
    record(lidar_written_pulses_per_s=count / best, lidar_written_speed_over_instrument=seconds / best)
