"""What is kept of a campaign's renders serves another noise, and does not show in its bytes."""

import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest

from campaign.config import Config
from simulator.simulate import simulate_campaign

SEEN = frozenset({"camera", "bench"})
NOISE = (
    "seed=5",
    'navigation.grade="apx15"',
    "camera.read_noise_e=9.0",
    "camera.black_level_dn=300.0",
    "faults.camera_gain=0.9",
    "lidar.noise_dn=3.0",
    "bench.sphere.noise_percent=0.05",
)


@pytest.mark.slow
def test_another_noise_renders_nothing(micro: Callable[..., Config], tmp_path: Path) -> None:
    """Rationale: rendering takes most of a campaign's time, and noise, gain and navigation are what is varied. Expected: with them
    changed no file is added to those of the first run (a frame, the boards, the sphere), and each is read. Control: a changed lens
    adds as many again. All bytes of the pictures are those of a run that keeps nothing, but for the configuration as run."""
    cache = tmp_path / "cache"

    def simulate(name: str, *settings: str) -> Path:
        out = tmp_path / name
        out.mkdir()
        simulate_campaign(micro("scene_seed=3", *settings), out, only=SEEN)
        return out

    def pictures(folder: Path) -> dict[str, str]:
        files = [p for p in folder.rglob("*") if p.suffix in (".tif", ".jpg", ".csv")]
        return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}

    keep = f'render.cache="{cache}"'
    first = simulate("first", keep)
    kept = {path: path.stat().st_mtime_ns for path in cache.iterdir()}
    assert len(kept) > 10
    again = simulate("again", keep, *NOISE)
    used = {path: path.stat().st_mtime_ns for path in cache.iterdir()}
    assert used.keys() == kept.keys()
    assert all(used[path] > kept[path] for path in kept)
    assert pictures(again) == pictures(simulate("without", *NOISE))
    assert not {p for p in pictures(first).items() if p[0].endswith(".tif")} & set(pictures(again).items())
    simulate("control", keep, "camera.lens.k1=-0.047")
    assert len(list(cache.iterdir())) > 1.9 * len(kept)
