"""Gymnasium knows the environments after ``import dockctl``, in whichever order the two are imported."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize("order", ["dockctl, gymnasium", "gymnasium, dockctl", "gymnasium, dockctl.envs"])
def test_names_are_known(order: str) -> None:
    code = f"import {order}; print(sorted(n for n in gymnasium.registry if n.startswith('dockctl/')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    expected = ["dockctl/Docking-v0", "dockctl/S1-v0", "dockctl/S2-v0", "dockctl/S3-v0"]
    assert done.stdout.strip() == str(expected)


def test_dockctl_alone_does_not_import_gymnasium() -> None:
    code = "import sys, dockctl; assert 'gymnasium' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
