"""Command line of the study: `lipmetrics study design | serve | export | analyse`, or `python -m study.cli ...`.

Exit codes: 0 done, 2 bad arguments or input, 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import socket
import sys
from pathlib import Path

from study.errors import InputError

DONE, BAD_INPUT, STOPPED = 0, 2, 130
SECONDS_PER_TRIAL = 15  # two videos of a few seconds, seen once or twice, and a choice


def main(argv: list[str] | None = None, prog: str = "python -m study.cli") -> int:
    """Run one command line, called `prog`; returns the exit code."""
    words = sys.argv[1:] if argv is None else list(argv)
    try:
        if words[:1] == ["analyse"]:  # reads its own words
            return _analyse(words[1:], f"{prog} analyse")
        arguments = _parser(prog).parse_args(words)
        return arguments.run(arguments)
    except InputError as error:
        _complain(str(error))
        return BAD_INPUT
    except (MemoryError, OSError) as error:
        _complain(" ".join(str(error).split()) or "ran out of memory")
        return BAD_INPUT
    except KeyboardInterrupt:
        _complain("stopped; what was finished before is kept")
        return STOPPED


def _analyse(words: list[str], prog: str) -> int:
    from study.report import main as analyse

    return analyse(words, prog=prog)


def run_design(arguments: argparse.Namespace) -> int:
    """`study design`: videos to a folder with the design, the settings and the texts of the pages."""
    from study.design import make_design
    from study.settings import load_settings, write_settings
    from study.videos import check_videos, copy_videos

    stimuli = _stimuli(arguments)
    asked = {
        "participants_n": arguments.participants,
        "scheme": arguments.pairs,
        "per_participant_n": arguments.per_participant,
        "catch_n": arguments.catch,
        "practice_n": arguments.practice,
        "catch_pairs": arguments.catch_pair,
        "seed": arguments.seed,
    }
    design = make_design(stimuli, **asked)
    warnings = check_videos(design.stimuli, design.pairs)
    folder = Path(arguments.out)
    _keep_answers(folder, arguments.overwrite)
    used = {one.code for one in design.stimuli}
    design = make_design(copy_videos([one for one in stimuli if one.code in used], folder), **asked)
    trials_n = len(design.sessions[0])
    paths = design.save(folder) + write_settings(folder, max(1, round(trials_n * SECONDS_PER_TRIAL / 60)))
    load_settings(folder)
    facts = {
        "folder": str(folder),
        "files": [str(path) for path in paths],
        "videos": len(design.stimuli),
        "pairs": len(design.pairs),
        "participants": len(design.sessions),
        "trials_per_participant": trials_n,
        "seed": design.seed,
        "identity": design.identity,
        "warnings": warnings,
    }
    for warning in warnings:
        _complain(f"warning: {warning}")
    served = all(one.file for one in design.stimuli)
    if not arguments.json:
        _say(
            f"{facts['pairs']} pairs of {facts['videos']} videos; {facts['participants']} participants of "
            f"{trials_n} trials -> {folder}"
        )
        if served:
            _say(f"change study.toml and the texts (*.md) there, then: lipmetrics study serve {folder}")
    code = _dry_run(design, folder, facts, arguments) if arguments.dry_run else DONE
    if arguments.json:
        _say_json({"command": "design", **facts})
    return code


def _dry_run(design, folder: Path, facts: dict, arguments: argparse.Namespace) -> int:
    """Simulated participants through database, export and analysis, into the folder dry_run."""
    from study.export import write_answers
    from study.rehearsal import rehearse

    table = rehearse(design, seed=design.seed)
    answers, _ = write_answers(folder / "dry_run" / "answers.csv", table)
    facts["dry_run"] = str(answers)
    if not arguments.json:
        _say(f"dry run: {len(table)} answers of {len(design.sessions)} simulated participants -> {answers}")
    stdout = sys.stdout
    try:
        if arguments.json:
            sys.stdout = sys.stderr
        return _analyse([str(answers), "-o", str(folder / "dry_run")], "lipmetrics study analyse")
    finally:
        sys.stdout = stdout


def _stimuli(arguments: argparse.Namespace) -> list:
    from study.design import stimuli_from_codes, stimuli_from_csv, stimuli_from_folder, with_files

    given = arguments.videos
    if arguments.stimuli is not None:
        if given:
            raise InputError(f"expected either VIDEOS or --stimuli, got both: {given[0]} and {arguments.stimuli}")
        return stimuli_from_csv(arguments.stimuli)
    if not given:
        raise InputError("expected a folder of videos, videos, or codes such as os0 os4 os10; or --stimuli CSV")
    if len(given) == 1 and (os.path.isdir(given[0]) or os.sep in given[0]):
        return stimuli_from_folder(given[0])
    if any(os.path.isfile(one) for one in given):
        files = {Path(one).stem: Path(one) for one in given}
        if len(files) < len(given):
            raise InputError("expected videos of different names, got two of one name; rename one")
        return with_files(stimuli_from_codes(files), files)
    return stimuli_from_codes(given)


def _keep_answers(folder: Path, overwrite: bool) -> None:
    """A design that may have answers is not replaced unseen."""
    if (folder / "design.json").exists() and not overwrite:
        raise InputError(
            f"expected a folder without a design, got {folder}, which has one; name another or --overwrite"
        )


def run_serve(arguments: argparse.Namespace) -> int:
    """`study serve`: show the study in browsers until Ctrl-C."""
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401
    except ImportError:
        raise InputError(
            "expected the packages starlette and uvicorn to serve a study, found none; "
            "run: pip install 'lipmetrics[web]'"
        ) from None
    from study.server import open_study, serve

    study = open_study(arguments.folder)
    listening = _listen(arguments.host, arguments.port)
    host, port = listening.getsockname()[:2]
    shown = "127.0.0.1" if host in ("0.0.0.0", "::") else host
    address = f"http://{f'[{shown}]' if ':' in shown else shown}:{port}/"

    def say():
        done = sum(one["state"] == "done" for one in study.store.sessions())
        _say(f"{study.settings.title}: {done} of {len(study.design.sessions)} participants done")
        _say(f"the study is at {address} until Ctrl-C")

    serve(study, listening, on_start=say)
    return DONE


def _listen(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listening = socket.socket(family, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen(1024)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"expected to listen at {host}, port {port}, but: {reason}; choose another --port") from None
    return listening


def run_export(arguments: argparse.Namespace) -> int:
    """`study export`: the answers in the database to a long table and its dictionary."""
    from study.design import load_design
    from study.export import answers_table, write_answers, write_outside_ids
    from study.settings import load_settings
    from study.store import Store, is_postgres

    folder = Path(arguments.folder)
    design, settings = load_design(folder), load_settings(folder)
    database = settings.database if is_postgres(settings.database) else folder / settings.database
    if isinstance(database, Path) and not database.exists():
        raise InputError(f"expected answers in {database}, there is no such file; 'lipmetrics study serve' makes it")
    store = Store(database, design.identity, len(design.sessions))
    try:
        table = answers_table(store, design, complete=arguments.complete)
        states = [one["state"] for one in store.sessions()]
        files = write_answers(arguments.out, table)
        if arguments.ids is not None:
            files.append(write_outside_ids(arguments.ids, store))
        withdrawn = store.withdrawn_n()
    finally:
        store.close()
    facts = {
        "files": [str(path) for path in files],
        "answers": len(table),
        **{state: states.count(state) for state in ("done", "active", "replaced")},
        "withdrawn": withdrawn,
    }
    if arguments.json:
        _say_json({"command": "export", **facts})
    else:
        _say(
            f"{len(table)} answers; participants: {facts['done']} done, {facts['active']} not finished, "
            f"{withdrawn} withdrawn -> {files[0]}"
        )
    return DONE


def _complain(text: str) -> None:
    print(f"lipmetrics study: {text}", file=sys.stderr)


def _say(text: str) -> None:
    """Print a result; once nobody reads on, the work goes on in silence."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _say_json(summary: dict) -> None:
    _say(json.dumps(summary, indent=2, ensure_ascii=False))


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line instead of a page of usage."""

    def error(self, message: str):
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see '{self.prog} --help'\n")


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = _Parser(prog=prog, description="Run a study that asks which of two videos is better, and analyse it.")
    verbs = parser.add_subparsers(title="commands", required=True, metavar="COMMAND", parser_class=_Parser)

    design = _add_verb(
        verbs,
        "design",
        run_design,
        "a folder of videos to pairs, orders and sides for every participant",
        "lipmetrics study design clips/ -o my_study --participants 20 --catch 4 --practice 2",
    )
    design.add_argument("videos", nargs="*", metavar="VIDEOS", help="folder, videos, or codes such as os0 os4 os10")
    design.add_argument("-o", "--out", required=True, metavar="DIR", help="folder of the study, made if needed")
    design.add_argument("--stimuli", metavar="CSV", help="table of videos: stimulus, action, level, audio, speed, file")
    design.add_argument(
        "--pairs", default="all", metavar="SCHEME", help="all (default), chain (neighbouring levels), or bib"
    )
    design.add_argument(
        "--per-participant", type=_count, metavar="N", help="with bib: how many of the pairs each participant answers"
    )
    design.add_argument("--participants", type=_count, default=20, metavar="N", help="default 20; even is exact")
    design.add_argument("--catch", type=_number_of, default=0, metavar="N", help="checks of attention per participant")
    design.add_argument(
        "--catch-pair",
        nargs=2,
        action="append",
        default=[],
        metavar=("BETTER", "WORSE"),
        help="pair with a plain answer for checks; without one, the page says which side to choose",
    )
    design.add_argument("--practice", type=_number_of, default=0, metavar="N", help="trials before the first")
    design.add_argument("--seed", type=_number_of, default=0, metavar="S", help="chooses among the balanced designs")
    design.add_argument("--dry-run", action="store_true", help="simulated participants through the whole analysis")
    design.add_argument("--overwrite", action="store_true", help="replace the design that is there")

    serve = _add_verb(
        verbs, "serve", run_serve, "the study as web pages, until Ctrl-C", "lipmetrics study serve my_study --port 8000"
    )
    serve.add_argument("folder", metavar="DIR", help="folder of the study")
    serve.add_argument(
        "--host", default="127.0.0.1", help="default 127.0.0.1, this computer only; 0.0.0.0 lets others in"
    )
    serve.add_argument("--port", type=_port, default=8000, help="default 8000; 0 takes a free one")

    export = _add_verb(
        verbs,
        "export",
        run_export,
        "the answers as a long table, with a dictionary of its columns",
        "lipmetrics study export my_study -o answers.csv",
    )
    export.add_argument("folder", metavar="DIR", help="folder of the study")
    export.add_argument("-o", "--out", default="answers.csv", metavar="FILE", help="table; default answers.csv")
    export.add_argument("--complete", action="store_true", help="finished sessions only")
    export.add_argument("--ids", metavar="FILE", help="also write what recruiting services named the participants")

    verbs.add_parser("analyse", help="answers to tables, figures and a report", add_help=False)
    return parser


def _add_verb(verbs, name: str, run, what: str, example: str) -> argparse.ArgumentParser:
    verb = verbs.add_parser(name, help=what, description=what[0].upper() + what[1:] + ".", epilog=f"example: {example}")
    verb.add_argument("--json", action="store_true", help="print one machine-readable summary on stdout")
    verb.set_defaults(run=run)
    return verb


def _whole(text: str, low: int, high: float, what: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > 18 or not low <= int(text) <= high:
        raise argparse.ArgumentTypeError(f"expected {what}, got '{text}'")
    return int(text)


def _count(text: str) -> int:
    return _whole(text, 1, math.inf, "a whole number of at least 1")


def _number_of(text: str) -> int:
    return _whole(text, 0, math.inf, "a whole number, 0 or more")


def _port(text: str) -> int:
    return _whole(text, 0, 65535, "a port from 0 to 65535")


if __name__ == "__main__":
    sys.exit(main())
