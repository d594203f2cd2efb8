"""Gymnasium environments; importing this package registers them."""

from dockctl.envs.registration import register_envs

register_envs()
