"""The pilot: alone with NumPy, equal to the simulator and to torch, and a stop at every bad input."""

from __future__ import annotations

import io
import json
import math
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.pilot import compare
from dockctl.agents.checkpoint import load_pair
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.tensors import load_parameters
from dockctl.errors import DockctlError
from dockctl.evaluation import load_policy
from dockctl.evaluation.policies import CheckpointPolicy
from dockctl.experiments.portable import export_files
from dockctl.pilot import Checks, Decision, Pilot, Reading
from dockctl.scenarios.loader import load

TASK = load("s3").scenario.task
INTERMEDIATE, FINAL = (18.0, 3.0, math.radians(150)), (36.0, 0.0, math.pi)
AWAY, REST = (23.0, -10.0, math.pi / 2), (0.0, 0.0, 0.0)
CLOUD = np.array([[8.0, 1.0, 0.5], [-4.0, -3.0, 1.0], [0.5, 6.0, 0.2]])
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


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped policy of scenario 3, exported."""
    path = tmp_path_factory.mktemp("pilot") / "s3.npz"
    export_files([Path("s3")], None, path)
    return path


@pytest.fixture
def pilot(file: Path) -> Pilot:
    return Pilot.load(file)


def decide(pilot: Pilot, now_s: float = 0.0, **readings: Any) -> Decision:
    """Decide from good inputs measured now, except those given."""
    good = {"pose": AWAY, "velocity": REST, "cloud": CLOUD}
    given = {name: Reading(now_s, value) for name, value in good.items()}
    given |= {
        name: value if value is None or isinstance(value, Reading) else Reading(now_s, value)
        for name, value in readings.items()
    }
    return pilot.decide(now_s, given["pose"], given["velocity"], {"bow": given["cloud"]})


def test_it_needs_only_numpy(file: Path, pilot: Pilot) -> None:
    done = subprocess.run([sys.executable, "-c", ALONE, file], capture_output=True, text=True)
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


def test_it_stops_where_it_arrives(file: Path) -> None:
    pilot = Pilot.load(file, final=FINAL)
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


class Raising:
    """An object whose numbers cannot be read."""

    def __array__(self, *args: Any, **options: Any) -> Any:
        raise RuntimeError


BAD = {
    "no pose yet": {"pose": None},
    "no velocity yet": {"velocity": None},
    "no cloud yet": {"cloud": None},
    "pose too old": {"pose": Reading(9.4, AWAY)},
    "velocity too old": {"velocity": Reading(9.4, REST)},
    "cloud too old": {"cloud": Reading(9.4, CLOUD)},
    "cloud of the future": {"cloud": Reading(10.6, CLOUD)},
    "time is NaN": {"pose": Reading(math.nan, AWAY)},
    "time is text": {"pose": Reading("now", AWAY)},  # type: ignore[arg-type]
    "time is a number as text": {"pose": Reading("10", AWAY)},  # type: ignore[arg-type]
    "pose is NaN": {"pose": (23.0, math.nan, 1.0)},
    "heading is infinite": {"pose": (23.0, -10.0, math.inf)},
    "velocity is NaN": {"velocity": (math.nan, 0.0, 0.0)},
    "pose without heading": {"pose": (23.0, -10.0)},
    "pose is text": {"pose": ("x", "y", "z")},
    "pose is a number as text": {"pose": ("23", "-10", "1.5")},
    "pose is true": {"pose": (True, True, True)},
    "pose is a duration": {"pose": np.array([1, 2, 3], "m8[s]")},
    "pose is complex": {"pose": np.array([23, -10, 1j])},
    "pose raises": {"pose": Raising()},
    "points are far beyond everything": {"cloud": np.array([[1e308, 0.0, 0.0]])},
    "pose is no floating-point number": {"pose": (10**400, 0, 0)},
    "time is no floating-point number": {"cloud": Reading(10**400, CLOUD)},
    "points are NaN": {"cloud": np.array([[1.0, math.nan, 0.0]])},
    "points are masked": {"cloud": np.ma.masked_less(CLOUD, CLOUD.max())},
    "pose is masked": {"pose": np.ma.array((23, -10, 1), mask=(0, 0, 1))},
    "points are infinite": {"cloud": np.array([[1.0, math.inf, 0.0]])},
    "points in a plane": {"cloud": CLOUD[:, :2]},
    "points in millimeters": {"cloud": 1000 * CLOUD},
    "no points": {"cloud": CLOUD[:0]},
    "surge": {"velocity": (2.1, 0.0, 0.0)},
    "sway": {"velocity": (0.0, -0.51, 0.0)},
    "yaw rate": {"velocity": (0.0, 0.0, 0.21)},
    "a jump": {"pose": (23.0, -4.9, 1.5)},
}


@pytest.mark.parametrize("name", BAD)
def test_bad_inputs_stop_the_boat(pilot: Pilot, name: str) -> None:
    """The last decision was one second before: 2 m/s and 1 m allow 3 m."""
    assert not decide(pilot, 9.0).stop
    decision = decide(pilot, 10.0, **BAD[name])
    (subject,) = BAD[name]
    assert decision.stop.startswith({"sway": "v", "surge": "u", "yaw rate": "r"}.get(name, subject))
    assert (decision.propeller_n, decision.rudder_rad, decision.action) == (0, 0, None)
    after = decide(pilot, 11.0, pose=BAD[name]["pose"] if name == "a jump" else AWAY)
    assert after.stop == ""
    assert after.observation is not None and after.observation[6:8].tolist() == [0, 0]  # of the stop


NO_TIMES: list[Any] = [
    "10.0",
    None,
    math.nan,
    math.inf,
    True,
    np.True_,
    [10.0],
    np.array([10.0]),
    10j,
    10**400,
]


@pytest.mark.parametrize("now_s", NO_TIMES, ids=lambda value: str(value)[:8])
def test_what_is_no_time_stops_the_boat(pilot: Pilot, now_s: Any) -> None:
    assert not decide(pilot, 9.0).stop
    decision = pilot.decide(now_s, Reading(10.0, AWAY), Reading(10.0, REST), {"bow": Reading(10.0, CLOUD)})
    assert decision.stop.startswith("now_s")
    assert (decision.propeller_n, decision.rudder_rad, decision.action) == (0, 0, None)
    assert decide(pilot, 11.0).stop == ""


@pytest.mark.parametrize("now_s", [10, np.float32(10.0), np.int64(10)])
def test_a_time_is_any_real_number(pilot: Pilot, now_s: Any) -> None:
    assert decide(pilot, now_s).stop == ""


@pytest.fixture(scope="module")
def weather(tmp_path_factory: pytest.TempPathFactory) -> Pilot:
    """A shipped policy that observes wind, the speed through the water, and earlier steps."""
    path = tmp_path_factory.mktemp("weather") / "marinas-weather.npz"
    export_files([Path("marinas-weather")], None, path)
    return Pilot.load(path, final=FINAL, intermediate=INTERMEDIATE)


def in_wind(pilot: Pilot, now_s: float, **readings: Any) -> Decision:
    """Decide from good inputs measured now, except those given."""
    good = {"pose": AWAY, "velocity": REST, "apparent_wind": (-3.0, 1.0), "through_water": (0.3, -0.05)}
    given = {name: Reading(now_s, value) for name, value in good.items()} | readings
    return pilot.decide(now_s, clouds={"bow": Reading(now_s, CLOUD)}, **given)


def observed(pilot: Pilot, decision: Decision) -> dict[str, float]:
    """Return the columns of an observation in units."""
    assert decision.observation is not None
    columns = zip(pilot.description["observation"], decision.observation, strict=True)
    return {column["name"]: column["scale"] * value for column, value in columns}


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


BAD_FLOWS = {
    "never arrived": None,
    "without a time": (1.0, 0.0),
    "too old": Reading(9.4, (1.0, 0.0)),
    "NaN": Reading(10.0, (math.nan, 0.0)),
    "three numbers": Reading(10.0, (1.0, 0.0, 0.0)),
    "text": Reading(10.0, ("x", "y")),
    "too fast": Reading(10.0, (0.0, 26.0)),
}


@pytest.mark.parametrize("name", ["apparent_wind", "through_water"])
@pytest.mark.parametrize("bad", BAD_FLOWS)
def test_bad_measurements_of_air_and_water_stop_the_boat(weather: Pilot, name: str, bad: str) -> None:
    weather.reset()
    assert not in_wind(weather, 9.0, velocity=Reading(9.0, (0.3, 0.0, 0.0))).stop
    decision = in_wind(weather, 10.0, **{name: BAD_FLOWS[bad]})
    columns = {"apparent_wind": "wind_port", "through_water": "v_water"}
    assert decision.stop.startswith(columns[name] if bad == "too fast" else name)
    assert (decision.propeller_n, decision.rudder_rad, decision.action) == (0, 0, None)
    after = observed(weather, in_wind(weather, 11.0))
    assert [after[f"{name}_1_ago"] for name in ("u", "propeller")] == [0, 0]  # as after a start


def test_far_from_the_goal_it_does_not_start(pilot: Pilot) -> None:
    assert decide(pilot, pose=(-90.0, 0.0, 0.0)).stop.startswith("distance")


def test_inputs_at_the_limits_are_good(pilot: Pilot) -> None:
    assert decide(pilot, 9.0).stop == ""
    old = Reading(9.5, AWAY)
    assert decide(pilot, 10.0, pose=old, velocity=(2.0, 0.5, 0.2)).stop == ""
    assert decide(pilot, 11.0, pose=(23.0, -7.1, 1.5)).stop == ""


def test_the_checks_can_be_changed(file: Path) -> None:
    pilot = Pilot.load(file, checks=Checks(max_age_s=2.0, min_points=0))
    assert decide(pilot, 2.0, cloud=Reading(0.0, CLOUD[:0])).stop == ""


def test_several_clouds_are_one(pilot: Pilot, file: Path) -> None:
    pose, velocity = Reading(0.0, AWAY), Reading(0.0, REST)
    clouds = {str(number): Reading(0.0, CLOUD[[number]]) for number in range(3)}
    split = pilot.decide(0.0, pose, velocity, clouds)
    whole = decide(Pilot.load(file))
    assert split.sector_ranges_m is not None and whole.sector_ranges_m is not None
    assert split.sector_ranges_m.tolist() == whole.sector_ranges_m.tolist()


def zip_of(member: bytes, flags: int) -> bytes:
    """Return an archive of one array, whose headers have these flags."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("x.npy", member)
    archived = bytearray(content.getvalue())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        archived[archived.index(signature) + offset] |= flags
    return bytes(archived)


def test_files_that_are_no_policy(file: Path, tmp_path: Path) -> None:
    def code_of(path: Path, **given: Any) -> str:
        with pytest.raises(DockctlError) as caught:
            Pilot.load(path, **given)
        return caught.value.code

    assert code_of(tmp_path / "none.npz") == "not_found"
    assert code_of(tmp_path) == "not_readable"
    content = file.read_bytes()
    damaged = tmp_path / "damaged.npz"
    header = io.BytesIO()
    description = {"descr": "<f4", "fortran_order": False, "shape": (10**13,)}
    np.lib.format.write_array_header_1_0(header, description)
    huge, encrypted = (zip_of(header.getvalue(), flags) for flags in (0, 1))
    compressed = io.BytesIO()
    np.savez_compressed(compressed, zeros=np.zeros(10**6))
    for flawed in (
        b"", b"text", content[:-100], content[:5000] + b"\xff" + content[5001:],
        huge, encrypted, compressed.getvalue(),
    ):  # fmt: skip
        damaged.write_bytes(flawed)
        assert code_of(damaged) == "not_readable"
    with np.load(file) as arrays:
        tensors = {name: arrays[name] for name in arrays.files}
    facts = json.loads(str(tensors["description"]))
    changes: list[dict[str, Any]] = [
        {"description": np.array("{}")},
        {"description": np.array("[" * 100_000)},
        {"description": np.array(json.dumps({**facts, "format": 2}))},
        {"description": np.array(json.dumps({**facts, "max_steps": math.inf}))},
        {"description": np.array(json.dumps({**facts, "control_period_s": -0.5}))},
        {"description": np.array(json.dumps({**facts, "commands": [[math.nan, 0]] * 77}))},
        {"description": np.array(json.dumps({**facts, "commands": [[0]] * 77}))},
        {"description": np.array(json.dumps({**facts, "lidar": {"sectors": 0, "range_m": 100}}))},
        {"description": np.array(json.dumps({**facts, "lidar": {"sectors": 10**11, "range_m": 100}}))},
        {"description": np.array(json.dumps({**facts, "commands": facts["commands"][:-1]}))},
        {"shared.0.weight": np.full_like(tensors["shared.0.weight"], np.nan)},
        {"shared.2.weight": tensors["shared.2.weight"][:, 1:]},
        {"more": np.zeros(1)},
    ]
    for change in changes:
        np.savez(damaged, **{**tensors, **change})
        assert code_of(damaged) == "not_readable"
    for final in ((1.0, 2.0), (10**400, 0, 0), (1e300, 0, 0), np.ma.masked_all(3)):
        assert code_of(file, final=final) == "wrong_type"


@pytest.mark.parametrize("name", ["s3", pytest.param("marinas", marks=pytest.mark.thorough)])
def test_an_onnx_model_decides_the_same(name: str, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    files = tmp_path / "policy.npz", tmp_path / "policy.onnx"
    export_files([Path(name)], files[1], files[0])
    pilots, rng = [Pilot.load(file) for file in files], np.random.default_rng(0)
    for step in range(100):
        pose = Reading(step, [*AWAY[:2], rng.uniform(-3, 3)] + rng.uniform(-1, 1, 3))
        velocity = Reading(step, rng.uniform(-0.15, 0.15, 3))
        cloud = Reading(step, rng.uniform(-8, 8, (50, 3)))
        own, onnx = (
            Pilot(each.description, each.networks, each.goals).decide(step, pose, velocity, {"all": cloud})
            for each in pilots
        )
        assert (own.stop, onnx.stop) == ("", "")
        assert (onnx.action, onnx.propeller_n, onnx.rudder_rad) == (
            own.action,
            own.propeller_n,
            own.rudder_rad,
        )
        assert onnx.q_values == pytest.approx(own.q_values, rel=1e-3, abs=1e-2)


def test_onnx_models_that_are_no_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    onnx = pytest.importorskip("onnx")
    file, flawed = tmp_path / "s1.onnx", tmp_path / "flawed.onnx"
    export_files([Path("s1")], file, None)
    plain, fewer, unnamed = (onnx.load(str(file)) for _ in range(3))
    del plain.metadata_props[:]
    (description,) = (each for each in fewer.metadata_props if each.key == "description")
    facts = json.loads(description.value)
    description.value = json.dumps({**facts, "observation": facts["observation"][1:]})
    del unnamed.graph.output[:1]
    contents = [each.SerializeToString() for each in (plain, fewer, unnamed)]
    for content in (b"", b"text", file.read_bytes()[:-1000], *contents):
        flawed.write_bytes(content)
        with pytest.raises(DockctlError, check=lambda error: error.code == "not_readable"):
            Pilot.load(flawed)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(DockctlError, check=lambda error: error.code == "unavailable"):
        Pilot.load(file)


def test_action_values_that_are_not_finite_stop_the_boat(pilot: Pilot) -> None:
    class Overflowing:
        sizes = pilot.networks.sizes

        def q_values(self, observation: np.ndarray) -> np.ndarray:
            return np.full((len(observation), 77), np.inf, np.float32)

        def greedy(self, observation: np.ndarray, q_values: np.ndarray) -> np.ndarray:
            return q_values.argmax(axis=1)

    decision = decide(Pilot(pilot.description, Overflowing(), pilot.goals))
    assert (decision.propeller_n, decision.rudder_rad) == (0.0, 0.0)
    assert decision.stop


def test_clouds_without_names_stop_the_boat(pilot: Pilot) -> None:
    readings = [Reading(1.0, CLOUD)]
    decision = pilot.decide(1.0, Reading(1.0, AWAY), Reading(1.0, REST), readings)  # type: ignore[arg-type]
    assert decision.stop.startswith("clouds")


def test_a_time_that_is_no_number_stops_the_boat(pilot: Pilot) -> None:
    now: Any = np.array([1.0, 2.0])
    clouds = {"bow": Reading(1.0, CLOUD)}
    assert pilot.decide(now, Reading(1.0, AWAY), Reading(1.0, REST), clouds).stop


def test_an_intermediate_pose_needs_a_final_one(file: Path) -> None:
    with pytest.raises(DockctlError) as caught:
        Pilot.load(file, intermediate=INTERMEDIATE)
    assert caught.value.code == "missing_key"


def test_no_clouds_at_all_stop_the_boat(pilot: Pilot) -> None:
    good = Reading(0.0, AWAY), Reading(0.0, REST)
    assert pilot.decide(0.0, *good, None).stop.startswith("clouds")  # type: ignore[arg-type]


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
