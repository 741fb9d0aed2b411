"""The database: nothing lost, nothing twice, nothing left after a withdrawal."""

import os
import sqlite3
import threading

import pytest

from study.errors import InputError
from study.store import MEASURES, FullError, Store, TakenError

POSTGRES = os.environ.get("STUDY_TEST_POSTGRES")  # address of an empty database
ADDRESSES = ["file", "memory", pytest.param("postgres", marks=pytest.mark.skipif(not POSTGRES, reason="no PostgreSQL"))]


@pytest.fixture(params=ADDRESSES)
def address(request, tmp_path):
    if request.param != "postgres":
        return {"file": tmp_path / "answers.sqlite", "memory": ":memory:"}[request.param]
    import psycopg

    with psycopg.connect(POSTGRES, autocommit=True) as connection:
        connection.execute("DROP TABLE IF EXISTS answer, outside_id, session, study_info")
    return POSTGRES


def take(store, key, trial, nonce="n" * 16, chosen="a", last=False, **measures):
    return store.answer(key, trial, nonce, left="a", right="b", chosen=chosen, last=last, measures=measures)


def test_a_session(address):
    store = Store(address, "design", 3)
    first = store.begin("key")
    assert (first.slot, first.state, first.answered_n, first.person) == (0, "active", 0, None)
    assert store.begin("key") == first == store.session("key") and store.session("other") is None
    assert store.begin("other").slot == 1 and store.begin("other").participant != first.participant
    assert take(store, "key", 1, response_time_s=1.25, replays_left=2) == ("stored", store.session("key"))
    assert store.session("key").answered_n == 1
    assert take(store, "key", 2, chosen="", last=True)[1].state == "done" == store.session("key").state
    one, two = store.answers()
    assert one == {
        "participant": first.participant,
        "trial": 1,
        "left": "a",
        "right": "b",
        "chosen": "a",
    } | dict.fromkeys(MEASURES) | {"response_time_s": 1.25, "replays_left": 2}
    assert two["chosen"] == "" and two["trial"] == 2
    assert [(s["slot"], s["state"], s["answered_n"]) for s in store.sessions()] == [(0, "done", 2), (1, "active", 0)]


def test_an_answer_is_taken_once_and_in_its_turn(address):
    store = Store(address, "design", 3)
    store.begin("key")
    assert take(store, "key", 2)[0] == "refused" and store.answers() == []
    assert take(store, "key", 1, "x" * 16)[0] == "stored"
    assert take(store, "key", 1, "x" * 16)[0] == "repeated"  # the reply was lost, the browser asks again
    assert take(store, "key", 1, "y" * 16, chosen="b")[0] == "refused"  # another window
    assert take(store, "key", 3, "y" * 16)[0] == "refused"
    assert take(store, "stranger", 1)[0] == "refused" and take(store, "stranger", 1)[1] is None
    assert take(store, "key", 2, "z" * 16, last=True)[0] == "stored"
    assert take(store, "key", 2, "z" * 16, last=True)[0] == "repeated"
    assert take(store, "key", 3, "z" * 16)[0] == "refused"
    assert [(a["trial"], a["chosen"]) for a in store.answers()] == [(1, "a"), (2, "a")]


def test_answers_outlive_the_store(tmp_path):
    store = Store(tmp_path / "a.sqlite", "design", 3)
    session, secret = store.begin("key"), store.secret
    take(store, "key", 1)
    again = Store(tmp_path / "a.sqlite", "design", 3)  # the first one is not closed: as after a kill
    assert again.session("key").participant == session.participant and again.session("key").answered_n == 1
    assert again.secret == secret
    mode = sqlite3.connect(tmp_path / "a.sqlite").execute("PRAGMA journal_mode").fetchone()
    assert mode == ("wal",) and store._engine._connection.execute("PRAGMA synchronous").fetchone() == (2,)
    with pytest.raises(InputError, match="answers to design other in the database, got those of design"):
        Store(tmp_path / "a.sqlite", "other", 3)


def test_withdrawal_leaves_nothing(tmp_path):
    path = tmp_path / "a.sqlite"
    store = Store(path, "design", 2)
    session = store.begin("key", {"PID": "prolific-number-7"})
    for trial in range(1, 40):
        take(store, "key", trial, f"nonce-of-the-trial-{trial}")
    before = b"".join(file.read_bytes() for file in tmp_path.iterdir())
    assert session.participant.encode() in before and b"prolific-number-7" in before
    assert b"key" not in before.replace(b"key_digest", b"").replace(b"KEY", b"").replace(b"_key", b"")
    assert store.withdraw("key") is True and store.withdraw("key") is False
    after = b"".join(file.read_bytes() for file in tmp_path.iterdir())
    for trace in (session.participant.encode(), b"prolific-number-7", b"nonce-of-the-trial"):
        assert trace not in after
    assert store.answers() == store.sessions() == store.outside_ids() == [] and store.withdrawn_n() == 1
    assert store.begin("key2", {"PID": "prolific-number-7"}).slot == 0  # the place is free again


def test_withdrawal_in_any_database(address):
    store = Store(address, "design", 2)
    store.begin("key", {"PID": "a"}), store.begin("other", {"PID": "b"})
    take(store, "key", 1), take(store, "other", 1)
    assert store.withdraw("key") and store.withdrawn_n() == 1
    assert len(store.answers()) == len(store.sessions()) == len(store.outside_ids()) == 1
    assert take(store, "key", 2)[1] is None and store.session("key") is None


def test_outside_ids_admit_once(address):
    store = Store(address, "design", 4)
    first = store.begin("key", {"PID": "a", "STUDY": "s"})
    assert first.person == "a" and store.begin("key", {"PID": "a", "STUDY": "s"}) == first
    with pytest.raises(TakenError):
        store.begin("other", {"PID": "a", "STUDY": "s"})
    assert store.begin("other", {"PID": "b", "STUDY": "s"}).slot == 1
    assert [(one["name"], one["value"]) for one in store.outside_ids() if one["participant"] == first.participant] == [
        ("PID", "a"),
        ("STUDY", "s"),
    ]


def test_places(address):
    now = [0.0]
    store = Store(address, "design", 2, abandoned_after_s=100, clock=lambda: now[0])
    store.begin("a"), store.begin("b")
    take(store, "b", 1, last=True)
    with pytest.raises(FullError):
        store.begin("c")
    now[0] = 90
    take(store, "a", 1)
    now[0] = 150
    with pytest.raises(FullError):
        store.begin("c")
    now[0] = 191
    assert store.begin("c").slot == 0
    assert store.session("a").state == "replaced" and take(store, "a", 2)[0] == "refused"
    assert [a["trial"] for a in store.answers()] == [1, 1]
    with pytest.raises(FullError):  # who is done keeps the place, and the new one has just come
        store.begin("d")


def test_many_at_once(address):
    if address == ":memory:":
        pytest.skip("one store")
    stores = [Store(address, "design", 8) for _ in range(2)]  # as two processes have
    outcomes, slots = [], []

    def work(number):
        store = stores[number % 2]
        slots.append(store.begin(f"key{number}").slot)
        for trial in range(1, 11):
            for other in stores:
                outcomes.append(take(other, f"key{number}", trial, f"{trial:016d}")[0])

    threads = [threading.Thread(target=work, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(slots) == list(range(8))
    assert outcomes.count("stored") == outcomes.count("repeated") == 80 == len(stores[0].answers())


def test_sql_in_values_stays_text(address):
    store = Store(address, "design", 2)
    evil = "'; DROP TABLE answer; --"
    store.begin(evil, {"PID": evil})
    assert take(store, evil, 1, evil, chosen=evil)[0] == "stored"
    assert store.answers()[0]["chosen"] == evil and store.outside_ids()[0]["value"] == evil


def test_bad_databases(tmp_path):
    (tmp_path / "text").write_text("this is not a database, and long enough to be looked at " * 20)
    with pytest.raises(InputError, match=r"expected a SQLite file .*text, but: file is not a database"):
        Store(tmp_path / "text", "design", 1)
    with pytest.raises(InputError, match="expected a SQLite file"):
        Store(tmp_path, "design", 1)
