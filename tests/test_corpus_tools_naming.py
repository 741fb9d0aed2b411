"""Names and templates: round trips, refusals with their reasons, and ambiguity against a search of all names."""

import itertools
import pickle
import re

import numpy as np
import pytest

from corpus_tools.naming import TAKE, THESIS_ACTIONS, THESIS_CODE, Template, _read
from lipmetrics.errors import InputError


def test_the_codes_of_the_thesis():
    """Table 5.1, and of beside fs; all 6 x 4 x 2 codes and no other reading of them."""
    assert THESIS_CODE.parse("of10a") == {"action": "of", "stickiness": 10, "audio": "a"}
    assert THESIS_CODE.parse("pu0") == {"action": "pu", "stickiness": 0, "audio": None}
    codes = [f"{a}{s}{x}" for a in THESIS_ACTIONS for s in (0, 4, 7, 10) for x in ("", "a")]
    assert len(codes) == 7 * 4 * 2
    for code in codes:
        fields = THESIS_CODE.parse(code)
        assert THESIS_CODE.format(**fields) == code and f"{fields['action']}{fields['stickiness']}" in code
    for code in ("", "os", "os1", "os04", "p4b", "x4", "os4aa", " os4", "OS4", "u4"):
        with pytest.raises(InputError, match="names follow"):
            THESIS_CODE.parse(code)


@pytest.mark.parametrize(
    ("text", "name", "fields"),
    [
        (
            "{speaker}_{utterance}_{repeat:d}",
            "p01_open-slow_3",
            {"speaker": "p01", "utterance": "open-slow", "repeat": 3},
        ),
        ("{speaker}_{repeat:d}", "Zoë K. 2-a_0", {"speaker": "Zoë K. 2-a", "repeat": 0}),
        ("{a:word}-{b:letters}", "a1-b", {"a": "a1", "b": "b"}),
        ("x{a:03d}", "x007", {"a": 7}),
        ("x{a:03d}", "x1234", {"a": 1234}),
        ("{a:number}s", "0.25s", {"a": 0.25}),
        ("{a:number}s", "10s", {"a": 10.0}),
        ("{a:1..12}", "10", {"a": 10}),
        ("Actor_{a:01..24}/{b:1..2}-{a}", "Actor_07/2-07", {"a": 7, "b": 2}),
        ("{a:one|only}", "only", {"a": "only"}),
        ("{a}[_{b:d}-{c:d}]", "x", {"a": "x", "b": None, "c": None}),
        ("{a}[_{b:d}-{c:d}]", "x_1-2", {"a": "x", "b": 1, "c": 2}),
        ("[{a:d}]x", "x", {"a": None}),
        ("{a}_[{b:d}][x{c:d}]_", "a_x1_", {"a": "a", "b": None, "c": 1}),
        ("{{{a:d}}}[[{b:d}]]", "{1}[2]", {"a": 1, "b": 2}),
    ],
)
def test_round_trips(text, name, fields):
    template = Template(text)
    assert template.parse(name) == fields and list(template.fields) == list(fields)
    assert template.format(**fields) == name and template.matches(name)
    assert template.parse(template.example()) and pickle.loads(pickle.dumps(template)) == template


@pytest.mark.parametrize(
    ("text", "name", "reason"),
    [
        (TAKE.text, "p01_m", "expected text without _ or / for utterance or '_' after 'p01_m', got the end"),
        (TAKE.text, "p01_m_x", "expected a whole number for repeat after 'p01_m_', got 'x'"),
        (TAKE.text, "p01__1", "expected text without _ or / for utterance after 'p01_', got '_1'"),
        (TAKE.text, "p01_m_01", "expected the end after 'p01_m_0', got '1'"),
        (TAKE.text, "p01_m_1_2", "expected a whole number for repeat or the end after 'p01_m_1', got '_2'"),
        ("{speaker}_{level:0|4|7|10}", "a_5", "expected 0, 4, 7 or 10 for level after 'a_', got '5'"),
        ("{speaker}_{level:0|4|7|10}", "a_1", "expected 0, 4, 7 or 10 for level after 'a_1', got the end"),
        ("{a:02d}x", "7x", "expected a whole number filled with zeros to 2 digits for a after '7', got 'x'"),
        ("{a:02d}x", "007x", "expected 'x' after '00', got '7x'"),
        ("{a:number}", "1.50", "expected a number such as 7 or 0.25 for a after '1.50', got the end"),
        ("{a:number}", "007", "got '07'"),
        ("{a:number}", "0.1234567890123456789", "expected a as a number such as 7 or 0.25, got '0.123456789"),
        ("{a:letters}.{b:d}", "a.", "expected a whole number for b after 'a.', got the end"),
        ("{a}/{b}", "../x", "expected text without _ or / for a at the start, got '../x'"),
        ("{a}/{b}", "a/b:c", "got ':c'"),
        ("{a}", "a.", "after 'a.', got the end"),
        ("{a}", "a\nb", "after 'a', got "),
        ("{a:d}/{a}", "1/2", "expected a to be the same everywhere in a name, got '1' and '2'"),
        ("{a:1..5}", "6", "expected 1 to 5 for a at the start, got '6'"),
        ("{a:letters}{b:d}", "٣", "expected letters for a at the start, got '٣'"),
        ("{a:letters}{b:d}", "a٣", "got '٣'"),
        ("{a}", "x" * 1001, "expected a name of at most 1000 characters, got 1001"),
    ],
)
def test_misfits_are_told(text, name, reason):
    with pytest.raises(InputError, match=re.escape(reason)) as refused:
        Template(text).parse(name)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"speaker": "a", "utterance": "m"}, "expected a value for repeat, got none"),
        ({"speaker": "a", "utterance": "m", "repeat": None}, "expected a value for repeat, got none"),
        ({"speaker": "a_b", "utterance": "m", "repeat": 1}, "expected speaker as text without _ or /, got 'a_b'"),
        ({"speaker": "", "utterance": "m", "repeat": 1}, "expected speaker as text"),
        ({"speaker": 1, "utterance": "m", "repeat": 1}, "expected speaker as text without _ or /, got 1"),
        ({"speaker": "a", "utterance": "m", "repeat": "1"}, "expected repeat as a whole number, got '1'"),
        ({"speaker": "a", "utterance": "m", "repeat": 1.0}, "expected repeat as a whole number, got 1.0"),
        ({"speaker": "a", "utterance": "m", "repeat": True}, "expected repeat as a whole number, got True"),
        ({"speaker": "a", "utterance": "m", "repeat": -1}, "expected repeat as a whole number, got -1"),
        ({"speaker": "a", "utterance": "m", "repeats": 1}, "got 'repeats'; did you mean 'repeat'?"),
        ({"speaker": "a" * 999, "utterance": "m", "repeat": 1}, "at most 1000 characters"),
    ],
)
def test_fields_that_no_name_can_say(fields, reason):
    with pytest.raises(InputError, match=re.escape(reason)):
        TAKE.format(**fields)


def test_values_of_arrays_and_numbers():
    template = Template("{level:0|4|7|10}_{a:number}_{b:02d}")
    assert template.format(level=np.int64(7), a=np.float32(0.5), b=np.int16(3)) == "7_0.5_03"
    assert template.format(level=7, a=2, b=30) == "7_2_30"
    for value in (0.1, 1e-9, 1 / 3, 123456789.0, 1e20, 5e-324, 1.7e308):
        name = Template("x{a:number}").format(a=value)
        assert "e" not in name and Template("x{a:number}").parse(name) == {"a": value}
    for bad in (np.nan, np.inf, -1.0, "1", True):
        with pytest.raises(InputError, match="expected a as a number"):
            Template("x{a:number}").format(a=bad)
    for bad in (5, False, 7.0, "7", None):
        with pytest.raises(InputError, match=f"expected (level as 0, 4, 7 or 10, got {bad!r}|a value for level)"):
            template.format(level=bad, a=1, b=1)


# -- ten thousand names ------------------------------------------------------------------------------------------------

TEMPLATES = [
    "{speaker}_{utterance}_{repeat:d}",
    "{action:os|of|fs|p|m|pu|mu}{stickiness:0|4|7|10}[{audio:a}]",
    "Actor_{actor:01..24}/{modality:01..03}-{emotion:1..8}-{actor}",
    "{speaker:word}[-{view:left_30|left|front}]_{take:03d}",
    "{a:letters}{b:d}[_{c:number}][x{d:02d}]",
]
SIGNS = list("aZé09._- xpuosm/4107{}\n٣")


def plain_pattern(text):
    """The same language by a regular expression written by hand, and how a value is read: slow, plain, independent."""
    free = r"(?:(?![_/\\:*?\"<>|. ])[ -~é٣])(?:(?:(?![_/\\:*?\"<>|])[ -~é٣])*(?![_/\\:*?\"<>|. ])[ -~é٣])?"
    whole, number = r"(?:0|[1-9][0-9]*)", r"(?:0|[1-9][0-9]*)(?:\.[0-9]*[1-9])?"
    letters, actor = r"[A-Za-zé]+", "(?:0[1-9]|1[0-9]|2[0-4])"
    return [
        rf"(?P<speaker>{free})_(?P<utterance>{free})_(?P<repeat>{whole})",
        r"(?P<action>os|of|fs|pu|mu|p|m)(?P<stickiness>0|4|7|10)(?P<audio>a)?",
        rf"Actor_(?P<actor>{actor})/(?P<modality>0[1-3])-(?P<emotion>[1-8])-(?P=actor)",
        r"(?P<speaker>[A-Za-zé0-9]+)(?:-(?P<view>left_30|left|front))?_(?P<take>[0-9]{3}|[1-9][0-9]{3,})",
        rf"(?P<a>{letters})(?P<b>{whole})(?:_(?P<c>{number}))?(?:x(?P<d>[0-9]{{2}}|[1-9][0-9]{{2,}}))?",
    ][TEMPLATES.index(text)]


def random_name(rng, template):
    """Valid fields, formatted; half of the time then changed in one place or two."""

    def pick(ways):
        return ways[rng.integers(len(ways))]

    def word(signs):
        return "".join(pick(signs) for _ in range(rng.integers(1, 6)))

    values = {
        "speaker": lambda: word("aZé09"),
        "utterance": lambda: pick(["m", "open-slow", "a b", "x.y", "puppy"]),
        "repeat": lambda: int(rng.integers(0, 200)),
        "action": lambda: pick(["os", "of", "fs", "p", "m", "pu", "mu"]),
        "stickiness": lambda: pick([0, 4, 7, 10]),
        "audio": lambda: pick(["a", None]),
        "actor": lambda: int(rng.integers(1, 25)),
        "modality": lambda: int(rng.integers(1, 4)),
        "emotion": lambda: int(rng.integers(1, 9)),
        "view": lambda: pick(["left_30", "left", "front", None]),
        "take": lambda: int(rng.integers(0, 2000)),
        "a": lambda: word("aZé"),
        "b": lambda: int(rng.integers(0, 2000)),
        "c": lambda: pick([None, 0.0, 0.5, 12.25, 100.0]),
        "d": lambda: pick([None, 3, 40, 120]),
    }
    fields = {field: values[field]() for field in template.fields}
    name = template.format(**fields)
    parsed = template.parse(name)
    assert parsed == fields and template.format(**parsed) == name
    signs = list(name)
    for _ in range(rng.integers(1, 3) if rng.random() < 0.6 else 0):
        at, sign = rng.integers(0, len(signs) + 1), pick(SIGNS)
        how = rng.integers(0, 3)
        signs[at : at + (how > 0)] = [sign] if how < 2 else []
    return "".join(signs)


@pytest.mark.slow
def test_ten_thousand_names_come_back_or_are_refused():
    rng = np.random.default_rng(20)
    valid_n = refused_n = 0
    for text in TEMPLATES:
        template, pattern = Template(text), re.compile(plain_pattern(text))
        for _ in range(2000):
            name = random_name(rng, template)
            plain = pattern.fullmatch(name)
            if plain is None:
                refused_n += 1
                with pytest.raises(InputError, match=r"^expected ") as refused:
                    template.parse(name)
                reason = str(refused.value)
                assert ", got " in reason and "\n" not in reason
                assert any(field in reason.split("names follow")[0] for field in (*template.fields, "'", "the end"))
            else:
                valid_n += 1
                fields = template.parse(name)
                assert template.format(**fields) == name
                assert {k: None if v is None else k for k, v in fields.items()} == {
                    k: None if v is None else k for k, v in plain.groupdict().items()
                }
                for field, piece in plain.groupdict().items():
                    value = fields[field]
                    assert value is None or value == (piece if isinstance(value, str) else float(piece))
    assert valid_n + refused_n == 10_000 and min(valid_n, refused_n) > 3000


# -- templates ---------------------------------------------------------------------------------------------------------


def readings(template, name):
    """All ways to divide a name among the parts of a template, by trying every division."""

    def fits(kind, piece):
        state = 0
        for sign in piece:
            state = kind.step(state, sign)
            if state is None:
                return False
        return bool(piece) and kind.ends(state)

    def ways(items, rest):
        if not items:
            return 0 if rest else 1
        head, tail = items[0], items[1:]
        return sum(ways(tail, rest[n:]) for n in range(1, len(rest) + 1) if fits(head.kind, rest[:n]))

    groups = sorted({item.group for item in template._items} - {None})
    return sum(
        ways([item for item in template._items if item.group is None or item.group in chosen], name)
        for n in range(len(groups) + 1)
        for chosen in itertools.combinations(groups, n)
    )


PIECES = [
    "{%s:d}",
    "{%s:02d}",
    "{%s:letters}",
    "{%s:word}",
    "{%s:number}",
    "{%s:1..12}",
    "{%s:a|ab|b}",
    "{%s:1|11}",
    "{%s}",
]


def test_templates_are_ambiguous_exactly_where_some_short_name_is():
    """Random templates against all names of up to 4 signs, each read in every possible way."""
    rng = np.random.default_rng(3)
    names = ["".join(signs) for n in range(1, 5) for signs in itertools.product("ab1.0", repeat=n)]
    accepted_n = refused_n = 0
    for _ in range(40):
        parts = []
        for field in "xyz"[: rng.integers(2, 4)]:
            part = str(rng.choice(PIECES)) % field
            literal = str(rng.choice(["", "", "a", "1", ".", "-"]))
            parts.append(f"[{literal}{part}]" if rng.random() < 0.3 and parts else literal + part)
        text = "".join(parts)
        try:
            template = Template(text)
        except InputError as error:
            found = re.search("which reads '(.*)' in two", str(error))
            if found is None:
                continue
            refused_n += 1
            silent = object.__new__(Template)
            object.__setattr__(silent, "text", text)
            object.__setattr__(silent, "_items", _read(text))
            assert readings(silent, found[1]) >= 2, (text, found[1])
        else:
            accepted_n += 1
            assert max(readings(template, name) for name in names) <= 1, text
    assert accepted_n > 10 and refused_n > 10


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{a}{b}", "expected a template that reads every name in one way, got {a}{b}, which reads"),
        ("{a}-{b}", "reads every name in one way"),
        ("{a:word}{b:d}", "reads every name in one way"),
        ("{a:d}[x{b:d}][x{c:d}]", "which reads '0x0' in two"),
        ("[{a:d}]{b:d}", "which reads '"),
        ("", "expected a template such as {speaker}_{utterance}_{repeat:d}, got ''"),
        ("plain", "expected a template with fields such as {speaker}, got none in plain"),
        ("{a", "expected every { to be closed, got '{a' in the template {a"),
        ("a}", "expected every { to be closed, got '}'"),
        ("{a}[x{b:d}", "expected every [ to be closed"),
        ("{a}x]", "got a ] without that"),
        ("{a}[x]", "expected [ ] around one field or more"),
        ("{a}[_{b:d}[x{c:d}]]", "expected no [ inside of [ ]"),
        ("[{a}]", "expected a template with a part outside of [ ]"),
        ("{A}", "expected fields named by small letters, digits and _ such as {speaker}, got {A}"),
        ("{}", "got {}"),
        ("{a:int}", "expected a field as {name}, {name:word}"),
        ("{a:5..1}", "expected a field as"),
        ("{a:01..5}", "expected a field as"),
        ("{a:x|x}", "expected a field as"),
        ("{a:1|01}", "expected a field as"),
        ("{a:x||y}", "expected a field as"),
        ("{a:0..99999}", "expected a field as"),
        ("{a:d}-{a:word}", "expected the field a to be of one kind, got a second, {a:word}"),
        ("{a:d}[-{a:d}]", "expected the field a only inside or only outside of one [ ]"),
    ],
)  # fmt: skip
def test_bad_templates_are_refused(text, reason):
    with pytest.raises(InputError, match=re.escape(reason)) as refused:
        Template(text)
    assert "\n" not in str(refused.value)


def test_the_given_example_of_two_readings_is_one():
    with pytest.raises(InputError, match=r"which reads '.+' in two") as refused:
        Template("{a:1..12}{b:d}")
    name = re.search("which reads '(.+?)' in two", str(refused.value))[1]
    ways = [
        i
        for i in range(1, len(name))
        if 1 <= int(name[:i]) <= 12 and name[:i] == str(int(name[:i])) and name[i:] == str(int(name[i:]))
    ]
    assert len(ways) >= 2
