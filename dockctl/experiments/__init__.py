"""Training and studies, and the Python API for them: ``from dockctl.experiments import train, resume``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dockctl.experiments.training import TrainedRun, resume, train

__all__ = ["TrainedRun", "resume", "train"]


def __getattr__(name: str) -> Any:
    """Import on first use: the command line imports this package, and `training` imports torch."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    from dockctl.experiments import training

    return getattr(training, name)
