"""What a laboratory gets wrong at the benches and on the ranging line: a reason at the indicator, and the others come out."""

import csv
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import tifffile

from campaign.load import load_config
from campaign.manifest import read_manifest, write_manifest
from evaluator.results import read_results

TINY = Path(__file__).parents[1] / "data" / "tiny.toml"
SMALL = (
    'campaign.parts=["bench", "ranging"]',
    "camera.width_px=768",
    "camera.height_px=512",
    "camera.pixel_size_um=18.0",
    "camera.lens.fx_px=751.05",
    "camera.lens.fy_px=750.9",
    "camera.lens.cx_px=385.3",
    "camera.lens.cy_px=254.85",
)
INDICATORS = ("camera_stability", "camera_repeatability", "lidar_ranging_rmse_relative", "camera_reprojection_error")


@pytest.fixture(scope="module")
def benches(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder that holds benches and ranging line alone."""
    from simulator.simulate import simulate_campaign

    out = tmp_path_factory.mktemp("benches") / "campaign"
    out.mkdir()
    simulate_campaign(load_config(TINY, SMALL), out)
    yield out
    shutil.rmtree(out, ignore_errors=True)


@pytest.fixture
def copy(benches: Path, tmp_path: Path) -> Path:
    """A copy to damage."""
    return Path(shutil.copytree(benches, tmp_path / "campaign"))


def evaluated(root: Path) -> dict[str, dict]:
    """results.json of a folder whose manifest knows its files: the operator made the mistake, nobody changed it later."""
    from testrange.pipeline import evaluate

    write_manifest(root, read_manifest(root))
    evaluate(root, root.parent / "results", lambda stage, done, total: None)
    return read_results(root.parent / "results" / "results.json")


def rows_of(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        return list(reader.fieldnames or ()), list(reader)


def rewrite(path: Path, change: Callable[[list[dict[str, str]]], list[dict[str, str]]]) -> None:
    header, rows = rows_of(path)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, header)
        writer.writeheader()
        writer.writerows(change(rows))


def others_stand(results: dict[str, dict], *without: str) -> None:
    """The other bench indicators have a value."""
    for name in INDICATORS:
        if name not in without:
            assert results["indicators"][name]["value"] is not None, results["indicators"][name]["reason"]


def failed(results: dict[str, dict], clause: str) -> list[str]:
    return [r["measured"] for r in results["conformity"] if r["clause"].startswith(clause) and r["status"] == "fail"]


def test_sound(benches: Path, tmp_path: Path) -> None:
    """Rationale: a folder with nothing but benches and ranging line. Expected: its four indicators with grades, the other four
    with a reason; M_z within the best grade; no bench clause fails."""
    results = evaluated(Path(shutil.copytree(benches, tmp_path / "campaign")))
    others_stand(results)
    assert results["indicators"]["camera_reprojection_error"]["value"] <= 0.3
    for name, block in results["indicators"].items():
        assert (block["value"] is None) == (name not in INDICATORS)
        assert block["value"] is not None or block["reason"]
    assert not [r for r in results["conformity"] if r["status"] == "fail"]
    assert not results["problems"]


def test_too_few_images(copy: Path) -> None:
    """Expected: three images of the board give no calibration and a reason that counts them."""
    rewrite(copy / "bench" / "chessboard" / "log.csv", lambda rows: rows[:3])
    results = evaluated(copy)
    others_stand(results, "camera_reprojection_error")
    block = results["indicators"]["camera_reprojection_error"]
    assert block["value"] is None and "3" in block["reason"]


def test_one_distance(copy: Path) -> None:
    """Expected: images of one distance alone fail 9.2.2 d, with a value or a reason at the indicator."""
    log = copy / "bench" / "chessboard" / "log.csv"
    nearest = min(float(r["distance_m"]) for r in rows_of(log)[1])
    rewrite(log, lambda rows: [r for r in rows if float(r["distance_m"]) == nearest])
    results = evaluated(copy)
    others_stand(results, "camera_reprojection_error")
    block = results["indicators"]["camera_reprojection_error"]
    assert block["value"] is not None or block["reason"]
    assert failed(results, "9.2.2 d")


def test_wrong_board(copy: Path) -> None:
    """Expected: a board of another size than board.json states is found nowhere, and the reason names the size stated."""
    path = copy / "bench" / "chessboard" / "board.json"
    board = json.loads(path.read_text())
    path.write_text(json.dumps(board | {"inner_columns": 9, "inner_rows": 6}))
    results = evaluated(copy)
    others_stand(results, "camera_reprojection_error")
    block = results["indicators"]["camera_reprojection_error"]
    assert block["value"] is None
    assert "9" in block["reason"] and "6" in block["reason"]


def test_saturated_sphere(copy: Path) -> None:
    """Expected: a repeatability series at full scale has no value; stability, and the rest, do."""
    for path in sorted((copy / "bench" / "sphere_repeatability").glob("*.tif")):
        dn = tifffile.imread(path)
        tifffile.imwrite(path, np.full_like(dn, 16383), photometric="rgb")
    results = evaluated(copy)
    others_stand(results, "camera_repeatability")
    block = results["indicators"]["camera_repeatability"]
    assert block["value"] is None and "saturat" in block["reason"]


@pytest.mark.parametrize("series", ["sphere_stability", "chessboard"])
def test_images_of_mixed_size(copy: Path, series: str) -> None:
    """Expected: images of another size are named; the indicator has a value from the others, or the reason."""
    paths = sorted((copy / "bench" / series).glob("*.tif"))
    for path in paths[1::4]:
        tifffile.imwrite(path, tifffile.imread(path)[:-32], photometric="rgb")
    results = evaluated(copy)
    name = {"sphere_stability": "camera_stability", "chessboard": "camera_reprojection_error"}[series]
    others_stand(results, name)
    block = results["indicators"][name]
    told = json.dumps(block["companions"]) + str(block["reason"])
    assert paths[1].name in told or "size" in str(block["reason"])


def test_a_missing_reading(copy: Path) -> None:
    """Expected: one empty cell leaves one reading out, names it, and the indicator stands."""

    def without_one(rows: list[dict[str, str]]) -> list[dict[str, str]]:
        rows[3]["slope_distance_m"] = ""
        return rows

    rewrite(copy / "ranging" / "total_station.csv", without_one)
    results = evaluated(copy)
    others_stand(results)
    panel = rows_of(copy / "ranging" / "total_station.csv")[1][3]["panel"]
    assert panel in json.dumps(
        [results["indicators"]["lidar_ranging_rmse_relative"]["companions"], results["problems"]]
    )
    assert failed(results, "9.1.2 c")


def test_four_panels(copy: Path) -> None:
    """Expected: four panels are fewer than the clause asks for: no value, and the reason counts them."""
    keep = [p["id"] for p in json.loads((copy / "ranging" / "line.json").read_text())["panels"]][:4]
    rewrite(copy / "ranging" / "total_station.csv", lambda rows: [r for r in rows if r["panel"] in keep])
    results = evaluated(copy)
    others_stand(results, "lidar_ranging_rmse_relative")
    block = results["indicators"]["lidar_ranging_rmse_relative"]
    assert block["value"] is None and "4" in block["reason"]
    assert failed(results, "9.1.2 a")


@pytest.mark.parametrize("folder", ["bench/sphere_stability", "bench/chessboard", "ranging"])
def test_a_part_is_absent(copy: Path, folder: str) -> None:
    """Expected: evaluate takes any subset of the parts; what is absent says so."""
    shutil.rmtree(copy / folder)
    results = evaluated(copy)
    gone = {
        "bench/sphere_stability": "camera_stability",
        "bench/chessboard": "camera_reprojection_error",
        "ranging": "lidar_ranging_rmse_relative",
    }[folder]
    others_stand(results, gone)
    block = results["indicators"][gone]
    assert block["value"] is None and "no " in block["reason"]


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("bench/chessboard/board.json", b'{"inner_columns": 1e9}'),
        ("bench/chessboard/log.csv", b"image\n../../../etc/passwd\n"),
        ("bench/sphere_stability/log.csv", b"\xff\xfe\x00"),
        ("ranging/line.json", b"[]"),
        ("ranging/scans/scan_01.laz", b"LASF" + bytes(400)),
        ("bench/chessboard/b_001.tif", b"II*\0\xff\xff\xff\xff"),
        (
            "bench/sphere_repeatability/s_001.tif",
            b"\x89PNG\r\n\x1a\n" + b"\0\0\0\rIHDR" + b"\x7f\xff\xff\xff" * 2 + b"\x10\2",
        ),
    ],
)
def test_hostile_files(copy: Path, file: str, content: bytes, capsys: pytest.CaptureFixture[str]) -> None:
    """Expected: `evaluate` says in one line what is wrong with the file; with --keep-going the rest is evaluated."""
    from testrange import cli

    assert (copy / file).is_file()
    (copy / file).write_bytes(content)
    write_manifest(copy, read_manifest(copy))
    out = copy.parent / "results"
    code = cli.call(["evaluate", str(copy), "--out", str(out), "--quiet"])
    told = capsys.readouterr().err
    assert code == 1 and told.count("\n") == 1 and Path(file).name in told
    assert "internal error" not in told
    assert not out.exists()
    assert cli.call(["evaluate", str(copy), "--out", str(out), "--quiet", "--keep-going"]) == 0
    measured = [n for n, b in read_results(out / "results.json")["indicators"].items() if b["value"] is not None]
    assert len(measured) >= 3
