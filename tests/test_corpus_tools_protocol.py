"""The protocol as data, its sheet, and its prompt page as Chromium runs it.

The page is driven from inside: a script added to a copy of it presses keys at given times and writes down what the page
says; Chromium's virtual time makes minutes pass at once.
"""

import csv
import html
import io
import itertools
import json
import re
import shutil
import subprocess
import tomllib

import pytest

from corpus_tools.protocol import load_protocol, prompt_page, protocol_text, sheet_page, write_protocol
from lipmetrics.errors import InputError

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
in_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here to open the page in; install chromium")
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--window-size=1000,700",
]
SHORT = """
title = "Short </script> & <b>"
repetitions_n = 2
interval_s = 4
start_s = 1
lick_s = 2.0
clip_s = 3.0
before_s = 0.5
template = "{speaker}_{utterance}_{repeat:d}"
before = ["Sit <still>."]
utterances = [
    { utterance = "m", show = "m", how = "the sound", kind = "sound" },
    { utterance = "puppy", show = "puppy", kind = "word" },
]
[texts]
ready = "Get ready"
lick = "Lick your lips"
next = "next"
wait = "breathe"
again = "once more"
paused = "Pause"
done = "Thank you"
"""


@pytest.fixture(scope="module")
def builtin():
    return load_protocol()


@pytest.fixture
def short(tmp_path):
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    return load_protocol(path)


# -- the data ---------------------------------------------------------------------------------------------------------


def test_the_thesis_protocol(builtin):
    """Section 5.2.2 and table 5.2: 4 actions and 18 utterances, 5 repetitions, 10 s, 1,650 clips of 3 s."""
    kinds = [one.kind for one in builtin.utterances]
    counts = {"action": 4, "sound": 5, "letter": 5, "word": 5, "sentence": 3}
    assert {kind: kinds.count(kind) for kind in kinds} == counts and len(kinds) == 22
    assert (builtin.repetitions_n, builtin.interval_s, builtin.clip_s) == (5, 10, 3)
    names = builtin.names([f"p{number:02d}" for number in range(1, 16)])
    assert len(names) == len({name.lower() for name in names}) == 22 * 5 * 15 == 1650
    assert names[0] == "p01_open-slow_1" and names[-1] == "p15_sgiu4s_5"
    assert all(builtin.template.format(**builtin.template.parse(name)) == name for name in names)


def test_lips_are_licked_before_each_change(builtin):
    prompts = builtin.prompts()
    assert len(prompts) == 22 * 6
    for i in range(0, len(prompts), 6):
        lick, *cues = prompts[i : i + 6]
        assert lick.kind == "lick" and [cue.repeat for cue in cues] == [1, 2, 3, 4, 5]
        assert {cue.utterance for cue in cues} == {lick.utterance}
        times = [cue.at_s for cue in cues]
        assert times == pytest.approx([lick.at_s + builtin.lick_s + 10 * k for k in range(5)])
    assert builtin.length_s == pytest.approx(prompts[-1].at_s + 10)


def test_planned_cuts(builtin):
    cuts = builtin.cuts("p01", mark_s=7.5)
    assert len(cuts) == 110 and all(cut.stop_s - cut.start_s == pytest.approx(3) for cut in cuts)
    assert cuts[0].start_s == pytest.approx(7.5 + 10 + 6 - 0.5)
    assert all(b.start_s >= a.stop_s for a, b in itertools.pairwise(cuts))
    with pytest.raises(InputError, match="expected speaker as text without _ or /, got 'p_1'"):
        builtin.cuts("p_1")


def test_files(tmp_path, builtin):
    paths = write_protocol(tmp_path / "sheet", builtin, protocol_text(), speakers=["p01", "p02"])
    assert [path.name for path in paths] == [
        "protocol.toml",
        "sheet.html",
        "prompt.html",
        "p01.cuts.csv",
        "p02.cuts.csv",
    ]
    assert load_protocol(paths[0]) == builtin
    rows = list(csv.DictReader(paths[4].open()))
    assert len(rows) == 110
    assert rows[1] == {
        "start_s": "25.500",
        "stop_s": "28.500",
        "speaker": "p02",
        "utterance": "open-slow",
        "repeat": "2",
    }
    with pytest.raises(InputError, match="expected speaker"):
        write_protocol(tmp_path / "none", builtin, protocol_text(), speakers=["a/b"])
    assert not (tmp_path / "none").exists()


def test_the_pages_need_no_network_and_are_safe(short):
    for page in (prompt_page(short, speaker='"><script>'), sheet_page(short)):
        assert not re.findall(r"https?:|//[a-z]+\.|\bimport\b|\bfetch\b|XMLHttp|@import|src=", page)
        assert "<title>Short &lt;/script&gt; &amp; &lt;b&gt;</title>" in page
        assert "{{" not in page.replace("}}", "")
    assert prompt_page(short).count("</script>") == 2
    assert "Sit &lt;still&gt;." in sheet_page(short)


def test_the_sheet_has_a_box_for_every_repetition(builtin):
    page = sheet_page(builtin)
    assert page.count('<td class="box">') == 110
    assert "22 actions and utterances, each 5 times at 10 s, 110 clips of 3 s, 21 minutes" in page
    for one in builtin.utterances:
        assert f"<code>{one.utterance}</code>" in page and html.escape(one.show) in page


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("interval_s", "intervals_s", "got 'intervals_s'; did you mean 'interval_s'?"),
        ("interval_s = 4", "interval_s = 'x'", "expected interval_s in .* to be a number, got 'x'"),
        ("interval_s = 4", "interval_s = 2", "expected clip_s above 0 and at most interval_s, 2 s, got 3 s"),
        ("start_s = 1", "start_s = -1", "expected start_s of the protocol in seconds, 0 or more, got -1"),
        ("start_s = 1", "start_s = nan", "expected start_s of the protocol in seconds"),
        ("before_s = 0.5", "before_s = 3.5", "expected before_s to be at most clip_s"),
        ("repetitions_n = 2", "repetitions_n = 0", "expected 1 to 1000 repetitions_n, got 0"),
        ("repetitions_n = 2", "", "expected repetitions_n in .*, got none"),
        ("repetitions_n = 2", "repetitions_n = true", "to be a whole number, got True"),
        ('"puppy", show', '"M", show', "expected utterances of different names, got 'm' and 'M'"),
        ('"puppy", show', '"pup_py", show', "expected utterance as text without _ or /, got 'pup_py'"),
        ('"puppy", show', '"puppy", shows', "the 2nd of .*, got 'shows'; did you mean 'show'"),
        ("{repeat:d}", "{take:d}", "the fields speaker, utterance and repeat, got none of repeat"),
        ("{repeat:d}", "{repeat:d}_{day:d}", "expected a value for day, got none"),
        ("{repeat:d}", "{repeat:2..5}", "expected repeat as 2 to 5, got 1"),
        ("utterances = [", "utterances = []\nother = [", "got 'other'"),
        ('lick = "Lick your lips"', "lick = 3", r"expected lick in \[texts\] of .* to be text, got 3"),
        ('["Sit <still>."]', "[3]", "expected 'before' in .* to be a list of texts"),
        ("title", "title =", "expected a protocol in TOML, got .*short.toml"),
    ],
)
def test_bad_protocols_are_refused(tmp_path, old, new, sentence):
    assert old in SHORT
    path = tmp_path / "short.toml"
    path.write_text(SHORT.replace(old, new, 1))
    with pytest.raises(InputError, match=sentence) as refused:
        load_protocol(path)
    assert "\n" not in str(refused.value)


def test_no_file(tmp_path):
    with pytest.raises(InputError, match=r"expected a protocol in TOML, got .*gone\.toml: No such file"):
        load_protocol(tmp_path / "gone.toml")
    assert tomllib.loads(protocol_text())["repetitions_n"] == 5


# -- the page in the browser -------------------------------------------------------------------------------------------

DRIVER = """
<script>
const said = [];
const press = (key) => document.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
const look = (name) => said.push([name, document.body.className, at("big").textContent, at("small").textContent,
  at("count").textContent, at("where").textContent, at("left").textContent,
  at("flash").classList.contains("on")]);
const saved = [];
download = (name, text) => saved.push([name, text]);
const later = (seconds, act) => setTimeout(act, seconds * 1000);
const finish = () => {
  const pre = document.createElement("pre");
  pre.id = "result";
  pre.textContent = JSON.stringify({ said, saved, cuts: cutsCSV(), log: logCSV(), state,
    problem: at("problem").textContent, setup: !at("setup").hidden, kept: at("kept").textContent });
  document.body.append(pre);
};
STEPS
</script>
</body>"""
START = 'at("sound").checked = false; at("speaker").value = "p01"; at("setup").requestSubmit();'


def drive(tmp_path, protocol, steps, seconds, **options):
    page = tmp_path / "prompt.html"
    page.write_text(prompt_page(protocol, **options).replace("</body>", DRIVER.replace("STEPS", steps)))
    flags = [*FLAGS, f"--user-data-dir={tmp_path / 'profile'}", f"--virtual-time-budget={int(1000 * seconds)}"]
    command = [CHROMIUM, *flags, "--dump-dom", page.as_uri()]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    (found,) = re.findall(r'<pre id="result">(.*?)</pre>', run.stdout, re.DOTALL)
    return json.loads(html.unescape(found))


def table(text):
    return list(csv.DictReader(io.StringIO(text)))


@in_browser
def test_a_whole_session(tmp_path, short):
    """Every prompt at its planned time; the saved cut list is the planned one."""
    steps = START + "".join(f'later({t}, () => look("{t}"));' for t in (0.1, 0.5, 1.5, 3.05, 4, 6.5, 10.5, 12))
    steps += 'later(23.5, () => { look("end"); press("s"); finish(); });'
    result = drive(tmp_path, short, steps, 25)
    said = {line[0]: line[1:] for line in result["said"]}
    assert said["0.1"][-1] is True and said["0.5"][:4] == ["start", "Get ready", "next: m", "1"]
    assert said["0.5"][-1] is False
    assert said["1.5"][:5] == ["lick", "Lick your lips", "next: m", "2", "p01: 1 of 2"]
    assert said["3.05"][:3] == ["cue", "m", "the sound"] and said["3.05"][-1] is True
    assert said["4"][0] == "cue" and said["4"][-1] is False
    assert said["6.5"][:4] == ["wait", "m", "breathe", "1"] and said["6.5"][4] == "p01: 1 of 2, 1 of 2"
    assert said["10.5"][:4] == ["wait", "", "breathe", "1"]  # the next word comes with the lick
    assert said["12"][:3] == ["lick", "Lick your lips", "next: puppy"] and said["12"][5] == "1 minute left"
    assert said["end"][:2] == ["done", "Thank you"] and result["state"]["saved"]
    assert [name for name, _ in result["saved"]] == ["p01.cuts.csv", "p01.log.csv"]
    assert result["saved"][0][1] == result["cuts"]
    rows, planned = table(result["cuts"]), short.cuts("p01")
    assert list(rows[0]) == ["start_s", "stop_s", "speaker", "utterance", "repeat"] and len(rows) == len(planned) == 4
    for row, cut in zip(rows, planned, strict=True):
        assert float(row["start_s"]) == pytest.approx(cut.start_s, abs=0.1)
        assert float(row["stop_s"]) - float(row["start_s"]) == pytest.approx(3, abs=0.002)
        assert [row["speaker"], row["utterance"], int(row["repeat"])] == list(cut.fields.values())
    log = table(result["log"])
    expected = ["mark", "lick", "cue", "cue", "lick", "cue", "cue", "end"]
    assert [row["event"] for row in log] == expected and float(log[0]["at_s"]) < 0.05
    assert [float(row["dry_s"]) for row in log if row["event"] == "cue"] == pytest.approx([2, 6, 2, 6], abs=0.1)


@in_browser
def test_pause_repeat_start_over_and_skip(tmp_path, short):
    steps = (
        START
        + 'later(4, () => press(" ")); later(4.5, () => look("paused"));'
        + 'later(9, () => at("keys").firstElementChild.click());'  # 5 s later
        + 'later(13, () => press("r")); later(13.5, () => { press("r"); look("again"); });'  # the 2nd, at 12, once more
        + 'later(21, () => press("R")); later(22, () => look("back"));'  # in the lick after it: once more again
        # lick at 29; puppy at 31, licked for once more at 32, so at 34 again; then left at 35
        + 'later(32, () => press("l")); later(35, () => press("n")); later(36, finish);'
    )
    result = drive(tmp_path, short, steps, 38)
    said = {line[0]: line[1:] for line in result["said"]}
    assert said["paused"][:2] == ["paused", "Pause"]
    assert said["again"][:3] == ["wait", "m", "once more"] and said["back"][:3] == ["wait", "m", "once more"]
    log = table(result["log"])
    told = [(row["event"], row["utterance"], row["repeat"], row["kept"], float(row["at_s"])) for row in log]
    expected = [
        ("mark", "", "", "", 0),
        ("lick", "m", "", "", 1),
        ("cue", "m", "1", "1", 3),
        ("pause", "", "", "", 4),
        ("go on", "", "", "", 9),
        ("cue", "m", "2", "0", 12),
        ("repeat", "m", "2", "", 13),
        ("cue", "m", "2", "0", 16),
        ("lick", "puppy", "", "", 20),
        ("repeat", "m", "2", "", 21),
        ("cue", "m", "2", "1", 25),
        ("lick", "puppy", "", "", 29),
        ("cue", "puppy", "1", "0", 31),
        ("start over", "puppy", "", "", 32),
        ("lick", "puppy", "", "", 32),
        ("cue", "puppy", "1", "1", 34),
        ("skip", "puppy", "", "", 35),
        ("end", "", "", "", 35),
    ]
    assert [one[:4] for one in told] == [one[:4] for one in expected]
    assert [one[4] for one in told] == pytest.approx([one[4] for one in expected], abs=0.1)
    kept = [(row["utterance"], row["repeat"], float(row["start_s"])) for row in table(result["cuts"])]
    assert [one[:2] for one in kept] == [("m", "1"), ("m", "2"), ("puppy", "1")]
    assert [one[2] for one in kept] == pytest.approx([2.5, 24.5, 33.5], abs=0.1)


@in_browser
def test_a_bad_speaker_is_refused_and_a_session_survives_a_reload(tmp_path, short):
    steps = 'at("speaker").value = "a_b"; at("setup").requestSubmit(); press(" "); later(0.5, finish);'
    result = drive(tmp_path, short, steps, 1)
    assert result["setup"] and result["log"].count("\n") == 1
    assert result["problem"] == 'Expected a short name of the speaker without spaces, _ and /, got "a_b"'
    steps = (
        'if (sessionStorage.getItem("again")) { at("kept").firstElementChild.click(); later(0.2, finish); } else {'
        f'sessionStorage.setItem("again", 1); {START} later(4, () => {{ state.saved = true; location.reload(); }}); }}'
    )
    result = drive(tmp_path, short, steps, 6)
    assert result["setup"] and result["kept"] == "Save the last session of this browser: p01, 1 prompts"
    assert [name for name, _ in result["saved"]] == ["p01.cuts.csv", "p01.log.csv"]
    assert table(result["saved"][0][1])[0]["utterance"] == "m"


@pytest.mark.parametrize("text", ["a = " + "[" * 20_000, "a = " + "9" * 4900, "a." * 50_000 + "a = 1"])
def test_a_protocol_that_no_reader_of_toml_bears(tmp_path, text):
    (tmp_path / "p.toml").write_text(text)
    with pytest.raises(InputError, match="expected a protocol in TOML"):
        load_protocol(tmp_path / "p.toml")
