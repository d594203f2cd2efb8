"""Long commands leave cleanly: Ctrl-C, and being told to end, ask them to save and go."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

INTERRUPTED = 130
"""Exit status of a command that was left so."""


@contextmanager
def on_interrupt(leave: Callable[[], None]) -> Iterator[None]:
    """Call `leave` whenever Ctrl-C is pressed or the process is told to end."""

    def handle(signum: int, frame: Any) -> None:
        leave()

    previous = [(number, signal.signal(number, handle)) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        yield
    finally:
        for number, handler in previous:
            signal.signal(number, handler)
