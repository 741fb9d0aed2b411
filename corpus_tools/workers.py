"""Processes that do jobs, one at a time each, and outlive the loss of one; or the same on a Dask cluster.

A worker that is killed or crashes loses its job only, which is done again by a new one, `ATTEMPTS_N` times at most. A
worker ends at once when the process that started it does, however that ended. Nothing heavy is imported here: a worker
is held to one thread before it imports anything.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Hashable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait

from lipmetrics.errors import InputError

ATTEMPTS_N = 3  # of a job whose worker is lost, and of starting a worker
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
CONNECT_S, WORKERS_S = 10, 60  # longest wait for a scheduler, and for its first worker
_ONE_AT_A_TIME = threading.Lock()  # a worker of Dask has several threads if nothing else is said, and OpenCV's
# search for faces allows one


@dataclass(frozen=True)
class Outcome:
    """What became of a job.

    Parameters
    ----------
    key : of the job
    value : what the function returned; None after an error
    error : one sentence; None where there was none
    """

    key: Hashable
    value: object = None
    error: str | None = None


def cores_n() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def work(function: str, jobs: Sequence[tuple[Hashable, tuple]], processes_n: int) -> Iterator[Outcome]:
    """Do jobs in processes of their own; gives the outcomes as they come.

    Parameters
    ----------
    function : `package.module:name`, called with the arguments of a job
    jobs : key and arguments; both and the results travel between processes
    processes_n : at most so many at a time

    Raises
    ------
    InputError : no worker can be started
    """
    waiting = deque(jobs)
    lost: Counter[Hashable] = Counter()
    workers = [_Worker(function) for _ in range(min(processes_n, len(waiting)))]
    starts_n = 0  # that failed, one after the other
    try:
        for worker in workers:
            worker.take(waiting)
        while busy := [worker for worker in workers if worker.job is not None]:
            for pipe in wait([worker.pipe for worker in busy]):
                i, worker = next((i, worker) for i, worker in enumerate(workers) if worker.pipe is pipe)
                job = worker.job
                try:
                    answer = pipe.recv()
                except Exception:  # cut off in the middle, it may be anything
                    how = worker.end()
                    if worker.is_ready:
                        lost[job[0]] += 1
                    else:
                        starts_n += 1
                        if starts_n >= ATTEMPTS_N * len(workers):
                            raise InputError(
                                f"expected processes that measure to start, but they ended at once ({how}); a script "
                                "that calls this needs the line: if __name__ == '__main__':"
                            ) from None
                    given_up = lost[job[0]] >= ATTEMPTS_N
                    if not given_up:
                        waiting.append(job)
                    workers[i] = _Worker(function)
                    workers[i].take(waiting)
                    if given_up:
                        yield Outcome(job[0], error=f"the process that did it was ended {ATTEMPTS_N} times ({how})")
                    continue
                if isinstance(answer, str):
                    raise InputError(f"expected processes that can do {function}, but: {answer}")
                if answer is None:
                    worker.is_ready, starts_n = True, 0
                    continue
                worker.take(waiting)  # before the answer is looked at, so that nobody waits
                yield Outcome(job[0], *answer)
    finally:
        for worker in workers:
            worker.end(wait_s=0 if worker.job else 2)


class _Worker:
    """A process and the line to it."""

    def __init__(self, function: str):
        context = multiprocessing.get_context("spawn")
        self.pipe, there = context.Pipe()
        self.job: tuple[Hashable, tuple] | None = None
        self.is_ready = False
        self.how = ""
        self.process = context.Process(target=_serve, args=(there, function), daemon=True)
        before = {name: os.environ.get(name) for name in ONE_THREAD}
        try:
            os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
            self.process.start()
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value
        there.close()

    def take(self, waiting: deque) -> None:
        """Send the next job, if there is one."""
        self.job = waiting.popleft() if waiting else None
        if self.job is not None:
            with suppress(OSError):  # it is gone; that is found when its answer is read
                self.pipe.send(self.job[1])

    def end(self, wait_s: float = 2.0) -> str:
        """End the process, after so long by force; how it ended."""
        if not self.how:
            self.pipe.close()  # tells it to end, once it has done its job
            self.process.join(wait_s)
            self.process.kill()
            self.process.join()
            code = self.process.exitcode
            self.how = f"exit code {code}" if code >= 0 else f"signal {-code}"
            self.process.close()
        return self.how


def _serve(pipe: Connection, function: str) -> None:
    """A worker: answers None once it is ready, or why it never will be, then (value, error) to each job."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that started this one
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(OSError, EOFError):
        try:
            do = _function(function)
        except Exception as error:
            pipe.send(" ".join(f"{type(error).__name__}: {error}".split()))
            return
        pipe.send(None)
        while True:
            pipe.send(_answer(do, pipe.recv()))


def _end_with_parent() -> None:
    wait([multiprocessing.parent_process().sentinel])
    os._exit(1)


def _function(function: str):
    from lipmetrics import frames

    frames.decoder_threads_n = 1
    with suppress(ImportError):
        import cv2

        cv2.setNumThreads(1)
    module, name = function.split(":")
    return getattr(importlib.import_module(module), name)


def _answer(do, arguments: tuple) -> tuple[object, str | None]:
    from lipmetrics.console import sentence

    try:
        return do(*arguments), None
    except Exception as error:
        return None, sentence(error)


def on_dask(address: str, function: str, jobs: Sequence[tuple[Hashable, tuple]]) -> Iterator[Outcome]:
    """`work` on a Dask cluster, whose workers see the same files under the same paths.

    Parameters
    ----------
    address : of the scheduler, such as tcp://10.0.0.1:8786

    Raises
    ------
    InputError : Dask is not installed, no scheduler answers, it has no workers, or it goes away
    """
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise InputError(
            "expected Dask for --dask, it is not installed; pip install 'lipmetrics[dask]', or leave --dask out"
        ) from None
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"expected a Dask scheduler at {address}, but: {why}; start one with 'dask scheduler'"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError:
            raise InputError(
                f"expected the Dask scheduler at {address} to have workers, got none in {WORKERS_S} s; start some with "
                f"'dask worker {address} --nthreads 1'"
            ) from None
        futures = {
            client.submit(_on_worker, function, arguments, pure=False, retries=ATTEMPTS_N - 1): key
            for key, arguments in jobs
        }
        try:
            for future in as_completed(list(futures), loop=client.loop):
                key = futures.pop(future)
                if future.status == "finished":
                    yield Outcome(key, *future.result())
                elif future.status == "cancelled":
                    raise InputError(f"lost the Dask scheduler at {address}; run it again to go on from here")
                else:
                    yield Outcome(key, error=" ".join(str(future.exception()).split()))
                future.release()
        finally:
            with suppress(Exception):  # the scheduler may be gone
                client.cancel(list(futures))


def _on_worker(function: str, arguments: tuple) -> tuple[object, str | None]:
    with _ONE_AT_A_TIME:
        return _answer(_function(function), arguments)
