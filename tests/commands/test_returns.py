"""``dockctl returns``: its options, and a policy that does not dock."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from dockctl.commands.returns import parse_units
from dockctl.errors import DockctlError
from tests.commands.conftest import Outcome, dockctl


def test_parse_units() -> None:
    assert parse_units("20, 1") == (20.0, 1.0)
    for wrong in ("", "20,", "20,20", "0", "-1", "nan", "inf", "meters"):
        with pytest.raises(DockctlError):
            parse_units(wrong)


def test_a_policy_must_dock(trained: tuple[Path, Outcome], tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(trained[0], run)
    outcome = dockctl("returns", "--ckpt", run)
    assert outcome.code == 2
    assert outcome.error_code == "mismatch"
    assert not (run / "returns.csv").exists()
