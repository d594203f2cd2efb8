"""Each way to diverge is found within one logging interval, and the checkpoint from before is kept."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from dockctl.agents import trainer as trainer_module
from dockctl.agents.checkpoint import load_pair
from dockctl.agents.divergence import DivergenceError, Monitor
from dockctl.agents.dqn.algorithm import DQN
from dockctl.agents.trainer import MAX_ROLLBACKS, Trainer
from dockctl.run_files import LAST, LEARNER_JSON, POLICY_JSON
from dockctl.runs.directory import RunDirectory
from dockctl.scenarios.training import Training
from tests.agents.test_trainer import SETTINGS, read_table, trainer_in

INJECTED, SAVED, LIMIT = 640, 600, 40
BOATS = SETTINGS["boats"]

Fault = Callable[[Trainer], None]


def trainer(root: Path, fault: Fault, *, times: int = 1, **changes: Any) -> Trainer:
    """Return a trainer that meets the fault after `INJECTED` steps, at most `times` times."""
    settings = {**SETTINGS, "total_steps": 100_000, "stop": None, "evaluate_every_steps": 200, **changes}
    left = [times]

    def inject(progress: Any) -> None:
        if progress.env_steps == INJECTED and left[0]:
            left[0] -= 1
            made._learning.finish()
            fault(made)

    made = trainer_in(
        RunDirectory.create(root, "toy", 0),
        Training(**settings),
        on_progress=inject,
        step_limit=LIMIT,
        validate=None,
    )
    return made


def dqn(made: Trainer) -> DQN:
    assert isinstance(made.algorithm, DQN)
    return made.algorithm


def env(made: Trainer) -> Any:
    """Return the environment, whose methods and attributes the faults replace."""
    return made.environment


def nan_reward(made: Trainer) -> None:
    def step(actions: Any) -> Any:
        observation, reward, terminated, truncated, info = original(actions)
        terms = {**info["reward_terms"], "final": np.full(BOATS, np.nan)}
        return observation, reward + np.nan, terminated, truncated, {**info, "reward_terms": terms}

    original, env(made).step = env(made).step, step


def nan_observation(made: Trainer) -> None:
    env(made).u[3] = np.nan


def nan_weight(made: Trainer) -> None:
    with torch.no_grad():
        dqn(made).learner.online.value[0].bias[2] = torch.nan


def nan_loss(made: Trainer) -> None:
    original = made.algorithm.learn
    learner: Any = made.algorithm
    learner.learn = lambda steps: ({**m, "loss": np.nan} for m in original(steps))


def exploding_values(made: Trainer) -> None:
    with torch.no_grad():
        dqn(made).learner.online.value[2].bias += 1e6


def dead_advantages(made: Trainer) -> None:
    with torch.no_grad():
        dqn(made).learner.online.advantage[0].weight.zero_()
        dqn(made).learner.online.advantage[0].bias.fill_(-1.0)


def no_end(made: Trainer) -> None:
    env(made).max_steps = 10**9
    env(made)._place = lambda rows: None

    def step(actions: Any) -> Any:
        env(made).x = np.clip(env(made).x, -1.4, -0.6)
        env(made).u[:] = 0
        return original(actions)

    original, env(made).step = env(made).step, step


def frozen(made: Trainer) -> None:
    observation = np.zeros((BOATS, 2), np.float32)
    never = np.zeros(BOATS, bool)
    info = env(made)._info()
    env(made).step = lambda actions: (observation, np.zeros(BOATS), never, never, info)


STRIDE = (100_000 - 200) // 8 // 2000 + 1
INTERVAL = STRIDE * SETTINGS["steps_per_update"] + BOATS
FAULTS = [
    (nan_reward, "reward term 'final'", BOATS),
    (nan_observation, "observation '0'", BOATS),
    (nan_weight, "loss", INTERVAL),
    (nan_loss, "loss", INTERVAL),
    (exploding_values, "the Q-values", INTERVAL),
    (dead_advantages, "the advantage stream", INTERVAL),
    (no_end, "the episode of boat", 2 * LIMIT * BOATS + INTERVAL),
    (frozen, "the observation", (LIMIT + 1) * BOATS + INTERVAL),
]


def assert_sound(run: RunDirectory, latest: int) -> None:
    """Check that the last checkpoint is from before the fault and finite."""
    folder = run.checkpoint(LAST)
    policy, card = load_pair(folder / POLICY_JSON)
    tensors, _ = load_pair(folder / LEARNER_JSON)
    assert 0 < card["env_steps"] <= latest
    assert all(np.isfinite(values).all() for values in [*policy.values(), *tensors.values()])


@pytest.mark.parametrize(("fault", "term", "delay"), FAULTS)
def test_a_fault_stops_the_training(fault: Fault, term: str, delay: int, tmp_path: Path) -> None:
    made = trainer(tmp_path, fault)
    with pytest.raises(DivergenceError) as caught:
        made.run()
    assert caught.value.term.startswith(term)
    assert caught.value.exit_code == 3
    assert INJECTED <= caught.value.env_steps <= INJECTED + delay
    assert_sound(made.run_directory, caught.value.env_steps if delay > INTERVAL else INJECTED)


def test_a_rollback_continues_with_other_random_numbers_and_a_lower_rate(tmp_path: Path) -> None:
    """From the checkpoint at 600 steps, with half the learning rate."""
    warnings: list[str] = []
    made = trainer(tmp_path, nan_weight, on_divergence="rollback", total_steps=1_000)
    made.warn = warnings.append
    assert made.run() == "steps"
    assert (made.progress.env_steps, made.progress.rollbacks, len(warnings)) == (1_000, 1, 1)
    assert_sound(made.run_directory, 1_000)
    plain = trainer(tmp_path, lambda made: None, total_steps=1_000)
    plain.run()
    tables = [read_table(one.run_directory.path / "updates.csv") for one in (made, plain)]
    rates = [{int(row["env_steps"]): float(row["learning_rate"]) for row in table} for table in tables]
    for steps, rate in rates[1].items():
        assert rates[0][steps] == pytest.approx(rate / 2 if steps >= SAVED else rate, rel=1e-4)
    episodes = [read_table(one.run_directory.path / "episodes.csv") for one in (made, plain)]
    assert [row for row in episodes[0] if int(row["env_steps"]) <= SAVED] == [
        row for row in episodes[1] if int(row["env_steps"]) <= SAVED
    ]
    assert episodes[0] != episodes[1]
    assert [int(row["episode"]) for row in episodes[0]] == list(range(1, len(episodes[0]) + 1))


@pytest.mark.parametrize("fault", [no_end, dead_advantages])
def test_a_training_that_was_interrupted_diverges_at_the_same_step(fault: Fault, tmp_path: Path) -> None:
    whole = trainer(tmp_path, fault)
    with pytest.raises(DivergenceError) as expected:
        whole.run()
    stopped = trainer(tmp_path, fault)
    stopped.interrupted = lambda: stopped.progress.env_steps > INJECTED
    assert stopped.run() == "interrupted"
    resumed = trainer_in(stopped.run_directory, stopped.training, step_limit=LIMIT, validate=None)
    resumed.restore()
    if fault is not dead_advantages:  # those are in the checkpoint
        fault(resumed)
    with pytest.raises(DivergenceError) as caught:
        resumed.run()
    assert caught.value.env_steps == expected.value.env_steps > stopped.progress.env_steps


def test_a_restored_monitor_knows_the_first_values() -> None:
    training = Training(**SETTINGS)
    first, second = Monitor(training), Monitor(training)
    first.check_update({"q_mean": 3.0}, 0)
    second.restore(*first.state(), same_episodes=True)
    second.check_update({"q_mean": 5.9}, 8)
    with pytest.raises(DivergenceError):
        second.check_update({"q_mean": 6.1}, 16)


@pytest.mark.parametrize("mode", ["stop", "continue", "rollback"])
def test_a_fault_in_the_first_step_after_a_resume(
    mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The networks are checked after the faulty step, too, where it completes a row of updates.csv."""
    monkeypatch.setattr(trainer_module, "UPDATE_ROWS", 100_000)  # every update is a row
    settings = {"on_divergence": mode, "total_steps": 1_000}
    stopped = trainer(tmp_path, lambda made: None, **settings)
    stopped.interrupted = lambda: stopped.progress.env_steps > INJECTED
    assert stopped.run() == "interrupted"
    warnings: list[str] = []
    resumed = trainer_in(stopped.run_directory, stopped.training, validate=None, warn=warnings.append)
    resumed.restore()
    nan_reward(resumed)
    with pytest.raises(DivergenceError) if mode != "continue" else nullcontext():
        resumed.run()
    assert [text for text in warnings if "'final'" in text] or mode == "stop"


def test_an_environment_that_fails_in_the_first_step_after_a_resume(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trainer_module, "UPDATE_ROWS", 100_000)
    stopped = trainer(tmp_path, lambda made: None)
    stopped.interrupted = lambda: stopped.progress.env_steps > INJECTED
    assert stopped.run() == "interrupted"
    resumed = trainer_in(stopped.run_directory, stopped.training, validate=None)
    resumed.restore()

    def step(actions: Any) -> None:
        raise ArithmeticError("broken")

    env(resumed).step = step
    with pytest.raises(ArithmeticError, match="broken"):
        resumed.run()


def test_a_rollback_before_the_first_checkpoint_stops(tmp_path: Path) -> None:
    errors = {}
    for reaction in ("stop", "rollback"):
        made = trainer(tmp_path / reaction, nan_weight, on_divergence=reaction, evaluate_every_steps=10_000)
        with pytest.raises(DivergenceError) as caught:
            made.run()
        assert made.progress.rollbacks == 0
        errors[reaction] = caught.value
    assert errors["rollback"].code == errors["stop"].code == "diverged"
    assert errors["rollback"].term == errors["stop"].term


def test_a_fault_that_returns_stops_the_training_in_the_end(tmp_path: Path) -> None:
    made = trainer(tmp_path, nan_loss, times=100, on_divergence="rollback", total_steps=1_000)
    with pytest.raises(DivergenceError):
        made.run()
    assert made.progress.rollbacks == MAX_ROLLBACKS
    assert_sound(made.run_directory, INJECTED)


@pytest.mark.parametrize("fault", [nan_weight, exploding_values, nan_observation])
def test_a_training_that_continues_does_not_save_what_is_not_finite(fault: Fault, tmp_path: Path) -> None:
    warnings: list[str] = []
    made = trainer(tmp_path, fault, on_divergence="continue", total_steps=1_000)
    made.warn = warnings.append
    assert made.run() == "steps"
    assert warnings
    assert_sound(made.run_directory, 1_000 if fault is exploding_values else INJECTED)
