"""Cached tables are never wrong or torn; compiled functions are cached, and never stale."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, wait
from functools import partial
from pathlib import Path
from threading import Event, Lock, current_thread, main_thread

import numpy as np
import pytest

from dockctl import compute
from dockctl.compute import cache_folder, cached

CALLEE = """
from dockctl.compute import compiled

@compiled()
def callee(x):
    return x + {added}
"""
CALLER = """
from callee import callee
from dockctl.compute import compiled

@compiled()
def caller(x):
    return 10 * callee(x)
"""
ASK = "from caller import caller; print(caller(1), sum(caller.stats.cache_hits.values()))"
NOWHERE = """
import numba.core.caching
numba.core.caching.CacheImpl._locator_classes = []
"""


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def table(size: int) -> dict[str, np.ndarray]:
    return {"squares": np.arange(size) ** 2}


def never() -> dict[str, np.ndarray]:
    raise AssertionError("built again")


def test_the_second_call_builds_nothing() -> None:
    cached("squares", [b"10"], lambda: table(10))
    np.testing.assert_array_equal(cached("squares", [b"10"], never)["squares"], np.arange(10) ** 2)


def test_building_tables_of_one_kind_is_shown_once(caplog: pytest.LogCaptureFixture) -> None:
    for harbor in (b"one", b"another", b"one"):
        cached("shown squares", [harbor], lambda: table(10))
    (record,) = caplog.records
    assert record.levelname == "WARNING"


def test_every_input_counts() -> None:
    cached("squares", [b"10", b"x"], lambda: table(10))
    for other in ([b"10"], [b"10", b"y"], [b"1", b"0x"], [b"10x"]):
        assert len(cached("squares", other, lambda: table(3))["squares"]) == 3


@pytest.mark.parametrize("content", [b"", b"not a table", b"PK\x03\x04 torn"])
def test_a_damaged_file_is_rebuilt(content: bytes) -> None:
    cached("squares", [b"10"], lambda: table(10))
    (file,) = cache_folder().glob("*.npz")
    file.write_bytes(content)
    assert len(cached("squares", [b"10"], lambda: table(10))["squares"]) == 10
    cached("squares", [b"10"], never)


def test_a_truncated_file_is_rebuilt() -> None:
    cached("squares", [b"10"], lambda: table(10_000))
    (file,) = cache_folder().glob("*.npz")
    file.write_bytes(file.read_bytes()[:-2000])
    assert len(cached("squares", [b"10"], lambda: table(10))["squares"]) == 10


def test_without_a_writable_folder_tables_are_built_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nowhere")
    assert len(cached("squares", [b"10"], lambda: table(10))["squares"]) == 10


def test_the_least_recently_used_files_are_deleted_beyond_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    cached("squares", [b"0"], lambda: table(1000))
    (first,) = cache_folder().iterdir()
    monkeypatch.setattr(compute, "CACHE_BYTES", 3 * first.stat().st_size + 10)
    for index in range(1, 6):
        cached("squares", [str(index).encode()], lambda: table(1000))
        for age, file in enumerate(sorted(cache_folder().iterdir(), key=lambda file: file.stat().st_mtime)):
            os.utime(file, (age, age))  # time stamps of the file system may be equal
        cached("squares", [b"0"], never)
    assert len(list(cache_folder().iterdir())) == 3
    assert first.exists()
    for index in (4, 5):
        cached("squares", [str(index).encode()], never)


def test_a_table_larger_than_the_limit_is_cached_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compute, "CACHE_BYTES", 10)
    for name in (b"a", b"b"):
        cached("squares", [name], lambda: table(1000))
        cached("squares", [name], never)
    assert len(list(cache_folder().iterdir())) == 1


def _race(index: int) -> int:
    return len(cached("squares", [b"same"], lambda: table(100_000))["squares"])


def test_many_processes_at_once() -> None:
    with ProcessPoolExecutor(4) as pool:
        assert list(pool.map(_race, range(16))) == [100_000] * 16
    assert len(list(cache_folder().iterdir())) == 1


def test_without_a_home_directory_tables_are_built_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dockctl.compute.cache_folder", lambda: Path("~/.cache/dockctl"))
    monkeypatch.chdir(tmp_path)
    assert len(cached("squares", [b"10"], lambda: table(10))["squares"]) == 10
    assert list(tmp_path.iterdir()) == []


def ask(folder: Path, before: str = "") -> tuple[int, int]:
    """Call the caller in a new process; return its result and the number of cache hits."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", before + ASK], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    answer, hits = done.stdout.split()
    return int(answer), int(hits)


@pytest.mark.slow
def test_a_function_is_cached_until_one_that_it_calls_changes(tmp_path: Path) -> None:
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE.format(added=1))
    assert ask(tmp_path) == (20, 0)
    assert ask(tmp_path) == (20, 1)
    (tmp_path / "callee.py").write_text(CALLEE.format(added=2))
    assert ask(tmp_path) == (30, 0)


@pytest.mark.slow
def test_without_a_cache_folder_functions_are_compiled_in_every_process(tmp_path: Path) -> None:
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE.format(added=1))
    assert ask(tmp_path, NOWHERE) == (20, 0)


@pytest.fixture
def _two_cores(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The main thread and a pool of one thread."""
    monkeypatch.setattr(compute, "usable_cores", lambda: 2)
    monkeypatch.setattr(compute, "_WORKERS", [])
    yield
    compute.workers().shutdown()


@pytest.mark.usefixtures("_two_cores")
def test_the_pool_helps_before_it_begins_what_was_given_last() -> None:
    order: list[str] = []
    begun, released, helped = Event(), Event(), Event()

    def first() -> None:
        begun.set()
        assert released.wait(10)
        order.append("first")

    def item(number: int) -> None:
        released.set()
        if current_thread() is main_thread():
            assert helped.wait(10)
        else:
            order.append("help")
            helped.set()

    earlier = compute.in_background(first)
    later = compute.in_background(lambda: order.append("second"))
    compute.begin_background(later=1)
    assert begun.wait(10)
    compute.on_all_cores(item, range(2))
    earlier.result(10)
    later.result(10)
    assert order == ["first", "help", "second"]


def test_functions_in_the_background_run_one_after_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also with many threads; each call to `on_all_cores` begins one."""
    monkeypatch.setattr(compute, "usable_cores", lambda: 5)
    monkeypatch.setattr(compute, "_WORKERS", [])
    order, running = list[int](), Lock()

    def run(number: int) -> None:
        assert running.acquire(blocking=False)
        time.sleep(0.01)
        order.append(number)
        running.release()

    results = [compute.in_background(partial(run, number)) for number in range(20)]
    for _ in range(5):
        compute.on_all_cores(lambda item: None, range(1))
    assert [result.result(10) for result in results[:5]] == [None] * 5
    time.sleep(0.05)
    assert order == list(range(5))
    compute.begin_background(later=1)
    assert [result.result(10) for result in results[:19]] == [None] * 19
    assert order == list(range(19))
    compute.begin_background()
    results[-1].result(10)
    compute.workers().shutdown()


@pytest.mark.usefixtures("_two_cores")
def test_a_function_in_the_background_waits_for_an_amount_of_work() -> None:
    """Work beyond what the next function waits for does not count for the one after it."""
    order = list[int]()
    results = [compute.in_background(partial(order.append, number), after=6) for number in range(5)]
    for work in (6, 5, 1, 100, 5):
        compute.on_all_cores(lambda item: None, range(1), work=work)
    wait(results[:3])
    assert compute.drop_background() == 2
    compute.begin_background()
    assert order == [0, 1, 2]
    assert not any(result.done() for result in results[3:])
    following = compute.in_background(partial(order.append, 5), after=2)
    compute.on_all_cores(lambda item: None, range(1))
    assert not following.done()
    compute.on_all_cores(lambda item: None, range(1))
    following.result(10)
    assert order == [0, 1, 2, 5]


@pytest.mark.usefixtures("_two_cores")
def test_results_and_errors_from_the_background() -> None:
    seven, error = compute.in_background(lambda: 7), compute.in_background(lambda: 1 / 0)
    compute.begin_background()
    assert seven.result(10) == 7
    with pytest.raises(ZeroDivisionError):
        error.result(10)


@pytest.mark.parametrize("cores", [1, 2, 5])
def test_a_function_on_all_cores_may_use_all_cores_itself(
    cores: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compute, "usable_cores", lambda: cores)
    monkeypatch.setattr(compute, "_WORKERS", [])

    def times_table(row: int) -> list[int]:
        return compute.map_on_all_cores(lambda column: row * column, range(row))

    with ThreadPoolExecutor(1) as watched:  # so that a deadlock fails the test
        tables = watched.submit(compute.map_on_all_cores, times_table, range(40)).result(30)
    compute.workers().shutdown()
    assert tables == [[row * column for column in range(row)] for row in range(40)]


@pytest.mark.usefixtures("_two_cores")
def test_an_error_on_all_cores_is_raised() -> None:
    with pytest.raises(ZeroDivisionError):
        compute.map_on_all_cores(lambda number: 1 // number, [2, 1, 0])
