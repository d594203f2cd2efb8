"""The mirror images of observations and actions, against a list by hand and against the simulation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dockctl.envs.mirror import mirror_images
from dockctl.envs.observation import Columns, ObservationEncoder, View, observation_part
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import InputError
from dockctl.experiments.dry_run import dry_run
from dockctl.scenarios.base import FieldError
from dockctl.scenarios.loader import load
from dockctl.sim.world import in_open_water

CHANGING_SIGN = {
    "v", "r", "rudder", "heading_error", "bearing_sin", "offset_port", "course_sin", "wind_port",
    "v_1_ago", "r_1_ago", "rudder_1_ago", "v_2_ago", "r_2_ago", "rudder_2_ago",
}  # fmt: skip
OPPOSITE = {f"range_{sector}": f"range_{9 - sector}" for sector in range(1, 9)}
WALL = [[[34, -9, -1], [34, 9, -1], [34, 9, 6]], [[34, -9, -1], [34, 9, 6], [34, -9, 6]]]
"""A surface that is its own mirror image in the x axis."""
POSES = np.array([[20, -4, 1.5], [24, 3, -2.0], [18, 6, 0.4], [26, -5, 3.0]])
IMAGE = np.array([1, -1, -1])


@pytest.mark.parametrize("name", ["s1", "s3", "marina", "s1-weather"])
def test_images_of_observations(name: str) -> None:
    scenario = load(name).scenario
    names = ObservationEncoder(scenario.observation, 8).names
    columns, signs, _ = mirror_images(scenario)
    assert [names[column] for column in columns] == [OPPOSITE.get(name, name) for name in names]
    assert [sign < 0 for sign in signs] == [name in CHANGING_SIGN for name in names]


def test_a_planar_scanner_is_symmetric() -> None:
    images = mirror_images(load("s3", overrides=["sensors.lidar={kind: planar}"]).scenario)
    assert images[0].tolist() == [*range(8), *range(15, 7, -1)]


def test_a_part_at_its_bound_has_the_image_of_its_sectors() -> None:
    """All ranges of the trials are below 10 m, where this proximity is 1."""
    parts = ["observation=[{proximity: {full_m: 50}}, {lidar: {cap_m: 0.1}}]", "sensors.lidar={kind: planar}"]
    images = mirror_images(load("s3", overrides=parts).scenario)
    assert images[0].tolist() == [*range(7, -1, -1), *range(15, 7, -1)]


@pytest.mark.parametrize("actions", ["grid", "incremental"])
def test_images_of_actions(actions: str) -> None:
    scenario = load("s3", overrides=[f"actions.kind={actions}"]).scenario
    images = mirror_images(scenario)[2]
    every, last = np.arange(len(images)), np.tile([10.0, 0.1], (len(images), 1))
    commands = scenario.actions.next_commands(every, scenario.vessel, last)
    mirrored = scenario.actions.next_commands(images, scenario.vessel, last * [1, -1])
    assert mirrored == pytest.approx(commands * [1, -1])


def test_the_image_of_an_episode_is_an_episode() -> None:
    """In a harbor that is its own image; rays on the border of two sectors count for one of them."""
    rng = np.random.default_rng(0)
    env, mirrored = (environment(side) for side in (1, -1))
    columns, signs, actions = mirror_images(env.scenario)
    observation, _ = env.reset(seed=0, options={"poses": POSES})
    image, _ = mirrored.reset(seed=0, options={"poses": POSES * IMAGE})
    ranges = [i for i, name in enumerate(env.observation_names) if name.startswith("range")]
    for _ in range(40):
        difference = np.abs(image - observation[:, columns] * signs)
        assert np.delete(difference, ranges, axis=1).max() < 1e-5
        assert difference[:, ranges].max() < 0.01
        action = rng.integers(77, size=len(POSES))
        observation, reward, terminated, truncated, _ = env.step(action)
        image, reward_of_image, *_ = mirrored.step(actions[action])
        assert reward_of_image == pytest.approx(reward)
        assert not (terminated | truncated).any()


def environment(side: int) -> DockingVectorEnv:
    poses = {"task.final": [30, 5, 180], "task.intermediate": [20, 3, 150]}
    changes = [
        f"{pose}.{key}={value}"
        for pose, (x, y, heading) in poses.items()
        for key, value in (("x_m", x), ("y_m", side * y), ("heading_deg", side * heading))
    ]
    parts = "[phase, distance, bearing, heading_error, velocity, command, lidar, course, offset]"
    loaded = load("s3", overrides=[*changes, f"observation={parts}"])
    world = in_open_water(loaded.scenario.sensors.lidar.build(np.array(WALL, float)))
    return DockingVectorEnv(loaded, len(POSES), worlds=[world])


def refused(*changes: str) -> FieldError:
    with pytest.raises(FieldError) as caught:
        mirror_images(load("s3", overrides=changes).scenario)
    assert (caught.value.field, caught.value.code) == ("training.mirrored", "mismatch")
    return caught.value


def test_what_has_no_image() -> None:
    mount = "{pitch_deg: 30, yaw_deg: 90, x_m: 0, y_m: 0.5, z_m: 3}"
    refused(f"sensors.lidar.mounts=[{mount}]")
    refused("actions.rudder_deg=[-30, 0]")
    refused("actions.kind=continuous")

    @observation_part("port_range")
    def port_range(view: View) -> Columns:
        return Columns(["port"], view.sector_ranges_m[:, 5:6], 0, 10)

    assert "'port_range'" in refused("observation=[phase, port_range]").message


def test_the_error_has_a_place(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("extends: s3\ntraining:\n  mirrored: true\nactions: {kind: grid, rudder_deg: [-30, 0]}\n")
    with pytest.raises(InputError) as caught:
        dry_run(load(file))
    problem = caught.value.problems[0]
    assert (problem.line, problem.field) == (3, "training.mirrored")
