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


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the tests' tables out of the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True)
def _own_registries(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let each test load plugins, and forget them after it."""
    catalog.fill()
    monkeypatch.setattr(plugins, "_loaded", {})
    saved = [(registry, registry.save()) for registry in plugins.GROUPS.values()]
    yield
    for registry, state in saved:
        registry.restore(state)
