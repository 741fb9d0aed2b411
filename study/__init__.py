"""Perceptual A/B studies: design, serving, export and analysis."""

import importlib

_HOME = {
    "Analysis": "analysis",
    "Answers": "responses",
    "InputError": "errors",
    "analyse": "analysis",
    "load_answers": "responses",
    "replicate_thesis": "replication",
    "thesis_answers": "responses",
}
__all__ = sorted(_HOME)


def __getattr__(name: str):
    """Load a public name when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'study' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"study.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*globals(), *__all__]
