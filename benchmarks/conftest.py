"""What the benchmarks share: the quickstart's range, and out/bench/latest.json with the figures of a run.

A figure is a ratio of two things measured in one run on one machine, or stands beside one: bare seconds say little elsewhere.
Nothing here fails because it is slow.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from campaign.load import load_config
from simulator import rig
from simulator.lidar import StripChunk, simulate_strip
from simulator.simulate import Range, prepare_range

LATEST = Path(__file__).parents[1] / "out" / "bench" / "latest.json"
Record = Callable[..., None]
FIGURES = pytest.StashKey[dict[str, float]]()


@pytest.fixture(scope="session")
def record(pytestconfig: pytest.Config) -> Iterator[Record]:
    """`record(name=value, ...)`: a figure for latest.json and the terminal."""
    figures = pytestconfig.stash.setdefault(FIGURES, {})
    yield lambda **new: figures.update({name: float(f"{value:.4g}") for name, value in new.items()})
    LATEST.parent.mkdir(parents=True, exist_ok=True)
    known = (
        json.loads(LATEST.read_text(encoding="utf-8")) if LATEST.is_file() else {}
    )  # what this session did not measure stays
    LATEST.write_text(json.dumps(known | figures, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """The figures once more, for people."""
    for name, value in config.stash.get(FIGURES, {}).items():
        terminalreporter.write_line(f"{name:48s} {value:>12,.6g}")


@pytest.fixture(scope="session")
def quickstart() -> Range:
    """Scene, flight and navigation of the quickstart; nothing rendered."""
    return prepare_range(load_config("quickstart"))


@pytest.fixture(scope="session")
def strip(quickstart: Range) -> Callable[[], Iterator[StripChunk]]:
    """The first strip's chunks, made anew by every call."""
    config, sortie = quickstart.config, quickstart.sorties[0]
    return lambda: simulate_strip(
        quickstart.render_scene,
        config,
        sortie.strips[0],
        sortie.motion,
        quickstart.estimated[0],
        rig.true_lidar(config),
        rig.nominal_lidar(config),
        quickstart.frame,
    )
