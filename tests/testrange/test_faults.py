"""The fault matrix' own logic: what a study says, which parts are simulated anew, what a verdict is."""

from pathlib import Path

import pytest

from campaign.config import PARTS
from campaign.errors import ConfigError
from campaign.load import load_config
from evaluator.mounting.diagnosis import family_limit
from testrange import faults

TINY = Path(__file__).parents[1] / "data" / "tiny.toml"


def case(shows: tuple[str, ...] = (), doubts: tuple[str, ...] = ()) -> faults.FaultCase:
    return faults.FaultCase(name="a fault", shows=shows, doubts=doubts)


def result(of: faults.FaultCase, z: dict[str, float], doubts: tuple[str, ...] = ()) -> faults.CaseResult:
    rows = tuple({"quantity": q, "z": v} for q, v in z.items())
    return faults.CaseResult(case=of, rows=rows, doubts=doubts, pairs=(), problems=())


def test_verdict() -> None:
    """Expected: only the injected quantity, on either side of zero, and only the doubted target, is "as injected"; what is missed
    and what shows besides is named."""
    assert result(case(("a",)), {"a": -9.0, "b": 3.9}).verdict(4.0) == "as injected"
    assert result(case(), {"a": 3.9, "b": -3.9}).verdict(4.0) == "as injected"
    assert result(case(("a",)), {"a": 3.9, "b": 5.0}).verdict(4.0) == "missed: a; besides: b"
    assert result(case((), ("F07",)), {"a": 0.0}, ("F07",)).verdict(4.0) == "as injected"
    assert result(case((), ("F07",)), {"a": 0.0}, ("F08",)).verdict(4.0) == "missed: F07; besides: F08"


def test_limit_is_for_the_family() -> None:
    """Expected: Phi^-1(1 - 0.005/m): 2.576 for one value, 3.891 for a hundred (tables of the normal distribution)."""
    assert family_limit(1) == pytest.approx(2.5758, abs=1e-4)
    assert family_limit(100) == pytest.approx(3.8906, abs=1e-4)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ('base = "quickstart"\n[[fault]]\nname = "x"\nset = ["seed=2"]\n', "seed=2"),
        ('base = "quickstart"\n[[fault]]\nname = "x"\nshow = []\n', "show"),
        ('base = "quickstart"\n', "fault"),
        ("base = 3\n", "base"),
    ],
)
def test_a_wrong_study_is_one_line(tmp_path: Path, text: str, word: str) -> None:
    path = tmp_path / "study.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as told:
        faults.load_study(path)
    assert word in str(told.value) and "\n" not in str(told.value)


def test_the_ready_made_study_loads_and_every_case_has_a_configuration() -> None:
    study = faults.load_study("faults")
    assert study.fault[0].name == "none"
    assert len({c.name for c in study.fault}) == len(study.fault)
    for each in study.fault:
        assert load_config(study.base, (*study.set, *each.set)).faults != (
            load_config(study.base, study.set).faults if each.set else None
        )


def test_only_what_a_fault_reaches_is_simulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: nineteen campaigns would take an hour; equal faults of a part give equal bytes.

    Expected: the first case simulates all four parts, a boresight of the camera its images alone, a range error the LiDAR and the
    ranging line, a survey error nothing but the paperwork; every assembled folder holds all four.
    """
    asked: list[frozenset[str]] = []

    def simulate(config: object, place: Path, only: frozenset[str]) -> None:
        asked.append(only)
        files = {
            "camera": "sorties/01/images/a.tif",
            "lidar": "sorties/01/lidar/a.las",
            "bench": "bench/chessboard/a.tif",
            "ranging": "ranging/line.json",
        }
        for part in only:
            path = place / files[part]
            path.parent.mkdir(parents=True)
            path.write_text(part)
        if not only:
            (place / "manifest.json").write_text("{}")

    monkeypatch.setattr("simulator.simulate.simulate_campaign", simulate)
    monkeypatch.setattr(faults, "read_manifest", lambda root: root)
    monkeypatch.setattr(faults, "write_manifest", lambda root, manifest: None)
    known: dict = {}
    cases = [
        ((), set(PARTS)),
        (("faults.camera_boresight_deg=[0.1, 0.0, 0.0]",), {"camera"}),
        (("faults.range_scale=1e-4",), {"lidar", "ranging"}),
        (("faults.k1=0.001",), {"camera", "bench"}),
        (('faults.survey_target="F01"', "faults.survey_error_m=[0.1, 0.0, 0.0]"), set()),
    ]
    for number, (settings, parts) in enumerate(cases):
        asked.clear()
        nothing = [
            f"faults.{s}_{k}=[0.0, 0.0, 0.0]" for s in ("camera", "lidar") for k in ("boresight_deg", "lever_arm_m")
        ]
        config = load_config(TINY, [*nothing, *settings])
        campaign = faults._assemble(config, tmp_path, number, known)
        assert set().union(*asked) == parts
        assert len(list(campaign.rglob("a.*"))) == 3 and (campaign / "ranging/line.json").is_file()
