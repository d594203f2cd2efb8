"""``dockctl returns``: its options, and a policy that does not dock."""

from __future__ import annotations

import shutil
from pathlib import Path

import pandas as pd
import pytest

from dockctl.analysis.returns import AT_START, DOCKING, break_even
from dockctl.commands.returns import parse_units
from dockctl.errors import DockctlError
from tests.commands.conftest import Outcome, dockctl


def test_parse_units() -> None:
    assert parse_units("20, 1") == (20.0, 1.0)
    for wrong in ("", "20,", "20,20", "0", "-1", "nan", "inf", "meters"):
        with pytest.raises(DockctlError):
            parse_units(wrong)


def test_a_policy_that_does_not_dock_is_compared_with_the_other_behaviors(
    trained: tuple[Path, Outcome], tmp_path: Path
) -> None:
    run = tmp_path / "run"
    shutil.copytree(trained[0], run)
    outcome = dockctl("returns", "--ckpt", run)
    assert outcome.code == 0, outcome.err
    table = pd.read_csv(run / "returns.csv")
    assert "docked" not in set(table["outcome"])
    assert table["behavior"].iloc[0] not in {DOCKING, AT_START}
    assert AT_START in set(table["behavior"])
    assert break_even(table) is None
    assert (run / "figures" / "returns.png").is_file()
