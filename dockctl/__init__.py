"""dockctl: train a small underactuated boat to dock in reverse by deep reinforcement learning.

`import dockctl.envs` registers the environments with Gymnasium. So does
`gymnasium.make("dockctl:dockctl/S3-v0")`, unless `dockctl` was imported before `gymnasium`.
"""

import importlib
import sys

__version__ = "0.1.0"

# True inside `gymnasium.make("dockctl:...")`. Gymnasium is not imported here, for a fast `dockctl --help`.
if "gymnasium" in sys.modules:
    importlib.import_module("dockctl.envs")
