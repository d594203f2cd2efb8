"""Updates a second of the learner, and the forward pass, on one core, against what people would use instead.

    python benchmarks/learner.py

Every learner draws its batches from a replay of its own, filled with the same numbers, and has no boats to
steer. What is compared:

- Stable-Baselines3's DQN with the very network of ours put into it, and with its own multi-layer perceptron
  of the widths 256, 128, 64, 64. It makes a pass less than ours: its target is not that of double DQN.
- sbx, the same on JAX, if it is installed (`pip install sbx-rl`; it stands on nightly builds, which nothing
  here can pin): its network has two hidden layers of one width, 205 here, which gives as many parameters as
  ours has. Compilation is not counted.
- The same update by torch modules, autograd and torch's Adam: `dockctl.agents.dqn.update`.
- The arithmetic alone: multiplications and additions of an update, over the rate at which this core
  multiplies large matrices.

The peers are asked for many updates in one call, which spares them their work around it.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable

import bench  # before numpy
import numpy as np
import torch
from numpy.typing import NDArray

from dockctl.agents.dqn.compiled import DoubleDQN, passes
from dockctl.agents.dqn.learner import Learner
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.dqn.replay import Replay, Transitions
from dockctl.agents.dqn.update import AutogradDQN
from dockctl.agents.policy import GreedyPolicy
from dockctl.envs.single import DockingEnv
from dockctl.scenarios.training import Training

# Read when JAX is first imported: one core means one core.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")

STORED = 100_000
WIDTHS, SBX_WIDTH = [256, 128, 64, 64], 205
OURS, SAME, PLAIN = "dockctl", "Stable-Baselines3, same network", "Stable-Baselines3, its own network"
SBX, EAGER, MATRICES = "sbx", "torch modules and autograd", "product of 1024 x 1024 matrices"
MODULES, ONNX = "torch modules", "onnxruntime"
Learn = Callable[[int], object]


class Duel(DuelingQNetwork):
    """Our network for other people's learners: parameters apart, no vector under them."""

    def __init__(self, env: DockingEnv) -> None:
        super().__init__(env.observation_space.shape[0], int(env.action_space.n))
        for parameter in self.parameters():
            parameter.data, parameter.grad = parameter.data.clone(), None


def network(env: DockingEnv) -> DuelingQNetwork:
    return DuelingQNetwork(env.observation_space.shape[0], int(env.action_space.n))


def transitions(env: DockingEnv) -> Transitions:
    rng, size = np.random.default_rng(0), env.observation_space.shape[0]
    return Transitions(
        rng.normal(size=(STORED, size)).astype(np.float32),
        rng.integers(env.action_space.n, size=STORED),
        rng.normal(size=STORED).astype(np.float32),
        np.full(STORED, 0.95, np.float32),
        rng.normal(size=(STORED, size)).astype(np.float32),
    )


def updates(learner: Learner, env: DockingEnv, batch: int) -> Learn:
    replay = Replay(STORED, env.observation_space.shape[0], np.random.default_rng(1))
    replay.add(transitions(env))
    return lambda count: [learner.update(replay.sample(batch), 1e-4) for _ in range(count)]


def ours(env: DockingEnv, batch: int) -> Learn:
    return updates(DoubleDQN(network(env), Training(batch_size=batch)), env, batch)


def autograd(env: DockingEnv, batch: int, device: str = "cpu") -> Learn:
    """Modules, autograd and Adam as torch has them."""
    return updates(AutogradDQN(network(env), Training(batch_size=batch), torch.device(device)), env, batch)


def stable_baselines(env: DockingEnv, batch: int, same_network: bool) -> Learn:
    from stable_baselines3 import DQN
    from stable_baselines3.common.logger import configure

    policy = {"net_arch": WIDTHS}
    model = DQN("MlpPolicy", env, batch_size=batch, buffer_size=STORED, policy_kwargs=policy, device="cpu")
    model.set_logger(configure(None, []))
    if same_network:
        for holder in (model.q_net, model.q_net_target):
            holder.q_net = Duel(env)
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


def fill(buffer: object, stored: Transitions) -> None:
    """Put transitions into a replay buffer of Stable-Baselines3, which sbx uses too."""
    buffer.observations[:, 0], buffer.next_observations[:, 0] = stored.observation, stored.next_observation
    buffer.actions[:, 0, 0], buffer.rewards[:, 0], buffer.full = stored.action, stored.reward, True


def operations(net: DuelingQNetwork, batch: int) -> int:
    """Multiplications and additions in the products of matrices of one update.

    Two passes over the next observations, one over the observations and one back, of which the first layer
    needs no derivative by its inputs; the whole output layer counts only where an action is chosen.
    """
    layers = net.layers(net.flat.numpy())
    hidden = [layer.weight.size for layer in layers.hidden]
    rows = layers.split + net.actions
    passes = 3 * sum(hidden) + layers.advantage.weight.size + 2 * rows
    back = 2 * sum(hidden) - hidden[0] + 2 * rows
    return 2 * batch * (passes + back)


def exported(net: DuelingQNetwork) -> Callable[[NDArray[np.float32]], object]:
    """Return the network's greedy action by onnxruntime on one core, the last layers folded into one."""
    import onnxruntime
    from onnx import TensorProto, helper, numpy_helper

    layers = net.layers(net.flat.numpy())
    output = passes.room_for_output(layers)
    passes.fold(layers, output)
    nodes, weights, below = [], [], "x0"
    for depth, layer in enumerate([*layers.hidden, output], start=1):
        names = [below, f"w{depth}", f"b{depth}"]
        weights += [
            numpy_helper.from_array(value, name) for value, name in zip(layer, names[1:], strict=True)
        ]
        nodes.append(helper.make_node("Gemm", names, [f"y{depth}"], transB=1))
        nodes.append(helper.make_node("Relu", [f"y{depth}"], [below := f"x{depth}"]))
    nodes[-1] = helper.make_node("ArgMax", [f"y{len(layers.hidden) + 1}"], ["action"], axis=1, keepdims=0)
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
        EAGER: autograd(env, batch),
    }
    if bench.installed("sbx-rl"):
        made[SBX] = sbx(env, batch)
    return {name: bench.Case(lambda learn=learn: learn(count), count) for name, learn in made.items()}


def forwards(env: DockingEnv, count: int) -> dict[str, bench.Case]:
    net = network(env)
    policy, observation = GreedyPolicy(net), np.ones((1, net.observation_size), np.float32)

    def by_modules(observation: NDArray[np.float32]) -> object:
        with torch.inference_mode():
            return net(torch.from_numpy(observation)).argmax(dim=1).numpy()

    made = {OURS: lambda rows: policy.act(rows, {}), MODULES: by_modules}
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
    square = torch.ones(1024, 1024)
    for batch, count, bar in ((32, 100, 2.0), (256, 30, 1.5)):
        cases = learners(env, batch, count)
        cases[MATRICES] = bench.Case(lambda: torch.mm(square, square))
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
        for peer, least in ((SAME, bar), (EAGER, 1.0)):
            what = f"batch {batch}, against {peer}"
            report.bars.append(bench.Bar(what, bench.ratio(times, peer, OURS), at_least=least, unit="×"))
    times = bench.alternate(forwards(env, 500), arguments.rounds, "forward pass")
    report.seconds |= {f"forward: {name}": values for name, values in times.items()}
    report.facts["forward"] = {
        "microseconds": {name: 1e6 * bench.summary(values)["median"] for name, values in times.items()}
    }
    report.bars.append(
        bench.Bar(
            "forward pass, against torch modules", bench.ratio(times, MODULES, OURS), at_least=1, unit="×"
        )
    )
    report.tell()
    bench.console.print_json(data=report.facts)


if __name__ == "__main__":
    main()
