"""`lipmetrics corpus segment`: a long take to clips by its cut list, or to a proposal of the cuts."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from av.video.reformatter import VideoReformatter
from tqdm import tqdm

from corpus_tools.activity import find_events, read_activity
from corpus_tools.contact import VIEW_PX, Tile, write_contact
from corpus_tools.cuts import read_cuts
from corpus_tools.cutting import COPIED, ENCODED, Made, cut, plan, view
from corpus_tools.long_take import LongTake, pictures, read_take
from corpus_tools.propose import Proposal, activity_png, propose, write_proposal
from corpus_tools.protocol import Protocol
from lipmetrics.atomic import whole_file
from lipmetrics.errors import InputError
from lipmetrics.frames import Frame
from lipmetrics.pixels import turn_of

COLUMNS = (
    *("clip", "file", "how", "why", "sound", "first_frame", "last_frame", "frames_n", "start_s", "stop_s"),
    *("first_s", "last_s", "error"),
)


def segment(
    take: str | Path,
    folder: str | Path,
    *,
    cuts: str | Path | None,
    protocol: Protocol,
    speaker: str | None = None,
    mark_s: float | None = None,
    overwrite: bool = False,
    crf: int | None = None,
    progress: bool = False,
) -> dict:
    """Cut a take, or propose the cuts where there is no cut list.

    Parameters
    ----------
    take : the long video
    folder : for the clips, `<take>.segment.csv` and `<take>.contact.png`; or for `<take>.proposed.csv`, its figure of
        movement and loudness and its contact sheet
    cuts, speaker, mark_s : see `corpus_tools.cuts.read_cuts` and `corpus_tools.propose.propose`
    overwrite : replace clips that are there
    crf : see `corpus_tools.cutting.cut`

    Returns
    -------
    The summary of the command.

    Raises
    ------
    InputError : a take or cut list that cannot be read, cuts beyond the end, or clips that are there already
    """
    folder = Path(folder)
    if cuts is None:
        return _propose(read_take(take), folder, protocol, speaker, mark_s, progress, overwrite)
    pieces = read_cuts(cuts, protocol, speaker=speaker, mark_s=mark_s or 0.0)
    known = read_take(take)
    planned = plan(known, pieces, folder)
    _refuse_to_overwrite([one.path for one in planned], overwrite)
    _refuse_own_take(known, planned)
    made = []
    with tqdm(total=len(planned), unit="clip", disable=not progress) as bar:
        for one in cut(known, planned, crf=crf, view_px=VIEW_PX):
            made.append(one)
            bar.update()
    made.sort(key=lambda one: one.first_frame)
    stem = known.path.stem
    table, sheet = folder / f"{stem}.segment.csv", folder / f"{stem}.contact.png"
    write_table(table, made)
    tiles = [Tile(one.views, one.name, _line(one), bool(one.error)) for one in made]
    write_contact(sheet, tiles, f"{known.path.name}: {len(made)} clips, first, middle and last picture of each")
    done = [one for one in made if not one.error]
    how = Counter(one.how for one in done)
    text = [f"{len(done)} clips of {known.path.name}: {how[COPIED]} copied, {how[ENCODED]} re-encoded"]
    reasons = Counter(one.why for one in done if one.how == ENCODED)
    text += [f"  {n} re-encoded: {why}" for why, n in sorted(reasons.items())]
    text += [str(table), str(sheet)]
    return {
        "text": text,
        "done_n": len(done),
        "copied_n": how[COPIED],
        "encoded_n": how[ENCODED],
        "files": [str(path) for path in (*(one.path for one in done), table, sheet)],
        "failed": [{"source": one.name, "error": one.error} for one in made if one.error],
    }


def write_table(path: str | Path, made: Sequence[Made]) -> None:
    """Write what became of each clip, columns `COLUMNS`; times are s from the take's first picture.

    Raises InputError if it cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for one in made:
        file = "" if one.error else one.path.name
        counts = (one.first_frame, one.last_frame, one.frames_n)
        times = (f"{value:.6f}" for value in (one.start_s, one.stop_s, one.first_s, one.last_s))
        writer.writerow([one.name, file, one.how, one.why, one.sound, *counts, *times, one.error])
    with whole_file(path) as part:
        part.write_text(text.getvalue(), encoding="utf-8", newline="")


def _propose(
    take: LongTake,
    folder: Path,
    protocol: Protocol,
    speaker: str | None,
    mark_s: float | None,
    progress: bool,
    overwrite: bool,
) -> dict:
    stem = take.path.stem
    table = folder / f"{stem}.proposed.csv"
    figure, sheet = folder / f"{stem}.proposed.png", folder / f"{stem}.proposed.contact.png"
    _refuse_to_overwrite([table], overwrite)  # it may have been corrected by hand
    if take.end_s < protocol.clip_s:
        raise InputError(f"expected a take longer than a clip of {protocol.clip_s:g} s, got {take.end_s:.2f} s")
    with tqdm(total=round(take.end_s), unit="s", disable=not progress) as bar:
        activity = read_activity(take.path, lambda time_s: bar.update(int(time_s) - bar.n))
    events = find_events(activity)
    proposal = propose(events, take.end_s, protocol, speaker=speaker, mark_s=mark_s)
    if not proposal.cuts:
        raise InputError(
            f"expected movement or sound in {take.path} to propose cuts of {protocol.clip_s:g} s by, found none; write "
            "a cut list by hand (start_s and the fields of the names)"
        )
    write_proposal(table, proposal, protocol, speaker=speaker)
    with whole_file(figure) as part:
        part.write_bytes(activity_png(activity, proposal))
    tiles = [
        Tile(views, _label(one.fields), f"{one.start_s:.3f} to {one.stop_s:.3f} s  {one.note}", bool(one.note))
        for one, views in zip(proposal.cuts, _views(take, proposal), strict=True)
    ]
    write_contact(sheet, tiles, f"{take.path.name}: {len(tiles)} cuts proposed, to be checked")
    where = "the mouth's part of the face" if activity.is_mouth else "the whole picture, as no face was seen"
    named = (
        f"named by the protocol, its mark at {proposal.mark_s:.2f} s"
        if proposal.mark_s is not None
        else "not named: the take does not keep to the protocol's times; fill in the names"
    )
    unsure, others_n = sum(bool(one.note) for one in proposal.cuts), len(proposal.others)
    return {
        "text": [
            f"{len(proposal.cuts)} cuts proposed, {unsure} with a note; {others_n} other movements left out",
            f"  {named}",
            f"  looked at {where}" + (" and listened" if len(activity.loudness_db) else ""),
            *map(str, (table, figure, sheet)),
            f"check them, then: lipmetrics corpus segment {take.path} --cuts {table} -o {folder}",
        ],
        "proposed_n": len(proposal.cuts),
        "noted_n": unsure,
        "left_out_n": others_n,
        "mark_s": proposal.mark_s,
        "files": [str(path) for path in (table, figure, sheet)],
    }


def _views(take: LongTake, proposal: Proposal) -> list[list]:
    """Small pictures of each proposed cut: its first, middle and last one."""
    wanted = []
    for number, one in enumerate(proposal.cuts):
        first, end = take.part(one.start_s, one.stop_s)
        if first < end:
            wanted += [(place, number) for place in sorted({first, (first + end) // 2, end - 1})]
    views: list[list] = [[] for _ in proposal.cuts]
    reformatter, turn = VideoReformatter(), None
    for k, index, picture in pictures(take, [(place, place + 1) for place, _ in wanted]):
        turn = turn_of(picture) if turn is None else turn
        frame = Frame(index, float(take.time_s[index]), picture, turn, reformatter)
        views[wanted[k][1]].append(view(frame, VIEW_PX))
    return views


def _refuse_to_overwrite(paths: Sequence[Path], overwrite: bool) -> None:
    there = [path for path in paths if path.exists()]
    if there and not overwrite:
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        raise InputError(
            f"expected to write new files, but {there[0]}{more} exist; add --overwrite or choose another -o"
            if more
            else f"expected to write a new file, but {there[0]} exists; add --overwrite or choose another -o"
        )


def _refuse_own_take(take: LongTake, planned: Sequence[Made]) -> None:
    for one in planned:
        if one.path.exists() and one.path.samefile(take.path):
            raise InputError(f"expected clips beside the take, got {one.path}, which is the take; choose another -o")


def _line(one: Made) -> str:
    if one.error:
        return one.error
    return f"{one.first_s:.3f} to {one.last_s:.3f} s, {one.frames_n} frames, {one.how}"


def _label(fields: dict) -> str:
    return " ".join(str(value) for value in fields.values() if value != "") or "?"
