"""Measure how mouths open in video."""

import importlib

_HOME = {
    "InputError": "errors",
    "Profile": "profile",
    "Take": "take",
    "align": "compare.alignment",
    "average": "compare.averages",
    "classify": "compare.classes",
    "find_openings": "still",
    "hausdorff": "compare.distances",
    "l2": "compare.distances",
    "load_profile": "profile",
    "measure": "pipeline",
    "opening_mask": "still",
    "read_take": "takes",
    "read_takes": "takes",
    "score": "scoring",
}
__all__ = sorted(_HOME)


def __getattr__(name: str):
    """Load a public name when it is first used: `lipmetrics --help` needs none of them."""
    if name not in _HOME:
        raise AttributeError(f"module 'lipmetrics' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"lipmetrics.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*globals(), *__all__]
