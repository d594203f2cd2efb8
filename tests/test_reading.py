"""Files of unknown origin."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dockctl.errors import DockctlError
from dockctl.reading import read_limited, reading


def test_a_file_up_to_the_limit_is_read(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"12345")
    assert read_limited(tmp_path / "x", 5) == b"12345"


@pytest.mark.parametrize(
    "use",
    [lambda data: data["policy"].get("name"), lambda data: float(data["m"]), lambda data: next(iter([]))],
)
def test_unexpected_content_is_an_error_of_the_file(use: Callable[[Any], Any]) -> None:
    with pytest.raises(DockctlError, match=r"x\.json: cannot be read"), reading(Path("x.json")):
        use({"policy": "s1", "m": 10**400})


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("large", "out_of_range"),
        ("folder", "not_readable"),
        ("pipe", "not_readable"),
        ("gone", "not_found"),
        ("loop", "not_readable"),
        ("x" * 300, "not_readable"),
        ("a\0b", "not_readable"),
        ("/dev/zero", "not_readable"),
        ("/proc/self/environ", "not_readable"),
    ],
)
def test_anything_else_is_refused_at_once(tmp_path: Path, name: str, code: str) -> None:
    (tmp_path / "large").write_bytes(b"123456")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(DockctlError) as caught:
        read_limited(tmp_path / name, 5)
    assert caught.value.code == code
