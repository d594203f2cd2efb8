"""What all tests share."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest
from hypothesis import settings

from dockctl import plugins
from dockctl.scenarios import catalog

os.environ.setdefault("MPLBACKEND", "Agg")

# The same examples everywhere. No deadline: the first call of a compiled function pays for its compilation.
settings.register_profile("dockctl", deadline=None, derandomize=True)
settings.load_profile("dockctl")


@pytest.fixture(autouse=True)
def _own_registries(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let each test load plugins, and forget them after it."""
    catalog.fill()
    monkeypatch.setattr(plugins, "_loaded", {})
    saved = [(registry, registry.save()) for registry in plugins.GROUPS.values()]
    yield
    for registry, state in saved:
        registry.restore(state)
