import dataclasses
import tomllib
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.settings import descriptions, from_table, parse_toml, read_toml, to_toml


@dataclass(frozen=True)
class Lamp:
    """A lamp.

    Parameters
    ----------
    power : what it gives,
        W
    colour : red, green, blue
    """

    power: float
    colour: tuple[float, float, float] = (1.0, 0.5, 0.25)

    def __post_init__(self):
        if self.power < 0:
            raise InputError(f"expected power of 0 or more, got {self.power}")


@dataclass(frozen=True)
class Torch:
    power: float


@dataclass(frozen=True)
class Shelf:
    """A shelf.

    Parameters
    ----------
    lamp : from left to right
    """

    lamp: tuple[Lamp, ...] = ()


@dataclass(frozen=True)
class Room:
    """A room.

    Parameters
    ----------
    title : its name
    count, seed : numbers
    step_s : s
    dark : whether it is
    keys : of a curve
    first : the first lamp
    """

    title: str = "a"
    count: int = 3
    seed: int | None = None
    step_s: float | Literal["auto"] = "auto"
    dark: bool | Literal["auto"] = "auto"
    kind: Literal["small", "large"] = "small"
    keys: tuple[tuple[float, float] | str, ...] = ()
    names: tuple[str, ...] = ("x",)
    first: Lamp = Lamp(1.0)
    shelf: Shelf = dataclasses.field(default_factory=Shelf)


def room(text):
    return from_table(Room, tomllib.loads(text), "room.toml")


def test_what_is_not_said_keeps_its_default():
    assert room("") == Room()
    assert room("count = 4\n[first]\npower = 2") == Room(count=4, first=Lamp(2.0))


def test_whole_numbers_serve_as_numbers_and_nothing_else_does():
    one = room("step_s = 2\nkeys = [[0, 1], 'linear', [1.5, 2]]")
    assert one.step_s == 2.0 and type(one.step_s) is float
    assert one.keys == ((0.0, 1.0), "linear", (1.5, 2.0)) and type(one.keys[0][0]) is float


FULL = Room(
    title='quo"ted \\ ümlaut\n\ttab \x7f \x01',
    count=-2,
    seed=7,
    step_s=1e-05,
    dark=True,
    kind="large",
    keys=((0.0, 0.1), "linear", (1 / 3, 2e22)),
    names=(),
    first=Lamp(0.1 + 0.2, (0.0, 1e-300, 5.0)),
    shelf=Shelf((Lamp(1.0), Lamp(2.0))),
)


@pytest.mark.parametrize("settings", [Room(), FULL, Room(keys=tuple((float(i), i / 7) for i in range(40)))])
def test_written_text_reads_back_equal(settings):
    assert from_table(Room, tomllib.loads(to_toml(settings)), "x") == settings


def test_random_numbers_read_back_to_the_last_bit():
    rng = np.random.default_rng(5)
    for value in (rng.standard_normal(200) * 10.0 ** rng.integers(-300, 300, 200)).tolist():
        assert from_table(Lamp, tomllib.loads(to_toml(Lamp(abs(value)))), "x").power == abs(value)


def test_every_line_has_its_comment():
    lines = to_toml(FULL).splitlines()
    assert "count = -2  # numbers" in lines and "power = 1.0  # what it gives, W" in lines
    assert lines[lines.index("[first]") - 1] == "# the first lamp"
    assert lines.count("[[shelf.lamp]]") == 2
    assert all(len(line) <= 112 for line in to_toml(Room(keys=tuple((float(i), 0.5) for i in range(40)))).splitlines())
    assert descriptions(Lamp) == {"power": "what it gives, W", "colour": "red, green, blue"}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("cuont = 3", "room.toml: expected a known key, got 'cuont'; did you mean 'count'"),
        ("xyzzy = 3", "room.toml: expected title, count, .* or shelf, got 'xyzzy'"),
        ("count = 3.0", "room.toml: expected count as a whole number, got 3.0"),
        ("count = true", "room.toml: expected count as a whole number, got true"),
        ("seed = 'a'", "expected seed as a whole number, got 'a'"),
        ("title = 3", "expected title as a text in quotes, got 3"),
        ("step_s = 'atuo'", "expected step_s as a number or 'auto', got 'atuo'"),
        ("step_s = nan", "expected step_s as a number or 'auto', got nan"),
        ("step_s = false", "expected step_s as a number or 'auto', got false"),
        ("dark = 1", "expected dark as true or false or 'auto', got 1"),
        ("kind = 'lagre'", "expected kind as 'small' or 'large', got 'lagre'; did you mean 'large'"),
        ("kind = 4", "expected kind as 'small' or 'large', got 4"),
        ("keys = 'linear'", "expected keys as a list, got 'linear'"),
        ("keys = [[0, 1], 3]", "expected item 2 of keys as a list of 2 numbers or a text in quotes, got 3"),
        ("first = 3", r"room.toml, \[first\]: expected a table of settings, got 3"),
        ("[first]\npower = inf", r"room.toml, \[first\]: expected power as a finite number, got inf"),
        ("[first]\npower = '1'", r"room.toml, \[first\]: expected power as a number, got '1'"),
        ("[first]\npower = [1]", r"room.toml, \[first\]: expected power as a number, got the list \[1\]"),
        ("[first]\npower = -1", r"room.toml, \[first\]: expected power of 0 or more, got -1.0"),
        ("[first]\ncolour = [1, 2, 3]", r"room.toml, \[first\]: expected the key 'power', got none"),
        ("[first]\npower = 1\ncolour = [1, 2]", r"expected colour as a list of 3 numbers, got the list \[1, 2\]"),
        ("[first]\npower = 1\ncolour = [1, 2, 'x']", "expected item 3 of colour as a number, got 'x'"),
        ("[[shelf.lamp]]\npower = 1\n[[shelf.lamp]]\npwoer = 1", r"room.toml, \[\[shelf.lamp\]\] 2: expected a known"),
        ("[shelf.lamp]\npower = 1", r"room.toml, \[shelf\]: expected lamp as a list of tables, got a table"),
        (f"step_s = 1{'0' * 400}", "expected step_s as a number or 'auto', got 1000"),
    ],
)
def test_what_cannot_be_used_is_one_sentence(text, sentence):
    with pytest.raises(InputError, match=sentence) as caught:
        room(text)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 250


def test_files_that_are_no_settings(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml: No such file"):
        read_toml(tmp_path / "none.toml")
    with pytest.raises(InputError, match="expected a TOML file"):
        read_toml(tmp_path)
    path = tmp_path / "room.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="it is not text"):
        read_toml(path)
    path.write_text("count = 3\n\ntitle = = 4\n")
    with pytest.raises(InputError, match=r"room\.toml: expected TOML .* line 3"):
        read_toml(path)
    path.write_text("a = " + "[" * 100_000)
    with pytest.raises(InputError, match=r"room\.toml: expected TOML"):
        read_toml(path)
    path.write_text("#" * 2_000_000)
    with pytest.raises(InputError, match="at most 1000000 bytes"):
        read_toml(path)
    path.write_text("\ufeffcount = 3", encoding="utf-8")
    assert read_toml(path) == {"count": 3}
    assert parse_toml("a = 1", "x") == {"a": 1}


def test_only_what_toml_can_hold_is_written():
    with pytest.raises(InputError, match="Lamp: expected power as a finite number, got nan"):
        to_toml(Lamp(float("nan")))
    with pytest.raises(InputError, match=r"Torch, \[first\]: expected power as a number, got 'bright'"):
        to_toml(Room(first=Torch("bright")))


def test_whole_numbers_are_written_as_the_numbers_they_stand_for():
    assert "power = 3.0 " in to_toml(Lamp(3)) and "colour = [1.0, 2.0, 3.0]" in to_toml(Lamp(3, (1, 2, 3)))
    assert to_toml(Lamp(3)) == to_toml(from_table(Lamp, tomllib.loads(to_toml(Lamp(3))), "x"))


def test_a_key_of_thousands_of_parts_is_not_read():
    with pytest.raises(InputError, match="expected TOML in lines of at most 5000 characters, got one of 100005"):
        parse_toml("a." * 50_000 + "a = 1", "a.toml")
