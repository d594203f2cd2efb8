"""Plugins in installed packages, and how they fail."""

from __future__ import annotations

import importlib
import sys
from importlib.metadata import EntryPoint, EntryPoints

import pytest

from dockctl import plugins
from dockctl.errors import DuplicateNameError, InputError, PluginError
from dockctl.plugins import REWARD_TERMS, VESSELS
from dockctl.scenarios import loader
from tests.plugins.conftest import TERM, Write


class FakePoint(EntryPoint):
    """An entry point of a package that need not be installed."""

    dist = None


def declare(monkeypatch: pytest.MonkeyPatch, *points: tuple[str, str, str]) -> None:
    """Declare entry points (group, name, value) as if a package were installed."""
    listed = [FakePoint(name, value, group) for group, name, value in points]
    monkeypatch.setattr(plugins, "entry_points", lambda: EntryPoints(listed))
    plugins.discover.__wrapped__()


def test_installed_names_are_known_before_their_code_is_imported(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(write("lazy_terms.py", TERM.format(name="lazy")).parent)
    declare(monkeypatch, ("dockctl.rewards", "lazy", "lazy_terms:term"))
    assert "lazy" in REWARD_TERMS.names()
    assert "lazy_terms" not in sys.modules
    assert REWARD_TERMS.get("lazy").origin == "entry point lazy_terms:term"
    monkeypatch.delitem(sys.modules, "lazy_terms")


def test_a_module_imported_before_is_not_a_duplicate(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(write("eager_terms.py", TERM.format(name="eager")).parent)
    __import__("eager_terms")
    declare(monkeypatch, ("dockctl.rewards", "eager", "eager_terms:term"))
    assert REWARD_TERMS.get("eager").origin == "module eager_terms"
    monkeypatch.delitem(sys.modules, "eager_terms")


def test_a_module_and_the_same_file_as_a_plugin_are_one(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write("both_terms.py", TERM.format(name="both"))
    monkeypatch.syspath_prepend(path.parent)
    module = importlib.import_module("both_terms")
    importlib.reload(module)
    assert REWARD_TERMS.get("both").origin == "module both_terms"
    plugins.load_file(path)
    assert REWARD_TERMS.get("both").origin == f"file {path}"
    importlib.reload(module)
    assert REWARD_TERMS.get("both").origin == "module both_terms"
    monkeypatch.delitem(sys.modules, "both_terms")


def test_a_broken_package_does_not_break_the_others(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(write("good_terms.py", TERM.format(name="good")).parent)
    write("broken_terms.py", TERM.format(name="half") + "\nraise RuntimeError('no luck')\n")
    declare(
        monkeypatch,
        ("dockctl.rewards", "half", "broken_terms:term"),
        ("dockctl.rewards", "good", "good_terms:term"),
        ("dockctl.rewards", "absent", "good_terms:nothing"),
        ("dockctl.rewards", "other", "good_terms:term"),
        ("dockctl.rewards", "garbled", "good terms"),
    )
    assert REWARD_TERMS.get("good").kind == "dense"
    for name, location in {
        "half": r"broken_terms\.py:8",
        "absent": "good_terms:nothing",
        "other": "good_terms:term",
        "garbled": "good terms",
    }.items():
        for _ in range(2):
            with pytest.raises(PluginError, match=location):
                REWARD_TERMS.get(name)
    assert loader.load("s1").scenario.name == "s1"
    monkeypatch.delitem(sys.modules, "good_terms")


def test_two_packages_with_the_same_name(monkeypatch: pytest.MonkeyPatch) -> None:
    declare(monkeypatch, ("dockctl.rewards", "same", "a:f"), ("dockctl.rewards", "same", "b:f"))
    with pytest.raises(DuplicateNameError) as caught:
        REWARD_TERMS.get("same")
    assert caught.value.origins == ("entry point a:f", "entry point b:f")


def test_data_is_a_path_a_function_or_a_package(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write("boat.yaml", "extends: eilbrecht\nmass_kg: 200\n").parent
    (folder / "boats").mkdir()
    write(
        "boats/__init__.py",
        "FILE = __file__.replace('__init__.py', 'tug.yaml')\ndef path():\n    return FILE\nTEN = 10\n",
    )
    write("boats/tug.yaml", "extends: eilbrecht\nmass_kg: 300\n")
    monkeypatch.syspath_prepend(folder)
    declare(
        monkeypatch,
        ("dockctl.vessels", "tug", "boats"),
        ("dockctl.vessels", "tug-path", "boats:FILE"),
        ("dockctl.vessels", "tug-function", "boats:path"),
        ("dockctl.vessels", "tug-number", "boats:TEN"),
        ("dockctl.vessels", "gone", "boats"),
    )
    for name in ("tug", "tug-path", "tug-function"):
        assert loader.load_vessel(name).mass_kg == 300
        assert VESSELS.get(name).origin.startswith("entry point boats")
    with pytest.raises(PluginError, match="boats:TEN"):
        loader.load_vessel("tug-number")
    with pytest.raises(InputError, match=r"gone\.yaml"):
        loader.load_vessel("gone")
    monkeypatch.delitem(sys.modules, "boats")
