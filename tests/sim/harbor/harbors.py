"""The reference harbor for tests."""

from __future__ import annotations

from pathlib import Path

import yaml
from pydantic import TypeAdapter

from dockctl.scenarios.harbor import HarborSpec, Marina
from dockctl.sim.harbor.build import Harbor, build_harbor

REFERENCE = Path(__file__).parents[3] / "scenarios" / "harbors" / "reference.yaml"


def reference_spec() -> Marina:
    spec = TypeAdapter(HarborSpec).validate_python(yaml.safe_load(REFERENCE.read_text()))
    assert isinstance(spec, Marina)
    return spec


def reference_harbor() -> Harbor:
    return build_harbor(reference_spec(), Path())
