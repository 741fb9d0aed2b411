"""A headless Chromium for the tests, driven over its debugging pipe: no port, no further package."""

import base64
import json
import os
import shutil
import subprocess
import sys
import time

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
]

# becomes Chromium, which reads its commands from file 3 and answers on file 4
_WITH_PIPES = """
import fcntl, os, sys
pipes = [fcntl.fcntl(int(number), fcntl.F_DUPFD, 10) for number in sys.argv[1:3]]
for pipe, number in zip(pipes, (3, 4)):
    os.dup2(pipe, number)
os.execvp(sys.argv[3], sys.argv[3:])
"""


class Chromium:
    """One browser with one page; commands of the Chrome DevTools Protocol.

    Parameters
    ----------
    profile : folder for the browser's files
    size : of the window, CSS px
    """

    def __init__(self, profile, size=(1000, 760)):
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()
        command = [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}", "about:blank"]
        self._process = subprocess.Popen(
            [sys.executable, "-c", _WITH_PIPES, str(to_read), str(to_write), *command],
            pass_fds=(to_read, to_write),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_read)
        os.close(to_write)
        self._rest, self._number, self._session = b"", 0, None
        self.requests = []  # addresses asked for by the page
        self.said = []  # errors in the page's console
        page = next(t for t in self.do("Target.getTargets")["targetInfos"] if t["type"] == "page")
        self._session = self.do("Target.attachToTarget", targetId=page["targetId"], flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.do(f"{domain}.enable")
        self.resize(*size)

    def do(self, method, **parameters):
        """Run one command; returns its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            reply = self._next()
            if reply.get("id") == self._number:
                if "error" in reply:
                    raise RuntimeError(f"{method}: {reply['error']['message']}")
                return reply["result"]
            self._note(reply)

    def _next(self):
        while b"\0" not in self._rest:
            piece = os.read(self._read, 1 << 20)
            if not piece:
                raise RuntimeError("Chromium has ended")
            self._rest += piece
        raw, self._rest = self._rest.split(b"\0", 1)
        return json.loads(raw)

    def _note(self, event):
        if event.get("method") == "Network.requestWillBeSent":
            self.requests.append(event["params"]["request"]["url"])
        if event.get("method") == "Runtime.exceptionThrown":
            self.said.append(str(event["params"]["exceptionDetails"]))
        if event.get("method") == "Log.entryAdded" and event["params"]["entry"]["level"] == "error":
            self.said.append(event["params"]["entry"]["text"])

    def resize(self, width, height, mobile=False):
        scale = 2 if mobile else 1
        self.do(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=mobile
        )

    def go(self, address):
        self.do("Page.navigate", url=address)

    def reload(self):
        """Load the page anew; returns when the old document is gone and the new one is there."""
        self.see("window.of_before = true")
        self.do("Page.reload")
        self.wait("!window.of_before && document.readyState == 'complete'")

    def arrive(self, path):
        """Until a page of the server is there as a whole."""
        self.wait(f"location.pathname == {json.dumps(path)} && document.readyState == 'complete'")

    def see(self, expression):
        """The value of a JavaScript expression in the page."""
        result = self.do("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            raise RuntimeError(f"{expression}: {result['exceptionDetails']}")
        return result["result"].get("value")

    def wait(self, expression, seconds=30):
        """Until the expression is true in the page, which may be on its way to another."""
        end = time.monotonic() + seconds
        while True:
            try:
                value = self.see(expression)
            except RuntimeError as error:
                if "ended" in str(error):
                    raise
                value = None
            if value:
                return value
            if time.monotonic() > end:
                text = self.see("document.body?.innerText")
                raise AssertionError(f"waited {seconds} s for {expression}; the page says: {text}; {self.said}")
            time.sleep(0.01)

    def click(self, selector):
        """A real press of the mouse in the middle of an element."""
        where = f"document.querySelector({json.dumps(selector)})"
        self.wait(
            f"document.readyState == 'complete' && {where} && !{where}.disabled && {where}.getClientRects().length"
        )
        box = self.see(f"{where}.scrollIntoView({{block: 'nearest'}}), {where}.getBoundingClientRect().toJSON()")
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        for kind in ("mousePressed", "mouseReleased"):
            self.do("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def press(self, key):
        code = {"ArrowLeft": 37, "ArrowRight": 39, "ArrowDown": 40, " ": 32}[key]
        for kind in ("keyDown", "keyUp"):
            self.do("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)

    def picture(self, path):
        shot = self.do("Page.captureScreenshot", format="png")
        path.write_bytes(base64.b64decode(shot["data"]))

    def close(self):
        try:
            self._session = None
            self.do("Browser.close")
        except (RuntimeError, OSError):
            pass
        self._process.kill()
        self._process.wait()
        os.close(self._read)
        os.close(self._write)
