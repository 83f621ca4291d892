"""The evaluator is blind: it computes from what a field campaign would have, and nothing of the truth stands outside truth/."""

import ast
import importlib.util
import json
import re
import shutil
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from campaign.config import Config
from evaluator.evaluate import evaluate_campaign
from evaluator.results import write_results
from simulator.simulate import simulate_campaign

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
TEXT = {".csv", ".json", ".txt", ".prj", ".toml"}


def results_of(campaign: Path, out: Path) -> bytes:
    write_results(out, evaluate_campaign(campaign))
    return out.read_bytes()


def test_results_are_the_same_without_truth(tiny_run: Path, tiny_copy: Path, tmp_path: Path) -> None:
    """Expected: the bytes that the run with truth/ wrote, from another folder too. Tolerance: none."""
    shutil.rmtree(tiny_copy / "truth")
    known = (tiny_run / "results" / "results.json").read_bytes()
    assert results_of(tiny_copy, tmp_path / "results.json") == known


def test_results_are_the_same_with_another_campaigns_truth(
    tiny_run: Path, tiny_copy: Path, tmp_path: Path, micro: Callable[..., Config], micro_campaign: Path
) -> None:
    """Rationale: a truth that is absent could be missed on purpose; a wrong one would be followed.

    Expected: no byte changes under the truth of a campaign with other seed, faults, targets' places and returns.
    """
    shutil.rmtree(tiny_copy / "truth")
    shutil.copytree(micro_campaign / "truth", tiny_copy / "truth")
    ours, theirs = (json.loads((c / "truth" / "truth.json").read_text()) for c in (tiny_run / "campaign", tiny_copy))
    for name in ("seed", "camera", "lidar", "range_offset_m"):
        assert ours[name] != theirs[name], name
    known = (tiny_run / "results" / "results.json").read_bytes()
    assert results_of(tiny_copy, tmp_path / "results.json") == known


def injected(config: Config) -> dict[str, float]:
    """Every fault, as configured and in the other forms that a leak could take: radians, sums with the nominal mounting."""
    out: dict[str, float] = {}
    for name, value in config.faults.model_dump().items():
        parts = value if isinstance(value, tuple) else (value,)
        for axis, part in enumerate(parts):
            if part is None or part == 0.0:  # not injected; zeros stand everywhere
                continue
            out[f"{name}[{axis}]"] = part
            if name.endswith("_deg"):
                out[f"{name}[{axis}] in radians"] = float(np.radians(part))
            if name.endswith("lever_arm_m"):
                nominal = getattr(config.platform, name.split("_")[0]).lever_arm_m[axis]
                out[f"{name}[{axis}] with nominal"] = nominal + part
    lens = config.camera.lens.model_dump()
    out |= {f"lens {name}": value for name, value in lens.items() if value not in (0.0, round(value))}
    return out | {"seed": float(config.seed)}


def outside_truth(campaign: Path) -> Iterator[Path]:
    for path in sorted(campaign.rglob("*")):
        if path.is_file() and path.relative_to(campaign).parts[0] != "truth":
            yield path


def numbers_in(path: Path) -> np.ndarray:
    return np.unique([abs(float(n)) for n in NUMBER.findall(path.read_text(encoding="utf-8"))])


def test_no_injected_value_stands_outside_truth(micro_campaign: Path, micro: Callable[..., Config]) -> None:
    """Rationale: an algorithm under test gets this folder; a fault, the seed or the true lens in it would be the answer.

    Expected: no number of a text file equals one to 1e-9 relative, no binary file holds one as a double, and the seed stands
    nowhere in digits. The control: truth/ itself is full of them, so the search finds what there is.
    """
    values = injected(micro())

    def leaks(path: Path) -> set[str]:
        content = path.read_bytes()
        found = {name for name, value in values.items() if struct.pack("<d", value) in content}
        found |= {name for name, value in values.items() if struct.pack("<d", -value) in content}
        if b"918273645" in content or struct.pack("<q", 918273645) in content:
            found.add("seed")
        if path.suffix in TEXT:
            seen = numbers_in(path)
            found |= {name for name, v in values.items() if np.isclose(seen, abs(v), rtol=1e-9, atol=0.0).any()}
        return found

    searched = list(outside_truth(micro_campaign))
    assert {path.suffix for path in searched} >= {".csv", ".json", ".las", ".wdp", ".laz", ".tif", ".jpg", ".out"}
    assert {path.name: leaks(path) for path in searched if leaks(path)} == {}
    known = leaks(micro_campaign / "truth" / "truth.json") | leaks(micro_campaign / "truth" / "campaign.toml")
    missing = {name for name in values.keys() - known if "radians" not in name}
    assert missing == set()


def test_true_and_estimated_trajectory_differ(tiny_run: Path) -> None:
    """Expected: the sortie's trajectory carries navigation errors of the instrument's size, millimetres to centimetres.

    Tolerance: two Gauss-Markov errors of 1-2 cm: between 1 mm and 10 cm RMS.
    """
    with np.load(tiny_run / "campaign" / "truth" / "trajectory.npz") as truth:
        height = truth["s01_ellipsoid_height_m"]
    table = np.fromfile(tiny_run / "campaign" / "sorties" / "01" / "trajectory.out", "<f8").reshape(-1, 17)
    assert 1e-3 < np.sqrt(np.mean((table[:, 3] - height) ** 2)) < 0.1


def test_results_name_no_place_and_no_time_of_day(tiny_run: Path) -> None:
    """Rationale: the same folder must give the same file anywhere and at any time.

    Expected: no string with a path of this run, and no date or clock time but those of the campaign's own plan.
    """
    text = (tiny_run / "results" / "results.json").read_text(encoding="utf-8")
    assert str(tiny_run) not in text
    assert "/tmp/" not in text and str(Path.home()) + "/" not in text
    strings = re.findall(r'"((?:[^"\\]|\\.)*)"', text)
    assert not [s for s in strings if re.search(r"^/|[A-Za-z]:\\", s)]
    plan = json.loads((tiny_run / "campaign" / "plan.json").read_text(encoding="utf-8"))
    own = plan["start_time"], plan["start_time"][:10], "UTC+08:00"
    rest = [re.sub("|".join(map(re.escape, own)), "", s) for s in strings]
    assert not [s for s in rest if re.search(r"\d{1,2}:\d{2}|20\d\d-\d\d-\d\d", s)]
    assert not [s for s in strings if "truth" in s.lower()]


def imported(module: ast.Module) -> set[str]:
    """Full names that a module imports, those inside functions too."""
    names: set[str] = set()
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {str(node.module)}
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in {
            "import_module",
            "__import__",
        }:
            names.add("a computed name")
    return names


SCORERS = {f"scores/score{of}.py" for of in ("", "_points", "_echoes", "_observations")}


def test_only_score_knows_where_the_truth_is() -> None:
    """Expected: in evaluator/ campaign.truth is imported by scores/ alone, these only by what shows or
    writes a score, and no other module mentions the folder: neither `.truth` of a CampaignFolder nor the word in a string.
    """
    package = Path(str(importlib.util.find_spec("evaluator").origin)).parent  # type: ignore[union-attr]
    modules = {p.relative_to(package).as_posix(): ast.parse(p.read_text("utf-8")) for p in package.rglob("*.py")}
    assert len(modules) > 20
    readers = {n for n, m in modules.items() if any(i.startswith("campaign.truth") for i in imported(m))}
    assert readers == SCORERS
    computed = {n for n, m in modules.items() if "a computed name" in imported(m)}
    assert computed == {"algorithms/load.py"}  # what the user names on the command line
    scorers = {n for n, m in modules.items() if any(i.startswith("evaluator.scores") for i in imported(m))}
    # `compare` has its child compare echoes with the truth after the evaluation is done.
    children = {"algorithms/apart.py", "algorithms/worker.py"}
    assert {n for n in scorers if not n.startswith("report/")} - SCORERS == children
    for name, module in modules.items():
        if name in SCORERS:
            continue
        attributes = {n.attr for n in ast.walk(module) if isinstance(n, ast.Attribute)}
        if not name.startswith("report/"):
            assert "truth" not in attributes, name
        documented = {
            id(node.body[0].value)
            for node in ast.walk(module)
            if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef)
            and node.body
            and isinstance(node.body[0], ast.Expr)
        }
        words = {
            n.value
            for n in ast.walk(module)
            if isinstance(n, ast.Constant) and isinstance(n.value, str) and id(n) not in documented
        }
        section = {"truth"} if name.startswith("report/") else set()  # the report has a section of that name
        assert not [w for w in words - section if w == "truth" or "truth/" in w], name


def test_a_campaign_without_a_sensor_still_keeps_its_secrets(tmp_path: Path, micro: Callable[..., Config]) -> None:
    """Expected: simulated with neither sensor, the folder still has truth/ and sheets, and the sheets state nominal values."""
    simulate_campaign(micro(), tmp_path, only=frozenset())
    rig = json.loads((tmp_path / "sensors" / "rig.json").read_text())
    config = micro()
    assert tuple(rig["camera"]["lever_arm_m"]) == config.platform.camera.lever_arm_m
    assert tuple(rig["lidar"]["lever_arm_m"]) == config.platform.lidar.lever_arm_m
    assert tuple(rig["camera"]["boresight_deg"]) == config.platform.camera.boresight_deg
    sheet = json.loads((tmp_path / "sensors" / "camera.json").read_text())["calibration"]
    drawn = np.array(list(sheet["lens"].values()))
    true = np.array(list(config.camera.lens.model_dump().values()))
    z = (drawn - true) / np.sqrt(np.diag(sheet["covariance"]))
    assert (z != 0).all() and pytest.approx(0.0, abs=4.5) == np.abs(z).max()
