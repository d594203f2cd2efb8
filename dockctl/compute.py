"""Compiled inner loops, one thread pool, and cached tables."""

from __future__ import annotations

import hashlib
import logging
import os
import sys
import tempfile
import zipfile
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import cache, wraps
from pathlib import Path
from threading import Lock
from typing import Any, ParamSpec, TypeVar, cast
from weakref import WeakValueDictionary

import numpy as np
import platformdirs
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from dockctl import geometry

Arrays = dict[str, NDArray[Any]]
Function = TypeVar("Function", bound=Callable[..., object])
P = ParamSpec("P")
T = TypeVar("T")
Result = TypeVar("Result")

CACHE_BYTES = 4_000_000_000
"""Maximum total size of all cached tables on disk."""
UNUSED_BYTES = 512_000_000
"""Maximum total size of unused results of `shared` functions that are kept."""
log = logging.getLogger(__name__)


@cache
def usable_cores() -> int:
    """Return the number of cores that this process may use; cached because every scan needs it."""
    return len(os.sched_getaffinity(0))


_WORKERS: list[ThreadPoolExecutor] = []


def workers() -> ThreadPoolExecutor:
    """Return the process's thread pool for compiled code that releases the GIL.

    All such work, scans and learning alike, runs in this pool and in the main thread, which together have one
    thread per core: with more threads, some would wait for one core while another is idle. A task must not
    wait for a task of the pool that may not have started.
    """
    if not _WORKERS:
        # They need the GIL for microseconds at a time, for which they would wait up to 5 ms by default.
        sys.setswitchinterval(2e-5)
        _WORKERS.append(ThreadPoolExecutor(max(1, usable_cores() - 1), thread_name_prefix="core"))
    return _WORKERS[0]


def on_all_cores(function: Callable[[T], object], items: Iterable[T], *, work: int = 1) -> None:
    """Call a function that releases the GIL with each item; this thread and the pool share the items.

    The function may itself use all cores: it runs tasks that the pool has not started in its own thread.

    Args:
        function: called with each item.
        items: in any number.
        work: amount of work, after which functions of `in_background` begin.
    """
    items = list(items)
    remaining = iter(items)  # the iterator of a list may be used by several threads

    def share() -> None:
        for item in remaining:
            function(item)

    others = [workers().submit(share) for _ in range(min(usable_cores(), len(items)) - 1)]
    _BACKGROUND.count(work)
    try:
        share()
    finally:
        for other in others:
            if not other.cancel():  # it started
                other.result()


def map_on_all_cores(function: Callable[[T], Result], items: Iterable[T]) -> list[Result]:
    """Return the results of a function for each item, in order; see `on_all_cores`."""
    items, results = list(items), dict[int, Result]()

    def keep(number: int) -> None:
        results[number] = function(items[number])

    on_all_cores(keep, range(len(items)))
    return [results[number] for number in range(len(items))]


class _Background:
    """Functions that the pool calls one after another, in the order in which they were given."""

    def __init__(self) -> None:
        self._waiting = deque[tuple[Callable[[], None], int]]()  # each with the work that it waits for
        self._begun = deque[Callable[[], None]]()
        self._lock, self._running, self._owed, self._work = Lock(), False, 0, 0

    def add(self, function: Callable[[], None], after: int) -> None:
        with self._lock:
            if not self._waiting:
                self._work = 0
            self._waiting.append((function, after))

    def count(self, work: int) -> None:
        """Let the pool call the next function if the work that it waits for has been done."""
        with self._lock:
            if self._waiting:
                after = self._waiting[0][1]
                self._work += min(work, after)
                if self._work >= after:
                    self._work -= after
                    self._begin_next()

    def begin(self, *, later: int) -> None:
        """Let the pool call all but the latest `later`."""
        with self._lock:
            while len(self._waiting) > later:
                self._begin_next()

    def drop(self) -> int:
        with self._lock:
            dropped = len(self._waiting)
            self._waiting.clear()
            return dropped

    def _begin_next(self) -> None:
        function, _ = self._waiting.popleft()
        self._begun.append(function)
        workers().submit(self._call_next)

    def _call_next(self) -> None:
        """Call the next function, after the one that another thread of the pool may be calling."""
        with self._lock:
            if self._running:
                self._owed += 1  # that thread calls it
                return
            self._running = True
        while True:
            self._begun.popleft()()
            with self._lock:
                if not self._owed:
                    self._running = False
                    return
                self._owed -= 1


_BACKGROUND = _Background()


def in_background(function: Callable[[], T], *, after: int = 1) -> Future[T]:
    """Call a function in the pool, after the next tasks of `on_all_cores` or after `begin_background`.

    In training, the scan of a step then uses all cores, and the function runs in parallel with the
    single-threaded work until the scan of the next step. If it started at once, it would delay the scan.
    Of several functions, a call to `on_all_cores` begins one at most. They run one after another.

    Args:
        function: called without arguments.
        after: work of `on_all_cores` since the function before it began.
    """
    result: Future[T] = Future()

    def run() -> None:
        try:
            result.set_result(function())
        except BaseException as error:
            result.set_exception(error)

    _BACKGROUND.add(run, after)
    return result


def begin_background(*, later: int = 0) -> None:
    """Let the pool call what was given to `in_background` and has not begun, except the latest `later`."""
    _BACKGROUND.begin(later=later)


def drop_background() -> int:
    """Forget the functions given to `in_background` that have not begun, and return their number."""
    return _BACKGROUND.drop()


def _after_fork() -> None:
    """Forget the threads of the parent, and their work: a forked child has none of them."""
    global _BACKGROUND
    _WORKERS.clear()
    _BACKGROUND = _Background()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def limit_blas_threads() -> None:
    """Keep BLAS in the calling thread: the matrices are small, and the simulator uses the other cores."""
    threadpool_limits(1, user_api="blas")


def compiled(**options: Any) -> Callable[[Function], Function]:
    """Return a decorator that compiles a function, caches it on disk and releases the GIL while it runs.

    Numba recompiles a function if its own file has changed, but not if a file with a function that it calls
    has changed. The name under which it is cached therefore includes a hash of the files it may call.
    If nothing can be cached, functions are compiled in every process.

    Args:
        options: options of `numba.njit`.
    """

    from numba import njit  # about half a second, which commands without a simulation do not need

    _announce_compilation()

    def decorate(function: Function) -> Function:
        function.__qualname__ += f"_{digest_of(Path(function.__code__.co_filename).parent)}"
        try:
            return cast("Function", njit(cache=True, nogil=True, **options)(function))
        except RuntimeError:  # no cache folder
            return cast("Function", njit(nogil=True, **options)(function))

    return decorate


@cache
def _announce_compilation() -> None:
    """Log a warning, which is shown by default, when a function is compiled that is not in the cache."""
    from numba.core import event

    @cache
    def announce() -> None:
        log.warning("compiling code that is not cached yet (once, up to a minute)")

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            if event.data["dispatcher"].py_func.__module__.startswith("dockctl."):
                announce()

        def on_end(self, event: Any) -> None:
            pass

    event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]  # numba has no types


@cache
def digest_of(folder: Path) -> str:
    """Hash the sources that compiled functions in a folder may call: the folder, geometry and noise."""
    sources = [path.read_bytes() for path in sorted(folder.glob("*.py"))]
    called = [source for source in sources if b"@compiled" in source]
    package = Path(geometry.__file__).parent
    shared = [(package / name).read_bytes() for name in ("geometry.py", "noise.py")]
    return hashlib.sha256(b"".join([*called, *shared])).hexdigest()[:12]


_announced: set[str] = set()
"""Tables of which this process has said that it builds them."""
_recent: dict[tuple[object, ...], tuple[object, int]] = {}
"""Results of `shared` functions that are kept, with their sizes, least recently used first."""


def shared(size: Callable[[Any], int]) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Return a decorator for a function whose calls with equal arguments share one result.

    They share it while it is in use. After that it is kept until more recent results of all such functions
    take `UNUSED_BYTES`.

    Args:
        size: estimates the size of a result [bytes].
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        in_use: WeakValueDictionary[tuple[object, ...], T] = WeakValueDictionary()

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> T:
            key = (function, args, tuple(kwargs.items()))
            result = in_use.get(key)
            if result is None:
                result = in_use[key] = function(*args, **kwargs)
            _recent.pop(key, None)
            _recent[key] = result, size(result)
            while sum(kept for _, kept in _recent.values()) > UNUSED_BYTES:
                del _recent[next(iter(_recent))]
            return result

        return call

    return decorate


def cache_folder() -> Path:
    """Return the folder of cached tables; ``XDG_CACHE_HOME`` moves it."""
    return platformdirs.user_cache_path("dockctl")


def cached(name: str, inputs: Iterable[bytes], build: Callable[[], Arrays]) -> Arrays:
    """Return the arrays that `build` computes, from the cache if possible.

    Safe to call from several processes: files are written atomically, and a damaged file is rebuilt. If the
    cache cannot be written, the arrays are computed every time.

    Args:
        name: description of the tables, for the file name and the log.
        inputs: everything that the arrays depend on, including the code.
        build: computes the arrays.
    """
    digest = hashlib.sha256()
    for data in inputs:
        digest.update(hashlib.sha256(data).digest())
    path = cache_folder() / f"{name.replace(' ', '-')}-{digest.hexdigest()[:24]}.npz"
    if not path.is_absolute():  # the user has no home directory
        return build()
    try:
        with np.load(path) as stored:
            arrays = dict(stored)
        os.utime(path)
        return arrays
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        if name not in _announced:  # one harbor of many
            log.warning("building the %s table (once, a few seconds)", name)
        _announced.add(name)
    arrays = build()
    try:
        _write(path, arrays)
    except OSError as error:
        log.info("the %s table cannot be cached: %s", name, error)
    return arrays


def _write(path: Path, arrays: Arrays) -> None:
    """Write the file atomically, then delete the least recently used files beyond `CACHE_BYTES`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, part = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        Path(part).replace(path)
    finally:
        Path(part).unlink(missing_ok=True)
    total, found = 0, []
    for stored in path.parent.glob("*.npz"):
        with suppress(FileNotFoundError):  # another process deleted it
            status = stored.stat()
            found.append((status.st_mtime, status.st_size, stored))
    for _, size, stored in sorted(found, reverse=True):
        total += size
        if total > CACHE_BYTES and stored != path:
            stored.unlink(missing_ok=True)
