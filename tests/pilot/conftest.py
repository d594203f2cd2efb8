"""Pilots of shipped policies."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.experiments.portable import export_files
from dockctl.pilot import Pilot
from tests.pilot.inputs import FINAL, INTERMEDIATE


@pytest.fixture
def pilot(s3_pilot: Path) -> Pilot:
    return Pilot.load(s3_pilot)


@pytest.fixture(scope="module")
def weather(tmp_path_factory: pytest.TempPathFactory) -> Pilot:
    """A shipped policy that observes wind, the speed through the water, and earlier steps."""
    path = tmp_path_factory.mktemp("weather") / "marinas-weather.npz"
    export_files([Path("marinas-weather")], None, path)
    return Pilot.load(path, final=FINAL, intermediate=INTERMEDIATE)
