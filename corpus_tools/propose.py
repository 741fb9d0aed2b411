"""Cuts proposed from what happens in a take, named by the protocol where the take keeps to its times."""

from __future__ import annotations

import csv
import io
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from corpus_tools.activity import Activity, Event
from corpus_tools.naming import Value
from corpus_tools.protocol import Protocol
from lipmetrics.atomic import whole_file

TOLERANCE_S = 1.0  # between the protocol's times and movements, after the best shift
REACTION_S = (-0.5, 3.0)  # after a prompt, where the mark's time is known
LEAST_SHARE, LEAST_N = 0.6, 3  # of the planned prompts that a movement answers, for the plan to be believed
NOT_SEEN = "nothing seen; by the plan"
ROW_S = 60.0  # of the figure


@dataclass(frozen=True)
class Proposed:
    """A cut as proposed, s from the take's first picture.

    fields : of the name; empty where the take does not keep to the protocol's times
    event : what is seen there; None where the plan alone says so
    note : what to look at
    """

    start_s: float
    stop_s: float
    fields: dict[str, Value]
    event: Event | None = None
    note: str = ""


@dataclass(frozen=True)
class Proposal:
    """cuts : in order of time; others : events that are not cut, such as licks; mark_s : of the plan, None without"""

    cuts: tuple[Proposed, ...]
    others: tuple[Event, ...]
    mark_s: float | None


def propose(
    events: Sequence[Event],
    end_s: float,
    protocol: Protocol,
    *,
    speaker: str | None = None,
    mark_s: float | None = None,
) -> Proposal:
    """Clips around events: each begins before_s before its event and is clip_s long, and none overlap.

    Parameters
    ----------
    end_s : of the take
    speaker : for the names
    mark_s : where the protocol's clock starts in the take; None looks for the shift at which most prompts are followed
        by a movement, and believes it if more than 60 % are

    Returns
    -------
    With a plan: a cut for each prompt, and events that answer none (such as licks) among `others`. Without: a cut for
    each event, without utterance and repeat.
    """
    cues = [prompt for prompt in protocol.prompts() if prompt.kind == "cue"]
    moved = [event for event in events if event.movement > 0]
    starts = np.array([event.start_s for event in moved])
    at = np.array([cue.at_s for cue in cues])
    if mark_s is None:
        shift, window = _best_shift(starts, at), (-TOLERANCE_S, TOLERANCE_S)
    else:
        shift, window = mark_s, REACTION_S
    answers = {} if shift is None else _answers(starts, at + shift, window)
    if mark_s is None and len(answers) < max(LEAST_N, LEAST_SHARE * len(cues)):
        return _unplanned(events, end_s, protocol, speaker)
    cuts, floor_s = [], 0.0
    for k, cue in enumerate(cues):
        event = moved[answers[k]] if k in answers else None
        onset_s = cue.at_s + shift if event is None else event.start_s
        cut = _around(onset_s, floor_s, end_s, protocol)
        if cut is None:
            continue
        fields = {"speaker": speaker or "", "utterance": cue.utterance, "repeat": cue.repeat}
        cuts.append(Proposed(*cut, fields, event, NOT_SEEN if event is None else _note(event, cut)))
        floor_s = cut[1]
    used = {id(one.event) for one in cuts}
    return Proposal(tuple(cuts), tuple(event for event in events if id(event) not in used), shift)


def write_proposal(path: str | Path, proposal: Proposal, protocol: Protocol, *, speaker: str | None = None) -> None:
    """Write the cut list to be checked: start_s, stop_s, the fields of the names, and what was seen.

    Raises InputError if it cannot be written.
    """
    fields = protocol.template.fields
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["start_s", "stop_s", *fields, "movement", "louder_db", "note"])
    for cut in proposal.cuts:
        named = {"speaker": speaker or "", **cut.fields}
        seen = ["", ""] if cut.event is None else [f"{cut.event.movement:.1f}", f"{cut.event.louder_db:.0f}"]
        cells = [named.get(field, "") for field in fields]
        writer.writerow([f"{cut.start_s:.3f}", f"{cut.stop_s:.3f}", *cells, *seen, cut.note])
    with whole_file(path) as part:
        part.write_text(text.getvalue(), encoding="utf-8", newline="")


def activity_png(activity: Activity, proposal: Proposal) -> bytes:
    """Movement and loudness over the take, a minute a row, with what is proposed (blue) and what is left out (grey)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    end_s = float(activity.time_s[-1])
    rows = max(1, int(np.ceil(end_s / ROW_S)))
    span_s = min(ROW_S, end_s)
    figure = Figure(figsize=(14, 1.15 * rows + 0.6), dpi=90, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, 1, squeeze=False)[:, 0]
    top = max(float(np.quantile(activity.movement, 0.995)), 1.0) * 1.25
    for k, panel in enumerate(panels):
        low_s, high_s = k * span_s, (k + 1) * span_s
        for cut in proposal.cuts:
            if cut.stop_s > low_s and cut.start_s < high_s:
                panel.axvspan(cut.start_s, cut.stop_s, color="#cfe3f5" if cut.event else "#f3e2b8", linewidth=0)
                label = " ".join(str(v) for f, v in cut.fields.items() if f != "speaker" and v != "")
                panel.text(cut.start_s, top, label, fontsize=6.5, va="top", color="#333333", clip_on=True)
        for event in proposal.others:
            if event.stop_s > low_s and event.start_s < high_s:
                panel.axvspan(event.start_s, event.stop_s, color="#e4e4e4", linewidth=0)
        panel.plot(activity.time_s, activity.movement, color="#0072b2", linewidth=0.8)
        panel.set(xlim=(low_s, high_s), ylim=(0, top))
        panel.tick_params(labelsize=7)
        if len(activity.loudness_db):
            heard = panel.twinx()
            heard.plot(activity.sound_time_s, activity.loudness_db, color="#d55e00", linewidth=0.5, alpha=0.7)
            heard.set_ylim(-90, 0)
            heard.tick_params(labelsize=6, colors="#d55e00")
    panels[-1].set_xlabel("time from the first picture (s)")
    figure.suptitle(
        "movement (blue line, grey levels) and loudness (orange, dB below full scale); "
        "blue: proposed, yellow: by the plan alone, grey: left out",
        fontsize=8,
    )
    target = io.BytesIO()
    figure.savefig(target, format="png", metadata={"Software": None})
    return target.getvalue()


def _unplanned(events: Sequence[Event], end_s: float, protocol: Protocol, speaker: str | None) -> Proposal:
    cuts, others, floor_s = [], [], 0.0
    for event in events:
        cut = _around(event.start_s, floor_s, end_s, protocol)
        if cut is None:
            others.append(event)
            continue
        cuts.append(Proposed(*cut, {"speaker": speaker or ""}, event, _note(event, cut)))
        floor_s = cut[1]
    return Proposal(tuple(cuts), tuple(others), None)


def _around(onset_s: float, floor_s: float, end_s: float, protocol: Protocol) -> tuple[float, float] | None:
    """Start and stop of a clip; moved behind the clip before it; None where its onset lies in that one."""
    if onset_s < floor_s or end_s < protocol.clip_s:
        return None
    start_s = min(max(onset_s - protocol.before_s, floor_s), end_s - protocol.clip_s)
    start_s = np.floor(max(start_s, 0.0) * 1000) / 1000  # as written
    return None if start_s < floor_s - 1e-6 else (float(start_s), round(float(start_s) + protocol.clip_s, 3))


def _note(event: Event, cut: tuple[float, float]) -> str:
    notes = []
    if event.movement == 0:
        notes.append("sound alone")
    if event.stop_s > cut[1]:
        notes.append(f"goes on until {event.stop_s:.2f} s")
    if event.start_s - cut[0] < 0.1:
        notes.append("begins at once")
    return "; ".join(notes)


def _best_shift(starts: np.ndarray, at: np.ndarray) -> float | None:
    """The shift of the planned times at which most of them are near the start of an event; the earliest of the best."""
    best, most = None, 0
    for shift in sorted({round(float(start - cue), 2) for start in starts for cue in at}):
        n = len(_answers(starts, at + shift, (-TOLERANCE_S, TOLERANCE_S)))
        if n > most:
            best, most = shift, n
    if best is None:
        return None
    for _ in range(3):  # into the middle of those it explains
        found = _answers(starts, at + best, (-TOLERANCE_S, TOLERANCE_S))
        best += float(np.median([starts[event] - at[cue] - best for cue, event in found.items()]))
    return best


def _answers(starts: np.ndarray, at: np.ndarray, window: tuple[float, float]) -> dict[int, int]:
    """Which event answers which prompt: the first one in the window after it that answers none yet."""
    found, used = {}, -1
    for k, time_s in enumerate(at):
        event = max(bisect_left(starts, time_s + window[0]), used + 1)
        if event < len(starts) and starts[event] <= time_s + window[1]:
            found[k] = used = event
    return found
