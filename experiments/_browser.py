"""A headless Chromium, driven by its own protocol through a pipe."""

import itertools
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from base64 import b64decode
from pathlib import Path
from typing import Any

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_SECONDS = 60.0  # for an answer
IS_OPEN = "typeof opened === 'object' && opened !== null"
"""Whether a page of ``plot.page`` shows something."""
IS_DRAWN = f"{IS_OPEN} && (!opened.isOfPairs || view.sights.corners.length === shown().corners)"
"""Whether it shows all of it."""


def chromium() -> str | None:
    """The browser, if there is one."""
    return next(filter(None, map(shutil.which, _NAMES)), None)


def axe_core() -> str | None:
    """The script of axe-core, which checks accessibility; None where npm has not installed it globally."""
    try:
        root = subprocess.run(["npm", "root", "-g"], capture_output=True, text=True, check=True).stdout.strip()
        return (Path(root) / "axe-core" / "axe.min.js").read_text(encoding="utf-8")
    except (OSError, subprocess.CalledProcessError):
        return None


class Browser:
    """A browser with one page; a context manager.

    Attributes:
        requests: Addresses that the page has asked for since it was opened.
        errors: What scripts of the page have failed at since, and other errors of the console.
    """

    def __init__(self, width: int = 900, height: int = 1000) -> None:
        found = chromium()
        if found is None:
            raise RuntimeError(f"This needs Chromium, as {' or '.join(_NAMES)}.")
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        (self._read, told), (says, self._write) = os.pipe(), os.pipe()
        options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe", "--no-first-run"]
        options += [f"--user-data-dir={self._folder.name}", f"--window-size={width},{height}", "about:blank"]
        # It listens at 3 and answers at 4.
        command = ["sh", "-c", f'exec "$0" "$@" 3</dev/fd/{says} 4>/dev/fd/{told}', found, *options]
        nowhere = subprocess.DEVNULL
        self._process = subprocess.Popen(command, pass_fds=(says, told), stdout=nowhere, stderr=nowhere)
        os.close(says)
        os.close(told)
        self._numbers, self._rest, self._session = itertools.count(1), b"", None
        self.requests: list[str] = []
        self.errors: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.call("Performance.enable", timeDomain="threadTicks")
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait()
        os.close(self._read)
        os.close(self._write)
        self._folder.cleanup()

    def call(self, method: str, **parameters: Any) -> Any:
        """What the protocol answers; raises ``RuntimeError`` if that is an error."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        self._send(json.dumps(message).encode() + b"\0")
        while (answer := self._next()).get("id") != number:
            if answer.get("method") == "Network.requestWillBeSent":
                self.requests.append(answer["params"]["request"]["url"])
            if answer.get("method") == "Runtime.exceptionThrown":
                details = answer["params"]["exceptionDetails"]
                self.errors.append(details.get("exception", {}).get("description", details["text"]))
            if answer.get("method") == "Log.entryAdded" and answer["params"]["entry"]["level"] == "error":
                self.errors.append(str(answer["params"]["entry"]))
            if answer.get("method") == "Runtime.consoleAPICalled" and answer["params"]["type"] == "error":
                self.errors.append(str(answer["params"]["args"]))
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']['message']}")
        return answer["result"]

    def _send(self, data: bytes) -> None:
        while data:
            data = data[os.write(self._write, data) :]

    def _next(self) -> dict[str, Any]:
        """The next message."""
        end = time.monotonic() + _SECONDS
        while b"\0" not in self._rest:
            if not select.select([self._read], [], [], max(0.0, end - time.monotonic()))[0]:
                raise RuntimeError(f"The browser has not answered for {_SECONDS:g} s.")
            if not (data := os.read(self._read, 2**16)):
                raise RuntimeError("The browser has ended.")
            self._rest += data
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)

    def open(self, path: Path, until: str = "document.readyState === 'complete'") -> None:
        """Open a file, and wait until an expression is true."""
        self.requests, self.errors = [], []
        self.call("Page.navigate", url=path.resolve().as_uri())
        self.wait(until)

    def wait(self, until: str) -> None:
        """Until an expression is true; raises ``RuntimeError`` if that takes a minute."""
        end = time.monotonic() + _SECONDS
        while not self.run(until):
            if time.monotonic() > end:
                raise RuntimeError(f"After {_SECONDS:g} s this is not true: {until}; {self.errors}")
            time.sleep(0.02)

    def run(self, script: str) -> Any:
        """The value of an expression of JavaScript; raises ``RuntimeError`` with what it throws, or if it hangs."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"]["exception"].get("description", "an exception"))
        return answer["result"].get("value")

    def milliseconds(self, script: str) -> float:
        """Of the processor that the page's thread takes for a script."""
        before, _, after = self._thread_time(), self.run(f"{script}; 0"), self._thread_time()
        return 1e3 * (after - before)

    def _thread_time(self) -> float:
        metrics = self.call("Performance.getMetrics")["metrics"]
        return next(each["value"] for each in metrics if each["name"] == "ThreadTime")

    def mouse(self, kind: str, x: float, y: float) -> None:
        """The mouse is ``mousePressed``, ``mouseMoved`` or ``mouseReleased`` somewhere."""
        pressed = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, buttons=int(kind != "mouseReleased"), **pressed)

    def key(self, name: str, *, shift: bool = False) -> None:
        """A key is pressed and let go."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=name, code=name, modifiers=8 * shift)

    def prefer(self, **features: str) -> None:
        """What the user prefers, as ``prefers_color_scheme="dark"``."""
        named = [{"name": name.replace("_", "-"), "value": value} for name, value in features.items()]
        self.call("Emulation.setEmulatedMedia", features=named)

    def picture(self, path: Path) -> None:
        """Write a PNG of the page."""
        path.write_bytes(b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
