"""The training loop: act, step, store, learn, validate, save."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

import dockctl
from dockctl.agents.background_learning import BackgroundLearning
from dockctl.agents.checkpoint import CheckpointError, PolicyCard, flatten, nest, save_policy, saved_steps
from dockctl.agents.divergence import DivergenceError, Monitor
from dockctl.agents.interface import (
    Algorithm,
    Policy,
    Recoverable,
    Resumable,
    Step,
    Tensors,
    final_info,
    final_observation,
)
from dockctl.agents.progress import EpisodeRecorder, Progress, UpdateRecorder
from dockctl.agents.training_state import TrainingState, checked_table, load_state, save_state
from dockctl.errors import DockctlError, PluginError
from dockctl.plugins import runtime_error
from dockctl.run_files import BEST, EPISODES_CSV, EVALUATIONS_CSV, TIMING_CSV, UPDATES_CSV
from dockctl.runs.directory import RunDirectory
from dockctl.runs.tables import EPISODES, EVALUATIONS, RECENT, TIMING, UPDATES, Value
from dockctl.scenarios.training import StopRule, Training

TABLES = {EPISODES_CSV: EPISODES, UPDATES_CSV: UPDATES, EVALUATIONS_CSV: EVALUATIONS, TIMING_CSV: TIMING}
UPDATE_ROWS = 2000
"""Approximate rows of ``updates.csv`` after ``training.total_steps``."""
MAX_ROLLBACKS = 3
NO_FINAL_OBSERVATION = (
    "the environment gives no final observations (final_obs): truncated episodes count as terminated"
)

Greedy = Callable[[Policy], Sequence[dict[str, Value]]]
"""Runs greedy episodes; returns a row for each, with the columns `dockctl.runs.tables.EVALUATIONS`."""


class Trainer:
    """Trains an algorithm in a vector environment and writes the run folder.

    Args:
        algorithm: acts and learns.
        training: limits, stop rule, and the interval of validations and checkpoints.
        environment: ``training.boats`` boats with same-step autoreset, which is assumed if it declares no
            mode; the keys of its `info` are optional. Without ``final_obs``, truncated episodes count as
            terminated.
        run: where tables and checkpoints are written.
        card: of the policy; its step count is updated when it is saved.
        validate: from many starts, to select the checkpoint ``best``; without it there is only ``last``.
        evaluate: from the poses that the stop rule requires; by default the validation starts.
        on_progress: called after every step.
        interrupted: called after every step; True saves the state and stops training.
        until: environment steps after which training stops as if interrupted.
        warn: called with each problem that does not end training.
        step_limit: control steps after which the environment ends an episode, if known.

    Raises:
        DockctlError: the environment declares a different autoreset mode or number of boats.
    """

    def __init__(
        self,
        algorithm: Algorithm,
        training: Training,
        environment: VectorEnv[Any, Any, Any],
        run: RunDirectory,
        card: PolicyCard,
        validate: Greedy | None = None,
        evaluate: Greedy | None = None,
        *,
        on_progress: Callable[[Progress], None] = lambda progress: None,
        interrupted: Callable[[], bool] = lambda: False,
        until: int | None = None,
        warn: Callable[[str], None] = lambda text: None,
        step_limit: int | None = None,
    ) -> None:
        mode = environment.metadata.get("autoreset_mode", AutoresetMode.SAME_STEP)
        if mode != AutoresetMode.SAME_STEP:
            message = f"the environment has {mode}, but the trainer needs {AutoresetMode.SAME_STEP}"
            raise DockctlError(message, code="mismatch")
        if environment.num_envs != training.boats:
            message = f"the environment has num_envs={environment.num_envs}, expected training.boats"
            raise DockctlError(f"{message}, {training.boats}", code="mismatch")
        self.algorithm, self.training, self.environment = algorithm, training, environment
        self.run_directory, self.card = run, card
        self.validate, self.evaluate = validate, evaluate
        self.on_progress, self.interrupted, self.until, self.warn = on_progress, interrupted, until, warn
        self._step_limit, self._warned = step_limit, set[str]()
        self._monitor = self._new_monitor()
        self.progress = Progress()
        self._learning = BackgroundLearning(algorithm, training)
        self._observation: NDArray[Any] | None = None
        self._saved_at: int | None = None
        self._blocks = set[str]()  # of the latest checkpoint
        self.episode_recorder = EpisodeRecorder(training.boats)
        updates = training.updates_due(training.total_steps)
        self.update_recorder = UpdateRecorder(stride=max(1, updates // UPDATE_ROWS))
        self.tables = {name: run.table(name, columns) for name, columns in TABLES.items()}

    def run(self) -> str:
        """Train until there is a reason to stop, save, and return the reason, a key of `REASONS`.

        Raises:
            DivergenceError: training diverged; the latest checkpoint is from before.
            PluginError: a plugin failed; the state is saved.
        """
        self._started = time.monotonic() - self.progress.wall_s
        while True:
            try:
                return self._train()
            except DivergenceError as error:
                self._roll_back(error)
            except Exception as error:
                if known := error if isinstance(error, PluginError) else runtime_error(error):
                    self._save_last(unfinished=False)
                    raise known from error
                raise
            finally:  # no learning continues in the background after an error
                self._learning.finish()

    def _new_monitor(self) -> Monitor:
        numbers = [str(column) for column in range(self.card.observation_size)]
        names = getattr(self.environment, "observation_names", numbers)
        return Monitor(self.training, names, self._step_limit)

    def _train(self) -> str:
        seed = [self.training.seed, self.progress.env_steps]
        if self.progress.rollbacks:
            seed.append(self.progress.rollbacks)
        if self._observation is None:
            reset_seed = int(np.random.SeedSequence(seed).generate_state(1)[0])
            self._observation, _ = self.environment.reset(seed=reset_seed)
        progress = self.progress
        while (reason := self._reason_to_stop()) is None:
            self._step(self._observation)
            progress.wall_s = time.monotonic() - self._started
            if progress.crossed(self.training.evaluate_every_steps, since=progress.evaluated_at):
                self._evaluate()
            self.on_progress(progress)
        self._record_updates()
        validated = reason in ("interrupted", "mastered")  # which a recent validation has confirmed
        if not validated and progress.validated_at < progress.env_steps:
            self._evaluate(validated=True)
        elif self._saved_at != progress.env_steps:
            self._save_last()
        return reason

    def _check(self, check: Callable[..., None], *arguments: Any) -> bool:
        """Run a check of the monitor and return whether it passes.

        Raises:
            DivergenceError: it fails, and training must stop.
        """
        try:
            check(*arguments, self.progress.env_steps)
        except DivergenceError as error:
            if self.training.on_divergence != "continue":
                raise
            self._warn_once(error.term, error.message)
            return False
        return True

    def _warn_once(self, about: str, text: str) -> None:
        if about not in self._warned:
            self._warned.add(about)
            self.warn(text)

    def _roll_back(self, error: DivergenceError) -> None:
        """Go back to the latest checkpoint, with new episodes and other random numbers.

        Raises:
            DivergenceError: there is no checkpoint, or no attempt is left.
        """
        attempt = self.progress.rollbacks + 1
        if self.training.on_divergence != "rollback" or attempt > MAX_ROLLBACKS:
            raise error
        try:
            self.restore()
        except CheckpointError:
            error.message += "; there is no checkpoint yet to go back to"
            raise error from None
        self.progress.rollbacks, self._observation = attempt, None
        self.episode_recorder, self._monitor = EpisodeRecorder(self.training.boats), self._new_monitor()
        if isinstance(self.algorithm, Recoverable):
            self.algorithm.recover(attempt)
        self.warn(f"{error.message}; back to step {self.progress.env_steps:,}, attempt {attempt}")

    def _reason_to_stop(self) -> str | None:
        if self.interrupted() or (self.until is not None and self.progress.env_steps > self.until):
            return "interrupted"
        rule = self.training.stop
        if rule is not None and self.progress.mastered(rule) and self._confirmed(rule):
            return "mastered"
        return self.progress.reached_limit(self.training)

    def _confirmed(self, rule: StopRule) -> bool:
        """Return whether a recent validation also meets the stop rule; validate if there is none."""
        progress = self.progress
        if self.validate is None or self.evaluate is None:  # the rule already uses the validation starts
            return True
        if progress.env_steps - progress.validated_at >= self.training.evaluate_every_steps:
            self._evaluate(validated=True)
        return progress.mastered(rule) and progress.validated(rule)

    def _step(self, observation: NDArray[Any]) -> None:
        """Step all boats while the algorithm learns, and store the step."""
        progress = self.progress
        action = self.algorithm.act(observation, progress.env_steps)
        self._learning.step(progress, observation)
        next_observation, reward, terminated, truncated, info = self.environment.step(action)
        done = terminated | truncated
        if done.any() and "final_obs" not in info:
            self._warn_once("final_obs", NO_FINAL_OBSERVATION)
            terminated = done
        final = final_observation(next_observation, info, done)
        last, step = (
            final_info(info, done),
            Step(observation, action, np.asarray(reward), final, terminated, truncated),
        )
        self._check(self._monitor.check_step, step, last)
        rows = self.episode_recorder.add(reward, last, done)
        self._record_updates(later=1)
        if not self._learning.overlaps:
            self._learning.finish()
        self.algorithm.store(step)
        progress.env_steps += self.training.boats
        progress.epsilon = self.algorithm.epsilon
        window = max(RECENT, self.training.stop.episodes if self.training.stop else 0)
        for row in rows:
            progress.count_episode(str(row["outcome"]), row["start_kind"] == "pose", window)
            row |= {
                "episode": progress.episodes,
                "env_steps": progress.env_steps,
                "epsilon": progress.epsilon,
            }
        self.tables[EPISODES_CSV].append(rows)
        self._observation = np.asarray(next_observation)

    def _record_updates(self, later: int = 0) -> None:
        """Check and record the metrics of all calls to `learn` except the latest `later`."""
        progress = self.progress
        for env_steps, observation, learned in self._learning.learned(later=later):
            logged = False
            for metrics in learned:
                progress.updates, progress.loss = progress.updates + 1, metrics["loss"]
                self._check(self._monitor.check_update, metrics)
                if row := self.update_recorder.add(metrics):
                    labels = {"update": progress.updates, "env_steps": env_steps}
                    self.tables[UPDATES_CSV].append([{**labels, **row}])
                    logged = True
            if logged:
                self._check(self._monitor.check_networks, self.algorithm, observation)

    def _evaluate(self, *, validated: bool = False) -> None:
        """Run the greedy episodes that are due, save the policy if it is the best so far, and save the state.

        Args:
            validated: validate even if no validation is due.
        """
        self._record_updates()
        progress, every, is_best = self.progress, self.training.validation.every_steps, False
        policy, tensors = self.algorithm.policy, self.algorithm.policy_tensors()
        validates = validated or progress.crossed(every, since=progress.validated_at)
        evaluate = self.evaluate if progress.evaluated_at < progress.env_steps else None
        validate = self.validate if validates else None
        poses, starts = list[dict[str, Value]](), list[dict[str, Value]]()
        with self._learning.ahead(progress, self._observation):
            if evaluate is not None:
                poses += evaluate(policy)
            if validate is not None:
                starts += validate(policy)
        if validate is not None:
            is_best = self._select(starts, tensors)
        if progress.evaluated_at < progress.env_steps:
            episodes = starts if self.evaluate is None else poses
            progress.evaluation_docked, progress.evaluation_episodes = _docked(episodes), len(episodes)
        progress.evaluated_at, rows = progress.env_steps, poses + starts
        labels = {"env_steps": progress.env_steps, "best": is_best}
        self.tables[EVALUATIONS_CSV].append({**row, **labels} for row in rows)
        self.tables[TIMING_CSV].append([{"env_steps": progress.env_steps, "wall_s": progress.wall_s}])
        self._save_last()

    def _select(self, validation: Sequence[dict[str, Value]], tensors: Tensors) -> bool:
        """Save the policy if it docks from at least as many starts as any before; return whether it does."""
        progress, docked = self.progress, _docked(validation)
        progress.validated_at = progress.env_steps
        progress.validation_docked, progress.validation_episodes = docked, len(validation)
        if progress.best is not None and docked < progress.best[0]:
            return False
        if not self._check(self._monitor.check_parameters, tensors):
            return False
        progress.best = [docked, len(validation), float(np.mean([row["return"] for row in validation]))]
        with self.run_directory.new_checkpoint(BEST) as folder:
            save_policy(folder, tensors, self._card())
        return True

    def _card(self) -> PolicyCard:
        return self.card.model_copy(update={"env_steps": self.progress.env_steps})

    def _save_last(self, *, unfinished: bool = True) -> None:
        """Save the policy and everything else that `restore` needs, unless a value is not finite.

        Args:
            unfinished: also save the unfinished episodes; False in the middle of a step.
        """
        self._record_updates()
        policy, (tensors, facts) = self.algorithm.policy_tensors(), self.algorithm.state()
        numbers = {name: values for name, values in tensors.items() if values.dtype.kind == "f"}
        if not self._check(self._monitor.check_parameters, {**policy, **numbers}):
            return
        tables = {name: table.save() for name, table in self.tables.items()}
        sums, terms = self.episode_recorder.state()
        watched, counts = self._monitor.state()
        groups = {"algorithm": tensors, "monitor": watched}
        environment = None
        if unfinished and isinstance(self.environment, Resumable):
            environment = self.environment.state()
        if environment is None:
            groups["algorithm"] = {k: v for k, v in tensors.items() if not k.startswith("unfinished.")}
        else:
            groups |= {"environment": environment[0], "episodes": sums}
        saved = {
            "progress": {**asdict(self.progress), "loss": None},  # may be NaN, which JSON does not support
            "algorithm": facts,
            "environment": environment and environment[1],
            "terms": terms,
            "monitor": counts,
            "updates": self.update_recorder.state(),
            "tables": tables,
        }
        state = flatten(groups, "/"), saved
        self._blocks = save_state(self.run_directory, policy, self._card(), *state, self._blocks)
        self._saved_at = self.progress.env_steps

    def restore(self) -> list[str]:
        """Continue from the newest intact checkpoint ``last``, exactly where it was saved.

        An environment that cannot be saved starts new episodes.

        Returns:
            Notes for the user on what was damaged or lost.

        Raises:
            CheckpointError: there is no intact checkpoint, or it does not match.
        """
        self._learning.forget()
        saved = load_state(self.run_directory)
        tensors, facts = nest(saved.tensors, "/"), saved.facts
        notes = [f"{text}; {saved.folder} is used instead" for text in saved.damaged]
        try:
            self.progress = Progress(**facts["progress"])
            self._saved_at, self._blocks = self.progress.env_steps, saved.blocks
            self.algorithm.restore(saved.policy, tensors["algorithm"], facts["algorithm"])
            self.update_recorder.restore(facts["updates"])
            environment: Any = None if facts["environment"] is None else self.environment
            same_episodes = isinstance(environment, Resumable)
            if "monitor" in facts:  # not in states of early versions, whose checks start over
                self._monitor.restore(tensors["monitor"], facts["monitor"], same_episodes=same_episodes)
            if isinstance(environment, Resumable):
                self.episode_recorder.restore(tensors["episodes"], facts["terms"])
                self._observation, _ = environment.restore(tensors["environment"], facts["environment"])
            else:
                notes.append("the unfinished episodes could not be saved; new ones start")
            tables = [(table, checked_table(facts["tables"][name])) for name, table in self.tables.items()]
        except KeyError as error:
            raise CheckpointError(_without(error, saved)) from None
        except (AttributeError, LookupError, OverflowError, TypeError, ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())
            raise CheckpointError(f"{saved.folder}: cannot be resumed: {reason}") from None
        except PluginError:
            raise
        except DockctlError as error:  # the state belongs to a different environment
            message = f"{saved.folder}: cannot be resumed: {error.message}"
            raise CheckpointError(message, code=error.code) from None
        self._drop_later_bests()
        lost = [table.restore(state, self.progress.env_steps) for table, state in tables]
        return notes + [loss for loss in lost if loss]

    def _drop_later_bests(self) -> None:
        """Remove checkpoints `BEST` from steps that will be repeated, if there is an earlier one.

        With another limit of steps the training may choose others.
        """
        folders = self.run_directory.checkpoints(BEST)
        later = [folder for folder in folders if saved_steps(folder) > self.progress.env_steps]
        if len(later) < len(folders):
            for folder in later:
                shutil.rmtree(folder)


def _without(key: KeyError, saved: TrainingState) -> str:
    """Return the message for a state with valid hashes but a missing key: another version wrote it."""
    version = saved.facts.get("dockctl")
    if version != dockctl.__version__:
        reason = f"saved by dockctl {version}, without {key}; this is {dockctl.__version__}"
    else:
        reason = f"without {key}: edited, or saved by another commit of dockctl {version}"
    return f"{saved.folder}: {reason}: training cannot continue from it, but its policy can be evaluated"


def _docked(rows: Sequence[dict[str, Value]]) -> int:
    return sum(row["outcome"] == "docked" for row in rows)
