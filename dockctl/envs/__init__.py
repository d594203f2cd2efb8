"""Gymnasium environments; ``import dockctl.envs`` registers them."""

from __future__ import annotations

import gymnasium

SCENARIOS_BY_ID = {
    "dockctl/S1-v0": {"scenario": "s1"},
    "dockctl/S2-v0": {"scenario": "s2"},
    "dockctl/S3-v0": {"scenario": "s3"},
    "dockctl/Docking-v0": {},  # takes scenario=, a name or a path
}


def register_envs() -> None:
    """Register the environments with Gymnasium, once.

    Without `max_episode_steps`: the limit depends on the start, so the environment truncates by itself.
    """
    for name, kwargs in SCENARIOS_BY_ID.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="dockctl.envs.single:DockingEnv",
                vector_entry_point="dockctl.envs.vector:DockingVectorEnv",
                kwargs=dict(kwargs),
            )


register_envs()
