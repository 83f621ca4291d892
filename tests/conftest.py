"""One small campaign, simulated and evaluated once a test session, for every test that needs a whole folder.

Tests that change it copy it first (`tiny_copy`).
"""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

TINY = Path(__file__).parent / "data" / "tiny.toml"


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A finished run of tests/data/tiny.toml: campaign/ and results/ inside."""
    from campaign.load import load_config
    from testrange.pipeline import run

    out = tmp_path_factory.mktemp("tiny") / "run"
    run(load_config(TINY), out, lambda stage, done, total: None)
    yield out
    shutil.rmtree(out, ignore_errors=True)


@pytest.fixture
def tiny_copy(tiny_run: Path, tmp_path: Path) -> Path:
    """A copy of the small campaign's folder that a test may damage."""
    copy = tmp_path / "campaign"
    shutil.copytree(tiny_run / "campaign", copy)
    return copy
