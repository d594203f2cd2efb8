"""What the package registers keeps the contract."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, Space

from dockctl import testing
from dockctl.envs.vector import DockingVectorEnv
from dockctl.evaluation.loading import load_policy
from dockctl.plugins import (
    ACTIONS,
    ALGORITHMS,
    CONDITIONS,
    HARBORS,
    OBSERVATION_PARTS,
    POLICIES,
    RANGE_SENSORS,
    REWARD_TERMS,
    VESSELS,
)
from dockctl.registry import Registry
from dockctl.scenarios import catalog
from dockctl.scenarios.base import FieldError, Number
from dockctl.scenarios.extensions import Condition, Disturbance, Drawn

catalog.fill()


def examples(registry: Registry[type[Any]]) -> list[tuple[str, dict[str, Any]]]:
    """Return the kinds of a registry, each with the keys of its examples."""
    return [(entry.name, keys) for entry in registry for keys in entry.value.examples]


@pytest.mark.parametrize("name", REWARD_TERMS.names())
def test_reward_terms(name: str) -> None:
    testing.check_reward_term(name)


@pytest.mark.parametrize("name", OBSERVATION_PARTS.names())
def test_observation_parts(name: str) -> None:
    testing.check_observation_part(name)


@pytest.mark.parametrize("kind", ACTIONS.names())
def test_action_types(kind: str) -> None:
    testing.check_action_type(kind)


@pytest.mark.parametrize(("kind", "keys"), examples(CONDITIONS))
def test_conditions(kind: str, keys: dict[str, Any]) -> None:
    testing.check_condition(kind, **keys)


@pytest.mark.parametrize(("kind", "keys"), examples(RANGE_SENSORS))
def test_range_sensors(kind: str, keys: dict[str, Any]) -> None:
    testing.check_range_sensor(kind, **keys)


@pytest.mark.parametrize(("kind", "keys"), examples(ALGORITHMS))
def test_algorithms(kind: str, keys: dict[str, Any]) -> None:
    if kind == "sb3":
        pytest.importorskip("stable_baselines3")
    spaces: list[Space[Any]] = [Discrete(7), Box(np.float32([-2, 0]), np.float32([1, 3]))]
    refusals = []
    for space in spaces:
        try:
            testing.check_algorithm(kind, space, **keys)
        except FieldError as refusal:
            refusals.append(refusal.field)
    assert len(refusals) < len(spaces)
    assert all(field.startswith(("actions", "training.algorithm")) for field in refusals)


@pytest.mark.parametrize("name", ["s1", *POLICIES.names()])
def test_policies(name: str) -> None:
    policy = load_policy(name)
    env = DockingVectorEnv(policy.scenario("s1"), 3)
    testing.check_policy(policy.make(env), env)


@pytest.mark.parametrize("registry", [CONDITIONS, RANGE_SENSORS, ALGORITHMS], ids=lambda each: each.noun)
def test_every_condition_sensor_and_algorithm_is_checked(registry: Registry[type[Any]]) -> None:
    assert registry.names()
    assert {kind for kind, _ in examples(registry)} == {*registry.names()}


@pytest.mark.parametrize("name", VESSELS.names())
def test_vessels(name: str) -> None:
    testing.check_vessel(name)


@pytest.mark.parametrize("name", HARBORS.names())
def test_harbors(name: str) -> None:
    testing.check_harbor(name)


@pytest.mark.parametrize("sectors", [4, 12, 360])
def test_rays_on_the_edges_of_sectors_are_accepted(sectors: int) -> None:
    testing.check_range_sensor("planar", sectors=sectors)


def test_a_number_is_a_default_of_a_condition_that_draws() -> None:
    class Tide(Condition):
        kind: Literal["tide"] = "tide"  # type: ignore[assignment]
        speed_mps: Drawn[Number] = 0.05  # type: ignore[assignment]

        def build(self, num_boats: int) -> Disturbance:
            return Disturbance()

    assert Tide().speed_mps == (0.05,)
    assert Tide().model_dump(mode="json")["speed_mps"] == 0.05
