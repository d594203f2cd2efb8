"""Ctrl-C, SIGTERM and a closed terminal: long commands save and stop."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

INTERRUPTED = 130
"""Exit status of an interrupted command."""


@contextmanager
def on_interrupt(stop: Callable[[], None]) -> Iterator[None]:
    """Call `stop` on Ctrl-C, on SIGTERM, and once on SIGHUP, of which a closing terminal may send two.

    Python allows this in the main thread only; in another one, `stop` is never called.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    called = False

    def handle(signum: int, frame: Any) -> None:
        nonlocal called
        if not called or signum != signal.SIGHUP:
            called = True
            stop()

    numbers = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # nohup
        numbers.remove(signal.SIGHUP)
    previous = [(number, signal.signal(number, handle)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in previous:
            signal.signal(number, handler)


@contextmanager
def interruptible(announce: Callable[[], None] = lambda: None) -> Iterator[Callable[[], bool]]:
    """Yield a function that reports whether Ctrl-C was pressed; a second one raises KeyboardInterrupt.

    Args:
        announce: called when the function first reports it: a signal handler must not print.
    """
    pressed = announced = False

    def stop() -> None:
        nonlocal pressed
        if pressed:
            raise KeyboardInterrupt
        pressed = True

    def interrupted() -> bool:
        nonlocal announced
        if pressed and not announced:
            announced = True
            announce()
        return pressed

    with on_interrupt(stop):
        yield interrupted
