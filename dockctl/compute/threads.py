"""The cores that this process may use, and the threads that share them."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor


def usable_cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


_WORKERS: list[ThreadPoolExecutor] = []


def workers() -> ThreadPoolExecutor:
    """Return the process' threads for compiled work that lets go of Python's lock, one for each core.

    All such work, scans and learning alike, goes to these: a thread more than there are cores would wait in
    the queue of one core while another is idle. What they are given must not wait for them in turn.
    """
    if not _WORKERS:
        _WORKERS.append(ThreadPoolExecutor(usable_cores(), thread_name_prefix="core"))
    return _WORKERS[0]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_WORKERS.clear)  # a forked child has none of its parent's threads
