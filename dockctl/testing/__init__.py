"""Contract tests for everything that can be registered; call them from your own tests.

    from dockctl.testing import check_reward_term

    def test_smooth_rudder():
        check_reward_term("smooth_rudder", scale_deg=30.0)

Each function returns None, or raises a `ContractError`: an `AssertionError` with the name of the broken rule.
Import the module that registers the name first, or install its package. Values are random but the same in
every run.
"""

from dockctl.testing.algorithms import check_algorithm
from dockctl.testing.contract import ContractError
from dockctl.testing.environments import check_policy, check_scenario, open_water
from dockctl.testing.parts import (
    check_action_type,
    check_condition,
    check_harbor,
    check_observation_part,
    check_range_sensor,
    check_reward_term,
    check_vessel,
)

__all__ = [
    "ContractError",
    "check_action_type",
    "check_algorithm",
    "check_condition",
    "check_harbor",
    "check_observation_part",
    "check_policy",
    "check_range_sensor",
    "check_reward_term",
    "check_scenario",
    "check_vessel",
    "open_water",
]
