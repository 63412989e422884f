"""A browser without a window, steered through its pipe: what a reader of a page would see.

It speaks Chromium's DevTools protocol, so that a page is tested without any change to it. No name
is resolved to an address, and every request and every message of the console is kept.
"""

import base64
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "chrome")

# Starting takes seconds on a busy machine, an answer takes less.
PATIENCE = 60.0


def browser_program() -> str | None:
    """Path of an installed Chromium; None for none."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


class Browser:
    """One page of a browser; a context manager.

    Attributes:
        requests: Addresses that the page asked for.
        complaints: Messages of its console and log, and its errors.
    """

    def __init__(self, program: str, folder: Path) -> None:
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self._number = 0
        self._session: str | None = None
        self._unread = b""
        theirs_in, self._to = os.pipe()
        self._from, theirs_out = os.pipe()
        options = (
            "--headless --no-sandbox --disable-gpu --disable-dev-shm-usage --no-first-run "
            "--disable-background-networking --disable-component-update --disable-extensions "
            "--remote-debugging-pipe"
        )
        # The browser reads its orders from descriptor 3 and answers on 4.
        words = f'exec "$0" "$@" 3<&{theirs_in} 4>&{theirs_out}'
        rules = "--host-resolver-rules=MAP * ~NOTFOUND"
        line = ["bash", "-c", words, program, *options.split(), rules]
        self._process = subprocess.Popen(
            [*line, f"--user-data-dir={folder}"],
            pass_fds=(theirs_in, theirs_out),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs_in)
        os.close(theirs_out)

    def __enter__(self) -> "Browser":
        target = self.order("Target.createTarget", url="about:blank")["targetId"]
        found = self.order("Target.attachToTarget", targetId=target, flatten=True)
        self._session = found["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.order(f"{domain}.enable")
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait()
        os.close(self._to)
        os.close(self._from)

    def order(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send one order of the protocol and return its answer.

        Raises:
            RuntimeError: the browser refuses it, or does not answer in time.
        """
        self._number += 1
        order = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            order["sessionId"] = self._session
        os.write(self._to, json.dumps(order).encode() + b"\0")
        while True:
            message = self._message()
            if message.get("id") == self._number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]

    def open(self, page: Path, width: int, height: int, dark: bool = False) -> None:
        """Show a file in a window of so many pixels, and wait until it is drawn."""
        self.requests.clear()
        self.complaints.clear()
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.order("Emulation.setDeviceMetricsOverride", **size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.order("Emulation.setEmulatedMedia", features=[scheme])
        self.order("Page.navigate", url=page.as_uri())
        self.settle()

    def settle(self) -> None:
        """Wait until the page is loaded and two frames have been drawn."""
        self.value(
            "new Promise(done => { const wait = () => document.readyState === 'complete' && "
            "location.href !== 'about:blank' ? requestAnimationFrame(() => "
            "requestAnimationFrame(() => done(1))) : setTimeout(wait, 20); wait(); })"
        )

    def value(self, expression: str) -> Any:
        """Value of a JavaScript expression in the page.

        Raises:
            RuntimeError: it throws.
        """
        found = self.order(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in found:
            raise RuntimeError(f"{expression}: {found['exceptionDetails']}")
        return found["result"].get("value")

    def screenshot(self, path: Path) -> None:
        """Write what the window shows as a PNG."""
        image = self.order("Page.captureScreenshot", format="png")["data"]
        path.write_bytes(base64.b64decode(image))

    def print(self, path: Path) -> None:
        """Write the printed page as a PDF."""
        printed = self.order("Page.printToPDF", printBackground=True)["data"]
        path.write_bytes(base64.b64decode(printed))

    def _message(self) -> dict[str, Any]:
        """The next message; an event is also kept."""
        until = time.monotonic() + PATIENCE
        while b"\0" not in self._unread:
            ready, _, _ = select.select([self._from], [], [], until - time.monotonic())
            data = os.read(self._from, 1 << 20) if ready else b""
            if not data:
                raise RuntimeError("the browser does not answer")
            self._unread += data
        text, _, self._unread = self._unread.partition(b"\0")
        message = json.loads(text)
        method, values = message.get("method"), message.get("params", {})
        if method == "Network.requestWillBeSent":
            self.requests.append(values["request"]["url"].partition(",")[0])
        elif method in ("Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded"):
            self.complaints.append(json.dumps(values))
        return message
