"""A boat on a line: drive from -1 to 0 and stop there. Small enough to be learned in seconds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete
from gymnasium.vector import AutoresetMode, VectorEnv

from dockctl.compute import on_all_cores

PUSH = np.array([-0.1, 0.0, 0.1])


@dataclass(frozen=True)
class ToyStart:
    eta: np.ndarray
    kind: str = "pose"
    berth: str = ""


def starts_at(*x: float) -> list[ToyStart]:
    return [ToyStart(np.array([value, 0.0, 0.0])) for value in x]


class ToyDocking(VectorEnv[Any, Any, Any]):
    """Observation: position and speed. Docked below 0.1 in both; a wall at 0.5 and one at -1.5."""

    def __init__(self, num_envs: int, *, max_steps: int = 40, autoreset: bool = True) -> None:
        self.num_envs, self.max_steps, self.autoreset = num_envs, max_steps, autoreset
        mode = AutoresetMode.SAME_STEP if autoreset else AutoresetMode.DISABLED
        self.metadata = {"autoreset_mode": mode}
        self.single_observation_space = Box(-2, 2, (2,), np.float32)
        self.observation_space = Box(-2, 2, (num_envs, 2), np.float32)
        self.single_action_space = Discrete(3)
        self.action_space = MultiDiscrete([3] * num_envs)
        self.x, self.u, self.push, self.steps = np.zeros((4, num_envs))

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        if seed is not None:
            self.rng = np.random.default_rng(seed)
        options = options or {}
        rows = np.array(options.get("reset_mask", np.ones(self.num_envs, bool)))
        self._place(rows)
        if "starts" in options:
            self.x = np.where(
                rows, [start.eta[0] if start else np.nan for start in options["starts"]], self.x
            )
        return self._observation(), self._info()

    def state(self) -> tuple[dict[str, Any], dict[str, Any]]:
        numbers = {"numbers": np.stack([self.x, self.u, self.push, self.steps])}
        return numbers, {"generator": self.rng.bit_generator.state}

    def restore(self, arrays: Any, facts: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        self.x, self.u, self.push, self.steps = arrays["numbers"].copy()
        self.rng = np.random.default_rng()
        self.rng.bit_generator.state = facts["generator"]
        return self._observation(), self._info()

    def _place(self, rows: np.ndarray) -> None:
        rng = getattr(self, "rng", np.random.default_rng(0))
        self.x = np.where(rows, -1 + rng.uniform(-0.1, 0.1, self.num_envs), self.x)
        for values in (self.u, self.push, self.steps):
            values[rows] = 0

    def _observation(self) -> np.ndarray:
        return np.stack([self.x, self.u], 1).astype(np.float32)

    def _info(self, outcome: Any = "") -> dict[str, Any]:
        zero = np.zeros(self.num_envs)
        outcome = np.broadcast_to(np.array(outcome, object), self.num_envs)
        return {
            "pose": np.stack([self.x, zero, zero], 1),
            "velocity": np.stack([self.u, zero, zero], 1),
            "command": np.stack([self.push, zero], 1),
            "distance_m": np.abs(self.x),
            "heading_error_rad": zero,
            "phase": zero.astype(int) + 1,
            "sector_ranges_m": np.stack([0.5 - self.x, self.x + 1.5], 1),
            "outcome": outcome,
            "collided_with": np.where(outcome == "collision", "wall", ""),
            "reward_terms": {"distance": -np.abs(self.x), "final": 10.0 * (outcome == "docked")},
            "start_kind": np.full(self.num_envs, "pose"),
            "start_index": zero.astype(int),
        }

    def step(self, actions: np.ndarray) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        on_all_cores(lambda boats: None, range(1), work=self.num_envs)  # where others scan
        self.push = PUSH[actions]
        self.u = np.clip(self.u + self.push, -0.3, 0.3)
        self.x = self.x + self.u
        self.steps += 1
        collided = (self.x > 0.5) | (self.x < -1.5)
        docked = ~collided & (np.abs(self.x) < 0.1) & (np.abs(self.u) < 0.1)
        truncated = ~collided & ~docked & (self.steps >= self.max_steps) & np.isfinite(self.x)
        reward = np.where(collided, -10.0, np.where(docked, 10.0, -np.abs(self.x)))
        outcome = np.select([collided, docked, truncated], ["collision", "docked", "timeout"], "")
        done = collided | docked | truncated
        if not self.autoreset:
            return self._observation(), reward, collided | docked, truncated, self._info(outcome)
        info: dict[str, Any] = {}
        if done.any():
            info = {"final_obs": self._observation(), "final_info": self._info(outcome)}
            self._place(done)
        return self._observation(), reward, collided | docked, truncated, {**self._info(), **info}
