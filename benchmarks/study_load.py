"""Many participants at once against the study's server on this machine: errors, answers per second, answer times.

    python benchmarks/study_load.py                        # 200 participants of 60 trials, no pause between answers
    python benchmarks/study_load.py --pause 3              # as people do, who look at the videos for some seconds

Every participant fetches both videos of a trial and answers; at the end the database must hold exactly what was sent.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import secrets
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from results import machine, markdown

from study.design import make_design, stimuli_from_folder
from study.export import answers_table
from study.settings import write_settings
from study.store import Store
from study.videos import copy_videos

VIDEO_BYTES = 50_000  # of a second of a small mouth


def make_study(folder: Path, people_n: int, trials_n: int):
    """A study of trials_n pairs, of files that a server cannot tell from videos; returns its design."""
    clips = folder / "clips"
    clips.mkdir(parents=True)
    for number in range(2 * trials_n):
        (clips / f"{'abcdefghij'[number // 2 % 10] * (1 + number // 20)}_{number % 2}.mp4").write_bytes(
            bytes([number % 256]) * VIDEO_BYTES
        )
    design = make_design(copy_videos(stimuli_from_folder(clips), folder), participants_n=people_n)
    design.save(folder)
    write_settings(folder, 1)
    return design


class Line:
    """One connection that is kept: a browser's."""

    def __init__(self, port: int):
        self.port, self.cookie, self.reader = port, "", None

    async def ask(self, method: str, path: str, body: bytes = b"", kind: str = "") -> tuple[int, str, bytes]:
        """Status, head and content of one request."""
        if self.reader is None:
            self.reader, self.writer = await asyncio.open_connection("127.0.0.1", self.port)
        head = f"{method} {path} HTTP/1.1\r\nHost: a\r\nCookie: {self.cookie}\r\nContent-Length: {len(body)}\r\n"
        self.writer.write((head + (f"Content-Type: {kind}\r\n" if kind else "") + "\r\n").encode() + body)
        head = (await self.reader.readuntil(b"\r\n\r\n")).decode("latin-1")
        length = int(re.search(r"content-length: (\d+)", head, re.IGNORECASE)[1])
        return int(head.split()[1]), head, await self.reader.readexactly(length)


async def take_part(port: int, seed: int, pause_s: float) -> tuple[list[tuple[int, str]], list[float]]:
    """One session; returns the answers (trial, side) and how long each took to be taken, s."""
    rng = np.random.default_rng(seed)
    line, told, seconds = Line(port), [], []
    _, _, page = await line.ask("GET", "/")
    key = re.search(r'name="key" value="([^"]*)"', page.decode())[1]
    _, head, _ = await line.ask("POST", "/begin", f"key={key}&agree=yes".encode(), "application/x-www-form-urlencoded")
    line.cookie = re.search(r"set-cookie: (study=[^;]*)", head, re.IGNORECASE)[1]
    _, _, state = await line.ask("GET", "/state")
    state = json.loads(state)
    while not state["done"]:
        for side in ("left", "right"):
            status, _, content = await line.ask("GET", f"/{state[side]}")
            if status != 200 or len(content) != VIDEO_BYTES:
                raise RuntimeError(f"a video came with status {status} and {len(content)} bytes")
        await asyncio.sleep(pause_s * rng.uniform(0.5, 1.5))
        side = str(rng.choice(["left", "right"]))
        said = {
            "trial": state["trial"],
            "nonce": secrets.token_hex(16),
            "choice": side,
            "measures": {"replays_left": 0},
        }
        begin = time.perf_counter()
        status, _, reply = await line.ask("POST", "/answer", json.dumps(said).encode(), "application/json")
        seconds.append(time.perf_counter() - begin)
        if status != 200:
            raise RuntimeError(f"an answer came back with status {status}: {reply!r}")
        told.append((said["trial"], side))
        state = json.loads(reply)
    line.writer.close()
    return told, seconds


async def crowd(port: int, people_n: int, pause_s: float) -> list[tuple[list[tuple[int, str]], list[float]]]:
    """All at once."""
    return await asyncio.gather(*(take_part(port, seed, pause_s) for seed in range(people_n)))


def load(folder: Path, people_n: int, trials_n: int, pause_s: float = 0.0) -> dict[str, float]:
    """Serve a study in `folder` to a crowd, and compare the database with what was sent.

    Raises
    ------
    RuntimeError : a request failed, or the database holds anything else than the answers sent
    """
    design = make_study(folder, people_n, trials_n)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-m", "study.cli", "serve", str(folder), "--port", "0"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    try:
        port = next(int(found[1]) for line in server.stdout if (found := re.search(r"http://[\d.]+:(\d+)/", line)))
        begin = time.perf_counter()
        people = asyncio.run(crowd(port, people_n, pause_s))
        wall_s = time.perf_counter() - begin
    finally:
        server.terminate()
        server.wait()
    store = Store(folder / "answers.sqlite", design.identity, people_n)
    table = answers_table(store, design)
    store.close()
    sides = np.where(table["chosen"] == table["left"], "left", "right")
    stored = pd.Series(list(zip(table["trial"], sides, strict=True))).groupby(table["participant"]).apply(list)
    if sorted(stored) != sorted(told for told, _ in people):
        raise RuntimeError("the database does not hold the answers that were sent")
    ms = 1e3 * np.concatenate([seconds for _, seconds in people])
    return {
        "participants": people_n,
        "answers": len(table),
        "answers per s": len(table) / wall_s,
        **{f"p{share} ms": float(np.percentile(ms, share)) for share in (50, 99)},
        "longest ms": float(ms.max()),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--people", type=int, default=200)
    parser.add_argument("--trials", type=int, default=60)
    parser.add_argument("--pause", type=float, default=0.0, help="mean time between answers, s")
    arguments = parser.parse_args()
    print(machine())
    with tempfile.TemporaryDirectory() as folder:
        row = load(Path(folder) / "study", arguments.people, arguments.trials, arguments.pause)
    print(markdown(pd.DataFrame([row]).set_index("participants"), decimals=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
