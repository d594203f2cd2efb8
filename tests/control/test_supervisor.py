"""The supervisor of a policy, against the simulator itself: what would have happened otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.random import default_rng

from dockctl.agents.interface import Info, Policy
from dockctl.control.supervisor import RECOVERY_S, WAITING_S
from dockctl.evaluation import rollout
from dockctl.evaluation.rollout import Episode, Rollout
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import PolicyInterface
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import Start, given_start, own_site
from tests.evaluation.fixed_policies import AHEAD, REST, Values, only
from tests.sim.worlds import walled


@cache
def in_marina(*, supervisor: bool) -> Rollout:
    return Rollout(load("s3", overrides=[f"evaluation.supervisor={supervisor}", "task.max_steps=40"]))


@pytest.fixture(scope="module", autouse=True)
def _released() -> Iterator[None]:
    """Another test counts the environments that are alive."""
    yield
    in_marina.cache_clear()


def starts(task: Rollout, *poses: tuple[float, float, float]) -> list[Start]:
    site = own_site(task.scenario)
    return [given_start(site, task.scenario.task, np.array(pose), i) for i, pose in enumerate(poses)]


def run(policy: Policy, *poses: tuple[float, float, float], supervisor: bool) -> list[Episode]:
    task = in_marina(supervisor=supervisor)
    return task.run(policy, starts(task, *poses), clearance=False)


def free_poses(count: int, seed: int, within_m: float) -> list[tuple[float, float, float]]:
    """Return random reachable poses with something this close to the hull."""
    task, rng, found = in_marina(supervisor=False), default_rng(seed), []
    obstacles, goal = task.worlds[0].obstacles, own_site(task.scenario).goals[1]
    while len(found) < count:
        x, y, heading = pose = rng.uniform((-15, -15, -np.pi), (35, 15, np.pi))
        if (
            obstacles.clearance_below(pose[None], within_m)[0] < within_m
            and not obstacles.unreachable(pose[None], goal)[0]
        ):
            found.append((float(x), float(y), float(heading)))
    return found


@pytest.mark.parametrize("seed", range(2))
def test_a_supervised_boat_that_starts_at_rest_never_collides(seed: int) -> None:
    """The policy drives at full thrust in random directions; the simulator says whether it collides."""
    rng, poses = default_rng(seed), free_poses(5, seed, within_m=1)
    strong = np.r_[0:14, 63:77]
    values = np.array([only(action) for action in np.repeat(rng.choice(strong, 8), 5).tolist()])
    values += 0.1 * rng.random(values.shape)
    without = [episode.outcome for episode in run(Values(*values), *poses, supervisor=False)]
    assert without.count("collision") > 0
    with_it = [episode.outcome for episode in run(Values(*values), *poses, supervisor=True)]
    assert "collision" not in with_it


def test_the_best_action_with_which_the_simulator_stops_in_time_replaces_an_unsafe_one() -> None:
    """Boats on their way to a wall; contact is found to 2 mm, so walls 5 mm apart bound what is safe."""
    loaded = load("s1", overrides=["evaluation.supervisor=true"])
    task, farther, closer = (Rollout(loaded, [walled(x)]) for x in (20.0, 20.005, 19.995))
    every = loaded.scenario.actions.commands(np.arange(77), loaded.scenario.vessel).tolist()
    replaced, rng = 0, default_rng(5)
    for distance in np.linspace(0.02, 0.5, 40):
        values, nu = rng.random(77).astype(np.float32), np.array([rng.uniform(0.2, 0.4), 0.0, 0.0])
        (start,) = starts(task, (20 - distance, 0.0, rng.uniform(-0.8, 0.8)))
        start, order = replace(start, nu=nu, max_steps=1), (-values).argsort().tolist()
        (episode,) = task.run(Values(values), [start], clearance=False)
        rank = order.index(every.index(episode.trajectory["command"][1].tolist()))
        assert not any(stops_in_time(closer, start, action) for action in order[:rank])
        if rank:
            assert stops_in_time(farther, start, order[rank])
        elif not stops_in_time(farther, start, order[0]):  # then no action is safe
            assert not any(stops_in_time(closer, start, action) for action in order)
        replaced += rank > 0
    assert 10 <= replaced <= 30


def stops_in_time(task: Rollout, start: Start, action: int) -> bool:
    """Whether a boat that takes the action, and no thrust after it, does not collide within 10 s."""
    simulator = Simulator(task.scenario, task.worlds, 1)
    simulator.reset(np.array([0]), [start])
    actions = [action, *[REST] * 20]
    commands = task.scenario.actions.commands(np.array(actions), task.scenario.vessel)
    return not any(simulator.step(command[None]).collided[0] for command in commands)


def test_in_open_water_nothing_is_replaced() -> None:
    loaded = load("s1", overrides=["evaluation.supervisor=true", "task.max_steps=30"])
    task, values = Rollout(loaded, [walled()]), default_rng(0).random((30, 77))
    (episode,) = task.run(Values(*values), starts(task, (20.0, 0.0, 2.8)), clearance=False)
    expected = loaded.scenario.actions.commands(values.argmax(axis=1), loaded.scenario.vessel)
    np.testing.assert_array_equal(episode.trajectory["command"][1:], expected[: episode.steps])


def test_a_waiting_boat_moves_away(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = load("s1", overrides=["evaluation.supervisor=true", "task.max_steps=80"])
    trajectories = []
    for boats in (1, 3):
        monkeypatch.setattr(rollout, "PARALLEL_BOATS", boats)
        task = Rollout(loaded, [walled()])
        poses = [(20.0, y, 2.8) for y in (0.0, 5.0, 10.0)]
        episodes = task.run(Values(only(REST)), starts(task, *poses), clearance=False)
        trajectories.append([episode.trajectory["command"] for episode in episodes])
    waiting, recovery = (
        round(time / loaded.scenario.vessel.control_period_s) for time in (WAITING_S, RECOVERY_S)
    )
    thrust = trajectories[0][0][1:, 0] != 0
    assert not thrust[:waiting].any()
    assert thrust[waiting : waiting + recovery].all()
    assert not thrust[waiting + recovery : 2 * waiting].any()
    for together, alone in zip(*trajectories, strict=True):
        np.testing.assert_array_equal(together, alone)
        np.testing.assert_array_equal(together, trajectories[0][0])


def test_a_policy_without_action_values_runs_as_it_is() -> None:
    class Ahead(Policy):
        def act(self, observation: np.ndarray, info: Info) -> np.ndarray:
            return np.full(len(observation), AHEAD)

    pose = free_poses(1, seed=2, within_m=2)[0]
    (episode,) = run(Ahead(), pose, supervisor=True)
    assert (episode.trajectory["command"][1:, 0] == 50).all()


def test_a_scenario_decides_before_the_policy() -> None:
    """`marinas` has a supervisor, the drawn harbors leave it to the policy."""
    interface, other = PolicyInterface.of(load("marinas").scenario), "marina-l-basin"
    assert interface.on(load(other).scenario).evaluation.supervisor is True
    without = load(other, overrides=["evaluation.supervisor=false"]).scenario
    assert interface.on(without).evaluation.supervisor is False
    assert PolicyInterface.of(load("marina").scenario).on(load(other).scenario).evaluation.supervisor is None
    assert interface.agrees(without, load(other).scenario)
