"""Which of the thesis's conclusions its own answers carry, each by the test that asks for it.

Conclusions: section 5.1.5, repeated in 5.4 and chapter 6. A conclusion survives if p is at most 0.05 in the direction
stated, under the test that allows for other participants and other pairs of videos; in part if only under one that
takes the videos as given.
"""

from __future__ import annotations

import pandas as pd

from study.effects import Interaction
from study.headline import Headline

ALPHA = 0.05
COLUMNS = ["place", "conclusion", "survives", "test", "estimate", "p", "comment"]


def verdicts(
    *,
    overall: Headline,
    by_video_set: Headline,
    pairs: pd.DataFrame,
    people: pd.DataFrame,
    heterogeneity_p: float,
    consistency: pd.DataFrame,
    audio: Interaction,
    speed: Interaction,
) -> pd.DataFrame:
    """One row per conclusion: place, conclusion, survives (yes, in part or no), test, estimate, p, comment.

    Parameters
    ----------
    overall, by_video_set : headline test of sticky against none; in the second, action and audio are the items
    pairs : `study.tables.level_pairs` with the headline columns
    people, heterogeneity_p, consistency : of `study.consistency`
    audio, speed : of `study.effects.interaction`
    """
    everyone = consistency.iloc[-1]
    rows = [_overall(overall, by_video_set), _awareness(heterogeneity_p, people), _everybody(people)]
    rows += [_speed_direction(speed), _speed_at_all(speed), _audio(audio), _audio_lower(audio)]
    rows += [_level(pairs, 7, 10, "level 10 is too much"), _level(pairs, 7, 4, "level 7 is preferred to level 4")]
    rows.append(
        (
            "5.1.1, question 4",
            "people can tell the levels apart",
            _yes(everyone["p"]),
            "circular triads against coin flips",
            "{circular:.0f} circular triads of {triads:.0f}, {expected:.0f} expected".format(**everyone),
            float(everyone["p"]),
            "weakly: a participant's choices are little more orderly than coin flips",
        )
    )
    return pd.DataFrame(rows, columns=COLUMNS)


def _yes(p: float, direction: bool = True) -> str:
    return "yes" if p <= ALPHA and direction else "no"


def _overall(overall: Headline, by_video_set: Headline) -> tuple:
    low, high = (share / (1 - share) for share in (overall.low, overall.high))
    both = _yes(max(overall.p, by_video_set.p), overall.mean > 0.5)
    return (
        "5.1.5, first; 5.4; chapter 6",
        "stickiness improves perceived realism",
        "in part" if both == "no" and _yes(overall.p, overall.mean > 0.5) == "yes" else both,
        "headline (participants and pairs)",
        f"ratio {overall.mean / (1 - overall.mean):.2f}, 95 % interval {low:.2f} to {high:.2f}",
        overall.p,
        f"{overall.p / 4e-7:,.0f} times the printed p. With the {by_video_set.items_n} sets of videos (action, with or "
        f"without audio) in place of the pairs: p {by_video_set.p:.3f}",
    )


def _awareness(p: float, people: pd.DataFrame) -> tuple:
    return (
        "5.1.5, second",
        "some people have a preference, others have not",
        _yes(p),
        "do participants differ: answers to each pair dealt anew",
        f"shares for sticky from {people['share'].min():.2f} to {people['share'].max():.2f}",
        p,
        "people differ; who has no preference cannot be told from who has a weak one with 30 answers each",
    )


def _everybody(people: pd.DataFrame) -> tuple:
    sure, hint = people[people["p_holm"] <= ALPHA], people[people["p"] <= ALPHA]
    against = int((hint["share"] < 0.5).sum())
    return (
        "5.4; chapter 6",
        "all who have a preference prefer sticky",
        "yes" if len(sure) and not against else "no",
        "exact binomial for each participant, Holm",
        f"{int((sure['share'] > 0.5).sum())} participants for sticky, {int((sure['share'] < 0.5).sum())} for none; "
        f"without Holm {len(hint) - against} and {against}",
        float(people["p_holm"].min()),
        f"it rests on {len(sure)} of {len(people)} participants",
    )


def _speed_direction(speed: Interaction) -> tuple:
    test = speed.matched_higher_sticky or speed.matched_higher
    return (
        "5.1.5, third; 5.4; chapter 6",
        "higher levels are preferred on slower, lower on faster movements",
        _yes(test.p, test.mean < 0),
        "headline, fast minus slow, matched actions",
        f"higher of two sticky levels chosen {_points(test)} more often in fast movements",
        test.p,
        "the fast opening went the other way: its higher levels were preferred, as section 5.1.4 itself says",
    )


def _speed_at_all(speed: Interaction) -> tuple:
    changed = speed.levels[speed.levels["p_holm"] <= ALPHA]
    words = ", ".join(f"level {row.level} {100 * row.difference:+.0f} points" for row in changed.itertuples())
    return (
        "5.1.5, third",
        "the preferred level depends on the speed",
        "in part" if speed.p_levels <= ALPHA else "no",
        "Hotelling's T^2 over participants, shares of the levels",
        f"in fast movements {words or 'no level changes by itself'}",
        speed.p_levels,
        "for these six actions only; three of each speed do not stand for all fast and slow movements",
    )


def _audio(audio: Interaction) -> tuple:
    return (
        "5.1.5, fourth",
        "audio can affect the preferred level",
        _yes(audio.p_levels),
        "Hotelling's T^2 over participants, shares of the levels",
        f"sticky against none {_points(audio.sticky)} with audio (p {audio.sticky.p:.2f})",
        audio.p_levels,
        "not shown, nor shown to be absent: clear without audio and unclear with it is not a difference",
    )


def _audio_lower(audio: Interaction) -> tuple:
    test = audio.matched_higher
    return (
        "5.1.5; 5.4",
        "audio lowers the preferred level",
        _yes(test.p, test.mean < 0),
        "headline, with minus without audio, same pairs",
        f"higher level chosen {_points(test)} more often with audio",
        test.p,
        "m went the other way (section 5.1.4)",
    )


def _level(pairs: pd.DataFrame, better, worse, words: str) -> tuple:
    row = pairs[pairs["level_a"].isin([better, worse]) & pairs["level_b"].isin([better, worse])].iloc[0]
    share = row["share"] if row["level_a"] == better else 1 - row["share"]
    survives = _yes(row["p_headline_holm"], share > 0.5)
    if survives == "no" and row["p_holm"] <= ALPHA and share > 0.5:
        survives = "in part"
    return (
        "5.1.4, figure 5.3",
        words,
        survives,
        "headline, Holm over the six pairs",
        f"{better} chosen over {worse} in {100 * share:.0f} %",
        float(row["p_headline_holm"]),
        f"over participants, with these videos taken as given, Holm: p {row['p_holm']:.3f}",
    )


def _points(one) -> str:
    return f"{100 * one.mean:+.1f} points ({100 * one.low:+.1f} to {100 * one.high:+.1f})"
