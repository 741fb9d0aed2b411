"""A dry run: simulated participants answer the whole design, through the same database and export as real ones."""

from __future__ import annotations

import numpy as np
import pandas as pd

from study.design import Design
from study.export import answers_table
from study.store import Store

ATTENTIVE = 0.97  # share of catch trials answered as expected


def rehearse(
    design: Design, *, seed: int = 0, preference: float = 0.4, person_sd: float = 0.5, item_sd: float = 0.3
) -> pd.DataFrame:
    """The export (`study.export.answers_table`) of a study whose participants are simulated.

    The logit of choosing the pair's second video, that of the higher level, is `preference` plus a normal effect of the
    person and one of the pair. `preference` 0 simulates a study in which nothing is to be found.

    Parameters
    ----------
    seed : of all random numbers; participants' names follow from it too
    person_sd, item_sd : standard deviations of the two effects, logits
    """
    rng = np.random.default_rng(seed)
    item = rng.normal(0, item_sd, len(design.pairs) + 1)
    store = Store(":memory:", design.identity, len(design.sessions), clock=lambda: 0.0)
    names = {}
    for number, trials in enumerate(design.sessions, start=1):
        session = store.begin(f"simulated {number}")
        names[session.participant] = f"simulated{number:04d}"
        person = rng.normal(0, person_sd)
        for one in trials:
            if one.kind == "catch":
                wrong = one.right if one.expected == one.left else one.left
                chosen = one.expected if rng.random() < ATTENTIVE else wrong
            else:
                first, second = design.pairs[one.question - 1]
                chosen = second if rng.random() < 1 / (1 + np.exp(-preference - person - item[one.question])) else first
            seconds = float(np.round(2 + rng.lognormal(0, 0.6), 4))
            store.answer(
                f"simulated {number}",
                one.trial,
                "simulated",
                left=one.left,
                right=one.right,
                chosen=chosen,
                last=one.trial == len(trials),
                measures={"response_time_s": seconds, "choice_time_s": seconds - 2, "start_drift_s": 0.0, "loads_n": 1}
                | dict.fromkeys(("replays_left", "replays_right", "stalls_n"), 0)
                | dict.fromkeys(("watched_left_s", "watched_right_s"), 2.0),
            )
    table = answers_table(store, design)
    store.close()
    return table.assign(participant=table["participant"].map(names))
