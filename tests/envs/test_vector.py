"""The vector environment: seeds, independence of the number of boats, options, errors."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded

from dockctl.envs.actions import GridActions
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError, InputError
from dockctl.scenarios.loader import load
from dockctl.sim.starts import given_start, own_site
from tests.sim.worlds import walled

S2, S3 = load("s2"), load("s3", overrides=["task.max_steps=40", "training.exploring_starts.steps=25"])


def env(boats: int, *, exploring: bool = True, source: Any = S3, wall: float = 24.0) -> DockingVectorEnv:
    return DockingVectorEnv(source, boats, exploring=exploring, worlds=[walled(wall)])


def test_scenario_3_without_an_intermediate_pose() -> None:
    """One phase from the start of scenario 3 to the berth, with the 15 numbers of scenario 1."""
    direct = DockingVectorEnv("s3-direct", 3, worlds=[walled()])
    assert direct.observation_names == DockingVectorEnv("s1", 1, worlds=[walled()]).observation_names
    assert "intermediate" not in direct.reward.names
    _, info = direct.reset(seed=0)
    assert np.degrees(info["pose"]) * [np.pi / 180, np.pi / 180, 1] == pytest.approx(
        np.tile([23.0, -10.0, 90.0], (3, 1))
    )
    for _ in range(3):
        observation, _, _, _, info = direct.step(np.full(3, 73))
        assert observation.shape == (3, 15)
        assert info["phase"].tolist() == [1, 1, 1]
        x, y, _ = info["pose"].T
        assert info["distance_m"] == pytest.approx(np.hypot(x - 36, y))


def record(vector: DockingVectorEnv, seed: Any, actions: np.ndarray) -> list[np.ndarray]:
    """Return observations, rewards and poses of every step, over many episodes."""
    first, info = vector.reset(seed=seed)
    steps = [first, info["pose"]]
    for action in actions:
        observation, reward, terminated, truncated, info = vector.step(action)
        steps += [observation, reward, terminated, truncated, info["pose"], info["sector_ranges_m"]]
    return steps


@pytest.fixture(scope="module")
def actions() -> np.ndarray:
    return np.random.default_rng(3).integers(0, 77, (250, 8))


def test_the_same_seed_gives_the_same_bits(actions: np.ndarray) -> None:
    first, second = record(env(8), 11, actions), record(env(8), 11, actions)
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
    assert not np.array_equal(first[1], record(env(8), 12, actions[:1])[1])


def test_a_boat_does_not_depend_on_the_number_of_boats(actions: np.ndarray) -> None:
    eight, three = record(env(8), 11, actions), record(env(3), 11, actions[:, :3])
    assert all(np.array_equal(a[:3], b) for a, b in zip(eight, three, strict=True))
    assert sum(steps.sum() for steps in (*three[4::6], *three[5::6])) > 20  # terminated, truncated


def test_a_row_with_its_own_seed_is_the_same_boat(actions: np.ndarray) -> None:
    seeds = list(range(20, 28))
    eight = record(env(8), seeds, actions)
    for row in (0, 5):
        for single in (
            record(env(1), [seeds[row]], actions[:, [row]]),
            record(env(1), seeds[row], actions[:, [row]]),
        ):
            assert all(np.array_equal(a[[row]], b) for a, b in zip(eight, single, strict=True))


def test_a_reset_without_seed_continues_the_generators() -> None:
    vector = env(8)
    first = vector.reset(seed=0)[1]["pose"]
    second = vector.reset()[1]["pose"]
    assert not np.array_equal(first, second)
    assert np.array_equal(vector.reset(seed=0)[1]["pose"], first)
    assert np.array_equal(vector.reset()[1]["pose"], second)


def test_scenario_2_starts_at_all_its_initial_poses() -> None:
    _, info = env(40, source=S2, exploring=False).reset(seed=0)
    assert set(info["start_index"]) == {0, 1, 2}
    assert set(info["start_kind"]) == {"pose"}


def test_info_is_complete_and_copied() -> None:
    vector = env(2, exploring=False)
    vector.reset(seed=0)
    _, reward, _, _, info = vector.step(np.array([73, 0]))
    assert info["pose"].shape == info["velocity"].shape == (2, 3)
    assert info["command"] == pytest.approx(np.array([[50, 0], [-50, -math.pi / 6]]))
    assert info["sector_ranges_m"].shape == (2, 8)
    assert info["distance_m"] == pytest.approx(np.hypot(info["pose"][:, 0] - 18, info["pose"][:, 1] - 3))
    assert sum(info["reward_terms"].values()) == pytest.approx(reward)
    copies = {key: np.copy(value) for key, value in info.items() if not isinstance(value, dict)}
    vector.step(np.array([73, 0]))
    assert all(np.array_equal(copies[key], info[key]) for key in copies)


def test_poses_set_the_start_poses() -> None:
    vector = env(2)
    poses = np.array([[20.0, 3.0, 2.5], [19.0, -1.0, 3.0]])
    observations, info = vector.reset(options={"poses": poses})
    assert np.array_equal(info["pose"], poses)
    assert info["phase"].tolist() == [0, 0]
    assert (info["start_kind"].tolist(), info["start_index"].tolist()) == (["pose", "pose"], [0, 1])
    assert observations in vector.observation_space
    assert (vector.simulator.max_steps == S3.scenario.task.max_steps).all()


def test_a_mask_resets_its_rows() -> None:
    vector = env(3, exploring=False)
    vector.reset(seed=0)
    _, _, _, _, before = vector.step(np.full(3, 73))
    _, info = vector.reset(options={"reset_mask": np.array([False, True, False])})
    assert np.array_equal(info["pose"][[0, 2]], before["pose"][[0, 2]])
    assert info["pose"][1] == pytest.approx([23, -10, math.pi / 2])


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"poses": [[20, 0, 0]]}, "mismatch"),
        ({"poses": [[20, 0, 0], [math.nan, 0, 0]]}, "mismatch"),
        ({"poses": [[20, 0, 0], [25, 1, math.pi]]}, "invalid"),
        ({"starts": []}, "mismatch"),
        ({"reset_mask": np.array([True])}, "mismatch"),
        ({"reset_mask": np.array([False, False])}, "mismatch"),
        ({"pose": [[20, 0, 0], [20, 0, 0]]}, "unknown_key"),
    ],
)
def test_wrong_options_are_rejected(options: dict[str, Any], code: str) -> None:
    with pytest.raises(DockctlError) as caught:
        env(2).reset(seed=0, options=options)
    assert caught.value.code == code
    assert caught.value.suggestion == ("poses" if "pose" in options else "")


@pytest.mark.parametrize("place", [(60, 0), (20, -50), (-30, 0), (1000, 1000), (45, 0)])
def test_starts_behind_and_in_the_quays_are_refused(place: tuple[float, float]) -> None:
    """The basin is x 4.5 to 38.5 m, y -40 to 40 m; the quays are 12 m wide."""
    vector = DockingVectorEnv(load("s3", overrides=["sensors={lidar: {kind: planar, rays: 4}}"]), 1)
    good, _ = vector.reset(seed=0)
    with pytest.raises(DockctlError):
        vector.reset(options={"poses": np.array([[*place, 0.0]])})
    start = replace(vector._draw(np.array([0]))[0], eta=np.array([*place, 0.0]))
    with pytest.raises(DockctlError):
        vector.reset(options={"starts": [start]})
    assert np.array_equal(vector.reset(options={"poses": np.array([[23.0, -10.0, math.pi / 2]])})[0], good)


def test_a_scenario_whose_boat_starts_in_a_quay_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "ashore.yaml").write_text(
        "extends: s1\ntask: {initial: [{x_m: 45, y_m: 0, heading_deg: 0}]}\n"
    )
    with pytest.raises(InputError) as caught:
        DockingVectorEnv(tmp_path / "ashore.yaml")
    (problem,) = caught.value.problems
    assert (problem.line, problem.field) == (2, "task.initial.0")


@pytest.mark.parametrize(
    ("argument", "code"),
    [({"render_mode": "human"}, "unknown_name"), ({"autoreset_mode": "Never"}, "unknown_name")],
)
def test_wrong_arguments_are_rejected(argument: dict[str, Any], code: str) -> None:
    with pytest.raises(DockctlError) as caught:
        DockingVectorEnv(S3, 1, worlds=[walled()], **argument)
    assert caught.value.code == code


def test_a_wrong_number_of_seeds_is_rejected() -> None:
    with pytest.raises(DockctlError) as caught:
        env(2).reset(seed=[1, 2, 3])
    assert caught.value.code == "mismatch"


@pytest.mark.parametrize("actions", [[0], [0, 77], [-1, 0], [0, 0, 0]])
def test_wrong_actions_are_rejected(actions: list[int]) -> None:
    vector = env(2)
    vector.reset(seed=0)
    with pytest.raises(InvalidAction):
        vector.step(np.array(actions))


def test_a_step_before_the_first_reset_is_rejected() -> None:
    with pytest.raises(ResetNeeded):
        env(2).step(np.array([0, 0]))


@pytest.mark.parametrize("scenario", ["s3", "s1-weather"])
def test_a_boat_without_a_start_rests_and_leaves_the_others_as_they_are(scenario: str) -> None:
    loaded = load(scenario)
    task, site = loaded.scenario.task, own_site(loaded.scenario)
    first, second = (given_start(site, task, np.array([23.0, y, 1.6]), 0) for y in (-10.0, -9.0))
    alone = DockingVectorEnv(loaded, 2, autoreset_mode="Disabled")
    among = DockingVectorEnv(loaded, 3, autoreset_mode="Disabled", worlds=alone.worlds)
    alone.reset(seed=[1, 3], options={"starts": [first, second]})
    _, start = among.reset(seed=[1, 2, 3], options={"starts": [first, None, second]})
    scanned: list[int] = []
    scan = among.simulator.scan
    among.simulator.scan = lambda rows=None: (scanned.extend(rows), scan(rows))[1]  # type: ignore[method-assign]  # spy
    for _ in range(30):
        expected, seen = alone.step(np.array([60, 73])), among.step(np.array([60, 5, 73]))
        for name, there, here in zip(("observation", "reward"), expected, seen, strict=False):
            assert np.array_equal(there, here[[0, 2]]), name
        assert not (seen[2][1] or seen[3][1] or seen[1][1])
        assert np.array_equal(seen[4]["pose"][1], start["pose"][1])
    assert sorted(set(scanned)) == [0, 2]
    _, info = among.reset(
        options={"starts": [None, first, None], "reset_mask": np.array([False, True, False])}
    )
    assert np.array_equal(info["pose"][1], first.eta)
    assert not np.array_equal(among.step(np.array([60, 60, 73]))[4]["pose"][1], first.eta)


def test_an_action_type_that_returns_another_shape_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(GridActions, "commands", lambda self, actions, vessel: np.zeros((len(actions), 3)))
    vector = env(2)
    vector.reset(seed=0)
    with pytest.raises(DockctlError, check=lambda error: error.code == "plugin"):
        vector.step(np.zeros(2, int))
