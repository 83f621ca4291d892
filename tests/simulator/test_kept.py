"""Arrays that are kept between runs: found by what they were made of, whole or made again, within a bound."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from campaign.errors import CampaignError
from simulator import kept
from simulator.kept import kept_array, kept_blocks, kept_bytes

BLOCKS = [np.arange(12, dtype=np.float32).reshape(3, 4), np.zeros((0, 4), np.uint8), np.array(7, np.int16)]


class Maker:
    """Gives the blocks, and counts how often it was asked."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self) -> Iterator[np.ndarray]:
        self.calls += 1
        yield from (block.copy() for block in BLOCKS)


def blocks(folder: Path, make: Maker, limit_gb: float = 1.0) -> list[np.ndarray]:
    return list(kept_blocks(str(folder), ("what", 1), make, limit_gb))


def same(found: list[np.ndarray]) -> bool:
    pairs = zip(found, BLOCKS, strict=True)
    return all(a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in pairs)


def array(folder: Path, number: int, limit_gb: float) -> np.ndarray:
    return kept_array(str(folder), number, lambda: np.full(125, float(number)), limit_gb)


def test_blocks_are_made_once(tmp_path: Path) -> None:
    """Expected: shapes, types and bytes as made, empty and zero-dimensional ones too; made once for one key, again for another, and
    each time without a folder. Tolerance: none, bytes."""
    make = Maker()
    assert same(blocks(tmp_path / "a" / "b", make)) and same(blocks(tmp_path / "a" / "b", make))
    assert make.calls == 1
    assert same(list(kept_blocks(str(tmp_path / "a" / "b"), ("what", 2), make)))
    assert make.calls == 2
    assert same(list(kept_blocks(None, ("what", 1), make)))
    assert make.calls == 3


def test_what_is_changed_by_its_user_is_not_kept_so(tmp_path: Path) -> None:
    """Rationale: noise is added in place. Expected: the kept numbers are those that were made."""
    for _ in range(2):
        found = kept_array(str(tmp_path), "k", lambda: np.ones(5))
        assert (found == 1.0).all()
        found += 1.0


@pytest.mark.parametrize("damage", ["cut", "cut head", "flipped", "longer", "huge", "empty", "other"])
def test_a_damaged_file_is_made_again(tmp_path: Path, damage: str) -> None:
    """Rationale: a power cut leaves short files, disks flip bits, and a wrong pixel would pass for a measurement. Expected: the
    numbers are as made, whatever the file holds, and the next run finds a sound file; a size that the file cannot hold takes no
    memory."""
    make = Maker()
    blocks(tmp_path, make)
    (file,) = tmp_path.iterdir()
    sound = file.read_bytes()
    head = len(b"testrange kept 1") + 40
    damaged = {
        "cut": sound[:-3],
        "cut head": sound[: head + 11],
        "flipped": sound[:130] + bytes([sound[130] ^ 1]) + sound[131:],
        "longer": sound + b"x",
        "huge": sound[: head + 12] + (2**60).to_bytes(8, "little") + sound[head + 20 :],
        "empty": b"",
        "other": sound.replace(file.stem.encode(), b"0" * 40),
    }[damage]
    assert damaged != sound
    file.write_bytes(damaged)
    assert same(blocks(tmp_path, make))
    assert make.calls == 2
    assert file.read_bytes() == sound
    assert same(blocks(tmp_path, make))
    assert make.calls == 2


def test_what_is_left_in_the_middle_is_not_kept(tmp_path: Path) -> None:
    """Expected: nothing remains when the user or the maker stops, and nothing passes for a whole file."""
    make = Maker()
    next(kept_blocks(str(tmp_path), ("what", 1), make))
    assert list(tmp_path.iterdir()) == []

    def failing() -> Iterator[np.ndarray]:
        yield BLOCKS[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(kept_blocks(str(tmp_path), ("what", 1), failing))
    assert list(tmp_path.iterdir()) == []


def test_the_folder_has_a_bound(tmp_path: Path) -> None:
    """Rationale: a year of studies fills a disk. Expected: of files of a bit over 1000 bytes under a limit of 4800 the four that
    were used last remain, and nothing that is not ours is touched, however old."""
    theirs = [tmp_path / "notes.txt", tmp_path / "0123.kept", tmp_path / f"{'a' * 39}g.kept"]
    for path in theirs:
        path.write_bytes(b"x" * 5000)
        os.utime(path, (1, 1))
    made = []
    for number in range(6):
        before = set(tmp_path.iterdir())
        array(tmp_path, number, 4.8e-6)
        (new,) = set(tmp_path.iterdir()) - before
        os.utime(new, (100 + number, 100 + number))
        made.append(new)
        if number == 3:  # the first is used again, so that the second is the oldest
            array(tmp_path, 0, 4.8e-6)
    assert [path.is_file() for path in made] == [True, False, False, True, True, True]
    assert all(path.is_file() for path in theirs)
    assert kept_bytes(tmp_path) <= 4800


def test_what_does_not_fit_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Expected: larger than the limit, or with little room on the disk, an array is made each time and leaves nothing; an abandoned
    part of a file goes, one in the making stays."""
    assert (array(tmp_path, 5, 9e-7) == 5.0).all()
    assert list(tmp_path.iterdir()) == []
    old, new = tmp_path / f"{'b' * 40}.01234567.part", tmp_path / f"{'b' * 40}.01234568.part"
    old.write_bytes(b"x")
    new.write_bytes(b"x")
    os.utime(old, (1, 1))
    assert (array(tmp_path, 5, 1e-3) == 5.0).all()
    assert not old.exists() and new.exists() and len(list(tmp_path.glob("*.kept"))) == 1
    monkeypatch.setattr(kept, "SPARE_BYTES", 1e18)
    assert (array(tmp_path, 6, 1e-3) == 6.0).all()
    assert len(list(tmp_path.glob("*.kept"))) == 1


def test_a_disk_that_is_full_is_no_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: what is kept saves time only. Expected: writing fails, the numbers are as made, nothing remains."""
    monkeypatch.setattr(kept, "_append", lambda *_: False)
    assert same(blocks(tmp_path, Maker()))
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(CampaignError, match="cannot be written") as told:
        blocks(tmp_path / "file", Maker())
    assert "\n" not in str(told.value)
