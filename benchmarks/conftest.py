"""What the benchmarks share: the quickstart's range, out/bench/latest.json with the figures of a run, and the table at its end.

A figure is a ratio of two things measured in one run on one machine, or stands beside one: bare seconds say little elsewhere.
A speed is held against benchmarks/baseline.json as a multiple of a small reference kernel's, timed beside each figure in both
runs. Bars are the project's own. Nothing here fails because it is slow.
"""

import json
import os
import platform
import statistics
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from campaign.load import load_config
from campaign.threads import thread_count
from simulator.flight import rig
from simulator.lidar.strip import StripChunk, simulate_strip
from simulator.simulate import Range, prepare_range

LATEST = Path(__file__).parents[1] / "out" / "bench" / "latest.json"
BASELINE = Path(__file__).with_name("baseline.json")
PAGE = Path(__file__).parents[1] / "docs" / "performance.md"
MARKS = ("<!-- figures of make baseline -->\n", "<!-- end of figures -->\n")
KERNEL, KERNEL_CPU = "reference_kernel_per_s", "reference_kernel_per_cpu_s"
Record = Callable[..., None]

# What is asked for: at least, or at most. A name with an ending (`_slope`, `_flat`) has a bar only where it stands here.
BARS: dict[str, tuple[str, float]] = {
    "lidar_pulses_per_s_unwritten": (">=", 1_800_000),
    "lidar_pulses_per_s": (">=", 700_000),
    "lidar_amplitude_rms_ratio": ("<=", 0.005),
    "lidar_amplitude_rms_ratio_slope": ("<=", 0.005),
    "lidar_range_bias_m": ("<=", 0.0005),
    "lidar_range_bias_m_slope": ("<=", 0.0005),
    "lidar_echo_count_equal": (">=", 0.999),
    "lidar_rim_amplitude_bias": ("<=", 0.01),
    "camera_time_ratio": ("<=", 1.10),
    "camera_frame_s": ("<=", 60.0),
    "camera_noise_ratio_targets": ("<=", 0.5),
    "memory_ratio_10x": ("<=", 1.1),
    "memory_simulate_gb": ("<=", 3.0),
    "memory_evaluate_gb": ("<=", 3.0),
    "decompositions_per_s": (">=", 50_000),
    "decomposition_rms_over_crb": ("<=", 1.2),
    "rerun_time_ratio": ("<=", 0.20),
    "study_two_workers_ratio": (">=", 1.7),
    "help_s": ("<=", 0.3),
}


@dataclass
class Session:
    """Figures of this run, and how quick the machine was when each was taken."""

    figures: dict[str, float] = field(default_factory=dict)
    kernel: list[tuple[float, float]] = field(default_factory=list)  # rounds a second of the clock, and of the CPU


SESSION = pytest.StashKey[Session]()


def kernel_per_s() -> tuple[float, float]:
    """Rounds of a small kernel on every thread, a second of the clock and of the CPU: arithmetic in the cache, no code of ours."""
    block = np.linspace(0.1, 1.0, 16_384)

    def work(_: int) -> None:
        for _ in range(60):
            np.exp(np.sin(block) * block)

    threads = thread_count()
    with ThreadPoolExecutor(threads) as pool:
        start, cpu = time.perf_counter(), time.process_time()
        list(pool.map(work, range(2 * threads)))
        rounds = 2 * threads * 60
        return rounds / (time.perf_counter() - start), rounds / (time.process_time() - cpu)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--baseline", action="store_true", help="put the figures into benchmarks/baseline.json and docs/performance.md"
    )


def pytest_configure(config: pytest.Config) -> None:
    config.stash[SESSION] = Session()


@pytest.fixture(scope="session")
def record(pytestconfig: pytest.Config) -> Iterator[Record]:
    """`record(name=value, ...)`: figures for latest.json and the table."""
    session = pytestconfig.stash[SESSION]

    def add(**new: float) -> None:
        session.figures.update({name: float(f"{value:.4g}") for name, value in new.items()})
        session.kernel += [kernel_per_s() for _ in range(3)]
        for name, rates in zip((KERNEL, KERNEL_CPU), zip(*session.kernel, strict=True), strict=True):
            session.figures[name] = float(f"{statistics.median(rates):.4g}")
        _write(LATEST, _read(LATEST) | session.figures)  # at once, and what this session did not measure stays

    yield add
    if pytestconfig.getoption("--baseline"):
        kind = machine()
        _write(BASELINE, {"machine": kind, "figures": session.figures})
        _write_page(kind, session.figures)


def machine() -> dict[str, str | int]:
    """Of what kind it is; no name of it, no path."""
    model = ""
    if Path("/proc/cpuinfo").is_file():
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 0
    return {
        "cpu": model or platform.machine(),
        "threads": thread_count(),
        "memory_gb": round(memory / 1e9),
        "system": platform.system(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "numba", "mitsuba", "drjit")},
    }


def _read(path: Path) -> dict[str, float]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _write(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def _write_page(kind: dict[str, str | int], figures: dict[str, float]) -> None:
    """The table of docs/performance.md, between its marks."""
    page = PAGE.read_text(encoding="utf-8")
    before, rest = page.split(MARKS[0])
    _, after = rest.split(MARKS[1])
    lines = ["| figure | value | bar | |", "|---|---|---|---|"]
    for name in sorted(figures):
        bar = "{} {:,g}".format(*BARS[name]) if name in BARS else ""
        lines.append(f"| `{name}` | {figures[name]:,.4g} | {bar} | {'missed' if missed(name, figures[name]) else ''} |")
    told = ", ".join(f"{key} {value}" for key, value in kind.items())
    table = "\n".join([*lines, "", f"Measured on: {told}.", ""])
    PAGE.write_text(before + MARKS[0] + table + MARKS[1] + after, encoding="utf-8")


def against(name: str, figures: dict[str, float], base: dict[str, float]) -> float | None:
    """How many times the baseline a figure is; speeds and times in units of the machine's own."""
    kernel = KERNEL_CPU if "_cpu_" in name else KERNEL
    if not base.get(name) or not base.get(kernel):
        return None
    power = 0 if name in (KERNEL, KERNEL_CPU) else 1 if "_per_" in name else -1 if name.endswith("_s") else 0
    return float(figures[name] / base[name] * (base[kernel] / figures[kernel]) ** power)


def missed(name: str, value: float) -> bool:
    sense, bar = BARS.get(name, (">=", -np.inf))
    return not (value >= bar if sense == ">=" else value <= bar)


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Every figure of the run: its ratio to the baseline's, the bar, and a mark where the bar is missed."""
    figures = config.stash[SESSION].figures
    if not figures:
        return
    stored = _read(BASELINE)
    base = stored.get("figures", {})
    terminalreporter.section("figures")
    terminalreporter.write_line(f"{'figure':44s} {'value':>12s} {'/ baseline':>11s} {'bar':>14s}")
    for name in sorted(figures):
        ratio = against(name, figures, base)
        told = "-" if ratio is None else f"{ratio:.2f}"
        bar = "{} {:,.6g}".format(*BARS[name]) if name in BARS else ""
        mark = "  MISSED" if missed(name, figures[name]) else ""
        terminalreporter.write_line(f"{name:44s} {figures[name]:>12,.6g} {told:>11s} {bar:>14s}{mark}")
    told = ", ".join(f"{k} {v}" for k, v in stored.get("machine", {}).items()) or "none: make baseline writes one"
    terminalreporter.write_line(f"baseline: {told}")
    count = sum(missed(name, value) for name, value in figures.items())
    terminalreporter.write_line(f"bars missed: {count}; figures: {LATEST.relative_to(LATEST.parents[2])}")


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
