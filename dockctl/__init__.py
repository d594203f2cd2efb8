"""dockctl: train a small underactuated boat to dock in reverse by deep reinforcement learning.

`gymnasium.make("dockctl:dockctl/S3-v0")` and `import dockctl.envs` register the environments with Gymnasium.
"""

import importlib
import sys

__version__ = "0.1.0"

# True inside `gymnasium.make("dockctl:...")`. Gymnasium is not imported here, for a fast `dockctl --help`.
if "gymnasium" in sys.modules:
    importlib.import_module("dockctl.envs")
