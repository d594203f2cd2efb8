"""Gymnasium environments; importing this package registers their names."""

from dockctl.envs.registration import register_envs

register_envs()
