"""Fixtures of all tests."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from filelock import FileLock, Timeout
from hypothesis import settings

from dockctl import plugins
from dockctl.experiments.portable import export_files
from dockctl.scenarios import catalog
from tests.compiling import PARTS

os.environ.setdefault("MPLBACKEND", "Agg")

# The same examples on every machine. No deadline: the first call of a compiled function includes compilation.
settings.register_profile("thorough", deadline=None, derandomize=True)
settings.register_profile("quick", settings.get_profile("thorough"), max_examples=15)


def pytest_configure(config: pytest.Config) -> None:
    """Try fewer examples where the thorough tests are left out."""
    settings.load_profile("quick" if "not thorough" in config.option.markexpr else "thorough")


def pytest_collection_finish() -> None:
    """Search what was imported, which lives until the end, for garbage once, not again in each collection."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _own_folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Use folders of the session instead of the user's; the workers of pytest-xdist share them."""
    base = tmp_path_factory.getbasetemp()
    session = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(session / "cache"))
        patch.setenv("XDG_STATE_HOME", str(session / "state"))
        yield


@pytest.fixture(scope="session", autouse=True)
def _signals_of_a_terminal() -> None:
    """Handle signals as in a terminal, also where `nohup` or a background job ignores them."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(scope="session", autouse=True)
def _compiled(_own_folders: None, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Share the compilation among the workers of pytest-xdist; else each would compile the same functions."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return
    session = tmp_path_factory.getbasetemp().parent
    for timeout in (0, -1):  # first the parts that nobody else is compiling, then wait for the others
        for name, compile_part in PARTS.items():
            with suppress(Timeout), FileLock(session / f"{name}.lock", timeout):
                compile_part()


@contextmanager
def own_registries() -> Iterator[None]:
    """Undo what is registered inside the block, as the end of a process does."""
    catalog.fill()
    saved = [(registry, registry.save()) for registry in plugins.GROUPS.values()]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plugins, "_loaded", {})
        yield
    for registry, state in saved:
        registry.restore(state)


@pytest.fixture(autouse=True)
def _own_registries() -> Iterator[None]:
    """Undo what a test registers."""
    with own_registries():
        yield


@pytest.fixture(scope="session")
def s3_pilot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped policy of scenario 3, exported for a boat."""
    path = tmp_path_factory.mktemp("pilot") / "s3.npz"
    export_files([Path("s3")], None, path)
    return path
