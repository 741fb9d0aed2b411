import json
import re

import pandas as pd
import pytest
import ring_mouth
from simulated_clips import HEIGHTS, facts, film

from lipmetrics import cli, detect
from lipmetrics import validate as validating
from lipmetrics.errors import InputError
from lipmetrics.validate import BATCH, _batches, code_hash, score_batch, validate

FILES = ["clips.csv", "conditions.csv", "frames.csv", "height_error.png", "report.html", "summary.json", "worst.png"]


@pytest.fixture
def here(monkeypatch):
    """Work is done in this process, by a method that sees what it is told: heights of 10, 0 and no mouth in turn."""
    monkeypatch.setitem(detect.METHODS, "default", "ring_mouth")

    def work(batches, film, folder, method, scores, jobs, progress):
        done = validating._Work({}, {}, 0.0)
        for batch in batches:
            failed, reason, spent_s = score_batch(
                batch, film, folder / "clips", method, [scores[o.clip] for o in batch]
            )
            done.failed |= failed
            done.dropped |= {one.clip: reason for one in batch if reason}
            done.processor_s += spent_s
        return done

    monkeypatch.setattr(validating, "_work", work)


def films(folder):
    path = folder / "clips" / "films.txt"
    return path.read_text().split() if path.exists() else []


def test_a_report_of_simulated_clips(here, tmp_path):
    clips = [facts("one"), facts("two", "noise", "3 %"), facts("three", "noise", "3 %", "impossible")]
    summary = validate(clips, film, tmp_path, facts={"part": "test"})
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == FILES
    assert (summary["clips"], summary["frames"], summary["failed"]) == (2, 2 * len(HEIGHTS), {})
    assert summary["dropped"] == {"three": "energy growth at 0.1 s"}
    frames = pd.read_csv(tmp_path / "frames.csv")
    assert frames["clip"].tolist() == ["one"] * 6 + ["two"] * 6
    assert frames["kind"].tolist()[:6] == ["closed"] * 2 + ["open"] * 4
    assert frames["status"].tolist()[:6] == ["open", "closed", "no_mouth"] * 2
    conditions = pd.read_csv(tmp_path / "conditions.csv").set_index("condition")
    assert conditions.loc["noise: 3 %", "verdict"] == "not to be used"
    assert conditions.loc["plain", "false_percent"] == 50 and conditions.loc["plain", "missed_percent"] == 75
    told = json.loads((tmp_path / "summary.json").read_text())
    assert told["targets"] and told["figures"]["frames_open"] == 8 and told["facts"] == {"part": "test"}
    assert len(pd.read_csv(tmp_path / "clips.csv")) == 2


def test_the_page_holds_everything_itself(here, tmp_path):
    validate([facts("one"), facts("two", "noise", "<3 %>")], film, tmp_path, facts={"part": "a <test>"})
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 2 and "a &lt;test&gt;" in page and "noise: &lt;3 %&gt;" in page
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    assert page.count("<table>") == page.count("</table>") >= 6 and "not to be used" in page


def test_nothing_is_done_twice(here, tmp_path):
    clips = [facts("one"), facts("two", take="run")]
    first = validate(clips[:1], film, tmp_path)
    both = validate(clips, film, tmp_path)
    assert films(tmp_path) == ["one", "two"]
    assert (first["clips_made_and_measured"], both["clips_made_and_measured"]) == (1, 1)
    again = validate(clips, film, tmp_path)
    assert again["clips_made_and_measured"] == 0 and again["figures"] == pytest.approx(both["figures"], nan_ok=True)
    (score,) = (tmp_path / "scored").glob("one.*")
    score.unlink()  # its clip is still there
    validate(clips, film, tmp_path)
    assert films(tmp_path) == ["one", "two"]


def test_another_method_has_a_report_of_its_own_of_the_same_clips(here, tmp_path):
    validate([facts("one")], film, tmp_path)
    before = (tmp_path / "report.html").read_bytes()
    validate([facts("one")], film, tmp_path, method="thesis")
    assert films(tmp_path) == ["one"] and (tmp_path / "thesis" / "report.html").exists()
    assert (tmp_path / "report.html").read_bytes() == before
    assert json.loads((tmp_path / "thesis" / "summary.json").read_text())["method"] == "thesis"


def test_the_same_clips_give_the_same_tables(here, tmp_path):
    for name in ("a", "b"):
        validate([facts("one"), facts("two", "noise", "3 %")], film, tmp_path / name)
    for file in ("frames.csv", "clips.csv", "conditions.csv", "worst.png", "height_error.png"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_a_method_that_breaks_is_named_and_the_rest_goes_on(here, tmp_path, monkeypatch):
    class Breaks(ring_mouth._Script):
        seen = 0

        def look(self, frame):
            Breaks.seen += 1
            if Breaks.seen == 3:
                raise ZeroDivisionError("no width")
            return super().look(frame)

    monkeypatch.setattr(ring_mouth, "make_detector", lambda settings, info: Breaks(settings))
    summary = validate([facts("one"), facts("two")], film, tmp_path)
    assert summary["failed"] == {"one": "unexpected ZeroDivisionError: no width"} and summary["clips"] == 1
    broken = next(row for row in summary["targets"] if "breaks" in row["what"])
    assert broken["all"] == "1" and broken["met"] is False


def test_clips_that_cannot_be_made_at_all(here, tmp_path):
    with pytest.raises(InputError, match=r"expected a clip that can be scored, got none: energy growth at 0\.1 s"):
        validate([facts("one", take="impossible")], film, tmp_path)


def test_an_unknown_method(tmp_path):
    with pytest.raises(InputError, match="expected a method out of default, thesis, got 'thesys'; did you mean"):
        validate([facts("one")], film, tmp_path, method="thesys")
    assert not list(tmp_path.iterdir())


def test_scores_that_were_damaged(here, tmp_path):
    validate([facts("one")], film, tmp_path)
    (score,) = (tmp_path / "scored").iterdir()
    score.write_bytes(b"")
    with pytest.raises(InputError, match=r"expected the scores .*one.*delete them"):
        validate([facts("one")], film, tmp_path)


def test_batches_are_of_one_movement_and_the_largest_come_first():
    clips = [facts(f"{take}{k}", take=take) for take, count in (("a", 1), ("b", BATCH + 2)) for k in range(count)]
    batches = _batches(clips)
    assert [len(batch) for batch in batches] == [BATCH, 2, 1]
    assert [len({one.take for one in batch}) for batch in batches] == [1, 1, 1]


def test_the_code_of_a_score_is_that_which_it_depends_on():
    assert code_hash() == code_hash() and len(code_hash()) == 12


@pytest.mark.slow
def test_in_processes_of_their_own(tmp_path):
    clips = [facts("one"), facts("two", take="run"), facts("three", take="impossible")]
    summary = validate(clips, film, tmp_path, method="thesis", jobs=2)
    assert summary["clips"] == 2 and list(summary["dropped"]) == ["three"] and summary["processor_seconds"] > 0
    assert sorted(films(tmp_path)) == ["one", "two"]


# -- the command ------------------------------------------------------------------------------------------------------


def test_the_command(tmp_path, capsys, monkeypatch):
    asked = {}

    def validated(clips, film, folder, **how):
        asked.update(how, clips=clips, film=film, folder=folder)
        return {"failed": {}, "text": ["fine"], "clips": len(clips)}

    monkeypatch.setattr(validating, "validate", validated)
    words = ["validate", "-o", str(tmp_path / "out"), "--only", "beard, noise: 6 %", "--part", "tune", "--jobs", "3"]
    assert cli.main(words) == cli.DONE
    assert capsys.readouterr().out == "fine\n"
    assert {one.condition for one in asked["clips"]} == {"beard: light", "beard: medium", "beard: full", "noise: 6 %"}
    assert (asked["method"], asked["jobs"], asked["folder"]) == ("default", 3, tmp_path / "out")
    assert asked["facts"]["part"] == "tune, only beard, noise: 6 %"
    assert len({one.key for one in asked["clips"]}) == len(asked["clips"]) == 24
    assert cli.main([*words, "--json"]) == cli.DONE
    assert json.loads(capsys.readouterr().out) == {"command": "validate", "failed": {}, "clips": 24}


@pytest.mark.parametrize(
    "words, sentence",
    [
        (["--part", "reprot"], "expected a part of tune or report, got 'reprot'; did you mean 'report'?"),
        (["--only", "beerd"], "did you mean 'beard'?"),
        (["--method", "thesys"], "did you mean 'thesis'?"),
        (["-o", "{taken}"], "expected an output folder to write to"),
        (["--jobs", "0"], "expected a whole number of at least 1, got '0'"),
        (["--seed", "-1"], "expected a whole number of at least 0, got '-1'"),
    ],
)
def test_the_command_refuses(words, sentence, tmp_path, capsys):
    taken = tmp_path / "taken"
    taken.touch()
    words = [word.format(taken=taken) for word in words]
    out = [] if "-o" in words else ["-o", str(tmp_path / "out")]
    try:
        code = cli.main(["validate", *out, *words])
    except SystemExit as left:
        code = left.code
    assert code == cli.BAD_INPUT
    error = capsys.readouterr().err
    assert sentence in error and error.count("\n") == 1
