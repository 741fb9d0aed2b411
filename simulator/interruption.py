"""Ctrl-C and SIGTERM as requests that a computation looks at between two steps."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def deferred_signals() -> Iterator[list[int]]:
    """Collect signals in the list instead of breaking off anywhere, which could leave a step half done.

    SIGINT and SIGTERM are collected where the program handles them in Python, as it does SIGINT unless told otherwise.
    The first is collected, a second acts as if there were no deferring. Outside the main thread, which alone gets
    signals, the list stays empty.
    """
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}

    def collect(number, frame):
        if received:
            handlers[number](number, frame)
        received.append(number)

    try:
        for number in handlers:
            signal.signal(number, collect)
        yield received
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
