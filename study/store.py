"""Where answers are kept: a SQLite file, or PostgreSQL by its address.

Every change is one transaction, on disk before the method returns. Each method may be called again after a lost
reply: a session begins once per key, an answer is taken once per trial. Stored are random numbers, answers and what the
study's settings name; of a session's key only the digest, so that who reads the database cannot act as a participant.
"""

from __future__ import annotations

import dataclasses
import hashlib
import secrets
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from study.errors import InputError
from study.wording import short

ACTIVE, DONE, REPLACED = "active", "done", "replaced"
STORED, REPEATED, REFUSED = "stored", "repeated", "refused"

#: what the page measures of each answer, as SQL types; the data dictionary in `study.export` says what they are
MEASURES = {
    "response_time_s": "DOUBLE PRECISION",
    "choice_time_s": "DOUBLE PRECISION",
    "replays_left": "INTEGER",
    "replays_right": "INTEGER",
    "watched_left_s": "DOUBLE PRECISION",
    "watched_right_s": "DOUBLE PRECISION",
    "start_drift_s": "DOUBLE PRECISION",
    "stalls_n": "INTEGER",
    "loads_n": "INTEGER",
    "shown_width_px": "INTEGER",
}

_SCHEMA = [
    "CREATE TABLE IF NOT EXISTS study_info (name TEXT PRIMARY KEY, value TEXT NOT NULL)",
    "CREATE TABLE IF NOT EXISTS session (participant TEXT PRIMARY KEY, key_digest TEXT NOT NULL UNIQUE, "
    "slot INTEGER NOT NULL, state TEXT NOT NULL, person TEXT UNIQUE, begun_s BIGINT NOT NULL, seen_s BIGINT NOT NULL)",
    "CREATE UNIQUE INDEX IF NOT EXISTS session_slot ON session (slot) WHERE state <> 'replaced'",
    "CREATE TABLE IF NOT EXISTS outside_id (participant TEXT NOT NULL REFERENCES session, name TEXT NOT NULL, "
    "value TEXT NOT NULL, PRIMARY KEY (participant, name))",
    "CREATE TABLE IF NOT EXISTS answer (participant TEXT NOT NULL REFERENCES session, trial INTEGER NOT NULL, "
    "nonce TEXT NOT NULL, left_code TEXT NOT NULL, right_code TEXT NOT NULL, chosen TEXT NOT NULL, "
    + ", ".join(f"{name} {kind}" for name, kind in MEASURES.items())
    + ", PRIMARY KEY (participant, trial))",
]


@dataclasses.dataclass(frozen=True)
class Session:
    """One participant as the database knows them.

    Parameters
    ----------
    participant : random public number, as in the export
    slot : index of their session in the design, from 0
    state : active, done, or replaced (rested too long; another has the slot)
    answered_n : trials answered
    person : the first of the outside identities, None if there are none
    """

    participant: str
    slot: int
    state: str
    answered_n: int
    person: str | None = None


class FaultError(Exception):
    """The database did not do what it was asked; nothing has changed, and asking again is right."""


class FullError(Exception):
    """Every place of the design is taken."""


class TakenError(Exception):
    """A participant with this outside identity has begun already, with another key."""


class Store:
    """The database of one study; may be used by several threads, and by several processes at once.

    Parameters
    ----------
    address : SQLite file, ':memory:', or postgresql://...
    identity : of the design whose answers are kept
    slots_n : places of the design
    abandoned_after_s : unfinished sessions older than this give their place away when none is left; 0 never
    clock : the time, s; for tests

    Raises
    ------
    InputError : the database cannot be opened, or holds the answers of another design
    """

    def __init__(
        self,
        address: str | Path,
        identity: str,
        slots_n: int,
        *,
        abandoned_after_s: float = 0.0,
        clock: Callable[[], float] = time.time,
    ):
        self.slots_n, self.abandoned_after_s, self.clock = slots_n, abandoned_after_s, clock
        self._lock = threading.Lock()
        self._engine = _Postgres(str(address)) if is_postgres(address) else _Sqlite(str(address))
        try:
            with self._transaction() as do:
                for statement in _SCHEMA:
                    do(statement)
                for name, value in (("design", identity), ("secret", secrets.token_hex(32)), ("withdrawn_n", "0")):
                    do("INSERT INTO study_info (name, value) VALUES (?, ?) ON CONFLICT DO NOTHING", name, value)
                info = dict(do("SELECT name, value FROM study_info"))
            self.secret = bytes.fromhex(info["secret"])
        except (FaultError, KeyError, ValueError, TypeError) as error:
            self.close()
            raise InputError(f"expected the database of a study, but it is damaged: {short(str(error))}") from None
        if info["design"] != identity:
            self.close()
            raise InputError(
                f"expected answers to design {identity} in the database, got those of {info['design']}; "
                "name another database in study.toml, or put the old design back"
            )

    def begin(self, key: str, outside_ids: Mapping[str, str] | None = None) -> Session:
        """The session of a key, begun if it is new.

        `outside_ids` are stored with it; the first of them admits a participant once.

        Raises
        ------
        FullError, TakenError
        """
        outside_ids = dict(outside_ids or {})
        person = next(iter(outside_ids.values()), None)
        now = int(self.clock())
        with self._transaction() as do:
            found = self._find(do, key)
            if found:
                return found
            if person is not None and do("SELECT 1 FROM session WHERE person = ?", person):
                raise TakenError
            slot = self._free_slot(do, now)
            participant = secrets.token_hex(8)
            do(
                "INSERT INTO session (participant, key_digest, slot, state, person, begun_s, seen_s) "
                "VALUES (?, ?, ?, ?, ?, ?, ?)",
                *(participant, _digest(key), slot, ACTIVE, person, now, now),
            )
            for name, value in outside_ids.items():
                do("INSERT INTO outside_id (participant, name, value) VALUES (?, ?, ?)", participant, name, value)
        return Session(participant, slot, ACTIVE, 0, person)

    def _free_slot(self, do, now: int) -> int:
        taken = {slot for (slot,) in do("SELECT slot FROM session WHERE state <> ?", REPLACED)}
        for slot in range(self.slots_n):
            if slot not in taken:
                return slot
        if self.abandoned_after_s > 0:
            oldest = do(
                "SELECT participant, slot FROM session WHERE state = ? AND seen_s < ? ORDER BY seen_s, slot LIMIT 1",
                *(ACTIVE, now - self.abandoned_after_s),
            )
            if oldest:
                do("UPDATE session SET state = ? WHERE participant = ?", REPLACED, oldest[0][0])
                return oldest[0][1]
        raise FullError

    def session(self, key: str) -> Session | None:
        """The session of a key, None if there is none."""
        with self._transaction(reading=True) as do:
            return self._find(do, key)

    def _find(self, do, key: str) -> Session | None:
        rows = do(
            "SELECT participant, slot, state, (SELECT COUNT(*) FROM answer WHERE answer.participant = "
            "session.participant), person FROM session WHERE key_digest = ?",
            _digest(key),
        )
        return Session(*rows[0]) if rows else None

    def answer(
        self,
        key: str,
        trial: int,
        nonce: str,
        *,
        left: str,
        right: str,
        chosen: str,
        last: bool,
        measures: Mapping[str, float | None],
    ) -> tuple[str, Session | None]:
        """Take the answer to the next trial.

        Parameters
        ----------
        trial : its position, from 1
        nonce : random word of this answer: the same answer again, after a lost reply, has the same
        left, right, chosen : codes; chosen is '' for no difference
        last : this is the session's last trial
        measures : values of `MEASURES`

        Returns
        -------
        stored; repeated, if this very answer is there already; or refused, if it is not this trial's turn - and the
        session after it, None if there is none with this key
        """
        with self._transaction() as do:
            found = self._find(do, key)
            if found is None or found.state == REPLACED:
                return REFUSED, found
            if trial != found.answered_n + 1 or found.state != ACTIVE:
                before = do("SELECT nonce FROM answer WHERE participant = ? AND trial = ?", found.participant, trial)
                return (REPEATED if before and before[0][0] == nonce else REFUSED), found
            names = ["participant", "trial", "nonce", "left_code", "right_code", "chosen", *MEASURES]
            do(
                f"INSERT INTO answer ({', '.join(names)}) VALUES ({', '.join('?' * len(names))})",
                *(found.participant, trial, nonce, left, right, chosen),
                *(measures.get(name) for name in MEASURES),
            )
            state = DONE if last else ACTIVE
            do(
                "UPDATE session SET seen_s = ?, state = ? WHERE participant = ?",
                *(int(self.clock()), state, found.participant),
            )
        return STORED, dataclasses.replace(found, state=state, answered_n=trial)

    def withdraw(self, key: str) -> bool:
        """Delete a session, its answers and its outside identities; its place is free again. False if there is none."""
        with self._transaction() as do:
            found = self._find(do, key)
            if found is None:
                return False
            for table in ("answer", "outside_id", "session"):
                do(f"DELETE FROM {table} WHERE participant = ?", found.participant)
            do("UPDATE study_info SET value = CAST(CAST(value AS INTEGER) + 1 AS TEXT) WHERE name = 'withdrawn_n'")
        with self._lock:
            self._engine.forget()
        return True

    def sessions(self) -> list[dict]:
        """All sessions in order of their place: participant, slot, state, begun_s (s since 1970), answered_n."""
        with self._transaction(reading=True) as do:
            rows = do(
                "SELECT participant, slot, state, begun_s, (SELECT COUNT(*) FROM answer WHERE answer.participant = "
                "session.participant) FROM session ORDER BY slot, begun_s, participant"
            )
        return [dict(zip(("participant", "slot", "state", "begun_s", "answered_n"), row, strict=True)) for row in rows]

    def answers(self) -> list[dict]:
        """All answers: participant, trial, left, right, chosen and `MEASURES`."""
        names = ["participant", "trial", "left_code", "right_code", "chosen", *MEASURES]
        with self._transaction(reading=True) as do:
            rows = do(f"SELECT {', '.join(names)} FROM answer ORDER BY participant, trial")
        names[2:4] = ["left", "right"]
        return [dict(zip(names, row, strict=True)) for row in rows]

    def outside_ids(self) -> list[dict]:
        """What recruiting services named: participant, name, value."""
        with self._transaction(reading=True) as do:
            rows = do("SELECT participant, name, value FROM outside_id ORDER BY participant, name")
        return [dict(zip(("participant", "name", "value"), row, strict=True)) for row in rows]

    def withdrawn_n(self) -> int:
        """How many have withdrawn."""
        with self._transaction(reading=True) as do:
            return int(do("SELECT value FROM study_info WHERE name = 'withdrawn_n'")[0][0])

    def close(self) -> None:
        """Close the database."""
        with self._lock:
            self._engine.close()

    @contextmanager
    def _transaction(self, reading: bool = False) -> Iterator[_Do]:
        try:
            with self._lock, self._engine.transaction(reading) as do:
                yield do
        except self._engine.faults as error:
            raise FaultError(short(str(error))) from error


def is_postgres(address: str | Path) -> bool:
    """Whether the address is PostgreSQL's, not a file's."""
    return str(address).startswith(("postgresql://", "postgres://"))


def _digest(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()


class _Do:
    """Runs one statement with ? for its values; returns the rows."""

    def __init__(self, execute: Callable):
        self._execute = execute

    def __call__(self, statement: str, *values) -> list[tuple]:
        cursor = self._execute(statement, values)
        return cursor.fetchall() if cursor.description else []


class _Sqlite:
    """Write-ahead log, synced at every commit: an answer survives a kill of the server, and a power cut."""

    faults = sqlite3.Error

    def __init__(self, path: str):
        try:
            if path != ":memory:":
                Path(path).parent.mkdir(parents=True, exist_ok=True)
            self._connection = sqlite3.connect(path, timeout=30, isolation_level=None, check_same_thread=False)
            for pragma in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON", "secure_delete = ON"):
                self._connection.execute(f"PRAGMA {pragma}")
        except (sqlite3.Error, OSError) as error:
            raise InputError(f"expected a SQLite file to open or make at {path}, but: {short(str(error))}") from None

    @contextmanager
    def transaction(self, reading: bool) -> Iterator[_Do]:
        self._connection.execute("BEGIN" if reading else "BEGIN IMMEDIATE")
        try:
            yield _Do(self._connection.execute)
            self._connection.execute("COMMIT")
        except BaseException:
            self._connection.rollback()
            raise

    def forget(self) -> None:
        """Deleted rows leave the log too."""
        self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")

    def close(self) -> None:
        self._connection.close()


class _Postgres:
    def __init__(self, address: str):
        try:
            import psycopg
        except ImportError:
            raise InputError(
                "expected the package psycopg for a postgresql:// database, found none; "
                "run: pip install 'psycopg[binary]'"
            ) from None
        self._psycopg, self._address, self.faults = psycopg, address, psycopg.Error
        try:
            self._connection = psycopg.connect(address)
        except psycopg.Error as error:
            raise InputError(f"expected PostgreSQL at the address in study.toml, but: {short(str(error))}") from None

    @contextmanager
    def transaction(self, reading: bool) -> Iterator[_Do]:
        if self._connection.closed:
            self._connection = self._psycopg.connect(self._address)

        def execute(statement: str, values: tuple):
            return self._connection.execute(statement.replace("?", "%s"), values)

        with self._connection.transaction():
            if not reading:  # one writer at a time, as in SQLite: the choice of a slot reads them all
                execute("SELECT pg_advisory_xact_lock(5812)", ())
            yield _Do(execute)

    def forget(self) -> None:
        pass

    def close(self) -> None:
        self._connection.close()
