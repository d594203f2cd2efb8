"""Dueling double DQN with n-step returns as an `Algorithm` (thesis sections 3.2.4 to 3.2.6)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields, replace
from typing import Annotated, Any

import numpy as np
import pydantic.dataclasses
import torch
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt

from dockctl.agents.checkpoint import flatten, nest
from dockctl.agents.dqn.network import FIRST_LAYER, DuelingQNetwork, widened
from dockctl.agents.dqn.policy import GreedyPolicy
from dockctl.agents.dqn.replay import Batch, NStep, Replay, mirror_every_second
from dockctl.agents.dqn.update import DoubleDQN
from dockctl.agents.interface import Metrics, Step, Tensors
from dockctl.agents.tensors import load_parameters, numpy_tensors
from dockctl.dueling import Hysteresis, Mirror, join, split
from dockctl.scenarios.training import Training

DRAWN_BYTES = 2**25
"""Memory limit of the transitions that are sampled at once, if that is enough for one update."""


@pydantic.dataclasses.dataclass
class _Counted:
    """Counters of a saved state.

    Attributes:
        updates: so far.
        slowdown: factor on the learning rate after rollbacks.
        part, begun: number of the part of the training, and of updates before it.
        finished: number of networks of earlier parts.
    """

    updates: NonNegativeInt
    slowdown: Annotated[float, Field(gt=0, le=1)]
    part: NonNegativeInt = 0
    begun: NonNegativeInt = 0
    finished: NonNegativeInt = 0


class DQN:
    """Epsilon-greedy exploration, replay of n-step transitions, and the updates of double DQN.

    Args:
        observation_size: length of an observation.
        actions: number of discrete actions.
        training: the hyperparameters.
        device: of the networks; the replay stays in main memory.
    """

    def __init__(self, observation_size: int, actions: int, training: Training, device: torch.device) -> None:
        torch.set_num_threads(1)  # the matrices are small, and the simulator uses the other cores
        self.training, self.actions, self.device = training, actions, device
        generator = torch.Generator().manual_seed(training.seed)
        network = DuelingQNetwork(observation_size, actions, training.hidden_sizes, generator).to(device)
        self.learner = DoubleDQN(network, training)
        self._calls = 0  # of `learn`
        self._scheduled = 0  # updates that these calls made or will make
        self.exploration = np.random.default_rng((training.seed, 1))
        self.n_step = NStep(training.boats, training.n_step, training.gamma, observation_size)
        sampling = np.random.default_rng((training.seed, 2))
        self.replay = Replay(training.replay_capacity, observation_size, sampling)
        self.epsilon: float | None = training.epsilon.start
        self.slowdown = 1.0
        self.mirror: Mirror | None = None
        self.hysteresis: Hysteresis | None = None

    @property
    def policy(self) -> GreedyPolicy:
        """The greedy policy of the current evaluated networks."""
        return GreedyPolicy(self.policy_tensors())

    @property
    def updates(self) -> int:
        return self.learner.updates

    @property
    def acts_while_learning(self) -> bool:
        """Whether `act` uses copies and `learn` draws all transitions when called; see `Overlapping`.

        The `act` of a subclass may use the networks that learn.
        """
        updates = self.training.boats // self.training.steps_per_update + 1
        return type(self).act is DQN.act and updates <= self._drawn_updates

    def act(self, observation: NDArray[Any], env_steps: int) -> NDArray[np.int64]:
        """Return a random action with probability epsilon, otherwise the greedy one; see `Algorithm`."""
        self.epsilon = self.training.epsilon.at(env_steps)
        explore = self.exploration.random(len(observation)) < self.epsilon
        random_action = self.exploration.integers(self.actions, size=len(observation))
        return np.where(explore, random_action, self.learner.greedy(observation, self._calls % 2))

    def store(self, step: Step) -> None:
        """Store the n-step transitions that `step` completes; see `Algorithm`."""
        self.replay.add(self.n_step.add(replace(step, reward=step.reward * self.training.reward_scale)))

    def learn(self, env_steps: int) -> Iterator[Metrics]:
        """Draw the transitions for the updates due after `env_steps`; the iterator performs the updates."""
        due = max(0, self.training.updates_due(env_steps) - self._scheduled) if len(self.replay) else 0
        slot, self._calls, self._scheduled = self._calls % 2, self._calls + 1, self._scheduled + due
        rate = self.slowdown * self.training.learning_rate_at(env_steps)
        part = self.training.part_at(env_steps)
        return self._update(self._draw(due) if due else None, due, rate, slot, part)

    @property
    def _drawn_updates(self) -> int:
        """Number of updates whose transitions are drawn at once."""
        size = self.learner.online.observation_size
        return max(1, DRAWN_BYTES // Replay.bytes_needed(self.training.batch_size, size))

    def _draw(self, due: int) -> Batch:
        """Return the transitions for `due` updates, or for as many of them as `DRAWN_BYTES` allow."""
        drawn = self.replay.sample(min(due, self._drawn_updates) * self.training.batch_size)
        if self.mirror:
            mirror_every_second(drawn, self.mirror)
        return drawn

    def start_from(self, policy: Tensors, inputs: NDArray[np.int64]) -> None:
        """Start from the parameters of the newest network, which may be narrower; see `FineTunable`."""
        (newest, *_), *_ = split(policy)
        first, known = newest[FIRST_LAYER], inputs >= 0
        weights = np.zeros((len(first), len(inputs)), first.dtype)
        weights[:, known] = first[:, inputs[known]]
        own = numpy_tensors(self.learner.online.state_dict())
        given = {**newest, FIRST_LAYER: weights}
        self.learner.start_from({name: widened(array, own[name]) for name, array in given.items()})

    def learn_mirrored(self, mirror: Mirror) -> None:
        """Replace half of the transitions by their mirror images; see `Mirrorable`."""
        self.mirror = mirror

    def keep_actions(self, hysteresis: Hysteresis) -> None:
        """Let the policy, not the exploration, keep its last action; see `Hysteretic`."""
        self.hysteresis = hysteresis

    def _update(
        self, transitions: Batch | None, due: int, learning_rate: float, slot: int, part: int
    ) -> Iterator[Metrics]:
        if part > self.learner.part:
            self.learner.begin(part)
        while due:
            transitions = transitions or self._draw(due)
            steps = len(transitions.action) // self.training.batch_size
            # The moments of unused units decay to denormal numbers, which are about ten times slower. The
            # mode belongs to the thread, so it is reset afterwards.
            torch.set_flush_denormal(True)
            try:
                metrics = self.learner.update(transitions, learning_rate, steps)
            finally:
                torch.set_flush_denormal(False)
            yield from ({**row, "learning_rate": learning_rate} for row in metrics)
            due, transitions = due - steps, None
        self.learner.publish(slot)

    def advantages(self, observation: NDArray[Any]) -> NDArray[Any]:
        """Return the output of the advantage stream of the network that acts next; see `Dueling`."""
        network = self.learner.acting[self._calls % 2]
        with torch.inference_mode():
            features = network.shared(torch.as_tensor(observation, dtype=torch.float32, device=self.device))
            values: NDArray[Any] = network.advantage(features).cpu().numpy()
        return values

    def recover(self, attempt: int) -> None:
        """Halve the learning rate, draw other random numbers, start new episodes; see `Recoverable`."""
        self.slowdown = 0.5**attempt
        training, size = self.training, self.learner.online.observation_size
        self.n_step = NStep(training.boats, training.n_step, training.gamma, size)
        self.exploration = np.random.default_rng((training.seed, 1, attempt))
        self.replay.rng = np.random.default_rng((training.seed, 2, attempt))

    def policy_tensors(self) -> Tensors:
        """Return the parameters of the evaluated networks; see `Algorithm`."""
        newest = numpy_tensors(self.learner.evaluated.state_dict())
        if self.training.ensemble is None:
            return join([newest], hysteresis=self.hysteresis)
        networks = [newest, *self.learner.snapshots, *self.learner.finished]
        return join(networks, self.mirror, self.hysteresis)

    def state(self) -> tuple[Tensors, dict[str, Any]]:
        """Return the other networks, optimizer, replay, n-step windows and generators; see `Algorithm`."""
        learner = self.learner
        tensors = {
            "first": learner.first if self.training.parts > 1 else {},
            "online": numpy_tensors(learner.online.state_dict()),
            "target": numpy_tensors(learner.target.state_dict()),
            "acting": numpy_tensors(learner.acting[self._calls % 2].state_dict()),
            "optimizer": learner.steps.moments(),
            "replay": self.replay.state(),
            "unfinished": self.n_step.state(),
        }
        generators = {"exploration": self.exploration, "sampling": self.replay.rng}
        states = {name: generator.bit_generator.state for name, generator in generators.items()}
        counted = _Counted(self.updates, self.slowdown, learner.part, learner.begun, len(learner.finished))
        return flatten(tensors), {**asdict(counted), **states}

    def restore(self, policy: Tensors, tensors: Tensors, facts: Mapping[str, Any]) -> None:
        """Continue from a saved state; see `Algorithm`."""
        nested = nest(tensors)
        if not nested["online"]:
            raise KeyError("online")
        load_parameters(self.learner.online, nested["online"])
        load_parameters(self.learner.target, nested["target"])
        counted = _Counted(**{each.name: facts[each.name] for each in fields(_Counted) if each.name in facts})
        (newest, *earlier), *_ = split(policy)
        kept = len(earlier) - counted.finished
        self.learner.snapshots, self.learner.finished = earlier[:kept], earlier[kept:]
        self.learner.part, self.learner.begun = counted.part, counted.begun
        if first := nested["first"]:
            self.learner.first = first
        load_parameters(self.learner.evaluated, newest)
        self.learner.publish_all()
        if acting := nested["acting"]:  # not in states of early versions
            load_parameters(self.learner.acting[self._calls % 2], acting)
        self.learner.steps.load_moments(nested["optimizer"])
        self.replay.load(nested["replay"], self.actions)
        if unfinished := nested["unfinished"]:
            self.n_step.load(unfinished, self.actions)
        self.learner.updates = self._scheduled = counted.updates
        self.slowdown = counted.slowdown
        self.exploration.bit_generator.state = facts["exploration"]
        self.replay.rng.bit_generator.state = facts["sampling"]
