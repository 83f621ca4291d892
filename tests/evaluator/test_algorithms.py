"""The slots of replaceable algorithms: what is accepted of an answer, what becomes of a failure, and whose names are taken."""

import dataclasses
import os
import runpy
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from campaign.errors import ConfigError
from evaluator.algorithms import (
    AlgorithmFailure,
    Algorithms,
    EchoTask,
    MarkTask,
    PanelTask,
    ReflectanceTask,
    VertexTask,
)
from evaluator.algorithms.apart import Job, evaluate_apart
from evaluator.algorithms.check import CHECKS, Wrong
from evaluator.algorithms.guard import guarded
from evaluator.algorithms.load import choose, load_algorithms, parse_assignments, put_current_folder_on_path
from evaluator.algorithms.own import board_adjustment, joint_adjustment
from evaluator.algorithms.record import OWN_TOOLS, SLOTS
from evaluator.algorithms.solvers import board_task, board_xi, mountings_solver
from evaluator.evaluate import evaluate_campaign
from evaluator.mounting.adjustment import solve_mountings
from evaluator.results import build_results

HERE = Path(__file__).parent
BAD = '''
"""Algorithms that misbehave."""
import os
import time


def raises(task):
    raise ValueError("no idea\\nat all")


def never_stops(task):
    while True:
        try:
            time.sleep(100.0)
        except BaseException:
            pass


def ends_the_process(task):
    os._exit(3)


number = 3
'''


def echo_task() -> EchoTask:
    return EchoTask(samples_dn=np.full((3, 32), 60.0), sampling_ns=1.0, echo_fwhm_ns=4.0, saturation_dn=4095.0)


def vertex_task() -> VertexTask:
    return VertexTask(
        origin_m=np.zeros((9, 3)),
        direction=np.tile([0.0, 0.0, -1.0], (9, 1)),
        range_m=np.ones(9),
        single_return=np.ones(9, dtype=bool),
        long_edge_m=0.5,
        inverted=True,
        thickness_m=0.001,
        normals=np.eye(4, 3),
        face_angle_std_rad=0.002,
        range_std_m=0.005,
        encoder_std_rad=0.0,
        footprint_m=0.005,
        located=True,
    )


def reflectance_task() -> ReflectanceTask:
    return ReflectanceTask(
        amplitude_dn=np.arange(1.0, 9.0),
        range_m=np.full(8, 50.0),
        reflectance_percent=np.arange(8.0),
        at_amplitude_dn=np.array([3.0, 4.0]),
        at_range_m=np.array([50.0, 50.0]),
    )


def panel_task() -> PanelTask:
    n = np.ones(6)
    return PanelTask(
        points_m=np.zeros((6, 3)),
        amplitude_dn=n,
        range_m=n,
        cos_incidence=n,
        single_return=n > 0,
        size_m=0.7,
        divergence_rad=0.0005,
        searched=False,
    )


def mark_task() -> MarkTask:
    return MarkTask(
        grey=np.zeros((40, 60), np.float32),
        predicted_px=np.array([30.0, 20.0]),
        search_radius_px=5.0,
        px_per_m=50.0 * np.eye(2),
        radius_m=0.1,
        sheets_m=np.zeros((4, 8, 3)),
        eye_m=np.array([0.0, 0.0, 50.0]),
        to_sun=None,
        clipped_at=4000.0,
    )


VERTEX = {"vertex_m": [0.0, 0.0, 0.01], "covariance_m2": 1e-6 * np.eye(3), "used": [0, 1, 2, 3]}
ECHOES = {"packet": [0, 2], "amplitude_dn": [5.0, 6.0], "centre_ns": [10.0, 12.0]}
TURN = np.diag([1.0, -1.0, -1.0])
CAMERA = {"camera_rotation": TURN, "camera_lever_arm_m": [0.1, 0.0, 0.1], "covariance": 1e-6 * np.eye(6)}


@pytest.mark.parametrize(
    ("slot", "task", "answer", "what"),
    [
        ("vertex_estimation", vertex_task(), None, "returned NoneType, expected FoundVertex"),
        (
            "vertex_estimation",
            vertex_task(),
            VERTEX | {"vertex_m": [np.nan] * 3},
            "vertex_m holds 3 of 3 values that are not",
        ),
        ("vertex_estimation", vertex_task(), VERTEX | {"vertex_m": [0.0, 0.0]}, r"the shape \(2,\), expected \(3,\)"),
        ("vertex_estimation", vertex_task(), VERTEX | {"vertex_m": "left"}, "vertex_m is str, not an array of numbers"),
        ("vertex_estimation", vertex_task(), VERTEX | {"vertex_m": [0.0, 0.0, 9.0]}, "9 m from its stated place"),
        ("vertex_estimation", vertex_task(), VERTEX | {"used": [0, 1, 9]}, "names a row outside 0 to 8"),
        ("vertex_estimation", vertex_task(), VERTEX | {"used": [0, 1, 1]}, "names a row twice"),
        ("vertex_estimation", vertex_task(), VERTEX | {"used": [0]}, "needs 3 at least"),
        ("vertex_estimation", vertex_task(), VERTEX | {"used": [0.5, 1.5]}, "expected row numbers or a mask of 9"),
        ("vertex_estimation", vertex_task(), VERTEX | {"covariance_m2": np.zeros((3, 3))}, "not above zero"),
        ("vertex_estimation", vertex_task(), VERTEX | {"covariance_m2": 1 - 2 * np.eye(3)}, "not above zero"),
        ("vertex_estimation", vertex_task(), VERTEX | {"covariance_m2": np.triu(np.ones((3, 3)))}, "not symmetric"),
        (
            "vertex_estimation",
            vertex_task(),
            VERTEX | {"covariance_m2": np.ones((3, 3)) + 2 * (1 - np.eye(3))},
            "negative eig",
        ),
        (
            "vertex_estimation",
            vertex_task(),
            VERTEX | {"centre": 1},
            "returned 'centre', which FoundVertex does not have",
        ),
        ("vertex_estimation", vertex_task(), {"vertex_m": [0.0] * 3}, "returned no covariance_m2"),
        ("echo_decomposition", echo_task(), ECHOES | {"packet": [0, 3]}, "names a row outside 0 to 2"),
        ("echo_decomposition", echo_task(), ECHOES | {"packet": [0.0, 1.0]}, "expected .m,. row numbers"),
        ("echo_decomposition", echo_task(), ECHOES | {"centre_ns": [10.0, 500.0]}, "far outside its packet of 32 ns"),
        ("echo_decomposition", echo_task(), ECHOES | {"amplitude_dn": [5.0]}, r"the shape \(1,\), expected \(2,\)"),
        ("echo_decomposition", echo_task(), ECHOES | {"amplitude_dn": [5.0, 1e30]}, "1e.30 DN is not plausible"),
        ("reflectance_model", reflectance_task(), [1.0], r"the shape \(1,\), expected \(2,\)"),
        ("reflectance_model", reflectance_task(), [1.0, np.inf], "1 of 2 values that are not finite"),
        ("reflectance_model", reflectance_task(), [1.0, 1e6], "1e.06 % is not plausible"),
        ("reflectance_model", reflectance_task(), {"percent": 1}, "dict, not an array of numbers"),
        ("panel_finding", panel_task(), {"inside": [0], "clear": [7]}, "names a row outside 0 to 5"),
        ("panel_finding", panel_task(), {"inside": [0], "clear": [1], "shift_m": [50.0, 0.0]}, "50 m, not plausible"),
        (
            "mark_finding",
            mark_task(),
            {"uv_px": [70.0, 1.0], "covariance_px2": np.eye(2)},
            "outside the image of 60 x 40",
        ),
        ("mark_finding", mark_task(), {"uv_px": [1.0, 1.0], "covariance_px2": [0.1, 0.1]}, r"the shape \(2,\)"),
        ("mounting_solver", None, CAMERA | {"camera_rotation": 2.0 * np.eye(3)}, "camera_rotation is no rotation"),
        ("mounting_solver", None, CAMERA | {"camera_rotation": -np.eye(3)}, "camera_rotation is no rotation"),
        ("mounting_solver", None, CAMERA | {"camera_lever_arm_m": [1e4, 0.0, 0.0]}, "1e.04 m, not plausible"),
        ("extrinsic_solver", None, CAMERA, "returned no lidar_rotation"),
    ],
)
def test_a_wrong_answer_is_told_for_what_it_is(slot: str, task: object, answer: object, what: str) -> None:
    """Rationale: what somebody's function returns goes into an adjustment. Expected: type, shape, finite, plausible, each
    told."""
    with pytest.raises(Wrong, match=what):
        CHECKS[slot](answer, task)


def test_a_right_answer_comes_out_in_order() -> None:
    """Rationale: an outsider need not know our types. Expected: lists and masks serve; echoes come sorted by packet, then
    time."""
    answer = {"packet": [2, 0, 0], "amplitude_dn": [1, 2, 3], "centre_ns": [5, 20, 10]}
    found = CHECKS["echo_decomposition"](answer, echo_task())
    assert found.packet.tolist() == [0, 0, 2] and found.centre_ns.tolist() == [10.0, 20.0, 5.0]
    assert found.amplitude_dn.tolist() == [3.0, 2.0, 1.0]
    mask = np.arange(9) % 2 == 0
    assert CHECKS["vertex_estimation"](VERTEX | {"used": mask}, vertex_task()).used.tolist() == [0, 2, 4, 6, 8]
    none = CHECKS["echo_decomposition"]({"packet": [], "amplitude_dn": [], "centre_ns": []}, echo_task())
    assert none.packet.size == 0


def test_without_a_name_every_slot_is_our_own_function_itself() -> None:
    """Rationale: the default keeps its speed and its bytes. Expected: no wrapper stands between; nothing is counted."""
    tools, log = guarded(Algorithms())
    assert all(getattr(tools, slot) is getattr(OWN_TOOLS, slot) for slot in SLOTS)
    assert not tools.replaced and not log.calls


def test_failures_are_named_and_counted() -> None:
    """Rationale: one bad call of many is told as such. Expected: text of slot, name and cause in one line; the count; a
    text is an answer where the slot allows one, and wrong where it does not."""
    tools, log = guarded(
        dataclasses.replace(Algorithms(), vertex_estimation=lambda task: 1 / 0, names={"vertex_estimation": "m:f"})
    )
    for _ in range(2):
        with pytest.raises(
            AlgorithmFailure, match=r"^vertex_estimation m:f: raised ZeroDivisionError: division by zero$"
        ):
            tools.vertex_estimation(vertex_task())
    assert log.problems() == ["vertex_estimation m:f: raised ZeroDivisionError: division by zero (2 of 2 calls)"]
    declines = Algorithms(vertex_estimation=lambda task: "too\ndark", reflectance_model=lambda task: "no")  # type: ignore[arg-type,return-value]
    tools, log = guarded(declines)
    assert tools.vertex_estimation(vertex_task()) == "too dark"
    with pytest.raises(AlgorithmFailure, match="is str, not an array"):
        tools.reflectance_model(reflectance_task())
    assert "test_algorithms" in tools.replaced["vertex_estimation"]


def test_a_call_that_hangs_is_stopped_and_not_repeated() -> None:
    """Rationale: 72 calls of a minute each are an hour. Expected: stopped at 0.3 s though it catches every Exception; the
    second call fails at once. Tolerance: 5 s for a busy machine."""

    def hangs(task: VertexTask) -> str:
        while True:
            try:
                time.sleep(0.01)
            except Exception:  # what _TimeUp must pass
                continue

    tools, log = guarded(Algorithms(vertex_estimation=hangs), limit_s=0.3)
    start = time.monotonic()
    for _ in range(2):
        with pytest.raises(AlgorithmFailure, match=r"took longer than 0\.3 s and was stopped"):
            tools.vertex_estimation(vertex_task())
    assert time.monotonic() - start < 5.0
    assert log.calls["vertex_estimation"].failed == 2 and log.calls["vertex_estimation"].seconds < 5.0


@pytest.mark.parametrize(
    ("items", "what"),
    [
        (["vertex_estimaton=a:b"], "is no algorithm's slot.*did you mean vertex_estimation"),
        (["vertex_estimation"], "is no choice of an algorithm"),
        (["vertex_estimation=module"], "is no function's name.*expected package.module:function"),
        (["vertex_estimation=../evil:f"], "is no function's name"),
        (["vertex_estimation=a:b", "vertex_estimation=c:d"], "is given twice"),
    ],
)
def test_choices_are_checked_before_anything_runs(items: list[str], what: str) -> None:
    """Rationale: a mistyped slot must not end as the default's figures. Expected: one line, the nearest slot named."""
    with pytest.raises(ConfigError, match=what):
        parse_assignments(items)


@pytest.fixture
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A current folder with BAD as bad_algorithms.py, on the path as the command puts it."""
    (tmp_path / "bad_algorithms.py").write_text(BAD)
    (tmp_path / "broken_algorithms.py").write_text("import nothing_of_that_name\n")
    (tmp_path / "raising_algorithms.py").write_text("raise RuntimeError('at import')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    put_current_folder_on_path()
    yield tmp_path
    for name in ("bad_algorithms", "broken_algorithms", "raising_algorithms"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("no_such_module:f", "vertex_estimation no_such_module:f: no module no_such_module"),
        ("bad_algorithms:raise", "no function raise in bad_algorithms; did you mean raises?"),
        ("bad_algorithms:number", "is not callable; got int"),
        ("broken_algorithms:f", "its module needs nothing_of_that_name, which is not installed"),
        ("raising_algorithms:f", "its module cannot be imported: RuntimeError: at import"),
    ],
)
def test_what_cannot_be_imported_is_told_in_one_line(in_folder: Path, name: str, what: str) -> None:
    """Rationale: the commonest first mistake. Expected: which of slot, module, function is wrong."""
    with pytest.raises(ConfigError) as told:
        load_algorithms({"vertex_estimation": name})
    assert what in str(told.value) and "\n" not in str(told.value)
    assert load_algorithms({"vertex_estimation": "bad_algorithms:raises"}).vertex_estimation.__name__ == "raises"


def lean(run: Path, target: Path) -> Path:
    """One strip of the small campaign, without benches, ranging line and images: what the LiDAR's slots need."""

    def leave_out(folder: str, names: list[str]) -> set[str]:
        others = {name for name in names if name.startswith("strip_") and not name.startswith("strip_01")}
        return ({"bench", "ranging", "images", "truth", "02"} & set(names)) | others

    shutil.copytree(run / "campaign", target, ignore=leave_out)
    return target


def test_a_campaign_cannot_name_an_algorithm(tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: somebody sent the folder; evaluating it must not run what it brings. Expected: files that name an algorithm are
    ignored, their module is never imported, results.json names none; a table of names from inside is refused by the loader; where
    the campaign is the current folder, it is not put on the path."""
    root = lean(tiny_run, tmp_path / "campaign")
    evil = "from pathlib import Path\nPath(__file__).with_name('ran').touch()\n\ndef f(task):\n    return 'no'\n"
    table = '[algorithms]\nvertex_estimation = "evil:f"\nreflectance_model = "evil:f"\n'
    for folder in (root, root / "sensors", root / "sorties"):
        (folder / "evil.py").write_text(evil)
        (folder / "algorithms.toml").write_text(table)
        (folder / "pyproject.toml").write_text(f"[tool.testrange.algorithms]\n{table}")
    monkeypatch.chdir(root)
    monkeypatch.setattr(sys, "path", [*sys.path])
    put_current_folder_on_path(root)
    assert str(root) not in sys.path
    results = build_results(evaluate_campaign(root))
    assert "algorithms" not in results and not list(root.rglob("ran"))
    assert results["indicators"]["lidar_reflectance_rmse"]["value"] is not None
    with pytest.raises(ConfigError, match=r"algorithms.toml: lies in the campaign folder"):
        choose([], root / "algorithms.toml", root)
    outside = tmp_path / "mine.toml"
    outside.write_text(table)
    assert choose(["reflectance_model=a:b"], outside, root) == {
        "vertex_estimation": "evil:f",
        "reflectance_model": "a:b",
    }


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("[algorithms]\nvertex = 'a:b'\n", "vertex: is no algorithm's slot"),
        ("[algorithms]\nvertex_estimation = 3\n", "algorithms.vertex_estimation: is no text"),
        ("[algoritms]\nvertex_estimation = 'a:b'\n", "expected one table"),
        ("vertex_estimation", "mine.toml"),
    ],
)
def test_a_file_of_names_is_checked(tmp_path: Path, text: str, what: str) -> None:
    """Rationale: as on the command line. Expected: one line with the key."""
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(ConfigError, match=what):
        choose([], tmp_path / "mine.toml")


def test_one_that_cannot_be_stopped_costs_its_slot_and_nothing_else(tiny_run: Path, in_folder: Path) -> None:
    """Rationale: SIGALRM does not reach everything; a segmentation fault takes all with it. Expected: of three replaced
    slots one that ignores every signal and one that ends the process are named in problems, the third and our own give
    their results, and results.json names all three. Tolerance: none; the limit of 1 s bounds what the test waits."""
    root = lean(tiny_run, in_folder / "campaign")
    names = {
        "vertex_estimation": "bad_algorithms:never_stops",
        "reflectance_model": "bad_algorithms:ends_the_process",
        "echo_decomposition": "evaluator.other_methods.waveforms:peaks",
    }
    done = evaluate_apart(Job(names=names, campaign=root, call_limit_s=1.0))
    assert done.evaluation is not None
    told = "\n".join(done.evaluation.problems)
    assert "vertex_estimation bad_algorithms:never_stops: a call took longer than 1 s and was stopped" in told
    assert "reflectance_model bad_algorithms:ends_the_process: ended the process with code 3" in told
    assert done.calls["echo_decomposition"].failed == 0 < done.calls["echo_decomposition"].count
    results = build_results(done.evaluation)
    assert results["algorithms"] == names
    reason = results["indicators"]["lidar_reflectance_rmse"]["reason"]
    assert reason == "reflectance_model bad_algorithms:ends_the_process: ended the process with code 3"
    counted = [r for r in results["conformity"] if r["clause"] == "5.5 b"]  # points on panels: our own part went on
    assert counted and {r["status"] for r in counted} <= {"pass", "fail"}


def test_our_own_solvers_serve_in_the_form_of_the_slots() -> None:
    """Rationale: a task must hold all that a solver needs, and an answer must come back without loss. Expected: our
    adjustments behind the slots give the parameters that they give directly. Tolerance: 1e-12 rad and m: angles pass
    through a rotation matrix."""
    problem = runpy.run_path(str(HERE / "flights.py"))["flight"](3)
    direct = solve_mountings(problem)
    tools, _ = guarded(dataclasses.replace(Algorithms(), names={"extrinsic_solver": "own"}))
    behind = mountings_solver(tools)(problem)
    assert tools.extrinsic_solver is not None and behind.parameters == pytest.approx(direct.parameters, abs=1e-12)
    assert behind.covariance == pytest.approx(direct.covariance, rel=1e-9)
    assert behind.camera_from_lidar == pytest.approx(direct.camera_from_lidar, abs=1e-12)
    assert np.linalg.norm(behind.parameters) > 1e-3 and joint_adjustment.__module__ == "evaluator.algorithms.own"

    boards = runpy.run_path(str(HERE / "test_mounting_by_boards.py"))
    case = boards["draw"](boards["flight"](), 5)
    task = board_task(case[0], case[1], case[2])
    xi, covariance = board_xi(case[0], board_adjustment(task))
    found = boards["solve_board_problem"](*case)
    assert xi == pytest.approx(found.parameters, abs=1e-12) and covariance == pytest.approx(found.covariance)


def test_every_observation_of_the_adjustment_is_in_its_task() -> None:
    """Rationale: somebody's solver sees what ours sees. Expected: the true mountings reproduce every pixel and vertex from
    the task's arrays alone, by the equation in its docstring. Tolerance: six of the stated standard deviations of
    navigation, pixel and survey together: 30 px of a wrong sign or a swapped index lie far outside."""
    from evaluator.algorithms.solvers import extrinsic_task
    from evaluator.camera_model import lens_from_vector, project
    from evaluator.frames import euler_rotation

    module = runpy.run_path(str(HERE / "flights.py"))
    task = extrinsic_task(module["flight"](3))
    true = module["TRUE"]
    camera = euler_rotation(*true[:3]) @ task.camera_rotation, task.camera_lever_arm_m + true[3:6]
    lidar = euler_rotation(*true[6:9]) @ task.lidar_rotation, task.lidar_lever_arm_m + true[9:12]
    place = task.mark_world_m[task.mark_target]
    in_body = np.einsum("nji,nj->ni", task.mark_world_from_body, place - task.mark_body_m)
    uv = project(lens_from_vector(task.lens), (in_body - camera[1]) @ camera[0])
    assert np.abs(uv - task.mark_uv_px).max() < 15.0
    vertex = (task.mark_world_m + task.vertex_from_mark_m)[task.vertex_target]
    in_body = np.einsum("nji,nj->ni", task.vertex_world_from_body, vertex - task.vertex_body_m)
    assert np.abs((in_body - lidar[1]) @ lidar[0] - task.vertex_lidar_m).max() < 0.15
    assert len(uv) > 50 and task.prior_std.shape == (12,) and os.sep not in "".join(task.targets)
