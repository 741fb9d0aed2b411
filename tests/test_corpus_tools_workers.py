"""Workers: all jobs are done, by others where a worker is lost, and none outlives what started it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from corpus_tools.workers import ATTEMPTS_N, ONE_THREAD, on_dask, work
from lipmetrics.errors import InputError

HERE = "test_corpus_tools_workers"


def double(value):
    """What the workers of these tests do."""
    if value == "odd":
        raise InputError("expected a number,\n got odd")
    if value == "threads":
        from lipmetrics import frames

        return [os.environ[name] for name in ONE_THREAD] + [frames.decoder_threads_n]
    return 2 * value


def die_once(marker):
    """Ends its process by force, the first time."""
    if not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def die(marker):
    with Path(marker).open("a") as file:
        file.write("x")
    os.kill(os.getpid(), signal.SIGKILL)


def sleep_long(pid_file):
    Path(pid_file).write_text(str(os.getpid()))
    time.sleep(600)


def either(name, *given):
    return {"double": double, "die_once": die_once, "die": die}[name](*given)


def test_all_jobs_are_done_whatever_happens_to_a_worker(tmp_path):
    jobs = [(k, ("double", k)) for k in range(12)]
    jobs[3:3] = [("error", ("double", "odd")), ("lost", ("die_once", str(tmp_path / "once")))]
    jobs[8:8] = [("hopeless", ("die", str(tmp_path / "always"))), ("threads", ("double", "threads"))]
    before = dict(os.environ)
    outcomes = {one.key: one for one in work(f"{HERE}:either", jobs, 2)}
    assert dict(os.environ) == before
    assert [outcomes[k].value for k in range(12)] == [2 * k for k in range(12)] and len(outcomes) == len(jobs)
    assert outcomes["error"].error == "expected a number, got odd" and outcomes["error"].value is None
    assert outcomes["lost"].value == "done" and outcomes["lost"].error is None
    assert outcomes["hopeless"].error == f"the process that did it was ended {ATTEMPTS_N} times (signal 9)"
    assert len((tmp_path / "always").read_text()) == ATTEMPTS_N
    assert outcomes["threads"].value == ["1"] * len(ONE_THREAD) + [1]


def test_no_jobs_no_workers():
    assert list(work("gone:gone", [], 2)) == []


def test_workers_that_cannot_start(tmp_path):
    with pytest.raises(
        InputError, match=r"expected processes that can do no_such:no, but: ModuleNotFoundError: No mod"
    ):
        list(work("no_such:no", [(1, ())], 1))
    script = (
        "from corpus_tools.workers import work\nfrom lipmetrics.errors import InputError\n"
        "try: list(work('no_such:no', [(1, ())], 1))\nexcept InputError as error: print(error)"
    )
    (tmp_path / "script.py").write_text(script)  # every worker starts it anew: its line of __main__ is missing
    run = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True)
    assert run.stdout.startswith("expected processes that measure to start, but they ended at once (exit code 1)")


def test_a_worker_ends_with_the_process_that_started_it(tmp_path):
    pid_file = tmp_path / "pid"
    script = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from corpus_tools.workers import work\n"
        f"if __name__ == '__main__': list(work('{HERE}:sleep_long', [(1, ({str(pid_file)!r},))], 1))"
    )
    (tmp_path / "script.py").write_text(script)
    parent = subprocess.Popen([sys.executable, tmp_path / "script.py"])
    wait_until(lambda: pid_file.exists() and pid_file.read_text(), 120)
    worker = int(pid_file.read_text())
    assert alive(worker)
    parent.kill()
    parent.wait()
    wait_until(lambda: not alive(worker), 60)


def wait_until(true, most_s):
    until = time.monotonic() + most_s
    while not true():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.02)


def alive(pid):
    """Whether a process runs; one that nobody has waited for yet does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def test_two_dask_workers(tmp_path):
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, protocol="tcp"
    )
    with cluster:
        jobs = [(k, ("double", k)) for k in range(8)] + [("error", ("double", "odd"))]
        jobs += [("lost", ("die_once", str(tmp_path / "once")))]
        outcomes = {one.key: one for one in on_dask(cluster.scheduler_address, f"{HERE}:either", jobs)}
    assert [outcomes[k].value for k in range(8)] == [2 * k for k in range(8)]
    assert outcomes["error"].error == "expected a number, got odd" and outcomes["lost"].value == "done"


def test_no_scheduler_there(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("corpus_tools.workers.CONNECT_S", 1)
    with pytest.raises(InputError, match=r"expected a Dask scheduler at tcp://127\.0\.0\.1:1, but: .*start one with"):
        list(on_dask("tcp://127.0.0.1:1", f"{HERE}:either", [(1, ("double", 1))]))


def test_dask_that_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(
        InputError, match=r"expected Dask for --dask, it is not installed; pip install 'lipmetrics\[dask"
    ):
        list(on_dask("tcp://127.0.0.1:1", f"{HERE}:either", []))
