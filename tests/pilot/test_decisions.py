"""The pilot: alone with NumPy, equal to the simulator and to torch."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.pilot import compare
from dockctl.agents.checkpoint import load_pair
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.tensors import load_parameters
from dockctl.evaluation import load_policy
from dockctl.evaluation.policies import CheckpointPolicy
from dockctl.pilot import Pilot, Reading
from dockctl.scenarios.loader import load
from tests.pilot.inputs import AWAY, CLOUD, FINAL, INTERMEDIATE, REST, decide, in_wind, observed

TASK = load("s3").scenario.task
ALONE = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] not in sys.stdlib_module_names | {"numpy", "dockctl"}:
            raise ImportError(f"blocked: {name}")

sys.meta_path.insert(0, Blocked())
from dockctl.pilot import Pilot, Reading

pilot = Pilot.load(sys.argv[1])
pose, velocity, cloud = (Reading(0.0, value) for value in ((23, -10, 1.57), (0, 0, 0), [[8.0, 1.0, 0.5]]))
print(pilot.decide(0.0, pose, velocity, {"bow": cloud}).action)
print(*(name for name in ("torch", "numba", "pydantic", "gymnasium", "trimesh") if name in sys.modules))
"""


def test_it_needs_only_numpy(s3_pilot: Path, pilot: Pilot) -> None:
    done = subprocess.run([sys.executable, "-c", ALONE, s3_pilot], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    action, heavy = done.stdout.split("\n")[:2]
    assert int(action) in range(77)
    assert heavy == ""


def test_the_description_is_that_of_the_scenario(pilot: Pilot) -> None:
    facts = pilot.description
    columns = {column["name"]: column for column in facts["observation"]}
    assert [*columns][:8] == ["phase", "distance", "heading_error", "u", "v", "r", "propeller", "rudder"]
    assert columns["u"] == {"name": "u", "unit": "m/s", "scale": 0.4, "low": -5.0, "high": 5.0}
    assert columns["rudder"]["scale"] == math.radians(30)
    assert columns["range_8"] == {"name": "range_8", "unit": "m", "scale": 10.0, "low": 0.0, "high": 2.0}
    assert facts["commands"][5] == [-50.0, math.radians(20)]
    assert (facts["control_period_s"], facts["lidar"]["sectors"], facts["scenario"]) == (0.5, 8, "s3")
    assert pilot.limits == (50.0, math.radians(30))
    assert pilot.goals == pytest.approx(np.array([INTERMEDIATE, FINAL]), abs=1e-12)


def test_the_network_is_that_of_torch(pilot: Pilot) -> None:
    loaded = load_policy("s3")
    assert isinstance(loaded, CheckpointPolicy)
    network = DuelingQNetwork(16, 77, loaded.card.hidden_sizes)
    load_parameters(network, load_pair(loaded.file)[0])
    bounds = [[column[side] for column in pilot.description["observation"]] for side in ("low", "high")]
    observations = np.random.default_rng(0).uniform(*bounds, (2000, 16)).astype(np.float32)
    with torch.no_grad():
        expected = network(torch.from_numpy(observations)).numpy()
    found = pilot.networks.q_values(observations)
    assert found.dtype == np.float32
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-3)
    best = np.sort(expected, axis=1)
    clear = best[:, -1] - best[:, -2] > 1e-3
    assert clear.mean() > 0.99
    assert (found.argmax(axis=1) == expected.argmax(axis=1))[clear].all()


def test_an_observation_by_hand(pilot: Pilot) -> None:
    decide(pilot)
    command = np.array(pilot.description["commands"][decide(pilot).action or 0])
    decision = decide(pilot, 0.5, velocity=(0.2, -0.05, 0.01))
    assert decision.observation is not None and decision.sector_ranges_m is not None
    distance = math.hypot(23 - 18, -10 - 3)
    ranges = [math.hypot(8, 1), math.hypot(4, 3), math.hypot(0.5, 6)]
    expected = np.full(8, 100.0)
    expected[[4, 0, 5]] = ranges  # ahead to port, astern to starboard, port
    assert decision.sector_ranges_m == pytest.approx(expected)
    assert decision.observation[:3] == pytest.approx([0, distance / 10, math.radians(90 - 150)], rel=1e-6)
    assert decision.observation[3:6] == pytest.approx([0.5, -0.5, 0.25])
    assert decision.observation[6:8] == pytest.approx(command / [50, math.radians(30)])
    assert decision.observation[8:] == pytest.approx(np.minimum(expected, 20) / 10)


def test_it_continues_with_the_final_pose_after_the_intermediate_one(pilot: Pilot) -> None:
    near = (INTERMEDIATE[0] - 1.4, INTERMEDIATE[1], math.radians(154))
    assert decide(pilot, 0.0, pose=near).phase == 0  # a start is no arrival
    assert decide(pilot, 0.5, pose=near, velocity=(0.1, 0.0, 0.0)).phase == 0  # too fast
    decision = decide(pilot, 1.0, pose=near)
    assert (decision.phase, decision.stop) == (1, "")
    assert decision.observation is not None
    assert decision.observation[1] == pytest.approx(math.hypot(36 - near[0], 3) / 10)
    assert decide(pilot, 1.5).phase == 1
    pilot.reset()
    assert decide(pilot, 2.0).phase == 0


def test_it_stops_where_it_arrives(s3_pilot: Path) -> None:
    pilot = Pilot.load(s3_pilot, final=FINAL)
    near = (FINAL[0] - 0.9, FINAL[1], math.radians(-178))
    assert decide(pilot, 0.0, pose=near).phase == 1  # no intermediate pose
    assert not decide(pilot, 0.5, pose=near, velocity=(0.101, 0.0, 0.0)).arrived
    decision = decide(pilot, 1.0, pose=near, velocity=(0.1, 0.0, 0.0))
    assert decision.arrived and decision.stop
    assert (decision.propeller_n, decision.rudder_rad) == (0, 0)
    assert decide(pilot, 1.5, pose=(34.0, 0.0, 3.0)).arrived  # until the next maneuver


def test_it_stops_after_the_time_of_an_episode(pilot: Pilot) -> None:
    stops = [decide(pilot, step / 2).stop for step in range(TASK.max_steps + 2)]
    assert [bool(stop) for stop in stops] == [False] * TASK.max_steps + [True] * 2


def test_a_policy_that_observes_the_wind(weather: Pilot, pilot: Pilot) -> None:
    assert (weather.flows, pilot.flows) == (("apparent_wind", "through_water"), ())
    weather.reset()
    velocities = [(0.3, 0.0, 0.0), (0.2, -0.05, 0.01), (0.1, 0.05, 0.0), (0.0, 0.04, 0.0)]
    decisions = [in_wind(weather, i, velocity=Reading(i, nu)) for i, nu in enumerate(velocities)]
    first, *_, last = (observed(weather, decision) for decision in decisions)
    assert [last[name] for name in ("wind_ahead", "wind_port")] == pytest.approx([-3, 1])
    assert [last[name] for name in ("u_water", "v_water")] == pytest.approx([0.3, -0.05])
    assert last["speed"] == pytest.approx(0.04)
    course = math.radians(90 + 90 - 150)  # heading, to port of it, and the heading of the goal
    assert [last["course_sin"], last["course_cos"]] == pytest.approx([math.sin(course), math.cos(course)])
    for age in (1, 2):
        then = [last[f"{name}_{age}_ago"] for name in ("u", "v", "r", "propeller", "rudder")]
        before = decisions[2 - age]  # whose command the decision after it observed
        command = before.propeller_n, before.rudder_rad
        assert then == pytest.approx([*velocities[3 - age], *command], abs=1e-6)
        assert [first[f"{name}_{age}_ago"] for name in ("u", "propeller")] == pytest.approx([0.3, 0])


def test_several_clouds_are_one(pilot: Pilot, s3_pilot: Path) -> None:
    pose, velocity = Reading(0.0, AWAY), Reading(0.0, REST)
    clouds = {str(number): Reading(0.0, CLOUD[[number]]) for number in range(3)}
    split = pilot.decide(0.0, pose, velocity, clouds)
    whole = decide(Pilot.load(s3_pilot))
    assert split.sector_ranges_m is not None and whole.sector_ranges_m is not None
    assert split.sector_ranges_m.tolist() == whole.sector_ranges_m.tolist()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["s1", *(pytest.param(name, marks=pytest.mark.thorough) for name in ("marinas", "marinas-weather"))],
)
def test_its_decisions_are_those_of_the_simulator(name: str) -> None:
    """From all points of a scan; the sectors of the simulator come from another algorithm."""
    result = compare(name, 25)
    assert (result["decisions"], result["other_action"], result["other_observation"]) == (25, 0, 0)
    assert result["stops"] == []
