"""Answers from the database to a long table, one row per answer, with a dictionary of its columns."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from study.atomic import whole_file
from study.design import Design, trial_row
from study.store import DONE, Store

#: column -> unit, meaning; in the order of the table
DICTIONARY = {
    "participant": ("", "random number of the participant; has no meaning outside this study"),
    "slot": ("", "which session of the design (design.csv: participant) this participant saw, from 1"),
    "session": ("", "done; active: not finished; replaced: rested too long, another participant has the place"),
    "trial": ("", "position in the session, from 1, practice and catch trials counted"),
    "kind": ("", "practice, test, or catch (a check of attention)"),
    "question": ("", "number of the pair in the design, from 1; 0 for a catch trial with a pair of its own"),
    "left": ("", "code of the video shown on the left"),
    "right": ("", "code of the video shown on the right"),
    "chosen": ("", "code of the video chosen; empty: no difference, where the study allows that answer"),
    "expected": ("", "catch trials: the code that an attentive participant chooses; empty elsewhere"),
    "instructed": ("", "1: a catch trial in which the page said which side to choose"),
    "action": ("", "action that both videos show"),
    "level_left": ("", "level of the video on the left"),
    "level_right": ("", "level of the video on the right"),
    "audio": ("", "1: the pair is of videos with sound (study.toml says which of the two is heard)"),
    "speed": ("", "class of the action, if the design names one"),
    "response_time_s": ("s", "from the common start of the videos to the answer"),
    "choice_time_s": ("s", "from when an answer became possible (both videos seen to the end) to the answer"),
    "replays_left": ("", "how often the left video was started again, alone or with the other"),
    "replays_right": ("", "how often the right video was started again, alone or with the other"),
    "watched_left_s": ("s", "how long the left video played, all showings together"),
    "watched_right_s": ("s", "how long the right video played, all showings together"),
    "start_drift_s": (
        "s",
        "by how much the left video started later than the right one (negative: earlier) at the first showing, from "
        "the times at which frames were shown; empty: the browser did not say",
    ),
    "stalls_n": ("", "how often a video ran dry, so that both had to wait or start anew"),
    "loads_n": (
        "",
        "how often the page was loaded in this trial; above 1: after a reload, which starts the times anew",
    ),
    "shown_width_px": ("px", "width of each video on the page, in CSS pixels"),
}


def answers_table(store: Store, design: Design, *, complete: bool = False) -> pd.DataFrame:
    """One row per answer, the columns of `DICTIONARY`; sessions in order of their place, trials in order.

    `complete` leaves out sessions that are not finished.
    """
    by_code = {one.code: one for one in design.stimuli}
    sessions = {one["participant"]: one for one in store.sessions()}
    rows = []
    for answer in store.answers():
        session = sessions.get(answer["participant"])  # None: begun or withdrawn between the two reads
        if session is None or (complete and session["state"] != DONE):
            continue
        planned = trial_row(design.sessions[session["slot"]][answer["trial"] - 1], by_code)
        rows.append(planned | answer | {"slot": session["slot"] + 1, "session": session["state"]})
    table = pd.DataFrame(rows, columns=list(DICTIONARY))
    return table.sort_values(["slot", "session", "participant", "trial"], kind="stable", ignore_index=True)


def write_answers(path: str | Path, table: pd.DataFrame) -> list[Path]:
    """Write the table as CSV, and <stem>.dictionary.csv beside it; returns the paths."""
    path = Path(path)
    meaning = path.with_name(f"{path.stem}.dictionary.csv")
    with whole_file(path) as part:
        table.to_csv(part, index=False, lineterminator="\n")
    with whole_file(meaning) as part:
        rows = [(name, unit, what) for name, (unit, what) in DICTIONARY.items()]
        pd.DataFrame(rows, columns=["column", "unit", "meaning"]).to_csv(part, index=False, lineterminator="\n")
    return [path, meaning]


def write_outside_ids(path: str | Path, store: Store) -> Path:
    """Write what recruiting services named each participant: participant, name, value."""
    with whole_file(path) as part:
        table = pd.DataFrame(store.outside_ids(), columns=["participant", "name", "value"])
        table.to_csv(part, index=False, lineterminator="\n")
    return Path(path)
