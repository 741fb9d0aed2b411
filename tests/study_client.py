"""A study to be served, its server as a process of its own, and participants who speak HTTP without a browser."""

import contextlib
import http.client
import json
import os
import re
import secrets
import signal
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlencode

from study.design import make_design, stimuli_from_folder
from study.settings import write_settings
from study.videos import copy_videos


def write_study(folder, videos, settings="", **design):
    """A study of the folder `videos`; `settings` are lines of study.toml in place of the default ones."""
    folder = Path(folder)
    folder.mkdir(parents=True)
    stimuli = copy_videos(stimuli_from_folder(videos), folder)
    made = make_design(stimuli, **design)
    made.save(folder)
    (folder / "study.toml").write_text(settings)
    write_settings(folder, 5)
    return made


def write_bytes_as_videos(folder, names, size=1000):
    """Files that a server cannot tell from videos."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, name in enumerate(names):
        (folder / f"{name}.mp4").write_bytes(bytes((i + k) % 251 for k in range(size)))
    return folder


class ServerProcess:
    """`lipmetrics study serve` in another process, to be killed and started anew at the same port."""

    def __init__(self, folder, port=0):
        self.folder, self.port = folder, port
        self.start()

    def start(self):
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
        command = [sys.executable, "-m", "study.cli", "serve", str(self.folder), "--port", str(self.port)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        for line in self.process.stdout:
            found = re.search(r"http://127\.0\.0\.1:(\d+)/", line)
            if found:
                self.port = int(found[1])
                return
        raise AssertionError("the server ended before it listened")

    @property
    def address(self):
        return f"http://127.0.0.1:{self.port}/"

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        self.process.stdout.close()

    def stop(self):
        self.process.terminate()
        self.process.wait(timeout=20)
        self.process.stdout.close()


class Visitor:
    """A browser without pictures: keeps the cookie, follows nothing by itself."""

    def __init__(self, port):
        self.port, self.cookie = port, None
        self._connection = None

    def ask(self, method, path, body=None, headers=None):
        """(status, headers, bytes) of one request; a broken connection is an OSError or HTTPException."""
        headers = dict(headers or {})
        if self.cookie:
            headers.setdefault("Cookie", f"study={self.cookie}")
        if self._connection is None:
            self._connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        try:
            self._connection.request(method, path, body, headers)
            reply = self._connection.getresponse()
            content = reply.read()
        except (OSError, http.client.HTTPException):
            self.hang_up()
            raise
        for value in reply.headers.get_all("Set-Cookie") or []:
            found = re.match(r'study="?([^";]*)', value)
            if found:
                self.cookie = found[1] or None
        return reply.status, reply.headers, content

    def hang_up(self):
        with contextlib.suppress(OSError):
            if self._connection is not None:
                self._connection.close()
        self._connection = None

    def form(self, path, **fields):
        return self.ask("POST", path, urlencode(fields), {"Content-Type": "application/x-www-form-urlencoded"})

    def consent_fields(self, path="/"):
        """The hidden fields of the first page."""
        status, _, content = self.ask("GET", path)
        assert status == 200, content
        return dict(re.findall(r'type="hidden" name="(\w+)" value="([^"]*)"', content.decode()))

    def begin(self, path="/"):
        status, headers, _ = self.form("/begin", **(self.consent_fields(path) | {"agree": "yes"}))
        assert (status, headers["Location"]) == (303, "instructions")
        return self

    def state(self):
        status, _, content = self.ask("GET", "/state")
        return status, json.loads(content)

    def answer(self, trial, choice, nonce=None, measures=None, **more):
        said = {"trial": trial, "nonce": nonce or secrets.token_hex(16), "choice": choice, "measures": measures or {}}
        return self.post(json.dumps(said | more))

    def post(self, body, kind="application/json"):
        status, _, content = self.ask("POST", "/answer", body, {"Content-Type": kind})
        try:
            return status, json.loads(content)
        except ValueError:
            return status, content
