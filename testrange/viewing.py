"""`testrange view`: one finished page on this machine's own address, for a browser here. Serves nothing else, and nobody else."""

import errno
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from campaign.archive.lists import results_campaign
from campaign.errors import TestrangeError
from campaign.manifest import read_manifest

HOST = "127.0.0.1"
PORT = 8041
MAX_BYTES = 100_000_000
# The page's own policy names its script by its sum; this one keeps it from asking anybody for anything.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; font-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


def find_page(place: Path) -> Path:
    """The page that a path means: a file itself, or view.html of a run's or a results folder, or beside a campaign.

    Raises
    ------
    TestrangeError
        There is none.
    """
    if place.is_file():
        if place.suffix.lower() not in (".html", ".htm"):
            raise TestrangeError("is no page", where=str(place), expected="an .html file or the folder that holds one")
        return place
    if not place.is_dir():
        raise TestrangeError("no such file or folder", where=str(place))
    offered = [place / "view.html", place / "results" / "view.html"]
    if (place / "manifest.json").is_file():
        beside = place.resolve().parent / "results"
        # several campaigns may lie beside one results folder
        if results_campaign(beside) in (None, _campaign_id(place)):
            offered.append(beside / "view.html")
    for page in offered:
        if page.is_file():
            return page
    raise TestrangeError(
        "holds no view.html", where=str(place), remedy="testrange run and testrange evaluate write one"
    )


def _campaign_id(campaign: Path) -> str | None:
    """The name that manifest.json gives; None where it cannot be read."""
    try:
        return read_manifest(campaign).campaign
    except TestrangeError:
        return None


class _Handler(BaseHTTPRequestHandler):
    """GET and HEAD of the one page; anything else is refused."""

    server: "_Server"
    server_version = "testrange"
    sys_version = ""
    timeout = 10.0

    def do_GET(self) -> None:
        self._answer(body=True)

    def do_HEAD(self) -> None:
        self._answer(body=False)

    def _answer(self, *, body: bool) -> None:
        if self.headers.get_all("Host", []) not in ([name] for name in self.server.own_names):
            self._send(HTTPStatus.FORBIDDEN, b"this page is for this machine's own address only\n", body=body)
        elif self.path.split("?", 1)[0] not in ("/", "/view.html"):
            self._send(HTTPStatus.NOT_FOUND, b"nothing here\n", body=body)
        else:
            self._send(HTTPStatus.OK, self.server.page, "text/html; charset=utf-8", body=body)

    def _send(self, status: HTTPStatus, content: bytes, kind: str = "text/plain", *, body: bool) -> None:
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(content))),
            ("Content-Security-Policy", POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
            ("Cache-Control", "no-store"),
        ):
            self.send_header(name, value)
        self.end_headers()
        if body:
            self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Says nothing: the terminal is for the address."""


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, port: int, page: bytes) -> None:
        super().__init__((HOST, port), _Handler)
        self.page = page
        self.own_names = tuple(f"{name}:{self.server_port}" for name in (HOST, "localhost"))

    def handle_error(self, request: object, client_address: object) -> None:
        """A browser that goes away in the middle is no error of ours."""

    @property
    def address(self) -> str:
        """Where a browser finds the page."""
        return f"http://{HOST}:{self.server_port}/"


def make_server(page: Path, port: int) -> _Server:
    """A server of one page on the loopback address; port 0 takes a free one. `serve_forever` starts it.

    Raises
    ------
    TestrangeError
        The page cannot be read or is too large, or the port cannot be had.
    """
    if not 0 <= port <= 65535:
        raise TestrangeError("is no port", where="--port", got=port, expected="0 to 65535; 0 takes a free one")
    try:
        if page.stat().st_size > MAX_BYTES:
            raise TestrangeError("too large for a page", where=str(page), expected=f"at most {MAX_BYTES} bytes")
        content = page.read_bytes()
    except OSError as error:
        raise TestrangeError("cannot be read", where=str(page), got=error.strerror) from None
    try:
        return _Server(port, content)
    except OSError as error:
        taken = error.errno == errno.EADDRINUSE
        what = "the port is taken" if taken else f"the port cannot be had: {error.strerror}"
        raise TestrangeError(
            what, where=f"{HOST}:{port}", remedy="name another with --port, or 0 for a free one"
        ) from None


def serve(place: Path, port: int = PORT, tell: Callable[[str], None] = print) -> None:
    """Serves the page of a folder, or one page, until Ctrl-C.

    Parameters
    ----------
    place : Path
        A page, or a folder that `find_page` knows.
    port : int
        0 takes a free one.
    tell : callable
        Gets the line with the address.
    """
    with make_server(find_page(place), port) as server:
        tell(f"{server.address}  (Ctrl-C ends)")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            return
