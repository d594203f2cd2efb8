"""The documented ways to make the environments known to Gymnasium."""

from __future__ import annotations

import subprocess
import sys

import pytest

NAMES = ["dockctl/Docking-v0", "dockctl/S1-v0", "dockctl/S2-v0", "dockctl/S3-v0"]


@pytest.mark.parametrize(
    "code",
    [
        "import dockctl.envs, gymnasium",
        "import gymnasium, dockctl.envs",
        "import gymnasium, dockctl",
        "import gymnasium; gymnasium.make('dockctl:dockctl/S1-v0')",
    ],
)
def test_names_are_registered(code: str) -> None:
    code += "; print(sorted(n for n in gymnasium.registry if n.startswith('dockctl/')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(NAMES)


def test_dockctl_alone_imports_nothing_heavy() -> None:
    code = "import sys, dockctl; assert not {'gymnasium', 'numpy', 'pydantic'} & {*sys.modules}; print('ok')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "ok"
