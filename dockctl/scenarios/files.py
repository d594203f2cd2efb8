"""The local files that a scenario takes part of its meaning from: plugins and meshes."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from dockctl.scenarios.schema import Scenario


def mesh_files(scenario: Scenario) -> tuple[Path, ...]:
    """Return the mesh files of the harbor."""
    return tuple(Path(mesh.path) for mesh in scenario.harbor.meshes)


def naming(scenario: Scenario, plugins: Iterable[str], meshes: Iterable[str]) -> Scenario:
    """Return `scenario` with other paths for its plugins, and for its meshes in their order."""
    harbor, pairs = scenario.harbor, zip(scenario.harbor.meshes, meshes, strict=True)
    moved = tuple(mesh.model_copy(update={"path": path}) for mesh, path in pairs)
    changed = {"plugins": tuple(plugins), "harbor": harbor.model_copy(update={"meshes": moved})}
    return scenario.model_copy(update=changed)
