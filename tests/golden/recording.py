"""What the golden tests compare: rollouts with fixed actions, boats at their goals, and a short training.

The digests cover every bit. They hold on the processor and with the libraries that they were recorded with.
Elsewhere the last bits of sines and matrix products may differ, and the tests compare the stored numbers
within a tolerance. After an intended change of behavior, record again; the commit says what changed and why:

    python -m tests.golden.recording
"""

from __future__ import annotations

import hashlib
import json
import platform
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from safetensors.numpy import load_file
from typer.testing import CliRunner

from dockctl.cli import app
from dockctl.envs.vector import DockingVectorEnv
from dockctl.sim.goal import TO_FINAL
from dockctl.sim.starts import Start, given_start, own_site

FOLDER = Path(__file__).parent
DIGESTS, NUMBERS = FOLDER / "digests.json", FOLDER / "numbers.npz"

SCENARIOS = ("s1", "s2", "s3", "marina")
BOATS, STEPS, SEED = 4, 300, 11
IDLE, ASTERN, ARRIVAL_STEPS = 38, 3, 20
INFO = (
    "pose", "velocity", "command", "distance_m", "heading_error_rad", "phase", "sector_ranges_m",
    "start_kind", "start_index", "outcome", "collided_with",
)  # fmt: skip
"""Keys of `info` that are compared; a key that is added later does not change the digest."""

TRAINING = (
    "training.boats=4", "training.warmup_steps=100", "training.batch_size=32", "training.steps_per_update=4",
    "training.replay_capacity=2000", "training.evaluate_every_steps=800", "training.hidden_sizes=[32, 16]",
    "training.exploring_starts.steps=60", "task.max_steps=80", "training.target_update_interval=50",
    "training.epsilon.decay_steps=1500", "training.stop=null",
    "training.action_repeat=1",
    "training.validation={starts: 6, every_steps: 800}",
)  # fmt: skip
TABLES = ("episodes.csv", "updates.csv", "evaluations.csv", "trajectories.csv")


def machine() -> dict[str, str]:
    """Return what the last bits depend on."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    facts = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    processor = " ".join(facts.get(name, "") for name in ("model name", "cpu family", "model"))
    features = digest(flag.encode() for flag in sorted(facts.get("flags", "").split()))[:12]
    libraries = {name: version(name) for name in ("numpy", "numba", "scipy", "torch")}
    return {"processor": processor, "features": features, "libc": "".join(platform.libc_ver()), **libraries}


def digest(parts: Iterable[bytes]) -> str:
    """Hash some contents in their order."""
    total = hashlib.sha256()
    for part in parts:
        total.update(hashlib.sha256(part).digest())
    return total.hexdigest()


def rollout(scenario: str) -> tuple[str, NDArray[np.float64]]:
    """Step boats through fixed actions, episode after episode; see `_steps`."""
    env = DockingVectorEnv(scenario, BOATS, exploring=True)
    actions = (
        np.random.default_rng(SEED)
        .integers(env.single_action_space.n, size=(STEPS // 5, BOATS))
        .repeat(5, axis=0)
    )
    return _steps(env, actions)


def arrivals(scenario: str) -> tuple[str, NDArray[np.float64]]:
    """Step boats that coast at the intermediate or final pose, and one that hits the quay; see `_steps`.

    Half of those that coast are too fast at first.
    """
    env = DockingVectorEnv(scenario, 5)
    site, task = own_site(env.scenario), env.scenario.task
    starts = [
        replace(given_start(site, task, goal, 0), nu=np.array([surge_mps, 0.0, 0.0]), phase=phase)
        for goal, surge_mps, phase in (
            (site.goals[0], 0.0, site.first_phase),
            (site.goals[0], 0.15, site.first_phase),
            (site.goals[1], 0.0, TO_FINAL),
            (site.goals[1], 0.15, TO_FINAL),
            (site.goals[1], -0.35, TO_FINAL),
        )
    ]
    return _steps(env, np.tile([IDLE, IDLE, IDLE, IDLE, ASTERN], (ARRIVAL_STEPS, 1)), starts)


def _steps(
    env: DockingVectorEnv, actions: NDArray[np.int64], starts: Sequence[Start] | None = None
) -> tuple[str, NDArray[np.float64]]:
    """Step an environment through actions (steps, boats).

    Returns:
        the digest of observations, rewards, flags and infos; observations and rewards, (steps, boats, k + 1).
    """
    observation, info = env.reset(seed=SEED, options={"starts": starts} if starts else None)
    contents = [observation.tobytes(), *_of_info(info)]
    numbers = []
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        contents += [observation.tobytes(), reward.tobytes(), terminated.tobytes(), truncated.tobytes()]
        contents += _of_info(info)
        if "final_info" in info:
            contents += _of_info(info["final_info"])
            contents += [row.tobytes() for row in info["final_obs"] if row is not None]
        numbers.append(np.column_stack([observation, reward]))
    return digest(contents), np.stack(numbers)


def _of_info(info: dict[str, Any]) -> list[bytes]:
    values = [info[key] for key in INFO] + [value for _, value in sorted(info["reward_terms"].items())]
    return [repr(value.tolist()).encode() if value.dtype == object else value.tobytes() for value in values]


def train(scenario: str, folder: Path) -> Path:
    """Train for a few steps through the command line and return the run folder."""
    settings = [word for setting in TRAINING for word in ("--set", setting)]
    arguments = ["train", scenario, "--seed", "5", "--steps", "2400", "--out", str(folder), *settings]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    (run,) = (folder / scenario).glob("*")
    return run


def training_digests(run: Path) -> dict[str, str]:
    """Hash the tables of a run and the weights of its checkpoints."""
    tables = {name: digest([(run / name).read_bytes()]) for name in TABLES}
    weights = {
        f"{name} weights": digest(
            content
            for key, tensor in sorted(load_file(run / "checkpoints" / name / "policy.safetensors").items())
            for content in (key.encode(), tensor.tobytes())
        )
        for name in ("best", "last")
    }
    return {**tables, **weights}


def training_numbers(run: Path) -> dict[str, NDArray[np.float64]]:
    """Return the first updates and the returns of the first episodes, which the last bits hardly change."""
    updates, episodes = (pd.read_csv(run / name) for name in ("updates.csv", "episodes.csv"))
    return {
        "updates": updates[["loss", "td_error", "q_mean"]].to_numpy(float)[:40],
        "returns": episodes["return"].to_numpy(float)[:8],
    }


def main() -> None:
    digests: dict[str, Any] = {"machine": machine(), "rollouts": {}, "arrivals": {}, "trainings": {}}
    numbers: dict[str, NDArray[np.float64]] = {}
    for scenario in SCENARIOS:
        digests["rollouts"][scenario], numbers[f"rollout {scenario}"] = rollout(scenario)
        digests["arrivals"][scenario], numbers[f"arrivals {scenario}"] = arrivals(scenario)
    for scenario in ("s1", "s3"):
        with tempfile.TemporaryDirectory() as folder:
            run = train(scenario, Path(folder))
            digests["trainings"][scenario] = training_digests(run)
            numbers |= {f"{name} {scenario}": values for name, values in training_numbers(run).items()}
    DIGESTS.write_text(json.dumps(digests, indent=2) + "\n", encoding="utf-8")
    np.savez_compressed(NUMBERS, **{name: values.astype(np.float32) for name, values in numbers.items()})


if __name__ == "__main__":
    main()
