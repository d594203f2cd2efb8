"""Rollouts and a short training repeat what was recorded, bit for bit where the machine is the same."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.golden import recording

DIGESTS = json.loads(recording.DIGESTS.read_text(encoding="utf-8"))
NUMBERS = np.load(recording.NUMBERS)
SAME_MACHINE = DIGESTS["machine"] == recording.machine()


@pytest.mark.slow
@pytest.mark.parametrize("scenario", recording.SCENARIOS)
def test_a_rollout_with_fixed_actions(scenario: str) -> None:
    digest, numbers = recording.rollout(scenario)
    np.testing.assert_allclose(numbers, NUMBERS[f"rollout {scenario}"], rtol=1e-5, atol=1e-4)
    if SAME_MACHINE:
        assert digest == DIGESTS["rollouts"][scenario]


@pytest.mark.slow
@pytest.mark.parametrize("scenario", recording.SCENARIOS)
def test_boats_at_their_goals_and_at_the_quay(scenario: str) -> None:
    digest, numbers = recording.arrivals(scenario)
    rewards = numbers[:, :, -1]
    assert ((rewards == 30_000).sum(), (rewards == -30_000).sum()) == (4, 1)  # goals and collision
    np.testing.assert_allclose(numbers, NUMBERS[f"arrivals {scenario}"], rtol=1e-5, atol=1e-4)
    if SAME_MACHINE:
        assert digest == DIGESTS["arrivals"][scenario]


@pytest.mark.slow
@pytest.mark.parametrize("scenario", [pytest.param("s1", marks=pytest.mark.thorough), "s3"])
def test_a_short_training(scenario: str, tmp_path: Path) -> None:
    run = recording.train(scenario, tmp_path)
    for name, numbers in recording.training_numbers(run).items():
        np.testing.assert_allclose(numbers, NUMBERS[f"{name} {scenario}"], rtol=2e-3, atol=2e-3)
    if SAME_MACHINE:
        assert recording.training_digests(run) == DIGESTS["trainings"][scenario]
