"""The local files that a scenario uses, and whether two scenarios are the same apart from names and paths."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from dockctl.reading import read_bytes
from dockctl.run_files import MESHES, PLUGINS, SCENARIO
from dockctl.scenarios.harbor import Fleet, Marina, is_model_file
from dockctl.scenarios.loader import dump
from dockctl.scenarios.schema import Scenario

LABELS = {"title", "description", "plugins"}
"""Fields that affect neither training nor episodes."""


def mesh_files(scenario: Scenario) -> tuple[Path, ...]:
    """Return the mesh files of the harbor and of its fleet."""
    return tuple(map(Path, [*(mesh.path for mesh in scenario.harbor.meshes), *_model_files(scenario)]))


def _model_files(scenario: Scenario) -> list[str]:
    fleet = scenario.harbor.fleet if isinstance(scenario.harbor, Marina) else Fleet()
    return [model for model in fleet.models if is_model_file(model)]


def with_paths(scenario: Scenario, plugins: Iterable[str], meshes: Iterable[str]) -> Scenario:
    """Return `scenario` with new paths for its plugins and, ordered as in `mesh_files`, its meshes."""
    harbor, paths = scenario.harbor, iter(meshes)
    moved = tuple(mesh.model_copy(update={"path": next(paths)}) for mesh in harbor.meshes)
    changes: dict[str, Any] = {"meshes": moved}
    if isinstance(harbor, Marina):
        models = (next(paths) if is_model_file(model) else model for model in harbor.fleet.models)
        changes["fleet"] = harbor.fleet.model_copy(update={"models": tuple(models)})
    changed = {"plugins": tuple(plugins), "harbor": harbor.model_copy(update=changes)}
    return scenario.model_copy(update=changed)


def self_contained(scenario: Scenario) -> dict[str, bytes]:
    """Return the files, by relative path, that a copy of the scenario needs to load anywhere.

    Raises:
        DockctlError: a local file of the scenario cannot be read.
    """
    files: dict[str, bytes] = {}

    def added(folder: str, paths: Iterable[Path]) -> list[str]:
        copies = {f"{folder}/{number:02d}-{path.name}": read_bytes(path) for number, path in enumerate(paths)}
        files.update(copies)
        return list(copies)

    plugins = added(PLUGINS, map(Path, scenario.plugins))
    moved = with_paths(scenario, plugins, added(MESHES, mesh_files(scenario)))
    return {SCENARIO: dump(moved).encode(), **files}


def first_difference(expected: Scenario, found: Scenario, *, ignore: Collection[str] = ()) -> str | None:
    """Describe the first field in which two scenarios differ; None if they are the same.

    Meshes are compared by their content, not by their path.

    Args:
        ignore: top-level fields that are not compared.

    Raises:
        OSError: a mesh cannot be read.
    """
    return _first_difference(_content(expected, ignore), _content(found, ignore))


def _content(scenario: Scenario, ignore: Collection[str]) -> dict[str, Any]:
    hashes = [hashlib.sha256(path.read_bytes()).hexdigest() for path in mesh_files(scenario)]
    return with_paths(scenario, (), hashes).model_dump(exclude={*LABELS, *ignore})


def _first_difference(expected: Any, found: Any, path: str = "") -> str | None:
    if isinstance(expected, dict) and isinstance(found, dict):
        fields = (
            _first_difference(expected.get(key), found.get(key), f"{path}.{key}".lstrip("."))
            for key in {**expected, **found}
        )
        return next((difference for difference in fields if difference), None)
    return None if expected == found else f"{path} is {_short(found)}, expected {_short(expected)}"


def _short(value: Any) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 40 else f"{text[:37]}..."
