"""Headless Chromium by the DevTools protocol, over two pipes: no driver and no package of its own."""

import base64
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic",
    "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
    "--remote-debugging-pipe",
)  # fmt: skip


def program() -> str | None:
    """The browser: FLEXARM_BROWSER, or the first of NAMES that there is."""
    return os.environ.get("FLEXARM_BROWSER") or next((found for name in NAMES if (found := shutil.which(name))), None)


class Page:
    """One tab. `faults` holds what its console said in warning or error, `requests` what it asked for and may have."""

    def __init__(self, reading: int, writing: int) -> None:
        self._in, self._out = os.fdopen(reading, "rb"), os.fdopen(writing, "wb", buffering=0)
        self._number, self._session, self._waiting = 0, "", b""
        self.faults: list[str] = []
        self.requests: dict[str, str] = {}
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")

    def send(self, method: str, **params: Any) -> Any:
        """A command's result."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        self._out.write(json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self._heard(answer)

    def _read(self) -> Any:
        while b"\0" not in self._waiting:
            more = self._in.read1(1 << 20)
            if not more:
                raise RuntimeError("the browser has gone")
            self._waiting += more
        first, _, self._waiting = self._waiting.partition(b"\0")
        return json.loads(first)

    def _heard(self, event: dict[str, Any]) -> None:
        method, told = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = told["exceptionDetails"]
            self.faults.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning", "assert"):
            self.faults.append(" ".join(str(one.get("value")) for one in told["args"]))
        elif method == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning"):
            self.faults.append(told["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests[told["requestId"]] = told["request"]["url"]
        elif method == "Network.loadingFailed" and told.get("blockedReason") == "csp":
            self.requests.pop(told["requestId"], None)

    # ---------------------------------------------------------------- what a person does
    def open(self, path: Path, width: int = 1280, height: int = 800, scale: float = 1.0, dark: bool = False) -> None:
        """Show a file in a window of this size (CSS pixels) and wait until it is drawn."""
        self.resize(width, height, scale)
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.send("Emulation.setEmulatedMedia", features=scheme)
        self.send("Page.navigate", url=path.resolve().as_uri())
        self.until("document.readyState === 'complete'")
        self.settle()

    def resize(self, width: int, height: int, scale: float = 1.0) -> None:
        """Size of the window, CSS pixels, and device pixels in each."""
        size = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": width < 500}
        self.send("Emulation.setDeviceMetricsOverride", **size)

    def run(self, script: str) -> Any:
        """The value of an expression; promises are awaited."""
        done = self.send("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in done:
            raise RuntimeError(f"{script}: {done['exceptionDetails']['exception'].get('description')}")
        return done["result"].get("value")

    def settle(self) -> None:
        """Two pictures of the screen later."""
        self.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def until(self, script: str, seconds: float = 20.0) -> None:
        """Wait for an expression to be true."""
        end = time.monotonic() + seconds
        while not self.run(script):
            if time.monotonic() > end:
                raise TimeoutError(script)
            time.sleep(0.02)

    def press(self, key: str, code: str = "", shift: bool = False) -> None:
        """A key, down and up; `key` as KeyboardEvent.key has it."""
        numbers = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40, "Home": 36, "End": 35, "Tab": 9}
        number = numbers.get(key, ord(key.upper()[0]) if len(key) == 1 else 0)
        same = {"key": key, "code": code or key, "windowsVirtualKeyCode": number, "modifiers": 8 if shift else 0}
        text = {"text": key} if len(key) == 1 else {}
        self.send("Input.dispatchKeyEvent", type="keyDown", **same, **text)
        self.send("Input.dispatchKeyEvent", type="keyUp", **same)
        self.settle()

    def set(self, selector: str, value: float, event: str = "input") -> None:
        """Give a control a value, as a hand does."""
        script = f"(c => {{ c.value = {value}; c.dispatchEvent(new Event('{event}')); }})"
        self.run(f"{script}(document.querySelector({json.dumps(selector)}))")
        self.settle()

    def box(self, selector: str) -> dict[str, float]:
        """Where an element is on the screen: x, y, width, height, after it has been scrolled to."""
        script = f"(() => {{ const e = document.querySelector({json.dumps(selector)}); "
        script += "e.scrollIntoView({block: 'center'}); return e.getBoundingClientRect().toJSON(); })()"
        found: dict[str, float] = self.run(script)
        return found

    def click(self, selector: str, share: tuple[float, float] = (0.5, 0.5)) -> None:
        """A click of the mouse at a place of an element."""
        x, y = self._place(selector, share)
        for kind in ("mousePressed", "mouseReleased"):
            self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)
        self.settle()

    def drag(self, selector: str, start: tuple[float, float], end: tuple[float, float], touch: bool = False) -> None:
        """The mouse or a finger from one place of an element to another."""
        self.send("Emulation.setTouchEmulationEnabled", enabled=touch)
        places = [self._place(selector, (start[0] + s * (end[0] - start[0]), start[1])) for s in (0.0, 0.3, 0.7, 1.0)]
        kinds = ("touchStart", "touchMove", "touchEnd") if touch else ("mousePressed", "mouseMoved", "mouseReleased")
        for k, (x, y) in enumerate([*places, places[-1]]):
            kind = kinds[0] if k == 0 else kinds[1] if k < len(places) else kinds[2]
            if touch:
                points = [] if kind == "touchEnd" else [{"x": x, "y": y}]
                self.send("Input.dispatchTouchEvent", type=kind, touchPoints=points)
            else:
                self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)
        self.settle()
        self.send("Emulation.setTouchEmulationEnabled", enabled=False)

    def _place(self, selector: str, share: tuple[float, float]) -> tuple[float, float]:
        box = self.box(selector)
        return box["x"] + share[0] * box["width"], box["y"] + share[1] * box["height"]

    def picture(self, path: Path, whole: bool = False) -> None:
        """A screenshot as a PNG file; whole: of all of the page."""
        shot = self.send("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(shot["data"]))


@contextmanager
def browser(folder: Path) -> Iterator[Page]:
    """A tab of a new browser whose profile is `folder`, which is empty. RuntimeError where there is none."""
    name = program()
    if name is None:
        raise RuntimeError(f"no browser: none of {', '.join(NAMES)} is here; FLEXARM_BROWSER names one elsewhere")
    (there, writing), (reading, back) = os.pipe(), os.pipe()
    words = [name, *FLAGS, f"--user-data-dir={folder}", "about:blank"]
    # the browser reads from descriptor 3 and writes to 4
    script = f'exec 5<&{there} 6>&{back}; exec 3<&5 4>&6 5<&- 6>&-; exec "$@"'
    with (folder.parent / f"{folder.name}.log").open("wb") as log:
        process = subprocess.Popen(
            ["bash", "-c", script, "browser", *words], pass_fds=(there, back), stdout=log, stderr=log
        )
    os.close(there)
    os.close(back)
    try:
        yield Page(reading, writing)
    finally:
        process.terminate()
        process.wait(timeout=20)
