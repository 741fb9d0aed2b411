"""Command line of the corpus tools: `lipmetrics corpus protocol | segment | index | run | average`.

    protocol -> record -> segment -> index -> run -> average

Each verb reads its words here and calls one function, imported only then; that function answers with a dict:
`text`, lines to print; `failed`, items that could not be done as `{"source": ..., "error": ...}`; `done_n`, how many
could; and whatever else `--json` should tell.

Exit codes: 0 done, 2 bad arguments or input, 3 some items of a batch failed, 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lipmetrics.console import (
    BAD_INPUT,
    DONE,
    SOME_FAILED,
    STOPPED,
    Parser,
    above_zero,
    add_verb,
    complain,
    count,
    prepare,
    say,
    say_json,
    seconds,
)
from lipmetrics.errors import InputError

if TYPE_CHECKING:
    from corpus_tools.readers import Reading

CORPORA = ("grid", "lombard", "mead", "ravdess")


def main(argv: list[str] | None = None, prog: str = "python -m corpus_tools.cli") -> int:
    """Run one command line, called `prog`; returns the exit code."""
    try:
        arguments = _parser(prog).parse_args(argv)
        return _finish(arguments, arguments.run(arguments))
    except InputError as error:
        complain(str(error))
        return BAD_INPUT
    except (MemoryError, OSError) as error:
        complain(" ".join(str(error).split()) or "ran out of memory; close other programs or use fewer --jobs")
        return BAD_INPUT
    except KeyboardInterrupt:
        complain("stopped; what was finished before is kept")
        return STOPPED


def run_protocol(arguments: argparse.Namespace) -> dict:
    """`corpus protocol`: the protocol, the sheet, the prompt page, and the planned cuts of each speaker."""
    from corpus_tools.protocol import load_protocol, protocol_text, write_protocol

    protocol = load_protocol(arguments.protocol)
    text = protocol_text() if arguments.protocol is None else Path(arguments.protocol).read_text(encoding="utf-8")
    if arguments.print:
        return {"text": [text.rstrip("\n")], "protocol": text}
    if arguments.out is None:
        raise InputError("expected -o DIR for the sheet and the prompt page, or --print, got neither")
    prepare(Path(arguments.out))
    paths = write_protocol(arguments.out, protocol, text, speakers=arguments.speaker)
    clips_n = len(protocol.utterances) * protocol.repetitions_n
    facts = f"{len(protocol.utterances)} utterances x {protocol.repetitions_n}, {clips_n} clips a speaker"
    return {
        "text": [f"{facts}, {math.ceil(protocol.length_s / 60)} minutes", *map(str, paths)],
        "files": [str(path) for path in paths],
        "utterances_n": len(protocol.utterances),
        "clips_n": clips_n,
        "length_s": protocol.length_s,
    }


def run_segment(arguments: argparse.Namespace) -> dict:
    """`corpus segment`: cuts a take, or proposes cuts where there is no list."""
    from corpus_tools.protocol import load_protocol
    from corpus_tools.segment import segment

    prepare(Path(arguments.out))
    return segment(
        arguments.take,
        arguments.out,
        cuts=arguments.cuts,
        protocol=load_protocol(arguments.protocol),
        speaker=arguments.speaker,
        mark_s=arguments.mark,
        overwrite=arguments.overwrite,
        crf=arguments.crf,
        progress=sys.stderr.isatty(),
    )


def run_index(arguments: argparse.Namespace) -> dict:
    """`corpus index`: writes the table of checks."""
    from corpus_tools.index import index

    protocol = _protocol(arguments)
    reading = _reading(arguments)
    expected = None
    if arguments.speaker:
        expected = protocol.names(arguments.speaker)
    elif arguments.protocol is not None or _is_default(arguments):  # everyone who is there should have everything
        expected = protocol.names(sorted({clip.fields["speaker"] for clip in reading.clips}))
    return index(
        reading.clips,
        arguments.out,
        misfits=reading.misfits,
        expected=expected,
        clip_s=protocol.clip_s if expected else None,
        jobs=arguments.jobs,
        progress=sys.stderr.isatty(),
    )


def run_run(arguments: argparse.Namespace) -> dict:
    """`corpus run`: measures what the store does not have yet."""
    from corpus_tools.batch import run

    return run(
        _told(_reading(arguments)).clips,
        arguments.out,
        jobs=arguments.jobs,
        dask=arguments.dask,
        method=arguments.method,
        reread=arguments.reread,
        progress=sys.stderr.isatty(),
    )


def run_average(arguments: argparse.Namespace) -> dict:
    """`corpus average`: averages of a store, as tables and a report."""
    from corpus_tools.report import write_report

    prepare(Path(arguments.out))
    return write_report(
        arguments.store,
        arguments.out,
        by=arguments.by,
        template=_template(arguments) if Path(arguments.store).is_dir() else None,
        parquet=arguments.parquet,
        progress=sys.stderr.isatty(),
    )


def _template(arguments: argparse.Namespace):
    from corpus_tools.naming import Template

    return _protocol(arguments).template if arguments.template is None else Template(arguments.template)


def _reading(arguments: argparse.Namespace) -> Reading:
    """The clips of the folder, or their words, by corpus, template, or the template of the protocol."""
    import dataclasses

    from corpus_tools.readers import read_corpus
    from corpus_tools.slices import slice_clip

    template = arguments.template
    if arguments.corpus is None and template is None:
        template = _protocol(arguments).template
    reading = read_corpus(arguments.folder, arguments.corpus, template, fps=arguments.fps)
    if arguments.slices is None:
        return reading
    clips, misfits = [], list(reading.misfits)
    for clip in reading.clips:
        try:
            clips += slice_clip(clip, arguments.slices, margin_s=arguments.margin)
        except InputError as error:
            misfits.append((clip.path, str(error)))
    if not clips:
        why = f"; {misfits[-1][1]}" if misfits else ", got none"
        raise InputError(f"expected {arguments.slices} in the clips of {arguments.folder}{why}")
    return dataclasses.replace(reading, clips=tuple(clips), misfits=tuple(misfits))


def _protocol(arguments: argparse.Namespace):
    from corpus_tools.protocol import load_protocol

    return load_protocol(arguments.protocol)


def _is_default(arguments: argparse.Namespace) -> bool:
    return arguments.corpus is None and arguments.template is None and arguments.slices is None


def _told(reading: Reading) -> Reading:
    """Say once what is not measured."""
    for path, why in reading.misfits[:5]:
        complain(f"left out {path}: {why}")
    if len(reading.misfits) > 5:
        complain(f"left out {len(reading.misfits) - 5} more; 'lipmetrics corpus index' lists them")
    return reading


def _finish(arguments: argparse.Namespace, answer: dict) -> int:
    """Print what a verb answers; the exit code follows from what failed."""
    failed = answer.get("failed") or []
    for one in failed:
        complain(f"{one['source']}: {one['error']}")
    lines = answer.pop("text", [])
    if arguments.json:
        say_json({"command": f"corpus {arguments.verb}", **answer})
    elif lines:
        say("\n".join(lines))
    if not failed:
        return DONE
    return SOME_FAILED if answer.get("done_n", 1) else BAD_INPUT


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = Parser(prog=prog, description="From a recording session to one store of measurements, and its averages.")
    verbs = parser.add_subparsers(title="commands", required=True, metavar="COMMAND", parser_class=Parser)
    _add_protocol(verbs, prog)
    _add_segment(verbs, prog)
    _add_index(verbs, prog)
    _add_run(verbs, prog)
    _add_average(verbs, prog)
    return parser


def _add_protocol(verbs, prog: str) -> None:
    verb = _add_verb(
        verbs,
        "protocol",
        run_protocol,
        "the recording protocol, a sheet to print and a page that prompts the speaker",
        f"{prog} protocol -o sheet --speaker p01",
    )
    verb.add_argument("protocol", nargs="?", metavar="PROTOCOL.toml", help="instead of the built-in one")
    verb.add_argument("-o", "--out", metavar="DIR", help="folder for protocol.toml, sheet.html, prompt.html")
    verb.add_argument("--print", action="store_true", help="print the protocol, to be changed, and write nothing")
    verb.add_argument("--speaker", nargs="+", default=[], metavar="NAME", help="also write NAME.cuts.csv as planned")


def _add_segment(verbs, prog: str) -> None:
    verb = _add_verb(
        verbs,
        "segment",
        run_segment,
        "a long take to clips by its cut list, or a proposal of the cuts",
        f"{prog} segment p01.mov --cuts p01.cuts.csv --mark 12.4 -o clips",
    )
    verb.add_argument("take", metavar="VIDEO", help="the long take")
    verb.add_argument("-o", "--out", required=True, metavar="DIR", help="folder for the clips, made if needed")
    what = verb.add_mutually_exclusive_group()
    what.add_argument("--cuts", metavar="CSV", help="start_s, stop_s and the fields of the names, or the page's log")
    what.add_argument("--propose", action="store_true", help="only write a cut list to check; so it is without --cuts")
    verb.add_argument("--protocol", metavar="TOML", help="names and lengths of the clips, if not the built-in protocol")
    verb.add_argument("--speaker", metavar="NAME", help="whose take it is, where the cuts are proposed")
    verb.add_argument("--mark", type=_from_zero, metavar="S", help="time of the page's mark in the take, s")
    verb.add_argument("--overwrite", action="store_true", help="replace clips that are there")
    verb.add_argument(
        "--crf",
        type=_rate_factor,
        metavar="N",
        help="encode with this loss, 1 (little) to 51, where a clip cannot be copied; smaller, but measures a little "
        "differently; without it lossless",
    )


def _add_index(verbs, prog: str) -> None:
    verb = _add_verb(
        verbs,
        "index",
        run_index,
        "checks before the work: missing, doubled, unreadable or badly framed clips, in a table",
        f"{prog} index clips -o index.csv",
    )
    _add_reading(verb)
    verb.add_argument("-o", "--out", required=True, metavar="CSV", help="the table")
    verb.add_argument("--speaker", nargs="+", default=[], metavar="NAME", help="who should be there")
    verb.add_argument("--jobs", type=count, metavar="N", help="processes; one for every core if not given")


def _add_run(verbs, prog: str) -> None:
    verb = _add_verb(
        verbs,
        "run",
        run_run,
        "measure all clips into one store; goes on where it was stopped",
        f"{prog} run clips -o corpus.h5",
    )
    _add_reading(verb)
    verb.add_argument("-o", "--out", required=True, metavar="STORE.h5", help="the store, made if needed")
    verb.add_argument("--jobs", type=count, metavar="N", help="processes; one for every core if not given")
    verb.add_argument("--dask", metavar="ADDRESS", help="measure on this Dask cluster, such as tcp://10.0.0.1:8786")
    verb.add_argument("--method", default="default", help="default, or thesis for the published baseline")
    verb.add_argument("--reread", action="store_true", help="compare contents, not only sizes and times of files")


def _add_average(verbs, prog: str) -> None:
    verb = _add_verb(
        verbs,
        "average",
        run_average,
        "average profiles of a store with their spread, as a report with tables",
        f"{prog} average corpus.h5 -o report",
    )
    verb.add_argument("store", metavar="STORE.h5", help="from 'corpus run'; or a folder of profiles")
    verb.add_argument("-o", "--out", required=True, metavar="DIR", help="folder for the report and the tables")
    verb.add_argument(
        "--by", nargs="+", metavar="FIELD", help="average clips that agree in these; the last one is drawn as levels"
    )
    verb.add_argument("--template", metavar="TEXT", help="names of the profiles of a folder")
    verb.add_argument("--protocol", metavar="TOML", help="whose template it is, if not the built-in protocol's")
    verb.add_argument("--parquet", action="store_true", help="tables as Parquet too (needs the extra)")


def _add_reading(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("folder", metavar="FOLDER", help="the corpus")
    kind = verb.add_mutually_exclusive_group()
    kind.add_argument("--corpus", choices=CORPORA, help="a known corpus by its own layout and names")
    kind.add_argument("--template", metavar="TEXT", help="names of the clips, such as {speaker}_{utterance}_{repeat:d}")
    verb.add_argument("--protocol", metavar="TOML", help="names of the clips, if not the built-in protocol")
    verb.add_argument("--fps", type=above_zero, help="pictures per second of clips that are folders of pictures")
    verb.add_argument("--slices", metavar="TIER", help="measure words or phones (a tier of their TextGrids), not clips")
    verb.add_argument("--margin", type=_from_zero, default=0.0, metavar="S", help="added on both sides of a slice, s")


def _add_verb(verbs, name: str, run, what: str, example: str) -> argparse.ArgumentParser:
    verb = add_verb(verbs, name, run, what, example)
    verb.set_defaults(verb=name)
    return verb


def _rate_factor(text: str) -> int:
    value = count(text)
    if value > 51:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1 to 51, got '{text}'")
    return value


def _from_zero(text: str) -> float:
    value = seconds(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"expected a time of 0 s or more, got '{text}'")
    return value


if __name__ == "__main__":
    sys.exit(main())
