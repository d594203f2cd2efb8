"""Every source of a policy, and the errors of each."""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dockctl import plugins
from dockctl.agents.interface import Policy, QPolicy
from dockctl.control.supervisor import has_supervisor
from dockctl.envs.single import DockingEnv
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.evaluation import compare, evaluate, load_policy
from dockctl.evaluation.policies import BuiltPolicy, LoadedPolicy
from dockctl.scenarios.loader import load
from dockctl.testing import ContractError, check_policy
from dockctl.trust import UntrustedError
from tests.commands.conftest import dockctl

CONTROLLER = Path(__file__).parents[2] / "examples" / "controller" / "reverse.py"

FACTORIES = """
import numpy as np

class Constant:
    def __init__(self, action):
        self.action = action
    def reset(self, rows, info):
        self.goal = info["goal"]
    def act(self, observation, info):
        return np.full(len(observation), self.action)

def ahead(scenario, *, action: int = 73):
    return Constant(action)

def wrong_shape(scenario):
    policy = Constant(0)
    policy.act = lambda observation, info: 3
    return policy

def not_there(scenario):
    return Constant(77)

def valuing(scenario, *, actions: int = 77):
    policy = Constant(0)
    policy.q_values = lambda observation: np.tile(np.arange(actions), (len(observation), 1))
    return policy

def fractions(scenario):
    return Constant(0.5)

def no_policy(scenario):
    return 7

def broken(scenario):
    raise KeyError("thrust")

def broken_act(scenario):
    policy = Constant(0)
    policy.act = lambda observation, info: observation.no_such_thing
    return policy

number = 3
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "factories.py"
    path.write_text(FACTORIES)
    return path


def actions(policy: LoadedPolicy, boats: int = 2) -> np.ndarray:
    env = DockingVectorEnv("s1", boats)
    observation, info = env.reset(seed=0)
    built = policy.make(env)
    built.reset(np.arange(boats), info)
    return built.act(observation, info)


def test_the_controller_meets_the_contract_of_a_policy() -> None:
    env = DockingVectorEnv("s1", 3)
    check_policy(load_policy(f"{CONTROLLER}:Reverse").make(env), env)


def test_a_policy_with_state_breaks_the_contract_unless_it_resets() -> None:
    class Counting:
        count = 0

        def reset(self, rows: Any, info: Any) -> None: ...

        def act(self, observation: np.ndarray, info: Any) -> np.ndarray:
            self.count += 1
            return np.full(len(observation), self.count % 77)

    with pytest.raises(AssertionError):
        check_policy(Counting(), DockingVectorEnv("s1", 2))


@pytest.mark.parametrize("factory", ["wrong_shape", "not_there", "fractions", "broken_act"])
def test_a_wrong_action_of_a_loaded_policy_breaks_the_contract(file: Path, factory: str) -> None:
    env = DockingVectorEnv("s1", 2)
    with pytest.raises(ContractError) as caught:
        check_policy(load_policy(f"{file}:{factory}").make(env), env)
    assert caught.value.rule == "valid"


def test_the_controller_docks_in_reverse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    name = f"{CONTROLLER}:Reverse"
    outcome = dockctl(
        "evaluate", "--policy", name, "--scenario", "s1", "--episodes", 4, "--min-success", 1,
        "--json", "result.json",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    policy = json.loads(Path("result.json").read_text())["policy"]
    digest = hashlib.sha256(CONTROLLER.read_bytes()).hexdigest()
    assert policy == {"name": name, "file": str(CONTROLLER), "sha256": digest}
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]


def test_the_controller_is_compared_with_a_checkpoint() -> None:
    result = compare(["s1", f"{CONTROLLER}:Reverse"], "s1", episodes=2)
    assert list(result.evaluations) == ["s1", "reverse.py:Reverse"]
    assert (result.table["outcome"] == "docked").all()
    straight = np.hypot(result.table["x_m"] - 36, result.table["y_m"])  # to the berth, reached within 1 m
    assert (result.table["path_length_m"] > straight - 1).all()


def measured(what: str) -> set[str]:
    return {f"{what}-s1-reverse.py_Reverse.{end}" for end in ("csv", "json", "png", "svg")}


@pytest.mark.parametrize(
    ("command", "files"),
    [
        (("map", "--reach-m", 0, "--headings", 0), measured("map")),
        pytest.param(("latency", "--decisions", 10), measured("latency"), marks=pytest.mark.thorough),
        pytest.param(("returns",), measured("returns"), marks=pytest.mark.thorough),
    ],
)
def test_every_command_takes_a_controller(
    command: tuple[object, ...], files: set[str], tmp_path: Path
) -> None:
    policy, out = f"{CONTROLLER}:Reverse", tmp_path / "out"
    outcome = dockctl(*command, policy, "--scenario", "s1", "--out", out)
    assert outcome.code == 0, outcome.err
    assert {path.name for path in (tmp_path / "out").iterdir()} == files


class Constant(Policy):
    """Always the same action."""

    def __init__(self, action: int) -> None:
        self.action = action

    def act(self, observation: np.ndarray, info: Any) -> np.ndarray:
        return np.full(len(observation), self.action)


def test_a_registered_policy() -> None:
    state = plugins.POLICIES.save()
    try:

        @plugins.policy("hold")
        def hold(scenario: Any, *, action: int = 38) -> Constant:
            return Constant(action)

        assert load_policy("hold").facts()["name"] == "hold"
        assert actions(load_policy("hold", action=4)).tolist() == [4, 4]
        with pytest.raises(DockctlError) as caught:
            load_policy("hld")
        assert (caught.value.code, caught.value.suggestion) == ("not_found", "hold")
        with pytest.raises(DockctlError) as caught:
            load_policy("hold", acton=3)
        assert (caught.value.code, caught.value.suggestion) == ("unknown_key", "action")
    finally:
        plugins.POLICIES.restore(state)


def test_a_factory_of_a_module(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(file.parent)
    monkeypatch.delitem(sys.modules, "factories", raising=False)
    policy = load_policy("factories:ahead", action=5)
    assert actions(policy).tolist() == [5, 5]
    assert policy.facts()["params"] == {"action": 5}
    with pytest.raises(DockctlError) as caught:
        load_policy("no_such_module:factory")
    assert caught.value.code == "plugin"


def test_only_factories_take_parameters(file: Path) -> None:
    loaded = load_policy(f"{file}:ahead", action=5)
    for policy in ("s1", loaded):
        with pytest.raises(
            DockctlError, match="only a factory takes parameters, found plugin_file"
        ) as caught:
            load_policy(policy, plugin_file="my.py")
        assert caught.value.code == "unknown_key"


@pytest.mark.parametrize(
    ("given", "code", "suggestion"),
    [
        ("FILE:ahed", "unknown_name", "ahead"),
        ("FILE:number", "unknown_name", ""),
        ("FILE", "missing_key", "FILE:my_factory"),
        ("missing.py:factory", "plugin", ""),
        ("marine", "not_found", "marina"),
        ("model.zip", "missing_key", "model.zip:DQN"),
        ("model.zip:DQN", "not_found", ""),
        ("model.onnx", "not_found", ""),
    ],
)
def test_a_policy_that_is_not_found(file: Path, given: str, code: str, suggestion: str) -> None:
    with pytest.raises(DockctlError) as caught:
        load_policy(given.replace("FILE", str(file)))
    assert caught.value.code == code
    assert caught.value.suggestion == suggestion.replace("FILE", str(file))
    assert code != "unknown_name" or "ahead" in str(caught.value)  # those that there are


def test_a_controller_that_values_actions_can_have_a_supervisor(file: Path) -> None:
    env = DockingVectorEnv("s1", 2)
    scenario = load("s1", overrides=["evaluation.supervisor=true"]).scenario
    valuing, plain = (load_policy(f"{file}:{factory}").make(env) for factory in ("valuing", "ahead"))
    assert has_supervisor(valuing, scenario) and not has_supervisor(plain, scenario)
    assert isinstance(valuing, QPolicy)
    assert valuing.q_values(np.zeros((2, 3))).tolist() == [list(range(77))] * 2
    wrong = load_policy(f"{file}:valuing", actions=5).make(env)
    assert isinstance(wrong, QPolicy)
    with pytest.raises(DockctlError, match=r"q_values returned shape \(2, 5\), expected \(2, 77\)"):
        wrong.q_values(np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("factory", "line"),
    [
        ("wrong_shape", ""),
        ("not_there", ""),
        ("fractions", ""),
        ("no_policy", ""),
        ("broken", 'raise KeyError("thrust")'),
        ("broken_act", "observation.no_such_thing"),
    ],
)
def test_a_policy_that_breaks_the_contract(file: Path, factory: str, line: str) -> None:
    with pytest.raises(DockctlError) as caught:
        actions(load_policy(f"{file}:{factory}"))
    assert caught.value.code == "plugin"
    assert f"{file}:{factory}" in str(caught.value)
    if line:
        number = 1 + next(i for i, text in enumerate(FACTORIES.splitlines()) if line in text)
        assert str(caught.value).endswith(f"({file}:{number})")


def test_a_controller_needs_a_scenario(file: Path) -> None:
    outcome = dockctl("evaluate", "--policy", f"{file}:ahead")
    assert (outcome.code, outcome.error_code) == (2, "missing_key")
    assert evaluate(f"{file}:ahead", "s1", episodes=0).groups["pose"][0].steps > 0


def test_a_stable_baselines3_archive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    model = sb3.DQN("MlpPolicy", DockingEnv("s1"), buffer_size=10, seed=0)
    model.save(tmp_path / "model.zip")
    given = f"{tmp_path / 'model.zip'}:DQN"
    with pytest.raises(UntrustedError):
        load_policy(given)  # it contains pickles
    env = DockingVectorEnv("s1", 3)
    expected = model.predict(env.reset(seed=0)[0], deterministic=True)[0]
    assert actions(load_policy(given, trust=True), 3).tolist() == expected.tolist()
    check_policy(load_policy(given, trust=True).make(env), env)
    with pytest.raises(DockctlError) as caught:
        load_policy(given, trust=True).make(DockingVectorEnv("s3", 1))
    assert caught.value.code == "mismatch"
    with pytest.raises(DockctlError) as caught:
        load_policy(given.replace("DQN", "DQM"), trust=True).make(env)
    assert (caught.value.code, caught.value.suggestion) == ("unknown_name", "DQN")
    (tmp_path / "damaged.zip").write_bytes(b"PK")
    with pytest.raises(DockctlError):
        load_policy(f"{tmp_path / 'damaged.zip'}:DQN", trust=True).make(env)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(DockctlError) as caught:
        load_policy(given, trust=True).make(env)
    assert caught.value.code == "unavailable"


def onnx_file(path: Path, inputs: int, outputs: int, batch: int | str) -> np.ndarray:
    """Write a linear model; return its weights (inputs, outputs)."""
    onnx = pytest.importorskip("onnx")
    helper, numpy_helper, float_ = onnx.helper, onnx.numpy_helper, onnx.TensorProto.FLOAT
    weights = np.random.default_rng(0).normal(size=(inputs, outputs)).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observation", "weights"], ["values"])],
        "policy",
        [helper.make_tensor_value_info("observation", float_, [batch, inputs])],
        [helper.make_tensor_value_info("values", float_, [batch, outputs])],
        [numpy_helper.from_array(weights, "weights")],
    )
    opset = helper.make_opsetid("", 17)
    onnx.save(helper.make_model(graph, opset_imports=[opset], ir_version=9), path)
    return weights


@pytest.mark.parametrize("batch", ["n", 1])
def test_an_onnx_file(tmp_path: Path, batch: int | str) -> None:
    pytest.importorskip("onnxruntime")
    weights = onnx_file(tmp_path / "policy.onnx", 15, 77, batch)
    env = DockingVectorEnv("s1", 3)
    policy = load_policy(tmp_path / "policy.onnx")
    expected = (env.reset(seed=0)[0] @ weights).argmax(axis=1)
    assert actions(policy, 3).tolist() == expected.tolist()
    check_policy(policy.make(env), env)


def test_an_onnx_file_with_its_weights_in_another_file(tmp_path: Path) -> None:
    """As torch writes large models."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    weights, path = onnx_file(tmp_path / "policy.onnx", 15, 77, "n"), tmp_path / "policy.onnx"
    onnx.save(onnx.load(path), path, save_as_external_data=True, location="weights", size_threshold=0)
    assert (tmp_path / "weights").stat().st_size >= weights.nbytes
    expected = (DockingVectorEnv("s1", 3).reset(seed=0)[0] @ weights).argmax(axis=1)
    assert actions(load_policy(path), 3).tolist() == expected.tolist()


def test_an_exported_onnx_file_whose_description_is_damaged(tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    onnx_file(path := tmp_path / "policy.onnx", 15, 77, "n")
    model = onnx.load(path)
    for text in ("{", "{}", '{"observation": [{}]}'):
        onnx.helper.set_model_props(model, {"description": text})
        onnx.save(model, path)
        with pytest.raises(DockctlError) as caught:
            load_policy(path).make(DockingVectorEnv("s1", 1))
        assert str(path) in str(caught.value)


@pytest.mark.parametrize(("inputs", "outputs"), [(16, 77), (15, 76)])
def test_an_onnx_file_of_another_size(tmp_path: Path, inputs: int, outputs: int) -> None:
    pytest.importorskip("onnxruntime")
    onnx_file(tmp_path / "policy.onnx", inputs, outputs, "n")
    with pytest.raises(DockctlError) as caught:
        load_policy(tmp_path / "policy.onnx").make(DockingVectorEnv("s1", 1))
    assert caught.value.code == "mismatch"
    assert str(tmp_path / "policy.onnx") in str(caught.value)
    (tmp_path / "policy.onnx").write_bytes(b"damaged")
    with pytest.raises(DockctlError):
        load_policy(tmp_path / "policy.onnx").make(DockingVectorEnv("s1", 1))


def test_onnx_needs_its_runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "policy.onnx").touch()
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    policy = load_policy(tmp_path / "policy.onnx")
    assert isinstance(policy, BuiltPolicy)
    with pytest.raises(DockctlError) as caught:
        policy.make(DockingVectorEnv("s1", 1))
    assert caught.value.code == "unavailable"
