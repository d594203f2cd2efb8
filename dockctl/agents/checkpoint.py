"""Checkpoints: tensors as safetensors, everything else as JSON, no pickle."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

import dockctl
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.errors import DockctlError, nearest
from dockctl.runs.directory import RunDirectory, shipped
from dockctl.runs.files import write_atomically
from dockctl.scenarios.interface import PolicyInterface

FORMAT = 1
POLICY, LEARNER = "policy", "learner"
Tensors = Mapping[str, NDArray[Any]]


class CheckpointError(DockctlError):
    """A checkpoint that is missing, damaged, or made for something else."""


@dataclass(frozen=True)
class PolicyCard:
    """What a policy is and where it comes from.

    Attributes:
        interface: what it observes and does, wherever it sails; None in a card of an earlier version.
        sha256: hash of its tensors' file; empty until it is stored.
    """

    scenario: str
    observation_size: int
    actions: int
    hidden_sizes: tuple[int, ...]
    env_steps: int
    seed: int
    interface: PolicyInterface | None = None
    sha256: str = ""

    def facts(self) -> dict[str, Any]:
        """The card as plain data, for JSON."""
        interface = None if self.interface is None else self.interface.model_dump(mode="json")
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        return {**own, "interface": interface}

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> Self:
        """Read what `facts` gave.

        Raises:
            KeyError, TypeError, ValueError: the facts are not those of a policy.
        """
        for name in ("observation_size", "actions", "env_steps", "seed"):
            if type(facts[name]) is not int:
                raise TypeError(f"{name} is {facts[name]!r}, expected a whole number")
        interface = facts.get("interface")
        if interface is not None:
            try:
                interface = PolicyInterface.model_validate(interface)
            except ValidationError as error:
                first = error.errors()[0]
                place = ".".join(map(str, ("interface", *first["loc"])))
                raise ValueError(f"{place}: {first['msg']}") from None
        card = cls(**{field.name: facts[field.name] for field in fields(cls) if field.name in facts})
        return replace(card, hidden_sizes=tuple(card.hidden_sizes), interface=interface)


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
        if not os.path.isfile(file):
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
    save_pair(folder, POLICY, tensors, card.facts())


def load_policy(path: str | Path) -> tuple[DuelingQNetwork, PolicyCard]:
    """Load a policy from a run folder, a checkpoint folder or file, or by the name of a shipped checkpoint.

    Raises:
        CheckpointError: there is none, or it is damaged.
    """
    file = find_policy(Path(path))
    tensors, facts = load_pair(file)
    try:
        card = PolicyCard.of(facts)
        network = DuelingQNetwork(card.observation_size, card.actions, card.hidden_sizes)
        load_parameters(network, tensors)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise CheckpointError(f"{file}: does not describe a policy: {error}") from None
    return network, card


@torch.no_grad()
def load_parameters(network: DuelingQNetwork, tensors: Tensors) -> None:
    """Copy named tensors into the parameters of `network`.

    Raises:
        KeyError, ValueError: a parameter is missing or has another shape.
    """
    for name, parameter in network.named_parameters():
        if tuple(tensors[name].shape) != tuple(parameter.shape):
            raise ValueError(f"{name} has shape {tensors[name].shape}, not {tuple(parameter.shape)}")
        parameter.copy_(torch.from_numpy(tensors[name]))


def find_policy(path: Path) -> Path:
    """JSON file of the policy that `path` names: of a run folder the best one, else the last.

    What exists on disk goes before a shipped checkpoint of the same name.

    Raises:
        CheckpointError: there is none.
    """
    names = shipped()
    if not os.path.exists(path) and str(path) in names:
        path = names[str(path)]
    if not os.path.exists(path):
        listed = ", ".join(names) or "none"
        message = f"{path}: no such run folder or checkpoint (shipped: {listed})"
        raise CheckpointError(message, code="not_found", suggestion=nearest(str(path), names))
    if os.path.isfile(path):
        if path.suffix not in (".json", ".safetensors"):
            raise CheckpointError(
                f"{path}: not a checkpoint: expected a folder, a .safetensors or a .json file"
            )
        return path.with_suffix(".json")
    for folder in (path, *map(RunDirectory(path).checkpoint, ("best", "last"))):
        if any(os.path.isfile(folder / f"{POLICY}.{kind}") for kind in ("json", "safetensors")):
            return folder / f"{POLICY}.json"
    also = f"; the shipped '{path}' is in {names[str(path)]}" if str(path) in names else ""
    raise CheckpointError(f"{path}: holds no checkpoint; a run has one from its first evaluation on{also}")


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
