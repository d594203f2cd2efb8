"""What is timed is what the environment and `Rollout` do. No test asserts a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dockctl.agents.interface import Policy
from dockctl.analysis.latency import OPTIONAL, PARTS
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.evaluation import Rollout, load_policy
from dockctl.evaluation.latency import time_decisions
from dockctl.evaluation.starts import evaluation_starts
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import ObservationPart

HISTORY: dict[str, Any] = {"part": "history", "params": {"steps": 2, "parts": ["velocity", "command"]}}


@pytest.mark.parametrize("past_steps", [0, 2])
def test_the_timed_observation_equals_that_of_the_environment(
    monkeypatch: pytest.MonkeyPatch, past_steps: int
) -> None:
    scenario = load("s1").scenario
    with_history = (*scenario.observation, ObservationPart.model_validate(HISTORY))
    observation = with_history if past_steps else scenario.observation
    env = DockingVectorEnv(scenario.model_copy(update={"observation": observation}), 1)
    timed: list[NDArray[np.float32]] = []

    class Ahead(Policy):
        def act(self, observation: NDArray[np.float32], info: Any) -> NDArray[np.int64]:
            timed.append(observation)
            return np.array([40 + len(timed) % 3])

    seen = [env.reset(seed=0, options={"poses": np.array([[20.0, 2.0, np.radians(160)]])})[0]]
    step = env.step

    def recording(actions: np.ndarray) -> Any:
        result = step(actions)
        seen.append(result[0])
        return result

    monkeypatch.setattr(env, "step", recording)
    time_decisions(env, Ahead(), 10)
    count = min(len(timed), len(seen)) - 1  # the last step may start another episode
    assert count >= 20
    assert np.array_equal(timed[:count], seen[:count])


def test_no_decisions_are_an_error() -> None:
    class Still(Policy):
        def act(self, observation: NDArray[np.float32], info: Any) -> NDArray[np.int64]:
            return np.array([38])

    with pytest.raises(DockctlError) as caught:
        time_decisions(DockingVectorEnv(load("s1").scenario, 1), Still(), 0)
    assert caught.value.code == "out_of_range"


@pytest.mark.slow
@pytest.mark.parametrize("control", ["supervisor", "planner", None])
def test_the_timed_episode_is_that_of_an_evaluation(
    monkeypatch: pytest.MonkeyPatch, control: str | None
) -> None:
    loaded = load_policy("s1")
    rollout = Rollout(loaded.scenario(overrides=[f"evaluation.{control}=true"] if control else []))
    env, starts = rollout.env(), evaluation_starts(rollout.scenario, rollout.worlds)
    (expected,) = rollout.run(loaded.make(env), starts, clearance=False)
    poses: list[NDArray[np.float64]] = []
    step = env.step

    def recording(actions: np.ndarray) -> Any:
        result = step(actions)
        poses.append(result[-1]["pose"][0].copy())
        return result

    monkeypatch.setattr(env, "step", recording)
    samples = time_decisions(env, loaded.make(env), 10)
    assert list(samples) == [part for part in PARTS if control or part != OPTIONAL]
    assert (samples > 0).all(axis=None)
    assert samples.sum(axis=1).to_numpy() == pytest.approx(2 * samples["decision_ms"].to_numpy())
    assert len(samples) == expected.steps
    assert np.array_equal(poses[-expected.steps :], expected.trajectory["pose"][1:])
