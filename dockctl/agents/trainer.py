"""Training of a dueling double DQN (thesis sections 3.2.4-3.2.6), from first step to last checkpoint."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import wait
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from dockctl.agents.autoreset import Info, settled_info, settled_observation
from dockctl.agents.checkpoint import (
    LEARNER,
    CheckpointError,
    PolicyCard,
    load_pair,
    load_parameters,
    save_pair,
    save_policy,
)
from dockctl.agents.dqn import schedules
from dockctl.agents.dqn.compiled import DoubleDQN
from dockctl.agents.dqn.learner import Learner
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.dqn.replay import NStep, Replay
from dockctl.agents.dqn.update import AutogradDQN
from dockctl.agents.policy import EpsilonGreedyPolicy, Policy
from dockctl.agents.progress import Progress
from dockctl.agents.records import EpisodeRecorder, UpdateRecorder
from dockctl.analysis.learning import RECENT
from dockctl.compute.threads import workers
from dockctl.evaluation.rollout import Episode, score
from dockctl.runs.directory import RunDirectory
from dockctl.runs.tables import EPISODES, EVALUATIONS, TIMING, UPDATES
from dockctl.scenarios.interface import PolicyInterface
from dockctl.scenarios.training import Training

UPDATE_ROWS = 2000


class Trainer:
    """Learns in one vector environment, judges itself by greedy episodes, and writes the run folder.

    Args:
        training: the schedule and every number of the learner.
        scenario: name of the scenario, for the checkpoints.
        environment: ``training.boats`` boats with same-step autoreset.
        evaluate: plays one greedy episode from each evaluation pose.
        run: where tables and checkpoints go.
        interface: what the policy observes and does, for the checkpoints.
        device: of the learner; the replay and the network that acts stay in main memory.
        on_progress: called after every step.
        interrupted: asked after every step whether to save and leave.
    """

    def __init__(
        self,
        training: Training,
        scenario: str,
        environment: VectorEnv[Any, Any, Any],
        evaluate: Callable[[Policy], list[Episode]],
        run: RunDirectory,
        *,
        interface: PolicyInterface | None = None,
        device: str = "cpu",
        on_progress: Callable[[Progress], None] = lambda progress: None,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        space, actions = environment.single_observation_space, environment.single_action_space
        assert isinstance(space, Box)
        assert isinstance(actions, Discrete)
        self.training, self.scenario, self.environment, self.run_directory = (
            training,
            scenario,
            environment,
            run,
        )
        self.evaluate, self.on_progress, self.interrupted = evaluate, on_progress, interrupted
        self.interface = interface
        size, generator = space.shape[0], torch.Generator().manual_seed(training.seed)
        network = DuelingQNetwork(size, int(actions.n), training.hidden_sizes, generator)
        self.learner: Learner = (
            DoubleDQN(network, training)
            if torch.device(device).type == "cpu"
            else AutogradDQN(network, training, torch.device(device))
        )
        self.policy = EpsilonGreedyPolicy(network, np.random.default_rng((training.seed, 1)))
        self.n_step = NStep(training.boats, training.n_step, training.gamma, size)
        self.replay = Replay(training.replay_capacity, size, np.random.default_rng((training.seed, 2)))
        self.progress, self._leaving = Progress(), False
        self.episode_recorder = EpisodeRecorder(training.boats)
        updates = schedules.updates_due(training, training.total_steps)
        self.update_recorder = UpdateRecorder(stride=max(1, updates // UPDATE_ROWS))
        self.episodes = run.table("episodes.csv", EPISODES)
        self.updates = run.table("updates.csv", UPDATES)
        self.evaluations = run.table("evaluations.csv", EVALUATIONS)
        self.timing = run.table("timing.csv", TIMING)

    def run(self) -> str:
        """Train until there is a reason to stop, save, and return it, a key of `REASONS`."""
        progress, began = self.progress, time.monotonic() - self.progress.wall_s
        seed = np.random.SeedSequence((self.training.seed, progress.env_steps)).generate_state(1)
        observation, _ = self.environment.reset(seed=int(seed[0]))
        while (reason := self._reason_to_stop()) is None:
            progress.epsilon = schedules.epsilon(self.training, progress.env_steps)
            action = self.policy(observation, progress.epsilon)
            learning = workers().submit(self._learn)  # the learner learns while the boats sail
            try:
                step = self.environment.step(action)
                learning.result()
            except BaseException:  # a step that fails, or leaving at once: nothing is learned after that
                self._leaving = True
                wait([learning])
                raise
            self._remember(observation, action, *step)
            observation = step[0]
            progress.env_steps += self.training.boats
            progress.wall_s = time.monotonic() - began
            every = self.training.evaluate_every_steps
            if progress.env_steps // every > progress.evaluated_at // every:
                self._judge()
            self.on_progress(progress)
        if reason != "interrupted" and progress.evaluated_at < progress.env_steps:
            self._judge()
        self.save_last()
        return reason

    def _reason_to_stop(self) -> str | None:
        return "interrupted" if self.interrupted() else self.progress.reason_to_stop(self.training)

    def _learn(self) -> None:
        """Make the updates that are due, on what is in the replay memory."""
        progress = self.progress
        progress.learning_rate = schedules.learning_rate(self.training, progress.env_steps)
        due = schedules.updates_due(self.training, progress.env_steps)
        while len(self.replay) and progress.updates < due and not self._leaving:
            metrics = self.learner.update(
                self.replay.sample(self.training.batch_size), progress.learning_rate
            )
            progress.updates = self.learner.updates
            if row := self.update_recorder.add(metrics):
                progress.loss = metrics.loss
                rate = {"learning_rate": progress.learning_rate}
                self.updates.append(
                    [{"update": progress.updates, "env_steps": progress.env_steps, **row, **rate}]
                )

    def _remember(
        self,
        observation: NDArray[Any],
        action: NDArray[np.int64],
        next_observation: NDArray[Any],
        reward: NDArray[Any],
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
        info: Info,
    ) -> None:
        """Put the step into the replay memory and finished episodes into the table."""
        done, progress = terminated | truncated, self.progress
        final_observation = settled_observation(next_observation, info, done)
        scaled = np.asarray(reward) * self.training.reward_scale
        self.replay.add(
            self.n_step.add(observation, action, scaled, final_observation, terminated, truncated)
        )
        rows = self.episode_recorder.add(reward, settled_info(info, done), done)
        for row in rows:
            keep = max(RECENT, self.training.stop.episodes if self.training.stop else 0)
            progress.count_episode(str(row["outcome"]), row["start_kind"] == "pose", keep)
            row |= {"episode": progress.episodes, "env_steps": progress.env_steps + self.training.boats}
            row["epsilon"] = progress.epsilon
        self.episodes.append(rows)

    def _judge(self) -> None:
        """Play the greedy episodes, keep the policy when it is the best so far, and save the state."""
        progress = self.progress
        episodes = self.evaluate(self.policy.greedy)
        docked, mean_return = score(episodes)
        is_best = progress.best is None or [docked, mean_return] > progress.best
        if is_best:
            progress.best = [docked, mean_return]
            with self.run_directory.new_checkpoint("best") as folder:
                save_policy(folder, self.learner.online, self._card())
        progress.evaluated_at = progress.env_steps
        progress.evaluation_docked, progress.evaluation_episodes = docked, len(episodes)
        labels = [{"env_steps": progress.env_steps, "pose": pose} for pose in range(len(episodes))]
        rows = [{**label, **e.row(), "best": is_best} for label, e in zip(labels, episodes, strict=True)]
        self.evaluations.append(rows)
        self.timing.append([{"env_steps": progress.env_steps, "wall_s": progress.wall_s}])
        self.save_last()

    def _card(self) -> PolicyCard:
        network = self.learner.online
        return PolicyCard(
            scenario=self.scenario,
            observation_size=network.observation_size,
            actions=network.actions,
            hidden_sizes=network.hidden_sizes,
            env_steps=self.progress.env_steps,
            seed=self.training.seed,
            interface=self.interface,
        )

    def save_last(self) -> None:
        """Save the policy and all that `restore` needs."""
        with self.run_directory.new_checkpoint("last") as folder:
            save_policy(folder, self.learner.online, self._card())
            replay = {f"replay.{name}": array for name, array in self.replay.state().items()}
            facts = {
                "progress": asdict(self.progress),
                "exploration": self.policy.rng.bit_generator.state,
                "sampling": self.replay.rng.bit_generator.state,
            }
            save_pair(folder, LEARNER, {**self.learner.state(), **replay}, facts)

    def restore(self) -> None:
        """Take the training up where `save_last` left it; the episodes then under way begin anew.

        Raises:
            CheckpointError: the checkpoint is missing, damaged, or does not fit the scenario.
        """
        folder = self.run_directory.checkpoint("last")
        policy, _ = load_pair(folder / "policy.json")
        tensors, facts = load_pair(folder / f"{LEARNER}.json")
        try:
            self.progress = Progress(**facts["progress"])
            load_parameters(self.learner.online, policy)
            self.learner.load(tensors, self.progress.updates)
            prefix = "replay."
            self.replay.load({k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)})
            self.policy.rng.bit_generator.state = facts["exploration"]
            self.replay.rng.bit_generator.state = facts["sampling"]
        except (KeyError, TypeError, ValueError) as error:
            raise CheckpointError(f"{folder}: cannot be taken up: {error}") from None
        for table in ("episodes.csv", "updates.csv", "evaluations.csv", "timing.csv"):
            self.run_directory.cut_table(table, self.progress.env_steps)
