"""Fair designs: which pairs of videos each participant sees, in which order, and which one on which side.

Sides and orders are balanced by construction, not by chance; the seed only chooses among balanced designs:

- sides: for every pair, and for every participant (also within each action), the two ways round differ by at most one,
  and are equal where the number is even. All trials are the edges of a graph between participants and pairs; an Euler
  circuit leaves every node as often as it enters it, and its direction says which video stands on the left.
- orders, where everybody answers all pairs: rows of Latin squares, so that a pair's counts over the positions differ
  by at most one. With an even number of pairs they are Williams' squares (E. J. Williams, Experimental designs balanced
  for the estimation of residual effects of treatments, Australian Journal of Scientific Research A 2, 1949), where
  every pair follows every other once in a full square; the second of each two participants has the reversed order of
  the first, so that the mean position is the same for all pairs with every even number of participants.
- orders, where everybody answers a part of the pairs (`bib`): a proper edge colouring (Koenig) of the same graph, whose
  colours are the positions; again the counts of a pair over the positions differ by at most one.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from study.atomic import whole_file
from study.errors import InputError
from study.wording import choices, nearest, short

VIDEO_ENDINGS = (".mp4", ".m4v", ".webm", ".mov")
SCHEMES = ("all", "chain", "bib")
KINDS = ("practice", "test", "catch")
COLUMNS = ["stimulus", "action", "level", "audio", "speed", "file", "sha256"]
FORMAT = 1
_CODE = re.compile(r"(?P<action>.*[^\W\d_])_?(?P<level>\d+(?:\.\d+)?)(?P<audio>a|_audio)?", re.IGNORECASE)


@dataclasses.dataclass(frozen=True)
class Stimulus:
    """One video.

    Parameters
    ----------
    code : its name, unique in the design, such as puppy_7 or m10a
    action, level : only videos of one action are paired, and those of different levels
    audio : whether it is shown with its sound; videos with and without are not paired
    speed : a class of actions, such as slow or fast; '' if it does not matter
    file, sha256 : path from the study's folder, and digest of the content in hexadecimal; '' for a bare code
    """

    code: str
    action: str = ""
    level: str = ""
    audio: bool = False
    speed: str = ""
    file: str = ""
    sha256: str = ""


@dataclasses.dataclass(frozen=True)
class Trial:
    """One pair as one participant sees it.

    Parameters
    ----------
    trial : position in the session, from 1, practice and catch trials counted
    kind : practice, test or catch
    question : number of the pair in `Design.pairs`, from 1; 0 for a catch trial with a pair of its own
    left, right : codes
    expected : code that an attentive participant chooses in a catch trial, '' elsewhere
    instructed : the page says which side to choose
    """

    trial: int
    kind: str
    question: int
    left: str
    right: str
    expected: str = ""
    instructed: bool = False


@dataclasses.dataclass(frozen=True)
class Design:
    """A whole study: the videos, and the trials of every participant.

    Parameters
    ----------
    stimuli : in order of action, audio and level
    pairs : of codes, lower level first; question n is pairs[n - 1]
    sessions : for each participant the trials in order
    scheme, seed : as they were asked for
    """

    stimuli: tuple[Stimulus, ...]
    pairs: tuple[tuple[str, str], ...]
    sessions: tuple[tuple[Trial, ...], ...]
    scheme: str
    seed: int

    @property
    def identity(self) -> str:
        """Digest of all that the design says, 16 hexadecimal digits."""
        return hashlib.sha256(_json_of(self).encode()).hexdigest()[:16]

    def stimulus(self, code: str) -> Stimulus:
        for one in self.stimuli:
            if one.code == code:
                return one
        raise InputError(f"expected a video of the design, got {nearest(code, [s.code for s in self.stimuli])}")

    def table(self) -> pd.DataFrame:
        """One row per trial: participant (from 1), the fields of `Trial`, and what the codes stand for."""
        by_code = {one.code: one for one in self.stimuli}
        rows = [
            {"participant": number, **trial_row(trial, by_code)}
            for number, session in enumerate(self.sessions, start=1)
            for trial in session
        ]
        return pd.DataFrame(rows)

    def save(self, folder: str | Path) -> list[Path]:
        """Write design.json (all of it) and design.csv (`table`) into `folder`; returns the paths."""
        paths = [Path(folder) / "design.json", Path(folder) / "design.csv"]
        with whole_file(paths[0]) as part:
            part.write_text(_json_of(self), encoding="utf-8")
        with whole_file(paths[1]) as part:
            self.table().to_csv(part, index=False, lineterminator="\n")
        return paths


def trial_row(trial: Trial, by_code: dict[str, Stimulus]) -> dict:
    """The fields of a trial, and action, levels, audio and speed of its videos."""
    left, right = by_code[trial.left], by_code[trial.right]
    row = dataclasses.asdict(trial)
    row.update(action=left.action, level_left=left.level, level_right=right.level)
    return row | {"audio": int(left.audio), "speed": left.speed, "instructed": int(trial.instructed)}


# -- the videos -------------------------------------------------------------------------------------------------------


def stimuli_from_codes(codes: Iterable[str]) -> list[Stimulus]:
    """Stimuli of codes that say action, level and audio: puppy_7, os10, m10a (with audio).

    If no code ends in a level, all belong to one action and the code is the level.

    Raises
    ------
    InputError : fewer than two, one twice, or some with a level and some without
    """
    codes = list(codes)
    twice = [code for code, count in Counter(codes).items() if count > 1]
    if twice:
        raise InputError(f"expected every video once, got '{short(twice[0])}' more often; leave the others out")
    if len(codes) < 2:
        raise InputError(f"expected at least 2 videos to pair, got {len(codes)}; name a folder of videos, or codes")
    found = [_CODE.fullmatch(code) for code in codes]
    if not any(found):
        return _ordered(Stimulus(code, "", code) for code in codes)
    if not all(found):
        odd = codes[found.index(None)]
        raise InputError(
            f"expected names of action and level such as puppy_7.mp4 or os10a.mp4, got '{short(odd)}'; "
            "rename it or describe all videos with --stimuli CSV"
        )
    return _ordered(
        Stimulus(code, match["action"].rstrip("_"), match["level"], bool(match["audio"]))
        for code, match in zip(codes, found, strict=True)
    )


def stimuli_from_folder(folder: str | Path) -> list[Stimulus]:
    """Stimuli of the videos in a folder, by their names without the ending; `file` is the path of each.

    Raises
    ------
    InputError : no folder, no videos, or names that `stimuli_from_codes` cannot read
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"expected a folder of videos, got {folder}, which is none; name another")
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() in VIDEO_ENDINGS and not p.name.startswith("."))
    if not files:
        raise InputError(f"expected videos ({choices(VIDEO_ENDINGS)}) in the folder {folder}, got none")
    return with_files(stimuli_from_codes(file.stem for file in files), {file.stem: file for file in files})


def stimuli_from_csv(path: str | Path) -> list[Stimulus]:
    """Stimuli of a table with a column stimulus (code) and any of action, level, audio (0 or 1), speed and file.

    `file` is a path from the table's folder.

    Raises
    ------
    InputError : no such table, no column stimulus, an unknown column, a code twice, a file that does not exist
    """
    path = Path(path)
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        raise InputError(f"expected a table of videos in {path}, but: {short(str(error))}") from None
    known = COLUMNS[:-1]
    for column in table.columns:
        if column not in known:
            raise InputError(f"{path}: expected the columns {choices(known)}, got {nearest(column, known)}")
    if "stimulus" not in table:
        raise InputError(f"{path}: expected a column stimulus with the codes, got {', '.join(table.columns)}")
    stimuli, files = [], {}
    for row in table.to_dict("records"):
        audio = row.get("audio", "0").strip().lower()
        if audio not in ("", "0", "1", "true", "false"):
            raise InputError(f"{path}: expected 0 or 1 under audio, got '{short(audio)}'")
        code = row["stimulus"]
        level = row.get("level", code)
        one = Stimulus(code, row.get("action", ""), level, audio in ("1", "true"), row.get("speed", ""))
        stimuli.append(one)
        if row.get("file"):
            files[code] = path.parent / row["file"]
    stimuli_from_codes(one.code for one in stimuli)  # for its checks of number and names only
    return with_files(_ordered(stimuli), files)


def with_files(stimuli: Sequence[Stimulus], files: dict[str, Path]) -> list[Stimulus]:
    """The stimuli with path and digest of their files."""
    found = []
    for one in stimuli:
        if one.code in files:
            try:
                digest = hashlib.sha256(files[one.code].read_bytes()).hexdigest()
            except OSError as error:
                reason = error.strerror or error
                raise InputError(f"expected the video {files[one.code]} of {one.code}, but: {reason}") from None
            one = dataclasses.replace(one, file=str(files[one.code]), sha256=digest)
        found.append(one)
    return found


def _ordered(stimuli: Iterable[Stimulus]) -> list[Stimulus]:
    def place(one: Stimulus):
        try:
            level = float(one.level)
        except ValueError:
            level = math.inf
        return one.action, one.audio, level, one.level, one.code

    return sorted(stimuli, key=place)


# -- the design -------------------------------------------------------------------------------------------------------


def make_design(
    stimuli: Sequence[Stimulus],
    *,
    participants_n: int,
    scheme: str = "all",
    per_participant_n: int | None = None,
    catch_n: int = 0,
    practice_n: int = 0,
    catch_pairs: Sequence[tuple[str, str]] = (),
    seed: int = 0,
) -> Design:
    """A balanced design (see the module).

    Parameters
    ----------
    stimuli : the videos; those of one action and one audio are paired
    participants_n : sessions to lay out; an even number balances exactly
    scheme : all, every pair; chain, neighbouring levels only; bib, all pairs, of which each participant answers
        `per_participant_n`, every pair being answered equally often (or once more) and pairs meeting others evenly
    catch_n : checks of attention per participant, spread over the session, sides balanced. The page says which side
        to choose, unless `catch_pairs` names pairs (better, worse) whose answer is plain
    practice_n : trials before the first, of pairs of the design
    seed : chooses among the balanced designs

    Raises
    ------
    InputError : an unknown scheme or code, numbers that do not fit, or no pair to make
    """
    stimuli = tuple(_ordered(stimuli))
    if scheme not in SCHEMES:
        raise InputError(f"expected pairs to be {choices(SCHEMES)}, got {nearest(scheme, SCHEMES)}")
    for name, value, least in (
        ("participants", participants_n, 1),
        ("catch trials", catch_n, 0),
        ("practice trials", practice_n, 0),
    ):
        if value < least:
            raise InputError(f"expected at least {least} {name}, got {value}")
    codes = [one.code for one in stimuli]
    catch_pairs = [tuple(pair) for pair in catch_pairs]
    for code in itertools.chain.from_iterable(catch_pairs):
        if code not in codes:
            raise InputError(f"expected videos of the study in a catch pair, got {nearest(code, codes)}")
    only_catch = set(itertools.chain.from_iterable(catch_pairs))
    pairs = _pairs(stimuli, scheme, {frozenset(pair) for pair in catch_pairs})
    if not pairs:
        raise InputError("expected two videos of one action at different levels, got none; see --stimuli CSV")
    if scheme == "bib":
        if per_participant_n is None:
            raise InputError("expected --per-participant N with --pairs bib: how many pairs each participant answers")
        if not 1 <= per_participant_n <= len(pairs):
            raise InputError(f"expected 1 to {len(pairs)} pairs per participant, got {per_participant_n}")
    elif per_participant_n is not None:
        raise InputError(f"expected --per-participant only with --pairs bib, got it with {scheme}")
    rng = np.random.default_rng(seed)
    pairs_n = len(pairs)
    if scheme == "bib" and per_participant_n < pairs_n:
        orders = _orders_of_parts(_parts(pairs_n, per_participant_n, participants_n, rng), pairs_n, rng)
    else:
        orders = _full_orders(pairs_n, participants_n, rng)
    by_code = {one.code: one for one in stimuli}
    groups = [(by_code[a].action, by_code[a].audio) for a, _ in pairs]
    first_left = _sides(orders, groups, rng)
    catch_sides = _catch_sides(participants_n, catch_n, rng)
    sessions = []
    for person, order in enumerate(orders):
        test = [_trial("test", pair, pairs, first_left[person, pair]) for pair in order]
        practice = _practice(practice_n, pairs, rng)
        catch = [_catch(side, catch_pairs, pairs, rng) for side in catch_sides[person]]
        trials = practice + _spread(test, catch, rng)
        sessions.append(tuple(dataclasses.replace(one, trial=i) for i, one in enumerate(trials, start=1)))
    used = {code for pair in pairs for code in pair} | only_catch
    return Design(tuple(one for one in stimuli if one.code in used), tuple(pairs), tuple(sessions), scheme, seed)


def _pairs(stimuli: Sequence[Stimulus], scheme: str, left_out: set[frozenset]) -> list[tuple[str, str]]:
    pairs = []
    for _, group in itertools.groupby(stimuli, key=lambda one: (one.action, one.audio)):
        videos = list(group)
        inside = itertools.pairwise(videos) if scheme == "chain" else itertools.combinations(videos, 2)
        pairs += [
            (a.code, b.code) for a, b in inside if a.level != b.level and frozenset((a.code, b.code)) not in left_out
        ]
    return pairs


def _full_orders(pairs_n: int, participants_n: int, rng: np.random.Generator) -> list[list[int]]:
    """Orders of all pairs: rows of one Latin square after the other, each with its own names."""
    zigzag = np.array([(i + 1) // 2 if i % 2 else -(i // 2) for i in range(pairs_n)]) % pairs_n
    orders: list[list[int]] = []
    while len(orders) < participants_n:
        names = rng.permutation(pairs_n)
        if pairs_n % 2 == 0:  # row r + n/2 is row r reversed
            half = pairs_n // 2
            firsts = (rng.permutation(half) + half * rng.integers(0, 2, half)) % pairs_n
            rows = np.column_stack([firsts, (firsts + half) % pairs_n]).ravel()
        else:
            rows = rng.permutation(pairs_n)
        orders += [names[(zigzag + row) % pairs_n].tolist() for row in rows]
    return orders[:participants_n]


def _parts(pairs_n: int, part_n: int, participants_n: int, rng: np.random.Generator) -> list[list[int]]:
    """For each participant the pairs, all equally often (or once more), preferring pairs that met least often."""
    count = np.zeros(pairs_n, int)
    together = np.zeros((pairs_n, pairs_n), int)
    parts = []
    for _ in range(participants_n):
        free, chosen = np.ones(pairs_n, bool), []
        tie = rng.permutation(pairs_n)
        for _ in range(part_n):
            met = together[chosen].sum(axis=0) if chosen else np.zeros(pairs_n, int)
            order = np.lexsort((tie, met, count, ~free))
            chosen.append(int(order[0]))
            free[chosen[-1]] = False
        count[chosen] += 1
        together[np.ix_(chosen, chosen)] += 1
        parts.append(chosen)
    return parts


def _orders_of_parts(parts: list[list[int]], pairs_n: int, rng: np.random.Generator) -> list[list[int]]:
    """Positions by edge colouring: a pair is split into nodes of at most T trials, each at T different positions."""
    part_n = len(parts[0])
    at_person = np.full((len(parts), part_n), -1)  # pair node at each position
    seen: Counter[int] = Counter()
    node_of: dict[tuple[int, int], int] = {}
    nodes_n = 0
    edges = []
    for person in rng.permutation(len(parts)):
        for pair in rng.permutation(parts[person]):
            key = (int(pair), seen[pair] // part_n)
            seen[pair] += 1
            if key not in node_of:
                node_of[key] = nodes_n
                nodes_n += 1
            edges.append((int(person), node_of[key]))
    pair_of = {node: key[0] for key, node in node_of.items()}
    at_node = np.full((nodes_n, part_n), -1)  # person at each position
    for person, node in edges:
        a = int(np.flatnonzero(at_person[person] < 0)[0])
        b = int(np.flatnonzero(at_node[node] < 0)[0])
        if a != b:  # free `a` at the node: swap a and b along the path that leaves it with a
            path, where, position, is_node = [], node, a, True
            while True:
                other = int((at_node if is_node else at_person)[where, position])
                if other < 0:
                    break
                path.append((other, where, position) if is_node else (where, other, position))
                where, position, is_node = other, (b if position == a else a), not is_node
            for p, n, position in path:
                at_person[p, position] = at_node[n, position] = -1
            for p, n, position in path:
                swapped = b if position == a else a
                at_person[p, swapped], at_node[n, swapped] = n, p
        at_person[person, a], at_node[node, a] = node, person
    positions = rng.permutation(part_n)
    return [[pair_of[int(node)] for node in row[positions]] for row in at_person]


def _sides(orders: list[list[int]], groups: list, rng: np.random.Generator) -> np.ndarray:
    """(participants, pairs) bool: the pair's first video is on the left; by the direction of Euler circuits.

    Nodes are pairs, and participants within a group of pairs. Nodes of odd degree are joined by edges of no trial:
    those of one participant to one node of theirs, so that the participant's total is balanced too, the rest to a last
    one.
    """
    edges: list[tuple] = []
    for person, order in enumerate(orders):
        edges += [(("person", person, groups[pair]), ("pair", pair)) for pair in order]
    edges = [edges[i] for i in rng.permutation(len(edges))]
    real_n = len(edges)
    degree = Counter(node for edge in edges for node in edge)
    for node in [node for node, count in degree.items() if count % 2]:
        other = ("whole", node[1]) if node[0] == "person" else ("rest",)
        edges.append((node, other))
        degree[other] += 1
    for node in [node for node, count in degree.items() if count % 2 and node[0] == "whole"]:
        edges.append((node, ("rest",)))
    touching: dict[tuple, list[int]] = {}
    for i, edge in enumerate(edges):
        for node in edge:
            touching.setdefault(node, []).append(i)
    forward = np.zeros(len(edges), bool)
    used = np.zeros(len(edges), bool)
    for start in touching:
        node = start
        while True:
            while touching[node] and used[touching[node][-1]]:
                touching[node].pop()
            if not touching[node]:
                if node != start:
                    raise AssertionError("an Euler circuit ended away from its start")
                break
            i = touching[node].pop()
            used[i] = True
            forward[i] = edges[i][0] == node
            node = edges[i][1] if forward[i] else edges[i][0]
    first_left = np.zeros((len(orders), len(groups)), bool)
    turned = rng.integers(0, 2) == 1
    for i in range(real_n):
        (_, person, _), (_, pair) = edges[i]
        first_left[person, pair] = forward[i] ^ turned
    return first_left


def _trial(kind: str, pair: int, pairs: Sequence[tuple[str, str]], first_left: bool) -> Trial:
    first, second = pairs[pair]
    left, right = (first, second) if first_left else (second, first)
    return Trial(0, kind, pair + 1, left, right)


def _practice(practice_n: int, pairs: Sequence[tuple[str, str]], rng: np.random.Generator) -> list[Trial]:
    """Random pairs, all different while there are enough, sides in turn."""
    chosen = [pair for _ in range(-(-practice_n // len(pairs))) for pair in rng.permutation(len(pairs))][:practice_n]
    first = rng.integers(0, 2)
    return [_trial("practice", int(pair), pairs, (i + first) % 2 == 0) for i, pair in enumerate(chosen)]


def _catch_sides(participants_n: int, catch_n: int, rng: np.random.Generator) -> list[list[bool]]:
    """Whether the left is right: half of each participant's, and the odd ones in turn over participants."""
    sides = []
    turn = int(rng.integers(0, 2))
    for person in range(participants_n):
        left_n = (catch_n + (person + turn) % 2) // 2
        sides.append([bool(i < left_n) for i in rng.permutation(catch_n)])
    return sides


def _catch(left_right: bool, catch_pairs, pairs, rng: np.random.Generator) -> Trial:
    if catch_pairs:
        better, worse = catch_pairs[rng.integers(len(catch_pairs))]
        left, right = (better, worse) if left_right else (worse, better)
        return Trial(0, "catch", 0, left, right, better)
    pair = int(rng.integers(len(pairs)))
    trial = _trial("catch", pair, pairs, bool(rng.integers(0, 2)))
    return dataclasses.replace(trial, expected=trial.left if left_right else trial.right, instructed=True)


def _spread(test: list[Trial], catch: list[Trial], rng: np.random.Generator) -> list[Trial]:
    """The catch trials in the session, one at a random place in each of as many equal stretches, never first."""
    trials = list(test)
    bounds = np.linspace(1, len(test), len(catch) + 1)
    places = [
        int(rng.integers(math.ceil(a), max(math.ceil(b), math.ceil(a) + 1))) for a, b in itertools.pairwise(bounds)
    ]
    for place, one in sorted(zip(places, catch, strict=True), key=lambda item: -item[0]):
        trials.insert(place, one)
    return trials


# -- files ------------------------------------------------------------------------------------------------------------


def _json_of(design: Design) -> str:
    def lines(items: Iterable) -> str:
        return ",\n".join("    " + json.dumps(item, ensure_ascii=False) for item in items)

    fields = [field.name for field in dataclasses.fields(Trial)]
    sessions = ([[getattr(trial, name) for name in fields] for trial in session] for session in design.sessions)
    return (
        "{\n"
        f'  "format": {FORMAT},\n  "scheme": "{design.scheme}",\n  "seed": {design.seed},\n'
        f'  "stimuli": [\n{lines(dataclasses.asdict(one) for one in design.stimuli)}\n  ],\n'
        f'  "pairs": [\n{lines(design.pairs)}\n  ],\n'
        f'  "trial_fields": {json.dumps(fields)},\n'
        f'  "sessions": [\n{lines(sessions)}\n  ]\n}}\n'
    )


def load_design(path: str | Path) -> Design:
    """The design in a folder (design.json) or a file.

    Raises
    ------
    InputError : there is none, or it is not a design
    """
    path = Path(path)
    file = path / "design.json" if path.is_dir() else path
    try:
        raw = json.loads(file.read_text(encoding="utf-8"))
        if raw["format"] != FORMAT:
            raise InputError(f"{file}: expected a design of format {FORMAT}, got {raw['format']}; make it anew")
        stimuli = tuple(Stimulus(**one) for one in raw["stimuli"])
        sessions = tuple(
            tuple(Trial(**dict(zip(raw["trial_fields"], values, strict=True))) for values in session)
            for session in raw["sessions"]
        )
        design = Design(stimuli, tuple(tuple(pair) for pair in raw["pairs"]), sessions, raw["scheme"], raw["seed"])
        known = {one.code for one in stimuli}
        for session in sessions:
            if [one.trial for one in session] != list(range(1, len(session) + 1)):
                raise ValueError("trials out of order")
            if not {code for one in session for code in (one.left, one.right)} <= known:
                raise ValueError("a trial of an unknown video")
        return design
    except OSError as error:
        reason = error.strerror or error
        raise InputError(
            f"expected a design at {file}, but: {reason}; make one with 'lipmetrics study design'"
        ) from None
    except (ValueError, KeyError, TypeError, RecursionError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        reason = f"{type(error).__name__} {short(str(error))}"
        raise InputError(f"{file}: expected a design as 'lipmetrics study design' writes it, but: {reason}") from None
