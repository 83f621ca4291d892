"""Exports: complete or not at all, the same bytes, one line for what is missing. Contents: contract/test_export_readers.py."""

import importlib
import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from campaign.errors import CampaignError, TestrangeError
from evaluator.model import EvaluationError
from testrange.export import FORMATS, Format, export_campaign
from testrange.export.source import open_source


def contents(root: Path) -> dict[str, bytes]:
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()}


@pytest.mark.parametrize("to", FORMATS)
def test_same_campaign_same_bytes(tiny_run: Path, tmp_path: Path, to: Format) -> None:
    """Rationale: no time of day, no absolute path. Expected: two exports are equal, and none names where the campaign stands."""
    first = export_campaign(tiny_run / "campaign", tmp_path / "a" / "one", to, results=tiny_run / "results")
    export_campaign(tiny_run / "campaign", tmp_path / "b" / "two", to, results=tiny_run / "results" / "results.json")
    one, two = contents(tmp_path / "a" / "one"), contents(tmp_path / "b" / "two")
    assert one == two
    assert [p.relative_to(tmp_path / "a" / "one").as_posix() for p in first] == sorted(one)
    assert not [name for name, raw in one.items() if str(tiny_run).encode() in raw]
    readme = one["README.md"].decode()
    assert (
        "虚拟检测场仿真数据 / synthetic data of a virtual range" in readme
        and "mountings and clocks: adjusted" in readme
    )


def drop(name: str) -> Callable[[Path], object]:
    return lambda root: (root / name).unlink()


def rewrite(name: str, change: Callable[[dict[str, object]], object]) -> Callable[[Path], object]:
    def write(root: Path) -> None:
        content = json.loads((root / name).read_bytes())
        change(content)
        (root / name).write_text(json.dumps(content))

    return write


@pytest.mark.parametrize(
    ("spoil", "to", "message"),
    [
        (drop("sensors/camera.json"), "colmap", "sensors/camera.json"),
        (drop("sensors/rig.json"), "odm", "without sensors/rig.json"),
        (drop("sorties/01/images/s01_l01_001.tif"), "odm", "s01_l01_001.tif: no such file"),
        (lambda r: shutil.rmtree(r / "sorties"), "colmap", "no image that can be placed"),
        (lambda r: shutil.rmtree(r / "sorties"), "clouds", "no LiDAR strip"),
        (lambda r: (r / "sorties/01/lidar/strip_01.las").write_bytes(b"LASF"), "clouds", "strip_01.las"),
        (lambda r: (r / "sorties/01/lidar/strip_01.las").write_bytes(b"LASF"), "mcap", "strip_01.las"),
    ],
)
def test_what_is_missing_is_one_line_and_nothing_is_left(
    tiny_copy: Path, tmp_path: Path, spoil: Callable[[Path], object], to: Format, message: str
) -> None:
    spoil(tiny_copy)
    with pytest.raises(TestrangeError, match=message) as caught:
        export_campaign(tiny_copy, tmp_path / "out", to)
    assert "\n" not in str(caught.value)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["campaign"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(campaign="other"), "results of another campaign"),
        (
            lambda c: c["mounting"].update(body_from_camera={"rotation": [[1]], "lever_arm_m": [0, 0, 0]}),
            "mounting block",
        ),
        (lambda c: c["mounting"]["body_from_lidar"].update(rotation=np.diag([1, 1, -1]).tolist()), "mounting block"),
        (lambda c: c["mounting"]["body_from_camera"].update(lever_arm_m=["a", 0, 0]), "mounting block"),
        (lambda c: c["mounting"].pop("names"), "mounting block"),
        (lambda c: c.update(indicators={}), "mounting block"),
    ],
)
def test_results_are_not_trusted(
    tiny_run: Path, tmp_path: Path, change: Callable[[dict[str, object]], object], message: str
) -> None:
    shutil.copy(tiny_run / "results" / "results.json", tmp_path)
    rewrite("results.json", change)(tmp_path)
    with pytest.raises(EvaluationError, match=message):
        open_source(tiny_run / "campaign", tmp_path)


def test_results_without_a_mounting_leave_the_nominal_one(tiny_run: Path, tmp_path: Path) -> None:
    """Expected: the export says why, and takes the sheets."""
    shutil.copy(tiny_run / "results" / "results.json", tmp_path)
    rewrite("results.json", lambda c: c.update(mounting={"status": "not_measured", "reason": "no frustum"}))(tmp_path)
    plain, given = (open_source(tiny_run / "campaign", r) for r in (None, tmp_path))
    assert not given.adjusted and "no adjusted mounting: no frustum" in given.basis
    assert plain.body_from_camera is not None and given.body_from_camera is not None
    np.testing.assert_array_equal(plain.body_from_camera.rotation, given.body_from_camera.rotation)


def test_names_are_unique_across_sorties(tiny_copy: Path) -> None:
    """Rationale: cameras count from DSC_0001 on every flight, and ODM has one folder. Expected: the sortie stands in front."""
    for place in sorted((tiny_copy / "sorties").iterdir()):
        text = (place / "images" / "exposures.csv").read_text()
        for old in sorted((place / "images").glob("*.tif")):
            new = f"DSC_{old.stem[-7:]}.tif"
            text = text.replace(old.name, new)
            old.rename(old.with_name(new))
        (place / "images" / "exposures.csv").write_text(text)
    names = [shot.name for shot in open_source(tiny_copy, None).shots()]
    assert names == ["s01_DSC_l01_001", "s01_DSC_l02_001", "s02_DSC_l01_001", "s02_DSC_l02_001"]


def test_picks_of_a_person_become_ground_control(tiny_copy: Path, tmp_path: Path) -> None:
    """Expected: the person's pixel, half a pixel less, in the place of the evaluator's."""
    (tiny_copy / "sorties/01/observations_camera.csv").write_text(
        "target,image,u_px,v_px\nF01,s01_l01_001.tif,700.25,500.75\n"
    )
    export_campaign(tiny_copy, tmp_path / "out", "odm")
    lines = [line.split() for line in (tmp_path / "out" / "gcp_list.txt").read_text().splitlines()[1:]]
    (pick,) = [line for line in lines if line[5:] == ["s01_l01_001.jpg", "F01"]]
    assert pick[3:5] == ["699.750", "500.250"]
    assert len(lines) > 10


def test_what_the_evaluation_wrote_is_not_found_again(tiny_run: Path, tmp_path: Path) -> None:
    """Rationale: the export's control points are those of the handbooks. Expected: the pixels of results/observations alone, a
    panel's corners not among them, blunders left out.
    """
    shutil.copy(tiny_run / "results" / "results.json", tmp_path)
    blunder = "rejected", ["mark of F02 in s01_l01_001.tif (sortie 1)"]
    rewrite("results.json", lambda c: c["mounting"].update([blunder]))(tmp_path)  # type: ignore[attr-defined]
    for sortie in ("01", "02"):
        image = f"s{sortie}_l01_001.tif"
        rows = [("F01", 700.25, 500.75), ("F02", 1.0, 2.0), ("P01", 3.0, 4.0), ("P01", 5.0, 4.0), ("F03", 9000.0, 1.0)]
        text = "".join(f"{target},{image},{u},{v}\n" for target, u, v in rows)
        (tmp_path / "observations" / sortie).mkdir(parents=True)
        (tmp_path / "observations" / sortie / "observations_camera.csv").write_text("target,image,u_px,v_px\n" + text)
    export_campaign(tiny_run / "campaign", tmp_path / "out", "odm", results=tmp_path)
    lines = [line.split()[3:] for line in (tmp_path / "out" / "gcp_list.txt").read_text().splitlines()[1:]]
    assert lines == [
        ["699.750", "500.250", "s01_l01_001.jpg", "F01"],
        ["699.750", "500.250", "s02_l01_001.jpg", "F01"],
        ["0.500", "1.500", "s02_l01_001.jpg", "F02"],
    ]


def test_targets_occupied_or_unknown_are_refused(tiny_run: Path, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    with pytest.raises(CampaignError, match="already exists"):
        export_campaign(tiny_run / "campaign", tmp_path / "full", "colmap")
    with pytest.raises(CampaignError, match="no such format; got ply; expected colmap, odm, clouds, mcap"):
        export_campaign(tiny_run / "campaign", tmp_path / "out", "ply")  # type: ignore[arg-type]
    (tmp_path / "one.mcap").touch()
    with pytest.raises(CampaignError, match="already exists"):
        export_campaign(tiny_run / "campaign", tmp_path / "one.mcap", "mcap")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["full", "one.mcap"]
    inside = tiny_run / "campaign" / "sorties" / "colmap"  # would be a file that the manifest does not know
    with pytest.raises(CampaignError, match="lies inside the campaign that is exported"):
        export_campaign(tiny_run / "campaign", inside, "colmap")
    assert not inside.exists()


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Expected: one line that says what to install."""
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    monkeypatch.delitem(sys.modules, "testrange.export.bag", raising=False)
    with pytest.raises(CampaignError, match=r"mcap is not installed; \.venv/bin/python -m pip install mcap"):
        importlib.import_module("testrange.export.bag")
