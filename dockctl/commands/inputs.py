"""Load a scenario for a command, with the checks that need the harbor's geometry."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dockctl.errors import InputError

if TYPE_CHECKING:
    from dockctl.scenarios.loader import LoadedScenario


def load_checked(
    source: str | Path, *, overrides: Sequence[str] = (), plugin_files: Sequence[Path] = ()
) -> LoadedScenario:
    """Load `source` and make sure that its meshes are there and that no pose lies inside an obstacle.

    Raises:
        InputError: every problem of the scenario, each with its place.
        DockctlError: the scenario or a plugin does not exist.
    """
    from dockctl.scenarios.loader import load
    from dockctl.sim.checks import check_poses

    loaded = load(source, overrides=overrides, plugin_files=plugin_files)
    try:
        found = check_poses(loaded.scenario, loaded.base_dir)
    except InputError as error:  # a mesh file, which knows the field that names it but not the line
        found = [(problem.field, f"{problem.file} {problem.message}") for problem in error.problems]
    if found:
        raise InputError(loaded.problem(path, message) for path, message in found) from None
    return loaded
