"""A folder written by hand is sound; each way to spoil it is one line."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from campaign.checks.folder import check_campaign, check_config
from campaign.errors import CampaignError
from campaign.folder import CampaignFolder
from campaign.manifest import read_manifest, verify_files, write_manifest

SORTIE = "sorties/01"


def lines(folder: CampaignFolder, *, checksums: bool = True) -> list[str]:
    return [str(p) for p in check_campaign(folder.root, checksums=checksums)]


def replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def cut(path: Path, keep: float) -> None:
    raw = path.read_bytes()
    path.write_bytes(raw[: int(len(raw) * keep)])


def test_a_sound_folder_has_no_problem(hand_campaign: CampaignFolder) -> None:
    assert lines(hand_campaign) == []


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda r: replace(r / "survey/targets.csv", "520010.12345", "nan"),
            "row 2 column easting_m: wrong value; got 'nan'",
        ),
        (lambda r: replace(r / "survey/spectra.csv", "P01", "P02"), "no spectrum of panel P01"),
        (lambda r: cut(r / f"{SORTIE}/trajectory.out", 0.0), "trajectory.out: is empty"),
        (lambda r: (r / f"{SORTIE}/trajectory.out").unlink(), "trajectory.out: missing"),
        (lambda r: cut(r / f"{SORTIE}/lidar/strip_01.las", 0.5), "strip_01.las: is truncated"),
        (lambda r: cut(r / f"{SORTIE}/lidar/strip_01.wdp", 0.5), "strip_01.wdp: is shorter than its packets say"),
        (lambda r: (r / f"{SORTIE}/lidar/strip_01.wdp").unlink(), "strip_01.wdp: no such file"),
        (lambda r: cut(r / f"{SORTIE}/images/DSC_0000.tif", 0.5), "DSC_0000.tif: is truncated"),
        (lambda r: (r / f"{SORTIE}/images/DSC_0000.tif").unlink(), "named in exposures.csv, but missing"),
        (
            lambda r: tifffile.imwrite(
                r / f"{SORTIE}/images/DSC_0001.tif", np.zeros((9, 9, 3), np.uint16), photometric="rgb"
            ),
            "image of another size than the camera's sheet states; got 9 x 9 px, 3 bands; expected 96 x 64 px, 3 bands",
        ),
        (
            lambda r: replace(r / f"{SORTIE}/images/exposures.csv", "465000000.75", "465000900.0"),
            "time outside the trajectory",
        ),
        (
            lambda r: replace(r / f"{SORTIE}/images/exposures.csv", "DSC_0000.tif", "../x.tif"),
            "expected a file name without",
        ),
        (
            lambda r: replace(r / "sensors/lidar.json", '"sampling_ns": 1.0', '"sampling_ns": 2.0'),
            "another sampling interval",
        ),
        (
            lambda r: replace(r / "sensors/camera.json", '"bit_depth": 14', '"bit_depth": 40'),
            "sensors/camera.json: bit_depth",
        ),
        (lambda r: replace(r / "plan.json", '"aircraft"', '"airkraft"'), "plan.json: aircraft: Field required"),
        (lambda r: (r / f"{SORTIE}/environment.csv").write_text(""), "environment.csv: is empty"),
        (
            lambda r: (r / f"{SORTIE}/observations_camera.csv").write_text(
                "target,image,u_px,v_px\nF09,DSC_0000.tif,1,1\n"
            ),
            "target F09 is not in the survey",
        ),
        (lambda r: replace(r / "manifest.json", '"gps_week"', '"week"'), "manifest.json: gps_week: Field required"),
        (lambda r: replace(r / "manifest.json", "4549", "1"), "EPSG:1+5737: is no coordinate system"),
        (lambda r: (r / "manifest.json").unlink(), "is no campaign folder"),
    ],
)
def test_each_fault_is_a_line(hand_campaign: CampaignFolder, spoil: Callable[[Path], object], message: str) -> None:
    """Expected: an error whose line names the file and the fault, no absolute path, no line break."""
    spoil(hand_campaign.root)
    found = lines(hand_campaign, checksums=False)
    assert any(message in line for line in found), found
    assert all(len(line.splitlines()) == 1 and str(hand_campaign.root) not in line for line in found)
    hit = next(line for line in found if message in line)
    assert hit.startswith("error: ")


def test_several_faults_are_all_found(hand_campaign: CampaignFolder) -> None:
    replace(hand_campaign.targets, "520010.12345", "nan")
    cut(hand_campaign.sortie(1).strip_las(1), 0.5)
    hand_campaign.rig.write_text("{}")
    found = [line for line in lines(hand_campaign, checksums=False) if line.startswith("error")]
    assert {line.split(": ")[1] for line in found} >= {
        "survey/targets.csv",
        f"{SORTIE}/lidar/strip_01.las",
        "sensors/rig.json",
    }


def test_absent_parts_are_warnings(hand_campaign: CampaignFolder) -> None:
    """Rationale: a missing part never stops the rest (design of the folder). Expected: warnings only."""
    shutil.rmtree(hand_campaign.root / "survey")
    hand_campaign.plan.unlink()
    shutil.rmtree(hand_campaign.sortie(1).lidar)
    write_manifest(hand_campaign.root, read_manifest(hand_campaign.root))
    found = lines(hand_campaign)
    assert len(found) == 4
    assert all(line.startswith("warning: ") for line in found)


def test_an_absent_trajectory_is_a_warning(hand_campaign: CampaignFolder) -> None:
    """Rationale: any subset of a folder is legal; what the manifest does not list is not missed. Expected: no error line."""
    hand_campaign.sortie(1).trajectory_sbet.unlink()
    write_manifest(hand_campaign.root, read_manifest(hand_campaign.root))
    found = lines(hand_campaign)
    assert any("trajectory.out: missing; nothing of this sortie can be placed" in line for line in found)
    assert not any(line.startswith("error") for line in found)


def test_checksums(hand_campaign: CampaignFolder) -> None:
    """Expected: one byte changed is seen by SHA-256, not by the size; a surplus file is a warning; a missing one an error."""
    wdp = hand_campaign.sortie(1).lidar / "strip_01.wdp"
    raw = bytearray(wdp.read_bytes())
    raw[-1] ^= 1
    wdp.write_bytes(raw)
    assert lines(hand_campaign, checksums=False) == []
    assert lines(hand_campaign) == [
        f"error: {SORTIE}/lidar/strip_01.wdp: checksum differs; the file was changed after the manifest was written"
    ]
    (hand_campaign.root / "notes.txt").write_text("x")
    hand_campaign.gcp_list.unlink()
    found = lines(hand_campaign, checksums=False)
    assert found == ["error: survey/gcp_list.txt: missing", "warning: notes.txt: not in the manifest"]


def test_truth_is_not_in_the_manifest(hand_campaign: CampaignFolder) -> None:
    """Rationale: results must not change with truth/. Expected: the manifest does not name it and does not miss it."""
    before = hand_campaign.manifest.read_bytes()
    (hand_campaign.truth).mkdir()
    (hand_campaign.truth / "truth.json").write_text("{}")
    assert verify_files(hand_campaign.root, read_manifest(hand_campaign.root)) == []
    write_manifest(hand_campaign.root, read_manifest(hand_campaign.root))
    assert hand_campaign.manifest.read_bytes() == before
    assert any(line.startswith("error: truth/truth.json") for line in lines(hand_campaign))


@pytest.mark.parametrize("name", ["../outside.txt", "/etc/passwd", "survey/../../outside.txt", "a\\\\..\\\\b"])
def test_listed_names_cannot_leave_the_folder(hand_campaign: CampaignFolder, name: str) -> None:
    (hand_campaign.root.parent / "outside.txt").write_text("secret")
    replace(hand_campaign.manifest, "plan.json", name)
    assert any("leaves the campaign folder" in line for line in lines(hand_campaign))


def test_links_out_of_the_folder_are_not_followed(hand_campaign: CampaignFolder) -> None:
    outside = hand_campaign.root.parent / "outside"
    outside.mkdir()
    (outside / "plan.json").write_bytes(hand_campaign.plan.read_bytes())
    hand_campaign.plan.unlink()
    hand_campaign.plan.symlink_to(outside / "plan.json")
    assert "error: plan.json: leaves the campaign folder" in lines(hand_campaign)
    with pytest.raises(CampaignError, match="is no plain file"):
        write_manifest(hand_campaign.root, read_manifest(hand_campaign.root))


def test_no_folder_at_all(tmp_path: Path) -> None:
    assert [str(p) for p in check_campaign(tmp_path / "none")] == ["error: manifest.json: no such folder"]


def test_every_problem_of_a_configuration(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text('[campaign]\nid = "x"\n[lidar]\nprf_hz = 1.0\n')
    messages = [p.message for p in check_config(path)]
    assert messages == [
        'camera is missing; add it, or name a device with use = "…"',
        "lidar.prf_hz is not a setting; did you mean lidar.prr_hz?",
    ]
    assert check_config("quickstart") == []
