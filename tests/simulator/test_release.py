"""What an earlier run kept or began is used by the very same code only."""

from pathlib import Path

import pytest

from simulator import release


def test_an_edited_source_is_another_release(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: between two releases the version stays the same while a constant of the renderer, and with it every picture,
    changes. Expected: another name for any change of a source or data file, the same one for compiled files.
    """
    for package in ("campaign", "scenes", "simulator"):
        (tmp_path / package).mkdir()
    source, data = tmp_path / "simulator" / "release.py", tmp_path / "scenes" / "paint.csv"
    source.write_text("SAMPLES = 1024\n", encoding="utf-8")
    monkeypatch.setattr(release, "__file__", str(source))
    names = []

    def note() -> None:
        release.sources.cache_clear()
        names.append(release.release())

    note()
    (tmp_path / "simulator" / "__pycache__").mkdir()
    (tmp_path / "simulator" / "__pycache__" / "release.pyc").write_bytes(b"compiled")
    note()
    source.write_text("SAMPLES = 2048\n", encoding="utf-8")
    note()
    data.write_text("400,0.5\n", encoding="utf-8")
    note()
    monkeypatch.undo()
    release.sources.cache_clear()
    assert names[0] == names[1]
    assert len(set(names)) == 3
    assert release.release() not in names
