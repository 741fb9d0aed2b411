"""Tables of docs/study.md from the thesis's answers: `python benchmarks/study_tables.py --write`.

Only what stands between `<!-- name -->` and `<!-- end of name -->` is replaced; tests/test_study_docs.py asserts that
it is current.
"""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path

from study import summary
from study.analysis import Analysis, analyse
from study.clusters import clustered_share
from study.headline import headline
from study.printed import between, p_text, percent
from study.replication import check_statements, replicate_thesis

PAGE = Path(__file__).parents[1] / "docs" / "study.md"
OPENINGS, SPOKEN = ("open_slow", "open_fast"), ("m", "mummy", "p", "puppy")


def printed_blocks() -> dict[str, str]:
    """The thesis's printed numbers and words, as Markdown by name of the block."""
    return {
        "replication": summary.replication(replicate_thesis()).markdown(),
        "statements": summary.statements(check_statements()).markdown(),
    }


def analysed_blocks() -> dict[str, str]:
    """What the analysis says, as Markdown by name of the block; the table of tests needs statsmodels to be whole."""
    found = analyse()
    blocks = {
        "in short": "\n".join(f"- {one}" for one in summary.in_short(found)) + "\n",
        "verdicts": summary.verdicts(found.verdicts).markdown(),
    }
    blocks["by kind"] = by_kind(found)
    for name in ("tests", "pairs", "strengths", "groups"):
        blocks[name] = getattr(summary, name)(found).markdown()
    for factor, one in found.interactions.items():
        blocks[f"{factor} changes"] = summary.interaction_effects(one).markdown()
        blocks[f"{factor} levels"] = summary.interaction_levels(one).markdown()
    return blocks


def by_kind(found: Analysis) -> str:
    """Stickiness or none in the mouth openings and in speech, as Markdown."""
    a, b = found.answers.sticky()
    rows = []
    for name, actions in (("slow and fast opening", OPENINGS), ("m, mummy, p, puppy", SPOKEN)):
        choices = found.answers.where(action=actions).choices(a, b)
        wide, narrow = headline(choices, draws=found.draws), clustered_share(choices)
        rows.append(
            (
                name,
                f"{int(choices.y.sum())} of {len(choices.y)}",
                percent(wide.mean),
                between(narrow.low, narrow.high),
                p_text(narrow.p_t),
                between(wide.low, wide.high),
                p_text(wide.p),
            )
        )
    head = ("", "chosen", "share", "participants", "p", "headline", "p")
    return summary.Table(head, tuple(rows)).markdown()


def with_blocks(text: str, blocks: dict[str, str]) -> str:
    """The page with its blocks replaced.

    Raises
    ------
    KeyError : the page has no such block
    """
    for name, block in blocks.items():
        pattern = re.compile(rf"(<!-- {name} -->\n).*?(<!-- end of {name} -->)", re.DOTALL)
        if not pattern.search(text):
            raise KeyError(name)
        text = pattern.sub(lambda match, block=block: f"{match[1]}{block}{match[2]}", text)
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="replace the tables in docs/study.md")
    arguments = parser.parse_args()
    blocks = printed_blocks() | analysed_blocks()
    if arguments.write:
        part = PAGE.with_suffix(".part")
        part.write_text(with_blocks(PAGE.read_text(encoding="utf-8"), blocks), encoding="utf-8")
        os.replace(part, PAGE)
    else:
        for name, block in blocks.items():
            print(f"{name}\n\n{block}")


if __name__ == "__main__":
    main()
