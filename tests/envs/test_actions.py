"""Action types: the commands of the grid and of continuous actions, and what the environments accept."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from gymnasium.error import InvalidAction
from gymnasium.spaces import Box, Discrete
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

from dockctl.envs.actions import ContinuousActions, GridActions
from dockctl.envs.single import DockingEnv
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError, InputError
from dockctl.geometry import Floats
from dockctl.scenarios.loader import dump, load
from dockctl.scenarios.schema import PolicyInterface, Scenario
from dockctl.scenarios.vessel import Vessel
from tests.sim.worlds import walled

VESSEL = load("s1").scenario.vessel
CONTINUOUS = load("s1", overrides=["actions.kind=continuous"])


def test_the_grid_is_that_of_the_thesis() -> None:
    grid = GridActions()
    table = grid.commands(np.arange(77), VESSEL)
    assert grid.space(VESSEL) == Discrete(77)
    assert table[0] == pytest.approx([-50, -math.radians(30)])
    assert table[1] == pytest.approx([-50, -math.radians(20)])
    assert table[38] == pytest.approx([0, 0])
    assert table[76] == pytest.approx([50, math.radians(30)])
    assert len(np.unique(table, axis=0)) == 77


class FromOne(GridActions):
    """Actions 1 to 77, as a plugin may number them."""

    def space(self, vessel: Vessel) -> Discrete:
        return Discrete(77, start=1)


class Faster(GridActions):
    """The command depends on the previous one."""

    def next_commands(self, actions: NDArray[Any], vessel: Vessel, previous: Floats) -> Floats:
        return previous + self.commands(actions, vessel)


def test_only_actions_that_are_numbers_of_commands_have_a_table() -> None:
    table = GridActions().command_table(VESSEL)
    assert table is not None
    np.testing.assert_array_equal(table, GridActions().commands(np.arange(77), VESSEL))
    for other in (FromOne(), Faster(), ContinuousActions()):
        assert other.command_table(VESSEL) is None


def test_the_default_grid_spans_the_limits_of_the_vessel() -> None:
    strong = load("s1", overrides=["vessel.max_propeller_n=400", "vessel.max_rudder_deg=15"]).scenario
    table = strong.actions.commands(np.arange(77), strong.vessel)
    assert np.abs(table).max(axis=0) == pytest.approx([400, math.radians(15)])
    assert np.unique(table[:, 0]) == pytest.approx(np.arange(-400, 401, 80))
    assert np.unique(table[:, 1]) == pytest.approx(np.radians(np.arange(-15, 16, 5)))
    given = load("s1", overrides=["vessel.max_propeller_n=400", "actions.propeller_n=[-50,0,50]"]).scenario
    assert isinstance(given.actions, GridActions)
    assert given.actions.propeller_n == (-50, 0, 50)
    assert given.actions.rudder_deg == GridActions().rudder_deg


def test_a_grid_is_the_same_after_a_dump_and_on_another_vessel(tmp_path: Any) -> None:
    strong = load("s1", overrides=["vessel.max_propeller_n=400"]).scenario
    (tmp_path / "strong.yaml").write_text(dump(strong))
    assert load(tmp_path / "strong.yaml").scenario == strong
    weak = load("s1").scenario
    policy = PolicyInterface.of(weak)
    for interface in (policy, PolicyInterface.model_validate(policy.model_dump(mode="json"))):
        assert interface.on(strong).actions == weak.actions
    with pytest.raises(DockctlError):
        PolicyInterface.of(strong).on(weak)


def test_continuous_actions_are_fractions_of_the_limits() -> None:
    actions = np.array([[1, -1], [-0.5, 0.25]], np.float32)
    expected = [[50, -math.radians(30)], [-25, math.radians(7.5)]]
    assert ContinuousActions().space(VESSEL) == Box(-1, 1, (2,), np.float32)
    assert ContinuousActions().commands(actions, VESSEL) == pytest.approx(np.array(expected))


def test_incremental_actions_change_the_last_command() -> None:
    """Raise both to the limits in 5 and 3 steps, hold, lower the rudder alone; a start is from rest."""
    env = DockingVectorEnv(load("s1", overrides=["actions.kind=incremental"]), 2, worlds=[walled()])
    assert env.single_action_space == Discrete(9)
    env.reset(seed=0)
    taken = []
    for action in (8, 8, 8, 8, 8, 8, 4, 3):
        _, _, _, _, info = env.step(np.array([action, 4]))
        taken.append(info["command"][0])
        assert info["command"][1].tolist() == [0, 0]
    force, angle = np.transpose(taken)
    assert force == pytest.approx([10, 20, 30, 40, 50, 50, 50, 50])
    assert np.degrees(angle) == pytest.approx([10, 20, 30, 30, 30, 30, 30, 20])
    _, info = env.reset(options={"reset_mask": np.array([True, False])})
    assert info["command"][0].tolist() == [0, 0]
    _, _, _, _, info = env.step(np.array([0, 4]))
    assert info["command"][0] == pytest.approx([-10, -math.radians(10)])


@pytest.mark.parametrize("form", [{}, {"kind": "grid"}, {"propeller_n": list(range(-50, 51, 10))}])
def test_the_kind_is_optional(form: dict[str, Any]) -> None:
    """Scenarios and policy cards of older versions have no kind."""
    whole = load("s1").scenario.model_dump(mode="json")
    assert Scenario.model_validate({**whole, "actions": form}).actions == GridActions()
    interface = PolicyInterface.of(load("s1").scenario)
    card = {**interface.model_dump(mode="json"), "actions": form}
    assert PolicyInterface.model_validate(card) == interface


def test_a_dumped_scenario_loads_as_equal(tmp_path: Any) -> None:
    file = tmp_path / "continuous.yaml"
    file.write_text(dump(CONTINUOUS.scenario))
    assert load(file).scenario == CONTINUOUS.scenario


def test_commands_beyond_the_limits_are_located_in_the_file(tmp_path: Any) -> None:
    file = tmp_path / "strong.yaml"
    file.write_text("extends: s1\nactions:\n  propeller_n: [-60, 0]\n")
    with pytest.raises(InputError) as caught:
        load(file)
    (problem,) = caught.value.problems
    assert (problem.line, problem.column, problem.field) == (3, 16, "actions.propeller_n")


def test_a_continuous_environment() -> None:
    env = DockingVectorEnv(CONTINUOUS, 2, worlds=[walled()])
    assert env.single_action_space == Box(-1, 1, (2,), np.float32)
    env.reset(seed=0)
    for dtype in (np.float32, np.float64):
        *_, info = env.step(np.array([[1, 0], [0.5, -1]], dtype))
        assert info["command"] == pytest.approx(np.array([[50, 0], [25, -math.pi / 6]]))
    for wrong in ([[1, 0]], [[1, 0], [1.1, 0]], [[1, 0], [math.nan, 0]], [1, 0]):
        with pytest.raises(InvalidAction):
            env.step(np.array(wrong))


def test_continuous_single_environments_equal_the_vector() -> None:
    worlds = [walled()]
    ours = DockingVectorEnv(CONTINUOUS, 2, worlds=worlds)
    peer = SyncVectorEnv(
        [lambda: DockingEnv(CONTINUOUS, worlds=worlds)] * 2, autoreset_mode=AutoresetMode.SAME_STEP
    )
    assert np.array_equal(ours.reset(seed=1)[0], peer.reset(seed=1)[0])
    for action in np.random.default_rng(0).uniform(-1, 1, (5, 2, 2)).astype(np.float32):
        for mine, theirs in zip(ours.step(action)[:4], peer.step(action)[:4], strict=True):
            assert np.array_equal(mine, theirs)
