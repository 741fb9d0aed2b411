"""How a mouth peels open: several openings at once, merges and splits, zip speed of each corner, left against right.

Lips that stick do not part at once. They open where the glue is weakest, sometimes in several places, and the ends of
the opened part then travel outwards like two zips. All measures are of a take's openings, one row per opening per
frame: x to the right as one looks at the face, 0 in the middle of the mouth. Left and right are those of the picture.

The opened part of a frame reaches from the leftmost end of its openings to the rightmost. The main opening of a take is
the stretch of open frames with the greatest height; its stroke goes on until the height has fallen below 0.9 of that.
Zips, delays and onsets are of this stroke. They are NaN where it is open in the take's first known frame, because its
beginning was not seen. Lengths are in the unit of the take; the rows say `mw`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import betainc

from lipmetrics.errors import InputError
from lipmetrics.metrics import movement
from lipmetrics.metrics.registry import NONE, Metric
from lipmetrics.take import Take

EVENT_COLUMNS = ("time_s", "event", "opening", "parents", "width", "width_before", "jump")
_MOST_POINTS = 500  # of a zip: all pairs of them are looked at
_NEEDED = ("time_s", "opening", "left", "right", "width", "area", "x", "event", "parents")


@dataclass(frozen=True)
class Settings:
    """What the measures of peeling depend on.

    zip_from, zip_to : shares of an end's way between which its speed is taken
    least_way : an end that travels less than this share of the greatest width of the opened part does not zip
    corner_share : where the corner is taken to be, as a share of the outermost place that is opened on that side
    side_share : places left and right whose onsets are compared, as a share of the further one of the two
    fall_share : the stroke ends when the height has fallen below this share of its greatest value
    """

    zip_from: float = 0.2
    zip_to: float = 0.8
    least_way: float = 0.1
    corner_share: float = 0.8
    side_share: float = 0.5
    fall_share: float = 0.9

    def __post_init__(self) -> None:
        if not 0 <= self.zip_from < self.zip_to <= 1:
            raise InputError(f"expected shares 0 <= zip_from < zip_to <= 1, got {self.zip_from} and {self.zip_to}")
        for name in ("least_way", "corner_share", "side_share", "fall_share"):
            if not 0 < getattr(self, name) <= 1:
                raise InputError(f"expected {name} above 0 and up to 1, got {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class Opened:
    """The openings of a take, frame by frame.

    take : where they are from
    known : (T,) bool
    count : (T,) number of openings, 0 closed or unknown
    left, right : (T,) ends of the opened part, NaN where nothing is open
    table : the rows of the openings with their `row` of the take, in order of time
    main : (K,) indices of the open frames of the main opening; empty where the mouth never opens
    from_closed : whether a known closed frame comes before it
    """

    take: Take
    known: np.ndarray
    count: np.ndarray
    left: np.ndarray
    right: np.ndarray
    table: pd.DataFrame
    main: np.ndarray
    from_closed: bool

    @property
    def time_s(self) -> np.ndarray:
        return self.take.time_s

    def stroke(self, fall_share: float) -> np.ndarray:
        """Those of `main` until the height has fallen below this share of its greatest value."""
        height = self.take.channels["height"][self.main]
        top = int(np.nanargmax(height))
        fallen = np.flatnonzero(height[top:] < fall_share * height[top])
        return self.main[: top + fallen[0]] if len(fallen) else self.main


def validate(take: Take | Opened) -> Opened:
    """Bring a take's openings into frames. What this gave may be handed to every measure in place of the take.

    Raises
    ------
    InputError : no take, no openings known, columns missing, or openings at times that are no frames of the take
    """
    if isinstance(take, Opened):
        return take
    movement.validate(take)
    if take.openings is None:
        raise InputError(
            f"{take.name}: expected a take that knows its openings one by one, its source {take.source} does not; "
            "measure the video itself, or a mesh by its inner lip loop"
        )
    missing = [column for column in _NEEDED if column not in take.openings]
    if missing:
        raise InputError(f"{take.name}: expected the columns {', '.join(_NEEDED)}, missing {', '.join(missing)}")
    table = take.openings.sort_values("time_s", kind="stable").reset_index(drop=True)
    at, time_s = table["time_s"].to_numpy(float), take.time_s
    row = np.clip(np.searchsorted(time_s, at - 1e-6), 0, len(time_s) - 1)
    far = np.abs(time_s[row] - at) > 2e-6  # tables keep microseconds
    if far.any():
        raise InputError(f"{take.name}: expected openings at the take's times, got one at {at[far][0]:g} s, no frame")
    left, right = np.full(len(time_s), np.inf), np.full(len(time_s), -np.inf)
    np.minimum.at(left, row, table["left"].to_numpy(float))
    np.maximum.at(right, row, table["right"].to_numpy(float))
    count = np.bincount(row, minlength=len(time_s))
    left[count == 0], right[count == 0] = np.nan, np.nan
    known = np.isfinite(take.channels["height"]) | (count > 0)
    main = _main(count > 0, known, take.channels["height"])
    before = known[: main[0]] if len(main) else known[:0]
    return Opened(take, known, count, left, right, table.assign(row=row), main, bool(before.any()))


def events(take: Take | Opened) -> pd.DataFrame:
    """Merges and splits of a take in order of time.

    Returns
    -------
    DataFrame, columns `EVENT_COLUMNS`: `event` is `merge` or `split`, `opening` who goes on or is new, `parents` who it
    came from; `width` of the opening then, `width_before` of its widest parent when last seen, `jump` their difference
    """
    table = validate(take).table
    rows = []
    for k in np.flatnonzero(table["event"].isin(["merge", "split"])):
        one = table.iloc[k]
        earlier = table[(table["row"] < one["row"]) & table["opening"].astype(str).isin(one["parents"].split("+"))]
        last_seen = earlier.groupby("opening")["width"].last()
        before = float(last_seen.max()) if len(last_seen) else math.nan
        width = float(one["width"])
        rows.append((one["time_s"], one["event"], one["opening"], one["parents"], width, before, width - before))
    return pd.DataFrame(rows, columns=list(EVENT_COLUMNS))


def openings_over_time(take: Take | Opened) -> np.ndarray:
    """(T,) float64 number of openings in each frame, NaN unknown."""
    opened = validate(take)
    return np.where(opened.known, opened.count, np.nan)


def several_share_v1(take: Take | Opened) -> float:
    """Share of the open time with more than one opening, 1; 0 where the mouth never opens.

    time with n > 1 / time with n > 0; a frame lasts from half way to half way to its neighbours.
    """
    opened = validate(take)
    lasts = movement.frame_durations(opened.time_s)
    open_s = lasts[opened.count > 0].sum()
    return float(lasts[opened.count > 1].sum() / open_s) if open_s else 0.0


def most_openings_v1(take: Take | Opened) -> float:
    """The most openings in one frame, 1: max_t n(t)."""
    return float(validate(take).count.max())


def merges_v1(take: Take | Opened) -> float:
    """Number of times that an opening was taken up by another, 1; three that become one are two merges."""
    table = validate(take).table
    return float(sum(len(parents.split("+")) - 1 for parents in table.loc[table["event"] == "merge", "parents"]))


def splits_v1(take: Take | Opened) -> float:
    """Number of times that a part of an opening came off, 1."""
    return float((validate(take).table["event"] == "split").sum())


def merge_time_v1(take: Take | Opened) -> float:
    """From the onset of the main opening to its last merge, s: when the lips no longer stick between openings.

    NaN where nothing merges in it.
    """
    opened = validate(take)
    table = opened.table
    rows = table.loc[(table["event"] == "merge") & table["row"].isin(opened.main), "row"]
    return float(opened.time_s[rows.max()] - opened.time_s[opened.main[0]]) if len(rows) else math.nan


def merge_jump_v1(take: Take | Opened) -> float:
    """Greatest jump of the width at a merge, mw: max over merges of (merged width - width of the widest parent).

    0 where nothing merges. The jump of thesis figure 5.42; `events` lists them all.
    """
    found = events(take)
    jumps = found.loc[found["event"] == "merge", "jump"]
    return float(jumps.max()) if jumps.notna().any() else 0.0


def zip_speed_left_v1(take: Take | Opened, settings: Settings = Settings()) -> float:
    """How fast the left end of the opened part travels outwards, mw/s.

    The end's way goes from its first place in the stroke to its outermost one, over a running median of three frames.
    The speed is the Theil-Sen slope (median of the slopes of all pairs of points) from where 20 % of the way is first
    reached, between frames, to where 80 % is.

    Returns
    -------
    float above 0; NaN where both shares are passed in one step between frames (it jumps open), where the way is shorter
    than a tenth of the greatest width of the opened part (it does not travel, or did before it was seen), where the end
    goes back as much as forth, and where the beginning was not seen

    Source: this package.
    """
    return _zip(validate(take), -1, settings)[0]


def zip_speed_right_v1(take: Take | Opened, settings: Settings = Settings()) -> float:
    """How fast the right end of the opened part travels outwards, mw/s, as `zip_speed_left_v1`."""
    return _zip(validate(take), 1, settings)[0]


def zip_jump_left_v1(take: Take | Opened, settings: Settings = Settings()) -> float:
    """The largest step of the left end between two frames as a share of its way, 1: near 1 jumps, near 0 peels.

    Over the frames as measured. Depends on the frame rate: compare takes of the same rate only.
    """
    return _zip(validate(take), -1, settings)[1]


def zip_jump_right_v1(take: Take | Opened, settings: Settings = Settings()) -> float:
    """The largest step of the right end between two frames as a share of its way, 1, as `zip_jump_left_v1`."""
    return _zip(validate(take), 1, settings)[1]


def corner_delay_left_v1(take: Take | Opened, settings: Settings = Settings()) -> float:
    """How much later the lips part at the left corner than in the middle of the mouth, s.

    t(c) - t(0), where t(x) is when an opening first covers x, between frames, and c is 0.8 of the outermost place that
    is opened on the left. Negative where the corner parts first. NaN where one of the two never opens or the beginning
    was not seen.
    """
    return _delay(validate(take), -1, settings)


def corner_delay_right_v1(take: Take | Opened, settings: Settings = Settings()) -> float:
    """How much later the lips part at the right corner than in the middle, s, as `corner_delay_left_v1`."""
    return _delay(validate(take), 1, settings)


def area_asymmetry_v1(take: Take | Opened) -> float:
    """Right against left in opened area over time, 1, from -1, only left, to 1, only right.

        (int A_right dt - int A_left dt) / (int A_right dt + int A_left dt)

    An opening that crosses the middle is divided as a smooth lens with its ends, area and centre of area: the share to
    the left is that of the beta distribution with a + b = 4 (a parabola where it is symmetric) and the same mean. NaN
    where the mouth never opens.
    """
    opened = validate(take)
    table = opened.table
    left, right, area = (table[name].to_numpy(float) for name in ("left", "right", "area"))
    width = np.maximum(right - left, np.finfo(float).tiny)
    mean = np.clip((table["x"].to_numpy(float) - left) / width, 1e-6, 1 - 1e-6)
    on_left = betainc(4 * mean, 4 * (1 - mean), np.clip(-left / width, 0.0, 1.0))
    weight = area * movement.frame_durations(opened.time_s)[table["row"]]
    return float((weight * (1 - 2 * on_left)).sum() / weight.sum()) if weight.sum() > 0 else math.nan


def onset_asymmetry_v1(take: Take | Opened, settings: Settings = Settings()) -> float:
    """How much earlier the lips part right than left, s: t(-q) - t(q), t(x) as in `corner_delay_left_v1`.

    q is half of the way from the middle to the outermost place that is opened on either side. Positive where the right
    is first. NaN where one side never opens that far or the beginning was not seen; then `area_asymmetry_v1` tells.
    """
    opened = validate(take)
    if not opened.from_closed:
        return math.nan
    rows = opened.stroke(settings.fall_share)
    q = settings.side_share * max(-opened.left[rows].min(), opened.right[rows].max())
    return _covered(opened, rows, -q) - _covered(opened, rows, q) + 0.0  # no minus zero


def width_at_peak_v1(take: Take | Opened) -> float:
    """Width of the largest opening when its height is greatest, mw; a lip that sticks keeps it narrow. w(argmax h).

    NaN where it is not known then.
    """
    take = take.take if isinstance(take, Opened) else take
    movement.validate(take)
    return float(take.channels["width"][np.nanargmax(take.channels["height"])])


def evaluate(take: Take, *, settings: Settings = Settings()) -> dict[str, float]:
    """All metrics of this module by name.

    Raises
    ------
    InputError : as `validate`
    """
    opened = validate(take)
    return {
        row.name: row.function(opened, settings) if row.function.__defaults__ else row.function(opened) for row in ROWS
    }


def _main(is_open: np.ndarray, known: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Open frames of the stretch with the greatest height; frames that are not known do not end it."""
    closed_so_far = np.cumsum(known & ~is_open)
    here = np.flatnonzero(is_open)
    if len(here) == 0:
        return here
    tallest = here[np.argmax(np.where(np.isfinite(height[here]), height[here], -1.0))]
    return here[closed_so_far[here] == closed_so_far[tallest]]


def _zip(opened: Opened, side: int, settings: Settings) -> tuple[float, float]:
    """Speed of one end, side -1 left and 1 right, and the largest step as a share of its way."""
    if not opened.from_closed:
        return math.nan, math.nan
    rows = opened.stroke(settings.fall_share)
    time_s = opened.time_s[rows]
    place = side * (opened.left if side < 0 else opened.right)[rows]
    widest = (opened.right - opened.left)[rows].max()
    steady = place.copy()
    if len(place) > 2:
        steady[1:-1] = np.median([place[:-2], place[1:-1], place[2:]], axis=0)
    way = steady.max() - steady[0]
    if way < settings.least_way * widest or way <= 0:
        return math.nan, math.nan
    end = int(place.argmax())
    jump = float(np.diff(place[: end + 1]).max() / (place[end] - place[0]))
    share = (steady - steady[0]) / way
    first, last = (int(np.argmax(share >= limit)) for limit in (settings.zip_from, settings.zip_to))
    if first == last:
        return math.nan, jump
    ends = [_crossing(time_s, share, k, limit) for k, limit in ((first, settings.zip_from), (last, settings.zip_to))]
    t = np.array([ends[0], *time_s[first:last], ends[1]])
    q = np.array([settings.zip_from, *share[first:last], settings.zip_to])
    if len(t) > _MOST_POINTS:
        few = np.linspace(0, len(t) - 1, _MOST_POINTS).round().astype(int)
        t, q = t[few], q[few]
    i, j = np.triu_indices(len(t), 1)
    apart = t[j] > t[i]  # a share may be reached exactly on a frame, which then is there twice
    speed = float(np.median((q[j] - q[i])[apart] / (t[j] - t[i])[apart]) * way)
    return (speed if speed > 0 else math.nan), jump


def _crossing(time_s: np.ndarray, values: np.ndarray, k: int, level: float) -> float:
    """When values reach `level`, linearly between frames k - 1 and k; the time of k where it is the first."""
    if k == 0:
        return float(time_s[0])
    return float(time_s[k - 1] + (level - values[k - 1]) / (values[k] - values[k - 1]) * (time_s[k] - time_s[k - 1]))


def _delay(opened: Opened, side: int, settings: Settings) -> float:
    if not opened.from_closed:
        return math.nan
    rows = opened.stroke(settings.fall_share)
    outermost = opened.left[rows].min() if side < 0 else opened.right[rows].max()
    if outermost * side <= 0:
        return math.nan
    return _covered(opened, rows, settings.corner_share * outermost) - _covered(opened, rows, 0.0)


def _covered(opened: Opened, rows: np.ndarray, x: float) -> float:
    """When an opening first covers x in these open frames, s; NaN never.

    Between two open frames linearly in the distance of the nearest opening from x; the frame's time where it covers x
    in the first of them.
    """
    table = opened.table
    distance = np.full(len(opened.time_s), np.inf)
    beyond = np.maximum(table["left"].to_numpy(float) - x, x - table["right"].to_numpy(float))
    np.minimum.at(distance, table["row"].to_numpy(), beyond)
    k = int(np.argmax(distance[rows] <= 0))
    if distance[rows[k]] > 0:
        return math.nan
    return _crossing(opened.time_s[rows], -distance[rows], k, 0.0)


ROWS = (
    Metric(
        *("several_share_v1", "sticky", "1", NONE, "openings", several_share_v1),
        *("time with n > 1 / time with n > 0", "this package"),
    ),
    Metric(*("most_openings_v1", "sticky", "1", NONE, "openings", most_openings_v1, "max_t n(t)", "this package")),
    Metric(
        *("merges_v1", "sticky", "1", NONE, "openings", merges_v1),
        *("sum over merges of (number of parents - 1)", "this package"),
    ),
    Metric(*("splits_v1", "sticky", "1", NONE, "openings", splits_v1, "number of splits", "this package")),
    Metric(
        *("merge_time_v1", "sticky", "s", NONE, "openings", merge_time_v1),
        *("t of the last merge in the main opening - t of its first frame", "this package"),
    ),
    Metric(
        *("merge_jump_v1", "sticky", "mw", NONE, "openings", merge_jump_v1),
        *("max over merges of (merged width - width of the widest parent), or 0", "this package"),
    ),
    Metric(
        *("zip_speed_left_v1", "sticky", "mw/s", NONE, "openings", zip_speed_left_v1),
        *("Theil-Sen slope of the left end outwards between 20 and 80 % of its way", "this package"),
    ),
    Metric(
        *("zip_speed_right_v1", "sticky", "mw/s", NONE, "openings", zip_speed_right_v1),
        *("Theil-Sen slope of the right end outwards between 20 and 80 % of its way", "this package"),
    ),
    Metric(
        *("zip_jump_left_v1", "sticky", "1", NONE, "openings", zip_jump_left_v1),
        *("largest step of the left end outwards / its way", "this package"),
    ),
    Metric(
        *("zip_jump_right_v1", "sticky", "1", NONE, "openings", zip_jump_right_v1),
        *("largest step of the right end outwards / its way", "this package"),
    ),
    Metric(
        *("corner_delay_left_v1", "sticky", "s", NONE, "openings", corner_delay_left_v1),
        *("t(0.8 outermost left) - t(0), t(x) when an opening first covers x", "this package"),
    ),
    Metric(
        *("corner_delay_right_v1", "sticky", "s", NONE, "openings", corner_delay_right_v1),
        *("t(0.8 outermost right) - t(0), t(x) when an opening first covers x", "this package"),
    ),
    Metric(
        *("area_asymmetry_v1", "sticky", "1", NONE, "openings", area_asymmetry_v1),
        *("(A_right - A_left) / (A_right + A_left), areas integrated over time", "this package"),
    ),
    Metric(
        *("onset_asymmetry_v1", "sticky", "s", NONE, "openings", onset_asymmetry_v1),
        *("t(-q) - t(q), q half of the outermost place on either side", "this package"),
    ),
    Metric(*("width_at_peak_v1", "sticky", "mw", NONE, "take", width_at_peak_v1, "w(argmax_t h(t))", "this package")),
)
