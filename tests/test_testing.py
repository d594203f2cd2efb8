"""The contract tests accept what the package registers, and refuse what breaks a rule."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, Space

from dockctl import testing
from dockctl.agents.dqn.algorithm import DQN
from dockctl.agents.dqn.policy import GreedyPolicy
from dockctl.envs.actions import GridActions
from dockctl.envs.observation import Columns, View, observation_part
from dockctl.envs.vector import DockingVectorEnv
from dockctl.evaluation.policies import load_policy
from dockctl.plugins import (
    ACTIONS,
    ALGORITHMS,
    CONDITIONS,
    HARBORS,
    OBSERVATION_PARTS,
    POLICIES,
    RANGE_SENSORS,
    REWARD_TERMS,
    VESSELS,
    Registry,
)
from dockctl.rewards.terms import reward_term
from dockctl.scenarios import catalog
from dockctl.scenarios.base import FieldError, Number
from dockctl.scenarios.extensions import Condition, Disturbance, Drawn, RangeSensorSpec, register
from dockctl.sim.goal import StepStatus
from dockctl.sim.lidar.planar import PlanarScanner, PlanarSensor
from dockctl.testing.contract import Rule
from tests.conftest import own_registries

catalog.fill()


def examples(registry: Registry[type[Any]]) -> list[tuple[str, dict[str, Any]]]:
    """Return the kinds of a registry, each with the keys of its examples."""
    return [(entry.name, keys) for entry in registry for keys in entry.value.examples]


@pytest.mark.parametrize("name", REWARD_TERMS.names())
def test_reward_terms(name: str) -> None:
    testing.check_reward_term(name)


@pytest.mark.parametrize("name", OBSERVATION_PARTS.names())
def test_observation_parts(name: str) -> None:
    testing.check_observation_part(name)


@pytest.mark.parametrize("kind", ACTIONS.names())
def test_action_types(kind: str) -> None:
    testing.check_action_type(kind)


@pytest.mark.parametrize(("kind", "keys"), examples(CONDITIONS))
def test_conditions(kind: str, keys: dict[str, Any]) -> None:
    testing.check_condition(kind, **keys)


@pytest.mark.parametrize(("kind", "keys"), examples(RANGE_SENSORS))
def test_range_sensors(kind: str, keys: dict[str, Any]) -> None:
    testing.check_range_sensor(kind, **keys)


@pytest.mark.parametrize(("kind", "keys"), examples(ALGORITHMS))
def test_algorithms(kind: str, keys: dict[str, Any]) -> None:
    if kind == "sb3":
        pytest.importorskip("stable_baselines3")
    spaces: list[Space[Any]] = [Discrete(7), Box(np.float32([-2, 0]), np.float32([1, 3]))]
    refusals = []
    for space in spaces:
        try:
            testing.check_algorithm(kind, space, **keys)
        except FieldError as refusal:
            refusals.append(refusal.field)
    assert len(refusals) < len(spaces)
    assert all(field.startswith(("actions", "training.algorithm")) for field in refusals)


@pytest.mark.parametrize("name", ["s1", *POLICIES.names()])
def test_policies(name: str) -> None:
    policy = load_policy(name)
    env = DockingVectorEnv(policy.scenario("s1"), 3)
    testing.check_policy(policy.make(env), env)


@pytest.mark.parametrize("registry", [CONDITIONS, RANGE_SENSORS, ALGORITHMS], ids=lambda each: each.noun)
def test_every_condition_sensor_and_algorithm_is_checked(registry: Registry[type[Any]]) -> None:
    assert registry.names()
    assert {kind for kind, _ in examples(registry)} == {*registry.names()}


def test_an_algorithm_whose_policy_explores_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng()
    monkeypatch.setattr(GreedyPolicy, "act", lambda self, rows, info: rng.integers(7, size=len(rows)))
    assert_rejected(lambda: testing.check_algorithm("dqn", Discrete(7)), "deterministic")


@pytest.mark.parametrize(
    ("act", "rule"),
    [
        (lambda rows: np.full(len(rows), 7), "in_range"),
        (lambda rows: np.full(len(rows), 3.4), "in_range"),
        (lambda rows: np.full(len(rows), np.nan), "in_range"),
        (lambda rows: np.zeros((len(rows), 1), int), "shape"),
        (lambda rows: rows.__imul__(0)[:, 0].astype(int), "pure"),
        (lambda rows: np.arange(len(rows)), "independent_rows"),
        (lambda rows: (np.roll(rows, 1, axis=0)[:, 0] > 0).astype(int), "independent_rows"),
    ],
)
def test_a_faulty_greedy_policy_is_rejected(monkeypatch: pytest.MonkeyPatch, act: Any, rule: str) -> None:
    monkeypatch.setattr(GreedyPolicy, "act", lambda self, rows, info: act(rows))
    assert_rejected(lambda: testing.check_algorithm("dqn", Discrete(7)), rule)


def test_a_policy_that_is_not_the_newest_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    newest, first = DQN.policy, dict[int, Any]()

    def stale(algorithm: DQN) -> Any:
        return first.setdefault(id(algorithm), newest.__get__(algorithm))

    monkeypatch.setattr(DQN, "policy", property(stale))
    assert_rejected(lambda: testing.check_algorithm("dqn", Discrete(7)), "consistent")


@pytest.mark.parametrize("lost", ["exploration", "replay"])
def test_an_algorithm_whose_state_is_incomplete_is_rejected(
    monkeypatch: pytest.MonkeyPatch, lost: str
) -> None:
    restore = DQN.restore

    def restore_without(algorithm: DQN, policy: Any, tensors: Any, facts: Any) -> None:
        blank = copy.deepcopy(vars(algorithm)[lost])
        restore(algorithm, policy, tensors, facts)
        vars(algorithm)[lost] = blank

    monkeypatch.setattr(DQN, "restore", restore_without)
    assert_rejected(lambda: testing.check_algorithm("dqn", Discrete(7)), "resumable")


def learn_without_loss(algorithm: DQN, env_steps: int) -> Any:
    for metrics in LEARN(algorithm, env_steps):
        yield {"td_error": metrics["td_error"]}


def learn_without_q(algorithm: DQN, env_steps: int) -> Any:
    for metrics in LEARN(algorithm, env_steps):
        yield {**metrics, "q_mean": np.nan}


def store_and_change(algorithm: DQN, step: Any) -> None:
    STORE(algorithm, step)
    step.next_observation[:] = 0


def state_with_numpy(algorithm: DQN) -> Any:
    tensors, facts = STATE(algorithm)
    return tensors, {**facts, "scale": np.float32(1)}


def act_as_the_next_boat(policy: GreedyPolicy, observation: Any, info: Any) -> Any:
    return np.arange(len(observation))[::-1]


def tensors_that_are_in_use(algorithm: DQN) -> Any:
    live = algorithm.learner.evaluated.state_dict()
    return {name: live[name].numpy() if name in live else value for name, value in TENSORS(algorithm).items()}


LEARN, STORE, STATE, TENSORS = DQN.learn, DQN.store, DQN.state, DQN.policy_tensors


@pytest.mark.parametrize(
    ("owner", "method", "broken", "rule"),
    [
        (DQN, "learn", learn_without_loss, "valid"),
        (DQN, "learn", learn_without_q, "finite"),
        (DQN, "store", store_and_change, "pure"),
        (DQN, "state", state_with_numpy, "resumable"),
        (DQN, "policy_tensors", tensors_that_are_in_use, "unshared"),
        (GreedyPolicy, "act", act_as_the_next_boat, "independent_rows"),
    ],
)
def test_an_algorithm_that_breaks_a_rule_is_rejected(
    monkeypatch: pytest.MonkeyPatch, owner: type[Any], method: str, broken: Any, rule: Rule
) -> None:
    monkeypatch.setattr(owner, method, broken)
    assert_rejected(lambda: testing.check_algorithm("dqn", Discrete(7)), rule)


@pytest.mark.parametrize("name", VESSELS.names())
def test_vessels(name: str) -> None:
    testing.check_vessel(name)


@pytest.mark.parametrize("name", HARBORS.names())
def test_harbors(name: str) -> None:
    testing.check_harbor(name)


def assert_rejected(check: Callable[[], None], rule: Rule) -> None:
    with pytest.raises(testing.ContractError) as caught:
        check()
    assert caught.value.rule == rule


def test_an_environment_that_shares_its_state_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    info = DockingVectorEnv._info

    def sharing(env: DockingVectorEnv, events: Any) -> Any:
        return {**info(env, events), "velocity": env.simulator.nu}

    monkeypatch.setattr(DockingVectorEnv, "_info", sharing)
    assert_rejected(lambda: testing.check_action_type("grid"), "deterministic")


def test_impure_terms_are_rejected() -> None:
    calls = iter(range(1000))

    @reward_term("drifting", kind="dense")
    def drifting(status: StepStatus) -> Any:
        return status.distance_m + next(calls)

    @reward_term("relative", kind="dense")
    def relative(status: StepStatus) -> Any:
        return status.distance_m - status.distance_m.mean()

    @reward_term("greedy", kind="dense")
    def greedy(status: StepStatus) -> Any:
        status.distance_m[:] = 0
        return status.distance_m

    @reward_term("inverse", kind="dense")
    def inverse(status: StepStatus) -> Any:
        with np.errstate(divide="ignore"):
            return 1 / status.distance_m

    @reward_term("number", kind="dense")
    def number(status: StepStatus) -> Any:
        return 0.0

    @reward_term("nothing", kind="dense")
    def nothing(status: StepStatus) -> Any:
        return None

    @reward_term("column", kind="dense")
    def column(status: StepStatus) -> Any:
        return status.distance_m[:, None]

    rules: dict[str, Rule] = {
        "drifting": "independent_rows",
        "relative": "independent_rows",
        "greedy": "pure",
        "inverse": "finite",
        "number": "shape",
        "nothing": "valid",
        "column": "shape",
    }
    for name, rule in rules.items():
        assert_rejected(lambda name=name: testing.check_reward_term(name), rule)  # type: ignore[misc]  # bound now


def test_a_part_without_bounds_is_rejected() -> None:
    @observation_part("boundless")
    def boundless(view: View) -> Columns:
        return Columns(["distance"], view.distance_m[:, None], 0, np.inf)

    assert_rejected(lambda: testing.check_observation_part("boundless"), "finite")


def test_commands_beyond_the_limits_are_rejected() -> None:
    @register(ACTIONS)
    class Strong(GridActions):
        kind: Literal["strong"] = "strong"  # type: ignore[assignment]

        def require_within_limits(self, vessel: Any) -> None:
            return

    assert_rejected(lambda: testing.check_action_type("strong", propeller_n=[60]), "in_range")


def test_one_command_of_many_beyond_the_limits_is_rejected() -> None:
    @register(ACTIONS)
    class NearlyRight(GridActions):
        kind: Literal["nearly_right"] = "nearly_right"  # type: ignore[assignment]

        def commands(self, actions: Any, vessel: Any) -> Any:
            return super().commands(actions, vessel) * np.where(actions == 3, 1.1, 1.0)[:, None]

    assert_rejected(lambda: testing.check_action_type("nearly_right"), "in_range")


def test_a_condition_that_draws_from_a_common_generator_is_rejected() -> None:
    common = np.random.default_rng(0)

    class Flow(Disturbance):
        def __init__(self, boats: int) -> None:
            self.velocity = np.zeros((boats, 2))

        def reset(self, rows: Any, rngs: Any) -> None:
            self.velocity[rows] = common.random((len(rows), 2))

        def water_velocity(self) -> Any:
            return self.velocity

    @register(CONDITIONS, group="water")
    class Unseeded(Condition):
        kind: Literal["unseeded"] = "unseeded"

        def build(self, num_boats: int) -> Disturbance:
            return Flow(num_boats)

    assert_rejected(lambda: testing.check_condition("unseeded"), "deterministic")


class Gusts(Disturbance):
    """A correct condition: a flow drawn per episode, and a force that grows with its time."""

    def __init__(self, boats: int) -> None:
        self.velocity, self.time_s = np.zeros((boats, 2)), np.zeros(boats)

    def reset(self, rows: Any, rngs: Any) -> None:
        self.velocity[rows] = [rng.random(2) for rng in rngs]
        self.time_s[rows] = 0

    def advance(self, period_s: float) -> None:
        self.time_s = self.time_s + period_s

    def water_velocity(self) -> Any:
        return self.velocity

    def force(self, eta: Any, nu: Any) -> Any:
        return self.time_s[:, None] * [1.0, 0.0, 0.0]


class FirstGenerator(Gusts):
    def reset(self, rows: Any, rngs: Any) -> None:
        super().reset(rows, [rngs[0]] + [copy.deepcopy(rngs[0]) for _ in rngs[1:]])


class LastingTime(Gusts):
    def reset(self, rows: Any, rngs: Any) -> None:
        self.velocity[rows] = [rng.random(2) for rng in rngs]


class ChangesArgument(Gusts):
    def force(self, eta: Any, nu: Any) -> Any:
        nu[:] = 0
        return super().force(eta, nu)


class NotFinite(Gusts):
    def force(self, eta: Any, nu: Any) -> Any:
        return np.full((len(eta), 3), np.nan)


class LosesSectors(Gusts):
    def reported_ranges(self, ranges: Any, rows: Any, range_m: float) -> Any:
        return np.full_like(ranges, np.nan)


class Unsaveable(Gusts):
    def __init__(self, boats: int) -> None:
        super().__init__(boats)
        self.scale = lambda: 1


@pytest.mark.parametrize(
    ("state", "rule"),
    [
        (Gusts, None),
        (FirstGenerator, "independent_rows"),
        (LastingTime, "deterministic"),
        (ChangesArgument, "pure"),
        (NotFinite, "finite"),
        (LosesSectors, "finite"),
        (Unsaveable, "resumable"),
    ],
)
def test_conditions_that_break_a_rule_are_rejected(state: type[Gusts], rule: Rule | None) -> None:
    class Gusty(Condition):
        kind: Literal["gusty"] = "gusty"

        def build(self, num_boats: int) -> Disturbance:
            return state(num_boats)

    with own_registries():
        register(CONDITIONS, group="water")(Gusty)
        if rule is None:
            testing.check_condition("gusty")
        else:
            assert_rejected(lambda: testing.check_condition("gusty"), rule)


def test_commands_in_an_array_that_is_used_again_are_rejected() -> None:
    arrays: dict[int, Any] = {}

    @register(ACTIONS)
    class Recycling(GridActions):
        kind: Literal["recycling"] = "recycling"  # type: ignore[assignment]

        def commands(self, actions: Any, vessel: Any) -> Any:
            array = arrays.setdefault(len(actions), np.zeros((len(actions), 2)))
            array[:] = super().commands(actions, vessel)
            return array

    assert_rejected(lambda: testing.check_action_type("recycling"), "unshared")


def test_a_policy_that_mixes_boats_is_rejected() -> None:
    class Largest:
        def reset(self, rows: Any, info: Any) -> None:
            pass

        def act(self, observation: Any, info: Any) -> Any:
            return np.full(len(observation), int(1e3 * np.abs(observation[:, 1]).max()) % 77)

    assert_rejected(lambda: testing.check_policy(Largest(), DockingVectorEnv("s1", 3)), "independent_rows")


def test_a_policy_that_forgets_boats_that_continue_is_rejected() -> None:
    class Counting:
        def reset(self, rows: Any, info: Any) -> None:
            self.steps = 0

        def act(self, observation: Any, info: Any) -> Any:
            self.steps += 1
            return np.full(len(observation), self.steps)

    assert_rejected(lambda: testing.check_policy(Counting(), DockingVectorEnv("s1", 3)), "independent_rows")


def test_a_condition_whose_state_is_incomplete_is_rejected() -> None:
    class Flow(Disturbance):
        def __init__(self, boats: int) -> None:
            self.velocity, self.factor = np.zeros((boats, 2)), np.zeros((boats, 1))

        def reset(self, rows: Any, rngs: Any) -> None:
            self.velocity[rows] = [rng.random(2) for rng in rngs]
            self.factor[rows] = [rng.random(1) for rng in rngs]

        def water_velocity(self) -> Any:
            return self.velocity * self.factor

        def state(self) -> dict[str, Any]:
            return {"velocity": self.velocity}

    @register(CONDITIONS, group="water")
    class Forgetful(Condition):
        kind: Literal["forgetful"] = "forgetful"

        def build(self, num_boats: int) -> Disturbance:
            return Flow(num_boats)

    assert_rejected(lambda: testing.check_condition("forgetful"), "resumable")


@pytest.mark.parametrize("sectors", [4, 12, 360])
def test_rays_on_the_edges_of_sectors_are_accepted(sectors: int) -> None:
    testing.check_range_sensor("planar", sectors=sectors)


def test_a_number_is_a_default_of_a_condition_that_draws() -> None:
    class Tide(Condition):
        kind: Literal["tide"] = "tide"  # type: ignore[assignment]
        speed_mps: Drawn[Number] = 0.05  # type: ignore[assignment]

        def build(self, num_boats: int) -> Disturbance:
            return Disturbance()

    assert Tide().speed_mps == (0.05,)
    assert Tide().model_dump(mode="json")["speed_mps"] == 0.05


def test_a_sensor_whose_points_do_not_agree_is_rejected() -> None:
    class Long(PlanarSensor):
        def points(self, pose: Any, every: int = 1) -> Any:
            return 2 * super().points(pose, every)

    class Clockwise(PlanarSensor):
        def sector_ranges(self, eta: Any) -> Any:
            return super().sector_ranges(eta)[:, ::-1]

    @register(RANGE_SENSORS)
    class LongScanner(PlanarScanner):
        kind: Literal["long"] = "long"  # type: ignore[assignment]

        def build(self, triangles: Any) -> Any:
            return Long(self, triangles)

    @register(RANGE_SENSORS)
    class ClockwiseScanner(PlanarScanner):
        kind: Literal["clockwise"] = "clockwise"  # type: ignore[assignment]

        def build(self, triangles: Any) -> Any:
            return Clockwise(self, triangles)

    for scanner in (LongScanner, ClockwiseScanner):
        assert issubclass(scanner, RangeSensorSpec)
        kind = scanner.model_fields["kind"].default
        assert_rejected(lambda kind=kind: testing.check_range_sensor(kind), "consistent")  # type: ignore[misc]


class Fixed(PlanarSensor):
    """Does not turn with the boat."""

    def sector_ranges(self, eta: Any) -> Any:
        return super().sector_ranges(eta * [1, 1, 0] + [0, 0, 0.1])

    def noisy_sector_ranges(self, eta: Any, noise: Any) -> Any:
        return super().noisy_sector_ranges(eta * [1, 1, 0] + [0, 0, 0.1], noise)

    def points(self, pose: Any, every: int = 1) -> Any:
        return super().points(pose * [1, 1, 0] + [0, 0, 0.1], every)


class Far(PlanarSensor):
    """Scans farther than its range."""

    def __init__(self, spec: Any, triangles: Any) -> None:
        super().__init__(spec.model_copy(update={"range_m": 100.0}), triangles)


class Everywhere(PlanarSensor):
    """Has a point for a ray that returns nothing."""

    def points(self, pose: Any, every: int = 1) -> Any:
        points = super().points(pose, every)
        return points if len(points) else np.array([[self.spec.range_m, 0.0, 1.0]])


class ChangesSurface(PlanarSensor):
    """Moves the harbor that it is built in."""

    def __init__(self, spec: Any, triangles: Any) -> None:
        triangles += 1.0
        super().__init__(spec, triangles)


@pytest.mark.parametrize(
    ("sensor", "rule"),
    [(Fixed, "consistent"), (Far, "in_range"), (Everywhere, "consistent"), (ChangesSurface, "pure")],
)
def test_sensors_that_break_a_rule_are_rejected(sensor: type[PlanarSensor], rule: Rule) -> None:
    class Scanner(PlanarScanner):
        kind: Literal["wrong"] = "wrong"  # type: ignore[assignment]

        def build(self, triangles: Any) -> Any:
            return sensor(self, triangles)

    with own_registries():
        register(RANGE_SENSORS)(Scanner)
        assert_rejected(lambda: testing.check_range_sensor("wrong"), rule)


def test_a_sensor_with_a_list_is_rejected() -> None:
    class Scanner(PlanarScanner):
        kind: Literal["listed"] = "listed"  # type: ignore[assignment]
        heights_m: list[float] = [1.0]

    with own_registries():
        register(RANGE_SENSORS)(Scanner)
        assert_rejected(lambda: testing.check_range_sensor("listed"), "valid")


def test_a_sensor_whose_noise_does_not_follow_the_seeds_is_rejected() -> None:
    common = np.random.default_rng(0)

    class Noisy(PlanarSensor):
        def noisy_sector_ranges(self, eta: Any, noise: Any) -> Any:
            ranges = self.sector_ranges(eta)
            return ranges * common.uniform(0.9, 1.0, ranges.shape)

    @register(RANGE_SENSORS)
    class NoisyScanner(PlanarScanner):
        kind: Literal["noisy"] = "noisy"  # type: ignore[assignment]

        def build(self, triangles: Any) -> Any:
            return Noisy(self, triangles)

    assert issubclass(NoisyScanner, RangeSensorSpec)
    assert_rejected(lambda: testing.check_range_sensor("noisy"), "independent_rows")
