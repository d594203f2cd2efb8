"""Checkpoints: tensors as safetensors, everything else as JSON, no pickle."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

import dockctl
from dockctl.agents.network import DuelingQNetwork
from dockctl.errors import DockctlError
from dockctl.runs.files import write_atomically

FORMAT = 1
POLICY, LEARNER = "policy", "learner"
Tensors = Mapping[str, NDArray[Any]]


class CheckpointError(DockctlError):
    """A checkpoint that is missing, damaged, or made for something else."""


@dataclass(frozen=True)
class PolicyCard:
    """What a policy is and where it comes from."""

    scenario: str
    observation_size: int
    actions: int
    hidden_sizes: tuple[int, ...]
    env_steps: int
    seed: int


def save_pair(folder: Path, name: str, tensors: Tensors, facts: Mapping[str, Any]) -> None:
    """Write ``<name>.safetensors`` and ``<name>.json``, which holds the facts and the hash of the tensors."""
    content = save_tensors({key: np.array(value, order="C") for key, value in tensors.items()})
    write_atomically(folder / f"{name}.safetensors", content)
    card = {
        "format": FORMAT,
        "dockctl": dockctl.__version__,
        **facts,
        "sha256": hashlib.sha256(content).hexdigest(),
    }
    write_atomically(folder / f"{name}.json", (json.dumps(card, indent=2) + "\n").encode())


def load_pair(facts_file: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read what `save_pair` wrote, by the path of its JSON file.

    Raises:
        CheckpointError: a file is missing, damaged, or of another format.
    """
    tensors_file = facts_file.with_suffix(".safetensors")
    for file in (facts_file, tensors_file):
        if not file.is_file():
            raise CheckpointError(
                f"{file}: no such file; a checkpoint is a .safetensors and a .json file of one name"
            )
    try:
        facts = json.loads(facts_file.read_text(encoding="utf-8"))
        content = tensors_file.read_bytes()
    except (OSError, ValueError) as error:
        raise CheckpointError(f"{facts_file}: not a readable checkpoint: {error}") from None
    if not isinstance(facts, dict) or facts.get("format") != FORMAT:
        raise CheckpointError(f"{facts_file}: not a checkpoint of format {FORMAT}")
    if hashlib.sha256(content).hexdigest() != facts.get("sha256"):
        raise CheckpointError(
            f"{tensors_file}: damaged or cut short: its hash is not the one in {facts_file.name}"
        )
    try:
        return load_tensors(content), facts
    except SafetensorError as error:
        raise CheckpointError(f"{tensors_file}: damaged: {error}") from None


def save_policy(folder: Path, network: DuelingQNetwork, card: PolicyCard) -> None:
    """Write the policy of `network` into `folder`."""
    tensors = {name: parameter.detach().cpu().numpy() for name, parameter in network.named_parameters()}
    save_pair(folder, POLICY, tensors, asdict(card))


def load_policy(path: str | Path) -> tuple[DuelingQNetwork, PolicyCard]:
    """Load a policy from a run folder, a checkpoint folder, or one of a checkpoint's two files.

    Raises:
        CheckpointError: there is none, or it is damaged.
    """
    file = find_policy(Path(path))
    tensors, facts = load_pair(file)
    try:
        card = PolicyCard(**{name: facts[name] for name in PolicyCard.__dataclass_fields__})
        for name in ("observation_size", "actions", "env_steps", "seed"):
            if type(facts[name]) is not int:
                raise TypeError(f"{name} is {facts[name]!r}, expected a whole number")
        network = DuelingQNetwork(card.observation_size, card.actions, tuple(card.hidden_sizes))
        load_parameters(network, tensors)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise CheckpointError(f"{file}: does not describe a policy: {error}") from None
    return network, card


@torch.no_grad()
def load_parameters(network: DuelingQNetwork, tensors: Tensors) -> None:
    """Copy named tensors into the parameters of `network`.

    Raises:
        KeyError, RuntimeError: a parameter is missing or has another shape.
    """
    for name, parameter in network.named_parameters():
        if tuple(tensors[name].shape) != tuple(parameter.shape):
            raise ValueError(f"{name} has shape {tensors[name].shape}, not {tuple(parameter.shape)}")
        parameter.copy_(torch.from_numpy(tensors[name]))


def find_policy(path: Path) -> Path:
    """JSON file of the policy that `path` names: of a run folder the best one, else the last.

    Raises:
        CheckpointError: there is none.
    """
    if not path.exists():
        raise CheckpointError(f"{path}: no such run folder or checkpoint")
    if path.is_file():
        if path.suffix not in (".json", ".safetensors"):
            raise CheckpointError(
                f"{path}: not a checkpoint: expected a folder, a .safetensors or a .json file"
            )
        return path.with_suffix(".json")
    for folder in (path, path / "checkpoints" / "best", path / "checkpoints" / "last"):
        if (folder / f"{POLICY}.json").is_file() or (folder / f"{POLICY}.safetensors").is_file():
            return folder / f"{POLICY}.json"
    raise CheckpointError(f"{path}: holds no checkpoint; a run has one from its first evaluation on")


def require_shape(
    card: PolicyCard, observation_size: int, actions: int, *, where: Path, scenario: str
) -> None:
    """Check that a policy fits a scenario.

    Raises:
        CheckpointError: it takes other observations or gives other actions.
    """
    for what, has, needs in (
        ("an observation of", card.observation_size, observation_size),
        ("actions in the number of", card.actions, actions),
    ):
        if has != needs:
            raise CheckpointError(
                f"{where}: trained on '{card.scenario}' with {what} {has}, but '{scenario}' has {needs}"
            )
