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


VARIANTS = {
    "marina-fleet",
    "marina-l-basin",
    "marina-smooth",
    "marina-stern-to",
    "marina-t-head",
    "marina-unseen",
    "marinas",  # builds 64 layouts; tests/sim/harbor/test_layouts.py has fewer
    "marinas-weather",
    "s2-poses",
    "s3-appendix-b",
    "s3-direct",
    "s3-opposite",
}
"""Other values of what the other scenarios have; tests/commands/test_validate.py loads them, too."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "source",
    [
        pytest.param(source, marks=[pytest.mark.thorough] if source in VARIANTS else [], id=Path(source).stem)
        for source in (*SCENARIOS.names(), *FILES)
    ],
)
def test_scenario(source: str | Path) -> None:
    check_scenario(source)
