"""What holds for all tests."""

import gc
import os
import subprocess
import sys
from pathlib import Path

import pytest

MANY = 200  # tests; fewer are over before another process has compiled what they need
FIRST_TO_LAST = ("test_study_", "test_corpus_tools_", "test_", "test_simulator_")  # the last is compiled last

_compiling = pytest.StashKey[subprocess.Popen]()


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    """All tests, or all quick ones, run on all cores where pytest-xdist is installed; a file's tests stay together."""
    option = config.option
    if hasattr(config, "workerinput"):
        return
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS and not option.keyword and not option.usepdb
    if whole and config.pluginmanager.hasplugin("xdist") and option.numprocesses is None and option.dist == "no":
        option.numprocesses, option.dist, option.loadscopereorder = "auto", "loadfile", False


def _place(item) -> int:
    """By the longest beginning that fits the file's name."""
    fitting = [start for start in FIRST_TO_LAST if item.path.name.startswith(start)]
    return FIRST_TO_LAST.index(max(fitting, key=len, default=FIRST_TO_LAST[0]))


def pytest_collection_modifyitems(items):
    """What needs no compiled code comes first, then in the order of compiling.py; small runs stay as asked for."""
    if len(items) > MANY:
        items.sort(key=_place)


def pytest_collection_finish(session):
    """A process that fills the cache of compiled code while tests run; no test waits for it or notices if it fails."""
    config = session.config
    alone = os.environ.get("NUMBA_DISABLE_JIT", "0") != "0" or (os.cpu_count() or 1) < 2
    if len(session.items) <= MANY or config.option.collectonly or hasattr(config, "workerinput") or alone:
        return
    quiet = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, str(Path(__file__).with_name("compiling.py")), str(os.getpid())]
    config.stash[_compiling] = subprocess.Popen(command, env=environment, **quiet)


def pytest_unconfigure(config):
    process = config.stash.get(_compiling, None)
    if process is not None:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@pytest.fixture(scope="module", autouse=True)
def _nothing_old_is_searched_for_garbage():
    """Full collections pass over what earlier modules left behind, compiled code above all: a million objects."""
    gc.collect()
    gc.freeze()
