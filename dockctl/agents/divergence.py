"""Checks during training: non-finite numbers, exploding values, dead networks, a stuck environment."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dockctl.agents.interface import Algorithm, Dueling, Info, Metrics, Step, Tensors
from dockctl.errors import DockctlError
from dockctl.scenarios.training import Training

PROBES = 64
"""Observations used to detect a dead advantage stream."""
SAME = 1e-6
"""Relative difference up to which advantages count as equal."""
DIFFERENT = 1e-3
"""Differences of observations above this must change the advantages."""
SLACK = 2.0
"""Factor by which values may exceed what rewards and discount allow."""
LATE = 2.0
"""Multiple of the step limit after which an episode should have ended."""


class DivergenceError(DockctlError):
    """Training diverged and cannot succeed.

    Attributes:
        term: what was affected first, for example ``reward term 'speed'``.
        env_steps: environment steps when it was found.
    """

    exit_code = 3
    code = "diverged"

    def __init__(self, term: str, flaw: str, env_steps: int) -> None:
        super().__init__(f"training diverged after {env_steps:,} steps: {term} {flaw}")
        self.term, self.env_steps = term, env_steps


class Monitor:
    """Checks the steps and updates of one training run.

    Args:
        training: number of boats, discount, and the factor on rewards.
        names: of the columns of an observation; columns are numbered if empty.
        step_limit: control steps after which the environment ends an episode, if known.
    """

    def __init__(self, training: Training, names: Sequence[str] = (), step_limit: int | None = None) -> None:
        self._training, self._names, self._step_limit = training, names, step_limit
        self._reward, self._last_reward = 0.0, 0.0  # largest so far: within episodes, at their ends
        self._first_scale: float | None = None
        self._lasted = np.zeros(training.boats, np.int64)
        self._unchanged = 0
        self._probes: deque[NDArray[np.float64]] = deque(maxlen=max(2, PROBES // training.boats))

    def state(self) -> tuple[Tensors, dict[str, Any]]:
        """Return what `restore` needs: arrays, and values for JSON."""
        arrays = {"lasted": self._lasted, **({"probes": np.stack(self._probes)} if self._probes else {})}
        facts = {
            "reward": float(self._reward),
            "last_reward": float(self._last_reward),
            "first_scale": self._first_scale,
            "unchanged": self._unchanged,
        }
        return arrays, facts

    def restore(self, arrays: Tensors, facts: Mapping[str, Any], *, same_episodes: bool) -> None:
        """Continue from what `state` returned.

        Args:
            same_episodes: unfinished episodes continue; otherwise new ones start.

        Raises:
            KeyError, TypeError, ValueError: they are not such a state.
        """
        if same_episodes:
            self._lasted[:] = arrays["lasted"]
        probes = [*arrays.get("probes", ())]
        if self._names and {probe.shape for probe in probes} - {(self._training.boats, len(self._names))}:
            raise ValueError("the observations of the monitor have a different shape")
        self._probes.extend(probes)
        self._reward, self._last_reward = float(facts["reward"]), float(facts["last_reward"])
        scale, self._unchanged = facts["first_scale"], int(facts["unchanged"])
        self._first_scale = None if scale is None else float(scale)

    def check_step(self, step: Step, info: Info, env_steps: int) -> None:
        """Check what the environment returned.

        Args:
            step: of all boats.
            info: after the step and before any reset.
            env_steps: environment steps before it, summed over all boats.

        Raises:
            DivergenceError: an observation or a reward is not finite, or the environment is stuck.
        """
        if not np.isfinite(step.next_observation).all():
            column = int(np.flatnonzero(~np.isfinite(step.next_observation).all(axis=0))[0])
            name = self._names[column] if self._names else column
            raise DivergenceError(f"observation '{name}'", "is not finite", env_steps)
        if not np.isfinite(step.reward).all():
            terms = (name for name, value in info.get("reward_terms", {}).items() if not _finite(value))
            name = next(terms, "")
            raise DivergenceError(
                f"reward term '{name}'" if name else "the reward", "is not finite", env_steps
            )
        self._check_progress(step, env_steps)
        sizes = np.abs(step.reward) * self._training.reward_scale
        self._reward = max(self._reward, sizes[~step.terminated].max(initial=0.0))
        self._last_reward = max(self._last_reward, sizes[step.terminated].max(initial=0.0))

    def _check_progress(self, step: Step, env_steps: int) -> None:
        """Check that episodes end and that observations change."""
        if self._step_limit is None:
            return
        self._lasted += 1
        late = np.flatnonzero(self._lasted > LATE * self._step_limit)
        if len(late):
            flaw = f"has lasted {self._lasted[late[0]]:,} steps; they are limited to {self._step_limit:,}"
            raise DivergenceError(f"the episode of boat {late[0]}", flaw, env_steps)
        self._lasted[step.terminated | step.truncated] = 0
        self._unchanged += 1
        if not np.array_equal(step.next_observation, step.observation):
            self._unchanged = 0
        if self._unchanged > self._step_limit:
            raise DivergenceError(
                "the observation", f"has not changed for {self._unchanged:,} steps", env_steps
            )

    def check_update(self, metrics: Metrics, env_steps: int) -> None:
        """Check the metrics of an update.

        Raises:
            DivergenceError: one is not finite, or the Q-values exceed what rewards and discount allow.
        """
        for name, value in metrics.items():
            if not math.isfinite(value):
                raise DivergenceError(f"{name}", f"is {value}", env_steps)
        scale = max(abs(metrics.get("q_mean", 0.0)), metrics.get("td_error", 0.0) / 2)
        if self._first_scale is None:
            self._first_scale = max(1.0, scale)
        discount = self._training.gamma
        sums = self._reward / (1 - discount) if discount < 1 else math.inf if self._reward else 0.0
        limit = SLACK * max(self._first_scale, sums + self._last_reward)
        if scale > limit:
            flaw = f"are {scale:.3g}; rewards and discount allow at most {limit / SLACK:.3g}"
            raise DivergenceError("the Q-values", flaw, env_steps)

    def check_parameters(self, tensors: Tensors, env_steps: int) -> None:
        """Check the parameters of a policy.

        Raises:
            DivergenceError: one is not finite.
        """
        for name, values in tensors.items():
            if not _finite(values):
                raise DivergenceError(f"parameter '{name}'", "is not finite", env_steps)

    def check_networks(self, algorithm: Algorithm, observation: NDArray[Any], env_steps: int) -> None:
        """Check the parameters of the policy, and its advantage stream if it has one; once per interval.

        Args:
            observation: (n, observation_size) before the step; the latest ones are used for the advantages.

        Raises:
            DivergenceError: a parameter is not finite, or the actions do not depend on the observations.
        """
        self.check_parameters(algorithm.policy_tensors(), env_steps)
        self._probes.append(np.asarray(observation, float))
        if len(self._probes) < (self._probes.maxlen or 0) or not isinstance(algorithm, Dueling):
            return
        observations = np.concatenate(self._probes)
        if np.ptp(observations, axis=0).max() < DIFFERENT:
            return
        advantages = algorithm.advantages(observations)
        centered = advantages - advantages.mean(axis=1, keepdims=True)
        if np.ptp(centered, axis=0).max() <= SAME * np.abs(advantages).max():
            flaw = f"prefers the same actions for {len(observations)} different observations: it is dead"
            raise DivergenceError("the advantage stream", flaw, env_steps)


def _finite(values: NDArray[np.float64]) -> bool:
    return bool(np.isfinite(values).all())
