"""The same seed gives the same bytes, for any number of cores and any size of chunk; and so does evaluation.

One kind of CPU and locked versions are taken for granted: another instruction set adds in another order.
"""

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import laspy
import pytest

from campaign.config import Config
from evaluator.evaluate import evaluate_campaign
from evaluator.results import write_results
from simulator.simulate import simulate_campaign

ONE_CORE = pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="only Linux takes cores away from a process")
MAKE_MICRO = """
import importlib.util, pathlib, sys
spec = importlib.util.spec_from_file_location("micro", sys.argv[1])
micro = importlib.util.module_from_spec(spec)
spec.loader.exec_module(micro)
from simulator.simulate import simulate_campaign
simulate_campaign(micro.micro_config(), pathlib.Path(sys.argv[2]))
"""
EVALUATE = """
import pathlib, sys
from evaluator.evaluate import evaluate_campaign
from evaluator.results import write_results
write_results(pathlib.Path(sys.argv[2]), evaluate_campaign(pathlib.Path(sys.argv[1])))
"""


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file by its path."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def different(a: Path, b: Path) -> set[str]:
    """Paths that only one folder has, or whose bytes differ."""
    left, right = digests(a), digests(b)
    return {name for name in left.keys() | right.keys() if left.get(name) != right.get(name)}


def on_one_core(script: str, *arguments: Path) -> None:
    """Runs Python in a process that may use one core; what starts in it counts one core."""
    core = min(os.sched_getaffinity(0))
    code = f"import os; os.sched_setaffinity(0, {{{core}}})\n{script}"
    subprocess.run([sys.executable, "-c", code, *map(str, arguments)], check=True, timeout=300)


@pytest.fixture
def simulated(tmp_path: Path) -> Callable[[Config], Path]:
    def make(config: Config) -> Path:
        out = tmp_path / "again"
        out.mkdir()
        simulate_campaign(config, out)
        return out

    return make


@ONE_CORE
def test_one_core_writes_the_same_campaign(micro_campaign: Path, tmp_path: Path) -> None:
    """Rationale: a laboratory with another machine must be able to repeat a campaign from its configuration and seed.

    Expected: every file the same, truth and manifest included. Tolerance: none, bytes.
    """
    out = tmp_path / "one_core"
    out.mkdir()
    on_one_core(MAKE_MICRO, Path(__file__).with_name("conftest.py"), out)
    assert len(digests(out)) > 20
    assert different(micro_campaign, out) == set()


@pytest.mark.slow
def test_kernels_just_compiled_and_kept_ones_write_the_same_campaign(tmp_path: Path) -> None:
    """Rationale: the first run in a new home compiles, later ones load what it kept. Sums whose order the compiler chose came out
    otherwise in the two, and a few of 22 000 pulses of the ranging line with them. Expected: every file the same. Tolerance: none.
    """
    folders = [tmp_path / name for name in ("compiled", "kept")]
    for folder in folders:
        folder.mkdir()
        code = [sys.executable, "-c", MAKE_MICRO, str(Path(__file__).with_name("conftest.py")), str(folder)]
        subprocess.run(code, check=True, timeout=600, env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")})
    assert list((tmp_path / "kernels").rglob("*.nbc"))
    assert different(*folders) == set()


def test_chunks_do_not_show(
    micro_campaign: Path, micro: Callable[..., Config], simulated: Callable[[Config], Path]
) -> None:
    """Rationale: the chunk's size bounds memory; it must not be a parameter of the physics.

    Expected: all files but the configuration as run, which states the size, and truth.json, which holds that file's checksum.
    The strip must be longer than one small chunk, or nothing would be tested. Tolerance: none, bytes.
    """
    with laspy.open(micro_campaign / "sorties/01/lidar/strip_01.las") as las:
        assert las.header.point_count > 70_000
    out = simulated(micro("recording.pulses_per_chunk=131072"))
    assert different(micro_campaign, out) == {"truth/campaign.toml", "truth/truth.json"}


def test_another_seed_is_another_campaign(
    micro_campaign: Path, micro: Callable[..., Config], simulated: Callable[[Config], Path]
) -> None:
    """Expected: images, echoes, packets, trajectory, survey and both certificates all differ (the control of the tests above),
    what was built and planned does not."""
    changed = different(micro_campaign, simulated(micro("seed=918273646")))
    lidar, images = "sorties/01/lidar/strip_01", "sorties/01/images/s01_l01_001"
    assert changed >= {f"{lidar}.las", f"{lidar}.wdp", f"{lidar}_points.laz", f"{images}.tif", f"{images}.jpg"}
    assert changed >= {"sorties/01/trajectory.out", "survey/targets.csv", "survey/spectra.csv"}
    assert changed >= {"sensors/camera.json", "sensors/lidar.json"}
    assert "sensors/rig.json" not in changed


@ONE_CORE
def test_evaluation_gives_the_same_bytes(tiny_run: Path, tmp_path: Path) -> None:
    """Rationale: two laboratories that evaluate one folder must get one file; sums of a BLAS with several threads differ in
    their last digits. Expected: results.json the same again, in this process and in one that has one core. Tolerance: none.
    """
    known = (tiny_run / "results" / "results.json").read_bytes()
    write_results(tmp_path / "again.json", evaluate_campaign(tiny_run / "campaign"))
    assert (tmp_path / "again.json").read_bytes() == known
    on_one_core(EVALUATE, tiny_run / "campaign", tmp_path / "one_core.json")
    assert (tmp_path / "one_core.json").read_bytes() == known
