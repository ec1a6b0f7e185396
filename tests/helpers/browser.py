"""A headless Chromium, driven by its DevTools protocol over two pipes."""

from __future__ import annotations

import base64
import io
import itertools
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

_FLAGS = (
    "--headless=new --no-sandbox --disable-gpu-sandbox --use-angle=swiftshader "
    "--enable-unsafe-swiftshader --no-first-run --disable-extensions "
    "--disable-background-networking --remote-debugging-pipe"
)


def chromium() -> str | None:
    """Path of a Chromium or Chrome; None if there is none."""
    names = ("chromium", "chromium-browser", "google-chrome", "chrome")
    return next((found for name in names if (found := shutil.which(name))), None)


class Browser:
    """One tab of a browser.  `events` holds all that the browser has told so far.

    Use it as a context manager.
    """

    def __init__(self, folder: Path, size: tuple[int, int] = (1000, 700), flags: str = "") -> None:
        (theirs, ours_out), (ours_in, back) = os.pipe(), os.pipe()
        self._out, self._in = os.fdopen(ours_out, "wb", 0), os.fdopen(ours_in, "rb", 0)
        self._numbers, self._rest, self.events = itertools.count(1), b"", []
        command = [str(chromium()), *_FLAGS.split(), *flags.split(), f"--user-data-dir={folder}"]
        # The browser reads descriptor 3 and writes 4; a shell moves ours there.
        script = f'exec 3<&{theirs} 4>&{back}; exec "$@"'
        self._process = subprocess.Popen(
            ["bash", "-c", script, "bash", *command],
            pass_fds=(theirs, back),
            stderr=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )
        os.close(theirs)
        os.close(back)
        self._session: str | None = None
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        opened = self.send("Target.attachToTarget", targetId=target, flatten=True)
        self._session = opened["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.send(f"{domain}.enable")
        self.resize(*size)
        self.scheme("light")

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._out.close()
        self._in.close()

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Result of a command."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        self._out.write(json.dumps(message).encode() + b"\0")
        while True:
            found = self._next()
            if found.get("id") == number:
                assert "error" not in found, (method, found)
                return found["result"]
            self.events.append(found)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            data = self._in.read(1 << 16)
            assert data, "the browser has gone"
            self._rest += data
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)

    def resize(self, width: int, height: int, *, mobile: bool = False) -> None:
        screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile}
        self.send("Emulation.setDeviceMetricsOverride", **screen)

    def scheme(self, name: str, motion: str = "reduce") -> None:
        """Set the colour scheme that the user prefers, "light" or "dark", and whether to move."""
        wanted = {"color-scheme": name, "reduced-motion": motion}
        features = [{"name": f"prefers-{k}", "value": value} for k, value in wanted.items()]
        self.send("Emulation.setEmulatedMedia", features=features)

    def open(self, page: Path) -> None:
        """Open a file and wait until it is loaded."""
        self.events.clear()
        self.send("Page.navigate", url=page.resolve().as_uri())
        while not any(event.get("method") == "Page.loadEventFired" for event in self.events):
            self.events.append(self._next())

    def value(self, script: str) -> Any:
        """Value of an expression, which may be a promise; an error of the page fails."""
        found = self.send(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def picture(self, path: Path) -> None:
        """Write what the tab shows as PNG."""
        path.write_bytes(base64.b64decode(self.send("Page.captureScreenshot")["data"]))

    def requests(self) -> list[str]:
        """Addresses that were asked for since the page was opened."""
        sent = [e for e in self.events if e.get("method") == "Network.requestWillBeSent"]
        return [event["params"]["request"]["url"] for event in sent]

    def complaints(self) -> list[Any]:
        """Errors and warnings of the page, such as exceptions and blocked requests."""
        kinds = ("Runtime.exceptionThrown", "Log.entryAdded", "Runtime.consoleAPICalled")
        return [event["params"] for event in self.events if event.get("method") in kinds]

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        self.send("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **more)

    def click(self, x: float, y: float) -> None:
        self.drag((x, y))

    def drag(self, *places: tuple[float, float], **more: Any) -> None:
        """Press at the first place, move over the others, and release at the last."""
        left = {"button": "left", "buttons": 1, "clickCount": 1, **more}
        self.mouse("Pressed", *places[0], **left)
        for place in places[1:]:
            self.mouse("Moved", *place, **left)
        self.mouse("Released", *places[-1], **{**left, "buttons": 0})

    def touch(self, kind: str, *places: tuple[float, float]) -> None:
        points = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(places)]
        self.send("Input.dispatchTouchEvent", type=f"touch{kind}", touchPoints=points)

    def key(self, key: str, **more: Any) -> None:
        text = {"text": key} if len(key) == 1 else {}
        self.send("Input.dispatchKeyEvent", type="keyDown", key=key, **text, **more)
        self.send("Input.dispatchKeyEvent", type="keyUp", key=key, **more)


def points(browser: Browser, script: str) -> np.ndarray:
    """Positions (V, 3) that a script gives."""
    return np.reshape(browser.value(f"Promise.resolve({script}).then(Array.from)"), (-1, 3))


def drawn(browser: Browser, canvas: str = "view") -> np.ndarray:
    """Pixels of the mesh, or of the marks over it (height, width, RGBA)."""
    script = f"document.getElementById('{canvas}').toDataURL()"
    # read in the frame in which it is drawn, before the browser clears it
    draw = f"new Promise(r => {{ ssdr.set({{}}); requestAnimationFrame(() => r({script})); }})"
    data = base64.b64decode(browser.value(draw).partition(",")[2])
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGBA")).copy()
