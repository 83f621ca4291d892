"""Evaluators broken on purpose are caught by verify, by name: the acceptance of issue 6."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from testrange.family.evaluate import evaluate_members
from testrange.family.make import make_family
from testrange.family.model import Family, load_family
from testrange.family.verify import Report, verify


def quiet(stage: str, done: int, total: int) -> None:
    """No progress."""


def made(out: Path, **changes: object) -> Path:
    family: Family = load_family("small").model_copy(
        update={"boundaries": False, "controls": False, "pairs": False, "violations": (), **changes}
    )
    result = make_family(family, out, quiet)
    assert not result.failed
    return out


def judged(family: Path, out: Path) -> Report:
    assert evaluate_members(family, out, quiet, workers=1) == []
    return verify(family, [out])


@pytest.fixture(scope="module")
def ranging(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    yield made(
        tmp_path_factory.mktemp("ranging") / "family",
        indicators=("lidar_ranging_rmse_relative",),
        grades=("excellent",),
    )


@pytest.mark.slow
def test_one_way_time_is_named(ranging: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: c t in the place of c t / 2 doubles every range; R2 takes it up and m_z does not show it. Expected: the sound
    evaluator is right; the broken one is named by R2."""
    from evaluator import c9_1_lidar_ranging as room

    assert judged(ranging, tmp_path / "sound").right
    sound = room.panel_ranges

    def one_way(*arguments: object) -> object:
        panels, not_used = sound(*arguments)  # type: ignore[arg-type]
        return [type(p)(**{**vars(p), "lidar_m": 2.0 * p.lidar_m}) for p in panels], not_used

    monkeypatch.setattr(room, "panel_ranges", one_way)
    report = judged(ranging, tmp_path / "broken")
    assert not report.right
    assert any("one-way time" in m for m in report.mistakes), report.block()


@pytest.mark.slow
def test_2n_for_2_n_minus_1_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: (8) with 2n gives 97.5 % of M_f, which grades rarely show. Expected: the sound evaluator is right; the broken one
    is named."""
    from evaluator import c8_3_reflectance_consistency as room

    family = made(tmp_path / "family", indicators=("reflectance_rmse_relative",), grades=("fair",))
    assert judged(family, tmp_path / "sound").right

    def two_n(lidar: object, camera: object) -> float:
        difference = np.asarray(lidar, float) - np.asarray(camera, float)
        return float(np.sqrt(np.sum(difference**2) / (2.0 * difference.size)))

    monkeypatch.setattr(room, "reflectance_rmse_relative", two_n)
    report = judged(family, tmp_path / "broken")
    assert report.mistakes == ("reflectance_rmse_relative: 2n in the place of 2(n - 1)",), report.block()


@pytest.mark.slow
def test_the_sign_of_one_boresight_angle_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: a convention turned round in one angle. Expected: that angle of that sensor, and no other, is named."""
    from dataclasses import replace

    from evaluator import evaluate as room

    family = made(tmp_path / "family", indicators=("calibration_error",), grades=("excellent",))
    assert judged(family, tmp_path / "sound").right
    sound = room.solve_geometry

    def turned(*arguments: object, **options: object) -> object:
        found = sound(*arguments, **options)  # type: ignore[arg-type]
        parameters = found.solution.parameters.copy()
        parameters[1] = -parameters[1]
        return replace(found, solution=replace(found.solution, parameters=parameters))

    monkeypatch.setattr(room, "solve_geometry", turned)
    report = judged(family, tmp_path / "broken")
    assert report.mistakes == ("camera_boresight_pitch: sign reversed",), report.block()
