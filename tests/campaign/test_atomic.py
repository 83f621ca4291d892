"""Folders and files appear complete or not at all."""

import errno
from pathlib import Path

import pytest

from campaign.atomic import complete_file, complete_folder
from campaign.errors import CampaignError


def test_a_folder_appears_only_when_complete(tmp_path: Path) -> None:
    target = tmp_path / "sub" / "out"
    with complete_folder(target) as work:
        (work / "a").write_text("1")
        assert not target.exists()
    assert (target / "a").read_text() == "1"
    assert [p.name for p in target.parent.iterdir()] == ["out"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_nothing_is_left_after_a_failure(tmp_path: Path, error: type[BaseException]) -> None:
    with pytest.raises(error), complete_folder(tmp_path / "out") as work:
        (work / "a").write_text("1")
        raise error
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="no space left on the disk"), complete_folder(tmp_path / "out"):
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(CampaignError, match="no space left on the disk"), complete_file(tmp_path / "f.csv") as work:
        work.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_an_occupied_target_is_kept(tmp_path: Path) -> None:
    """Rationale: deleting a user's folder is the worst that a tool can do."""
    target = tmp_path / "out"
    target.mkdir()
    (target / "thesis.tex").write_text("years of work")
    with pytest.raises(CampaignError, match="already exists"), complete_folder(target):
        pass
    with pytest.raises(CampaignError, match="does not look like"), complete_folder(target, replace=True):
        pass
    assert (target / "thesis.tex").read_text() == "years of work"
    (tmp_path / "link").symlink_to(target)
    with pytest.raises(CampaignError, match="is not a folder"), complete_folder(tmp_path / "link", replace=True):
        pass


def test_replace_swaps_our_own_folder_only_when_the_new_one_is_complete(tmp_path: Path) -> None:
    target = tmp_path / "out"
    target.mkdir()
    (target / "manifest.json").write_text("old")
    with pytest.raises(ValueError), complete_folder(target, replace=True) as work:
        (work / "manifest.json").write_text("new")
        raise ValueError
    assert (target / "manifest.json").read_text() == "old"
    with complete_folder(target, replace=True) as work:
        (work / "manifest.json").write_text("new")
    assert (target / "manifest.json").read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_an_unwritable_place_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CampaignError, match="cannot be written"), complete_folder(tmp_path / "file" / "out"):
        pass


@pytest.mark.parametrize("place", ["/", ".", "..", "folder"])
def test_a_file_to_write_has_a_name(tmp_path: Path, place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: `view --out /` ended in an internal error, and a folder of that name was found out only when all was written.
    Expected: one line, before the work."""
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CampaignError, match="is a folder"), complete_file(Path(place)):
        raise AssertionError("the work began")
