"""The study's pages over real HTTP: a whole session, what must be refused, and the server killed at random moments."""

import http.client
import json
import os
import re
import secrets
import socket
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from study_client import ServerProcess, Visitor, write_bytes_as_videos, write_study

from study.design import load_design

pytest.importorskip("starlette", reason="the extra web is not installed")
pytest.importorskip("uvicorn", reason="the extra web is not installed")

import uvicorn

from study.errors import InputError
from study.export import answers_table
from study.server import BODY_LIMIT_BYTES, make_app, open_study

NAMES = ("p_0", "p_4", "p_7", "p_10")
NONCE = "0123456789abcdef"


@pytest.fixture
def serving(tmp_path):
    """A function that serves a study made with some settings: (study, port)."""
    running = []

    def start(settings="", **design):
        videos = write_bytes_as_videos(tmp_path / "clips", NAMES)
        folder = tmp_path / f"study{len(running)}"
        write_study(folder, videos, settings, **({"participants_n": 4} | design))
        study = open_study(folder)
        listening = socket.create_server(("127.0.0.1", 0))
        config = uvicorn.Config(make_app(study), access_log=False, log_level="critical", lifespan="off")
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        running.append((server, thread, study))
        return study, listening.getsockname()[1]

    yield start
    for server, thread, study in running:
        server.should_exit = True
        thread.join()
        study.store.close()


def everything(study):
    return study.store.sessions(), study.store.answers(), study.store.outside_ids()


# -- a session --------------------------------------------------------------------------------------------------------


def test_a_whole_session(serving):
    study, port = serving(
        'completion_code = "C<1>"\ncompletion_url = "https://a.b/c?d=1&e=2"\n', catch_n=2, practice_n=1
    )
    visitor = Visitor(port).begin()
    assert b"Press <strong>Play</strong>" in visitor.ask("GET", "/instructions")[2]
    assert visitor.ask("GET", "/trials")[0] == 200
    trials = study.design.sessions[0]
    rng = np.random.default_rng(4)
    clicks = []
    for trial in trials:
        status, state = visitor.state()
        assert status == 200 and state["trial"] == trial.trial and state["of"] == len(trials) == 9
        assert state["kind"] == ("practice" if trial.kind == "practice" else "trial")
        assert state["instructed"] == (
            "" if not trial.instructed else "left" if trial.expected == trial.left else "right"
        )
        for side in ("left", "right"):
            content = (study.settings and visitor.ask("GET", "/" + state[side]))[2]
            file = study.design.stimulus(getattr(trial, side)).file
            assert content == (study.media[state[side].partition("/")[2]]).read_bytes() and file.startswith("videos/")
        choice = rng.choice(["left", "right"])
        clicks.append(getattr(trial, choice))
        measures = {"response_time_s": 1.5 + trial.trial, "start_drift_s": -0.002, "replays_left": trial.trial}
        status, after = visitor.answer(trial.trial, choice, measures=measures)
        assert status == 200 and after == visitor.state()[1]
    assert after == {"done": True, "of": 9}
    done = visitor.ask("GET", "/done")[2].decode()
    assert "C&lt;1&gt;" in done and 'href="https://a.b/c?d=1&amp;e=2"' in done
    table = answers_table(study.store, study.design)
    assert table["chosen"].tolist() == clicks and table["trial"].tolist() == list(range(1, 10))
    assert table["left"].tolist() == [one.left for one in trials]
    assert table["expected"].tolist() == [one.expected for one in trials]
    assert table["response_time_s"].tolist() == [1.5 + n for n in range(1, 10)]
    assert set(table["start_drift_s"]) == {-0.002} and table["replays_left"].tolist() == list(range(1, 10))
    assert table["level_left"].tolist() == [study.design.stimulus(one.left).level for one in trials]
    assert set(table["session"]) == {"done"} and set(table["action"]) == {"p"}


def test_the_way_through_the_pages(serving):
    study, port = serving()
    visitor = Visitor(port)

    def where(path):
        status, headers, _ = visitor.ask("GET", path)
        return headers["Location"] if status == 303 else status

    assert [where(p) for p in ("/", "/trials", "/instructions", "/done", "/withdraw")] == [200, "./", 400, "./", "./"]
    assert visitor.state()[0] == 401 and study.store.sessions() == []
    visitor.begin()
    assert [where(p) for p in ("/", "/trials", "/instructions", "/done", "/withdraw")] == [
        *("instructions", 200, 200, "./", 200)
    ]
    visitor.answer(1, "left")
    assert where("/") == "trials"
    for trial in range(2, 7):
        visitor.answer(trial, "right")
    assert [where(p) for p in ("/", "/trials", "/instructions", "/done")] == ["done", "done", "done", 200]
    assert visitor.answer(7, "left")[0] == 422 and visitor.answer(6, "left")[0] == 409
    status, _, content = visitor.form("/withdraw", sure="yes")
    assert status == 200 and b"have been deleted" in content and visitor.cookie is None
    assert everything(study) == ([], [], []) and where("/") == 200


def test_consent_sent_twice_begins_once(serving):
    study, port = serving()
    visitor = Visitor(port)
    fields = visitor.consent_fields() | {"agree": "yes"}
    for _ in range(2):
        assert visitor.form("/begin", **fields)[0] == 303
    assert len(study.store.sessions()) == 1
    visitor.answer(1, "left")
    resumed = Visitor(port)  # the same cookie after a crash of the browser
    resumed.cookie = visitor.cookie
    assert resumed.state()[1]["trial"] == 2


def test_a_lost_reply(serving):
    study, port = serving()
    visitor = Visitor(port).begin()
    first = visitor.answer(1, "left", NONCE)
    assert first[0] == 200 and visitor.answer(1, "left", NONCE) == first
    assert visitor.answer(1, "right", NONCE) == first  # the answer stands
    status, state = visitor.answer(1, "right")  # another window
    assert status == 409 and state == first[1]
    assert visitor.answer(3, "left")[0] == 409
    assert [one["chosen"] for one in study.store.answers()] == [study.design.sessions[0][0].left]


def test_ties(serving):
    study, port = serving("tie_allowed = true\n", catch_n=1)
    visitor = Visitor(port).begin()
    for trial in study.design.sessions[0]:
        assert visitor.state()[1]["tie"] is (trial.kind == "test")
        status, _ = visitor.answer(trial.trial, "tie")
        assert status == (200 if trial.kind == "test" else 422)
        if trial.kind != "test":
            visitor.answer(trial.trial, "left")
    assert sum(one["chosen"] == "" for one in study.store.answers()) == 6


def test_ids_of_recruiting_services(serving):
    study, port = serving('id_parameters = ["PROLIFIC_PID", "STUDY_ID"]\n')
    link = "/?PROLIFIC_PID=5f0a&STUDY_ID=77&SESSION_ID=88"
    for bad in ("/", "/?STUDY_ID=77", "/?PROLIFIC_PID=", "/?PROLIFIC_PID=%27%20OR%201", "/?PROLIFIC_PID=" + "a" * 101):
        status, _, content = Visitor(port).ask("GET", bad)
        assert status == 400 and b"carries your number" in content
    visitor = Visitor(port).begin(link)
    assert visitor.ask("GET", link)[1]["Location"] == "instructions"
    assert [(one["name"], one["value"]) for one in study.store.outside_ids()] == [
        ("PROLIFIC_PID", "5f0a"),
        ("STUDY_ID", "77"),
    ]
    again = Visitor(port)
    fields = again.consent_fields(link) | {"agree": "yes"}
    status, _, content = again.form("/begin", **fields)
    assert status == 409 and b"link has been used" in content and again.cookie is None
    visitor.begin("/?PROLIFIC_PID=other&STUDY_ID=77")  # the next person at this browser
    assert len(study.store.sessions()) == 2
    del fields["PROLIFIC_PID"]
    assert again.form("/begin", **fields)[0] == 400 and len(study.store.sessions()) == 2


def test_ids_are_ignored_unless_named(serving):
    study, port = serving()
    Visitor(port).begin("/?PROLIFIC_PID=5f0a")
    assert study.store.outside_ids() == [] and study.store.sessions()[0]["slot"] == 0


def test_full(serving):
    study, port = serving(participants_n=1)
    Visitor(port).begin()
    late = Visitor(port)
    status, _, content = late.form("/begin", **(late.consent_fields() | {"agree": "yes"}))
    assert status == 410 and b"takes no more participants" in content and len(study.store.sessions()) == 1


def test_a_session_that_rested_too_long(serving):
    study, port = serving(participants_n=1)
    visitor = Visitor(port).begin()
    study.store.clock = lambda: time.time() + 25 * 3600
    Visitor(port).begin()
    assert visitor.state()[0] == visitor.answer(1, "left")[0] == 410
    status, _, content = visitor.ask("GET", "/")
    assert status == 410 and b"expired" in content


def test_shared_computer(serving):
    study, port = serving("shared_computer = true\n")
    visitor = Visitor(port).begin()
    for trial in range(1, 7):
        visitor.answer(trial, "left")
    assert visitor.ask("GET", "/done")[0] == 200 and visitor.ask("GET", "/")[0] == 200
    visitor.begin()
    assert [one["state"] for one in study.store.sessions()] == ["done", "active"]


# -- what a page gives away and lets in -------------------------------------------------------------------------------


def test_blind_and_private(serving):
    study, port = serving(catch_n=1)
    visitor = Visitor(port).begin()
    said = b"".join(visitor.ask("GET", path)[2] for path in ("/trials", "/state", "/static/study.js", "/instructions"))
    for code in NAMES:
        assert code.encode() not in said
    assert b"catch" not in visitor.ask("GET", "/state")[2]
    kept = b"".join(
        file.read_bytes() for file in study.media[next(iter(study.media))].parents[1].glob("answers.sqlite*")
    )
    assert b"127.0.0.1" not in kept and visitor.cookie.partition(".")[0].encode() not in kept
    other = Visitor(port).begin()
    assert other.cookie != visitor.cookie


def test_headers(serving):
    _, port = serving()
    visitor = Visitor(port).begin()
    for path in ("/", "/instructions", "/trials", "/state", "/withdraw", "/static/study.js", "/nowhere"):
        status, headers, content = visitor.ask("GET", path)
        assert "default-src 'none'" in headers["Content-Security-Policy"], path
        assert headers["X-Content-Type-Options"] == "nosniff" and headers["Referrer-Policy"] == "no-referrer"
        assert headers["Cache-Control"] == ("no-cache" if "static" in path else "no-store")
        if status == 200 and b"<html" in content:
            text = content.decode()
            assert not re.findall(r"\son\w+=|style=|https?:", text)  # nothing inline, nothing from elsewhere
            scripts = re.findall(r"<script([^>]*)>", text)
            assert all('type="application/json"' in one or 'src="static/study.js"' in one for one in scripts)
            assert 'name="viewport" content="width=device-width' in text
    cookie = Visitor(port)
    _, headers, _ = cookie.form("/begin", **(cookie.consent_fields() | {"agree": "yes"}))
    assert all(word in headers["Set-Cookie"] for word in ("HttpOnly", "SameSite=lax"))


def test_parts_of_videos(serving):
    study, port = serving()
    visitor = Visitor(port)
    name, path = next(iter(study.media.items()))
    whole = path.read_bytes()
    status, headers, content = visitor.ask("GET", f"/media/{name}")
    assert status == 200 and content == whole and headers["Content-Type"] == "video/mp4"
    assert headers["Accept-Ranges"] == "bytes"
    for asked, first, last in (("0-1", 0, 1), ("100-199", 100, 199), ("990-", 990, 999), ("-10", 990, 999)):
        status, headers, content = visitor.ask("GET", f"/media/{name}", headers={"Range": f"bytes={asked}"})
        assert status == 206 and content == whole[first : last + 1]
        assert headers["Content-Range"] == f"bytes {first}-{last}/1000"
    assert visitor.ask("GET", f"/media/{name}", headers={"Range": "bytes=2000-"})[0] == 416
    status, headers, content = visitor.ask("HEAD", f"/media/{name}")
    assert status == 200 and headers["Content-Length"] == "1000" and content == b""


@pytest.mark.parametrize(
    "path",
    [
        "/media/../study.toml",
        "/media/..%2fstudy.toml",
        "/media/%2e%2e/study.toml",
        "/media/..%5cstudy.toml",
        "/media//etc/passwd",
        "/media/%2fetc%2fpasswd",
        "/media/videos/p_0.mp4",
        "/media/p_0.mp4",
        "/media/",
        "/media/%00",
        "/static/../server.py",
        "/static/%2e%2e%2fserver.py",
        "/static/page.html",
        "/design.json",
        "/answers.sqlite",
        "/../../etc/passwd",
        "/.git/config",
    ],
)
def test_only_the_videos_of_the_design_are_served(serving, path):
    _, port = serving()
    status, _, content = Visitor(port).ask("GET", path)
    assert status == 404 and b"root:" not in content and b"import" not in content


GOOD = {"trial": 1, "nonce": NONCE, "choice": "left", "measures": {}}
BAD_ANSWERS = {
    "nothing": b"",
    "not json": b"{",
    "not utf-8": b'{"trial": "\xff"}',
    "a list": b"[]",
    "deep": b"[" * 10000,
    "a long number": b'{"trial": ' + b"9" * 9000 + b"}",
    **{
        name: json.dumps(GOOD | change).encode()
        for name, change in {
            "trial 0": {"trial": 0},
            "trial -1": {"trial": -1},
            "trial beyond": {"trial": 7},
            "trial as text": {"trial": "1"},
            "trial as fraction": {"trial": 1.0},
            "trial true": {"trial": True},
            "sql trial": {"trial": "1; DROP TABLE answer"},
            "sql choice": {"choice": "left'; DROP TABLE answer; --"},
            "a code as choice": {"choice": "p_0"},
            "no choice": {"choice": None},
            "choices": {"choice": ["left"]},
            "tie not allowed": {"choice": "tie"},
            "sql nonce": {"nonce": "'; DROP TABLE answer; --"},
            "short nonce": {"nonce": "abc"},
            "long nonce": {"nonce": "a" * 65},
            "no nonce": {"nonce": None},
            "extra": {"participant": "someone"},
            "measures as list": {"measures": []},
            "unknown measure": {"measures": {"chosen": 1}},
            "sql measure": {"measures": {"response_time_s); DROP TABLE answer; --": 1}},
            "measure as text": {"measures": {"response_time_s": "1"}},
            "negative time": {"measures": {"response_time_s": -1}},
            "huge time": {"measures": {"response_time_s": 1e300}},
            "fraction of a replay": {"measures": {"replays_left": 0.5}},
            "true as number": {"measures": {"response_time_s": True}},
        }.items()
    },
    **{
        word: json.dumps(GOOD).replace("{}", f'{{"start_drift_s": {word}}}').encode()
        for word in ("NaN", "Infinity", "-Infinity", "1e999")
    },
}


def test_malformed_answers_change_nothing(serving):
    study, port = serving()
    visitor = Visitor(port).begin()
    before = everything(study)
    for name, body in BAD_ANSWERS.items():
        status, said = visitor.post(body)
        assert status == 422 and "error" in said, name
    good = json.dumps(GOOD)
    assert visitor.post(good, "text/plain")[0] == visitor.post(good, "application/x-www-form-urlencoded")[0] == 415
    assert visitor.ask("GET", "/answer")[0] == visitor.ask("PUT", "/answer", good)[0] == 405
    assert visitor.ask("GET", "/begin")[0] == 405
    assert everything(study) == before and visitor.state()[1]["trial"] == 1
    assert visitor.post(good)[0] == 200  # and the right one is taken


def test_forged_participants_change_nothing(serving):
    study, port = serving()
    visitor = Visitor(port).begin()
    visitor.answer(1, "left")
    before = everything(study)
    key, _, signature = visitor.cookie.partition(".")
    forged = Visitor(port)
    for cookie in (
        study.store.sessions()[0]["participant"],
        secrets.token_urlsafe(24),
        key,
        f"{key}.",
        f"{key}.{'0' * 32}",
        f"{key}x.{signature}",
        f"{key}.{signature}x",
        "' OR 1=1 --",
        ".",
        "a" * 4000,
        "\xe9.\xe9",
    ):
        forged.cookie = cookie
        assert forged.answer(2, "left")[0] == 401 and forged.state()[0] == 401, cookie
        forged.cookie = cookie
        assert forged.form("/withdraw", sure="yes")[0] == 400
        forged.cookie = cookie
        assert forged.ask("GET", "/done")[0] == forged.ask("GET", "/trials")[0] == 303
    for fields in ({}, {"agree": "yes"}, {"key": "a.b", "agree": "yes"}, {"key": f"{key}.{'0' * 32}", "agree": "yes"}):
        assert forged.form("/begin", **fields)[0] == 400
    fields = Visitor(port).consent_fields()
    assert forged.form("/begin", **fields)[0] == 400  # not agreed
    assert visitor.form("/withdraw", sure="no")[0] == 400
    assert visitor.ask("POST", "/withdraw", "sure=yes", {"Content-Type": "text/plain"})[0] == 415
    assert visitor.ask("POST", "/begin", b"\xff\xfe", {"Content-Type": "application/x-www-form-urlencoded"})[0] == 400
    assert forged.form("/begin", **{f"a{i}": "b" for i in range(30)})[0] == 400
    assert everything(study) == before


def test_large_bodies_are_refused(serving):
    study, port = serving()
    visitor = Visitor(port).begin()
    before = everything(study)
    large = json.dumps(GOOD).encode().ljust(BODY_LIMIT_BYTES + 1)
    for path, kind in (("/answer", "application/json"), ("/begin", "application/x-www-form-urlencoded")):
        kinds = {"Content-Type": kind}
        assert visitor.ask("POST", path, large, kinds)[0] == 413
        visitor.hang_up()
        pieces = iter([b" " * 1000] * 100)  # without a length, in pieces
        assert visitor.ask("POST", path, pieces, kinds)[0] == 413
        visitor.hang_up()
        with socket.create_connection(("127.0.0.1", port), timeout=20) as line:  # a length and nothing more
            cookie = f"Cookie: study={visitor.cookie}"
            line.sendall(
                f"POST {path} HTTP/1.1\r\nHost: a\r\n{cookie}\r\nContent-Type: {kind}\r\n"
                "Content-Length: 99999999999\r\n\r\n".encode()
            )
            assert b" 413 " in line.recv(100)
    assert visitor.post(json.dumps(GOOD).encode().ljust(BODY_LIMIT_BYTES))[0] == 200
    assert everything(study)[0] == [before[0][0] | {"answered_n": 1}]


def test_no_http_at_all(serving):
    _, port = serving()
    for raw in (b"\x16\x03\x01\x02\x00", b"GET\r\n\r\n", b"POST /answer HTTP/1.1\r\nContent-Length: -5\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", port), timeout=20) as line:
            line.sendall(raw)
            assert b" 400 " in line.recv(100)
    with socket.create_connection(("127.0.0.1", port), timeout=20) as line:  # leaves in the middle of a body
        line.sendall(b"POST /answer HTTP/1.1\r\nHost: a\r\nContent-Length: 50\r\n\r\n{")
    assert Visitor(port).begin().state()[1]["trial"] == 1


def test_a_fault_of_the_database_is_not_an_answer(serving, capsys):
    study, port = serving()
    visitor = Visitor(port).begin()
    study.store._engine._connection.execute("PRAGMA query_only = ON")
    assert visitor.answer(1, "left", NONCE)[0] == 503
    study.store._engine._connection.execute("PRAGMA query_only = OFF")
    assert visitor.state()[1]["trial"] == 1 and visitor.answer(1, "left", NONCE)[0] == 200
    assert "the database says: attempt to write a readonly database" in capsys.readouterr().err


# -- what open_study wants --------------------------------------------------------------------------------------------


def test_bad_studies(tmp_path):
    videos = write_bytes_as_videos(tmp_path / "clips", NAMES)
    folder = tmp_path / "study"
    write_study(folder, videos, participants_n=2)
    open_study(folder).store.close()
    video = folder / "videos" / "p_4.mp4"
    content = video.read_bytes()
    video.write_bytes(content + b"x")
    with pytest.raises(InputError, match=r"expected .*p_4\.mp4 as it was when the design was made"):
        open_study(folder)
    video.unlink()
    with pytest.raises(InputError, match=r"expected the video .*p_4\.mp4 of the design, but: No such file"):
        open_study(folder)
    video.write_bytes(content)
    (folder / "study.toml").write_text('database = "postgresql://nobody@127.0.0.1:1/none"')
    with pytest.raises(InputError, match=r"expected the package psycopg|expected PostgreSQL at the address"):
        open_study(folder)


def test_without_the_extra(tmp_path):
    """One sentence says which command installs it."""
    write_study(tmp_path / "study", write_bytes_as_videos(tmp_path / "clips", NAMES), participants_n=2)
    program = f"""
        import sys
        sys.modules["starlette"] = None
        from study.cli import main
        sys.exit(main(["serve", {str(tmp_path / "study")!r}]))
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "run: pip install 'lipmetrics[web]'" in done.stderr


# -- killed -----------------------------------------------------------------------------------------------------------


def answer_through_kills(tmp_path, kills_n, people_n):
    """People answer while the server is killed; returns what each was told is stored, and the export."""
    videos = write_bytes_as_videos(
        tmp_path / "clips", [f"{a}_{level}" for a in "abcdefghij" for level in (0, 4, 7, 10)]
    )
    folder = tmp_path / "study"
    design = write_study(folder, videos, participants_n=people_n)
    server = ServerProcess(folder)
    rng = np.random.default_rng(11)
    told, faults, over = [[] for _ in range(people_n)], [], threading.Event()
    answered = threading.Semaphore(0)

    def patiently(work):
        while True:
            try:
                return work()
            except (OSError, http.client.HTTPException):
                time.sleep(0.02)

    def take_part(number):
        try:
            visitor, choose = Visitor(server.port), np.random.default_rng(number)
            fields = patiently(visitor.consent_fields) | {"agree": "yes"}
            assert patiently(lambda: visitor.form("/begin", **fields))[0] == 303
            state = patiently(visitor.state)[1]
            while not state["done"]:
                trial, nonce = state["trial"], secrets.token_hex(16)
                choice = str(choose.choice(["left", "right"]))
                status, state = patiently(lambda t=trial, c=choice, n=nonce: visitor.answer(t, c, n))
                assert status == 200, (status, state)
                told[number].append((trial, choice))
                answered.release()
                if choose.random() < 0.1:  # a reload
                    assert patiently(visitor.state) == (200, state)
                over.wait(0.15 * choose.random())
        except Exception as error:
            faults.append(error)

    people = [threading.Thread(target=take_part, args=(number,)) for number in range(people_n)]
    for one in people:
        one.start()
    for _ in range(kills_n):
        answered.acquire(timeout=20)  # somebody is in the middle of the session
        time.sleep(float(rng.uniform(0, 0.25)))
        server.kill()
        if not any(one.is_alive() for one in people):
            server.start()
            break
        server.start()
    alive_n = sum(one.is_alive() for one in people)
    over.set()
    for one in people:
        one.join(timeout=120)
    server.stop()
    assert not faults, faults
    assert alive_n, "they were done before the last kill: let them answer more slowly"
    study = open_study(folder)
    table = answers_table(study.store, study.design)
    sessions = study.store.sessions()
    study.store.close()
    return design, told, table, sessions


def check_nothing_lost_or_doubled(design, told, table, sessions):
    trials_n = len(design.sessions[0])
    assert len(sessions) == len(told) and {one["state"] for one in sessions} == {"done"}
    assert len(table) == trials_n * len(told)
    stored = []
    for _, answers in table.groupby("participant"):
        assert answers["trial"].tolist() == list(range(1, trials_n + 1))
        sides = np.where(answers["chosen"] == answers["left"], "left", "right")
        stored.append(list(zip(answers["trial"].tolist(), sides.tolist(), strict=True)))
    assert sorted(stored) == sorted(told)


def test_killed_a_few_times(tmp_path):
    check_nothing_lost_or_doubled(*answer_through_kills(tmp_path, kills_n=2, people_n=3))


@pytest.mark.slow
def test_killed_many_times(tmp_path):
    """12 times; `LIPMETRICS_KILLS=50` takes three minutes."""
    kills = int(os.environ.get("LIPMETRICS_KILLS", "12"))
    check_nothing_lost_or_doubled(*answer_through_kills(tmp_path, kills_n=kills, people_n=40))


@pytest.mark.slow
def test_many_people_at_once(tmp_path):
    """The crowd of benchmarks/study_load.py, a smaller one; it compares the database with what was sent."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
    import study_load

    assert study_load.load(tmp_path / "study", people_n=40, trials_n=10)["answers"] == 400


def test_the_design_in_the_folder_is_the_one_served(serving):
    study, _ = serving()
    folder = study.media[next(iter(study.media))].parents[1]
    assert load_design(folder) == study.design
    assert len(pd.read_csv(folder / "design.csv")) == 24
