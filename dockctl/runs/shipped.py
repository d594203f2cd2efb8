"""The checkpoints that come with the package."""

from __future__ import annotations

from pathlib import Path

import dockctl

FOLDER = Path(dockctl.__file__).parent / "checkpoints"


def shipped() -> dict[str, Path]:
    """Folder of each shipped checkpoint by its name."""
    return {file.parent.name: file.parent for file in sorted(FOLDER.glob("*/policy.json"))}
