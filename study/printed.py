"""Numbers the way figures, pages and the terminal show them."""

from __future__ import annotations

import math


def p_text(p: float) -> str:
    """`0.013`, `0.25`, `7.7e-7`; a dash if unknown."""
    if p is None or not math.isfinite(p):
        return "-"
    if p < 0.001:
        return f"{p:.1e}".replace("e-0", "e-")
    return f"{p:.3f}" if p < 0.0995 else f"{p:.2f}"


def percent(share: float, decimals: int = 0) -> str:
    """`60 %`; a dash if unknown."""
    return "-" if share is None or not math.isfinite(share) else f"{100 * share:.{decimals}f} %"


def points(difference: float) -> str:
    """A difference of two shares in percentage points, with its sign: `+6`, `-12`."""
    if difference is None or not math.isfinite(difference):
        return "-"
    return f"{0.0 if abs(difference) < 0.005 else 100 * difference:+.0f}"


def between(low: float, high: float, show=percent) -> str:
    """`52 to 68 %`; a dash if unknown."""
    if low is None or not (math.isfinite(low) and math.isfinite(high)):
        return "-"
    first, last = show(low), show(high)
    return f"{first.removesuffix(' %')} to {last}"


def number(value: float, decimals: int = 2) -> str:
    """`1.50`, infinity as a sign; a dash if unknown."""
    if value is None or math.isnan(value):
        return "-"
    return "∞" if math.isinf(value) else f"{value:.{decimals}f}"


def level_name(level) -> str:
    """`level 4`; a name that is no number as it is."""
    if isinstance(level, (int, float)):
        return f"level {level:g}"
    return str(level)


def level_names(levels) -> str:
    """`level 0`, `levels 4, 7, 10`, or names as they are."""
    levels = list(levels)
    if all(isinstance(level, (int, float)) for level in levels):
        text = [f"{level:g}" for level in levels]
        return f"level{'s' * (len(text) > 1)} {', '.join(text) if len(text) <= 4 else f'{text[0]} to {text[-1]}'}"
    return ", ".join(map(str, levels)) if len(levels) <= 3 else f"{len(levels)} others"


def counted(n: int, what: str) -> str:
    """`1 pair`, `2 pairs`."""
    return f"{n} {what}{'' if n == 1 else 's'}"
