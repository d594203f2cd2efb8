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

    loaded = load(source, overrides=overrides, plugin_files=plugin_files)
    try:
        from dockctl.sim.checks import check_poses
    except ModuleNotFoundError:
        return loaded
    found = check_poses(loaded.scenario, loaded.base_dir)
    if found:
        raise InputError(loaded.problem(path, message) for path, message in found)
    return loaded
