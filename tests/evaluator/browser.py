"""A headless Chromium driven over a pipe (DevTools protocol): pages from disk, no network, no package for it."""

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--remote-debugging-pipe",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--force-prefers-reduced-motion",
    "--host-resolver-rules=MAP * ~NOTFOUND",
)
# The browser reads from 3 and writes to 4: this puts the pipes' ends there and becomes the browser.
TO_3_AND_4 = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]
os.dup2(ends[0], 3)
os.dup2(ends[1], 4)
os.execv(sys.argv[3], sys.argv[3:])
"""
WAIT_S = 60.0  # for one answer: a machine may be busy
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def chromium() -> str | None:
    """The browser's command, where one is installed."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)


class Browser:
    """One tab. `messages`: everything on the console and every exception; `requests`: every address that was asked for."""

    def __init__(self, program: str) -> None:
        to_read, self._to = os.pipe()
        self._from, to_write = os.pipe()
        self._profile = tempfile.mkdtemp(prefix="chromium-")
        command = [program, *FLAGS, f"--user-data-dir={self._profile}", "about:blank"]
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", TO_3_AND_4, str(to_read), str(to_write), *command],
            pass_fds=(to_read, to_write),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_read)
        os.close(to_write)
        self._rest, self._number, self._session = b"", 0, ""
        self.messages: list[str] = []
        self.requests: list[str] = []

    def __enter__(self) -> Self:
        try:
            tabs = self._call("Target.getTargets")["targetInfos"]
            tab = next(t["targetId"] for t in tabs if t["type"] == "page")
            self._session = self._call("Target.attachToTarget", targetId=tab, flatten=True)["sessionId"]
            for domain in ("Page", "Runtime", "Log", "Network"):
                self._call(f"{domain}.enable")
            no_network = {"latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
            self._call("Network.emulateNetworkConditions", offline=True, **no_network)
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._to)
        os.close(self._from)
        shutil.rmtree(self._profile, ignore_errors=True)

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                result: dict[str, Any] = answer["result"]
                return result
            self._note(answer)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            assert select.select([self._from], [], [], WAIT_S)[0], "the browser does not answer"
            got = os.read(self._from, 1 << 20)
            assert got, "the browser has ended"
            self._rest += got
        one, self._rest = self._rest.split(b"\0", 1)
        answer: dict[str, Any] = json.loads(one)
        return answer

    def _note(self, event: dict[str, Any]) -> None:
        if event["method"] in ("Runtime.exceptionThrown", "Log.entryAdded", "Runtime.consoleAPICalled"):
            self.messages.append(json.dumps(event["params"])[:500])
        if event["method"] == "Network.requestWillBeSent":
            self.requests.append(event["params"]["request"]["url"])

    def script(self, text: str) -> Any:
        """Value of an expression (a promise is awaited), or of the last of several statements, in the page."""
        found = self._call(
            "Runtime.evaluate", expression=f"{{{text}}}" if ";" in text else text, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def state(self, name: str) -> str:
        """One attribute data-… that the page keeps of itself."""
        return str(self.script(f"document.documentElement?.dataset.{name} || ''"))

    def load(self, path: Path) -> None:
        """Opens a page from disk and waits until it is loaded."""
        self._call("Page.navigate", url=path.resolve().as_uri())
        end = time.monotonic() + WAIT_S
        while time.monotonic() < end and self.script("document.readyState") != "complete":
            time.sleep(0.05)

    def open(self, path: Path) -> None:
        """Waits until a page that keeps its state in data-… has drawn."""
        self._call("Page.navigate", url=path.resolve().as_uri())
        end = time.monotonic() + WAIT_S
        while time.monotonic() < end and not (self.state("state") and self.state("frames")):
            time.sleep(0.1)
        self.settle()

    def settle(self) -> None:
        """Waits until no more frames are drawn."""
        end, frames = time.monotonic() + WAIT_S, ""
        while time.monotonic() < end:
            two = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
            self._call("Runtime.evaluate", expression=two, awaitPromise=True)
            now = self.state("frames")
            if now == frames:
                return
            frames = now

    def size(self, width: int, height: int) -> None:
        """Of the window's inside, at one device pixel a pixel."""
        self._call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 500
        )

    def before_each_page(self, text: str) -> None:
        """A script that runs before the page's own."""
        self._call("Page.addScriptToEvaluateOnNewDocument", source=text)

    def click(self, x: float, y: float) -> None:
        """The left button, pressed and let go."""
        for kind in ("mousePressed", "mouseReleased"):
            self._call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)
        self.settle()

    def picture(self) -> np.ndarray:
        """(height, width, 3) uint8 of what is seen."""
        self.settle()
        coded = base64.b64decode(self._call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_COLOR))
