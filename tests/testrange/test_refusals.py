"""What would fail after hours, or silently do something else, is refused at once: one line, and nothing is begun or left behind."""

import sys
from pathlib import Path

import pytest

from campaign.errors import TestrangeError
from simulator import kept
from testrange import cli, pipeline
from testrange.study.execution import cluster
from testrange.study.execution.cluster import check_address


@pytest.fixture(autouse=True)
def nothing_begins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """In an empty folder, where a simulation that begins fails the test."""

    def begins(*_: object, **__: object) -> None:
        raise AssertionError("the simulation has begun")

    monkeypatch.setattr(pipeline, "simulate_units", begins)
    monkeypatch.setattr("testrange.faults.matrix.run_matrix", begins)
    monkeypatch.chdir(tmp_path)


def refusal(line: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on stderr."""
    assert cli.call(line) == 1
    told = capsys.readouterr()
    assert told.err.startswith("testrange: ") and told.err.count("\n") == 1, told.err
    assert told.out == "" and "internal error" not in told.err and "begun" not in told.err
    return told.err


def simulate_and_run(*more: str) -> list[list[str]]:
    return [[command, "quickstart", "--quiet", *more] for command in ("simulate", "run")]


@pytest.mark.parametrize(
    ("cache", "words"),
    [
        ("out", "is the output"),
        ("out/renders", "lies inside"),
        ("link/renders", "lies inside"),
        (".out.part/renders", "lies inside"),
        (".", "holds"),
    ],
)
@pytest.mark.parametrize("replace", [False, True])
def test_cache_and_output_are_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], cache: str, words: str, replace: bool
) -> None:
    """Rationale: a cache in the target occupied it, hours later, and --replace deleted the renders. Expected: refused as an option
    and as a setting, through links too; no folder is made, none is deleted."""
    (tmp_path / "link").symlink_to("out")
    if replace:
        (tmp_path / "out" / "renders").mkdir(parents=True)
        (tmp_path / "out" / "manifest.json").write_text("{}")
        (tmp_path / "out" / "renders" / "a.kept").write_text("hours")
    before = sorted(tmp_path.rglob("*"))
    for given in (["--cache", cache], ["--set", f'render.cache="{cache}"']):
        for line in simulate_and_run("--out", "out", *given, *(["--replace"] if replace else [])):
            told = refusal(line, capsys)
            assert words in told and "keeps renders" in told and "choose another place" in told
    assert sorted(tmp_path.rglob("*")) == before


def test_a_fault_matrix_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Expected: the same for the command that simulates many campaigns, by its study's settings."""
    line = ["faults", "m.toml", "--quiet", "--out", "out", "--set", 'render.cache="out/renders"']
    (tmp_path / "m.toml").write_text('base = "quickstart"\n[[fault]]\nname = "none"\n')
    assert "lies inside the output folder" in refusal(line, capsys)
    assert [p.name for p in tmp_path.iterdir()] == ["m.toml"]


@pytest.mark.parametrize(
    "cache", ["/proc/foo", "/proc/foo/bar", "/dev/null", "file", "file/renders", "dangling", "loop", "n" * 300]
)
def test_a_cache_that_cannot_be_made(tmp_path: Path, capsys: pytest.CaptureFixture[str], cache: str) -> None:
    """Rationale: the message named a path alone, and an empty folder of begun work was left. Expected: it says whose folder it is
    and what to do, and nothing is left."""
    if cache.startswith("/proc") and not Path("/proc/self").exists():
        pytest.skip("no /proc here")
    (tmp_path / "file").write_text("x")
    (tmp_path / "dangling").symlink_to("nowhere")
    (tmp_path / "loop").symlink_to("loop")
    for line in simulate_and_run("--out", "out", "--cache", cache):
        told = refusal(line, capsys)
        assert cache in told and "folder that keeps renders" in told and "choose another" in told
    assert sorted(p.name for p in tmp_path.iterdir()) == ["dangling", "file", "loop"]


def test_a_cache_that_is_full_is_used_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: keeping saves time only. Expected: a full disk is no reason to refuse, another failure to write is."""

    def fails(number: int) -> None:
        def temporary(**_: object) -> None:
            raise OSError(number, "told")

        monkeypatch.setattr(kept.tempfile, "TemporaryFile", temporary)

    fails(kept.errno.ENOSPC)
    kept.make_folder(tmp_path / "a", to_write=True)
    fails(kept.errno.EROFS)
    with pytest.raises(TestrangeError, match="cannot be written; got told"):
        kept.make_folder(tmp_path / "a", to_write=True)


def test_an_empty_cache(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: an unset variable in a script, --cache "$CACHE", filled the current folder with renders. Expected: refused, on the
    command line and in a configuration; nothing is written."""
    for line in simulate_and_run("--out", "out", "--cache", ""):
        assert "--cache: is empty" in refusal(line, capsys)
    for line in simulate_and_run("--out", "out", "--cache", "a\udcff"):
        assert "--cache: is not UTF-8" in refusal(line, capsys)
    for text in ("", "\\u0000"):
        for line in simulate_and_run("--out", "out", "--set", f'render.cache="{text}"'):
            assert "render.cache: got" in refusal(line, capsys)
    assert list(tmp_path.iterdir()) == []


def test_an_occupied_target_makes_no_cache(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "x").write_text("x")
    for line in simulate_and_run("--out", "out", "--cache", "renders"):
        assert "not empty" in refusal(line, capsys)
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


WRONG = ["foo", "", ":8786", "tcp://foo", "foo:", "foo:x", "foo:0", "foo:65536", "http://foo:1", "inproc://a/b:1"]
WRONG += ["tcp://a://b:1", "::1:8786", "tcp://[::1", "a b:1", "tcp://u@a:1", "foo:1/x"]


@pytest.mark.parametrize("address", WRONG)
def test_what_is_no_address(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], address: str
) -> None:
    """Rationale: Dask's client meets a missing port after it is made: it waited twice its time and ended in a traceback.
    Expected: one line without a client, for a campaign and for a study; nothing is left."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "Client", None)
    lines = simulate_and_run("--out", "out", "--scheduler", address)
    for line in (*lines, ["study", "nothere.toml", "--out", "out", "--scheduler", address]):
        told = refusal(line, capsys)
        assert "is no address of a Dask scheduler" in told and repr(address) in told and "tcp://HOST:PORT" in told
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(TestrangeError, match="is no address"):
        cluster.connect(address)


def test_what_is_an_address(monkeypatch: pytest.MonkeyPatch) -> None:
    """Expected: names, both kinds of numbers, with and without tcp; by tls only where Dask has certificates, and nothing without
    them where it wants encryption."""
    pytest.importorskip("distributed")
    import dask

    for address in ("tcp://192.0.2.7:8786", "node-7.cluster:8786", "[::1]:8786", "tcp://[2001:db8::7]:8786"):
        check_address(address)
    with pytest.raises(TestrangeError, match="TLS needs certificates"):
        check_address("tls://node:8786")
    with (
        dask.config.set({"distributed.comm.require-encryption": True}),
        pytest.raises(TestrangeError, match="ask for encryption"),
    ):
        check_address("node:8786")
    wrong = {"distributed.comm.tls.ca-file": "/nowhere.pem", "distributed.comm.tls.client.cert": "/nowhere.pem"}
    with dask.config.set(wrong), pytest.raises(TestrangeError, match="settings for TLS are wrong"):
        check_address("tls://node:8786")
    monkeypatch.setattr("distributed.security.Security.get_connection_args", lambda *_: {"ssl_context": object()})
    check_address("tls://node:8786")


def test_without_the_extra_nothing_is_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [n for n in sys.modules if n.split(".")[0] == "distributed"] + ["distributed"]:
        monkeypatch.setitem(sys.modules, name, None)
    for line in simulate_and_run("--out", "out", "--scheduler", "tcp://192.0.2.7:8786"):
        assert "testrange[cluster]" in refusal(line, capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("workers", ["1", "3"])
def test_workers_beside_a_scheduler(tmp_path: Path, capsys: pytest.CaptureFixture[str], workers: str) -> None:
    """Rationale: --workers was ignored without a word. Expected: refused, also where it asks for one."""
    given = ["--out", "out", "--workers", workers, "--scheduler", "tcp://192.0.2.7:8786"]
    for line in (*simulate_and_run(*given), ["study", "nothere.toml", *given]):
        told = refusal(line, capsys)
        assert "--workers and --scheduler: exclude each other" in told and "leave out --workers" in told
    assert list(tmp_path.iterdir()) == []


def test_what_is_right_begins(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Expected: the checks let pass a cache beside the target, which is made, and each of the two options alone."""
    for more in (["--cache", "renders"], ["--workers", "2"], []):
        for line in simulate_and_run("--out", "out", *more):
            assert cli.call(line) == 1
            assert "the simulation has begun" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["renders"]
    assert list((tmp_path / "renders").iterdir()) == []


def test_a_loop_of_links_is_no_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Expected: one line, by `evaluate` too, which compares places before it looks at the folder."""
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "campaign").mkdir()
    (tmp_path / "campaign" / "manifest.json").write_text("{}")
    for line in (
        *simulate_and_run("--out", "loop", "--cache", "c"),
        ["evaluate", "campaign", "--quiet", "--out", "loop"],
    ):
        refusal(line, capsys)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["campaign", "loop"]
