"""Fine-tuning: a training that starts from a trained policy."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from dockctl.agents.checkpoint import find_policy, load_pair, load_policy
from dockctl.dueling import split
from dockctl.errors import DockctlError
from dockctl.experiments import train
from dockctl.experiments.training import TrainedRun
from dockctl.experiments.verify import verify
from tests.commands.conftest import QUICK

MORE = "observation=[phase, distance, apparent_wind, heading_error, velocity, command, {lidar: {cap_m: 20}}]"


def trained(out: Path, *overrides: str, scenario: str = "s3", **options: Any) -> TrainedRun:
    quiet = Console(file=io.StringIO())
    return train(scenario, steps=60, overrides=[*QUICK, *overrides], out=out, console=quiet, **options)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> TrainedRun:
    return trained(tmp_path_factory.mktemp("first"))


def test_a_policy_acts_as_before_whatever_the_new_inputs_are(run: TrainedRun, tmp_path: Path) -> None:
    # without an update, the evaluated network is the initial one
    tuned = trained(tmp_path, MORE, "training.warmup_steps=1000", start_from=run.path)
    before, after = load_policy(run.path)[0], load_policy(tuned.path)[0]
    observation = np.random.default_rng(0).normal(size=(500, 16)).astype(np.float32)
    wind = np.random.default_rng(1).normal(size=(500, 2)).astype(np.float32)
    extended = np.concatenate([observation[:, :2], wind, observation[:, 2:]], axis=1)
    chosen = before.act(observation, {})
    np.testing.assert_array_equal(after.act(extended, {}), chosen)
    assert len(set(chosen)) > 1


def test_a_policy_acts_as_before_in_wider_layers(run: TrainedRun, tmp_path: Path) -> None:
    wider = trained(
        tmp_path, "training.warmup_steps=1000", "training.hidden_sizes=[24, 8]", start_from=run.path
    )
    before, after = load_policy(run.path)[0], load_policy(wider.path)[0]
    observation = np.random.default_rng(0).normal(size=(500, 16)).astype(np.float32)
    np.testing.assert_array_equal(after.act(observation, {}), before.act(observation, {}))
    weights = load_pair(find_policy(wider.path))[0]["shared.0.weight"]
    assert weights.shape == (24, 16)
    assert (weights[16:] != 0).all()  # the new units can learn


def test_of_an_ensemble_the_newest_network_is_taken(tmp_path: Path) -> None:
    ensemble = ("training.ensemble={networks: 3, every_steps: 10}", "training.target_update_interval=5")
    first = trained(tmp_path / "first", *ensemble, "training.hysteresis=100")
    tuned = trained(tmp_path / "tuned", "training.warmup_steps=1000", start_from=first.path)
    (newest, *others), mirror, hysteresis = split(load_pair(find_policy(first.path))[0])
    assert (len(others), mirror, hysteresis is not None) == (2, None, True)
    started = load_pair(find_policy(tuned.path))[0]
    for name, array in newest.items():
        np.testing.assert_array_equal(started[name], array)
        assert any((other[name] != array).any() for other in others)


def test_the_run_folder_suffices_to_repeat_the_training(run: TrainedRun, tmp_path: Path) -> None:
    tuned = trained(tmp_path, "training.seed=5", start_from=run.path)
    result = verify(tuned.path, 50)
    assert result.is_equal
    assert result.tables[1].rows > 0
    (tuned.path / "initial").rename(tmp_path / "moved")
    assert not verify(tuned.path, 50).is_equal


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("training.hidden_sizes=[16]",), "hidden_sizes"),
        (("training.hidden_sizes=[16, 4]",), "hidden_sizes"),
        (("sensors.lidar.sectors=12",), "sensors.lidar"),
        (("observation=[distance, velocity, command]",), "phase, heading_error, lidar"),
        (("actions={kind: grid, propeller_n: [-50, 0, 50]}",), "actions"),
    ],
)
def test_a_policy_that_does_not_fit_is_refused(
    run: TrainedRun, tmp_path: Path, overrides: tuple[str, ...], words: str
) -> None:
    with pytest.raises(DockctlError, match=words) as error:
        trained(tmp_path, *overrides, start_from=run.path)
    assert error.value.code == "mismatch"
    assert not list(tmp_path.iterdir())
