"""Write a policy for machines without dockctl's dependencies: a pilot file (NumPy) or an ONNX model.

Both have the same description as JSON: `description`.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

import dockctl
from dockctl.console import print_text
from dockctl.dueling import SAME_COMMAND, Ensemble, Layers
from dockctl.envs.observation import HISTORY, ObservationEncoder, blank_view
from dockctl.errors import DockctlError
from dockctl.evaluation.loading import load_checkpoint
from dockctl.evaluation.policies import CheckpointPolicy
from dockctl.geometry import pose_array
from dockctl.onnx_networks import ACTION, DESCRIPTION, Q_VALUES
from dockctl.pilot import PARTS
from dockctl.plugins import OBSERVATION_PARTS
from dockctl.policy_files import FORMAT
from dockctl.registry import PACKAGE_ORIGIN
from dockctl.runs.files import require_writable_file, write_atomically
from dockctl.scenarios.schema import Scenario, Tolerance

OPSET, IR_VERSION = 17, 8
"""ONNX versions that runtimes have supported since 2022."""


def export_files(
    ckpts: Sequence[Path],
    onnx: Path | None,
    pilot: Path | None,
    *,
    plugin_files: Sequence[Path] = (),
    trust: bool = False,
) -> None:
    """Write one policy as an ONNX model, a pilot file, or both.

    Args:
        plugin_files, trust: see `dockctl.evaluation.load_policy`.

    Raises:
        DockctlError: several policies are given, there is no such policy, it cannot be exported, or a file
            cannot be written; nothing is written then.
    """
    if len(ckpts) > 1:
        raise DockctlError("--onnx and --pilot export one policy: give one run folder or checkpoint")
    for file, suffix in ((onnx, ".onnx"), (pilot, ".npz")):
        if file:
            require_writable_file(file, suffix)
    policy = load_checkpoint(ckpts[0], plugin_files=plugin_files, trust=trust)
    scenario = policy.scenario().scenario
    contents = [
        (file, encode(policy, scenario)) for file, encode in ((onnx, onnx_model), (pilot, pilot_file)) if file
    ]
    for file, content in contents:
        print_text(Console(), f"{policy.file} exported to {write_atomically(file, content)}")


def pilot_file(policy: CheckpointPolicy, scenario: Scenario) -> bytes:
    """Return the content of a file that `dockctl.pilot.Pilot.load` reads.

    Raises:
        DockctlError: the policy is not a network of the built-in DQN, or has an observation part that a pilot
            does not compute.
    """
    _networks(policy)
    histories = [given for given in scenario.observation if given.part == HISTORY]
    earlier = [part for given in histories for part in given.params.get("parts", ())]
    for part in (*(given.part for given in scenario.observation), *earlier):
        if part not in PARTS or OBSERVATION_PARTS.origin(part) != PACKAGE_ORIGIN:
            raise DockctlError(
                f"{policy.file}: observes '{part}', which the pilot does not compute"
                f" (known: {', '.join(sorted(PARTS))}); export an ONNX model instead",
                code="unavailable",
            )
    content = io.BytesIO()
    text = np.array(json.dumps(description(policy, scenario), allow_nan=False))
    np.savez(content, allow_pickle=False, **{DESCRIPTION: text}, **dict(sorted(policy.tensors.items())))
    return content.getvalue()


def onnx_model(policy: CheckpointPolicy, scenario: Scenario) -> bytes:
    """Return an ONNX model of the greedy policy, with the scaling of the observation and the commands.

    Input: ``observation`` (n, k) float32, in the units of the description. Outputs: ``action`` (n,) int64,
    ``propeller_n`` and ``rudder_rad`` (n,) float32, ``q_values`` (n, actions) float32.

    Raises:
        DockctlError: the policy is not a network of the built-in DQN, or the package onnx is missing.
    """
    try:
        from onnx import TensorProto, checker, helper, numpy_helper
    except ImportError:
        raise DockctlError(
            "--onnx: needs the package onnx; install it with: pip install 'dockctl[onnx]'",
            code="unavailable",
        ) from None
    networks, mirror, hysteresis = _networks(policy)
    facts = description(policy, scenario)
    constants: dict[str, Any] = {}
    nodes: list[Any] = []

    def constant(name: str, values: Any, kind: type = np.float32) -> str:
        constants[name] = np.asarray(values, kind)
        return name

    def node(kind: str, *inputs: str, name: str = "", **attributes: Any) -> str:
        output = name or f"{kind.lower()}_{len(nodes)}"
        nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    columns = facts["observation"]
    scale = constant("scale", [column["scale"] for column in columns])
    x = node("Div", "observation", scale)
    for kind, bound, unbounded in (("Max", "low", -math.inf), ("Min", "high", math.inf)):
        values = [unbounded if column[bound] is None else column[bound] for column in columns]
        x = node(kind, x, constant(bound, values))

    def q_of(network: Layers, number: int, x: str) -> str:
        streams: dict[str, str] = {}
        for stream, pairs in network._asdict().items():
            out = streams.get("shared", x)
            for layer, (weight, bias) in enumerate(pairs):
                name = f"{number}.{stream}.{layer}"
                named = (constant(f"{name}.weight", weight), constant(f"{name}.bias", bias))
                out = node("Gemm", out, *named, transB=1)
                if stream == "shared" or layer + 1 < len(pairs):
                    out = node("Relu", out)
            streams[stream] = out
        mean = node("ReduceMean", streams["advantage"], axes=[1], keepdims=1)
        return node("Sub", node("Add", streams["value"], streams["advantage"]), mean)

    each = [q_of(network, number, x) for number, network in enumerate(networks)]
    if mirror is not None:
        columns_of_image = constant("columns", mirror.columns, np.int64)
        actions = constant("actions", mirror.actions, np.int64)
        image = node("Mul", node("Gather", x, columns_of_image, axis=1), constant("signs", mirror.signs))
        each += [
            node("Gather", q_of(network, number, image), actions, axis=1)
            for number, network in enumerate(networks)
        ]
    q = node("Mean", *each, name=Q_VALUES)
    if hysteresis is not None:
        last = node("Gather", x, constant("last command", hysteresis.columns, np.int64), axis=1)
        rows = node("Unsqueeze", last, constant("axis", [1], np.int64))
        difference = node("Abs", node("Sub", rows, constant("commands", hysteresis.commands)))
        farthest = node("ReduceMax", difference, axes=[2], keepdims=0)
        same = node("Cast", node("Less", farthest, constant("same", SAME_COMMAND)), to=TensorProto.FLOAT)
        q = node("Add", q, node("Mul", same, constant("margin", hysteresis.margin)))
    action = node("ArgMax", q, axis=1, keepdims=0, name=ACTION)
    for column, name in enumerate(("propeller_n", "rudder_rad")):
        table = constant(f"{name} of actions", [command[column] for command in facts["commands"]])
        node("Gather", table, action, name=name)
    real, whole, rows = TensorProto.FLOAT, TensorProto.INT64, "n"
    outputs: dict[str, tuple[Any, list[Any]]] = {
        ACTION: (whole, [rows]),
        "propeller_n": (real, [rows]),
        "rudder_rad": (real, [rows]),
        Q_VALUES: (real, [rows, len(facts["commands"])]),
    }
    graph = helper.make_graph(
        nodes,
        "dockctl",
        [helper.make_tensor_value_info("observation", real, [rows, len(columns)])],
        [helper.make_tensor_value_info(name, *shape) for name, shape in outputs.items()],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )
    model = helper.make_model(
        graph,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="dockctl",
        producer_version=dockctl.__version__,
    )
    helper.set_model_props(model, {DESCRIPTION: json.dumps(facts, allow_nan=False)})
    checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString(deterministic=True))


def description(policy: CheckpointPolicy, scenario: Scenario) -> dict[str, Any]:
    """Return the description that is needed to use the policy in other software, as plain data for JSON.

    Raises:
        DockctlError: its actions are not discrete.
    """
    vessel, lidar, task, card = scenario.vessel, scenario.sensors.lidar, scenario.task, policy.card
    commands = scenario.actions.command_table(vessel)
    if commands is None:
        raise DockctlError(
            f"{policy.file}: has {scenario.actions.kind} actions, {scenario.actions.space(vessel)}; expected"
            " discrete actions with a command each",
            code="unavailable",
        )
    return {
        "format": FORMAT,
        "dockctl": dockctl.__version__,
        "scenario": scenario.name,
        "seed": card.seed,
        "env_steps": card.env_steps,
        "checkpoint_sha256": card.sha256,
        "control_period_s": vessel.control_period_s,
        "max_steps": scenario.evaluated_task.max_steps,
        "limits": {"propeller_n": vessel.max_propeller_n, "rudder_rad": math.radians(vessel.max_rudder_deg)},
        "lidar": {"sectors": lidar.sectors, "range_m": lidar.range_m},
        "observation": _columns(scenario),
        "actions": scenario.actions.model_dump(mode="json"),
        "commands": commands.tolist(),
        "goals": {
            "intermediate": pose_array(task.intermediate).tolist() if task.intermediate else None,
            "final": pose_array(task.final).tolist(),
        },
        "tolerances": {
            "intermediate": _tolerance(task.intermediate_tolerance),
            "final": _tolerance(task.final_tolerance),
        },
    }


def _columns(scenario: Scenario) -> list[dict[str, Any]]:
    """Return name, unit, scale, and bounds (after scaling) of each column of the observation."""
    vessel, sectors = scenario.vessel, scenario.sensors.lidar.sectors
    limit = vessel.command_limit
    encoder = ObservationEncoder(scenario.observation, sectors)
    low, high = (
        [bound if math.isfinite(bound) else None for bound in bounds.tolist()]
        for bounds in (encoder.space.low, encoder.space.high)
    )
    columns = []
    for given in encoder.columns(blank_view(sectors, limit)):
        scales = np.broadcast_to(np.asarray(given.scale, float), len(given.names)).tolist()
        units = given.units or [""] * len(given.names)
        columns += [
            {"name": name, "unit": unit, "scale": scale}
            for name, unit, scale in zip(given.names, units, scales, strict=True)
        ]
    return [{**column, "low": low[i], "high": high[i]} for i, column in enumerate(columns)]


def _tolerance(tolerance: Tolerance) -> dict[str, float]:
    return {
        "distance_m": tolerance.distance_m,
        "heading_rad": tolerance.heading,
        "speed_mps": tolerance.speed_mps,
    }


def _networks(policy: CheckpointPolicy) -> Ensemble:
    """Return the networks of a policy.

    Raises:
        DockctlError: it is not a policy of the built-in DQN.
    """
    kind = policy.card.algorithm.get("kind")
    try:
        return Ensemble.of(policy.tensors)
    except (ValueError, KeyError) as error:
        raise DockctlError(
            f"{policy.file}: policies of the algorithm '{kind}' cannot be exported: {error};"
            " only those of 'dqn' can",
            code="unavailable",
        ) from None
