"""The cores that this process may use, and one thread pool for them."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


_WORKERS: list[ThreadPoolExecutor] = []


def workers() -> ThreadPoolExecutor:
    """Return the process's thread pool for compiled code that releases the GIL, one thread per core.

    All such work, scans and learning alike, runs in this pool: more threads than cores would wait for one
    core while another is idle. A task must not wait for another task of the pool.
    """
    if not _WORKERS:
        _WORKERS.append(ThreadPoolExecutor(usable_cores(), thread_name_prefix="core"))
    return _WORKERS[0]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_WORKERS.clear)  # a forked child has none of its parent's threads
