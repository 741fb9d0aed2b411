"""Sticky-lips finite element simulator: the source of ground-truth mouth videos."""

import importlib
import sys
import types

_HOME = {
    "InputError": "errors",
    "Model": "model",
    "Motion": "motion",
    "Scene": "scene",
    "load_scene": "scene",
    "make_clip": "clip",
    "read_niftysim": "niftysim_xml",
    "render": "render",
    "scene_names": "scene",
    "simulate": "simulate",
    "solve": "solver",
    "truth": "truth",
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


class _Package(types.ModuleType):
    """Keeps `simulator.render` the verb: an import would put the module of the same name in its place."""

    def __setattr__(self, name: str, value) -> None:
        if not (name in _HOME and isinstance(value, types.ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __dir__() -> list[str]:
    return [*globals(), *__all__]
