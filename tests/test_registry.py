"""Names, origins, offers and the two errors."""

from __future__ import annotations

import pytest

from dockctl.plugins import DuplicateNameError, Registry, UnknownNameError, contributing


def term(status: object, *, floor: float = 0.1, scale: float) -> None:
    pass


@pytest.fixture
def registry() -> Registry[object]:
    registry: Registry[object] = Registry("reward term")
    registry.register("distance", 1, kind="dense", source="eq. 3.10")
    return registry


def test_an_entry_knows_everything_about_itself(registry: Registry[object]) -> None:
    with contributing("file mine.py"):
        assert registry.register("mine", term) is term
    entry = registry.get("mine")
    assert (entry.name, entry.origin, registry.origin("mine")) == ("mine", "file mine.py", "file mine.py")
    assert list(entry.parameters) == ["floor", "scale"]
    assert registry.get("distance").parameters == {}
    assert next((entry.name, entry.origin) for entry in registry) == ("distance", "dockctl")


def test_what_registers_itself_outside_of_a_plugin_is_named_by_its_module(registry: Registry[object]) -> None:
    registry.register("mine", term)
    assert registry.origin("mine") == f"module {__name__}"


def test_a_second_owner_is_refused_and_both_are_named(registry: Registry[object]) -> None:
    message = "reward term 'distance' is registered twice: by dockctl and by file mine.py; rename one"
    with contributing("file mine.py"), pytest.raises(DuplicateNameError, match=message):
        registry.register("distance", 2)


def test_an_unknown_name_has_the_nearest_as_suggestion(registry: Registry[object]) -> None:
    registry.offer("speed", "package p 1", lambda: None)
    with pytest.raises(UnknownNameError) as caught:
        registry.get("sped")
    assert (caught.value.code, caught.value.suggestion) == ("unknown_name", "speed")
    assert registry.origin("sped") == ""


def test_an_offer_is_loaded_when_it_is_first_used(registry: Registry[object]) -> None:
    calls = []

    def load() -> None:
        calls.append("load")
        registry.register("speed", 3)

    registry.offer("speed", "package p 1", load)
    assert registry.names() == ["distance", "speed"]
    assert "speed" in registry
    assert calls == []
    assert registry.get("speed").origin == "package p 1"
    assert registry.get("speed").value == 3
    assert calls == ["load"]


def test_an_offer_of_a_taken_name_is_refused_when_it_is_used(registry: Registry[object]) -> None:
    registry.offer("distance", "package p 1", lambda: None)
    registry.offer("speed", "package p 1", lambda: None)
    registry.offer("speed", "package q 2", lambda: None)
    with pytest.raises(
        DuplicateNameError, match="'distance' is registered twice: by dockctl and by package p 1"
    ):
        registry.get("distance")
    with pytest.raises(
        DuplicateNameError, match="'speed' is registered twice: by package p 1 and by package q 2"
    ):
        registry.get("speed")


def test_a_local_file_may_not_take_an_offered_name(registry: Registry[object]) -> None:
    registry.offer("speed", "package p 1", lambda: None)
    with (
        contributing("file a.py"),
        pytest.raises(DuplicateNameError, match=r"by package p 1 and by file a\.py"),
    ):
        registry.register("speed", 3)


def test_withdraw_and_restore(registry: Registry[object]) -> None:
    state = registry.save()
    with contributing("file a.py"):
        registry.register("a", 1)
        registry.register("b", 2)
    registry.withdraw("file a.py")
    assert registry.names() == ["distance"]
    registry.offer("c", "package p 1", lambda: None)
    assert registry.names() == ["distance", "c"]
    registry.restore(state)
    assert registry.names() == ["distance"]
