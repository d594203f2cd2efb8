"""The registry: names, origins, lazy entries and the two errors."""

from __future__ import annotations

import pytest

from dockctl.errors import DuplicateNameError, PluginError, UnknownNameError
from dockctl.plugins import Guard
from dockctl.registry import Registry, registering_as


def term(status: object, *, floor: float = 0.1, scale: float) -> None:
    pass


@pytest.fixture
def registry() -> Registry[object]:
    registry: Registry[object] = Registry("reward term")
    registry.register("distance", 1, kind="dense", source="eq. 3.10")
    return registry


def test_an_entry_has_name_origin_and_parameters(registry: Registry[object]) -> None:
    with registering_as("file mine.py"):
        assert registry.register("mine", term) is term
    entry = registry.get("mine")
    assert (entry.name, entry.origin, registry.origin("mine")) == ("mine", "file mine.py", "file mine.py")
    assert list(entry.parameters) == ["floor", "scale"]
    assert registry.get("distance").parameters == {}
    assert next((entry.name, entry.origin) for entry in registry) == ("distance", "dockctl")


def test_outside_of_a_plugin_the_origin_is_the_module(registry: Registry[object]) -> None:
    registry.register("mine", term)
    assert registry.origin("mine") == f"module {__name__}"


def test_an_error_of_code_without_a_source_file_is_reported(registry: Registry[object]) -> None:
    """As of a class that was typed in a shell."""
    registry.register("mine", type("Typed", (), {"__module__": "not_a_file"}))
    assert (registry.get("mine").file, registry.get("mine").place) == ("", "")
    with pytest.raises(PluginError, match="no thrust"), Guard(registry, "mine"):
        raise ValueError("no thrust")


def test_a_second_origin_is_rejected_and_both_are_named(registry: Registry[object]) -> None:
    with registering_as("file mine.py"), pytest.raises(DuplicateNameError) as caught:
        registry.register("distance", 2)
    assert caught.value.origins == ("dockctl", "file mine.py")


def test_an_unknown_name_has_the_nearest_as_suggestion(registry: Registry[object]) -> None:
    registry.register_lazily("speed", "package p 1", lambda: None)
    with pytest.raises(UnknownNameError) as caught:
        registry.get("sped")
    assert (caught.value.code, caught.value.suggestion) == ("unknown_name", "speed")
    assert registry.origin("sped") == ""


def test_a_lazy_entry_is_loaded_on_first_use(registry: Registry[object]) -> None:
    calls = []

    def load() -> None:
        calls.append("load")
        registry.register("speed", 3)

    registry.register_lazily("speed", "package p 1", load)
    assert registry.names() == ["distance", "speed"]
    assert "speed" in registry
    assert calls == []
    assert registry.get("speed").origin == "package p 1"
    assert registry.get("speed").value == 3
    assert calls == ["load"]


def test_a_lazy_entry_with_a_taken_name_is_rejected_on_first_use(registry: Registry[object]) -> None:
    registry.register_lazily("distance", "package p 1", lambda: None)
    registry.register_lazily("speed", "package p 1", lambda: None)
    registry.register_lazily("speed", "package q 2", lambda: None)
    for name, origins in {
        "distance": ("dockctl", "package p 1"),
        "speed": ("package p 1", "package q 2"),
    }.items():
        with pytest.raises(DuplicateNameError) as caught:
            registry.get(name)
        assert caught.value.origins == origins


def test_a_local_file_may_not_take_the_name_of_a_lazy_entry(registry: Registry[object]) -> None:
    registry.register_lazily("speed", "package p 1", lambda: None)
    with registering_as("file a.py"), pytest.raises(DuplicateNameError) as caught:
        registry.register("speed", 3)
    assert caught.value.origins == ("package p 1", "file a.py")


def test_unregister_and_restore(registry: Registry[object]) -> None:
    state = registry.save()
    with registering_as("file a.py"):
        registry.register("a", 1)
        registry.register("b", 2)
    registry.unregister("file a.py")
    assert registry.names() == ["distance"]
    registry.register_lazily("c", "package p 1", lambda: None)
    assert registry.names() == ["distance", "c"]
    registry.restore(state)
    assert registry.names() == ["distance"]
