"""What all tests share: figures need no screen, and hypothesis draws the same examples everywhere."""

from __future__ import annotations

import os

from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")

# No deadline: the first example of a compiled function pays for its compilation.
settings.register_profile("dockctl", deadline=None, derandomize=True)
settings.load_profile("dockctl")
