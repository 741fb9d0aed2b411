"""Sticky-lips finite element simulator: the source of ground-truth mouth videos."""

import importlib

_HOME = {
    "InputError": "errors",
    "Model": "model",
    "Motion": "motion",
    "read_niftysim": "niftysim_xml",
    "solve": "solver",
    "write_niftysim": "niftysim_xml",
}
__all__ = sorted(_HOME)


def __getattr__(name: str):
    """Load a public name when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'simulator' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"simulator.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*globals(), *__all__]
