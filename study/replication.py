"""Every number that the thesis prints about its study, beside the same number from its own answers.

Thesis: M. I. Leach, Physically-based Animation of 'Sticky Lips', Sheffield 2020, sections 5.1 and 5.4 and chapter 6;
the answers are those of its appendix A (study/data/SOURCE.md).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import pandas as pd

from study.binomial import p_at_least, p_more_than, p_two_sided
from study.responses import Answers, Preference, thesis_answers

STICKY, NONE = (4, 7, 10), (0,)
SPOKEN = ("m", "mummy", "p", "puppy")
COLUMNS = [
    "place",
    "quantity",
    "printed",
    "from_answers",
    "agrees",
    "reason",
    "reconstructed",
    "for_a",
    "for_b",
    "p_at_least",
    "p_more_than",
    "p_two_sided",
]
MISSING = "one answer is missing from the thesis's count (for no stickiness, slow opening, against level 10)"
STRICT = "P(> r) is printed, where eq. 5.2 says P(>= r)"
SLIP = "a slip of two digits: section 5.1.4 prints 0.0000004 for the same test"
CUT = "the digits were cut, not rounded"


@dataclasses.dataclass(frozen=True)
class Printed:
    """A printed ratio or p-value.

    Parameters
    ----------
    place, quantity : where, and what of
    printed : as it stands there
    kind : ratio or p
    conditions, a, b : of which answers, and which levels against which
    missing : the answer that the thesis lost belongs to them
    reason : why it differs from the answers, '' if it does not
    """

    place: str
    quantity: str
    printed: str
    kind: str
    conditions: dict
    a: tuple = STICKY
    b: tuple = NONE
    missing: bool = False
    reason: str = ""


@dataclasses.dataclass(frozen=True)
class Count:
    """A printed number of people, trials or videos.

    Parameters
    ----------
    place, quantity, printed : as above
    of : the same number from the answers
    reason : why it differs
    """

    place: str
    quantity: str
    printed: str
    of: Callable[[Answers], object]
    reason: str = ""


@dataclasses.dataclass(frozen=True)
class Statement:
    """A printed comparison without a number.

    Parameters
    ----------
    place, printed : where, and its words (shortened)
    holds : whether the counts point that way
    counts : words for what the counts are
    remark : what to know about it, '' if the counts say it all
    """

    place: str
    printed: str
    holds: Callable[[Answers], bool]
    counts: Callable[[Answers], str]
    remark: str = ""


def _pairs(answers: Answers) -> int:
    return answers.table["pair"].nunique()


def _times(answers: Answers, level: int) -> int:
    """How often a level was chosen."""
    table = answers.table
    won = table["level_left"].where(table["chosen"] == table["left"], table["level_right"])
    return int((won == level).sum())


def _both(place: str, of: str, ratio: str, p: str, conditions: dict, **settings) -> list[Printed]:
    ratio_reason, p_reason = settings.pop("reasons")
    return [
        Printed(place, f"{of}: ratio", ratio, "ratio", conditions, reason=ratio_reason, **settings),
        Printed(place, f"{of}: p", p, "p", conditions, reason=p_reason, **settings),
    ]


NUMBERS: list[Count | Printed] = [
    Count("5.1.2", "actions", "6", lambda a: len(a.actions)),
    Count("5.1.3", "levels of stickiness", "4", lambda a: len(a.levels)),
    Count(
        "5.1.3", "pairs of levels for each action", "6", lambda a: a.where(action="m", audio=0).table["pair"].nunique()
    ),
    Count("5.1.3", "trials, unspoken actions", "12", lambda a: _pairs(a.where(action=["open_slow", "open_fast"]))),
    Count("5.1.3", "trials, speech without audio", "24", lambda a: _pairs(a.where(action=SPOKEN, audio=0))),
    Count("5.1.3", "trials, speech with audio", "24", lambda a: _pairs(a.where(audio=1))),
    Count("5.1.3", "trials per participant", "60", lambda a: _pairs(a)),
    Count(
        "5.1.3",
        "participants who completed all trials",
        "every user",
        lambda a: f"{int((a.table.groupby('participant').size() == 60).sum())} of {len(a.participants)}",
        "participants 1 and 2 answered 36 each (appendix A.2: a technical issue)",
    ),
    Count("5.1.4", "participants", "20", lambda a: len(a.participants)),
    Printed(
        "5.1.4, figure 5.2",
        "sticky against none: p",
        "0.0000004",
        "p",
        {},
        missing=True,
        reason=f"{STRICT}; {MISSING}",
    ),
    *_both("5.1.4, figure 5.3 (a)", "4 against none", "1.49", "0.002", {}, a=(4,), reasons=("", STRICT)),
    *_both("5.1.4, figure 5.3 (b)", "7 against none", "1.40", "0.009", {}, a=(7,), reasons=("", STRICT)),
    *_both(
        "5.1.4, figure 5.3 (c)",
        "10 against none",
        "1.65",
        "0.0002",
        {},
        a=(10,),
        missing=True,
        reasons=(MISSING, f"{STRICT}; {MISSING}"),
    ),
    *_both(
        "5.1.4, figure 5.8 (text)",
        "fast opening, sticky against none",
        "3.61",
        "0.000002",
        {"action": "open_fast"},
        reasons=(CUT, STRICT),
    ),
    *_both(
        "5.1.4, figure 5.4 (text)",
        "slow opening, sticky against none",
        "2.93",
        "0.00003",
        {"action": "open_slow"},
        missing=True,
        reasons=(MISSING, f"{STRICT}; {MISSING}"),
    ),
    *_both(
        "5.1.5",
        "sticky against none",
        "1.51",
        "0.00004",
        {},
        missing=True,
        reasons=(MISSING, f"{SLIP}; {STRICT}; {MISSING}"),
    ),
    *(
        Printed(
            place, "sticky against none: p", "0.00004", "p", {}, missing=True, reason=f"{SLIP}; {STRICT}; {MISSING}"
        )
        for place in ("5.4", "chapter 6")
    ),
]


def _fraction(answers: Answers, a, b, **conditions) -> str:
    found = answers.where(**conditions).preference(a, b)
    return f"{found.for_a}:{found.for_b}"


def _counts_of(*parts: tuple[str, tuple, tuple, dict]) -> Callable[[Answers], str]:
    """`4 against none 14:6, ...`, one part for each (words, a, b, conditions)."""
    return lambda answers: ", ".join(f"{words} {_fraction(answers, a, b, **c)}" for words, a, b, c in parts)


def _all_ahead(*parts: tuple[tuple, tuple, dict]) -> Callable[[Answers], bool]:
    def holds(answers: Answers) -> bool:
        found = [answers.where(**conditions).preference(a, b) for a, b, conditions in parts]
        return all(one.for_a > one.for_b for one in found)

    return holds


def _by_level(answers: Answers, action: str) -> dict[int, tuple[int, int]]:
    """How often each level was chosen without and with audio."""
    parts = [answers.where(action=action, audio=audio) for audio in (0, 1)]
    return {level: tuple(_times(part, level) for part in parts) for level in answers.levels}


def _by_level_words(action: str) -> Callable[[Answers], str]:
    return lambda answers: ", ".join(
        f"level {level}: {before} to {after}" for level, (before, after) in _by_level(answers, action).items()
    )


def _shift(answers: Answers, action: str) -> int:
    """Change of the answers for sticky from without to with audio."""
    before, after = (answers.where(action=action, audio=audio).preference(STICKY, NONE) for audio in (0, 1))
    return after.for_a - before.for_a


def _with_audio(action: str) -> Callable[[Answers], str]:
    return _counts_of(
        ("sticky against none without audio", STICKY, NONE, {"action": action, "audio": 0}),
        ("with", STICKY, NONE, {"action": action, "audio": 1}),
    )


def _m_moves_up(answers: Answers) -> bool:
    change = {level: after - before for level, (before, after) in _by_level(answers, "m").items()}
    return change[0] < 0 and change[4] < 0 and change[7] > 0 and change[10] == max(change.values()) > 0


def _puppy_moves_down(answers: Answers) -> bool:
    change = {level: after - before for level, (before, after) in _by_level(answers, "puppy").items()}
    return change[0] + change[4] > 0 > change[7] + change[10]


def _worst_for_sticky(answers: Answers) -> list[tuple[str, Preference]]:
    """Sticky against none for every action with and without audio, least sticky share first."""
    found = []
    for (action, audio), _ in answers.table.groupby(["action", "audio"]):
        words = f"{action} with audio" if audio else action
        found.append((words, answers.where(action=action, audio=audio).preference(STICKY, NONE)))
    return sorted(found, key=lambda one: one[1].share)


def _never_strongly(answers: Answers) -> bool:
    return all(p_two_sided(one.for_b, one.n) > 0.05 or one.for_a > one.for_b for _, one in _worst_for_sticky(answers))


def _worst_words(answers: Answers) -> str:
    (words, one), *_ = _worst_for_sticky(answers)
    return f"least for sticky: {words} {one.for_a}:{one.for_b}, two-sided p {p_two_sided(one.for_a, one.n):.2f}"


_SLOW, _FAST, _M = {"action": "open_slow"}, {"action": "open_fast"}, {"action": "m", "audio": 0}
_P, _PUPPY = {"action": "p", "audio": 0}, {"action": "puppy", "audio": 0}

STATEMENTS: list[Statement] = [
    Statement(
        "5.1.4, figure 5.3 (d)",
        "a preference for level 7 over level 4",
        _all_ahead(((7,), (4,), {})),
        _counts_of(("7 against 4", (7,), (4,), {})),
    ),
    Statement(
        "5.1.4, figure 5.3 (e), (f)",
        "level 10 too much, levels 4 and 7 preferred",
        _all_ahead(((4,), (10,), {}), ((7,), (10,), {})),
        _counts_of(("4 against 10", (4,), (10,), {}), ("7 against 10", (7,), (10,), {})),
        "4 against 10 is within chance",
    ),
    Statement(
        "5.1.4, figure 5.5 (a), (b), (c)",
        "slow opening: a clear preference for any of the sticky levels over none",
        _all_ahead(*(((level,), NONE, _SLOW) for level in STICKY)),
        _counts_of(*((f"{level} against none", (level,), NONE, _SLOW) for level in STICKY)),
        "clear for 7 alone; 10 is within chance (two-sided p 0.50), also with the lost answer, 12:7",
    ),
    Statement(
        "5.1.4, figure 5.6",
        "m: no overall preference",
        lambda a: a.where(**_M).preference(STICKY, NONE).ratio == 1,
        _counts_of(("sticky against none", STICKY, NONE, _M)),
        "without audio; the caption does not say so",
    ),
    Statement(
        "5.1.4, figure 5.7 (f)",
        "m: 7 over 10 the most significant",
        _all_ahead(((7,), (10,), _M)),
        _counts_of(("7 against 10", (7,), (10,), _M)),
    ),
    Statement(
        "5.1.4, figure 5.8",
        "the preference is stronger for the fast than for the slow opening",
        lambda a: a.where(**_FAST).preference(STICKY, NONE).ratio > a.where(**_SLOW).preference(STICKY, NONE).ratio,
        _counts_of(("fast", STICKY, NONE, _FAST), ("slow", STICKY, NONE, _SLOW)),
        "three answers of 60 apart: within chance",
    ),
    Statement(
        "5.1.4, figure 5.9 (d), (e), (f)",
        "fast opening: higher levels consistently rated as better",
        _all_ahead(((7,), (4,), _FAST), ((10,), (4,), _FAST), ((10,), (7,), _FAST)),
        _counts_of(
            ("7 against 4", (7,), (4,), _FAST),
            ("10 against 4", (10,), (4,), _FAST),
            ("10 against 7", (10,), (7,), _FAST),
        ),
        "the opposite of conclusion 3 of section 5.1.5",
    ),
    Statement(
        "5.1.4, figure 5.10",
        "p: a strong preference for sticky",
        _all_ahead((STICKY, NONE, _P)),
        _counts_of(("sticky against none", STICKY, NONE, _P)),
        "without audio",
    ),
    Statement(
        "5.1.4, figure 5.11 (d), (e), (f)",
        "p: lower levels consistently preferred",
        _all_ahead(((4,), (7,), _P), ((4,), (10,), _P), ((7,), (10,), _P)),
        _counts_of(
            ("4 against 7", (4,), (7,), _P), ("4 against 10", (4,), (10,), _P), ("7 against 10", (7,), (10,), _P)
        ),
        "without audio",
    ),
    Statement(
        "5.1.4, figure 5.13",
        "puppy: 10 strongest against none, little between sticky levels",
        lambda a: (
            a.where(**_PUPPY).preference(10, 0).ratio
            > max(a.where(**_PUPPY).preference(level, 0).ratio for level in (4, 7))
        ),
        _counts_of(
            *((f"{level} against none", (level,), NONE, _PUPPY) for level in STICKY),
            ("7 against 4", (7,), (4,), _PUPPY),
            ("10 against 4", (10,), (4,), _PUPPY),
            ("10 against 7", (10,), (7,), _PUPPY),
        ),
    ),
    Statement(
        "5.1.4, figure 5.14",
        "m: audio increased the preference for sticky",
        lambda a: _shift(a, "m") > 0,
        _with_audio("m"),
    ),
    Statement(
        "5.1.4, figure 5.15",
        "m: with audio a shift from levels 0 and 4 to 7 and 10, most to 10",
        _m_moves_up,
        _by_level_words("m"),
        "the opposite of section 5.1.5, where audio is said to lower the preferred level",
    ),
    Statement(
        "5.1.4, figure 5.16", "p: with audio a dramatic shift to none", lambda a: _shift(a, "p") < 0, _with_audio("p")
    ),
    Statement(
        "5.1.4, figure 5.18",
        "mummy: with audio a slight shift to none",
        lambda a: _shift(a, "mummy") < 0,
        _with_audio("mummy"),
    ),
    Statement(
        "5.1.4, figure 5.19",
        "puppy: little change with audio",
        lambda a: abs(_shift(a, "puppy")) <= 5,
        _with_audio("puppy"),
    ),
    Statement(
        "5.1.4, figure 5.20", "puppy: with audio a shift to lower levels", _puppy_moves_down, _by_level_words("puppy")
    ),
    Statement(
        "5.1.4, Impact of Audio",
        "the aggregate effect across all actions (announced, not printed)",
        lambda a: True,
        _counts_of(
            ("spoken actions, sticky against none without audio", STICKY, NONE, {"action": SPOKEN, "audio": 0}),
            ("with", STICKY, NONE, {"action": SPOKEN, "audio": 1}),
        ),
    ),
    Statement(
        "5.1.5",
        "in no case was no stickiness strongly preferred",
        _never_strongly,
        _worst_words,
        "absence of evidence: 54 answers would miss a ratio of 1.5 more often than not",
    ),
]


def replicate_thesis(answers: Answers | None = None) -> pd.DataFrame:
    """Every count, ratio and p-value printed about the study, beside the same from the answers.

    Parameters
    ----------
    answers : other answers to the same questions; None: the thesis's own

    Returns
    -------
    One row per printed number: place, quantity, printed (as it stands), from_answers (the same from all answers, p by
    eq. 5.2), agrees, reason (why not), reconstructed (the number under that reason: NaN where it agrees),
    for_a, for_b (counts), p_at_least (eq. 5.2), p_more_than, p_two_sided
    """
    answers = answers or thesis_answers()
    rows = [_count(one, answers) if isinstance(one, Count) else _number(one, answers) for one in NUMBERS]
    return pd.DataFrame(rows, columns=COLUMNS)


def check_statements(answers: Answers | None = None) -> pd.DataFrame:
    """What the thesis says in words about the figures, beside the counts: place, printed, holds, counts, remark.

    `holds` means only that the counts point that way; `study.verdicts` tests the conclusions.
    """
    answers = answers or thesis_answers()
    rows = [(one.place, one.printed, one.holds(answers), one.counts(answers), one.remark) for one in STATEMENTS]
    return pd.DataFrame(rows, columns=["place", "printed", "holds", "counts", "remark"])


def _count(one: Count, answers: Answers) -> dict:
    found = str(one.of(answers))
    agrees = found == one.printed
    return {
        "place": one.place,
        "quantity": one.quantity,
        "printed": one.printed,
        "from_answers": found,
        "agrees": agrees,
        "reason": "" if agrees else one.reason,
    }


def _number(one: Printed, answers: Answers) -> dict:
    found = answers.where(**one.conditions).preference(one.a, one.b)
    r, n = found.for_a, found.n
    lost = found if not one.missing else dataclasses.replace(found, for_b=found.for_b - 1)
    if one.kind == "ratio":
        value, reconstructed = found.ratio, lost.ratio
        decimals = len(one.printed.partition(".")[2])
        text = f"{value:.{decimals}f}"
    else:
        value, reconstructed = p_at_least(r, n), p_more_than(r, lost.n)
        text = as_printed(value)
    agrees = text == one.printed
    return {
        "place": one.place,
        "quantity": one.quantity,
        "printed": one.printed,
        "from_answers": text,
        "agrees": agrees,
        "reason": "" if agrees else one.reason,
        "reconstructed": None if agrees else reconstructed,
        "for_a": found.for_a,
        "for_b": found.for_b,
        "p_at_least": p_at_least(r, n),
        "p_more_than": p_more_than(r, n),
        "p_two_sided": p_two_sided(r, n),
    }


def as_printed(p: float) -> str:
    """A p-value the way the thesis prints it: one digit that is not 0, no exponent."""
    digits, _, power = f"{p:.0e}".partition("e")
    places = -int(power)
    return f"{float(digits) * 10**-places:.{max(places, 0)}f}"
