"""A reward term in one file: name it in a scenario under `plugins`, or give it with --plugin."""

import numpy as np

from dockctl.rewards.terms import reward_term


@reward_term("gentle_turns", kind="dense", source="examples/local-term")
def gentle_turns(status, *, limit_radps: float = 0.03):
    """Return by how much the yaw rate exceeds `limit_radps`, (n,) [rad/s]."""
    return np.maximum(np.abs(status.nu[:, 2]) - limit_radps, 0.0)
