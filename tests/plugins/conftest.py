"""A plugin with a reward term, and a fixture that writes files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

TERM = """
from dockctl.rewards.terms import reward_term

@reward_term("{name}", kind="dense", source="here")
def term(status, *, floor: float = 0.1, sizes: tuple[int, ...] = (), needed: bool):
    return status.distance_m
"""

Write = Callable[[str, str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str, str], Path]:
    def write(name: str, text: str) -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return write
