"""A campaign of one strip and one small picture: a few seconds, for tests that need several simulations."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from campaign.config import Config
from campaign.load import load_config

TINY = Path(__file__).parents[1] / "data" / "tiny.toml"
# Values of faults and seed that no other number of a campaign equals by chance.
MICRO = (
    "seed=918273645",
    "bench.sphere.window_px=[64, 48]",
    "bench.chessboard.squares=[14, 9]",
    "bench.chessboard.square_m=0.055",
    "bench.chessboard.margin_m=0.02",
    "bench.chessboard.distances_m=[1.0, 1.1, 1.2, 1.35]",
    "bench.chessboard.f_number=8.0",
    "bench.chessboard.samples=16",
    "flight.heights_m=[22.0]",
    "flight.headings_deg=[0.0]",
    "lidar.prr_hz=200000.0",
    "lidar.samples=32",
    "camera.width_px=320",
    "camera.height_px=240",
    "camera.pixel_size_um=40.0",
    "camera.lens.fx_px=330.0913",
    "camera.lens.fy_px=330.2471",
    "camera.lens.cx_px=161.2317",
    "camera.lens.cy_px=118.7193",
    "camera.lens.k1=-0.0469133",
    "camera.lens.k2=0.0236171",
    "camera.lens.k3=-0.00491317",
    "camera.lens.p1=0.000321737",
    "camera.lens.p2=-0.000261193",
    "render.target_samples=4",
    "faults.camera_boresight_deg=[0.251713, -0.301937, 0.402311]",
    "faults.lidar_boresight_deg=[-0.209317, 0.354143, -0.307721]",
    "faults.camera_lever_arm_m=[0.031271, -0.021433, 0.043913]",
    "faults.lidar_lever_arm_m=[-0.042173, 0.033191, 0.022739]",
    "faults.camera_clock_s=0.000713",
    "faults.lidar_clock_s=-0.000391",
    "faults.range_offset_m=0.0123719",
    "faults.range_scale=0.0000631",
    "faults.principal_distance_px=0.713911",
    "faults.principal_point_px=[0.317713, -0.291317]",
    "faults.k1=0.000331719",
    "faults.lidar_gain=0.973117",
    "faults.camera_gain=1.021739",
)


def micro_config(*overrides: str) -> Config:
    """The configuration, any of its values replaced."""
    return load_config(TINY, [*MICRO, *overrides])


@pytest.fixture(scope="session")
def micro() -> Callable[..., Config]:
    """`micro_config`, for tests that change a value."""
    return micro_config


@pytest.fixture(scope="session")
def micro_campaign(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The simulated folder, as this process with all its cores makes it."""
    from simulator.simulate import simulate_campaign

    out = tmp_path_factory.mktemp("micro") / "campaign"
    out.mkdir()
    simulate_campaign(micro_config(), out)
    yield out
