"""Names of clips by one template: `parse` takes a name apart, `format` makes it, and the two are exact inverses.

A template is text with fields in braces:

    {speaker}_{utterance}_{repeat:d}
    {action:os|of|p}{stickiness:0|4|7|10}[{audio:a}]
    Actor_{actor:01..24}/{modality:01..03}-{actor}

| field          | takes                                                                     | gives  |
|----------------|---------------------------------------------------------------------------|--------|
| `{a}`          | one or more characters, but none of `_/\\:*?"<>|`, no dot or space at ends | text   |
| `{a:word}`     | letters and digits                                                        | text   |
| `{a:letters}`  | letters                                                                   | text   |
| `{a:d}`        | whole number without leading zeros; `{a:03d}` filled with zeros to 3      | int    |
| `{a:number}`   | whole or decimal number such as 7 or 0.25, no zeros that could be left out | float  |
| `{a:1..5}`     | whole number of a range; `{a:01..24}` filled with zeros                   | int    |
| `{a:os|of|p}`  | one of these (a single one only in `[ ]`); whole numbers where all are    | text, int |

What stands in `[ ]` may be missing as a whole, its fields are then None. A field that comes again must be the same
again. `{{ }} [[ ]]` stand for the signs themselves.

A template that could read some name in two ways is refused when it is made, with such a name: the template is a chain
of small automata, one a field, and the product of the chain with itself is searched for a name with two ways through
(Book et al. 1971, Ambiguity in graphs and expressions, IEEE Trans. Computers C-20). So there is no greedy or lazy:
a name has one reading or none.
"""

from __future__ import annotations

import dataclasses
import math
import operator
import re
from collections import deque
from decimal import Decimal

from corpus_tools.wording import choices, nearest, short
from lipmetrics.errors import InputError

LONGEST_N = 1000  # characters of a name: longer than any path of a file
MOST_WAYS_N = 1000  # alternatives of a field
NOT_IN_NAMES = set('_/\\:*?"<>|')
DIGITS = "0123456789"

Value = str | int | float | None


@dataclasses.dataclass(frozen=True)
class Template:
    """A pattern that names follow, and the two ways through it.

    Parameters
    ----------
    text : the pattern, as the module's text says

    Raises
    ------
    InputError : the pattern cannot be read, or reads some name in two ways
    """

    text: str
    _items: tuple = dataclasses.field(init=False, repr=False, compare=False)

    def __post_init__(self):
        object.__setattr__(self, "_items", _read(self.text))
        _refuse_two_ways(self)

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the fields in order."""
        return tuple(dict.fromkeys(item.field for item in self._items if item.field))

    def example(self, **fields: Value) -> str:
        """A name that fits, with these values where given."""
        return "".join(
            item.kind.write(fields[item.field]) if fields.get(item.field) is not None else item.kind.example
            for item in self._items
        )

    def matches(self, name: str) -> bool:
        """Whether `parse` takes the name."""
        try:
            self.parse(name)
        except InputError:
            return False
        return True

    def parse(self, name: str) -> dict[str, Value]:
        """Take a name apart; `format(**parse(name)) == name`.

        Parameters
        ----------
        name : without the ending of the file; folders, where the template has some, divided by `/`

        Returns
        -------
        fields : value by name of the field, in order; None for those of a part that is missing

        Raises
        ------
        InputError : the name does not fit: which field, what was expected there, and what came
        """
        if len(name) > LONGEST_N:
            raise InputError(f"expected a name of at most {LONGEST_N} characters, got {len(name)}: {short(name)}")
        live = {(-1, 0): ()}  # state: item of each character so far
        for i, sign in enumerate(name):
            after = {
                state: (*way, state[0]) for before, way in live.items() for state in _steps(self._items, before, sign)
            }
            if not after:
                raise InputError(self._misfit(name, i, live))
            live = after
        ways = [way for state, way in live.items() if _may_end(self._items, state)]
        if not ways:
            raise InputError(self._misfit(name, len(name), live))
        fields: dict[str, Value] = dict.fromkeys(self.fields)
        for i, item in enumerate(self._items):
            piece = "".join(sign for sign, owner in zip(name, ways[0], strict=True) if owner == i)
            if not item.field or not piece:
                continue
            value = item.kind.read(piece)
            if value is None:
                raise InputError(f"expected {item.field} as {item.kind.says}, got '{short(piece)}' in '{short(name)}'")
            if fields[item.field] is not None and fields[item.field] != value:
                raise InputError(
                    f"expected {item.field} to be the same everywhere in a name, got '{fields[item.field]}' and "
                    f"'{value}' in '{short(name)}'"
                )
            fields[item.field] = value
        return fields

    def format(self, **fields: Value) -> str:
        """Make the name of these fields; `parse(format(**fields)) == fields`.

        Raises
        ------
        InputError : a field is missing, unknown, or has a value that no name can say
        """
        for field in fields:
            if field not in self.fields:
                raise InputError(f"expected the fields {', '.join(self.fields)}, got {nearest(field, self.fields)}")
        given = {field: value for field, value in fields.items() if value is not None}
        left_out = {
            group
            for group in {item.group for item in self._items} - {None}
            if not any(item.field in given for item in self._items if item.group == group)
        }
        pieces = []
        for item in self._items:
            if item.group in left_out:
                continue
            if item.field and item.field not in given:
                raise InputError(f"expected a value for {item.field}, got none, for a name of {self.text}")
            try:
                pieces.append(item.kind.write(given[item.field] if item.field else item.kind.example))
            except (TypeError, ValueError):
                raise InputError(
                    f"expected {item.field} as {item.kind.says}, got {short(repr(given[item.field]))}, for a name of "
                    f"{self.text}"
                ) from None
        name = "".join(pieces)
        if len(name) > LONGEST_N:
            raise InputError(f"expected a name of at most {LONGEST_N} characters, got {len(name)}: {short(name)}")
        return name

    def _misfit(self, name: str, i: int, live: dict) -> str:
        """Where the name leaves the template: the fields that could have gone on there."""
        expected = []
        for index, state in sorted(live):
            item = self._items[index]
            inside = index >= 0 and bool(item.kind.may_go_on(state))
            if inside:
                expected.append(f"{item.kind.says} for {item.field}" if item.field else item.kind.says)
            if index < 0 or item.kind.ends(state):
                for j in _followers(self._items, index):
                    after = self._items[j]
                    expected.append(f"{after.kind.says} for {after.field}" if after.field else after.kind.says)
                if _may_end(self._items, (index, state)):
                    expected.append("the end")
        came = f"'{short(name[i:])}'" if i < len(name) else "the end"
        where = f"after '{short(name[:i])}'" if i else "at the start"
        return (
            f"expected {choices(dict.fromkeys(expected))} {where}, got {came} in '{short(name)}'; "
            f"names follow {self.text}, such as {self.example()}"
        )


# -- kinds of fields: small automata; state 0 has read nothing, and no state reads one sign in two ways ----------------


@dataclasses.dataclass(frozen=True)
class _Text:
    """Free text of some set of characters; state 1 may end, state 2 (after a dot or space) may not."""

    says: str
    example: str
    signs: str  # "any", "word" or "letters"

    def step(self, state: int, sign: str) -> int | None:
        if self.signs == "any":
            if sign in ". ":
                return 2 if state else None
            return 1 if sign.isprintable() and sign not in NOT_IN_NAMES else None
        return 1 if sign.isalpha() or (self.signs == "word" and sign in DIGITS) else None

    def ends(self, state: int) -> bool:
        return state == 1

    def may_go_on(self, state: int) -> bool:
        return True

    def read(self, piece: str) -> str:
        return piece

    def write(self, value) -> str:
        return _accepted(self, str.__str__(value))


@dataclasses.dataclass(frozen=True)
class _Whole:
    """A whole number of at least `digits_n` digits, filled with zeros; the state counts them, negative after a zero."""

    digits_n: int

    @property
    def says(self) -> str:
        return "a whole number" + (f" filled with zeros to {self.digits_n} digits" if self.digits_n > 1 else "")

    @property
    def example(self) -> str:
        return "1".zfill(self.digits_n)

    def step(self, state: int, sign: str) -> int | None:
        if sign not in DIGITS or -state == self.digits_n:
            return None
        if state == 0:
            return -1 if sign == "0" else 1
        return state - 1 if state < 0 else min(state + 1, self.digits_n)

    def ends(self, state: int) -> bool:
        return abs(state) == self.digits_n

    def may_go_on(self, state: int) -> bool:
        return -state != self.digits_n

    def read(self, piece: str) -> int:
        return int(piece)

    def write(self, value) -> str:
        if isinstance(value, bool):
            raise TypeError
        return _accepted(self, f"{operator.index(value):0{self.digits_n}d}")


@dataclasses.dataclass(frozen=True)
class _Number:
    """A decimal number: 1 a leading zero, 2 before the point, 3 the point, 4 a digit after it, 5 a zero after it."""

    says: str = "a number such as 7 or 0.25"
    example: str = "0.5"

    def step(self, state: int, sign: str) -> int | None:
        if sign == ".":
            return 3 if state in (1, 2) else None
        if sign not in DIGITS or state == 1:
            return None
        if state in (0, 2):
            return 1 if state == 0 and sign == "0" else 2
        return 5 if sign == "0" else 4

    def ends(self, state: int) -> bool:
        return state in (1, 2, 4)

    def may_go_on(self, state: int) -> bool:
        return True

    def read(self, piece: str) -> float | None:
        value = float(piece)
        return value if math.isfinite(value) and _plain(value) == piece else None

    def write(self, value) -> str:
        if isinstance(value, bool | str):
            raise TypeError
        value = float(value)
        if not math.isfinite(value):
            raise ValueError
        return _accepted(self, _plain(value))


@dataclasses.dataclass(frozen=True)
class _OneOf:
    """One of some words; the states are the beginnings of them."""

    ways: tuple[str, ...]
    values: tuple[str | int, ...]
    begins: tuple[str, ...]
    says: str

    @property
    def example(self) -> str:
        return self.ways[0]

    def step(self, state: int, sign: str) -> int | None:
        try:
            return self.begins.index(self.begins[state] + sign)
        except ValueError:
            return None

    def ends(self, state: int) -> bool:
        return self.begins[state] in self.ways

    def may_go_on(self, state: int) -> bool:
        return any(way.startswith(self.begins[state]) and way != self.begins[state] for way in self.ways)

    def read(self, piece: str) -> str | int:
        return self.values[self.ways.index(piece)]

    def write(self, value) -> str:
        if isinstance(value, bool | float) or value not in self.values:
            raise ValueError
        return self.ways[self.values.index(value)]


@dataclasses.dataclass(frozen=True)
class _Item:
    """A field, or text that stands in every name (no field); `group` numbers the `[ ]` that it stands in."""

    field: str | None
    kind: _Text | _Whole | _Number | _OneOf
    group: int | None


def _plain(value: float) -> str:
    """The shortest decimal that gives this number back, without an exponent."""
    return format(Decimal(repr(value)), "f").removesuffix(".0")


def _accepted(kind, piece: str) -> str:
    state = 0
    for sign in piece:
        state = kind.step(state, sign)
        if state is None:
            raise ValueError
    if not piece or not kind.ends(state):
        raise ValueError
    return piece


def _one_of(ways: tuple[str, ...], says: str | None = None) -> _OneOf:
    whole = all(way.isascii() and way.isdigit() for way in ways)
    values = tuple(int(way) for way in ways) if whole else ways
    begins = tuple(dict.fromkeys(way[:i] for way in ways for i in range(len(way) + 1)))
    return _OneOf(ways, values, begins, says or choices(ways))


# -- the chain of them -------------------------------------------------------------------------------------------------


def _followers(items: tuple[_Item, ...], index: int) -> list[int]:
    """Items that may come after one, -1 being the start: the next, and the first after each `[ ]` left out."""
    found, j = [], index + 1
    while j < len(items):
        found.append(j)
        group = items[j].group
        if group is None or (index >= 0 and items[index].group == group):
            break
        while j < len(items) and items[j].group == group:
            j += 1
    return found


def _may_end(items: tuple[_Item, ...], state: tuple[int, int]) -> bool:
    index, inner = state
    if index < 0 or not items[index].kind.ends(inner):
        return False
    rest = items[index + 1 :]
    return all(item.group is not None and item.group != items[index].group for item in rest)


def _steps(items: tuple[_Item, ...], state: tuple[int, int], sign: str) -> list[tuple[int, int]]:
    """States after one more character."""
    index, inner = state
    reached = []
    if index >= 0:
        reached.append((index, items[index].kind.step(inner, sign)))
    if index < 0 or items[index].kind.ends(inner):
        reached += [(j, items[j].kind.step(0, sign)) for j in _followers(items, index)]
    return [one for one in reached if one[1] is not None]


def _refuse_two_ways(template: Template) -> None:
    """Search the product of the chain with itself, breadth first, for the shortest name with two readings."""
    items = template._items
    signs = sorted({sign for item in items if isinstance(item.kind, _OneOf) for way in item.kind.ways for sign in way})
    # one character stands for all that no field tells apart
    signs += [sign for sign in (*DIGITS, ".", "-", *_strangers(signs)) if sign not in signs]
    start = ((-1, 0), (-1, 0))
    seen, queue = {start}, deque([(start, "")])
    while queue:
        (one, other), name = queue.popleft()
        if one != other and _may_end(items, one) and _may_end(items, other):
            return _refuse(template, name)
        for sign in signs:
            there = [(a, b) for a in _steps(items, one, sign) for b in _steps(items, other, sign)]
            for pair in there:
                # two ways that part and meet again are two readings as well: whatever ends one ends the other
                if one != other and pair[0] == pair[1]:
                    return _refuse(template, name + sign + _ending(items, pair[0], signs))
                if pair[0] <= pair[1] and pair not in seen:
                    seen.add(pair)
                    queue.append((pair, name + sign))
                elif pair[0] > pair[1] and pair[::-1] not in seen:
                    seen.add(pair[::-1])
                    queue.append((pair[::-1], name + sign))
    return None


def _strangers(signs: list[str]) -> list[str]:
    """A letter and another character that stand in no list of alternatives and no text of the template."""
    letter = next(sign for sign in map(chr, range(ord("a"), 0x3000)) if sign.isalpha() and sign not in signs)
    other = next(sign for sign in map(chr, range(0x21, 0x3000)) if _is_plain_sign(sign) and sign not in signs)
    return [letter, other]


def _is_plain_sign(sign: str) -> bool:
    return sign.isprintable() and not sign.isalnum() and sign not in NOT_IN_NAMES and sign not in ". -"


def _ending(items: tuple[_Item, ...], state: tuple[int, int], signs: list[str]) -> str:
    """The shortest rest of a name from a state on."""
    seen, queue = {state}, deque([(state, "")])
    while queue:
        at, rest = queue.popleft()
        if _may_end(items, at):
            return rest
        for sign in signs:
            for after in _steps(items, at, sign):
                if after not in seen:
                    seen.add(after)
                    queue.append((after, rest + sign))
    return ""


def _refuse(template: Template, name: str) -> None:
    fields = ", ".join(template.fields)
    raise InputError(
        f"expected a template that reads every name in one way, got {template.text}, which reads '{name}' in two; put "
        f"a sign between the fields ({fields}) that they cannot hold, or say more of them, such as {{a:letters}} or "
        "{a:1..5}"
    )


# -- reading a template ------------------------------------------------------------------------------------------------

_PARTS = re.compile(
    r"(?P<sign>\{\{|\}\}|\[\[|\]\])|(?P<field>\{[^{}]*\})|(?P<open>\[)|(?P<close>\])|(?P<text>[^{}\[\]]+)"
)


def _read(text: str) -> tuple[_Item, ...]:
    if not isinstance(text, str) or not text:
        raise InputError(f"expected a template such as {{speaker}}_{{utterance}}_{{repeat:d}}, got {text!r}")
    items: list[_Item] = []
    kinds: dict[str, object] = {}
    at, group, groups_n = 0, None, 0
    while at < len(text):
        found = _PARTS.match(text, at)
        if found is None:
            raise InputError(f"expected every {{ to be closed, got '{short(text[at:])}' in the template {text}")
        at = found.end()
        if found["open"]:
            if group is not None:
                raise InputError(f"expected no [ inside of [ ], got one in the template {text}")
            group, groups_n = groups_n, groups_n + 1
        elif found["close"]:
            if group is None or not any(item.group == group and item.field for item in items):
                raise InputError(f"expected [ ] around one field or more, got a ] without that in the template {text}")
            group = None
        elif found["field"]:
            field, kind = _read_field(found["field"], kinds, group is not None, text)
            if (
                field in kinds
                and any(item.field == field and item.group != group for item in items)
                and (group is not None or any(item.field == field and item.group is not None for item in items))
            ):
                raise InputError(
                    f"expected the field {field} only inside or only outside of one [ ], got both in {text}"
                )
            kinds[field] = kind
            items.append(_Item(field, kind, group))
        else:
            piece = found["text"] or found["sign"][0]
            items.append(_Item(None, _one_of((piece,), f"'{piece}'"), group))
    if group is not None:
        raise InputError(f"expected every [ to be closed, got one that is not in the template {text}")
    if not kinds:
        raise InputError(f"expected a template with fields such as {{speaker}}, got none in {text}")
    if not any(item.group is None for item in items):
        raise InputError(f"expected a template with a part outside of [ ], got none in {text}")
    return tuple(items)


def _read_field(piece: str, kinds: dict, in_group: bool, text: str) -> tuple[str, object]:
    field, colon, says = piece[1:-1].partition(":")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", field):
        raise InputError(
            f"expected fields named by small letters, digits and _ such as {{speaker}}, got {piece} in {text}"
        )
    if not colon and field in kinds:
        return field, kinds[field]
    kind = _read_kind(says, in_group) if colon else _Text("text without _ or /", "a", "any")
    if kind is None:
        raise InputError(
            "expected a field as {name}, {name:word}, {name:letters}, {name:d}, {name:02d}, {name:number}, "
            f"{{name:1..5}} or {{name:one|two}}, got {piece} in the template {text}"
        )
    if kinds.get(field, kind) != kind:
        raise InputError(f"expected the field {field} to be of one kind, got a second, {piece}, in the template {text}")
    return field, kind


def _read_kind(says: str, in_group: bool):
    if says == "word":
        return _Text("letters and digits", "a1", "word")
    if says == "letters":
        return _Text("letters", "a", "letters")
    if says == "number":
        return _Number()
    if found := re.fullmatch(r"(?:0([1-9]))?d", says):
        return _Whole(int(found[1] or 1))
    if found := re.fullmatch(r"([0-9]{1,9})\.\.([0-9]{1,9})", says):
        return _read_range(found[1], found[2])
    ways = tuple(says.split("|"))
    if not all(ways) or len(set(ways)) < len(ways) or len(ways) > MOST_WAYS_N:
        return None
    if len(ways) == 1 and not in_group:  # says nothing, and is more often a slip such as {a:int}
        return None
    whole = all(way.isascii() and way.isdigit() for way in ways)
    if whole and len({int(way) for way in ways}) < len(ways):
        return None
    return _one_of(ways)


def _read_range(low: str, high: str) -> _OneOf | None:
    filled = len(low) == len(high) and low.startswith("0") and len(low) > 1
    if int(low) > int(high) or int(high) - int(low) >= MOST_WAYS_N or (not filled and str(int(low)) != low):
        return None
    ways = tuple(str(number).zfill(len(low) if filled else 1) for number in range(int(low), int(high) + 1))
    return _one_of(ways, f"{low} to {high}")


# -- known templates ---------------------------------------------------------------------------------------------------

# thesis table 5.1: action, level of stickiness, and a where the video has sound. The table prints fs for the fast
# opening, the answers in its appendix say of: both are taken and kept apart, so that names come back as they were
THESIS_CODE = Template("{action:os|of|fs|p|m|pu|mu}{stickiness:0|4|7|10}[{audio:a}]")
THESIS_ACTIONS = {
    "os": "mouth opening, slow",
    "of": "mouth opening, fast",
    "fs": "mouth opening, fast",
    "p": "p",
    "m": "m",
    "pu": "puppy",
    "mu": "mummy",
}
TAKE = Template("{speaker}_{utterance}_{repeat:d}")
