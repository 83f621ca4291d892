"""`view` serves one page to this machine alone; the .rrd recording by the extra."""

import http.client
import importlib.util
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from campaign.errors import TestrangeError
from testrange import pipeline
from testrange.viewing import HOST, find_page, make_server, serve


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """A results folder with a page, beside a campaign."""
    for name in ("run/results", "run/campaign"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "run" / "campaign" / "manifest.json").write_text("{}")
    place = tmp_path / "run" / "results" / "view.html"
    place.write_text("<!doctype html><title>页</title>")
    (place.parent / "secret.txt").write_text("not for anybody")
    return place


@pytest.fixture
def port(page: Path) -> Iterator[int]:
    """A server that runs while the test does."""
    with make_server(page, 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield server.server_port
        server.shutdown()
        thread.join()


def ask(port: int, path: str, host: str | None = None, method: str = "GET") -> tuple[int, dict[str, str], bytes]:
    """Status, headers, body."""
    connection = http.client.HTTPConnection(HOST, port, timeout=10)
    try:
        connection.request(method, path, headers={"Host": host or f"{HOST}:{port}"})
        answer = connection.getresponse()
        return answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read()
    finally:
        connection.close()


def test_one_page_and_nothing_else(page: Path, port: int) -> None:
    """Rationale: a folder of results is nobody else's. Expected: the page's bytes with a policy that allows no request; 404 for
    the file beside it and for every way out of the folder; 501 for writing. Tolerance: none."""
    status, headers, body = ask(port, "/")
    assert (status, body) == (200, page.read_bytes())
    assert headers["content-security-policy"].startswith("default-src 'none';")
    assert "connect-src" not in headers["content-security-policy"]  # falls back on 'none'
    assert headers["x-content-type-options"] == "nosniff"
    assert "python" not in headers["server"].lower()
    assert ask(port, "/", method="HEAD")[2] == b""
    for path in ("/secret.txt", "/../results/secret.txt", "/%2e%2e/secret.txt", "//etc/passwd", "/view.html/"):
        assert ask(port, path)[0] == 404, path
    assert ask(port, "/", method="POST")[0] == 501


@pytest.mark.parametrize("host", ["example.org", "127.0.0.1", "127.0.0.1:1", "evil.localhost:{port}", "0.0.0.0:{port}"])
def test_other_names_are_refused(port: int, host: str) -> None:
    """Rationale: a page elsewhere may point its own name at 127.0.0.1 and read what is served there. Expected: 403 for any name
    but ours, and nothing of the page. Tolerance: none."""
    status, _, body = ask(port, "/", host.format(port=port))
    assert status == 403
    assert b"doctype" not in body


def test_loopback_only(page: Path, port: int) -> None:
    """Expected: the socket is bound to 127.0.0.1, so that another address of this machine finds nobody; localhost is ours."""
    assert ask(port, "/", f"localhost:{port}")[0] == 200
    with socket.socket() as other, pytest.raises(OSError):
        other.settimeout(2)
        other.connect(("127.0.0.2", port))


def test_where_a_page_is_found(page: Path, tmp_path: Path, port: int) -> None:
    """Expected: by file, results, run and campaign; else one line that says what is missing. A taken port, and a number that is
    none, are one line each."""
    run = tmp_path / "run"
    assert {find_page(p).resolve() for p in (page, run / "results", run, run / "campaign")} == {page.resolve()}
    with pytest.raises(TestrangeError, match=r"holds no view\.html; testrange run"):
        find_page(tmp_path)
    with pytest.raises(TestrangeError, match="no such file"):
        find_page(tmp_path / "nowhere")
    with pytest.raises(TestrangeError, match="is no page"):
        find_page(run / "results" / "secret.txt")
    with pytest.raises(TestrangeError, match="the port is taken; name another"):
        make_server(page, port)
    with pytest.raises(TestrangeError, match="is no port"):
        make_server(page, 70_000)


def test_interrupt_ends_it(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Expected: the address is told first, and Ctrl-C is an end like any other: no traceback."""
    told: list[str] = []

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("socketserver.BaseServer.serve_forever", interrupted)
    serve(page, 0, told.append)
    assert told[0].startswith("http://127.0.0.1:")


def test_recording_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Expected: one line that names the extra, and no file."""
    from evaluator.results import Evaluation
    from testrange.rerun_log import write_rrd

    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(TestrangeError, match=r"rerun-sdk is not installed; .venv/bin/python -m pip install rerun-sdk"):
        write_rrd(tmp_path / "a.rrd", Evaluation(campaign="c", synthetic=False, indicators={}))
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="the extra rerun is not installed")
def test_recording(tiny_run: Path, tmp_path: Path) -> None:
    """Rationale: a recording is looked at with another program. Expected: a file of that program's format with every target, the
    points of every strip, the cameras of every sortie, and times of the campaign's own day. Tolerance: none."""
    from evaluator.load import load_campaign
    from evaluator.results import Evaluation
    from testrange.rerun_log import unix_time_s, write_rrd

    data = load_campaign(tiny_run / "campaign")
    evaluation = Evaluation(campaign=data.manifest.campaign, synthetic=True, indicators={}, data=data)
    assert evaluation.data is not None
    assert write_rrd(tmp_path / "a.rrd", evaluation) == []
    content = (tmp_path / "a.rrd").read_bytes()
    assert content[:3] == b"RRF"
    for target in evaluation.data.targets:
        assert target.id.encode() in content, target.id
    for s in evaluation.data.sorties:
        assert f"world/camera/sortie_{s.folder.number:02d}/name".encode() in content
        for strip in s.strips:
            assert f"world/points/sortie_{s.folder.number:02d}/strip_{strip:02d}/".encode() in content
    time = evaluation.data.sorties[0].exposures[0].gps_time_s
    assert str(unix_time_s(evaluation.data, time).astype("datetime64[s]")).startswith(evaluation.data.manifest.date)


def test_results_of_another_campaign_are_not_its_page(page: Path) -> None:
    """Rationale: two campaigns beside one results folder: the second was shown the first one's page. Expected: no page."""
    (page.parent / "results.json").write_text('{"campaign": "other"}')
    with pytest.raises(TestrangeError, match="holds no view"):
        find_page(page.parent.parent / "campaign")
    assert find_page(page.parent) == page


@pytest.mark.parametrize("name", ["results/results.json", "campaign/manifest.json", "results", "campaign/page.txt"])
def test_a_page_is_not_written_over_something_else(page: Path, name: str) -> None:
    """Rationale: `view CAMPAIGN --out CAMPAIGN/manifest.json` put the page in the place of the manifest. Expected: refused
    before anything is evaluated, the file untouched."""
    run = page.parent.parent
    before = (run / "campaign" / "manifest.json").read_bytes()
    with pytest.raises(TestrangeError, match=r"is no name for it; expected a file that ends in \.html"):
        pipeline.view(run, run / name, lambda *_: None, "zh")
    assert (run / "campaign" / "manifest.json").read_bytes() == before
