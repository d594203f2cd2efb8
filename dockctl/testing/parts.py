"""Contract tests of reward terms, observation parts, actions, conditions, sensors, vessels and harbors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
from gymnasium.spaces import Discrete, Space
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dockctl.agents.algorithms import AlgorithmSpec
from dockctl.envs.observation import Columns, ObservationEncoder, View
from dockctl.geometry import Floats, nearest_in_sectors, rotate, sector_index, to_world
from dockctl.plugins import ACTIONS, CONDITIONS, OBSERVATION_PARTS, RANGE_SENSORS, REWARD_TERMS
from dockctl.registry import Registry
from dockctl.rewards.terms import Kind as RewardKind
from dockctl.scenarios import catalog
from dockctl.scenarios.extensions import ActionType, Condition, NoisyRangeSensor, RangeNoise, RangeSensorSpec
from dockctl.scenarios.loader import load, load_harbor, load_vessel
from dockctl.scenarios.schema import ObservationPart, Scenario
from dockctl.sim.goal import StepStatus
from dockctl.sim.harbor.build import build_harbor, build_scene
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import given_start, own_site
from dockctl.sim.vessel import ReferenceVesselModel, VesselModel
from dockctl.testing.contract import ContractError, Require, contract_of
from dockctl.testing.environments import SECTORS, Rows, check_environment, open_water

BOATS = 7
SAMPLES = 1000
BASIN_M = 20.0
GROUPS = ("water", "air", "sensing", "actuation", "vessel")


def check_reward_term(name: str, **params: Any) -> None:
    """Check the reward term `name` with these parameters: shape, finite, pure, row by row."""
    catalog.fill()
    entry = REWARD_TERMS.get(name)
    require = contract_of(f"reward term '{name}'")
    require("valid", entry.kind in get_args(RewardKind), f"unknown kind '{entry.kind}'")
    if "distance_unit_m" in entry.parameters:
        params = {"distance_unit_m": 20.0, **params}
    term = entry.bind(params)
    value = _check_rows(require, lambda values: {"value": term(_status(values))}, _step_values())["value"]
    require("shape", value.shape == (BOATS,), f"value of shape {value.shape}, expected {(BOATS,)}")


def check_observation_part(name: str, **params: Any) -> None:
    """Check the observation part `name` with these parameters: shape, names, bounds, pure, row by row."""
    catalog.fill()
    part, require = OBSERVATION_PARTS.get(name).bind(params), contract_of(f"observation part '{name}'")
    limit = np.array([50.0, np.radians(30.0)])

    def columns(values: Rows) -> Columns:
        result = part(View(**values, command_limit=limit, past=()))
        require("valid", isinstance(result, Columns), f"returned {type(result).__name__}, not Columns")
        return cast(Columns, result)

    values = _view_values()
    _check_rows(require, lambda rows: {"values": columns(rows).values}, values)
    names = tuple(columns(values).names)
    require("valid", len({*names}) == len(names), f"duplicate column names {names}")
    alone = columns({key: value[:1] for key, value in values.items()})
    require("independent_rows", tuple(alone.names) == names, "the names depend on the number of boats")
    for bound in (alone.low, alone.high):
        require("finite", (np.abs(bound) < np.finfo(np.float32).max).all(), "the bounds are not finite")
    space = ObservationEncoder([ObservationPart(part=name, params=params)], SECTORS).space
    require("in_range", (space.low < space.high).all(), "a lower bound is not below its upper bound")


def check_action_type(kind: str, *, vessel: str | Path = "eilbrecht", **keys: Any) -> None:
    """Check the action type `kind` with these keys: space, shape and limits of the commands, row by row."""
    spec: ActionType = registered_spec(ACTIONS, ActionType, kind, keys)
    require, boat = contract_of(f"action type '{kind}'"), load_vessel(vessel)
    spec.require_within_limits(boat)
    require("valid", spec.describe(), "no description")
    space = spec.space(boat)
    require("valid", isinstance(space, Space), f"space() returned {space!r}, expected a Gymnasium space")
    batch = batch_space(space, BOATS)
    batch.seed(0)
    actions = np.asarray(batch.sample())
    require("valid", batch.contains(actions), "samples of the space are not plain arrays")
    commands = _check_rows(
        require, lambda rows: {"commands": spec.commands(rows["actions"], boat)}, {"actions": actions}
    )["commands"]
    require(
        "shape", commands.shape == (BOATS, 2), f"commands of shape {commands.shape}, expected {(BOATS, 2)}"
    )
    limit = boat.command_limit
    if spec.has_memory:
        previous = np.random.default_rng(0).uniform(-1, 1, (BOATS, 2)) * limit
        commands = _check_rows(
            require,
            lambda rows: {"commands": spec.next_commands(rows["actions"], boat, rows["previous"])},
            {"actions": actions, "previous": previous},
        )["commands"]
        require("shape", commands.shape == (BOATS, 2), f"next_commands of shape {commands.shape}")
    every = _all_actions(space)
    for side in (-1, 0, 1):
        commands = spec.next_commands(every, boat, np.tile(side * limit, (len(every), 1)))
        require("in_range", (np.abs(commands) <= limit + 1e-9).all(), "a command exceeds the vessel's limits")
    check_environment(_scenario(actions=spec), [open_water()], steps=20)


def check_condition(kind: str, **keys: Any) -> None:
    """Check the condition `kind` with these keys: draws, row by row, and hooks without effects."""
    spec: Condition = registered_spec(CONDITIONS, Condition, kind, keys)
    require, scenario = contract_of(f"condition '{kind}'"), _scenario(conditions={kind: spec})
    group = CONDITIONS.get(kind).kind
    require("valid", group in GROUPS, f"unknown group '{group}' (known: {', '.join(GROUPS)})")
    some = slice(3, 5)
    many, other, later = (_simulate(scenario, episodes=episodes) for episodes in (1, 1, 2))
    require("finite", all(np.isfinite(state).all() for state in many), "a boat's state is not finite")
    require("deterministic", np.array_equal(many, other), "the same generators give different episodes")
    require("deterministic", np.array_equal(many, later), "an episode depends on the one before it")
    require(
        "independent_rows", np.array_equal(many[:, some], _simulate(scenario, some)), "depends on other boats"
    )
    reset = _simulate(scenario, reset_at=10)
    others = np.arange(BOATS) != 1
    require(
        "independent_rows", np.array_equal(many[:, others], reset[:, others]), "a reset changes other boats"
    )
    check_environment(scenario, [open_water()], steps=20)


def check_range_sensor(kind: str, **keys: Any) -> None:
    """Check the range sensor `kind` with these keys: shape, range, points by sector, noise, row by row."""
    spec: RangeSensorSpec = registered_spec(RANGE_SENSORS, RangeSensorSpec, kind, keys)
    require, walls = contract_of(f"range sensor '{kind}'"), _basin()
    sensor = spec.build(walls)
    require("pure", np.array_equal(walls, _basin()), "build changes its argument")
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(-8, 8, (BOATS, 2)), rng.uniform(-4, 4, BOATS)])
    scanned = _check_rows(require, lambda rows: {"ranges": sensor.sector_ranges(rows["eta"])}, {"eta": poses})
    ranges, expected = scanned["ranges"], (BOATS, spec.sectors)
    require("shape", ranges.shape == expected, f"ranges of shape {ranges.shape}, expected {expected}")
    require(
        "in_range", (ranges >= 0).all() and (ranges <= spec.range_m).all(), f"not in 0 to {spec.range_m:g} m"
    )
    reach_m = min(spec.range_m, 5.0)  # less than the distance of some walls
    near = spec.model_copy(update={"range_m": reach_m}).build(_basin()).sector_ranges(poses)
    require("in_range", (near >= 0).all() and (near <= reach_m).all(), f"not in 0 to {reach_m:g} m")
    for pose, row in zip(poses, ranges, strict=True):
        points = sensor.points(pose)
        require("shape", points.ndim == 2 and points.shape[1] == 3, f"points of shape {points.shape}")
        beside_m = np.abs(np.abs(to_world(points, pose)[:, :2]).max(axis=1) - BASIN_M / 2)
        require("consistent", (beside_m < 0.5).all(), "points not on the walls: are they in the body frame?")
        some = set(map(tuple, sensor.points(pose, 2)))
        require("consistent", some <= set(map(tuple, points)), "every second ray has points that no ray has")
        # A point on the edge of two sectors may belong to either.
        turned = [np.column_stack(rotate(points[:, 0], points[:, 1], turn)) for turn in (-1e-6, 1e-6)]
        before, after = (sector_index(np.arctan2(xy[:, 1], xy[:, 0]), spec.sectors) for xy in turned)
        nearest = [nearest_in_sectors(xy, spec.sectors, spec.range_m) for xy in turned]
        low = np.min(nearest, axis=0) - 1e-3
        high = nearest_in_sectors(points[before == after], spec.sectors, spec.range_m) + 1e-3
        require(
            "consistent",
            ((low <= row) & (row <= high)).all(),
            f"ranges {row}, but the nearest points of the sectors are at {nearest[0]}",
        )
    if isinstance(sensor, NoisyRangeSensor):
        _check_noise(require, sensor, poses, ranges)
    require("valid", sensor.table_bytes >= 0, "negative table_bytes")
    nowhere = spec.build(np.empty((0, 3, 3)))
    empty = nowhere.sector_ranges(poses)
    require(
        "consistent", (empty == spec.range_m).all(), f"nothing returns, but a range is not {spec.range_m:g} m"
    )
    require("consistent", len(nowhere.points(poses[0])) == 0, "nothing returns, but there are points")


def _check_noise(require: Require, sensor: NoisyRangeSensor, poses: Floats, ranges: Floats) -> None:
    """Check that noisy ranges are exact if all errors are zero, and that each row depends on its seed."""

    def noisy(rows: Rows, error: float) -> Rows:
        share = np.full(len(rows["eta"]), error)
        noise = RangeNoise(rows["seeds"], share, share, np.zeros_like(share))
        return {"noisy ranges": sensor.noisy_sector_ranges(rows["eta"], noise)}

    rows = {"eta": poses, "seeds": np.arange(len(poses), dtype=np.uint64)}
    _check_rows(require, lambda some: noisy(some, 0.05), rows)
    exact = noisy(rows, 0.0)["noisy ranges"]
    require("consistent", np.allclose(exact, ranges, rtol=0, atol=1e-6), "noisy ranges without noise differ")


def check_vessel(source: str | Path) -> None:
    """Check that a vessel loads, moves, stays finite, and that the fast step agrees with the matrices."""
    vessel, require = load_vessel(source), contract_of(f"vessel '{source}'")
    model, reference = VesselModel(vessel), ReferenceVesselModel(vessel)
    rng = np.random.default_rng(0)
    eta, nu = np.zeros((BOATS, 3)), np.zeros((BOATS, 3))
    for _ in range(100):
        command = model.command_limit * rng.uniform(-1, 1, (BOATS, 2))
        slow = np.hstack(reference.step(eta, nu, command))
        alone = np.hstack(model.step(eta[:1], nu[:1], command[:1]))
        eta, nu = model.step(eta, nu, command)
        fast = np.hstack([eta, nu])
        require("finite", np.isfinite(fast).all(), "the state is not finite")
        require("independent_rows", np.array_equal(fast[:1], alone), "a boat depends on the number of boats")
        require(
            "consistent", np.allclose(fast, slow, rtol=1e-9, atol=1e-9), "the step differs from the matrices"
        )
    require("valid", np.abs(eta).max() > 0, "does not move")


def check_harbor(source: str | Path) -> None:
    """Check that a harbor loads and builds the same surface twice, finite, with a plan view."""
    require, spec = contract_of(f"harbor '{source}'"), load_harbor(source)
    harbor, again = (build_harbor(load_harbor(source), Path()) for _ in range(2))
    require("shape", harbor.triangles.shape[1:] == (3, 3), "no triangles")
    require("finite", len(harbor.triangles) and np.isfinite(harbor.triangles).all(), "empty or not finite")
    require(
        "deterministic",
        np.array_equal(harbor.triangles, again.triangles),
        "built differently the second time",
    )
    require("deterministic", spec == load_harbor(source), "loads differently the second time")
    require("valid", build_scene(harbor, load_vessel("eilbrecht").hull).polygons, "nothing to draw")


def _all_actions(space: Space[Any]) -> NDArray[Any]:
    """Return every action of a discrete space, or many samples of another space."""
    if isinstance(space, Discrete):
        return np.arange(space.start, space.start + space.n)
    many = batch_space(space, SAMPLES)
    many.seed(0)
    return np.asarray(many.sample())


def registered_spec(registry: Registry[type[Any]], base: type[Any], kind: str, keys: dict[str, Any]) -> Any:
    """Check a registered spec with these keys as all specs are checked, and return it."""
    catalog.fill()
    model = registry.get(kind).value
    require = contract_of(f"{registry.noun} '{kind}'")
    require(
        "valid", isinstance(model, type) and issubclass(model, base), f"not a subclass of {base.__name__}"
    )
    spec = model.model_validate({**keys, "kind": kind})
    again = model.model_validate(spec.model_dump(mode="json"))
    require("valid", again == spec, f"a dump loads as {again}, not as {spec}")
    if base is not AlgorithmSpec:  # whose options may be a dictionary
        try:
            same = hash(again) == hash(spec)
        except TypeError as error:
            message = f"{error}: use tuples for lists"
            raise ContractError(f"{registry.noun} '{kind}'", "valid", message) from error
        require("valid", same, "equal specs have different hashes")
    return spec


def _check_rows(require: Require, measure: Callable[[Rows], Mapping[str, Any]], rows: Rows) -> Rows:
    """Check a pure function of n rows and return its result."""

    def function(rows: Rows) -> Rows:
        return {key: np.asarray(value) for key, value in measure(rows).items()}

    before = {key: value.copy() for key, value in rows.items()}
    result = function(rows)
    for key, value in result.items():
        require("valid", value.dtype.kind in "biuf", f"{key} does not consist of real numbers")
        require("shape", value.shape[:1] == (BOATS,), f"{key} of shape {value.shape} for {BOATS} boats")
        require("finite", np.isfinite(value).all(), f"{key} is not finite")
    for key, value in before.items():
        require("pure", np.array_equal(value, rows[key]), f"changes its argument {key}")
    for some in (slice(0, 1), slice(2, 5)):
        part = function({key: value[some] for key, value in rows.items()})
        for key, value in part.items():
            require(
                "independent_rows",
                np.array_equal(value, result[key][some]),
                f"a row of {key} depends on other rows",
            )
    copies = {key: value.copy() for key, value in result.items()}
    function({key: value[::-1].copy() for key, value in rows.items()})
    for key, value in result.items():
        require("unshared", np.array_equal(value, copies[key]), f"{key} changes in a later call")
    for key, value in result.items():
        if value.flags.writeable and not any(np.shares_memory(value, given) for given in rows.values()):
            value[:] = -7.0
        require(
            "unshared", np.array_equal(function(rows)[key], copies[key]), f"{key} is shared with later calls"
        )
    return copies


def _status(values: Rows) -> StepStatus:
    """Return the status of a step in a harbor with a wall along x = 0."""
    return StepStatus(
        **values, clearance_below=lambda limit_m: np.minimum(np.abs(values["eta"][:, 0]), limit_m)
    )


def _step_values() -> Rows:
    """Return random values of a `StepStatus`, each event in one row."""
    rng = np.random.default_rng(1)
    event = np.eye(3, BOATS, dtype=bool)
    return {
        "phase": rng.integers(0, 2, BOATS),
        "distance_m": np.append(0.0, rng.uniform(0, 60, BOATS - 1)),
        "heading_error_rad": rng.uniform(-np.pi, np.pi, BOATS),
        "previous_distance_m": rng.uniform(0, 60, BOATS),
        "previous_heading_error_rad": rng.uniform(-np.pi, np.pi, BOATS),
        "nu": rng.uniform(-0.5, 0.5, (BOATS, 3)) * (np.arange(BOATS) != 3)[:, None],
        "command": rng.uniform(-0.5, 0.5, (BOATS, 2)) * [100.0, 1.0],
        "previous_command": rng.uniform(-0.5, 0.5, (BOATS, 2)) * [100.0, 1.0],
        "sector_ranges_m": rng.uniform(0, 100, (BOATS, SECTORS)),
        "collided": event[0],
        "reached_intermediate": event[1],
        "reached_final": event[2],
        "eta": rng.uniform(-1, 1, (BOATS, 3)) * [50.0, 50.0, np.pi],
    }


def _view_values() -> Rows:
    """Return random values of a `View` except the vessel's limits."""
    rng = np.random.default_rng(2)
    shared = {field.name for field in fields(View)} & {field.name for field in fields(StepStatus)}
    return {
        **{key: value for key, value in _step_values().items() if key in shared},
        "apparent_wind": rng.uniform(-12, 12, (BOATS, 2)),
        "through_water": rng.uniform(-1, 1, (BOATS, 2)),
        "goal": rng.uniform(-1, 1, (BOATS, 3)) * [50.0, 50.0, np.pi],
    }


def _scenario(**changes: Any) -> Scenario:
    scenario = load("s1").scenario
    sensors = scenario.sensors.model_copy(
        update={"lidar": scenario.sensors.lidar.model_copy(update={"sectors": SECTORS})}
    )
    return Scenario.model_validate({**dict(scenario), "sensors": sensors, **changes})


def _simulate(
    scenario: Scenario, of: slice = slice(0, BOATS), *, episodes: int = 1, reset_at: int | None = None
) -> Floats:
    """Return the states (steps, k, 6) of k of the boats under random commands in open water.

    Args:
        of: the boats to simulate.
        episodes: number of identical episodes, the last of which is returned.
        reset_at: step at which a new episode of the second boat starts.
    """
    rows = np.arange(BOATS)[of]
    simulator = Simulator(scenario, [open_water()], len(rows))
    site = own_site(scenario)
    start = given_start(site, scenario.task, site.initial[0], 0)
    commands = np.random.default_rng(3).uniform(-1, 1, (30, BOATS, 2)) * simulator.vessel.command_limit
    for _ in range(episodes):
        simulator.reset(np.arange(len(rows)), [start] * len(rows), [np.random.default_rng(r) for r in rows])
        states = []
        for step, command in enumerate(commands):
            if step == reset_at:
                simulator.reset(np.array([1]), [replace(start, seed=99)])
            before, again = _hooks(simulator), _hooks(simulator)
            for name, value in before.items():
                require = contract_of(name)
                require("finite", value.dtype.kind in "biuf" and np.isfinite(value).all(), "is not finite")
                require("pure", np.array_equal(value, again[name]), "changes without a reset or advance")
            simulator.step(command[rows])
            states.append(np.hstack([simulator.eta, simulator.nu]))
    return np.array(states)


def _hooks(simulator: Simulator) -> Rows:
    """Return copies of the results of those hooks that may be called at any time."""
    values: Rows = {}
    for disturbance in simulator.disturbances:
        who = type(disturbance).__name__
        eta, nu = simulator.eta.copy(), simulator.nu.copy()
        hooks = {
            "water_velocity": disturbance.water_velocity(),
            "air_velocity": disturbance.air_velocity(),
            "force": disturbance.force(eta, nu),
            "pose_error": disturbance.pose_error(),
            "velocity_error": disturbance.velocity_error(),
            **disturbance.episode(),
        }
        for given, own in ((eta, simulator.eta), (nu, simulator.nu)):
            contract_of(f"{who}.force")("pure", np.array_equal(given, own), "changes its arguments")
        values |= {f"{who}.{name}": np.array(value) for name, value in hooks.items()}
    return values


def _basin() -> Floats:
    """Return the four walls (8, 3, 3) of a square basin of `BASIN_M`, from -1 m to 6 m."""
    corners = BASIN_M / 2 * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    walls = []
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        a, b, c, d = [x0, y0, -1.0], [x1, y1, -1.0], [x1, y1, 6.0], [x0, y0, 6.0]
        walls += [[a, b, c], [a, c, d]]
    return np.array(walls)
