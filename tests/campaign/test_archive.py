"""The archive of 10.3: whole, the same bytes every time, and nothing hostile gets through its check."""

import csv
import io
import json
import os
import shutil
import stat
import struct
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import bagit
import pytest

from campaign.archive.check import check_archive, is_archive
from campaign.archive.pack import MANIFEST, write_archive
from campaign.checks.folder import check_campaign
from campaign.errors import CampaignError
from campaign.folder import CampaignFolder
from campaign.manifest import read_manifest, write_manifest

STRIP = "data/campaign/sorties/01/lidar/strip_01.las"


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """As much of a results folder as an archive looks at."""
    folder = tmp_path / "results"
    folder.mkdir()
    indicator = {
        "clause": "9.3",
        "name": "Calibration <error>",
        "name_zh": "平均标定误差",
        "value": 0.24021138890443142,
        "unit": "pixel",
        "grade": "excellent",
        "grade_zh": "优",
    }
    content = {"campaign": "hand", "indicators": {"calibration_error": indicator}}
    (folder / "results.json").write_text(json.dumps(content))
    (folder / "报告.pdf").write_bytes(b"%PDF-1.7 made by hand")
    return folder


@pytest.fixture
def packed(hand_campaign: CampaignFolder, results: Path, tmp_path: Path) -> Path:
    """A .zip."""
    write_archive(hand_campaign.root, results, tmp_path / "hand.zip")
    return tmp_path / "hand.zip"


@pytest.fixture
def bag(hand_campaign: CampaignFolder, results: Path, tmp_path: Path) -> Path:
    """A folder."""
    write_archive(hand_campaign.root, results, tmp_path / "bag")
    return tmp_path / "bag"


def errors(path: Path) -> list[str]:
    return [str(p) for p in check_archive(path) if p.severity == "error"]


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text("utf-8-sig"))))


def contents(root: Path) -> dict[str, bytes]:
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def test_another_implementation_takes_the_bag(bag: Path, packed: Path, tmp_path: Path) -> None:
    """Rationale: the laboratory checks with the Library of Congress' tool. Expected: valid, folder and unpacked zip alike."""
    bagit.Bag(str(bag)).validate()
    with zipfile.ZipFile(packed) as pack:
        pack.extractall(tmp_path / "unpacked")
    bagit.Bag(str(tmp_path / "unpacked" / "hand")).validate()
    assert contents(tmp_path / "unpacked" / "hand") == contents(bag)


def test_a_sound_archive_has_no_problem_and_holds_the_campaign(
    bag: Path, packed: Path, hand_campaign: CampaignFolder, results: Path
) -> None:
    """Expected: no problem; the campaign inside is the campaign, byte by byte, so that it can be evaluated again."""
    assert (check_archive(bag), check_archive(packed)) == ([], [])
    assert is_archive(bag) and is_archive(packed) and not is_archive(hand_campaign.root)
    assert contents(bag / "data/campaign") == contents(hand_campaign.root)
    assert contents(bag / "data/results") == contents(results)
    assert check_campaign(bag / "data/campaign") == []


def test_same_campaign_same_bytes(packed: Path, hand_campaign: CampaignFolder, results: Path, tmp_path: Path) -> None:
    """Rationale: no time of day, no order of a disk. Expected: equal bytes after the files' own times were changed."""
    for path in hand_campaign.root.rglob("*"):
        os.utime(path, (1_000_000_000, 1_000_000_000))
    write_archive(hand_campaign.root, results, tmp_path / "again.zip")
    assert (tmp_path / "again.zip").read_bytes() == packed.read_bytes()
    info = zipfile.ZipFile(packed).getinfo("hand/bag-info.txt")
    assert info.date_time == (2026, 6, 9, 0, 0, 0)


def test_every_file_has_its_place_in_a_to_e(bag: Path) -> None:
    """Rationale: 10.3 a-e. Expected: images b, point clouds c, results d, the rest e; every payload file named once."""
    listed = {r["path"]: r["category"] for r in rows(bag / "data/item_list.csv")}
    on_disk = {p.relative_to(bag / "data").as_posix() for p in (bag / "data").rglob("*") if p.is_file()}
    assert set(listed) == on_disk
    assert listed["campaign/sorties/01/images/DSC_0000.tif"] == "b"
    assert listed["campaign/sorties/01/lidar/strip_01.wdp"] == "c"
    assert listed["results/报告.pdf"] == "d"
    assert listed["item_list.csv"] == listed["test_items.csv"] == "a"
    for name in ("manifest.json", "plan.json", "survey/targets.csv", "sensors/rig.json", "sorties/01/trajectory.out"):
        assert listed[f"campaign/{name}"] == "e"
    page = (bag / "data/item_list.html").read_text("utf-8")
    assert "Calibration &lt;error&gt;" in page and "<error>" not in page and "0.24021 pixel" in page
    assert "http" not in page.split("</style>")[1]
    (item,) = rows(bag / "data/test_items.csv")
    assert (item["id"], item["value"], item["grade"]) == ("calibration_error", "0.24021138890443142", "excellent")


def test_ro_crate_describes_every_file_with_dates_of_the_campaign(bag: Path) -> None:
    """Expected: RO-Crate 1.1 with the descriptor, the root and one entity a file; the campaign's date."""
    graph = json.loads((bag / "data/ro-crate-metadata.json").read_text("utf-8"))["@graph"]
    entities = {e["@id"]: e for e in graph}
    assert entities["ro-crate-metadata.json"]["conformsTo"]["@id"] == "https://w3id.org/ro/crate/1.1"
    root = entities["./"]
    assert root["datePublished"] == "2026-06-09"
    parts = [p["@id"] for p in root["hasPart"]]
    files = {i for i, e in entities.items() if e["@type"] == "File"}
    assert set(parts) == files and len(parts) == len(files)
    las = entities["campaign/sorties/01/lidar/strip_01.las"]
    assert las["contentSize"] == str((bag / STRIP).stat().st_size)
    assert "results/%E6%8A%A5%E5%91%8A.pdf" in files


def spoil_text(root: Path, name: str, old: str, new: str) -> None:
    path = root / name
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), "utf-8")


def link(root: Path) -> None:
    (root / STRIP).unlink()
    (root / STRIP).symlink_to("/etc/hostname")


def flip(root: Path) -> None:
    raw = bytearray((root / STRIP).read_bytes())
    raw[-1] ^= 1
    (root / STRIP).write_bytes(raw)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (flip, f"{STRIP}: checksum differs from {MANIFEST}"),
        (lambda r: (r / STRIP).unlink(), f"{STRIP}: missing; {MANIFEST} lists it"),
        (lambda r: (r / "data/more.txt").write_text("x"), f"data/more.txt: not in {MANIFEST}"),
        (link, f"{STRIP}: is no plain file"),
        (lambda r: os.mkfifo(r / "data/pipe"), "data/pipe: is no plain file"),
        (lambda r: spoil_text(r, MANIFEST, STRIP, "data/../../etc/passwd"), "a path leaves the archive"),
        (lambda r: spoil_text(r, MANIFEST, STRIP, "/etc/passwd"), "a path leaves the archive"),
        (lambda r: spoil_text(r, MANIFEST, STRIP, "data\\\\x"), "a path holds a character"),
        (lambda r: spoil_text(r, "bag-info.txt", "Bagging-Date: 2026", "Bagging-Date: 2025"), "bag-info.txt: checksum"),
        (lambda r: spoil_text(r, "bag-info.txt", "Payload-Oxum: ", "Payload-Oxum: 9"), "Payload-Oxum states 9"),
        (lambda r: spoil_text(r, "bagit.txt", "1.0", "9.0"), "bagit.txt: is no declaration"),
        (lambda r: (r / "fetch.txt").write_text("http://x 1 data/x\n"), "fetch.txt: the archive leaves files"),
        (lambda r: (r / MANIFEST).unlink(), f"{MANIFEST}: is missing"),
        (lambda r: (r / "data/campaign/manifest.json").write_text("{}"), "data/campaign/manifest.json: checksum"),
    ],
)
def test_what_is_wrong_with_a_folder_is_named(bag: Path, spoil: Callable[[Path], object], message: str) -> None:
    spoil(bag)
    assert any(message in line for line in errors(bag)), errors(bag)


def test_a_campaign_that_was_changed_before_it_was_packed_again_is_found(bag: Path) -> None:
    """Rationale: who repacks can make the bag's own lists agree. Expected: the campaign's manifest.json still tells."""
    flip(bag)
    old = bagit.Bag(str(bag))
    old.save(manifests=True)
    bagit.Bag(str(bag)).validate()
    assert any(f"{STRIP}: differs from the campaign's manifest.json" in line for line in errors(bag))


def repack(
    source: Path, target: Path, change: Callable[[zipfile.ZipInfo, bytes], tuple[zipfile.ZipInfo, bytes]]
) -> None:
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for info in old.infolist():
            new.writestr(*change(info, old.read(info)))


def as_link(info: zipfile.ZipInfo, raw: bytes) -> tuple[zipfile.ZipInfo, bytes]:
    if info.filename.endswith("plan.json"):
        info.external_attr = (stat.S_IFLNK | 0o777) << 16
    return info, raw


def outside(info: zipfile.ZipInfo, raw: bytes) -> tuple[zipfile.ZipInfo, bytes]:
    if info.filename.endswith("plan.json"):
        info.filename = "hand/../../plan.json"
    return info, raw


def beside(info: zipfile.ZipInfo, raw: bytes) -> tuple[zipfile.ZipInfo, bytes]:
    if info.filename.endswith("plan.json"):
        info.filename = "plan.json"
    return info, raw


def changed(info: zipfile.ZipInfo, raw: bytes) -> tuple[zipfile.ZipInfo, bytes]:
    return info, raw[:-1] + b"?" if info.filename.endswith("plan.json") else raw


def bomb(info: zipfile.ZipInfo, raw: bytes) -> tuple[zipfile.ZipInfo, bytes]:
    if info.filename.endswith(".wdp"):
        info.compress_type = zipfile.ZIP_DEFLATED
        raw = bytes(60_000_000)
    return info, raw


def lzma(info: zipfile.ZipInfo, raw: bytes) -> tuple[zipfile.ZipInfo, bytes]:
    info.compress_type = zipfile.ZIP_LZMA
    return info, raw


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (as_link, "plan.json: is a link or a device"),
        (outside, "its name leaves the archive"),
        (beside, "plan.json: stands outside the bag's folder"),
        (changed, "checksum differs"),
        (bomb, "expected at most 100 times"),
        (lzma, "is packed by method 14"),
    ],
)
def test_what_is_wrong_with_a_zip_is_named(
    packed: Path,
    tmp_path: Path,
    change: Callable[[zipfile.ZipInfo, bytes], tuple[zipfile.ZipInfo, bytes]],
    message: str,
) -> None:
    repack(packed, tmp_path / "spoiled.zip", change)
    assert any(message in line for line in errors(tmp_path / "spoiled.zip")), errors(tmp_path / "spoiled.zip")


def test_the_formats_of_a_packed_campaign_are_checked(
    hand_campaign: CampaignFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: lists and checksums of an archive say that nothing changed, not that it was ever a campaign. Expected: the same
    problems for the folder and the .zip, named by the place in the archive and by no temporary one, nothing left behind; a disk
    without room is a warning that says what was not checked. Tolerance: none."""
    path = hand_campaign.root / "sensors" / "camera.json"
    path.write_text(path.read_text().replace('"bit_depth"', '"bits"'))
    write_manifest(hand_campaign.root, read_manifest(hand_campaign.root))
    write_archive(hand_campaign.root, None, tmp_path / "odd")
    write_archive(hand_campaign.root, None, tmp_path / "odd.zip")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    folder, packed = check_archive(tmp_path / "odd"), check_archive(tmp_path / "odd.zip")
    assert folder == packed
    assert any(p.severity == "error" and p.where == "data/campaign/sensors/camera.json" for p in packed)
    assert not any(str(tmp_path) in f"{p.where} {p.message}" for p in packed)
    assert list(temporary.iterdir()) == []
    full = shutil.disk_usage(tmp_path)._replace(free=10)
    monkeypatch.setattr(shutil, "disk_usage", lambda place: full)
    told = check_archive(tmp_path / "odd.zip")
    assert [p.severity for p in told] == ["warning"] and "formats of the campaign not checked" in told[0].message


def directory_entry(raw: bytearray, name: str) -> int:
    """Where the central directory's entry of a file begins."""
    at = raw.rfind(name.encode()) - 46
    assert raw[at : at + 4] == b"PK\1\2"
    return at


def test_headers_that_lie_are_refused(packed: Path, tmp_path: Path) -> None:
    """Rationale: nothing in a zip binds its directory to its contents. Expected: an encryption bit, a size that is not the
    stored one, an entry laid over another's bytes, an entry twice, a huge directory and a cut file are each one line."""
    name = "hand/data/campaign/plan.json"

    def spoiled(change: Callable[[bytearray, int], None]) -> list[str]:
        raw = bytearray(packed.read_bytes())
        change(raw, directory_entry(raw, name))
        target = tmp_path / "lying.zip"
        target.write_bytes(raw)
        return errors(target)

    def put(form: str, offset: int, value: int) -> Callable[[bytearray, int], None]:
        return lambda raw, at: struct.pack_into(form, raw, at + offset, value)

    assert any("is encrypted" in line for line in spoiled(put("<H", 8, 1)))
    assert any("states 4000000000 bytes" in line for line in spoiled(put("<I", 24, 4_000_000_000)))
    assert any("shares bytes with another entry" in line for line in spoiled(put("<I", 42, 0)))
    assert any(
        "directory is too large" in line
        for line in spoiled(lambda raw, _: struct.pack_into("<I", raw, len(raw) - 10, 2**31))
    )
    assert any(
        "is no zip, or is truncated" in line for line in spoiled(lambda raw, _: raw.__delitem__(slice(-30, None)))
    )
    with pytest.warns(UserWarning, match="Duplicate name"), zipfile.ZipFile(packed, "a") as pack:
        pack.writestr(name, b"other")
    assert any("stands twice in the zip" in line for line in errors(packed))


def test_an_archive_is_refused_where_the_campaign_is_not_what_it_says(
    hand_campaign: CampaignFolder, results: Path, tmp_path: Path
) -> None:
    """Expected: one line each, and nothing left behind."""
    root, out = hand_campaign.root, tmp_path / "out.zip"
    plan = root / "plan.json"
    text = plan.read_text()

    def refused(match: str, results: Path | None = None, target: Path = out) -> None:
        with pytest.raises(CampaignError, match=match):
            write_archive(root, results, target)
        assert not out.exists()

    plan.write_text(text.replace("2026-06-30", "2026-07-30"))
    refused("plan.json was changed after manifest.json was written")
    plan.unlink()
    refused("plan.json is missing")
    plan.symlink_to("/etc/hostname")
    refused("is no plain file")
    plan.unlink()
    plan.write_text(text)
    refused("lies inside what is archived", target=root / "a.zip")
    (results / "results.json").write_text('{"campaign": "other"}')
    refused("results of another campaign", results)
    refused("no such folder", tmp_path / "nowhere")
    write_archive(root, None, out)
    with pytest.raises(CampaignError, match="already exists"):
        write_archive(root, None, out)
    assert check_archive(out) == []


def test_no_archive_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "x.zip").write_bytes(b"nothing")
    assert errors(tmp_path / "x.zip") == ["error: x.zip: is no zip, or is truncated"]
    (tmp_path / "empty").mkdir()
    assert errors(tmp_path / "empty") == ["error: bagit.txt: is missing"]
    with pytest.raises(CampaignError, match="no such archive"):
        check_archive(tmp_path / "nowhere.zip")
    shutil.rmtree(tmp_path / "empty")


@pytest.mark.parametrize("name", ["../../evil", "/abs", "a/b", "", ".", "..", "a\\b", "a\u2028b", "a\x00b"])
def test_a_campaign_whose_name_is_no_folder_is_refused(
    hand_campaign: CampaignFolder, tmp_path: Path, name: str
) -> None:
    """Rationale: the name becomes the folder inside the zip, from where "../.." would be unpacked beside the archive.
    Expected: one line, nothing written."""
    file = hand_campaign.root / "manifest.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "campaign": name}))
    with pytest.raises(CampaignError, match="names no folder"):
        write_archive(hand_campaign.root, None, tmp_path / "out.zip")
    assert not list(tmp_path.glob("*out*"))


@pytest.mark.parametrize("name", ["a\u2028b.txt", "a\u2029b.txt", "a\x85b.txt"])
def test_a_file_name_that_breaks_a_line_is_refused(
    hand_campaign: CampaignFolder, results: Path, tmp_path: Path, name: str
) -> None:
    """Rationale: a list of checksums is read by lines, and readers take these for ends of lines. Expected: refused when
    written; such an archive was written and then failed its own check."""
    (results / name).write_text("x")
    with pytest.raises(CampaignError, match="other systems cannot write"):
        write_archive(hand_campaign.root, results, tmp_path / "out.zip")


def test_a_day_that_is_none_is_refused_in_both_forms(hand_campaign: CampaignFolder, tmp_path: Path) -> None:
    """Rationale: the zip refused 30 February and the folder filed it. Expected: both refuse."""
    file = hand_campaign.root / "manifest.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "date": "2026-02-30"}))
    for out in ("out.zip", "out"):
        with pytest.raises(CampaignError, match="is no date"):
            write_archive(hand_campaign.root, None, tmp_path / out)


def test_a_suffix_in_capitals_is_a_zip(hand_campaign: CampaignFolder, tmp_path: Path) -> None:
    """Rationale: the check takes .ZIP for a zip. Expected: a file, not a folder of that name; sound."""
    write_archive(hand_campaign.root, None, tmp_path / "out.ZIP")
    assert (tmp_path / "out.ZIP").is_file()
    assert not errors(tmp_path / "out.ZIP")
