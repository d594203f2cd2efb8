"""Every registered scenario and those of the examples, under the contract of `dockctl.testing`."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.plugins import SCENARIOS
from dockctl.scenarios import catalog
from dockctl.testing import check_scenario

catalog.fill()
EXAMPLES = Path(__file__).parents[2] / "examples"
FILES = [
    EXAMPLES / "custom-boat/s1-launch.yaml",
    EXAMPLES / "custom-harbor/s1-pontoon.yaml",
    EXAMPLES / "glb-harbor/fishing-harbor.yaml",
    EXAMPLES / "local-term/s1-gentle.yaml",
]


@pytest.mark.slow
@pytest.mark.parametrize("source", [*SCENARIOS.names(), *FILES], ids=lambda source: Path(source).stem)
def test_scenario(source: str | Path) -> None:
    check_scenario(source)
