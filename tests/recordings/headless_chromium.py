"""Opens a page in headless Chromium and looks at it, by the DevTools protocol over a pipe."""

import base64
import contextlib
import json
import os
import select
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

CHROMIUM = Path("/usr/bin/chromium")
_ARGUMENTS = (
    "--headless=new", "--no-sandbox", "--remote-debugging-pipe", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--disable-background-networking", "--no-first-run",
    "--disable-component-update", "--hide-scrollbars",
)  # fmt: skip

Picture = NDArray[np.uint8]


class Page:
    """A page that is open.

    Attributes:
        asked: every address that the page tried to load.
        refused: those that its own policy forbade.
    """

    def __init__(self, to_browser: int, from_browser: int) -> None:
        self._to, self._from = to_browser, from_browser
        self._rest, self._number, self._session = b"", 0, None
        self._is_loaded = False
        self.asked: dict[str, str] = {}
        self.refused: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self.call("Network.enable")
        self.call("Page.enable")

    def call(self, method: str, **parameters: Any) -> Any:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]

    def open(self, url: str) -> None:
        self._is_loaded = False
        self.call("Page.navigate", url=url)
        # Until then the old page may still be the one that is asked.
        while not self._is_loaded:
            self._next()

    def picture(self) -> Picture:
        """The page as it looks now, RGB."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert found is not None
        return np.asarray(cv2.cvtColor(found, cv2.COLOR_BGR2RGB), np.uint8)

    def picture_once(self, wanted: Callable[[Picture], bool], *, within_s: float) -> Picture:
        """The first picture that is as wanted, or the last one of that time."""
        deadline = time.monotonic() + within_s
        while not wanted(seen := self.picture()) and time.monotonic() < deadline:
            time.sleep(0.5)
        return seen

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._from], [], [], 60.0)
            assert ready, "chromium does not answer"
            part = os.read(self._from, 1 << 20)
            assert part, "chromium is gone"
            self._rest += part
        text, self._rest = self._rest.split(b"\0", 1)
        message: dict[str, Any] = json.loads(text)
        event = message.get("params", {})
        self._is_loaded |= message.get("method") == "Page.loadEventFired"
        if message.get("method") == "Network.requestWillBeSent":
            self.asked[event["requestId"]] = event["request"]["url"]
        if message.get("method") == "Network.loadingFailed" and event.get("blockedReason") == "csp":
            self.refused.append(self.asked[event["requestId"]])
        return message


@contextmanager
def chromium(home: Path, *, width: int = 1600, height: int = 900) -> Iterator[Page]:
    """A browser with a home of its own, ended at the end."""
    browser_reads, to_browser = os.pipe()
    from_browser, browser_writes = os.pipe()
    command = [str(CHROMIUM), *_ARGUMENTS, f"--window-size={width},{height}", f"--user-data-dir={home}"]
    # DevTools' pipe is file descriptors 3 and 4.
    shell = ["bash", "-c", f'exec "$@" 3<&{browser_reads} 4>&{browser_writes}', "bash", *command]
    with (home / "chromium.log").open("wb") as log:
        process = subprocess.Popen(
            shell, pass_fds=(browser_reads, browser_writes), stdout=log, stderr=log,
            env={**os.environ, "HOME": str(home), "XDG_CONFIG_HOME": str(home)},
        )  # fmt: skip
    os.close(browser_reads)
    os.close(browser_writes)
    try:
        yield Page(to_browser, from_browser)
    finally:
        with contextlib.suppress(OSError):
            os.write(to_browser, b'{"id":0,"method":"Browser.close"}\0')
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        os.close(to_browser)
        os.close(from_browser)
