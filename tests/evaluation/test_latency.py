"""The timed observation equals that of the environment."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dockctl.agents.interface import Policy
from dockctl.envs.vector import DockingVectorEnv
from dockctl.evaluation.latency import time_decisions
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
    assert count >= 29
    assert np.array_equal(timed[:count], seen[:count])
