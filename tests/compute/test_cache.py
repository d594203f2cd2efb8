"""The cache of tables: atomic files, and never the wrong table."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from dockctl.compute.cache import MAX_FILES, cache_folder, cached


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


def test_old_files_are_deleted() -> None:
    for index in range(MAX_FILES + 5):
        cached("squares", [bytes([index])], lambda: table(10))
    assert len(list(cache_folder().iterdir())) == MAX_FILES


def _race(index: int) -> int:
    return len(cached("squares", [b"same"], lambda: table(100_000))["squares"])


def test_many_processes_at_once() -> None:
    with ProcessPoolExecutor(4) as pool:
        assert list(pool.map(_race, range(16))) == [100_000] * 16
    assert len(list(cache_folder().iterdir())) == 1


def test_without_a_home_directory_tables_are_built_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dockctl.compute.cache.cache_folder", lambda: Path("~/.cache/dockctl"))
    monkeypatch.chdir(tmp_path)
    assert len(cached("squares", [b"10"], lambda: table(10))["squares"]) == 10
    assert list(tmp_path.iterdir()) == []
