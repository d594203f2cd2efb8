"""dockctl: teach a small underactuated boat to dock in reverse, and measure how well it does.

After ``import dockctl``, Gymnasium knows the environments: ``gymnasium.make("dockctl/S3-v0")``.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

__version__ = "0.1.0"


class _NamesForGymnasium(MetaPathFinder):
    """Registers the environments when Gymnasium is imported.

    Gymnasium has no entry point for plugins, and importing it here would slow down ``dockctl --help``.
    """

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_register(module: ModuleType) -> None:
                load(module)
                importlib.import_module("dockctl.envs")

            spec.loader.exec_module = load_and_register  # type: ignore[method-assign]  # the hook itself
        return spec


if "gymnasium" in sys.modules:
    importlib.import_module("dockctl.envs")
else:
    sys.meta_path.insert(0, _NamesForGymnasium())
