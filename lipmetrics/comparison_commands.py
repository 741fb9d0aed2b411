"""The commands `compare`, `average` and `score`: their words, and what they do; everything heavy is imported then."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from lipmetrics.console import (
    DONE,
    SOME_FAILED,
    above_zero,
    add_verb,
    complain,
    count,
    prepare,
    say,
    say_json,
    sentence,
)
from lipmetrics.errors import InputError

if TYPE_CHECKING:
    from lipmetrics.labels import Labels
    from lipmetrics.scoring import Labelled
    from lipmetrics.take import Take

_DEFAULT = object()
REFERENCE_GROUPS = ("real", "reference", "references")
_TAKES = "takes: profiles, simulated clips, videos, meshes, landmark tables, or folders of these"


def add_comparison_verbs(verbs) -> None:
    """Add the three commands to the parser's."""
    verb = add_verb(
        verbs,
        "compare",
        run_compare,
        "align two takes: distances, lag, phases and figures on one page",
        "lipmetrics compare real/anna_mm_1 model/anna_mm_1 -o out",
    )
    verb.add_argument("first", metavar="A", help="a take, the reference")
    verb.add_argument("second", metavar="B", help="another take")
    verb.add_argument("-o", "--out", default="lipmetrics-compare", metavar="DIR", help="folder for numbers and page")
    _add_curves(verb)
    _add_reading(verb)

    verb = add_verb(
        verbs,
        "average",
        run_average,
        "average several takes of one movement, with their spread",
        "lipmetrics average real/*_mm_*.frames.csv -o out/mm",
    )
    verb.add_argument("takes", nargs="+", metavar="PROFILE", help=_TAKES)
    verb.add_argument("-o", "--out", required=True, metavar="FILE", help="FILE.average.csv, .json and .png are written")
    _add_curves(verb, cost=False)
    _add_reading(verb)

    verb = add_verb(
        verbs,
        "score",
        run_score,
        "score a model's takes against real ones, with the floor that real takes set",
        "lipmetrics score model/ --reference real/ --names {speaker}_{utterance}_{repeat} -o out",
    )
    verb.add_argument("takes", nargs="*", metavar="MODEL", help=f"the model's {_TAKES}")
    named = "takes of a named model; give several models, or one several times"
    verb.add_argument("--model", action="append", default=[], metavar="NAME=PATH", type=_named_path, help=named)
    verb.add_argument("--reference", nargs="+", default=[], metavar="REAL", help="the real takes")
    verb.add_argument("-o", "--out", default="lipmetrics-score", metavar="DIR", help="folder for numbers and report")
    verb.add_argument("--names", metavar="PATTERN", help="of the takes' names, such as {speaker}_{utterance}_{repeat}")
    verb.add_argument("--model-names", metavar="PATTERN", help="the models' names, where they are built differently")
    verb.add_argument("--list", metavar="CSV", help="table of path, utterance, speaker, repeat, group for all takes")
    verb.add_argument("--same-speaker", action="store_true", help="compare a take with those of its own speaker only")
    verb.add_argument("--seed", type=_whole, default=0, metavar="N", help="of the bootstrap (default 0)")
    verb.add_argument("--draws", type=count, default=2000, metavar="N", help="of the bootstrap (default 2000)")
    _add_curves(verb)
    _add_reading(verb)


def _add_curves(verb: argparse.ArgumentParser, *, cost: bool = True) -> None:
    verb.add_argument("--channels", metavar="A,B", help="of width, height and area (default all)")
    if cost:
        verb.add_argument("--cost", default=None, help="local cost of the alignment: absolute (default) or squared")
    verb.add_argument(
        "--band", type=_band, default=_DEFAULT, metavar="R", help="share of the duration a path may stray by, or none"
    )
    verb.add_argument("--rate", type=above_zero, metavar="HZ", help="samples per second that curves are compared at")
    verb.add_argument("--allow-mixed-units", action="store_true", help="compare lengths in different units anyway")


def _add_reading(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("--unit", default="mw", help="mw, mouth widths (default), or px, m, model")
    verb.add_argument("--fps", type=above_zero, help="frames per second of meshes, and of landmarks without times")
    verb.add_argument("--lip-loop", metavar="FILE", help="inner-lip vertices of meshes")
    verb.add_argument("--mouth-width", type=above_zero, metavar="W", help="at rest, px or units of the mesh")
    verb.add_argument("--video", action="store_true", help="measure the videos of simulated clips, not their truth")


# -- compare ----------------------------------------------------------------------------------------------------------


def run_compare(arguments: argparse.Namespace) -> int:
    """`lipmetrics compare`: two takes, their distances and a page."""
    from lipmetrics.compare_page import as_record, compare_takes, in_short, write_comparison
    from lipmetrics.takes import read_take

    folder = Path(arguments.out)
    prepare(folder)
    takes = [read_take(path, **_reading(arguments, folder)) for path in (arguments.first, arguments.second)]
    takes = _distinct(takes, [arguments.first, arguments.second])
    found = compare_takes(*takes, **_curves(arguments), mixed_units=arguments.allow_mixed_units)
    files = [str(path) for path in write_comparison(found, folder)]
    if arguments.json:
        say_json({"command": "compare", **as_record(found), "files": files})
    else:
        say("\n".join([*in_short(found), f"open {files[-1]} in a browser; all files are in {folder}"]))
    return DONE


# -- average ----------------------------------------------------------------------------------------------------------


def run_average(arguments: argparse.Namespace) -> int:
    """`lipmetrics average`: takes of one movement to their average with its spread, and a figure."""
    from lipmetrics.atomic import whole_file
    from lipmetrics.compare import average
    from lipmetrics.curve_figures import average_png
    from lipmetrics.take import same_unit

    target = Path(arguments.out)
    name = target.name
    for ending in (".csv", ".json", ".png", ".average"):
        name = name.removesuffix(ending)
    if not name:
        raise InputError(f"expected a file name after -o such as out/mm, got '{arguments.out}'")
    folder = target.parent
    prepare(folder)
    curves = _curves(arguments)
    usable, failed = [], {}
    for path, take in _read_all(arguments.takes, _reading(arguments, folder), failed):
        try:
            take.array(curves.get("channels", ("width", "height", "area")))
            usable.append(take)
        except InputError as error:
            failed[str(path)] = str(error)
    _tell(failed)
    if not usable:
        raise InputError("expected a take that can be averaged, got none; see above" if failed else "expected a take")
    same_unit(usable, allow_mixed=arguments.allow_mixed_units)
    made = average(usable, name=name, mixed_units=arguments.allow_mixed_units, **curves)
    files = made.save(folder, name)
    files.append(folder / f"{name}.average.png")
    with whole_file(files[-1]) as part:
        part.write_bytes(average_png(made, usable))
    typical = {channel: float(made.spread[:, c].mean()) for c, channel in enumerate(made.channels)}
    if arguments.json:
        facts = {"name": name, "takes": list(made.takes), "unit": made.unit, "rate_hz": made.rate_hz}
        facts |= {"duration_s": float(made.time_s[-1]), "mean_spread": typical, "failed": failed}
        say_json({"command": "average", **facts, "files": [str(path) for path in files]})
    else:
        spread = ", ".join(f"{channel} ± {value:.3g}" for channel, value in typical.items())
        say(f"average of {len(usable)} takes, {made.time_s[-1]:.2f} s, {spread} {made.unit} -> {files[0]}")
    return SOME_FAILED if failed else DONE


# -- score ------------------------------------------------------------------------------------------------------------


def run_score(arguments: argparse.Namespace) -> int:
    """`lipmetrics score`: models against real takes, to numbers and a report."""
    from lipmetrics.labels import read_list
    from lipmetrics.score_files import summary, write_score
    from lipmetrics.score_page import in_short, write_score_page
    from lipmetrics.scoring import Settings, score

    folder = Path(arguments.out)
    listed = read_list(arguments.list) if arguments.list else {}
    models, references = _sources(arguments, listed)
    prepare(folder)
    reading, failed = _reading(arguments, folder), {}
    real = _labelled(references, reading, failed, listed, arguments.names)
    pattern = arguments.model_names or arguments.names
    named = {name: _labelled(paths, reading, failed, listed, pattern) for name, paths in models.items()}
    for what, takes in (("real take", real), *((f"take of {name}", takes) for name, takes in named.items())):
        if not takes:
            _tell(failed)
            raise InputError(f"expected a {what} that can be used, got none; see above")
    settings = Settings(
        **_curves(arguments),
        allow_mixed_units=arguments.allow_mixed_units,
        same_speaker=arguments.same_speaker,
        seed=arguments.seed,
        draws=arguments.draws,
    )
    with _progress() as step:
        found = score(named, real, settings=settings, progress=step)
    found.failed = failed | found.failed
    _tell(found.failed)
    files = write_score(found, folder)
    files.append(folder / "report.html")
    write_score_page(found, files[-1])
    names = [str(path) for path in files]
    if arguments.json:
        say_json({"command": "score", **summary(found), "files": names})
    else:
        say("\n".join([*in_short(found), *found.notes, f"open {names[-1]} in a browser; all files are in {folder}"]))
    return SOME_FAILED if found.failed else DONE


def _sources(arguments: argparse.Namespace, listed: dict[Path, Labels]) -> tuple[dict[str, list], list]:
    """Paths of each model's takes and of the references, from the words or from the list's groups."""
    models: dict[str, list] = {}
    if arguments.takes:
        models[_model_name(arguments.takes)] = list(arguments.takes)
    for name, path in arguments.model:
        models.setdefault(name, []).append(path)
    references = list(arguments.reference)
    if listed and not models and not references:
        for path, labels in listed.items():
            if labels.group is None:
                raise InputError(
                    f"expected a group for each take in {arguments.list}, 'real' or the name of a model, as no MODEL "
                    f"and no --reference are given; {path.name} has none"
                )
            if labels.group.lower() in REFERENCE_GROUPS:
                references.append(path)
            else:
                models.setdefault(labels.group, []).append(path)
    if not references:
        raise InputError("expected real takes after --reference, got none; there is nothing to score against")
    if not models:
        raise InputError("expected a model's takes in front of --reference, or with --model NAME=PATH, got none")
    return models, references


def _model_name(paths: list[str]) -> str:
    """The folder's name where one is given, else 'model'."""
    folders = [Path(path) for path in paths if Path(path).is_dir()]
    return folders[0].resolve().name or "model" if len(folders) == len(paths) == 1 else "model"


def _labelled(paths: Iterable, reading: dict, failed: dict, listed: dict[Path, Labels], pattern: str | None):
    """Takes with labels; those that cannot be read or labelled are named in `failed`."""
    from lipmetrics.labels import Labels, labels_of_name
    from lipmetrics.scoring import Labelled

    known = {_key(path): labels for path, labels in listed.items()}
    found: list[Labelled] = []
    for path, take in _read_all(paths, reading, failed):
        try:
            if known:
                if _key(path) not in known:
                    raise InputError(f"expected {path} in the list of takes, found no row for it")
                labels = known[_key(path)]
            else:
                labels = labels_of_name(path, pattern) if pattern else Labels()
            found.append(Labelled(take, labels, str(path)))
        except InputError as error:
            failed[str(path)] = str(error)
    return found


def _key(path: str | Path) -> str:
    from lipmetrics.labels import normal

    name = str(normal(path))
    for ending in (".frames.csv", ".openings.csv"):
        name = name.removesuffix(ending)
    return name


# -- what they share --------------------------------------------------------------------------------------------------


def _read_all(paths: Iterable, reading: dict, failed: dict[str, str]) -> list[tuple[Path, Take]]:
    """All takes that the paths name, with unlike names; one that cannot be read is named in `failed`."""
    from lipmetrics.takes import read_take, take_paths

    every = list(dict.fromkeys(one for path in paths for one in take_paths(path)))
    found = []
    for path in every:
        try:
            found.append((path, read_take(path, **reading)))
        except Exception as error:
            if len(every) == 1 and not isinstance(error, InputError | OSError | MemoryError):
                raise  # a fault of ours: show where
            failed[str(path)] = sentence(error)
    takes = _distinct([take for _, take in found], [path for path, _ in found])
    return [(path, take) for (path, _), take in zip(found, takes, strict=True)]


def _distinct(takes: list, paths: list) -> list:
    """Takes of one name get their folder's before it, then a number."""
    from dataclasses import replace

    names = [take.name for take in takes]
    if len(set(names)) < len(names):
        folders = [Path(path).resolve().parent.name for path in paths]
        takes = [
            replace(take, name=f"{folder}/{take.name}") if names.count(take.name) > 1 else take
            for take, folder in zip(takes, folders, strict=True)
        ]
    seen: dict[str, int] = {}
    for k, take in enumerate(takes):
        seen[take.name] = seen.get(take.name, 0) + 1
        if seen[take.name] > 1:
            takes[k] = replace(take, name=f"{take.name} ({seen[take.name]})")
    return takes


def _reading(arguments: argparse.Namespace, folder: Path) -> dict:
    """What `read_take` needs; videos are measured once and kept in `folder`/measured."""
    return {
        "unit": arguments.unit,
        "fps": arguments.fps,
        "lip_loop": arguments.lip_loop,
        "mouth_width": arguments.mouth_width,
        "video": arguments.video,
        "work_folder": folder / "measured",
        "progress": sys.stderr.isatty(),
    }


def _curves(arguments: argparse.Namespace) -> dict:
    """Settings of the comparison that were given; the others keep the library's defaults."""
    given = {"rate_hz": arguments.rate}
    if arguments.channels:
        given["channels"] = tuple(name.strip() for name in arguments.channels.split(","))
    if getattr(arguments, "cost", None):
        given["cost"] = arguments.cost
    if arguments.band is not _DEFAULT:
        given["band"] = arguments.band
    return given


def _tell(failed: dict[str, str]) -> None:
    for name, why in failed.items():
        complain(f"{name}: {why}; passed over")


class _progress:
    """A bar of pairs where somebody watches."""

    def __enter__(self):
        self.bar = None
        return self.step if sys.stderr.isatty() else None

    def step(self, done: int, of: int) -> None:
        if self.bar is None:
            from tqdm import tqdm

            self.bar = tqdm(total=of, unit="pair", leave=False)
        self.bar.update(done - self.bar.n)

    def __exit__(self, *_) -> None:
        if self.bar is not None:
            self.bar.close()


def _named_path(text: str) -> tuple[str, str]:
    name, equals, path = text.partition("=")
    if not (name.strip() and equals and path):
        raise argparse.ArgumentTypeError(f"expected NAME=PATH such as mine=clips/, got '{text}'")
    return name.strip(), path


def _band(text: str):
    if text == "none":
        return None
    try:
        share = float(text)
    except ValueError:
        share = -1.0
    if not 0 <= share <= 1:
        raise argparse.ArgumentTypeError(f"expected a share from 0 to 1 such as 0.1, or none, got '{text}'")
    return share


def _whole(text: str) -> int:
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 0, got '{text}'")
    return int(text)
