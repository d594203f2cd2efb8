"""Updates per second of the learner, and the forward pass, on one core, compared with other libraries.

    python benchmarks/learner.py

Every learner draws its batches from its own replay, filled with the same numbers, without an environment.
What is compared:

- Stable-Baselines3's DQN with our network, and with its own multi-layer perceptron of the widths 256, 128,
  64, 64. Its update has one forward pass less: its target is not that of double DQN.
- sbx, the same on JAX, if it is installed (`pip install sbx-rl`): its network has two hidden layers of width
  205, which gives as many parameters as ours has. Compilation is not counted.
- The arithmetic alone: multiplications and additions of an update, over the rate at which this core
  multiplies large matrices.

The other libraries make many updates in one call, which saves them overhead.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable

import bench  # before numpy
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.linalg.blas import sgemm  # of the BLAS that the compiled updates call
from torch import nn

from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.dqn.policy import GreedyPolicy
from dockctl.agents.dqn.replay import Batch, Replay, Transitions
from dockctl.agents.dqn.update import DoubleDQN
from dockctl.agents.tensors import numpy_tensors
from dockctl.envs.single import DockingEnv
from dockctl.scenarios.training import Training

# Read when JAX is first imported: one core means one core.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")

STORED = 100_000
WIDTHS, SBX_WIDTH = [256, 128, 64, 64], 205
OURS, SAME, PLAIN = "dockctl", "Stable-Baselines3, same network", "Stable-Baselines3, its own network"
SBX, MATRICES, ONNX = "sbx", "product of 1024 x 1024 matrices", "onnxruntime"
Learn = Callable[[int], object]


def network(env: DockingEnv) -> DuelingQNetwork:
    return DuelingQNetwork(env.observation_space.shape[0], int(env.action_space.n))


def transitions(env: DockingEnv) -> Batch:
    rng, size = np.random.default_rng(0), env.observation_space.shape[0]
    return Transitions(
        rng.normal(size=(STORED, size)).astype(np.float32),
        rng.integers(env.action_space.n, size=STORED),
        rng.normal(size=STORED).astype(np.float32),
        np.full(STORED, 0.95, np.float32),
        rng.normal(size=(STORED, size)).astype(np.float32),
    )


def ours(env: DockingEnv, batch: int, device: str = "cpu") -> Learn:
    learner = DoubleDQN(network(env).to(device), Training(batch_size=batch))
    replay = Replay(STORED, env.observation_space.shape[0], np.random.default_rng(1))
    replay.add(transitions(env))
    return lambda count: [learner.update(replay.sample(batch), 1e-4) for _ in range(count)]


def stable_baselines(env: DockingEnv, batch: int, same_network: bool) -> Learn:
    from stable_baselines3 import DQN
    from stable_baselines3.common.logger import configure

    policy = {"net_arch": WIDTHS}
    model = DQN("MlpPolicy", env, batch_size=batch, buffer_size=STORED, policy_kwargs=policy, device="cpu")
    model.set_logger(configure(None, []))
    if same_network:
        for holder in (model.q_net, model.q_net_target):
            holder.q_net = network(env)
        model.policy.optimizer = torch.optim.Adam(model.q_net.parameters(), lr=1e-4)
    fill(model.replay_buffer, transitions(env))
    return lambda count: model.train(count, batch)


def sbx(env: DockingEnv, batch: int) -> Learn:
    from sbx import DQN
    from stable_baselines3.common.logger import configure

    policy = {"net_arch": [SBX_WIDTH]}
    model = DQN("MlpPolicy", env, batch_size=batch, buffer_size=STORED, policy_kwargs=policy)
    model.set_logger(configure(None, []))
    fill(model.replay_buffer, transitions(env))
    return lambda count: model.train(batch, count)


def fill(buffer: object, stored: Batch) -> None:
    """Put transitions into a replay buffer of Stable-Baselines3, which sbx uses too."""
    buffer.observations[:, 0], buffer.next_observations[:, 0] = stored.observation, stored.next_observation
    buffer.actions[:, 0, 0], buffer.rewards[:, 0], buffer.full = stored.action, stored.reward, True


def linear_layers(*modules: nn.Module) -> list[nn.Linear]:
    return [layer for module in modules for layer in module.modules() if isinstance(layer, nn.Linear)]


def operations(net: DuelingQNetwork, batch: int) -> int:
    """Return the multiplications and additions in the matrix products of one update.

    Two forward passes over the next observations, one over the observations, and one backward, which costs
    two forward passes less the first layer, whose inputs need no gradient.
    """
    weights = [layer.weight.numel() for layer in linear_layers(net)]
    return 2 * batch * (5 * sum(weights) - weights[0])


def exported(net: DuelingQNetwork) -> Callable[[NDArray[np.float32]], object]:
    """Return the network's greedy action by onnxruntime on one core: that of the highest advantage."""
    import onnxruntime
    from onnx import TensorProto, helper, numpy_helper

    nodes, weights, below = [], [], "x0"
    layers = linear_layers(net.shared, net.advantage)
    for depth, layer in enumerate(layers, start=1):
        names = [below, f"w{depth}", f"b{depth}"]
        for name, value in zip(names[1:], (layer.weight, layer.bias), strict=True):
            weights.append(numpy_helper.from_array(value.detach().numpy(), name))
        nodes.append(helper.make_node("Gemm", names, [f"y{depth}"], transB=1))
        nodes.append(helper.make_node("Relu", [f"y{depth}"], [below := f"x{depth}"]))
    nodes[-1] = helper.make_node("ArgMax", [f"y{len(layers)}"], ["action"], axis=1, keepdims=0)
    seen = helper.make_tensor_value_info("x0", TensorProto.FLOAT, ["boats", net.observation_size])
    action = helper.make_tensor_value_info("action", TensorProto.INT64, ["boats"])
    graph = helper.make_graph(nodes, "policy", [seen], [action], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, ["CPUExecutionProvider"])
    return lambda observation: session.run(None, {"x0": observation})[0]


def learners(env: DockingEnv, batch: int, count: int) -> dict[str, bench.Case]:
    made = {
        OURS: ours(env, batch),
        SAME: stable_baselines(env, batch, same_network=True),
        PLAIN: stable_baselines(env, batch, same_network=False),
    }
    if bench.installed("sbx-rl"):
        made[SBX] = sbx(env, batch)
    return {name: bench.Case(lambda learn=learn: learn(count), count) for name, learn in made.items()}


def forwards(env: DockingEnv, count: int) -> dict[str, bench.Case]:
    net = network(env)
    policy, observation = (
        GreedyPolicy(numpy_tensors(net.state_dict())),
        np.ones((1, net.observation_size), np.float32),
    )
    made = {OURS: lambda rows: policy.act(rows, {})}
    if bench.installed("onnxruntime") and bench.installed("onnx"):
        made[ONNX] = exported(net)
    return {
        name: bench.Case(lambda act=act: [act(observation) for _ in range(count)], count)
        for name, act in made.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=9)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    env, report = DockingEnv("s3"), bench.Report("learner", "Learner: updates on one core")
    square = np.ones((1024, 1024), np.float32, order="F")
    for batch, count in ((32, 100), (256, 30)):
        cases = learners(env, batch, count)
        cases[MATRICES] = bench.Case(lambda: sgemm(1, square, square))
        times = bench.alternate(cases, arguments.rounds, f"updates, batch {batch}")
        needed = operations(network(env), batch) / (2 * 1024**3)  # in products of the large matrices
        report.facts[f"batch {batch}"] = {
            "operations": operations(network(env), batch),
            "updates_per_second": {
                n: 1 / bench.summary(t)["median"] for n, t in times.items() if n != MATRICES
            },
            "times_as_fast_as": {n: bench.ratio(times, n, OURS) for n in times if n not in (OURS, MATRICES)},
            "share_of_the_arithmetic_bound": needed * bench.ratio(times, MATRICES, OURS),
        }
        report.seconds |= {f"batch {batch}: {name}": values for name, values in times.items()}
        what = f"batch {batch}, relative to {SAME}"
        report.targets.append(bench.Target(what, bench.ratio(times, SAME, OURS), at_least=1, unit="×"))
    times = bench.alternate(forwards(env, 500), arguments.rounds, "forward pass")
    report.seconds |= {f"forward: {name}": values for name, values in times.items()}
    report.facts["forward"] = {
        "microseconds": {name: 1e6 * bench.summary(values)["median"] for name, values in times.items()}
    }
    report.write()
    bench.console.print_json(data=report.facts)


if __name__ == "__main__":
    main()
